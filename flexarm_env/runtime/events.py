"""Events of an episode: pushes at the tip, a payload that changes, and what it costs to go beyond limits.

Pushes and changes come at the start of a control period. What is drawn and what changes there is done before the arm is
kept to be gone back to, and is not done again where a period is repeated: which push holds, and whether the change is
still to come, follow from the record.
"""

from __future__ import annotations

import math

from ..compiler import absolute, arms, kernel, load, maximum, place, select_lt, size, splat, square_root, stack, store
from ..physics.arithmetic import put
from ..physics.integrator.impact import change_payload
from ..physics.model import OK, PAYLOAD_INERTIA, PAYLOAD_MASS
from ..physics.protocol import gauge
from ..tasks.program import CHANGE, COST, FURTHER, PERIODS, PUSH, PUSHED
from ..tasks.stream import draw, uniform
from ..tasks.task import info_of, put_info, reward_term

_PUSH = PUSH.places
_ONE, _BOTH = (0,), (0, 0)


@kernel
def _axes(task):
    """Components of a push: in space targets have three numbers."""
    return 2 + size(task.targets) // 3


# --- at the start of an episode ------------------------------------------------------------------------
@kernel
def draw_events(lanes, p, arm, par, record, info):
    """When the payload changes and to what; the first push; the info of this before anything has happened."""
    i = arm % lanes
    if p.payload_change is not None:
        record[CHANGE * lanes + i] = math.floor(draw(p.stream, arm, p.payload_change.time, 0) + 0.5)
        record[(CHANGE + 1) * lanes + i] = draw(p.stream, arm, p.payload_change.factor, 0)
    if p.pushes is not None:
        _draw_push(p.pushes, p.stream, arm, record, lanes, _axes(p.task))
    if size(p.task.further) > 0:
        info[(info_of(p.task).further + FURTHER.payload) * lanes + i] = par[PAYLOAD_MASS * lanes + i]


@kernel
def _draw_push(pushes, stream, arm, record, lanes, axes):
    """The push after the present period's start: when, how strong, which way, in the plane or in space."""
    i = arm % lanes
    first = record[PERIODS * lanes + i] + math.floor(draw(stream, arm, pushes.wait, 0) + 0.5)
    force, angle = draw(stream, arm, pushes.force, 0), 2.0 * math.pi * uniform(stream, arm)
    if first > pushes.until:
        first = math.inf
    record[(PUSHED + _PUSH.first) * lanes + i] = first
    record[(PUSHED + _PUSH.over) * lanes + i] = first + pushes.lasting
    height = 2.0 * uniform(stream, arm) - 1.0 if axes == 3 else 0.0
    level, at = force * math.sqrt(1.0 - height * height), (PUSHED + _PUSH.force) * lanes + i
    record[at], record[at + lanes] = level * math.cos(angle), level * math.sin(angle)
    record[at + 2 * lanes] = force * height


# --- at the start of a control period ------------------------------------------------------------------
@kernel
def apply_events(lane, p, g, par, record, w):
    """Events at the period's start of the arms of group g that are to be moved, before they are kept."""
    change_payloads(lane, p, par, record, w)
    if p.pushes is not None:
        for i in range(len(lane)):
            if w.flag[i] == OK and record[(PUSHED + _PUSH.over) * len(lane) + i] <= record[PERIODS * len(lane) + i]:
                _draw_push(p.pushes, p.stream, g * len(lane) + i, record, len(lane), _axes(p.task))


@kernel
def change_payloads(lane, p, par, record, w):
    """Payloads that change now; in lanes the others stay as they are, to the last bit."""
    if p.payload_change is not None:
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
            change_payload(lane, p.model, p.payload_change.resting, par, new, live, w, p.h, p.books)


@kernel
def set_pushes(lane, p, record, w):
    """The force on the tip in this period, the inputs behind the joints' torques."""
    if p.pushes is not None:
        lanes, first = len(lane), size(p.task.links)
        for i in range(arms(lane)):
            now = record[PERIODS * lanes + i]
            on = record[(PUSHED + _PUSH.first) * lanes + i] <= now and now < record[(PUSHED + _PUSH.over) * lanes + i]
            for d in range(_axes(p.task)):
                w.u[(first + d) * lanes + i] = record[(PUSHED + _PUSH.force + d) * lanes + i] if on else 0.0


# --- at its end ----------------------------------------------------------------------------------------
@kernel
def record_events(lane, p, par, record, w, live, info, outcome):
    """Cost, payload and push of the period into info; the episode's cost grows, the reward falls."""
    if size(p.task.further) > 0:
        at, first = info_of(p.task).further, size(p.task.links)
        if p.cost is not None or p.keep_out is not None:
            passed = _cost(lane, p, w.q, info)
            if p.keep_out is not None:
                close = load(lane, info, at + FURTHER.clearance)
                passed = select_lt(close, p.keep_out.margin, splat(lane, 1.0), passed)
            cost = select_lt(0.5, live, passed, splat(lane, 0.0))
            before = load(lane, record, COST)
            put(live, record, COST, before + cost, before)
            store(info, at + FURTHER.cost, cost)
            put_info(lane, live, info, at + FURTHER.episode_cost, before + cost)
            if p.task.charged is not None:
                k = size(p.task.terms) - 2 - min(size(p.task.acted), 1)  # before those of change, if any, and failure
                store(outcome, 0, load(lane, outcome, 0) + reward_term(lane, p.task, live, info, k, -cost))
        put_info(lane, live, info, at + FURTHER.payload, load(lane, par, PAYLOAD_MASS))
        if p.pushes is not None:
            for d in range(_axes(p.task)):
                put_info(lane, live, info, at + FURTHER.push + d, load(lane, w.u, first + d))


@kernel
def _cost(lane, p, q, info):
    """1 where a limit is passed, by a link's tip deflection or by the strain at a station; 0 elsewhere."""
    most, task, cost = splat(lane, 0.0), p.task, p.cost
    if cost is not None:
        if cost.deflection is not None:
            at, links = info_of(task).deflection, size(task.links)
            for k in range(links):
                bend = absolute(load(lane, info, at + k))
                if size(task.targets) == 3:  # in both planes
                    across = load(lane, info, at + links + k)
                    bend = square_root(bend * bend + across * across)
                most = maximum(most, bend / cost.deflection[k])
        if cost.strain is not None:
            n, planes = size(p.model.n), 1 + size(task.targets) // 3
            for g in range(0, cost.strain.shape[0] // n, planes):
                bent = absolute(gauge(lane, p.model, q, cost.strain[g * n : (g + 1) * n]))
                if planes == 2:  # where both bendings add up
                    bent = bent + absolute(gauge(lane, p.model, q, cost.strain[(g + 1) * n : (g + 2) * n]))
                most = maximum(most, bent)
    return select_lt(1.0, most, splat(lane, 1.0), splat(lane, 0.0))
