"""Friction of a point on an obstacle, solved for in each Newton iteration beside the linear system (theory, (6.9)).

Near rest the regularized law is so steep that Newton's iteration with the law's derivative alternates between both
directions of sliding. Therefore the residual contains the friction force F_k of the present iterate, but the matrix S
does not contain its derivative. The solution x = S^-1 r is linear in a change of the force. So is the remaining sliding
velocity:

    w = w_k - c_v A B^T x + c_v G (F(w) - F_k),   G = A B^T S^-1 B A^T,   F(w) = -mu F_n w / sqrt(|w|^2 + v_s^2)

This equation for the three components of w has one solution. Bisection for s = sqrt(|w|^2 + v_s^2) finds it.
"""

from __future__ import annotations

from ...compiler import Lanes, kernel, select_lt, square_root, stack
from .law import cross, dot

_BISECTIONS = 52
"""Halvings of the logarithm of the bracket of s."""
_NINE = (0,) * 9


@kernel
def component(part, force, moment, i):
    """Return component i of a generalized force on a point, in the order of the point's entries in the inputs."""
    axes = len(part.space)
    if i < axes:
        return force[0] if i == 0 else (force[1] if i == 1 else force[2])
    # in the plane the moment about z alone
    if axes == 2:
        return moment[2]
    return moment[0] if i == 3 else (moment[1] if i == 4 else moment[2])


@kernel
def unit_entry(i, k):
    """Return 1.0 where i = k, otherwise 0.0."""
    return 1.0 if i == k else 0.0


@kernel
def column_of_slip(part, p, n, i):
    """Return column i of A (three numbers): sliding velocity for a unit rate of component i of the point's motion."""
    axes, radius = len(part.space), part.radii[p]
    if i < axes:
        normal = n[0] if i == 0 else (n[1] if i == 1 else n[2])
        return (
            unit_entry(i, 0) - n[0] * normal, unit_entry(i, 1) - n[1] * normal, unit_entry(i, 2) - n[2] * normal
        )
    # rotations: r n x omega
    about = 2 if axes == 2 else i - 3
    turned = cross(n, (unit_entry(about, 0), unit_entry(about, 1), unit_entry(about, 2)))
    return turned[0] * radius, turned[1] * radius, turned[2] * radius


@kernel
def _row(lane, matrix: Lanes, i):
    """Return row i of a matrix of nine numbers."""
    return matrix[3 * i], matrix[3 * i + 1], matrix[3 * i + 2]


@kernel
def _times(lane, matrix: Lanes, x):
    """Return the product of a matrix of nine numbers, by rows, and a vector of three."""
    return dot(_row(lane, matrix, 0), x), dot(_row(lane, matrix, 1), x), dot(_row(lane, matrix, 2), x)


@kernel
def _speed(u0, u1, u2, i1, i2, i3, stiffness):
    """Return |(1 + c G)^-1 p|^2 at c = stiffness; u0, u1, u2: p, tr(G) p - G p, adj(G) p; i1, i2, i3: invariants of G.

    By Cayley and Hamilton (1 + c G)^-1 = (1 + c (tr(G) - G) + c^2 adj(G)) / (1 + c i1 + c^2 i2 + c^3 i3).
    """
    c = stiffness
    share = 1.0 / (((i3 * c + i2) * c + i1) * c + 1.0)
    x = (u2[0] * c + u1[0]) * c + u0[0]
    y = (u2[1] * c + u1[1]) * c + u0[1]
    z = (u2[2] * c + u1[2]) * c + u0[2]
    return x * share, y * share, z * share


@kernel
def solve_friction(lane, part, p, at, S: Lanes, change: Lanes):
    """Solve for the friction of point p; change: in, B^T x; out, the change of the generalized force on the point.

    # in        at: offsets in S of the point's `HERE`: D, bound, creep, normal, slip, rate
    """
    axes, rate, bound = len(part.axes), S[at.rate], S[at.bound] * S[at.active]
    normal = S[at.normal], S[at.normal + 1], S[at.normal + 2]
    slip = S[at.slip], S[at.slip + 1], S[at.slip + 2]
    creep = select_lt(0.0, bound, S[at.creep], 1.0)
    # G = A D A^T, and the sliding velocity without friction, p = w_k - c_v A B^T x - c_v G F_k
    G = stack(lane, _NINE)
    for k in range(9):
        G[k] = 0.0
    p0, p1, p2 = slip
    for i in range(axes):
        left = column_of_slip(part, p, normal, i)
        for j in range(axes):
            right, entry = column_of_slip(part, p, normal, j), S[at.D + axes * i + j] * rate
            for a in range(3):
                for b in range(3):
                    G[3 * a + b] += left[a] * right[b] * entry
        moved = change[i] * rate
        p0, p1, p2 = p0 - left[0] * moved, p1 - left[1] * moved, p2 - left[2] * moved
    grip = bound / square_root(dot(slip, slip) + creep * creep)
    given = _times(lane, G, slip)
    u0 = p0 + given[0] * grip, p1 + given[1] * grip, p2 + given[2] * grip
    # invariants of G, and adj(G) p
    first, second, third = _row(lane, G, 0), _row(lane, G, 1), _row(lane, G, 2)
    i1 = first[0] + second[1] + third[2]
    c0, c1, c2 = cross(second, third), cross(third, first), cross(first, second)
    i2, i3 = c0[0] + c1[1] + c2[2], dot(first, c0)
    moved_p = _times(lane, G, u0)
    u1 = u0[0] * i1 - moved_p[0], u0[1] * i1 - moved_p[1], u0[2] * i1 - moved_p[2]
    u2 = (
        c0[0] * u0[0] + c1[0] * u0[1] + c2[0] * u0[2], c0[1] * u0[0] + c1[1] * u0[1] + c2[1] * u0[2],
        c0[2] * u0[0] + c1[2] * u0[1] + c2[2] * u0[2],
    )  # fmt: skip
    # s between v_s and that without friction
    low, high = creep, square_root(dot(u0, u0) + creep * creep)
    for _ in range(_BISECTIONS):
        s = square_root(low * high)
        w = _speed(u0, u1, u2, i1, i2, i3, bound / s)
        above = dot(w, w) + creep * creep
        low, high = select_lt(s * s, above, s, low), select_lt(s * s, above, high, s)
    share = bound / square_root(low * high)
    w = _speed(u0, u1, u2, i1, i2, i3, share)
    force = slip[0] * grip - w[0] * share, slip[1] * grip - w[1] * share, slip[2] * grip - w[2] * share
    # the change of friction, as a generalized force on the point
    for i in range(axes):
        change[i] = dot(column_of_slip(part, p, normal, i), force)
