"""Benchmark suite: named, versioned tasks for learning and control, frozen as data (docs/suite.md).

    tasks(), task(id)        the tasks; a `Task` each
    make(id), make_vec(id, n)    a task's environment, single or vector
    digest(task)             hash of the resolved task, to verify that it is unchanged

`gymnasium.make("flexarm_env:flexarm/slew-measured-v2")` and `gymnasium.make_vec` make the same environments.
"""

from typing import Any

from .data import Task, task, tasks


def make(task_id: str, **more: Any) -> Any:
    """Create the environment of a task, like `gymnasium.make`.

    more: `render_mode`, `info_level`. Other keywords change the task, so that its score is not the suite's, and cause a
    warning (except `duration` and `reward`, for training).
    """
    import gymnasium

    return gymnasium.make(task(task_id).registered, **more)


def make_vec(task_id: str, num_envs: int, **more: Any) -> Any:
    """Create the vector environment of a task, like `gymnasium.make_vec`.

    more: as in `make`, and `threads`, `autoreset_mode`.
    """
    import gymnasium

    return gymnasium.make_vec(task(task_id).registered, num_envs=num_envs, **more)


def digest(one: Task) -> str:
    """Hash a resolved task: 16 hexadecimal digits.

    Covers environment, keywords and, with them resolved, the arm, solver, times, reward weights, starts and observation
    layout; numbers to ten digits.
    """
    from .frozen import digest_of

    return digest_of(one)


__all__ = ["Task", "digest", "make", "make_vec", "task", "tasks"]
