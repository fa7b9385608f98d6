"""Optimal motions of many arms at once: least effort, least time, earliest settling, and motion along a tip path.

    plant = dynamics(arm, 0.02)
    motion = least_time(plant, plant.rest(start), plant.rest(goal), Bounds(deflection=0.1))
    motion.controls       # (T, n, N) torques divided by their limits, one row per period; zero after each arm's end

`ilqr` computes the motions with the nonlinear elastica model and torque limits. The augmented Lagrangian method
enforces bounds on joint angles and deflections, and terminal conditions. Durations are whole control periods, found by
bisection for all arms together. The motions are local optima. `least_effort`, `least_time` and `follow` verify a
motion: they simulate its torques on a finer mesh with shorter steps (`Motion.replay`). In space, if the replay violates
a limit, the plan is computed again with half the step, at most `Dynamics.halvings` times. A step that was passed to
`dynamics` is not halved.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import validation as check
from ..geometry.plane import rigid_times
from ..validation import Array
from . import ilqr
from .bounds import TOLERANCE, Bounds, kept_by, within
from .dynamics import Dynamics
from .replay import Replay, replay

Counts = NDArray[np.int64]

STATES = "a state an arm; of joint angles, those of `Dynamics.rest`"


@dataclass
class Motion:
    """Planned motion of n arms.

    controls (T, n, N): torques divided by their limits. states (T + 1, n, S): states. periods (n,): number of control
    periods until each arm arrives. missed (n,): largest violation of the limits (see `TOLERANCE`). ends (n,): number of
    periods after which each arm's controls are zero. replay: simulation of the controls on a finer mesh with shorter
    steps, or None. step: solver step of the plan, s; nan: the step of the `Dynamics`.
    """

    controls: Array
    states: Array
    periods: Counts
    missed: Array
    ends: Counts
    replay: Replay | None = None
    step: float = np.nan

    @property
    def found(self) -> NDArray[np.bool_]:
        """For each arm (n,), True if plan and replay (`Replay.kept`) meet all limits."""
        planned = self.missed <= TOLERANCE
        return planned if self.replay is None else planned & self.replay.kept

    def energy(self, dt: float) -> Array:
        """Return the effort (n,), s: the time integral of the sum of (torque / limit)^2 over the joints.

        dt: control period, s.
        """
        return np.asarray(np.sum(self.controls**2, axis=(0, 2)) * dt)


HALVINGS = 3
"""Number of times that the default step of plans in space is halved, down to 0.6 ms."""

FALL = 0.9
"""Factor from a sufficient number of periods to the next attempt, until some number is known to be too small."""


def rates_of(plant: Dynamics) -> float:
    """Return a characteristic joint rate, rad/s: sqrt(max_i tau_i / I_ii) of the straight, rigid arm.

    tau_i: torque limits, N m. I_ii: diagonal entries of the joint inertia, kg m^2.
    """
    inertia = plant.inertia(np.zeros((1, plant.n_inputs)))[0]
    return float(np.sqrt(np.max(plant.limits / np.diag(inertia))))


def rigid_periods(plant: Dynamics, start: Array, goal: Array) -> Counts:
    """Return the least number of control periods (n,) in which the rigid arm moves from rest to rest.

    All joints start and stop together, and the joint inertia is evaluated at the goal. start, goal (n, N): joint
    angles, rad.
    """
    times = rigid_times(plant.inertia(goal), goal - start, plant.limits)
    return np.asarray(np.maximum(1, np.ceil(times / plant.period)), np.int64)


def optimise(
    plant: ilqr.System, x: Array, controls: Array, costs: Sequence[ilqr.Cost], limits: Sequence[ilqr.Limits],
    effort: float, *, rounds: int = 10, iterations: int = 10, torque: float = 1.0,
) -> tuple[ilqr.Solution, Array]:  # fmt: skip
    """Minimize costs subject to limits, by `ilqr.solve` and the augmented Lagrangian method.

    Returns the solution and each arm's largest violation (n,). If an outer iteration does not halve an arm's violation,
    the arm's penalties are increased. The outer iteration ends when each arm either meets its limits or has not
    improved in two iterations.

    x: initial states (n, S). controls (T, n, N): initial guess. effort: weight of the squared controls. torque: largest
    magnitude of the controls.
    """
    weights = np.full(plant.n_inputs, effort)
    missed, stuck = np.full(len(x), np.inf), np.zeros(len(x), np.int64)
    for _ in range(rounds):
        found = ilqr.solve(
            plant, x, controls, [*costs, *limits], weights, iterations=iterations, tolerance=1e-4, bound=torque
        )
        controls = found.controls
        # largest violation; stagnation counts rounds without a 10 % improvement
        worst = np.max([np.zeros(len(x)), *(one.violation(found.states) for one in limits)], axis=0)
        # arms whose violation was not halved get a larger penalty
        slow = worst > 0.5 * missed
        stuck, missed = np.where(worst < 0.9 * missed, 0, stuck + 1), worst
        if ((missed <= 0.5 * TOLERANCE) | (stuck >= 2)).all():
            break
        for one in limits:
            one.update(found.states)
            one.penalty = np.where(slow, np.minimum(one.penalty * 5.0, 1e7), one.penalty)
    return found, missed


def arrive(plant: Dynamics, goal: Array, periods: Counts, total: int) -> ilqr.Limits:
    """Return the constraint that the arms rest at the goal states (n, S) after `periods` (n,) of `total` periods.

    The constraint divides rates by `rates_of`.
    """
    scale = np.ones(plant.size)
    scale[plant.half :] = 1.0 / rates_of(plant)
    slope = np.diag(scale)

    def off(x: Array) -> tuple[Array, Array]:
        return (x - goal) * scale, np.broadcast_to(slope, (*x.shape, plant.size))

    # equality at the arrival, no limit elsewhere
    low = np.full((total + 1, *goal.shape), -np.inf)
    low[periods, np.arange(len(goal))] = 0.0
    return ilqr.Limits(off, low, -low, np.full(len(goal), 100.0))


def _posed(plant: Dynamics, start: ArrayLike, goal: ArrayLike, bounds: Bounds | None) -> tuple[Array, Array, Bounds]:
    """Validate start and goal states (n, S) and bounds against the arm and against each other."""
    begin = check.array("start", start, ("n", plant.size), STATES)
    end = check.array("goal", goal, (len(begin), plant.size), STATES)
    return begin, end, kept_by(plant, bounds, start=begin, goal=end)


def _replayed(plant: Dynamics, motion: Motion, start: Array, goal: Array | None, bounds: Bounds) -> Motion:
    """Return the motion with its replay on a finer mesh.

    goal (n, S): states at rest at the end; None: no goal.
    """
    others = replace(bounds, deflection=np.inf)

    def missed(fine: Dynamics, states: Array) -> Array:
        n = states.shape[1]
        limits = within(fine, others, n, len(states) - 1)
        return np.asarray(np.max([np.zeros(n), *(one.violation(states) for one in limits)], axis=0))

    rate = rates_of(plant)
    found = replay(plant, start, motion.controls, motion.ends, goal, bounds.deflection, missed, rate)
    return replace(motion, replay=found)


def _refined(plant: Dynamics, solve: Callable[[Dynamics, Motion | None], Motion]) -> Motion:
    """Return a replayed plan; in space the step is halved as long as planning fails or the replay misses limits.

    solve: function of a plant and the last plan (or None) that returns a replayed motion. A step that the user gave is
    kept. If a shorter step finds fewer plans, the plan with the longer step is kept.
    """
    halvings = plant.halvings if plant.step == type(plant).step else 0
    best = last = None
    for k in range(halvings + 1):
        try:
            last = replace(solve(plant, last), step=plant.step)
        except ilqr.Astray:  # the solver fails in such steps
            if k == halvings and best is None:
                raise
        else:
            if best is None or last.found.sum() >= best.found.sum():
                best = last
            if not ((last.missed <= TOLERANCE) & ~last.found).any():
                break
        if k < halvings:
            plant = plant.in_steps(0.5 * plant.step)
    assert best is not None
    return best


def least_effort(
    plant: Dynamics, start: ArrayLike, goal: ArrayLike, periods: int, bounds: Bounds | None = None,
    guess: ArrayLike | None = None,
) -> Motion:  # fmt: skip
    """Plan a motion from a state to rest in a given time with the least integral of the squared torques.

    Args:
        plant: dynamics of the arm. start, goal: states (n, S) at the start and at the end, see `Dynamics.rest`.
            periods: duration of the motion in control periods.
        bounds: limits of the motion, see `Bounds`. guess: initial guess (T, n, N) of the controls.
    Returns:
        A `Motion`. The attribute `found` of the motion is True for arms whose plan meets all limits.
    """
    start, goal, own = _posed(plant, start, goal, bounds)
    n, total = len(start), check.integer("periods", periods, minimum=1)
    controls = plant.begun(start, goal, total)
    if guess is not None:
        controls = check.array("guess", guess, controls.shape)
    when = np.full(n, total)

    def solve(plant: Dynamics, last: Motion | None) -> Motion:
        """Plan from the last plan or, without one, from the guess; return the motion with its finer replay."""
        limits = [arrive(plant, goal, when, total), *within(plant, own, n, total)]
        begun = controls if last is None else last.controls
        found, missed = optimise(plant, start, begun, [], limits, 1.0, torque=own.torque, rounds=14)
        return _replayed(plant, Motion(found.controls, found.states, when, missed, when), start, goal, own)

    return _refined(plant, solve)


def least_time(
    plant: Dynamics, start: ArrayLike, goal: ArrayLike, bounds: Bounds | None = None, most: int = 400
) -> Motion:
    """Plan a motion from a state to rest in the fewest control periods.

    plant, start, goal, bounds: the arguments of `least_effort`. most: largest number of control periods. Raises
    ValueError if an arm cannot arrive within `most` periods.
    """
    start, goal, own = _posed(plant, start, goal, bounds)
    most, joints = check.integer("most", most, minimum=1), plant.joints
    # first guess: 1.4 times the rigid arm's minimum time at the allowed torque
    rigid = 1.4 * rigid_periods(plant, start[:, joints], goal[:, joints]) / np.sqrt(own.torque)
    high = np.minimum(rigid, most).astype(np.int64) + 4

    def solve(plant: Dynamics, last: Motion | None) -> Motion:
        def tried(chosen: Counts, periods: Counts, guess: Array) -> Motion:
            """Plan the chosen arms with the given numbers of periods."""
            # arrive at rest within the bounds, after each arm's own number of periods
            total, n = int(periods.max()), len(chosen)
            limits = [arrive(plant, goal[chosen], periods, total), *within(plant, own, n, total)]
            found, missed = optimise(plant, start[chosen], guess[:total], [], limits, 1e-2, torque=own.torque)
            return Motion(found.controls, found.states, periods, missed, periods)

        if last is None:
            motion = soonest(plant, start, high, tried, most, plant.begun(start, goal, most))
        else:  # no fewer periods than in a longer step
            motion = soonest(plant, start, last.periods, tried, most, last.controls, low=last.periods - 1)
        if last is None and not motion.found.all():
            arm = int(np.argmin(motion.found))
            wider = "" if own == Bounds() else f", or {own} wider"
            what = f"must be more{wider}: arm {arm} cannot arrive in so few control periods"
            raise check.InvalidValue("most", most, what)
        return _replayed(plant, motion, start, goal, own)

    return _refined(plant, solve)


def least_settling(
    plant: Dynamics, start: Array, goal: Array, off: Callable[[Array, NDArray[np.int64]], tuple[Array, Array]],
    after: tuple[Array, Array], *, guess: Array, periods: Counts, tail: int, most: int = 400,
) -> Motion:  # fmt: skip
    """Plan the fastest motion that moves the tip to within a tolerance of its target and keeps it there.

    Args:
        plant: dynamics of the arm. start, goal: states (n, S) at the start and at the goal; the arm rests at the goal.
        off: function of states (..., n, S) and arm indices (n,). The function returns the distances (..., n, 1) of the
            tips from their targets divided by the allowed distance, and the derivatives (..., n, 1, S) of these ratios.
        after: cost matrices after the arrival: (S, S) for a stage, (n, S, S) for the last stage.
        guess: controls (T, n, N) with which the arms arrive after about `periods` (n,) control periods. tail: number of
            periods of the plan after the arrival. most: largest number of periods.
    Returns:
        A `Motion`, whose `missed` is in multiples of the allowed distance.
    """
    stage, last = after

    def tried(chosen: Counts, periods: Counts, guess: Array) -> Motion:
        """Plan the chosen arms with their arrival after the given numbers of periods."""
        total, n = int(periods.max()) + tail, len(chosen)
        # after the arrival: cost of the distance from rest, and the tip within its band
        there = np.arange(total + 1)[:, None] >= periods
        weight = there[:, :, None, None] * stage
        weight[-1] = last[chosen]
        high = np.where(there, 1.0 - 2.0 * TOLERANCE, np.inf)[:, :, None]
        # constraint: distance over the allowed one below 1 after the arrival
        band = ilqr.Limits(lambda x: off(x, chosen), np.full(high.shape, -np.inf), high, np.full(n, 10.0))
        costs = [ilqr.Quadratic(goal[chosen], weight)]
        controls = _padded(guess, total)
        found, missed = optimise(plant, start[chosen], controls, costs, [band], 1e-2, rounds=8, iterations=12)
        return Motion(found.controls, found.states, periods, missed, np.full(n, total))

    return soonest(plant, start, periods, tried, most, guess, tail)


def soonest(
    plant: Dynamics, start: Array, high: Counts, tried: Callable[[Counts, Counts, Array], Motion], most: int,
    guess: Array | None = None, tail: int = 0, low: Counts | None = None,
) -> Motion:  # fmt: skip
    """Find the least number of periods of each arm for which a motion exists, by bisection for all arms together.

    Args:
        start: states (n, S). high: numbers of periods (n,) that are tried first. tried: function of arm indices,
            numbers of periods and initial guess that computes a `Motion`.
        most: largest number of periods. guess: initial guess (T, n, N). tail: number of periods of a motion after the
            arrival. low: numbers of periods (n,) that are known to be too small; None means 0.
    Returns:
        The motions. An arm without a motion of at most `most` periods has `periods` 0 and an infinite `missed`.
    """
    n = len(start)
    controls = np.zeros((most + tail, n, plant.n_inputs))
    # warm start: each arm's last success
    best = controls.copy() if guess is None else _padded(guess, most + tail)
    periods, ends, missed = np.zeros(n, np.int64), np.zeros(n, np.int64), np.full(n, np.inf)
    # low: largest number known to be too small; aim: number tried next
    low, aim = np.zeros(n, np.int64) if low is None else low.copy(), np.minimum(high, most)
    while (chosen := np.flatnonzero(aim > low)).size:
        motion = tried(chosen, aim[chosen], best[:, chosen])
        good = motion.found
        for i, arm in enumerate(chosen.tolist()):
            total = int(aim[arm])
            # success: keep the motion; shrink by FALL until a failure is known, then bisect
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
    """Cut or zero-pad controls (T, n, N) to `total` periods."""
    out = np.zeros((total, *controls.shape[1:]))
    count = min(total, len(controls))
    out[:count] = controls[:count]
    return out


@dataclass
class TipPath:
    """Cost 1/2 weight |tip - path|^2 of each stage. path (T + 1, n, 2 or 3): tip positions, m. weight: 1/m^2."""

    plant: Dynamics
    path: Array
    weight: float

    def value(self, x: Array, k: int | slice) -> Array:
        """Return the cost (..., n) of states (..., n, S) at stage k, or at a slice of stages."""
        off = self.plant.tip(x)[0] - self.path[k]
        return np.asarray(0.5 * self.weight * (off**2).sum(-1))

    def slopes(self, x: Array) -> tuple[Array, Array]:
        """Return gradient (T + 1, n, S) and Gauss-Newton Hessian (T + 1, n, S, S) at states (T + 1, n, S)."""
        tip, slope = self.plant.tip(x)
        off = self.weight * (tip - self.path)
        return np.einsum("...i,...is->...s", off, slope), self.weight * slope.swapaxes(-1, -2) @ slope


def follow(
    plant: Dynamics, start: ArrayLike, path: ArrayLike, bounds: Bounds | None = None, *, weight: float = 1e6,
    iterations: int = 100,
) -> Motion:  # fmt: skip
    """Plan torques that move the tip of the flexible arm along a path.

    Args:
        plant: dynamics of the arm. start: states (n, S) with the tips at the start of the path. path (T + 1, n, 2 or
            3): tip positions at the control instants, m, relative to the root. bounds: limits of the motion (`Bounds`).
            weight: weight of squared distances from the path, 1/m^2; squared torques, divided by their limits, have
            the weight 1. iterations: number of iLQR iterations.
    Returns:
        A `Motion`, whose `missed` is the violation of the bounds and does not include distances from the path.
    """
    start = check.array("start", start, ("n", plant.size), STATES)
    own, n = kept_by(plant, bounds, start=start), len(start)
    numbers = len(plant.tip(start[0])[0])
    path = check.array("path", path, ("T + 1", n, numbers), "a row of tips a control instant, m about the root")
    total, weight = len(path) - 1, check.number("weight", weight, "1/m^2", above=0.0)
    iterations = check.integer("iterations", iterations, minimum=1)
    if not total:
        raise check.InvalidValue("shape of path", path.shape, f"must be (T + 1, {n}, {numbers}), T at least 1")

    def solve(plant: Dynamics, last: Motion | None) -> Motion:
        limits = within(plant, own, n, total)
        controls = plant.begun(start, start, total) if last is None else last.controls
        # continuation: raise the weight from 1e-4 of its value
        for share in (1e-4, 1e-2, 1.0) if last is None else (1.0,):
            cost = TipPath(plant, path, share * weight)
            found, missed = optimise(
                plant, start, controls, [cost], limits, 1.0, torque=own.torque, iterations=iterations,
                rounds=8 if limits else 1,
            )  # fmt: skip
            controls = found.controls
        motion = Motion(found.controls, found.states, np.full(n, total), missed, np.full(n, total))
        return _replayed(plant, motion, start, None, own)

    return _refined(plant, solve)
