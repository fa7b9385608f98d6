"""Static equilibrium under gravity and constant loads, and steady rotation, by continuation from the unloaded arm.

Continuation: if no joint can turn, the loads (and the square of the spin rate) are increased from zero in steps. The
tangent of the equilibrium path predicts the next equilibrium, and Newton's iteration corrects the prediction. If the
result is unstable or far from the prediction, the load step is halved, so that the solution stays on the same branch. A
symmetric arm, such as a straight column above its critical load, stays on the symmetric branch, which is then unstable.

Minimization: if the path ends, or if joints can turn, Newton's method minimizes the potential energy V. Each step
minimizes V + s/2 |q - q_0|^2, where q_0 are the coordinates before the step and the norm is that of the mass matrix.
The factor s decreases after each successful step, so that the last steps are plain Newton steps. The result is a stable
equilibrium, unless the arm starts in an unstable equilibrium.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .. import validation as check
from ..equations import Equations, Point, at_rest_of
from ..physics.model import OK, has_play
from ..rest import NoEquilibrium, out_of_range, resting
from ..scene import JointTorque, Load, Motion, Scene
from ..settings import Settings
from ..simulation import Simulation
from ..time_functions import constant
from ..validation import Array
from .stability import Stability, at_rest

AT_REST = 1e-6
"""Acceleration (rad/s^2, or lengths of the arm / s^2) below which an arm counts as at rest."""

_LARGEST_MOVE = 0.3
"""Largest change of a coordinate (rad or arm lengths) in one Newton iteration and in the first load step."""

_ASTRAY, _AIM = 0.3, 0.15
"""Largest and desired distance of an equilibrium from its prediction, as shares of the step.

Above the largest distance the load step is halved.
"""

_SHORTEST = 1e-6
"""Load step, as a share of the loads reached, below which the path has ended."""

_LEAN = 1e-7
"""Largest lean (rad or arm lengths) of an unstable equilibrium that counts as symmetric: loads push it to no side.

Round-off, such as cos(pi/2) = 6e-17, must not select the side.
"""

_TURNS = 16
"""Largest number of turns by which loads may wind an arm up; an arm that turns further has no equilibrium."""

_MOST = 400
"""Largest number of Newton iterations in a search."""


class UnstableEquilibrium(UserWarning):
    """Warning that an equilibrium is unstable: after a small disturbance the arm moves away from it."""


class Equilibrium(Simulation):
    """Static equilibrium of an arm: a `Simulation` at rest at t = 0, returned by `static_equilibrium`.

    Attributes:
        stability: stability of the equilibrium, with the joints held or free according to `hold_joints`.
        followed: fraction of the loads up to which the equilibrium depends continuously on the loads. If `followed` is
            below 1.0, the arm snaps through at this fraction of the loads. `followed` is 0.0 if joints turn freely.
    """

    stability: Stability
    followed: float


def static_equilibrium(
    scene: Scene,
    formulation: str | None = None,
    *,
    hold_joints: bool = True,
    require_stable: bool | None = None,
    **options: Any,
) -> Equilibrium:
    """Compute the static equilibrium of an arm under gravity and constant loads; time-dependent loads are ignored.

    With held joints, all loads of a planar arm grow in proportion from zero to their values, while the function follows
    the equilibrium. With free joints the function returns a minimum of the potential energy. If the initial state is an
    equilibrium, the function returns this state, even if the state is unstable (such as an upright arm). In space the
    full loads act on the unloaded shape at once. Above the buckling load the result may therefore lie on another branch
    than the equilibrium that grows with the load, and may be unstable. For spatial scenes with `start="held"` there is
    no warning about an unstable result.

    Args:
        scene: the scene with the arm and its loads; prescribed motions keep their values at t = 0.
        formulation, options: formulation and options of the solver, as in `simulate`.
        hold_joints: if True, joints stay at their initial angles; holding torques replace the scene's joint torques,
            and an elastic gear is held at its motor. If False, joints turn freely, without Coulomb friction.
        require_stable: reaction to an unstable equilibrium, such as a straight column above its critical load. None:
            warn. True: raise NoEquilibrium. False: return the equilibrium without a warning.
    Returns:
        A Simulation of the same arm at rest, at t = 0, with its `stability`; `joint_torques()` returns the holding
        torques, N m, which continue to act.
    Raises:
        ValueError: an option is invalid. NoEquilibrium: no equilibrium was found, or it is unstable and require_stable
            is True; the message gives the reason.
    Warns:
        UnstableEquilibrium: the equilibrium is unstable (see require_stable).
    """
    if not isinstance(hold_joints, bool):
        raise check.InvalidValue("hold_joints", hold_joints, "must be True or False")
    if require_stable is not None and not isinstance(require_stable, bool):
        raise check.InvalidValue("require_stable", require_stable, "must be True, False or None")
    settings = check.instance("scene", scene, Scene).settings(formulation, **options)
    found = {"xy": _in_plane, "xyz": _in_space}[scene.axes](scene, settings, hold_joints)
    if require_stable is not False:
        warn_unstable(found.stability, bool(require_stable))
    return found


def _in_plane(scene: Scene, settings: Settings, hold_joints: bool) -> Equilibrium:
    """Compute the `static_equilibrium` of an arm in the plane."""
    found = Equilibrium(still(scene, hold_joints), settings)
    equations, start = at_rest_of(found)
    work, held = found.work, equations.inputs.tolist() if hold_joints else []
    point, found.followed = find_rest(equations, start, held)
    found.stability = at_rest(equations, point, held)
    work.q[:], work.v[:] = point.q, 0.0
    found.set_torques(point.u[: equations.n_links])
    return found


def _in_space(scene: Scene, settings: Settings, hold_joints: bool) -> Equilibrium:
    """Compute the `static_equilibrium` of an arm in space: the state in which `rest.relax` brings it to rest.

    Raises:
        NoEquilibrium: the arm has no equilibrium.
    """
    scene = still(scene, hold_joints)
    if scene.root == "free":
        raise check.InvalidValue("scene.root", scene.root, 'must be "pinned" for a rest')
    scene = replace(scene, start="held" if hold_joints else "equilibrium")
    found, held = Equilibrium(scene, settings), resting(scene)
    equations, point = at_rest_of(found)
    r, torques = equations.residual(point), found.work.u[: scene.arm.n_links].copy()
    # joints held by the search, but not by the scene
    for k, row in enumerate(equations.rows_turned):
        name = f"{'motor' if scene.arm.joint(k).elastic else 'joint'}{k}"
        if held.motion_of(name) is not None and scene.motion_of(name) is None:
            torques[k] += r[row]
    found.set_torques(torques)
    turning = [k for k in range(scene.arm.n_links) if scene.motion_of(f"joint{k}") is None]
    found.followed = 0.0
    found.stability = at_rest(*at_rest_of(found), turning if hold_joints else [])
    return found


def warn_unstable(stability: Stability, refuse: bool) -> None:
    """Warn about an unstable equilibrium, or raise NoEquilibrium if `refuse` is True."""
    if not stability.stable:
        text = (
            f"the equilibrium found is unstable: a small disturbance of it grows by exp({stability.growth:.3g} t / s), "
            f"in {stability.negative} direction(s); a small lateral load selects a direction"
        )
        if refuse:
            raise NoEquilibrium(text)
        warnings.warn(UnstableEquilibrium(text), stacklevel=3)


def still(scene: Scene, hold_joints: bool, **changes: Any) -> Scene:
    """Return the scene with motions fixed at their values for t = 0, without time-dependent loads.

    changes: other fields of the scene with their new values.
    """

    def kept(load: Load) -> bool:
        steady = all(len(f.pieces) == 1 and not f.pieces[0, 2:6].any() for f in load.functions)
        return steady and not (hold_joints and isinstance(load, JointTorque))

    contacts = tuple(contact.held() for contact in scene.contacts)
    moved = replace(scene, motions=(), start="unloaded", contacts=contacts, **changes)
    prescribed = [m.coordinate for m in scene.motions]
    if hold_joints:  # a motor without inertia cannot be held by a torque that goes on acting
        massless = [k for k, joint in enumerate(scene.arm.joints) if joint.elastic and joint.rotor == 0.0]
        prescribed += [f"motor{k}" for k in massless if f"motor{k}" not in prescribed]
    return replace(
        moved,
        motions=tuple(Motion(name, constant(moved.initial_value(name))) for name in prescribed),
        loads=tuple(load for load in moved.loads if kept(load)),
    )


def find_rest(equations: Equations, start: Point, held: Sequence[int], spin: float = 0.0) -> tuple[Point, float]:
    """Return the equilibrium near a start, and the fraction of the loads up to which continuation succeeded.

    With a spin (rad/s), the equilibrium is a steady rotation about the origin.

    start: the unloaded arm at its initial angles; `start.u` contains the loads. held: indices of the joints that stay
    at their angles. The field `u` of the returned point contains the torques that hold these joints.
    """
    search = _Search(equations, start, held, spin)
    point, followed = start, 0.0
    # in a gear's play no load holds the link: rest cannot be followed from the unloaded arm
    if not has_play(equations.model) and len(held) == len(equations.turned):  # nothing can turn
        point, followed = search.follow(start)
    if followed < 1.0:
        point = search.sink(point, followed)
    return point, followed


@dataclass(frozen=True)
class _Found:
    """Result of Newton's iteration: the point, its matrices A, G and B, and whether it is a minimum of the
    potential.
    """

    point: Point
    A: Array
    G: Array
    B: Array
    stable: bool


class _Search:
    """Newton's iteration for coordinates, multipliers and holding torques under a fraction (share) of the loads."""

    def __init__(self, equations: Equations, start: Point, held: Sequence[int], spin: float) -> None:
        self.full, self.spin, self.held = equations, spin, list(held)
        self.loads = start.u.copy()
        self.columns = np.array([equations.inputs.tolist().index(k) for k in held], np.int64)
        self.angles = equations.motor_slopes(start.q)[self.held]
        self.target = equations.motor_angles(start.q)[self.held]
        self.weight = equations.model.weight[equations.free]
        self.spent = 0

    def take(self, share: float) -> None:
        """Set the fraction of the loads that acts."""
        self.share, self.e = share, self.full.under(share)

    def at(self, point: Point, q: Array) -> Point:
        """Return the point moved to the coordinates q, with the present fraction of the loads and of the rotation."""
        v, a = self.e.rotating(q, self.spin * np.sqrt(self.share))
        u = self.share * self.loads
        u[self.held] = point.u[self.held]
        return replace(point, q=q, v=v, a=a, u=u)

    def follow(self, start: Point) -> tuple[Point, float]:
        """Follow the equilibrium from the unloaded start; return the last equilibrium and its fraction of the loads."""
        self.take(0.0)
        q = start.q.copy()
        q[self.e.algebraic] = 0.0
        found = self.newton(replace(start, q=q), 0.0, np.inf)
        assert found is not None  # without loads the start is at rest, and nothing acts in its joints
        share = step = 0.0
        while share < 1.0:
            point, toward = found.point, self.tangent(found)
            slope = self.size(toward)
            if share == 0.0:
                step = _LARGEST_MOVE / max(slope, 1e-300)
            most = 4.0
            while True:
                goal = min(1.0, share + step)
                self.take(goal)
                step = goal - share
                move = step * slope
                ahead = self.moved(point, step * toward)
                found = self.newton(ahead, 0.0, max(move, 1e-6))
                astray = np.inf if found is None else self.size((found.point.q - ahead.q)[self.e.free]) - 1e-7
                good = astray <= _ASTRAY * move
                if found is not None and good and (found.stable or self.on_a_ridge(found)):
                    break
                self.check(point, start, share)
                if found is not None and not found.stable:  # the end of the path is near
                    most = 1.0
                step *= 0.5 if astray <= move else 0.25
                if step < _SHORTEST * goal:
                    return point, share
            share = goal
            step *= most if astray <= 0.0 else min(most, _AIM * move / astray)
            self.check(found.point, start, share)
        return found.point, 1.0

    def check(self, point: Point, start: Point, share: float) -> None:
        """Raise NoEquilibrium if the path leaves the formulation's valid range, winds up a link, or takes too long."""
        if self.e.status(point.q) != OK:
            raise NoEquilibrium(out_of_range(self.e.model, f", from {share:.3g} of the loads on"))
        if self.size((point.q - start.q)[self.e.free]) > _TURNS * 2.0 * np.pi:
            raise NoEquilibrium(f"the loads are too large: they turn the arm by {_TURNS} times at {share:.3g} of them")
        if self.spent > _MOST and share < 1.0:
            raise NoEquilibrium(
                f"the loads are too large: the equilibrium exists from the unloaded arm up to {share:.3g} of them only"
            )

    def sink(self, start: Point, followed: float) -> Point:
        """Descend in the potential energy under all loads, from `start` to an equilibrium; return the equilibrium."""
        self.take(1.0)
        point, acceleration = self.accelerations(start)
        if acceleration < AT_REST:
            return point
        first = s = 10.0 * acceleration  # a first move of about 0.1
        most = self.spent + _MOST
        while self.spent < most and self.size((point.q - start.q)[self.e.free]) < 2.0 * np.pi:
            found = self.newton(point, s, 1.0)
            if found is None or not found.stable:
                s *= 4.0
                if s > 1e9 * first:
                    break
                continue
            distance = self.size((found.point.q - point.q)[self.e.free])
            point, s = found.point, 0.1 * s
            if distance < 0.01:
                last = self.newton(point, 0.0, 0.1)
                if last is not None and (last.stable or self.accelerations(point)[1] < AT_REST):
                    self.check(last.point, last.point, 1.0)
                    return last.point
                if self.accelerations(point)[1] < AT_REST:
                    return point
        joints, inputs = len(self.e.turned), len(self.e.inputs)
        why = "the loads may be too large for the arm, or the joints' torques may turn it on and on"
        if inputs < joints:
            why = "nothing holds the arm, its root being free"
        elif len(self.held) == joints:
            why = f"the equilibrium exists from the unloaded arm up to {followed:.3g} of the loads, where it snaps"
        raise NoEquilibrium(
            f"no equilibrium was found: {why}; the arm where the search ended still accelerates at "
            f"{self.accelerations(point)[1]:.3g} rad/s^2 (or arm lengths/s^2)"
        )

    def size(self, x: Array) -> float:
        """Return the largest weighted entry of a displacement of the movable coordinates, in rad or arm lengths."""
        return float(np.abs(x[: self.e.free.size] * self.weight).max(initial=0.0))

    def residual(self, point: Point) -> Array:
        """Return the residual r (n,), N and N m, at the point's q under the present fraction of loads and spin."""
        return self.e.residual(self.at(point, point.q))

    def inertia(self, point: Point) -> Array:
        """Return the mass matrix M (f, f)."""
        return self.e.inertia(self.at(point, point.q))

    def stiffness(self, point: Point) -> Array:
        """Return the stiffness K (f, f), including the terms of the rotation."""
        e, here = self.e, self.at(point, point.q)
        frame, ways = e.frame(here, self.spin * np.sqrt(self.share)), e.unit(e.free)
        return e.along(here, q=ways, v=frame.V @ ways, a=frame.W @ ways)[e.free]

    def borders(self, point: Point) -> tuple[Array, Array]:
        """Return the derivatives G of the constraints by the movable coordinates, and the forces B of unit torques of
        held joints in these coordinates.
        """
        e, here = self.e, self.at(point, point.q)
        return e.constraint_slopes(here), e.input_slopes(here, e.inputs[self.columns])

    def solve(self, A: Array, G: Array, B: Array, left: Array) -> Array:
        """Solve the bordered system, scaled to the stiffness; return the changes of coordinates, multipliers and
        torques.

        left: residuals of the first len(left) rows; the residuals of all other rows are 0.
        """
        f, g, h = A.shape[0], G.shape[0], B.shape[1]
        scale = float(np.abs(A).max(initial=0.0))
        matrix = np.zeros((f + g + h, f + g + h))
        matrix[:f, :f] = A
        matrix[:f, f : f + g], matrix[f : f + g, :f] = scale * G.T, scale * G
        matrix[:f, f + g :], matrix[f + g :, :f] = -scale * B, scale * self.angles
        scaled = np.zeros(f + g + h)
        scaled[: len(left)] = left
        scaled[f:] *= scale
        try:
            x = np.linalg.solve(matrix, -scaled)
        except np.linalg.LinAlgError:
            return np.full(f + g + h, np.nan)
        x[f:] *= scale
        return np.asarray(x, np.float64)

    def moved(self, point: Point, x: Array, share: float = 1.0) -> Point:
        """Return the point displaced by x; the part of x that belongs to the coordinates is multiplied by `share`."""
        e, f, g = self.e, self.e.free.size, self.e.algebraic.size
        q, u = point.q.copy(), point.u.copy()
        q[e.free] += share * x[:f]
        q[e.algebraic] += x[f : f + g]
        u[self.held] += x[f + g :]
        return self.at(replace(point, u=u), q)

    def tangent(self, found: _Found) -> Array:
        """Return the derivatives of coordinates, multipliers and torques by the fraction of the loads."""
        return self.solve(found.A, found.G, found.B, self.change(found.point, 1.0))

    def change(self, point: Point, other: float) -> Array:
        """Return the derivative (f,) of the residual by the loads' fraction: a difference to the fraction `other`."""
        share, before = self.share, self.residual(point)
        self.take(other)
        change = (self.residual(point) - before) / (other - share)
        self.take(share)
        return np.asarray(change[self.e.free], np.float64)

    def on_a_ridge(self, found: _Found) -> bool:
        """Return True if the loads do not push an unstable equilibrium to one side (deviation at most `_LEAN`)."""
        within = self.within(found.G)
        inner = within.T @ found.A @ within
        squares, shapes = np.linalg.eigh(0.5 * (inner + inner.T))
        away = within @ shapes[:, squares <= 0.0]
        lean = away @ ((away.T @ self.change(found.point, 0.0)) / np.minimum(squares[squares <= 0.0], -1e-300))
        return self.size(lean) <= _LEAN

    def newton(self, start: Point, s: float, reach: float) -> _Found | None:
        """Return the equilibrium (s = 0) or the end of a descent step; None if there is none within `reach`."""
        e, point, last = self.e, start, np.inf
        for _ in range(15):
            self.spent += 1
            r, A, (G, B) = self.residual(point), self.stiffness(point), self.borders(point)
            pull = np.zeros(e.free.size)
            if s != 0.0:
                M = self.inertia(point)
                A, pull = A + s * M, s * M @ (point.q - start.q)[e.free]
            angles = e.motor_angles(point.q)[self.held]
            x = self.solve(A, G, B, np.concatenate([r[e.free] + pull, r[e.algebraic], angles - self.target]))
            if not np.isfinite(x).all():
                return None
            size = self.size(x)
            point = self.moved(point, x, min(1.0, _LARGEST_MOVE / max(size, 1e-300)))
            if self.size((point.q - start.q)[e.free]) > reach:
                return None
            if size < 1e-9 or (size < 1e-6 and size > 0.5 * last):
                return _Found(point, A, G, B, self.convex(A, G))
            last = size
        return None

    def within(self, G: Array) -> Array:
        """Return an orthonormal basis (f, .) of the displacements that constraints and held joints permit."""
        walls = np.vstack([G, self.angles])
        return np.asarray(np.linalg.qr(walls.T, mode="complete")[0][:, len(walls) :], np.float64)

    def convex(self, A: Array, G: Array) -> bool:
        """Return whether A is positive definite for the displacements that constraints and held joints permit."""
        within = self.within(G)
        inner = within.T @ A @ within
        scale = np.sqrt(np.abs(inner.diagonal())) + 1e-300
        try:
            np.linalg.cholesky(0.5 * (inner + inner.T) / np.outer(scale, scale))
        except np.linalg.LinAlgError:
            return False
        return True

    def accelerations(self, point: Point) -> tuple[Point, float]:
        """Return the point with its multipliers and holding torques, and its largest weighted acceleration."""
        r, (G, B) = self.residual(point), self.borders(point)
        x = self.solve(self.inertia(point), G, B, r[self.e.free])
        return self.moved(point, x, 0.0), self.size(x)
