"""How a run of one arm changes with a number that its model was made from, by the implicit function theorem.

A step ends where r(q, v, a; theta) = 0, with v and a that follow from q and the step's start. What r changes by with
theta is a difference between models that were made with theta a little larger and smaller, at the state as it is; what
it changes by with that state is one residual in dual lanes; then S dq = -dr with the matrix of the step's end. No
difference is taken of what was iterated, nor along a motion, so that steps of 1e-5 of theta leave errors of 1e-9
however far the arm has gone. Joints with Coulomb friction slide or stick as they did.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ..compiler import kernel, size, splat, store
from ..physics.integrator.drive import set_inputs, set_motions
from ..physics.integrator.newton import slopes_of
from ..physics.integrator.work import take_out_known
from ..physics.joints.friction import change_friction, friction_tangents, note_branch
from ..physics.layout import OF_MOTION
from ..physics.protocol import (
    State,
    Weights,
    assemble,
    factor,
    link_poses,
    residual,
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
    for k in range(times.shape[0]):
        before = times[k] - 1e-6 * h[k]
        set_inputs(lane, drive, u[k], times[k], before)
        set_motions(lane, drive, psi[k], times[k], before)


@kernel
def factor_rows(lane, model, drive, par, steps, scheme, r, factors):
    """The factored matrix of each step's end, (rows n_factor,)."""
    n, length, inputs = size(model.n), size(model.n_factor), size(model.n_inputs)
    for k in range(steps.h.shape[0]):
        slopes = slopes_of(scheme, steps.h[k])
        own = factors[k * length : (k + 1) * length]
        state, weights = _state(steps, k, n), Weights(slopes.a, slopes.v, 1.0)
        assemble(lane, model, par, state, steps.u[k * inputs : (k + 1) * inputs], weights, r, own)
        take_out_known(lane, model, drive, r, own, True)
        factor(lane, model, own)
        note_branch(lane, model, par, state, weights, slopes.v / slopes.a, r, own)


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
    n, length, inputs = size(model.n), size(model.n_factor), size(model.n_inputs)
    dq, dv, da, db = tangent[0], tangent[1], tangent[2], tangent[3]
    r, start, given = room[:n], room[n : 2 * n], room[2 * n : 3 * n]
    q, v, a, both = room[3 * n : 5 * n], room[5 * n : 7 * n], room[7 * n : 9 * n], room[9 * n : 11 * n]
    u, par = room[11 * n : 11 * n + 2 * inputs], room[11 * n + 2 * inputs :]
    free = par[2 * here.par.shape[0] :]
    for i in range(here.par.shape[0]):
        store(par, i, splat(wide, here.par[i]))
    am, af = scheme.alpha_m, scheme.alpha_f
    for k in range(steps.h.shape[0]):
        h, slopes, own = steps.h[k], slopes_of(scheme, steps.h[k]), factors[k * length : (k + 1) * length]
        for i in range(n):
            start[i] = dq[i] + h * dv[i] + (h * h * (0.5 - scheme.beta)) * db[i]
            dv[i] = dv[i] + (h * (1.0 - scheme.gamma)) * db[i] - slopes.v * start[i]
            da[i] = (am * db[i] - af * da[i]) * (1.0 / (1.0 - af)) - slopes.a * start[i]
            dq[i], given[i] = 0.0, 0.0
        _know(drive, moved[k], dq, dv, da)
        for i in range(inputs):
            store(u, i, splat(wide, here.u[k * inputs + i]))
        _add(lane, here, steps, k, r, free, given)
        _add(lane, ahead, steps, k, r, free, given)
        _add(lane, behind, steps, k, r, free, given)
        for _ in range(passes):
            for i in range(n):
                q[2 * i], v[2 * i], a[2 * i] = steps.q[k * n + i], steps.v[k * n + i], steps.a[k * n + i]
                q[2 * i + 1], v[2 * i + 1], a[2 * i + 1] = dq[i], dv[i], da[i]
            residual(wide, model, par, State(q, v, a), u, both, free)
            for i in range(n):
                r[i] = given[i] + both[2 * i + 1]
            take_out_known(lane, model, drive, r, own, False)
            solve(lane, model, own, r)
            _bound(lane, here, own)
            _bound(lane, ahead, own)
            _bound(lane, behind, own)
            weights = Weights(slopes.a, slopes.v, 1.0)
            friction_tangents(lane, model, State(dq, dv, da), weights, slopes.v / slopes.a, own, r)
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
def _add(lane, one, on, k, r, free, given):
    """given <- given + the weight of a neighbour's residual at the state."""
    if one.weight != 0.0:
        n, inputs = size(one.model.n), size(one.model.n_inputs)
        residual(lane, one.model, one.par, _state(on, k, n), one.u[k * inputs : (k + 1) * inputs], r, free)
        for i in range(n):
            given[i] += one.weight * r[i]


@kernel
def _bound(lane, one, matrix):
    """Likewise of the friction of joints that slide."""
    if one.weight != 0.0:
        change_friction(lane, one.model, one.par, one.weight, matrix)


@kernel
def pose_rows(lane, model, par, q, v, poses):
    """Poses of the links, a row of q and v each; SINGLE only."""
    for k in range(q.shape[0]):
        link_poses(lane, model, par, q[k], v[k], poses[k])
