"""What the environments refuse: wrong arguments, options, actions and seeds are named, and change nothing."""

import math
from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from flexarm_env import arms
from flexarm_env import validation as check
from flexarm_env.envs.flexible_arm import FlexibleArmVectorEnv
from tests.env_tools import IDS, MULTI, assert_same, rich
from tests.refusals import refusal, refuses, says

ONE, TWO = IDS
THREE = arms.named("three_strips")

WRONG: dict[str, list[tuple[dict[str, Any], tuple[str, ...]]]] = {
    ONE: [
        ({"colour": "red"}, ("colour", "unknown argument")),
        ({"control_dt": 0.0}, ("control_dt = 0.0", "positive")),
        ({"dt": 0.003}, ("dt = 0.003", "whole number")),
        ({"formulation": "elastica", "segments": 3}, ("segments", "floating_frame")),
        ({"arm": "de_luca_siciliano"}, ("arm", "1 link")),
        ({"arm": "no_such_arm"}, ("no_such_arm", "strip")),
        ({"action_mode": "velocity"}, ("action_mode", "torque", "residual_pd")),
        ({"residual_share": 1.0}, ("residual_share = 1.0", 'action_mode="residual_pd"')),
        ({"action_mode": "residual_pd", "residual_share": 0.0}, ("residual_share = 0.0", "positive")),
        ({"task": "juggle"}, ("task", "slew", "track", "replay")),
        ({"reference": [[0, 0], [1, 1]]}, ("reference", 'task="track"')),
        ({"reward": {"glory": 1.0}}, ("reward.glory", "accuracy")),
        ({"randomization": {"payload": (2.0, 0.5)}}, ("randomization.payload", "low")),
        ({"randomization": {"EI": (0.0, 1.0)}}, ("randomization.EI[0] = 0.0", "positive")),
        ({"randomization": {"colour": (1, 2)}}, ("randomization.colour", "payload")),
        ({"sensors": {"delay": 0.01}}, ("sensors.delay = 0.01", "control_dt")),
        ({"sensors": {"noise": {"hub": 1.0}}}, ("sensors.noise.hub", "hub_rate")),
        ({"sensors": {"strain_gauges": [1.5]}}, ("strain_gauges[0]", "1")),
        ({"sensors": "noisy"}, ("sensors = 'noisy'", "table")),
        ({"observation": np.zeros(2)}, ("observation[0] = 0.0", "text")),
        ({"formulation": np.zeros(2)}, ("formulation = [0.0, 0.0]", "elastica")),
        ({"max_iterations": 10**400}, ("max_iterations = 1000", "from 1 to 10000")),
        ({"sensors": {"delay": 1e9}}, ("sensors.delay", "at most 1000")),
        ({"task": "track", "reference": "nope.csv"}, ("reference = 'nope.csv'", "exists")),
        ({"task": "track", "reference": 5}, ("reference = 5", "TimeFunction")),
        ({"task": "track", "reference": [[0.0, 0.0], [4.0, 1e7]]}, ("reference = 1", "at most 1e+06 (rad)")),
        ({"task": "replay", "motion": "nope.csv"}, ("motion = 'nope.csv'", "exists")),
        ({"task": "replay", "motion": "nope.toml"}, ("motion = 'nope.toml'", "exists")),
        ({"task": "replay", "motion": {"t": [0, 1]}}, ("motion.psi", "missing")),
        *(({"task": "replay", "motion": wrong}, ("motion = ", ": must ")) for wrong in (3, [], {})),
        ({"actuator": {"lag": -1.0}}, ("actuator.lag = -1.0",)),
        ({"actuator": {"coulomb_rate": 0.1}}, ("actuator.coulomb_rate", "unknown key")),
        ({"action_mode": "current"}, ("arm.joints[0].motor", "needs a motor with a current_limit")),
        ({"starts": {"angles": [(0.0, 1e9)]}}, ("starts.angles[0][1] = 1000000000.0", "at most 1e+06 (rad)")),
        ({"task": "track", "reference": {"path": "line", "rate": (0, 1e9)}}, ("rate[1] = 1000000000", "1e+06 (rad/s)")),
        ({"reward": {"effort": 1e300}}, ("reward.effort = 1e+300", "at most 1e+30")),
        *(
            ({keyword: {name: [[1, 2], [3]]}}, (f"{keyword}.{name}", " = [", "]: must be a "))
            for keyword, name in (("sensors", "delay"), ("actuator", "viscous"), ("cost", "deflection"))
        ),
        ({"info_level": "loud"}, ("info_level", "full")),
        ({"render_mode": "ascii"}, ("render_mode", "rgb_array")),
        ({"initial_vibration": 2.0}, ("initial_vibration = 2.0",)),
    ],
    TWO: [
        ({"joint_limits": [None, (1.0, 2.0)], "starts": {"straight": 0.5}}, ("starts.straight = 0.5", "must be 0")),
        *(
            ({"task": "track", "reference": path}, ("reference = (", "s: must stay within reach, 0 to 1 m"))
            for path in ([[0, 0.5, 0.1], [1, 5.0, 0.2]], [[[0, 2], [1, 2]], [[0, 0], [1, 1]]])
        ),
    ],
    MULTI: [
        ({"arm": "strip"}, ("must have at least 2 link",)),
        ({"arm": replace(THREE, torque_limits=None)}, ("needs 3 torque limit",)),
        ({"joint_limits": [None, None]}, ("joint_limits",)),
        ({"sensors": {"strain_gauges": [(3, 0.5)]}}, ("strain_gauges[0].link",)),
        ({"sensors": {"noise": {"elbow_rate": 0.1}}}, ("elbow_rate",)),
        ({"actuator": {"viscous": [0.1, 0.1]}}, ("actuator.viscous",)),
        ({"task": "slew"}, ('"reach"',)),
        ({"task": "track", "reference": [[0.0, 3.0, 0.0], [1.0, 3.0, 0.0]]}, ("within reach",)),
        ({"task": "replay", "motion": {"joint3": "spin_up"}}, ("joint3",)),
    ],
    "SpatialFlexArm-v0": [
        ({"formulation": np.zeros(2)}, ("formulation = [0.0, 0.0]", "elastica")),
        ({"formulation": "paper"}, ("formulation = 'paper'", "'floating_frame' in space")),
    ],
}


@pytest.mark.filterwarnings("ignore:.*render_mode:UserWarning")
@pytest.mark.parametrize(("env_id", "kwargs", "words"), [(k, *row) for k, rows in WRONG.items() for row in rows])
def test_a_wrong_argument_is_named(env_id: str, kwargs: dict[str, Any], words: tuple[str, ...]) -> None:
    told = refusal(lambda: gym.make(env_id, **kwargs))
    assert all(word in told for word in words), told


@pytest.mark.parametrize("many", [10**9, 10**400])
def test_more_arms_than_memory_holds_are_refused(many: int) -> None:
    """Before any is made: a system that promises room ends whoever fills it."""
    with pytest.raises(ValueError, match=r"must be at most \d+ GB, this machine's memory: take fewer \(num_envs\)"):
        gym.make_vec(ONE, num_envs=many)


@pytest.mark.parametrize("wrong", [{"num_envs": 0}, {"threads": 0}, {"autoreset_mode": "Never"}])
def test_a_wrong_argument_of_a_vector_is_named(wrong: dict[str, Any]) -> None:
    refuses(next(iter(wrong)), lambda: FlexibleArmVectorEnv(**{"num_envs": 2} | wrong))


# ---------------------------------------------------------------------------------------- nothing is changed
def started(env_id: str, n: int = 0) -> Any:
    """A single environment, or a vector of n, that has made a step."""
    env = gym.make_vec(env_id, num_envs=n) if n else gym.make(env_id).unwrapped
    env.reset(seed=1)
    env.step(np.zeros(env.action_space.shape, np.float32))
    return env


def remembered(env: Any) -> list[Any]:
    """States of all arms and of their generators."""
    states = env.get_state()
    states = states if isinstance(states, list) else [states]
    return [(state["arm"], state["generator"].bit_generator.state) for state in states]


OPTIONS: list[tuple[str, int, Any, tuple[str, ...]]] = [
    (TWO, 0, {"colour": 1}, ("options.colour", "target", "motion")),
    (TWO, 0, {"target": [0.99, 0.99]}, ("options.target", "within reach")),
    (TWO, 0, {"target": [0.5, math.nan]}, ("options.target[1]", "finite")),
    (ONE, 0, {"start": 10**400}, ("options.start", "finite")),
    (TWO, 0, {"target": [0.5, 10**400]}, ("options.target[1]", "finite")),
    (TWO, 0, {"start": [0.0, 3.0]}, ("options.start[1] = 3.0", "limits")),
    (TWO, 0, {"start": 0.0}, ("options.start",)),
    (TWO, 0, {"motion": {"joint2": "robot_arm_motion"}}, ("options.motion.joint2", "joint1")),
    (TWO, 0, {"motion": "no_such_motion"}, ("no_such_motion", "two_link_motion")),
    (TWO, 0, {"motion": "flying_rod"}, ("options.motion", "free")),
    (TWO, 0, {"motion": [[0.0, 0.0], [0.0, 1.0]]}, ("options.motion", "t[1]")),
    (TWO, 0, {"interpolation": "linear"}, ("options.interpolation", "options.motion")),
    (TWO, 0, {"motion": "two_link_motion", "start": [0.3, 0.0]}, ("options.start[0] = 0.3", "motion begins")),
    (TWO, 0, {"motion": "two_link_motion", "vibration": 0.1}, ("options.vibration = 0.1", "motion")),
    (MULTI, 0, {"start": [0.1, 0.2]}, ("3 angles",)),
    (MULTI, 0, {"start": [0.0, 0.0, 3.0]}, ("options.start[2] = 3",)),
    (MULTI, 0, {"target": [1.2, 0.0]}, ("within reach",)),
    (MULTI, 0, {"target": 0.5}, ("options.target",)),
    (ONE, 3, [1], ("options",)),
    (ONE, 3, {"motion": ["spin_up", "spin_up"]}, ("list of 3, one for each",)),
]


@pytest.mark.parametrize(("env_id", "n", "options", "words"), OPTIONS)
def test_a_wrong_option_is_named_and_changes_nothing(env_id: str, n: int, options: Any, words: tuple[str, ...]) -> None:
    env = started(env_id, n)
    before = remembered(env)
    told = refusal(lambda: env.reset(seed=2, options=options))
    assert all(word in told for word in words), told
    assert_same(before, remembered(env))


def test_a_target_is_the_reference_s_matter() -> None:
    env = gym.make(TWO, **rich(TWO))
    refuses(r"options\.target = .*track", lambda: env.reset(options={"target": [0.5, 0.0]}))


@pytest.mark.parametrize("seed", [-1, 1.5, [1, 2], [1, 2, "three"], [1, 2, -3]])
def test_a_wrong_seed_changes_nothing(seed: Any) -> None:
    env = started(ONE, 3)
    before = remembered(env)
    refuses("seed", lambda: env.reset(seed=seed))
    assert_same(before, remembered(env))


def test_single_and_vector_take_the_same_seeds() -> None:
    one, many = started(ONE, 0), started(ONE, 1)
    assert np.array_equal(one.reset(seed=np.int64(5))[0], many.reset(seed=np.int64(5))[0][0])
    for env in (one, many):
        for seed in (1.5, True, -1, np.array(3)):
            says(
                f"seed = {check.shown(seed)}: must be a whole number, at least 0", lambda e=env, s=seed: e.reset(seed=s)
            )


@pytest.mark.parametrize(
    ("env_id", "n", "action"),
    [(TWO, 0, x) for x in (np.zeros(3, np.float32), np.float32(0.0), "up", np.array([0.0, 1j]), None, [[0.0, 0.0]])]
    + [(MULTI, 0, np.zeros(2))]
    + [(ONE, 3, x) for x in (np.zeros((2, 1), np.float32), np.zeros(3, np.float32), "left", None)],
)
def test_an_action_of_a_wrong_shape_or_kind_moves_nothing(env_id: str, n: int, action: Any) -> None:
    env = started(env_id, n)
    before = remembered(env)
    refuses("action", lambda: env.step(action))
    assert_same(before, remembered(env))


# ---------------------------------------------------------------------------------------- actions that are no numbers
@pytest.fixture(scope="module", params=(*IDS, MULTI))
def env(request: pytest.FixtureRequest) -> Any:
    return gym.make(request.param)


def test_actions_beyond_one_are_clipped_and_other_kinds_of_numbers_taken(env: Any) -> None:
    n = env.action_space.shape[0]
    outcomes = []
    for action in (np.full(n, 1.0, np.float32), np.full(n, 7.0, np.float32), [1] * n, np.full(n, 1e300)):
        env.reset(seed=9)
        outcomes.append(env.step(action))
    for other in outcomes[1:]:
        assert_same(outcomes[0], other)


def test_an_action_that_is_not_finite_ends_the_episode_where_it_was(env: Any) -> None:
    for bad in (math.nan, math.inf):
        env.reset(seed=1)
        last = env.step(env.action_space.sample())
        state = env.unwrapped.batch.motion(0)
        observation, reward, terminated, truncated, info = env.step(np.full(env.action_space.shape, bad, np.float32))
        assert terminated and not truncated
        assert info["termination_reason"] == "action_not_finite"
        assert reward == info["reward_failure"] == -env.unwrapped.plan.record.weights[-1] < -5.0
        assert_same(observation, last[0])
        assert_same(info["tip_position"], last[-1]["tip_position"])
        for a, b in zip(state[:2], env.unwrapped.batch.motion(0)[:2], strict=True):
            assert_same(a, b)
        with pytest.raises(gym.error.ResetNeeded):
            env.step(env.action_space.sample())
