"""An arm's work array: its views, and what is done to them before and after a system is solved."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...compiler.decorator import kernel
from ...compiler.dispatch import size
from ...compiler.lanes import splat, store
from ..protocol import State, pin


class Work(NamedTuple):
    """Views of one flat float64 array; n rows, L lanes. q v a b: state; *0: state at the step's start."""

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    b: np.ndarray
    q0: np.ndarray
    v0: np.ndarray
    a0: np.ndarray
    b0: np.ndarray
    r: np.ndarray
    shift: np.ndarray  # 2 n rows where the model's period is corrected, otherwise none
    S: np.ndarray
    u: np.ndarray
    u0: np.ndarray
    y: np.ndarray
    y0: np.ndarray
    psi: np.ndarray
    psi0: np.ndarray
    reaction: np.ndarray
    reaction0: np.ndarray
    flag: np.ndarray  # status of each lane
    books: np.ndarray  # work of the drives, dissipated energy, unused
    counts: np.ndarray  # Newton iterations, factorisations, halvings, steps


@kernel
def _rows_of_shift(correction, n):
    return 0 if correction is None else 2 * n


@kernel
def work_size(lanes, model, n_motions):
    """Length of the flat array behind `Work`."""
    n, n_u = size(model.n), size(model.n_inputs)
    shift = _rows_of_shift(model.correction, n)
    return lanes * (9 * n + shift + size(model.n_factor) + 4 * n_u + 8 * n_motions + 4) + 4


@kernel
def unpack(lane, model, flat, n_motions):
    """`Work` as views of `flat`."""
    lanes = len(lane)
    n, n_u, m, s = size(model.n) * lanes, size(model.n_inputs) * lanes, n_motions * lanes, size(model.n_factor) * lanes
    k = 9 * n + _rows_of_shift(model.correction, n)
    i = k + s
    j = i + 4 * n_u
    e = j + 8 * m
    return Work(
        flat[0:n], flat[n : 2 * n], flat[2 * n : 3 * n], flat[3 * n : 4 * n],
        flat[4 * n : 5 * n], flat[5 * n : 6 * n], flat[6 * n : 7 * n], flat[7 * n : 8 * n], flat[8 * n : 9 * n],
        flat[9 * n : k], flat[k:i],
        flat[i : i + n_u], flat[i + n_u : i + 2 * n_u], flat[i + 2 * n_u : i + 3 * n_u], flat[i + 3 * n_u : j],
        flat[j : j + 3 * m], flat[j + 3 * m : j + 6 * m], flat[j + 6 * m : j + 7 * m], flat[j + 7 * m : e],
        flat[e : e + lanes], flat[e + lanes : e + 4 * lanes], flat[e + 4 * lanes : e + 4 * lanes + 4],
    )  # fmt: skip


@kernel
def state_of(w):
    """The arm's coordinates and their rates."""
    return State(w.q, w.v, w.a)


@kernel
def take_out_known(lane, model, drive, r, S, matrix):
    """Take fixed and prescribed coordinates out of the residual and, where asked for, out of the matrix."""
    for i in range(model.fixed.shape[0]):
        k = model.fixed[i]
        store(r, k, splat(lane, 0.0))
        if matrix:
            pin(lane, model, S, k)
    if drive is not None:
        for k in drive.known:
            if k >= 0:
                r[k] = 0.0
                if matrix:
                    pin(lane, model, S, k)


@kernel
def note_reactions(known, algebraic, r, multipliers, reaction):
    """Generalised forces that hold the prescribed coordinates: rows of the residual, or multipliers."""
    for i in range(known.shape[0]):
        k = known[i]
        if k >= 0:
            reaction[i] = r[k]
        elif algebraic is not None:
            reaction[i] = multipliers[algebraic[-1 - k]]


@kernel
def set_known(known, psi, q, v, a, b):
    """Give prescribed coordinates their position, velocity and acceleration."""
    for i in range(known.shape[0]):
        k = known[i]
        if k >= 0:
            q[k], v[k], a[k], b[k] = psi[3 * i], psi[3 * i + 1], psi[3 * i + 2], psi[3 * i + 2]


@kernel
def move_multipliers(algebraic, target, values, clear):
    """Multipliers live in q; solves for accelerations or velocity jumps leave them in those arrays."""
    if algebraic is not None:
        for i in range(algebraic.shape[0]):
            k = algebraic[i]
            target[k] = 0.0 if clear else values[k]
