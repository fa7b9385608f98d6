"""Choose an environment's default mesh, step and Newton tolerance, and estimate the tip's error with these settings.

The rule below accepts or rejects settings for an arm. If the rule rejects the default settings
(`options.DEFAULT_OPTIONS`), the step is divided by integers and the mesh is refined until the rule accepts the
settings. Solver options that a user gives are never changed. Symbols: T control period, h step, L the arm's length, I
inertia about a joint.

The error e_1 of small motions comes from linear theory (`small_motions`). e_1 is the largest distance, divided by L,
between the tips of two solutions: one on the mesh with steps of h, and one on a fine mesh with exact time integration.
The motions last 100 control periods with bang-bang torques, which are constant for 1 or for 8 periods. The linear model
contains flexible links with jumps and tapers of their sections, payload, hub, rotors on elastic gears, and viscous
friction. The inner PD loop, or the amplifier with its back-emf, acts at control instants. The model on the mesh also
contains the errors of finite elements and of the time integration.

Large bending increases the error by the factor G = 1 + (theta / 0.55 rad)^3, where theta is the largest angle between
the tangents at the two ends of a link in the small motions. The factor G was fitted to the errors of random arms. For
theta below 0.4 rad, these errors were at most 4 e_1. The median error was 2 e_1 for theta = 0.8 rad, 6 e_1 for 1.2 rad,
and 20 e_1 for 2 rad. If theta exceeds 1.6 rad, the search begins with the second of `MESHES`; if theta exceeds 3 rad,
with the third.

Coulomb friction T_C adds the error e_2 = sum of T_C h t / I over the joints. If a joint reverses within a step, its
rate afterwards has an error of up to T_C h / I (docs/theory.md, section 6). The estimate assumes that the rate has this
error for t = 1 s.

A fast rotation causes the error e_3. The exact beam in the plane has positions as coordinates, so a rotation with
angular velocity Omega lags by the fraction kappa (Omega h)^2 (`Settings.period_error`). For this beam e_3 is kappa h^2
times the time integral of Omega^3. All other formulations have angles as coordinates. For these formulations e_3 is
kappa h^2 / 10 times the time integral of Omega^3, where Omega is the largest rate of an elbow without joint limits.

With backlash, steps must resolve the contact in the gear: omega_c h must be at most 0.3 (measured). The contact has the
angular frequency omega_c = sqrt(k (1/J + 1/I)) for a rotor of inertia J, an arm of inertia I and a gear of stiffness k.
If the inner PD loop sustains a vibration ("chatters"), the search begins with steps that satisfy the condition for
backlash. Trial episodes decide whether the steps are halved further.

In arms of several links, large motions may increase errors by more than the factor G. Nonlinear trial episodes
(`trials`) measure the additional growth of errors. The step and then the mesh are refined until the error of a trial is
small. The estimate of the tip's error includes the error of the trial.

For elasticas with several links, let omega_3 be the angular frequency of the third vibration mode. If the third mode
has a damping ratio below 0.1, omega_3 h must be at most 0.45 (measured). With longer steps the energy of unresolved
vibrations may grow.

In space, tau L / (E EI) must be at most 2 rad (measured) for a torque tau and E elements per link. An element that
turns by pi has no unique rotation vector.

For steps of at most half the default step, the Newton tolerance is the default tolerance times (h / default h)^2,
because Newton increments are proportional to h^2. In space the tolerance is also multiplied by the factor 100 I_min /
I_max if this factor is below 1, as for arms with light last links. I_min and I_max are the smallest and the largest
inertia about a joint.

The error bound is e = G e_1 + e_2. The default settings are kept if e <= `SmallMotions.kept` and e_3 <= `SPUN`. If they
are not kept, the search looks for settings with e <= `AIM`. The error estimate is `MARGIN` G e_1 + `MARGIN_OF_FRICTION`
e_2 + e_3, to which `Batch.estimate` adds the error due to neglected stretch and shear. With random factors, the rule
also applies to the softest arm and to the stiffest arm with the smallest payload. The rule ignores gravity, and
controllers other than the inner PD loop.
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
from .trials import Trial, refined, settled

# Errors and bounds on errors are distances of the tip divided by the arm's length L.
AIM = 1e-3  # bound to which step and mesh are refined unless the usual settings are kept

SPUN = 0.02  # largest e_3 accepted
FINEST_TOLERANCE = 1e-10  # the smallest Newton tolerance
FINE_IF_GIVEN = 0.125  # given step over the usual one up to which no trial is made
FRACTIONS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32)  # divisors of the usual step that are tried

@dataclass(frozen=True)
class Resolution:
    """Settings of an environment, the estimated tip error due to step and mesh, and the user's warning ("": none)."""

    settings: Settings
    estimate: float  # tip error divided by the arm's length
    warning: str = ""


@np.errstate(over="ignore", invalid="ignore")  # loops and steps that are unstable
def resolve(
    arm: Arm, drive: Drive, period: float, formulation: str, usual: Mapping[str, Any], given: Mapping[str, Any],
    drawn: Mapping[str, tuple[float, float]] | None = None, trial: Trial | None = None, gain: float = 0.0,
) -> Resolution:  # fmt: skip
    """Choose an environment's mesh, step and Newton tolerance by the rule; keep the values that the user gives.

    usual: default options of the formulation. given: the user's options. drawn: ranges (low, high) of randomized
    factors by name. period: control period, s. trial: function that runs trial episodes (`trials`), or None. gain: if
    trial is None, the factor by which the arm's motions amplify errors of small motions (`trials.amplification`).
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
        most = rule.motions.trials
        settings, error = refined(trial, rule.rules[0], settings, finer, at, least, arm.total_length, most)
    assert settings.dt is not None
    if gain:
        error = gain * rule.rules[0].small(settings, settings.dt)
    small = rule.estimate(settings, settings.dt)
    estimate = max(small, min(1.0, MARGIN * error))
    if trial is not None and MARGIN * error > COARSE:
        return Resolution(settings, estimate, amplified(estimate, formulation))
    told_from = COARSE_IF_GIVEN if "dt" in given or fixed & given.keys() else COARSE
    # no warning of packaged arms that whip: no settings help, and their documentation states the estimate
    told = small if trial is None else estimate
    return Resolution(settings, estimate, too_coarse(rule, settings, told, name, told_from))


def _of_loop(
    rule: Worst, first: Settings, meshes: list[Settings], at: Callable[[Settings, float], Settings], least: float,
    trial: Trial | None,
) -> Resolution:  # fmt: skip
    """Return the resolution for a PD loop that chatters in small motions, for which linear theory gives no error.

    Trials measure the error: limits of torques, friction and large bends may stop or limit the chatter. first: settings
    at which the search begins. meshes: settings with finer meshes. at: function of (settings, step, s) that returns the
    settings with this step and a suitable Newton tolerance. least: shortest step that is tried, s. trial: the trials;
    with None the error is infinite.
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
    """Return settings with the meshes to try, from the coarsest to the finest.

    first: settings whose mesh is to be chosen. name: name of the field with the number of elements or nodes. sizes:
    values of this field that are tried. usual: default options of the formulation. For large bends (rule.theta) the
    list begins with a finer mesh.
    """
    begin = usual[name]
    pieces = max(len(link.jumps) for link in rule.arm.links) + 1
    least = pieces + 1 if first.formulation == "elastica" else max(pieces, rule.elements)
    ladder = [begin, *(size for size in sizes if size > begin)]
    # large bends begin with a finer mesh
    ladder = ladder[sum(rule.theta > bend for bend in rule.motions.ladder) :]
    fitting = [size for size in ladder if size >= least] or [least]
    return [first if size == begin else replace(first, **{name: size}) for size in fitting]


def _tolerance(rule: Worst, settings: Settings, usual: float) -> float:
    """Return the Newton tolerance: the usual one, smaller for short steps and, in space, for unequal joint inertias.

    usual: the formulation's default step, s.
    """
    assert settings.dt is not None
    share = settings.dt / usual
    least = 1.0 if share > 0.5 else share * share
    least *= rule.motions.tolerance(rule.inertia)
    return settings.tolerance if least == 1.0 else max(FINEST_TOLERANCE, settings.tolerance * least)


def _search(rule: Worst, meshes: list[Settings], fractions: tuple[int, ...]) -> Settings:
    """Return the settings with the first mesh and longest step that the rule accepts, or the best ones tried.

    fractions: divisors of the usual step that are tried.
    """
    h = meshes[0].dt
    assert h is not None
    kept = rule.motions.kept
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
