"""Tangents of a step, a fresh start and a jump of torques, by the implicit function theorem at the solution.

A step solves r(q, v, a) = 0, with v and a functions of q and of the step's start. Consider a direction in which the
start, the inputs or the parameters change. One residual in dual lanes, with the tangents of v and a at dq = 0, gives dr
without the part of q. The tangent dq solves S dq = -dr, where S is the matrix at the step's end, in lanes without
tangents.

`wide` is a dual lane tag and `x` its work array, whose values are updated here; `w` is the arm's own work array.

The tangents are exact if only these equations determine the step, which excludes Coulomb friction and period
correction.
"""

from __future__ import annotations

from ...compiler import (
    absolute,
    kernel,
    load,
    max_over_lanes,
    maximum,
    select_lt,
    size,
    splat,
    store,
    tangents_only,
    without_tangents,
)
from ..protocol import Weights, assemble, factor, multiply, residual, retract, solve
from .step import newmark_predict
from .switching import light_joint_weights
from .work import accumulated_increment, copy_rows, remove_known_rows, reset_shift, state_of


@kernel
def copy_values(lane, wide, rows, values, both):
    """Copy the values of `rows` rows to dual lanes `both`, whose tangents do not change."""
    many = len(wide) // len(lane)
    for k in range(rows):
        store(both, k * many, load(lane, values, k))


LEFT, LEAST = 1e-8, 1e-14
"""Allowed error of tangents, as a share of the first solution: LEFT times the steps' tolerance, at least LEAST."""


@kernel
def largest_row(lane, model, r, many, first):
    """Return the largest |r_k| weight_k of r: n rows of `many` elements; elements before `first` do not count."""
    found = splat(lane, 0.0)
    for k in range(size(model.n)):
        for j in range(first, many):
            found = maximum(absolute(load(lane, r, k * many + j)) * model.weight[k], found)
    return found


@kernel
def tangents_have_converged(lane, scheme, first, before, left):
    """Return whether the remaining error, left^2 / before, is below the allowed share of `first` in all lanes.

    first, before, left: largest weighted rows of the first, the last but one and the last correction.
    """
    share = max(LEAST, LEFT * scheme.tolerance)
    return max_over_lanes(select_lt(first * before * share, left * left, 1.0, splat(lane, 0.0))) < 0.5


@kernel
def copy_state(lane, wide, model, w, x):
    """Copy the values of q, v and a from w to the dual work array x; tangents stay."""
    n = size(model.n)
    copy_values(lane, wide, n, w.q, x.q)
    copy_values(lane, wide, n, w.v, x.v)
    copy_values(lane, wide, n, w.a, x.a)


@kernel
def factor_step_end(lane, model, par, w, slopes):
    """Factor the Newton matrix at the end of a step into w.S; w.r <- the residual at the end of the step."""
    # S = c_m dr/da + c_v dr/dv + dr/dq at the end, not that of Newton's last iteration, which belongs to an earlier
    # iterate
    weights = Weights(slopes.a, slopes.v, 1.0, newton_share=1.0)
    assemble(lane, model, par, state_of(w), w.u, weights, w.r, w.S)
    remove_known_rows(lane, model, None, w.r, w.S, True)
    factor(lane, model, w.S)


@kernel
def _solve(lane, wide, model, w, x):
    """Solve for tangents in dual lanes: tangents of x.r <- -S^-1 (tangents of x.r), w.S: factors; known rows are 0."""
    n, many = size(model.n), len(wide) // len(lane)
    # d <- -S^-1 dr, one right side per direction, because the factors are those of plain lanes
    for j in range(1, many):
        for k in range(n):
            store(w.r, k, -load(lane, x.r, k * many + j))
        remove_known_rows(lane, model, None, w.r, w.S, False)
        solve(lane, model, w.S, w.r)
        for k in range(n):
            store(x.r, k * many + j, load(lane, w.r, k))


@kernel
def step_tangents(lane, wide, model, parx, w, x, slopes, scheme, passes):
    """Compute the tangents of q, v, a, b at the end of a step in x, in place of the tangents at its start.

    # in        w: the arm at the step's end, w.S from `factor_step_end`; w.q0, w.v0, w.a0, w.b0: its start
    # out       x.q, x.v, x.a, x.b; x.r, x.S: scratch

    passes: 1 where S is the residual's derivative; more where S is approximate and the remaining error is solved for
    again.
    """
    if model.newton.rotations is None:
        _step_tangents(lane, wide, model, parx, w, x, slopes, scheme, passes)
    else:
        # rotations do not add up: tangents of the prediction p, then of the increment D with q+ = p (+) D
        for start, value in ((w.q0, x.q), (w.v0, x.v), (w.a0, x.a), (w.b0, x.b)):
            copy_values(lane, wide, size(model.n), start, value)
        newmark_predict(wide, model, x, slopes.h, scheme)
        copy_rows(wide, size(model.n), x.b, x.b0)
        _shift_tangents(lane, wide, model, parx, w, x, slopes, scheme, passes)
        for k in range(size(model.n)):
            store(x.b, k, load(wide, x.b0, k) + load(wide, x.shift, k) * slopes.b)


@kernel
def _shift_tangents(lane, wide, model, parx, w, x, slopes, scheme, passes):
    """Compute the tangents of q, v and a at the step's end, with q = (predicted q) (+) d, d: the total increment.

    v and a follow d by `slopes`. x: in, tangents of the prediction; w.shift: d at the step's end. passes: see
    `step_tangents`. See theory, section 9, "Derivatives".
    """
    n, moved, total = size(model.n), accumulated_increment(lane, w)[0], accumulated_increment(wide, x)[0]
    reset_shift(wide, model, x)
    copy_rows(wide, n, x.v, x.v0)
    copy_rows(wide, n, x.a, x.a0)
    copy_values(lane, wide, n, moved, total)
    _follow_shift(wide, model, x, slopes)
    first, before = splat(lane, 0.0), splat(lane, 0.0)
    for k in range(passes):
        # dr at the present tangents of d, then dd <- dd - S^-1 dr
        residual(wide, model, parx, state_of(x), x.u, x.r, x.S)
        _solve(lane, wide, model, w, x)
        for i in range(n):
            store(total, i, load(wide, total, i) + tangents_only(load(wide, x.r, i)))
        _follow_shift(wide, model, x, slopes)
        left = largest_row(lane, model, x.r, len(wide) // len(lane), 1)
        # first correction: the scale of what may be left
        first = left if k == 0 else first
        if k > 0 and tangents_have_converged(lane, scheme, first, before, left):
            break
        before = left


@kernel
def _follow_shift(wide, model, x, slopes):
    """Set x.q, x.v and x.a to the prediction moved by its total increment d: q (+) d, v + dv/dq d, a + da/dq d."""
    total, start = accumulated_increment(wide, x)
    copy_rows(wide, size(model.n), start, x.q)
    retract(wide, model, x.q, 1.0, total, None)
    for i in range(size(model.n)):
        # v_p + c_v D, a_p + c_m D, eq. (6.1)
        store(x.v, i, load(wide, x.v0, i) + load(wide, total, i) * slopes.v)
        store(x.a, i, load(wide, x.a0, i) + load(wide, total, i) * slopes.a)


@kernel
def _step_tangents(lane, wide, model, parx, w, x, slopes, scheme, passes):
    """Compute the tangents of a step as `step_tangents`, for coordinates without rotations, by eq. (6.1)."""
    n, h, am, af = size(model.n), slopes.h, scheme.alpha_m, scheme.alpha_f
    for k in range(n):
        q, v, a, b = load(wide, x.q, k), load(wide, x.v, k), load(wide, x.a, k), load(wide, x.b, k)
        # b+ = (q+ - ahead) db/dq, from which v+ and a+ follow; first with q+ = 0
        ahead = q + v * h + b * (h * h * (0.5 - scheme.beta))
        store(x.q0, k, ahead)
        store(x.q, k, splat(wide, 0.0))
        store(x.v, k, v + b * (h * (1.0 - scheme.gamma)) - ahead * slopes.v)
        store(x.a, k, (b * am - a * af) * (1.0 / (1.0 - af)) - ahead * slopes.a)
    for _ in range(passes):
        copy_state(lane, wide, model, w, x)
        # dq+ = -S^-1 dr
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
    """Compute in x.r the tangents of a after a fresh start, from the tangents of q and v in x; w.S: factors of M."""
    for k in range(size(model.n)):
        store(x.a, k, splat(wide, 0.0))
    copy_state(lane, wide, model, w, x)
    residual(wide, model, parx, state_of(x), x.u, x.r, x.S)
    _solve(lane, wide, model, w, x)


@kernel
def before_switch(lane, wide, model, parx, w, x):
    """Store in x.q0 the residual, with tangents, before a torque jump from x.u0 to x.u; w: the arm before the jump."""
    copy_state(lane, wide, model, w, x)
    residual(wide, model, parx, state_of(x), x.u0, x.r, x.S)
    copy_rows(wide, size(model.n), x.r, x.q0)


@kernel
def light_tangents(lane, wide, model, parx, w, x, h):
    """Compute tangents as `switch_tangents` for models with `NewtonPolicy.light_joints`, where S da = -(r(u) - r(u0)).

    S = M + h/2 C + h^2/4 K changes along the direction too; h: a step, s. w: the arm after the jump.
    See theory, section 9, "Derivatives".
    """
    n = size(model.n)
    for k in range(n):
        store(x.b0, k, splat(wide, 0.0))
    copy_values(lane, wide, n, w.a, x.b0)
    for k in range(n):
        # b0 <- -da, without tangents
        store(x.b0, k, without_tangents(load(wide, x.a, k)) - load(wide, x.b0, k))
    assemble(wide, model, parx, state_of(x), x.u, light_joint_weights(h), x.r, x.S)
    for k in range(n):
        store(x.r, k, load(wide, x.q0, k) - load(wide, x.r, k))
    # r <- r(u) - r(u0) + S da, whose tangents must vanish
    multiply(wide, model, x.S, x.b0, x.r)
    for k in range(n):
        store(x.r, k, -load(wide, x.r, k))
    _solve(lane, wide, model, w, x)
    _add_jump(wide, n, x)


@kernel
def _add_jump(wide, n, x):
    """Add x.r, the tangents of the jump da, to x.a and x.b."""
    for k in range(n):
        store(x.a, k, load(wide, x.a, k) + load(wide, x.r, k))
        store(x.b, k, load(wide, x.b, k) + load(wide, x.r, k))


@kernel
def switch_tangents(lane, wide, model, parx, w, x):
    """Compute the tangents of a and b after a jump of the torques, at which the residual is unchanged: r(u) = r(u0).

    x: in, tangents before the jump and x.q0 from `before_switch`; out, x.a and x.b. w: the arm after the jump, with the
    factors in w.S.
    """
    copy_state(lane, wide, model, w, x)
    residual(wide, model, parx, state_of(x), x.u, x.r, x.S)
    for k in range(size(model.n)):
        store(x.r, k, load(wide, x.r, k) - load(wide, x.q0, k))
    _solve(lane, wide, model, w, x)
    _add_jump(wide, size(model.n), x)
