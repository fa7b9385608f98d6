"""A link in space whose coordinates are its strains: torsion and two curvatures, Legendre polynomials along it.

Between Gauss's points (and from the last to the link's end) a section turns by psi = s + s x d, s the integral of the
strain over the interval and d its first moment about the middle, over the interval: Magnus' series to fourth order, of
two numbers that are linear in the coordinates. That is
Cayley's rotation of x = tan(|psi|/2) psi/|psi|, whose rates are rational:

    rel = 2 (x' - x x x') / (1 + x.x),   rel' = 2 (x'' - x x x'') / (1 + x.x) - 2 (x.x') rel / (1 + x.x)

along the axes of the interval's end. A point is where the tangents before it, weighted, lead to. Places are a function
of the coordinates, and forces on these are its derivative's transpose times those on the points, to the last bit of it:
what a chain conserves it keeps whatever the number of points. All vectors are in the axes of the link's root.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from ...compiler import inlined, kernel, load, size, splat, square_root, stack, store
from ..arithmetic import put_vector, vector
from ..model import TAU_D
from ..protocol import added
from .chain import Vertex, factors_of, three_of
from .element import Place, scale
from .layout import AXES, joint_row
from .matrix import matrix_in
from .moving import move_vertex, put_difference
from .rotations import (
    add_vector,
    back,
    composed,
    cross,
    dot,
    matrix,
    minus,
    plus,
    polynomial,
    put_matrix,
    times,
    turned,
)
from .strained_layout import noted_at, strained_at

_TANGENT = (1.0, 1 / 12, 1 / 120, 17 / 20160, 31 / 362880, 691 / 79833600, 5461 / 6227020800, 929569 / 10461394944000)
TANGENT = _TANGENT[::-1]
"""f of tan(a/2) = a f(a^2) / 2, coefficients from the highest power on: to 1e-9 for a of 1, to 1e-6 for a of 1.5."""
_SLOPE = tuple(k * c for k, c in enumerate(_TANGENT))[1:]
SLOPE = _SLOPE[::-1]
CURVE = tuple(k * c for k, c in enumerate(_SLOPE))[:0:-1]


class Bend(NamedTuple):
    """An interval: what it turns by, and the angular velocity and acceleration that it adds, in the axes of its end."""

    x: Any
    psi: Any
    s: Any
    d: Any
    share: Any  # 1 / (1 + x.x)
    f: Any
    slope: Any  # f'
    rel: Any  # None without rates
    second: Any


@kernel
def strain_row(model, k):
    """The first row of the strains of link k."""
    return joint_row(model, k) + 1


@kernel
def _sum(lane, model, table, i, x, row):
    """Row i of a table times the polynomials' coefficients."""
    n = size(model.polynomials)
    total = times(vector(lane, x, row), model.strains[table + n * i])
    for j in range(1, n):
        total = plus(total, times(vector(lane, x, row + 3 * j), model.strains[table + n * i + j]))
    return total


@kernel
def slope_of_slope(z):
    """f'' of `TANGENT`."""
    return polynomial(CURVE, z)


@kernel
def bend_of(lane, model, at, i, row, q, v, a):
    """The `Bend` of interval i; v, a: None where they are not asked for."""
    s, d = _sum(lane, model, at.sums, i, q, row), _sum(lane, model, at.slants, i, q, row)
    if model.curved is not None:
        s = s[0], s[1], s[2] + model.strains[at.natural + 2 * i]
        d = d[0], d[1], d[2] + model.strains[at.natural + 2 * i + 1]
    psi = plus(s, cross(s, d))
    z = dot(psi, psi)
    f, slope = polynomial(TANGENT, z), polynomial(SLOPE, z)
    x = times(psi, f * 0.5)
    share = 1.0 / (dot(x, x) + 1.0)
    if v is None:
        return Bend(x, psi, s, d, share, f, slope, None, None)
    sv, dv = _sum(lane, model, at.sums, i, v, row), _sum(lane, model, at.slants, i, v, row)
    rate = plus(sv, plus(cross(sv, d), cross(s, dv)))
    zv = dot(psi, rate) * 2.0
    xv = times(plus(times(rate, f), times(psi, slope * zv)), 0.5)
    rel = times(minus(xv, cross(x, xv)), share * 2.0)
    if a is None:
        return Bend(x, psi, s, d, share, f, slope, rel, None)
    sa, da = _sum(lane, model, at.sums, i, a, row), _sum(lane, model, at.slants, i, a, row)
    second = plus(plus(sa, times(cross(sv, dv), 2.0)), plus(cross(sa, d), cross(s, da)))
    za = (dot(rate, rate) + dot(psi, second)) * 2.0
    xa = plus(times(rate, slope * zv * 2.0), times(psi, slope_of_slope(z) * zv * zv + slope * za))
    xa = plus(times(second, f), xa)
    xa = times(xa, 0.5)
    more = minus(times(minus(xa, cross(x, xa)), share * 2.0), times(rel, dot(x, xv) * share * 2.0))
    return Bend(x, psi, s, d, share, f, slope, rel, more)


@kernel
def turned_by(bend, p):
    """p and then the interval."""
    half = square_root(bend.share)
    return composed(p, (half, bend.x[0] * half, bend.x[1] * half, bend.x[2] * half))


@kernel
def tangent_at(p):
    """e_x, turned by p."""
    w, x, y, z = p
    return 1.0 - (y * y + z * z) * 2.0, (x * y + w * z) * 2.0, (x * z - w * y) * 2.0


@kernel
def still(lane):
    """No rotation."""
    zero = splat(lane, 0.0)
    return splat(lane, 1.0), zero, zero, zero


@kernel
def last_place(lane, model, k, q, v, root):
    """The `Place` of link k's last section, root: of its first."""
    n, at, row, zero = size(model.points), strained_at(model, k), strain_row(model, k), splat(lane, 0.0)
    p, w = still(lane), root.spin
    r, u = (zero, zero, zero), (zero, zero, zero)
    for i in range(n + 1):
        bend = bend_of(lane, model, at, i, row, q, v, None)
        p = turned_by(bend, p)
        w = plus(w, turned(matrix(p), bend.rel))
        if i < n:
            t, way = tangent_at(p), model.strains[at.ways + n * n + i]
            r, u = plus(r, times(t, way)), plus(u, times(cross(w, t), way))
    A = matrix(root.p)
    return Place(plus(root.r, turned(A, r)), plus(root.v, turned(A, u)), composed(root.p, p), back(matrix(p), w))


@kernel
def walk(lane, model, k, state, root, S):
    """The `Vertex` of link k's last section; notes in S all that `pull` needs."""
    n, at, to, row = size(model.points), strained_at(model, k), noted_at(model, k), strain_row(model, k)
    q, v, a = state
    zero, p, w, alpha = splat(lane, 0.0), still(lane), root.place.spin, root.alpha
    frame = matrix(root.place.p)
    a0 = back(frame, root.a)
    put_matrix(S, to.frame, frame)
    put_vector(S, to.a, a0)
    put_vector(S, to.spin, w)
    for i in range(n + 1):
        bend = bend_of(lane, model, at, i, row, q, v, a)
        p = turned_by(bend, p)
        A = matrix(p)
        own = turned(A, bend.rel)
        w = plus(w, own)
        alpha = plus(plus(alpha, turned(A, bend.second)), cross(w, own))
        put_matrix(S, to.turn + 9 * i, A)
        put_vector(S, to.x_of + 3 * i, bend.x)
        put_vector(S, to.psi + 3 * i, bend.psi)
        put_vector(S, to.s + 3 * i, bend.s)
        put_vector(S, to.d + 3 * i, bend.d)
        put_vector(S, to.series + 3 * i, (bend.share, bend.f, bend.slope))
        put_vector(S, to.w + 3 * i, w)
        put_vector(S, to.alpha + 3 * i, alpha)
        if i < n:
            t = A[0][0], A[1][0], A[2][0]
            put_vector(S, to.second + 3 * i, plus(cross(alpha, t), cross(w, cross(w, t))))
            I, own_w = three_of(lane, model.strains, at.inertia + 3 * i), back(A, w)
            turn = plus(scale(back(A, alpha), I), cross(own_w, scale(own_w, I)))
            put_vector(S, to.moment + 3 * i, turned(A, turn))
    u, r, found = (zero, zero, zero), (zero, zero, zero), a0
    for i in range(n + 1):
        r, found = (zero, zero, zero), a0
        for j in range(n):
            way = model.strains[at.ways + n * i + j]
            t = noted_tangent(lane, S, to, j)
            r, found = plus(r, times(t, way)), plus(found, times(vector(lane, S, to.second + 3 * j), way))
            if i == n:
                u = plus(u, times(cross(vector(lane, S, to.w + 3 * j), t), way))
        put_vector(S, to.r + 3 * i, r)
        if i < n:
            put_vector(S, to.force + 3 * i, times(found, model.strains[at.mass + i]))
    place, A = root.place, matrix(p)
    r, u = plus(place.r, turned(frame, r)), plus(place.v, turned(frame, u))
    last = Place(r, u, composed(place.p, p), back(A, w))
    return Vertex(last, turned(frame, found), back(A, alpha), (zero, zero, zero))


@kernel
def noted_tangent(lane, S, to, i):
    """e_x of point i, as `walk` noted it."""
    o = to.turn + 9 * i
    return load(lane, S, o), load(lane, S, o + 3), load(lane, S, o + 6)


@kernel
def _own_force(lane, S, to, i, g):
    """(on s, on d) of an interval by a moment g in the root's axes on all that it turns."""
    A, x, psi = matrix_in(lane, S, to.turn + 9 * i), vector(lane, S, to.x_of + 3 * i), vector(lane, S, to.psi + 3 * i)
    s, d = vector(lane, S, to.s + 3 * i), vector(lane, S, to.d + 3 * i)
    share, f, slope = vector(lane, S, to.series + 3 * i)
    own = back(A, g)
    y = times(plus(own, cross(x, own)), share)  # 2 share, and X has a half
    y = plus(times(y, f), times(psi, slope * 2.0 * dot(psi, y)))
    return plus(y, cross(d, y)), cross(y, s)


@kernel
def elastic(lane, model, par, k, state, r):
    """What resists the strains of link k, to their rows."""
    n, at, row = size(model.polynomials), strained_at(model, k), strain_row(model, k)
    factors, zero = factors_of(lane, par), splat(lane, 0.0)
    tau = zero if model.damped is None else load(lane, par, TAU_D) * model.strains[at.damping]
    for i in range(n):
        total = zero, zero, zero
        for j in range(n):
            x = vector(lane, state.q, row + 3 * j)
            if model.damped is not None:
                x = plus(x, times(vector(lane, state.v, row + 3 * j), tau))
            total = plus(total, scale(x, _three(lane, model, at.stiffness, i, j)))
        total = scale(total, factors)
        for j in range(n):
            a = vector(lane, state.a, row + 3 * j)
            total = minus(total, scale(a, _three(lane, model, at.correction, i, j)))
        add_vector(lane, r, row + 3 * i, total)


@kernel
def _three(lane, model, table, i, j):
    """Of polynomials i and j: torsion, bending about y and z."""
    n = size(model.polynomials)
    o, next_of = table + n * i + j, n * n
    x, y, z = model.strains[o], model.strains[o + next_of], model.strains[o + 2 * next_of]
    return splat(lane, x), splat(lane, y), splat(lane, z)


@kernel
def stiff_of(lane, model, par, k, i, j):
    """K of polynomials i and j, with the arm's own factors."""
    return scale(_three(lane, model, strained_at(model, k).stiffness, i, j), factors_of(lane, par))


@kernel
def correction_of(lane, model, k, i, j):
    """What steps take from their inertia."""
    return _three(lane, model, strained_at(model, k).correction, i, j)


@kernel
def pull(lane, model, k, r, S):
    """(force, moment) on the root of link k, inertial and own axes, from what `walk` noted and what is `on` the last
    section; on the strains, to their rows in r."""
    n, m, at, to = size(model.points), size(model.polynomials), strained_at(model, k), noted_at(model, k)
    frame, A = matrix_in(lane, S, to.frame), matrix_in(lane, S, to.turn + 9 * n)
    force, moment = back(frame, vector(lane, S, to.on)), turned(A, vector(lane, S, to.on + 3))
    total, couple = force, plus(moment, cross(vector(lane, S, to.r + 3 * n), force))
    g = moment
    put_vector(S, to.bend + 3 * n, g)
    for i in range(n):
        j = n - 1 - i
        own = vector(lane, S, to.force + 3 * j)
        total = plus(total, own)
        couple = plus(couple, plus(cross(vector(lane, S, to.r + 3 * j), own), vector(lane, S, to.moment + 3 * j)))
        on = times(force, model.strains[at.ways + n * n + j])
        for p in range(n):
            on = plus(on, times(vector(lane, S, to.force + 3 * p), model.strains[at.ways + n * p + j]))
        put_vector(S, to.pull + 3 * j, on)
        t = noted_tangent(lane, S, to, j)
        g = plus(g, plus(cross(t, on), vector(lane, S, to.moment + 3 * j)))
        put_vector(S, to.bend + 3 * j, g)
    row = strain_row(model, k)
    for i in range(n + 1):
        on_s, on_d = _own_force(lane, S, to, i, vector(lane, S, to.bend + 3 * i))
        for j in range(m):
            share, slant = model.strains[at.sums + m * i + j], model.strains[at.slants + m * i + j]
            add_vector(lane, r, row + 3 * j, plus(times(on_s, share), times(on_d, slant)))
    return turned(frame, total), couple


@inlined
def strained_sums(lane, model, par, k, q, v, root):
    """`chain.sums_of` link k; root: the `Place` of its first section."""
    n, at, row, A0 = size(model.points), strained_at(model, k), strain_row(model, k), matrix(root.p)
    zero = splat(lane, 0.0)
    kinetic, gravity, push = zero, zero, (zero, zero, zero)
    tangents, rates = stack(lane, model.scratch), stack(lane, model.scratch)
    p, w = still(lane), root.spin
    for i in range(n):
        bend = bend_of(lane, model, at, i, row, q, v, None)
        p = turned_by(bend, p)
        A = matrix(p)
        w = plus(w, turned(A, bend.rel))
        t, own = (A[0][0], A[1][0], A[2][0]), back(A, w)
        put_vector(tangents, 3 * i, t)
        put_vector(rates, 3 * i, cross(w, t))
        kinetic = kinetic + dot(own, scale(own, three_of(lane, model.strains, at.inertia + 3 * i))) * 0.5
    for i in range(n):
        r, u = (zero, zero, zero), (zero, zero, zero)
        for j in range(n):
            way = model.strains[at.ways + n * i + j]
            r = plus(r, times(vector(lane, tangents, 3 * j), way))
            u = plus(u, times(vector(lane, rates, 3 * j), way))
        rate, mass = plus(root.v, turned(A0, u)), model.strains[at.mass + i]
        kinetic, push = kinetic + dot(rate, rate) * (0.5 * mass), plus(push, times(rate, mass))
        if model.gravity is not None:
            gravity = gravity - dot(three_of(lane, model.gravity, 0), plus(root.r, turned(A0, r))) * mass
    return (kinetic, _stiff_sum(lane, model, par, k, q, q) * 0.5, gravity), push


@kernel
def point_of(model, k, i, q, root):
    """Where point i of link k is."""
    lane, n, at, row = (0,), len(model.points), strained_at(model, k), strain_row(model, k)
    p, r = still(lane), (0.0, 0.0, 0.0)
    for j in range(n):
        p = turned_by(bend_of(lane, model, at, j, row, q, None, None), p)
        r = plus(r, times(tangent_at(p), model.strains[at.ways + n * i + j]))
    return plus(root.r, turned(matrix(root.p), r))


@kernel
def _stiff_sum(lane, model, par, k, x, y):
    """x' K y of link k."""
    m, row, total = size(model.polynomials), strain_row(model, k), splat(lane, 0.0)
    for i in range(m):
        for j in range(m):
            bent = scale(vector(lane, y, row + 3 * j), stiff_of(lane, model, par, k, i, j))
            total = total + dot(vector(lane, x, row + 3 * i), bent)
    return total


@kernel
def strained_damping(lane, model, par, k, v, x):
    """Power of link k's damping at rates v over rates x, W."""
    tau = load(lane, par, TAU_D) * model.strains[strained_at(model, k).damping]
    return _stiff_sum(lane, model, par, k, x, v) * tau


@kernel
def strained_update(lane, model, q, share, d, more):
    """See `protocol`: the base's rotation is moved by an increment in its own axes."""
    move_vertex(lane, q, 0, share, d, more)
    for k in range(AXES, model.n):
        store(q, k, added(lane, q, share, d, more, k))


@kernel
def strained_difference(lane, model, start, q, d):
    """See `protocol`."""
    put_difference(lane, start, q, d, 0)
    for k in range(AXES, model.n):
        store(d, k, load(lane, q, k) - load(lane, start, k))
