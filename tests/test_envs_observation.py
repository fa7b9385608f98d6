"""What is observed: entries by name, what sensors measure, and several observations in one."""

import itertools
import math
import pickle
from types import SimpleNamespace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from flexarm_env import control
from flexarm_env.envs.options import plan
from flexarm_env.envs.task import SLEW
from flexarm_env.tasks.program import GOAL
from tests.env_tools import IDS, MULTI, assert_goes_back, assert_pair_same, assert_same, episode, pair, successes
from tests.refusals import refuses

ONE, TWO = IDS
MODES = ("NextStep", "SameStep", "Disabled")
MEASURED = {"observation": "measured", "history": 3}
JOINTS = {ONE: ("hub",), TWO: ("hub", "elbow"), MULTI: ("hub", "elbow_1", "elbow_2")}


def measured_names(env_id: str) -> tuple[str, ...]:
    """Of an arm that names no sensors."""
    joints = JOINTS[env_id]
    return (
        *(f"{joint}_{of}" for joint in joints for of in ("sin", "cos")), *(f"{joint}_rate" for joint in joints),
        *(f"{joint}_error" for joint in joints), *(() if env_id == ONE else ("target_x", "target_y")),
        *(f"strain_gauge_{k + 1}" for k in range(len(joints))),
    )  # fmt: skip


def values(env: Any, observation: np.ndarray) -> dict[str, float]:
    """The newest observation, in SI units by name."""
    own = env.unwrapped.plan
    newest = observation[-len(own.names) :].astype(float) * own.scales
    return dict(zip(own.names, newest.tolist(), strict=True))


def angles_of(env: Any) -> np.ndarray:
    """Joint angles of the arm as it is."""
    poses = env.unwrapped.batch.view(0).poses
    return np.array([pose[2] - (poses[k - 1][8] if k else 0.0) for k, pose in enumerate(poses)])


# ---------------------------------------------------------------------------------------- what is there
@pytest.mark.parametrize("env_id", [ONE, *(pytest.param(k, marks=pytest.mark.slow) for k in (TWO, MULTI))])
def test_measured_is_what_ideal_sensors_give(env_id: str) -> None:
    """Encoders, filtered differences of them and gauges at the roots; the target, and no word of the tip."""
    env, full = gym.make(env_id, **MEASURED), gym.make(env_id, sensors={"strain_gauges": roots(env_id)})
    names, joints = env.unwrapped.plan.names, JOINTS[env_id]
    assert names == measured_names(env_id)
    assert env.observation_space.shape == (3 * len(names),)
    assert not any("tip" in name or "to_target" in name for name in names)
    observation, info = env.reset(seed=4)
    full.reset(seed=4)
    kept = math.exp(-2.0 * math.pi * 20.0 * 0.02)
    before, rates = angles_of(env), np.zeros(len(joints))
    goal = env.unwrapped.batch.record(0)[GOAL : GOAL + len(joints)].copy()
    assert [values(env, observation)[f"{joint}_rate"] for joint in joints] == [0.0] * len(joints)
    rng = np.random.default_rng(0)
    for _ in range(25):
        action = rng.uniform(-1.0, 1.0, env.action_space.shape).astype(np.float32)
        observation, *_, info = env.step(action)
        seen, true = values(env, observation), values(full, full.step(action)[0])
        angles = angles_of(env)
        rates = kept * rates + (1.0 - kept) * (angles - before) / 0.02
        before = angles
        for k, joint in enumerate(joints):
            assert seen[f"{joint}_sin"] == pytest.approx(math.sin(angles[k]), abs=1e-7)
            assert seen[f"{joint}_cos"] == pytest.approx(math.cos(angles[k]), abs=1e-7)
            assert seen[f"{joint}_rate"] == pytest.approx(rates[k], abs=1e-5)
            assert seen[f"{joint}_error"] == pytest.approx(goal[k] - angles[k], abs=1e-6)
            assert seen[f"strain_gauge_{k + 1}"] == true[f"strain_gauge_{k + 1}"]
        if env_id != ONE:
            assert [seen["target_x"], seen["target_y"]] == pytest.approx(info["target"], abs=1e-6)


def roots(env_id: str) -> list[tuple[int, float]]:
    return [(k, 0.0) for k in range(len(JOINTS[env_id]))]


@pytest.mark.parametrize("env_id", [ONE, pytest.param(TWO, marks=pytest.mark.slow)])
def test_entries_are_chosen_by_name(env_id: str) -> None:
    full = gym.make(env_id, sensors={"strain_gauges": roots(env_id)})
    names = full.unwrapped.plan.names
    chosen = (names[3], f"{JOINTS[env_id][0]}_error", names[0], names[-1])  # the second one shares a compiled form
    env, own, there = gym.make(env_id, observation=chosen), [0, 2, 3], [3, 0, len(names) - 1]
    assert env.unwrapped.plan.names == chosen
    assert_same(env.observation_space.high[own], full.observation_space.high[there])
    for one, other in zip(episode(env, 2, 10), episode(full, 2, 10), strict=True):
        assert_same(one[0][own], other[0][there])
        assert_same(one[1:], other[1:])


def test_goals_and_gauges_by_name_need_nothing_else() -> None:
    """Joint entries stay those of the arm itself; the goal is held against them."""
    env = gym.make(ONE, observation=("hub_rate", "hub_error", "strain_gauge_1"))
    observation, info = env.reset(seed=1)
    seen = values(env, observation)
    assert seen["hub_error"] == pytest.approx(info["target"] - angles_of(env)[0], abs=1e-6)
    observation = env.step(np.ones(1, np.float32))[0]
    assert values(env, observation)["hub_rate"] == pytest.approx(env.unwrapped.batch.view(0).poses[0][5], abs=1e-5)


def test_full_is_the_default_and_nothing_of_it_is_compiled() -> None:
    extras = plan(SLEW, observation="full", history=1).extras
    assert extras.selection is None
    assert extras.instruments is None
    assert plan(SLEW, observation="full").names == plan(SLEW).names


def test_history_holds_the_last_observations_oldest_first() -> None:
    seen = np.array([o[0] for o in episode(gym.make(ONE, **MEASURED), 5, 12)]).reshape(-1, 3, 5)
    assert_same(seen[0], np.repeat(seen[0, :1], 3, axis=0))
    assert_same(seen[1:, :2], seen[:-1, 1:])
    assert (np.ptp(seen[:, 2], axis=0) > 0.0).all()


# ---------------------------------------------------------------------------------------- one and many
@pytest.mark.parametrize(
    ("env_id", "mode"),
    [*itertools.product((ONE,), MODES), *(pytest.param(TWO, m, marks=pytest.mark.slow) for m in MODES),
     pytest.param(MULTI, MODES[0], marks=pytest.mark.slow)],
)  # fmt: skip
def test_vector_is_the_single_environment(env_id: str, mode: str) -> None:
    assert assert_pair_same(pair(env_id, 5, mode, max_episode_steps=7, **MEASURED), 30) >= 10


def test_states_and_copies_go_on_alike() -> None:
    env = gym.make(ONE, **MEASURED)
    episode(env, 0, 6)
    assert_goes_back(env, copied=pickle.loads(pickle.dumps(env)))


def test_a_motion_is_measured_too() -> None:
    env = gym.make(ONE, **MEASURED)
    env.reset(seed=0, options={"motion": [[0.0, 0.1], [1.0, 0.9]], "interpolation": "linear"})
    for k in range(1, 20):
        seen = values(env, env.step(np.zeros(1, np.float32))[0])
        assert seen["hub_sin"] == pytest.approx(math.sin(0.1 + 0.8 * 0.02 * k), abs=1e-6)
    assert seen["hub_rate"] == pytest.approx(0.8, abs=1e-4)


@pytest.mark.slow
def test_a_moving_target_is_shown_as_the_encoder_turns() -> None:
    """The reference is known; its entries stay."""
    env = gym.make(ONE, task="track", **MEASURED)
    assert env.unwrapped.plan.names[3:7] == ("target_rate", "target_ahead_1", "target_ahead_2", "hub_error")
    env.reset(seed=0)
    observation, *_, info = env.step(np.zeros(1, np.float32))
    seen = values(env, observation)
    assert seen["hub_error"] == pytest.approx(info["target"] - angles_of(env)[0], abs=1e-6)


def test_success_and_reward_are_the_true_tip_s() -> None:
    for one, other in zip(episode(gym.make(ONE, **MEASURED), 6, 20), episode(gym.make(ONE), 6, 20), strict=True):
        assert_same(one[1:], other[1:])


# ---------------------------------------------------------------------------------------- who acts on it
def test_controllers_that_need_no_deflection_act_on_what_is_measured() -> None:
    env = gym.make_vec(ONE, num_envs=16, vectorization_mode="vector_entry_point", duration=8.0, **MEASURED)
    for name in ("pd", "zvd"):
        assert successes(env, control.make(name, env), 0) >= 0.9, name


@pytest.mark.parametrize("name", ["lqr", "time_optimal"])
def test_controllers_that_need_more_say_what(name: str) -> None:
    with pytest.raises(
        ValueError, match=r"observation: \w+ needs the entry tip_deflection, which is not among hub_sin"
    ):
        control.make(name, gym.make(ONE, **MEASURED))
    with pytest.raises(ValueError, match=r"observation: PD needs the entry hub_cos"):
        own = plan(SLEW, observation=("hub_sin", "hub_rate", "hub_error"))
        control.make("pd", control.Setup.of(SimpleNamespace(unwrapped=SimpleNamespace(plan=own))))


def test_a_policy_is_held_to_its_observation() -> None:
    """Names, scales and how many stand in one."""
    setups = [
        control.Setup.of(SimpleNamespace(unwrapped=SimpleNamespace(plan=plan(SLEW, **keywords))))
        for keywords in ({}, {"history": 3}, {"observation": "measured"}, MEASURED, {"observation": ("hub_sin",)})
    ]
    assert len({setup.layout for setup in setups}) == 5
    assert [setup.size for setup in setups] == [6, 18, 5, 15, 1]
    weights = [(np.ones((15, 1), np.float32), np.zeros(1, np.float32))]
    meta = {"env_id": ONE, "env_kwargs": {}, "layout": setups[3].layout, "activation": "tanh", "squash": True}
    policy = control.NumpyPolicy(meta, weights)
    policy.check(setups[3])
    refuses("5 entries, other names or scales", lambda: policy.check(setups[2]))


# ---------------------------------------------------------------------------------------- what is refused
@pytest.mark.parametrize(
    ("keywords", "words"),
    [
        ({"observation": "all"}, r"^observation = 'all': must be \"full\", \"measured\" or names"),
        ({"observation": ()}, r"^observation = \(\): must name at least one"),
        ({"observation": ("hub_sin", "hub_sin")}, r"^observation\[1\] = 'hub_sin': must not be named twice"),
        ({"observation": ("hub_sine",)}, r"^observation\[0\] = 'hub_sine'.*hub_sin"),
        ({"observation": ("strain_gauge_2",)}, r"^observation\[0\] = 'strain_gauge_2'.*strain_gauge_1"),
        ({"observation": 3}, r"^observation = 3: must be a sequence of names"),
        ({"history": 0}, r"^history = 0: must be a whole number"),
        ({"history": 2.0}, r"^history = 2\.0: must be a whole number"),
    ],
)
def test_errors_say_what_is_allowed(keywords: dict[str, Any], words: str) -> None:
    refuses(words, lambda: gym.make(ONE, **keywords))
