"""Tasks without reward, with which controllers simulate an arm by the compiled functions of the environments."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..batch import Chain, Reach, Slew, SpaceReach, Starts, Task
from ..parameters import Arm


class Bare(NamedTuple):
    """Description of a task without reward.

    kind: class of the task's data in compiled code. entries: number of entries of an observation. targets: number of
    coordinates of a target. ranges: ranges of targets; unused in this task.
    """

    kind: type[Task]
    entries: int
    targets: int
    ranges: list[tuple[float, float]]


def bare_in_plane(arm: Arm) -> Bare:
    """Return the description of the task for an arm in the plane."""
    n, ranges = arm.n_links, [(arm.total_length, arm.total_length), (0.0, 0.0)]
    return Bare(Slew, 6, 1, ranges) if n == 1 else Bare(Reach if n == 2 else Chain, 5 * n + 4, 2, ranges)


def bare_in_space(arm: Arm) -> Bare:
    """Return the description of the task for an arm in space."""
    n, flexible = arm.n_links, [link for link in arm.links if not link.rigid]
    return Bare(SpaceReach, 3 * n + 6 * len(flexible) + 6, 3, [(0.0, 0.0)] * n)


def bare_task(arm: Arm, bare: Bare) -> Task:
    """Return a task without reward for an arm."""
    n, (kind, entries, targets, _) = arm.n_links, bare
    assert arm.torque_limits is not None
    return kind(
        links=(0,) * n, targets=(0,) * targets, terms=(0,) * 6, entries=(0,) * entries,
        length=arm.total_length, lengths=np.array([0.0 if link.rigid else link.span for link in arm.links]),
        scales=np.ones(entries),
        rates=np.ones(n), weights=np.zeros(6), torque_limits=np.array(arm.torque_limits),
        joint_limits=np.array([(-np.inf, np.inf)] * n).ravel(), hold=1.0, bands=np.full(3, np.inf),
    )  # fmt: skip


def bare_starts(arm: Arm, bare: Bare) -> Starts:
    """Return ranges of initial states that contain only the straight arm at rest."""
    return Starts(start=[(0.0, 0.0)] * arm.n_links, target=bare.ranges)
