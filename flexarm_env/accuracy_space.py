"""Part of the error estimate (`accuracy`) for runs in space: errors that coarser meshes and longer steps do not show.
"""

import math

import numpy as np

from .parameters import Link
from .scene import Scene
from .settings import Settings
from .validation import Array

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
    """Return settings of exact beams for a comparison run, and whether their mesh is fine enough.

    The distance from this run is an error that a comparison with a coarser mesh does not show.

    Frames along chords have an error of the order of the squared shear angle, on any mesh. The elastica formulation
    neglects shear deformation. A link under an axial force N bends within a distance of about sqrt(EI/N) from its ends.
    If the elements are several times longer than this distance, meshes with one and with two elements have the same
    error.

    Args:
        t: instants of the run, (n,), s. tip: positions of the tip and of the ends of its axes, (n, 4, 3), m.
    Returns:
        The settings (None if coarser meshes show all errors), and whether the elements of the exact beams are short
            enough.
    """
    links = [link for link in scene.arm.links if not link.rigid]
    if not scene.spatial or not links:
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
    """Return the ratio of the error of a run with step h to its distance from a run with step 2 h.

    growth: factor by which the distance grows if both steps are doubled. If the error is proportional to a power of h,
    the ratio is 1 / (growth - 1), for example 1/3 for a method of second order. The result contains a safety factor of
    1.5. If no step resolves a vibration, the error is about the vibration's amplitude for every step, and growth is
    about 1; the result is therefore limited to 1.5.
    """
    return 0.5 if growth >= 4.0 or not math.isfinite(growth) else min(1.5, 1.5 / max(growth - 1.0, 1e-3))


def mesh_factor(n: int) -> float:
    """Return the ratio of the error of a run with n elements to its distance from a run with m = n / 2 elements.

    If n is odd, m is rounded up. For errors proportional to the squared element length the ratio is
    1 / ((n/m)^2 - 1), which is 1/3 for m = n / 2. The result contains a safety factor of 1.5. For n = 1 the comparison
    run has two elements, and the result is 1.
    """
    return 1.0 if n == 1 else 1.5 / ((n / -(-n // 2)) ** 2 - 1.0)
