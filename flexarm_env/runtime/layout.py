"""Sizes and offsets of the sections of an arm's memory block (`tasks.program.Block`)."""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from ..compiler import size, uncompiled
from ..physics.integrator.work import work_size
from ..physics.reading import Reading
from ..tasks.program import CHANNEL, INFO, LAW, RECORD, SAVED, SCRATCH, Block


def record_sizes(task: Any, entries: int, extras: Any) -> tuple[int, ...]:
    """Return the sizes of a `RECORD`, in the order of its layout.

    The sizes count joints, stored actions, rows of motor torques, rows of motor commands, drawn delays, past
    observations, and numbers in the sensors' channels. task: a `tasks.task.Task`. entries: number of entries of the
    observation. extras: a `tasks.program.Extras`.
    """
    motors, sensors, instruments = extras.actuator, extras.sensors, extras.instruments
    return (
        len(task.links), len(task.acted), int(motors is not None), 0 if motors is None else motors.rows,
        sum(part is not None and part.drawn is not None for part in (motors, sensors))
        + (0 if motors is None or motors.lag is None else 2),
        0 if sensors is None else entries * sensors.age, 0 if instruments is None else readings_size(instruments),
    )  # fmt: skip


def readings_size(instruments: Any) -> int:
    """Return the length of the sensors' channels in a record: one `CHANNEL` for each sensor law."""
    channels = len(instruments.laws) // LAW.places.end
    return channels * int(CHANNEL.offsets(0, instruments.room).end)


def parameters_of(model: Any, reading: Reading) -> int:
    """Return the number of each arm's own parameters, which include joint laws if arms differ in these."""
    return len(reading.own) + (len(model.data) if getattr(model, "own", None) is not None else 0)


def layout_of(
    lanes: int, reading: Reading, model: Any, task: Any, entries: int, extras: Any, fitted: bool, motions: int = 0
) -> Block:
    """Return the offsets of the sections in the memory block of a group of `lanes` arms, aligned to cache lines.

    reading: quantities of the arm (`reading_of`). task: a `tasks.task.Task`. entries: number of entries of the
    observation. extras: a `tasks.program.Extras`. fitted: whether steps are fitted to a tolerance, which needs a
    `SCRATCH` after the other sections. motions: number of prescribed coordinates.
    """
    links, record = len(task.links), RECORD.offsets(0, *record_sizes(task, entries, extras)).end
    info = INFO.offsets(0, links, len(task.targets), len(task.terms), len(task.further)).end
    # the record is saved only where motors or a moving target change it within a period
    kept = 0 if extras.actuator is None and extras.reference is None else record
    saved = SAVED.offsets(0, size(model.n), size(model.n_inputs), motions, kept).end
    # integrator's work array first, rounded up to 8 float64, a cache line: eight lanes of all that follows fill one
    first = -(-int(uncompiled(work_size)(lanes, model, motions)) // 8) * 8
    starts = [first]
    pose = reading.poses.places.end
    # offsets of par, poses, record, action, seen, info, saved, in lanes
    for count in (parameters_of(model, reading), pose * links + len(task.base), record, links, entries, info, saved):
        starts.append(starts[-1] + count * lanes)
    scratch = SCRATCH.offsets(0, links, saved).end * lanes if fitted else 0
    return Block(*starts, row=-(-(starts[-1] + scratch) // 8) * 8)  # type: ignore[misc]


def fit_rooms(rows: int, inputs: int, motions: int, links: int) -> tuple[np.ndarray, np.ndarray]:
    """Return zeroed arrays for one arm of a scene whose steps are fitted: a `SAVED` without record and a `SCRATCH`.

    rows: number of equations of the model. inputs: number of inputs. motions: number of prescribed coordinates. links:
    number of links.
    """
    saved = SAVED.offsets(0, rows, inputs, motions, 0).end
    return np.zeros(saved), np.zeros(SCRATCH.offsets(0, links, saved).end)


def aligned(rows: int, columns: int) -> np.ndarray:
    """Return zeros (rows, columns) that begin on a cache line, so that eight lanes fill exactly one cache line.

    Raises ValueError if the array is larger than the machine's memory: an operating system that overcommits memory
    would kill the process when the process fills the array.
    """
    have = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") if hasattr(os, "sysconf") else 2**46
    if 8 * rows * columns > have:
        most = f"{have // 10**9} GB, this machine's memory: take fewer (num_envs)"
        raise ValueError(f"states of all arms: {8 * rows * columns // 10**9} GB must be at most {most}")
    numbers = np.zeros(rows * columns + 7)
    first = -(numbers.ctypes.data // 8) % 8
    return numbers[first : first + rows * columns].reshape(rows, columns)
