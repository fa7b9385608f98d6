"""Shaped commands for arms in space: references that leave the modes about the rest at the target still."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..parameters import Arm
from .base import Setup, Signals
from .kinematics import rigid_times
from .shaping import Shaped, Shaper, cascade
from .space_pd import SpatialPD, SpatialPDGains, held_model, holding

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SpatialShapedGains(SpatialPDGains):
    """Those of the PD, `effort`: share of the torque limit for the reference, and `modes` that it is shaped for, at
    most."""

    effort: float
    modes: int


def closed_loop_shaper(arm: Arm, gravity: Array, gains: SpatialShapedGains, kind: str, angles: Array) -> Shaper:
    """Impulses for the slowest lightly damped modes of the arm under PD control with filtered rates, about its rest
    with joints at angles (N,)."""
    free, joints, A = held_model(arm, gravity, angles)
    N, filter_rate = arm.n_links, 1.0 / gains.lag
    inertia = np.diag(np.diag(holding(arm, gravity, angles[None])[1][0]))
    rates = np.array([free.C[free.outputs.index(f"joint{k}_rate")] for k in range(N)])
    spring, damper = gains.rate**2 * inertia, 2.0 * gains.ratio * gains.rate * inertia
    filtered = np.hstack([filter_rate * rates, -filter_rate * np.eye(N)])
    closed = np.vstack([np.hstack([A - free.B @ spring @ joints, -free.B @ damper]), filtered])
    return cascade(closed, kind, gains.modes)


def coriolis(arm: Arm, gravity: Array, angles: Array, rates: Array) -> Array:
    """Torques (n, N), N m, of the rigid arm at angles and rates (n, N), without acceleration: what the changes of its
    inertia M with the angles ask for, (d/dt M) rates - 1/2 grad (rates . M rates)."""
    step, N = 1e-5, arm.n_links
    ways = np.concatenate([np.eye(N)[:, None] * np.ones((1, len(angles), 1)), rates[None]])
    ends = [holding(arm, gravity, (angles + sign * step * ways).reshape(-1, N))[1] for sign in (1.0, -1.0)]
    slopes = ((ends[0] - ends[1]) / (2.0 * step)).reshape(N + 1, -1, N, N)
    grown = np.einsum("nij,nj->ni", slopes[N], rates)
    found: Array = grown - 0.5 * np.einsum("knij,ni,nj->nk", slopes[:N], rates, rates)
    return found


class SpatialShapedPD(Shaped, SpatialPD):
    """What holds the arm, a PD about a shaped reference (see `ShapedPD`), and what the rigid arm needs for it."""

    def __init__(self, setup: Setup, gains: SpatialShapedGains, kind: str) -> None:
        SpatialPD.__init__(self, setup, gains)
        self.shaped, self.kind = gains, kind

    def initialise(self, signals: Signals, to_go: Array) -> None:
        SpatialPD.initialise(self, signals, to_go)
        shapers = [closed_loop_shaper(self.setup.arm, self.gravity, self.shaped, self.kind, goal) for goal in self.goal]
        self.shape(shapers, rigid_times(self.inertia, to_go, self.shaped.effort * self.limits), to_go)

    def torques(self, signals: Signals, to_go: Array) -> Array:
        left, rates, accelerations = self.reference()
        arm, angles = self.setup.arm, self.goal - left
        inertia = holding(arm, self.gravity, angles, self.bodies)[1]
        moved = np.einsum("nij,nj->ni", inertia, accelerations) + coriolis(arm, self.gravity, angles, rates)
        self.rates += self.passed * (signals.rates - rates - self.rates)
        pull = np.diagonal(self.inertia, axis1=1, axis2=2) * self._pull(to_go - left, self.rates)
        found: Array = self.forward(to_go) + moved + pull
        return found
