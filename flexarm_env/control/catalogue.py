"""Controllers by name, with the tuned gains that come with the package (`data/control/*.toml`)."""

import dataclasses
import tomllib
from collections.abc import Callable, Mapping
from functools import cache, partial
from importlib import resources
from typing import Any

from .. import validation as check
from .base import Controller, Setup
from .lqg import LQG, LQGGains, SpatialLQG, SpatialLQR
from .lqr import LQR, LQRGains
from .mpc import MPC, MPCGains, SpatialMPC
from .pd import PD, PDGains, SpatialPD, SpatialPDGains
from .shaping import SHAPERS, ShapedGains, ShapedPD, SpatialShapedGains, SpatialShapedPD
from .time_optimal import TimeOptimal, TimeOptimalGains

_Kind = tuple[type[Any], Callable[[Setup, Any], Controller]]
_KINDS: dict[str, _Kind] = {
    "pd": (PDGains, PD),
    **{kind: (ShapedGains, partial(ShapedPD, kind=kind)) for kind in SHAPERS},
    "lqr": (LQRGains, LQR), "lqg": (LQGGains, LQG), "mpc": (MPCGains, MPC),
    "time_optimal": (TimeOptimalGains, TimeOptimal),
}  # fmt: skip
_SPACE: dict[str, _Kind] = {
    "pd": (SpatialPDGains, SpatialPD),
    **{kind: (SpatialShapedGains, partial(SpatialShapedPD, kind=kind)) for kind in SHAPERS},
    "lqr": (LQGGains, SpatialLQR), "lqg": (LQGGains, SpatialLQG), "mpc": (MPCGains, SpatialMPC),
}  # fmt: skip
"""Those of arms in space."""

NAMES = tuple(_KINDS)
"""Names that `make` takes."""


@cache
def _table(task: str) -> dict[str, Any]:
    path = resources.files("flexarm_env") / "data" / "control" / f"{task}.toml"
    return tomllib.loads(path.read_text("utf-8"))


def tuned_gains(name: str, task: str, n_joints: int | None = None) -> Any:
    """The tuned gains of the controller `name` for a task ("slew", "reach", or "space"), of its gains' class.

    n_joints: of the arm; None: as the task's own arm has. For three and more there is one set of gains, "chain".
    Raises ValueError for a name that there is not, or that no arm of this task can have.
    """
    check.choice("controller", name, NAMES)
    table = _table("chain" if n_joints is not None and n_joints > 2 and task != "space" else task)
    if name not in table:
        known = ", ".join(f'"{other}"' for other in table)
        raise check.InvalidValue("controller", name, f'must be one of {known} for task="{task}"')
    return gains_from(name, table[name], task == "space")


def gains_from(name: str, values: Mapping[str, Any], space: bool = False) -> Any:
    """Gains of the controller `name` from values by key; an unknown key is a ValueError that says which there are."""
    kind, _ = (_SPACE if space else _KINDS)[name]
    needed = [field.name for field in dataclasses.fields(kind) if field.default is dataclasses.MISSING]
    return check.made(name, kind, values, **dict.fromkeys(needed, "must be given"))


def make(name: str, env: Any, gains: Any = None) -> Controller:
    """A controller for an environment of this package.

    Args:
        name: "pd", "zv", "zvd", "lqr", "lqg", "mpc" or "time_optimal".
        env: a `Setup`, or an environment (single or vector) with action_mode "torque".
        gains: of the controller's class of gains, or a table of them by name, as `flexarm tune` writes; None takes the
            tuned ones of the environment's task.
    Raises:
        ValueError: an unknown name, or an environment that the controller is not made for.
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
            what = "must be None: controllers plan for a root that stays where it is (pd of the suite aims anew)"
            raise check.InvalidValue("arm.base", plan.arm.base, what)
    space = setup.arm.spatial
    if space and name not in _SPACE:
        there = ", ".join(f'"{one}"' for one in _SPACE)
        raise check.InvalidValue("controller", name, f"must be one of {there} for an arm in space")
    kind, made = (_SPACE if space else _KINDS)[name]
    if gains is None:
        gains = tuned_gains(name, "space" if space else setup.task, setup.n_joints)
    elif isinstance(gains, Mapping):
        gains = gains_from(name, gains, space)
    return made(setup, check.instance("gains", gains, kind))
