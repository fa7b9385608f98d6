"""The task "press": wall, path and commanded force; reward and success from what happened; refusals."""

import math
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from flexarm_env.envs.pictures import renderer
from flexarm_env.shapes import HalfSpace, Sphere
from tests.env_tools import assert_goes_back, assert_pair_same, pair
from tests.refusals import refusal

FAR, BEHIND = HalfSpace((2.0, 0.0), (-1.0, 0.0)).to_dict(), HalfSpace((0.7, 0.0), (1.0, 0.0)).to_dict()
WALL: dict[str, Any] = {"obstacle": HalfSpace((0.7, 0.0), (-1.0, 0.0)).to_dict(), "stiffness": 2e4, "friction": 0.3}


def pressed(env: Any, torque: float, periods: int) -> list[dict[str, Any]]:
    """Infos of an arm whose elbow pushes the tip to the wall while the hub rests."""
    found = []
    for _ in range(periods):
        *_, terminated, _, info = env.step(np.array([0.0, torque], np.float32))
        found.append(info)
        if terminated:
            break
    return found


def test_the_path_is_on_the_wall_and_the_force_within_its_range() -> None:
    env: Any = gym.make("TwoLinkFlexArm-v0", task="press", reference={"force": (0.1, 0.2), "speed": (0.02, 0.03)})
    plan = env.unwrapped.plan
    at = [plan.names.index(name) for name in ("target_force", "tip_force_normal")]
    for seed in range(5):
        seen, info = env.reset(seed=seed)
        start = info["target"]
        assert start[0] == pytest.approx(0.7, abs=1e-12)
        assert 0.1 <= info["target_force"] <= 0.2
        assert seen[at[0]] * plan.scales[at[0]] == pytest.approx(info["target_force"], rel=1e-6)
        assert info["tip_position"][0] < 0.65
        for _ in range(10):
            *_, info = env.step(np.zeros(2, np.float32))
        assert info["target"][0] == pytest.approx(0.7, abs=1e-12)
        assert 0.02 <= abs(info["target"][1] - start[1]) / 0.2 <= 0.03


@pytest.mark.parametrize("turn", [0.0, 2.0])
def test_reward_and_success_follow_from_force_and_path(turn: float) -> None:
    """Computed again from infos; a wall that is turned about the root changes nothing."""
    c, s = math.cos(turn), math.sin(turn)
    wall = {**WALL, "obstacle": HalfSpace((0.7 * c, 0.7 * s), (-c, -s)).to_dict()}
    bands = {"force": 30.0, "path": 0.2}
    given: dict[str, Any] = {"contacts": wall, "success": bands, "duration": 1.2, "joint_limits": None}
    env: Any = gym.make("TwoLinkFlexArm-v0", task="press", **given)
    env.reset(seed=1)
    infos = pressed(env, -0.5, 60)
    weights = dict(zip(env.unwrapped.plan.kind.rewards, env.unwrapped.plan.record.weights.tolist(), strict=True))
    squares, farthest, touched = 0.0, 0.0, 0
    for k, info in enumerate(infos, 1):
        f = (info["contact_force"] - info["target_force"]) / info["target_force"]
        e = abs(float((info["target"] - info["tip_position"]) @ (-s, c)))
        touched += info["contact_force"] > 0.0
        assert info["reward_force"] == pytest.approx(weights["force"] * math.exp(-((f / 0.25) ** 2)), abs=1e-9)
        assert info["reward_accuracy"] == pytest.approx(weights["accuracy"] * math.exp(-((e / 0.01) ** 2)), abs=1e-9)
        assert info["reward_settle"] == pytest.approx(
            weights["settle"] / (1.0 + ((e / 0.2) ** 2 + (f / 30.0) ** 2) ** 2), rel=1e-9
        )
        if k > 20:
            squares, farthest = squares + f * f, max(farthest, e)
        good = k > 20 and squares / (k - 20) < 30.0**2 and farthest < 0.2
        assert info["is_success"] == good
    assert touched > 0
    assert infos[-1]["is_success"]


def test_a_commanded_force_has_a_visible_arrow() -> None:
    """Longer than the mark of the payload, about 2 % of the reach: at least a tenth of the reach."""
    env: Any = gym.make("TwoLinkFlexArm-v0", task="press")
    plan = env.unwrapped.plan
    pen = renderer(plan, "rgb_array")
    low, high = (plan.extras.reference.ranges[k] for k in (8, 9))
    for force in (low, high):
        pen.touches = np.array([[0.7, 0.0, 0.0, -force, 0.0, 0.0, force]])
        ((start, end),) = pen.arrows()
        assert 0.1 < np.linalg.norm(end - start) / plan.arm.total_length < 0.4


def test_a_vector_presses_as_single_arms_do() -> None:
    keywords: dict[str, Any] = {"task": "press", "duration": 1.0, "sensors": {"noise": 0.01}}
    both = pair("TwoLinkFlexArm-v0", 9, **keywords)
    assert assert_pair_same(both, 60, scale=0.6) > 0
    env = gym.make("TwoLinkFlexArm-v0", **keywords)
    env.reset(seed=0)
    assert_goes_back(env, scale=0.2)


def test_three_links_press_too() -> None:
    env = gym.make("MultiLinkFlexArm-v0", task="press")
    _, info = env.reset(seed=0)
    assert info["target_force"] > 0.0
    assert np.hypot(*info["tip_position"]) < np.hypot(*info["target"])


@pytest.mark.parametrize(
    ("env_id", "keywords", "words"),
    [
        ("FlexibleArm-v0", {}, "task = 'press'"),
        ("TwoLinkFlexArm-v0", {"contacts": {**WALL, "obstacle": Sphere((0.7, 0.0), 0.1).to_dict()}}, "a half-space"),
        ("TwoLinkFlexArm-v0", {"contacts": {**WALL, "bodies": ["joint1"]}}, "for the tip"),
        ("TwoLinkFlexArm-v0", {"contacts": {**WALL, "obstacle": FAR}}, "0.85 m"),
        ("TwoLinkFlexArm-v0", {"contacts": {**WALL, "obstacle": BEHIND}}, "outside"),
        ("TwoLinkFlexArm-v0", {"reference": {"distance": (0.5, 0.6)}}, "reference.distance"),
        ("TwoLinkFlexArm-v0", {"reference": {"force": (0.0, 0.1)}}, "reference.force"),
        ("TwoLinkFlexArm-v0", {"reference": {"mu": 1.0}}, "mu"),
        ("TwoLinkFlexArm-v0", {"base": {"mass": 10.0, "inertia": 1.0}}, "task = 'press'"),
        ("TwoLinkFlexArm-v0", {"duration": "long"}, "duration = 'long'"),
    ],
)  # fmt: skip
def test_what_is_refused(env_id: str, keywords: dict[str, Any], words: str) -> None:
    assert words in refusal(lambda: gym.make(env_id, task="press", **keywords), Exception)


def test_a_reset_commands_the_force() -> None:
    """In a single and a vector environment; path and start are those of a drawn force, and the next one is drawn."""
    env: Any = gym.make("TwoLinkFlexArm-v0", task="press")
    usual = env.reset(seed=3)[1]
    info = env.reset(seed=3, options={"force": 0.75})[1]
    assert info["target_force"] == 0.75 != usual["target_force"]
    for name in ("target", "tip_position"):
        assert np.array_equal(info[name], usual[name])
    assert env.reset(seed=3)[1]["target_force"] == usual["target_force"]
    several: Any = gym.make_vec("TwoLinkFlexArm-v0", num_envs=3, task="press")
    assert (several.reset(seed=3, options={"force": 0.75})[1]["target_force"] == 0.75).all()
    assert "options.force = -1.0: must be" in refusal(lambda: env.reset(options={"force": -1.0}))
    other: Any = gym.make("TwoLinkFlexArm-v0")
    assert 'options.force = 1.0: must be given with task="press" only' in refusal(
        lambda: other.reset(options={"force": 1.0})
    )
