"""Strain gauges in space: weights of the rotations of the elements beside a gauge's station.

Bending moments and torque are interpolated linearly between the middles of an exact beam's elements, which is exact for
loads at vertices; the reading is the moment at the station divided by the stiffness there. A segment with a floating
frame has its own shape functions.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ... import validation as check
from ...parameters import Link
from ...scene import Scene
from ...settings import Settings
from ..floating.beam_element import mesh
from .build import AXES_OF_STRAINS, count_elements, polynomials, turns_of
from .build import _elements as _packed
from .layout import ELEMENT, GAUGE
from .segments import ENDS, frames, turned_over

Array = NDArray[np.float64]

AXIS = {"xy": (2, 1.0), "xz": (1, -1.0), "torsion": (0, 1.0)}
"""For each measure, the component of the rotation vector (0: x, 1: y, 2: z) that a gauge reads, and its sign."""


def gauges(scene: Scene, settings: Settings, spots: Sequence[Any]) -> Array:
    """Return (G, GAUGE.length): one packed `GAUGE` record for each spot (link, place) or (link, place, measure).

    place: fraction of the link's length. measure: a key of `AXIS`, "xy" by default.
    """
    found = []
    if settings.modes is not None and len(spots):
        what = "must be left out where strain gauges are read in space: these know segments of one element"
        raise check.InvalidValue("modes", settings.modes, what)
    for k, place, *more in spots:
        link, (axis, sign) = scene.arm.links[k], AXIS[more[0] if more else "xy"]
        own = _segment if settings.formulation == "floating_frame" else _elements
        first, near, far, rest = own(link, count_elements(link, settings), place * link.length, axis)
        found.append(
            GAUGE.pack({}, link=k, element=first, axis=axis, near=sign * near, far=sign * far, rest=sign * rest)
        )
    return np.array(found, np.float64).reshape(len(spots), GAUGE.places.end)


def strained_rows(scene: Scene, settings: Settings, system: Any, spots: Sequence[Any]) -> Array:
    """Return (G, n): row g times the coordinates q is the reading of gauge g. For links with strains as coordinates.

    spots: as in `gauges`. A reading (1/m) is the strain at the station relative to the stress-free link.
    """
    n, names, found = polynomials(settings), list(system.names), np.zeros((len(spots), len(system.q0)))
    for row, (k, place, *more) in zip(found, spots, strict=True):
        axis, sign = AXIS[more[0] if more else "xy"]
        # kappa = sum_j c_j P_j(2 s/L - 1) / L (9.4)
        first = names.index(f"link{k}.{AXES_OF_STRAINS[axis]}1")
        values = np.polynomial.legendre.legvander(2.0 * place - 1.0, n - 1).ravel() / scene.arm.links[k].length
        row[first : first + 3 * n : 3] = sign * values
    return found


def _stiffness(link: Link, s: Array, axis: int) -> Array:
    """Return the stiffness (N m^2) of a link at position s (m): GJ, EI_y or EI for axis 0, 1 or 2."""
    return np.asarray(link.along(s).EI if axis == 2 else link.across(s)["GJ" if axis == 0 else "EI_y"])


def _elements(link: Link, n: int, s: float, axis: int) -> tuple[int, Array, Array, float]:
    """Return a gauge's weights: (first element, weights of its ends, weights of the next element's ends, rest reading).

    The reading (1/m) is a weighted sum of the rotations (rad) of the ends of elements `first` and first + 1, minus the
    rest reading without stress. The weights (2,), 1/m, are for the left and right end; they are 0 if there is no next
    element.
    n: number of elements.
    s: position of the gauge on the link, m.
    axis: 0 for torsion, 1 and 2 for bending about y and z.
    """
    ends = link.mesh(n, "elements")
    own = [ELEMENT.unpack(packed) for packed in _packed(link, n, 1.0)]
    # M of an element acts at its middle, or at its center of flexibility int x/EI / int 1/EI
    lengths, stiff = np.diff(ends), np.array([one["EI"][axis] for one in own])
    middles = 0.5 * (ends[1:] + ends[:-1])
    if axis > 0:
        middles = middles + lengths * [one["tilt"][axis - 1] for one in own]
    first = int(np.clip(np.searchsorted(middles, s, side="right") - 1, 0, max(0, n - 2)))
    pair = [first] if n == 1 else [first, first + 1]
    # kappa(s) = M(s) / EI(s), M linear between two elements
    share = 0.0 if n == 1 else (s - middles[first]) / (middles[first + 1] - middles[first])
    here = float(_stiffness(link, np.array(s), axis))
    weights = np.array([1.0 - share, share])[: len(pair)] * stiff[pair] / here / lengths[pair]
    rest = float(weights @ turns_of(link, ends)[pair]) if axis == 2 else 0.0
    sides = np.zeros((2, 2))
    sides[: len(pair)] = np.outer(weights, [-1.0, 1.0])
    return first, sides[0], sides[1], rest


def _segment(link: Link, n: int, s: float, axis: int) -> tuple[int, Array, Array, float]:
    """Return the values of `_elements` for a segment with a floating frame at s (m), from its shapes' curvatures."""
    ends = link.mesh(n, "segments")
    e = int(np.clip(np.searchsorted(ends, s, side="right") - 1, 0, n - 1))
    # torsion: (phi_r - phi_l) / l; bending: second derivative of the shapes
    weights = np.array([-1.0, 1.0]) / (ends[e + 1] - ends[e])
    if axis > 0:
        part = mesh(link if axis == 2 else turned_over(link), n, "segments")[e]
        weights = part.bend((s - ends[e]) / part.length)[ENDS]
    natural = frames(link, n, None)[e][1]
    rest = float(weights @ [-natural.near, natural.far]) if axis == 2 else 0.0
    return e, weights, np.zeros(2), rest
