"""Outlines of planar shapes, and flat faces of shapes in space, for drawing."""

from itertools import pairwise

import numpy as np

from ..shapes import Box, Cylinder, HalfSpace, Shape, Sphere
from ..validation import Array


def _circle(count: int) -> Array:
    angle = 2.0 * np.pi * np.arange(count) / count
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def outline_of(shape: Shape, center: Array, far: float) -> Array:
    """Return the corners (n, 2), m, of a planar shape.

    The outline of a half-space extends to the distance `far`, m, from its surface point that is nearest to `center`.
    """
    place = np.array(shape.place)
    if isinstance(shape, HalfSpace):
        normal = np.array(shape.normal)
        foot, along = center - shape.distance(center) * normal, far * np.array([-normal[1], normal[0]])
        return np.array([foot - along, foot + along, foot + along - far * normal, foot - along - far * normal])
    local = shape.sizes[0] * _circle(60) if isinstance(shape, Sphere) else np.array(shape.sizes) * _SQUARE
    return np.asarray(place + local @ shape.axes.T)


_SQUARE = np.array([(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)])
_CUBE = [
    np.insert(_SQUARE[:: 1 if way > 0 else -1], axis, way, axis=1)[:: -1 if axis == 1 else 1]
    for axis in range(3)
    for way in (1.0, -1.0)
]
"""Corners of each face of the cube, anticlockwise seen from outside."""


def faces_of(shape: Shape, center: Array, far: float) -> list[Array]:
    """Return the faces of a shape in space, each with its corners (n, 3), m, counterclockwise seen from outside.

    A half-space is represented by a square with sides of 2 `far`, m, about its surface point nearest to `center`. The
    corners of this square are counterclockwise seen from inside the half-space.
    """
    place, axes = np.array(shape.place), shape.axes
    if isinstance(shape, HalfSpace):
        normal = np.array(shape.normal)
        first = np.cross(np.eye(3)[np.argmin(np.abs(normal))], normal)
        first /= np.linalg.norm(first)
        foot, across = center - shape.distance(center) * normal, np.stack([np.cross(normal, first), first])
        return [foot + far * _SQUARE @ across]
    if isinstance(shape, Box):
        local = [face * np.array(shape.sizes) for face in _CUBE]
    elif isinstance(shape, Cylinder):
        (radius, half), rim = shape.sizes, _circle(24)
        ends = [np.column_stack([radius * rim, np.full(24, way * half)]) for way in (-1.0, 1.0)]
        local = _between(ends[0], ends[1]) + [ends[0][::-1], ends[1]]
    else:
        height, rim = np.pi * (np.arange(9) / 8.0 - 0.5), _circle(16)
        rings = [shape.sizes[0] * np.column_stack([np.cos(h) * rim, np.full(16, np.sin(h))]) for h in height]
        local = [face for low, high in pairwise(rings) for face in _between(low, high)]
    return [place + face @ axes.T for face in local]


def _between(low: Array, high: Array) -> list[Array]:
    after, above = np.roll(low, -1, axis=0), np.roll(high, -1, axis=0)
    return [np.stack(corners) for corners in zip(low, after, above, high, strict=True)]
