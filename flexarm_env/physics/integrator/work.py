"""An arm's work array: its views, and what is done to them before and after a system is solved."""

from __future__ import annotations

from typing import Any

from ...compiler import inlined, kernel, load, select_lt, size, splat, store
from ...layout import Field, Layout
from ..layout import BOOKS, COUNTS, FACTORISATIONS, MOTION, OF_MOTION
from ..protocol import State, factor, pin, rotates, solve, update

_ROWS = ("n", "lanes")
_INPUTS = ("inputs", "lanes")
_MOTIONS = ("motions", MOTION.length, "lanes")
WORK = Layout(
    "Work", "lanes, n, shift, factor, inputs, motions",
    Field("q", _ROWS, "m, rad", "coordinates; forces in rows of multipliers"),
    Field("v", _ROWS, "1/s", "their rates"),
    Field("a", _ROWS, "1/s^2", "their second rates"),
    Field("b", _ROWS, "1/s^2", "the integrator's auxiliary accelerations"),
    Field("q0", _ROWS, "m, rad", "the same at the step's start"),
    Field("v0", _ROWS, "1/s", ""),
    Field("a0", _ROWS, "1/s^2", ""),
    Field("b0", _ROWS, "1/s^2", ""),
    Field("r", _ROWS, "N, N m", "residual, and what it is solved for"),
    Field("shift", ("shift", "lanes"), "m, rad", "2 n rows where the period is corrected, or rotations are moved"),
    Field("S", ("factor", "lanes"), "", "iteration matrix and its factors"),
    Field("u", _INPUTS, "N m, N", "inputs"),
    Field("u0", _INPUTS, "N m, N", ""),
    Field("y", _INPUTS, "rad, m", "ports: what the inputs work on"),
    Field("y0", _INPUTS, "rad, m", ""),
    Field("psi", _MOTIONS, "", "a `MOTION` for each prescribed coordinate"),
    Field("psi0", _MOTIONS, "", ""),
    Field("reaction", ("motions", "lanes"), "N, N m", "forces that hold the prescribed coordinates"),
    Field("reaction0", ("motions", "lanes"), "N, N m", ""),
    Field("flag", ("lanes",), "", "status of each lane"),
    Field("books", (BOOKS.length, "lanes"), "J", "a `BOOKS`"),
    Field("counts", (COUNTS.length,), "", "a `COUNTS` for all lanes together"),
)  # fmt: skip
"""The integrator's memory of an arm, or of a group of lanes."""

Work = Any
"""A named tuple of one-dimensional views: the fields of WORK."""

_work_at = kernel(WORK.offsets)
_views = inlined(WORK.views)


@kernel
def rows_of_shift(model, n):
    """What of `shift` there is."""
    return 0 if model.correction is None and rotates(model) is None else 2 * n


@kernel
def work_size(lanes, model, n_motions):
    """Length of the flat array behind `Work`."""
    n, shift = size(model.n), rows_of_shift(model, size(model.n))
    return _work_at(0, lanes, n, shift, size(model.n_factor), size(model.n_inputs), n_motions).end


@inlined
def unpack(lane, model, flat, n_motions):
    """`Work` as views of `flat`."""
    n, shift = size(model.n), rows_of_shift(model, size(model.n))
    return _views(flat, 0, len(lane), n, shift, size(model.n_factor), size(model.n_inputs), n_motions)


@kernel
def state_of(w):
    """The arm's coordinates and their rates."""
    return State(w.q, w.v, w.a)


@kernel
def copy_rows(lane, count, source, target):
    """target <- source, so many elements."""
    for k in range(count):
        store(target, k, load(lane, source, k))


@kernel
def moved_by(w):
    """Where rotations are moved: (what q is its prediction moved by, as increments in body axes; that prediction)."""
    n = w.q.shape[0]
    return w.shift[:n], w.shift[n:]


@kernel
def open_shift(lane, model, w):
    """q is where it is to be moved from."""
    if rotates(model) is not None:
        total, start = moved_by(w)
        copy_rows(lane, size(model.n), w.q, start)
        for k in range(size(model.n)):
            store(total, k, splat(lane, 0.0))


@kernel
def move_on(lane, model, w, d):
    """q moved by d. Rotations do not add up: increments do, and it is their sum that moves the prediction, so that
    where a step ends does not depend on the way that Newton took there."""
    if rotates(model) is None:
        update(lane, model, w.q, 1.0, d, None)
    else:
        total, start = moved_by(w)
        for k in range(size(model.n)):
            store(total, k, load(lane, total, k) + load(lane, d, k))
        copy_rows(lane, size(model.n), start, w.q)
        update(lane, model, w.q, 1.0, total, None)


@kernel
def take_out_known(lane, model, drive, r, S, matrix):
    """Take fixed and prescribed coordinates out of the residual and, where asked for, out of the matrix."""
    for i in range(model.fixed.shape[0]):
        k = model.fixed[i]
        store(r, k, splat(lane, 0.0))
        if matrix:
            pin(lane, model, S, k)
    if drive is not None:
        for i in range(drive.known.shape[0]):
            k = drive.known[i]
            if k >= 0:
                store(r, k, splat(lane, 0.0))
                if matrix:
                    pin(lane, model, S, k)


@kernel
def solve_known(lane, model, drive, w, matrix):
    """r <- S^-1 r without the known rows; `matrix`: S is new, and is factored."""
    take_out_known(lane, model, drive, w.r, w.S, matrix)
    if matrix:
        factor(lane, model, w.S)
        w.counts[FACTORISATIONS] += 1.0
    solve(lane, model, w.S, w.r)


@kernel
def note_reactions(lane, known, algebraic, r, multipliers, reaction):
    """Generalised forces that hold the prescribed coordinates: rows of the residual, or multipliers."""
    for i in range(known.shape[0]):
        k = known[i]
        if k >= 0:
            store(reaction, i, load(lane, r, k))
        elif algebraic is not None:
            store(reaction, i, load(lane, multipliers, algebraic[-1 - k]))


@kernel
def set_known(lane, known, psi, q, v, a, b):
    """Give prescribed coordinates their position, velocity and acceleration."""
    for i in range(known.shape[0]):
        k = known[i]
        if k >= 0:
            at = OF_MOTION.end * i
            second = load(lane, psi, at + OF_MOTION.second)
            store(q, k, load(lane, psi, at + OF_MOTION.value))
            store(v, k, load(lane, psi, at + OF_MOTION.rate))
            store(a, k, second)
            store(b, k, second)


@kernel
def move_multipliers(lane, algebraic, target, values, clear):
    """Multipliers live in q; solves for accelerations or velocity jumps leave them in those arrays."""
    if algebraic is not None:
        for i in range(algebraic.shape[0]):
            k = algebraic[i]
            store(target, k, splat(lane, 0.0) if clear else load(lane, values, k))


@kernel
def take_multipliers(lane, algebraic, w, active, c_m):
    """Take r times c_m from the multipliers, which live in q, where `active` or (None) everywhere; that r becomes 0."""
    if algebraic is not None:
        for i in range(algebraic.shape[0]):
            k = algebraic[i]
            force = load(lane, w.q, k)
            less = force - load(lane, w.r, k) * c_m
            store(w.q, k, less if active is None else select_lt(0.5, active, less, force))
            store(w.r, k, splat(lane, 0.0))
