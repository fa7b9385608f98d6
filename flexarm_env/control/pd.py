"""PD control of the joints: in the plane, and in space about the arm's rest at its target under gravity."""

import warnings
from dataclasses import dataclass

import numpy as np

from .. import validation as check
from ..parameters import Arm
from ..validation import Array
from .arm_model import arm_model
from .base import Controller, Gains, Setup, Signals
from .space import AboutRest, holding

POSTURES = (0.0, 0.8, 1.6, 2.4)
"""Angles of elbows, rad, at which PD control is asked to be stable, where they may be so bent."""


@dataclass(frozen=True)
class PDGains(Gains):
    """Dimensionless gains of the joints, so that they carry over to an arm of another size.

    Args:
        bandwidth (N,): rigid natural frequency of joint i under its own spring, over the first flexible frequency.
        ratio (N,): rigid damping ratio of joint i. One number alone is every joint's.
    """

    bandwidth: tuple[float, ...]
    ratio: tuple[float, ...]

    def of(self, arm: Arm) -> tuple[Array, Array]:
        """kp (N,) in N m/rad and kd (N,) in N m s/rad for an arm, from its inertia with the elbows at a right angle."""
        for name, given in (("bandwidth", self.bandwidth), ("ratio", self.ratio)):
            if np.size(given) not in (1, arm.n_links):
                raise check.InvalidValue(f"pd.{name}", given, f"must be one number, or {arm.n_links}, one a joint")
        model = arm_model(arm, (0.5 * np.pi,) * (arm.n_links - 1))
        inertia = np.diag(model.inertia)
        omega = np.asarray(self.bandwidth) * model.frequencies[0]
        return inertia * omega**2, 2.0 * np.asarray(self.ratio) * inertia * omega

    def on(self, setup: Setup) -> tuple[Array, Array]:
        """`of` the setup's arm; a warning where that is not `stable`."""
        if not self.stable(setup):
            what = f"PD gains are unstable on arm {setup.arm.name!r} in periods of {setup.control_dt:g} s"
            warnings.warn(f"{what}: tune them for it (flexarm tune), or take lqr", UserWarning, stacklevel=4)
        return self.of(setup.arm)

    def stable(self, setup: Setup, factor: float = 1.0) -> bool:
        """Whether the linear arm under these gains times a factor, held over control periods, is stable in all of
        `POSTURES`."""
        kp, kd = self.of(setup.arm)
        limits = [pair for pair in (setup.arm.joint_limits or ())[1:] if pair is not None]
        for angle in POSTURES if setup.n_joints > 1 else (0.0,):
            if any(not low <= angle <= high for low, high in limits):
                continue
            model = arm_model(setup.arm, (angle,) * (setup.n_joints - 1))
            n = model.n_joints
            A, B = model.discrete(setup.control_dt)
            feedback = np.diag(kp) @ model.C[:n] + np.diag(kd) @ model.C[n : 2 * n]
            if np.abs(np.linalg.eigvals(A - factor * B @ feedback)).max() >= 1.0:
                return False
        return True


class PD(Controller):
    """torque = kp (goal - angle) - kd rate, joint by joint."""

    def __init__(self, setup: Setup, gains: PDGains) -> None:
        super().__init__(setup)
        self.kp, self.kd = gains.on(setup)

    passed = 1.0
    """Of a change of the rates, by the filter of one period, where there is one."""

    def torques(self, signals: Signals, to_go: Array) -> Array:
        return self.kp * to_go - self.kd * signals.rates

    def towards(self, wanted: Array, angles: Array, rates: Array) -> Array:
        """Torques (N,), N m, that turn joints at angles, with filtered rates, to the angles wanted, all (N,)."""
        found: Array = self.kp * (wanted - angles) - self.kd * rates
        return found


@dataclass(frozen=True)
class SpatialPDGains(Gains):
    """rate: rad/s, of each joint under its spring, others still. ratio: of damping. lag: s, of the filter of rates: a
    beam's root turns so lightly that what is sampled of it must not come back at once."""

    rate: float
    ratio: float
    lag: float


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
        return self.forward(to_go) + self.pulled(signals, to_go)

    def pulled(self, signals: Signals, to_go: Array, rates: Array | float = 0.0) -> Array:
        """Torques (n, N), N m, towards joint angles and rates."""
        self.rates += self.passed * (signals.rates - rates - self.rates)
        found: Array = np.diagonal(self.inertia, axis1=1, axis2=2) * self._pull(to_go, self.rates)
        return found

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
