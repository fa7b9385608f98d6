"""The tasks "press" and "land": the tip slides along a wall under a commanded normal force, or lands on a wall."""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

import numpy as np

from .. import sensors as description
from .. import validation as check
from ..batch import Land, LandChain, Press, PressChain, SpacePress, Starts, Task
from ..compiler import uncompiled
from ..geometry.inverse import angles_at, beyond_reach, goal_angles
from ..parameters import Arm
from ..rigid import largest_force
from ..scene import Contact, contacts_of
from ..shapes import HalfSpace
from ..tasks.space import directions as directions_of
from ..validation import Array
from .observation import COMMANDED
from .space import Place
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
HEIGHTS = (0.2, 0.5)
"""Range of the height of a path's middle in space, divided by the largest distance within reach along the wall."""
FORCES = (0.3, 0.6)
"""Range of the commanded force, divided by the largest tip force that the motors can hold."""
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
    """Wall: distance (m), bearing and elevation (rad) of the wall's point that is nearest to the root."""

    distance: float
    bearing: float
    elevation: float = 0.0

    @property
    def directions(self) -> Array:
        """Unit vectors (3, 3): from the root to the nearest point, to larger bearings, and upwards along the wall."""
        return np.array(uncompiled(directions_of)(self.bearing, self.elevation))

    def half_chord(self, length: float) -> float:
        """Return the half length, m, of the part of the wall within `REACH` times the arm's length of the root."""
        return math.sqrt(max((REACH * length) ** 2 - self.distance**2, 0.0))


class OnWall(Point):
    """Moving target that slides along a wall."""

    paths: ClassVar = {"line": (*Point.paths["line"], ("force", "N"))}

    def __init__(self, wall: Wall, duration: float) -> None:
        """Store the wall and the length of an episode, s."""
        self.wall, self.duration = wall, duration

    def ranges(self, arm: Arm, path: str) -> list[Pair]:
        """Return ranges of a drawn path: wall distance (m), time (s), speed (m/s), bearing (rad), force (N)."""
        d, b, _ = self.wall
        half = self.wall.half_chord(arm.total_length)
        speed = min(0.05 * arm.total_length, half / (0.6 * self.duration))
        most = largest_force(arm)
        time = (0.4 * self.duration, 0.6 * self.duration)
        return [(d, d), time, (0.4 * speed, speed), (b, b), (FORCES[0] * most, FORCES[1] * most)]

    def check_ranges(self, ranges: list[Pair], arm: Arm, path: str) -> None:
        """Raise `InvalidValue` unless the wall is within reach and the commanded force is positive."""
        check_force(ranges[4])


class OnWallInSpace(Place):
    """Moving target that slides along a wall in space, in a random direction."""

    paths: ClassVar = {"line": (*Place.paths["line"], ("height", "m"), ("force", "N"))}

    def __init__(self, wall: Wall, duration: float) -> None:
        """Store the wall and the length of an episode, s."""
        self.wall, self.duration = wall, duration

    def ranges(self, arm: Arm, path: str) -> list[Pair]:
        """Return ranges of a path: distance (m), time (s), speed (m/s), bearing, elevation (rad), height, force (N).

        The height of a path's middle is measured from the wall's point nearest to the root, upwards along the wall.
        """
        d, b, e = self.wall
        half, most = self.wall.half_chord(arm.total_length), largest_force(arm)
        speed = min(0.05 * arm.total_length, 0.4 * half / (0.6 * self.duration))
        time = (0.4 * self.duration, 0.6 * self.duration)
        height, force = (HEIGHTS[0] * half, HEIGHTS[1] * half), (FORCES[0] * most, FORCES[1] * most)
        return [(d, d), time, (0.4 * speed, speed), (b, b), (e, e), height, force]

    def check_ranges(self, ranges: list[Pair], arm: Arm, path: str) -> None:
        """Raise `InvalidValue` unless the force is positive and all paths are within reach and joint limits."""
        check_force(ranges[6])
        away, around, up = self.wall.directions
        time, speed = ranges[1], ranges[2][1]
        # farthest ends of the paths from their middles, in eight directions along the wall
        far = speed * max(abs(time[1]), abs(self.duration - time[0]))
        turns = np.linspace(0.0, 2.0 * np.pi, 9)[:-1, None]
        ends = np.concatenate([np.zeros((1, 3)), far * (np.cos(turns) * around + np.sin(turns) * up)])
        middles = self.wall.distance * away + np.linspace(*ranges[5], 3)[:, None] * up
        places = (middles[:, None] + ends).reshape(-1, 3)
        wrong = beyond_reach(arm, places)
        if wrong is not None:
            limits = " and the joint limits" * bool(arm.joint_limits)
            at = ", ".join(f"{x:g}" for x in places[wrong])
            what = f"must keep the paths within reach{limits} at speeds up to {speed:g} m/s: ({at}) m is not"
            raise check.InvalidValue("reference.height", ranges[5], what)


def check_force(force: Pair) -> None:
    """Raise `InvalidValue` unless all commanded forces are positive."""
    if force[0] <= 0.0:
        raise check.InvalidValue("reference.force", force, "must be positive (N)")


class PlaceOnWall(OnWall):
    """Target at rest on a wall."""

    paths: ClassVar = {"line": (("distance", "m"), ("offset", "m"), ("speed", "m/s"), ("bearing", "rad"))}

    def ranges(self, arm: Arm, path: str) -> list[Pair]:
        """Return ranges of a target: wall distance (m), offset from its nearest point (m), speed (0), bearing (rad)."""
        d, b, _ = self.wall
        half = self.wall.half_chord(arm.total_length)
        return [(d, d), (0.0, 0.7 * half), (0.0, 0.0), (b, b)]

    def check_ranges(self, ranges: list[Pair], arm: Arm, path: str) -> None:
        """Raise `InvalidValue` unless the target on the wall is within the arm's reach."""
        farthest = math.sqrt(max((0.95 * arm.total_length) ** 2 - self.wall.distance**2, 0.0))
        if ranges[1][1] > farthest:
            what = f"must be at most {farthest:g} m, so that the point of the wall is within reach"
            raise check.InvalidValue("reference.offset", ranges[1], what)


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
        ValueError: the message names the key path, the value and the allowed values.
    """
    if task not in (PRESS, LAND):
        return Pressing(kind, contacts, sensors, reference)
    if kind.target.numbers == 1 or (kind.space and task == LAND):
        ids = "TwoLinkFlexArm-v0 or MultiLinkFlexArm-v0, whose target is a point in the plane"
        ids = "TwoLinkFlexArm-v0, MultiLinkFlexArm-v0 or SpatialFlexArm-v0" if task == PRESS else ids
        raise check.InvalidValue("task", task, f"must be given for {ids}")
    if kind.space and arm.n_links < 3:
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
    zeros = (0.0,) * (2 if arm.spatial else 1)
    obstacle = HalfSpace((DISTANCE * arm.total_length, *zeros), (-1.0, *zeros))
    return Contact(obstacle, largest_force(arm) / 3e-3**1.5, damping=30.0, friction=0.3)


def _wall_of(contact: Contact, arm: Arm) -> Wall:
    """Return the wall of a contact, shifted by the payload's radius, after checking that the tip reaches the wall."""
    obstacle, path = contact.obstacle, "contacts[0].obstacle"
    if not isinstance(obstacle, HalfSpace) or "tip" not in contact.bodies:
        raise check.InvalidValue(path, obstacle.to_dict(), "must be a half-space for the tip, the wall of the task")
    away = -np.array(obstacle.normal)
    distance = float(obstacle.distance(np.zeros((1, len(away))))[0]) - arm.payload.radius
    if not 0.0 < distance < REACH * arm.total_length:
        what = f"must be a wall at most {REACH * arm.total_length:g} m from the root, which is outside"
        raise check.InvalidValue(path, obstacle.to_dict(), what)
    elevation = math.atan2(away[2], math.hypot(away[0], away[1])) if arm.spatial else 0.0
    return Wall(distance, math.atan2(away[1], away[0]), elevation)


def _kind(kind: Kind, wall: Wall, duration: float) -> Kind:
    """Return the task definition for task="press" at a wall, with episodes of `duration` s."""
    weights = {name: kind.rewards[name] for name in kind.rewards if name != FAILURE}

    def entries(arm: Arm) -> list[tuple[str, float]]:
        return [*kind.entries(arm), (COMMANDED, largest_force(arm))]

    def starts(arm: Arm, rules: int) -> Starts:
        usual = kind.starts(arm, rules)
        begun = _ranges_in_space(arm, wall, kind.gravity) if kind.space else _ranges(arm, wall)
        return dataclasses.replace(usual, start=begun, straight=0.0)

    def record(arm: Arm) -> type[Task]:
        return SpacePress if kind.space else Press if arm.n_links == 2 else PressChain

    return dataclasses.replace(
        kind, task=PRESS, duration=LONGER * kind.duration, entries=entries, starts=starts, bands=BANDS,
        target=OnWallInSpace(wall, duration) if kind.space else OnWall(wall, duration),
        rewards={**weights, "force": 0.5, FAILURE: kind.rewards[FAILURE]}, record=record,
    )  # fmt: skip


def _landing(kind: Kind, wall: Wall, duration: float, arm: Arm) -> Kind:
    """Return the task definition for task="land" at a wall, with episodes of `duration` s."""
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
    place = NEAR * wall.distance * np.array([[math.cos(wall.bearing), math.sin(wall.bearing)]])
    return _about(arm, goal_angles(arm, np.zeros((1, arm.n_links)), place, np.ones((1, arm.n_links)))[0])


def _ranges_in_space(arm: Arm, wall: Wall, gravity: Any) -> list[Pair]:
    """Return the ranges of joint angles at a start, rad; see `_ranges`.

    gravity (3,): acceleration of gravity, m/s^2, against which the motors hold the arm.
    """
    away, _, up = wall.directions
    height = 0.5 * sum(HEIGHTS) * wall.half_chord(arm.total_length)
    found = angles_at(arm, NEAR * (wall.distance * away + height * up), gravity)
    if found is None:
        what = f"must be a wall in front of which the tip of {arm.name!r} can start, within its joint limits"
        raise check.InvalidValue("contacts[0].obstacle", tuple(wall), what)
    return _about(arm, found)


def _about(arm: Arm, angles: Array) -> list[Pair]:
    """Return ranges of joint angles of half width `TURN` about `angles` (N,), rad, within the joint limits."""
    limits = [(-math.inf, math.inf) if pair is None else pair for pair in arm.joint_limits or (None,) * arm.n_links]
    pairs = zip(angles.tolist(), limits, strict=True)
    return [(max(low, angle - TURN), min(high, angle + TURN)) for angle, (low, high) in pairs]
