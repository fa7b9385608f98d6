"""The arms' streams of random numbers."""

import math

import numpy as np

from ..compiler import kernel


@kernel
def uniform(stream, arm):
    """The next number of an arm's stream, in [0, 1): SplitMix64 (Steele, Lea & Flood 2014)."""
    z = stream[arm] + np.uint64(0x9E3779B97F4A7C15)
    stream[arm] = z
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    return float(z >> np.uint64(11)) * 1.1102230246251565e-16


@kernel
def draw(stream, arm, ranges, k):
    """The next number of an arm's stream, within range k, (low, high), of `ranges`."""
    return ranges[2 * k] + (ranges[2 * k + 1] - ranges[2 * k]) * uniform(stream, arm)


@kernel
def draw_whole(stream, arm, limits):
    """The next number of an arm's stream, a whole one from limits[0] to limits[1]."""
    return limits[0] + math.floor(uniform(stream, arm) * (limits[1] - limits[0] + 1.0))
