"""A base class of controllers in space; functions that compute static equilibria and linear models about equilibria."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..geometry.inverse import approach
from ..linear import Equilibrium, LinearModel, linearize, static_equilibrium
from ..parameters import Arm
from ..physics.gauges import Spot
from ..physics.space.reading import tips
from ..rigid import frames, jacobian, link_bodies, tip_at, weight_and_inertia
from ..scene import Scene
from ..validation import Array
from .base import Controller, Setup, Signals

NEAR, MOST = 5e-4, 12
"""Accepted distance of the resting tip from its target, divided by the arm's length; largest number of rests computed
from one initial posture."""

MOST_RESTS = 1000
"""Largest number of rests that a controller stores, for episodes that begin again from the same seeds."""

BENT = 0.8
"""Joint angle, rad, of the bent postures from which goals are searched."""


def rest(arm: Arm, gravity: Array, angles: Array) -> Equilibrium:
    """Compute the flexible arm's static equilibrium under gravity (3,), m/s^2, with joints held at angles (N,), rad."""
    where: dict[str, Any] = {"gravity": tuple(gravity.tolist()), "angles": tuple(angles.tolist())}
    scene = Scene("rest", arm, duration=1.0, dt=1e-3, **where)
    return static_equilibrium(scene, elements=2, hold_joints=True, require_stable=False)


def held_model(
    arm: Arm, gravity: Array, angles: Array, gauges: Sequence[Spot] = ()
) -> tuple[LinearModel, Array, Array]:
    """Linearize the flexible arm about rest at joint angles (N,), rad, with free joints and without backlash.

    Returns the model, the matrix (N, S) that maps the model's states to joint angles, and the state matrix of the arm
    with gravity compensation. Gravity compensation means that the joint torques cancel the rigid arm's gravity torques
    at the present angles.
    """
    # x' = A x + B u about the rest, and rows of the joint angles
    free = linearize(rest(arm.taut, gravity, angles), gauges=list(gauges))
    joints = free.C[[free.outputs.index(f"joint{k}") for k in range(arm.n_links)]]
    # derivative of the rigid holding torques by the joint angles
    step = 1e-4 * np.eye(arm.n_links)
    ends = [weight_and_inertia(arm, gravity, angles + sign * step)[0] for sign in (1.0, -1.0)]
    return free, joints, free.A + free.B @ ((ends[0] - ends[1]).T / 2e-4) @ joints


def bent_postures(now: Array) -> Array:
    """Return two postures (2, ..., N), rad, with the first joint angle of `now` (..., N) and opposite elbow angles."""
    elbows = np.arange(now.shape[-1] - 1)
    bends = [np.broadcast_to(BENT * side * (-1.0) ** elbows, (*now.shape[:-1], len(elbows))) for side in (1, -1)]
    return np.stack([np.concatenate([now[..., :1], bend], axis=-1) for bend in bends])


class AboutRest(Controller):
    """Base class of controllers in space that use the flexible arm's static equilibrium at the target.

    The torques that hold the arm in its present posture are the holding torques at the target, plus the difference of
    the rigid arm's gravity torques between the two postures. Computing a static equilibrium
    (`linear.static_equilibrium`) takes a few tenths of a second.
    """

    aims = follows_goal = omits_modes = False

    def __init__(self, setup: Setup) -> None:
        """Store gravity and the bodies of the rigid arm."""
        super().__init__(setup)
        self.gravity = np.array(setup.gravity or (0.0, 0.0, 0.0))
        self.bodies = link_bodies(setup.arm)
        self._rests: dict[bytes, tuple[float, Array, Array]] = {}

    def _rest(self, angles: Array) -> tuple[Array, Array]:
        """Return tip position (3,), m, and joint torques (N,), N m, of the resting arm at joint angles (N,), rad."""
        found = rest(self.setup.arm, self.gravity, angles)
        return tips(self.setup.arm, found.settings, found.work.q[None])[0, 0], np.array(found.joint_torques())

    def _settle(self, target: Array, angles: Array) -> tuple[float, Array, Array]:
        """Find the arm at rest whose tip is nearest to the target (3,), m, by Broyden's method from joint angles (N,).

        Returns the distance between tip and target (m), joint angles (rad) and torques (N m).
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
        """Return the tip targets (n, 3), m, inertial axes, from the first observation, for nearly straight arms."""
        arm, now = self.setup.arm, signals.angles
        if signals.to_go is not None:
            return tip_at(arm, now + signals.to_go)
        found: Array = tip_at(arm, now) + (frames(arm, now)[2][:, 0] @ signals.error[..., None])[..., 0]
        return found

    def _goal(self, signals: Signals) -> Array:
        """Compute the joint angles (n, N), rad, of the arms at rest at the targets, and store their holding torques."""
        goals, self.torque = np.zeros(signals.angles.shape), np.zeros(signals.angles.shape)
        for i, target in enumerate(self.targets(signals)):
            goals[i], self.torque[i] = self.rest_at(target, signals.angles[i])[1:]
        return goals

    def rest_at(self, target: Array, now: Array) -> tuple[float, Array, Array]:
        """Compute the arm at rest with its tip nearest to a target (3,), m.

        The search begins at the joint angles `now` (N,), rad, and in two bent postures. Returns the distance between
        tip and target, m, joint angles (N,), rad, and torques (N,), N m.
        """
        arm = self.setup.arm
        known = self._rests.get(key := target.tobytes() + now.tobytes())
        if known is not None:
            return known
        best: tuple[float, Array, Array] | None = None
        for start in (now + 0.3, *bent_postures(now)):
            found = self._settle(target, approach(arm, start, target))
            best = found if best is None or found[0] < best[0] else best
            if best[0] < NEAR * arm.total_length:
                break
        assert best is not None
        if len(self._rests) < MOST_RESTS:
            self._rests[key] = best
        return best

    def initialise(self, signals: Signals, to_go: Array) -> None:
        """Store the rigid arm's inertia at the goal, and the flexible arm's holding torques minus the rigid arm's."""
        weight, self.inertia = weight_and_inertia(self.setup.arm, self.gravity, self.goal, self.bodies)
        self.torque = self.torque - weight

    def forward(self, to_go: Array) -> Array:
        """Return the torques (n, N), N m, that hold the arm at its present joint angles.

        to_go (n, N): joint angles of the goal minus present joint angles, rad.
        """
        found: Array = self.torque + weight_and_inertia(self.setup.arm, self.gravity, self.goal - to_go, self.bodies)[0]
        return found
