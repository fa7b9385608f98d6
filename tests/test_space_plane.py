"""Arms of scenes in space that stay in a plane: found where it is true, by the plane's kernels to the last bit, and
where the spatial kernels have them."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import flexarm_env as fx
from flexarm_env.scene import in_plane
from flexarm_env.sensors import Accelerometer, Encoder, Gyroscope, Sensors, StrainGauge
from flexarm_env.time_functions import constant, cycloid, pulse, sine

X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
FLAT = fx.Section.rectangle(0.05, 0.006, 70e9, 2700.0, 26e9)
TALL = fx.Section.rectangle(0.006, 0.05, 70e9, 2700.0, 26e9)
TUBE = fx.Section.tube(0.02, 0.002, 70e9, 2700.0, 26e9)
GEAR = fx.Joint(stiffness=300.0, damping=0.1, motor_inertia=1e-4, gear_ratio=20.0, friction_coulomb=0.1)
DRAWN = Rotation.from_rotvec([0.4, -1.1, 0.7])


def pitch(**more: Any) -> fx.Scene:
    """Two links that pitch under gravity: what they are in x-z, and loads."""
    links = (fx.Link(0.6, TALL, root_offset=0.05, root_mass=0.1), fx.Link.tapered(
        0.5, (0.004, 0.003), (0.05, 0.03), E=70e9, rho=2700.0, G=26e9
    ))  # fmt: skip
    arm = fx.Arm(
        "pitch", links, hub_axis=Y, elbows=(fx.Elbow(0.2, np.diag([5e-3, 1e-3, 5e-3]), 1e-3, axis=Y),), tau_d=1e-3,
        payload=fx.Payload(0.3, np.diag([1e-3, 2e-3, 2.5e-3]), (0.05, 0.0, 0.02)), joints=(GEAR, fx.Joint()),
    )  # fmt: skip
    push = fx.PointLoad(0, "tip", force_x=pulse(3.0, 0.1), force_z=pulse(-4.0, 0.1), torque_y=sine(0.2, 9.0))
    loads = (fx.JointTorque(1, constant(1.2)), push)
    fields: dict[str, Any] = {"gravity": (0.0, 0.0, -9.81), "angles": (-0.3, 0.5), "rates": (0.5, -1.0), "loads": loads}
    return fx.Scene("pitch", arm, **{"duration": 0.3, "dt": 1e-3, "sample": 0.02, **fields, **more})


def same_in_the_plane() -> fx.Scene:
    """`pitch` as one writes it for the plane: its y is the other's -z."""
    links = (fx.Link(0.6, FLAT, root_offset=0.05, root_mass=0.1), fx.Link.tapered(
        0.5, (0.05, 0.03), (0.004, 0.003), E=70e9, rho=2700.0, G=26e9
    ))  # fmt: skip
    arm = fx.Arm(
        "pitch", links, elbows=(fx.Elbow(0.2, 1e-3, 1e-3),), tau_d=1e-3,
        payload=fx.Payload(0.3, 2e-3, (0.05, -0.02)), joints=(GEAR, fx.Joint()),
    )  # fmt: skip
    push = fx.PointLoad(0, "tip", pulse(3.0, 0.1), pulse(4.0, 0.1), sine(0.2, 9.0))
    return fx.Scene(
        "pitch", arm, duration=0.3, dt=1e-3, sample=0.02, gravity=(0.0, 9.81), angles=(-0.3, 0.2), rates=(0.5, -0.5),
        loads=(fx.JointTorque(1, constant(1.2)), push),
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("formulation", ["geometrically_exact", "floating_frame", "elastica"])
def test_an_arm_in_x_z_is_the_planes_to_the_last_bit(formulation: str) -> None:
    plane, space = (fx.simulate(s, formulation, estimate_error=False) for s in (same_in_the_plane(), pitch()))
    assert plane.finished and space.scene.spatial
    for name in ("q", "v", "joint_angles", "motor_rates", "joint_torque", "kinetic", "strain_energy", "work"):
        assert np.array_equal(getattr(plane, name), getattr(space, name)), name
    x, y, angle = plane.tip.T
    assert np.array_equal(space.tip, np.column_stack([x, 0.0 * x, -y])) and not space.twist.any()
    assert np.array_equal(space.tip_deflection[..., 1], -plane.tip_deflection)
    quaternion = np.column_stack([np.cos(angle / 2), 0.0 * x, np.sin(angle / 2), 0.0 * x])
    assert np.abs(space.tip_rotation - quaternion).max() < 1e-15


def turned() -> fx.Scene:
    """A drawn plane; links that are turned over and about their x axes, joints that turn the other way, mounts in the
    plane, loads and gravity of all components."""
    flip = Rotation.from_rotvec([math.pi, 0.0, 0.0])
    elbows = (
        fx.Elbow(0.2, 1e-3, 1e-3, axis=Z, mount=(Rotation.from_rotvec([0.0, 0.0, 0.4]) * flip).as_matrix()),
        fx.Elbow(axis=(0.0, -math.sin(0.7), -math.cos(0.7)), mount=(X, 0.7)),
    )
    arm = fx.Arm(
        "turned", (fx.Link(0.5, FLAT), fx.Link(0.4, FLAT), fx.Link(0.3, TUBE)), hub_mount=DRAWN.as_matrix(),
        elbows=elbows, payload=fx.Payload(0.2, 1e-4), joints=(fx.Joint(), GEAR, fx.Joint()),
    )  # fmt: skip
    g, f, m = (DRAWN.apply(v).tolist() for v in ([1.0, -9.0, 0.0], [3.0, 2.0, 0.0], [0.0, 0.0, 0.3]))
    push = fx.PointLoad(
        2, "tip", **{f"force_{c}": constant(v) for c, v in zip("xyz", f, strict=True)},
        **{k: sine(v, 7.0) for k, v in zip(("torque_x", "torque_y", "torque"), m, strict=True)},
    )  # fmt: skip
    motion = fx.Motion("joint2", cycloid(0.8, 0.2, offset=0.3))
    return fx.Scene(
        "turned", arm, duration=0.2, dt=5e-4, sample=0.02, gravity=g, angles=(0.2, -0.4, 0.3), position=(0.1, 0.2, 0.3),
        motions=(motion,), loads=(push, fx.JointTorque(1, constant(1.0))),
    )  # fmt: skip


def carried() -> fx.Scene:
    """A root that is moved along z, a curved link upside down, a rigid joint, a rest to start from."""
    arm = fx.Arm(
        "carried", (fx.Link(0.5, FLAT, curvature=1.2), fx.Link(0.4, FLAT)), hub_axis=(0.0, 0.0, -1.0),
        hub_mount=(X, math.pi / 2), payload=fx.Payload(0.2),
        elbows=(fx.Elbow(axis=Z),),
    )  # fmt: skip
    motions = (fx.Motion("root_z", cycloid(0.1, 0.1, offset=0.5)), fx.Motion("joint0", cycloid(0.5, 0.2, offset=0.1)))
    return fx.Scene(
        "carried", arm, duration=0.2, dt=5e-4, sample=0.02, gravity=(0.0, 0.0, -9.81), position=(0.0, 0.3, 0.5),
        angles=(0.1, 0.3), rigid_joints=(1,), start="held", motions=motions,
    )  # fmt: skip


def flying() -> fx.Scene:
    """Nothing holds the root."""
    arm = fx.Arm("f", (fx.Link(0.6, TALL), fx.Link(0.4, TALL)), hub_axis=Y, elbows=(fx.Elbow(axis=(0.0, -1.0, 0.0)),))
    push = fx.PointLoad(0, "root", force_z=pulse(9.0, 0.1))
    return fx.Scene(
        "flying", arm, duration=0.2, dt=5e-4, sample=0.02, root="free", position=(0.0, 0.4, 0.0), angles=(0.4, 0.5),
        velocity=(1.0, 0.0, -0.5), rates=(2.0, 1.0), loads=(push,), gravity=(0.0, 0.0, -9.81),
    )  # fmt: skip


GAUGES = ((0, "xy"), (0, "xz"), (1, "xy"), (2, "xy"), (2, "xz"), (2, "torsion"))
SENSORS = Sensors(
    encoders=(Encoder(), Encoder(), Encoder()), gyroscope=Gyroscope(), accelerometer=Accelerometer(),
    strain_gauges=tuple(StrainGauge(link=k, place=0.3, measures=what) for k, what in GAUGES),
)  # fmt: skip


def both(scene: fx.Scene) -> list[Any]:
    """Its run, and that of spatial kernels forced."""
    options: dict[str, Any] = {"segments": 2, "elements": 1, "estimate_error": False}
    return [fx.simulate(s, "floating_frame", **options) for s in (scene, dataclasses.replace(scene, space=True))]


RATES = ("rates", "torque", "velocity")


@pytest.mark.slow
@pytest.mark.parametrize("make", [turned, pitch, carried, flying])
def test_it_is_what_the_spatial_kernels_say(make: Any) -> None:
    scene = make()
    flat, space = both(scene)
    assert in_plane(scene) and np.ptp(space.joint_angles[:, -1]) + np.ptp(space.tip, axis=0).max() > 0.1
    size = {name: max(1.0, float(np.abs(getattr(space, name)).max())) for name in space.arrays}
    for name in space.arrays:
        if name not in ("q", "v", "shapes"):
            a, b = getattr(flat, name), getattr(space, name)
            limit = 1e-2 if name.endswith(RATES) else 1e-3 if a.ndim == 1 else 5e-5
            assert a.shape == b.shape and np.abs(a - b).max() < limit * size[name], name


@pytest.mark.slow
def test_what_is_read_off_it_and_kept(tmp_path: Any) -> None:
    """Sensors of both bendings and of torsion, the page, pictures, files; nothing of a link's width is guessed."""
    run, space = both(dataclasses.replace(turned(), duration=0.1, sample=0.005))
    read, known = (one.measured(SENSORS) for one in (run, space))
    assert list(read) == list(known)
    for name, values in known.items():
        share = 0.1 if "strain" in name else 0.02  # in the plane the mean of a stretch between stations
        assert np.abs(read[name] - values).max() <= share * float(np.abs(values).max()) + 1e-9, name
    clip, other = run.clip(), space.clip()
    assert clip.pinned and [p.name for p in clip.pulls] == [p.name for p in other.pulls]
    assert np.abs(clip.points[:, -1] - run.tip).max() < 1e-12 and clip.rigid is not None
    ends = (np.array(clip.cuts[1:]) - 1, np.array(other.cuts[1:]) - 1)
    assert np.abs(clip.across[:, ends[0]] - other.across[:, ends[1]]).max() < 0.01
    for pull, wanted in zip(clip.pulls, other.pulls, strict=True):
        assert pull.axis is None or np.abs(pull.axis - wanted.axis).max() < 1e-3
    run.to_npz(tmp_path / "run.npz")
    again = fx.Trajectory.from_npz(tmp_path / "run.npz")
    assert again.tip_rotation.shape == (len(again.t), 4)
    assert all(np.array_equal(getattr(run, key), getattr(again, key)) for key in run.arrays)


def _arm(**changes: Any) -> fx.Scene:
    scene = pitch()
    return dataclasses.replace(scene, arm=dataclasses.replace(scene.arm, **changes))


SKEWED = ((2e-3, 1e-5, 0.0), (1e-5, 2e-3, 0.0), (0.0, 0.0, 2e-3))
PUSH: dict[str, Any] = {"link": 1, "end": "tip"}


@pytest.mark.parametrize("scene", [
    dataclasses.replace(pitch(), gravity=(0.0, 1e-9, -9.81)), dataclasses.replace(pitch(), space=True),
    _arm(hub_axis=(0.0, 1.0, 1e-9)), _arm(hub_axis=X), _arm(elbows=(fx.Elbow(axis=Z),)),
    _arm(elbows=(fx.Elbow(axis=Y, mount=(X, 1e-6)),)),
    _arm(elbows=(fx.Elbow(axis=(0.0, 1.0, 1.0), mount=(X, -math.pi / 4)),)),
    _arm(payload=fx.Payload(0.3, 0.0, (0.05, 1e-6, 0.0))), _arm(payload=fx.Payload(0.3, SKEWED)),
    _arm(hub_inertia=SKEWED),
    _arm(links=(fx.Link(0.6, TALL, curvature=0.1), fx.Link(0.5, TALL))),
    _arm(links=(fx.RigidLink(0.6, 1.0), fx.Link(0.5, TALL))),
    dataclasses.replace(pitch(), loads=(fx.PointLoad(**PUSH, force_y=constant(1e-9)),)),
    dataclasses.replace(pitch(), loads=(fx.PointLoad(**PUSH, torque_x=constant(1e-9)),)),
    dataclasses.replace(pitch(), loads=(fx.PointLoad(**PUSH, torque=constant(1e-9)),)),
    dataclasses.replace(pitch(), motions=(fx.Motion("root_y", cycloid(1e-6, 0.1)),)),
    dataclasses.replace(flying(), velocity=(0.0, 1e-6, 0.0)),
    dataclasses.replace(turned(), loads=(fx.PointLoad(**PUSH, force_x=constant(1.0), force_y=sine(1.0, 2.0)),)),
    same_in_the_plane(),
])  # fmt: skip
def test_what_leaves_the_plane_is_computed_in_space(scene: fx.Scene) -> None:
    assert in_plane(scene) is None


def test_any_axis_of_a_round_section_will_do() -> None:
    axis = (0.0, 0.6, 0.8)
    for section, found in ((TUBE, True), (FLAT, False)):
        arm = fx.Arm("a", (fx.Link(0.5, section),), hub_axis=axis)
        flat = in_plane(fx.Scene("s", arm, duration=1.0, dt=1e-3))
        assert (flat is not None) is found
