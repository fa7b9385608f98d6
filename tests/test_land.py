"""The task "land": target, reward and success from what happened; refusals; a controller that lands."""

import math
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from flexarm_env import control
from flexarm_env.control.force import largest_force
from flexarm_env.shapes import HalfSpace, Sphere
from tests.env_tools import assert_goes_back, assert_pair_same, pair
from tests.refusals import refusal

TURN = 2.0
C, S = math.cos(TURN), math.sin(TURN)
WALL: dict[str, Any] = {
    "obstacle": HalfSpace((0.7 * C, 0.7 * S), (-C, -S)).to_dict(), "stiffness": 3e3, "damping": 10.0, "friction": 0.3,
}  # fmt: skip
LOW: dict[str, Any] = {"path": 0.3, "speed": 0.5, "impulse": 1.0}


def test_the_target_rests_on_the_wall_on_both_sides() -> None:
    env: Any = gym.make("TwoLinkFlexArm-v0", task="land", reference={"offset": (0.05, 0.1)})
    sides = set()
    for seed in range(12):
        _, info = env.reset(seed=seed)
        x, y = info["target"]
        assert x == pytest.approx(0.7, abs=1e-12)
        assert 0.05 <= abs(y) <= 0.1
        sides.add(y > 0.0)
        for _ in range(3):
            *_, info = env.step(np.zeros(2, np.float32))
        assert info["target"] == pytest.approx((x, y), abs=1e-12)
    assert sides == {True, False}


@pytest.mark.parametrize("impulse", [1.0, 0.004])
def test_reward_and_success_follow_from_what_happened(impulse: float) -> None:
    """Computed again from infos, at a wall that is turned about the root; impulse: bound of a period's impulse, N s."""
    bands = {**LOW, "impulse": impulse}
    env: Any = gym.make(
        "TwoLinkFlexArm-v0", task="land", contacts=WALL, success=bands, duration=1.6, joint_limits=None,
        observation=["hub_rate", "tip_force_normal"],
    )  # fmt: skip
    env.reset(seed=1)
    weights = dict(zip(env.unwrapped.plan.kind.rewards, env.unwrapped.plan.record.weights.tolist(), strict=True))
    hardest, held = 0.0, 0
    for _ in range(80):
        _, reward, _, _, info = env.step(np.array([0.0, -0.5], np.float32))
        e = abs(float((info["target"] - info["tip_position"]) @ (-S, C)))
        assert info["reward_accuracy"] == pytest.approx(weights["accuracy"] * math.exp(-((e / 0.01) ** 2)), abs=1e-9)
        own = min(info["contact_impulse"] / impulse, 1.0)
        assert info["reward_impulse"] == pytest.approx(-weights["impulse"] * own, abs=1e-12)
        assert (info["reward_settle"] > 0.0) == (info["contact_force"] > 0.0)
        assert info["reward_settle"] <= weights["settle"] / (1.0 + (e / 0.3) ** 4) + 1e-12
        hardest = max(hardest, info["contact_impulse"])
        # speed from the term `settle`; success: 0.5 s in contact within all bounds, both instants at the ends included
        r2 = math.sqrt(max(weights["settle"] / max(info["reward_settle"], 1e-12) - 1.0, 0.0))
        v = 0.5 * math.sqrt(max(r2 - (e / 0.3) ** 2, 0.0))
        held = held + 1 if info["contact_force"] > 0.0 and e < 0.3 and v < 0.5 and hardest < impulse else 0
        assert info["is_success"] == (held >= 26)
        assert reward == pytest.approx(sum(v for k, v in info.items() if k.startswith("reward_")), abs=1e-12)
    assert hardest > 0.004


def test_a_controller_lands_and_zero_torque_does_not() -> None:
    env = gym.make_vec("TwoLinkFlexArm-v0", num_envs=3, task="land")
    own = control.make("hybrid_force", env)
    bound = largest_force(env.unwrapped.plan.arm) * 0.02
    for acts in (True, False):
        observation, _ = env.reset(seed=5)
        own.reset(observation)
        hardest, held = np.zeros(3), np.zeros(3)
        for _ in range(env.unwrapped.plan.limit):
            action = own.act(observation) if acts else np.zeros((3, 2), np.float32)
            observation, _, _, _, info = env.step(action)
            hardest = np.maximum(hardest, info["contact_impulse"])
            held = np.where(info["contact_force"] > 0.0, held + 1, 0)
        assert info["is_success"].tolist() == [acts] * 3
        if acts:
            assert (hardest < bound).all()
            assert (held > 25).all()


@pytest.mark.slow
def test_a_vector_lands_as_single_arms_do() -> None:
    keywords: dict[str, Any] = {"task": "land", "duration": 1.0, "sensors": {"noise": 0.01}}
    both = pair("TwoLinkFlexArm-v0", 9, **keywords)
    assert assert_pair_same(both, 60, scale=0.6) > 0
    env = gym.make("TwoLinkFlexArm-v0", **keywords)
    env.reset(seed=0)
    assert_goes_back(env, scale=0.2)


def test_three_links_land_too() -> None:
    env = gym.make("MultiLinkFlexArm-v0", task="land")
    _, info = env.reset(seed=0)
    assert np.hypot(*info["tip_position"]) < np.hypot(*info["target"])


@pytest.mark.parametrize(
    ("env_id", "keywords", "words"),
    [
        ("FlexibleArm-v0", {}, "task = 'land'"),
        ("SpatialFlexArm-v0", {}, "task = 'land'"),
        ("TwoLinkFlexArm-v0", {"contacts": {**WALL, "obstacle": Sphere((0.7, 0.0), 0.1).to_dict()}}, "a half-space"),
        ("TwoLinkFlexArm-v0", {"reference": {"speed": (0.0, 0.1)}}, "reference.speed"),
        ("TwoLinkFlexArm-v0", {"reference": {"force": (0.1, 0.2)}}, "force"),
        ("TwoLinkFlexArm-v0", {"reference": {"offset": (0.0, 0.9)}}, "reference.offset"),
    ],
)  # fmt: skip
def test_what_is_refused(env_id: str, keywords: dict[str, Any], words: str) -> None:
    assert words in refusal(lambda: gym.make(env_id, task="land", **keywords), Exception)
