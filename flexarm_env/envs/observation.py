"""Entries of observations: available and selected entries, their sensors, and stacking of previous observations."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .. import sensors as description
from .. import validation as check
from ..batch import LAW_SIZE, Instruments, Selection, law_of, room_of
from ..parameters import Arm
from ..rigid import rate_scale
from ..scene import touching_points
from .features import Frame, gauge_scales
from .task import Kind

FULL, MEASURED = "full", "measured"
ACTED = "previous_action"
"""Name of the entries, one per joint, with the action of the period that has just ended; 0 at an episode's start."""
COMMANDED = "target_force"
"""Name of the entry with the commanded normal force of the task "press"."""
LONGEST_HISTORY = 1000

Entries = list[tuple[str, float]]


@dataclass(frozen=True)
class Sight:
    """Available entries of the observation, with names and scales; gauges and previous actions are at the end.

    chosen (C,): indices of the selected entries, in order; None for all. instruments: sensors with noise, filter or
    delay, or None. read: number of entries that sensors measure.
    """

    names: tuple[str, ...]
    scales: tuple[float, ...]
    chosen: tuple[int, ...] | None
    instruments: Instruments | None
    read: int

    def of(self, values: Sequence[Any]) -> tuple[Any, ...]:
        """Select the values of the selected entries from `values`, one value per available entry."""
        return tuple(values) if self.chosen is None else tuple(values[k] for k in self.chosen)

    def selection(self, history: int) -> Selection | None:
        """Return the indices of the selected entries in `history` stacked observations; None if all are selected."""
        if self.chosen is None and history == 1:
            return None
        chosen = range(len(self.names)) if self.chosen is None else self.chosen
        return Selection(np.array(chosen, np.int64), history)


def checked_observation(observation: Any, history: Any) -> tuple[str | tuple[str, ...], int]:
    """Validate the keywords `observation` and `history` as far as possible without the arm; return their values."""
    count = check.integer("history", history, minimum=1, maximum=LONGEST_HISTORY)
    if isinstance(observation, str):
        if observation in (FULL, MEASURED):
            return observation, count
        raise check.InvalidValue("observation", observation, f'must be "{FULL}", "{MEASURED}" or names of entries')
    names = check.sequence("observation", observation, "names of entries")
    for i, name in enumerate(names):
        check.text(f"observation[{i}]", name, empty=False)
        if name in names[:i]:
            raise check.InvalidValue(f"observation[{i}]", name, "must not be named twice")
    if not names:
        raise check.InvalidValue("observation", observation, "must name at least one entry")
    return names, count


def sensors_of(kind: Kind, arm: Arm, observation: str | tuple[str, ...], given: Any) -> description.Sensors:
    """Return the user's sensors. Unless the observation is "full", the arm's sensors replace kinds that the user omits.

    If observation="measured", an arm without sensors has ideal sensors, and ideal encoders replace missing encoders.
    """
    own = arm.sensors
    if isinstance(given, description.Sensors):
        found, named = given, set(description.KEYS)
    else:
        table = {} if given is None else check.table_of("sensors", given)
        known = {key: value for key, value in table.items() if key in description.KEYS}
        found, named = description.from_table(known), set(known)
    if observation != FULL:
        base = own or kind.sensors(arm)
        if own is None and observation != MEASURED:
            gauged = any(name.startswith("strain_gauge_") for name in observation)
            base = description.Sensors(strain_gauges=base.strain_gauges if gauged else ())
        found = dataclasses.replace(found, **{key: getattr(base, key) for key in description.KEYS if key not in named})
        if observation == MEASURED and not found.encoders:
            found = dataclasses.replace(found, encoders=(description.Encoder(),))
    with check.under("sensors"):
        found.check_for(arm.links, arm.axes)
    return found


def sight(frame: Frame, observation: str | tuple[str, ...], sensors: description.Sensors, further: Entries) -> Sight:
    """Return the entries (`Sight`) that are available with the given sensors. further: entries of a moving target."""
    kind, arm = frame.kind, frame.arm
    task = kind.entries(arm)
    goals = goal_entries(kind, arm)
    aimed = observation == MEASURED or (observation != FULL and any(name in observation for name, _ in goals))
    entries = [*task, *further, *(goals if aimed else [])]
    push = rate_scale(arm, 0) ** 2 * arm.total_length
    sizes = {"accelerometer": push, "gyroscope": rate_scale(arm, 0), "camera": arm.total_length}
    assert arm.torque_limits is not None
    sizes |= {"force": arm.torque_limits[0] / arm.total_length, "switch": 1.0}
    for sensor, readings in description.of_the_tip(arm.axes).items():
        if getattr(sensors, sensor) is not None:
            entries += [(name, 1.0 if "_rise_" in name else sizes[sensor]) for name in readings]
    gauges = _gauge_entries(frame, sensors.strain_gauges)
    entries += gauges
    names, scales = tuple(name for name, _ in entries), tuple(scale for _, scale in entries)
    joints = [[names.index(f"{joint}_{of}") for of in ("sin", "cos", "rate")] for joint in arm.joint_names]
    added = len(entries) - len(task) - len(further) - len(gauges)
    instruments = _instruments(frame, sensors, aimed, joints, entries, [scale for _, scale in gauges], added)
    read, acted = len(names), arm.by_link(ACTED)
    if isinstance(observation, tuple) and any(name in observation for name in acted):
        names, scales = (*names, *acted), (*scales, *(1.0 for _ in acted))
    return Sight(names, scales, _chosen(observation, names, len(task), joints, acted), instruments, read)


def goal_entries(kind: Kind, arm: Arm) -> Entries:
    """Return names and scales of the target's entries: goal minus encoder angles, and the target point."""
    axes = "xyz"[: kind.target.numbers] if kind.target.numbers > 1 else ""
    point = [(f"target_{axis}", arm.total_length) for axis in axes]
    return [*((f"{joint}_error", 1.0) for joint in arm.joint_names), *point]


def _chosen(
    observation: str | tuple[str, ...], names: tuple[str, ...], task: int, joints: list[list[int]],
    acted: Sequence[str],
) -> tuple[int, ...] | None:
    """Return the indices of the observed entries among all available entries.

    An unknown name of an entry raises ValueError.
    """
    if observation == FULL:
        return None
    if observation == MEASURED:
        measured = {place for joint in joints for place in joint}
        # a commanded force is known without a sensor
        measured |= {k for k, name in enumerate(names) if name == COMMANDED}
        return tuple(k for k in range(len(names)) if k in measured or k >= task)
    for i, name in enumerate(observation):
        if name not in names:
            known = (*names, *(one for one in acted if one not in names))
            raise check.UnknownKey(f"observation[{i}] = {name!r}", known, "entry of the observation")
    return tuple(names.index(name) for name in observation)


def _gauge_entries(frame: Frame, gauges: Sequence[description.StrainGauge]) -> Entries:
    """Return name and scale of each gauge, in its unit."""
    found = []
    for i, (gauge, scale) in enumerate(zip(gauges, gauge_scales(frame, gauges), strict=True)):
        with check.under(f"sensors.strain_gauges[{i}]"):
            found.append((f"strain_gauge_{i + 1}", scale * gauge.per_curvature_of(frame.arm.links[gauge.link])))
    return found


def _instruments(
    frame: Frame,
    sensors: description.Sensors,
    aimed: bool,
    joints: list[list[int]],
    entries: Entries,
    sizes: list[float],
    added: int,
) -> Instruments | None:
    """Return the sensors with noise, filter or delay, or None; ideal gauges are not among them."""
    motors: list[int] = []
    laws, period, length = [], frame.period, frame.arm.total_length
    if sensors.encoders:
        each = [sensors.encoder(k).behind(frame.arm.joint(k).gear_ratio) for k in range(len(joints))]
        laws += [law_of(encoder, 1.0, period, f"sensors.encoders[{k}]") for k, encoder in enumerate(each)]
        motors = [int(encoder.side == "motor" and frame.arm.joint(k).elastic) for k, encoder in enumerate(each)]
    scales = dict(entries)
    for sensor, readings in description.of_the_tip(frame.arm.axes).items():
        if getattr(sensors, sensor) is not None:
            laws += [law_of(getattr(sensors, sensor), scales[name], period, f"sensors.{sensor}") for name in readings]
    lawful = not all(gauge.is_ideal for gauge in sensors.strain_gauges)
    if lawful:
        sized = zip(sensors.strain_gauges, sizes, strict=True)
        laws += [law_of(g, size, period, f"sensors.strain_gauges[{i}]") for i, (g, size) in enumerate(sized)]
    if not laws and not aimed:
        return None
    table = np.array(laws) if laws else np.zeros((0, LAW_SIZE))
    gravity = frame.gravity or (0.0,) * len(frame.arm.axes)
    return Instruments(
        period=period,
        laws=table.ravel(),
        entries=added,
        room=room_of(table),
        goals=(0,) if aimed else None,
        encoders=np.array(joints, np.int64).ravel() if sensors.encoders else None,
        motors=np.array(motors, np.int64) if any(motors) else None,
        accelerometer=None if sensors.accelerometer is None else np.array([*gravity, scales["tip_acceleration_x"]]),
        camera=None if sensors.camera is None else length,
        gauges=(0,) * len(sensors.strain_gauges) if lawful else None,
        gyroscope=None if sensors.gyroscope is None else scales["gyroscope_x"],
        force=None if sensors.force is None else scales["tip_force_normal"],
        switch=None if sensors.switch is None else sensors.switch.threshold,
        tip=_tip_of(frame),
    )


def _tip_of(frame: Frame) -> int:
    """Return the tip's index among the possible contact points (the last one); -1 if the tip cannot touch."""
    points = touching_points(frame.contacts, frame.arm)
    return len(points) - 1 if (frame.arm.n_links - 1, 1.0) in points else -1
