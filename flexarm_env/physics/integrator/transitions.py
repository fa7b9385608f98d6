"""Forward and backward derivatives of steps and jumps, from the equation and not from the iteration that solves it.

A transition leads from a start (q, v, a, b), inputs u and parameters to an end. A transition solves an equation for an
unknown z. The end is a function of start and z.

    transition           z    equation, solved with the matrix S
    jump                 da   r(q, v, a + da, u) - r(q, v, a, u0) = 0,  S = M. In lanes that start afresh a = 0, and
                              r(q, v, a, u0) is left out (`start.restart`).
    jump, light joints   da   r(q, v, a, u) - r(q, v, a, u0) + S da = 0,  S = M + h/2 C + h^2/4 K
    step                 q+   r(q+, v+, a+, u) = 0,  v+, a+, b+ linear in q+ and the start, equation (6.1)
    step, rotations      D    r(q+, v+, a+, u) = 0,  q+ = p (+) D,  p, v+ - s_v D, a+ - s_a D: the prediction

Both rules use the factors of S at the solution, in lanes without tangents:

    forward    dr <- one residual in dual lanes with the start's tangents and dz = 0;  dz = -S^-1 dr
    backward   lambda = -S^-T z_bar;  cotangents of start, u and parameters += (dr)^T lambda (`protocol.vjp_residual`)

If S is approximate, the remaining error is solved for again. Coulomb friction corrects the solution by torques that are
linear in the solution, on the branch that the values select (`joints.friction_derivatives`). The period correction is
not part of a step's equation. Derivatives of control periods with this correction therefore differentiate every
operation of the solver (`runtime.derivative`).

Recurring arguments. `w`: the arm's own work array. `wide`: a dual lane tag. `x`: work array with tangents for `wide`,
whose values are copied from w. `parx`: parameters in dual lanes. `bar`: a work array whose q, v, a, b and u contain
cotangents and whose other rows are scratch. `par_bar`: cotangents of the parameters par.
"""

from __future__ import annotations

from ...compiler import kernel, load, max_over_lanes, select_lt, size, splat, store, without_tangents
from ..joints.friction_derivatives import (
    change_friction_tangents,
    friction_cotangents,
    friction_residual_cotangents,
    friction_residual_tangents,
    friction_tangents,
    store_directions,
)
from ..protocol import (
    MASS_ALONE,
    State,
    assemble,
    input_displacements,
    multiply,
    residual,
    solve,
    solve_transposed,
    tangent_map,
    vjp_product,
    vjp_residual,
)
from .switching import light_joint_weights
from .work import remove_known_rows, state_of


# --- both rules --------------------------------------------------------------------------------------
@kernel
def copy_values(lane, wide, rows, values, both):
    """Copy the values of `rows` rows from `values` to the dual lanes `both`. The tangents in `both` do not change."""
    many = len(wide) // len(lane)
    for k in range(rows):
        store(both, k * many, load(lane, values, k))


@kernel
def copy_state(lane, wide, model, w, x):
    """Copy the values of q, v and a from w to the dual work array x. The tangents in x do not change."""
    n = size(model.n)
    copy_values(lane, wide, n, w.q, x.q)
    copy_values(lane, wide, n, w.v, x.v)
    copy_values(lane, wide, n, w.a, x.a)


@kernel
def solve_tangents(lane, wide, model, parx, w, x, weights, ahead, free):
    """Solve for the tangents of the unknown with the factors w.S: tangents of x.r <- -S^-1 (tangents of x.r).

    Known rows become 0.
    weights, ahead: the rate on which friction acts (`friction.apply_friction`), here applied to the tangents of x.v and
    x.a.
    free: scratch memory, n dual rows.
    """
    n, many = size(model.n), len(wide) // len(lane)
    step = n * len(lane)
    v, a = free[:step], free[step : step + step]
    # one right side per direction, because the factors are those of plain lanes
    for j in range(1, many):
        for k in range(n):
            store(w.r, k, load(lane, x.r, k * many + j))
        remove_known_rows(lane, model, None, w.r, w.S, False)
        solve(lane, model, w.S, w.r)
        if model.newton.friction is not None:
            for k in range(n):
                store(v, k, load(lane, x.v, k * many + j))
                store(a, k, load(lane, x.a, k * many + j))
            change_friction_tangents(lane, wide, model, parx, j, w.S)
            friction_tangents(lane, model, State(v, v, a), weights, ahead, w.S, w.r)
        for k in range(n):
            store(x.r, k * many + j, -load(lane, w.r, k))


@kernel
def solve_cotangents(lane, model, w, bar):
    """Solve for the cotangents of the equation with the factors w.S: bar.r <- -S^-T bar.r; known rows become 0."""
    for k in range(size(model.n)):
        store(bar.r, k, -load(lane, bar.r, k))
    remove_known_rows(lane, model, None, bar.r, w.S, False)
    solve_transposed(lane, model, w.S, bar.r)
    remove_known_rows(lane, model, None, bar.r, w.S, False)


# --- jump of accelerations ---------------------------------------------------------------------------
@kernel
def before_jump(lane, wide, model, parx, w, x, first):
    """Compute the residual before a jump in dual lanes: x.q0 <- r(q, v, a, u0), or 0 in lanes that start afresh.

    # in        w: the arm before the jump;  x.u0: inputs before the jump;  first: dual lanes > 1/2 start afresh
    # out       x.q0; x.a, x.b <- 0 in lanes whose accelerations are computed anew
    """
    n, zero = size(model.n), splat(wide, 0.0)
    if model.newton.resolved is not None:
        for k in range(n):
            store(x.a, k, zero)
            store(x.b, k, zero)
    else:
        copy_state(lane, wide, model, w, x)
        residual(wide, model, parx, state_of(x), x.u0, x.r, x.S)
        for k in range(n):
            store(x.q0, k, select_lt(0.5, first, zero, load(wide, x.r, k)))
            if model.newton.light_joints is None:
                store(x.a, k, select_lt(0.5, first, zero, load(wide, x.a, k)))
                store(x.b, k, select_lt(0.5, first, zero, load(wide, x.b, k)))


@kernel
def jump_tangents(lane, wide, model, parx, w, x, h, first):
    """Compute the tangents of a and b in x after a jump of accelerations, given the tangents before the jump.

    # in        w: the arm after the jump, w.S its factors and, by `store_directions`, the branches of friction
    #           h: a step, s;  first: lanes > 1/2 start afresh
    # out       x.a, x.b;  x.r, x.S, x.v0, x.b0: scratch
    """
    n = size(model.n)
    if model.newton.light_joints is not None and model.newton.resolved is None:
        _light_equation(lane, wide, model, parx, w, x, h, first)
    else:
        copy_state(lane, wide, model, w, x)
        residual(wide, model, parx, state_of(x), x.u, x.r, x.S)
        if model.newton.resolved is None:
            friction_residual_tangents(lane, wide, model, parx, w.S, x.q0, first)
            for k in range(n):
                store(x.r, k, load(wide, x.r, k) - load(wide, x.q0, k))
    solve_tangents(lane, wide, model, parx, w, x, MASS_ALONE, 0.5 * h, x.v0)
    for k in range(n):
        da = load(wide, x.r, k)
        store(x.a, k, load(wide, x.a, k) + da)
        store(x.b, k, load(wide, x.b, k) + da)


@kernel
def _light_equation(lane, wide, model, parx, w, x, h, first):
    """Compute x.r <- r(u) - r(u0) + S da for a jump with light joints; S changes along the direction, too.

    x: contains values before the jump, x.q0 = r(u0). w: the arm after the jump. See docs/theory.md, section 9,
    "Derivatives".
    """
    n = size(model.n)
    for k in range(n):
        store(x.b0, k, splat(wide, 0.0))
    copy_values(lane, wide, n, w.a, x.b0)
    for k in range(n):
        # b0 <- -da, without tangents
        store(x.b0, k, without_tangents(load(wide, x.a, k)) - load(wide, x.b0, k))
    assemble(wide, model, parx, state_of(x), x.u, light_joint_weights(h), x.r, x.S)
    friction_residual_tangents(lane, wide, model, parx, w.S, x.q0, first)
    for k in range(n):
        store(x.r, k, load(wide, x.q0, k) - load(wide, x.r, k))
    multiply(wide, model, x.S, x.b0, x.r)
    for k in range(n):
        store(x.r, k, -load(wide, x.r, k))


@kernel
def vjp_jump(lane, model, par, par_bar, w, bar, h, first):
    """Transform the cotangents in bar from the end to the start of a jump of accelerations; add those of u and u0.

    # in        w: the arm after the jump, w.S its factors;  w.a0, w.u0: accelerations and inputs before it;
    #           h: a step, s;  first: lanes > 1/2 start afresh
    # in, out   bar.q, bar.v, bar.a, bar.b, bar.u, bar.u0;  par_bar
    Cotangents of rotations in q refer to increments in body axes. The residual's stiffness part is the same to the last
    bit on both sides of the jump, and cancels.
    """
    n, zero = size(model.n), splat(lane, 0.0)
    for k in range(n):
        store(bar.r, k, load(lane, bar.a, k) + load(lane, bar.b, k))
    store_directions(lane, model, w.S)
    friction_cotangents(lane, model, par_bar, MASS_ALONE, 0.5 * h, w.S, bar.r, bar.v, bar.a)
    solve_cotangents(lane, model, w, bar)
    if model.newton.resolved is not None:
        # a and b before the jump do not count
        vjp_residual(lane, model, par, par_bar, state_of(w), w.u, bar.S, state_of(bar), bar.u, bar.r)
        for k in range(n):
            store(bar.a, k, zero)
            store(bar.b, k, zero)
    else:
        _vjp_difference(lane, model, par, par_bar, w, bar, h, first)


@kernel
def _vjp_difference(lane, model, par, par_bar, w, bar, h, first):
    """Add the cotangents from bar.r through r(q, v, a + da, u) - r(q, v, a, u0), with light joints also through S da.

    Arguments as in `vjp_jump`. In lanes `first` the difference does not contain r(u0), and a = 0 without light joints.
    """
    n, zero, light = size(model.n), splat(lane, 0.0), model.newton.light_joints is not None
    after, before, start = State(bar.q0, bar.v0, bar.a0), State(w.q0, w.v0, w.b0), State(w.q, w.v, w.a0)
    for k in range(n):
        for part in (after, before):
            store(part.q, k, zero)
            store(part.v, k, zero)
            store(part.a, k, zero)
        if light:
            store(w.r, k, load(lane, w.a, k) - load(lane, w.a0, k))
            store(w.b, k, load(lane, bar.r, k))
    # without friction r(u) - r(u0) of light joints is linear in the torques alone
    if light and model.newton.friction is None and max_over_lanes(first) < 0.5:
        input_displacements(lane, model, par, bar.r, bar.b0)
        for k in range(size(model.n_inputs)):
            turned = load(lane, bar.b0, k)
            store(bar.u, k, load(lane, bar.u, k) - turned)
            store(bar.u0, k, load(lane, bar.u0, k) + turned)
    else:
        for k in range(n):
            store(bar.b0, k, select_lt(0.5, first, zero, -load(lane, bar.r, k)))
        friction_residual_cotangents(lane, model, par_bar, w.S, bar.b0)
        vjp_residual(lane, model, par, par_bar, start if light else state_of(w), w.u, bar.S, after, bar.u, bar.r)
        vjp_residual(lane, model, par, par_bar, start, w.u0, bar.S, before, bar.u0, bar.b0)
        _add_state(lane, n, before, after)
    if light:
        vjp_product(lane, model, par, par_bar, start, w.u, light_joint_weights(h), w.r, bar.S, after, bar.u, w.b)
        tangent_map(lane, model, w.q, True, after.q)
    _add_state(lane, n, after, bar)
    if not light:
        for k in range(n):
            store(bar.a, k, select_lt(0.5, first, zero, load(lane, bar.a, k)))
            store(bar.b, k, select_lt(0.5, first, zero, load(lane, bar.b, k)))


@kernel
def _add_state(lane, n, more, to):
    """Add the n rows of q, v, a of `more` to those of `to`."""
    for k in range(n):
        store(to.q, k, load(lane, to.q, k) + load(lane, more.q, k))
        store(to.v, k, load(lane, to.v, k) + load(lane, more.v, k))
        store(to.a, k, load(lane, to.a, k) + load(lane, more.a, k))
