"""LQG: linear-quadratic regulator whose state is estimated by a Kalman filter from sensor readings.

The filter's model is the linearization of `flexarm_env.linear` about rest at the current joint angles, over a control
period with constant torque. The model's state contains the arm's state x, a constant disturbance torque d at each joint
and the bias b of each gauge:

    x+ = A x + B (u - f + d) + w,   angles = C x + v,   gauges = C x + b + v

Here w and v are process and measurement noise, and f are the joints' Coulomb friction torques. The filter can estimate
gauge biases, since a bias is constant, whereas bending decays. The filter does not estimate encoder biases, which are
indistinguishable from a rotation of the arm. The filter uses the measured joint angles, but not the joint rates, which
are computed from these angles. The model omits sensor delays, sensor low-passes, and motor lag.
"""

import re
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..linear.point import gauge_name
from ..linear.state_space import held
from ..parameters import Arm
from ..physics.reading import reading_of
from ..rigid import rigid_inertia
from ..sensors import Encoder, Sensors, StrainGauge
from ..validation import Array
from .arm_model import linear_model, postures
from .base import Controller, Setup, Signals
from .lqr import SENSOR, StateWeights, riccati
from .space import AboutRest, held_model

FINEST_ANGLE = 1e-4
"""Smallest standard deviation, rad, that the filter assumes for an encoder's angle."""

FINEST_GAUGE = 1e-2
"""Smallest standard deviation of a gauge, divided by the gauge's scale, which is its reading at the curvature under
full joint torque."""

SHARP = 4.0
"""Factor of the friction compensation on the torque that would stop the motor in a period.

The compensation is this product, limited to the friction torque. With a factor above 1 the motor still makes small
motions. Friction of even smaller motions is not compensated, since compensating it would cause a limit cycle."""

WALK = 1e-3
"""Random walk of a bias per control period, divided by the bias's standard deviation."""

UNREST, LEARNING = 10, 150
"""Number of control periods of process noise that the filter assumes before an episode; number of control periods after
which the filter's gains have converged."""


@dataclass(frozen=True)
class LQGGains(StateWeights):
    """`StateWeights` of the regulator and noise parameters of the filter.

    Args:
        noise: standard deviation of the process noise of the joint torques, divided by the torque limit. push: standard
            deviation, divided by the torque limit, of the process noise of forces on the links. The noise of forces on
            the links represents the nonlinear effects of large motions.
        drift: standard deviation of the disturbance torque's change in one control period, divided by the limit.
    """

    noise: float = 0.02
    push: float = 0.01
    drift: float = 2e-4


class Plant(NamedTuple):
    """Linear model of an arm about rest over a control period: x+ = A x + B u; outputs are rows @ x.

    rigid (2n, N): derivative of x by the joint angles of the undeformed arm. inertia (N, N): rigid inertia of the arm,
    kg m^2. first: lowest flexible frequency with free joints, rad/s. states: names of the model's states x. shown:
    output rows of four groups: joint angles, joint rates, outputs of `bent_of`, and the rates of these outputs.
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
    """Regulator and filter for the state z = (x, d, b), which has s entries.

    The model is z+ = A z + B u, y = C z. The regulator is u = -K z. In control period k of an episode the filter adds
    L[k] (y - C z) to its estimate. x: state of the arm. d (N,): disturbance torques, N m. b: biases of the gauges.
    stopping (N, s): matrix from z to the motors' rates, rad/s. rigid (s, N): derivative of z by the joint angles of the
    undeformed arm. states: names of x, as in `LinearModel.states`.
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
    """Linearize the arm about rest at a posture (elbow angles, rad), with the observed strain gauges as outputs."""
    n, places = setup.n_joints, [(gauge.link, gauge.place) for gauge in gauges_of(setup).values()]
    free = linear_model(setup.arm, posture, gauges=places)
    period = linear_model(setup.arm, posture, gauges=places, discrete=setup.control_dt, method="zoh")
    size = len(free.A) // 2
    # M^-1 K, and rows of the joint angles by q
    stiffness, joints = free.A[size:, :size], free.C[[free.outputs.index(f"joint{k}") for k in range(n)], :size]
    # rigid modes: null space of M^-1 K, scaled to unit joint angles
    modes = np.linalg.svd(stiffness)[2][-n:].T
    rigid = np.vstack([modes @ np.linalg.inv(joints @ modes), np.zeros((size, n))])
    # the n rigid modes have frequency 0: the next one is the lowest flexible frequency
    first = float(np.sqrt(np.sort(-np.linalg.eigvals(stiffness).real)[n]))
    rows = dict(zip(free.outputs, free.C, strict=True))
    inertia = rigid_inertia(setup.arm, np.array([(0.0, *(posture or (0.0,) * (n - 1)))]))[0]
    return Plant(period.A, period.B, rows, rigid, inertia, first, free.states, _shown(setup.arm, rows))


def bent_of(arm: Arm) -> list[tuple[str, float]]:
    """Return outputs (name, divisor) of the linear model: an output divided by its divisor is in `Signals.bends`.

    The divisor of a deflection is the link's length. In space the outputs are the flexible links' deflections along y
    and z, and twists (rad, with divisor 1).
    """
    found = []
    for name in reading_of(arm).bent:
        what, axis = re.fullmatch(r"(?:tip_)?([a-z]+)(_[yz])?", name).groups("")  # type: ignore[union-attr]
        over = [(k, 1.0 if what == "twist" else link.span) for k, link in enumerate(arm.links) if not link.rigid]
        found += [(f"{what}{k}{axis}", divisor) for k, divisor in over]
    return found


def _shown(arm: Arm, rows: dict[str, Array]) -> list[Array]:
    """Return the output rows of joint angles, of the outputs of `bent_of`, and of the rates of both (`Plant.shown`)."""
    parts = [(f"joint{k}", 1.0) for k in range(arm.n_links)], bent_of(arm)
    return [
        np.array([rows[name + end] / over for name, over in part]).reshape(-1, len(rows["joint0"]))
        for part in parts for end in ("", "_rate")
    ]  # fmt: skip


@lru_cache(maxsize=256)
def design(setup: Setup, gains: LQGGains, posture: tuple[float, ...] = ()) -> Design:
    """Compute regulator and filter of an arm about rest at a posture (elbow angles, rad)."""
    return measured(setup, gains, plant(setup, posture))


def measured(setup: Setup, gains: LQGGains, own: Plant) -> Design:
    """Compute the design for measurements by the joints' encoders and the observed strain gauges."""
    arm, gauges, encoders = setup.arm, list(gauges_of(setup).values()), _encoders(setup)
    # output rows: motor or joint angles, then gauge readings
    rows = [
        own.rows[f"{'motor' if encoder.side == 'motor' and arm.joint(k).elastic else 'joint'}{k}"]
        for k, encoder in enumerate(encoders)
    ]
    rows += [unit * own.rows[name] for unit, name in curvatures(setup)]
    # standard deviation of a uniform distribution
    bias = np.array([np.ptp(gauge.biases) / np.sqrt(12.0) for gauge in gauges])
    return designed(setup, gains, own, np.array(rows), np.array(_variances(setup, encoders)), bias)


def designed(setup: Setup, gains: LQGGains, own: Plant, seen: Array, variances: Array, bias: Array) -> Design:
    """Compute regulator and time-varying Kalman gains for p measurements of the arm's state x.

    seen (p, 2 n): output matrix of the measurements `seen` @ x; x contains n coordinates and their n rates. variances
    (p,): variances of the measurements. bias (b,): standard deviations of the biases of the last b measurements.
    """
    from scipy.linalg import block_diag

    n, limits, size, count, p = setup.n_joints, np.asarray(setup.torque_limits), len(own.A), len(bias), len(seen)
    # augmented model: z = (x, d, b); d acts like a torque
    C, more = np.hstack([seen, np.zeros((p, n)), np.eye(p)[:, p - count :]]), n + count
    A = block_diag(own.A, np.eye(more))
    A[:size, size : size + n] = own.B

    # process noise: torques, and forces that turn the links rigidly
    turn = np.roll(own.rigid, size // 2, axis=0) @ np.linalg.inv(own.inertia) * setup.control_dt
    unseen = np.hstack([own.B * gains.noise * limits, turn * gains.push * limits])
    push = unseen @ unseen.T + 1e-12 * np.eye(size)
    V, drift = np.diag(variances), np.diag((gains.drift * limits) ** 2)
    W = block_diag(push, drift, np.diag((WALK * bias) ** 2))
    # initial covariance: encoder errors, then UNREST periods of noise
    start = own.rigid @ V[:n, :n] @ own.rigid.T
    for _ in range(UNREST):
        start = own.A @ start @ own.A.T + push
    S, L = block_diag(start, drift, np.diag(bias**2)), np.empty((LEARNING, size + more, p))
    # Kalman gain L = S C' (C S C' + V)^-1, then S+ = A (I - L C) S A' + W
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
    """Compute the regulator gain K (N, 2n), u = -K x, from the weights in `gains` on the outputs `Plant.shown`."""
    weights = gains.angle, gains.rate / own.first, gains.bend, gains.bend_rate / own.first
    # Q = sum of weighted output rows, R = 1 / limit^2
    Q = np.vstack([weight * rows for weight, rows in zip(weights, own.shown, strict=True)])
    R = np.diag(1.0 / np.asarray(setup.torque_limits) ** 2)
    return riccati(own.A, own.B, Q.T @ Q + 1e-9 * np.eye(len(own.A)), R)[0]


def curvatures(setup: Setup) -> list[tuple[float, str]]:
    """Return, for each observed gauge, its reading per curvature and the name of its output in the linear model."""
    return [
        (g.per_curvature_of(setup.arm.links[g.link]) * float(np.mean(g.gains)), gauge_name(g.link, g.place, g.measures))
        for g in gauges_of(setup).values()
    ]


def gauges_of(setup: Setup) -> dict[int, StrainGauge]:
    """Return a dict of the observed gauges; its keys are the indices of their entries in the observation."""
    all_of = setup.sensors.strain_gauges if setup.sensors else ()
    found = {f"strain_gauge_{k}": gauge for k, gauge in enumerate(all_of, 1)}
    return {k: found[name] for k, name in enumerate(setup.names) if name in found}


def _encoders(setup: Setup) -> list[Encoder]:
    """Return the joints' encoders on the motor or joint side of their gears; ideal encoders if none are known."""
    known = setup.sensors if setup.sensors and setup.sensors.encoders else Sensors.ideal(setup.arm.links)
    return [known.encoder(k).behind(setup.arm.joint(k).gear_ratio) for k in range(setup.n_joints)]


def _variances(setup: Setup, encoders: list[Encoder]) -> list[float]:
    """Return the measurement variances of joint angles and gauges.

    The variances include sensor noise, quantization, observation noise and model error.
    """
    gauges, added = gauges_of(setup), setup.noise or (0.0,) * len(setup.names)
    places = [*(setup.names.index(f"{joint}_error") for joint in setup.arm.joint_names), *gauges]
    least = [*(FINEST_ANGLE for _ in encoders), *(FINEST_GAUGE * setup.scales[k] for k in gauges)]
    return [
        # quantization with uniform error: step^2 / 12
        part.noise**2 + part.step**2 / 12.0 + added[k] ** 2 + finest**2
        for part, k, finest in zip([*encoders, *gauges.values()], places, least, strict=True)
    ]


class LQG(Controller):
    """LQG controller u = -K x - d + f with estimates of the state x and of the disturbance torques d.

    The term f compensates for the Coulomb friction of the estimated motion.

    Attributes:
        z (n, s): estimates of the state z of `Design` for n arms, relative to each arm's goal.
    """

    needs_goals = True

    def __init__(self, setup: Setup, gains: LQGGains) -> None:
        super().__init__(setup)
        self.gains = gains
        self.friction = np.array([setup.arm.joint(k).friction_coulomb for k in range(setup.n_joints)])
        self.centres = np.array([np.mean(gauge.biases) for gauge in gauges_of(setup).values()])

    def initialise(self, signals: Signals, to_go: Array) -> None:
        """Set the estimates to the undeformed arm at rest. to_go (n, N): goal minus joint angles, rad."""
        self.parts = self._parts(self.goal)
        self.z = np.zeros((len(to_go), self.parts[0][0].A.shape[0]))
        for d, rows in self.parts:
            self.z[rows] = -to_go[rows] @ d.rigid.T

    def _parts(self, angles: Array) -> list[tuple[Design, NDArray[np.bool_]]]:
        """Group arms by design: return the designs for joint angles (n, N), rad, each with a mask (n,) of its arms."""
        found = postures(angles)
        return [
            (design(self.setup, self.gains, posture), np.array([posture == one for one in found]))
            for posture in dict.fromkeys(found)
        ]

    def seen(self, signals: Signals, to_go: Array) -> Array:
        """Return the measurements (n, p): joint angles minus goal angles, rad, and gauge readings minus mean biases."""
        return np.hstack([-to_go, signals.gauges - self.centres])

    def torques(self, signals: Signals, to_go: Array) -> Array:
        """Correct the estimates with the measurements; return torques (n, N), N m, with friction compensation."""
        y, torques = self.seen(signals, to_go), np.zeros_like(to_go)
        # gain-scheduled by the current joint angles
        self.parts = self._parts(self.goal - to_go)
        for d, rows in self.parts:
            z = self.z[rows]
            # z += L (y - C z);  u = -K z + f
            z = z + (y[rows] - z @ d.C.T) @ d.L[min(self.step, LEARNING - 1)].T
            u = -z @ d.K.T
            self.z[rows], torques[rows] = z, u + self._friction(d, z, u, SHARP)
        return torques

    def predict(self, torques: Array) -> None:
        """Advance the estimates by one period under the applied torques (n, N), N m, minus the friction."""
        for d, rows in self.parts:
            z, u = self.z[rows], torques[rows]
            self.z[rows] = z @ d.A.T + (u - self._friction(d, z, u)) @ d.B.T

    def _friction(self, d: Design, z: Array, torques: Array, sharp: float = 1.0) -> Array:
        """Predict the Coulomb friction (n, N), N m, in the next period: the torque that stops the motors, limited.

        The predicted friction torque stops the motors by the end of the period. The limit is the joints' friction
        torque. sharp: factor by which the torque is multiplied before it is limited.
        """
        # motor rates at the end of the period without friction; torque that makes them zero
        rates = z @ (d.stopping @ d.A).T + torques @ (d.stopping @ d.B).T
        stops = sharp * rates / np.diagonal(d.stopping @ d.B)
        return np.clip(stops, -self.friction, self.friction)


FARTHEST = 1.0
"""Largest joint error, rad, that the regulator acts on."""


def plant_in_space(setup: Setup, gravity: Array, angles: Array) -> tuple[Plant, dict[str, float]]:
    """Linearize an arm in space about rest at joint angles (N,), rad, with the rigid arm's gravity torques compensated.

    Returns the `Plant`, and the values of the outputs at rest by name.
    """
    arm, n = setup.arm, setup.n_joints
    free, joints, A = held_model(arm, gravity, angles, [gauge.spot for gauge in gauges_of(setup).values()])
    rows, y = dict(zip(free.outputs, free.C, strict=True)), dict(zip(free.outputs, free.y.tolist(), strict=True))
    size = len(free.A) // 2
    # a stiff arm turns as the flexible one does where its joints are turned slowly
    turned = np.block([[free.A[size:, :size], free.B[size:]], [joints[:, :size], np.zeros((n, n))]])
    turned /= np.abs(turned).max(axis=1, keepdims=True)
    slow = np.linalg.solve(turned, np.vstack([np.zeros((size, n)), np.eye(n)]))[:size]
    rigid = np.vstack([slow, np.zeros((size, n))])
    # lowest flexible frequency; a stiff arm has none
    squares = np.sort(-np.linalg.eigvals(A[size:, :size]).real)
    first = float(np.sqrt(squares[n])) if size > n else 1.0 / setup.control_dt
    # zero-order hold over a control period
    discrete, inertia = held(A, free.B, setup.control_dt), rigid_inertia(arm, angles[None])[0]
    return Plant(*discrete, rows, rigid, inertia, first, free.states, _shown(arm, rows)), y


class SpatialLQG(LQG, AboutRest):
    """LQG controller in space, about the goal: u = holding torque - K x - d + f (see `LQG`)."""

    def initialise(self, signals: Signals, to_go: Array) -> None:
        """Compute the arm at rest, the design and the expected measurements at each arm's goal."""
        AboutRest.initialise(self, signals, to_go)
        plants = [plant_in_space(self.setup, self.gravity, angles) for angles in self.goal]
        self.designs = [(self.design(own), np.arange(len(plants)) == i) for i, (own, _) in enumerate(plants)]
        self.at_rest = np.array([self.resting(y) for _, y in plants])
        LQG.initialise(self, signals, to_go)

    def design(self, own: Plant) -> Design:
        """Compute regulator and filter of a plant for encoders and gauges."""
        return measured(self.setup, self.gains, own)

    def resting(self, y: dict[str, float]) -> list[float]:
        """Return the measurements at the goal. y: outputs of the linear model at the goal, by name."""
        return [0.0] * self.setup.n_joints + [unit * y[name] for unit, name in curvatures(self.setup)]

    def seen(self, signals: Signals, to_go: Array) -> Array:
        """Return the filter's measurements (n, p) relative to their values at the goal."""
        found: Array = super().seen(signals, to_go) - self.at_rest
        return found

    def _parts(self, angles: Array) -> Any:
        return self.designs

    def torques(self, signals: Signals, to_go: Array) -> Array:
        """Return holding torques plus feedback (n, N), N m; joint errors are limited to `FARTHEST`, rad."""
        # feedforward: holding torques at the present angles
        self.held = self.forward(to_go)
        torques, beyond = super().torques(signals, to_go), to_go - np.clip(to_go, -FARTHEST, FARTHEST)
        # remove the regulator's response to the error beyond the limit
        for d, rows in self.designs:
            torques[rows] -= beyond[rows] @ (d.K @ d.rigid).T
        return self.held + torques

    def predict(self, torques: Array) -> None:
        super().predict(torques - self.held)


class SpatialLQR(SpatialLQG):
    """LQR in space: a `SpatialLQG` whose filter observes joint angles, deflections, twists and their rates."""

    needs_goals, needs_bends = False, True

    def design(self, own: Plant) -> Design:
        """Compute regulator and observer of a plant for the observed joint angles, deflections, twists and rates."""
        noise = np.repeat([SENSOR, SENSOR * own.first] * 2, [len(part) for part in own.shown])
        return designed(self.setup, self.gains, own, np.vstack(own.shown), noise**2, np.zeros(0))

    def resting(self, y: dict[str, float]) -> list[float]:
        """Return the measurements at the goal: deflections and twists from `y`, zeros for angles and rates.

        y: outputs of the linear model at the goal, by name.
        """
        still = [y[name] / over for name, over in bent_of(self.setup.arm)]
        return [0.0] * (2 * self.setup.n_joints) + still + [0.0] * len(still)

    def seen(self, signals: Signals, to_go: Array) -> Array:
        """Return the outputs (n, p) relative to their values at the goal."""
        found: Array = signals.outputs(-to_go) - self.at_rest
        return found
