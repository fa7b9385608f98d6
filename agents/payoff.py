"""Return of a task and its derivatives by the actions, which `agents.foresight` maximizes.

`Fine` differentiates the task's cost. `InTask` steps arms with random events in the task's own environment. `Steady`
stabilizes arms whose motion a small change of an early action would change completely.
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
"""Height, m: a point inside a wall costs one price if it is this far below the wall's top; see `Fine`."""
NUDGE = 1e-3
"""Disturbance of the first action, over the torque limits, with which feedback laws are compared."""


class Fine:
    """Differentiable cost of a task: the price of each control period that ends with too large a deflection.

    In the plane a period costs one price if a link's deflection over its length exceeds the limit; derivatives are
    those of a smoothed step. In space a period costs one price if the arm is inside a shape at the period's end. The
    cost in space is a smoothed step, too, whose middle lies `OFF` m outside of the shape, so that optimized arms stay
    outside. The cost of shapes is evaluated at points on straight lines between the sections of the state. Inside a
    wall the gradient of the smoothed step does not lead over the wall. With `lifting` the cost of a point inside the
    wall is therefore the height, over `LIFT`, by which the point must rise to be above the wall. Other kinds of cost
    raise ValueError.
    """

    ROUNDED, SOFT, OFF = 0.03, 0.005, 0.012

    def __init__(self, task: suite.Task, plan: Any, names: Sequence[str] = (), lifting: bool = False) -> None:
        """Store the indices of the observation and state entries on which the task's cost depends.

        names: names of the state's entries, for shapes in space. lifting: use the cost by height, see the class. Raises
        ValueError for another kind of cost.
        """
        cost, self.lifting = task.keywords.get("cost", {}), lifting
        self.shapes = plan.keep_out if "keep_out" in task.keywords else ()
        if task.price and set(cost) != {"deflection"} and not (self.shapes and not cost and plan.arm.spatial):
            raise ValueError(f"{task.id}: only costs of deflection, and of shapes in space, have derivatives")
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
        """Return the cost (n,) and the derivatives of the cost by the observations (n, O) and by the states (n, S).

        seen (n, O): observations. state (n, S): states.
        """
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
        """Return the cost over the price (n,), and the derivatives of this ratio by the arms' points (n, P, 3), 1/m.

        The cost of an arm is the largest cost among the arm's points.
        """
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
    """Arms with random events, which the task's environment draws while it steps the arms.

    Derivatives are evaluated at the states that the environment reaches. `step` and `vjp` have the arguments of the
    methods of `derivatives.Arms`.
    """

    def __init__(self, arms: Any, seeds: Sequence[int]) -> None:
        self.arms, self.n, self.vjp, self.observe, self.seeds = arms, arms.n, arms.vjp, arms.observe, seeds
        self.first, self.failed = arms.names.index("periods"), np.zeros(arms.n, bool)

    def step(self, state: Array, action: Array) -> tuple[Array, Array, Array]:
        """Advance the episodes by one control period; the first call of an episode resets the environment."""
        env = self.arms.environment
        if state[0, self.first] == 0.0:
            env.reset(seed=self.seeds)
            self.past = np.zeros(self.n, bool)
        seen, reward, terminated, _, _ = env.step(action.astype(np.float32))
        self.past |= terminated
        return self.arms.states(), seen.astype(float), reward.copy()


class Steady:
    """Feedback that returns arms to the path on which actions (T, n, N) lead them from states `start`.

    The feedback is a linearized policy that observes the whole state; on the path the feedback is 0. Searches in space
    add the feedback to the actions. Without feedback even a change of an early action by 1e-5 of the torque limit leads
    to another motion, and most of the return is lost.
    """

    def __init__(self, arms: Any, start: Array, actions: Array, policy: Any) -> None:
        """Simulate the path under actions (T, n, N), and store the policy's derivatives by its observations there."""
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
        """Return the feedback (n, N) added to the actions of period k."""
        return np.einsum("njo,no->nj", self.slopes[k], seen - self.seen[k])

    def back(self, k: int, slope: Array) -> Array:
        """Convert derivatives by the actions (n, N) of period k to derivatives (n, O) by the observation before k."""
        return np.einsum("njo,nj->no", self.slopes[k], slope)


def returned(
    arms: Any, start: Array, wanted: Array, fine: Fine, steady: Steady | None = None, weight: Array | None = None,
    grid: float = 0.0,
) -> tuple[Array, Array, Array]:  # fmt: skip
    """Return J (n,) of actions (T, n, N), the derivatives of J by the actions, and the actions as played.

    J is the return minus the cost. J is NaN for an episode that ends early. steady: feedback that is added to the
    actions. weight (T,): weights of the periods' rewards and costs; periods after the last nonzero weight are not
    simulated. grid: played actions are rounded to multiples of 1 / grid; 0: not rounded.
    """
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
    """Round actions to float32, the type that environments receive."""
    return x.astype(np.float32).astype(float)


def steadiers(task: suite.Task, env: Any, trained: Sequence[Path]) -> list[Any]:
    """Load the policies of the run folders that accept the environment's observation.

    Raises ValueError if no policy of a task in space accepts the observation.
    """
    found = []
    for folder in trained:
        with suppress(ValueError):
            found.append(choose(str(folder), task).make(env))
    if trained and not found and task.environment == SPACE:
        raise ValueError(f"{task.id}: in space no policy that observes the whole state exists")
    return found


def steadiest(arms: Any, start: Array, actions: Array, policies: Sequence[Any]) -> Steady:
    """Return a feedback that stabilizes each arm by its best policy, about the path under actions (T, n, N).

    start: states at the beginning of the path. With the best policy a disturbance of `NUDGE` in the first action
    changes an arm's observations least.
    """
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
