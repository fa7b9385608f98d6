"""Fresh starts: an arm drawn from its stream, put in its place, and looked at; and arms that are moved elsewhere."""

from __future__ import annotations

import math

import numpy as np

from ..compiler import apart, follow, kernel, load, size, splat, stack, store
from ..physics.integrator.work import unpack
from ..physics.layout import POSE
from ..physics.model import OK, PAYLOAD_INERTIA, PAYLOAD_MASS, STIFFNESS_FACTOR, TAU_D
from ..physics.protocol import link_poses
from ..tasks.program import (
    GOAL,
    HOLD,
    MODE,
    PARAMETERS,
    PERIODS_ALLOWED,
    SHAKE,
    START,
    TARGET,
    TORQUE_FACTOR,
    basis_at,
    report_at,
    request_at,
    start_at,
)
from ..tasks.stream import uniform
from ..tasks.task import aim, info_of, judge, target_from
from ..tasks.track import start_path
from .episode import OUTCOME, look, note_energies, settle, show, weigh
from .events import draw_events
from .sensors import hear_motors, read_gauges, see_motors, sense

_SHAKE = SHAKE.places
_ONE, _RECORD, _START = (0,), (0,) * GOAL, (0,) * START.offsets(0, 0).end


@kernel
def begin(address, mode, count):
    """Fresh starts of the arms p.queue[:count], drawn from their streams, in a mode."""
    p = follow(address)
    for k in range(count):
        arm = p.queue[k]
        g = arm // len(p.lane)
        block = p.block[g * p.layout.row : (g + 1) * p.layout.row]
        _start(p.lane, p, arm, mode, block, unpack(p.lane, p.model, block, 0))


@apart
def _start(lane, p, arm, mode, block, w):
    task, layout, lanes = p.task, p.layout, len(lane)
    i, n_joints = arm % lanes, size(task.links)
    par, poses = block[layout.par : layout.poses], block[layout.poses : layout.record]
    record, info = block[layout.record : layout.action], block[layout.info : layout.saved]
    seen, action = block[layout.seen : layout.info], block[layout.action : layout.seen]
    own, at = stack(_ONE, task.links + _START), start_at(0, n_joints)
    _draw(task, p.ranges, p.stream, p.request, arm, own)
    limit = record[PERIODS_ALLOWED * lanes + i]
    for k in range(record.shape[0] // lanes):
        record[k * lanes + i] = 0.0
    record[PERIODS_ALLOWED * lanes + i], record[MODE * lanes + i] = limit, float(mode)
    record[TORQUE_FACTOR * lanes + i] = own[at.torque_factor]
    record[TARGET * lanes + i], record[(TARGET + 1) * lanes + i] = own[at.target], own[at.target + 1]
    _place(lanes, i, p.ranges.pose, p.ranges.shake, n_joints, own, size(p.model.n), w.q, w.v, w.a, w.b)
    for k in range(PARAMETERS):
        par[k * lanes + i] = own[at.parameters + k]
    for k in range(w.u.shape[0] // lanes):
        w.u[k * lanes + i] = 0.0
    for k in range(n_joints):
        action[k * lanes + i] = 0.0
        record[(GOAL + k) * lanes + i] = own[at.angles + k]
    for k in range(w.books.shape[0] // lanes):
        w.books[k * lanes + i] = 0.0
    start_path(p.reference, task, p.stream, arm, record, lanes)
    link_poses(lane, p.model, par, w.q, w.v, poses)
    read_gauges(lane, p.sensors, p.entries, p.model, w.q, seen)
    see_motors(lane, p.instruments, p.model, par, record, w)
    live = _only(lane, i)
    _open(lanes, p, arm, block, 1.0)
    draw_events(lanes, p, arm, par, record, info)
    note_energies(lane, p.books, task, p.model, par, record, w, live, info)
    _first_sight(lane, p, arm, live, record, action, poses, seen, info)
    show(lane, arm // lanes, p.block.shape[0] // p.layout.row, info, p.table)


@kernel
def _only(lane, i):
    """1 in lane i, 0 elsewhere."""
    mask = stack(lane, _ONE)
    store(mask, 0, splat(lane, 0.0))
    mask[i] = 1.0
    return load(lane, mask, 0)


@kernel
def _draw(task, ranges, stream, request, arm, own):
    """own <- a `START`: as requested, or drawn. As many draws for any request."""
    n = size(task.links)
    at, asked = start_at(0, n), request_at(0, n)
    straight = uniform(stream, arm) < ranges.straight
    for k in range(n):
        angle = _between(stream, arm, ranges.start, k)
        own[at.angles + k] = _given(request[asked.angles + k], 0.0 if straight else angle)
    first, second = _between(stream, arm, ranges.target, 0), _between(stream, arm, ranges.target, 1)
    first, second = target_from(task, own[at.angles : at.end], first, second)
    own[at.target] = _given(request[asked.target], first)
    own[at.target + 1] = _given(request[asked.target + 1], second)
    vibration = (2.0 * uniform(stream, arm) - 1.0) * ranges.vibration
    own[at.vibration] = _given(request[asked.vibration], vibration)
    payload = _between(stream, arm, ranges.factors, 0)
    stiffness = _between(stream, arm, ranges.factors, 1)
    damping = _between(stream, arm, ranges.factors, 2)
    own[at.torque_factor] = _between(stream, arm, ranges.factors, 3)
    own[at.parameters + PAYLOAD_MASS] = ranges.nominal[PAYLOAD_MASS] * payload
    own[at.parameters + PAYLOAD_INERTIA] = ranges.nominal[PAYLOAD_INERTIA] * payload
    own[at.parameters + STIFFNESS_FACTOR] = ranges.nominal[STIFFNESS_FACTOR] * stiffness
    own[at.parameters + TAU_D] = ranges.nominal[TAU_D] * damping


@kernel
def _between(stream, arm, ranges, k):
    """The next number of an arm's stream, within row k of `ranges`."""
    return ranges[2 * k] + (ranges[2 * k + 1] - ranges[2 * k]) * uniform(stream, arm)


@kernel
def _given(requested, drawn):
    """What was requested, or else what was drawn."""
    if math.isnan(requested):
        return drawn
    return requested


@kernel
def _place(lanes, i, pose, shake, n_joints, own, rows, q, v, a, b):
    """Arm in lane i: straight links at their joint angles, at rest but for the initial vibration."""
    at = start_at(0, n_joints)
    first, vibration = own[at.angles], own[at.vibration]
    cosine, sine = math.cos(first), math.sin(first)
    length = basis_at(0, n_joints).end
    for row in range(rows):
        by, o = basis_at(row * length, n_joints), _SHAKE.end * row
        alpha, value = 0.0, pose[by.one]
        for k in range(n_joints):
            alpha += own[at.angles + k]
            value += pose[by.angles + k] * alpha
            value += pose[by.cosines + k] * math.cos(alpha) + pose[by.sines + k] * math.sin(alpha)
        q[row * lanes + i] = value
        rate = shake[o + _SHAKE.one] + shake[o + _SHAKE.cosine] * cosine + shake[o + _SHAKE.sine] * sine
        v[row * lanes + i] = rate * vibration
        a[row * lanes + i], b[row * lanes + i] = 0.0, 0.0


@kernel
def _open(lanes, p, arm, block, in_range):
    """The info of an arm before anything has happened: zeros; the joint angles that reach its target."""
    task, layout = p.task, p.layout
    i, at = arm % lanes, info_of(task)
    for k in range(layout.info, layout.saved, lanes):
        block[k + i] = 0.0
    block[layout.info + at.in_range * lanes + i] = in_range
    block[layout.info + at.error * lanes + i] = p.estimate
    mine = stack(_ONE, task.links + _RECORD)
    for k in range(GOAL + size(task.links)):
        mine[k] = block[layout.record + k * lanes + i]
    aim(task, mine)
    for k in range(GOAL, GOAL + size(task.links)):
        block[layout.record + k * lanes + i] = mine[k]
    block[layout.record + HOLD * lanes + i] = 0.0


@kernel
def _first_sight(lane, p, arm, live, record, action, poses, seen, info):
    """The first observation of an episode; no reward yet."""
    lanes, i, at = len(lane), arm % len(lane), info_of(p.task)
    look(lane, p, True, poses, record, seen)
    judge(lane, p.task, poses, action, record, live, info)
    for k in range(at.terms, at.terms + size(p.task.terms)):
        info[k * lanes + i] = 0.0
    sense(lane, p, arm, poses, record, seen, True)
    p.reward[arm], p.terminated[arm], p.truncated[arm] = 0.0, np.uint8(0), np.uint8(0)


@kernel
def take_report(address, arm, code):
    """The outcome of a period of a guided arm, from `p.report`; code: its status, or -1 for an episode's start."""
    p = follow(address)
    g = arm // len(p.lane)
    _take_report(p.lane, p, arm, code, p.block[g * p.layout.row : (g + 1) * p.layout.row])


@kernel
def _take_report(lane, p, arm, code, block):
    task, layout, lanes, report = p.task, p.layout, len(lane), p.report
    i, n, at = arm % lanes, size(task.links), info_of(task)
    told = report_at(0, n, report.shape[0] - report_at(0, n, 0).end)
    poses, seen = block[layout.poses : layout.record], block[layout.seen : layout.info]
    record, info = block[layout.record : layout.action], block[layout.info : layout.saved]
    action = block[layout.action : layout.seen]
    live, outcome = _only(lane, i), stack(lane, OUTCOME)
    store(outcome, 0, splat(lane, 0.0))
    store(outcome, 1, splat(lane, 0.0))
    if code <= OK:
        for k in range(POSE.end * n):
            poses[k * lanes + i] = report[told.poses + k]
        for k in range(n):
            action[k * lanes + i] = report[told.action + k]
        for k in range(told.gauges, told.end):
            seen[(p.entries - (told.end - k)) * lanes + i] = report[k]
        hear_motors(lanes, p.instruments, i, report[told.motors : told.gauges], record)
        if code < OK:
            _open(lanes, p, arm, block, report[told.in_range])
            _first_sight(lane, p, arm, live, record, action, poses, seen, info)
        else:
            look(lane, p, False, poses, record, seen)
            weigh(lane, p, live, poses, action, record, info, outcome)
        for k in range(n):
            info[(at.torque + k) * lanes + i] = report[told.torque + k]
        info[at.in_range * lanes + i] = report[told.in_range]
        info[at.error * lanes + i] = p.estimate
        for k in range(at.reward - at.energies):
            info[(at.energies + k) * lanes + i] = report[told.energies + k]
    if code >= OK:
        settle(lane, p, arm, outcome, float(code), poses, record, seen, info)
    show(lane, arm // lanes, p.block.shape[0] // p.layout.row, info, p.table)
