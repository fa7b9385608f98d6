"""Central differences of sixth order, for values that are not differentiated automatically.

Examples are the points on the arm's center line, and values that uncompiled code computes.
"""

from collections.abc import Callable

import numpy as np

from ..validation import Array

STEP = 1e-3
"""Step of the differences, as a fraction of a coordinate's characteristic size (1 rad, or the arm's length)."""

WEIGHTS = (1, 3 / 4), (2, -3 / 20), (3, 1 / 60)
"""Weights of the central difference: pairs of the number of steps to both sides and the weight."""


def derivative(f: Callable[[float], Array], step: float) -> Array:
    """Return the derivative df/dt at t = 0 from the values of f at t = -3, ..., 3 steps."""
    total: Array = np.zeros(())
    for i, weight in WEIGHTS:
        total = total + weight * (f(i * step) - f(-i * step))
    return np.asarray(total / step)


def step_along(d: Array, weight: Array) -> float:
    """Return the step of differences along an increment d (n,), 1.0 if d is 0. weight: 1 / size of each coordinate."""
    size = float(np.abs(d * weight).max(initial=0.0))
    return STEP / size if size > 0.0 else 1.0
