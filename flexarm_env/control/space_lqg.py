"""LQR and LQG of arms in space: the planar filter and regulator (`lqg`), about the arm's rest at its target."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .arm_model import held
from .base import Setup, Signals
from .lqg import LQG, Design, Plant, curvatures, designed, gauges_of, measured
from .lqr import SENSOR
from .space_pd import AboutRest, held_model, holding

Array = NDArray[np.float64]

FARTHEST = 1.0
"""rad that a joint is pulled by at most, as if its goal were no farther."""


def plant(setup: Setup, gravity: Array, angles: Array) -> tuple[Plant, dict[str, float]]:
    """The arm about its rest with joints at angles (N,), its rigid weight held; and outputs there."""
    arm, n = setup.arm, setup.n_joints
    free, joints, A = held_model(arm, gravity, angles, [gauge.spot for gauge in gauges_of(setup).values()])
    rows, y = dict(zip(free.outputs, free.C, strict=True)), dict(zip(free.outputs, free.y.tolist(), strict=True))
    size = len(free.A) // 2
    # a stiff arm turns as the flexible one does where its joints are turned slowly
    turned = np.block([[free.A[size:, :size], free.B[size:]], [joints[:, :size], np.zeros((n, n))]])
    turned /= np.abs(turned).max(axis=1, keepdims=True)
    slow = np.linalg.solve(turned, np.vstack([np.zeros((size, n)), np.eye(n)]))[:size]
    rigid = np.vstack([slow, np.zeros((size, n))])
    squares = np.sort(-np.linalg.eigvals(A[size:, :size]).real)
    first = float(np.sqrt(squares[n])) if size > n else 1.0 / setup.control_dt
    bending = [(k, link.span) for k, link in enumerate(arm.links) if not link.rigid]
    bends = [
        np.array([rows[f"deflection{k}_{d}{end}"] / span for d in "yz" for k, span in bending]
                 + [rows[f"twist{k}{end}"] for k, _ in bending]).reshape(-1, 2 * size)
        for end in ("", "_rate")
    ]  # fmt: skip
    inertia = holding(arm, gravity, angles[None])[1][0]
    own = Plant(*held(A, free.B, setup.control_dt), rows, rigid, inertia, first, free.states, (bends[0], bends[1]))
    return own, y


class SpatialLQG(LQG, AboutRest):
    """u = what holds the arm - K x - d + f, about its goal (see `LQG`)."""

    def initialise(self, signals: Signals, to_go: Array) -> None:
        AboutRest.initialise(self, signals, to_go)
        plants = [plant(self.setup, self.gravity, angles) for angles in self.goal]
        self.designs = [(self.design(own), np.arange(len(plants)) == i) for i, (own, _) in enumerate(plants)]
        self.at_rest = np.array([self.resting(y) for _, y in plants])
        LQG.initialise(self, signals, to_go)

    def design(self, own: Plant) -> Design:
        """Regulator and filter of a plant."""
        return measured(self.setup, self.gains, own)

    def resting(self, y: dict[str, float]) -> list[float]:
        """What is seen at the goal."""
        return [0.0] * self.setup.n_joints + [unit * y[name] for unit, name in curvatures(self.setup)]

    def seen(self, signals: Signals, to_go: Array) -> Array:
        """What the filter takes in, about what it is at the goal, (n, p)."""
        found: Array = super().seen(signals, to_go) - self.at_rest
        return found

    def _parts(self, angles: Array) -> Any:
        return self.designs

    def torques(self, signals: Signals, to_go: Array) -> Array:
        self.held = self.forward(to_go)
        torques, beyond = super().torques(signals, to_go), to_go - np.clip(to_go, -FARTHEST, FARTHEST)
        for d, rows in self.designs:
            torques[rows] -= beyond[rows] @ (d.K @ d.rigid).T
        return self.held + torques

    def predict(self, torques: Array) -> None:
        super().predict(torques - self.held)


class SpatialLQR(SpatialLQG):
    """The same on what the observation says of angles, deflections, twists and their rates."""

    needs_goals, needs_bends = False, True

    def design(self, own: Plant) -> Design:
        """Regulator and filter of a plant."""
        n, none = self.setup.n_joints, np.zeros(0)
        joints = [np.array([own.rows[f"joint{k}{end}"] for k in range(n)]) for end in ("", "_rate")]
        noise = np.repeat([SENSOR, SENSOR * own.first] * 2, [n, n, *(len(part) for part in own.bends)])
        return designed(self.setup, self.gains, own, np.vstack([*joints, *own.bends]), noise**2, none)

    def resting(self, y: dict[str, float]) -> list[float]:
        """What is seen at the goal."""
        links = self.setup.arm.links
        still = [
            y[name] / (link.span if name.startswith("deflection") else 1.0)
            for what in ("deflection{}_y", "deflection{}_z", "twist{}")
            for k, link in enumerate(links)
            if not link.rigid and (name := what.format(k))
        ]
        joints = [0.0] * self.setup.n_joints
        return [*joints, *joints, *still, *(0.0 for _ in still)]

    def seen(self, signals: Signals, to_go: Array) -> Array:
        """What the filter takes in, about what it is at the goal, (n, p)."""
        found: Array = signals.outputs(-to_go) - self.at_rest
        return found
