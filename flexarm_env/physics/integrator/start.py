"""A consistent start at t+: velocities, accelerations and multipliers where a load or a motion may have jumped."""

from __future__ import annotations

from ...compiler import alone, apart, kernel, load, size, splat, store
from ..joints.friction import apply_friction, note_friction, turn_round
from ..layout import DISSIPATED, OF_MOTION, WORK_DONE
from ..protocol import MASS_ALONE, RESIDUAL_ALONE, Weights, assemble, constrain, damping_work
from .drive import set_inputs, set_motions
from .work import copy_rows, move_multipliers, note_reactions, set_known, solve_known, state_of, unpack

SMALL = 1e-3
"""Share of a velocity at which the damping of all of it is asked for, so that forces of its square do not count."""


@kernel
def restart(lane, model, drive, par, flat, n_motions, t, h, fresh):
    """Consistent velocities, accelerations and multipliers at t+, where a load or motion may have jumped.

    First velocities: they jump by dv, M dv + Phi_q^T Lambda = 0, with the prescribed part known. The part of dv that
    damping ends within much less than a step is taken out again (`_pass_layer`), and accelerations that are kept get
    what its forces do to them. Work and loss of the impulses go to the books.

    Then accelerations. A fresh start solves M a + Phi_q^T lambda = Q - h(q, v), and b = a. At a kink within a run (not
    fresh, with a drive) accelerations and multipliers are kept and corrected three times by the residual r at t+,

        (M + h/2 C + h^2/4 K) da + Phi_q^T dlambda = -r,

    and b keeps its distance from a. Where the step resolves the motion that is M da = -r, to third order; solved with M
    alone, the stress of strains and strain rates too stiff for the step would make accelerations large. h: a step.
    """
    restart_within(lane, model, drive, par, unpack(lane, model, flat, n_motions), t, h, fresh)


@kernel
def _keep(lane, n, algebraic, w):
    """Accelerations and multipliers to q0, which is free between steps; to b its distance from a."""
    for k in range(n):
        a = load(lane, w.a, k)
        store(w.q0, k, a)
        store(w.b, k, load(lane, w.b, k) - a)
    if algebraic is not None:
        for i in range(algebraic.shape[0]):
            k = algebraic[i]
            store(w.q0, k, load(lane, w.q, k))


@kernel
def _take_multipliers(lane, drive, algebraic, w, fresh):
    """Multipliers from where the accelerations were solved for: the new ones, or what is added to those kept."""
    if drive is not None and algebraic is not None and not fresh:
        for i in range(algebraic.shape[0]):
            k = algebraic[i]
            store(w.a, k, load(lane, w.a, k) + load(lane, w.q, k))
    move_multipliers(lane, algebraic, w.q, w.a, False)


@kernel
def _set_b(lane, n, drive, w, fresh):
    """b = a, or at the distance that was kept; prescribed coordinates have none."""
    if drive is not None and not fresh:
        for i in range(drive.known.shape[0]):
            k = drive.known[i]
            if k >= 0:
                store(w.b, k, splat(lane, 0.0))
        for k in range(n):
            store(w.b, k, load(lane, w.b, k) + load(lane, w.a, k))
    else:
        copy_rows(lane, n, w.a, w.b)


@kernel
def _less(lane, n, r, start, scale):
    """r <- (r - start) scale."""
    for k in range(n):
        store(r, k, (load(lane, r, k) - load(lane, start, k)) * scale)


@kernel
def _rates(lane, drive, w, i):
    """Prescribed velocity i after the jump and before it."""
    k, at = drive.known[i], OF_MOTION.end * i + OF_MOTION.rate
    if k >= 0:
        return load(lane, w.psi, at), load(lane, w.v0, k)
    return load(lane, w.psi, at), load(lane, w.psi0, at)


@kernel
def _book_impulse(lane, drive, w, share, scale):
    """Book the work of the impulses in `reaction`, times `scale`: the velocity there is a share of that before the jump
    and the rest of that after it."""
    for i in range(drive.known.shape[0]):
        speed, before = _rates(lane, drive, w, i)
        work = (speed + (before - speed) * share) * load(lane, w.reaction, i) * scale
        store(w.books, WORK_DONE, load(lane, w.books, WORK_DONE) + work)


@kernel
def _jumps(lane, drive, w):
    """Whether a prescribed velocity jumps, by more than round-off."""
    for i in range(drive.known.shape[0]):
        after, before = _rates(lane, drive, w, i)
        if abs(alone(after) - alone(before)) > 1e-12 * (abs(alone(after)) + abs(alone(before))):
            return True
    return False


@kernel
def _forces(lane, model, par, w, weights):
    """r of q, v, a, with the multipliers that stand in a's rows; S unless weights.mass = 0."""
    move_multipliers(lane, model.algebraic, w.q, w.a, False)
    assemble(lane, model, par, state_of(w), w.u, weights, w.r, w.S)


@kernel
def _jump(lane, model, drive, par, w, h, fresh):
    """v <- v + dv, a0: dv with the impulses in its rows of multipliers."""
    n = size(model.n)
    for k in range(n):
        store(w.v0, k, load(lane, w.v, k))
        store(w.v, k, splat(lane, 0.0))
        store(w.a, k, splat(lane, 0.0))
        store(w.a0, k, splat(lane, 0.0))
    _forces(lane, model, par, w, RESIDUAL_ALONE)
    copy_rows(lane, n, w.r, w.b0)  # the forces at rest: what a residual has beyond them is inertia
    _solve_jump(lane, model, drive, par, w)
    _forces(lane, model, par, w, RESIDUAL_ALONE)  # of accelerations dv
    _less(lane, n, w.r, w.b0, 1.0)
    note_reactions(lane, drive.known, model.algebraic, w.r, w.a0, w.reaction)
    _book_impulse(lane, drive, w, 0.5, 1.0)  # impulse times mean velocity is the kinetic energy it brings
    if _jumps(lane, drive, w):
        _pass_layer(lane, model, drive, par, w, h, fresh)
    for k in range(n):
        store(w.v, k, load(lane, w.v0, k) + load(lane, w.a0, k))
    move_multipliers(lane, model.algebraic, w.v, w.v, True)


@kernel
def _solve_jump(lane, model, drive, par, w):
    """a0, a <- dv of M dv + Phi_q^T Lambda = 0 with its prescribed part, Lambda in its rows of multipliers."""
    n = size(model.n)
    for i in range(drive.known.shape[0]):
        k = drive.known[i]
        if k >= 0:
            after, before = _rates(lane, drive, w, i)
            store(w.a0, k, after - before)
    copy_rows(lane, n, w.a0, w.a)
    move_multipliers(lane, model.algebraic, w.a, w.a, True)
    _forces(lane, model, par, w, MASS_ALONE)
    _less(lane, n, w.r, w.b0, 1.0)
    for k in range(n):
        store(w.v, k, load(lane, w.v0, k) + load(lane, w.a0, k))
    constrain(lane, model, w.psi, state_of(w), 1, 1.0, w.r)
    solve_known(lane, model, drive, w, True)
    for k in range(n):
        dv = load(lane, w.a0, k) - load(lane, w.r, k)
        store(w.v, k, splat(lane, 0.0))
        store(w.a0, k, dv)
        store(w.a, k, dv)


@kernel
def _pass_layer(lane, model, drive, par, w, h, fresh):
    """Take out of dv what damping ends before a step of h could see it.

    Damping does not let the velocity jump within the material: it spreads what M alone leaves next to a prescribed
    coordinate, in a time that a step may be too long for. There the step would meet forces C dv that last for a small
    part of it as if they lasted for half of it, and so would its books. With s = (M + h/2 C)^-1 M, where nothing
    prescribed moves and Phi_q s = 0, dv loses

        e = (1 - s)^3 (1 + 3 s) dv:    all that damping ends within the step, h^3 of what the step resolves, and nothing
                                       without damping. (1 - s) x solves (M + h/2 C) y + Phi_q^T mu = h/2 C x.

    The impulse of damping is h/2 C (g - e), g having one factor (1 - s) less; it acts at the velocities after the jump
    where they are prescribed. M^-1 C (dv - e), the jump of the accelerations (kept in q0) with that of the multipliers,
    is a sum of the same solutions.
    """
    n, part = size(model.n), 0.5 * h * SMALL
    for k in range(n):
        store(w.r, k, load(lane, w.a0, k))
        store(w.a, k, splat(lane, 0.0))
    move_multipliers(lane, model.algebraic, w.q, w.a, False)
    layer_of(lane, model, drive, par, w, w.b0, h, fresh)
    for k in range(n):
        e, dv = load(lane, w.r, k), load(lane, w.a0, k)
        store(w.v, k, load(lane, w.v, k) - e * part)
        store(w.a, k, e * -SMALL)
        store(w.r, k, load(lane, w.v0, k) + dv - e * 0.5)  # mean of the velocities before and after the layer
        store(w.a0, k, dv - e)
    move_multipliers(lane, model.algebraic, w.v, w.v, True)
    taken = damping_work(lane, model, par, w.q, w.v, w.r) / SMALL  # v is `part` times g - e
    store(w.books, DISSIPATED, load(lane, w.books, DISSIPATED) + taken)
    _forces(lane, model, par, w, RESIDUAL_ALONE)
    _less(lane, n, w.r, w.b0, 1.0)
    note_reactions(lane, drive.known, model.algebraic, w.r, w.q, w.reaction)
    _book_impulse(lane, drive, w, 0.0, 1.0 / SMALL)


@kernel
def layer_of(lane, model, drive, par, w, rest, h, fresh):
    """r <- e of the jump dv in r, v <- g times h/2 and SMALL (`_pass_layer`). rest: the forces at rest; a is 0."""
    n, part = size(model.n), 0.5 * h * SMALL
    for k in range(n):
        store(w.v, k, load(lane, w.r, k) * part)
    _damp(lane, model, drive, par, w, rest, h, True, fresh, 1.0)  # (1 - s) dv
    for k in range(n):
        store(w.v, k, load(lane, w.r, k) * part)
    _damp(lane, model, drive, par, w, rest, h, False, fresh, -3.0)  # (1 - s)^2 dv
    for k in range(n):
        store(w.v, k, load(lane, w.v, k) * 4.0 - load(lane, w.r, k) * (3.0 * part))  # (1 - s) (1 + 3 s) dv
    _damp(lane, model, drive, par, w, rest, h, False, fresh, 1.0)  # g
    for k in range(n):
        store(w.v, k, load(lane, w.r, k) * part)
    _damp(lane, model, drive, par, w, rest, h, False, fresh, 1.0)  # e


@kernel
def _damp(lane, model, drive, par, w, rest, h, matrix, fresh, share):
    """r <- (1 - s) x where v is x times h/2 and SMALL; `share` of it goes into the jump of the accelerations."""
    move_multipliers(lane, model.algebraic, w.v, w.v, True)
    assemble(lane, model, par, state_of(w), w.u, Weights(1.0 if matrix else 0.0, 0.5 * h, 0.0), w.r, w.S)
    _less(lane, size(model.n), w.r, rest, 1.0 / SMALL)
    move_multipliers(lane, model.algebraic, w.r, w.r, True)
    solve_known(lane, model, drive, w, matrix)
    if not fresh:
        for k in range(size(model.n)):
            store(w.q0, k, load(lane, w.q0, k) - load(lane, w.r, k) * (2.0 * share / h))


@apart
def restart_within(lane, model, drive, par, w, t, h, fresh):
    """`restart` of a work array that has been unpacked."""
    n = size(model.n)
    times, half = 1, 0.0
    if drive is not None and not fresh:
        for i in range(drive.entries.shape[0]):  # others that have changed stand in u0 as they were
            store(w.u0, drive.entries[i], load(lane, w.u, drive.entries[i]))
    note_friction(lane, model, par, state_of(w), w.u0, w.r, w.S)
    if drive is not None:
        if not fresh:
            _keep(lane, n, model.algebraic, w)
            times, half = 3, 0.5 * h
        copy_rows(lane, OF_MOTION.end * drive.known.shape[0], w.psi, w.psi0)
        set_inputs(lane, drive, w.u, t, t + 1e-6 * h)
        set_motions(lane, drive, w.psi, t, t + 1e-6 * h)
        _jump(lane, model, drive, par, w, h, fresh)
        turn_round(lane, model, w.v, w.S)
    for k in range(n):
        store(w.a, k, splat(lane, 0.0))
    move_multipliers(lane, model.algebraic, w.q, w.a, False)
    if drive is not None:
        if not fresh:
            copy_rows(lane, n, w.q0, w.a)
            move_multipliers(lane, model.algebraic, w.q, w.q0, False)
            move_multipliers(lane, model.algebraic, w.a, w.a, True)
        set_known(lane, drive.known, w.psi, w.q, w.v, w.a, w.b)
    for i in range(times):
        matrix = i == 0
        weights = Weights(1.0 if matrix else 0.0, half, half * half)
        assemble(lane, model, par, state_of(w), w.u, weights, w.r, w.S)
        constrain(lane, model, w.psi, state_of(w), 2, 1.0, w.r)
        solve_known(lane, model, drive, w, matrix)
        apply_friction(lane, model, par, state_of(w), MASS_ALONE, 0.5 * h, w.S, w.r)
        for k in range(n):
            store(w.a, k, load(lane, w.a, k) - load(lane, w.r, k))
        _take_multipliers(lane, drive, model.algebraic, w, fresh)
        move_multipliers(lane, model.algebraic, w.a, w.a, True)
    _set_b(lane, n, drive, w, fresh)
    if drive is not None:
        assemble(lane, model, par, state_of(w), w.u, RESIDUAL_ALONE, w.r, w.S)
        note_reactions(lane, drive.known, model.algebraic, w.r, w.q, w.reaction)
        copy_rows(lane, size(model.n_inputs), w.u, w.u0)
