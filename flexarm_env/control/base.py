"""What the controllers have in common: the numbers they read, the interface they keep, the torque limit they obey."""

from __future__ import annotations

import hashlib
import json
import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, fields
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from .. import validation as check
from ..parameters import Arm
from ..rigid import rigid_inertia
from ..sensors import Sensors
from ..shapes import Shape
from ..validation import Array
from .kinematics import goal_angles, tip_in_hub_frame, wrapped

RESIDUAL_SHARE = 0.7
"""Share of the torque limit that the action adds in action_mode="residual_pd", where nothing is said."""


WHOLE = {"flexible": 1, "modes": 0, "block": 1, "horizon": 1, "iterations": 1, "first": 1}
"""Fields of gains that are whole numbers, and the least that each may be."""

SHARES: dict[str, dict[str, float]] = {
    "effort": {"above": 0.0, "maximum": 1.0}, "memory": {"minimum": 0.0, "maximum": 1.0}, "lag": {"above": 0.0},
    "drift": {"minimum": 0.0, "maximum": 1.0},
}  # fmt: skip
"""Bounds of fields of gains that have others than 0 to `MOST_GAIN`."""

MOST_GAIN = 1e6
"""The most that a gain or a weight may be, in its own unit: beyond, no controller of these arms makes sense."""


@dataclass(frozen=True)
class Gains:
    """Numbers of a controller, checked; a field that has one a joint is a tuple of them, or one number alone."""

    def __post_init__(self) -> None:
        for field in fields(self):
            name, value = field.name, getattr(self, field.name)
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
    """What a controller may know about its environment: the nominal arm and the observation's layout, SI.

    Args:
        task: "slew" (one link, tip angle) or "reach" (two links or more, tip position).
        arm: the nominal arm. control_dt: s. torque_limits (N,): N m at an action of 1.
        names, scales: of the observation's entries, in order; entry = value / scale.
        history: how many of these stand in an observation, the oldest first.
        sensors: that read the entries; None: ideal ones, or not known. noise: that all entries have beside it, in their
            units; (): none.
        action_mode: what an action stands for; "": not known. residual_share: of action_mode="residual_pd".
        gravity: m/s^2; None: none. keep_out: shapes that the arm is to stay out of.
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

    @classmethod
    def of(cls, env: Any) -> Setup:
        """What there is to know of an environment of this package, single or vector, wrapped or not."""
        plain = getattr(env, "unwrapped", None)
        plan = getattr(plain, "plan", None)
        if plan is None:
            raise check.InvalidValue("env", env, "must be an environment of flexarm_env, single or vector")
        scales = tuple(float(s) for s in plan.scales)
        limits = plan.arm.torque_limits
        names, noise, extras = tuple(plan.names), (), plan.extras
        if extras.sensors is not None and extras.sensors.noise.any():
            chosen = slice(None) if extras.selection is None else extras.selection.chosen
            noise = tuple((extras.sensors.noise[chosen] * plan.scales).tolist())
        share = None if extras.controller is None else float(extras.controller.share)
        return cls(
            plan.kind.task, plan.arm, plan.period, limits, names, scales, plan.history, plan.sensors, noise,
            plan.action_mode, share, plan.gravity, plan.keep_out,
        )  # fmt: skip

    @property
    def n_joints(self) -> int:
        """Number of joints N."""
        return self.arm.n_links

    @property
    def size(self) -> int:
        """Numbers in an observation."""
        return len(self.names) * self.history

    @property
    def layout(self) -> str:
        """Hash of the observation's layout, its names and scales (six digits) in order: 16 hexadecimal digits."""
        entries: list[Any] = [[name, f"{scale:.6g}"] for name, scale in zip(self.names, self.scales, strict=True)]
        entries += [] if self.history == 1 else [self.history]
        return hashlib.sha256(json.dumps(entries).encode()).hexdigest()[:16]


@dataclass(frozen=True)
class Signals:
    """An observation in SI units, one row an environment.

    Attributes: angles (n, N) rad, wrapped to one turn; rates (n, N) rad/s; bends (n, N): tip deflection over length;
        bend_rates (n, N) 1/s; error (n, 1): target minus tip angle, rad (slew), or (n, 2): tip to target in the frame
        that turns with the hub, m (reach). Where the observation has instead the goal's joint angles less the joints'
        (observation="measured"), these are to_go (n, N) rad, and bends, their rates and error are empty. gauges (n, G):
        in their units. In space error is (n, 3), and bends (n, 3 F) are those along y, along z and twists (rad) of the
        F flexible links, for controllers that need them.
    """

    angles: Array
    rates: Array
    bends: Array
    bend_rates: Array
    error: Array
    gauges: Array
    to_go: Array | None = None

    def outputs(self, angles: Array) -> Array:
        """Outputs (n, 4 N) of an arm's model with its joints at these angles: they, their rates, deflections, rates;
        in space (n, 2 N + 6 F)."""
        return np.concatenate([angles, self.rates, self.bends, self.bend_rates], axis=1)


BENDS = ("tip_deflection_y", "tip_deflection_z", "twist")
BEND_RATES = ("tip_deflection_rate_y", "tip_deflection_rate_z", "twist_rate")
"""What the links of arms in space show."""


class Reader:
    """Observations to :class:`Signals`, of which the newest is read.

    Args:
        setup: of the environment. who: that reads, for errors. bends: whether deflections are needed in any case.
        goals: whether joint angles at the goal less the joints' are.
    Raises:
        ValueError: an entry that is needed is not observed; its name.
    """

    def __init__(self, setup: Setup, who: str = "a controller", bends: bool = True, goals: bool = False) -> None:
        self.scales, self.size = np.asarray(setup.scales), setup.size
        place = {name: i for i, name in enumerate(setup.names)}
        joints = setup.arm.joint_names
        deflections, deflection_rates = (setup.arm.by_link(f"tip_deflection{rate}") for rate in ("", "_rate"))
        error = ("target_error",) if setup.task == "slew" else ("to_target_x", "to_target_y")
        if setup.arm.spatial:
            bending = [k for k, link in enumerate(setup.arm.links) if bends and not link.rigid]
            deflections, deflection_rates = (
                tuple(setup.arm.by_link(name)[k] for name in names for k in bending) for names in (BENDS, BEND_RATES)
            )
            error = (*error, "to_target_z")
        aims = tuple(f"{joint}_error" for joint in joints)
        self.aimed = goals or (
            not bends and any(name not in place for name in (*error, *deflections)) and aims[0] in place
        )
        needed = [f"{joint}_{of}" for of in ("sin", "cos", "rate") for joint in joints]
        needed += aims if self.aimed else [*deflections, *error]
        for name in (*needed, *(deflection_rates if bends else ())):
            if name not in place:
                known = ", ".join(setup.names)
                hint = ' (observation="measured" has it)' if name in aims else ""
                raise ValueError(f"observation: {who} needs the entry {name}{hint}, which is not among {known}")
        self._sin, self._cos, self._rates = ([place[f"{j}_{of}"] for j in joints] for of in ("sin", "cos", "rate"))
        self._bends, self._bend_rates, self._error, self._goals = (
            [place[name] for name in names if name in place] for names in (deflections, deflection_rates, error, aims)
        )
        self._gauges = [place[name] for name in setup.names if name.startswith("strain_gauge_")]

    def __call__(self, observation: NDArray[np.floating]) -> Signals:
        seen = np.atleast_2d(check.floats("observation", observation))
        if seen.ndim != 2 or seen.shape[1] != self.size:
            raise check.InvalidValue("shape of observation", np.shape(observation), f"must be (n, {self.size})")
        values = seen[:, -len(self.scales) :] * self.scales
        if not math.isfinite(np.vdot(values, values)):  # quicker than to look at each
            row = np.flatnonzero(~(np.abs(values) < 1e100).all(axis=1))[0]
            raise check.InvalidValue(f"observation[{row}]", seen[row], "must be finite numbers, below 1e100 in size")
        angles = np.arctan2(values[:, self._sin], values[:, self._cos])
        return Signals(
            angles, values[:, self._rates], values[:, self._bends], values[:, self._bend_rates], values[:, self._error],
            values[:, self._gauges], values[:, self._goals] if self.aimed else None,
        )  # fmt: skip


class Controller(ABC):
    """Observations in, actions out, for any number of environments that start their episodes together.

    A subclass answers :meth:`torques`; what it remembers is set in :meth:`initialise`. `reset` takes the first
    observation of the episodes, and every later one goes to `act` in turn, the first included.
    """

    action_mode = "torque"
    needs_bends: ClassVar[bool] = False
    """Whether it needs tip deflections and their rates, whatever else there is."""
    needs_goals: ClassVar[bool] = False
    """Whether it needs joint angles at the goal less the joints' as sensors read them (observation="measured")."""

    def __init__(self, setup: Setup) -> None:
        self.setup = setup
        self.limits = np.asarray(setup.torque_limits)
        self.read = Reader(setup, type(self).__name__, self.needs_bends, self.needs_goals)
        self.goal = np.zeros((0, setup.n_joints))
        """Joint angles (n, N) of the arm at rest at its target, unwrapped from the angles at the start."""

    def reset(self, observation: NDArray[np.floating]) -> None:
        """Begin episodes with their first observation, (n, entries) or (entries,)."""
        signals = self.read(observation)
        self.step = 0
        self._angles = signals.angles.copy()
        self.goal = self._goal(signals)
        self.initialise(signals, self.goal - self._angles)

    def act(self, observation: NDArray[np.floating]) -> NDArray[np.float32]:
        """Actions in [-1, 1], (n, N), or (N,) for a single observation.

        Raises ValueError for an observation of another size or number than `reset` had, or that is not finite (what is
        remembered then is as before), and RuntimeError before any.
        """
        signals = self.read(observation)
        count, begun = len(signals.angles), len(self.goal)
        if not begun:
            raise RuntimeError("No episode has begun: call the controller's reset(observation) first")
        if count != begun:
            raise check.InvalidValue("rows of observation", count, f"must be {begun}, as reset had")
        if signals.to_go is not None and not self.setup.arm.spatial:
            to_go = signals.to_go
        elif self.setup.task == "slew":
            to_go = _hub_error(signals)
        else:
            self._angles += wrapped(signals.angles - self._angles)
            to_go = self.goal - self._angles
        torques = np.clip(self.torques(signals, to_go), -self.limits, self.limits)
        self.predict(torques)
        self.step += 1
        actions: NDArray[np.float32] = (torques / self.limits).astype(np.float32)
        return actions if np.ndim(observation) == 2 else actions.reshape(-1)

    def initialise(self, signals: Signals, to_go: Array) -> None:  # noqa: B027
        """Set what is remembered, at the start of episodes; to_go (n, N): goal minus joint angles, rad."""

    @abstractmethod
    def torques(self, signals: Signals, to_go: Array) -> Array:
        """Joint torques (n, N) in N m, before the limit; to_go as in :meth:`initialise`."""

    def predict(self, torques: Array) -> None:  # noqa: B027
        """Take what is estimated one period on, under the torques (n, N) that are applied in it."""

    def _goal(self, signals: Signals) -> Array:
        if signals.to_go is not None:
            return self._angles + signals.to_go
        if self.setup.task == "slew":
            return self._angles + _hub_error(signals)
        arm = self.setup.arm
        target = tip_in_hub_frame(arm, signals.angles[:, 1:], signals.bends) + signals.error
        inertia = rigid_inertia(arm, signals.angles[:, 1:])
        rates = np.sqrt(self.limits / np.diagonal(inertia, axis1=1, axis2=2))
        return goal_angles(arm, signals.angles, target, rates)


def _hub_error(signals: Signals) -> Array:
    """Target minus hub angle (n, 1): the straight arm's tip is where its hub points."""
    bend = np.clip(signals.bends, -0.9, 0.9)
    chord = 1.0 - 0.6 * bend**2  # along the root tangent, over the length, of a cantilever bent by its tip
    return signals.error + np.arctan2(bend, chord)
