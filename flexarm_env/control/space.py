"""Arms in space for controllers: rigid kinematics, weight, inertia, inverse kinematics, and the flexible arm's rest."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..bodies import tensor
from ..parameters import Arm, Link
from ..physics.gauges import Spot
from ..physics.space.build import Body, X, axis_of, far_body, mount_of, near_body, tip_end, tip_lever
from ..physics.space.reading import frames, tips
from ..scene import Scene
from ..tasks.space_angles import JOINT, follow_point, seek_point
from ..validation import Array
from .base import Controller, Setup, Signals

if TYPE_CHECKING:
    from ..linear import Equilibrium, LinearModel

NEAR, MOST = 5e-4, 12
"""Accepted distance of the resting tip from its target, divided by the arm's length; largest number of rests computed
from one initial posture."""

MOST_RESTS = 1000
"""Largest number of rests that a controller stores, for episodes that begin again from the same seeds."""

MOST_FOLLOWED, LOST = 500, 1e-3
"""Number of instants at which a path is followed; distance at which it counts as lost, divided by the arm's length."""

BENT = 0.8
"""Joint angle, rad, of the bent postures from which goals are searched."""


def tip_at(arm: Arm, angles: Array) -> Array:
    """Return the rigid arm's tip position (..., 3), m, inertial axes, at joint angles (..., N), rad."""
    return frames(arm, angles)[3]


def jacobian(arm: Arm, angles: Array) -> Array:
    """Return the position Jacobian (..., 3, N), m/rad, of the rigid tip: columns e_k x (tip - p_k).

    angles (..., N): joint angles, rad.
    """
    places, axes, _, tip = frames(arm, angles)
    return np.swapaxes(np.cross(axes, tip[..., None, :] - places), -1, -2)


def approach(arm: Arm, angles: Array, points: Array) -> Array:
    """Solve the inverse kinematics by damped least squares: joint angles (..., N), rad, with the tip nearest to points.

    angles: initial guess. points (..., 3): m, inertial axes. Joint limits are enforced by clipping.
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
    """Pack each joint's mount, axis and span for compiled kernels (`tasks.space_angles.JOINT`), one after the other."""
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
    """Return the index of the first point (n, 3) that is not finite or beyond the rigid tip's reach, or None."""
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
    """Return the index of the first point of a path (n, 3), m, that the rigid tip cannot follow; None if it can.

    The joints move from angles `start` (N,), rad, within their limits, like the goal posture of a moving target. seek,
    follow: the functions of `INVERSE`, uncompiled.
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
    """Return joint angles (N,), rad, within limits, with the rigid arm's tip at point (3,), m; None if there are none.

    The tip is within 1e-9 of the arm's length. The search has many initial postures and returns the solution with the
    least sum of squares. gravity (3,): m/s^2, inertial axes. Solutions that the torque limits can hold against gravity
    are preferred.
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

    gravity (3,): m/s^2. angles (n, N): joint angles, rad. parts: the arm's `lumps`, if known.
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


def rest(arm: Arm, gravity: Array, angles: Array) -> Equilibrium:
    """Compute the flexible arm's static equilibrium with its joints held at angles (N,), rad; gravity: m/s^2."""
    from ..linear import static_equilibrium

    where: dict[str, Any] = {"gravity": tuple(gravity.tolist()), "angles": tuple(angles.tolist())}
    scene = Scene("rest", arm, duration=1.0, dt=1e-3, **where)
    return static_equilibrium(scene, elements=2, hold_joints=True, require_stable=False)


def held_model(
    arm: Arm, gravity: Array, angles: Array, gauges: Sequence[Spot] = ()
) -> tuple[LinearModel, Array, Array]:
    """Linearize the flexible arm about its rest at joint angles (N,), rad, with free joints and without backlash.

    Returns the model, the rows (N, S) of its joint angles, and A. In A the rigid arm's weight is compensated at every
    angle.
    """
    from ..linear import linearize

    # x' = A x + B u about the rest, and rows of the joint angles
    free = linearize(rest(arm.taut, gravity, angles), gauges=list(gauges))
    joints = free.C[[free.outputs.index(f"joint{k}") for k in range(arm.n_links)]]
    # derivative of the rigid holding torques by the joint angles
    step = 1e-4 * np.eye(arm.n_links)
    ends = [holding(arm, gravity, angles + sign * step)[0] for sign in (1.0, -1.0)]
    return free, joints, free.A + free.B @ ((ends[0] - ends[1]).T / 2e-4) @ joints


class AboutRest(Controller):
    """Base of controllers in space: torques of the rest at the target, corrected by the change of the rigid weight.

    Goals are static rests of the flexible arm (`linear.static_equilibrium`); each takes a few tenths of a second.
    """

    def __init__(self, setup: Setup) -> None:
        """Store gravity and the rigid arm's bodies."""
        super().__init__(setup)
        self.gravity = np.array(setup.gravity or (0.0, 0.0, 0.0))
        self.bodies = lumps(setup.arm)
        self._rests: dict[bytes, tuple[float, Array, Array]] = {}

    def _rest(self, angles: Array) -> tuple[Array, Array]:
        """Return tip position (3,), m, and joint torques (N,), N m, of the arm at rest at joint angles (N,), rad."""
        found = rest(self.setup.arm, self.gravity, angles)
        return tips(self.setup.arm, found.settings, found.work.q[None])[0, 0], np.array(found.joint_torques())

    def _settle(self, target: Array, angles: Array) -> tuple[float, Array, Array]:
        """Find the rest whose tip is nearest to the target (3,), m, by Broyden's method from joint angles (N,).

        Returns (distance of the tip, m, joint angles, rad, torques, N m).
        """
        arm = self.setup.arm
        J, (tip, torques) = jacobian(arm, angles), self._rest(angles)
        best = np.inf, angles, torques
        for _ in range(MOST):
            off = target - tip
            size = float(np.linalg.norm(off))
            if size < best[0]:
                best = size, angles, torques
            if size < NEAR * arm.total_length:
                break
            # damped least squares, at most 0.3 rad
            step = J.T @ np.linalg.solve(J @ J.T + 1e-4 * arm.total_length**2 * np.eye(3), off)
            step *= min(1.0, 0.3 / float(np.abs(step).max()))
            after, torques = self._rest(angles + step)
            # Broyden's rank-one update of the Jacobian
            J = J + np.outer(after - tip - J @ step, step) / (step @ step)
            angles, tip = angles + step, after
        return best

    def targets(self, signals: Signals) -> Array:
        """Return the tip targets (n, 3), m, inertial axes, from the first observation; arms start nearly straight."""
        arm, now = self.setup.arm, signals.angles
        if signals.to_go is not None:
            return tip_at(arm, now + signals.to_go)
        found: Array = tip_at(arm, now) + (frames(arm, now)[2][:, 0] @ signals.error[..., None])[..., 0]
        return found

    def _goal(self, signals: Signals) -> Array:
        """Compute the joint angles (n, N), rad, of the rests at the targets, and store the torques of these rests."""
        goals, self.torque = np.zeros(signals.angles.shape), np.zeros(signals.angles.shape)
        for i, target in enumerate(self.targets(signals)):
            goals[i], self.torque[i] = self.rest_at(target, signals.angles[i])[1:]
        return goals

    def rest_at(self, target: Array, now: Array) -> tuple[float, Array, Array]:
        """Find the rest whose tip is nearest to a target (3,), m, from joint angles `now` (N,) and two bent postures.

        Returns (distance of the tip, m, joint angles (N,), rad, torques (N,), N m).
        """
        arm, N = self.setup.arm, self.setup.n_joints
        known = self._rests.get(key := target.tobytes() + now.tobytes())
        if known is not None:
            return known
        # start postures: the present one, and both bends of the elbows
        sides = [[now[0], *(BENT * side * (-1.0) ** k for k in range(N - 1))] for side in (1, -1)]
        best: tuple[float, Array, Array] | None = None
        for start in (now + 0.3, *np.array(sides)):
            found = self._settle(target, approach(arm, start, target))
            best = found if best is None or found[0] < best[0] else best
            if best[0] < NEAR * arm.total_length:
                break
        assert best is not None
        if len(self._rests) < MOST_RESTS:
            self._rests[key] = best
        return best

    def initialise(self, signals: Signals, to_go: Array) -> None:
        """Store the rigid inertia at the goal and the torque difference between flexible and rigid rest."""
        weight, self.inertia = holding(self.setup.arm, self.gravity, self.goal, self.bodies)
        self.torque = self.torque - weight

    def forward(self, to_go: Array) -> Array:
        """Return the torques (n, N), N m, that hold the arm at its present joint angles, goal minus to_go."""
        found: Array = self.torque + holding(self.setup.arm, self.gravity, self.goal - to_go, self.bodies)[0]
        return found
