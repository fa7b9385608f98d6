"""The derivative of what the solver does in a period: tangents of each of its steps at their solution.

A step (`integrator.step`) solves generalized-alpha's equations for q with the constraints on q; with multipliers it
then takes out of v and of a what lies across the constraints. A step whose period is corrected also depends on how the
iteration matrix changes: there the derivative is one of differences.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .. import validation as check
from ..compiler import SINGLE
from ..physics.integrator.step import advance
from ..physics.integrator.work import Work
from ..physics.layout import HALVINGS
from ..physics.model import MESSAGE, OK, Drive, Scheme
from ..simulation import Simulation
from ..time_functions import C0, PIECE
from .equations import Derivatives, Equations, Point, Reduced, Rows, slopes

Array = NDArray[np.float64]

STEP, SHARP = 1e-4, 1e-12
"""Step of differences of the solver, in variables of size 1, and Newton's tolerance there: a correction of the period
that comes an iteration sooner is another within the tolerance."""


@dataclass
class _Tangents:
    """Derivatives of q, v, a, b over the rows that can move, (f, 2 n + m), by the start's state and by the inputs."""

    q: Array
    v: Array
    a: Array
    b: Array


def point_of(w: Work) -> Point:
    """The point of the motion in a work array (copied)."""
    return Point(w.q.copy(), w.v.copy(), w.a.copy(), w.u.copy(), w.psi.copy())


def steps_of(simulation: Simulation, dt: float) -> tuple[int, float]:
    """How many steps of which length the solver takes in a period, s; ValueError where a kink of the scene is in it."""
    end = simulation.t + dt
    kinks = [t for t in simulation.scene.kinks if simulation.t + 1e-12 < t < end - 1e-12]
    if kinks:
        raise check.InvalidValue("discrete", dt, f"must not reach past the scene's kink at t = {kinks[0]:g} s")
    steps = max(1, math.ceil(dt / simulation.dt * (1.0 - 1e-9)))
    return steps, dt / steps


def solved(
    simulation: Simulation, equations: Equations, flat: Array, w: Work, reduced: Reduced, dt: float
) -> tuple[Array, Array, Array]:
    """A, B and the next state of a period, along the motion that starts in the work array (which moves on)."""
    scheme = simulation.scheme
    steps, h = steps_of(simulation, dt)
    n, m, f = equations.independent.size, equations.inputs.size, equations.free.size
    if simulation.model.correction is not None:
        return _by_differences(simulation, equations, flat, w, reduced, h, steps)
    q = np.hstack([reduced.lift, np.zeros((f, n + m))])
    v = np.hstack([reduced.drift, reduced.lift, np.zeros((f, m))])
    a = reduced.lift @ reduced.accelerations + reduced.bend_v @ v + reduced.bend_q @ q
    tangents = _Tangents(q, v, a, a)
    for step in range(steps):
        start, b = point_of(w), w.b.copy()
        advance_steps(simulation, simulation.drive, flat, w, simulation.t + step * h, h, 1)
        end_point = point_of(w)
        found = _found(equations, scheme, h, start, b, end_point)
        derivatives = equations.derivatives(found, rates=False)
        tangents = _after(derivatives, scheme, h, tangents)
        if equations.algebraic.size:
            tangents = _settled(equations, derivatives, found, end_point, tangents)
    change = np.vstack([equations.changes(w.q, tangents.q), equations.changes(w.q, tangents.v)])
    return change[:, : 2 * n], change[:, 2 * n :], np.concatenate(equations.state(w.q, w.v))


def advance_steps(
    simulation: Simulation, drive: Drive, flat: Array, w: Work, at: float, h: float, steps: int
) -> None:
    """Equal steps of h from t = at; RuntimeError where they fail or have to be halved."""
    scheme = simulation.scheme
    if simulation.model.correction is not None:
        scheme = scheme._replace(tolerance=min(SHARP, scheme.tolerance))
    advance(SINGLE, simulation.model, drive, simulation.par, flat, simulation.n_motions, at, h, steps, scheme, (0,))
    if w.flag[0] != OK:
        bound = float(getattr(simulation.model, "bound", 0.0))
        text = MESSAGE[int(w.flag[0])].format(t=at, h=h, halvings=scheme.max_halvings, bound=bound)
        raise RuntimeError(f"the solver failed within the period: {text}")
    if w.counts[HALVINGS] > 0:
        raise RuntimeError(f"the solver halved the step of {h:.3g} s from t = {at:.6g} s; take a smaller dt")


def _offset(drive: Drive, entries: Rows, values: Array) -> Drive:
    """The drive with values added to the functions of some inputs, where they have one."""
    pieces = drive.pieces.copy()
    for entry, value in zip(entries, values, strict=True):
        own = drive.terms[drive.entries == entry]
        if own.size:
            pieces.reshape(-1, PIECE)[drive.first[own[0]] : drive.first[own[0] + 1], C0] += value
    return drive._replace(pieces=pieces)


def _by_differences(
    simulation: Simulation, e: Equations, flat: Array, w: Work, reduced: Reduced, h: float, steps: int
) -> tuple[Array, Array, Array]:
    """A, B and the next state of `steps` steps of h by sixth-order differences of the solver, in variables scaled so
    that each moves the coordinates, itself or by the accelerations it causes, by about as much."""
    start, dt = point_of(w), h * steps
    n, m = e.independent.size, e.inputs.size
    size = 1.0 / simulation.model.weight[e.free[e.independent]]
    caused = h * h * np.abs(reduced.accelerations / size[:, None]).max(axis=0)
    unit = 1.0 / np.maximum(np.concatenate([1.0 / size, dt / size, np.zeros(m)]), caused)

    def after(z: Array) -> Array:
        x, v, u = np.split(unit * z, [n, 2 * n])
        w.q[:], w.v[:], w.u[:], w.psi[:] = start.q, start.v, start.u, start.psi
        w.q[e.free] += reduced.lift @ x
        w.v[e.free] += reduced.lift @ v + reduced.drift @ x
        w.u[e.inputs] += u
        drive = _offset(simulation.drive, e.inputs, u)
        simulation.make_consistent(simulation.model, drive, flat)
        advance_steps(simulation, drive, flat, w, simulation.t, h, steps)
        return np.concatenate(e.state(w.q, w.v))

    rows = np.arange(2 * n + m)
    change = slopes(after, np.zeros(2 * n + m), rows, np.full(2 * n + m, STEP)) / unit
    return change[:, : 2 * n], change[:, 2 * n :], after(np.zeros(2 * n + m))


def _bordered(A: Array, G: Array, right: Array, below: Array | float = 0.0) -> Array:
    """x and lambda of A x + G' lambda = right, G x = below; scaled so that both parts of the matrix have one size."""
    f, g = A.shape[0], G.shape[0]
    scale = float(np.abs(A).max())
    matrix = np.zeros((f + g, f + g))
    matrix[:f, :f] = A
    matrix[:f, f:], matrix[f:, :f] = scale * G.T, scale * G
    x = np.linalg.solve(matrix, np.vstack([right, np.zeros((g, right.shape[1])) + scale * below]))
    x[f:] *= scale
    return np.asarray(x)


def _found(e: Equations, scheme: Scheme, h: float, start: Point, b: Array, end: Point) -> Point:
    """What Newton's iteration has found: the end itself, or with multipliers the point before it was settled."""
    if not e.algebraic.size:
        return end
    am, af, beta, gamma = scheme.alpha_m, scheme.alpha_f, scheme.beta, scheme.gamma
    free = e.free
    v, a, q = end.v.copy(), end.a.copy(), end.q.copy()
    new_b = ((end.q - start.q - h * start.v) / (h * h) - (0.5 - beta) * b)[free] / beta
    v[free] = start.v[free] + h * ((1.0 - gamma) * b[free] + gamma * new_b)
    a[free] = ((1.0 - am) * new_b - af * start.a[free] + am * b[free]) / (1.0 - af)
    q[e.algebraic] = 0.0
    found = replace(end, q=q, v=v, a=a)
    balance = e.residual(found)[free]
    q[e.algebraic] = -np.linalg.lstsq(e.constraint_slopes(found).T, balance, rcond=None)[0]
    return found


def _after(d: Derivatives, scheme: Scheme, h: float, t: _Tangents) -> _Tangents:
    """Tangents after Newton's iteration of a step of generalized-alpha."""
    am, af, beta, gamma = scheme.alpha_m, scheme.alpha_f, scheme.beta, scheme.gamma
    c_b, c_v = 1.0 / (beta * h * h), gamma / (beta * h)
    c_m = c_b * (1.0 - am) / (1.0 - af)
    q_ahead, v_ahead = t.q + h * t.v + h * h * (0.5 - beta) * t.b, t.v + h * (1.0 - gamma) * t.b
    right = d.M @ (c_m * q_ahead + (af * t.a - am * t.b) / (1.0 - af)) + d.C @ (c_v * q_ahead - v_ahead)
    right[:, right.shape[1] - d.B.shape[1] :] += d.B
    q = _bordered(c_m * d.M + c_v * d.C + d.K, d.G, right)[: len(right)]
    b = c_b * (q - q_ahead)
    return _Tangents(q, v_ahead + gamma * h * b, ((1.0 - am) * b - af * t.a + am * t.b) / (1.0 - af), b)


def _settled(e: Equations, d: Derivatives, found: Point, end: Point, t: _Tangents) -> _Tangents:
    """Tangents after v and a have been brought onto the constraints: M dv + G' Lambda = 0 and M da + G' dlambda = 0."""
    after = e.derivatives(end)
    f = len(e.free)

    def settled(before: Array, after_: Array, tangent: Array, below: Array) -> Array:
        right = d.M @ tangent + _jump_slopes(e, d, before - after_, end) @ t.q
        return _bordered(d.M, d.G, right, below)[:f]

    v = settled(found.v, end.v, t.v, -after.G_rate @ t.q)
    a = settled(found.a, end.a, t.a, -after.H_v @ v - after.H_q @ t.q)
    return _Tangents(t.q, v, a, t.b - t.a + a)


def _jump_slopes(e: Equations, d: Derivatives, jump: Array, end: Point) -> Array:
    """Derivative by q of M(q) jump + G(q)' impulses, which is zero at the end; rows that can move."""
    free, lam, zero = e.free, e.algebraic, np.zeros(e.n)
    moved = np.zeros(e.n)
    moved[free] = jump[free]
    impulses = -np.linalg.lstsq(d.G.T, d.M @ moved[free], rcond=None)[0]

    def momentum(q: Array) -> Array:
        with_impulse, without = q.copy(), q.copy()
        with_impulse[lam], without[lam] = impulses, 0.0
        still = Point(without, zero, zero, np.zeros_like(end.u), end.psi)
        return e.residual(replace(still, q=with_impulse, a=moved)) - e.residual(still)

    return slopes(momentum, end.q, free, e.steps)[free]
