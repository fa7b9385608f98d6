"""Derivatives of the state after a period by the initial state and the inputs: tangents of the solver's steps.

Each array carries its tangents in additional SIMD lanes ("dual lanes"). The tangents include constraint forces and the
correction at the end of a period. The tangents are exact except for rotations in space. For rotations in space the
tangents neglect a part of the Newton iterates' effect. The resulting error is of second order in the rotation during a
step.
"""

from typing import Any

import numpy as np

from .. import validation as check
from ..compiler import SINGLE, WIDEST, dual, uncompiled
from ..equations.reduced import Rows
from ..physics.integrator.step import advance
from ..physics.integrator.work import Work, unpack, work_size
from ..physics.layout import HALVINGS
from ..physics.model import MESSAGE, OK, Scheme
from ..settings import steps_in
from ..simulation import Simulation
from ..validation import Array

SHARP = 1e-12
"""Newton tolerance for models with a period correction, so that it hardly matters at which iteration it begins."""


def at_start(simulation: Simulation, model: Any) -> tuple[Array, Work]:
    """Copy the state into a work array with the accelerations just after t; return the array and its views."""
    work, n_motions = simulation.work, simulation.n_motions
    flat: Array = np.zeros(sum(view.size for view in work))
    w: Work = uncompiled(unpack)(SINGLE, model, flat, n_motions)
    w.q[:], w.v[:], w.u[:], w.psi[:] = work.q, work.v, work.u, work.psi
    simulation.make_consistent(model, simulation.drive, flat)
    return flat, w


def steps_of(simulation: Simulation, dt: float) -> tuple[int, float]:
    """Return the number and the length, s, of the solver's steps in a period.

    Raises ValueError if an input is discontinuous within the period.
    """
    end = simulation.t + dt
    kinks = [t for t in simulation.scene.kinks if simulation.t + 1e-12 < t < end - 1e-12]
    if kinks:
        raise check.InvalidValue("discrete", dt, f"must not reach past the scene's kink at t = {kinks[0]:g} s")
    steps = steps_in(dt, simulation.dt)
    return steps, dt / steps


def period_tangents(
    simulation: Simulation, flat: Array, w: Work, starts: tuple[Array, Array, Array], rows: Rows, inputs: Any, dt: float
) -> tuple[Array, Array]:
    """Return the tangents of the coordinates q and rates v at the end of a period dt, s: two arrays (rows, columns).

    Each column is the derivative by one variable. The last variables are the entries u[inputs] of the input vector u.
    starts: tangents of q, v and the accelerations at the start of the period, (rows, columns) each. rows: the
    coordinates with tangents. flat, w: the work array and its views, which the function advances to the end of the
    period.
    """
    steps, h = steps_of(simulation, dt)
    n, links = starts[0].shape[1], simulation.scene.arm.n_links
    given = {name: np.zeros((len(getattr(w, name)), n)) for name in "qvabu"}
    for name, tangents in zip("qvab", (*starts, starts[2]), strict=True):
        given[name][rows] = tangents
    given["u"][inputs, range(n - len(inputs), n)] = 1.0
    groups = [
        _Dual(simulation, w, {name: x[:, k : k + len(WIDEST)] for name, x in given.items()})
        for k in range(0, n, len(WIDEST))
    ]
    for step in range(steps):
        at = simulation.t + step * h
        _advance(simulation, flat, w, at, h)
        for group in groups:
            group.step(w.u[:links], at, h)
    q, v = (np.hstack([group.tangents(name)[rows] for group in groups])[:, :n] for name in "qv")
    return q, v


def _scheme_of(simulation: Simulation) -> Scheme:
    """Return the solver's scheme, with a smaller tolerance if the period is corrected."""
    scheme = simulation.scheme
    sharp = simulation.model.newton.period_correction is not None
    return scheme._replace(tolerance=min(SHARP, scheme.tolerance)) if sharp else scheme


def _advance(of: Simulation, flat: Array, w: Work, at: float, h: float) -> None:
    """Advance by a step of h (s) from t = at; raise RuntimeError if the step fails or the solver halves it."""
    scheme = _scheme_of(of)
    advance(SINGLE, of.model, of.drive, of.par, flat, of.n_motions, at, h, 1, scheme, (0,))
    if w.flag[0] != OK:
        bound = float(getattr(of.model, "bound", 0.0))
        text = MESSAGE[int(w.flag[0])].format(t=at, h=h, halvings=scheme.max_halvings, bound=bound)
        raise RuntimeError(f"the solver failed within the period: {text}")
    if w.counts[HALVINGS] > 0:
        raise RuntimeError(f"the solver halved the step of {h:.3g} s from t = {at:.6g} s; take a smaller dt")


class _Dual:
    """Copies of an arm's work array in the lanes of a vector; each lane has the tangents along one direction."""

    def __init__(self, simulation: Simulation, w: Work, tangents: dict[str, Array]) -> None:
        """Copy the work array into the lanes. tangents: for each field of the array its tangents (rows, columns), with
        at most one column per lane.
        """
        self.simulation, self.lane = simulation, dual(WIDEST)
        model, motions = simulation.model, simulation.n_motions
        self.flat = np.zeros(int(uncompiled(work_size)(len(self.lane), model, motions)))
        self.work = uncompiled(unpack)(self.lane, model, self.flat, motions)
        par = np.zeros((len(simulation.par), 2, len(WIDEST)))
        par[:, 0] = simulation.par[:, None]
        self.par = par.ravel()
        for name, own in tangents.items():
            numbers = self._numbers(name)
            numbers[:, 0] = getattr(w, name)[:, None]
            numbers[:, 1, : own.shape[1]] = own
        loads = simulation.drive.entries >= simulation.scene.arm.n_links  # torques are given with their tangents
        self.drive = simulation.drive._replace(
            entries=simulation.drive.entries[loads], terms=simulation.drive.terms[loads]
        )

    def _numbers(self, name: str) -> Array:
        """Return a view of the values and tangents (rows, 2, lanes) of a field of the work array."""
        return np.asarray(getattr(self.work, name)).reshape(-1, 2, len(WIDEST))

    def tangents(self, name: str) -> Array:
        """Return a view of the tangents (rows, lanes) of a field of the work array."""
        return self._numbers(name)[:, 1]

    def step(self, torques: Array, t: float, h: float) -> None:
        """Advance by a step of h (s) from the time t (s) under joint torques (N,), N m."""
        own = self.simulation
        self._numbers("u")[: len(torques), 0] = torques[:, None]
        advance(self.lane, own.model, self.drive, self.par, self.flat, own.n_motions, t, h, 1, _scheme_of(own), None)
