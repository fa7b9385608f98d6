"""Reward and success of every task, from the formula that docs/suite.md has, on recorded episodes: NumPy alone, from
tips, deflections, targets and actions."""

import math
from typing import Any

import numpy as np
import pytest

from flexarm_env import suite
from flexarm_env.physics.layout import SPACE_POSE

AT_WALL = ("press-v1", "land-v1", "wipe-v1")  # formulas: test_press.py, test_press_space.py, test_land.py
TASKS = [task for task in suite.tasks(earlier=True) if task.id not in AT_WALL]
QUICK = ("catch-v1", "slew-geared-v2")


def record(task: suite.Task, seed: int) -> dict[str, np.ndarray]:
    """An episode under rough actions that come near the target now and then: what is to be seen at each instant."""
    env = suite.make(task.id)
    env.reset(seed=seed)
    batch, rng, action, rows = env.unwrapped.batch, np.random.default_rng(seed), 0.0, []
    for _ in range(env.unwrapped.plan.limit):
        pull = rng.normal(size=env.action_space.shape)
        action = np.clip(0.9 * action + 0.4 * pull, -1.0, 1.0).astype(np.float32)
        _, reward, terminated, _, info = env.step(action)
        view = batch.view(0)
        turned = 0.0 if env.unwrapped.plan.arm.base is None else view.q[-1]
        rows.append((view.poses, view.target, action.astype(float), turned, reward, info["is_success"], terminated))
        if terminated:
            break
    names = ("poses", "target", "action", "turned", "reward", "success", "failed")
    return dict(zip(names, map(np.array, zip(*rows, strict=True)), strict=True))


def bends(poses: np.ndarray, lengths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(n, N): tips less roots normal to the tangents at the roots, over the lengths, and their rates."""
    x, y, angle, vx, vy, rate, tx, ty, _, tvx, tvy, _ = np.moveaxis(poses, -1, 0)
    c, s = np.cos(angle), np.sin(angle)
    along = c * (tx - x) + s * (ty - y)
    normal = c * (ty - y) - s * (tx - x)
    return normal / lengths, (c * (tvy - vy) - s * (tvx - vx) - rate * along) / lengths


def held(good: np.ndarray, period: float, hold: float, once: bool) -> np.ndarray:
    """Success: good throughout the trailing `hold` s, the instants at both ends of it included."""
    count, out, need = 0, [], math.ceil(hold / period - 1e-9) + 1
    for one in good:
        count = count if once and count >= need else count + 1 if one else 0
        out.append(count >= need)
    return np.array(out)


def told(task: suite.Task, seen: dict[str, np.ndarray], first: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Reward and success of each period. first: the target at the episode's start."""
    env: Any = suite.make(task.id).unwrapped
    arm, period, given = env.plan.arm, env.plan.period, task.keywords.get("success", {})
    weight = {"accuracy": 0.5, "distance": 0.5, "vibration": 0.02, "change": 0.0, "attitude": 0.5}
    weight |= task.keywords.get("reward", {})
    paid = given.get("paid", False)
    lengths = np.array([link.span for link in arm.links])
    L, poses, action, space = lengths.sum(), seen["poses"], seen["action"], arm.spatial
    shaking = 0.0 if space else np.minimum((bends(poses, lengths)[1] ** 2).sum(axis=1), 1.0)
    first_tip, first_speed = (SPACE_POSE.tip, SPACE_POSE.velocity) if space else (6, 9)
    tip, speed = (poses[:, -1, k : k + (3 if space else 2)] for k in (first_tip, first_speed))
    moving = velocity(env, seen) if task.keywords.get("task") == "track" else np.zeros_like(seen["target"])
    if len(first) == 1:
        start = np.unwrap(np.arctan2(tip[:, 1], tip[:, 0]))
        start += 2 * math.pi * np.round((poses[0, 0, 2] - start[0]) / (2 * math.pi))
        e, way, turns = seen["target"][:, 0] - start, 1.0, task.keywords.get("turns") == "any"
        if turns:
            e, way = (e + math.pi) % (2 * math.pi) - math.pi, math.pi
        slip = (tip[:, 0] * speed[:, 1] - tip[:, 1] * speed[:, 0]) / (tip**2).sum(axis=1) - moving[:, 0]
        good = (np.abs(e) < given.get("position", math.radians(1.0))) & (
            np.abs(bends(poses, lengths)[1][:, 0]) < given.get("vibration", math.inf if paid else 0.01)
        )
        good &= np.abs(slip) < given.get("speed", math.inf)
        settle, price = np.exp(-((e / 0.02) ** 2) - (slip / 0.2) ** 2), weight["vibration"]
    else:
        e, way, price = np.linalg.norm(seen["target"] - tip, axis=1) / L, 1.0, 0.0
        slip = np.linalg.norm(speed - moving, axis=1) / L
        good = (e < given.get("position", 0.01)) & (slip < given.get("speed", 0.05))
        settle = np.exp(-((e / 0.02) ** 2) - (slip / 0.1) ** 2)
    turned, level = np.abs(seen["turned"]), given.get("attitude", math.inf)
    good &= turned < level
    if paid:
        square = (e / given["position"]) ** 2 + (slip / given["speed"]) ** 2 + (turned / level) ** 2
        settle = 1.0 / (1.0 + square**2)
    change = np.diff(action, axis=0, prepend=np.zeros((1, action.shape[1])))
    reward = weight["accuracy"] * np.exp(-((e / 0.1) ** 2)) + settle
    reward -= weight["distance"] * np.minimum(np.abs(e) / way, 1.0) + weight["change"] * (change**2).sum(axis=1)
    reward -= weight["attitude"] * np.minimum(turned**2, 1.0)
    reward -= 0.01 * (action**2).sum(axis=1) + price * shaking + 5.0 * seen["failed"]
    return reward, held(good, period, given.get("hold", 0.5), given.get("once", False))


def velocity(env: Any, seen: dict[str, np.ndarray]) -> np.ndarray:
    """Of a target on a straight line, a circle or a swing, from its places, exactly."""
    target, T = seen["target"], env.plan.period
    if env.plan.kind.target.numbers == 1:
        way = np.diff(target[:, 0])
        twice = (way[2:] + way[:-2]) @ way[1:-1] / (way[1:-1] @ way[1:-1])  # 2 cos(omega T)
        omega = math.acos(0.5 * twice)  # rad a period
        inner = (way[1:] + way[:-1]) * (0.5 * omega / math.sin(omega) / T)
        ends = twice * inner[0] - inner[1], twice * inner[-1] - inner[-2]
        return np.concatenate([ends[:1], inner, ends[1:]])[:, None]
    if env.plan.extras.reference.line is not None:
        return np.repeat(np.diff(target[:2], axis=0) / T, len(target), axis=0)
    a, b = target[1] - target[0], target[2] - target[1]
    turn = math.atan2(a[0] * b[1] - a[1] * b[0], a @ b)
    chord = 0.5 * turn / math.sin(0.5 * turn) / T
    c, s = math.cos(-0.5 * turn), math.sin(-0.5 * turn)
    steps = np.vstack([np.diff(target, axis=0), [[0.0, 0.0]]]) @ np.array([[c, s], [-s, c]]) * chord
    c, s = math.cos(turn), math.sin(turn)
    steps[-1] = np.array([[c, -s], [s, c]]) @ steps[-2]
    return steps


@pytest.mark.parametrize(
    "task", [pytest.param(t, marks=() if t.id in QUICK else pytest.mark.slow, id=t.id) for t in TASKS]
)
def test_reward_and_success_follow_from_the_documented_formula(task: suite.Task) -> None:
    for seed in range(2):
        seen = record(task, seed)
        reward, success = told(task, seen, seen["target"][0])
        np.testing.assert_allclose(seen["reward"], reward, atol=1e-8)
        np.testing.assert_array_equal(seen["success"], success & ~seen["failed"])


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*changes the task:UserWarning")
@pytest.mark.parametrize("once", [False, True])
def test_a_success_is_kept_once_it_is_one(once: bool) -> None:
    """A target that stands still where the arm is: good at once, and until it is pushed away."""
    env: Any = suite.make(
        "slew-limited-v2", task="track", reference={"path": "line", "behind": [0.0, 0.0], "rate": [0.0, 0.0]},
        success={"hold": 0.2, "once": once, "speed": 0.5},
    )  # fmt: skip
    env.reset(seed=0)
    found = [env.step(np.array([0.0 if k < 20 else 1.0], np.float32))[-1]["is_success"] for k in range(60)]
    assert found[9:20] == [True] * 11 and not any(found[:9]) and found[-1] == once
