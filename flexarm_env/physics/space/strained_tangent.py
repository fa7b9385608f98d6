"""The tangent of a link whose coordinates are its strains, column by column; all vectors in the root's axes.

By the strains, sections turn by theta and points move by R, both to the last bit. A point's acceleration changes by

    cm R + 2 cd w x R + ck (alpha x R + w x (w x R)),

w and alpha those of the section there: what an observer sees who turns with it. Left out is what neighbours turn
against each other, in first order of the step; Newton's way is longer by little.
"""

from __future__ import annotations

from ...compiler import kernel, load, size, splat
from ..arithmetic import add, put_vector, vector
from ..model import TAU_D
from .chain import clear, three_of
from .element import add_block, scale
from .layout import F
from .matrix import matrix_in
from .rotations import back, cross, dot, minus, plus, product, put_matrix, scaled, skew, times, transposed, turned
from .strained import correction_of, noted_tangent, slope_of_slope, stiff_of
from .strained_layout import noted_at, strained_at


@kernel
def _turns(lane, S, to, i):
    """What interval i's end turns by, by each entry of s and of d, to `by_sum` and `by_slant`."""
    A, x, psi = matrix_in(lane, S, to.turn + 9 * i), vector(lane, S, to.x_of + 3 * i), vector(lane, S, to.psi + 3 * i)
    s, d = vector(lane, S, to.s + 3 * i), vector(lane, S, to.d + 3 * i)
    share, f, slope = vector(lane, S, to.series + 3 * i)
    one, zero = share * 0.0 + 1.0, share * 0.0
    o = 9 * i
    for axis in ((one, zero, zero), (zero, one, zero), (zero, zero, one)):
        for by, to_row in ((plus(axis, cross(axis, d)), to.by_sum + o), (cross(s, axis), to.by_slant + o)):
            y = plus(times(by, f), times(psi, slope * 2.0 * dot(psi, by)))
            put_vector(S, to_row, turned(A, times(minus(y, cross(x, y)), share)))
        o += 3


@kernel
def _inertia(lane, model, at, to, S, i, b):
    """I b of the sections at point i."""
    A = matrix_in(lane, S, to.turn + 9 * i)
    return turned(A, scale(back(A, b), three_of(lane, model.strains, at.inertia + 3 * i)))


@kernel
def _rotary(lane, model, at, to, S, i, theta, weights):
    """Change of the moment of rotary inertia at point i where sections turn by theta, but for what turns it."""
    w, I = vector(lane, S, to.w + 3 * i), _inertia(lane, model, at, to, S, i, theta)
    gyration = plus(cross(theta, _inertia(lane, model, at, to, S, i, w)), cross(w, I))
    return plus(times(I, weights.mass), times(gyration, weights.damping))


@kernel
def _turned_on(lane, S, to, i, c, by_s, by_d):
    """By how much (on s, on d) of interval i change with s and d themselves, of which entry c changes by (by_s, by_d):
    the slope of `strained._own_force` where the moment turns with the interval's end."""
    A, x, psi = matrix_in(lane, S, to.turn + 9 * i), vector(lane, S, to.x_of + 3 * i), vector(lane, S, to.psi + 3 * i)
    s, d = vector(lane, S, to.s + 3 * i), vector(lane, S, to.d + 3 * i)
    share, f, slope = vector(lane, S, to.series + 3 * i)
    ds, dd = _entry(share, c, by_s), _entry(share, c, by_d)
    dpsi = plus(ds, plus(cross(ds, d), cross(s, dd)))
    own, along = back(A, vector(lane, S, to.bend + 3 * i)), dot(psi, dpsi) * 2.0
    y0 = times(plus(own, cross(x, own)), share)
    z, on = dot(psi, psi), dot(psi, y0) * 2.0
    y = plus(times(y0, f), times(psi, slope * on))
    dx = times(plus(times(dpsi, f), times(psi, slope * along)), 0.5)
    dy0 = minus(times(cross(dx, own), share), times(y0, dot(x, dx) * share * 2.0))
    steeper = slope_of_slope(z) * along
    dy = plus(times(dy0, f), times(psi, slope * 2.0 * dot(psi, dy0)))
    dy = plus(dy, plus(times(y0, slope * along), times(psi, steeper * on)))
    dy = plus(dy, plus(times(psi, slope * 2.0 * dot(dpsi, y0)), times(dpsi, slope * on)))
    return plus(dy, plus(cross(d, dy), cross(dd, y))), plus(cross(dy, s), cross(y, ds))


@kernel
def _entry(like, c, x):
    """x along axis c."""
    zero = like * 0.0
    if c == 0:
        return zero + x, zero, zero
    if c == 1:
        return zero, zero + x, zero
    return zero, zero, zero + x


@kernel
def _on_strains(lane, model, S, at, to, force, moment, ck, theta_too, column, stride):
    """(force, moment) on the root of the changes of the points' forces, of the `force` on the last section and of its
    `moment`; on the strains, to S from `column` on. theta_too: what sections turn by in `theta`, or not at all."""
    n, m = size(model.points), size(model.polynomials)
    total, couple, g = force, plus(moment, cross(vector(lane, S, to.r + 3 * n), force)), moment
    if theta_too is not None:
        held = back(matrix_in(lane, S, to.frame), vector(lane, S, to.on))
        couple = plus(couple, times(cross(vector(lane, S, to.moved + 3 * n), held), ck))
    for back_i in range(n + 1):
        i = n - back_i
        if i < n:
            own, turn = vector(lane, S, to.change + 3 * i), vector(lane, S, to.second + 3 * i)
            t = noted_tangent(lane, S, to, i)
            total = plus(total, own)
            couple = plus(couple, plus(cross(vector(lane, S, to.r + 3 * i), own), turn))
            on = times(force, model.strains[at.ways + n * n + i])
            for p in range(n):
                on = plus(on, times(vector(lane, S, to.change + 3 * p), model.strains[at.ways + n * p + i]))
            g = plus(g, plus(cross(t, on), turn))
            if theta_too is not None:
                theta, moved = vector(lane, S, to.theta + 3 * i), vector(lane, S, to.moved + 3 * i)
                couple = plus(couple, times(cross(moved, vector(lane, S, to.force + 3 * i)), ck))
                g = plus(g, times(cross(cross(theta, t), vector(lane, S, to.pull + 3 * i)), ck))
        on = g
        if theta_too is not None:
            held = vector(lane, S, to.bend + 3 * i)
            on = plus(g, times(cross(held, vector(lane, S, to.theta + 3 * i)), ck))
        on_s = turned(matrix_in(lane, S, to.by_sum + 9 * i), on)
        on_d = turned(matrix_in(lane, S, to.by_slant + 9 * i), on)
        if theta_too is not None:
            j, c = theta_too
            by_s, by_d = model.strains[at.sums + m * i + j], model.strains[at.slants + m * i + j]
            more_s, more_d = _turned_on(lane, S, to, i, c, by_s, by_d)
            on_s, on_d = plus(on_s, times(more_s, ck)), plus(on_d, times(more_d, ck))
        for j in range(m):
            found = times(on_s, model.strains[at.sums + m * i + j])
            found = plus(found, times(on_d, model.strains[at.slants + m * i + j]))
            for c in range(3):
                add(lane, S, column + stride * (3 * j + c), found[c])
    return total, couple


@kernel
def _by_strain(lane, model, weights, S, at, to, j, c):
    """The column of the coefficient of polynomial j about axis c."""
    n, m, zero = size(model.points), size(model.polynomials), splat(lane, 0.0)
    cm, cd, ck = weights.mass, weights.damping, weights.stiffness
    frame, theta, pushed = matrix_in(lane, S, to.frame), (zero, zero, zero), (zero, zero, zero)
    for i in range(n + 1):
        by_s = times(vector(lane, S, to.by_sum + 9 * i + 3 * c), model.strains[at.sums + m * i + j])
        by_d = times(vector(lane, S, to.by_slant + 9 * i + 3 * c), model.strains[at.slants + m * i + j])
        theta = plus(theta, plus(by_s, by_d))
        put_vector(S, to.theta + 3 * i, theta)
    for i in range(n + 1):
        R = zero, zero, zero
        for p in range(n):
            slid = cross(vector(lane, S, to.theta + 3 * p), noted_tangent(lane, S, to, p))
            R = plus(R, times(slid, model.strains[at.ways + n * i + p]))
        put_vector(S, to.moved + 3 * i, R)
        if i < n:
            w, mass = vector(lane, S, to.w + 3 * i), model.strains[at.mass + i]
            swing = cross(w, R)
            found = plus(times(R, cm), times(swing, 2.0 * cd))
            found = plus(found, times(plus(cross(vector(lane, S, to.alpha + 3 * i), R), cross(w, swing)), ck))
            put_vector(S, to.change + 3 * i, times(found, mass))
            pushed = plus(pushed, times(R, cm * mass))
            turn = _rotary(lane, model, at, to, S, i, vector(lane, S, to.theta + 3 * i), weights)
            turn = plus(turn, times(cross(vector(lane, S, to.theta + 3 * i), vector(lane, S, to.moment + 3 * i)), ck))
            put_vector(S, to.second + 3 * i, turn)
    row, end = 3 * j + c, vector(lane, S, to.theta + 3 * n)
    put_vector(S, to.last + 6 * row, turned(frame, vector(lane, S, to.moved + 3 * n)))
    put_vector(S, to.last + 6 * row + 3, back(matrix_in(lane, S, to.turn + 9 * n), end))
    put_vector(S, to.by_root + 6 * row, turned(frame, pushed))
    moment = times(cross(end, vector(lane, S, to.bend + 3 * n)), ck)
    force, couple = _on_strains(
        lane, model, S, at, to, (zero, zero, zero), moment, ck, (j, c), to.matrix + row, 3 * m
    )
    put_vector(S, to.on_root + 6 * row, turned(frame, force))
    put_vector(S, to.on_root + 6 * row + 3, couple)


@kernel
def _by_turn(lane, model, weights, S, f, at, to, axis, c):
    """The column of a rotation of the root about its axis c."""
    n, zero = size(model.points), splat(lane, 0.0)
    cm, cd, ck = weights.mass, weights.damping, weights.stiffness
    frame, spin = matrix_in(lane, S, to.frame), vector(lane, S, to.spin)
    fall, forces = times(cross(axis, vector(lane, S, to.a)), -ck), (zero, zero, zero)
    for i in range(n):
        r, mass = vector(lane, S, to.r + 3 * i), model.strains[at.mass + i]
        R, slip = cross(axis, r), vector(lane, S, to.slip + 3 * i)
        found = plus(plus(times(R, cm), fall), times(plus(cross(axis, slip), cross(spin, R)), cd))
        put_vector(S, to.change + 3 * i, times(found, mass))
        put_vector(S, to.second + 3 * i, _rotary(lane, model, at, to, S, i, axis, weights))
        forces = plus(forces, vector(lane, S, to.force + 3 * i))
    held = times(cross(axis, back(frame, vector(lane, S, to.on))), -ck)
    force, couple = _on_strains(
        lane, model, S, at, to, held, (zero, zero, zero), ck, None, to.by_root + 3 + c, 6
    )
    force = turned(frame, plus(minus(force, held), times(cross(axis, forces), ck)))
    for i in range(3):
        add(lane, S, f + F.LL + 6 * i + 3 + c, force[i])
        add(lane, S, f + F.LL + 18 + 6 * i + 3 + c, couple[i])


@kernel
def strained_tangent(lane, model, par, k, weights, S, f):
    """Link k's part of the matrix: on its root to the `FACTOR` at f, the rest behind it."""
    n, m, at, to = size(model.points), size(model.polynomials), strained_at(model, k), noted_at(model, k)
    zero, cm = splat(lane, 0.0), weights.mass
    one = zero + 1.0
    frame, spin = matrix_in(lane, S, to.frame), vector(lane, S, to.spin)
    clear(lane, S, to.matrix, to.end - to.matrix)
    end = vector(lane, S, to.r + 3 * n)
    put_matrix(S, to.last_turn, matrix_in(lane, S, to.turn + 9 * n))
    put_matrix(S, to.shift, scaled(product(frame, skew(end)), -1.0))
    lever, mass = (zero, zero, zero), zero
    for i in range(n + 1):
        _turns(lane, S, to, i)
        if i < n:
            r, u = vector(lane, S, to.r + 3 * i), (zero, zero, zero)
            for p in range(n):
                rate = cross(vector(lane, S, to.w + 3 * p), noted_tangent(lane, S, to, p))
                u = plus(u, times(rate, model.strains[at.ways + n * i + p]))
            put_vector(S, to.slip + 3 * i, minus(times(u, 2.0), cross(spin, r)))
            mass = mass + model.strains[at.mass + i]
            lever = plus(lever, times(r, model.strains[at.mass + i]))
    for j in range(m):
        for c in range(3):
            _by_strain(lane, model, weights, S, at, to, j, c)
    _by_turn(lane, model, weights, S, f, at, to, (one, zero, zero), 0)
    _by_turn(lane, model, weights, S, f, at, to, (zero, one, zero), 1)
    _by_turn(lane, model, weights, S, f, at, to, (zero, zero, one), 2)
    for i in range(3):
        add(lane, S, f + F.LL + 7 * i, mass * cm)
    add_block(lane, S, f + F.LL, 1, 0, product(skew(times(lever, cm)), transposed(frame)))
    share = weights.stiffness + zero
    if model.damped is not None:
        share = share + load(lane, par, TAU_D) * (model.strains[at.damping] * weights.damping)
    for i in range(m):
        for j in range(m):
            K, lighter = stiff_of(lane, model, par, k, i, j), correction_of(lane, model, k, i, j)
            for c in range(3):
                add(lane, S, to.matrix + 3 * m * (3 * i + c) + 3 * j + c, K[c] * share - lighter[c] * cm)
