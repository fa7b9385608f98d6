"""Create controllers by name, with the tuned gains in the package (`data/control/*.toml`)."""

import dataclasses
import tomllib
from collections.abc import Callable, Mapping
from functools import cache, partial
from importlib import resources
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import arms
from .. import validation as check
from ..parameters import Arm
from ..rigid import timescales
from .arm_model import arm_model
from .base import IN_SPACE, Controller, Setup
from .force import ForceGains, HybridForce, Impedance, ImpedanceGains, WallController
from .lqg import LQG, LQGGains, SpatialLQG, SpatialLQR
from .lqr import LQR, LQRGains
from .lqr_force import LQRForce, LQRForceGains
from .margins import warn_of_delay, warn_of_growth
from .mpc import MPC, MPCGains, SpatialMPC
from .mpc_force import MPCForce, MPCForceGains
from .pd import PD, PDGains, SpatialPD, SpatialPDGains
from .shaping import SHAPERS, ShapedGains, ShapedPD, SpatialShapedGains, SpatialShapedPD
from .space_force import SpatialForceGains, SpatialHybridForce, SpatialImpedance, SpatialPathPD
from .time_optimal import TimeOptimal, TimeOptimalGains

_Kind = tuple[type[Any], Callable[[Setup, Any], Controller]]
_KINDS: dict[str, _Kind] = {
    "pd": (PDGains, PD),
    **{kind: (ShapedGains, partial(ShapedPD, kind=kind)) for kind in SHAPERS},
    "lqr": (LQRGains, LQR), "lqg": (LQGGains, LQG), "mpc": (MPCGains, MPC),
    "time_optimal": (TimeOptimalGains, TimeOptimal),
    "hybrid_force": (ForceGains, HybridForce), "impedance": (ImpedanceGains, Impedance),
    "lqr_force": (LQRForceGains, LQRForce), "mpc_force": (MPCForceGains, MPCForce),
}  # fmt: skip
_SPACE: dict[str, _Kind] = {
    "pd": (SpatialPDGains, SpatialPD),
    **{kind: (SpatialShapedGains, partial(SpatialShapedPD, kind=kind)) for kind in SHAPERS},
    "lqr": (LQGGains, SpatialLQR), "lqg": (LQGGains, SpatialLQG), "mpc": (MPCGains, SpatialMPC),
    "hybrid_force": (SpatialForceGains, SpatialHybridForce), "impedance": (SpatialForceGains, SpatialImpedance),
}  # fmt: skip
"""Gains and controller classes for arms in space, by name."""
_SPACE_WALL: dict[str, Callable[[Setup, Any], Controller]] = {
    "pd": SpatialPathPD, "hybrid_force": SpatialHybridForce, "impedance": SpatialImpedance,
}  # fmt: skip
"""Controller classes for task "press" in space, by name."""
PRESS, LAND = "press", "land"
"""Names of the tasks at a wall, which share gains for any number of joints."""

FORCE_NAMES = ("hybrid_force", "impedance", "lqr_force", "mpc_force")
"""Names of the controllers of a contact force, for tasks at a wall alone."""

NAMES = tuple(_KINDS)
"""Controller names accepted by `make`."""


def _classes(table: str) -> dict[str, _Kind]:
    """Return gains and controller classes by name. table: name of a table of tuned gains (`Setup.gains`)."""
    return _SPACE if table == IN_SPACE else _KINDS


@cache
def _table(task: str) -> dict[str, Any]:
    """Read the tuned gains of a task from the package's TOML file."""
    path = resources.files("flexarm_env") / "data" / "control" / f"{task}.toml"
    return tomllib.loads(path.read_text("utf-8"))


def tuned_gains(name: str, task: str, n_joints: int | None = None) -> Any:
    """Return the tuned gains of controller `name` for a task ("slew", "reach", "press", "land" or "space").

    n_joints: number of joints; None means the number of joints of the task's default arm. All arms with three or more
    joints have the same gains. Returns an instance of the controller's gains class. Raises ValueError for an unknown
    name, or if the controller does not support the task.
    """
    check.choice("controller", name, NAMES)
    at_wall = task in (PRESS, LAND)
    many = n_joints is not None and n_joints > 2 and task != IN_SPACE
    table = _table(PRESS if at_wall else "chain" if many else task)
    if name not in table:
        known = ", ".join(f'"{other}"' for other in table)
        raise check.InvalidValue("controller", name, f'must be one of {known} for task="{task}"')
    return gains_from(name, table[name], task)


def gains_from(name: str, values: Mapping[str, Any], task: str = "slew") -> Any:
    """Create the gains of controller `name` from a dict of values.

    task: the task, or "space" for an arm in space (`Setup.gains`). Raises ValueError for an unknown key; the message
    lists the valid keys.
    """
    kind, _ = _classes(task)[name]
    needed = [field.name for field in dataclasses.fields(kind) if field.default is dataclasses.MISSING]
    return check.made(name, kind, values, **dict.fromkeys(needed, "must be given"))


TUNED_ON = "strip"
"""The one-link arm on which the LQR gains were tuned."""


def for_arm(gains: LQRGains, setup: Setup) -> LQRGains:
    """Adapt the LQR weights of joint rates, which were tuned on the one-link arm `TUNED_ON`, to another one-link arm.

    The weights refer to rates divided by the first flexible frequency. Let p be the product of an arm's first flexible
    frequency and the duration of the arm's fastest quarter turn. The weights are multiplied by p of the new arm and
    divided by p of `TUNED_ON`. The adapted weights have the same effect in a slew of the new arm as the tuned weights
    in a slew of `TUNED_ON`.
    """
    # p of the new arm divided by p of `TUNED_ON`; p: first flexible frequency times quarter-turn time
    share = _tempo(setup.arm) / _tempo(arms.named(TUNED_ON))
    share = float(f"{share:.3g}")  # 1.0 for the arm itself
    return dataclasses.replace(gains, rate=share * gains.rate, bend_rate=share * gains.bend_rate)


def _tempo(arm: Arm) -> float:
    """Return the first flexible frequency (free joints, rad/s) times the time of the quickest quarter turn, s."""
    return float(arm_model(arm).frequencies[0]) * timescales(arm).slew


def make(name: str, env: Any, gains: Any = None) -> Controller:
    """Create a controller for an environment of this package.

    Args:
        name: "pd", "zv", "zvd", "lqr", "lqg", "mpc" or "time_optimal"; at a wall (task="press" or "land")
            "hybrid_force", "impedance", and in the plane "lqr_force" or "mpc_force".
        env: a `Setup`, or an environment (single or vector) with action_mode "torque".
        gains: an instance of the controller's gains class, or a dict of gains by name, such as a table in a file of
            `flexarm tune`. None: the tuned gains of the package for the environment's task.
    Raises:
        ValueError: an unknown name, or an environment that the controller does not support.
    """
    check.choice("controller", name, NAMES)
    setup = env if isinstance(env, Setup) else Setup.of(env)
    if not isinstance(env, Setup):
        plan = env.unwrapped.plan
        if plan.task != plan.kind.task:
            raise check.InvalidValue("task", plan.task, f'must be "{plan.kind.task}" (controllers steer to a target)')
        if plan.extras.controller is not None:
            what = 'must be "torque": controllers set torques themselves'
            raise check.InvalidValue("action_mode", "residual_pd", what)
        if plan.arm.base is not None:
            what = "must be None: controllers need a fixed root (the suite's pd updates its goal in each period)"
            raise check.InvalidValue("arm.base", plan.arm.base, what)
        if name == "mpc" and plan.contacts:
            what = "must be left out with mpc, whose plans ignore obstacles; mpc_force controls the force on a wall"
            raise check.InvalidValue("contacts", plan.contacts, what)
    classes = _classes(setup.gains)
    if name not in classes:
        there = ", ".join(f'"{one}"' for one in classes)
        raise check.InvalidValue("controller", name, f"must be one of {there} for an arm in space")
    kind, made = classes[name]
    if classes is _SPACE and setup.task == PRESS:
        if name not in _SPACE_WALL:
            there = ", ".join(f'"{one}"' for one in _SPACE_WALL)
            raise check.InvalidValue("controller", name, f'must be one of {there} for task="{PRESS}" in space')
        made = _SPACE_WALL[name]
    if gains is None:
        gains = tuned_gains(name, setup.gains, setup.n_joints)
        gains = for_arm(gains, setup) if kind is LQRGains and setup.n_joints == 1 else gains
    elif isinstance(gains, Mapping):
        gains = gains_from(name, gains, setup.gains)
    gains = check.instance("gains", gains, kind)
    found = made(setup, gains)
    warn_of_delay(name, setup, gains)
    if found.omits_modes:
        warn_of_growth(name, setup, gains)
    return found


class Following:
    """Controller that recomputes its goal in every period to follow a moving target or a floating base.

    The class wraps a controller without memory.
    """

    restarts = True

    def __init__(self, controller: Controller) -> None:
        self.controller = controller

    @property
    def setup(self) -> Setup:
        """Setup of the wrapped controller's environment."""
        return self.controller.setup

    def reset(self, observation: NDArray[np.floating]) -> None:
        """Do nothing, because the controller has no memory."""

    def restart(self, observation: NDArray[np.floating], rows: NDArray[np.bool_]) -> None:
        """Do nothing, because the controller has no memory."""

    def act(self, observation: NDArray[np.floating], beside: NDArray[np.floating] | None = None) -> Any:
        """Compute actions (n, N) in [-1, 1] with the goal in the present observation; beside: see `Controller.act`."""
        self.controller.reset(observation)
        return self.controller.act(observation, beside)


def controller(name: str, env: Any, gains: Any = None) -> Controller | Following:
    """Create a controller as :func:`make` does; PD control also supports moving targets and floating bases."""
    plan = env.unwrapped.plan
    following = name == "pd" and (plan.task in ("track", PRESS, LAND) or plan.arm.base is not None)
    made = make(name, Setup.of(env) if following else env, gains)
    if following and isinstance(made, WallController):  # follows the path by itself
        return make(name, env, gains)
    return Following(made) if following else made
