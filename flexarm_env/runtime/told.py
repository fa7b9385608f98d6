"""Data of one arm for Python code: a `View` of the arm at an instant, and the offsets of the entries of `info`."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..compiler import SINGLE, size, uncompiled
from ..physics import protocol
from ..physics.contact.layout import READ, Touching
from ..physics.integrator.work import unpack
from ..physics.reading import Reading
from ..tasks.program import INFO
from ..tasks.task import Task

Array = NDArray[np.float64]


def info_places(task: Task) -> Any:
    """Return the offsets of the fields of a task's `INFO`."""
    return INFO.offsets(0, len(task.links), len(task.targets), len(task.terms), len(task.further))


NO_TOUCHES = np.zeros((0, 7))
"""Value of `View.touches` for an arm without contacts."""


def touches_of(reading: Reading, model: Any, row: Array, poses: Array) -> Array:
    """Return position (m), force on the arm (N) and normal force (N) of each contact point, (points, 7), inertial axes.

    reading: quantities of the arm (`reading_of`). model: the arm's model. row: the integrator's work array of one arm,
    without lanes. poses: the links' poses, one row for each link.
    """
    contact = model.newton.contact
    if contact is None:
        return NO_TOUCHES
    part = next(part for part in model.contributions if isinstance(part, Touching))
    work = uncompiled(unpack)(SINGLE, model, row, 0)
    S: Array = work.S
    rows = [S[contact.at + k * contact.stride :][: READ.end] for k in range(len(contact.points))]
    found = np.zeros((len(rows), NO_TOUCHES.shape[1]))
    found[:, : len(part.space)] = poses[part.links, reading.tip]
    if part.inside is not None:
        # points along links: their input displacements, in which the arm's own parameters have no part
        y, arm = np.zeros(size(model.n_inputs)), model.arm
        uncompiled(protocol.input_displacements)(SINGLE, arm, np.zeros(0), work.q[: size(arm.n)].copy(), y)
        places = y[part.input :][: len(part.points) * len(part.entries)].reshape(len(part.points), -1)
        found[:, : len(part.space)] = places[:, : len(part.space)]
    found[:, 3:6] = [reading[READ.force : READ.force + 3] for reading in rows]
    found[:, 6] = [reading[READ.normal] for reading in rows]
    return found


@dataclass(frozen=True)
class View:
    """State and task of one arm of N links at an instant, for rendering and recording."""

    points: Array  # (n, 2), in space (n, 3): centerline from root to tip, m, inertial axes
    poses: Array  # (N, 12) as `physics.protocol.link_poses`, in space (N, 23) as `task_poses`
    time: float  # time since the start, s
    target: Array  # target point, m, or target angle, rad
    torques: Array  # (N,) joint torques, N m
    deflection: Array  # (N,) tip deflection / link length; in space (2 N,): along y, then along z
    q: Array  # coordinates of the state, m and rad
    touches: Array = field(default_factory=lambda: NO_TOUCHES)  # contact points and forces, see `touches_of`
