"""Loads and motions as functions of time, evaluated where the integrator needs them."""

from __future__ import annotations

import math

from ...compiler.decorator import kernel


@kernel
def piece_at(drive, f, t):
    """Index of the piece of function f that holds at time t."""
    low, high = drive.first[f], drive.first[f + 1] - 1
    while low < high:
        middle = (low + high + 1) // 2
        if drive.pieces[middle, 0] <= t:
            low = middle
        else:
            high = middle - 1
    return low


@kernel
def evaluate(drive, f, t, side):
    """(value, rate, second derivative) of function f at t; the piece is the one that holds at `side`."""
    p = drive.pieces[piece_at(drive, f, side)]
    s = t - p[0]
    value = p[1] + s * (p[2] + s * (p[3] + s * p[4]))
    rate = p[2] + s * (2.0 * p[3] + 3.0 * s * p[4])
    second = 2.0 * p[3] + 6.0 * s * p[4]
    if p[5] != 0.0:
        phase = p[6] * s + p[7]
        value += p[5] * math.sin(phase)
        rate += p[5] * p[6] * math.cos(phase)
        second -= p[5] * p[6] * p[6] * math.sin(phase)
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
    """Fill psi (n_motions * 3: position, velocity, acceleration) at time t."""
    for i in range(drive.motions.shape[0]):
        value, rate, second = evaluate(drive, drive.motions[i], t, side)
        psi[3 * i], psi[3 * i + 1], psi[3 * i + 2] = value, rate, second
