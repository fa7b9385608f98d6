"""How an arm is computed: the formulation and its flat options, one spelling everywhere.

``Settings.make("floating_frame", segments=8)`` fills in the defaults, which live here and nowhere else.
An option that the formulation lacks is an error that names it and lists those the formulation takes.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from typing import Any

from flexarm_env import validation as check

FORMULATIONS = ("floating_frame", "geometrically_exact", "elastica")
COUPLINGS = ("von_karman", "paper", "linear")
FRAMES = ("root", "chord")

_COMMON: dict[str, Any] = {
    "dt": None,
    "rho_inf": None,
    "tolerance": 1e-10,
    "newton": "full",
    "max_iterations": 20,
    "max_halvings": 8,
    "newmark": None,
    "step_tolerance": None,
}
_DEFAULTS: dict[str, dict[str, Any]] = {
    "floating_frame": {
        "segments": 5,
        "elements": 1,
        "coupling": "von_karman",
        "modes": None,
        "frame": "chord",
        "multipliers": False,
        **_COMMON,
        "rho_inf": 0.9,
    },
    "geometrically_exact": {"elements": 5, "order": 2, "period_correction": False, **_COMMON, "rho_inf": 0.7},
    "elastica": {"nodes": 6, **_COMMON, "rho_inf": 1.0},
}
MODAL_BOUND = 0.25
"""Tip deflection over length beyond which a link reduced to modes is out of its range (theory, section 4)."""
MOST_ELEMENTS = 1000
"""Elements of a link: its dense or banded matrices are then as large as a step can do with."""

MOST_STEPS = 10**5
"""Steps of a period that is differentiated."""

MOST_IN_SEGMENT = 32
"""Elements of a segment of the floating frame, whose matrices are full."""

_MESH = ("segments", "elements", "coupling")
"""Options of the floating frame that modes drop where they are given alone."""

_REPLACED = ("elements", "coupling")
"""Those that have no meaning beside modes."""


def options_of(formulation: str) -> tuple[str, ...]:
    """Names of the options that a formulation takes."""
    check.choice("formulation", formulation, FORMULATIONS)
    return tuple(_DEFAULTS[formulation])


def default_options(formulation: str) -> dict[str, Any]:
    """The options of a formulation with their defaults (a fresh dict)."""
    check.choice("formulation", formulation, FORMULATIONS)
    return dict(_DEFAULTS[formulation])


def check_options(formulation: str, names: Iterable[str]) -> None:
    """Every name is an option of the formulation, or a ValueError that says what the formulation takes."""
    taken = options_of(formulation)
    for name in names:
        if name not in taken:
            others = [other for other, options in _DEFAULTS.items() if name in options]
            hint = f"it belongs to {' and '.join(others)}" if others else ""
            raise check.UnknownKey(str(name), taken, f"option of {formulation}", hint)


@dataclass(frozen=True)
class Settings:
    """A formulation with all its options; make it with :meth:`make`. None where the formulation has no such option.

    Args:
        formulation: "floating_frame", "geometrically_exact" or "elastica".
        segments: floating frames per link, 1 to 1000 (floating_frame, default 5; with modes 1).
        elements: beam elements per segment (floating_frame, default 1) or per link (geometrically_exact, default 5);
            at most 1000 a link in all.
        coupling: "von_karman" (default), "paper" or "linear" axial-bending coupling (floating_frame).
        modes: bending modes per segment, 1 to 8, in place of elements and coupling (floating_frame).
        frame: where a segment's frame floats (floating_frame): through both of its ends ("chord", default), or clamped
            to its root section ("root", the paper's, and the default with multipliers). Where shear strains are large
            (EI / (C L^2) = 0.025) segments in chords stay 4e-5 of the length off the exact beam.
        multipliers: join segments and links by Lagrange multipliers, the paper's own form, in place of coordinates that
            need none; slower, for comparison (floating_frame, default False; frame "root").
        order: polynomial order of the elements, 1 to 3 (geometrically_exact, default 2).
        period_correction: take the integrator's error of the period out of each step (geometrically_exact, default
            False; the elastica always does). A step whose correction would be more than 3 % of the arm's length, or in
            which no Newton increment is below 1 % of it and the root of the tolerance, is left as it is.
        nodes: tangent angles per link, 3 to 12 (elastica, default 6).
        dt: step, s; None takes the scene's.
        rho_inf: spectral radius of generalized-alpha at infinite frequency, 0 to 1 (defaults 0.9, 0.7 and 1.0).
        newmark: (beta, gamma) of plain Newmark, in place of rho_inf.
        tolerance: of the Newton iteration, default 1e-10.
        newton: "full" (default) or "modified".
        max_iterations: of Newton in one step, at most 10,000, default 20.
        max_halvings: of a step whose Newton fails, default 8.
        step_tolerance: error of the tip, a fraction of the arm's length, that a control period of an environment, or of
            a scene the time between two samples or kinks, may add: dt is then the longest step, and is halved, up to
            five times, where the motion asks for it; where that does not suffice, `Trajectory.step_error` and info say
            so. At least `tolerance`. None (default): steps of dt.
    """

    formulation: str
    segments: int | None = None
    elements: int | None = None
    coupling: str | None = None
    modes: int | None = None
    frame: str | None = None
    multipliers: bool | None = None
    order: int | None = None
    period_correction: bool | None = None
    nodes: int | None = None
    dt: float | None = None
    rho_inf: float | None = None
    tolerance: float = 1e-10
    newton: str = "full"
    max_iterations: int = 20
    max_halvings: int = 8
    newmark: tuple[float, float] | None = None
    step_tolerance: float | None = None

    def __post_init__(self) -> None:
        check.choice("formulation", self.formulation, FORMULATIONS)
        taken = _DEFAULTS[self.formulation]
        for name in _CHECKS:
            value = getattr(self, name)
            if name not in taken:
                check_options(self.formulation, [name] if value is not None else [])
                continue
            reduced = self.modes is not None
            if (name == "modes" or (reduced and name in _MESH)) and value is None:
                continue
            check.store(self, **{name: _CHECKS[name](name, value)})
            if reduced and name in _REPLACED:
                raise check.InvalidValue(name, value, "must not be given together with modes, which replaces it")
        if self.formulation == "floating_frame":
            self._check_frame()
        if (self.segments or 1) * (self.elements or 1) > MOST_ELEMENTS:
            what = f"must be at most {MOST_ELEMENTS} elements a link: take fewer segments or elements"
            raise check.InvalidValue("segments * elements", f"{self.segments} * {self.elements}", what)
        if self.dt is not None:
            check.store(self, dt=check.number("dt", self.dt, "s", above=0.0))
        if self.step_tolerance is not None:
            allowed = check.number("step_tolerance", self.step_tolerance, above=0.0, maximum=1.0)
            if allowed < self.tolerance:
                what = f"must be at least tolerance = {self.tolerance:g}, to which Newton solves each step"
                raise check.InvalidValue("step_tolerance", allowed, what)
            check.store(self, step_tolerance=allowed)
        self._check_integrator()

    def _check_frame(self) -> None:
        if self.frame == "chord" and self.multipliers:
            raise check.InvalidValue("frame", self.frame, "must be 'root' with multipliers, as the paper has it")
        if (self.elements or 1) > MOST_IN_SEGMENT:
            what = f"must be at most {MOST_IN_SEGMENT} a segment: take more segments, whose cost grows in proportion"
            raise check.InvalidValue("elements", self.elements, what)

    def _check_integrator(self) -> None:
        if self.newmark is None:
            check.store(self, rho_inf=check.number("rho_inf", self.rho_inf, minimum=0.0, maximum=1.0))
            return
        if self.rho_inf is not None:
            raise check.InvalidValue("rho_inf", self.rho_inf, "must not be given together with newmark")
        both = check.numbers("newmark", self.newmark, "two numbers, (beta, gamma)", 2, above=0.0, maximum=1.0)
        check.store(self, newmark=both)

    @classmethod
    def make(cls, formulation: str = "floating_frame", **options: Any) -> Settings:
        """Settings of a formulation, its defaults overridden by ``options``.

        An option given as None takes its default. Raises ValueError for an option the formulation lacks, a value
        out of range, ``modes`` together with ``elements`` or ``coupling``, ``newmark`` with ``rho_inf``.
        """
        check_options(formulation, options)
        values = merged(default_options(formulation), options)
        if values.get("multipliers"):
            values.setdefault("frame", "root")
        return cls(formulation=formulation, **values)

    @property
    def deflection_bound(self) -> float:
        """Tip deflection over a link's length beyond which the formulation stops; infinite but for links in modes."""
        return MODAL_BOUND if self.modes is not None and self.segments in (None, 1) else math.inf

    @property
    def period_error(self) -> float:
        """kappa: the integrator makes a period longer by the share kappa (omega h)^2 (docs: theory, section 6)."""
        if self.newmark is not None:
            beta, excess = self.newmark[0], self.newmark[1] - 0.5
            return max(0.0, 0.5 * beta - 1.0 / 24.0 - excess * (0.25 - 0.125 * excess))
        assert self.rho_inf is not None
        return 1.0 / 12.0 + 0.375 * ((1.0 - self.rho_inf) / (1.0 + self.rho_inf)) ** 2

    def options(self) -> dict[str, Any]:
        """The options that :meth:`make` takes to make these settings again (those that are None left out)."""
        names = _DEFAULTS[self.formulation]
        return {name: getattr(self, name) for name in names if getattr(self, name) is not None}

    def replace(self, **options: Any) -> Settings:
        """These settings with some options changed; what a new option excludes is dropped."""
        return Settings.make(self.formulation, **merged(self.options(), options))

    def dividing(self, period: float | None) -> Settings:
        """These settings with the longest step of at most dt that divides a period, s (None: as they are)."""
        if period is None:
            return self
        assert self.dt is not None
        if check.number("discrete", period, "s", above=0.0) / self.dt > MOST_STEPS:
            raise check.InvalidValue("discrete", period, f"must be at most {MOST_STEPS} steps of dt = {self.dt:g} s")
        dt = period / steps_in(period, self.dt)
        return self if abs(dt - self.dt) <= 1e-9 * dt else dataclasses.replace(self, dt=dt)

    def with_dt(self, dt: float) -> Settings:
        """These settings with the step ``dt`` where none was given."""
        return self if self.dt is not None else dataclasses.replace(self, dt=dt)


def steps_in(time: float, dt: float) -> int:
    """In how many steps of at most dt (s) a time (s) is gone through."""
    return max(1, math.ceil(time / dt * (1.0 - 1e-9)))


def merged(base: dict[str, Any], options: dict[str, Any]) -> dict[str, Any]:
    """``base`` overridden by ``options``: modes drops the mesh of ``base`` (and a mesh option drops its modes),
    multipliers its frame, newmark drops rho_inf and the other way about. None overrides nothing."""
    given = {name: value for name, value in options.items() if value is not None}
    dropped = {"frame"} if given.get("multipliers") else set()
    if "modes" in given:
        dropped.update(_MESH)
    elif any(name in given for name in _MESH):
        dropped.add("modes")
    dropped.update(other for name, other in (("newmark", "rho_inf"), ("rho_inf", "newmark")) if name in given)
    return {name: value for name, value in base.items() if name not in dropped} | given


_count = partial(check.integer, minimum=1)
_CHECKS: dict[str, Any] = {
    "segments": partial(_count, maximum=MOST_ELEMENTS),
    "elements": partial(_count, maximum=MOST_ELEMENTS),
    "coupling": partial(check.choice, allowed=COUPLINGS),
    "modes": partial(_count, maximum=8),
    "frame": partial(check.choice, allowed=FRAMES),
    "multipliers": check.flag,
    "order": partial(_count, maximum=3),
    "period_correction": check.flag,
    "nodes": partial(check.integer, minimum=3, maximum=12),
    "tolerance": partial(check.number, above=0.0, maximum=1.0),
    "newton": partial(check.choice, allowed=("full", "modified")),
    "max_iterations": partial(_count, maximum=10_000),
    "max_halvings": partial(check.integer, minimum=0, maximum=30),
}
