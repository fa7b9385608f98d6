"""What an episode's delays, gains and hub are drawn to be: told by info, and at work."""

import dataclasses
import itertools
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from flexarm_env import arms
from flexarm_env.derivatives import Arms
from flexarm_env.envs.options import plan
from flexarm_env.envs.task import SLEW
from flexarm_env.parameters import Joint
from tests.env_tools import IDS, MULTI, assert_pair_same, assert_same, pair
from tests.refusals import refuses

ONE, TWO = IDS
SPACE, N, DT = "SpatialFlexArm-v0", 9, 0.0025
EVERYWHERE = [ONE, *(pytest.param(name, marks=pytest.mark.slow) for name in (TWO, MULTI, SPACE))]


def features(env_id: str, delay: Any = (0.0, 18 * DT), late: Any = (0.02, 0.08), gain: Any = (0.5, 1.5)) -> Any:
    """Delays and gains of commands and of sensors; gauges on a link that bends."""
    gauges = [{"link": int(env_id == SPACE), "gain": gain}, {"link": int(env_id == SPACE), "place": 0.5}]
    sensors = {"delay": late, "strain_gauges": gauges, "encoders": {"gain": gain}, "camera": {"gain": gain}}
    own = {"elements": 1, "control_dt": 0.02} if env_id == SPACE else {}
    return {"actuator": {"delay": delay, "lag": 0.01}, "sensors": sensors, "dt": DT, **own}


def run(env: Any, steps: int = 30, seed: int = 5, share: float = 0.3, options: Any = None) -> tuple[Any, Any, Any]:
    """Info of the reset, outcomes of a rollout, and observations (steps + 1, ...)."""
    seen, info = env.reset(seed=seed, options=options)
    rng, shape = np.random.default_rng(1), env.action_space.shape
    moves = share * rng.uniform(-1.0, 1.0, (steps, *shape[-1:])).astype(np.float32)
    outcomes = [env.step(np.broadcast_to(move, shape).copy()) for move in moves]
    return info, outcomes, np.array([seen, *(out[0] for out in outcomes)])


@pytest.mark.slow
@pytest.mark.parametrize("env_id", EVERYWHERE)
def test_delays_and_gains_that_are_told_are_those_at_work(env_id: str) -> None:
    """Arms that draw all, against arms that are given what info told: the torques to the last bit, what they show so
    many periods later, and readings times their gains."""
    many = gym.make_vec(env_id, num_envs=N, **features(env_id))
    names, joints = many.unwrapped.plan.names, many.unwrapped.plan.arm.joint_names
    info, outcomes, seen = run(many)
    commands, late = info["drawn_command_delay"], info["drawn_observation_delay"]
    steps = commands / DT
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    assert steps.min() >= 0.0 and steps.max() <= 18.0 and len(set(steps)) > 3
    assert set(np.round(late / 0.02)) <= {1.0, 2.0, 3.0, 4.0} and len(set(late)) > 1
    told = [key for key in info if key.startswith("drawn_")]
    assert "drawn_strain_gauge_1_gain" in told and "drawn_strain_gauge_2_gain" not in told
    for out, key in itertools.product(outcomes, told):
        np.testing.assert_array_equal(out[-1][key], info[key])
    for i in range(0, N, 3):
        alone = gym.make(env_id, **features(env_id, float(commands[i]), 0.0, 1.0))
        _, same, true = run(alone, seed=5 + i)
        for out, other in zip(outcomes, same, strict=True):
            np.testing.assert_array_equal(out[-1]["joint_torque"][i], other[-1]["joint_torque"])
        periods = round(float(late[i]) / 0.02)
        shown = np.concatenate([np.repeat(true[:1], periods, axis=0), true[: len(true) - periods]])
        for joint in joints:
            sine, cosine = (names.index(f"{joint}_{of}") for of in ("sin", "cos"))
            angle = info[f"drawn_{joint}_angle_gain"][i] * np.unwrap(np.arctan2(shown[:, sine], shown[:, cosine]))
            shown[:, sine], shown[:, cosine] = np.sin(angle), np.cos(angle)
            shown[:, names.index(f"{joint}_rate")] *= info[f"drawn_{joint}_angle_gain"][i]
        for k, name in enumerate(names):
            gain = info[f"drawn_{name}_gain"][i] if f"drawn_{name}_gain" in info else 1.0
            np.testing.assert_allclose(seen[:, i, k], gain * shown[:, k], rtol=1e-6, atol=2e-6, err_msg=name)
    many.close()


@pytest.mark.parametrize("env_id", EVERYWHERE)
def test_cross_correlation_finds_the_delay_that_is_told(env_id: str) -> None:
    """Of what is asked for at random with the torque at each period's end, in whole periods."""
    own = {"elements": 1, "control_dt": 0.02} if env_id == SPACE else {}
    many = gym.make_vec(env_id, num_envs=N, actuator={"delay": (0.0, 48 * DT)}, dt=DT, **own)
    info, outcomes, _ = run(many, 80, share=0.05)
    torque = np.array([out[-1]["hub_torque"] for out in outcomes])
    asked = np.random.default_rng(1).uniform(-1.0, 1.0, (80, *many.single_action_space.shape))[:, 0]
    found = [int(np.argmax([torque[k:, i] @ asked[: 80 - k] for k in range(9)])) for i in range(N)]
    np.testing.assert_array_equal(found, np.floor(info["drawn_command_delay"] / 0.02 + 1e-9))
    assert len(set(found)) > 3
    many.close()


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["NextStep", "SameStep", "Disabled"])
@pytest.mark.parametrize("env_id", EVERYWHERE)
def test_the_vector_draws_what_single_environments_draw(env_id: str, mode: str) -> None:
    """Across autoresets, with jitter on top, noise that comes late, several observations in one; info and all."""
    given = features(env_id) | {"duration": 0.14, "history": 2}
    given["actuator"] = given["actuator"] | {"jitter": 5 * DT}
    given["sensors"] = given["sensors"] | {"noise": 0.01}
    assert assert_pair_same(pair(env_id, N, mode, **given), 24, scale=0.5, passed=4) >= 2 * N


def test_episodes_draw_anew_and_options_change_nothing_of_it() -> None:
    env = gym.make(ONE, **features(ONE))
    drawn = [run(env, 2, seed)[0] for seed in range(12)]
    assert len({info["drawn_command_delay"] for info in drawn}) > 5
    assert len({info["drawn_observation_delay"] for info in drawn}) > 2
    for info, seed in zip(drawn, range(3), strict=False):
        again = run(env, 2, seed, options={"start": 0.3, "target": 0.1, "vibration": 0.0})[0]
        for key in (key for key in info if key.startswith("drawn_")):
            assert again[key] == info[key]


def test_jitter_comes_on_top_of_the_delay_that_is_drawn() -> None:
    """Each period's delay is told, that of reset without jitter; a lag's torques say the same."""
    lag, n, most = 0.05, 8, 24
    env = gym.make(ONE, actuator={"delay": (4 * DT, 20 * DT), "jitter": most * DT, "lag": lag}, dt=DT, duration=20.0)
    info, outcomes, _ = run(env, 300, share=1.0)
    first, late = (round(float(one["drawn_command_delay"]) / DT) for one in (info, outcomes[0][-1]))
    assert 4 <= first <= 20 and late >= first
    asked = 2.0 * np.random.default_rng(1).uniform(-1.0, 1.0, (300, 1))[:, 0].astype(np.float32).astype(np.float64)
    asked, torque, found = np.concatenate([np.zeros(9), asked]), 0.0, []
    for k, out in enumerate(outcomes):
        found.append(round(float(out[-1]["drawn_command_delay"]) / DT))
        for s in range(n):
            torque += (asked[9 + k - max(0, -(-(found[-1] - s) // n))] - torque) * (1.0 - np.exp(-DT / lag))
        assert out[-1]["hub_torque"] == pytest.approx(torque, abs=1e-9)
    assert set(found) == set(range(first, first + most + 1))


@pytest.mark.slow
def test_delays_that_are_not_drawn_are_not_there() -> None:
    """Ranges of one number are that number, and jitter without delay is told alone."""
    one, same = (gym.make(ONE, actuator={"delay": delay}, sensors={"delay": late}, dt=DT)
                 for delay, late in ((0.03, 0.04), ((0.03, 0.03), (0.04, 0.04))))  # fmt: skip
    assert_same(one.reset(seed=0), same.reset(seed=0))
    assert_same(one.unwrapped.batch.get_state(0), same.unwrapped.batch.get_state(0))
    jittered = gym.make(ONE, actuator={"jitter": 3 * DT}, dt=DT)
    info, outcomes, _ = run(jittered, 40)
    assert [key for key in info if key.startswith("drawn_")] == ["drawn_command_delay"]
    assert info["drawn_command_delay"] == 0.0
    assert {round(out[-1]["drawn_command_delay"] / DT) for out in outcomes} == {0, 1, 2, 3}


@pytest.mark.slow
def test_a_state_keeps_its_delays_in_environments_of_other_ranges() -> None:
    """Where as many commands and observations are remembered; elsewhere it is refused."""

    def made(low: float, high: float, late: Any) -> Any:
        sensors = {"delay": late, "strain_gauges": [{"gain": (0.5, 1.5)}]}
        env = gym.make(ONE, actuator={"delay": (low * DT, high * DT)}, sensors=sensors, dt=DT).unwrapped
        env.reset(seed=1)
        return env

    one, other = made(13, 15, (0.04, 0.06)), made(1, 8, (0.0, 0.06))
    info = run(one, 5)[0]
    other.set_state(one.get_state())
    for _ in range(12):
        move = np.full(1, 0.2, np.float32) if _ % 3 else np.full(1, -0.3, np.float32)
        mine, yours = one.step(move), other.step(move)
        assert_same(mine, yours)
        assert yours[-1]["drawn_command_delay"] == info["drawn_command_delay"] >= 12.5 * DT
    for high, late in ((16, (0.04, 0.06)), (15, (0.04, 0.08)), (15, 0.06)):
        third = made(13, high, late)
        refuses("must be the state of an environment made alike", lambda: third.set_state(one.get_state()))  # noqa: B023


@pytest.mark.slow
def test_motions_keep_what_is_drawn_in_info() -> None:
    given = {"randomization": {"payload": (0.5, 2.0)}, "sensors": {"strain_gauges": [{"gain": (0.5, 1.5)}]}}
    plain, led = gym.make(ONE, **given), gym.make(ONE, **given)
    _, drawn = plain.reset(seed=3)
    _, info = led.reset(seed=3, options={"motion": "spin_up"})
    after = led.step(np.zeros(1, np.float32))[-1]
    assert info["drawn_payload"] == after["drawn_payload"] == drawn["drawn_payload"] != 0.0
    own = led.unwrapped.batch
    assert own.parameters(0)[0] == own.arm.payload.mass * info["drawn_payload"]
    assert 0.5 < info["drawn_strain_gauge_1_gain"] == after["drawn_strain_gauge_1_gain"] < 1.5


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"actuator": {"delay": (0.01, 0.0)}}, r"actuator.delay = \(0.01, 0.0\): must be \(low, high\) with low"),
        ({"actuator": {"delay": (-0.01, 0.01)}}, r"actuator.delay\[0\] = -0.01: must be a number, zero or"),
        ({"actuator": {"delay": (0.0, float("nan"))}}, r"actuator.delay\[1\] = nan"),
        ({"actuator": {"delay": (0.0, float("inf"))}}, r"actuator.delay\[1\] = inf"),
        ({"actuator": {"delay": (0.0, 0.0011)}}, r"actuator.delay\[1\] = 0.0011: must be a whole number of dt ="),
        ({"actuator": {"delay": (0.0, 2.6)}}, r"actuator.delay\[1\] = 2.6: must be at most 1000 dt = 2.5 s"),
        ({"actuator": {"delay": (0.0, 0.01, 0.02)}}, r"actuator.delay = .*: must be a sequence of two numbers \(s\)"),
        ({"actuator": {"delay": "soon"}}, "actuator.delay = 'soon'"),
        ({"actuator": {"jitter": (0.0, 0.01)}}, "actuator.jitter = .*: must be a number"),
        ({"actuator": {"jitter": float("nan")}}, "actuator.jitter = nan"),
        ({"sensors": {"delay": (0.0, 0.01)}}, r"sensors.delay\[1\] = 0.01: must be a whole number of control_dt"),
        ({"sensors": {"delay": (0.04, 0.02)}}, r"sensors.delay = \(0.04, 0.02\): must be \(low, high\)"),
        ({"sensors": {"delay": (0.0, 21.0)}}, r"sensors.delay\[1\] = 21.0: must be at most 1000 control_dt"),
        ({"sensors": {"camera": {"delay": (0.0, 0.1)}}}, r"sensors.camera.delay = \(0.0, 0.1\): must be a number"),
        ({"sensors": {"camera": {"gain": (1.0, 0.5)}}}, r"sensors.camera.gain = \(1.0, 0.5\): must be \(low, high\)"),
        ({"sensors": {"camera": {"gain": (1.0, float("nan"))}}}, r"sensors.camera.gain\[1\] = nan"),
    ],
)  # fmt: skip
def test_ranges_that_are_none_are_refused(given: dict[str, Any], words: str) -> None:
    for env_id, own in ((ONE, {"dt": DT}), (SPACE, {"dt": DT, "control_dt": 0.02})):
        refuses(words, lambda: gym.make(env_id, **given, **own))  # noqa: B023


@pytest.mark.slow
def test_derivatives_of_arms_that_draw_delays() -> None:
    """Commands are as late as the environment's, hubs and gains are parameters; to see past of another length is
    refused."""
    given = {"actuator": {"delay": (0.0, 18 * DT), "lag": 0.01}, "dt": DT, "arm": "strip_geared"}
    given |= {"sensors": {"strain_gauges": [{"gain": (0.5, 1.5)}]}, "randomization": {"hub_inertia": (0.5, 2.0)}}
    arm = Arms(ONE, N, parameters=True, **given)
    state, (_, info) = arm.reset(seed=2), gym.make_vec(ONE, num_envs=N, **given).reset(seed=2)
    own = {name: state[:, k] for k, name in enumerate(arm.names)}
    np.testing.assert_array_equal(own["delay"], np.round(info["drawn_command_delay"] / DT))
    np.testing.assert_array_equal(own["sensor[0].law[0]"], info["drawn_strain_gauge_1_gain"])
    hub = arms.named("strip_geared").hub_inertia
    np.testing.assert_allclose(own["hub[0]"], hub * (info["drawn_hub_inertia"] - 1.0), atol=1e-11 * hub)
    assert {"sensor[0].law[0]", "hub[0]"} <= set(arm.names[: arm.moving])
    refuses(r"sensors.delay = \(0.0, 0.04\): must be one number if derivatives are computed",
            lambda: Arms(ONE, 2, sensors={"delay": (0.0, 0.04)}))  # fmt: skip


GEARS = Joint(stiffness=30.0, damping=0.03, motor_inertia=2e-5, gear_ratio=20.0, friction_coulomb=0.01, backlash=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("env_id", "options", "off"),
    [
        (ONE, {"formulation": "geometrically_exact", "tolerance": 1e-9}, 1e-7),
        (ONE, {}, 1e-2),  # the period is corrected for the nominal arm
        (TWO, {"formulation": "floating_frame", "segments": 2, "dt": 0.0025, "tolerance": 1e-9}, 1e-6),
        (SPACE, {"elements": 1, "dt": 0.0025, "tolerance": 1e-9}, 1e-6),
    ],
)
def test_a_hub_is_drawn_behind_a_gear_that_gives(env_id: str, options: dict[str, Any], off: float) -> None:
    """Motion and energies are those of the arm that has it."""
    base = arms.named({ONE: "strip", TWO: "de_luca_siciliano", SPACE: "three_dof"}[env_id])
    hub = base.torque_limits[0] / 200.0
    found = []
    for own, more in ((1.0, {"randomization": {"hub_inertia": (2.5, 2.5)}}), (2.5, {}), (1.0, {})):
        arm = dataclasses.replace(base, hub_inertia=own * hub, joints=(GEARS,) * base.n_links)
        _, outcomes, _ = run(gym.make(env_id, arm=arm, info_level="full", **options, **more), 30)
        keys = ("energy_kinetic", "energy_dissipated", "work", "hub_torque")
        found.append(np.array([[*(out[-1][key] for key in keys), *out[-1]["motor_rate"]] for out in outcomes]))
    drawn, made, nominal = (rows / np.abs(found[1]).max(axis=0) for rows in found)
    np.testing.assert_allclose(drawn, made, atol=off)
    assert np.abs(drawn - nominal).max() > 0.05


@pytest.mark.parametrize("more", [{}, {"delay": (0.0, 6 * DT)}], ids=["lag", "lag and delay"])
def test_motors_whose_lag_is_drawn(more: dict[str, Any]) -> None:
    """The lag that info tells is at work: torques are those of a motor that lags so much, in vectors too."""
    low, high = 0.01, 0.08
    many = gym.make_vec(ONE, num_envs=N, actuator={"lag": (low, high), **more}, dt=DT)
    info, outcomes, _ = run(many, share=1.0)
    lags = info["drawn_command_lag"]
    assert low <= lags.min() and lags.max() <= high and len(set(lags)) == N and np.std(lags) > 0.01
    assert all((out[-1]["drawn_command_lag"] == lags).all() for out in outcomes)
    for i in range(0, N, 4):
        given = {"lag": float(lags[i])} | ({"delay": float(info["drawn_command_delay"][i])} if more else {})
        _, same, _ = run(gym.make(ONE, actuator=given, dt=DT), seed=5, share=1.0)
        for out, other in zip(outcomes, same, strict=True):
            assert out[-1]["joint_torque"][i] == pytest.approx(other[-1]["joint_torque"], abs=1e-9)
    alone = gym.make(ONE, actuator={"lag": (low, high), **more}, dt=DT)
    _, same, _ = run(alone, share=1.0)
    assert all((out[0][0] == other[0]).all() for out, other in zip(outcomes, same, strict=True))


def test_ranges_of_lags() -> None:
    """From 0 on, no lag at all; a range of one number is that number; what is no range is refused."""
    none: Any = gym.make(ONE, actuator={"lag": (0.0, 1e-7)}, dt=DT)
    ideal, same = run(none, 5)[1], run(gym.make(ONE, dt=DT), 5)[1]
    for out, other in zip(ideal, same, strict=True):
        assert out[-1]["hub_torque"] == pytest.approx(other[-1]["hub_torque"], abs=1e-12)
    one, same = (plan(SLEW, actuator={"lag": lag}).extras.actuator for lag in (0.02, (0.02, 0.02)))
    assert one == same
    with pytest.raises(ValueError, match=r"actuator.lag = \(0.05, 0.01\): must be \(low, high\) with low at most high"):
        plan(SLEW, actuator={"lag": (0.05, 0.01)})
