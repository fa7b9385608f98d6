"""Offsets and names of a state's entries in the memory block of an arm."""

from typing import Any, NamedTuple

import numpy as np

from .. import validation as check
from ..compiler import size, uncompiled
from ..physics.integrator.work import unpack
from ..physics.joints.layout import LAW as JOINT_LAW
from ..physics.joints.layout import PLACE, PLACES
from ..physics.model import OWN, OWN_IN_SPACE
from ..runtime.layout import record_sizes
from ..tasks.program import (
    CHANGE,
    CHANNEL,
    HOLD,
    LAW,
    LEVEL,
    PATH,
    PATH_AT,
    PERIODS,
    PUSH,
    PUSHED,
    RECORD,
    TARGET,
    TARGET_RATE,
    TORQUE_FACTOR,
)
from ..validation import Array

_JOINT, _LAW = JOINT_LAW.places, LAW.places


class _Place(NamedTuple):
    name: str
    at: int  # offset of the number in a memory block


def places_of(
    batch: Any, model: Any, stride: int, layout: Any, parameters: bool, kept: bool
) -> tuple[Any, tuple[str, ...], int]:
    """Return offsets and names of a state's entries in a memory block, and the number of variable entries.

    stride: distance between two elements of the block.
    layout: offsets of the block's sections.
    parameters: True if the state contains parameters as variable entries.
    kept: True to include accelerations and torques although each period recomputes the accelerations.
    """
    task, extras = batch.task, batch.extras
    rows, links = int(size(model.n)), len(task.links)
    fixed = set(model.fixed.tolist())
    work = uncompiled(unpack)((0,) * stride, model, np.arange(layout.par, dtype=np.float64), 0)
    afresh = not kept and model.newton.resolved is not None
    friction = model.newton.friction is not None
    moving: list[_Place] = []
    forces = set() if model.algebraic is None else set(model.algebraic.tolist())
    # rows of rigid links (weight 0) follow from other rows, and nothing reads them
    passive = set(np.flatnonzero(model.weight == 0.0).tolist()) - forces
    free = [k for k in range(rows) if k not in fixed | passive]
    for name in ("q", "v") if afresh else ("q", "v", "a", "b"):
        first = int(getattr(work, name)[0])
        moving += [_Place(f"{name}[{k}]", first + k * stride) for k in free if name == "q" or k not in forces]
    if not afresh:
        moving += [_Place(f"torque[{k}]", int(work.u[0]) + k * stride) for k in range(links)]
    at = RECORD.offsets(0, *record_sizes(task, batch.entries, extras))

    def recorded(name: str, first: int, count: int) -> list[_Place]:
        places = (layout.record + (first + k) * stride for k in range(count))
        return [_Place(f"{name}[{k}]" if count > 1 else name, place) for k, place in enumerate(places)]

    moving += recorded("acted", at.acted, len(task.acted))
    if extras.actuator is not None:
        moving += recorded("motor", at.torque, links) + recorded("asked", at.commands, at.delays - at.commands)
    words = OWN_IN_SPACE if len(task.targets) == 3 else OWN
    own = [_Place(name, layout.par + k * stride) for k, name in enumerate(words)]
    own += recorded("torque_factor", TORQUE_FACTOR, 1)
    own += [_Place(name, layout.par + (len(model.own) + k) * stride) for k, name, _ in _laws(model)]
    given = [_Place(f"q[{k}]", int(work.q[0]) + k * stride) for k in sorted(fixed)]
    for name in "qvab":
        given += [_Place(f"{name}[{k}]", int(getattr(work, name)[0]) + k * stride) for k in sorted(passive)]
    remembered, drawn = _of_sensors(extras.instruments, at.readings, recorded, own if parameters else None)
    moving += remembered
    if parameters:
        moving += own
    else:
        given += own
    given += drawn + recorded("delay", at.delays, at.seen - at.delays)
    given += recorded("target", TARGET, max(2, len(task.targets)))
    given += recorded("target_rate", TARGET_RATE, max(2, len(task.targets)))
    if any(part is not None for part in (extras.controller, extras.instruments, extras.reference)):
        given += recorded("goal", at.goal, links)
    if extras.pushes is not None:
        given += recorded("push", PUSHED, PUSH.places.end)
    if extras.payload_change is not None:
        given += recorded("change", CHANGE, 2)
    if afresh and friction:  # with the last torques they say which joints slide, and nothing else
        given += [_Place(f"a[{k}]", int(work.a[0]) + k * stride) for k in free]
    # inputs that acted last: the jump at the start of a period depends on them
    if not afresh or friction or extras.payload_change is not None:
        last = [_Place(f"torque[{k}]", int(work.u[0]) + k * stride) for k in range(len(work.u) // stride)]
        given += last if afresh else last[links:]
    if extras.reference is not None:
        given += recorded("path", PATH_AT, PATH.places.end if len(task.targets) == 3 else PATH.places.z)
    if batch.program.models is not None:
        given += recorded("level", LEVEL, 1)
    given += recorded("periods", PERIODS, 1) + recorded("hold", HOLD, 1)
    both = moving + given
    return np.array([place.at for place in both], np.int64), tuple(place.name for place in both), len(moving)


def _laws(model: Any) -> list[tuple[int, str, float]]:
    """Return index, name and value of the nonzero numbers of the joint laws, if each arm has laws of its own."""
    if getattr(model, "own", None) is None:
        return []
    found = []
    for i in range(len(model.data) // _JOINT.end):
        joint = int(model.table[PLACES * i + PLACE.joint])
        for field in JOINT_LAW.fields:
            k = _JOINT.end * i + getattr(_JOINT, field.name)
            if model.data[k] != 0.0:
                found.append((k, f"{field.name}[{joint}]", float(model.data[k])))
    return found


def laws_of(model: Any, names: tuple[str, ...]) -> tuple[list[int], list[float]]:
    """Return two lists for the parameters of gears, rotors and friction: their indices in a state, and their values.

    names: names of the state's entries.
    """
    found = _laws(model)
    return [names.index(name) for _, name, _ in found], [value for _, _, value in found]


def _of_sensors(instruments: Any, first: int, recorded: Any, own: Any) -> tuple[list[_Place], list[_Place]]:
    """Return two lists: the sensors' memory that affects readings, and sensor numbers that are drawn or counted.

    own: list of the parameters to which gains and biases are added, or None.
    """
    if instruments is None:
        return [], []
    moving: list[_Place] = []
    given: list[_Place] = []
    encoders = 0 if instruments.encoders is None else len(instruments.encoders) // 3
    shaken = 0 if instruments.accelerometer is None else len(instruments.accelerometer) - 1  # axes
    for c, law in enumerate(instruments.laws.reshape(-1, _LAW.end)):
        at = CHANNEL.offsets(first + c * CHANNEL.offsets(0, instruments.room).end, instruments.room)
        late, filtered = int(law[_LAW.late]), law[_LAW.own : _LAW.after].any()
        parts = {
            "filter": ((at.input, 3), filtered),
            "before": ((at.output, 1), not filtered and law[_LAW.share] > 0.0),
            "tip": ((at.place, 3), encoders <= c < encoders + shaken),
            "spin": ((at.rate, 1), shaken > 2 and encoders <= c < encoders + shaken),
            "reading": ((at.reading, 1), c < encoders or law[_LAW.every] > 1.0),
            "rate": ((at.rate, 1), c < encoders and law[_LAW.kept] > 0.0),
            "past": ((at.past, late), late > 0),
        }
        for name, (places, needed) in parts.items():
            moving += recorded(f"sensor[{c}].{name}", *places) if needed else []
        drawn = given if own is None else own
        drawn += recorded(f"sensor[{c}].law", at.gain, 2)
        given += recorded(f"sensor[{c}].since", at.since, 1)
    return moving, given


def checked(name: str, value: Any, shape: tuple[int, ...]) -> Array:
    """Return an array of numbers as float64; raise ValueError if its shape is not `shape`.

    name: name of the argument in the message.
    """
    rows = check.floats(name, value)
    if rows.shape != shape:
        raise check.InvalidValue(f"{name}.shape", rows.shape, f"must be {shape}")
    return rows
