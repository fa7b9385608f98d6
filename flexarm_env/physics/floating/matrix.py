"""A body's matrix, cm dr/da + cc dr/dv + ck dr/dq, and its elimination from a chain (docs: theory, section 3).

Rows and columns: the body's n elastic coordinates, then x, y of the acceleration of its origin and its angle.
"""

from ...compiler import kernel, load, size, splat, store, unrolled
from ..arithmetic import pair, put_pair, turned, turned_back, vector
from ..model import STIFFNESS_FACTOR
from .body import constants, damping_time, dot, turn_of_root
from .layout import KNOWN, NOW, cell, factors_at, span_at, strain_at, vectors_at, window


@unrolled
@kernel
def tangent(lane, model, D, par, carried, cm, cc, ck, q, v, a, known, vectors, strains, S):
    """The body's matrix cm dr/da + cc dr/dv + ck dr/dq, with the lever arms of the force at its tip; how the tip moves
    (`arm`) and how its acceleration changes (`swept`)."""
    own, n = constants(model), size(model.n)
    at, vec = factors_at(0, n), vectors_at(0, n)
    W, wide, theta = at.matrix, n + 3, n + 2
    ax, ay = pair(lane, S, at.now + NOW.a)
    w, alpha = pair(lane, S, at.now + NOW.rate)
    sx, sy = pair(lane, known, KNOWN.s)
    tx, ty = pair(lane, known, KNOWN.t)
    dx, dy = pair(lane, known, KNOWN.d)
    gx, gy = pair(lane, known, KNOWN.g)
    inertia, spin_rate = pair(lane, known, KNOWN.inertia)
    stiffness, tau = load(lane, par, STIFFNESS_FACTOR), damping_time(lane, model, D, par)
    put_pair(S, at.frame, pair(lane, S, at.now + NOW.cos))
    mass = splat(lane, D[own.mass])
    square, twice = w * w, w * (2.0 * cc)
    x, y = pair(lane, S, at.now + NOW.tip)
    ux, uy = pair(lane, S, at.now + NOW.tip_rate)
    bx, by = pair(lane, S, at.now + NOW.tip_second)
    put_pair(S, at.arm + 2 * n, (-y, x))
    put_pair(S, at.swept + 2 * n, (-(y * cm + uy * (2.0 * cc) + by * ck), x * cm + ux * (2.0 * cc) + bx * ck))
    zero = splat(lane, 0.0)
    px, py, pt = W + n * wide, W + (n + 1) * wide, W + theta * wide  # rows of x, y, angle
    put_pair(S, px + n, (mass, zero))
    put_pair(S, py + n, (zero, mass))
    put_pair(S, pt + n, (-sy, sx))
    store(S, px + theta, -(sy * cm) - (w * sx + ty) * (2.0 * cc) - dy * ck)
    store(S, py + theta, sx * cm - (w * sy - tx) * (2.0 * cc) + dx * ck)
    store(S, pt + theta, inertia * cm + spin_rate * (2.0 * cc) - ((sx * ax + sy * ay) + (x * gx + y * gy)) * ck)
    slope = splat(lane, ck)  # of elastic forces
    if model.damped is not None:
        slope = tau * cc + ck
    bend = slope * stiffness
    spun, turned = twice + alpha * ck, square * ck
    for i in range(n):
        gq, cb, bv = load(lane, vectors, vec.gq + i), load(lane, vectors, vec.cb + i), load(lane, vectors, vec.bv + i)
        gsx, gsy = load(lane, vectors, vec.gsx + i), splat(lane, D[own.S_bar_y + i])
        tipx, tipy = load(lane, vectors, vec.px + i), splat(lane, D[own.tip_v + i])
        along = gsx * cm - gsy * spun - gsx * turned
        across = gsy * cm + gsx * spun - gsy * turned
        swept_x = tipx * cm - tipy * spun - tipx * turned
        swept_y = tipy * cm + tipx * spun - tipy * turned
        if model.modal is not None:
            dv, da = dot(lane, model, D, own.D0 + i * n, v), dot(lane, model, D, own.D0 + i * n, a)
            along, across = along - (dv * (2.0 * cc) + da * ck), across - (w * dv) * (2.0 * ck)
            dv, da = dot(lane, model, D, own.tip_H + i * n, v), dot(lane, model, D, own.tip_H + i * n, a)
            swept_x, swept_y = swept_x - (dv * (2.0 * cc) + da * ck), swept_y - (w * dv) * (2.0 * ck)
        put_pair(S, at.arm + 2 * i, (tipx, tipy))
        put_pair(S, at.swept + 2 * i, (swept_x, swept_y))
        store(S, px + i, along)
        store(S, py + i, across)
        ba = splat(lane, -0.0)
        if model.modal is None:
            ba = load(lane, a, 0) * D[own.B + i]
            for j in range(1, n):
                ba = ba + load(lane, a, j) * D[own.B + j * n + i]
        gv = dot(lane, model, D, own.G + i * n, v)
        lever = (gsx * ay - gsy * ax) + (tipx * gy - tipy * gx)
        about = lever + (alpha * gq) * 2.0 + ba + (w * gv) * 2.0
        store(S, pt + i, cb * cm + gq * twice + about * ck)
        row = W + i * wide
        put_pair(S, row + n, (gsx, gsy))
        store(S, row + theta, cb * cm + (bv - w * gq) * (2.0 * cc) + lever * ck)
        for j in range(n):
            entry = bend * D[own.K_bend + i * n + j] + cm * D[own.M_ff + i * n + j]
            entry = entry - turned * D[own.G + i * n + j]
            if model.modal is None:
                entry = entry + spun * D[own.B + i * n + j]
                if model.full is None:
                    entry = entry + slope * D[own.K_axial + i * n + j]
            else:
                entry = entry - (ax * D[own.D0 + i * n + j] + gx * D[own.tip_H + i * n + j]) * ck
            if model.drag is not None:
                entry = entry + (cc * D[own.drag]) * D[own.M_ff + i * n + j]
            store(S, row + j, entry)
    _stretching(lane, model, D, tau, cc, ck, strains, S)
    if model.drag is not None:
        _drag_tangent(lane, model, D, carried, cc, ck, v, vectors, S)


@kernel
def _stretching(lane, model, D, tau, cc, ck, strains, S):
    """The elements' part of the matrix: through the axial force, and its turning."""
    n, wide = size(model.n), len(model.window)
    W, own, kept = factors_at(0, n).matrix, span_at(constants(model).spans, wide), strain_at(0, wide)
    for e in range(len(model.elements)):
        first = window(model, n, e)
        force = load(lane, strains, kept.force) * ck
        both, lag = splat(lane, D[own.stiffness] * ck), splat(lane, 0.0)
        if model.damped is not None:
            both, lag = (tau * cc + ck) * D[own.stiffness], (tau * ck) * D[own.stiffness]
        for j in range(wide):
            if model.full is None:
                change = splat(lane, ck * D[own.stiffness] * D[own.stretch + j])
            else:
                change = both * load(lane, strains, kept.slope + j)
                if model.damped is not None:
                    change = change + lag * load(lane, strains, kept.rate + j)
            for i in range(wide):
                entry = load(lane, strains, kept.slope + i) * change + force * D[own.H + i * wide + j]
                place = W + (first + i) * (n + 3) + first + j
                store(S, place, load(lane, S, place) + entry)
        own, kept = span_at(own.end, wide), strain_at(kept.end, wide)


@kernel
def _drag_tangent(lane, model, D, carried, cc, ck, v, vectors, S):
    """What drag on the carried mass adds to the matrix."""
    own, n = constants(model), size(model.n)
    W, px = factors_at(0, n).matrix, vectors_at(0, n).px
    mass, inertia = load(lane, carried, 0) * D[own.drag], load(lane, carried, 1) * D[own.drag]
    tx = splat(lane, 0.0)
    for i in range(n):
        tx = tx + load(lane, vectors, px + i) * load(lane, v, i)
    for i in range(n):
        xi, yi, phi = load(lane, vectors, px + i), D[own.tip_v + i], D[own.tip_phi + i]
        for j in range(n):
            entry = (xi * load(lane, vectors, px + j) + yi * D[own.tip_v + j]) * mass
            entry = (entry + inertia * (phi * D[own.tip_phi + j])) * cc
            if model.modal is not None:
                lost = xi * dot(lane, model, D, own.tip_H + j * n, v) + tx * D[own.tip_H + i * n + j]
                entry = entry - (lost * mass) * ck
            place = W + i * (n + 3) + j
            store(S, place, load(lane, S, place) + entry)


@unrolled
@kernel
def take_in(lane, model, D, S, tail):
    """The body's matrix with what lies behind it.

    tail (9, by rows, global axes): change of force and moment by a change of the acceleration and the angle at the tip
    section; it is turned to the frame's axes.
    """
    own, n = constants(model), size(model.n)
    at = factors_at(0, n)
    W, wide = at.matrix, n + 3
    c, s = pair(lane, S, at.frame)
    _turn_matrix(lane, tail, c, -s)
    for j in range(wide):  # what comes back through the tip by column j
        if j < n:
            bx, by = pair(lane, S, at.swept + 2 * j)
            fx, fy, m = _times(lane, tail, bx, by, splat(lane, D[own.tip_phi + j]))
        elif j == wide - 1:
            bx, by = pair(lane, S, at.swept + 2 * n)
            fx, fy, m = _times(lane, tail, bx, by, splat(lane, 1.0))
        else:
            k = j - n
            fx, fy, m = load(lane, tail, cell(0, k)), load(lane, tail, cell(1, k)), load(lane, tail, cell(2, k))
        for i in range(wide):
            k = W + i * wide + j
            if i < n:
                px, py = pair(lane, S, at.arm + 2 * i)
                part = px * fx + py * fy + m * D[own.tip_phi + i]
            elif i == n:
                part = fx
            elif i == n + 1:
                part = fy
            else:
                px, py = pair(lane, S, at.arm + 2 * n)
                part = px * fx + py * fy + m
            store(S, k, load(lane, S, k) + part)


@unrolled
@kernel
def condense(lane, model, D, S, tail):
    """Take in what lies behind, eliminate the elastic coordinates, hand on what is left.

    tail (9, by rows, global axes): change of force and moment by a change of the acceleration and the angle; in at the
    tip section, out at the root section. Factors stay in the matrix, pivots inverted: no pivoting, since cm M, positive
    definite, outweighs the rest.
    """
    take_in(lane, model, D, S, tail)
    own, n = constants(model), size(model.n)
    at = factors_at(0, n)
    W, wide, theta = at.matrix, n + 3, n + 2
    if model.chord is not None:  # from the frame's angle to the root section's
        for i in range(wide):
            last = load(lane, S, W + i * wide + theta)
            for j in range(n):
                k = W + i * wide + j
                store(S, k, load(lane, S, k) - last * D[own.root + j])
        for j in range(wide):
            last = load(lane, S, W + theta * wide + j)
            for i in range(n):
                k = W + i * wide + j
                store(S, k, load(lane, S, k) - last * D[own.root + i])
    for k in range(n):
        inverse = 1.0 / load(lane, S, W + k * wide + k)
        store(S, W + k * wide + k, inverse)
        for i in range(k + 1, wide):
            f = load(lane, S, W + i * wide + k) * inverse
            store(S, W + i * wide + k, f)
            for j in range(k + 1, wide):
                place = W + i * wide + j
                store(S, place, load(lane, S, place) - f * load(lane, S, W + k * wide + j))
    for i in range(3):
        for j in range(3):
            store(tail, cell(i, j), load(lane, S, W + (n + i) * wide + n + j))
    c, s = pair(lane, S, at.frame)
    _turn_matrix(lane, tail, c, s)


@kernel
def _times(lane, tail, x, y, turn):
    """The matrix of three rows times (x, y, turn)."""
    one, two, three = vector(lane, tail, 0), vector(lane, tail, 3), vector(lane, tail, 6)
    return (
        one[0] * x + one[1] * y + one[2] * turn,
        two[0] * x + two[1] * y + two[2] * turn,
        three[0] * x + three[1] * y + three[2] * turn,
    )


@kernel
def _turn_matrix(lane, tail, c, s):
    """The matrix of three rows in axes turned back by the angle with cosine c and sine s."""
    for j in range(3):
        x, y = turned(c, s, load(lane, tail, cell(0, j)), load(lane, tail, cell(1, j)))
        store(tail, cell(0, j), x)
        store(tail, cell(1, j), y)
    for i in range(3):
        x, y = pair(lane, tail, cell(i, 0))
        put_pair(tail, cell(i, 0), turned(c, s, x, y))


@unrolled
@kernel
def reduce(lane, model, D, S, x, flow):
    """Right sides from tip to root: flow (3, global axes) is what is left of those behind, in force and moment."""
    own, n = constants(model), size(model.n)
    at = factors_at(0, n)
    W, wide, theta = at.matrix, n + 3, n + 2
    c, s = pair(lane, S, at.frame)
    fx, fy, moment = vector(lane, flow, 0)
    gx, gy = turned_back(c, s, fx, fy)
    px, py = pair(lane, S, at.arm + 2 * n)
    turning = px * gx + py * gy + moment
    left_x, left_y, left_t = gx, gy, turning
    for i in range(n):
        px, py = pair(lane, S, at.arm + 2 * i)
        total = load(lane, x, i) - (px * gx + py * gy) - moment * D[own.tip_phi + i]
        if model.chord is not None:
            total = total + turning * D[own.root + i]
        for j in range(i):
            total = total - load(lane, S, W + i * wide + j) * load(lane, x, j)
        store(x, i, total)
        left_x = left_x + load(lane, S, W + n * wide + i) * total
        left_y = left_y + load(lane, S, W + (n + 1) * wide + i) * total
        left_t = left_t + load(lane, S, W + theta * wide + i) * total
    put_pair(flow, 0, turned(c, s, left_x, left_y))
    store(flow, 2, left_t)


@unrolled
@kernel
def restore(lane, model, D, S, x, flow):
    """Solution from root to tip: flow (3, global axes) is the change of acceleration and angle at a section."""
    own, n = constants(model), size(model.n)
    at = factors_at(0, n)
    W, wide, theta = at.matrix, n + 3, n + 2
    c, s = pair(lane, S, at.frame)
    fx, fy, turn = vector(lane, flow, 0)
    bx, by = turned_back(c, s, fx, fy)
    for i in range(n - 1, -1, -1):
        row = W + i * wide
        total = load(lane, x, i) - load(lane, S, row + n) * bx - load(lane, S, row + n + 1) * by
        total = total - load(lane, S, row + theta) * turn
        for j in range(i + 1, n):
            total = total - load(lane, S, row + j) * load(lane, x, j)
        store(x, i, total * load(lane, S, row + i))
    if model.chord is not None:
        turn = turn - turn_of_root(lane, model, D, x)
    wx, wy = pair(lane, S, at.swept + 2 * n)
    bx, by = bx + wx * turn, by + wy * turn
    for j in range(n):
        wx, wy = pair(lane, S, at.swept + 2 * j)
        bx, by = bx + wx * load(lane, x, j), by + wy * load(lane, x, j)
    put_pair(flow, 0, turned(c, s, bx, by))
    store(flow, 2, turn + dot(lane, model, D, own.tip_phi, x))
