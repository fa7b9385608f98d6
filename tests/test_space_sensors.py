"""Sensors of arms in space against known answers, beside the plane, and in environments."""

import dataclasses
import math
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import flexarm_env as fx
from flexarm_env import arms
from flexarm_env.envs.options import plan
from flexarm_env.envs.space import SPACE
from flexarm_env.rigid import rate_scale
from flexarm_env.runtime.laws import law_of, memory_of
from flexarm_env.runtime.readings import read_rows
from flexarm_env.sensors import Accelerometer, Gyroscope, Sensors, StrainGauge
from flexarm_env.time_functions import constant, ramp, sine
from tests import space_answers as answers
from tests.env_tools import assert_pair_same, pair
from tests.refusals import says
from tests.scene_tools import everything

EXACT, FLOATING = "geometrically_exact", "floating_frame"
THREE = ("xy", "xz", "torsion")


def run(scene: fx.Scene, how: str = EXACT, **options: Any) -> Any:
    return answers.finished(everything(scene), how, **options)


# ------------------------------------------------------------------ strain gauges
@pytest.mark.parametrize(
    ("how", "mesh", "GJ", "most"),
    [(EXACT, {"elements": 8}, 10.0, 1e-6), (EXACT, {"elements": 8}, 6.0, 4e-3),
     pytest.param(FLOATING, {"segments": 16}, 6.0, 1e-2, marks=pytest.mark.slow)],
)
def test_gauges_of_a_helix(how: str, mesh: dict[str, int], GJ: float, most: float) -> None:
    """A moment M at the tip of a round rod, fixed in space: M is the same everywhere, so that in the section's axes its
    part across turns by M_x (1/GJ - 1/EI) over length, from what it is at the root: constant strains where GJ = EI."""
    EI, M = 10.0, np.array([3.0, 4.0, -6.0])
    section = fx.Section(EI=EI, EA=1e7, C=1e7, m=1.0, J=1e-4, EI_y=EI, C_y=1e7, J_y=1e-4, GJ=GJ)
    arm = fx.Arm("rod", (fx.Link(1.0, section),))
    load = fx.PointLoad(0, "tip", torque_x=constant(M[0]), torque_y=constant(M[1]), torque=constant(M[2]))
    scene = fx.Scene("helix", arm, duration=0.002, dt=1e-3, loads=(load,), start="held", space=True)
    places = (0.0, 0.3, 1.0)
    gauges = tuple(StrainGauge(place=place, measures=what) for place in places for what in THREE)
    found = run(scene, how, **mesh).measured(Sensors(strain_gauges=gauges))
    turn = M[0] * (1.0 / GJ - 1.0 / EI)
    for i, place in enumerate(places):
        angle = turn * place
        across = (M[1] + 1j * M[2]) * np.exp(-1j * angle) / EI
        wanted = {"xy": across.imag, "xz": -across.real, "torsion": M[0] / GJ}
        for j, what in enumerate(THREE):
            assert found[f"strain_gauge_{3 * i + j + 1}"][0] == pytest.approx(wanted[what], abs=most), (place, what)


@pytest.mark.slow
def test_strains_are_curvatures_times_distances() -> None:
    """To the surface of either side of a strip; the shear strain needs its distance. A taper's strain is its moment
    over its stiffness there."""
    section = fx.Section.rectangle(0.05, 0.01, 70e9, 2700.0, 26e9)
    push = fx.PointLoad(0, "tip", force_y=constant(1e-3), force_z=constant(2e-3), torque_x=constant(5e-4))
    taper = fx.Taper((0.05, 0.03), (0.012, 0.008), 70e9, 2700.0, 26e9)
    for link, most in ((fx.Link(0.8, section), 1e-5), (fx.Link(0.8, taper), 1e-5)):
        scene = fx.Scene("s", fx.Arm("a", (link,)), duration=0.002, dt=1e-3, loads=(push,), start="held", space=True)
        gauges = [{"place": 0.25, "unit": "strain"}, {"place": 0.25, "unit": "strain", "measures": "xz"},
                  {"place": 0.25, "unit": "strain", "measures": "torsion", "distance": 0.005}]  # fmt: skip
        seen = run(scene, elements=8).measured({"strain_gauges": gauges})
        s = np.array(0.2)
        width, thickness = (0.05, 0.01) if link.uniform else (0.045, 0.011)
        there, across = link.along(s), link.across(s)
        wanted = [1e-3 * 0.6 / there.EI * thickness / 2, 2e-3 * 0.6 / across["EI_y"] * width / 2]
        wanted += [5e-4 / across["GJ"] * 0.005]
        np.testing.assert_allclose([seen[f"strain_gauge_{k}"][0] for k in (1, 2, 3)], wanted, rtol=most)
    assert run(scene, elements=8).strain(0, 0.25)[0] == pytest.approx(float(wanted[0]), rel=most)


# ------------------------------------------------------------------ accelerometer, gyroscope, camera
def specific_force(t: np.ndarray, r: Any, v: Any, A: Rotation, w: Any, gravity: Any) -> np.ndarray:
    """What an accelerometer reads at t (m,) of a tip at r with velocity v, axes A, angular velocity w in them."""
    period, laws = t[1] - t[0], np.array([law_of(Accelerometer(), 1.0, t[1] - t[0])] * 3)
    out, inputs = np.empty((t.size, 3)), np.column_stack([r, A.as_rotvec(), v, w])
    read_rows(
        laws.ravel(), 0, memory_of(3, 0), np.zeros(1, np.uint64), period, np.array(gravity), 0, (0,) * 3, inputs, out
    )
    return out


@pytest.mark.parametrize("period", [0.005, 0.02, 0.05])
@pytest.mark.parametrize("speed", [0.3, 5.0, 20.0])
def test_an_accelerometer_reads_specific_force_in_the_tip_s_own_axes(speed: float, period: float) -> None:
    """Closed forms: a tip spun about an oblique axis, its own axes oblique to that, held or thrown into free fall,
    reads w x (w x r); held under gravity that and the mean of a turning -g. Errors are of fourth order in w T."""
    t, g, axis = period * np.arange(12), np.array([2.0, -3.0, -9.81]), np.array([0.6, 0.0, 0.8])
    r0, A0 = np.array([1.3, -0.4, 0.2]), Rotation.from_rotvec([0.3, -0.8, 0.5])
    turn, omega = Rotation.from_rotvec(np.outer(speed * t, axis)), speed * axis
    A, small = turn * A0, 1e-3 * (speed * period) ** 4 + 1e-10
    r, w = turn.apply(r0), np.tile(A0.inv().apply(omega), (12, 1))
    v = np.cross(omega, r)
    spin = A0.inv().apply(np.cross(omega, np.cross(omega, r0)))
    still = np.zeros(3)
    assert np.abs(specific_force(t, r, v, A, w, still) - spin).max() < 1.5 * speed**2 * small
    fall, rate = np.outer(t, [7.0, -3.0, 1.0]) + 0.5 * np.outer(t**2, g), [7.0, -3.0, 1.0] + np.outer(t, g)
    found = specific_force(t, r + fall, v + rate, A, w, g)
    assert np.abs(found - spin)[1:].max() < 30.0 * (speed**2 + 1.0) * small
    s, weights = np.polynomial.legendre.leggauss(12)
    held = np.zeros((11, 3))
    for x, share in zip(s, weights, strict=True):
        part = Rotation.from_rotvec(np.outer(speed * (t[:-1] + 0.5 * period * (1.0 + x)), axis)) * A0
        held += 0.5 * share * (spin - part.inv().apply(g))
    assert np.abs(specific_force(t, r, v, A, w, g)[1:] - held).max() < 20.0 * (speed**2 + 1.0) * small


@pytest.mark.slow
def test_a_centrifuge_and_free_fall() -> None:
    """A rigid arm that leans out by 30 degrees is spun about the vertical; a free one that tumbles falls."""
    lean, spin, length = math.radians(30.0), 4.0, 0.7
    link = fx.RigidLink(length, 1.0, (0.3, 0.0, 0.0), np.diag([0.01, 0.04, 0.04]))
    pillar = fx.RigidLink(0.0, 1.0, (0.0, 0.0, 0.0), np.diag([0.01, 0.01, 0.01]))
    arm = fx.Arm("c", (pillar, link), elbows=(fx.Elbow(axis=(0.0, 1.0, 0.0)),))
    motions = (fx.Motion("joint0", ramp(spin, 1.0)), fx.Motion("joint1", constant(-lean)))
    scene = fx.Scene(
        "c", arm, duration=0.4, dt=1e-3, sample=0.01, motions=motions, angles=(0.0, -lean), rates=(spin, 0.0),
        gravity=(0.0, 0.0, -9.81),
    )  # fmt: skip
    seen = run(scene).measured({"accelerometer": {}, "gyroscope": {}, "camera": {}})
    out = length * math.cos(lean) * spin**2  # towards the vertical
    wanted = {
        "tip_acceleration_x": -out * math.cos(lean) + 9.81 * math.sin(lean), "tip_acceleration_y": 0.0,
        "tip_acceleration_z": out * math.sin(lean) + 9.81 * math.cos(lean),
        "gyroscope_x": spin * math.sin(lean), "gyroscope_y": 0.0, "gyroscope_z": spin * math.cos(lean),
        "camera_z": length * math.sin(lean), "camera_rise_z": lean,
    }  # fmt: skip
    for name, value in wanted.items():
        np.testing.assert_allclose(seen[name][2:], value, atol=2e-4, err_msg=name)
    t = 0.01 * np.arange(len(seen["camera_x"]))
    np.testing.assert_allclose(seen["camera_y"], length * math.cos(lean) * np.sin(spin * t), atol=1e-8)
    np.testing.assert_allclose(seen["camera_rise_y"], np.arcsin(math.cos(lean) * np.sin(spin * t)), atol=1e-8)
    ball = fx.Arm("ball", (dataclasses.replace(link, centre=(length, 0.0, 0.0)),))
    fall = fx.Scene(
        "f", ball, duration=0.4, dt=1e-3, sample=0.01, root="free", rates=(3.0,), gravity=(0.0, 0.0, -9.81),
        velocity=(0.0, -3.0 * length, 0.0), space=True,
    )  # fmt: skip
    fallen = run(fall, rho_inf=1.0)
    assert fallen.tip[-1, 2] < -0.7
    seen = fallen.measured({"accelerometer": {}, "gyroscope": {}})
    for axis in "xyz":  # its centre is at the tip
        assert np.abs(seen[f"tip_acceleration_{axis}"][1:]).max() < 1e-4
    np.testing.assert_allclose(seen["gyroscope_z"], 3.0, atol=1e-6)


@pytest.mark.slow
def test_a_gyroscope_reads_the_derivative_of_the_rotation() -> None:
    """Of the whipping tip of `three_dof`, by differences of its axes; the accelerometer by those of its velocity."""
    loads = tuple(fx.JointTorque(k, sine(size, 12.0)) for k, size in enumerate((4.0, 2.0, 1.0)))
    scene = fx.Scene(
        "s", arms.named("three_dof"), duration=0.2, dt=2.5e-4, sample=2.5e-4, gravity=(0, 0, -9.81), loads=loads,
        angles=(0.1, 0.7, -0.9), start="held",
    )  # fmt: skip
    found = run(scene, rho_inf=0.8)
    seen = found.measured({"gyroscope": {}, "accelerometer": {}})
    A = Rotation.from_quat(np.roll(found.tip_rotation, -1, axis=1))
    spin = (A[:-2].inv() * A[2:]).as_rotvec() / 5e-4
    gyro = np.column_stack([seen[f"gyroscope_{axis}"] for axis in "xyz"])
    assert np.abs(gyro).max(axis=0).min() > 0.05
    assert np.abs(A[:-2].inv().apply(A[1:-1].apply(gyro[1:-1])) - spin).max() < 5e-3 * np.abs(gyro).max()
    push = np.column_stack([seen[f"tip_acceleration_{axis}"] for axis in "xyz"])[1:]
    slope = np.diff(found.tip_velocity[:, :3], axis=0) / 2.5e-4 - [0.0, 0.0, -9.81]
    middle = A[:-1] * Rotation.from_rotvec(0.5 * (A[:-1].inv() * A[1:]).as_rotvec())
    assert np.abs(push - middle.inv().apply(slope)).max() < 5e-3 * np.abs(push).max()


# ------------------------------------------------------------------ environments
ALL: dict[str, Any] = {
    "encoders": {}, "accelerometer": {}, "gyroscope": {}, "camera": {},
    "strain_gauges": [{"link": 1, "measures": what} for what in THREE] + [{"link": 2, "place": 0.6, "measures": "xz"}],
}  # fmt: skip


@pytest.mark.slow
def test_every_entry_of_a_sensor_is_that_of_a_scene_run_beside() -> None:
    """Torques held for 50 ms; each quantity made here of the recorded motion."""
    arm, action, start = arms.named("three_dof"), np.array([0.1, -0.3, 0.2], np.float32), (0.2, 0.7, -0.4)
    env = gym.make("SpatialFlexArm-v0", elements=2, dt=2e-4, tolerance=1e-9, sensors=ALL, observation="measured")
    env.reset(seed=0, options={"start": start, "target": (0.5, 0.3, 0.6)})
    for _ in range(5):
        seen, *_ = env.step(action)
    plan = env.unwrapped.plan
    seen = dict(zip(plan.names, seen * np.array(plan.scales), strict=True))
    found = answers.beside(env, action, start)
    A = Rotation.from_quat(np.roll(found.tip_rotation, -1, axis=1))
    w = rate_scale(arm, 0)
    assert plan.scales[plan.names.index("tip_acceleration_z")] == pytest.approx(w**2 * arm.total_length)
    wanted = dict(zip(("camera_x", "camera_y", "camera_z"), found.tip[-1], strict=True))
    wanted |= dict(zip(("camera_rise_y", "camera_rise_z"), np.arcsin(A[-1].as_matrix()[1:, 0]), strict=True))
    spin = A[-1].inv().apply(found.tip_velocity[-1, 3:])
    wanted |= {f"gyroscope_{axis}": value for axis, value in zip("xyz", spin, strict=True)}
    # the mean, in the tip's own axes, over the last period
    last = slice(-51, None)
    turned = A[last].inv().apply(found.tip_velocity[last, :3])
    rest = np.cross(A[last].inv().apply(found.tip_velocity[last, 3:]), turned) - A[last].inv().apply([0.0, 0.0, -9.81])
    force = (turned[-1] - turned[0]) / 0.01 + np.trapezoid(rest, dx=2e-4, axis=0) / 0.01
    wanted |= {f"tip_acceleration_{axis}": value for axis, value in zip("xyz", force, strict=True)}
    names = found.names

    def turn(name: str) -> Rotation:
        k = names.index(name)
        return Rotation.from_rotvec(found.q[-1, k : k + 3])

    root = Rotation.from_quat(np.roll(found.link_rotations[-1, :, 0], -1, axis=1))
    bent = [(root[k].inv() * turn(f"link{k}.rx1")).as_rotvec() for k in (1, 2)]
    next_ = [(turn(f"link{k}.rx1").inv() * turn(f"link{k}.rx2")).as_rotvec() for k in (1, 2)]
    at_root = (1.5 * bent[0] - 0.5 * next_[0]) / 0.25
    at_six = (0.3 * bent[1] + 0.7 * next_[1]) / 0.25
    wanted |= {f"strain_gauge_{k + 1}": x for k, x in enumerate((at_root[2], -at_root[1], at_root[0], -at_six[1]))}
    for name, value in wanted.items():
        size = plan.scales[plan.names.index(name)]
        assert abs(seen[name] - value) < 2e-3 * size + 2e-3 * abs(value), (name, seen[name], value)
    assert len(wanted) == 15 and {*wanted} < {*plan.names}


LAWFUL: dict[str, Any] = {
    "encoders": {"counts": 4096, "noise": 1e-4, "delay": 0.013}, "accelerometer": {"noise": 0.1, "bias": 0.2},
    "gyroscope": {"noise": 0.01, "bias": 0.05, "low_pass": {"frequency": 20.0}}, "noise": 0.001, "delay": 0.01,
    "camera": {"period": 0.02, "delay": 0.015, "noise": 1e-3},
    "strain_gauges": [{"link": 1, "measures": what, "gain": (0.98, 1.02), "noise": 0.01} for what in THREE],
}  # fmt: skip


@pytest.mark.slow
def test_a_vector_is_the_single_environment_with_every_sensor() -> None:
    """And a state carries what they remember."""
    keywords: dict[str, Any] = {"observation": "measured", "sensors": LAWFUL, "history": 2, "elements": 1, "dt": 0.005}
    assert_pair_same(pair("SpatialFlexArm-v0", 3, **keywords), 6, scale=0.3, passed=1)


def test_an_arm_s_own_sensors_and_what_is_refused() -> None:
    own = Sensors(gyroscope=Gyroscope(), strain_gauges=(StrainGauge(link=1, measures="torsion"),))
    arm = dataclasses.replace(arms.named("three_dof"), sensors=own)
    names = plan(SPACE, arm=arm, observation="measured").names
    assert {"gyroscope_z", "strain_gauge_1"} <= set(names)
    again = arms.from_toml(arms.to_toml(arm)) if hasattr(arms, "to_toml") else arm
    assert again.sensors == own
    for make, words in (
        (lambda: gym.make("FlexibleArm-v0", sensors={"gyroscope": {}}), "sensors.gyroscope"),
        (lambda: gym.make("FlexibleArm-v0", sensors={"strain_gauges": [{"measures": "xz"}]}), "measures = 'xz'"),
        (lambda: StrainGauge(unit="strain", measures="torsion"), "distance = None"),
        (lambda: StrainGauge(measures="yz"), "measures = 'yz'"),
    ):
        says(words, make)


@pytest.mark.slow
@pytest.mark.parametrize("link", ["curved", "tapered"])
def test_gauges_of_frames_on_curved_and_tapered_links_are_off(link: str) -> None:
    """Moments at the tip bend and twist by M/EI_y and M/GJ anywhere: the figures of the tutorial."""
    steel, moment = {"E": 70e9, "rho": 2700.0, "G": 26e9}, 1e-3
    own = fx.Link(1.0, fx.Section.rectangle(0.03, 0.004, **steel), curvature=1.2)
    if link == "tapered":
        own = fx.Link.tapered(1.0, widths=(0.04, 0.02), thicknesses=(0.006, 0.003), **steel)
    about = dict.fromkeys(("torque", "torque_x", "torque_y"), constant(moment))
    scene = fx.Scene(
        "gauges", fx.Arm(link, (own,), hub_inertia=0.01, tau_d=1e-3), duration=2e-3, dt=1e-3, start="held", space=True,
        motions=(fx.Motion("joint0", constant(0.0)),), loads=(fx.PointLoad(0, "tip", **about),),
    )  # fmt: skip
    off = {"curved": {"xz": (1.449, 0.1), "torsion": (0.041, 0.0105)}, "tapered": {"torsion": (0.171, 0.048)}}[link]
    meshes = [("floating_frame", {"segments": n}) for n in (10, 40)] + [("geometrically_exact", {"elements": 10})]
    for measures, shares in off.items():
        for (formulation, mesh), share in zip(meshes, (*shares, 0.0), strict=True):
            run, errors, sizes = fx.simulate(scene, formulation, estimate_error=False, **mesh), [], []
            for place in (0.0, 0.3, 0.5, 0.7, 0.9, 1.0):
                turn, section = own.turn * place, own.across(np.array(place * own.length))
                bent = -moment * (np.cos(turn) - np.sin(turn)) / section["EI_y"]
                wanted = bent if measures == "xz" else moment * (np.cos(turn) + np.sin(turn)) / section["GJ"]
                gauge = {"strain_gauges": [{"place": place, "measures": measures}]}
                errors.append(abs(run.measured(gauge)["strain_gauge_1"][0] - wanted))
                sizes.append(abs(wanted))
            assert max(errors) / max(sizes) == pytest.approx(share, rel=0.02, abs=0.006), (formulation, mesh)
