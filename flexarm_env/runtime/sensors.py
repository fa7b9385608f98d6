"""What sensors make of an observation: readings by their laws, strain gauges, noise and delay, choice and history."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ..compiler import arms, kernel, load, maximum, pick, place, sincos, size, square_root, store
from ..physics.arithmetic import arctangent, clip
from ..physics.layout import BASE_POSE, POSE, SPACE_POSE
from ..physics.protocol import gauge, ports
from ..physics.space.rotations import matrix, quaternion, times, turned
from ..tasks.program import CLIP, FURTHER, GOAL, TARGET, channel_at
from ..tasks.stream import draw_whole
from ..tasks.task import info_of
from .inertial import specific_force
from .laws import LAW_SIZE, channel_of, normal, read, read_encoder, tip_acceleration


@kernel
def read_gauges(lane, sensors, entries, model, q, seen):
    """Scaled curvatures at the gauges, the last entries of the observation."""
    if sensors is not None:
        n = size(model.n)
        count = sensors.gauges.shape[0] // n
        for g in range(count):
            read = gauge(lane, model, q, sensors.gauges[g * n : (g + 1) * n])
            store(seen, entries - count + g, clip(read, CLIP))


@kernel
def record_motor_angles(lane, instruments, model, par, record, w):
    """Motors' angles to where their encoders will find them."""
    if instruments is not None:
        if instruments.motors is not None:
            base = record.shape[0] // len(lane) - readings_size(instruments)
            ports(lane, model, par, w.q, w.y)
            for k in range(instruments.motors.shape[0]):
                store(record, channel_of(base, instruments.room, k).motor, load(lane, w.y, k))


@kernel
def write_observation(lane, p, arm, poses, record, seen, first):
    """The observation of one arm, as it is measured; first: of an episode, nothing to remember."""
    measure(lane, p, p.stream, arm, poses, record, seen, first)
    _select(len(lane), p, arm, record, seen, first)


@kernel
def measure(lane, p, stream, arm, poses, record, seen, first):
    """Entries as sensors read them, in the place of the true ones; stream: see `read`."""
    instruments = p.instruments
    if instruments is not None:
        base, at = record.shape[0] // len(lane) - readings_size(instruments), size(p.task.entries)
        if p.reference is not None:
            at += p.reference.scales.shape[0]
        who = Who(stream, arm, arm % arms(lane), base, first)
        c = _encoders(lane, p, instruments, who, poses, record, seen)
        _turned(lane, p, instruments, who, poses, record, seen)
        at = _goals(lane, p, instruments, who, at, poses, record, seen)
        felt = _acceleration(lane, p, instruments, who, c, poses, record)
        for readings in (felt, _spin(lane, p, instruments, who, poses), _picture(lane, p, instruments, who, poses)):
            for value in readings:
                _show(lane, instruments, who, at, c, record, seen, value)
                at, c = at + 1, c + 1
        _gauges(lane, p, instruments, who, c, record, seen)


class Who(NamedTuple):
    """Whose sensors are read."""

    stream: Any  # of random numbers, or None
    arm: int
    i: int  # its lane
    base: int  # of its channels in the record
    first: bool  # in its episode


@kernel
def readings_size(instruments):
    """Numbers that sensors remember, the last of a record."""
    if instruments is not None:
        return (instruments.laws.shape[0] // LAW_SIZE) * channel_at(0, instruments.room).end
    return 0


@kernel
def _true_angle(lane, task, i, k, poses):
    """Angle of joint k."""
    if size(task.targets) == 3:
        return pick(lane, poses, SPACE_POSE.end * k + SPACE_POSE.angle, i)
    angle = pick(lane, poses, POSE.end * k + POSE.angle, i)
    if k == 0 and size(task.base) > 0:
        angle = angle - pick(lane, poses, POSE.end * size(task.links) + BASE_POSE.angle, i)
    if k > 0:
        angle = angle - pick(lane, poses, POSE.end * (k - 1) + POSE.tip_angle, i)
    return angle


@kernel
def _angle(lane, task, instruments, who, k, poses, record):
    """Angle of joint k as its encoder reads it, or as it is where there is none."""
    if instruments.encoders is not None:
        return pick(lane, record, channel_of(who.base, instruments.room, k).reading, who.i)
    return _true_angle(lane, task, who.i, k, poses)


@kernel
def _encoders(lane, p, instruments, who, poses, record, seen):
    """Sine, cosine and rate of each joint; returns the next channel."""
    if instruments.encoders is not None:
        i, n, encoders = who.i, size(p.task.links), instruments.encoders
        for k in range(n):
            true = _true_angle(lane, p.task, i, k, poses)
            if instruments.motors is not None:
                if instruments.motors[k] == 1:  # it turns with the motor
                    true = pick(lane, record, channel_of(who.base, instruments.room, k).motor, i)
            angle, rate = read_encoder(
                lane, instruments.laws, instruments.room, k, record, who.base, who.stream, who.arm, true, who.first
            )
            sine, cosine = sincos(angle)
            place(lane, seen, encoders[3 * k], i, sine)
            place(lane, seen, encoders[3 * k + 1], i, cosine)
            place(lane, seen, encoders[3 * k + 2], i, clip(rate / p.task.scales[encoders[3 * k + 2]], CLIP))
        return n
    return 0


@kernel
def _turned(lane, p, instruments, who, poses, record, seen):
    """What is shown of a moving point, from the frame of the hub's angle into that of its encoder's."""
    if instruments.encoders is not None:
        if p.reference is not None:
            i, first, count = who.i, size(p.task.entries), p.reference.scales.shape[0]
            if p.reference.axis is not None:
                axis = (p.reference.axis[0], p.reference.axis[1], p.reference.axis[2])
                read_as = _angle(lane, p.task, instruments, who, 0, poses, record)
                turn = matrix(quaternion(times(axis, _true_angle(lane, p.task, i, 0, poses) - read_as)))
                for k in range(first, first + count, 3):
                    a = (pick(lane, seen, k, i), pick(lane, seen, k + 1, i), pick(lane, seen, k + 2, i))
                    b = turned(turn, a)
                    for d in range(3):
                        place(lane, seen, k + d, i, clip(b[d], CLIP))
            elif size(p.task.targets) == 2:
                off = _angle(lane, p.task, instruments, who, 0, poses, record)
                sine, cosine = sincos(off - pick(lane, poses, POSE.angle, i))
                for k in range(first, first + count, 2):
                    x, y = pick(lane, seen, k, i), pick(lane, seen, k + 1, i)
                    place(lane, seen, k, i, clip(cosine * x + sine * y, CLIP))
                    place(lane, seen, k + 1, i, clip(cosine * y - sine * x, CLIP))


@kernel
def _goals(lane, p, instruments, who, at, poses, record, seen):
    """Joint angles at the goal less encoder angles, rad, and a point, over the arm's length; returns the next entry."""
    if instruments.goals is not None:
        i, n, targets = who.i, size(p.task.links), size(p.task.targets)
        for k in range(n):
            angle = _angle(lane, p.task, instruments, who, k, poses, record)
            place(lane, seen, at + k, i, clip(pick(lane, record, GOAL + k, i) - angle, CLIP))
        if targets == 1:
            return at + n
        for d in range(targets):
            place(lane, seen, at + n + d, i, clip(pick(lane, record, TARGET + d, i) / p.task.length, CLIP))
        return at + n + targets
    return at


@kernel
def _show(lane, instruments, who, at, c, record, seen, value):
    """Entry `at`: what channel c reads of a value."""
    laws, room, arm = instruments.laws, instruments.room, who.arm
    shown = read(lane, laws, room, c, record, who.base, who.stream, arm, value, who.first)
    place(lane, seen, at, who.i, clip(shown, CLIP))


@kernel
def _of_tip(lane, p, who, poses, field):
    """Three numbers of the last link's pose in space."""
    o = SPACE_POSE.end * (size(p.task.links) - 1) + field
    return pick(lane, poses, o, who.i), pick(lane, poses, o + 1, who.i), pick(lane, poses, o + 2, who.i)


@kernel
def _acceleration(lane, p, instruments, who, c, poses, record):
    """What an accelerometer feels along the tip's tangent and across it, in space along its axes; c: its channel."""
    accelerometer = instruments.accelerometer
    if accelerometer is None:
        return ()
    i, room, period = who.i, instruments.room, instruments.period
    if size(p.task.targets) == 3:
        x, y, z = specific_force(
            lane, record, who.base, room, c, i, _of_tip(lane, p, who, poses, SPACE_POSE.tip),
            _of_tip(lane, p, who, poses, SPACE_POSE.turn), _of_tip(lane, p, who, poses, SPACE_POSE.velocity),
            _of_tip(lane, p, who, poses, SPACE_POSE.spin), period,
            (accelerometer[0], accelerometer[1], accelerometer[2]), who.first,
        )  # fmt: skip
        return x / accelerometer[3], y / accelerometer[3], z / accelerometer[3]
    o = POSE.end * (size(p.task.links) - 1)
    x, vx = pick(lane, poses, o + POSE.tip_x, i), pick(lane, poses, o + POSE.tip_vx, i)
    y, vy = pick(lane, poses, o + POSE.tip_y, i), pick(lane, poses, o + POSE.tip_vy, i)
    angle, rate = pick(lane, poses, o + POSE.tip_angle, i), pick(lane, poses, o + POSE.tip_rate, i)
    along, across = tip_acceleration(
        lane, record, who.base, room, c, i, x, y, angle, vx, vy, rate, period, accelerometer[0], accelerometer[1],
        who.first,
    )  # fmt: skip
    return along / accelerometer[2], across / accelerometer[2]


@kernel
def _spin(lane, p, instruments, who, poses):
    """Angular velocity about the tip's axes, where there is a gyroscope."""
    if instruments.gyroscope is None:
        return ()
    x, y, z = _of_tip(lane, p, who, poses, SPACE_POSE.spin)
    return x / instruments.gyroscope, y / instruments.gyroscope, z / instruments.gyroscope


@kernel
def rise(x):
    """The angle whose sine is x, from -pi/2 to pi/2."""
    return arctangent(x, square_root(maximum(1.0 - x * x, 0.0)))


@kernel
def _picture(lane, p, instruments, who, poses):
    """The tip's position that a camera sees, in space also by what its axis rises towards y and z."""
    if instruments.camera is None:
        return ()
    if size(p.task.targets) == 3:
        x, y, z = _of_tip(lane, p, who, poses, SPACE_POSE.tip)
        A = matrix(quaternion(_of_tip(lane, p, who, poses, SPACE_POSE.turn)))
        return x / instruments.camera, y / instruments.camera, z / instruments.camera, rise(A[1][0]), rise(A[2][0])
    o = POSE.end * (size(p.task.links) - 1) + POSE.tip_x
    return pick(lane, poses, o, who.i) / instruments.camera, pick(lane, poses, o + 1, who.i) / instruments.camera


@kernel
def _gauges(lane, p, instruments, who, c, record, seen):
    if instruments.gauges is not None:
        count = size(instruments.gauges)
        for g in range(count):
            k = p.entries - count + g
            _show(lane, instruments, who, k, c + g, record, seen, pick(lane, seen, k, who.i))


# --- the observation -----------------------------------------------------------------------------------
@kernel
def _select(lanes, p, arm, record, seen, first):
    """All entries, or those that are chosen, behind the observations before."""
    selection, observation = p.selection, p.observation
    if selection is not None:
        count, older = selection.chosen.shape[0], selection.chosen.shape[0] * (selection.frames - 1)
        out = arm * (count + older)
        for j in range(older):
            observation[out + j] = observation[out + j + count]
        for j in range(count):
            observation[out + older + j] = _entry(lanes, p, arm, selection.chosen[j], record, seen, first)
        if first:
            for j in range(older):
                observation[out + j] = observation[out + older + j % count]
    else:
        out = arm * p.entries
        for k in range(p.entries):
            observation[out + k] = _entry(lanes, p, arm, k, record, seen, first)


@kernel
def _past_at(lanes, p, record):
    """Where past observations are, `RECORD.seen`; before them how late they come, where that is drawn."""
    return record.shape[0] // lanes - readings_size(p.instruments) - p.entries * p.sensors.age


@kernel
def draw_age(p, arm, record, lanes):
    """By how many periods the observations of arm's episode come late, where that is drawn."""
    if p.sensors is not None and p.sensors.drawn is not None:
        record[(_past_at(lanes, p, record) - 1) * lanes + arm % lanes] = draw_whole(p.stream, arm, p.sensors.drawn)


@kernel
def record_drawn(lanes, p, i, record, info):
    """What of the sensors is drawn for the episode of the arm in lane i into info: how late they are, and gains."""
    first, instruments = info_of(p.task).further + FURTHER.told, p.instruments
    if p.sensors is not None and p.sensors.drawn is not None:
        info[(first + 1) * lanes + i] = record[(_past_at(lanes, p, record) - 1) * lanes + i] * p.period
    if instruments is not None:
        base = record.shape[0] // lanes - readings_size(instruments)
        for c in range(size(p.task.further) - FURTHER.told - 2):
            info[(first + 2 + c) * lanes + i] = record[channel_of(base, instruments.room, c).gain * lanes + i]


@kernel
def _entry(lanes, p, arm, k, record, seen, first):
    """Entry k of the observation with its noise, as it arrives."""
    value, sensors = seen[k * lanes + arm % lanes], p.sensors
    if sensors is not None:
        if sensors.noise[k] > 0.0:
            value = min(CLIP, max(-CLIP, value + sensors.noise[k] * normal(p.stream, arm)))
        past = _past_at(lanes, p, record)
        arrived = value
        for j in range(sensors.age):
            at = (past + j * p.entries + k) * lanes + arm % lanes
            if first:
                record[at] = value
            older = record[at]
            record[at] = value
            value = older
            if sensors.drawn is not None:  # of which that many periods are the episode's
                if j < record[(past - 1) * lanes + arm % lanes]:
                    arrived = value
        if sensors.drawn is not None:
            value = arrived
    return np.float32(value)
