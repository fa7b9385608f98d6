"""Floating frames joined by Lagrange multipliers, the paper's own form: eqs. [34]-[38], [64], [65], [72]-[78].

Each body has R_x, R_y, theta of its frame and its elastic coordinates q of its own; that its tip is where the next
frame begins, and at its angle where the joint is rigid or prescribed, are constraints Phi. Rows: body 0, multipliers of
the joint behind it, body 1, ..., so that the matrix is banded. A body's mechanics are those of `body`: what its joint
holds it with lies at its tip as any force does.

S holds the band, the pivots of its factors, and room for one body's `FACTORS`. One arm at a time: rows are exchanged.
"""

from ...compiler import kernel, load, size, splat, stack, store
from ..arithmetic import add, pair, put_pair, put_vector, turned
from ..layout import OF_MOTION
from ..linalg import band_lu, band_lu_solve
from ..model import PAYLOAD_INERTIA, PAYLOAD_MASS, FloatingFrame
from ..protocol import register
from .body import carry, constants, forces, tip
from .chain import diagonal, frame_at, less_loads, payload_force
from .chain_output import damping_work, energy, link_poses, out_of_range, ports_of_loads, shape
from .layout import ANGLE, ELASTIC, KNOWN, MOTION, MULTIPLIERS, NOW, START, factors_at
from .matrix import take_in, tangent

THREE, FIVE, NINE = (0,) * 3, (0,) * 5, (0,) * 9
NUMBERS, MOVES = (0,) * KNOWN.end, (0,) * NOW.end


@kernel
def band_width(half):
    """Numbers a row of the band of half-width `half`, with room for what pivoting fills."""
    return 3 * half + 1


@kernel
def assemble(lane, model, par, state, u, weights, r, S):
    """Residual [64] and tangent [72]-[78] of the chain, see `protocol`."""
    (q, v, a), (cm, cc, ck) = state, weights
    mesh, table, n, segments, L = model.mesh, model.table, size(model.mesh.n), model.segments, len(lane)
    pose, force, held, carried = stack(lane, FIVE), stack(lane, THREE), stack(lane, THREE), stack(lane, THREE)
    tail = stack(lane, NINE)
    known, vectors, strains = stack(lane, NUMBERS), stack(lane, mesh.scratch), stack(lane, mesh.strains)
    width, last, zero = band_width(model.half), table.shape[0] - 1, splat(lane, 0.0)
    own = S[model.n * (width + 1) * L :]
    if cm != 0.0:
        for k in range(model.n * width):
            store(S, k, zero)
    put_vector(held, 0, (zero, zero, load(lane, u, 0)))
    put_pair(carried, 0, (zero, zero))
    for b in range(last + 1):
        at, lam, D = table[b, START], table[b, START] + ELASTIC + n, model.data[model.block * b :]
        e, link = (at + ELASTIC) * L, b // segments
        frame_at(lane, model, state, at, pose)
        carry(lane, mesh, D, q[e:], v[e:], a[e:], pose, own)
        for i in range(3):  # the joint before it and loads, at the root
            store(force, i, -load(lane, held, i))
        if b % segments == 0:
            less_loads(lane, model, link, 0, u, force)
        for i in range(3):  # the joint behind it, payload and loads, at the tip
            store(r, at + i, load(lane, force, i))
            store(held, i, zero)
        for i in range(table[b, MULTIPLIERS]):
            store(held, i, load(lane, q, lam + i))
            store(r, lam + i, zero)
        if b < last and (b + 1) % segments == 0:
            add(lane, held, 2, load(lane, u, link + 1))
        for i in range(3):
            store(force, i, load(lane, held, i))
        if b == last:
            payload_force(lane, par, pose, force, carried)
        if (b + 1) % segments == 0:
            less_loads(lane, model, link, 1, u, force)
        forces(lane, mesh, D, par, carried, q[e:], v[e:], a[e:], force, known, vectors, strains, own, r[e:])
        for i in range(3):
            add(lane, r, at + i, load(lane, force, i))
        if cm != 0.0:
            tangent(lane, mesh, D, par, carried, cm, cc, ck, q[e:], v[e:], a[e:], known, vectors, strains, own)
            if b == last:
                diagonal(tail, zero, load(lane, par, PAYLOAD_MASS), load(lane, par, PAYLOAD_INERTIA) * cm)
                take_in(lane, mesh, D, own, tail)
            _to_band(lane, mesh, own, at, cm, model.half, S)
            if b < last:
                _join(lane, mesh, D, own, at, table[b, MULTIPLIERS], cm, model.half, S)


@kernel
def _to_band(lane, mesh, own, at, cm, half, S):
    """A body's matrix to its rows and columns of the band: those of R in global axes, columns of its acceleration
    times cm, since R comes in through that alone."""
    n, width = size(mesh.n), band_width(half)
    places = factors_at(0, n)
    (c, s), W, wide = pair(lane, own, places.frame), places.matrix, n + 3
    for i in range(wide):
        k = W + i * wide + n
        x, y = pair(lane, own, k)
        x, y = turned(c, s, x, y)
        put_pair(own, k, (x * cm, y * cm))
    for j in range(wide):
        k = W + n * wide + j
        x, y = turned(c, s, load(lane, own, k), load(lane, own, k + wide))
        store(own, k, x)
        store(own, k + wide, y)
    for i in range(wide):
        row = at + (i + ELASTIC) % wide  # the body's matrix begins with q, its rows in the system with R, theta
        for j in range(wide):
            store(S, row * width + at + (j + ELASTIC) % wide - row + half, load(lane, own, W + i * wide + j))


@kernel
def _join(lane, mesh, D, own, at, rows, scale, half, S):
    """Phi_q and its transpose for the joint behind a body, of so many rows, both times `scale`."""
    n = size(mesh.n)
    places = factors_at(0, n)
    (c, s), phi = pair(lane, own, places.frame), constants(mesh).tip_phi
    lam = at + ELASTIC + n
    for k in range(rows):
        _both(S, half, lam + k, at + k, splat(lane, scale))
        _both(S, half, lam + k, lam + rows + k, splat(lane, -scale))
    for j in range(n + 1):  # q, then theta
        x, y = pair(lane, own, places.arm + 2 * j)
        x, y = turned(c, s, x * scale, y * scale)
        place = at + ELASTIC + j if j < n else at + ANGLE
        _both(S, half, lam, place, x)
        _both(S, half, lam + 1, place, y)
        if rows == 3 and j < n:
            _both(S, half, lam + ANGLE, place, splat(lane, scale * D[phi + j]))


@kernel
def _both(S, half, i, j, x):
    """Entries (i, j) and (j, i) of the band."""
    store(S, i * band_width(half) + j - i + half, x)
    store(S, j * band_width(half) + i - j + half, x)


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
        e, lam, behind = (at + ELASTIC) * len(lane), at + ELASTIC + n, table[b + 1, START]
        frame_at(lane, model, state, at, pose)
        carry(lane, model.mesh, D, q[e:], v[e:], a[e:], pose, now)
        c, s = pair(lane, now, NOW.cos)
        tx, ty = pair(lane, now, NOW.tip + 2 * level)  # the tip's place, its rate, its acceleration
        store(r, lam, (load(lane, x, at) - load(lane, x, behind) + c * tx - s * ty) * scale)
        store(r, lam + 1, (load(lane, x, at + 1) - load(lane, x, behind + 1) + s * tx + c * ty) * scale)
        if table[b, MULTIPLIERS] == 3:
            turn = load(lane, pose, level) - load(lane, x, behind + ANGLE)
            if table[b, MOTION] >= 0:
                turn = turn + load(lane, psi, OF_MOTION.end * table[b, MOTION] + level)
            elif level == 0:
                turn = turn + D[constants(model.mesh).offset]
            store(r, lam + ANGLE, turn * scale)


@kernel
def pin(lane, model, S, k):
    """Replace row and column k by those of the identity."""
    half, zero = model.half, splat(lane, 0.0)
    width = band_width(half)
    for j in range(max(0, k - half), min(model.n, k + half + 1)):
        store(S, k * width + j - k + half, zero)
        store(S, j * width + k - j + half, zero)
    store(S, k * width + half, splat(lane, 1.0))


@kernel
def factor(lane, model, S):
    """Band LU; the pivots lie behind the matrix."""
    n = model.n
    band_lu(lane, S, S[n * band_width(model.half) * len(lane) :], n, model.half, model.half)


@kernel
def solve(lane, model, S, x):
    """x <- S^-1 x."""
    n = model.n
    band_lu_solve(lane, S, S[n * band_width(model.half) * len(lane) :], x, n, model.half, model.half)


@kernel
def ports(lane, model, par, q, y):
    """Joint angles, then position and section angle at each point load."""
    segments = model.segments
    store(y, 0, load(lane, q, ANGLE))
    for k in range(1, model.links):
        b = k * segments - 1
        before = model.table[b, START]
        turned = tip(lane, model.mesh, model.data[model.block * b :], q[(before + ELASTIC) * len(lane) :])[2]
        turned = load(lane, q, before + ANGLE) + turned
        store(y, k, load(lane, q, model.table[b + 1, START] + ANGLE) - turned)
    ports_of_loads(lane, model, q, y)


register(
    FloatingFrame, assemble, constrain, pin, factor, solve, ports, damping_work, energy, link_poses, out_of_range, shape
)
