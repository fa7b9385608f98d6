"""Cotangents of a step, a fresh start and a jump of torques: what comes out of them, taken back to what went in.

The transposes of `tangents`: a system with the transposed matrix, and the residual's derivatives backwards. `bar` is a
work array whose q, v, a, b and u hold cotangents, its other rows are free; `w` holds the arm at the end of the step.
"""

from __future__ import annotations

from ...compiler import kernel, load, select_lt, size, splat, store
from ..joints.friction import friction_cotangents, note_branch, note_cotangents
from ..protocol import MASS_ALONE, State, Weights, solve_transposed, vjp_residual
from .work import copy_rows, state_of, take_out_known


@kernel
def _multiply(lane, model, w, bar):
    """bar.r <- - S^-T bar.r, of the factors in w.S."""
    for k in range(size(model.n)):
        store(bar.r, k, -load(lane, bar.r, k))
    take_out_known(lane, model, None, bar.r, w.S, False)
    solve_transposed(lane, model, w.S, bar.r)
    take_out_known(lane, model, None, bar.r, w.S, False)


@kernel
def vjp_step(lane, model, par, par_bar, w, bar, slopes, scheme, passes):
    """bar: cotangents of q, v, a, b from a step's end to its start; those of u and of the parameters are added.

    w.r, w.S: from `tangents.prepare`. passes: 1 where S is the residual's derivative; where it is nearly so, what is
    left is solved for again.
    """
    n, h, am, af = size(model.n), slopes.h, scheme.alpha_m, scheme.alpha_f
    weights, half = Weights(slopes.a, slopes.v, 1.0), slopes.v / slopes.a
    note_branch(lane, model, par, state_of(w), weights, half, w.r, w.S)
    for _ in range(passes):
        for k in range(n):  # all that comes to q of the end, which the residual is to take away
            q, v = load(lane, bar.q, k), load(lane, bar.v, k)
            a, b = load(lane, bar.a, k), load(lane, bar.b, k)
            store(bar.r, k, q + v * slopes.v + a * slopes.a + b * slopes.b)
        friction_cotangents(lane, model, weights, half, w.S, bar.r, bar.v, bar.a)
        _multiply(lane, model, w, bar)
        vjp_residual(lane, model, par, par_bar, state_of(w), w.u, bar.S, state_of(bar), bar.u, bar.r)
    for k in range(n):
        v, a = load(lane, bar.v, k), load(lane, bar.a, k)
        ahead = -load(lane, bar.b, k) * slopes.b - v * slopes.v - a * slopes.a
        store(bar.q, k, ahead)
        store(bar.v, k, v + ahead * h)
        store(bar.b, k, v * (h * (1.0 - scheme.gamma)) + a * (am / (1.0 - af)) + ahead * (h * h * (0.5 - scheme.beta)))
        store(bar.a, k, a * (-af / (1.0 - af)))


@kernel
def vjp_switch(lane, model, par, par_bar, w, bar, h):
    """bar: cotangents from after a jump of the torques from u0 to u to before it; w: after it, its matrix in w.S, but
    for a0: accelerations before it. What the residual has of stiffness on both sides is the same to the last bit, and
    is taken from one another as such."""
    n, zero = size(model.n), splat(lane, 0.0)
    after, before = State(bar.q0, bar.v0, bar.a0), State(w.q0, w.v0, w.b0)
    for k in range(n):
        store(bar.r, k, load(lane, bar.a, k) + load(lane, bar.b, k))
        for part in (after, before):
            store(part.q, k, zero)
            store(part.v, k, zero)
            store(part.a, k, zero)
    friction_cotangents(lane, model, MASS_ALONE, 0.5 * h, w.S, bar.r, bar.v, bar.a)
    _multiply(lane, model, w, bar)
    for k in range(n):
        store(bar.b0, k, -load(lane, bar.r, k))
    note_cotangents(lane, model, w.S, bar.b0)
    vjp_residual(lane, model, par, par_bar, state_of(w), w.u, bar.S, after, bar.u, bar.r)
    vjp_residual(lane, model, par, par_bar, State(w.q, w.v, w.a0), w.u0, bar.S, before, bar.u0, bar.b0)
    for k in range(n):
        store(bar.q, k, load(lane, bar.q, k) + (load(lane, after.q, k) + load(lane, before.q, k)))
        store(bar.v, k, load(lane, bar.v, k) + (load(lane, after.v, k) + load(lane, before.v, k)))
        store(bar.a, k, load(lane, bar.a, k) + (load(lane, after.a, k) + load(lane, before.a, k)))


@kernel
def vjp_restart(lane, model, par, par_bar, w, bar, fresh, h):
    """bar: cotangents of q and v from after a fresh start to before it, where `fresh` is 1; w.S: its matrix."""
    zero = splat(lane, 0.0)
    for k in range(size(model.n)):
        a, b = load(lane, bar.a, k), load(lane, bar.b, k)
        store(bar.r, k, select_lt(0.5, fresh, a + b, zero))
        store(bar.q0, k, select_lt(0.5, fresh, zero, a))
        store(bar.b, k, select_lt(0.5, fresh, zero, b))
    friction_cotangents(lane, model, MASS_ALONE, 0.5 * h, w.S, bar.r, bar.v, bar.a)
    _multiply(lane, model, w, bar)
    vjp_residual(lane, model, par, par_bar, state_of(w), w.u, bar.S, state_of(bar), bar.u, bar.r)
    copy_rows(lane, size(model.n), bar.q0, bar.a)
