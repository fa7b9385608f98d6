"""Hybrid force/position control of a tip that slides along a wall (task "press")."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .. import validation as check
from ..geometry.plane import tip_in_hub_frame, wrapped
from ..parameters import Arm
from ..validation import Array
from .arm_model import postures
from .base import Controller, Gains, Setup, Signals
from .lqr import LQRGains, design, times

ENTRIES = ("to_target_x", "to_target_y", "target_velocity_x", "target_velocity_y", "target_force", "tip_force_normal")
"""Entries of the observation that the controller reads in addition to those of joints and links."""


@dataclass(frozen=True)
class ForceGains(Gains):
    """Gains of `HybridForce`.

    Args:
        angle, rate, bend, bend_rate: weights of the state feedback about the reference; see `LQRGains`.
        path, force: integral gains, 1/s, on the distance from the path and on the error of the normal force.
        lead: ratio of the proportional gain to the integral gain for the distance from the path, s.
        approach: time in which the tip moves to the wall, s. press: time in which the force then rises, s.
        friction: assumed coefficient of friction.
    """

    angle: float = 2.919
    rate: float = 12.65
    bend: float = 0.1562
    bend_rate: float = 0.3423
    path: float = 0.9
    lead: float = 0.4
    force: float = 0.3
    approach: float = 3.0
    press: float = 1.0
    friction: float = 0.3


class HybridForce(Controller):
    """State feedback with integral errors about an arm at rest that presses on the wall with the commanded force.

    In each period the controller computes the joint angles and torques of the arm at rest whose tip is at the reference
    under the wall's reaction (`StaticChain`). The reference moves from the tip's initial position to the target; then
    the force rises. The errors along the wall and of the normal force are integrated, and both shift the reference.
    """

    needs_bends = True

    def __init__(self, setup: Setup, gains: ForceGains | None = None) -> None:
        """Look up the entries of the observation.

        Raises:
            ValueError: the environment has another task than "press", or its observation lacks an entry.
        """
        if setup.task != "press":
            raise check.InvalidValue("task", setup.task, 'must be "press" for a controller of the contact force')
        super().__init__(setup)
        self.gains = ForceGains() if gains is None else check.instance("gains", gains, ForceGains)
        for name in ENTRIES:
            if name not in setup.names:
                raise check.InvalidValue("observation", setup.names, f"must have the entry {name}")
        at, scales = [setup.names.index(name) for name in ENTRIES], np.array(setup.scales)
        self._at, self._scales = np.array(at) - len(setup.names), scales[at]
        self._weights = LQRGains(self.gains.angle, self.gains.rate, self.gains.bend, self.gains.bend_rate)
        self.chain = StaticChain(setup.arm)

    def reset(self, observation: NDArray[np.floating]) -> None:
        """Begin episodes with their first observation, (n, entries) or (entries,)."""
        signals = self.read(observation)
        self.step, self.goal = 0, signals.angles.copy()
        self._tip = self._rotated(signals, tip_in_hub_frame(self.setup.arm, signals.angles[:, 1:], signals.bends))
        self._shift, self._excess = np.zeros((len(self.goal), 2)), np.zeros(len(self.goal))
        self._bends = np.zeros_like(self.goal)
        self._error: Array | None = None

    def act(self, observation: NDArray[np.floating], beside: NDArray[np.floating] | None = None) -> NDArray[np.float32]:
        """Compute actions in [-1, 1]: torques divided by their limits, saturated; beside: see `Controller.act`."""
        if not len(self.goal):
            raise RuntimeError("No episode has begun: call the controller's reset(observation) first")
        signals = self.read(observation)
        seen = np.atleast_2d(np.asarray(observation, np.float64))[:, self._at] * self._scales
        torques = self._torques(signals, seen)
        self.step += 1
        actions = torques / self.limits
        if beside is not None:
            actions = actions + np.reshape(beside, actions.shape)
        applied: NDArray[np.float32] = np.clip(actions, -1.0, 1.0).astype(np.float32)
        return applied if np.ndim(observation) == 2 else applied.reshape(-1)

    def torques(self, signals: Signals, to_go: Array) -> Array:
        """Raise an error: `act` does not use this method, since it needs entries that `Signals` lacks."""
        raise NotImplementedError

    def _torques(self, signals: Signals, seen: Array) -> Array:
        """Return joint torques (n, N), N m. seen (n, 6): `ENTRIES` in SI units, vectors in the hub's frame."""
        gains, dt = self.gains, self.setup.control_dt
        arm, time = self.setup.arm, self.step * dt
        to_target, velocity = self._rotated(signals, seen[:, :2]), self._rotated(signals, seen[:, 2:4])
        commanded, force = seen[:, 4], seen[:, 5]
        target = self._rotated(signals, tip_in_hub_frame(arm, signals.angles[:, 1:], signals.bends)) + to_target
        # tangent of the wall, and its normal away from the root
        along = velocity / np.maximum(np.linalg.norm(velocity, axis=1), 1e-12)[:, None]
        normal = np.stack([-along[:, 1], along[:, 0]], axis=1)
        normal *= np.sign((normal * target).sum(axis=1))[:, None]
        # approach: a polynomial of fifth degree; then the force rises
        x, y = np.clip(time / gains.approach, 0.0, 1.0), np.clip((time - gains.approach) / gains.press, 0.0, 1.0)
        near, share = x**3 * (10.0 - 15.0 * x + 6.0 * x * x), y * y * (3.0 - 2.0 * y)
        if y >= 1.0:
            error = (to_target * along).sum(axis=1)
            change = error - self._error if self._error is not None else np.zeros_like(error)
            self._shift += along * (gains.path * (dt * error + gains.lead * change))[:, None]
            self._error = error
            self._excess += gains.force * dt * (commanded - force)
        size = ((commanded + self._excess) * share)[:, None]
        pressing = (normal + gains.friction * along) * size
        reference = self._tip + near * (target + velocity * dt + self._shift - self._tip)
        # the arm at rest there, and its rates
        before, bent = self.goal, self._bends
        self.goal, self._bends, holding = self.chain.solve(before, -pressing, reference)
        rates = (self.goal - before) / dt
        bend_rates = (self._bends - bent) / dt if self.step else np.zeros_like(bent)
        off = [
            wrapped(signals.angles - self.goal), signals.rates - rates, signals.bends - self._bends,
            signals.bend_rates - bend_rates,
        ]  # fmt: skip
        return holding - self._feedback(np.concatenate(off, axis=1))

    def _feedback(self, outputs: Array) -> Array:
        """Return K x (n, N), N m, for outputs (n, 4 N) about the reference; K is that of the reference's posture."""
        setup, found = self.setup, np.zeros((len(outputs), self.setup.n_joints))
        for i, posture in enumerate(postures(self.goal)):
            own = design(setup.arm, setup.torque_limits, setup.control_dt, self._weights, posture)
            # a mirrored posture has the same gains
            found[i] = own.K @ own.model.state_of(outputs[i])
        return found

    def _rotated(self, signals: Signals, vectors: Array) -> Array:
        """Rotate vectors (n, 2) from the hub's frame into inertial axes."""
        cosine, sine = np.cos(signals.angles[:, 0]), np.sin(signals.angles[:, 0])
        x, y = vectors.T
        return np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=1)


class StaticChain:
    """Arm of flexible links at rest under a force on its tip, with small deflections of each link."""

    def __init__(self, arm: Arm) -> None:
        """Store lengths (m) and bending stiffnesses at mid-length (N m^2; inf for rigid links)."""
        self.lengths = np.array([link.span for link in arm.links])
        stiff = [np.inf if link.rigid else float(link.along(0.5 * link.length).EI) for link in arm.links]
        self.stiffness = np.array(stiff)

    def bend(self, angles: Array, force: Array) -> tuple[Array, Array, Array]:
        """Return tip (n, 2), m, deflections divided by length (n, N) and joint torques (n, N), N m, of the arm at rest.

        angles (n, N): joint angles, rad. force (n, 2): force on the tip, N, inertial axes.
        """
        n, links = angles.shape
        bends, slopes, torques = np.zeros((n, links)), np.zeros((n, links)), np.zeros((n, links))
        for _ in range(4):
            # places of the joints and the tip, with the links' deflections of the pass before
            angle, places, tangents = np.zeros(n), [np.zeros((n, 2))], []
            for k, length in enumerate(self.lengths):
                angle = angle + angles[:, k]
                tangents.append(angle)
                cosine, sine = np.cos(angle), np.sin(angle)
                x, y = length * (1.0 - 0.6 * bends[:, k] ** 2), length * bends[:, k]
                places.append(places[-1] + np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=1))
                angle = angle + slopes[:, k]
            for k, length in enumerate(self.lengths):
                # transverse force and moment at the link's tip
                across = np.cos(tangents[k]) * force[:, 1] - np.sin(tangents[k]) * force[:, 0]
                moment, EI = _moment(places[-1] - places[k + 1], force), self.stiffness[k]
                bends[:, k] = across * length**2 / (3.0 * EI) + moment * length / (2.0 * EI)
                slopes[:, k] = across * length**2 / (2.0 * EI) + moment * length / EI
                torques[:, k] = -_moment(places[-1] - places[k], force)
        return places[-1], bends, torques

    def solve(self, angles: Array, force: Array, tip: Array) -> tuple[Array, Array, Array]:
        """Return joint angles (n, N), deflections and holding torques of the arm whose tip is at `tip` (n, 2), m.

        angles: initial guess of Newton's iteration. With more than two joints the nearest solution is found.
        """
        step, angles = 1e-5, angles.copy()
        for _ in range(6):
            at = self.bend(angles, force)[0]
            columns = [(self.bend(angles + step * unit, force)[0] - at) / step for unit in np.eye(angles.shape[1])]
            inverse = np.linalg.pinv(np.stack(columns, axis=2))
            angles += times(inverse, np.clip(tip - at, -0.05, 0.05))
        _, bends, torques = self.bend(angles, force)
        return angles, bends, torques


def _moment(lever: Array, force: Array) -> Array:
    """Return the moment (n,), N m, of forces (n, 2) at levers (n, 2)."""
    return np.asarray(lever[:, 0] * force[:, 1] - lever[:, 1] * force[:, 0])
