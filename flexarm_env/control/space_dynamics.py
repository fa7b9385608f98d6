"""Control periods of an arm in space as a function of its state and torques, on the elastica there."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import validation as check
from ..parameters import Arm
from ..physics.space.reading import read
from .dynamics import IN_SPACE, Dynamics, Vector
from .lqr import StateWeights, riccati
from .space_pd import held_model, holding

Array = NDArray[np.float64]

STEP = 1e-5
"""Of differences: rad, and of strains."""

GENTLE = StateWeights(1.0, 0.5, 1.0, 0.5)
"""Of regulators that bring the arm home from afar."""

NEWTON = 8
"""Steps to where the arm rests."""


class SpatialDynamics(Dynamics):
    """`Dynamics` of an arm on a base that is held, under gravity.

    q of a link are its joint's angle, then its strains: `nodes` - 1 polynomials of torsion, bending about y and z.
    Deflections are those of its flexible links along y, then z, over their lengths, then their twists, rad.
    """

    step = 0.005

    def __init__(self, arm: Arm, period: float, nodes: int, gravity: Vector) -> None:
        strains = 3 * (nodes - 1)
        counts = [1 if link.rigid else 1 + strains for link in arm.links]
        rows = 6 + np.arange(sum(counts))  # behind those of the base
        self.gravity = gravity
        self._begin(arm, period, nodes, np.cumsum([0, *counts[:-1]]), rows)
        self._bending = [k for k, link in enumerate(arm.links) if not link.rigid]
        self._strains = np.setdiff1d(np.arange(self.half), self.joints)

    def rest(self, angles: ArrayLike) -> Array:
        """States (m, S) of the arm at rest, bent by its weight, at joint angles (m, N)."""
        return self.still(angles)[0]

    def still(self, angles: ArrayLike) -> tuple[Array, Array]:
        """See `Dynamics.still`: what a period does not move, by Newton's method."""
        x, n = self.unbent(angles), self.n_inputs
        u, half = np.zeros((len(x), n)), self.half
        u[:] = holding(self.arm, np.array(self.gravity), x[:, self.joints])[0] / self.limits
        weight = np.repeat([1.0 / self.period, 1.0], half)
        for _ in range(NEWTON):
            A, B = self.jacobians(x, u)
            off = (self.advance(x, u) - x) * weight
            slope = np.concatenate([(A - np.eye(self.size))[:, :, self._strains], B], axis=2) * weight[:, None]
            step = -np.linalg.pinv(slope) @ off[:, :, None]
            x[:, self._strains] += step[:, :-n, 0]
            u += step[:, -n:, 0]
        return x, u

    def unbent(self, angles: ArrayLike) -> Array:
        """States (m, S) of the straight arm without motion, at joint angles (m, N)."""
        angles = np.asarray(angles, np.float64)
        if angles.ndim != 2 or angles.shape[1] != self.n_inputs:
            what = f"must be (m, {self.n_inputs}), a row an arm"
            raise check.InvalidValue("shape of joint angles", angles.shape, what)
        x = np.zeros((len(angles), self.size))
        x[:, self.joints] = angles
        return x

    def homing(self, x: Array, u: Array) -> Array:
        """Gains (m, N, S) of gentle regulators, u - K dx, about rest at states (m, S) that torques u (m, N) hold."""
        C, n = self.outputs(np.zeros((1, self.size)))[1][0], self.n_inputs
        stage = C.T @ np.diag(GENTLE.of_outputs(self.first, n, len(C) // 2 - n) ** 2) @ C + 1e-6 * np.eye(self.size)
        return np.stack([riccati(A, B, stage, np.eye(n))[0] for A, B in zip(*self.jacobians(x, u), strict=True)])

    def begun(self, start: Array, goal: Array, periods: int) -> Array:
        """What gentle regulators do: torques that are held would let an arm fall."""
        home, held = self.still(goal[:, self.joints])
        K, x, controls = self.homing(home, held), start, np.zeros((periods, *held.shape))
        for k in range(periods):
            controls[k] = np.clip(held - (K @ (x - home)[:, :, None])[:, :, 0], -1.0, 1.0)
            x = self.advance(x, controls[k])
        return controls

    def inertia(self, angles: Array) -> Array:
        """(m, N, N), kg m^2: of the rigid arm about its joints at angles (m, N)."""
        return holding(self.arm, np.array(self.gravity), angles)[1]

    @property
    def first(self) -> float:
        """Lowest frequency of bending of the arm at joint angles 0, its joints free, rad/s."""
        n = self.n_inputs
        A = held_model(self.arm, np.array(self.gravity), np.zeros(n))[2]
        return float(np.sqrt(np.sort(-np.linalg.eigvals(A[len(A) // 2 :, : len(A) // 2]).real)[n]))

    def tip(self, x: Array) -> tuple[Array, Array]:
        """Tip (..., 3), m, about the root, and its derivative (..., 3, S)."""
        place, slope = self.points(x)
        return place[..., -1, :], slope[..., -1, :, :]

    def points(self, x: Array) -> tuple[Array, Array]:
        """Sections of all links and their tips, (..., P, 3), m about the root, and their derivative by x."""
        return self._seen(x, "shapes")

    def places(self, x: Array) -> Array:
        """`points` without the derivative."""
        found = self._read(x[..., : self.half].reshape(-1, self.half), "shapes")
        return found.reshape(*x.shape[:-1], *found.shape[1:])

    def bends(self, x: Array) -> tuple[Array, Array]:
        """Deflections over length and twists (..., 3 F), and their derivative (..., 3 F, S)."""
        return self._seen(x, "bends")

    def _seen(self, x: Array, what: str) -> tuple[Array, Array]:
        """Values (..., *) and derivative (..., *, S), by differences."""
        q = x[..., : self.half].reshape(-1, self.half)
        ways = STEP * np.concatenate([np.zeros((1, self.half)), np.eye(self.half), -np.eye(self.half)])
        found = self._read((q + ways[:, None]).reshape(-1, self.half), what)
        found = found.reshape(len(ways), *x.shape[:-1], *found.shape[1:])
        slope = np.zeros((*found.shape[1:], self.size))
        ends = found[1 : 1 + self.half] - found[1 + self.half :]
        slope[..., : self.half] = np.moveaxis(ends, 0, -1) / (2.0 * STEP)
        return found[0], slope

    def _read(self, q: Array, what: str) -> Array:
        """(m, P, 3): points; (m, 3 F): deflections and twists."""
        rows = np.zeros((len(q), 6 + self.half))
        rows[:, 6:] = q
        found = read(self.arm, self.settings, rows, np.zeros_like(rows))
        if what == "shapes":
            return np.asarray(found["shapes"][:, 1:])
        bent, twist = found["tip_deflection"][:, self._bending], found["twist"][:, self._bending]
        return np.concatenate([bent[..., 0], bent[..., 1], twist], axis=1)


IN_SPACE.append(SpatialDynamics)
