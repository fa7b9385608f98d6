"""What an environment sees and pays: observation, success and reward of the two tasks, for one arm or a lane group.

`poses` holds 12 numbers a link (`protocol.link_poses`); each observed entry is divided by its scale and clipped to
+-10. Everything here is arithmetic on lanes, so that a batch and a single arm give the same bits.

    observe(lane, task, poses, record, out)                the scaled observation into the first entries of `out`
    judge(lane, task, poses, action, record, live, info)   success and reward terms into `info`, where `live` > 1/2;
                                                           returns (reward, joint limit passed: 1 or 0)
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..compiler.decorator import kernel
from ..compiler.dispatch import Family, size
from ..compiler.lanes import absolute, load, select_lt, sincos, splat, square_root, store
from ..physics.arithmetic import arctangent, clip, decay, put, smaller
from .program import CLIP, DEFLECTION, GOAL, HOLD, SUCCESS, TARGET, TARGET_RATE, TIP


class Slew(NamedTuple):
    """One link turns its tip to a polar angle. scales (6,), weights (6,): see `envs.flexible_arm`."""

    links: tuple[int, ...]
    targets: tuple[int, ...]
    terms: tuple[int, ...]
    entries: tuple[int, ...]
    length: float
    scales: np.ndarray
    weights: np.ndarray
    torque_limits: np.ndarray
    joint_limits: np.ndarray  # (2 n_links,): low, high of each joint, rad
    hold: float  # instants in the band that make a success


class Reach(NamedTuple):
    """Two links bring their tip to a point. scales (14,), weights (6,): see `envs.two_link`."""

    links: tuple[int, ...]
    targets: tuple[int, ...]
    terms: tuple[int, ...]
    entries: tuple[int, ...]
    length: float
    scales: np.ndarray
    weights: np.ndarray
    torque_limits: np.ndarray
    joint_limits: np.ndarray
    hold: float
    lengths: np.ndarray


TASKS = Family("task")
"""Each task's functions, by the class of its record."""

observe = TASKS.function("observe", "lane, task, poses, record, out")
judge = TASKS.function("judge", "lane, task, poses, action, record, live, info")
aim = TASKS.function("aim", "task, record")


@kernel
def _deflection(lane, poses, k):  # type: ignore[no-untyped-def]
    """(normal, along, normal rate, dx, dy, dvx, dvy, sine, cosine) of link k: tip less root, in and out of the root's
    turning frame."""
    o = 12 * k
    sine, cosine = sincos(load(lane, poses, o + 2))
    dx, dy = load(lane, poses, o + 6) - load(lane, poses, o), load(lane, poses, o + 7) - load(lane, poses, o + 1)
    dvx = load(lane, poses, o + 9) - load(lane, poses, o + 3)
    dvy = load(lane, poses, o + 10) - load(lane, poses, o + 4)
    normal, along = cosine * dy - sine * dx, cosine * dx + sine * dy
    rate = cosine * dvy - sine * dvx - load(lane, poses, o + 5) * along
    return normal, along, rate, dx, dy, dvx, dvy, sine, cosine


@kernel
def _scaled(lane, task, out, k, value):  # type: ignore[no-untyped-def]
    store(out, k, clip(value / task.scales[k], CLIP))


@kernel
def _past_limits(lane, task, poses):  # type: ignore[no-untyped-def]
    """1 where a joint's angle is beyond its limits."""
    past = splat(lane, 0.0)
    before = splat(lane, 0.0)
    for k in range(size(task.links)):
        angle = load(lane, poses, 12 * k + 2) - before
        past = select_lt(angle, task.joint_limits[2 * k], 1.0, past)
        past = select_lt(task.joint_limits[2 * k + 1], angle, 1.0, past)
        before = load(lane, poses, 12 * k + 8)
    return past


@kernel
def _held(lane, task, good, record, live, info):  # type: ignore[no-untyped-def]
    """Count the instants in the band; success is a count that reaches task.hold."""
    before = load(lane, record, HOLD)
    held = select_lt(0.5, good, before + 1.0, splat(lane, 0.0))
    put(live, record, HOLD, held, before)
    success = select_lt(held, task.hold - 0.5, splat(lane, 0.0), splat(lane, 1.0))
    put(live, info, SUCCESS, success, load(lane, info, SUCCESS))


@kernel
def _effort(lane, task, action):  # type: ignore[no-untyped-def]
    total = splat(lane, 0.0)
    for k in range(size(task.links)):
        a = load(lane, action, k)
        total = total + a * a
    return total


@kernel
def _pay(lane, task, live, info, k, value):  # type: ignore[no-untyped-def]
    """Reward term k, weighted, into info."""
    first = DEFLECTION + 2 * size(task.links) + size(task.targets)
    weighted = value * task.weights[k]
    put(live, info, first + k, weighted, load(lane, info, first + k))
    return weighted


@kernel
def _note(lane, task, poses, record, live, info):  # type: ignore[no-untyped-def]
    """Tip position and target into info."""
    n = size(task.links)
    o = 12 * n - 12
    put(live, info, TIP, load(lane, poses, o + 6), load(lane, info, TIP))
    put(live, info, TIP + 1, load(lane, poses, o + 7), load(lane, info, TIP + 1))
    for k in range(size(task.targets)):
        put(live, info, DEFLECTION + n + k, load(lane, record, TARGET + k), load(lane, info, DEFLECTION + n + k))


# --- slew ----------------------------------------------------------------------------------------------


@kernel
def slew_observe(lane, task, poses, record, out):  # type: ignore[no-untyped-def]
    """sin, cos of the hub angle; hub rate; tip deflection and rate over L; target less tip angle, unwrapped."""
    normal, along, rate, _, _, _, _, sine, cosine = _deflection(lane, poses, 0)
    _scaled(lane, task, out, 0, sine)
    _scaled(lane, task, out, 1, cosine)
    _scaled(lane, task, out, 2, load(lane, poses, 5))
    _scaled(lane, task, out, 3, normal / task.length)
    _scaled(lane, task, out, 4, rate / task.length)
    error = load(lane, record, TARGET) - (load(lane, poses, 2) + arctangent(normal, along))
    _scaled(lane, task, out, 5, error)


@kernel
def slew_judge(lane, task, poses, action, record, live, info):  # type: ignore[no-untyped-def]
    """Terms: accuracy, settle, distance, effort, vibration."""
    normal, along, rate, dx, dy, dvx, dvy, _, _ = _deflection(lane, poses, 0)
    error = absolute(load(lane, record, TARGET) - (load(lane, poses, 2) + arctangent(normal, along)))
    turning = (dx * dvy - dy * dvx) / (dx * dx + dy * dy)
    rate = absolute(rate / task.length)
    put(live, info, DEFLECTION, normal / task.length, load(lane, info, DEFLECTION))
    good = select_lt(error, math.pi / 180.0, splat(lane, 1.0), splat(lane, 0.0))
    good = select_lt(rate, 0.01, good, splat(lane, 0.0))
    _held(lane, task, good, record, live, info)
    _note(lane, task, poses, record, live, info)
    wide, narrow, slow = error * 10.0, error * 50.0, (turning - load(lane, record, TARGET_RATE)) * 5.0
    total = _pay(lane, task, live, info, 0, decay(wide * wide))
    total = total + _pay(lane, task, live, info, 1, decay(narrow * narrow + slow * slow))
    total = total + _pay(lane, task, live, info, 2, -smaller(error, 1.0))
    total = total + _pay(lane, task, live, info, 3, -_effort(lane, task, action))
    total = total + _pay(lane, task, live, info, 4, -smaller(rate * rate, 1.0))
    return total, _past_limits(lane, task, poses)


@kernel
def slew_aim(task, record):  # type: ignore[no-untyped-def]
    """Joint angle that reaches the target."""
    store(record, GOAL, record[TARGET])


# --- reach ---------------------------------------------------------------------------------------------


@kernel
def reach_observe(lane, task, poses, record, out):  # type: ignore[no-untyped-def]
    """Joints, rates, deflections and rates, tip velocity and way to the target in the hub's frame (`envs.two_link`)."""
    n = size(task.links)
    before, spin = splat(lane, 0.0), splat(lane, 0.0)
    hub_sine, hub_cosine = splat(lane, 0.0), splat(lane, 1.0)
    for k in range(n):
        o = 12 * k
        normal, _, rate, _, _, _, _, sine, cosine = _deflection(lane, poses, k)
        if k == 0:
            hub_sine, hub_cosine = sine, cosine
        else:
            sine, cosine = sincos(load(lane, poses, o + 2) - before)
        _scaled(lane, task, out, 2 * k, sine)
        _scaled(lane, task, out, 2 * k + 1, cosine)
        _scaled(lane, task, out, 2 * n + k, load(lane, poses, o + 5) - spin)
        _scaled(lane, task, out, 3 * n + k, normal / task.lengths[k])
        _scaled(lane, task, out, 4 * n + k, rate / task.lengths[k])
        before, spin = load(lane, poses, o + 8), load(lane, poses, o + 11)
    o = 12 * n - 12
    vx, vy = load(lane, poses, o + 9), load(lane, poses, o + 10)
    dx = load(lane, record, TARGET) - load(lane, poses, o + 6)
    dy = load(lane, record, TARGET + 1) - load(lane, poses, o + 7)
    _scaled(lane, task, out, 5 * n, hub_cosine * vx + hub_sine * vy)
    _scaled(lane, task, out, 5 * n + 1, hub_cosine * vy - hub_sine * vx)
    _scaled(lane, task, out, 5 * n + 2, hub_cosine * dx + hub_sine * dy)
    _scaled(lane, task, out, 5 * n + 3, hub_cosine * dy - hub_sine * dx)


@kernel
def reach_judge(lane, task, poses, action, record, live, info):  # type: ignore[no-untyped-def]
    """Terms: accuracy, settle, distance, effort, vibration."""
    n = size(task.links)
    shaking = splat(lane, 0.0)
    for k in range(n):
        normal, _, rate, _, _, _, _, _, _ = _deflection(lane, poses, k)
        put(live, info, DEFLECTION + k, normal / task.lengths[k], load(lane, info, DEFLECTION + k))
        rate = rate / task.lengths[k]
        shaking = shaking + rate * rate
    o = 12 * n - 12
    vx, vy = load(lane, poses, o + 9), load(lane, poses, o + 10)
    dx = load(lane, record, TARGET) - load(lane, poses, o + 6)
    dy = load(lane, record, TARGET + 1) - load(lane, poses, o + 7)
    vx, vy = vx - load(lane, record, TARGET_RATE), vy - load(lane, record, TARGET_RATE + 1)
    error = square_root(dx * dx + dy * dy) / task.length
    speed = square_root(vx * vx + vy * vy) / task.length
    good = select_lt(error, 0.01, splat(lane, 1.0), splat(lane, 0.0))
    good = select_lt(speed, 0.05, good, splat(lane, 0.0))
    _held(lane, task, good, record, live, info)
    _note(lane, task, poses, record, live, info)
    wide, narrow, slow = error * 10.0, error * 50.0, speed * 10.0
    total = _pay(lane, task, live, info, 0, decay(wide * wide))
    total = total + _pay(lane, task, live, info, 1, decay(narrow * narrow + slow * slow))
    total = total + _pay(lane, task, live, info, 2, -smaller(error, 1.0))
    total = total + _pay(lane, task, live, info, 3, -_effort(lane, task, action))
    total = total + _pay(lane, task, live, info, 4, -smaller(shaking, 1.0))
    return total, _past_limits(lane, task, poses)


@kernel
def reach_aim(task, record):  # type: ignore[no-untyped-def]
    """Joint angles of the straight-linked arm that reach the target: of the two solutions the one that the joints, at
    the record's angles, are sooner at (joint k takes a time for an angle x that goes as sqrt(|x|) / its rate's scale).
    """
    a, b = task.lengths[0], task.lengths[1]
    x, y = record[TARGET], record[TARGET + 1]
    cosine = (x * x + y * y - a * a - b * b) / (2.0 * a * b)
    bend = math.acos(min(1.0, max(-1.0, cosine)))
    bearing, inner = math.atan2(y, x), math.atan2(b * math.sin(bend), a + b * math.cos(bend))
    hub_now, elbow_now = record[GOAL], record[GOAL + 1]
    least = math.inf
    for side in (1.0, -1.0):
        elbow, hub = side * bend, bearing - side * inner
        hub -= 2.0 * math.pi * math.floor((hub - hub_now) / (2.0 * math.pi) + 0.5)
        way = max(abs(hub - hub_now) / task.scales[4] ** 2, abs(elbow - elbow_now) / task.scales[5] ** 2)
        if elbow < task.joint_limits[2] or elbow > task.joint_limits[3]:
            way += 1e6
        if way < least:
            least = way
            record[GOAL], record[GOAL + 1] = hub, elbow


TASKS.register(Slew, observe=slew_observe, judge=slew_judge, aim=slew_aim)
TASKS.register(Reach, observe=reach_observe, judge=reach_judge, aim=reach_aim)
