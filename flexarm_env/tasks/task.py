"""Common parts of all tasks: the record `Task`, the functions that a task registers, kernels for reward and success.

A task consists of a record (a subclass of `Task`, such as `Slew` or `Reach`) and the kernels registered for the record.
`poses` contains a `physics.layout.POSES` record per link, then a `BASE_POSE` record if the base floats. Observed
entries are divided by their scales and clipped to +-10. All arithmetic runs on lanes, one arm per lane, so that a batch
and a single arm give the same bits. `live` is 1.0 in the lanes of running arms, that is, of arms that were advanced
without a failure and have finite observations, otherwise 0.0.

    observe(lane, task, poses, record, out)                write the scaled observation into the first entries of `out`
    judge(lane, task, poses, action, record, live, info)   write success and reward terms into `info` where live > 1/2;
                                                           return (reward, 1.0 where a joint is beyond its limits)
    turn_in(lane, task, poses, seen, first, end)           rotate entries first to end - 1 of `seen`, targets or rates
                                                           in inertial axes, into the frame that turns with the hub

Each of the following kernels works on one arm; `record` is this arm's `program.RECORD`:

    target_from(task, angles, first, second)   return the target (two numbers) from two drawn numbers, with the arm at
                                               these joint angles
    aim(task, record)                          write the joint angles that reach the target into the record's `goal`,
                                               at the start of an episode
    pursue(task, record)                       the same for a target that has moved, starting from the present `goal`
    draw_path(task, stream, arm, start, drawn, path)   write a moving target's `program.PATH` from the angle of joint 0,
                                                       `start`, and the drawn numbers
    draw_line(task, stream, arm, start, drawn, path)   the same for a straight path
    path_at(task, path, t, out)                write the target's `program.MOVING` at t (s) into out
"""

from typing import NamedTuple

import numpy as np

from ..compiler import Family, Lanes, absolute, kernel, select_lt, sincos, size
from ..physics.arithmetic import clip, minimum, store_where
from ..physics.layout import BASE_POSE, POSE
from .program import CLIP, DEFLECTION, FURTHER, GOAL, HOLD, SUCCESS, TARGET, TIP, info_at


class Task(NamedTuple):
    """Constants of a task for N links, with D numbers in a target, T reward terms, and O entries of the observation.

    Tuples of zeros carry lengths that must be known at compilation. No code is compiled for fields that are None.
    """

    links: tuple[int, ...]  # N zeros, one per link
    targets: tuple[int, ...]  # D zeros, one per number of a target
    terms: tuple[int, ...]  # T zeros, one per reward term
    entries: tuple[int, ...]  # O zeros, one per entry of the observation
    length: float  # length of the arm, m
    lengths: np.ndarray  # (N,) lengths of the links, m; in space 0 for a rigid link
    scales: np.ndarray  # (O,) divisors of the observation's entries, in the entries' units
    rates: np.ndarray  # (N,) largest rate of each joint, rad/s
    weights: np.ndarray  # (T,) weights of the reward terms; the last is the weight of failure
    torque_limits: np.ndarray  # (N,) torque limit of each joint, N m
    joint_limits: np.ndarray  # (2 N,): lower and upper limit of each joint, rad
    hold: float  # number of consecutive instants within all success bands that count as a success
    bands: np.ndarray  # success bands of position, speed, ...; the last is that of a floating base's attitude, rad
    further: tuple[int, ...] = ()  # one zero per number of a `FURTHER` record, or empty
    once: tuple[int, ...] | None = None  # not None if a success lasts to the end of the episode
    turns: tuple[int, ...] | None = None  # not None if a target angle plus whole turns is the same target
    acted: tuple[int, ...] = ()  # one zero per joint if changes of actions have a price, else empty
    charged: tuple[int, ...] | None = None  # not None if the reward has a term for `cost`
    paid: tuple[int, ...] | None = None  # not None if the term `settle` is measured in bands (`settled`)
    base: tuple[int, ...] = ()  # one zero per number of a `BASE_POSE` if the arm's base floats, else empty
    relative: float = 1.0  # 1: drawn target angles count from joint 0's initial angle; 0: absolute
    nearness: tuple[int, ...] | None = None  # not None: terms `distance`, `attitude` are 1 - loss; None: -loss
    chain: np.ndarray | None = None  # in space, with moving targets: one `space_angles.JOINT` record per joint

    @property
    def given(self) -> str:
        """Field of `REQUEST` that determines a start's target: "target", or "goals" for joint angles there."""
        return "target"

Task.own_terms = ()  # type: ignore[attr-defined]  # no field, known to the compiler: see `tasks.own_terms`


TASKS = Family("task")
"""The kernels of each task, by the class of its record."""

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
    """Return the index of each field of `program.INFO` in the task's info."""
    return info_at(0, size(task.links), size(task.targets), size(task.terms), size(task.further))


@kernel
def put_info(lane, live, info: Lanes, k, value):
    """Write value into number k of info for running arms (live > 1/2)."""
    store_where(lane, live, info, k, value, info[k])


@kernel
def deflection(lane, poses: Lanes, k):
    """Return the tip of link k relative to its root: (normal, along, normal rate, dx, dy, dvx, dvy, sine, cosine).

    normal, along: components, m, across and along the tangent of the root section; normal rate: rate of the normal
    component, m/s; dx, dy (m), dvx, dvy (m/s): vector from root to tip and its rate, in inertial axes; sine, cosine:
    sine and cosine of the root section's angle.
    """
    # tip less root, inertial axes
    o = POSE.end * k
    sine, cosine = sincos(poses[o + POSE.angle])
    dx = poses[o + POSE.tip_x] - poses[o + POSE.x]
    dy = poses[o + POSE.tip_y] - poses[o + POSE.y]
    dvx = poses[o + POSE.tip_vx] - poses[o + POSE.vx]
    dvy = poses[o + POSE.tip_vy] - poses[o + POSE.vy]
    # components in the axes of the root section; the frame turns at its rate
    normal, along = cosine * dy - sine * dx, cosine * dx + sine * dy
    rate = cosine * dvy - sine * dvx - poses[o + POSE.rate] * along
    return normal, along, rate, dx, dy, dvx, dvy, sine, cosine


@kernel
def of_base(lane, task, poses: Lanes, number):
    """Return entry `number` of a floating base's `BASE_POSE`: attitude (rad) or rate (rad/s); 0 if fixed."""
    if size(task.base) > 0:
        return poses[POSE.end * size(task.links) + number]
    return 0.0


@kernel
def hub_angle(lane, task, poses: Lanes, sine, cosine):
    """Return sine and cosine of joint 0's angle, given `sine` and `cosine` of the inertial angle of link 0's root.

    If the root is fixed, joint 0's angle is the inertial angle. On a floating base, the base's attitude is subtracted.
    """
    if size(task.base) > 0:
        return sincos(poses[POSE.angle] - of_base(lane, task, poses, BASE_POSE.angle))
    return sine, cosine


@kernel
def show_base(lane, task, poses: Lanes, sine, cosine, out):
    """Write the last seven entries of the observation of an arm on a floating base, divided by their scales.

    Do nothing if the root is fixed. Entries: sine and cosine of the base's attitude, its rate (rad/s), then velocity
    (m/s) and position (m) of the hub, each along and across the root section of link 0. sine, cosine: sine and cosine
    of this section's inertial angle. poses: poses of the links, then of the base, inertial axes.
    """
    if size(task.base) > 0:
        k = size(task.entries) - 7
        # attitude psi_b as (sin, cos), which is continuous over whole turns, and psi_b' divided by its scale
        s, c = sincos(of_base(lane, task, poses, BASE_POSE.angle))
        show_scaled(lane, task, out, k, s)
        show_scaled(lane, task, out, k + 1, c)
        show_scaled(lane, task, out, k + 2, of_base(lane, task, poses, BASE_POSE.rate))
        # hub's velocity, then its position: inertial axes to the axes of link 0's root
        for d, first in ((3, POSE.vx), (5, POSE.x)):
            x, y = poses[first], poses[first + 1]
            show_scaled(lane, task, out, k + d, cosine * x + sine * y)
            show_scaled(lane, task, out, k + d + 1, cosine * y - sine * x)


@kernel
def level(lane, task, poses, good):
    """Return `good` (1 or 0) if a floating base's attitude is within its success band, otherwise 0.

    The success band of the attitude, rad, is the last entry of task.bands. If the root is fixed, `good` is returned.
    good: 1 if all other errors are within their bands. poses: poses of the links, then of the base.
    """
    if size(task.base) > 0:
        turned = absolute(of_base(lane, task, poses, BASE_POSE.angle))
        return select_lt(turned, task.bands[task.bands.shape[0] - 1], good, 0.0)
    return good


@kernel
def squared_turn(lane, task, poses):
    """Return the square of a floating base's attitude divided by its success band, the last of task.bands (rad)."""
    turned = of_base(lane, task, poses, BASE_POSE.angle) / task.bands[task.bands.shape[0] - 1]
    return turned * turned


@kernel
def reward_attitude(lane, task, poses: Lanes, live, info, total):
    """Return total plus reward term 5, which rewards a small attitude of a floating base; total if the root is fixed.

    The loss is min(attitude^2, 1), rad^2; the term is 1 - loss or -loss (`left_of`) times its weight. Attitude (rad)
    and hub position (m, inertial axes) are written into info for running arms (live > 1/2).
    """
    if size(task.base) > 0:
        turned, at = of_base(lane, task, poses, BASE_POSE.angle), info_of(task).further + FURTHER.base
        # psi_b (rad) and the hub's x, y (m, inertial axes)
        put_info(lane, live, info, at, turned)
        put_info(lane, live, info, at + 1, poses[POSE.x])
        put_info(lane, live, info, at + 2, poses[POSE.y])
        total = total + reward_term(lane, task, live, info, 5, left_of(task, minimum(turned * turned, 1.0)))
    return total


@kernel
def show_scaled(lane, task, out: Lanes, k, value):
    """Write value divided by the scale of entry k, limited to +-CLIP, into entry k of the observation `out`."""
    out[k] = clip(value / task.scales[k], CLIP)


@kernel
def past_limit(task, k, angle, past):
    """Return 1.0 for arms whose joint k is beyond its limits (rad), and the value `past` for all other arms.

    task.joint_limits (2 N,): lower and upper limit of each joint, rad.
    """
    past = select_lt(angle, task.joint_limits[2 * k], 1.0, past)
    return select_lt(task.joint_limits[2 * k + 1], angle, 1.0, past)


@kernel
def past_limits(lane, task, poses: Lanes):
    """Return 1.0 for arms with any joint beyond its limits, 0.0 for all other arms.

    A joint's angle is the angle of its link's root section minus that of the preceding link's tip section or the base.
    """
    past = 0.0
    # joint 0 is measured against the base's attitude psi_b, joint k against the tip section before it
    before = of_base(lane, task, poses, BASE_POSE.angle)
    for k in range(size(task.links)):
        angle = poses[POSE.end * k + POSE.angle] - before
        past = past_limit(task, k, angle, past)
        before = poses[POSE.end * k + POSE.tip_angle]
    return past


@kernel
def record_success(lane, task, good, record: Lanes, live, info):
    """Count the consecutive instants within the success bands; write success (1 or 0) into info of running arms.

    good: 1 if all errors are within their bands. Success means a count (record.hold) of at least task.hold. If
    task.once is not None, success lasts to the end of the episode.
    """
    # hold counts periods in a row: an instant outside a band starts the count again
    before = record[HOLD]
    held = select_lt(0.5, good, before + 1.0, 0.0)
    # `once` (a tag): the count stays, because a success lasts to the episode's end
    if task.once is not None:
        held = select_lt(before, task.hold - 0.5, held, before)
    store_where(lane, live, record, HOLD, held, before)
    success = select_lt(held, task.hold - 0.5, 0.0, 1.0)
    put_info(lane, live, info, SUCCESS, success)


@kernel
def effort(lane, task, action: Lanes):
    """Return the sum of squares of the joints' actions (-1 to 1), at most the number of joints."""
    total = 0.0
    for k in range(size(task.links)):
        a = action[k]
        total = total + a * a
    return total


@kernel
def settled(lane, square):
    """Return 1 / (1 + square^2), the reward term `settle`: 1 at rest on the target, 1/2 if square is 1.

    square: sum of squares of errors (position, speed, ...), each divided by its success band.
    """
    return 1.0 / (square * square + 1.0)


@kernel
def left_of(task, loss):
    """Return the reward for a loss between 0 and 1: 1 - loss if task.nearness is not None, otherwise -loss.

    With 1 - loss the reward is never negative, so that an early end of the episode is never an advantage.
    """
    if task.nearness is not None:
        return 1.0 - loss
    return -loss


@kernel
def reward_change(lane, task, action: Lanes, record: Lanes, live, info, total):
    """Return total plus the weighted term -sum (action - last action)^2; total if the term has no weight (task.acted).

    The term's value is also written into info, before the failure term. For running arms (live > 1/2) the action
    (joints, lanes) is stored in the record as the last action.
    """
    change = 0.0
    for j in range(size(task.acted)):
        # sum_j (u_j - u_j of the last period)^2; last actions are behind the goal angles
        at = GOAL + size(task.links) + j
        before, now = record[at], action[j]
        change = change + (now - before) * (now - before)
        store_where(lane, live, record, at, now, before)
    if size(task.acted) > 0:
        total = total + reward_term(lane, task, live, info, size(task.terms) - 2, -change)
    return total


@kernel
def reward_term(lane, task, live, info, k, value):
    """Return value times the weight of reward term k (task.weights); write this product into info for running arms."""
    # info holds weighted terms, so that they add up to the reward
    weighted = value * task.weights[k]
    put_info(lane, live, info, info_of(task).terms + k, weighted)
    return weighted


@kernel
def record_deflections(lane, task, poses: Lanes, live, info: Lanes):
    """Write tip deflections / link lengths into info for running arms (live > 1/2); return a vibration measure, 1/s^2.

    The measure is the sum of the squared rates of deflection / link length, in the axes of the links' roots.
    """
    shaking = 0.0
    for k in range(size(task.links)):
        normal, _, rate, _, _, _, _, _, _ = deflection(lane, poses, k)
        put_info(lane, live, info, DEFLECTION + k, normal / task.lengths[k])
        rate = rate / task.lengths[k]
        shaking = shaking + rate * rate
    return shaking


@kernel
def record_tip(lane, task, poses: Lanes, record: Lanes, live, info):
    """Write the tip's position (m, inertial axes) and the target (m or rad) into info for running arms (live > 1/2).

    poses: positions, angles and rates of the links, inertial axes. record: records of the arms; the target is read.
    """
    o, at = POSE.end * (size(task.links) - 1), info_of(task).target
    put_info(lane, live, info, TIP, poses[o + POSE.tip_x])
    put_info(lane, live, info, TIP + 1, poses[o + POSE.tip_y])
    for k in range(size(task.targets)):
        put_info(lane, live, info, at + k, record[TARGET + k])
