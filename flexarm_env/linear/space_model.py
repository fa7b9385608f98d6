"""State space of an arm in space, in coordinates of the tangent space, also for a free root.

Small motions about a point are increments d of the coordinates (of rotations in the section's own axes) and changes e
of the rates. Rotations do not commute: exp(d^) changes by d' = e - w x d with the section's own angular velocity w, so

    d' = e - W d,        M e' + C e + K d = B u,

M, C, K being the residual's slopes at constant other quantities. Over a step, the model is the derivative of the solver
in dual lanes, because its rotations depend on the Newton iterates, in second order of the rotation in a step.
"""

from typing import Any

import numpy as np

from .. import rotations
from ..compiler import SINGLE, uncompiled
from ..physics.equations import read_gauges, read_poses
from ..physics.gauges import curvature_rows
from ..physics.layout import SPACE_POSE, SPACE_POSES
from ..physics.protocol import local_difference
from ..simulation import Simulation
from ..validation import Array
from .equations import SECOND, Rows, motor_rows, slopes
from .period import at_start, period_tangents
from .plane_model import gauge_name
from .space import SmallMotions

SHOWN = {
    "": "angle", "_rate": "rate", "deflection_y": "deflection", "deflection_z": "deflection",
    "deflection_y_rate": "deflection_rate", "deflection_z_rate": "deflection_rate", "twist": "twist",
    "twist_rate": "twist_rate",
}  # fmt: skip
"""Outputs of a link, "joint0" and "joint0_rate" first, and what they are of a `SPACE_POSE`."""


class SpaceModel:
    """Parts of the `LinearModel` of a simulation about its present state, for the f rows that can move; attributes as
    those of `PlaneModel`."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation, self.motions = simulation, SmallMotions(simulation)
        self.motions.model, self.rows = simulation.model, self.motions.free
        self._motors = motor_rows(simulation)
        self._flat, self._w = at_start(simulation, simulation.model)
        self.q, self.v, self.a = self._w.q.copy(), self._w.v.copy(), self._w.a.copy()
        self.motions.about(self.v, self.a, self._w.u)
        names, root, rows, f = simulation.system.names, simulation.scene.root == "free", self.rows, len(self.rows)
        at = {int(row): i for i, row in enumerate(rows)}
        turned = {k: at[row] for k, row in enumerate(self.motions.joints) if row in at and not (k == 0 and root)}
        first = [int(k) for k in rows if names[k].endswith("rx") or ".rx" in names[k]]
        self.turning: Rows = np.array([[at[k + i] for i in range(3)] for k in first], np.int64).reshape(-1, 3)
        M, C, K = (self.motions.slopes(self.q, which, rows) for which in (2, 1, 0))
        W, B = self._turned(self.v[rows]), np.zeros((f, len(turned)))
        B[list(turned.values()), range(len(turned))] = 1.0
        self._right = np.asarray(np.linalg.solve(M, np.hstack([-K, -C, B])), np.float64)
        self.A = np.block([[-W, np.eye(f)], [self._right[:, : 2 * f]]])
        self.B = np.vstack([np.zeros((f, len(turned))), self._right[:, 2 * f :]])
        self._plain = np.setdiff1d(np.arange(f), self.turning)
        self.x = np.concatenate([self.q[rows], self.v[rows]])
        self.x[self.turning] = 0.0
        self.rate = np.concatenate([self.v[rows], self.a[rows]])
        self._inputs = list(turned)
        self.u, self.inputs = self._w.u[self._inputs].copy(), tuple(f"torque{k}" for k in turned)
        self.names = tuple(names[k] for k in rows)
        self.still = M, C + M @ W, K + C @ W + M @ self._turned(self.a[rows])

    def _turned(self, change: Array) -> Array:
        """(f, f): of each rotation c^ of its three numbers c of `change` (f,)."""
        found = np.zeros((len(self.rows),) * 2)
        for i in self.turning:
            found[np.ix_(i, i)] = rotations.skew(change[i])
        return found

    def _slope(self, q: Array) -> Array:
        """(f, f): increments by coordinates at q, which for rotation vectors are not the same."""
        found = np.eye(len(self.rows))
        for i in self.turning:
            found[np.ix_(i, i)] = rotations.slope(q[self.rows[i]])
        return found

    def period(self, dt: float) -> tuple[Array, Array, Array]:
        """Return A, B and the next state of the solver over a period, s; of rotations the increments. Call it once: the
        solver is moved on."""
        rows, f, n, w = self.rows, len(self.rows), self._right.shape[1], self._w
        q, v = np.zeros((f, n)), np.zeros((f, n))
        q[:, :f], v[:, f : 2 * f] = np.linalg.inv(self._slope(w.q)), np.eye(f)
        begun, way = w.q.copy(), np.zeros(len(w.q))
        q, v = period_tangents(self._simulation, self._flat, w, (q, v, self._right), rows, self._inputs, dt)
        uncompiled(local_difference)(SINGLE, self._simulation.model, begun, w.q, way)
        change = np.vstack([self._slope(w.q) @ q, v])
        after = np.concatenate([way[rows], w.v[rows]])
        after[self._plain] += self.x[self._plain]
        return change[:, : 2 * f], change[:, 2 * f :], after

    def outputs(self, gauges: list[Any]) -> tuple[tuple[str, ...], Array, Array]:
        """Return names and values of the outputs, and their derivatives by the state."""
        simulation, model, f = self._simulation, self.motions.model, len(self.rows)
        links = range(simulation.scene.arm.n_links)
        rows = curvature_rows(simulation.scene, simulation.settings, simulation.system, gauges)

        def shown(change: Array) -> Array:
            q, v = self.motions.moved(self.q, self.rows, change[:f]), self.v.copy()
            v[self.rows] += change[f:]
            poses, bent = np.zeros((len(links), SPACE_POSE.end)), np.zeros((1, len(rows)))
            read_poses(model, simulation.par, q, v, poses.reshape(-1))
            values = SPACE_POSES.unpack(poses)
            found = []
            for name, field in SHOWN.items():
                of = values[field]
                found.append(of[:, "yz".index(name[11])] if of.ndim > 1 else of)
            motors = [x[row] for row in self._motors.values() for x in (q, v)]
            read_gauges(model, q[None], rows, bent)
            return np.concatenate([*found, values["tip"][-1], motors, bent[0]])

        names = [_numbered(name, k) for name in SHOWN for k in links]
        names += ["tip_x", "tip_y", "tip_z", *(f"motor{k}{end}" for k in self._motors for end in ("", "_rate"))]
        names += [gauge_name(*spot) for spot in gauges]
        still, steps = np.zeros(2 * f), np.ones(2 * f)
        steps[:f] = 1e-4 / model.weight[self.rows]
        return tuple(names), shown(still), slopes(shown, still, np.arange(2 * f), steps, SECOND)


def _numbered(name: str, k: int) -> str:
    """The name with the link's number: deflection_y of link 1 is deflection1_y."""
    head, _, tail = name.partition("_")
    return f"{head or 'joint'}{k}" + (f"_{tail}" if tail else "")
