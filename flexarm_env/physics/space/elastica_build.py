"""A scene in space to its `SpatialElastica`: links by their strains, without stretch and shear."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ... import curves, rotations
from ... import validation as check
from ...parameters import Arm, Link
from ...scene import Scene
from ...settings import Settings
from ..elastica.build import HEAVIER
from ..elastica.slenderness import _largest
from ..model import System
from . import build as chains
from .chain import SpatialElastica
from .layout import AXES, PLACE, B, F, H
from .strained_layout import NOTED, STRAINED

Array = NDArray[np.float64]

LEAST_POLAR = 1e-8
"""Rotary inertia about its axis, over m l^2 of a link, that none falls below: torsion is a motion of its own."""

AXES_OF_STRAINS = ("twist", "bend_y", "bend_z")


def polynomials(settings: Settings) -> int:
    """Of each strain: the curvature of an angle that so many nodes have."""
    assert settings.nodes is not None
    return settings.nodes - 1


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
        shapes = dict(zip([f.name for f in STRAINED.fields], STRAINED.shapes(**sizes), strict=True))
        return STRAINED.pack(sizes, **{name: np.zeros(shape) for name, shape in shapes.items()})
    s = L * own.at
    plane, across = link.along(s), link.across(s)
    P = np.polynomial.legendre.legvander(2.0 * own.at - 1.0, n - 1)
    D = np.array([across["GJ"], across["EI_y"], plane.EI])
    stiffness = np.einsum("ap,pi,pj->aij", D * own.weights / L, P, P)
    J, J_y = plane.J, across["J_y"]
    inertia = np.stack([np.maximum(J + J_y, LEAST_POLAR * plane.m * L**2), J_y, J], axis=1)
    bow = np.vectorize(lambda at: float(curves.along(link.curvature, at)), otypes=[float])(L * own.inner)
    natural = _interval(L * np.diff(own.ends), bow)
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
    """(3, n, n) kg m^2, what to take from the inertia of the strains for steps of h (see `elastica.build`)."""
    assert settings.dt is not None
    lengthening, share = 2.0 * settings.period_error * settings.dt**2, HEAVIER * settings.dt**4
    M, K = _inertia(packed), packed["stiffness"]
    C = (lengthening * K - share * K @ np.linalg.solve(M, K)) @ np.linalg.solve(M + lengthening * K, M)
    return np.asarray(0.5 * (C + C.transpose(0, 2, 1)))


def physical(model: SpatialElastica) -> SpatialElastica:
    """The model with the inertia that the links have, for all that is not a step."""
    strains, n = model.strains.copy(), len(model.polynomials)
    STRAINED.unpack(strains.reshape(model.links, -1), polynomials=n, points=n + 2)["correction"][:] = 0.0
    return model._replace(strains=strains)


def names_of(arm: Arm, n: int) -> tuple[str, ...]:
    """Names of the rows: of the base, of each joint, of the strains of each link."""
    found = [f"root_{name}" for name in ("x", "y", "z", "rx", "ry", "rz")]
    for k, link in enumerate(arm.links):
        found.append(f"joint{k}")
        if not link.rigid:
            found += [f"link{k}.{name}{j + 1}" for j in range(n) for name in AXES_OF_STRAINS]
    return tuple(found)


def _start(scene: Scene, names: tuple[str, ...]) -> tuple[Array, Array]:
    """Coordinates of links without stress at the scene's angles, and their rates as it moves before t = 0."""
    arm, q, v = scene.arm, np.zeros(len(names)), np.zeros(len(names))
    q[:3], v[:3] = scene.position, scene.velocity
    before = 0.0
    for k in range(arm.n_links):
        row = names.index(f"joint{k}")
        q[row] = scene.initial_value(f"joint{k}")
        v[row] = scene.rates[k] if arm.spatial else scene.rates[k] - before
        before = scene.rates[k]
    if scene.root == "free":  # the base turns with link 0
        v[3:AXES] = scene.rates[0] * (chains.mount_of(arm, 0) @ chains.axis_of(arm, 0))
        v[names.index("joint0")] = 0.0
    return q, v


BENT = 0.3
"""By what share of its length a link is taken to be bent where nothing is known yet."""


class Notes(dict[str, float]):
    """ "stretch_and_shear", a fraction of the arm's length: what leaving them out costs where links bend by `BENT`, and
    where they are stretched as joints turn as prescribed, with all mass at the tip; a longer link is softer, too."""

    def __init__(self, scene: Scene) -> None:
        arm = scene.arm
        links = [link for link in arm.links if not link.rigid]
        rate = sum(_largest(m.function, scene.duration, 1) for m in scene.motions if m.joint is not None)
        mass = arm.payload.mass + sum(elbow.mass for elbow in arm.elbows) + sum(0.5 * link.mass for link in arm.links)
        stretch = rate**2 * arm.total_length * mass / min((link.series("EA") for link in links), default=math.inf)
        self.share = max(map(_softness, links), default=0.0) + 3.0 * stretch
        super().__init__(stretch_and_shear=min(1.0, BENT * self.share + stretch))

    @property
    def softer(self) -> float:
        """Factor on EI that makes links as soft as stretch and shear make the one that they soften most: what a run
        with it comes out apart is the estimate (`accuracy.followed`)."""
        return 1.0 / (1.0 + self.share)


def _softness(link: Link) -> float:
    """What shear, or stretch, gives way to a force at the tip of a clamped link, over what bending does, each in the
    direction in which it is softest: 3 EI / (C L^2)."""
    s = np.linspace(0.0, link.length, 33)
    plane, across = link.along(s), link.across(s)
    sheared = max(float((1.0 / x).max()) for x in (plane.C, across["C_y"], plane.EA))
    bent = max(float((1.0 / x).min()) for x in (plane.EI, across["EI_y"]))
    return 3.0 * sheared / (bent * link.length**2)


def build(scene: Scene, settings: Settings) -> System:
    """The scene's chain, each link's strains of `nodes` - 1 polynomials."""
    arm, n = scene.arm, polynomials(settings)
    for k, link in enumerate(arm.links):
        if not link.rigid and len(link.jumps):
            what = "must not jump along a link under the elastica in space; take geometrically_exact or floating_frame"
            raise check.InvalidValue(f"links[{k}].section", f"{len(link.jumps)} jumps", what)
    names = names_of(arm, n)
    _, shares = arm.damping
    strains = [_link(link, n, 1.0 if shares is None else shares[k]) for k, link in enumerate(arm.links)]
    for link, packed in zip(arm.links, strains, strict=True):
        if not link.rigid:
            fields = STRAINED.unpack(packed, polynomials=n, points=n + 2)
            fields["correction"][:] = _correction(fields, settings)
    first, places = B.end + H.end * arm.n_links, []
    room = F.end + NOTED.offsets(0, n, n + 2).end
    for k, link in enumerate(arm.links):
        places.append(PLACE.pack({}, row=names.index(f"joint{k}"), elements=0 if link.rigid else 1, factor=first))
        first += room
    places.append(PLACE.pack({}, row=len(names), elements=0, factor=first))
    weight = np.ones(len(names))
    weight[:3] = 1.0 / arm.total_length
    mass = STRAINED.offsets(0, n, n + 2)
    own = float(sum(packed[mass.mass : mass.inertia].sum() for packed in strains))
    common = chains.common(scene, names, own)
    model = SpatialElastica(
        n=len(names), n_factor=first, weight=weight, predictor=(1.0, 0.0),
        places=np.concatenate(places).astype(np.int64), polynomials=(0,) * n, points=(0,) * (n + 2),
        scratch=(0,) * (3 * n + 6), strains=np.concatenate(strains),
        curved=(0,) if any(link.curved for link in arm.links if not link.rigid) else None, **common,
    )  # fmt: skip
    coordinates = {name: i for i, name in enumerate(names) if name.startswith(("root_", "joint"))}
    return System(model, chains.parameters(scene), *_start(scene, names), coordinates, names, (), (), Notes(scene))


# ------------------------------------------------------------------ what is read off
class Sections(NamedTuple):
    """Of m instants, in the axes of the link's root: places (m, points + 1, 3), axes (m, points + 1, 3, 3), velocities
    and angular velocities against the root, of the points and of the last section."""

    r: Array
    A: Array
    v: Array
    w: Array


def sections(link: Link, n: int, c: Array, rate: Array) -> Sections:
    """From the coefficients of the strains (m, 3 n) and their rates."""
    own, packed = grid(n), STRAINED.unpack(_link(link, n, 1.0), polynomials=n, points=n + 2)
    natural = np.zeros((n + 3, 2, 3))
    natural[..., 2] = packed["natural"]
    tables, c, rate = (own.sums, own.slants), c.reshape(-1, n, 3), rate.reshape(-1, n, 3)
    s, d = (np.einsum("ij,mja->mia", table, c) + natural[:, k] for k, table in enumerate(tables))
    sv, dv = (np.einsum("ij,mja->mia", table, rate) for table in tables)
    psi, turn = s + np.cross(s, d), sv + np.cross(sv, d) + np.cross(s, dv)
    steps = rotations.matrices(psi)
    rel = _rates(psi, turn)
    A, w = [np.broadcast_to(np.eye(3), (len(c), 3, 3))], [np.zeros((len(c), 3))]
    for i in range(n + 3):
        A.append(A[-1] @ steps[:, i])
        w.append(w[-1] + rotations.turned(A[-1], rel[:, i]))
    axes, spin = np.stack(A[1:], axis=1), np.stack(w[1:], axis=1)
    t, ways = axes[:, :-1, :, 0], link.length * own.ways
    r, v = (np.einsum("ij,mja->mia", ways, x) for x in (t, np.cross(spin[:, :-1], t)))
    return Sections(r, axes, v, spin)


def _rates(psi: Array, turn: Array) -> Array:
    """Angular velocities, in the axes turned to, of rotation vectors that change at these rates."""
    square = (psi * psi).sum(-1, keepdims=True)
    near = square < 1e-6
    a = np.sqrt(np.where(near, 1.0, square))
    one = np.where(near, 0.5 - square / 24.0, (1.0 - np.cos(a)) / (a * a))
    two = np.where(near, 1.0 / 6.0 - square / 120.0, (a - np.sin(a)) / a**3)
    across = np.cross(psi, turn)
    return np.asarray(turn - one * across + two * np.cross(psi, across))
