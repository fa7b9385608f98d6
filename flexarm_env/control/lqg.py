"""LQG: linear-quadratic control of a state that a Kalman filter estimates from what sensors read.

The filter's model is that of `flexarm_env.linear` about rest, at the joint angles as they are, over a control period
with the torque held. Its state is the arm's, a lasting torque d at each joint and the bias b of each gauge:

    x+ = A x + B (u - f + d) + w,   angles = C x + v,   gauges = C x + b + v

f is Coulomb friction as the arm's joints have it. A gauge's bias is told from bending since bending dies out; that of
an encoder cannot be told from a turn of the arm. Filtered rates are made of the very angles that the filter takes in,
and tell it nothing more. Delays and low-passes of sensors, and lags of motors, are not in the model.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..linear.plane_model import gauge_name
from ..linear.state_space import held
from ..parameters import Arm
from ..rigid import rigid_inertia
from ..sensors import Encoder, Sensors, StrainGauge
from ..validation import Array
from .arm_model import linear_model, postures
from .base import Controller, Setup, Signals
from .lqr import SENSOR, StateWeights, riccati
from .space import AboutRest, held_model, holding

FINEST_ANGLE = 1e-4
"""Least standard deviation of an angle that the filter takes an encoder for, rad."""

FINEST_GAUGE = 1e-2
"""The same of a gauge, over its scale: its reading of the curvature that the joint's full torque makes."""

SHARP = 4.0
"""Push against friction over the torque that would stop the motor, up to friction's own: above 1 small motions are made
too, and none is made for what is smaller still, so that the arm does not hunt."""

WALK = 1e-3
"""What a bias may walk in a control period, over what it is drawn from."""

UNREST, LEARNING = 10, 150
"""Control periods of noise that the arm is taken to have had before an episode; those until gains have settled."""


@dataclass(frozen=True)
class LQGGains(StateWeights):
    """`StateWeights`, and the filter's.

    Args:
        noise, push: what the filter allows for, over the limit: of the torques; and of what moves the links beside
            them, as the rest of a large motion does (without it the filter would believe its modes for ever).
        drift: change of the lasting torque in a control period that it looks for, over the limit.
    """

    noise: float = 0.02
    push: float = 0.01
    drift: float = 2e-4


class Plant(NamedTuple):
    """An arm about rest, over a control period: x+ = A x + B u; outputs are rows . x.

    rigid (2n, N): x by the joint angles of a stiff arm, of rigid inertia (N, N). first: lowest flexible frequency,
    joints free, rad/s. shown: rows of joint angles, their rates, what `bent_of` names and its rates.
    """

    A: Array
    B: Array
    rows: dict[str, Array]
    rigid: Array
    inertia: Array
    first: float
    states: tuple[str, ...]
    shown: list[Array]


class Design(NamedTuple):
    """z = (x, d, b) of s numbers. z+ = A z + B u; y = C z; u = -K z; z += L[k] (y - C z) at instant k.

    stopping (N, s): motors' rates. rigid (s, N): z by the joint angles of a stiff arm. states: of x, those of
    `LinearModel.states`.
    """

    A: Array
    B: Array
    C: Array
    K: Array
    L: Array
    stopping: Array
    rigid: Array
    states: tuple[str, ...]


@lru_cache(maxsize=256)
def plant(setup: Setup, posture: tuple[float, ...]) -> Plant:
    """The arm with its elbows at a posture in rad, and the gauges that are observed."""
    n, places = setup.n_joints, [(gauge.link, gauge.place) for gauge in gauges_of(setup).values()]
    free = linear_model(setup.arm, posture, gauges=places)
    period = linear_model(setup.arm, posture, gauges=places, discrete=setup.control_dt, method="zoh")
    size = len(free.A) // 2
    stiffness, joints = free.A[size:, :size], free.C[[free.outputs.index(f"joint{k}") for k in range(n)], :size]
    modes = np.linalg.svd(stiffness)[2][-n:].T
    rigid = np.vstack([modes @ np.linalg.inv(joints @ modes), np.zeros((size, n))])
    first = float(np.sqrt(np.sort(-np.linalg.eigvals(stiffness).real)[n]))
    rows = dict(zip(free.outputs, free.C, strict=True))
    inertia = rigid_inertia(setup.arm, np.array([posture or (0.0,) * (n - 1)]))[0]
    return Plant(period.A, period.B, rows, rigid, inertia, first, free.states, _shown(setup.arm, rows))


def bent_of(arm: Arm) -> list[tuple[str, float]]:
    """Outputs of a linear model that are, over what stands beside them, a controller's `Signals.bends`."""
    if not arm.spatial:
        return [(f"deflection{k}", link.span) for k, link in enumerate(arm.links)]
    bending = [(k, link.span) for k, link in enumerate(arm.links) if not link.rigid]
    bends = [(f"deflection{k}_{d}", span) for d in "yz" for k, span in bending]
    return bends + [(f"twist{k}", 1.0) for k, _ in bending]


def _shown(arm: Arm, rows: dict[str, Array]) -> list[Array]:
    """See `Plant`."""
    parts = [(f"joint{k}", 1.0) for k in range(arm.n_links)], bent_of(arm)
    return [
        np.array([rows[name + end] / over for name, over in part]).reshape(-1, len(rows["joint0"]))
        for part in parts for end in ("", "_rate")
    ]  # fmt: skip


@lru_cache(maxsize=256)
def design(setup: Setup, gains: LQGGains, posture: tuple[float, ...] = ()) -> Design:
    """Regulator and filter of an arm about rest, its elbows at a posture in rad."""
    return measured(setup, gains, plant(setup, posture))


def measured(setup: Setup, gains: LQGGains, own: Plant) -> Design:
    """The design for encoders of the joints and what gauges are observed."""
    arm, gauges, encoders = setup.arm, list(gauges_of(setup).values()), _encoders(setup)
    rows = [
        own.rows[f"{'motor' if encoder.side == 'motor' and arm.joint(k).elastic else 'joint'}{k}"]
        for k, encoder in enumerate(encoders)
    ]
    rows += [unit * own.rows[name] for unit, name in curvatures(setup)]
    bias = np.array([np.ptp(gauge.biases) / np.sqrt(12.0) for gauge in gauges])
    return designed(setup, gains, own, np.array(rows), np.array(_variances(setup, encoders)), bias)


def designed(setup: Setup, gains: LQGGains, own: Plant, seen: Array, variances: Array, bias: Array) -> Design:
    """Regulator and filter for what is seen: rows (p, 2n), of these variances; bias (b,): deviations of the last b."""
    from scipy.linalg import block_diag

    n, limits, size, count, p = setup.n_joints, np.asarray(setup.torque_limits), len(own.A), len(bias), len(seen)
    C, more = np.hstack([seen, np.zeros((p, n)), np.eye(p)[:, p - count :]]), n + count
    A = block_diag(own.A, np.eye(more))
    A[:size, size : size + n] = own.B

    turn = np.roll(own.rigid, size // 2, axis=0) @ np.linalg.inv(own.inertia) * setup.control_dt
    unseen = np.hstack([own.B * gains.noise * limits, turn * gains.push * limits])
    push = unseen @ unseen.T + 1e-12 * np.eye(size)
    V, drift = np.diag(variances), np.diag((gains.drift * limits) ** 2)
    W = block_diag(push, drift, np.diag((WALK * bias) ** 2))
    start = own.rigid @ V[:n, :n] @ own.rigid.T
    for _ in range(UNREST):
        start = own.A @ start @ own.A.T + push
    S, L = block_diag(start, drift, np.diag(bias**2)), np.empty((LEARNING, size + more, p))
    for k in range(LEARNING):
        L[k] = np.linalg.solve(C @ S @ C.T + V, C @ S).T
        S = A @ (S - L[k] @ C @ S) @ A.T + W
        S = 0.5 * (S + S.T)

    rates = [own.rows.get(f"motor{k}_rate", own.rows[f"joint{k}_rate"]) for k in range(n)]
    none = np.zeros((more, n))
    return Design(
        A, np.vstack([own.B, none]), C, np.hstack([_regulator(setup, gains, own), np.eye(n), np.zeros((n, count))]),
        L, np.hstack([rates, none.T]), np.vstack([own.rigid, none]), own.states,
    )  # fmt: skip


def _regulator(setup: Setup, gains: LQGGains, own: Plant) -> Array:
    """K (N, 2n)."""
    weights = gains.angle, gains.rate / own.first, gains.bend, gains.bend_rate / own.first
    Q = np.vstack([weight * rows for weight, rows in zip(weights, own.shown, strict=True)])
    R = np.diag(1.0 / np.asarray(setup.torque_limits) ** 2)
    return riccati(own.A, own.B, Q.T @ Q + 1e-9 * np.eye(len(own.A)), R)[0]


def curvatures(setup: Setup) -> list[tuple[float, str]]:
    """Of each gauge that is observed: its reading over the output of a linear model, and that output's name."""
    return [
        (g.per_curvature_of(setup.arm.links[g.link]) * float(np.mean(g.gains)), gauge_name(g.link, g.place, g.measures))
        for g in gauges_of(setup).values()
    ]


def gauges_of(setup: Setup) -> dict[int, StrainGauge]:
    """The gauges that are observed, by their entries' places in the observation."""
    all_of = setup.sensors.strain_gauges if setup.sensors else ()
    found = {f"strain_gauge_{k}": gauge for k, gauge in enumerate(all_of, 1)}
    return {k: found[name] for k, name in enumerate(setup.names) if name in found}


def _encoders(setup: Setup) -> list[Encoder]:
    """Those of the joints; ideal ones where none are known."""
    known = setup.sensors if setup.sensors and setup.sensors.encoders else Sensors.ideal(setup.arm.links)
    return [known.encoder(k).behind(setup.arm.joint(k).gear_ratio) for k in range(setup.n_joints)]


def _variances(setup: Setup, encoders: list[Encoder]) -> list[float]:
    """Of each angle and gauge: its noise, its counts, what all entries have, and what the model is not trusted to."""
    gauges, added = gauges_of(setup), setup.noise or (0.0,) * len(setup.names)
    places = [*(setup.names.index(f"{joint}_error") for joint in setup.arm.joint_names), *gauges]
    least = [*(FINEST_ANGLE for _ in encoders), *(FINEST_GAUGE * setup.scales[k] for k in gauges)]
    return [
        part.noise**2 + part.step**2 / 12.0 + added[k] ** 2 + finest**2
        for part, k, finest in zip([*encoders, *gauges.values()], places, least, strict=True)
    ]


class LQG(Controller):
    """u = -K x - d + f, x and d from the filter, f what friction is going to take.

    Attributes: z (n, s): estimates, each about its own goal (see `Design`).
    """

    needs_goals = True

    def __init__(self, setup: Setup, gains: LQGGains) -> None:
        super().__init__(setup)
        self.gains = gains
        self.friction = np.array([setup.arm.joint(k).friction_coulomb for k in range(setup.n_joints)])
        self.centres = np.array([np.mean(gauge.biases) for gauge in gauges_of(setup).values()])

    def initialise(self, signals: Signals, to_go: Array) -> None:
        self.parts = self._parts(self.goal)
        self.z = np.zeros((len(to_go), self.parts[0][0].A.shape[0]))
        for d, rows in self.parts:
            self.z[rows] = -to_go[rows] @ d.rigid.T

    def _parts(self, angles: Array) -> list[tuple[Design, NDArray[np.bool_]]]:
        """The designs for arms at these joint angles (n, N), and whose they are."""
        found = postures(angles)
        return [
            (design(self.setup, self.gains, posture), np.array([posture == one for one in found]))
            for posture in dict.fromkeys(found)
        ]

    def seen(self, signals: Signals, to_go: Array) -> Array:
        """What the filter takes in, (n, p)."""
        return np.hstack([-to_go, signals.gauges - self.centres])

    def torques(self, signals: Signals, to_go: Array) -> Array:
        y, torques = self.seen(signals, to_go), np.zeros_like(to_go)
        self.parts = self._parts(self.goal - to_go)
        for d, rows in self.parts:
            z = self.z[rows]
            z = z + (y[rows] - z @ d.C.T) @ d.L[min(self.step, LEARNING - 1)].T
            u = -z @ d.K.T
            self.z[rows], torques[rows] = z, u + self._friction(d, z, u, SHARP)
        return torques

    def predict(self, torques: Array) -> None:
        for d, rows in self.parts:
            z, u = self.z[rows], torques[rows]
            self.z[rows] = z @ d.A.T + (u - self._friction(d, z, u)) @ d.B.T

    def _friction(self, d: Design, z: Array, torques: Array, sharp: float = 1.0) -> Array:
        """Coulomb friction (n, N) over the next period: what stops the motors by its end, if it can."""
        rates = z @ (d.stopping @ d.A).T + torques @ (d.stopping @ d.B).T
        stops = sharp * rates / np.diagonal(d.stopping @ d.B)
        return np.clip(stops, -self.friction, self.friction)


FARTHEST = 1.0
"""rad that a joint is pulled by at most, as if its goal were no farther."""


def plant_in_space(setup: Setup, gravity: Array, angles: Array) -> tuple[Plant, dict[str, float]]:
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
    discrete, inertia = held(A, free.B, setup.control_dt), holding(arm, gravity, angles[None])[1][0]
    return Plant(*discrete, rows, rigid, inertia, first, free.states, _shown(arm, rows)), y


class SpatialLQG(LQG, AboutRest):
    """u = what holds the arm - K x - d + f, about its goal (see `LQG`)."""

    def initialise(self, signals: Signals, to_go: Array) -> None:
        AboutRest.initialise(self, signals, to_go)
        plants = [plant_in_space(self.setup, self.gravity, angles) for angles in self.goal]
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
        noise = np.repeat([SENSOR, SENSOR * own.first] * 2, [len(part) for part in own.shown])
        return designed(self.setup, self.gains, own, np.vstack(own.shown), noise**2, np.zeros(0))

    def resting(self, y: dict[str, float]) -> list[float]:
        """What is seen at the goal."""
        still = [y[name] / over for name, over in bent_of(self.setup.arm)]
        return [0.0] * (2 * self.setup.n_joints) + still + [0.0] * len(still)

    def seen(self, signals: Signals, to_go: Array) -> Array:
        """What the filter takes in, about what it is at the goal, (n, p)."""
        found: Array = signals.outputs(-to_go) - self.at_rest
        return found
