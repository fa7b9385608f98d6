"""Estimate the error of neglecting stretch and shear in the elastica, from a scene alone, before the run.

Small vibrations about the initial configuration define the modes of the elastica. The inertia forces m u of mode k
cause section forces N and Q along the chain. The work of N and Q in stretch and shear increases the mode's flexibility
by the fraction

    epsilon_k = omega_k^2 int N^2 / EA + Q^2 / C ds / (u' M u)

The fraction refers to bending alone and is of first order (Grammel). The added flexibility divides the square of the
mode's frequency by 1 + epsilon. Each mode's response to the scene's loads and motions is computed in time with and
without epsilon. The estimate is a sum of three terms. The first is the largest distance between the two tip motions.
The second is a fraction of the distance between the deflections; this fraction grows with the arm's rotation. The third
is the stretch along the arm (theory, section 5). The model is linear about the initial configuration. The estimate is
right within a factor of about 3 for one link and of 4 for several links that do not swing far. A small error (below 0.3
% of the length) is mostly overestimated. The estimate does not cover links in fast rotation. For links in fast rotation
a run's error estimate uses the distance to a softer companion run (`Notes.softer`), if this distance exceeds the
estimate.
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
"""Number of modes that the error estimate includes; these modes have the lowest frequencies."""
SUDDEN = 2.0
"""Factor on a static deflection: a load that is applied at once deflects an arm twice as far as a slow load."""

FEWEST, MOST, A_PERIOD = 2000, 100_000, 20
"""Smallest and largest number of time samples in a scene, and number of samples in a period of the highest mode."""


class Notes(Mapping[str, float]):
    """Mapping with the single key "stretch_and_shear": the error estimate as a fraction of the arm's length.

    The estimate is computed at the first access.
    """

    def __init__(self, scene: Scene, n: int) -> None:
        """Store the scene and the number n of nodes per link; nothing is computed yet."""
        self._of = scene, n

    @property
    def softer(self) -> float:
        """Factor on EI of a companion run: 1 / (1 + epsilon) with the largest epsilon of the lowest modes.

        The distance to the companion run estimates the error for motions of any size, unlike the linear estimate.
        """
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
    """Estimate the largest error of the tip with n nodes per link, as a fraction (at most 1) of the arm's length.

    The estimate is cached, because it does not depend on the time step or other settings of a run.
    """
    length = scene.arm.total_length
    modes = _Modes(scene, chain(scene.arm, n))
    count = min(MODES, modes.omega.size)
    wanted = A_PERIOD * modes.omega[:count].max(initial=0.0) * scene.duration / (2.0 * np.pi)
    t = np.linspace(0.0, scene.duration, int(np.clip(wanted, FEWEST, MOST)) + 1)
    # sums over the modes of the difference of both responses, over the arm's length
    tip, deflection = np.zeros((2, t.size)), np.zeros(t.size)
    for k in range(count):
        square, shape = modes.omega[k] ** 2, modes.shapes[:, k]
        force, damping = modes.force(shape, t), modes.damping(shape, square)
        bent = _response(square, damping, force, t)
        sheared = _response(square / (1.0 + square * modes.section_work(shape)), damping, force, t)
        bow = modes.deflection(shape) / length
        # over max(1, bow |q|): a deflection is bounded, which its linear model is not
        off = (sheared - bent) / max(1.0, bow * np.abs(bent).max())
        tip += np.outer(modes.tip(shape) / length, off)
        deflection += bow * np.abs(off)
    angle, between, rate = modes.swing(t)
    # Errors of the deflection become errors of the tip as the arm turns: not at small angles, fully at a right angle.
    # They also do as links turn against each other, since the modes are those of the initial configuration.
    share = max(1.0 - np.cos(min(angle, 0.5 * np.pi)), 2.0 * np.sin(0.5 * min(between, np.pi / 3.0)))
    bending = np.hypot(*tip).max() + share * deflection.max()
    return float(min(1.0, bending + along_the_arm(scene, rate)))


def _response(square: float, tau_d: float, force: Array, t: Array) -> Array:
    """Return x(t) of x'' + tau_d w^2 x' + w^2 x = force from rest, by Fourier convolution; square: w^2 > 0 (1/s^2).

    tau_d: damping time constant, s. force, t (s): samples at equal intervals from 0.
    """
    # response to an impulse, under- or overdamped; rate = 0: critically damped
    decay, n = 0.5 * tau_d * square, t.size
    rate = np.sqrt(complex(square - decay**2))
    with np.errstate(over="ignore", invalid="ignore"):
        slow, fast = np.exp((1j * rate - decay) * t), np.exp((-1j * rate - decay) * t)
    impulse = ((slow - fast) / (2j * rate)).real if abs(rate) > 1e-9 * decay else t * np.exp(-decay * t)
    room = 1 << (2 * n - 1).bit_length()
    return np.asarray(np.fft.irfft(np.fft.rfft(impulse, room) * np.fft.rfft(force, room), room)[:n] * t[1])


def along_the_arm(scene: Scene, rate: float) -> float:
    """Estimate the stretch of the arm as a fraction of its length L, from root motion, rotation and weight.

    The model is a spring of stiffness EA / L. The elbows, the payload and half of the links' mass are at its tip.
    rate: largest angular velocity, rad/s. For an arm that swings as a pendulum, the model uses three times the weight.
    """
    arm, end = scene.arm, scene.duration
    length = arm.total_length
    mass = arm.payload.mass + sum(0.5 * link.mass for link in arm.links) + sum(elbow.mass for elbow in arm.elbows)
    # stretch = acceleration / (axial frequency)^2, of centrifugal force, root motion, weight
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
    """Flexible modes of a chain about the scene's initial configuration, including the payload.

    omega (f,): angular frequencies, rad/s.
    shapes (Nn, f): node angles in each mode, normalized to u^T M u = 1.
    rigid (Nn, r): node angles of motions without strain.
    along, across (2, Nn): unit tangents and normals of the nodes, inertial axes.
    M (Nn, Nn): mass matrix, kg m^2.
    b (Nn,): first moments, kg m.
    mass: total mass, kg.
    """

    def __init__(self, scene: Scene, chain: Chain) -> None:
        """Linearize the chain about the scene's initial angles and solve the eigenproblem K u = omega^2 M u."""
        self.scene, self.chain, arm = scene, chain, scene.arm
        n, m = chain.n, chain.w.size
        payload = arm.payload
        self.angles, rest = np.repeat(scene.angles, n), chain.rest
        if rest is not None:
            self.angles = self.angles + rest
        self.along = np.array([np.cos(self.angles), np.sin(self.angles)])  # unit tangents at the nodes
        self.across = np.array([-np.sin(self.angles), np.cos(self.angles)])
        self.own = [slice(k * n, (k + 1) * n) for k in range(arm.n_links)]  # nodes of each link
        # M_ij = P_ij cos(phi_i - phi_j) + R_ij with the payload; K
        cosines = np.cos(self.angles[:, None] - self.angles)
        arm_of = chain.w.copy()
        arm_of[m - n :] += payload.offset[0] * chain.lines[-1].tip_angle
        self.b = chain.b + payload.mass * arm_of
        self.mass = chain.mass + payload.mass
        self.M = (chain.P + payload.mass * np.outer(arm_of, arm_of)) * cosines
        K = np.zeros((m, m))
        for k, own in enumerate(self.own):
            self.M[own, own] += chain.R[k]
            K[own, own] = chain.K_EI[k]
        tip = chain.lines[-1].tip_angle
        self.M[m - n :, m - n :] += (payload.inertia + payload.mass * payload.offset[1] ** 2) * np.outer(tip, tip)
        # M - b b^T / m: a free root moves with the center of mass; rigid joints have no coordinate
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
        """Return tau_d of a mode, s: the links' values averaged by strain energy; square: omega^2 of the mode."""
        largest, shares = self.scene.arm.damping
        if shares is None:
            return largest
        energies = [u @ K @ u for u, K in zip(np.split(shape, len(shares)), self.chain.K_EI, strict=True)]
        return float(largest * np.dot(shares, energies) / square)

    def _steps(self, shape: Array) -> tuple[Array, list[Array]]:
        """Return the changes of the unit tangents (2, Nn) and the displacements (2,), m, of all joints and the tip.

        Values are per unit of the mode `shape`, in inertial axes, ordered from the root to the tip.
        """
        move = self.across * shape
        places = [-(move @ self.b) / self.mass if self.root else np.zeros(2)]
        for own in self.own:
            places.append(places[-1] + move[:, own] @ self.chain.w[own])
        return move, places

    def deflection(self, shape: Array) -> float:
        """Return the largest deflection of a link's tip from its root tangent, m per unit of the mode `shape`."""
        return max(abs(float(self.chain.w[own] @ (shape[own] - shape[own.start]))) for own in self.own)

    def swing(self, t: Array) -> tuple[float, float, float]:
        """Return the largest link angle and angle between links (rad), and the angular rate without gravity (rad/s).

        Only rigid motions count. The scene's loads and motions are integrated over the times t (s).
        """
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
        """Return the displacement (2,) of the tip, m per unit of the mode `shape`, in inertial axes."""
        return self._steps(shape)[1][-1]

    def section_work(self, shape: Array) -> float:
        """Return int N^2 / EA + Q^2 / C ds for the forces m u of a mode, which are inertia forces divided by omega^2.

        N, Q: section forces along and across the tangent, summed from the tip. The result times omega^2 is epsilon_k of
        the module's docstring.
        """
        chain, arm = self.chain, self.scene.arm
        move, starts = self._steps(shape)
        total, force = 0.0, np.zeros(2)
        for k in reversed(range(arm.n_links)):
            own, link, line = self.own[k], arm.links[k], chain.lines[k]
            last = k == arm.n_links - 1
            force = force + (arm.payload.mass if last else arm.elbow(k + 1).mass) * starts[k + 1]
            force = force + link.tip_mass * starts[k + 1]
            # u at 65 places, inertia force m u ds of each interval, and the force beyond each place, whose parts are N
            # and Q
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
        """Return the generalized force on a mode at the times t (s): the scene's loads, motions and gravity.

        Gravity starts at once, unless ``weight`` is False. If a scene has no loads and motions, the arm's largest
        torques are applied at once instead.
        """
        scene, arm, n = self.scene, self.scene.arm, self.chain.n
        across = self.across
        force: Array = np.zeros(t.size)
        root = self._steps(shape)[1][0]
        # angle of each joint in the mode: of a link's first node less the tip before it
        joints = [float(shape[k * n]) for k in range(arm.n_links)]
        for k in range(1, arm.n_links):
            joints[k] -= float(self.chain.lines[k - 1].tip_angle @ shape[self.own[k - 1]])
        for load in scene.loads:
            if isinstance(load, JointTorque):
                force += joints[load.joint] * load.function(t)
                continue
            # generalized force by virtual work: F . du + tau dphi of the loaded point (inertial axes)
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
        """Return the inertia force on a mode for unit acceleration of a prescribed motion of the root or a joint."""
        if motion.joint is None:
            return float(self.b @ (self.across[0 if motion.coordinate == "root_x" else 1] * shape))
        return float((self.M @ shape)[motion.joint * self.chain.n :].sum())  # all that follows turns with it


def _acceleration(f: TimeFunction, t: Array) -> Array:
    """Return f'' at equidistant times t (s). A jump of f', such as a start from rest, is spread over one sample."""
    found: Array = f(t, 2)
    for kink, before in [(0.0, 0.0), *((k, f(k, 1, side="left")) for k in f.kinks if 0.0 < k < t[-1])]:
        found[round(kink / t[1])] += (f(kink, 1) - before) / t[1]
    return found


def coordinates(arm: Arm, n: int) -> Array:
    """Return the matrix T (Nn, Nn) that maps coordinates (joint and node angles) to the tangent angles of all nodes."""
    T = np.eye(arm.n_links * n)
    for k in range(1, arm.n_links):
        T[k * n, k * n - 1] = 1.0
    return T


def _largest(f: TimeFunction, end: float, derivative: int = 0) -> float:
    """Return the largest magnitude on [0, end] (s) of a derivative of f, at 2001 samples and just before jumps."""
    times = np.linspace(0.0, end, 2001)
    return float(max(np.abs(f(times, derivative)).max(), np.abs(f(times, derivative, side="left"))[1:].max()))


def _eigh(K: Array, M: Array) -> tuple[Array, Array]:
    """Solve K x = square M x for symmetric K and M. Return squares, and vectors as columns with x^T M x = 1."""
    L = np.linalg.cholesky(M)
    square, vectors = np.linalg.eigh(np.linalg.solve(L, np.linalg.solve(L, K).T))
    return square, np.linalg.solve(L.T, vectors)
