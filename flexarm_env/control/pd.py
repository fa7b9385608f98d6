"""PD control of the joints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..parameters import Arm
from .arm_model import arm_model
from .base import Controller, Setup, Signals

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PDGains:
    """Dimensionless gains of the joints, so that they carry over to an arm of another size.

    Args:
        bandwidth (N,): rigid natural frequency of joint i under its own spring, over the first flexible frequency.
        ratio (N,): rigid damping ratio of joint i.
    """

    bandwidth: tuple[float, ...]
    ratio: tuple[float, ...]

    def of(self, arm: Arm) -> tuple[Array, Array]:
        """kp (N,) in N m/rad and kd (N,) in N m s/rad for an arm, from its inertia with the elbows at a right angle."""
        model = arm_model(arm, (0.5 * np.pi,) * (arm.n_links - 1))
        inertia = np.diag(model.inertia)
        omega = np.asarray(self.bandwidth) * model.frequencies[0]
        return inertia * omega**2, 2.0 * np.asarray(self.ratio) * inertia * omega


class PD(Controller):
    """torque = kp (goal - angle) - kd rate, joint by joint."""

    def __init__(self, setup: Setup, gains: PDGains) -> None:
        super().__init__(setup)
        self.kp, self.kd = gains.of(setup.arm)

    passed = 1.0
    """Of a change of the rates, by the filter of one period, where there is one."""

    def torques(self, signals: Signals, to_go: Array) -> Array:
        return self.kp * to_go - self.kd * signals.rates

    def towards(self, wanted: Array, angles: Array, rates: Array) -> Array:
        """Torques (N,), N m, that turn joints at angles, with filtered rates, to the angles wanted, all (N,)."""
        found: Array = self.kp * (wanted - angles) - self.kd * rates
        return found
