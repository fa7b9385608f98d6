"""A task: one link turns its tip to a polar angle, and keeps it there."""

import math

from ..compiler import absolute, kernel, load, select_lt, sincos, size, splat
from ..physics.arithmetic import arctangent, decay, smaller
from ..physics.layout import BASE_POSE, POSE
from .program import DEFLECTION, GOAL, MOVING, PATH, TARGET, TARGET_RATE
from .stream import uniform
from .task import (
    TASKS,
    Task,
    deflection,
    effort,
    hub_angle,
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
    """Observation and reward: see `envs.flexible_arm`."""

    __slots__ = ()


@kernel
def _error(lane, task, poses, record, normal, along):
    """Target less tip angle; to the nearest of the target's whole turns where these are alike."""
    error = load(lane, record, TARGET) - (load(lane, poses, POSE.angle) + arctangent(normal, along))
    if task.turns is not None:
        sine, cosine = sincos(error)
        return arctangent(sine, cosine)
    return error


@kernel
def slew_observe(lane, task, poses, record, out):
    """sin, cos of the hub angle; hub rate; tip deflection and rate over L; target less tip angle, unwrapped."""
    normal, along, rate, _, _, _, _, sine, cosine = deflection(lane, poses, 0)
    hub_sine, hub_cosine = hub_angle(lane, task, poses, sine, cosine)
    show_scaled(lane, task, out, 0, hub_sine)
    show_scaled(lane, task, out, 1, hub_cosine)
    show_scaled(lane, task, out, 2, load(lane, poses, POSE.rate) - of_base(lane, task, poses, BASE_POSE.rate))
    show_scaled(lane, task, out, 3, normal / task.length)
    show_scaled(lane, task, out, 4, rate / task.length)
    show_scaled(lane, task, out, 5, _error(lane, task, poses, record, normal, along))
    show_base(lane, task, poses, sine, cosine, out)


@kernel
def slew_judge(lane, task, poses, action, record, live, info):
    """Terms: accuracy, settle, distance, effort, vibration."""
    normal, along, rate, dx, dy, dvx, dvy, _, _ = deflection(lane, poses, 0)
    error = absolute(_error(lane, task, poses, record, normal, along))
    way = error if task.turns is None else error * (1.0 / math.pi)  # in half turns, where no way is longer than that
    turning = (dx * dvy - dy * dvx) / (dx * dx + dy * dy)
    rate = absolute(rate / task.length)
    put_info(lane, live, info, DEFLECTION, normal / task.length)
    slip = turning - load(lane, record, TARGET_RATE)
    good = select_lt(error, task.bands[0], splat(lane, 1.0), splat(lane, 0.0))
    good = select_lt(absolute(slip), task.bands[1], good, splat(lane, 0.0))
    good = level(lane, task, poses, select_lt(rate, task.bands[2], good, splat(lane, 0.0)))
    record_success(lane, task, good, record, live, info)
    record_tip(lane, task, poses, record, live, info)
    wide, narrow, slow = error * 10.0, error * 50.0, slip * 5.0
    settle = decay(narrow * narrow + slow * slow)
    if task.paid is not None:
        place, pace, shake = error / task.bands[0], slip / task.bands[1], rate / task.bands[2]
        square = place * place + pace * pace + shake * shake
        settle = settled(lane, square if size(task.base) == 0 else square + squared_turn(lane, task, poses))
    total = reward_term(lane, task, live, info, 0, decay(wide * wide))
    total = total + reward_term(lane, task, live, info, 1, settle)
    total = total + reward_term(lane, task, live, info, 2, -smaller(way, 1.0))
    total = total + reward_term(lane, task, live, info, 3, -effort(lane, task, action))
    total = total + reward_term(lane, task, live, info, 4, -smaller(rate * rate, 1.0))
    total = reward_attitude(lane, task, poses, live, info, total)
    total = reward_change(lane, task, action, record, live, info, total)
    return total, past_limits(lane, task, poses)


@kernel
def slew_target(task, angles, first, second):
    """So far from where the arm stands, or from 0."""
    return task.relative * angles[0] + first, 0.0


@kernel
def slew_aim(task, record):
    """Joint angle that reaches the target."""
    record[GOAL] = record[TARGET]


@kernel
def slew_draw_path(task, stream, arm, start, drawn, path):
    """A swing from where the arm stands; drawn: its width, rad; its period, s."""
    side = 1.0 if uniform(stream, arm) < 0.5 else -1.0
    path[_PATH.x] = start
    path[_PATH.size] = drawn[0] * side
    path[_PATH.rate] = 2.0 * math.pi / drawn[1]


@kernel
def slew_draw_line(task, stream, arm, start, drawn, path):
    """From behind past where the arm stands; drawn: how far behind, rad; its rate, rad/s."""
    side = 1.0 if uniform(stream, arm) < 0.5 else -1.0
    path[_PATH.x], path[_PATH.vx] = start - drawn[0] * side, drawn[1] * side


@kernel
def slew_path_at(task, path, t, out):
    """To and fro, from rest; or on and on."""
    width, rate = path[_PATH.size], path[_PATH.rate]
    angle = rate * t + path[_PATH.phase]
    out[_MOVING.x] = path[_PATH.x] + path[_PATH.vx] * t + 0.5 * width * (1.0 - math.cos(angle))
    out[_MOVING.vx] = path[_PATH.vx] + 0.5 * width * rate * math.sin(angle)


@kernel
def slew_turn_in(lane, task, poses, seen, first, end):
    """An angle is the same in any frame."""


TASKS.register(
    Slew, observe=slew_observe, judge=slew_judge, target_from=slew_target, aim=slew_aim, pursue=slew_aim,
    draw_path=slew_draw_path, draw_line=slew_draw_line, path_at=slew_path_at, turn_in=slew_turn_in,
)  # fmt: skip
