"""Sensors, motors, controllers, moving targets, randomised arms: each against what it is meant to be."""

from __future__ import annotations

import math
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from flexarm_env import arms
from tests.env_tools import assert_same, episode


def run(env: Any, actions: np.ndarray, seed: int = 0, **options: Any) -> list[Any]:
    """Outcomes of given actions (n, joints)."""
    env.reset(seed=seed, options=options or None)
    return [env.step(a.astype(np.float32)) for a in actions]


def column(outcomes: list[Any], key: str) -> np.ndarray:
    return np.array([o[-1][key] for o in outcomes])


START = {"start": 0.2, "target": 0.9}


# ---------------------------------------------------------------------------------------- controllers
def test_residual_pd_is_the_documented_controller() -> None:
    env = gym.make("FlexibleArm-v0", action_mode="residual_pd")
    limit = 2.0
    stiffness = limit / (math.pi / 4)
    damping = 2.0 * math.sqrt(stiffness * 0.342340270011394)
    env.reset(seed=0, options=START)
    rng = np.random.default_rng(0)
    for _ in range(60):
        pose = env.unwrapped.batch.view(0).poses[0]
        action = rng.uniform(-1, 1, 1).astype(np.float32)
        info = env.step(action)[-1]
        torque = stiffness * (0.9 - pose[2]) - damping * pose[5] + 0.7 * limit * float(action[0])
        assert info["hub_torque"] == pytest.approx(min(limit, max(-limit, torque)), abs=1e-9)


@pytest.mark.parametrize("env_id", ["FlexibleArm-v0", "TwoLinkFlexArm-v0"])
def test_residual_pd_without_an_agent_comes_near_the_target(env_id: str) -> None:
    env = gym.make_vec(env_id, num_envs=64, action_mode="residual_pd", max_episode_steps=400, duration=8.0)
    env.reset(seed=0)
    first = None
    for _ in range(399):
        *_, infos = env.step(np.zeros(env.action_space.shape, np.float32))
        first = infos if first is None else first
    gaps = infos["target"] - infos["tip_position"] if env_id.startswith("Two") else None
    if gaps is None:
        bearing = np.arctan2(infos["tip_position"][:, 1], infos["tip_position"][:, 0])
        gaps = (infos["target"] - bearing + math.pi) % (2 * math.pi) - math.pi
        error = np.abs(gaps)
    else:
        error = np.hypot(*gaps.T)
    assert np.median(error) < 0.05
    assert not np.isnan(error).any()


# ---------------------------------------------------------------------------------------- motors
def test_an_ideal_actuator_is_no_actuator() -> None:
    env = gym.make("FlexibleArm-v0", actuator={"lag": 0.0, "delay": 0.0, "viscous": 0.0})
    assert env.unwrapped.plan.extras.actuator is None


def test_lag_is_first_order() -> None:
    lag, period = 0.03, 0.02
    env = gym.make("FlexibleArm-v0", actuator={"lag": lag})
    torques = column(run(env, np.ones((20, 1)), **START), "hub_torque")
    t = period * np.arange(1, 21)
    np.testing.assert_allclose(torques, 2.0 * (1.0 - np.exp(-t / lag)), rtol=1e-12)


@pytest.mark.parametrize("delay", [0.04, 0.0225, 0.0025])
def test_delay_holds_commands_back(delay: float) -> None:
    """With a lag one solver's step long, the torque at the period's end tells how long the command has been there."""
    env = gym.make("FlexibleArm-v0", actuator={"delay": delay, "lag": 0.05})
    actions = np.zeros((8, 1))
    actions[2:] = 1.0
    torques = column(run(env, actions, **START), "hub_torque")
    t = 0.02 * np.arange(1, 9) - 0.04 - delay
    np.testing.assert_allclose(torques, 2.0 * (1.0 - np.exp(-np.maximum(t, 0.0) / 0.05)), rtol=1e-9, atol=1e-15)


def test_saturation_limits_the_motor() -> None:
    env = gym.make("FlexibleArm-v0", actuator={"saturation": 0.4})
    assert column(run(env, np.ones((3, 1)), **START), "hub_torque") == pytest.approx([0.8] * 3)


def test_delay_alone_is_the_same_arm_later() -> None:
    plain, late = gym.make("FlexibleArm-v0"), gym.make("FlexibleArm-v0", actuator={"delay": 0.04})
    actions = np.random.default_rng(0).uniform(-1, 1, (20, 1))
    one = run(plain, actions, **START)
    other = run(late, np.concatenate([actions, np.zeros((2, 1))]), **START)
    for a, b in zip(one, other[2:], strict=True):
        np.testing.assert_allclose(a[0], b[0], atol=2e-6)


def test_viscous_friction_stops_the_arm_and_its_loss_is_booked() -> None:
    env = gym.make("FlexibleArm-v0", actuator={"viscous": 0.3, "coulomb": 0.05}, info_level="full", duration=8.0)
    actions = np.zeros((400, 1))
    actions[:20] = 1.0
    outcomes = run(env, actions, **START)
    energy = sum(column(outcomes, f"energy_{k}") for k in ("kinetic", "strain", "gravity"))
    work, lost = column(outcomes, "work"), column(outcomes, "energy_dissipated")
    assert np.all(np.diff(lost) > -1e-6)
    assert energy[-1] < 0.01 * energy.max()
    np.testing.assert_allclose(energy + lost, work, atol=0.01 * work.max())
    assert work[-1] == pytest.approx(work[20], abs=1e-9)


def test_coulomb_friction_holds_against_a_small_torque() -> None:
    env = gym.make("FlexibleArm-v0", actuator={"coulomb": 0.2, "coulomb_rate": 0.02})
    turned = [abs(run(env, np.full((100, 1), a), **START)[-1][0][2]) for a in (0.05, 0.5)]
    assert turned[0] < 0.01  # creeps
    assert turned[1] > 0.3


# ---------------------------------------------------------------------------------------- sensors
def test_noise_has_the_size_asked_for_and_follows_the_seed() -> None:
    env = gym.make("FlexibleArm-v0", sensors={"noise": {"tip_deflection": 0.002, "hub_rate": 0.1}}, duration=40.0)
    plain = gym.make("FlexibleArm-v0", duration=40.0)
    actions = np.zeros((2000, 1))
    noisy = np.array([o[0] for o in run(env, actions, **START)])
    clean = np.array([o[0] for o in run(plain, actions, **START)])
    scales = np.array(env.unwrapped.plan.scales)
    sizes = (noisy - clean).std(axis=0) * scales
    np.testing.assert_allclose(sizes[[2, 3]], [0.1, 0.002], rtol=0.1)
    assert np.all(sizes[[0, 1, 4, 5]] == 0.0)
    assert abs((noisy - clean)[:, 3].mean()) < 0.1 * (noisy - clean)[:, 3].std()
    assert_same(noisy, np.array([o[0] for o in run(env, actions, **START)]))
    assert not np.array_equal(noisy, np.array([o[0] for o in run(env, actions, seed=1, **START)]))
    assert env.observation_space.high[0] == 1.0 or env.observation_space.contains(noisy[0])


def test_sensor_delay_shows_the_past() -> None:
    plain, late = gym.make("FlexibleArm-v0"), gym.make("FlexibleArm-v0", sensors={"delay": 0.06})
    actions = np.random.default_rng(0).uniform(-1, 1, (20, 1))
    first = plain.reset(seed=0, options=START)[0]
    one, other = run(plain, actions, **START), run(late, actions, **START)
    for k in range(20):
        assert_same(other[k][0], one[k - 3][0] if k >= 3 else first)
        assert_same(other[k][-1], one[k][-1])


@pytest.mark.parametrize(
    "options",
    [
        {"nodes": 6},
        {"formulation": "geometrically_exact", "elements": 6, "order": 3},
        {"formulation": "floating_frame", "segments": 8},
        {"formulation": "floating_frame", "modes": 3},
    ],
    ids=["elastica", "exact", "segments", "modes"],
)
def test_strain_gauges_read_the_curvature(options: dict[str, Any]) -> None:
    """In free motion, compared with the elastica of eight nodes."""
    places = [0.0, 0.3, 0.7]
    actions = np.sin(np.arange(40)[:, None] * 0.3) * 0.3
    reference = gym.make("FlexibleArm-v0", nodes=8, sensors={"strain_gauges": places})
    env = gym.make("FlexibleArm-v0", sensors={"strain_gauges": places}, **options)
    assert env.observation_space.shape == (9,)
    a = np.array([o[0][6:] for o in run(reference, actions, **START)])
    b = np.array([o[0][6:] for o in run(env, actions, **START)])
    size = np.abs(a).max(axis=0)
    places_good = slice(1, 3) if "segments" in options else slice(0, 3)  # at the root a segment's mean lags behind
    np.testing.assert_allclose((b / size)[:, places_good], (a / size)[:, places_good], atol=0.08)


def test_a_gauge_on_a_bent_cantilever() -> None:
    """At rest under gravity, sideways, the hub held by a motion: EI kappa = moment of the weight beyond the gauge."""
    g = 0.3
    gauges = {"strain_gauges": [0.0, 0.5]}
    env = gym.make("FlexibleArm-v0", gravity=(0.0, -g), sensors=gauges, duration=60.0, arm=_damped())
    env.reset(seed=0, options={"motion": [[0.0, 0.0], [30.0, 0.0]], "interpolation": "linear"})
    for _ in range(1500):
        observation = env.step(np.zeros(1, np.float32))[0]
    arm = arms.named("strip")
    link, section = arm.links[0], arm.links[0].section
    moments = [-g * (section.m * (1 - s) ** 2 / 2 + arm.payload.mass * (1 - s)) * link.length for s in (0.0, 0.5)]
    scale = 2.0 / section.EI
    np.testing.assert_allclose(observation[6:] * scale, np.array(moments) / section.EI, rtol=0.01)


def _damped() -> Any:
    import dataclasses

    return dataclasses.replace(arms.named("strip"), tau_d=0.1)


# ---------------------------------------------------------------------------------------- moving targets
def test_a_drawn_path_starts_at_rest_where_the_arm_is() -> None:
    env = gym.make("FlexibleArm-v0", task="track")
    observation, info = env.reset(seed=0)
    assert observation.shape == (9,)
    assert observation[5] == pytest.approx(0.0, abs=1e-6)
    assert observation[6] == 0.0
    targets = [info["target"]]
    ahead = [observation[7:9]]
    for _ in range(100):
        observation, *_, info = env.step(np.zeros(1, np.float32))
        targets.append(info["target"])
        ahead.append(observation[7:9])
        assert observation[6] * env.unwrapped.plan.scales[2] == pytest.approx(
            (targets[-1] - targets[-2]) / 0.02, abs=0.05
        )
    for k in range(80):
        assert ahead[k][0] == pytest.approx(targets[k + 5] - targets[k], abs=1e-5)
        assert ahead[k][1] == pytest.approx(targets[k + 15] - targets[k], abs=1e-5)


def test_a_given_path_is_followed() -> None:
    t = np.linspace(0, 8, 81)
    table = np.column_stack([t, 0.5 + 0.1 * np.cos(t), 0.2 * np.sin(t)])
    env = gym.make("TwoLinkFlexArm-v0", task="track", reference=table)
    observation, info = env.reset(seed=0)
    assert observation.shape == (20,)
    for k in range(1, 100):
        info = env.step(np.zeros(2, np.float32))[-1]
        wanted = (0.5 + 0.1 * math.cos(0.02 * k), 0.2 * math.sin(0.02 * k))
        np.testing.assert_allclose(info["target"], wanted, atol=1e-5)


def test_the_controller_follows_a_moving_target() -> None:
    env = gym.make("FlexibleArm-v0", task="track", action_mode="residual_pd")
    errors = [abs(o[0][5]) for o in episode_at_rest(env)]
    assert max(errors) < 0.5


def episode_at_rest(env: Any) -> list[Any]:
    env.reset(seed=2)
    return [env.step(np.zeros(env.action_space.shape, np.float32)) for _ in range(150)]


# ---------------------------------------------------------------------------------------- starts
def test_initial_vibration_has_the_amplitude_asked_for() -> None:
    env = gym.make("FlexibleArm-v0", initial_vibration=0.05, arm=_undamped())
    env.reset(seed=0, options={"start": 0.7, "vibration": 0.03})
    bends = column([env.step(np.zeros(1, np.float32)) for _ in range(150)], "tip_deflection")
    assert np.abs(bends).max() == pytest.approx(0.03, rel=0.03)
    crossings = np.flatnonzero(np.diff(np.sign(bends)) != 0)
    assert np.ptp(np.diff(crossings)) <= 1, "one frequency alone"
    sizes = []
    for seed in range(40):
        env.reset(seed=seed)
        sizes.append(np.abs(column([env.step(np.zeros(1, np.float32)) for _ in range(25)], "tip_deflection")).max())
    assert max(sizes) < 0.052
    assert max(sizes) > 0.04
    assert min(sizes) < 0.01


def _undamped() -> Any:
    import dataclasses

    return dataclasses.replace(arms.named("strip"), tau_d=0.0)


def test_gravity_bends_a_hanging_arm() -> None:
    env = gym.make("FlexibleArm-v0", gravity=(0.0, -9.81), info_level="full")
    env.reset(seed=0, options={"start": 0.0, "target": 0.0})
    info = [env.step(np.zeros(1, np.float32)) for _ in range(10)][-1][-1]
    assert info["tip_position"][1] < -0.05
    assert info["energy_gravity"] < 0.0


def test_a_heavier_payload_is_slower() -> None:
    rates = []
    for factor in (0.5, 2.0):
        env = gym.make("FlexibleArm-v0", randomization={"payload": (factor, factor)})
        rates.append(run(env, np.ones((20, 1)), **START)[-1][0][2])
    assert rates[0] > 1.3 * rates[1]


def test_torque_constant_scales_the_torque() -> None:
    env = gym.make("FlexibleArm-v0", randomization={"torque_constant": (0.8, 0.8)})
    assert run(env, np.ones((1, 1)), **START)[0][-1]["hub_torque"] == pytest.approx(1.6)


def test_episodes_of_a_randomised_arm_differ(rng: np.random.Generator) -> None:
    env = gym.make("FlexibleArm-v0", randomization={"EI": (0.7, 1.3)})
    one, other = episode(env, 0, 20, **START), episode(env, 1, 20, **START)
    assert_same(one[0][0], other[0][0])
    assert not np.array_equal(one[-1][0], other[-1][0])
