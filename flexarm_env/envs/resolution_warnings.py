"""Warn of a step or mesh that may be too coarse, and of an episode that may be too short."""

from __future__ import annotations

import warnings
from typing import Protocol

from ..parameters import Arm
from ..rigid import timescales
from ..settings import Settings

COARSE, COARSE_IF_GIVEN = 0.05, 0.2
"""Estimated errors, divided by the arm's length, above which `make` warns: for its own settings, and for a step or mesh
that the user gives."""

FINEST = 1e-3
"""Smallest ratio of step to control period that a warning advises."""

LEAST_TURNS = 1.5
"""Smallest default duration of an episode without a warning, divided by the time of the arm's fastest quarter turn."""


class ResolutionWarning(UserWarning):
    """Warning that the tip's error with this step or mesh may exceed the fraction `COARSE` of the arm's length."""


class Rule(Protocol):
    """Interface of `judge.Worst`: estimates of the tip's error that depend on mesh and step."""

    period: float

    def estimate(self, settings: Settings, h: float) -> float:
        """Return the estimated tip error for a mesh and steps of h, s, divided by the arm's length."""


def too_coarse(rule: Rule, settings: Settings, estimate: float, name: str, most: float) -> str:
    """Return a warning with advice if the error estimate exceeds `most`, otherwise "".

    The warning recommends a shorter step if this reduces the error to COARSE, and otherwise a finer mesh. rule: source
    of error estimates for other settings. estimate: error of the tip divided by the arm's length. name: name of the
    solver option for the mesh.
    """
    if estimate <= most:
        return ""
    assert settings.dt is not None
    size = "its length" if estimate >= 1.0 else f"{100.0 * estimate:.2g} % of its length"
    h = settings.dt
    while h > FINEST * rule.period and rule.estimate(settings, h) > COARSE:
        h *= 0.5
    if h <= FINEST * rule.period:
        return f"the arm's tip may be off by {size} with {name}={getattr(settings, name)}: take more"
    return f"the arm's tip may be off by {size} with dt={settings.dt:.3g} s: take dt={h:.3g} s, or a step_tolerance"


def amplified(estimate: float, formulation: str) -> str:
    """Return a warning about an arm whose error is large with all settings, because its motion amplifies errors.

    estimate: error of the tip divided by the arm's length. formulation: formulation of the settings.
    """
    instead = "formulation='geometrically_exact'" if formulation == "elastica" else "a smaller dt"
    size = "its length" if estimate >= 1.0 else f"{100.0 * estimate:.2g} % of its length"
    return f"the arm's tip may be off by {size}, since links that whip or buckle amplify errors: try {instead}"


def unsettled(period: float, estimate: float) -> str:
    """Return a warning that the PD loop sustains a vibration, with the tip's error and settings to change.

    period: control period, s. estimate: error of the tip divided by the arm's length.
    """
    what = "the PD loop of action_mode='residual_pd' does not settle with this arm, whatever the solver's step"
    size = "" if estimate <= COARSE else ", and the arm's tip may be off by " + (
        "its length" if estimate >= 1.0 else f"{100.0 * estimate:.2g} % of its length"
    )
    return f"{what}{size}: take control_dt less than {period:g} s, or another action_mode"


def warn(sentence: str) -> None:
    """Issue the sentence as a `ResolutionWarning`; do nothing if it is ""."""
    if sentence:
        warnings.warn(sentence, ResolutionWarning, stacklevel=4)


def warn_of_times(arm: Arm, duration: float) -> None:
    """Warn if the default duration, s, is below `LEAST_TURNS` times the time of the arm's fastest quarter turn."""
    own = timescales(arm)
    if duration < LEAST_TURNS * own.slew:
        what = f"arm {arm.name!r} takes at least {own.slew:.3g} s for a quarter turn, and an episode has {duration:g} s"
        fits = f"duration={own.duration:g} fits, with control_dt={own.control_dt:g} (flexarm arm says more)"
        warnings.warn(f"{what}: {fits}", UserWarning, stacklevel=6)
