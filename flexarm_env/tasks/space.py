"""The task `SpaceReach`: in space, move the tip of an arm to a point at rest or in motion, and hold it there."""

import math

from ..compiler import Lanes, kernel, sincos, size
from ..physics.layout import SPACE_POSE
from .program import GOAL, MOVING, PATH, TARGET, TARGET_RATE
from .reach import reward_point
from .space_angles import follow_point, seek_point
from .stream import uniform
from .task import TASKS, Task, info_of, past_limit, put_info, show_scaled

_PATH, _MOVING = PATH.places, MOVING.places


class SpaceReach(Task):
    """Constants of the task "reach" in space; `envs.spatial` describes observation and reward.

    A link of length 0 in `lengths` is rigid.
    """

    __slots__ = ()

    @property
    def given(self) -> str:
        return "goals"


@kernel
def _in_root(lane, poses: Lanes, x, y, z, d):
    """Return the component of the vector (x, y, z; inertial axes) along axis d of link 0's root."""
    o = SPACE_POSE.axes + d
    # column d of A, which turns axes of link 0's root into inertial ones and is stored by rows
    return (x * poses[o] + y * poses[o + 3]) + z * poses[o + 6]


@kernel
def to_target(lane, task, poses: Lanes, record: Lanes):
    """Return the vector from the tip to the target, m, inertial axes.

    poses: poses of the links; the last link's tip is read. record.target: target point, m, inertial axes.
    """
    o = SPACE_POSE.end * (size(task.links) - 1) + SPACE_POSE.tip
    return (
        record[TARGET] - poses[o],
        record[TARGET + 1] - poses[o + 1],
        record[TARGET + 2] - poses[o + 2],
    )


@kernel
def _velocity(lane, task, poses: Lanes):
    """Return the velocity of the tip, m/s, inertial axes."""
    o = SPACE_POSE.end * (size(task.links) - 1) + SPACE_POSE.velocity
    return poses[o], poses[o + 1], poses[o + 2]


@kernel
def space_observe(lane, task, poses: Lanes, record, out):
    """Write the scaled observation: joint angles and rates, deflections and twists, tip velocity, tip to target.

    Entries: sine and cosine of N joint angles; N joint rates (rad/s); for each flexible link its tip's deflections
    along y and z and their rates, divided by the link's length, its twist (rad) and twist rate (rad/s); tip velocity
    (m/s) and vector from tip to target (m), in the axes of link 0's root. Each entry is divided by its scale and
    clipped to +-10. poses: poses of the links; record: records of the arms; the target is read.
    """
    n, to = size(task.links), 3 * size(task.links)
    for k in range(n):
        # theta_k as (sin, cos), continuous over whole turns, then theta_k' divided by its scale
        sine, cosine = sincos(poses[SPACE_POSE.end * k + SPACE_POSE.angle])
        show_scaled(lane, task, out, 2 * k, sine)
        show_scaled(lane, task, out, 2 * k + 1, cosine)
        show_scaled(lane, task, out, 2 * n + k, poses[SPACE_POSE.end * k + SPACE_POSE.rate])
    for k in range(n):
        if task.lengths[k] > 0.0:
            # flexible links: deflection along y, z and its rates over L (root axes); rigid ones have no entry
            o = SPACE_POSE.end * k + SPACE_POSE.deflection
            for d in range(4):
                show_scaled(lane, task, out, to + d, poses[o + d] / task.lengths[k])
            for d in range(4, 6):  # twist and its rate
                show_scaled(lane, task, out, to + d, poses[o + d])
            to += 6
    # vectors in the axes of link 0's root
    for vector in (_velocity(lane, task, poses), to_target(lane, task, poses, record)):
        for d in range(3):
            show_scaled(lane, task, out, to + d, _in_root(lane, poses, vector[0], vector[1], vector[2], d))
        to += 3


@kernel
def space_judge(lane, task, poses: Lanes, action, record: Lanes, live, info):
    """Write success, info and the reward terms of a tip that is brought to a point in space (`reach.reward_point`).

    shaking: sum of squares of deflection rates divided by the links' lengths, 1/s^2. poses: poses of the links; action
    (joints, lanes), in [-1, 1]; info is written for running arms (live > 1/2). Returns the reward, and 1.0 if a joint
    is beyond its limits, otherwise 0.0.
    """
    shaking, past = record_pose(lane, task, poses, record, live, info)
    # way to the target and velocity relative to it, inertial axes
    way, (vx, vy, vz) = to_target(lane, task, poses, record), _velocity(lane, task, poses)
    velocity = vx - record[TARGET_RATE], vy - record[TARGET_RATE + 1], vz - record[TARGET_RATE + 2]
    return reward_point(lane, task, way, velocity, shaking, poses, action, record, live, info), past


@kernel
def record_pose(lane, task, poses: Lanes, record: Lanes, live, info):
    """Write deflections, twists, tip and target into info for running arms (live > 1/2); return (shaking, past).

    shaking: sum of squares of deflection rates divided by the links' lengths, 1/s^2. past: 1.0 if a joint is beyond
    its limits.
    """
    n, at = size(task.links), info_of(task)
    shaking, past = 0.0, 0.0
    # deflection along y and z and its rate over L (root axes); twist (rad); joint limits
    for k in range(n):
        o = SPACE_POSE.end * k
        if task.lengths[k] > 0.0:
            for d in range(2):
                bend = poses[o + SPACE_POSE.deflection + d] / task.lengths[k]
                rate = poses[o + SPACE_POSE.deflection_rate + d] / task.lengths[k]
                put_info(lane, live, info, at.deflection + n * d + k, bend)
                shaking = shaking + rate * rate
        put_info(lane, live, info, at.twist + k, poses[o + SPACE_POSE.twist])
        past = past_limit(task, k, poses[o + SPACE_POSE.angle], past)
    for d in range(3):
        tip = poses[SPACE_POSE.end * (n - 1) + SPACE_POSE.tip + d]
        put_info(lane, live, info, at.tip + d, tip)
        put_info(lane, live, info, at.target + d, record[TARGET + d])
    return shaking, past


@kernel
def space_target(task, angles, first, second):
    """Return two zeros: in space the target follows from the joint angles at the goal (`runtime.starts`)."""
    return 0.0, 0.0


@kernel
def space_aim(task, record):
    """Write the goal angles (rad) that reach a target on a path into record[GOAL:]; no-op if targets rest.

    Goal angles of a resting target have been drawn before the target itself. record: record of one arm. The record's
    field `target` (m, inertial axes) is read. The record's field `goal` contains the start of the search at entry and
    the goal angles at return.
    """
    if task.chain is not None:
        point = (record[TARGET], record[TARGET + 1], record[TARGET + 2])
        seek_point(task.chain, task.links, task.length, task.joint_limits, point, record[GOAL:])


@kernel
def space_pursue(task, record):
    """Move the goal angles (rad), record[GOAL:], so that they reach the moved target; do nothing if targets rest.

    record: record of one arm. Its field `target` (m, inertial axes) is read. Its field `goal` (rad) is read and
    written. task.chain: one `JOINT` record per joint; None if targets rest.
    """
    if task.chain is not None:
        point = (record[TARGET], record[TARGET + 1], record[TARGET + 2])
        follow_point(task.chain, task.links, task.length, task.joint_limits, point, record[GOAL:])


@kernel
def directions(bearing, elevation):
    """Return unit vectors: away from the root at a bearing and elevation (rad), to greater bearing, upwards.

    Bearing: from x towards y about the z axis; elevation: above the plane of x and y.
    """
    c, s, flat, up = math.cos(bearing), math.sin(bearing), math.cos(elevation), math.sin(elevation)
    return (c * flat, s * flat, up), (-s, c, 0.0), (-c * up, -s * up, flat)


@kernel
def space_draw_path(task, stream, arm, start, drawn, path):
    """Write a circular path in a random plane, from a random phase, into `path`, a `PATH`.

    drawn (5,): distance of the circle's center from the root, m; period, s; radius, m; bearing and elevation of the
    center, rad. stream[arm]: random numbers of the arm. start: unused argument.
    """
    away, _, _ = directions(drawn[3], drawn[4])
    # center of the circle, distance times direction (inertial axes)
    path[_PATH.x], path[_PATH.y], path[_PATH.z] = drawn[0] * away[0], drawn[0] * away[1], drawn[0] * away[2]
    path[_PATH.size] = drawn[2]
    path[_PATH.rate] = 2.0 * math.pi / drawn[1]
    path[_PATH.phase] = 2.0 * math.pi * uniform(stream, arm)
    # axis of the circle, uniform on the sphere: bearing uniform, cos(tilt) uniform
    path[_PATH.bearing] = 2.0 * math.pi * uniform(stream, arm)
    path[_PATH.tilt] = math.acos(1.0 - 2.0 * uniform(stream, arm))


@kernel
def space_draw_line(task, stream, arm, start, drawn, path):
    """Write a straight path in a random direction, by its point nearest to the root, into `path`, a `PATH`.

    drawn (5,): distance of the path's nearest point from the root, m; time at which the target reaches this point, s;
    speed, m/s; bearing and elevation of this point, rad. stream[arm]: random numbers of the arm. start: unused
    argument.
    """
    away, around, up = directions(drawn[3], drawn[4])
    turn = 2.0 * math.pi * uniform(stream, arm)
    # v across the direction, so that the path's nearest point is the drawn one
    c, s = drawn[2] * math.cos(turn), drawn[2] * math.sin(turn)
    path[_PATH.vx], path[_PATH.vy], path[_PATH.vz] = c * around[0] + s * up[0], c * around[1] + s * up[1], s * up[2]
    # x(0) = point - v t: the path passes the drawn point at the drawn time (inertial axes)
    path[_PATH.x] = drawn[0] * away[0] - path[_PATH.vx] * drawn[1]
    path[_PATH.y] = drawn[0] * away[1] - path[_PATH.vy] * drawn[1]
    path[_PATH.z] = drawn[0] * away[2] - path[_PATH.vz] * drawn[1]


@kernel
def space_path_at(task, path, t, out):
    """Write the target's position (m) and velocity (m/s) at time t (s), inertial axes: on a circle or a line.

    path: parameters of the target's path, a `PATH` record. The circle's axis has the path's bearing and tilt from z.
    The center of a circle rests; on a line the radius is 0. out: the `MOVING` record that is written.
    """
    radius, rate = path[_PATH.size], path[_PATH.rate]
    angle = rate * t + path[_PATH.phase]
    c, s = radius * math.cos(angle), radius * math.sin(angle)
    # two unit vectors across the circle's axis
    _, first, other = directions(path[_PATH.bearing], 0.5 * math.pi - path[_PATH.tilt])
    out[_MOVING.x] = path[_PATH.x] + path[_PATH.vx] * t + (c * first[0] + s * other[0])
    out[_MOVING.y] = path[_PATH.y] + path[_PATH.vy] * t + (c * first[1] + s * other[1])
    out[_MOVING.z] = path[_PATH.z] + path[_PATH.vz] * t + (c * first[2] + s * other[2])
    # v + rate (c other - s first), the time derivative
    out[_MOVING.vx] = path[_PATH.vx] + rate * (c * other[0] - s * first[0])
    out[_MOVING.vy] = path[_PATH.vy] + rate * (c * other[1] - s * first[1])
    out[_MOVING.vz] = path[_PATH.vz] + rate * (c * other[2] - s * first[2])


@kernel
def space_turn_in(lane, task, poses, seen: Lanes, first, end):
    """Rotate the points or velocities (x, y, z) at seen[first:end] from inertial axes to link 0's root axes."""
    for k in range(first, end, 3):
        x, y, z = seen[k], seen[k + 1], seen[k + 2]
        for d in range(3):
            seen[k + d] = _in_root(lane, poses, x, y, z, d)


TASKS.register(
    SpaceReach, observe=space_observe, judge=space_judge, target_from=space_target, aim=space_aim, pursue=space_pursue,
    draw_path=space_draw_path, draw_line=space_draw_line, path_at=space_path_at, turn_in=space_turn_in,
)  # fmt: skip
