"""Goal dictionaries for hindsight experience replay."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3 import SAC, HerReplayBuffer
from stable_baselines3.common.env_checker import check_env

import flexarm_env  # noqa: F401
from flexarm_env.goals import GoalObservation
from tests.refusals import says

IDS = ("TwoLinkFlexArm-v0", "MultiLinkFlexArm-v0", "flexarm/reach-measured-v1", "SpatialFlexArm-v0")


def goals(env_id: str = "TwoLinkFlexArm-v0", tolerance: float | None = None, **kwargs: Any) -> GoalObservation:
    return GoalObservation(gym.make(env_id, **kwargs), tolerance)


@pytest.mark.parametrize("env_id", IDS)
def test_goals_are_tip_and_target_and_the_rest_does_not_see_the_target(env_id: str) -> None:
    env = goals(env_id)
    check_env(env)
    if env_id.startswith("flexarm/"):
        env.reset(seed=4)
    else:  # two episodes that differ in their target only
        (one, _), (two, _) = (env.reset(seed=4, options={"target": place(env, at)}) for at in (0.4, 0.6))
        assert np.array_equal(one["observation"], two["observation"])
        assert np.array_equal(one["achieved_goal"], two["achieved_goal"])
        assert not np.array_equal(one["desired_goal"], two["desired_goal"])
    seen, _, _, _, info = env.step(np.full(env.action_space.shape, 0.3, np.float32))
    np.testing.assert_allclose(seen["achieved_goal"] * env.length, info["tip_position"], atol=1e-6)
    np.testing.assert_allclose(seen["desired_goal"] * env.length, info["target"], atol=1e-6)


def place(env: GoalObservation, share: float) -> np.ndarray:
    """A target on the x axis, m, in space at the shoulder's height."""
    where = np.zeros(env.goal.shape)
    where[0] = share * env.length
    if len(where) == 3:
        where[2] = 0.4 * env.length
    return where


def test_the_reward_is_paid_within_the_tolerance() -> None:
    env = goals(tolerance=0.05)
    rows, here = np.array([[0.0, 0.049], [0.0, 0.051], [0.03, 0.03], [3.0, 0.0]]), np.zeros((4, 2))
    assert env.compute_reward(rows, here, [{}] * 4).tolist() == [1.0, 0.0, 1.0, 0.0]
    tip = env.reset(seed=2)[1]["tip_position"]
    env.reset(seed=2, options={"target": tip})
    assert env.step(np.zeros(2, np.float32))[1] == 1.0
    assert goals().tolerance == 0.01 and goals(success={"position": 0.03}).tolerance == 0.03


def test_hindsight_replay_trains_on_it() -> None:
    env = goals(duration=0.5)
    settings: dict[str, Any] = {"learning_starts": 50, "batch_size": 32, "policy_kwargs": {"net_arch": [16]}}
    model = SAC("MultiInputPolicy", env, replay_buffer_class=HerReplayBuffer, seed=0, **settings)
    model.learn(150)
    assert model.num_timesteps == 150 and env.action_space.contains(model.predict(env.reset(seed=1)[0])[0])


def test_what_has_no_goal_point_is_refused() -> None:
    says('of this package with task="reach", not one with task="slew"', lambda: goals("FlexibleArm-v0"))
    says('not one with task="track"', lambda: goals(task="track"))
    says("not one of another package", lambda: GoalObservation(gym.make("CartPole-v1")))
    says("needs entries besides the target's, not only to_target_x", lambda: goals(observation=["to_target_x"]))
    says("tolerance = -1.0: must be a positive number (of the arm's length)", lambda: goals(tolerance=-1.0))
