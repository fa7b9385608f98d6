"""A sensor's law for reading one quantity: filter, delay, gain, bias, noise and resolution (`sensors.Law`).

    reading = round(gain F u(t - delay) + bias + noise),        F: low-pass filter

Between the instants of two readings the quantity u is interpolated linearly. For this interpolated u, filter and delay
are computed exactly. Bias, noise and resolution are in units of the entry's scale. A channel (`program.CHANNEL`) is the
memory of a sensor for one quantity.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np

from ..compiler import kernel, lane_count, load_lane, sincos, store_lane, with_slope, without_tangents
from ..tasks.program import CHANNEL, LAW, channel_at
from ..tasks.stream import draw, uniform

_LAW = LAW.places
LAW_SIZE = _LAW.end


def law_of(law: Any, scale: float, period: float, path: str = "sensors") -> np.ndarray:
    """Return the `LAW` array of a sensor (`flexarm_env.sensors.Law`) that is read every `period` s.

    law: the sensor's law. scale: the observation entry's scale, in SI units, by which bias, noise and resolution are
    divided. path: key path of the sensor for error messages. Raises ValueError for a delay of more than MOST_LATE
    periods, or a reading interval that is no whole number of periods.
    """
    # delay and interval in periods; delay = whole periods + share of one
    late, every = law.delay / period, law.interval / period
    if round(every) != 0 and abs(every - round(every)) > 1e-6 * every:
        raise ValueError(f"{path}.period = {law.interval!r}: must be a whole number of periods of {period:g} s")
    if late > MOST_LATE:
        raise ValueError(f"{path}.delay = {law.delay!r}: must be at most {MOST_LATE} periods of {period:g} s")
    whole = math.floor(late + 1e-9)
    share = late - whole if late - whole > 1e-9 else 0.0
    own, before, after = _held_filter(law.low_pass, period)
    # rate of an encoder: rate <- kept rate + (1 - kept) (difference of readings) / period
    kept = math.exp(-2.0 * math.pi * getattr(law, "rate_frequency", 0.0) * period)
    return LAW.pack(
        {}, gain=law.gains, bias=np.array(law.biases) / scale, noise=law.noise / scale, quantum=law.step / scale,
        own=own, before=before, after=after, late=whole, share=share, bow=_bow(law.low_pass, period, share),
        every=max(1.0, float(round(every))), rate=(1.0 - kept) / period, kept=kept,
    )  # fmt: skip


MOST_LATE = 1000
"""Largest delay of a sensor, in control periods. A channel stores the output of each of these periods."""


@lru_cache(64)
def _held_filter(low_pass: Any, period: float) -> tuple[Any, Any, Any]:
    """Return the exact transition of a low-pass filter over a period in which its input u changes linearly.

    State x = (y, s) with y' = w s, s' = w (u - y) - 2 damping w s; order 1 has y' = w (u - y) alone. Times are counted
    in control periods. The result contains own (4,) by rows, before (2,) and after (2,) of the transition x+ = own x +
    before u + after u+. low_pass: the filter; None for y = u.
    """
    if low_pass is None:
        return (0.0,) * 4, (0.0, 0.0), (1.0, 0.0)
    from scipy.linalg import expm

    w = 2.0 * math.pi * low_pass.frequency * period
    A, B = [[-w, 0.0], [0.0, -1.0]], [w, 0.0]
    if low_pass.order == 2:
        A, B = [[0.0, w], [-w, -2.0 * low_pass.damping * w]], [0.0, w]
    # expm of ((A, B, 0), (0, 0, 1), (0, 0, 0)): state, input, slope of the input
    block = np.zeros((4, 4))
    block[:2, :2], block[:2, 2], block[2, 3] = A, B, 1.0
    power = expm(block)
    return power[:2, :2].ravel(), power[:2, 2] - power[:2, 3], power[:2, 3]


def _bow(low_pass: Any, period: float, share: float) -> np.ndarray:
    """Return `LAW.bow` (4,): coefficients of a delayed filter output's deviation from linear interpolation.

    The filter's output `share` of a period before the second instant is (1 - share) y+ + share y + bow . (y, s, u, u+).
    Here the input changes linearly from u to u+. All coefficients are 0 without a filter or without a fractional delay.
    """
    if low_pass is None or share == 0.0:
        return np.zeros(4)
    rows = []
    # output after the whole period, and after the part before the delayed instant, each by (y, s, u, u+)
    for part in (1.0, 1.0 - share):
        own, before, after = _held_filter(low_pass, part * period)
        rows.append(np.array([own[0], own[1], before[0] + (1.0 - part) * after[0], part * after[0]]))
    return np.asarray(rows[1] - (1.0 - share) * rows[0] - np.array([share, 0.0, 0.0, 0.0]))


def room_of(laws: np.ndarray) -> int:
    """Return the number of past outputs stored in a channel: the largest whole delay of the laws, in periods.

    laws (c, LAW): the laws of c channels.
    """
    return int(laws[:, _LAW.late].max(initial=0.0))


def memory_of(channels: int, room: int) -> np.ndarray:
    """Return zeroed memory for `channels` channels: `CHANNEL` records with `room` past outputs each."""
    return np.zeros(channels * CHANNEL.offsets(0, room).end)


@kernel
def channel_of(base, room, c):
    """Return the offsets of the numbers of channel c, the memory of a sensor for one quantity (`program.CHANNEL`).

    base: offset of channel 0. room: number of past outputs in a channel. Offsets count the numbers of one arm, without
    lanes.
    """
    return channel_at(base + c * channel_at(0, room).end, room)


@kernel
def normal(stream, arm):
    """Draw a normally distributed number (mean 0, standard deviation 1) from an arm's stream (Box & Muller 1958)."""
    radius = math.sqrt(-2.0 * math.log(1.0 - uniform(stream, arm)))
    return radius * math.cos(2.0 * math.pi * uniform(stream, arm))


@kernel
def read(lane, laws, room, c, memory, base, stream, arm, value, first):
    """Return the reading of a quantity by channel c, one period after the last call, and update its memory.

    value: present true value of the quantity, in the unit of its law. laws: one `LAW` per channel. c: number of the
    channel. memory: array in lanes that holds one `CHANNEL` per channel from offset `base` on, each with `room` past
    outputs. arm: index of the arm in the batch; its lane is arm % lanes. first: whether the episode begins; the
    quantity is then assumed to have been constant. stream: random numbers, or None for readings without noise (a first
    reading needs random numbers). In lanes with tangents the reading has tangents, which rounding does not change.
    """
    i, o, at = arm % lane_count(lane), c * _LAW.end, channel_of(base, room, c)
    since, late, share, bow = laws[o + _LAW.every], int(laws[o + _LAW.late]), laws[o + _LAW.share], o + _LAW.bow
    # start: the filter is at rest, y = value, y' = 0
    if first:
        _remember(lane, laws, room, o, at, memory, stream, arm, value)
        here = load_lane(lane, memory, at.output, i)
    else:
        # filter: (output, slope) a period later, for an input that runs straight from u to value
        y, s = load_lane(lane, memory, at.output, i), load_lane(lane, memory, at.slope, i)
        u = load_lane(lane, memory, at.input, i)
        held = laws[o + _LAW.before] * u + laws[o + _LAW.after] * value
        store_lane(lane, memory, at.output, i, laws[o + _LAW.own] * y + laws[o + _LAW.own + 1] * s + held)
        held = laws[o + _LAW.before + 1] * u + laws[o + _LAW.after + 1] * value
        store_lane(lane, memory, at.slope, i, laws[o + _LAW.own + 2] * y + laws[o + _LAW.own + 3] * s + held)
        since = memory[at.since * len(lane) + i] + 1.0
        here = load_lane(lane, memory, at.output, i)
        # y(t - share) = y + share (y_0 - y) + bow, because the filtered line is not straight
        if share > 0.0:
            here = here + (y - here) * share
            here = here + (laws[bow] * y + laws[bow + 1] * s + laws[bow + 2] * u + laws[bow + 3] * value)
    store_lane(lane, memory, at.input, i, value)
    # whole periods of delay: take the output from the past, then push the newest one onto it
    now = here
    if late > 0:
        here = load_lane(lane, memory, at.past + late - 1, i)
    for k in range(room - 1, 0, -1):
        store_lane(lane, memory, at.past + k, i, load_lane(lane, memory, at.past + k - 1, i))
    if room > 0:
        store_lane(lane, memory, at.past, i, now)
    # y = gain x + bias + noise, rounded, every `every` periods; held between
    if since > laws[o + _LAW.every] - 0.5:
        here = here * load_lane(lane, memory, at.gain, i) + load_lane(lane, memory, at.bias, i)
        noise, quantum = laws[o + _LAW.noise], laws[o + _LAW.quantum]
        if stream is not None and noise > 0.0:
            here = here + noise * normal(stream, arm)
        # rounded in value, slope 1 for derivatives
        if quantum > 0.0:
            here = with_slope(quantum * math.floor(without_tangents(here) / quantum + 0.5), here, 1.0)
        store_lane(lane, memory, at.reading, i, here)
        since = 0.0
    memory[at.since * len(lane) + i] = since
    return load_lane(lane, memory, at.reading, i)


@kernel
def _remember(lane, laws, room, o, at, memory, stream, arm, value):
    """Draw gain and bias of a channel and fill the channel's memory with `value`, at the start of an episode.

    o: offset of the channel's law in `laws`. at: offsets of the channel's numbers in `memory`. room: past outputs in a
    channel. value: the true quantity, assumed constant before the start. Without a stream nothing is done.
    """
    if stream is not None:
        i = arm % lane_count(lane)
        memory[at.gain * len(lane) + i] = draw(stream, arm, laws[o + _LAW.gain :], 0)
        memory[at.bias * len(lane) + i] = draw(stream, arm, laws[o + _LAW.bias :], 0)
        store_lane(lane, memory, at.output, i, value)
        store_lane(lane, memory, at.slope, i, 0.0)
        for k in range(room):
            store_lane(lane, memory, at.past + k, i, value)


@kernel
def read_encoder(lane, laws, room, c, memory, base, stream, arm, angle, first):
    """Return the angle (rad) and rate (rad/s) read by the encoder with channel c (`flexarm_env.sensors.Encoder`).

        rate+ = kept rate + (1 - kept) (reading+ - reading) / period,        kept = exp(-2 pi rate_frequency period)

    angle: true angle, rad. first: whether the episode begins; the rate is then 0. All other arguments are the arguments
    of `read`.
    """
    i, o, at = arm % lane_count(lane), c * _LAW.end, channel_of(base, room, c)
    before = load_lane(lane, memory, at.reading, i)
    now = read(lane, laws, room, c, memory, base, stream, arm, angle, first)
    if first:
        store_lane(lane, memory, at.rate, i, 0.0)
    else:
        rate = laws[o + _LAW.kept] * load_lane(lane, memory, at.rate, i) + laws[o + _LAW.rate] * (now - before)
        store_lane(lane, memory, at.rate, i, rate)
    return now, load_lane(lane, memory, at.rate, i)


GAUSS = math.sqrt(0.6)
"""The outer two of three Gauss points on [-1, 1] are +-GAUSS. In a mean the outer points have the weight 5/18 each, and
the middle point has the weight 8/18.
"""


@kernel
def tip_acceleration(lane, memory, base, room, c, i, x, y, angle, vx, vy, rate, period, gravity_x, gravity_y, first):
    """Return the tip's mean specific force (acceleration minus gravity) in the plane over the last period, m/s^2.

    Let the specific force in the tip's axes, along and across the tip's tangent, be f = f0 + f1 s, with s from -1 to 1
    over the period. f0 and f1 are determined so that f, rotated into inertial axes, moves the tip from position and
    velocity a period ago to the present ones. Written in complex numbers,

        M0 = mean f e^(i psi) = a_0 f0 + a_1 f1,     M1 = mean s f e^(i psi) = a_1 f0 + a_2 f1,
        a_j = mean s^j e^(i psi),

    where M0 and M1 follow from the changes of velocity and position. The kernel returns f0, the mean of f. The angle
    psi(s) of the tip's tangent is the cubic polynomial through angles and rates at both ends of the period. The means
    are evaluated at three Gauss points.

    first: whether the episode begins, so that no period precedes. The velocity in the tip's axes is then assumed
    constant, so that f = rate x v - g.

    # in        x, y (m), vx, vy (m/s), gravity_x, gravity_y (m/s^2), inertial axes;  angle (rad), rate (rad/s) of the
    #           tip's tangent;  period, s
    # in, out   memory: channels c, c + 1 of lane i hold position, velocity, angle and rate of the previous instant
    #           base: offset of channel 0;  room: number of past outputs in a channel
    """
    a, b = channel_of(base, room, c), channel_of(base, room, c + 1)
    if first:
        fx, fy, turn = -rate * vy - gravity_x, rate * vx - gravity_y, angle
    else:
        vx0, vy0 = load_lane(lane, memory, a.speed, i), load_lane(lane, memory, b.speed, i)
        dx, dy = x - load_lane(lane, memory, a.place, i), y - load_lane(lane, memory, b.place, i)
        angle0, rate0 = load_lane(lane, memory, a.turn, i), load_lane(lane, memory, b.turn, i)
        # M0 from the velocities, M1 from the positions
        M0x, M0y = (vx - vx0) / period - gravity_x, (vy - vy0) / period - gravity_y
        M1x = (vx + vx0 - dx * (2.0 / period)) / period
        M1y = (vy + vy0 - dy * (2.0 / period)) / period
        # psi less its value in the middle, turn: odd part (half - cube) s + cube s^3, even part bow s^2
        half, bow = (angle - angle0) * 0.5, (rate - rate0) * (0.125 * period)
        cube = ((rate + rate0) * (0.25 * period) - half) * 0.5
        sine, cosine = sincos((half - cube) * GAUSS + cube * (0.6 * GAUSS))  # odd part at the Gauss point GAUSS
        tilt, level = sincos(bow * 0.6)  # even part, there
        sine = sine * (GAUSS / 0.6)
        # eliminate f1: f0 e^(i turn) = (M0 - a_1 / a_2 M1) / (a_0 - a_1^2 / a_2), expanded by the odd part's cosine
        X, Y = cosine * M0x + sine * M1y, cosine * M0y - sine * M1x
        re, im = cosine * (4.0 / 9.0) + level * (5.0 / 9.0), tilt * (5.0 / 9.0)
        norm = re * re + im * im
        fx, fy = (X * re + Y * im) / norm, (Y * re - X * im) / norm
        turn = angle - half - bow
    # memory: place, velocity and angle, to which the next period's means refer
    store_lane(lane, memory, a.place, i, x)
    store_lane(lane, memory, b.place, i, y)
    store_lane(lane, memory, a.speed, i, vx)
    store_lane(lane, memory, b.speed, i, vy)
    store_lane(lane, memory, a.turn, i, angle)
    store_lane(lane, memory, b.turn, i, rate)
    # times e^(-i turn): from the middle's axes to the tip's own axes
    sine, cosine = sincos(turn)
    return cosine * fx + sine * fy, cosine * fy - sine * fx
