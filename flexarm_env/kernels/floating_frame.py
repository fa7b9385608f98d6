"""Floating-frame bodies joined by multipliers: residual and tangent, eqs. [57]-[65] and docs/theory.md section 2.

Body coordinates (R_x, R_y, theta, q); the system is ordered body 0, multipliers of joint 0-1, body 1, ... so
that it stays banded. A body's inertia constants may carry foreshortening (`d0`, `tip_h`): then q are bending modes.
"""

from __future__ import annotations

import numpy as np

from ..model import (
    ANGLE,
    B_SKEW,
    BLOCK,
    C_THETA,
    C_U,
    D0,
    DIVERGED,
    ELEMENTS,
    G,
    HEAD,
    I0,
    K_AXIAL,
    K_BEND,
    LENGTH,
    LINEAR,
    LINK,
    M_FF,
    MASS,
    OFFSET,
    OK,
    OUT_OF_RANGE,
    ROWS,
    S0,
    S_BAR,
    SIZE,
    START,
    TIP,
    TIP_H,
    VON_KARMAN,
    FloatingFrame,
)
from .jit import kernel
from .linalg import band_lu, band_lu_solve
from .protocol import register

@kernel
def _row(m, body):  # type: ignore[no-untyped-def]
    """First row of the multipliers after a body."""
    return m.start[body] + 3 + m.size[body]


@kernel
def _quadratic(matrix, x, y, at, n):  # type: ignore[no-untyped-def]
    total = 0.0
    for i in range(n):
        line = 0.0
        for j in range(n):
            line += matrix[i, j] * y[at + j]
        total += x[at + i] * line
    return total


@kernel
def _line(matrix, i, y, at, n):  # type: ignore[no-untyped-def]
    total = 0.0
    for j in range(n):
        total += matrix[i, j] * y[at + j]
    return total


@kernel
def _dot(row, y, at, n):  # type: ignore[no-untyped-def]
    total = 0.0
    for j in range(n):
        total += row[j] * y[at + j]
    return total


@kernel
def _add(S, half, i, j, x):  # type: ignore[no-untyped-def]
    S[i * (3 * half + 1) + j - i + half] += x


@kernel
def _add_pair(S, half, cos, sin, k, j, x, y):  # type: ignore[no-untyped-def]
    """Add the body-frame vector (x, y), turned to global axes, to rows k, k+1 of column j."""
    _add(S, half, k, j, cos * x - sin * y)
    _add(S, half, k + 1, j, sin * x + cos * y)


@kernel
def _add_pair_row(S, half, cos, sin, i, k, x, y):  # type: ignore[no-untyped-def]
    """The same for columns k, k+1 of row i."""
    _add(S, half, i, k, cos * x - sin * y)
    _add(S, half, i, k + 1, sin * x + cos * y)


@kernel
def _tip(m, body, q):  # type: ignore[no-untyped-def]
    """Tip in the body frame: (s_x, s_y, phi)."""
    at, n = m.start[body] + 3, m.size[body]
    tip = m.tip[body]
    s_x = m.length[body] + _dot(tip[0], q, at, n)
    if m.elements[body] == 0:
        s_x -= 0.5 * _quadratic(m.tip_h[body], q, q, at, n)
    return s_x, _dot(tip[1], q, at, n), _dot(tip[2], q, at, n)


@kernel
def _tip_rate(m, body, q, v):  # type: ignore[no-untyped-def]
    """Rate of the tip in the body frame."""
    at, n = m.start[body] + 3, m.size[body]
    tip = m.tip[body]
    s_x = _dot(tip[0], v, at, n)
    if m.elements[body] == 0:
        s_x -= _quadratic(m.tip_h[body], q, v, at, n)
    return s_x, _dot(tip[1], v, at, n), _dot(tip[2], v, at, n)


@kernel
def _tip_gradient(m, body, q, j):  # type: ignore[no-untyped-def]
    """d(s_x, s_y)/dq_j at the tip."""
    x = m.tip[body, 0, j]
    if m.elements[body] == 0:
        x -= _line(m.tip_h[body], j, q, m.start[body] + 3, m.size[body])
    return x, m.tip[body, 1, j]


@kernel
def _body(m, par, body, q, v, a, cm, cc, ck, r, S):  # type: ignore[no-untyped-def]
    """Inertia [61]-[63], damping, elastic force [44] of one body, gravity as an acceleration of the frame."""
    at = m.start[body]
    e, n, half = at + 3, m.size[body], m.half
    cos, sin = np.cos(q[at + 2]), np.sin(q[at + 2])
    gx, gy = a[at] - m.gravity[0], a[at + 1] - m.gravity[1]
    ax, ay = cos * gx + sin * gy, cos * gy - sin * gx  # a_R in the body frame
    w, alpha = v[at + 2], a[at + 2]
    s_bar, d0, g, b, m_ff = m.s_bar[body], m.d0[body], m.g[body], m.b[body], m.m_ff[body]
    k_axial, k_bend, c_u, c = m.k_axial[body], m.k_bend[body], m.c_u[body], m.c[body]
    modal = m.elements[body] == 0
    stiff, damp = par[2], par[3]

    # s = s_bar, t its rate, h = grad s q'' + second-order term
    sx, sy = m.s0[body] + _dot(s_bar[0], q, e, n), _dot(s_bar[1], q, e, n)
    tx, ty = _dot(s_bar[0], v, e, n), _dot(s_bar[1], v, e, n)
    hx, hy = _dot(s_bar[0], a, e, n), _dot(s_bar[1], a, e, n)
    if modal:
        sx -= 0.5 * _quadratic(d0, q, q, e, n)
        tx -= _quadratic(d0, q, v, e, n)
        hx -= _quadratic(d0, q, a, e, n) + _quadratic(d0, v, v, e, n)
    inertia, spin_rate, lever = m.i0[body], 0.0, 0.0  # I, (c_u + G q)'q', (c + B q)'q''
    for i in range(n):
        gq = _line(g, i, q, e, n)
        inertia += (2.0 * c_u[i] + gq) * q[e + i]
        spin_rate += (c_u[i] + gq) * v[e + i]
        lever += (c[i] + _line(b, i, q, e, n)) * a[e + i]

    fx = m.mass[body] * ax - alpha * sy - w * w * sx - 2.0 * w * ty + hx
    fy = m.mass[body] * ay + alpha * sx - w * w * sy + 2.0 * w * tx + hy
    r[at] += cos * fx - sin * fy
    r[at + 1] += sin * fx + cos * fy
    r[at + 2] += sx * ay - sy * ax + alpha * inertia + lever + 2.0 * w * spin_rate
    if S is not None:
        _add(S, half, at, at, cm * m.mass[body])
        _add(S, half, at + 1, at + 1, cm * m.mass[body])
        # column theta: through acceleration, rate and angle
        dx, dy = fx - m.mass[body] * ax, fy - m.mass[body] * ay
        _add_pair(
            S, half, cos, sin, at, at + 2,
            -cm * sy - cc * (2.0 * w * sx + 2.0 * ty) - ck * dy,
            cm * sx - cc * (2.0 * w * sy - 2.0 * tx) + ck * dx,
        )  # fmt: skip
        _add(S, half, at + 2, at + 2, cm * inertia + cc * 2.0 * spin_rate - ck * (sx * ax + sy * ay))
        _add_pair_row(S, half, cos, sin, at + 2, at, -cm * sy, cm * sx)

    for i in range(n):
        gs_x, gs_y = s_bar[0, i], s_bar[1, i]
        if modal:
            gs_x -= _line(d0, i, q, e, n)
        gq, cb, bv = c_u[i] + _line(g, i, q, e, n), c[i] + _line(b, i, q, e, n), _line(b, i, v, e, n)
        mv = 0.0 if m.mass_damping == 0.0 else m.mass_damping * _line(m_ff, i, v, e, n)
        elastic = _line(k_axial, i, q, e, n) + stiff * _line(k_bend, i, q, e, n)
        if damp != 0.0:
            elastic += damp * (_line(k_axial, i, v, e, n) + stiff * _line(k_bend, i, v, e, n))
        r[e + i] += (
            gs_x * ax + gs_y * ay + alpha * cb + _line(m_ff, i, a, e, n) - w * w * gq + 2.0 * w * bv + elastic + mv
        )
        if S is not None:
            p, k = 0.0, 0.0  # d(rate of grad s)/dq terms of foreshortening
            if modal:
                p, k = _line(d0, i, v, e, n), _line(d0, i, a, e, n)
            _add_pair(
                S, half, cos, sin, at, e + i,
                cm * gs_x - cc * (2.0 * w * gs_y + 2.0 * p) - ck * (alpha * gs_y + w * w * gs_x + k),
                cm * gs_y + cc * 2.0 * w * gs_x + ck * (alpha * gs_x - w * w * gs_y - 2.0 * w * p),
            )  # fmt: skip
            ba = 0.0  # (B'q'')_i
            for j in range(n):
                ba += b[j, i] * a[e + j]
            _add(S, half, at + 2, e + i,
                 cm * cb + cc * 2.0 * w * gq
                 + ck * (gs_x * ay - gs_y * ax + 2.0 * alpha * gq + ba + 2.0 * w * _line(g, i, v, e, n)))  # fmt: skip
            _add_pair_row(S, half, cos, sin, e + i, at, cm * gs_x, cm * gs_y)
            _add(S, half, e + i, at + 2, cm * cb + cc * 2.0 * (bv - w * gq) + ck * (gs_x * ay - gs_y * ax))
            inert = cm + cc * m.mass_damping
            linear = ck + cc * damp
            row = (e + i) * (3 * half + 1) - i + half
            for j in range(n):
                x = inert * m_ff[i, j] + (2.0 * w * cc + alpha * ck) * b[i, j] - ck * w * w * g[i, j]
                x += linear * (k_axial[i, j] + stiff * k_bend[i, j])
                if modal:
                    x -= ck * ax * d0[i, j]
                S[row + j] += x


@kernel
def _coupling(m, body, q, ck, r, S):  # type: ignore[no-untyped-def]
    """Axial-bending coupling of each element: P G w [45], and with it the foreshortening in von Karman's energy."""
    e, half = m.start[body] + 3, m.half
    full = m.coupling == VON_KARMAN
    for element in range(m.elements[body]):
        first = e + 3 * (element - 1)  # rows of the element's first node; the clamped root has none
        g, ea = m.element_g[body, element], m.element_ea[body, element]
        stretch = q[first + 3] - (q[first] if element > 0 else 0.0)
        w0 = q[first + 1] if element > 0 else 0.0
        w1 = q[first + 2] if element > 0 else 0.0
        w2, w3 = q[first + 4], q[first + 5]
        wgw = 0.0
        for i in range(4):
            gw = g[i, 0] * w0 + g[i, 1] * w1 + g[i, 2] * w2 + g[i, 3] * w3
            wgw += gw * (w0 if i == 0 else w1 if i == 1 else w2 if i == 2 else w3)
        force = ea * (stretch + (0.5 * wgw if full else 0.0))  # axial force P
        if full:
            r[first + 3] += 0.5 * ea * wgw
            if element > 0:
                r[first] -= 0.5 * ea * wgw
        low = 0 if element > 0 else 2
        for i in range(low, 4):
            row = first + 1 + i + (i // 2)
            gw = g[i, 0] * w0 + g[i, 1] * w1 + g[i, 2] * w2 + g[i, 3] * w3
            r[row] += force * gw
            if S is not None:
                _add(S, half, row, first + 3, ck * ea * gw)
                if element > 0:
                    _add(S, half, row, first, -ck * ea * gw)
                if full:
                    _add(S, half, first + 3, row, ck * ea * gw)
                    if element > 0:
                        _add(S, half, first, row, -ck * ea * gw)
                for j in range(low, 4):
                    x = force * g[i, j]
                    if full:
                        x += ea * gw * (g[j, 0] * w0 + g[j, 1] * w1 + g[j, 2] * w2 + g[j, 3] * w3)
                    _add(S, half, row, first + 1 + j + (j // 2), ck * x)


@kernel
def _payload(m, body, mass, inertia, q, v, a, cm, cc, ck, r, S):  # type: ignore[no-untyped-def]
    """A point mass and inertia at a body's tip, exactly."""
    at = m.start[body]
    e, n, half = at + 3, m.size[body], m.half
    cos, sin = np.cos(q[at + 2]), np.sin(q[at + 2])
    gx, gy = a[at] - m.gravity[0], a[at + 1] - m.gravity[1]
    ax, ay = cos * gx + sin * gy, cos * gy - sin * gx
    w, alpha = v[at + 2], a[at + 2]
    sx, sy, _ = _tip(m, body, q)
    tx, ty, _ = _tip_rate(m, body, q, v)
    hx, hy, turn = _tip_rate(m, body, q, a)
    modal = m.elements[body] == 0
    if modal:
        hx -= _quadratic(m.tip_h[body], v, v, e, n)
    turn += alpha
    bx = -alpha * sy - w * w * sx - 2.0 * w * ty + hx
    by = alpha * sx - w * w * sy + 2.0 * w * tx + hy
    fx, fy = mass * (ax + bx), mass * (ay + by)
    r[at] += cos * fx - sin * fy
    r[at + 1] += sin * fx + cos * fy
    r[at + 2] += sx * fy - sy * fx + inertia * turn
    for i in range(n):
        x, y = _tip_gradient(m, body, q, i)
        r[e + i] += x * fx + y * fy + inertia * m.tip[body, 2, i] * turn
    if S is None:
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
            px, py = _tip_gradient(m, body, q, j - 3)
            p, k = 0.0, 0.0
            if modal:
                p, k = _line(m.tip_h[body], j - 3, v, e, n), _line(m.tip_h[body], j - 3, a, e, n)
            dx = cm * px - cc * (2.0 * w * py + 2.0 * p) - ck * (alpha * py + w * w * px + k)
            dy = cm * py + cc * 2.0 * w * px + ck * (alpha * px - w * w * py - 2.0 * w * p)
            spin = cm * m.tip[body, 2, j - 3]
        dx *= mass
        dy *= mass
        if j == 2:  # the force turns with the frame
            _add_pair(S, half, cos, sin, at, at + j, dx - ck * fy, dy + ck * fx)
        else:
            _add_pair(S, half, cos, sin, at, at + j, dx, dy)
        _add(S, half, at + 2, at + j, sx * dy - sy * dx + ck * (px * fy - py * fx) + inertia * spin)
        for i in range(n):
            x, y = _tip_gradient(m, body, q, i)
            entry = x * dx + y * dy + inertia * m.tip[body, 2, i] * spin
            if modal and j >= 3:
                entry -= ck * fx * m.tip_h[body, i, j - 3]
            _add(S, half, e + i, at + j, entry)


@kernel
def _tip_force(m, body, fx, fy, moment, q, ck, r, S):  # type: ignore[no-untyped-def]
    """Residual -= what a global force and a moment do at a body's tip; tangent with its curvature."""
    at = m.start[body]
    e, n, half = at + 3, m.size[body], m.half
    cos, sin = np.cos(q[at + 2]), np.sin(q[at + 2])
    lx, ly = cos * fx + sin * fy, cos * fy - sin * fx
    sx, sy, _ = _tip(m, body, q)
    r[at] -= fx
    r[at + 1] -= fy
    r[at + 2] -= sx * ly - sy * lx + moment
    for i in range(n):
        x, y = _tip_gradient(m, body, q, i)
        r[e + i] -= x * lx + y * ly + m.tip[body, 2, i] * moment
        if S is not None:
            turned = ck * (x * ly - y * lx)
            _add(S, half, e + i, at + 2, -turned)
            _add(S, half, at + 2, e + i, -turned)
            if m.elements[body] == 0:
                for j in range(n):
                    _add(S, half, e + i, e + j, ck * lx * m.tip_h[body, i, j])
    if S is not None:
        _add(S, half, at + 2, at + 2, ck * (sx * lx + sy * ly))


@kernel
def _joint_columns(m, body, q, scale, S):  # type: ignore[no-untyped-def]
    """Phi_q and its transpose for the joint between a body's tip and the next body, both times `scale`."""
    at, lam, nxt, half = m.start[body], _row(m, body), m.start[body + 1], m.half
    e, n = at + 3, m.size[body]
    cos, sin = np.cos(q[at + 2]), np.sin(q[at + 2])
    sx, sy, _ = _tip(m, body, q)
    for k in range(2):
        _both(S, half, lam + k, at + k, scale)
        _both(S, half, lam + k, nxt + k, -scale)
    _both(S, half, lam, at + 2, scale * (-sin * sx - cos * sy))
    _both(S, half, lam + 1, at + 2, scale * (cos * sx - sin * sy))
    for i in range(n):
        x, y = _tip_gradient(m, body, q, i)
        _both(S, half, lam, e + i, scale * (cos * x - sin * y))
        _both(S, half, lam + 1, e + i, scale * (sin * x + cos * y))
    if m.rows[body] == 3:
        _both(S, half, lam + 2, at + 2, scale)
        _both(S, half, lam + 2, nxt + 2, -scale)
        for i in range(n):
            _both(S, half, lam + 2, e + i, scale * m.tip[body, 2, i])


@kernel
def _both(S, half, i, j, x):  # type: ignore[no-untyped-def]
    _add(S, half, i, j, x)
    _add(S, half, j, i, x)


@kernel
def assemble(lane, model, par, q, v, a, u, cm, cc, ck, r, S):  # type: ignore[no-untyped-def]
    """Residual and tangent of the chain, see `protocol`."""
    m = model
    for k in range(m.n):
        r[k] = 0.0
    if S is not None:
        for k in range(m.n_factor):
            S[k] = 0.0
    last = m.size.shape[0] - 1
    for body in range(last + 1):
        _body(m, par, body, q, v, a, cm, cc, ck, r, S)
        if m.coupling != LINEAR and m.elements[body] > 0:
            _coupling(m, body, q, ck, r, S)
        at = m.start[body]
        if body == 0 or m.link[body] != m.link[body - 1]:
            r[at + 2] -= u[m.link[body]]
        if body < last:
            lam = _row(m, body)
            fx, fy, moment = -q[lam], -q[lam + 1], 0.0
            r[at + 3 + m.size[body] + m.rows[body]] -= q[lam]
            r[at + 4 + m.size[body] + m.rows[body]] -= q[lam + 1]
            if m.rows[body] == 3:
                moment -= q[lam + 2]
                r[m.start[body + 1] + 2] -= q[lam + 2]
            if m.link[body + 1] != m.link[body]:
                moment -= u[m.link[body + 1]]
            _tip_force(m, body, fx, fy, moment, q, ck, r, S)
            if S is not None:
                _joint_columns(m, body, q, cm, S)
    if par[0] != 0.0 or par[1] != 0.0:
        _payload(m, last, par[0], par[1], q, v, a, cm, cc, ck, r, S)
    for i in range(m.loads.shape[0]):
        body, k = m.loads[i, 0], m.n_links + 3 * i
        if m.loads[i, 1] == 0:
            r[m.start[body]] -= u[k]
            r[m.start[body] + 1] -= u[k + 1]
            r[m.start[body] + 2] -= u[k + 2]
        else:
            _tip_force(m, body, u[k], u[k + 1], u[k + 2], q, ck, r, S)


@kernel
def constrain(lane, model, psi, q, v, a, level, scale, r):  # type: ignore[no-untyped-def]
    """Constraint rows: tip of each body minus the next frame's origin, and its angle where rigid or prescribed."""
    m = model
    for body in range(m.size.shape[0] - 1):
        at, lam, nxt = m.start[body], _row(m, body), m.start[body + 1]
        e, n = at + 3, m.size[body]
        cos, sin = np.cos(q[at + 2]), np.sin(q[at + 2])
        sx, sy, phi = _tip(m, body, q)
        if level == 0:
            x, y, turn = sx, sy, q[at + 2] + phi - q[nxt + 2]
            first, second = q[at] - q[nxt], q[at + 1] - q[nxt + 1]
        else:
            tx, ty, rate = _tip_rate(m, body, q, v)
            w = v[at + 2]
            if level == 1:
                x, y, turn = tx - w * sy, ty + w * sx, w + rate - v[nxt + 2]
                first, second = v[at] - v[nxt], v[at + 1] - v[nxt + 1]
            else:
                hx, hy, second_rate = _tip_rate(m, body, q, a)
                if m.elements[body] == 0:
                    hx -= _quadratic(m.tip_h[body], v, v, e, n)
                x = hx - a[at + 2] * sy - w * w * sx - 2.0 * w * ty
                y = hy + a[at + 2] * sx - w * w * sy + 2.0 * w * tx
                turn = a[at + 2] + second_rate - a[nxt + 2]
                first, second = a[at] - a[nxt], a[at + 1] - a[nxt + 1]
        r[lam] = scale * (first + cos * x - sin * y)
        r[lam + 1] = scale * (second + sin * x + cos * y)
        if m.rows[body] == 3:
            if m.angle[body] >= 0:
                turn += psi[3 * m.angle[body] + level]
            elif level == 0:
                turn += m.offset[body]
            r[lam + 2] = scale * turn


@kernel
def pin(lane, model, S, k):  # type: ignore[no-untyped-def]
    """Replace row and column k by those of the identity."""
    half = model.half
    width = 3 * half + 1
    for j in range(max(0, k - half), min(model.n, k + half + 1)):
        S[k * width + j - k + half] = 0.0
        S[j * width + k - j + half] = 0.0
    S[k * width + half] = 1.0


@kernel
def factor(lane, model, S):  # type: ignore[no-untyped-def]
    """Band LU; the pivots lie behind the matrix."""
    n = model.n
    band_lu(S, S[n * (3 * model.half + 1) :], n, model.half, model.half)


@kernel
def solve(lane, model, S, x):  # type: ignore[no-untyped-def]
    """x <- S^-1 x."""
    n = model.n
    band_lu_solve(S, S[n * (3 * model.half + 1) :], x, n, model.half, model.half)


@kernel
def ports(lane, model, par, q, y):  # type: ignore[no-untyped-def]
    """Joint angles, then position and section angle at each point load."""
    m = model
    last = m.size.shape[0] - 1
    for body in range(last + 1):
        if body == 0:
            y[0] = q[2]
        elif m.link[body] != m.link[body - 1]:
            y[m.link[body]] = q[m.start[body] + 2] - q[m.start[body - 1] + 2] - _tip(m, body - 1, q)[2]
    for i in range(m.loads.shape[0]):
        body, k = m.loads[i, 0], m.n_links + 3 * i
        at = m.start[body]
        y[k], y[k + 1], y[k + 2] = q[at], q[at + 1], q[at + 2]
        if m.loads[i, 1] == 1:
            sx, sy, phi = _tip(m, body, q)
            cos, sin = np.cos(q[at + 2]), np.sin(q[at + 2])
            y[k] += cos * sx - sin * sy
            y[k + 1] += sin * sx + cos * sy
            y[k + 2] += phi


@kernel
def dissipation(lane, model, par, q, v):  # type: ignore[no-untyped-def]
    """v'C v over the elastic coordinates, W."""
    m = model
    power = 0.0
    for body in range(m.size.shape[0]):
        e, n = m.start[body] + 3, m.size[body]
        if par[3] != 0.0:
            power += par[3] * _quadratic(m.k_axial[body], v, v, e, n)
            power += par[3] * par[2] * _quadratic(m.k_bend[body], v, v, e, n)
        if m.mass_damping != 0.0:
            power += m.mass_damping * _quadratic(m.m_ff[body], v, v, e, n)
    return power


@kernel
def _coupling_energy(m, body, q):  # type: ignore[no-untyped-def]
    e = m.start[body] + 3
    total = 0.0
    for element in range(m.elements[body]):
        first = e + 3 * (element - 1)
        g, ea = m.element_g[body, element], m.element_ea[body, element]
        stretch = q[first + 3] - (q[first] if element > 0 else 0.0)
        wgw = 0.0
        for i in range(0 if element > 0 else 2, 4):
            for j in range(0 if element > 0 else 2, 4):
                wgw += q[first + 1 + i + i // 2] * g[i, j] * q[first + 1 + j + j // 2]
        if m.coupling == VON_KARMAN:
            total += 0.5 * ea * (stretch * wgw + 0.25 * wgw * wgw)
        else:
            total += 0.5 * ea * stretch * wgw  # q'K(q)q/2 of eq. [43]; no potential of the paper's force exists
    return total


@kernel
def energy(lane, model, par, q, v):  # type: ignore[no-untyped-def]
    """(kinetic, strain, gravity) in J."""
    m = model
    kinetic, strain, potential = 0.0, 0.0, 0.0
    last = m.size.shape[0] - 1
    for body in range(last + 1):
        at = m.start[body]
        e, n = at + 3, m.size[body]
        cos, sin = np.cos(q[at + 2]), np.sin(q[at + 2])
        w = v[at + 2]
        s_bar, d0 = m.s_bar[body], m.d0[body]
        sx, sy = m.s0[body] + _dot(s_bar[0], q, e, n), _dot(s_bar[1], q, e, n)
        tx, ty = _dot(s_bar[0], v, e, n), _dot(s_bar[1], v, e, n)
        if m.elements[body] == 0:
            sx -= 0.5 * _quadratic(d0, q, q, e, n)
            tx -= _quadratic(d0, q, v, e, n)
        vx, vy = cos * v[at] + sin * v[at + 1], cos * v[at + 1] - sin * v[at]
        inertia = m.i0[body] + 2.0 * _dot(m.c_u[body], q, e, n) + _quadratic(m.g[body], q, q, e, n)
        kinetic += 0.5 * m.mass[body] * (vx * vx + vy * vy) + vx * (tx - w * sy) + vy * (ty + w * sx)
        kinetic += 0.5 * w * w * inertia + 0.5 * _quadratic(m.m_ff[body], v, v, e, n)
        kinetic += w * (_dot(m.c[body], v, e, n) - _quadratic(m.b[body], q, v, e, n))
        strain += 0.5 * _quadratic(m.k_axial[body], q, q, e, n)
        strain += 0.5 * par[2] * _quadratic(m.k_bend[body], q, q, e, n)
        if m.coupling != LINEAR:
            strain += _coupling_energy(m, body, q)
        potential -= m.gravity[0] * (m.mass[body] * q[at] + cos * sx - sin * sy)
        potential -= m.gravity[1] * (m.mass[body] * q[at + 1] + sin * sx + cos * sy)
        if body == last and (par[0] != 0.0 or par[1] != 0.0):
            px, py, _ = _tip(m, body, q)
            rx, ry, turn = _tip_rate(m, body, q, v)
            ux, uy = vx + rx - w * py, vy + ry + w * px
            kinetic += 0.5 * par[0] * (ux * ux + uy * uy) + 0.5 * par[1] * (w + turn) ** 2
            potential -= par[0] * m.gravity[0] * (q[at] + cos * px - sin * py)
            potential -= par[0] * m.gravity[1] * (q[at + 1] + sin * px + cos * py)
    return kinetic, strain, potential


@kernel
def link_poses(lane, model, par, q, v, out):  # type: ignore[no-untyped-def]
    """Per link: root x, y, angle and their rates, tip x, y, angle and their rates."""
    m = model
    for body in range(m.size.shape[0]):
        at, k = m.start[body], 12 * m.link[body]
        if body == 0 or m.link[body] != m.link[body - 1]:
            for i in range(3):
                out[k + i], out[k + 3 + i] = q[at + i], v[at + i]
        if body == m.size.shape[0] - 1 or m.link[body] != m.link[body + 1]:
            cos, sin = np.cos(q[at + 2]), np.sin(q[at + 2])
            sx, sy, phi = _tip(m, body, q)
            tx, ty, rate = _tip_rate(m, body, q, v)
            w = v[at + 2]
            tx, ty = tx - w * sy, ty + w * sx
            out[k + 6], out[k + 7] = q[at] + cos * sx - sin * sy, q[at + 1] + sin * sx + cos * sy
            out[k + 8], out[k + 11] = q[at + 2] + phi, w + rate
            out[k + 9], out[k + 10] = v[at] + cos * tx - sin * ty, v[at + 1] + sin * tx + cos * ty


@kernel
def out_of_range(lane, model, par, q):  # type: ignore[no-untyped-def]
    """DIVERGED when a body's tip deflects beyond its length; OUT_OF_RANGE when modes leave their range."""
    m = model
    for body in range(m.size.shape[0]):
        sx, sy, _ = _tip(m, body, q)
        if not abs(sy) < m.length[body]:
            return float(DIVERGED)
        if m.elements[body] == 0 and m.bound > 0.0 and abs(sy) > m.bound * m.length[body]:
            return float(OUT_OF_RANGE)
    return float(OK)


@kernel
def shape(model, q, points):  # type: ignore[no-untyped-def]
    """Positions along the chain at the bodies' stations; returns how many were written."""
    m = model
    points[0, 0], points[0, 1] = q[0], q[1]
    k = 1
    for body in range(m.size.shape[0]):
        at = m.start[body]
        e, n = at + 3, m.size[body]
        cos, sin = np.cos(q[at + 2]), np.sin(q[at + 2])
        for s in range(m.stations.shape[1]):
            x = m.stations[body, s]
            if not x > 0.0:
                continue
            x += _dot(m.shapes[body, s, 0], q, e, n)
            if m.elements[body] == 0:
                x -= 0.5 * _quadratic(m.station_h[body, s], q, q, e, n)
            y = _dot(m.shapes[body, s, 1], q, e, n)
            points[k, 0], points[k, 1] = q[at] + cos * x - sin * y, q[at + 1] + sin * x + cos * y
            k += 1
    return k


register(
    FloatingFrame,
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
