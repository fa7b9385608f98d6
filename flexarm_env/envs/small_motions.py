"""Linear model of small motions of an arm in the plane, with a mesh, a step, and torques held in each control period.

The links are nearly straight elasticas. The coordinates x are the tangent angles at the nodes of
`physics.elastica.chain`, rad, and the angles of motors with elastic gears, rad. For a floating base the coordinates
also include its position, m, and attitude, rad. The equations are

    M x'' + C x' + K x = B u,    tip = c x,    motor and joint angles = B^T x

`Motion.of` assembles the matrices M, C, K and B. For the elastica the tangent angle of a link is one polynomial. For
every formulation except the elastica, the tangent angle is quadratic in each element, since the displacements of a beam
element are cubic. `Motion.exact` advances x by a control period with the matrix exponential, `Motion.stepped` with the
integrator's steps.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise

import numpy as np

from ..batch import Amplifier
from ..bodies import about_z
from ..parameters import Arm
from ..physics.elastica.build import payload_arm, phase_correction
from ..physics.elastica.chain import Chain, Line, basis, chain, chain_of, gauss
from ..sections import Link
from ..settings import Settings
from ..tasks import RESIDUAL_SHARE
from ..validation import Array

CARRIED = 1e13
"""Largest squared frequency, rad^2/s^2; with larger squared frequencies round-off (1e-16) would give rigid rotations a
frequency."""

FINE = 12
"""Number of nodes of a reference link: FINE minus 2 for each link of the arm, but at least 6."""

PERIODS = 100
"""Number of control periods simulated."""

HELD = (1, 8, 8, 25)
"""Numbers of control periods for which each run holds its actions. From the last run only the spin is used."""


@lru_cache(8)
def actions(count: int) -> Array:
    """Return random bang-bang actions of +-1, (PERIODS, N, runs); in run r each action lasts HELD[r] periods."""
    draw, found = np.random.default_rng(5), []
    for held in HELD:
        signs = np.where(draw.random((-(-PERIODS // held), count)) < 0.5, -1.0, 1.0)
        found.append(np.repeat(signs, held, axis=0)[:PERIODS])
    return np.stack(found, axis=2)


class Elements(Line):
    """Link of n elements; its tangent angle is continuous, and quadratic in each element."""

    @classmethod
    def cut(cls, link: Link, n: int) -> Elements:
        """Divide a link into at least n elements, with ends at the jumps of its section."""
        ends = link.mesh(max(n, len(link.jumps) + 1), "elements")
        pieces = tuple((a, b, 2 * i, basis(3, True)) for i, (a, b) in enumerate(pairwise(ends.tolist())))
        return cls(link, 2 * len(pieces) + 1, pieces)

    def quadrature(self) -> tuple[Array, Array]:
        """Return five Gauss points (m from the root) and weights (m) per element, element by element."""
        x, weights = gauss(5)
        spans = [(a, 0.5 * (b - a)) for a, b, *_ in self.pieces]
        points = [a + half * (x + 1.0) for a, half in spans]
        return np.concatenate(points), np.concatenate([half * weights for _, half in spans])


@lru_cache(64)
def fine(arm: Arm) -> Chain:
    """Return the matrices of the reference model: polynomials of high order between jumps and kinks of sections."""
    nodes = max(FINE - 2 * arm.n_links, 6)
    pieces = max(len(link.jumps) for link in arm.links) + 1
    return chain(arm, nodes if pieces == 1 else 5 * pieces + 1)


@lru_cache(64)
def cut(arm: Arm, elements: int) -> Chain:
    """Return the matrices of an arm with at least the given number of beam elements per link.

    All links have the same number of elements: the largest number that any link requires.
    """
    lines = [Elements.cut(link, elements) for link in arm.links]
    most = max(line.n for line in lines)
    return chain_of(arm, [Elements.cut(line.link, (most - 1) // 2) for line in lines])


@dataclass(frozen=True)
class Motion:
    """Linear model of small motions about a posture, M x'' + C x' + K x = B u, with n coordinates x and N torques u."""

    M: Array  # (n, n) inertia matrix
    C: Array  # (n, n) damping matrix
    K: Array  # (n, n) stiffness matrix
    S: Array  # (n, n) effective inertia matrix in steps of h; equal to M unless the period is corrected
    B: Array  # (n, N): generalized forces per joint torque; B^T x: motor or joint angles, rad
    tip: Array  # (2, n), in space (3, n): displacement of the tip per coordinate, m, inertial axes
    bend: Array  # (N, n): rotation of each link's tip relative to its root, rad; in space (3 flexible links, n)

    @classmethod
    def of(cls, arm: Arm, parts: Chain, pose: Array, settings: Settings | None = None, h: float = 0.0) -> Motion:
        """Return the small motions of a planar arm about absolute link angles `pose` (N,), rad.

        parts: matrices of the links. settings: the integrator's settings; None for the continuous equations. h: step of
        the integrator, s.
        """
        n, count, m = parts.n, arm.n_links, parts.w.size
        # M_ij = P_ij cos(alpha_i - alpha_j), payload and rotary inertia (theory, eq. 5.2), about straight links
        alpha = np.repeat(pose, n)
        to = payload_arm(parts, arm.payload) * np.exp(1j * alpha)
        M = parts.P * np.cos(alpha[:, None] - alpha) + arm.payload.mass * np.outer(to.conj(), to).real
        K, C, correction = np.zeros((m, m)), np.zeros((m, m)), np.zeros((m, m))
        B, bend = np.zeros((m, count)), np.zeros((count, m))
        for k, (line, link) in enumerate(zip(parts.lines, arm.links, strict=True)):
            own = slice(k * n, (k + 1) * n)
            M[own, own] += parts.R[k]
            K[own, own] = parts.K_EI[k]
            C[own, own] = (arm.tau_d if link.tau_d is None else link.tau_d) * parts.K_EI[k]
            # the joint turns its link's root against the tip of the link before
            B[k * n, k] = 1.0
            bend[k, own], bend[k, k * n] = line.tip_angle, line.tip_angle[0] - 1.0
            if k + 1 < count:
                B[own, k + 1] = -line.tip_angle
        M[own, own] += about_z(arm.payload.inertia) * np.outer(line.tip_angle, line.tip_angle)
        # inertia that steps of h see: S = M - correction (theory, eq. 5.3)
        if settings is not None and settings.formulation == "elastica":
            found = phase_correction(parts, arm.payload.mass, payload_arm(parts, arm.payload), None, h, settings)
            for k in range(count):
                correction[k * n : (k + 1) * n, k * n : (k + 1) * n] = found[k]
        elif settings is not None:  # the scheme's period is longer than the trapezoidal rule's
            correction = -2.0 * (settings.period_error - 1.0 / 12.0) * h * h * K
        # a node's angle moves the tip by w_i n_i, n_i normal to the tangent
        tip = np.stack([-parts.w * np.sin(alpha), parts.w * np.cos(alpha)])
        made = cls(M, C, K, M - correction, B, tip, bend)
        if arm.base is not None:
            first = parts.b * np.exp(1j * alpha) + arm.payload.mass * to
            made = made.floating(arm, 1j * first, parts.mass + arm.payload.mass)
        return made.jointed(arm)

    def grown(self, more: int) -> Motion:
        """Return the model with `more` additional coordinates, whose rows and columns in the matrices are 0."""
        M, C, K, S = (np.pad(x, ((0, more), (0, more))) for x in (self.M, self.C, self.K, self.S))
        tip, bend = (np.pad(x, ((0, 0), (0, more))) for x in (self.tip, self.bend))
        return Motion(M, C, K, S, np.pad(self.B, ((0, more), (0, 0))), tip, bend)

    def floating(self, arm: Arm, first: Array, mass: float) -> Motion:
        """Return the model with the position (m) and attitude (rad) of a floating base as three more coordinates.

        first (n,): derivative of the arm's momentum by the rate of each coordinate, complex x + i y, kg m. mass: mass
        of the arm, kg. The hub's torque acts on the base with the opposite sign.
        """
        assert arm.base is not None
        made, n = self.grown(3), len(self.M)
        for matrix in (made.M, made.S):
            # rows of the momenta in x and y, then the base's attitude
            for i, row in enumerate((first.real, first.imag)):
                matrix[n + i, :n] = matrix[:n, n + i] = row
                matrix[n + i, n + i] = mass + arm.base.mass
            matrix[n + 2, n + 2] = arm.base.inertia
        made.B[n + 2, 0] = -1.0
        made.tip[:, n : n + 2] = np.eye(2)
        return made

    def jointed(self, arm: Arm) -> Motion:
        """Return the model with rotors, elastic gears and viscous friction of the joints added.

        Backlash and Coulomb friction are not included.
        """
        made = self
        for k in range(arm.n_links):
            joint = arm.joint(k)
            if not joint.moves:
                continue
            # turns^T x: the angle that the torque turns, of the joint or its motor
            turns = made.B[:, k].copy()
            # elastic gear: a motor angle of its own, on which the torque acts, coupled by stiffness and damping
            if joint.elastic:
                made = made.grown(1)
                motor = np.zeros(len(made.M))
                motor[-1] = 1.0
                give = motor - np.append(turns, 0.0)
                made.K[...] += joint.stiffness * np.outer(give, give)
                made.C[...] += joint.damping * np.outer(give, give)
                made.B[:, k] = turns = motor
            # rotor and friction act on the angle that the torque turns
            for matrix in (made.M, made.S):
                matrix += joint.rotor * np.outer(turns, turns)
            made.C[...] += joint.friction_viscous * np.outer(turns, turns)
        return made

    def softened(self, most: float) -> Motion:
        """Return the model with all vibration frequencies limited to `most` rad/s.

        Higher frequencies cause round-off errors and hardly move the arm. With M-normalized mode shapes V the stiffness
        matrix is K = M V diag(w^2) V^T M. In K, C and M - S, the rows and columns of modes with w > most are multiplied
        by most / w. S is the integrator's mass matrix.
        """
        squares, V = vibrations(self.M, self.K)
        if not squares[-1] < CARRIED:
            raise np.linalg.LinAlgError("stiffness that double precision does not carry beside free turns")
        scale = np.minimum(1.0, most / np.sqrt(np.maximum(squares, 1e-300)))
        if scale.min() == 1.0:
            return self
        MV = self.M @ V

        def soft(X: Array) -> Array:
            """Scale rows and columns of the matrix X in modal coordinates."""
            return np.asarray(MV @ (scale[:, None] * (V.T @ X @ V) * scale) @ MV.T, np.float64)

        return replace(self, C=soft(self.C), K=soft(self.K), S=self.M - soft(self.M - self.S))

    def _rates(self, M: Array) -> Array:
        """Return the matrices A and B side by side: (x, x')' = A (x, x') + B u, with inertia M."""
        n = len(M)
        solved = np.linalg.solve(M, np.hstack([-self.K, -self.C, self.B]))
        return np.vstack([np.hstack([np.zeros((n, n)), np.eye(n), np.zeros_like(self.B)]), solved])

    def exact(self, period: float) -> Array:
        """Return the exact transition matrix (2 n, 2 n + N) from the state (x, x') and the torques to the next state.

        period: time from one state to the next, s.
        """
        return self._whole(exponential, self._rates(self.M) * period)

    def stepped(self, h: float, steps: int) -> Array:
        """Return the transition matrix (2 n, 2 n + N) of `steps` trapezoidal steps of h seconds, with mass matrix S."""
        # (1 - h/2 A) z+ = (1 + h/2 A) z + h B u
        A = self._rates(self.S) * (0.5 * h)
        rows = len(A)
        ahead = np.hstack([np.eye(rows) + A[:, :rows], 2.0 * A[:, rows:]])
        one = np.asarray(np.linalg.solve(np.eye(rows) - A[:, :rows], ahead), np.float64)
        below: Array = np.eye(one.shape[1] - rows)
        return self._whole(lambda whole: np.asarray(np.linalg.matrix_power(whole, steps), np.float64), one, below)

    def _whole(self, power: Callable[[Array], Array], rows: Array, below: Array | None = None) -> Array:
        """Return the upper rows of a function of the square matrix [rows; below]; columns: state, then torques.

        power: matrix function, exponential or power. below: (N, N) block for the torques; None means 0, as for an
        exponential.
        """
        size, count = rows.shape[1], rows.shape[1] - len(rows)
        whole = np.zeros((size, size))
        whole[: len(rows)] = rows
        if below is not None:
            whole[-count:, -count:] = below
        return np.asarray(power(whole)[: len(rows)])

    def respond(self, advance: Array, torques: Callable[[int, Array, Array], Array], periods: int, runs: int) -> Array:
        """Return the response to torques over control periods, (periods, 2 + 2 N, runs).

        The rows are the tip displacement (m; three rows in space), motor or joint angles (rad), and each link's angle
        between root and tip (rad). advance: transition matrix from `exact` or `stepped`. torques: function of (period,
        angles (N, runs), rates (N, runs)) that returns torques (N, runs), N m.
        """
        n = len(self.M)
        seen = np.vstack([self.tip, self.B.T, self.bend])
        state, found = np.zeros((2 * n, runs)), np.empty((periods, len(seen), runs))
        for k in range(periods):
            u = torques(k, self.B.T @ state[:n], self.B.T @ state[n:])
            state = advance @ np.vstack([state, u])
            found[k] = seen @ state[:n]
        return found


@dataclass(frozen=True)
class Drive:
    """Actuation of the N joints in the linear model: torques, a PD loop, or an amplifier with back-emf."""

    torques: tuple[float, ...]  # (N,) joint torques at full action, N m
    residual: float | None = None  # share of the torque limits that the action adds to the PD loop; None: no PD loop
    emf: tuple[float, ...] | None = None  # (N,) back-emf constants of motors under voltage, N m s/rad; None: none
    limits: tuple[float, ...] = ()  # (N,) torque limits, N m

    @classmethod
    def of(cls, arm: Arm, mode: str, share: float | None, amplifier: Amplifier | None) -> Drive:
        """Return the drive that an environment has with an action mode, a residual share and an amplifier (or None)."""
        limits = arm.torque_limits
        assert limits is not None
        if amplifier is not None:
            emf = None if amplifier.emf is None else tuple(amplifier.emf.tolist())
            return cls(tuple(amplifier.gain.tolist()), None, emf, tuple(amplifier.limits.tolist()))
        if mode == "residual_pd":
            return cls(limits, RESIDUAL_SHARE if share is None else share, None, limits)
        return cls(limits, limits=limits)


def exponential(A: Array) -> Array:
    """Return exp(A), computed by scaling and squaring of a Taylor polynomial of degree 8."""
    halvings = max(0, math.ceil(math.log2(max(float(np.abs(A).sum(axis=1).max()), 1e-300))) + 4)
    small, one = A * 0.5**halvings, np.eye(len(A))
    found: Array = np.eye(len(A))
    for k in range(8, 0, -1):
        found = one + small @ found / k
    for _ in range(halvings):
        found = found @ found
    return found


def vibrations(M: Array, K: Array) -> tuple[Array, Array]:
    """Return squared angular frequencies (ascending, at least 0) and M-normalized mode shapes of M x'' + K x = 0."""
    # symmetric standard form L^-1 K L^-T with M = L L^T
    factor = np.linalg.cholesky(M)
    half = np.linalg.solve(factor, K)
    squares, turned = np.linalg.eigh(np.linalg.solve(factor, half.T))
    return np.maximum(squares, 0.0), np.asarray(np.linalg.solve(factor.T, turned), np.float64)


def frequency_unless_damped(motion: Motion, number: int, most: float) -> float:
    """Return the angular frequency, rad/s, of mode `number` (from 0); 0.0 if its damping ratio exceeds `most`."""
    squares, shapes = vibrations(motion.M, motion.K)
    rates = np.sqrt(squares)
    # rigid turns, with frequency 0, do not count
    k = min(len(rates) - 1, int((rates < 1e-6 * rates[-1]).sum()) + number)
    damping = float(shapes[:, k] @ motion.C @ shapes[:, k]) / (2.0 * rates[k])
    return 0.0 if damping > most else float(rates[k])


def poses(n_links: int) -> Sequence[Array]:
    """Return two postures of small motions, straight and with elbows at 90 degrees, as link angles (N,), rad."""
    square: Array = 0.5 * np.pi * (np.arange(n_links, dtype=np.float64) % 2.0)
    return [np.zeros(1)] if n_links == 1 else [np.zeros(n_links), square]
