"""Benchmark suite: named, versioned tasks for learning and control, frozen as data (docs/suite.md).

    tasks(), task(id)            return all tasks, or one, as `Task`
    make(id), make_vec(id, n)    create a task's environment, single or vector
    digest(task)                 returns a hash of the resolved task, to verify that it is unchanged

`gymnasium.make("flexarm_env:flexarm/slew-measured-v2")` and `gymnasium.make_vec` make the same environments.
"""

from typing import Any

from .data import Task, task, tasks


def make(task_id: str, **more: Any) -> Any:
    """Create the environment of a task, like `gymnasium.make`.

    more: keywords `render_mode` and `info_level` of the environment. Any other keyword changes the task, so that its
    score does not belong to the suite, and causes a warning (except `duration` and `reward`, for training).
    """
    import gymnasium

    return gymnasium.make(task(task_id).registered, **more)


def make_vec(task_id: str, num_envs: int, **more: Any) -> Any:
    """Create the vector environment of a task, like `gymnasium.make_vec`.

    more: keywords of `make`, and the vector environment's `threads` and `autoreset_mode`.
    """
    import gymnasium

    return gymnasium.make_vec(task(task_id).registered, num_envs=num_envs, **more)


def digest(one: Task) -> str:
    """Return the digest of a resolved task, 16 hexadecimal digits.

    The hash covers environment and keywords, and the values that follow from them: the arm, solver, times, reward
    weights, starts and observation layout. The digest depends on the first ten digits of each number.
    """
    from .frozen import digest_of

    return digest_of(one)


__all__ = ["Task", "digest", "make", "make_vec", "task", "tasks"]
