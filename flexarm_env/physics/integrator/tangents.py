"""Tangents of a step, a fresh start and a jump of torques, by the implicit function theorem at the values found.

What a step solves is r(q, v, a) = 0 with v and a that follow from q and the step's start. Of a direction in which the
start, the inputs or the arm's parameters change, all but q's own share of dr is one residual in dual lanes, with the
tangents that v and a would have if q had none; then S dq = - dr, S being the matrix of plain lanes at the end of the
step. `wide` is a dual tag, `x` its work array, whose values are brought up to date here; `w` holds the arm itself.

Exact where nothing but these equations decides what a step comes to: not with friction as a set, nor where the period
is corrected.
"""

from __future__ import annotations

from ...compiler import kernel, load, size, splat, store
from ..protocol import Weights, assemble, factor, residual, solve
from .work import copy_rows, state_of, take_out_known


@kernel
def copy_values(lane, wide, rows, values, both):
    """The values of `rows` elements into dual lanes, whose tangents stay."""
    many = len(wide) // len(lane)
    for k in range(rows):
        store(both, k * many, load(lane, values, k))


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
def switch_tangents(lane, wide, model, parx, w, x):
    """x: tangents of a and b after the jump, by which the residual has not changed; its matrix is in w.S still."""
    copy_state(lane, wide, model, w, x)
    residual(wide, model, parx, state_of(x), x.u, x.r, x.S)
    for k in range(size(model.n)):
        store(x.r, k, load(wide, x.r, k) - load(wide, x.q0, k))
    _solve(lane, wide, model, w, x)
    for k in range(size(model.n)):
        store(x.a, k, load(wide, x.a, k) + load(wide, x.r, k))
        store(x.b, k, load(wide, x.b, k) + load(wide, x.r, k))
