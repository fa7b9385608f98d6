"""Where things are in an arm's memory: how much room each section of a block needs."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..compiler.dispatch import size
from ..physics.integrator.work import work_size
from ..tasks.program import DEFLECTION, GOAL, TAIL, Layout
from .fitted import scratch_size


def layout_of(lanes: int, model: Any, task: Any, entries: int, extras: Any, fitted: bool) -> Layout:
    """Sections of a block, each beginning on a whole number of lanes (and of cache lines).

    task: `Slew` or `Reach`. entries: of the observation. extras: see `batch.Extras`. fitted: steps are, to a tolerance.
    """
    links, record = len(task.links), GOAL + len(task.links)
    if extras.actuator is not None:
        record += links * (extras.actuator.age + 3)
    if extras.sensors is not None:
        record += entries * extras.sensors.age
    record += fitted  # halvings of the step that the last period took
    kept = 0 if extras.actuator is None and extras.reference is None else record
    saved = 4 * size(model.n) + 3 + size(model.n_inputs) + kept
    first = -(-int(getattr(work_size, "py_func", work_size)(lanes, model, 0)) // 8) * 8
    starts = [first]
    for count in (
        4, 12 * links, record, links, entries,
        DEFLECTION + 2 * links + len(task.targets) + len(task.terms) + TAIL, saved,
    ):  # fmt: skip
        starts.append(starts[-1] + count * lanes)
    scratch = scratch_size(links, saved) * lanes if fitted else 0
    return Layout(*starts, row=-(-(starts[-1] + scratch) // 8) * 8)  # type: ignore[misc]


def aligned(rows: int, columns: int) -> np.ndarray:
    """Zeros that begin on a cache line, so that eight lanes are one, and not parts of two."""
    numbers = np.zeros(rows * columns + 7)
    first = -(numbers.ctypes.data // 8) % 8
    return numbers[first : first + rows * columns].reshape(rows, columns)
