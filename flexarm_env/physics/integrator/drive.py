"""Loads and motions as functions of time, evaluated where the integrator needs them."""

from __future__ import annotations

import math

from ...compiler.decorator import kernel
from ...time_functions import AMPLITUDE, C0, C1, C2, C3, OMEGA, PHASE, T0
from ..layout import OF_MOTION


@kernel
def piece_at(drive, f, t):
    """Index of the piece of function f that holds at time t."""
    low, high = drive.first[f], drive.first[f + 1] - 1
    while low < high:
        middle = (low + high + 1) // 2
        if drive.pieces[middle, T0] <= t:
            low = middle
        else:
            high = middle - 1
    return low


@kernel
def evaluate(drive, f, t, side):
    """(value, rate, second derivative) of function f at t; the piece is the one that holds at `side`."""
    p = drive.pieces[piece_at(drive, f, side)]
    s = t - p[T0]
    value = p[C0] + s * (p[C1] + s * (p[C2] + s * p[C3]))
    rate = p[C1] + s * (2.0 * p[C2] + 3.0 * s * p[C3])
    second = 2.0 * p[C2] + 6.0 * s * p[C3]
    if p[AMPLITUDE] != 0.0:
        phase = p[OMEGA] * s + p[PHASE]
        value += p[AMPLITUDE] * math.sin(phase)
        rate += p[AMPLITUDE] * p[OMEGA] * math.cos(phase)
        second -= p[AMPLITUDE] * p[OMEGA] * p[OMEGA] * math.sin(phase)
    return value, rate, second


@kernel
def set_inputs(drive, u, t, side):
    """Fill the driven entries of u at time t."""
    before = -1
    for i in range(drive.inputs.shape[0]):
        entry = drive.inputs[i, 0]
        if entry != before:
            u[entry] = 0.0
        u[entry] += evaluate(drive, drive.inputs[i, 1], t, side)[0]
        before = entry


@kernel
def set_motions(drive, psi, t, side):
    """Fill psi, a `MOTION` for each prescribed coordinate, at time t."""
    for i in range(drive.motions.shape[0]):
        value, rate, second = evaluate(drive, drive.motions[i], t, side)
        at = OF_MOTION.end * i
        psi[at + OF_MOTION.value], psi[at + OF_MOTION.rate], psi[at + OF_MOTION.second] = value, rate, second
