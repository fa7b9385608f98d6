"""Division of a link into cells (elements, segments, node intervals) that end at jumps and kinks of its section.

A "piece" of a link is a part between two neighboring positions at which the link's section jumps or kinks, or the
link's curvature jumps. The cells of a link with one piece have equal length. Otherwise cells end at the ends of pieces,
and the number of cells per length is proportional to the density

    d(s) = EI(s)^(-1/2) / int EI^(-1/2) ds + KINKED |d ln EI / ds|                  (1/m)

The first term, whose integral along the link is 1, makes cells shorter where the link is softer. Cells of length l have
equal bending angles M l / EI if l ~ EI, and equal resolution of bending waves if l ~ EI^(1/4). The power 1/2 of the
density is a compromise between the powers 1 and 1/4. The second term adds cells where the stiffness changes by a large
factor, because the polynomial of a cell does not represent the curvature M / EI there.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple, Protocol

import numpy as np

from flexarm_env import validation as check
from flexarm_env.validation import Array

KINKED = 0.2
"""Weight of a change of ln EI by 1 in the cell density, whose first term has the integral 1 over the link."""

SAMPLES = 64
"""Number of intervals of a smooth piece in the trapezoidal rule for the density."""


class Stiffnesses(Protocol):
    """Properties of sections from which the density is computed."""

    @property
    def EI(self) -> Array:
        """Bending stiffness EI, N m^2."""
        ...


class Divisible(Protocol):
    """Attributes of a link from which its division into cells is computed (see `sections.Link`)."""

    def __hash__(self) -> int: ...

    @property
    def length(self) -> float:
        """Length of the link, m."""
        ...

    @property
    def breaks(self) -> tuple[float, ...]:
        """Positions of jumps and kinks of the section, and of both ends of the link, m from the root."""
        ...

    @property
    def jumps(self) -> tuple[float, ...]:
        """Positions at which the section or the curvature jumps, m from the root."""
        ...

    def along(self, s: Array | float, before: bool = False) -> Stiffnesses:
        """Return the section's properties at positions s, m.

        At a jump, the function returns the properties just after the jump, or just before the jump if `before`.
        """
        ...


class Piece(NamedTuple):
    """Piece of a link; its "weight" is the integral of the cell density over the piece."""

    first: float  # start of the piece, m from the link's root
    last: float  # end of the piece, m from the link's root
    places: Array  # (SAMPLES + 1,) positions, m from the link's root
    below: Array  # (SAMPLES + 1,): integral of the density from `first` to each place
    even: bool  # whether the density is constant

    @property
    def weight(self) -> float:
        """Integral of the cell density over the piece."""
        return float(self.below[-1])

    def ends(self, count: int) -> Array:
        """Return the positions (count,) at which `count` cells of equal weight begin, m from the link's root."""
        if self.even:
            return np.linspace(self.first, self.last, count, endpoint=False)
        # invert the integral of the density
        return np.interp(np.arange(count) / count * self.weight, self.below, self.places)


@lru_cache(512)
def _pieces(link: Divisible, kinks: bool) -> tuple[Piece, ...]:
    """Return the smooth pieces of a link, between jumps and kinks; if `kinks` is False, between jumps alone."""
    ends = link.breaks if kinks else (0.0, *link.jumps, link.length)
    sampled, spans = [], []
    # EI^(-1/2) along each piece; at its end the value before the jump
    for first, last in pairwise(ends):
        places = np.linspace(first, last, SAMPLES + 1)
        EI = link.along(places).EI
        EI[-1] = link.along(places[-1], before=True).EI
        root = 1.0 / np.sqrt(EI)
        spans.append(0.5 * (root[1:] + root[:-1]) * np.diff(places))  # trapezoidal rule
        sampled.append((first, last, places, EI))
    total = sum(float(span.sum()) for span in spans)
    found = []
    # integral of the density: first term by the trapezoidal rule, second term exactly from ln EI
    for (first, last, places, EI), span in zip(sampled, spans, strict=True):
        own = span / total + KINKED * abs(np.diff(np.log(EI)))
        even = bool(np.ptp(EI) <= 1e-12 * EI[0])
        found.append(Piece(first, last, places, np.concatenate([[0.0], np.cumsum(own)]), even))
    return tuple(found)


def pieces(link: Divisible, n: int, option: str) -> tuple[Piece, ...]:
    """Return the pieces of a link; if there are more pieces than n cells, only jumps divide the link.

    option: name of the option that sets n, for messages. Raises ValueError, which names the option, if n is too small
    for the jumps.
    """
    # a cell cannot span a jump
    least = len(link.jumps) + 1
    if n < least:
        more = option == "nodes"  # one more than there are cells
        what = f"must be at least {least + more} for a link whose sections jump {least - 1} times"
        raise check.InvalidValue(option, n + more, what)
    return _pieces(link, n >= len(link.breaks) - 1)


def counts(found: Sequence[Piece], n: int, most: int | None = None) -> list[int]:
    """Return the number of cells in each piece, n in total.

    Each piece has at least one cell. Each further cell is added to the piece with the largest weight per cell.

    most: largest number of cells in a piece; None: no limit. n must not exceed `most` times the number of pieces.
    """
    weights, cells = np.array([piece.weight for piece in found]), np.ones(len(found), np.int64)
    for _ in range(n - len(found)):
        # pieces that have `most` cells get no further one
        full = cells >= (n if most is None else most)
        cells[np.argmax(np.where(full, 0.0, weights / cells))] += 1
    return [int(count) for count in cells]


def ends(link: Divisible, n: int, option: str) -> Array:
    """Return the ends (n + 1,) of n cells, m from the link's root. option: name of the user's option for n."""
    if len(link.breaks) == 2:
        return np.linspace(0.0, link.length, n + 1)
    found = pieces(link, n, option)
    starts = [piece.ends(count) for piece, count in zip(found, counts(found, n), strict=True)]
    return np.concatenate([*starts, [link.length]])


def cells_like(link: Divisible, n: int) -> int:
    """Return how many cells give a link with jumps and kinks the resolution that a uniform link has with n cells."""
    if len(link.breaks) == 2:
        return n
    return sum(max(1, int(np.ceil(n * piece.weight - 1e-9))) for piece in _pieces(link, True))


def middles(link: Divisible, n: int) -> list[float]:
    """Return the positions, m from the root, that divide each piece into halves of equal weight.

    n: number of cells; it must exceed the number of jumps.
    """
    return [float(piece.ends(2)[1]) for piece in _pieces(link, n >= len(link.breaks) - 1)]


def divides(fine: Divisible, m: int, link: Divisible, n: int) -> bool:
    """Return whether m cells divide `fine` at least as finely as n cells divide `link`.

    fine: the same link with additional points, so that its pieces are the halves of the pieces of `link`. Each piece of
    `fine` must have at least as many cells as the piece of `link` that contains this piece.
    """
    found, halves = (_pieces(one, k >= len(one.breaks) - 1) for one, k in ((link, n), (fine, m)))
    whole, own = counts(found, n), counts(halves, m)
    if len(own) != 2 * len(whole):
        return m >= 2 * n
    return all(count >= least for count, least in zip(own, np.repeat(whole, 2), strict=True))
