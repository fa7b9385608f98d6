"""How one quantity is read by its law: filter, delay, gain and bias, noise, resolution; and rows of readings."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np

from ..compiler import alone, arms, kernel, pick, place, sincos, with_slope
from ..tasks.program import CHANNEL, LAW, channel_at
from ..tasks.stream import draw, uniform

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
    share = late - whole if late - whole > 1e-9 else 0.0
    own, before, after = _held_filter(law.low_pass, period)
    kept = math.exp(-2.0 * math.pi * getattr(law, "rate_frequency", 0.0) * period)
    return LAW.pack(
        {}, gain=law.gains, bias=np.array(law.biases) / scale, noise=law.noise / scale, quantum=law.step / scale,
        own=own, before=before, after=after, late=whole, share=share, bow=_bow(law.low_pass, period, share),
        every=max(1.0, float(round(every))), rate=(1.0 - kept) / period, kept=kept,
    )  # fmt: skip


MOST_LATE = 1000
"""Periods by which a sensor may be late: each of them is remembered."""


@lru_cache(64)
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


def _bow(low_pass: Any, period: float, share: float) -> np.ndarray:
    """`LAW.bow` (4,): what is added to the straight line between a filter's outputs at two instants to have its output
    `share` of a period before the second, where the input runs straight between them."""
    if low_pass is None or share == 0.0:
        return np.zeros(4)
    rows = []
    for part in (1.0, 1.0 - share):
        own, before, after = _held_filter(low_pass, part * period)
        rows.append(np.array([own[0], own[1], before[0] + (1.0 - part) * after[0], part * after[0]]))
    return np.asarray(rows[1] - (1.0 - share) * rows[0] - np.array([share, 0.0, 0.0, 0.0]))


def room_of(laws: np.ndarray) -> int:
    """Room for the past that these laws (c, LAW) need."""
    return int(laws[:, _LAW.late].max(initial=0.0))


def memory_of(channels: int, room: int) -> np.ndarray:
    """A `CHANNEL` for each."""
    return np.zeros(channels * CHANNEL.offsets(0, room).end)


@kernel
def channel_of(base, room, c):
    """Where the numbers of channel c are."""
    return channel_at(base + c * channel_at(0, room).end, room)


@kernel
def normal(stream, arm):
    """A standard normal number from an arm's stream (Box & Muller 1958)."""
    radius = math.sqrt(-2.0 * math.log(1.0 - uniform(stream, arm)))
    return radius * math.cos(2.0 * math.pi * uniform(stream, arm))


@kernel
def read(lane, laws, room, c, memory, base, stream, arm, value, first):
    """What channel c reads of a quantity, a period after the last time. base: of the channels in `memory`.

    first: of an episode; the quantity has been what it is for ever. stream: None for readings without noise, never the
    first. Under a dual tag the number of one arm goes through with its tangents; rounding leaves these as they are.
    """
    i, o, at = arm % arms(lane), c * _LAW.end, channel_of(base, room, c)
    since, late, share, bow = laws[o + _LAW.every], int(laws[o + _LAW.late]), laws[o + _LAW.share], o + _LAW.bow
    if first:
        _remember(lane, laws, room, o, at, memory, stream, arm, value)
        here = pick(lane, memory, at.output, i)
    else:
        y, s = pick(lane, memory, at.output, i), pick(lane, memory, at.slope, i)
        u = pick(lane, memory, at.input, i)
        held = laws[o + _LAW.before] * u + laws[o + _LAW.after] * value
        place(lane, memory, at.output, i, laws[o + _LAW.own] * y + laws[o + _LAW.own + 1] * s + held)
        held = laws[o + _LAW.before + 1] * u + laws[o + _LAW.after + 1] * value
        place(lane, memory, at.slope, i, laws[o + _LAW.own + 2] * y + laws[o + _LAW.own + 3] * s + held)
        since = memory[at.since * len(lane) + i] + 1.0
        here = pick(lane, memory, at.output, i)
        if share > 0.0:
            here = here + (y - here) * share
            here = here + (laws[bow] * y + laws[bow + 1] * s + laws[bow + 2] * u + laws[bow + 3] * value)
    place(lane, memory, at.input, i, value)
    now = here
    if late > 0:
        here = pick(lane, memory, at.past + late - 1, i)
    for k in range(room - 1, 0, -1):
        place(lane, memory, at.past + k, i, pick(lane, memory, at.past + k - 1, i))
    if room > 0:
        place(lane, memory, at.past, i, now)
    if since > laws[o + _LAW.every] - 0.5:
        here = here * pick(lane, memory, at.gain, i) + pick(lane, memory, at.bias, i)
        noise, quantum = laws[o + _LAW.noise], laws[o + _LAW.quantum]
        if stream is not None and noise > 0.0:
            here = here + noise * normal(stream, arm)
        if quantum > 0.0:
            here = with_slope(quantum * math.floor(alone(here) / quantum + 0.5), here, 1.0)
        place(lane, memory, at.reading, i, here)
        since = 0.0
    memory[at.since * len(lane) + i] = since
    return pick(lane, memory, at.reading, i)


@kernel
def _remember(lane, laws, room, o, at, memory, stream, arm, value):
    """A channel at an episode's start."""
    if stream is not None:
        i = arm % arms(lane)
        memory[at.gain * len(lane) + i] = draw(stream, arm, laws[o + _LAW.gain :], 0)
        memory[at.bias * len(lane) + i] = draw(stream, arm, laws[o + _LAW.bias :], 0)
        place(lane, memory, at.output, i, value)
        place(lane, memory, at.slope, i, 0.0)
        for k in range(room):
            place(lane, memory, at.past + k, i, value)


@kernel
def read_encoder(lane, laws, room, c, memory, base, stream, arm, angle, first):
    """Angle and rate that an encoder reads (`flexarm_env.sensors.Encoder`)."""
    i, o, at = arm % arms(lane), c * _LAW.end, channel_of(base, room, c)
    before = pick(lane, memory, at.reading, i)
    now = read(lane, laws, room, c, memory, base, stream, arm, angle, first)
    if first:
        place(lane, memory, at.rate, i, 0.0)
    else:
        rate = laws[o + _LAW.kept] * pick(lane, memory, at.rate, i) + laws[o + _LAW.rate] * (now - before)
        place(lane, memory, at.rate, i, rate)
    return now, pick(lane, memory, at.rate, i)


GAUSS = math.sqrt(0.6)
"""The outer two of three Gauss points between -1 and 1; their weights are 5/18, that of the middle 8/18."""


@kernel
def tip_acceleration(lane, memory, base, room, c, i, x, y, angle, vx, vy, rate, period, gravity_x, gravity_y, first):
    """Mean over the last period of the tip's specific force f (acceleration less gravity) along its tangent and across,
    m/s^2: f = f0 + f1 s, s from -1 to 1, in the tip's own axes, so that what it turns into in fixed ones brings the tip
    from its place and velocity a period ago to those of now. The angle psi(s) is the cubic of angles and rates at both
    ends; integrals are those of three Gauss points. With s^j e^(i psi) averaged, a_j, and the changes of velocity and
    place, M0 = mean f e^(i psi) = a_0 f0 + a_1 f1 and M1 = mean s f e^(i psi) = a_1 f0 + a_2 f1, complex, f0 is wanted.

    first: there is no time before; what it is at the instant if the velocity in the tip's own axes stays as it is.
    """
    a, b = channel_of(base, room, c), channel_of(base, room, c + 1)
    if first:
        fx, fy, turn = -rate * vy - gravity_x, rate * vx - gravity_y, angle
    else:
        vx0, vy0 = pick(lane, memory, a.speed, i), pick(lane, memory, b.speed, i)
        dx, dy = x - pick(lane, memory, a.place, i), y - pick(lane, memory, b.place, i)
        angle0, rate0 = pick(lane, memory, a.turn, i), pick(lane, memory, b.turn, i)
        M0x, M0y = (vx - vx0) / period - gravity_x, (vy - vy0) / period - gravity_y
        M1x = (vx + vx0 - dx * (2.0 / period)) / period
        M1y = (vy + vy0 - dy * (2.0 / period)) / period
        half, bow = (angle - angle0) * 0.5, (rate - rate0) * (0.125 * period)
        cube = ((rate + rate0) * (0.25 * period) - half) * 0.5
        sine, cosine = sincos((half - cube) * GAUSS + cube * (0.6 * GAUSS))  # of psi's odd part at the Gauss points
        tilt, level = sincos(bow * 0.6)  # and of its even part
        sine = sine * (GAUSS / 0.6)
        X, Y = cosine * M0x + sine * M1y, cosine * M0y - sine * M1x
        re, im = cosine * (4.0 / 9.0) + level * (5.0 / 9.0), tilt * (5.0 / 9.0)
        norm = re * re + im * im
        fx, fy = (X * re + Y * im) / norm, (Y * re - X * im) / norm
        turn = angle - half - bow
    place(lane, memory, a.place, i, x)
    place(lane, memory, b.place, i, y)
    place(lane, memory, a.speed, i, vx)
    place(lane, memory, b.speed, i, vy)
    place(lane, memory, a.turn, i, angle)
    place(lane, memory, b.turn, i, rate)
    sine, cosine = sincos(turn)
    return cosine * fx + sine * fy, cosine * fy - sine * fx
