"""Exudyn as a peer: the one-link validation scenes on its own geometrically exact beam elements (extra: bench).

Loads are switched off at their kink between two calls of the solver, so that no Python function runs inside it; a
prescribed hub angle needs a function of time, which Exudyn calls from Python, once or more a step: that is in its time.
"""

from __future__ import annotations

import itertools
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexarm_env.scenes import named

SCENES = ("robot_arm_motion_smooth", "robot_arm_motion", "robot_arm_torque", "flying_rod", "flying_rod_soft")


def run(name: str, elements: int, dt: float, *, order: int = 2, rho_inf: float = 1.0) -> dict[str, Any]:
    """One scene: tip positions at its sampling instants (m), CPU seconds of the solver, and whether it finished.

    order: 1 or 2 (nodes of an element less one). rho_inf: of its generalized-alpha; modified Newton, dense solver.
    """
    import exudyn as exu
    from exudyn import itemInterface

    scene = named(name)
    link = scene.arm.links[0]
    section = link.section
    container = exu.SystemContainer()
    mbs = container.AddSystem()
    angle = scene.angles[0]
    start = np.array(scene.position)
    along = np.array([np.cos(angle), np.sin(angle)])
    nodes = [
        mbs.AddNode(itemInterface.NodeRigidBody2D(referenceCoordinates=[*(start + along * x), angle]))
        for x in np.linspace(0.0, link.length, order * elements + 1)
    ]
    for e in range(elements):
        mbs.AddObject(
            itemInterface.ObjectBeamGeometricallyExact2D(
                nodeNumbers=nodes[order * e : order * e + order + 1],
                length=link.length / elements,
                massPerLength=section.m,
                crossSectionInertia=section.J,
                bendingStiffness=section.EI,
                axialStiffness=section.EA,
                shearStiffness=section.C,
            )
        )
    ground = mbs.AddNode(itemInterface.NodePointGround())
    ground_marker = mbs.AddMarker(itemInterface.MarkerNodeCoordinate(nodeNumber=ground, coordinate=0))
    held = (0, 1) if scene.root == "pinned" else ()
    for coordinate in held:
        marker = mbs.AddMarker(itemInterface.MarkerNodeCoordinate(nodeNumber=nodes[0], coordinate=coordinate))
        mbs.AddObject(itemInterface.CoordinateConstraint(markerNumbers=[ground_marker, marker]))
    motion = scene.motion_of("joint0")
    if motion is not None:
        marker = mbs.AddMarker(itemInterface.MarkerNodeCoordinate(nodeNumber=nodes[0], coordinate=2))
        mbs.AddObject(
            itemInterface.CoordinateConstraint(
                markerNumbers=[ground_marker, marker],
                offset=0.0,
                offsetUserFunction=lambda mbs, t, number, offset: motion(t) - angle,
                offsetUserFunction_t=lambda mbs, t, number, offset: motion(t, 1),
            )
        )
    loads: list[tuple[int, str, Any]] = []
    for load in scene.loads:
        parts = (
            [(2, load.function)]
            if hasattr(load, "joint")
            else [(k, f) for k, f in enumerate((load.force_x, load.force_y, load.torque)) if f is not None]
        )
        for coordinate, function in parts:
            marker = mbs.AddMarker(itemInterface.MarkerNodeCoordinate(nodeNumber=nodes[0], coordinate=coordinate))
            loads.append(
                (mbs.AddLoad(itemInterface.LoadCoordinate(markerNumber=marker, load=function(0.0))), "load", function)
            )
    sensor = mbs.AddSensor(
        itemInterface.SensorNode(
            nodeNumber=nodes[-1], storeInternal=True, outputVariableType=exu.OutputVariableType.Position
        )
    )
    mbs.Assemble()
    settings = exu.SimulationSettings()
    settings.timeIntegration.verboseMode = 0
    settings.timeIntegration.generalizedAlpha.spectralRadius = rho_inf
    settings.timeIntegration.newton.useModifiedNewton = True
    small = elements * order < 30
    settings.linearSolver.solverType = exu.LinearSolverType.EXUdense if small else exu.LinearSolverType.EigenSparse
    settings.solution.file.write = False
    settings.solution.sensors.writePeriod = scene.sample
    settings.show.statistics = False
    settings.show.computationTime = False
    instants = [0.0, *scene.kinks, scene.duration] if loads else [0.0, scene.duration]
    clock, finished = time.process_time(), True
    for first, last in itertools.pairwise(instants):
        for load, what, function in loads:
            mbs.SetLoadParameter(load, what, function(first))
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
