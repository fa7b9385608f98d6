"""How far an arm is from the shapes that it is to stay out of: of its points the nearest."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..compiler import apart, kernel, load, maximum, size, splat, stack, uncompiled
from ..physics.obstacles import OBSTACLE, KeepOut, distance
from ..physics.protocol import shape
from ..tasks.program import FURTHER
from ..tasks.task import info_of, put_info

Array = NDArray[np.float64]

_ONE = (0,)

SPACING = 1.0 / 16.0
"""Of the points that count along an arm, over its length, at most."""


def with_room(given: KeepOut | None, model: Any, q: Array, room: Array, groups: int, length: float) -> KeepOut | None:
    """With room for the points of an arm of each group: as many as a state has in `room`, (many, 2 or 3); length: of
    the arm, m."""
    if given is None:
        return None
    count = int(uncompiled(shape)(model, q, room))
    gaps = np.linalg.norm(np.diff(room[:count], axis=0), axis=1)
    parts = np.ones(count, np.int64)
    if given.tip is None:  # along rigid ends, for one, nothing is drawn
        parts[1:] = np.maximum(1, np.ceil(gaps / (SPACING * length) - 1e-9))
    return given._replace(rows=(0,) * len(q), points=np.zeros((groups, count, room.shape[1])), parts=parts)


@apart
def clearance(keep_out, model, g, lanes, i, q):
    """Of arm i of group g: signed distance, m, of the nearest of its points from the nearest shape. The root, which is
    held, does not count."""
    mine, points = stack(_ONE, keep_out.rows), keep_out.points[g]
    for k in range(size(model.n)):
        mine[k] = q[k * lanes + i]
    count = shape(model, mine, points)
    least, first = math.inf, 1
    if keep_out.tip is not None:
        first = count - 1
    for j in range(first, count):
        x, y, z = points[j, 0], points[j, 1], 0.0
        dx, dy, dz = x - points[j - 1, 0], y - points[j - 1, 1], 0.0
        if points.shape[1] > 2:
            z = points[j, 2]
            dz = z - points[j - 1, 2]
        for part in range(keep_out.parts[j]):
            back = part / keep_out.parts[j]
            for s in range(keep_out.shapes.shape[0] // OBSTACLE.places.end):
                least = min(least, distance(keep_out.shapes, s, x - dx * back, y - dy * back, z - dz * back))
    return least


@kernel
def record_clearance(lane, p, g, q, live, info):
    """That of the arms of group g into info, where `live` > 1/2."""
    if p.keep_out is not None:
        found = stack(lane, _ONE)
        for i in range(len(lane)):
            found[i] = clearance(p.keep_out, p.model, g, len(lane), i, q)
        at, far = info_of(p.task).further, load(lane, found, 0)
        put_info(lane, live, info, at + FURTHER.clearance, far)
        put_info(lane, live, info, at + FURTHER.penetration, maximum(-far, splat(lane, 0.0)))
