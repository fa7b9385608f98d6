"""Fresh starts: an arm drawn from its stream, put in its place, and looked at; and arms that are moved elsewhere."""

from __future__ import annotations

import math

import numpy as np

from ..model import OK
from .address import follow
from .environment import settle, tail_of
from .jit import kernel
from .lanes import SINGLE
from .newmark import unpack
from .program import (
    DEFLECTION,
    ENERGIES,
    ERROR,
    HOLD,
    GOAL,
    IN_RANGE,
    JOINT_LIMIT,
    LIMIT,
    MODE,
    TARGET,
    TORQUE_FACTOR,
)
from .protocol import energy, link_poses, size
from .sensors import read_gauges, sense, uniform
from .task import aim, judge, observe
from .track import look_ahead, start_path


@kernel
def begin(address, arm, mode):  # type: ignore[no-untyped-def]
    """A fresh start of one arm, drawn from its stream, in a mode."""
    p = follow(address)
    g = arm // len(p.lane)
    block = p.block[g * p.layout.row : (g + 1) * p.layout.row]
    _start(p, arm, mode, block, unpack(p.lane, p.model, block, 0))


@kernel
def _start(p, arm, mode, block, w):  # type: ignore[no-untyped-def]
    task, layout, lanes = p.task, p.layout, len(p.lane)
    i, n_joints, n = arm % lanes, size(task.links), size(p.model.n)
    record = block[layout.record : layout.action]
    own = np.zeros(16)
    _draw(task, p.ranges, p.stream, p.wish, arm, own)
    limit = record[LIMIT * lanes + i]
    for k in range(record.shape[0] // lanes):
        record[k * lanes + i] = 0.0
    record[LIMIT * lanes + i], record[MODE * lanes + i] = limit, float(mode)
    record[TORQUE_FACTOR * lanes + i] = own[8]
    record[TARGET * lanes + i], record[(TARGET + 1) * lanes + i] = own[5], own[6]
    q, v, par = np.empty(n), np.empty(n), own[12:16]
    _place(p.ranges.pose, p.ranges.shake, n_joints, own, q, v)
    for k in range(n):
        w.q[k * lanes + i], w.v[k * lanes + i] = q[k], v[k]
        w.a[k * lanes + i], w.b[k * lanes + i] = 0.0, 0.0
    for k in range(4):
        block[layout.par + k * lanes + i] = par[k]
    for k in range(n_joints):
        w.u[k * lanes + i] = 0.0
        record[(GOAL + k) * lanes + i] = own[k]
    for k in range(3):
        w.books[k * lanes + i] = 0.0
    start_path(p.reference, task, p.stream, arm, record, lanes)
    poses, energies = np.empty(12 * n_joints), np.zeros(6)
    link_poses(SINGLE, p.model, par, q, v, poses)
    energies[0], energies[1], energies[2] = _energies(p.books, p.model, par, q, v)
    energies[5] = 1.0
    seen = np.zeros(p.entries)
    read_gauges(SINGLE, p.sensors, p.entries, p.model, q, seen)
    _look(p, arm, block, poses, np.zeros(n_joints), np.zeros(n_joints), energies, seen, True)


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
def _energies(books, model, par, q, v):  # type: ignore[no-untyped-def]
    """Kinetic, strain and gravity energy where energies are kept."""
    if books is not None:
        return energy(SINGLE, model, par, q, v)
    return 0.0, 0.0, 0.0


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
def _place(pose, shake, n_joints, own, q, v):  # type: ignore[no-untyped-def]
    """Straight links at their joint angles, at rest but for the initial vibration."""
    cosine, sine = math.cos(own[0]), math.sin(own[0])
    for row in range(q.shape[0]):
        o = row * (1 + 3 * n_joints)
        alpha, value = 0.0, pose[o]
        for k in range(n_joints):
            alpha += own[k]
            value += pose[o + 1 + k] * alpha
            value += pose[o + 1 + n_joints + k] * math.cos(alpha) + pose[o + 1 + 2 * n_joints + k] * math.sin(alpha)
        q[row] = value
        v[row] = (shake[3 * row] + shake[3 * row + 1] * cosine + shake[3 * row + 2] * sine) * own[4]


@kernel
def _look(p, arm, block, poses, torques, action, energies, seen, first):  # type: ignore[no-untyped-def]
    """Observation and info of one arm from its poses (12 N), torques, energies (5) and whether it is in range.

    first: at the start of an episode, where there is no reward yet. Returns (reward, joint limit passed).
    """
    task, layout, lanes = p.task, p.layout, len(p.lane)
    i, n, targets, tail = arm % lanes, size(task.links), size(task.targets), tail_of(task)
    record, info = block[layout.record : layout.action], block[layout.info : layout.saved]
    mine, own = np.empty(record.shape[0] // lanes), np.zeros(info.shape[0] // lanes)
    for k in range(mine.shape[0]):
        mine[k] = record[k * lanes + i]
    if first:
        mine[HOLD] = 0.0
        aim(task, mine)
    observe(SINGLE, task, poses, mine, seen)
    look_ahead(1, p.reference, task, p.period, first, poses, mine, seen)
    reward, past = judge(SINGLE, task, poses, action, mine, 1.0, own)
    for k in range(n):
        own[DEFLECTION + n + targets + k] = torques[k]
    if first:
        for k in range(tail - size(task.terms), tail):
            own[k] = 0.0
    own[tail + IN_RANGE], own[tail + ERROR] = energies[5], p.estimate
    for k in range(5):
        own[tail + ENERGIES + k] = energies[k]
    for k in range(mine.shape[0]):
        record[k * lanes + i] = mine[k]
    for k in range(own.shape[0]):
        info[k * lanes + i] = own[k]
    for k in range(p.entries):
        block[layout.seen + k * lanes + i] = seen[k]
    if first:
        sense(lanes, p.sensors, p.entries, p.stream, arm, record, block[layout.seen : layout.info], p.observation, True)
        p.reward[arm], p.terminated[arm], p.truncated[arm] = 0.0, np.uint8(0), np.uint8(0)
    return reward, past


@kernel
def witness(address, arm, code):  # type: ignore[no-untyped-def]
    """The outcome of a period of an arm that was moved elsewhere, told in `p.outside`; code: its status, or -1 for the
    start of its episode."""
    p = follow(address)
    g, n = arm // len(p.lane), size(p.task.links)
    block = p.block[g * p.layout.row : (g + 1) * p.layout.row]
    _witness(p, arm, code, block, p.outside[: 12 * n], p.outside[12 * n : 13 * n], p.outside[13 * n : 14 * n])


@kernel
def _witness(p, arm, code, block, poses, torques, action):  # type: ignore[no-untyped-def]
    layout, n, reward, reason = p.layout, size(p.task.links), 0.0, float(code)
    energies, seen = p.outside[14 * n : 14 * n + 6], np.zeros(p.entries)
    for k in range(14 * n + 6, p.outside.shape[0]):  # gauges
        at = p.entries - (p.outside.shape[0] - k)
        seen[at] = p.outside[k]
    if code <= OK:
        reward, past = _look(p, arm, block, poses, torques, action, energies, seen, code < OK)
        if past > 0.5:
            reason = float(JOINT_LIMIT)
    if code >= OK:
        record, info = block[layout.record : layout.action], block[layout.info : layout.saved]
        settle(len(p.lane), p, arm, reward, reason, record, block[layout.seen : layout.info], info)

