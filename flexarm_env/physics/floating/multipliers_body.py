"""One floating-frame body: inertia [57]-[63], elastic force [44], [45], payload and tip forces, with their tangents.

A body's constants lie in one block of the Model's `data` (see `flexarm_env.model.FloatingFrame`). They may carry
foreshortening (`d0`, `tip_h`): then the elastic coordinates are bending modes, and the body has no elements.
"""

from __future__ import annotations

import numpy as np

from ...compiler.decorator import kernel
from ..model import VON_KARMAN
from .layout import ELEMENTS, OF_ELEMENT, SIZE, START, constants


@kernel
def quadratic(d, at, x, y, e, n):
    """x'A y with the matrix at d[at:], elastic coordinates from e."""
    total = 0.0
    for i in range(n):
        line = 0.0
        for j in range(n):
            line += d[at + i * n + j] * y[e + j]
        total += x[e + i] * line
    return total


@kernel
def line(d, at, i, y, e, n):
    total = 0.0
    for j in range(n):
        total += d[at + i * n + j] * y[e + j]
    return total


@kernel
def dot(d, at, y, e, n):
    total = 0.0
    for j in range(n):
        total += d[at + j] * y[e + j]
    return total


@kernel
def add_entry(S, half, i, j, x):
    S[i * (3 * half + 1) + j - i + half] += x


@kernel
def add_pair(S, half, cos, sin, k, j, x, y):
    """Add the body-frame vector (x, y), turned to global axes, to rows k, k+1 of column j."""
    add_entry(S, half, k, j, cos * x - sin * y)
    add_entry(S, half, k + 1, j, sin * x + cos * y)


@kernel
def add_pair_row(S, half, cos, sin, i, k, x, y):
    """The same for columns k, k+1 of row i."""
    add_entry(S, half, i, k, cos * x - sin * y)
    add_entry(S, half, i, k + 1, sin * x + cos * y)


@kernel
def tip_position(m, body, q):
    """Tip in the body frame: (s_x, s_y, phi)."""
    d, p, e, n = m.data, constants(m, body), m.table[body, START] + 3, m.table[body, SIZE]
    s_x = d[p.length] + dot(d, p.tip, q, e, n)
    if m.table[body, ELEMENTS] == 0:
        s_x -= 0.5 * quadratic(d, p.tip_H, q, q, e, n)
    return s_x, dot(d, p.tip + n, q, e, n), dot(d, p.tip + 2 * n, q, e, n)


@kernel
def lost_inertia(m, body, payload, q):
    """What a reduced body's inertia about its root has lost to foreshortening, kg m^2; a payload (kg) at its tip."""
    d, p, e, n = m.data, constants(m, body), m.table[body, START] + 3, m.table[body, SIZE]
    across = tip_position(m, body, q)[1]
    own = quadratic(d, p.G, q, q, e, n)
    return payload * (d[p.length] * quadratic(d, p.tip_H, q, q, e, n) - across * across) - own


@kernel
def tip_rate(m, body, q, v):
    """Rate of the tip in the body frame."""
    d, p, e, n = m.data, constants(m, body), m.table[body, START] + 3, m.table[body, SIZE]
    s_x = dot(d, p.tip, v, e, n)
    if m.table[body, ELEMENTS] == 0:
        s_x -= quadratic(d, p.tip_H, q, v, e, n)
    return s_x, dot(d, p.tip + n, v, e, n), dot(d, p.tip + 2 * n, v, e, n)


@kernel
def tip_gradient(m, body, q, j):
    """d(s_x, s_y)/dq_j at the tip."""
    p, n = constants(m, body), m.table[body, SIZE]
    x = m.data[p.tip + j]
    if m.table[body, ELEMENTS] == 0:
        x -= line(m.data, p.tip_H, j, q, m.table[body, START] + 3, n)
    return x, m.data[p.tip + n + j]


@kernel
def body_residual(m, par, body, q, v, a, cm, cc, ck, r, S):
    """Inertia [61]-[63], damping, elastic force [44] of one body, gravity as an acceleration of the frame."""
    d, at = m.data, m.table[body, START]
    e, n, half = at + 3, m.table[body, SIZE], m.half
    cos, sin = np.cos(q[at + 2]), np.sin(q[at + 2])
    gx, gy = a[at] - m.gravity[0], a[at + 1] - m.gravity[1]
    ax, ay = cos * gx + sin * gy, cos * gy - sin * gx  # a_R in the body frame
    w, alpha = v[at + 2], a[at + 2]
    p = constants(m, body)
    mass = d[p.mass]
    modal = m.table[body, ELEMENTS] == 0
    stiff, damp = par[2], par[3]

    # s = s_bar, t its rate, h = grad s q'' + second-order term
    sx, sy = d[p.S0] + dot(d, p.S_bar, q, e, n), dot(d, p.S_bar + n, q, e, n)
    tx, ty = dot(d, p.S_bar, v, e, n), dot(d, p.S_bar + n, v, e, n)
    hx, hy = dot(d, p.S_bar, a, e, n), dot(d, p.S_bar + n, a, e, n)
    if modal:
        sx -= 0.5 * quadratic(d, p.D0, q, q, e, n)
        tx -= quadratic(d, p.D0, q, v, e, n)
        hx -= quadratic(d, p.D0, q, a, e, n) + quadratic(d, p.D0, v, v, e, n)
    inertia, spin_rate, lever = d[p.I0], 0.0, 0.0  # I, (c_u + G q)'q', (c + B q)'q''
    for i in range(n):
        gq = line(d, p.G, i, q, e, n)
        inertia += (2.0 * d[p.c_u + i] + gq) * q[e + i]
        spin_rate += (d[p.c_u + i] + gq) * v[e + i]
        lever += (d[p.c + i] + line(d, p.B, i, q, e, n)) * a[e + i]

    fx = mass * ax - alpha * sy - w * w * sx - 2.0 * w * ty + hx
    fy = mass * ay + alpha * sx - w * w * sy + 2.0 * w * tx + hy
    r[at] += cos * fx - sin * fy
    r[at + 1] += sin * fx + cos * fy
    r[at + 2] += sx * ay - sy * ax + alpha * inertia + lever + 2.0 * w * spin_rate
    if cm != 0.0:
        add_entry(S, half, at, at, cm * mass)
        add_entry(S, half, at + 1, at + 1, cm * mass)
        # column theta: through acceleration, rate and angle
        dx, dy = fx - mass * ax, fy - mass * ay
        add_pair(
            S, half, cos, sin, at, at + 2,
            -cm * sy - cc * (2.0 * w * sx + 2.0 * ty) - ck * dy,
            cm * sx - cc * (2.0 * w * sy - 2.0 * tx) + ck * dx,
        )  # fmt: skip
        add_entry(S, half, at + 2, at + 2, cm * inertia + cc * 2.0 * spin_rate - ck * (sx * ax + sy * ay))
        add_pair_row(S, half, cos, sin, at + 2, at, -cm * sy, cm * sx)

    for i in range(n):
        gs_x, gs_y = d[p.S_bar + i], d[p.S_bar + n + i]
        if modal:
            gs_x -= line(d, p.D0, i, q, e, n)
        gq, cb = d[p.c_u + i] + line(d, p.G, i, q, e, n), d[p.c + i] + line(d, p.B, i, q, e, n)
        bv = line(d, p.B, i, v, e, n)
        mv = 0.0 if m.mass_damping == 0.0 else m.mass_damping * line(d, p.M_ff, i, v, e, n)
        elastic = line(d, p.K_axial, i, q, e, n) + stiff * line(d, p.K_bend, i, q, e, n)
        if damp != 0.0:
            elastic += damp * (line(d, p.K_axial, i, v, e, n) + stiff * line(d, p.K_bend, i, v, e, n))
        r[e + i] += (
            gs_x * ax + gs_y * ay + alpha * cb + line(d, p.M_ff, i, a, e, n) - w * w * gq + 2.0 * w * bv + elastic + mv
        )
        if cm != 0.0:
            dv, da = 0.0, 0.0  # d(rate of grad s)/dq terms of foreshortening
            if modal:
                dv, da = line(d, p.D0, i, v, e, n), line(d, p.D0, i, a, e, n)
            add_pair(
                S, half, cos, sin, at, e + i,
                cm * gs_x - cc * (2.0 * w * gs_y + 2.0 * dv) - ck * (alpha * gs_y + w * w * gs_x + da),
                cm * gs_y + cc * 2.0 * w * gs_x + ck * (alpha * gs_x - w * w * gs_y - 2.0 * w * dv),
            )  # fmt: skip
            ba = 0.0  # (B'q'')_i
            for j in range(n):
                ba += d[p.B + j * n + i] * a[e + j]
            gv = line(d, p.G, i, v, e, n)
            entry = cm * cb + cc * 2.0 * w * gq
            entry += ck * (gs_x * ay - gs_y * ax + 2.0 * alpha * gq + ba + 2.0 * w * gv)
            add_entry(S, half, at + 2, e + i, entry)
            add_pair_row(S, half, cos, sin, e + i, at, cm * gs_x, cm * gs_y)
            add_entry(S, half, e + i, at + 2, cm * cb + cc * 2.0 * (bv - w * gq) + ck * (gs_x * ay - gs_y * ax))
            inert = cm + cc * m.mass_damping
            linear = ck + cc * damp
            row = (e + i) * (3 * half + 1) - i + half
            for j in range(n):
                x = inert * d[p.M_ff + i * n + j] - ck * w * w * d[p.G + i * n + j]
                x += (2.0 * w * cc + alpha * ck) * d[p.B + i * n + j]
                x += linear * (d[p.K_axial + i * n + j] + stiff * d[p.K_bend + i * n + j])
                if modal:
                    x -= ck * ax * d[p.D0 + i * n + j]
                S[row + j] += x


@kernel
def element_places(m, body, element):
    """Row of u of an element's first node (its v, phi and the second node's follow; the clamped root has none), and
    where in `data` its EA / l and its G are."""
    first = m.table[body, START] + 3 * element
    own = constants(m, body).elements + OF_ELEMENT.end * element
    return first, own + OF_ELEMENT.stiffness, own + OF_ELEMENT.G


@kernel
def bending(x, first, inner):
    """v, phi of both nodes of an element; inner: its first node is not the clamped root."""
    if inner:
        return x[first + 1], x[first + 2], x[first + 4], x[first + 5]
    return 0.0, 0.0, x[first + 4], x[first + 5]


@kernel
def times(d, g, w):
    """G w, four numbers; G (4, 4) at d[g:]."""
    return (
        d[g] * w[0] + d[g + 1] * w[1] + d[g + 2] * w[2] + d[g + 3] * w[3],
        d[g + 4] * w[0] + d[g + 5] * w[1] + d[g + 6] * w[2] + d[g + 7] * w[3],
        d[g + 8] * w[0] + d[g + 9] * w[1] + d[g + 10] * w[2] + d[g + 11] * w[3],
        d[g + 12] * w[0] + d[g + 13] * w[1] + d[g + 14] * w[2] + d[g + 15] * w[3],
    )


@kernel
def along(x, y):
    return x[0] * y[0] + x[1] * y[1] + x[2] * y[2] + x[3] * y[3]


@kernel
def coupling_force(m, body, damp, q, v, cm, cc, ck, r, S):
    """Axial-bending coupling of each element: P G w [45], and with von Karman's stretch e = u2 - u1 + w'Gw / 2 what its
    energy EA e^2 / 2l and its dissipation EA damp e'^2 / 2l (theory, eqs. 1.2, 1.3) add to the linear axial forces."""
    d, half = m.data, m.half
    full = m.coupling == VON_KARMAN
    for element in range(m.table[body, ELEMENTS]):
        first, stiffness, g = element_places(m, body, element)
        inner, ea = element > 0, d[stiffness]
        w, rate = bending(q, first, inner), bending(v, first, inner)
        gw, grate = times(d, g, w), times(d, g, rate)
        force = ea * (q[first + 3] - (q[first] if inner else 0.0))  # axial force P
        both, lag = ck, 0.0  # weights of a change of Gw: by position and rate, and of a change of Gw'
        if full:
            shortening, lost = 0.5 * along(w, gw), along(w, grate)  # and its rate
            extra = ea * (shortening + damp * lost)
            force += extra + damp * ea * (v[first + 3] - (v[first] if inner else 0.0))
            r[first + 3] += extra
            if inner:
                r[first] -= extra
            both, lag = ck + cc * damp, ck * damp
        for i in range(0 if inner else 2, 4):
            row = first + 1 + i + i // 2
            r[row] += force * gw[i]
            if cm != 0.0:
                add_entry(S, half, row, first + 3, both * ea * gw[i])
                if inner:
                    add_entry(S, half, row, first, -both * ea * gw[i])
                if full:
                    turned = ea * (both * gw[i] + lag * grate[i])
                    add_entry(S, half, first + 3, row, turned)
                    if inner:
                        add_entry(S, half, first, row, -turned)
                for j in range(0 if inner else 2, 4):
                    x = ck * force * d[g + 4 * i + j]
                    if full:
                        x += ea * gw[i] * (both * gw[j] + lag * grate[j])
                    add_entry(S, half, row, first + 1 + j + j // 2, x)


@kernel
def payload_residual(m, body, mass, inertia, q, v, a, cm, cc, ck, r, S):
    """A point mass and inertia at a body's tip, exactly."""
    p = constants(m, body)
    at = m.table[body, START]
    e, n, half = at + 3, m.table[body, SIZE], m.half
    cos, sin = np.cos(q[at + 2]), np.sin(q[at + 2])
    gx, gy = a[at] - m.gravity[0], a[at + 1] - m.gravity[1]
    ax, ay = cos * gx + sin * gy, cos * gy - sin * gx
    w, alpha = v[at + 2], a[at + 2]
    sx, sy, _ = tip_position(m, body, q)
    tx, ty, _ = tip_rate(m, body, q, v)
    hx, hy, turn = tip_rate(m, body, q, a)
    modal = m.table[body, ELEMENTS] == 0
    if modal:
        hx -= quadratic(m.data, p.tip_H, v, v, e, n)
    turn += alpha
    bx = -alpha * sy - w * w * sx - 2.0 * w * ty + hx
    by = alpha * sx - w * w * sy + 2.0 * w * tx + hy
    fx, fy = mass * (ax + bx), mass * (ay + by)
    r[at] += cos * fx - sin * fy
    r[at + 1] += sin * fx + cos * fy
    r[at + 2] += sx * fy - sy * fx + inertia * turn
    for i in range(n):
        x, y = tip_gradient(m, body, q, i)
        r[e + i] += x * fx + y * fy + inertia * m.data[p.tip + 2 * n + i] * turn
    if cm == 0.0:
        return
    for j in range(3 + n):  # column by column: how the tip's acceleration (mass times) and the lever arms change
        dx, dy, px, py, spin = 0.0, 0.0, 0.0, 0.0, 0.0
        if j == 0:
            dx, dy = cm * cos, -cm * sin
        elif j == 1:
            dx, dy = cm * sin, cm * cos
        elif j == 2:
            dx = -cm * sy - cc * (2.0 * w * sx + 2.0 * ty) + ck * ay
            dy = cm * sx - cc * (2.0 * w * sy - 2.0 * tx) - ck * ax
            spin = cm
        else:
            px, py = tip_gradient(m, body, q, j - 3)
            dv, da = 0.0, 0.0
            if modal:
                dv = line(m.data, p.tip_H, j - 3, v, e, n)
                da = line(m.data, p.tip_H, j - 3, a, e, n)
            dx = cm * px - cc * (2.0 * w * py + 2.0 * dv) - ck * (alpha * py + w * w * px + da)
            dy = cm * py + cc * 2.0 * w * px + ck * (alpha * px - w * w * py - 2.0 * w * dv)
            spin = cm * m.data[p.tip + 2 * n + j - 3]
        dx *= mass
        dy *= mass
        if j == 2:  # the force turns with the frame
            add_pair(S, half, cos, sin, at, at + j, dx - ck * fy, dy + ck * fx)
        else:
            add_pair(S, half, cos, sin, at, at + j, dx, dy)
        add_entry(S, half, at + 2, at + j, sx * dy - sy * dx + ck * (px * fy - py * fx) + inertia * spin)
        for i in range(n):
            x, y = tip_gradient(m, body, q, i)
            entry = x * dx + y * dy + inertia * m.data[p.tip + 2 * n + i] * spin
            if modal and j >= 3:
                entry -= ck * fx * m.data[p.tip_H + i * n + j - 3]
            add_entry(S, half, e + i, at + j, entry)


@kernel
def payload_drag(m, body, mass, inertia, q, v, cm, cc, ck, r, S):
    """The payload's share of damping that goes with mass: drag on how it moves in the body's frame."""
    p = constants(m, body)
    e, n, half = m.table[body, START] + 3, m.table[body, SIZE], m.half
    mass, inertia = m.mass_damping * mass, m.mass_damping * inertia
    tx, ty, turn = tip_rate(m, body, q, v)
    modal = m.table[body, ELEMENTS] == 0
    for i in range(n):
        x, y = tip_gradient(m, body, q, i)
        phi = m.data[p.tip + 2 * n + i]
        r[e + i] += mass * (x * tx + y * ty) + inertia * phi * turn
        if cm != 0.0:
            for j in range(n):
                px, py = tip_gradient(m, body, q, j)
                entry = cc * (mass * (x * px + y * py) + inertia * phi * m.data[p.tip + 2 * n + j])
                if modal:
                    entry -= ck * mass * (x * line(m.data, p.tip_H, j, v, e, n) + tx * m.data[p.tip_H + i * n + j])
                add_entry(S, half, e + i, e + j, entry)


@kernel
def tip_force(m, body, fx, fy, moment, q, cm, ck, r, S):
    """Residual -= what a global force and a moment do at a body's tip; tangent with its curvature."""
    p = constants(m, body)
    at = m.table[body, START]
    e, n, half = at + 3, m.table[body, SIZE], m.half
    cos, sin = np.cos(q[at + 2]), np.sin(q[at + 2])
    lx, ly = cos * fx + sin * fy, cos * fy - sin * fx
    sx, sy, _ = tip_position(m, body, q)
    r[at] -= fx
    r[at + 1] -= fy
    r[at + 2] -= sx * ly - sy * lx + moment
    for i in range(n):
        x, y = tip_gradient(m, body, q, i)
        r[e + i] -= x * lx + y * ly + m.data[p.tip + 2 * n + i] * moment
        if cm != 0.0:
            turned = ck * (x * ly - y * lx)
            add_entry(S, half, e + i, at + 2, -turned)
            add_entry(S, half, at + 2, e + i, -turned)
            if m.table[body, ELEMENTS] == 0:
                for j in range(n):
                    add_entry(S, half, e + i, e + j, ck * lx * m.data[p.tip_H + i * n + j])
    if cm != 0.0:
        add_entry(S, half, at + 2, at + 2, ck * (sx * lx + sy * ly))
