"""Natural frequencies and shapes about a point of the motion, steady rotation included."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import validation as check
from ..scene import Scene
from ..simulation import Simulation
from .equations import STEP, Equations, Point, Reduced, slopes
from .equilibrium import settle, still
from .period import point_of
from .state_space import at_start, simulation_of

Array = NDArray[np.float64]

ROUND_OFF = 1e-14
"""Relative error of the stiffness K: a squared frequency below this times |x|'|K||x| is that of a rigid motion."""


@dataclass(frozen=True)
class Modes:
    """The n lowest modes of an arm about a point of its motion.

    Attributes:
        frequencies (n,): natural frequencies |lambda|, rad/s, ascending; 0 for a rigid motion.
        damping (n,): ratios -Re lambda / |lambda|; 1 for each pole of an overdamped mode, -1 for a pole that grows
            without oscillation, 0 for a rigid motion.
        eigenvalues (n,): lambda, rad/s, the one of a pair with positive imaginary part.
        shapes (n, points, 2): displacements of the points along the chain at the phase of their largest one, which
            has unit length, m. In rotation points move on ellipses; this is the real part.
        points (points, 2): the chain itself, root to tip, m.
        spin: rad/s.
    """

    frequencies: Array
    damping: Array
    eigenvalues: NDArray[np.complex128]
    shapes: Array = field(repr=False)
    points: Array = field(repr=False)
    spin: float


def modes(
    target: Simulation | Scene,
    n: int = 6,
    formulation: str | None = None,
    *,
    spin: float = 0.0,
    clamped: bool | Sequence[int] = False,
    **options: Any,
) -> Modes:
    """Natural frequencies, damping ratios and shapes of an arm about a point of its motion.

    Args:
        target: a Scene, about its equilibrium with the joints held at their initial angles (`static_equilibrium`); or a
            Simulation, about the state it has now.
        n: how many modes at most.
        formulation, options: of a Scene, as for `simulate`.
        spin: rad/s, about the root of a pinned Scene without gravity, its loads left out: the modes are those of the
            arm in steady rotation, stretched and bent as that makes it, as seen by an observer who turns with it.
        clamped: False: joints that are not prescribed or rigid can turn (their torques stay what they are); True: the
            hub is held ("clamped modes"); or the indices of the joints that are held.
    Returns:
        The Modes.
    Raises:
        ValueError: a value that is not allowed. NoEquilibrium: there is none near the start.
    """
    n = check.integer("n", n, minimum=1)
    spin = check.number("spin", spin, "rad/s")
    equations, point = _about(target, formulation, options, spin)
    held = _held(clamped, equations)
    reduced = equations.reduced(point, spin)
    keep = [i for i in range(equations.independent.size) if i not in held]
    eigenvalues, vectors = _solve(reduced, keep)
    order = np.argsort(np.abs(eigenvalues), kind="stable")[:n]
    eigenvalues, vectors = eigenvalues[order], vectors[:, order]
    frequencies = np.abs(eigenvalues)
    damping = np.where(frequencies > 0.0, -eigenvalues.real / np.maximum(frequencies, 1e-300), 0.0) + 0.0  # no -0.0
    shapes = [_shape(equations, point.q, reduced.lift[:, keep] @ vector) for vector in vectors.T]
    points = equations.points(point.q)
    return Modes(frequencies, damping, eigenvalues, np.array(shapes).reshape(-1, *points.shape), points, spin)


def _about(
    target: Simulation | Scene, formulation: str | None, options: dict[str, Any], spin: float
) -> tuple[Equations, Point]:
    """The arm's equations and the point that its modes are about."""
    if isinstance(target, Simulation):
        if spin != 0.0:
            raise check.InvalidValue("spin", spin, "must be given with a Scene; a Simulation brings its own motion")
        simulation = simulation_of(target, formulation, options)
        equations = Equations(simulation)
        return equations, point_of(at_start(simulation, equations.model)[1])
    scene = check.instance("target", target, Scene)
    settings = scene.settings(formulation, **options)
    if spin != 0.0 and (scene.root != "pinned" or scene.gravity is not None):
        raise check.InvalidValue("spin", spin, "needs a pinned root and no gravity, or there is no steady rotation")
    moved = {"position": (0.0, 0.0), "loads": ()} if spin != 0.0 else {}
    simulation = still(scene, settings, True, **moved)
    equations = Equations(simulation)
    w = simulation.work
    start = Point(w.q.copy(), *equations.turned(w.q, spin), w.u.copy(), w.psi.copy())
    return equations, settle(equations, start, equations.inputs.tolist(), spin)


def _held(clamped: bool | Sequence[int], equations: Equations) -> list[int]:
    """Places of the held joints among the independent coordinates."""
    if isinstance(clamped, bool):
        return [equations.joints[0]] if clamped and 0 in equations.joints else []
    joints = check.sequence("clamped", clamped, "joint indices")
    for i, joint in enumerate(joints):
        check.integer(f"clamped[{i}]", joint, minimum=0, maximum=equations.n_links - 1)
    return [equations.joints[k] for k in joints if k in equations.joints]


def _solve(reduced: Reduced, keep: list[int]) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Eigenvalues with non-negative imaginary part, one of each rigid pair, and their vectors of coordinates.

    In the basis of the undamped modes, in which the inertia is 1 and the symmetric part of the stiffness diagonal.
    """
    pick = np.ix_(keep, keep)
    M, C, K = reduced.M[pick], reduced.C[pick], reduced.K[pick]
    squares, basis = _undamped(0.5 * (M + M.T), 0.5 * (K + K.T))
    symmetric = np.abs(K - K.T).max() < 1e-8 * np.abs(K).max()
    if symmetric and (squares >= 0.0).all() and np.abs(C).max() ** 2 < 1e-20 * np.abs(K).max() * np.abs(M).max():
        return 1j * np.sqrt(squares), basis.astype(complex)
    turning = 0.0 if symmetric else 0.5 * basis.T @ (K - K.T) @ basis
    values, vectors = _damped(squares, np.diag(squares) + turning, basis.T @ C @ basis)
    moving = np.sqrt(np.abs(squares[squares != 0.0]))
    rigid = np.abs(values) < 1e-4 * moving.min(initial=np.inf)
    chosen = [i for i in range(values.size) if not rigid[i] and values[i].imag >= 0.0]
    zeros = np.flatnonzero(rigid)[::2]  # a rigid motion has two eigenvalues
    values[zeros] = 0.0
    chosen += zeros.tolist()
    return values[chosen], basis @ vectors[:, chosen]


def _damped(squares: Array, K: Array, C: Array) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """All 2n eigenvalues of x'' + C x' + K x = 0, by size, and their vectors x, where K is all but diag(squares).

    The fast poles of a damped stiff beam are up to 1e14 times the slow ones, which would drown in their round-off. The
    slow ones are therefore the inverse problem's, (A - shift)^-1, in coordinates whose squares are energies.
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


def _undamped(M: Array, K: Array) -> tuple[Array, Array]:
    """Squared frequencies and M-normalised shapes of M x'' + K x = 0; those of rigid motions exactly 0.

    Frequencies of stretch may be 1e8 times those of bending, and their round-off with them: the low ones are taken
    from the inverse problem, whose largest eigenvalues they are.
    """
    from scipy.linalg import eigh

    squares, basis = eigh(K, M)
    largest = float(np.abs(squares).max())
    shift = max(1e-12 * largest, -2.0 * float(squares.min()))
    inverse, shapes = eigh(M, K + shift * M)
    low = int((squares < 1e-8 * largest).sum())
    inverse, shapes = inverse[::-1][:low], shapes[:, ::-1][:, :low]
    fine = 1.0 / inverse - shift
    shapes = shapes / np.sqrt(inverse)
    noise = ROUND_OFF * (np.abs(shapes) * (np.abs(K) @ np.abs(shapes))).sum(axis=0) + 1e-6 * shift
    fine[np.abs(fine) < noise] = 0.0
    return np.concatenate([fine, squares[low:]]), np.hstack([shapes, basis[:, low:]])


def _shape(equations: Equations, q: Array, vector: NDArray[np.complex128]) -> Array:
    """Displacements of the chain's points along a complex change of the rows that can move."""
    weight = equations.model.weight[equations.free]
    vector = vector / np.abs(vector * weight).max()

    def moved(step: Array) -> Array:
        at = q.copy()
        at[equations.free] += step[0] * vector.real + step[1] * vector.imag
        return equations.points(at).ravel()

    parts = slopes(moved, np.zeros(2), np.array([0, 1]), np.full(2, STEP / 5.0))
    change = (parts[:, 0] + 1j * parts[:, 1]).reshape(-1, 2)
    largest = change.ravel()[np.abs(change).argmax()]
    real = (change * (np.conj(largest) / np.abs(largest))).real if np.abs(largest) > 0.0 else change.real
    return np.asarray(real / max(float(np.sqrt((real**2).sum(axis=1)).max()), 1e-300))
