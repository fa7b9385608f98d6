"""Linear-quadratic control with an observer: joints and bending modes together, in discrete time."""

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ..parameters import Arm
from ..validation import Array
from .arm_model import ArmModel, arm_model, postures
from .base import Controller, Gains, Setup, Signals


@dataclass(frozen=True)
class StateWeights(Gains):
    """Dimensionless weights, beside a weight of 1 on each torque over its limit.

    Args:
        angle: on joint angles (1/rad). rate: on joint rates over the first flexible frequency.
        bend: on tip deflections over length. bend_rate: on their rates over that frequency.
    """

    angle: float
    rate: float
    bend: float
    bend_rate: float

    def stage(self, C: Array, first: float, joints: int) -> Array:
        """(S, S): cost of a state, by rows C (O, S) of so many angles, their rates, deflections and their rates; first:
        the model's first flexible frequency, rad/s."""
        many = len(C) // 2 - joints
        weights = [self.angle, self.rate / first, self.bend, self.bend_rate / first]
        own = np.diag(np.repeat(weights, [joints, joints, many, many]) ** 2)
        return np.asarray(C.T @ own @ C + 1e-6 * np.eye(C.shape[1]))


@dataclass(frozen=True)
class LQRGains(StateWeights):
    """`StateWeights`, and the observer's.

    Args:
        noise: of the torque that the observer allows for, over the limit.
        flexible: bending modes in the model; None: one more than joints.
    """

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


def riccati(A: Array, B: Array, Q: Array, R: Array) -> tuple[Array, Array]:
    """K and P of the discrete Riccati equation: u = -K x costs x' P x."""
    from scipy.linalg import solve_discrete_are

    P = solve_discrete_are(A, B, Q, R)
    return np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A), P


@lru_cache(maxsize=1024)
def design(arm: Arm, limits: tuple[float, ...], dt: float, gains: LQRGains, posture: tuple[float, ...] = ()) -> Design:
    """Regulator and observer gains from the discrete Riccati equations, the elbows at a posture in rad."""
    from scipy.linalg import solve_discrete_are

    model = arm_model(arm, posture, gains.flexible)
    n = model.n_joints
    A, B = model.discrete(dt)
    C = model.C
    first = model.frequencies[0]
    K, _ = riccati(A, B, gains.stage(C, first, n), np.diag(1.0 / np.asarray(limits) ** 2))
    W = B @ np.diag((gains.noise * np.asarray(limits)) ** 2) @ B.T + 1e-10 * np.eye(len(A))
    V = np.diag(np.repeat([SENSOR, SENSOR * first, SENSOR, SENSOR * first], n) ** 2)
    S = solve_discrete_are(A.T, C.T, W, V)
    L = np.linalg.solve(C @ S @ C.T + V, C @ S).T
    return Design(A, B, C, K, L, model)


class Observer:
    """States of many arms, each about its own goal, from their outputs; one design an arm."""

    def __init__(self, designs: list[Design], outputs: Array) -> None:
        matrices = zip(*(d[:5] for d in designs), strict=True)
        self.A, self.B, self.C, self.K, self.L = (np.stack(one) for one in matrices)
        self.x = np.stack([d.model.state_of(y) for d, y in zip(designs, outputs, strict=True)])

    def update(self, outputs: Array) -> None:
        """Take in the outputs (n, 4 N) measured now."""
        self.x = self.x + times(self.L, outputs - times(self.C, self.x))

    def predict(self, torques: Array) -> None:
        """One period on, under these torques (n, N)."""
        self.x = times(self.A, self.x) + times(self.B, torques)


def times(matrices: Array, vectors: Array) -> Array:
    """Products (n, i) of matrices (n, i, j) and vectors (n, j)."""
    product: Array = (matrices @ vectors[:, :, None])[:, :, 0]
    return product


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

    def initialise(self, signals: Signals, to_go: Array) -> None:
        self.observer = Observer(self.designs(), signals.outputs(-to_go))

    def torques(self, signals: Signals, to_go: Array) -> Array:
        self.observer.update(signals.outputs(-to_go))
        return -times(self.observer.K, self.observer.x)

    def predict(self, torques: Array) -> None:
        self.observer.predict(torques)
