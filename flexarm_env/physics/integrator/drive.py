"""Evaluate a scene's loads and prescribed motions, which are functions of time, for the integrator."""

from __future__ import annotations

import math

from ... import time_functions
from ...compiler import Lanes, kernel
from ...time_functions import AMPLITUDE, C0, C1, C2, C3, OMEGA, PHASE, PIECE, T0
from ..layout import OF_MOTION

cubic, wave = kernel(time_functions.cubic), kernel(time_functions.wave)
"""Kernels for the value and the derivatives of a piece (cubic plus wave), compiled from the source of
`TimeFunction`."""


@kernel
def piece_at(drive, f, t):
    """Return the index in `drive.pieces` of the piece of time function f that applies at time t (s)."""
    # bisection for the piece with t_i <= t < t_(i+1)
    low, high = drive.first[f], drive.first[f + 1] - 1
    while low < high:
        middle = (low + high + 1) // 2
        if drive.pieces[PIECE * middle + T0] <= t:
            low = middle
        else:
            high = middle - 1
    return low


@kernel
def evaluate(drive, f, t, side):
    """Return (value, first, second time derivative) of time function f of a `Drive` at time t (s).

        value = c0 + c1 s + c2 s^2 + c3 s^3 + A sin(w s + p),    s = t - t0

    The values are in the function's unit (N, N m, m, rad).
    side: time (s) by which the piece is selected. This time is slightly before or after t, which matters if the
    function jumps at t.
    """
    at = PIECE * piece_at(drive, f, side)
    p = drive.pieces[at : at + PIECE]
    # time since the piece began; its cubic, then its sine
    s = t - p[T0]
    value, rate, second, _ = cubic(p[C0], p[C1], p[C2], p[C3], s)
    if p[AMPLITUDE] != 0.0:
        phase = p[OMEGA] * s + p[PHASE]
        swing, swing_rate, swing_second, _ = wave(p[AMPLITUDE], p[OMEGA], math.sin(phase), math.cos(phase))
        value, rate, second = value + swing, rate + swing_rate, second + swing_second
    return value, rate, second


@kernel
def set_inputs(lane, drive, u: Lanes, t, side):
    """Write the inputs that depend on time into u (N m, N): each driven entry is the sum of its terms at time t (s).

    drive: the scene's loads and motions (`Drive`). Entries without a term, such as actions, keep their value. u: array
    of n_inputs lanes.
    side: time (s) slightly before or after t. It selects the piece of a function that jumps at t.
    """
    before = -1
    for i in range(drive.entries.shape[0]):
        entry = drive.entries[i]
        # u_i = sum of its terms, which are neighbors: the first one overwrites
        if entry != before:
            u[entry] = 0.0
        u[entry] += evaluate(drive, drive.terms[i], t, side)[0]
        before = entry


@kernel
def set_motions(lane, drive, psi: Lanes, t, side):
    """Write value, rate and second rate of each prescribed coordinate at time t (s) to psi, one `MOTION` each.

    drive: the scene's loads and motions (`Drive`).
    psi: array of n_motions * 3 lanes (m or rad, with rates).
    side: time (s) slightly before or after t. It selects the piece of a function that jumps at t.
    """
    for i in range(drive.motions.shape[0]):
        value, rate, second = evaluate(drive, drive.motions[i], t, side)
        at = OF_MOTION.end * i
        psi[at + OF_MOTION.value] = value
        psi[at + OF_MOTION.rate] = rate
        psi[at + OF_MOTION.second] = second
