"""How a run of one arm changes with a number that its model was made from, by the implicit function theorem.

A step ends where r(q, v, a; theta) = 0, with v and a that follow from q and the step's start. Of a change of theta all
but q's own share of dr is a difference of the residual between models that were made with theta a little larger and
smaller, at a state moved along with it; then S dq = -dr with the matrix of the step's end. No difference is taken of
what was iterated, so that steps of 1e-5 of theta leave errors of 1e-9. What rubs (Coulomb) slips or sticks as it did.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ..compiler import bare, kernel, size
from ..physics.integrator.drive import set_inputs, set_motions
from ..physics.integrator.newton import slopes_of
from ..physics.integrator.work import take_out_known
from ..physics.layout import OF_MOTION
from ..physics.protocol import (
    State,
    Weights,
    assemble,
    bound_along,
    factor,
    link_poses,
    note_slip,
    residual,
    rub_along,
    solve,
)


class Neighbour(NamedTuple):
    """A model made with theta + offset; what it gives counts by its weight in the derivative."""

    model: Any
    par: np.ndarray
    u: np.ndarray  # (rows inputs,): inputs at the steps' ends
    offset: float
    weight: float


class Steps(NamedTuple):
    """Steps one after the other: what they came to, a row each, and their lengths."""

    q: np.ndarray  # (rows n,)
    v: np.ndarray
    a: np.ndarray
    u: np.ndarray  # (rows inputs,)
    h: np.ndarray  # (rows,) s


@kernel
def drive_rows(drive, times, h, u, psi):
    """Inputs (rows, inputs) and a `MOTION` for each prescribed coordinate (rows, ...) at the ends of steps."""
    for k in range(times.shape[0]):
        before = times[k] - 1e-6 * h[k]
        set_inputs(drive, u[k], times[k], before)
        set_motions(drive, psi[k], times[k], before)


@kernel
def factor_rows(lane, model, drive, par, steps, scheme, r, factors):
    """The factored matrix of each step's end, (rows n_factor,)."""
    m, p, on, room, S = bare(model), bare(par), bare(steps), bare(r), bare(factors)
    n, length, inputs = size(model.n), size(model.n_factor), size(model.n_inputs)
    for k in range(steps.h.shape[0]):
        slopes = slopes_of(scheme, on.h[k])
        own = S[k * length : (k + 1) * length]
        assemble(
            lane, m, p, _state(on, k, n), on.u[k * inputs : (k + 1) * inputs], Weights(slopes.a, slopes.v, 1.0),
            room, own,
        )  # fmt: skip
        note_slip(lane, m, p, _state(on, k, n), slopes.v / slopes.a, room, own)
        take_out_known(lane, m, drive, room, own, True)
        factor(lane, m, own)


@kernel
def _state(on, k, n):
    return State(on.q[k * n : (k + 1) * n], on.v[k * n : (k + 1) * n], on.a[k * n : (k + 1) * n])


@kernel
def tangent_rows(lane, model, drive, steps, scheme, factors, here, ahead, behind, moved, passes, tangent, room, out):
    """out (rows, 2 n) <- what q and v at the steps' ends change by; tangent (4, n) of q, v, a, b: before, then after.

    here, ahead, behind: `Neighbour`s; here is the model itself. moved (rows, motions, 3): what motions change by.
    passes: 1 where the factored matrix is the residual's derivative; where it is nearly so, what is left is solved for
    again. room: 6 n + n_factor numbers.
    """
    m, on, S, space = bare(model), bare(steps), bare(factors), bare(room)
    one, two, three = bare(here), bare(ahead), bare(behind)
    n, length = size(model.n), size(model.n_factor)
    dq, dv, da, db = bare(tangent[0]), bare(tangent[1]), bare(tangent[2]), bare(tangent[3])
    r, start = space[3 * n : 4 * n], space[4 * n : 5 * n]
    am, af = scheme.alpha_m, scheme.alpha_f
    for k in range(steps.h.shape[0]):
        h, slopes, own = on.h[k], slopes_of(scheme, on.h[k]), S[k * length : (k + 1) * length]
        for i in range(n):
            start[i] = dq[i] + h * dv[i] + (h * h * (0.5 - scheme.beta)) * db[i]
            dv[i] = dv[i] + (h * (1.0 - scheme.gamma)) * db[i] - slopes.v * start[i]
            da[i] = (am * db[i] - af * da[i]) * (1.0 / (1.0 - af)) - slopes.a * start[i]
            dq[i] = 0.0
        _know(drive, moved[k], dq, dv, da)
        for _ in range(passes):
            for i in range(n):
                r[i] = 0.0
            _add(lane, one, on, k, dq, dv, da, space, own, r)
            _add(lane, two, on, k, dq, dv, da, space, own, r)
            _add(lane, three, on, k, dq, dv, da, space, own, r)
            take_out_known(lane, m, drive, r, own, False)
            solve(lane, m, own, r)
            weights = Weights(slopes.a, slopes.v, 1.0)
            rub_along(lane, m, one.par, State(dq, dv, da), weights, slopes.v / slopes.a, own, r)
            for i in range(n):
                dq[i] -= r[i]
                dv[i] -= slopes.v * r[i]
                da[i] -= slopes.a * r[i]
        for i in range(n):
            db[i] = (dq[i] - start[i]) * slopes.b
            out[k, i], out[k, n + i] = dq[i], dv[i]
        for i in range(drive.known.shape[0]):
            db[drive.known[i]] = da[drive.known[i]]


@kernel
def _know(drive, moved, dq, dv, da):
    """Tangents of prescribed coordinates."""
    for i in range(drive.known.shape[0]):
        k = drive.known[i]
        dq[k], dv[k], da[k] = moved[i, OF_MOTION.value], moved[i, OF_MOTION.rate], moved[i, OF_MOTION.second]


@kernel
def _add(lane, one, on, k, dq, dv, da, space, matrix, r):
    """r <- r + the weight of a neighbour's residual at the state that is moved along with it; and of what may rub."""
    if one.weight != 0.0:
        n, inputs = size(one.model.n), size(one.model.n_inputs)
        q, v, a, own, S = space[:n], space[n : 2 * n], space[2 * n : 3 * n], space[5 * n : 6 * n], space[6 * n :]
        for i in range(n):
            q[i] = on.q[k * n + i] + one.offset * dq[i]
            v[i] = on.v[k * n + i] + one.offset * dv[i]
            a[i] = on.a[k * n + i] + one.offset * da[i]
        residual(lane, one.model, one.par, State(q, v, a), one.u[k * inputs : (k + 1) * inputs], own, S)
        for i in range(n):
            r[i] += one.weight * own[i]
        bound_along(lane, one.model, one.par, one.weight, matrix)


@kernel
def pose_rows(lane, model, par, q, v, poses):
    """Poses of the links, a row of q and v each; SINGLE only."""
    m, p = bare(model), bare(par)
    for k in range(q.shape[0]):
        link_poses(lane, m, p, bare(q[k]), bare(v[k]), bare(poses[k]))
