"""Data of one arm for Python code: the `View` of an instant, and the offsets of its info."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..tasks.program import INFO
from ..tasks.task import Task

Array = NDArray[np.float64]


def info_places(task: Task) -> Any:
    """Return the offsets of the fields of a task's `INFO`."""
    return INFO.offsets(0, len(task.links), len(task.targets), len(task.terms), len(task.further))


@dataclass(frozen=True)
class View:
    """One arm at an instant, for rendering and recording; N links."""

    points: Array  # (n, 2), in space (n, 3): centerline from root to tip, m, inertial axes
    poses: Array  # (N, 12) as `physics.protocol.link_poses`, in space (N, 23) as `task_poses`
    time: float  # s
    target: Array  # m or rad
    torques: Array  # (N,) joint torques, N m
    deflection: Array  # (N,) tip deflection over L; in space (2 N,): along y, then along z
    q: Array  # coordinates of the state, m and rad
