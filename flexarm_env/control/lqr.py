"""Discrete-time linear-quadratic regulator (LQR) with an observer, for joint angles and bending modes."""

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
    """Dimensionless weights of squared state variables in the cost; each torque divided by its limit has the weight 1.

    Args:
        angle: weight of joint angles (1/rad). rate: weight of joint rates divided by the first flexible frequency.
        bend: weight of tip deflections divided by length. bend_rate: weight of the deflections' rates divided by length
            and by the first flexible frequency.
    """

    angle: float
    rate: float
    bend: float
    bend_rate: float

    def stage(self, C: Array, first: float, joints: int) -> Array:
        """Compute the matrix Q (S, S) of the stage cost x' Q x.

        C (O, S): output matrix, with rows of `joints` joint angles, their rates, deflections, and deflection rates.
        first: the model's first flexible frequency, rad/s.
        """
        many = len(C) // 2 - joints
        weights = [self.angle, self.rate / first, self.bend, self.bend_rate / first]
        own = np.diag(np.repeat(weights, [joints, joints, many, many]) ** 2)
        # a small multiple of I makes Q positive definite
        return np.asarray(C.T @ own @ C + 1e-6 * np.eye(C.shape[1]))


@dataclass(frozen=True)
class LQRGains(StateWeights):
    """`StateWeights` of the regulator and parameters of the observer.

    Args:
        noise: standard deviation of the torque disturbance that the observer assumes, divided by the torque limit.
        flexible: number of flexible modes in the model; None: number of joints plus one.
    """

    noise: float = 0.05
    flexible: int | None = None


class Design(NamedTuple):
    """Discrete model and gains: x+ = A x + B u; y = C x; u = -K x; x += L (y - C x).

    A (2n, 2n), B (2n, N), C (4N, 2n), K (N, 2n), L (2n, 4N); model: the continuous `ArmModel`.
    """

    A: Array
    B: Array
    C: Array
    K: Array
    L: Array
    model: ArmModel


SENSOR = 1e-3
"""Standard deviation of the observer's measurements: angles (rad), tip deflections divided by length, and the rates of
both divided by the first flexible frequency."""


def riccati(A: Array, B: Array, Q: Array, R: Array) -> tuple[Array, Array]:
    """Solve the discrete algebraic Riccati equation: gain K (u = -K x) and cost matrix P (cost-to-go x' P x).

    A, B: matrices of the discrete model. Q, R: weights of states and inputs in the cost, the sum of x' Q x + u' R u.
    """
    from scipy.linalg import solve_discrete_are

    P = solve_discrete_are(A, B, Q, R)
    # K = (R + B' P B)^-1 B' P A
    return np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A), P


def spread_of(setup: Setup) -> tuple[float, ...]:
    """Return the standard deviations (4 N,), in SI units, of the measurement noise of the outputs; () without noise.

    The outputs are joint angles, joint rates, deflections, and deflection rates.
    """
    if not any(setup.noise):
        return ()
    of, joints = dict(zip(setup.names, setup.noise, strict=True)), setup.arm.joint_names
    # the noise of an angle is that of its sine
    names = [f"{joint}_sin" for joint in joints], [f"{joint}_rate" for joint in joints]
    bends = setup.arm.by_link("tip_deflection"), setup.arm.by_link("tip_deflection_rate")
    return tuple(of.get(name, 0.0) for group in (*names, *bends) for name in group)


@lru_cache(maxsize=1024)
def design(
    arm: Arm, limits: tuple[float, ...], dt: float, gains: LQRGains, posture: tuple[float, ...] = (),
    spread: tuple[float, ...] = (),
) -> Design:  # fmt: skip
    """Compute regulator and observer gains from the discrete Riccati equations at a posture (elbow angles, rad).

    limits (N,): torque limits, N m. dt: control period, s. spread: result of `spread_of`. The observer assumes this
    noise in addition to the measurement noise `SENSOR`.
    """
    from scipy.linalg import solve_discrete_are

    model = arm_model(arm, posture, gains.flexible)
    n = model.n_joints
    A, B = model.discrete(dt)
    C = model.C
    first = model.frequencies[0]
    # regulator: torques weighted by 1 / limit^2
    K, _ = riccati(A, B, gains.stage(C, first, n), np.diag(1.0 / np.asarray(limits) ** 2))
    # process noise through the torques, measurement noise; a small multiple of I keeps W regular
    W = B @ np.diag((gains.noise * np.asarray(limits)) ** 2) @ B.T + 1e-10 * np.eye(len(A))
    V = np.diag(np.repeat([SENSOR, SENSOR * first, SENSOR, SENSOR * first], n) ** 2)
    if spread:
        V = V + np.diag(np.square(spread))
    # stationary Kalman filter: covariance S of the prediction, L = S C' (C S C' + V)^-1
    S = solve_discrete_are(A.T, C.T, W, V)
    L = np.linalg.solve(C @ S @ C.T + V, C @ S).T
    return Design(A, B, C, K, L, model)


class Observer:
    """Observer that estimates the states of many arms, relative to each arm's goal, from their outputs."""

    def __init__(self, designs: list[Design], outputs: Array) -> None:
        """Stack the designs' matrices and start from the minimum-norm states with outputs (n, 4 N)."""
        matrices = zip(*(d[:5] for d in designs), strict=True)
        self.A, self.B, self.C, self.K, self.L = (np.stack(one) for one in matrices)
        self.x = np.stack([d.model.state_of(y) for d, y in zip(designs, outputs, strict=True)])

    def update(self, outputs: Array) -> None:
        """Correct the estimates with measured outputs (n, 4 N): x += L (y - C x)."""
        self.x = self.x + times(self.L, outputs - times(self.C, self.x))

    def predict(self, torques: Array) -> None:
        """Advance the estimates by one period under torques (n, N), N m: x = A x + B u."""
        self.x = times(self.A, self.x) + times(self.B, torques)


def times(matrices: Array, vectors: Array) -> Array:
    """Multiply n matrices (n, i, j) by n vectors (n, j); return the n products (n, i)."""
    product: Array = (matrices @ vectors[:, :, None])[:, :, 0]
    return product


class LQR(Controller):
    """State feedback u = -K x with the observer's estimate x; gains are designed at the posture of the goal."""

    needs_bends = True

    def __init__(self, setup: Setup, gains: LQRGains) -> None:
        super().__init__(setup)
        self.gains = gains

    def designs(self) -> list[Design]:
        """Return each arm's design for the elbow angles at its goal; mirrored postures have the same design."""
        setup = self.setup
        return [
            design(setup.arm, setup.torque_limits, setup.control_dt, self.gains, posture, spread_of(setup))
            for posture in postures(self.goal)
        ]

    def initialise(self, signals: Signals, to_go: Array) -> None:
        self.observer = Observer(self.designs(), signals.outputs(-to_go))

    def torques(self, signals: Signals, to_go: Array) -> Array:
        self.observer.update(signals.outputs(-to_go))
        return -times(self.observer.K, self.observer.x)

    def predict(self, torques: Array) -> None:
        self.observer.predict(torques)
