"""Equations of motion of one arm, in the plane and in space, as functions with exact derivatives.

    r(q, v, a, lambda, u) = M(q) a + h(q, v) + Phi_q^T lambda - B u = 0,   Phi(q) = 0

Derivatives are tangents of the residual in dual lanes (`physics.equations`), along directions of the tangent space. For
a rotation, a direction is an increment d in the section's own axes. Rotations do not add up: a section with the axes A
exp(d^) has the angular velocity w + d' + w x d, to first order of d. Increments d with time derivatives d', d''
therefore change rates and accelerations by (`Frame`)

    dv = d' + V d,        da = d'' + U d' + W d
"""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from .. import rotations
from ..compiler import SINGLE, UNCOMPILED, size, uncompiled
from ..physics.assembly import assemble, physical, smooth
from ..physics.equations import WITH_SLOPES, Directions, pose_slopes, residual_slopes, slopes_room
from ..physics.floating.layout import LINK, MULTIPLIERS, SIZE, START
from ..physics.layout import BASE_POSE
from ..physics.model import FloatingFrame
from ..physics.protocol import State, retract
from ..physics.reading import joint_angles, reading_of
from ..physics.space.layout import AXES
from ..rigid import axis_of, mount_of
from ..simulation import Simulation
from ..validation import Array
from .differences import derivative, step_along
from .reduced import Frame, Point, Reduced, Rows, check_mass


class Equations:
    """Equations of motion of one arm, with their derivatives.

    Attributes:
        free: rows of q that can move: not multipliers, not fixed, not prescribed. algebraic: rows of q with Lagrange
            multipliers.
        independent, dependent: indices, in `free`, of independent coordinates, and of coordinates that constraints
            determine. joints: joints that can turn, each with its index among the independent coordinates.
        turned: joints on which a torque can act, each with the index of the angle on which it acts: the motor's angle
            with an elastic gear, otherwise the joint's angle. rows_turned: row of q of this angle, for every joint.
        motors: rows of q with the motors' angles at elastic gears. turning (k, 3): rows of q with rotation vectors.
        names: names of the independent coordinates: "joint0", ... for joints that can turn, "motor0", ... for motors.
        driven: names of the prescribed coordinates, in the order of the scene's motions.
    """

    def __init__(self, simulation: Simulation, stepping: bool = False, driven: bool = False) -> None:
        """Set up the equations of a simulation.

        stepping: True to use the solver's inertia, which may contain a correction of the integrator's period error.
        driven: True if prescribed coordinates count as rows that can move.
        """
        system, scene = simulation.system, simulation.scene
        self.simulation, self.par, self.n_links = simulation, simulation.par, scene.arm.n_links
        self.names_of_rows, self.reading = system.names, reading_of(scene)
        self.model = model = smooth(simulation.model) if stepping else physical(simulation.model)
        self.n = int(size(model.n))
        self._room = np.zeros(
            int(uncompiled(slopes_room)(WITH_SLOPES, model, len(self.par), simulation.n_motions))
        )
        self.algebraic = np.asarray(() if model.algebraic is None else model.algebraic, np.int64)
        prescribed = [int(k) for k in simulation.drive.known if k >= 0]
        still = {*self.algebraic.tolist(), *np.flatnonzero(model.weight == 0.0).tolist()}
        still |= {*([] if driven else prescribed), *(() if model.fixed is None else model.fixed.tolist())}
        self.free: Rows = np.array([k for k in range(self.n) if k not in still], np.int64)
        # a dependent row follows from other free rows through the constraints
        place = {int(row): i for i, row in enumerate(self.free)}
        dependent = [place[row] for row in _dependent(model)]
        self.dependent: Rows = np.array(dependent, np.int64)
        self.independent: Rows = np.array([i for i in range(len(self.free)) if i not in dependent], np.int64)
        order = {int(self.free[i]): j for j, i in enumerate(self.independent)}
        rows = _joint_rows(simulation)
        self.joints = {k: order[row] for k, row in rows.items() if row in order}
        self.motors, self.base = motor_rows(simulation), system.coordinates.get("base")
        acted = {k: self.motors.get(k, row) for k, row in rows.items()}
        self.rows_turned = [acted[k] for k in range(self.n_links)]
        self.turned = {k: order[row] for k, row in acted.items() if row in order}
        given = {row: f"joint{k}" for k, row in rows.items()} | {
            system.coordinates[name]: name for name in ("root_x", "root_y") if name in system.coordinates
        }
        moving = [int(self.free[i]) for i in self.independent]
        self.names = tuple(given.get(row, system.names[row]) for row in moving)
        grounded = scene.root == "pinned" or scene.floats
        turning = [k for k, i in self.turned.items() if moving[i] not in prescribed and (k > 0 or grounded)]
        self.inputs: Rows = np.array(turning, np.int64)
        self.driven: Rows = np.array([order[row] for row in prescribed if row in order], np.int64)
        # rows of angles that a steady rotation turns: absolute angles, in space those of the first joint
        root = [system.coordinates[name] for name in ("joint0", "motor0") if name in system.coordinates]
        self.pairs, self.turned_rigidly = system.vectors, list(system.absolute) or root
        first = [k for k, name in enumerate(system.names) if name == "root_rx" or ".rx" in name]
        self.turning: Rows = np.array(first, np.int64).reshape(-1, 1) + np.arange(3)
        self._no_inputs, self._psi = np.zeros(int(size(model.n_inputs))), simulation.work.psi.copy()
        self._no_gauges = np.zeros((0, self.n))

    def under(self, share: float) -> Equations:
        """Return the equations of the same arm with gravity multiplied by the factor `share`."""
        scene = self.simulation.scene
        if scene.gravity is None or share == 1.0:
            return self
        lighter = replace(scene, gravity=(share * scene.gravity[0], share * scene.gravity[1]))
        other = copy(self)
        other.model = physical(assemble(lighter, self.simulation.settings).model)
        return other

    # --- residual and its derivatives ------------------------------------------------------------------------------

    def residual(self, point: Point, level: int = 0) -> Array:
        """Return the residual r (n,), in N and N m, at a point.

        level: selects the rows of multipliers: the constraints (0), or their first (1) or second (2) time derivatives.
        """
        return self._evaluate(point, _none(self.n, len(point.u)), level)[0]

    def status(self, q: Array) -> int:
        """Return the status code (`flexarm_env.physics.model`) of the arm's model at the coordinates q."""
        zero = np.zeros(self.n)
        none = _none(self.n, len(self._no_inputs))
        return self._evaluate(Point(q, zero, zero, self._no_inputs, self._psi), none, 0)[2]

    def _evaluate(self, p: Point, ways: Directions, level: int) -> tuple[Array, Array, int]:
        """Return the residual (n,), its derivatives along m directions (m, n), and the status code."""
        r, slopes = np.zeros(self.n), np.zeros((len(ways.q), self.n))
        status = residual_slopes(
            WITH_SLOPES, self.model, self.par, State(p.q, p.v, p.a), p.u, p.psi, ways, level, self._room, r, slopes
        )
        return r, slopes, int(status)

    def along(self, point: Point, q: Any = 0.0, v: Any = 0.0, a: Any = 0.0, u: Any = 0.0, level: int = 0) -> Array:
        """Return derivatives (n, m) of the residual along m directions: changes of q, v, a (n, m) and u (inputs, m)."""
        m = max(np.shape(x)[1] for x in (q, v, a, u) if np.ndim(x) == 2)
        ways = Directions(*(
            np.array(np.broadcast_to(np.transpose(x), (m, rows)), np.float64, order="C")
            for x, rows in ((q, self.n), (v, self.n), (a, self.n), (u, len(point.u)))
        ))  # fmt: skip
        if not UNCOMPILED:
            return self._evaluate(point, ways, level)[1].T

        def moved(i: int, t: float) -> Array:
            q, (v, a, u) = self.moved(point.q, t * ways.q[i]), (t * way[i] for way in ways[1:])
            return self.residual(Point(q, point.v + v, point.a + a, point.u + u, point.psi), level)

        columns = [derivative(partial(moved, i), step_along(ways.q[i], self.model.weight)) for i in range(m)]
        return np.array(columns).reshape(m, self.n).T

    def unit(self, rows: Rows) -> Array:
        """Return the unit directions (n, number of rows) of the given rows."""
        return np.eye(self.n)[:, rows]

    def constraint_slopes(self, point: Point) -> Array:
        """Return the derivatives (m, f) of the constraints with respect to the rows that can move."""
        if not self.algebraic.size:
            return np.zeros((0, self.free.size))
        still = replace(point, v=np.zeros(self.n))
        return self.along(still, v=self.unit(self.free), level=1)[self.algebraic]

    def input_slopes(self, point: Point, inputs: Rows) -> Array:
        """Return -dr/du (f, inputs), the generalized forces of unit torques on the rows that can move."""
        if not len(inputs):
            return np.zeros((self.free.size, 0))
        return -self.along(point, u=np.eye(len(point.u))[:, inputs])[self.free]

    def moved(self, q: Array, d: Array) -> Array:
        """Return the coordinates q after an increment d (n,); rotations are composed."""
        found = q.copy()
        uncompiled(retract)(SINGLE, self.model, found, 1.0, d, None)
        return found

    # --- what is read off -------------------------------------------------------------------------------------------

    def poses_along(
        self, q: Array, v: Array, dq: Array, dv: Array, gauges: Array | None = None
    ) -> tuple[Array, Array, Array, Array]:
        """Return poses (n_links, ...), gauge readings (G,), and derivatives (m, ...) of both along directions dq, dv.

        dq, dv (n, m): increments of the coordinates and changes of the rates. gauges: gauges whose readings are
            returned, as rows of `gauges.curvature_rows`.
        """
        rows = self._no_gauges if gauges is None else gauges
        own = self.reading.poses.places.end
        poses, count, m = own * self.n_links, own * self.n_links + BASE_POSE.end, dq.shape[1]
        inputs, zero = self._no_inputs, np.zeros(self.n)
        d, e = (np.array(x.T, order="C") for x in (dq, dv))
        ways = Directions(d, e, np.zeros((m, self.n)), np.zeros((m, len(inputs))))
        values, slopes = np.zeros(count + len(rows)), np.zeros((m, count + len(rows)))
        out = np.zeros(count * len(WITH_SLOPES))

        def read(ways: Directions, q: Array, v: Array) -> Array:
            pose_slopes(
                WITH_SLOPES, self.model, self.par, State(q, v, zero), inputs, self._psi, ways, rows, self._room, out,
                values, slopes,
            )  # fmt: skip
            return values.copy()

        if UNCOMPILED:
            none = _none(self.n, len(inputs))

            def moved(i: int, t: float) -> Array:
                return read(none, self.moved(q, t * d[i]), v + t * e[i])

            for i in range(m):
                slopes[i] = derivative(partial(moved, i), step_along(d[i], self.model.weight))
            ways = none
        read(ways, q, v)
        shape = (self.n_links, own)
        return (
            values[:poses].reshape(shape), values[count:], slopes[:, :poses].reshape(-1, *shape), slopes[:, count:]
        )  # fmt: skip

    def poses(self, q: Array, v: Array) -> Array:
        """Return the poses of the links (`physics.layout`), (n_links, ...)."""
        none = np.zeros((self.n, 0))
        return self.poses_along(q, v, none, none)[0]

    def points(self, q: Array) -> Array:
        """Return the positions of points along the chain, from root to tip: (points, 2 or 3), m."""
        return self.reading.points(self.simulation.scene.arm, self.simulation.settings, self.model, q)

    def points_along(self, q: Array, d: Array) -> Array:
        """Return the derivatives (m, points, 2 or 3) of `points` along m increments d (n, m) of the coordinates."""
        scene, settings, ways = self.simulation.scene, self.simulation.settings, np.array(d.T, order="C")
        if not UNCOMPILED:
            return self.reading.point_slopes(scene.arm, settings, self.model, q, ways)

        def moved(i: int, t: float) -> Array:
            return self.points(self.moved(q, t * ways[i]))

        return np.array(
            [derivative(partial(moved, i), step_along(way, self.model.weight)) for i, way in enumerate(ways)]
        )

    def joint_angles(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Return joint angles and rates (n_links,) of a link's root relative to the previous tip or a floating base."""
        angles, rates = self.reading.joints(self.poses(q, v))
        if self.base is not None:
            angles[0], rates[0] = angles[0] - q[self.base], rates[0] - v[self.base]
        return angles, rates

    def joint_slopes(self, q: Array) -> Array:
        """Return the derivatives (n_links, f), which are constant, of the joint angles by the f rows that can move."""
        ways = self.unit(self.free)
        slopes = joint_angles(self.poses_along(q, np.zeros(self.n), ways, 0.0 * ways)[2])[0].T
        if self.base is not None:
            slopes[0] -= ways[self.base]
        return slopes

    def motor_angles(self, q: Array) -> Array:
        """Return the motors' angles (n_links,), on which joint torques act, relative to the previous link."""
        angles = self.joint_angles(q, np.zeros(self.n))[0]
        for k, row in self.motors.items():
            angles[k] = q[row]
        return angles

    def motor_slopes(self, q: Array) -> Array:
        """Return the derivatives (n_links, f), which are constant, of `motor_angles` by the f rows that can move."""
        slope = self.joint_slopes(q)
        for k, row in self.motors.items():
            slope[k] = self.free == row
        return slope

    def state(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Return the independent coordinates and their rates, in the order of `names`."""
        rows = self.free[self.independent]
        x, rate = q[rows], v[rows]
        angles, rates = self.joint_angles(q, v)
        for k, i in self.joints.items():
            x[i], rate[i] = angles[k], rates[k]
        return x, rate

    def changes(self, q: Array, dq: Array) -> Array:
        """Return the changes (n, m) of the independent coordinates for changes dq (f, m) of the rows that can move."""
        result = dq[self.independent]
        if self.dependent.size:
            turns = self.joint_slopes(q) @ dq
            for k, i in self.joints.items():
                result[i] = turns[k]
        return result

    # --- rotation ----------------------------------------------------------------------------------------------------

    def rotating(self, q: Array, spin: float) -> tuple[Array, Array]:
        """Return rates and accelerations of q in a steady rotation, in space about the first joint's axis.

        spin: angular velocity, rad/s.
        """
        v, a = np.zeros(self.n), np.zeros(self.n)
        if spin == 0.0:
            return v, a
        for x, y in self.pairs:
            v[x], v[y] = -spin * q[y], spin * q[x]
            a[x], a[y] = -(spin**2) * q[x], -(spin**2) * q[y]
        v[self.turned_rigidly] = spin
        omega = self._omega(spin)
        for i in self._vertices():
            v[i : i + 3] = np.cross(omega, q[i : i + 3])
            a[i : i + 3] = np.cross(omega, v[i : i + 3])
            v[i + 3 : i + AXES] = rotations.back(rotations.matrices(q[i + 3 : i + AXES]), omega)
        return v, a

    def frame(self, point: Point, spin: float = 0.0) -> Frame:
        """Return the `Frame` (n, n) at a point, for an observer who turns with the arm at `spin` (rad/s)."""
        V, U, W = np.zeros((3, self.n, self.n))
        for x, y in self.pairs:  # x = T(w t) xi: x' = T (xi' + w S xi), x'' = T (xi'' + 2 w S xi' + w^2 S^2 xi)
            V[x, y], V[y, x], W[x, x], W[y, y] = -spin, spin, -(spin**2), -(spin**2)
        hat = rotations.skew(self._omega(spin))
        for i in self._vertices():
            rows = np.ix_(range(i, i + 3), range(i, i + 3))
            V[rows], W[rows] = hat, hat @ hat
        U += 2.0 * V
        for i in self.turning:
            rows = np.ix_(i, i)
            V[rows] = U[rows] = rotations.skew(point.v[i])
            W[rows] = rotations.skew(point.a[i])
        return Frame(V, U, W)

    def _omega(self, spin: float) -> Array:
        """Return the angular velocity (3,), in inertial axes, of a spin (rad/s) about the first joint's axis."""
        arm = self.simulation.scene.arm
        return spin * (mount_of(arm, 0) @ axis_of(arm, 0))

    def _vertices(self) -> list[int]:
        """Return, for each vertex of an arm in space, the index of its first row in the equations."""
        if not self.turning.size:  # in the plane no rows are rotation vectors
            return []
        return [i for i, name in enumerate(self.names_of_rows) if name.startswith("link") and ".x" in name]

    # --- linear equations --------------------------------------------------------------------------------------------

    def inertia(self, point: Point) -> Array:
        """Return the mass matrix M (f, f) of the rows that can move."""
        return self.along(point, a=self.unit(self.free))[self.free]

    def reduced(self, point: Point, spin: float = 0.0) -> Reduced:
        """Return the linear equations in independent coordinates.

        If spin (rad/s) is not 0, the point must be a steady rotation; the matrices then refer to the rotating frame, in
        which they are constant.
        """
        free, lam, here, there = self.free, self.algebraic, self.independent, self.dependent
        f, n = free.size, here.size
        # columns of one residual: by accelerations, rates, coordinates
        ways, none = self.unit(free), np.zeros((self.n, f))
        q, v, a = (np.hstack(part) for part in ((none, none, ways), (none, ways, none), (ways, none, none)))
        columns = self.along(point, q, v, a)
        M, C, K = (columns[free, f * i : f * (i + 1)] for i in range(3))
        B = self.input_slopes(point, self.inputs)
        lift, drift = np.zeros((f, n)), np.zeros((f, n))
        bend_v, bend_q = np.zeros((f, f)), np.zeros((f, f))
        lift[here] = np.eye(n)
        if there.size:
            G = self.constraint_slopes(point)
            inverse = np.linalg.inv(G[:, there])
            lift[there] = -inverse @ G[:, here]
            drift[there] = -inverse @ self.along(point, q=ways, level=1)[lam] @ lift
            bend_v[there] = -inverse @ self.along(point, v=ways, level=2)[lam]
            bend_q[there] = -inverse @ self.along(point, q=ways, level=2)[lam]
        damping, stiffness = C + M @ bend_v, K + M @ bend_q
        M, C, B = lift.T @ M @ lift, lift.T @ damping @ lift, lift.T @ B
        check_mass(M)
        K = lift.T @ (damping @ drift + stiffness @ lift)
        frame = self.frame(point, spin).among(free[here])
        if there.size:  # the turn of a frame behind a hinge -> the joint's angle
            change = np.eye(n)
            jacobian = self.joint_slopes(point.q) @ lift
            for k, i in self.joints.items():
                change[i] = jacobian[k]
            back: Array = np.asarray(np.linalg.inv(change), np.float64)
            M, C, K, B = back.T @ M @ back, back.T @ C @ back, back.T @ K @ back, back.T @ B
            lift, drift, frame = lift @ back, drift @ back, frame.in_coordinates(change, back)
        return Reduced(M, C, K, B, lift, drift, bend_v, bend_q, frame)


def _none(rows: int, inputs: int) -> Directions:
    """Return a `Directions` without directions."""
    return Directions(*(np.zeros((0, count)) for count in (rows, rows, rows, inputs)))


def _dependent(model: object) -> list[int]:
    """Return the dependent rows: the frame after each joint, and the joint's angle if the joint is rigid."""
    if not isinstance(model, FloatingFrame):
        return []
    rows = []
    for body, behind in zip(model.table[:-1], model.table[1:], strict=True):
        assert behind[START] == body[START] + 3 + body[SIZE] + body[MULTIPLIERS]
        rows += [int(behind[START]) + i for i in range(int(body[MULTIPLIERS]))]
    return rows


def _joint_rows(simulation: Simulation) -> dict[int, int]:
    """Return a dict from joints to rows: the row of a joint's angle, or of the frame that turns with the joint."""
    system, model = simulation.system, simulation.model
    rows = {}
    for k in range(simulation.scene.arm.n_links):
        if isinstance(model, FloatingFrame):
            rows[k] = next(int(body[START]) + 2 for body in model.table if body[LINK] == k)
        else:
            rows[k] = system.coordinates[f"joint{k}"]
    return rows


def motor_rows(simulation: Simulation) -> dict[int, int]:
    """Return the row of q of each motor with an elastic gear, by the index of its joint."""
    found = {k: simulation.system.coordinates.get(f"motor{k}") for k in range(simulation.scene.arm.n_links)}
    return {k: row for k, row in found.items() if row is not None}


def at_rest_of(simulation: Simulation) -> tuple[Equations, Point]:
    """Return the equations of a simulation, and a point with its coordinates at rest under its inputs."""
    equations, w = Equations(simulation), simulation.work
    zero = np.zeros(equations.n)
    return equations, Point(w.q.copy(), zero, zero, w.u.copy(), w.psi.copy())
