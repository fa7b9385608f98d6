"""Simulate a strip that falls on a floor with Exudyn, for `benchmarks.contact`: python exudyn_contact.py

The script needs only Exudyn and prints the tip's positions (m) as JSON. ANCF cables stretch and bend
without shear. The floor is a user function: a force on the tip by the law of Hunt and Crossley.
"""

import json
from typing import Any

LENGTH, EI, EA, MASS, TAU, G = 1.0, 2.0, 1e5, 0.2, 2e-3, 9.81
FLOOR, STIFFNESS, DAMPING = -0.05, 1e4, 0.5
DURATION, SAMPLE = 0.4, 0.01


def normal_force(height: float, rate: float) -> float:
    """Return the floor's force, N, at a height (m) of the tip and a rate of this height (m/s)."""
    depth = max(FLOOR - height, 0.0)
    return float(max(0.0, STIFFNESS * depth**1.5 * (1.0 - 1.5 * DAMPING * rate)))


def tips(elements: int, dt: float) -> list[list[float]]:
    """Return the tip's positions (x, y) at the samples, m. elements: number of elements. dt: step, s."""
    import exudyn as exu
    from exudyn import itemInterface
    from exudyn.beams import GenerateStraightLineANCFCable2D

    items: Any = itemInterface
    mbs = exu.SystemContainer().AddSystem()
    cable = items.ObjectANCFCable2D(
        physicsMassPerLength=MASS, physicsBendingStiffness=EI, physicsAxialStiffness=EA, nodeNumbers=[0, 0],
        physicsBendingDamping=TAU * EI, physicsAxialDamping=TAU * EA, useReducedOrderIntegration=0,
    )  # fmt: skip
    made = GenerateStraightLineANCFCable2D(
        mbs=mbs, positionOfNode0=[0.0, 0.0, 0.0], positionOfNode1=[LENGTH, 0.0, 0.0], numberOfElements=elements,
        cableTemplate=cable, massProportionalLoad=[0.0, -G, 0.0], fixedConstraintsNode0=[1, 1, 0, 1],
        fixedConstraintsNode1=[0, 0, 0, 0],
    )  # fmt: skip
    end = made[0][-1]
    ground = mbs.AddMarker(
        items.MarkerNodeCoordinate(nodeNumber=mbs.AddNode(items.NodePointGround()), coordinate=0)
    )  # fmt: skip
    height = mbs.AddMarker(items.MarkerNodeCoordinate(nodeNumber=end, coordinate=1))

    def force(mbs, t, item, u, v, k, d, offset):  # type: ignore[no-untyped-def]
        return -normal_force(u, v)

    mbs.AddObject(
        items.CoordinateSpringDamper(markerNumbers=[ground, height], stiffness=0.0, springForceUserFunction=force)
    )
    sensor = mbs.AddSensor(
        items.SensorNode(nodeNumber=end, storeInternal=True, outputVariableType=exu.OutputVariableType.Position)
    )
    mbs.Assemble()
    settings = exu.SimulationSettings()
    of = settings.timeIntegration
    of.numberOfSteps, of.endTime = round(DURATION / dt), DURATION
    of.generalizedAlpha.spectralRadius = 0.9
    of.newton.relativeTolerance, of.newton.absoluteTolerance = 1e-8, 1e-10
    of.verboseMode = 0
    settings.solution.file.write = False
    settings.solution.sensors.writePeriod = SAMPLE
    if not mbs.SolveDynamic(settings):
        raise RuntimeError("Exudyn did not come to an end")
    return mbs.GetSensorStoredData(sensor)[:, 1:3].tolist()  # type: ignore[no-any-return]


if __name__ == "__main__":
    print(json.dumps([tips(16, 2e-4), tips(16, 1e-4), tips(32, 1e-4)]))
