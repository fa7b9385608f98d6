"""Chains of floating frames, derived otherwise: energies by quadrature (`oracle_lagrange.py`).

Nothing here uses the package's mechanics. The frame of a body (`oracle_bodies.py`) stands at theta_root - rho'p.
Kinetic energy, potentials and Rayleigh's function are sums over its points.
"""

import itertools
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from flexarm_env.scene import PointLoad, Scene
from tests.oracle_lagrange import STEP, Lagrange
from tests.physics.oracle_bodies import QUADRATURE, Body, Points, averaged, finite_elements, form, mesh_points, modal

Array = NDArray[Any]


class Motion(NamedTuple):
    """Of one body: root X (..., 2), its rate, the frame's angle and rate, elastic coordinates and rates."""

    X: Array
    X_rate: Array
    angle: Array
    rate: Array
    p: Array
    p_rate: Array


class Chain(Lagrange):
    """The oracle of a scene: `segments` bodies a link, of `elements` each or reduced to `modes`.

    Coordinates are the root's, each body's p, and the elbows' angles. Joined by multipliers (`joined`) each body has
    its frame's x, y, angle, then p, then the multipliers of the joint behind it: 2 of a hinge, 3 of a rigid joint.

    Reduced to modes, what a body's own mass and an elbow's have of third and higher order in p within their frame is
    left out of the kinetic energy (theory, 2.3 and section 4); the payload moves exactly.
    """

    def __init__(
        self,
        scene: Scene,
        segments: int,
        elements: int = 1,
        *,
        frame: str = "root",
        coupling: str = "von_karman",
        modes: int | None = None,
        stiffness: float = 1.0,
        joined: bool = False,
    ) -> None:
        self.scene, self.arm, self.coupling, self.frame = scene, scene.arm, coupling, frame
        self.modes, self.stiffness, self.joined = modes, stiffness, joined
        self.bodies: list[Body] = []
        for k, link in enumerate(scene.arm.links):
            part = link.length / segments
            for i in range(segments):
                if modes is None:
                    self.bodies.append(finite_elements(k, link.section, part, elements, frame))
                else:
                    load = self._carried(k, part * (segments - 1 - i))
                    self.bodies.append(modal(k, link.section, part, modes, frame, load, segments == 1))
        self.starts, at = [], 0 if joined else 3
        self.multipliers: list[int] = []  # their rows
        for body, following in itertools.zip_longest(self.bodies, self.bodies[1:]):
            self.starts.append(at + 3 if joined else at)
            at = self.starts[-1] + body.n
            if joined and following is not None:
                hinge = following.link != body.link and following.link not in scene.rigid_joints
                self.multipliers += range(at, at + (2 if hinge else 3))
                at += 2 if hinge else 3
        self.betas = at
        self.n = at + (0 if joined else self.arm.n_links - 1)
        self.g = np.array(scene.gravity or (0.0, 0.0))

    def _carried(self, link: int, rest: float) -> tuple[float, float]:
        """Mass and inertia about a point `rest` before the tip of a link of all that follows, straight: by points."""
        items = []  # mass, inertia, distance
        s, at = self.arm.links[link].section, rest
        items += [(s.m * rest * 0.5 * w, s.J * rest * 0.5 * w, rest * 0.5 * (1 + x)) for x, w in QUADRATURE]
        for k in range(link + 1, self.arm.n_links):
            elbow, item = self.arm.elbow(k), self.arm.links[k]
            items.append((elbow.mass, elbow.inertia_left + elbow.inertia_right, at))
            s, l = item.section, item.length
            items += [(s.m * l * 0.5 * w, s.J * l * 0.5 * w, at + l * 0.5 * (1 + x)) for x, w in QUADRATURE]
            at += l
        items.append((self.arm.payload.mass, self.arm.payload.inertia, at))
        return sum(m for m, _, _ in items), sum(j + m * d**2 for m, j, d in items)

    # ---------------------------------------------------------------- kinematics
    def motion(self, q: Array, v: Array) -> list[Motion]:
        """Of every body, root to tip."""
        found = []
        X, X_rate = q[..., :2], v[..., :2]
        angle, rate = q[..., 2], v[..., 2]  # of the root section
        for b, (body, at) in enumerate(zip(self.bodies, self.starts, strict=True)):
            if self.joined:
                X, X_rate = q[..., at - 3 : at - 1], v[..., at - 3 : at - 1]
                angle, rate = q[..., at - 1], v[..., at - 1]
            elif b and self.bodies[b - 1].link != body.link:
                beta = self.betas + body.link - 1
                angle, rate = angle + q[..., beta], rate + v[..., beta]
            p, p_rate = q[..., at : at + body.n], v[..., at : at + body.n]
            own = Motion(X, X_rate, angle - p @ body.rho, rate - p_rate @ body.rho, p, p_rate)
            found.append(own)
            (X, X_rate), (angle, rate) = (item[..., 0, :] for item in at_points(own, body.tip)), tip_turn(own, body)
        return found

    def tip(self, b: int, q: Array, v: Array) -> Array:
        """x, y, angle of a body's tip section, and their rates, (..., 6)."""
        own = self.motion(q, v)[b]
        (X, X_rate), turn = at_points(own, self.bodies[b].tip), tip_turn(own, self.bodies[b])
        return np.concatenate([X[..., 0, :], turn[0][..., None], X_rate[..., 0, :], turn[1][..., None]], axis=-1)

    def root(self, b: int, q: Array, v: Array) -> Array:
        """The same of its root section."""
        own, rho = self.motion(q, v)[b], self.bodies[b].rho
        turn, rate = own.angle + own.p @ rho, own.rate + own.p_rate @ rho
        return np.concatenate([own.X, turn[..., None], own.X_rate, rate[..., None]], axis=-1)

    def curve(self, b: int, intervals: int, q: Array) -> Array:
        """Points of a body's axis, as many to each element of its mesh."""
        body, own = self.bodies[b], self.motion(q, q)[b]
        elements = len(body.nodes) // 3 - 1
        at = np.arange(intervals // elements + 1) / (intervals // elements)
        points = mesh_points(body.section, body.length, elements, at, 0.0 * at).combined(body.nodes)
        if self.modes is not None:  # drawn through the nodes of its mesh
            points = points._replace(H=np.stack([body.node_H[:-1], body.node_H[1:]], 1).reshape(-1, body.n, body.n))
        found = at_points(own, points)[0].reshape(elements, at.size, 2)
        return np.concatenate([found[:1, 0], *found[:, 1:]])

    # ------------------------------------------------------------------ energies
    def _lumped(self) -> list[tuple[int, str, float, float, bool]]:
        """Body, its end, mass, inertia, and whether it moves exactly."""
        arm, found = self.arm, [(0, "root", 0.0, self.arm.hub_inertia, True)]
        for b in range(1, len(self.bodies)):
            k = self.bodies[b].link
            if self.bodies[b - 1].link != k:
                elbow = arm.elbow(k)
                found.append((b - 1, "tip", elbow.mass, elbow.inertia_left, False))
                found.append((b, "root", 0.0, elbow.inertia_right, True))
        found.append((len(self.bodies) - 1, "tip", arm.payload.mass, arm.payload.inertia, True))
        return found

    def kinetic(self, q: Array, v: Array) -> Array:
        """Kinetic energy."""
        motion, total = self.motion(q, v), 0.0
        for own, body in zip(motion, self.bodies, strict=True):
            s = body.section
            total = total + kinetic_energy(own, body.points, s.m * body.points.dx, s.J * body.points.dx, False)
        for b, end, mass, inertia, exactly in self._lumped():
            own, body = motion[b], self.bodies[b]
            if end == "root":
                total = total + 0.5 * inertia * (own.rate + own.p_rate @ body.rho) ** 2
            else:
                one = np.ones(1)
                total = total + kinetic_energy(own, body.tip, mass * one, inertia * one, exactly)
        return total

    def gravity(self, q: Array) -> Array:
        """Potential of the weight."""
        motion, total = self.motion(q, q), 0.0
        for own, body in zip(motion, self.bodies, strict=True):
            centre = averaged(body.points, body.points.dx / body.length)
            total = total - body.section.m * body.length * (at_points(own, centre)[0][..., 0, :] @ self.g)
        for b, end, mass, _, _ in self._lumped():
            if end == "tip":
                total = total - mass * (at_points(motion[b], self.bodies[b].tip)[0][..., 0, :] @ self.g)
        return total

    def _bending(self, body: Body, x: Array) -> Array:
        """Energy of bending and shear at strains that go with x (places or rates of p)."""
        s, points = body.section, body.points
        shear, curvature = x @ (points.slope - points.phi).T, x @ points.curvature.T
        return 0.5 * self.stiffness * (s.EI * curvature**2 + s.C * shear**2) @ points.dx

    def _stretches(self, body: Body, p: Array, rate: Array | None = None) -> list[Array]:
        """Elongation of each element along its sections' normals, or its rate at p."""
        found, length = [], body.length / max(1, len(body.elements))
        ratio = body.section.C / body.section.EA
        for own in body.elements:
            points = Points(*(None if item is None else item[own] for item in body.points))
            grow = (points.u[-1] - points.u[0]) * length / (points.x[-1] - points.x[0])  # u is linear
            x = p if rate is None else rate
            stretch = x @ grow
            if self.coupling == "von_karman":
                phi, slope = p @ points.phi.T, p @ points.slope.T
                if rate is None:
                    more = phi * slope - 0.5 * phi**2 - ratio * (slope - phi) * phi
                else:
                    phi_rate, slope_rate = rate @ points.phi.T, rate @ points.slope.T
                    more = phi_rate * slope + phi * slope_rate - phi * phi_rate
                    more = more - ratio * ((slope_rate - phi_rate) * phi + (slope - phi) * phi_rate)
                stretch = stretch + more @ points.dx
            found.append(stretch)
        return found

    def strain(self, q: Array) -> Array:
        """Strain energy."""
        total = 0.0
        for at, body in zip(self.starts, self.bodies, strict=True):
            p, l = q[..., at : at + body.n], body.length / max(1, len(body.elements))
            total = total + self._bending(body, p)
            for stretch in self._stretches(body, p):
                total = total + 0.5 * body.section.EA / l * stretch**2
        return total

    def dissipation(self, q: Array, v: Array) -> Array:
        """Rayleigh's function: Kelvin-Voigt's, and drag on what moves in its body's frame."""
        total = 0.0
        motion = self.motion(q, v)
        for own, body in zip(motion, self.bodies, strict=True):
            l = body.length / max(1, len(body.elements))
            loss = self._bending(body, own.p_rate)
            for rate in self._stretches(body, own.p, own.p_rate):
                loss = loss + 0.5 * body.section.EA / l * rate**2
            total = total + self.arm.tau_d * loss
        if self.arm.mass_damping:
            for own, body in zip(motion, self.bodies, strict=True):
                s, points = body.section, body.points
                total = total + self._drag(own, points, s.m * points.dx, s.J * points.dx, False)
            for b, end, mass, inertia, exactly in self._lumped():
                one = np.ones(1)
                if end == "root":  # it turns with the root's section, not with the frame
                    turn = (motion[b].p_rate @ self.bodies[b].rho) ** 2
                    total = total + 0.5 * self.arm.mass_damping * inertia * turn
                else:
                    total = total + self._drag(motion[b], self.bodies[b].tip, mass * one, inertia * one, exactly)
        return total

    def _drag(self, own: Motion, points: Points, mass: Array, inertia: Array, exactly: bool) -> Array:
        fast = own.p_rate @ points.u.T
        if exactly and points.H is not None:
            fast = fast - form(own.p, points.H, own.p_rate)
        squares = (fast**2 + (own.p_rate @ points.v.T) ** 2) @ mass + (own.p_rate @ points.phi.T) ** 2 @ inertia
        return 0.5 * self.arm.mass_damping * squares

    # ----------------------------------------------------------------- equations
    def potential(self, q: Array) -> Array:
        """Strain and weight."""
        return self.strain(q) + self.gravity(q)

    def residual(self, q: Array, v: Array, a: Array, u: Array) -> Array:
        """With Phi_q' lambda; rows of multipliers are left at zero."""
        r = super().residual(q, v, a, u)
        if self.coupling == "paper":
            r = r + self._paper_force(q)
        r = r + (self.gaps(q + 1j * STEP * np.eye(self.n)).imag / STEP) @ q[self.multipliers]
        r[self.multipliers] = 0.0
        return r

    def gaps(self, q: Array) -> Array:
        """What multipliers keep at zero: between each body's tip and the next one's root."""
        found = [q[..., :0]]
        for b, (body, following) in enumerate(itertools.pairwise(self.bodies)) if self.joined else ():
            gap = (self.tip(b, q, q) - self.root(b + 1, q, q))[..., :3]
            if following.link != body.link:
                gap[..., 2] += self.scene.angles[following.link] - self.scene.angles[body.link]
                gap = gap[..., :3] if following.link in self.scene.rigid_joints else gap[..., :2]
            found.append(gap)
        return np.concatenate(found, axis=-1)

    def _paper_force(self, q: Array) -> Array:
        """P times the derivative of half the integral of v'^2, on the coordinates of bending."""
        r = np.zeros(self.n)
        for at, body in zip(self.starts, self.bodies, strict=True):
            p, l = q[at : at + body.n], body.length / len(body.elements)
            for own, stretch in zip(body.elements, self._stretches(body, p), strict=True):
                slope = body.points.slope[own]
                r[at : at + body.n] += body.section.EA / l * stretch * slope.T @ (body.points.dx[own] * (slope @ p))
        return r

    def places(self, q: Array, v: Array) -> list[tuple[Array, Array]]:
        """Root and tip section (x, y, angle and rates) of each link."""
        links = [body.link for body in self.bodies]
        first = [links.index(k) for k in range(self.arm.n_links)]
        last = [len(links) - 1 - links[::-1].index(k) for k in range(self.arm.n_links)]
        return [(self.root(a, q, v), self.tip(b, q, v)) for a, b in zip(first, last, strict=True)]

    def ports(self, q: Array) -> Array:
        """What inputs work on: joint angles, then x, y, angle at each point load."""
        places = self.places(q, q)
        elbows = (root - tip for (_, tip), (root, _) in itertools.pairwise(places))
        y = [turn[..., 2:3] for turn in (places[0][0], *elbows)]
        for load in (item for item in self.scene.loads if isinstance(item, PointLoad)):
            y.append(places[load.link][load.end == "tip"][..., :3])
        return np.concatenate(y, axis=-1)


def at_points(own: Motion, points: Points) -> tuple[Array, Array]:
    """Positions and rates of points, (..., S, 2): exact."""
    x, y = points.x + own.p @ points.u.T, own.p @ points.v.T
    dx, dy = own.p_rate @ points.u.T, own.p_rate @ points.v.T
    if points.H is not None:
        x, dx = x - 0.5 * form(own.p, points.H, own.p), dx - form(own.p, points.H, own.p_rate)
    c, s, w = np.cos(own.angle)[..., None], np.sin(own.angle)[..., None], own.rate[..., None]
    dx, dy = dx - w * y, dy + w * x
    X = own.X[..., None, :] + np.stack([c * x - s * y, s * x + c * y], axis=-1)
    return X, own.X_rate[..., None, :] + np.stack([c * dx - s * dy, s * dx + c * dy], axis=-1)


def tip_turn(own: Motion, body: Body) -> tuple[Array, Array]:
    """Angle and rate of the tip section."""
    return own.angle + own.p @ body.tip.phi[0], own.rate + own.p_rate @ body.tip.phi[0]


def kinetic_energy(own: Motion, points: Points, mass: Array, inertia: Array, exactly: bool) -> Array:
    """Of masses at points. Not exactly: products of places and rates within the frame to second order in p."""
    turning = 0.5 * (own.rate[..., None] + own.p_rate @ points.phi.T) ** 2 @ inertia
    if exactly or points.H is None:
        rate = at_points(own, points)[1]
        return 0.5 * (rate[..., 0] ** 2 + rate[..., 1] ** 2) @ mass + turning
    moments = np.array([np.tensordot(mass, points.H, 1), np.tensordot(mass * points.x, points.H, 1)])
    h, h_rate = form(own.p, moments, own.p), form(own.p, moments, own.p_rate)  # of m H and m x H, summed
    x0, y, dy, w = points.x, own.p @ points.v.T, own.p_rate @ points.v.T, own.rate[..., None]
    c, s = np.cos(own.angle)[..., None], np.sin(own.angle)[..., None]
    X, Y = own.X_rate[..., :1], own.X_rate[..., 1:]
    vx, vy = c * X + s * Y, c * Y - s * X
    twice = X**2 + Y**2 + 2.0 * (-vx * w * y + vy * (dy + w * x0))
    twice = (twice + w**2 * (x0**2 + y**2) + 2.0 * w * x0 * dy + dy**2) @ mass
    shortened = -2.0 * vx[..., 0] * h_rate[..., 0] - vy[..., 0] * own.rate * h[..., 0] - own.rate**2 * h[..., 1]
    return 0.5 * (twice + shortened) + turning
