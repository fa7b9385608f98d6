"""A task: in space, the tip of a chain of links is brought to a point, and kept there."""

from ..compiler import kernel, load, sincos, size, splat, square_root
from ..physics.layout import SPACE_POSE
from .program import TARGET
from .reach import pay_point
from .task import TASKS, Task, info_of, past_limit, put_info, show_scaled


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
    for d in range(3):
        tip = load(lane, poses, SPACE_POSE.end * (n - 1) + SPACE_POSE.tip + d)
        put_info(lane, live, info, at.tip + d, tip)
        put_info(lane, live, info, at.target + d, load(lane, record, TARGET + d))
    error = square_root((dx * dx + dy * dy) + dz * dz) / task.length
    speed = square_root((vx * vx + vy * vy) + vz * vz) / task.length
    return pay_point(lane, task, error, speed, shaking, action, record, live, info), past


@kernel
def space_target(task, angles, first, second):
    """Follows from joint angles (`runtime.starts`)."""
    return 0.0, 0.0


@kernel
def space_aim(task, record):
    """Nothing: the goal's joint angles were drawn."""


TASKS.register(
    SpaceReach, observe=space_observe, judge=space_judge, target_from=space_target, aim=space_aim, pursue=space_aim
)
