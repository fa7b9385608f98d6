"""One control period of a batch of arms, and their fresh starts: everything between an action and an observation.

A Program holds all of it, reached by one address (`address.py`). Arms stand in groups of L = len(lane); row g of
`block` belongs to arms g L ... g L + L - 1 and holds, with lanes inside, the sections of `Layout`. Per arm, not in
lanes: action, observation, reward, flags, and the stream of random numbers.

A lane whose Newton iteration fails is put back to where the period began and reported: the caller repeats that arm
alone, where steps can be halved; its neighbours have gone on, untouched.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from ..model import NEWTON_FAILED, NOT_FINITE, OK
from .address import follow
from .jit import kernel
from .lanes import SINGLE, absolute, load, select_lt, splat, store
from .newmark import advance, restart, unpack
from .protocol import energy, link_poses, out_of_range, size
from .task import (
    DEFLECTION,
    ENERGIES,
    ERROR,
    FRESH,
    GOAL,
    GUIDED,
    IN_RANGE,
    LIMIT,
    MODE,
    OVER,
    REASON,
    RUNNING,
    STEP,
    TARGET,
    TORQUE_FACTOR,
    aim,
    judge,
    observe,
    put,
)

ACTION_NOT_FINITE, JOINT_LIMIT, RETRY = 100, 101, 102
"""Reasons for an end beside the status codes of `model`; RETRY: to be repeated alone."""


class Layout(NamedTuple):
    """Where the sections of a block begin (in float64), lanes inside."""

    par: int  # 4: payload mass, payload inertia, EI factor, tau_d
    poses: int  # 12 a link
    record: int  # see task.py
    action: int  # 1 a joint, clipped
    seen: int  # the scaled observation
    info: int  # see task.py
    saved: int  # q, v, a, b at the period's start, then books (3)
    end: int
    row: int  # length of a block, in whole cache lines


class Ranges(NamedTuple):
    """What a fresh start is drawn from, uniformly; tables by rows, ranges (low, high). N links, n rows of the state."""

    pose: np.ndarray  # (n, 1 + 3 N): q = pose (1, alpha_k, cos alpha_k, sin alpha_k), alpha the links' absolute angles
    shake: np.ndarray  # (n, 3): velocities of a unit of initial vibration: constant, cos and sin of alpha_0
    nominal: np.ndarray  # (4,) of par
    start: np.ndarray  # (N, 2) rad, joint angles
    target: np.ndarray  # (2, 2): rad (slew, from the start), or m and rad (reach, polar)
    straight: float  # share of starts with all joints at 0
    vibration: float  # largest initial vibration, as a tip deflection over L
    factors: np.ndarray  # (4, 2): payload, EI, damping, torque constant


class Program(NamedTuple):
    """A batch of arms with its task. Shapes: n arms, A joints, O entries of the observation."""

    lane: tuple[int, ...]
    model: Any
    scheme: Any
    task: Any
    ranges: Ranges
    layout: Layout
    books: bool
    estimate: float  # of the formulation's own error, as a fraction of L
    h: float
    n_steps: int
    n: int
    block: np.ndarray  # (groups row,)
    action: np.ndarray  # (n A,) float32
    observation: np.ndarray  # (n O,) float32
    reward: np.ndarray  # (n,)
    terminated: np.ndarray  # (n,) uint8
    truncated: np.ndarray  # (n,) uint8
    stream: np.ndarray  # (n,) uint64
    wish: np.ndarray  # (A + 3,): start angles, target, vibration wished for; NaN: drawn


@kernel
def _period(lane, p, g):  # type: ignore[no-untyped-def]
    """One control period of group g; returns how many of its arms have ended or must be repeated alone."""
    block = _block(p, g)
    return _move(lane, p, g, block, unpack(lane, p.model, block, 0))


@kernel
def _block(p, g):  # type: ignore[no-untyped-def]
    return p.block[g * p.layout.row : (g + 1) * p.layout.row]


@kernel
def _section(lane, block, first, entries):  # type: ignore[no-untyped-def]
    return block[first : first + entries * len(lane)]


@kernel
def _move(lane, p, g, block, w):  # type: ignore[no-untyped-def]
    task, layout, lanes = p.task, p.layout, len(lane)
    n_joints, n_seen = size(task.links), size(task.entries)
    par = _section(lane, block, layout.par, 4)
    poses = _section(lane, block, layout.poses, 12 * n_joints)
    record = block[layout.record : layout.action]
    action = _section(lane, block, layout.action, n_joints)
    seen = _section(lane, block, layout.seen, n_seen)
    info = block[layout.info : layout.saved]
    saved = block[layout.saved : layout.end]
    _read_actions(p, g, lanes, action, record, w.flag)
    _keep(lane, p.model, w, saved)
    _drive(lane, task, action, record, w.u)
    restart(lane, p.model, None, par, block, 0, 0.0, p.h)
    advance(lane, p.model, None, par, block, 0, 0.0, p.h, p.n_steps, p.scheme, p.books)
    link_poses(lane, p.model, par, w.q, w.v, poses)
    observe(lane, task, poses, record, seen)
    flag = load(lane, w.flag, 0)
    for k in range(n_seen):
        finite = select_lt(absolute(load(lane, seen, k)), np.inf, splat(lane, 0.0), splat(lane, float(NOT_FINITE)))
        flag = select_lt(flag, 0.5, finite, flag)
    store(w.flag, 0, flag)
    live = select_lt(flag, 0.5, splat(lane, 1.0), splat(lane, 0.0))
    reward, past = judge(lane, task, poses, action, record, live, info)
    _note(lane, p, par, w, live, info)
    store(action, 0, reward)  # two rows of lanes handed on
    store(poses, 0, past)
    return _close(lane, p, g, w, record, seen, info, saved, action, poses)


@kernel
def _read_actions(p, g, lanes, action, record, flag):  # type: ignore[no-untyped-def]
    """Clipped actions in lanes; flag: OK for an arm to be moved, another code for one to be left alone."""
    n_joints = size(p.task.links)
    for i in range(lanes):
        arm = g * lanes + i
        code = float(RETRY)
        if arm < p.n:
            if record[MODE * lanes + i] == RUNNING:
                code = float(OK)
            for k in range(n_joints):
                a = float(p.action[arm * n_joints + k])
                if not math.isfinite(a):
                    a = 0.0
                    if code == OK:
                        code = float(ACTION_NOT_FINITE)
                store(action, k * lanes + i, min(1.0, max(-1.0, a)))
        store(flag, i, code)


@kernel
def _drive(lane, task, action, record, u):  # type: ignore[no-untyped-def]
    """Joint torques for this period."""
    factor = load(lane, record, TORQUE_FACTOR)
    for k in range(size(task.links)):
        store(u, k, load(lane, action, k) * task.torque_limits[k] * factor)


@kernel
def _keep(lane, model, w, saved):  # type: ignore[no-untyped-def]
    n = size(model.n)
    for k in range(n):
        store(saved, k, load(lane, w.q, k))
        store(saved, n + k, load(lane, w.v, k))
        store(saved, 2 * n + k, load(lane, w.a, k))
        store(saved, 3 * n + k, load(lane, w.b, k))
    for k in range(3):
        store(saved, 4 * n + k, load(lane, w.books, k))


@kernel
def _put_back(lanes, i, model, w, saved):  # type: ignore[no-untyped-def]
    """Lane i as it was when the period began."""
    n = size(model.n)
    for k in range(n):
        store(w.q, k * lanes + i, saved[k * lanes + i])
        store(w.v, k * lanes + i, saved[(n + k) * lanes + i])
        store(w.a, k * lanes + i, saved[(2 * n + k) * lanes + i])
        store(w.b, k * lanes + i, saved[(3 * n + k) * lanes + i])
    for k in range(3):
        store(w.books, k * lanes + i, saved[(4 * n + k) * lanes + i])


@kernel
def _tail(task):  # type: ignore[no-untyped-def]
    """First entry of the tail of info."""
    return DEFLECTION + 2 * size(task.links) + size(task.targets) + size(task.terms)


@kernel
def _note(lane, p, par, w, live, info):  # type: ignore[no-untyped-def]
    """Torques, range, error estimate and energies into info."""
    task = p.task
    n, tail = size(task.links), _tail(task)
    torques = DEFLECTION + n + size(task.targets)
    for k in range(n):
        put(live, info, torques + k, load(lane, w.u, k), load(lane, info, torques + k))
    code = out_of_range(lane, p.model, par, w.q)
    inside = select_lt(code, 0.5, splat(lane, 1.0), splat(lane, 0.0))
    put(live, info, tail + IN_RANGE, inside, load(lane, info, tail + IN_RANGE))
    put(live, info, tail + ERROR, splat(lane, p.estimate), load(lane, info, tail + ERROR))
    put(live, info, tail + REASON, splat(lane, 0.0), load(lane, info, tail + REASON))
    if p.books:
        kinetic, strain, gravity = energy(lane, p.model, par, w.q, w.v)
        first = tail + ENERGIES
        put(live, info, first, kinetic, load(lane, info, first))
        put(live, info, first + 1, strain, load(lane, info, first + 1))
        put(live, info, first + 2, gravity, load(lane, info, first + 2))
        put(live, info, first + 3, load(lane, w.books, 1), load(lane, info, first + 3))
        put(live, info, first + 4, load(lane, w.books, 0), load(lane, info, first + 4))


@kernel
def _close(lane, p, g, w, record, seen, info, saved, reward, past):  # type: ignore[no-untyped-def]
    """Arm by arm: what the caller sees; returns how many arms have ended or must be repeated alone."""
    lanes, n_joints = len(lane), size(p.task.links)
    failure = DEFLECTION + 2 * n_joints + size(p.task.targets) + size(p.task.terms) - 1
    reason_at = _tail(p.task) + REASON
    penalty = p.task.weights[size(p.task.terms) - 1]
    count = 0
    for i in range(lanes):
        arm = g * lanes + i
        if arm >= p.n:
            break
        mode = record[MODE * lanes + i]
        if mode != RUNNING:
            _put_back(lanes, i, p.model, w, saved)
            if mode == FRESH:
                store(record, MODE * lanes + i, float(RUNNING))
            elif mode == GUIDED:
                count += 1
            continue
        reason = w.flag[i]
        if reason == ACTION_NOT_FINITE:
            _put_back(lanes, i, p.model, w, saved)
        elif reason == NEWTON_FAILED and lanes > 1:
            _put_back(lanes, i, p.model, w, saved)
            store(info, reason_at * lanes + i, float(RETRY))
            count += 1
            continue
        elif reason == OK and past[i] > 0.5:
            reason = float(JOINT_LIMIT)
        _settle(p, arm, lanes, i, record, seen, info, reward[i], reason, failure, reason_at, penalty)
        if p.terminated[arm] + p.truncated[arm] > 0:
            count += 1
    return count


@kernel
def _settle(p, arm, lanes, i, record, seen, info, reward, reason, failure, reason_at, penalty):  # type: ignore[no-untyped-def]
    """The outcome of one arm's period into the arrays that the caller reads."""
    if reason == OK or reason == JOINT_LIMIT:
        for k in range(size(p.task.entries)):
            p.observation[arm * size(p.task.entries) + k] = np.float32(seen[k * lanes + i])
    else:
        first = failure + 1 - size(p.task.terms)
        for k in range(first, failure):
            store(info, k * lanes + i, 0.0)
        store(info, 0 * lanes + i, 0.0)
        reward = 0.0
    lost = 0.0
    if reason != OK:
        lost = -penalty
        store(record, MODE * lanes + i, float(OVER))
    store(info, failure * lanes + i, lost)
    store(info, reason_at * lanes + i, reason)
    steps = record[STEP * lanes + i] + 1.0
    store(record, STEP * lanes + i, steps)
    over = steps > record[LIMIT * lanes + i] - 0.5
    if over:
        store(record, MODE * lanes + i, float(OVER))
    p.reward[arm] = reward + lost
    p.terminated[arm] = np.uint8(reason != OK)
    p.truncated[arm] = np.uint8(over)


@kernel
def step(address, first, last):  # type: ignore[no-untyped-def]
    """One control period of groups first ... last - 1; returns how many arms want the caller's attention."""
    p = follow(address)
    count = 0
    for g in range(first, last):
        count += _period(p.lane, p, g)
    return count


# --- fresh starts ------------------------------------------------------------------------------------


@kernel
def uniform(stream, arm):  # type: ignore[no-untyped-def]
    """The next number of an arm's stream, in [0, 1): SplitMix64 (Steele, Lea & Flood 2014)."""
    z = stream[arm] + np.uint64(0x9E3779B97F4A7C15)
    stream[arm] = z
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    return float(z >> np.uint64(11)) * 1.1102230246251565e-16


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
def _begin(lane, p, arm, mode):  # type: ignore[no-untyped-def]
    g = arm // len(lane)
    block = _block(p, g)
    _start(lane, p, arm, mode, block, unpack(lane, p.model, block, 0))


@kernel
def _start(lane, p, arm, mode, block, w):  # type: ignore[no-untyped-def]
    """Arm `arm` at a fresh start: draw it, put it there, and look at it."""
    task, layout, lanes = p.task, p.layout, len(lane)
    i, n_joints = arm % lanes, size(task.links)
    record = block[layout.record : layout.action]
    info = block[layout.info : layout.saved]
    par = _section(lane, block, layout.par, 4)
    own = np.zeros(16)
    _draw(p, arm, own)
    for k in range(4):
        store(par, k * lanes + i, own[12 + k])
    _place_arm(p, lanes, i, own, w)
    mine = np.zeros(layout.action // lanes - layout.record // lanes)
    mine[LIMIT] = record[LIMIT * lanes + i]
    mine[MODE], mine[TORQUE_FACTOR] = float(mode), own[8]
    mine[TARGET], mine[TARGET + 1] = own[5], own[6]
    for k in range(n_joints):
        mine[GOAL + k] = own[k]
    aim(task, mine)
    for k in range(info.shape[0] // lanes):
        store(info, k * lanes + i, 0.0)
    _look(p, lanes, arm, mine, par, w, record, info)


@kernel
def _draw(p, arm, own):  # type: ignore[no-untyped-def]
    """own: 0-3 joint angles, 4 vibration, 5-6 target, 8 torque constant, 12-15 par. As many draws for any wish."""
    ranges, stream, wish, n = p.ranges, p.stream, p.wish, size(p.task.links)
    straight = uniform(stream, arm) < ranges.straight
    for k in range(n):
        angle = _between(stream, arm, ranges.start, k)
        own[k] = _given(wish[k], 0.0 if straight else angle)
    first, second = _between(stream, arm, ranges.target, 0), _between(stream, arm, ranges.target, 1)
    if size(p.task.targets) == 1:
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
def _place_arm(p, lanes, i, own, w):  # type: ignore[no-untyped-def]
    """Straight links at their joint angles, at rest but for the initial vibration; books at zero."""
    pose, shake, n = p.ranges.pose, p.ranges.shake, size(p.task.links)
    cosine, sine = math.cos(own[0]), math.sin(own[0])
    for row in range(size(p.model.n)):
        o = row * (1 + 3 * n)
        alpha, value = 0.0, pose[o]
        for k in range(1, 1 + n):
            alpha += own[k - 1]
            value += pose[o + k] * alpha + pose[o + n + k] * math.cos(alpha) + pose[o + 2 * n + k] * math.sin(alpha)
        store(w.q, row * lanes + i, value)
        rate = shake[3 * row] + shake[3 * row + 1] * cosine + shake[3 * row + 2] * sine
        store(w.v, row * lanes + i, rate * own[4])
        store(w.a, row * lanes + i, 0.0)
        store(w.b, row * lanes + i, 0.0)
    for k in range(w.u.shape[0] // lanes):
        store(w.u, k * lanes + i, 0.0)
    for k in range(3):
        store(w.books, k * lanes + i, 0.0)
    store(w.flag, i, 0.0)


@kernel
def _look(p, lanes, arm, mine, par, w, record, info):  # type: ignore[no-untyped-def]
    """Observation and info of one arm at its start."""
    task, i, n = p.task, arm % lanes, size(p.model.n)
    q, v, own_par = np.empty(n), np.empty(n), np.empty(4)
    for k in range(n):
        q[k], v[k] = w.q[k * lanes + i], w.v[k * lanes + i]
    for k in range(4):
        own_par[k] = par[k * lanes + i]
    poses, seen = np.empty(12 * size(task.links)), np.empty(size(task.entries))
    action, own_info = np.zeros(size(task.links)), np.zeros(info.shape[0] // lanes)
    link_poses(SINGLE, p.model, own_par, q, v, poses)
    observe(SINGLE, task, poses, mine, seen)
    judge(SINGLE, task, poses, action, mine, 1.0, own_info)
    tail = _tail(task)
    for k in range(size(task.terms)):
        own_info[tail - 1 - k] = 0.0
    own_info[tail + IN_RANGE], own_info[tail + ERROR] = 1.0, p.estimate
    if p.books:
        kinetic, strain, gravity = energy(SINGLE, p.model, own_par, q, v)
        own_info[tail + ENERGIES], own_info[tail + ENERGIES + 1] = kinetic, strain
        own_info[tail + ENERGIES + 2] = gravity
    for k in range(size(task.entries)):
        p.observation[arm * size(task.entries) + k] = np.float32(seen[k])
    for k in range(own_info.shape[0]):
        store(info, k * lanes + i, own_info[k])
    for k in range(mine.shape[0]):
        store(record, k * lanes + i, mine[k])
    p.reward[arm], p.terminated[arm], p.truncated[arm] = 0.0, np.uint8(0), np.uint8(0)


@kernel
def begin(address, arm, mode):  # type: ignore[no-untyped-def]
    """A fresh start of one arm, drawn from its stream, in a mode."""
    p = follow(address)
    _begin(p.lane, p, arm, mode)
