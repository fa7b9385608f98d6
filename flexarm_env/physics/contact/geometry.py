"""Distance of a point from an obstacle and the outward normal of its nearest surface, for kernels."""

from __future__ import annotations

from ...compiler import absolute, kernel, maximum, select_lt, square_root
from ..obstacles import BOX, CYLINDER, OBSTACLE, SPHERE

O = OBSTACLE.places
_TINY = 1e-150
"""Smallest length (m) by which a vector is divided. A shorter vector gets the direction of the first axis."""


@kernel
def _unit(a, b, c):
    """Return the length of the vector (a, b, c) and its direction; (1, 0, 0) where the length is 0."""
    length = square_root((a * a + b * b) + c * c)
    share = 1.0 / maximum(length, _TINY)
    return length, select_lt(_TINY, length, a * share, 1.0), b * share, c * share


@kernel
def _sign(x):
    """Return -1 where x < 0, otherwise 1."""
    return select_lt(x, 0.0, -1.0, 1.0)


@kernel
def _of_corner(a, b, c):
    """Return signed distance (m) from a corner and its gradient; a, b, c: distances beyond its three faces, m.

    Outside: from the nearest face, edge or corner. Inside (all negative): from the nearest face.
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

    Point in m, inertial axes; table: one `OBSTACLE` per shape. The gradient is in inertial axes.
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
        far, outward, n3, _ = _of_corner(out - table[h], absolute(c) - table[h + 1], a * 0.0 - 1e300)
        n1, n2, n3 = u1 * outward, u2 * outward, n3 * _sign(c)
    return (
        far, (n1 * table[A] + n2 * table[A + 1]) + n3 * table[A + 2],
        (n1 * table[A + 3] + n2 * table[A + 4]) + n3 * table[A + 5],
        (n1 * table[A + 6] + n2 * table[A + 7]) + n3 * table[A + 8],
    )  # fmt: skip
