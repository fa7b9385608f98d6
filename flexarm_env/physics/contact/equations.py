"""Contact as a contribution (`physics.contributions`): forces at points, matrix block, energy and damping.

The forces of all obstacles on a point act through the point's entries in the arm's inputs. The derivative of the forces
adds the block B K B^T to the matrix, which is applied to solutions (`physics.point_block`).

While no point touches, only the points' positions and distances are computed. In lanes, arms without contact get forces
and blocks of 0.
"""

from __future__ import annotations

from ...compiler import Lanes, kernel, max_over_lanes, maximum, select_lt, size, stack
from .. import protocol
from ..contributions import register
from ..point_block import column, divide, product, store_columns, store_solutions, subtract
from ..space.rotations import Vector, cross, dot
from .account import after_step, damping_power, energy
from .clearance import acts, measure_near
from .friction import column_of_slip, component, solve_friction, unit_entry
from .kinematics import (
    any_touches,
    gap_at,
    here_of,
    meeting,
    motion_of,
    motions,
    nearest,
    obstacle_count,
    place_of,
    wrench,
)
from .layout import LAWS, Touching
from .moving import add_reactions


@kernel
def point_forces(lane, part, model, par, state, S: Lanes, inputs: Lanes):
    """Store the gaps of all points in S and add the forces of obstacles (N, N m) to the arm's inputs."""
    y = stack(lane, model.points)
    protocol.input_displacements(lane, model.arm, par, state.q, y)
    for p in range(len(part.points)):
        S[here_of(part, p).gap] = gap_at(lane, part, state.q, y, p)
        S[here_of(part, p).bound] = 0.0
    if any_touches(lane, part, S):
        poses = stack(lane, part.poses)
        motions(lane, part, model, par, state.q, state.v, poses)
        for p in range(len(part.points)):
            velocity, spin = motion_of(lane, part, poses, p)
            for o in range(obstacle_count(part)):
                if part.meets[p * obstacle_count(part) + o] > 0.5:
                    place = place_of(lane, part, y, p)
                    met = meeting(lane, part, p, o, state.q, state.v, place, velocity, spin)
                    force, moment = wrench(part, p, met)
                    k = part.input + p * len(part.entries)
                    for i in range(len(part.axes)):
                        inputs[k + i] += component(part, force, moment, i)
                    if part.laws[LAWS.end * o + LAWS.friction] > 0.0:
                        _store_friction(lane, part, p, o, met, S)


@kernel
def _store_friction(lane, part, p, o, met, S: Lanes):
    """Store friction bound mu F_n, normal, sliding velocity of obstacle o if its bound is the largest for point p."""
    at = here_of(part, p)
    bound, before = met.grip * met.regular, S[at.bound]
    for k in range(3):
        S[at.normal + k] = select_lt(before, bound, met.normal[k], S[at.normal + k])
        S[at.slip + k] = select_lt(before, bound, met.slip[k], S[at.slip + k])
    S[at.creep] = select_lt(before, bound, part.laws[LAWS.end * o + LAWS.creep], S[at.creep])
    S[at.bound] = select_lt(before, bound, bound, before)


@kernel
def _store_reactions(lane, part, model, par, state, r: Lanes, S: Lanes):
    """Write the rows of moving obstacles in r: the sum (N) of the forces that the obstacle exerts on the arm.

    Rows of moving obstacles are prescribed. The energy account therefore adds the work of these forces like that of
    other motions.
    """
    for i in range(part.moving.shape[0]):
        if part.moving[i] >= 0:
            r[part.moving[i]] = 0.0
    if any_touches(lane, part, S):
        add_reactions(lane, part, model, par, state.q, state.v, r)


@kernel
def inertia_forces(lane, part, model, par, a: Lanes, r: Lanes):
    """Set the rows of moving obstacles in r to 0, because obstacles have no mass."""
    if part.moving is not None:
        for i in range(part.moving.shape[0]):
            if part.moving[i] >= 0:
                r[part.moving[i]] = 0.0


# --- the block of the matrix ---------------------------------------------------------------------------
@kernel
def assemble(lane, part, model, par, state, u: Lanes, weights, r, S: Lanes):
    """With weights.with_matrix, store B and K of each touching point. `point_forces` has stored the gaps before.

    Rows of moving obstacles in r receive the forces that move the obstacles.
    """
    if part.moving is not None:
        _store_reactions(lane, part, model, par, state, r, S)
    if weights.with_matrix:
        for p in range(len(part.points)):
            at = here_of(part, p)
            S[at.active] = select_lt(S[at.gap], 0.0, 1.0, 0.0)
        if any_touches(lane, part, S):
            y, poses = stack(lane, model.points), stack(lane, part.poses)
            protocol.input_displacements(lane, model.arm, par, state.q, y)
            motions(lane, part, model, par, state.q, state.v, poses)
            for p in range(len(part.points)):
                if max_over_lanes(S[here_of(part, p).active]) > 0.5:
                    _store_stiffness(lane, part, p, weights, state.q, state.v, y, poses, S)
                    first = part.input + p * len(part.entries)
                    store_columns(
                        lane, model, par, state, u, first, part.axes, part.room, S, here_of(part, p).B
                    )  # fmt: skip


@kernel
def _store_stiffness(lane, part, p, weights, q, v, y: Lanes, poses: Lanes, S: Lanes):
    """Store K of point p: minus the derivative of its force by its displacement, including the rate of displacement.

    N is the normal, A the map from the point's motion to the sliding velocity w, and e = w / sqrt(|w|^2 + v_s^2). Each
    obstacle adds k' N N^T - mu k' A^T e N^T + c A^T (1 - e e^T) A, where k' = weights.stiffness dF_n/dd +
    weights.damping dF_n/d(dd/dt) and c = weights.damping mu F_n / sqrt(|w|^2 + v_s^2). With weights.friction_apart, the
    obstacle with the largest friction adds only the first term. `friction.solve_friction` solves for its friction.
    """
    at, axes = here_of(part, p), len(part.axes)
    for j in range(axes * axes):
        S[at.K + j] = 0.0
    S[at.rate] = 0.0
    if weights.friction_apart:
        S[at.rate] = 0.0 + weights.damping
    velocity, spin = motion_of(lane, part, poses, p)
    along, normal = stack(lane, part.axes), stack(lane, part.axes)
    for o in range(obstacle_count(part)):
        if part.meets[p * obstacle_count(part) + o] > 0.5:
            met = meeting(lane, part, p, o, q, v, place_of(lane, part, y, p), velocity, spin)
            stiffness = met.stiffness * weights.stiffness + met.damper * weights.damping
            grip, scale = met.grip * weights.damping, 1.0 / met.regular
            e = met.slip * scale
            friction = met.grip * met.regular
            # 0 for the friction that is solved for after the linear system
            share = S[at.rate] * 0.0 + 1.0
            if weights.friction_apart:
                share = select_lt(friction, S[at.bound], 1.0, 0.0)
            zero = Vector(0.0, 0.0, 0.0)
            # A^T e and N
            moment = cross(met.normal, e) * -part.radii[p]
            for i in range(axes):
                along[i] = component(part, e, moment, i)
                normal[i] = component(part, met.normal, zero, i)
            slides = select_lt(0.0, met.force, friction / maximum(met.force, 1e-300), 0.0) * share
            grip = grip * share
            for i in range(axes):
                for j in range(axes):
                    entry = (normal[i] - along[i] * slides) * (normal[j] * stiffness)
                    entry = entry + grip * (_tangential(part, p, met.normal, i, j) - along[i] * along[j])
                    S[at.K + axes * i + j] += entry


@kernel
def _tangential(part, p, normal, i, j):
    """Return entry (i, j) of A^T A, where A maps the point's motion to the sliding velocity."""
    return dot(column_of_slip(part, p, normal, i), column_of_slip(part, p, normal, j))


@kernel
def fix_coordinate(lane, part, model, S: Lanes, k):
    """Set row k of B to 0 for touching points, because a fixed or prescribed coordinate does not move a point."""
    n = size(part.room)
    for p in range(len(part.points)):
        at = here_of(part, p)
        if max_over_lanes(S[at.active]) > 0.5:
            for i in range(len(part.axes)):
                S[at.B + i * n + k] = 0.0


@kernel
def before_factor(lane, part, model, S: Lanes):
    """Set W and C of all points to 0, so that `solve` omits the points' blocks until `after_factor` has run."""
    axes, n = len(part.axes), size(part.room)
    for p in range(len(part.points)):
        at = here_of(part, p)
        if max_over_lanes(S[at.active]) > 0.5:
            for j in range(axes * n):
                S[at.W + j] = 0.0
            for j in range(axes * axes):
                S[at.C + j] = 0.0


@kernel
def after_factor(lane, part, model, S: Lanes):
    """Compute W = S^-1 B and C = (1 + K B^T W)^-1 K for each touching point.

    For each point, the solution with S already includes the blocks of the preceding points.
    """
    for p in range(len(part.points)):
        at = here_of(part, p)
        if max_over_lanes(S[at.active]) > 0.5:
            # `solve` leaves this point out, because its C is still 0
            store_solutions(lane, model, part.axes, part.room, S, at.B, at.W)
            _store_inverse(lane, part, p, S)


@kernel
def _store_inverse(lane, part, p, S: Lanes):
    """Compute C = (1 + K B^T W)^-1 K of point p."""
    at, axes, n = here_of(part, p), len(part.axes), size(part.room)
    moved = stack(lane, part.axes)
    for j in range(axes):
        # column j of B^T W
        for m in range(axes):
            moved[m] = product(lane, n, column(lane, at.B, part.room, S, m), column(lane, at.W, part.room, S, j))
        for i in range(axes):
            total = moved[0] * 0.0 + unit_entry(i, j)
            for m in range(axes):
                total = total + S[at.K + axes * i + m] * moved[m]
            S[at.work + axes * i + j] = total
            S[at.C + axes * i + j] = S[at.K + axes * i + j]
    divide(lane, part.axes, S, at.work, at.C)


@kernel
def before_solve(lane, part, model, S: Lanes, x, transposed):
    """If transposed, compute x <- x - B C^T W^T x before S^T x = b is solved, from the last point to the first."""
    if transposed:
        for i in range(len(part.points)):
            p = len(part.points) - 1 - i
            at = here_of(part, p)
            if max_over_lanes(S[at.active]) > 0.5:
                subtract(lane, part.axes, part.room, S, at.W, at.B, at.C, True, x)


@kernel
def after_solve(lane, part, model, S: Lanes, x, transposed):
    """Compute x <- x - W C B^T x after a solution of S x = b without the points' blocks (theory, (6.7))."""
    if not transposed:
        for p in range(len(part.points)):
            at = here_of(part, p)
            if max_over_lanes(S[at.active]) > 0.5:
                subtract(lane, part.axes, part.room, S, at.B, at.W, at.C, False, x)


@kernel
def correct_increment(lane, part, model, S: Lanes, x: Lanes, fresh):
    """Correct x = S^-1 r by the friction of each touching point, one after another (`friction.solve_friction`).

    fresh: True if S has new factors. V = S^-1 B and D = B^T V are then computed first.
    """
    axes, n = len(part.axes), size(part.room)
    for p in range(len(part.points)):
        at = here_of(part, p)
        if max_over_lanes(S[at.active] * S[at.bound]) > 0.0:
            if fresh:
                store_solutions(lane, model, part.axes, part.room, S, at.B, at.V)
                for i in range(axes):
                    source = column(lane, at.B, part.room, S, i)
                    for j in range(axes):
                        S[at.D + axes * i + j] = product(lane, n, source, column(lane, at.V, part.room, S, j))
            change = stack(lane, part.axes)
            for i in range(axes):
                change[i] = product(lane, n, column(lane, at.B, part.room, S, i), x)
            solve_friction(lane, part, p, at, S, change)
            for i in range(axes):
                own = column(lane, at.V, part.room, S, i)
                for k in range(n):
                    x[k] -= own[k] * change[i]


@kernel
def multiply(lane, part, model, S: Lanes, x, y: Lanes):
    """Add the product B K B^T x of the points' blocks to y (n rows)."""
    axes, n = len(part.axes), size(part.room)
    parts = stack(lane, part.axes)
    for p in range(len(part.points)):
        at = here_of(part, p)
        if max_over_lanes(S[at.active]) > 0.5:
            for j in range(axes):
                parts[j] = product(lane, n, column(lane, at.B, part.room, S, j), x)
            for i in range(axes):
                share = 0.0
                for j in range(axes):
                    share = share + S[at.K + axes * i + j] * parts[j]
                own = column(lane, at.B, part.room, S, i)
                for k in range(n):
                    y[k] += own[k] * share


register(
    Touching, point_forces, assemble, fix_coordinate, before_factor, after_factor, before_solve, after_solve, multiply,
    energy, damping_power, acts, measure_near, after_step, correct_increment, inertia_forces, nearest,
)  # fmt: skip
