"""Floating-frame bodies joined by multipliers, eqs. [34]-[38], [64], [65] and docs/theory.md sections 2 and 3.

Body coordinates (R_x, R_y, theta, q); the system is ordered body 0, multipliers of joint 0-1, body 1, ... so
that it stays banded.
"""

from __future__ import annotations

import numpy as np

from ...compiler.decorator import kernel
from ..linalg import band_lu, band_lu_solve
from ..model import DIVERGED, LINEAR, OK, OUT_OF_RANGE, VON_KARMAN, FloatingFrame
from ..protocol import register
from .layout import ELEMENTS, LINK, MOTION, MULTIPLIERS, SIZE, START, STATIONS, constants, station_at
from .multipliers_body import (
    add_entry,
    along,
    bending,
    body_residual,
    coupling_force,
    dot,
    element_places,
    lost_inertia,
    payload_drag,
    payload_residual,
    quadratic,
    times,
    tip_force,
    tip_gradient,
    tip_position,
    tip_rate,
)


@kernel
def _joint_columns(m, body, q, scale, S):
    """Phi_q and its transpose for the joint between a body's tip and the next body, both times `scale`."""
    at, nxt, n, half = m.table[body, START], m.table[body + 1, START], m.table[body, SIZE], m.half
    e, lam = at + 3, at + 3 + n
    p = constants(m, body)
    cos, sin = np.cos(q[at + 2]), np.sin(q[at + 2])
    sx, sy, _ = tip_position(m, body, q)
    for k in range(2):
        _both(S, half, lam + k, at + k, scale)
        _both(S, half, lam + k, nxt + k, -scale)
    _both(S, half, lam, at + 2, scale * (-sin * sx - cos * sy))
    _both(S, half, lam + 1, at + 2, scale * (cos * sx - sin * sy))
    for i in range(n):
        x, y = tip_gradient(m, body, q, i)
        _both(S, half, lam, e + i, scale * (cos * x - sin * y))
        _both(S, half, lam + 1, e + i, scale * (sin * x + cos * y))
    if m.table[body, MULTIPLIERS] == 3:
        _both(S, half, lam + 2, at + 2, scale)
        _both(S, half, lam + 2, nxt + 2, -scale)
        for i in range(n):
            _both(S, half, lam + 2, e + i, scale * m.data[p.tip + 2 * n + i])


@kernel
def _both(S, half, i, j, x):
    add_entry(S, half, i, j, x)
    add_entry(S, half, j, i, x)


@kernel
def assemble(lane, model, par, state, u, weights, r, S):
    """Residual and tangent of the chain, see `protocol`."""
    (q, v, a), (cm, cc, ck) = state, weights
    m = model
    for k in range(m.n):
        r[k] = 0.0
    if cm != 0.0:
        for k in range(m.n_factor):
            S[k] = 0.0
    last = m.table.shape[0] - 1
    for body in range(last + 1):
        body_residual(m, par, body, q, v, a, cm, cc, ck, r, S)
        if m.coupling != LINEAR and m.table[body, ELEMENTS] > 0:
            coupling_force(m, body, par[3], q, v, cm, cc, ck, r, S)
        at = m.table[body, START]
        if body == 0 or m.table[body, LINK] != m.table[body - 1, LINK]:
            r[at + 2] -= u[m.table[body, LINK]]
        if body < last:
            lam = m.table[body, START] + 3 + m.table[body, SIZE]
            fx, fy, moment = -q[lam], -q[lam + 1], 0.0
            r[at + 3 + m.table[body, SIZE] + m.table[body, MULTIPLIERS]] -= q[lam]
            r[at + 4 + m.table[body, SIZE] + m.table[body, MULTIPLIERS]] -= q[lam + 1]
            if m.table[body, MULTIPLIERS] == 3:
                moment -= q[lam + 2]
                r[m.table[body + 1, START] + 2] -= q[lam + 2]
            if m.table[body + 1, LINK] != m.table[body, LINK]:
                moment -= u[m.table[body + 1, LINK]]
            tip_force(m, body, fx, fy, moment, q, cm, ck, r, S)
            if cm != 0.0:
                _joint_columns(m, body, q, cm, S)
    if par[0] != 0.0 or par[1] != 0.0:
        payload_residual(m, last, par[0], par[1], q, v, a, cm, cc, ck, r, S)
        if m.mass_damping != 0.0:
            payload_drag(m, last, par[0], par[1], q, v, cm, cc, ck, r, S)
    for i in range(m.loads.shape[0]):
        body, k = m.loads[i, 0], m.n_links + 3 * i
        if m.loads[i, 1] == 0:
            r[m.table[body, START]] -= u[k]
            r[m.table[body, START] + 1] -= u[k + 1]
            r[m.table[body, START] + 2] -= u[k + 2]
        else:
            tip_force(m, body, u[k], u[k + 1], u[k + 2], q, cm, ck, r, S)


@kernel
def constrain(lane, model, psi, state, level, scale, r):
    """Constraint rows: tip of each body minus the next frame's origin, and its angle where rigid or prescribed."""
    q, v, a = state
    m = model
    for body in range(m.table.shape[0] - 1):
        at, lam, nxt = m.table[body, START], m.table[body, START] + 3 + m.table[body, SIZE], m.table[body + 1, START]
        e, n = at + 3, m.table[body, SIZE]
        p = constants(m, body)
        cos, sin = np.cos(q[at + 2]), np.sin(q[at + 2])
        sx, sy, phi = tip_position(m, body, q)
        if level == 0:
            x, y, turn = sx, sy, q[at + 2] + phi - q[nxt + 2]
            first, second = q[at] - q[nxt], q[at + 1] - q[nxt + 1]
        else:
            tx, ty, rate = tip_rate(m, body, q, v)
            w = v[at + 2]
            if level == 1:
                x, y, turn = tx - w * sy, ty + w * sx, w + rate - v[nxt + 2]
                first, second = v[at] - v[nxt], v[at + 1] - v[nxt + 1]
            else:
                hx, hy, second_rate = tip_rate(m, body, q, a)
                if m.table[body, ELEMENTS] == 0:
                    hx -= quadratic(m.data, p.tip_H, v, v, e, n)
                x = hx - a[at + 2] * sy - w * w * sx - 2.0 * w * ty
                y = hy + a[at + 2] * sx - w * w * sy + 2.0 * w * tx
                turn = a[at + 2] + second_rate - a[nxt + 2]
                first, second = a[at] - a[nxt], a[at + 1] - a[nxt + 1]
        r[lam] = scale * (first + cos * x - sin * y)
        r[lam + 1] = scale * (second + sin * x + cos * y)
        if m.table[body, MULTIPLIERS] == 3:
            if m.table[body, MOTION] >= 0:
                turn += psi[3 * m.table[body, MOTION] + level]
            elif level == 0:
                turn += m.data[p.offset]
            r[lam + 2] = scale * turn


@kernel
def pin(lane, model, S, k):
    """Replace row and column k by those of the identity."""
    half = model.half
    width = 3 * half + 1
    for j in range(max(0, k - half), min(model.n, k + half + 1)):
        S[k * width + j - k + half] = 0.0
        S[j * width + k - j + half] = 0.0
    S[k * width + half] = 1.0


@kernel
def factor(lane, model, S):
    """Band LU; the pivots lie behind the matrix."""
    n = model.n
    band_lu(S, S[n * (3 * model.half + 1) :], n, model.half, model.half)


@kernel
def solve(lane, model, S, x):
    """x <- S^-1 x."""
    n = model.n
    band_lu_solve(S, S[n * (3 * model.half + 1) :], x, n, model.half, model.half)


@kernel
def ports(lane, model, par, q, y):
    """Joint angles, then position and section angle at each point load."""
    m = model
    last = m.table.shape[0] - 1
    for body in range(last + 1):
        if body == 0:
            y[0] = q[2]
        elif m.table[body, LINK] != m.table[body - 1, LINK]:
            turn = q[m.table[body, START] + 2] - q[m.table[body - 1, START] + 2]
            y[m.table[body, LINK]] = turn - tip_position(m, body - 1, q)[2]
    for i in range(m.loads.shape[0]):
        body, k = m.loads[i, 0], m.n_links + 3 * i
        at = m.table[body, START]
        y[k], y[k + 1], y[k + 2] = q[at], q[at + 1], q[at + 2]
        if m.loads[i, 1] == 1:
            sx, sy, phi = tip_position(m, body, q)
            cos, sin = np.cos(q[at + 2]), np.sin(q[at + 2])
            y[k] += cos * sx - sin * sy
            y[k + 1] += sin * sx + cos * sy
            y[k + 2] += phi


@kernel
def damping_work(lane, model, par, q, v, x):
    """x'C(q) v, W: damping of the elastic coordinates and of the payload (for x = v twice Rayleigh's function)."""
    m = model
    power = 0.0
    last = m.table.shape[0] - 1
    for body in range(last + 1):
        e, n = m.table[body, START] + 3, m.table[body, SIZE]
        p = constants(m, body)
        if par[3] != 0.0:
            power += par[3] * quadratic(m.data, p.K_axial, x, v, e, n)
            power += par[3] * par[2] * quadratic(m.data, p.K_bend, x, v, e, n)
            if m.coupling == VON_KARMAN:
                power += par[3] * _coupling_loss(m, body, q, v, x)
        if m.mass_damping != 0.0:
            power += m.mass_damping * quadratic(m.data, p.M_ff, x, v, e, n)
            if body == last:
                vx, vy, turning = tip_rate(m, body, q, v)
                xx, xy, turned = tip_rate(m, body, q, x)
                power += m.mass_damping * (par[0] * (vx * xx + vy * xy) + par[1] * turning * turned)
    return power


@kernel
def _coupling_loss(m, body, q, v, x):
    """EA / l times what products of the rates of von Karman's stretches have beyond those of the linear ones."""
    total = 0.0
    for element in range(m.table[body, ELEMENTS]):
        first, stiffness, g = element_places(m, body, element)
        inner = element > 0
        gw = times(m.data, g, bending(q, first, inner))
        linear_v, linear_x = v[first + 3] - (v[first] if inner else 0.0), x[first + 3] - (x[first] if inner else 0.0)
        more_v, more_x = along(bending(v, first, inner), gw), along(bending(x, first, inner), gw)
        total += m.data[stiffness] * (more_v * (linear_x + more_x) + linear_v * more_x)
    return total


@kernel
def _coupling_energy(m, body, q):
    total = 0.0
    for element in range(m.table[body, ELEMENTS]):
        first, stiffness, g = element_places(m, body, element)
        inner = element > 0
        stretch = q[first + 3] - (q[first] if inner else 0.0)
        w = bending(q, first, inner)
        wgw = along(w, times(m.data, g, w))
        if m.coupling == VON_KARMAN:
            total += 0.5 * m.data[stiffness] * (stretch * wgw + 0.25 * wgw * wgw)
        else:
            total += 0.5 * m.data[stiffness] * stretch * wgw  # q'K(q)q/2 of [43]; the paper's force has no potential
    return total


@kernel
def energy(lane, model, par, q, v):
    """(kinetic, strain, gravity) in J."""
    m = model
    kinetic, strain, potential = 0.0, 0.0, 0.0
    last = m.table.shape[0] - 1
    for body in range(last + 1):
        at = m.table[body, START]
        e, n = at + 3, m.table[body, SIZE]
        p = constants(m, body)
        cos, sin = np.cos(q[at + 2]), np.sin(q[at + 2])
        w = v[at + 2]
        sx, sy = m.data[p.S0] + dot(m.data, p.S_bar, q, e, n), dot(m.data, p.S_bar + n, q, e, n)
        tx, ty = dot(m.data, p.S_bar, v, e, n), dot(m.data, p.S_bar + n, v, e, n)
        if m.table[body, ELEMENTS] == 0:
            sx -= 0.5 * quadratic(m.data, p.D0, q, q, e, n)
            tx -= quadratic(m.data, p.D0, q, v, e, n)
        vx, vy = cos * v[at] + sin * v[at + 1], cos * v[at + 1] - sin * v[at]
        inertia = m.data[p.I0] + 2.0 * dot(m.data, p.c_u, q, e, n)
        inertia += quadratic(m.data, p.G, q, q, e, n)
        kinetic += 0.5 * m.data[p.mass] * (vx * vx + vy * vy) + vx * (tx - w * sy) + vy * (ty + w * sx)
        kinetic += 0.5 * w * w * inertia + 0.5 * quadratic(m.data, p.M_ff, v, v, e, n)
        kinetic += w * (dot(m.data, p.c, v, e, n) - quadratic(m.data, p.B, q, v, e, n))
        strain += 0.5 * quadratic(m.data, p.K_axial, q, q, e, n)
        strain += 0.5 * par[2] * quadratic(m.data, p.K_bend, q, q, e, n)
        if m.coupling != LINEAR:
            strain += _coupling_energy(m, body, q)
        potential -= m.gravity[0] * (m.data[p.mass] * q[at] + cos * sx - sin * sy)
        potential -= m.gravity[1] * (m.data[p.mass] * q[at + 1] + sin * sx + cos * sy)
        if body == last and (par[0] != 0.0 or par[1] != 0.0):
            px, py, _ = tip_position(m, body, q)
            rx, ry, turn = tip_rate(m, body, q, v)
            ux, uy = vx + rx - w * py, vy + ry + w * px
            kinetic += 0.5 * par[0] * (ux * ux + uy * uy) + 0.5 * par[1] * (w + turn) ** 2
            potential -= par[0] * m.gravity[0] * (q[at] + cos * px - sin * py)
            potential -= par[0] * m.gravity[1] * (q[at + 1] + sin * px + cos * py)
    return kinetic, strain, potential


@kernel
def link_poses(lane, model, par, q, v, out):
    """Per link: root x, y, angle and their rates, tip x, y, angle and their rates."""
    m = model
    for body in range(m.table.shape[0]):
        at, k = m.table[body, START], 12 * m.table[body, LINK]
        if body == 0 or m.table[body, LINK] != m.table[body - 1, LINK]:
            for i in range(3):
                out[k + i], out[k + 3 + i] = q[at + i], v[at + i]
        if body == m.table.shape[0] - 1 or m.table[body, LINK] != m.table[body + 1, LINK]:
            cos, sin = np.cos(q[at + 2]), np.sin(q[at + 2])
            sx, sy, phi = tip_position(m, body, q)
            tx, ty, rate = tip_rate(m, body, q, v)
            w = v[at + 2]
            tx, ty = tx - w * sy, ty + w * sx
            out[k + 6], out[k + 7] = q[at] + cos * sx - sin * sy, q[at + 1] + sin * sx + cos * sy
            out[k + 8], out[k + 11] = q[at + 2] + phi, w + rate
            out[k + 9], out[k + 10] = v[at] + cos * tx - sin * ty, v[at + 1] + sin * tx + cos * ty


@kernel
def out_of_range(lane, model, par, q):
    """DIVERGED when a body's tip deflects beyond its length; OUT_OF_RANGE when a reduced link leaves its range: by its
    deflection, or by an inertia about its root that comes near to where the mass matrix is indefinite."""
    m = model
    for body in range(m.table.shape[0]):
        p = constants(m, body)
        deflection, length = abs(tip_position(m, body, q)[1]), m.data[p.length]
        if not deflection < length:
            return float(DIVERGED)
        if m.table[body, ELEMENTS] == 0:
            payload = par[0] if body == m.table.shape[0] - 1 else 0.0
            if deflection > m.bound * length or lost_inertia(m, body, payload, q) > m.data[p.most_lost]:
                return float(OUT_OF_RANGE)
    return float(OK)


@kernel
def shape(model, q, points):
    """Positions along the chain at the bodies' stations, as many as `points` has room for; their number."""
    m = model
    points[0, 0], points[0, 1] = q[0], q[1]
    k = 1
    for body in range(m.table.shape[0]):
        at = m.table[body, START]
        e, n = at + 3, m.table[body, SIZE]
        p = constants(m, body)
        cos, sin = np.cos(q[at + 2]), np.sin(q[at + 2])
        d, first = m.data, p.stations
        for _ in range(m.table[body, STATIONS]):
            if k == points.shape[0]:
                return k
            own = station_at(first, n)
            x = d[own.x] + dot(d, own.u, q, e, n) - 0.5 * quadratic(d, own.H, q, q, e, n)
            y = dot(d, own.v, q, e, n)
            first = own.end
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
    damping_work=damping_work,
    energy=energy,
    link_poses=link_poses,
    out_of_range=out_of_range,
    shape=shape,
)
