"""The integrator's work array: layout, views, and operations on the views before and after a linear solve.

An arm, or a group of arms in lanes, has one flat float64 array. `unpack` returns the array's parts by name, as the
record `Work`.
"""

from __future__ import annotations

from typing import Any

from ...compiler import Lanes, inlined, kernel, select_lt, size
from ...layout import Field, Layout
from ..layout import BOOKS, COUNTS, FACTORISATIONS, MOTION, OF_MOTION
from ..protocol import State, add_stiffness, factor, retract, solve

_ROWS = ("n", "lanes")
_INPUTS = ("inputs", "lanes")
_MOTIONS = ("motions", MOTION.length, "lanes")
WORK = Layout(
    "Work", "lanes, n, shift, factor, inputs, motions",
    Field("q", _ROWS, "m, rad", "coordinates; rows of multipliers contain constraint forces lambda (N, N m)"),
    Field("v", _ROWS, "1/s", "velocities (m/s, rad/s)"),
    Field("a", _ROWS, "1/s^2", "accelerations (m/s^2, rad/s^2)"),
    Field("b", _ROWS, "1/s^2", "auxiliary accelerations of the generalized-alpha method, eq. (6.1)"),
    Field("q0", _ROWS, "m, rad", "q at the start of the step; free between steps"),
    Field("v0", _ROWS, "1/s", "v at the start of the step; free between steps"),
    Field("a0", _ROWS, "1/s^2", "a at the start of the step; free between steps"),
    Field("b0", _ROWS, "1/s^2", "b at the start of the step; free between steps"),
    Field("r", _ROWS, "N, N m", "residual; after a solution S^-1 r (m, rad), the negative Newton increment"),
    Field("shift", ("shift", "lanes"), "m, rad", "2 n rows or none, see `shift_size`"),
    Field("S", ("factor", "lanes"), "", "Newton matrix or, in place, its factors"),
    Field("u", _INPUTS, "N m, N", "inputs: joint torques (N m), then one `LOAD` per point load"),
    Field("u0", _INPUTS, "N m, N", "u at the start of the step, or before a jump"),
    Field("y", _INPUTS, "rad, m", "displacements on which the inputs do work"),
    Field("y0", _INPUTS, "rad, m", "displacements y at the start of the step"),
    Field("psi", _MOTIONS, "", "one `MOTION` per prescribed coordinate: value, rate, second rate"),
    Field("psi0", _MOTIONS, "", "psi at the start of the step, or before a jump"),
    Field("reaction", ("motions", "lanes"), "N, N m",
          "forces (in a jump: impulses) that enforce the prescribed motions"),
    Field("reaction0", ("motions", "lanes"), "N, N m", "reaction at the start of the step"),
    Field("flag", ("lanes",), "", "status code of each lane (`model.STATUS`); 0: ok"),
    Field("books", (BOOKS.length, "lanes"), "J", "energy account, one `BOOKS` per lane"),
    Field("counts", (COUNTS.length,), "", "one `COUNTS` for all lanes together"),
)  # fmt: skip
"""`WORK`: layout of the work array of one arm, or of a group of arms in lanes."""

Work = Any
"""Type of a work record `w`: a named tuple of one-dimensional views, one per field of WORK."""

_work_at = kernel(WORK.offsets)
_views = inlined(WORK.views)


@kernel
def shift_size(model, n):
    """Return the number of rows of `Work.shift`: 2 n if the model has a period correction or rotations, otherwise 0.

    With a period correction the first n rows are the shift of the displacement, the others scratch. With rotations the
    rows are the two arrays of `accumulated_increment`.
    """
    return 0 if model.newton.period_correction is None and model.newton.rotations is None else 2 * n


@kernel
def work_size(lanes, model, n_motions):
    """Return the length of the flat float64 array that `unpack` divides into views. lanes: number of arms in lanes."""
    n, shift = size(model.n), shift_size(model, size(model.n))
    return _work_at(0, lanes, n, shift, size(model.n_factor), size(model.n_inputs), n_motions).end


@inlined
def unpack(lane, model, flat, n_motions):
    """Return `Work`, views of the flat array `flat`, one per field of WORK; n_motions: prescribed coordinates."""
    n, shift = size(model.n), shift_size(model, size(model.n))
    return _views(flat, 0, len(lane), n, shift, size(model.n_factor), size(model.n_inputs), n_motions)


@kernel
def state_of(w):
    """Return the `State` (q, v, a) of the work record w; its arrays are views, not copies."""
    return State(w.q, w.v, w.a)


@kernel
def copy_rows(lane, count, source: Lanes, target: Lanes):
    """Copy the first `count` rows of `source` to `target`."""
    for k in range(count):
        target[k] = source[k]


@kernel
def accumulated_increment(lane, w: Work):
    """Return the arrays d and start (n rows each) of a model with rotations: the coordinates are q = start (+) d.

    d: sum of the step's Newton increments, with rotations in body axes (rad). start: predicted coordinates.
    """
    n = w.q.shape[0]
    return w.shift[:n], w.shift[n:]


@kernel
def reset_shift(lane, model, w):
    """Set the sum of increments of a model with rotations to d = 0 and its start to the current coordinates q."""
    if model.newton.rotations is not None:
        total, start = accumulated_increment(lane, w)
        copy_rows(lane, size(model.n), w.q, start)
        for k in range(size(model.n)):
            total[k] = 0.0


@kernel
def apply_increment(lane, model, w, d: Lanes):
    """Move the coordinates by an increment: q <- q (+) d.

    Rotations cannot be added, but their increments can. In models with rotations, therefore, the sum of all increments
    of the step is applied to the predicted q. The end of a step then does not depend on the path of the Newton
    iteration.

    # model     model
    # out       w.q; in models with rotations also w.shift
    """
    if model.newton.rotations is None:
        retract(lane, model, w.q, 1.0, d, None)
    else:
        # total <- total + d,  q <- start (+) total
        total, start = accumulated_increment(lane, w)
        for k in range(size(model.n)):
            total[k] += d[k]
        copy_rows(lane, size(model.n), start, w.q)
        retract(lane, model, w.q, 1.0, total, None)


@kernel
def remove_known_rows(lane, model, drive, r: Lanes, S, matrix):
    """Remove fixed and prescribed coordinates k from the linear system S x = r by setting r_k to 0.

    matrix: if True, also replace row and column k of S by those of the identity matrix; if False, S contains factors.
    drive: the scene's `Drive`, or None if nothing is prescribed.
    """
    for i in range(model.fixed.shape[0]):
        k = model.fixed[i]
        r[k] = 0.0
        if matrix:
            add_stiffness(lane, model, S, k, None)
    if drive is not None:
        for i in range(drive.known.shape[0]):
            # k < 0: a multiplier prescribes the motion, all rows of q stay unknown
            k = drive.known[i]
            if k >= 0:
                r[k] = 0.0
                if matrix:
                    add_stiffness(lane, model, S, k, None)


@kernel
def solve_unknown_rows(lane, model, drive, w, matrix):
    """Solve for the unknown rows: w.r <- S^-1 w.r, where rows of fixed and prescribed coordinates are 0.

    matrix: True if w.S contains a new matrix, which is then factored; False if w.S contains factors.
    """
    remove_known_rows(lane, model, drive, w.r, w.S, matrix)
    if matrix:
        factor(lane, model, w.S)
        w.counts[FACTORISATIONS] += 1.0
    solve(lane, model, w.S, w.r)


@kernel
def store_reactions(lane, known, algebraic, r: Lanes, multipliers: Lanes, reaction: Lanes):
    """Store the generalized forces (N, N m) that enforce the prescribed motions, one per motion, in `reaction`.

    If known[i] = k >= 0, the reaction of motion i is row k of the residual r. If known[i] = -1 - j, the reaction is
    multiplier j, in row algebraic[j] of `multipliers` (n rows).
    """
    for i in range(known.shape[0]):
        k = known[i]
        if k >= 0:
            reaction[i] = r[k]
        elif algebraic is not None:
            reaction[i] = multipliers[algebraic[-1 - k]]


@kernel
def set_prescribed(lane, known, psi: Lanes, q: Lanes, v: Lanes, a: Lanes, b: Lanes):
    """Set q and v of prescribed coordinates to the motions' values and rates, and a and b to their second rates.

    known: rows of prescribed coordinates. A negative entry (motion prescribed by a multiplier) is skipped.
    psi: one `MOTION` per entry of known: value, rate, second rate (m or rad).
    """
    for i in range(known.shape[0]):
        k = known[i]
        if k >= 0:
            at = OF_MOTION.end * i
            second = psi[at + OF_MOTION.second]
            q[k] = psi[at + OF_MOTION.value]
            v[k] = psi[at + OF_MOTION.rate]
            a[k] = second
            b[k] = second


@kernel
def move_multipliers(lane, algebraic, target: Lanes, values: Lanes, clear):
    """Copy the rows of multipliers from `values` to `target`, or, if clear is True, set them to 0.

    algebraic: rows of the multipliers; None: nothing to do. Multipliers are stored in q. A solution for accelerations
    or velocity jumps, however, contains the multipliers in its own array.
    """
    if algebraic is not None:
        for i in range(algebraic.shape[0]):
            k = algebraic[i]
            # lambda (N, N m) is a row of q: it has no rate or acceleration
            target[k] = 0.0 if clear else values[k]


@kernel
def take_multipliers(lane, algebraic, w: Work, active, c_m):
    """Update the multipliers in w.q: lambda <- lambda - c_m r, equation (3.5), and set their rows of w.r to 0.

    algebraic: rows of the multipliers; None: nothing to do.
    active: lanes > 1/2 are updated; None means all lanes.
    c_m: da+/dq+ of the step, or 1 in solutions for accelerations. The factor c_m reverses the scaling of the
    multipliers' columns in the matrix.
    """
    if algebraic is not None:
        for i in range(algebraic.shape[0]):
            k = algebraic[i]
            force = w.q[k]
            # (3.5): columns of lambda in S are divided by c_m
            less = force - w.r[k] * c_m
            w.q[k] = less if active is None else select_lt(0.5, active, less, force)
            w.r[k] = 0.0
