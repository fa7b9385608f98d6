"""PD control of joints in space, about the arm's rest at its target under gravity."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..bodies import tensor
from ..parameters import Arm, Link
from ..physics.gauges import Spot
from ..physics.space.build import Body, X, far_body, near_body, tip_end, tip_lever
from ..physics.space.reading import frames, tips
from ..scene import Scene
from .base import Controller, Setup, Signals
from .space import approach, jacobian, tip_at

if TYPE_CHECKING:
    from ..linear import Equilibrium
    from ..linear.state_space import LinearModel

Array = NDArray[np.float64]

NEAR, MOST = 5e-4, 12
"""How far the tip may rest from its target, over the arm's length; rests that are looked at from one start."""

BENT = 0.8
"""rad: joints of postures from which goals are looked for."""


@dataclass(frozen=True)
class SpatialPDGains:
    """rate: rad/s, of each joint under its spring, others still. ratio: of damping. lag: s, of the filter of rates: a
    beam's root turns so lightly that what is sampled of it must not come back at once."""

    rate: float
    ratio: float
    lag: float


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
    from ..linear import static_equilibrium

    where: dict[str, Any] = {"gravity": tuple(gravity.tolist()), "angles": tuple(angles.tolist())}
    scene = Scene("rest", arm, duration=1.0, dt=1e-3, **where)
    return static_equilibrium(scene, elements=2, hold_joints=True, require_stable=False)


def held_model(
    arm: Arm, gravity: Array, angles: Array, gauges: Sequence[Spot] = ()
) -> tuple[LinearModel, Array, Array]:
    """The flexible arm about its rest with joints at angles (N,), let go; rows of its joint angles; its A where the
    rigid arm's weight is held at every angle."""
    from ..linear import linearize

    free = linearize(rest(arm, gravity, angles), gauges=list(gauges))
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

    def _goal(self, signals: Signals) -> Array:
        """Arms stand straight where an episode begins, or nearly so."""
        arm, now = self.setup.arm, signals.angles
        if signals.to_go is None:
            targets = tip_at(arm, now) + (frames(arm, now)[2][:, 0] @ signals.error[..., None])[..., 0]
        else:
            targets = tip_at(arm, now + signals.to_go)
        goals, self.torque = np.zeros(now.shape), np.zeros(now.shape)
        for i, target in enumerate(targets):
            goals[i], self.torque[i] = self.rest_at(target, now[i])[1:]
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


class SpatialPD(AboutRest):
    """What holds the arm, and a PD about its goal."""

    def __init__(self, setup: Setup, gains: SpatialPDGains) -> None:
        super().__init__(setup)
        self.gains = gains
        self.passed = float(1.0 - np.exp(-setup.control_dt / gains.lag))
        """Of a change of the rates, by their filter, in a period."""

    def initialise(self, signals: Signals, to_go: Array) -> None:
        super().initialise(signals, to_go)
        self.rates = signals.rates.copy()

    def torques(self, signals: Signals, to_go: Array) -> Array:
        self.rates += self.passed * (signals.rates - self.rates)
        inertia = np.diagonal(self.inertia, axis1=1, axis2=2)
        return self.forward(to_go) + inertia * self._pull(to_go, self.rates)

    def _pull(self, to_go: Array, rates: Array) -> Array:
        """Accelerations of the joints, rad/s^2."""
        rate, ratio = self.gains.rate, self.gains.ratio
        found: Array = rate * rate * np.clip(to_go, -1.0, 1.0) - 2.0 * ratio * rate * rates
        return found

    def towards(self, wanted: Array, angles: Array, rates: Array) -> Array:
        """Torques (N,), N m, that hold the rigid arm's weight and turn joints at angles, with filtered rates, to the
        angles wanted, all (N,)."""
        weight, inertia = holding(self.setup.arm, self.gravity, angles[None], self.bodies)
        found: Array = weight[0] + np.diag(inertia[0]) * self._pull(wanted - angles, rates)
        return found
