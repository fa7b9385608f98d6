"""A link in space whose coordinates are its strains: torsion and two curvatures as sums of Legendre polynomials.

The Gauss points divide the link into intervals. Over an interval the section rotates by the vector psi = s + s x d
(Magnus' series to fourth order). The vector s is the integral of the strain over the interval. The vector d is the
first moment of the strain about the interval's middle, divided by the interval's length. s and d are linear in the
coordinates. The Cayley vector x = tan(|psi|/2) psi/|psi| of the rotation has rational rates:

    rel = 2 (x' - x x x') / (1 + x.x),   rel' = 2 (x'' - x x x'') / (1 + x.x) - 2 (x.x') rel / (1 + x.x)

The vector `rel` is the relative angular velocity along the axes of the interval's end. The position of a Gauss point is
a weighted sum of the link's tangents. Positions are therefore a function of the coordinates. The transposed derivative
of this function maps the forces on the points to generalized forces, to round-off. The chain therefore obeys its
conservation laws for any number of points. All vectors are in the axes of the link's root unless stated otherwise. See
docs/theory.md, section 9.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from ...compiler import Lanes, inlined, kernel, size, square_root, stack
from ..arithmetic import store_vector
from ..model import TAU_D
from ..protocol import added
from .chain import Vertex
from .element import Place
from .layout import AXES, factors_of, joint_row
from .matrix import matrix_in
from .moving import move_vertex, store_increment
from .rotations import (
    Vector,
    add_vector,
    compose,
    cross,
    dot,
    load_vector,
    matrix,
    polynomial,
    scale,
    store_matrix,
    three_of,
)
from .strained_layout import noted_at, strained_at

_TANGENT = (1.0, 1 / 12, 1 / 120, 17 / 20160, 31 / 362880, 691 / 79833600, 5461 / 6227020800, 929569 / 10461394944000)
TANGENT = _TANGENT[::-1]
"""Coefficients, highest power first, of the series f in tan(a/2) = a f(a^2) / 2; error 1e-9 for a = 1 rad."""
_SLOPE = tuple(k * c for k, c in enumerate(_TANGENT))[1:]
# f' and f'' by a^2
SLOPE = _SLOPE[::-1]
CURVE = tuple(k * c for k, c in enumerate(_SLOPE))[:0:-1]


class Bend(NamedTuple):
    """Rotation of one interval and its rates, in the axes of the interval's end unless stated otherwise.

    x, psi: Cayley vector x = tan(|psi|/2) psi/|psi|, and rotation vector psi = s + s x d (rad)
    s, d: integral and first moment of the strain over the interval, rad
    f: value at psi.psi of the series `TANGENT`, with which x = psi f / 2
    rel: angular velocity that the interval adds, rad/s; None if rates are not computed
    second: angular acceleration that the interval adds, rad/s^2; None if accelerations are not computed
    """

    x: Any
    psi: Any
    s: Any
    d: Any
    share: Any  # the number 1 / (1 + x.x)
    f: Any
    slope: Any  # derivative of the series f at psi.psi
    rel: Any
    second: Any


@kernel
def strain_row(model, k):
    """Return the first row, in q and r, of the strains of link k."""
    return joint_row(model, k) + 1


@kernel
def _sum(lane, model, table, i, x, row):
    """Return row i of a table times the coefficients in x from `row` on, as a vector: torsion, bending about y and z.

    table: offset of the table in model.strains; it has a row for each interval and a column for each polynomial.
    """
    n = size(model.polynomials)
    total = model.strains[table + n * i] * load_vector(lane, x, row)
    for j in range(1, n):
        total = total + model.strains[table + n * i + j] * load_vector(lane, x, row + 3 * j)
    return total


@kernel
def slope_of_slope(z):
    """Return the second derivative f''(z) of the series f (`TANGENT`) at a squared angle z (rad^2)."""
    return polynomial(CURVE, z)


@kernel
def bend_of(lane, model, at, i, row, q, v, a):
    """Return the `Bend` of interval i: its rotation, and the rates of the rotation if v and a are not None.

    at: offsets of the link's constants (`strained_at`).
    q, v, a: the arm's coordinates, rates, accelerations.
    row: row of the link's first strain. See docs/theory.md, (9.5).
    """
    s, d = _sum(lane, model, at.sums, i, q, row), _sum(lane, model, at.slants, i, q, row)
    # s and d of kappa_0 add, which lies in the link's x-y plane: bending about z
    if model.curved is not None:
        s = Vector(s[0], s[1], s[2] + model.strains[at.natural + 2 * i])
        d = Vector(d[0], d[1], d[2] + model.strains[at.natural + 2 * i + 1])
    # psi = s + s x d and x = psi f(psi.psi) / 2
    psi = s + cross(s, d)
    z = dot(psi, psi)
    f, slope = polynomial(TANGENT, z), polynomial(SLOPE, z)
    x = f * 0.5 * psi
    share = 1.0 / (dot(x, x) + 1.0)
    if v is None:
        return Bend(x, psi, s, d, share, f, slope, None, None)
    # rates: psi', x', and rel = 2 (x' - x x x') / (1 + x.x)
    sv, dv = _sum(lane, model, at.sums, i, v, row), _sum(lane, model, at.slants, i, v, row)
    rate = sv + (cross(sv, d) + cross(s, dv))
    zv = dot(psi, rate) * 2.0
    xv = 0.5 * (f * rate + slope * zv * psi)
    rel = share * 2.0 * (xv - cross(x, xv))
    if a is None:
        return Bend(x, psi, s, d, share, f, slope, rel, None)
    # second rates: psi'', x'', and rel'
    sa, da = _sum(lane, model, at.sums, i, a, row), _sum(lane, model, at.slants, i, a, row)
    second = sa + 2.0 * cross(sv, dv) + (cross(sa, d) + cross(s, da))
    za = (dot(rate, rate) + dot(psi, second)) * 2.0
    xa = slope * zv * 2.0 * rate + (slope_of_slope(z) * zv * zv + slope * za) * psi
    xa = f * second + xa
    xa = 0.5 * xa
    more = share * 2.0 * (xa - cross(x, xa)) - dot(x, xv) * share * 2.0 * rel
    return Bend(x, psi, s, d, share, f, slope, rel, more)


@kernel
def turned_by(bend, p):
    """Return the quaternion p (1, x) / sqrt(1 + x.x): the rotation p, then the interval's rotation in body axes."""
    half = square_root(bend.share)
    return compose(p, (half, bend.x[0] * half, bend.x[1] * half, bend.x[2] * half))


@kernel
def tangent_at(p):
    """Return the tangent of the section with rotation p (quaternion): the unit vector e_x rotated by p."""
    w, x, y, z = p
    return Vector(1.0 - (y * y + z * z) * 2.0, (x * y + w * z) * 2.0, (x * z - w * y) * 2.0)


@kernel
def identity_rotation(lane):
    """Return the quaternion (1, 0, 0, 0) of the identity rotation in all lanes."""
    zero = 0.0
    return 1.0, zero, zero, zero


@kernel
def last_place(lane, model, k, q, v, root):
    """Return the `Place` of the last section of link k from the link's strains and its first section (root)."""
    n, at, row, zero = size(model.points), strained_at(model, k), strain_row(model, k), 0.0
    p, w = identity_rotation(lane), root.spin
    r, u = Vector(zero, zero, zero), Vector(zero, zero, zero)
    for i in range(n + 1):
        bend = bend_of(lane, model, at, i, row, q, v, None)
        # p, w behind the interval, then r += way t, v += way (w x t) (root axes)
        p = turned_by(bend, p)
        w = w + matrix(p) @ bend.rel
        if i < n:
            t, way = tangent_at(p), model.strains[at.ways + n * n + i]
            r, u = r + way * t, u + way * cross(w, t)
    A = matrix(root.p)
    return Place(root.r + A @ r, root.v + A @ u, compose(root.p, p), matrix(p).T @ w)


@kernel
def sweep_outward(lane, model, k, state, root, S):
    """Return the `Vertex` of the last section of link k; store in `NOTED` of S the values that `sweep_inward` reads.

    state: coordinates q, velocities v, accelerations a of the arm.
    root: `Vertex` of the link's first section. `NOTED` contains orientations, angular rates, accelerations, inertia
    forces and moments of all Gauss points, in the axes of the link's root. See docs/theory.md, (9.5).
    """
    n, at, to, row = size(model.points), strained_at(model, k), noted_at(model, k), strain_row(model, k)
    q, v, a = state
    zero, p, w, alpha = 0.0, identity_rotation(lane), root.place.spin, root.alpha
    frame = matrix(root.place.p)
    a0 = frame.T @ root.a
    store_matrix(lane, S, to.frame, frame)
    store_vector(lane, S, to.a, a0)
    store_vector(lane, S, to.spin, w)
    # A, w, alpha (link axes) behind each interval; t'' and J of its point
    for i in range(n + 1):
        bend = bend_of(lane, model, at, i, row, q, v, a)
        p = turned_by(bend, p)
        A = matrix(p)
        own = A @ bend.rel
        w = w + own
        alpha = alpha + A @ bend.second + cross(w, own)
        store_matrix(lane, S, to.turn + 9 * i, A)
        store_vector(lane, S, to.x_of + 3 * i, bend.x)
        store_vector(lane, S, to.psi + 3 * i, bend.psi)
        store_vector(lane, S, to.s + 3 * i, bend.s)
        store_vector(lane, S, to.d + 3 * i, bend.d)
        store_vector(lane, S, to.series + 3 * i, (bend.share, bend.f, bend.slope))
        store_vector(lane, S, to.w + 3 * i, w)
        store_vector(lane, S, to.alpha + 3 * i, alpha)
        if i < n:
            t = A.T[0]
            store_vector(lane, S, to.second + 3 * i, cross(alpha, t) + cross(w, cross(w, t)))
            I, own_w = three_of(lane, model.strains, at.inertia + 3 * i), A.T @ w
            turn = scale(A.T @ alpha, I) + cross(own_w, scale(own_w, I))
            store_vector(lane, S, to.moment + 3 * i, A @ turn)
    # r = sum ways t, a = a_0 + sum ways t'', f = m a of the points; v of the end (root axes)
    u, r, found = Vector(zero, zero, zero), Vector(zero, zero, zero), a0
    for i in range(n + 1):
        r, found = Vector(zero, zero, zero), a0
        for j in range(n):
            way = model.strains[at.ways + n * i + j]
            t = noted_tangent(lane, S, to, j)
            r, found = r + way * t, found + way * load_vector(lane, S, to.second + 3 * j)
            if i == n:
                u = u + way * cross(load_vector(lane, S, to.w + 3 * j), t)
        store_vector(lane, S, to.r + 3 * i, r)
        if i < n:
            store_vector(lane, S, to.force + 3 * i, model.strains[at.mass + i] * found)
    # back to inertial axes: r, v, a of the last section
    place, A = root.place, matrix(p)
    r, u = place.r + frame @ r, place.v + frame @ u
    last = Place(r, u, compose(place.p, p), A.T @ w)
    return Vertex(last, frame @ found, A.T @ alpha, Vector(zero, zero, zero))


@kernel
def noted_tangent(lane, S: Lanes, to, i):
    """Return the tangent at Gauss point i, root axes, from the rotation matrix that `sweep_outward` stored in S."""
    o = to.turn + 9 * i
    return Vector(S[o], S[o + 3], S[o + 6])


@kernel
def _own_force(lane, S, to, i, g):
    """Return the generalized forces (N m) on s and d of interval i. g: moment (N m, root axes) on all points beyond.

    s is the integral of the strain over the interval, d its first moment (rad).
    to: offsets of the link's stored kinematics in S (`noted_at`). The function applies the transposed derivative of the
    rotation by (s, d), from values that `sweep_outward` stored in S.
    """
    A, x, psi = (
        matrix_in(lane, S, to.turn + 9 * i),
        load_vector(lane, S, to.x_of + 3 * i),
        load_vector(lane, S, to.psi + 3 * i),
    )
    s, d = load_vector(lane, S, to.s + 3 * i), load_vector(lane, S, to.d + 3 * i)
    share, f, slope = load_vector(lane, S, to.series + 3 * i)
    own = A.T @ g
    # transpose of rel by x', of x by psi, then of psi = s + s x d
    y = share * (own + cross(x, own))  # 2 share, and X has a half
    y = f * y + slope * 2.0 * dot(psi, y) * psi
    return y + cross(d, y), cross(y, s)


@kernel
def elastic(lane, model, par: Lanes, k, state, r):
    """Add the elastic and damping forces of link k's strains, minus the inertia correction for time steps, to r.

    r <- r + factors K (q + tau v) - correction a (N m), in the rows of the link's strains. K and correction are the
    matrices `STRAINED.K_EI` and `correction` of the link's polynomials.
    factors: the arm's factors on GJ, EI_y, EI.
    tau: tau_d times the link's share (s). See docs/theory.md, (9.4).
    """
    n, at, row = size(model.polynomials), strained_at(model, k), strain_row(model, k)
    factors, zero = factors_of(lane, par), 0.0
    tau = zero if model.damped is None else par[TAU_D] * model.strains[at.damping]
    for i in range(n):
        total = Vector(zero, zero, zero)
        for j in range(n):
            x = load_vector(lane, state.q, row + 3 * j)
            if model.damped is not None:
                # K (c + tau_d c'): damping by the strain rates
                x = x + tau * load_vector(lane, state.v, row + 3 * j)
            total = total + scale(x, _three(lane, model, at.K_EI, i, j))
        total = scale(total, factors)
        for j in range(n):
            a = load_vector(lane, state.a, row + 3 * j)
            # - (M - M*) c'': the inertia that steps see (5.3)
            total = total - scale(a, _three(lane, model, at.correction, i, j))
        add_vector(lane, r, row + 3 * i, total)


@kernel
def _three(lane, model, table, i, j):
    """Return entry (i, j) of a table (3, polynomials, polynomials) of model.strains as a `Vector`.

    table: offset of the table. The vector's components are for torsion, bending about y, bending about z.
    """
    n = size(model.polynomials)
    o, next_of = table + n * i + j, n * n
    x, y, z = model.strains[o], model.strains[o + next_of], model.strains[o + 2 * next_of]
    return Vector(x, y, z)


@kernel
def stiff_of(lane, model, par, k, i, j):
    """Return stiffnesses K_ij (N m) of polynomials i, j for torsion, bending about y, z, times the arm's factors."""
    return scale(_three(lane, model, strained_at(model, k).K_EI, i, j), factors_of(lane, par))


@kernel
def correction_of(lane, model, k, i, j):
    """Return the inertia (kg m^2) about x, y, z that time steps subtract for polynomials i and j (theory, 5.3)."""
    return _three(lane, model, strained_at(model, k).correction, i, j)


@kernel
def sweep_inward(lane, model, k, r, S):
    """Return the force (N, inertial axes) and the moment (N m, root axes) on the root of link k.

    The function sums the forces that `sweep_outward` stored in S from tip to root, beginning with the wrench on the
    link's last section (`NOTED.on`). The generalized forces on the strains are added to their rows of r. See
    docs/theory.md, (9.5).
    """
    n, m, at, to = size(model.points), size(model.polynomials), strained_at(model, k), noted_at(model, k)
    frame, A = matrix_in(lane, S, to.frame), matrix_in(lane, S, to.turn + 9 * n)
    force, moment = frame.T @ load_vector(lane, S, to.on), A @ load_vector(lane, S, to.on + 3)
    # total: force on the root; couple: moment about the root's origin; g: moment on all that an interval rotates
    total, couple = force, moment + cross(load_vector(lane, S, to.r + 3 * n), force)
    g = moment
    store_vector(lane, S, to.bend + 3 * n, g)
    for i in range(n):
        j = n - 1 - i
        own = load_vector(lane, S, to.force + 3 * j)
        total = total + own
        couple = couple + (cross(load_vector(lane, S, to.r + 3 * j), own) + load_vector(lane, S, to.moment + 3 * j))
        # n = sum of ways times forces beyond: the force on the tangent of point j; t x n is its moment
        on = model.strains[at.ways + n * n + j] * force
        for p in range(n):
            on = on + model.strains[at.ways + n * p + j] * load_vector(lane, S, to.force + 3 * p)
        store_vector(lane, S, to.pull + 3 * j, on)
        t = noted_tangent(lane, S, to, j)
        g = g + (cross(t, on) + load_vector(lane, S, to.moment + 3 * j))
        store_vector(lane, S, to.bend + 3 * j, g)
    # generalized forces on c_j: int P_j times the moments on s and d of each interval (9.5)
    row = strain_row(model, k)
    for i in range(n + 1):
        on_s, on_d = _own_force(lane, S, to, i, load_vector(lane, S, to.bend + 3 * i))
        for j in range(m):
            share, slant = model.strains[at.sums + m * i + j], model.strains[at.slants + m * i + j]
            add_vector(lane, r, row + 3 * j, share * on_s + slant * on_d)
    return frame @ total, couple


@inlined
def strained_sums(lane, model, par, k, q, v, root):
    """Return ((kinetic, strain, gravitational) energy in J, momentum in kg m/s, inertial axes) of link k.

    root: `Place` of the link's first section. q, v: coordinates and rates of the arm. See docs/theory.md, (9.5).
    """
    n, at, row, A0 = size(model.points), strained_at(model, k), strain_row(model, k), matrix(root.p)
    zero = 0.0
    kinetic, gravity, push = zero, zero, Vector(zero, zero, zero)
    tangents, rates = stack(lane, model.scratch), stack(lane, model.scratch)
    p, w = identity_rotation(lane), root.spin
    # tangents t = A e_x and rates w x t (inertial axes); rotary energy w'J w / 2, w in section axes
    for i in range(n):
        bend = bend_of(lane, model, at, i, row, q, v, None)
        p = turned_by(bend, p)
        A = matrix(p)
        w = w + A @ bend.rel
        t, own = A.T[0], A.T @ w
        store_vector(lane, tangents, 3 * i, t)
        store_vector(lane, rates, 3 * i, cross(w, t))
        kinetic = kinetic + dot(own, scale(own, three_of(lane, model.strains, at.inertia + 3 * i))) * 0.5
    # 1/2 m |v|^2, m v and m r of the points (inertial axes)
    for i in range(n):
        r, u = Vector(zero, zero, zero), Vector(zero, zero, zero)
        for j in range(n):
            way = model.strains[at.ways + n * i + j]
            r = r + way * load_vector(lane, tangents, 3 * j)
            u = u + way * load_vector(lane, rates, 3 * j)
        rate, mass = root.v + A0 @ u, model.strains[at.mass + i]
        kinetic, push = kinetic + dot(rate, rate) * (0.5 * mass), push + mass * rate
        if model.gravity is not None:
            gravity = gravity - dot(three_of(lane, model.gravity, 0), root.r + A0 @ r) * mass
    return (kinetic, _stiff_sum(lane, model, par, k, q, q) * 0.5, gravity), push


@kernel
def point_of(lane, model, k, i, q, root):
    """Return the position (m, inertial axes) of Gauss point i of link k. root: `Place` of the link's root."""
    n, at, row = len(model.points), strained_at(model, k), strain_row(model, k)
    p, r = identity_rotation(lane), Vector(0.0, 0.0, 0.0)
    for j in range(n):
        p = turned_by(bend_of(lane, model, at, j, row, q, None, None), p)
        r = r + model.strains[at.ways + n * i + j] * tangent_at(p)
    return root.r + matrix(root.p) @ r


@kernel
def _stiff_sum(lane, model, par, k, x, y):
    """Return x^T K y for the strains of link k; K: stiffness matrix. The unit is J if x and y are coordinates."""
    m, row, total = size(model.polynomials), strain_row(model, k), 0.0
    for i in range(m):
        for j in range(m):
            bent = scale(load_vector(lane, y, row + 3 * j), stiff_of(lane, model, par, k, i, j))
            total = total + dot(load_vector(lane, x, row + 3 * i), bent)
    return total


@kernel
def strained_damping(lane, model, par: Lanes, k, v, x):
    """Return x^T C v (W), the power of link k's damping forces C v (N m) at the strain rates x.

    v: actual rates of all coordinates.
    x: virtual rates of all coordinates.
    C: stiffness of the strains times tau_d and times the link's share of tau_d.
    """
    tau = par[TAU_D] * model.strains[strained_at(model, k).damping]
    return _stiff_sum(lane, model, par, k, x, v) * tau


@kernel
def strained_update(lane, model, q: Lanes, share, d, more):
    """Apply the increment share * d + more to q: the base's rotation is composed in body axes, other rows are added.

    d, more: increments of all coordinates; more = None means zero. share: factor on d. See `protocol.retract`.
    """
    move_vertex(lane, q, 0, share, d, more)
    for k in range(AXES, model.n):
        q[k] = added(lane, q, share, d, more, k)


@kernel
def strained_difference(lane, model, start: Lanes, q: Lanes, d: Lanes):
    """Store in d the increment from coordinates start to coordinates q; the base's rotation is in body axes."""
    store_increment(lane, start, q, d, 0)
    for k in range(AXES, model.n):
        d[k] = q[k] - start[k]
