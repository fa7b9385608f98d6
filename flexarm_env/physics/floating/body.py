"""One body of a chain of floating frames in lanes: inertia [57]-[63], elastic force, and what it hands on.

A body's frame stands at X, theta; its root section is turned by rho'p against the frame, its tip lies at t(p) in it.
Positions drop out (gravity is an acceleration of the frame), so that from root to tip a body hands on the section's
angle and the acceleration there, from tip to root the force and the moment that all behind it ask for. Their changes by
a change of what lies before are as few: three numbers each way (docs: theory, section 3).

E = [[0, -1], [1, 0]] turns a quarter; d/dt of R y is R (y' + w E y).
"""

from ...compiler import kernel, load, sincos, size, splat, store, unrolled
from ..arithmetic import pair, put_pair, put_vector, turned, turned_back, vector
from ..model import STIFFNESS_FACTOR, TAU_D
from .layout import KNOWN, NOW, PASSED, body_at, factors_at, span_at, strain_at, vectors_at, window


@kernel
def constants(model):
    """Where the fields of BODY begin in a body's block."""
    return body_at(0, size(model.n), len(model.window), len(model.elements), 0)


@kernel
def damping_time(lane, model, D, par):
    """tau_d of the body, s."""
    tau = load(lane, par, TAU_D)
    if model.damped is not None and len(model.damped) > 1:
        tau = tau * D[constants(model).damped]
    return tau


@kernel
def dot(lane, model, D, at, x):
    """sum_j D[at + j] x_j over the elastic coordinates."""
    total = load(lane, x, 0) * D[at]
    for j in range(1, size(model.n)):
        total = total + load(lane, x, j) * D[at + j]
    return total


@kernel
def along(lane, model, D, at, x):
    """`dot` with what shapes along the axis bring, which modes have none of (x + -0.0 is x to the last bit)."""
    if model.modal is not None:
        return splat(lane, -0.0)
    return dot(lane, model, D, at, x)


@kernel
def product(lane, model, D, at, x, y):
    """x'A y with the matrix at D[at:]."""
    n = size(model.n)
    total = load(lane, x, 0) * dot(lane, model, D, at, y)
    for i in range(1, n):
        total = total + load(lane, x, i) * dot(lane, model, D, at + i * n, y)
    return total


@kernel
def in_window(lane, model, D, at, x, first):
    """sum_j D[at + j] x_j over the coordinates of an element's window, which begins at `first`."""
    total = load(lane, x, first) * D[at]
    for j in range(1, len(model.window)):
        total = total + load(lane, x, first + j) * D[at + j]
    return total


@kernel
def tip(lane, model, D, x):
    """(u, v, phi)'x at the tip, without foreshortening."""
    own = constants(model)
    return along(lane, model, D, own.tip_u, x), dot(lane, model, D, own.tip_v, x), dot(lane, model, D, own.tip_phi, x)


@kernel
def turn_of_root(lane, model, D, x):
    """rho'x, by which the root section is turned against the frame."""
    if model.chord is None:
        return splat(lane, 0.0)
    return dot(lane, model, D, constants(model).root, x)


@unrolled
@kernel
def carry(lane, model, D, q, v, a, pose, S):
    """From the root section to the tip section: pose holds angle, rate, second rate and the acceleration less gravity.

    What the frame does now is kept in S (`NOW`).
    """
    own, now = constants(model), factors_at(0, size(model.n)).now
    angle, w, alpha = vector(lane, pose, PASSED.angle)
    if model.chord is not None:
        angle = angle - turn_of_root(lane, model, D, q)
        w = w - turn_of_root(lane, model, D, v)
        alpha = alpha - turn_of_root(lane, model, D, a)
    sine, cosine = sincos(angle)
    gx, gy = pair(lane, pose, PASSED.ax)
    ax, ay = turned_back(cosine, sine, gx, gy)
    x, y, phi = tip(lane, model, D, q)
    tx, ty, rate = tip(lane, model, D, v)
    hx, hy, second = tip(lane, model, D, a)
    x = x + D[own.length]
    if model.modal is not None:
        x = x - product(lane, model, D, own.tip_H, q, q) * 0.5
        tx = tx - product(lane, model, D, own.tip_H, q, v)
        hx = hx - (product(lane, model, D, own.tip_H, q, a) + product(lane, model, D, own.tip_H, v, v))
    bx = hx - alpha * y - (w * w) * x - (w * ty) * 2.0
    by = hy + alpha * x - (w * w) * y + (w * tx) * 2.0
    put_pair(S, now + NOW.cos, (cosine, sine))
    put_pair(S, now + NOW.a, (ax, ay))
    put_pair(S, now + NOW.rate, (w, alpha))
    put_pair(S, now + NOW.tip, (x, y))
    put_pair(S, now + NOW.tip_rate, (tx - w * y, ty + w * x))
    put_pair(S, now + NOW.tip_second, (bx, by))
    put_vector(pose, PASSED.angle, (angle + phi, w + rate, alpha + second))
    put_pair(pose, PASSED.ax, turned(cosine, sine, ax + bx, ay + by))


@kernel
def _strains(lane, model, D, stiffness, tau, q, v, strains):
    """Of each element: its axial force, then what its stretch and that one's rate change by with its coordinates.

    von Karman: g + H q and H v; the paper, whose force has no potential: G q and nothing.
    """
    n, wide = size(model.n), len(model.window)
    own = span_at(constants(model).spans, wide)
    kept = strain_at(0, wide)
    for e in range(len(model.elements)):
        first = window(model, n, e)
        linear, half, lost = splat(lane, 0.0), splat(lane, 0.0), splat(lane, 0.0)
        for i in range(wide):
            slope = in_window(lane, model, D, own.H + i * wide, q, first)
            x = load(lane, q, first + i)
            linear, half = linear + x * D[own.stretch + i], half + x * slope
            if model.full is None:
                store(strains, kept.slope + i, slope)
            else:
                slope = slope + D[own.stretch + i]
                lost = lost + load(lane, v, first + i) * slope
                store(strains, kept.slope + i, slope)
        force = linear * D[own.stiffness]
        if model.full is not None:
            force = (linear + half * 0.5) * D[own.stiffness]
            if model.damped is not None:
                force = force + (lost * tau) * D[own.stiffness]
                for i in range(wide):
                    store(strains, kept.rate + i, in_window(lane, model, D, own.H + i * wide, v, first))
        store(strains, kept.force, force)
        own, kept = span_at(own.end, wide), strain_at(kept.end, wide)


@unrolled
@kernel
def forces(lane, model, D, par, carried, q, v, a, force, known, vectors, strains, S, r):
    """The body's rows of the residual, inertia [61]-[63] and elastic forces [44], [45].

    force: in what lies behind asks for at the tip (x, y, moment), out what all from here on asks for at the root.
    carried: mass and inertia at the tip, kg and kg m^2, for drag alone. known, vectors, strains: kept for `tangent`.
    """
    own, n = constants(model), size(model.n)
    now, vec = factors_at(0, n).now, vectors_at(0, n)
    cos, sin = pair(lane, S, now + NOW.cos)
    ax, ay = pair(lane, S, now + NOW.a)
    w, alpha = pair(lane, S, now + NOW.rate)
    stiffness, tau = load(lane, par, STIFFNESS_FACTOR), damping_time(lane, model, D, par)
    fx, fy, moment = vector(lane, force, 0)
    gx, gy = turned_back(cos, sin, fx, fy)
    # s: first moment, t its rate, h its second rate in the frame
    sx, sy = along(lane, model, D, own.S_bar_x, q) + D[own.S0], dot(lane, model, D, own.S_bar_y, q)
    tx, ty = along(lane, model, D, own.S_bar_x, v), dot(lane, model, D, own.S_bar_y, v)
    hx, hy = along(lane, model, D, own.S_bar_x, a), dot(lane, model, D, own.S_bar_y, a)
    if model.modal is not None:
        sx = sx - product(lane, model, D, own.D0, q, q) * 0.5
        tx = tx - product(lane, model, D, own.D0, q, v)
        hx = hx - (product(lane, model, D, own.D0, q, a) + product(lane, model, D, own.D0, v, v))
    inertia, spin_rate, lever = splat(lane, D[own.I0]), splat(lane, 0.0), splat(lane, 0.0)
    for i in range(n):
        gq = dot(lane, model, D, own.G + i * n, q)
        if model.modal is None:
            inertia = inertia + (gq + 2.0 * D[own.c_u + i]) * load(lane, q, i)
            gq = gq + D[own.c_u + i]
        else:
            inertia = inertia + gq * load(lane, q, i)
        cb = along(lane, model, D, own.B + i * n, q) + D[own.c + i]
        spin_rate = spin_rate + gq * load(lane, v, i)
        lever = lever + cb * load(lane, a, i)
        store(vectors, vec.gq + i, gq)
        store(vectors, vec.cb + i, cb)
    square = w * w
    mass = D[own.mass]
    dx = hx - alpha * sy - square * sx - (w * ty) * 2.0
    dy = hy + alpha * sx - square * sy + (w * tx) * 2.0
    turning = (sx * ay - sy * ax) + alpha * inertia + lever + (w * spin_rate) * 2.0
    x, y = pair(lane, S, now + NOW.tip)
    turning = turning + (x * gy - y * gx) + moment
    _strains(lane, model, D, stiffness, tau, q, v, strains)
    for i in range(n):
        gsx, gsy, px = splat(lane, D[own.S_bar_x + i]), D[own.S_bar_y + i], splat(lane, D[own.tip_u + i])
        if model.modal is not None:
            gsx = gsx - dot(lane, model, D, own.D0 + i * n, q)
            px = px - dot(lane, model, D, own.tip_H + i * n, q)
        bv = along(lane, model, D, own.B + i * n, v)
        store(vectors, vec.bv + i, bv)
        store(vectors, vec.gsx + i, gsx)
        store(vectors, vec.px + i, px)
        gq, cb = load(lane, vectors, vec.gq + i), load(lane, vectors, vec.cb + i)
        elastic = dot(lane, model, D, own.K_bend + i * n, q)
        if model.curved is not None:
            elastic = elastic - D[own.moment + i]
        if model.damped is not None:
            elastic = elastic + dot(lane, model, D, own.K_bend + i * n, v) * tau
        elastic = elastic * stiffness
        if model.full is None:
            elastic = elastic + along(lane, model, D, own.K_axial + i * n, q)
            if model.damped is not None:
                elastic = elastic + along(lane, model, D, own.K_axial + i * n, v) * tau
        total = (gsx * ax + ay * gsy) + alpha * cb + dot(lane, model, D, own.M_ff + i * n, a)
        total = total - square * gq
        if model.modal is None:
            total = total + (w * bv) * 2.0
        total = total + elastic
        total = total + (px * gx + gy * D[own.tip_v + i]) + moment * D[own.tip_phi + i]
        if model.chord is not None:
            total = total - turning * D[own.root + i]
        store(r, i, total)
    wide = len(model.window)
    kept = strain_at(0, wide)
    for e in range(len(model.elements)):
        first = window(model, n, e)
        for i in range(wide):
            pull = load(lane, strains, kept.force) * load(lane, strains, kept.slope + i)
            store(r, first + i, load(lane, r, first + i) + pull)
        kept = strain_at(kept.end, wide)
    if model.drag is not None:
        _drag(lane, model, D, carried, v, vectors, r)
    store(force, 0, cos * (ax * mass + dx + gx) - sin * (ay * mass + dy + gy))
    store(force, 1, sin * (ax * mass + dx + gx) + cos * (ay * mass + dy + gy))
    store(force, 2, turning)
    put_pair(known, KNOWN.d, (dx, dy))
    put_pair(known, KNOWN.s, (sx, sy))
    put_pair(known, KNOWN.t, (tx, ty))
    put_pair(known, KNOWN.inertia, (inertia, spin_rate))
    put_pair(known, KNOWN.g, (gx, gy))


@kernel
def _drag(lane, model, D, carried, v, vectors, r):
    """Damping that goes with mass, on rates in the frame: the body's own and that of what it carries at its tip."""
    own, n, px = constants(model), size(model.n), vectors_at(0, size(model.n)).px
    mass, inertia = load(lane, carried, 0) * D[own.drag], load(lane, carried, 1) * D[own.drag]
    _, ty, turning = tip(lane, model, D, v)
    tx = splat(lane, 0.0)
    for i in range(n):
        tx = tx + load(lane, vectors, px + i) * load(lane, v, i)
    for i in range(n):
        total = dot(lane, model, D, own.M_ff + i * n, v) * D[own.drag]
        total = total + (load(lane, vectors, px + i) * tx + ty * D[own.tip_v + i]) * mass
        total = total + (turning * D[own.tip_phi + i]) * inertia
        store(r, i, load(lane, r, i) + total)
