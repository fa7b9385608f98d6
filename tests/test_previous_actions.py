"""Entries of the observation that hold previous actions."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import flexarm_env  # noqa: F401  (registers)
from flexarm_env.control import Setup
from tests.refusals import refuses

NAMES = ("hub_sin", "previous_action_2", "hub_cos", "previous_action_1")


def test_they_are_the_actions_of_the_period_before() -> None:
    """Clipped, 0 at a start, without the noise and the delay of other entries, the oldest first; single as vector."""
    keywords: dict[str, Any] = {"observation": NAMES, "history": 3, "sensors": {"noise": 0.1, "delay": 0.04}}
    one = gym.make("TwoLinkFlexArm-v0", **keywords)
    many = gym.make_vec("TwoLinkFlexArm-v0", num_envs=9, vectorization_mode="vector_entry_point", **keywords)
    seen, _ = one.reset(seed=4)
    rows, _ = many.reset(seed=[4, *range(10, 18)])
    assert np.array_equal(seen, rows[0]) and not seen.reshape(3, 4)[:, [1, 3]].any()
    rng, done = np.random.default_rng(0), np.zeros((3, 2))
    for _ in range(6):
        actions = rng.uniform(-1.5, 1.5, (9, 2)).astype(np.float32)
        seen, rows = one.step(actions[0])[0], many.step(actions)[0]
        done = np.concatenate([done[1:], np.clip(actions[:1], -1.0, 1.0)])
        assert np.array_equal(seen, rows[0])
        assert np.array_equal(seen.reshape(3, 4)[:, [3, 1]], done.astype(np.float32))
        assert np.array_equal(rows.reshape(9, 3, 4)[:, -1, [3, 1]], np.clip(actions, -1.0, 1.0))
    assert one.observation_space.high.reshape(3, 4)[0].tolist() == [10.0, 1.0, 10.0, 1.0]
    assert Setup.of(one).noise == pytest.approx((0.1, 0.0, 0.1, 0.0))


def test_what_does_not_go_with_them() -> None:
    refuses("sensors.noise", lambda: gym.make(
        "TwoLinkFlexArm-v0", observation=NAMES, sensors={"noise": {"previous_action_1": 0.1}}))  # fmt: skip
    refuses(r"previous_action_3'", lambda: gym.make("TwoLinkFlexArm-v0", observation=("previous_action_3",)))
    from flexarm_env.derivatives import Arms

    refuses("previous_action", lambda: Arms("TwoLinkFlexArm-v0", 2, observation=NAMES))
