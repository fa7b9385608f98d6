"""The best that was ever played on a task's public hundred: per episode its actions and value, dated, to be replayed.

The constants that scores are made from do not move with it (`flexarm_env.suite.score`): a score above 1 is possible,
and a run that beats the record in an episode is told of on the page of results. `agents.record` of a checkout makes it.
"""

from dataclasses import asdict, dataclass
from functools import cache
from importlib import resources
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import validation as check
from ..validation import Array
from .data import Task, tasks
from .judge import Policy, judge
from .score import FIRST

ROUNDING, UPRIGHT = 1e-6, {"swing-up-v1": 1e-3}
"""A record is played again to the bit on every x86-64 that was tried. Where sines round otherwise, as another
architecture's may, values differ by less than this: a last bit of the models' matrices made 2e-8 at most, and 3e-4 (of
J 298) of arms that stand upright under torques alone for seconds."""


@dataclass(frozen=True)
class Record:
    """Of n episodes.

    Attributes:
        actions: (T, n, N) float32. values: (n,), return less price times cost. by: (n,), who played them, or where the
            search began that found them. digest: of the task. date: ISO.
    """

    actions: NDArray[np.float32]
    values: Array
    by: tuple[str, ...]
    digest: str
    date: str


class Actions(Policy):
    """Actions (T, n, N) of n episodes, by the time."""

    def __init__(self, actions: NDArray[Any]) -> None:
        self.actions = actions

    def reset(self, observation: NDArray[np.float32]) -> None:
        """At the beginning."""
        self.k = 0

    def act(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """The next actions."""
        self.k += 1
        now: NDArray[np.float32] = self.actions[min(self.k, len(self.actions)) - 1].astype(np.float32)
        return now


@cache
def known() -> tuple[str, ...]:
    """Ids of the tasks that have a record, as they are."""
    return tuple(
        task.id for task in tasks(earlier=True) if _path(task).is_file() and record(task).digest == task.digest
    )


def _path(task: Task) -> Any:
    return resources.files("flexarm_env") / "data" / "suite" / "best" / f"{task.id}.npz"


def packed(actions: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Actions (T, n, N) as a file has them, a quarter smaller there: bytes (4, n, N, T), all first ones before all
    second ones."""
    rows = np.ascontiguousarray(actions.transpose(1, 2, 0), "<f4")
    return np.moveaxis(rows[..., None].view(np.uint8), -1, 0)


def unpacked(planes: NDArray[np.uint8]) -> NDArray[np.float32]:
    """What `packed` was given."""
    rows = np.ascontiguousarray(np.moveaxis(planes, 0, -1)).view("<f4")[..., 0]
    return np.ascontiguousarray(rows.transpose(2, 0, 1), np.float32)


def record(task: Task) -> Record:
    """The record of a task. ValueError where there is none."""
    path = _path(task)
    if not path.is_file():
        raise check.InvalidValue("--best", task.id, "has no record")
    with path.open("rb") as stream, np.load(stream, allow_pickle=False) as data:
        by = tuple(str(name) for name in data["by"])
        return Record(unpacked(data["actions"]), data["values"], by, str(data["digest"]), str(data["date"]))


def rounding(task_id: str) -> float:
    """What the values of a record, played again on any processor, are off by at most; see ROUNDING."""
    return UPRIGHT.get(task_id, ROUNDING)


def played(task: Task, env: Any, policy: Policy) -> tuple[Array, NDArray[np.bool_]]:
    """Values and successes of a policy on a task's episodes, as a results file has them."""
    found = asdict(judge(env, policy, FIRST))
    return np.array(found["returns"]) - task.price * np.array(found["costs"]), np.array(found["successes"])
