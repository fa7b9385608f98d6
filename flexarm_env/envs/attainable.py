"""Conditions on random targets: the arm can reach the target within its joint limits, and its motors can hold it."""

import dataclasses
import itertools
import math
from typing import Any

import numpy as np

from .. import validation as check
from ..batch import GOAL, Attainable, Starts, Task, attainable, draw_attainable, first_unattainable
from ..compiler import uncompiled
from ..geometry.inverse import INVERSE, chain_of, lost_at
from ..parameters import Arm
from ..rigid import link_bodies, mass_moments, weight_and_inertia

Pair = tuple[float, float]

SAMPLES = 1000
"""Number of drawn targets of which at least one must be attainable."""

PATHS = 100
"""Number of drawn paths of which at least one must be attainable."""

TRIED = 4
"""Number of drawn starts that are tried if an arm in space cannot follow a given path from the middle posture."""

_ELBOWS = 9
"""Number of angles of each elbow at which the tip's distance from the root is computed."""
_SURE = 0.98
"""Share of the largest torque: if every sampled posture needs at most this share, drawn targets are not checked."""


class Conditions:
    """Conditions on random targets and paths of arms in the plane, and validation of given targets and paths."""

    def of_targets(
        self, arm: Arm, gravity: tuple[float, ...] | None, task: Task, starts: Starts, extras: Any
    ) -> Attainable | None:
        """Return the conditions on random targets; None if every possible target is attainable or the base floats.

        gravity: acceleration of gravity, m/s^2. task: constants of the task. extras: further features of the
        environment (`Extras`). Raises ValueError if none of `SAMPLES` random targets is attainable.
        """
        if arm.base is not None:
            return None
        arm, torques = _worst(arm, task, starts, extras)
        needs, surely_held = _in_plane(arm, gravity, torques)
        if surely_held and _all_within(arm, task, starts):
            return None
        rng, ask = np.random.default_rng(0), uncompiled(attainable)
        begin, aims = np.array(starts.start, np.float64), np.array(starts.target, np.float64)
        for _ in range(SAMPLES):
            angles = rng.uniform(begin[:, 0], begin[:, 1]) * (rng.uniform() >= starts.straight)
            first, second = rng.uniform(aims[:, 0], aims[:, 1]).tolist()
            if len(task.targets) == 1:
                first, second = task.relative * angles[0] + first, 0.0
            else:
                first, second = first * math.cos(second), first * math.sin(second)
            if ask(task, needs, angles, first, second) > 0.5:
                return needs
        raise _none(starts, arm, needs.gravity)

    def of_paths(
        self, arm: Arm, gravity: tuple[float, ...] | None, task: Task, starts: Starts, extras: Any, period: float,
        periods: int,
    ) -> Any:  # fmt: skip
        """Return the moving target (`Extras.reference`) with the conditions on random paths.

        period: control period, s. periods: largest number of control periods in an episode. Raises ValueError if the
        arm cannot follow a given path within its joint limits, or if none of `PATHS` random paths is attainable.
        """
        moving = extras.reference
        if moving is None or arm.base is not None:
            return moving
        begin, numbers = np.array(starts.start, np.float64), len(task.targets)
        if len(moving.table):
            points = moving.table.reshape(-1, 2 * numbers)[: periods + 1, :numbers]
            at = self.first_lost(arm, task, begin, points)
            if at is not None:
                unit = "rad" if numbers == 1 else "m"
                where = ", ".join(f"{x:g}" for x in points[at])
                what = f"must stay where {arm.name!r} can follow within its joint limits"
                raise ValueError(f"reference = ({where}) {unit} at {at * period:g} s: {what}")
            return moving
        return self.of_drawn_paths(arm, gravity, task, starts, extras, periods * period)

    def of_drawn_paths(
        self, arm: Arm, gravity: tuple[float, ...] | None, task: Task, starts: Starts, extras: Any, lasting: float
    ) -> Any:
        """Return the moving target with the conditions on random paths of `lasting` seconds."""
        moving, begin = extras.reference, np.array(starts.start, np.float64)
        if len(task.targets) == 1 and moving.line is not None:  # an endless line
            return moving
        arm, torques = _worst(arm, task, starts, extras)
        needs, surely_held = _in_plane(arm, gravity, torques)
        if surely_held and _surely_followed(arm, task, moving, begin):
            return moving
        moving = moving._replace(needs=needs, lasting=lasting)
        rng, ask, path = np.random.default_rng(0), uncompiled(draw_attainable), np.zeros(GOAL)
        stream = np.zeros(1, np.uint64)
        with np.errstate(over="ignore"):
            for _ in range(PATHS):
                angles = rng.uniform(begin[:, 0], begin[:, 1]) * (rng.uniform() >= starts.straight)
                stream[0] = rng.integers(2**63)
                if ask(moving, task, stream, 0, angles, path, 1) > 0.5:
                    return moving
        what = f"must hold paths that {arm.name!r} can follow within its joint limits"
        what += " and that its motors hold against gravity" * bool(needs.gravity.any())
        raise check.InvalidValue("reference", moving.ranges.tolist(), f"{what}: none of {PATHS} drawn ones is")

    def first_lost(self, arm: Arm, task: Task, begin: np.ndarray, points: np.ndarray) -> int | None:
        """Return the index of the first point of a path (n, numbers) that the arm cannot reach, or None.

        begin (N, 2): ranges of the initial joint angles, rad; the arm starts at the middles of the ranges.
        """
        flat = np.zeros((len(points), 2))
        flat[:, : points.shape[1]] = points
        at = uncompiled(first_unattainable)(task, _free(task), begin.mean(axis=1), flat.ravel())
        return None if at < 0 else int(at)

    def check_target(self, arm: Arm, task: Task, angles: np.ndarray, target: np.ndarray) -> None:
        """Raise `InvalidValue` if the arm cannot reach a given target within its joint limits.

        angles (N,): joint angles at the start, rad; NaN for joints with random initial angles.
        """
        if arm.base is not None or arm.joint_limits is None:
            return
        given = tuple(target.tolist())
        if uncompiled(attainable)(task, _free(task), np.nan_to_num(angles), *given) < 0.5:
            shown = given if len(task.targets) > 1 else given[0]
            raise check.InvalidValue("options.target", shown, f"must be within the joint limits of {arm.name!r}")


IN_PLANE = Conditions()


class ConditionsInSpace(Conditions):
    """Conditions for arms in space, whose random targets are joint angles within the joint limits."""

    def of_targets(
        self, arm: Arm, gravity: tuple[float, ...] | None, task: Task, starts: Starts, extras: Any
    ) -> Attainable | None:
        """Return the conditions on random targets; None if the motors can hold the arm at every target.

        `Attainable.bodies` contains each link's mass (kg) and center of mass (m, link axes).
        """
        arm, torques = _worst(arm, task, starts, extras)
        down = np.array(gravity or (0.0, 0.0, 0.0))
        if not down.any():
            return None
        ranges, parts = np.array(starts.target), link_bodies(arm)
        drawn = np.random.default_rng(0).uniform(ranges[:, 0], ranges[:, 1], (SAMPLES, arm.n_links))
        corners = np.array([*itertools.product(*ranges[:6])])
        rest = np.broadcast_to(ranges[6:].mean(axis=1), (len(corners), max(0, arm.n_links - 6)))
        tried = np.concatenate([drawn, np.hstack([corners, rest])])
        needed = np.abs(weight_and_inertia(arm, down, tried, parts)[0]) / torques
        if needed.max() <= _SURE:
            return None
        if needed[:SAMPLES].max(axis=1).min() > 1.0:
            raise _none(starts, arm, down)
        bodies = np.concatenate([(part.mass, *part.centre) for part in parts])
        return Attainable(bodies, down, torques, chain_of(arm))

    def of_drawn_paths(
        self, arm: Arm, gravity: tuple[float, ...] | None, task: Task, starts: Starts, extras: Any, lasting: float
    ) -> Any:
        """Return the moving target without conditions, because `Place.check_ranges` has validated the ranges."""
        return extras.reference

    def first_lost(self, arm: Arm, task: Task, begin: np.ndarray, points: np.ndarray) -> int | None:
        """Return the index of the first point (n, 3), m, at which the arm leaves its joint limits, or None.

        The arm starts at the middles of the ranges `begin` (N, 2), rad. If the arm leaves its limits, the function also
        tests `TRIED` random initial angles, and returns the largest of all indices.
        """
        if arm.joint_limits is None:
            return None
        rng, latest = np.random.default_rng(0), 0
        for start in (begin.mean(axis=1), *rng.uniform(begin[:, 0], begin[:, 1], (TRIED, len(begin)))):
            at = lost_at(arm, start, points, *map(uncompiled, INVERSE))
            if at is None:
                return None
            latest = max(latest, at)
        return latest

    def check_target(self, arm: Arm, task: Task, angles: np.ndarray, target: np.ndarray) -> None:
        """Accept every target: `Place.read` finds joint angles within the limits."""


def _free(task: Task) -> Attainable:
    """Return the conditions on targets for an arm that needs no torque to stay at rest."""
    n = len(task.links)
    return Attainable(np.zeros(2 * n), np.zeros(2), np.full(n, np.inf), None)


def _worst(arm: Arm, task: Task, starts: Starts, extras: Any) -> tuple[Arm, np.ndarray]:
    """Return the arm with the heaviest payload that can be drawn and the smallest torque limits (N,), N m."""
    factors, change = starts.drawn, extras.payload_change
    heavy = factors["payload"][1] * (1.0 if change is None else max(1.0, float(change.factor.max())))
    weak = factors["torque_constant"][0]
    torques = weak * np.array(task.torque_limits if extras.actuator is None else extras.actuator.limits)
    return _with_payload(arm, heavy), torques


def _in_plane(arm: Arm, gravity: tuple[float, ...] | None, torques: np.ndarray) -> tuple[Attainable, bool]:
    """Return the conditions on targets of a planar arm, and whether its motors can hold the arm in every posture."""
    down = np.array(gravity or (0.0, 0.0))
    moments = np.array(mass_moments(arm), complex)
    bodies = np.stack([moments.real, moments.imag], axis=1).ravel()
    most = np.cumsum(np.abs(moments)[::-1])[::-1] * float(np.hypot(*down))
    return Attainable(bodies, down, torques, None), bool((most <= torques).all())


def _surely_followed(arm: Arm, task: Task, moving: Any, begin: np.ndarray) -> bool:
    """Return True only if the joint limits certainly let the arm follow every path that can be drawn."""
    limits = [(-math.inf, math.inf) if pair is None else pair for pair in arm.joint_limits or (None,) * arm.n_links]
    ranges = moving.ranges.reshape(-1, 2)
    if len(task.targets) == 1:  # a swing from the start to either side
        wide = ranges[0, 1]
        return bool(limits[0][0] <= begin[0, 0] - wide and begin[0, 1] + wide <= limits[0][1])
    nearest, farthest = _distances(arm, limits[1:])
    wide = 0.0 if moving.line is not None else ranges[2, 1]
    endless = all(math.isinf(limit) for limit in limits[0])
    return bool(endless and nearest <= ranges[0, 0] - wide and ranges[0, 1] + wide <= farthest)


def _none(starts: Starts, arm: Arm, gravity: np.ndarray) -> check.InvalidValue:
    what = f"must hold targets that {arm.name!r} reaches within its joint limits"
    if gravity.any():
        what += " and that its motors hold against gravity"
    return check.InvalidValue("starts.target", list(starts.target), f"{what}: none of {SAMPLES} drawn ones is")


def _with_payload(arm: Arm, factor: float) -> Arm:
    """Return the arm with its payload's mass multiplied by a factor."""
    if factor == 1.0:
        return arm
    return dataclasses.replace(arm, payload=dataclasses.replace(arm.payload, mass=factor * arm.payload.mass))


def _all_within(arm: Arm, task: Task, starts: Starts) -> bool:
    """Return True only if a planar arm certainly reaches every target that can be drawn within its joint limits."""
    limits = [(-math.inf, math.inf) if pair is None else pair for pair in arm.joint_limits or (None,) * arm.n_links]
    low, high = starts.target[0]
    if len(task.targets) == 1:
        first, last = starts.start[0] if task.relative else (0.0, 0.0)
        if starts.straight > 0.0 and task.relative:
            first, last = min(first, 0.0), max(last, 0.0)
        return limits[0][0] <= first + low and last + high <= limits[0][1]
    if limits[0][1] - limits[0][0] < 2.0 * math.pi:
        return False
    nearest, farthest = _distances(arm, limits[1:])
    # the distance changes continuously with the elbows, so that every value between two reachable ones is reachable
    return nearest <= low and high <= farthest


def _distances(arm: Arm, limits: list[Pair]) -> Pair:
    """Return the smallest and largest distance of the tip from the root, m.

    The elbow angles are sampled on a grid within their limits.
    """
    grids = [np.linspace(max(low, -math.pi), min(high, math.pi), _ELBOWS) for low, high in limits]
    grids = [np.append(grid, np.clip(0.0, grid[0], grid[-1])) for grid in grids]
    many = len(grids) > 3  # all alike, and turned to and fro
    elbows = np.array([*zip(*grids, strict=True)] if many else [*itertools.product(*grids)])
    if many:
        sides = np.where(np.arange(len(grids)) % 2 == 0, 1.0, -1.0)
        low, high = (np.array([grid.min() for grid in grids]), np.array([grid.max() for grid in grids]))
        elbows = np.concatenate([elbows, np.clip(elbows * sides, low, high)])
    bearings = np.concatenate([np.zeros((len(elbows), 1)), np.cumsum(elbows, axis=1)], axis=1)
    found = np.abs(np.exp(1j * bearings) @ np.array([link.span for link in arm.links]))
    return float(found.min()), float(found.max())
