"""Natural frequencies and tip compliance of a chain for small motions about its stress-free posture."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from flexarm_env.sections import GAUSS
from flexarm_env.validation import Array

from .chain import Chain, chain_of


class Posture(NamedTuple):
    """Geometry of a chain with all hinge angles 0, in the ground's axes.

    anchors (h, 3): a point on each hinge's axis, m. axes (h, 3): directions of the hinges. frames (n, 3, 3), origins
    (n, 3), m: axes and origins of the bodies' frames. body_of (h,): index of each hinge's body. tip (3,): position of
    the tip, m.
    """

    anchors: Array
    axes: Array
    frames: Array
    origins: Array
    body_of: list[int]
    tip: Array


def posture(chain: Chain) -> Posture:
    """Compute the positions of all bodies with the hinge angles at 0."""
    R, origin = np.eye(3), np.zeros(3)
    anchors, axes, frames, origins, body_of = [], [], [], [], []
    for i, body in enumerate(chain.bodies):
        origin, R = origin + R @ body.position, R @ body.rotation
        frames.append(R)
        origins.append(origin)
        for hinge in body.hinges:
            anchors.append(origin)
            axes.append(R @ hinge.axis)
            body_of.append(i)
    tip = origin + R @ chain.tip
    return Posture(np.array(anchors), np.array(axes), np.array(frames), np.array(origins), body_of, tip)


def mass_matrix(chain: Chain) -> Array:
    """Return the mass matrix (h, h), kg m^2, of a chain with h hinges at hinge angles 0; armature is included."""
    at = posture(chain)
    M = np.diag([hinge.armature for hinge in chain.hinges])
    for i, body in enumerate(chain.bodies):
        R, centre = at.frames[i], at.origins[i] + at.frames[i] @ body.centre
        moved = np.array([j <= i for j in at.body_of])[:, None]
        # Jacobians of the center of mass and of the rotation
        turning = np.where(moved, at.axes, 0.0)
        moving = np.cross(turning, centre - at.anchors)
        M += body.mass * moving @ moving.T + turning @ R @ body.inertia @ R.T @ turning.T
    return M


def chain_modes(chain: Chain, clamped: bool = True) -> tuple[Array, Array]:
    """Return natural frequencies (Hz, ascending) and damping ratios of a chain about its stress-free posture.

    clamped: True if the joints are held (with an elastic gear, the motors). If False, the joints turn freely, and the
    zero frequencies of rigid motions are omitted. The damping ratios assume that the modes are those of the undamped
    chain.
    """
    hinges = chain.hinges
    kept = [i for i, hinge in enumerate(hinges) if not (clamped and hinge.driven)]
    if not kept or not any(hinges[i].stiffness for i in kept):
        return np.zeros(0), np.zeros(0)
    M = mass_matrix(chain)[np.ix_(kept, kept)]
    K, C = (np.diag([getattr(hinges[i], name) for i in kept]) for name in ("stiffness", "damping"))
    k = np.diag(K)
    if k.min() > 0.0:
        # K x = w^2 M x as K^-1/2 M K^-1/2 y = y / w^2: the lowest frequencies are its largest eigenvalues, to round-off
        root = 1.0 / np.sqrt(k)
        inverse, y = np.linalg.eigh(root[:, None] * M * root)
        # eigenvalues below round-off of the largest are frequencies that double precision does not resolve
        kept_modes = inverse > 1e-15 * inverse[-1]
        omega, x = 1.0 / np.sqrt(inverse[kept_modes][::-1]), (root[:, None] * y[:, kept_modes])[:, ::-1]
        # y^T y = x^T K x = 1: damping ratio (x^T C x / x^T K x) w / 2
        return omega / (2.0 * np.pi), 0.5 * omega * np.einsum("ik,ij,jk->k", x, C, x)
    # M = L L^T: K x = w^2 M x becomes the symmetric L^-1 K L^-T y = w^2 y
    L = np.linalg.inv(np.linalg.cholesky(M))
    squares, y = np.linalg.eigh(L @ K @ L.T)
    omega = np.sqrt(np.maximum(squares, 0.0))
    flexible = omega > 1e-5 * omega.max()
    x = (L.T @ y)[:, flexible]
    omega = omega[flexible]
    ratios = np.einsum("ik,ij,jk->k", x, C, x) / (2.0 * omega)
    return omega / (2.0 * np.pi), ratios


def tip_compliance(chain: Chain) -> Array:
    """Return the matrix (3, 3) of the tip's displacement per tip force, m/N, in the ground's axes, with held joints.

    The chain is in its stress-free posture. The matrix is the sum of (axis x lever) (axis x lever)^T / k over all
    springs; the lever is the vector from the spring to the tip.
    """
    at, hinges = posture(chain), chain.hinges
    levers = np.cross(at.axes, at.tip - at.anchors)
    give = np.array([1.0 / hinge.stiffness if hinge.stiffness else 0.0 for hinge in hinges])
    return np.asarray(np.einsum("h,hi,hj->ij", give, levers, levers))


def exact_compliance(chain: Chain) -> Array:
    """Return the matrix of `tip_compliance`, m/N, for the arm that the chain approximates.

    Bending and torsion are integrated with 16 Gauss points in each interval of a link with smooth EI.
    """
    arm = chain.arm
    pieces = max((len(link.breaks) - 1 for link in arm.links if not link.rigid), default=1)
    return tip_compliance(chain_of(arm, len(GAUSS[0]) * pieces))
