"""Equations of motion of a Simulation's arm as functions, with derivatives and independent coordinates.

    r(q, v, a, lambda, u) = M(q) a + h(q, v) + Phi_q^T lambda - B u = 0,   Phi(q) = 0

The residual is linear in a, lambda and u and quadratic in v, so differences by these have no truncation error; those by
q are of sixth order with a step of 0.5 % of a coordinate's scale (truncation 1e-16, round-off 1e-13).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import validation as check
from ..compiler import SINGLE, size
from ..physics.assembly import assemble, physical, room_for_points, smooth
from ..physics.equations import equations
from ..physics.floating.layout import LINK, MULTIPLIERS, SIZE, START
from ..physics.layout import POSE
from ..physics.model import FloatingFrame
from ..physics.protocol import State
from ..runtime.sampling import observe_arm
from ..simulation import Simulation
from ..trajectory import joint_angles
from ..validation import Array

Rows = NDArray[np.int64]

STEP = 5e-3
"""Step of differences by q, times the size that matters of a coordinate (1 rad, the arm's length)."""

SIXTH, SECOND = ((1, 3 / 4), (2, -3 / 20), (3, 1 / 60)), ((1, 1 / 2),)
"""(how many steps to both sides, weight) of differences of these orders."""


@dataclass(frozen=True)
class Point:
    """Coordinates (multipliers included), rates and accelerations (n,), inputs and prescribed values at an instant."""

    q: Array
    v: Array
    a: Array
    u: Array
    psi: Array


@dataclass(frozen=True)
class Reduced:
    """M x'' + C x' + K x = B u about a point, x the independent coordinates; rows that can move follow by
    dq = lift x, dv = lift x' + drift x, da = lift x'' + bend_v dv + bend_q dq."""

    M: Array
    C: Array
    K: Array
    B: Array
    lift: Array
    drift: Array
    bend_v: Array
    bend_q: Array

    def among(self, keep: Sequence[int]) -> tuple[Array, Array, Array]:
        """Return M, C and K of some coordinates, with the other coordinates fixed."""
        pick = np.ix_(keep, keep)
        return self.M[pick], self.C[pick], self.K[pick]

    def accelerations(self, driven: Rows) -> tuple[Array, Array]:
        """Return the derivatives of x'' by (x, x', u), (n, 2 n + inputs), and by prescribed accelerations, (n,
        driven)."""
        rest = np.setdiff1d(np.arange(len(self.M)), driven)
        right = np.hstack([-self.K, -self.C, self.B, -self.M[:, driven]])[rest]
        found = np.zeros((len(self.M), right.shape[1]))
        found[rest] = np.linalg.solve(self.M[np.ix_(rest, rest)], right)
        found[driven, right.shape[1] - len(driven) + np.arange(len(driven))] = 1.0
        return found[:, : right.shape[1] - len(driven)], found[:, right.shape[1] - len(driven) :]


def slopes(f: Callable[[Array], Array], x: Array, rows: Rows, steps: Array, weights: Any = SIXTH) -> Array:
    """Return df/dx by central differences, one column for each of the given rows of x."""
    if not len(rows):
        return np.zeros((f(x).size, 0))
    columns = []
    for k in rows:
        moved, total = x.copy(), np.zeros(())
        for i, weight in weights:
            moved[k] = x[k] + i * steps[k]
            ahead = f(moved)
            moved[k] = x[k] - i * steps[k]
            total = total + weight * (ahead - f(moved))
        columns.append(total / steps[k])
    return np.array(columns).T


def exact_slopes(f: Callable[[Array], Array], x: Array, rows: Rows) -> Array:
    """Return df/dx of an f of at most second degree in x, for which central differences with step 1 are exact."""
    return slopes(f, x, rows, np.ones(len(x)), SECOND)


class Equations:
    """Equations of motion of one arm.

    Attributes:
        free: rows of q that can move (no multiplier, not fixed, not prescribed). algebraic: rows of multipliers.
        independent, dependent: positions in `free`; the frame behind a joint of the floating frame depends on the one
            before it. joints: turnable joints, each with its position among the independent coordinates.
        turned: joints that a torque can turn, each with the position of the angle on which the torque acts: the motor's
            angle with an elastic gear, otherwise the joint's angle. motors: rows of the motors' angles behind elastic
            gears.
        names: names of the independent coordinates, "joint0", ... for the joints that can turn, "motor0", ... for
            motors.
        driven: the prescribed coordinates, in the order of the scene's motions.
    """

    def __init__(self, simulation: Simulation, stepping: bool = False, driven: bool = False) -> None:
        """stepping: with the inertia that the solver steps with, which may hold a correction of its period. driven:
        prescribed coordinates are rows that can move."""
        if simulation.scene.spatial:
            what = "must be a scene in the plane; in space there are `linearize`, `modes` and `static_equilibrium`"
            raise check.InvalidValue("scene", simulation.scene.name, what)
        system, model = simulation.system, smooth(simulation.model) if stepping else physical(simulation.model)
        self._simulation = simulation
        self.model, self.par, self.n_links = model, simulation.par, simulation.scene.arm.n_links
        self.n = int(size(model.n))
        self._most_points = room_for_points(simulation.settings, self.n_links)
        self._room = np.zeros(int(size(model.n_factor)))
        self.algebraic = np.asarray(() if model.algebraic is None else model.algebraic, np.int64)
        prescribed = [int(k) for k in simulation.drive.known if k >= 0]
        known = [] if driven else prescribed
        still = {*known, *self.algebraic.tolist(), *(() if model.fixed is None else model.fixed.tolist())}
        self.free: Rows = np.array([k for k in range(self.n) if k not in still], np.int64)
        self.steps = STEP / model.weight
        place = {int(row): i for i, row in enumerate(self.free)}
        dependent = [place[row] for row in _dependent(model)]
        self.dependent: Rows = np.array(dependent, np.int64)
        self.independent: Rows = np.array([i for i in range(len(self.free)) if i not in dependent], np.int64)
        order = {int(self.free[i]): j for j, i in enumerate(self.independent)}
        rows = _joint_rows(simulation)
        self.joints = {k: order[row] for k, row in rows.items() if row in order}
        self.motors, self.base = motor_rows(simulation), simulation.system.coordinates.get("base")
        acted = {k: self.motors.get(k, row) for k, row in rows.items()}
        self.turned = {k: order[row] for k, row in acted.items() if row in order}
        given = {row: f"joint{k}" for k, row in rows.items()} | {
            system.coordinates[name]: name for name in ("root_x", "root_y") if name in system.coordinates
        }
        moving = [int(self.free[i]) for i in self.independent]
        self.names = tuple(given.get(row, system.names[row]) for row in moving)
        self.pairs, self.angles = system.vectors, list(system.absolute)
        self.in_pairs = [(order[x], order[y]) for x, y in self.pairs if x in order and y in order]
        grounded = simulation.scene.root == "pinned" or simulation.scene.floats
        turning = [k for k, i in self.turned.items() if moving[i] not in prescribed and (k > 0 or grounded)]
        self.inputs: Rows = np.array(turning, np.int64)
        self.driven: Rows = np.array([order[row] for row in prescribed if row in order], np.int64)
        self._no_inputs, self._psi = np.zeros(int(size(model.n_inputs))), simulation.work.psi.copy()
        self._poses, self._energies = np.zeros(POSE.end * self.n_links), np.zeros(3)

    def under(self, share: float) -> Equations:
        """Return the equations with gravity multiplied by a factor."""
        scene = self._simulation.scene
        if scene.gravity is None or share == 1.0:
            return self
        lighter = replace(scene, gravity=(share * scene.gravity[0], share * scene.gravity[1]))
        other = copy(self)
        other.model = physical(assemble(lighter, self._simulation.settings).model)
        return other

    def residual(self, point: Point, level: int = 0) -> Array:
        """r (n,), rows of multipliers: constraints (level 0), their first or second rate (1, 2)."""
        r = np.zeros(self.n)
        self._evaluate(point, level, r)
        return r

    def status(self, q: Array) -> int:
        """Return the model's status code (`flexarm_env.physics.model`) at a point."""
        zero = np.zeros(self.n)
        return self._evaluate(Point(q, zero, zero, self._no_inputs, self._psi), 0, zero.copy())

    def _evaluate(self, p: Point, level: int, r: Array) -> int:
        return int(equations(SINGLE, self.model, self.par, State(p.q, p.v, p.a), p.u, p.psi, level, r, self._room))

    def poses(self, q: Array, v: Array) -> Array:
        """Poses of the links (`physics.layout`), (n_links, 12)."""
        self._observe(q, v, np.zeros((0, 2)))
        return self._poses.reshape(-1, POSE.end).copy()

    def points(self, q: Array) -> Array:
        """Points along the chain, root to tip, (points, 2), m."""
        points = np.full((self._most_points, 2), np.nan)
        return points[: self._observe(q, np.zeros(self.n), points)].copy()

    def _observe(self, q: Array, v: Array, points: Array) -> int:
        return int(observe_arm(SINGLE, self.model, self.par, q, v, self._poses, self._energies, points))

    def joint_angles(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Joint angles and rates (n_links,) each: a link's root less the tip before it, or a base that floats."""
        angles, rates = joint_angles(self.poses(q, v))
        if self.base is not None:
            angles[0], rates[0] = angles[0] - q[self.base], rates[0] - v[self.base]
        return angles, rates

    def joint_slopes(self, q: Array) -> Array:
        """Return the constant derivatives (n_links, f) of the joint angles by the rows that can move."""
        return slopes(lambda x: self.joint_angles(x, np.zeros(self.n))[0], q, self.free, self.steps)

    def motor_angles(self, q: Array) -> Array:
        """Return the angles (n_links,) on which joint torques act: motor angles relative to the link before."""
        angles = self.joint_angles(q, np.zeros(self.n))[0]
        for k, row in self.motors.items():
            angles[k] = q[row]
        return angles

    def motor_slopes(self, q: Array) -> Array:
        """Return the constant derivatives (n_links, f) of the motor angles by the rows that can move."""
        slope = self.joint_slopes(q)
        for k, row in self.motors.items():
            slope[k] = self.free == row
        return slope

    def rotating(self, q: Array, spin: float) -> tuple[Array, Array]:
        """Return rates and accelerations of a rigid rotation about the origin at a steady rate, rad/s."""
        v, a = np.zeros(self.n), np.zeros(self.n)
        if spin == 0.0:
            return v, a
        for x, y in self.pairs:
            v[x], v[y] = -spin * q[y], spin * q[x]
            a[x], a[y] = -(spin**2) * q[x], -(spin**2) * q[y]
        v[self.angles] = spin
        return v, a

    def slope(self, point: Point, field: str, rows: Rows, level: int = 0) -> Array:
        """Return the derivative (n, rows) of the residual at a level by some rows of a field of the point."""

        def moved(x: Array) -> Array:
            return self.residual(replace(point, **{field: x}), level)

        at: Array = getattr(point, field)
        return slopes(moved, at, rows, self.steps) if field == "q" else exact_slopes(moved, at, rows)

    def constraint_slopes(self, point: Point) -> Array:
        """Return the derivatives (m, f) of the constraints by the rows that can move."""
        if not self.algebraic.size:
            return np.zeros((0, self.free.size))
        return self.slope(replace(point, v=np.zeros(self.n)), "v", self.free, 1)[self.algebraic]

    def reduced(self, point: Point, spin: float = 0.0) -> Reduced:
        """Return the equations in independent coordinates. With a spin (rad/s) positions turn with the arm: then the
        point is one of steady rotation about the origin, and the matrices are constant in time."""
        free, lam, here, there = self.free, self.algebraic, self.independent, self.dependent
        f, n = free.size, here.size
        M, C, K = (self.slope(point, field, free)[free] for field in "avq")
        B = -self.slope(point, "u", self.inputs)[free]
        lift, drift = np.zeros((f, n)), np.zeros((f, n))
        bend_v, bend_q = np.zeros((f, f)), np.zeros((f, f))
        lift[here] = np.eye(n)
        if there.size:
            G = self.constraint_slopes(point)
            inverse = np.linalg.inv(G[:, there])
            lift[there] = -inverse @ G[:, here]
            drift[there] = -inverse @ self.slope(point, "q", free, 1)[lam] @ lift
            bend_v[there] = -inverse @ self.slope(point, "v", free, 2)[lam]
            bend_q[there] = -inverse @ self.slope(point, "q", free, 2)[lam]
        damping, stiffness = C + M @ bend_v, K + M @ bend_q
        M, C, B = lift.T @ M @ lift, lift.T @ damping @ lift, lift.T @ B
        _check_mass(M)
        K = lift.T @ (damping @ drift + stiffness @ lift)
        if spin != 0.0:  # x = T(w t) xi: x' = xi' + w S xi, x'' = xi'' + 2 w S xi' + w^2 S^2 xi at t = 0
            S = np.zeros((n, n))
            for x, y in self.in_pairs:
                S[x, y], S[y, x] = -1.0, 1.0
            K = K + spin * C @ S + spin**2 * M @ S @ S
            C = C + 2.0 * spin * M @ S
        if there.size:  # the turn of a frame behind a hinge -> the joint's angle
            change = np.eye(n)
            jacobian = self.joint_slopes(point.q) @ lift
            for k, i in self.joints.items():
                change[i] = jacobian[k]
            back = np.linalg.inv(change)
            M, C, K, B = back.T @ M @ back, back.T @ C @ back, back.T @ K @ back, back.T @ B
            lift, drift = lift @ back, drift @ back
        return Reduced(M, C, K, B, lift, drift, bend_v, bend_q)

    def state(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Independent coordinates and their rates, in the order of `names`."""
        rows = self.free[self.independent]
        x, rate = q[rows], v[rows]
        angles, rates = self.joint_angles(q, v)
        for k, i in self.joints.items():
            x[i], rate[i] = angles[k], rates[k]
        return x, rate

    def changes(self, q: Array, dq: Array) -> Array:
        """Return changes (n, columns) of the independent coordinates, from changes (f, columns) of the rows that can
        move."""
        result = dq[self.independent]
        if self.dependent.size:
            turns = self.joint_slopes(q) @ dq
            for k, i in self.joints.items():
                result[i] = turns[k]
        return result


def _check_mass(M: Array) -> None:
    """Raise ValueError where some coordinate has no inertia."""
    size = np.sqrt(np.maximum(M.diagonal(), 0.0))
    if not (size > 0.0).all() or np.linalg.eigvalsh(M / np.outer(size, size)).min() < 1e-14:
        raise ValueError(
            "the mass matrix is singular, so there is no state space: some coordinate has no inertia "
            "(a link reduced to modes needs a hub inertia)"
        )


def _dependent(model: object) -> list[int]:
    """Rows that the constraints determine: the frame behind each joint, its angle where the joint does not hinge."""
    if not isinstance(model, FloatingFrame):
        return []
    rows = []
    for body, behind in zip(model.table[:-1], model.table[1:], strict=True):
        assert behind[START] == body[START] + 3 + body[SIZE] + body[MULTIPLIERS]
        rows += [int(behind[START]) + i for i in range(int(body[MULTIPLIERS]))]
    return rows


def _joint_rows(simulation: Simulation) -> dict[int, int]:
    """Row of each joint that has one: of its angle, or of the frame that turns with it."""
    system, model = simulation.system, simulation.model
    rows = {}
    for k in range(simulation.scene.arm.n_links):
        if isinstance(model, FloatingFrame):
            rows[k] = next(int(body[START]) + 2 for body in model.table if body[LINK] == k)
        else:
            rows[k] = system.coordinates[f"joint{k}"]
    return rows


def motor_rows(simulation: Simulation) -> dict[int, int]:
    """Row of each motor behind an elastic gear."""
    found = {k: simulation.system.coordinates.get(f"motor{k}") for k in range(simulation.scene.arm.n_links)}
    return {k: row for k, row in found.items() if row is not None}
