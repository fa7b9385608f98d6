"""User-defined reward terms, which are added to a task's reward terms.

A term is a kernel `term(lane, task, poses, action, record)` that returns the term's value for a lane of arms. Terms are
constants of the task record's class, so that the compiler can compile them into the task. Each choice of terms
therefore has its own class.
"""

from collections.abc import Sequence
from functools import cache
from typing import Any

from ..compiler import kernel, size
from .task import TASKS, Task, judge, reward_term

TERM_ARGUMENTS = ("lane", "task", "poses", "action", "record")
"""Names of a reward term's arguments; see `tasks.task`."""


@kernel
def judge_with_terms(lane, task, poses, action, record, live, info):
    """Evaluate a task with user-defined reward terms; return (reward, 1.0 if a joint is beyond its limits).

    `judge` writes success and the task's terms into info for running arms (live > 1/2). task.own_terms: kernels
    term(lane, task, poses, action, record), whose weighted values are added to the reward and written into info.terms
    before the terms of cost, change of actions and failure. poses: positions, angles and rates of the links, inertial
    axes; action (joints, lanes), in [-1, 1].
    """
    total, past = judge(lane, task, poses, action, record, live, info)
    # k: first of the user's own terms; cost (if task.charged), change of actions (if task.acted), failure follow it
    k = size(task.terms) - 1 - min(size(task.acted), 1) - len(task.own_terms)
    if task.charged is not None:
        k = k - 1
    for term in task.own_terms:
        total = total + reward_term(lane, task, live, info, k, term(lane, task, poses, action, record))
        k = k + 1
    return total, past


def with_terms(record: Any, terms: Sequence[Any]) -> type[Task]:
    """Return the class of a task's record with these user-defined terms; equal terms give the same class."""
    found: type[Task] = _with_terms(record, tuple(terms))
    return found


@cache
def _with_terms(record: Any, terms: tuple[Any, ...]) -> Any:
    words = "+".join(f"{term.__module__}.{term.__qualname__}" for term in terms)
    made: Any = type(f"{record.__name__}+{words}", (record,), {"__slots__": (), "own_terms": terms})
    made.__module__, made.__reduce__ = __name__, _reduced
    TASKS.register(made, **TASKS.members[record])
    return made


def _reduced(record: Any) -> Any:
    """Tell pickle how to rebuild a record of a class with user-defined terms, which cannot be imported by name."""
    return _remade, (type(record).__mro__[1], type(record).own_terms, tuple(record))


def _remade(record: type[Task], terms: tuple[Any, ...], values: tuple[Any, ...]) -> Any:
    return with_terms(record, terms)._make(values)
