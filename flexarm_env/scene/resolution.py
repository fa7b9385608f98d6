"""Find the longest time step that resolves the motions and loads of a scene."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from flexarm_env import validation as check
from flexarm_env.scene.definition import Scene
from flexarm_env.settings import Settings
from flexarm_env.time_functions import AMPLITUDE, C0, C2, OMEGA, T0, TimeFunction
from flexarm_env.validation import Array

IN_A_PERIOD = 16
"""Steps per period of a sine; the companion run of an error estimate, with twice the step, has half as many."""

ROUGH = 0.1
"""Permitted deviation of a function from straight lines between its values at the steps, as a fraction of its range."""

NO_PART = 1e-9
"""Amplitude relative to the function's size below which a sine counts as round-off."""

MOST_HALVINGS = 12
"""Maximum number of step halvings for cubic pieces that are shorter than the step."""

MOST_REFINED, MOST_STEPS = 100.0, 1e7
"""Limits of refinement. A function of time is rejected if its step is more than MOST_REFINED times shorter than the
longest step and the run has more than MOST_STEPS such steps.
"""


def resolving_step(scene: Scene, longest: float | Settings, end: float) -> float:
    """Return a time step, s, that resolves all motions, loads and obstacle displacements until the time `end`, s.

    Args:
        longest: upper limit of the time step, s, or solver settings whose dt is this limit.
    Raises:
        ValueError: a function of time would need too many steps; the message names the function.
    """
    dt = longest.dt if isinstance(longest, Settings) else longest
    assert dt is not None
    found, path_of = dt, ""
    for path, function in functions(scene):
        own = _of_sines(function, end)
        if own < found:
            found, path_of = own, path
        own = _of_cubics(function, found, end)
        if own < found:
            found, path_of = own, path
    if found < dt / MOST_REFINED and end / found > MOST_STEPS:
        what = (
            f"must be slower: the function needs steps of at most {found:.2g} s, {end / found:.0e} of them in "
            f"{end:g} s; leave it out, or give dt = {found:.2g} to run it nevertheless"
        )
        raise check.InvalidValue(path_of, f"too fast for dt = {dt:g} s", what)
    return found


def functions(scene: Scene) -> Iterator[tuple[str, TimeFunction]]:
    """Yield the key path and function of time of every motion, load and moving obstacle."""
    for i, motion in enumerate(scene.motions):
        yield f"motions[{i}].function", motion.function
    for i, load in enumerate(scene.loads):
        for function in load.functions:
            yield f"loads[{i}]", function
    for i, contact in enumerate(scene.contacts):
        for axis, function in contact.displacements:
            yield f"contacts[{i}].displacement_{'xyz'[axis]}", function


def _of_sines(function: TimeFunction, end: float) -> float:
    """Return the shortest sine period divided by `IN_A_PERIOD`, s; inf if no sine lasts a quarter of its period."""
    rows = function.pieces
    starts = rows[:, T0]
    # lasting: duration of each piece within [0, end]; size: of the whole function
    lasting = np.minimum(np.append(starts[1:], np.inf), end) - np.maximum(starts, 0.0)
    size = np.abs(rows[:, C0:C2]).max() + np.abs(rows[:, AMPLITUDE]).max()
    # sines of more than round-off size that turn by more than pi / 2 within their piece
    counts = (np.abs(rows[:, AMPLITUDE]) > NO_PART * size) & (rows[:, OMEGA] * lasting > 0.5 * math.pi)
    fastest = float(np.max(np.abs(rows[counts, OMEGA]), initial=0.0))
    return 2.0 * math.pi / (IN_A_PERIOD * fastest) if fastest > 0.0 else math.inf


def _of_cubics(function: TimeFunction, dt: float, end: float) -> float:
    """Return dt (s), halved until straight lines between steps are within `ROUGH` of the range of the function."""
    rows = function.pieces[function.pieces[:, T0] < end]
    if len(rows) < 2 or not rows[:, C2:AMPLITUDE].any():
        return dt
    places = np.append(rows[:, T0], end)
    # no inner piece is shorter than dt: steps miss nothing
    if not (np.diff(places)[:-1] < dt).any():
        return dt
    # compare at quarters of each piece
    inside = (places[:-1, None] + np.diff(places)[:, None] * np.array([0.0, 0.25, 0.5, 0.75])).ravel()
    values = function(inside)
    # steps end at kinks of value and slope
    allowed, stops = ROUGH * float(np.ptp(values)), np.array([0.0, *function.kinks_up_to(1), end])
    stops = np.unique(stops[(stops >= 0.0) & (stops <= end)])
    for _ in range(MOST_HALVINGS):
        if float(np.abs(values - _lines(function, stops, dt, inside)).max()) <= allowed:
            break
        dt = 0.5 * dt
    return dt


def _lines(function: TimeFunction, stops: Array, dt: float, at: Array) -> Array:
    """Return the values at instants `at` of straight lines between steps of at most dt (s); steps end at `stops`."""
    # equal steps in each interval between stops
    counts = np.maximum(1, np.ceil(np.diff(stops) / dt * (1.0 - 1e-9))).astype(np.int64)
    parts = [np.linspace(a, b, n, endpoint=False) for a, b, n in zip(stops[:-1], stops[1:], counts, strict=True)]
    ends = np.append(np.concatenate(parts), stops[-1])
    # linear interpolation in the step that contains the instant
    i = np.clip(np.searchsorted(ends, at, side="right") - 1, 0, len(ends) - 2)
    before, after = function(ends[:-1]), function(ends[1:], side="left")
    share = np.clip((at - ends[i]) / (ends[i + 1] - ends[i]), 0.0, 1.0)
    return np.asarray(before[i] + share * (after[i] - before[i]))
