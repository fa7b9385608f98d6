"""LQG: linear-quadratic control of a state that a Kalman filter estimates from what sensors read.

The filter's model is that of `flexarm_env.linear`, over a control period with the torque held, about rest; its state has
beside the arm's own the torque that nobody accounts for at each joint (friction above all) and the bias of each gauge:

    x+ = A x + B (u + d) + w,  d+ = d + drift,  b+ = b;   angles = C x + v,  gauges = C x + b + v

Filtered rates are made of the very angles that the filter takes in, and tell it nothing more.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..sensors import Encoder, Sensors
from .arm_model import NODES, postures
from .base import Controller, Setup, Signals

Array = NDArray[np.float64]

FINEST_ANGLE = 1e-4
"""Least standard deviation of an angle that the filter takes an encoder for, rad."""

FINEST_GAUGE = 1e-2
"""The same of a gauge, over its scale: its reading of the curvature that the joint's full torque makes."""

SHARP = 4.0
WALK = 1e-3
"""What a bias may walk in a control period, over what it is drawn from."""

LEARNING = 150
"""Control periods until the filter's gains are taken to have settled."""


@dataclass(frozen=True)
class LQGGains:
    """Dimensionless weights, beside a weight of 1 on each torque over its limit.

    Args:
        angle: on joint angles (1/rad). rate: on joint rates over the first flexible frequency.
        bend: on tip deflections over length. bend_rate: on their rates over that frequency.
        noise: of the torque that the filter allows for, over the limit. drift: change of the lasting torque that it
            looks for, over the limit, in a control period.
    """

    angle: float
    rate: float
    bend: float
    bend_rate: float
    noise: float = 0.05
    drift: float = 0.01


class Design(NamedTuple):
    """z = (x, d, b) of s numbers. z+ = A z + B u; y = C z; u = -K z; z += L[k] (y - C z) at instant k.

    rigid (s, N): z by the joint angles of a stiff arm. states: of x, those of `LinearModel.states`.
    """

    A: Array
    B: Array
    C: Array
    K: Array
    L: Array
    F: Array
    rigid: Array
    states: tuple[str, ...]


@lru_cache(maxsize=256)
def design(setup: Setup, gains: LQGGains, posture: tuple[float, ...] = ()) -> Design:
    """Regulator and filter of an arm about rest, its elbows at a posture in rad."""
    from scipy.linalg import block_diag, solve_discrete_are

    from ..linear import linearize
    from ..scene import Scene

    arm, n, limits = setup.arm, setup.n_joints, np.asarray(setup.torque_limits)
    sensors, shown = setup.sensors or Sensors(), gauges_of(setup)
    gauges = [sensors.strain_gauges[g] for g in shown]
    angles = (0.0, *np.cumsum(posture or np.zeros(n - 1)).tolist())
    scene = Scene("design", arm, angles=angles, duration=1.0, dt=1e-3)
    places = [(gauge.link, gauge.place) for gauge in gauges]
    of = {"nodes": NODES, "gauges": places}
    model = linearize(scene, "elastica", discrete=setup.control_dt, method="zoh", **of)
    free = linearize(scene, "elastica", **of)
    A, B, size = model.A, model.B, len(model.A)
    rows = {name: C for name, C in zip(model.outputs, model.C, strict=True)}

    stiffness = free.A[size // 2 :, : size // 2]
    joints = np.array([rows[f"joint{k}"] for k in range(n)])
    modes = np.linalg.svd(stiffness)[2][-n:].T
    rigid = np.zeros((size, n))
    rigid[: size // 2] = modes @ np.linalg.inv(joints[:, : size // 2] @ modes)
    first = float(np.sqrt(np.sort(-np.linalg.eigvals(stiffness).real)[n]))

    weights = [(f"joint{k}", gains.angle) for k in range(n)]
    weights += [(f"joint{k}_rate", gains.rate / first) for k in range(n)]
    weights += [(f"deflection{k}", gains.bend / link.span) for k, link in enumerate(arm.links)]
    weights += [(f"deflection{k}_rate", gains.bend_rate / (first * link.span)) for k, link in enumerate(arm.links)]
    weighed = np.array([weight * rows[name] for name, weight in weights])
    R = np.diag(1.0 / limits**2)
    P = solve_discrete_are(A, B, weighed.T @ weighed + 1e-9 * np.eye(size), R)
    K = np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)

    encoders = [sensors.encoder(k) if sensors.encoders else Encoder() for k in range(n)]
    encoders = [encoder.behind(arm.joint(k).gear_ratio) for k, encoder in enumerate(encoders)]
    seen = [rows[f"{'motor' if one.side == 'motor' and arm.joint(k).elastic else 'joint'}{k}"]
            for k, one in enumerate(encoders)]  # fmt: skip
    read = [rows[f"curvature{g.link}@{g.place:g}"] * f * np.mean(g.gains)
            for g, f in zip(gauges, _per_curvature(setup, shown), strict=True)]  # fmt: skip
    scales = [setup.scales[setup.names.index(f"strain_gauge_{g + 1}")] for g in shown]
    finest = [FINEST_ANGLE] * n + [FINEST_GAUGE * scale for scale in scales]
    parts = [*encoders, *gauges]
    V = np.diag([part.noise**2 + part.step**2 / 12.0 + least**2 for part, least in zip(parts, finest, strict=True)])

    F = np.array([np.pad(rows.get(f"motor{k}_rate", rows[f"joint{k}_rate"]), (0, n + len(gauges))) for k in range(n)])
    bias = np.array([np.ptp(gauge.biases) / np.sqrt(12.0) for gauge in gauges])
    more, count = n + len(gauges), len(gauges)
    whole = block_diag(A, np.eye(more))
    whole[:size, size : size + n] = B
    C = np.zeros((n + count, size + more))
    C[:, :size] = [*seen, *read]
    C[n:, size + n :] = np.eye(count)
    push = B @ np.diag((gains.noise * limits) ** 2) @ B.T + 1e-12 * np.eye(size)
    W = block_diag(push, np.diag((gains.drift * limits) ** 2), np.diag((WALK * bias) ** 2))
    S = block_diag(rigid @ V[:n, :n] @ rigid.T, np.diag((gains.drift * limits) ** 2), np.diag(bias**2))
    for _ in range(10):
        S[:size, :size] = A @ S[:size, :size] @ A.T + push
    L = np.empty((LEARNING, size + more, n + count))
    for k in range(LEARNING):
        L[k] = np.linalg.solve(C @ S @ C.T + V, C @ S).T
        S = S - L[k] @ C @ S
        S = whole @ S @ whole.T + W
        S = 0.5 * (S + S.T)
    return Design(
        whole, np.vstack([B, np.zeros((more, n))]), C, np.hstack([K, np.eye(n), np.zeros((n, count))]), L, F,
        np.vstack([rigid, np.zeros((more, n))]), model.states,
    )  # fmt: skip


def gauges_of(setup: Setup) -> tuple[int, ...]:
    """Indices of the gauges that are observed."""
    count = len(setup.sensors.strain_gauges) if setup.sensors else 0
    return tuple(g for g in range(count) if f"strain_gauge_{g + 1}" in setup.names)


def _per_curvature(setup: Setup, shown: tuple[int, ...]) -> Iterator[float]:
    """What gauges read of a curvature of 1/m."""
    for g in shown:
        assert setup.sensors is not None
        gauge = setup.sensors.strain_gauges[g]
        link = setup.arm.links[gauge.link]
        there = link.along(gauge.place * link.length)
        yield gauge.per_curvature(float(there.m), float(there.J))


class LQG(Controller):
    """u = -K x - d, x and d from the filter; both designed for the posture at the goal.

    Attributes: z (n, s): estimates, each about its own goal (see `Design`).
    """

    needs_goals = True

    def __init__(self, setup: Setup, gains: LQGGains) -> None:
        super().__init__(setup)
        self.gains = gains
        self.friction = np.array([setup.arm.joint(k).friction_coulomb for k in range(setup.n_joints)])
        self.centres = np.array([np.mean(setup.sensors.strain_gauges[g].biases) for g in gauges_of(setup)]
                                if setup.sensors else [])  # fmt: skip

    def begin(self, signals: Signals, to_go: Array) -> None:
        found = postures(self.goal)
        self.parts = [
            (design(self.setup, self.gains, posture), np.array([posture == one for one in found]))
            for posture in dict.fromkeys(found)
        ]
        self.z = np.zeros((len(to_go), self.parts[0][0].A.shape[0]))
        for d, rows in self.parts:
            self.z[rows] = -to_go[rows] @ d.rigid.T

    def torques(self, signals: Signals, to_go: Array) -> Array:
        y = np.hstack([-to_go, signals.gauges - self.centres])
        torques = np.zeros_like(to_go)
        for d, rows in self.parts:
            z = self.z[rows]
            z = z + (y[rows] - z @ d.C.T) @ d.L[min(self.step, LEARNING - 1)].T
            u = -z @ d.K.T
            self.z[rows], torques[rows] = z, u + self._rubbing(d, z, u, SHARP)
        return torques

    def applied(self, torques: Array) -> None:
        for d, rows in self.parts:
            z, u = self.z[rows], torques[rows]
            self.z[rows] = z @ d.A.T + (u - self._rubbing(d, z, u)) @ d.B.T

    def _rubbing(self, d: Design, z: Array, torques: Array, sharp: float = 1.0) -> Array:
        """Coulomb friction (n, N) over the next period: what stops the motors by its end, if it can."""
        rates = z @ (d.F @ d.A).T + torques @ (d.F @ d.B).T
        stops = sharp * rates / np.diagonal(d.F @ d.B)
        return np.clip(stops, -self.friction, self.friction)
