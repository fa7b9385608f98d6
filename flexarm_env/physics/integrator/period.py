"""Correction of a step for the integrator's error of the period (docs: theory, eq. 6.2).

Newmark's displacement with beta less 2 kappa would keep the period of a vibration to fourth order in omega h, but is
stable only where the step resolves all of them. Hence

    q+ = (Newmark's q+) - 2 kappa h^2 Y (a+ - a),   Y = S^-1 c_m M,

where S, the iteration matrix at hand, is a low-pass filter: it keeps what the step resolves and stops the rest. a+ is
that of the step without correction, from the first Newton increment whose square is below the tolerance, so that
it leaves no larger an error; M is constant.
"""

from __future__ import annotations

import math

from ...compiler import absolute, kernel, largest, load, maximum, select_lt, size, splat, store
from ..joints.friction import keep_sticking
from ..model import TAU_D
from ..protocol import inertia, rotate, solve
from .work import take_out_known

NEAR, FAR = 0.01, 0.03
"""Largest weighted Newton increment from which to correct, and largest weighted correction: one that is larger belongs
to motion that the step does not resolve (what a jump of the root's velocity leaves), and would bring energy."""


@kernel
def _filtered(lane, model, drive, par, w, c_m, x, y):
    """y <- Y x; zero in coordinates that are known."""
    inertia(lane, model, par, x, y)
    for k in range(size(model.n)):
        store(y, k, load(lane, y, k) * c_m)
    take_out_known(lane, model, drive, y, w.S, False)
    solve(lane, model, w.S, y)
    keep_sticking(lane, model, w.S, y)


@kernel
def correct_period(lane, model, drive, par, tolerance, w, corrected, active, slopes):
    """Where Newton's increment -r of an `active` arm is small for the first time in a step, w.shift <- the correction d
    and r <- what brings a and v to the step so corrected; elsewhere w.shift <- 0. Returns which arms are corrected."""
    if model.correction is None:
        return corrected
    n = size(model.n)
    zero, increment = splat(lane, 0.0), splat(lane, 0.0)
    for k in range(n):
        increment = maximum(absolute(load(lane, w.r, k)) * model.weight[k], increment)
        store(w.shift, k, zero)
    now = select_lt(increment, min(NEAR, math.sqrt(tolerance)), select_lt(corrected, 0.5, active, zero), zero)
    if largest(now) > 0.5:
        d, y = w.shift[: n * len(lane)], w.shift[n * len(lane) :]
        for k in range(n):
            store(d, k, (load(lane, w.a, k) - load(lane, w.a0, k)) - load(lane, w.r, k) * slopes.a)
        take_out_known(lane, model, drive, d, w.S, False)
        rotate(lane, model, w.q0, w.q, 0.5, d)  # S belongs to the step's end, the difference to its middle
        _filtered(lane, model, drive, par, w, slopes.a, d, y)
        rotate(lane, model, w.q0, w.q, -0.5, y)
        take_out_known(lane, model, drive, y, w.S, False)
        shift = zero
        for k in range(n):
            moved = load(lane, y, k) * (-model.correction * slopes.h * slopes.h)
            shift = maximum(absolute(moved) * model.weight[k], shift)
            store(d, k, moved)
        small = select_lt(shift, FAR, now, zero)
        for k in range(n):
            store(d, k, select_lt(0.5, small, load(lane, d, k), zero))
        _filtered(lane, model, drive, par, w, slopes.a, d, y)
        share = 1.0 / (1.0 + load(lane, par, TAU_D) * slopes.v)
        for k in range(n):  # the shift as a residual is K d, and S - c_m M = (1 + tau_d c_v) K
            store(w.r, k, load(lane, w.r, k) + (load(lane, d, k) - load(lane, y, k)) * share)
    return maximum(now, corrected)
