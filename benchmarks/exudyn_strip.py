"""The default arm of `FlexibleArm-v0` in Exudyn, stepped from Python a control period at a time (extra: bench).

Its implicit solver is kept between periods, writes no files and takes its quickest settings for a small system: dense
matrices, modified Newton, linear elements, the module without range checks. Only what a step needs is in the loop: the
torque set, the period solved, the tip and hub read. No observation, reward or wrapper, which ours has: the comparison
is generous to it.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import numpy as np

from flexarm_env import arms


def stepper(elements: int, n_steps: int, period: float = 0.02) -> Callable[[int], int]:
    """A function of a count that makes so many control periods under random torque and returns that count."""
    sys.exudynFast = True  # its module without range checks
    import exudyn as exu
    from exudyn import itemInterface

    arm = arms.resolve("strip")
    link, section = arm.links[0], arm.links[0].section
    assert arm.torque_limits is not None
    container = exu.SystemContainer()
    mbs = container.AddSystem()
    places = np.linspace(0.0, link.length, elements + 1)
    nodes = [mbs.AddNode(itemInterface.NodeRigidBody2D(referenceCoordinates=[x, 0.0, 0.0])) for x in places]
    for e in range(elements):
        mbs.AddObject(
            itemInterface.ObjectBeamGeometricallyExact2D(
                nodeNumbers=nodes[e : e + 2],
                length=link.length / elements,
                massPerLength=section.m,
                crossSectionInertia=section.J,
                bendingStiffness=section.EI,
                axialStiffness=section.EA,
                shearStiffness=section.C,
                bendingDamping=arm.tau_d * section.EI,
                axialDamping=arm.tau_d * section.EA,
                shearDamping=arm.tau_d * section.C,
            )
        )
    rigid = itemInterface.ObjectRigidBody2D
    mbs.AddObject(rigid(physicsMass=1e-6, physicsInertia=arm.hub_inertia, nodeNumber=nodes[0]))
    mbs.AddObject(rigid(physicsMass=arm.payload.mass, physicsInertia=1e-9, nodeNumber=nodes[-1]))
    ground = mbs.AddMarker(
        itemInterface.MarkerNodeCoordinate(nodeNumber=mbs.AddNode(itemInterface.NodePointGround()), coordinate=0)
    )
    for coordinate in (0, 1):
        marker = mbs.AddMarker(itemInterface.MarkerNodeCoordinate(nodeNumber=nodes[0], coordinate=coordinate))
        mbs.AddObject(itemInterface.CoordinateConstraint(markerNumbers=[ground, marker]))
    hub = mbs.AddMarker(itemInterface.MarkerNodeCoordinate(nodeNumber=nodes[0], coordinate=2))
    torque = mbs.AddLoad(itemInterface.LoadCoordinate(markerNumber=hub, load=0.0))
    mbs.Assemble()

    settings: Any = exu.SimulationSettings()
    settings.timeIntegration.verboseMode = 0
    settings.timeIntegration.adaptiveStep = False
    settings.timeIntegration.generalizedAlpha.spectralRadius = 0.7
    settings.timeIntegration.newton.useModifiedNewton = True
    settings.timeIntegration.numberOfSteps = n_steps
    settings.timeIntegration.endTime = 0.0
    settings.linearSolver.solverType = exu.LinearSolverType.EXUdense
    settings.solution.file.write = False
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
