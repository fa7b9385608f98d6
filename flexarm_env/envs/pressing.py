"""The tasks "press" and "land": the tip slides along a wall under a commanded normal force, or lands on a wall."""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

import numpy as np

from .. import sensors as description
from .. import validation as check
from ..batch import Land, LandChain, Press, PressChain, Starts
from ..geometry.plane import goal_angles
from ..parameters import Arm
from ..rigid import largest_force
from ..scene import Contact, contacts_of
from ..shapes import HalfSpace
from .targets import Pair, Point
from .task import FAILURE, LAND, PRESS, Kind

DISTANCE = 0.7
"""Distance of the default wall from the root, divided by the arm's length."""
NEAR, TURN = 0.75, 0.1
"""Tip's distance from the root at a start, divided by the wall's distance; half width of the ranges of initial joint
angles, rad."""
LONGER = 3.0
"""Length of an episode, as a multiple of that of the environment's default task.

The arm comes to rest at the wall in a third of an episode.
"""
REACH = 0.85
"""Largest distance of a path's point from the root, divided by the arm's length."""
BANDS: dict[str, tuple[float, str]] = {"force": (0.1, ""), "path": (0.002, "m")}
"""Bounds of a success: root mean square of the force's relative error, and largest distance from the path."""


LANDED: dict[str, tuple[float, str]] = {"path": (0.005, "m"), "speed": (0.005, "m/s")}
"""Bounds of a success of "land": distance from the target along the wall, and speed of the tip.

The bound of a period's impulse is the impulse, in one default control period, of the largest tip force that the motors
can hold.
"""


class Wall(NamedTuple):
    """A wall in the plane. distance: of its nearest point from the root, m. bearing: direction of this point, rad."""

    distance: float
    bearing: float


class OnWall(Point):
    """A point that moves along a wall."""

    paths: ClassVar = {"line": (*Point.paths["line"], ("force", "N"))}

    def __init__(self, wall: Wall, duration: float) -> None:
        """Set the wall, and the length of an episode, s."""
        self.wall, self.duration = wall, duration

    def ranges(self, arm: Arm, path: str) -> list[Pair]:
        """Return ranges of a drawn path's wall distance (m), time (s), speed (m/s), wall bearing (rad), force (N)."""
        d, b = self.wall
        half = math.sqrt(max((REACH * arm.total_length) ** 2 - d * d, 0.0))
        speed = min(0.05 * arm.total_length, half / (0.6 * self.duration))
        most = largest_force(arm)
        time = (0.4 * self.duration, 0.6 * self.duration)
        return [(d, d), time, (0.4 * speed, speed), (b, b), (0.3 * most, 0.6 * most)]

    def check_ranges(self, ranges: list[Pair], arm: Arm, path: str) -> None:
        """Check that the wall is within reach and the commanded force positive."""
        if ranges[4][0] <= 0.0:
            raise check.InvalidValue("reference.force", ranges[4], "must be positive (N)")


class PlaceOnWall(OnWall):
    """A point at rest on a wall."""

    paths: ClassVar = {"line": (("distance", "m"), ("offset", "m"), ("speed", "m/s"), ("bearing", "rad"))}

    def ranges(self, arm: Arm, path: str) -> list[Pair]:
        """Return ranges of wall distance (m), offset from the wall's nearest point (m), speed (0), bearing (rad)."""
        d, b = self.wall
        half = math.sqrt(max((REACH * arm.total_length) ** 2 - d * d, 0.0))
        return [(d, d), (0.0, 0.7 * half), (0.0, 0.0), (b, b)]

    def check_ranges(self, ranges: list[Pair], arm: Arm, path: str) -> None:
        """Check that the target is within reach."""
        farthest = math.sqrt(max((0.95 * arm.total_length) ** 2 - self.wall.distance**2, 0.0))
        if ranges[1][1] > farthest:
            what = f"must be at most {farthest:g} m, so that the point of the wall is within reach"
            raise check.InvalidValue("reference.offset", ranges[1], what)


class Pressing(NamedTuple):
    """Properties of an environment with task "press" or "land": kind, contacts, sensors and reference."""

    kind: Kind
    contacts: Any
    sensors: Any
    reference: Any


def pressing(kind: Kind, arm: Arm, task: Any, duration: Any, contacts: Any, sensors: Any, reference: Any) -> Pressing:
    """Return the kind and the keywords of task="press" or "land"; for any other task, the given kind and keywords.

    The first contact is the wall: a half-space with the root outside of it. Without contacts the wall is at a distance
    of 0.7 arm lengths along x. A force sensor is added.

    Raises:
        ValueError: the message names the key path, the value and the allowed values.
    """
    if task not in (PRESS, LAND):
        return Pressing(kind, contacts, sensors, reference)
    if kind.space or kind.target.numbers != 2:
        what = "must be given for TwoLinkFlexArm-v0 or MultiLinkFlexArm-v0, whose target is a point in the plane"
        raise check.InvalidValue("task", task, what)
    if arm.base is not None:
        raise check.InvalidValue("task", task, "must not be given for an arm whose base floats")
    longer = LONGER if task == PRESS else 1.0
    length = longer * kind.duration if duration is None else check.number("duration", duration, "s", above=0.0)
    found = contacts_of("contacts", contacts, arm, False) or (_usual_wall(arm),)
    wall = _wall_of(found[0], arm)
    options = {} if reference is None else check.table_of("reference", reference)
    for name in ("distance", "bearing", "path", *(["speed"] if task == LAND else [])):
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
    obstacle = HalfSpace((DISTANCE * arm.total_length, 0.0), (-1.0, 0.0))
    return Contact(obstacle, largest_force(arm) / 3e-3**1.5, damping=30.0, friction=0.3)


def _wall_of(contact: Contact, arm: Arm) -> Wall:
    """Return the wall of a contact, shifted by the payload's radius, after checking that the tip reaches the wall."""
    obstacle, path = contact.obstacle, "contacts[0].obstacle"
    if not isinstance(obstacle, HalfSpace) or "tip" not in contact.bodies:
        raise check.InvalidValue(path, obstacle.to_dict(), "must be a half-space for the tip, the wall of the task")
    normal = np.array(obstacle.normal)
    distance = float(obstacle.distance(np.zeros((1, 2)))[0]) - arm.payload.radius
    if not 0.0 < distance < REACH * arm.total_length:
        what = f"must be a wall at most {REACH * arm.total_length:g} m from the root, which is outside"
        raise check.InvalidValue(path, obstacle.to_dict(), what)
    return Wall(distance, math.atan2(-normal[1], -normal[0]))


def _kind(kind: Kind, wall: Wall, duration: float) -> Kind:
    """Return the kind for task="press" at a wall, with episodes of `duration` s."""
    weights = {name: kind.rewards[name] for name in kind.rewards if name != FAILURE}

    def entries(arm: Arm) -> list[tuple[str, float]]:
        return [*kind.entries(arm), ("target_force", largest_force(arm))]

    def starts(arm: Arm, rules: int) -> Starts:
        usual = kind.starts(arm, rules)
        return dataclasses.replace(usual, start=_ranges(arm, wall), straight=0.0)

    return dataclasses.replace(
        kind, task=PRESS, duration=LONGER * kind.duration, target=OnWall(wall, duration), entries=entries,
        starts=starts, bands=BANDS, rewards={**weights, "force": 0.5, FAILURE: kind.rewards[FAILURE]},
        record=lambda arm: Press if arm.n_links == 2 else PressChain,
    )  # fmt: skip


def _landing(kind: Kind, wall: Wall, duration: float, arm: Arm) -> Kind:
    """Return the kind for task="land" at a wall, with episodes of `duration` s."""
    weights = {name: kind.rewards[name] for name in kind.rewards if name != FAILURE}

    def starts(arm: Arm, rules: int) -> Starts:
        return dataclasses.replace(kind.starts(arm, rules), start=_ranges(arm, wall), straight=0.0)

    return dataclasses.replace(
        kind, task=LAND, target=PlaceOnWall(wall, duration), starts=starts,
        bands={**LANDED, "impulse": (largest_force(arm) * kind.period, "N s")},
        rewards={**weights, "impulse": 1.0, FAILURE: kind.rewards[FAILURE]},
        record=lambda arm: Land if arm.n_links == 2 else LandChain,
    )  # fmt: skip


def _ranges(arm: Arm, wall: Wall) -> list[Pair]:
    """Return the ranges of joint angles at a start, rad, about a posture whose tip is in front of the wall."""
    limits = [(-math.inf, math.inf) if pair is None else pair for pair in arm.joint_limits or (None,) * arm.n_links]
    place = NEAR * wall.distance * np.array([[math.cos(wall.bearing), math.sin(wall.bearing)]])
    angles = goal_angles(arm, np.zeros((1, arm.n_links)), place, np.ones((1, arm.n_links)))[0]
    pairs = zip(angles.tolist(), limits, strict=True)
    return [(max(low, angle - TURN), min(high, angle + TURN)) for angle, (low, high) in pairs]
