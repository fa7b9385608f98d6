"""Records: the best known actions in each of a task's 100 public episodes, which can be replayed.

A new record does not change the reference values of the scores (`flexarm_env.suite.score`), so that a score can exceed
1. The page of results lists the runs that exceed the record's value in an episode. The program `agents.record` in a
checkout computes the records.
"""

from dataclasses import asdict, dataclass
from functools import cache
from importlib import resources
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import validation as check
from ..episodes import Policy
from ..validation import Array
from .data import Task, tasks
from .judge import judge
from .score import FIRST

ROUNDING, UPRIGHT = 1e-6, {"swing-up-v1": 1e-3}
"""Largest differences of values in a replay. Replays are bitwise equal on every x86-64 processor tested. Other
architectures round sines differently, and values then differ by less than these numbers. A change of the last bit of
the models' matrices caused at most 2e-8. For arms balanced upright for seconds by open-loop torques such a change of
the matrices caused 3e-4, at a J of 298."""


@dataclass(frozen=True)
class Record:
    """Best known actions of a task in n episodes of T control periods.

    Attributes:
        actions (T, n, N): actions of the N joints, float32. values (n,): each episode's return minus the task's price
            times the episode's cost. by (n,): for each episode, name of the policy that chose the actions; for
            optimized actions, name of the policy whose actions the optimization started from. digest: digest of the
            task. date: date in ISO format.
    """

    actions: NDArray[np.float32]
    values: Array
    by: tuple[str, ...]
    digest: str
    date: str


@cache
def known() -> tuple[str, ...]:
    """Return the ids of the tasks whose record has the digest of the task."""
    return tuple(
        task.id for task in tasks(earlier=True) if _path(task).is_file() and record(task).digest == task.digest
    )


def _path(task: Task) -> Any:
    """Return the path of a task's record file."""
    return resources.files("flexarm_env") / "data" / "suite" / "best" / f"{task.id}.npz"


def packed(actions: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Split actions (T, n, N) into four byte planes (4, n, N, T), which compress to three quarters of the size."""
    # first bytes of all numbers, then second bytes, and so on
    rows = np.ascontiguousarray(actions.transpose(1, 2, 0), "<f4")
    return np.moveaxis(rows[..., None].view(np.uint8), -1, 0)


def unpacked(planes: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Join the byte planes of `packed` to actions (T, n, N), float32."""
    rows = np.ascontiguousarray(np.moveaxis(planes, 0, -1)).view("<f4")[..., 0]
    return np.ascontiguousarray(rows.transpose(2, 0, 1), np.float32)


def record(task: Task) -> Record:
    """Read the record of a suite task. Raises ValueError if the task has no record."""
    path = _path(task)
    if not path.is_file():
        raise check.InvalidValue("--best", task.id, "has no record")
    with path.open("rb") as stream, np.load(stream, allow_pickle=False) as data:
        by = tuple(str(name) for name in data["by"])
        return Record(unpacked(data["actions"]), data["values"], by, str(data["digest"]), str(data["date"]))


def rounding(task_id: str) -> float:
    """Return the largest difference that two processors can cause between the values J of a replay (`ROUNDING`)."""
    return UPRIGHT.get(task_id, ROUNDING)


def played(task: Task, env: Any, policy: Policy) -> tuple[Array, NDArray[np.bool_]]:
    """Evaluate a policy on a task's n public episodes: return values (n,) and successes (n,).

    The value of an episode is its return minus the task's price times the episode's cost.
    """
    found = asdict(judge(env, policy, FIRST))
    return np.array(found["returns"]) - task.price * np.array(found["costs"]), np.array(found["successes"])
