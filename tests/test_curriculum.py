"""Ranges of starts that change while an environment is used."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from flexarm_env import arms
from flexarm_env.envs.options import plan
from flexarm_env.envs.task import CHAIN, REACH
from tests.refusals import refuses

NEAR = {"angles": [(0.0, 0.1)], "target": (0.05, 0.1)}


def test_joints_start_within_half_a_radian_and_further_by_rules_1() -> None:
    """Rules 2 change no other draw. `starts` gives the ranges of rules 1."""
    usual, former = (plan(REACH, rules=rules).starts for rules in (2, 1))
    assert usual.start == [(-0.5, 0.5)] * 2 and former.start == [(-1.0, 1.0), (-1.8, 1.8)]
    assert (usual.target, usual.straight) == (former.target, former.straight)
    given = {"angles": former.start, "straight": former.straight}
    assert plan(REACH, starts=given).starts.start == former.start
    ranges = [CHAIN.starts(arms.named("three_strips"), rules).start[1:] for rules in (2, 1)]
    assert ranges == [[(-0.5, 0.5)] * 2, [(-1.2, 1.2)] * 2]
    # attribute `starts`: empty ranges are those of the environment's rules
    for rules, widest in ((1, 1.8), (2, 0.5)):
        env: Any = gym.make("TwoLinkFlexArm-v0", rules=rules)
        env.unwrapped.starts = {}
        assert env.unwrapped.plan.starts.start[1] == (-widest, widest)


def test_starts_set_hold_from_the_next_reset_on() -> None:
    env: Any = gym.make("FlexibleArm-v0")
    one = env.unwrapped
    assert one.starts == {}
    env.reset(seed=0)
    first = env.step(np.ones(1, np.float32))[0]
    one.starts = NEAR
    assert one.starts == NEAR and env.spec.kwargs["starts"] == NEAR
    again = env.step(np.ones(1, np.float32))[0]  # the episode that runs goes on
    assert abs(again - first).max() > 0.0
    angles = []
    for _ in range(30):
        seen, info = env.reset()
        angles.append(np.arctan2(seen[0], seen[1]))
        assert 0.05 - 1e-6 <= info["target"] - angles[-1] <= 0.1 + 1e-6
    assert min(angles) >= 0.0 and max(angles) <= 0.1 + 1e-6
    fresh = gym.make("FlexibleArm-v0", starts=NEAR)
    for seed in range(3):
        assert np.array_equal(env.reset(seed=seed)[0], fresh.reset(seed=seed)[0])
    refuses("starts.absolute", lambda: setattr(one, "starts", {**NEAR, "absolute": True}))
    refuses("starts.target", lambda: setattr(one, "starts", {"target": 3.0}))


@pytest.mark.slow
def test_ranges_that_lead_out_of_reach_are_checked_from_then_on() -> None:
    """Another form of the program is needed then; episodes that run go on in it."""
    limits = {"joint_limits": [None, (-1.0, 1.0)]}
    env: Any = gym.make_vec("TwoLinkFlexArm-v0", num_envs=8, vectorization_mode="vector_entry_point", **limits,
                            starts={"target": ((0.92, 0.95), (-1.0, 1.0))})  # fmt: skip
    same: Any = gym.make_vec("TwoLinkFlexArm-v0", num_envs=8, vectorization_mode="vector_entry_point", **limits,
                             starts={"target": ((0.92, 0.95), (-1.0, 1.0))})  # fmt: skip
    for one in (env, same):
        one.reset(seed=0)
    assert env.unwrapped.plan.starts.attainable is None
    env.unwrapped.starts = {"target": ((0.6, 0.95), (-1.0, 1.0))}
    assert env.unwrapped.plan.starts.attainable is not None
    push = np.full((8, 2), 0.2, np.float32)
    for _ in range(5):
        assert all(np.array_equal(a, b) for a, b in zip(env.step(push)[:4], same.step(push)[:4], strict=True))
    _, info = env.reset(seed=1)
    distances = np.linalg.norm(info["target"], axis=1)
    assert distances.min() >= np.hypot(0.5 + 0.5 * np.cos(1.0), 0.5 * np.sin(1.0)) - 1e-9


def test_set_attr_applies_or_is_refused() -> None:
    """`set_attr("starts", ...)` was accepted, given back by `get_attr`, and had no effect."""
    pytest.importorskip("stable_baselines3")
    from flexarm_env.sb3 import make_sb3_vec

    for mode in ("vector_entry_point", "sync"):
        env = make_sb3_vec("FlexibleArm-v0", 3, seed=0, vectorization_mode=mode)
        env.set_attr("starts", NEAR)
        assert env.get_attr("starts") == [NEAR] * 3
        seen = env.reset()
        assert (seen[:, 5] >= 0.05 - 1e-6).all() and (seen[:, 5] <= 0.1 + 1e-6).all()
        refuses("attr_name = 'duration': must be given when", lambda env=env: env.set_attr("duration", 2.0))
        env.close()
