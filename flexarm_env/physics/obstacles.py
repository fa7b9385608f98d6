"""What `shapes` describes, for kernels: signed distances."""

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
    Field("kind", (), "", "which of `shapes.SHAPES`"),
    Field("place", (3,), "m", ""),
    Field("axes", (3, 3), "", "its own, as columns; of a half-space the first is its normal"),
    Field("sizes", (3,), "m", "radius; radius and half length; halves of a box's sides"),
)  # fmt: skip
O = OBSTACLE.places
HALF_SPACE, SPHERE, BOX, CYLINDER = range(4)

ENDLESS = 1e300
"""Half of what a shape of the plane measures along z, m."""


class KeepOut(NamedTuple):
    """Shapes that an arm is to stay out of."""

    shapes: np.ndarray  # an `OBSTACLE` each
    margin: float  # m: what is nearer costs
    tip: tuple[int, ...] | None  # a tag where only the tip is looked at, and not all of the arm
    rows: tuple[int, ...] = ()  # a zero for each row of the state
    points: np.ndarray = np.zeros((0, 0, 2))  # (groups, P, 2 or 3) m: room for points along an arm
    parts: np.ndarray = np.zeros(0, np.int64)  # (P,): in how many of them the way from the point before is looked at


def packed(shapes: Sequence[Shape]) -> Array:
    """An `OBSTACLE` each; those of the plane stand in z = 0."""
    rows = []
    for shape in shapes:
        d, kind = shape.dimension, SHAPES.index(type(shape))
        axes, place, sizes = np.eye(3), np.zeros(3), np.full(3, ENDLESS)
        axes[:d, :d], place[:d], sizes[: len(shape.sizes)] = shape.axes, shape.place, shape.sizes
        if kind == HALF_SPACE:
            axes[:, 0] = 0.0
            axes[:d, 0] = shape.normal  # type: ignore[attr-defined]
        rows.append(OBSTACLE.pack({}, kind=kind, place=place, axes=axes, sizes=sizes))
    return np.concatenate(rows)


@kernel
def _corner(a, b, c):
    """Distance from a corner whose sides are coordinates, all below 0 inside."""
    zero = a * 0.0
    x, y, z = maximum(a, zero), maximum(b, zero), maximum(c, zero)
    inside = maximum(maximum(a, b), c)
    return square_root((x * x + y * y) + z * z) + select_lt(inside, 0.0, inside, zero)


@kernel
def distance(table, s, x, y, z):
    """Signed distance of a point from shape s of a table of `OBSTACLE`; lanes as the point's."""
    o = O.end * s
    kind, p, A, h = table[o + O.kind], o + O.place, o + O.axes, o + O.sizes
    dx, dy, dz = x - table[p], y - table[p + 1], z - table[p + 2]
    a = (dx * table[A] + dy * table[A + 3]) + dz * table[A + 6]
    b = (dx * table[A + 1] + dy * table[A + 4]) + dz * table[A + 7]
    c = (dx * table[A + 2] + dy * table[A + 5]) + dz * table[A + 8]
    far = a
    if kind == SPHERE:
        far = square_root((a * a + b * b) + c * c) - table[h]
    elif kind == BOX:
        far = _corner(absolute(a) - table[h], absolute(b) - table[h + 1], absolute(c) - table[h + 2])
    elif kind == CYLINDER:
        out = square_root(a * a + b * b)
        far = _corner(out - table[h], absolute(c) - table[h + 1], x * 0.0 - ENDLESS)
    return far
