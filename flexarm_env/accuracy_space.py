"""Parts of the error estimate (`accuracy`) that differ between plane and space.

In space the estimate includes errors that comparisons with coarser meshes and longer steps do not show.
"""

import math
from collections.abc import Callable

import numpy as np

from .parameters import Arm, Link
from .rigid import inertia_beyond
from .scene import Scene
from .settings import Settings
from .validation import Array

HALF = 0.5
"""Error of a run divided by its distance from a run with twice the step, or from a run on half the mesh."""

STUBBY = 5e-3
"""EI / (C L^2) of a link above which a run with chord frames is compared with another run.

The other run uses clamped frames in the plane and an exact beam in space.
"""

SHEARED = 1e-4
"""EI / (C L^2) of a link above which an elastica in space is compared with an exact beam."""

LAYER = 2.0
"""Limit of an element's length divided by sqrt(EI/N), the bending length of a link under an axial force N.

If the ratio exceeds LAYER, any run in space is compared with a finer exact beam.
"""

AT_LEAST, AT_MOST = 12, 200
"""AT_LEAST: smallest number of elements per link of the exact beam with which an elastica is compared. AT_MOST: largest
number of elements per link of any exact beam that a run is compared with.
"""


def _stubbiness(link: Link) -> float:
    """Return the largest shear-to-bending flexibility EI / (C L^2) of a link in space, over length and planes."""
    s = np.linspace(0.0, link.length, 9)
    own, across = link.along(s), link.across(s)
    return float(max((own.EI / own.C).max(), (across["EI_y"] / across["C_y"]).max()) / link.length**2)


def _pull(scene: Scene, t: Array, tip: Array) -> float:
    """Return an estimate of the largest force (N) in the links of a run in space, from weight, inertia and loads.

    Args:
        t, tip: instants (n,) s; positions of the tip and its axes (n, 4, 3) m, inertial axes.
    """
    arm = scene.arm
    mass = arm.payload.mass + sum(link.mass for link in arm.links) + sum(elbow.mass for elbow in arm.elbows)
    # acceleration of the tip by differences of unequal intervals
    rate = np.diff(tip[:, 0], axis=0) / np.diff(t)[:, None]
    second = np.diff(rate, axis=0) / (0.5 * (t[2:] - t[:-2]))[:, None]
    most = float(np.linalg.norm(second, axis=1).max(initial=0.0)) + float(np.linalg.norm(scene.gravity or 0.0))
    # largest forces of the loads, sampled over the run
    at = np.linspace(0.0, scene.duration, 257)
    forces = (getattr(load, f"force_{axis}", None) for load in scene.loads for axis in "xyz")
    return mass * most + sum(float(np.abs(f(at)).max()) for f in forces if f is not None)


def witness(scene: Scene, settings: Settings, t: Array, tip: Array) -> tuple[Settings | None, bool]:
    """Return settings for a comparison run with exact beams, and whether this run's mesh is fine enough.

    The distance from the comparison run contains errors that a comparison with a coarser mesh does not show.

    If the x axis of a floating frame is the chord of a segment, the frame causes an error of the order of the squared
    shear angle. A finer mesh does not reduce the error of chord frames. The elastica formulation neglects shear
    deformation. A link under an axial force N bends within a distance of about sqrt(EI/N) from its ends. If the
    elements are several times longer than sqrt(EI/N), meshes with one and with two elements have the same error.

    Args:
        t: instants of the run, (n,), s. tip: positions of the tip and of the end points of its three axes, (n, 4, 3),
            m.
    Returns:
        The settings, and whether the elements of the comparison run are short enough. The settings are None if a
            comparison with a coarser mesh shows all errors.
    """
    links = [link for link in scene.arm.links if not link.rigid]
    if not links:
        return None, True
    # n: cells per link; bends: shortest bending length over the link's length
    elastica = settings.formulation == "elastica"
    n = (settings.nodes or 0) - 1 if elastica else (settings.segments or 1) * (settings.elements or 1)
    pull = max(_pull(scene, t, tip), 1e-300)
    bends = min(math.sqrt(softest(link) / pull) / link.length for link in links)  # over the link's length
    limit = math.inf if settings.formulation == "geometrically_exact" else SHEARED if elastica else STUBBY
    sheared = any(_stubbiness(link) > limit for link in links)
    layered = 1.0 / n > LAYER * bends
    if not sheared and not layered:
        return None, True
    # elements of the exact beam: one per bending length and twice the run's mesh, within the limits
    count = max(n, AT_LEAST) if sheared or elastica else n
    if layered:
        count = max(count, 2 * n, math.ceil(1.0 / bends))
    count = max(n, min(count, AT_MOST))
    scheme = {"newmark": settings.newmark} if settings.newmark else {"rho_inf": settings.rho_inf}
    own = Settings.make("geometrically_exact", elements=count, dt=settings.dt, tolerance=settings.tolerance, **scheme)
    return own, 1.0 / count <= LAYER * bends


def softest(link: Link) -> float:
    """Return the smallest of the bending and torsional stiffnesses along a link in space, N m^2."""
    s = np.linspace(0.0, link.length, 65)
    across = link.across(s)
    return float(min(link.along(s).EI.min(), across["EI_y"].min(), across["GJ"].min()))


LITTLE = 1e-7
"""If the distance of two runs, divided by the arm's length, is below this number, no third run is made."""


def step_factor(growth: float) -> float:
    """Return the error of a run with step h, divided by the distance between runs with the steps h and 2 h.

    growth: factor by which the distance between the two runs grows if the steps of both runs are doubled. If the error
    is proportional to a power of h, the ratio is 1 / (growth - 1), for example 1/3 for a method of second order. The
    result contains a safety factor of 1.5. If no step resolves a vibration, the error is about the vibration's
    amplitude for every step, and growth is about 1. The returned ratio is therefore limited to 1.5.
    """
    return 0.5 if growth >= 4.0 or not math.isfinite(growth) else min(1.5, 1.5 / max(growth - 1.0, 1e-3))


def mesh_factor(n: int) -> float:
    """Return the error of a run with n elements, divided by the distance between runs with n and m = n / 2 elements.

    If n is odd, m is rounded up. For errors proportional to the squared element length the ratio is
    1 / ((n/m)^2 - 1), which is 1/3 for m = n / 2. The result contains a safety factor of 1.5. For n = 1 the comparison
    run has two elements, and the result is 1.
    """
    return 1.0 if n == 1 else 1.5 / ((n / -(-n // 2)) ** 2 - 1.0)


class Errors:
    """Parts of the error estimate for runs in the plane."""

    def factor(self, n: int) -> float:
        """Return the error with n elements or segments, divided by the distance between runs with n and with n / 2."""
        return HALF

    def other_modes(self, settings: Settings, full: int) -> tuple[Settings, float]:
        """Return settings with at least `full` segments, without modes, for comparison with links reduced to modes."""
        return settings.replace(segments=max(full, settings.segments or 1), elements=1), 1.0

    def has_stubby_link(self, arm: Arm) -> bool:
        """Return whether a run with chord frames needs a comparison run with frames clamped at the segments' roots."""
        return any(link.slenderness > STUBBY for link in arm.links)

    def gear_rate(self, arm: Arm) -> float:
        """Return `accuracy.gear_rate`."""
        rates = [0.0]
        for k, joint in enumerate(arm.joints):
            # two inertias on a spring: omega^2 = k (1 / rotor + 1 / arm)
            if joint.elastic and joint.rotor > 0.0:
                rates.append(math.sqrt(joint.stiffness * (1.0 / joint.rotor + 1.0 / inertia_beyond(arm, k))))
        return max(rates)

    def slowest_square(self, arm: Arm) -> float:
        """Return omega^2 (1/s^2) of the straight arm's slowest vibration with a fixed root."""
        uniform = all(link.uniform is not None and not link.rigid_ends for link in arm.links)
        if uniform and not arm.payload.eccentric:
            return _cantilever(arm, min(link.mean.EI for link in arm.links))
        return _varying_rate(arm)

    def share_of_step(self, share: float, growth: Callable[[], float]) -> float:
        """Return the error due to the time step h, divided by the distance between runs with the steps h and 2 h.

        share: default ratio. growth: function that returns the factor by which the distance between the two runs grows
        if the steps of both runs are doubled.
        """
        return share

    def witness(self, scene: Scene, settings: Settings, t: Array, tip: Array) -> tuple[Settings | None, bool]:
        """Return None: in the plane, runs are compared with clamped frames instead of exact beams."""
        return None, True

    def neglected(self, apart: float, known: float) -> float:
        """Return the elastica's error due to its neglect of stretch and shear, divided by the arm's length.

        apart: distance from a run with reduced stiffness. known: linear estimate of the error. Both arguments are
        divided by the arm's length.
        """
        return max(known, min(1.0, apart))


class ErrorsInSpace(Errors):
    """Parts of the error estimate for runs in space."""

    def factor(self, n: int) -> float:
        """Return the ratio that `mesh_factor` computes."""
        return mesh_factor(n)

    def other_modes(self, settings: Settings, full: int) -> tuple[Settings, float]:
        """Return settings with half as many segments and the same number of modes."""
        n = settings.segments or 1
        return settings.replace(segments=2 if n == 1 else -(-n // 2), modes=settings.modes), mesh_factor(n)

    def has_stubby_link(self, arm: Arm) -> bool:
        """Return False, because in space `witness` covers links with shear deformation."""
        return False

    def gear_rate(self, arm: Arm) -> float:
        """Return 0, because gears are not considered in space."""
        return 0.0

    def slowest_square(self, arm: Arm) -> float:
        """Return omega^2, 1/s^2, of the slowest vibration of a beam with the arm's smallest stiffness."""
        return _cantilever(arm, min(softest(link) for link in arm.links if not link.rigid))

    def share_of_step(self, share: float, growth: Callable[[], float]) -> float:
        """Return the larger of `share` and the ratio that `step_factor` computes."""
        return max(share, step_factor(growth()))

    def witness(self, scene: Scene, settings: Settings, t: Array, tip: Array) -> tuple[Settings | None, bool]:
        """Return settings of exact beams for a comparison run, see the function `witness`."""
        return witness(scene, settings, t, tip)

    def neglected(self, apart: float, known: float) -> float:
        """Return `apart`, the distance from the comparison run with exact beams."""
        return apart


def errors_of(scene: Scene) -> Errors:
    """Return the object that computes the parts of the error estimate for a scene, in the plane or in space."""
    return ErrorsInSpace() if scene.spatial else Errors()


def _cantilever(arm: Arm, stiffness: float) -> float:
    """Return omega^2 (1/s^2) of a beam with the arm's length, a stiffness (N m^2) and the arm's load at its tip."""
    carried = arm.payload.mass + sum(arm.elbow(k).mass for k in range(1, arm.n_links))
    # cantilever: omega^2 = 3 EI / ((m_tip + 33/140 m_beam) L^3)
    moved = carried + 33.0 / 140.0 * sum(link.mass for link in arm.links if not link.rigid)
    return 3.0 * stiffness / (moved * arm.total_length**3)


def _varying_rate(arm: Arm) -> float:
    """Return omega^2 (1/s^2) of a straight, locked arm with varying sections, as Rayleigh's quotient of its sag."""
    s, EI, mass, first = [], [], [], 0.0
    for k, link in enumerate(arm.links):
        # 200 pieces per link; masses at their middles, payload and elbows at the link's last piece
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
    # deflection under weights w: moments at hinges, their rotations, lever arms; omega^2 = w.d / w.d^2
    deflection = levers @ ((weight @ levers) / np.concatenate(EI))
    return float(weight @ deflection / (weight @ deflection**2))
