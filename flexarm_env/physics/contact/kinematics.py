"""Points that may touch: their offsets in S, position, motion, distance from obstacles, and the obstacles' forces."""

from __future__ import annotations

from ...compiler import Lanes, kernel, max_over_lanes, select_lt, size, stack
from .. import protocol
from ..layout import POSE, SPACE_POSE
from ..space.rotations import Vector, cross, load_vector, matrix, quaternion
from .law import gap_of, meet
from .layout import HERE

_here = kernel(HERE.offsets)


@kernel
def here_of(part, p):
    """Return the offsets in S of the fields of point p's record `HERE` (gap, forces and matrix entries)."""
    axes, n = len(part.axes), size(part.room)
    first = _here(0, axes, n)
    return _here(part.at + p * first.end, axes, n)


@kernel
def obstacle_count(part):
    """Return the number of obstacles in the contribution `part` of contacts."""
    return part.meets.shape[0] // len(part.points)


@kernel
def place_of(lane, part, y: Lanes, p):
    """Return the position of point p, a `Vector` (m, inertial axes), from the arm's input displacements y."""
    k = part.input + p * len(part.entries)
    if len(part.space) == 2:
        return Vector(y[k], y[k + 1], 0.0 * y[k])
    return load_vector(lane, y, k)


@kernel
def motions(lane, part, model, par, q, v, poses):
    """Write the motions of the points at coordinates q and rates v, which `motion_of` reads, to poses.

    The motions are those of the links' tips in the arm's task poses or, if a point is along a link, the velocities on
    which the inputs do work.
    """
    if part.inside is None:
        protocol.task_poses(lane, model.arm, par, q, v, poses)
    else:
        protocol.input_displacements(lane, model.arm, par, q, poses, None, v)


@kernel
def motion_of(lane, part, poses: Lanes, p):
    """Return velocity (m/s) and angular velocity (rad/s) of point p, inertial axes, from the result of `motions`."""
    if part.inside is not None:
        k = part.input + p * len(part.entries)
        if len(part.space) == 2:
            still = 0.0 * poses[k]
            return Vector(poses[k], poses[k + 1], still), Vector(still, still, poses[k + 2])
        return load_vector(lane, poses, k), load_vector(lane, poses, k + 3)
    if len(part.space) == 2:
        o = POSE.end * part.links[p]
        zero = poses[o + POSE.tip_vx] * 0.0
        velocity = Vector(poses[o + POSE.tip_vx], poses[o + POSE.tip_vy], zero)
        return velocity, Vector(zero, zero, poses[o + POSE.tip_rate])
    o = SPACE_POSE.end * part.links[p]
    # the spin of a task's pose is in section axes
    turn = matrix(quaternion(load_vector(lane, poses, o + SPACE_POSE.turn)))
    return load_vector(lane, poses, o + SPACE_POSE.velocity), turn @ load_vector(lane, poses, o + SPACE_POSE.spin)


@kernel
def less_obstacle(lane, part, o, rows: Lanes, vector):
    """Return `vector` minus the displacement or velocity of obstacle o, both in inertial axes.

    rows: q if `vector` is a position (m), v if `vector` is a velocity (m/s). Entries of `rows` are the components x, y
    and z of the obstacle's displacement or velocity. A component without an entry is 0. If part.moving is None (no
    obstacle moves), the function returns `vector`.
    """
    if part.moving is None:
        return vector
    x = _row_or_zero(lane, rows, part.moving[3 * o])
    y = _row_or_zero(lane, rows, part.moving[3 * o + 1])
    z = _row_or_zero(lane, rows, part.moving[3 * o + 2])
    return vector - Vector(x, y, z)


@kernel
def _row_or_zero(lane, rows: Lanes, k):
    """Return row k of `rows`, or 0 if k is negative."""
    return select_lt(float(k), -0.5, 0.0, rows[max(k, 0)])


@kernel
def meeting(lane, part, p, o, q: Lanes, v: Lanes, place, velocity, spin):
    """Return the `Meeting` of point p with obstacle o, from the point's motion relative to the obstacle.

    place (m), velocity (m/s), spin (rad/s): motion of the point, inertial axes.
    q: coordinates of the arm.
    v: rates of coordinates.
    """
    place, velocity = less_obstacle(lane, part, o, q, place), less_obstacle(lane, part, o, v, velocity)
    return meet(part, p, o, place, velocity, spin)


@kernel
def gap_at(lane, part, q: Lanes, y: Lanes, p):
    """Return the distance (m) of point p from the nearest obstacle that it may touch; y: input displacements."""
    least = 1e300
    place = place_of(lane, part, y, p)
    for o in range(obstacle_count(part)):
        if part.meets[p * obstacle_count(part) + o] > 0.5:
            gap = gap_of(part, p, o, less_obstacle(lane, part, o, q, place))
            least = select_lt(gap, least, gap, least)
    return least


@kernel
def nearest(lane, part, model, par, q, distance):
    """Return the smaller of `distance` (m) and the least distance of a point from an obstacle at coordinates q."""
    y = stack(lane, model.points)
    protocol.input_displacements(lane, model.arm, par, q, y)
    for p in range(len(part.points)):
        gap = gap_at(lane, part, q, y, p)
        distance = select_lt(gap, distance, gap, distance)
    return distance


@kernel
def touches(gap):
    """Return whether the gap (m) is negative in any lane."""
    return max_over_lanes(select_lt(gap, 0.0, 1.0, 0.0)) > 0.5


@kernel
def any_touches(lane, part, S: Lanes):
    """Return whether any point touches an obstacle in any lane, according to the gaps stored in S."""
    least = 1e300
    for p in range(len(part.points)):
        gap = S[here_of(part, p).gap]
        least = select_lt(gap, least, gap, least)
    return touches(least)


@kernel
def wrench(part, p, met):
    """Return the force (N) and the moment about the point (N m) of a `Meeting` on the arm, in inertial axes."""
    friction = met.slip * -met.grip
    # the friction force acts on the sphere's surface, at -r n
    return met.normal * met.force + friction, cross(met.normal, friction) * -part.radii[p]
