"""Signed distances of points from the shapes of `shapes`, and their gradients, for kernels."""

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
    Field("kind", (), "", "index of the shape's class in `shapes.SHAPES`"),
    Field("place", (3,), "m", "reference point of the shape, inertial axes"),
    Field("axes", (3, 3), "", "axes of the shape as columns; half-space: the first is the outward normal"),
    Field("sizes", (3,), "m", "radius of a sphere, radius and half length of a cylinder, or half sides of a box"),
)  # fmt: skip
O = OBSTACLE.places
HALF_SPACE, SPHERE, BOX, CYLINDER = range(4)

ENDLESS = 1e300
"""Half size (m) of a planar shape along z, so large that the shape is unlimited in z."""
_TINY = 1e-150
"""Smallest length (m) by which a vector is divided. For a shorter vector the direction is that of the first axis."""


class KeepOut(NamedTuple):
    """Shapes that an arm must not enter, and scratch memory for points along the arm."""

    shapes: np.ndarray  # table with one `OBSTACLE` per shape
    margin: float  # m: distances below the margin are penalized
    tip: tuple[int, ...] | None  # a tag: only the tip is checked; None: the whole arm is checked
    rows: tuple[int, ...] = ()  # one zero per row of q: size of a stack array
    points: np.ndarray = np.zeros((0, 0, 2))  # (groups, P, 2 or 3) m: scratch, points along an arm
    parts: np.ndarray = np.zeros(0, np.int64)  # (P,): number of points that are checked between points j - 1 and j


def packed(shapes: Sequence[Shape]) -> Array:
    """Return the flat table of one `OBSTACLE` per shape. Planar shapes are at z = 0 and extend by ENDLESS along z."""
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
def _unit(a, b, c):
    """Return the length of the vector (a, b, c) and its direction; the direction is (1, 0, 0) if the length is 0."""
    length = square_root((a * a + b * b) + c * c)
    share = 1.0 / maximum(length, _TINY)
    return length, select_lt(_TINY, length, a * share, 1.0), b * share, c * share


@kernel
def _sign(x):
    """Return -1 where x < 0, otherwise 1."""
    return select_lt(x, 0.0, -1.0, 1.0)


@kernel
def _of_corner(a, b, c):
    """Return the signed distance (m) from a corner and its gradient; a, b, c: distances (m) beyond the three faces.

    Outside, the distance is measured from the nearest face, edge or corner; inside (all negative), from the nearest
    face.
    """
    zero = a * 0.0
    length, x, y, z = _unit(maximum(a, zero), maximum(b, zero), maximum(c, zero))
    inside = maximum(maximum(a, b), c)
    # inside: the face with the largest of the three, the first of equal ones
    first = select_lt(a, inside, 0.0, 1.0)
    second = select_lt(b, inside, 0.0, 1.0 - first)
    third = 1.0 - first - second
    far = select_lt(0.0, inside, length, inside)
    return far, select_lt(0.0, inside, x, first), select_lt(0.0, inside, y, second), select_lt(0.0, inside, z, third)


@kernel
def distance_and_normal(table, s, x, y, z):
    """Return the signed distance (m), negative inside, of (x, y, z) from shape s, and the unit vector of its gradient.

    x, y, z: coordinates of the point (m, inertial axes).
    table: one `OBSTACLE` per shape. The unit vector is in inertial axes.
    """
    o = O.end * s
    kind, p, A, h = table[o + O.kind], o + O.place, o + O.axes, o + O.sizes
    # (a, b, c): the point in the shape's own axes
    dx, dy, dz = x - table[p], y - table[p + 1], z - table[p + 2]
    a = (dx * table[A] + dy * table[A + 3]) + dz * table[A + 6]
    b = (dx * table[A + 1] + dy * table[A + 4]) + dz * table[A + 7]
    c = (dx * table[A + 2] + dy * table[A + 5]) + dz * table[A + 8]
    # half-space: along the normal, the first axis
    far, n1, n2, n3 = a, a * 0.0 + 1.0, a * 0.0, a * 0.0
    if kind == SPHERE:
        length, n1, n2, n3 = _unit(a, b, c)
        far = length - table[h]
    elif kind == BOX:
        far, n1, n2, n3 = _of_corner(absolute(a) - table[h], absolute(b) - table[h + 1], absolute(c) - table[h + 2])
        n1, n2, n3 = n1 * _sign(a), n2 * _sign(b), n3 * _sign(c)
    elif kind == CYLINDER:
        out, u1, u2, _ = _unit(a, b, a * 0.0)
        far, outward, n3, _ = _of_corner(out - table[h], absolute(c) - table[h + 1], a * 0.0 - ENDLESS)
        n1, n2, n3 = u1 * outward, u2 * outward, n3 * _sign(c)
    return (
        far, (n1 * table[A] + n2 * table[A + 1]) + n3 * table[A + 2],
        (n1 * table[A + 3] + n2 * table[A + 4]) + n3 * table[A + 5],
        (n1 * table[A + 6] + n2 * table[A + 7]) + n3 * table[A + 8],
    )  # fmt: skip


@kernel
def distance(table, s, x, y, z):
    """Return the signed distance (m), negative inside, of the point (x, y, z) from shape s of a table.

    x, y, z: coordinates of the point (m, inertial axes), which may be lanes. table: one `OBSTACLE` per shape.
    """
    return distance_and_normal(table, s, x, y, z)[0]
