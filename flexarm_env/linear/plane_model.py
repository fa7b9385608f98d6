"""State space of a planar arm: its independent coordinates and their rates.

Over a period, the model is the derivative of the solver's steps, with tangents in dual lanes.
"""

import numpy as np

from ..physics.gauges import Spot, curvature_rows
from ..physics.layout import POSE, ROOT, ROOT_RATES, TIP, TIP_RATES
from ..simulation import Simulation
from ..trajectory import link_deflection
from ..validation import Array
from .equations import Equations, exact_slopes, slopes
from .period import at_start, period_tangents, point_of


def gauge_name(link: int, place: float, measures: str = "xy") -> str:
    """Name of a gauge's output, such as "curvature0@0.5": its link, and place from 0 (root) to 1 (tip).

    measures: one of `sensors.MEASURES`: bending in the plane "xy" or "xz", or "torsion".
    """
    what = {"xy": "curvature", "xz": "curvature_z", "torsion": "torsion"}[measures]
    return f"{what}{link}@{place:g}"


class PlaneModel:
    """Parts of the `LinearModel` of a simulation about its present state.

    Attributes:
        names: names of the coordinates. inputs, x, u, rate: see `LinearModel`. A, B: continuous model. still: M, C, K
            of the coordinates that are not prescribed.
    """

    def __init__(self, simulation: Simulation, stepping: bool, motions: bool) -> None:
        self._simulation = simulation
        self._equations = e = Equations(simulation, stepping, driven=motions)
        self._flat, self._w = at_start(simulation, e.model)
        self._start = start = point_of(self._w)
        self._reduced = reduced = e.reduced(start)
        n, m, driven = e.independent.size, e.inputs.size, e.driven
        self._accelerations, moved = reduced.accelerations(driven)
        self.A = np.block([[np.zeros((n, n)), np.eye(n)], [self._accelerations[:, : 2 * n]]])
        self.B = np.vstack([np.zeros((n, m + driven.size)), np.hstack([self._accelerations[:, 2 * n :], moved])])
        accelerations = e.state(start.q, start.a)[1]  # joint angles are linear in q
        self.x = np.concatenate(e.state(start.q, start.v))
        self.rate = np.concatenate([self.x[n:], accelerations])
        self.u = np.concatenate([start.u[e.inputs], accelerations[driven]])
        self.names = e.names
        self.inputs = (*(f"torque{k}" for k in e.inputs), *(f"{e.names[i]}_acceleration" for i in driven))
        self.still = reduced.among([i for i in range(n) if i not in driven])

    def period(self, dt: float) -> tuple[Array, Array, Array]:
        """Return A, B and the next state of the solver over a period, s, without prescribed coordinates. Call it once:
        the solver is moved on."""
        e, w, reduced = self._equations, self._w, self._reduced
        n, m, f = e.independent.size, e.inputs.size, e.free.size
        q = np.hstack([reduced.lift, np.zeros((f, n + m))])
        v = np.hstack([reduced.drift, reduced.lift, np.zeros((f, m))])
        a = reduced.lift @ self._accelerations + reduced.bend_v @ v + reduced.bend_q @ q
        found = period_tangents(self._simulation, self._flat, w, (q, v, a), e.free, e.inputs, dt)
        change = np.vstack([e.changes(w.q, tangents) for tangents in found])
        return change[:, : 2 * n], change[:, 2 * n :], np.concatenate(e.state(w.q, w.v))

    def outputs(self, gauges: list[Spot]) -> tuple[tuple[str, ...], Array, Array]:
        """Return names and values of the outputs, and their derivatives by the state."""
        e, reduced, q, v = self._equations, self._reduced, self._start.q, self._start.v

        def shown(q: Array, v: Array) -> Array:
            poses = e.poses(q, v)
            angles, rates = e.joint_angles(q, v)
            cos, sin, spin = np.cos(poses[:, POSE.angle]), np.sin(poses[:, POSE.angle]), poses[:, POSE.rate]
            dx, dy, _ = (poses[:, TIP] - poses[:, ROOT]).T
            vx, vy, _ = (poses[:, TIP_RATES] - poses[:, ROOT_RATES]).T
            turning = cos * vy - sin * vx - spin * (cos * dx + sin * dy)
            motors = [x[row] for row in e.motors.values() for x in (q, v)]
            return np.concatenate([angles, rates, link_deflection(poses), turning, poses[-1, TIP][:2], motors])

        by_q = slopes(lambda x: shown(x, v), q, e.free, e.steps)
        by_v = exact_slopes(lambda x: shown(q, x), v, e.free)
        links, ends = range(e.n_links), ("", "_rate")
        names = [f"{what}{k}{end}" for what in ("joint", "deflection") for end in ends for k in links]
        names += ["tip_x", "tip_y", *(f"motor{k}{end}" for k in e.motors for end in ends)]
        names += [gauge_name(*spot) for spot in gauges]
        simulation = self._simulation
        rows = curvature_rows(simulation.scene, simulation.settings, simulation.system, gauges)
        bent = rows[:, e.free] @ reduced.lift
        C = np.hstack([by_q @ reduced.lift + by_v @ reduced.drift, by_v @ reduced.lift])
        values = np.concatenate([shown(q, v), rows @ q])
        return tuple(names), values, np.vstack([C, np.hstack([bent, np.zeros_like(bent)])])
