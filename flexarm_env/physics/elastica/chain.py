"""The elastica: constant matrices of a slender chain without stretch and shear, with exact geometry; theory (5.2).

The unknowns of a link are the tangent angles phi_l at n nodes. The unit tangent is interpolated, so that r(s) = r_root
+ sum_l S_l(s) (cos phi_l, sin phi_l), where S_l is the integral of the Lagrange polynomial l_l. The chain of all links
then has the equations of a pendulum of nodes,

    sum_j [P_ij cos(phi_i - phi_j) + R_ij] phi_j'' + P_ij sin(phi_i - phi_j) phi_j'^2 + K_ij (phi_j + tau_d phi_j')
        + b_i (a_root - g) . (-sin phi_i, cos phi_i) = generalized loads

The constant matrices are those of :class:`Chain`. Links that carry another link have Lobatto nodes, with a node at the
tip, to which the next link is attached. The last link has Radau nodes, with a node at the root and none at the tip. s
is the arc length from the link's root, m; e_j = (cos phi_j, sin phi_j) is the unit tangent at node j.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from flexarm_env import curves, meshing
from flexarm_env import validation as check
from flexarm_env.compiler import kernel, size
from flexarm_env.layout import Field, Layout
from flexarm_env.parameters import Arm, Link

from ..linalg import product, solve
from .layout import POINT

Array = NDArray[np.float64]

MOST_IN_PIECE = 12
"""Largest number of nodes on a smooth piece of a link. Runs with 24 nodes on one piece gained energy and diverged."""


def nodes(n: int, tip: bool) -> Array:
    """Return n nodes on [-1, 1], one at -1: Lobatto nodes (with one at +1) if ``tip`` is True, else Radau nodes."""
    # Lobatto: roots of P'_{n-1} between the ends; Radau: roots of P_{n-1} + P_n
    basis = np.zeros(n + 1)
    if tip:
        basis[n - 1] = 1.0
        return np.concatenate([[-1.0], _roots(np.asarray(legendre.legder(basis[:n]))), [1.0]])
    basis[n - 1 :] = 1.0
    return np.concatenate([[-1.0], _roots(basis)[1:]])


def _roots(series: Array) -> Array:
    """Return the real roots of a Legendre series in increasing order, with the same bits on all processors."""
    # three Newton steps from roots rounded to 1e-7, so that every LAPACK yields the same bits
    roots = np.sort(legendre.legroots(series).real).round(7)
    for _ in range(3):
        roots -= legendre.legval(roots, series) / legendre.legval(roots, legendre.legder(series))
    return np.asarray(roots)


class Basis(NamedTuple):
    """Legendre coefficients of the Lagrange polynomials of n nodes on [-1, 1], a column for each polynomial."""

    own: Array  # (n, n), coefficients of the polynomials, which are 1 at their node and 0 at the others
    rate: Array  # (n - 1, n), coefficients of the polynomials' derivatives
    primitive: Array  # (n + 1, n), coefficients of the polynomials' integrals from -1


@lru_cache(64)
def basis(n: int, tip: bool) -> Basis:
    """Compute the `Basis` for the nodes `nodes(n, tip)`; the result is cached."""
    own = solve(legendre.legvander(nodes(n, tip), n - 1), np.eye(n))
    rate, primitive = legendre.legder(own, axis=0), legendre.legint(own, lbnd=-1.0, axis=0)
    return Basis(own, np.asarray(rate, np.float64), np.asarray(primitive, np.float64))


gauss = lru_cache(64)(legendre.leggauss)


@dataclass(frozen=True)
class Line:
    """Interpolation of a link's angle by n nodes: a continuous function, a polynomial between jumps or kinks. SI units.

    For each smooth piece `pieces` contains its two ends s on the link (m), the index of its first node and the basis of
    its functions. Neighboring pieces share a node.
    """

    link: Link
    n: int
    pieces: tuple[tuple[float, float, int, Basis], ...]

    @classmethod
    def of(cls, link: Link, n: int, tip: bool) -> Line:
        """Distribute n nodes over a link's cells (`meshing`), with a node at the link's tip if ``tip`` is True.

        Raises:
            ValueError: n is too few for the link's jumps, or gives a smooth piece more than `MOST_IN_PIECE` nodes.
        """
        pieces, first, found = [], 0, meshing.pieces(link, n - 1, "nodes")
        if (most := 1 + (MOST_IN_PIECE - 1) * len(found)) < n:
            raise check.InvalidValue("nodes", n, f"must be at most {most} for a link of {len(found)} smooth piece(s)")
        # Radau's nodes on the last piece of the last link, where M = 0; Lobatto's elsewhere: neighbors share the node
        # between them
        for piece, steps in zip(found, meshing.counts(found, n - 1, MOST_IN_PIECE - 1), strict=True):
            last = piece.last == link.length and not tip
            pieces.append((piece.first, piece.last, first, basis(steps + 1, not last)))
            first += steps
        return cls(link, n, tuple(pieces))

    @property
    def length(self) -> float:
        """Length of the flexible link without rigid ends, m."""
        return self.link.length

    def _table(self, s: Array, of_piece: Callable[[Array, Basis, float], Array]) -> Array:
        """Return a table (len(s), n): for each position s (m) and each node, the value of the node's function at s.

        of_piece(x, basis, length) returns the values (len(x), k) of a piece's k functions at points x on [-1, 1].
        Functions of other pieces are 0.
        """
        s = np.asarray(s, np.float64)
        table = np.zeros((s.size, self.n))
        for a, b, first, functions in self.pieces:
            # xi in [-1, 1] of points on this piece; a point on a jump belongs to the piece behind it, whose EI counts
            # there
            here = (s >= a) & ((s < b) | (b == self.length))
            x = 2.0 * (s[here] - a) / (b - a) - 1.0
            table[here, first : first + len(functions.own)] = of_piece(x, functions, b - a)
        return table

    def lagrange(self, s: Array) -> Array:
        """Return Lagrange polynomials l_l(s), (len(s), n): weights of the node angles in the angle phi at s (m)."""
        return self._table(s, lambda x, of, length: product(legendre.legvander(x, len(of.own) - 1), of.own))

    def slope(self, s: Array) -> Array:
        """Return l_l'(s), 1/m, (len(s), n): weights of the node angles in the curvature at position s (m)."""

        def of_piece(x: Array, of: Basis, length: float) -> Array:
            return product(legendre.legvander(x, max(len(of.own) - 2, 0)), of.rate) * (2.0 / length)

        return self._table(s, of_piece)

    def position(self, s: Array) -> Array:
        """Return weights (len(s), n), m: r(s) - r_root = sum_l weight_l e_l, with the unit tangents e_l and root joint.

        On rigid ends s is below 0 or above the length, m.
        """
        s = np.asarray(s, np.float64)
        table = self.integral(np.clip(s, 0.0, self.length))
        if not self.link.rigid_ends:
            return table
        # rigid ends are levers along the beam's tangent: at the root along phi_0, at the tip along phi(L)
        table[:, 0] += self.link.root_offset + np.minimum(s, 0.0)
        return np.asarray(table + np.outer(np.maximum(s - self.length, 0.0), self.tip_angle))

    def integral(self, s: Array) -> Array:
        """Return S_l(s) = int_0^s l_l ds, m, (len(s), n): weights of the unit tangents in r(s) - r(0)."""

        def of_piece(x: Array, of: Basis, length: float) -> Array:
            return product(legendre.legvander(x, len(of.own)), of.primitive) * (0.5 * length)

        table = self._table(s, of_piece)
        # int_0^s l_l ds' of a piece that lies before s is its full integral: places continue from its end
        for a, b, first, of in self.pieces[:-1]:
            table[np.asarray(s) >= b, first : first + len(of.own)] += of_piece(np.ones(1), of, b - a)[0]
        return table

    def quadrature(self) -> tuple[Array, Array]:
        """Return Gauss points s and weights, both m, that integrate all matrices of the link exactly."""
        if self.link.uniform is None:
            return self.link.quadrature()
        x, weights = gauss(self.n + 1)
        return 0.5 * self.length * (x + 1.0), 0.5 * self.length * weights

    def matrix(self, table: Array, what: str) -> Array:
        """Return the matrix int X table^T table ds (n, n); X: section property named by `what` ("m", "J", "EI" ...).

        table: (points, n), values of functions at the points of `quadrature`.
        """
        s, weights = self.quadrature()
        if self.link.uniform is not None:
            return np.asarray(getattr(self.link.uniform, what) * product(table.T * weights, table))
        return product(table.T * (weights * getattr(self.link.along(s), what)), table)

    def total(self, table: Array, what: str) -> Array:
        """Return int X table ds (n,), where X is the section property named by `what`; table: as in `matrix`."""
        s, weights = self.quadrature()
        if self.link.uniform is not None:
            return np.asarray(getattr(self.link.uniform, what) * product(weights, table))
        return product(weights * getattr(self.link.along(s), what), table)

    @property
    def rest(self) -> Array:
        """Angles of the nodes (n,), rad, relative to the root, at which the link's strain energy is least."""
        # K phi = int EI kappa_0 l' ds with phi = 0 at the first node
        s, weights = self.quadrature()
        slope = self.slope(s)
        pull = product(weights * self.link.along(s).EI * curves.along(self.link.curvature, s), slope)
        angles = np.zeros(self.n)
        angles[1:] = solve(self.matrix(slope, "EI")[1:, 1:], pull[1:])
        return angles

    @property
    def tip_weights(self) -> Array:
        """Weights (n,), m, of the unit tangents in the vector from root to tip joint; S_l(L) without rigid ends."""
        return np.asarray(self.position(np.array([self.length + self.link.tip_offset]))[0])

    @property
    def tip_angle(self) -> Array:
        """Weights l_l(L), (n,), of the node angles in the section angle at the link's tip."""
        return np.asarray(self.lagrange(np.array([self.length]))[0])


DATA = Layout(
    "Data", "links, nodes, points",
    Field("P", ("links * nodes", "links * nodes"), "kg m^2",
          "masses without the payload: kinetic energy 1/2 sum P_ij e_i' . e_j'"),
    Field("R", ("links", "nodes", "nodes"), "kg m^2",
          "rotary inertia of sections, hub and elbows, minus the correction C"),
    Field("K_EI", ("links", "nodes", "nodes"), "N m", "K: bending stiffness int EI l_i' l_j' ds"),
    Field("b", ("links * nodes",), "kg m", "first moments: sum b_j e_j = mass (center of mass - root)"),
    Field("w", ("links * nodes",), "m", "sum w_j e_j = tip of the last link - root; per link, its tip - its root"),
    Field("tips", ("links * nodes",), "", "weights l_j(L) of a link's node angles in the angle at its tip"),
    Field("beta", ("links * nodes",), "m", "weights of the root: root = (x, y of the last rows) - sum beta_j e_j"),
    Field("mass", (), "kg", "mass of the chain without its payload"),
    Field("root", (POINT.length,), "m", "position of a root that cannot move, inertial axes"),
    Field("gravity", (POINT.length,), "m/s^2", "gravity, inertial axes"),
    Field("C", ("links", "nodes", "nodes"), "kg m^2",
          "M - M* of theory (5.3), the correction of the integrator's period error"),
    Field("points", ("points", "links * nodes"), "m", "weights of each drawn point: point - root = sum weight_j e_j"),
)  # fmt: skip
"""`DATA`: numbers of a `Chain` and of its scene, in `Elastica.data`. A link's matrices refer to its own nodes."""
_data_at = kernel(DATA.offsets)


@kernel
def constants(model: Any) -> Any:
    """Return the offset in model.data of each field of DATA. The last field, `points`, may have any length."""
    return _data_at(0, size(model.links), size(model.nodes), 0)


@dataclass(frozen=True)
class Chain:
    """Constant matrices of a chain of N links with n nodes each, from root to tip, without payload. SI units."""

    lines: tuple[Line, ...]
    P: Array  # (Nn, Nn) kg m^2: masses; the kinetic energy is 1/2 sum P_ij e_i'.e_j'
    R: Array  # (N, n, n) kg m^2: rotary inertia of sections, hub and elbows, lumped at the nodes
    K_EI: Array  # (N, n, n) N m: bending stiffness K
    b: Array  # (Nn,) kg m: first moments; the center of mass is r_root + sum b_j e_j / mass
    w: Array  # (Nn,) m: weights of the tip; the tip of the last link is r_root + sum w_j e_j
    mass: float  # kg: total mass of links, rigid ends and elbows

    @property
    def n(self) -> int:
        """Number of nodes of a link."""
        return self.lines[0].n

    @property
    def rest(self) -> Array | None:
        """Stress-free angles of all nodes (Nn,), rad, relative to their link's root; None if all links are straight."""
        if not any(line.link.curved for line in self.lines):
            return None
        return np.concatenate([line.rest for line in self.lines])

    def arms_to(self, link: int, s: Array) -> Array:
        """Return weights (len(s), Nn), m: a link's point at s (m) is r_root + sum_j weight_j e_j."""
        n, weights = self.n, np.zeros((len(s), self.w.size))
        weights[:, : link * n] = self.w[: link * n]
        weights[:, link * n : (link + 1) * n] = self.lines[link].position(s)
        return weights

    def angle_at(self, link: int, s: float) -> Array:
        """Return weights (Nn,) of the node angles in a link's section angle at s (m), which may lie on a rigid end."""
        n, weights = self.n, np.zeros(self.w.size)
        line = self.lines[link]
        weights[link * n : (link + 1) * n] = line.lagrange(np.clip(np.array([s]), 0.0, line.length))[0]
        return weights


@lru_cache(64)
def chain(arm: Arm, n: int) -> Chain:
    """Compute the matrices (theory, 5.2) of an arm whose links have n nodes each.

    The result is cached, because arms are used repeatedly. A cached result is read-only.
    """
    return chain_of(arm, [Line.of(link, n, k < arm.n_links - 1) for k, link in enumerate(arm.links)])


def chain_of(arm: Arm, lines: Sequence[Line]) -> Chain:
    """Compute the matrices of an arm whose links are interpolated by `lines`, all with equal numbers of nodes."""
    count, n = arm.n_links, lines[0].n
    total = count * n
    P, R, K = np.zeros((total, total)), np.zeros((count, n, n)), np.zeros((count, n, n))
    b, w = np.zeros(total), np.zeros(total)
    beyond = 0.0  # mass that hangs on the link's tip
    # from the tip inward: P_ij = int m S_i S_j of link k, with the mass of all links beyond as a point at its tip joint
    for k in reversed(range(count)):
        link, line, own = arm.links[k], lines[k], slice(k * n, (k + 1) * n)
        s = line.quadrature()[0]
        if k < count - 1:
            beyond += arm.elbow(k + 1).mass
        w[own] = line.tip_weights
        b[own] = line.total(line.position(s), "m") + beyond * w[own]
        P[own, own] = line.matrix(line.position(s), "m") + beyond * np.outer(w[own], w[own])
        R[k] = _rotary(arm, k, line)
        K[k] = line.matrix(line.slope(s), "EI")
        beyond += link.mass
        # rigid ends: their mass at the middle of the end, P_ij += m w_i w_j; the rotary part is in R
        if link.rigid_ends:
            for mass, along, _ in link.ends:
                at = line.position(np.array([along - link.root_offset]))[0]
                b[own] += mass * at
                P[own, own] += mass * np.outer(at, at)
                beyond += mass
    # coupling with later links, which hang on the tip joint of link k: P_ij = w_i b_j
    for k in range(count):
        own, later = slice(k * n, (k + 1) * n), slice((k + 1) * n, total)
        P[own, later] = np.outer(w[own], b[later])
        P[later, own] = P[own, later].T
    for matrix in (P, R, K, b, w):
        matrix.flags.writeable = False
    return Chain(tuple(lines), P, R, K, b, w, beyond)


def _rotary(arm: Arm, k: int, line: Line) -> Array:
    """Return the rotary inertia matrix R_k (n, n), kg m^2, of link k: sections, hub or elbow halves, rigid ends.

    The quadrature of the nodes lumps the sections' inertia. For Radau nodes the lumping is exact. For Lobatto nodes
    only the highest polynomial has an error, as usual.
    """
    if line.link.uniform is not None:
        R = line.link.uniform.J * line.integral(np.array([line.length]))[0]
    else:
        R = line.total(line.lagrange(line.quadrature()[0]), "J")
    # R: inertia (kg m^2) on the first node (hub or elbow), on the last one (next elbow), and on the ends' angles
    R[0] += arm.hub_inertia if k == 0 else arm.elbow(k).inertia_right
    if k < arm.n_links - 1:
        R[-1] += arm.elbow(k + 1).inertia_left
    R[0] += line.link.root_inertia
    return np.asarray(np.diag(R) + line.link.tip_inertia * np.outer(line.tip_angle, line.tip_angle))
