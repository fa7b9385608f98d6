"""Rigid arms in space: forward and inverse kinematics, weight and inertia."""

import itertools
import math
from collections.abc import Callable, Sequence

import numpy as np

from ..bodies import tensor
from ..parameters import Arm, Link
from ..physics.space.build import Body, X, axis_of, far_body, mount_of, near_body, tip_end, tip_lever
from ..physics.space.reading import frames
from ..tasks.space_angles import JOINT, follow_point, seek_point
from ..validation import Array

MOST_FOLLOWED, LOST = 500, 1e-3
"""Largest number of path points that are followed; distance, divided by the arm's length, of a lost path."""


def tip_at(arm: Arm, angles: Array) -> Array:
    """Return the rigid arm's tip position (..., 3), m, inertial axes, at joint angles (..., N), rad."""
    return frames(arm, angles)[3]


def jacobian(arm: Arm, angles: Array) -> Array:
    """Return the position Jacobian (..., 3, N), m/rad, of the rigid arm's tip, with the columns e_k x (tip - p_k).

    angles (..., N): joint angles, rad. In inertial axes, e_k is the axis of joint k and p_k its position, m.
    """
    places, axes, _, tip = frames(arm, angles)
    return np.swapaxes(np.cross(axes, tip[..., None, :] - places), -1, -2)


def approach(arm: Arm, angles: Array, points: Array) -> Array:
    """Return joint angles (..., N), rad, that bring the rigid tip nearest to points, by damped least squares.

    angles: initial guess of the joint angles, rad. points (..., 3): target positions, m, inertial axes. Joint limits
    are enforced by clipping.
    """
    limits = np.array([(-np.inf, np.inf) if r is None else r for r in arm.joint_limits or (None,) * arm.n_links])
    for _ in range(60):
        J, off = jacobian(arm, angles), points - tip_at(arm, angles)
        # damping proportional to the remaining distance; steps of at most 0.5 rad
        damping = 1e-3 * arm.total_length * np.linalg.norm(off, axis=-1)[..., None, None] + 1e-15
        step = _damped_step(J, off[..., None], damping)
        size = np.abs(step).max(axis=(-1, -2))[..., None]
        angles = np.clip(angles + step[..., 0] * np.minimum(1.0, 0.5 / np.maximum(size, 1e-12)), *limits.T)
    return angles


def _damped_step(J: Array, off: Array, damping: Array) -> Array:
    """Return the damped least-squares step J' (J J' + damping I)^-1 off, (..., N, 1), for Jacobians J (..., 3, N).

    With fewer than three joints J J' is singular. The equivalent form (J' J + damping I)^-1 J' off is then used.
    """
    across = np.swapaxes(J, -1, -2)
    if J.shape[-1] < 3:
        floor = 1e-12 * np.square(J).sum(axis=(-1, -2), keepdims=True)  # where joints turn the tip alike
        return np.asarray(np.linalg.solve(across @ J + (damping + floor) * np.eye(J.shape[-1]), across @ off))
    return np.asarray(across @ np.linalg.solve(J @ across + damping * np.eye(3), off))


def chain_of(arm: Arm) -> Array:
    """Return mount, axis and span of all joints in one array for kernels, one `tasks.space_angles.JOINT` per joint."""
    rows = [
        JOINT.pack({}, mount=mount_of(arm, k).ravel(), axis=axis_of(arm, k), span=link.span)
        for k, link in enumerate(arm.links)
    ]
    return np.concatenate(rows)


def _bent(arm: Arm) -> Array:
    """Return initial postures (n, N), rad, for the inverse kinematics."""
    grid = itertools.product(*[(-2.4, -0.8, 0.8, 2.4)] * min(arm.n_links, 4))
    return np.array([(*row, *(0.3,) * (arm.n_links - len(row))) for row in grid])


def _off(arm: Arm, angles: Array, points: Array) -> Array:
    """Return the tip's distance from points (..., 3), divided by the arm's length."""
    return np.asarray(np.linalg.norm(tip_at(arm, angles) - points, axis=-1) / arm.total_length)


def beyond_reach(arm: Arm, points: Array) -> int | None:
    """Return the index of the first of n points (n, 3) that is not finite or out of the rigid tip's reach, or None."""
    lost = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if lost.size:
        return int(lost[0])
    starts, found = _bent(arm), np.zeros((0, arm.n_links))
    left = np.arange(len(points))
    while len(left):
        # warm start all remaining points from the last solution
        if len(found):  # from what the last point was reached by
            angles = approach(arm, np.broadcast_to(found[-1], (len(left), arm.n_links)), points[left])
            left = left[_off(arm, angles, points[left]) > 1e-9]
        if not len(left):
            break
        # otherwise try all start postures for the next point
        point = points[left[0]]
        angles = approach(arm, starts, np.broadcast_to(point, (len(starts), 3)))
        best = np.argmin(_off(arm, angles, point))
        if _off(arm, angles[best], point) > 1e-9:
            return int(left[0])
        found, left = angles[best : best + 1], left[1:]
    return None


INVERSE = seek_point, follow_point
"""Kernels for `lost_at`: one moves joint angles to any point, the other to a point that has moved a little."""


def lost_at(
    arm: Arm, start: Array, points: Array, seek: Callable[..., None], follow: Callable[..., None]
) -> int | None:
    """Return the index of the first point of a path (n, 3), m, that the rigid tip cannot reach; None if there is none.

    The joints move from angles `start` (N,), rad, within their limits, like the goal posture of a moving target. seek,
    follow: functions of `INVERSE`, without compilation.
    """
    limits = np.array([(-np.inf, np.inf) if r is None else r for r in arm.joint_limits or (None,) * arm.n_links])
    known = chain_of(arm), (0,) * arm.n_links, arm.total_length, limits.ravel()
    angles = np.array(start, np.float64)
    seek(*known, tuple(points[0].tolist()), angles)
    stride = max(1, len(points) // MOST_FOLLOWED)  # instants left out of long paths have their iterations all the same
    for k in range(0, len(points), stride):
        for _ in range(stride):
            follow(*known, tuple(points[k].tolist()), angles)
        if _off(arm, angles, points[k]) > LOST:
            return k
    return None


def angles_at(arm: Arm, point: Array, gravity: Sequence[float] | None = None) -> Array | None:
    """Return joint angles (N,), rad, within limits, with the rigid tip at point (3,), m; None if no solution is found.

    The distance of the tip from the point is at most 1e-9 of the arm's length. The search has many initial postures and
    returns the solution with the least sum of squares. gravity (3,): gravitational acceleration, m/s^2, inertial axes.
    Solutions that the torque limits can hold against gravity are preferred.
    """
    starts = _bent(arm)
    found = approach(arm, starts, np.broadcast_to(point, (len(starts), 3)))
    found = found[_off(arm, found, point) < 1e-9]
    if not len(found):
        return None
    # joints without limits are wrapped to [-pi, pi)
    limits = [math.inf if r is None else 0.0 for r in arm.joint_limits or (None,) * arm.n_links]
    turned = np.where(np.isinf(limits), (found + np.pi) % (2.0 * np.pi) - np.pi, found)
    squares = (turned**2).sum(axis=1)
    if gravity is not None and arm.torque_limits is not None:
        held = (np.abs(holding(arm, np.array(gravity), turned)[0]) <= np.array(arm.torque_limits)).all(axis=1)
        squares = np.where(held | (not held.any()), squares, np.inf)
    best: Array = turned[np.argmin(squares)]
    return best


def lumps(arm: Arm) -> list[tuple[int, Body]]:
    """Return the rigid arm's bodies: (index of the link whose joint moves the body, `Body` in the link's root axes)."""
    found = []
    for k, link in enumerate(arm.links):
        # bodies at the link's root: the joint's far body, and the flexible part
        far, parts = far_body(arm, k), []
        root = (0.0 if link.rigid else link.root_offset) * X
        parts.append(Body(far.mass, far.centre + root, far.inertia))
        if not link.rigid and link.mass:
            parts.append(_beam(link, root))
        # at the last section: the next joint's near body, or the link's tip piece
        tip = link.span * X - tip_lever(link)  # where its last section is
        near = near_body(arm, k + 1) if k + 1 < arm.n_links else tip_end(link)
        parts.append(Body(near.mass, tip + near.centre, near.inertia))
        found += [(k, part) for part in parts]
    held = arm.payload
    at = arm.links[-1].span * X + np.array((*held.offset, 0.0)[:3])
    found.append((arm.n_links - 1, Body(held.mass, at, tensor(held.inertia))))
    return [(k, part) for k, part in found if part.mass > 0.0 or part.inertia.any()]


def _beam(link: Link, root: Array) -> Body:
    """Return a straight beam as a rigid body: mass, center and inertia in the link's axes; root: its start, m."""
    s, weights = link.quadrature()
    # center of mass, and second moments of mass about it
    middle = link.moment(1) / link.mass
    swing, flat, across = link.moment(2) - middle * link.moment(1), link.rotary, float(weights @ link.across(s)["J_y"])
    return Body(link.mass, root + middle * X, np.diag([flat + across, swing + across, swing + flat]))


def _cross(a: Array, b: Array) -> Array:
    """Return the cross product of vectors (..., 3), without the call overhead of `numpy.cross`."""
    (ax, ay, az), (bx, by, bz) = np.moveaxis(a, -1, 0), np.moveaxis(b, -1, 0)
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], -1)


def holding(
    arm: Arm, gravity: Array, angles: Array, parts: list[tuple[int, Body]] | None = None
) -> tuple[Array, Array]:
    """Compute gravity torques (n, N), N m, and joint inertia (n, N, N), kg m^2, of the rigid arm with its rotors.

    gravity (3,): gravitational acceleration, m/s^2. angles (n, N): joint angles, rad. parts: result of `lumps(arm)`, or
        None to compute it.
    """
    places, axes, links, _ = frames(arm, angles)
    torques, inertia = np.zeros(angles.shape), np.zeros((*angles.shape, arm.n_links))
    inertia += np.diag([arm.joint(k).rotor for k in range(arm.n_links)])
    for k, part in lumps(arm) if parts is None else parts:
        moved = slice(k + 1)
        # e_j x (center - p_j), velocity of the center by joint rate; joint axes in link axes
        swing = _cross(axes[:, moved], (places[:, k] + links[:, k] @ part.centre)[:, None] - places[:, moved])
        own = axes[:, moved] @ links[:, k]
        # holding torque -m (e x r) . g; inertia m s s' + e' J e
        torques[:, moved] -= part.mass * swing @ gravity
        inertia[:, moved, moved] += part.mass * swing @ np.swapaxes(swing, 1, 2)
        inertia[:, moved, moved] += own @ part.inertia @ np.swapaxes(own, 1, 2)
    return torques, inertia
