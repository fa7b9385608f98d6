"""Convert actions into joint torques: amplifiers, PD controllers, motors with lag, delay and saturation."""

from __future__ import annotations

import math

from ..compiler import Lanes, kernel, max_over_lanes, select_lt, size, stack
from ..physics.arithmetic import clip, decay, store_where
from ..physics.contact.moving import jump_obstacles, open_obstacles
from ..physics.integrator.start import restart
from ..physics.integrator.step import advance
from ..physics.integrator.switching import jump_accelerations
from ..physics.integrator.work import Work, copy_rows
from ..physics.layout import POSE, SPACE_POSE
from ..physics.protocol import input_displacements, task_poses
from ..tasks.program import FURTHER, GOAL, LATE, PERIODS, TORQUE_FACTOR, record_at, saved_at
from ..tasks.stream import draw_whole, uniform
from ..tasks.task import info_of, put_info
from .energy_balance import close_step, open_step
from .events import set_pushes

_NO_LAG = 1e-3  # over h: exp(-1000) is 0
_ANGLE, _RATE = 0, POSE.rate - POSE.angle


@kernel
def _joint(lane, task, poses: Lanes, k, rates):
    """Return the angle (rad) or rate (rad/s) of joint k, from poses of the links in inertial axes.

    rates: which number is returned, `_ANGLE` or `_RATE` (its offset in a planar pose). In the plane a joint's angle is
    the root angle of its link minus the tip angle of the preceding link. Spatial poses (targets of three numbers)
    contain the angle itself.
    """
    if size(task.targets) == 3:
        return poses[SPACE_POSE.end * k + (SPACE_POSE.rate if rates else SPACE_POSE.angle)]
    here = poses[POSE.end * k + POSE.angle + rates]
    if k == 0:
        return here
    return here - poses[POSE.end * (k - 1) + POSE.tip_angle + rates]


@kernel
def _control(lane, task, controller, model, par, poses, record: Lanes, w: Work):
    """Apply the PD joint controllers: w.u <- clip(share w.u + stiffness (goal - angle) - damping rate), N m.

    The angles (rad) and rates (rad/s) are joint angles and rates, from encoders on the link side of the gears. If
    controller.motors is not None, motor angles and rates are used instead. goal: record.goal, rad. controller: share of
    the action's torque, stiffness (N m/rad) and damping (N m s/rad) of each joint. Torques are clipped to
    task.torque_limits.
    # in        w.u, torques of the action;  w.q, w.v;  record.goal
    # scratch   poses, or w.y
    # out       w.u (joints, lanes)
    """
    if controller.motors is None:
        task_poses(lane, model, par, w.q, w.v, poses)
    else:
        input_displacements(lane, model, par, w.q, w.y)
    # k_p (goal - angle)
    for k in range(size(task.links)):
        angle = _joint(lane, task, poses, k, _ANGLE) if controller.motors is None else w.y[k]
        error = record[GOAL + k] - angle
        w.u[k] = w.u[k] * controller.share + error * controller.stiffness[k]
    # - k_d rate; then the torque is clipped to its limits
    if controller.motors is not None:
        input_displacements(lane, model, par, w.v, w.y)
    for k in range(size(task.links)):
        rate = _joint(lane, task, poses, k, _RATE) if controller.motors is None else w.y[k]
        w.u[k] = clip(w.u[k] - rate * controller.damping[k], task.torque_limits[k])


@kernel
def _amplify(lane, task, amplifier, model, par, action: Lanes, factor, w: Work):
    """Convert actions into torques w.u (N m) of motors driven by currents or by voltages.

        current (emf None):  u = factor clip(gain a, limits)
        voltage:             u = clip(factor gain a - emf w, limits) + emf w

    a: action, -1 to 1. gain: torque of the largest current, or of the largest voltage at rest, N m. limits: largest
    torques, N m. emf: back-EMF constant, N m s/rad; w: joint rate, rad/s. factor: drawn factor on the torque constant
    or voltage. With voltages the equations of motion contain emf w as viscous friction. Back-emf therefore acts
    throughout the period, for steps of any length. The term emf w added here keeps the motor's torque within its limits
    at the start of the period. w.y is scratch.
    """
    if amplifier.emf is None:
        for k in range(size(task.links)):
            torque = clip(action[k] * amplifier.gain[k], amplifier.limits[k])
            w.u[k] = torque * factor
    else:
        input_displacements(lane, model, par, w.v, w.y)
        for k in range(size(task.links)):
            held = w.y[k] * amplifier.emf[k]
            asked = action[k] * amplifier.gain[k] * factor
            w.u[k] = clip(asked - held, amplifier.limits[k]) + held


@kernel
def command(lane, task, controller, amplifier, model, par, action: Lanes, poses, record: Lanes, w: Work):
    """Write the commanded joint torques of a control period into w.u, N m.

    If the joints have an amplifier, the amplifier computes the torque. For all other joints the torque is the action
    times the torque limit, plus the torque of PD controllers if the joints have PD controllers. A drawn factor on the
    torque constant multiplies the torque. amplifier, controller: None if absent.
    # in        action (joints, lanes) in [-1, 1];  w.q, w.v;  record.goal, record.torque_factor
    # scratch   poses, w.y
    # out       w.u (joints, lanes)
    """
    factor = record[TORQUE_FACTOR]
    if amplifier is not None:
        _amplify(lane, task, amplifier, model, par, action, factor, w)
    else:
        # u = action tau_max, plus the PD controller's share; times the drawn factor on torques
        for k in range(size(task.links)):
            w.u[k] = action[k] * task.torque_limits[k]
        if controller is not None:
            _control(lane, task, controller, model, par, poses, record, w)
        for k in range(size(task.links)):
            w.u[k] *= factor


@kernel
def take_steps(lane, p, model, parts, par, poses, record, action, saved, block, w):
    """Advance the arms by one control period of p.n_steps steps of p.h seconds, each divided into `parts` equal parts.

    The torque of ideal motors is constant over the period. The torque of other motors (p.actuator) changes in each
    step.
    # in        action (joints, lanes) in [-1, 1];  saved, the state at the start of the period;  par, own parameters
    # in, out   w: q (m, rad), v, a, b, u (inputs, N m and N), books (energy account, J), flag;  block: memory of w
    #           record, torques and commands of the motors
    # scratch   poses
    """
    command_motors(lane, p, model, par, poses, record, action, w)
    # u is constant in the period: a jumps once, then all steps in one call
    if p.actuator is None:
        jump_with_torques(lane, p, model, par, 0, record, saved, block, w)
        advance(lane, model, None, par, block, 0, 0.0, p.h / parts, p.n_steps * parts, p.scheme, p.books)
    else:
        start = stack(lane, p.task.links)
        # u of step s, the jump of a that u - u_0 causes, the step, and the work u (y - y_0) in it
        for s in range(p.n_steps):
            if s > 0:
                copy_rows(lane, size(model.n_inputs), w.u, w.u0)
            update_motor_torques(lane, p.task, p.actuator, s, record, w)
            if may_jump_before_step(p.actuator, s):
                jump_with_torques(lane, p, model, par, s, record, saved, block, w)
            open_step(lane, p, model, par, w, start)
            advance(lane, model, None, par, block, 0, 0.0, p.h / parts, parts, p.scheme, p.books)
            close_step(lane, p, model, par, record, w, start)


@kernel
def command_motors(lane, p, model, par, poses, record, action, w):
    """Write the inputs of a period into w.u (torques, N m; pushes, N), and save the previous period's inputs in w.u0.

    Commands to motors that are not ideal are also stored in the record. `update_motor_torques` reads the delayed
    command there.
    # in        action (joints, lanes) in [-1, 1];  w.q, w.v;  record: goal, torque factor, push
    # scratch   poses, w.y
    # out       w.u, w.u0 (inputs, lanes);  record.commands, newest first;  rows of moving obstacles, and their time
    """
    open_obstacles(lane, model, w, record, PERIODS, p.period)
    copy_rows(lane, size(model.n_inputs), w.u, w.u0)
    set_pushes(lane, p, record, w)
    command(lane, p.task, p.controller, p.amplifier, model, par, action, poses, record, w)
    if p.actuator is not None:
        record_commands(lane, p.task, p.actuator, record, w)


@kernel
def may_jump_before_step(actuator, s):
    """Return whether torques may jump before step s: if s is 0, or before every step if actuator.within is True.

    s: index of the step in its control period, from 0. actuator: the motors' lag and delay; None for ideal motors.
    """
    if actuator is not None:
        if actuator.within is not None:
            return True
    return s == 0


@kernel
def is_starting(lane, s, record: Lanes):
    """Return 1.0 in lanes whose episode begins with step s (from 0) of this period, otherwise 0.0."""
    return select_lt(record[PERIODS] + s, 0.5, 1.0, 0.0)


@kernel
def start_stiff(lane, p, model, par, s, record, saved: Lanes, block, w: Work):
    """Solve for the accelerations of arms whose episode begins with step s; return 1.0 in their lanes, 0.0 in others.

    Other lanes keep the accelerations a and b that were saved at the start of the period. In lanes whose episode
    begins, w.u0 is set to w.u, so that no jump of torques follows. block: memory of the group, of which w is a view.
    # in        saved, accelerations of lanes whose episode continues;  w.u, inputs (N m, N)
    # out       w.a, w.b (m/s^2, rad/s^2), w.u0
    """
    n, first = size(model.n), is_starting(lane, s, record)
    if max_over_lanes(first) > 0.5:
        # a of all lanes is solved; lanes that do not begin get theirs back
        restart(lane, model, None, par, block, 0, 0.0, p.h, True)
        for k in range(size(model.n_inputs)):
            store_where(lane, first, w.u0, k, w.u[k], w.u0[k])
        at = saved_at(0, n, 0, 0, 0)
        for k in range(n):
            store_where(lane, first, w.a, k, w.a[k], saved[at.a + k])
            store_where(lane, first, w.b, k, w.b[k], saved[at.b + k])
    return first


@kernel
def jump_with_torques(lane, p, model, par, s, record, saved, block, w, kept=None):
    """Compute the jump of the accelerations w.a and w.b as inputs jump from w.u0 to w.u (N m, N) before step s.

    For an elastica (`NewtonPolicy.resolved`) the kernel solves for the accelerations anew. Stiff models solve anew only
    when an episode begins, because accelerations solved from round-off in stiff strains would be large
    (`switching.jump_accelerations`). For models with light joints the matrix of the jump includes the joints' damping
    and stiffness. s: number of the step in the period, from 0. saved: state at the start of the period. kept: not None
    if the accelerations before the jump are stored in w.a0.
    """
    if model.newton.resolved is not None:
        jump_obstacles(lane, model, w, p.h)
        restart(lane, model, None, par, block, 0, 0.0, p.h, True)
    elif model.newton.light_joints is not None:
        jump_accelerations(lane, model, par, block, 0, p.h, is_starting(lane, s, record), kept)
    else:
        start_stiff(lane, p, model, par, s, record, saved, block, w)
        jump_accelerations(lane, model, par, block, 0, p.h, None, kept)


@kernel
def motors_at(task, actuator):
    """Return the offsets of the record's fields torque, commands and delays, for motors that are not ideal."""
    return record_at(0, size(task.links), size(task.acted), 1, actuator.rows, 0, 0, 0)


@kernel
def record_commands(lane, task, actuator, record: Lanes, w: Work):
    """Insert the commanded torques w.u (N m) as first row of record.commands and drop the oldest (last) row.

    record.commands (actuator.rows, joints): commands of the last `actuator.rows` control periods, in lanes.
    """
    n, at = size(task.links), motors_at(task, actuator)
    for k in range(n):
        for row in range(actuator.rows - 1, 0, -1):
            record[at.commands + row * n + k] = record[at.commands + (row - 1) * n + k]
        record[at.commands + k] = w.u[k]


@kernel
def update_motor_torques(lane, task, actuator, s, record: Lanes, w: Work):
    """Advance the motors by step s: set w.u to the mean torque and record.torque to the torque at the end, N m.

    A motor's torque approaches its delayed command c by a first-order lag, and saturates:

        tau+ = clip(tau + share (c - tau)),     mean = clip(tau + mean_share (c - tau))

    with share = 1 - exp(-h / lag) and the mean of the share over the step, mean_share. The command is `age` periods
    old, and age + 1 periods old in the first `late` steps of a period. Jitter adds a drawn number of steps to the
    delay.
    # in        record.commands (rows, joints), newest first;  record.late, record.delays, in steps
    # out       w.u, record.torque
    """
    n, at = size(task.links), motors_at(task, actuator)
    share, mean = _lag(lane, task, actuator, record)
    # row of the command that acts in step s; the first `late` steps of a period use the previous period's command
    age = actuator.age + 1 if s < actuator.late else actuator.age
    for k in range(n):
        # command (N m) that acts without jitter
        asked = record[at.commands + age * n + k]
        if actuator.jitter is not None:
            _, period, oldest = actuator.jitter
            late = _lateness(lane, task, actuator, record)
            for older in range(age + 1, oldest + 1):
                # row older - 1 was due `due` steps ago; while the drawn delay is longer, the row behind it still acts
                due = s + (older - 1 - actuator.age) * period - actuator.late
                before = record[at.commands + older * n + k]
                asked = select_lt(due + 0.5, late, before, asked)
        # tau+ = clip(tau + share (c - tau)), and the mean over the step
        torque = record[at.torque + k]
        left = asked - torque
        record[at.torque + k] = clip(torque + left * share, actuator.limits[k])
        w.u[k] = clip(torque + left * mean, actuator.limits[k])


@kernel
def _lag(lane, task, actuator, record: Lanes):
    """Return (share, mean): fraction of the way to its command that a torque covers in a step, and its mean.

    share = 1 - exp(-h / lag) at the end of a step of length h (s); mean: mean of this fraction over the step. If a lag
    is drawn for each episode, both are read from the record; otherwise they are constants of the actuator.
    """
    if actuator.lag is None:
        return actuator.share, actuator.mean
    at = _lag_at(task, actuator)
    return record[at], record[at + 1]


@kernel
def _lag_at(task, actuator):
    """Return the offset in a record of a drawn lag (two numbers), which follows a drawn delay (one number)."""
    at = motors_at(task, actuator).delays
    return at if actuator.drawn is None else at + 1


@kernel
def _lateness(lane, task, actuator, record: Lanes):
    """Return the drawn extra delay of this period's commands (steps), beyond actuator.age and actuator.late."""
    late = record[LATE]
    if actuator.drawn is not None:
        late = late + record[motors_at(task, actuator).delays]
    return late


@kernel
def draw_delay(actuator, task, stream, arm, record, lanes):
    """Draw the command delay (whole steps) of an arm's episode into record.delays, unless the delay is fixed.

    actuator.drawn: least and largest delay (steps), or None for a fixed delay. arm: index of the arm in the batch.
    lanes: number of arms in a group.
    """
    if actuator is not None and actuator.drawn is not None:
        record[motors_at(task, actuator).delays * lanes + arm % lanes] = draw_whole(stream, arm, actuator.drawn)


@kernel
def draw_lag(p, arm, record, info, lanes):
    """Draw the motors' lag for an arm's episode into the record and, in s, into `info`, unless the lag is fixed.

    The record stores share = 1 - exp(-h / lag), the fraction of the way to the command in a step, and the mean of this
    fraction over the step. arm: index of the arm in the batch. lanes: number of arms in a group.
    """
    if p.actuator is not None and p.actuator.lag is not None:
        least, most = p.actuator.lag
        lag, at = least + (most - least) * uniform(p.stream, arm), _lag_at(p.task, p.actuator) * lanes + arm % lanes
        share = 1.0 - decay(1.0 / max(lag, _NO_LAG))
        record[at], record[at + lanes] = share, 1.0 - share * lag
        info[(info_of(p.task).further + FURTHER.told + 2) * lanes + arm % lanes] = lag * p.h


@kernel
def record_delay(lane, p, record, live, info):
    """Write the delay (s) of this period's commands into info of running arms, if the delay is random."""
    actuator = p.actuator
    if actuator is not None and actuator.jitter is not None:
        late = _lateness(lane, p.task, actuator, record) + float(actuator.age * p.n_steps + actuator.late)
        put_info(lane, live, info, info_of(p.task).further + FURTHER.told, late * p.h)


@kernel
def draw_lateness(actuator, stream, arm, record, lanes):
    """Draw the extra delay of the next period's commands into record.late; no-op without random delays.

    The extra delay is a whole number of steps from 0 to actuator.jitter[0]. arm: index of the arm in the batch. lanes:
    number of arms in a group.
    """
    if actuator is not None and actuator.jitter is not None:
        drawn = math.floor(uniform(stream, arm) * (actuator.jitter[0] + 1.0))
        record[LATE * lanes + arm % lanes] = drawn
