"""Forces between a point of the arm and an obstacle: Hunt-Crossley normal force and regularized Coulomb friction.

    F_n = max(0, k d^n (1 + 3/2 alpha dd/dt)),    F_t = -mu F_n w / sqrt(|w|^2 + v_s^2)          theory, (6.8)

d is the penetration, w the sliding velocity of the sphere's surface in the tangent plane. Vectors
(`space.rotations.Vector`) are in inertial axes; in the plane z = 0.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from ...compiler import kernel, maximum, select_lt, square_root
from ..obstacles import distance_and_normal
from ..space.rotations import Vector, cross, dot
from .layout import LAWS


class Meeting(NamedTuple):
    """Contact of a point and an obstacle: geometry, rates, and forces on the arm (0 in lanes without contact)."""

    gap: Any  # m: signed distance of the sphere's surface, negative if it penetrates
    normal: Any  # `Vector`: unit normal that points out of the obstacle
    slip: Any  # m/s, `Vector`: sliding velocity w
    force: Any  # N: normal force F_n
    elastic: Any  # N: elastic part k d^n of F_n, the derivative of the stored energy
    stored: Any  # J: stored energy k d^(n + 1) / (n + 1)
    stiffness: Any  # N/m: derivative of F_n by the penetration d
    damper: Any  # N s/m: derivative of F_n by the rate dd/dt
    grip: Any  # N s/m: mu F_n / sqrt(|w|^2 + v_s^2), so that the friction is F_t = -grip w
    sliding: Any  # m/s: sliding speed |w|
    regular: Any  # m/s: regularized sliding speed sqrt(|w|^2 + v_s^2)


@kernel
def _power(x, root, halves):
    """Return x^(halves / 2) for x >= 0 and an integer `halves` from 0 to 6. root: the square root of x."""
    y = x * 0.0 + 1.0
    for _ in range(halves // 2):
        y = y * x
    if halves % 2 == 1:
        y = y * root
    return y


@kernel
def slip_velocity(radius, normal, velocity, spin):
    """Return the velocity (m/s) of the sphere's lowest point -r n in the tangent plane: v - n (n . v) + r n x omega."""
    return velocity - normal * dot(normal, velocity) + cross(normal, spin) * radius


@kernel
def meet(part, p, o, place, velocity, spin):
    """Return the `Meeting` of point p with obstacle o. place (m), velocity (m/s), spin (rad/s): motion of the point."""
    law, radius = LAWS.end * o, part.radii[p]
    far, nx, ny, nz = distance_and_normal(part.shapes, o, place[0], place[1], place[2])
    gap, normal = far - radius, Vector(nx, ny, nz)
    k, halves = part.laws[law + LAWS.stiffness], int(part.laws[law + LAWS.halves])
    alpha, mu, creep = part.laws[law + LAWS.damping], part.laws[law + LAWS.friction], part.laws[law + LAWS.creep]
    # normal force: d = -gap > 0, dd/dt = -n . v
    depth = maximum(-gap, 0.0)
    root = square_root(depth)
    lower = _power(depth, root, halves - 2) * k
    elastic = lower * depth
    factor = dot(normal, velocity) * (-1.5 * alpha) + 1.0
    pushes = select_lt(gap, 0.0, select_lt(0.0, factor, 1.0, 0.0), 0.0)
    force = elastic * factor * pushes
    slope, damper = lower * factor * pushes * (0.5 * halves), elastic * pushes * (1.5 * alpha)
    # friction: velocity of the sphere's surface
    slip = slip_velocity(radius, normal, velocity, spin)
    square = dot(slip, slip)
    regular = square_root(square + creep * creep)
    return Meeting(
        gap, normal, slip, force, elastic, elastic * depth * (2.0 / (halves + 2.0)), slope, damper,
        force * mu / regular, square_root(square), regular,
    )  # fmt: skip


@kernel
def gap_of(part, p, o, place):
    """Return the signed distance (m) of obstacle o from the sphere about point p; the point is at `place` (m)."""
    return distance_and_normal(part.shapes, o, place[0], place[1], place[2])[0] - part.radii[p]
