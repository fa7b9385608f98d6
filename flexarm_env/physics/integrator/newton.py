"""Newton-Raphson iteration of one time step, equations [69]-[82]: from the prediction to the end of the step.

The unknown is the displacement q+. v+, a+ and b+ are linear functions of q+ (`NewmarkSlopes`). During the iteration
w.q, w.v, w.a, w.b contain the current iterate of the step's end, and w.q0, w.v0, w.a0, w.b0 the step's start.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ...compiler import (
    Lanes,
    absolute,
    inlined,
    kernel,
    lane_count,
    max_over_lanes,
    maximum,
    select_lt,
    size,
    tangents_only,
)
from ..contact.integration import apply_contact_friction, least_contraction, measure_near_contacts
from ..joints.friction import apply_friction
from ..layout import ITERATIONS
from ..protocol import (
    ITERATE_ALONE,
    RESIDUAL_ALONE,
    Weights,
    assemble,
    constraint_residual,
    correct_positions,
    factor,
    reuses_matrix,
    solve,
)
from .period import correct_period
from .work import Work, apply_increment, remove_known_rows, solve_unknown_rows, state_of, take_multipliers

LINEAR = 1e-3
"""Smallest contraction that is assumed for models that reuse factors. At first the largest errors decrease
quadratically. The measured contraction therefore underestimates the contraction of the linearly convergent part."""


class NewmarkSlopes(NamedTuple):
    """Derivatives of v+, a+ and b+ at the end of a step by q+, equation (6.1), and the step's length h."""

    v: float  # dv+/dq+ = gamma / (beta h), 1/s
    a: float  # da+/dq+ = (1 - alpha_m) / ((1 - alpha_f) beta h^2), 1/s^2; c_m in docs/theory.md
    b: float  # db+/dq+ = 1 / (beta h^2), 1/s^2
    h: float  # length of the step, s


@kernel
def newmark_slopes(scheme, h):
    """Return the `NewmarkSlopes` of a step of h (s) of the scheme."""
    b = 1.0 / (scheme.beta * h * h)
    return NewmarkSlopes(scheme.gamma / (scheme.beta * h), b * (1.0 - scheme.alpha_m) / (1.0 - scheme.alpha_f), b, h)


@kernel
def _first_contraction(lane, first_error, increment):
    """Return the contraction theta that is assumed for the first iteration, which has no earlier increment to compare.

    increment: |d|, the largest weighted entry of the first increment. The remaining error is estimated as theta / (1 -
    theta) |d|. If first_error = kappa (`NewtonPolicy`) is given and |d| < 0.05, theta is kappa |d|, a quadratic error.
    Otherwise theta is 1/2, so that the estimate is |d| itself.
    """
    if first_error is None:
        return 0.5
    return select_lt(increment, 0.05, increment * first_error, 0.5)


@kernel
def follow_displacement(lane, w: Work, k, d, slopes):
    """Update v, a and b in row k for a change d of coordinate k (m or rad): v += d dv/dq, a += d da/dq, b += d db/dq.

    slopes: `NewmarkSlopes`, dv/dq (1/s), da/dq and db/dq (1/s^2) of the step's end.
    """
    w.v[k] += d * slopes.v
    w.a[k] += d * slopes.a
    w.b[k] += d * slopes.b


@kernel
def move_prediction(lane, model, w: Work, q: Lanes, slopes):
    """Replace the predicted coordinates w.q by q (n rows) and change w.v, w.a, w.b by `slopes` (`NewmarkSlopes`).

    In models with rotations only positions may change (m), so that rows can be subtracted. w.shift stores the change.
    """
    for k in range(size(model.n)):
        moved = q[k]
        d = moved - w.q[k]
        w.q[k] = moved
        follow_displacement(lane, w, k, d, slopes)
        if model.newton.rotations is not None:
            w.shift[k] = d


@kernel
def _shifted_increment(lane, correction, shift: Lanes, k, d):
    """Return the increment of q in row k, and its size for the convergence test; d: Newton increment (m or rad).

    With a period correction (correction not None) the shift of the displacement is added to d. The size is then the
    larger of the two absolute values.
    """
    if correction is None:
        return d, absolute(d)
    moved = d + shift[k]
    return moved, maximum(absolute(moved), absolute(d))


@kernel
def _take_tangent_multipliers(lane, algebraic, w: Work, c_m):
    """Update the multipliers' tangents (dual lanes) by lambda <- lambda - c_m r. The multipliers' values do not change.

    algebraic: rows of the multipliers, or None. c_m: da+/dq+ of the step. The multipliers' rows of w.r become 0.
    """
    if algebraic is not None:
        for i in range(algebraic.shape[0]):
            k = algebraic[i]
            w.q[k] += tangents_only(-w.r[k]) * c_m
            w.r[k] = 0.0


@kernel
def _limit_increment(lane, model, longest, r: Lanes):
    """Scale the increment r (n rows; m, rad) down until its largest weighted entry |r_k| weight_k is <= `longest`.

    longest: a fraction of the arm's length (positions), or rad (angles); None means no limit.
    """
    if longest is not None:
        # max(longest, max_k |r_k| weight_k), so that the factor is at most 1
        size_of = longest
        for k in range(size(model.n)):
            size_of = maximum(absolute(r[k]) * model.weight[k], size_of)
        share = longest / size_of
        for k in range(size(model.n)):
            r[k] *= share


@inlined
def _apply_newton_increment(lane, model, par, w: Work, active, slopes, tolerance):
    """Apply the Newton increment -w.r, equations [80]-[82]: q <- q (+) d; v, a, b by `slopes`; lambda <- lambda - c_m
    r.

    # model     model, par, tolerance of the scheme
    # in        w.r = S^-1 r, w.shift; active: lanes > 1/2 are updated, other lanes do not change by a bit
    # out       w.q, w.v, w.a, w.b; w.r: the increment applied to q

    Returns the largest weighted increment, max_k |d_k| weight_k (rad, lengths over the arm's length). The result is NaN
    if an entry is not finite.
    """
    _limit_increment(lane, model, model.newton.max_increment, w.r)
    # multipliers are forces: they do not count for convergence
    take_multipliers(lane, model.algebraic, w, active, slopes.a)
    largest_of = 0.0
    nothing = -0.0  # x + -0.0 is x to the last bit
    # d = -S^-1 r; largest |d_k| weight_k; v, a, b by their slopes
    for k in range(size(model.n)):
        d = -w.r[k]
        moved, increment = _shifted_increment(lane, model.newton.period_correction, w.shift, k, d)
        largest_of = maximum(increment * model.weight[k], largest_of)
        # a comparison with NaN is false: NaN and inf in any row make the result NaN
        largest_of = select_lt(increment, np.inf, largest_of, np.nan)
        d = select_lt(0.5, active, d, nothing)
        if len(lane) > 1:
            w.r[k] = select_lt(0.5, active, moved, nothing)
            follow_displacement(lane, w, k, d, slopes)
        else:
            w.r[k] = d
    # v, a, b for one arm: loops apart from the check above, so that the compiler vectorizes them
    if len(lane) == 1:
        for k in range(size(model.n)):
            follow_displacement(lane, w, k, w.r[k], slopes)
        if model.newton.period_correction is not None:
            for k in range(size(model.n)):
                w.r[k] = select_lt(0.5, active, w.r[k] + w.shift[k], nothing)
    measure_near_contacts(lane, model, par, w.q, w.S, largest_of)
    apply_increment(lane, model, w, w.r)
    # the correction is of order |d|^2: below the tolerance for increments under its square root
    if model.newton.max_increment is not None:
        active = select_lt(math.sqrt(tolerance), largest_of, active, 0.0)
    correct_positions(lane, model, par, w, active, slopes, None)
    return largest_of


@inlined
def newton(lane, model, drive, par, w: Work, slopes, scheme, plain):
    """Solve a step's equations [69]-[82] for q+, v+, a+, b+ and lambda; return 1 in lanes that failed, 0 in others.

    Convergence criterion: theta / (1 - theta) |d| < tolerance, with the weighted increment |d| and the contraction
    theta (theory, section 6). Lanes that have converged, or have failed before (w.flag), do not change while other
    lanes iterate.

    # model     model, drive, par, scheme. slopes: `NewmarkSlopes` of the step
    # state     w.q, w.v, w.a, w.b: prediction, replaced by the step's end; w.u, w.psi at end; w.q0, w.a0 at start
    # scratch   w.r, w.S (out: factors of the Newton matrix), w.shift

    plain: True skips the period correction (6.2).
    """
    active = select_lt(w.flag[0], 0.5, 1.0, 0.0)
    # before: the last increment, |d| of iteration - 1; corrected: 1 where (6.2) has been applied
    before, corrected = 1e300, 1.0 if plain else 0.0
    for iteration in range(scheme.max_iterations):
        fresh = iteration == 0
        if scheme.modified is None:
            fresh = not reuses_matrix(model.newton, iteration)
        # r and, unless factors are reused, S = c_m dr/da + c_v dr/dv + dr/dq, eqs. [72]-[78]
        # without contacts the same tag as elsewhere, so that a program has one copy of the residual's kernel
        alone = RESIDUAL_ALONE if model.newton.contact is None else ITERATE_ALONE
        weights = Weights(slopes.a, slopes.v, 1.0, newton_share=1.0, friction_apart=True, instant=alone.instant)
        assemble(lane, model, par, state_of(w), w.u, weights if fresh else alone, w.r, w.S)
        constraint_residual(lane, model, w.psi, state_of(w), 0, slopes.a, w.r)
        # w.r <- S^-1 r, then Coulomb friction (6.6) and the period correction (6.2)
        solve_unknown_rows(lane, model, drive, w, fresh)
        apply_contact_friction(lane, model, w.S, w.r, fresh)
        apply_friction(lane, model, par, state_of(w), weights, slopes.v / slopes.a, w.S, w.r)
        corrected = correct_period(lane, model, drive, par, scheme.tolerance, w, corrected, active, slopes)
        increment = _apply_newton_increment(lane, model, par, w, active, slopes, scheme.tolerance)
        w.counts[ITERATIONS] += 1.0
        # contraction theta = |d| / |d of the iteration before|, at most 0.9; at least LINEAR where factors are reused
        theta = select_lt(increment, before * 0.9, increment / before, 0.9)
        if model.newton.reuse is not None:
            theta = maximum(theta, LINEAR)
        if iteration == 0:
            theta = _first_contraction(lane, model.newton.first_error, increment)
            if model.newton.tangent_error is not None:
                theta = maximum(theta, model.newton.tangent_error[0])
        elif model.newton.tangent_error is not None:
            # new matrix: the measured contraction belongs to the old one; theta is at most max(10 |d|, tangent error)
            if not reuses_matrix(model.newton, iteration):
                least = maximum(increment * 10.0, model.newton.tangent_error[1])
                theta = select_lt(least, theta, least, theta)
        # near obstacles the residual is not smooth
        theta = least_contraction(lane, model.newton.contact, w.S, iteration == 0, increment, theta)
        # error after this update: |d| theta / (1 - theta)
        active = select_lt(increment * theta / (1.0 - theta), scheme.tolerance, 0.0, active)
        before = increment
        if max_over_lanes(active) < 0.5:
            break
    # dual lanes: tangents (derivatives along a direction) converge one iteration later than values
    if len(lane) > lane_count(lane):
        for _ in range(3 if model.newton.rotations is None else 6):
            _solve_tangents_once_more(lane, model, drive, par, w, slopes)
    return active


@kernel
def _solve_tangents_once_more(lane, model, drive, par, w: Work, slopes):
    """Repeat one Newton solve for the tangents of dual lanes at the converged values. The values do not change.

    During the iteration the tangents are one iteration behind the values. If S is the exact derivative of r, one
    further solve makes the tangents exact. In models with rotations S is approximate, and a few solves are needed.

    # state     w.q, w.v, w.a, w.b and multipliers: only their tangents change
    # scratch   w.r, w.S
    """
    weights = Weights(slopes.a, slopes.v, 1.0, newton_share=1.0)
    assemble(lane, model, par, state_of(w), w.u, weights, w.r, w.S)
    constraint_residual(lane, model, w.psi, state_of(w), 0, slopes.a, w.r)
    remove_known_rows(lane, model, drive, w.r, w.S, True)
    factor(lane, model, w.S)
    solve(lane, model, w.S, w.r)
    apply_friction(lane, model, par, state_of(w), weights, slopes.v / slopes.a, w.S, w.r)
    _take_tangent_multipliers(lane, model.algebraic, w, slopes.a)
    for k in range(size(model.n)):
        # tangents alone: zero value parts leave q, v, a, b unchanged
        d = tangents_only(-w.r[k])
        w.r[k] = d
        follow_displacement(lane, w, k, d, slopes)
    apply_increment(lane, model, w, w.r)
