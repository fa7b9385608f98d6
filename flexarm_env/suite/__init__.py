"""The suite: named, versioned tasks for learning and control, frozen as data (docs/suite.md).

    tasks(), task(id)        what there is; a `Task` each
    make(id), make_vec(id, n)    its environment, single or vector
    digest(task)             of what the task comes to, to see that it is still the same

`gymnasium.make("flexarm_env:flexarm/slew-measured-v2")` and `gymnasium.make_vec` make the same environments.
"""

from typing import Any

from .data import Task, task, tasks


def make(task_id: str, **more: Any) -> Any:
    """The environment of a task, as `gymnasium.make` makes it. more: `render_mode`, `info_level`; other keywords make
    it another task, whose score is not the suite's, and are warned of (but `duration` and `reward`, for training)."""
    import gymnasium

    return gymnasium.make(task(task_id).registered, **more)


def make_vec(task_id: str, num_envs: int, **more: Any) -> Any:
    """The vector environment of a task, as `gymnasium.make_vec` makes it. more: as in `make`, and `threads`,
    `autoreset_mode`."""
    import gymnasium

    return gymnasium.make_vec(task(task_id).registered, num_envs=num_envs, **more)


def digest(one: Task) -> str:
    """16 hexadecimal digits of what a task comes to: environment, keywords, and with them resolved the arm, solver,
    times, reward weights, starts, observation's layout; numbers to ten digits."""
    from .frozen import digest_of

    return digest_of(one)


__all__ = ["Task", "digest", "make", "make_vec", "task", "tasks"]
