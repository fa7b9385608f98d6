"""Rigid kinematics of arms in space: where the tip is, how it moves with the joints, and joint angles for a point."""

from __future__ import annotations

import itertools
import math

import numpy as np
from numpy.typing import NDArray

from ..parameters import Arm
from ..physics.space.build import axis_of, mount_of
from ..physics.space.reading import frames
from ..tasks.space_angles import JOINT

Array = NDArray[np.float64]


def tip_at(arm: Arm, angles: Array) -> Array:
    """Where the rigid arm's tip is, (..., 3) m, at joint angles (..., N)."""
    return frames(arm, angles)[3]


def jacobian(arm: Arm, angles: Array) -> Array:
    """(..., 3, N), m: what the tip moves by with the angles."""
    places, axes, _, tip = frames(arm, angles)
    return np.swapaxes(np.cross(axes, tip[..., None, :] - places), -1, -2)


def approach(arm: Arm, angles: Array, points: Array, steps: int = 60) -> Array:
    """Angles (..., N) nearby at which the tip is nearest to points (..., 3): damped least squares, within limits."""
    limits = np.array([(-np.inf, np.inf) if r is None else r for r in arm.joint_limits or (None,) * arm.n_links])
    for _ in range(steps):
        J, off = jacobian(arm, angles), points - tip_at(arm, angles)
        damping = 1e-3 * arm.total_length * np.linalg.norm(off, axis=-1)[..., None, None] + 1e-15
        step = np.swapaxes(J, -1, -2) @ np.linalg.solve(
            J @ np.swapaxes(J, -1, -2) + damping * np.eye(3), off[..., None]
        )
        size = np.abs(step).max(axis=(-1, -2))[..., None]
        angles = np.clip(angles + step[..., 0] * np.minimum(1.0, 0.5 / np.maximum(size, 1e-12)), *limits.T)
    return angles


def chain_of(arm: Arm) -> Array:
    """What kinematics know of an arm (`tasks.space_angles.JOINT`), a joint after the other."""
    rows = [
        JOINT.pack({}, mount=mount_of(arm, k).ravel(), axis=axis_of(arm, k), span=link.span)
        for k, link in enumerate(arm.links)
    ]
    return np.concatenate(rows)


def _bent(arm: Arm) -> Array:
    """Postures (n, N) from which angles are looked for."""
    grid = itertools.product(*[(-2.4, -0.8, 0.8, 2.4)] * min(arm.n_links, 4))
    return np.array([(*row, *(0.3,) * (arm.n_links - len(row))) for row in grid])


def _off(arm: Arm, angles: Array, points: Array) -> Array:
    """Distance of the tip from points, over the arm's length."""
    return np.asarray(np.linalg.norm(tip_at(arm, angles) - points, axis=-1) / arm.total_length)


def beyond_reach(arm: Arm, points: Array) -> int | None:
    """The first of points (n, 3) that is not finite, or to which no joint angles are found; None: all are reached."""
    lost = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if lost.size:
        return int(lost[0])
    starts, found = _bent(arm), np.zeros((0, arm.n_links))
    left = np.arange(len(points))
    while len(left):
        if len(found):  # from what the last point was reached by
            angles = approach(arm, np.broadcast_to(found[-1], (len(left), arm.n_links)), points[left])
            left = left[_off(arm, angles, points[left]) > 1e-9]
        if not len(left):
            break
        point = points[left[0]]
        angles = approach(arm, starts, np.broadcast_to(point, (len(starts), 3)))
        best = np.argmin(_off(arm, angles, point))
        if _off(arm, angles[best], point) > 1e-9:
            return int(left[0])
        found, left = angles[best : best + 1], left[1:]
    return None


def angles_at(arm: Arm, point: Array) -> Array | None:
    """Joint angles (N,) of least sum of squares, of those found from many starts, that bring the rigid arm's tip to a
    point (3,), m, within 1e-9 of its length; None: none are found."""
    starts = _bent(arm)
    found = approach(arm, starts, np.broadcast_to(point, (len(starts), 3)))
    found = found[_off(arm, found, point) < 1e-9]
    if not len(found):
        return None
    limits = [math.inf if r is None else 0.0 for r in arm.joint_limits or (None,) * arm.n_links]
    turned = np.where(np.isinf(limits), (found + np.pi) % (2.0 * np.pi) - np.pi, found)
    best: Array = turned[np.argmin((turned**2).sum(axis=1))]
    return best
