"""Model-predictive control of contact force and path (task "press"), with torque limits.

The model is that of `lqr_force.LQRForce`: the arm linearized at rest on the wall, with the wall's stiffness at the tip,
and with the integrals of force error and path error as additional states. In each period the controller minimizes the
regulator's cost over the torques of the next periods, subject to the motors' limits (Mayne et al. 2000). With torques u
= -K x + c the cost is the regulator's cost plus the sum of c' W c. If the regulator's torques stay within the limits, c
= 0.

If the measured force is below `LOST` times the commanded force, the tip counts as off the wall. While the tip is off
the wall, the controller applies the state feedback of an arm in free motion towards the reference.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from .. import validation as check
from ..validation import Array
from .base import Setup
from .force import View
from .lqr_force import LQRForce, LQRForceGains, WallModel

LOST = 0.1
"""Measured force, divided by the commanded force, below which the tip counts as off the wall."""

MOST = 50
"""Largest number of iterations of a quadratic program; a few suffice."""


@dataclass(frozen=True, kw_only=True)
class MPCForceGains(LQRForceGains):
    """Gains of the controller `MPCForce`: the gains of `LQRForce`, and the horizon.

    Args:
        horizon: number of control periods in which the planned torques satisfy the limits. After the horizon the plan
            uses the torques of the regulator without limits.
    """

    horizon: int = 20

    def __post_init__(self) -> None:
        """Validate the horizon."""
        check.integer("horizon", self.horizon, minimum=1, maximum=200)


class MPCForce(LQRForce):
    """Model-predictive controller with the integrals of force and path error as states, within the torque limits."""

    gains: MPCForceGains

    def __init__(self, setup: Setup, gains: MPCForceGains | None = None) -> None:
        """Store the gains; see `PressController`."""
        super().__init__(setup, MPCForceGains() if gains is None else check.instance("gains", gains, MPCForceGains))
        self._programs: dict[int, tuple[WallModel, Program]] = {}

    def _touching(self, view: View) -> Array:
        return np.asarray(view.touching * (view.force > LOST * view.commanded))

    def _feedback(self, model: WallModel, x: Array, holding: Array) -> Array:
        horizon, state = self.gains.horizon, model.states @ x
        # models of postures and bearings on the design grid recur
        if id(model) not in self._programs:
            self._programs[id(model)] = model, Program.of(model, horizon)
        program = self._programs[id(model)][1]
        return -program.first_torques(state, -self.limits - holding, self.limits - holding)


class Program(NamedTuple):
    """Quadratic program over p periods: torques u increase the regulator's cost by (u - F x)' H (u - F x).

    F x are the regulator's torques from the state x. u contains the torques of the p periods, one period after the
    other. F has the shape (p N, S), H the shape (p N, p N).
    """

    F: Array
    H: Array

    @classmethod
    def of(cls, model: WallModel, horizon: int) -> "Program":
        """Return the program of a model for a number of periods."""
        n, closed = model.B.shape[1], model.A - model.B @ model.K
        # u_k = -K x_k + c_k with x_(k + 1) = (A - B K) x_k + B c_k: u = F x + G c
        F, G, power = np.zeros((horizon * n, len(model.A))), np.eye(horizon * n), np.eye(len(model.A))
        for k in range(horizon):
            F[k * n : (k + 1) * n] = -model.K @ power
            later = -model.K @ power @ model.B
            for j in range(horizon - 1 - k):
                G[(j + k + 1) * n : (j + k + 2) * n, j * n : (j + 1) * n] = later
            power = closed @ power
        inverse = np.linalg.inv(G)
        return cls(F, inverse.T @ np.kron(np.eye(horizon), model.W) @ inverse)

    def first_torques(self, x: Array, low: Array, high: Array) -> Array:
        """Return the optimal torques (N,), N m, of the first period. x (S,): state. low, high (N,): torque limits."""
        times = len(self.F) // len(low)
        bounds = np.tile(np.minimum(low, 0.0), times), np.tile(np.maximum(high, 0.0), times)
        return boxed(self.H, self.F @ x, *bounds)[: len(low)]


def boxed(H: Array, wanted: Array, low: Array, high: Array) -> Array:
    """Return the u within [low, high] that minimizes (u - wanted)' H (u - wanted), by projected Newton steps.

    H: symmetric positive definite matrix. The method is that of Bertsekas (1982).
    """
    u = np.clip(wanted, low, high)
    if (u == wanted).all():
        return u
    scale = float(np.abs(H).max() * (high - low).max())

    def cost(at: Array) -> float:
        off = at - wanted
        return float(off @ H @ off)

    for _ in range(MOST):
        slope = H @ (u - wanted)
        # bounds that the minimum along the slope would violate
        free = ~(((u <= low) & (slope > 0.0)) | ((u >= high) & (slope < 0.0)))
        if not free.any() or np.abs(slope[free]).max() < 1e-12 * scale:
            break
        step, share, before = np.zeros_like(u), 1.0, cost(u)
        step[free] = -np.linalg.solve(H[np.ix_(free, free)], slope[free])
        after = np.clip(u + step, low, high)
        while cost(after) > before and share > 1e-6:
            share *= 0.5
            after = np.clip(u + share * step, low, high)
        if not cost(after) < before:
            break
        u = after
    return u
