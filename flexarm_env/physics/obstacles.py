"""Signed distances of points from the shapes of `shapes`, for kernels."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..compiler import absolute, kernel, maximum, select_lt, square_root
from ..layout import Field, Layout
from ..shapes import SHAPES, Shape

Array = NDArray[np.float64]

OBSTACLE = Layout(
    "Obstacle", "",
    Field("kind", (), "", "index in `shapes.SHAPES`"),
    Field("place", (3,), "m", "reference point of the shape, inertial axes"),
    Field("axes", (3, 3), "", "axes of the shape as columns; of a half-space the first: outward normal"),
    Field("sizes", (3,), "m", "sphere: radius; cylinder: radius and half length; box: half sides"),
)  # fmt: skip
O = OBSTACLE.places
HALF_SPACE, SPHERE, BOX, CYLINDER = range(4)

ENDLESS = 1e300
"""Half size along z of a shape of the plane, m."""


class KeepOut(NamedTuple):
    """Shapes that an arm must not enter, and scratch memory for points along the arm."""

    shapes: np.ndarray  # one `OBSTACLE` per shape
    margin: float  # m: a smaller distance is penalized
    tip: tuple[int, ...] | None  # a tag: only the tip is checked; None: the whole arm
    rows: tuple[int, ...] = ()  # one zero per row of q: size of a stack array
    points: np.ndarray = np.zeros((0, 0, 2))  # (groups, P, 2 or 3) m: scratch, points along an arm
    parts: np.ndarray = np.zeros(0, np.int64)  # (P,): points checked between point j - 1 and j


def packed(shapes: Sequence[Shape]) -> Array:
    """Return the flat table of one `OBSTACLE` per shape; plane shapes lie at z = 0 and extend by ENDLESS along z."""
    rows = []
    for shape in shapes:
        d, kind = shape.dimension, SHAPES.index(type(shape))
        axes, place, sizes = np.eye(3), np.zeros(3), np.full(3, ENDLESS)
        axes[:d, :d], place[:d], sizes[: len(shape.sizes)] = shape.axes, shape.place, shape.sizes
        # a half-space has only its normal n, stored as the first axis
        if kind == HALF_SPACE:
            axes[:, 0] = 0.0
            axes[:d, 0] = shape.normal  # type: ignore[attr-defined]
        rows.append(OBSTACLE.pack({}, kind=kind, place=place, axes=axes, sizes=sizes))
    return np.concatenate(rows)


@kernel
def _corner(a, b, c):
    """Return the signed distance (m) of a point from a box, negative inside.

    a, b, c (m): the point's distance beyond each pair of opposite faces, |coordinate| - half side, negative between the
    faces. For a cylinder a is the distance beyond its mantle.
    """
    # inside all of a, b, c <= 0: minus the distance from the nearest face; outside: from the nearest face, edge or
    # corner
    zero = a * 0.0
    x, y, z = maximum(a, zero), maximum(b, zero), maximum(c, zero)
    inside = maximum(maximum(a, b), c)
    return square_root((x * x + y * y) + z * z) + select_lt(inside, 0.0, inside, zero)


@kernel
def distance(table, s, x, y, z):
    """Return the signed distance (m), negative inside, of the point (x, y, z) from shape s of a table.

    Point in m, inertial axes; its components may be lanes. table: one `OBSTACLE` per shape (kind, place, axes, sizes).
    """
    o = O.end * s
    kind, p, A, h = table[o + O.kind], o + O.place, o + O.axes, o + O.sizes
    # (a, b, c): the point in the shape's own axes
    dx, dy, dz = x - table[p], y - table[p + 1], z - table[p + 2]
    a = (dx * table[A] + dy * table[A + 3]) + dz * table[A + 6]
    b = (dx * table[A + 1] + dy * table[A + 4]) + dz * table[A + 7]
    c = (dx * table[A + 2] + dy * table[A + 5]) + dz * table[A + 8]
    # half-space: distance a along its normal
    far = a
    if kind == SPHERE:
        far = square_root((a * a + b * b) + c * c) - table[h]
    elif kind == BOX:
        far = _corner(absolute(a) - table[h], absolute(b) - table[h + 1], absolute(c) - table[h + 2])
    elif kind == CYLINDER:
        out = square_root(a * a + b * b)
        far = _corner(out - table[h], absolute(c) - table[h + 1], x * 0.0 - ENDLESS)
    return far
