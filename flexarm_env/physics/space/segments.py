"""Constants of segments with floating frames in space: the planar elements of both bendings, and torsion."""

from __future__ import annotations

import dataclasses
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ... import curves
from ... import validation as check
from ...parameters import Link, Section, Taper
from ...settings import Settings
from ..floating.beam_element import QUADRATURE, Element, coupling_matrix, mesh
from .layout import FRAME, WEIGHT

Array = NDArray[np.float64]

ENDS = [2, 5]
"""Rotations among the six coordinates of a planar element."""

LEAST_ROTARY = 1e-8
"""Rotary inertia about the axis, over m l^2 of a segment, that none falls below: its ends turn by themselves."""


def refuse(settings: Settings) -> None:
    """What floating frames in space do not have, by name."""
    for name, value, wanted, instead in (
        ("modes", settings.modes, None, "segments=..., whose number takes the place of modes"),
        ("multipliers", settings.multipliers, False, "multipliers=False: joints are coordinates there"),
        ("frame", settings.frame, "chord", "frame='chord'"),
        ("coupling", settings.coupling, "von_karman", "coupling='von_karman'"),
        ("elements", settings.elements, 1, "elements=1, and more segments"),
    ):
        if value != wanted:
            raise check.InvalidValue(name, value, f"is one of the plane; in space take {instead}")


def turned_over(link: Link) -> Link:
    """The link with what bends it in the x-z plane in the place of what bends it in the x-y plane, straight."""

    def over(one: Section) -> Section:
        across: dict[str, Any] = {"EI": one.EI_y, "C": one.C_y, "J": one.J_y}
        return dataclasses.replace(one, **across)

    section: Any = link.section
    if isinstance(section, Taper):
        section = dataclasses.replace(section, widths=section.thicknesses, thicknesses=section.widths)
    elif isinstance(section, Section):
        section = over(section)
    else:
        section = tuple((s, over(one)) for s, one in section)
    return dataclasses.replace(link, section=section, curvature=0.0)


def torsion(link: Link, a: float, b: float) -> float:
    """GJ, N m^2, of a piece from a to b: of springs one behind the other."""
    x, w = np.polynomial.legendre.leggauss(8)
    return float(2.0 / (w @ (1.0 / link.across(0.5 * (a + b) + 0.5 * (b - a) * x)["GJ"])))


def _pairs(weights: Array, a: Array, b: Array) -> Array:
    """(ll, lr, rr) of two functions at points."""
    return np.array([weights @ (a * a), weights @ (a * b), weights @ (b * b)])


def _frame(link: Link, plane: Element, across: Element, start: float) -> tuple[Array, tuple[float, float, float]]:
    """A `FRAME`, and the turn from the left section to the chord, the chord's length, the turn to the right section
    without stress."""
    l, both = plane.length, np.ix_(ENDS, ENDS)
    bend, coupling = np.zeros((3, 3)), np.zeros((3, 3))
    twist = torsion(link, start, start + l) / l
    bend[:, 0] = twist, -twist, twist
    upper = np.triu_indices(2)
    moments = np.zeros((2, 3))
    for axis, part in ((1, across), (2, plane)):
        bend[:, axis] = part.stiffness()[both][upper]
        coupling[:, axis] = coupling_matrix(part.section, l)[np.ix_([1, 3], [1, 3])][upper]
    w: Array = np.zeros(2)
    if link.curved:
        for xi, weight, section in plane.points:
            kappa = float(curves.along(plane.link.curvature, xi * l))
            moments[:, 2] += weight * l * section.EI * kappa * plane.bend(xi)[ENDS]
        w[:] = np.linalg.solve(plane.stiffness()[both], moments[:, 2])
    # inertia
    rotary, lateral, near, far = np.zeros((6, 3)), np.zeros((3, 3)), np.zeros((2, 3)), np.zeros((2, 3))
    for axis, part in ((1, across), (2, plane)):
        points = part.points
        at, share = np.array([p[0] for p in points]), l * np.array([p[1] for p in points])
        shapes = np.array([part.shapes(xi) for xi, _, _ in points])
        h, phi = shapes[:, 1][:, ENDS].T, shapes[:, 2][:, ENDS].T
        m, J = (share * np.array([getattr(p[2], name) for p in points]) for name in ("m", "J"))
        rest = 1.0 - phi[0] - phi[1]
        rotary[:3, axis] = _pairs(J, *phi)
        rotary[3:, axis] = J @ (phi[0] * rest), J @ (phi[1] * rest), J @ (rest * rest)
        lateral[:, axis] = _pairs(m, *h)
        side = 3 - axis  # a rotation about z moves along y
        near[:, side], far[:, side] = h @ (m * (1.0 - at)), h @ (m * at)
        rotary[:3, 0] += _pairs(J, 1.0 - at, at)
        mass = _pairs(m, 1.0 - at, at)
    least = LEAST_ROTARY * plane.section.m * l**3
    if rotary[0, 0] < least / 3.0:
        rotary[:3, 0] = least / 3.0, least / 6.0, least / 3.0
    rows = []
    for xi, weight in zip(*QUADRATURE, strict=True):
        hy, hz = (part.shapes(xi)[1][ENDS] for part in (plane, across))
        dm = float(plane.link.along(np.array([xi * l])).m[0]) * weight * l
        rows.append(WEIGHT.pack({}, xi=xi, mass=dm, left=[0.0, hy[0], hz[0]], right=[0.0, hy[1], hz[1]]))
    pull = plane.section.EA / l
    packed = FRAME.pack(
        {}, length=l, pull=pull, bend=bend, coupling=coupling, moment=moments, spent=0.5 * moments[:, 2] @ w,
        rotary=rotary, mass=mass, near=near, far=far, lateral=lateral, points=np.concatenate(rows),
    )  # fmt: skip
    stretch = 0.5 * float(w @ coupling_matrix(plane.section, l)[np.ix_([1, 3], [1, 3])] @ w)
    return packed, (-float(w[0]), l - stretch, float(w[1]))


@lru_cache(64)
def frames(link: Link, n: int) -> tuple[tuple[Array, tuple[float, float, float]], ...]:
    """`_frame` of each of n segments; kept, since arms are used again and again."""
    if n == 0:
        return ()
    planes, across = mesh(link, n, "segments"), mesh(turned_over(link), n, "segments")
    ends = link.mesh(n, "segments")
    pieces = zip(planes, across, ends[:-1].tolist(), strict=True)
    return tuple(_frame(link, plane, other, s) for plane, other, s in pieces)
