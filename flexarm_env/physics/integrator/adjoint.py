"""Cotangents of a step, a fresh start and a jump of torques: compute the inputs' from the results' cotangents.

The functions are the transposes of those in `tangents`. The transposed functions solve a system with the transposed
matrix and apply the residual's derivatives in reverse. `bar` is a work array: its q, v, a, b and u hold cotangents, its
other rows are scratch. `w` holds the arm at the end of the step.
"""

from __future__ import annotations

from ...compiler import kernel, load, max_over_lanes, select_lt, size, splat, store
from ..joints.friction import friction_cotangents, friction_residual_cotangents, store_branch
from ..model import TAU_D
from ..protocol import (
    MASS_ALONE,
    State,
    Weights,
    input_displacements,
    note_inverse,
    noted_inverse,
    solve_transposed,
    tangent_map,
    vjp_product,
    vjp_residual,
)
from .switching import light_joint_weights
from .tangents import largest_row, tangents_have_converged
from .work import accumulated_increment, copy_rows, remove_known_rows, state_of


@kernel
def _multiply(lane, model, w, bar):
    """Solve for the residual's cotangents: bar.r <- -S^-T bar.r, with the factors in w.S.

    bar: work array of cotangents. Rows of fixed coordinates (model.fixed) are set to 0 before and after.
    """
    for k in range(size(model.n)):
        store(bar.r, k, -load(lane, bar.r, k))
    remove_known_rows(lane, model, None, bar.r, w.S, False)
    solve_transposed(lane, model, w.S, bar.r)
    remove_known_rows(lane, model, None, bar.r, w.S, False)


@kernel
def vjp_step(lane, model, par, par_bar, w, bar, slopes, scheme, passes):
    """Transform the cotangents of q, v, a, b in bar from a step's end to its start; add those of u and parameters.

    w: the arm at the step's end, w.r and w.S from `tangents.factor_step_end`; slopes: `NewmarkSlopes` of the step.
    passes: 1 if S is the residual's exact derivative; more if S is approximate, so that the remaining error is solved
    for again.
    """
    weights, half = Weights(slopes.a, slopes.v, 1.0, newton_share=1.0), slopes.v / slopes.a
    # friction takes the branch of the values: which joints stick, and to which side the others slide
    store_branch(lane, model, par, state_of(w), weights, half, w.r, w.S)
    if model.newton.rotations is None:
        _vjp_step(lane, model, par, par_bar, w, bar, slopes, scheme, weights, half, passes)
    else:
        _vjp_shift(lane, model, par, par_bar, w, bar, slopes, scheme, weights, half, passes)
        _vjp_foresee(lane, model, w, bar, slopes.h, scheme)


@kernel
def _vjp_step(lane, model, par, par_bar, w, bar, slopes, scheme, weights, half, passes):
    """Transform cotangents as `vjp_step`, for coordinates without rotations, by eq. (6.1) and lambda = -S^-T q_bar."""
    n, h, am, af = size(model.n), slopes.h, scheme.alpha_m, scheme.alpha_f
    for _ in range(passes):
        # total cotangent of q+, of which v+, a+ and b+ are functions
        for k in range(n):
            q, v = load(lane, bar.q, k), load(lane, bar.v, k)
            a, b = load(lane, bar.a, k), load(lane, bar.b, k)
            store(bar.r, k, q + v * slopes.v + a * slopes.a + b * slopes.b)
        friction_cotangents(lane, model, weights, half, w.S, bar.r, bar.v, bar.a)
        _multiply(lane, model, w, bar)
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
    """Compute d_bar = v_bar dv/dq + a_bar da/dq + b_bar db/dq: cotangent of a displacement that changes v, a, b."""
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
    """Transform the cotangents of q, v, a in bar from the step's end back to its prediction; D: increment in w.shift.

    The total cotangent of q at the end must vanish, so that forces of stiff strains, which cancel, are not summed up.
    The cotangent of the prediction is -T(D)^-1 (s_v v_bar + s_a a_bar + s_b b_bar). See theory, section 9,
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
        friction_cotangents(lane, model, weights, ahead, w.S, bar.r, bar.v, bar.a)
        _multiply(lane, model, w, bar)
        left = largest_row(lane, model, bar.r, 1, 0)
        first = left if k == 0 else first
        vjp_residual(lane, model, par, par_bar, state_of(w), w.u, bar.S, state_of(bar), bar.u, bar.r)
        if k > 0 and tangents_have_converged(lane, scheme, first, before, left):
            break
        before = left
    # cotangent of the prediction p: -T(D)^-1 (s_v v + s_a a + s_b b)
    _follow(lane, model, bar, slopes, bar.q)
    for i in range(n):
        store(bar.q, i, -load(lane, bar.q, i))
    _turn_back(lane, model, moved, bar.a0, bar.q)


@kernel
def _vjp_foresee(lane, model, w, bar, h, scheme):
    """Transform the cotangents in bar through a step's prediction with a+ = 0 (`newmark_predict`), with rotations.

    The second half of w.shift is the prediction's increment of q. h: length of the step, s.
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


@kernel
def _open_jump(lane, n, bar, after, before):
    """Set bar.r to the cotangent of a jump of a and b, a_bar + b_bar, and the states `after` and `before` to 0."""
    zero = splat(lane, 0.0)
    for k in range(n):
        store(bar.r, k, load(lane, bar.a, k) + load(lane, bar.b, k))
        for part in (after, before):
            store(part.q, k, zero)
            store(part.v, k, zero)
            store(part.a, k, zero)


@kernel
def _add_state(lane, n, more, to):
    """Add the rows of q, v, a of `more` to those of `to`; n: rows."""
    for k in range(n):
        store(to.q, k, load(lane, to.q, k) + load(lane, more.q, k))
        store(to.v, k, load(lane, to.v, k) + load(lane, more.v, k))
        store(to.a, k, load(lane, to.a, k) + load(lane, more.a, k))


@kernel
def vjp_light(lane, model, par, par_bar, w, bar, h, first):
    """Transform cotangents as `vjp_switch` for models with `NewtonPolicy.light_joints` whose inputs are torques alone.

    Cotangents of q belong to increments in body axes. first: lanes > 1/2 that have no residual before the jump. The
    derivative of the matrix M + h/2 C + h^2/4 K is included. See theory, section 9, "Derivatives".
    """
    n, zero, one = size(model.n), splat(lane, 0.0), State(w.q, w.v, w.a0)
    after, before = State(bar.q0, bar.v0, bar.a0), State(w.q0, w.v0, w.b0)
    for k in range(n):
        store(w.r, k, load(lane, w.a, k) - load(lane, w.a0, k))
    _open_jump(lane, n, bar, after, before)
    friction_cotangents(lane, model, MASS_ALONE, 0.5 * h, w.S, bar.r, bar.v, bar.a)
    _multiply(lane, model, w, bar)
    copy_rows(lane, n, bar.r, w.b)
    # without friction r(u) - r(u0) is linear in the torques alone: their cotangents are displacements of bar.r
    if model.newton.friction is None and max_over_lanes(first) < 0.5:
        input_displacements(lane, model, par, bar.r, bar.b0)
        for k in range(size(model.n_inputs)):
            turned = load(lane, bar.b0, k)
            store(bar.u, k, load(lane, bar.u, k) - turned)
            store(bar.u0, k, load(lane, bar.u0, k) + turned)
    else:
        for k in range(n):
            store(bar.b0, k, select_lt(0.5, first, zero, -load(lane, bar.r, k)))
        friction_residual_cotangents(lane, model, w.S, bar.b0)
        vjp_residual(lane, model, par, par_bar, one, w.u, bar.S, after, bar.u, bar.r)
        vjp_residual(lane, model, par, par_bar, one, w.u0, bar.S, before, bar.u0, bar.b0)
        _add_state(lane, n, before, after)
    vjp_product(lane, model, par, par_bar, one, w.u, light_joint_weights(h), w.r, bar.S, after, bar.u, w.b)
    tangent_map(lane, model, w.q, True, after.q)
    _add_state(lane, n, after, bar)


@kernel
def vjp_switch(lane, model, par, par_bar, w, bar, h):
    """Transform the cotangents in bar from after a jump of the torques from u0 to u to before the jump.

    Adds the cotangents of u, u0 and the parameters. w: the arm after the jump, w.S its factors; w.a0: accelerations
    before it. The residual's stiffness part is the same to the last bit on both sides and cancels exactly.
    """
    n = size(model.n)
    after, before = State(bar.q0, bar.v0, bar.a0), State(w.q0, w.v0, w.b0)
    _open_jump(lane, n, bar, after, before)
    friction_cotangents(lane, model, MASS_ALONE, 0.5 * h, w.S, bar.r, bar.v, bar.a)
    _multiply(lane, model, w, bar)
    for k in range(n):
        store(bar.b0, k, -load(lane, bar.r, k))
    friction_residual_cotangents(lane, model, w.S, bar.b0)
    vjp_residual(lane, model, par, par_bar, state_of(w), w.u, bar.S, after, bar.u, bar.r)
    vjp_residual(lane, model, par, par_bar, State(w.q, w.v, w.a0), w.u0, bar.S, before, bar.u0, bar.b0)
    _add_state(lane, n, before, after)
    _add_state(lane, n, after, bar)


@kernel
def vjp_restart(lane, model, par, par_bar, w, bar, fresh, h):
    """Transform the cotangents of q and v in bar from after a fresh start to before it, in lanes with fresh > 1/2.

    w.S: factors of the arm's mass matrix M; h: a step, s, for friction half a step ahead. Other lanes keep their
    cotangents.
    """
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
