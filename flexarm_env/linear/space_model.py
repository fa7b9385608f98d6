"""State space of an arm in space: coordinates of the tangent space, which a free root has like all else.

Small motions about a point are increments d of the coordinates, of rotations in the section's own axes, and changes e
of the rates. Rotations do not add up: exp(d^) moves on by d' = e - w x d with the section's own angular velocity w, so

    d' = e - W d,        M e' + C e + K d = B u,

M, C, K being the residual's slopes at constant other quantities. What the solver does in a step is its own derivative,
in dual lanes: its rotations depend, in second order of what a step turns by, on Newton's way.
"""

from typing import Any

import numpy as np

from .. import rotations
from ..compiler import SINGLE, uncompiled
from ..physics.equations import read_gauges, read_poses
from ..physics.gauges import curvature_rows
from ..physics.integrator.work import Work
from ..physics.layout import SPACE_POSE, SPACE_POSES
from ..physics.protocol import difference
from ..simulation import Simulation
from ..validation import Array
from .equations import SECOND, Reduced, Rows, slopes
from .period import period_tangents
from .space import SmallMotions
from .stability import eigenpairs, growing

SHOWN = {
    "": "angle", "_rate": "rate", "deflection_y": "deflection", "deflection_z": "deflection",
    "deflection_y_rate": "deflection_rate", "deflection_z_rate": "deflection_rate", "twist": "twist",
    "twist_rate": "twist_rate",
}  # fmt: skip
"""Outputs of a link, "joint0" and "joint0_rate" first, and what they are of a `SPACE_POSE`."""


class Tangent:
    """The arm of a simulation about the state in a work array: its rows that can move, and M, C, K (f, f), W (f, f) and
    B (f, inputs) there."""

    def __init__(self, simulation: Simulation, model: Any, w: Work) -> None:
        self.motions = SmallMotions(simulation)
        self.motions.model, self.rows = model, self.motions.free
        names, root = simulation.system.names, simulation.scene.root == "free"
        self.names = tuple(names[k] for k in self.rows)
        at = {int(row): i for i, row in enumerate(self.rows)}
        found = {k: at[row] for k, row in enumerate(self.motions.joints) if row in at and not (k == 0 and root)}
        self.inputs, self._places = list(found), list(found.values())
        first = [int(k) for k in self.rows if names[k].endswith("rx") or ".rx" in names[k]]
        self.turning: Rows = np.array([[at[k + i] for i in range(3)] for k in first], np.int64).reshape(-1, 3)
        self.q, self.v, self.a = w.q.copy(), w.v.copy(), w.a.copy()
        self.motions.about(self.v, self.a, w.u)
        self.M, self.C, self.K = (self.motions.slopes(self.q, which, self.rows) for which in (2, 1, 0))
        f = len(self.rows)
        self.W, self.B = self.turned(self.v[self.rows]), np.zeros((f, len(self.inputs)))
        self.B[self._places, range(len(self.inputs))] = 1.0

    def turned(self, change: Array) -> Array:
        """(f, f): of each rotation c^ of its three numbers c of `change` (f,)."""
        found = np.zeros((len(self.rows),) * 2)
        for i in self.turning:
            found[np.ix_(i, i)] = rotations.skew(change[i])
        return found

    def slope(self, q: Array) -> Array:
        """(f, f): increments by coordinates at q, which for rotation vectors are not the same."""
        found = np.eye(len(self.rows))
        for i in self.turning:
            found[np.ix_(i, i)] = rotations.slope(q[self.rows[i]])
        return found

    def reduced(self) -> Reduced:
        """The equations in d alone."""
        none = np.zeros((len(self.rows), 0))
        K = self.K + self.C @ self.W + self.M @ self.turned(self.a[self.rows])
        return Reduced(self.M, self.C + self.M @ self.W, K, self.B, none, none, none, none)

    def outputs(self, d: Array, e: Array, gauges: Array) -> Array:
        """Values of `LinearModel.outputs` at increments d and changes e of the rates."""
        q, v, arm = self.motions.moved(self.q, self.rows, d), self.v.copy(), self.motions.simulation.scene.arm
        v[self.rows] += e
        poses, bent = np.zeros((arm.n_links, SPACE_POSE.end)), np.zeros((1, len(gauges)))
        read_poses(self.motions.model, self.motions.simulation.par, q, v, poses.reshape(-1))
        values = SPACE_POSES.unpack(poses)
        found = []
        for name, field in SHOWN.items():
            of = values[field]
            found.append(of[:, "yz".index(name[11])] if of.ndim > 1 else of)
        motors = [x[row] for row in self.motors.values() for x in (q, v)]
        read_gauges(self.motions.model, q[None], gauges, bent)
        return np.concatenate([*found, values["tip"][-1], motors, bent[0]])

    @property
    def motors(self) -> dict[int, int]:
        """Row of each motor behind an elastic gear."""
        rows, arm = self.motions.simulation.system.coordinates, self.motions.simulation.scene.arm
        return {k: rows[f"motor{k}"] for k in range(arm.n_links) if f"motor{k}" in rows}


def _shown(tangent: Tangent, spots: list[Any], gauges: Array) -> tuple[tuple[str, ...], Array, Array]:
    """Names, values, and derivatives by the state of the outputs."""
    links, f = range(tangent.motions.simulation.scene.arm.n_links), len(tangent.rows)
    shown = [_numbered(name, k) for name in SHOWN for k in links]
    shown += ["tip_x", "tip_y", "tip_z", *(f"motor{k}{end}" for k in tangent.motors for end in ("", "_rate"))]
    what = {"xy": "curvature", "xz": "curvature_z", "torsion": "torsion"}
    shown += [f"{what[spot[2] if len(spot) > 2 else 'xy']}{spot[0]}@{spot[1]:g}" for spot in spots]
    still, steps = np.zeros(2 * f), np.ones(2 * f)
    steps[:f] = 1e-4 / tangent.motions.model.weight[tangent.rows]

    def outputs(change: Array) -> Array:
        return tangent.outputs(change[:f], change[f:], gauges)

    return tuple(shown), outputs(still), slopes(outputs, still, np.arange(2 * f), steps, SECOND)


def _numbered(name: str, k: int) -> str:
    """The name with the link's number: deflection_y of link 1 is deflection1_y."""
    head, _, tail = name.partition("_")
    return f"{head or 'joint'}{k}" + (f"_{tail}" if tail else "")


def linear_parts(
    simulation: Simulation, flat: Array, w: Work, discrete: float | None, spots: list[Any]
) -> dict[str, Any]:
    """Fields of a continuous `LinearModel`, or where a period is given of what the solver does in it; and `growing`."""
    tangent = Tangent(simulation, simulation.model, w)
    f, m = len(tangent.rows), len(tangent.inputs)
    right = np.asarray(np.linalg.solve(tangent.M, np.hstack([-tangent.K, -tangent.C, tangent.B])), np.float64)
    A = np.block([[-tangent.W, np.eye(f)], [right[:, : 2 * f]]])
    B = np.vstack([np.zeros((f, m)), right[:, 2 * f :]])
    turned = np.zeros(f, bool)
    turned[tangent.turning] = True
    values = np.where(turned, 0.0, tangent.q[tangent.rows])
    x, rate = np.concatenate([values, tangent.v[tangent.rows]]), np.concatenate([tangent.v, tangent.a])
    rate = np.concatenate([rate[: len(tangent.q)][tangent.rows], rate[len(tangent.q) :][tangent.rows]])
    rows = curvature_rows(simulation.scene, simulation.settings, simulation.system, spots)
    names, y, C = _shown(tangent, spots, rows)
    reduced, inputs = tangent.reduced(), tangent.inputs
    found = {
        "A": A, "B": B, "C": C, "D": np.zeros((len(names), m)), "x": x, "u": w.u[inputs].copy(), "y": y, "rate": rate,
        "states": (*tangent.names, *(f"{name}_rate" for name in tangent.names)),
        "inputs": tuple(f"torque{k}" for k in inputs), "outputs": names, "t": simulation.t, "dt": discrete,
        "growing": growing(eigenpairs(reduced, list(range(f)))[0]),
    }  # fmt: skip
    if discrete is not None:
        found |= _period(simulation, tangent, flat, w, right, discrete)
        found["rate"][:f][~turned] += values[~turned]
    return found


def _period(
    simulation: Simulation, tangent: Tangent, flat: Array, w: Work, right: Array, dt: float
) -> dict[str, Array]:
    """A, B and the state after a period (increments of rotations and of all else from the start, and rates)."""
    rows, f, n = tangent.rows, len(tangent.rows), right.shape[1]
    q, v = np.zeros((f, n)), np.zeros((f, n))
    q[:, :f], v[:, f : 2 * f] = np.linalg.inv(tangent.slope(w.q)), np.eye(f)
    begun, way = w.q.copy(), np.zeros(len(w.q))
    q, v = period_tangents(simulation, flat, w, (q, v, right), rows, tangent.inputs, dt)
    uncompiled(difference)(SINGLE, simulation.model, begun, w.q, way)
    change = np.vstack([tangent.slope(w.q) @ q, v])
    return {"A": change[:, : 2 * f], "B": change[:, 2 * f :], "rate": np.concatenate([way[rows], w.v[rows]])}
