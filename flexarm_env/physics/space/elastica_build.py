"""A scene in space to its `SpatialElastica`: links by their strains, without stretch and shear."""

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
from . import build as chains
from .build import polynomials
from .chain import SpatialElastica
from .layout import F
from .strained_layout import NOTED, STRAINED

Array = NDArray[np.float64]

LEAST_POLAR = 1e-8
"""Rotary inertia about its axis, over m l^2 of a link, that none falls below: torsion is a motion of its own."""


class Grid(NamedTuple):
    """Of a link of length 1: Gauss's points and weights, the ends of the intervals (points + 2), what points and the
    end are ahead by of each tangent (points + 1, points), and s and d by each polynomial (points + 1, polynomials)."""

    at: Array
    weights: Array
    ends: Array
    ways: Array
    inner: Array  # (points + 1, 12): where intervals look at the strain
    sums: Array
    slants: Array


@lru_cache(32)
def grid(n: int) -> Grid:
    """That of n polynomials; kept."""
    legendre, points = np.polynomial.legendre, n + 2
    x, w = legendre.leggauss(points)
    lagrange = np.linalg.inv(legendre.legvander(x, points - 1))
    ways = 0.5 * np.array([legendre.legval([*x, 1.0], legendre.legint(c, lbnd=-1)) for c in lagrange.T]).T
    ends = np.concatenate([[0.0], 0.5 * (1.0 + x), [1.0]])
    inner = ends[:-1, None] + np.diff(ends)[:, None] * (0.5 + 0.5 * INNER[0])
    sums, slants = _interval(np.diff(ends), np.asarray(legendre.legvander(2.0 * inner - 1.0, n - 1), np.float64))
    return Grid(0.5 * (1.0 + x), 0.5 * w, ends, ways, inner, sums, slants)


INNER = np.polynomial.legendre.leggauss(12)
"""Of an interval, over which strains are integrated."""


def _interval(h: Array, strain: Array) -> tuple[Array, Array]:
    """s and d, (intervals, ...), of intervals h and a strain at the points of `INNER` in each, (intervals, 12, ...):
    its integral, and its first moment about the middle over h."""
    x, w = INNER
    share = 0.5 * h.reshape(-1, *np.ones(strain.ndim - 2, int))
    return share * np.tensordot(strain, w, (1, 0)), share * np.tensordot(strain, 0.5 * w * x, (1, 0))


def _link(link: Link, n: int, damping: float) -> Array:
    """Its `STRAINED`."""
    own, sizes, L = grid(n), {"polynomials": n, "points": n + 2}, link.length
    if link.rigid:
        return np.zeros(STRAINED.offsets(0, **sizes).end)
    s = L * own.at
    plane, across = link.along(s), link.across(s)
    P = np.polynomial.legendre.legvander(2.0 * own.at - 1.0, n - 1)
    D = np.array([across["GJ"], across["EI_y"], plane.EI])
    stiffness = np.einsum("ap,pi,pj->aij", D * own.weights / L, P, P)
    J, J_y = plane.J, across["J_y"]
    inertia = np.stack([np.maximum(J + J_y, LEAST_POLAR * plane.m * L**2), J_y, J], axis=1)
    natural = _interval(L * np.diff(own.ends), curves.along(link.curvature, L * own.inner))
    return STRAINED.pack(
        sizes, sums=own.sums, slants=own.slants, natural=np.array(natural).T, ways=L * own.ways,
        mass=L * own.weights * plane.m, inertia=(L * own.weights)[:, None] * inertia, stiffness=stiffness,
        damping=damping, correction=np.zeros_like(stiffness),
    )  # fmt: skip


def _inertia(packed: dict[str, Array]) -> Array:
    """(3, n, n) kg m^2, of the strains of a straight link whose root turns as it likes: torsion, bending about y, z."""
    angles = np.cumsum(packed["sums"], axis=0)
    along, aside = packed["ways"].sum(axis=1), packed["ways"] @ angles[:-1]
    found = []
    for axis in range(3):
        turn = np.hstack([np.ones((len(along) - 1, 1)), angles[:-1]])
        M = np.einsum("p,pi,pj->ij", packed["inertia"][:, axis], turn, turn)
        if axis > 0:
            moved = np.hstack([along[:-1, None], aside[:-1]])
            M += np.einsum("p,pi,pj->ij", packed["mass"], moved, moved)
        found.append(M[1:, 1:] - np.outer(M[1:, 0], M[0, 1:]) / M[0, 0])
    return np.array(found)


def _correction(packed: dict[str, Array], settings: Settings) -> Array:
    """(3, n, n) kg m^2, what to take from the inertia of the strains for steps of h (see `elastica.build`). Lighter it
    makes bending about the softer axis alone, or about both where they are alike: in a bent link torsion and the
    stiffer bending move the same mass, and what is taken from one of them would leave less than nothing of motions that
    have hardly any inertia."""
    from scipy.linalg import eigh

    assert settings.dt is not None
    lengthening, share = 2.0 * settings.period_error * settings.dt**2, HEAVIER * settings.dt**4
    M, K = _inertia(packed), packed["stiffness"]
    C = (lengthening * K - share * K @ np.linalg.solve(M, K)) @ np.linalg.solve(M + lengthening * K, M)
    C = np.asarray(0.5 * (C + C.transpose(0, 2, 1)))
    softest = ALIKE * min(K[1, 0, 0], K[2, 0, 0])
    for axis in range(3):
        if axis == 0 or K[axis, 0, 0] > softest:
            squares, modes = eigh(K[axis], M[axis])
            taken = (lengthening * squares - share * squares**2) / (1.0 + lengthening * squares)
            moved = M[axis] @ modes
            C[axis] = (moved * np.minimum(taken, 0.0)) @ moved.T
    return C


def physical(model: SpatialElastica) -> SpatialElastica:
    """The model with the inertia that the links have, for all that is not a step."""
    assert model.strains is not None
    strains, n = model.strains.copy(), len(model.polynomials)
    STRAINED.unpack(strains.reshape(model.links, -1), polynomials=n, points=n + 2)["correction"][:] = 0.0
    return model._replace(strains=strains)


ALIKE = 1.01
"""Bending stiffnesses whose ratio is at most this are alike."""

BENT = 0.3
"""By what share of its length a link is taken to be bent where nothing is known yet."""


class Notes(dict[str, float]):
    """ "stretch_and_shear", a fraction of the arm's length: what leaving them out costs under the force that bends a
    link by `BENT`, or that is known to act if that is more, and where links are stretched as joints turn as prescribed,
    with all mass at the tip; a longer link is softer, too."""

    def __init__(self, scene: Scene) -> None:
        arm = scene.arm
        links = [link for link in arm.links if not link.rigid]
        rate = sum(_largest(m.function, scene.duration, 1) for m in scene.motions if m.joint is not None)
        mass = arm.payload.mass + sum(elbow.mass for elbow in arm.elbows) + sum(0.5 * link.mass for link in arm.links)
        stretch = rate**2 * arm.total_length * mass / min((link.series("EA") for link in links), default=math.inf)
        shares = [_soft(link) for link in links]
        self.share = max((sheared / bent for sheared, bent in shares), default=0.0) + 3.0 * stretch
        known = 2.0 * max((_force(scene, mass) * sheared for sheared, _ in shares), default=0.0)  # swung to, and back
        super().__init__(stretch_and_shear=min(1.0, max(BENT * self.share, known) + stretch))

    @property
    def softer(self) -> float:
        """Factor on EI that makes links as soft as stretch and shear make the one that they soften most: what a run
        with it comes out apart is the estimate (`accuracy.followed`)."""
        return 1.0 / (1.0 + self.share)


def _soft(link: Link) -> tuple[float, float]:
    """What shear, or stretch, gives way to a force at the tip of a clamped link, and what bending does, 1/N of the
    length, each in the direction in which it is softest: 1/C, L^2/(3 EI)."""
    s = np.linspace(0.0, link.length, 33)
    plane, across = link.along(s), link.across(s)
    sheared = max(float((1.0 / x).max()) for x in (plane.C, across["C_y"], plane.EA))
    bent = max(float((1.0 / x).min()) for x in (plane.EI, across["EI_y"]))
    return sheared, bent * link.length**2 / 3.0


def _force(scene: Scene, mass: float) -> float:
    """N: weight, and the largest that loads push with, wherever these are."""
    pushes = [
        _largest(f, scene.duration)
        for load in scene.loads
        if isinstance(load, PointLoad)
        for f in (load.force_x, load.force_y, load.force_z)
        if f is not None
    ]
    return mass * float(np.linalg.norm(scene.gravity or 0.0)) + sum(pushes)


def build(scene: Scene, settings: Settings) -> System:
    """The scene's chain, each link's strains of `nodes` - 1 polynomials."""
    arm, n = scene.arm, polynomials(settings)
    for k, link in enumerate(arm.links):
        if not link.rigid and len(link.jumps):
            what = "must not jump along a link under the elastica in space; take geometrically_exact or floating_frame"
            raise check.InvalidValue(f"links[{k}].section", f"{len(link.jumps)} jumps", what)
    _, shares = arm.damping
    strains = [_link(link, n, 1.0 if shares is None else shares[k]) for k, link in enumerate(arm.links)]
    for link, packed in zip(arm.links, strains, strict=True):
        if not link.rigid:
            fields = STRAINED.unpack(packed, polynomials=n, points=n + 2)
            fields["correction"][:] = _correction(fields, settings)
    mass, room = STRAINED.offsets(0, n, n + 2), F.end + NOTED.offsets(0, n, n + 2).end
    return chains.system(
        scene, settings, SpatialElastica, float(sum(packed[mass.mass : mass.inertia].sum() for packed in strains)),
        [*[room] * arm.n_links, 0], Notes(scene), predictor=(1.0, 0.0), strains=np.concatenate(strains),
        polynomials=(0,) * n, points=(0,) * (n + 2), scratch=(0,) * (3 * n + 6),
        curved=(0,) if any(link.curved for link in arm.links if not link.rigid) else None,
    )  # fmt: skip
