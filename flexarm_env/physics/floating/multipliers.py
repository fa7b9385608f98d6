"""Floating frames joined by Lagrange multipliers, the paper's own form: equations [34]-[38], [64], [65], [72]-[78].

Each body has its own rows: R_x, R_y (inertial axes) and theta of its frame, then its elastic coordinates q. The
constraints Phi (theory, 3.4) require that the body's tip is the origin of the next frame. If the joint is rigid or
prescribed, Phi also requires that the angle of the tip section equals the next frame's angle. Order of rows: body 0,
multipliers of the joint at its tip, body 1, .... The matrix is banded. The kernels of module `body` compute the forces
and the matrix of each body. For a body, the multipliers of the joint at its tip are a force at the tip like any other.

S contains the band, the pivots of its factors, and the `FACTORS` of one body as scratch memory. The kernels compute one
arm at a time, because pivoting exchanges rows.
"""

from ...compiler import Lanes, kernel, size, stack
from ..arithmetic import load_pair, rotate_2d, store_pair, store_vector
from ..layout import OF_MOTION
from ..linalg import band_lu, band_lu_solve
from ..model import PAYLOAD_INERTIA, PAYLOAD_MASS, FloatingFrame
from ..protocol import State, register
from .body import constants, forces, propagate_to_tip, tip
from .chain import diagonal, frame_at, payload_force, subtract_loads
from .chain_inputs import load_displacements
from .chain_output import centerline, damping_power, energy, link_poses, out_of_range
from .layout import ANGLE, ELASTIC, KNOWN, MOTION, MULTIPLIERS, NOW, START, factors_at
from .matrix import add_outboard, tangent

THREE, FIVE, NINE = (0,) * 3, (0,) * 5, (0,) * 9
NUMBERS, MOVES = (0,) * KNOWN.end, (0,) * NOW.end


@kernel
def band_width(half):
    """Return the number of entries per row of a band matrix with `half` diagonals on each side, including fill-in."""
    return 3 * half + 1


@kernel
def assemble(lane, model, par: Lanes, state: State, u: Lanes, weights, r: Lanes, S: Lanes):
    """Compute the residual r of equation [64] and the banded matrix of equations [72]-[78] (see `protocol.assemble`).

    Rows of r: force (inertial axes) and moment of each body's frame, then its elastic coordinates. Rows of multipliers
    are set to 0; `constraint_residual` writes them later. Entry (i, j) of the matrix is S[i band_width + j - i + half].

    The local array `held` (3,) contains the force and moment lambda of the joint between two bodies, plus an elbow's
    torque. Force and moment act at the tip of the body before the joint and, with opposite sign, at the root of the
    body after the joint. Without weights.with_matrix S does not change.
    """
    q, v, a = state
    cm, cc, ck, with_matrix = weights.mass, weights.damping, weights.stiffness, weights.with_matrix
    mesh, table, n, segments = model.mesh, model.table, size(model.mesh.n), model.segments
    pose, force, held, carried = stack(lane, FIVE), stack(lane, THREE), stack(lane, THREE), stack(lane, THREE)
    tail = stack(lane, NINE)
    known, vectors, strains = stack(lane, NUMBERS), stack(lane, mesh.scratch), stack(lane, mesh.strains)
    width, last, zero = band_width(model.half), table.shape[0] - 1, 0.0
    own = S[model.n * (width + 1) :]
    # S <- 0: entries of the band between two bodies' blocks are added to, not set
    if with_matrix:
        for k in range(model.n * width):
            S[k] = zero
    # u_0 acts on body 0 as the moment of a joint before it
    store_vector(lane, held, 0, (zero, zero, u[0]))
    store_pair(lane, carried, 0, (zero, zero))
    for b in range(last + 1):
        at, lam, D = table[b, START], table[b, START] + ELASTIC + n, model.data[model.block * b :]
        e, link = at + ELASTIC, b // segments
        # R, theta are rows of q; R'' - g, w, alpha of the tip section follow by (3.1)
        frame_at(lane, model, state, at, pose)
        propagate_to_tip(lane, mesh, D, q[e:], v[e:], a[e:], pose, own)
        for i in range(3):  # the joint before it and loads, at the root
            force[i] = -held[i]
        if b % segments == 0:
            subtract_loads(lane, model, link, 0, u, force)
        for i in range(3):  # the joint behind it, payload and loads, at the tip
            r[at + i] = force[i]
            held[i] = zero
        # Phi_q^T lambda: force and moment (inertial axes) of the joint at the tip; u adds the elbow's torque to the
        # moment
        for i in range(table[b, MULTIPLIERS]):
            held[i] = q[lam + i]
            r[lam + i] = zero
        if b < last and (b + 1) % segments == 0:
            held[2] += u[link + 1]
        for i in range(3):
            force[i] = held[i]
        # m_p (r'' - g) and J_p theta'' at the last tip (inertial axes)
        if b == last:
            payload_force(lane, par, pose, force, carried)
        if (b + 1) % segments == 0:
            subtract_loads(lane, model, link, 1, u, force)
        # r of R, theta, q by (3.2), and -(G, M) of the joint before on R, theta
        forces(lane, mesh, D, par, carried, q[e:], v[e:], a[e:], force, known, vectors, strains, own, r[e:])
        for i in range(3):
            r[at + i] += force[i]
        # dr/d(q, R, theta) of the body into the band, then Phi_q of the joint at its tip
        if with_matrix:
            tangent(lane, mesh, D, par, carried, cm, cc, ck, v[e:], a[e:], known, vectors, strains, own)
            if b == last:
                diagonal(lane, tail, zero, par[PAYLOAD_MASS], par[PAYLOAD_INERTIA] * cm)
                add_outboard(lane, mesh, D, own, tail)
            _to_band(lane, mesh, own, at, cm, model.half, S)
            if b < last:
                _join(lane, mesh, D, own, at, table[b, MULTIPLIERS], cm, model.half, S)


@kernel
def _to_band(lane, mesh, own: Lanes, at, cm, half, S: Lanes):
    """Write a body's matrix to its rows and columns of the band; rows of R are in inertial axes (theory, 3.5).

    Columns of the origin's acceleration are multiplied by cm, because R enters the residual only through its
    acceleration.

    # in       own: `FACTORS` of the body, whose matrix is overwritten. at: the body's first row. cm: weight of dr/da
    # out      S: the band of half-width `half`
    """
    n, width = size(mesh.n), band_width(half)
    places = factors_at(0, n)
    (c, s), W, wide = load_pair(lane, own, places.frame), places.matrix, n + 3
    # columns of the origin: from frame axes to inertial axes
    for i in range(wide):
        k = W + i * wide + n
        x, y = load_pair(lane, own, k)
        x, y = rotate_2d(c, s, x, y)
        store_pair(lane, own, k, (x * cm, y * cm))
    # rows of R: from frame axes to inertial axes
    for j in range(wide):
        k = W + n * wide + j
        x, y = rotate_2d(c, s, own[k], own[k + wide])
        own[k] = x
        own[k + wide] = y
    # the body's matrix has the order q, R'', theta; the band has R, theta, q
    for i in range(wide):
        row = at + (i + ELASTIC) % wide
        for j in range(wide):
            S[row * width + at + (j + ELASTIC) % wide - row + half] = own[W + i * wide + j]


@kernel
def _join(lane, mesh, D, own, at, rows, scale, half, S):
    """Write Phi_q of the joint at a body's tip, and its transpose, to the band, both times `scale` (theory, 3.5).

    Phi are the constraints of `constraint_residual`. Rows and columns of the constraints are those of the joint's
    multipliers.

    # in       own: `FACTORS` of the body (`frame`, `arm`); at: its first row; rows: 2 for a hinge, 3 with the angle;
    #          half: half-width of the band
    # out      S: rows and columns of the joint's multipliers
    """
    n = size(mesh.n)
    places = factors_at(0, n)
    (c, s), phi = load_pair(lane, own, places.frame), constants(mesh).tip_phi
    lam = at + ELASTIC + n
    # Phi_q (3.4): +1 of this body's x, y, theta, -1 of the next one's
    for k in range(rows):
        _both(lane, S, half, lam + k, at + k, scale)
        _both(lane, S, half, lam + k, lam + rows + k, -scale)
    # derivative of the tip's place by q, then theta; inertial axes
    for j in range(n + 1):  # q, then theta
        x, y = load_pair(lane, own, places.arm + 2 * j)
        x, y = rotate_2d(c, s, x * scale, y * scale)
        place = at + ELASTIC + j if j < n else at + ANGLE
        _both(lane, S, half, lam, place, x)
        _both(lane, S, half, lam + 1, place, y)
        # tip section's angle by q
        if rows == 3 and j < n:
            _both(lane, S, half, lam + ANGLE, place, scale * D[phi + j])


@kernel
def _both(lane, S: Lanes, half, i, j, x):
    """Write x into entries (i, j) and (j, i) of the band of half-width `half`."""
    S[i * band_width(half) + j - i + half] = x
    S[j * band_width(half) + i - j + half] = x


@kernel
def constraint_residual(lane, model, psi: Lanes, state: State, level, scale, r: Lanes):
    """Write the constraints [34]-[38], or their time derivatives, times `scale` to the rows of multipliers of r.

        Phi = (R_b + A t_b - R_{b+1},  angle of the tip section + psi - theta_{b+1})                   (theory, eq. 3.4)

    R, theta: origin (inertial axes) and angle of the frame of body b and of the next body.
    A: rotation matrix for the angle theta_b.
    t_b: tip in frame axes.
    level: 0 for Phi (m, rad), 1 and 2 for its time derivatives.
    psi: angles, rates and accelerations of prescribed joints (`MOTION`). A rigid joint has a constant angle instead. A
    free elbow has no row for the angle.
    """
    q, v, a = state
    table, n = model.table, size(model.mesh.n)
    pose, now = stack(lane, FIVE), stack(lane, MOVES)
    # level 0: Phi by places; 1: Phi' by rates; 2: Phi'' by accelerations
    x = q
    if level == 1:
        x = v
    elif level == 2:
        x = a
    for b in range(table.shape[0] - 1):
        at, D = table[b, START], model.data[model.block * b :]
        e, lam, behind = at + ELASTIC, at + ELASTIC + n, table[b + 1, START]
        # t, t', t'' of the tip relative to the origin R, frame axes
        frame_at(lane, model, state, at, pose)
        propagate_to_tip(lane, model.mesh, D, q[e:], v[e:], a[e:], pose, now)
        c, s = load_pair(lane, now, NOW.cos)
        tx, ty = load_pair(lane, now, NOW.tip + 2 * level)  # the tip's place, its rate, its acceleration
        r[lam] = (x[at] - x[behind] + c * tx - s * ty) * scale
        r[lam + 1] = (x[at + 1] - x[behind + 1] + s * tx + c * ty) * scale
        if table[b, MULTIPLIERS] == 3:
            # psi(t) in Phi_3 = theta_b + phi_t + psi - theta_(b+1), by its level: value, rate or second rate
            turn = pose[level] - x[behind + ANGLE]
            if table[b, MOTION] >= 0:
                turn = turn + psi[OF_MOTION.end * table[b, MOTION] + level]
            elif level == 0:
                turn = turn + D[constants(model.mesh).offset]
            r[lam + ANGLE] = turn * scale


@kernel
def add_stiffness(lane, model, S: Lanes, k, x):
    """Add the stiffness x (N m/rad) to diagonal entry k of the band matrix. If x is None, fix row and column k."""
    half, zero = model.half, 0.0
    width = band_width(half)
    if x is not None:
        S[k * width + half] += x
        return
    for j in range(max(0, k - half), min(model.n, k + half + 1)):
        S[k * width + j - k + half] = zero
        S[j * width + k - j + half] = zero
    S[k * width + half] = 1.0


@kernel
def factor(lane, model, S: Lanes):
    """Factor the band of S in place by LU with partial pivoting; pivots are stored in S after the band."""
    n = model.n
    band_lu(lane, S, S[n * band_width(model.half) :], n, model.half, model.half)


@kernel
def solve(lane, model, S: Lanes, x):
    """Replace the right side x by the solution S^-1 x (increments and multipliers), with the factors of `factor`."""
    n = model.n
    band_lu_solve(lane, S, S[n * band_width(model.half) :], x, n, model.half, model.half)


@kernel
def input_displacements(lane, model, par, q: Lanes, y: Lanes, since=None):
    """Write the displacements on which inputs do work to y: joint angles, then x, y and angle at each point load.

    The hub's joint angle is the angle of the first frame. The angle of elbow k is the angle of link k's first frame
    minus the angle of the tip section before the elbow (rad). Positions (m) are in inertial axes. since is not read,
    because angles in the plane add up.
    """
    segments = model.segments
    y[0] = q[ANGLE]
    for k in range(1, model.links):
        b = k * segments - 1
        # tip section before the elbow: theta + phi_t'q
        before = model.table[b, START]
        turned = tip(lane, model.mesh, model.data[model.block * b :], q[before + ELASTIC :])[2]
        turned = q[before + ANGLE] + turned
        y[k] = q[model.table[b + 1, START] + ANGLE] - turned
    load_displacements(lane, model, q, y)


register(
    FloatingFrame,
    assemble,
    constraint_residual,
    add_stiffness,
    factor,
    solve,
    input_displacements,
    damping_power,
    energy,
    link_poses,
    out_of_range,
    centerline,
)
