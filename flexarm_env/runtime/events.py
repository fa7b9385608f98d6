"""What befalls an arm in an episode: pushes at its tip, a payload that changes, and what it costs to go beyond limits.

Pushes and changes come at the start of a control period. What is drawn and what changes there is done before the arm is
kept to be gone back to, and is not done again where a period is repeated: which push holds, and whether the change is
still to come, follow from the record.
"""

from __future__ import annotations

import math

from ..compiler import absolute, arms, kernel, load, maximum, place, select_lt, size, splat, stack, store
from ..physics.arithmetic import put
from ..physics.integrator.impact import change_payload
from ..physics.model import OK, PAYLOAD_INERTIA, PAYLOAD_MASS
from ..tasks.program import CHANGE, COST, DEFLECTION, FURTHER, PERIODS, PUSH, PUSHED
from ..tasks.stream import uniform
from ..tasks.task import info_of

_PUSH = PUSH.places
_ONE, _BOTH = (0,), (0, 0)


@kernel
def _between(stream, arm, ranges):
    return ranges[0] + (ranges[1] - ranges[0]) * uniform(stream, arm)


# --- at the start of an episode ------------------------------------------------------------------------
@kernel
def draw_events(lanes, p, arm, par, record, info):
    """When the payload changes and to what; the first push; what is told before anything has happened."""
    i = arm % lanes
    _draw_change(p.payload_change, p.stream, arm, record, lanes)
    _first_push(p.pushes, p.stream, arm, record, lanes)
    if size(p.task.further) > 0:
        info[(info_of(p.task).further + FURTHER.payload) * lanes + i] = par[PAYLOAD_MASS * lanes + i]


@kernel
def _draw_change(change, stream, arm, record, lanes):
    if change is not None:
        i = arm % lanes
        record[CHANGE * lanes + i] = math.floor(_between(stream, arm, change.time) + 0.5)
        record[(CHANGE + 1) * lanes + i] = _between(stream, arm, change.factor)


@kernel
def _first_push(pushes, stream, arm, record, lanes):
    if pushes is not None:
        _draw_push(pushes, stream, arm, record, lanes)


@kernel
def _draw_push(pushes, stream, arm, record, lanes):
    """The push after the present period's start: when, how strong, which way."""
    i = arm % lanes
    first = record[PERIODS * lanes + i] + math.floor(_between(stream, arm, pushes.wait) + 0.5)
    force, angle = _between(stream, arm, pushes.force), 2.0 * math.pi * uniform(stream, arm)
    if first > pushes.until:
        first = math.inf
    record[(PUSHED + _PUSH.first) * lanes + i] = first
    record[(PUSHED + _PUSH.over) * lanes + i] = first + pushes.lasting
    record[(PUSHED + _PUSH.x) * lanes + i] = force * math.cos(angle)
    record[(PUSHED + _PUSH.y) * lanes + i] = force * math.sin(angle)


# --- at the start of a control period ------------------------------------------------------------------
@kernel
def befall(lane, p, g, par, record, w):
    """What comes to the arms of group g that are to be moved, before they are kept."""
    change(lane, p, p.payload_change, par, record, w)
    _next_pushes(lane, p, p.pushes, g, record, w)


@kernel
def change(lane, p, what, par, record, w):
    """Payloads that change now; in lanes the others stay as they are, to the last bit. what: `p.payload_change`."""
    if what is not None:
        lanes, due = len(lane), False
        live, new = stack(lane, _ONE), stack(lane, _BOTH)
        store(live, 0, splat(lane, 0.0))
        store(new, 0, load(lane, par, PAYLOAD_MASS))
        store(new, 1, load(lane, par, PAYLOAD_INERTIA))
        for i in range(arms(lane)):
            if w.flag[i] == OK and record[CHANGE * lanes + i] == record[PERIODS * lanes + i]:
                factor = record[(CHANGE + 1) * lanes + i]
                place(lane, new, 0, i, p.ranges.nominal[PAYLOAD_MASS] * factor)
                place(lane, new, 1, i, p.ranges.nominal[PAYLOAD_INERTIA] * factor)
                live[i], due = 1.0, True
                record[CHANGE * lanes + i] = -1.0
        if due:
            change_payload(lane, p.model, what.resting, par, new, live, w, p.h, p.books)


@kernel
def _next_pushes(lane, p, pushes, g, record, w):
    """The next push of each arm whose last one is over."""
    if pushes is not None:
        lanes = len(lane)
        for i in range(lanes):
            if w.flag[i] == OK and record[(PUSHED + _PUSH.over) * lanes + i] <= record[PERIODS * lanes + i]:
                _draw_push(pushes, p.stream, g * lanes + i, record, lanes)


@kernel
def push(lane, pushes, first, record, w):
    """Entries of w.u from `first` on: the force on the tip in this period."""
    if pushes is not None:
        lanes = len(lane)
        for i in range(arms(lane)):
            for d in range(2):
                w.u[(first + d) * lanes + i] = _force(record, lanes, i, d)


@kernel
def _force(record, lanes, i, d):
    now = record[PERIODS * lanes + i]
    if record[(PUSHED + _PUSH.first) * lanes + i] <= now and now < record[(PUSHED + _PUSH.over) * lanes + i]:
        return record[(PUSHED + _PUSH.x + d) * lanes + i]
    return 0.0


# --- at its end ----------------------------------------------------------------------------------------
@kernel
def tell(lane, p, par, record, w, live, info):
    """Cost, payload and push of the period into info; the episode's cost grows."""
    if size(p.task.further) > 0:
        at = info_of(p.task).further
        cost = select_lt(0.5, live, _cost(lane, p.cost, size(p.model.n), w.q, info), splat(lane, 0.0))
        before = load(lane, record, COST)
        put(live, record, COST, before + cost, before)
        store(info, at + FURTHER.cost, cost)
        put(live, info, at + FURTHER.episode_cost, before + cost, load(lane, info, at + FURTHER.episode_cost))
        put(live, info, at + FURTHER.payload, load(lane, par, PAYLOAD_MASS), load(lane, info, at + FURTHER.payload))
        _tell_push(lane, p.pushes, size(p.task.links), at + FURTHER.push, w, live, info)


@kernel
def _tell_push(lane, pushes, first, at, w, live, info):
    if pushes is not None:
        for d in range(2):
            put(live, info, at + d, load(lane, w.u, first + d), load(lane, info, at + d))


@kernel
def _cost(lane, cost, n, q, info):
    """1 where a limit is passed, 0 elsewhere."""
    if cost is not None:
        most = maximum(_bend(lane, cost.deflection, info), _strain(lane, cost.strain, n, q))
        return select_lt(1.0, most, splat(lane, 1.0), splat(lane, 0.0))
    return splat(lane, 0.0)


@kernel
def _bend(lane, limits, info):
    """Largest tip deflection, over its limit."""
    most = splat(lane, 0.0)
    if limits is not None:
        for k in range(limits.shape[0]):
            most = maximum(most, absolute(load(lane, info, DEFLECTION + k)) / limits[k])
    return most


@kernel
def _strain(lane, rows, n, q):
    """Largest strain at the stations, over its limit."""
    most = splat(lane, 0.0)
    if rows is not None:
        for g in range(rows.shape[0] // n):
            total = splat(lane, 0.0)
            for k in range(n):
                total = total + load(lane, q, k) * rows[g * n + k]
            most = maximum(most, absolute(total))
    return most
