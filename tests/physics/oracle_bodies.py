"""Bodies of `oracle_chain.py`: points of an axis with rows of u, v, phi, v' and phi' over the elastic coordinates p."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from flexarm_env.parameters import Section

Array = NDArray[Any]
POINTS, WEIGHTS = np.polynomial.legendre.leggauss(6)
QUADRATURE = tuple(zip(POINTS, WEIGHTS, strict=True))
MESH = 32  # elements from which modes are taken


@cache
def element_fields(EI: float, C: float, length: float, xi: float) -> tuple[Array, Array, Array, Array, Array]:
    """Rows over (u1, v1, phi1, u2, v2, phi2): u, v, phi, v', phi' at x = xi length.

    v is a cubic and phi = v' + (EI/C) v''' (moment balance EI phi'' = C (phi - v')), fitted to the end values.
    """

    def cubic(x: float) -> tuple[Array, Array, Array, Array]:
        v = np.array([1.0, x, x**2, x**3])
        slope = np.array([0.0, 1.0, 2 * x, 3 * x**2])
        third = np.array([0.0, 0.0, 0.0, 6.0])
        phi = slope + EI / C * third
        return v, phi, slope, np.array([0.0, 0.0, 2.0, 6 * x])

    ends = np.array([cubic(0.0)[0], cubic(0.0)[1], cubic(length)[0], cubic(length)[1]])
    coefficients = np.linalg.inv(ends)
    u = np.array([1.0 - xi, 0.0, 0.0, xi, 0.0, 0.0])
    rows = [u]
    for row in cubic(xi * length):
        full = np.zeros(6)
        full[[1, 2, 4, 5]] = row @ coefficients
        rows.append(full)
    return rows[0], rows[1], rows[2], rows[3], rows[4]


def form(x: Array, matrix: Array, y: Array) -> Array:
    """x'A y for each A of a stack (S, n, n): (..., S)."""
    return np.asarray((np.tensordot(y, matrix, (-1, 2)) * x[..., None, :]).sum(-1))


class Points(NamedTuple):
    """Points of a body's axis; rows over its n elastic coordinates, H its foreshortening (None: it has none)."""

    x: Array  # (S,)
    dx: Array  # (S,) weights
    u: Array  # (S, n)
    v: Array
    phi: Array
    slope: Array
    curvature: Array
    H: Array | None  # (S, n, n)

    def combined(self, basis: Array, H: Array | None = None) -> Points:
        """The same points over coordinates p with (old coordinates) = basis p."""
        rows = [row @ basis for row in (self.u, self.v, self.phi, self.slope, self.curvature)]
        return Points(self.x, self.dx, *rows, H)


def mesh_points(section: Section, length: float, elements: int, stations: Array, weights: Array) -> Points:
    """Points at `stations` in (0, 1) of each element, over u, v, phi of all nodes."""
    l = length / elements
    rows = np.zeros((5, elements * stations.size, 3 * elements + 3))
    for k, xi in enumerate(stations):
        own = np.array(element_fields(section.EI, section.C, l, xi))
        for e in range(elements):
            rows[:, e * stations.size + k, 3 * e : 3 * e + 6] = own
    x = ((np.arange(elements)[:, None] + stations) * l).reshape(-1)
    return Points(x, np.tile(weights * l, elements), *rows, None)


@dataclass
class Body:
    """A piece of a link: points for integrals, its tip, and the frame's angle theta_root - rho'p."""

    link: int
    length: float
    section: Section
    points: Points
    tip: Points  # one point
    rho: Array  # (n,)
    elements: list[slice]  # points of each finite element; () for modes

    nodes: Array  # (3 (mesh elements + 1), n): u, v, phi of all nodes of its mesh over p
    node_H: Array | None  # foreshortening at those nodes

    @property
    def n(self) -> int:
        return self.rho.size


def finite_elements(link: int, section: Section, length: float, elements: int, frame: str) -> Body:
    """Frame through the root section ("root": p = u, v, phi of nodes 1..E) or both ends ("chord": p = phi of node 0,
    then u, v, phi of the others but v of the last)."""
    last = 3 * elements
    kept = list(range(3, last + 3)) if frame == "root" else [2, *range(3, last + 1), last + 2]
    basis = np.eye(last + 3)[:, kept]
    inner = mesh_points(section, length, elements, 0.5 * (1.0 + POINTS), 0.5 * WEIGHTS).combined(basis)
    ends = mesh_points(section, length, elements, np.array([0.0, 1.0]), np.zeros(2)).combined(basis)
    size = POINTS.size
    slices = [slice(size * e, size * (e + 1)) for e in range(elements)]
    return Body(link, length, section, inner, _only(ends, -1), ends.phi[0].copy(), slices, basis, None)


def modal(
    link: int, section: Section, length: float, n: int, frame: str, carried: tuple[float, float], whole: bool
) -> Body:
    """Bending modes with foreshortening: clamped with `carried` (mass, inertia) at the tip, of unit generalised mass,
    the tip's deflection positive; the same shapes where the frame goes through both ends of a whole
    link; in a piece of one the static shapes of a unit turn of either end, then pinned-pinned modes."""
    inner = mesh_points(section, length, MESH, 0.5 * (1.0 + POINTS), 0.5 * WEIGHTS)
    mass = _gram(inner, section.m, inner.v) + _gram(inner, section.J, inner.phi)
    stiff = _gram(inner, section.EI, inner.curvature) + _gram(inner, section.C, inner.slope - inner.phi)
    nodes, last = np.arange(MESH + 1), 3 * MESH
    bending = np.sort(np.concatenate([3 * nodes + 1, 3 * nodes + 2]))
    mass[last + 1, last + 1] += carried[0]
    mass[last + 2, last + 2] += carried[1]
    free = bending[2:]
    lowest = lowest_modes(stiff[np.ix_(free, free)], mass[np.ix_(free, free)], n)
    basis = np.zeros((last + 3, n))
    basis[free] = lowest * np.sign(lowest[-2])
    if frame == "chord" and not whole and n > 1:
        mass[last + 1, last + 1] -= carried[0]
        mass[last + 2, last + 2] -= carried[1]
        basis = np.zeros((last + 3, n))
        free = np.array([k for k in bending if k not in (1, last + 1)])
        inside = np.array([k for k in free if k not in (2, last + 2)])
        for k, end in enumerate((2, last + 2)):  # the other end held
            basis[end, k] = 1.0
            basis[inside, k] = -np.linalg.solve(stiff[np.ix_(inside, inside)], stiff[inside, end])
        if n > 2:
            lowest = lowest_modes(stiff[np.ix_(free, free)], mass[np.ix_(free, free)], n - 2)
            basis[free, 2:] = lowest * np.sign(lowest[0])
    elif frame == "chord":  # turned so that the tip stays on the axis
        turn = basis[last + 1] / length
        basis[1::3] -= np.outer(nodes * length / MESH, turn)
        basis[2::3] -= turn
    # H: integral of v'^2 - (v' - phi)^2 up to each point and to each node, by quadrature within its element
    l, upto = length / MESH, np.append(0.5 * (1.0 + POINTS), 1.0)
    fields = [[element_fields(section.EI, section.C, l, 0.5 * xi * (1.0 + x))[2:4] for x in POINTS] for xi in upto]
    own = np.array([basis[3 * e : 3 * e + 6] for e in range(MESH)])
    phi, slope = np.einsum("kpri,ein->rekpn", np.array(fields), own)
    turns = np.stack([slope, slope - phi])
    weights = np.multiply.outer([1.0, -1.0], np.outer(0.5 * l * upto, WEIGHTS))
    within = np.einsum("skp,sekpm,sekpn->ekmn", weights, turns, turns)
    at_nodes = np.concatenate([np.zeros((1, n, n)), np.cumsum(within[:, -1], axis=0)])
    H = (at_nodes[:-1, None] + within[:, :-1]).reshape(-1, n, n)
    ends = _only(mesh_points(section, length, MESH, np.array([0.0, 1.0]), np.zeros(2)), -1)
    rho = np.zeros(n) if frame == "root" else basis[2].copy()
    shapes = inner.combined(basis, H), ends.combined(basis, at_nodes[-1:])
    return Body(link, length, section, *shapes, rho, [], basis, at_nodes)


def lowest_modes(stiff: Array, mass: Array, n: int) -> Array:
    """Eigenvectors of unit generalised mass, by M x = K x / w^2: turns of sections may have hardly any inertia."""
    vectors = eigh(mass, stiff, subset_by_index=[len(mass) - n, len(mass) - 1])[1][:, ::-1]
    return vectors / np.sqrt(np.sum(vectors * (mass @ vectors), axis=0))


def _only(points: Points, k: int) -> Points:
    """Point k alone."""
    index = [range(points.x.size)[k]]
    return Points(*(None if item is None else item[index] for item in points))


def averaged(points: Points, share: Array) -> Points:
    """One point that is where the average of points is: positions are linear in the rows and in H."""
    return Points(*(None if item is None else np.tensordot(share, item, (0, 0))[None] for item in points))


def _gram(points: Points, density: float, rows: Array) -> Array:
    return rows.T @ (density * points.dx[:, None] * rows)
