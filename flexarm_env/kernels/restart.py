"""A consistent start at t+: velocities, accelerations and multipliers where a load or a motion may have jumped."""

from __future__ import annotations

from .bare import bare
from .drive import set_inputs, set_motions
from .jit import kernel
from .lanes import load, splat, store
from .protocol import assemble, constrain, factor, size, solve
from .work import move_multipliers, note_reactions, set_known, take_out_known, unpack


@kernel
def restart(lane, model, drive, par, flat, n_motions, t, h, fresh):  # type: ignore[no-untyped-def]
    """Consistent velocities, accelerations and multipliers at t+, where a load or motion may have jumped.

    Velocities jump by M dv + Phi_q^T Lambda = 0 with the prescribed part known; the work of the impulse goes to the
    books. A fresh start then has M a + Phi_q^T lambda = Q - h(q, v), and b = a. At a kink within a run (not fresh, with
    a drive) what the residual at t+ asks for is added to accelerations and multipliers,

        (M + h/2 C + h^2/4 K) da + Phi_q^T dlambda = -r,    three times,

    and b keeps its distance from a. Where the step resolves the motion that is M da = -r, to third order; solved with M
    alone, the stress of strains and strain rates too stiff for the step would make accelerations large. h: a step.
    """
    _restart(lane, bare(model), drive, bare(par), unpack(lane, model, bare(flat), n_motions), t, h, fresh)


@kernel
def _keep(n, algebraic, w):  # type: ignore[no-untyped-def]
    """Accelerations and multipliers to q0, which is free between steps; to b its distance from a."""
    for k in range(n):
        w.q0[k] = w.a[k]
        w.b[k] -= w.a[k]
    if algebraic is not None:
        for i in range(algebraic.shape[0]):
            k = algebraic[i]
            w.q0[k] = w.q[k]


@kernel
def _take_multipliers(drive, algebraic, w, fresh):  # type: ignore[no-untyped-def]
    """Multipliers from where the accelerations were solved for: the new ones, or what is added to those kept."""
    if drive is not None:
        if not fresh:
            if algebraic is not None:
                for i in range(algebraic.shape[0]):
                    k = algebraic[i]
                    w.a[k] += w.q[k]
    move_multipliers(algebraic, w.q, w.a, False)


@kernel
def _set_b(lane, n, drive, w, fresh):  # type: ignore[no-untyped-def]
    """b = a, or at the distance that was kept; prescribed coordinates have none."""
    if drive is not None:
        if not fresh:
            for i in range(drive.known.shape[0]):
                k = drive.known[i]
                if k >= 0:
                    w.b[k] = 0.0
            for k in range(n):
                w.b[k] += w.a[k]
            return
    for k in range(n):
        store(w.b, k, load(lane, w.a, k))


@kernel
def _restart(lane, model, drive, par, w, t, h, fresh):  # type: ignore[no-untyped-def]
    """`restart` on bare arrays."""
    n = size(model.n)
    if drive is not None:
        if not fresh:
            _keep(n, model.algebraic, w)
        for i in range(w.psi.shape[0]):
            w.psi0[i] = w.psi[i]
        set_inputs(drive, w.u, t, t + 1e-6 * h)
        set_motions(drive, w.psi, t, t + 1e-6 * h)
        for k in range(n):
            w.v0[k] = w.v[k]
            w.a0[k] = 0.0  # the jump dv; impulses in its rows of multipliers
        for i in range(drive.known.shape[0]):
            k = drive.known[i]
            if k >= 0:
                w.a0[k] = w.psi[3 * i + 1] - w.v[k]
    for turn in range(7):
        stage = min(turn, 3) if turn < 6 else 4
        again = stage == 3 and turn > 3
        if drive is None:  # only the accelerations are to be solved for
            if turn != 3:
                continue
        if again and fresh:
            continue
        if turn == 3:
            for k in range(n):
                store(w.a, k, splat(lane, 0.0))
            move_multipliers(model.algebraic, w.q, w.a, False)
        if drive is not None:
            if stage == 0:  # the residual at rest, to be subtracted: what is left is inertia
                for k in range(n):
                    w.v[k], w.a[k] = 0.0, 0.0
                move_multipliers(model.algebraic, w.q, w.a, False)
            elif stage <= 2:
                for k in range(n):
                    w.a[k] = w.a0[k]
                move_multipliers(model.algebraic, w.q, w.a0, False)
            elif turn == 3:
                for k in range(n):
                    w.v[k] = w.v0[k] + w.a0[k]
                move_multipliers(model.algebraic, w.q, w.a, False)
                move_multipliers(model.algebraic, w.v, w.v, True)
                if not fresh:
                    for k in range(n):
                        w.a[k] = w.q0[k]
                    move_multipliers(model.algebraic, w.q, w.q0, False)
                    move_multipliers(model.algebraic, w.a, w.a, True)
                set_known(drive.known, w.psi, w.q, w.v, w.a, w.b)
        matrix = turn == 1 or turn == 3
        resolved = 0.5 * h if stage == 3 and drive is not None and not fresh else 0.0
        assemble(
            lane, model, par, w.q, w.v, w.a, w.u, 1.0 if matrix else 0.0, resolved, resolved * resolved, w.r, w.S
        )  # fmt: skip
        if drive is not None:
            if stage == 0:
                for k in range(n):
                    w.b0[k] = w.r[k]
            elif stage <= 2:
                for k in range(n):
                    w.r[k] -= w.b0[k]
            if stage == 2:
                note_reactions(drive.known, model.algebraic, w.r, w.a0, w.reaction)
                for i in range(drive.known.shape[0]):  # impulse times mean velocity is the kinetic energy it brings
                    k = drive.known[i]
                    speed = w.psi[3 * i + 1] + (w.v0[k] if k >= 0 else w.psi0[3 * i + 1])
                    w.books[0] += 0.5 * speed * w.reaction[i]
            elif stage == 1:
                for k in range(n):
                    w.v[k] = w.v0[k] + w.a0[k]
                constrain(lane, model, w.psi, w.q, w.v, w.a, 1, 1.0, w.r)
                for k in range(n):
                    w.v[k] = 0.0
        if stage == 3:
            constrain(lane, model, w.psi, w.q, w.v, w.a, 2, 1.0, w.r)
        if matrix or again:
            take_out_known(lane, model, drive, w.r, w.S, matrix)
            if matrix:
                factor(lane, model, w.S)
                w.counts[1] += 1.0
            solve(lane, model, w.S, w.r)
        if stage == 3:
            for k in range(n):
                store(w.a, k, load(lane, w.a, k) - load(lane, w.r, k))
            _take_multipliers(drive, model.algebraic, w, fresh)
            move_multipliers(model.algebraic, w.a, w.a, True)
            if fresh or turn == 5 or drive is None:
                _set_b(lane, n, drive, w, fresh)
        if drive is not None:
            if stage == 1:
                for k in range(n):
                    w.a0[k] -= w.r[k]
            elif stage == 4:
                note_reactions(drive.known, model.algebraic, w.r, w.q, w.reaction)
