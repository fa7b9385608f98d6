"""How far a run's tip may be off: estimated from a run of twice the step and one of another mesh (theory, section 8).

The error has these parts, each a fraction of the arm's length:

    time_step   half the distance of the tip from a companion run of twice the step (a third is what a method of second
                order leaves; the rest is for safety); all of that from an eighth of the step where the step does not
                resolve the slowest vibration, or its decay
    mesh        half the distance between that companion and another of twice the step and half the mesh; all of it
                where the other mesh is the finer one; at least the distance from frames that are clamped at their
                roots, where links are so stubby that chords keep an error on any mesh (theory, section 3)
    energy      five times the energy that appeared from nowhere, or half of what the scheme dissipated, as a share of
                the energy turned over (`Trajectory.turned_over`)
    others      what the formulation knows of itself before the run: System.notes

Time step, mesh and notes add up; the estimate is that sum, or the energy's part where that is larger.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .parameters import Arm, Link
from .scene import Scene
from .settings import MOST_ELEMENTS, Settings, steps_in
from .validation import Array

_SAME_TIME = 1e-9
"""Instants this close (s, and relative to the last one) are the same."""

INACCURATE = "inaccurate"
"""Status of a run that came to its end, its estimated error above the limit."""

FOUND, TAKEN = 5.0, 0.5
"""Error for each share of the energy turned over that appeared from nowhere, or that the scheme dissipated. A small
relative error of an energy is twice that of the amplitude, hence a half; energy that appears is a sign of instability
and counts ten times as much."""


@dataclass(frozen=True)
class Probe:
    """A companion run: instants t (n,) s, tips (n, 2) m, in space places and axes as long as a fifth of the arm,
    (n, 4, 3) m, and whether it came to its end."""

    t: Array
    tip: Array
    good: bool


@dataclass(frozen=True)
class Estimate:
    """The estimated error and its parts, fractions of L.

    unknown: why the time step or the mesh could not be judged, in which case total is infinite; "" otherwise.
    """

    total: float
    parts: Mapping[str, float] = field(default_factory=dict)
    unknown: str = ""

    def message(self, limit: float) -> str:
        """Why a run is inaccurate, and what to do."""
        if self.unknown:
            return f"the error could not be estimated: {self.unknown}; take a smaller dt or a finer mesh"
        worst = max(self.parts, key=lambda name: self.parts[name])
        return (
            f"the tip's estimated error, {self.total:.2g} of the arm's length, is above error_limit = {limit:g}; the "
            f"largest part of it is {worst} ({self.parts[worst]:.2g}): {REMEDY.get(worst, REMEDY['others'])}"
        )


def missed(settings: Settings, step_error: float) -> str:
    """Why steps fitted to a tolerance are inaccurate; "" where they kept it. step_error: the largest of a stretch."""
    if settings.step_tolerance is None or step_error <= settings.step_tolerance:
        return ""
    return (
        f"step_tolerance = {settings.step_tolerance:g} is not kept: with dt = {settings.dt:g} s halved five times a "
        f"stretch between samples and kinks adds {step_error:.2g} of the arm's length; take a smaller dt, or a larger "
        "step_tolerance"
    )


REMEDY = {
    "time_step": "take a smaller dt",
    "mesh": "take more segments, elements or nodes",
    "energy": "take a smaller dt, or a rho_inf nearer to 1 if the scheme took it",
    "others": "take another formulation",
}


HALF = 0.5
"""Error for each unit of distance from a run of twice the step, or on half the mesh."""


def other_mesh(settings: Settings, space: bool = False) -> tuple[Settings, float]:
    """Settings of another mesh, and the error for each unit of distance from a run on it.

    The mesh is coarser; finer where there is none coarser; the full model where the link is reduced to modes, but in
    space, where these and finite elements are of one kind, other segments with as many modes.
    """
    if settings.formulation == "elastica":
        assert settings.nodes is not None
        if settings.nodes == 3:
            return settings.replace(nodes=5), 1.0
        return settings.replace(nodes=max(3, settings.nodes - 2)), HALF
    if settings.modes is not None and space:
        n = settings.segments or 1
        return settings.replace(segments=2 if n == 1 else -(-n // 2), modes=settings.modes), 1.0 if n == 1 else HALF
    if settings.modes is not None:
        return settings.replace(segments=max(5, settings.segments or 1), elements=1), 1.0
    assert settings.elements is not None
    if settings.formulation == "geometrically_exact":
        if settings.elements == 1:
            return settings.replace(elements=2), 1.0
        return settings.replace(elements=-(-settings.elements // 2)), HALF
    assert settings.segments is not None
    changes = {"coupling": "von_karman"}
    if settings.segments == 1:
        return settings.replace(segments=2, elements=-(-settings.elements // 2), **changes), 1.0
    return settings.replace(segments=-(-settings.segments // 2), **changes), HALF


COARSE, FINER = 0.5, 0.125
"""Step times the rate of the slowest vibration above which runs of h and 2 h may be wrong alike; h then is compared
with so much of it."""


STUBBY = 5e-3
"""EI / (C L^2) of a link above which frames along chords are compared with clamped ones."""


def clamped(scene: Scene, settings: Settings) -> Settings | None:
    """Settings of the same mesh with frames clamped at the roots, where what chords leave out of shear may count."""
    along = settings.formulation == "floating_frame" and settings.frame == "chord" and settings.coupling == "von_karman"
    if along and not scene.spatial and any(link.slenderness > STUBBY for link in scene.arm.links):
        return settings.replace(frame="root")
    return None


def slowest_rate(scene: Scene) -> float:
    """Rate (1/s) of the arm's slowest vibration or, where that is overdamped, of its faster decay; root held, straight.

    From the frequency of a beam of the arm's length and least stiffness, all that it carries at its tip (Rayleigh);
    where sections vary, in the plane, of the arm as it is.
    """
    arm, spatial = scene.arm, scene.spatial
    bending = [link for link in arm.links if not link.rigid]
    if not bending:
        return 0.0
    uniform = all(link.uniform is not None and not link.rigid_ends for link in arm.links)
    if spatial or (uniform and not arm.payload.eccentric):
        stiffness = min(_softest(link) if spatial else link.mean.EI for link in bending)
        carried = arm.payload.mass + sum(arm.elbow(k).mass for k in range(1, arm.n_links))
        moved = carried + 33.0 / 140.0 * sum(link.mass for link in bending)
        square = 3.0 * stiffness / (moved * arm.total_length**3)
    else:
        square = _varying_rate(arm)
    return max(math.sqrt(square), arm.damping[0] * square)


def _softest(link: Link) -> float:
    """The least stiffness to bending or torsion anywhere along a link in space, N m^2."""
    s = np.linspace(0.0, link.length, 65)
    across = link.across(s)
    return float(min(link.along(s).EI.min(), across["EI_y"].min(), across["GJ"].min()))


def _varying_rate(arm: Arm) -> float:
    """Square of the rate of a straight, locked arm whose sections vary: Rayleigh's, of the shape under its weight."""
    s, EI, mass, first = [], [], [], 0.0
    for k, link in enumerate(arm.links):
        places = np.linspace(0.0, link.length, 201)
        middle, piece = 0.5 * (places[1:] + places[:-1]), link.length / 200
        s.append(first + link.root_offset + middle)
        sections = link.along(middle)
        EI.append(sections.EI / piece)  # stiffness of a piece as a hinge with a spring
        mass.append(sections.m * piece)
        mass[-1][-1] += arm.payload.mass if k + 1 == arm.n_links else arm.elbow(k + 1).mass
        mass[-1][-1] += link.tip_mass
        first += link.span
    if arm.payload.eccentric:  # a place of its own, behind a rigid piece
        mass[-1][-1] -= arm.payload.mass
        s.append(np.array([first + arm.payload.offset[0]]))
        EI.append(np.array([np.inf]))
        mass.append(np.array([arm.payload.mass]))
    x, weight = np.concatenate(s), np.concatenate(mass)
    levers = np.maximum(x[:, None] - x, 0.0)  # of a weight (row) about a hinge (column)
    deflection = levers @ ((weight @ levers) / np.concatenate(EI))
    return float(weight @ deflection / (weight @ deflection**2))


def count_steps(scene: Scene, settings: Settings, end: float, sample: float) -> int:
    """Steps of a run that lands on every sample and kink."""
    lengths = _stretches(scene, end, sample)
    return int(_steps_in(lengths, _step_of(lengths, settings, sample)).sum())


def in_steps(scene: Scene, settings: Settings, end: float, sample: float) -> Settings:
    """Settings whose dt is the longest step of a run with this dt at most that lands on every sample and kink.

    An elastica's inertia is that of one length of step (theory, 5.3): steps are then no longer than those of a tenth of
    the time.
    """
    return settings.replace(dt=_step_of(_stretches(scene, end, sample), settings, sample))


def _stretches(scene: Scene, end: float, sample: float) -> Array:
    """Lengths (s) between samples and kinks."""
    samples = np.minimum(np.arange(1.0, steps_in(end, sample) + 1.0) * sample, end)
    kinks = np.array([k for k in scene.kinks if k < end], np.float64)
    return np.diff(np.union1d(samples, kinks), prepend=0.0)


def _steps_in(lengths: Array, dt: float) -> Array:
    """In how many steps of at most dt each stretch is gone through."""
    return np.maximum(1.0, np.ceil(lengths / dt * (1.0 - 1e-9)))


def _step_of(lengths: Array, settings: Settings, sample: float) -> float:
    """`in_steps` of stretches."""
    dt = settings.dt
    assert dt is not None
    steps = lengths / _steps_in(lengths, dt)
    found = float(steps.max())
    if settings.formulation == "elastica":
        order = np.argsort(steps)
        found = float(steps[order][np.searchsorted(np.cumsum(lengths[order]), 0.1 * lengths.sum())])
    for known in (dt, sample / steps_in(sample, dt)):
        if abs(found - known) <= 1e-9 * known:
            return known
    return found


def common_instants(t: ArrayLike, other: ArrayLike) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Indices into two increasing sequences of times, t (n,) s and other (m,) s, of the instants that both have."""
    first, second = np.asarray(t, dtype=float), np.asarray(other, dtype=float)
    nearest = np.clip(np.searchsorted(second, first), 0, second.size - 1)
    before = np.maximum(nearest - 1, 0)
    nearest = np.where(np.abs(second[before] - first) < np.abs(second[nearest] - first), before, nearest)
    same = np.abs(second[nearest] - first) <= _SAME_TIME * max(1.0, abs(float(second[-1])))
    return np.flatnonzero(same), nearest[same]


def distance(one: Probe, other: Probe) -> float:
    """Largest distance of two tips, or of their axes' ends, m, over the instants that both have; infinite where either
    failed."""
    if not (one.good and other.good):
        return math.inf
    mine, theirs = common_instants(one.t, other.t)
    return float(reduce(np.hypot, np.moveaxis(other.tip[theirs] - one.tip[mine], -1, 0)).max())


def estimate(
    scene: Scene,
    settings: Settings,
    mine: Probe,
    end: float,
    sample: float,
    run: Callable[..., Probe],
    levels: Sequence[int] = (),
) -> tuple[dict[str, float], str]:
    """The parts of time step and mesh, as fractions of L, and why one of them is infinite.

    mine: the run itself, sampled each `sample` s. run: a companion, from a scene, settings, a sampling interval and,
    where steps are fitted to a tolerance, the halvings of dt in each stretch (`Trajectory.step_levels`). levels: those
    of the run. Drag (`Arm.mass_damping`) belongs to one mesh: meshes are then compared without it.
    """
    dt = settings.dt
    assert dt is not None
    length, wide = scene.arm.total_length, min(2.0 * sample, end)
    steps = count_steps(scene, settings, end, sample)
    companion = Probe(mine.t, mine.tip, False)
    doubled = settings.replace(dt=2.0 * dt)
    drag = scene.arm.mass_damping > 0.0
    bare = replace(scene, arm=replace(scene.arm, mass_damping=0.0)) if drag else scene
    if settings.step_tolerance is not None:
        other, factor = other_mesh(settings, scene.spatial)
        time_step = HALF * distance(mine, run(scene, settings, sample, [level - 1 for level in levels]))
        base = run(bare, settings, sample, levels) if drag else mine
        mesh = factor * distance(base, run(bare, other, sample, levels))
        if (root := clamped(scene, settings)) is not None:
            mesh = max(mesh, distance(base, run(bare, root, sample, levels)))
        return {"time_step": time_step / length, "mesh": mesh / length}, _why(time_step, mesh)
    if count_steps(scene, doubled, end, wide) <= 0.75 * steps:
        companion = run(scene, doubled, wide)
        time_step = HALF * distance(mine, companion)
    if not companion.good:  # kinks or samples in each step, or too long a step: look at a shorter one
        doubled, wide = settings, sample
        companion = mine
        time_step = 2.0 * distance(mine, run(scene, settings.replace(dt=0.5 * dt), sample))
    if dt * slowest_rate(scene) > COARSE:
        time_step = max(time_step, distance(mine, run(scene, settings.replace(dt=FINER * dt), sample)))
    other, factor = other_mesh(doubled, scene.spatial)
    base = run(bare, doubled, wide) if drag else companion
    mesh = factor * distance(base, run(bare, other, wide))
    if math.isinf(mesh):
        base = run(bare, settings, sample) if drag else mine
        mesh = distance(base, run(bare, finer_mesh(settings).replace(dt=0.5 * dt), sample))
    elif (root := clamped(scene, doubled)) is not None:
        mesh = max(mesh, distance(base, run(bare, root, wide)))
    return {"time_step": time_step / length, "mesh": mesh / length}, _why(time_step, mesh)


def followed(
    scene: Scene,
    settings: Settings,
    mine: Probe,
    sample: float,
    run: Callable[..., Probe],
    levels: Sequence[int],
    notes: Mapping[str, float],
) -> dict[str, float]:
    """The elastica's note on stretch and shear where motion is gross: a linear estimate, or how far a run whose links
    are as much softer as stretch and shear make them (`Notes.softer`) comes out, if that is more; {} for others."""
    stiffness = getattr(notes, "softer", None)
    if stiffness is None:
        return {}
    apart = distance(mine, run(scene, settings, sample, levels, stiffness)) / scene.arm.total_length
    return {"stretch_and_shear": max(notes["stretch_and_shear"], min(1.0, apart))}


def _why(time_step: float, mesh: float) -> str:
    """Why an estimate is infinite."""
    if math.isinf(time_step):
        return "neither a run of twice the step nor one of half of it came to its end"
    return "no run on another mesh came to its end" if math.isinf(mesh) else ""


def finer_mesh(settings: Settings) -> Settings:
    """Settings of twice the mesh."""
    if settings.formulation == "elastica":
        assert settings.nodes is not None
        return settings.replace(nodes=min(12, settings.nodes + 2) if settings.nodes < 12 else 11)
    if settings.modes is not None:
        return settings.replace(segments=max(8, 2 * (settings.segments or 1)), elements=1)
    if settings.formulation == "geometrically_exact":
        assert settings.elements is not None
        return settings.replace(elements=min(MOST_ELEMENTS, 2 * settings.elements))
    assert settings.segments is not None
    finer = min(2 * settings.segments, MOST_ELEMENTS // (settings.elements or 1))
    return settings.replace(segments=finer, coupling="von_karman")


def energy_part(balance: Array, turned_over: float) -> float:
    """The energy's part of the error from the balance (n,) J and the energy turned over, J."""
    if turned_over <= 0.0:
        return 0.0
    return max(FOUND * float(balance.max()), -TAKEN * float(balance.min())) / turned_over


def total(parts: Mapping[str, float]) -> float:
    """The estimate from its parts."""
    return max(parts.get("energy", 0.0), sum(value for name, value in parts.items() if name != "energy"))
