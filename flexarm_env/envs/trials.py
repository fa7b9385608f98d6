"""Nonlinear trial episodes of a user's arm, which measure how much large motions amplify the errors of small motions.

Linear theory does not contain the buckling of links, or whip-like motions of chains. Trials therefore simulate episodes
of 100 control periods in steps of h and of h/2, with bang-bang torques that are constant for 1 or for 8 periods. Let

    d    be the largest distance between the tips in the two simulations, divided by the arm's length L, or infinite if
         a simulation fails,
    d_1  be the largest distance between the tips of small motions in steps of h and of h/2, divided by L, plus the
         Newton tolerance,
    e_1  be the error of small motions due to step and mesh (`resolution`).

The factor d / d_1 measures the amplification of errors, and the error of the trial is max(d, e_1 d / d_1). If the
factor d / d_1 exceeds `GROWN`, settings must also satisfy a second condition: on the next finer mesh in steps of h/2,
the tips must have nearly the same positions. If a PD loop sustains a vibration ("chatters"), the trial's error is the
distance between the tips on the two meshes.

With random factors (keyword `randomization`), two more arms run the same episodes as the nominal arm: the softest arm
with the heaviest payload and the strongest torques, and the stiffest arm with the lightest payload.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any, Protocol

import numpy as np

from .. import arms
from ..batch import ACTION_NOT_FINITE, Amplifier, Batch, Extras
from ..parameters import Arm
from ..settings import Settings
from ..validation import Array
from .features import Frame, controller
from .judge import MARGIN
from .small_motions import PERIODS
from .small_motions_models import small_motions
from .task import Kind, reward_weights

LANES_AT_CORNERS, HELD = 8, (1, 8)
"""Number of episodes with factors at the ends of their ranges, half of which begin straight; numbers of periods for
which actions are held."""

TRIED = 2e-3
"""Largest accepted error of a trial, divided by L; steps and meshes are refined until the error is below `TRIED`."""

NOISE = 2.0
"""A finer setting replaces the best one unless its error is larger by this factor, because chaotic errors scatter."""

TAIL, SCATTER = 3.0, 1e-3
"""Number of standard deviations of log d within which 99.9 % of normal episodes lie; smallest d of an episode, divided
by the largest."""

GROWN = 10.0
"""Amplification d / d_1 above which a trial with a small error is checked by episodes on the next mesh."""

IDLE = 4
"""If a PD loop moves the arm, one of `IDLE` episodes has no action, so that the arm must settle."""

Trial = Callable[[Settings], Array]
"""Function of settings that returns tip positions (PERIODS, lanes, 2 or 3), m; nan after an episode's end, inf at a
failure."""


class Rule(Protocol):
    """Interface of `judge.Judge`: error estimates from small motions."""

    def small(self, settings: Settings, h: float) -> float:
        """Return e_1, the error of small motions with these settings and the time step h, s, divided by L."""

    def halved(self, settings: Settings, h: float) -> float:
        """Return the largest distance between the tips of small motions with time steps h, s, and h/2, divided by L."""


KEPT = 16
"""Number of arms whose trials are cached, because environments of one arm are often made one after the other."""

_kept: dict[Any, Trial] = {}


@lru_cache(1)
def shipped() -> frozenset[Arm]:
    """Return the arms of the package; they have the default settings, and their trials were run in advance."""
    return frozenset(arms.named(name) for name in arms.names())


AMPLIFICATIONS = {
    ("three_dof", "geometrically_exact"): 2072.0,
    ("three_dof", "floating_frame"): 3342.0,
    ("three_dof_loaded", "geometrically_exact"): 2862.0,
    ("three_dof_loaded", "floating_frame"): 8890.0,
    ("three_strips", "elastica"): 83.1,
    ("turret_boom", "geometrically_exact"): 260.0,
    ("turret_boom", "floating_frame"): 527.0,
    ("two_link_upright", "elastica"): 8905.0,
    ("two_link_upright", "floating_frame"): 61.0,
    ("two_link_upright", "geometrically_exact"): 79.7,
}
"""Factor d / d_1 of a trial with the usual settings, where trials raise the estimate; keys: arm and formulation."""


MILD = {"EI": (0.5, math.inf), "payload": (0.0, 2.0), "torque_constant": (0.0, 1.5)}
"""Ranges of drawn factors (`starts.FACTORS`) within which a packaged arm keeps the usual settings without a trial."""


def is_known(arm: Arm, drawn: Mapping[str, tuple[float, float]]) -> bool:
    """Return True if no trial is needed, because the package contains the arm and random factors are within `MILD`."""
    mild = all(low <= drawn[name][0] and drawn[name][1] <= high for name, (low, high) in MILD.items() if name in drawn)
    return mild and arm in shipped()


def amplification(arm: Arm, formulation: str) -> float:
    """Return the arm's entry in `AMPLIFICATIONS`, or 0 if the arm has no entry."""
    return next((x for (name, own), x in AMPLIFICATIONS.items() if own == formulation and arms.named(name) == arm), 0.0)


def trials_of(
    kind: Kind, arm: Arm, period: float, gravity: tuple[float, ...] | None, mode: str, share: float | None,
    amplifier: Amplifier | None, drawn: Mapping[str, tuple[float, float]] | None = None,
) -> Trial:  # fmt: skip
    """Return a function of settings that runs the trial episodes of an arm and returns the tip positions (`Trial`).

    Functions for the latest arms are cached.

    Args:
        kind: definition of the environment's task, without the user's reward terms. arm: the arm. period: control
            period, s. gravity: m/s^2, or None. mode: the action mode. share: largest residual torque that is added to a
            PD loop, divided by the torque limit. amplifier: the amplifier, or None. drawn: ranges (low, high) of random
            factors by name (`starts.FACTORS`).
    """
    drive = None if amplifier is None else tuple(None if x is None else tuple(x.tolist()) for x in amplifier)
    ends = corners(drawn or {})
    key = kind.id, kind.axes, arm, period, gravity, mode, share, drive, repr(ends)
    if key in _kept:
        return _kept[key]
    motions = small_motions(arm)

    @lru_cache(2 * motions.trials + 2)
    def tips(settings: Settings) -> Array:
        # corners of the drawn factors as further lanes
        parts = [episodes(settings, motions.lanes, {}), *(episodes(settings, LANES_AT_CORNERS, one) for one in ends)]
        return np.concatenate(parts, axis=1)

    def episodes(settings: Settings, lanes: int, factors: Mapping[str, float]) -> Array:
        """Run `lanes` episodes of bang-bang torques. factors: by name, factors on the arm's nominal values.

        Returns the tip positions (PERIODS, lanes, 2 or 3), m; nan after an episode's end, inf in the period of a
        failure.
        """
        starts = kind.starts(arm, 1)  # the widest ranges
        starts = replace(starts, drawn=dict(starts.drawn) | {name: (x, x) for name, x in factors.items()})
        record = kind.build(arm, reward_weights(kind, None, arm.n_links, period, PERIODS, 2), period, {})
        loop = controller(Frame(kind, arm, settings, period, gravity), mode, share)
        batch = Batch(
            arm, settings, lanes, record, starts, period=period, gravity=gravity,
            extras=Extras(controller=loop, amplifier=amplifier),
        )  # fmt: skip
        batch.start(range(lanes // 2, lanes), range(lanes // 2), limit=PERIODS + 1)
        batch.request[: arm.n_links] = 0.0  # straight
        batch.start(range(lanes // 2), range(lanes // 2), limit=PERIODS + 1)
        at = batch.info_at
        found: Array = np.full((PERIODS, lanes, at.deflection - at.tip), np.nan)
        live = np.ones(lanes, bool)
        for k, action in enumerate(_actions(arm.n_links, lanes)):
            batch.action[...] = action
            if loop is not None:
                batch.action[::IDLE] = 0.0
            batch.step()
            failed = live & batch.terminated & (batch.table[at.reason, :lanes] < ACTION_NOT_FINITE)
            live &= ~batch.terminated
            found[k, live] = batch.table[at.tip : at.deflection, :lanes].T[live]
            found[k, failed] = np.inf
        batch.close()
        return found

    while len(_kept) >= KEPT:
        # another thread may drop the same one
        _kept.pop(next(iter(_kept)), None)
    return _kept.setdefault(key, tips)


def corners(drawn: Mapping[str, tuple[float, float]]) -> list[dict[str, float]]:
    """Return the factors of the softest and the stiffest randomized arm; omit an arm that equals the nominal arm.

    drawn: ranges (low, high) of random factors by name (`starts.FACTORS`).
    """
    soft = {"EI": 0, "payload": 1, "torque_constant": 1, "damping": 0}  # ends of the ranges
    found = []
    for ends in (soft, {"EI": 1, "payload": 0, "torque_constant": 1, "damping": 0}):
        factors = {name: float(drawn[name][end]) for name, end in ends.items() if name in drawn}
        if any(factor != 1.0 for factor in factors.values()) and factors not in found:
            found.append(factors)
    return found


@lru_cache(8)
def _actions(count: int, lanes: int) -> Array:
    """Return bang-bang actions (PERIODS, lanes, N): each is +-1 and held for a number of periods from `HELD`."""
    draw, found = np.random.default_rng(11), np.zeros((PERIODS, lanes, count))
    for i in range(lanes):
        held = HELD[i % len(HELD)]
        signs = np.where(draw.random((-(-PERIODS // held), count)) < 0.5, -1.0, 1.0)
        found[:, i] = np.repeat(signs, held, axis=0)[:PERIODS]
    return found


def _apart(one: Array, two: Array, length: float) -> float:
    """Return d, the largest distance between the tips of two trials, divided by `length`, until either episode ends.

    The logarithms of errors that grow exponentially are about normally distributed. The result d is therefore the
    larger of two numbers. One number is the largest distance in the lanes. The second number is the distance `TAIL`
    standard deviations above the mean of the logarithms, divided by MARGIN; almost all episodes have smaller distances.
    one, two: tip positions from two calls of a `Trial`. length: length of the arm, m. d is inf if an episode failed.
    """
    if np.isinf(one).any() or np.isinf(two).any():
        return math.inf
    lanes = np.nan_to_num(np.linalg.norm(one - two, axis=2)).max(axis=0) / length
    largest = float(lanes.max())
    if largest == 0.0:
        return 0.0
    # episodes that hardly move do not widen the scatter
    logs = np.log(np.maximum(lanes, SCATTER * largest))
    return max(largest, math.exp(float(logs.mean()) + TAIL * float(logs.std())) / MARGIN)


def error(trial: Trial, rule: Rule, settings: Settings, finer: Settings, length: float) -> tuple[float, float]:
    """Return the error max(d, e_1 d / d_1) of a trial, divided by the arm's length, and the factor d / d_1.

    The module's docstring defines d, d_1 and e_1. finer: the settings with half the step. length: length of the arm, m.
    """
    assert settings.dt is not None
    apart = _apart(trial(settings), trial(finer), length)
    gain = apart / (rule.halved(settings, settings.dt) + settings.tolerance)
    return max(apart, gain * rule.small(settings, settings.dt)), gain


def refined(
    trial: Trial, rule: Rule, first: Settings, meshes: Sequence[Settings], at: Callable[[Settings, float], Settings],
    least: float, length: float, most: int,
) -> tuple[Settings, float]:  # fmt: skip
    """Search for settings with a trial error of at most `TRIED`; return the best settings found, and their error.

    The search begins with `first`. The error is divided by the arm's length. meshes: settings with finer meshes, from
    the coarsest. at: function of (settings, step, s) that returns the settings with this step and a suitable Newton
    tolerance. least: shortest step that is tried, s. length: length of the arm, m. most: largest number of settings
    that are tried.
    """
    # meshes that small motions find worse, as many nodes on short pieces of a link are, do not help
    worst = NOISE * rule.small(first, least)
    settings, left = first, [mesh for mesh in meshes if rule.small(mesh, least) <= worst]
    tried: list[tuple[Settings, float]] = []
    for _ in range(most):
        h = settings.dt
        assert h is not None
        finest = at(settings, 0.5 * h)
        found, gain = error(trial, rule, settings, finest, length)
        of_mesh = gain * rule.small(settings, least) if math.isfinite(gain) else 0.0
        if found <= TRIED and left and gain > GROWN:
            # the next mesh runs too: small motions may miss the mesh's share
            of_mesh = _apart(trial(settings), trial(at(left[0], 0.5 * h)), length)
            found = max(found, of_mesh)
        tried.append((settings, found))
        more = 0.5 * h >= least * (1.0 - 1e-9)
        if found <= TRIED:
            # near a step that fails other episodes fail too
            failed = any(math.isinf(one) for _, one in tried)
            return (finest if failed and more else settings), found
        if left and of_mesh > 0.5 * TRIED:
            settings = at(left.pop(0), h)
        elif more:
            settings = at(settings, 0.5 * h)
        else:
            break
    # errors of all, by the finest run too, which is free of what small motions say about meshes
    best, chosen, lowest = first, math.inf, math.inf
    for one, found in tried:
        known = max(found, _apart(trial(one), trial(finest), length))
        if known <= NOISE * lowest:
            best, chosen = one, known
        lowest = min(lowest, known)
    return best, chosen


def settled(
    trial: Trial, settings: Settings, finer: Settings, at: Callable[[Settings, float], Settings], least: float,
    length: float,
) -> tuple[Settings, float]:  # fmt: skip
    """Halve the step until episodes change little with half the step and a finer mesh; return settings and distance.

    The distance is the largest distance between the tips in the two episodes, divided by the arm's length. The search
    ends if the distance is at most `TRIED`, or if the next step would be shorter than `least`, s. finer: settings with
    the finer mesh. at: function of (settings, step, s), see `refined`. length: length of the arm, m.
    """
    best, chosen = settings, math.inf
    while True:
        h = settings.dt
        assert h is not None
        found = _apart(trial(settings), trial(at(finer, 0.5 * h)), length)
        # the finest that runs: a loop that chatters is bounded, and so are the errors of steps that do not resolve it
        if math.isfinite(found) or math.isinf(chosen):
            best, chosen = settings, found
        if found <= TRIED or 0.5 * h < least * (1.0 - 1e-9):
            return best, chosen
        settings = at(settings, 0.5 * h)
