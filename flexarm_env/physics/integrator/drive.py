"""Loads and motions as functions of time, evaluated where the integrator needs them."""

from __future__ import annotations

import math

from ... import time_functions
from ...compiler import kernel, load, splat, store
from ...time_functions import AMPLITUDE, C0, C1, C2, C3, OMEGA, PHASE, PIECE, T0
from ..layout import OF_MOTION

cubic, wave = kernel(time_functions.cubic), kernel(time_functions.wave)
"""A piece's values, by the same lines as a `TimeFunction`'s."""


@kernel
def piece_at(drive, f, t):
    """Index of the piece of function f that holds at time t."""
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
    """(value, rate, second derivative) of function f at t; the piece is the one that holds at `side`."""
    at = PIECE * piece_at(drive, f, side)
    p = drive.pieces[at : at + PIECE]
    s = t - p[T0]
    value, rate, second, _ = cubic(p[C0], p[C1], p[C2], p[C3], s)
    if p[AMPLITUDE] != 0.0:
        phase = p[OMEGA] * s + p[PHASE]
        swing, swing_rate, swing_second, _ = wave(p[AMPLITUDE], p[OMEGA], math.sin(phase), math.cos(phase))
        value, rate, second = value + swing, rate + swing_rate, second + swing_second
    return value, rate, second


@kernel
def set_inputs(lane, drive, u, t, side):
    """Fill the driven entries of u at time t."""
    before = -1
    for i in range(drive.entries.shape[0]):
        entry = drive.entries[i]
        if entry != before:
            store(u, entry, splat(lane, 0.0))
        store(u, entry, load(lane, u, entry) + evaluate(drive, drive.terms[i], t, side)[0])
        before = entry


@kernel
def set_motions(lane, drive, psi, t, side):
    """Fill psi, a `MOTION` for each prescribed coordinate, at time t."""
    for i in range(drive.motions.shape[0]):
        value, rate, second = evaluate(drive, drive.motions[i], t, side)
        at = OF_MOTION.end * i
        store(psi, at + OF_MOTION.value, splat(lane, value))
        store(psi, at + OF_MOTION.rate, splat(lane, rate))
        store(psi, at + OF_MOTION.second, splat(lane, second))
