"""Constants of segments with floating frames in space: planar elements for bending about y and z, and torsion.

A segment that is reduced to n modes has n shapes for bending in each plane: two static shapes of its rotated ends and n
- 2 `inner` shapes. The inner shapes are the lowest modes of the segment between pins, minus the rotations of the ends
in these modes. The coordinate of an inner mode is its largest slope or section rotation before this subtraction.
Torsion has a linear shape and n - 2 sine waves between fixed ends.
"""

from __future__ import annotations

import dataclasses
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ... import curves
from ... import validation as check
from ...compiler import kernel
from ...layout import Field, Layout
from ...parameters import Link, Section, Taper
from ...settings import Settings
from ..floating.beam_element import BENDING, Element, coupling_matrix, mesh
from ..floating.reduction import MESH, pinned_modes
from .layout import inner_of

Array = NDArray[np.float64]

ENDS = [2, 5]
"""Indices of the end rotations among the six coordinates of a planar element."""

LEAST_ROTARY = 1e-8
"""Lower bound of rotary inertia divided by m l^2. It applies to a segment about its axis and to an exact element about
any axis. The bound is needed because the ends' rotations are independent coordinates."""

POINTS = 4
"""Number of Gauss points for the mass of a segment without inner modes."""

WEIGHT = Layout(
    "Weight", "inner",
    Field("xi", (), "", "position along the chord, from 0 (left) to 1 (right)"),
    Field("mass", (), "kg", "mass of the Gauss point"),
    Field("left", (3,), "m", "h along y, z: the point is h (phi x e_x) off the chord; phi: rotation of the left end"),
    Field("right", (3,), "m", "h along y, z for the rotation of the right end, as in `left`"),
    Field("inner", ("inner", 3), "m", "h along y, z for the amplitudes of each inner mode"),
)  # fmt: skip

FRAME = Layout(
    "SpatialFrame", "inner, points",
    Field("length", (), "m", "reference length l of the segment"),
    Field("pull", (), "N/m", "EA / l, stiffness of the chord for stretch"),
    Field("K_EI", (3, 3), "N m",
          "stiffness K about x, y, z for the rotations phi: blocks (left, left), (left, right), (right, right)"),
    Field("coupling", (3, 3), "m", "coupling H of stretch with bending (theory 1.2), blocks as in `K_EI`"),
    Field("moment", (2, 3), "N m", "moments K phi_0 of the stress-free rotations phi_0 about x, y, z: left, right"),
    Field("spent", (), "J", "phi_0^T K phi_0 / 2, the energy of the stress-free rotations phi_0"),
    Field("rotary", (6, 3), "kg m^2",
          "rotary inertia about x, y, z: (l, l), (l, r), (r, r), (l, frame), (r, frame), (frame, frame)"),
    Field("mass", (3,), "kg", "mass matrix of the ends' positions: (left, left), (left, right), (right, right)"),
    Field("near", (2, 3), "kg m",
          "int m (1 - xi) h: coupling of the left position with the left and the right rotation, h of `WEIGHT`"),
    Field("far", (2, 3), "kg m", "int m xi h: coupling of the right position with left and right rotation"),
    Field("lateral", (3, 3), "kg m^2",
          "int m h h of rotations about x, y, z: (left, left), (left, right), (right, right)"),
    Field("points", ("points", WEIGHT.length), "", "Gauss points of the mass, a `WEIGHT` each"),
    Field("inner_K_EI", ("inner", "inner", 3), "N m",
          "stiffness of the inner modes about x, y, z; inner modes do not couple with the ends' rotations"),
    Field("inner_coupling", ("inner", "inner + 2", 3), "m",
          "coupling H of each inner mode with left, right, inner modes"),
    Field("inner_lateral", ("inner", "inner + 2", 3), "kg m^2",
          "int m h h of each inner mode with left, right, inner modes"),
    Field("inner_rotary", ("inner", "inner + 3", 3), "kg m^2",
          "rotary inertia of each inner mode with left, right, frame, inner modes"),
    Field("inner_near", ("inner", 3), "kg m", "int m (1 - xi) h of each inner mode"),
    Field("inner_far", ("inner", 3), "kg m", "integral of m xi h for each inner mode"),
    Field("inner_moment", ("inner", 3), "N m", "stiffness times stress-free amplitudes, about x, y, z"),
    Field("roll", ("inner + 2", "inner + 2", 3), "kg m^2",
          "int m h_i h_j across planes (left, right, inner): [1] h_i on y, h_j on z; [2] reverse"),
)  # fmt: skip

W = WEIGHT.offsets(0, 0)
_frame_at, _weight_at = kernel(FRAME.offsets), kernel(WEIGHT.offsets)


def points_for(inner: int) -> int:
    """Return the number of Gauss points for the mass of a segment with `inner` inner modes."""
    return POINTS + 2 * inner


@kernel
def points_of(model: Any) -> Any:
    """Return the number of Gauss points for the mass of each segment of the model."""
    return POINTS + 2 * inner_of(model)


@kernel
def frame_at(model: Any, i: Any) -> Any:
    """Return the offsets, in model.frames, of the fields of the `FRAME` record of segment i, counted over all links."""
    inner, points = inner_of(model), points_of(model)
    return _frame_at(i * _frame_at(0, inner, points).end, inner, points)


@kernel
def weight_end(model: Any) -> Any:
    """Return the length of one `WEIGHT` record in model.frames, in float64 entries."""
    return _weight_at(0, inner_of(model)).end


def refuse(settings: Settings) -> None:
    """Raise `InvalidValue` for settings that floating frames in space do not support."""
    if settings.modes == 1:
        what = "must be at least 2 in space: a segment's ends turn by themselves, and each bends it"
        raise check.InvalidValue("modes", 1, what)
    for name, value, wanted, instead in (
        ("multipliers", settings.multipliers, False, "multipliers=False: joints are coordinates there"),
        ("frame", settings.frame, "chord", "frame='chord'"),
        ("coupling", settings.coupling or "von_karman", "von_karman", "coupling='von_karman'"),
        ("elements", settings.elements or 1, 1, "modes=3 or more, which bend a segment between its ends"),
    ):
        if value != wanted:
            raise check.InvalidValue(name, value, f"is one of the plane; in space take {instead}")


def turned_over(link: Link) -> Link:
    """Return a straight link whose bending properties in the x-y plane are those of `link` in the x-z plane."""

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
    """Return the torsional stiffness GJ (N m^2) of a link between positions a and b (m): harmonic mean of GJ."""
    x, w = np.polynomial.legendre.leggauss(8)
    return float(2.0 / (w @ (1.0 / link.across(0.5 * (a + b) + 0.5 * (b - a) * x)["GJ"])))


class _Plane:
    """Constants for bending of a segment in one plane by n shapes: two shapes of rotated ends, then inner modes.

    K, H: bending stiffness (n, n), N m, and coupling with stretch (n, n), m
    moment, h: stress-free moments (n,), N m, and deflections of the shapes (n, points), m
    phi, at: section rotations of the shapes (n, points), and positions (points,) over length
    dm, dJ: mass (kg) and rotary inertia (kg m^2) of the quadrature points, (points,)
    """

    def __init__(self, part: Element, modes: int | None) -> None:
        self.part, self.parts, self.n = part, [part], modes or 2
        self.nodal, self.K = np.zeros((4, 2)), part.stiffness()[np.ix_(ENDS, ENDS)]
        # static shapes: phi = 1 at one end, 0 at the other
        self.nodal[[1, 3], [0, 1]] = 1.0
        if modes is not None:
            # modes between pins with phi = 0 at both ends (Craig and Bampton), scaled to a slope of 1
            K, nodal = pinned_modes(part.link, modes)
            basis = np.eye(modes)
            basis[:2, 2:] = -nodal[[1, -1], 2:]
            slopes = np.abs(np.diff(nodal[0::2, 2:], axis=0)).max(axis=0) * (MESH / part.length)
            basis[:, 2:] /= np.maximum(slopes, np.abs(nodal[1::2, 2:]).max(axis=0))  # alike in both planes
            self.parts, self.nodal, self.K = mesh(part.link, MESH, "elements"), nodal @ basis, basis.T @ K @ basis
        starts = [one.at(0.0) - self.parts[0].at(0.0) for one in self.parts]
        self.starts = np.array(starts)
        self.H, self.moment, rows = np.zeros((self.n, self.n)), np.zeros(self.n), []
        for e, (start, one) in enumerate(zip(starts, self.parts, strict=True)):
            own = self.nodal[2 * e : 2 * e + 4]
            # H = int (v' v' - gamma gamma); v and phi of the shapes at the quadrature points
            self.H += own.T @ coupling_matrix(one.section, one.length) @ own
            for xi, weight, section in one.points:
                x, dx, (_, v, phi) = start + xi * one.length, weight * one.length, one.shapes(xi)
                rows.append([x, dx, section.m, section.J, *(v[BENDING] @ own), *(phi[BENDING] @ own)])
                if one.link.curved:
                    kappa = float(curves.along(one.link.curvature, xi * one.length))
                    self.moment += dx * section.EI * kappa * (one.bend(xi)[BENDING] @ own)
        x, dx, m, J, *shapes = np.array(rows).T
        self.at, self.dm, self.dJ = x / part.length, m * dx, J * dx
        self.h, self.phi = np.array(shapes[: self.n]), np.array(shapes[self.n :])

    def across(self, x: float) -> Array:
        """Return the deflections h (m) of the n shapes at the distance x (m) from the segment's left end."""
        e = int(np.searchsorted(self.starts, x, "right")) - 1
        xi = (x - self.starts[e]) / self.parts[e].length
        return np.asarray(self.parts[e].shapes(xi)[1][BENDING] @ self.nodal[2 * e : 2 * e + 4])


class Natural(NamedTuple):
    """Stress-free shape of a segment or element, in the plane of its curvature."""

    near: float  # rad: rotation from the left section to the chord
    length: float  # m: length of the chord
    far: float  # rad: rotation from the chord to the right section
    inner: tuple[float, ...] = ()  # rad: amplitudes of the inner modes about x, y, z


_UPPER = np.triu_indices(2)


def _symmetric(weights: Array, rows: Array) -> Array:
    """Return the matrix of the integrals of w f_i f_j, for functions f in rows (n, points) and weights w (points,)."""
    return np.asarray((rows * weights) @ rows.T)


def _frame(link: Link, plane: Element, across: Element, start: float, modes: int | None) -> tuple[Array, Natural]:
    """Return the packed `FRAME` record and the `Natural` (stress-free shape) of the segment that begins at `start` (m).

    plane, across: the segment's planar elements in the x-y and in the x-z plane.
    modes: number of shapes per plane, or None for the two static shapes.
    """
    l, n = plane.length, modes or 2
    inner, both = n - 2, (_Plane(across, modes), _Plane(plane, modes))
    # axis 0: torsion, 1: bending in the x-z plane, 2: bending in the x-y plane; the frame is the last row of `rotary`
    K, H, rotary = (np.zeros((n + k, n + k, 3)) for k in (0, 0, 1))  # the frame comes last
    moments = np.zeros((n, 3))
    twist = torsion(link, start, start + l) / l
    # torsion: phi = 1 - xi, xi of the ends, sin(k pi xi) inside
    K[:2, :2, 0] = twist * np.array([[1.0, -1.0], [-1.0, 1.0]])
    waves = np.pi * np.arange(1, inner + 1)[:, None]
    # bending: K, H, and J with 1 - sum of the shapes' rotation for the frame
    for axis, one in zip((1, 2), both, strict=True):
        K[..., axis], H[..., axis] = one.K, one.H
        rest = 1.0 - one.phi[0] - one.phi[1]
        rotary[..., axis] = _symmetric(one.dJ, np.vstack([one.phi, rest]))
        moments[:, axis] = one.moment
        twisted = np.vstack([1.0 - one.at, one.at, np.sin(waves * one.at), 0.0 * one.at])
        rotary[..., 0] += _symmetric(one.dJ, twisted)
    # int GJ phi_j' phi_k' of the waves
    x, weights = np.polynomial.legendre.leggauss(32)
    at, slopes = 0.5 * (1.0 + x), waves * np.cos(waves * 0.5 * (1.0 + x)) / l
    K[2:, 2:, 0] = _symmetric(0.5 * l * weights * np.asarray(link.across(start + l * at)["GJ"]), np.asarray(slopes))
    # J about the axis at least LEAST_ROTARY m l^2: ends rotate by J alone
    least = LEAST_ROTARY * plane.section.m * l**3
    if rotary[0, 0, 0] < least / 3.0:
        rotary[..., 0] = 0.0
        rotary[:2, :2, 0] = least / 6.0 * (np.ones((2, 2)) + np.eye(2))
        rotary[2:n, 2:n, 0] = 0.5 * least * np.eye(inner)
    # h of either bending at Gauss points, for int m n n
    x, weights = np.polynomial.legendre.leggauss(points_for(inner))
    at, h = 0.5 * (1.0 + x), np.zeros((len(x), n, 3))
    dm = 0.5 * l * weights * plane.link.along(at * l).m
    for side, one in ((2, both[0]), (1, both[1])):  # a rotation about z moves along y
        h[..., side] = [one.across(s) for s in (at * l).tolist()]
    rows = [
        WEIGHT.pack({"inner": inner}, xi=at[p], mass=dm[p], left=h[p, 0], right=h[p, 1], inner=h[p, 2:])
        for p in range(len(x))
    ]
    # int m (1 - xi, xi)^2, int m h, int m h h over the segment
    ends = np.array([1.0 - at, at])
    mass = _symmetric(dm, ends)[_UPPER]
    near, far = np.einsum("p,ep,pnc->enc", dm, ends, h)
    lateral = np.einsum("p,pnc,pmc->nmc", dm, h, h)[..., [0, 2, 1]]  # about x, y, z
    both_planes = np.einsum("p,pn,pm->nm", dm, h[..., 2], h[..., 1])
    order = [0, 1, n, *range(2, n)]  # the frame before inner modes
    # phi without stress: K phi = int EI kappa_0 phi'
    w: Array = np.zeros(n)
    if link.curved:
        w[:] = np.linalg.solve(K[..., 2], moments[:, 2])
    packed = FRAME.pack(
        {"inner": inner, "points": len(rows)}, length=l, pull=plane.section.EA / l, K_EI=K[:2, :2][_UPPER],
        coupling=H[:2, :2][_UPPER], moment=moments[:2], spent=0.5 * moments[:, 2] @ w,
        rotary=[*rotary[:2, :2][_UPPER], *rotary[:2, n], rotary[n, n]], mass=mass, near=near[:2], far=far[:2],
        lateral=lateral[:2, :2][_UPPER], points=np.concatenate(rows), inner_K_EI=K[2:, 2:], inner_coupling=H[2:],
        inner_lateral=lateral[2:], inner_rotary=rotary[2:n, order], inner_near=near[2:], inner_far=far[2:],
        inner_moment=moments[2:], roll=np.stack([0.0 * both_planes, both_planes.T, both_planes], axis=-1),
    )  # fmt: skip
    bent = np.zeros((inner, 3))
    bent[:, 2] = w[2:]
    return packed, Natural(-float(w[0]), l - 0.5 * float(w @ H[..., 2] @ w), float(w[1]), tuple(bent.ravel().tolist()))


@lru_cache(64)
def frames(link: Link, n: int, modes: int | None) -> tuple[tuple[Array, Natural], ...]:
    """Return the pair (`FRAME`, `Natural`) for each of a link's n segments; the result is cached."""
    if n == 0:
        return ()
    planes, across = mesh(link, n, "segments"), mesh(turned_over(link), n, "segments")
    ends = link.mesh(n, "segments")
    pieces = zip(planes, across, ends[:-1].tolist(), strict=True)
    return tuple(_frame(link, plane, other, s, modes) for plane, other, s in pieces)
