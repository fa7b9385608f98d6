"""Floating frames joined by Lagrange multipliers, the paper's own form: eqs. [34]-[38], [64], [65], [72]-[78].

Each body has R_x, R_y, theta of its frame and its elastic coordinates q of its own; that its tip is where the next
frame begins, and at its angle where the joint is rigid or prescribed, are constraints Phi. Rows: body 0, multipliers of
the joint behind it, body 1, ..., so that the matrix is banded. A body's mechanics are those of `body`: what its joint
holds it with lies at its tip as any force does.

S holds the band, the pivots of its factors, and room for one body's `FACTORS`. SINGLE only.
"""

from __future__ import annotations

from ...compiler.arrays import stack
from ...compiler.decorator import kernel
from ...compiler.dispatch import size
from ..layout import OF_MOTION
from ..linalg import band_lu, band_lu_solve
from ..model import FloatingFrame
from ..protocol import register
from .body import carry, constants, forces, tip
from .chain import less_loads
from .chain_output import damping_work, energy, fall, link_poses, out_of_range, ports_of_loads, shape
from .layout import ANGLE, ELASTIC, KNOWN, MOTION, MULTIPLIERS, NOW, PASSED, START, cell, factors_at
from .matrix import take_in, tangent

THREE, FIVE, NINE = (0,) * 3, (0,) * 5, (0,) * 9
NUMBERS, MOVES = (0,) * KNOWN.end, (0,) * NOW.end


@kernel
def band_width(half):
    """Numbers a row of the band of half-width `half`, with room for what pivoting fills."""
    return 3 * half + 1


@kernel
def _frame(model, b, q, v, a, pose):
    """pose <- angle of body b's frame, its rates, and the acceleration of its origin less gravity."""
    at = model.table[b, START]
    pose[PASSED.angle], pose[PASSED.rate], pose[PASSED.second] = q[at + ANGLE], v[at + ANGLE], a[at + ANGLE]
    pose[PASSED.ax], pose[PASSED.ay] = a[at] - fall(model.gravity, 0), a[at + 1] - fall(model.gravity, 1)


@kernel
def assemble(lane, model, par, state, u, weights, r, S):
    """Residual [64] and tangent [72]-[78] of the chain, see `protocol`."""
    (q, v, a), (cm, cc, ck) = state, weights
    mesh, table, n, segments = model.mesh, model.table, size(model.mesh.n), model.segments
    pose, force, held, carried = stack(lane, FIVE), stack(lane, THREE), stack(lane, THREE), stack(lane, THREE)
    known, vectors, strains = stack(lane, NUMBERS), stack(lane, mesh.scratch), stack(lane, mesh.strains)
    width, last = band_width(model.half), table.shape[0] - 1
    own = S[model.n * (width + 1) :]
    if cm != 0.0:
        for k in range(model.n * width):
            S[k] = 0.0
    held[0], held[1], held[2] = 0.0, 0.0, u[0]
    carried[0], carried[1] = 0.0, 0.0
    for b in range(last + 1):
        at, lam, D = table[b, START], table[b, START] + ELASTIC + n, model.data[model.block * b :]
        q_b, v_b, a_b, link = q[at + ELASTIC :], v[at + ELASTIC :], a[at + ELASTIC :], b // segments
        _frame(model, b, q, v, a, pose)
        carry(lane, mesh, D, q_b, v_b, a_b, pose, own)
        for i in range(3):  # the joint before it and loads, at the root
            force[i] = -held[i]
        if b % segments == 0:
            less_loads(lane, model.loads, model, link, 0, u, force)
        for i in range(3):  # the joint behind it, payload and loads, at the tip
            r[at + i], held[i] = force[i], 0.0
        for i in range(table[b, MULTIPLIERS]):
            held[i], r[lam + i] = q[lam + i], 0.0
        if b < last and (b + 1) % segments == 0:
            held[2] += u[link + 1]
        for i in range(3):
            force[i] = held[i]
        if b == last:
            force[0], force[1] = pose[PASSED.ax] * par[0], pose[PASSED.ay] * par[0]
            force[2] = pose[PASSED.second] * par[1]
            carried[0], carried[1] = par[0], par[1]
        if (b + 1) % segments == 0:
            less_loads(lane, model.loads, model, link, 1, u, force)
        forces(lane, mesh, D, par, carried, q_b, v_b, a_b, force, known, vectors, strains, own, r[at + ELASTIC :])
        for i in range(3):
            r[at + i] += force[i]
        if cm != 0.0:
            tangent(lane, mesh, D, par, carried, cm, cc, ck, q_b, v_b, a_b, known, vectors, strains, own)
            if b == last:
                _take_in_payload(lane, mesh, D, par, cm, own)
            _to_band(mesh, own, at, cm, model.half, S)
            if b < last:
                _join(mesh, D, own, at, table[b, MULTIPLIERS], cm, model.half, S)


@kernel
def _take_in_payload(lane, mesh, D, par, cm, own):
    """The payload's part of the last body's matrix: it changes by its mass times the change of the tip's acceleration,
    its moment by that of the angle."""
    tail = stack(lane, NINE)
    for i in range(9):
        tail[i] = 0.0
    tail[cell(0, 0)], tail[cell(1, 1)], tail[cell(2, 2)] = par[0], par[0], cm * par[1]
    take_in(lane, mesh, D, own, tail)


@kernel
def _to_band(mesh, own, at, cm, half, S):
    """A body's matrix to its rows and columns of the band: those of R in global axes, columns of its acceleration
    times cm, since R comes in through that alone."""
    n, width = size(mesh.n), band_width(half)
    places = factors_at(0, n)
    W, wide, c, s = places.matrix, n + 3, own[places.frame], own[places.frame + 1]
    for i in range(wide):
        k = W + i * wide + n
        own[k], own[k + 1] = cm * (c * own[k] - s * own[k + 1]), cm * (s * own[k] + c * own[k + 1])
    for j in range(wide):
        k = W + n * wide + j
        own[k], own[k + wide] = c * own[k] - s * own[k + wide], s * own[k] + c * own[k + wide]
    for i in range(wide):
        row = at + (i + ELASTIC) % wide  # the body's matrix begins with q, its rows in the system with R, theta
        for j in range(wide):
            S[row * width + at + (j + ELASTIC) % wide - row + half] = own[W + i * wide + j]


@kernel
def _join(mesh, D, own, at, rows, scale, half, S):
    """Phi_q and its transpose for the joint behind a body, of so many rows, both times `scale`."""
    n = size(mesh.n)
    places = factors_at(0, n)
    c, s, phi = own[places.frame], own[places.frame + 1], constants(mesh).tip_phi
    lam = at + ELASTIC + n
    for k in range(rows):
        _both(S, half, lam + k, at + k, scale)
        _both(S, half, lam + k, lam + rows + k, -scale)
    for j in range(n + 1):  # q, then theta
        x, y = scale * own[places.arm + j], scale * own[places.arm + n + 1 + j]
        place = at + ELASTIC + j if j < n else at + ANGLE
        _both(S, half, lam, place, c * x - s * y)
        _both(S, half, lam + 1, place, s * x + c * y)
        if rows == 3 and j < n:
            _both(S, half, lam + ANGLE, place, scale * D[phi + j])


@kernel
def _both(S, half, i, j, x):
    """Entries (i, j) and (j, i) of the band."""
    S[i * band_width(half) + j - i + half] = x
    S[j * band_width(half) + i - j + half] = x


@kernel
def constrain(lane, model, psi, state, level, scale, r):
    """Constraints [34]-[38] or their rates: each tip less the next frame's origin, its angle less that frame's where it
    is rigid or prescribed."""
    q, v, a = state
    table, n = model.table, size(model.mesh.n)
    pose, now = stack(lane, FIVE), stack(lane, MOVES)
    x = q
    if level == 1:
        x = v
    elif level == 2:
        x = a
    for b in range(table.shape[0] - 1):
        at, D = table[b, START], model.data[model.block * b :]
        lam, behind = at + ELASTIC + n, table[b + 1, START]
        _frame(model, b, q, v, a, pose)
        carry(lane, model.mesh, D, q[at + ELASTIC :], v[at + ELASTIC :], a[at + ELASTIC :], pose, now)
        c, s, moved = now[NOW.cos], now[NOW.sin], NOW.tip + 2 * level  # the tip's place, its rate, its acceleration
        r[lam] = scale * (x[at] - x[behind] + c * now[moved] - s * now[moved + 1])
        r[lam + 1] = scale * (x[at + 1] - x[behind + 1] + s * now[moved] + c * now[moved + 1])
        if table[b, MULTIPLIERS] == 3:
            turn = pose[level] - x[behind + ANGLE]
            if table[b, MOTION] >= 0:
                turn += psi[OF_MOTION.end * table[b, MOTION] + level]
            elif level == 0:
                turn += D[constants(model.mesh).offset]
            r[lam + ANGLE] = scale * turn


@kernel
def pin(lane, model, S, k):
    """Replace row and column k by those of the identity."""
    half = model.half
    width = band_width(half)
    for j in range(max(0, k - half), min(model.n, k + half + 1)):
        S[k * width + j - k + half] = 0.0
        S[j * width + k - j + half] = 0.0
    S[k * width + half] = 1.0


@kernel
def factor(lane, model, S):
    """Band LU; the pivots lie behind the matrix."""
    n = model.n
    band_lu(S, S[n * band_width(model.half) :], n, model.half, model.half)


@kernel
def solve(lane, model, S, x):
    """x <- S^-1 x."""
    n = model.n
    band_lu_solve(S, S[n * band_width(model.half) :], x, n, model.half, model.half)


@kernel
def ports(lane, model, par, q, y):
    """Joint angles, then position and section angle at each point load."""
    segments = model.segments
    y[0] = q[ANGLE]
    for k in range(1, model.links):
        b = k * segments - 1
        before = model.table[b, START]
        turned = q[before + ANGLE] + tip(lane, model.mesh, model.data[model.block * b :], q[before + ELASTIC :])[2]
        y[k] = q[model.table[b + 1, START] + ANGLE] - turned
    ports_of_loads(lane, model, model.loads, q, y)


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
