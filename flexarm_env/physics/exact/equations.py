"""Chains of geometrically exact beams: residual, tangent and its factors (model: `flexarm_env.model.ExactBeam`).

Elements (`exact_element`) hand what they know of a vertex to the next one, so that each row is written once. A link
hinged to the tip before it shares that vertex's position; its root's angle there is psi + delta, hence a force on that
angle acts on psi and on delta. The interior of each element is condensed as soon as its tangent is known; the vertices
are eliminated from the tip to the root, without pivoting (the matrix is symmetric, and cm M outweighs what is not
positive in it). A free hinge passes only forces on to the link before it: its angle is eliminated on the way.

S holds: 3 flags of pinned root coordinates, 6 factors of the root, 4 numbers a hinge (flag, couplings of its angle
with x and y, inverse pivot), then for each element its factors (see `exact_element.tangent`), its condensed matrix
LL, LR, RR, and the sines and cosines at its Gauss points.
"""

from __future__ import annotations

from ...compiler.decorator import kernel
from ...compiler.lanes import load, splat, store
from ...compiler.trace import aligned_frame
from ..model import ExactBeam
from ..protocol import register
from .element import VERTEX, backward, forces, forward, tangent, turns
from .inertia import inertia, rotate
from .output import damping_work, energy, link_poses, out_of_range, ports, predict, shape

HEAD = 9
HINGE = 4


@kernel
def _stride(order):
    """`factor_size` of the order."""
    n = 3 * (len(order) - 1)
    return n * (n - 1) // 2 + 7 * n + 21 + 2 * len(order)


@kernel
def _add(lane, array, k, value):
    store(array, k, load(lane, array, k) + value)


@kernel
def _falling(lane, gravity, a, i, k):
    """Acceleration less gravity, component k, of the vertex at row i."""
    if gravity is None:
        return load(lane, a, i + k)
    return load(lane, a, i + k) - gravity[k]


@kernel
def _rates(lane, damped, v, i):
    """Rates of the vertex at row i where anything depends on them."""
    if damped is None:
        return splat(lane, 0.0), splat(lane, 0.0), splat(lane, 0.0)
    return load(lane, v, i), load(lane, v, i + 1), load(lane, v, i + 2)


@kernel
def _rate(lane, damped, v, k):
    if damped is None:
        return splat(lane, 0.0)
    return load(lane, v, k)


@kernel
def _loaded(lane, loads, links, u, r):
    """r less the point loads."""
    if loads is not None:
        for f in range(loads.shape[0] // 4):
            k = links + 3 * f
            _add(lane, r, loads[4 * f], -load(lane, u, k))
            _add(lane, r, loads[4 * f + 1], -load(lane, u, k + 1))
            _add(lane, r, loads[4 * f + 2], -load(lane, u, k + 2))
            if loads[4 * f + 3] >= 0:
                _add(lane, r, loads[4 * f + 3], -load(lane, u, k + 2))


@kernel
def _lumps(lane, model, par, cm, S):
    """Pin flags cleared; inertia of hub, elbows and payload added to the condensed matrices."""
    if cm != 0.0:
        links, stride = model.links, _stride(model.order)
        first = HEAD + HINGE * (links - 1)
        zero = splat(lane, 0.0)
        for k in range(3):
            store(S, k, zero)
        block = first + stride - 21 - 2 * len(model.order)
        _add(lane, S, block + 5, splat(lane, cm * model.hub_inertia))
        for k in range(1, links):
            store(S, HEAD + HINGE * (k - 1), zero)
            after = block + stride * model.elements * k
            before = after - stride
            mass = splat(lane, cm * model.elbows[3 * k - 3])
            _add(lane, S, before + 15, mass)
            _add(lane, S, before + 18, mass)
            _add(lane, S, before + 20, splat(lane, cm * model.elbows[3 * k - 2]))
            _add(lane, S, after + 5, splat(lane, cm * model.elbows[3 * k - 1]))
        last = block + stride * (model.elements * links - 1)
        mass = cm * load(lane, par, 0)
        _add(lane, S, last + 15, mass)
        _add(lane, S, last + 18, mass)
        _add(lane, S, last + 20, cm * load(lane, par, 1))


@kernel
def _circles(lane, model, q, S):
    """Sines and cosines at all Gauss points, ahead of the elements: long chains, but none waits for another."""
    p, stride = len(model.order), _stride(model.order)
    deltas = 3 * p * model.elements * model.links + 3
    i, o = 3, HEAD + HINGE * (model.links - 1) + stride - 2 * p
    for k in range(model.links):
        turn = load(lane, q, i - 1)
        if k > 0:
            turn = turn + load(lane, q, deltas + k - 1)
        for _ in range(model.elements):
            turns(lane, model.order, q[(i - 3) * len(lane) :], turn, S[o * len(lane) :])
            i += 3 * p
            o += stride
            turn = load(lane, q, i - 1)


@kernel
def assemble(lane, model, par, state, u, weights, r, S):
    """r and, where the weight of M is not 0, the tangent condensed to the vertices."""
    (q, v, a), (cm, cc, ck) = state, weights
    aligned_frame(lane)
    links, p, stride = model.links, len(model.order), _stride(model.order)
    stiffness, tau = load(lane, par, 2), load(lane, par, 3)
    zero = splat(lane, 0.0)
    vx, vy, vt = _rates(lane, model.damped, v, 0)
    at = load(lane, a, 2)
    left = (
        load(lane, q, 0), load(lane, q, 1), load(lane, q, 2), vx, vy, vt,
        _falling(lane, model.gravity, a, 0, 0), _falling(lane, model.gravity, a, 0, 1), at,
        zero, zero, at * model.hub_inertia - load(lane, u, 0),
    )  # fmt: skip
    i, o = 3, HEAD + HINGE * (links - 1)
    deltas = 3 * p * model.elements * links + 3
    _circles(lane, model, q, S)
    for k in range(links):
        root, before, turn = i, zero, zero
        if k > 0:
            x, y, t, vx, vy, vt, ax, ay, at, fx, fy, ft = left
            mass = model.elbows[3 * k - 3]
            before = ft + at * model.elbows[3 * k - 2]
            d = deltas + k - 1
            turn = at + load(lane, a, d)
            left = (
                x, y, t + load(lane, q, d), vx, vy, vt + _rate(lane, model.damped, v, d), ax, ay, turn,
                fx + ax * mass, fy + ay * mass, turn * model.elbows[3 * k - 1],
            )  # fmt: skip
        k1, k2, kb = model.sections[6 * k], model.sections[6 * k + 1], stiffness * model.sections[6 * k + 2]
        length, ml, jl = model.sections[6 * k + 3], model.sections[6 * k + 4], model.sections[6 * k + 5]
        for _ in range(model.elements):
            j = (i - 3) * len(lane)
            out = forces(
                lane, model.order, model.damped, model.gravity, q[j:], v[j:], a[j:], left,
                k1, k2, kb, length, ml, jl, tau, r[j:], S[(o + stride - 2 * p) * len(lane) :],
            )  # fmt: skip
            left, points = out[:VERTEX], out[VERTEX:]
            if cm != 0.0:
                tangent(
                    lane, model.order, model.damped, points, k1, k2, kb, ml, jl, tau, cm, cc, ck, S[o * len(lane) :]
                )
            i += 3 * p
            o += stride
        if k > 0:
            ft = load(lane, r, root - 1)
            store(r, root - 1, before + ft)
            store(r, deltas + k - 1, ft - load(lane, u, k))
    mass, inertia = load(lane, par, 0), load(lane, par, 1)
    store(r, i - 3, left[9] + left[6] * mass)
    store(r, i - 2, left[10] + left[7] * mass)
    store(r, i - 1, left[11] + left[8] * inertia)
    _loaded(lane, model.loads, links, u, r)
    _lumps(lane, model, par, cm, S)


@kernel
def constrain(lane, model, psi, state, level, scale, r):
    """No constraint is left: joints are coordinates."""


@kernel
def pin(lane, model, S, k):
    """Flag coordinate k, of the root or of a joint, for `factor`."""
    slot = k
    if k > 2:
        slot = HEAD + HINGE * (k - 3 * len(model.order) * model.elements * model.links - 3)
    store(S, slot, splat(lane, 1.0))


@kernel
def _eliminate(lane, S, o, tail):
    """Eliminate the right vertex of the element whose condensed matrix is at o; what remains on the left one.

    `tail`: what the elements behind left on the right vertex (xx, xy, xt, yy, yt, tt).
    """
    xx, xy, xt = load(lane, S, o + 15) + tail[0], load(lane, S, o + 16) + tail[1], load(lane, S, o + 17) + tail[2]
    yy, yt, tt = load(lane, S, o + 18) + tail[3], load(lane, S, o + 19) + tail[4], load(lane, S, o + 20) + tail[5]
    i0 = 1.0 / xx
    l1, l2 = xy * i0, xt * i0
    i1 = 1.0 / (yy - xy * l1)
    m2 = yt - xy * l2
    l3 = m2 * i1
    i2 = 1.0 / ((tt - xt * l2) - m2 * l3)
    store(S, o + 15, i0)
    store(S, o + 16, l1)
    store(S, o + 17, l2)
    store(S, o + 18, i1)
    store(S, o + 19, l3)
    store(S, o + 20, i2)
    x0, x1, x2 = load(lane, S, o + 6), load(lane, S, o + 7), load(lane, S, o + 8)  # row x of the left vertex
    y0, y1, y2 = load(lane, S, o + 9), load(lane, S, o + 10), load(lane, S, o + 11)
    t0, t1, t2 = load(lane, S, o + 12), load(lane, S, o + 13), load(lane, S, o + 14)
    x1, y1, t1 = x1 - l1 * x0, y1 - l1 * y0, t1 - l1 * t0
    x2, y2, t2 = (x2 - l2 * x0) - l3 * x1, (y2 - l2 * y0) - l3 * y1, (t2 - l2 * t0) - l3 * t1
    p0, p1, p2 = x0 * i0, x1 * i1, x2 * i2
    q0, q1, q2 = y0 * i0, y1 * i1, y2 * i2
    r0, r1, r2 = t0 * i0, t1 * i1, t2 * i2
    store(S, o + 6, p0)
    store(S, o + 7, p1)
    store(S, o + 8, p2)
    store(S, o + 9, q0)
    store(S, o + 10, q1)
    store(S, o + 11, q2)
    store(S, o + 12, r0)
    store(S, o + 13, r1)
    store(S, o + 14, r2)
    return (
        ((load(lane, S, o) - p0 * x0) - p1 * x1) - p2 * x2,
        ((load(lane, S, o + 1) - p0 * y0) - p1 * y1) - p2 * y2,
        ((load(lane, S, o + 2) - p0 * t0) - p1 * t1) - p2 * t2,
        ((load(lane, S, o + 3) - q0 * y0) - q1 * y1) - q2 * y2,
        ((load(lane, S, o + 4) - q0 * t0) - q1 * t1) - q2 * t2,
        ((load(lane, S, o + 5) - r0 * t0) - r1 * t1) - r2 * t2,
    )


@kernel
def factor(lane, model, S):
    """L D L' over the vertices from tip to root; inverse pivots are kept."""
    aligned_frame(lane)
    links, stride = model.links, _stride(model.order)
    zero, one = splat(lane, 0.0), splat(lane, 1.0)
    tail = (zero, zero, zero, zero, zero, zero)
    o = HEAD + HINGE * (links - 1) + stride * (links * model.elements + 1) - 21 - 2 * len(model.order)
    for k in range(links - 1, -1, -1):
        for _ in range(model.elements):
            o -= stride
            tail = _eliminate(lane, S, o, tail)
        if k > 0:
            h = HEAD + HINGE * (k - 1)
            if S[h * len(lane)] == 0.0:
                xx, xy, xt, yy, yt, tt = tail
                inverse = 1.0 / tt
                zx, zy = xt * inverse, yt * inverse
                store(S, h + 1, zx)
                store(S, h + 2, zy)
                store(S, h + 3, inverse)
                tail = (xx - zx * xt, xy - zx * yt, zero, yy - zy * yt, zero, zero)
    xx, xy, xt, yy, yt, tt = tail
    if S[0] != 0.0:
        xx, xy, xt = one, zero, zero
    if S[len(lane)] != 0.0:
        yy, xy, yt = one, zero, zero
    if S[2 * len(lane)] != 0.0:
        tt, xt, yt = one, zero, zero
    i0 = 1.0 / xx
    l1, l2 = xy * i0, xt * i0
    i1 = 1.0 / (yy - xy * l1)
    m2 = yt - xy * l2
    l3 = m2 * i1
    store(S, 3, i0)
    store(S, 4, l1)
    store(S, 5, l2)
    store(S, 6, i1)
    store(S, 7, l3)
    store(S, 8, 1.0 / ((tt - xt * l2) - m2 * l3))


@kernel
def _reduce(lane, S, o, x, y, t):
    """Right side of the right vertex at o, reduced; and what it takes from the left one."""
    y = y - load(lane, S, o + 16) * x
    t = (t - load(lane, S, o + 17) * x) - load(lane, S, o + 19) * y
    return (
        x, y, t,
        (load(lane, S, o + 6) * x + load(lane, S, o + 7) * y) + load(lane, S, o + 8) * t,
        (load(lane, S, o + 9) * x + load(lane, S, o + 10) * y) + load(lane, S, o + 11) * t,
        (load(lane, S, o + 12) * x + load(lane, S, o + 13) * y) + load(lane, S, o + 14) * t,
    )  # fmt: skip


@kernel
def _restore(lane, S, o, x, y, t, a, b, c):
    """Solution (x, y, t) at the right vertex from its reduced right side and the solution (a, b, c) at the left one."""
    t = ((t * load(lane, S, o + 20) - load(lane, S, o + 8) * a) - load(lane, S, o + 11) * b) - load(lane, S, o + 14) * c
    y = ((y * load(lane, S, o + 18) - load(lane, S, o + 7) * a) - load(lane, S, o + 10) * b) - load(lane, S, o + 13) * c
    x = ((x * load(lane, S, o + 15) - load(lane, S, o + 6) * a) - load(lane, S, o + 9) * b) - load(lane, S, o + 12) * c
    y = y - load(lane, S, o + 19) * t
    x = (x - load(lane, S, o + 16) * y) - load(lane, S, o + 17) * t
    return x, y, t


@kernel
def solve(lane, model, S, x):
    """x <- S^-1 x with the factors of `factor`."""
    aligned_frame(lane)
    links, p, stride = model.links, len(model.order), _stride(model.order)
    zero = splat(lane, 0.0)
    deltas = 3 * p * model.elements * links + 3
    i, o = deltas, HEAD + HINGE * (links - 1) + stride * links * model.elements
    tx, ty, tt, taken = load(lane, x, i - 3), load(lane, x, i - 2), load(lane, x, i - 1), zero
    for k in range(links - 1, -1, -1):
        for _ in range(model.elements):
            i -= 3 * p
            o -= stride
            lx, ly, lt, rx, ry, rt = forward(lane, model.order, S[o * len(lane) :], x[(i - 3) * len(lane) :])
            tx, ty, tt, ux, uy, ut = _reduce(lane, S, o + stride - 21 - 2 * p, tx - rx, ty - ry, tt - rt)
            store(x, i + 3 * p - 3, tx)
            store(x, i + 3 * p - 2, ty)
            store(x, i + 3 * p - 1, tt)
            taken = lt + ut
            tx, ty = (load(lane, x, i - 3) - lx) - ux, (load(lane, x, i - 2) - ly) - uy
            tt = load(lane, x, i - 1) - taken
        if k > 0:
            h, d = HEAD + HINGE * (k - 1), deltas + k - 1
            if S[h * len(lane)] == 0.0:
                turn = load(lane, x, d)
                both = turn - taken
                tt = load(lane, x, i - 1) - turn
                tx, ty = tx - load(lane, S, h + 1) * both, ty - load(lane, S, h + 2) * both
                store(x, d, both)
    if S[0] != 0.0:
        tx = load(lane, x, 0)
    if S[len(lane)] != 0.0:
        ty = load(lane, x, 1)
    if S[2 * len(lane)] != 0.0:
        tt = load(lane, x, 2)
    ty = ty - load(lane, S, 4) * tx
    tt = (tt - load(lane, S, 5) * tx) - load(lane, S, 7) * ty
    tt = tt * load(lane, S, 8)
    ty = ty * load(lane, S, 6) - load(lane, S, 7) * tt
    tx = (tx * load(lane, S, 3) - load(lane, S, 4) * ty) - load(lane, S, 5) * tt
    store(x, 0, tx)
    store(x, 1, ty)
    store(x, 2, tt)
    for k in range(links):
        if k > 0:
            h, d = HEAD + HINGE * (k - 1), deltas + k - 1
            turn = tt
            if S[h * len(lane)] == 0.0:
                turn = (load(lane, x, d) * load(lane, S, h + 3) - load(lane, S, h + 1) * tx) - load(lane, S, h + 2) * ty
            store(x, d, turn - tt)
            tt = turn
        for _ in range(model.elements):
            j, b = i + 3 * p - 3, o + stride - 21 - 2 * p
            rx, ry, rt = _restore(lane, S, b, load(lane, x, j), load(lane, x, j + 1), load(lane, x, j + 2), tx, ty, tt)
            store(x, j, rx)
            store(x, j + 1, ry)
            store(x, j + 2, rt)
            backward(lane, model.order, S[o * len(lane) :], x[(i - 3) * len(lane) :], (tx, ty, tt), (rx, ry, rt))
            tx, ty, tt = rx, ry, rt
            i += 3 * p
            o += stride


register(
    ExactBeam,
    predict=predict,
    assemble=assemble,
    inertia=inertia,
    rotate=rotate,
    constrain=constrain,
    pin=pin,
    factor=factor,
    solve=solve,
    ports=ports,
    damping_work=damping_work,
    energy=energy,
    link_poses=link_poses,
    out_of_range=out_of_range,
    shape=shape,
)
