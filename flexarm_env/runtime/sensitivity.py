"""Derivative of one arm's run by a parameter theta of its model, by the implicit function theorem.

The state at the end of a step satisfies r(q, v, a; theta) = 0, where v and a follow from q and from the state at the
start of the step. dr/dtheta is a finite difference of the residuals of models with slightly larger and smaller theta,
at the same state. dr/dstate is evaluated in lanes with tangents. The tangent dq solves S dq = -dr with the matrix S at
the end of the step. Results of iterations and prescribed motions of two runs are never subtracted from each other.
Therefore relative offsets of theta of 1e-5 cause errors of only 1e-9, however far the arm has moved. Joints with
Coulomb friction keep sliding or sticking as in the run.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ..compiler import kernel, load, size, splat, store
from ..physics.integrator.drive import set_inputs, set_motions
from ..physics.integrator.newton import newmark_slopes
from ..physics.integrator.step import newmark_predict
from ..physics.integrator.work import copy_rows, remove_known_rows, state_of, unpack, work_size
from ..physics.joints.friction_derivatives import change_friction, friction_tangents, store_branch
from ..physics.layout import OF_MOTION
from ..physics.protocol import State, Weights, assemble, factor, link_poses, local_difference, residual, retract, solve


class Neighbour(NamedTuple):
    """Model of the arm with the parameter theta + offset.

    The residual of this model enters the derivative with the factor `weight`.
    """

    model: Any
    par: np.ndarray  # the arm's own parameters
    u: np.ndarray  # (rows inputs,): inputs at the ends of the steps, N m and N
    offset: float  # offset of theta, in theta's unit
    weight: float  # coefficient in the difference formula, 1 / unit of theta


class Steps(NamedTuple):
    """The steps of a run, one step per row: states and inputs at the ends of the steps, and lengths of the steps."""

    q: np.ndarray  # (rows n,) coordinates, m and rad
    v: np.ndarray  # (rows n,) velocities, m/s and rad/s
    a: np.ndarray  # (rows n,) accelerations, m/s^2 and rad/s^2
    u: np.ndarray  # (rows inputs,) inputs, N m and N
    h: np.ndarray  # (rows,) step lengths, s


@kernel
def drive_rows(lane, drive, times, h, u, psi):
    """Write inputs u (rows, inputs) and prescribed motions psi (rows, motions, `MOTION`) at the ends of steps.

    times, h (rows,): ends and lengths of the steps, s. At a kink the values before the kink are written.
    """
    for k in range(times.shape[0]):
        before = times[k] - 1e-6 * h[k]
        set_inputs(lane, drive, u[k], times[k], before)
        set_motions(lane, drive, psi[k], times[k], before)


@kernel
def factor_rows(lane, model, drive, par, steps, scheme, r, factors):
    """Write the factored Newton matrix of each step's end into factors (rows, n_factor).

    # in        steps, states and inputs;  par, the arm's own parameters
    # scratch   r (n,)
    The sliding or sticking of joints with Coulomb friction is stored with the factors.
    """
    n, length, inputs = size(model.n), size(model.n_factor), size(model.n_inputs)
    for k in range(steps.h.shape[0]):
        slopes = newmark_slopes(scheme, steps.h[k])
        own = factors[k * length : (k + 1) * length]
        state, weights = _state(steps, k, n), Weights(slopes.a, slopes.v, 1.0, newton_share=1.0)
        assemble(lane, model, par, state, steps.u[k * inputs : (k + 1) * inputs], weights, r, own)
        remove_known_rows(lane, model, drive, r, own, True)
        factor(lane, model, own)
        store_branch(lane, model, par, state, weights, slopes.v / slopes.a, r, own)


@kernel
def _state(on, k, n):
    """Return the `State` in row k of `on`, a `Steps` record with n coordinates."""
    return State(on.q[k * n : (k + 1) * n], on.v[k * n : (k + 1) * n], on.a[k * n : (k + 1) * n])


@kernel
def room_of(model, par):
    """Return the length of the scratch array of `tangent_rows`."""
    return work_size(2, model, 0) + 6 * size(model.n) + 2 * par.shape[0]


@kernel
def tangent_rows(lane, wide, model, drive, steps, scheme, factors, here, ahead, behind, moved, passes, room, out):
    """Write the derivatives of q and v at the steps' ends by theta into out (rows, 2 n).

    wide: the lanes of `lane` with one tangent. here, ahead, behind: `Neighbour` records (models) with unchanged, larger
    and smaller theta. steps: the run's steps, a `Steps`. factors: factored matrices from `factor_rows`. moved (rows,
    motions, 3): derivatives of the prescribed motions by theta. passes: number of solutions per step; 1 suffices if the
    factored matrix is the exact derivative of the residual. Each further solution reduces the remaining error.
    # in, out   room: `room_of` numbers of scratch, first a `Work` whose q, v, a, b hold the state and its tangents
    The state at the end of a step is the prediction plus Newton's increment, with changes of v, a and b in proportion.
    Rotations are updated by `protocol.retract`.
    """
    n, length, inputs = size(model.n), size(model.n_factor), size(model.n_inputs)
    w, more = unpack(wide, model, room, 0), room[work_size(2, model, 0) :]
    # dual numbers d of n rows; par with tangents 0, because given <- dr/dtheta is added apart
    r, given, dv, da = more[:n], more[n : 2 * n], more[2 * n : 3 * n], more[3 * n : 4 * n]
    d, par = more[4 * n : 6 * n], more[6 * n :]
    for i in range(here.par.shape[0]):
        store(par, i, splat(wide, here.par[i]))
    for k in range(steps.h.shape[0]):
        h, slopes, own = steps.h[k], newmark_slopes(scheme, steps.h[k]), factors[k * length : (k + 1) * length]
        # prediction (6.1) with the tangents of q, v, a, b at the step's start
        newmark_predict(wide, model, w, h, scheme)
        copy_rows(wide, n, w.q, w.q0)
        copy_rows(wide, n, w.v, w.v0)
        copy_rows(wide, n, w.a, w.a0)
        copy_rows(wide, n, w.b, w.b0)
        # q at the step's end is known; its tangent is sought, at first 0 except for prescribed rows
        for i in range(n):
            store(w.q, i, splat(wide, steps.q[k * n + i]))
            given[i] = 0.0
        for i in range(drive.known.shape[0]):
            w.q[2 * drive.known[i] + 1] = moved[k, i, OF_MOTION.value]
        for i in range(inputs):
            store(w.u, i, splat(wide, here.u[k * inputs + i]))
        # given <- dr/dtheta at fixed state
        for one in (here, ahead, behind):
            _add_residual(lane, one, steps, k, r, w.S, given)
        # dr by the state's tangents, then S dq = -(given + dr)
        for _ in range(passes):
            _follow(wide, model, drive, w, d, slopes, steps, k, moved)
            residual(wide, model, par, state_of(w), w.u, w.r, w.S)
            for i in range(n):
                r[i], dv[i], da[i] = given[i] + w.r[2 * i + 1], w.v[2 * i + 1], w.a[2 * i + 1]
            remove_known_rows(lane, model, drive, r, own, False)
            solve(lane, model, own, r)
            # joints that slide: T = +-T_C(theta) changes as well; W = S^-1 e_i is stored with the factors
            for one in (here, ahead, behind):
                if one.weight != 0.0:
                    change_friction(lane, one.model, one.par, one.weight, own)
            weights = Weights(slopes.a, slopes.v, 1.0, newton_share=1.0)
            friction_tangents(lane, model, State(dv, dv, da), weights, slopes.v / slopes.a, own, r)
            # move q by the solution: tangents change, values are those of the step
            for i in range(n):
                w.r[2 * i], w.r[2 * i + 1] = -0.0, -r[i]
            retract(wide, model, w.q, 1.0, w.r, None)
            for i in range(n):
                w.q[2 * i] = steps.q[k * n + i]
        # dv, da follow dq by (6.1); b for the next step
        _follow(wide, model, drive, w, d, slopes, steps, k, moved)
        for i in range(n):
            store(w.b, i, load(wide, w.b0, i) + load(wide, d, i) * slopes.b)
            out[k, i], out[k, n + i] = w.q[2 * i + 1], w.v[2 * i + 1]
        # prescribed rows: b = a
        for i in range(drive.known.shape[0]):
            j = drive.known[i]
            store(w.b, j, load(wide, w.a, j))


@kernel
def _follow(wide, model, drive, w, d, slopes, on, k, moved):
    """Set v and a in lanes with tangents from the increment d between the prediction and q in step k.

    Tangents follow d, v = v_p + slopes.v d and a = a_p + slopes.a d. d (n,) is written. moved: derivatives of the
    prescribed motions by theta, for the prescribed rows.
    """
    n = size(model.n)
    local_difference(wide, model, w.q0, w.q, d)
    for i in range(n):
        store(w.v, i, load(wide, w.v0, i) + load(wide, d, i) * slopes.v)
        store(w.a, i, load(wide, w.a0, i) + load(wide, d, i) * slopes.a)
        w.v[2 * i], w.a[2 * i] = on.v[k * n + i], on.a[k * n + i]
    for i in range(drive.known.shape[0]):
        j = 2 * drive.known[i] + 1
        w.v[j], w.a[j] = moved[k, i, OF_MOTION.rate], moved[k, i, OF_MOTION.second]


@kernel
def _add_residual(lane, one, on, k, r, free, given):
    """Compute a model's residual for another theta in the state of row k; add it, times weight, to given (n,).

    r, free: scratch memory for residual and matrix.
    """
    if one.weight != 0.0:
        n, inputs = size(one.model.n), size(one.model.n_inputs)
        residual(lane, one.model, one.par, _state(on, k, n), one.u[k * inputs : (k + 1) * inputs], r, free)
        for i in range(n):
            given[i] += one.weight * r[i]


@kernel
def pose_rows(lane, model, par, q, v, poses):
    """Write the link poses (`physics.layout.POSES`, inertial axes) of each row of q and v; SINGLE lane only.

    # in        q, v (rows, n), m, rad and rates
    # out       poses (rows, links POSES): positions (m) and angles (rad) of each link's root and tip, and their rates
    """
    for k in range(q.shape[0]):
        link_poses(lane, model, par, q[k], v[k], poses[k])
