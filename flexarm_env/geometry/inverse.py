"""Inverse kinematics: joint angles at which the rigid arm's tip is at a point.

For planar arms `goal_of` computes the angles: analytically for two links, and for more links by solving two equations.
In space `approach` and `angles_at` compute the angles by damped least squares.
"""

import itertools
import math
from collections.abc import Callable, Sequence

import numpy as np

from ..parameters import Arm
from ..rigid import axis_of, jacobian, mount_of, tip_at, weight_and_inertia
from ..tasks.angles import least_angles, sooner_angles
from ..tasks.space_angles import JOINT, follow_point, seek_point
from ..validation import Array

MOST_FOLLOWED, LOST = 500, 1e-3
"""Largest number of path points that are followed; distance, divided by the arm's length, of a lost path."""


def limits_of(arm: Arm) -> Array:
    """Return the lower and upper limit of each joint, (N, 2) rad; infinite for joints without limits."""
    return np.array([(-np.inf, np.inf) if r is None else r for r in arm.joint_limits or (None,) * arm.n_links], float)


# -------------------------------------------------------------------------- in the plane
def goal_of(lengths: Array, rates: Array, limits: Array, x: float, y: float, angles: Array) -> Array:
    """Return joint angles (N,), rad, at which the tip of an arm with straight links is at (x, y), m, from its root.

    The function returns the solution that is the goal in the environments: with two links the solution that the joints
    reach first, with more links the solution with the least sum of squared angles (`tasks.angles`). If the point is out
    of reach, the tip is on the line to the point. x, y: in inertial axes. lengths (N,): lengths of the links, m. rates
    (N,): joint rates; the time in which a joint turns by an angle is proportional to sqrt(|angle|) / rate. limits
    (2 N,): lower and upper limit of each joint, rad. angles (N,): present joint angles, rad.
    """
    goal: Array = angles.copy()
    if len(lengths) == 2:
        sooner_angles(lengths, rates, limits, float(x), float(y), goal)
    else:
        least_angles(lengths, limits, float(x), float(y), goal)
    return goal


def goal_angles(arm: Arm, angles: Array, target: Array, rates: Array) -> Array:
    """Compute joint angles (n, N), rad, at which the rigid arm's tip is at the target.

    The solution is that of `goal_of`, with the hub angle nearest to the present one. The angles satisfy the joint
    limits, and elbow angles are within +-pi.

    Args:
        angles (n, N): present joint angles, rad. target (n, 2): target of the tip, m, in hub axes at these angles.
        rates (n, N): joint rates, as in `goal_of`; they are used only for two links.
    """
    lengths, limits = np.array([link.span for link in arm.links]), limits_of(arm).ravel()
    # target from hub axes to inertial axes
    hub = angles[:, 0]
    x = np.cos(hub) * target[:, 0] - np.sin(hub) * target[:, 1]
    y = np.sin(hub) * target[:, 0] + np.cos(hub) * target[:, 1]
    return np.array([goal_of(lengths, rates[i], limits, x[i], y[i], angles[i]) for i in range(len(angles))])


# ------------------------------------------------------------------------------ in space
def approach(arm: Arm, angles: Array, points: Array, steps: int = 60) -> Array:
    """Return joint angles (..., N), rad, at which the rigid arm's tip is nearest to points, by damped least squares.

    angles: initial guess of the joint angles, rad. points (..., 3): target positions, m, inertial axes. steps: number
    of iterations. Joint limits are enforced by clipping.
    """
    limits = limits_of(arm)
    for _ in range(steps):
        J, off = jacobian(arm, angles), points - tip_at(arm, angles)
        # damping proportional to the remaining distance; steps of at most 0.5 rad
        damping = 1e-3 * arm.total_length * np.linalg.norm(off, axis=-1)[..., None, None] + 1e-15
        step = _damped_step(J, off[..., None], damping)
        size = np.abs(step).max(axis=(-1, -2))[..., None]
        angles = np.clip(angles + step[..., 0] * np.minimum(1.0, 0.5 / np.maximum(size, 1e-12)), *limits.T)
    return angles


def _damped_step(J: Array, off: Array, damping: Array) -> Array:
    """Return the damped least-squares step J' (J J' + damping I)^-1 off, (..., N, 1), for Jacobians J (..., 3, N).

    With fewer than three joints J J' is singular. For fewer than three joints the function uses the equivalent form (J'
    J + damping I)^-1 J' off.
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
    """Return the rigid tip's distance from points (..., 3), m, divided by the arm's length."""
    return np.asarray(np.linalg.norm(tip_at(arm, angles) - points, axis=-1) / arm.total_length)


def beyond_reach(arm: Arm, points: Array) -> int | None:
    """Return the index of the first of n points (n, 3), m, that is not finite or out of reach; None without one."""
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
    """Return the index of the first point of a path (n, 3), m, that the rigid arm cannot reach; None if there is none.

    The joints follow the path from the angles `start` (N,), rad, within their limits. seek, follow: uncompiled
    functions of `INVERSE`.
    """
    limits = limits_of(arm)
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
    """Return joint angles (N,), rad, within limits, at which the rigid arm's tip is at `point` (3,), m; or None.

    The search starts from many postures and returns the solution with the least sum of squared angles. Its tip is
    within 1e-9 arm lengths of the point. The result is None if no solution is found. gravity (3,): gravitational
    acceleration, m/s^2, inertial axes; solutions that the motors can hold against gravity are preferred.
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
        needed = np.abs(weight_and_inertia(arm, np.array(gravity), turned)[0])
        held = (needed <= np.array(arm.torque_limits)).all(axis=1)
        squares = np.where(held | (not held.any()), squares, np.inf)
    best: Array = turned[np.argmin(squares)]
    return best
