"""Chains in space of another derivation: strains as coordinates, d'Alembert's principle, SciPy in time, plain NumPy.

Coordinates are joint angles and the curvatures and twist of each link as polynomials along it (where a section is soft,
stretch and shear as well); a free base has its place and a quaternion. Nothing is left to interpolate: places and
rotations, their rates, and all that they vary by, are integrals along the link at Gauss's points,

    A' = A kappa^,  r' = A (e_x + Gamma),  dtheta' = A dkappa,  dr' = dtheta x A (e_x + Gamma) + A dGamma,

and the mass matrix and the forces are sums over bodies of what does virtual work,

    sum of dr . m (r.. - g) + dtheta . (I alpha + w x I w)  +  dk . (K k + tau K k.)  =  dr . F + dtheta . M + dq . tau.

`tests/test_oracle_space.py` holds that against Lagrange's equations of the energies. Nothing here uses the package's
mechanics: of it are the parameters of arms and scenes, and the values of time functions.
"""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from flexarm_env.bodies import RigidLink
from flexarm_env.scene import JointTorque, PointLoad, Scene
from flexarm_env.time_functions import Side
from tests.oracle_joints import Joints

Array = NDArray[Any]
X = np.array([1.0, 0.0, 0.0])
GAUGE = 0.3
"""Where links' curvatures are read."""
LEVI = np.array([np.cross(np.eye(3), axis) for axis in np.eye(3)])  # LEVI[k] b: e_k x b, turned about


def hat(a: Array) -> Array:
    """The matrices of b -> a x b; rows of vectors times one of them: b x a."""
    return np.asarray((a @ LEVI.reshape(3, 9)).reshape(*a.shape, 3))


def cross(a: Array, b: Array) -> Array:
    """a x b, any leading axes."""
    return np.asarray((hat(a) @ b[..., None])[..., 0])


def exponential(psi: Array) -> Array:
    """Rodrigues' formula."""
    square = (psi * psi).sum(-1)[..., None, None]
    near = np.abs(square) < 1e-10
    a = np.sqrt(np.where(near, 1.0, square))
    one = np.where(near, 1.0 - square / 6.0, np.sin(a) / a)
    two = np.where(near, 0.5 - square / 24.0, (1.0 - np.cos(a)) / (a * a))
    S = hat(psi)
    return np.asarray(np.eye(3) + one * S + two * (S @ S))


class Point(NamedTuple):
    """A frame, or many: place, axes, their rates, accelerations as far as those of the coordinates do not make them,
    variations (..., n, 3) by the coordinates; all along inertial axes."""

    r: Array
    A: Array
    v: Array
    w: Array
    a: Array
    alpha: Array
    dr: Array
    dt: Array

    def beyond(self, arm: Array) -> Point:
        """What is fixed to it at `arm`, in its axes."""
        l, w = self.A @ arm, self.w
        second = cross(self.alpha, l) + cross(w, cross(w, l))
        return self._replace(r=self.r + l, v=self.v + cross(w, l), a=self.a + second, dr=self.dr + self.dt @ hat(l))


class Beam:
    """A link that bends: n polynomials for each of its strains, quadrature at `points` places and its end."""

    def __init__(self, link: Any, tau: float, first: int, n: int, points: int, soft: bool) -> None:
        self.link, self.first, self.tau = link, first, tau
        self.strains, L = 6 if soft else 3, link.length
        self.count = n * self.strains
        x, w = np.polynomial.legendre.leggauss(points)
        s, self.weights = 0.5 * L * (1.0 + x), 0.5 * L * w
        ends = np.concatenate([[0.0], s, [L]])
        legendre = np.polynomial.legendre.legvander
        lagrange = np.linalg.inv(legendre(x, points - 1))  # column j: coefficients of node j's
        primitives = [np.polynomial.legendre.legint(c, lbnd=-1) for c in lagrange.T]
        self.W = 0.5 * L * np.array([np.polynomial.legendre.legval([*x, 1.0], c) for c in primitives]).T
        pair = 0.5 + np.array([-1.0, 1.0]) / np.sqrt(12.0)
        inner = ends[:-1, None] + np.diff(ends)[:, None] * pair
        self.spans = np.diff(ends)[:, None]

        def basis(s: Array) -> Array:
            return np.asarray(legendre(2.0 * s / L - 1.0, n - 1))

        self.P, self.inner = basis(s), basis(inner)
        self.bow = np.zeros((*inner.shape, 3))
        self.bow[..., 2] = self._curvature(inner)
        own, across = link.along(s), link.across(s)
        D = [across["GJ"], across["EI_y"], own.EI, own.EA, own.C, across["C_y"]][: self.strains]
        self.K = np.zeros((self.count, self.count))
        for i, stiffness in enumerate(D):
            self.K[i * n : (i + 1) * n, i * n : (i + 1) * n] = self.P.T @ (self.P * (self.weights * stiffness)[:, None])
        self.m, self.J = own.m, np.stack([own.J + across["J_y"], across["J_y"], own.J], axis=-1)

    def _curvature(self, s: Array) -> Array:
        own = self.link.curvature
        if not isinstance(own, tuple):
            return np.full(s.shape, float(own))
        return np.interp(s, *np.array(own).T)

    def curvatures(self, q: Array, place: float) -> Array:
        """Torsion and curvatures about y and z at a place between root (0) and tip (1), 1/m."""
        s = np.array([place * self.link.length])
        P = np.polynomial.legendre.legvander(2.0 * s / self.link.length - 1.0, self.P.shape[1] - 1)
        k = q[self.first : self.first + self.count].reshape(self.strains, -1)[:3]
        return np.asarray((P @ k.T)[0] + [0.0, 0.0, self._curvature(s)[0]])

    def points(self, root: Point, q: Array, v: Array) -> Point:
        """The places of the quadrature and the beam's end, in this order."""
        n = self.P.shape[1]
        k, rate = (x[self.first : self.first + self.count].reshape(self.strains, n) for x in (q, v))
        kappa = self.inner @ k[:3].T + self.bow
        a, b = kappa[:, 0], kappa[:, 1]
        steps = exponential(0.5 * self.spans * (a + b) + self.spans**2 * cross(a, b) * (np.sqrt(3.0) / 12.0))
        axes = [root.A @ steps[0]]
        for step in steps[1:]:
            axes.append(axes[-1] @ step)
        A, W = np.array(axes), self.W
        At, P = A[:-1], self.P
        bend = (At @ (P @ rate[:3].T)[..., None])[..., 0]
        w = root.w + W @ bend
        alpha = root.alpha + W @ cross(w[:-1], bend)
        zeros = np.zeros((*P.shape[:1], *root.dt.shape), dtype=A.dtype)
        varied, stretched = zeros, zeros.copy()
        for c in range(3):
            here = slice(self.first + c * n, self.first + (c + 1) * n)
            varied[:, here] = P[:, :, None] * At[:, None, :, c]
        t, slide = At[..., 0], np.zeros_like(bend)
        if self.strains == 6:
            t = t + (At @ (P @ k[3:].T)[..., None])[..., 0]
            slide = (At @ (P @ rate[3:].T)[..., None])[..., 0]
            for c in range(3):
                here = slice(self.first + (3 + c) * n, self.first + (4 + c) * n)
                stretched[:, here] = P[:, :, None] * At[:, None, :, c]
        dt = root.dt + np.tensordot(W, varied, 1)
        spin = w[:-1]
        second = cross(alpha[:-1], t) + cross(spin, cross(spin, t) + 2.0 * slide)
        return Point(
            root.r + W @ t, A, root.v + W @ (cross(spin, t) + slide), w, root.a + W @ second, alpha,
            root.dr + np.tensordot(W, dt[:-1] @ hat(t) + stretched, 1), dt,
        )  # fmt: skip


class SpatialOracle:
    """The chain of a scene; `n` polynomials a strain. Columns: the base's place and rotation, joints, strains, motors
    behind gears that give."""

    def __init__(self, scene: Scene, n: int = 6, points: int = 10, soft: bool = False, carried: bool = False) -> None:
        self.scene, self.arm = scene, scene.arm
        links = self.arm.links
        largest, shares = self.arm.damping
        self.beams: list[Beam | None] = []
        at = 6 + len(links)
        for k, link in enumerate(links):
            tau = largest * (1.0 if shares is None else shares[k])
            beam = None if link.rigid else Beam(link, tau, at, n, points, soft)
            self.beams.append(beam)
            at += 0 if beam is None else beam.count
        motors = [k for k in range(len(links)) if self.arm.joint(k).elastic]
        turned = [at + motors.index(k) if k in motors else 6 + k for k in range(len(links))]
        at += len(motors)
        self.joints = Joints(self.arm, turned, at, carried)
        self.n = at
        self.g = np.array(scene.gravity or (0.0, 0.0, 0.0))
        self.K, self.D = np.zeros((at, at)), np.zeros((at, at))
        for beam in self.beams:
            if beam is not None:
                own = slice(beam.first, beam.first + beam.count)
                self.K[own, own], self.D[own, own] = beam.K, beam.tau * beam.K
        names = [*("root_x", "root_y", "root_z"), "", "", "", *(f"joint{k}" for k in range(len(links)))]
        names += [""] * (at - len(motors) - len(names)) + [f"motor{k}" for k in motors]
        self.known = {
            i: f for i, name in enumerate(names) if (f := scene.motion_of(name) if name else None) is not None
        }
        held = {6, *()} if scene.root == "free" else {i for i in range(6) if i not in self.known}
        held |= {6 + k for k in scene.rigid_joints}
        self.free = [i for i in range(at) if i not in held and i not in self.known]

    def walk(self, r: Array, A: Array, q: Array, v: Array) -> list[tuple[Point, Point | None, Point]]:
        """Of each link: its root at the joint; the quadrature's points; its end, before a rigid end."""
        n, zero = self.n, np.zeros(3)
        dr, dt = np.zeros((n, 3)), np.zeros((n, 3))
        dr[:3], dt[3:6] = np.eye(3), np.eye(3)
        at, arm = Point(r, A, v[:3], v[3:6], zero, zero, dr, dt), self.arm
        found = []
        for k, (link, beam) in enumerate(zip(arm.links, self.beams, strict=True)):
            mount, axis = (arm.hub_mount, arm.hub_axis) if k == 0 else (arm.elbow(k).mount, arm.elbow(k).axis)
            A = at.A if mount is None else at.A @ np.array(mount)
            A = A @ exponential(q[6 + k] * np.array(axis))
            turn = A @ np.array(axis)
            dt = at.dt.copy() if not np.iscomplexobj(turn) else at.dt + 0j
            dt[6 + k] = turn
            rate = turn * v[6 + k]
            root = at._replace(A=A, w=at.w + rate, alpha=at.alpha + cross(at.w, rate), dt=dt)
            start, points = root.beyond(link.root_offset * X), None
            end = start
            if beam is not None:
                points = beam.points(start, q, v)
                end = Point(*(field[-1] for field in points))
                points = Point(*(field[:-1] for field in points))
            found.append((root, points, end))
            at = end.beyond((link.length if link.rigid else link.tip_offset) * X)
        return found

    def bodies(self, walk: list[tuple[Point, Point | None, Point]]) -> list[tuple[Point, Any, Any]]:
        """(where, mass, tensor in the axes there) of all that has inertia; of beams mass and tensors at many points."""
        arm, found = self.arm, []
        for k, (root, points, end) in enumerate(walk):
            link, beam, last = arm.links[k], self.beams[k], k == arm.n_links - 1
            tip = end.beyond((link.length if link.rigid else link.tip_offset) * X)
            found.append((root, 0.0, _tensor(arm.hub_inertia if k == 0 else arm.elbow(k).inertia_right)))
            if isinstance(link, RigidLink):
                found.append((root.beyond(np.array(link.centre)), link.mass, _tensor(link.inertia)))
            else:
                assert beam is not None and points is not None
                found.append((root.beyond(0.5 * link.root_offset * X), link.root_mass, _tensor(link.root_inertia)))
                found.append((end.beyond(0.5 * link.tip_offset * X), link.tip_mass, _tensor(link.tip_inertia)))
                found.append((points, beam.weights * beam.m, beam.weights[:, None, None] * np.eye(3) * beam.J[:, None]))
            if last:
                offset = np.array((*arm.payload.offset, 0.0)[:3])
                found.append((tip.beyond(offset), arm.payload.mass, _tensor(arm.payload.inertia)))
            else:
                found.append((tip, arm.elbow(k + 1).mass, _tensor(arm.elbow(k + 1).inertia_left)))
        return found

    def forces(self, walk: list[tuple[Point, Point | None, Point]], t: float, side: Side) -> Array:
        """Generalised forces of the loads."""
        total = np.zeros(self.n)
        for load in self.scene.loads:
            if isinstance(load, JointTorque):
                total[self.joints.turned[load.joint]] += load.function(t, 0, side)
            elif isinstance(load, PointLoad):
                link, (root, _, end) = self.arm.links[load.link], walk[load.link]
                at = root if load.end == "root" else end.beyond((link.length if link.rigid else link.tip_offset) * X)
                names = (("force_x", "force_y", "force_z"), ("torque_x", "torque_y", "torque"))
                pairs = [[getattr(load, name) for name in three] for three in names]
                force, moment = (np.array([0.0 if f is None else f(t, 0, side) for f in three]) for three in pairs)
                total += at.dr @ force + at.dt @ moment
        return total

    def equations(self, r: Array, A: Array, q: Array, v: Array, t: float, side: Side) -> tuple[Array, Array]:
        """M, h of M dv/dt + h = 0."""
        walk = self.walk(r, A, q, v)
        M, h = np.zeros((self.n, self.n)), self.K @ q + self.D @ v - self.forces(walk, t, side)
        for at, mass, I in self.bodies(walk):
            fall, I = at.a - self.g, at.A @ I @ np.swapaxes(at.A, -1, -2)
            turn = (I @ at.alpha[..., None])[..., 0] + cross(at.w, (I @ at.w[..., None])[..., 0])
            many = at.dr.ndim == 3
            m = np.asarray(mass)[..., None, None]
            sides = [(m * at.dr, at.dr), (at.dt @ I, at.dt)]
            for one, two in sides:
                if many:
                    one, two = (np.swapaxes(x, 1, 2).reshape(-1, self.n).T for x in (one, two))
                M += one @ two.T
            pull = (sides[0][0] @ fall[..., None])[..., 0] + (at.dt @ turn[..., None])[..., 0]
            h += pull.sum(0) if many else pull
        for inertia, p, axial, at, e in self.joints.rotors(walk, v):
            M += inertia * np.outer(axial, axial)
            h += inertia * (self.joints.carried * (at.alpha @ e) * axial + p * (at.dt @ cross(at.w, e)))
        return M, h + self.joints.gears(q, v)[0]

    def energies(self, r: Array, A: Array, q: Array, v: Array) -> tuple[Any, Any]:
        """Kinetic and potential energy, J."""
        kinetic, potential = 0.0, 0.5 * q @ self.K @ q
        walk = self.walk(r, A, q, v)
        potential = potential + self.joints.wound(q)
        for inertia, p, *_ in self.joints.rotors(walk, v):
            kinetic = kinetic + 0.5 * inertia * p * p
        for at, mass, I in self.bodies(walk):
            own = (np.swapaxes(at.A, -1, -2) @ at.w[..., None])[..., 0]
            turning = (own * (I @ own[..., None])[..., 0]).sum(-1)
            kinetic = kinetic + 0.5 * (mass * (at.v * at.v).sum(-1) + turning).sum()
            potential = potential - (mass * (at.r @ self.g)).sum()
        return kinetic, potential

    def start(self) -> Array:
        """State at t = 0: place, quaternion (x, y, z, w), coordinates, rates, what has been dissipated."""
        scene, m = self.scene, self.n - 6
        y = np.zeros(8 + m + self.n)
        y[:3], y[6] = scene.position, 1.0
        y[7 : 7 + self.arm.n_links] = scene.angles
        v = y[7 + m : -1]
        v[:3] = scene.velocity
        for k, turned in enumerate(self.joints.turned):
            y[1 + turned], v[6 + k], v[turned] = scene.angles[k], scene.rates[k], scene.rates[k]
        if scene.root == "free":
            mount = np.eye(3) if self.arm.hub_mount is None else np.array(self.arm.hub_mount)
            v[3:6], v[6] = scene.rates[0] * mount @ np.array(self.arm.hub_axis), 0.0
        return y

    def rest(self, y: Array) -> Array:
        """The state of rest under the loads as they are at t = 0 that `y` leads to: pseudo-transient continuation,
        (s M + dh/dq) d = -h with s falling as it goes."""
        m, held = self.n - 6, self.scene.start == "held"
        rows = np.array([i for i in self.free if i > 5 and not (held and i < 6 + self.arm.n_links)])
        r, A, q, v = self.parts(y, 0.0, "right")
        v = 0.0 * v
        s, eps = 1e3, 1e-6
        for _ in range(200):
            M, h = self.equations(r, A, q, v, 0.0, "right")
            J = np.empty((len(rows), len(rows)))
            for j, row in enumerate(rows):
                ends = []
                for sign in (1.0, -1.0):
                    near = q.copy()
                    near[row] += sign * eps
                    ends.append(self.equations(r, A, near, v, 0.0, "right")[1][rows])
                J[:, j] = (ends[0] - ends[1]) / (2.0 * eps)
            d = np.linalg.solve(s * M[np.ix_(rows, rows)] + J, -h[rows])
            size = np.abs(d).max()
            q[rows] += d * min(1.0, 0.3 / size)
            if s < 1e-6 and size < 1e-9:
                y = y.copy()
                y[7 : 7 + m] = q[6:]
                return y
            s *= 0.2 if size < 0.1 else 0.7
        raise AssertionError("no rest")

    def parts(self, y: Array, t: float, side: Side) -> tuple[Array, Array, Array, Array]:
        """Place and axes of the base, coordinates (those of the base left 0) and rates, motions prescribed in them."""
        m = self.n - 6
        r, q, v = y[:3].copy(), np.concatenate([np.zeros(6), y[7 : 7 + m]]), y[7 + m : 7 + m + self.n].copy()
        for i, f in self.known.items():
            v[i] = f(t, 1, side)
            if i < 3:
                r[i] = f(t, 0, side)
            else:
                q[i] = f(t, 0, side)
        return r, Rotation.from_quat(y[3:7]).as_matrix(), q, v

    def accelerations(self, y: Array, t: float, side: Side) -> tuple[Array, Array, Array]:
        """Accelerations, rates, and the generalised forces that prescribed coordinates ask for."""
        r, A, q, v = self.parts(y, t, side)
        M, h = self.equations(r, A, q, v, t, side)
        a = np.zeros(self.n)
        for i, f in self.known.items():
            a[i] = f(t, 2, side)
        free = self.free
        a[free] = np.linalg.solve(M[np.ix_(free, free)], -(h + M @ a)[free])
        return a, v, M @ a + h

    def rate(self, t: float, y: Array, side: Side = "right") -> Array:
        """dy/dt."""
        a, v, _ = self.accelerations(y, t, side)
        q = self.parts(y, t, side)[2]
        w, p = v[3:6], y[3:7]
        spin = 0.5 * np.array([*(p[3] * w + np.cross(w, p[:3])), -w @ p[:3]]) + (1.0 - p @ p) * p
        return np.concatenate([v[:3], spin, v[6:], a, [v @ self.D @ v + self.joints.gears(q, v)[3]]])

    def jacobian(self, t: float, y: Array) -> Array:
        """Of `rate`, its stiff part alone: what elasticity and damping make of accelerations."""
        m, free = self.n - 6, self.free
        J = np.zeros((y.size, y.size))
        J[:3, 7 + m : 10 + m] = np.eye(3)
        J[7 : 7 + m, 13 + m : -1] = np.eye(m)
        state = self.parts(y, t, "right")
        M, _ = self.equations(*state, t, "right")
        _, K, D, _ = self.joints.gears(*state[2:])
        inverse = np.zeros((self.n, self.n))
        inverse[np.ix_(free, free)] = np.linalg.inv(M[np.ix_(free, free)])
        J[7 + m : -1, 7 : 7 + m], J[7 + m : -1, 7 + m : -1] = -inverse @ (self.K + K)[:, 6:], -inverse @ (self.D + D)
        return J

    def with_payload(self, y: Array, t: float, factor: float) -> Array:
        """The state after the payload has become so many times what it was, of an arm whose base rests. What comes was
        at rest, and momenta stay; what goes takes its own along."""
        m, free, payload = self.n - 6, self.free, self.arm.payload
        state = self.parts(y, t, "right")
        M, before = self.equations(*state, t, "right")[0], self.energies(*state)[0]
        inertia = tuple(map(tuple, factor * _tensor(payload.inertia)))
        self.arm = replace(self.arm, payload=replace(payload, mass=factor * payload.mass, inertia=inertia))
        if factor > 1.0:
            heavier, y = self.equations(*state, t, "right")[0], y.copy()
            v = np.linalg.solve(heavier[np.ix_(free, free)], M[np.ix_(free, free)] @ state[3][free])
            y[[7 + m + i for i in free]] = v
            y[-1] += before - self.energies(*self.parts(y, t, "right"))[0]
        return y

    def run(self, times: Array, rtol: float = 3e-5, changed: tuple[float, float] | None = None) -> dict[str, Array]:
        """A row for each of `times` (ascending from 0): where the tip is, its axes, in these the specific force and the
        angular velocity there, each link's deflection, twist and curvatures at `GAUGE`, torques of prescribed joints,
        what is dissipated; "natural": deflections without stress. changed: when and by what factor the payload is."""
        scene, y = self.scene, self.start()
        natural = self._read(y, 0.0, "right")["bent"]
        if scene.start != "unloaded":
            y = self.rest(y)
        found: list[dict[str, Array]] = [self._read(y, 0.0, "right")] if times[0] == 0.0 else []
        for start, end in itertools.pairwise([0.0, *(k for k in scene.kinks if k < times[-1]), float(times[-1])]):
            if changed is not None and start == changed[0]:
                y = self.with_payload(y, start, changed[1])
            here = times[(times > start) & (times <= end)]

            def piece(t: float, y: Array, start: float = start, end: float = end) -> Array:
                return self.rate(t, y, "left" if t > 0.5 * (start + end) else "right")

            asked = np.union1d(here, [end])
            solution = solve_ivp(piece, (start, end), y, "BDF", asked, jac=self.jacobian, rtol=rtol, atol=1e-2 * rtol)
            assert solution.success, solution.message
            y = solution.y[:, -1]
            found += [self._read(solution.y[:, i], t, "left") for i, t in enumerate(here)]
        return {"natural": natural, **{key: np.array([row[key] for row in found]) for key in found[0]}}

    def _read(self, y: Array, t: float, side: Side) -> dict[str, Array]:
        r, A, q, v = self.parts(y, t, side)
        links, tips = self.walk(r, A, q, v), []
        for link, (_, _, end) in zip(self.arm.links, links, strict=True):
            tips.append(end.beyond((link.length if link.rigid else link.tip_offset) * X))
        bent = [root.A.T @ (tip.r - root.r) for (root, _, _), tip in zip(links, tips, strict=True)]
        twist = [
            Rotation.from_matrix(root.A.T @ tip.A).as_rotvec()[0] for (root, _, _), tip in zip(links, tips, strict=True)
        ]
        a, _, asked = self.accelerations(y, t, side)
        tip, torque = tips[-1], np.zeros(self.arm.n_links)
        if any(i > 5 for i in self.known):
            torque = asked[self.joints.turned]
        strains = [beam.curvatures(q, GAUGE) for beam in self.beams if beam is not None]
        return {
            "felt": tip.A.T @ (tip.a + a @ tip.dr - self.g), "spin": tip.A.T @ tip.w, "strains": np.array(strains),
            "tip": tips[-1].r, "axes": tips[-1].A, "bent": np.array(bent), "twist": np.array(twist), "torque": torque,
            "energy": np.array(self.energies(r, A, q, v)), "dissipated": y[-1],
        }  # fmt: skip


def _tensor(value: Any) -> Array:
    return np.array(value) if isinstance(value, tuple) else value * np.eye(3)
