"""Arms in space as controllers know them: the rigid arm's kinematics, weight and inertia, joint angles for a point,
and the flexible arm's rest there."""

import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..bodies import tensor
from ..linear import Equilibrium, LinearModel, linearize, static_equilibrium
from ..parameters import Arm, Link
from ..physics.gauges import Spot
from ..physics.space.build import Body, X, axis_of, far_body, mount_of, near_body, tip_end, tip_lever
from ..physics.space.reading import frames, tips
from ..scene import Scene
from ..tasks.space_angles import JOINT
from ..validation import Array
from .base import Controller, Setup, Signals

NEAR, MOST = 5e-4, 12
"""How far the tip may rest from its target, over the arm's length; rests that are looked at from one start."""

BENT = 0.8
"""rad: joints of postures from which goals are looked for."""


def tip_at(arm: Arm, angles: Array) -> Array:
    """Where the rigid arm's tip is, (..., 3) m, at joint angles (..., N)."""
    return frames(arm, angles)[3]


def jacobian(arm: Arm, angles: Array) -> Array:
    """(..., 3, N), m: what the tip moves by with the angles."""
    places, axes, _, tip = frames(arm, angles)
    return np.swapaxes(np.cross(axes, tip[..., None, :] - places), -1, -2)


def approach(arm: Arm, angles: Array, points: Array) -> Array:
    """Angles (..., N) nearby at which the tip is nearest to points (..., 3): damped least squares, within limits."""
    limits = np.array([(-np.inf, np.inf) if r is None else r for r in arm.joint_limits or (None,) * arm.n_links])
    for _ in range(60):
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


def lumps(arm: Arm) -> list[tuple[int, Body]]:
    """Bodies of the rigid arm: which link they turn with, and they, from its root."""
    found = []
    for k, link in enumerate(arm.links):
        far, parts = far_body(arm, k), []
        root = (0.0 if link.rigid else link.root_offset) * X
        parts.append(Body(far.mass, far.centre + root, far.inertia))
        if not link.rigid and link.mass:
            parts.append(_beam(link, root))
        tip = link.span * X - tip_lever(link)  # where its last section is
        near = near_body(arm, k + 1) if k + 1 < arm.n_links else tip_end(link)
        parts.append(Body(near.mass, tip + near.centre, near.inertia))
        found += [(k, part) for part in parts]
    held = arm.payload
    at = arm.links[-1].span * X + np.array((*held.offset, 0.0)[:3])
    found.append((arm.n_links - 1, Body(held.mass, at, tensor(held.inertia))))
    return [(k, part) for k, part in found if part.mass > 0.0 or part.inertia.any()]


def _beam(link: Link, root: Array) -> Body:
    """The beam, straight, from where it begins to bend at `root`."""
    s, weights = link.quadrature()
    middle = link.moment(1) / link.mass
    swing, flat, across = link.moment(2) - middle * link.moment(1), link.rotary, float(weights @ link.across(s)["J_y"])
    return Body(link.mass, root + middle * X, np.diag([flat + across, swing + across, swing + flat]))


def _cross(a: Array, b: Array) -> Array:
    """As NumPy's, sooner."""
    (ax, ay, az), (bx, by, bz) = np.moveaxis(a, -1, 0), np.moveaxis(b, -1, 0)
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], -1)


def holding(
    arm: Arm, gravity: Array, angles: Array, parts: list[tuple[int, Body]] | None = None
) -> tuple[Array, Array]:
    """Of the rigid arm at joint angles (n, N): torques that hold it, N m; inertia about the joints (n, N, N), kg m^2,
    with rotors.

    parts: its `lumps`, where they are known.
    """
    places, axes, links, _ = frames(arm, angles)
    torques, inertia = np.zeros(angles.shape), np.zeros((*angles.shape, arm.n_links))
    inertia += np.diag([arm.joint(k).rotor for k in range(arm.n_links)])
    for k, part in lumps(arm) if parts is None else parts:
        moved = slice(k + 1)
        swing = _cross(axes[:, moved], (places[:, k] + links[:, k] @ part.centre)[:, None] - places[:, moved])
        own = axes[:, moved] @ links[:, k]
        torques[:, moved] -= part.mass * swing @ gravity
        inertia[:, moved, moved] += part.mass * swing @ np.swapaxes(swing, 1, 2)
        inertia[:, moved, moved] += own @ part.inertia @ np.swapaxes(own, 1, 2)
    return torques, inertia


def rest(arm: Arm, gravity: Array, angles: Array) -> Equilibrium:
    """The flexible arm at rest, its joints held at angles (N,)."""
    where: dict[str, Any] = {"gravity": tuple(gravity.tolist()), "angles": tuple(angles.tolist())}
    scene = Scene("rest", arm, duration=1.0, dt=1e-3, **where)
    return static_equilibrium(scene, elements=2, hold_joints=True, require_stable=False)


def held_model(
    arm: Arm, gravity: Array, angles: Array, gauges: Sequence[Spot] = ()
) -> tuple[LinearModel, Array, Array]:
    """The flexible arm about its rest with joints at angles (N,), let go, gears without play; rows of its joint
    angles; its A where the rigid arm's weight is held at every angle."""
    free = linearize(rest(arm.taut, gravity, angles), gauges=list(gauges))
    joints = free.C[[free.outputs.index(f"joint{k}") for k in range(arm.n_links)]]
    step = 1e-4 * np.eye(arm.n_links)
    ends = [holding(arm, gravity, angles + sign * step)[0] for sign in (1.0, -1.0)]
    return free, joints, free.A + free.B @ ((ends[0] - ends[1]).T / 2e-4) @ joints


class AboutRest(Controller):
    """Torques of the arm at rest at its target, and what the rigid arm's weight asks for elsewhere.

    Goals follow from static rests of the flexible arm (`linear.static_equilibrium`), some tenths of a second an arm.
    """

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self.gravity = np.array(setup.gravity or (0.0, 0.0, 0.0))
        self.bodies = lumps(setup.arm)

    def _rest(self, angles: Array) -> tuple[Array, Array]:
        """Place of the tip, m, and torques, N m, where joints are held at angles (N,)."""
        found = rest(self.setup.arm, self.gravity, angles)
        return tips(self.setup.arm, found.settings, found.work.q[None])[0, 0], np.array(found.joint_torques())

    def _settle(self, target: Array, angles: Array) -> tuple[float, Array, Array]:
        """(distance of the tip, joint angles, torques) of the rest nearest to the target, by Broyden's method."""
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
            step = J.T @ np.linalg.solve(J @ J.T + 1e-4 * arm.total_length**2 * np.eye(3), off)
            step *= min(1.0, 0.3 / float(np.abs(step).max()))
            after, torques = self._rest(angles + step)
            J = J + np.outer(after - tip - J @ step, step) / (step @ step)
            angles, tip = angles + step, after
        return best

    def targets(self, signals: Signals) -> Array:
        """Where tips are to come to, (n, 3) m; arms stand straight where an episode begins, or nearly so."""
        arm, now = self.setup.arm, signals.angles
        if signals.to_go is not None:
            return tip_at(arm, now + signals.to_go)
        found: Array = tip_at(arm, now) + (frames(arm, now)[2][:, 0] @ signals.error[..., None])[..., 0]
        return found

    def _goal(self, signals: Signals) -> Array:
        goals, self.torque = np.zeros(signals.angles.shape), np.zeros(signals.angles.shape)
        for i, target in enumerate(self.targets(signals)):
            goals[i], self.torque[i] = self.rest_at(target, signals.angles[i])[1:]
        return goals

    def rest_at(self, target: Array, now: Array) -> tuple[float, Array, Array]:
        """Distance of the tip from a target (3,), m, joint angles and torques (N,) of the rest nearest to it that is
        found from joints at angles (N,)."""
        arm, N = self.setup.arm, self.setup.n_joints
        sides = [[now[0], *(BENT * side * (-1.0) ** k for k in range(N - 1))] for side in (1, -1)]
        best: tuple[float, Array, Array] | None = None
        for start in (now + 0.3, *np.array(sides)):
            found = self._settle(target, approach(arm, start, target))
            best = found if best is None or found[0] < best[0] else best
            if best[0] < NEAR * arm.total_length:
                break
        assert best is not None
        return best

    def initialise(self, signals: Signals, to_go: Array) -> None:
        weight, self.inertia = holding(self.setup.arm, self.gravity, self.goal, self.bodies)
        self.torque = self.torque - weight

    def forward(self, to_go: Array) -> Array:
        """Torques (n, N), N m, that hold the arm."""
        found: Array = self.torque + holding(self.setup.arm, self.gravity, self.goal - to_go, self.bodies)[0]
        return found
