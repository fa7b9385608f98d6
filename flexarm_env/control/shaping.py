"""Input shaping: a reference convolved with a few impulses leaves no vibration behind (ZV: Singer & Seering 1990).

The impulses are made for the modes of the arm under its PD control, so that what is left after the shaped
reference has ended is what the PD alone has to damp.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from .. import validation as check
from ..parameters import Arm
from ..rigid import coriolis, rigid_inertia
from ..validation import Array
from .arm_model import arm_model, postures
from .base import Controller, Setup, Signals
from .kinematics import rigid_times
from .pd import PDGains, SpatialPD, SpatialPDGains
from .space import held_model, holding

LIGHT = 0.5
"""Modes damped less than this are shaped for; the others die out by themselves."""


@dataclass(frozen=True)
class Shaper:
    """Impulses: amplitudes (they sum to 1) and their delays in s, both (n_impulses,)."""

    amplitudes: tuple[float, ...]
    delays: tuple[float, ...]

    def then(self, other: Shaper) -> Shaper:
        """The two convolved: a shaper for the modes of both."""
        amplitudes = np.outer(self.amplitudes, other.amplitudes).ravel()
        delays = np.add.outer(np.asarray(self.delays), np.asarray(other.delays)).ravel()
        return Shaper(tuple(amplitudes.tolist()), tuple(delays.tolist()))

    def residual(self, frequency: float, ratio: float = 0.0) -> float:
        """Vibration that a mode (frequency in rad/s, damping ratio) is left with, over that of one impulse at t = 0."""
        pole = frequency * (ratio - 1j * np.sqrt(1.0 - ratio**2))
        t = np.asarray(self.delays)
        return float(abs(np.sum(np.asarray(self.amplitudes) * np.exp(pole * t))) * np.exp(-ratio * frequency * t.max()))


def zv(frequency: float, ratio: float = 0.0) -> Shaper:
    """Zero vibration: two impulses, half a damped period apart. frequency in rad/s, ratio of damping, 0 to 0.99."""
    frequency = check.number("frequency", frequency, "rad/s", above=0.0)
    damped = np.sqrt(1.0 - check.number("ratio", ratio, minimum=0.0, maximum=0.99) ** 2)
    k = np.exp(-ratio * np.pi / damped)
    return Shaper((1.0 / (1.0 + k), k / (1.0 + k)), (0.0, np.pi / (frequency * damped)))


def zvd(frequency: float, ratio: float = 0.0) -> Shaper:
    """Zero vibration and derivative: three impulses; an error in the frequency counts to second order only."""
    one = zv(frequency, ratio)
    a, b = one.amplitudes
    return Shaper((a * a, 2.0 * a * b, b * b), (0.0, one.delays[1], 2.0 * one.delays[1]))


SHAPERS = {"zv": zv, "zvd": zvd}


@dataclass(frozen=True)
class ShapedGains(PDGains):
    """Dimensionless: those of the PD, and `effort`: share of the torque limit for the reference."""

    effort: float


@lru_cache(maxsize=1024)
def closed_loop_shaper(arm: Arm, gains: PDGains, kind: str, posture: tuple[float, ...]) -> Shaper:
    """Impulses for the N slowest lightly damped modes of the arm under PD control, the elbows at a posture in rad."""
    model = arm_model(arm, posture)
    n = model.n_joints
    kp, kd = gains.of(arm)
    return cascade(model.A - model.B @ (np.diag(kp) @ model.C[:n] + np.diag(kd) @ model.C[n : 2 * n]), kind, n)


def cascade(closed: Array, kind: str, most: int) -> Shaper:
    """Impulses for the slowest lightly damped modes of a linear model, `most` at most."""
    poles = np.linalg.eigvals(closed)
    poles = poles[poles.imag > 1e-6]
    frequencies, ratios = np.abs(poles), -poles.real / np.abs(poles)
    light = np.flatnonzero((ratios < LIGHT) & (ratios > 0.0))
    shaper = Shaper((1.0,), (0.0,))
    for i in light[np.argsort(frequencies[light])][:most]:
        shaper = shaper.then(SHAPERS[kind](float(frequencies[i]), float(ratios[i])))
    return shaper


class Shaped(Controller):
    """Follows a shaped reference: one of constant acceleration and deceleration, all joints in step, convolved with
    impulses."""

    kind: str
    """Of the impulses, "zv" or "zvd"."""

    def shape(self, shapers: Sequence[Shaper], quickest: Array, to_go: Array) -> None:
        """Begin episodes: impulses of each arm, times (n,) that its unshaped reference takes, s, and its way (n, N)."""
        self.move = to_go
        most = max(len(s.delays) for s in shapers)
        self.amplitudes, self.delays = np.zeros((2, len(shapers), most))
        for i, shaper in enumerate(shapers):
            count = len(shaper.delays)
            self.amplitudes[i, :count], self.delays[i, :count] = shaper.amplitudes, shaper.delays
        self.period = np.maximum(quickest, 2.0 * self.setup.control_dt)

    def _reference(self, t: float) -> tuple[Array, Array]:
        """Share of the move done and its rate in 1/s, (n,) each, at time t in s."""
        x = np.clip((t - self.delays) / self.period[:, None], 0.0, 1.0)
        early = x < 0.5
        done = np.where(early, 2.0 * x**2, 1.0 - 2.0 * (1.0 - x) ** 2)
        rate = np.where(early, 4.0 * x, 4.0 * (1.0 - x)) / self.period[:, None]
        return np.sum(self.amplitudes * done, axis=1), np.sum(self.amplitudes * rate, axis=1)

    def reference(self) -> tuple[Array, Array, Array]:
        """Of this period: what is left to go, rad, its rates and accelerations in the period, (n, N) each."""
        dt = self.setup.control_dt
        done, rate = self._reference(self.step * dt)
        _, later = self._reference((self.step + 1) * dt)
        left = self.move * (1.0 - done)[:, None]
        return left, self.move * rate[:, None], self.move * ((later - rate) / dt)[:, None]


class ShapedPD(Shaped):
    """PD control along a shaped reference, with the torque that the rigid arm needs for it fed forward.

    The reference is the quickest one that the rigid arm can follow with a share `effort` of its torque.
    """

    def __init__(self, setup: Setup, gains: ShapedGains, kind: str) -> None:
        super().__init__(setup)
        self.gains, self.kind = gains, kind
        self.kp, self.kd = gains.on(setup)

    def initialise(self, signals: Signals, to_go: Array) -> None:
        arm = self.setup.arm
        shapers = [closed_loop_shaper(arm, self.gains, self.kind, posture) for posture in postures(self.goal)]
        inertia = rigid_inertia(arm, self.goal[:, 1:])
        self.shape(shapers, rigid_times(inertia, to_go, self.gains.effort * self.limits), to_go)

    def torques(self, signals: Signals, to_go: Array) -> Array:
        left, rates, accelerations = self.reference()
        angles = self.goal - left
        inertia = rigid_inertia(self.setup.arm, angles[:, 1:])
        forward = np.einsum("nij,nj->ni", inertia, accelerations) + coriolis(self.setup.arm, angles[:, 1:], rates)
        torques: Array = forward + self.kp * (to_go - left) + self.kd * (rates - signals.rates)
        return torques


@dataclass(frozen=True)
class SpatialShapedGains(SpatialPDGains):
    """Those of the PD, `effort`: share of the torque limit for the reference, and `modes` that it is shaped for, at
    most."""

    effort: float
    modes: int


def shaper_in_space(arm: Arm, gravity: Array, gains: SpatialShapedGains, kind: str, angles: Array) -> Shaper:
    """Impulses for the slowest lightly damped modes of the arm under PD control with filtered rates, about its rest
    with joints at angles (N,)."""
    free, joints, A = held_model(arm, gravity, angles)
    N, filter_rate = arm.n_links, 1.0 / gains.lag
    inertia = np.diag(np.diag(holding(arm, gravity, angles[None])[1][0]))
    rates = np.array([free.C[free.outputs.index(f"joint{k}_rate")] for k in range(N)])
    spring, damper = gains.rate**2 * inertia, 2.0 * gains.ratio * gains.rate * inertia
    filtered = np.hstack([filter_rate * rates, -filter_rate * np.eye(N)])
    closed = np.vstack([np.hstack([A - free.B @ spring @ joints, -free.B @ damper]), filtered])
    return cascade(closed, kind, gains.modes)


def coriolis_in_space(arm: Arm, gravity: Array, angles: Array, rates: Array) -> Array:
    """Torques (n, N), N m, of the rigid arm at angles and rates (n, N), without acceleration: what the changes of its
    inertia M with the angles ask for, (d/dt M) rates - 1/2 grad (rates . M rates)."""
    step, N = 1e-5, arm.n_links
    ways = np.concatenate([np.eye(N)[:, None] * np.ones((1, len(angles), 1)), rates[None]])
    ends = [holding(arm, gravity, (angles + sign * step * ways).reshape(-1, N))[1] for sign in (1.0, -1.0)]
    slopes = ((ends[0] - ends[1]) / (2.0 * step)).reshape(N + 1, -1, N, N)
    grown = np.einsum("nij,nj->ni", slopes[N], rates)
    found: Array = grown - 0.5 * np.einsum("knij,ni,nj->nk", slopes[:N], rates, rates)
    return found


class SpatialShapedPD(Shaped, SpatialPD):
    """What holds the arm, a PD about a shaped reference (see `ShapedPD`), and what the rigid arm needs for it."""

    def __init__(self, setup: Setup, gains: SpatialShapedGains, kind: str) -> None:
        SpatialPD.__init__(self, setup, gains)
        self.shaped, self.kind = gains, kind

    def initialise(self, signals: Signals, to_go: Array) -> None:
        SpatialPD.initialise(self, signals, to_go)
        shapers = [shaper_in_space(self.setup.arm, self.gravity, self.shaped, self.kind, goal) for goal in self.goal]
        self.shape(shapers, rigid_times(self.inertia, to_go, self.shaped.effort * self.limits), to_go)

    def torques(self, signals: Signals, to_go: Array) -> Array:
        left, rates, accelerations = self.reference()
        arm, angles = self.setup.arm, self.goal - left
        inertia = holding(arm, self.gravity, angles, self.bodies)[1]
        moved = np.einsum("nij,nj->ni", inertia, accelerations) + coriolis_in_space(arm, self.gravity, angles, rates)
        found: Array = self.forward(to_go) + moved + self.pulled(signals, to_go - left, rates)
        return found
