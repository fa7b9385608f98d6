"""Records: for each of a task's hundred public episodes, the best known actions, with values and date, for replay.

The reference values of scores (`flexarm_env.suite.score`) do not change with the records. A score above 1 is therefore
possible, and the page of results lists runs that beat the record in an episode. The program `agents.record` in a
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
    """Record of a task for n episodes.

    Attributes:
        actions (T, n, N): actions, float32. values (n,): return minus price times cost. by (n,): name of the policy
            that played each episode, or from which the search began. digest: digest of the task. date: date in ISO
            format.
    """

    actions: NDArray[np.float32]
    values: Array
    by: tuple[str, ...]
    digest: str
    date: str


@cache
def known() -> tuple[str, ...]:
    """Return the ids of the tasks with a record that belongs to their present version."""
    return tuple(
        task.id for task in tasks(earlier=True) if _path(task).is_file() and record(task).digest == task.digest
    )


def _path(task: Task) -> Any:
    """Return the path of a task's record file."""
    return resources.files("flexarm_env") / "data" / "suite" / "best" / f"{task.id}.npz"


def packed(actions: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Pack actions (T, n, N) into four planes of bytes (4, n, N, T), whose compressed files are a quarter smaller."""
    # first bytes of all numbers, then second bytes, and so on
    rows = np.ascontiguousarray(actions.transpose(1, 2, 0), "<f4")
    return np.moveaxis(rows[..., None].view(np.uint8), -1, 0)


def unpacked(planes: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Invert `packed`: return actions (T, n, N), float32, from planes of bytes."""
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
    """Return the largest difference between a record's values on two processors; see ROUNDING."""
    return UPRIGHT.get(task_id, ROUNDING)


def played(task: Task, env: Any, policy: Policy) -> tuple[Array, NDArray[np.bool_]]:
    """Evaluate a policy on a task's public episodes: return values (n,), as in a results file, and successes (n,)."""
    found = asdict(judge(env, policy, FIRST))
    return np.array(found["returns"]) - task.price * np.array(found["costs"]), np.array(found["successes"])
