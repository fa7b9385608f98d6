"""Linear-quadratic control with an observer: joints and bending modes together, in discrete time."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..parameters import Arm
from .arm_model import ArmModel, arm_model, postures
from .base import Controller, Setup, Signals

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LQRGains:
    """Dimensionless weights, beside a weight of 1 on each torque over its limit.

    Args:
        angle: on joint angles (1/rad). rate: on joint rates over the first flexible frequency.
        bend: on tip deflections over length. bend_rate: on their rates over that frequency.
        noise: of the torque that the observer allows for, over the limit.
        flexible: bending modes in the model; None: one more than joints.
    """

    angle: float
    rate: float
    bend: float
    bend_rate: float
    noise: float = 0.05
    flexible: int | None = None


class Design(NamedTuple):
    """Discrete model and gains: x+ = A x + B u; y = C x; u = -K x; x += L (y - C x)."""

    A: Array
    B: Array
    C: Array
    K: Array
    L: Array
    model: ArmModel


SENSOR = 1e-3
"""Standard deviation of what the observer measures: angles (rad) and tip deflections over length as they stand, their
rates over the first flexible frequency."""


@lru_cache(maxsize=1024)
def design(arm: Arm, limits: tuple[float, ...], dt: float, gains: LQRGains, posture: tuple[float, ...] = ()) -> Design:
    """Regulator and observer gains from the discrete Riccati equations, the elbows at a posture in rad."""
    from scipy.linalg import solve_discrete_are

    model = arm_model(arm, posture, gains.flexible)
    n = model.n_joints
    A, B = model.discrete(dt)
    C = model.C
    first = model.frequencies[0]
    weights = np.repeat([gains.angle, gains.rate / first, gains.bend, gains.bend_rate / first], n)
    Q = C.T @ np.diag(weights**2) @ C + 1e-6 * np.eye(len(A))
    R = np.diag(1.0 / np.asarray(limits) ** 2)
    P = solve_discrete_are(A, B, Q, R)
    K = np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)
    W = B @ np.diag((gains.noise * np.asarray(limits)) ** 2) @ B.T + 1e-10 * np.eye(len(A))
    V = np.diag(np.repeat([SENSOR, SENSOR * first, SENSOR, SENSOR * first], n) ** 2)
    S = solve_discrete_are(A.T, C.T, W, V)
    L = np.linalg.solve(C @ S @ C.T + V, C @ S).T
    return Design(A, B, C, K, L, model)


class Observer:
    """States of many arms, each about its own goal, from their outputs; one design an arm."""

    def __init__(self, designs: list[Design], outputs: Array) -> None:
        self.A = np.stack([d.A for d in designs])
        self.B = np.stack([d.B for d in designs])
        self.C = np.stack([d.C for d in designs])
        self.K = np.stack([d.K for d in designs])
        self.L = np.stack([d.L for d in designs])
        self.x = np.stack([d.model.state_of(y) for d, y in zip(designs, outputs, strict=True)])

    def update(self, outputs: Array) -> None:
        """Take in the outputs (n, 4 N) measured now."""
        self.x = self.x + _times(self.L, outputs - _times(self.C, self.x))

    def predict(self, torques: Array) -> None:
        """One period on, under these torques (n, N)."""
        self.x = _times(self.A, self.x) + _times(self.B, torques)


def _times(matrices: Array, vectors: Array) -> Array:
    product: Array = (matrices @ vectors[:, :, None])[:, :, 0]
    return product


def outputs_about_goal(signals: Signals, to_go: Array) -> Array:
    """Outputs (n, 4 N) of the linear model about the goal."""
    return np.concatenate([-to_go, signals.rates, signals.bends, signals.bend_rates], axis=1)


class LQR(Controller):
    """u = -K x, x from the observer; gains of the posture at the goal."""

    needs_bends = True

    def __init__(self, setup: Setup, gains: LQRGains) -> None:
        super().__init__(setup)
        self.gains = gains

    def designs(self) -> list[Design]:
        """The design of each arm, from its elbows' angles at the goal (a mirrored posture has the same)."""
        setup = self.setup
        return [
            design(setup.arm, setup.torque_limits, setup.control_dt, self.gains, posture)
            for posture in postures(self.goal)
        ]

    def begin(self, signals: Signals, to_go: Array) -> None:
        self.observer = Observer(self.designs(), outputs_about_goal(signals, to_go))

    def torques(self, signals: Signals, to_go: Array) -> Array:
        self.observer.update(outputs_about_goal(signals, to_go))
        return -_times(self.observer.K, self.observer.x)

    def applied(self, torques: Array) -> None:
        self.observer.predict(torques)
