"""Fresh starts: an arm drawn from its stream, put in its place, and looked at; and arms that are moved elsewhere."""

from __future__ import annotations

import math

import numpy as np

from ..compiler.arrays import stack
from ..compiler.decorator import kernel
from ..compiler.dispatch import size
from ..compiler.entry import follow
from ..compiler.lanes import load, splat, store
from ..physics.integrator.work import unpack
from ..physics.model import OK
from ..physics.protocol import link_poses
from ..tasks.program import (
    DEFLECTION,
    ENERGIES,
    ERROR,
    GOAL,
    HOLD,
    IN_RANGE,
    JOINT_LIMIT,
    LIMIT,
    MODE,
    TARGET,
    TORQUE_FACTOR,
)
from ..tasks.stream import uniform
from ..tasks.task import aim, judge, observe
from ..tasks.track import look_ahead, start_path
from .episode import note_energies, settle, show, tail_of
from .sensors import read_gauges, sense

_ONE, _PAIR, _MANY, _OWN = (0,), (0, 0), (0,) * (GOAL + 8), (0,) * 16


@kernel
def begin(address, mode, count):  # type: ignore[no-untyped-def]
    """Fresh starts of the arms p.queue[:count], drawn from their streams, in a mode."""
    p = follow(address)
    for k in range(count):
        arm = p.queue[k]
        g = arm // len(p.lane)
        block = p.block[g * p.layout.row : (g + 1) * p.layout.row]
        _start(p.lane, p, arm, mode, block, unpack(p.lane, p.model, block, 0))


@kernel
def _start(lane, p, arm, mode, block, w):  # type: ignore[no-untyped-def]
    task, layout, lanes = p.task, p.layout, len(lane)
    i, n_joints = arm % lanes, size(task.links)
    par, poses = block[layout.par : layout.poses], block[layout.poses : layout.record]
    record, info = block[layout.record : layout.action], block[layout.info : layout.saved]
    seen, action = block[layout.seen : layout.info], block[layout.action : layout.seen]
    own = stack(_ONE, _OWN)
    _draw(task, p.ranges, p.stream, p.wish, arm, own)
    limit = record[LIMIT * lanes + i]
    for k in range(record.shape[0] // lanes):
        record[k * lanes + i] = 0.0
    record[LIMIT * lanes + i], record[MODE * lanes + i] = limit, float(mode)
    record[TORQUE_FACTOR * lanes + i] = own[8]
    record[TARGET * lanes + i], record[(TARGET + 1) * lanes + i] = own[5], own[6]
    _place(lanes, i, p.ranges.pose, p.ranges.shake, n_joints, own, size(p.model.n), w.q, w.v, w.a, w.b)
    for k in range(4):
        par[k * lanes + i] = own[12 + k]
    for k in range(n_joints):
        w.u[k * lanes + i], action[k * lanes + i] = 0.0, 0.0
        record[(GOAL + k) * lanes + i] = own[k]
    for k in range(3):
        w.books[k * lanes + i] = 0.0
    start_path(p.reference, task, p.stream, arm, record, lanes)
    link_poses(lane, p.model, par, w.q, w.v, poses)
    read_gauges(lane, p.sensors, p.entries, p.model, w.q, seen)
    live = _only(lane, i)
    _open(lanes, p, arm, block, 1.0)
    note_energies(lane, p.books, task, p.model, par, record, w, live, info)
    _sight(lane, p, arm, live, record, action, poses, seen, info)
    show(lane, arm // lanes, p.block.shape[0] // p.layout.row, info, p.table)


@kernel
def _only(lane, i):  # type: ignore[no-untyped-def]
    """1 in lane i, 0 elsewhere."""
    mask = stack(lane, _ONE)
    store(mask, 0, splat(lane, 0.0))
    mask[i] = 1.0
    return load(lane, mask, 0)


@kernel
def _draw(task, ranges, stream, wish, arm, own):  # type: ignore[no-untyped-def]
    """own: 0-3 joint angles, 4 vibration, 5-6 target, 8 torque constant, 12-15 par. As many draws for any wish."""
    n = size(task.links)
    straight = uniform(stream, arm) < ranges.straight
    for k in range(n):
        angle = _between(stream, arm, ranges.start, k)
        own[k] = _given(wish[k], 0.0 if straight else angle)
    first, second = _between(stream, arm, ranges.target, 0), _between(stream, arm, ranges.target, 1)
    if size(task.targets) == 1:
        first, second = own[0] + first, 0.0
    else:
        first, second = first * math.cos(second), first * math.sin(second)
    own[5], own[6] = _given(wish[n], first), _given(wish[n + 1], second)
    own[4] = _given(wish[n + 2], (2.0 * uniform(stream, arm) - 1.0) * ranges.vibration)
    payload = _between(stream, arm, ranges.factors, 0)
    stiffness = _between(stream, arm, ranges.factors, 1)
    damping = _between(stream, arm, ranges.factors, 2)
    own[8] = _between(stream, arm, ranges.factors, 3)
    own[12], own[13] = ranges.nominal[0] * payload, ranges.nominal[1] * payload
    own[14], own[15] = ranges.nominal[2] * stiffness, ranges.nominal[3] * damping


@kernel
def _between(stream, arm, ranges, k):  # type: ignore[no-untyped-def]
    """The next number of an arm's stream, within row k of `ranges`."""
    return ranges[2 * k] + (ranges[2 * k + 1] - ranges[2 * k]) * uniform(stream, arm)


@kernel
def _given(wish, drawn):  # type: ignore[no-untyped-def]
    """What was wished for, or else what was drawn."""
    if math.isnan(wish):
        return drawn
    return wish


@kernel
def _place(lanes, i, pose, shake, n_joints, own, rows, q, v, a, b):  # type: ignore[no-untyped-def]
    """Arm in lane i: straight links at their joint angles, at rest but for the initial vibration."""
    cosine, sine = math.cos(own[0]), math.sin(own[0])
    for row in range(rows):
        o = row * (1 + 3 * n_joints)
        alpha, value = 0.0, pose[o]
        for k in range(n_joints):
            alpha += own[k]
            value += pose[o + 1 + k] * alpha
            value += pose[o + 1 + n_joints + k] * math.cos(alpha) + pose[o + 1 + 2 * n_joints + k] * math.sin(alpha)
        q[row * lanes + i] = value
        v[row * lanes + i] = (shake[3 * row] + shake[3 * row + 1] * cosine + shake[3 * row + 2] * sine) * own[4]
        a[row * lanes + i], b[row * lanes + i] = 0.0, 0.0


@kernel
def _open(lanes, p, arm, block, in_range):  # type: ignore[no-untyped-def]
    """The info of an arm before anything has happened: zeros; the joint angles that reach its target."""
    task, layout = p.task, p.layout
    i, tail = arm % lanes, tail_of(task)
    for at in range(layout.info, layout.saved, lanes):
        block[at + i] = 0.0
    block[layout.info + (tail + IN_RANGE) * lanes + i] = in_range
    block[layout.info + (tail + ERROR) * lanes + i] = p.estimate
    mine = stack(_ONE, _MANY)
    for k in range(GOAL + size(task.links)):
        mine[k] = block[layout.record + k * lanes + i]
    aim(task, mine)
    for k in range(GOAL, GOAL + size(task.links)):
        block[layout.record + k * lanes + i] = mine[k]
    block[layout.record + HOLD * lanes + i] = 0.0


@kernel
def _sight(lane, p, arm, live, record, action, poses, seen, info):  # type: ignore[no-untyped-def]
    """The first observation of an episode; no reward yet."""
    task, lanes = p.task, len(lane)
    i, tail = arm % lanes, tail_of(task)
    observe(lane, task, poses, record, seen)
    look_ahead(lanes, p.reference, task, p.period, True, poses, record, seen)
    judge(lane, task, poses, action, record, live, info)
    for k in range(tail - size(task.terms), tail):
        info[k * lanes + i] = 0.0
    sense(lanes, p.sensors, p.entries, p.stream, arm, record, seen, p.observation, True)
    p.reward[arm], p.terminated[arm], p.truncated[arm] = 0.0, np.uint8(0), np.uint8(0)


@kernel
def witness(address, arm, code):  # type: ignore[no-untyped-def]
    """The outcome of a period of an arm that was moved elsewhere, told in `p.outside`; code: its status, or -1 for the
    start of its episode."""
    p = follow(address)
    g = arm // len(p.lane)
    _witness(p.lane, p, arm, code, p.block[g * p.layout.row : (g + 1) * p.layout.row])


@kernel
def _witness(lane, p, arm, code, block):  # type: ignore[no-untyped-def]
    task, layout, lanes, outside = p.task, p.layout, len(lane), p.outside
    i, n, targets, tail = arm % lanes, size(task.links), size(task.targets), tail_of(task)
    poses, seen = block[layout.poses : layout.record], block[layout.seen : layout.info]
    record, info = block[layout.record : layout.action], block[layout.info : layout.saved]
    action = block[layout.action : layout.seen]
    live, pair, reason = _only(lane, i), stack(lane, _PAIR), float(code)
    store(pair, 0, splat(lane, 0.0))
    if code <= OK:
        for k in range(12 * n):
            poses[k * lanes + i] = outside[k]
        for k in range(n):
            action[k * lanes + i] = outside[13 * n + k]
        first = 14 * n + 6
        for k in range(first, outside.shape[0]):  # gauges
            seen[(p.entries - (outside.shape[0] - k)) * lanes + i] = outside[k]
        if code < OK:
            _open(lanes, p, arm, block, outside[first - 1])
            _sight(lane, p, arm, live, record, action, poses, seen, info)
        else:
            observe(lane, task, poses, record, seen)
            look_ahead(lanes, p.reference, task, p.period, False, poses, record, seen)
            reward, past = judge(lane, task, poses, action, record, live, info)
            store(pair, 0, reward)
            store(pair, 1, past)
            if pair[lanes + i] > 0.5:
                reason = float(JOINT_LIMIT)
        for k in range(n):
            info[(DEFLECTION + n + targets + k) * lanes + i] = outside[12 * n + k]
        info[(tail + IN_RANGE) * lanes + i] = outside[first - 1]
        info[(tail + ERROR) * lanes + i] = p.estimate
        for k in range(5):
            info[(tail + ENERGIES + k) * lanes + i] = outside[14 * n + k]
    if code >= OK:
        settle(lanes, p, arm, pair[i], reason, record, seen, info)
    show(lane, arm // lanes, p.block.shape[0] // p.layout.row, info, p.table)
