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

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from flexarm_env.parameters import Arm, Link

Array = NDArray[np.float64]


def nodes(n: int, tip: bool) -> Array:
    """n nodes on [-1, 1], the first at -1: Lobatto's with the last at +1 (``tip``), otherwise Radau's."""
    basis = np.zeros(n + 1)
    if tip:
        basis[n - 1] = 1.0
        inner = legendre.legroots(legendre.legder(basis[:n]))
        return np.concatenate([[-1.0], np.sort(inner.real), [1.0]])
    basis[n - 1 :] = 1.0
    roots: Array = np.sort(legendre.legroots(basis).real)
    roots[0] = -1.0
    return roots


@dataclass(frozen=True)
class Line:
    """One link of n nodes: its interpolation and its own matrices, SI. `at` are nodes on [-1, 1]."""

    length: float
    at: Array  # (n,)
    coefficients: Array  # (n, n): column l holds the Legendre coefficients of l_l

    @classmethod
    def of(cls, length: float, n: int, tip: bool) -> Line:
        """The interpolation of a link; ``tip``: a node at its tip."""
        at = nodes(n, tip)
        return cls(length, at, np.asarray(np.linalg.inv(legendre.legvander(at, n - 1))))

    def _position(self, s: Array) -> Array:
        return 2.0 * np.asarray(s) / self.length - 1.0

    def lagrange(self, s: Array) -> Array:
        """l_l(s), shape (len(s), n), s in m from the root."""
        return legendre.legvander(self._position(s), self.at.size - 1) @ self.coefficients

    def slope(self, s: Array) -> Array:
        """l_l'(s), 1/m, shape (len(s), n)."""
        rate = legendre.legder(self.coefficients, axis=0)
        values = legendre.legvander(self._position(s), max(self.at.size - 2, 0)) @ rate
        return values * (2.0 / self.length)

    def integral(self, s: Array) -> Array:
        """S_l(s) = int_0^s l_l, m, shape (len(s), n)."""
        primitive = legendre.legint(self.coefficients, lbnd=-1.0, axis=0)
        return legendre.legvander(self._position(s), self.at.size) @ primitive * (0.5 * self.length)

    def quadrature(self) -> tuple[Array, Array]:
        """Gauss points and weights, m, exact for all matrices of the link."""
        x, weights = legendre.leggauss(self.at.size + 1)
        return 0.5 * self.length * (x + 1.0), 0.5 * self.length * weights

    def matrix(self, table: Array) -> Array:
        """int table table' ds for a table at the quadrature's points."""
        return (table.T * self.quadrature()[1]) @ table

    @property
    def tip_weights(self) -> Array:
        """w_l = S_l(L), m."""
        return np.asarray(self.integral(np.array([self.length]))[0])

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
        return self.lines[0].at.size

    def arm_to(self, link: int, s: float) -> Array:
        """Weights (Nn,) in m with which the unit tangents add up to the point at s on a link."""
        n, weights = self.n, np.zeros(self.w.size)
        for k in range(link):
            weights[k * n : (k + 1) * n] = self.lines[k].tip_weights
        weights[link * n : (link + 1) * n] = self.lines[link].integral(np.array([s]))[0]
        return weights

    def angle_at(self, link: int, s: float) -> Array:
        """Weights (Nn,) of the nodes' angles in the section angle at s on a link."""
        n, weights = self.n, np.zeros(self.w.size)
        weights[link * n : (link + 1) * n] = self.lines[link].lagrange(np.array([s]))[0]
        return weights


def chain(arm: Arm, n: int) -> Chain:
    """The matrices of an arm, mechanics of docs/theory.md, with n nodes a link."""
    count = arm.n_links
    lines = tuple(Line.of(link.length, n, k < count - 1) for k, link in enumerate(arm.links))
    total = count * n
    P, R, K = np.zeros((total, total)), np.zeros((count, n, n)), np.zeros((count, n, n))
    b, w = np.zeros(total), np.zeros(total)
    beyond = 0.0  # mass that hangs on the link's tip
    for k in reversed(range(count)):
        link, line, own = arm.links[k], lines[k], slice(k * n, (k + 1) * n)
        s, weights = line.quadrature()
        if k < count - 1:
            beyond += arm.elbow(k + 1).mass
        w[own] = line.tip_weights
        b[own] = link.section.m * (weights @ line.integral(s)) + beyond * w[own]
        P[own, own] = link.section.m * line.matrix(line.integral(s)) + beyond * np.outer(w[own], w[own])
        R[k] = _rotary(arm, k, line, link)
        K[k] = link.section.EI * line.matrix(line.slope(s))
        beyond += link.mass
    for k in range(count):
        own, later = slice(k * n, (k + 1) * n), slice((k + 1) * n, total)
        P[own, later] = np.outer(w[own], b[later])
        P[later, own] = P[own, later].T
    return Chain(lines, P, R, K, b, w, beyond)


def _rotary(arm: Arm, k: int, line: Line, link: Link) -> Array:
    """Rotary inertia at the nodes of link k: sections by the nodes' own quadrature, hub or elbows' halves at its ends.

    That is exact for Radau's nodes; of Lobatto's it is the usual lumping, which errs in the highest polynomial alone.
    """
    R = link.section.J * line.tip_weights
    R[0] += arm.hub_inertia if k == 0 else arm.elbow(k).inertia_right
    if k < arm.n_links - 1:
        R[-1] += arm.elbow(k + 1).inertia_left
    return np.diag(R)
