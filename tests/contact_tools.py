"""Readings of contacts and iterations of the integrator, for tests and for `benchmarks.contact`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from flexarm_env import Simulation
from flexarm_env.compiler import SINGLE, size, uncompiled
from flexarm_env.physics import protocol
from flexarm_env.physics.contact.build import duration as duration
from flexarm_env.physics.contact.kinematics import gap_at
from flexarm_env.physics.contact.layout import READING
from flexarm_env.physics.layout import ITERATIONS, STEPS


def reading(simulation: Simulation, point: int = 0) -> dict[str, NDArray[np.float64]]:
    """Return the `READING` of a contact point at the end of the last step.

    Where no point is near an obstacle the integrator stores a lower bound of the distance; it is replaced here.
    """
    model, watch = simulation.model, simulation.model.newton.contact
    found = READING.unpack(simulation.work.S, watch.at + point * watch.stride)
    if found["penetration"] < 0.0:
        part, q, y = model.contributions[-1], simulation.work.q, np.zeros(size(model.n_inputs))
        uncompiled(protocol.input_displacements)(SINGLE, model.arm, simulation.par, q, y)
        found["penetration"] = -np.asarray(uncompiled(gap_at)(SINGLE, part, q, y, point))
    return found


def iterations_of_a_step(simulation: Simulation) -> float:
    """Return the mean number of Newton iterations of a step."""
    counts = simulation.work.counts
    return float(counts[ITERATIONS] / counts[STEPS])
