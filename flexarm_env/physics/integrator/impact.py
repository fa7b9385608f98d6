"""A payload that changes at an instant: what is gripped comes to the arm's motion, what is let go takes its along."""

from __future__ import annotations

from ...compiler import kernel, load, select_lt, size, splat, store
from ..layout import DISSIPATED, WORK_DONE
from ..model import PAYLOAD_INERTIA, PAYLOAD_MASS
from ..protocol import MASS_ALONE, RESIDUAL_ALONE, Weights, assemble, constrain, energy
from .start import layer_of
from .work import copy_rows, move_multipliers, solve_known, state_of, take_multipliers


@kernel
def change_payload(lane, model, resting, par, new, live, w, h, books):
    """The payload's mass and inertia become `new` (2 rows of lanes) where `live` is 1; elsewhere nothing changes.

    resting: a tag where what is gripped rests. It comes to the arm's motion in no time: positions stay, and so does the
    momentum, M+ v+ + Phi_q^T Lambda = M- v-; torques and the forces of springs, dampers and friction are finite, and
    have no impulse. Where there is none, and where something is let go, what comes or goes moves with the tip:
    velocities stay. Of the jump of the velocities what damping ends before a step could see it is taken out, as where a
    motion jumps: e = (1 - s)^3 (1 + 3 s) dv with s = (M+ + h/2 C)^-1 M+ (`start.restart` says why).

    Accelerations change with what the forces ask for of the residual r-, r+ before and after,

        (M+ + h/2 C + h^2/4 K) da + Phi_q^T dlambda = -(r+ - r-),    three times,

    and b keeps its distance from a: see `start.restart`. h: a step. books: a tag, or None. What the impact and
    that damping take, T- - T+, goes to what is dissipated; the energy of the payload that comes or goes to the work.
    """
    n, here = size(model.n), load(lane, live, 0)
    before = energy(lane, model, par, w.q, w.v)
    struck = _struck(lane, resting, par, new, here)
    assemble(lane, model, par, state_of(w), w.u, RESIDUAL_ALONE, w.r, w.S)
    copy_rows(lane, n, w.r, w.b0)
    copy_rows(lane, n, w.v, w.v0)
    copy_rows(lane, n, w.a, w.a0)
    _of_momentum(lane, model, par, new, w)
    for k in range(n):
        v = load(lane, w.v0, k)
        store(w.v0, k, select_lt(0.5, struck, v - load(lane, w.r, k), v))
    layer_of(lane, model, None, par, w, w.q0, h, True)
    for k in range(n):
        v = load(lane, w.v0, k)
        store(w.v, k, select_lt(0.5, struck, v + load(lane, w.r, k), v))
        store(w.a, k, load(lane, w.a0, k))
    move_multipliers(lane, model.algebraic, w.v, w.v, True)
    _accelerate(lane, model, par, w, h)
    for k in range(n):
        a = load(lane, w.a0, k)
        new_a = select_lt(0.5, here, load(lane, w.a, k), a)
        store(w.a, k, new_a)
        store(w.b, k, select_lt(0.5, here, load(lane, w.b, k) + (new_a - a), load(lane, w.b, k)))
    _book(lane, model, books, par, w, before, struck)


@kernel
def _struck(lane, resting, par, new, live):
    """1 where something at rest is gripped."""
    if resting is not None:
        more = select_lt(load(lane, par, PAYLOAD_MASS), load(lane, new, 0), live, splat(lane, 0.0))
        return select_lt(load(lane, par, PAYLOAD_INERTIA), load(lane, new, 1), live, more)
    return splat(lane, 0.0)


@kernel
def _at_rest(lane, model, par, w, moving, weights):
    """r of accelerations v0 (moving) or 0, of an arm at rest; S unless weights.mass = 0."""
    for k in range(size(model.n)):
        store(w.v, k, splat(lane, 0.0))
        store(w.a, k, load(lane, w.v0, k) if moving else splat(lane, 0.0))
    assemble(lane, model, par, state_of(w), w.u, weights, w.r, w.S)


@kernel
def _of_momentum(lane, model, par, new, w):
    """r <- M+^-1 (M+ - M-) v-, by which velocities fall; q0 <- the forces at rest; par <- the new payload."""
    n = size(model.n)
    _at_rest(lane, model, par, w, True, RESIDUAL_ALONE)
    copy_rows(lane, n, w.r, w.q0)
    _at_rest(lane, model, par, w, False, RESIDUAL_ALONE)
    for k in range(n):
        store(w.q0, k, load(lane, w.q0, k) - load(lane, w.r, k))
    store(par, PAYLOAD_MASS, load(lane, new, 0))
    store(par, PAYLOAD_INERTIA, load(lane, new, 1))
    _at_rest(lane, model, par, w, True, MASS_ALONE)
    for k in range(n):
        store(w.q0, k, load(lane, w.r, k) - load(lane, w.q0, k))
    _at_rest(lane, model, par, w, False, RESIDUAL_ALONE)
    for k in range(n):
        rest = load(lane, w.r, k)
        store(w.r, k, load(lane, w.q0, k) - rest)
        store(w.q0, k, rest)
    move_multipliers(lane, model.algebraic, w.r, w.r, True)
    solve_known(lane, model, None, w, True)


@kernel
def _accelerate(lane, model, par, w, h):
    """Accelerations from those before, whose residual is in b0."""
    for i in range(3):
        first = i == 0
        weights = Weights(1.0 if first else 0.0, 0.5 * h, 0.25 * h * h)
        assemble(lane, model, par, state_of(w), w.u, weights, w.r, w.S)
        for k in range(size(model.n)):
            store(w.r, k, load(lane, w.r, k) - load(lane, w.b0, k))
        constrain(lane, model, w.psi, state_of(w), 2, 1.0, w.r)
        solve_known(lane, model, None, w, first)
        take_multipliers(lane, model.algebraic, w, None, 1.0)
        for k in range(size(model.n)):
            store(w.a, k, load(lane, w.a, k) - load(lane, w.r, k))


@kernel
def _book(lane, model, books, par, w, before, struck):
    """What the impact takes, and what the payload brings or takes along."""
    if books is not None:
        after = energy(lane, model, par, w.q, w.v)
        gained, risen = after[0] - before[0], after[2] - before[2]
        lost = select_lt(0.5, struck, -gained, splat(lane, 0.0))
        store(w.books, DISSIPATED, load(lane, w.books, DISSIPATED) + lost)
        store(w.books, WORK_DONE, load(lane, w.books, WORK_DONE) + (gained + lost + risen))
