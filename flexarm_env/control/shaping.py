"""Input shaping: convolve a reference with a few impulses so that it leaves no residual vibration.

The impulses are designed for the modes of the arm under its PD control (Singer & Seering 1990).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from .. import validation as check
from ..geometry.plane import rigid_times
from ..parameters import Arm
from ..rigid import coriolis, rigid_inertia
from ..validation import Array
from .arm_model import arm_model, postures
from .base import Controller, Setup, Signals
from .pd import PDGains, SpatialPD, SpatialPDGains
from .space import held_model

LIGHT = 0.5
"""Largest damping ratio of the modes that a shaper suppresses; modes with more damping decay by themselves."""


@dataclass(frozen=True)
class Shaper:
    """Impulse sequence: amplitudes (n_impulses,) with the sum 1, and delays (n_impulses,), s."""

    amplitudes: tuple[float, ...]
    delays: tuple[float, ...]

    def then(self, other: Shaper) -> Shaper:
        """Return the convolution with another shaper; the result suppresses the modes of both shapers."""
        amplitudes = np.outer(self.amplitudes, other.amplitudes).ravel()
        delays = np.add.outer(np.asarray(self.delays), np.asarray(other.delays)).ravel()
        return Shaper(tuple(amplitudes.tolist()), tuple(delays.tolist()))

    def residual(self, frequency: float, ratio: float = 0.0) -> float:
        """Return the residual vibration V of a mode, divided by the vibration after one impulse at t = 0.

        V = exp(-zeta w t_n) |sum_i A_i exp(zeta w t_i - j w_d t_i)| for amplitudes A_i and delays t_i. frequency:
        undamped frequency w of the mode, rad/s. ratio: damping ratio zeta of the mode; w_d = w sqrt(1 - zeta^2).
        """
        pole = frequency * (ratio - 1j * np.sqrt(1.0 - ratio**2))
        t = np.asarray(self.delays)
        return float(abs(np.sum(np.asarray(self.amplitudes) * np.exp(pole * t))) * np.exp(-ratio * frequency * t.max()))


def zv(frequency: float, ratio: float = 0.0) -> Shaper:
    """Return the zero-vibration shaper: two impulses half a damped period apart.

    The amplitudes are 1/(1 + K) and K/(1 + K) with K = exp(-zeta pi / sqrt(1 - zeta^2)). frequency: undamped frequency
    of the mode, rad/s. ratio: damping ratio zeta, 0 to 0.99.
    """
    frequency = check.number("frequency", frequency, "rad/s", above=0.0)
    damped = np.sqrt(1.0 - check.number("ratio", ratio, minimum=0.0, maximum=0.99) ** 2)
    k = np.exp(-ratio * np.pi / damped)
    return Shaper((1.0 / (1.0 + k), k / (1.0 + k)), (0.0, np.pi / (frequency * damped)))


def zvd(frequency: float, ratio: float = 0.0) -> Shaper:
    """Return the zero-vibration-derivative shaper (ZVD), which has three impulses.

    With this shaper the residual vibration is proportional to the square of the error in the assumed frequency. With
    the zero-vibration shaper the residual vibration is proportional to the error in the frequency. frequency: undamped
    frequency of the mode, rad/s. ratio: damping ratio, 0 to 0.99.
    """
    # the convolution of two ZV shapers
    one = zv(frequency, ratio)
    a, b = one.amplitudes
    return Shaper((a * a, 2.0 * a * b, b * b), (0.0, one.delays[1], 2.0 * one.delays[1]))


SHAPERS = {"zv": zv, "zvd": zvd}


@dataclass(frozen=True)
class ShapedGains(PDGains):
    """Dimensionless PD gains. effort: largest torque of the reference motion divided by the torque limit."""

    effort: float


@lru_cache(maxsize=1024)
def closed_loop_shaper(arm: Arm, gains: PDGains, kind: str, posture: tuple[float, ...]) -> Shaper:
    """Design a shaper for the N slowest lightly damped modes of the arm under PD control.

    kind: kind of the shaper, "zv" or "zvd". posture: elbow angles, rad.
    """
    model = arm_model(arm, posture)
    n = model.n_joints
    # closed loop A - B (kp C_angles + kd C_rates)
    kp, kd = gains.of(arm)
    return cascade(model.A - model.B @ (np.diag(kp) @ model.C[:n] + np.diag(kd) @ model.C[n : 2 * n]), kind, n)


def cascade(closed: Array, kind: str, most: int) -> Shaper:
    """Convolve the shapers of the slowest lightly damped modes (at most `most`) of the loop x' = closed @ x."""
    # one of each conjugate pair: frequency |s|, damping ratio -Re(s)/|s|
    poles = np.linalg.eigvals(closed)
    poles = poles[poles.imag > 1e-6]
    frequencies, ratios = np.abs(poles), -poles.real / np.abs(poles)
    light = np.flatnonzero((ratios < LIGHT) & (ratios > 0.0))
    shaper = Shaper((1.0,), (0.0,))
    for i in light[np.argsort(frequencies[light])][:most]:
        shaper = shaper.then(SHAPERS[kind](float(frequencies[i]), float(ratios[i])))
    return shaper


class Shaped(Controller):
    """Controller that follows a shaped reference, in which all joints start and stop together.

    The reference before shaping has a constant acceleration, then a constant deceleration.
    """

    kind: str
    """Kind of the shaper, "zv" or "zvd"."""

    def shape(self, shapers: Sequence[Shaper], quickest: Array, to_go: Array) -> None:
        """Compute the references of new episodes, each with the shaper of its arm.

        quickest (n,): durations of the references before shaping, s. to_go (n, N): joint displacements, rad.
        """
        self.move = to_go
        most = max(len(s.delays) for s in shapers)
        self.amplitudes, self.delays = np.zeros((2, len(shapers), most))
        for i, shaper in enumerate(shapers):
            count = len(shaper.delays)
            self.amplitudes[i, :count], self.delays[i, :count] = shaper.amplitudes, shaper.delays
        self.period = np.maximum(quickest, 2.0 * self.setup.control_dt)

    def _reference(self, t: float) -> tuple[Array, Array]:
        """Return the completed share of the move and the rate of this share, 1/s, (n,) each, at time t, s."""
        # unshaped reference s(x): 2 x^2 up to x = 1/2, then 1 - 2 (1 - x)^2; sum of its delayed copies
        x = np.clip((t - self.delays) / self.period[:, None], 0.0, 1.0)
        early = x < 0.5
        done = np.where(early, 2.0 * x**2, 1.0 - 2.0 * (1.0 - x) ** 2)
        rate = np.where(early, 4.0 * x, 4.0 * (1.0 - x)) / self.period[:, None]
        return np.sum(self.amplitudes * done, axis=1), np.sum(self.amplitudes * rate, axis=1)

    def reference(self) -> tuple[Array, Array, Array]:
        """Return the reference in this period: angles to the goal, rad, rates, rad/s, mean accelerations, rad/s^2."""
        dt = self.setup.control_dt
        done, rate = self._reference(self.step * dt)
        _, later = self._reference((self.step + 1) * dt)
        left = self.move * (1.0 - done)[:, None]
        return left, self.move * rate[:, None], self.move * ((later - rate) / dt)[:, None]

    def inverse_dynamics(self, left: Array, rates: Array, accelerations: Array) -> Array:
        """Return the rigid arm's torques (n, N), N m, along the reference, without gravity torques.

        The torques are inertia times acceleration plus Coriolis torques. left, rates, accelerations (n, N): results of
        `reference`.
        """
        arm, angles = self.setup.arm, self.goal - left
        found: Array = np.einsum("nij,nj->ni", rigid_inertia(arm, angles), accelerations)
        return found + coriolis(arm, angles, rates)


class ShapedPD(Shaped):
    """PD control along a shaped reference with the rigid arm's inverse dynamics as feedforward.

    The reference before shaping is the fastest motion of the rigid arm whose torques are at most `effort` times the
    torque limits.
    """

    def __init__(self, setup: Setup, gains: ShapedGains, kind: str) -> None:
        super().__init__(setup)
        self.gains, self.kind = gains, kind
        self.kp, self.kd = gains.on(setup)

    def initialise(self, signals: Signals, to_go: Array) -> None:
        """Design each arm's shaper in the posture at its goal, and compute the arm's reference."""
        arm = self.setup.arm
        shapers = [closed_loop_shaper(arm, self.gains, self.kind, posture) for posture in postures(self.goal)]
        inertia = rigid_inertia(arm, self.goal)
        self.shape(shapers, rigid_times(inertia, to_go, self.gains.effort * self.limits), to_go)

    def torques(self, signals: Signals, to_go: Array) -> Array:
        """Return feedforward torques plus PD torques (n, N), N m."""
        left, rates, accelerations = self.reference()
        forward = self.inverse_dynamics(left, rates, accelerations)
        torques: Array = forward + self.kp * (to_go - left) + self.kd * (rates - signals.rates)
        return torques


@dataclass(frozen=True)
class SpatialShapedGains(SpatialPDGains):
    """Gains of PD control in space, and parameters of the shaped reference.

    effort: largest torque of the reference motion divided by the torque limit. modes: maximum number of modes that the
    shaper suppresses.
    """

    effort: float
    modes: int


def shaper_in_space(arm: Arm, gravity: Array, gains: SpatialShapedGains, kind: str, angles: Array) -> Shaper:
    """Design a shaper for the slowest lightly damped modes of the arm in space under PD control with filtered rates.

    The model is linearized about rest at joint angles (N,), rad. gravity: acceleration of gravity, m/s^2. kind: kind of
    the shaper, "zv" or "zvd".
    """
    free, joints, A = held_model(arm, gravity, angles)
    N, filter_rate = arm.n_links, 1.0 / gains.lag
    inertia = np.diag(np.diag(rigid_inertia(arm, angles[None])[0]))
    rates = np.array([free.C[free.outputs.index(f"joint{k}_rate")] for k in range(N)])
    # PD gains scaled by the joints' inertia
    spring, damper = gains.rate**2 * inertia, 2.0 * gains.ratio * gains.rate * inertia
    # rate filter w' = (rate - w) / lag; closed loop in states (x, w)
    filtered = np.hstack([filter_rate * rates, -filter_rate * np.eye(N)])
    closed = np.vstack([np.hstack([A - free.B @ spring @ joints, -free.B @ damper]), filtered])
    return cascade(closed, kind, gains.modes)


class SpatialShapedPD(Shaped, SpatialPD):
    """PD control along a shaped reference in space, with holding torques and rigid feedforward (see `ShapedPD`)."""

    restarts = False

    def __init__(self, setup: Setup, gains: SpatialShapedGains, kind: str) -> None:
        SpatialPD.__init__(self, setup, gains)
        self.shaped, self.kind = gains, kind

    def initialise(self, signals: Signals, to_go: Array) -> None:
        """Compute the arms at rest at their goals, their shapers and their references."""
        SpatialPD.initialise(self, signals, to_go)
        shapers = [shaper_in_space(self.setup.arm, self.gravity, self.shaped, self.kind, goal) for goal in self.goal]
        self.shape(shapers, rigid_times(self.inertia, to_go, self.shaped.effort * self.limits), to_go)

    def torques(self, signals: Signals, to_go: Array) -> Array:
        """Return the sum of holding torques, feedforward torques and PD torques, (n, N), N m."""
        left, rates, accelerations = self.reference()
        moved = self.inverse_dynamics(left, rates, accelerations)
        found: Array = self.forward(to_go) + moved + self.pulled(signals, to_go - left, rates)
        return found
