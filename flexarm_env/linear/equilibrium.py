"""Rest under gravity and constant loads, and steady rotation: Newton, and where it fails, implicit steps downhill.

A step downhill minimises the potential plus s/2 |q - q_before|^2 in the norm of the mass matrix, by Newton; s falls as
the steps succeed, so that the last ones are Newton's own. From a start that is no equilibrium it ends in a stable one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import validation as check
from ..model import OK
from ..scene import JointTorque, Load, Motion, Scene
from ..settings import Settings
from ..simulation import Simulation
from ..time_functions import constant
from .equations import Equations, Point, exact_slopes, slopes

Array = NDArray[np.float64]

AT_REST = 1e-6
"""Acceleration (rad/s^2, or lengths of the arm / s^2) below which an arm counts as at rest."""

_LARGEST_MOVE = 0.3
"""Of one Newton iteration, rad or lengths of the arm."""


class NoEquilibrium(RuntimeError):
    """No equilibrium was found; the message says what was tried."""


def static_equilibrium(
    scene: Scene, formulation: str | None = None, *, hold_joints: bool = True, **options: Any
) -> Simulation:
    """The arm at rest under its gravity and its constant loads; loads that change with time are left out.

    Args:
        scene: its motions keep the value they have at t = 0.
        formulation, options: as for `simulate`.
        hold_joints: True: joints stay at their initial angles, and torques hold them, in place of the scene's joint
            torques; False: joints turn freely. From a start that is an equilibrium the arm does not move, even where
            that is unstable (an arm that stands upright).
    Returns:
        A Simulation of the same arm at rest, at t = 0; `joint_torques()` gives the holding torques, N m, and they go on
        acting.
    Raises:
        ValueError: an option that is not allowed. NoEquilibrium: with a sentence that says why.
    """
    if not isinstance(hold_joints, bool):
        raise check.InvalidValue("hold_joints", hold_joints, "must be True or False")
    simulation = still(check.instance("scene", scene, Scene), scene.settings(formulation, **options), hold_joints)
    equations = Equations(simulation)
    held = equations.inputs.tolist() if hold_joints else []
    work = simulation.work
    zero = np.zeros(equations.n)
    point = settle(equations, Point(work.q.copy(), zero, zero, work.u.copy(), work.psi.copy()), held)
    work.q[:], work.v[:] = point.q, 0.0
    simulation.set_torques(point.u[: equations.n_links])
    return simulation


def still(scene: Scene, settings: Settings, hold_joints: bool, **changes: Any) -> Simulation:
    """The scene at its start, its motions standing still, loads that change with time left out, `changes` made."""

    def kept(load: Load) -> bool:
        steady = all(len(f.pieces) == 1 and not f.pieces[0, 2:6].any() for f in load.functions)
        return steady and not (hold_joints and isinstance(load, JointTorque))

    moved = replace(scene, motions=(), **changes)
    quiet = replace(
        moved,
        motions=tuple(Motion(m.coordinate, constant(moved.initial_value(m.coordinate))) for m in scene.motions),
        loads=tuple(load for load in moved.loads if kept(load)),
    )
    return Simulation(quiet, settings)


def settle(equations: Equations, start: Point, held: Sequence[int], spin: float = 0.0) -> Point:
    """The point of rest, or of steady rotation about the origin (spin, rad/s), near the start.

    held: joints that stay at their angle; the point's u holds the torques that keep them there.
    """
    point = _settle(equations, start, held, spin)
    code = equations.status(point.q)
    if code != OK:
        bound = float(getattr(equations.model, "bound", 0.0))
        why = "beyond the range of the reduction to modes" if bound else "larger than a floating body can have"
        raise NoEquilibrium(
            f"the arm would deflect {why} at rest; take more segments (no modes), or formulation='geometrically_exact'"
        )
    return point


def _settle(equations: Equations, start: Point, held: Sequence[int], spin: float) -> Point:
    search = _Search(equations, start, held, spin)
    if len(held) == len(equations.joints):  # nothing can turn
        found = search.newton(start, 0.0)
        if found is not None:
            return found
    point, acceleration = search.accelerations(start)
    if acceleration < AT_REST:
        return point
    first = s = 10.0 * acceleration  # a first move of about 0.1
    for _ in range(60):
        moved = search.newton(point, s)
        if moved is None:
            s *= 4.0
            if s > 1e6 * first:
                break
            continue
        distance = float(np.abs((moved.q - point.q) * equations.model.weight)[equations.free].max())
        point, s = moved, 0.1 * s
        if distance < 0.01:
            found = search.newton(point, 0.0)
            if found is not None:
                return found
            if search.accelerations(point)[1] < AT_REST:
                return point
    acceleration = search.accelerations(point)[1]
    raise NoEquilibrium(
        "no equilibrium was found: "
        + ("nothing holds the arm, its root being free" if len(equations.inputs) < len(equations.joints) else
           "the loads may be too large for the arm, or the joints' torques may turn it on and on")
        + f"; the arm where the search ended still accelerates at {acceleration:.3g} rad/s^2 (or arm lengths/s^2)"
    )  # fmt: skip


class _Search:
    """Newton's iteration for coordinates, multipliers and holding torques."""

    def __init__(self, equations: Equations, start: Point, held: Sequence[int], spin: float) -> None:
        self.e, self.spin, self.held = equations, spin, list(held)
        self.columns = np.array([equations.inputs.tolist().index(k) for k in held], np.int64)
        self.angles = equations.joint_slopes(start.q)[self.held]
        self.target = equations.joint_angles(start.q, np.zeros(equations.n))[0][self.held]

    def at(self, point: Point, q: Array) -> Point:
        v, a = self.e.turned(q, self.spin)
        return replace(point, q=q, v=v, a=a)

    def residual(self, point: Point) -> Array:
        return self.e.residual(self.at(point, point.q))

    def matrices(self, point: Point) -> tuple[Array, Array, Array, Array]:
        """M, K with what the rotation adds, G and B of the held joints."""
        e, here = self.e, self.at(point, point.q)
        M = exact_slopes(lambda a: e.residual(replace(here, a=a)), here.a, e.free)[e.free]
        K = slopes(lambda q: e.residual(self.at(point, q)), point.q, e.free, e.steps)[e.free]
        G = e.constraint_slopes(here)
        rows = e.inputs[self.columns]
        B = -exact_slopes(lambda u: e.residual(replace(here, u=u)), here.u, rows)[e.free]
        return M, K, G, B

    def solve(self, A: Array, G: Array, B: Array, right: Array) -> Array:
        """Of the bordered system of coordinates, multipliers and holding torques (scaled to the stiffness)."""
        f, g, h = A.shape[0], G.shape[0], B.shape[1]
        scale = float(np.abs(A).max())
        matrix = np.zeros((f + g + h, f + g + h))
        matrix[:f, :f] = A
        matrix[:f, f : f + g], matrix[f : f + g, :f] = scale * G.T, scale * G
        matrix[:f, f + g :], matrix[f + g :, :f] = -scale * B, scale * self.angles
        scaled = right.copy()
        scaled[f:] *= scale
        try:
            x = np.linalg.solve(matrix, scaled)
        except np.linalg.LinAlgError:
            return np.full(f + g + h, np.nan)
        x[f:] *= scale
        return np.asarray(x, np.float64)

    def newton(self, start: Point, s: float) -> Point | None:
        """Rest at s = 0, otherwise a step downhill from the start; None where the iteration does not converge."""
        e, point, last = self.e, start, np.inf
        f, g = e.free.size, e.algebraic.size
        weight = e.model.weight[e.free]
        for _ in range(60 if s == 0.0 else 15):
            M, K, G, B = self.matrices(point)
            r = self.residual(point)
            angles = e.joint_angles(point.q, np.zeros(e.n))[0][self.held]
            pull = s * M @ (point.q - start.q)[e.free]
            x = self.solve(K + s * M, G, B, -np.concatenate([r[e.free] + pull, r[e.algebraic], angles - self.target]))
            size = float(np.abs(x[:f] * weight).max())
            if not np.isfinite(x).all() or size > 1e3:
                return None
            q, u = point.q.copy(), point.u.copy()
            q[e.free] += x[:f] * min(1.0, _LARGEST_MOVE / max(size, 1e-300))
            q[e.algebraic] += x[f : f + g]
            u[self.held] += x[f + g :]
            point = self.at(replace(point, u=u), q)
            if np.abs((q - start.q)[e.free] * weight).max() > (10.0 if self.held else 1.0):
                return None
            if size < 1e-9 or (size < 1e-6 and size > 0.5 * last):
                return point
            last = size
        return None

    def accelerations(self, point: Point) -> tuple[Point, float]:
        """The point with its multipliers and holding torques, and the largest weighted acceleration there."""
        e = self.e
        f, g = e.free.size, e.algebraic.size
        M, _, G, B = self.matrices(point)
        r = self.residual(point)
        x = self.solve(M, G, B, -np.concatenate([r[e.free], np.zeros(g + len(self.held))]))
        q, u = point.q.copy(), point.u.copy()
        q[e.algebraic] += x[f : f + g]
        u[self.held] += x[f + g :]
        return replace(point, q=q, u=u), float(np.abs(x[:f] * e.model.weight[e.free]).max())
