"""Derivatives of a scene's simulation by parameters of the scene or the arm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..compiler import SINGLE, dual, size, uncompiled
from ..physics.integrator.work import unpack
from ..physics.layout import HALVINGS, OF_MOTION, POSE
from ..physics.reading import reading_of
from ..runtime import sensitivity
from ..runtime.sensitivity import Neighbour, Steps
from ..simulation import Simulation
from ..trajectory import Trajectory, recorded
from ..validation import Array
from .methods import PASSES

MOST = 4_000_000
"""Largest number of float64 entries of factored matrices that are stored at a time."""

MOST_ROWS = 1_000_000
"""Largest number of steps in a run whose states are all stored."""


class NotDifferentiable(ValueError):
    """Raised if a run has no derivative; the message gives the reason."""


@dataclass(frozen=True)
class Run:
    """Simulation in equal steps, whose states are stored for differentiation.

    Attributes:
        simulation: the simulation at the end of the run.
        trajectory: the samples of the run.
        start: array (4, n), initial coordinates q, velocities v, accelerations a, and filtered accelerations b.
        q, v, a: arrays (steps, n), coordinates, velocities and accelerations at the ends of steps.
        t: array (steps,), times of the ends of steps, s.
        every: number of steps between two samples.
    """

    simulation: Simulation
    trajectory: Trajectory
    start: Array
    q: Array
    v: Array
    a: Array
    t: Array
    every: int
    _kept: dict[Any, Any]

    @classmethod
    def of(cls, simulation: Simulation, interval: float) -> Run:
        """Advance a new Simulation to the end of its scene with a sample every `interval` s; return the `Run`."""
        scene = simulation.scene
        every = max(1, int(np.ceil(interval / simulation.dt * (1.0 - 1e-9))))
        if every * scene.duration / interval > MOST_ROWS:
            every = 1  # samples alone
        start = _state(simulation)
        fields, shapes = simulation.record(scene.duration, interval / every)
        t, q, v, a = (np.ascontiguousarray(fields[name][1:]) for name in ("time", "q", "v", "a"))
        chosen = {name: values[::every] for name, values in fields.items()}
        return cls(simulation, recorded(simulation, chosen, shapes[::every], 0.0), start, q, v, a, t, every, {})

    def check(self) -> None:
        """Raise NotDifferentiable if the steps of the run cannot be differentiated."""
        simulation = self.simulation
        model, scene = simulation.model, simulation.scene
        inside = [t for load in scene.loads for f in load.functions for t in f.jumps if 0.0 < t < scene.duration]
        moved = [motion.function for motion in scene.motions]
        moved += [function for contact in scene.contacts for _, function in contact.displacements]
        inside += [t for function in moved for t in function.kinks if 0.0 < t < scene.duration]
        between = [t for t in scene.kinks if np.abs(self.t - t).min(initial=np.inf) > 1e-9 * max(1.0, t)]
        for there, what in (
            (model.algebraic is not None, "joints by multipliers"),
            (model.newton.period_correction is not None, "the correction of the period"),
            (simulation.settings.step_tolerance is not None, "steps fitted to a tolerance"),
            (simulation.work.counts[HALVINGS] > 0.0, "a step that had to be halved"),
            (bool(np.diff(self.t).max(initial=0.0) > 1.001 * simulation.dt), "more steps than are kept"),
            (bool(inside), "a load that jumps or a motion that has a kink"),
            (bool(between), "a kink between two steps"),
            (scene.spatial and scene.root == "free", "a free root in space"),
            (scene.floats, "a base that floats"),
        ):
            if there:
                raise NotDifferentiable(what)

    def slopes(self, neighbours: Sequence[tuple[Simulation, float, float]]) -> Array:
        """Return the derivatives of q and v by a parameter, (samples, 2, n), at the start and at the samples.

        neighbours: two triples (simulation, offset, weight). In each of the two simulations the parameter is changed by
        the triple's offset. The weights are the coefficients of a finite difference. For simulations a and b and an
        offset e, the triples of a central difference are (a, e, 1 / 2e) and (b, -e, -1 / 2e); the triples of a
        one-sided difference are (a, e, 2 / e) and (b, 2 e, -1 / 2e).

        Raises:
            NotDifferentiable: the steps cannot be differentiated (`check`), or the parameter changes the structure of
                the model.
        """
        self.check()
        own = self.simulation
        model, n = own.model, len(own.work.q)
        for other, _, _ in neighbours:
            if _kind(other.model) != _kind(model):
                raise NotDifferentiable("a change of the model's structure")
        h = np.diff(self.t, prepend=0.0)
        if "driven" not in self._kept:
            self._kept["driven"] = self._driven(own)
        u, psi = self._kept["driven"]
        central = 0.0 - sum(weight for _, _, weight in neighbours)
        central = 0.0 if abs(central) < 1e-9 * abs(neighbours[0][2]) else central
        tangent, moved = central * self.start, central * psi
        stars = [Neighbour(model, own.par, u.ravel(), 0.0, central)]
        for other, offset, weight in neighbours:
            other_u, other_psi = (u, psi) if _same(own.drive, other.drive) else self._driven(other)
            tangent = tangent + weight * _state(other)
            moved = moved + weight * other_psi
            stars.append(Neighbour(other.model, other.par, other_u.ravel(), offset, weight))
        approximate = own.settings.formulation == "geometrically_exact" or own.scene.contacts
        passes = reading_of(own.scene).passes or (PASSES if approximate else 1)
        room, out = np.zeros(int(uncompiled(sensitivity.room_of)(model, own.par))), np.empty((len(h), 2 * n))
        w = uncompiled(unpack)(dual(SINGLE), model, room, 0)
        for rows, values, own_tangent in zip((w.q, w.v, w.a, w.b), self.start, tangent, strict=True):
            rows.reshape(n, 2)[:] = np.stack([values, own_tangent], axis=-1)
        most = max(1, MOST // int(size(model.n_factor)))
        for k in range(0, len(h), most):
            part = slice(k, k + most)
            steps = Steps(self.q[part].ravel(), self.v[part].ravel(), self.a[part].ravel(), u[part].ravel(), h[part])
            factors = self._factored(k, steps)
            stage = [star._replace(u=star.u[k * u.shape[1] : (k + most) * u.shape[1]]) for star in stars]
            sensitivity.tangent_rows(
                SINGLE, dual(SINGLE), model, own.drive, steps, own.scheme, factors, *stage, moved[part], passes,
                room, out[part],
            )  # fmt: skip
        return np.concatenate([tangent[:2].reshape(1, -1), out[self.every - 1 :: self.every]]).reshape(-1, 2, n)

    def moved(self, other: Simulation, change: Array, places: bool = True) -> Trajectory:
        """Return the trajectory of an arm with changed parameters, to first order.

        change (samples, 2, n): changes of q and v. other: Simulation of the changed arm. places: True to compute tip,
        joints and motors from the changed q and v. All other fields are copied from the trajectory of the unchanged
        arm.
        """
        q, v = self.trajectory.q + change[:, 0], self.trajectory.v + change[:, 1]
        found: dict[str, Any] = {}
        if places:

            def poses() -> Array:
                found = np.zeros((len(q), other.scene.arm.n_links, POSE.end))
                sensitivity.pose_rows(SINGLE, other.model, other.par, q, v, found.reshape(len(q), -1))
                return found

            found = reading_of(other.scene).motion(other.scene.arm, other.settings, other.system, q, v, poses)
        return replace(self.trajectory, scene=other.scene, q=q, v=v, **found)

    def _factored(self, k: int, steps: Steps) -> Array:
        """Return the factored matrices of the steps from k on. Only the last computed matrices are stored."""
        own = self.simulation
        if self._kept.get("at") != k:
            factors = np.empty(len(steps.h) * int(size(own.model.n_factor)))
            r = np.zeros(len(own.work.q))
            sensitivity.factor_rows(SINGLE, own.model, own.drive, own.par, steps, own.scheme, r, factors)
            self._kept.update(at=k, factors=factors)
        return np.asarray(self._kept["factors"])

    def _driven(self, of: Simulation) -> tuple[Array, Array]:
        """Return the inputs (steps, inputs) and the prescribed values (steps, motions, 3) of a scene at all steps."""
        u, psi = np.zeros((len(self.t), len(of.work.u))), np.zeros((len(self.t), OF_MOTION.end * of.n_motions))
        sensitivity.drive_rows(SINGLE, of.drive, self.t, np.diff(self.t, prepend=0.0), u, psi)
        return u, psi.reshape(len(self.t), of.n_motions, OF_MOTION.end)


def _state(of: Simulation) -> Array:
    """Return the present q, v, a, b of a simulation."""
    w = of.work
    return np.array([w.q, w.v, w.a, w.b])


def _same(a: Any, b: Any) -> bool:
    return all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))


def _kind(model: Any) -> Any:
    """Return the properties that determine the compiled code of a model: sizes, tags and optional parts."""
    if isinstance(model, np.ndarray):
        return model.dtype, model.shape
    if hasattr(model, "_fields"):
        return type(model), tuple(_kind(part) for part in model)
    if isinstance(model, tuple):
        return tuple(map(_kind, model))
    return model if isinstance(model, int) else type(model)
