"""What the elastica's leaving out stretch and shear costs: an estimate for a scene, before anything is run.

Small vibrations about the initial configuration give the modes of the elastica. In mode k its inertia forces m u,
balanced through the chain, make section forces N and Q whose work in stretch and shear adds the flexibility

    epsilon_k = omega_k^2 int N^2 / EA + Q^2 / C ds / (u' M u)

to that of bending (first order; Grammel). The static deflection is off by the share epsilon, the frequency by
epsilon / 2, and over a time T the phase by epsilon omega T / 2. How far a mode is deflected follows from the scene's
largest loads and motions, each applied at once. The sum over modes of deflection times error is the estimate
(docs: theory, section "Elastica"): right within a factor of about 3 where the error is large, an upper bound elsewhere.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from flexarm_env.mechanics.elastica import Chain
from flexarm_env.parameters import Arm
from flexarm_env.scene import JointTorque, Motion, Scene
from flexarm_env.time_functions import TimeFunction

Array = NDArray[np.float64]

MODES = 3
SUDDEN = 2.0
"""A load applied at once deflects twice as far as one applied slowly."""


def stretch_and_shear(scene: Scene, chain: Chain) -> float:
    """Estimated largest error of the tip, as a share of the arm's length, at most 1."""
    arm = scene.arm
    modes = _Modes(scene, chain)
    total = 0.0
    for k in range(min(MODES, modes.omega.size)):
        omega, shape = modes.omega[k], modes.shapes[:, k]
        epsilon = omega**2 * modes.section_work(shape)
        drift = min(2.0, 0.5 * epsilon * omega * scene.duration)
        deflection = min(1.0, modes.amplitude(k) * modes.deflection(shape) / arm.total_length)
        total += deflection * (epsilon + drift)
    return float(min(1.0, total + along_the_arm(scene)))


def along_the_arm(scene: Scene) -> float:
    """Stretch of the arm, as a share of its length, where its root is shaken or its hub is turned at a given rate.

    The arm is a spring of EA / L with half of its links' mass, its elbows and its payload at the tip.
    """
    arm, end = scene.arm, scene.duration
    length = arm.total_length
    mass = arm.payload.mass + sum(0.5 * link.mass for link in arm.links) + sum(elbow.mass for elbow in arm.elbows)
    square = min(link.section.EA for link in arm.links) / (length * mass)
    move = 0.0
    for motion in scene.motions:
        f = motion.function
        if motion.joint is None:
            jump = max([abs(f(0.0, 1))] + [abs(f(t, 1) - f(t, 1, side="left")) for t in f.kinks if 0.0 < t < end])
            move += jump / np.sqrt(square) + SUDDEN * _largest(f, end, 2) / square
        elif motion.joint == 0:
            move += _largest(f, end, 1) ** 2 * length / square
    return float(move / length)


class _Modes:
    """Flexible modes of a chain about the scene's initial configuration.

    omega (f,) rad/s; shapes (Nn, f): angles of the nodes in each mode, normalised by the inertia (u' M u = 1).
    """

    def __init__(self, scene: Scene, chain: Chain) -> None:
        self.scene, self.chain, arm = scene, chain, scene.arm
        n, m = chain.n, chain.w.size
        payload = arm.payload
        self.angles = np.repeat(scene.angles, n)
        self.cosines = np.cos(self.angles[:, None] - self.angles)
        self.b = chain.b + payload.mass * chain.w
        self.mass = chain.mass + payload.mass
        self.M = (chain.P + payload.mass * np.outer(chain.w, chain.w)) * self.cosines
        K = np.zeros((m, m))
        for k in range(arm.n_links):
            own = slice(k * n, (k + 1) * n)
            self.M[own, own] += chain.R[k]
            K[own, own] = chain.K[k]
        tip = chain.lines[-1].tip_angle
        self.M[m - n :, m - n :] += payload.inertia * np.outer(tip, tip)
        free_root = scene.root == "free"
        M = self.M - np.outer(self.b, self.b) * self.cosines / self.mass if free_root else self.M
        held = {int(k.joint) for k in scene.motions if k.joint is not None} | set(scene.rigid_joints)
        self.basis = np.delete(coordinates(arm, n), [k * n for k in held], axis=1)
        square, self.vectors = _eigh(self.basis.T @ K @ self.basis, self.basis.T @ M @ self.basis)
        flexible = square > 1e-9 * square[-1]
        self.omega: Array = np.sqrt(square[flexible])
        self.shapes: Array = self.basis @ self.vectors[:, flexible]
        self.root = free_root

    def deflection(self, shape: Array) -> float:
        """Largest tip deflection of any link from its root's tangent, m per unit of the mode."""
        n = self.chain.n
        links = [slice(k * n, (k + 1) * n) for k in range(self.scene.arm.n_links)]
        return max(abs(float(self.chain.w[own] @ (shape[own] - shape[own.start]))) for own in links)

    def section_work(self, shape: Array) -> float:
        """int N^2 / EA + Q^2 / C ds of the inertia forces of the mode (per omega^2), along the chain from its tip."""
        chain, arm, n = self.chain, self.scene.arm, self.chain.n
        e = np.array([np.cos(self.angles), np.sin(self.angles)])
        move = np.array([-e[1], e[0]]) * shape  # of the unit tangents
        roots = -(move @ self.b) / self.mass if self.root else np.zeros(2)
        total, force = 0.0, np.zeros(2)
        starts = [roots]
        for k in range(arm.n_links):
            own = slice(k * n, (k + 1) * n)
            starts.append(starts[-1] + move[:, own] @ chain.w[own])
        for k in reversed(range(arm.n_links)):
            own, link, line = slice(k * n, (k + 1) * n), arm.links[k], chain.lines[k]
            last = k == arm.n_links - 1
            force = force + (arm.payload.mass if last else arm.elbow(k + 1).mass) * starts[k + 1]
            finer = np.linspace(0.0, link.length, 65)
            field = starts[k][:, None] + move[:, own] @ line.integral(finer).T
            steps = 0.5 * (field[:, 1:] + field[:, :-1]) * (link.section.m * link.length / 64)
            momentum = np.concatenate([np.zeros((2, 1)), np.cumsum(steps, axis=1)], axis=1)
            beyond = force[:, None] + momentum[:, -1:] - momentum
            along, across = e[:, own][:, 0] @ beyond, np.array([-e[1, own][0], e[0, own][0]]) @ beyond
            density = along**2 / link.section.EA + across**2 / link.section.C
            total += float(np.sum(0.5 * (density[1:] + density[:-1]))) * link.length / 64
            force = force + momentum[:, -1]
        return total

    def amplitude(self, k: int) -> float:
        """How far mode k is moved at most by the scene's loads, motions and gravity, each at its largest."""
        shape, omega = self.shapes[:, k], self.omega[k]
        scene, arm, n = self.scene, self.scene.arm, self.chain.n
        across = np.array([-np.sin(self.angles), np.cos(self.angles)])
        force: float = 0.0
        torques = [load for load in scene.loads if isinstance(load, JointTorque)]
        for load in scene.loads:
            if isinstance(load, JointTorque):
                continue
            s = 0.0 if load.end == "root" else arm.links[load.link].length
            reach, turn = self.chain.arm_to(load.link, s) * shape, self.chain.angle_at(load.link, s) @ shape
            root = -(across * shape) @ self.b / self.mass if self.root else np.zeros(2)
            point = across @ reach + root
            parts = ((load.force_x, point[0]), (load.force_y, point[1]), (load.torque, turn))
            force += sum(_largest(f, scene.duration) * abs(x) for f, x in parts if f is not None)
        limits = arm.torque_limits or (0.0,) * arm.n_links
        for joint in range(arm.n_links):
            given = [_largest(load.function, scene.duration) for load in torques if load.joint == joint]
            peak = sum(given) if scene.loads or scene.motions else limits[joint]
            before = self.chain.lines[joint - 1].tip_angle @ shape[(joint - 1) * n : joint * n] if joint else 0.0
            force += peak * abs(shape[joint * n] - before)
        if scene.gravity is not None:
            force += abs(float((np.asarray(scene.gravity) @ (across * shape)) @ self.b))
        move = SUDDEN * force / omega**2
        for motion in scene.motions:
            move += self._moved_by(motion, shape, omega)
        return float(move)

    def _moved_by(self, motion: Motion, shape: Array, omega: float) -> float:
        if motion.joint is None:
            across = np.array([-np.sin(self.angles), np.cos(self.angles)])[0 if motion.coordinate == "root_x" else 1]
            share = abs(float(self.b @ (across * shape)))
        else:
            share = abs(float((self.M @ shape)[motion.joint * self.chain.n :].sum()))  # all that follows turns with it
        f, end = motion.function, self.scene.duration
        jump = max([abs(f(0.0, 1))] + [abs(f(t, 1) - f(t, 1, side="left")) for t in f.kinks if 0.0 < t < end])
        return share * (jump / omega + SUDDEN * _largest(f, end, 2) / omega**2)


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
