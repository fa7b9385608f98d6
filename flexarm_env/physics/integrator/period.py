"""Correction of a step for the integrator's error of the period (theory, eq. 6.2).

With beta - 2 kappa instead of beta, Newmark's displacement would preserve the period of a vibration to fourth order in
omega h. The method with beta - 2 kappa, however, is stable only if the step resolves all vibrations. The corrected
displacement is therefore

    q+ = (Newmark's q+) - 2 kappa h^2 Y (a+ - a),   Y = S^-1 c_m M,

The Newton matrix S acts as a low-pass filter. Y is about 1 for motion that the step resolves and vanishes for faster
motion. a+ is the acceleration of the step without correction. The acceleration a+ is taken at the first Newton
increment whose square is below the tolerance; the error of a+ is then below the tolerance too. M is constant.
"""

from __future__ import annotations

import math

from ...compiler import Lanes, absolute, kernel, max_over_lanes, maximum, select_lt, size
from ..joints.friction import hold_sticking_joints
from ..model import TAU_D
from ..protocol import inertia_forces, solve
from .work import Work, remove_known_rows

NEAR, FAR = 0.01, 0.03
"""NEAR: largest weighted Newton increment at which the period is corrected. FAR: largest weighted correction (rad, or
displacement divided by the arm's length). A larger correction would stem from motion that the step does not resolve,
such as vibrations after a jump of the root's velocity. It would add energy."""


@kernel
def _filtered(lane, model, drive, par, w, c_m, turn, x, y: Lanes):
    """Apply the low-pass filter of equation (6.2) to accelerations: y <- S^-1 c_m M x, (n,) lanes; 0 in known rows.

    w.S: factors of the Newton matrix S.
    M: constant mass matrix. c_m = da/dq of the step, 1/s^2.
    turn: None, or (start, q, share): the vectors in x are then first rotated by `share` times the rotation of their
    section from start to q.
    drive: `Drive`, whose prescribed rows are known, or None. Joints that stick by Coulomb friction remain at rest.
    """
    inertia_forces(lane, model, par, turn, x, y)
    for k in range(size(model.n)):
        y[k] *= c_m
    remove_known_rows(lane, model, drive, y, w.S, False)
    solve(lane, model, w.S, y)
    hold_sticking_joints(lane, model, w.S, y)


@kernel
def correct_period(lane, model, drive, par: Lanes, tolerance, w: Work, corrected, active, slopes):
    """Compute the period correction d, equation (6.2), at the first small Newton increment; return the corrected lanes.

    # model     slopes: `NewmarkSlopes`; tolerance of the scheme; without `NewtonPolicy.period_correction` a no-op
    # in        w.q, w.a: Newton iterate; w.q0, w.a0: start of the step; w.S: factors. Lanes > 1/2: active, iterating;
    #           corrected, the correction of this step has been applied
    # out       w.shift <- d (m, rad), zero in lanes not corrected now; w.r: changed so that v and a fit the moved step
    """
    if model.newton.period_correction is None:
        return corrected
    n = size(model.n)
    zero, increment = 0.0, 0.0
    for k in range(n):
        # |d| (weighted): corrected once in a step, at the first d whose square is below the tolerance
        increment = maximum(absolute(w.r[k]) * model.weight[k], increment)
        w.shift[k] = zero
    now = select_lt(increment, min(NEAR, math.sqrt(tolerance)), select_lt(corrected, 0.5, active, zero), zero)
    if max_over_lanes(now) > 0.5:
        d, y = w.shift[:n], w.shift[n:]
        for k in range(n):
            # a+ - a, with a+ after this increment
            d[k] = (w.a[k] - w.a0[k]) - w.r[k] * slopes.a
        remove_known_rows(lane, model, drive, d, w.S, False)
        # Y (a+ - a): S belongs to the step's end, the difference to its middle, so that vectors are turned half way
        _filtered(lane, model, drive, par, w, slopes.a, (w.q0, w.q, 0.5), d, y)
        inertia_forces(lane, model, par, (w.q0, w.q, -0.5), y, None)
        remove_known_rows(lane, model, drive, y, w.S, False)
        # d = -2 kappa h^2 Y (a+ - a); dropped where it is larger than FAR
        shift = zero
        for k in range(n):
            moved = y[k] * (-model.newton.period_correction * slopes.h * slopes.h)
            shift = maximum(absolute(moved) * model.weight[k], shift)
            d[k] = moved
        small = select_lt(shift, FAR, now, zero)
        for k in range(n):
            d[k] = select_lt(0.5, small, d[k], zero)
        _filtered(lane, model, drive, par, w, slopes.a, None, d, y)
        share = 1.0 / (1.0 + par[TAU_D] * slopes.v)
        # moving q by d changes the residual by K d; with S - c_m M = (1 + tau_d c_v) K, S^-1 K d = share (d - Y d)
        for k in range(n):
            w.r[k] += (d[k] - y[k]) * share
    return maximum(now, corrected)
