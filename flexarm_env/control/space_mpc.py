"""Receding-horizon control of arms in space: the planar one (`mpc`), about the arm's rest at its target under gravity.

What is different: torques that are held would let an arm fall, so that plans begin with what gentle regulators do, and
are asked for sooner and sooner arrivals. And links without hubs ring at their roots so fast that no prediction keeps up
with what is read of rates: an extended Kalman filter weighs both.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .base import Signals
from .lqr import SENSOR
from .mpc import MPC, Regulator, regulators
from .space_dynamics import SpatialDynamics
from .space_pd import AboutRest

Array = NDArray[np.float64]

SOONER, SPARE = 0.9, 1.2
"""Share of an arrival that a plan has which is tried next; times the soonest found: what is asked for."""

NOISE, UNSEEN = 0.02, 3e-4
"""What the filter allows for in a period: of torques over their limits; of angles and strains, rad, and of their rates
over the first frequency."""

RATES, UNKNOWN = 10.0, 9.0
"""Times `SENSOR`: what rates are trusted to; times the variances of `UNSEEN`: those of a state at the start."""


class SpatialMPC(MPC, AboutRest):
    """`MPC` about the arm's rest at its target, and the torques that hold it there.

    Attributes: spread (n, S, S): covariance of the states' errors.
    """

    wild, ahead, put_off = 1e3, 2.0, 0.1

    def initialise(self, signals: Signals, to_go: Array) -> None:
        plant, n = self.plant, self.setup.n_joints
        many = signals.bends.shape[1]
        self.seen = np.square(np.repeat([SENSOR, RATES * SENSOR * plant.first] * 2, [n, n, many, many]))
        self.unseen = np.diag(np.square(np.repeat([UNSEEN, UNSEEN * plant.first], plant.half)))
        self.spread = np.broadcast_to(UNKNOWN * self.unseen, (len(to_go), *self.unseen.shape))
        super().initialise(signals, to_go)

    def _estimate(self, signals: Signals, to_go: Array) -> Array:
        values, C = self.plant.outputs(self.x)
        S = self.spread @ C.swapaxes(1, 2)
        L = np.linalg.solve(C @ S + np.diag(self.seen), S.swapaxes(1, 2)).swapaxes(1, 2)
        self.spread = self.spread - L @ S.swapaxes(1, 2)
        return np.asarray(self.x + (L @ (signals.outputs(self.goal - to_go) - values)[:, :, None])[:, :, 0])

    def _inertia(self) -> Array:
        return self.plant.inertia(self.goal)

    def _give_up(self, chosen: NDArray[np.bool_]) -> None:
        """What gentle regulators do, who are there at the horizon's end."""
        plan = self.plan
        plan.gains[:, chosen], plan.states[:, chosen] = -self.gentle[chosen], self.home[chosen]
        plan.controls[:, chosen] = self.still[chosen]
        off = self.x[chosen] - self.home[chosen]
        now = self.still[chosen] - (self.gentle[chosen] @ off[:, :, None])[:, :, 0]
        plan.controls[0, chosen], plan.states[0, chosen] = np.clip(now, -1.0, 1.0), self.x[chosen]
        self.arrival[chosen] = self._ends[-2]

    def _standing(self, signals: Signals, to_go: Array) -> Array:
        return self.plant.unbent(self.goal - to_go)

    def predict(self, torques: Array) -> None:
        A, B = self.plant.jacobians(self.x, torques / self.limits)
        moved = A @ self.spread @ A.swapaxes(1, 2) + NOISE**2 * B @ B.swapaxes(1, 2) + self.unseen
        lost = ~np.isfinite(moved).all(axis=(1, 2), keepdims=True)
        self.spread = np.where(lost, UNKNOWN * self.unseen, 0.5 * (moved + moved.swapaxes(1, 2)))
        super().predict(torques)

    def _regulators(self) -> list[Regulator]:
        return regulators(self.plant, self.home, self.still, self.stage)

    def _begin(self, to_go: Array) -> None:
        """As soon as there is a plan, and some more."""
        gains, plan, held, everyone = self.gains, self.plan, self.grids[-1].first, np.ones(len(to_go), np.bool_)
        assert isinstance(held, SpatialDynamics)
        self.gentle = held.homing(self.home, self.still)
        self.arrival = np.zeros(len(to_go))
        self._give_up(everyone)
        super()._begin(to_go)
        on = self._improve(everyone, 1) <= gains.allowed
        while on.any():
            kept, before = (plan.controls.copy(), plan.gains.copy(), plan.states.copy()), self.arrival.copy()
            self.arrival[on] = np.floor(SOONER * self.arrival[on])
            lost = on.copy()
            lost[on] = self._improve(on, 3) > gains.allowed
            for now, old in zip((plan.controls, plan.gains, plan.states), kept, strict=True):
                now[:, lost] = old[:, lost]
            self.arrival[lost] = before[lost]
            on &= ~lost
        self.arrival = np.minimum(np.ceil(SPARE * self.arrival), self._ends[-2])
        self._improve(everyone, gains.first)
