"""What the elastica's leaving out stretch and shear costs: an estimate for a scene, before anything is run.

Small vibrations about the initial configuration give the modes of the elastica. In mode k its inertia forces m u,
balanced through the chain, make section forces N and Q whose work in stretch and shear adds the flexibility

    epsilon_k = omega_k^2 int N^2 / EA + Q^2 / C ds / (u' M u)

to that of bending (first order; Grammel): the square of its frequency is divided by 1 + epsilon. Each mode's response
to the scene's loads and motions is computed in time with it and without; the estimate is the largest distance of the
tip between the two, and of the deflections as far as the arm turns (docs: theory, section "Elastica"). The model is
linear about the start: right within a factor of about 3 for one link, of 4 for several that do not swing far; mostly
too large where the error is small (below 0.3 % of the length). Links that whip round are beyond it: what a run's own
estimate then counts is a companion run that is softer (`Notes.softer`), if that is further away.
"""

from collections.abc import Iterator, Mapping
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from flexarm_env import validation as check
from flexarm_env.parameters import Arm
from flexarm_env.physics.elastica.chain import Chain, chain
from flexarm_env.scene import JointTorque, Motion, Scene
from flexarm_env.time_functions import TimeFunction

Array = NDArray[np.float64]

MODES = 3
SUDDEN = 2.0
"""A load applied at once deflects twice as far as one applied slowly."""

FEWEST, MOST, A_PERIOD = 2000, 100_000, 20
"""Samples of a scene's time, and of a period of the highest mode."""


class Notes(Mapping[str, float]):
    """ "stretch_and_shear" of a scene, worked out when it is first looked at."""

    def __init__(self, scene: Scene, n: int) -> None:
        self._of = scene, n

    @property
    def softer(self) -> float:
        """Factor on EI that makes the lowest modes as slow as stretch and shear make the one that they slow down most:
        how far a run with it comes apart follows motion however gross, which the estimate, being linear, does not."""
        scene, n = self._of
        modes = _Modes(scene, chain(scene.arm, n))
        lowest = range(min(MODES, modes.omega.size))
        slower = [float(modes.omega[k]) ** 2 * modes.section_work(modes.shapes[:, k]) for k in lowest]
        return 1.0 / (1.0 + max(slower, default=0.0))

    def __getitem__(self, name: str) -> float:
        if name != "stretch_and_shear":
            raise KeyError(name)
        return stretch_and_shear(*self._of)

    def __iter__(self) -> Iterator[str]:
        return iter(("stretch_and_shear",))

    def __len__(self) -> int:
        return 1


@lru_cache(64)
def stretch_and_shear(scene: Scene, n: int) -> float:
    """Estimated largest error of the tip with n nodes a link, as a share of the arm's length, at most 1; kept, since it
    does not depend on how the scene is run."""
    length = scene.arm.total_length
    modes = _Modes(scene, chain(scene.arm, n))
    count = min(MODES, modes.omega.size)
    wanted = A_PERIOD * modes.omega[:count].max(initial=0.0) * scene.duration / (2.0 * np.pi)
    t = np.linspace(0.0, scene.duration, int(np.clip(wanted, FEWEST, MOST)) + 1)
    tip, deflection = np.zeros((2, t.size)), np.zeros(t.size)
    for k in range(count):
        square, shape = modes.omega[k] ** 2, modes.shapes[:, k]
        force, damping = modes.force(shape, t), modes.damping(shape, square)
        bent = _response(square, damping, force, t)
        sheared = _response(square / (1.0 + square * modes.section_work(shape)), damping, force, t)
        bow = modes.deflection(shape) / length
        off = (sheared - bent) / max(1.0, bow * np.abs(bent).max())  # a deflection is bounded, its linear model is not
        tip += np.outer(modes.tip(shape) / length, off)
        deflection += bow * np.abs(off)
    angle, between, rate = modes.swing(t)
    # An arm that turns goes on from a deflection that is off to another angle; at small angles the two do not mix. They
    # do where links turn against each other: modes are those of the chain as it began.
    share = max(1.0 - np.cos(min(angle, 0.5 * np.pi)), 2.0 * np.sin(0.5 * min(between, np.pi / 3.0)))
    bending = np.hypot(*tip).max() + share * deflection.max()
    return float(min(1.0, bending + along_the_arm(scene, rate)))


def _response(square: float, tau_d: float, force: Array, t: Array) -> Array:
    """x(t) of x'' + tau_d w^2 x' + w^2 x = force from rest, w^2 = square > 0: convolution with that of an impulse."""
    decay, n = 0.5 * tau_d * square, t.size
    rate = np.sqrt(complex(square - decay**2))
    with np.errstate(over="ignore", invalid="ignore"):
        slow, fast = np.exp((1j * rate - decay) * t), np.exp((-1j * rate - decay) * t)
    impulse = ((slow - fast) / (2j * rate)).real if abs(rate) > 1e-9 * decay else t * np.exp(-decay * t)
    room = 1 << (2 * n - 1).bit_length()
    return np.asarray(np.fft.irfft(np.fft.rfft(impulse, room) * np.fft.rfft(force, room), room)[:n] * t[1])


def along_the_arm(scene: Scene, rate: float) -> float:
    """Stretch of the arm, as a share of its length: by a root that is shaken, by turning at up to `rate` (rad/s), and
    by its weight, thrice that where it swings as a pendulum.

    The arm is a spring of EA / L with half of its links' mass, its elbows and its payload at the tip.
    """
    arm, end = scene.arm, scene.duration
    length = arm.total_length
    mass = arm.payload.mass + sum(0.5 * link.mass for link in arm.links) + sum(elbow.mass for elbow in arm.elbows)
    square = min(link.series("EA") for link in arm.links) / (length * mass)
    move = rate**2 * length / square
    for motion in scene.motions:
        f = motion.function
        if motion.joint is None:
            jump = max([abs(f(0.0, 1))] + [abs(f(t, 1) - f(t, 1, side="left")) for t in f.kinks if 0.0 < t < end])
            move += jump / np.sqrt(square) + SUDDEN * _largest(f, end, 2) / square
    if scene.gravity is not None and scene.root == "pinned":
        gravity = np.asarray(scene.gravity)
        swings = 0 not in {motion.joint for motion in scene.motions} | set(scene.rigid_joints)
        along = abs(float(gravity @ [np.cos(scene.angles[0]), np.sin(scene.angles[0])]))
        move += (3.0 * float(np.hypot(*gravity)) if swings else SUDDEN * along) / square
    return float(move / length)


class _Modes:
    """Flexible modes of a chain about the scene's initial configuration.

    omega (f,) rad/s; shapes (Nn, f): angles of the nodes in each mode, normalised by the inertia (u' M u = 1); rigid
    (Nn, r): those of the motions without strain.
    """

    def __init__(self, scene: Scene, chain: Chain) -> None:
        self.scene, self.chain, arm = scene, chain, scene.arm
        n, m = chain.n, chain.w.size
        payload = arm.payload
        self.angles, rest = np.repeat(scene.angles, n), chain.rest
        if rest is not None:
            self.angles = self.angles + rest
        self.along = np.array([np.cos(self.angles), np.sin(self.angles)])  # unit tangents at the nodes
        self.across = np.array([-np.sin(self.angles), np.cos(self.angles)])
        self.own = [slice(k * n, (k + 1) * n) for k in range(arm.n_links)]  # nodes of each link
        cosines = np.cos(self.angles[:, None] - self.angles)
        arm_of = chain.w.copy()
        arm_of[m - n :] += payload.offset[0] * chain.lines[-1].tip_angle
        self.b = chain.b + payload.mass * arm_of
        self.mass = chain.mass + payload.mass
        self.M = (chain.P + payload.mass * np.outer(arm_of, arm_of)) * cosines
        K = np.zeros((m, m))
        for k, own in enumerate(self.own):
            self.M[own, own] += chain.R[k]
            K[own, own] = chain.K[k]
        tip = chain.lines[-1].tip_angle
        self.M[m - n :, m - n :] += (payload.inertia + payload.mass * payload.offset[1] ** 2) * np.outer(tip, tip)
        free_root = scene.root == "free"
        M = self.M - np.outer(self.b, self.b) * cosines / self.mass if free_root else self.M
        held = {int(k.joint) for k in scene.motions if k.joint is not None} | set(scene.rigid_joints)
        self.basis = np.delete(coordinates(arm, n), [k * n for k in held], axis=1)
        with check.solvable(arm.name):
            square, self.vectors = _eigh(self.basis.T @ K @ self.basis, self.basis.T @ M @ self.basis)
        flexible = square > 1e-9 * square[-1]
        self.omega: Array = np.sqrt(square[flexible])
        self.shapes: Array = self.basis @ self.vectors[:, flexible]
        self.rigid: Array = self.basis @ self.vectors[:, ~flexible]
        self.root = free_root

    def damping(self, shape: Array, square: float) -> float:
        """tau_d of a mode, s: the mean of the links' by their strain energy."""
        largest, shares = self.scene.arm.damping
        if shares is None:
            return largest
        energies = [u @ K @ u for u, K in zip(np.split(shape, len(shares)), self.chain.K, strict=True)]
        return float(largest * np.dot(shares, energies) / square)

    def _steps(self, shape: Array) -> tuple[Array, list[Array]]:
        """Changes of the unit tangents (2, Nn), displacements of the links' roots and of the tip (2,), in a mode."""
        move = self.across * shape
        places = [-(move @ self.b) / self.mass if self.root else np.zeros(2)]
        for own in self.own:
            places.append(places[-1] + move[:, own] @ self.chain.w[own])
        return move, places

    def deflection(self, shape: Array) -> float:
        """Largest tip deflection of any link from its root's tangent, m per unit of the mode."""
        return max(abs(float(self.chain.w[own] @ (shape[own] - shape[own.start]))) for own in self.own)

    def swing(self, t: Array) -> tuple[float, float, float]:
        """How far links swing at most, and against each other, rad, without strain; how fast if it were not for
        gravity, rad/s."""
        n, end = self.chain.n, float(t[-1])
        angle, rate = np.zeros((self.scene.arm.n_links, t.size)), np.zeros((self.scene.arm.n_links, t.size))
        for shape in self.rigid.T:
            full, driven = (np.cumsum(self.force(shape, t, weight)) * t[1] for weight in (True, False))
            angle += np.outer(shape[::n], np.cumsum(full) * t[1])
            rate += np.outer(shape[::n], driven)
        own = [m.function for m in self.scene.motions if m.joint is not None]
        given = sum(float(np.ptp(f(t))) for f in own), sum(_largest(f, end, 1) for f in own)
        between = float(np.ptp(angle, axis=0).max())
        between += sum(float(np.ptp(m.function(t))) for m in self.scene.motions if m.joint)  # elbows
        return float(np.abs(angle).max()) + given[0], between, float(np.abs(rate).max()) + given[1]

    def tip(self, shape: Array) -> Array:
        """Displacement of the tip, m per unit of the mode, (2,)."""
        return self._steps(shape)[1][-1]

    def section_work(self, shape: Array) -> float:
        """int N^2 / EA + Q^2 / C ds of the inertia forces of the mode (per omega^2), along the chain from its tip."""
        chain, arm = self.chain, self.scene.arm
        move, starts = self._steps(shape)
        total, force = 0.0, np.zeros(2)
        for k in reversed(range(arm.n_links)):
            own, link, line = self.own[k], arm.links[k], chain.lines[k]
            last = k == arm.n_links - 1
            force = force + (arm.payload.mass if last else arm.elbow(k + 1).mass) * starts[k + 1]
            force = force + link.tip_mass * starts[k + 1]
            finer = np.linspace(0.0, link.length, 65)
            field = starts[k][:, None] + move[:, own] @ line.position(finer).T
            masses = link.along(0.5 * (finer[1:] + finer[:-1])).m
            steps = 0.5 * (field[:, 1:] + field[:, :-1]) * (masses * link.length / 64)
            momentum = np.concatenate([np.zeros((2, 1)), np.cumsum(steps, axis=1)], axis=1)
            beyond = force[:, None] + momentum[:, -1:] - momentum
            along, across = self.along[:, own.start] @ beyond, self.across[:, own.start].copy() @ beyond
            if link.curved:
                tangent = np.exp(1j * (line.lagrange(finer) @ self.angles[own]))
                turned = (beyond[0] + 1j * beyond[1]) * tangent.conj()
                along, across = turned.real, turned.imag
            sections = link.along(finer)
            density = along**2 / sections.EA + across**2 / sections.C
            total += float(np.sum(0.5 * (density[1:] + density[:-1]))) * link.length / 64
            force = force + momentum[:, -1] + link.root_mass * starts[k]
        return total

    def force(self, shape: Array, t: Array, weight: bool = True) -> Array:
        """What excites a mode at the times t (s): the scene's loads, motions and gravity, which starts at once, and the
        arm's largest torques, applied at once, where the scene has neither loads nor motions."""
        scene, arm, n = self.scene, self.scene.arm, self.chain.n
        across = self.across
        force: Array = np.zeros(t.size)
        root = self._steps(shape)[1][0]
        joints = [float(shape[k * n]) for k in range(arm.n_links)]  # their angles
        for k in range(1, arm.n_links):
            joints[k] -= float(self.chain.lines[k - 1].tip_angle @ shape[self.own[k - 1]])
        for load in scene.loads:
            if isinstance(load, JointTorque):
                force += joints[load.joint] * load.function(t)
                continue
            ends = arm.links[load.link]
            s = -ends.root_offset if load.end == "root" else ends.length + ends.tip_offset
            point = across @ (self.chain.arms_to(load.link, np.array([s]))[0] * shape) + root
            angle = float(self.chain.angle_at(load.link, s) @ shape)
            parts = ((load.force_x, point[0]), (load.force_y, point[1]), (load.torque, angle))
            force += sum((f(t) * x for f, x in parts if f is not None), np.zeros(t.size))
        if scene.undriven and arm.torque_limits:
            force += sum(limit * abs(angle) for limit, angle in zip(arm.torque_limits, joints, strict=True))
        if weight and scene.gravity is not None:
            force += float(np.asarray(scene.gravity) @ ((across * shape) @ self.b + self.mass * root))
        for motion in scene.motions:
            force -= self._share(motion, shape) * _acceleration(motion.function, t)
        return force

    def _share(self, motion: Motion, shape: Array) -> float:
        """Inertia force of a mode per acceleration of a motion."""
        if motion.joint is None:
            return float(self.b @ (self.across[0 if motion.coordinate == "root_x" else 1] * shape))
        return float((self.M @ shape)[motion.joint * self.chain.n :].sum())  # all that follows turns with it


def _acceleration(f: TimeFunction, t: Array) -> Array:
    """f'' at the times t; a jump of f' is an impulse, spread over a sample, the start from rest among them."""
    found: Array = f(t, 2)
    for kink, before in [(0.0, 0.0), *((k, f(k, 1, side="left")) for k in f.kinks if 0.0 < k < t[-1])]:
        found[round(kink / t[1])] += (f(kink, 1) - before) / t[1]
    return found


def coordinates(arm: Arm, n: int) -> Array:
    """Angles of the nodes by the coordinates (Nn, Nn): a joint's turns all that follow in its link's root only."""
    T = np.eye(arm.n_links * n)
    for k in range(1, arm.n_links):
        T[k * n, k * n - 1] = 1.0
    return T


def _largest(f: TimeFunction, end: float, derivative: int = 0) -> float:
    times = np.linspace(0.0, end, 2001)
    return float(max(np.abs(f(times, derivative)).max(), np.abs(f(times, derivative, side="left"))[1:].max()))


def _eigh(K: Array, M: Array) -> tuple[Array, Array]:
    """Generalised symmetric eigenproblem, vectors normalised by M."""
    L = np.linalg.cholesky(M)
    square, vectors = np.linalg.eigh(np.linalg.solve(L, np.linalg.solve(L, K).T))
    return square, np.linalg.solve(L.T, vectors)
