"""Results of methods on a task of the suite: the runs of each method, and their means."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .data import Task
from .results import Results, of_task, summary
from .score import interquartile_mean, interval


@dataclass(frozen=True)
class Line:
    """Results of one method on one task: for each run, its summary and its entry in the results file."""

    method: str
    summaries: list[dict[str, Any]]
    entries: list[dict[str, Any]]

    def mean(self, key: str) -> float | None:
        """Return the mean of the summaries' entry `key` over the runs; None if the entry is None in a run."""
        values = [one[key] for one in self.summaries]
        return None if any(value is None for value in values) else float(np.mean(values))

    @property
    def policy(self) -> bool:
        """True if the method can act in any episode, False if it consists of actions optimized for given episodes."""
        return all(entry["policy"].get("kind") != "actions" for entry in self.entries)

    @property
    def learnt(self) -> bool:
        """True if the method is a trained policy."""
        return self.policy and any(entry["training"] for entry in self.entries)

    def trained(self, key: str) -> float:
        """Return the training effort, averaged over runs. key: "steps", "wall_s" or "cpu_s"."""
        return float(np.mean([(entry["training"] or {}).get(key, 0.0) for entry in self.entries]))

    def short(self, task: Task) -> bool:
        """Return whether the method was trained with less than 99 % of the task's budget of control periods."""
        return 0.0 < self.trained("steps") < 0.99 * task.budget


def lines_of(task: Task, found: Sequence[Results]) -> list[Line]:
    """Return the methods on a task, the highest mean value first."""
    runs: dict[str, list[dict[str, Any]]] = {}
    for one, entry in of_task(task, found):
        runs.setdefault(one.name, []).append(entry)
    rows = [Line(name, [summary(task, entry) for entry in entries], entries) for name, entries in runs.items()]
    return sorted(rows, key=lambda line: -float(np.mean([one["value"] for one in line.summaries])))


def middle(own: Mapping[str, Sequence[float]], count: int) -> str:
    """Format the interquartile mean of a method's scores, with its interval; "" for fewer than `count` tasks."""
    if len(own) < count:
        return ""
    limits = interval(own)
    return two(interquartile_mean(own)) + ("" if limits is None else f" [{limits[0]:.2f}, {limits[1]:.2f}]")


def two(score: float) -> str:
    """Format a score with two digits, without a negative zero."""
    return f"{round(score, 2) + 0.0:.2f}"
