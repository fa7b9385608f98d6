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

from ..compiler import kernel, load, size, splat, store
from ..physics.integrator.drive import set_inputs, set_motions
from ..physics.integrator.newton import slopes_of
from ..physics.integrator.step import foresee
from ..physics.integrator.work import copy_rows, state_of, take_out_known, unpack, work_size
from ..physics.joints.friction import change_friction, friction_tangents, note_branch
from ..physics.layout import OF_MOTION
from ..physics.protocol import State, Weights, assemble, difference, factor, link_poses, residual, solve, update


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


@kernel
def room_of(model, par):
    """Numbers that `tangent_rows` works in: a work array of numbers with their tangents, and more."""
    return work_size(2, model, 0) + 6 * size(model.n) + 2 * par.shape[0]


@kernel
def tangent_rows(lane, wide, model, drive, steps, scheme, factors, here, ahead, behind, moved, passes, room, out):
    """out (rows, 2 n) <- what q and v at the steps' ends change by.

    wide: `lane` with a tangent. here, ahead, behind: `Neighbour`s; here is the model itself. moved (rows, motions, 3):
    what motions change by. passes: 1 where the factored matrix is the residual's derivative; where it is nearly so,
    what is left is solved for again. room: of `room_of` numbers, first a work array whose q, v, a and b hold the state,
    each number followed by its tangent: before, then after. A step ends at its prediction moved by what Newton found,
    and v, a and b follow that; rotations are moved by `protocol.update`, on both ways.
    """
    n, length, inputs = size(model.n), size(model.n_factor), size(model.n_inputs)
    w, more = unpack(wide, model, room, 0), room[work_size(2, model, 0) :]
    r, given, dv, da = more[:n], more[n : 2 * n], more[2 * n : 3 * n], more[3 * n : 4 * n]
    d, par = more[4 * n : 6 * n], more[6 * n :]
    for i in range(here.par.shape[0]):
        store(par, i, splat(wide, here.par[i]))
    for k in range(steps.h.shape[0]):
        h, slopes, own = steps.h[k], slopes_of(scheme, steps.h[k]), factors[k * length : (k + 1) * length]
        foresee(wide, model, w, h, scheme)
        copy_rows(wide, n, w.q, w.q0)
        copy_rows(wide, n, w.v, w.v0)
        copy_rows(wide, n, w.a, w.a0)
        copy_rows(wide, n, w.b, w.b0)
        for i in range(n):
            store(w.q, i, splat(wide, steps.q[k * n + i]))
            given[i] = 0.0
        for i in range(drive.known.shape[0]):
            w.q[2 * drive.known[i] + 1] = moved[k, i, OF_MOTION.value]
        for i in range(inputs):
            store(w.u, i, splat(wide, here.u[k * inputs + i]))
        for one in (here, ahead, behind):
            _add_residual(lane, one, steps, k, r, w.S, given)
        for _ in range(passes):
            _follow(wide, model, drive, w, d, slopes, steps, k, moved)
            residual(wide, model, par, state_of(w), w.u, w.r, w.S)
            for i in range(n):
                r[i], dv[i], da[i] = given[i] + w.r[2 * i + 1], w.v[2 * i + 1], w.a[2 * i + 1]
            take_out_known(lane, model, drive, r, own, False)
            solve(lane, model, own, r)
            for one in (here, ahead, behind):
                if one.weight != 0.0:  # what `own` notes of friction changes by a neighbour's, where joints slide
                    change_friction(lane, one.model, one.par, one.weight, own)
            weights = Weights(slopes.a, slopes.v, 1.0)
            friction_tangents(lane, model, State(dv, dv, da), weights, slopes.v / slopes.a, own, r)
            for i in range(n):
                w.r[2 * i], w.r[2 * i + 1] = -0.0, -r[i]
            update(wide, model, w.q, 1.0, w.r, None)
            for i in range(n):
                w.q[2 * i] = steps.q[k * n + i]
        _follow(wide, model, drive, w, d, slopes, steps, k, moved)
        for i in range(n):
            store(w.b, i, load(wide, w.b0, i) + load(wide, d, i) * slopes.b)
            out[k, i], out[k, n + i] = w.q[2 * i + 1], w.v[2 * i + 1]
        for i in range(drive.known.shape[0]):
            j = drive.known[i]
            store(w.b, j, load(wide, w.a, j))


@kernel
def _follow(wide, model, drive, w, d, slopes, on, k, moved):
    """d <- what moves the prediction to q; v and a follow it, their values those of step k."""
    n = size(model.n)
    difference(wide, model, w.q0, w.q, d)
    for i in range(n):
        store(w.v, i, load(wide, w.v0, i) + load(wide, d, i) * slopes.v)
        store(w.a, i, load(wide, w.a0, i) + load(wide, d, i) * slopes.a)
        w.v[2 * i], w.a[2 * i] = on.v[k * n + i], on.a[k * n + i]
    for i in range(drive.known.shape[0]):
        j = 2 * drive.known[i] + 1
        w.v[j], w.a[j] = moved[k, i, OF_MOTION.rate], moved[k, i, OF_MOTION.second]


@kernel
def _add_residual(lane, one, on, k, r, free, given):
    """given <- given + the weight of a neighbour's residual at the state."""
    if one.weight != 0.0:
        n, inputs = size(one.model.n), size(one.model.n_inputs)
        residual(lane, one.model, one.par, _state(on, k, n), one.u[k * inputs : (k + 1) * inputs], r, free)
        for i in range(n):
            given[i] += one.weight * r[i]


@kernel
def pose_rows(lane, model, par, q, v, poses):
    """Poses of the links, a row of q and v each; SINGLE only."""
    for k in range(q.shape[0]):
        link_poses(lane, model, par, q[k], v[k], poses[k])
