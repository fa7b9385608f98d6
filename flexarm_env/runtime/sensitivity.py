"""How a run of one arm changes with a number that its model was made from, by the implicit function theorem.

A step ends where r(q, v, a; theta) = 0, with v and a that follow from q and the step's start. What r changes by with
theta is a difference between models that were made with theta a little larger and smaller, at the state as it is; what
it changes by with that state is one residual in dual lanes; then S dq = -dr with the matrix of the step's end. No
difference is taken of what was iterated, nor along a motion, so that steps of 1e-5 of theta leave errors of 1e-9
however far the arm has gone. What rubs (Coulomb) slips or sticks as it did.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ..compiler import bare, kernel, size, splat, store
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
def drive_rows(lane, drive, times, h, u, psi):
    """Inputs (rows, inputs) and a `MOTION` for each prescribed coordinate (rows, ...) at the ends of steps."""
    driven = bare(drive)
    for k in range(times.shape[0]):
        before = times[k] - 1e-6 * h[k]
        set_inputs(lane, driven, u[k], times[k], before)
        set_motions(lane, driven, psi[k], times[k], before)


@kernel
def factor_rows(lane, model, drive, par, steps, scheme, r, factors):
    """The factored matrix of each step's end, (rows n_factor,)."""
    m, driven, p, on, room, S = bare(model), bare(drive), bare(par), bare(steps), bare(r), bare(factors)
    n, length, inputs = size(model.n), size(model.n_factor), size(model.n_inputs)
    for k in range(steps.h.shape[0]):
        slopes = slopes_of(scheme, on.h[k])
        own = S[k * length : (k + 1) * length]
        assemble(
            lane, m, p, _state(on, k, n), on.u[k * inputs : (k + 1) * inputs], Weights(slopes.a, slopes.v, 1.0),
            room, own,
        )  # fmt: skip
        note_slip(lane, m, p, _state(on, k, n), slopes.v / slopes.a, room, own)
        take_out_known(lane, m, driven, room, own, True)
        factor(lane, m, own)


@kernel
def _state(on, k, n):
    return State(on.q[k * n : (k + 1) * n], on.v[k * n : (k + 1) * n], on.a[k * n : (k + 1) * n])


def room_of(model, par):
    """Numbers that `tangent_rows` works in."""
    return 11 * int(size(model.n)) + 2 * (int(size(model.n_inputs)) + len(par) + int(size(model.n_factor)))


@kernel
def tangent_rows(
    lane, wide, model, drive, steps, scheme, factors, here, ahead, behind, moved, passes, tangent, room, out
):
    """out (rows, 2 n) <- what q and v at the steps' ends change by; tangent (4, n) of q, v, a, b: before, then after.

    wide: `lane` with a tangent. here, ahead, behind: `Neighbour`s; here is the model itself. moved (rows, motions, 3):
    what motions change by. passes: 1 where the factored matrix is the residual's derivative; where it is nearly so,
    what is left is solved for again. room: `room_of`.
    """
    m, driven, on, S, space = bare(model), bare(drive), bare(steps), bare(factors), bare(room)
    one, two, three = bare(here), bare(ahead), bare(behind)
    n, length, inputs = size(model.n), size(model.n_factor), size(model.n_inputs)
    dq, dv, da, db = bare(tangent[0]), bare(tangent[1]), bare(tangent[2]), bare(tangent[3])
    r, start, given = space[:n], space[n : 2 * n], space[2 * n : 3 * n]
    q, v, a, both = space[3 * n : 5 * n], space[5 * n : 7 * n], space[7 * n : 9 * n], space[9 * n : 11 * n]
    u, par = space[11 * n : 11 * n + 2 * inputs], space[11 * n + 2 * inputs :]
    free = par[2 * here.par.shape[0] :]
    for i in range(here.par.shape[0]):
        store(par, i, splat(wide, one.par[i]))
    am, af = scheme.alpha_m, scheme.alpha_f
    for k in range(steps.h.shape[0]):
        h, slopes, own = on.h[k], slopes_of(scheme, on.h[k]), S[k * length : (k + 1) * length]
        for i in range(n):
            start[i] = dq[i] + h * dv[i] + (h * h * (0.5 - scheme.beta)) * db[i]
            dv[i] = dv[i] + (h * (1.0 - scheme.gamma)) * db[i] - slopes.v * start[i]
            da[i] = (am * db[i] - af * da[i]) * (1.0 / (1.0 - af)) - slopes.a * start[i]
            dq[i], given[i] = 0.0, 0.0
        _know(driven, moved[k], dq, dv, da)
        for i in range(inputs):
            store(u, i, splat(wide, one.u[k * inputs + i]))
        _add(lane, one, on, k, r, free, given)
        _add(lane, two, on, k, r, free, given)
        _add(lane, three, on, k, r, free, given)
        for _ in range(passes):
            for i in range(n):
                q[2 * i], v[2 * i], a[2 * i] = on.q[k * n + i], on.v[k * n + i], on.a[k * n + i]
                q[2 * i + 1], v[2 * i + 1], a[2 * i + 1] = dq[i], dv[i], da[i]
            residual(wide, m, par, State(q, v, a), u, both, free)
            for i in range(n):
                r[i] = given[i] + both[2 * i + 1]
            take_out_known(lane, m, driven, r, own, False)
            solve(lane, m, own, r)
            _bound(lane, one, own)
            _bound(lane, two, own)
            _bound(lane, three, own)
            weights = Weights(slopes.a, slopes.v, 1.0)
            rub_along(lane, m, one.par, State(dq, dv, da), weights, slopes.v / slopes.a, own, r)
            for i in range(n):
                dq[i] -= r[i]
                dv[i] -= slopes.v * r[i]
                da[i] -= slopes.a * r[i]
        for i in range(n):
            db[i] = (dq[i] - start[i]) * slopes.b
            out[k, i], out[k, n + i] = dq[i], dv[i]
        for i in range(driven.known.shape[0]):
            db[driven.known[i]] = da[driven.known[i]]


@kernel
def _know(drive, moved, dq, dv, da):
    """Tangents of prescribed coordinates."""
    for i in range(drive.known.shape[0]):
        k = drive.known[i]
        dq[k], dv[k], da[k] = moved[i, OF_MOTION.value], moved[i, OF_MOTION.rate], moved[i, OF_MOTION.second]


@kernel
def _add(lane, one, on, k, r, free, given):
    """given <- given + the weight of a neighbour's residual at the state."""
    if one.weight != 0.0:
        n, inputs = size(one.model.n), size(one.model.n_inputs)
        residual(lane, one.model, one.par, _state(on, k, n), one.u[k * inputs : (k + 1) * inputs], r, free)
        for i in range(n):
            given[i] += one.weight * r[i]


@kernel
def _bound(lane, one, matrix):
    """Likewise of what may rub."""
    if one.weight != 0.0:
        bound_along(lane, one.model, one.par, one.weight, matrix)


@kernel
def pose_rows(lane, model, par, q, v, poses):
    """Poses of the links, a row of q and v each; SINGLE only."""
    m, p = bare(model), bare(par)
    for k in range(q.shape[0]):
        link_poses(lane, m, p, bare(q[k]), bare(v[k]), bare(poses[k]))
