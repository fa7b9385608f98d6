"""What sensors make of an observation: readings by their laws, strain gauges, noise and delay, choice and history."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..compiler import kernel, load, size, splat, store
from ..physics.arithmetic import clip
from ..physics.layout import POSE
from ..physics.protocol import ports
from ..tasks.program import CHANNEL, CLIP, GOAL, LAW, TARGET, channel_at
from ..tasks.stream import uniform

_LAW = LAW.places
LAW_SIZE = _LAW.end


def law_of(law: Any, scale: float, period: float, path: str = "sensors") -> np.ndarray:
    """A `LAW` for a sensor (`flexarm_env.sensors.Law`) read every `period` s. scale: of its entry, in its unit."""
    late, every = law.delay / period, law.interval / period
    if round(every) != 0 and abs(every - round(every)) > 1e-6 * every:
        raise ValueError(f"{path}.period = {law.interval!r}: must be a whole number of periods of {period:g} s")
    if late > MOST_LATE:
        raise ValueError(f"{path}.delay = {law.delay!r}: must be at most {MOST_LATE} periods of {period:g} s")
    whole = math.floor(late + 1e-9)
    own, before, after = _held_filter(law.low_pass, period)
    kept = math.exp(-2.0 * math.pi * getattr(law, "rate_frequency", 0.0) * period)
    return LAW.pack(
        {}, gain=law.gains, bias=np.array(law.biases) / scale, noise=law.noise / scale, quantum=law.step / scale,
        own=own, before=before, after=after, late=whole, share=late - whole if late - whole > 1e-9 else 0.0,
        every=max(1.0, float(round(every))), rate=(1.0 - kept) / period, kept=kept,
    )  # fmt: skip


MOST_LATE = 1000
"""Periods by which a sensor may be late: each of them is remembered."""


def _held_filter(low_pass: Any, period: float) -> tuple[Any, Any, Any]:
    """A low-pass over a period in which its input runs straight: the exact solution of its equation.

    State (y, y' / w): y' = w s, s' = w (u - y) - 2 damping w s; of order 1 y' = w (u - y) alone.
    """
    if low_pass is None:
        return (0.0,) * 4, (0.0, 0.0), (1.0, 0.0)
    from scipy.linalg import expm

    w = 2.0 * math.pi * low_pass.frequency * period
    A, B = [[-w, 0.0], [0.0, -1.0]], [w, 0.0]
    if low_pass.order == 2:
        A, B = [[0.0, w], [-w, -2.0 * low_pass.damping * w]], [0.0, w]
    block = np.zeros((4, 4))
    block[:2, :2], block[:2, 2], block[2, 3] = A, B, 1.0
    power = expm(block)
    return power[:2, :2].ravel(), power[:2, 2] - power[:2, 3], power[:2, 3]


def room_of(laws: np.ndarray) -> int:
    """Room for the past that these laws (c, LAW) need."""
    return int((laws[:, _LAW.late] + (laws[:, _LAW.share] > 0.0)).max(initial=0.0))


def memory_of(channels: int, room: int) -> np.ndarray:
    """A `CHANNEL` for each."""
    return np.zeros(channels * CHANNEL.offsets(0, room).end)


@kernel
def normal(stream, arm):
    """A standard normal number from an arm's stream (Box & Muller 1958)."""
    radius = math.sqrt(-2.0 * math.log(1.0 - uniform(stream, arm)))
    return radius * math.cos(2.0 * math.pi * uniform(stream, arm))


# --- one quantity by its law ---------------------------------------------------------------------------
@kernel
def read(laws, room, c, memory, base, lanes, stream, arm, value, first):
    """What channel c reads of a quantity, a period after the last time. base: of the channels in `memory`.

    first: of an episode; the quantity has been what it is for ever.
    """
    i, o, at = arm % lanes, c * _LAW.end, channel_at(base + c * channel_at(0, room).end, room)
    if first:
        low, high = laws[o + _LAW.gain], laws[o + _LAW.gain + 1]
        memory[at.gain * lanes + i] = low + (high - low) * uniform(stream, arm)
        low, high = laws[o + _LAW.bias], laws[o + _LAW.bias + 1]
        memory[at.bias * lanes + i] = low + (high - low) * uniform(stream, arm)
        output, slope, since = value, 0.0, laws[o + _LAW.every]
        for k in range(room):
            memory[(at.past + k) * lanes + i] = value
    else:
        y, s, u = memory[at.output * lanes + i], memory[at.slope * lanes + i], memory[at.input * lanes + i]
        output = laws[o + _LAW.own] * y + laws[o + _LAW.own + 1] * s
        output = output + (laws[o + _LAW.before] * u + laws[o + _LAW.after] * value)
        slope = laws[o + _LAW.own + 2] * y + laws[o + _LAW.own + 3] * s
        slope = slope + (laws[o + _LAW.before + 1] * u + laws[o + _LAW.after + 1] * value)
        since = memory[at.since * lanes + i] + 1.0
    memory[at.input * lanes + i], memory[at.output * lanes + i], memory[at.slope * lanes + i] = value, output, slope
    here, late, share = output, int(laws[o + _LAW.late]), laws[o + _LAW.share]
    if late > 0:
        here = memory[(at.past + late - 1) * lanes + i]
    if share > 0.0:
        here = here + (memory[(at.past + late) * lanes + i] - here) * share
    for k in range(room - 1, 0, -1):
        memory[(at.past + k) * lanes + i] = memory[(at.past + k - 1) * lanes + i]
    if room > 0:
        memory[at.past * lanes + i] = output
    if since > laws[o + _LAW.every] - 0.5:
        here = here * memory[at.gain * lanes + i] + memory[at.bias * lanes + i]
        if laws[o + _LAW.noise] > 0.0:
            here = here + laws[o + _LAW.noise] * normal(stream, arm)
        if laws[o + _LAW.quantum] > 0.0:
            here = laws[o + _LAW.quantum] * math.floor(here / laws[o + _LAW.quantum] + 0.5)
        memory[at.reading * lanes + i], since = here, 0.0
    memory[at.since * lanes + i] = since
    return memory[at.reading * lanes + i]


@kernel
def read_encoder(laws, room, c, memory, base, lanes, stream, arm, angle, first):
    """Angle and rate that an encoder reads (`flexarm_env.sensors.Encoder`)."""
    i, o, at = arm % lanes, c * _LAW.end, channel_at(base + c * channel_at(0, room).end, room)
    before = memory[at.reading * lanes + i]
    now = read(laws, room, c, memory, base, lanes, stream, arm, angle, first)
    rate = 0.0
    if not first:
        rate = laws[o + _LAW.kept] * memory[at.rate * lanes + i] + laws[o + _LAW.rate] * (now - before)
    memory[at.rate * lanes + i] = rate
    return now, rate


@kernel
def tip_acceleration(memory, base, room, c, lanes, i, vx, vy, angle, period, gravity_x, gravity_y, first):
    """Mean over a period of what accelerates the tip, less gravity, along its tangent and across it, m/s^2."""
    x = channel_at(base + c * channel_at(0, room).end, room).speed * lanes + i
    y = channel_at(base + (c + 1) * channel_at(0, room).end, room).speed * lanes + i
    ax, ay = -gravity_x, -gravity_y
    if not first:
        ax, ay = ax + (vx - memory[x]) / period, ay + (vy - memory[y]) / period
    memory[x], memory[y] = vx, vy
    cosine, sine = math.cos(angle), math.sin(angle)
    return cosine * ax + sine * ay, cosine * ay - sine * ax


@kernel
def read_rows(laws, room, memory, stream, period, gravity_x, gravity_y, encoders, accelerometers, inputs, out):
    """Readings at instants `period` apart, an instant a row of `out`; all in SI, not in scales.

    Columns of inputs: an angle for each encoder; tip velocity x, y and angle for each accelerometer; then what is
    read as it stands. Columns of out: angle and rate for each encoder, then one for each channel.
    """
    for k in range(inputs.shape[0]):
        first, c, column, put = k == 0, 0, 0, 0
        for _ in range(encoders):
            angle, rate = read_encoder(laws, room, c, memory, 0, 1, stream, 0, inputs[k, column], first)
            out[k, put], out[k, put + 1] = angle, rate
            c, column, put = c + 1, column + 1, put + 2
        for _ in range(accelerometers):
            vx, vy, angle = inputs[k, column], inputs[k, column + 1], inputs[k, column + 2]
            along, across = tip_acceleration(
                memory, 0, room, c, 1, 0, vx, vy, angle, period, gravity_x, gravity_y, first
            )
            out[k, put] = read(laws, room, c, memory, 0, 1, stream, 0, along, first)
            out[k, put + 1] = read(laws, room, c + 1, memory, 0, 1, stream, 0, across, first)
            c, column, put = c + 2, column + 3, put + 2
        while put < out.shape[1]:
            out[k, put] = read(laws, room, c, memory, 0, 1, stream, 0, inputs[k, column], first)
            c, column, put = c + 1, column + 1, put + 1


# --- in an environment ---------------------------------------------------------------------------------
@kernel
def read_gauges(lane, sensors, entries, model, q, seen):
    """Scaled curvatures at the gauges, the last entries of the observation."""
    if sensors is not None:
        n = size(model.n)
        count = sensors.gauges.shape[0] // n
        for g in range(count):
            total = splat(lane, 0.0)
            for k in range(n):
                total = total + load(lane, q, k) * sensors.gauges[g * n + k]
            store(seen, entries - count + g, clip(total, CLIP))


@kernel
def see_motors(lane, instruments, model, par, record, w):
    """Motors' angles to where their encoders will find them."""
    if instruments is not None:
        _see_motors(lane, instruments, instruments.motors, model, par, record, w)


@kernel
def _see_motors(lane, instruments, motors, model, par, record, w):
    if motors is not None:
        base, room = record.shape[0] // len(lane) - _readings(instruments), instruments.room
        ports(lane, model, par, w.q, w.y)
        for k in range(motors.shape[0]):
            store(record, channel_at(base + k * channel_at(0, room).end, room).motor, load(lane, w.y, k))


@kernel
def hear_motors(lanes, instruments, i, report, record):
    """The same of an arm that is moved elsewhere, from what is told of it."""
    if instruments is not None:
        base, room = record.shape[0] // lanes - _readings(instruments), instruments.room
        for k in range(_size(instruments.motors)):
            record[channel_at(base + k * channel_at(0, room).end, room).motor * lanes + i] = report[k]


@kernel
def _size(motors):
    if motors is not None:
        return motors.shape[0]
    return 0


@kernel
def sense(lanes, p, arm, poses, record, seen, first):
    """The observation of one arm from what is there to be seen; first: of an episode, nothing to remember."""
    _instruments(lanes, p, p.instruments, arm, poses, record, seen, first)
    _show(lanes, p, p.selection, arm, record, seen, p.observation, first)


@kernel
def _instruments(lanes, p, instruments, arm, poses, record, seen, first):
    """Entries as sensors read them, in the place of what is there to be seen."""
    if instruments is not None:
        base, at = record.shape[0] // lanes - _readings(instruments), _further(p.task, p.reference)
        c = _encoders(lanes, p, instruments, instruments.encoders, arm, base, poses, record, seen, first)
        _turned(lanes, p, instruments, instruments.encoders, p.reference, arm, base, poses, record, seen)
        at = _goals(lanes, p, instruments, instruments.goals, instruments.encoders, arm, base, at, poses, record, seen)
        at, c = _accelerometer(
            lanes, p, instruments, instruments.accelerometer, arm, base, at, c, poses, record, seen, first
        )
        at, c = _camera(lanes, p, instruments, instruments.camera, arm, base, at, c, poses, record, seen, first)
        _gauges(lanes, p, instruments, instruments.gauges, arm, base, c, record, seen, first)


@kernel
def _readings(instruments):
    """Numbers that sensors remember, the last of a record."""
    if instruments is not None:
        return (instruments.laws.shape[0] // _LAW.end) * channel_at(0, instruments.room).end
    return 0


@kernel
def _further(task, reference):
    """How many entries the task and a moving target have."""
    if reference is not None:
        return size(task.entries) + reference.scales.shape[0]
    return size(task.entries)


@kernel
def _angle(lanes, instruments, encoders, i, k, base, poses, record):
    """Angle of joint k, as its encoder reads it, or as it is where there is none."""
    if encoders is not None:
        room = instruments.room
        return record[channel_at(base + k * channel_at(0, room).end, room).reading * lanes + i]
    angle = poses[(POSE.end * k + POSE.angle) * lanes + i]
    if k > 0:
        angle = angle - poses[(POSE.end * (k - 1) + POSE.tip_angle) * lanes + i]
    return angle


@kernel
def _at_motor(lanes, instruments, motors, i, k, base, record, angle):
    """What the encoder of joint k turns with: the joint, or its motor."""
    if motors is not None:
        if motors[k] == 1:
            return record[
                channel_at(base + k * channel_at(0, instruments.room).end, instruments.room).motor * lanes + i
            ]
    return angle


@kernel
def _encoders(lanes, p, instruments, encoders, arm, base, poses, record, seen, first):
    """Sine, cosine and rate of each joint; returns the next channel."""
    if encoders is not None:
        i, n = arm % lanes, size(p.task.links)
        for k in range(n):
            true = _angle(lanes, instruments, None, i, k, base, poses, record)
            true = _at_motor(lanes, instruments, instruments.motors, i, k, base, record, true)
            angle, rate = read_encoder(
                instruments.laws, instruments.room, k, record, base, lanes, p.stream, arm, true, first
            )
            place = encoders[3 * k + 2]
            seen[encoders[3 * k] * lanes + i] = math.sin(angle)
            seen[encoders[3 * k + 1] * lanes + i] = math.cos(angle)
            seen[place * lanes + i] = clip(rate / p.task.scales[place], CLIP)
        return n
    return 0


@kernel
def _turned(lanes, p, instruments, encoders, reference, arm, base, poses, record, seen):
    """What is shown of a moving point, from the frame of the hub's angle into that of its encoder's."""
    if encoders is not None:
        if reference is not None:
            i, first, count = arm % lanes, size(p.task.entries), reference.scales.shape[0]
            if size(p.task.targets) == 2:
                off = _angle(lanes, instruments, encoders, i, 0, base, poses, record)
                off = off - poses[POSE.angle * lanes + i]
                cosine, sine = math.cos(off), math.sin(off)
                for k in range(first, first + count, 2):
                    x, y = seen[k * lanes + i], seen[(k + 1) * lanes + i]
                    seen[k * lanes + i] = clip(cosine * x + sine * y, CLIP)
                    seen[(k + 1) * lanes + i] = clip(cosine * y - sine * x, CLIP)


@kernel
def _goals(lanes, p, instruments, goals, encoders, arm, base, at, poses, record, seen):
    """Joint angles at the goal less encoder angles, rad, and a point, over the arm's length; returns the next entry."""
    if goals is not None:
        i, n, targets = arm % lanes, size(p.task.links), size(p.task.targets)
        for k in range(n):
            angle = _angle(lanes, instruments, encoders, i, k, base, poses, record)
            seen[(at + k) * lanes + i] = clip(record[(GOAL + k) * lanes + i] - angle, CLIP)
        if targets == 1:
            return at + n
        for d in range(targets):
            seen[(at + n + d) * lanes + i] = clip(record[(TARGET + d) * lanes + i] / p.task.length, CLIP)
        return at + n + targets
    return at


@kernel
def _accelerometer(lanes, p, instruments, accelerometer, arm, base, at, c, poses, record, seen, first):
    """Along the tip's tangent and across it; returns the next entry and channel."""
    if accelerometer is not None:
        i, o, room = arm % lanes, POSE.end * (size(p.task.links) - 1), instruments.room
        vx, vy = poses[(o + POSE.tip_vx) * lanes + i], poses[(o + POSE.tip_vy) * lanes + i]
        along, across = tip_acceleration(
            record, base, room, c, lanes, i, vx, vy, poses[(o + POSE.tip_angle) * lanes + i], instruments.period,
            accelerometer[0], accelerometer[1], first,
        )  # fmt: skip
        along, across = along / accelerometer[2], across / accelerometer[2]
        along = read(instruments.laws, room, c, record, base, lanes, p.stream, arm, along, first)
        across = read(instruments.laws, room, c + 1, record, base, lanes, p.stream, arm, across, first)
        seen[at * lanes + i], seen[(at + 1) * lanes + i] = clip(along, CLIP), clip(across, CLIP)
        return at + 2, c + 2
    return at, c


@kernel
def _camera(lanes, p, instruments, camera, arm, base, at, c, poses, record, seen, first):
    """The tip's position; returns the next entry and channel."""
    if camera is not None:
        i, o = arm % lanes, POSE.end * (size(p.task.links) - 1) + POSE.tip_x
        for d in range(2):
            value = poses[(o + d) * lanes + i] / camera
            value = read(instruments.laws, instruments.room, c + d, record, base, lanes, p.stream, arm, value, first)
            seen[(at + d) * lanes + i] = clip(value, CLIP)
        return at + 2, c + 2
    return at, c


@kernel
def _gauges(lanes, p, instruments, gauges, arm, base, c, record, seen, first):
    if gauges is not None:
        count = size(gauges)
        for g in range(count):
            k = (p.entries - count + g) * lanes + arm % lanes
            value = read(instruments.laws, instruments.room, c + g, record, base, lanes, p.stream, arm, seen[k], first)
            seen[k] = clip(value, CLIP)


# --- what is told --------------------------------------------------------------------------------------
@kernel
def _show(lanes, p, selection, arm, record, seen, observation, first):
    """All entries, or those that are chosen, behind the observations before."""
    if selection is not None:
        count, older = selection.chosen.shape[0], selection.chosen.shape[0] * (selection.frames - 1)
        out = arm * (count + older)
        for j in range(older):
            observation[out + j] = observation[out + j + count]
        for j in range(count):
            observation[out + older + j] = _entry(lanes, p, p.sensors, arm, selection.chosen[j], record, seen, first)
        if first:
            for j in range(older):
                observation[out + j] = observation[out + older + j % count]
    else:
        out = arm * p.entries
        for k in range(p.entries):
            observation[out + k] = _entry(lanes, p, p.sensors, arm, k, record, seen, first)


@kernel
def _entry(lanes, p, sensors, arm, k, record, seen, first):
    """Entry k of what is there to be seen, as it arrives."""
    value = seen[k * lanes + arm % lanes]
    if sensors is not None:
        value = _measured(lanes, sensors, p.entries, p.stream, arm, k, value, record, _readings(p.instruments), first)
    return np.float32(value)


@kernel
def _measured(lanes, sensors, entries, stream, arm, k, value, record, after, first):
    """Entry k of the observation with its noise, as it arrives."""
    if sensors.noise[k] > 0.0:
        value = min(CLIP, max(-CLIP, value + sensors.noise[k] * normal(stream, arm)))
    memory = record.shape[0] // lanes - after - entries * sensors.age  # `RECORD.seen`; `after` it: readings
    for j in range(sensors.age):
        at = (memory + j * entries + k) * lanes + arm % lanes
        if first:
            record[at] = value
        older = record[at]
        record[at] = value
        value = older
    return value
