"""PD control of the joints. In space the set point is the arm's equilibrium at the target under gravity."""

import warnings
from dataclasses import dataclass, field

import numpy as np

from .. import validation as check
from ..geometry.inverse import approach
from ..parameters import Arm
from ..rigid import tip_at, weight_and_inertia
from ..validation import Array
from .arm_model import arm_model
from .base import Controller, Gains, Setup, Signals
from .loop import pd_law, plant, radius
from .space import NEAR, AboutRest, bent_postures

POSTURES = (0.0, 0.8, 1.6, 2.4)
"""Elbow angles, rad, at which PD control must be stable, unless joint limits exclude them."""

RIGID_STEPS = 15
"""Number of iterations of the inverse kinematics for goals of the rigid arm."""


@dataclass(frozen=True)
class PDGains(Gains):
    """Gains of PD control; they are dimensionless, so that they apply to arms of any size.

    Args:
        bandwidth (N,): natural frequency of each joint of the rigid arm under its proportional gain, divided by the
            arm's first flexible frequency. A single number applies to all joints.
        ratio (N,): damping ratio of each joint of the rigid arm. A single number applies to all joints.
    """

    bandwidth: tuple[float, ...]
    ratio: tuple[float, ...]

    def of(self, arm: Arm) -> tuple[Array, Array]:
        """Compute kp (N,), N m/rad, and kd (N,), N m s/rad, from the arm's inertia with elbows at 90 degrees."""
        for name, given in (("bandwidth", self.bandwidth), ("ratio", self.ratio)):
            if np.size(given) not in (1, arm.n_links):
                raise check.InvalidValue(f"pd.{name}", given, f"must be one number, or {arm.n_links}, one per joint")
        model = arm_model(arm, (0.5 * np.pi,) * (arm.n_links - 1))
        # kp = I omega^2, kd = 2 zeta I omega, omega = bandwidth * first flexible frequency
        inertia = np.diag(model.inertia)
        omega = np.asarray(self.bandwidth) * model.frequencies[0]
        return inertia * omega**2, 2.0 * np.asarray(self.ratio) * inertia * omega

    def on(self, setup: Setup) -> tuple[Array, Array]:
        """Return kp and kd for the setup's arm (see `of`); warn if the loop is unstable."""
        if not self.stable(setup):
            what = f"PD gains are unstable on arm {setup.arm.name!r} in periods of {setup.control_dt:g} s"
            if setup.delay or setup.lag:
                what += f" with a delay of {setup.delay:g} s and a lag of {setup.lag:.3g} s"
            warnings.warn(f"{what}: tune them for it (flexarm tune), or take lqr", UserWarning, stacklevel=4)
        return self.of(setup.arm)

    def stable(self, setup: Setup, factor: float = 1.0) -> bool:
        """Return whether the sampled linear loop is stable in all `POSTURES`, with the setup's delay and motor lag.

        factor: factor by which the gains are multiplied.
        """
        law = pd_law(*self.of(setup.arm))
        models = [arm_model(setup.arm, posture) for posture in postures_of(setup.arm)]
        systems = [plant(model, setup.control_dt, setup.delay, setup.lag) for model in models]
        return all(radius(system, law, factor) < 1.0 for system in systems)


def postures_of(arm: Arm) -> list[tuple[float, ...]]:
    """Return the postures (elbow angles, rad) in which loops must be stable.

    All elbows have the same angle, one of `POSTURES`, limited by the joint limits.
    """
    limits = [pair for pair in (arm.joint_limits or ())[1:] if pair is not None]
    angles = [angle for angle in POSTURES if all(low <= angle <= high for low, high in limits)]
    return [(angle,) * (arm.n_links - 1) for angle in angles] if arm.n_links > 1 else [()]


class PD(Controller):
    """PD controller: torque = kp (goal - angle) - kd rate, joint by joint."""

    restarts = True

    def __init__(self, setup: Setup, gains: PDGains) -> None:
        super().__init__(setup)
        self.kp, self.kd = gains.on(setup)

    def linear(self) -> Array | None:
        """Return the matrix K (entries, N) of the linear control law: unsaturated actions are observation @ K.

        The result is None if the observation does not contain the goal's joint angles.
        """
        if not self.read.aimed:
            return None
        setup, first = self.setup, self.setup.size - len(self.setup.names)
        K = np.zeros((setup.size, setup.n_joints))
        for joint, (error, rate) in enumerate(zip(self.read._goals, self.read._rates, strict=True)):
            K[first + error, joint] = self.kp[joint] * setup.scales[error] / self.limits[joint]
            K[first + rate, joint] = -self.kd[joint] * setup.scales[rate] / self.limits[joint]
        return K

    passed = 1.0
    """Share of a change of the rates that the rate filter passes in a period; 1: no filter."""

    def torques(self, signals: Signals, to_go: Array) -> Array:
        return self.kp * to_go - self.kd * signals.rates

    def towards(self, wanted: Array, angles: Array, rates: Array) -> Array:
        """Return PD torques (N,), N m, for set points `wanted`, rad, joint angles, rad, and filtered rates, rad/s."""
        found: Array = self.kp * (wanted - angles) - self.kd * rates
        return found


@dataclass(frozen=True)
class SpatialPDGains(Gains):
    """Gains of PD control in space.

    ratio: damping ratio. lag: time constant, s, of the low-pass on rates. Without the low-pass, feedback of the sampled
    rate of a beam's root is unstable, because the root has little inertia. rests: 1: goals are static equilibria of the
    flexible arm. 0: goals are postures of the rigid arm. The computation of a posture takes a hundredth of the time of
    an equilibrium, but the sag of the links remains as an error.
    """

    rate: float
    ratio: float
    lag: float
    rests: int = field(default=1, kw_only=True)


class SpatialPD(AboutRest):
    """Holding torque of the arm plus PD control about its goal, with filtered joint rates."""

    restarts = True

    def __init__(self, setup: Setup, gains: SpatialPDGains) -> None:
        super().__init__(setup)
        self.gains = gains
        self.passed = float(1.0 - np.exp(-setup.control_dt / gains.lag))
        """Share of a change of the rates that passes the rate filter per period."""

    def _goal(self, signals: Signals) -> Array:
        if self.gains.rests:
            return super()._goal(signals)
        # rigid arm: observed goal angles, or else inverse kinematics
        if signals.to_go is not None:
            goals = signals.angles + signals.to_go
        else:
            goals = self._rigid(self.targets(signals), signals.angles)
        self.torque = weight_and_inertia(self.setup.arm, self.gravity, goals, self.bodies)[0]
        return goals

    def _rigid(self, targets: Array, now: Array) -> Array:
        """Return joint angles (n, N), rad, of the rigid arm with its tip at the targets (n, 3), m.

        The search starts from the angles `now` (n, N) and from two bent postures; the nearest tip wins.
        """
        starts = np.stack([now + 0.3, *bent_postures(now)])
        found = approach(self.setup.arm, starts, np.broadcast_to(targets, (len(starts), *targets.shape)), RIGID_STEPS)
        off = np.linalg.norm(tip_at(self.setup.arm, found) - targets, axis=-1)
        # equally near tips: the first start
        best = np.argmin(off > np.maximum(off.min(axis=0), NEAR * self.setup.arm.total_length), axis=0)
        return np.asarray(found[best, np.arange(len(now))])

    def rest_at(self, target: Array, now: Array) -> tuple[float, Array, Array]:
        """Return target distance, joint angles and holding torques at rest; if `rests` is 0, the arm is rigid."""
        if self.gains.rests:
            return super().rest_at(target, now)
        angles = self._rigid(target[None], now[None])
        torques = weight_and_inertia(self.setup.arm, self.gravity, angles, self.bodies)[0]
        return float(np.linalg.norm(tip_at(self.setup.arm, angles[0]) - target)), angles[0], torques[0]

    def initialise(self, signals: Signals, to_go: Array) -> None:
        super().initialise(signals, to_go)
        self.rates = signals.rates.copy()

    def torques(self, signals: Signals, to_go: Array) -> Array:
        return self.forward(to_go) + self.pulled(signals, to_go)

    def pulled(self, signals: Signals, to_go: Array, rates: Array | float = 0.0) -> Array:
        """Update the rate filter; return PD torques (n, N), N m: inertia matrix at the goal times PD accelerations.

        to_go (n, N): goal minus joint angles, rad. rates: desired joint rates (n, N), rad/s.
        """
        # first-order low-pass of the rate error
        self.rates += self.passed * (signals.rates - rates - self.rates)
        found: Array = np.diagonal(self.inertia, axis1=1, axis2=2) * self._pull(to_go, self.rates)
        return found

    def _pull(self, to_go: Array, rates: Array) -> Array:
        """Return the joints' PD accelerations, rad/s^2: rate^2 error - 2 ratio rate velocity; errors at most 1 rad."""
        rate, ratio = self.gains.rate, self.gains.ratio
        found: Array = rate * rate * np.clip(to_go, -1.0, 1.0) - 2.0 * ratio * rate * rates
        return found

    def towards(self, wanted: Array, angles: Array, rates: Array) -> Array:
        """Return PD torques plus the rigid arm's gravity torques (N,), N m, for set points `wanted`, rad.

        angles, rates (N,): joint angles, rad, and filtered rates, rad/s.
        """
        # gravity compensation, and gains scaled by the joint's inertia
        weight, inertia = weight_and_inertia(self.setup.arm, self.gravity, angles[None], self.bodies)
        found: Array = weight[0] + np.diag(inertia[0]) * self._pull(wanted - angles, rates)
        return found
