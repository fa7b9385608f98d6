"""Stability of an arm at an equilibrium or in motion, from the eigenvalues of its linearized equations.

At rest, the forces of loads, gravity and held joints have a potential. Let K and M be the stiffness and mass matrices
of the coordinates that can move. An equilibrium is stable if K x = mu M x has no negative eigenvalue mu (theorem of
Lagrange and Dirichlet). A mode with mu < 0 grows as exp(sqrt(-mu) t).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..equations import Equations, Point, undamped
from ..validation import Array

Complex = NDArray[np.complex128]

GROWS = 1e-6
"""An eigenvalue counts as growing if its real part exceeds GROWS times its magnitude (round-off is 1e-9)."""


@dataclass(frozen=True)
class Stability:
    """Stability of an arm at rest, with given joints held and all other joints free.

    Attributes:
        smallest: smallest squared frequency mu, rad^2/s^2, of K x = mu M x with the held joints fixed; infinite if no
            coordinate can move.
        negative: number of negative mu. neutral: number of mu that are 0 up to round-off; freely turning joints, for
            example, have mu = 0.
    """

    smallest: float
    negative: int
    neutral: int

    @property
    def stable(self) -> bool:
        """True if no small motion grows exponentially; motions with mu = 0 (`neutral`) may still drift."""
        return self.negative == 0

    @property
    def growth(self) -> float:
        """Largest exponential growth rate of a small undamped motion, 1/s; 0.0 if the arm is stable."""
        return float(np.sqrt(max(0.0, -self.smallest)))


def at_rest(equations: Equations, point: Point, held: Sequence[int] = ()) -> Stability:
    """Return the stability of an arm at rest with the joints `held` fixed.

    Raises ValueError if a coordinate has no inertia.
    """
    M, _, K = equations.reduced(point).among(moving(equations, held))
    return stability(M, K)


def stability(M: Array, K: Array) -> Stability:
    """Return the `Stability`, computed from the symmetric parts of the inertia M and the stiffness K."""
    if not M.size:
        return Stability(np.inf, 0, 0)
    squares, _ = undamped(0.5 * (M + M.T), 0.5 * (K + K.T))
    return Stability(float(squares.min()), int((squares < 0.0).sum()), int((squares == 0.0).sum()))


def moving(equations: Equations, held: Sequence[int]) -> list[int]:
    """Return the indices of the independent coordinates without the joints `held`."""
    still = [equations.turned[k] for k in held if k in equations.turned]
    return [i for i in range(equations.independent.size) if i not in still]


def growing(eigenvalues: Complex) -> int:
    """Return the number of eigenvalues with growing motions; a conjugate pair counts as one."""
    return int((eigenvalues.real > GROWS * np.abs(eigenvalues)).sum())


def eigenpairs(M: Array, C: Array, K: Array) -> tuple[Complex, Complex]:
    """Return eigenvalues and eigenvectors of M x'' + C x' + K x = 0.

    Of each conjugate pair only the eigenvalue with positive imaginary part is returned. A rigid motion has a pair of
    zero eigenvalues, of which only one is returned. The eigenvalues are computed in the basis of the undamped modes, in
    which M is the identity and the symmetric part of K is diagonal.
    """
    squares, basis = undamped(0.5 * (M + M.T), 0.5 * (K + K.T))
    symmetric = np.abs(K - K.T).max() < 1e-8 * np.abs(K).max()
    if symmetric and (squares >= 0.0).all() and np.abs(C).max() ** 2 < 1e-20 * np.abs(K).max() * np.abs(M).max():
        return 1j * np.sqrt(squares), basis.astype(complex)
    turning = 0.0 if symmetric else 0.5 * basis.T @ (K - K.T) @ basis
    values, vectors = _damped(squares, np.diag(squares) + turning, basis.T @ C @ basis)
    elastic_ones = np.sqrt(np.abs(squares[squares != 0.0]))
    rigid = np.abs(values) < 1e-4 * elastic_ones.min(initial=np.inf)
    chosen = [i for i in range(values.size) if not rigid[i] and values[i].imag >= 0.0]
    zeros = np.flatnonzero(rigid)[::2]  # a rigid motion has two eigenvalues
    values[zeros] = 0.0
    chosen += zeros.tolist()
    return values[chosen], basis @ vectors[:, chosen]


def _damped(squares: Array, K: Array, C: Array) -> tuple[Complex, Complex]:
    """Return the 2n eigenvalues of x'' + C x' + K x = 0, sorted by magnitude, and vectors x; K is about diag(squares).

    The fast poles of a damped stiff beam are up to 1e14 times as large as the slow poles, and the round-off of the fast
    poles would hide the slow poles. The slow poles are therefore computed from the inverse problem, (A - shift)^-1, in
    coordinates whose squares are energies.
    """
    from scipy.linalg import eig

    n = squares.size
    one = np.eye(n)
    shift = 0.37 * float(np.sqrt(np.abs(squares[squares != 0.0])).min(initial=np.inf))
    shift = shift if np.isfinite(shift) else 1.0
    scale = 1.0 / np.sqrt(np.abs(squares) + shift**2)
    both = np.outer(scale, scale)
    inverse = np.linalg.inv((K + shift * C + shift**2 * one) * both)
    upper = np.hstack([-inverse @ ((C + shift * one) * both), -inverse * scale])
    lower = np.hstack([np.diag(scale), np.zeros((n, n))]) + shift * scale[:, None] * upper
    slow, slow_vectors = eig(np.vstack([upper, lower]))
    fast, fast_vectors = eig(np.block([[np.zeros((n, n)), one], [-K, -C]]))
    slow = shift + 1.0 / np.where(slow == 0.0, 1e-300, slow)
    count = int((np.abs(slow) < 1e7 * shift).sum())
    low, high = np.argsort(np.abs(slow), kind="stable")[:count], np.argsort(np.abs(fast), kind="stable")[count:]
    vectors = np.hstack([scale[:, None] * slow_vectors[:n, low], fast_vectors[:n, high]])
    return np.concatenate([slow[low], fast[high]]), vectors
