"""One control period of a batch of arms: everything between an action and an observation.

A `Program` holds all of it, reached by one address (`compiler.entry`). Arms stand in groups of L = len(lane); row g of
`block` belongs to arms g L ... g L + L - 1 and holds, with lanes inside, the sections of `program.Block`. Per arm, not
in lanes: action, observation, reward, flags, and the stream of random numbers.

`_period` is the algorithm. A lane whose Newton iteration fails is put back to where the period began and reported: the
caller repeats that arm alone, where steps can be halved; its neighbours have gone on, untouched.
"""

from __future__ import annotations

import math

import numpy as np

from ..compiler import absolute, apart, follow, hot, kernel, load, select_lt, size, splat, stack, store
from ..physics.integrator.work import unpack
from ..physics.layout import DISSIPATED, WORK_DONE
from ..physics.model import NEWTON_FAILED, NOT_FINITE, OK, OUT_OF_RANGE
from ..physics.protocol import energy, out_of_range, ports, task_poses
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
    sections,
)
from ..tasks.task import info_of, judge, observe, put_info
from ..tasks.track import look_ahead, move_targets
from .events import apply_events, record_events
from .fitted import move, record_step_error
from .keep_out import record_clearance
from .keeping import keep, put_back
from .motors import draw_lateness, record_delay
from .sensors import read_gauges, record_motor_angles, write_observation

OUTCOME = (0, 0)
"""Room for what a period comes to: reward; 1 where a joint is past its limits."""


@hot
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
    par, poses, record, action, seen, info, saved, scratch = sections(p.layout, block)
    outcome = stack(lane, OUTCOME)
    read_actions(lane, p, g, action, record, w.flag)
    apply_events(lane, p, g, par, record, w)
    keep(w, record, saved)
    move(lane, p, p.models, p.model, 1, par, poses, record, action, saved, scratch, block, w)
    task_poses(lane, p.model, par, w.q, w.v, poses)
    move_targets(lane, p.reference, p.task, p.period, record)
    observe_state(lane, p, False, poses, record, seen)
    observe_material(lane, p, par, record, w, seen)
    live = find_sound(lane, p.entries, w.flag, seen)
    reward(lane, p, live, poses, action, record, info, outcome)
    record_clearance(lane, p, g, w.q, live, info)
    record_period(lane, p, par, record, scratch, w, live, info, outcome)
    return finish(lane, p, g, w, poses, record, seen, info, saved, outcome)


@kernel
def read_actions(lane, p, g, action, record, flag):
    """Clipped actions in lanes; flag: OK for an arm to be moved, another code for one to be left alone."""
    lanes, n_joints = len(lane), size(p.task.links)
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
                action[k * lanes + i] = min(1.0, max(-1.0, a))
        flag[i] = code


# --- observation and reward ----------------------------------------------------------------------------
@kernel
def observe_state(lane, p, first, poses, record, seen):
    """The true observation, but for strain gauges, into `seen`. first: at the start of an episode."""
    observe(lane, p.task, poses, record, seen)
    look_ahead(lane, p.reference, p.task, p.period, first, poses, record, seen)


@kernel
def observe_material(lane, p, par, record, w, seen):
    """Strain gauges into `seen`; motors' angles to where their encoders will find them."""
    read_gauges(lane, p.sensors, p.entries, p.model, w.q, seen)
    record_motor_angles(lane, p.instruments, p.model, par, record, w)


@kernel
def find_sound(lane, entries, flag, seen):
    """1 where an arm was moved and is sound; what is not finite is flagged."""
    code = load(lane, flag, 0)
    for k in range(entries):
        finite = select_lt(absolute(load(lane, seen, k)), np.inf, splat(lane, 0.0), splat(lane, float(NOT_FINITE)))
        code = select_lt(code, 0.5, finite, code)
    store(flag, 0, code)
    return select_lt(code, 0.5, splat(lane, 1.0), splat(lane, 0.0))


@kernel
def reward(lane, p, live, poses, action, record, info, outcome):
    """Success and reward of a period: into info where `live` > 1/2, and outcome <- (reward, joint limit passed)."""
    total, past = judge(lane, p.task, poses, action, record, live, info)
    store(outcome, 0, total)
    store(outcome, 1, past)


# --- info ----------------------------------------------------------------------------------------------
@kernel
def record_period(lane, p, par, record, scratch, w, live, info, outcome):
    """What a period came to into info where `live` > 1/2, but for what `reward` says; what it costs, into outcome."""
    at = info_of(p.task)
    record_events(lane, p, par, record, w, live, info, outcome)
    record_step_error(lane, p, scratch, live, info)
    record_torques(lane, p, par, record, w, live, info)
    record_delay(lane, p, record, live, info)
    put_info(lane, live, info, at.error, splat(lane, p.estimate))
    put_info(lane, live, info, at.reason, splat(lane, 0.0))
    inside = select_lt(out_of_range(lane, p.model, par, w.q), 0.5, splat(lane, 1.0), splat(lane, 0.0))
    put_info(lane, live, info, at.in_range, inside)
    record_energies(lane, p, par, w, live, info)


@kernel
def record_torques(lane, p, par, record, w, live, info):
    """Torques of the joints into info; of motors under voltages less what the rate takes."""
    n, at = size(p.task.links), info_of(p.task).torque
    emf = None
    if p.amplifier is not None:
        emf = p.amplifier.emf
    if emf is not None:
        ports(lane, p.model, par, w.v, w.y)
    for k in range(n):
        torque = load(lane, w.u, k)
        if p.actuator is not None:
            torque = load(lane, record, record_at(0, n, size(p.task.acted), 1, 0, 0, 0, 0).torque + k)
        if emf is not None:
            torque = torque - load(lane, w.y, k) * emf[k]
        put_info(lane, live, info, at + k, torque)


@kernel
def record_energies(lane, p, par, w, live, info):
    """Energies into info, and the motors' angles and rates."""
    if p.books is not None:
        kinetic, strain, gravity = energy(lane, p.model, par, w.q, w.v)
        at = energies_at(info_of(p.task).energies)
        put_info(lane, live, info, at.kinetic, kinetic)
        put_info(lane, live, info, at.strain, strain)
        put_info(lane, live, info, at.gravity, gravity)
        put_info(lane, live, info, at.dissipated, load(lane, w.books, DISSIPATED))
        put_info(lane, live, info, at.work, load(lane, w.books, WORK_DONE))
        n, motors = size(p.task.links), info_of(p.task).motors
        for rates in range(2):
            ports(lane, p.model, par, w.v if rates else w.q, w.y)
            for k in range(n):
                put_info(lane, live, info, motors + rates * n + k, load(lane, w.y, k))


@kernel
def copy_info(lane, p, g, info):
    """The info of group g into the caller's table."""
    column = p.table[g * len(lane) :]
    for k in range(info.shape[0] // len(lane)):
        store(column, k * (p.block.shape[0] // p.layout.row), load(lane, info, k))


# --- the end of a period, arm by arm -------------------------------------------------------------------
@kernel
def finish(lane, p, g, w, poses, record, seen, info, saved, outcome):
    """What the caller reads of each arm; returns how many arms have ended, are guided, or must be repeated alone.

    outcome: see `reward`.
    """
    lanes, reason_at, count = len(lane), info_of(p.task).reason * len(lane), 0
    for i in range(lanes):
        arm = g * lanes + i
        if arm >= p.n:
            continue
        mode, reason = record[MODE * lanes + i], w.flag[i]
        if mode == RUNNING and not (reason == NEWTON_FAILED and lanes > 1):
            if reason == ACTION_NOT_FINITE:
                put_back(lanes, i, w, saved, record)
            count += finish_arm(lane, p, arm, outcome, reason, poses, record, seen, info)
            continue
        put_back(lanes, i, w, saved, record)
        if mode == RUNNING:
            info[reason_at + i] = float(RETRY)
            count += 1
        elif mode == FRESH:
            record[MODE * lanes + i] = float(RUNNING)
        elif mode == GUIDED:
            count += 1
    copy_info(lane, p, g, info)
    return count


@kernel
def finish_arm(lane, p, arm, outcome, reason, poses, record, seen, info):
    """The outcome of one arm's period into the arrays that the caller reads; returns 1 where its episode has ended.

    outcome: see `reward`. reason: a status code, or ACTION_NOT_FINITE.
    """
    task, lanes, i = p.task, len(lane), arm % len(lane)
    total = outcome[i]
    if reason == OK and outcome[lanes + i] > 0.5:
        reason = float(JOINT_LIMIT)
    n_terms, at = size(task.terms), info_of(task)
    if reason == OK or reason == JOINT_LIMIT:
        write_observation(lane, p, arm, poses, record, seen, False)
        draw_lateness(p.actuator, p.stream, arm, record, lanes)
    else:
        info[SUCCESS * lanes + i] = 0.0
        for k in range(at.terms, at.terms + n_terms):
            info[k * lanes + i] = 0.0
        total = 0.0
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
    info[at.reward * lanes + i] = total + lost
    info[at.truncated * lanes + i] = 1.0 if over else 0.0
    p.reward[arm] = total + lost
    p.terminated[arm] = np.uint8(reason != OK)
    p.truncated[arm] = np.uint8(over)
    if over or reason != OK:
        record[MODE * lanes + i] = float(OVER)
        return 1
    return 0
