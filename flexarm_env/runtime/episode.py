"""One control period of a batch of arms: everything between an action and an observation.

A `Program` holds all of it, reached by one address (`compiler.entry`). Arms stand in groups of L = len(lane); row g of
`block` belongs to arms g L ... g L + L - 1 and holds, with lanes inside, the sections of `program.Block`. Per arm, not
in lanes: action, observation, reward, flags, and the stream of random numbers.

A lane whose Newton iteration fails is put back to where the period began and reported: the caller repeats that arm
alone, where steps can be halved; its neighbours have gone on, untouched.
"""

from __future__ import annotations

import math

import numpy as np

from ..compiler import absolute, apart, follow, kernel, load, select_lt, size, splat, stack, store
from ..physics.arithmetic import put
from ..physics.integrator.work import unpack
from ..physics.layout import DISSIPATED, WORK_DONE
from ..physics.model import NEWTON_FAILED, NOT_FINITE, OK, OUT_OF_RANGE
from ..physics.protocol import energy, link_poses, out_of_range, ports
from ..tasks.program import (
    ACTION_NOT_FINITE,
    FRESH,
    GUIDED,
    JOINT_LIMIT,
    MODE,
    OVER,
    PERIODS,
    PERIODS_ALLOWED,
    RETRY,
    RUNNING,
    SUCCESS,
    energies_at,
    record_at,
)
from ..tasks.task import info_of, judge, observe
from ..tasks.track import look_ahead, move_targets
from .events import befall, tell
from .fitted import move
from .keeping import keep, put_back
from .sensors import read_gauges, see_motors, sense

OUTCOME = (0, 0)
"""Room for what a period comes to: reward; 1 where a joint is past its limits."""


@kernel
def step(address, first, last):
    """One control period of groups first ... last - 1; returns how many arms want the caller's attention."""
    p = follow(address)
    count = 0
    for g in range(first, last):
        block = p.block[g * p.layout.row : (g + 1) * p.layout.row]
        count += _period(p.lane, p, g, block, unpack(p.lane, p.model, block, 0))
    return count


@apart
def _period(lane, p, g, block, w):
    """One control period of group g; returns how many of its arms have ended, are guided, or must be repeated alone."""
    task, layout, model = p.task, p.layout, p.model
    par, poses = block[layout.par : layout.poses], block[layout.poses : layout.record]
    record, action = block[layout.record : layout.action], block[layout.action : layout.seen]
    seen, info = block[layout.seen : layout.info], block[layout.info : layout.saved]
    saved = block[layout.saved : layout.end]
    _read_actions(lane, task, p.n, p.action, g, action, record, w.flag)
    befall(lane, p, g, par, record, w)
    keep(lane, size(model.n), w, record, saved)
    scratch = block[layout.end : layout.row]
    move(lane, p, p.models, par, poses, record, action, saved, scratch, block, w)
    link_poses(lane, model, par, w.q, w.v, poses)
    move_targets(lane, p.reference, task, p.period, record)
    look(lane, p, False, poses, record, seen)
    read_gauges(lane, p.sensors, p.entries, model, w.q, seen)
    see_motors(lane, p.instruments, model, par, record, w)
    live = _live(lane, p.entries, w.flag, seen)
    outcome = stack(lane, OUTCOME)
    weigh(lane, p, live, poses, action, record, info, outcome)
    tell(lane, p, par, record, w, live, info)
    _note(lane, task, p.actuator, p.estimate, record, w.u, live, info)
    _less_emf(lane, p.amplifier, task, model, par, w, live, info)
    inside = select_lt(out_of_range(lane, model, par, w.q), 0.5, splat(lane, 1.0), splat(lane, 0.0))
    in_range = info_of(task).in_range
    put(live, info, in_range, inside, load(lane, info, in_range))
    note_energies(lane, p.books, task, model, par, record, w, live, info)
    return _close(lane, p, g, w, poses, record, seen, info, saved, outcome)


@kernel
def look(lane, p, first, poses, record, seen):
    """What is to be seen, but for strain gauges, into `seen`. first: at the start of an episode."""
    observe(lane, p.task, poses, record, seen)
    look_ahead(lane, p.reference, p.task, p.period, first, poses, record, seen)


@kernel
def weigh(lane, p, live, poses, action, record, info, outcome):
    """Success and reward of a period: into info where `live` > 1/2, and outcome <- (reward, joint limit passed)."""
    reward, past = judge(lane, p.task, poses, action, record, live, info)
    store(outcome, 0, reward)
    store(outcome, 1, past)


@kernel
def _read_actions(lane, task, n, actions, g, action, record, flag):
    """Clipped actions in lanes; flag: OK for an arm to be moved, another code for one to be left alone."""
    lanes, n_joints = len(lane), size(task.links)
    for i in range(lanes):
        arm = g * lanes + i
        code = float(RETRY)
        if arm < n:
            if record[MODE * lanes + i] == RUNNING:
                code = float(OK)
            for k in range(n_joints):
                a = float(actions[arm * n_joints + k])
                if not math.isfinite(a):
                    a = 0.0
                    if code == OK:
                        code = float(ACTION_NOT_FINITE)
                action[k * lanes + i] = min(1.0, max(-1.0, a))
        flag[i] = code


@kernel
def _live(lane, entries, flag, seen):
    """1 where an arm was moved and is sound; what is not finite is flagged."""
    code = load(lane, flag, 0)
    for k in range(entries):
        finite = select_lt(absolute(load(lane, seen, k)), np.inf, splat(lane, 0.0), splat(lane, float(NOT_FINITE)))
        code = select_lt(code, 0.5, finite, code)
    store(flag, 0, code)
    return select_lt(code, 0.5, splat(lane, 1.0), splat(lane, 0.0))


@kernel
def _note(lane, task, actuator, estimate, record, u, live, info):
    """Torques, error estimate and no reason into info."""
    n, at = size(task.links), info_of(task)
    for k in range(n):
        torque = load(lane, u, k)
        if actuator is not None:
            torque = load(lane, record, record_at(0, n, 1, 0, 0, 0).torque + k)
        put(live, info, at.torque + k, torque, load(lane, info, at.torque + k))
    put(live, info, at.error, splat(lane, estimate), load(lane, info, at.error))
    put(live, info, at.reason, splat(lane, 0.0), load(lane, info, at.reason))


@kernel
def _less_emf(lane, amplifier, task, model, par, w, live, info):
    """Torques into info of motors under voltages: less what the rate takes."""
    if amplifier is not None:
        ports(lane, model, par, w.v, w.y)
        for k in range(size(task.links)):
            at = info_of(task).torque + k
            told = load(lane, info, at)
            put(live, info, at, told - load(lane, w.y, k) * amplifier.emf[k], told)


@kernel
def note_energies(lane, books, task, model, par, record, w, live, info):
    """Energies into info, and the motors' angles and rates."""
    if books is not None:
        kinetic, strain, gravity = energy(lane, model, par, w.q, w.v)
        at = energies_at(info_of(task).energies)
        put(live, info, at.kinetic, kinetic, load(lane, info, at.kinetic))
        put(live, info, at.strain, strain, load(lane, info, at.strain))
        put(live, info, at.gravity, gravity, load(lane, info, at.gravity))
        put(live, info, at.dissipated, load(lane, w.books, DISSIPATED), load(lane, info, at.dissipated))
        put(live, info, at.work, load(lane, w.books, WORK_DONE), load(lane, info, at.work))
        n, motors = size(task.links), info_of(task).motors
        for rates in range(2):
            ports(lane, model, par, w.v if rates else w.q, w.y)
            for k in range(n):
                put(live, info, motors + rates * n + k, load(lane, w.y, k), load(lane, info, motors + rates * n + k))


@kernel
def _close(lane, p, g, w, poses, record, seen, info, saved, outcome):
    """Arm by arm: what the caller sees; returns how many arms have ended, are guided, or must be repeated alone.

    outcome: see `weigh`.
    """
    lanes = len(lane)
    n, reason_at = size(p.model.n), info_of(p.task).reason * lanes
    count = 0
    for i in range(lanes):
        arm = g * lanes + i
        if arm >= p.n:
            continue
        mode, reason = record[MODE * lanes + i], w.flag[i]
        if mode == RUNNING and not (reason == NEWTON_FAILED and lanes > 1):
            if reason == ACTION_NOT_FINITE:
                put_back(lanes, i, n, w, saved, record)
            count += settle(lane, p, arm, outcome, reason, poses, record, seen, info)
            continue
        put_back(lanes, i, n, w, saved, record)
        if mode == RUNNING:
            info[reason_at + i] = float(RETRY)
            count += 1
        elif mode == FRESH:
            record[MODE * lanes + i] = float(RUNNING)
        elif mode == GUIDED:
            count += 1
    show(lane, g, p.block.shape[0] // p.layout.row, info, p.table)
    return count


@kernel
def show(lane, g, groups, info, table):
    """The info of group g into the caller's table."""
    column = table[g * len(lane) :]
    for k in range(info.shape[0] // len(lane)):
        store(column, k * groups, load(lane, info, k))


@kernel
def settle(lane, p, arm, outcome, reason, poses, record, seen, info):
    """The outcome of one arm's period into the arrays that the caller reads; returns 1 where its episode has ended.

    outcome: see `weigh`. reason: a status code, or ACTION_NOT_FINITE.
    """
    task, lanes, i = p.task, len(lane), arm % len(lane)
    reward = outcome[i]
    if reason == OK and outcome[lanes + i] > 0.5:
        reason = float(JOINT_LIMIT)
    n_terms, at = size(task.terms), info_of(task)
    if reason == OK or reason == JOINT_LIMIT:
        sense(lane, p, arm, poses, record, seen, False)
    else:
        info[SUCCESS * lanes + i] = 0.0
        for k in range(at.terms, at.terms + n_terms):
            info[k * lanes + i] = 0.0
        reward = 0.0
    if reason == OUT_OF_RANGE:
        info[at.in_range * lanes + i] = 0.0
    lost = 0.0
    if reason != OK:
        lost = -task.weights[n_terms - 1]
    info[(at.terms + n_terms - 1) * lanes + i] = lost
    info[at.reason * lanes + i] = reason
    steps = record[PERIODS * lanes + i] + 1.0
    record[PERIODS * lanes + i] = steps
    over = steps > record[PERIODS_ALLOWED * lanes + i] - 0.5
    info[at.reward * lanes + i] = reward + lost
    info[at.truncated * lanes + i] = 1.0 if over else 0.0
    p.reward[arm] = reward + lost
    p.terminated[arm] = np.uint8(reason != OK)
    p.truncated[arm] = np.uint8(over)
    if over or reason != OK:
        record[MODE * lanes + i] = float(OVER)
        return 1
    return 0
