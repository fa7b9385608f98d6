"""Receding-horizon control: in every period the torques of the next ones are planned anew, and the first is applied.

The plan is that of `ilqr` on the elastica, within the torque limits, from the state as it is read. It costs effort, and
from an instant of arrival on the distance from rest at the goal; behind the horizon stands the linear regulator at the
goal. (With a cost of the distance from the start on, torques that saturate overshoot.) It goes on from the plan of the
period before, followed by its gains from where the arm is now, by an iteration. An arrival that a plan misses is put
off: when an episode begins until none does, later as far as an arm that differs from the nominal one may need. Once the
regulator stays within the limits by itself, it takes over.

Read are joint angles, deflections of the tips and their rates. The rest of the state is the model's prediction, drawn
towards that of a link bent by a force at its tip: the prediction knows the higher modes of the nominal arm, and is
wrong on another.
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
from .kinematics import rigid_times
from .lqr import StateWeights, riccati

Array = NDArray[np.float64]

PUT_OFF = 0.03
"""Share of its time by which an arrival is put off while an episode's first plan is made."""

LATEST = 2.0
"""Times the arrival first planned at which it is not put off any more: whatever an arm of a quarter of the stiffness,
or four times the mass, does takes twice as long. For ever a few periods ahead, it would leave the vibration before it,
which costs nothing, to grow where damping does not stop it."""

MOST = 60
"""First plans that are made at most."""


@dataclass(frozen=True)
class MPCGains(StateWeights):
    """`StateWeights`, and how plans are made.

    Args:
        memory: share of the prediction that is kept in a period, of what is not read.
        allowed: cost of the distance from the goal at which a plan has arrived.
        block: control periods over which planned torques are held. horizon: such blocks that are planned.
        iterations: of a decision. first: of an episode's first plan.
    """

    memory: float = 1.0
    allowed: float = 10.0
    block: int = 2
    horizon: int = 50
    iterations: int = 1
    first: int = 10


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
    outputs = np.zeros((4 * n, plant.size))
    outputs[np.arange(n), plant.joints] = outputs[n + np.arange(n), half + plant.joints] = 1.0
    outputs[2 * n : 3 * n, :half] = outputs[3 * n :, half:] = plant.bends(np.zeros(plant.size))[1][:, :half]
    weight: Array = outputs.T @ np.diag(gains.of_outputs(first, n) ** 2) @ outputs + 1e-6 * np.eye(plant.size)
    return weight


@lru_cache(maxsize=512)
def regulator(arm: Arm, period: float, gains: MPCGains, posture: tuple[float, ...]) -> Regulator:
    """The regulator at a posture (elbow angles, rad)."""
    plant = dynamics(arm, period)
    n = arm.n_links
    A, B = (part[0] for part in plant.jacobians(plant.rest(np.array([(0.0, *posture)])), np.zeros((1, n))))
    K, P = riccati(A, B, stage_weight(arm, period, gains), np.eye(n))
    return Regulator(K, P, 1.0 / float(np.max(np.einsum("is,is->i", K, np.linalg.solve(P, K.T).T))))


class MPC(Controller):
    """Plans over a horizon, in every period.

    Attributes: x (n, S): states as they are taken to be (see `dynamics.Dynamics`). plan: torques (H, n, N) over their
        limits, with gains; the first are held for another `left` periods. arrival (n,): control periods from the start,
        put off until it is `latest` (n,) at most.
    """

    needs_bends = True

    def __init__(self, setup: Setup, gains: MPCGains) -> None:
        super().__init__(setup)
        self.gains = gains
        held = [dynamics(setup.arm, k * setup.control_dt) for k in range(1, gains.block + 1)]
        self.plant, self.grids = held[0], [Grid(first, held[-1]) for first in held]
        self.stage = stage_weight(setup.arm, setup.control_dt, gains)
        self.effort = np.full(setup.n_joints, float(gains.block))

    def initialise(self, signals: Signals, to_go: Array) -> None:
        n, gains, setup = len(to_go), self.gains, self.setup
        postures = np.round(self.goal[:, 1:] / GRID) * GRID
        owned = [regulator(setup.arm, setup.control_dt, gains, tuple((0.0 + row).tolist())) for row in postures]
        self.K, self.P = np.stack([r.K for r in owned]), np.stack([r.P for r in owned])
        self.reach = np.array([r.reach for r in owned])
        self.home, self.x = self.plant.rest(self.goal), self._standing(signals, to_go)
        shape, self.left = (gains.horizon, n, setup.n_joints), gains.block
        states = np.zeros((gains.horizon + 1, *self.x.shape))
        self.plan = ilqr.Solution(np.zeros(shape), states, np.zeros(n), np.zeros((*shape, self.plant.size)))
        self.arrival = np.ceil(rigid_times(setup.arm, self.goal, to_go, self.limits) / setup.control_dt)
        late, iterations, missed = np.ones(n, np.bool_), gains.first, np.zeros(n)
        for _ in range(MOST):
            missed[late] = self._improve(late, iterations)
            late = (missed > gains.allowed) & (self.arrival < self._ends[-2])
            if not late.any():
                break
            self.arrival[late] += np.maximum(1.0, np.round(PUT_OFF * self.arrival[late]))
            iterations = 3
        self.latest = LATEST * self.arrival

    def torques(self, signals: Signals, to_go: Array) -> Array:
        kept, self.plan.states[0] = self.gains.memory, self.x
        guess = kept * self.x + (1.0 - kept) * self._standing(signals, to_go)
        self.x = self.plant.corrected(guess, signals.outputs(self.goal - to_go))
        off = self.x - self.home
        shares = -(self.K @ off[:, :, None])[:, :, 0]
        far = np.einsum("ni,nij,nj->n", off, self.P, off) > self.reach
        if far.any():
            missed = self._improve(far, self.gains.iterations)
            shares[far] = self.plan.controls[0][far]
            self.arrival[far] += (missed > self.gains.allowed) & (self.arrival[far] < self.latest[far])
        return np.asarray(shares * self.limits)

    def predict(self, torques: Array) -> None:
        self.x = self.plant.advance(self.x, torques / self.limits)
        lost = ~np.isfinite(self.x).all(axis=1)
        self.x[lost] = self.home[lost]
        self.left -= 1
        if not self.left:
            plan, self.left = self.plan, self.gains.block
            for values in (plan.controls, plan.gains, plan.states):
                values[:-1] = values[1:]
            plan.controls[-1], plan.gains[-1] = 0.0, 0.0

    @property
    def _ends(self) -> Array:
        """Instants (H + 1,) at the ends of the plan's stages, periods from the episode's start."""
        stages = np.arange(self.gains.horizon)
        return self.step + np.concatenate([[0.0], self.left + self.gains.block * stages])

    def _improve(self, chosen: NDArray[np.bool_], iterations: int) -> Array:
        """Go on with the plans of some arms, from where they are; by how much they miss the goal at their arrival."""
        there = self._ends[:, None] >= self.arrival[chosen]
        weight = (self.gains.block * there)[:, :, None, None] * self.stage
        weight[-1] = self.P[chosen]
        cost = ilqr.Quadratic(self.home[chosen], weight)
        grid, plan = self.grids[self.left - 1], self.plan
        own = ilqr.Solution(plan.controls[:, chosen], plan.states[:, chosen], plan.cost, plan.gains[:, chosen])
        try:
            found = ilqr.solve(grid, self.x[chosen], own, [cost], self.effort, iterations=iterations)
        except ValueError:  # no arm of the model moves from where one is taken to be
            plan.controls[:, chosen], plan.gains[:, chosen] = 0.0, 0.0
            return np.full(own.controls.shape[1], np.inf)
        plan.controls[:, chosen], plan.states[:, chosen] = found.controls, found.states
        plan.gains[:, chosen] = found.gains
        at = np.where(there.any(axis=0), np.argmax(there, axis=0), len(there) - 1)
        off = found.states[at, np.arange(len(at))] - self.home[chosen]
        return np.asarray(np.einsum("ni,nij,nj->n", off, self.P[chosen], off))

    def _standing(self, signals: Signals, to_go: Array) -> Array:
        """States (n, S) with what is read, the links bent by forces at their tips."""
        return self.plant.corrected(self.plant.rest(self.goal - to_go), signals.outputs(self.goal - to_go))
