"""Rigid kinematics of arms in space: where the tip is, how it moves with the joints, and joint angles for a point."""

from __future__ import annotations

import itertools
import math

import numpy as np
from numpy.typing import NDArray

from ..parameters import Arm
from ..physics.space.reading import frames

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


def angles_at(arm: Arm, point: Array) -> Array | None:
    """Joint angles (N,) of least sum of squares, of those found from many starts, that bring the rigid arm's tip to a
    point (3,), m, within 1e-9 of its length; None: none are found."""
    grid = itertools.product(*[(-2.4, -0.8, 0.8, 2.4)] * min(arm.n_links, 4))
    starts = np.array([(*row, *(0.3,) * (arm.n_links - len(row))) for row in grid])
    found = approach(arm, starts, np.broadcast_to(point, (len(starts), 3)))
    near = np.linalg.norm(tip_at(arm, found) - point, axis=1) < 1e-9 * arm.total_length
    found = found[near]
    if not len(found):
        return None
    limits = [math.inf if r is None else 0.0 for r in arm.joint_limits or (None,) * arm.n_links]
    turned = np.where(np.isinf(limits), (found + np.pi) % (2.0 * np.pi) - np.pi, found)
    best: Array = turned[np.argmin((turned**2).sum(axis=1))]
    return best
