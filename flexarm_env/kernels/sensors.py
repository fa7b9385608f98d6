"""What sensors make of an observation: strain gauges, noise and delay. And the arms' streams of random numbers."""

from __future__ import annotations

import math

import numpy as np

from .arithmetic import clip
from .jit import kernel
from .lanes import load, splat, store
from .program import CLIP
from .protocol import size


@kernel
def uniform(stream, arm):  # type: ignore[no-untyped-def]
    """The next number of an arm's stream, in [0, 1): SplitMix64 (Steele, Lea & Flood 2014)."""
    z = stream[arm] + np.uint64(0x9E3779B97F4A7C15)
    stream[arm] = z
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    return float(z >> np.uint64(11)) * 1.1102230246251565e-16


@kernel
def normal(stream, arm):  # type: ignore[no-untyped-def]
    """A standard normal number from an arm's stream (Box & Muller 1958)."""
    radius = math.sqrt(-2.0 * math.log(1.0 - uniform(stream, arm)))
    return radius * math.cos(2.0 * math.pi * uniform(stream, arm))


@kernel
def read_gauges(lane, sensors, entries, model, q, seen):  # type: ignore[no-untyped-def]
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
def sense(lanes, sensors, entries, stream, arm, record, seen, observation, first):  # type: ignore[no-untyped-def]
    """The observation of one arm from what is there to be seen; first: of an episode, nothing to remember."""
    i, out = arm % lanes, arm * entries
    for k in range(entries):
        value = seen[k * lanes + i]
        if sensors is not None:
            value = _measured(lanes, sensors, entries, stream, arm, k, value, record, first)
        observation[out + k] = np.float32(value)


@kernel
def _measured(lanes, sensors, entries, stream, arm, k, value, record, first):  # type: ignore[no-untyped-def]
    """Entry k of the observation with its noise, as it arrives."""
    if sensors.noise[k] > 0.0:
        value = min(CLIP, max(-CLIP, value + sensors.noise[k] * normal(stream, arm)))
    memory = record.shape[0] // lanes - entries * sensors.age  # the newest observation first
    for j in range(sensors.age):
        at = (memory + j * entries + k) * lanes + arm % lanes
        if first:
            record[at] = value
        older = record[at]
        record[at] = value
        value = older
    return value
