"""Build the `SpatialElastica` of a scene in space: links with strains as coordinates, without stretch and shear."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ... import curves
from ... import validation as check
from ...parameters import Link
from ...scene import PointLoad, Scene
from ...settings import Settings
from ..elastica.build import HEAVIER
from ..elastica.slenderness import _largest
from ..model import System
from ..protocol import NewtonPolicy
from . import build as chains
from .build import polynomials
from .chain import SpatialElastica
from .layout import F
from .strained_layout import NOTED, STRAINED

Array = NDArray[np.float64]

LEAST_POLAR = 1e-8
"""Lower bound of a link's rotary inertia about its axis, divided by the link's m l^2; torsion needs some inertia."""


class Grid(NamedTuple):
    """Quadrature along a link of length 1 with n polynomials per strain and n + 2 Gauss points.

    ends: (points + 2,), ends of the intervals: 0, the Gauss points, and 1
    ways: (points + 1, points), weights by which the tangents at the points give the position of each point and of the
    end
    sums, slants: (points + 1, polynomials), integral s and first moment d of each polynomial over each interval
    """

    at: Array  # positions of the Gauss points (0 to 1), and their weights
    weights: Array
    ends: Array
    ways: Array
    inner: Array  # (points + 1, 12): positions at which the strain is evaluated to integrate it over each interval
    sums: Array
    slants: Array


@lru_cache(32)
def grid(n: int) -> Grid:
    """Return the `Grid` (quadrature along a link) for n polynomials per strain; the result is cached."""
    legendre, points = np.polynomial.legendre, n + 2
    x, w = legendre.leggauss(points)
    # ways w_pq: int_0^(x_p) of the Lagrange polynomial of point q, so that r_p = L sum_q w_pq t_q
    lagrange = np.linalg.inv(legendre.legvander(x, points - 1))
    ways = 0.5 * np.array([legendre.legval([*x, 1.0], legendre.legint(c, lbnd=-1)) for c in lagrange.T]).T
    # quadrature within each interval, for s and d (9.5)
    ends = np.concatenate([[0.0], 0.5 * (1.0 + x), [1.0]])
    inner = ends[:-1, None] + np.diff(ends)[:, None] * (0.5 + 0.5 * INNER[0])
    sums, slants = _interval(np.diff(ends), np.asarray(legendre.legvander(2.0 * inner - 1.0, n - 1), np.float64))
    return Grid(0.5 * (1.0 + x), 0.5 * w, ends, ways, inner, sums, slants)


INNER = np.polynomial.legendre.leggauss(12)
"""Nodes and weights of the Gauss rule that integrates strains over an interval between two Gauss points."""


def _interval(h: Array, strain: Array) -> tuple[Array, Array]:
    """Return the integral s and the first moment d of a strain over each interval, each of shape (intervals, ...).

    h contains the lengths of the intervals; `strain` (intervals, 12, ...) the strain at the points of `INNER`. The
    moment d is about the interval's middle, divided by h.
    """
    x, w = INNER
    share = 0.5 * h.reshape(-1, *np.ones(strain.ndim - 2, int))
    return share * np.tensordot(strain, w, (1, 0)), share * np.tensordot(strain, 0.5 * w * x, (1, 0))


def _link(link: Link, n: int, damping: float) -> Array:
    """Pack the `STRAINED` record of a link with n polynomials per strain; it contains zeros for a rigid link.

    damping: the link's share of the arm's largest Kelvin-Voigt time constant. The record's inertia correction stays
    zero.
    """
    own, sizes, L = grid(n), {"polynomials": n, "points": n + 2}, link.length
    if link.rigid:
        return np.zeros(STRAINED.offsets(0, **sizes).end)
    s = L * own.at
    plane, across = link.along(s), link.across(s)
    # stiffness (3, n, n): int P_i diag(GJ, EI_y, EI) P_j ds / L^2
    P = np.polynomial.legendre.legvander(2.0 * own.at - 1.0, n - 1)
    D = np.array([across["GJ"], across["EI_y"], plane.EI])
    stiffness = np.einsum("ap,pi,pj->aij", D * own.weights / L, P, P)
    # J about x, y, z (section axes) of each point; s, d of kappa_0
    J, J_y = plane.J, across["J_y"]
    inertia = np.stack([np.maximum(J + J_y, LEAST_POLAR * plane.m * L**2), J_y, J], axis=1)
    natural = _interval(L * np.diff(own.ends), curves.along(link.curvature, L * own.inner))
    return STRAINED.pack(
        sizes, sums=own.sums, slants=own.slants, natural=np.array(natural).T, ways=L * own.ways,
        mass=L * own.weights * plane.m, inertia=(L * own.weights)[:, None] * inertia, K_EI=stiffness,
        damping=damping, correction=np.zeros_like(stiffness),
    )  # fmt: skip


def _inertia(packed: dict[str, Array]) -> Array:
    """Return the inertia matrices (3, n, n), kg m^2, of the strains of a straight link whose root rotates freely.

    The first index selects torsion, bending about y, or bending about z.
    packed: fields of the link's `STRAINED` record.
    """
    # rotation of each interval's end by each polynomial; lateral displacement of points by root rotation and strains
    angles = np.cumsum(packed["sums"], axis=0)
    along, aside = packed["ways"].sum(axis=1), packed["ways"] @ angles[:-1]
    found = []
    for axis in range(3):
        turn = np.hstack([np.ones((len(along) - 1, 1)), angles[:-1]])
        M = np.einsum("p,pi,pj->ij", packed["inertia"][:, axis], turn, turn)
        if axis > 0:
            moved = np.hstack([along[:-1, None], aside[:-1]])
            M += np.einsum("p,pi,pj->ij", packed["mass"], moved, moved)
        # M of free ends: the root's rotation theta condensed, M_cc - M_ct M_tt^-1 M_tc
        found.append(M[1:, 1:] - np.outer(M[1:, 0], M[0, 1:]) / M[0, 0])
    return np.array(found)


def _correction(packed: dict[str, Array], settings: Settings) -> Array:
    """Return the correction (3, n, n), kg m^2, subtracted from the strains' inertia for steps h (theory 5.3, 9).

    See also `elastica.build`. The correction applies only to bending about the softer axis, or to both axes if they are
    equally stiff. In a bent link torsion and the stiffer bending move the same mass. Subtracting inertia from one of
    them would leave negative inertia to motions that have hardly any.
    """
    from scipy.linalg import eigh

    assert settings.dt is not None
    lengthening, share = 2.0 * settings.period_error * settings.dt**2, HEAVIER * settings.dt**4
    # M - M* of (5.3), symmetrized
    M, K = _inertia(packed), packed["K_EI"]
    C = (lengthening * K - share * K @ np.linalg.solve(M, K)) @ np.linalg.solve(M + lengthening * K, M)
    C = np.asarray(0.5 * (C + C.transpose(0, 2, 1)))
    softest = ALIKE * min(K[1, 0, 0], K[2, 0, 0])
    for axis in range(3):
        # torsion and the stiffer bending: modes become heavier only, because in bent links both move one mass and M -
        # M* might become negative
        if axis == 0 or K[axis, 0, 0] > softest:
            squares, modes = eigh(K[axis], M[axis])
            taken = (lengthening * squares - share * squares**2) / (1.0 + lengthening * squares)
            moved = M[axis] @ modes
            C[axis] = (moved * np.minimum(taken, 0.0)) @ moved.T
    return C


def physical(model: SpatialElastica) -> SpatialElastica:
    """Return the model with the links' physical inertia, without the inertia correction for time steps."""
    assert model.strains is not None
    strains, n = model.strains.copy(), len(model.polynomials)
    STRAINED.unpack(strains.reshape(model.links, -1), polynomials=n, points=n + 2)["correction"][:] = 0.0
    return model._replace(strains=strains)


NEWTON = NewtonPolicy(acceleration_share=1.0, resolved=(0,), reuse=((0,) * 1, (0,) * 2))
"""Rules of the Newton iteration. The first matrix is used for three iterations, because a matrix costs at least as much
as four residuals. After the third iteration, each iteration computes a new matrix."""

ALIKE = 1.01
"""Two bending stiffnesses of a section count as equal if their ratio is at most this value."""

ALONG = 4.0
"""Quotient of two ratios of shear to bending deflection: that of a swinging link over that of a clamped link. A link
that swings about a pin under its own inertia has the ratio 12 EI / (C L^2). A clamped link under a force at its tip has
the ratio 3 EI / (C L^2)."""

BENT = 0.3
"""Deflection of a link that is assumed before a run, as a fraction of the link's length."""


class Notes(dict[str, float]):
    """Estimate "stretch_and_shear": the error, as a fraction of the arm's length, of neglecting stretch and shear.

    The estimate assumes the force that deflects a link by `BENT` times its length, or a larger force if the scene
    applies one. The estimate includes the stretch of links that rotate with prescribed joints, with all mass at the
    tip, because a longer link is also softer.
    """

    def __init__(self, scene: Scene) -> None:
        arm = scene.arm
        links = [link for link in arm.links if not link.rigid]
        # centrifugal stretch: prescribed rates (rad/s), all mass at the tip
        rate = sum(_largest(m.function, scene.duration, 1) for m in scene.motions if m.joint is not None)
        mass = arm.payload.mass + sum(elbow.mass for elbow in arm.elbows) + sum(0.5 * link.mass for link in arm.links)
        stretch = rate**2 * arm.total_length * mass / min((link.series("EA") for link in links), default=math.inf)
        shares = [_soft(link) for link in links]
        self.share = max((sheared / bent for sheared, bent in shares), default=0.0) + 3.0 * stretch
        # F sheared, twice: a link swings to twice its static deflection and back
        known = 2.0 * max((_force(scene, mass) * sheared for sheared, _ in shares), default=0.0)
        super().__init__(stretch_and_shear=min(1.0, max(BENT * self.share, known) + stretch))

    @property
    def softer(self) -> float:
        """Factor on EI. With it, bending alone deflects the most affected link as much as stretch and shear would.

        For slender links the error estimate is the distance of a run from a run with this factor (`accuracy.followed`).
        """
        return 1.0 / (1.0 + ALONG * self.share)


def _soft(link: Link) -> tuple[float, float]:
    """Return (1/C, L^2/(3 EI)), 1/N: flexibility of a clamped link to a tip force, by shear and by bending.

    The flexibility is the tip's deflection divided by the link's length and by the force.

    Each value is for the direction in which the link is softest; stretch counts like shear. Along the link the largest
    flexibility to shear and the smallest flexibility to bending are used, which overestimates their ratio.
    """
    s = np.linspace(0.0, link.length, 33)
    plane, across = link.along(s), link.across(s)
    sheared = max(float((1.0 / x).max()) for x in (plane.C, across["C_y"], plane.EA))
    bent = max(float((1.0 / x).min()) for x in (plane.EI, across["EI_y"]))
    return sheared, bent * link.length**2 / 3.0


def _force(scene: Scene, mass: float) -> float:
    """Return the largest known force (N): weight plus the largest values of all point loads, wherever they act."""
    pushes = [
        _largest(f, scene.duration)
        for load in scene.loads
        if isinstance(load, PointLoad)
        for f in (load.force_x, load.force_y, load.force_z)
        if f is not None
    ]
    return mass * float(np.linalg.norm(scene.gravity or 0.0)) + sum(pushes)


def build(scene: Scene, settings: Settings) -> System:
    """Build the `System` of a scene for the elastica in space: each strain of a link has `nodes` - 1 polynomials."""
    arm, n = scene.arm, polynomials(settings)
    for k, link in enumerate(arm.links):
        if not link.rigid and len(link.jumps):
            what = "must not jump along a link under the elastica in space; take geometrically_exact or floating_frame"
            raise check.InvalidValue(f"links[{k}].section", f"{len(link.jumps)} jumps", what)
    _, shares = arm.damping
    strains = [_link(link, n, 1.0 if shares is None else shares[k]) for k, link in enumerate(arm.links)]
    # inertia that steps leave out (theory 5.3)
    for link, packed in zip(arm.links, strains, strict=True):
        if not link.rigid:
            fields = STRAINED.unpack(packed, polynomials=n, points=n + 2)
            fields["correction"][:] = _correction(fields, settings)
    mass, room = STRAINED.offsets(0, n, n + 2), F.end + NOTED.offsets(0, n, n + 2).end
    return chains.system(
        scene, settings, SpatialElastica, float(sum(packed[mass.mass : mass.inertia].sum() for packed in strains)),
        [*[room] * arm.n_links, 0], Notes(scene), newton=NEWTON, strains=np.concatenate(strains),
        polynomials=(0,) * n, points=(0,) * (n + 2), scratch=(0,) * (3 * n + 6),
        curved=(0,) if any(link.curved for link in arm.links if not link.rigid) else None,
    )  # fmt: skip
