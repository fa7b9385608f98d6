"""Sensors against their definitions: noise, bias, gain, quantisation, delay, filters; each alone, then in environments
and over the trajectory of a scene."""

import dataclasses
import math
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from flexarm_env import Arm, Joint, JointTorque, Link, Motion, PointLoad, Scene, Section, arms, sensors, simulate
from flexarm_env.envs.options import plan
from flexarm_env.envs.task import SLEW
from flexarm_env.runtime.laws import law_of, memory_of, room_of
from flexarm_env.runtime.readings import read_rows
from flexarm_env.sensors import Accelerometer, Camera, Encoder, Law, LowPass, Sensors, StrainGauge
from flexarm_env.time_functions import constant, ramp, sine
from tests.env_tools import ONE, assert_goes_back, assert_pair_same, assert_same, episode, pair
from tests.scene_tools import everything

T = 1e-3


def read(law: Law, u: np.ndarray, seed: int = 0, period: float = T) -> np.ndarray:
    """Readings of u (n,), and for an encoder their rates."""
    laws, encoder = law_of(law, 1.0, period)[None], isinstance(law, Encoder)
    out, stream = np.empty((len(u), 2 if encoder else 1)), np.array([seed * 7919 + 1], np.uint64)
    room = room_of(laws)
    none = np.zeros(3)
    read_rows(
        laws.ravel(), room, memory_of(1, room), stream, period, none, int(encoder), None, u[:, None].copy(), out
    )
    return out if encoder else out[:, 0]


# ---------------------------------------------------------------------------------------- a law by itself
def test_an_ideal_sensor_reads_what_is_there(rng: np.random.Generator) -> None:
    u = rng.normal(size=1000)
    assert_same(read(Law(), u), u)


def test_noise_is_white_normal_and_of_the_size_asked_for() -> None:
    found = read(Law(noise=0.3), np.full(40_000, 2.0)) - 2.0
    assert found.std() == pytest.approx(0.3, rel=0.02)
    assert abs(found.mean()) < 4.0 * 0.3 / 200.0
    assert (found**4).mean() / found.var() ** 2 == pytest.approx(3.0, abs=0.15)
    assert all(abs(np.corrcoef(found[k:], found[:-k])[0, 1]) < 0.02 for k in (1, 2, 5))


@pytest.mark.parametrize(
    ("law", "low", "high"),
    [(Law(bias=0.4), 0.6, 1.4), (Law(bias=(0.1, 0.3)), 1.1, 1.3), (Law(gain=(0.8, 1.1)), 0.8, 1.1)],
)
def test_bias_and_gain_are_drawn_once_for_each_episode(law: Law, low: float, high: float) -> None:
    runs = np.array([read(law, np.ones(3), seed) for seed in range(1500)])
    assert np.ptp(runs, axis=1).max() == 0.0
    assert low <= runs.min() < low + 0.01 * (high - low)
    assert high - 0.01 * (high - low) < runs.max() <= high
    assert runs.mean() == pytest.approx(0.5 * (low + high), abs=0.03 * (high - low))
    assert runs[:, 0].std() == pytest.approx((high - low) / math.sqrt(12.0), rel=0.05)


def test_constant_gain_and_bias() -> None:
    assert read(Law(gain=1.5, bias=(0.25, 0.25)), np.array([1.0, -2.0])).tolist() == [1.75, -2.75]


def test_readings_are_whole_quanta(rng: np.random.Generator) -> None:
    u = rng.uniform(-3.0, 3.0, 20_000)
    found = read(Law(quantum=0.02), u)
    assert np.abs(found / 0.02 - np.round(found / 0.02)).max() < 1e-9
    error = found - u
    assert np.abs(error).max() <= 0.01 + 1e-12
    assert error.std() == pytest.approx(0.02 / math.sqrt(12.0), rel=0.02)
    turns = read(Encoder(counts=4096), u)[:, 0] * 4096 / (2.0 * math.pi)
    assert np.abs(turns - np.round(turns)).max() < 1e-9
    assert np.abs(turns / 4096 * 2.0 * math.pi - u).max() <= math.pi / 4096 + 1e-12


@pytest.mark.parametrize("delay", [0.0, 1e-3, 7e-3, 2.4e-3, 0.25e-3])
def test_delay_is_exact_for_what_runs_straight(delay: float) -> None:
    t = T * np.arange(60)
    slope, start = 3.0, 0.5
    expected = start + slope * np.maximum(t - delay, 0.0)
    np.testing.assert_allclose(read(Law(delay=delay), start + slope * t), expected, atol=1e-12)
    wave = read(Law(delay=delay), np.sin(30.0 * t))
    np.testing.assert_allclose(wave[10:], np.sin(30.0 * (t - delay))[10:], atol=30.0**2 * T**2 / 8.0)


def response(found: np.ndarray, t: np.ndarray, w: float) -> complex:
    """Amplitude and phase of the reading of sin(w t), from whole periods after the start has died away."""
    basis = np.column_stack([np.sin(w * t), np.cos(w * t)])
    a, b = np.linalg.lstsq(basis, found, rcond=None)[0]
    return complex(a, b)


@pytest.mark.parametrize("frequency", [2.0, 9.0])
@pytest.mark.parametrize(
    "low_pass", [LowPass(5.0), LowPass(5.0, order=2, damping=0.4), LowPass(2.0, order=2, damping=0.9)]
)
def test_amplitude_and_phase_of_a_filter(low_pass: LowPass, frequency: float) -> None:
    w, w0 = 2.0 * math.pi * frequency, 2.0 * math.pi * low_pass.frequency
    t = T * np.arange(6000)
    found = response(read(Law(low_pass=low_pass), np.sin(w * t))[3000:], t[3000:], w)
    s = 1j * w
    exact = w0 / (s + w0) if low_pass.order == 1 else w0**2 / (s**2 + 2.0 * low_pass.damping * w0 * s + w0**2)
    assert abs(found) == pytest.approx(abs(exact), rel=1e-3)
    assert np.angle(found) == pytest.approx(np.angle(exact), abs=1e-3)


def test_a_filter_is_exact_between_coarse_instants() -> None:
    """Of a ramp from rest, y = t - (1 - exp(-w t)) / w, whatever the period; and it begins at rest."""
    w = 2.0 * math.pi * 5.0
    t = 0.05 * np.arange(20)
    y = read(Law(low_pass=LowPass(5.0)), t, period=0.05)
    np.testing.assert_allclose(y, t - (1.0 - np.exp(-w * t)) / w, atol=1e-12)
    for order in (1, 2):
        assert np.ptp(read(Law(low_pass=LowPass(5.0, order=order)), np.full(50, 1.7))) < 1e-12


@pytest.mark.parametrize("delay", [0.02, 0.05, 0.0625, 0.11])
def test_a_filter_is_exact_when_it_comes_late(delay: float) -> None:
    """Of a ramp from rest, as above, a delay that is no whole number of periods included; of order 2 with damping 1
    y = t - 2 / w + exp(-w t) (t + 2 / w)."""
    w, period = 2.0 * math.pi * 5.0, 0.05
    t = period * np.arange(20)
    past = np.maximum(t - delay, 0.0)
    expected = {
        1: past - (1.0 - np.exp(-w * past)) / w,
        2: past - 2.0 / w + np.exp(-w * past) * (past + 2.0 / w),
    }
    for order, y in expected.items():
        found = read(Law(low_pass=LowPass(5.0, order=order, damping=1.0), delay=delay), t, period=period)
        np.testing.assert_allclose(found, y, atol=1e-12)


@pytest.mark.parametrize("frequency", [2.0, 9.0])
def test_a_rate_is_the_filtered_difference(frequency: float) -> None:
    w, period = 2.0 * math.pi * frequency, 0.01
    t = period * np.arange(2000)
    found = response(read(Encoder(rate_frequency=8.0), np.sin(w * t), period=period)[1000:, 1], t[1000:], w)
    a, z = math.exp(-2.0 * math.pi * 8.0 * period), np.exp(1j * w * period)
    assert found == pytest.approx((1.0 - a) * (1.0 - 1.0 / z) / period / (1.0 - a / z), rel=1e-9)
    ramped = read(Encoder(), 0.3 + 2.0 * t, period=period)[:, 1]
    assert ramped[0] == 0.0
    assert ramped[-1] == pytest.approx(2.0)


def test_a_camera_shows_pictures() -> None:
    t = T * np.arange(50)
    found = read(Camera(period=8e-3, delay=3e-3), t)
    np.testing.assert_allclose(found, np.maximum(t[np.arange(50) // 8 * 8] - 3e-3, 0.0), atol=1e-12)
    noisy = read(Camera(period=8e-3, noise=0.1), t)
    assert np.ptp(noisy[:48].reshape(6, 8), axis=1).max() == 0.0
    assert len(set(noisy.tolist())) == 7


def test_what_is_read_is_filtered_then_late_then_noisy_then_rounded() -> None:
    u = np.cumsum(np.random.default_rng(0).normal(size=500)) * 0.01
    clean = read(Law(low_pass=LowPass(20.0), delay=4e-3), u)
    found = read(Law(low_pass=LowPass(20.0), delay=4e-3, gain=2.0, noise=0.05, quantum=1e-6), u)
    assert (found - 2.0 * clean).std() == pytest.approx(0.05, rel=0.1)


# ---------------------------------------------------------------------------------------- scenes
STRIP = Section.rectangle(0.03, 0.004, 70e9, 2700.0, 26e9)
LOADED = Arm("loaded", (Link(0.5, STRIP), Link(0.5, STRIP)), tau_d=0.05)


@pytest.mark.parametrize(
    ("formulation", "options"),
    [
        ("elastica", {"nodes": 5}),
        pytest.param("geometrically_exact", {"elements": 4}, marks=pytest.mark.slow),
        pytest.param("floating_frame", {"segments": 8}, marks=pytest.mark.slow),
    ],
)
def test_strain_of_a_loaded_cantilever(formulation: str, options: dict[str, Any]) -> None:
    """EI kappa = F (L - x); strain at the surface of a strip 4 mm thick: 2 mm kappa."""
    held = tuple(Motion(f"joint{k}", constant(0.0)) for k in range(2))
    load = PointLoad(1, "tip", force_y=ramp(0.5, 1.0))
    scene = Scene("loaded", LOADED, duration=4.0, dt=0.01, sample=0.1, motions=held, loads=(load,))
    run = simulate(everything(scene), formulation, estimate_error=False, **options)
    for link, place in ((0, 0.4), (1, 0.0), (1, 0.5)):
        arm_left = 1.0 - 0.5 * (link + place)
        expected = 0.002 * 0.5 * arm_left / STRIP.EI
        coarse = 0.08 if formulation == "floating_frame" else 0.01
        assert run.strain(link, place)[-1] == pytest.approx(expected, rel=coarse)
        assert_same(run.strain(link, place, 0.004), 2.0 * run.strain(link, place))


def test_a_scene_is_measured() -> None:
    """By hand from the trajectory's own arrays."""
    motion = (Motion("joint0", ramp(1.2, 1.0)),)
    arm = Arm("swung", (Link(0.5, STRIP),), tau_d=0.01)
    scene = everything(Scene("swung", arm, duration=2.0, dt=0.005, sample=0.01, motions=motion, gravity=(0.0, -9.81)))
    run = simulate(scene, "elastica", nodes=4, estimate_error=False)
    seen = run.measured()
    assert list(seen) == ["hub_angle", "hub_rate", "strain_gauge_1"]
    assert_same(seen["hub_angle"], run.joint_angles[:, 0])
    np.testing.assert_allclose(seen["strain_gauge_1"] * 0.002, run.strain(0, 0.0), rtol=1e-12)
    own = {
        "encoders": {"counts": 1000}, "accelerometer": {}, "camera": {"period": 0.04, "delay": 0.02},
        "strain_gauges": [{"place": 0.5, "unit": "strain", "delay": 0.03}],
    }  # fmt: skip
    seen = run.measured(own)
    np.testing.assert_allclose(seen["hub_angle"], run.joint_angles[:, 0], atol=math.pi / 1000 + 1e-12)
    u = (run.tip_velocity[0, 0] + 1j * run.tip_velocity[0, 1]) * np.exp(-1j * run.tip[0, 2])
    first = 1j * run.tip_velocity[0, 2] * u + 9.81j * np.exp(-1j * run.tip[0, 2])
    assert seen["tip_acceleration_x"][0] + 1j * seen["tip_acceleration_y"][0] == pytest.approx(first)
    taken = np.maximum(np.arange(len(run.t)) // 4 * 4 - 2, 0)
    np.testing.assert_allclose(np.column_stack([seen["camera_x"], seen["camera_y"]]), run.tip[taken, :2], atol=1e-12)
    late = np.maximum(np.arange(len(run.t)) - 3, 0)
    np.testing.assert_allclose(seen["strain_gauge_1"], run.strain(0, 0.5)[late], atol=1e-15)
    noisy = {"encoders": {"noise": 0.01}}
    assert_same(run.measured(noisy, seed=1), run.measured(noisy, seed=1))
    assert not np.array_equal(run.measured(noisy, seed=1)["hub_angle"], run.measured(noisy, seed=2)["hub_angle"])
    with pytest.raises(ValueError, match="even distances"):
        simulate(dataclasses.replace(scene, sample=0.03), "elastica", nodes=4, estimate_error=False).measured()


def specific_force(t: np.ndarray, r: Any, v: Any, psi: Any, w: Any, gravity: complex) -> np.ndarray:
    """What an accelerometer reads at t (m,) of a tip at r, with velocity v (complex), angle psi and rate w."""
    period, laws = t[1] - t[0], np.array([law_of(Accelerometer(), 1.0, t[1] - t[0])] * 2)
    out, inputs = np.empty((t.size, 2)), np.column_stack([r.real, r.imag, psi, v.real, v.imag, w])
    stream = np.zeros(1, np.uint64)
    along = np.array([gravity.real, gravity.imag, 0.0])
    read_rows(laws.ravel(), 0, memory_of(2, 0), stream, period, along, 0, (0,) * 2, inputs, out)
    return out[:, 0] + 1j * out[:, 1]


@pytest.mark.parametrize("period", [0.005, 0.02, 0.05])
@pytest.mark.parametrize("w", [0.3, 5.0, -5.0, 20.0])
def test_an_accelerometer_reads_specific_force_in_the_tip_s_own_axes(w: float, period: float) -> None:
    """Closed forms: a spin, held or thrown into free fall, reads -w^2 r; one held under gravity that and the mean of a
    turning -g; rest -g. Errors are of fourth order in w T."""
    t, g, r0 = period * np.arange(12), 2.0 - 9.81j, 1.3
    psi, small = w * t + 0.3, 1e-3 * (w * period) ** 4 + 1e-11
    r, rates = r0 * np.exp(1j * psi), np.full(12, w)
    spin, x = -(w**2) * r0, 0.5 * w * period
    assert np.abs(specific_force(t, r, 1j * w * r, psi, rates, 0j) - spin).max() < w**2 * small
    thrown, velocity = r + (7.0 - 3.0j) * t + 0.5 * g * t**2, 1j * w * r + 7.0 - 3.0j + g * t
    assert np.abs(specific_force(t, thrown, velocity, psi, rates, g) - spin)[1:].max() < 30.0 * (w**2 + 1.0) * small
    held = spin - g * np.exp(-1j * (psi - x)) * np.sin(x) / x
    assert np.abs(specific_force(t, r, 1j * w * r, psi, rates, g) - held)[1:].max() < 20.0 * small
    rest = specific_force(t, r0 + 0.0 * r, 0.0 * r, 0.0 * t + 0.3, 0.0 * t, g)
    np.testing.assert_allclose(rest, np.full(12, -g * np.exp(-0.3j)), rtol=1e-12)


@pytest.mark.parametrize(
    ("formulation", "options"),
    [
        ("elastica", {"nodes": 5}), ("floating_frame", {"segments": 2}),
        ("geometrically_exact", {"elements": 4}),
    ],
)  # fmt: skip
def test_a_swinging_tip_s_specific_force(formulation: str, options: dict[str, Any]) -> None:
    """Against the mean, over each window of 10 ms, of 16 samples in it: u' + i w u - g e^(-i psi), u = v e^(-i psi)."""
    section = Section(EI=20.0, EA=1e6, C=3e5, m=0.3, J=1e-5)
    loads = (JointTorque(0, sine(6.0, 9.0)),)
    arm = Arm("swung", (Link(0.8, section),), hub_inertia=0.02, tau_d=0.01)
    scene = everything(Scene("swung", arm, duration=0.6, dt=0.01 / 16, loads=loads, gravity=(0.0, -9.81)))
    runs = [
        simulate(dataclasses.replace(scene, sample=sample), formulation, estimate_error=False, **options)
        for sample in (0.01, scene.dt)
    ]
    seen, fine = runs[0].measured({"accelerometer": {}}), runs[1]
    turned, w = np.exp(-1j * fine.tip[:, 2]), fine.tip_velocity[:, 2]
    u = (fine.tip_velocity[:, 0] + 1j * fine.tip_velocity[:, 1]) * turned
    rest = 1j * w * u + 9.81j * turned
    parts = np.stack([rest[k : k - 16 or None : 16][: len(runs[0].t) - 1] for k in range(17)])
    weights = np.array([1.0, *[4.0, 2.0] * 7, 4.0, 1.0]) / 48.0  # Simpson's rule
    wanted = np.diff(u[::16]) / 0.01 + weights @ parts
    found = (seen["tip_acceleration_x"] + 1j * seen["tip_acceleration_y"])[1:]
    assert np.abs(wanted).max() > 20.0
    assert np.abs(found - wanted).max() < 2e-3 * np.abs(wanted).max()


# ---------------------------------------------------------------------------------------- environments
LAWFUL: dict[str, Any] = {
    "encoders": {"counts": 4096, "noise": 1e-4, "delay": 0.013}, "accelerometer": {"noise": 0.1, "bias": 0.2},
    "camera": {"period": 0.1, "delay": 0.05, "noise": 1e-3},
    "strain_gauges": [
        {"gain": (0.98, 1.02), "noise": 0.01, "low_pass": {"frequency": 4.0, "order": 2, "damping": 0.9}},
    ],
}  # fmt: skip
ALL = {"observation": "measured", "history": 2, "sensors": LAWFUL, "gravity": (0.0, 0.0)}


@pytest.mark.slow
def test_vector_is_the_single_environment_with_every_sensor() -> None:
    assert assert_pair_same(pair(ONE, 4, max_episode_steps=9, **ALL), 30) >= 8


@pytest.mark.slow
def test_an_environment_reads_by_the_laws_of_a_scene() -> None:
    """The same motion, measured by both; without chance."""
    quiet = {
        "encoders": {"counts": 500, "delay": 0.013}, "accelerometer": {"low_pass": {"frequency": 8.0}},
        "camera": {"period": 0.1, "delay": 0.05},
        "strain_gauges": [{"place": 0.2, "unit": "strain", "gain": 1.1, "low_pass": {"frequency": 4.0, "order": 2}}],
    }  # fmt: skip
    env = gym.make(ONE, observation="measured", history=2, sensors=quiet, gravity=(0.0, -9.81), rho_inf=0.8)
    own = env.unwrapped.plan
    observation, _ = env.reset(seed=0, options={"motion": "robot_arm_motion_smooth"})
    seen = [observation]
    for _ in range(80):
        seen.append(env.step(np.zeros(1, np.float32))[0])
    found = dict(zip(own.names, (np.array(seen)[:, -len(own.names) :] * own.scales).T, strict=True))
    guide = env.unwrapped.guide
    run = simulate(guide.scene, guide.settings.formulation, **guide.settings.options(), estimate_error=False)
    expected = run.measured(quiet)
    for name in ("hub_rate", "tip_acceleration_x", "tip_acceleration_y", "camera_x", "camera_y", "strain_gauge_1"):
        size = np.abs(expected[name]).max()
        np.testing.assert_allclose(found[name], expected[name][:81], atol=2e-6 * size, err_msg=name)
    np.testing.assert_allclose(found["hub_sin"], np.sin(expected["hub_angle"][:81]), atol=1e-6)


@pytest.mark.slow
def test_states_hold_what_sensors_remember() -> None:
    env = gym.make(ONE, **ALL)
    episode(env, 0, 6)
    assert_goes_back(env)


def test_full_shows_encoders_and_further_sensors_where_they_are_asked_for() -> None:
    env = gym.make(ONE, sensors={"encoders": {"counts": 100}, "camera": {}})
    names = env.unwrapped.plan.names
    assert names[5:] == ("target_error", "camera_x", "camera_y")
    observation, info = env.reset(seed=3)
    hub = math.atan2(observation[0], observation[1])
    assert hub / (2.0 * math.pi / 100) == pytest.approx(round(hub / (2.0 * math.pi / 100)), abs=1e-4)
    assert observation[6:] == pytest.approx(info["tip_position"], abs=1e-6)


GEARED = dataclasses.replace(
    arms.named("strip"), joints=(Joint(stiffness=60.0, motor_inertia=2e-5, gear_ratio=30.0),)
)  # fmt: skip
THERE = {"encoders": {"side": "motor"}}
MOTORS: dict[str, Any] = {"arm": GEARED, "observation": "measured", "sensors": THERE, "info_level": "full"}


@pytest.mark.slow
def test_vector_is_the_single_environment_with_encoders_on_motors() -> None:
    assert assert_pair_same(pair(ONE, 3, max_episode_steps=12, **MOTORS), 26) >= 3


def test_counts_on_the_motor_s_side_are_those_of_the_rotor() -> None:
    assert Encoder(counts=4096, side="motor").behind(30.0).step == pytest.approx(2.0 * math.pi / 4096 / 30.0)
    assert Encoder(counts=4096).behind(30.0).step == pytest.approx(2.0 * math.pi / 4096)


@pytest.mark.slow
def test_an_encoder_on_the_motor_s_side_sees_the_gear_give() -> None:
    """Under the task, under a motion, and over a scene."""
    env = gym.make(ONE, **MOTORS)
    env.reset(seed=2)
    apart = 0.0
    for _ in range(10):
        observation, *_, info = env.step(np.ones(1, np.float32))
        turned = info["motor_angle"][0]
        assert observation[:2] == pytest.approx([math.sin(turned), math.cos(turned)], abs=1e-6)
        assert observation[3] == pytest.approx(info["target"] - turned, abs=1e-5)
        apart = max(apart, abs(turned - env.unwrapped.batch.view(0).poses[0, 2]))
    assert apart > 0.01
    env.reset(seed=0, options={"motion": "robot_arm_motion_smooth"})
    for _ in range(60):
        observation, *_, info = env.step(np.zeros(1, np.float32))
    guide = env.unwrapped.guide
    turned, held = info["motor_angle"][0], env.unwrapped.batch.poses(0)[0, 2]
    assert abs(turned - held) > 1e-4
    assert observation[0] == pytest.approx(math.sin(turned), abs=1e-6)
    run = simulate(guide.scene, "elastica", **guide.settings.options(), estimate_error=False)
    assert_same(run.measured(THERE)["hub_angle"], run.motor_angles[:, 0])


# ---------------------------------------------------------------------------------------- an arm's own
def test_an_arm_s_own_sensors_in_toml_and_in_an_environment() -> None:
    own = Sensors(
        (Encoder(counts=4096, rate_frequency=30.0),),
        (StrainGauge(place=0.1, noise=0.01, low_pass=LowPass(20.0, 2, 0.9)), StrainGauge(place=0.5, gain=(0.9, 1.1))),
        Accelerometer(bias=0.1), Camera(period=0.1),
    )  # fmt: skip
    arm = dataclasses.replace(arms.named("strip"), sensors=own)
    assert arms.from_toml(arms.to_toml(arm)) == arm
    assert hash(arm) == hash(arms.from_toml(arms.to_toml(arm)))
    assert plan(SLEW, arm=arm).names == plan(SLEW).names
    measured = plan(SLEW, arm=arm, observation="measured").names
    further = ("tip_acceleration_x", "tip_acceleration_y", "camera_x", "camera_y", "strain_gauge_1", "strain_gauge_2")
    assert measured == ("hub_sin", "hub_cos", "hub_rate", "hub_error", *further)
    fewer = plan(SLEW, arm=arm, observation="measured", sensors={"strain_gauges": [0.0]}).names
    assert fewer == measured[:-1]
    text = (
        arms.to_toml(arms.named("strip")) + "[sensors]\nencoders = {counts = 4096}\nstrain_gauges = [0.0, [0, 0.5]]\n"
    )
    read_back = arms.from_toml(text).sensors
    assert read_back == Sensors((Encoder(counts=4096),), (StrainGauge(), StrainGauge(place=0.5)))
    assert sensors.from_table(sensors.to_table(own)) == own


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"encoder": {}}, r"sensors\.encoder.*encoders"),
        ({"encoders": {"count": 3}}, r"sensors\.encoders\.count.*counts"),
        ({"encoders": [{}, {}]}, r"sensors\.encoders = '2 encoders': must be one, or 1"),
        ({"encoders": {"side": "gear"}}, r"sensors\.encoders\.side = 'gear': must be one of \"link\", \"motor\""),
        ({"encoders": {"counts": 0}}, r"sensors\.encoders\.counts = 0"),
        ({"encoders": {"counts": 8, "quantum": 0.1}}, r"sensors\.encoders\.quantum = 0\.1: must not be given together"),
        ({"encoders": {"delay": 30.0}}, r"sensors\.encoders\[0\]\.delay = 30\.0: must be at most 1000 periods"),
        ({"encoders": {"bias": 1e30}}, r"sensors\.encoders\.bias = 1e\+30: must be .* at most 1e\+15"),
        ({"encoders": {"gain": (1.0, 1e30)}}, r"sensors\.encoders\.gain\[1\] = 1e\+30: must be .* at most 1e\+15"),
        ({"strain_gauges": [{"quantum": 1e-30}]}, r"strain_gauges\[0\]\.quantum = 1e-30: must be 0, or at least 1e-12"),
        ({"strain_gauges": [{"link": 1}]}, r"sensors\.strain_gauges\[0\]\.link = 1"),
        ({"strain_gauges": [2.0]}, r"sensors\.strain_gauges\[0\] = 2\.0"),
        ({"strain_gauges": [{"unit": "volt"}]}, r"sensors\.strain_gauges\[0\]\.unit = 'volt'"),
        ({"strain_gauges": [{"gain": (1.1, 0.9)}]}, r"sensors\.strain_gauges\[0\]\.gain = \(1\.1, 0\.9\)"),
        ({"accelerometer": {"noise": -1.0}}, r"sensors\.accelerometer\.noise = -1\.0"),
        ({"accelerometer": {"low_pass": {"order": 2}}}, r"sensors\.accelerometer\.low_pass\.frequency"),
        ({"accelerometer": {"low_pass": {"frequency": 3, "order": 3}}}, r"accelerometer\.low_pass\.order = 3"),
        ({"camera": {"period": 0.03}}, r"sensors\.camera\.period = 0\.03: must be a whole number of periods"),
        ({"camera": {"bias": "much"}}, r"sensors\.camera\.bias = 'much'"),
    ],
)
def test_errors_name_the_key(table: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        gym.make(ONE, sensors=table)


def test_a_strain_needs_a_thickness() -> None:
    flat = Arm("flat", (Link(1.0, Section(1.0, 1e6, 1e6, 0.2)),), torque_limits=(1.0,))
    with pytest.raises(ValueError, match=r"sensors\.strain_gauges\[0\]\.distance = None: must be given"):
        gym.make(ONE, arm=flat, sensors={"strain_gauges": [{"unit": "strain"}]})
