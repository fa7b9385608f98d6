"""Types of the environments' keyword arguments, for completion in editors and for `help`."""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypedDict, get_type_hints

from ..parameters import Arm, Base
from ..sensors import Sensors
from ..settings import FORMULATIONS, default_options


class SolverKeywords(TypedDict, total=False):
    """Options of the solver (`Settings`); each formulation accepts only its own options."""

    segments: int | None
    elements: int | None
    coupling: str | None
    modes: int | None
    frame: str | None
    multipliers: bool | None
    order: int | None
    period_correction: bool | None
    nodes: int | None
    dt: float | None
    rho_inf: float | None
    tolerance: float | None
    newton: str | None
    max_iterations: int | None
    max_halvings: int | None
    newmark: tuple[float, float] | None
    step_tolerance: float | None


class Keywords(SolverKeywords, total=False):
    """Keyword arguments of all environments; `options.plan` defines their defaults and validates their values."""

    arm: Arm | str | os.PathLike[str] | None
    base: Base | Mapping[str, float] | None
    formulation: str | None
    control_dt: float | None
    action_mode: str
    residual_share: float | None
    duration: float | None
    task: str | None
    reference: Any
    motion: Any
    reward: Mapping[str, float] | None
    reward_terms: Mapping[str, Any] | None
    rules: int
    randomization: Mapping[str, Sequence[float]] | None
    observation: str | Sequence[str]
    history: int
    sensors: Mapping[str, Any] | Sensors | None
    actuator: Mapping[str, Any] | None
    cost: Mapping[str, Any] | None
    pushes: Mapping[str, Any] | None
    payload_change: Mapping[str, Any] | None
    keep_out: Any
    contacts: Any
    success: Mapping[str, Any] | None
    turns: str
    starts: Mapping[str, Any] | None
    initial_vibration: float
    joint_limits: Any
    gravity: Sequence[float] | None
    info_level: str
    render_mode: str | None
    max_episode_steps: int | None


SOLVER_OPTIONS = tuple(dict.fromkeys(name for formulation in FORMULATIONS for name in default_options(formulation)))
"""Names of the solver's options, in all formulations."""


def signature_of(function: Callable[..., Any], plan: Callable[..., Any]) -> inspect.Signature:
    """Return the complete signature of a constructor that passes its `**arguments` to `plan`.

    function: a constructor whose first parameter is `self`. plan: a function of the task's definition and of keywords;
    its last parameter collects the solver's options. In the signature the solver's options have the default None,
    which selects the formulation's default.
    """
    own = [p for p in inspect.signature(function).parameters.values() if p.kind is not p.VAR_KEYWORD][1:]
    taken = [p for p in inspect.signature(plan).parameters.values() if p.kind is p.KEYWORD_ONLY]
    types = get_type_hints(SolverKeywords)
    solver = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=types[name])
        for name in SOLVER_OPTIONS
    ]
    return inspect.Signature([*own, *taken, *solver])
