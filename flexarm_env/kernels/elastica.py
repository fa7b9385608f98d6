"""The elastica's equations of motion, their tangent and what is read off its state (`flexarm_env.model.Elastica`).

With e_j = (cos phi_j, sin phi_j), second rate e_j'', the inertia force on node i is (-sin phi_i, cos phi_i) . A_i,
A_i = sum_j P_ij e_j'' + b_i (a_root - g) - loads: no sine of a difference is needed. Its derivative by node j is
(-sin phi_i, cos phi_i) . P_ij d e_j'', by node i itself also -e_i . A_i. The payload adds m_p w w' to P, m_p w to b and
J_p l(L) l(L)' to the last link's R.
"""

from __future__ import annotations

from ..model import Elastica
from .jit import kernel
from .lanes import load, sincos, splat, store
from .protocol import register, size
from .stack import stack
from .traced import aligned_frame
from .unroll import unrolled


@kernel
def _offsets(model):  # type: ignore[no-untyped-def]
    """Where R, K, b, w, tips and the single numbers begin in model.data; P begins at 0."""
    n = size(model.nodes)
    m = size(model.links) * n
    R = m * m
    b = R + 2 * m * n
    return R, R + m * n, b, b + m, b + 2 * m, b + 3 * m


@kernel
def _absolute(lane, model, q, x):  # type: ignore[no-untyped-def]
    """x <- angles of the nodes (or their rates) from the coordinates: a joint's is relative to the tip before it."""
    n = size(model.nodes)
    for i in range(n):
        store(x, i, load(lane, q, i))
    for k in range(1, size(model.links)):
        store(x, k * n, load(lane, q, k * n) + load(lane, q, k * n - 1))
        for i in range(k * n + 1, k * n + n):
            store(x, i, load(lane, q, i))


@kernel
def _frame_acceleration(lane, model, a):  # type: ignore[no-untyped-def]
    """Acceleration of the root less gravity."""
    x, y = splat(lane, 0.0), splat(lane, 0.0)
    if model.root is not None:
        m = size(model.links) * size(model.nodes)
        x, y = load(lane, a, m), load(lane, a, m + 1)
    if model.gravity is not None:
        o = _offsets(model)[5]
        x, y = x - model.data[o + 3], y - model.data[o + 4]
    return x, y


@kernel
def assemble(lane, model, par, q, v, a, u, cm, cc, ck, r, S):  # type: ignore[no-untyped-def]
    """r and, unless cm = 0, S = cm dr/da + cc dr/dv + ck dr/dq (row-major, model.n squared)."""
    aligned_frame(lane)
    y = stack(lane, model.scratch)
    c, s = stack(lane, model.scratch), stack(lane, model.scratch)
    ex, ey = stack(lane, model.scratch), stack(lane, model.scratch)
    fx, fy = stack(lane, model.scratch), stack(lane, model.scratch)
    _forces(lane, model, par, q, v, a, u, y, c, s, ex, ey, fx, fy, r)
    if cm != 0.0:
        _tangent(lane, model, par, y, c, s, ex, ey, fx, fy, cm, cc, ck, S)


@unrolled
@kernel
def _forces(lane, model, par, q, v, a, u, y, c, s, ex, ey, fx, fy, r):  # type: ignore[no-untyped-def]
    """r, and on the way: nodes' rates y, e_j = (c, s), e_j'' = (ex, ey), A_i = (fx, fy)."""
    D = model.data
    at_R, at_K, at_b, at_w, _, _ = _offsets(model)
    n, links = size(model.nodes), size(model.links)
    m = n * links
    payload, stiffness, tau_d = load(lane, par, 0), load(lane, par, 2), load(lane, par, 3)
    x, z = stack(lane, model.scratch), stack(lane, model.scratch)
    _absolute(lane, model, q, x)
    _absolute(lane, model, v, y)
    _absolute(lane, model, a, z)
    frame_x, frame_y = _frame_acceleration(lane, model, a)
    tip_x, tip_y = frame_x, frame_y
    for i in range(m):
        angle, rate, second = load(lane, x, i), load(lane, y, i), load(lane, z, i)
        sine, cosine = sincos(angle)
        square = rate * rate
        ax, ay = -(sine * second + cosine * square), cosine * second - sine * square
        tip_x, tip_y = tip_x + ax * D[at_w + i], tip_y + ay * D[at_w + i]
        store(c, i, cosine)
        store(s, i, sine)
        store(ex, i, ax)
        store(ey, i, ay)
        store(x, i, (angle + rate * tau_d) * stiffness)
    tip_x, tip_y = tip_x * payload, tip_y * payload
    for i in range(m):
        fxi, fyi = load(lane, ex, 0) * D[i * m], load(lane, ey, 0) * D[i * m]
        for j in range(1, m):
            fxi = fxi + load(lane, ex, j) * D[i * m + j]
            fyi = fyi + load(lane, ey, j) * D[i * m + j]
        if model.root is not None or model.gravity is not None:
            fxi, fyi = fxi + frame_x * D[at_b + i], fyi + frame_y * D[at_b + i]
        store(fx, i, fxi + tip_x * D[at_w + i])
        store(fy, i, fyi + tip_y * D[at_w + i])
    _less_forces(lane, model, model.loads, u, fx, fy)
    for k in range(links):
        for i in range(k * n, k * n + n):
            total = load(lane, z, k * n) * D[at_R + i * n]
            for j in range(1, n):
                total = total + load(lane, z, k * n + j) * D[at_R + i * n + j]
            for j in range(n):
                total = total + load(lane, x, k * n + j) * D[at_K + i * n + j]
            store(r, i, total + (load(lane, c, i) * load(lane, fy, i) - load(lane, s, i) * load(lane, fx, i)))
    _less_torques(lane, model, model.loads, u, r)
    _payload_turns(lane, model, load(lane, par, 1), z, r)
    _root_force(lane, model, payload, ex, ey, frame_x, frame_y, u, r)
    for k in range(links - 1, 0, -1):  # from angles to coordinates, see _to_relative
        store(r, k * n - 1, load(lane, r, k * n - 1) + load(lane, r, k * n))
    for k in range(links):
        store(r, k * n, load(lane, r, k * n) - load(lane, u, k))


@unrolled
@kernel
def _tangent(lane, model, par, y, c, s, ex, ey, fx, fy, cm, cc, ck, S):  # type: ignore[no-untyped-def]
    """The matrix of `assemble`; ex, ey become the weighted derivative of e''."""
    D = model.data
    at_R, at_K, _, at_w, _, _ = _offsets(model)
    n, links, rows = size(model.nodes), size(model.links), size(model.n)
    m = n * links
    payload = load(lane, par, 0)
    slope = load(lane, par, 2) * (load(lane, par, 3) * cc + ck)
    for i in range(m):
        cosine, sine, ax, ay = load(lane, c, i), load(lane, s, i), load(lane, ex, i), load(lane, ey, i)
        twice = load(lane, y, i) * (2.0 * cc)
        store(ex, i, -(sine * cm + cosine * twice + ay * ck))
        store(ey, i, cosine * cm - sine * twice + ax * ck)
    for i in range(m):
        share = payload * D[at_w + i]
        ci, si, dxi, dyi = load(lane, c, i), load(lane, s, i), load(lane, ex, i), load(lane, ey, i)
        k = i // n
        for j in range(i):
            p = share * D[at_w + j] + D[i * m + j]
            lower = p * (ci * load(lane, ey, j) - si * load(lane, ex, j))
            upper = p * (load(lane, c, j) * dyi - load(lane, s, j) * dxi)
            if j >= k * n:
                bend = slope * D[at_K + i * n + j - k * n] + cm * D[at_R + i * n + j - k * n]
                lower, upper = lower + bend, upper + bend
            store(S, i * rows + j, lower)
            store(S, j * rows + i, upper)
        p = share * D[at_w + i] + D[i * m + i]
        own = p * (ci * dyi - si * dxi) + (slope * D[at_K + i * n + i - k * n] + cm * D[at_R + i * n + i - k * n])
        store(S, i * rows + i, own - (ci * load(lane, fx, i) + si * load(lane, fy, i)) * ck)
    _payload_turns_tangent(lane, model, load(lane, par, 1), cm, S)
    _root_tangent(lane, model, payload, c, s, ex, ey, cm, S)
    _to_relative(lane, model, S)


@kernel
def _less_forces(lane, model, loads, u, fx, fy):  # type: ignore[no-untyped-def]
    """A_i <- A_i less the forces of the point loads times their arms."""
    if loads is not None:
        links = size(model.links)
        m = links * size(model.nodes)
        for f in range((size(model.n_inputs) - links) // 3):
            force_x, force_y = load(lane, u, links + 3 * f), load(lane, u, links + 3 * f + 1)
            for i in range(m):
                store(fx, i, load(lane, fx, i) - force_x * loads[2 * f * m + i])
                store(fy, i, load(lane, fy, i) - force_y * loads[2 * f * m + i])


@kernel
def _less_torques(lane, model, loads, u, r):  # type: ignore[no-untyped-def]
    """r_i <- r_i less the torques of the point loads."""
    if loads is not None:
        links = size(model.links)
        m = links * size(model.nodes)
        for f in range((size(model.n_inputs) - links) // 3):
            torque = load(lane, u, links + 3 * f + 2)
            for i in range(m):
                store(r, i, load(lane, r, i) - torque * loads[(2 * f + 1) * m + i])


@kernel
def _payload_turns(lane, model, inertia, z, r):  # type: ignore[no-untyped-def]
    """Rotary inertia of the payload, on the last link's angles."""
    D = model.data
    _, _, _, _, at_tips, _ = _offsets(model)
    if model.payload_turns is not None:
        n, m = size(model.nodes), size(model.links) * size(model.nodes)
        moment = splat(lane, 0.0)
        for j in range(m - n, m):
            moment = moment + load(lane, z, j) * D[at_tips + j]
        moment = moment * inertia
        for i in range(m - n, m):
            store(r, i, load(lane, r, i) + moment * D[at_tips + i])


@kernel
def _payload_turns_tangent(lane, model, inertia, cm, S):  # type: ignore[no-untyped-def]
    D = model.data
    _, _, _, _, at_tips, _ = _offsets(model)
    if model.payload_turns is not None:
        n, m, rows = size(model.nodes), size(model.links) * size(model.nodes), size(model.n)
        for i in range(m - n, m):
            share = inertia * (cm * D[at_tips + i])
            for j in range(m - n, m):
                store(S, i * rows + j, load(lane, S, i * rows + j) + share * D[at_tips + j])


@kernel
def _root_force(lane, model, payload, ex, ey, frame_x, frame_y, u, r):  # type: ignore[no-untyped-def]
    """Rate of the whole chain's momentum less gravity and loads: the rows of the root's position."""
    D = model.data
    _, _, at_b, at_w, _, at_one = _offsets(model)
    if model.root is not None:
        m = size(model.links) * size(model.nodes)
        mass = payload + D[at_one]
        total_x, total_y = mass * frame_x, mass * frame_y
        for j in range(m):
            moment = payload * D[at_w + j] + D[at_b + j]
            total_x = total_x + moment * load(lane, ex, j)
            total_y = total_y + moment * load(lane, ey, j)
        store(r, m, total_x)
        store(r, m + 1, total_y)
        _less_total(lane, model, model.loads, u, r)


@kernel
def _root_tangent(lane, model, payload, c, s, dx, dy, cm, S):  # type: ignore[no-untyped-def]
    D = model.data
    _, _, at_b, at_w, _, at_one = _offsets(model)
    if model.root is not None:
        m, rows = size(model.links) * size(model.nodes), size(model.n)
        for j in range(m):
            moment = payload * D[at_w + j] + D[at_b + j]
            store(S, m * rows + j, moment * load(lane, dx, j))
            store(S, (m + 1) * rows + j, moment * load(lane, dy, j))
            store(S, j * rows + m, moment * load(lane, s, j) * -cm)
            store(S, j * rows + m + 1, moment * load(lane, c, j) * cm)
        mass = (payload + D[at_one]) * cm
        store(S, m * rows + m, mass)
        store(S, m * rows + m + 1, splat(lane, 0.0))
        store(S, (m + 1) * rows + m, splat(lane, 0.0))
        store(S, (m + 1) * rows + m + 1, mass)


@kernel
def _less_total(lane, model, loads, u, r):  # type: ignore[no-untyped-def]
    """The root's rows less all forces."""
    if loads is not None:
        links = size(model.links)
        m = links * size(model.nodes)
        for f in range((size(model.n_inputs) - links) // 3):
            store(r, m, load(lane, r, m) - load(lane, u, links + 3 * f))
            store(r, m + 1, load(lane, r, m + 1) - load(lane, u, links + 3 * f + 1))


@kernel
def _to_relative(lane, model, S):  # type: ignore[no-untyped-def]
    """From the nodes' angles to the coordinates: what acts on a link's root acts on the tip before it as well."""
    n, rows = size(model.nodes), size(model.n)
    for k in range(size(model.links) - 1, 0, -1):
        for j in range(rows):
            o = j * rows + k * n
            store(S, o - 1, load(lane, S, o - 1) + load(lane, S, o))
        for j in range(rows):
            o = k * n * rows + j
            store(S, o - rows, load(lane, S, o - rows) + load(lane, S, o))


@kernel
def constrain(lane, model, psi, q, v, a, level, scale, r):  # type: ignore[no-untyped-def]
    """No constraint is left: joints are coordinates."""


@kernel
def pin(lane, model, S, k):  # type: ignore[no-untyped-def]
    """Row and column k <- those of the identity."""
    rows = size(model.n)
    for j in range(rows):
        store(S, k * rows + j, splat(lane, 0.0))
        store(S, j * rows + k, splat(lane, 0.0))
    store(S, k * rows + k, splat(lane, 1.0))


@unrolled
@kernel
def _factor(lane, model, S):  # type: ignore[no-untyped-def]
    """S <- L U without pivoting, the diagonal inverted: cm M, positive definite, outweighs the rest."""
    rows = size(model.n)
    for k in range(rows):
        inverse = 1.0 / load(lane, S, k * rows + k)
        store(S, k * rows + k, inverse)
        for i in range(k + 1, rows):
            f = load(lane, S, i * rows + k) * inverse
            store(S, i * rows + k, f)
            for j in range(k + 1, rows):
                store(S, i * rows + j, load(lane, S, i * rows + j) - f * load(lane, S, k * rows + j))


@unrolled
@kernel
def _solve(lane, model, S, x):  # type: ignore[no-untyped-def]
    """x <- S^-1 x with the factors of `_factor`."""
    rows = size(model.n)
    for i in range(1, rows):
        total = load(lane, x, i)
        for j in range(i):
            total = total - load(lane, S, i * rows + j) * load(lane, x, j)
        store(x, i, total)
    for i in range(rows - 1, -1, -1):
        total = load(lane, x, i)
        for j in range(i + 1, rows):
            total = total - load(lane, S, i * rows + j) * load(lane, x, j)
        store(x, i, total * load(lane, S, i * rows + i))


@kernel
def factor(lane, model, S):  # type: ignore[no-untyped-def]
    """See _factor."""
    aligned_frame(lane)
    _factor(lane, model, S)


@kernel
def solve(lane, model, S, x):  # type: ignore[no-untyped-def]
    """See _solve."""
    aligned_frame(lane)
    _solve(lane, model, S, x)


@kernel
def _tangents(lane, model, q, v, c, s, ex, ey):  # type: ignore[no-untyped-def]
    """(c, s) <- e_j, (ex, ey) <- e_j'; c, s, ex, ey hold angles and rates on the way."""
    _absolute(lane, model, q, c)
    _absolute(lane, model, v, ex)
    for i in range(size(model.links) * size(model.nodes)):
        sine, cosine = sincos(load(lane, c, i))
        rate = load(lane, ex, i)
        store(c, i, cosine)
        store(s, i, sine)
        store(ex, i, -(sine * rate))
        store(ey, i, cosine * rate)


@kernel
def _root(lane, model, q):  # type: ignore[no-untyped-def]
    """Position of the root."""
    D = model.data
    _, _, _, _, _, at_one = _offsets(model)
    if model.root is not None:
        m = size(model.links) * size(model.nodes)
        return load(lane, q, m), load(lane, q, m + 1)
    return splat(lane, D[at_one + 1]), splat(lane, D[at_one + 2])


@kernel
def _sum(lane, weights, first, x, m):  # type: ignore[no-untyped-def]
    """sum_j weights[first + j] x_j."""
    total = splat(lane, 0.0)
    for j in range(m):
        total = total + load(lane, x, j) * weights[first + j]
    return total


@kernel
def ports(lane, model, par, q, y):  # type: ignore[no-untyped-def]
    """Joint angles, then position and angle of the point of each load."""
    n, links = size(model.nodes), size(model.links)
    for k in range(links):
        store(y, k, load(lane, q, k * n))
    _load_ports(lane, model, model.loads, q, y)


@kernel
def _load_ports(lane, model, loads, q, y):  # type: ignore[no-untyped-def]
    """Position and angle of the point of each load."""
    if loads is not None:
        links = size(model.links)
        m = links * size(model.nodes)
        x, c, s = stack(lane, model.scratch), stack(lane, model.scratch), stack(lane, model.scratch)
        _absolute(lane, model, q, x)
        for i in range(m):
            sine, cosine = sincos(load(lane, x, i))
            store(c, i, cosine)
            store(s, i, sine)
        root_x, root_y = _root(lane, model, q)
        for f in range((size(model.n_inputs) - links) // 3):
            store(y, links + 3 * f, root_x + _sum(lane, loads, 2 * f * m, c, m))
            store(y, links + 3 * f + 1, root_y + _sum(lane, loads, 2 * f * m, s, m))
            store(y, links + 3 * f + 2, _sum(lane, loads, (2 * f + 1) * m, x, m))


@kernel
def _bending(lane, model, x):  # type: ignore[no-untyped-def]
    """x' K x over all links; x: angles or rates of the nodes. Differences from the root's keep spins exact."""
    D = model.data
    _, at_K, _, _, _, _ = _offsets(model)
    n = size(model.nodes)
    total = splat(lane, 0.0)
    for k in range(size(model.links)):
        start = load(lane, x, k * n)
        for i in range(1, n):
            row = splat(lane, 0.0)
            for j in range(1, n):
                row = row + (load(lane, x, k * n + j) - start) * D[at_K + (k * n + i) * n + j]
            total = total + row * (load(lane, x, k * n + i) - start)
    return total


@kernel
def dissipation(lane, model, par, q, v):  # type: ignore[no-untyped-def]
    """Power lost in Kelvin-Voigt damping, W."""
    y = stack(lane, model.scratch)
    _absolute(lane, model, v, y)
    return _bending(lane, model, y) * (load(lane, par, 2) * load(lane, par, 3))


@kernel
def energy(lane, model, par, q, v):  # type: ignore[no-untyped-def]
    """(kinetic, strain, gravity), J; gravity's is zero where the centre of mass is at the origin."""
    D = model.data
    at_R, _, at_b, at_w, at_tips, at_one = _offsets(model)
    n, links = size(model.nodes), size(model.links)
    m = n * links
    payload = load(lane, par, 0)
    x, y = stack(lane, model.scratch), stack(lane, model.scratch)
    c, s, ex, ey = (
        stack(lane, model.scratch),
        stack(lane, model.scratch),
        stack(lane, model.scratch),
        stack(lane, model.scratch),
    )
    _absolute(lane, model, q, x)
    _absolute(lane, model, v, y)
    _tangents(lane, model, q, v, c, s, ex, ey)
    strain = _bending(lane, model, x) * (load(lane, par, 2) * 0.5)
    tip_x, tip_y = _sum(lane, D, at_w, ex, m), _sum(lane, D, at_w, ey, m)
    turn = splat(lane, 0.0)
    for i in range(m - n, m):
        turn = turn + load(lane, y, i) * D[at_tips + i]
    twice = payload * (tip_x * tip_x + tip_y * tip_y) + load(lane, par, 1) * (turn * turn)
    for i in range(m):
        px, py, rate, spin = splat(lane, 0.0), splat(lane, 0.0), load(lane, y, i), splat(lane, 0.0)
        for j in range(n):
            spin = spin + load(lane, y, i // n * n + j) * D[at_R + i * n + j]
        for j in range(m):
            px = px + load(lane, ex, j) * D[i * m + j]
            py = py + load(lane, ey, j) * D[i * m + j]
        twice = twice + (load(lane, ex, i) * px + load(lane, ey, i) * py + rate * spin)
    mass = payload + D[at_one]
    if model.root is not None:
        vx, vy = load(lane, v, m), load(lane, v, m + 1)
        px = payload * tip_x + _sum(lane, D, at_b, ex, m)
        py = payload * tip_y + _sum(lane, D, at_b, ey, m)
        twice = twice + (mass * (vx * vx + vy * vy) + (vx * px + vy * py) * 2.0)
    return twice * 0.5, strain, _gravity_energy(lane, model, payload, q, c, s)


@kernel
def _gravity_energy(lane, model, payload, q, c, s):  # type: ignore[no-untyped-def]
    """- mass g . centre of mass."""
    D = model.data
    _, _, at_b, at_w, _, at_one = _offsets(model)
    if model.gravity is None:
        return splat(lane, 0.0)
    m = size(model.links) * size(model.nodes)
    mass = payload + D[at_one]
    root_x, root_y = _root(lane, model, q)
    cx = payload * _sum(lane, D, at_w, c, m) + _sum(lane, D, at_b, c, m) + mass * root_x
    cy = payload * _sum(lane, D, at_w, s, m) + _sum(lane, D, at_b, s, m) + mass * root_y
    return -(cx * D[at_one + 3] + cy * D[at_one + 4])


@kernel
def link_poses(lane, model, par, q, v, out):  # type: ignore[no-untyped-def]
    """12 numbers a link: root x, y, angle and their rates, tip x, y, angle and their rates."""
    D = model.data
    _, _, _, at_w, at_tips, _ = _offsets(model)
    n, links = size(model.nodes), size(model.links)
    m = n * links
    x, y = stack(lane, model.scratch), stack(lane, model.scratch)
    c, s, ex, ey = (
        stack(lane, model.scratch),
        stack(lane, model.scratch),
        stack(lane, model.scratch),
        stack(lane, model.scratch),
    )
    _absolute(lane, model, q, x)
    _absolute(lane, model, v, y)
    _tangents(lane, model, q, v, c, s, ex, ey)
    px, py = _root(lane, model, q)
    vx, vy = splat(lane, 0.0), splat(lane, 0.0)
    if model.root is not None:
        vx, vy = load(lane, v, m), load(lane, v, m + 1)
    for k in range(links):
        o = 12 * k
        store(out, o, px)
        store(out, o + 1, py)
        store(out, o + 2, load(lane, x, k * n))
        store(out, o + 3, vx)
        store(out, o + 4, vy)
        store(out, o + 5, load(lane, y, k * n))
        angle, rate = splat(lane, 0.0), splat(lane, 0.0)
        for i in range(k * n, k * n + n):
            px, py = px + load(lane, c, i) * D[at_w + i], py + load(lane, s, i) * D[at_w + i]
            vx, vy = vx + load(lane, ex, i) * D[at_w + i], vy + load(lane, ey, i) * D[at_w + i]
            angle, rate = angle + load(lane, x, i) * D[at_tips + i], rate + load(lane, y, i) * D[at_tips + i]
        store(out, o + 6, px)
        store(out, o + 7, py)
        store(out, o + 8, angle)
        store(out, o + 9, vx)
        store(out, o + 10, vy)
        store(out, o + 11, rate)


@kernel
def out_of_range(lane, model, par, q):  # type: ignore[no-untyped-def]
    """The geometry is exact: no deflection is too large."""
    return splat(lane, 0.0)


@kernel
def shape(model, q, points):  # type: ignore[no-untyped-def]
    """Positions along the chain, into the first rows of `points`; returns how many."""
    D = model.data
    _, _, _, _, _, at_one = _offsets(model)
    lane = (0,)
    m = size(model.links) * size(model.nodes)
    first = at_one + 5 + m * size(model.nodes)
    count = min((D.shape[0] - first) // m, points.shape[0])
    x = stack(lane, model.scratch)
    _absolute(lane, model, q, x)
    root_x, root_y = _root(lane, model, q)
    for p in range(count):
        points[p, 0], points[p, 1] = root_x, root_y
    for j in range(m):
        sine, cosine = sincos(x[j])
        for p in range(count):
            points[p, 0] += cosine * D[first + p * m + j]
            points[p, 1] += sine * D[first + p * m + j]
    return count


register(
    Elastica,
    assemble=assemble,
    constrain=constrain,
    pin=pin,
    factor=factor,
    solve=solve,
    ports=ports,
    dissipation=dissipation,
    energy=energy,
    link_poses=link_poses,
    out_of_range=out_of_range,
    shape=shape,
)
