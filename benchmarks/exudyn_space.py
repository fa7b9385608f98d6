"""Compare arms in space with Exudyn's beam (extra: bench): converged results, and run time against error.

python -m benchmarks.exudyn_space [--out FOLDER] [--page]

Exudyn's model consists of `ObjectBeamGeometricallyExact` on nodes with Euler parameters, and joints as `GenericJoint`.
All arms are undamped, because that object ignores its damping matrix (1.13.6). Newton's tolerances are 1e-6. At the
default 1e-8, Newton's method with difference derivatives does not converge, and steps are halved or the solver fails.
Forces are Python functions in Exudyn, called twice per step; with 200 to 3200 steps they take a few milliseconds of a
run.
"""

import argparse
import time
from typing import Any

import numpy as np

import flexarm_env as fx
from benchmarks import pages
from benchmarks.exudyn_peer import sensor_of, settings_of
from benchmarks.machine import table
from flexarm_env.rotations import matrices, quaternions
from flexarm_env.time_functions import constant, sine

Array = Any
STRIP = fx.Section(2.0, 2e4, 1e4, 0.3, 1e-4, 4.0, 1e4, 2e-4, 1.0)
SAMPLE = 0.01


def _load(link: int, size: float, end: str = "tip") -> fx.PointLoad:
    of = {"force_y": (1.2, 5.0), "force_z": (1.6, 4.0), "torque_x": (0.35, 6.0)}
    return fx.PointLoad(link, end, **{name: sine(size * a, omega) for name, (a, omega) in of.items()})


def _scene(name: str, arm: fx.Arm, duration: float, **more: Any) -> fx.Scene:
    return fx.Scene(name, arm, duration=duration, dt=1e-3, sample=SAMPLE, space=True, **more)


def scenes() -> dict[str, fx.Scene]:
    """Return the compared scenes: a clamped link, a chain with oblique hinges, and a right angle in free flight."""
    one, two = (fx.Link(1.0, STRIP),), (fx.Link(0.6, STRIP), fx.Link(0.5, STRIP))
    tensor = ((2e-3, 2e-4, 0.0), (2e-4, 3e-3, 0.0), (0.0, 0.0, 2.5e-3))
    body = fx.Payload(0.15, tensor, (0.03, 0.05, -0.04))
    elbow = fx.Elbow(0.1, 1e-3, 2e-3, (0.0, 0.6, 0.8), ((1.0, 0.0, 0.0), 0.4))
    corner = fx.Elbow(0.1, 1e-3, 1e-3, mount=((0.0, 1.0, 0.0), -1.2))
    held = (fx.Motion("joint0", constant(0.0)),)
    chain = fx.Arm("chain", two, hub_inertia=0.02, hub_axis=(0.0, 1.0, 1.0), elbows=(elbow,), payload=body)
    angle = fx.Arm("angle", two, elbows=(corner,), payload=fx.Payload(0.2, 1e-3))
    torques = (fx.JointTorque(0, sine(2.0, 6.0)), fx.JointTorque(1, sine(0.8, 5.0)))
    return {
        "clamped": _scene("clamped", fx.Arm("one", one), 1.0, loads=(_load(0, 1.0),), motions=held),
        "chain": _scene("chain", chain, 0.8, loads=(*torques, _load(1, 1.0)), angles=(0.2, 0.5)),
        "flight": _scene("flight", angle, 0.8, loads=(_load(1, 2.0), _load(0, -3.0, "root")), root="free",
                         angles=(0.0, 0.3), rigid_joints=(1,)),
    }  # fmt: skip


def ours(scene: fx.Scene, elements: int, dt: float) -> tuple[Array, float, bool]:
    """Run a scene with the package; return tip positions (n, 3), m, CPU seconds, and whether the run finished."""
    runs = [fx.simulate(scene, elements=elements, dt=dt, rho_inf=0.9, estimate_error=False) for _ in range(2)]
    return runs[0].tip, min(run.cpu_seconds for run in runs), runs[0].finished


def _inertia(value: Any, mass: float, c: Array) -> list[float]:
    """Return Exudyn's six components of an inertia tensor about the node."""
    I = np.array(value) if isinstance(value, tuple) else value * np.eye(3)
    I = I + mass * (c @ c * np.eye(3) - np.outer(c, c))
    return [I[0, 0], I[1, 1], I[2, 2], I[1, 2], I[0, 2], I[0, 1]]


def peer(scene: fx.Scene, elements: int, dt: float) -> tuple[Array, float, bool]:
    """Run a scene with Exudyn; return tip positions (n, 3), m, CPU seconds, and whether the run finished."""
    import exudyn as exu
    from exudyn import itemInterface

    items: Any = itemInterface
    mbs = exu.SystemContainer().AddSystem()
    arm = scene.arm
    r, R = np.array(scene.position), np.eye(3)
    before, ends = mbs.AddMarker(items.MarkerBodyRigid(bodyNumber=mbs.AddObject(items.ObjectGround()))), []
    for k, link in enumerate(arm.links):
        elbow = arm.elbow(k) if k else None
        axis = np.array(arm.hub_axis if elbow is None else elbow.axis)
        mount = arm.hub_mount if elbow is None else elbow.mount
        mount = np.eye(3) if mount is None else np.array(mount)
        R = R @ mount @ matrices(scene.angles[k] * axis)
        s: Any = link.section
        section = exu.BeamSection()
        section.massPerLength, section.inertia = s.m, np.diag([s.J + s.J_y, s.J_y, s.J])
        section.stiffnessMatrix = np.diag([s.EA, s.C, s.C_y, s.GJ, s.EI_y, s.EI])
        nodes = [
            mbs.AddNode(items.NodeRigidBodyEP(referenceCoordinates=[*(r + R[:, 0] * x), *quaternions(R)]))
            for x in np.linspace(0.0, link.length, elements + 1)
        ]
        for e in range(elements):
            mbs.AddObject(items.ObjectBeamGeometricallyExact(
                nodeNumbers=nodes[e : e + 2], length=link.length / elements, sectionData=section
            ))  # fmt: skip
        near, far = (mbs.AddMarker(items.MarkerNodeRigid(nodeNumber=node)) for node in (nodes[0], nodes[-1]))

        def body(node: Any, mass: float, inertia: Any, c: Array) -> None:
            mbs.AddObject(items.ObjectRigidBody(
                physicsMass=mass, physicsInertia=_inertia(inertia, mass, c), physicsCenterOfMass=c, nodeNumber=node
            ))  # fmt: skip

        zero, last = np.zeros(3), k == arm.n_links - 1
        body(nodes[0], 1e-12, arm.hub_inertia or 1e-12 if elbow is None else elbow.inertia_right, zero)
        tip = arm.payload if last else arm.elbow(k + 1)
        if isinstance(tip, fx.Payload):
            body(nodes[-1], tip.mass or 1e-12, tip.inertia or 1e-12, np.array((*tip.offset, 0.0)[:3]))
        else:
            body(nodes[-1], tip.mass or 1e-12, tip.inertia_left or 1e-12, zero)
        if k or scene.root != "free":
            rigid = k in scene.rigid_joints or scene.motion_of(f"joint{k}") is not None
            if rigid:  # at its angle
                turns = mount @ matrices(scene.angles[k] * axis), np.eye(3)
            else:
                frame = np.linalg.svd(axis[None])[2]
                frame = np.array([frame[1], np.cross(axis, frame[1]), axis]).T
                turns = mount @ frame, frame
            mbs.AddObject(items.GenericJoint(
                markerNumbers=[before, near], constrainedAxes=[1, 1, 1, 1, 1, int(rigid)],
                rotationMarker0=turns[0], rotationMarker1=turns[1],
            ))  # fmt: skip
            for load in scene.loads:
                if isinstance(load, fx.JointTorque) and load.joint == k:
                    for marker, arm_of in ((near, axis), (before, -mount @ axis)):
                        _force(
                            mbs, items.Torque, marker, [lambda t, f=load.function, x=x: x * f(t) for x in arm_of], True
                        )
        before, r = far, r + R[:, 0] * link.length
        ends.append({"root": near, "tip": far})
    for load in scene.loads:
        if isinstance(load, fx.PointLoad):
            marker = ends[load.link][load.end]
            _force(mbs, items.Force, marker, [load.force_x, load.force_y, load.force_z], False)
            _force(mbs, items.Torque, marker, [load.torque_x, load.torque_y, load.torque], False)
    sensor = sensor_of(mbs, nodes[-1])
    mbs.Assemble()
    settings = settings_of(0.9, dense=False)
    of = settings.timeIntegration
    of.numberOfSteps, of.endTime, of.adaptiveStep = round(scene.duration / dt), scene.duration, False
    of.newton.relativeTolerance = of.newton.absoluteTolerance = 1e-6
    settings.solution.sensors.writePeriod = SAMPLE
    clock = time.process_time()
    try:
        finished = bool(mbs.SolveDynamic(settings))
    except Exception:  # of its own kinds
        finished = False
    return np.asarray(mbs.GetSensorStoredData(sensor))[:, 1:4], time.process_time() - clock, finished


def _force(mbs: Any, item: Any, marker: Any, functions: list[Any], turning: bool) -> None:
    """Add a force or torque whose components are functions of time, or None."""

    def at(mbs: Any, t: float, load: Any) -> list[float]:
        return [0.0 if f is None else float(f(t)) for f in functions]

    if any(functions):
        mbs.AddLoad(item(markerNumber=marker, loadVector=[0, 0, 0], bodyFixed=turning, loadVectorUserFunction=at))


CHECKED = ((16, 1e-3), (32, 5e-4))
"""Elements per link and steps (s) of two runs whose results are extrapolated to second order in mesh and step."""
MESHES = (4, 8, 16, 32)
STEPS = (4e-3, 2e-3, 1e-3, 5e-4, 2.5e-4)


def measure(_: argparse.Namespace) -> dict[str, Any]:
    """Compare converged results of Exudyn and this package, and measure run time against error."""
    rows: list[dict[str, Any]] = []
    checks = []
    for name, scene in scenes().items():
        length = scene.arm.total_length

        def apart(one: Array, two: Array, length: float = length) -> float:
            return float(np.linalg.norm(one - two, axis=1).max()) / length

        at_once = {}
        for who, run in (("flexarm_env", ours), ("Exudyn", peer)):
            coarse, fine = (run(scene, *case)[0] for case in CHECKED)
            at_once[who] = fine + (fine - coarse) / 3.0
        bent = fx.simulate(scene, elements=16, estimate_error=False)
        checks.append([
            name, f"{float(np.linalg.norm(bent.tip_deflection, axis=2).max()):.2f}",
            f"{np.degrees(np.abs(bent.twist).max()):.0f}", f"{apart(at_once['flexarm_env'], at_once['Exudyn']):.1e}",
        ])  # fmt: skip
        known = ours(scene, 48, 1.25e-4)[0]
        for who, run in (("flexarm_env", ours), ("Exudyn", peer)):
            for elements in MESHES:
                for dt in STEPS:
                    if who == "Exudyn" and (dt == STEPS[-1] or (elements, dt) == (32, STEPS[-2])):
                        continue  # half a minute
                    tips, seconds, finished = run(scene, elements, dt)
                    ended = finished and tips.shape == known.shape
                    error = apart(tips, known) if ended else float("nan")
                    rows.append(
                        {"scene": name, "who": who, "elements": elements, "dt": dt, "error": error, "cpu": seconds}
                    )
                    print(rows[-1], flush=True)
    return {"checks": checks, "rows": rows}


def front(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the Pareto front of error and CPU time; each further row has at most 0.7 times the previous error."""
    best: list[dict[str, Any]] = []
    for row in sorted((row for row in rows if row["error"] == row["error"]), key=lambda row: row["cpu"]):
        if not best or row["error"] < 0.7 * best[-1]["error"]:
            best.append(row)
    return best


def blocks(found: dict[str, Any]) -> pages.Blocks:
    """Format the tables of the page."""
    lines = []
    for name in dict.fromkeys(row["scene"] for row in found["rows"]):
        for who in ("flexarm_env", "Exudyn"):
            own = front([row for row in found["rows"] if row["scene"] == name and row["who"] == who])
            lines += [
                [name, who, row["elements"], f"{1e3 * row['dt']:g}", f"{100 * row['error']:.2g}", f"{row['cpu']:.3f}"]
                for row in own
            ]
    return {
        "CHECKS": table(
            "scene | largest deflection, of a link's length | largest twist, ° | distance between the tips, of L",
            found["checks"],
        ),
        "WORK": table("scene | program | elements per link | step, ms | error, % of L | CPU, s", lines),
    }


if __name__ == "__main__":
    pages.run("space_peer", __doc__, measure, blocks, packages=("exudyn",))
