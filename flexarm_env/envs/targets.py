"""Types of targets of planar tasks: an angle or a point, at rest or in motion."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np

from .. import validation as check
from ..batch import Land, LandChain, Press, PressChain, Task
from ..compiler import uncompiled
from ..geometry.inverse import goal_angles
from ..parameters import Arm
from ..rigid import largest_force, rate_scale, reach
from ..tasks.program import GOAL, TARGET
from ..tasks.space import directions as directions_of
from ..tasks.task import aim, target_from
from ..time_functions import TimeFunction
from ..validation import Array
from .motion import ANGLE, function_of

Pair = tuple[float, float]

AHEAD = (0.1, 0.3)
"""Times from the present, s, for which task="track" observes the future displacement of the target."""

NEAR = 0.75
"""Tip's distance from the root at a start before a wall, divided by the wall's distance."""
FORCES = (0.3, 0.6)
"""Range of the commanded force, divided by the largest tip force that the motors can hold."""
REACH = 0.85
"""Largest distance of a path's point on a wall from the root, divided by the arm's length."""


def joint_range(arm: Arm, k: int, row: Any, of: str = "angles") -> Pair:
    """Return joint k's range (low, high), rad, of `starts.<of>`; raise `InvalidValue` if it exceeds the joint limits.

    row: the user's pair of angles, rad. of: key of the pair in the table, for messages.
    """
    low, high = check.limits(f"starts.{of}[{k}]", row, "rad", **ANGLE)
    own = None if arm.joint_limits is None else arm.joint_limits[k]
    if own is not None and not own[0] <= low <= high <= own[1]:
        what = f"must be within the joint's limits, {own[0]:g} to {own[1]:g} rad"
        raise check.InvalidValue(f"starts.{of}[{k}]", (low, high), what)
    return low, high


class Target(ABC):
    """Type of a task's target: an angle or a point.

    numbers: number of coordinates of a target. A compiled task stores at least two numbers per target; for an angle the
    second number is 0.
    paths: shapes of random paths, the default shape first, each with the names and units of the numbers that define a
    path of this shape.
    on_wall, at_rest_on_wall: types of targets on a wall, for the tasks "press" and "land"; None if the environment has
    no such task.
    """

    numbers: int
    paths: ClassVar[Mapping[str, tuple[tuple[str, str], ...]]]
    on_wall: ClassVar[Any] = None
    at_rest_on_wall: ClassVar[Any] = None

    @abstractmethod
    def read(self, arm: Arm, value: Any, gravity: Sequence[float] | None = None) -> Pair:
        """Validate the reset option "target" and return it.

        gravity: acceleration of gravity, m/s^2, against which the motors must hold the arm at the target.
        """

    @abstractmethod
    def reached(self, arm: Arm, angles: Sequence[float]) -> Pair:
        """Return the target that the rigid arm reaches at joint angles, rad."""

    def requested(self, arm: Arm, angles: Sequence[float]) -> Sequence[float]:
        """Return the target that the rigid arm reaches at joint angles, rad, in the form of `resets.Request.target`."""
        return self.reached(arm, angles)

    def request_size(self, arm: Arm) -> int:
        """Return the number of values with which a request stores a target."""
        return 2

    def goal(self, task: Task, angles: Array, drawn: Array) -> Array:
        """Return the goal joint angles, rad, of a random target. angles: initial angles. drawn: random numbers."""
        record = np.zeros(GOAL + len(angles))
        record[GOAL:] = angles
        record[TARGET : TARGET + 2] = uncompiled(target_from)(task, angles, *drawn.tolist())
        uncompiled(aim)(task, record)
        return record[GOAL:]

    @abstractmethod
    def start_ranges(self, arm: Arm, value: Any) -> list[Pair]:
        """Validate `starts.target`; return the two ranges of a random target, in space a range for each joint."""

    def chain(self, arm: Arm) -> dict[str, Array]:
        """Return the compiled task's data for inverse kinematics; None if moving targets need no such data."""
        return {}

    def axis(self, arm: Arm) -> Array | None:
        """Return the axis (3,) about which random paths are rotated; None in the plane."""
        return None

    @abstractmethod
    def place(self, arm: Arm, target: Array) -> Array:
        """Return the position, (2,) m, at which a picture shows the target."""

    @abstractmethod
    def entries(self, arm: Arm) -> list[tuple[str, float]]:
        """Return names and scales of a moving target's observation entries: its velocity and future displacements."""

    @abstractmethod
    def ranges(self, arm: Arm, path: str) -> list[Pair]:
        """Return the default ranges of the numbers that define a random path of the shape `path`."""

    def drawn(self, options: Mapping[str, Any], arm: Arm) -> tuple[str, list[Pair]]:
        """Return the shape of random paths and the ranges of the numbers that define a path.

        options: the user's ranges by name, which replace default ranges.

        Raises:
            ValueError: a name is unknown, a range is invalid, or a path could leave the reach of the arm.
        """
        shape = check.choice("reference.path", options.get("path", next(iter(self.paths))), tuple(self.paths))
        check.known_keys("reference", options, ("path", *(name for name, _ in self.paths[shape])))
        ranges = self.ranges(arm, shape)
        for k, (name, unit) in enumerate(self.paths[shape]):
            if name in options:
                signed = name in ("bearing", "elevation", "height")
                bounds = {"above": 0.0} if name == "period" else {} if signed else {"minimum": 0.0}
                bounds = ANGLE | bounds if unit.startswith("rad") else bounds
                ranges[k] = check.limits(f"reference.{name}", options[name], unit, **bounds)
        return shape, self.narrowed(ranges, options, arm, shape)

    def narrowed(self, ranges: list[Pair], options: Mapping[str, Any], arm: Arm, path: str) -> list[Pair]:
        """Return `ranges`, or narrower ranges if some paths are outside the joint limits.

        options: the user's ranges, which are not narrowed.
        """
        self.check_ranges(ranges, arm, path)
        return ranges

    def check_ranges(self, ranges: list[Pair], arm: Arm, path: str) -> None:  # noqa: B027
        """Raise ValueError if a path within the given ranges leaves the arm's reach."""

    @abstractmethod
    def path(self, reference: Any, arm: Arm, t: Array) -> list[TimeFunction]:
        """Return the path `reference` as one function of time per coordinate. t (n,): instants of the validation, s."""


class Angle(Target):
    """Target of one number: the polar angle of the tip, rad."""

    numbers = 1
    paths: ClassVar = {"swing": (("width", "rad"), ("period", "s")), "line": (("behind", "rad"), ("rate", "rad/s"))}

    def read(self, arm: Arm, value: Any, gravity: Sequence[float] | None = None) -> Pair:
        if check.several(value) and len(value) == 1:
            value = value[0]
        return check.number("options.target", value, "rad", **ANGLE), 0.0

    def reached(self, arm: Arm, angles: Sequence[float]) -> Pair:
        return float(sum(angles)), 0.0

    def start_ranges(self, arm: Arm, value: Any) -> list[Pair]:
        """Return the range of the target angle (rad), and the unused range (0, 0)."""
        return [check.limits("starts.target", value, "rad", **ANGLE), (0.0, 0.0)]

    def place(self, arm: Arm, target: Array) -> Array:
        return np.array([arm.total_length * math.cos(target[0]), arm.total_length * math.sin(target[0])])

    def entries(self, arm: Arm) -> list[tuple[str, float]]:
        ahead = [(f"target_ahead_{k + 1}", 1.0) for k in range(len(AHEAD))]
        return [("target_rate", rate_scale(arm, 0)), *ahead]

    def ranges(self, arm: Arm, path: str) -> list[Pair]:
        rate = rate_scale(arm, 0)
        if path == "line":
            return [(0.5, 1.0), (0.1 * rate, 0.3 * rate), (0.0, 0.0), (0.0, 0.0)]
        return [(0.3, math.pi / 2), (10.0 / rate, 20.0 / rate), (0.0, 0.0), (0.0, 0.0)]

    def path(self, reference: Any, arm: Arm, t: Array) -> list[TimeFunction]:
        angle = function_of("reference", reference)
        check.number("reference", max(angle(t).min(), angle(t).max(), key=abs), "rad", **ANGLE)
        return [angle]


class Point(Target):
    """Target of two numbers: the position of the tip, (x, y) in m."""

    numbers = 2
    paths: ClassVar = {
        "circle": (("distance", "m"), ("period", "s"), ("radius", "m"), ("bearing", "rad")),
        "line": (("distance", "m"), ("time", "s"), ("speed", "m/s"), ("bearing", "rad")),
    }

    def read(self, arm: Arm, value: Any, gravity: Sequence[float] | None = None) -> Pair:
        """Return the target (x, y), m; raise `InvalidValue` if it is out of reach."""
        x, y = check.sequence("options.target", value, "two numbers (m), (x, y)", 2)
        x, y = check.number("options.target[0]", x, "m"), check.number("options.target[1]", y, "m")
        near, far = reach(arm)
        if not near <= math.hypot(x, y) <= far:
            what = f"must be within reach, {near:g} to {far:g} m from the root"
            raise check.InvalidValue("options.target", (x, y), what)
        return x, y

    def reached(self, arm: Arm, angles: Sequence[float]) -> Pair:
        """Return the tip (x, y), m, of the rigid arm at joint angles, rad."""
        angle, x, y = 0.0, 0.0, 0.0
        for link, turn in zip(arm.links, angles, strict=True):
            angle += turn
            x, y = x + link.span * math.cos(angle), y + link.span * math.sin(angle)
        return x, y

    def start_ranges(self, arm: Arm, value: Any) -> list[Pair]:
        """Return the ranges of a point's distance (m) and bearing (rad)."""
        first, second = check.sequence("starts.target", value, "two pairs: distance (m) and bearing (rad)", 2)
        near, far = reach(arm)
        low, high = check.limits("starts.target[0]", first, "m")
        if not near <= low <= high <= far:
            what = f"must be within reach, {near:g} to {far:g} m from the root"
            raise check.InvalidValue("starts.target[0]", (low, high), what)
        return [(low, high), check.limits("starts.target[1]", second, "rad", **ANGLE)]

    def place(self, arm: Arm, target: Array) -> Array:
        return target

    def entries(self, arm: Arm, axes: str = "xy") -> list[tuple[str, float]]:
        speed, way = rate_scale(arm, 0) * arm.total_length, 0.5 * arm.total_length
        named = [("target_velocity", speed), *((f"target_ahead_{k + 1}", way) for k in range(len(AHEAD)))]
        return [(f"{name}_{axis}", scale) for name, scale in named for axis in axes]

    def ranges(self, arm: Arm, path: str) -> list[Pair]:
        """Return default ranges of random paths, scaled to the arm's length and to its fastest joint rates."""
        rate, far = rate_scale(arm, 0), arm.total_length
        turns = (-math.pi / 3, math.pi / 3)
        if path == "line":
            return [(0.5 * far, 0.75 * far), (3.0 / rate, 5.0 / rate), (0.1 * rate * far, 0.25 * rate * far), turns]
        return [(0.5 * far, 0.75 * far), (12.0 / rate, 24.0 / rate), (0.05 * far, 0.2 * far), turns]

    def check_ranges(self, ranges: list[Pair], arm: Arm, path: str) -> None:
        """Raise ValueError if a circle, or the point of a straight path nearest to the root, is out of reach."""
        (nearest, farthest), _, (_, radius), _ = ranges
        near, far = reach(arm)
        wide = radius if path == "circle" else 0.0
        if nearest - wide < near * (1.0 - 1e-9) or farthest + wide > far * (1.0 + 1e-9):
            what = f"must keep the path within reach, {near:g} to {far:g} m from the root, or a line's nearest point"
            raise check.InvalidValue("reference.distance", ranges[0], what)

    def path(self, reference: Any, arm: Arm, t: Array) -> list[TimeFunction]:
        """Return x and y, m, of a path as functions of time; a ValueError names the first instant out of reach."""
        both = coordinates(reference, "two functions of time, x and y (m), or a table (n, 3): t, x, y", 2)
        x, y = (f(t) for f in both)
        near, far = reach(arm)
        distance = np.hypot(x, y)
        wrong = np.flatnonzero((distance < near * (1.0 - 1e-9)) | (distance > far * (1.0 + 1e-9)))
        if wrong.size:
            at = f"({x[wrong[0]]:g}, {y[wrong[0]]:g}) m at {t[wrong[0]]:g} s"
            raise ValueError(f"reference = {at}: must stay within reach, {near:g} to {far:g} m from the root")
        return both


def coordinates(value: Any, what: str, numbers: int) -> list[TimeFunction]:
    """Convert a point's path to one function of time per coordinate.

    value: a table with the columns t (s) and coordinates (m), the path of a file, or functions of time.
    """
    try:
        rows = np.asarray(value)
    except ValueError:
        rows = np.array(None)
    if rows.dtype.kind in "fiu" and rows.ndim == 2 and rows.shape[1] == 1 + numbers:
        value = [rows[:, [0, 1 + d]] for d in range(numbers)]
    return [function_of(f"reference[{d}]", f) for d, f in enumerate(check.sequence("reference", value, what, numbers))]


class Wall(NamedTuple):
    """Wall, defined by distance (m), bearing and elevation (rad) of its point nearest to the root."""

    distance: float
    bearing: float
    elevation: float = 0.0

    @property
    def directions(self) -> Array:
        """Unit vectors (3, 3): from root to nearest point, along the wall to larger bearings, up along the wall."""
        return np.array(uncompiled(directions_of)(self.bearing, self.elevation))

    def half_chord(self, length: float) -> float:
        """Return half the length, m, of the wall's part within `REACH` times the arm's length from the root."""
        return math.sqrt(max((REACH * length) ** 2 - self.distance**2, 0.0))


class OnWall(Point):
    """Moving target that slides along a wall."""

    paths: ClassVar = {"line": (*Point.paths["line"], ("force", "N"))}

    def __init__(self, wall: Wall, duration: float) -> None:
        """Store the wall and the length of an episode, s."""
        self.wall, self.duration = wall, duration

    def ranges(self, arm: Arm, path: str) -> list[Pair]:
        """Return ranges of random paths: wall distance (m), time (s), speed (m/s), bearing (rad), force (N)."""
        d, b, _ = self.wall
        half = self.wall.half_chord(arm.total_length)
        speed = min(0.05 * arm.total_length, half / (0.6 * self.duration))
        most = largest_force(arm)
        time = (0.4 * self.duration, 0.6 * self.duration)
        return [(d, d), time, (0.4 * speed, speed), (b, b), (FORCES[0] * most, FORCES[1] * most)]

    def check_ranges(self, ranges: list[Pair], arm: Arm, path: str) -> None:
        """Raise `InvalidValue` unless the wall is within reach and the commanded force is positive."""
        check_force(ranges[4])

    def first_posture(self, arm: Arm, gravity: Any) -> Array:
        """Return joint angles (N,), rad, at which the tip is in front of the wall."""
        place = NEAR * self.wall.distance * np.array([[math.cos(self.wall.bearing), math.sin(self.wall.bearing)]])
        return np.asarray(goal_angles(arm, np.zeros((1, arm.n_links)), place, np.ones((1, arm.n_links)))[0])

    def record(self, arm: Arm) -> type[Task]:
        """Return the class of the compiled task for an arm."""
        return Press if arm.n_links == 2 else PressChain


def check_force(force: Pair) -> None:
    """Raise `InvalidValue` unless all commanded forces are positive."""
    if force[0] <= 0.0:
        raise check.InvalidValue("reference.force", force, "must be positive (N)")


class PlaceOnWall(OnWall):
    """Target at rest on a wall."""

    paths: ClassVar = {"line": (("distance", "m"), ("offset", "m"), ("speed", "m/s"), ("bearing", "rad"))}

    def ranges(self, arm: Arm, path: str) -> list[Pair]:
        """Return ranges: wall distance (m), offset from the wall's nearest point (m), speed (0), bearing (rad)."""
        d, b, _ = self.wall
        half = self.wall.half_chord(arm.total_length)
        return [(d, d), (0.0, 0.7 * half), (0.0, 0.0), (b, b)]

    def check_ranges(self, ranges: list[Pair], arm: Arm, path: str) -> None:
        """Raise `InvalidValue` unless the target on the wall is within the arm's reach."""
        farthest = math.sqrt(max((0.95 * arm.total_length) ** 2 - self.wall.distance**2, 0.0))
        if ranges[1][1] > farthest:
            what = f"must be at most {farthest:g} m, so that the point of the wall is within reach"
            raise check.InvalidValue("reference.offset", ranges[1], what)

    def record(self, arm: Arm) -> type[Task]:
        """Return the class of the compiled task for landing on a wall."""
        return Land if arm.n_links == 2 else LandChain


Point.on_wall, Point.at_rest_on_wall = OnWall, PlaceOnWall

ANGLE_OF_TIP, POINT = Angle(), Point()
