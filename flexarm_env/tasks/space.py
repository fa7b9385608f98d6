"""A task: in space, the tip of a chain of links is brought to a point, which may move, and kept there."""

import math

from ..compiler import kernel, load, sincos, size, splat, square_root, store
from ..physics.layout import SPACE_POSE
from .program import GOAL, MOVING, PATH, TARGET, TARGET_RATE
from .reach import reward_point
from .space_angles import follow_point, seek_point
from .stream import uniform
from .task import TASKS, Task, info_of, past_limit, put_info, show_scaled

_PATH, _MOVING = PATH.places, MOVING.places


class SpaceReach(Task):
    """Observation and reward: see `envs.spatial`. Links of length 0 in the record are rigid."""

    __slots__ = ()


@kernel
def _in_root(lane, poses, x, y, z, d):
    """Component d of a vector in the axes of the root of link 0."""
    o = SPACE_POSE.axes + d
    return (x * load(lane, poses, o) + y * load(lane, poses, o + 3)) + z * load(lane, poses, o + 6)


@kernel
def _to_target(lane, task, poses, record):
    """Way from the tip to the target, m."""
    o = SPACE_POSE.end * (size(task.links) - 1) + SPACE_POSE.tip
    return (
        load(lane, record, TARGET) - load(lane, poses, o),
        load(lane, record, TARGET + 1) - load(lane, poses, o + 1),
        load(lane, record, TARGET + 2) - load(lane, poses, o + 2),
    )


@kernel
def _velocity(lane, task, poses):
    """Of the tip, m/s."""
    o = SPACE_POSE.end * (size(task.links) - 1) + SPACE_POSE.velocity
    return load(lane, poses, o), load(lane, poses, o + 1), load(lane, poses, o + 2)


@kernel
def space_observe(lane, task, poses, record, out):
    """Joints, rates; of links that bend deflections, twist and their rates; tip velocity, way to the target."""
    n, to = size(task.links), 3 * size(task.links)
    for k in range(n):
        sine, cosine = sincos(load(lane, poses, SPACE_POSE.end * k + SPACE_POSE.angle))
        show_scaled(lane, task, out, 2 * k, sine)
        show_scaled(lane, task, out, 2 * k + 1, cosine)
        show_scaled(lane, task, out, 2 * n + k, load(lane, poses, SPACE_POSE.end * k + SPACE_POSE.rate))
    for k in range(n):
        if task.lengths[k] > 0.0:
            o = SPACE_POSE.end * k + SPACE_POSE.deflection
            for d in range(4):
                show_scaled(lane, task, out, to + d, load(lane, poses, o + d) / task.lengths[k])
            for d in range(4, 6):  # twist and its rate
                show_scaled(lane, task, out, to + d, load(lane, poses, o + d))
            to += 6
    for vector in (_velocity(lane, task, poses), _to_target(lane, task, poses, record)):
        for d in range(3):
            show_scaled(lane, task, out, to + d, _in_root(lane, poses, vector[0], vector[1], vector[2], d))
        to += 3


@kernel
def space_judge(lane, task, poses, action, record, live, info):
    """Terms: accuracy, settle, distance, effort, vibration."""
    n, at = size(task.links), info_of(task)
    shaking, past = splat(lane, 0.0), splat(lane, 0.0)
    for k in range(n):
        o = SPACE_POSE.end * k
        if task.lengths[k] > 0.0:
            for d in range(2):
                bend = load(lane, poses, o + SPACE_POSE.deflection + d) / task.lengths[k]
                rate = load(lane, poses, o + SPACE_POSE.deflection_rate + d) / task.lengths[k]
                put_info(lane, live, info, at.deflection + n * d + k, bend)
                shaking = shaking + rate * rate
        put_info(lane, live, info, at.twist + k, load(lane, poses, o + SPACE_POSE.twist))
        past = past_limit(task, k, load(lane, poses, o + SPACE_POSE.angle), past)
    dx, dy, dz = _to_target(lane, task, poses, record)
    vx, vy, vz = _velocity(lane, task, poses)
    vx, vy = vx - load(lane, record, TARGET_RATE), vy - load(lane, record, TARGET_RATE + 1)
    vz = vz - load(lane, record, TARGET_RATE + 2)
    for d in range(3):
        tip = load(lane, poses, SPACE_POSE.end * (n - 1) + SPACE_POSE.tip + d)
        put_info(lane, live, info, at.tip + d, tip)
        put_info(lane, live, info, at.target + d, load(lane, record, TARGET + d))
    error = square_root((dx * dx + dy * dy) + dz * dz) / task.length
    speed = square_root((vx * vx + vy * vy) + vz * vz) / task.length
    return reward_point(lane, task, error, speed, shaking, poses, action, record, live, info), past


@kernel
def space_target(task, angles, first, second):
    """Follows from joint angles (`runtime.starts`)."""
    return 0.0, 0.0


@kernel
def space_aim(task, record):
    """The joint angles that a target on a path is reached at; otherwise the goal's own were drawn."""
    if task.chain is not None:
        point = (record[TARGET], record[TARGET + 1], record[TARGET + 2])
        seek_point(task.chain, task.links, task.length, task.joint_limits, point, record[GOAL:])


@kernel
def space_pursue(task, record):
    """The joint angles that follow on the record's own."""
    if task.chain is not None:
        point = (record[TARGET], record[TARGET + 1], record[TARGET + 2])
        follow_point(task.chain, task.links, task.length, task.joint_limits, point, record[GOAL:])


@kernel
def _directions(bearing, elevation):
    """Unit vectors: away from the root, towards greater bearings, upwards."""
    c, s, flat, up = math.cos(bearing), math.sin(bearing), math.cos(elevation), math.sin(elevation)
    return (c * flat, s * flat, up), (-s, c, 0.0), (-c * up, -s * up, flat)


@kernel
def space_draw_path(task, stream, arm, start, drawn, path):
    """A circle in any plane; drawn: distance of its centre, m; period, s; radius, m; bearing and elevation, rad."""
    away, _, _ = _directions(drawn[3], drawn[4])
    path[_PATH.x], path[_PATH.y], path[_PATH.z] = drawn[0] * away[0], drawn[0] * away[1], drawn[0] * away[2]
    path[_PATH.size] = drawn[2]
    path[_PATH.rate] = 2.0 * math.pi / drawn[1]
    path[_PATH.phase] = 2.0 * math.pi * uniform(stream, arm)
    path[_PATH.bearing] = 2.0 * math.pi * uniform(stream, arm)
    path[_PATH.tilt] = math.acos(1.0 - 2.0 * uniform(stream, arm))


@kernel
def space_draw_line(task, stream, arm, start, drawn, path):
    """A straight line; drawn: where it is nearest to the root, m; when, s; speed, m/s; bearing and elevation there."""
    away, around, up = _directions(drawn[3], drawn[4])
    turn = 2.0 * math.pi * uniform(stream, arm)
    c, s = drawn[2] * math.cos(turn), drawn[2] * math.sin(turn)
    path[_PATH.vx], path[_PATH.vy], path[_PATH.vz] = c * around[0] + s * up[0], c * around[1] + s * up[1], s * up[2]
    path[_PATH.x] = drawn[0] * away[0] - path[_PATH.vx] * drawn[1]
    path[_PATH.y] = drawn[0] * away[1] - path[_PATH.vy] * drawn[1]
    path[_PATH.z] = drawn[0] * away[2] - path[_PATH.vz] * drawn[1]


@kernel
def space_path_at(task, path, t, out):
    """On a circle about the axis of its bearing and tilt; or where a point has got to that goes straight on."""
    radius, rate = path[_PATH.size], path[_PATH.rate]
    angle = rate * t + path[_PATH.phase]
    c, s = radius * math.cos(angle), radius * math.sin(angle)
    _, first, other = _directions(path[_PATH.bearing], 0.5 * math.pi - path[_PATH.tilt])
    out[_MOVING.x] = path[_PATH.x] + path[_PATH.vx] * t + (c * first[0] + s * other[0])
    out[_MOVING.y] = path[_PATH.y] + path[_PATH.vy] * t + (c * first[1] + s * other[1])
    out[_MOVING.z] = path[_PATH.z] + path[_PATH.vz] * t + (c * first[2] + s * other[2])
    out[_MOVING.vx] = path[_PATH.vx] + rate * (c * other[0] - s * first[0])
    out[_MOVING.vy] = path[_PATH.vy] + rate * (c * other[1] - s * first[1])
    out[_MOVING.vz] = path[_PATH.vz] + rate * (c * other[2] - s * first[2])


@kernel
def space_turn_in(lane, task, poses, seen, first, end):
    """Into the axes of the root of link 0."""
    for k in range(first, end, 3):
        x, y, z = load(lane, seen, k), load(lane, seen, k + 1), load(lane, seen, k + 2)
        for d in range(3):
            store(seen, k + d, _in_root(lane, poses, x, y, z, d))


TASKS.register(
    SpaceReach, observe=space_observe, judge=space_judge, target_from=space_target, aim=space_aim, pursue=space_pursue,
    draw_path=space_draw_path, draw_line=space_draw_line, path_at=space_path_at, turn_in=space_turn_in,
)  # fmt: skip
