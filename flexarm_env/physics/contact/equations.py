"""Contact as a contribution (`physics.contributions`): forces at points, their block of the matrix, energy, damping.

The forces of all obstacles on a point act through the point's entries in the arm's inputs. Their derivative adds the
block B K B^T to the matrix, which is applied to solutions (theory, (6.7)) with a matrix K:

    (S + B K B^T)^-1 b = x - W C B^T x,   x = S^-1 b,   W = S^-1 B,   C = (1 + K B^T W)^-1 K

While no point touches, only the points' places and distances are computed. In lanes, arms that do not touch get
forces and blocks of 0.
"""

from __future__ import annotations

from ...compiler import Lanes, kernel, max_over_lanes, maximum, select_lt, sincos, size, square_root, stack
from .. import protocol
from ..contributions import register
from ..layout import POSE, SPACE_POSE
from .friction import column_of_slip, component, solve_friction, unit_entry
from .law import cross, dot, gap_of, meet
from .layout import HERE, LAWS, READ, Touching

_here = kernel(HERE.offsets)


@kernel
def here_of(part, p):
    """Return the offsets in S of point p's `HERE`."""
    axes, n = len(part.axes), size(part.room)
    first = _here(0, axes, n)
    return _here(part.at + p * first.end, axes, n)


@kernel
def obstacle_count(part):
    """Return the number of obstacles."""
    return part.meets.shape[0] // len(part.points)


@kernel
def place_of(lane, part, y: Lanes, p):
    """Return the place (m, three numbers) of point p from the arm's input displacements y."""
    k = part.input + p * len(part.entries)
    if len(part.space) == 2:
        return y[k], y[k + 1], 0.0 * y[k]
    return y[k], y[k + 1], y[k + 2]


@kernel
def motion_of(lane, part, poses: Lanes, p):
    """Return velocity (m/s) and angular velocity (rad/s) of point p, inertial axes, from the arm's task poses."""
    if len(part.space) == 2:
        o = POSE.end * part.links[p]
        zero = poses[o + POSE.tip_vx] * 0.0
        return (poses[o + POSE.tip_vx], poses[o + POSE.tip_vy], zero), (zero, zero, poses[o + POSE.tip_rate])
    o = SPACE_POSE.end * part.links[p]
    velocity = poses[o + SPACE_POSE.velocity], poses[o + SPACE_POSE.velocity + 1], poses[o + SPACE_POSE.velocity + 2]
    turn = poses[o + SPACE_POSE.turn], poses[o + SPACE_POSE.turn + 1], poses[o + SPACE_POSE.turn + 2]
    spin = poses[o + SPACE_POSE.spin], poses[o + SPACE_POSE.spin + 1], poses[o + SPACE_POSE.spin + 2]
    return velocity, _rotated(turn, spin)


@kernel
def _rotated(psi, x):
    """Return exp(psi^) x, the vector x rotated by the rotation vector psi (rad)."""
    square = dot(psi, psi)
    angle = square_root(square)
    sine, cosine = sincos(angle)
    small = select_lt(square, 1e-8, 1.0, 0.0)
    safe = select_lt(0.5, small, 1.0, square)
    # sin(a) / a and (1 - cos(a)) / a^2
    first = select_lt(0.5, small, 1.0 - square * (1.0 / 6.0), sine / square_root(safe))
    second = select_lt(0.5, small, 0.5 - square * (1.0 / 24.0), (1.0 - cosine) / safe)
    once = cross(psi, x)
    twice = cross(psi, once)
    return (
        x[0] + once[0] * first + twice[0] * second, x[1] + once[1] * first + twice[1] * second,
        x[2] + once[2] * first + twice[2] * second,
    )  # fmt: skip


@kernel
def _gap(lane, part, y: Lanes, p):
    """Return the distance (m) of point p from the nearest of its obstacles; y: the arm's input displacements."""
    least = 1e300
    place = place_of(lane, part, y, p)
    for o in range(obstacle_count(part)):
        if part.meets[p * obstacle_count(part) + o] > 0.5:
            gap = gap_of(part, p, o, place)
            least = select_lt(gap, least, gap, least)
    return least


@kernel
def _touches(gap):
    """Return whether the gap (m) is negative in any lane."""
    return max_over_lanes(select_lt(gap, 0.0, 1.0, 0.0)) > 0.5


@kernel
def _any_touches(lane, part, S: Lanes):
    """Return whether a point touches in any lane, by the gaps in S."""
    least = 1e300
    for p in range(len(part.points)):
        gap = S[here_of(part, p).gap]
        least = select_lt(gap, least, gap, least)
    return _touches(least)


@kernel
def wrench(part, p, met):
    """Return force (N) and moment about the point (N m) of a `Meeting` on the arm, two vectors of three."""
    friction = met.slip[0] * -met.grip, met.slip[1] * -met.grip, met.slip[2] * -met.grip
    # the friction force acts on the sphere's surface, at -r n
    moment = cross(met.normal, friction)
    radius = -part.radii[p]
    force = (
        met.normal[0] * met.force + friction[0], met.normal[1] * met.force + friction[1],
        met.normal[2] * met.force + friction[2],
    )  # fmt: skip
    return force, (moment[0] * radius, moment[1] * radius, moment[2] * radius)


@kernel
def point_forces(lane, part, model, par, state, S: Lanes, inputs: Lanes):
    """Store the gaps of all points in S and add the forces of obstacles (N, N m) to the arm's inputs."""
    y = stack(lane, model.points)
    protocol.input_displacements(lane, model.arm, par, state.q, y)
    for p in range(len(part.points)):
        S[here_of(part, p).gap] = _gap(lane, part, y, p)
        S[here_of(part, p).bound] = 0.0
    if _any_touches(lane, part, S):
        poses = stack(lane, part.poses)
        protocol.task_poses(lane, model.arm, par, state.q, state.v, poses)
        for p in range(len(part.points)):
            velocity, spin = motion_of(lane, part, poses, p)
            for o in range(obstacle_count(part)):
                if part.meets[p * obstacle_count(part) + o] > 0.5:
                    met = meet(part, p, o, place_of(lane, part, y, p), velocity, spin)
                    force, moment = wrench(part, p, met)
                    k = part.input + p * len(part.entries)
                    for i in range(len(part.axes)):
                        inputs[k + i] += component(part, force, moment, i)
                    if part.laws[LAWS.end * o + LAWS.friction] > 0.0:
                        _store_friction(lane, part, p, o, met, S)


@kernel
def _store_friction(lane, part, p, o, met, S: Lanes):
    """Store bound mu F_n, normal and sliding velocity of obstacle o where its bound is the largest of point p."""
    at = here_of(part, p)
    bound, before = met.grip * met.regular, S[at.bound]
    for k in range(3):
        S[at.normal + k] = select_lt(before, bound, met.normal[k], S[at.normal + k])
        S[at.slip + k] = select_lt(before, bound, met.slip[k], S[at.slip + k])
    S[at.creep] = select_lt(before, bound, part.laws[LAWS.end * o + LAWS.creep], S[at.creep])
    S[at.bound] = select_lt(before, bound, bound, before)


# --- the block of the matrix ---------------------------------------------------------------------------
@kernel
def _column(lane, at, n, S: Lanes, i):
    """Return column i of B (at: its offset in S) or of W, a view of n rows."""
    return S[at + i * n : at + (i + 1) * n]


@kernel
def assemble(lane, part, model, par, state, u: Lanes, weights, r, S: Lanes):
    """Store B and K of the points that touch, with weights.with_matrix; `point_forces` has stored their gaps."""
    if weights.with_matrix:
        for p in range(len(part.points)):
            at = here_of(part, p)
            S[at.active] = select_lt(S[at.gap], 0.0, 1.0, 0.0)
        if _any_touches(lane, part, S):
            y, poses = stack(lane, model.points), stack(lane, part.poses)
            protocol.input_displacements(lane, model.arm, par, state.q, y)
            protocol.task_poses(lane, model.arm, par, state.q, state.v, poses)
            for p in range(len(part.points)):
                if max_over_lanes(S[here_of(part, p).active]) > 0.5:
                    _store_stiffness(lane, part, p, weights, y, poses, S)
                    _store_columns(lane, part, p, model, par, state, u, S)


@kernel
def _store_columns(lane, part, p, model, par, state, u: Lanes, S: Lanes):
    """Store B of point p: column i, by how much a unit of component i on the point lowers the arm's residual."""
    at, n, rows = here_of(part, p), size(model.arm.n), size(part.room)
    inputs, still, moved = stack(lane, model.points), stack(lane, part.room), stack(lane, part.room)
    for k in range(size(model.n_inputs)):
        inputs[k] = u[k]
    protocol.residual(lane, model.arm, par, state, inputs, still, S)
    for i in range(len(part.axes)):
        k = part.input + p * len(part.entries) + i
        force = inputs[k]
        inputs[k] = force + 1.0
        protocol.residual(lane, model.arm, par, state, inputs, moved, S)
        inputs[k] = force
        column = _column(lane, at.B, rows, S, i)
        for j in range(rows):
            column[j] = 0.0
        for j in range(n):
            column[j] = still[j] - moved[j]


@kernel
def _store_stiffness(lane, part, p, weights, y: Lanes, poses: Lanes, S: Lanes):
    """Store K of point p: minus the derivative of its force by its displacement, whose rate follows it.

    With N the normal, A the map from the point's motion to the sliding velocity w and e = w / sqrt(|w|^2 + v_s^2), each
    obstacle adds k' N N^T - mu k' A^T e N^T + c A^T (1 - e e^T) A, where k' = weights.stiffness dF_n/dd +
    weights.damping dF_n/d(dd/dt) and c = weights.damping mu F_n / sqrt(|w|^2 + v_s^2). With weights.friction_apart the
    obstacle with the largest friction adds the first term alone, and `friction.apply` solves for its friction.
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
            met = meet(part, p, o, place_of(lane, part, y, p), velocity, spin)
            stiffness = met.stiffness * weights.stiffness + met.damper * weights.damping
            grip, scale = met.grip * weights.damping, 1.0 / met.regular
            e = met.slip[0] * scale, met.slip[1] * scale, met.slip[2] * scale
            friction = met.grip * met.regular
            # 0 for the friction that is solved for after the linear system
            share = S[at.rate] * 0.0 + 1.0
            if weights.friction_apart:
                share = select_lt(friction, S[at.bound], 1.0, 0.0)
            zero = (0.0, 0.0, 0.0)
            # A^T e and N
            turned = cross(met.normal, e)
            moment = turned[0] * -part.radii[p], turned[1] * -part.radii[p], turned[2] * -part.radii[p]
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
    """Return entry (i, j) of A^T A."""
    return dot(column_of_slip(part, p, normal, i), column_of_slip(part, p, normal, j))


@kernel
def fix_coordinate(lane, part, model, S: Lanes, k):
    """Set row k of B to 0 in points that touch: a fixed or prescribed coordinate does not move them."""
    n = size(part.room)
    for p in range(len(part.points)):
        at = here_of(part, p)
        if max_over_lanes(S[at.active]) > 0.5:
            for i in range(len(part.axes)):
                S[at.B + i * n + k] = 0.0


@kernel
def before_factor(lane, part, model, S: Lanes):
    """Set W and C to 0: `solve` leaves out the blocks until `after_factor` has run."""
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
    """Compute W = S^-1 B and C = (1 + K B^T W)^-1 K of each point that touches; S has the blocks of those before it."""
    axes, n = len(part.axes), size(part.room)
    for p in range(len(part.points)):
        at = here_of(part, p)
        if max_over_lanes(S[at.active]) > 0.5:
            for i in range(axes):
                column, source = stack(lane, part.room), _column(lane, at.B, n, S, i)
                for k in range(n):
                    column[k] = source[k]
                protocol.solve(lane, model, S, column)
                # W is read by `solve` only with C, which is still 0
                for k in range(n):
                    S[at.W + i * n + k] = column[k]
            _store_inverse(lane, part, p, S)


@kernel
def _store_inverse(lane, part, p, S: Lanes):
    """Compute C = (1 + K B^T W)^-1 K of point p by Gauss-Jordan elimination without pivoting."""
    at, axes, n = here_of(part, p), len(part.axes), size(part.room)
    product = stack(lane, part.axes)
    for j in range(axes):
        # column j of B^T W
        for m in range(axes):
            product[m] = _dot(lane, n, _column(lane, at.B, n, S, m), _column(lane, at.W, n, S, j))
        for i in range(axes):
            total = product[0] * 0.0 + unit_entry(i, j)
            for m in range(axes):
                total = total + S[at.K + axes * i + m] * product[m]
            S[at.work + axes * i + j] = total
            S[at.C + axes * i + j] = S[at.K + axes * i + j]
    for i in range(axes):
        inverse = 1.0 / S[at.work + axes * i + i]
        for j in range(axes):
            S[at.work + axes * i + j] *= inverse
            S[at.C + axes * i + j] *= inverse
        for m in range(axes):
            if m != i:
                share = S[at.work + axes * m + i]
                for j in range(axes):
                    S[at.work + axes * m + j] -= share * S[at.work + axes * i + j]
                    S[at.C + axes * m + j] -= share * S[at.C + axes * i + j]


@kernel
def _dot(lane, n, x: Lanes, y: Lanes):
    """Return x . y of n rows."""
    total = 0.0
    for k in range(n):
        total = total + x[k] * y[k]
    return total


@kernel
def _subtract(lane, part, p, S: Lanes, along, target, transposed, x: Lanes):
    """Compute x <- x - target C (along^T x), or with C^T (transposed True); along, target: offsets of B and W in S."""
    at, axes, n = here_of(part, p), len(part.axes), size(part.room)
    parts = stack(lane, part.axes)
    for j in range(axes):
        parts[j] = _dot(lane, n, _column(lane, along, n, S, j), x)
    for i in range(axes):
        share = 0.0
        for j in range(axes):
            entry = axes * j + i if transposed else axes * i + j
            share = share + S[at.C + entry] * parts[j]
        column = _column(lane, target, n, S, i)
        for k in range(n):
            x[k] -= column[k] * share


@kernel
def before_solve(lane, part, model, S: Lanes, x, transposed):
    """Compute x <- x - B C^T W^T x before a solution of S^T x = b (transposed True), of the last point first."""
    if transposed:
        for i in range(len(part.points)):
            p = len(part.points) - 1 - i
            at = here_of(part, p)
            if max_over_lanes(S[at.active]) > 0.5:
                _subtract(lane, part, p, S, at.W, at.B, True, x)


@kernel
def after_solve(lane, part, model, S: Lanes, x, transposed):
    """Compute x <- x - W C B^T x after a solution of S x = b without the points' blocks (theory, (6.7))."""
    if not transposed:
        for p in range(len(part.points)):
            at = here_of(part, p)
            if max_over_lanes(S[at.active]) > 0.5:
                _subtract(lane, part, p, S, at.B, at.W, False, x)


@kernel
def correct_increment(lane, part, model, S: Lanes, x: Lanes, fresh):
    """Correct x = S^-1 r by the friction of the points that touch, one after the other (`friction.solve_friction`).

    fresh: S has new factors; V = S^-1 B and D = B^T V are computed first.
    """
    axes, n = len(part.axes), size(part.room)
    for p in range(len(part.points)):
        at = here_of(part, p)
        if max_over_lanes(S[at.active] * S[at.bound]) > 0.0:
            if fresh:
                for i in range(axes):
                    column, source = _column(lane, at.V, n, S, i), _column(lane, at.B, n, S, i)
                    for k in range(n):
                        column[k] = source[k]
                    protocol.solve(lane, model, S, column)
                for i in range(axes):
                    for j in range(axes):
                        S[at.D + axes * i + j] = _dot(
                            lane, n, _column(lane, at.B, n, S, i), _column(lane, at.V, n, S, j)
                        )
            change = stack(lane, part.axes)
            for i in range(axes):
                change[i] = _dot(lane, n, _column(lane, at.B, n, S, i), x)
            solve_friction(lane, part, p, at, S, change)
            for i in range(axes):
                column = _column(lane, at.V, n, S, i)
                for k in range(n):
                    x[k] -= column[k] * change[i]


@kernel
def multiply(lane, part, model, S: Lanes, x, y: Lanes):
    """Add the product B K B^T x of the points' blocks to y (n rows)."""
    axes, n = len(part.axes), size(part.room)
    parts = stack(lane, part.axes)
    for p in range(len(part.points)):
        at = here_of(part, p)
        if max_over_lanes(S[at.active]) > 0.5:
            for j in range(axes):
                parts[j] = _dot(lane, n, _column(lane, at.B, n, S, j), x)
            for i in range(axes):
                share = 0.0
                for j in range(axes):
                    share = share + S[at.K + axes * i + j] * parts[j]
                column = _column(lane, at.B, n, S, i)
                for k in range(n):
                    y[k] += column[k] * share


# --- work and energy -----------------------------------------------------------------------------------
@kernel
def energy(lane, part, model, par, q, v, sums):
    """Return sums, (kinetic, strain, gravitational; J), with the energy k d^(n + 1) / (n + 1) stored in contacts."""
    kinetic, strain, gravity = sums
    y = stack(lane, model.points)
    protocol.input_displacements(lane, model.arm, par, q, y)
    zero = (0.0, 0.0, 0.0)
    for p in range(len(part.points)):
        if _touches(_gap(lane, part, y, p)):
            for o in range(obstacle_count(part)):
                if part.meets[p * obstacle_count(part) + o] > 0.5:
                    strain = strain + meet(part, p, o, place_of(lane, part, y, p), zero, zero).stored
    return kinetic, strain, gravity


@kernel
def damping_power(lane, part, model, par, q, v, x, total):
    """Return total (W) plus the power at rates x that contacts dissipate at rates v, by damping and friction."""
    y = stack(lane, model.points)
    protocol.input_displacements(lane, model.arm, par, q, y)
    least = 1e300
    for p in range(len(part.points)):
        gap = _gap(lane, part, y, p)
        least = select_lt(gap, least, gap, least)
    if _touches(least):
        rates, others = stack(lane, part.poses), stack(lane, part.poses)
        protocol.task_poses(lane, model.arm, par, q, v, rates)
        protocol.task_poses(lane, model.arm, par, q, x, others)
        for p in range(len(part.points)):
            velocity, spin = motion_of(lane, part, rates, p)
            other, turn = motion_of(lane, part, others, p)
            for o in range(obstacle_count(part)):
                if part.meets[p * obstacle_count(part) + o] > 0.5:
                    met = meet(part, p, o, place_of(lane, part, y, p), velocity, spin)
                    force, moment = wrench(part, p, met)
                    # all forces but the elastic one
                    power = dot(force, other) + dot(moment, turn) - dot(met.normal, other) * met.elastic
                    total = total - power
    return total


# --- readings ------------------------------------------------------------------------------------------
_FAR = 1e-3
"""Share of `Watch.reach`, the most that a point moves per weighted increment of 1, beyond which the gap of the last
Newton iterate tells that no point touches at the end of the step."""


@kernel
def after_step(lane, part, model, par, q, v, S: Lanes, h):
    """Store the `READING` of each point in S and add the forces times h (s) to its impulses.

    The forces at the end of a step count for the whole step, which integrates a force that begins and ends at 0 as the
    trapezoidal rule does.
    """
    least = 1e300
    for p in range(len(part.points)):
        gap = S[here_of(part, p).gap]
        least = select_lt(gap, least, gap, least)
    near = select_lt(least, model.newton.contact.reach * _FAR, 1.0, 0.0)
    if h == 0.0 or max_over_lanes(near) > 0.5:
        y, poses = stack(lane, model.points), stack(lane, part.poses)
        protocol.input_displacements(lane, model.arm, par, q, y)
        protocol.task_poses(lane, model.arm, par, q, v, poses)
        for p in range(len(part.points)):
            _store_reading(lane, part, p, y, poses, h, S)
    else:
        for p in range(len(part.points)):
            at = here_of(part, p)
            for k in range(READ.impulse):
                S[at.reading + k] = 0.0
            S[at.reading + READ.penetration] = -S[at.gap]


@kernel
def _store_reading(lane, part, p, y: Lanes, poses: Lanes, h, S: Lanes):
    """Store the `READING` of point p from input displacements y and task poses; add forces times h (s) to impulses."""
    velocity, spin = motion_of(lane, part, poses, p)
    least, normal, sliding, total, friction = 1e300, 0.0, 0.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for o in range(obstacle_count(part)):
        if part.meets[p * obstacle_count(part) + o] > 0.5:
            met = meet(part, p, o, place_of(lane, part, y, p), velocity, spin)
            force, _ = wrench(part, p, met)
            total = total[0] + force[0], total[1] + force[1], total[2] + force[2]
            friction = (
                friction[0] - met.slip[0] * met.grip, friction[1] - met.slip[1] * met.grip,
                friction[2] - met.slip[2] * met.grip,
            )  # fmt: skip
            normal = normal + met.force
            sliding = select_lt(met.gap, least, met.sliding, sliding)
            least = select_lt(met.gap, least, met.gap, least)
    at, tangential = here_of(part, p).reading, square_root(dot(friction, friction))
    S[at + READ.normal] = normal
    S[at + READ.tangential] = tangential
    S[at + READ.penetration] = -least
    S[at + READ.sliding] = sliding
    for k in range(3):
        S[at + READ.force + k] = total[k]
    S[at + READ.impulse] += normal * h
    S[at + READ.friction] += tangential * h
    S[at + READ.peak] = maximum(S[at + READ.peak], normal)


register(
    Touching, point_forces, assemble, fix_coordinate, before_factor, after_factor, before_solve, after_solve, multiply,
    energy, damping_power, after_step, correct_increment,
)  # fmt: skip
