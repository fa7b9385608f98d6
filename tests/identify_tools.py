"""Slopes of what sensors read against those of whole runs."""

from typing import Any

import numpy as np

from flexarm_env.identification.fit import Problem
from flexarm_env.identification.log import Run
from flexarm_env.identification.model import Experiment
from tests.differences import central


def by_runs(made: Experiment, run: Run, k: int, size: float, step: float, order: int = 6) -> dict[str, Any]:
    """What an experiment's outputs change by with its parameter k over its size, by whole runs."""

    def read(way: float) -> Any:
        moved = made.start.copy()
        moved[k] += way * size
        found = made.predict(moved, run)
        return np.array([found[name] for name in run.outputs])

    return dict(zip(run.outputs, central(read, step, order), strict=True))


def compare(made: Experiment, run: Run, limit: float, step: float, least: float) -> None:
    """Errors of an experiment's slopes over a parameter's own effect on an output, or a hundredth of the largest one's
    where that is more; least: that each has on one of them, over the largest."""
    sizes = Problem(made, [run]).sizes
    found = made.slopes(made.start, run, sizes)
    assert not made.by_differences
    for k, p in enumerate(made.parameters):
        known = by_runs(made, run, k, sizes[k], step)
        moves = [float(np.abs(y).max() / max(np.abs(found[name]).max(), 1e-30)) for name, y in known.items()]
        assert max(moves) > least, p.path
        for name, column in known.items():
            error = np.abs(found[name][:, k] - column).max()
            scale = max(float(np.abs(column).max()), 0.01 * float(np.abs(found[name]).max()))
            assert error <= limit * scale, (p.path, name, error / scale)
