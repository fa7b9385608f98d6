"""Shapes of obstacles in the plane and in space, with signed distances and their gradients.

The distance of a point from a shape is the distance to the nearest point of the shape's surface, m, and is negative
inside the shape. All distances are exact. If several points of the surface are equally near, the gradient belongs to
one of the nearest points.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike

from . import bodies
from . import validation as check
from .validation import Array

Point = tuple[float, ...]


def _point(path: str, value: object, unit: str = "m") -> Point:
    """Validate a point or vector of two or three finite numbers."""
    given = check.sequence(path, value, f"two numbers (x, y) or three (x, y, z){f', {unit}' if unit else ''}")
    if len(given) not in (2, 3):
        raise check.InvalidValue(path, value, "must be two numbers (x, y), in the plane, or three, in space")
    return tuple(check.number(f"{path}[{k}]", x, unit) for k, x in enumerate(given))


@dataclass(frozen=True)
class Shape:
    """Base class of shapes, with position and orientation.

    The number of coordinates, d, is 2 in the plane and 3 in space.
    """

    name: ClassVar[str]

    @property
    def place(self) -> Point:
        """Reference point of the shape, m."""
        raise NotImplementedError

    @property
    def axes(self) -> Array:
        """Axes of the shape as columns of a matrix, (d, d)."""
        return np.eye(self.dimension)

    @property
    def dimension(self) -> int:
        """Number of coordinates: 2 in the plane, 3 in space."""
        return len(self.place)

    def moved(self, by: Sequence[float]) -> Self:
        """Return the shape displaced by the vector `by` (d,), m."""
        points = {f.name: getattr(self, f.name) for f in fields(self) if f.name in ("point", "center", "start", "end")}
        return replace(self, **{k: tuple(x + y for x, y in zip(v, by, strict=True)) for k, v in points.items()})

    @property
    def sizes(self) -> Point:
        """Half dimensions of the shape, m; each class defines which dimensions."""
        return ()

    def distance(self, points: ArrayLike) -> Array:
        """Return the signed distances (...,), m, of points (..., d) from the shape's surface."""
        return self.look(points)[0]

    def gradient(self, points: ArrayLike) -> Array:
        """Return the gradients of the distance at points (..., d): unit vectors (..., d)."""
        return self.look(points)[1]

    def look(self, points: ArrayLike) -> tuple[Array, Array]:
        """Return distances (...,), m, of points (..., d) and the gradients of the distances, (..., d)."""
        given = np.asarray(points, np.float64)
        if given.shape[-1:] != (self.dimension,):
            what = f"must have {self.dimension} numbers along its last axis, as the {self.name} has"
            raise check.InvalidValue("points", given.shape, what)
        distance, slope = self._local((given - np.array(self.place)) @ self.axes)
        return np.asarray(distance), np.asarray(slope @ self.axes.T)

    def _local(self, y: Array) -> tuple[Array, Array]:
        raise NotImplementedError

    def to_dict(self) -> dict[str, Any]:
        """Return a dict from which `shape_of` creates an equal shape."""
        fields = {name: getattr(self, name) for name in check.names_of(type(self))}
        return {"shape": self.name, **{name: value for name, value in fields.items() if value is not None}}


@dataclass(frozen=True)
class HalfSpace(Shape):
    """Half-space: all points on one side of a plane (in 2-D: of a line), for example a wall or a floor.

    point: a point of the surface, m. normal: vector of any length, normal to the surface, out of the obstacle.
    """

    point: Point
    normal: Point
    name: ClassVar[str] = "half_space"

    def __post_init__(self) -> None:
        """Validate the fields and normalize the normal vector."""
        point, normal = _point("point", self.point), _point("normal", self.normal, "")
        if len(point) != len(normal):
            raise check.InvalidValue("normal", self.normal, f"must have {len(point)} numbers, as point has")
        length = math.hypot(*normal)
        if not 1e-150 < length < 1e150:
            raise check.InvalidValue("normal", self.normal, "must be a direction: not all of its numbers 0")
        check.store(self, point=point, normal=tuple(x / length for x in normal))

    @property
    def place(self) -> Point:
        """A point of the half-space's surface, m."""
        return self.point

    def _local(self, y: Array) -> tuple[Array, Array]:
        normal = np.array(self.normal)
        return y @ normal, np.broadcast_to(normal, y.shape)


@dataclass(frozen=True)
class Sphere(Shape):
    """Ball (in 2-D: disc).

    center: position of the center, m. radius: radius, m.
    """

    center: Point
    radius: float
    name: ClassVar[str] = "sphere"

    def __post_init__(self) -> None:
        center, radius = _point("center", self.center), check.number("radius", self.radius, "m", above=0.0)
        check.store(self, center=center, radius=radius)

    @property
    def place(self) -> Point:
        """Center of the ball, m."""
        return self.center

    @property
    def sizes(self) -> Point:
        """Radius of the ball, m."""
        return (self.radius,)

    def _local(self, y: Array) -> tuple[Array, Array]:
        far, slope = _unit(y)
        return far - self.radius, slope


@dataclass(frozen=True)
class Box(Shape):
    """Cuboid (in 2-D: rectangle).

    center: position of the center, m. sides: full lengths of the sides, m. turn: rotation of the box: in 2-D an angle
    (rad), in space a rotation matrix or a pair (axis, angle); None for no rotation.
    """

    center: Point
    sides: Point
    turn: Any = None
    name: ClassVar[str] = "box"

    def __post_init__(self) -> None:
        """Validate the fields of the box. turn: an angle, rad, in the plane, or a rotation in space."""
        center, sides = _point("center", self.center), _point("sides", self.sides)
        if len(center) != len(sides):
            raise check.InvalidValue("sides", self.sides, f"must have {len(center)} numbers, as center has")
        for k, side in enumerate(sides):
            check.number(f"sides[{k}]", side, "m", above=0.0)
        turn = self.turn
        if turn is not None:
            turn = check.number("turn", turn, "rad") if len(center) == 2 else bodies.mount("turn", turn)
        check.store(self, center=center, sides=sides, turn=turn)

    @property
    def place(self) -> Point:
        """Center of the box, m."""
        return self.center

    @property
    def axes(self) -> Array:
        """Axes along the sides of the box, as columns of a matrix."""
        if self.turn is None or self.dimension == 3:
            return np.eye(self.dimension) if self.turn is None else np.array(self.turn)
        c, s = math.cos(self.turn), math.sin(self.turn)
        return np.array([(c, -s), (s, c)])

    @property
    def sizes(self) -> Point:
        """Half of the side lengths, m."""
        return tuple(0.5 * side for side in self.sides)

    def _local(self, y: Array) -> tuple[Array, Array]:
        distance, slope = _corner(np.abs(y) - np.array(self.sizes))
        return distance, slope * np.where(y < 0.0, -1.0, 1.0)


@dataclass(frozen=True)
class Cylinder(Shape):
    """Circular cylinder with flat ends, in space.

    start, end: end points of the cylinder's axis, m. radius: radius, m.
    """

    start: Point
    end: Point
    radius: float
    name: ClassVar[str] = "cylinder"

    def __post_init__(self) -> None:
        start, end = bodies.vector("start", self.start, "m"), bodies.vector("end", self.end, "m")
        if not math.dist(start, end) > 1e-12:
            raise check.InvalidValue("end", self.end, "must be another point than start (1e-12 m apart and more)")
        check.store(self, start=start, end=end, radius=check.number("radius", self.radius, "m", above=0.0))

    @property
    def place(self) -> Point:
        """Position of the middle of the cylinder's axis, m."""
        return tuple(0.5 * (a + b) for a, b in zip(self.start, self.end, strict=True))

    @property
    def axes(self) -> Array:
        """Axes of the cylinder as columns of a matrix. The third column is the direction of the cylinder's axis."""
        along = np.subtract(self.end, self.start) / math.dist(self.start, self.end)
        least = np.eye(3)[np.argmin(np.abs(along))]
        first = np.cross(least, along)
        first /= np.linalg.norm(first)
        return np.column_stack([first, np.cross(along, first), along])

    @property
    def sizes(self) -> Point:
        """Radius and half length of the cylinder, m."""
        return self.radius, 0.5 * math.dist(self.start, self.end)

    def _local(self, y: Array) -> tuple[Array, Array]:
        """Return the signed distance (m) of points y (..., 3), in the cylinder's axes, and its gradient (..., 3)."""
        radius, half = self.sizes
        out, way = _unit(y[..., :2])
        distance, slope = _corner(np.stack([out - radius, np.abs(y[..., 2]) - half], axis=-1))
        along = slope[..., 1] * np.where(y[..., 2] < 0.0, -1.0, 1.0)
        return distance, np.concatenate([way * slope[..., :1], along[..., None]], axis=-1)


def _unit(y: Array) -> tuple[Array, Array]:
    """Return lengths and directions of vectors; the direction of a zero vector is the first axis."""
    length = np.linalg.norm(y, axis=-1)
    first = np.eye(y.shape[-1])[0]
    return length, np.where(length[..., None] > 0.0, y / np.where(length > 0.0, length, 1.0)[..., None], first)


def _corner(q: Array) -> tuple[Array, Array]:
    """Return signed distance and gradient from coordinates relative to a corner, which are all negative inside."""
    outside, inside = np.maximum(q, 0.0), q.max(axis=-1)
    length, slope = _unit(outside)
    nearest = np.eye(q.shape[-1])[np.argmax(q, axis=-1)]
    return length + np.minimum(inside, 0.0), np.where((inside > 0.0)[..., None], slope, nearest)


SHAPES: tuple[type[Shape], ...] = (HalfSpace, Sphere, Box, Cylinder)


def shape_of(path: str, value: Any, dimension: int) -> Shape:
    """Return `value` if it is a shape; otherwise create a shape from the table `value`.

    A table has the key `shape` ("half_space", "sphere", "box" or "cylinder") and the fields of this class.

    Raises:
        ValueError: the value is neither a shape nor a table with these fields, or the shape has another number of
            coordinates than `dimension`.
    """
    shape = value if isinstance(value, Shape) else _from_table(path, value)
    if shape.dimension != dimension:
        where = "the plane: points of two numbers" if dimension == 2 else "space: points of three numbers"
        raise check.InvalidValue(path, shape.to_dict(), f"must be in {where}")
    return shape


def _from_table(path: str, value: Any) -> Shape:
    """Make a shape from a table, in which the key `shape` names the class."""
    table = check.table_of(path, value)
    kinds: Mapping[str, Any] = {kind.name: kind for kind in SHAPES}
    words = tuple(kinds)
    word = check.choice(f"{path}.shape", check.needed(path, table, "shape", f"must be {', '.join(words)}"), words)
    fields = {k: v for k, v in table.items() if k != "shape"}
    wanted = {k: f"a {word} needs it" for k in check.names_of(kinds[word]) if k != "turn"}
    found: Shape = check.made(path, kinds[word], fields, **wanted)
    return found
