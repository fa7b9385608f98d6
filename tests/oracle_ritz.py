"""Frequencies of planar arms from their energies alone, by Ritz's method: a link's angle moves by polynomials."""

from typing import Any

import numpy as np
from numpy.polynomial import Legendre
from scipy.integrate import cumulative_trapezoid
from scipy.linalg import eigh

from flexarm_env import curves
from flexarm_env.parameters import Arm, Joint

SHAPES = 12
"""Polynomials of a link."""


def ritz_frequencies(arm: Arm, count: int, hinged: bool = False) -> Any:
    """rad/s, of small motions in the plane about the shape without stress, without stretch; joints are free, or held
    (elastic gears by their motors)."""
    gears = arm.joints or (Joint(),) * arm.n_links
    elastic = sum(gear.elastic for gear in gears)
    size = arm.n_links * SHAPES + elastic + (arm.n_links if hinged else 0)
    M, K, unit = np.zeros((size, size)), np.zeros((size, size)), np.eye(size)

    def add(mass: Any, inertia: Any, moved: Any, turned: Any) -> None:
        """Bodies, by rows that say how they move (complex numbers) and turn with each coordinate."""
        M[:] += ((moved.T * mass) @ moved.conj()).real + (turned.T * inertia) @ turned

    x, weights = np.polynomial.legendre.leggauss(40)
    still, free = np.zeros((1, size)), iter(unit[arm.n_links * SHAPES :, None])
    joint, turn, way = 0j * still, still, 1.0 + 0.0j
    for k, (link, gear) in enumerate(zip(arm.links, gears, strict=True)):
        before = turn
        if hinged or gear.elastic:  # else a link's root turns with the tip before it
            turn = next(free)
        if gear.elastic:
            motor = next(free) if hinged else still
            add(0.0, gear.motor_inertia * gear.gear_ratio**2, still, motor)
            K += gear.stiffness * (turn - before - motor).T @ (turn - before - motor)
        add(0.0, arm.hub_inertia if k == 0 else arm.elbow(k).inertia_right, joint, turn)
        root = joint + 1j * link.root_offset * way * turn
        add(link.root_mass, link.root_inertia, 0.5 * (joint + root), turn)
        ends, L = np.array(link.points), link.length
        half = 0.5 * np.diff(ends)[:, None]
        s, w = np.append(ends[:-1, None] + half * (1.0 + x), L), np.append(half * weights, 0.0)
        basis = [Legendre([1.0]), *(Legendre.basis(j, [0.0, L]).integ(lbnd=0.0) for j in range(SHAPES))]
        fine = np.linspace(0.0, L, 4001)
        tangent = way * np.exp(1j * curves.angle(link.curvature, fine))
        paths = [cumulative_trapezoid(1j * f(fine) * tangent, fine, initial=0.0) for f in basis]
        rows = np.vstack([turn, unit[k * SHAPES : (k + 1) * SHAPES]])
        moved = root + np.array([np.interp(s, fine, path) for path in paths]).T @ rows
        turned, bent = (np.array(values).T @ rows for values in ([f(s) for f in basis], [f.deriv()(s) for f in basis]))
        sections = link.along(s)
        add(w * sections.m, w * sections.J, moved, turned)
        K += (bent.T * (w * sections.EI)) @ bent
        turn, way = turned[-1:], way * np.exp(1j * link.turn)
        joint = moved[-1:] + 1j * link.tip_offset * way * turn
        add(link.tip_mass, link.tip_inertia, 0.5 * (moved[-1:] + joint), turn)
        if k + 1 < arm.n_links:
            add(arm.elbow(k + 1).mass, arm.elbow(k + 1).inertia_left, joint, turn)
    add(arm.payload.mass, arm.payload.inertia, joint + 1j * complex(*arm.payload.offset[:2]) * way * turn, turn)
    return np.sqrt(np.abs(eigh(K, M, eigvals_only=True)))[arm.n_links if hinged else 0 :][:count]
