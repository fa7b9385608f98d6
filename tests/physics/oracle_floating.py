"""Floating-frame chains of another derivation: Lagrange's equations from energies by quadrature, by complex step.

Nothing here uses the package's mechanics. Shape functions come from the beam's differential equations, solved for each
element's end values; energies are integrals over the fields r(x) and phi(x); the mass matrix is built from the fields'
Jacobians, and its derivatives are complex steps (1e-30, exact to round-off). Rows and order are the package's.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexarm_env.scene import PointLoad, Scene

Array = NDArray[Any]
STEP = 1e-30
POINTS, WEIGHTS = np.polynomial.legendre.leggauss(6)


def element_fields(EI: float, C: float, length: float, xi: float) -> tuple[Array, Array, Array, Array, Array]:
    """Rows over (u1, v1, phi1, u2, v2, phi2): u, v, phi, v', phi' at x = xi length.

    v is a cubic and phi = v' + (EI/C) v''' (moment balance EI phi'' = C (phi - v')), fitted to the end values.
    """

    def cubic(x: float) -> tuple[Array, Array, Array, Array]:
        v = np.array([1.0, x, x**2, x**3])
        slope = np.array([0.0, 1.0, 2 * x, 3 * x**2])
        third = np.array([0.0, 0.0, 0.0, 6.0])
        phi = slope + EI / C * third
        return v, phi, slope, np.array([0.0, 0.0, 2.0, 6 * x])

    ends = np.array([cubic(0.0)[0], cubic(0.0)[1], cubic(length)[0], cubic(length)[1]])
    coefficients = np.linalg.inv(ends)
    u = np.array([1.0 - xi, 0.0, 0.0, xi, 0.0, 0.0])
    rows = [u]
    for row in cubic(xi * length):
        full = np.zeros(6)
        full[[1, 2, 4, 5]] = row @ coefficients
        rows.append(full)
    return rows[0], rows[1], rows[2], rows[3], rows[4]


@dataclass
class Place:
    """A point of a body: its x, and rows of u, v, phi, v', phi' over the body's elastic coordinates."""

    x: float
    rows: Array  # (5, n)


class Oracle:
    """The chain of a scene, `segments` bodies a link of `elements` each; coupling as in the package."""

    def __init__(self, scene: Scene, segments: int, elements: int, coupling: str) -> None:
        self.scene, self.coupling, self.segments, self.elements = scene, coupling, segments, elements
        self.links = [k for k in range(scene.arm.n_links) for _ in range(segments)]
        self.n_elastic = 3 * elements
        self.starts, self.rows = [], []
        row = 0
        for b in range(len(self.links)):
            joint = None if b + 1 == len(self.links) else self.links[b + 1]
            free = joint is not None and joint != self.links[b] and joint not in scene.rigid_joints
            multipliers = 0 if joint is None else 2 if free else 3
            self.starts.append(row)
            self.rows.append(multipliers)
            row += 3 + self.n_elastic + multipliers
        self.n = row
        self.quadrature: list[list[list[tuple[Place, float]]]] = []  # by body, by element: places and weights dx
        self.tips: list[Place] = []
        self.lengths = [scene.arm.links[k].length / segments for k in self.links]
        for b, k in enumerate(self.links):
            s, length = scene.arm.links[k].section, self.lengths[b] / elements
            per_element = []
            for e in range(elements):
                places = []
                for point, weight in zip(POINTS, WEIGHTS, strict=True):
                    xi = 0.5 * (1.0 + point)
                    fields = element_fields(s.EI, s.C, length, xi)
                    places.append((self._place(e, (e + xi) * length, fields), 0.5 * weight * length))
                per_element.append(places)
            self.quadrature.append(per_element)
            self.tips.append(self._place(elements - 1, elements * length, element_fields(s.EI, s.C, length, 1.0)))

    def _place(self, element: int, x: float, fields: tuple[Array, ...]) -> Place:
        full = np.zeros((5, 3 + self.n_elastic))
        full[:, 3 * element : 3 * element + 6] = np.array(fields)
        return Place(x, full[:, 3:])  # the first node is the frame's

    # ------------------------------------------------------------------ fields
    def position(self, body: int, place: Place, q: Array) -> Array:
        """x, y, angle of a section."""
        at = self.starts[body]
        e = q[at + 3 : at + 3 + self.n_elastic]
        c, s = np.cos(q[at + 2]), np.sin(q[at + 2])
        x, y = place.x + place.rows[0] @ e, place.rows[1] @ e
        return np.array([q[at] + c * x - s * y, q[at + 1] + s * x + c * y, q[at + 2] + place.rows[2] @ e])

    def jacobian(self, body: int, place: Place, q: Array) -> Array:
        """Derivative of `position` with respect to all coordinates, (3, n)."""
        at = self.starts[body]
        e = slice(at + 3, at + 3 + self.n_elastic)
        c, s = np.cos(q[at + 2]), np.sin(q[at + 2])
        x, y = place.x + place.rows[0] @ q[e], place.rows[1] @ q[e]
        result = np.zeros((3, self.n), dtype=q.dtype)
        result[0, at] = result[1, at + 1] = result[2, at + 2] = 1.0
        result[0, at + 2], result[1, at + 2] = -s * x - c * y, c * x - s * y
        result[0, e] = c * place.rows[0] - s * place.rows[1]
        result[1, e] = s * place.rows[0] + c * place.rows[1]
        result[2, e] = place.rows[2]
        return result

    def masses(self) -> list[tuple[int, Place, float, float]]:
        """Everything that has inertia: body, place, mass (kg), rotary inertia (kg m^2)."""
        arm, found = self.scene.arm, []
        root = Place(0.0, np.zeros((5, self.n_elastic)))
        for b, k in enumerate(self.links):
            section = arm.links[k].section
            for places in self.quadrature[b]:
                found += [(b, place, section.m * dx, section.J * dx) for place, dx in places]
            if b == 0:
                found.append((b, root, 0.0, arm.hub_inertia))
            elif self.links[b - 1] != k:
                elbow = arm.elbow(k)
                found.append((b - 1, self.tips[b - 1], elbow.mass, elbow.inertia_left))
                found.append((b, root, 0.0, elbow.inertia_right))
        found.append((len(self.links) - 1, self.tips[-1], arm.payload.mass, arm.payload.inertia))
        return found

    def mass_matrix(self, q: Array) -> Array:
        """Hessian of the kinetic energy with respect to the velocities."""
        total = np.zeros((self.n, self.n), dtype=q.dtype)
        for b, place, mass, inertia in self.masses():
            j = self.jacobian(b, place, q)
            total += j.T @ (np.array([mass, mass, inertia])[:, None] * j)
        return total

    # ---------------------------------------------------------------- energies
    def strain(self, q: Array) -> Any:
        """Bending, shear, and the stretch of each element's average, with the deflection's foreshortening."""
        total: Any = 0.0
        for b, k in enumerate(self.links):
            section, at = self.scene.arm.links[k].section, self.starts[b]
            e = q[at + 3 : at + 3 + self.n_elastic]
            for places in self.quadrature[b]:
                stretch, length = self._stretch(k, places, e)
                total += 0.5 * section.EA / length * stretch**2
                for place, dx in places:
                    _, _, phi, slope, curvature = place.rows @ e
                    total += 0.5 * dx * (section.EI * curvature**2 + section.C * (slope - phi) ** 2)
        return total

    def _stretch(self, link: int, places: list[tuple[Place, float]], e: Array) -> tuple[Any, float]:
        """Length of an element, and its axial force along the frame times length / EA.

        The exact beam's is N cos phi - Q sin phi, N = EA (cos phi (1 + u') + sin phi v' - 1), Q = C (v' - phi) to first
        order: EA (u' + phi v' - phi^2 / 2) - Q phi to second.
        """
        length = sum(dx for _, dx in places)
        # u is linear, so that two points tell the elongation
        (first, _), (last, _) = places[0], places[-1]
        stretch = (last.rows[0] - first.rows[0]) @ e * length / (last.x - first.x)
        if self.coupling == "von_karman":
            ratio = self.scene.arm.links[link].section.C / self.scene.arm.links[link].section.EA
            for place, dx in places:
                _, _, phi, slope, _ = place.rows @ e
                stretch = stretch + dx * (phi * slope - 0.5 * phi**2 - ratio * (slope - phi) * phi)
        return stretch, length

    def gravity(self, q: Array) -> Any:
        """Potential of the weight."""
        g = self.scene.gravity or (0.0, 0.0)
        return -sum(m * (np.array(g) @ self.position(b, place, q)[:2]) for b, place, m, _ in self.masses())

    def kinetic(self, q: Array, v: Array) -> Any:
        """Kinetic energy."""
        return 0.5 * v @ self.mass_matrix(q) @ v

    # ---------------------------------------------------------------- equations
    def constraints(self, q: Array) -> tuple[list[int], Array]:
        """Rows of the multipliers, and what they keep at zero."""
        rows, values = [], []
        for b in range(len(self.links) - 1):
            gap = self.position(b, self.tips[b], q) - q[self.starts[b + 1] : self.starts[b + 1] + 3]
            if self.links[b + 1] != self.links[b]:
                angles = self.scene.angles
                gap[2] += angles[self.links[b + 1]] - angles[self.links[b]]
            first = self.starts[b] + 3 + self.n_elastic
            rows += range(first, first + self.rows[b])
            values += list(gap[: self.rows[b]])
        return rows, np.array(values)

    def residual(self, q: Array, v: Array, a: Array, u: Array) -> Array:
        """d/dt dT/dv - dT/dq + d(U + V)/dq + Phi_q' lambda + damping - loads; constraint rows are left at zero."""
        rows, _ = self.constraints(q)
        state = q.copy()
        state[rows] = 0.0
        r = self.mass_matrix(state) @ a
        r += self.mass_matrix(state + 1j * STEP * v).imag @ v / STEP
        for k in range(self.n):
            if k in rows:
                continue
            moved = state.astype(complex)
            moved[k] += 1j * STEP
            potential = self.strain(moved) + self.gravity(moved) + q[rows] @ self.constraints(moved)[1]
            r[k] += (potential - 0.5 * v @ self.mass_matrix(moved) @ v).imag / STEP
        r += self._damping(state, v) - self._loads(state, u)
        if self.coupling == "paper":
            r += self._paper_force(state)
        r[rows] = 0.0
        return r

    def dissipation(self, q: Array, v: Array) -> Any:
        """Rayleigh's function R(q, v): half the power that damping takes. Kelvin-Voigt: stress = D tau_d (rate of
        strain), so tau_d times the strain energy at the rates of the strains, the stretch's at the posture q. Drag:
        half of mass_damping times the mass that moves relative to its body's frame."""
        arm, total = self.scene.arm, 0.0
        for b, k in enumerate(self.links):
            section, at = arm.links[k].section, self.starts[b]
            elastic = slice(at + 3, at + 3 + self.n_elastic)
            for places in self.quadrature[b]:
                moved, length = self._stretch(self.links[b], places, q[elastic] + 1j * STEP * v[elastic])
                total += 0.5 * arm.tau_d * section.EA / length * (moved.imag / STEP) ** 2
                for place, dx in places:
                    _, _, phi, slope, curvature = place.rows @ v[elastic]
                    total += 0.5 * arm.tau_d * dx * (section.EI * curvature**2 + section.C * (slope - phi) ** 2)
        within = v.copy()
        for at in self.starts:
            within[at : at + 3] = 0.0
        return total + arm.mass_damping * self.kinetic(q, within)

    def _damping(self, q: Array, v: Array) -> Array:
        """dR/dv, exact for what is quadratic in v."""
        unit = np.eye(self.n)
        return np.array([0.5 * (self.dissipation(q, v + e) - self.dissipation(q, v - e)) for e in unit])

    def _loads(self, q: Array, u: Array) -> Array:
        """Generalised forces of joint torques and point loads, by virtual work."""
        r = np.zeros(self.n)
        for k in range(self.scene.arm.n_links):
            first = self.links.index(k)
            r[self.starts[first] + 2] += u[k]
            if k:
                r -= u[k] * self.jacobian(first - 1, self.tips[first - 1], q)[2].real
        entry = self.scene.arm.n_links
        for load in [item for item in self.scene.loads if isinstance(item, PointLoad)]:
            last = len(self.links) - 1 - self.links[::-1].index(load.link)
            first = self.links.index(load.link)
            root = Place(0.0, np.zeros((5, self.n_elastic)))
            body, place = (first, root) if load.end == "root" else (last, self.tips[last])
            r += u[entry : entry + 3] @ self.jacobian(body, place, q).real
            entry += 3
        return r

    def _paper_force(self, q: Array) -> Array:
        """P G w on the bending coordinates alone, P = EA (u2 - u1) / l."""
        r = np.zeros(self.n)
        for b, k in enumerate(self.links):
            section, at = self.scene.arm.links[k].section, self.starts[b]
            e = q[at + 3 : at + 3 + self.n_elastic]
            for places in self.quadrature[b]:
                stretch, length = self._stretch(k, places, e)
                for place, dx in places:
                    slope = place.rows[3]
                    r[at + 3 : at + 3 + self.n_elastic] += section.EA / length * stretch * dx * (slope @ e) * slope
        return r
