"""What sensors make of an observation: strain gauges, noise and delay."""

from __future__ import annotations

import math

import numpy as np

from ..compiler import kernel, load, size, splat, store
from ..physics.arithmetic import clip
from ..tasks.program import CLIP
from ..tasks.stream import uniform


@kernel
def normal(stream, arm):
    """A standard normal number from an arm's stream (Box & Muller 1958)."""
    radius = math.sqrt(-2.0 * math.log(1.0 - uniform(stream, arm)))
    return radius * math.cos(2.0 * math.pi * uniform(stream, arm))


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
def sense(lanes, sensors, entries, stream, arm, record, seen, observation, first):
    """The observation of one arm from what is there to be seen; first: of an episode, nothing to remember."""
    i, out = arm % lanes, arm * entries
    for k in range(entries):
        value = seen[k * lanes + i]
        if sensors is not None:
            value = _measured(lanes, sensors, entries, stream, arm, k, value, record, first)
        observation[out + k] = np.float32(value)


@kernel
def _measured(lanes, sensors, entries, stream, arm, k, value, record, first):
    """Entry k of the observation with its noise, as it arrives."""
    if sensors.noise[k] > 0.0:
        value = min(CLIP, max(-CLIP, value + sensors.noise[k] * normal(stream, arm)))
    memory = record.shape[0] // lanes - entries * sensors.age  # `RECORD.seen`, the last of the record
    for j in range(sensors.age):
        at = (memory + j * entries + k) * lanes + arm % lanes
        if first:
            record[at] = value
        older = record[at]
        record[at] = value
        value = older
    return value
