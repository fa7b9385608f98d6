"""Derivatives of arms with prescribed motions. The environment simulates each of these arms outside its batch."""

from typing import Any

import numpy as np

from ..compiler import SINGLE, uncompiled
from ..physics.integrator.work import unpack, work_size
from ..runtime.guided import Guided
from ..validation import Array


def program_of(program: Any, guide: Any) -> Any:
    """Return a program for the single arm of an `envs.motion.Guide`, otherwise equal to the batch's program."""
    sensors = program.sensors
    if sensors is not None:
        sensors = sensors._replace(gauges=np.ascontiguousarray(guide.gauges, np.float64).ravel())
    return program._replace(lane=SINGLE, model=guide.simulation.model, sensors=sensors, n=1)


def guided(guide: Any, model: Any, lanes: int) -> Guided:
    """Return drive, motions and kinks of the guide's arm, with scratch memory for `lanes` lanes."""
    own = guide.simulation
    return Guided(
        drive=own.drive, motions=own.n_motions, kinks=np.array(guide.scene.kinks, np.float64),
        duration=float(guide.scene.duration), longest=float(own.dt), chunk=int(own._chunk),
        free=guide.free.astype(np.float64),
        takes=float(guide.free.any() and not guide.scene.loads),
        room=np.zeros(int(uncompiled(work_size)(lanes, model, own.n_motions))),
    )  # fmt: skip


def state_of(batch: Any, arm: int, guide: Any, model: Any, layout: Any, places: Any) -> Array:
    """Return the state (1, S) of arm number `arm`, which `guide` simulates.

    places: offsets of the state's numbers in the memory block with the sections `layout`.
    """
    block, work = np.zeros(layout.row), guide.simulation.work
    there = uncompiled(unpack)(SINGLE, model, block, 0)
    for name in ("q", "v", "a", "b", "u"):
        getattr(there, name)[:] = getattr(work, name)
    par, record = guide.simulation.par, batch.record(arm)
    block[layout.par : layout.par + len(par)] = par
    block[layout.record : layout.record + len(record)] = record
    row: Array = block[places]
    return row[None]
