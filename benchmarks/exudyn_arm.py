"""Compare the exact beam with Exudyn: large motion of a tapered two-link arm with elastic joints and rigid ends.

    python -m benchmarks.exudyn_arm            measures both and prints the distances (extra: bench)

The joints are damped. Each of Exudyn's beam elements has a constant section, so that its error is of second order in
the element length: two meshes are extrapolated (Richardson). Rigid ends are local positions of bodies on the beams' end
nodes. Joints are revolute joints with torsional springs, whose offsets are the motors' angles.
"""

from typing import Any

import numpy as np

from benchmarks.exudyn_peer import beam, sensor_of, settings_of
from flexarm_env.parameters import Arm, Joint, Link, Payload
from flexarm_env.scene import Motion, Scene
from flexarm_env.simulation import Trajectory, simulate
from flexarm_env.time_functions import cycloid

LENGTHS, ENDS, MATERIAL = (0.55, 0.4), ((0.05, 0.04), (0.03, 0.0)), {"E": 7e9, "rho": 2700.0, "G": 2.6e9}
SIDES: tuple[tuple[Any, Any], ...] = (((0.02, 0.015), (8e-3, 5e-3)), ((0.015, 0.01), (5e-3, 3e-3)))
SPRINGS, DAMPERS, HUB, PAYLOAD, TAU_D = (60.0, 15.0), (0.05, 0.02), 0.01, (0.1, 1e-4), 2e-3
TURNS, TIMES = (1.6, -2.0), (0.4, 0.3)
DURATION, SAMPLE = 1.0, 0.01


def scene() -> Scene:
    """Return the scene: motors with cycloidal motions drive the arm through springs in the joints."""
    links = tuple(
        Link.tapered(length, *sides, **MATERIAL, root_offset=ends[0], tip_offset=ends[1])
        for length, sides, ends in zip(LENGTHS, SIDES, ENDS, strict=True)
    )
    joints = tuple(Joint(stiffness=k, damping=d) for k, d in zip(SPRINGS, DAMPERS, strict=True))
    arm = Arm("tapered", links, hub_inertia=HUB, payload=Payload(*PAYLOAD), tau_d=TAU_D, joints=joints)
    motions = tuple(Motion(f"motor{k}", cycloid(TURNS[k], TIMES[k])) for k in range(2))
    return Scene("tapered", arm, duration=DURATION, dt=5e-4, sample=SAMPLE, motions=motions)


def ours(elements: int = 10, dt: float = 5e-4) -> Trajectory:
    """Simulate the scene with the exact beam."""
    options: dict[str, Any] = {"elements": elements, "order": 2, "dt": dt, "rho_inf": 0.9}
    return simulate(scene(), "geometrically_exact", estimate_error=False, **options)


def peer(elements: int, dt: float) -> np.ndarray:
    """Simulate the scene with Exudyn; return tip positions (n, 2) at the samples, m."""
    import exudyn as exu
    from exudyn import itemInterface

    items: Any = itemInterface
    known = scene()
    mbs = exu.SystemContainer().AddSystem()
    x, before = 0.0, mbs.AddMarker(items.MarkerBodyRigid(bodyNumber=mbs.AddObject(items.ObjectGround())))
    for k, link in enumerate(known.arm.links):
        start, motor = x + link.root_offset, known.motion_of(f"motor{k}")
        nodes = beam(mbs, link, elements, 2, (start, 0.0), tau_d=TAU_D)
        last = k + 1 == len(LENGTHS)
        inertia, (mass, turning) = HUB if k == 0 else 1e-12, PAYLOAD if last else (1e-12, 1e-12)
        first = mbs.AddObject(items.ObjectRigidBody2D(mass=1e-12, inertia=inertia, nodeNumber=nodes[0]))
        end = mbs.AddObject(items.ObjectRigidBody2D(mass=mass, inertia=turning, nodeNumber=nodes[-1]))
        near = mbs.AddMarker(items.MarkerBodyRigid(bodyNumber=first, localPosition=[-link.root_offset, 0.0, 0.0]))
        mbs.AddObject(items.RevoluteJoint2D(markerNumbers=[before, near]))

        def torque(mbs: Any, t: float, item: int, angle: float, rate: float, stiffness: float, damping: float,
                   offset: float, motor: Any = motor) -> float:  # fmt: skip
            return float(stiffness * (angle - motor(t)) + damping * (rate - motor(t, 1)))

        mbs.AddObject(items.TorsionalSpringDamper(
            markerNumbers=[before, near], stiffness=SPRINGS[k], damping=DAMPERS[k], springTorqueUserFunction=torque,
        ))  # fmt: skip
        before = mbs.AddMarker(items.MarkerBodyRigid(bodyNumber=end, localPosition=[link.tip_offset, 0.0, 0.0]))
        x = start + link.length + link.tip_offset
    sensor = sensor_of(mbs, nodes[-1])
    mbs.Assemble()
    settings = settings_of(0.9, dense=False)
    of = settings.timeIntegration
    of.numberOfSteps, of.endTime = round(DURATION / dt), DURATION
    of.newton.relativeTolerance, of.newton.absoluteTolerance = 1e-5, 1e-6
    settings.solution.sensors.writePeriod = SAMPLE
    if not mbs.SolveDynamic(settings):
        raise RuntimeError(f"Exudyn with {elements} elements per link and steps of {dt:g} s did not come to an end")
    return np.asarray(mbs.GetSensorStoredData(sensor))[:, 1:3]


OURS = ((10, 5e-4), (10, 2.5e-4))
PEERS = ((16, 5e-4), (16, 2.5e-4), (24, 2.5e-4))
"""Elements per link and steps, s, of Exudyn's runs; OURS has those of the exact beam."""


def compared(mine: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> str:
    """Return lines with the distances between the programs' tips, over the arm's length."""
    length = sum(LENGTHS) + sum(map(sum, ENDS))
    own, finest = mine[_name(*OURS[-1])], other[_name(*PEERS[-1])]
    middle = other[_name(*PEERS[1])]
    peer_at_once = finest + (finest - middle) / ((PEERS[2][0] / PEERS[1][0]) ** 2 - 1.0)
    peer_at_once = peer_at_once + (middle - other[_name(*PEERS[0])]) / 3.0
    own_at_once = own + (own - mine[_name(*OURS[0])]) / 3.0

    def apart(one: np.ndarray, two: np.ndarray) -> float:
        return float(np.hypot(*(one - two).T).max()) / length

    lines = [f"the exact beam, {name}: {apart(tips, own_at_once):.2g} of L" for name, tips in mine.items()]
    lines += [f"Exudyn, {name}: {apart(tips, own_at_once):.2g} of L" for name, tips in other.items()]
    both = apart(peer_at_once, own_at_once)
    lines.append(f"Exudyn extrapolated in mesh and step, the exact beam in step: {both:.2g} of L")
    return "\n".join(lines)


def _name(elements: int, dt: float) -> str:
    return f"{elements} elements per link, {1e3 * dt:g} ms"


def main() -> None:
    """Run both programs and print the distances."""
    mine = {_name(*case): ours(*case).tip[:, :2] for case in OURS}
    print(compared(mine, {_name(*case): peer(*case) for case in PEERS}))


if __name__ == "__main__":
    main()
