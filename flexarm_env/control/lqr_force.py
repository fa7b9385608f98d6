"""LQR with the integrals of the force error and of the position error along the wall (task "press").

The linear model contains the arm about rest, a spring between tip and wall with sliding friction, and two integrators.
Sliding friction couples the forces along and normal to the wall. With a model without friction, the loop would be
unstable for one direction of the path. One Riccati equation gives all gains. Integral action in linear-quadratic
control follows Young & Willems (1972).
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from .. import validation as check
from ..geometry.plane import tip_in_hub_frame
from ..linear.state_space import held
from ..parameters import Arm
from ..validation import Array
from .arm_model import GRID, ArmModel, arm_model, postures
from .base import Setup
from .force import Approach, PressController, View, feedback
from .lqr import LQRGains, riccati


@dataclass(frozen=True, kw_only=True)
class LQRForceGains(Approach):
    """Gains of the controller `LQRForce`.

    Args:
        angle, rate, bend, bend_rate: weights of the arm's state; see `lqr.StateWeights`.
        path: weight, 1/s, of the time integral of (distance from the path / arm's length).
        force: weight, 1/s, of the time integral of (force error / largest tip force that the motors can hold).
        stiffness: assumed stiffness of the wall, multiplied by the arm's length and divided by the largest tip force.
    """

    angle: float = 10.0
    rate: float = 5.0
    bend: float = 0.1562
    bend_rate: float = 0.3423
    path: float = 5.0
    force: float = 0.2
    stiffness: float = 400.0


class LQRForce(PressController):
    """Linear-quadratic feedback of state and integrated errors about an arm that presses on the wall."""

    def __init__(self, setup: Setup, gains: LQRForceGains | None = None) -> None:
        """Store the gains; see `PressController`."""
        self.timing = self.gains = LQRForceGains() if gains is None else check.instance("gains", gains, LQRForceGains)
        super().__init__(setup)
        self._weights = LQRGains(self.gains.angle, self.gains.rate, self.gains.bend, self.gains.bend_rate)

    def forget(self) -> None:
        self._sums = np.zeros((len(self.goal), 2))

    def pressing(self, view: View) -> Array:
        # the tip at rest is inside the wall: delta = 3/2 F / (dF/d delta) for F = k delta^(3/2)
        slope = self.gains.stiffness * self.most / self.setup.arm.total_length
        depth = 1.5 * view.commanded * view.share / slope
        off, holding = self._rest(view, view.normal * depth[:, None], 0.0)
        # integrals of the errors along the wall, over L, and of the force, over F_max
        error = -(view.to_target * view.along).sum(axis=1) / self.setup.arm.total_length
        excess = (view.force - view.commanded) / self.most
        touching = self._touching(view)
        self._sums += (self.setup.control_dt * touching)[:, None] * np.stack([error, excess], axis=1)
        # before the force has risen: the state feedback alone
        found = feedback(self.setup, self._weights, self.goal, off)
        for i in np.flatnonzero(touching).tolist():
            found[i] = self._pressed(view, i, off[i], holding[i])
        return holding - found

    def _touching(self, view: View) -> Array:
        """Return 1 for each arm that the model of an arm on the wall describes, 0 for the others; (n,)."""
        return view.touching

    def _pressed(self, view: View, i: int, off: Array, holding: Array) -> Array:
        """Return torques (N,), N m, of arm i that are subtracted from the torques `holding` at the reference.

        off (4 N,): the arm's outputs minus those at the reference.
        """
        setup, goal = self.setup, self.goal[i]
        (posture,) = postures(goal[None])
        # the design's posture bends its first bent elbow to the left; mirror all other postures
        bent = np.round(goal[1:] / GRID)
        mirror = next((float(np.sign(elbow)) for elbow in bent if elbow != 0.0), 1.0)
        (ax, ay), (nx, ny) = view.along[i], view.normal[i]
        bearing = mirror * (np.arctan2(ny, nx) - goal[0])
        bearing = float(np.round(((bearing + np.pi) % (2.0 * np.pi) - np.pi) / GRID) * GRID)
        # the design's tangent is its normal turned by a quarter to the left
        side = mirror * float(np.sign(nx * ay - ny * ax))
        model = wall_model(
            setup.arm,
            setup.torque_limits,
            setup.control_dt,
            self.gains,
            posture,
            bearing,
            self.most,
            side * self.friction,
        )
        x = np.concatenate([mirror * off, self._sums[i] * (side, 1.0)])
        return np.asarray(mirror * self._feedback(model, x, mirror * holding))

    def _feedback(self, model: "WallModel", x: Array, holding: Array) -> Array:
        """Return torques (N,), N m, that are subtracted from the torques `holding` (N,). x: outputs and sums."""
        return np.asarray(model.gains @ x)


class WallModel(NamedTuple):
    """Discrete model x+ = A x + B u of an arm that touches a wall, and its linear-quadratic regulator.

    Attributes:
        A, B: matrices of the modal states and the two integrated errors, for torques u (N,), N m.
        K (N, S), P (S, S): gains of the regulator and matrix of its cost x' P x. W (N, N): the cost increases by c' W c
            if the torques of one period differ by c from the regulator's torques.
        states (S, 4 N + 2): matrix that computes the state from outputs and integrated errors. gains (N, 4 N + 2): K
            times `states`.
    """

    A: Array
    B: Array
    K: Array
    P: Array
    W: Array
    states: Array
    gains: Array


@lru_cache(maxsize=4096)
def wall_model(
    arm: Arm, limits: tuple[float, ...], dt: float, gains: LQRForceGains, posture: tuple[float, ...], bearing: float,
    most: float, friction: float,
) -> WallModel:  # fmt: skip
    """Return the model of an arm that touches a wall, with gains for its outputs and for two integrated errors.

    The integrated errors are the position error along the wall and the force error. The arm's state is computed from
    the outputs by `ArmModel.state_of`.

    limits (N,): torque limits, N m. dt: control period, s. posture: elbow angles, rad. bearing: direction, rad, in the
    hub's frame, of the wall's normal that points away from the root. most: largest tip force, N. friction: coefficient
    of friction, negative if the tip slides in the direction of this normal turned by -90 degrees.
    """
    model = arm_model(arm, posture)
    n, N, size = len(model.A) // 2, model.n_joints, len(model.A)
    normal = np.array([np.cos(bearing), np.sin(bearing)])
    rows = _tip_rows(arm, model, posture)
    across, along = normal @ rows, np.array([-normal[1], normal[0]]) @ rows
    # the wall as a spring with sliding friction: q'' = ... - M^-1 (c_n + mu s c_t)' k c_n q
    stiffness = gains.stiffness * most / arm.total_length
    A = np.zeros((size + 2, size + 2))
    A[:size, :size] = model.A
    A[n:size, :n] -= stiffness * np.outer(_inverse_mass(model) @ (across + friction * along), across)
    # integrals of e / L and f / F_max
    A[size, :n], A[size + 1, :n] = along / arm.total_length, stiffness / most * across
    A, B = held(A, np.concatenate([model.B, np.zeros((2, N))]), dt)
    Q = np.zeros((size + 2, size + 2))
    weights = LQRGains(gains.angle, gains.rate, gains.bend, gains.bend_rate)
    Q[:size, :size] = weights.stage(model.C, float(model.frequencies[0]), N)
    Q[size, size], Q[size + 1, size + 1] = gains.path**2, gains.force**2
    R = np.diag(1.0 / np.asarray(limits) ** 2)
    K, P = riccati(A, B, Q, R)
    states = model.state_of(np.eye(len(model.C))).T
    whole = np.zeros((size + 2, states.shape[1] + 2))
    whole[:size, :-2], whole[size:, -2:] = states, np.eye(2)
    found = np.concatenate([K[:, :size] @ states, K[:, size:]], axis=1)
    return WallModel(A, B, K, P, R + B.T @ P @ B, whole, found)


def _tip_rows(arm: Arm, model: ArmModel, posture: tuple[float, ...]) -> Array:
    """Return the tip's displacement (2, n), m, per modal amplitude, in the hub's frame."""
    n, N, step = len(model.A) // 2, model.n_joints, 1e-5
    elbows, none = np.array([posture]), np.zeros((1, N))

    def difference(turn: Array, bend: Array) -> Array:
        ends = [tip_in_hub_frame(arm, elbows + sign * turn, none + sign * bend)[0] for sign in (step, -step)]
        return np.asarray((ends[0] - ends[1]) / (2.0 * step))

    # the hub turns the tip about the root; elbows and deflections by central differences
    x, y = tip_in_hub_frame(arm, elbows, none)[0]
    columns = [np.array([-y, x])]
    columns += [difference(unit, np.zeros(N)) for unit in np.eye(N - 1)]
    columns += [difference(np.zeros(N - 1), unit) for unit in np.eye(N)]
    rows = np.concatenate([model.C[:N, :n], model.C[2 * N : 3 * N, :n]])
    return np.asarray(np.stack(columns, axis=1) @ rows)


def _inverse_mass(model: ArmModel) -> Array:
    """Return the inverse (n, n) of the modal mass matrix, kg m^2.

    Torques act on the modes by the transposed rows of the joint angles, M B = C_joint'. The N rigid modes have a full
    block, the flexible modes are orthogonal.
    """
    n, N = len(model.A) // 2, model.n_joints
    joints, B = model.C[:N, :n], model.B[n:]
    found = np.zeros((n, n))
    found[:N, :N] = B[:N] @ np.linalg.inv(joints[:, :N].T)
    for i in range(N, n):
        found[i, i] = (B[i] @ joints[:, i]) / (joints[:, i] @ joints[:, i])
    return found
