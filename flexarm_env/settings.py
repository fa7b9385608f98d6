"""Solver settings: a formulation and its options, which have the same names in Python, TOML and the command line.

``Settings.make("floating_frame", segments=8)`` creates settings; options that are not given have default values. If a
formulation does not have an option, the error message lists the options of the formulation.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from flexarm_env import validation as check
from flexarm_env.records import choice, described, integer, number, rules, switch, value

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
PRESETS: dict[str, tuple[str, dict[str, Any]]] = {
    "paper": ("floating_frame", {"coupling": "paper", "multipliers": True, "newmark": (0.25, 0.5)}),
}
"""Names for a formulation together with some of its options. "paper" is the solver of Meek & Liu (1995): frames at the
roots of the segments, the paper's geometric stiffness [45], Lagrange multipliers, Newmark with beta = 1/4 and gamma =
1/2.
"""

MODAL_BOUND = 0.25
"""Largest tip deflection, divided by the link's length, for which a link reduced to modes is valid (theory, section 4).
"""
MOST_ELEMENTS = 1000
"""Largest number of elements per link. With more elements the dense or banded matrices of a step would be too large."""

MOST_NODES = 48
"""Largest number of nodes per elastica link, whose matrices are dense: 12 per smooth piece (`physics.elastica.chain`).
"""

MOST_STEPS = 10**5
"""Maximum number of steps in a period that is differentiated."""

MOST_IN_SEGMENT = 32
"""Largest number of elements per segment of the floating frame. A segment's matrices are dense."""

_MESH = ("segments", "elements", "coupling")
"""Options of the floating frame that are removed if `modes` is given without them."""

_REPLACED = ("elements", "coupling")
"""Options that have no meaning together with `modes`."""

_RELATED = ("formulation", "dt", "rho_inf", "newmark", "step_tolerance")
"""Fields of `Settings` that are validated together with others."""

_PAIR = {"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 2}


def expand_preset(formulation: str, options: Mapping[str, Any]) -> tuple[str, dict[str, Any]]:
    """Replace the name of a preset by its formulation and its options; ``options`` override the preset's options.

    The name of a formulation is returned unchanged, with ``options``.
    """
    check.choice("formulation", formulation, (*FORMULATIONS, *PRESETS))
    formulation, preset = PRESETS.get(formulation, (formulation, {}))
    check_options(formulation, options)
    return formulation, merged(preset, dict(options))


def options_of(formulation: str) -> tuple[str, ...]:
    """Return the names of a formulation's options."""
    check.choice("formulation", formulation, FORMULATIONS)
    return tuple(_DEFAULTS[formulation])


def default_options(formulation: str) -> dict[str, Any]:
    """Return a formulation's options with their defaults, as a new dict."""
    check.choice("formulation", formulation, FORMULATIONS)
    return dict(_DEFAULTS[formulation])


def check_options(formulation: str, names: Iterable[str]) -> None:
    """Raise ValueError if a name is not an option of the formulation; the message lists the options."""
    taken = options_of(formulation)
    for name in names:
        if name not in taken:
            others = [other for other, options in _DEFAULTS.items() if name in options]
            hint = f"it belongs to {' and '.join(others)}" if others else ""
            raise check.UnknownKey(str(name), taken, f"option of {formulation}", hint)


@described
@dataclass(frozen=True)
class Settings:
    """Formulation with all its options, created by :meth:`make`; options that the formulation does not have are None.

    :func:`default_options` returns the default values of the options.

    Args:
        frame: axes of a segment's floating frame (floating_frame). "chord" (default): the x axis passes through both
            ends of the segment. "root": the axes are fixed to the section at the segment's root, as in Meek & Liu
            (1995); the default with multipliers. On very stubby links (EI / (C L^2) = 0.025) "chord" causes an error of
            4e-5 of the length, which no mesh reduces.
        period_correction: True to correct the period error of the time integration in each step (geometrically_exact,
            default False; always True for the elastica). A step is not corrected in two cases: the correction exceeds 3
            % of the arm's length, or no Newton increment is below the smaller of 1 % of the length and the square root
            of the tolerance.
        step_tolerance: permitted error of the tip, divided by the arm's length, in each control period of an
            environment or each interval between samples and kinks of a scene. dt is then the longest step, which is
            halved up to five times. The error is estimated from the difference between the links' tip positions that
            steps of h and steps of h/2 reach. If five halvings do not suffice, `Trajectory.step_error` and info report
            the remaining error. The estimate does not contain errors of motors with elastic gears, of late reversals of
            Coulomb friction, or of the mesh. `step_tolerance` must be at least `tolerance`. None (default): constant
            dt.
    """

    formulation: str = choice(FORMULATIONS, 'beam formulation; "paper" selects the solver of Meek & Liu (1995)')
    segments: int | None = integer(
        "number of floating frames per link (floating_frame, default 5; with modes 1)", None,
        minimum=1, maximum=MOST_ELEMENTS, optional=True,
    )  # fmt: skip
    elements: int | None = integer(
        "number of beam elements per segment (floating_frame, default 1) or per link (geometrically_exact, default 5)",
        None,
        minimum=1, maximum=MOST_ELEMENTS, optional=True,
    )  # fmt: skip
    coupling: str | None = choice(
        COUPLINGS, "coupling of stretch and bending (floating_frame, default von_karman)", None, optional=True
    )
    modes: int | None = integer(
        "number of bending modes per segment, which replace elements and coupling (floating_frame)", None,
        minimum=1, maximum=8, optional=True,
    )  # fmt: skip
    frame: str | None = choice(
        FRAMES, "axes of a segment's floating frame (floating_frame, default chord)", None, optional=True
    )
    multipliers: bool | None = switch(
        "connect segments and links by Lagrange multipliers, as Meek & Liu do; slower, for comparison (floating_frame)",
        None, optional=True,
    )  # fmt: skip
    order: int | None = integer(
        "polynomial order of the elements (geometrically_exact, default 2)", None, minimum=1, maximum=3, optional=True
    )
    period_correction: bool | None = switch(
        "correct the period error of the time integration in each step (geometrically_exact)", None, optional=True
    )
    nodes: int | None = integer(
        "number of nodes (tangent angles) per link, up to 12 between jumps of the section (elastica, default 6)", None,
        minimum=3, maximum=MOST_NODES, optional=True,
    )  # fmt: skip
    dt: float | None = number("time step; default: the scene's step", "s", None, above=0.0, optional=True)
    rho_inf: float | None = number(
        "spectral radius of generalized-alpha at infinite frequency: 1 without numerical damping, 0 with most", "",
        None, minimum=0.0, maximum=1.0, optional=True,
    )  # fmt: skip
    tolerance: float = number("tolerance of the Newton iteration", "", 1e-10, above=0.0, maximum=1.0)
    newton: str = choice(("full", "modified"), "kind of Newton iteration", "full")
    max_iterations: int = integer("largest number of Newton iterations per step", 20, minimum=1, maximum=10_000)
    max_halvings: int = integer("largest number of halvings of a step if Newton fails", 8, minimum=0, maximum=30)
    newmark: tuple[float, float] | None = value(
        partial(check.numbers, what="two numbers, (beta, gamma)", length=2, above=0.0, maximum=1.0), _PAIR,
        "(beta, gamma) of Newmark's method, which replaces generalized-alpha and rho_inf", "", None, optional=True,
    )  # fmt: skip
    step_tolerance: float | None = number(
        "permitted tip error between two samples, divided by the arm's length; dt is halved if necessary", "",
        None, above=0.0, maximum=1.0, optional=True,
    )  # fmt: skip

    def __post_init__(self) -> None:
        """Validate the options of the formulation; an `InvalidValue` names the option."""
        own = rules(Settings)
        own["formulation"]("formulation", self.formulation)
        taken = _DEFAULTS[self.formulation]
        # options of other formulations must be None; modes and the mesh that it replaces may be None
        for name in (name for name in own if name not in _RELATED):
            value = getattr(self, name)
            if name not in taken:
                check_options(self.formulation, [name] if value is not None else [])
                continue
            reduced = self.modes is not None
            if (name == "modes" or (reduced and name in _MESH)) and value is None:
                continue
            check.store(self, **{name: own[name].check(name, value)})
            if reduced and name in _REPLACED:
                raise check.InvalidValue(name, value, "must not be given together with modes, which replaces it")
        if self.formulation == "floating_frame":
            self._check_frame()
        if (self.segments or 1) * (self.elements or 1) > MOST_ELEMENTS:
            what = f"must be at most {MOST_ELEMENTS} elements a link: take fewer segments or elements"
            raise check.InvalidValue("segments * elements", f"{self.segments} * {self.elements}", what)
        check.store(self, dt=own["dt"]("dt", self.dt))
        # Newton's tolerance must not exceed the permitted error
        allowed = own["step_tolerance"]("step_tolerance", self.step_tolerance)
        if allowed is not None and allowed < self.tolerance:
            what = f"must be at least tolerance = {self.tolerance:g}, the tolerance of the Newton iteration"
            raise check.InvalidValue("step_tolerance", allowed, what)
        check.store(self, step_tolerance=allowed)
        self._check_integrator()

    def _check_frame(self) -> None:
        """Check the combinations of the floating frame: chord with multipliers, elements per segment."""
        # the multiplier form has frames at the roots only
        if self.frame == "chord" and self.multipliers:
            raise check.InvalidValue("frame", self.frame, "must be 'root' with multipliers")
        if (self.elements or 1) > MOST_IN_SEGMENT:
            what = f"must be at most {MOST_IN_SEGMENT} a segment: take more segments, whose cost grows in proportion"
            raise check.InvalidValue("elements", self.elements, what)

    def _check_integrator(self) -> None:
        """Check that exactly one of rho_inf and newmark is given, and its values."""
        own = rules(Settings)
        if self.newmark is None:
            check.store(self, rho_inf=own["rho_inf"].check("rho_inf", self.rho_inf))
            return
        if self.rho_inf is not None:
            raise check.InvalidValue("rho_inf", self.rho_inf, "must not be given together with newmark")
        check.store(self, newmark=own["newmark"]("newmark", self.newmark))

    @classmethod
    def make(cls, formulation: str = "floating_frame", **options: Any) -> Settings:
        """Create the settings of a formulation or of the preset "paper"; ``options`` override the defaults.

        An option that is None has its default value. Raises ValueError if the formulation does not have an option, if a
        value is out of range, or if options exclude each other: ``modes`` with ``elements`` or ``coupling``,
        ``newmark`` with ``rho_inf``.
        """
        formulation, options = expand_preset(formulation, options)
        values = merged(default_options(formulation), options)
        # multipliers need frames at the roots
        if values.get("multipliers"):
            values.setdefault("frame", "root")
        return cls(formulation=formulation, **values)

    @property
    def deflection_bound(self) -> float:
        """Tip deflection divided by the link's length at which a run ends; inf unless links are reduced to modes."""
        return MODAL_BOUND if self.modes is not None and self.segments in (None, 1) else math.inf

    @property
    def period_error(self) -> float:
        """Coefficient kappa: time steps of length h multiply the period of a vibration by 1 + kappa (omega h)^2.

        omega: angular frequency of the vibration, rad/s.
        """
        # Newmark, e = gamma - 1/2: kappa = beta/2 - 1/24 - e/4 + e^2/8, at least 0
        # generalized-alpha: kappa = 1/12 + 3/8 ((1 - rho_inf)/(1 + rho_inf))^2
        if self.newmark is not None:
            beta, excess = self.newmark[0], self.newmark[1] - 0.5
            return max(0.0, 0.5 * beta - 1.0 / 24.0 - excess * (0.25 - 0.125 * excess))
        assert self.rho_inf is not None
        return 1.0 / 12.0 + 0.375 * ((1.0 - self.rho_inf) / (1.0 + self.rho_inf)) ** 2

    def options(self) -> dict[str, Any]:
        """Return the options that are not None, from which :meth:`make` creates equal settings."""
        names = _DEFAULTS[self.formulation]
        return {name: getattr(self, name) for name in names if getattr(self, name) is not None}

    def replace(self, **options: Any) -> Settings:
        """Return a copy with changed options; previous options that a new option excludes are removed."""
        return Settings.make(self.formulation, **merged(self.options(), options))

    def dividing(self, period: float | None) -> Settings:
        """Return settings with the longest step that is at most dt and divides `period`, s.

        If `period` is None, return `self`.
        """
        if period is None:
            return self
        assert self.dt is not None
        if check.number("discrete", period, "s", above=0.0) / self.dt > MOST_STEPS:
            raise check.InvalidValue("discrete", period, f"must be at most {MOST_STEPS} steps of dt = {self.dt:g} s")
        # unchanged if dt divides the period up to round-off
        dt = period / steps_in(period, self.dt)
        return self if abs(dt - self.dt) <= 1e-9 * dt else dataclasses.replace(self, dt=dt)

    def with_dt(self, dt: float) -> Settings:
        """Return settings with the step ``dt``, s, if these settings have no dt; otherwise `self`."""
        return self if self.dt is not None else dataclasses.replace(self, dt=dt)


def steps_in(time: float, dt: float) -> int:
    """Return the smallest number of equal steps of at most dt, s, in `time`, s, with a relative tolerance of 1e-9."""
    return max(1, math.ceil(time / dt * (1.0 - 1e-9)))


def merged(base: dict[str, Any], options: dict[str, Any]) -> dict[str, Any]:
    """Update ``base`` with the ``options`` that are not None; remove entries that these options exclude.

    `modes` and the mesh options exclude each other, and so do `newmark` and `rho_inf`. `multipliers` excludes `frame`.
    """
    given = {name: value for name, value in options.items() if value is not None}
    dropped = {"frame"} if given.get("multipliers") else set()
    if "modes" in given:
        dropped.update(_MESH)
    elif any(name in given for name in _MESH):
        dropped.add("modes")
    dropped.update(other for name, other in (("newmark", "rho_inf"), ("rho_inf", "newmark")) if name in given)
    return {name: value for name, value in base.items() if name not in dropped} | given
