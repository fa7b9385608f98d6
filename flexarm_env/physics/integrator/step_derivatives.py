"""Forward and backward derivatives of a time step, from the equation that the step solves (rules: `transitions`).

The unknown is q+; v+, a+ and b+ are linear functions of q+, equation (6.1). In models with rotations the unknown is the
increment D from the prediction p, with q+ = p (+) D. The two unknowns have different round-off. If q+ is the unknown,
forces of stiff strains appear only in S. With rotations q+ cannot be the unknown, because increments of rotations do
not add up. Arguments are as in `transitions`.
"""

from __future__ import annotations

from ...compiler import absolute, kernel, load, max_over_lanes, maximum, select_lt, size, splat, store, tangents_only
from ..joints.friction_derivatives import friction_cotangents, store_branch
from ..model import TAU_D
from ..protocol import (
    Weights,
    assemble,
    factor,
    note_inverse,
    noted_inverse,
    residual,
    retract,
    tangent_map,
    vjp_residual,
)
from .step import newmark_predict
from .transitions import copy_state, copy_values, solve_cotangents, solve_tangents
from .work import accumulated_increment, copy_rows, remove_known_rows, reset_shift, state_of

LEFT, LEAST = 1e-8, 1e-14
"""Allowed error of derivatives relative to their first solution: LEFT times the Newton tolerance, but at least
LEAST."""


@kernel
def _step_weights(slopes):
    """Return the `Weights` of a step's matrix S = s_a dr/da + s_v dr/dv + dr/dq. slopes: `NewmarkSlopes`."""
    return Weights(slopes.a, slopes.v, 1.0, newton_share=1.0)


@kernel
def _largest_row(lane, model, r, many, first):
    """Return the largest |r_k| weight_k of r (n rows of `many` elements each); elements before `first` do not count."""
    found = splat(lane, 0.0)
    for k in range(size(model.n)):
        for j in range(first, many):
            found = maximum(absolute(load(lane, r, k * many + j)) * model.weight[k], found)
    return found


@kernel
def _have_converged(lane, scheme, first, before, left):
    """Return whether the remaining error, left^2 / before, is in all lanes below the allowed fraction of `first`.

    first, before, left: largest weighted rows of the first, the second to last, and the last correction.
    """
    share = max(LEAST, LEFT * scheme.tolerance)
    return max_over_lanes(select_lt(first * before * share, left * left, 1.0, splat(lane, 0.0))) < 0.5


@kernel
def factor_step_end(lane, model, par, w, slopes):
    """Compute and factor the Newton matrix at the end of a step in w.S; store which joints stick. Scratch memory:
    w.r."""
    # the matrix of Newton's last iteration belongs to an earlier iterate
    weights = _step_weights(slopes)
    assemble(lane, model, par, state_of(w), w.u, weights, w.r, w.S)
    remove_known_rows(lane, model, None, w.r, w.S, True)
    factor(lane, model, w.S)
    store_branch(lane, model, par, state_of(w), weights, slopes.v / slopes.a, w.r, w.S)


@kernel
def step_tangents(lane, wide, model, parx, w, x, slopes, scheme, passes):
    """Replace the tangents of q, v, a, b in x at a step's start by the tangents at the step's end.

    # in        w: the arm at the step's end, w.S from `factor_step_end`; w.q0, w.v0, w.a0, w.b0: its start
    # out       x.q, x.v, x.a, x.b; x.r, x.S: scratch

    passes: number of solutions with S. 1 if S is the residual's exact derivative; more if S is approximate.
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
    """Compute the tangents of q, v and a at the step's end, where q = (predicted q) (+) d with the total increment d.

    v and a change with d by `slopes`. x contains the tangents of the prediction on entry. w.shift: d at the step's end.
    passes: as in `step_tangents`. See docs/theory.md, section 9, "Derivatives".
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
        solve_tangents(lane, wide, model, parx, w, x, _step_weights(slopes), slopes.v / slopes.a, x.q0)
        for i in range(n):
            store(total, i, load(wide, total, i) + tangents_only(load(wide, x.r, i)))
        _follow_shift(wide, model, x, slopes)
        left = _largest_row(lane, model, x.r, len(wide) // len(lane), 1)
        # first correction: the scale of what may be left
        first = left if k == 0 else first
        if k > 0 and _have_converged(lane, scheme, first, before, left):
            break
        before = left


@kernel
def _follow_shift(wide, model, x, slopes):
    """Set x.q, x.v, x.a to the prediction changed by its total increment d: q (+) d, v + dv/dq d, a + da/dq d."""
    total, start = accumulated_increment(wide, x)
    copy_rows(wide, size(model.n), start, x.q)
    retract(wide, model, x.q, 1.0, total, None)
    for i in range(size(model.n)):
        # v_p + c_v D, a_p + c_m D, eq. (6.1)
        store(x.v, i, load(wide, x.v0, i) + load(wide, total, i) * slopes.v)
        store(x.a, i, load(wide, x.a0, i) + load(wide, total, i) * slopes.a)


@kernel
def _step_tangents(lane, wide, model, parx, w, x, slopes, scheme, passes):
    """Compute the tangents of a step like `step_tangents`, for coordinates without rotations, by equation (6.1)."""
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
        solve_tangents(lane, wide, model, parx, w, x, _step_weights(slopes), slopes.v / slopes.a, x.v0)
        for k in range(n):
            q = load(wide, x.r, k)
            store(x.q, k, load(wide, x.q, k) + q)
            store(x.v, k, load(wide, x.v, k) + q * slopes.v)
            store(x.a, k, load(wide, x.a, k) + q * slopes.a)
    for k in range(n):
        store(x.b, k, (load(wide, x.q, k) - load(wide, x.q0, k)) * slopes.b)


@kernel
def vjp_step(lane, model, par, par_bar, w, bar, slopes, scheme, passes):
    """Transform the cotangents of q, v, a, b in bar from a step's end to its start; add those of u and parameters.

    w: work array at the step's end, with w.r and w.S from `factor_step_end`. slopes: `NewmarkSlopes` of the step.
    passes: number of solutions with S: 1 if S is the residual's exact derivative, more if S is approximate.
    """
    weights, half = _step_weights(slopes), slopes.v / slopes.a
    if model.newton.rotations is None:
        _vjp_step(lane, model, par, par_bar, w, bar, slopes, scheme, weights, half, passes)
    else:
        _vjp_shift(lane, model, par, par_bar, w, bar, slopes, scheme, weights, half, passes)
        _vjp_foresee(lane, model, w, bar, slopes.h, scheme)


@kernel
def _vjp_step(lane, model, par, par_bar, w, bar, slopes, scheme, weights, half, passes):
    """Transform cotangents like `vjp_step` for coordinates without rotations, equation (6.1), lambda = -S^-T q_bar."""
    n, h, am, af = size(model.n), slopes.h, scheme.alpha_m, scheme.alpha_f
    for _ in range(passes):
        # total cotangent of q+, of which v+, a+ and b+ are functions
        for k in range(n):
            q, v = load(lane, bar.q, k), load(lane, bar.v, k)
            a, b = load(lane, bar.a, k), load(lane, bar.b, k)
            store(bar.r, k, q + v * slopes.v + a * slopes.a + b * slopes.b)
        friction_cotangents(lane, model, par_bar, weights, half, w.S, bar.r, bar.v, bar.a)
        solve_cotangents(lane, model, w, bar)
        vjp_residual(lane, model, par, par_bar, state_of(w), w.u, bar.S, state_of(bar), bar.u, bar.r)
    for k in range(n):
        # (6.1) backwards: from v+, a+, b+ to q, v, a, b of the start
        v, a = load(lane, bar.v, k), load(lane, bar.a, k)
        # ahead: cotangent of q + h v + h^2 (1/2 - beta) b, from which q+ departs in (6.1)
        ahead = -load(lane, bar.b, k) * slopes.b - v * slopes.v - a * slopes.a
        store(bar.q, k, ahead)
        store(bar.v, k, v + ahead * h)
        store(bar.b, k, v * (h * (1.0 - scheme.gamma)) + a * (am / (1.0 - af)) + ahead * (h * h * (0.5 - scheme.beta)))
        store(bar.a, k, a * (-af / (1.0 - af)))


@kernel
def _follow(lane, model, bar, slopes, d_bar):
    """Compute d_bar = v_bar dv/dq + a_bar da/dq + b_bar db/dq, the cotangent of a change of q that changes v, a, b."""
    for k in range(size(model.n)):
        v, a, b = load(lane, bar.v, k), load(lane, bar.a, k), load(lane, bar.b, k)
        store(d_bar, k, v * slopes.v + a * slopes.a + b * slopes.b)


@kernel
def _turn_back(lane, model, d, free, x):
    """Compute x <- T^-1 x with the tangent map T of the increment d (`protocol.tangent_map`); free: scratch."""
    for k in range(size(model.n)):
        store(free, k, -load(lane, d, k))
    tangent_map(lane, model, free, True, x)


@kernel
def _vjp_shift(lane, model, par, par_bar, w, bar, slopes, scheme, weights, ahead, passes):
    """Transform the cotangents of q, v, a in bar from the step's end to its prediction; w.shift: increment D.

    The total cotangent of q at the end must vanish, so that forces of stiff strains cancel instead of being summed up.
    The cotangent of the prediction is -T(D)^-1 (s_v v_bar + s_a a_bar + s_b b_bar). See docs/theory.md, section 9,
    "Derivatives".
    """
    n, moved = size(model.n), accumulated_increment(lane, w)[0]
    first, before = splat(lane, 0.0), splat(lane, 0.0)
    # tau = C / K of stiff rows of S = K + C + M; a0 <- -s D with s = tau / (1 + tau)
    tau = load(lane, par, TAU_D) * weights.damping
    for i in range(n):
        store(bar.a0, i, load(lane, moved, i) * (tau * -1.0 / (tau + 1.0)))
    tangent_map(lane, model, w.q, False, bar.q)
    note_inverse(lane, model, moved, bar.v0)
    note_inverse(lane, model, w.q, bar.b0)
    for k in range(passes):
        # cotangent of D: that of v, a, b mapped by T(D)^-T, and that of q in body axes
        _follow(lane, model, bar, slopes, bar.r)
        copy_rows(lane, n, bar.q, bar.q0)
        noted_inverse(lane, model, moved, bar.v0, bar.r)
        noted_inverse(lane, model, w.q, bar.b0, bar.q0)
        for i in range(n):
            store(bar.r, i, load(lane, bar.r, i) + load(lane, bar.q0, i))
        # to first order S T^-s stands for K + (C + M) T^-1, s = C / (K + C)
        noted_inverse(lane, model, bar.a0, bar.v0, bar.r)
        friction_cotangents(lane, model, par_bar, weights, ahead, w.S, bar.r, bar.v, bar.a)
        solve_cotangents(lane, model, w, bar)
        left = _largest_row(lane, model, bar.r, 1, 0)
        first = left if k == 0 else first
        vjp_residual(lane, model, par, par_bar, state_of(w), w.u, bar.S, state_of(bar), bar.u, bar.r)
        if k > 0 and _have_converged(lane, scheme, first, before, left):
            break
        before = left
    # cotangent of the prediction p: -T(D)^-1 (s_v v + s_a a + s_b b)
    _follow(lane, model, bar, slopes, bar.q)
    for i in range(n):
        store(bar.q, i, -load(lane, bar.q, i))
    _turn_back(lane, model, moved, bar.a0, bar.q)


@kernel
def _vjp_foresee(lane, model, w, bar, h, scheme):
    """Transform the cotangents in bar back through a step's prediction with a+ = 0 (`newmark_predict`), with rotations.

    The second half of w.shift contains the prediction's increment of q. h: length of the step, s.
    """
    am, af, beta, gamma, n = scheme.alpha_m, scheme.alpha_f, scheme.beta, scheme.gamma, size(model.n)
    way = accumulated_increment(lane, w)[1]
    tangent_map(lane, model, way, False, bar.q)
    for k in range(n):
        d, v, b = load(lane, bar.q, k), load(lane, bar.v, k), load(lane, bar.b, k)
        ahead = (b + v * (h * gamma) + d * (h * h * beta)) * (1.0 / (1.0 - am))
        store(bar.v, k, v + d * h)
        store(bar.a, k, ahead * af)
        store(bar.b, k, v * (h * (1.0 - gamma)) + d * (h * h * (0.5 - beta)) - ahead * am)
    _turn_back(lane, model, way, bar.a0, bar.q)
