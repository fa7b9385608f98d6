"""A return in a task with its slope by the actions, as `agents.foresight` climbs it.

What a task takes for its cost is differentiated here (`Fine`), arms to which something comes that is drawn on the way
move in the task itself (`InTask`), and arms that the least change of an early action would send elsewhere are pulled
back to their way (`Steady`).
"""

import re
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from flexarm_env import suite
from flexarm_env.suite.policies import choose
from flexarm_env.validation import Array

SPACE = "SpatialFlexArm-v0"
LIFT = 0.3
"""m that an arm has to rise by, to be over a shape, for what its price is; see `Fine`."""
NUDGE = 1e-3
"""By how much of the limits a first action is off, where ways of steadying are compared."""


class Fine:
    """What a task takes for its cost: price times the periods at whose end a tip's deflection over L passes the limit,
    or the arm in space is inside a shape.

    The slope by a deflection is that of a step that is somewhat rounded off. Of shapes the cost itself is rounded, and
    half of it stands `OFF` m before them, so that what is found stays outside. Looked at are points on the straight
    lines between the sections that the state holds. Within a wall no slope leads over it: `lifting` prices, of the
    point that has to rise most to be over a shape, by how much. ValueError for another kind of cost.
    """

    ROUNDED, SOFT, OFF = 0.03, 0.005, 0.012

    def __init__(self, task: suite.Task, plan: Any, names: Sequence[str] = (), lifting: bool = False) -> None:
        cost, self.lifting = task.keywords.get("cost", {}), lifting
        self.shapes = plan.keep_out if "keep_out" in task.keywords else ()
        if task.price and set(cost) != {"deflection"} and not (self.shapes and not cost and plan.arm.spatial):
            raise ValueError(f"{task.id}: no slope of costs but of the deflection's, and of shapes in space")
        self.price, self.limit = task.price, float(cost.get("deflection", 1.0))
        self.places = [k for k, name in enumerate(plan.names) if re.fullmatch(r"tip_deflection(_\d+)?", name)]
        self.scales = np.array([plan.scales[k] for k in self.places])
        if self.shapes:
            rows, row = [], 6  # behind the root's; of each section, place and turn
            counts = np.broadcast_to(plan.settings.elements, plan.arm.n_links)
            for link, count in zip(plan.arm.links, counts, strict=True):
                own = [row + 1 + 6 * k for k in range(1 if link.rigid else count)]
                rows, row = rows if link.rigid else [*rows, *own], own[-1] + 6
            self.sections = np.array([[names.index(f"q[{row + d}]") for d in range(3)] for row in rows])
            at = np.linspace(0.0, len(rows) - 1.0, 5 * len(rows) - 4)
            self.weights = np.maximum(0.0, 1.0 - np.abs(at[:, None] - np.arange(len(rows))))

    def __call__(self, seen: Array, state: Array) -> tuple[Array, Array, Array | float]:
        """Of observations (n, O) and states (n, S): what is taken (n,), and its slopes (n, O) and (n, S)."""
        slope = np.zeros_like(seen)
        if self.shapes:
            value, way = self.nearest(self.weights @ state[:, self.sections])
            by_state = np.zeros_like(state)
            by_state[:, self.sections] = self.price * self.weights.T @ way
            return self.price * value, slope, by_state
        bends = seen[:, self.places] * self.scales
        over = np.abs(bends) > self.limit
        near = np.exp(-(((np.abs(bends) - self.limit) / (self.ROUNDED * self.limit)) ** 2))
        slope[:, self.places] = self.price * near * np.sign(bends) * self.scales / (self.ROUNDED * self.limit)
        return self.price * over.any(axis=1), slope, 0.0

    def nearest(self, points: Array) -> tuple[Array, Array]:
        """Of arms' points (n, P, 3), m: cost (n,) over the price, of one of them, and its slope (n, P, 3)."""
        soft, flat, cost, every = self.SOFT, points.copy(), [], np.arange(len(points))
        for shape in self.shapes:
            if self.lifting:  # how far inside, seen from above
                soft, flat[..., 2] = 3.0 * self.SOFT, shape.place[2]
            far, way = shape.look(flat)
            within = 1.0 / (1.0 + np.exp(np.clip((far - self.OFF) / soft, -500.0, 500.0)))
            slope = (-within * (1.0 - within) / soft)[..., None] * way
            if self.lifting:
                below = np.maximum(shape.place[2] + shape.sizes[-1] + self.OFF - points[..., 2], 0.0) / LIFT
                slope = slope * [1.0, 1.0, 0.0] * below[..., None]
                slope[..., 2] = np.where(below > 0.0, -within / LIFT, 0.0)
                within = within * below
            cost.append((within, slope))
        value, slopes = (np.concatenate(x, axis=1) for x in zip(*cost, strict=True))
        most = value.argmax(axis=1)
        kept = np.zeros_like(points)
        kept[every, most % points.shape[1]] = slopes[every, most]
        return value[every, most], kept


class InTask:
    """Arms to which something comes that is drawn on the way: they move in the task itself, which draws it, and are
    differentiated at the very states that they are in there. `step` and `vjp` are as those of `derivatives.Arms`."""

    def __init__(self, arms: Any, seeds: Sequence[int]) -> None:
        self.arms, self.n, self.vjp, self.observe, self.seeds = arms, arms.n, arms.vjp, arms.observe, seeds
        self.first, self.failed = arms.names.index("periods"), np.zeros(arms.n, bool)

    def step(self, state: Array, action: Array) -> tuple[Array, Array, Array]:
        """The next period of the episodes, from the first one on."""
        env = self.arms.environment
        if state[0, self.first] == 0.0:
            env.reset(seed=self.seeds)
            self.past = np.zeros(self.n, bool)
        seen, reward, terminated, _, _ = env.step(action.astype(np.float32))
        self.past |= terminated
        return self.arms.states(), seen.astype(float), reward.copy()


class Steady:
    """Pulls arms back to the way that they had under actions (T, n, N) from states `start`, as a policy would that sees
    all there is: linear about that way, 0 on it. What is searched in space is added to it, for under actions alone the
    least change of an early one sends such an arm elsewhere (by 1e-5 of the torque: most of the return is lost)."""

    def __init__(self, arms: Any, start: Array, actions: Array, policy: Any) -> None:
        state, seen = start, [arms.observe(start)]
        for action in actions[:-1]:
            state, after, _ = arms.step(state, action)
            seen.append(after)
        self.seen = np.array(seen)
        rows = self.seen.reshape(-1, self.seen.shape[-1]).astype(np.float32)
        sides = (0.01 * np.eye(rows.shape[1], dtype=np.float32))[:, None]
        slopes = [(policy.act(rows + side) - policy.act(rows - side)) / 0.02 for side in sides]
        self.slopes = np.stack(slopes, axis=2).reshape(*actions.shape, -1)

    def __call__(self, k: int, seen: Array) -> Array:
        """What is added to the actions of period k (n, N)."""
        return np.einsum("njo,no->nj", self.slopes[k], seen - self.seen[k])

    def back(self, k: int, slope: Array) -> Array:
        """Slopes by what was seen before period k (n, O), of those by its actions (n, N)."""
        return np.einsum("njo,nj->no", self.slopes[k], slope)


def returned(
    arms: Any, start: Array, wanted: Array, fine: Fine, steady: Steady | None = None, weight: Array | None = None,
    grid: float = 0.0,
) -> tuple[Array, Array, Array]:  # fmt: skip
    """J (n,) of actions (T, n, N), NaN where an episode would have ended; its slope by them; what was played, in parts
    of `grid` if there is one. weight: (T,), of the periods' rewards and costs; what comes after the last one that
    counts is not looked at."""
    counts = np.ones(len(wanted)) if weight is None else np.trim_zeros(weight, "b")
    states, taken, total, over = [start], [], np.zeros(arms.n), np.zeros(arms.n, bool)
    actions, seen = wanted.copy(), None if steady is None else arms.observe(start)
    for k, (action, count) in enumerate(zip(wanted, counts, strict=False)):
        if steady is not None:
            actions[k] = exact(np.clip(action + steady(k, seen), -1.0, 1.0))
        if grid:
            actions[k] = np.round(actions[k] * grid) / grid
        state, seen, reward = arms.step(states[-1], actions[k])
        cost, *slope = fine(seen, state)
        states.append(state)
        taken.append([count * one for one in slope])
        total += count * (reward - cost)
        over |= arms.failed | arms.past
    slopes = np.zeros_like(actions)
    back, ahead = np.zeros_like(start), 0.0
    for k in reversed(range(len(counts))):
        by_seen, by_state, one = *taken[k], np.full(arms.n, counts[k])
        back, slopes[k] = arms.vjp(states[k], actions[k], back - by_state, ahead - by_seen, one)
        if steady is not None:
            slopes[k] *= (np.abs(actions[k]) < 1.0) | (slopes[k] * actions[k] < 0.0)  # at a limit: the way back alone
            ahead = steady.back(k, slopes[k])
    return np.where(over, np.nan, total), slopes, actions


def exact(x: Array) -> Array:
    """As actions are handed on, in float32."""
    return x.astype(np.float32).astype(float)


def steadiers(task: suite.Task, env: Any, trained: Sequence[Path]) -> list[Any]:
    """Those of the policies (run folders) that see what an environment shows. ValueError where in space none does."""
    found = []
    for folder in trained:
        with suppress(ValueError):
            found.append(choose(str(folder), task).make(env))
    if trained and not found and task.environment == SPACE:
        raise ValueError(f"{task.id}: no policy that sees all there is and steadies arms in space")
    return found


def steadiest(arms: Any, start: Array, actions: Array, policies: Sequence[Any]) -> Steady:
    """The way of arms from states `start` under actions (T, n, N), each arm steadied by the one of the policies under
    which a first action that is `NUDGE` off leads away least."""
    ways = [Steady(arms, start, actions, policy) for policy in policies]
    away = []
    for steady in ways:
        state, seen, far = start, arms.observe(start), []
        for k, action in enumerate(actions):
            far.append(np.abs(seen - steady.seen[k]).max(axis=1))
            wanted = np.clip(action + steady(k, seen) + (NUDGE if k == 0 else 0.0), -1.0, 1.0)
            state, seen, _ = arms.step(state, exact(np.nan_to_num(wanted)))
        away.append(np.fmin(far, 1.0).mean(axis=0))
    for i, best in enumerate(np.argmin(away, axis=0)):
        ways[0].slopes[:, i] = ways[best].slopes[:, i]
    return ways[0]
