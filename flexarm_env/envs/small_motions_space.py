"""Linear model of small motions of an arm in space about a posture: matrices for `small_motions.Motion`.

Links consist of beam elements with cubic displacements in both planes, linear stretch and linear twist. The coordinates
are the joint angles (rad), and displacement (m) and rotation (rad) of each element's far end in inertial axes. For each
section, a matrix (6, n) maps the coordinates to the section's displacement and rotation. Only the KEPT lowest modes of
the arm are used.
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial import legendre

from .. import rotations
from ..bodies import Inertia, RigidLink, tensor
from ..parameters import Arm
from ..rigid import axis_of, mount_of
from ..sections import Link
from ..settings import Settings
from ..validation import Array
from .small_motions import Motion, vibrations

KEPT = 30
"""Number of vibration modes that are used."""

X = np.array([1.0, 0.0, 0.0])
BENDING_Y, BENDING_Z = [1, 5, 7, 11], [2, 4, 8, 10]
"""Indices among an element's 12 rows for bending along y and z.

The slope of the displacement along y is the rotation about z; the slope of the displacement along z is minus the
rotation about y.
"""

POINTS = legendre.leggauss(4)


class _Assembly:
    """Matrices M, C, K (n, n) of an arm about joint angles `pose`, assembled from root to tip; SI units, inertial axes.

    bend: for each flexible link (3, n), rotation of its tip relative to its root, rad, in the link's axes. tip (3, n):
    displacement of the tip, m.
    """

    def __init__(self, arm: Arm, elements: int, pose: Array) -> None:
        """Assemble the arm: joints, rigid bodies and beams from the root to the payload.

        elements: number per link, at least one between two jumps of the section. pose: joint angles (N,), rad.
        """
        self.arm, self.joints = arm, arm.n_links
        counts = [0 if link.rigid else max(elements, len(link.jumps) + 1) for link in arm.links]
        self.n = self.joints + 6 * sum(counts)
        self.M, self.C, self.K = (np.zeros((self.n, self.n)) for _ in range(3))
        self.bend: list[Array] = []
        # at: map (6, n) of the section reached; axes: its axes in inertial ones; first: next free coordinate
        at, axes, first = np.zeros((6, self.n)), np.eye(3), self.joints
        for k, (link, count) in enumerate(zip(arm.links, counts, strict=True)):
            if k:
                self.add_body(at, axes, arm.elbow(k).mass, arm.elbow(k).inertia_left)
            # joint k: rotates by its angle about its axis
            axes = axes @ mount_of(arm, k) @ rotations.matrices(pose[k] * axis_of(arm, k))
            at = at.copy()
            at[3:, k] += axes @ axis_of(arm, k)
            self.add_body(at, axes, 0.0, arm.elbow(k).inertia_right if k else arm.hub_inertia)
            if isinstance(link, RigidLink):
                self.add_body(moved(at, axes @ np.array(link.centre)), axes, link.mass, link.inertia)
                at = moved(at, link.length * axes @ X)
            else:
                at = self.add_link(link, at, axes, count, first)
                first += 6 * count
        payload = arm.payload
        offset = np.array([*payload.offset, 0.0])[:3]
        self.add_body(moved(at, axes @ offset), axes, payload.mass, payload.inertia)
        self.tip = at[:3]

    def add_body(self, at: Array, axes: Array, mass: float, inertia: Inertia) -> None:
        """Add a rigid body centered at a section to M.

        at: map (6, n) from the coordinates to the section's displacement and rotation. axes: axes of the section. mass:
        mass of the body, kg. inertia: inertia of the body, kg m^2, in the section's axes.
        """
        self.M += mass * at[:3].T @ at[:3] + at[3:].T @ (axes @ tensor(inertia) @ axes.T) @ at[3:]

    def add_link(self, link: Link, at: Array, axes: Array, count: int, first: int) -> Array:
        """Add a beam and its rigid ends to M, C and K; return the map (6, n) of the joint at the beam's far end.

        count: number of elements along the beam. at: map (6, n) of the joint at the link's root. axes: unit vectors of
        the link's axes, in inertial axes. first: index of the link's first coordinate.
        """
        root = moved(at, link.root_offset * axes @ X)
        self.add_body(moved(at, 0.5 * link.root_offset * axes @ X), axes, link.root_mass, link.root_inertia)
        at, ends = root, link.mesh(count, "elements")
        # an element's matrices are in the link's axes: rotate displacements and rotations of both ends
        whole = np.kron(np.eye(4), axes.T)
        tau_d = self.arm.tau_d if link.tau_d is None else link.tau_d
        for e in range(count):
            beyond = np.zeros((6, self.n))
            beyond[:, first + 6 * e : first + 6 * (e + 1)] = np.eye(6)
            mass, stiffness = element(link, float(ends[e]), float(ends[e + 1]))
            both = whole @ np.vstack([at, beyond])
            self.M += both.T @ mass @ both
            strained = both.T @ stiffness @ both
            self.K += strained
            # Kelvin-Voigt damping: C = tau_d K
            self.C += tau_d * strained
            at = beyond
        self.bend.append(axes.T @ (at[3:] - root[3:]))
        self.add_body(moved(at, 0.5 * link.tip_offset * axes @ X), axes, link.tip_mass, link.tip_inertia)
        return moved(at, link.tip_offset * axes @ X)


def moved(at: Array, way: Array) -> Array:
    """Return the matrix (6, n) from the coordinates to displacement and rotation of a point fixed to a section.

    at (6, n): matrix from the coordinates to displacement and rotation of the section. way (3,): vector from the
    section to the point, m, inertial axes.
    """
    found = at.copy()
    # displacement u + theta x way
    found[:3] -= rotations.skew(way) @ at[3:]
    return found


def element(link: Link, start: float, end: float) -> tuple[Array, Array]:
    """Return mass and stiffness (12, 12) of a straight beam element from `start` to `end` (m), in the link's axes.

    Rows: displacement (m) and rotation (rad) of the section at `start`, then of the section at `end`. Bending is cubic
    in both planes; stretch and twist are linear. The integrals are computed with four Gauss points.
    """
    length, (x, weights) = end - start, POINTS
    z, share = 0.5 * (x + 1.0), 0.5 * length * weights
    s = start + length * z
    plane, across = link.along(s), link.across(s)
    mass, stiffness = np.zeros((12, 12)), np.zeros((12, 12))
    # Hermite functions of (v, v') at both ends, and their second derivatives by s
    cubic = np.stack(
        [1 - 3 * z**2 + 2 * z**3, length * (z - 2 * z**2 + z**3), 3 * z**2 - 2 * z**3, length * (z**3 - z**2)]
    )
    curved = np.stack([12 * z - 6, length * (6 * z - 4), 6 - 12 * z, length * (6 * z - 2)]) / length**2
    # bending in the x-y and the x-z plane; a rotation about y is minus the slope along z
    for rows, EI, sign in ((BENDING_Y, plane.EI, 1.0), (BENDING_Z, across["EI_y"], -1.0)):
        signs = np.array([[1.0], [sign], [1.0], [sign]])
        place = np.ix_(rows, rows)
        mass[place] += (signs * cubic * share * plane.m) @ (signs * cubic).T
        stiffness[place] += (signs * curved * share * EI) @ (signs * curved).T
    # stretch (EA, m) and torsion (GJ, polar inertia J + J_y)
    linear, slope = np.stack([1.0 - z, z]), np.array([[-1.0], [1.0]]) / length * np.ones(len(z))
    for i, own, stiff in ((0, plane.m, plane.EA), (3, plane.J + across["J_y"], across["GJ"])):
        place = np.ix_([i, i + 6], [i, i + 6])
        mass[place] += (linear * share * own) @ linear.T
        stiffness[place] += (slope * share * stiff) @ slope.T
    return mass, stiffness


def of_space(
    arm: Arm, elements: int, pose: Array, settings: Settings | None = None, h: float = 0.0, stiffness: float = 1.0
) -> Motion:
    """Return the linear model of an arm in space about joint angles `pose` (N,), rad, in the arm's lowest modes.

    elements: number of elements per link. settings: the integrator's settings; None for the continuous equations. h:
    step of the integrator, s. stiffness: factor on EI, EI_y and GJ of all links.
    """
    made = _Assembly(arm, elements, pose)
    made.K *= stiffness
    made.C *= stiffness
    squares, shapes = vibrations(made.M, made.K)
    squares, shapes = squares[:KEPT], shapes[:, :KEPT]
    # turns of the joints are rigid; round-off would give them a frequency
    squares[: arm.n_links] = 0.0
    K, M = np.diag(squares), np.eye(len(squares))
    # trapezoidal steps with S have the scheme's period error, of which kappa = 1/12 is their own
    S = M if settings is None else M + 2.0 * (settings.period_error - 1.0 / 12.0) * h * h * K
    bend = np.vstack(made.bend) if made.bend else np.zeros((0, made.n))
    B = shapes[: arm.n_links].T.copy()
    return Motion(M, shapes.T @ made.C @ shapes, K, S.copy(), B, made.tip @ shapes, bend @ shapes).jointed(arm)


def poses_in_space(n_links: int) -> list[Array]:
    """Return two postures of small motions, straight and with elbows at 1.2 rad, as joint angles (N,), rad."""
    return [np.zeros(n_links)] if n_links == 1 else [np.zeros(n_links), np.array([0.0, *[1.2] * (n_links - 1)])]
