"""Linear arm models for controller design: rigid inertia and the lowest modes about rest in a given posture.

The models are derived from `flexarm_env.linear` and are not fitted to simulations.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from .. import validation as check
from ..linear.state_space import LinearModel, held, linearize
from ..parameters import Arm
from ..scene import Scene
from ..validation import Array

NODES = 7
"""Number of tangent angles per link in the elastica model that yields the modes; with it the retained frequencies are
converged."""


GRID = 0.1
"""Spacing, rad, of the elbow angles for which controllers are designed."""


def postures(goals: Array) -> list[tuple[float, ...]]:
    """Round the elbow angles of goals (n, N), rad, to the design grid; return a tuple of N - 1 angles for each goal.

    A posture and its mirror image have the same model, so the function returns the posture whose first bent elbow has a
    positive angle.
    """
    # joint 0, the hub, does not affect the model
    elbows = np.round(goals[:, 1:] / GRID) * GRID
    # mirrored arms have the same model: the first bent elbow of the key is positive
    mirrored = [next((angle for angle in row if angle != 0.0), 1.0) < 0.0 for row in elbows.tolist()]
    return [tuple((0.0 + row * (-1.0 if flip else 1.0)).tolist()) for row, flip in zip(elbows, mirrored, strict=True)]


@dataclass(frozen=True)
class ArmModel:
    """Linear model x' = A x + B u, y = C x of an arm about rest in a posture, reduced to its lowest modes; SI units.

    States x (2 n,): amplitudes of the n lowest modes (the N rigid modes first), then their rates. Inputs u are the N
    joint torques, N m. Outputs y (4 N,): joint angles (rad), joint rates, tip deflections divided by link length, and
    the rates of the divided deflections.

    Attributes:
        A (2n, 2n), B (2n, N), C (4N, 2n): matrices of the continuous-time model.
        frequencies (n - N,): frequencies of the flexible modes with free joints, rad/s. ratios (n - N,): damping ratios
            of these modes.
        inertia (N, N): rigid inertia about the joints, kg m^2.
    """

    A: Array
    B: Array
    C: Array
    frequencies: Array
    ratios: Array
    inertia: Array

    @property
    def n_joints(self) -> int:
        """Number of joints N."""
        return int(self.B.shape[1])

    def discrete(self, dt: float) -> tuple[Array, Array]:
        """Return the zero-order-hold discretization (A, B) over one period dt, s."""
        return held(self.A, self.B, dt)

    def state_of(self, outputs: Array) -> Array:
        """Return the state (..., 2n) that has the given outputs (..., 4N) and the smallest energy.

        The amplitudes q of the modes minimize |q_rigid|^2 + sum_i (omega_i q_i)^2, summed over the flexible modes i.
        The rates q' minimize |q'|^2.
        """
        n_joints, n = self.n_joints, len(self.A) // 2
        # W = diag(1, 1/omega): q = W (H W)^+ y minimizes |W^-1 q| subject to H q = y
        weight = np.concatenate([np.ones(n_joints), 1.0 / self.frequencies])
        half = np.concatenate([self.C[:n_joints, :n], self.C[2 * n_joints : 3 * n_joints, :n]])
        positions = weight[:, None] * np.linalg.pinv(half * weight)
        rates = np.linalg.pinv(half)
        angle, rate, bend, bend_rate = np.split(outputs, 4, axis=-1)
        q = np.concatenate([angle, bend], axis=-1) @ positions.T
        v = np.concatenate([rate, bend_rate], axis=-1) @ rates.T
        return np.concatenate([q, v], axis=-1)


def linear_model(arm: Arm, posture: tuple[float, ...], **options: Any) -> LinearModel:
    """Linearize the elastica model of an arm about rest at a posture, with gears without backlash.

    posture: elbow angles, rad; () is the straight arm. options: keyword arguments of `linear.linearize`.
    """
    # absolute link angles, the hub at 0
    angles = (0.0, *np.cumsum(posture or np.zeros(arm.n_links - 1)).tolist())
    scene = Scene("design", arm.taut, angles=angles, duration=1.0, dt=1e-3)
    return linearize(scene, "elastica", nodes=NODES, **options)


@lru_cache(maxsize=256)
def arm_model(arm: Arm, posture: tuple[float, ...] = (), flexible: int | None = None) -> ArmModel:
    """Compute the linear model of an arm's lowest modes about rest.

    Args:
        arm: the arm. posture: angles of joints 1 to N-1, rad; () is the straight arm.
        flexible: number of flexible modes in addition to the N rigid modes, at least 1; None means N + 1.
    """
    n_joints, full = arm.n_links, linear_model(arm, posture)
    size = len(full.A) // 2
    # blocks of q'' = -M^-1 K q - M^-1 C q' + M^-1 B u
    stiffness, damping, force = -full.A[size:, :size], -full.A[size:, size:], full.B[size:]
    # modes by frequency; the N-dimensional null space of M^-1 K holds the rigid ones
    values, vectors = np.linalg.eig(stiffness)
    order = np.argsort(values.real)
    modes = np.hstack([np.linalg.svd(stiffness)[2][-n_joints:].T, vectors.real[:, order[n_joints:]]])
    n = n_joints + (n_joints + 1 if flexible is None else flexible)
    if n > size:
        raise check.InvalidValue("flexible", flexible, f"must be at most {size - n_joints}, as many as the model has")
    place = {name: i for i, name in enumerate(full.outputs)}
    # rows of joint angles and tip deflections by q; scale modes to a largest output of 1
    seen = full.C[[place[f"{what}{k}"] for what in ("joint", "deflection") for k in range(n_joints)], :size]
    modes = modes / np.abs(seen @ modes).max(axis=0)
    # truncate: the rows of Phi^-1 give the modal coordinates
    left, modes = np.linalg.inv(modes)[:n], modes[:, :n]
    squares = np.concatenate([np.zeros(n_joints), values.real[order[n_joints:n]]])
    A, B, C = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, n_joints)), np.zeros((4 * n_joints, 2 * n))
    A[:n, n:] = np.eye(n)
    A[n:, :n] = -np.diag(squares)
    # modal damping alone: couplings between modes are dropped, rigid modes are undamped
    A[n:, n:] = -np.diag(np.diag(left @ damping @ modes) * (squares > 0.0))
    B[n:] = left @ force
    # output matrix; deflections over the links' lengths
    lengths = np.array([[link.span] for link in arm.links])
    joints, bends = seen[:n_joints] @ modes, seen[n_joints:] @ modes / lengths
    C[:n_joints, :n] = C[n_joints : 2 * n_joints, n:] = joints
    C[2 * n_joints : 3 * n_joints, :n] = C[3 * n_joints :, n:] = bends
    frequencies = np.sqrt(squares[n_joints:])
    # rigid joint accelerations per torque are I^-1
    inertia = np.linalg.inv(joints[:, :n_joints] @ B[n : n + n_joints])
    return ArmModel(A, B, C, frequencies, -np.diag(A[n:, n:])[n_joints:] / (2.0 * frequencies), inertia)
