"""The tasks `Reach` and `Chain`: move the tip of an arm to a point and hold it there."""

import math

from ..compiler import Lanes, kernel, select_lt, sincos, size, square_root
from ..physics.arithmetic import decay, minimum
from ..physics.layout import BASE_POSE, POSE
from .angles import least_angles, next_angles, sooner_angles
from .program import GOAL, MOVING, PATH, TARGET, TARGET_RATE
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
    record_deflections,
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
    """Constants of the task "reach" for two links; `envs.two_link` describes observation and reward."""

    __slots__ = ()


class Chain(Task):
    """Constants of the task "reach" for any number of links; goal joint angles by `angles.least_angles`."""

    __slots__ = ()


@kernel
def reach_observe(lane, task, poses: Lanes, record: Lanes, out):
    """Write the scaled observation: joints, deflections, tip velocity, and vector from tip to target (`envs.two_link`).

    Entries: sine, cosine of each joint angle; N joint rates (rad/s); N tip deflections divided by link length, and
    their N rates (1/s); tip velocity (m/s) and target minus tip (m), in the axes of link 0's root; seven entries of a
    floating base.
    poses: positions, angles and rates of the links, inertial axes; record: records of the arms; the target is read.
    Each entry is divided by its scale and clipped to +-10.
    """
    n = size(task.links)
    before, spin = 0.0, of_base(lane, task, poses, BASE_POSE.rate)
    hub_sine, hub_cosine = 0.0, 1.0
    for k in range(n):
        o = POSE.end * k
        normal, _, rate, _, _, _, _, sine, cosine = deflection(lane, poses, k)
        # theta_k (rad): the hub's against a floating base, an elbow's against the tip section before it
        if k == 0:
            hub_sine, hub_cosine = sine, cosine
            sine, cosine = hub_angle(lane, task, poses, sine, cosine)
        else:
            sine, cosine = sincos(poses[o + POSE.angle] - before)
        show_scaled(lane, task, out, 2 * k, sine)
        show_scaled(lane, task, out, 2 * k + 1, cosine)
        show_scaled(lane, task, out, 2 * n + k, poses[o + POSE.rate] - spin)
        show_scaled(lane, task, out, 3 * n + k, normal / task.lengths[k])
        show_scaled(lane, task, out, 4 * n + k, rate / task.lengths[k])
        before, spin = poses[o + POSE.tip_angle], poses[o + POSE.tip_rate]
    # way to the target and tip velocity: inertial axes, then the axes of link 0's root
    o = POSE.end * (n - 1)
    vx, vy = poses[o + POSE.tip_vx], poses[o + POSE.tip_vy]
    dx = record[TARGET] - poses[o + POSE.tip_x]
    dy = record[TARGET + 1] - poses[o + POSE.tip_y]
    show_scaled(lane, task, out, 5 * n, hub_cosine * vx + hub_sine * vy)
    show_scaled(lane, task, out, 5 * n + 1, hub_cosine * vy - hub_sine * vx)
    show_scaled(lane, task, out, 5 * n + 2, hub_cosine * dx + hub_sine * dy)
    show_scaled(lane, task, out, 5 * n + 3, hub_cosine * dy - hub_sine * dx)
    show_base(lane, task, poses, hub_sine, hub_cosine, out)


@kernel
def reach_judge(lane, task, poses: Lanes, action, record: Lanes, live, info):
    """Write success, info and the reward terms of a tip that is brought to a point in the plane (`reward_point`).

    shaking: sum of squares of deflection rates divided by the links' lengths, 1/s^2. poses: positions, angles and rates
    of the links, inertial axes; action (joints, lanes), in [-1, 1]; info is written for running arms (live > 1/2).
    Returns the reward, and 1.0 if a joint is beyond its limits, otherwise 0.0.
    """
    n = size(task.links)
    shaking = record_deflections(lane, task, poses, live, info)
    o = POSE.end * (n - 1)
    # tip's way to the target and velocity relative to it, inertial axes; in the plane z is a known zero
    way = record[TARGET] - poses[o + POSE.tip_x], record[TARGET + 1] - poses[o + POSE.tip_y], 0.0
    velocity = poses[o + POSE.tip_vx] - record[TARGET_RATE], poses[o + POSE.tip_vy] - record[TARGET_RATE + 1], 0.0
    record_tip(lane, task, poses, record, live, info)
    total = reward_point(lane, task, way, velocity, shaking, poses, action, record, live, info)
    return total, past_limits(lane, task, poses)


@kernel
def _magnitude(a):
    """Return the magnitude of a vector."""
    return square_root((a[0] * a[0] + a[1] * a[1]) + a[2] * a[2])


@kernel
def reward_point(lane, task, way, velocity, shaking, poses, action, record, live, info):
    """Return the reward for a tip that is brought to a point, in the plane or in space, and record success.

        accuracy exp(-(10 error)^2), settle exp(-(50 error)^2 - (10 speed)^2), distance by min(error, 1) (`left_of`),
        effort -sum action^2, vibration -min(shaking, 1), attitude of a floating base, change of actions

    In the total each term is multiplied by its weight. If task.paid is not None, settle is 1 / (1 + s^2) (`settled`). s
    is the sum of squares of error and speed (and of a floating base's attitude), each divided by its success band.
    error: distance of the tip from the target divided by the arm's length. speed: speed of the tip relative to the
    target, divided by the arm's length, 1/s. way, velocity (x, y, z): vector from the tip to the target, m, and the
    tip's velocity relative to the target, m/s, in the same axes. shaking: sum of squares of the deflection rates
    divided by the links' lengths, 1/s^2. Terms are written into info for running arms (live > 1/2).
    """
    error, speed = _magnitude(way) / task.length, _magnitude(velocity) / task.length
    # success: |r - target| / L and speed / L (1/s) within their bands
    good = select_lt(error, task.bands[0], 1.0, 0.0)
    good = level(lane, task, poses, select_lt(speed, task.bands[1], good, 0.0))
    record_success(lane, task, good, record, live, info)
    # settle = exp(-(50 error)^2 - (10 speed)^2), or 1 / (1 + s^2) by the success bands
    wide, narrow, slow = error * 10.0, error * 50.0, speed * 10.0
    settle = decay(narrow * narrow + slow * slow)
    if task.paid is not None:
        place, pace = error / task.bands[0], speed / task.bands[1]
        square = place * place + pace * pace
        settle = settled(lane, square if size(task.base) == 0 else square + squared_turn(lane, task, poses))
    total = reward_term(lane, task, live, info, 0, decay(wide * wide))
    total = total + reward_term(lane, task, live, info, 1, settle)
    # losses, at most 1 each (effort 1 per joint): |r - target| / L, sum action^2, sum (deflection rate / L)^2
    total = total + reward_term(lane, task, live, info, 2, left_of(task, minimum(error, 1.0)))
    total = total + reward_term(lane, task, live, info, 3, -effort(lane, task, action))
    total = total + reward_term(lane, task, live, info, 4, -minimum(shaking, 1.0))
    total = reward_attitude(lane, task, poses, live, info, total)
    return reward_change(lane, task, action, record, live, info, total)


@kernel
def reach_target(task, angles, first, second):
    """Return the target point (x, y), m, from polar coordinates about the root: first (m), second (rad)."""
    return first * math.cos(second), first * math.sin(second)


@kernel
def reach_aim(task, record):
    """Write the goal angles (rad) of two links into record[GOAL:]: the elbow side that the joints reach first.

    record: record of one arm. The record's target (m, inertial axes) is read. The record's goal contains the present
    joint angles at entry and the angles that bring the tip to the target at return (`angles.sooner_angles`).
    """
    sooner_angles(task.lengths, task.rates, task.joint_limits, record[TARGET], record[TARGET + 1], record[GOAL:])


@kernel
def chain_aim(task, record):
    """Write the goal angles (rad) of N links into record[GOAL:]: the angles of least sum of squares at the target.

    record: record of one arm. The record's target (m, inertial axes) is read. The first entry of the record's goal is
    the hub's present angle at entry. At return the goal contains the goal angles (`angles.least_angles`).
    """
    least_angles(task.lengths, task.joint_limits, record[TARGET], record[TARGET + 1], record[GOAL:])


@kernel
def chain_pursue(task, record):
    """Write the goal angles (rad) of N links near the present goal angles into record[GOAL:]; see `chain_aim`.

    record: record of one arm. Its field `target` (m, inertial axes) is read. Its field `goal` (rad) is read and
    written.
    """
    next_angles(task.lengths, task.joint_limits, record[TARGET], record[TARGET + 1], record[GOAL:])


@kernel
def reach_draw_path(task, stream, arm, start, drawn, path):
    """Write a circular path with random sense of rotation and random phase into `path`, a `PATH`.

    drawn (4,): distance of the circle's center from the root, m; period, s; radius, m; bearing of the center, rad.
    stream[arm]: random numbers of the arm. start: unused argument.
    """
    side = 1.0 if uniform(stream, arm) < 0.5 else -1.0
    # center (inertial axes), from its distance and bearing
    path[_PATH.x] = drawn[0] * math.cos(drawn[3])
    path[_PATH.y] = drawn[0] * math.sin(drawn[3])
    path[_PATH.size] = drawn[2]
    path[_PATH.rate] = side * 2.0 * math.pi / drawn[1]
    path[_PATH.phase] = 2.0 * math.pi * uniform(stream, arm)


@kernel
def reach_draw_line(task, stream, arm, start, drawn, path):
    """Write a straight path with random sense of direction into `path`, a `PATH`, from its point nearest to the root.

    drawn (4,): distance of the path's nearest point from the root, m; time at which the target reaches this point, s;
    speed, m/s; bearing of this point, rad. stream[arm]: random numbers of the arm. start: unused argument.
    """
    side = 1.0 if uniform(stream, arm) < 0.5 else -1.0
    cosine, sine = math.cos(drawn[3]), math.sin(drawn[3])
    path[_PATH.vx], path[_PATH.vy] = -side * drawn[2] * sine, side * drawn[2] * cosine
    # x(0) = point - v t: the path passes the drawn point at the drawn time
    path[_PATH.x] = drawn[0] * cosine - path[_PATH.vx] * drawn[1]
    path[_PATH.y] = drawn[0] * sine - path[_PATH.vy] * drawn[1]


@kernel
def reach_path_at(task, path, t, out):
    """Write the target's position (m) and velocity (m/s), inertial axes, at time t (s), on a circle or a line.

    path: parameters of the target's path, a `PATH` record. The formula describes a circle whose center moves. The
    center of a circular path rests; on a straight path the radius is 0. out: the `MOVING` record that is written.
    """
    radius, rate = path[_PATH.size], path[_PATH.rate]
    # angle on the circle at t: rate t + phase, from the x axis (inertial)
    angle = rate * t + path[_PATH.phase]
    out[_MOVING.x] = path[_PATH.x] + path[_PATH.vx] * t + radius * math.cos(angle)
    out[_MOVING.y] = path[_PATH.y] + path[_PATH.vy] * t + radius * math.sin(angle)
    out[_MOVING.vx] = path[_PATH.vx] - radius * rate * math.sin(angle)
    out[_MOVING.vy] = path[_PATH.vy] + radius * rate * math.cos(angle)


@kernel
def reach_turn_in(lane, task, poses: Lanes, seen: Lanes, first, end):
    """Rotate the points or velocities (x, y) at seen[first:end] from inertial axes to link 0's root axes."""
    sine, cosine = sincos(poses[POSE.angle])
    for k in range(first, end, 2):
        x, y = seen[k], seen[k + 1]
        seen[k] = cosine * x + sine * y
        seen[k + 1] = cosine * y - sine * x


_OF_BOTH = {
    "observe": reach_observe, "judge": reach_judge, "target_from": reach_target, "draw_path": reach_draw_path,
    "draw_line": reach_draw_line, "path_at": reach_path_at, "turn_in": reach_turn_in,
}  # fmt: skip
TASKS.register(Reach, **_OF_BOTH, aim=reach_aim, pursue=reach_aim)
TASKS.register(Chain, **_OF_BOTH, aim=chain_aim, pursue=chain_pursue)
