"""Points that may touch: their offsets in S, position and motion, distance from obstacles, and an obstacle's force."""

from __future__ import annotations

from ...compiler import Lanes, kernel, max_over_lanes, select_lt, sincos, size, square_root
from ..layout import POSE, SPACE_POSE
from .law import cross, dot, gap_of
from .layout import HERE

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
def gap_at(lane, part, y: Lanes, p):
    """Return the distance (m) of point p from the nearest of its obstacles; y: the arm's input displacements."""
    least = 1e300
    place = place_of(lane, part, y, p)
    for o in range(obstacle_count(part)):
        if part.meets[p * obstacle_count(part) + o] > 0.5:
            gap = gap_of(part, p, o, place)
            least = select_lt(gap, least, gap, least)
    return least


@kernel
def touches(gap):
    """Return whether the gap (m) is negative in any lane."""
    return max_over_lanes(select_lt(gap, 0.0, 1.0, 0.0)) > 0.5


@kernel
def any_touches(lane, part, S: Lanes):
    """Return whether a point touches in any lane, by the gaps in S."""
    least = 1e300
    for p in range(len(part.points)):
        gap = S[here_of(part, p).gap]
        least = select_lt(gap, least, gap, least)
    return touches(least)


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
