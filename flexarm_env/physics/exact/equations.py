"""Chains of geometrically exact beams: residual, tangent and its factors (model: `physics.model.ExactBeam`).

An element (`element`) passes what it has of its right vertex to the next one, so that each row is written once. A link
hinged to the tip before it shares that vertex's position; its root's angle there is psi + delta, hence a force on that
angle acts on psi and on delta. The interior of each element is condensed as soon as its tangent is known; the vertices
are eliminated from the tip to the root, without pivoting (the matrix is symmetric, and cm M outweighs what is not
positive in it). A free hinge passes only forces on to the link before it: its angle is eliminated on the way.

Where all that is in coordinates and in S is told in `layout`: CHAIN and FACTORS.
"""

from ...compiler import kernel, load, sincos, splat, store
from ..arithmetic import add, put_vector, vector
from ..layout import OF_LOAD
from ..model import PAYLOAD_INERTIA, PAYLOAD_MASS, ExactBeam
from ..protocol import State, register
from .element import backward, directions, forces, forward, handed_on, tangent
from .inertia import inertia, rotate
from .layout import (
    AXES,
    LL,
    LR_T,
    LR_X,
    LR_Y,
    OF_HINGE,
    ROWS_OF_LOAD,
    RR,
    TT,
    XT,
    XX,
    XY,
    YT,
    YY,
    T,
    Vertex,
    X,
    Y,
    elbow_of,
    element_factors_at,
    factors_of,
    lever_at,
    next_section,
    root_angle,
    rows_of,
    section_of,
)
from .output import damping_work, energy, link_poses, ports, predict, shape
from .rigid import ROOT_END, TIP_END, about_root, about_tip, begin, carried, end, last, near, with_payload


@kernel
def _less_loads(lane, model, u, q, r):
    """r less the point loads; those on rigid ends have moments about the vertex before."""
    loads = model.loads
    for f in range(loads.shape[0] // ROWS_OF_LOAD.end):
        at, k = ROWS_OF_LOAD.end * f, model.links + OF_LOAD.end * f
        add(lane, r, loads[at + ROWS_OF_LOAD.x], -load(lane, u, k + OF_LOAD.x))
        add(lane, r, loads[at + ROWS_OF_LOAD.y], -load(lane, u, k + OF_LOAD.y))
        add(lane, r, loads[at + ROWS_OF_LOAD.psi], -load(lane, u, k + OF_LOAD.torque))
        if loads[at + ROWS_OF_LOAD.hinge] >= 0:
            add(lane, r, loads[at + ROWS_OF_LOAD.hinge], -load(lane, u, k + OF_LOAD.torque))
    if model.rigid is not None:
        for f in range(loads.shape[0] // ROWS_OF_LOAD.end):
            row, k = loads[ROWS_OF_LOAD.end * f + ROWS_OF_LOAD.psi], model.links + OF_LOAD.end * f
            sine, cosine = sincos(load(lane, q, row))
            moment = cosine * load(lane, u, k + OF_LOAD.y) - sine * load(lane, u, k + OF_LOAD.x)
            add(lane, r, row, -(moment * model.rigid[lever_at(model.links, 0) + f]))


@kernel
def _at_vertex(lane, model, S, o, mass):
    """A mass at a vertex; where there are levers it is at the far end of one (`rigid`)."""
    if model.rigid is None:
        add(lane, S, o + XX, mass)
        add(lane, S, o + YY, mass)


@kernel
def _lumps(lane, model, par, cm, S):
    """Pin flags cleared; inertia of hub, elbows and payload added to the condensed matrices."""
    if cm != 0.0:
        factors, own = factors_of(model), element_factors_at(0, len(model.order))
        zero = splat(lane, 0.0)
        for k in range(AXES):
            store(S, factors.pinned + k, zero)
        add(lane, S, factors.elements + own.condensed + LL + TT, splat(lane, cm * model.hub_inertia))
        for k in range(1, model.links):
            store(S, factors.hinges + OF_HINGE.end * (k - 1) + OF_HINGE.pinned, zero)
            elbow = elbow_of(model, k)
            after = factors.elements + own.end * model.elements * k + own.condensed
            before = after - own.end
            _at_vertex(lane, model, S, before + RR, splat(lane, cm * elbow.mass))
            add(lane, S, before + RR + TT, splat(lane, cm * elbow.left))
            add(lane, S, after + LL + TT, splat(lane, cm * elbow.right))
        last = factors.end - own.end + own.condensed
        _at_vertex(lane, model, S, last + RR, cm * load(lane, par, PAYLOAD_MASS))
        add(lane, S, last + RR + TT, cm * load(lane, par, PAYLOAD_INERTIA))


@kernel
def _directions(lane, model, q, S):
    """Sines and cosines at all Gauss points, ahead of the elements: long chains, but none waits for another."""
    own = element_factors_at(0, len(model.order))
    i, o = rows_of(model).elements, factors_of(model).elements + own.circle
    for k in range(model.links):
        psi = root_angle(lane, model, q, k)
        for _ in range(model.elements):
            directions(lane, model.order, q[i * len(lane) :], psi, S[o * len(lane) :])
            i += AXES * len(model.order)
            o += own.end
            psi = load(lane, q, i + T)


@kernel
def _behind_hinge(lane, model, state, k, left):
    """The vertex before link k as the link's root has it: its own angle, and the elbow's part that goes with it."""
    (x, y, psi), (vx, vy, spin), (ax, ay, alpha), (fx, fy, _) = left.place, left.rate, left.acceleration, left.force
    elbow, d = elbow_of(model, k), rows_of(model).hinges + k - 1
    alpha = alpha + load(lane, state.a, d)
    if model.damped is not None:
        spin = spin + load(lane, state.v, d)
    return Vertex(
        (x, y, psi + load(lane, state.q, d)),
        (vx, vy, spin),
        (ax, ay, alpha),
        (fx + ax * elbow.mass, fy + ay * elbow.mass, alpha * elbow.right),
    )


@kernel
def assemble(lane, model, par, state, u, weights, r, S):
    """r and, where the weight of M is not 0, the tangent condensed to the vertices."""
    q, v, a = state
    p, rows, own = len(model.order), rows_of(model), element_factors_at(0, len(model.order))
    zero = splat(lane, 0.0)
    torque = load(lane, a, T) * model.hub_inertia - load(lane, u, 0)
    ax, ay, alpha = vector(lane, a, 0)
    rate = zero, zero, zero
    if model.gravity is not None:
        ax, ay = ax - model.gravity[0], ay - model.gravity[1]
    if model.damped is not None:
        rate = vector(lane, v, 0)
    left = Vertex(vector(lane, q, 0), rate, (ax, ay, alpha), (zero, zero, torque))
    i, o = rows.elements, factors_of(model).elements
    _directions(lane, model, q, S)
    for k in range(model.links):
        first, before = i, left
        if model.rigid is not None:
            left = begin(lane, model, state, k, left, i)
        elif k > 0:
            left = _behind_hinge(lane, model, state, k, left)
        section = section_of(lane, model, par, k)
        for _ in range(model.elements):
            j = i * len(lane)
            here = State(q[j:], v[j:], a[j:])
            circle = S[(o + own.circle) * len(lane) :]
            left, points = handed_on(forces(lane, model.order, model.gravity, here, left, section, r[j:], circle))
            if weights.mass != 0.0:
                tangent(lane, model.order, points, section, weights, S[o * len(lane) :])
            i += AXES * p
            o += own.end
            section = next_section(model, section)
        if model.rigid is not None:
            end(lane, model, state, u, k, before, first, r, weights, S)
        elif k > 0:
            moment = load(lane, r, first + T)
            store(r, first + T, (before.force[T] + before.acceleration[T] * elbow_of(model, k).left) + moment)
            store(r, rows.hinges + k - 1, moment - load(lane, u, k))
    if model.rigid is not None:
        fx, fy, moment = last(lane, model, par, state, left, i, weights, S)
    else:
        (fx, fy, moment), (ax, ay, _) = left.force, left.acceleration
        mass = load(lane, par, PAYLOAD_MASS)
        fx, fy = fx + ax * mass, fy + ay * mass
    put_vector(r, i, (fx, fy, moment + left.acceleration[T] * load(lane, par, PAYLOAD_INERTIA)))
    if model.loads is not None:
        _less_loads(lane, model, u, q, r)
    _lumps(lane, model, par, weights.mass, S)


@kernel
def pin(lane, model, S, k):
    """Flag coordinate k, of the root or of a joint, for `factor`."""
    factors = factors_of(model)
    slot = factors.pinned + k
    if k >= AXES:
        slot = factors.hinges + OF_HINGE.end * (k - rows_of(model).hinges) + OF_HINGE.pinned
    store(S, slot, splat(lane, 1.0))


@kernel
def _six(lane, S, o):
    """The `SYMMETRIC` at o."""
    xx, xy, xt = vector(lane, S, o + XX)
    yy, yt, tt = vector(lane, S, o + YY)
    return xx, xy, xt, yy, yt, tt


@kernel
def _factor_three(S, o, xx, xy, xt, yy, yt, tt):
    """Write the factors of a `SYMMETRIC` to o and return them."""
    i0 = 1.0 / xx
    l1, l2 = xy * i0, xt * i0
    i1 = 1.0 / (yy - xy * l1)
    m2 = yt - xy * l2
    l3 = m2 * i1
    i2 = 1.0 / ((tt - xt * l2) - m2 * l3)
    put_vector(S, o + XX, (i0, l1, l2))
    put_vector(S, o + YY, (i1, l3, i2))
    return i0, l1, l2, i1, l3, i2


@kernel
def _eliminate(lane, S, o, tail):
    """Eliminate the right vertex of the element whose `CONDENSED` is at o; what remains on the left one.

    `tail`: what the elements behind left on the right vertex, a `SYMMETRIC`.
    """
    xx, xy, xt, yy, yt, tt = _six(lane, S, o + RR)
    i0, l1, l2, i1, l3, i2 = _factor_three(
        S, o + RR, xx + tail[0], xy + tail[1], xt + tail[2], yy + tail[3], yt + tail[4], tt + tail[5]
    )
    x0, x1, x2 = vector(lane, S, o + LR_X)
    y0, y1, y2 = vector(lane, S, o + LR_Y)
    t0, t1, t2 = vector(lane, S, o + LR_T)
    x1, y1, t1 = x1 - l1 * x0, y1 - l1 * y0, t1 - l1 * t0
    x2, y2, t2 = (x2 - l2 * x0) - l3 * x1, (y2 - l2 * y0) - l3 * y1, (t2 - l2 * t0) - l3 * t1
    p0, p1, p2 = x0 * i0, x1 * i1, x2 * i2
    q0, q1, q2 = y0 * i0, y1 * i1, y2 * i2
    r0, r1, r2 = t0 * i0, t1 * i1, t2 * i2
    put_vector(S, o + LR_X, (p0, p1, p2))
    put_vector(S, o + LR_Y, (q0, q1, q2))
    put_vector(S, o + LR_T, (r0, r1, r2))
    xx, xy, xt, yy, yt, tt = _six(lane, S, o + LL)
    return (
        ((xx - p0 * x0) - p1 * x1) - p2 * x2,
        ((xy - p0 * y0) - p1 * y1) - p2 * y2,
        ((xt - p0 * t0) - p1 * t1) - p2 * t2,
        ((yy - q0 * y0) - q1 * y1) - q2 * y2,
        ((yt - q0 * t0) - q1 * t1) - q2 * t2,
        ((tt - r0 * t0) - r1 * t1) - r2 * t2,
    )


@kernel
def stiffen(lane, model, S, k, x):
    """See `protocol`: the hub's turns the first section, an elbow's is kept for `factor`."""
    factors = factors_of(model)
    if k < AXES:
        add(lane, S, factors.elements + element_factors_at(0, len(model.order)).condensed + LL + TT, x)
    else:
        store(S, factors.hinges + OF_HINGE.end * (k - rows_of(model).hinges) + OF_HINGE.own, x)


@kernel
def _turn_free(lane, model, S, h, tail):
    """Eliminate psi behind the hinge at h, with what a jointed arm adds to its row; what remains at the vertex."""
    xx, xy, xt, yy, yt, tt = tail
    zero = splat(lane, 0.0)
    if model.jointed is None:
        inverse = 1.0 / tt
        zx, zy = xt * inverse, yt * inverse
        store(S, h + OF_HINGE.x, zx)
        store(S, h + OF_HINGE.y, zy)
        store(S, h + OF_HINGE.inverse, inverse)
        return xx - zx * xt, xy - zx * yt, zero, yy - zy * yt, zero, zero
    own = load(lane, S, h + OF_HINGE.own)
    inverse = 1.0 / (tt + own)
    zx, zy, zt = xt * inverse, yt * inverse, own * inverse
    store(S, h + OF_HINGE.x, zx)
    store(S, h + OF_HINGE.y, zy)
    store(S, h + OF_HINGE.inverse, inverse)
    store(S, h + OF_HINGE.own, zt)
    return xx - zx * xt, xy - zx * yt, xt * zt, yy - zy * yt, yt * zt, tt * zt


@kernel
def factor(lane, model, S):
    """L D L' over the vertices from tip to root; inverse pivots are kept."""
    factors, own = factors_of(model), element_factors_at(0, len(model.order))
    zero, one = splat(lane, 0.0), splat(lane, 1.0)
    tail = with_payload(lane, model, S, (zero, zero, zero, zero, zero, zero))
    tail = near(lane, model, S, model.links - 1, TIP_END, tail)
    o = factors.end
    for k in range(model.links - 1, -1, -1):
        for _ in range(model.elements):
            o -= own.end
            tail = _eliminate(lane, S, o + own.condensed, tail)
        tail = near(lane, model, S, k, ROOT_END, tail)
        if k > 0:
            h = factors.hinges + OF_HINGE.end * (k - 1)
            if S[(h + OF_HINGE.pinned) * len(lane)] == 0.0:
                tail = _turn_free(lane, model, S, h, tail)
            tail = near(lane, model, S, k - 1, TIP_END, tail)
    xx, xy, xt, yy, yt, tt = tail
    pinned = factors.pinned
    if S[(pinned + X) * len(lane)] != 0.0:
        xx, xy, xt = one, zero, zero
    if S[(pinned + Y) * len(lane)] != 0.0:
        yy, xy, yt = one, zero, zero
    if S[(pinned + T) * len(lane)] != 0.0:
        tt, xt, yt = one, zero, zero
    _factor_three(S, factors.root, xx, xy, xt, yy, yt, tt)


@kernel
def _forward_three(lane, S, o, x, y, t):
    """Right side (x, y, t), reduced by the factored `SYMMETRIC` at o."""
    y = y - load(lane, S, o + XY) * x
    return x, y, (t - load(lane, S, o + XT) * x) - load(lane, S, o + YT) * y


@kernel
def _backward_three(lane, S, o, x, y, t):
    """Solution from the reduced right side over the pivots."""
    y = y - load(lane, S, o + YT) * t
    return (x - load(lane, S, o + XY) * y) - load(lane, S, o + XT) * t, y, t


@kernel
def _reduce(lane, S, o, x, y, t):
    """Right side of the right vertex of the `CONDENSED` at o, reduced; and what it takes from the left one."""
    x, y, t = _forward_three(lane, S, o + RR, x, y, t)
    x0, x1, x2 = vector(lane, S, o + LR_X)
    y0, y1, y2 = vector(lane, S, o + LR_Y)
    t0, t1, t2 = vector(lane, S, o + LR_T)
    return x, y, t, (x0 * x + x1 * y) + x2 * t, (y0 * x + y1 * y) + y2 * t, (t0 * x + t1 * y) + t2 * t


@kernel
def _restore(lane, S, o, right, left):
    """Solution at the right vertex from its reduced right side and the solution at the left one."""
    (x, y, t), (a, b, c) = right, left
    x0, x1, x2 = vector(lane, S, o + LR_X)
    y0, y1, y2 = vector(lane, S, o + LR_Y)
    t0, t1, t2 = vector(lane, S, o + LR_T)
    t = ((t * load(lane, S, o + RR + TT) - x2 * a) - y2 * b) - t2 * c
    y = ((y * load(lane, S, o + RR + YY) - x1 * a) - y1 * b) - t1 * c
    x = ((x * load(lane, S, o + RR + XX) - x0 * a) - y0 * b) - t0 * c
    return _backward_three(lane, S, o + RR, x, y, t)


@kernel
def solve(lane, model, S, x):
    """x <- S^-1 x with the factors of `factor`."""
    rows, factors, own = rows_of(model), factors_of(model), element_factors_at(0, len(model.order))
    span = AXES * len(model.order)
    i, o, taken = rows.tip, factors.end, splat(lane, 0.0)
    tx, ty, tt = vector(lane, x, i)
    for k in range(model.links - 1, -1, -1):
        for _ in range(model.elements):
            i -= span
            o -= own.end
            lx, ly, lt, rx, ry, rt = forward(lane, model.order, S[o * len(lane) :], x[i * len(lane) :])
            tx, ty, tt, ux, uy, ut = _reduce(lane, S, o + own.condensed, tx - rx, ty - ry, tt - rt)
            put_vector(x, i + span, (tx, ty, tt))
            taken = lt + ut
            tx, ty, tt = vector(lane, x, i)
            tx, ty, tt = (tx - lx) - ux, (ty - ly) - uy, tt - taken
        taken, tt = about_root(lane, model, S, k, x, i, tx, ty, taken, tt)
        if k > 0:
            h, d = factors.hinges + OF_HINGE.end * (k - 1), rows.hinges + k - 1
            if S[(h + OF_HINGE.pinned) * len(lane)] == 0.0:
                own_side = load(lane, x, d)
                both = own_side - taken
                tt = load(lane, x, i + T) - own_side
                if model.jointed is not None:  # with its part of the moment behind
                    tt = tt + load(lane, S, h + OF_HINGE.own) * both
                tx, ty = tx - load(lane, S, h + OF_HINGE.x) * both, ty - load(lane, S, h + OF_HINGE.y) * both
                store(x, d, both)
            tt = about_tip(lane, model, S, k - 1, x, i, tx, ty, tt)
    pinned, root = factors.pinned, factors.root
    if S[(pinned + X) * len(lane)] != 0.0:
        tx = load(lane, x, X)
    if S[(pinned + Y) * len(lane)] != 0.0:
        ty = load(lane, x, Y)
    if S[(pinned + T) * len(lane)] != 0.0:
        tt = load(lane, x, T)
    tx, ty, tt = _forward_three(lane, S, root, tx, ty, tt)
    tx, ty, tt = tx * load(lane, S, root + XX), ty * load(lane, S, root + YY), tt * load(lane, S, root + TT)
    tx, ty, tt = _backward_three(lane, S, root, tx, ty, tt)
    put_vector(x, 0, (tx, ty, tt))
    for k in range(model.links):
        if k > 0:
            h, d = factors.hinges + OF_HINGE.end * (k - 1), rows.hinges + k - 1
            tx, ty = carried(lane, model, S, k - 1, TIP_END, tx, ty, tt)
            psi = tt
            if S[(h + OF_HINGE.pinned) * len(lane)] == 0.0:
                psi = load(lane, x, d) * load(lane, S, h + OF_HINGE.inverse) - load(lane, S, h + OF_HINGE.x) * tx
                psi = psi - load(lane, S, h + OF_HINGE.y) * ty
                if model.jointed is not None:  # with the part that psi before it carries along
                    psi = psi + load(lane, S, h + OF_HINGE.own) * tt
            store(x, d, psi - tt)
            tt = psi
        tx, ty = carried(lane, model, S, k, ROOT_END, tx, ty, tt)
        for _ in range(model.elements):
            left = tx, ty, tt
            tx, ty, tt = _restore(lane, S, o + own.condensed, vector(lane, x, i + span), left)
            put_vector(x, i + span, (tx, ty, tt))
            backward(lane, model.order, S[o * len(lane) :], x[i * len(lane) :], left, (tx, ty, tt))
            i += span
            o += own.end


register(
    ExactBeam, predict, assemble, inertia, rotate, pin, stiffen, factor, solve, ports, damping_work, energy, link_poses,
    shape, solve_transposed=solve,
)  # fmt: skip
