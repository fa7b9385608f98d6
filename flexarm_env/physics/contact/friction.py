"""Friction of a point on an obstacle, which each Newton iteration solves separately from the linear system (6.9).

Near rest the regularized law is so steep that Newton's iteration with the law's derivative would alternate between both
directions of sliding. Therefore the residual contains the friction force F_k of the present iterate, but the matrix S
does not contain the force's derivative. The solution x = S^-1 r is linear in a change of the force. The remaining
sliding velocity w follows from the force F(w) on the point:

    w = w_k - c_v A B^T x + c_v G (F(w) - F_k),   G = A B^T S^-1 B A^T,   F(w) = -mu F_n w / sqrt(|w|^2 + v_s^2)

The equation for the three components of w has a unique solution. Bisection for s = sqrt(|w|^2 + v_s^2) finds it.
"""

from __future__ import annotations

from ...compiler import Lanes, kernel, select_lt, square_root, stack
from ..space.rotations import Matrix, Vector, cross, dot, load_vector

_BISECTIONS = 52
"""Number of bisections of the interval of log(s) that contains the solution."""
_NINE = (0,) * 9


@kernel
def component(part, force, moment, i):
    """Return component i of the generalized force (force, moment) on a point; order: that of the arm's inputs."""
    # branches with `if`, which the compiler can differentiate backwards
    value = force[0]
    if i == 1:
        value = force[1]
    if len(part.space) == 2:
        # in the plane the moment about z alone
        if i == 2:
            value = moment[2]
    else:
        if i == 2:
            value = force[2]
        if i == 3:
            value = moment[0]
        if i == 4:
            value = moment[1]
        if i == 5:
            value = moment[2]
    return value


@kernel
def unit_entry(i, k):
    """Return 1.0 if i = k, otherwise 0.0."""
    entry = 0.0
    if i == k:
        entry = 1.0
    return entry


@kernel
def unit_vector(i):
    """Return the unit vector along axis i (0, 1 or 2)."""
    return Vector(unit_entry(i, 0), unit_entry(i, 1), unit_entry(i, 2))


@kernel
def column_of_slip(part, p, n, i):
    """Return column i of A as a `Vector`: the sliding velocity if component i of the point's motion has rate 1."""
    axes, radius = len(part.space), part.radii[p]
    normal = n[0]
    if i == 1:
        normal = n[1]
    if i == 2:
        normal = n[2]
    column = unit_vector(i) - n * normal
    if i >= axes:
        # rotations: r n x omega, in the plane about z
        about = i - 3
        if axes == 2:
            about = 2
        column = cross(n, unit_vector(about)) * radius
    return column


@kernel
def _velocity(u0, u1, u2, i1, i2, i3, stiffness):
    """Return (1 + c G)^-1 p for c = stiffness; u0, u1, u2: p, tr(G) p - G p, adj(G) p; i1, i2, i3: invariants of G.

    By Cayley and Hamilton (1 + c G)^-1 = (1 + c (tr(G) - G) + c^2 adj(G)) / (1 + c i1 + c^2 i2 + c^3 i3).
    """
    c = stiffness
    share = 1.0 / (((i3 * c + i2) * c + i1) * c + 1.0)
    return ((u2 * c + u1) * c + u0) * share


@kernel
def solve_friction(lane, part, p, at, S: Lanes, change: Lanes):
    """Solve for the friction of point p. `change` contains B^T x, then the change of the generalized force on p.

    # in        at: offsets in S of the point's `HERE`: D, bound, creep, normal, slip, rate
    """
    axes, rate, bound = len(part.axes), S[at.rate], S[at.bound] * S[at.active]
    normal, slip = load_vector(lane, S, at.normal), load_vector(lane, S, at.slip)
    creep = select_lt(0.0, bound, S[at.creep], 1.0)
    # G = A D A^T, and the sliding velocity without friction, p = w_k - c_v A B^T x - c_v G F_k
    G = stack(lane, _NINE)
    for k in range(9):
        G[k] = 0.0
    free = slip
    for i in range(axes):
        left = column_of_slip(part, p, normal, i)
        for j in range(axes):
            right, entry = column_of_slip(part, p, normal, j), S[at.D + axes * i + j] * rate
            for a in range(3):
                for b in range(3):
                    G[3 * a + b] += left[a] * right[b] * entry
        free = free - left * (change[i] * rate)
    grip = bound / square_root(dot(slip, slip) + creep * creep)
    g = Matrix(load_vector(lane, G, 0), load_vector(lane, G, 3), load_vector(lane, G, 6))
    u0 = free + (g @ slip) * grip
    # invariants of G, and adj(G) p
    adjugate = Matrix(cross(g[1], g[2]), cross(g[2], g[0]), cross(g[0], g[1]))
    i1, i2, i3 = g[0][0] + g[1][1] + g[2][2], adjugate[0][0] + adjugate[1][1] + adjugate[2][2], dot(g[0], adjugate[0])
    u1, u2 = u0 * i1 - g @ u0, adjugate.T @ u0
    # s between v_s and that without friction
    low, high = creep, square_root(dot(u0, u0) + creep * creep)
    for _ in range(_BISECTIONS):
        s = square_root(low * high)
        w = _velocity(u0, u1, u2, i1, i2, i3, bound / s)
        above = dot(w, w) + creep * creep
        low, high = select_lt(s * s, above, s, low), select_lt(s * s, above, high, s)
    share = bound / square_root(low * high)
    w = _velocity(u0, u1, u2, i1, i2, i3, share)
    force = slip * grip - w * share
    # the change of friction, as a generalized force on the point
    for i in range(axes):
        change[i] = dot(column_of_slip(part, p, normal, i), force)
