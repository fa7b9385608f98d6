"""Tasks without reward, with which controllers simulate an arm by the compiled functions of the environments."""

from __future__ import annotations

import numpy as np

from ..batch import Chain, Reach, Slew, SpaceReach, Starts, Task
from ..parameters import Arm


def bare_task(arm: Arm) -> Task:
    """Return a task without reward for an arm."""
    n = arm.n_links
    flexible = [link for link in arm.links if not link.rigid]
    # class, number of entries and of a target's coordinates
    kind, entries, targets = {
        "xy": (Slew, 6, 1) if n == 1 else (Reach if n == 2 else Chain, 5 * n + 4, 2),
        "xyz": (SpaceReach, 3 * n + 6 * len(flexible) + 6, 3),
    }[arm.axes]
    assert arm.torque_limits is not None
    return kind(
        links=(0,) * n, targets=(0,) * targets, terms=(0,) * 6, entries=(0,) * entries,
        length=arm.total_length, lengths=np.array([0.0 if link.rigid else link.span for link in arm.links]),
        scales=np.ones(entries),
        rates=np.ones(n), weights=np.zeros(6), torque_limits=np.array(arm.torque_limits),
        joint_limits=np.array([(-np.inf, np.inf)] * n).ravel(), hold=1.0, bands=np.full(3, np.inf),
    )  # fmt: skip


def bare_starts(arm: Arm) -> Starts:
    """Return ranges of initial states that contain only the straight arm at rest; targets are not used."""
    none, reach = [(0.0, 0.0)] * arm.n_links, arm.total_length
    return Starts(start=none, target={"xy": [(reach, reach), (0.0, 0.0)], "xyz": none}[arm.axes])
