"""Consistent velocities, accelerations and multipliers just after a time t at which a load or a motion may jump."""

from __future__ import annotations

from ...compiler import Lanes, kernel, noinline, size, without_tangents
from ..joints.friction import apply_friction, release_reversed_joints, store_friction
from ..layout import DISSIPATED, OF_MOTION, WORK_DONE
from ..protocol import MASS_ALONE, RESIDUAL_ALONE, Weights, assemble, constraint_residual, damping_power
from .drive import set_inputs, set_motions
from .work import (
    Work,
    copy_rows,
    move_multipliers,
    set_prescribed,
    solve_unknown_rows,
    state_of,
    store_reactions,
    unpack,
)

SMALL = 1e-3
"""Damping forces are evaluated at the velocity times SMALL, and the result is divided by SMALL. Forces that are
quadratic in the velocity are then negligible."""


@kernel
def restart(lane, model, drive, par, flat, n_motions, t, h, fresh):
    """Compute consistent velocities, accelerations and multipliers at t+, after loads or motions may have jumped.

    Velocities jump by dv. The jump satisfies M dv + Phi_q^T Lambda = 0, where prescribed rows of dv are known (Phi = 0:
    constraints; Lambda: their impulses). Damping ends a part of dv within much less than a step. The part that damping
    ends is removed from the velocities, and its damping forces change the accelerations. The work and the energy loss
    of the impulses are added to the energy account w.books.

    Accelerations at a fresh start solve M a + Phi_q^T lambda = Q - h(q, v), with generalized loads Q, and b = a. At a
    kink within a run (not fresh, with a drive) accelerations and multipliers are kept, then corrected three times by
    the residual r at t+:

        (M + h/2 C + h^2/4 K) da + Phi_q^T dlambda = -r,

    The difference b - a does not change. If the step resolves the motion, the result agrees with M da = -r to third
    order. With M alone, stresses from strains and strain rates that are too stiff for the step would cause large
    accelerations.

    # model     model. drive: `Drive`, or None (no loads or motions in time, velocities do not jump); par. h: a step, s
    # state     flat: work array `Work` with n_motions prescribed coordinates; q stays, v, a, b and lambda change
    """
    restart_within(lane, model, drive, par, unpack(lane, model, flat, n_motions), t, h, fresh)


@kernel
def _save_accelerations(lane, n, algebraic, w: Work):
    """Store accelerations and multipliers in w.q0 (free between steps) and the difference b - a in w.b.

    n: number of rows. algebraic: rows of multipliers, whose values are in w.q, or None without multipliers.
    """
    for k in range(n):
        a = w.a[k]
        w.q0[k] = a
        w.b[k] -= a
    if algebraic is not None:
        for i in range(algebraic.shape[0]):
            k = algebraic[i]
            w.q0[k] = w.q[k]


@kernel
def _take_multipliers(lane, drive, algebraic, w: Work, fresh):
    """Move the multipliers to w.q from their rows of w.a, into which a solution for accelerations writes them.

    At a kink (with a drive, not fresh) the solution is the change of the multipliers, which is added to their values in
    w.q.
    algebraic: rows of the multipliers; None: nothing to do.
    drive: the scene's loads and motions (`Drive`), or None.
    fresh: True at a fresh start.
    """
    if drive is not None and algebraic is not None and not fresh:
        for i in range(algebraic.shape[0]):
            k = algebraic[i]
            w.a[k] += w.q[k]
    move_multipliers(lane, algebraic, w.q, w.a, False)


@kernel
def _restart_auxiliary_acceleration(lane, n, drive, w: Work, fresh):
    """Set the auxiliary acceleration to b = a; at a kink (with a drive, not fresh) add the difference stored in w.b.

    n: number of rows. drive: the scene's loads and motions (`Drive`), or None. fresh: True at a fresh start. In
    prescribed rows the difference is 0.
    """
    if drive is not None and not fresh:
        for i in range(drive.known.shape[0]):
            k = drive.known[i]
            if k >= 0:
                w.b[k] = 0.0
        for k in range(n):
            w.b[k] += w.a[k]
    else:
        copy_rows(lane, n, w.a, w.b)


@kernel
def _scaled_difference(lane, n, r: Lanes, start: Lanes, scale):
    """Compute r <- (r - start) * scale in n rows."""
    for k in range(n):
        r[k] = (r[k] - start[k]) * scale


@kernel
def _prescribed_rates(lane, drive, w: Work, i):
    """Return the velocities after and before the jump of prescribed motion i, m/s or rad/s.

    The velocity before is row k of w.v0. If a multiplier prescribes the motion (k < 0), it is the rate in w.psi0.
    """
    k, at = drive.known[i], OF_MOTION.end * i + OF_MOTION.rate
    if k >= 0:
        return w.psi[at], w.v0[k]
    return w.psi[at], w.psi0[at]


@kernel
def _account_for_impulse(lane, drive, w: Work, share, scale):
    """Add the work of the impulses w.reaction (N s, N m s), times `scale`, to w.books (J).

    The work is impulse times velocity. The velocity is share * (prescribed velocity before the jump) + (1 - share) *
    (prescribed velocity after the jump).
    drive: `Drive`, which names the prescribed coordinates.
    """
    for i in range(drive.known.shape[0]):
        speed, before = _prescribed_rates(lane, drive, w, i)
        work = (speed + (before - speed) * share) * w.reaction[i] * scale
        w.books[WORK_DONE] += work


@kernel
def _has_velocity_jump(lane, drive, w):
    """Return whether a prescribed velocity jumps by more than round-off (1e-12 of its size); for a single arm."""
    for i in range(drive.known.shape[0]):
        after, before = _prescribed_rates(lane, drive, w, i)
        v1, v0 = without_tangents(after), without_tangents(before)
        if abs(v1 - v0) > 1e-12 * (abs(v1) + abs(v0)):
            return True
    return False


@kernel
def _residual_with_multipliers(lane, model, par, w, weights):
    """Compute the residual w.r (equation [64]) at w.q, w.v, w.a; the multipliers are read from their rows of w.a.

    The multipliers are moved to w.q first. With weights.with_matrix the function also assembles w.S; weights: factors
    of mass, damping and stiffness (`Weights`).
    """
    move_multipliers(lane, model.algebraic, w.q, w.a, False)
    assemble(lane, model, par, state_of(w), w.u, weights, w.r, w.S)


@kernel
def _jump_velocities(lane, model, drive, par, w: Work, h, fresh):
    """Add the velocity jump dv that prescribed motions cause: M dv + Phi_q^T Lambda = 0. h: length of a step, s.

    Phi = 0: constraints.
    Lambda: impulses of the constraints.
    fresh: True at a fresh start, which keeps no accelerations.

    # state     w.v: in and out
    # out       w.v0: v before the jump; w.a0: dv, in rows of multipliers the impulses Lambda; w.reaction; w.books
    # scratch   w.r, w.S, w.a, w.b0

    See docs/theory.md, section 6, "Kinks".
    """
    n = size(model.n)
    for k in range(n):
        w.v0[k] = w.v[k]
        w.v[k] = 0.0
        w.a[k] = 0.0
        w.a0[k] = 0.0
    _residual_with_multipliers(lane, model, par, w, RESIDUAL_ALONE)
    # b0: residual at rest (v = a = 0); what a residual has beyond it is inertia
    copy_rows(lane, n, w.r, w.b0)
    _solve_jump(lane, model, drive, par, w)
    # M dv + Phi_q^T Lambda: its prescribed rows are the impulses of the motions
    _residual_with_multipliers(lane, model, par, w, RESIDUAL_ALONE)
    _scaled_difference(lane, n, w.r, w.b0, 1.0)
    store_reactions(lane, drive.known, model.algebraic, w.r, w.a0, w.reaction)
    # impulse times mean velocity is the kinetic energy that it brings
    _account_for_impulse(lane, drive, w, 0.5, 1.0)
    if _has_velocity_jump(lane, drive, w):
        _remove_damping_layer(lane, model, drive, par, w, h, fresh)
    for k in range(n):
        w.v[k] = w.v0[k] + w.a0[k]
    move_multipliers(lane, model.algebraic, w.v, w.v, True)


@kernel
def _solve_jump(lane, model, drive, par, w: Work):
    """Solve M dv + Phi_q^T Lambda = 0 for the velocity jump dv (m/s, rad/s), whose prescribed rows are known.

    # in        w.v0: v before the jump; w.b0: residual at rest; w.psi, w.psi0: motions after and before
    # out       w.a0 and w.a: dv, with Lambda in rows of multipliers; w.v = 0
    # scratch   w.r, w.S

    See docs/theory.md, section 6, "Kinks".
    """
    n = size(model.n)
    for i in range(drive.known.shape[0]):
        k = drive.known[i]
        if k >= 0:
            after, before = _prescribed_rates(lane, drive, w, i)
            w.a0[k] = after - before
    # r <- M dv of the prescribed part, and S = M
    copy_rows(lane, n, w.a0, w.a)
    move_multipliers(lane, model.algebraic, w.a, w.a, True)
    _residual_with_multipliers(lane, model, par, w, MASS_ALONE)
    _scaled_difference(lane, n, w.r, w.b0, 1.0)
    for k in range(n):
        # Phi' (level 1) at v + dv of the prescribed rows
        w.v[k] = w.v0[k] + w.a0[k]
    constraint_residual(lane, model, w.psi, state_of(w), 1, 1.0, w.r)
    solve_unknown_rows(lane, model, drive, w, True)
    for k in range(n):
        # known part less S^-1 r
        dv = w.a0[k] - w.r[k]
        w.v[k] = 0.0
        w.a0[k] = dv
        w.a[k] = dv


@kernel
def _remove_damping_layer(lane, model, drive, par, w: Work, h, fresh):
    """Remove from the velocity jump dv the part e that damping ends in much less than a step of h (s).

    Within the material, damping prevents a jump of the velocity. With M alone the jump remains next to a prescribed
    coordinate; damping spreads it in a time that may be far below a step. Without the removal, the step and its energy
    account would apply the forces C dv for half of the step. Let s = (M + h/2 C)^-1 M, with prescribed coordinates at
    rest and Phi_q s = 0. The function subtracts from dv the part

        e = (1 - s)^3 (1 + 3 s) dv,

    To order h^3, e is the part that damping ends within the step, and 0 without damping. The vector y = (1 - s) x is
    the solution of (M + h/2 C) y + Phi_q^T mu = h/2 C x.

    M, C: mass and damping matrix.
    mu: multipliers of the constraints Phi = 0. The impulse of damping is h/2 C (g - e), where g has one factor (1 - s)
    less than e. It acts at the prescribed velocities after the jump. Unless fresh, the accelerations and multipliers
    stored in w.q0 change by -M^-1 C (dv - e), a sum of the same solutions.

    # state     w.a0: in, dv; out, dv - e.   w.books: work and loss are added.   w.q0 (unless fresh): in and out
    # out       w.reaction: impulses of the motions (N s, N m s), times SMALL.   # scratch  w.r, w.S, w.v, w.a

    See docs/theory.md, section 6, "Kinks".
    """
    n, part = size(model.n), 0.5 * h * SMALL
    for k in range(n):
        w.r[k] = w.a0[k]
        w.a[k] = 0.0
    move_multipliers(lane, model.algebraic, w.q, w.a, False)
    damping_layer(lane, model, drive, par, w, w.b0, h, fresh)
    for k in range(n):
        # v <- part (g - e); a <- -SMALL e: both small, so that forces of their squares vanish
        e, dv = w.r[k], w.a0[k]
        w.v[k] -= e * part
        w.a[k] = e * -SMALL
        # v_0 + dv - e/2: the layer's damping dissipates its impulse times this mean
        w.r[k] = w.v0[k] + dv - e * 0.5
        w.a0[k] = dv - e
    move_multipliers(lane, model.algebraic, w.v, w.v, True)
    taken = damping_power(lane, model, par, w.q, w.v, w.r) / SMALL
    w.books[DISSIPATED] += taken
    # impulses of the motions: h/2 C (g - e) - M e, times SMALL
    _residual_with_multipliers(lane, model, par, w, RESIDUAL_ALONE)
    _scaled_difference(lane, n, w.r, w.b0, 1.0)
    store_reactions(lane, drive.known, model.algebraic, w.r, w.q, w.reaction)
    _account_for_impulse(lane, drive, w, 0.0, 1.0 / SMALL)


@kernel
def damping_layer(lane, model, drive, par, w: Work, rest, h, fresh):
    """Compute w.r <- e = (1 - s)^3 (1 + 3 s) dv, the part of a velocity jump dv that damping ends within a step.

    s = (M + h/2 C)^-1 M, with the mass matrix M and the damping matrix C.
    h: length of a step, s. Unless fresh, the jump of accelerations is added to w.q0.

    # in        w.r: dv; w.a = 0; rest: residual at rest (v = a = 0), n rows
    # out       w.r: e; w.v: SMALL h/2 g, g = (1 - s)^2 (1 + 3 s) dv
    # scratch   w.S

    See docs/theory.md, section 6, "Kinks".
    """
    n, part = size(model.n), 0.5 * h * SMALL
    for k in range(n):
        w.v[k] = w.r[k] * part
    # r <- (1 - s) dv
    _damp_layer(lane, model, drive, par, w, rest, h, True, fresh, 1.0)
    for k in range(n):
        w.v[k] = w.r[k] * part
    # r <- (1 - s)^2 dv
    _damp_layer(lane, model, drive, par, w, rest, h, False, fresh, -3.0)
    for k in range(n):
        # (1 - s) (1 + 3 s) dv = 4 (1 - s) dv - 3 (1 - s)^2 dv
        w.v[k] = w.v[k] * 4.0 - w.r[k] * (3.0 * part)
    # r <- g
    _damp_layer(lane, model, drive, par, w, rest, h, False, fresh, 1.0)
    for k in range(n):
        w.v[k] = w.r[k] * part
    # r <- e
    _damp_layer(lane, model, drive, par, w, rest, h, False, fresh, 1.0)


@kernel
def _damp_layer(lane, model, drive, par, w: Work, rest, h, matrix, fresh, share):
    """Compute w.r <- y = (1 - s) x from (M + h/2 C) y + Phi_q^T mu = h/2 C x; w.v contains SMALL h/2 x (m/s, rad/s).

    s = (M + h/2 C)^-1 M.
    M, C: mass and damping matrix.
    mu: multipliers of the constraints Phi = 0.
    h: length of a step, s.
    matrix: if True, first assemble and factor M + h/2 C in w.S; if False, use the factors in w.S.
    rest: residual at rest (v = a = 0). Unless fresh, the accelerations in w.q0 change by -share 2/h (1 - s) x, a part
    of M^-1 C (dv - e).
    """
    move_multipliers(lane, model.algebraic, w.v, w.v, True)
    assemble(lane, model, par, state_of(w), w.u, Weights(1.0, 0.5 * h, 0.0, with_matrix=matrix), w.r, w.S)
    # h/2 C x: residual at the small velocity less that at rest, over SMALL
    _scaled_difference(lane, size(model.n), w.r, rest, 1.0 / SMALL)
    move_multipliers(lane, model.algebraic, w.r, w.r, True)
    solve_unknown_rows(lane, model, drive, w, matrix)
    if not fresh:
        for k in range(size(model.n)):
            w.q0[k] -= w.r[k] * (2.0 * share / h)


@noinline
def restart_within(lane, model, drive, par, w: Work, t, h, fresh):
    """Compute consistent v, a, b and multipliers at t+ on the work array w, after loads or motions may have jumped.

    Velocities jump with prescribed motions. A fresh start solves M a = Q - h(q, v) and sets b = a. At a kink (not
    fresh, with a drive) a and the multipliers are kept and corrected, and b keeps its difference from a. For the
    equations see `restart`.

    # model     model. drive: `Drive`, or None (no loads or motions in time, velocities do not jump); par. h: a step, s
    # state     w.v, w.a, w.b and multipliers in w.q are changed; w.u, w.psi <- values at t+; w.u0, w.reaction, w.books
    # scratch   w.r, w.S, w.q0, w.v0, w.a0, w.b0, w.psi0

    See docs/theory.md, section 6, "Kinks".
    """
    n = size(model.n)
    times, half = 1, 0.0
    if drive is not None and not fresh:
        # u0 <- inputs before the jump; entries that are set from outside hold theirs already
        for i in range(drive.entries.shape[0]):
            w.u0[drive.entries[i]] = w.u[drive.entries[i]]
    # T of friction before the jump (it decides which joints slide), then u, psi and v after it
    store_friction(lane, model, par, state_of(w), w.u0, w.r, w.S)
    if drive is not None:
        if not fresh:
            _save_accelerations(lane, n, model.algebraic, w)
            times, half = 3, 0.5 * h
        copy_rows(lane, OF_MOTION.end * drive.known.shape[0], w.psi, w.psi0)
        set_inputs(lane, drive, w.u, t, t + 1e-6 * h)
        set_motions(lane, drive, w.psi, t, t + 1e-6 * h)
        _jump_velocities(lane, model, drive, par, w, h, fresh)
        release_reversed_joints(lane, model, w.v, w.S)
    for k in range(n):
        # a = 0: a fresh start solves M a = -r; a kink corrects the a saved in q0
        w.a[k] = 0.0
    move_multipliers(lane, model.algebraic, w.q, w.a, False)
    if drive is not None:
        if not fresh:
            copy_rows(lane, n, w.q0, w.a)
            move_multipliers(lane, model.algebraic, w.q, w.q0, False)
            move_multipliers(lane, model.algebraic, w.a, w.a, True)
        set_prescribed(lane, drive.known, w.psi, w.q, w.v, w.a, w.b)
    for i in range(times):
        matrix = i == 0
        # S = M, or M + h/2 C + h^2/4 K at a kink; a <- a - S^-1 r
        weights = Weights(1.0, half, half * half, with_matrix=matrix)
        assemble(lane, model, par, state_of(w), w.u, weights, w.r, w.S)
        constraint_residual(lane, model, w.psi, state_of(w), 2, 1.0, w.r)
        solve_unknown_rows(lane, model, drive, w, matrix)
        # Coulomb friction (6.6) for rates w = v + h/2 a, half a step ahead
        apply_friction(lane, model, par, state_of(w), MASS_ALONE, 0.5 * h, w.S, w.r)
        for k in range(n):
            w.a[k] -= w.r[k]
        _take_multipliers(lane, drive, model.algebraic, w, fresh)
        move_multipliers(lane, model.algebraic, w.a, w.a, True)
    _restart_auxiliary_acceleration(lane, n, drive, w, fresh)
    if drive is not None:
        # reactions at t+ (N, N m): r of prescribed rows, or their lambda
        assemble(lane, model, par, state_of(w), w.u, RESIDUAL_ALONE, w.r, w.S)
        store_reactions(lane, drive.known, model.algebraic, w.r, w.q, w.reaction)
        copy_rows(lane, size(model.n_inputs), w.u, w.u0)
