"""The Newton matrix of a link whose coordinates are its strains, column by column (theory, 9), in root axes.

A change of a strain rotates sections by theta and moves points by R; both vectors are exact to round-off. A point's
acceleration changes by

    cm R + 2 cd w x R + ck (alpha x R + w x (w x R)),

The axes rotate with the section at the point. w, alpha: angular velocity and acceleration of that section; cm, cd,
ck: `Weights` of mass, damping, stiffness. Rotations of sections relative to each other within a step are neglected.
The relative rotations are of first order in the step, and the omission hardly slows Newton's iteration.
"""

from __future__ import annotations

from ...compiler import Lanes, kernel, size
from ..arithmetic import store_vector
from ..model import TAU_D
from .chain import fill_zeros
from .element import add_block
from .layout import F
from .matrix import matrix_in
from .rotations import Vector, cross, dot, load_vector, scale, skew, store_matrix, three_of
from .strained import correction_of, noted_tangent, slope_of_slope, stiff_of
from .strained_layout import noted_at, strained_at


@kernel
def _turns(lane, S, to, i):
    """Store the derivatives of the rotation of interval i's end by s and d in fields `by_sum`, `by_slant` (root axes).

    s is the integral of the strain over the interval, d its first moment. The interval's rotation vector is psi = s + s
    x d. See docs/theory.md, (9.5).
    """
    A, x, psi = (
        matrix_in(lane, S, to.turn + 9 * i),
        load_vector(lane, S, to.x_of + 3 * i),
        load_vector(lane, S, to.psi + 3 * i),
    )
    s, d = load_vector(lane, S, to.s + 3 * i), load_vector(lane, S, to.d + 3 * i)
    share, f, slope = load_vector(lane, S, to.series + 3 * i)
    one, zero = share * 0.0 + 1.0, share * 0.0
    o = 9 * i
    for axis in (Vector(one, zero, zero), Vector(zero, one, zero), Vector(zero, zero, one)):
        for by, to_row in ((axis + cross(axis, d), to.by_sum + o), (cross(s, axis), to.by_slant + o)):
            # dpsi = by; dx = psi-derivative of x = psi f / 2; rotation = A 2 (dx - x x dx) / (1 + x.x)
            y = f * by + slope * 2.0 * dot(psi, by) * psi
            store_vector(lane, S, to_row, A @ (share * (y - cross(x, y))))
        o += 3


@kernel
def _inertia(lane, model, at, to, S, i, b):
    """Return I b: the rotary inertia I (kg m^2) of the section at point i times a vector b, in root axes.

    at, to: offsets of the link's constants and stored kinematics (`strained_at`, `noted_at`).
    """
    A = matrix_in(lane, S, to.turn + 9 * i)
    return A @ scale(A.T @ b, three_of(lane, model.strains, at.inertia + 3 * i))


@kernel
def _rotary(lane, model, at, to, S, i, theta, weights):
    """Return the change of the rotary inertia moment at point i by a rotation theta of its section, in root axes.

    The change is cm I theta + cd (theta x I w + w x I theta).
    cm, cd: `Weights` of mass and damping.
    w: angular velocity of the section. The caller adds the rotation of the moment itself (ck).
    at, to: offsets of the link's constants (`strained_at`) and stored kinematics (`noted_at`).
    """
    w, I = load_vector(lane, S, to.w + 3 * i), _inertia(lane, model, at, to, S, i, theta)
    gyration = cross(theta, _inertia(lane, model, at, to, S, i, w)) + cross(w, I)
    return weights.mass * I + weights.damping * gyration


@kernel
def _turned_on(lane, S, to, i, c, by_s, by_d):
    """Return the derivatives (N m) of the generalized forces on s and d of interval i by component c of s and of d.

    The results are derivatives of `strained._own_force`.
    by_s, by_d: changes of the vectors, while the moment `NOTED.bend` rotates with the interval's end.
    s: integral of the strain over the interval, d: its first moment (rad). See (9.5).
    """
    A, x, psi = (
        matrix_in(lane, S, to.turn + 9 * i),
        load_vector(lane, S, to.x_of + 3 * i),
        load_vector(lane, S, to.psi + 3 * i),
    )
    s, d = load_vector(lane, S, to.s + 3 * i), load_vector(lane, S, to.d + 3 * i)
    share, f, slope = load_vector(lane, S, to.series + 3 * i)
    # changes of s, d, psi; the moment in the axes of the interval's end
    ds, dd = _entry(share, c, by_s), _entry(share, c, by_d)
    dpsi = ds + (cross(ds, d) + cross(s, dd))
    own, along = A.T @ load_vector(lane, S, to.bend + 3 * i), dot(psi, dpsi) * 2.0
    # steps of `_own_force`: y0 by x, then y by f and psi
    y0 = share * (own + cross(x, own))
    z, on = dot(psi, psi), dot(psi, y0) * 2.0
    y = f * y0 + slope * on * psi
    # derivatives of x = psi f / 2, y_0 and y; steeper: d(slope)
    dx = 0.5 * (f * dpsi + slope * along * psi)
    dy0 = share * cross(dx, own) - dot(x, dx) * share * 2.0 * y0
    steeper = slope_of_slope(z) * along
    dy = f * dy0 + slope * 2.0 * dot(psi, dy0) * psi
    dy = dy + (slope * along * y0 + steeper * on * psi)
    dy = dy + (slope * 2.0 * dot(dpsi, y0) * psi + slope * on * dpsi)
    return dy + (cross(d, dy) + cross(dd, y)), cross(dy, s) + cross(y, ds)


@kernel
def _entry(like, c, x):
    """Return the vector with x as component c and zeros otherwise, in the lanes of `like`."""
    zero = like * 0.0
    if c == 0:
        return Vector(zero + x, zero, zero)
    if c == 1:
        return Vector(zero, zero + x, zero)
    return Vector(zero, zero, zero + x)


@kernel
def _on_strains(lane, model, S: Lanes, at, to, force, moment, ck, theta_too, column, stride):
    """Return the change of (force, moment) on the root in one column of the matrix; add the column's strain rows to S.

    S contains the changes of the points' forces (`change`) and moments (`second`).
    force, moment: changes on the last section.
    ck: weight of dr/dq. theta_too: (polynomial, axis) for a strain's column. Rotations `theta` and displacements
    `moved` then also rotate the present forces, with weight ck. theta_too is None for the column of a root rotation.
    Strain row i of the column is S[column + stride i]. Vectors are in root axes.
    at, to: offsets of the link's constants (`strained_at`) and stored kinematics (`noted_at`). See docs/theory.md,
    (9.5).
    """
    n, m = size(model.points), size(model.polynomials)
    total, couple, g = force, moment + cross(load_vector(lane, S, to.r + 3 * n), force), moment
    if theta_too is not None:
        # c_k R x f: present forces act at displaced points
        held = matrix_in(lane, S, to.frame).T @ load_vector(lane, S, to.on)
        couple = couple + ck * cross(load_vector(lane, S, to.moved + 3 * n), held)
    for back_i in range(n + 1):
        i = n - back_i
        if i < n:
            own, turn = load_vector(lane, S, to.change + 3 * i), load_vector(lane, S, to.second + 3 * i)
            t = noted_tangent(lane, S, to, i)
            # df on the root and dm about its origin (root axes)
            total = total + own
            couple = couple + (cross(load_vector(lane, S, to.r + 3 * i), own) + turn)
            # dn_i = sum ways df beyond: on the tangent of point i, as in `strained.sweep_inward`
            on = model.strains[at.ways + n * n + i] * force
            for p in range(n):
                on = on + model.strains[at.ways + n * p + i] * load_vector(lane, S, to.change + 3 * p)
            g = g + (cross(t, on) + turn)
            if theta_too is not None:
                # c_k theta x t . n: the tangent rotates against the present force
                theta, moved = load_vector(lane, S, to.theta + 3 * i), load_vector(lane, S, to.moved + 3 * i)
                couple = couple + ck * cross(moved, load_vector(lane, S, to.force + 3 * i))
                g = g + ck * cross(cross(theta, t), load_vector(lane, S, to.pull + 3 * i))
        on = g
        if theta_too is not None:
            held = load_vector(lane, S, to.bend + 3 * i)
            on = g + ck * cross(held, load_vector(lane, S, to.theta + 3 * i))
        # on s and d by their rotations' transpose, then sum over intervals onto c_j
        on_s = matrix_in(lane, S, to.by_sum + 9 * i) @ on
        on_d = matrix_in(lane, S, to.by_slant + 9 * i) @ on
        if theta_too is not None:
            j, c = theta_too
            by_s, by_d = model.strains[at.sums + m * i + j], model.strains[at.slants + m * i + j]
            more_s, more_d = _turned_on(lane, S, to, i, c, by_s, by_d)
            on_s, on_d = on_s + ck * more_s, on_d + ck * more_d
        for j in range(m):
            found = model.strains[at.sums + m * i + j] * on_s
            found = found + model.strains[at.slants + m * i + j] * on_d
            for c in range(3):
                S[column + stride * (3 * j + c)] += found[c]
    return total, couple


@kernel
def _by_strain(lane, model, weights, S, at, to, j, c):
    """Compute the column of the matrix for the coefficient of polynomial j about axis c, in the link's `NOTED` record.

    The function adds column 3 j + c to the strain rows of `matrix` and writes row 3 j + c of `on_root`, `last` and the
    root position's part of `by_root`.
    at, to: offsets of the link's constants (`strained_at`) and stored kinematics (`noted_at`). See docs/theory.md,
    (9.5).
    """
    n, m, zero = size(model.points), size(model.polynomials), 0.0
    cm, cd, ck = weights.mass, weights.damping, weights.stiffness
    frame, theta, pushed = matrix_in(lane, S, to.frame), Vector(zero, zero, zero), Vector(zero, zero, zero)
    # theta: sum of the rotations of all intervals before
    for i in range(n + 1):
        by_s = model.strains[at.sums + m * i + j] * load_vector(lane, S, to.by_sum + 9 * i + 3 * c)
        by_d = model.strains[at.slants + m * i + j] * load_vector(lane, S, to.by_slant + 9 * i + 3 * c)
        theta = theta + (by_s + by_d)
        store_vector(lane, S, to.theta + 3 * i, theta)
    # R: sum of theta x t over the tangents before; changes of inertia forces and moments
    for i in range(n + 1):
        R = Vector(zero, zero, zero)
        for p in range(n):
            slid = cross(load_vector(lane, S, to.theta + 3 * p), noted_tangent(lane, S, to, p))
            R = R + model.strains[at.ways + n * i + p] * slid
        store_vector(lane, S, to.moved + 3 * i, R)
        if i < n:
            w, mass = load_vector(lane, S, to.w + 3 * i), model.strains[at.mass + i]
            swing = cross(w, R)
            found = cm * R + 2.0 * cd * swing
            found = found + ck * (cross(load_vector(lane, S, to.alpha + 3 * i), R) + cross(w, swing))
            store_vector(lane, S, to.change + 3 * i, mass * found)
            pushed = pushed + cm * mass * R
            turn = _rotary(lane, model, at, to, S, i, load_vector(lane, S, to.theta + 3 * i), weights)
            turn = turn + ck * cross(load_vector(lane, S, to.theta + 3 * i), load_vector(lane, S, to.moment + 3 * i))
            store_vector(lane, S, to.second + 3 * i, turn)
    # motion of the last section; the strain's row by the root's position: cm sum m R
    row, end = 3 * j + c, load_vector(lane, S, to.theta + 3 * n)
    store_vector(lane, S, to.last + 6 * row, frame @ load_vector(lane, S, to.moved + 3 * n))
    store_vector(lane, S, to.last + 6 * row + 3, matrix_in(lane, S, to.turn + 9 * n).T @ end)
    store_vector(lane, S, to.by_root + 6 * row, frame @ pushed)
    moment = ck * cross(end, load_vector(lane, S, to.bend + 3 * n))
    force, couple = _on_strains(
        lane,
        model,
        S,
        at,
        to,
        Vector(zero, zero, zero),
        moment,
        ck,
        (j, c),
        to.matrix + row,
        3 * m,
    )
    store_vector(lane, S, to.on_root + 6 * row, frame @ force)
    store_vector(lane, S, to.on_root + 6 * row + 3, couple)


@kernel
def _by_turn(lane, model, weights, S: Lanes, f, at, to, axis, c):
    """Compute the column of the matrix for a rotation of the root about its axis c (unit vector `axis`, root axes).

    The function adds column 3 + c of the 6 x 6 block LL at offset f of S (force in inertial axes, moment in root axes)
    and fills `by_root`. In inertial axes, the root's acceleration minus gravity and the force on the last section stay
    fixed. See docs/theory.md, (9.5).
    """
    n, zero = size(model.points), 0.0
    cm, cd, ck = weights.mass, weights.damping, weights.stiffness
    frame, spin = matrix_in(lane, S, to.frame), load_vector(lane, S, to.spin)
    fall, forces = -ck * cross(axis, load_vector(lane, S, to.a)), Vector(zero, zero, zero)
    # changes seen from the root: displacement R = axis x r; fall: the root's acceleration, which does not rotate
    for i in range(n):
        r, mass = load_vector(lane, S, to.r + 3 * i), model.strains[at.mass + i]
        R, slip = cross(axis, r), load_vector(lane, S, to.slip + 3 * i)
        found = cm * R + fall + cd * (cross(axis, slip) + cross(spin, R))
        store_vector(lane, S, to.change + 3 * i, mass * found)
        store_vector(lane, S, to.second + 3 * i, _rotary(lane, model, at, to, S, i, axis, weights))
        forces = forces + load_vector(lane, S, to.force + 3 * i)
    held = -ck * cross(axis, frame.T @ load_vector(lane, S, to.on))
    force, couple = _on_strains(lane, model, S, at, to, held, Vector(zero, zero, zero), ck, None, to.by_root + 3 + c, 6)
    # back to inertial axes; f of all points turns with the root
    force = frame @ (force - held + ck * cross(axis, forces))
    for i in range(3):
        S[f + F.LL + 6 * i + 3 + c] += force[i]
        S[f + F.LL + 18 + 6 * i + 3 + c] += couple[i]


@kernel
def strained_tangent(lane, model, par: Lanes, k, weights, S: Lanes, f):
    """Store the Newton matrix of link k's strains in its `NOTED`; add the block of its root to LL at offset f of S.

    f: offset of the link's `FACTOR` record. RR, the block of the last section, is not written here. `NOTED` must
    contain the values that `sweep_outward` and `sweep_inward` store.
    par: the arm's factors on stiffnesses, and tau_d.
    weights: factors of mass, damping and stiffness (`Weights`). See docs/theory.md, (9.5).
    """
    n, m, at, to = size(model.points), size(model.polynomials), strained_at(model, k), noted_at(model, k)
    zero, cm = 0.0, weights.mass
    one = zero + 1.0
    frame, spin = matrix_in(lane, S, to.frame), load_vector(lane, S, to.spin)
    fill_zeros(lane, S, to.matrix, to.end - to.matrix)
    end = load_vector(lane, S, to.r + 3 * n)
    store_matrix(lane, S, to.last_turn, matrix_in(lane, S, to.turn + 9 * n))
    store_matrix(lane, S, to.shift, -(frame @ skew(end)))
    # dpsi of the intervals, v of the points relative to the root (root axes), sum m and sum m r
    lever, mass = Vector(zero, zero, zero), zero
    for i in range(n + 1):
        _turns(lane, S, to, i)
        if i < n:
            r, u = load_vector(lane, S, to.r + 3 * i), Vector(zero, zero, zero)
            for p in range(n):
                rate = cross(load_vector(lane, S, to.w + 3 * p), noted_tangent(lane, S, to, p))
                u = u + model.strains[at.ways + n * i + p] * rate
            store_vector(lane, S, to.slip + 3 * i, 2.0 * u - cross(spin, r))
            mass = mass + model.strains[at.mass + i]
            lever = lever + model.strains[at.mass + i] * r
    # columns by c_j, then by the root's rotation (root axes) and translation, c_m sum m
    for j in range(m):
        for c in range(3):
            _by_strain(lane, model, weights, S, at, to, j, c)
    _by_turn(lane, model, weights, S, f, at, to, Vector(one, zero, zero), 0)
    _by_turn(lane, model, weights, S, f, at, to, Vector(zero, one, zero), 1)
    _by_turn(lane, model, weights, S, f, at, to, Vector(zero, zero, one), 2)
    for i in range(3):
        S[f + F.LL + 7 * i] += mass * cm
    add_block(lane, S, f + F.LL, 1, 0, skew(cm * lever) @ frame.T)
    # K_ij (c_k + tau_d c_v) - (M - M*) c_m, because steps see the inertia M* (5.3)
    share = weights.stiffness + zero
    if model.damped is not None:
        share = share + par[TAU_D] * (model.strains[at.damping] * weights.damping)
    for i in range(m):
        for j in range(m):
            K, lighter = stiff_of(lane, model, par, k, i, j), correction_of(lane, model, k, i, j)
            for c in range(3):
                S[to.matrix + 3 * m * (3 * i + c) + 3 * j + c] += K[c] * share - lighter[c] * cm
