"""Readings of contacts and iterations of the integrator, for tests and for `benchmarks.contact`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from flexarm_env import Simulation
from flexarm_env.physics.contact.build import duration as duration
from flexarm_env.physics.contact.layout import READING
from flexarm_env.physics.layout import ITERATIONS, STEPS


def reading(simulation: Simulation, point: int = 0) -> dict[str, NDArray[np.float64]]:
    """Return the `READING` of a contact point at the end of the last step."""
    watch = simulation.model.newton.contact
    return READING.unpack(simulation.work.S, watch.at + point * watch.stride)


def iterations_of_a_step(simulation: Simulation) -> float:
    """Return the mean number of Newton iterations of a step."""
    counts = simulation.work.counts
    return float(counts[ITERATIONS] / counts[STEPS])
