"""Estimate a run's tip error from a run with twice the step and a run on another mesh (docs/theory.md, section 8).

The distance between two runs is the largest distance between their tips at equal times. The error estimate has four
parts, which are divided by the arm's length:

    time_step   half the distance from a run with twice the step. (The error of a second-order method is a third of this
                distance; the factor 1/2 includes a safety margin.) If the step does not resolve the slowest vibration
                or its decay, time_step is the whole distance from a run with an eighth of the step. In space a third
                run, with four times the step, shows the order of the errors. If the order is below two, time_step is up
                to 1.5 times the distance from the run with twice the step
    mesh        half the distance between two runs with twice the step. The second run has a mesh with half as many
                cells. If the second run needs a finer mesh instead, this part is the whole distance between the two
                runs. Two errors do not depend on the mesh: the error of chord frames on stubby links, and the error of
                a link under high tension that bends within less than one element. For such links this part is at least
                the distance from a run with frames clamped at the segments' roots, in space from a run with exact beams
                (`accuracy_space`)
    energy      five times the energy that the time integration created, or half of the energy that it dissipated,
                divided by `Trajectory.turned_over`
    others      errors of the formulation that are known before the run (`System.notes`)

The estimated tip error is time_step + mesh + others, or `energy` if `energy` is larger.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .accuracy_space import HALF, LITTLE, Errors, errors_of
from .scene import Scene, default_mesh, divided, halved_mesh, resolving_step
from .settings import MOST_ELEMENTS, Settings, steps_in
from .validation import Array

_SAME_TIME = 1e-9
"""Two instants count as equal if they differ by less than this (s, and as a fraction of the last instant)."""

INACCURATE = "inaccurate"
"""Status of a run that reached its end with an estimated error above the limit."""

FOUND, TAKEN = 5.0, 0.5
"""Factors on the energy that the scheme created (FOUND) or dissipated (TAKEN), as a fraction of the energy turned over.
TAKEN is 1/2 because a small relative error of the energy is twice the relative error of the amplitude. FOUND is ten
times as large because created energy indicates instability."""


@dataclass(frozen=True)
class Probe:
    """Tip of a run. t (n,): instants of the samples, s. tip: in the plane positions of the tip (n, 2), m; in space
    positions of the tip and of points on its three axes, (n, 4, 3), m. good: True if the run reached its end."""

    t: Array
    tip: Array
    good: bool


@dataclass(frozen=True)
class Estimate:
    """Estimated error (`total`) and its parts, divided by the arm's length. unknown: "", or the reason why a part could
    not be estimated. The total is infinite if a part could not be estimated."""

    total: float
    parts: Mapping[str, float] = field(default_factory=dict)
    unknown: str = ""

    def message(self, limit: float) -> str:
        """Return the reason why a run is inaccurate, and advice to the user."""
        if self.unknown:
            return f"the error could not be estimated: {self.unknown}; take a smaller dt or a finer mesh"
        worst = max(self.parts, key=lambda name: self.parts[name])
        return (
            f"the tip's estimated error, {self.total:.2g} of the arm's length, is above error_limit = {limit:g}; the "
            f"largest part of it is {worst} ({self.parts[worst]:.2g}): {REMEDY.get(worst, REMEDY['others'])}"
        )


def missed(settings: Settings, step_error: float) -> str:
    """Return the message that the step error exceeds step_tolerance, or "" if it does not."""
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


def other_mesh(settings: Settings, errors: Errors | None = None, full: int = 5) -> tuple[Settings, float]:
    """Return settings with another mesh, and the run's expected error divided by the distance of the two runs.

    The other mesh is coarser than the mesh of the run, or finer if there is no coarser mesh. For links reduced to modes
    in the plane, the returned settings have at least `full` segments and no modes. In space the returned settings have
    another number of segments and the same number of modes.
    """
    if settings.formulation == "elastica":
        assert settings.nodes is not None
        # the smallest mesh is compared with a finer one
        if settings.nodes == 3:
            return settings.replace(nodes=5), 1.0
        return settings.replace(nodes=max(3, settings.nodes - 2)), HALF
    errors = errors or Errors()
    if settings.modes is not None:
        return errors.other_modes(settings, full)
    assert settings.elements is not None
    if settings.formulation == "geometrically_exact":
        # exact beams: half the elements; floating frames: half the segments
        if settings.elements == 1:
            return settings.replace(elements=2), 1.0
        return settings.replace(elements=-(-settings.elements // 2)), errors.factor(settings.elements)
    assert settings.segments is not None
    changes = {"coupling": "von_karman"}
    if settings.segments == 1:
        return settings.replace(segments=2, elements=-(-settings.elements // 2), **changes), 1.0
    return settings.replace(segments=-(-settings.segments // 2), **changes), errors.factor(settings.segments)


def companion_mesh(scene: Scene, settings: Settings) -> tuple[Scene, Settings, float]:
    """Return scene and settings with another mesh, and the run's expected error divided by the distance of the two
    runs. If a link's section has jumps or kinks, all cells are halved: a coarser mesh could keep the cells of a short
    interval and hide the error of these cells. For arms without jumps and kinks the mesh is that of `other_mesh`."""
    if divided(scene.arm) and (halved := halved_mesh(scene.arm, settings)):
        return replace(scene, arm=halved[0]), halved[1], 1.0
    full = default_mesh(scene.arm, settings.formulation).get("segments", 5)
    return scene, *other_mesh(settings, errors_of(scene), full)


COARSE, FINER = 0.5, 0.125
"""COARSE: product of step h and rate of the slowest vibration above which runs with h and 2 h may have the same error.
Such runs are compared with runs with FINER times the step."""


DRIVEN = 4.0
"""Factor on the step dt. If steps of DRIVEN dt resolve loads and motions, the error is half the distance from the
companion run. Otherwise the error is the whole distance, since both runs may vibrate out of phase."""


QUARTER, SLOW, QUICK = 0.25, 0.2, 30.0
"""QUARTER: factor on the step of the companion run of an arm with elastic gears. Let x be the step times the rate of a
gear's vibration: below x = SLOW the step resolves the vibration, above x = QUICK the gear is practically rigid.
"""


def clamped(scene: Scene, settings: Settings) -> Settings | None:
    """Return settings with frames clamped at the segments' roots if a planar run has stubby links and chord frames with
    von Karman coupling; otherwise return None. In such a run the shear of the links causes an error that a comparison
    of meshes does not show."""
    along = settings.formulation == "floating_frame" and settings.frame == "chord" and settings.coupling == "von_karman"
    if along and errors_of(scene).has_stubby_link(scene.arm):
        return settings.replace(frame="root")
    return None


def rubs(scene: Scene) -> bool:
    """Return whether a joint has Coulomb friction or backlash, which cause step errors of first order."""
    return any(joint.friction_coulomb > 0.0 or joint.backlash > 0.0 for joint in scene.arm.joints)


def gear_rate(scene: Scene) -> float:
    """Return the angular frequency, rad/s, of the fastest gear vibration: a rotor vibrates on its elastic gear against
    the rigid arm beyond the joint. Return 0 if no gear is elastic, or for an arm in space."""
    return errors_of(scene).gear_rate(scene.arm)


def slowest_rate(scene: Scene) -> float:
    """Return the angular frequency, rad/s, of the straight arm's slowest vibration with a fixed root. If the slowest
    vibration is overdamped, return its faster decay rate, 1/s. The frequency is Rayleigh's estimate for a beam with the
    arm's length, smallest stiffness and load at the tip. For planar arms with varying sections the frequency is
    computed from the stiffness and mass at points along the arm."""
    arm = scene.arm
    if all(link.rigid for link in arm.links):
        return 0.0
    square = errors_of(scene).slowest_square(arm)
    return max(math.sqrt(square), arm.damping[0] * square)


def count_steps(scene: Scene, settings: Settings, end: float, sample: float) -> int:
    """Return the number of steps in a run whose steps end at every sample and kink."""
    lengths = _stretches(scene, end, sample)
    return int(_steps_in(lengths, _step_of(lengths, settings, sample)).sum())


def in_steps(scene: Scene, settings: Settings, end: float, sample: float) -> Settings:
    """Return settings whose dt is the longest step of a run in which steps end at every sample and kink. Each interval
    between samples and kinks has equal steps of at most the given dt. For an elastica the new dt is chosen so that
    steps up to the new dt cover a tenth of the run's time. The reason is that the correction of the elastica's inertia
    matrix holds for one step length (docs/theory.md, section 5.3)."""
    return settings.replace(dt=_step_of(_stretches(scene, end, sample), settings, sample))


def _stretches(scene: Scene, end: float, sample: float) -> Array:
    """Return the intervals (s) between samples and kinks, up to `end`."""
    samples = np.minimum(np.arange(1.0, steps_in(end, sample) + 1.0) * sample, end)
    kinks = np.array([k for k in scene.kinks if k < end], np.float64)
    return np.diff(np.union1d(samples, kinks), prepend=0.0)


def _steps_in(lengths: Array, dt: float) -> Array:
    """Return the number of steps of at most dt (s) in each interval."""
    return np.maximum(1.0, np.ceil(lengths / dt * (1.0 - 1e-9)))


def _step_of(lengths: Array, settings: Settings, sample: float) -> float:
    """Return the step (s) of `in_steps` for given intervals."""
    dt = settings.dt
    assert dt is not None
    # step in each interval; then the longest, or the elastica's tenth
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
    """Return the indices of equal instants in two increasing sequences of times, t (n,) and other (m,), s."""
    first, second = np.asarray(t, dtype=float), np.asarray(other, dtype=float)
    # nearest instant of the other sequence: the one behind or before
    nearest = np.clip(np.searchsorted(second, first), 0, second.size - 1)
    before = np.maximum(nearest - 1, 0)
    nearest = np.where(np.abs(second[before] - first) < np.abs(second[nearest] - first), before, nearest)
    same = np.abs(second[nearest] - first) <= _SAME_TIME * max(1.0, abs(float(second[-1])))
    return np.flatnonzero(same), nearest[same]


def distance(one: Probe, other: Probe) -> float:
    """Return the largest distance, m, between the `tip` of two runs at equal times; inf if a run failed."""
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
    """Return the parts time_step and mesh of the error, divided by the arm's length, and a reason.

    The reason states why a part is infinite; it is "" if all parts are finite. mine: the run, sampled every `sample` s.
    levels: numbers of halvings of dt in `mine` (`Trajectory.step_levels`). run: function that computes a comparison
    run. The arguments of `run` are a scene, settings, a sampling interval and, with a step_tolerance, the number of
    halvings of dt in each interval. Meshes are compared without `Arm.mass_damping`, whose effect depends on the mesh.
    """
    dt = settings.dt
    assert dt is not None
    # share of the distance that counts; the companion is sampled half as often
    length, wide = scene.arm.total_length, min(2.0 * sample, end)
    share = HALF
    if rubs(scene) or resolving_step(scene, DRIVEN * dt, end) < DRIVEN * dt:
        share = 1.0
    steps = count_steps(scene, settings, end, sample)
    companion = Probe(mine.t, mine.tip, False)
    doubled = settings.replace(dt=2.0 * dt)
    # meshes are compared without drag
    drag = scene.arm.mass_damping > 0.0
    bare = replace(scene, arm=replace(scene.arm, mass_damping=0.0)) if drag else scene
    # fitted steps: each stretch with one halving less; then the other mesh with the same steps
    if settings.step_tolerance is not None:
        there, other, factor = companion_mesh(bare, settings)
        time_step = HALF * distance(mine, run(scene, settings, sample, [level - 1 for level in levels]))
        base = run(bare, settings, sample, levels) if drag else mine
        mesh = factor * distance(base, run(there, other, sample, levels))
        if (root := clamped(scene, settings)) is not None:
            mesh = max(mesh, distance(base, run(bare, root, sample, levels)))
        return {"time_step": time_step / length, "mesh": mesh / length}, _why(time_step, mesh)
    if count_steps(scene, doubled, end, wide) <= 0.75 * steps:
        companion = run(scene, doubled, wide)
        found = distance(mine, companion)
        time_step = share * found
        if companion.good and time_step > LITTLE * length:
            time_step = found * errors_of(scene).share_of_step(
                share, lambda: _growth(scene, doubled, end, wide, companion, found, run)
            )
    # no longer step possible, or it failed: compare with half the step
    if not companion.good:
        doubled, wide = settings, sample
        companion = mine
        time_step = (1.0 + 2.0 * share) * distance(mine, run(scene, settings.replace(dt=0.5 * dt), sample))
    # steps that miss the slowest vibration, or a gear's
    if dt * slowest_rate(scene) > COARSE:
        time_step = max(time_step, distance(mine, run(scene, settings.replace(dt=FINER * dt), sample)))
    if SLOW < dt * gear_rate(scene) < QUICK:
        time_step = max(time_step, distance(mine, run(scene, settings.replace(dt=QUARTER * dt), sample)))
    # mesh: companions of twice the step on two meshes; on failure a finer mesh and half the step
    there, other, factor = companion_mesh(bare, doubled)
    base = run(bare, doubled, wide) if drag else companion
    mesh = factor * distance(base, run(there, other, wide))
    if math.isinf(mesh):
        base = run(bare, settings, sample) if drag else mine
        mesh = distance(base, run(bare, finer_mesh(settings).replace(dt=0.5 * dt), sample))
    elif (root := clamped(scene, doubled)) is not None:
        mesh = max(mesh, distance(base, run(bare, root, wide)))
    elif settings.formulation != "elastica":
        mesh = max(mesh, _from_exact(scene, doubled, base, wide, run))
    return {"time_step": time_step / length, "mesh": mesh / length}, _why(time_step, mesh)


def _growth(
    scene: Scene, settings: Settings, end: float, sample: float, mine: Probe, found: float, run: Callable[..., Probe]
) -> float:
    """Return the growth (`step_factor`) of the distance `found` (m) of a run in space from `mine`, which has half its
    step. settings, sample: settings and sampling interval of `mine`. A third run, with four times the step, shows how
    the distance grows."""
    again, wide = settings.replace(dt=2.0 * float(settings.dt or 0.0)), min(2.0 * sample, end)
    if count_steps(scene, again, end, wide) > 0.75 * count_steps(scene, settings, end, sample):
        return 1.0
    return distance(mine, run(scene, again, wide)) / found


def _from_exact(scene: Scene, settings: Settings, mine: Probe, sample: float, run: Callable[..., Probe]) -> float:
    """Return the distance (m) of a run in space from its `witness`, an exact beam. Return inf if the witness is too
    coarse, and 0 if there is no witness or double precision cannot resolve it."""
    exact, fine = errors_of(scene).witness(scene, settings, mine.t, mine.tip)
    if exact is None:
        return 0.0
    try:
        found = distance(mine, run(scene, exact, sample))
    except ValueError:
        return 0.0
    return found if fine else math.inf


def followed(
    scene: Scene,
    settings: Settings,
    mine: Probe,
    sample: float,
    run: Callable[..., Probe],
    levels: Sequence[int],
    notes: Mapping[str, float],
) -> dict[str, float]:
    """For an elastica, return the error due to neglected stretch and shear, divided by the arm's length; otherwise {}.

    In the plane the error is the distance from a run whose bending stiffness is reduced to represent stretch and shear.
    The planar error is at most 1 and at least the linear estimate in `notes`. In space the error is the distance from a
    run with exact beams or, for slender links, from the run with reduced stiffness.
    """
    stiffness = getattr(notes, "softer", None)
    if stiffness is None:
        return {}
    length = scene.arm.total_length
    if (found := _from_exact(scene, settings, mine, sample, run)) > 0.0:
        return {"stretch_and_shear": found / length}
    apart = distance(mine, run(scene, settings, sample, levels, stiffness)) / length
    return {"stretch_and_shear": errors_of(scene).neglected(apart, notes.get("stretch_and_shear", 0.0))}


def _why(time_step: float, mesh: float) -> str:
    """Return the reason for an infinite estimate; "" if the estimate is finite."""
    if math.isinf(time_step):
        return "neither a run of twice the step nor one of half of it came to its end"
    if math.isinf(mesh):
        return "no run on another mesh came to its end, or links bend within less than any mesh resolves"
    return ""


def finer_mesh(settings: Settings) -> Settings:
    """Return settings with about twice the number of elements or nodes."""
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
    """Return the part `energy` of the error estimate. balance (n,): energy that the time integration has created until
    each instant, J. turned_over: see `Trajectory.turned_over`, J."""
    if turned_over <= 0.0:
        return 0.0
    return max(FOUND * float(balance.max()), -TAKEN * float(balance.min())) / turned_over


def total(parts: Mapping[str, float]) -> float:
    """Return the total error: the sum of all parts except `energy`, or `energy` if it is larger than this sum."""
    return max(parts.get("energy", 0.0), sum(value for name, value in parts.items() if name != "energy"))
