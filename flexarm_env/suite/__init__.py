"""Benchmark suite: named, versioned tasks for learning and control, frozen as data (docs/suite.md).

    tasks(), task(id)            return all tasks, or one, as `Task`
    make(id), make_vec(id, n)    create a task's environment, single or vector
    digest(task)                 returns a hash of the resolved task, to verify that it is unchanged

`gymnasium.make("flexarm_env:flexarm/slew-measured-v2")` and `gymnasium.make_vec` create the same environments as these
functions.
"""

from typing import Any

from .data import Task, task, tasks


def make(task_id: str, **more: Any) -> Any:
    """Create the environment of a task, as `gymnasium.make` does.

    more: further keywords of the environment. Keywords other than `render_mode` and `info_level` change the task and
    cause a warning. Scores on a changed task do not count in the suite. `duration` and `reward` cause no warning,
    because training may change them.
    """
    import gymnasium

    return gymnasium.make(task(task_id).registered, **more)


def make_vec(task_id: str, num_envs: int, **more: Any) -> Any:
    """Create the vector environment of a task, as `gymnasium.make_vec` does.

    more: further keywords as in `make`, and the vector environment's `threads` and `autoreset_mode`.
    """
    import gymnasium

    return gymnasium.make_vec(task(task_id).registered, num_envs=num_envs, **more)


def digest(one: Task) -> str:
    """Return the digest of a task: a hash of its complete definition, 16 hexadecimal digits.

    The hash covers the environment's id and keywords, and all values that follow from them: arm, solver settings,
    times, reward weights, ranges of initial states, and observation layout. The hash uses numbers with ten significant
    digits.
    """
    from .frozen import digest_of

    return digest_of(one)


__all__ = ["Task", "digest", "make", "make_vec", "task", "tasks"]
