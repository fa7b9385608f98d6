"""A body's Newton matrix, cm dr/da + cc dr/dv + ck dr/dq, and its elimination from a chain (theory, section 3).

A body's matrix has n + 3 rows and columns. The first n rows and columns are for the elastic coordinates. The next two
rows are the force at the root; their columns are for the acceleration of the frame's origin (frame axes). The last row
is the moment at the root; its column is for the frame's angle.

A change of the preceding coordinates acts on the body through three numbers: the change of its root's acceleration (two
components) and of its root's angle. The change of acceleration is weighted: it is the sum of cm, cc, ck times the
changes by accelerations, rates, coordinates. `tail` (9,) is the 3 x 3 matrix, by rows, that maps these three numbers to
the change of force and moment. `tail` represents all bodies beyond a section.
"""

from ...compiler import Lanes, kernel, size, unrolled
from ..arithmetic import load_pair, load_vector, rotate_2d, rotate_back_2d, store_pair
from ..model import STIFFNESS_FACTOR
from .body import constants, damping_time, dot, turn_of_root
from .constants import span_at
from .layout import KNOWN, NOW, cell, factors_at, strain_at, vectors_at, window


@unrolled
@kernel
def tangent(lane, model, D, par: Lanes, carried, cm, cc, ck, v, a: Lanes, known, vectors: Lanes, strains, S: Lanes):
    """Compute the body's matrix cm dr/da + cc dr/dv + ck dr/dq, equations [72]-[78], derivative of `body.forces`.

    The columns are derivatives by the elastic coordinates q, by the acceleration of the frame's origin (x, y, frame
    axes) and by the frame's angle. Forces at the tip are constant here; `add_outboard` adds the effect of their change.
    E: matrix of a rotation by 90 deg. t: position of the tip relative to the origin.

    # model    D. par: the arm's parameters. cm, cc, ck: `Weights`
    # state    v, a; S: `NOW`; known, vectors, strains: written by `body.forces`; carried (2,): kg, kg m^2 at the tip
    # out      S: `FACTORS.frame`; `arm` = (dt/dq, E t); `swept` = weighted change of the tip's acceleration relative to
    #          the origin by q and angle, the bracket of (theory, eq. 3.3); `matrix`
    """
    own, n = constants(model), size(model.n)
    at, vec = factors_at(0, n), vectors_at(0, n)
    W, wide, theta = at.matrix, n + 3, n + 2
    # R'' - g, w, alpha; s_bar, its rate, f_R - m_t (R'' - g); force at the tip; I, I'/2
    ax, ay = load_pair(lane, S, at.now + NOW.a)
    w, alpha = load_pair(lane, S, at.now + NOW.rate)
    sx, sy = load_pair(lane, known, KNOWN.s)
    tx, ty = load_pair(lane, known, KNOWN.t)
    dx, dy = load_pair(lane, known, KNOWN.d)
    gx, gy = load_pair(lane, known, KNOWN.g)
    inertia, spin_rate = load_pair(lane, known, KNOWN.inertia)
    stiffness, tau = par[STIFFNESS_FACTOR], damping_time(lane, model, D, par)
    store_pair(lane, S, at.frame, load_pair(lane, S, at.now + NOW.cos))
    mass = D[own.mass]
    square, twice = w * w, w * (2.0 * cc)
    x, y = load_pair(lane, S, at.now + NOW.tip)
    ux, uy = load_pair(lane, S, at.now + NOW.tip_rate)
    bx, by = load_pair(lane, S, at.now + NOW.tip_second)
    # column of the angle: E t, and cm E t + 2 cc E t' + ck E t'' with the derivatives of t in inertial space
    store_pair(lane, S, at.arm + 2 * n, (-y, x))
    store_pair(lane, S, at.swept + 2 * n, (-(y * cm + uy * (2.0 * cc) + by * ck), x * cm + ux * (2.0 * cc) + bx * ck))
    zero = 0.0
    px, py, pt = W + n * wide, W + (n + 1) * wide, W + theta * wide  # rows of x, y, angle
    # by the origin's acceleration: df_R = m_t, df_theta = E s_bar
    store_pair(lane, S, px + n, (mass, zero))
    store_pair(lane, S, py + n, (zero, mass))
    store_pair(lane, S, pt + n, (-sy, sx))
    # by the angle: E times (cm s_bar + 2 cc (its rate) + ck d); forces that are constant in inertial axes turn back
    S[px + theta] = -(sy * cm) - (w * sx + ty) * (2.0 * cc) - dy * ck
    S[py + theta] = sx * cm - (w * sy - tx) * (2.0 * cc) + dx * ck
    S[pt + theta] = inertia * cm + spin_rate * (2.0 * cc) - ((sx * ax + sy * ay) + (x * gx + y * gy)) * ck
    # weight of elastic forces: ck + tau_d cc
    slope = ck
    if model.damped is not None:
        slope = tau * cc + ck
    bend = slope * stiffness
    # 2 w cc + alpha ck goes with E, w^2 ck with the identity
    spun, turned = twice + alpha * ck, square * ck
    for i in range(n):
        gq, cb, bv = vectors[vec.gq + i], vectors[vec.cb + i], vectors[vec.bv + i]
        gsx, gsy = vectors[vec.gsx + i], D[own.S_bar_y + i]
        tipx, tipy = vectors[vec.px + i], D[own.tip_v + i]
        # f_R by q_i: Gamma_i (cm - turned) + E Gamma_i spun
        along = gsx * cm - gsy * spun - gsx * turned
        across = gsy * cm + gsx * spun - gsy * turned
        # the same of the tip: (dt/dq_i) (cm - turned) + E (dt/dq_i) spun
        swept_x = tipx * cm - tipy * spun - tipx * turned
        swept_y = tipy * cm + tipx * spun - tipy * turned
        # Gamma and dt/dq of modes change with q: -D0, -H times v and a
        if model.modal is not None:
            dv, da = dot(lane, model, D, own.D0 + i * n, v), dot(lane, model, D, own.D0 + i * n, a)
            along, across = along - (dv * (2.0 * cc) + da * ck), across - (w * dv) * (2.0 * ck)
            dv, da = dot(lane, model, D, own.tip_H + i * n, v), dot(lane, model, D, own.tip_H + i * n, a)
            swept_x, swept_y = swept_x - (dv * (2.0 * cc) + da * ck), swept_y - (w * dv) * (2.0 * ck)
        store_pair(lane, S, at.arm + 2 * i, (tipx, tipy))
        store_pair(lane, S, at.swept + 2 * i, (swept_x, swept_y))
        S[px + i] = along
        S[py + i] = across
        # (B'a)_i: finite elements alone; -0.0 leaves sums bit-equal
        ba = -0.0
        if model.modal is None:
            ba = a[0] * D[own.B + i]
            for j in range(1, n):
                ba = ba + a[j] * D[own.B + j * n + i]
        # f_theta by q_i: (c + B q) cm + 2 w cc (c_u + G q) + ck (lever + 2 alpha (c_u + G q) + B'a + 2 w G v)
        gv = dot(lane, model, D, own.G + i * n, v)
        lever = (gsx * ay - gsy * ax) + (tipx * gy - tipy * gx)
        about = lever + (alpha * gq) * 2.0 + ba + (w * gv) * 2.0
        S[pt + i] = cb * cm + gq * twice + about * ck
        # row of q_i: Gamma_i by the acceleration; by the angle (c + B q) cm + 2 cc (B v - w (c_u + G q)) + ck lever
        row = W + i * wide
        store_pair(lane, S, row + n, (gsx, gsy))
        S[row + theta] = cb * cm + (bv - w * gq) * (2.0 * cc) + lever * ck
        # by q_j: elastic stiffness + cm M_ff - w^2 ck G + (2 w cc + alpha ck) B, minus what foreshortening takes
        for j in range(n):
            entry = bend * D[own.K_EI + i * n + j] + cm * D[own.M_ff + i * n + j]
            entry = entry - turned * D[own.G + i * n + j]
            if model.modal is None:
                entry = entry + spun * D[own.B + i * n + j]
                if model.full is None:
                    entry = entry + slope * D[own.K_EA + i * n + j]
            else:
                entry = entry - (ax * D[own.D0 + i * n + j] + gx * D[own.tip_H + i * n + j]) * ck
            if model.drag is not None:
                entry = entry + (cc * D[own.drag]) * D[own.M_ff + i * n + j]
            S[row + j] = entry
    _stretching(lane, model, D, tau, cc, ck, strains, S)
    if model.drag is not None:
        _drag_tangent(lane, model, D, carried, cc, ck, v, vectors, S)


@kernel
def _stretching(lane, model, D, tau, cc, ck, strains: Lanes, S: Lanes):
    """Add the finite elements' axial stiffness to the body's matrix: material part and geometric part N H.

        gradient_i (ck EA/l + cc tau_d EA/l) gradient_j + ck gradient_i tau_d EA/l (H v)_j + ck N H_ij

    i, j: coordinates of an element's window.
    gradient: derivative of the element's stretch.
    N: axial force of the element, N.
    H: coupling matrix `SPAN.H` of the element.
    v: rates of the coordinates.

    # in       tau: tau_d, s. cc, ck: weights of damping and stiffness. strains: a `STRAIN` per element
    # out      S: added to `FACTORS.matrix`

    See docs/theory.md, (1.2).
    """
    n, wide = size(model.n), len(model.window)
    W, own, kept = factors_at(0, n).matrix, span_at(constants(model).spans, wide), strain_at(0, wide)
    for e in range(len(model.elements)):
        first = window(model, n, e)
        force = strains[kept.force] * ck
        both, lag = D[own.stiffness] * ck, 0.0
        if model.damped is not None:
            both, lag = (tau * cc + ck) * D[own.stiffness], (tau * ck) * D[own.stiffness]
        for j in range(wide):
            if model.full is None:
                # the paper's force N G q: N changes with the linear stretch alone and is not damped
                change = ck * D[own.stiffness] * D[own.stretch + j]
            else:
                change = both * strains[kept.slope + j]
                if model.damped is not None:
                    change = change + lag * strains[kept.rate + j]
            for i in range(wide):
                entry = strains[kept.slope + i] * change + force * D[own.H + i * wide + j]
                place = W + (first + i) * (n + 3) + first + j
                S[place] += entry
        own, kept = span_at(own.end, wide), strain_at(kept.end, wide)


@kernel
def _drag_tangent(lane, model, D, carried: Lanes, cc, ck, v: Lanes, vectors: Lanes, S: Lanes):
    """Add the mass-proportional damping of the carried mass to the body's matrix; derivative of `body._mass_damping`.

        cc drag (m J'J + J_p phi phi') - ck drag m (terms of the change of J with q, modes alone)

    m, J_p = carried. J = dt/dq, phi: derivatives of the tip's position and of its angle by q.
    drag: coefficient of mass-proportional damping, 1/s.

    # in       carried (2,): mass (kg), inertia (kg m^2) at the tip; v: elastic rates; vectors: x row of J
    #          cc, ck: weights of dr/dv, dr/dq
    # out      S: added to `FACTORS.matrix`

    See docs/theory.md, section 2.
    """
    own, n = constants(model), size(model.n)
    W, px = factors_at(0, n).matrix, vectors_at(0, n).px
    mass, inertia = carried[0] * D[own.drag], carried[1] * D[own.drag]
    # velocity of the tip along the frame's axis
    tx = 0.0
    for i in range(n):
        tx = tx + vectors[px + i] * v[i]
    for i in range(n):
        xi, yi, phi = vectors[px + i], D[own.tip_v + i], D[own.tip_phi + i]
        for j in range(n):
            entry = (xi * vectors[px + j] + yi * D[own.tip_v + j]) * mass
            entry = (entry + inertia * (phi * D[own.tip_phi + j])) * cc
            if model.modal is not None:
                lost = xi * dot(lane, model, D, own.tip_H + j * n, v) + tx * D[own.tip_H + i * n + j]
                entry = entry - (lost * mass) * ck
            place = W + i * (n + 3) + j
            S[place] += entry


@unrolled
@kernel
def add_outboard(lane, model, D, S: Lanes, tail: Lanes):
    """Add the matrix of all bodies beyond the tip to the body's matrix: arm' tail swept. See docs/theory.md, (3.3).

    arm contains the derivatives of the tip section's displacement and rotation by each coordinate. swept contains the
    derivatives of the tip section's weighted acceleration (cm, cc, ck times the derivatives by accelerations, rates,
    coordinates) and of its rotation. arm and swept are in frame axes.

    # in       tail (9,): change of force (N) and moment (N m) at the tip section by its weighted acceleration and its
    #          angle, inertial axes; overwritten by the same matrix in the axes of the body's frame
    # in, out  S: `FACTORS.matrix` (n + 3, n + 3); reads `frame`, `arm`, `swept`
    """
    own, n = constants(model), size(model.n)
    at = factors_at(0, n)
    W, wide = at.matrix, n + 3
    # tail in frame axes: A' tail A
    c, s = load_pair(lane, S, at.frame)
    _turn_matrix(lane, tail, c, -s)
    for j in range(wide):
        # (R'', theta) of the tip by column j (frame axes), and tail times it: the force (f_x, f_y) and moment m
        if j < n:
            bx, by = load_pair(lane, S, at.swept + 2 * j)
            fx, fy, m = _times(lane, tail, bx, by, D[own.tip_phi + j])
        elif j == wide - 1:
            bx, by = load_pair(lane, S, at.swept + 2 * n)
            fx, fy, m = _times(lane, tail, bx, by, 1.0)
        else:
            k = j - n
            fx, fy, m = tail[cell(0, k)], tail[cell(1, k)], tail[cell(2, k)]
        for i in range(wide):
            k = W + i * wide + j
            # virtual work on q_i: p_i . f + phi_t,i m
            if i < n:
                px, py = load_pair(lane, S, at.arm + 2 * i)
                part = px * fx + py * fy + m * D[own.tip_phi + i]
            elif i == n:
                part = fx
            elif i == n + 1:
                part = fy
            else:
                px, py = load_pair(lane, S, at.arm + 2 * n)
                part = px * fx + py * fy + m
            S[k] += part


@unrolled
@kernel
def condense(lane, model, D, S: Lanes, tail: Lanes):
    """Eliminate a body's elastic coordinates; return the remaining matrix as `tail` of the preceding body.

    The remaining matrix maps the acceleration (weighted by cm, cc, ck, as in `add_outboard`) and the angle of the root
    section to the change of force and moment at the root. The factors L and U, with inverted pivots, remain in S. No
    pivoting is needed, because the positive definite cm M outweighs the other terms.

    # in, out  tail (9,): matrix of force and moment by acceleration and angle (inertial axes), at the tip section of
    #          the body for all bodies beyond, then at its root section: the Schur complement of the elastic rows
    # in, out  S: `FACTORS.matrix`, then its factors

    See docs/theory.md, (3.3).
    """
    add_outboard(lane, model, D, S, tail)
    own, n = constants(model), size(model.n)
    at = factors_at(0, n)
    W, wide, theta = at.matrix, n + 3, n + 2
    # replace the frame's angle by the root section's, theta = angle - rho'q: columns, then rows (r_q -= rho M_b)
    if model.chord is not None:
        for i in range(wide):
            last = S[W + i * wide + theta]
            for j in range(n):
                k = W + i * wide + j
                S[k] -= last * D[own.root + j]
        for j in range(wide):
            last = S[W + theta * wide + j]
            for i in range(n):
                k = W + i * wide + j
                S[k] -= last * D[own.root + i]
    # L U of the n rows of q, without pivoting: their block is near a positive definite K + c_m M
    for k in range(n):
        inverse = 1.0 / S[W + k * wide + k]
        S[W + k * wide + k] = inverse
        for i in range(k + 1, wide):
            f = S[W + i * wide + k] * inverse
            S[W + i * wide + k] = f
            for j in range(k + 1, wide):
                place = W + i * wide + j
                S[place] -= f * S[W + k * wide + j]
    # Schur complement, back to inertial axes
    for i in range(3):
        for j in range(3):
            tail[cell(i, j)] = S[W + (n + i) * wide + n + j]
    c, s = load_pair(lane, S, at.frame)
    _turn_matrix(lane, tail, c, s)


@kernel
def _times(lane, tail, x, y, turn):
    """Return the 3 x 3 matrix `tail` times the vector (x, y, turn)."""
    one, two, three = load_vector(lane, tail, 0), load_vector(lane, tail, 3), load_vector(lane, tail, 6)
    return (
        one[0] * x + one[1] * y + one[2] * turn,
        two[0] * x + two[1] * y + two[2] * turn,
        three[0] * x + three[1] * y + three[2] * turn,
    )


@kernel
def _turn_matrix(lane, tail: Lanes, c, s):
    """Rotate the 3 x 3 matrix `tail` in place: Q tail Q'. Q rotates x and y by the angle with cosine c and sine s.

    With (c, s) of a frame, Q maps frame axes to inertial axes; with (c, -s), inertial axes to frame axes.
    """
    # A T: rows x, y
    for j in range(3):
        x, y = rotate_2d(c, s, tail[cell(0, j)], tail[cell(1, j)])
        tail[cell(0, j)] = x
        tail[cell(1, j)] = y
    # T A^T: columns x, y
    for i in range(3):
        x, y = load_pair(lane, tail, cell(i, 0))
        store_pair(lane, tail, cell(i, 0), rotate_2d(c, s, x, y))


@unrolled
@kernel
def reduce(lane, model, D, S: Lanes, x: Lanes, flow: Lanes):
    """Substitute forward in one body: x <- L^-1 x in the rows of the body's elastic coordinates.

    # in       S: factors that `condense` stored
    # in, out  x (n,): right side, then the reduced right side
    # in, out  flow (3,): force and moment (inertial axes) that the reduced right sides of the bodies beyond cause;
    #          in: at the tip section; out: at the root section, to be subtracted from the right side there

    See docs/theory.md, (3.3).
    """
    own, n = constants(model), size(model.n)
    at = factors_at(0, n)
    W, wide, theta = at.matrix, n + 3, n + 2
    c, s = load_pair(lane, S, at.frame)
    fx, fy, moment = load_vector(lane, flow, 0)
    # force and moment in frame axes, moment about the frame's origin
    gx, gy = rotate_back_2d(c, s, fx, fy)
    px, py = load_pair(lane, S, at.arm + 2 * n)
    turning = px * gx + py * gy + moment
    left_x, left_y, left_t = gx, gy, turning
    for i in range(n):
        px, py = load_pair(lane, S, at.arm + 2 * i)
        # b_i - p_i . g - phi_t,i M, then less L_ik b_k of the rows before
        total = x[i] - (px * gx + py * gy) - moment * D[own.tip_phi + i]
        if model.chord is not None:
            total = total + turning * D[own.root + i]
        for j in range(i):
            total = total - S[W + i * wide + j] * x[j]
        x[i] = total
        # S_(root, i) U_ii^-1 b_i: what the eliminated rows require of (f, m) at the root
        left_x = left_x + S[W + n * wide + i] * total
        left_y = left_y + S[W + (n + 1) * wide + i] * total
        left_t = left_t + S[W + theta * wide + i] * total
    store_pair(lane, flow, 0, rotate_2d(c, s, left_x, left_y))
    flow[2] = left_t


@unrolled
@kernel
def restore(lane, model, D, S: Lanes, x: Lanes, flow: Lanes):
    """Substitute back in one body: x <- increments of the body's elastic coordinates. See docs/theory.md, (3.3).

    # in       S: factors that `condense` stored, and `FACTORS.swept`
    # in, out  x (n,): reduced right side, then the solution
    # in, out  flow (3,): change of acceleration (weighted as in `add_outboard`, inertial axes) and of angle,
    #          in: at the root section; out: at the tip section
    """
    own, n = constants(model), size(model.n)
    at = factors_at(0, n)
    W, wide, theta = at.matrix, n + 3, n + 2
    c, s = load_pair(lane, S, at.frame)
    fx, fy, turn = load_vector(lane, flow, 0)
    bx, by = rotate_back_2d(c, s, fx, fy)
    # U x = right side, less the columns of acceleration and angle; pivots are stored inverted
    for i in range(n - 1, -1, -1):
        row = W + i * wide
        total = x[i] - S[row + n] * bx - S[row + n + 1] * by
        total = total - S[row + theta] * turn
        for j in range(i + 1, n):
            total = total - S[row + j] * x[j]
        x[i] = total * S[row + i]
    # angle of the frame: root section's less rho'x
    if model.chord is not None:
        turn = turn - turn_of_root(lane, model, D, x)
    # R'' of the tip (frame axes): swept_theta dtheta + sum_i swept_i dq_i
    wx, wy = load_pair(lane, S, at.swept + 2 * n)
    bx, by = bx + wx * turn, by + wy * turn
    for j in range(n):
        wx, wy = load_pair(lane, S, at.swept + 2 * j)
        bx, by = bx + wx * x[j], by + wy * x[j]
    store_pair(lane, flow, 0, rotate_2d(c, s, bx, by))
    flow[2] = turn + dot(lane, model, D, own.tip_phi, x)
