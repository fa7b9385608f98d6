"""Iterative linear-quadratic regulator (iLQR) with limited controls, for many arms at once.

The method is that of Li & Todorov (2004); the limits of the controls follow Tassa et al. (2014). For each arm it
minimizes

    sum_k cost_k(x_k) + 1/2 sum_k weight . (u_k - still)^2   with x_k+1 = f(x_k, u_k) and |u_k| <= bound,

where k runs from 0 to T in the first sum and from 0 to T - 1 in the second sum. Each iteration linearizes all stages of
all arms together, solves the linear-quadratic problem with limited controls backward in time, and then evaluates
several step lengths together. Limits of states are enforced by the augmented Lagrangian method (`Limits`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from flexarm_env.validation import Array

LENGTHS = np.array([1.0, 0.7, 0.45, 0.25, 0.12, 0.05, 0.02, 0.005])
"""Step lengths of the line search, relative to the full step: one for each lane of the compiled code."""


class System(Protocol):
    """Discrete-time system x_k+1 = f(x_k, u_k): `control.dynamics.Dynamics` or a similar class."""

    size: int
    n_inputs: int

    def stage(self, k: int, x: Array, u: Array) -> Array:
        """Return the states (m, S) after stage k from states x (m, S) and controls u (m, N)."""

    def linear(self, x: Array, u: Array) -> tuple[Array, Array]:
        """Return f's derivatives by states x (T, n, S) and controls u (T, n, N): A (T, n, S, S) and B (T, n, S, N)."""


class Astray(ValueError):
    """Error: both the initial guess and the controls `still` lead to states that are not finite.

    Attributes:
        arms (n,): mask of the arms without finite states.
    """

    def __init__(self, arms: NDArray[np.bool_]) -> None:
        super().__init__("controls: the first guess leads to states that are not finite, and so does no control")
        self.arms = arms


class Cost(Protocol):
    """Cost of states, stage by stage."""

    def value(self, x: Array, k: int | slice) -> Array:
        """Return the cost (..., n) of states (..., n, S) at stage k, or at a slice of stages."""

    def slopes(self, x: Array) -> tuple[Array, Array]:
        """Return gradient (T + 1, n, S) and positive semi-definite Hessian (T + 1, n, S, S) at states (T + 1, n, S)."""


@dataclass
class Quadratic:
    """Quadratic cost 1/2 (x - goal)' W (x - goal): goal (n, S) or (T + 1, n, S); weight W (T + 1, [n,] S, S)."""

    goal: Array
    weight: Array

    def value(self, x: Array, k: int | slice) -> Array:
        """Return the cost (..., n) of states (..., n, S) at stage k, or at a slice of stages."""
        goal = self.goal if self.goal.ndim == 2 else self.goal[k]
        off, weight = x - goal, self.weight[k]
        weight = weight if self.weight.ndim == 4 else weight[..., None, :, :]
        return np.asarray(0.5 * np.einsum("...i,...i->...", (weight @ off[..., None])[..., 0], off))

    def slopes(self, x: Array) -> tuple[Array, Array]:
        """Return gradient W (x - goal) and Hessian W at states (T + 1, n, S)."""
        off = x - self.goal
        weight = self.weight if self.weight.ndim == 4 else self.weight[:, None]
        weight = np.broadcast_to(weight, (*off.shape, off.shape[-1]))
        return (weight @ off[..., None])[..., 0], weight


@dataclass
class Limits:
    """Constraints low <= g(x) <= high by the augmented Lagrangian method; low = high is an equality.

    of: function of states x (..., S) that returns g (..., G) and its derivative (..., G, S). low, high (T + 1, n, G):
    limits of g at each stage, infinite for no limit.
    penalty (n,): penalty factor of each arm. alone: optional cheaper function of the states that returns only g
    (..., G); `of` is then called only at states at which a limit is active. above, below (T + 1, n, G): multipliers of
    the upper and lower limits.
    """

    of: Any
    low: Array
    high: Array
    penalty: Array
    alone: Any = None
    above: Array = field(init=False)
    below: Array = field(init=False)

    def __post_init__(self) -> None:
        """Store the limits, and start with zero multipliers."""
        self.above, self.below = np.zeros(self.high.shape), np.zeros(self.high.shape)

    def _values(self, x: Array) -> Array:
        """Evaluate g (..., G) at states x (..., S)."""
        return np.asarray(self.of(x)[0] if self.alone is None else self.alone(x))

    def _active(self, g: Array, k: int | slice) -> tuple[Array, Array]:
        """Return the estimates max(lambda + penalty * violation, 0), (..., n, G), of upper and lower multipliers."""
        stiff = self.penalty[:, None]
        over = self.above[k] + stiff * (g - self.high[k])
        under = self.below[k] + stiff * (self.low[k] - g)
        return np.maximum(over, 0.0), np.maximum(under, 0.0)

    def value(self, x: Array, k: int | slice) -> Array:
        """Return the augmented Lagrangian term (..., n) at stage k: sum of (multiplier estimate)^2 / (2 penalty)."""
        over, under = self._active(self._values(x), k)
        return np.asarray((over**2 + under**2).sum(-1) / (2.0 * self.penalty))

    def slopes(self, x: Array) -> tuple[Array, Array]:
        """Return gradient (T + 1, n, S) and Gauss-Newton Hessian (T + 1, n, S, S) of the augmented Lagrangian terms."""
        if self.alone is None:
            g, slope = self.of(x)
            over, under = self._active(g, slice(None))
        else:
            over, under = self._active(self.alone(x), slice(None))
            pushed = ((over > 0.0) | (under > 0.0)).any(axis=-1)
            slope = np.zeros((*over.shape, x.shape[-1]))
            slope[pushed] = self.of(x[pushed])[1]
        # J' (lambda_high - lambda_low);  penalty J' J over the active limits
        gradient = np.einsum("...g,...gs->...s", over - under, slope)
        stiff = self.penalty[:, None] * ((over > 0.0).astype(np.float64) + (under > 0.0))
        return gradient, slope.swapaxes(-1, -2) @ (stiff[..., None] * slope)

    def violation(self, x: Array) -> Array:
        """Return the largest violation (n,) along trajectories x (T + 1, n, S), in the units of g."""
        g = self._values(x)
        return np.asarray(np.maximum(np.maximum(g - self.high, self.low - g), 0.0).max(axis=(0, 2)))

    def update(self, x: Array) -> None:
        """Update the multipliers of the augmented Lagrangian from trajectories x (T + 1, n, S)."""
        self.above, self.below = self._active(self._values(x), slice(None))


@dataclass
class Solution:
    """Solution: controls (T, n, N), states (T + 1, n, S), cost (n,) and gains K (T, n, N, S).

    The feedback law along the solution is u = controls + K (x - states).
    """

    controls: Array
    states: Array
    cost: Array
    gains: Array


def rollout(system: System, x: Array, controls: Array) -> Array:
    """Simulate states (T + 1, n, S) from x (n, S) under controls (T, n, N)."""
    states = np.empty((len(controls) + 1, *x.shape))
    # x_k+1 = f(x_k, u_k)
    states[0] = x
    for k, u in enumerate(controls):
        states[k + 1] = system.stage(k, states[k], u)
    return states


def followed(system: System, x: Array, plan: Solution, bound: float = 1.0) -> tuple[Array, Array]:
    """Simulate the feedback law of a plan from another initial state x (n, S).

    Returns controls (T, n, N), clipped to +-bound, and states (T + 1, n, S).
    """
    controls, states = np.empty(plan.controls.shape), np.empty(plan.states.shape)
    states[0] = x
    with np.errstate(all="ignore"):
        for k, u in enumerate(plan.controls):
            # u = clip(u_k + K (x - x_k))
            off = states[k] - plan.states[k]
            controls[k] = np.clip(u + (plan.gains[k] @ off[..., None])[..., 0], -bound, bound)
            states[k + 1] = system.stage(k, states[k], controls[k])
    return controls, states


def total(costs: Sequence[Cost], effort: Array, states: Array, controls: Array, still: Array | float = 0.0) -> Array:
    """Return the total costs (n,) of trajectories, as defined at the top of this module; inf if not finite.

    effort (N,): weights of (controls - still)^2.
    """
    value = 0.5 * np.einsum("tna,a->n", (controls - still) ** 2, effort)
    with np.errstate(all="ignore"):
        for cost in costs:
            value = value + cost.value(states, slice(None)).sum(0)
    return np.where(np.isfinite(value), value, np.inf)


def solve(
    system: System, x: Array, guess: Array | Solution, costs: Sequence[Cost], effort: Array, *,
    iterations: int = 50, tolerance: float = 1e-6, bound: float = 1.0, still: Array | float = 0.0,
) -> Solution:  # fmt: skip
    """Minimize the total cost by iLQR from an initial guess.

    Args:
        x: initial states (n, S). guess: controls (T, n, N), or a `Solution`; if its initial states differ from x, its
            feedback law is simulated from x. effort (N,): positive weights of the controls.
        iterations: largest number of iterations. tolerance: the solver stops after an iteration that reduces the cost
            of each arm by at most this fraction.
        bound: largest magnitude of the controls. still (n, N): controls without cost.
    Raises:
        Astray: neither the initial guess nor `still` leads to finite states.
    """
    if isinstance(guess, Solution):
        controls, states = followed(system, x, guess, bound)
    else:
        controls = np.clip(guess, -bound, bound)
        states = rollout(system, x, controls)
    cost = total(costs, effort, states, controls, still)
    # arms with infinite cost: try the plan's open-loop controls, then the rest controls
    for other in (guess.controls if isinstance(guess, Solution) else guess, still):
        if not np.isfinite(cost).all():
            controls = np.where(np.isfinite(cost)[:, None], controls, np.clip(other, -bound, bound))
            states = rollout(system, x, controls)
            cost = total(costs, effort, states, controls, still)
    if not np.isfinite(cost).all():
        raise Astray(~np.isfinite(cost))
    # Levenberg-Marquardt damping of Quu, one per arm, zero while full steps succeed
    damping = np.full(len(x), 0.0)
    gains = np.zeros((*controls.shape, system.size))
    for _ in range(iterations):
        feed, gains = backward(system, states, controls, costs, effort, damping, bound, still)
        found, moved, costs_of = _forward(system, states, controls, feed, gains, costs, effort, bound, still)
        # line search: the best of the tried step lengths, accepted if it lowers the cost
        best = np.argmin(costs_of, axis=0)
        arms = np.arange(len(x))
        lower = costs_of[best, arms]
        better = lower < cost
        fall = np.where(better, (cost - lower) / np.maximum(np.abs(cost), 1e-12), 0.0)
        controls = np.where(better[:, None], moved[:, best, arms], controls)
        states = np.where(better[:, None], found[:, best, arms], states)
        cost = np.where(better, lower, cost)
        # raise the damping after a rejected or very short step, otherwise lower it
        weak = ~better | (LENGTHS[best] < 0.1)
        damping = np.where(weak, np.maximum(10.0 * damping, 1e-6), np.where(damping > 1e-6, 0.2 * damping, 0.0))
        if ((fall < tolerance) & (better | (damping > 1e3))).all():
            break
    return Solution(controls, states, cost, gains)


def backward(
    system: System,
    states: Array,
    controls: Array,
    costs: Sequence[Cost],
    effort: Array,
    damping: Array,
    bound: float = 1.0,
    still: Array | float = 0.0,
) -> tuple[Array, Array]:
    """Solve the linear-quadratic problem about a trajectory; return k (T, n, N) and K (T, n, N, S) of du = k + K dx.

    states (T + 1, n, S), controls (T, n, N): the trajectory. effort (N,): weights of (u - still)^2, with the controls
    u. damping (n,): number added to the diagonal of the cost-to-go's second derivatives by the controls. bound: limit
    of |controls + k|.
    """
    periods, _, count = controls.shape
    A, B = system.linear(states[:-1], controls)
    slopes = [cost.slopes(states) for cost in costs]
    # V_x and V_xx at the last stage
    gradient, curvature = (np.sum(part, axis=0) if len(part) > 1 else part[0] for part in zip(*slopes, strict=True))
    value, bend = gradient[-1], curvature[-1]
    feed, gains = np.empty(controls.shape), np.empty((*controls.shape, system.size))
    low, high = -bound - controls, bound - controls
    # R + damping I and R (u - still)
    own = np.eye(count) * (effort + damping[:, None])[:, None, :]
    pull = (controls - still) * effort
    for k in range(periods - 1, -1, -1):
        Ak, Bk = A[k], B[k]
        AT, BT = Ak.swapaxes(1, 2), Bk.swapaxes(1, 2)
        # Qu = R u + B' Vx, Quu = R + B' Vxx B, Qux = B' Vxx A
        Qu = pull[k] + (BT @ value[:, :, None])[:, :, 0]
        PA = bend @ Ak
        Quu, Qux = own + BT @ (bend @ Bk), BT @ PA
        feed[k], gains[k] = step, gain = _within(Quu, Qu, Qux, low[k], high[k])
        # Vx = lx + A' Vx + K' (Qu + Quu k) + Qux' k
        GT = gain.swapaxes(1, 2)
        value = (
            gradient[k] + (AT @ value[:, :, None])[:, :, 0]
            + (GT @ (Qu + (Quu @ step[:, :, None])[:, :, 0])[:, :, None])[:, :, 0]
            + (Qux.swapaxes(1, 2) @ step[:, :, None])[:, :, 0]
        )  # fmt: skip
        # Vxx = lxx + A' Vxx A + K' Quu K + K' Qux + Qux' K, kept symmetric
        cross = GT @ Qux
        bend = curvature[k] + AT @ PA + GT @ (Quu @ gain) + cross + cross.swapaxes(1, 2)
        bend = 0.5 * (bend + bend.swapaxes(1, 2))
    return feed, gains


def _within(Quu: Array, Qu: Array, Qux: Array, low: Array, high: Array) -> tuple[Array, Array]:
    """Solve the box-constrained QP min 1/2 u' Quu u + Qu u, low <= u <= high: minimizer (n, N) and gains (n, N, S).

    The gains -Quu^-1 Qux of clamped controls are zero.
    """
    if Quu.shape[1] == 1:
        step = np.clip(-Qu / Quu[:, 0], low, high)
        free = (step > low) & (step < high)
        return step, np.where(free[:, :, None], -Qux / Quu, 0.0)
    # unconstrained solution; only arms with a violated limit need more
    both = -np.linalg.solve(Quu, np.concatenate([Qu[:, :, None], Qux], axis=2))
    step, gain = both[:, :, 0], both[:, :, 1:]
    inside = ((step > low) & (step < high)).all(axis=1)
    if inside.all():
        return step, gain
    held = np.flatnonzero(~inside)
    step[held] = _corner(Quu[held], Qu[held], low[held], high[held])
    free = (step > low) & (step < high)
    gain[held] = _partial(Quu[held], Qux[held], free[held])
    return step, gain


def _corner(H: Array, g: Array, low: Array, high: Array) -> Array:
    """Minimize 1/2 u' H u + g' u between low and high, (n, N), when a limit is active.

    For two controls the result is the best point with one control at a limit. For more controls the method is
    coordinate descent.
    """
    count = H.shape[1]
    if count == 2:
        tried = []
        for i, j in ((0, 1), (1, 0)):
            for end in (low, high):
                u = np.empty(g.shape)
                u[:, i] = end[:, i]
                u[:, j] = np.clip(-(g[:, j] + H[:, i, j] * u[:, i]) / H[:, j, j], low[:, j], high[:, j])
                tried.append(u)
        each = np.array(tried)
        worth = np.einsum("cni,cni->cn", each, 0.5 * np.einsum("nij,cnj->cni", H, each) + g)
        return np.asarray(each[np.argmin(worth, axis=0), np.arange(len(g))])
    u = np.clip(np.zeros(g.shape), low, high)
    for _ in range(200):
        before = u.copy()
        for i in range(count):
            rest = g[:, i] + np.einsum("nj,nj->n", H[:, i], u) - H[:, i, i] * u[:, i]
            u[:, i] = np.clip(-rest / H[:, i, i], low[:, i], high[:, i])
        if np.abs(u - before).max() < 1e-9:
            break
    return u


def _partial(Quu: Array, Qux: Array, free: NDArray[np.bool_]) -> Array:
    """Return the gains -Quu^-1 Qux (n, N, S) of the free controls (n, N); clamped controls have zero rows."""
    both = free[:, :, None] & free[:, None, :]
    # identity rows for the clamped controls
    H = np.where(both, Quu, np.eye(Quu.shape[1]))
    return np.asarray(np.where(free[:, :, None], -np.linalg.solve(H, np.where(free[:, :, None], Qux, 0.0)), 0.0))


def _forward(
    system: System,
    states: Array,
    controls: Array,
    feed: Array,
    gains: Array,
    costs: Sequence[Cost],
    effort: Array,
    bound: float,
    still: Array | float,
) -> tuple[Array, Array, Array]:
    """Simulate the new control law forward with all `LENGTHS` of the feedforward step.

    Returns states (T + 1, 8, n, S), controls (T, 8, n, N) and costs (8, n). feed, gains: feedforward and gains that
    `backward` returned.
    """
    periods, n, count = controls.shape
    size, tried = system.size, len(LENGTHS)
    found, moved = np.empty((periods + 1, tried, n, size)), np.empty((periods, tried, n, count))
    found[0] = states[0]
    ahead = controls[:, None] + LENGTHS[:, None, None] * feed[:, None]
    with np.errstate(all="ignore"):
        for k in range(periods):
            off = found[k] - states[k]
            # u = clip(u_k + length * k + K (x - x_k))
            u = ahead[k] + (gains[k] @ off[..., None])[..., 0]
            moved[k] = u = np.minimum(np.maximum(u, -bound), bound)
            found[k + 1] = system.stage(k, found[k].reshape(-1, size), u.reshape(-1, count)).reshape(tried, n, size)
    value = np.array([total(costs, effort, found[:, i], moved[:, i], still) for i in range(tried)])
    return found, moved, value


__all__ = [
    "Astray", "Cost", "Limits", "Quadratic", "Solution", "System", "backward", "followed", "rollout", "solve", "total",
]  # fmt: skip
