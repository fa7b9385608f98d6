"""The keyword `contacts` of environments: obstacles that the arm can touch, and time steps that resolve impacts."""

import math
from collections.abc import Mapping
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np

from .. import validation as check
from ..batch import PayloadChange, standing_scene
from ..physics import assembly
from ..physics.contact.build import (
    STEPS,
    check_steps,
    duration,
    effective_masses,
    largest_speed,
    points_of,
    start_depths,
)
from ..physics.contact.layout import Touching
from ..physics.model import EI_Y_FACTOR, GJ_FACTOR, PAYLOAD_INERTIA, PAYLOAD_MASS, STIFFNESS_FACTOR, System
from ..physics.reading import reading_of
from ..scene import Contact, Scene, contacts_of, resolving_step
from ..scene.contacts import place_on_link
from ..sections import Link
from ..settings import Settings
from ..tasks.starts import Starts
from ..tasks.task import Task
from ..validation import Array
from .features import Frame
from .resolution import FINEST_TOLERANCE

MOST_STEPS = 1000
"""Largest number of steps per control period that is chosen if the user gives no `dt`."""


def framed(
    frame: Frame, value: Any, task: str, duration: float, given: Mapping[str, Any],
    drawn: Mapping[str, tuple[float, float]], changing: PayloadChange | None,
) -> Frame:  # fmt: skip
    """Add contacts to a frame, with a time step so short that every impact lasts at least `STEPS` steps.

    If the user gives no `dt`, a control period is divided into the number of steps that such an impact requires, at
    most `MOST_STEPS`. The Newton tolerance decreases with the square of the step. The number of steps follows from the
    lightest and softest arm that may be drawn. value: keyword `contacts`: one or several `Contact` or tables; None for
    no contacts. task: task of the environment. duration: longest episode, s. given: the user's solver options. drawn:
    ranges of randomized factors by name. changing: change of the payload during an episode, or None.

    Raises:
        ValueError: a contact is invalid; the message names the key path, the value and the rule.
    """
    arm, settings = frame.arm, frame.settings
    contacts = contacts_of("contacts", value, arm, len(arm.axes))
    if not contacts:
        return frame
    if task == "replay":
        refuse_motion(contacts, "task", task)
    if settings.step_tolerance is not None:
        what = "must be None with contacts, whose impulses are those of equal steps"
        raise check.InvalidValue("step_tolerance", settings.step_tolerance, what)
    if settings.multipliers:
        raise check.InvalidValue("multipliers", True, "must be False with contacts")
    frame = replace(frame, settings=_with_sections(frame, contacts, given))
    changed = 1.0 if changing is None else float(changing.factor[0])
    return replace(frame, contacts=contacts, settings=_resolved(frame, contacts, duration, given, drawn, changed))


MOST_PARTS = 20
"""Largest denominator of the fraction of a link's length in the name of a contact point along the link."""
MOST_COMMON = 60
"""Largest common denominator of all contact points along links, which is the least number of elements of a link."""


def _with_sections(frame: Frame, contacts: tuple[Contact, ...], given: Mapping[str, Any]) -> Settings:
    """Return settings with which an element (a segment of the floating frame) ends at each contact point along a link.

    If the user does not give the number of elements, it is increased to the next common multiple of the points'
    denominators. The elastica in the plane has points at any fraction. given: the user's solver options.

    Raises:
        ValueError: a point is not at the end of an element, or its link is not straight with a constant section.
    """
    settings, parts = frame.settings, 1
    option = {"geometrically_exact": "elements", "floating_frame": "segments"}.get(settings.formulation, "")
    count = int(getattr(settings, option, None) or 1)
    for i, contact in enumerate(contacts):
        for k, name in enumerate(contact.bodies):
            place = place_on_link(name)
            if place is None:
                continue
            path = f"contacts[{i}].bodies[{k}]"
            link = frame.arm.links[place[0]]
            if not isinstance(link, Link) or link.uniform is None:
                what = "must be on a link that is straight and flexible with one Section along its length"
                raise check.InvalidValue(path, name, what)
            if not option:
                continue
            fraction = Fraction(place[1]).limit_denominator(MOST_PARTS)
            if abs(float(fraction) - place[1]) > 1e-9:
                what = f"must be at a fraction of the link with a denominator of at most {MOST_PARTS}, such as 0.25"
                raise check.InvalidValue(path, name, what)
            if given.get(option) is not None and count % fraction.denominator:
                what = f"must be at the end of one of the link's {option}: {option} must be a multiple of"
                raise check.InvalidValue(path, name, f"{what} {fraction.denominator}, not {count}")
            parts = math.lcm(parts, fraction.denominator)
            if parts > MOST_COMMON:
                what = f"must have a common denominator of at most {MOST_COMMON} with the points before it, not {parts}"
                raise check.InvalidValue(path, name, what)
    return settings if count % parts == 0 else settings.replace(**{option: parts * math.ceil(count / parts)})


def with_rows(modes: Array, contacts: tuple[Contact, ...], behind: int) -> Array:
    """Insert rows of zeros for moving obstacles, after the arm's rows, in a table of initial rates.

    behind: number of rows after the rows of zeros.
    """
    rows = sum(len(contact.displacements) for contact in contacts)
    return np.insert(modes, [len(modes) - behind] * rows, 0.0, axis=0)


DRAWS = 50
"""Number of drawn starts, and of drawn targets, of which at least one must be outside obstacles."""


def free_starts(frame: Frame, task: Task, starts: Starts, targets: bool) -> Starts:
    """Return ranges of initial states; states in which the arm touches an obstacle are drawn again.

    targets: True if targets inside obstacles are drawn again, too.

    Raises:
        ValueError: none of `DRAWS` random initial states or targets is outside the obstacles.
    """
    rng, begin, aims = np.random.default_rng(0), np.array(starts.start), np.array(starts.target)
    postures, goals = [], []
    for _ in range(DRAWS):
        postures.append(rng.uniform(begin[:, 0], begin[:, 1]) * (rng.uniform() >= starts.straight))
        first = rng.uniform(aims[:, 0], aims[:, 1])
        goals.append(frame.kind.target.goal(task, postures[-1], first))
    for name, drawn in (("angles", postures), ("target", goals if targets else [])):
        if drawn and all(_is_inside(frame, angles) for angles in drawn):
            what = f"must contain places outside the obstacles of contacts: none of {DRAWS} drawn ones is"
            given = starts.start if name == "angles" else starts.target
            raise check.InvalidValue(f"starts.{name}", [tuple(map(float, row)) for row in given], what)
    return replace(starts, free=(0,), free_targets=(0,) if targets else None)


def _is_inside(frame: Frame, angles: Array) -> bool:
    """Return whether a point of the arm with straight links at joint angles (rad) is inside an obstacle."""
    assert frame.settings.dt is not None
    stated = frame.arm.stated(angles.tolist())
    scene = standing_scene(frame.arm, frame.settings.dt, frame.gravity, stated, contacts=frame.contacts)
    return bool(start_depths(assembly.assemble(scene, frame.settings)).any())


def refuse_motion(contacts: tuple[Contact, ...], path: str, value: Any) -> None:
    """Raise `InvalidValue` if a prescribed motion is combined with contacts."""
    if contacts:
        what = "must not be given in an environment with contacts; scenes (flexarm_env.Scene) take motions and contacts"
        raise check.InvalidValue(path, value, what)


def _resolved(
    frame: Frame, contacts: tuple[Contact, ...], length: float, given: Mapping[str, Any],
    drawn: Mapping[str, tuple[float, float]], changed: float,
) -> Settings:  # fmt: skip
    """Return settings whose steps resolve the contacts, also with obstacles that move for `length` s.

    changed: smallest factor of a payload change.
    """
    settings = frame.settings
    # an obstacle hits a resting arm with its own speed
    contacts = tuple(replace(x, speed=max(x.speed, largest_speed(x, length))) for x in contacts)
    assert settings.dt is not None
    moves = standing_scene(frame.arm, settings.dt, frame.gravity, contacts=contacts)
    dt = resolving_step(moves, settings.dt, length)
    if given.get("dt") is not None and dt < settings.dt:
        what = f"must be at most {dt:.3g} s, so that steps resolve the displacements of obstacles"
        raise check.InvalidValue("dt", given["dt"], what)
    if frame.period / dt > MOST_STEPS:
        what = f"must move slower: they need steps of at most {dt:.2g} s, more than {MOST_STEPS} in a control period"
        raise check.InvalidValue("contacts", f"obstacles too fast for control_dt = {frame.period:g} s", what)
    count = max(1, round(frame.period / settings.dt))
    if dt < settings.dt:
        count = math.ceil(frame.period / dt * (1.0 - 1e-9))
        settings = _with_step(settings, frame.period / count, given.get("tolerance") is not None)
    while True:
        assert settings.dt is not None
        scene = standing_scene(frame.arm, settings.dt, frame.gravity, contacts=contacts)
        system = _with_least_masses(assembly.assemble(scene, settings), scene, settings, drawn, changed)
        need = _steps_needed(scene, system, frame.period)
        if given.get("dt") is not None or need <= count or count >= MOST_STEPS:
            break
        count = min(MOST_STEPS, max(need, count + 1))
        settings = _with_step(frame.settings, frame.period / count, given.get("tolerance") is not None)
    check_steps(scene, settings, system)
    return settings


def _with_step(first: Settings, dt: float, fixed: bool) -> Settings:
    """Return the settings with steps of dt (s).

    Unless the user fixes the Newton tolerance, it is adapted to this step.
    """
    assert first.dt is not None
    share = dt / first.dt
    tolerance = first.tolerance
    if share <= 0.5 and not fixed:
        tolerance = max(FINEST_TOLERANCE, tolerance * share * share)
    return replace(first, dt=dt, tolerance=tolerance)


def _with_least_masses(
    system: System, scene: Scene, settings: Settings, drawn: Mapping[str, tuple[float, float]], changed: float,
) -> System:  # fmt: skip
    """Return the assembled arm (`System`) whose contact points have their smallest effective masses.

    The minimum is over the nominal arm and the lightest, softest arm. changed: smallest factor of a payload change.
    """
    assert settings.dt is not None
    par = system.par.copy()
    lightest = drawn.get("payload", (1.0, 1.0))[0] * changed
    par[PAYLOAD_MASS] *= lightest
    par[PAYLOAD_INERTIA] *= lightest * drawn.get("payload_inertia", (1.0, 1.0))[0]
    softer = drawn.get("EI", (1.0, 1.0))[0]
    par[STIFFNESS_FACTOR] *= softer
    # in space EI_y and GJ also have factors of their own; that of EI acts on EI_y, too
    if "GJ" in reading_of(scene).stiffnesses:
        par[EI_Y_FACTOR] *= softer * drawn.get("EI_y", (1.0, 1.0))[0]
        par[GJ_FACTOR] *= drawn.get("GJ", (1.0, 1.0))[0]
    if (par == system.par).all():
        return system
    masses: Array = effective_masses(replace(system, par=par), settings.dt)
    parts = tuple(
        part._replace(masses=masses.clip(max=part.masses)) if isinstance(part, Touching) else part
        for part in system.model.contributions
    )
    return replace(system, model=system.model._replace(contributions=parts))


def _steps_needed(scene: Scene, system: System, period: float) -> int:
    """Return the number of steps in a period (s) with which every impact lasts `STEPS` steps, at most MOST_STEPS + 1.

    system: the assembled scene.
    """
    part = next(part for part in system.model.contributions if isinstance(part, Touching))
    masses = dict(zip(points_of(scene), part.masses.tolist(), strict=True))
    lasts = min(duration(contact, masses[one]) for contact in scene.contacts for one in contact.points(scene.arm))
    return math.ceil(min(STEPS * period / lasts, MOST_STEPS + 1.0) - 1e-9)
