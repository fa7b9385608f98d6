"""Reverse derivative of a control period: from cotangents of its results to cotangents of initial state and action.

The period is run once more, and the state at the end of each step is stored on a tape. After the run the steps are
processed in reverse order. One reverse pass computes all derivatives of one scalar, for a few times the cost of the
period. A block with the layout of the arms' block contains cotangents: x_bar, the cotangent of a number x, is the
derivative of the scalar by x. At the start of each period the accelerations of elastica arms are solved for anew,
whereas the accelerations of stiff arms jump with the torques. Torques that change within a period change at the start
of a step.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..compiler import (
    Lanes,
    absolute,
    dereference,
    entry_point,
    inlined,
    kernel,
    lane_count,
    load,
    select_lt,
    size,
    splat,
    stack,
    store,
    vjp_of,
)
from ..physics.integrator.newton import newmark_slopes
from ..physics.integrator.step import advance, newmark_predict
from ..physics.integrator.step_derivatives import factor_step_end, vjp_step
from ..physics.integrator.transitions import vjp_jump
from ..physics.integrator.work import accumulated_increment, copy_rows, reset_shift, shift_size, unpack
from ..physics.model import NEWTON_FAILED
from ..physics.protocol import local_difference, tangent_map, task_poses, vjp_poses
from ..tasks.own_terms import judge_with_terms
from ..tasks.program import GOAL, PERIODS, sections
from ..tasks.task import info_of, observe
from ..tasks.track import list_ahead, move_targets, turn_ahead
from .derivative import arm_in, close, fill, write_outcome
from .keeping import read_parts, save_lanes, write_parts
from .motors import (
    command,
    command_motors,
    is_starting,
    jump_with_torques,
    may_jump_before_step,
    motors_at,
    record_commands,
    update_motor_torques,
)
from .sensors import read_gauges


class Asked(NamedTuple):
    """Rows of the integrator's work array that `motors.command` reads and writes."""

    q: Lanes  # (n,) coordinates of the arm, m and rad
    v: Lanes  # (n,) velocities, m/s and rad/s
    u: Lanes  # (inputs,) joint torques, N m
    y: Lanes  # (joints,) scratch memory


@kernel
def _see(lane, p, q, poses, record, action, seen, outcome):
    """Compute the scaled true observation `seen` and the reward (outcome row 0) from q, poses, record and action.

    # in        q (m, rad), poses (inertial axes, m, rad and rates), record, action (joints, lanes)
    # in, out   seen (entries, lanes): in: a moving target's future (`track.list_ahead`); out: scaled
    # out       outcome
    All info is scratch here. This function exists so that the compiler can differentiate it in reverse mode (`vjp_of`).
    """
    info = stack(lane, (0,) * info_of(p.task).end)
    for k in range(info_of(p.task).end):
        store(info, k, splat(lane, 0.0))
    observe(lane, p.task, poses, record, seen)
    turn_ahead(lane, p.reference, p.task, poses, seen)
    read_gauges(lane, p.sensors, p.entries, p.model, q, seen)
    reward, _ = judge_with_terms(lane, p.task, poses, action, record, splat(lane, 1.0), info)
    store(outcome, 0, reward)


@kernel
def _ask(lane, model, task, controller, amplifier, par, q, v, record, action, poses, y, u):
    """Write the commanded joint torques (N m) into u, from state, record and action (`motors.command`).

    # in        q (m, rad), v, record, action (joints, lanes) in [-1, 1]
    # scratch   poses, y
    # out       u (joints, lanes)
    """
    command(lane, task, controller, amplifier, model, par, action, poses, record, Asked(q, v, u, y))


_vjp_sight = vjp_of(_see, ("q", "poses", "record", "action", "seen", "outcome"))
_vjp_command = vjp_of(_ask, ("par", "q", "v", "record", "action", "u"), scratch=("poses", "y"))
_vjp_commands = vjp_of(record_commands, ("record", "w"))
_vjp_motors = vjp_of(update_motor_torques, ("record", "w"))


@entry_point
def adjoint(address, first, last):
    """Compute the cotangents of states and actions of groups first ... last - 1 from those of the periods' results.

    address: address of a `Derivative` d. The inputs are d.state_bar (cotangent of the state at the end of the period),
    d.observation_bar and d.reward_bar. The outputs are d.state_bar (cotangent of the state at the start of the period),
    d.action_bar and d.failed. The blocks and the tape of group `first` are used for all groups. Returns 0.
    """
    d = dereference(address)
    row = d.plain.row
    block, bars = d.block[first * row : (first + 1) * row], d.bars[first * row : (first + 1) * row]
    tape = d.tape[first * d.room : (first + 1) * d.room]
    for g in range(first, last):
        _period(d.lane, d, g, block, bars, tape)
    return 0


@kernel
def _period(lane, d, g, block, bars, tape):
    """Compute the cotangents of group g's states and actions: a forward pass onto the tape, then the reverse pass.

    # block     scratch, the group's numbers;  bars  scratch, their cotangents, with the same sections
    # tape      scratch: `_length` numbers a step, then `_length` + `_more` for each jump of torques
    """
    p, layout, model = d.program, d.plain, d.program.model
    w, bar = unpack(lane, model, block, 0), unpack(lane, model, bars, 0)
    par, poses, record, action, seen, info, _, _ = sections(layout, block)
    _, poses_bar, record_bar, action_bar, seen_bar, reward_bar, _, _ = sections(layout, bars)
    par_bar = _parameters(d, bars)
    _run(lane, d, g, block, tape, w, None)
    length, more = _length(model, p.task) * len(lane), _more(model) * len(lane)
    start = tape[p.n_steps * length :]
    # cotangents of observation and reward, through poses (inertial axes), to q, v, a at the period's end
    for i in range(lane_count(lane)):
        if g * lane_count(lane) + i < d.n:
            d.failed[g * lane_count(lane) + i] = np.uint8(w.flag[i])
    _seed(lane, d, g, bars)
    task_poses(lane, model, par, w.q, w.v, poses)
    _vjp_outcome(
        lane, p, w.q, poses, record, action, seen, info, bar.q, poses_bar, record_bar, action_bar, seen_bar, reward_bar
    )
    vjp_poses(lane, model, par, par_bar, w.q, w.v, poses, bar.q, bar.v, poses_bar)
    # cotangents of rotation vectors become those of body-axes increments
    if model.newton.rotations is not None:
        tangent_map(lane, model, w.q, True, bar.q)
    # steps, jumps and motors from the last to the first, because a cotangent needs the state that it belongs to
    slopes = newmark_slopes(p.scheme, p.h)
    for s in range(p.n_steps - 1, -1, -1):
        read_parts(_of_step(lane, model, w), tape[s * length :])
        factor_step_end(lane, model, par, w, slopes)
        vjp_step(lane, model, par, par_bar, w, bar, slopes, p.scheme, d.passes)
        if may_jump_before_step(p.actuator, s):
            read_parts(_of_step(lane, model, w), start[s * (length + more) :])
            read_parts(_of_jump(w), start[s * (length + more) + length :])
            vjp_jump(lane, model, par, par_bar, w, bar, p.h, is_starting(lane, s, record))
        _vjp_turn(lane, model, p.task, p.actuator, s, record, record_bar, w, bar, tape[s * length :])
    # back to cotangents of rotation vectors: T^T, the inverse of the map above
    if model.newton.rotations is not None:
        tangent_map(lane, model, w.q, False, bar.q)
    # commands in the record come from the actions, and through a PD controller from q and v
    if p.actuator is not None:
        _vjp_commands(lane, p.task, p.actuator, record, w, record_bar, bar)
    _vjp_command(
        lane, model, p.task, p.controller, p.amplifier, par, w.q, w.v, record, action, poses, w.y, w.u,
        par_bar, bar.q, bar.v, record_bar, action_bar, bar.u,
    )  # fmt: skip
    copy_rows(lane, size(model.n_inputs), bar.u0, bar.u)
    _read_off(lane, d, g, bars)


@kernel
def _run(lane, d, g, block, tape, w, recording):
    """Run group g's period with the ends of its steps and jumps on the tape, or in d.step_ends; w: views of `block`.

    recording: a tag to write d.step_ends, but no steps and jumps on the tape; None for the tape.
    # in        d.state, d.action;  d.step_ends if d.known[0] > 0, without the tag
    # out       block, w;  tape: `_length` numbers a step, then `_length` + `_more` for each jump of torques
    """
    p, layout, model = d.program, d.plain, d.program.model
    par, poses, record, action, _, _, saved, _ = sections(layout, block)
    # q, v, a at each step's end are needed backwards
    fill(lane, d, d.places, layout, g, block)
    save_lanes(w, record, saved)
    command_motors(lane, p, model, par, poses, record, action, w)
    length, more = _length(model, p.task) * len(lane), _more(model) * len(lane)
    start = tape[p.n_steps * length :]
    for s in range(p.n_steps):
        _turn(lane, model, p.task, p.actuator, s, record, w, tape[s * length :])
        # a jump of a by u - u_0: its state, S, a and u_0 before it go behind the ends of all steps
        if may_jump_before_step(p.actuator, s):
            jump_with_torques(lane, p, model, par, s, record, saved, block, w, (0,))
            if recording is None:
                write_parts(_of_step(lane, model, w), start[s * (length + more) :])
                write_parts(_of_jump(w), start[s * (length + more) + length :])
        _step(lane, d, g, s, par, block, w, recording)
        if recording is None:
            write_parts(_of_step(lane, model, w), tape[s * length :])


@kernel
def _step(lane, d, g, s, par, block, w, recording):
    """Advance group g by step s. In models with rotations `foreseen` in w becomes the prediction's increment.

    recording: a tag to write d.step_ends instead; None without.
    """
    p, model = d.program, d.program.model
    if recording is not None:
        advance(lane, model, None, par, block, 0, 0.0, p.h, 1, p.scheme, None)
        _record_step(lane, d, g, s, w)
    elif model.newton.rotations is None:
        advance(lane, model, None, par, block, 0, 0.0, p.h, 1, p.scheme, None)
    else:
        if d.known[0] > 0.0:
            _repeat_step(lane, d, g, s, w)
        else:
            advance(lane, model, None, par, block, 0, 0.0, p.h, 1, p.scheme, None)
        # stored: the increment by which the prediction moves q, in place of the prediction
        foreseen = accumulated_increment(lane, w)[1]
        local_difference(lane, model, w.q0, foreseen, foreseen)


@kernel
def _record_step(lane, d, g, s, w):
    """Write q and v of group g at the end of step s into d.step_ends; NaN for an arm whose solver failed."""
    n = size(d.program.model.n)
    for i in range(lane_count(lane)):
        arm = g * lane_count(lane) + i
        if arm < d.n:
            at = (arm * d.program.n_steps + s) * 2 * n
            for k in range(n):
                d.step_ends[at + k], d.step_ends[at + n + k] = w.q[k * len(lane) + i], w.v[k * len(lane) + i]
            if w.flag[i] != 0.0:
                d.step_ends[at] = np.nan


@kernel
def _repeat_step(lane, d, g, s, w):
    """Advance group g by step s without a solution: q and v at its end are d.step_ends, a and b follow by (6.1).

    Lanes whose step_ends are NaN get the status of a failed iteration.
    """
    model, n = d.program.model, size(d.program.model.n)
    slopes, total = newmark_slopes(d.program.scheme, d.program.h), accumulated_increment(lane, w)[0]
    newmark_predict(lane, model, w, d.program.h, d.program.scheme)
    reset_shift(lane, model, w)
    for i in range(lane_count(lane)):
        at = (arm_in(lane, d.n, g, i) * d.program.n_steps + s) * 2 * n
        for k in range(n):
            w.shift[k * len(lane) + i] = d.step_ends[at + k]
            w.v[k * len(lane) + i] = d.step_ends[at + n + k]
    # D = q+ (-) p
    local_difference(lane, model, w.q, total, w.r)
    copy_rows(lane, n, total, w.q)
    copy_rows(lane, n, w.r, total)
    for k in range(n):
        change = load(lane, w.r, k)
        store(w.a, k, load(lane, w.a, k) + change * slopes.a)
        store(w.b, k, load(lane, w.b, k) + change * slopes.b)
    flag = load(lane, w.flag, 0)
    store(w.flag, 0, select_lt(absolute(load(lane, w.q, 0)), np.inf, flag, float(NEWTON_FAILED)))


@entry_point
def recorded_step(address, first, last):
    """Advance groups first ... last - 1 by one period like `derivative.step`; write d.step_ends as well. Returns 0.

    address: address of a `Derivative` d of a model with rotations. Step_ends of an arm whose solver fails are NaN.
    """
    d = dereference(address)
    block = d.block[first * d.plain.row : (first + 1) * d.plain.row]
    tape = d.tape[first * d.room : (first + 1) * d.room]
    w = unpack(d.lane, d.program.model, block, 0)
    for g in range(first, last):
        _record(d.lane, d, g, block, tape, w)
    return 0


@kernel
def _record(lane, d, g, block, tape, w):
    """Advance group g by one period; write the period's results and d.step_ends. w: views of `block`."""
    _run(lane, d, g, block, tape, w, (0,))
    close(lane, d.program, d.plain, block, w)
    write_outcome(lane, d, d.places, d.plain, g, block)


@inlined
def _parameters(d, bars):
    """Return the cotangents of the arms' own parameters in a block of cotangents, or None if they are not computed."""
    if d.parameters is None:
        return None
    return bars[d.plain.par : d.plain.poses]


@kernel
def _vjp_outcome(
    lane, p, q, poses, record: Lanes, action, seen, info, q_bar, poses_bar, record_bar, action_bar, seen_bar, reward_bar
):
    """Apply the reverse derivative of `_see` at the end of a period, when targets have moved, to the cotangents.

    record: as at the start of the period, also afterwards.
    """
    links = size(p.task.links)
    start = stack(lane, p.task.links)
    copy_rows(lane, links, record[GOAL * len(lane) :], start)
    move_targets(lane, p.reference, p.task, p.period, record)
    record[PERIODS] += 1.0
    list_ahead(lane, p.reference, p.task, p.period, True, record, seen)
    _vjp_sight(
        lane, p, q, poses, record, action, seen, info, q_bar, poses_bar, record_bar, action_bar, seen_bar, reward_bar
    )
    # commands of the period depend on its start's goal angles
    record[PERIODS] -= 1.0
    copy_rows(lane, links, start, record[GOAL * len(lane) :])


@kernel
def _length(model, task):
    """Return the number of values stored per step: q, v, a, increment of q, inputs, earlier motor torques."""
    return _last(model) + size(task.links)


@kernel
def _last(model):
    """Return the offset of the motors' torques among the numbers stored per step."""
    return 3 * size(model.n) + shift_size(model, size(model.n)) + size(model.n_inputs)


@kernel
def _more(model):
    """Return the number of values stored per jump of torques: factors, and earlier accelerations and inputs."""
    return size(model.n_factor) + size(model.n) + size(model.n_inputs)


@kernel
def room_of(model, task, actuator, n_steps):
    """Return the length of one arm's tape, which stores the ends of a period's steps and the jumps of torques."""
    times = n_steps if may_jump_before_step(actuator, 1) else 1
    return n_steps * _length(model, task) + times * (_length(model, task) + _more(model))


@kernel
def _of_step(lane, model, w):
    """Return the views of w that are stored at the end of a step: q, v, a, increment of q, inputs."""
    return w.q, w.v, w.a, w.shift[: shift_size(model, size(model.n)) * len(lane)], w.u


@kernel
def _of_jump(w):
    """Return the views of w stored at a jump of torques: factored matrix, accelerations and torques before it."""
    return w.S, w.a0, w.u0


@kernel
def _turn(lane, model, task, actuator, s, record, w, tape):
    """Store the motors' torques in the tape's part for step s, then update them for the step.

    # in, out   record.torque (joints, lanes), N m, from the start to the end of the step
    # out       w.u, mean torques over the step; w.u0, torques before the step;  tape
    The torque of ideal motors (actuator None) does not change.
    """
    if actuator is not None:
        torques = record[motors_at(task, actuator).torque * len(lane) :]
        copy_rows(lane, size(task.links), torques, tape[_last(model) * len(lane) :])
        if s > 0:
            copy_rows(lane, size(model.n_inputs), w.u, w.u0)
        update_motor_torques(lane, task, actuator, s, record, w)


@kernel
def _vjp_turn(lane, model, task, actuator, s, record, record_bar, w, bar, tape):
    """Apply the reverse derivative of `motors.update_motor_torques` in step s, to record_bar and bar.u.

    The motors' torques before the step are read from the tape.
    """
    if actuator is not None:
        torques = record[motors_at(task, actuator).torque * len(lane) :]
        copy_rows(lane, size(task.links), tape[_last(model) * len(lane) :], torques)
        _vjp_motors(lane, task, actuator, s, record, w, record_bar, bar)
        # u_0 was a copy of u: its cotangent adds to that of the u before
        if s > 0:
            for k in range(size(model.n_inputs)):
                store(bar.u, k, load(lane, bar.u, k) + load(lane, bar.u0, k))
                store(bar.u0, k, splat(lane, 0.0))


@kernel
def _seed(lane, d, g, bars):
    """Clear the cotangent block of group g and set the cotangents of final state, observation and reward.

    # in        d.state_bar, d.observation_bar, d.reward_bar, arm by arm
    # out       bars, a block of cotangents in lanes; row 0 of its info holds the reward's
    """
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
    """Copy the cotangents of group g's states and actions from the block `bars` to d.state_bar and d.action_bar."""
    count, joints = d.places.shape[0], size(d.program.task.links)
    for i in range(lane_count(lane)):
        arm = g * len(lane) + i
        if arm < d.n:
            for k in range(d.moving):
                d.state_bar[arm * count + k] = bars[d.places[k] + i]
            for k in range(joints):
                d.action_bar[arm * joints + k] = bars[d.plain.action + k * len(lane) + i]
