"""How far the integrator may trust a Newton increment near an obstacle, where the residual is not smooth."""

from __future__ import annotations

from ...compiler import Lanes, absolute, kernel, maximum, select_lt


@kernel
def least_contraction(lane, contact, S: Lanes, first, increment, theta):
    """Return the contraction theta of an iteration, at least 1/2 where the increment may have changed which points touch.

    The gaps in S are those before the increment. A point moves by at most `reach` times the weighted increment. In the
    first iteration of a step (first True) theta is at least 1/2 also where a point touches: the error after it is not
    known. contact: `Watch`, or None without contact, where theta is returned.
    """
    if contact is None:
        return theta
    moved, zero = increment * contact.reach, 0.0
    near = zero
    for p in range(len(contact.points)):
        gap = S[contact.at + p * contact.stride]
        near = select_lt(gap if first else absolute(gap), moved, 1.0, near)
    return maximum(theta, near * 0.5)
