"""Streams of random numbers, one per arm."""

import math

import numpy as np

from ..compiler import kernel


@kernel
def uniform(stream, arm):
    """Return the next number of an arm's stream, uniform in [0, 1): SplitMix64 (Steele, Lea & Flood 2014).

    stream (arms,): uint64, the state of each arm's stream, which is advanced. arm: index of the arm in the batch.
    """
    z = stream[arm] + np.uint64(0x9E3779B97F4A7C15)
    stream[arm] = z
    # SplitMix64: multiply and xor-shift spread each bit of the counter over all 64
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    # upper 53 bits times 2^-53
    return float(z >> np.uint64(11)) * 1.1102230246251565e-16


@kernel
def draw(stream, arm, ranges, k):
    """Return the next number of an arm's stream, uniform between ranges[2 k] and ranges[2 k + 1]."""
    return ranges[2 * k] + (ranges[2 * k + 1] - ranges[2 * k]) * uniform(stream, arm)


@kernel
def draw_whole(stream, arm, limits):
    """Return the next number of an arm's stream, a whole number between limits[0] and limits[1], both included."""
    return limits[0] + math.floor(uniform(stream, arm) * (limits[1] - limits[0] + 1.0))
