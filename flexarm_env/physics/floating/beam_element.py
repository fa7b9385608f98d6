"""The paper's two-node planar Timoshenko element: shape functions [41], stiffness [44], [45], mass [52].

The nodal coordinates are (u1, v1, phi1, u2, v2, phi2) in the body frame (m, m, rad). The element has length l (m) and
shear factor mu = 1 / (1 + 12 EI / (C l^2)). mu = 1 is the Euler-Bernoulli element (theory, section 1).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ...parameters import Link, Section

Array = NDArray[np.float64]

BENDING = np.array([1, 2, 4, 5])
"""Indices of the bending coordinates v1, phi1, v2, phi2 among an element's six coordinates."""

_GAUSS_X, _GAUSS_W = np.polynomial.legendre.leggauss(4)
QUADRATURE = (0.5 * (1.0 + _GAUSS_X), 0.5 * _GAUSS_W)
"""Gauss points xi in (0, 1) and their weights. Four points integrate every product of shape functions exactly."""


FINER = np.polynomial.legendre.leggauss(8)
"""Gauss points in (-1, 1) and weights for each smooth piece of an element whose section varies."""


@dataclass(frozen=True)
class Element:
    """A piece of a link as one finite element.

    link: the piece as a `Link`.
    start: distance of the piece's start from the body's root, m.
    number: index of the element in a mesh of equal elements, otherwise None. If sections vary, the shape functions are
    those of the mean section, while the stiffness and the mass matrix are integrals over the actual sections.
    """

    link: Link
    number: int | None
    start: float

    @property
    def length(self) -> float:
        """Return the length l of the element, m."""
        return self.link.length

    @cached_property
    def section(self) -> Section:
        """Return the section of the element; if sections vary, return the mean section."""
        return self.link.mean

    @cached_property
    def mu(self) -> float:
        """Return the dimensionless shear factor mu of the shape functions."""
        return shear_factor(self.section, self.length)

    @cached_property
    def points(self) -> list[tuple[float, float, Section]]:
        """Return quadrature points xi in (0, 1), their weights (sum 1) and the sections at these points."""
        if self.link.uniform is not None:
            return [(x, weight, self.link.uniform) for x, weight in zip(*QUADRATURE, strict=True)]
        # Gauss points piece by piece, because EI, m jump between pieces and no rule is exact across a jump
        x, weights = FINER
        ends = np.array(self.link.points)
        half = 0.5 * np.diff(ends)[:, None]
        s = (ends[:-1, None] + half * (1.0 + x)).ravel()
        values = np.array(self.link.along(s)).T
        shares = (half * weights).ravel() / self.length
        return [(a / self.length, b, Section(*map(float, c))) for a, b, c in zip(s, shares, values, strict=True)]

    def at(self, xi: float) -> float:
        """Return the distance x (m) from the body's root to the element's point xi in (0, 1)."""
        return self.start + xi * self.length if self.number is None else (self.number + xi) * self.length

    def shapes(self, xi: float) -> Array:
        """Return the element's shape functions of u, v and phi at xi, shape (3, 6) (`shape_functions`)."""
        return shape_functions(xi, self.length, self.mu)

    def stiffness(self) -> Array:
        """Return the axial and bending stiffness (6, 6), equation [44]; if the section varies, its integral."""
        if self.link.uniform is not None:
            return linear_stiffness(self.link.uniform, self.length)
        l, total = self.length, np.zeros((6, 6))
        # strains by nodal coordinates: shear v' - phi, which is constant in the element, and stretch u'
        gamma = (self.mu - 1.0) * np.array([0.0, 1.0 / l, 0.5, 0.0, -1.0 / l, 0.5])  # v' - phi
        stretch = np.array([-1.0, 0.0, 0.0, 1.0, 0.0, 0.0]) / l
        # K = sum over quadrature points of EI phi'^T phi' + C gamma^T gamma + EA u'^T u'
        for xi, weight, at in self.points:
            for stiffness, strain in ((at.EI, self.bend(xi)), (at.C, gamma), (at.EA, stretch)):
                total += weight * l * stiffness * np.outer(strain, strain)
        return total

    def bend(self, xi: float) -> Array:
        """Return the curvature's shape functions phi' at xi, (6,), 1/m."""
        # derivative of the phi row of eq. [41] by x
        l, b = self.length, 3.0 * self.mu
        a = 6.0 * self.mu * (1.0 - 2.0 * xi) / l**2
        return np.array([0.0, -a, (-1.0 - b + 2.0 * b * xi) / l, 0.0, a, (1.0 - b + 2.0 * b * xi) / l])

    def mass(self) -> Array:
        """Return the consistent mass matrix (6, 6) with rotary inertia, equation [52]."""
        mass = np.zeros((6, 6))
        for xi, weight, at in self.points:
            n_u, n_v, n_phi = self.shapes(xi)
            # int m (N_u'N_u + N_v'N_v) + J N_phi'N_phi dx
            translational = np.outer(n_u, n_u) + np.outer(n_v, n_v)
            mass += weight * self.length * (at.m * translational + at.J * np.outer(n_phi, n_phi))
        return mass


def mesh(link: Link, n: int, option: str) -> list[Element]:
    """Divide a link, or a piece of a link, into n elements from root to tip; elements end where sections jump.

    option: name of the setting that determines n, such as "segments", for the message of a ValueError.
    """
    if link.uniform is not None:
        l = link.length / n
        return [Element(Link(l, link.uniform), e, e * l) for e in range(n)]
    parts = link.cut(n, option)
    starts = np.cumsum([0.0] + [part.length for part in parts])
    return [Element(part, None, float(start)) for part, start in zip(parts, starts[:-1], strict=True)]


def shear_factor(section: Section, length: float) -> float:
    """Return the dimensionless shear factor mu = 1 / (1 + 12 EI / (C l^2)) of equation [41]."""
    return float(1.0 / (1.0 + 12.0 * section.EI / (section.C * length**2)))


def shape_functions(xi: float, length: float, mu: float) -> Array:
    """Return the shape functions of u, v (m, along and across the element's axis) and phi (rad) at xi = x/l: (3, 6).

    The columns are for u1, v1, phi1, u2, v2, phi2.
    length: length l of the element, m.
    mu: shear factor 1 / (1 + 12 EI / (C l^2)); 1 without shear. The functions are equation [41] of the paper.
    """
    eta, half = 1.0 - xi, 0.5 * length
    return np.array(
        [
            [eta, 0, 0, xi, 0, 0],
            [
                0, eta * (1 + mu * xi * (eta - xi)), half * xi * eta * (1 + mu * (eta - xi)),
                0, xi * (1 - mu * eta * (eta - xi)), -half * xi * eta * (1 - mu * (eta - xi)),
            ],
            [
                0, -6 * mu * xi * eta / length, eta * (1 - 3 * mu * xi),
                0, 6 * mu * xi * eta / length, xi * (1 - 3 * mu * eta),
            ],
        ]
    )  # fmt: skip


def linear_stiffness(section: Section, length: float) -> Array:
    """Return the axial and bending stiffness, equation [44], on (u1, v1, phi1, u2, v2, phi2), shape (6, 6)."""
    mu, l = shear_factor(section, length), length
    stiffness = np.zeros((6, 6))
    # EA/l on (u_1, u_2), eq. [44]
    stiffness[np.ix_([0, 3], [0, 3])] = section.EA / l * np.array([[1, -1], [-1, 1]])
    a, b = 12 * mu / l**2, 6 * mu / l
    # bending with shear: EI/l on (v1, phi1, v2, phi2)
    stiffness[np.ix_(BENDING, BENDING)] = (section.EI / l) * np.array(
        [[a, b, -a, b], [b, 1 + 3 * mu, -b, 3 * mu - 1], [-a, -b, a, -b], [b, 3 * mu - 1, -b, 1 + 3 * mu]]
    )
    return stiffness


def geometric_matrix(section: Section, length: float) -> Array:
    """Return G (4, 4), 1/m, of the geometric stiffness P G [45]: w'Gw = int v'^2 dx with w = (v1, phi1, v2, phi2)."""
    mu, l = shear_factor(section, length), length
    a, b = 60 + 12 * mu**2, 6 * mu**2 * l
    c, d = (5 + 3 * mu**2) * l**2, (-5 + 3 * mu**2) * l**2
    return np.array([[a, b, -a, b], [b, c, -b, d], [-a, -b, a, -b], [b, d, -b, c]]) / (60 * l)


def coupling_matrix(section: Section, length: float) -> Array:
    """Return H (4, 4), 1/m, of von Karman's energy EA / 2l (u2 - u1 + w'Hw / 2)^2 on w = (v1, phi1, v2, phi2).

        w'Hw = int v'^2 - gamma^2 - 2 (Q / EA) phi dx                                  (theory, eq. 1.2)

    The energy's derivative is the exact beam's force along the frame. The exact beam's stretch, along the normal of the
    section, is u' + phi v' - phi^2 / 2 to second order. The exact beam's shear force Q = C gamma rotates with the
    section, which subtracts Q phi from the axial force. The shear strain gamma = v' - phi is constant in the element.
    The matrix G of [45] would measure the stretch along the tangent instead, with an error of gamma^2 / 2 on any mesh.
    """
    mu, l = shear_factor(section, length), length
    # Q, gamma and the mean of phi over the element, as rows on w
    shear_force = 12.0 * mu * section.EI / l**2 * np.array([-1.0 / l, -0.5, 1.0 / l, -0.5])
    gamma = shear_force / section.C
    mean_phi = np.array([-mu / l, 0.5 * (1.0 - mu), mu / l, 0.5 * (1.0 - mu)])
    # int Q phi / EA dx as a bilinear form
    turned = np.outer(shear_force / section.EA, mean_phi)
    return geometric_matrix(section, l) - l * (np.outer(gamma, gamma) + turned + turned.T)
