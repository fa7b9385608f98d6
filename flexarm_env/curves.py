"""Curvature of a stress-free link: one number, or a linear function between points along the link."""

from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexarm_env import validation as check
from flexarm_env.validation import Array

Curvature = float | tuple[tuple[float, float], ...]
"""Curvature, 1/m, positive to the left: one number, or pairs (s, curvature) with s in m from the root. Equal s mark a
jump.
"""

GAUSS = np.polynomial.legendre.leggauss(12)
"""Gauss points and weights on [-1, 1] for a piece of a link that turns by less than 0.5 rad."""


def checked(value: object, length: float) -> Curvature:
    """Validate a curvature and return it; if the curvature is the same at all points, return one number.

    Raises:
        ValueError: a value is not a number (1/m), or the points do not run from 0 to `length` (m) in order.
    """
    if not isinstance(value, list | tuple):
        return check.number("curvature", value, "1/m")
    what = "a number (1/m) or two or more pairs, s (m) and a curvature (1/m)"
    if len(value) < 2:
        raise check.InvalidValue("curvature", value, f"must be {what}")
    found: list[tuple[float, float]] = []
    for i, entry in enumerate(value):
        s, kappa = check.sequence(f"curvature[{i}]", entry, "s (m) and a curvature (1/m)", 2)
        place = check.number(f"curvature[{i}][0]", s, "m", minimum=0.0)
        found.append((place, check.number(f"curvature[{i}][1]", kappa, "1/m")))
    found[-1] = check_places("curvature[{}][0]", [s for s, _ in found], length), found[-1][1]
    values = {kappa for _, kappa in found}
    return values.pop() if len(values) == 1 else tuple(found)


def check_places(key: str, places: list[float], length: float) -> float:
    """Validate positions along a link (distances from the root, m) and return the link's length.

    Positions must increase from 0 to the length; two equal positions define a jump. The last position is set to the
    exact length. key: key path for error messages, with {} in place of the index.
    """
    if places[0] != 0.0:
        raise check.InvalidValue(key.format(0), places[0], "must be 0, the link's root")
    last = len(places) - 1
    # the last point may differ from the length by round-off
    if abs(places[last] - length) > 1e-9 * length:
        raise check.InvalidValue(key.format(last), places[last], f"must be the link's length, {length:g} m")
    places[last] = length
    for i in range(1, len(places)):
        at_an_end = places[i] == places[i - 1] and i in (1, last)
        if places[i] < places[i - 1] or at_an_end or (i > 1 and places[i] == places[i - 2]):
            allowed = "must not be below the one before it; two alike are a jump, within the link and not at its ends"
            raise check.InvalidValue(key.format(i), places[i], allowed)
    return length


def between(places: Array, s: Array, before: bool) -> tuple[NDArray[np.int64], Array]:
    """Return for each position s the interval of points around s, and the fraction (0 to 1) of the interval before s.

    The interval is given by the index of its first point. At a jump the function returns the interval after the jump;
    if `before` is True, the interval before the jump.
    """
    i = np.clip(np.searchsorted(places, s, side="left" if before else "right") - 1, 0, len(places) - 2)
    return i, np.clip((s - places[i]) / (places[i + 1] - places[i]), 0.0, 1.0)


def points(curve: Curvature) -> tuple[float, ...]:
    """Return the positions within a link at which the curvature has a kink or a jump, m from the root."""
    return () if isinstance(curve, float) else tuple(s for s, _ in curve[1:-1])


def jumps(curve: Curvature) -> tuple[float, ...]:
    """Return the positions within a link at which the curvature jumps, m from the root."""
    return () if isinstance(curve, float) else tuple(s for (s, _), (after, _) in pairwise(curve) if s == after)


def along(curve: Curvature, s: Any, before: bool = False) -> Array:
    """Return the curvature (1/m) at positions s (m); at a jump the value after the jump, or, if `before` is True, the
    value before the jump."""
    s = np.asarray(s, np.float64)
    if isinstance(curve, float):
        return np.full(s.shape, curve)
    places, values = np.array(curve).T
    i, share = between(places, s, before)
    return np.asarray(values[i] + (values[i + 1] - values[i]) * share)


def angle(curve: Curvature, s: Any) -> Array:
    """Return the tangent's angle (rad) at positions s (m) relative to the root: the integral of the curvature."""
    s = np.asarray(s, np.float64)
    if isinstance(curve, float):
        return np.asarray(curve * s)
    total = np.zeros(s.shape)
    # linear pieces: int (one + (other - one) x / (b - a)) dx
    for (a, one), (b, other) in pairwise(curve):
        if b > a:
            x = np.clip(s, a, b) - a
            total = total + x * (one + 0.5 * (other - one) * x / (b - a))
    return total


def place(curve: Curvature, s: Any) -> NDArray[np.complex128]:
    """Return the points at arc lengths s (m) as complex numbers x + iy, m, in the axes of the root's tangent.

    x + iy = int_0^s exp(i angle) ds, by Gauss quadrature on intervals in which the angle changes by less than half a
    radian.
    """
    s = np.asarray(s, np.float64)
    if isinstance(curve, float) and curve == 0.0:
        return np.asarray(s, np.complex128)
    # mesh: all places s, kinks, and pieces of at most 1 / (2 max|curvature|)
    ends = np.unique(np.concatenate([[0.0], points(curve), s.ravel()]))
    strongest = abs(curve) if isinstance(curve, float) else max(abs(kappa) for _, kappa in curve)
    pieces = [np.linspace(a, b, 1 + max(1, int(np.ceil(2.0 * strongest * (b - a))))) for a, b in pairwise(ends)]
    mesh = np.unique(np.concatenate([[0.0], *pieces]))
    # Gauss quadrature per piece, then cumulative sums
    half = 0.5 * np.diff(mesh)[:, None]
    inner = np.exp(1j * angle(curve, mesh[:-1, None] + half * (1.0 + GAUSS[0]))) @ GAUSS[1] * half[:, 0]
    sums = np.concatenate([[0.0], np.cumsum(inner)])
    return np.asarray(sums[np.searchsorted(mesh, s)])


def part(curve: Curvature, first: float, last: float) -> Curvature:
    """Return the curvature between the positions first and last (m), with s measured from `first`."""
    if isinstance(curve, float):
        return curve
    inner = [(s - first, kappa) for s, kappa in curve if first < s < last]
    ends = float(along(curve, first)), float(along(curve, last, True))
    return ((0.0, ends[0]), *inner, (last - first, ends[1]))
