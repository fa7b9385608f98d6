"""Linear equations of an arm at a point of its motion: continuous and discrete state space, and outputs.

The state consists of d, the changes of the independent coordinates, and e, the changes of their rates. For a rotation
in space, d is an increment in the section's own axes. The time derivative of d is then d' = e - w x d, with the
section's angular velocity w. For all coordinates together

    d' = e - V d,        M e' + C e + K d = B u

with the matrices of `equations.Reduced`. The discrete model is the derivative of the solver's steps (`linear.period`).
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from .. import rotations
from ..compiler import SINGLE, uncompiled
from ..equations import Equations, point_of
from ..physics.gauges import Spot, curvature_rows
from ..physics.protocol import local_difference
from ..physics.reading import reading_of
from ..simulation import Simulation
from ..validation import Array
from .period import at_start, period_tangents

COMPLEX_STEP = 1e-100
"""Imaginary step for derivatives of outputs by poses; they are exact, because nothing is subtracted."""


def gauge_name(link: int, place: float, measures: str = "xy") -> str:
    """Return the output name of a gauge at a place from 0 (root) to 1 (tip) of a link, such as "curvature0@0.5".

    measures: strain that the gauge measures, one of `sensors.MEASURES`: "xy" or "xz" for bending in this plane, or
    "torsion".
    """
    what = {"xy": "curvature", "xz": "curvature_z", "torsion": "torsion"}[measures]
    return f"{what}{link}@{place:g}"


class ArmAtPoint:
    """Compute the `LinearModel` of a simulation about its present state.

    Attributes:
        names: names of the coordinates. inputs, x, u, rate, A, B: attributes of the continuous `LinearModel`. still:
            mass, damping and stiffness matrices of the coordinates that are not prescribed.
    """

    def __init__(self, simulation: Simulation, stepping: bool, motions: bool) -> None:
        """Compute the continuous model; stepping, motions: arguments `stepping` and `driven` of `Equations`."""
        self._simulation = simulation
        self._equations = e = Equations(simulation, stepping, driven=motions)
        self._flat, self._w = at_start(simulation, e.model)
        self._start = start = point_of(self._w)
        self._reduced = reduced = e.reduced(start)
        n, m, driven = e.independent.size, e.inputs.size, e.driven
        self._accelerations, moved = reduced.accelerations(driven)
        self.A = np.block([[-reduced.frame.V, np.eye(n)], [self._accelerations[:, : 2 * n]]])
        self.B = np.vstack([np.zeros((n, m + driven.size)), np.hstack([self._accelerations[:, 2 * n :], moved])])
        accelerations = e.state(start.q, start.a)[1]  # joint angles are linear in q
        # the state; increments of rotations start from 0
        self._rows = e.free[e.independent]
        self._turning = np.isin(self._rows, e.turning)
        self.x = np.concatenate(e.state(start.q, start.v))
        self.x[:n][self._turning] = 0.0
        self.rate = np.concatenate([e.state(start.q, start.v)[1], accelerations])
        self.u = np.concatenate([start.u[e.inputs], accelerations[driven]])
        self.names = e.names
        self.inputs = (*(f"torque{k}" for k in e.inputs), *(f"{e.names[i]}_acceleration" for i in driven))
        self.still = reduced.among([i for i in range(n) if i not in driven])

    def period(self, dt: float) -> tuple[Array, Array, Array]:
        """Advance the solver by a period dt, s; return A and B of the discrete model, and the state after the period.

        The state does not contain prescribed coordinates. Call this method only once.
        """
        e, w, reduced, start = self._equations, self._w, self._reduced, self._start
        n, m, f = e.independent.size, e.inputs.size, e.free.size
        # tangents of coordinates, rates and accelerations of the rows that can move, by (d, e, u)
        q = np.hstack([reduced.lift, np.zeros((f, n + m))])
        v = np.hstack([reduced.drift, reduced.lift, np.zeros((f, m))])
        a = reduced.lift @ self._accelerations + reduced.bend_v @ v + reduced.bend_q @ q
        q = np.asarray(np.linalg.solve(self._increments(start.q), q), np.float64)
        found = period_tangents(self._simulation, self._flat, w, (q, v, a), e.free, e.inputs, dt)
        change = np.vstack([e.changes(w.q, self._increments(w.q) @ found[0]), e.changes(w.q, found[1])])
        after, way = np.concatenate(e.state(w.q, w.v)), np.zeros(e.n)
        if self._turning.any():
            uncompiled(local_difference)(SINGLE, e.model, start.q, w.q, way)
            after[:n][self._turning] = way[self._rows][self._turning]
        return change[:, : 2 * n], change[:, 2 * n :], after

    def _increments(self, q: Array) -> Array:
        """Return the matrix (f, f) that maps changes of coordinates to increments at q; the two differ for
        rotations.
        """
        free, found = self._equations.free, np.eye(self._equations.n)
        for i in self._equations.turning:
            found[np.ix_(i, i)] = rotations.slope(q[i])
        return found[np.ix_(free, free)]

    def outputs(self, gauges: Sequence[Spot]) -> tuple[tuple[str, ...], Array, Array]:
        """Return names and values of the outputs, and their derivatives with respect to the state."""
        e, reduced, simulation = self._equations, self._reduced, self._simulation
        q, v, n = self._start.q, self._start.v, e.independent.size
        # directions of the state, in all rows
        dq, dv = np.zeros((2, e.n, 2 * n))
        dq[e.free, :n], dv[e.free, :n], dv[e.free, n:] = reduced.lift, reduced.drift, reduced.lift
        rows = curvature_rows(simulation.scene, simulation.settings, simulation.system, gauges)
        poses, bent, by_poses, by_bent = e.poses_along(q, v, dq, dv, rows)
        reading = reading_of(simulation.scene)

        def shown(poses: Any, q: Any, v: Any) -> Any:
            base = (0.0, 0.0) if e.base is None else (q[e.base], v[e.base])
            motors = [x[row] for row in e.motors.values() for x in (q, v)]
            return np.concatenate([*reading.outputs(poses, base), poses[-1, reading.tip], motors])

        values = shown(poses, q, v)
        columns = [
            shown(poses + COMPLEX_STEP * 1j * change, q + COMPLEX_STEP * 1j * d, v + COMPLEX_STEP * 1j * rate).imag
            for change, d, rate in zip(by_poses, dq.T, dv.T, strict=True)
        ]
        C = np.vstack([np.array(columns).T / COMPLEX_STEP, by_bent.T])
        links, ends = range(e.n_links), ("", "_rate")
        names = [_numbered(name, k) for name in reading.output_names for k in links]
        names += [f"tip_{axis}" for axis in simulation.scene.axes]
        names += [f"motor{k}{end}" for k in e.motors for end in ends] + [gauge_name(*spot) for spot in gauges]
        return tuple(names), np.concatenate([values, bent]), C


def _numbered(name: str, k: int) -> str:
    """Return the name with the link's number, for example deflection1_y for deflection_y of link 1."""
    head, _, tail = name.partition("_")
    return f"{head or 'joint'}{k}" + (f"_{tail}" if tail else "")
