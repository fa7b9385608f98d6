"""The arm as its controllers know it: rigid inertia, and a few linear modes about rest in a given posture.

Everything a gain is derived from stands here; nothing is fitted to a simulation.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..mechanics.elastica import Chain, chain
from ..parameters import Arm

Array = NDArray[np.float64]

NODES = 8
"""Tangent angles a link from which the modes are taken; the frequencies kept are then converged."""


@dataclass(frozen=True)
class ArmModel:
    """Linear model of an arm about rest, its joints at given angles: a truncated set of modes, SI.

    States x (2 n,): amplitudes of the n lowest modes (the N rigid ones first), then their rates. Inputs: N joint
    torques. Outputs (4 N,): joint angles, joint rates, tip deflections over length, their rates.

    Attributes:
        A (2n, 2n), B (2n, N), C (4N, 2n): continuous time.
        frequencies (n - N,): of the flexible modes, joints free, rad/s. ratios (n - N,): their damping ratios.
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
        """A, B over one period dt with the torque held."""
        from scipy.linalg import expm

        n, m = self.B.shape
        block = np.zeros((n + m, n + m))
        block[:n, :n], block[:n, n:] = self.A, self.B
        power = expm(block * dt)
        return power[:n, :n], power[:n, n:]

    def state_of(self, outputs: Array) -> Array:
        """The state (..., 2n) of least strain and kinetic energy that has these outputs (..., 4N)."""
        n_joints, n = self.n_joints, len(self.A) // 2
        weight = np.concatenate([np.ones(n_joints), 1.0 / self.frequencies])
        half = np.concatenate([self.C[:n_joints, :n], self.C[2 * n_joints : 3 * n_joints, :n]])
        positions = weight[:, None] * np.linalg.pinv(half * weight)
        rates = np.linalg.pinv(half)
        angle, rate, bend, bend_rate = np.split(outputs, 4, axis=-1)
        q = np.concatenate([angle, bend], axis=-1) @ positions.T
        v = np.concatenate([rate, bend_rate], axis=-1) @ rates.T
        return np.concatenate([q, v], axis=-1)


@lru_cache(maxsize=256)
def arm_model(arm: Arm, posture: tuple[float, ...] = (), flexible: int = 2) -> ArmModel:
    """The arm's linear model about rest.

    Args:
        arm: the arm. posture: angles of joints 1 to N-1, rad (() is straight).
        flexible: modes kept beside the N rigid ones, at least 1.
    """
    from scipy.linalg import eigh

    parts = chain(arm, NODES)
    n_joints, size = arm.n_links, arm.n_links * NODES
    angles = np.repeat(np.concatenate([[0.0], np.cumsum(posture or np.zeros(n_joints - 1))]), NODES)
    M = (parts.P + arm.payload.mass * np.outer(parts.w, parts.w)) * np.cos(angles[:, None] - angles)
    K = np.zeros((size, size))
    for k in range(n_joints):
        own = slice(k * NODES, (k + 1) * NODES)
        M[own, own] += parts.R[k]
        K[own, own] += parts.K[k]
    tip = parts.lines[-1].tip_angle
    M[-NODES:, -NODES:] += arm.payload.inertia * np.outer(tip, tip)
    joints, bends = _outputs(parts)
    squares, modes = eigh(K, M, subset_by_index=[0, n_joints + flexible - 1])
    squares[:n_joints] = 0.0
    n = n_joints + flexible
    A, B, C = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, n_joints)), np.zeros((4 * n_joints, 2 * n))
    A[:n, n:] = np.eye(n)
    A[n:, :n] = -np.diag(squares)
    A[n:, n:] = -arm.tau_d * np.diag(squares)
    B[n:] = modes.T @ joints.T  # the torques work on the joint angles
    rows = np.stack([joints @ modes, bends @ modes])
    C[:n_joints, :n] = C[n_joints : 2 * n_joints, n:] = rows[0]
    C[2 * n_joints : 3 * n_joints, :n] = C[3 * n_joints :, n:] = rows[1]
    rigid = np.zeros((size, n_joints))
    for k in range(n_joints):
        rigid[k * NODES :, k] = 1.0
    frequencies = np.sqrt(squares[n_joints:])
    return ArmModel(A, B, C, frequencies, 0.5 * arm.tau_d * frequencies, rigid.T @ M @ rigid)


def _outputs(parts: Chain) -> tuple[Array, Array]:
    """Joint angles and tip deflections over length (N, Nn each) from the nodes' absolute angles."""
    count, size = len(parts.lines), parts.w.size
    joints, bends = np.zeros((count, size)), np.zeros((count, size))
    for k, line in enumerate(parts.lines):
        first = k * NODES
        joints[k, first] = 1.0
        if k > 0:
            joints[k, first - NODES : first] -= parts.lines[k - 1].tip_angle
        bends[k, first : first + NODES] = line.tip_weights / line.length
        bends[k, first] -= 1.0
    return joints, bends
