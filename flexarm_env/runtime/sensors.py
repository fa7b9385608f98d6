"""From the true state to the observation: sensor readings, strain gauges, noise, delay, selection and history.

A reading is a quantity that a sensor measures by a law (`laws.read`). Each reading has a channel, which stores past
values of the quantity. Entries of the observation are divided by their scales and limited to +-CLIP.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ..compiler import Lanes, kernel, lane_count, load_lane, maximum, sincos, size, square_root, store_lane
from ..physics.arithmetic import arctangent, clip
from ..physics.integrator.work import Work
from ..physics.layout import BASE_POSE, POSE, SPACE_POSE
from ..physics.protocol import input_displacements, strain_gauge
from ..physics.space.rotations import Vector, matrix, quaternion
from ..tasks.program import CLIP, FURTHER, GOAL, TARGET, channel_at
from ..tasks.stream import draw_whole
from ..tasks.task import info_of
from .inertial import specific_force
from .laws import LAW_SIZE, channel_of, normal, read, read_encoder, tip_acceleration
from .touch import contact_channels, contact_entries


@kernel
def read_gauges(lane, sensors, entries, model, q, seen: Lanes):
    """Write the curvatures at strain gauges, divided by their scales and limited to +-CLIP, to the end of `seen`.

    sensors.gauges (G, n): one row per gauge, whose product with q is curvature / scale. entries: length of the
    observation. q (n, lanes): coordinates. Without gauges (sensors is None) the kernel does nothing.
    """
    if sensors is not None:
        n = size(model.n)
        count = sensors.gauges.shape[0] // n
        for g in range(count):
            read = strain_gauge(lane, model, q, sensors.gauges[g * n : (g + 1) * n])
            seen[entries - count + g] = clip(read, CLIP)


@kernel
def record_motor_angles(lane, instruments, model, par, record: Lanes, w: Work):
    """Store the motors' angles (rad, divided by the gear ratio) in the record's channels, for encoders on motors.

    The encoder of joint k reads channel k. w.q: coordinates (m, rad). w.y is scratch memory.
    """
    if instruments is not None:
        if instruments.motors is not None:
            base = record.shape[0] - readings_size(instruments)
            input_displacements(lane, model, par, w.q, w.y)
            for k in range(instruments.motors.shape[0]):
                record[channel_of(base, instruments.room, k).motor] = w.y[k]


@kernel
def write_observation(lane, p, arm, poses, record, seen, first):
    """Replace one arm's true entries by sensor readings and write them to the arm's row of p.observation (float32).

    arm: index of the arm in the batch. poses: the links' poses, inertial axes. record: channels (memory of the
    sensors). seen: true entries at entry, measured entries at return. first: whether the episode begins.
    """
    measure(lane, p, p.stream, arm, poses, record, seen, first)
    _select(len(lane), p, arm, record, seen, first)


@kernel
def measure(lane, p, stream, arm, poses, record, seen, first):
    """Replace the true entries of one arm in `seen` by its sensors' readings.

    A channel is the memory of a sensor for one number. Channels are in the order encoders, accelerometer, gyroscope,
    camera, force, switch, gauges; each sensor replaces or adds its entries in `seen`. arm: index of the arm in the
    batch. stream: random numbers, or None for readings without noise and without drawn gains or biases. first: whether
    the episode begins. poses: the links' poses, m, rad, inertial axes.
    """
    instruments = p.instruments
    if instruments is not None:
        # channels are the last numbers of the record, so that offsets of all others do not depend on the sensors
        base, at = record.shape[0] // len(lane) - readings_size(instruments), size(p.task.entries)
        if p.reference is not None:
            at += p.reference.scales.shape[0]
        # encoders first, because frames of moving targets and goals use the angles that they read
        who = Who(stream, arm, arm % lane_count(lane), base, first)
        c = _encoders(lane, p, instruments, who, poses, record, seen)
        _turned(lane, p, instruments, who, poses, record, seen)
        at = _goals(lane, p, instruments, who, at, poses, record, seen)
        # accelerometer (m/s^2), gyroscope (rad/s), camera (rad or m): one entry and one channel for each number
        felt = _acceleration(lane, p, instruments, who, c, poses, record)
        for readings in (felt, _spin(lane, p, instruments, who, poses), _picture(lane, p, instruments, who, poses)):
            for value in readings:
                _show(lane, instruments, who, at, c, record, seen, value)
                at, c = at + 1, c + 1
        # force sensor and contact switch: `record_contact_forces` has stored their readings
        for _ in range(contact_channels(instruments)):
            value = load_lane(lane, record, channel_of(base, instruments.room, c).motor, who.i)
            _show(lane, instruments, who, at, c, record, seen, value)
            at, c = at + 1, c + 1
        _gauges(lane, p, instruments, who, c, record, seen)


class Who(NamedTuple):
    """The arm whose sensors are read: its index in the batch, lane, channels and random numbers."""

    stream: Any  # states of all arms' random numbers; None: readings without noise
    arm: int  # index of the arm in the batch and in `stream`
    i: int  # lane of the arm
    base: int  # offset of the arm's first sensor channel in the record
    first: bool  # whether this is the first reading of an episode


@kernel
def readings_size(instruments):
    """Return the total length of the sensors' channels, which are the last numbers of a record; 0 without instruments.

    A channel is the memory of a sensor for one number (`program.CHANNEL`).
    """
    if instruments is not None:
        return (instruments.laws.shape[0] // LAW_SIZE) * channel_at(0, instruments.room).end
    return 0


@kernel
def _true_angle(lane, task, i, k, poses):
    """Return the true angle of joint k, rad, of the arm in lane i, from poses of the links in inertial axes.

    In the plane the joint angle is the link's root angle minus the tip angle of the preceding link, or minus the
    attitude of a floating base. Poses in space (targets of three numbers) contain the angle itself.
    """
    if size(task.targets) == 3:
        return load_lane(lane, poses, SPACE_POSE.end * k + SPACE_POSE.angle, i)
    angle = load_lane(lane, poses, POSE.end * k + POSE.angle, i)
    if k == 0 and size(task.base) > 0:
        angle = angle - load_lane(lane, poses, POSE.end * size(task.links) + BASE_POSE.angle, i)
    if k > 0:
        angle = angle - load_lane(lane, poses, POSE.end * (k - 1) + POSE.tip_angle, i)
    return angle


@kernel
def _angle(lane, task, instruments, who, k, poses, record):
    """Return the angle of joint k (rad) that its encoder reads, or the true angle if there are no encoders.

    who: the arm, a `Who`. poses: links' poses, inertial axes. record: channels of the sensors, with the last readings.
    """
    if instruments.encoders is not None:
        return load_lane(lane, record, channel_of(who.base, instruments.room, k).reading, who.i)
    return _true_angle(lane, task, who.i, k, poses)


@kernel
def _encoders(lane, p, instruments, who, poses, record, seen):
    """Read the encoders: write sine, cosine and scaled rate of each joint into `seen`; return the next channel.

    who: the arm, a `Who`.
    # in        poses of the links (inertial axes), or motor angles in the channels
    # out       seen, at the indices instruments.encoders: sine, cosine, rate divided by its scale, limited to +-CLIP
    #           record, channels 0 ... N - 1, one for each joint
    """
    if instruments.encoders is not None:
        i, n, encoders = who.i, size(p.task.links), instruments.encoders
        for k in range(n):
            # angle of the joint between both sections, behind the gear (rad)
            true = _true_angle(lane, p.task, i, k, poses)
            # an encoder on the motor reads the motor's angle, after the ratio
            if instruments.motors is not None:
                if instruments.motors[k] == 1:
                    true = load_lane(lane, record, channel_of(who.base, instruments.room, k).motor, i)
            # angle with its law, and rate <- filtered differences of readings: an encoder has no rate of its own
            angle, rate = read_encoder(
                lane, instruments.laws, instruments.room, k, record, who.base, who.stream, who.arm, true, who.first
            )
            sine, cosine = sincos(angle)
            store_lane(lane, seen, encoders[3 * k], i, sine)
            store_lane(lane, seen, encoders[3 * k + 1], i, cosine)
            store_lane(lane, seen, encoders[3 * k + 2], i, clip(rate / p.task.scales[encoders[3 * k + 2]], CLIP))
        return n
    return 0


@kernel
def _turned(lane, p, instruments, who, poses, record, seen):
    """Rotate the entries of a moving target from the frame of the true hub angle to that of the measured hub angle.

    The entries are vectors in axes that turn with the hub: the target's rate and its future displacements, divided by
    their scales. The entries were written for the true angle; the observer knows only the measured angle. Angular
    targets of one number are not rotated. who: the arm, a `Who`. poses: links' poses, inertial axes.
    """
    if instruments.encoders is not None:
        if p.reference is not None:
            i, first, count = who.i, size(p.task.entries), p.reference.scales.shape[0]
            # in space: exp(axis (true - measured)), axis of joint 0 (inertial): the target as the encoder sees it
            if p.reference.axis is not None:
                axis = Vector(p.reference.axis[0], p.reference.axis[1], p.reference.axis[2])
                read_as = _angle(lane, p.task, instruments, who, 0, poses, record)
                turn = matrix(quaternion((_true_angle(lane, p.task, i, 0, poses) - read_as) * axis))
                for k in range(first, first + count, 3):
                    x, y = load_lane(lane, seen, k, i), load_lane(lane, seen, k + 1, i)
                    a = Vector(x, y, load_lane(lane, seen, k + 2, i))
                    b = turn @ a
                    for d in range(3):
                        store_lane(lane, seen, k + d, i, clip(b[d], CLIP))
            elif size(p.task.targets) == 2:
                off = _angle(lane, p.task, instruments, who, 0, poses, record)
                sine, cosine = sincos(off - load_lane(lane, poses, POSE.angle, i))
                # in the plane: rotated by measured - true, the target as the encoder sees it
                for k in range(first, first + count, 2):
                    x, y = load_lane(lane, seen, k, i), load_lane(lane, seen, k + 1, i)
                    store_lane(lane, seen, k, i, clip(cosine * x + sine * y, CLIP))
                    store_lane(lane, seen, k + 1, i, clip(cosine * y - sine * x, CLIP))


@kernel
def _goals(lane, p, instruments, who, at, poses, record, seen):
    """Write goal angles minus encoder angles (rad) into `seen`, then the target point divided by the arm's length.

    at: index of the first entry. Returns the index of the next entry, which is `at` without instruments.goals. who: the
    arm, a `Who`. Goal angles: record.goal, rad; target: record.target, m, inertial axes. Entries are within +-CLIP.
    """
    if instruments.goals is not None:
        i, n, targets = who.i, size(p.task.links), size(p.task.targets)
        for k in range(n):
            angle = _angle(lane, p.task, instruments, who, k, poses, record)
            store_lane(lane, seen, at + k, i, clip(load_lane(lane, record, GOAL + k, i) - angle, CLIP))
        if targets == 1:
            return at + n
        for d in range(targets):
            store_lane(lane, seen, at + n + d, i, clip(load_lane(lane, record, TARGET + d, i) / p.task.length, CLIP))
        return at + n + targets
    return at


@kernel
def _show(lane, instruments, who, at, c, record, seen, value):
    """Write entry `at` of `seen`: the reading of `value` by the law of channel c, limited to +-CLIP.

    value: true quantity of one arm, divided by its scale. who: the arm, a `Who`. record: the sensors' channels.
    """
    laws, room, arm = instruments.laws, instruments.room, who.arm
    shown = read(lane, laws, room, c, record, who.base, who.stream, arm, value, who.first)
    store_lane(lane, seen, at, who.i, clip(shown, CLIP))


@kernel
def _of_tip(lane, p, who, poses, field):
    """Return a vector of the last link's pose in space; field: offset in a pose of tip, turn, velocity or spin.

    tip: position, m; turn: rotation vector, rad; velocity: velocity, m/s; all along inertial axes. spin: angular
    velocity, rad/s, tip axes. who: the arm, a `Who`.
    """
    o = SPACE_POSE.end * (size(p.task.links) - 1) + field
    x, y = load_lane(lane, poses, o, who.i), load_lane(lane, poses, o + 1, who.i)
    return Vector(x, y, load_lane(lane, poses, o + 2, who.i))


@kernel
def _acceleration(lane, p, instruments, who, c, poses, record):
    """Return the tip's mean specific force (acceleration minus gravity) over a period, tip axes, divided by its scale.

    Components are along and across the tip's tangent in the plane, and along the tip's axes x, y, z in space. Without
    an accelerometer the result is (). instruments.accelerometer: gravity (m/s^2, inertial axes), then the scale
    (m/s^2). c: the accelerometer's first channel in the record, one channel for each axis. Place, speed and angle of
    the previous period are read from the channels and replaced. poses: poses of the links.
    """
    accelerometer = instruments.accelerometer
    if accelerometer is None:
        return ()
    i, room, period = who.i, instruments.room, instruments.period
    if size(p.task.targets) == 3:
        # in space: position m, rotation vector rad, velocity m/s in inertial axes, spin rad/s in tip axes
        x, y, z = specific_force(
            lane,
            record,
            who.base,
            room,
            c,
            i,
            _of_tip(lane, p, who, poses, SPACE_POSE.tip),
            _of_tip(lane, p, who, poses, SPACE_POSE.turn),
            _of_tip(lane, p, who, poses, SPACE_POSE.velocity),
            _of_tip(lane, p, who, poses, SPACE_POSE.spin),
            period,
            Vector(accelerometer[0], accelerometer[1], accelerometer[2]),
            who.first,
        )  # fmt: skip
        return Vector(x / accelerometer[3], y / accelerometer[3], z / accelerometer[3])
    # in the plane: x, y (m, inertial axes), psi (rad) of the tip and their rates
    o = POSE.end * (size(p.task.links) - 1)
    x, vx = load_lane(lane, poses, o + POSE.tip_x, i), load_lane(lane, poses, o + POSE.tip_vx, i)
    y, vy = load_lane(lane, poses, o + POSE.tip_y, i), load_lane(lane, poses, o + POSE.tip_vy, i)
    angle, rate = load_lane(lane, poses, o + POSE.tip_angle, i), load_lane(lane, poses, o + POSE.tip_rate, i)
    along, across = tip_acceleration(
        lane, record, who.base, room, c, i, x, y, angle, vx, vy, rate, period, accelerometer[0], accelerometer[1],
        who.first,
    )  # fmt: skip
    return along / accelerometer[2], across / accelerometer[2]


@kernel
def _spin(lane, p, instruments, who, poses):
    """Return the tip's angular velocity in its own axes, divided by its scale; () without a gyroscope.

    The components are along the x, y, z axes of the last link's tip section; the scale instruments.gyroscope is in
    rad/s. who: the arm, a `Who`. poses: poses of the links in space.
    """
    if instruments.gyroscope is None:
        return ()
    x, y, z = _of_tip(lane, p, who, poses, SPACE_POSE.spin)
    return Vector(x / instruments.gyroscope, y / instruments.gyroscope, z / instruments.gyroscope)


@kernel
def rise(x):
    """Return the arcsine of x, rad, from -pi/2 to pi/2."""
    return arctangent(x, square_root(maximum(1.0 - x * x, 0.0)))


@kernel
def _picture(lane, p, instruments, who, poses):
    """Return the tip's position divided by the camera's scale, inertial axes; in space also two angles of its x axis.

    The angles (rad) are those by which the tip's x axis rises towards the inertial y and z axes. Without a camera the
    result is (). who: the arm, a `Who`. poses: poses of the links; instruments.camera: scale, m.
    """
    if instruments.camera is None:
        return ()
    if size(p.task.targets) == 3:
        x, y, z = _of_tip(lane, p, who, poses, SPACE_POSE.tip)
        A = matrix(quaternion(_of_tip(lane, p, who, poses, SPACE_POSE.turn)))
        return x / instruments.camera, y / instruments.camera, z / instruments.camera, rise(A[1][0]), rise(A[2][0])
    o = POSE.end * (size(p.task.links) - 1) + POSE.tip_x
    x, y = load_lane(lane, poses, o, who.i), load_lane(lane, poses, o + 1, who.i)
    return x / instruments.camera, y / instruments.camera


@kernel
def _gauges(lane, p, instruments, who, c, record, seen):
    """Replace the true gauge curvatures, the last entries of `seen`, by the readings of channels c, c + 1, ...

    Readings are curvatures divided by their scales. c: channel of the first gauge. who: the arm, a `Who`.
    """
    if instruments.gauges is not None:
        count = size(instruments.gauges)
        for g in range(count):
            k = p.entries - count + g
            _show(lane, instruments, who, k, c + g, record, seen, load_lane(lane, seen, k, who.i))


# the observation is written arm by arm, because histories and noise belong to arms
@kernel
def _select(lanes, p, arm, record, seen, first):
    """Write one arm's row of p.observation, float32: all entries, or the chosen entries behind earlier observations.

    seen: measured entries, in lanes. A row with history holds `frames` observations, the oldest first. Chosen indices
    from p.entries on are actions of the period that ends here. At the start of an episode (first) the history is filled
    with the first observation, and actions are 0.
    """
    selection, observation = p.selection, p.observation
    if selection is not None:
        # older: entries of all frames but the newest
        count, older = selection.chosen.shape[0], selection.chosen.shape[0] * (selection.frames - 1)
        out = arm * (count + older)
        # history: all frames move one place, the oldest drops out
        for j in range(older):
            observation[out + j] = observation[out + j + count]
        for j in range(count):
            k = selection.chosen[j]
            if k < p.entries:
                observation[out + older + j] = _entry(lanes, p, arm, k, record, seen, first)
            elif first:
                observation[out + older + j] = np.float32(0.0)
            else:  # the action of the period that ends here
                done = p.action[arm * size(p.task.links) + k - p.entries]
                observation[out + older + j] = np.float32(min(1.0, max(-1.0, done)))
        # no past at the start: the history repeats the newest observation
        if first:
            for j in range(older):
                observation[out + j] = observation[out + older + j % count]
    else:
        out = arm * p.entries
        for k in range(p.entries):
            observation[out + k] = _entry(lanes, p, arm, k, record, seen, first)


@kernel
def _past_at(lanes, p, record):
    """Return the offset of past observations in the record; the number before them is the drawn delay, in periods.

    lanes: number of arms in a group. The sensors' channels, which end the record, follow the past observations.
    """
    return record.shape[0] // lanes - readings_size(p.instruments) - p.entries * p.sensors.age


@kernel
def draw_age(p, arm, record, lanes):
    """Draw the observation delay (whole control periods) of an arm's episode into its record, unless it is fixed.

    arm: index of the arm in the batch. lanes: number of arms in a group. p.sensors.drawn: least and largest delay.
    """
    if p.sensors is not None and p.sensors.drawn is not None:
        record[(_past_at(lanes, p, record) - 1) * lanes + arm % lanes] = draw_whole(p.stream, arm, p.sensors.drawn)


@kernel
def record_drawn(lanes, p, i, record, info):
    """Write the drawn observation delay (s) and channel gains of the arm in lane i into info.

    record: contains the delay (periods) and the channels' gains, drawn at the start of the episode.
    """
    first, instruments = info_of(p.task).further + FURTHER.told, p.instruments
    if p.sensors is not None and p.sensors.drawn is not None:
        info[(first + 1) * lanes + i] = record[(_past_at(lanes, p, record) - 1) * lanes + i] * p.period
    if instruments is not None:
        base = record.shape[0] // lanes - readings_size(instruments)
        count = size(p.task.further) - FURTHER.told - 3
        if p.model.newton.contact is not None:
            count = count - contact_entries(p.model.newton.contact)
        for c in range(count):
            info[(first + 3 + c) * lanes + i] = record[channel_of(base, instruments.room, c).gain * lanes + i]


@kernel
def _entry(lanes, p, arm, k, record, seen, first):
    """Return entry k of one arm's observation as float32, with noise and delay.

    seen: measured entries, in lanes; arm: index in the batch. The record contains the last `age` values of the entry.
    Each call shifts these values by one period and returns the oldest value, or the value at the drawn delay. At the
    start of an episode (first) the past is filled with the present value.
    """
    value, sensors = seen[k * lanes + arm % lanes], p.sensors
    if sensors is not None:
        if sensors.noise[k] > 0.0:
            # value + sigma N(0, 1), sigma in scales of the entry
            value = min(CLIP, max(-CLIP, value + sensors.noise[k] * normal(p.stream, arm)))
        # `value` moves through the past: newest in, oldest out
        past = _past_at(lanes, p, record)
        arrived = value
        for j in range(sensors.age):
            at = (past + j * p.entries + k) * lanes + arm % lanes
            if first:
                record[at] = value
            older = record[at]
            record[at] = value
            value = older
            if sensors.drawn is not None:  # a delay of so many periods was drawn for the episode
                if j < record[(past - 1) * lanes + arm % lanes]:
                    arrived = value
        if sensors.drawn is not None:
            value = arrived
    return np.float32(value)
