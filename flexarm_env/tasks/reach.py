"""A task: the tip of a chain of links is brought to a point, and kept there."""

import math

from ..compiler import kernel, load, select_lt, sincos, size, splat, square_root, store
from ..physics.arithmetic import decay, smaller
from ..physics.layout import BASE_POSE, POSE
from .angles import least_angles, next_angles, sooner_angles
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


class Reach(Task):
    """Of two links. Observation and reward: see `envs.two_link`."""

    __slots__ = ()


class Chain(Task):
    """Of any number of links: as `Reach`, but for the joint angles that are aimed at."""

    __slots__ = ()


@kernel
def reach_observe(lane, task, poses, record, out):
    """Joints, rates, deflections and rates, tip velocity and way to the target in the hub's frame (`envs.two_link`)."""
    n = size(task.links)
    before, spin = splat(lane, 0.0), of_base(lane, task, poses, BASE_POSE.rate)
    hub_sine, hub_cosine = splat(lane, 0.0), splat(lane, 1.0)
    for k in range(n):
        o = POSE.end * k
        normal, _, rate, _, _, _, _, sine, cosine = deflection(lane, poses, k)
        if k == 0:
            hub_sine, hub_cosine = sine, cosine
            sine, cosine = hub_angle(lane, task, poses, sine, cosine)
        else:
            sine, cosine = sincos(load(lane, poses, o + POSE.angle) - before)
        show_scaled(lane, task, out, 2 * k, sine)
        show_scaled(lane, task, out, 2 * k + 1, cosine)
        show_scaled(lane, task, out, 2 * n + k, load(lane, poses, o + POSE.rate) - spin)
        show_scaled(lane, task, out, 3 * n + k, normal / task.lengths[k])
        show_scaled(lane, task, out, 4 * n + k, rate / task.lengths[k])
        before, spin = load(lane, poses, o + POSE.tip_angle), load(lane, poses, o + POSE.tip_rate)
    o = POSE.end * (n - 1)
    vx, vy = load(lane, poses, o + POSE.tip_vx), load(lane, poses, o + POSE.tip_vy)
    dx = load(lane, record, TARGET) - load(lane, poses, o + POSE.tip_x)
    dy = load(lane, record, TARGET + 1) - load(lane, poses, o + POSE.tip_y)
    show_scaled(lane, task, out, 5 * n, hub_cosine * vx + hub_sine * vy)
    show_scaled(lane, task, out, 5 * n + 1, hub_cosine * vy - hub_sine * vx)
    show_scaled(lane, task, out, 5 * n + 2, hub_cosine * dx + hub_sine * dy)
    show_scaled(lane, task, out, 5 * n + 3, hub_cosine * dy - hub_sine * dx)
    show_base(lane, task, poses, hub_sine, hub_cosine, out)


@kernel
def reach_judge(lane, task, poses, action, record, live, info):
    """Terms: accuracy, settle, distance, effort, vibration."""
    n = size(task.links)
    shaking = splat(lane, 0.0)
    for k in range(n):
        normal, _, rate, _, _, _, _, _, _ = deflection(lane, poses, k)
        put_info(lane, live, info, DEFLECTION + k, normal / task.lengths[k])
        rate = rate / task.lengths[k]
        shaking = shaking + rate * rate
    o = POSE.end * (n - 1)
    vx, vy = load(lane, poses, o + POSE.tip_vx), load(lane, poses, o + POSE.tip_vy)
    dx = load(lane, record, TARGET) - load(lane, poses, o + POSE.tip_x)
    dy = load(lane, record, TARGET + 1) - load(lane, poses, o + POSE.tip_y)
    vx, vy = vx - load(lane, record, TARGET_RATE), vy - load(lane, record, TARGET_RATE + 1)
    error = square_root(dx * dx + dy * dy) / task.length
    speed = square_root(vx * vx + vy * vy) / task.length
    record_tip(lane, task, poses, record, live, info)
    total = reward_point(lane, task, error, speed, shaking, poses, action, record, live, info)
    return total, past_limits(lane, task, poses)


@kernel
def reward_point(lane, task, error, speed, shaking, poses, action, record, live, info):
    """The reward where a tip is `error` from its target, over L, and so fast; and whether it has held there."""
    good = select_lt(error, task.bands[0], splat(lane, 1.0), splat(lane, 0.0))
    good = level(lane, task, poses, select_lt(speed, task.bands[1], good, splat(lane, 0.0)))
    record_success(lane, task, good, record, live, info)
    wide, narrow, slow = error * 10.0, error * 50.0, speed * 10.0
    settle = decay(narrow * narrow + slow * slow)
    if task.paid is not None:
        place, pace = error / task.bands[0], speed / task.bands[1]
        square = place * place + pace * pace
        settle = settled(lane, square if size(task.base) == 0 else square + squared_turn(lane, task, poses))
    total = reward_term(lane, task, live, info, 0, decay(wide * wide))
    total = total + reward_term(lane, task, live, info, 1, settle)
    total = total + reward_term(lane, task, live, info, 2, -smaller(error, 1.0))
    total = total + reward_term(lane, task, live, info, 3, -effort(lane, task, action))
    total = total + reward_term(lane, task, live, info, 4, -smaller(shaking, 1.0))
    total = reward_attitude(lane, task, poses, live, info, total)
    return reward_change(lane, task, action, record, live, info, total)


@kernel
def reach_target(task, angles, first, second):
    """From polar coordinates about the root."""
    return first * math.cos(second), first * math.sin(second)


@kernel
def reach_aim(task, record):
    """Of the two solutions the one sooner reached from the record's angles."""
    sooner_angles(task.lengths, task.rates, task.joint_limits, record[TARGET], record[TARGET + 1], record[GOAL:])


@kernel
def chain_aim(task, record):
    """The angles of least sum of squares."""
    least_angles(task.lengths, task.joint_limits, record[TARGET], record[TARGET + 1], record[GOAL:])


@kernel
def chain_pursue(task, record):
    """The angles of least sum of squares that follow on the record's own."""
    next_angles(task.lengths, task.joint_limits, record[TARGET], record[TARGET + 1], record[GOAL:])


@kernel
def reach_draw_path(task, stream, arm, start, drawn, path):
    """A circle; drawn: distance of its centre, m; period, s; radius, m; bearing of its centre, rad."""
    side = 1.0 if uniform(stream, arm) < 0.5 else -1.0
    path[_PATH.x] = drawn[0] * math.cos(drawn[3])
    path[_PATH.y] = drawn[0] * math.sin(drawn[3])
    path[_PATH.size] = drawn[2]
    path[_PATH.rate] = side * 2.0 * math.pi / drawn[1]
    path[_PATH.phase] = 2.0 * math.pi * uniform(stream, arm)


@kernel
def reach_draw_line(task, stream, arm, start, drawn, path):
    """A straight line; drawn: where it is nearest to the root, m; when, s; speed, m/s; bearing of that point, rad."""
    side = 1.0 if uniform(stream, arm) < 0.5 else -1.0
    cosine, sine = math.cos(drawn[3]), math.sin(drawn[3])
    path[_PATH.vx], path[_PATH.vy] = -side * drawn[2] * sine, side * drawn[2] * cosine
    path[_PATH.x] = drawn[0] * cosine - path[_PATH.vx] * drawn[1]
    path[_PATH.y] = drawn[0] * sine - path[_PATH.vy] * drawn[1]


@kernel
def reach_path_at(task, path, t, out):
    """On a circle whose centre moves on: for circles it rests, for lines the radius is 0."""
    radius, rate = path[_PATH.size], path[_PATH.rate]
    angle = rate * t + path[_PATH.phase]
    out[_MOVING.x] = path[_PATH.x] + path[_PATH.vx] * t + radius * math.cos(angle)
    out[_MOVING.y] = path[_PATH.y] + path[_PATH.vy] * t + radius * math.sin(angle)
    out[_MOVING.vx] = path[_PATH.vx] - radius * rate * math.sin(angle)
    out[_MOVING.vy] = path[_PATH.vy] + radius * rate * math.cos(angle)


@kernel
def reach_turn_in(lane, task, poses, seen, first, end):
    """Points or their velocities, turned back by the hub's angle."""
    sine, cosine = sincos(load(lane, poses, POSE.angle))
    for k in range(first, end, 2):
        x, y = load(lane, seen, k), load(lane, seen, k + 1)
        store(seen, k, cosine * x + sine * y)
        store(seen, k + 1, cosine * y - sine * x)


_OF_BOTH = {
    "observe": reach_observe, "judge": reach_judge, "target_from": reach_target, "draw_path": reach_draw_path,
    "draw_line": reach_draw_line, "path_at": reach_path_at, "turn_in": reach_turn_in,
}  # fmt: skip
TASKS.register(Reach, **_OF_BOTH, aim=reach_aim, pursue=reach_aim)
TASKS.register(Chain, **_OF_BOTH, aim=chain_aim, pursue=chain_pursue)
