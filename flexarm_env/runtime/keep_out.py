"""Clearance of an arm from keep-out shapes: the smallest distance between points of the arm and the shapes."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..compiler import SINGLE, kernel, maximum, noinline, size, stack, store_lane, uncompiled
from ..physics.obstacles import OBSTACLE, KeepOut, distance
from ..physics.protocol import centerline
from ..tasks.program import FURTHER
from ..tasks.task import info_of, put_info

Array = NDArray[np.float64]

_ONE = (0,)

SPACING = 1.0 / 16.0
"""Largest distance between neighboring points that are checked along an arm, divided by the arm's length."""


def with_room(given: KeepOut | None, model: Any, q: Array, room: Array, groups: int, length: float) -> KeepOut | None:
    """Return the `KeepOut` record with memory for centerline points and with the number of parts of each interval.

    given: a `KeepOut` record; for None the result is None. q: coordinates of the model in some state. room (many, 2
    or 3): scratch memory for the points, m. groups: number of groups of the batch. length: length of the arm, m.
    Intervals between centerline points are subdivided to at most SPACING times the length.
    """
    if given is None:
        return None
    count = int(uncompiled(centerline)(SINGLE, model, q, room))
    gaps = np.linalg.norm(np.diff(room[:count], axis=0), axis=1)
    parts = np.ones(count, np.int64)
    # between joint and beam a rigid end has no centerline points
    if given.tip is None:
        parts[1:] = np.maximum(1, np.ceil(gaps / (SPACING * length) - 1e-9))
    return given._replace(rows=(0,) * len(q), points=np.zeros((groups, count, room.shape[1])), parts=parts)


@noinline
def clearance(keep_out, model, g, lanes, i, q):
    """Return the signed distance (m) of arm i of group g from the nearest shape; negative within a shape.

    Points along the centerline (inertial axes) are checked, or only the tip if keep_out.tip is not None. The root does
    not move and is not checked. q (n, lanes): coordinates (m, rad) of the group's arms. keep_out.parts: number of parts
    into which each interval between centerline points is divided. keep_out.rows: one zero for each of the n
    coordinates. keep_out.points: scratch memory for the points.
    """
    mine, points = stack(_ONE, keep_out.rows), keep_out.points[g]
    # q of this arm alone, because the clearance is computed arm by arm
    for k in range(size(model.n)):
        mine[k] = q[k * lanes + i]
    count = centerline(_ONE, model, mine, points)
    least, first = math.inf, 1
    if keep_out.tip is not None:
        first = count - 1
    for j in range(first, count):
        x, y, z = points[j, 0], points[j, 1], 0.0
        dx, dy, dz = x - points[j - 1, 0], y - points[j - 1, 1], 0.0
        if points.shape[1] > 2:
            z = points[j, 2]
            dz = z - points[j - 1, 2]
        # points between j and j - 1, at most SPACING L apart, so that no shape slips between two
        for part in range(keep_out.parts[j]):
            back = part / keep_out.parts[j]
            for s in range(keep_out.shapes.shape[0] // OBSTACLE.places.end):
                least = min(least, distance(keep_out.shapes, s, x - dx * back, y - dy * back, z - dz * back))
    return least


@kernel
def record_clearance(lane, p, g, q, live, info):
    """Write clearance and penetration (m) of the arms of group g into info for running arms (live > 1/2).

    Clearance is the signed distance of the arm from the nearest keep-out shape, penetration max(-clearance, 0). q (n,
    lanes): coordinates (m, rad). Without keep-out shapes (p.keep_out is None) the kernel does nothing.
    """
    if p.keep_out is not None:
        found = stack(lane, _ONE)
        for i in range(len(lane)):
            store_lane(lane, found, 0, i, clearance(p.keep_out, p.model, g, len(lane), i, q))
        at, far = info_of(p.task).further, found[0]
        put_info(lane, live, info, at + FURTHER.clearance, far)
        put_info(lane, live, info, at + FURTHER.penetration, maximum(-far, 0.0))
