"""The default mesh, step and Newton tolerance of an environment, and the error of its tip with them.

The usual settings (`options.DEFAULT_OPTIONS`) are kept where they are good enough for an arm. Otherwise the step
becomes a whole fraction of the usual one and the mesh finer until the rule calls them good enough. A user's own options
are never changed. With T the control period, h the step, L the arm's length and I the inertia about a joint:

e_1, small motions. Largest distance, over L, between the tip of small motions (`small_motions`) on the mesh in steps of
    h and that on a fine mesh without steps, over 100 periods of bang-bang torques that are held for 1 and for 8
    periods. It covers the first frequencies of the links, payload, hub, rotors on elastic gears, jumps and tapers of
    sections, and viscous friction. The inner PD loop and the amplifier with its back-emf are part of these motions, and
    act at control instants. Linear elements count with their stiffness, Newmark's scheme with its damping. Source:
    linear theory.
G = 1 + (theta / 0.55 rad)^3, large bends. theta is the largest angle between the ends of a link in these motions; it
    depends on torque over EI/L and on resonance. Measured over random arms: the error is up to 4 e_1 for theta below
    0.4 rad, and half of the arms with theta of 0.8, 1.2 and 2 rad have 2, 6 and 20 e_1. Above theta = 1.6 and 3 rad the
    search begins with the second and the third of `MESHES` (measured).
e_2 = sum of T_C h t / I, Coulomb friction T_C. A reversal within a step leaves a rate that is off by up to T_C h / I
    (docs: theory, section 6), which acts on the position for t = 1 s.
e_3 = kappa h^2 int Omega^3 dt, spin Omega of links of the exact beam in the plane, whose coordinates are positions: a
    turn in steps of h is late by the fraction kappa (Omega h)^2 (`Settings.period_error`). For the other formulations,
    whose coordinates are angles, e_3 is a tenth of this, with the rate of elbows without limits for Omega.
omega_c h <= 0.3, backlash: contact of a rotor J with the arm I through a gear k is resolved, with
    omega_c = sqrt(k (1/J + 1/I)). Measured. A PD loop that chatters begins with such steps, and trials shorten them.
trials (`trials`), arms of several links: nonlinear episodes measure by how much the amplification of errors exceeds G;
the
    step and then the mesh are made finer until the error of a trial is small, and the estimate covers it.
omega_3 h <= 0.45, chains of elasticas whose third vibration has less than a tenth of critical damping: with longer
    steps the energy of vibrations that are not resolved may grow. Measured.
tau L / (E EI) <= 2 rad, elements E of a link in space: an element that turns by pi has no rotation vector. Measured.
tolerance: the usual tolerance times (h / usual h)^2 for steps of at most half the usual step, because increments
decrease in this proportion; in space also times 100 I_min / I_max if that is below 1, for light wrists.

The bound is e = G e_1 + e_2. The usual settings are kept where e <= `KEPT` and e_3 <= `SPUN`; otherwise settings with
e <= `AIM` are taken. The estimate is `MARGIN` G e_1 + `MARGIN_OF_FRICTION` e_2 + e_3, to which `Batch.estimate` adds
the error due to neglected stretch and shear. With randomized factors, the softest arm and the stiffest arm with the
smallest payload are also checked. Gravity and controllers other than the inner PD loop are not considered.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..parameters import Arm
from ..settings import Settings, merged
from .judge import CONTACT, MARGIN, MESHES, Worst, worst
from .resolution_warnings import COARSE, COARSE_IF_GIVEN, amplified, too_coarse, unsettled
from .small_motions import Drive
from .trials import TRIALS, TRIALS_IN_SPACE, Trial, refined, settled

# Errors and bounds on errors are distances of the tip over the arm's length L.
KEPT, KEPT_IN_SPACE, AIM = 5e-3, 6e-3, 1e-3
"""Bounds up to which the usual settings are kept, and to which step and mesh are refined where they are not."""

SPUN = 0.02  # largest e_3 accepted
UNEQUAL, FINEST_TOLERANCE = 100.0, 1e-10
"""Ratio of inertias about two joints up to which the usual tolerance in space suits both; the smallest tolerance."""
FINE_IF_GIVEN = 0.125  # given step over the usual one up to which no trial is made
FRACTIONS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32)  # divisors of the usual step that are tried
BENDS, BENDS_IN_SPACE = (1.6, 3.0), (3.2, 6.0)
"""Bends of a link, rad, above which the search begins with the second and the third mesh."""

@dataclass(frozen=True)
class Resolution:
    """Settings of an environment, with the tip's error that step and mesh leave and a warning for the user, or ""."""

    settings: Settings
    estimate: float  # error of the tip over the arm's length
    warning: str = ""


@np.errstate(over="ignore", invalid="ignore")  # loops and steps that are unstable
def resolve(
    arm: Arm, drive: Drive, period: float, formulation: str, usual: Mapping[str, Any], given: Mapping[str, Any],
    drawn: Mapping[str, tuple[float, float]] | None = None, trial: Trial | None = None,
) -> Resolution:  # fmt: skip
    """Return the settings of an environment: the user's options, and a mesh, step and tolerance where these are open.

    usual: default options of the formulation. given: the user's options. drawn: ranges of factors. period: s. trial:
        trials of nonlinear motions (`trials`), None for none.
    """
    given = {name: value for name, value in given.items() if value is not None}
    first = Settings.make(formulation, **merged(dict(usual), given)).dividing(period)
    assert first.dt is not None
    try:
        rule = worst(arm, drive, period, drawn or {})
    except np.linalg.LinAlgError:  # masses or stiffnesses that double precision does not carry (`physics.precision`)
        return Resolution(first, math.inf)
    if not rule.slender or not math.isfinite(rule.theta):
        return Resolution(first, math.inf)
    name, sizes = MESHES[formulation]
    # meshes to try; options that a user gives are fixed
    fixed = {"modes", name, "elements" if formulation == "floating_frame" else name}
    meshes = [first] if fixed & given.keys() else _meshes(first, name, sizes, rule, usual)

    def at(mesh: Settings, h: float) -> Settings:
        one = replace(mesh, dt=h)
        return one if "tolerance" in given else replace(one, tolerance=_tolerance(rule, one, usual["dt"]))

    least = first.dt if "dt" in given else first.dt / FRACTIONS[-1]
    if rule.chatters[0]:
        return _of_loop(rule, first, meshes, at, least, trial)
    settings = _search(rule, meshes, (1,) if "dt" in given else FRACTIONS)
    assert settings.dt is not None
    h, error = settings.dt, 0.0
    settings = at(replace(settings, tolerance=first.tolerance), h)
    fine = "dt" in given and h <= FINE_IF_GIVEN * usual["dt"]
    tried = arm.n_links > 1 and settings.modes is None and not fine
    if trial is not None and tried and rule.estimate(settings, h) <= COARSE:
        finer = [one for one in meshes if getattr(one, name) > getattr(settings, name)]
        most = TRIALS_IN_SPACE if arm.spatial else TRIALS
        settings, error = refined(trial, rule.rules[0], settings, finer, at, least, arm.total_length, most)
    assert settings.dt is not None
    estimate = max(rule.estimate(settings, settings.dt), min(1.0, MARGIN * error))
    if MARGIN * error > COARSE:
        return Resolution(settings, estimate, amplified(estimate, formulation))
    told_from = COARSE_IF_GIVEN if "dt" in given or fixed & given.keys() else COARSE
    return Resolution(settings, estimate, too_coarse(rule, settings, estimate, name, told_from))


def _of_loop(
    rule: Worst, first: Settings, meshes: list[Settings], at: Callable[[Settings, float], Settings], least: float,
    trial: Trial | None,
) -> Resolution:  # fmt: skip
    """Return the resolution for a PD loop that chatters in small motions, where no linear theory tells the error.

    Trials tell it: limits of torques, friction and large bends may end the chatter, or bound it. first: settings to
    begin with; meshes: settings with finer meshes; at: function of (settings, step, s) that returns the settings with
    this step and a suitable Newton tolerance; least: shortest step, s; trial: None for no trials, which leave the error
    infinite.
    """
    error, settings = math.inf, first
    if trial is not None and first.modes is None:
        assert first.dt is not None
        # rotors that the loop swings on their gears are resolved as contacts are, and shake the links: a finer mesh
        h = first.dt
        while rule.swing * h > CONTACT and 0.5 * h >= least * (1.0 - 1e-9):
            h *= 0.5
        mesh = meshes[min(1, len(meshes) - 1)]
        finer = meshes[min(2, len(meshes) - 1)]
        settings, error = settled(trial, at(mesh, h), finer, at, least, rule.arm.total_length)
    estimate = math.inf if math.isinf(error) else min(1.0, MARGIN * error)
    told = rule.chatters[1] or (trial is not None and estimate > COARSE)
    return Resolution(settings, estimate, unsettled(rule.period, estimate) if told else "")


def _meshes(
    first: Settings, name: str, sizes: tuple[int, ...], rule: Worst, usual: Mapping[str, Any]
) -> list[Settings]:
    """Return settings with the meshes to try, the coarsest first.

    first: settings that are completed. name: of the field with the number of elements or nodes; sizes: values of it to
    try; usual: default options of the formulation. Large bends (rule.theta) begin with a finer mesh.
    """
    begin = usual[name]
    pieces = max(len(link.jumps) for link in rule.arm.links) + 1
    least = pieces + 1 if first.formulation == "elastica" else max(pieces, rule.elements)
    ladder = [begin, *(size for size in sizes if size > begin)]
    # large bends begin with a finer mesh
    ladder = ladder[sum(rule.theta > bend for bend in (BENDS_IN_SPACE if rule.arm.spatial else BENDS)) :]
    fitting = [size for size in ladder if size >= least] or [least]
    return [first if size == begin else replace(first, **{name: size}) for size in fitting]


def _tolerance(rule: Worst, settings: Settings, usual: float) -> float:
    """Return the Newton tolerance: the usual one, reduced for short steps and, in space, for unequal joint inertias.

    usual: the formulation's default step, s.
    """
    assert settings.dt is not None
    share = settings.dt / usual
    least = 1.0 if share > 0.5 else share * share
    if rule.arm.spatial:
        least *= min(1.0, UNEQUAL * float(rule.inertia.min() / rule.inertia.max()))
    return settings.tolerance if least == 1.0 else max(FINEST_TOLERANCE, settings.tolerance * least)


def _search(rule: Worst, meshes: list[Settings], fractions: tuple[int, ...]) -> Settings:
    """Return the settings with the first mesh and the longest step that are good enough, or the best ones tried.

    fractions: divisors of the usual step to try.
    """
    h = meshes[0].dt
    assert h is not None
    kept = KEPT_IN_SPACE if rule.arm.spatial else KEPT
    # the usual settings are good enough
    if rule.bound(meshes[0], h) <= kept and rule.spin(meshes[0], h) <= SPUN:
        return meshes[0]
    best: tuple[float, Settings, int] = math.inf, meshes[-1], fractions[-1]
    for settings in meshes:
        # a mesh that misses AIM with the shortest step is too coarse
        if rule.bound(settings, h / FRACTIONS[-1]) > AIM and settings is not meshes[-1]:
            continue
        for k in fractions:
            bound = max(rule.bound(settings, h / k), AIM / SPUN * rule.spin(settings, h / k))
            if bound < best[0]:
                best = bound, settings, k
            if bound <= AIM and rule.spin(settings, h / k) <= SPUN:
                return replace(settings, dt=h / k)
        break
    return replace(best[1], dt=h / best[2]) if best[2] > 1 else best[1]
