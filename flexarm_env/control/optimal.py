"""Optimal motions of many arms at once: least effort, least time, soonest settled, and along a path of the tip.

    plant = dynamics(arm, 0.02)
    motion = least_time(plant, plant.rest(start), plant.rest(goal), Bounds(deflection=0.1))
    motion.controls       # (T, n, N) torques over their limits, held for a period each; zero behind each arm's end

All are solved by `ilqr` on the elastica itself, torques within their limits throughout; bounds on joint angles and
deflections, and where an arm is to be when, are kept by multipliers. Times are whole control periods, found by
bisection for all arms together. What is found is a local optimum: nothing says that there is none better.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import validation as check
from ..shapes import Shape
from ..validation import Array
from . import ilqr
from .dynamics import Dynamics
from .kinematics import rigid_times

Counts = NDArray[np.int64]

STATES = "a state an arm; of joint angles, those of `Dynamics.rest`"
TOLERANCE = 2e-3
"""What a limit may be missed by: rad, rates over the arm's own (`rates_of`), or shares of a deflection's bound or of a
band."""


@dataclass(frozen=True)
class Bounds:
    """Limits beside the motors' own.

    torque: share of the torque limits, above 0 and at most 1. joints: (low, high) of each joint angle, rad, infinite
    where there is none; () for none at all. deflection: largest tip deflection over length of any link (in space: also
    twist, rad). keep_out: shapes that `Dynamics.points` stay out of, by `margin`, m.
    """

    torque: float = 1.0
    joints: Sequence[tuple[float, float]] | Array = ()
    deflection: float = np.inf
    keep_out: Sequence[Shape] = ()
    margin: float = 0.0

    def __post_init__(self) -> None:
        torque = check.number("bounds.torque", self.torque, "share of the limits", above=0.0, maximum=1.0)
        check.store(self, torque=torque, deflection=_or_infinite("bounds.deflection", self.deflection, above=0.0))
        joints = self.joints.tolist() if isinstance(self.joints, np.ndarray) else self.joints
        pairs = []
        for k, pair in enumerate(check.sequence("bounds.joints", joints, "pairs (low, high), one a joint")):
            path = f"bounds.joints[{k}]"
            ends = check.sequence(path, pair, "two numbers (rad), (low, high)", 2)
            low, high = (_or_infinite(f"{path}[{i}]", end, "rad") for i, end in enumerate(ends))
            if low > high:
                raise check.InvalidValue(path, (low, high), "must be (low, high) with low at most high")
            pairs.append((low, high))
        shapes = check.sequence("bounds.keep_out", self.keep_out, "shapes (`flexarm_env.shapes`)")
        shapes = tuple(check.instance(f"bounds.keep_out[{k}]", one, Shape) for k, one in enumerate(shapes))
        check.store(self, joints=tuple(pairs), keep_out=shapes)
        check.store(self, margin=check.number("bounds.margin", self.margin, "m", minimum=0.0))


def _or_infinite(path: str, value: object, unit: str = "", **bounds: float) -> float:
    """`check.number`, or infinity: no bound."""
    if isinstance(value, float) and np.isinf(value) and (value > 0.0 or not bounds):
        return float(value)
    return check.number(path, value, unit, **bounds)


@dataclass
class Motion:
    """controls (T, n, N): torques over their limits; states (T + 1, n, S); periods (n,): when each arm is there;
    missed (n,): by how much limits are (see `TOLERANCE`). ends (n,): periods behind which its controls are zero."""

    controls: Array
    states: Array
    periods: Counts
    missed: Array
    ends: Counts

    @property
    def found(self) -> NDArray[np.bool_]:
        """Which arms keep all limits (n,)."""
        return self.missed <= TOLERANCE

    def energy(self, dt: float) -> Array:
        """Effort (n,), s: the integral of the squared torques over their limits."""
        return np.asarray(np.sum(self.controls**2, axis=(0, 2)) * dt)


FALL = 0.9
"""Share of the periods known to be enough that is tried next, as long as none are known to be too few."""


def rates_of(plant: Dynamics) -> float:
    """A rate that is large for the arm, 1/s: what full torque makes of a joint of the straight rigid arm in 1 rad."""
    inertia = plant.inertia(np.zeros((1, plant.n_inputs)))[0]
    return float(np.sqrt(np.max(plant.limits / np.diag(inertia))))


def rigid_periods(plant: Dynamics, start: Array, goal: Array) -> Counts:
    """Control periods (n,) that the rigid arm at the goal's posture takes from rest to rest, joints (n, N) in step."""
    times = rigid_times(plant.inertia(goal), goal - start, plant.limits)
    return np.asarray(np.maximum(1, np.ceil(times / plant.period)), np.int64)


def optimise(
    plant: ilqr.System, x: Array, controls: Array, costs: Sequence[ilqr.Cost], limits: Sequence[ilqr.Limits],
    effort: float, *, rounds: int = 10, iterations: int = 10, torque: float = 1.0,
) -> tuple[ilqr.Solution, Array]:  # fmt: skip
    """`ilqr.solve` with limits by multipliers: the solution, and by how much each arm (n,) misses its limits.

    A round's violations that are not halved in the next ask for a larger penalty. It ends when every arm keeps its
    limits, or has not come nearer to them for two rounds.
    """
    weights = np.full(plant.n_inputs, effort)
    missed, stuck = np.full(len(x), np.inf), np.zeros(len(x), np.int64)
    for _ in range(rounds):
        found = ilqr.solve(
            plant, x, controls, [*costs, *limits], weights, iterations=iterations, tolerance=1e-4, bound=torque
        )
        controls = found.controls
        worst = np.max([np.zeros(len(x)), *(one.violation(found.states) for one in limits)], axis=0)
        slow = worst > 0.5 * missed
        stuck, missed = np.where(worst < 0.9 * missed, 0, stuck + 1), worst
        if ((missed <= 0.5 * TOLERANCE) | (stuck >= 2)).all():
            break
        for one in limits:
            one.update(found.states)
            one.penalty = np.where(slow, np.minimum(one.penalty * 5.0, 1e7), one.penalty)
    return found, missed


def arrive(plant: Dynamics, goal: Array, periods: Counts, total: int) -> ilqr.Limits:
    """At rest at the goal (n, S) after so many periods (n,) of `total`."""
    scale = np.ones(plant.size)
    scale[plant.half :] = 1.0 / rates_of(plant)
    slope = np.diag(scale)

    def off(x: Array) -> tuple[Array, Array]:
        return (x - goal) * scale, np.broadcast_to(slope, (*x.shape, plant.size))

    low = np.full((total + 1, *goal.shape), -np.inf)
    low[periods, np.arange(len(goal))] = 0.0
    return ilqr.Limits(off, low, -low, np.full(len(goal), 100.0))


def within(plant: Dynamics, bounds: Bounds, n: int, total: int, stiff: float = 1.0) -> list[ilqr.Limits]:
    """Joint angles; over their bound, deflections; distances from shapes, over the arm's length; throughout.

    stiff: times the penalties that plans begin with.
    """
    found = []
    count = plant.n_inputs
    if bounds.joints:
        check.sequence("bounds.joints", bounds.joints, f"{count} pairs (low, high), one a joint", count)
        low, high = np.array(bounds.joints, np.float64).T
        slope = np.zeros((count, plant.size))
        slope[np.arange(count), plant.joints] = 1.0

        def angles(x: Array) -> tuple[Array, Array]:
            return x[..., plant.joints], np.broadcast_to(slope, (*x.shape[:-1], *slope.shape))

        found.append(_throughout(angles, low, high, n, total, stiff * 100.0))
    if np.isfinite(bounds.deflection):

        def shares(x: Array) -> tuple[Array, Array]:
            bend, slope = plant.bends(x)
            return bend / bounds.deflection, slope / bounds.deflection

        many = np.ones(plant.bends(np.zeros(plant.size))[0].shape)
        found.append(_throughout(shares, -many, many, n, total, stiff))
    if bounds.keep_out:
        length = plant.arm.total_length

        def distances(x: Array) -> Array:
            places = plant.places(x)
            far = [shape.distance(places) for shape in bounds.keep_out]
            return np.asarray(np.concatenate(far, axis=-1) - bounds.margin) / length

        def approach(x: Array) -> tuple[Array, Array]:
            points, slope = plant.points(x)
            ways = [np.einsum("...d,...ds->...s", shape.gradient(points), slope) for shape in bounds.keep_out]
            return distances(x), np.concatenate(ways, axis=-2) / length

        low = np.zeros(distances(np.zeros(plant.size)).shape)
        found.append(_throughout(approach, low, low + np.inf, n, total, stiff * 1e4, distances))
    return found


def _throughout(
    of: Callable[[Array], tuple[Array, Array]], low: Array, high: Array, n: int, total: int, penalty: float,
    alone: Callable[[Array], Array] | None = None,
) -> ilqr.Limits:  # fmt: skip
    shape = (total + 1, n, len(low))
    return ilqr.Limits(of, np.broadcast_to(low, shape), np.broadcast_to(high, shape), np.full(n, penalty), alone)


def _kept_by(plant: Dynamics, bounds: Bounds | None, **states: Array) -> Bounds:
    """The bounds. InvalidValue unless each of the states (n, S), by what they are, keeps them."""
    own = check.instance("bounds", Bounds() if bounds is None else bounds, Bounds)
    for what, x in states.items():
        for one in within(plant, own, len(x), 0):
            outside = np.flatnonzero(one.violation(x[None]) > TOLERANCE)
            if outside.size:
                arm = int(outside[0])
                angles, bends = x[arm, plant.joints].round(6).tolist(), plant.bends(x[arm])[0].round(6).tolist()
                path = f"joint angles and deflections of {what}[{arm}]"
                raise check.InvalidValue(path, (angles, bends), f"must be within {own}")
    return own


def _posed(plant: Dynamics, start: ArrayLike, goal: ArrayLike, bounds: Bounds | None) -> tuple[Array, Array, Bounds]:
    """Start, goal and bounds, if they fit the arm and each other."""
    begin = check.array("start", start, ("n", plant.size), STATES)
    end = check.array("goal", goal, (len(begin), plant.size), STATES)
    return begin, end, _kept_by(plant, bounds, start=begin, goal=end)


def least_effort(
    plant: Dynamics, start: ArrayLike, goal: ArrayLike, periods: int, bounds: Bounds | None = None,
    guess: ArrayLike | None = None,
) -> Motion:  # fmt: skip
    """From state to rest in a given time with the least integral of the squared torques.

    Args:
        plant: the arm. start, goal: states (n, S), see `Dynamics.rest`. periods: control periods.
        bounds: see `Bounds`. guess: first guess (T, n, N).
    Returns a motion whose `found` says which arms can.
    """
    start, goal, own = _posed(plant, start, goal, bounds)
    n, total = len(start), check.integer("periods", periods, minimum=1)
    controls = plant.begun(start, goal, total)
    if guess is not None:
        controls = check.array("guess", guess, controls.shape)
    when = np.full(n, total)
    limits = [arrive(plant, goal, when, total), *within(plant, own, n, total)]
    found, missed = optimise(plant, start, controls, [], limits, 1.0, torque=own.torque, rounds=14)
    return Motion(found.controls, found.states, when, missed, when)


def least_time(
    plant: Dynamics, start: ArrayLike, goal: ArrayLike, bounds: Bounds | None = None, most: int = 400
) -> Motion:
    """From state to rest in the fewest control periods.

    Arguments as for `least_effort`; most: control periods. ValueError where an arm cannot be there in so many.
    """
    start, goal, own = _posed(plant, start, goal, bounds)
    most, joints = check.integer("most", most, minimum=1), plant.joints
    rigid = 1.4 * rigid_periods(plant, start[:, joints], goal[:, joints]) / np.sqrt(own.torque)
    high = np.minimum(rigid, most).astype(np.int64) + 4

    def tried(chosen: Counts, periods: Counts, guess: Array) -> Motion:
        total, n = int(periods.max()), len(chosen)
        limits = [arrive(plant, goal[chosen], periods, total), *within(plant, own, n, total)]
        found, missed = optimise(plant, start[chosen], guess[:total], [], limits, 1e-2, torque=own.torque)
        return Motion(found.controls, found.states, periods, missed, periods)

    motion = soonest(plant, start, high, tried, most, plant.begun(start, goal, most))
    if not motion.found.all():
        arm = int(np.argmin(motion.found))
        wider = "" if own == Bounds() else f", or {own} wider"
        raise check.InvalidValue("most", most, f"must be more{wider}: arm {arm} is not there in so few control periods")
    return motion


def least_settling(
    plant: Dynamics, start: Array, goal: Array, off: Callable[[Array, NDArray[np.int64]], tuple[Array, Array]],
    after: tuple[Array, Array], *, guess: Array, periods: Counts, tail: int, most: int = 400,
) -> Motion:  # fmt: skip
    """The motion after whose fewest periods the tip stays where it is to be.

    Args:
        plant: the arm. start, goal: states (n, S), the goal at rest.
        off: (states (..., n, S), arms (n,)) -> distances (..., n, 1) from where the tip is to be over what is allowed,
            and their derivative (..., n, 1, S).
        after: costs of a stage, weight (S, S), and of the last one, weight (n, S, S), from when the tip is there.
        guess: controls (T, n, N) that are there after `periods` (n,) or nearly. tail: periods that are looked at after
            that. least: periods (n,) known to be too few. most: periods.
    `missed` is in shares of what is allowed.
    """
    stage, last = after

    def tried(chosen: Counts, periods: Counts, guess: Array) -> Motion:
        total, n = int(periods.max()) + tail, len(chosen)
        there = np.arange(total + 1)[:, None] >= periods
        weight = there[:, :, None, None] * stage
        weight[-1] = last[chosen]
        high = np.where(there, 1.0 - 2.0 * TOLERANCE, np.inf)[:, :, None]
        band = ilqr.Limits(lambda x: off(x, chosen), np.full(high.shape, -np.inf), high, np.full(n, 10.0))
        costs = [ilqr.Quadratic(goal[chosen], weight)]
        controls = _padded(guess, total)
        found, missed = optimise(plant, start[chosen], controls, costs, [band], 1e-2, rounds=8, iterations=12)
        return Motion(found.controls, found.states, periods, missed, np.full(n, total))

    return soonest(plant, start, periods, tried, most, guess, tail)


def soonest(
    plant: Dynamics, start: Array, high: Counts, tried: Callable[[Counts, Counts, Array], Motion], most: int,
    guess: Array | None = None, tail: int = 0,
) -> Motion:  # fmt: skip
    """The fewest periods of each arm for which `tried` finds a motion, by bisection.

    Args:
        start: states (n, S). high: periods (n,) to begin with. tried: (arms, periods, first guess) -> `Motion`.
        most: periods. guess: first guess (T, n, N). tail: periods of a motion that follow those which are counted.
    An arm that has none of at most `most` periods has `periods` 0, and `missed` infinite.
    """
    n = len(start)
    controls = np.zeros((most + tail, n, plant.n_inputs))
    best = controls.copy() if guess is None else _padded(guess, most + tail)
    periods, ends, missed = np.zeros(n, np.int64), np.zeros(n, np.int64), np.full(n, np.inf)
    low, aim = np.zeros(n, np.int64), np.minimum(high, most)
    while (chosen := np.flatnonzero(aim > low)).size:
        motion = tried(chosen, aim[chosen], best[:, chosen])
        good = motion.found
        for i, arm in enumerate(chosen.tolist()):
            total = int(aim[arm])
            if good[i]:
                ends[arm] = end = motion.ends[i]
                controls[:end, arm], controls[end:, arm] = motion.controls[:end, i], 0.0
                best[:, arm] = controls[:, arm]
                periods[arm], missed[arm] = total, motion.missed[i]
                aim[arm] = int(FALL * total) if low[arm] == 0 else (low[arm] + total) // 2
            else:
                low[arm] = total
                aim[arm] = (total + periods[arm]) // 2 if periods[arm] else min(most, int(total / FALL) + 1)
    controls = controls[: max(1, int(ends.max()))]
    return Motion(controls, ilqr.rollout(plant, start, controls), periods, missed, ends)


def _padded(controls: Array, total: int) -> Array:
    out = np.zeros((total, *controls.shape[1:]))
    count = min(total, len(controls))
    out[:count] = controls[:count]
    return out


@dataclass
class TipPath:
    """1/2 weight |tip - path|^2, stage by stage: path (T + 1, n, 2 or 3) m; weight: 1/m^2."""

    plant: Dynamics
    path: Array
    weight: float

    def value(self, x: Array, k: int | slice) -> Array:
        off = self.plant.tip(x)[0] - self.path[k]
        return np.asarray(0.5 * self.weight * (off**2).sum(-1))

    def slopes(self, x: Array) -> tuple[Array, Array]:
        tip, slope = self.plant.tip(x)
        off = self.weight * (tip - self.path)
        return np.einsum("...i,...is->...s", off, slope), self.weight * slope.swapaxes(-1, -2) @ slope


def follow(
    plant: Dynamics, start: ArrayLike, path: ArrayLike, bounds: Bounds | None = None, *, weight: float = 1e6,
    iterations: int = 100,
) -> Motion:  # fmt: skip
    """Torques that lead the tip along a path: feedforward for what bends.

    Args:
        plant: the arm. start: states (n, S), tips at the path's start. path (T + 1, n, 2 or 3): where tips are to be at
            each control instant, m about the root. bounds: see `Bounds`. weight: of distances squared, 1/m^2, against
            the squared torques over their limits; the larger, the nearer the tip keeps to the path.
    Returns a motion; `missed` is of the bounds alone.
    """
    start = check.array("start", start, ("n", plant.size), STATES)
    own, n = _kept_by(plant, bounds, start=start), len(start)
    numbers = len(plant.tip(start[0])[0])
    path = check.array("path", path, ("T + 1", n, numbers), "a row of tips a control instant, m about the root")
    total, weight = len(path) - 1, check.number("weight", weight, "1/m^2", above=0.0)
    iterations = check.integer("iterations", iterations, minimum=1)
    if not total:
        raise check.InvalidValue("shape of path", path.shape, f"must be (T + 1, {n}, {numbers}), T at least 1")
    limits, controls = within(plant, own, n, total), plant.begun(start, start, total)
    for share in (1e-4, 1e-2, 1.0):
        cost = TipPath(plant, path, share * weight)
        found, missed = optimise(
            plant, start, controls, [cost], limits, 1.0, torque=own.torque, iterations=iterations,
            rounds=8 if limits else 1,
        )  # fmt: skip
        controls = found.controls
    return Motion(found.controls, found.states, np.full(n, total), missed, np.full(n, total))
