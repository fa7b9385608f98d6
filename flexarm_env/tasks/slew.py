"""The task `Slew`: turn the tip of one link to a polar angle and hold it there."""

import math

from ..compiler import Lanes, absolute, kernel, select_lt, sincos, size
from ..physics.arithmetic import arctangent, decay, minimum
from ..physics.layout import BASE_POSE, POSE
from .program import DEFLECTION, GOAL, MOVING, PATH, TARGET, TARGET_RATE
from .stream import uniform
from .task import (
    TASKS,
    Task,
    deflection,
    effort,
    hub_angle,
    left_of,
    level,
    of_base,
    past_limits,
    put_info,
    record_success,
    record_tip,
    reward_attitude,
    reward_change,
    reward_term,
    settled,
    show_base,
    show_scaled,
    squared_turn,
)

_PATH, _MOVING = PATH.places, MOVING.places


class Slew(Task):
    """Constants of the task "slew"; `envs.flexible_arm` describes observation and reward."""

    __slots__ = ()


@kernel
def _error(lane, task, poses: Lanes, record: Lanes, normal, along):
    """Return the target angle less the tip's polar angle about the root, rad; with task.turns reduced to +-pi.

    normal, along: components of the vector from root to tip, m, across and along link 0's root section.
    """
    error = record[TARGET] - (poses[POSE.angle] + arctangent(normal, along))
    if task.turns is not None:
        sine, cosine = sincos(error)
        return arctangent(sine, cosine)
    return error


@kernel
def slew_observe(lane, task, poses: Lanes, record, out):
    """Write the scaled observation: hub angle and rate, tip deflection and its rate, and angle error.

    Entries: sine and cosine of the hub angle, relative to a floating base; hub rate (rad/s); tip deflection across the
    root's tangent, divided by L; deflection rate divided by L (1/s); target minus tip angle (rad), within +-pi if
    task.turns is not None, otherwise with all turns; seven entries of a floating base. Each entry is divided by its
    scale and clipped to +-10. poses: pose of the link, inertial axes; record: records of the arms; the target is read.
    """
    normal, along, rate, _, _, _, _, sine, cosine = deflection(lane, poses, 0)
    # hub angle as (sin, cos), against a floating base where there is one
    hub_sine, hub_cosine = hub_angle(lane, task, poses, sine, cosine)
    show_scaled(lane, task, out, 0, hub_sine)
    show_scaled(lane, task, out, 1, hub_cosine)
    show_scaled(lane, task, out, 2, poses[POSE.rate] - of_base(lane, task, poses, BASE_POSE.rate))
    show_scaled(lane, task, out, 3, normal / task.length)
    show_scaled(lane, task, out, 4, rate / task.length)
    show_scaled(lane, task, out, 5, _error(lane, task, poses, record, normal, along))
    show_base(lane, task, poses, sine, cosine, out)


@kernel
def slew_judge(lane, task, poses, action, record: Lanes, live, info):
    """Write success, info and reward terms of a tip that turns to an angle; return (reward, joint limit passed).

    e: magnitude of tip angle minus target (rad). slip: tip rate minus target rate (rad/s). rate: deflection rate
    divided by L (1/s).

        accuracy exp(-(10 e)^2), settle exp(-(50 e)^2 - (5 slip)^2), distance by min(e, 1) (`left_of`; if task.turns is
        not None, e in half turns), effort -sum action^2, vibration -min(rate^2, 1)

    In the total each term is multiplied by its weight. A floating base adds a term for its attitude. If the environment
    prices changes of actions, the price adds another term. If task.paid is not None, settle is 1 / (1 + s^2)
    (`settled`). s is the sum of squares of e, slip and rate (and of a base's attitude), each divided by its success
    band. poses: pose of the link, inertial axes; info is written for running arms (live > 1/2). The joint limit is
    passed (1.0) if the joint is beyond its limits, otherwise the value is 0.0.
    """
    # tip less root: polar angle and its rate (inertial axes), deflection (root axes)
    normal, along, rate, dx, dy, dvx, dvy, _, _ = deflection(lane, poses, 0)
    # e (rad); `way` in half turns where whole turns do not matter: no way is longer than one
    error = absolute(_error(lane, task, poses, record, normal, along))
    way = error if task.turns is None else error * (1.0 / math.pi)
    # (r x v) / r^2: rate of the tip's polar angle, rad/s
    turning = (dx * dvy - dy * dvx) / (dx * dx + dy * dy)
    rate = absolute(rate / task.length)
    put_info(lane, live, info, DEFLECTION, normal / task.length)
    # success: angle (rad), rate (rad/s) and deflection rate / L (1/s) within their bands
    slip = turning - record[TARGET_RATE]
    good = select_lt(error, task.bands[0], 1.0, 0.0)
    good = select_lt(absolute(slip), task.bands[1], good, 0.0)
    good = level(lane, task, poses, select_lt(rate, task.bands[2], good, 0.0))
    record_success(lane, task, good, record, live, info)
    record_tip(lane, task, poses, record, live, info)
    # settle = exp(-(50 e)^2 - (5 slip)^2), or 1 / (1 + s^2) by the success bands
    wide, narrow, slow = error * 10.0, error * 50.0, slip * 5.0
    settle = decay(narrow * narrow + slow * slow)
    if task.paid is not None:
        place, pace, shake = error / task.bands[0], slip / task.bands[1], rate / task.bands[2]
        square = place * place + pace * pace + shake * shake
        settle = settled(lane, square if size(task.base) == 0 else square + squared_turn(lane, task, poses))
    total = reward_term(lane, task, live, info, 0, decay(wide * wide))
    total = total + reward_term(lane, task, live, info, 1, settle)
    # losses, at most 1 each (effort 1 per joint): way, sum action^2, (deflection rate / L)^2
    total = total + reward_term(lane, task, live, info, 2, left_of(task, minimum(way, 1.0)))
    total = total + reward_term(lane, task, live, info, 3, -effort(lane, task, action))
    total = total + reward_term(lane, task, live, info, 4, -minimum(rate * rate, 1.0))
    total = reward_attitude(lane, task, poses, live, info, total)
    total = reward_change(lane, task, action, record, live, info, total)
    return total, past_limits(lane, task, poses)


@kernel
def slew_target(task, angles, first, second):
    """Return (target angle, 0.0), rad: the drawn angle `first`, plus joint 0's angle if task.relative is 1."""
    return task.relative * angles[0] + first, 0.0


@kernel
def slew_aim(task, record):
    """Write the joint angle that reaches the target into record[GOAL]: the target angle itself, rad."""
    record[GOAL] = record[TARGET]


@kernel
def slew_draw_path(task, stream, arm, start, drawn, path):
    """Write the `PATH` record of a swing from joint 0's angle `start` (rad) to a random side.

    drawn: width (rad) and period (s) of the swing. stream[arm]: random numbers of the arm.
    """
    side = 1.0 if uniform(stream, arm) < 0.5 else -1.0
    path[_PATH.x] = start
    path[_PATH.size] = drawn[0] * side
    path[_PATH.rate] = 2.0 * math.pi / drawn[1]


@kernel
def slew_draw_line(task, stream, arm, start, drawn, path):
    """Write the `PATH` record of a path of constant rate that passes joint 0's angle `start` towards a random side.

    path: parameters of the target's path, a `PATH` record. start: angle of joint 0, rad. drawn (2,): angle by which the
    path is behind `start` at t = 0, rad; rate of the path, rad/s. stream[arm]: random numbers of the arm.
    """
    side = 1.0 if uniform(stream, arm) < 0.5 else -1.0
    path[_PATH.x], path[_PATH.vx] = start - drawn[0] * side, drawn[1] * side


@kernel
def slew_path_at(task, path, t, out):
    """Write the target angle (rad) and its rate (rad/s) at time t (s): a cosine swing from rest, plus a constant rate.

        angle = x + vx t + width (1 - cos(rate t + phase)) / 2

    path: a `PATH`, with these parameters (width is its field `size`). out: the `MOVING` record that is written.
    """
    width, rate = path[_PATH.size], path[_PATH.rate]
    angle = rate * t + path[_PATH.phase]
    out[_MOVING.x] = path[_PATH.x] + path[_PATH.vx] * t + 0.5 * width * (1.0 - math.cos(angle))
    out[_MOVING.vx] = path[_PATH.vx] + 0.5 * width * rate * math.sin(angle)


@kernel
def slew_turn_in(lane, task, poses, seen, first, end):
    """Do nothing: the entries in `seen`, angle differences and rates, are the same in any frame of the plane."""


TASKS.register(
    Slew, observe=slew_observe, judge=slew_judge, target_from=slew_target, aim=slew_aim, pursue=slew_aim,
    draw_path=slew_draw_path, draw_line=slew_draw_line, path_at=slew_path_at, turn_in=slew_turn_in,
)  # fmt: skip
