"""From actions to joint torques: amplifiers, controllers under the action, motors with lag, delay and saturation."""

from __future__ import annotations

import math

from ..compiler import kernel, largest, load, select_lt, size, splat, store
from ..physics.arithmetic import clip, put
from ..physics.integrator.start import restart
from ..physics.integrator.step import advance
from ..physics.integrator.switching import switch
from ..physics.integrator.work import copy_rows
from ..physics.layout import POSE, SPACE_POSE
from ..physics.protocol import light, ports, task_poses
from ..tasks.program import FURTHER, GOAL, LATE, PERIODS, TORQUE_FACTOR, record_at, saved_at
from ..tasks.stream import draw_whole, uniform
from ..tasks.task import info_of, put_info
from .events import set_pushes

_ANGLE, _RATE = 0, POSE.rate - POSE.angle


@kernel
def _joint(lane, task, poses, k, rates):
    """Angle (_ANGLE) or rate (_RATE) of joint k."""
    if size(task.targets) == 3:
        return load(lane, poses, SPACE_POSE.end * k + (SPACE_POSE.rate if rates else SPACE_POSE.angle))
    here = load(lane, poses, POSE.end * k + POSE.angle + rates)
    if k == 0:
        return here
    return here - load(lane, poses, POSE.end * (k - 1) + POSE.tip_angle + rates)


@kernel
def _control(lane, task, controller, model, par, poses, record, w):
    """w.u <- what the controllers make of the action's torques in it, by encoders on the links' side of the gears, or
    on motors that have angles of their own."""
    if controller.motors is None:
        task_poses(lane, model, par, w.q, w.v, poses)
    else:
        ports(lane, model, par, w.q, w.y)
    for k in range(size(task.links)):
        angle = _joint(lane, task, poses, k, _ANGLE) if controller.motors is None else load(lane, w.y, k)
        error = load(lane, record, GOAL + k) - angle
        store(w.u, k, load(lane, w.u, k) * controller.share + error * controller.stiffness[k])
    if controller.motors is not None:
        ports(lane, model, par, w.v, w.y)
    for k in range(size(task.links)):
        rate = _joint(lane, task, poses, k, _RATE) if controller.motors is None else load(lane, w.y, k)
        store(w.u, k, clip(load(lane, w.u, k) - rate * controller.damping[k], task.torque_limits[k]))


@kernel
def _amplify(lane, task, amplifier, model, par, action, factor, w):
    """w.u <- torques, N m, of what the amplifiers are asked for: shares of the largest currents or voltages.

    factor: on the torque of a current, or on a voltage. A voltage makes u = gain a less emf times the rate, which is
    viscous friction to the equations of motion, so that it holds throughout the period and for steps of any length;
    limits of current and torque are looked at at its start.
    """
    if amplifier.emf is None:
        for k in range(size(task.links)):
            torque = clip(load(lane, action, k) * amplifier.gain[k], amplifier.limits[k])
            store(w.u, k, torque * factor)
    else:
        ports(lane, model, par, w.v, w.y)
        for k in range(size(task.links)):
            held = load(lane, w.y, k) * amplifier.emf[k]
            asked = load(lane, action, k) * amplifier.gain[k] * factor
            store(w.u, k, clip(asked - held, amplifier.limits[k]) + held)


@kernel
def command(lane, task, controller, amplifier, model, par, action, poses, record, w):
    """w.u <- torques asked for, N m: what the amplifiers make of the action, or its share of the limits, or what the
    controllers make of that."""
    factor = load(lane, record, TORQUE_FACTOR)
    if amplifier is not None:
        _amplify(lane, task, amplifier, model, par, action, factor, w)
    else:
        for k in range(size(task.links)):
            store(w.u, k, load(lane, action, k) * task.torque_limits[k])
        if controller is not None:
            _control(lane, task, controller, model, par, poses, record, w)
        for k in range(size(task.links)):
            store(w.u, k, load(lane, w.u, k) * factor)


@kernel
def take_steps(lane, p, model, parts, par, poses, record, action, saved, block, w):
    """The steps of one period under an action, each in so many parts; motors that are not ideal in each step anew."""
    ask(lane, p, model, par, poses, record, action, w)
    if p.actuator is None:
        jump(lane, p, model, par, 0, record, saved, block, w)
        advance(lane, model, None, par, block, 0, 0.0, p.h / parts, p.n_steps * parts, p.scheme, p.books)
    else:
        for s in range(p.n_steps):
            if s > 0:
                copy_rows(lane, size(model.n_inputs), w.u, w.u0)
            turn_motors(lane, p.task, p.actuator, s, record, w)
            if jumps(p.actuator, s):
                jump(lane, p, model, par, s, record, saved, block, w)
            advance(lane, model, None, par, block, 0, 0.0, p.h / parts, parts, p.scheme, p.books)


@kernel
def ask(lane, p, model, par, poses, record, action, w):
    """w.u <- inputs of a period, u0 those before; what motors are asked for they remember."""
    copy_rows(lane, size(model.n_inputs), w.u, w.u0)
    set_pushes(lane, p, record, w)
    command(lane, p.task, p.controller, p.amplifier, model, par, action, poses, record, w)
    if p.actuator is not None:
        record_commands(lane, p.task, p.actuator, record, w)


@kernel
def jumps(actuator, s):
    """Whether torques may jump ahead of step s of a period."""
    if actuator is not None:
        if actuator.within is not None:
            return True
    return s == 0


@kernel
def starting(lane, s, record):
    """1 in lanes where an episode begins with step s of a period."""
    return select_lt(load(lane, record, PERIODS) + splat(lane, s), 0.5, splat(lane, 1.0), splat(lane, 0.0))


@kernel
def start_stiff(lane, p, model, par, s, record, saved, block, w):
    """1 in lanes where an episode begins, whose accelerations are solved for; elsewhere they stay."""
    n, first = size(model.n), starting(lane, s, record)
    if largest(first) > 0.5:
        restart(lane, model, None, par, block, 0, 0.0, p.h, True)
        for k in range(size(model.n_inputs)):
            put(first, w.u0, k, load(lane, w.u, k), load(lane, w.u0, k))
        at = saved_at(0, n, 0, 0, 0)
        for k in range(n):
            put(first, w.a, k, load(lane, w.a, k), load(lane, saved, at.a + k))
            put(first, w.b, k, load(lane, w.b, k), load(lane, saved, at.b + k))
    return first


@kernel
def jump(lane, p, model, par, s, record, saved, block, w, kept=None):
    """Accelerations jump with the torques, from w.u0 to w.u, ahead of step s of a period.

    They are solved afresh where nothing is stiff, the elastica (a pair as predictor); elsewhere where an episode begins
    only (`switching.switch` says why). kept: as there.
    """
    if isinstance(model.predictor, tuple):
        restart(lane, model, None, par, block, 0, 0.0, p.h, True)
    elif light(model) is not None:
        switch(lane, model, par, block, 0, p.h, starting(lane, s, record), kept)
    else:
        start_stiff(lane, p, model, par, s, record, saved, block, w)
        switch(lane, model, par, block, 0, p.h, None, kept)


@kernel
def motors_at(task, actuator):
    """Where in the record the motors' fields are."""
    return record_at(0, size(task.links), size(task.acted), 1, actuator.rows, 0, 0, 0)


@kernel
def record_commands(lane, task, actuator, record, w):
    """Remember what the motors are asked for, w.u."""
    n, at = size(task.links), motors_at(task, actuator)
    for k in range(n):
        for row in range(actuator.rows - 1, 0, -1):
            store(record, at.commands + row * n + k, load(lane, record, at.commands + (row - 1) * n + k))
        store(record, at.commands + k, load(lane, w.u, k))


@kernel
def turn_motors(lane, task, actuator, s, record, w):
    """w.u <- the motors' torques in step s of a period, their mean over it; what they end with they remember."""
    n, at = size(task.links), motors_at(task, actuator)
    age = actuator.age + 1 if s < actuator.late else actuator.age
    for k in range(n):
        asked = load(lane, record, at.commands + age * n + k)
        if actuator.jitter is not None:
            _, period, oldest = actuator.jitter
            late = _lateness(lane, task, actuator, record)
            for older in range(age + 1, oldest + 1):
                due = s + (older - 1 - actuator.age) * period - actuator.late
                before = load(lane, record, at.commands + older * n + k)
                asked = select_lt(splat(lane, due + 0.5), late, before, asked)
        torque = load(lane, record, at.torque + k)
        left = asked - torque
        store(record, at.torque + k, clip(torque + left * actuator.share, actuator.limits[k]))
        store(w.u, k, clip(torque + left * actuator.mean, actuator.limits[k]))


@kernel
def _lateness(lane, task, actuator, record):
    """Steps by which this period's commands come later than they always do."""
    late = load(lane, record, LATE)
    if actuator.drawn is not None:
        late = late + load(lane, record, motors_at(task, actuator).delays)
    return late


@kernel
def draw_delay(actuator, task, stream, arm, record, lanes):
    """By how many steps the commands of arm's episode come late, where that is drawn."""
    if actuator is not None and actuator.drawn is not None:
        record[motors_at(task, actuator).delays * lanes + arm % lanes] = draw_whole(stream, arm, actuator.drawn)


@kernel
def record_delay(lane, p, record, live, info):
    """How late the period's commands came into info, where that is drawn."""
    actuator = p.actuator
    if actuator is not None and actuator.jitter is not None:
        late = _lateness(lane, p.task, actuator, record) + float(actuator.age * p.n_steps + actuator.late)
        put_info(lane, live, info, info_of(p.task).further + FURTHER.told, late * p.h)


@kernel
def draw_lateness(actuator, stream, arm, record, lanes):
    """How late the commands of arm's next period come, where that is drawn."""
    if actuator is not None and actuator.jitter is not None:
        drawn = math.floor(uniform(stream, arm) * (actuator.jitter[0] + 1.0))
        record[LATE * lanes + arm % lanes] = drawn
