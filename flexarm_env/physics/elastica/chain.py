"""The elastica: a slender chain without stretch and shear, its geometry exact (docs: theory, section "Elastica").

The unknowns of a link are the tangent angles phi_l at n nodes; the unit tangent is interpolated, so that
r(s) = r_root + sum_l S_l(s) (cos phi_l, sin phi_l) with S_l the integral of the Lagrange polynomial l_l. The chain of
all links then has the equations of a pendulum of nodes,

    sum_j [P_ij cos(phi_i - phi_j) + R_ij] phi_j'' + P_ij sin(phi_i - phi_j) phi_j'^2 + K_ij (phi_j + tau_d phi_j')
        + b_i (a_root - g) . (-sin phi_i, cos phi_i) = generalised loads

with the constant matrices of :class:`Chain`. Nodes are Lobatto's where another link follows (one lies at the tip, where
the next link hangs) and Radau's on the last link (one at the root, none at the tip).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from flexarm_env import curves
from flexarm_env import validation as check
from flexarm_env.parameters import Arm, Link

from ..linalg import product, solve

Array = NDArray[np.float64]


def nodes(n: int, tip: bool) -> Array:
    """n nodes on [-1, 1], the first at -1: Lobatto's with the last at +1 (``tip``), otherwise Radau's."""
    basis = np.zeros(n + 1)
    if tip:
        basis[n - 1] = 1.0
        return np.concatenate([[-1.0], _roots(np.asarray(legendre.legder(basis[:n]))), [1.0]])
    basis[n - 1 :] = 1.0
    return np.concatenate([[-1.0], _roots(basis)[1:]])


def _roots(series: Array) -> Array:
    """Real roots, rising. Newton's steps begin where all processors' libraries agree."""
    roots = np.sort(legendre.legroots(series).real).round(7)
    for _ in range(3):
        roots -= legendre.legval(roots, series) / legendre.legval(roots, legendre.legder(series))
    return np.asarray(roots)


class Basis(NamedTuple):
    """Functions on [-1, 1], each 1 at a node and 0 at the others: Legendre coefficients, a column each, of themselves,
    of their slopes and of their integrals from -1."""

    own: Array
    rate: Array
    primitive: Array


@lru_cache(64)
def basis(n: int, tip: bool) -> Basis:
    """That of `nodes`; kept."""
    own = solve(legendre.legvander(nodes(n, tip), n - 1), np.eye(n))
    rate, primitive = legendre.legder(own, axis=0), legendre.legint(own, lbnd=-1.0, axis=0)
    return Basis(own, np.asarray(rate, np.float64), np.asarray(primitive, np.float64))


gauss = lru_cache(64)(legendre.leggauss)


@dataclass(frozen=True)
class Line:
    """One link of n nodes: its interpolation, continuous, and a polynomial between two jumps.

    SI. `pieces`: of each smooth piece its ends on the link, its first node, and the basis of its k functions;
    neighbouring pieces share a node.
    """

    link: Link
    n: int
    pieces: tuple[tuple[float, float, int, Basis], ...]

    @classmethod
    def of(cls, link: Link, n: int, tip: bool) -> Line:
        """The interpolation of a link; ``tip``: a node at its tip. Nodes go to the pieces as mesh cells would."""
        ends = np.array([0.0, *link.jumps, link.length])
        if n < len(ends):
            what = f"must be at least {len(ends)} for a link whose sections jump {len(ends) - 2} times"
            raise check.InvalidValue("nodes", n, what)
        own = link.mesh(n - 1, "nodes")
        pieces, first = [], 0
        for a, b in pairwise(ends.tolist()):
            steps = int(np.sum((own[:-1] >= a) & (own[:-1] < b)))
            last = b == link.length and not tip
            pieces.append((a, b, first, basis(steps + 1, not last)))
            first += steps
        return cls(link, n, tuple(pieces))

    @property
    def length(self) -> float:
        """m."""
        return self.link.length

    def _table(self, s: Array, of_piece: Callable[[Array, Basis, float], Array]) -> Array:
        """(len(s), n): what `of_piece` (points on [-1, 1], basis, length) gives of each piece's functions."""
        s = np.asarray(s, np.float64)
        table = np.zeros((s.size, self.n))
        for a, b, first, functions in self.pieces:
            here = (s >= a) & ((s < b) | (b == self.length))
            x = 2.0 * (s[here] - a) / (b - a) - 1.0
            table[here, first : first + len(functions.own)] = of_piece(x, functions, b - a)
        return table

    def lagrange(self, s: Array) -> Array:
        """l_l(s), shape (len(s), n), s in m from the root."""
        return self._table(s, lambda x, of, length: product(legendre.legvander(x, len(of.own) - 1), of.own))

    def slope(self, s: Array) -> Array:
        """l_l'(s), 1/m, shape (len(s), n)."""

        def of_piece(x: Array, of: Basis, length: float) -> Array:
            return product(legendre.legvander(x, max(len(of.own) - 2, 0)), of.rate) * (2.0 / length)

        return self._table(s, of_piece)

    def position(self, s: Array) -> Array:
        """Weights (len(s), n), m, of the unit tangents in the way from the joint at the link's root to s.

        On rigid ends s is below 0 or beyond the length.
        """
        s = np.asarray(s, np.float64)
        table = self.integral(np.clip(s, 0.0, self.length))
        if not self.link.rigid_ends:
            return table
        table[:, 0] += self.link.root_offset + np.minimum(s, 0.0)
        return np.asarray(table + np.outer(np.maximum(s - self.length, 0.0), self.tip_angle))

    def integral(self, s: Array) -> Array:
        """S_l(s) = int_0^s l_l, m, shape (len(s), n)."""

        def of_piece(x: Array, of: Basis, length: float) -> Array:
            return product(legendre.legvander(x, len(of.own)), of.primitive) * (0.5 * length)

        table = self._table(s, of_piece)
        for a, b, first, of in self.pieces[:-1]:  # what lies wholly before s
            table[np.asarray(s) >= b, first : first + len(of.own)] += of_piece(np.ones(1), of, b - a)[0]
        return table

    def quadrature(self) -> tuple[Array, Array]:
        """Gauss points and weights, m, exact for all matrices of the link."""
        if self.link.uniform is None:
            return self.link.quadrature()
        x, weights = gauss(self.n + 1)
        return 0.5 * self.length * (x + 1.0), 0.5 * self.length * weights

    def matrix(self, table: Array, what: str) -> Array:
        """int (section's `what`) table table' ds for a table at the quadrature's points."""
        s, weights = self.quadrature()
        if self.link.uniform is not None:
            return np.asarray(getattr(self.link.uniform, what) * product(table.T * weights, table))
        return product(table.T * (weights * getattr(self.link.along(s), what)), table)

    def total(self, table: Array, what: str) -> Array:
        """int (section's `what`) table ds."""
        s, weights = self.quadrature()
        if self.link.uniform is not None:
            return np.asarray(getattr(self.link.uniform, what) * product(weights, table))
        return product(weights * getattr(self.link.along(s), what), table)

    @property
    def rest(self) -> Array:
        """The nodes' angles without stress from that of the root, rad: those of least strain energy."""
        s, weights = self.quadrature()
        slope = self.slope(s)
        pull = product(weights * self.link.along(s).EI * curves.along(self.link.curvature, s), slope)
        angles = np.zeros(self.n)
        angles[1:] = solve(self.matrix(slope, "EI")[1:, 1:], pull[1:])
        return angles

    @property
    def tip_weights(self) -> Array:
        """Weights of the tangents in the way from one joint to the other, m; w_l = S_l(L) without rigid ends."""
        return np.asarray(self.position(np.array([self.length + self.link.tip_offset]))[0])

    @property
    def tip_angle(self) -> Array:
        """l_l(L)."""
        return np.asarray(self.lagrange(np.array([self.length]))[0])


@dataclass(frozen=True)
class Chain:
    """Constant matrices of a chain of N links with n nodes each, payload left out; SI, numbered from root to tip."""

    lines: tuple[Line, ...]
    P: Array  # (Nn, Nn) kg m^2: masses, 1/2 sum P_ij e_i'.e_j'
    R: Array  # (N, n, n) kg m^2: rotary inertia of sections, hub and elbows, lumped at the nodes
    K: Array  # (N, n, n) N m: bending stiffness
    b: Array  # (Nn,) kg m: first moments, the centre of mass is r_root + sum b_j e_j / mass
    w: Array  # (Nn,) m: the tip of the last link is r_root + sum w_j e_j
    mass: float  # kg

    @property
    def n(self) -> int:
        """Nodes of a link."""
        return self.lines[0].n

    @property
    def rest(self) -> Array | None:
        """Angles of the nodes without stress from that of their link's root (Nn,), rad; None: straight links."""
        if not any(line.link.curved for line in self.lines):
            return None
        return np.concatenate([line.rest for line in self.lines])

    def arms_to(self, link: int, s: Array) -> Array:
        """Weights (len(s), Nn) in m with which the unit tangents add up to the points at s on a link."""
        n, weights = self.n, np.zeros((len(s), self.w.size))
        weights[:, : link * n] = self.w[: link * n]
        weights[:, link * n : (link + 1) * n] = self.lines[link].position(s)
        return weights

    def angle_at(self, link: int, s: float) -> Array:
        """Weights (Nn,) of the nodes' angles in the section angle at s on a link."""
        n, weights = self.n, np.zeros(self.w.size)
        line = self.lines[link]
        weights[link * n : (link + 1) * n] = line.lagrange(np.clip(np.array([s]), 0.0, line.length))[0]
        return weights


@lru_cache(64)
def chain(arm: Arm, n: int) -> Chain:
    """The matrices of an arm, mechanics of docs/theory.md, with n nodes a link; kept, since arms are used again and
    again, and hence read-only."""
    count = arm.n_links
    lines = tuple(Line.of(link, n, k < count - 1) for k, link in enumerate(arm.links))
    total = count * n
    P, R, K = np.zeros((total, total)), np.zeros((count, n, n)), np.zeros((count, n, n))
    b, w = np.zeros(total), np.zeros(total)
    beyond = 0.0  # mass that hangs on the link's tip
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
        if link.rigid_ends:
            for mass, along, _ in link.ends:
                at = line.position(np.array([along - link.root_offset]))[0]
                b[own] += mass * at
                P[own, own] += mass * np.outer(at, at)
                beyond += mass
    for k in range(count):
        own, later = slice(k * n, (k + 1) * n), slice((k + 1) * n, total)
        P[own, later] = np.outer(w[own], b[later])
        P[later, own] = P[own, later].T
    for matrix in (P, R, K, b, w):
        matrix.flags.writeable = False
    return Chain(lines, P, R, K, b, w, beyond)


def _rotary(arm: Arm, k: int, line: Line) -> Array:
    """Rotary inertia at the nodes of link k: sections by the nodes' own quadrature, hub or elbows' halves at its ends.

    That is exact for Radau's nodes; of Lobatto's it is the usual lumping, which errs in the highest polynomial alone.
    """
    if line.link.uniform is not None:
        R = line.link.uniform.J * line.integral(np.array([line.length]))[0]
    else:
        R = line.total(line.lagrange(line.quadrature()[0]), "J")
    R[0] += arm.hub_inertia if k == 0 else arm.elbow(k).inertia_right
    if k < arm.n_links - 1:
        R[-1] += arm.elbow(k + 1).inertia_left
    R[0] += line.link.root_inertia
    return np.asarray(np.diag(R) + line.link.tip_inertia * np.outer(line.tip_angle, line.tip_angle))
