"""Cotangents of a control period: from what it comes to, back to its state and action.

The period is gone through once more, each step's end is kept, and they are gone back through in turn; all derivatives
at once, for a few times what the period costs. A block like that of the arms holds cotangents in place of numbers.
Accelerations start afresh with each period (elasticas) or jump with the torques (stiff arms); where motors turn within
a period, with each step.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..compiler import arms, follow, hot, kernel, largest, load, select_lt, size, splat, stack, store, vjp_of
from ..physics.integrator.adjoint import vjp_light, vjp_restart, vjp_step, vjp_switch
from ..physics.integrator.newton import slopes_of
from ..physics.integrator.start import restart
from ..physics.integrator.step import advance
from ..physics.integrator.tangents import prepare
from ..physics.integrator.work import copy_rows, moved_by, rows_of_shift, unpack
from ..physics.layout import POSE
from ..physics.protocol import difference, light, rotates, tangent_map, task_poses, vjp_poses
from ..tasks.program import saved_at, sections
from ..tasks.task import info_of, judge, observe
from .derivative import fill
from .keeping import keep, read_parts, write_parts
from .motors import ask, command, jump, jumps, motors_at, record_commands, starting, turn_motors


class Asked(NamedTuple):
    """What of a work array the commands look at."""

    q: np.ndarray
    v: np.ndarray
    u: np.ndarray
    y: np.ndarray


@kernel
def _see(lane, task, poses, record, action, seen, outcome):
    info = stack(lane, (0,) * info_of(task).end)
    for k in range(info_of(task).end):
        store(info, k, splat(lane, 0.0))
    observe(lane, task, poses, record, seen)
    reward, _ = judge(lane, task, poses, action, record, splat(lane, 1.0), info)
    store(outcome, 0, reward)


def _ask(lane, model, task, controller, amplifier, par, q, v, record, action, u):
    poses, y = stack(lane, (0,) * (POSE.end * size(task.links))), stack(lane, (0,) * size(task.links))
    command(lane, task, controller, amplifier, model, par, action, poses, record, Asked(q, v, u, y))


_vjp_sight = vjp_of(_see, ("poses", "record", "action", "seen", "outcome"))
_vjp_command = vjp_of(_ask, ("par", "q", "v", "record", "action", "u"))
_vjp_commands = vjp_of(record_commands, ("record", "w"))
_vjp_motors = vjp_of(turn_motors, ("record", "w"))


@hot
def adjoint(address, first, last):
    """Cotangents of the states and actions of groups first ... last - 1, from those of what a period comes to."""
    d = follow(address)
    row = d.plain.row
    block, bars = d.block[first * row : (first + 1) * row], d.bars[first * row : (first + 1) * row]
    tape = d.tape[first * d.room : (first + 1) * d.room]
    for g in range(first, last):
        _period(d.lane, d, g, block, bars, tape)
    return 0


@kernel
def _period(lane, d, g, block, bars, tape):
    p, layout, model = d.program, d.plain, d.program.model
    w, bar = unpack(lane, model, block, 0), unpack(lane, model, bars, 0)
    par, poses, record, action, seen, info, saved, _ = sections(layout, block)
    par_bar, poses_bar, record_bar, action_bar, seen_bar, reward_bar, _, _ = sections(layout, bars)
    fill(lane, d, d.places, layout, g, block)
    keep(w, record, saved)
    ask(lane, p, model, par, poses, record, action, w)
    length, more = _length(model, p.task) * len(lane), _more(model) * len(lane)
    start = tape[p.n_steps * length :]
    for s in range(p.n_steps):
        _turn(lane, model, p.task, p.actuator, s, record, w, tape[s * length :])
        if jumps(p.actuator, s):
            jump(lane, p, model, par, s, record, saved, block, w, (0,))
            write_parts(_of_step(lane, model, p.task, w), start[s * (length + more) :])
            write_parts(_of_jump(w), start[s * (length + more) + length :])
        advance(lane, model, None, par, block, 0, 0.0, p.h, 1, p.scheme, None)
        if rotates(model) is not None:
            _, foreseen = moved_by(w)
            difference(lane, model, w.q0, foreseen, foreseen)  # what foresees it moves by is what is kept
        write_parts(_of_step(lane, model, p.task, w), tape[s * length :])
    for i in range(arms(lane)):
        if g * arms(lane) + i < d.n:
            d.failed[g * arms(lane) + i] = np.uint8(w.flag[i])
    _seed(lane, d, g, bars)
    task_poses(lane, model, par, w.q, w.v, poses)
    _vjp_sight(lane, p.task, poses, record, action, seen, info, poses_bar, record_bar, action_bar, seen_bar, reward_bar)
    vjp_poses(lane, model, par, par_bar, w.q, w.v, poses, bar.q, bar.v, poses_bar)
    if rotates(model) is not None:
        tangent_map(lane, model, w.q, True, bar.q)
    slopes = slopes_of(p.scheme, p.h)
    for s in range(p.n_steps - 1, -1, -1):
        read_parts(_of_step(lane, model, p.task, w), tape[s * length :])
        prepare(lane, model, par, w, slopes)
        vjp_step(lane, model, par, par_bar, w, bar, slopes, p.scheme, d.passes)
        if jumps(p.actuator, s):
            read_parts(_of_step(lane, model, p.task, w), start[s * (length + more) :])
            read_parts(_of_jump(w), start[s * (length + more) + length :])
            _vjp_torques_jump(lane, p, par, par_bar, s, record, saved, block, w, bar)
        _vjp_turn(lane, model, p.task, p.actuator, s, record, record_bar, w, bar, tape[s * length :])
    if rotates(model) is not None:
        tangent_map(lane, model, w.q, False, bar.q)
    if p.actuator is not None:
        _vjp_commands(lane, p.task, p.actuator, record, w, record_bar, bar)
    _vjp_command(
        lane, model, p.task, p.controller, p.amplifier, par, w.q, w.v, record, action, w.u,
        par_bar, bar.q, bar.v, record_bar, action_bar, bar.u,
    )  # fmt: skip
    copy_rows(lane, size(model.n_inputs), bar.u0, bar.u)
    _read_off(lane, d, g, bars)


# --- where torques jump -------------------------------------------------------------------------------
@kernel
def _vjp_torques_jump(lane, p, par, par_bar, s, record, saved, block, w, bar):
    """`motors.jump` backwards."""
    if isinstance(p.model.predictor, tuple):
        vjp_restart(lane, p.model, par, par_bar, w, bar, splat(lane, 1.0), p.h)
    elif light(p.model) is not None:
        vjp_light(lane, p.model, par, par_bar, w, bar, p.h, starting(lane, s, record))
    else:
        _vjp_switch(lane, p, par, par_bar, s, record, saved, block, w, bar)


@kernel
def _vjp_switch(lane, p, par, par_bar, s, record, saved, block, w, bar):
    zero, first = splat(lane, 0.0), starting(lane, s, record)
    n, inputs = size(p.model.n), size(p.model.n_inputs)
    vjp_switch(lane, p.model, par, par_bar, w, bar, p.h)
    if largest(first) > 0.5:  # whose torques did not jump: u0 is u
        at = saved_at(0, n, inputs, 0, 0)
        for k in range(inputs):
            both = load(lane, bar.u, k) + load(lane, bar.u0, k)
            store(bar.u, k, select_lt(0.5, first, both, load(lane, bar.u, k)))
            store(bar.u0, k, select_lt(0.5, first, zero, load(lane, bar.u0, k)))
            store(w.u0, k, load(lane, saved, at.inputs + k))
        for k in range(n):
            store(w.a, k, load(lane, saved, at.a + k))
        restart(lane, p.model, None, par, block, 0, 0.0, p.h, True)
        vjp_restart(lane, p.model, par, par_bar, w, bar, first, p.h)


# --- what is kept of each step ----------------------------------------------------------------------
@kernel
def _length(model, task):
    """Numbers kept of a step: q, v, a, what moved q, the torques, and the motors' before it."""
    return _last(model, task) + size(task.links)


@kernel
def _last(model, task):
    """Where of them the motors' torques are."""
    return 3 * size(model.n) + rows_of_shift(model, size(model.n)) + size(task.links)


@kernel
def _more(model):
    """Numbers kept besides where torques jump."""
    return size(model.n_factor) + size(model.n) + size(model.n_inputs)


@kernel
def room_of(model, task, actuator, n_steps):
    """Numbers kept of a period: of each step's end, and of where torques have jumped."""
    times = n_steps if jumps(actuator, 1) else 1
    return n_steps * _length(model, task) + times * (_length(model, task) + _more(model))


@kernel
def _of_step(lane, model, task, w):
    """What is kept where a step ends."""
    shift = w.shift[: rows_of_shift(model, size(model.n)) * len(lane)]
    return w.q, w.v, w.a, shift, w.u[: size(task.links) * len(lane)]


@kernel
def _of_jump(w):
    """What is kept where torques jump: the matrix, factored; accelerations and torques before."""
    return w.S, w.a0, w.u0


# --- motors -----------------------------------------------------------------------------------------
@kernel
def _turn(lane, model, task, actuator, s, record, w, tape):
    """The motors' torques in step s; what they were before is kept last in the tape's numbers of that step."""
    if actuator is not None:
        torques = record[motors_at(task, actuator).torque * len(lane) :]
        copy_rows(lane, size(task.links), torques, tape[_last(model, task) * len(lane) :])
        if s > 0:
            copy_rows(lane, size(model.n_inputs), w.u, w.u0)
        turn_motors(lane, task, actuator, s, record, w)


@kernel
def _vjp_turn(lane, model, task, actuator, s, record, record_bar, w, bar, tape):
    """`turn_motors`, backwards."""
    if actuator is not None:
        torques = record[motors_at(task, actuator).torque * len(lane) :]
        copy_rows(lane, size(task.links), tape[_last(model, task) * len(lane) :], torques)
        _vjp_motors(lane, task, actuator, s, record, w, record_bar, bar)
        if s > 0:
            for k in range(size(model.n_inputs)):
                store(bar.u, k, load(lane, bar.u, k) + load(lane, bar.u0, k))
                store(bar.u0, k, splat(lane, 0.0))


# --- rows -------------------------------------------------------------------------------------------
@kernel
def _seed(lane, d, g, bars):
    """Cotangents of what the period has come to, into a block."""
    for k in range(d.plain.saved // len(lane)):
        store(bars, k, splat(lane, 0.0))
    count, entries = d.places.shape[0], d.chosen.shape[0]
    reward = d.plain.info
    for i in range(len(lane)):
        arm = g * len(lane) + i
        if arm < d.n:
            for k in range(d.moving):
                bars[d.places[k] + i] = d.state_bar[arm * count + k]
            for k in range(entries):
                bars[d.plain.seen + d.chosen[k] * len(lane) + i] += d.observation_bar[arm * entries + k]
            bars[reward + i] = d.reward_bar[arm]


@kernel
def _read_off(lane, d, g, bars):
    """Cotangents of state and action, out of a block."""
    count, joints = d.places.shape[0], size(d.program.task.links)
    for i in range(arms(lane)):
        arm = g * len(lane) + i
        if arm < d.n:
            for k in range(d.moving):
                d.state_bar[arm * count + k] = bars[d.places[k] + i]
            for k in range(joints):
                d.action_bar[arm * joints + k] = bars[d.plain.action + k * len(lane) + i]
