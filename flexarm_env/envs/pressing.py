"""The tasks "press" and "land": the tip slides along a wall under a commanded normal force, or lands on a wall."""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from .. import sensors as description
from .. import validation as check
from ..batch import Starts
from ..parameters import Arm
from ..rigid import largest_force
from ..scene import Contact, contacts_of
from ..scene.contacts import DISPLACEMENTS
from ..shapes import HalfSpace
from ..validation import Array
from .observation import COMMANDED
from .targets import REACH, Pair, Wall
from .task import FAILURE, LAND, PRESS, Kind

DISTANCE = 0.7
"""Distance of the default wall from the root, divided by the arm's length."""
TURN = 0.1
"""Half width of the ranges of initial joint angles, rad."""
LONGER = 3.0
"""Length of an episode, as a multiple of that of the environment's default task.

The arm comes to rest at the wall in a third of an episode.
"""
BANDS: dict[str, tuple[float, str]] = {"force": (0.1, ""), "path": (0.002, "m")}
"""Bounds of a success: root mean square of the force's relative error, and largest distance from the path."""


LANDED: dict[str, tuple[float, str]] = {"path": (0.005, "m"), "speed": (0.005, "m/s")}
"""Bounds of a success of "land": distance from the target along the wall, and speed of the tip.

The bound of a period's impulse is the impulse, in one default control period, of the largest tip force that the motors
can hold.
"""


class Pressing(NamedTuple):
    """Properties of an environment with task "press" or "land": definition of the task, contacts, sensors and path."""

    kind: Kind
    contacts: Any
    sensors: Any
    reference: Any


def pressing(kind: Kind, arm: Arm, task: Any, duration: Any, contacts: Any, sensors: Any, reference: Any) -> Pressing:
    """Return definition and keywords of an environment with task="press" or "land"; leave other tasks unchanged.

    The first contact is the wall, a half-space that does not contain the root. If the user gives no contacts, the wall
    is at a distance of 0.7 arm lengths along x. A force sensor is added to the environment's sensors.

    Raises:
        ValueError: a keyword is invalid; the message names the key path, the value and the rule.
    """
    if task not in (PRESS, LAND):
        return Pressing(kind, contacts, sensors, reference)
    target = kind.target
    if target.on_wall is None or (task == LAND and target.at_rest_on_wall is None):
        ids = "TwoLinkFlexArm-v0 or MultiLinkFlexArm-v0, whose target is a point in the plane"
        ids = "TwoLinkFlexArm-v0, MultiLinkFlexArm-v0 or SpatialFlexArm-v0" if task == PRESS else ids
        raise check.InvalidValue("task", task, f"must be given for {ids}")
    if arm.n_links < target.numbers:
        what = f"must be given for an arm with at least three joints in space, which {arm.name!r} has not"
        raise check.InvalidValue("task", task, what)
    if arm.base is not None:
        raise check.InvalidValue("task", task, "must not be given for an arm whose base floats")
    longer = LONGER if task == PRESS else 1.0
    length = longer * kind.duration if duration is None else check.number("duration", duration, "s", above=0.0)
    found = contacts_of("contacts", contacts, arm, len(arm.axes)) or (_usual_wall(arm),)
    wall = _wall_of(found[0], arm)
    options = {} if reference is None else check.table_of("reference", reference)
    for name in ("distance", "bearing", "elevation", "path", *(["speed"] if task == LAND else [])):
        if name in options:
            raise check.InvalidValue(f"reference.{name}", options[name], f'must be left out with task="{task}"')
    if isinstance(sensors, description.Sensors):
        own = description.ForceSensor() if sensors.force is None else sensors.force
        sensors = dataclasses.replace(sensors, force=own)
    elif sensors is None or isinstance(sensors, Mapping):
        sensors = {"force": {}, **(sensors or {})}
    made = _kind(kind, wall, length) if task == PRESS else _landing(kind, wall, length, arm)
    return Pressing(made, found, sensors, {**options, "path": "line"})


def _usual_wall(arm: Arm) -> Contact:
    """Return the default wall: a soft pad with friction 0.3 that the motors' largest force indents by 3 mm."""
    zeros = (0.0,) * (len(arm.axes) - 1)
    obstacle = HalfSpace((DISTANCE * arm.total_length, *zeros), (-1.0, *zeros))
    return Contact(obstacle, largest_force(arm) / 3e-3**1.5, damping=30.0, friction=0.3)


def _wall_of(contact: Contact, arm: Arm) -> Wall:
    """Return the wall of a contact, shifted by the payload's radius, after checking that the tip reaches the wall."""
    obstacle, path = contact.obstacle, "contacts[0].obstacle"
    if not isinstance(obstacle, HalfSpace) or "tip" not in contact.bodies:
        raise check.InvalidValue(path, obstacle.to_dict(), "must be a half-space for the tip, the wall of the task")
    for axis, function in contact.displacements:
        what = "must be left out: the wall of the task stands still; further contacts may move"
        raise check.InvalidValue(f"contacts[0].{DISPLACEMENTS[axis]}", function, what)
    away = -np.array(obstacle.normal)
    distance = float(obstacle.distance(np.zeros((1, len(away))))[0]) - arm.payload.radius
    if not 0.0 < distance < REACH * arm.total_length:
        what = f"must be a wall at most {REACH * arm.total_length:g} m from the root, which is outside"
        raise check.InvalidValue(path, obstacle.to_dict(), what)
    x, y, z = np.append(away, 0.0)[:3]
    return Wall(distance, math.atan2(y, x), math.atan2(z, math.hypot(x, y)))


def _kind(kind: Kind, wall: Wall, duration: float) -> Kind:
    """Return the task definition for task="press" at a wall, with episodes of `duration` s."""
    assert kind.target.on_wall is not None
    target = kind.target.on_wall(wall, duration)

    def entries(arm: Arm) -> list[tuple[str, float]]:
        return [*kind.entries(arm), (COMMANDED, largest_force(arm))]

    made = _at_wall(kind, target, PRESS, {"force": 0.5})
    return dataclasses.replace(made, duration=LONGER * kind.duration, entries=entries, bands=BANDS)


def _landing(kind: Kind, wall: Wall, duration: float, arm: Arm) -> Kind:
    """Return the task definition for task="land" at a wall, with episodes of `duration` s."""
    assert kind.target.at_rest_on_wall is not None
    made = _at_wall(kind, kind.target.at_rest_on_wall(wall, duration), LAND, {"impulse": 1.0})
    return dataclasses.replace(made, bands={**LANDED, "impulse": (largest_force(arm) * kind.period, "N s")})


def _at_wall(kind: Kind, target: Any, task: str, reward: dict[str, float]) -> Kind:
    """Return a task definition with a target on a wall. reward: the added reward term and its weight."""
    weights = {name: kind.rewards[name] for name in kind.rewards if name != FAILURE}

    def starts(arm: Arm, rules: int) -> Starts:
        begun = _about(arm, target.first_posture(arm, kind.gravity))
        return dataclasses.replace(kind.starts(arm, rules), start=begun, straight=0.0)

    return dataclasses.replace(
        kind, task=task, target=target, starts=starts, record=target.record,
        rewards={**weights, **reward, FAILURE: kind.rewards[FAILURE]},
    )  # fmt: skip


def _about(arm: Arm, angles: Array) -> list[Pair]:
    """Return ranges of joint angles of half width `TURN` about `angles` (N,), rad, within the joint limits."""
    limits = [(-math.inf, math.inf) if pair is None else pair for pair in arm.joint_limits or (None,) * arm.n_links]
    pairs = zip(angles.tolist(), limits, strict=True)
    return [(max(low, angle - TURN), min(high, angle + TURN)) for angle, (low, high) in pairs]
