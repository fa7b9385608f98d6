"""Tangents of a step, a fresh start and a jump of torques, by the implicit function theorem at the values found.

What a step solves is r(q, v, a) = 0 with v and a that follow from q and the step's start. Of a direction in which the
start, the inputs or the arm's parameters change, all but q's own share of dr is one residual in dual lanes, with the
tangents that v and a would have if q had none; then S dq = - dr, S being the matrix of plain lanes at the end of the
step. `wide` is a dual tag, `x` its work array, whose values are brought up to date here; `w` holds the arm itself.

Exact where nothing but these equations decides what a step comes to: not with friction as a set, nor where the period
is corrected.
"""

from __future__ import annotations

from ...compiler import absolute, alone, change, kernel, largest, load, maximum, select_lt, size, splat, store
from ..protocol import Weights, assemble, factor, multiply, residual, rotates, solve, update
from .step import foresee
from .switching import light_weights
from .work import copy_rows, moved_by, open_shift, state_of, take_out_known


@kernel
def copy_values(lane, wide, rows, values, both):
    """The values of `rows` elements into dual lanes, whose tangents stay."""
    many = len(wide) // len(lane)
    for k in range(rows):
        store(both, k * many, load(lane, values, k))


LEFT, LEAST = 1e-8, 1e-14
"""Share of the first solution that may be left, over the steps' own tolerance; at least."""


@kernel
def largest_row(lane, model, r, many, first):
    """The largest weighted row of r, whose rows have `many` elements each, those before `first` left out."""
    found = splat(lane, 0.0)
    for k in range(size(model.n)):
        for j in range(first, many):
            found = maximum(absolute(load(lane, r, k * many + j)) * model.weight[k], found)
    return found


@kernel
def solved(lane, scheme, first, before, left):
    """Whether of the first solution nothing counts beyond the last, `left` after one of `before`."""
    share = max(LEAST, LEFT * scheme.tolerance)
    return largest(select_lt(first * before * share, left * left, 1.0, splat(lane, 0.0))) < 0.5


@kernel
def copy_state(lane, wide, model, w, x):
    """The values of q, v and a."""
    n = size(model.n)
    copy_values(lane, wide, n, w.q, x.q)
    copy_values(lane, wide, n, w.v, x.v)
    copy_values(lane, wide, n, w.a, x.a)


@kernel
def prepare(lane, model, par, w, slopes):
    """w.S <- the factors of a step's matrix at its end."""
    weights = Weights(slopes.a, slopes.v, 1.0)
    assemble(lane, model, par, state_of(w), w.u, weights, w.r, w.S)
    take_out_known(lane, model, None, w.r, w.S, True)
    factor(lane, model, w.S)


@kernel
def _solve(lane, wide, model, w, x):
    """Tangents of x.r <- those of - S^-1 r."""
    n, many = size(model.n), len(wide) // len(lane)
    for j in range(1, many):
        for k in range(n):
            store(w.r, k, -load(lane, x.r, k * many + j))
        take_out_known(lane, model, None, w.r, w.S, False)
        solve(lane, model, w.S, w.r)
        for k in range(n):
            store(x.r, k * many + j, load(lane, w.r, k))


@kernel
def step_tangents(lane, wide, model, parx, w, x, slopes, scheme, passes):
    """x: tangents of q, v, a, b from a step's start to its end, where w is; w.S from `prepare`.

    passes: 1 where S is the residual's derivative; where it is nearly so, what is left is solved for again.
    """
    if rotates(model) is None:
        _step_tangents(lane, wide, model, parx, w, x, slopes, scheme, passes)
    else:
        for start, value in ((w.q0, x.q), (w.v0, x.v), (w.a0, x.a), (w.b0, x.b)):
            copy_values(lane, wide, size(model.n), start, value)
        foresee(wide, model, x, slopes.h, scheme)
        copy_rows(wide, size(model.n), x.b, x.b0)
        _shift_tangents(lane, wide, model, parx, w, x, slopes, scheme, passes)
        for k in range(size(model.n)):
            store(x.b, k, load(wide, x.b0, k) + load(wide, x.shift, k) * slopes.b)


@kernel
def _shift_tangents(lane, wide, model, parx, w, x, slopes, scheme, passes):
    """x: tangents of q, v and a where increments of rotations move q from where it is, v and a following them, to where
    the residual is 0; w.shift: what moves it there."""
    n, moved, total = size(model.n), moved_by(w)[0], moved_by(x)[0]
    open_shift(wide, model, x)
    copy_rows(wide, n, x.v, x.v0)
    copy_rows(wide, n, x.a, x.a0)
    copy_values(lane, wide, n, moved, total)
    _follow_shift(wide, model, x, slopes)
    first, before = splat(lane, 0.0), splat(lane, 0.0)
    for k in range(passes):
        residual(wide, model, parx, state_of(x), x.u, x.r, x.S)
        _solve(lane, wide, model, w, x)
        for i in range(n):
            store(total, i, load(wide, total, i) + change(load(wide, x.r, i)))
        _follow_shift(wide, model, x, slopes)
        left = largest_row(lane, model, x.r, len(wide) // len(lane), 1)
        first = left if k == 0 else first
        if k > 0 and solved(lane, scheme, first, before, left):
            break
        before = left


@kernel
def _follow_shift(wide, model, x, slopes):
    """q, v and a of what q is moved by."""
    total, start = moved_by(x)
    copy_rows(wide, size(model.n), start, x.q)
    update(wide, model, x.q, 1.0, total, None)
    for i in range(size(model.n)):
        store(x.v, i, load(wide, x.v0, i) + load(wide, total, i) * slopes.v)
        store(x.a, i, load(wide, x.a0, i) + load(wide, total, i) * slopes.a)


@kernel
def _step_tangents(lane, wide, model, parx, w, x, slopes, scheme, passes):
    """`step_tangents` of coordinates that add up."""
    n, h, am, af = size(model.n), slopes.h, scheme.alpha_m, scheme.alpha_f
    for k in range(n):
        q, v, a, b = load(wide, x.q, k), load(wide, x.v, k), load(wide, x.a, k), load(wide, x.b, k)
        ahead = q + v * h + b * (h * h * (0.5 - scheme.beta))
        store(x.q0, k, ahead)
        store(x.q, k, splat(wide, 0.0))
        store(x.v, k, v + b * (h * (1.0 - scheme.gamma)) - ahead * slopes.v)
        store(x.a, k, (b * am - a * af) * (1.0 / (1.0 - af)) - ahead * slopes.a)
    for _ in range(passes):
        copy_state(lane, wide, model, w, x)
        residual(wide, model, parx, state_of(x), x.u, x.r, x.S)
        _solve(lane, wide, model, w, x)
        for k in range(n):
            q = load(wide, x.r, k)
            store(x.q, k, load(wide, x.q, k) + q)
            store(x.v, k, load(wide, x.v, k) + q * slopes.v)
            store(x.a, k, load(wide, x.a, k) + q * slopes.a)
    for k in range(n):
        store(x.b, k, (load(wide, x.q, k) - load(wide, x.q0, k)) * slopes.b)


@kernel
def restart_tangents(lane, wide, model, parx, w, x):
    """x.r: tangents of a from those of q and v, after a fresh start, whose matrix is in w.S still."""
    for k in range(size(model.n)):
        store(x.a, k, splat(wide, 0.0))
    copy_state(lane, wide, model, w, x)
    residual(wide, model, parx, state_of(x), x.u, x.r, x.S)
    _solve(lane, wide, model, w, x)


@kernel
def before_switch(lane, wide, model, parx, w, x):
    """x.q0 <- the residual before the torques jump from u0 to u."""
    copy_state(lane, wide, model, w, x)
    residual(wide, model, parx, state_of(x), x.u0, x.r, x.S)
    copy_rows(wide, size(model.n), x.r, x.q0)


@kernel
def light_tangents(lane, wide, model, parx, w, x, h):
    """`switch_tangents` of models that are `protocol.light`, whose matrix changes too."""
    n = size(model.n)
    for k in range(n):
        store(x.b0, k, splat(wide, 0.0))
    copy_values(lane, wide, n, w.a, x.b0)
    for k in range(n):
        store(x.b0, k, alone(load(wide, x.a, k)) - load(wide, x.b0, k))
    assemble(wide, model, parx, state_of(x), x.u, light_weights(h), x.r, x.S)
    for k in range(n):
        store(x.r, k, load(wide, x.q0, k) - load(wide, x.r, k))
    multiply(wide, model, x.S, x.b0, x.r)
    for k in range(n):
        store(x.r, k, -load(wide, x.r, k))
    _solve(lane, wide, model, w, x)
    _add_jump(wide, n, x)


@kernel
def _add_jump(wide, n, x):
    for k in range(n):
        store(x.a, k, load(wide, x.a, k) + load(wide, x.r, k))
        store(x.b, k, load(wide, x.b, k) + load(wide, x.r, k))


@kernel
def switch_tangents(lane, wide, model, parx, w, x):
    """x: tangents of a and b after the jump, by which the residual has not changed; its matrix is in w.S still."""
    copy_state(lane, wide, model, w, x)
    residual(wide, model, parx, state_of(x), x.u, x.r, x.S)
    for k in range(size(model.n)):
        store(x.r, k, load(wide, x.r, k) - load(wide, x.q0, k))
    _solve(lane, wide, model, w, x)
    _add_jump(wide, size(model.n), x)
