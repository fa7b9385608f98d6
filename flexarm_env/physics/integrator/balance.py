"""Acceptance of a step by its energy balance (docs: theory, section 6, "Rejected steps")."""

from __future__ import annotations

from ...compiler import absolute, kernel, max_over_lanes, maximum, noinline, select_lt, size
from ..model import NEWTON_FAILED
from ..protocol import (
    energy,
    input_displacements,
    local_difference,
    mean_damping_power,
)
from .work import Work

TURN = 0.15
"""If every coordinate changes by less than this angle (rad) in a step, the energy is not evaluated. The directions of
inertia forces then also change by at most this angle. In this case the trapezoidal rule gains or loses less than 3 % of
the energy (measured)."""

TOLERANCE = 0.05
"""Largest error of a step's energy balance, as a fraction of the kinetic and strain energy."""


@kernel
def refuse_step(lane, model, drive, par, w: Work, active, h):
    """Flag lanes whose computed step violates the energy balance dE = W - D; return whether any lane is flagged.

    h: step (s).
    W, D: work and dissipation of mean forces (J). For linear vibrations the trapezoidal rule satisfies the balance
    exactly for any h. A violation is therefore an error of inertia forces that rotate with the nodes. In fast rotation
    Newton's iteration may have converged to a solution far from the motion. The check requires a model whose motion the
    steps resolve (the elastica), no loads or motions in time (drive None), and a coordinate that changes by TURN.
    active: values above 1/2 mark lanes whose iteration has not converged; they are not flagged here.

    # state     w.q0, w.v0 at the start of the step; w.q, w.v, w.u at its end
    # out       w.flag <- NEWTON_FAILED.   # scratch  w.r, w.y, w.y0
    """
    if model.newton.resolved is None or drive is not None:
        return False
    # the balance lacks the work of moving obstacles
    if model.newton.contact is not None:
        if model.newton.contact.paths is not None:
            return False
    # largest change of a coordinate in the step, rad
    turn = 0.0
    for k in range(size(model.n)):
        turn = maximum(absolute(w.q[k] - w.q0[k]), turn)
    if max_over_lanes(turn) < TURN:
        return False
    return _flag_unbalanced(lane, model, par, w, active, turn, h)


@noinline
def _flag_unbalanced(lane, model, par, w: Work, active, turn, h):
    """Flag lanes with |dE - W + D| > TOLERANCE max(T + U) over a step of h (s) under constant inputs.

    dE: change of the energy.
    W: work of the inputs.
    D: dissipation of mean forces (J).
    T, U: kinetic and strain energy, at the start or end of the step.
    active: values above 1/2 mark lanes whose iteration has not converged; they are not flagged.
    turn: largest change of a coordinate, rad. Lanes with a turn below TURN are not flagged, as for a single arm. D does
    not contain the loss by Coulomb friction. With friction, therefore, only a gain of energy counts. Returns whether a
    lane is flagged.

    # state     w.q0, w.v0 at the start of the step; w.q, w.v, w.u at its end
    # out       w.flag <- NEWTON_FAILED.   # scratch  w.r, w.y, w.y0

    See docs/theory.md, section 6, "Rejected steps".
    """
    kinetic0, strain0, gravity0 = energy(lane, model, par, w.q0, w.v0)
    kinetic, strain, gravity = energy(lane, model, par, w.q, w.v)
    input_displacements(lane, model, par, w.q0, w.y0)
    input_displacements(lane, model, par, w.q, w.y, (w.q0, w.y0))
    # dE, then - W of the inputs
    gain = (kinetic - kinetic0) + (strain - strain0) + (gravity - gravity0)
    for i in range(size(model.n_inputs)):
        gain = gain - w.u[i] * (w.y[i] - w.y0[i])
    # + D: dissipation at the step's mean rates w.r = (q - q0) / h, and the damping forces' work beyond it
    local_difference(lane, model, w.q0, w.q, w.r)
    for k in range(size(model.n)):
        w.r[k] *= 1.0 / h
    power, beyond = mean_damping_power(lane, model, par, w.q0, w.v0, w.q, w.v, w.r, h, None)
    gain = gain + power * h
    if beyond is not None:
        gain = gain + beyond * h
    if model.newton.friction is None:
        gain = absolute(gain)
    # a NaN energy is not < and counts as lost; lanes that failed before stay as flagged
    held = maximum(kinetic + strain, kinetic0 + strain0)
    lost = select_lt(gain, held * TOLERANCE, 0.0, 1.0)
    lost = select_lt(maximum(active, w.flag[0]), 0.5, select_lt(turn, TURN, 0.0, lost), 0.0)
    w.flag[0] = select_lt(0.5, lost, float(NEWTON_FAILED), w.flag[0])
    return max_over_lanes(lost) > 0.5
