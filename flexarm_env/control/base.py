"""Base class of controllers, the data of an environment that controllers use, and the conversion of observations."""

from __future__ import annotations

import copy
import hashlib
import json
import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, fields
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from .. import validation as check
from ..geometry.inverse import goal_angles
from ..geometry.plane import tip_in_hub_frame, wrapped
from ..parameters import Arm
from ..physics.reading import rate_name, reading_of
from ..rigid import rigid_inertia
from ..sensors import Sensors
from ..shapes import Shape
from ..tasks import RESIDUAL_SHARE as RESIDUAL_SHARE
from ..validation import Array

WHOLE = {"flexible": 1, "modes": 0, "block": 1, "horizon": 1, "iterations": 1, "first": 1, "rests": 0}
"""Names of the gains that must be integers, each with its smallest allowed value."""

SHARES: dict[str, dict[str, float]] = {
    "effort": {"above": 0.0, "maximum": 1.0}, "memory": {"minimum": 0.0, "maximum": 1.0}, "lag": {"above": 0.0},
    "drift": {"minimum": 0.0, "maximum": 1.0},
}  # fmt: skip
"""Names of the gains whose allowed range is not 0 to `MOST_GAIN`, each with its bounds."""

IN_SPACE = "space"
"""Name of the table of tuned gains for arms in space."""

MOST_GAIN = 1e6
"""Largest gain or weight, in its own unit; larger values make no sense for these arms."""


@dataclass(frozen=True)
class Gains:
    """Validated controller parameters; a parameter per joint is a tuple of N numbers or one number for all joints."""

    def __post_init__(self) -> None:
        """Validate every field against its bounds and store the converted value."""
        for field in fields(self):
            name, value = field.name, getattr(self, field.name)
            # per-joint fields may be tuples
            many = "tuple" in str(field.type) and isinstance(value, tuple | list)
            if name in WHOLE:
                if value is not None or field.default is not None:
                    value = check.integer(name, value, minimum=WHOLE[name])
            else:
                bounds = SHARES.get(name, {"minimum": 0.0, "maximum": MOST_GAIN})
                found = [check.number(name, one, "", **bounds) for one in (value if many else [value])]
                value = tuple(found) if many else found[0]
            check.store(self, **{name: value})


@dataclass(frozen=True)
class Setup:
    """Data of an environment that a controller can use: the nominal arm and the observation's layout, in SI units.

    Args:
        task: "slew" (one link, tip angle), "reach" (two links or more, tip position), "press" or "land" (at a wall).
        arm: the nominal arm. control_dt: control period, s. torque_limits (N,): joint torques at an action of 1, N m.
        names, scales: names and scales of the observation's entries, in order; entry = value / scale.
        history: number of instants in an observation, the oldest first.
        sensors: sensors that measure the entries; None: ideal or unknown sensors. noise: standard deviation of the
            noise on each entry, in the entry's unit; (): no noise.
        action_mode: the environment's keyword, which defines the meaning of an action; "": unknown. residual_share:
            with action_mode="residual_pd", the torque at an action of 1 divided by the torque limit.
        gravity: acceleration of gravity, m/s^2; None: no gravity. keep_out: shapes that the arm must avoid.
        delay: sum of the delays of torques and readings, s; for random delays the largest value. lag: time constant of
            the motors, s.
        wall: in the tasks "press" and "land" the bearing, rad, of the wall's point that is nearest to the root; None:
            no wall. wall_elevation: elevation of this point above the x-y plane, rad.
    """

    task: str
    arm: Arm
    control_dt: float
    torque_limits: tuple[float, ...]
    names: tuple[str, ...]
    scales: tuple[float, ...]
    history: int = 1
    sensors: Sensors | None = None
    noise: tuple[float, ...] = ()
    action_mode: str = ""
    residual_share: float | None = None
    gravity: tuple[float, ...] | None = None
    keep_out: tuple[Shape, ...] = ()
    delay: float = 0.0
    lag: float = 0.0
    wall: float | None = None
    wall_elevation: float = 0.0

    @classmethod
    def of(cls, env: Any) -> Setup:
        """Create the setup from an environment of this package, single or vector, with or without wrappers."""
        plain = getattr(env, "unwrapped", None)
        plan = getattr(plain, "plan", None)
        if plan is None:
            raise check.InvalidValue("env", env, "must be an environment of flexarm_env, single or vector")
        scales = tuple(float(s) for s in plan.scales)
        limits = plan.arm.torque_limits
        names, noise, extras = tuple(plan.names), (), plan.extras
        # noise of the selected entries in SI units; previous actions carry none
        if extras.sensors is not None and extras.sensors.noise.any():
            chosen = slice(None) if extras.selection is None else extras.selection.chosen
            own = np.concatenate([extras.sensors.noise, np.zeros(plan.arm.n_links)])
            noise = tuple((own[chosen][: len(plan.scales)] * plan.scales).tolist())
        share = None if extras.controller is None else float(extras.controller.share)
        wall = getattr(plan.kind.target, "wall", None)
        return cls(
            plan.kind.task, plan.arm, plan.period, limits, names, scales, plan.history, plan.sensors, noise,
            plan.action_mode, share, plan.gravity, plan.keep_out, *lateness(plan),
            None if wall is None else float(wall.bearing), 0.0 if wall is None else float(wall.elevation),
        )  # fmt: skip

    @property
    def gains(self) -> str:
        """Name of the table of tuned gains: the task, or "space" for an arm in space."""
        return self.arm.axes.table_of_gains(self.task)

    @property
    def n_joints(self) -> int:
        """Number of joints N."""
        return self.arm.n_links

    @property
    def size(self) -> int:
        """Number of entries in an observation, including previous instants (`history`)."""
        return len(self.names) * self.history

    @property
    def layout(self) -> str:
        """Hash of the observation's layout (names and scales to six digits, in order): 16 hexadecimal digits."""
        entries: list[Any] = [[name, f"{scale:.6g}"] for name, scale in zip(self.names, self.scales, strict=True)]
        entries += [] if self.history == 1 else [self.history]
        return hashlib.sha256(json.dumps(entries).encode()).hexdigest()[:16]


def lateness(plan: Any) -> tuple[float, float]:
    """Return (delay, lag), s, of an environment: sum of motor and sensor delay, and time constant of the motors.

    For a random delay the function returns the largest value. In a solver step dt the difference between the motor
    torque and the commanded torque is multiplied by exp(-dt / lag).
    """
    motors, sensors, step = plan.extras.actuator, plan.extras.sensors, plan.settings.dt
    delay = 0.0 if sensors is None else sensors.age * plan.period
    if motors is None:
        return delay, 0.0
    # whole periods, fixed solver steps, then the maxima of random delay and jitter
    delay += motors.age * plan.period + motors.late * step
    delay += 0.0 if motors.drawn is None else motors.drawn[1] * step
    delay += 0.0 if motors.jitter is None else motors.jitter[0] * step
    return delay, 0.0 if motors.share >= 1.0 else -step / math.log1p(-motors.share)


@dataclass(frozen=True)
class Signals:
    """Observation in SI units, one row per environment.

    Attributes:
        angles (n, N): joint angles, rad, wrapped to one turn.
        rates (n, N): joint rates, rad/s.
        bends (n, N): tip deflections divided by the links' lengths. For controllers in space that need deflections the
            shape is (n, 3 F): deflections of the F flexible links along y, then along z, then their twists (rad).
        bend_rates (n, N): rates of the entries of `bends`, 1/s.
        error: target minus tip angle (n, 1), rad, in task "slew"; otherwise the vector from tip to target (n, 2), m, in
            the frame that turns with the hub. In space the vector is (n, 3).
        to_go (n, N): the goal's joint angles minus the present joint angles, rad, only with observation="measured".
            With observation="measured" the arrays bends, bend_rates and error are empty.
        gauges (n, G): readings of the strain gauges, in the gauges' units.
    """

    angles: Array
    rates: Array
    bends: Array
    bend_rates: Array
    error: Array
    gauges: Array
    to_go: Array | None = None

    def outputs(self, angles: Array) -> Array:
        """Stack joint angles, joint rates, deflections and deflection rates as outputs of an arm's model.

        angles (n, N), rad: joint angles that replace the measured angles. Returns (n, 4 N), in space (n, 2 N + 6 F).
        """
        return np.concatenate([angles, self.rates, self.bends, self.bend_rates], axis=1)


class Reader:
    """Converter of observations to :class:`Signals`, from the newest instant of an observation.

    Args:
        setup: setup of the environment. who: name of the controller, for error messages. bends: True if deflections are
            required.
        goals: True if differences between goal and present joint angles are required. aims: True if goals are computed
            from deflections.
    Raises:
        ValueError: the observation lacks a required entry, which the message names.
    """

    def __init__(
        self, setup: Setup, who: str = "a controller", bends: bool = True, goals: bool = False, aims: bool = True
    ) -> None:
        """Look up the positions of all required entries in the observation."""
        self.scales, self.size = np.asarray(setup.scales), setup.size
        place = {name: i for i, name in enumerate(setup.names)}
        joints = setup.arm.joint_names
        arm, bent = setup.arm, reading_of(setup.arm).bent
        # only flexible links have deflections
        bending = [k for k, link in enumerate(arm.links) if (bends or aims) and not link.rigid]
        deflections, deflection_rates = (
            tuple(arm.by_link(name)[k] for name in names for k in bending) for names in (bent, map(rate_name, bent))
        )
        error = ("target_error",) if setup.task == "slew" else tuple(f"to_target_{axis}" for axis in arm.axes)
        to_go = tuple(f"{joint}_error" for joint in joints)
        self.aimed = goals or (
            not bends and any(name not in place for name in (*error, *deflections)) and to_go[0] in place
        )
        needed = [f"{joint}_{of}" for of in ("sin", "cos", "rate") for joint in joints]
        needed += to_go if self.aimed else [*deflections, *error]
        for name in (*needed, *(deflection_rates if bends else ())):
            if name not in place:
                known = ", ".join(setup.names)
                hint = ' (observation="measured" has it)' if name in to_go else ""
                raise ValueError(f"observation: {who} needs the entry {name}{hint}, which is not among {known}")
        # indices within one instant: an observation may stack several
        self._sin, self._cos, self._rates = ([place[f"{j}_{of}"] for j in joints] for of in ("sin", "cos", "rate"))
        self._bends, self._bend_rates, self._error, self._goals = (
            [place[name] for name in names if name in place] for names in (deflections, deflection_rates, error, to_go)
        )
        self._gauges = [place[name] for name in setup.names if name.startswith("strain_gauge_")]

    def __call__(self, observation: NDArray[np.floating]) -> Signals:
        """Read the newest instant of observations (n, entries) or (entries,), scaled to SI units."""
        seen = np.atleast_2d(check.floats("observation", observation))
        if seen.ndim != 2 or seen.shape[1] != self.size:
            raise check.InvalidValue("shape of observation", np.shape(observation), f"must be (n, {self.size})")
        # value = entry * scale; the newest instant is the last one
        values = seen[:, -len(self.scales) :] * self.scales
        if not math.isfinite(np.vdot(values, values)):  # quicker than to look at each
            row = np.flatnonzero(~(np.abs(values) < 1e100).all(axis=1))[0]
            raise check.InvalidValue(f"observation[{row}]", seen[row], "must be finite numbers, below 1e100 in size")
        # joint angles in [-pi, pi]
        angles = np.arctan2(values[:, self._sin], values[:, self._cos])
        return Signals(
            angles, values[:, self._rates], values[:, self._bends], values[:, self._bend_rates], values[:, self._error],
            values[:, self._gauges], values[:, self._goals] if self.aimed else None,
        )  # fmt: skip


class Controller(ABC):
    """Base class of controllers, which compute actions from observations for one or many environments.

    The environments begin their episodes together. Call `reset` with the first observation of the episodes, then `act`
    with every observation, including the first. A subclass implements :meth:`torques`, and sets its memory in
    :meth:`initialise`.
    """

    action_mode = "torque"
    needs_bends: ClassVar[bool] = False
    """True if the controller requires tip deflections and their rates."""
    needs_goals: ClassVar[bool] = False
    """True if the controller requires goal joint angles minus measured joint angles (observation="measured")."""
    aims: ClassVar[bool] = True
    """True if goals are computed from observed deflections."""
    omits_modes: ClassVar[bool] = True
    """True if the controller's linear model can omit vibration modes of the arm (`margins.warn_of_growth`)."""
    follows_goal: ClassVar[bool] = True
    """True if the controller follows observed goal joint angles in every period; False if `reset` fixes the goal."""
    restarts: ClassVar[bool] = False
    """True if single environments can begin a new episode (`restart`), each with its own memory."""

    def __init__(self, setup: Setup) -> None:
        """Store the setup and torque limits, and prepare the observation reader."""
        self.setup = setup
        self.limits = np.asarray(setup.torque_limits)
        self.read = Reader(setup, type(self).__name__, self.needs_bends, self.needs_goals, self.aims)
        self.goal = np.zeros((0, setup.n_joints))
        """Joint angles (n, N) of the arm at rest at its target, unwrapped from the angles at the start."""

    def reset(self, observation: NDArray[np.floating]) -> None:
        """Begin episodes: set goal joint angles and memory from the first observation, (n, entries) or (entries,)."""
        signals = self.read(observation)
        self.step = 0
        self._angles = signals.angles.copy()
        self.goal = self._goal(signals)
        self.initialise(signals, self.goal - self._angles)

    def restart(self, observation: NDArray[np.floating], rows: NDArray[np.bool_]) -> None:
        """Begin new episodes in some environments; the memory of all other environments does not change.

        observation (n, entries): observations of all environments. rows (n,): True for environments that begin an
        episode. Raises ValueError if the attribute `restarts` is False.
        """
        if not self.restarts:
            what = "must be pd or a controller of the contact force: the memory of other controllers begins"
            what += " for all environments together"
            raise check.InvalidValue("controller", type(self).__name__, what)
        if not rows.any():
            return
        begun = copy.copy(self)
        begun.reset(observation[rows])
        # memory: the arrays with one row per environment that `reset` has made
        for name, value in vars(begun).items():
            own = vars(self).get(name)
            if isinstance(value, np.ndarray) and value is not own and isinstance(own, np.ndarray):
                own[rows] = value

    def act(self, observation: NDArray[np.floating], beside: NDArray[np.floating] | None = None) -> NDArray[np.float32]:
        """Compute saturated actions in [-1, 1], (n, N), or (N,) for one observation: torques divided by torque limits.

        beside: actions of another policy, an array with the shape of the result. The method adds these actions to the
        controller's own actions before the saturation, and advances the state estimate with the saturated sum. Raises
        RuntimeError before the first `reset`. Raises ValueError if the observation is not finite, has a wrong number of
        entries, or has another number of rows than the observation in `reset`. A ValueError leaves the controller's
        memory unchanged.
        """
        signals = self.read(observation)
        count, begun = len(signals.angles), len(self.goal)
        if not begun:
            raise RuntimeError("No episode has begun: call the controller's reset(observation) first")
        if count != begun:
            raise check.InvalidValue("rows of observation", count, f"must be {begun}, as reset had")
        # goal minus joint angles: observed, from the tip's angle, or from the goal fixed at reset (angles unwrapped)
        if signals.to_go is not None and self.follows_goal:
            to_go = signals.to_go
        elif self.setup.task == "slew":
            to_go = _hub_error(signals)
        else:
            self._angles += wrapped(signals.angles - self._angles)
            to_go = self.goal - self._angles
        torques = self.torques(signals, to_go)
        if beside is not None:
            torques = torques + np.reshape(beside, torques.shape) * self.limits
        # the estimates advance under the torques that act, hence after the saturation
        torques = np.clip(torques, -self.limits, self.limits)
        self.predict(torques)
        self.step += 1
        actions: NDArray[np.float32] = (torques / self.limits).astype(np.float32)
        return actions if np.ndim(observation) == 2 else actions.reshape(-1)

    def initialise(self, signals: Signals, to_go: Array) -> None:  # noqa: B027
        """Set the memory at the start of episodes. to_go (n, N): goal minus joint angles, rad."""

    @abstractmethod
    def torques(self, signals: Signals, to_go: Array) -> Array:
        """Return joint torques (n, N), N m, before saturation. to_go (n, N): goal minus joint angles, rad."""

    def predict(self, torques: Array) -> None:  # noqa: B027
        """Advance the estimate by one period under the applied torques (n, N), N m."""

    def _goal(self, signals: Signals) -> Array:
        """Compute the joint angles (n, N), rad, of the arm at rest at its target, without jumps by whole turns."""
        if signals.to_go is not None:
            return self._angles + signals.to_go
        if self.setup.task == "slew":
            return self._angles + _hub_error(signals)
        arm = self.setup.arm
        # target in hub axes, m; of two inverse-kinematics solutions the one reached sooner at full torque
        target = tip_in_hub_frame(arm, signals.angles[:, 1:], signals.bends) + signals.error
        inertia = rigid_inertia(arm, signals.angles)
        rates = np.sqrt(self.limits / np.diagonal(inertia, axis1=1, axis2=2))
        return goal_angles(arm, signals.angles, target, rates)


def _hub_error(signals: Signals) -> Array:
    """Return target minus hub angle (n, 1), rad, of one link: tip error plus the angle from hub to tip (0 at rest)."""
    bend = np.clip(signals.bends, -0.9, 0.9)
    chord = 1.0 - 0.6 * bend**2  # along the root tangent, over the length, of a cantilever bent by its tip
    return signals.error + np.arctan2(bend, chord)
