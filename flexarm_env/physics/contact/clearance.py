"""Clearance: tests that show, without computing the points' distances, that no point touches an obstacle.

A lower bound of the distances at coordinates q follows from the distances at reference coordinates q_r:

    d(q) >= min d(q_r) - sum_k levers_k |q_k - q_r,k|

If coordinate k changes by 1, a point moves by at most levers_k. A distance changes by at most the motion of the point.
If the bound is positive, all forces of obstacles are exactly 0. Results therefore have the same bits with and without
these tests.
"""

from __future__ import annotations

from ...compiler import Lanes, absolute, kernel, max_over_lanes, maximum, select_lt, size, stack
from .. import protocol
from .kinematics import gap_at, here_of, touches
from .layout import HERE, READ, REFERENCE

_reference = kernel(REFERENCE.offsets)
_here = kernel(HERE.offsets)

_FAR = 1e-3
"""If the gap of a point in the last Newton iterate exceeds this fraction of `Watch.reach`, the point does not touch at
the end of the step. `Watch.reach` bounds a point's displacement for a weighted increment of 1."""
_ROUND_OFF = 1e-12
"""Round-off of a distance as a fraction of the distance and of `Touching.extent`: at least a thousand units."""


@kernel
def _reference_of(part):
    """Return the offsets in S of the fields of `REFERENCE`, which follow the fields of the points."""
    n = size(part.room)
    return _reference(part.at + len(part.points) * _here(0, len(part.axes), n).end, n)


@kernel
def forget_clearance(lane, part, S: Lanes):
    """Discard the reference, so that the next test computes the points' distances."""
    if part.levers is not None:
        S[_reference_of(part).clearance] = 0.0


@kernel
def _measure(lane, part, model, par, q: Lanes, S: Lanes):
    """Store the gaps of all points at q in S, make q the reference, and return the smallest gap, m."""
    y, least = stack(lane, model.points), 1e300
    protocol.input_displacements(lane, model.arm, par, q, y)
    for p in range(len(part.points)):
        gap = gap_at(lane, part, q, y, p)
        S[here_of(part, p).gap] = gap
        S[here_of(part, p).bound] = 0.0
        least = select_lt(gap, least, gap, least)
    if part.levers is not None:
        at = _reference_of(part)
        S[at.bounded] = 0.0
        S[at.clearance] = least - (absolute(least) + part.extent) * _ROUND_OFF
        for k in range(size(part.room)):
            S[at.q + k] = q[k]
    return least


@kernel
def _clearance(lane, part, q: Lanes, S: Lanes):
    """Return a lower bound (m) of the points' distances from obstacles at q, not positive without a reference."""
    at = _reference_of(part)
    far = S[at.clearance]
    for k in range(size(part.room)):
        far = far - absolute(q[k] - S[at.q + k]) * part.levers[k]
    return far


@kernel
def _is_clear(lane, part, q, S: Lanes):
    """Return whether the bound shows that no point touches in any lane; then store the bound as gap of all points."""
    if part.levers is None:
        return False
    far = _clearance(lane, part, q, S)
    clear = max_over_lanes(select_lt(0.0, far, 0.0, 1.0)) < 0.5
    if clear:
        S[_reference_of(part).bounded] = 1.0
        for p in range(len(part.points)):
            S[here_of(part, p).gap] = far
            S[here_of(part, p).bound] = 0.0
    return clear


@kernel
def may_touch(lane, part, model, S: Lanes):
    """Return whether a point may touch in any lane at the end of a step, from the gaps of the last Newton iterate."""
    least = 1e300
    for p in range(len(part.points)):
        gap = S[here_of(part, p).gap]
        least = select_lt(gap, least, gap, least)
    return max_over_lanes(select_lt(least, model.newton.contact.reach * _FAR, 1.0, 0.0)) > 0.5


@kernel
def _start_account(lane, part, model, par, q, S: Lanes):
    """Store the penetration of each point at coordinates q in S, or a bound of it if no point touches."""
    if not _is_clear(lane, part, q, S):
        _measure(lane, part, model, par, q, S)
    for p in range(len(part.points)):
        S[here_of(part, p).reading + READ.penetration] = -S[here_of(part, p).gap]


@kernel
def acts(lane, part, model, par, q, S, instant):
    """Return whether a point may touch in any lane at coordinates q.

    The value of `instant` selects the test. None: always True.
    ITERATE: the test uses the clearance; the gaps in S are then distances or a lower bound of distances.
    STEP_START: the test uses the readings in S, which are those of the previous step until `after_step`.
    STEP_END: the test uses the gaps of the last iterate.
    STEPS_START: the test uses the clearance or the distances, and stores the readings for STEP_START.
    """
    if instant is None:
        return True
    if len(instant) == len(protocol.STEP_START):
        return _touched(lane, part, S)
    if len(instant) == len(protocol.STEP_END):
        return may_touch(lane, part, model, S)
    if len(instant) == len(protocol.STEPS_START):
        _start_account(lane, part, model, par, q, S)
        return True
    if part.levers is None:
        return True
    return _acts_at_iterate(lane, part, model, par, q, S)


@kernel
def _acts_at_iterate(lane, part, model, par, q, S: Lanes):
    """Return whether a point touches in any lane at the Newton iterate q."""
    if _is_clear(lane, part, q, S):
        return False
    return touches(_measure(lane, part, model, par, q, S))


@kernel
def _touched(lane, part, S: Lanes):
    """Return whether a point touched in any lane when the readings in S were stored."""
    deepest = -1e300
    for p in range(len(part.points)):
        deepest = maximum(S[here_of(part, p).reading + READ.penetration], deepest)
    return max_over_lanes(select_lt(0.0, deepest, 1.0, 0.0)) > 0.5


@kernel
def measure_near(lane, part, model, par, q, S: Lanes, increment):
    """Store the gaps at iterate q if the gaps in S are a bound and the increment may bring a point to an obstacle.

    `least_contraction` compares the gaps with `Watch.reach` times the increment.
    """
    if part.levers is not None:
        at, moved = _reference_of(part), increment * model.newton.contact.reach
        near = select_lt(S[here_of(part, 0).gap], moved, S[at.bounded], 0.0)
        if max_over_lanes(near) > 0.5:
            _measure(lane, part, model, par, q, S)
