"""The suite's protocol: evaluation episodes, the score of a policy on a task, and the mean score of a method.

The score of a policy on a task is (J - J_PD) / (J_best - J_PD). J is the policy's mean return minus the task's price
times the mean cost. J_PD is the J of PD control, and J_best was the largest known J when the reference was computed.
The mean score of a method over tasks and runs is the interquartile mean, the mean of the middle half of all scores. The
interval of the mean score is a percentile bootstrap interval, with runs resampled within each task (Agarwal et al.
2021).
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources

import numpy as np
from numpy.typing import NDArray

from .. import validation as check
from .data import Task

FIRST, EPISODES = 10_000, 100
"""Seeds of the evaluation episodes: FIRST, FIRST + 1, .... Seeds of training runs are below FIRST."""

RESAMPLES, LEVEL = 10_000, 0.95
FLOOR = "pd"
"""Controller whose score is 0 by definition."""


@dataclass(frozen=True)
class Reference:
    """Reference values J of a task, from which scores are computed.

    digest: digest of the task version. pd: the value J of PD control. best: the best known value J. by: the method that
    reached the best value.
    """

    digest: str
    pd: float
    best: float
    by: str

    def score(self, value: float) -> float:
        """Return the score of a value J: (J - J_PD) / (J_best - J_PD)."""
        return (value - self.pd) / (self.best - self.pd)


@cache
def references() -> dict[str, Reference]:
    """Return the reference values in the package, by task id."""
    path = resources.files("flexarm_env") / "data" / "suite" / "references.json"
    return read_references(path.read_text("utf-8"), "references.json") if path.is_file() else {}


def read_references(text: str, path: str) -> dict[str, Reference]:
    """Parse the tasks' reference values from JSON; raise ValueError for invalid content."""
    found: dict[str, Reference] = {}
    with check.in_file(path):
        for name, entry in check.table_of("", json.loads(text)).items():
            with check.under(name):
                table = check.table_of("", entry)
                digest, pd, best, by = (
                    check.needed("", table, key, "must be given") for key in ("digest", "pd", "best", "by")
                )
                pd = check.number("pd", pd)
                best = check.number("best", best, above=pd)
                found[name] = Reference(check.text("digest", digest), pd, best, check.text("by", by))
    return found


def reference(task: Task) -> Reference | None:
    """Return the reference values of a task; None if the package has none for the task's current version."""
    known = references().get(task.id)
    return None if known is None or known.digest != task.digest else known


def score(task: Task, value: float) -> float | None:
    """Return the score of a value J on a task; None if the task has no reference values."""
    known = reference(task)
    return None if known is None else known.score(value)


def interquartile_mean(scores: Mapping[str, Sequence[float]]) -> float:
    """Return the mean of the middle half of all scores. scores: for each task id, the scores of the method's runs."""
    return float(_middle(np.concatenate([np.asarray(runs, float) for runs in scores.values()])[None])[0])


def interval(
    scores: Mapping[str, Sequence[float]], *, resamples: int = RESAMPLES, seed: int = 0
) -> tuple[float, float] | None:
    """Return the bootstrap interval, with confidence `LEVEL`, of the interquartile mean of scores.

    The bootstrap resamples the runs within each task. Returns None if no task has two runs.
    """
    if all(len(runs) < 2 for runs in scores.values()):
        return None
    rng = np.random.default_rng(seed)
    drawn = [np.asarray(runs, float)[rng.integers(len(runs), size=(resamples, len(runs)))] for runs in scores.values()]
    low, high = np.quantile(_middle(np.concatenate(drawn, axis=1)), [0.5 - LEVEL / 2.0, 0.5 + LEVEL / 2.0])
    return float(low), float(high)


def _middle(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the mean of each row without its lowest and highest quarter (rounded down)."""
    cut = values.shape[1] // 4
    means: NDArray[np.float64] = np.sort(values, axis=1)[:, cut : values.shape[1] - cut].mean(axis=1)
    return means
