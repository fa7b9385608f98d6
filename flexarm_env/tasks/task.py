"""What every task has in common: its record, the functions that it brings, and what their kernels are made of.

A task is a record (a subclass of `Task`) and kernels that are registered for it; `slew` and `reach` are two. `poses`
holds a `physics.layout.POSES` a link, behind them a `BASE_POSE` of a base that floats; each observed entry is divided
by its scale and clipped to +-10. All of it is arithmetic on lanes: a batch and a single arm give the same bits.

    observe(lane, task, poses, record, out)                the scaled observation into the first entries of `out`
    judge(lane, task, poses, action, record, live, info)   success and reward terms into `info`, where `live` > 1/2;
                                                           returns (reward, joint limit passed: 1 or 0)
    turn_in(lane, task, poses, seen, first, end)           these entries, numbers of targets in fixed axes, into the
                                                           frame that turns with the hub

and for one arm, whose `record` is its own (`program.RECORD`):

    target_from(task, angles, first, second)   the target (two numbers) that two drawn ones mean, with the arm at
                                               these joint angles
    aim(task, record)                          the joint angles that reach the target, at the start of an episode
    pursue(task, record)                       the same, where the target has moved on from these angles' own
    draw_path(task, stream, arm, start, drawn, path)   numbers of a moving target's path (`program.PATH`), from the
                                               angle of joint 0 and the numbers that were drawn
    draw_line(task, stream, arm, start, drawn, path)   likewise, of one that runs straight
    path_at(task, path, t, out)                out <- a `program.MOVING`: the target at t (s)
"""

from typing import NamedTuple

import numpy as np

from ..compiler import Family, absolute, kernel, load, select_lt, sincos, size, splat, store
from ..physics.arithmetic import clip, put, smaller
from ..physics.layout import BASE_POSE, POSE
from .program import CLIP, FURTHER, GOAL, HOLD, SUCCESS, TARGET, TIP, info_at


class Task(NamedTuple):
    """What the kernels of a task know: N links, D numbers in a target, T reward terms, O entries of the observation.

    links, targets, terms, entries are tuples of so many zeros: numbers that the compiler knows.
    """

    links: tuple[int, ...]
    targets: tuple[int, ...]
    terms: tuple[int, ...]
    entries: tuple[int, ...]
    length: float  # of the arm, m
    lengths: np.ndarray  # (N,) m
    scales: np.ndarray  # (O,) of the observation
    rates: np.ndarray  # (N,) rad/s: top rate of each joint
    weights: np.ndarray  # (T,) of the reward's terms; the last: of failure
    torque_limits: np.ndarray  # (N,) N m
    joint_limits: np.ndarray  # (2 N,): low, high of each joint, rad
    hold: float  # instants in the band that make a success
    bands: np.ndarray  # what the task's errors must be below in it
    further: tuple[int, ...] = ()  # as many zeros as `FURTHER` has numbers, or none
    once: tuple[int, ...] | None = None  # a tag where a success stays one to the end
    turns: tuple[int, ...] | None = None  # a tag where a target angle is met at any number of whole turns
    acted: tuple[int, ...] = ()  # as many zeros as there are joints where the change of actions is priced
    charged: tuple[int, ...] | None = None  # a tag where the reward has a term for `cost`
    paid: tuple[int, ...] | None = None  # a tag where `settle` pays by the bands
    base: tuple[int, ...] = ()  # as many zeros as `BASE_POSE` has numbers where the arm's base floats, or none
    relative: float = 1.0  # 0: target angles are drawn as they stand, and not from where the arm starts
    chain: np.ndarray | None = None  # in space, a `space_angles.JOINT` a joint where targets move


TASKS = Family("task")
"""Each task's functions, by the class of its record."""

observe = TASKS.function("observe", "lane, task, poses, record, out")
judge = TASKS.function("judge", "lane, task, poses, action, record, live, info")
target_from = TASKS.function("target_from", "task, angles, first, second")
aim = TASKS.function("aim", "task, record")
pursue = TASKS.function("pursue", "task, record")
draw_path = TASKS.function("draw_path", "task, stream, arm, start, drawn, path")
draw_line = TASKS.function("draw_line", "task, stream, arm, start, drawn, path")
path_at = TASKS.function("path_at", "task, path, t, out")
turn_in = TASKS.function("turn_in", "lane, task, poses, seen, first, end")


@kernel
def info_of(task):
    """Where the fields of a task's `INFO` are."""
    return info_at(0, size(task.links), size(task.targets), size(task.terms), size(task.further))


@kernel
def put_info(lane, live, info, k, value):
    """Number k of info, where `live` > 1/2."""
    put(live, info, k, value, load(lane, info, k))


@kernel
def deflection(lane, poses, k):
    """(normal, along, normal rate, dx, dy, dvx, dvy, sine, cosine) of link k: tip less root, in and out of the root's
    turning frame."""
    o = POSE.end * k
    sine, cosine = sincos(load(lane, poses, o + POSE.angle))
    dx = load(lane, poses, o + POSE.tip_x) - load(lane, poses, o + POSE.x)
    dy = load(lane, poses, o + POSE.tip_y) - load(lane, poses, o + POSE.y)
    dvx = load(lane, poses, o + POSE.tip_vx) - load(lane, poses, o + POSE.vx)
    dvy = load(lane, poses, o + POSE.tip_vy) - load(lane, poses, o + POSE.vy)
    normal, along = cosine * dy - sine * dx, cosine * dx + sine * dy
    rate = cosine * dvy - sine * dvx - load(lane, poses, o + POSE.rate) * along
    return normal, along, rate, dx, dy, dvx, dvy, sine, cosine


@kernel
def of_base(lane, task, poses, number):
    """The attitude of a base that floats, or its rate; 0 where the root is held."""
    if size(task.base) > 0:
        return load(lane, poses, POSE.end * size(task.links) + number)
    return splat(lane, 0.0)


@kernel
def hub_angle(lane, task, poses, sine, cosine):
    """Sine and cosine of joint 0's angle, of those of link 0's root: from the base, where that floats."""
    if size(task.base) > 0:
        return sincos(load(lane, poses, POSE.angle) - of_base(lane, task, poses, BASE_POSE.angle))
    return sine, cosine


@kernel
def show_base(lane, task, poses, sine, cosine, out):
    """Of a base that floats the last entries: sine and cosine of its attitude, its rate; velocity and offset of the
    hub, along and across the root of link 0, whose sine and cosine these are."""
    if size(task.base) > 0:
        k = size(task.entries) - 7
        s, c = sincos(of_base(lane, task, poses, BASE_POSE.angle))
        show_scaled(lane, task, out, k, s)
        show_scaled(lane, task, out, k + 1, c)
        show_scaled(lane, task, out, k + 2, of_base(lane, task, poses, BASE_POSE.rate))
        for d, first in ((3, POSE.vx), (5, POSE.x)):
            x, y = load(lane, poses, first), load(lane, poses, first + 1)
            show_scaled(lane, task, out, k + d, cosine * x + sine * y)
            show_scaled(lane, task, out, k + d + 1, cosine * y - sine * x)


@kernel
def level(lane, task, poses, good):
    """`good` where a base that floats is within the last of the bands, elsewhere 0."""
    if size(task.base) > 0:
        turned = absolute(of_base(lane, task, poses, BASE_POSE.angle))
        return select_lt(turned, task.bands[task.bands.shape[0] - 1], good, splat(lane, 0.0))
    return good


@kernel
def squared_turn(lane, task, poses):
    """Square of a base's attitude over the last of the bands."""
    turned = of_base(lane, task, poses, BASE_POSE.angle) / task.bands[task.bands.shape[0] - 1]
    return turned * turned


@kernel
def reward_attitude(lane, task, poses, live, info, total):
    """The total less what the attitude of a base that floats costs; where it is, into info."""
    if size(task.base) > 0:
        turned, at = of_base(lane, task, poses, BASE_POSE.angle), info_of(task).further + FURTHER.base
        put_info(lane, live, info, at, turned)
        put_info(lane, live, info, at + 1, load(lane, poses, POSE.x))
        put_info(lane, live, info, at + 2, load(lane, poses, POSE.y))
        total = total + reward_term(lane, task, live, info, 5, -smaller(turned * turned, 1.0))
    return total


@kernel
def show_scaled(lane, task, out, k, value):
    store(out, k, clip(value / task.scales[k], CLIP))


@kernel
def past_limit(task, k, angle, past):
    """1 where joint k's angle is beyond its limits, elsewhere `past`."""
    past = select_lt(angle, task.joint_limits[2 * k], 1.0, past)
    return select_lt(task.joint_limits[2 * k + 1], angle, 1.0, past)


@kernel
def past_limits(lane, task, poses):
    """1 where a joint's angle is beyond its limits."""
    past = splat(lane, 0.0)
    before = of_base(lane, task, poses, BASE_POSE.angle)
    for k in range(size(task.links)):
        angle = load(lane, poses, POSE.end * k + POSE.angle) - before
        past = past_limit(task, k, angle, past)
        before = load(lane, poses, POSE.end * k + POSE.tip_angle)
    return past


@kernel
def record_success(lane, task, good, record, live, info):
    """Count the instants in the band; success is a count that reaches task.hold."""
    before = load(lane, record, HOLD)
    held = select_lt(0.5, good, before + 1.0, splat(lane, 0.0))
    if task.once is not None:  # a success stays one, by the count that made it
        held = select_lt(before, task.hold - 0.5, held, before)
    put(live, record, HOLD, held, before)
    success = select_lt(held, task.hold - 0.5, splat(lane, 0.0), splat(lane, 1.0))
    put_info(lane, live, info, SUCCESS, success)


@kernel
def effort(lane, task, action):
    total = splat(lane, 0.0)
    for k in range(size(task.links)):
        a = load(lane, action, k)
        total = total + a * a
    return total


@kernel
def settled(lane, square):
    """What `settle` pays by the bands: 1 / (1 + r^4), r^2 the sum of squares of the errors over them."""
    return 1.0 / (square * square + 1.0)


@kernel
def reward_change(lane, task, action, record, live, info, total):
    """The total less what the actions' change costs, where that is priced: the last term but failure."""
    change = splat(lane, 0.0)
    for j in range(size(task.acted)):
        at = GOAL + size(task.links) + j
        before, now = load(lane, record, at), load(lane, action, j)
        change = change + (now - before) * (now - before)
        put(live, record, at, now, before)
    if size(task.acted) > 0:
        total = total + reward_term(lane, task, live, info, size(task.terms) - 2, -change)
    return total


@kernel
def reward_term(lane, task, live, info, k, value):
    """Reward term k, weighted, into info."""
    weighted = value * task.weights[k]
    put_info(lane, live, info, info_of(task).terms + k, weighted)
    return weighted


@kernel
def record_tip(lane, task, poses, record, live, info):
    """Tip position and target into info."""
    o, at = POSE.end * (size(task.links) - 1), info_of(task).target
    put_info(lane, live, info, TIP, load(lane, poses, o + POSE.tip_x))
    put_info(lane, live, info, TIP + 1, load(lane, poses, o + POSE.tip_y))
    for k in range(size(task.targets)):
        put_info(lane, live, info, at + k, load(lane, record, TARGET + k))
