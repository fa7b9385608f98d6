"""Functions of contacts that integrator and runtime call (`NewtonPolicy.contact`); no-ops without contacts.

Near an obstacle the residual is not smooth. `least_contraction` accounts for this in the convergence test. At the end
of each step `record_contacts` stores readings and adds up impulses.
"""

from __future__ import annotations

from ...compiler import Lanes, absolute, kernel, maximum, select_lt
from .. import contributions
from ..protocol import STEPS_START
from .layout import READ
from .moving import account_of


@kernel
def least_contraction(lane, contact, S: Lanes, first, increment, theta):
    """Return the contraction theta of an iteration, but at least 1/2 if the increment may change which points touch.

    S contains the gaps before the increment. A point moves by at most `reach` times the weighted increment. In the
    first iteration of a step (first True) theta is also at least 1/2 if a point touches, because the remaining error is
    not known.
    contact: `Watch`, or None in a model without contacts; theta is then returned unchanged.
    """
    if contact is None:
        return theta
    moved, zero = increment * contact.reach, 0.0
    near = zero
    for p in range(len(contact.points)):
        gap = S[contact.at + p * contact.stride + contact.gap]
        near = select_lt(gap if first else absolute(gap), moved, 1.0, near)
    return maximum(theta, near * 0.5)


@kernel
def measure_near_contacts(lane, model, par, q, S, increment):
    """Replace lower bounds of distances in S by the distances at iterate q, if `least_contraction` needs distances.

    increment: weighted increment that will be applied next.
    """
    if model.newton.contact is not None:
        for part in model.contributions:
            contributions.measure_near(lane, part, model, par, q, S, increment)


@kernel
def apply_contact_friction(lane, model, S, x, fresh):
    """Correct a Newton iteration's solution x = S^-1 r by friction of contacts. fresh: True if S has new factors."""
    if model.newton.contact is not None:
        for part in model.contributions:
            contributions.correct_increment(lane, part, model, S, x, fresh)


@kernel
def record_contacts(lane, model, par, q, v, S, h):
    """Store the `READING` of each point at the state q, v in S; add contact forces times h (s) to the impulses.

    The integrator calls the function after each step h. With h = 0 it stores the readings of a state between steps.
    """
    if model.newton.contact is not None:
        for part in model.contributions:
            contributions.after_step(lane, part, model, par, q, v, S, h)


@kernel
def start_contact_account(lane, model, par, q, S):
    """Store the penetrations of all points at coordinates q in S, at the start of the energy account's first step."""
    if model.newton.contact is not None:
        for part in model.contributions:
            contributions.acts(lane, part, model, par, q, S, STEPS_START)


@kernel
def reset_impulses(lane, model, S: Lanes):
    """Set impulses and peak forces of all points to 0, as at the start of a control period."""
    if model.newton.contact is not None:
        for p in range(len(model.newton.contact.points)):
            at = reading_at(model, p)
            S[at + READ.impulse] = 0.0
            S[at + READ.friction] = 0.0
            S[at + READ.peak] = 0.0
        if model.newton.contact.paths is not None:
            S[account_of(model.newton.contact.paths).work] = 0.0


@kernel
def reading_at(model, p):
    """Return the offset in S of the `READING` of point p in a model with contacts."""
    return model.newton.contact.at + p * model.newton.contact.stride
