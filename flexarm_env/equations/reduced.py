"""Points of an arm's motion, and linear equations about a point in independent coordinates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..physics.integrator.work import Work
from ..validation import Array

Rows = NDArray[np.int64]


@dataclass(frozen=True)
class Point:
    """State of an arm at an instant: coordinates (with multipliers), rates, accelerations (n,), inputs, motions."""

    q: Array
    v: Array
    a: Array
    u: Array
    psi: Array


@dataclass(frozen=True)
class Frame:
    """Matrices V, U, W (n, n) that relate increments d of coordinates to changes of rates and accelerations.

    The changes are dv = d' + V d and da = d'' + U d' + W d. V and W are zero except for rotations, and for equations in
    a rotating frame.
    """

    V: Array
    U: Array
    W: Array

    def among(self, rows: Rows) -> Frame:
        """Return the `Frame` of some coordinates: the entries of V, U, W in the given rows and columns."""
        pick = np.ix_(rows, rows)
        return Frame(self.V[pick], self.U[pick], self.W[pick])

    def in_coordinates(self, change: Array, back: Array) -> Frame:
        """Return the `Frame` for the coordinates change @ d; back: inverse of the matrix `change`."""
        return Frame(change @ self.V @ back, change @ self.U @ back, change @ self.W @ back)


@dataclass(frozen=True)
class Reduced:
    """Matrices of M e' + C e + K d = B u about a point.

    d (n,): changes of the independent coordinates. e (n,): changes of the rates of the independent coordinates.

    The changes of the rows that can move are dq = lift d, dv = lift e + drift d, da = lift e' + bend_v dv + bend_q dq.
    frame: the `Frame` of the independent coordinates; it relates e and e' to d and its time derivatives.
    """

    M: Array
    C: Array
    K: Array
    B: Array
    lift: Array
    drift: Array
    bend_v: Array
    bend_q: Array
    frame: Frame

    def among(self, keep: Sequence[int]) -> tuple[Array, Array, Array]:
        """Return M, C, K of M d'' + C d' + K d = B u for the coordinates `keep`; the other coordinates are fixed."""
        pick, frame = np.ix_(keep, keep), self.frame
        C, K = self.C + self.M @ frame.U, self.K + self.C @ frame.V + self.M @ frame.W
        return self.M[pick], C[pick], K[pick]

    def accelerations(self, driven: Rows) -> tuple[Array, Array]:
        """Return derivatives of e' by (d, e, u), (n, 2 n + inputs), and by prescribed accelerations, (n, driven)."""
        rest = np.setdiff1d(np.arange(len(self.M)), driven)
        right = np.hstack([-self.K, -self.C, self.B, -self.M[:, driven]])[rest]
        found = np.zeros((len(self.M), right.shape[1]))
        found[rest] = np.linalg.solve(self.M[np.ix_(rest, rest)], right)
        found[driven, right.shape[1] - len(driven) + np.arange(len(driven))] = 1.0
        return found[:, : right.shape[1] - len(driven)], found[:, right.shape[1] - len(driven) :]


def check_mass(M: Array) -> None:
    """Raise ValueError if a coordinate has no inertia."""
    size = np.sqrt(np.maximum(M.diagonal(), 0.0))
    if not (size > 0.0).all() or np.linalg.eigvalsh(M / np.outer(size, size)).min() < 1e-14:
        raise ValueError(
            "the mass matrix is singular, so there is no state space: some coordinate has no inertia "
            "(a link reduced to modes needs a hub inertia)"
        )


def point_of(w: Work) -> Point:
    """Return a copy of the point (coordinates, rates, accelerations, inputs) in a work array."""
    return Point(w.q.copy(), w.v.copy(), w.a.copy(), w.u.copy(), w.psi.copy())


ROUND_OFF = 1e-14
"""Relative error of the stiffness K. Squared frequencies below ROUND_OFF |x|'|K||x| are those of rigid motions."""


def undamped(M: Array, K: Array) -> tuple[Array, Array]:
    """Return squared frequencies (exactly 0 for rigid motions) and M-normalized shapes of M x'' + K x = 0.

    Frequencies of stretching can be 1e8 times those of bending, so that their round-off errors exceed the low
    frequencies. The low frequencies are therefore computed from the largest eigenvalues of the inverse problem.
    """
    from scipy.linalg import eigh

    squares, basis = eigh(K, M)
    largest = float(np.abs(squares).max())
    if largest == 0.0:
        # no stiffness at all: every motion is a rigid one
        return squares, basis
    shift = max(1e-12 * largest, -2.0 * float(squares.min()))
    inverse, shapes = eigh(M, K + shift * M)
    low = int((squares < 1e-8 * largest).sum())
    inverse, shapes = inverse[::-1][:low], shapes[:, ::-1][:, :low]
    fine = 1.0 / inverse - shift
    shapes = shapes / np.sqrt(inverse)
    noise = ROUND_OFF * (np.abs(shapes) * (np.abs(K) @ np.abs(shapes))).sum(axis=0) + 1e-6 * shift
    fine[np.abs(fine) < noise] = 0.0
    return np.concatenate([fine, squares[low:]]), np.hstack([shapes, basis[:, low:]])
