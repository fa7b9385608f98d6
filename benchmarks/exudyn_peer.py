"""Compare with Exudyn's geometrically exact beam elements: scenes of one link, and the strip stepped from Python.

The scenes need the extra `bench`; the strip is that of `FlexibleArm-v0`.

In `run`, loads are switched off between two calls of the solver, so that no Python function runs inside the solver. A
prescribed hub angle requires a function of time, which Exudyn calls in Python at least once per step; Exudyn's time
includes these calls. `stepper` reuses one solver object for all control periods, writes no files, and has the fastest
settings for a small system: dense matrices, modified Newton, linear elements, and the module without range checks. The
loop of `stepper` only sets the torque, solves the period, and reads tip and hub. The loop has no observation, reward or
wrapper, which the package's environment has: the comparison favors Exudyn.
"""

import itertools
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexarm_env import arms
from flexarm_env.parameters import Link
from flexarm_env.scenes import named

SCENES = ("robot_arm_motion_smooth", "robot_arm_motion", "robot_arm_torque", "flying_rod", "flying_rod_soft")


def beam(
    mbs: Any, link: Link, elements: int, order: int, start: tuple[float, float] = (0.0, 0.0), angle: float = 0.0,
    tau_d: float = 0.0,
) -> list[Any]:  # fmt: skip
    """Add a straight link to an Exudyn system and return its nodes.

    order: polynomial order of the elements, 1 or 2. Each element has the section at its middle.
    """
    from exudyn import itemInterface

    along = np.array([np.cos(angle), np.sin(angle)])
    nodes = [
        mbs.AddNode(itemInterface.NodeRigidBody2D(referenceCoordinates=[*(np.array(start) + along * x), angle]))
        for x in np.linspace(0.0, link.length, order * elements + 1)
    ]
    for e in range(elements):
        section = link.along((e + 0.5) / elements * link.length)
        mbs.AddObject(itemInterface.ObjectBeamGeometricallyExact2D(
            nodeNumbers=nodes[order * e : order * (e + 1) + 1], length=link.length / elements,
            massPerLength=section.m, crossSectionInertia=section.J,
            bendingStiffness=section.EI, axialStiffness=section.EA, shearStiffness=section.C,
            bendingDamping=tau_d * section.EI, axialDamping=tau_d * section.EA, shearDamping=tau_d * section.C,
        ))  # fmt: skip
    return nodes


def _marker(mbs: Any, node: Any, coordinate: int = 0) -> Any:
    from exudyn import itemInterface

    return mbs.AddMarker(itemInterface.MarkerNodeCoordinate(nodeNumber=node, coordinate=coordinate))


def _held(mbs: Any, node: Any, coordinates: tuple[int, ...], **function: Any) -> None:
    """Fix coordinates of a node. function: keywords of a prescribed offset over time."""
    from exudyn import itemInterface

    ground = _marker(mbs, mbs.AddNode(itemInterface.NodePointGround()))
    for coordinate in coordinates:
        markers = [ground, _marker(mbs, node, coordinate)]
        mbs.AddObject(itemInterface.CoordinateConstraint(markerNumbers=markers, **function))


def settings_of(rho_inf: float, dense: bool) -> Any:
    """Return Exudyn settings: generalized-α, modified Newton, no output files."""
    import exudyn as exu

    settings: Any = exu.SimulationSettings()
    settings.timeIntegration.verboseMode = 0
    settings.timeIntegration.generalizedAlpha.spectralRadius = rho_inf
    settings.timeIntegration.newton.useModifiedNewton = True
    settings.linearSolver.solverType = exu.LinearSolverType.EXUdense if dense else exu.LinearSolverType.EigenSparse
    settings.solution.file.write = False
    return settings


def sensor_of(mbs: Any, node: Any) -> Any:
    """Add a sensor that stores the positions of a node."""
    import exudyn as exu
    from exudyn import itemInterface

    position = exu.OutputVariableType.Position
    return mbs.AddSensor(itemInterface.SensorNode(nodeNumber=node, storeInternal=True, outputVariableType=position))


def run(name: str, elements: int, dt: float, *, rho_inf: float = 1.0) -> dict[str, Any]:
    """Run one scene; return tip positions at the sampling instants, m, the solver's CPU seconds, and whether it
    finished."""
    import exudyn as exu
    from exudyn import itemInterface

    scene, order = named(name), 2
    container = exu.SystemContainer()
    mbs = container.AddSystem()
    angle = scene.angles[0]
    nodes = beam(mbs, scene.arm.links[0], elements, order, scene.position, angle)
    if scene.root == "pinned":
        _held(mbs, nodes[0], (0, 1))
    motion = scene.motion_of("joint0")
    if motion is not None:
        _held(mbs, nodes[0], (2,), offset=0.0, offsetUserFunction=lambda mbs, t, number, offset: motion(t) - angle,
              offsetUserFunction_t=lambda mbs, t, number, offset: motion(t, 1))  # fmt: skip
    loads: list[tuple[Any, Any]] = []
    for load in scene.loads:
        parts = (None, None, load.function) if hasattr(load, "joint") else (load.force_x, load.force_y, load.torque)
        for coordinate, function in enumerate(parts):
            if function is not None:
                marker = _marker(mbs, nodes[0], coordinate)
                item = itemInterface.LoadCoordinate(markerNumber=marker, load=function(0.0))
                loads.append((mbs.AddLoad(item), function))
    sensor = sensor_of(mbs, nodes[-1])
    mbs.Assemble()
    settings = settings_of(rho_inf, dense=elements * order < 30)
    settings.solution.sensors.writePeriod = scene.sample
    settings.show.statistics = settings.show.computationTime = False
    instants = [0.0, *scene.kinks, scene.duration] if loads else [0.0, scene.duration]
    clock, finished = time.process_time(), True
    for first, last in itertools.pairwise(instants):
        for load, function in loads:
            mbs.SetLoadParameter(load, "load", function(first))
        settings.timeIntegration.startTime, settings.timeIntegration.endTime = first, last
        settings.timeIntegration.numberOfSteps = max(1, round((last - first) / dt))
        try:
            finished = bool(mbs.SolveDynamic(settings, updateInitialValues=True))
        except Exception:  # Exudyn raises its own kinds of error when Newton fails
            finished = False
        if not finished:
            break
    cpu = time.process_time() - clock
    record: NDArray[np.float64] = np.asarray(mbs.GetSensorStoredData(sensor))
    return {"finished": finished, "cpu_seconds": cpu, "t": record[:, 0], "tip": record[:, 1:3]}


def stepper(elements: int, n_steps: int, period: float = 0.02) -> Callable[[int], int]:
    """Return a function that steps the strip by `count` control periods under random torques and returns `count`."""
    sys.exudynFast = True  # its module without range checks
    import exudyn as exu
    from exudyn import itemInterface

    arm = arms.resolve("strip")
    assert arm.torque_limits is not None
    container = exu.SystemContainer()
    mbs = container.AddSystem()
    nodes = beam(mbs, arm.links[0], elements, 1, tau_d=arm.tau_d)
    rigid = itemInterface.ObjectRigidBody2D
    mbs.AddObject(rigid(physicsMass=1e-6, physicsInertia=arm.hub_inertia, nodeNumber=nodes[0]))
    mbs.AddObject(rigid(physicsMass=arm.payload.mass, physicsInertia=1e-9, nodeNumber=nodes[-1]))
    _held(mbs, nodes[0], (0, 1))
    torque = mbs.AddLoad(itemInterface.LoadCoordinate(markerNumber=_marker(mbs, nodes[0], 2), load=0.0))
    mbs.Assemble()
    settings = settings_of(0.7, dense=True)
    settings.timeIntegration.adaptiveStep = False
    settings.timeIntegration.numberOfSteps = n_steps
    settings.timeIntegration.endTime = 0.0
    solver = exu.MainSolverImplicitSecondOrder()
    solver.InitializeSolver(mbs, settings)
    solver.SolveSteps(mbs, settings)
    torques = np.random.default_rng(0).uniform(-1.0, 1.0, 256) * arm.torque_limits[0]
    position, rates = exu.OutputVariableType.Position, exu.OutputVariableType.Coordinates_t
    initial, state = exu.ConfigurationType.Initial, {"period": 0}

    def advance(count: int) -> int:
        for _ in range(count):
            k = state["period"]
            mbs.SetLoadParameter(torque, "load", float(torques[k % 256]))
            settings.timeIntegration.startTime = k * period
            settings.timeIntegration.endTime = (k + 1) * period
            solver.InitializeSolverInitialConditions(mbs, settings)
            solver.SolveSteps(mbs, settings)
            mbs.systemData.SetSystemState(mbs.systemData.GetSystemState(), configuration=initial)
            mbs.GetNodeOutput(nodes[-1], position)
            mbs.GetNodeOutput(nodes[0], rates)
            state["period"] = k + 1
        return count

    return advance
