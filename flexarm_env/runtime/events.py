"""Events of an episode: pushes at the tip, a change of the payload, and the cost of exceeding limits.

Pushes and payload changes begin at the start of a control period. Pushes and payload changes are drawn and applied
before the arm's state is saved for a repetition (`keeping`). The events of a repeated period are not drawn or applied
again, because the record stores which push acts and whether the payload change is still due.
"""

from __future__ import annotations

import math

from ..compiler import (
    Lanes,
    absolute,
    kernel,
    lane_count,
    maximum,
    select_lt,
    size,
    square_root,
    stack,
    store_lane,
)
from ..physics.arithmetic import store_where
from ..physics.integrator.impact import change_payload
from ..physics.integrator.work import Work
from ..physics.model import OK, PAYLOAD_INERTIA, PAYLOAD_MASS
from ..physics.protocol import strain_gauge
from ..tasks.program import CHANGE, COST, FURTHER, PERIODS, PUSH, PUSHED
from ..tasks.stream import draw, uniform
from ..tasks.task import info_of, put_info, reward_term

_PUSH = PUSH.places
_ONE, _BOTH = (0,), (0, 0)


@kernel
def _axes(task):
    """Return the number of force components of a push: 2 in the plane, 3 in space (targets of three numbers)."""
    return 2 + size(task.targets) // 3


@kernel
def draw_events(lanes, p, arm, par, record, info):
    """Draw the payload change and the first push of an arm's episode; write the payload's mass (kg) into info.payload.

    record.change gets two numbers: the control period at whose start the payload changes, and the factor on the nominal
    payload. lanes: number of arms in a group. arm: index of the arm in the batch; its lane is arm % lanes. par:
    parameters in lanes, with the present payload mass.
    """
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
    """Draw the next push of an arm: first control period, first period after the push, force (N, inertial axes).

    pushes: bounds of waiting time and force, duration `lasting` and latest start `until`; times in control periods. The
    direction is uniform on the circle in the plane (axes = 2) or on the sphere in space (axes = 3; height uniform in
    [-1, 1], angle uniform). A push that would begin after pushes.until is omitted (first = inf). lanes: number of arms
    in a group.
    """
    i = arm % lanes
    # period of the push; it is drawn in every case, so that the stream does not depend on the settings
    first = record[PERIODS * lanes + i] + math.floor(draw(stream, arm, pushes.wait, 0) + 0.5)
    force, angle = draw(stream, arm, pushes.force, 0), 2.0 * math.pi * uniform(stream, arm)
    if first > pushes.until:
        first = math.inf
    record[(PUSHED + _PUSH.first) * lanes + i] = first
    record[(PUSHED + _PUSH.over) * lanes + i] = first + pushes.lasting
    # force times a unit vector, uniform on the circle (height 0) or the sphere (height uniform); inertial axes
    height = 2.0 * uniform(stream, arm) - 1.0 if axes == 3 else 0.0
    level, at = force * math.sqrt(1.0 - height * height), (PUSHED + _PUSH.force) * lanes + i
    record[at], record[at + lanes] = level * math.cos(angle), level * math.sin(angle)
    record[at + 2 * lanes] = force * height


@kernel
def draw_pushes(lane, p, g, record, w):
    """Draw the next push for each moving arm of group g whose last push has ended; no-op without pushes.

    # in        w.flag, OK where an arm is to be moved;  record.periods, control periods done
    # in, out   record.push: first period of the push, first period after the push, force (N, inertial axes)
    """
    if p.pushes is not None:
        for i in range(len(lane)):
            if w.flag[i] == OK and record[(PUSHED + _PUSH.over) * len(lane) + i] <= record[PERIODS * len(lane) + i]:
                _draw_push(p.pushes, p.stream, g * len(lane) + i, record, len(lane), _axes(p.task))


@kernel
def change_payloads(lane, p, par: Lanes, record, w):
    """Apply the payload changes that are due in this period: mass (kg), inertia (kg m^2), jump of velocities.

    A change is due in an arm that moves (w.flag OK) if record.change equals the number of periods done. Afterwards
    record.change is -1: no further change is due. The kernel does not change the numbers of other arms. par: each arm's
    own parameters; payload mass and inertia are written. w: the arms' states, read and written. The kernel
    `impact.change_payload` applies the balance of momentum.
    """
    if p.payload_change is not None:
        lanes, due = len(lane), False
        live, new = stack(lane, _ONE), stack(lane, _BOTH)
        live[0] = 0.0
        new[0] = par[PAYLOAD_MASS]
        new[1] = par[PAYLOAD_INERTIA]
        # m_p and J_p of all lanes at once: the jump of accelerations is solved in lanes; old values where no change is
        # due
        for i in range(lane_count(lane)):
            if w.flag[i] == OK and record[CHANGE * lanes + i] == record[PERIODS * lanes + i]:
                factor = record[(CHANGE + 1) * lanes + i]
                store_lane(lane, new, 0, i, p.ranges.nominal[PAYLOAD_MASS] * factor)
                store_lane(lane, new, 1, i, p.ranges.nominal[PAYLOAD_INERTIA] * factor)
                store_lane(lane, live, 0, i, 1.0)
                due = True
                record[CHANGE * lanes + i] = -1.0
        if due:
            change_payload(lane, p.model, p.payload_change.resting, par, new, live, w, p.h, p.books)


@kernel
def set_pushes(lane, p, record, w):
    """Write this period's push on the tip (N, inertial axes) into w.u after the torques; 0 without a push.

    record.push: first control period of the push, first period after the push, force (N). Without random pushes the
    kernel does nothing.
    """
    if p.pushes is not None:
        lanes, first = len(lane), size(p.task.links)
        for i in range(lane_count(lane)):
            now = record[PERIODS * lanes + i]
            on = record[(PUSHED + _PUSH.first) * lanes + i] <= now and now < record[(PUSHED + _PUSH.over) * lanes + i]
            for d in range(_axes(p.task)):
                w.u[(first + d) * lanes + i] = record[(PUSHED + _PUSH.force + d) * lanes + i] if on else 0.0


@kernel
def record_events(lane, p, par: Lanes, record: Lanes, w: Work, live, info: Lanes, outcome: Lanes):
    """Write cost, payload mass (kg) and push (N) of the period into info of running arms; charge the cost.

    The cost of a period is 1 if a limit is exceeded or if the arm is nearer to a keep-out shape than its margin,
    otherwise 0. The price times the cost is subtracted from the reward.
    # in, out   record.cost, sum of the episode;  outcome row 0, the reward, reduced by the price times the cost
    """
    if size(p.task.further) > 0:
        at, first = info_of(p.task).further, size(p.task.links)
        if p.cost is not None or p.keep_out is not None:
            passed = _cost(lane, p, w.q, info)
            # cost 1 where clearance (m) < margin as well
            if p.keep_out is not None:
                close = info[at + FURTHER.clearance]
                passed = select_lt(close, p.keep_out.margin, 1.0, passed)
            cost = select_lt(0.5, live, passed, 0.0)
            before = record[COST]
            store_where(lane, live, record, COST, before + cost, before)
            info[at + FURTHER.cost] = cost
            put_info(lane, live, info, at + FURTHER.episode_cost, before + cost)
            # reward -= price * cost
            if p.task.charged is not None:
                k = size(p.task.terms) - 2 - min(size(p.task.acted), 1)  # before change, if any, and failure
                outcome[0] += reward_term(lane, p.task, live, info, k, -cost)
        put_info(lane, live, info, at + FURTHER.payload, par[PAYLOAD_MASS])
        if p.pushes is not None:
            for d in range(_axes(p.task)):
                put_info(lane, live, info, at + FURTHER.push + d, w.u[first + d])


@kernel
def _cost(lane, p, q, info: Lanes):
    """Return 1.0 in lanes of arms whose tip deflection or strain exceeds a limit, otherwise 0.0.

    Deflections are read from info (tip deflection / link length). Strains are computed from rows of
    `gauges.curvature_rows`, divided by their limits. In space each station has two rows, for bending in both planes,
    whose absolute values are added.
    # in        q (n, lanes) coordinates; info.deflection
    """
    most, task, cost = 0.0, p.task, p.cost
    if cost is not None:
        # |deflection| / L of each link over its limit; cost 1 where any ratio is above 1
        if cost.deflection is not None:
            at, links = info_of(task).deflection, size(task.links)
            for k in range(links):
                bend = absolute(info[at + k])
                if size(task.targets) == 3:  # in space: magnitude over both planes
                    across = info[at + links + k]
                    bend = square_root(bend * bend + across * across)
                most = maximum(most, bend / cost.deflection[k])
        # |strain| at each station over its limit, a gauge row divided by it
        if cost.strain is not None:
            n, planes = size(p.model.n), 1 + size(task.targets) // 3
            for g in range(0, cost.strain.shape[0] // n, planes):
                bent = absolute(strain_gauge(lane, p.model, q, cost.strain[g * n : (g + 1) * n]))
                if planes == 2:  # in space: the strains of both bendings add up
                    bent = bent + absolute(strain_gauge(lane, p.model, q, cost.strain[(g + 1) * n : (g + 2) * n]))
                most = maximum(most, bent)
    return select_lt(1.0, most, 1.0, 0.0)
