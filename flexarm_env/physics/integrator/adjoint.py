"""Cotangents of a step, a fresh start and a jump of torques: what comes out of them, taken back to what went in.

The transposes of `tangents`: a system with the transposed matrix, and the residual's derivatives backwards. `bar` is a
work array whose q, v, a, b and u hold cotangents, its other rows are free; `w` holds the arm at the end of the step.
"""

from __future__ import annotations

from ...compiler import kernel, largest, load, select_lt, size, splat, store
from ..joints.friction import friction_cotangents, note_branch, note_cotangents
from ..model import TAU_D
from ..protocol import (
    MASS_ALONE,
    State,
    Weights,
    friction,
    note_inverse,
    noted_inverse,
    ports,
    rotates,
    solve_transposed,
    tangent_map,
    vjp_product,
    vjp_residual,
)
from .switching import light_weights
from .tangents import largest_row, solved
from .work import copy_rows, moved_by, state_of, take_out_known


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
    weights, half = Weights(slopes.a, slopes.v, 1.0), slopes.v / slopes.a
    note_branch(lane, model, par, state_of(w), weights, half, w.r, w.S)
    if rotates(model) is None:
        _vjp_step(lane, model, par, par_bar, w, bar, slopes, scheme, weights, half, passes)
    else:
        _vjp_shift(lane, model, par, par_bar, w, bar, slopes, scheme, weights, half, passes)
        _vjp_foresee(lane, model, w, bar, slopes.h, scheme)


@kernel
def _vjp_step(lane, model, par, par_bar, w, bar, slopes, scheme, weights, half, passes):
    """`vjp_step` of coordinates that add up."""
    n, h, am, af = size(model.n), slopes.h, scheme.alpha_m, scheme.alpha_f
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
def _follow(lane, model, bar, slopes, d_bar):
    """d_bar <- what v, a and b have of what q is moved by."""
    for k in range(size(model.n)):
        v, a, b = load(lane, bar.v, k), load(lane, bar.a, k), load(lane, bar.b, k)
        store(d_bar, k, v * slopes.v + a * slopes.a + b * slopes.b)


@kernel
def _turn_back(lane, model, d, free, x):
    """x <- T^-1 x, of T that is d's (`protocol.tangent_map`)."""
    for k in range(size(model.n)):
        store(free, k, -load(lane, d, k))
    tangent_map(lane, model, free, True, x)


@kernel
def _vjp_shift(lane, model, par, par_bar, w, bar, slopes, scheme, weights, ahead, passes):
    """bar: cotangents of q, v and a from where increments of rotations have moved q to, v, a and b following, back to
    where it began. w.shift: what moved it.

    What comes to q of stiff strains cancels in the end, and is not summed up: it is what v, a and b take with them.
    """
    n, moved = size(model.n), moved_by(w)[0]
    first, before = splat(lane, 0.0), splat(lane, 0.0)
    tau = load(lane, par, TAU_D) * weights.damping  # of stiff rows of S = K + C + M: C over K
    for i in range(n):
        store(bar.a0, i, load(lane, moved, i) * (tau * -1.0 / (tau + 1.0)))
    tangent_map(lane, model, w.q, False, bar.q)
    note_inverse(lane, model, moved, bar.v0)
    note_inverse(lane, model, w.q, bar.b0)
    for k in range(passes):
        _follow(lane, model, bar, slopes, bar.r)
        copy_rows(lane, n, bar.q, bar.q0)
        noted_inverse(lane, model, moved, bar.v0, bar.r)
        noted_inverse(lane, model, w.q, bar.b0, bar.q0)
        for i in range(n):
            store(bar.r, i, load(lane, bar.r, i) + load(lane, bar.q0, i))
        noted_inverse(lane, model, bar.a0, bar.v0, bar.r)  # to first order S T^-s for K + (C + M) T^-1, s = C / (K + C)
        friction_cotangents(lane, model, weights, ahead, w.S, bar.r, bar.v, bar.a)
        _multiply(lane, model, w, bar)
        left = largest_row(lane, model, bar.r, 1, 0)
        first = left if k == 0 else first
        vjp_residual(lane, model, par, par_bar, state_of(w), w.u, bar.S, state_of(bar), bar.u, bar.r)
        if k > 0 and solved(lane, scheme, first, before, left):
            break
        before = left
    _follow(lane, model, bar, slopes, bar.q)
    for i in range(n):
        store(bar.q, i, -load(lane, bar.q, i))
    _turn_back(lane, model, moved, bar.a0, bar.q)


@kernel
def _vjp_foresee(lane, model, w, bar, h, scheme):
    """`step.foresee` of no acceleration, backwards; second in w.shift: the increment that it moves q by."""
    am, af, beta, gamma, n = scheme.alpha_m, scheme.alpha_f, scheme.beta, scheme.gamma, size(model.n)
    _, way = moved_by(w)
    tangent_map(lane, model, way, False, bar.q)
    for k in range(n):
        d, v, b = load(lane, bar.q, k), load(lane, bar.v, k), load(lane, bar.b, k)
        ahead = (b + v * (h * gamma) + d * (h * h * beta)) * (1.0 / (1.0 - am))
        store(bar.v, k, v + d * h)
        store(bar.a, k, ahead * af)
        store(bar.b, k, v * (h * (1.0 - gamma)) + d * (h * h * (0.5 - beta)) - ahead * am)
    _turn_back(lane, model, way, bar.a0, bar.q)


@kernel
def _open_jump(lane, n, bar, after, before):
    """bar.r <- what comes to a jump of a and b; nothing to the states of both sides."""
    zero = splat(lane, 0.0)
    for k in range(n):
        store(bar.r, k, load(lane, bar.a, k) + load(lane, bar.b, k))
        for part in (after, before):
            store(part.q, k, zero)
            store(part.v, k, zero)
            store(part.a, k, zero)


@kernel
def _add_state(lane, n, more, to):
    """to <- to + more."""
    for k in range(n):
        store(to.q, k, load(lane, to.q, k) + load(lane, more.q, k))
        store(to.v, k, load(lane, to.v, k) + load(lane, more.v, k))
        store(to.a, k, load(lane, to.a, k) + load(lane, more.a, k))


@kernel
def vjp_light(lane, model, par, par_bar, w, bar, h, first):
    """`vjp_switch` of models that are `protocol.light` and whose inputs are torques alone, q's cotangents of increments
    in body axes; first: 1 where there was no residual before. What the matrix itself changes by counts too."""
    n, zero, one = size(model.n), splat(lane, 0.0), State(w.q, w.v, w.a0)
    after, before = State(bar.q0, bar.v0, bar.a0), State(w.q0, w.v0, w.b0)
    for k in range(n):
        store(w.r, k, load(lane, w.a, k) - load(lane, w.a0, k))
    _open_jump(lane, n, bar, after, before)
    friction_cotangents(lane, model, MASS_ALONE, 0.5 * h, w.S, bar.r, bar.v, bar.a)
    _multiply(lane, model, w, bar)
    copy_rows(lane, n, bar.r, w.b)
    if friction(model) is None and largest(first) < 0.5:  # before and after differ by what torques work on
        ports(lane, model, par, bar.r, bar.b0)
        for k in range(size(model.n_inputs)):
            turned = load(lane, bar.b0, k)
            store(bar.u, k, load(lane, bar.u, k) - turned)
            store(bar.u0, k, load(lane, bar.u0, k) + turned)
    else:
        for k in range(n):
            store(bar.b0, k, select_lt(0.5, first, zero, -load(lane, bar.r, k)))
        note_cotangents(lane, model, w.S, bar.b0)
        vjp_residual(lane, model, par, par_bar, one, w.u, bar.S, after, bar.u, bar.r)
        vjp_residual(lane, model, par, par_bar, one, w.u0, bar.S, before, bar.u0, bar.b0)
        _add_state(lane, n, before, after)
    vjp_product(lane, model, par, par_bar, one, w.u, light_weights(h), w.r, bar.S, after, bar.u, w.b)
    tangent_map(lane, model, w.q, True, after.q)
    _add_state(lane, n, after, bar)


@kernel
def vjp_switch(lane, model, par, par_bar, w, bar, h):
    """bar: cotangents from after a jump of the torques from u0 to u to before it; w: after it, its matrix in w.S, but
    for a0: accelerations before it. What the residual has of stiffness on both sides is the same to the last bit, and
    is taken from one another as such."""
    n = size(model.n)
    after, before = State(bar.q0, bar.v0, bar.a0), State(w.q0, w.v0, w.b0)
    _open_jump(lane, n, bar, after, before)
    friction_cotangents(lane, model, MASS_ALONE, 0.5 * h, w.S, bar.r, bar.v, bar.a)
    _multiply(lane, model, w, bar)
    for k in range(n):
        store(bar.b0, k, -load(lane, bar.r, k))
    note_cotangents(lane, model, w.S, bar.b0)
    vjp_residual(lane, model, par, par_bar, state_of(w), w.u, bar.S, after, bar.u, bar.r)
    vjp_residual(lane, model, par, par_bar, State(w.q, w.v, w.a0), w.u0, bar.S, before, bar.u0, bar.b0)
    _add_state(lane, n, before, after)
    _add_state(lane, n, after, bar)


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
