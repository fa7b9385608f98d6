"""Receding-horizon control: in every period the torques of the next ones are planned anew, and the first is applied.

The plan is that of `ilqr` on the elastica, within the torque limits, from the state as it is read to rest at the goal:
costs as in `lqr` over a horizon, and behind it those of the linear regulator at the goal. It goes on from the plan of
the period before, by a few iterations. Once the regulator stays within the limits by itself, it takes over.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..parameters import Arm
from . import ilqr
from .arm_model import GRID, arm_model
from .base import Controller, Setup, Signals
from .dynamics import Grid, dynamics
from .kinematics import rigid_inertia

Array = NDArray[np.float64]


@dataclass(frozen=True)
class MPCGains:
    """Dimensionless weights, beside a weight of 1 on each torque over its limit.

    Args:
        angle: on joint angles (1/rad). rate: on joint rates over the first flexible frequency.
        bend: on tip deflections over length. bend_rate: on their rates over that frequency.
        block: control periods over which planned torques are held. horizon: such blocks that are planned.
        iterations: of a decision. first: of an episode's first plan.
    """

    angle: float
    rate: float
    bend: float
    bend_rate: float
    block: int = 2
    horizon: int = 50
    iterations: int = 1
    first: int = 10
    before: float = 0.0
    soonest: float = 1.0
    allowed: float = 10.0
    lead: int = 0
    hold: float = 1.0
    memory: float = 1.0


class Regulator(NamedTuple):
    """Of the arm about rest: u = -K dx costs 1/2 dx' P dx, and keeps its limits where dx' P dx <= reach."""

    K: Array
    P: Array
    reach: float


@lru_cache(maxsize=32)
def stage_weight(arm: Arm, period: float, gains: MPCGains) -> Array:
    """(S, S): cost of a state's distance from rest at the goal."""
    plant, n = dynamics(arm, period), arm.n_links
    first = float(arm_model(plant.arm, (0.0,) * (n - 1)).frequencies[0])
    half = plant.half
    bends = plant.bends(np.zeros(plant.size))[1][:, :half]
    outputs = np.zeros((4 * n, plant.size))
    outputs[np.arange(n), plant.joints] = outputs[n + np.arange(n), half + plant.joints] = 1.0
    outputs[2 * n : 3 * n, :half] = outputs[3 * n :, half:] = bends
    weights = np.repeat([gains.angle, gains.rate / first, gains.bend, gains.bend_rate / first], n)
    weight: Array = outputs.T @ np.diag(weights**2) @ outputs + 1e-6 * np.eye(plant.size)
    return weight


@lru_cache(maxsize=512)
def regulator(arm: Arm, period: float, gains: MPCGains, posture: tuple[float, ...]) -> Regulator:
    """The regulator at a posture (elbow angles, rad)."""
    from scipy.linalg import solve_discrete_are

    plant = dynamics(arm, period)
    n = arm.n_links
    x = plant.rest(np.array([(0.0, *posture)]))
    A, B = (part[0] for part in plant.jacobians(x, np.zeros((1, n))))
    P = solve_discrete_are(A, B, gains.hold**2 * stage_weight(arm, period, gains), np.eye(n))
    K = np.linalg.solve(np.eye(n) + B.T @ P @ B, B.T @ P @ A)
    reach = 1.0 / float(np.max(np.einsum("is,is->i", K, np.linalg.solve(P, K.T).T)))
    return Regulator(K, P, reach)


class MPC(Controller):
    """Plans over a horizon, in every period."""

    needs_bends = True

    def __init__(self, setup: Setup, gains: MPCGains) -> None:
        super().__init__(setup)
        self.gains = gains
        self.plant = dynamics(setup.arm, setup.control_dt)
        held = [dynamics(setup.arm, k * setup.control_dt) for k in range(1, gains.block + 1)]
        self.grids = [Grid(first, held[-1]) for first in held]
        self.stage = stage_weight(setup.arm, setup.control_dt, gains)
        self.effort = np.full(setup.n_joints, float(gains.block))

    def begin(self, signals: Signals, to_go: Array) -> None:
        n, gains, setup = len(to_go), self.gains, self.setup
        self.home = self.plant.rest(self.goal)
        postures = np.round(self.goal[:, 1:] / GRID) * GRID
        owned = [regulator(setup.arm, setup.control_dt, gains, tuple((0.0 + row).tolist())) for row in postures]
        self.K, self.P = np.stack([r.K for r in owned]), np.stack([r.P for r in owned])
        self.reach = np.array([r.reach for r in owned])
        self.missed = np.zeros(n)
        self.x = self.plant.rest(self.goal - to_go)
        self.x = self.plant.corrected(self.x, self._outputs(signals, to_go))
        self.plan, self.left = np.zeros((gains.horizon, n, setup.n_joints)), gains.block
        inertia = rigid_inertia(setup.arm, self.goal[:, 1:])
        load = (np.abs(np.einsum("nij,nj->ni", inertia, to_go)) / self.limits).max(axis=1)
        self.arrival = np.ceil(gains.soonest * 2.0 * np.sqrt(load) / setup.control_dt)
        late = np.ones(n, np.bool_)
        iterations = gains.first
        for _ in range(60):
            self._improve(late, iterations)
            late = self.missed > gains.allowed
            late &= self.arrival < self._ends[-2]
            if not late.any():
                break
            self.arrival[late] += np.maximum(1.0, np.round(0.03 * self.arrival[late]))
            iterations = 3

    def torques(self, signals: Signals, to_go: Array) -> Array:
        if self.gains.memory < 1.0:
            self.x = self.gains.memory * self.x + (1.0 - self.gains.memory) * self.plant.corrected(self.plant.rest(self.goal - to_go), self._outputs(signals, to_go))
        self.x = self.plant.corrected(self.x, self._outputs(signals, to_go))
        off = self.x - self.home
        shares = -(self.K @ off[:, :, None])[:, :, 0]
        far = np.einsum("ni,nij,nj->n", off, self.P, off) > self.reach
        if far.any():
            self._improve(far, self.gains.iterations)
            self.arrival[far & (self.missed > self.gains.allowed)] += 1.0
            shares[far] = self.plan[0][far]
        return shares * self.limits

    def applied(self, torques: Array) -> None:
        self.x = self.plant.advance(self.x, torques / self.limits)
        lost = ~np.isfinite(self.x).all(axis=1)
        self.x[lost] = self.home[lost]
        self.left -= 1
        if not self.left:
            self.plan, self.left = np.concatenate([self.plan[1:], 0.0 * self.plan[-1:]]), self.gains.block

    @property
    def _ends(self) -> Array:
        """Instants (H + 1,) at the ends of the plan's stages, periods from the episode's start."""
        block = self.gains.block
        return self.step + np.concatenate([[0.0], self.left + block * np.arange(self.gains.horizon)])

    def _improve(self, chosen: NDArray[np.bool_], iterations: int) -> None:
        """Go on with the plans of some arms, from where they are."""
        self.arrival = np.maximum(self.arrival, self.step + self.gains.lead)
        there = self._ends[:, None] >= self.arrival[chosen]
        shares = self.gains.block * np.where(there, 1.0, self.gains.before)
        weight = shares[:, :, None, None] * self.stage
        weight[-1] = self.P[chosen] / self.gains.hold**2
        cost = ilqr.Quadratic(self.home[chosen], weight)
        found = ilqr.solve(
            self.grids[self.left - 1], self.x[chosen], self.plan[:, chosen], [cost], self.effort, iterations=iterations
        )
        self.plan[:, chosen] = found.controls
        at = np.minimum(np.argmax(there, axis=0), len(there) - 1)
        off = found.states[at, np.arange(chosen.sum())] - self.home[chosen]
        self.missed[chosen] = np.einsum("ni,nij,nj->n", off, self.P[chosen], off)

    def _outputs(self, signals: Signals, to_go: Array) -> Array:
        return np.concatenate([self.goal - to_go, signals.rates, signals.bends, signals.bend_rates], axis=1)
