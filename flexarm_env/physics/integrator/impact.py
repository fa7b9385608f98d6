"""Jump of the state when the payload changes at an instant, because an object is gripped or released."""

from __future__ import annotations

from ...compiler import Lanes, kernel, select_lt, size
from ..layout import DISSIPATED, WORK_DONE
from ..model import PAYLOAD_INERTIA, PAYLOAD_MASS
from ..protocol import MASS_ALONE, RESIDUAL_ALONE, Weights, assemble, constraint_residual, energy
from .start import damping_layer
from .work import Work, copy_rows, move_multipliers, solve_unknown_rows, state_of, take_multipliers


@kernel
def change_payload(lane, model, resting, par, new, live: Lanes, w: Work, h, books):
    """Set the payload's mass (kg) and inertia (kg m^2) to `new` (2 rows) in lanes with live > 1/2; velocities jump.

    resting: a compile-time tag if the gripped object is at rest, otherwise None. An object at rest instantly takes the
    arm's velocity. Torques, springs, dampers and friction are finite and have no impulse. The coordinates q and the
    momentum therefore do not change: M+ v+ + Phi_q^T Lambda = M- v-. M-, M+: mass matrix with the old and the new
    payload.
    Lambda: impulses of the constraints Phi = 0. If resting is None, or if an object is released, the object moves with
    the tip and v does not change. Damping ends a part e of the jump dv within less than a step. This part is removed at
    once, as after a jump of a motion (see `start`): e = (1 - s)^3 (1 + 3 s) dv with s = (M+ + h/2 C)^-1 M+.

    The accelerations a and the auxiliary accelerations b jump by the same da, because the residual changes from r- to
    r+:

        (M+ + h/2 C + h^2/4 K) da + Phi_q^T dlambda = -(r+ - r-),    solved three times with one factorization.

    # model     par: old payload, replaced by the new one. h: a step, s. In space the inertia is a factor on the tensor
    # state     w.v, w.a, w.b and multipliers in w.q are changed
    # scratch   w.r, w.S, w.q0, w.v0, w.a0, w.b0

    books: a tag to add the energies to w.books, or None. The impact's loss T- - T+ of kinetic energy counts as
    dissipation. The energy of the gripped or released object counts as work.
    T: kinetic energy.
    """
    n, here = size(model.n), live[0]
    before = energy(lane, model, par, w.q, w.v)
    struck = _is_gripped_at_rest(lane, resting, par, new, here)
    # r-, v-, a- with the old payload, from which the jump is computed
    assemble(lane, model, par, state_of(w), w.u, RESIDUAL_ALONE, w.r, w.S)
    copy_rows(lane, n, w.r, w.b0)
    copy_rows(lane, n, w.v, w.v0)
    copy_rows(lane, n, w.a, w.a0)
    # w.r <- loss of velocity; v0 <- v+ by momentum alone
    _velocity_loss(lane, model, par, new, w)
    for k in range(n):
        v = w.v0[k]
        w.v0[k] = select_lt(0.5, struck, v - w.r[k], v)
    # w.r <- e of that loss, which velocities regain
    damping_layer(lane, model, None, par, w, w.q0, h, True)
    for k in range(n):
        v = w.v0[k]
        w.v[k] = select_lt(0.5, struck, v + w.r[k], v)
        w.a[k] = w.a0[k]
    move_multipliers(lane, model.algebraic, w.v, w.v, True)
    # a+ in live lanes (> 1/2); b+ = b + a+ - a, so that (6.1) continues without a jump
    _accelerate(lane, model, par, w, h)
    for k in range(n):
        a = w.a0[k]
        new_a = select_lt(0.5, here, w.a[k], a)
        w.a[k] = new_a
        w.b[k] = select_lt(0.5, here, w.b[k] + (new_a - a), w.b[k])
    _account_for_impact(lane, model, books, par, w, before, struck)


@kernel
def _is_gripped_at_rest(lane, resting, par: Lanes, new: Lanes, live):
    """Return 1 in live lanes whose arm grips an object at rest, i.e. payload mass or inertia increases; 0 elsewhere.

    resting: a tag if gripped objects are at rest; if None the result is 0 in all lanes. par: contains the old payload.
    new: mass (kg) and inertia (kg m^2) of the new payload. live: 1 in lanes whose payload changes, otherwise 0.
    """
    if resting is not None:
        more = select_lt(par[PAYLOAD_MASS], new[0], live, 0.0)
        return select_lt(par[PAYLOAD_INERTIA], new[1], live, more)
    return 0.0


@kernel
def _rest_residual(lane, model, par, w: Work, moving, weights):
    """Compute the residual w.r at rest (v = 0), with accelerations w.v0 (moving True) or 0 (moving False).

    The payload is that in par. The function sets w.v to 0 and w.a to these accelerations. With weights.with_matrix it
    also assembles w.S.
    weights: factors of mass, damping and stiffness (`Weights`).
    """
    for k in range(size(model.n)):
        w.v[k] = 0.0
        w.a[k] = w.v0[k] if moving else 0.0
    assemble(lane, model, par, state_of(w), w.u, weights, w.r, w.S)


@kernel
def _velocity_loss(lane, model, par: Lanes, new: Lanes, w: Work):
    """Compute the velocity that an impact removes: w.r <- M+^-1 (M+ - M-) v-, with v- in w.v0 (m/s, rad/s).

    M-: mass matrix with the payload in par. M+: mass matrix with the new payload. new: mass (kg), inertia (kg m^2).

    # out       w.r; w.q0 <- forces at rest with the new payload; par <- the new payload; w.S: factors of M+
    # scratch   w.v, w.a, which are 0 on return
    """
    n = size(model.n)
    # w.q0 <- M- v-: residual with v- in place of accelerations less that at rest
    _rest_residual(lane, model, par, w, True, RESIDUAL_ALONE)
    copy_rows(lane, n, w.r, w.q0)
    _rest_residual(lane, model, par, w, False, RESIDUAL_ALONE)
    for k in range(n):
        w.q0[k] -= w.r[k]
    # the same with the new payload: M+ v-
    par[PAYLOAD_MASS] = new[0]
    par[PAYLOAD_INERTIA] = new[1]
    _rest_residual(lane, model, par, w, True, MASS_ALONE)
    for k in range(n):
        w.q0[k] = w.r[k] - w.q0[k]
    _rest_residual(lane, model, par, w, False, RESIDUAL_ALONE)
    for k in range(n):
        # (M+ - M-) v- and the new forces at rest
        rest = w.r[k]
        w.r[k] = w.q0[k] - rest
        w.q0[k] = rest
    move_multipliers(lane, model.algebraic, w.r, w.r, True)
    solve_unknown_rows(lane, model, None, w, True)


@kernel
def _accelerate(lane, model, par, w: Work, h):
    """Solve for accelerations w.a and multipliers after the payload has changed. w.b0: residual r- before the change.

    The function applies three corrections -(r+ - r-), with one factorization of M+ + h/2 C + h^2/4 K (mass matrix with
    the new payload, damping, stiffness). r+ is the residual at the current a.
    h: length of a step, s.
    Scratch memory: w.r, w.S.
    """
    for i in range(3):
        first = i == 0
        weights = Weights(1.0, 0.5 * h, 0.25 * h * h, with_matrix=first)
        assemble(lane, model, par, state_of(w), w.u, weights, w.r, w.S)
        for k in range(size(model.n)):
            w.r[k] -= w.b0[k]
        # level 2: Phi'' = 0 determines lambda together with a
        constraint_residual(lane, model, w.psi, state_of(w), 2, 1.0, w.r)
        solve_unknown_rows(lane, model, None, w, first)
        take_multipliers(lane, model.algebraic, w, None, 1.0)
        for k in range(size(model.n)):
            w.a[k] -= w.r[k]


@kernel
def _account_for_impact(lane, model, books, par, w: Work, before, struck):
    """Add the impact's loss of kinetic energy to the dissipation and the payload's energy to the work in w.books (J).

    before: (kinetic, strain, gravitational) energy before the change.
    struck: 1 in lanes that gripped an object at rest, otherwise 0.
    books: a compile-time tag, or None for no energy account.
    """
    if books is not None:
        after = energy(lane, model, par, w.q, w.v)
        gained, risen = after[0] - before[0], after[2] - before[2]
        lost = select_lt(0.5, struck, -gained, 0.0)
        w.books[DISSIPATED] += lost
        w.books[WORK_DONE] += gained + lost + risen
