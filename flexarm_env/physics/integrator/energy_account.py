"""The energy account: work of inputs and motions and energy dissipated by damping, with mean forces of steps."""

from __future__ import annotations

from ...compiler import kernel, size
from ..contact.integration import start_contact_account
from ..joints.friction import account_for_friction, store_friction
from ..layout import BEYOND, DISSIPATED, OF_MOTION, WORK_DONE
from ..protocol import input_displacements, local_difference, mean_damping_power
from .work import Work, copy_rows, state_of


@kernel
def start_energy_account(lane, model, drive, par, w):
    """Store inputs, displacements, motions, reactions and friction at the start of a sequence of steps without jumps.

    # in        w.q, w.v, w.a, w.u, w.psi, w.reaction
    # out       w.u0, w.y0, w.psi0, w.reaction0; in w.S friction torques (`joints.friction.store_friction`) and
    #           penetrations of contact points
    # scratch   w.r
    """
    copy_rows(lane, size(model.n_inputs), w.u, w.u0)
    input_displacements(lane, model, par, w.q, w.y0)
    start_contact_account(lane, model, par, w.q, w.S)
    store_friction(lane, model, par, state_of(w), w.u, w.r, w.S)
    if drive is not None:
        copy_rows(lane, OF_MOTION.end * drive.known.shape[0], w.psi, w.psi0)
        copy_rows(lane, drive.known.shape[0], w.reaction, w.reaction0)


@kernel
def account_for_step(lane, model, drive, par, w: Work, h):
    """Add the work and dissipation (J) of a step of h (s) to w.books, as mean force times displacement.

    The dissipation is the power of damping at the step's mean strain rates. Rates at the ends of the step differ from
    the mean by second order of h. In very stiff strains this difference exceeds the rates themselves. The damping
    forces then do additional work, entry BEYOND of w.books, which the strain energy absorbs and returns.
    drive: the scene's loads and motions (`Drive`), or None without motions in time.

    # state     w.q0, w.v0, w.u0, w.y0, w.psi0, w.reaction0 at the start; w.q, w.v, w.u, w.psi, w.reaction at the end
    # out       w.books (energy account); w.u0, w.y0, w.psi0, w.reaction0 <- values at the end, for the next step
    # scratch  w.r, which a completed step no longer needs

    See docs/theory.md, section 6, "Work and energy".
    """
    # work of inputs: (u0 + u) / 2 . (y - y0)
    input_displacements(lane, model, par, w.q, w.y, (w.q0, w.y0))
    work = w.books[WORK_DONE]
    for i in range(size(model.n_inputs)):
        force = (w.u0[i] + w.u[i]) * 0.5
        work = work + force * (w.y[i] - w.y0[i])
        w.u0[i] = w.u[i]
        w.y0[i] = w.y[i]
    # W += (reaction_0 + reaction) / 2 (psi - psi_0), N times m or N m times rad
    if drive is not None:
        for i in range(drive.known.shape[0]):
            k = OF_MOTION.end * i + OF_MOTION.value
            force = (w.reaction0[i] + w.reaction[i]) * 0.5
            work = work + force * (w.psi[k] - w.psi0[k])
        copy_rows(lane, OF_MOTION.end * drive.known.shape[0], w.psi, w.psi0)
        copy_rows(lane, drive.known.shape[0], w.reaction, w.reaction0)
    w.books[WORK_DONE] = work
    # dissipation at the mean rates w.r = (q - q0) / h; theory, section 6, "Work and energy"
    local_difference(lane, model, w.q0, w.q, w.r)
    for k in range(size(model.n)):
        w.r[k] *= 1.0 / h
    power, beyond = mean_damping_power(lane, model, par, w.q0, w.v0, w.q, w.v, w.r, h, w.S)
    w.books[DISSIPATED] += power * h
    if beyond is not None:
        w.books[BEYOND] += beyond * h
    account_for_friction(lane, model, par, state_of(w), w.u, w.r, w.S, w.q0, w.books)
