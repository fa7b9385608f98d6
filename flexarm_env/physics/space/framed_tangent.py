"""Newton's matrix of a segment with a floating frame in space (`framed`); inner modes are eliminated (theory, 9)."""

from __future__ import annotations

from typing import Any, NamedTuple

from ...compiler import Lanes, kernel
from ..arithmetic import store_vector
from .element import fill, rows_of
from .frame import cross_with_ex, ex_cross
from .framed_motion import bent_rows, late_of, late_pull, plus_lifted, swung, with_swung
from .inner import HELIX, condense, constant, ends_by, inner_by
from .inner import product as product_of
from .layout import F, factors_of, inner_at, inner_of, inner_row
from .rotations import Matrix, Vector, about_identity, dot, load_vector, outer, plus_identity, scale, skew, skewed
from .segments import frame_at


@kernel
def _plus_diagonal(A, d):
    """Return A + diag(d), the matrix A with the vector d added to its diagonal."""
    a, b, c = A
    return Matrix(Vector(a[0] + d[0], a[1], a[2]), Vector(b[0], b[1] + d[1], b[2]), Vector(c[0], c[1], c[2] + d[2]))


@kernel
def _column(A, j):
    """Return column j of the 3 x 3 matrix A as a `Vector`."""
    return A.T[j]


class Column(NamedTuple):
    """Derivatives by three increments: of an end's position (m, frame axes) or of its rotation (rad, section axes)."""

    d: Any  # 1, -1 or 0: derivative of the right end's position relative to the left end
    x_l: Any  # 1 or 0: derivative of the left end's position
    x_r: Any  # 1 or 0: derivative of the right end's position
    phi_l: Any  # 3 x 3: derivatives of the sections' rotations relative to the frame
    phi_r: Any
    beta: Any  # 3 x 3: derivative of the frame's rotation
    t_l: Any  # 3 x 3: derivatives of the sections' rotations
    t_r: Any


class Bent(NamedTuple):
    """Mass moments of a deflected segment; n is the deflection of its mass from the chord, in frame axes."""

    near: Any  # kg m: first moment, int m (1 - x/l) n
    far: Any  # kg m: first moment, int m x/l n
    left: Any  # kg m^2: int m h h phi about y, z of the left rotation, as n rotates about the chord
    right: Any
    roll: Any  # kg m^2: int m n^2; None without inner modes


@kernel
def _bent_inertia(lane, model, frame, at, q, row):
    """Return the `Bent` of a segment (9.3). q: coordinates. row: first row of its inner modes. at: `FRAME` offsets."""
    a, b = frame.left.phi, frame.right.phi
    x, y = cross_with_ex(a), cross_with_ex(b)
    near = scale(x, constant(lane, model, at.near, 0)) + scale(y, constant(lane, model, at.near, 1))
    far = scale(x, constant(lane, model, at.far, 0)) + scale(y, constant(lane, model, at.far, 1))
    l, r = product_of(lane, model, at.lateral, a, b)
    roll = None
    if model.inner is not None:
        l, r = ends_by(lane, model, at.inner_lateral, 2, q, row, l, r)
        roll = dot(l, a) + dot(r, b)
        l = inner_by(lane, model, at.roll, 2, 0, a, b, q, row)
        r = inner_by(lane, model, at.roll, 2, 1, a, b, q, row)
        for i in range(inner_of(model)):
            own = load_vector(lane, q, row + 3 * i)
            roll = roll + dot(inner_by(lane, model, at.inner_lateral, 2, i, a, b, q, row), own)
            n = cross_with_ex(own)
            near = near + scale(n, constant(lane, model, at.inner_near, i))
            far = far + scale(n, constant(lane, model, at.inner_far, i))
    zero = l[0] * 0.0
    return Bent(near, far, Vector(zero, l[1], l[2]), Vector(zero, r[1], r[2]), roll)


@kernel
def _inner_own(lane, model, frame, at, k, q, row, mass):
    """Return H phi (m) of inner mode k, and its inertia int m h_k n about y, z times mass, the weight of dr/da."""
    a, b = frame.left.phi, frame.right.phi
    bow = mass * inner_by(lane, model, at.roll, 2, k + 2, a, b, q, row)
    return inner_by(lane, model, at.inner_coupling, 2, k, a, b, q, row), Vector(bow[0] * 0.0, bow[1], bow[2])


@kernel
def _inner_column(lane, model, stiff, geometric, own, share, weights, at, k, by):
    """Return the 3 x 3 derivative of the moment (N m; rows x, y, z) on inner mode k by the coordinates of `by`.

    by: the coordinates (`Column`). own: result of `_inner_own`. share: weighted EA / l (N/m). geometric: weighted force
    along the chord (N)."""
    cm, (slope, bow), pair = weights.mass, own, (inner_of(model) + 2) * k
    # material: H phi (EA / l) d(stretch)
    strain = by.phi_l.T @ stiff.slope_l + by.phi_r.T @ stiff.slope_r
    found = outer(slope, share * Vector(strain[0] + by.d, strain[1], strain[2]))
    # pull H (geometric stiffness), and c_m int m h h: inertia of n, which is linear in phi
    hl = geometric * constant(lane, model, at.inner_coupling, pair)
    hr = geometric * constant(lane, model, at.inner_coupling, pair + 1)
    hl = hl + cm * constant(lane, model, at.inner_lateral, pair)
    hr = hr + cm * constant(lane, model, at.inner_lateral, pair + 1)
    found = found + (rows_of(hl, by.phi_l) + rows_of(hr, by.phi_r))
    # c_m int m h of the ends' places and of the roll beta_x (frame axes); then rotary inertia
    near, far = constant(lane, model, at.inner_near, k), constant(lane, model, at.inner_far, k)
    h, zero = cm * (by.x_l * near + by.x_r * far), bow[0]
    found = found + Matrix(Vector(zero, zero, zero), Vector(zero, zero, -h[2]), Vector(zero, h[1], zero))
    found = found + outer(Vector(zero, -bow[2], bow[1]), by.beta[0])
    turn = (inner_of(model) + 3) * k
    for j, part in ((0, by.t_l), (1, by.t_r), (2, by.beta)):
        found = found + rows_of(cm * constant(lane, model, at.inner_rotary, turn + j), part)
    return found


@kernel
def _inner_pair(lane, model, par, slopes, share, rate, pull, weights, at, k, j, S: Lanes, inner):
    """Store the derivative of the moment on inner mode k by inner mode j in the `INNER` record of the segment in S.

    slopes: H phi of both modes (m). share: weighted EA / l (N/m). rate: weight of K with damping. pull: chord's force
    (N)."""
    m, (one, two) = inner_of(model), slopes
    bend = rate * constant(lane, model, at.inner_K_EI, m * k + j)
    own = pull * weights.stiffness * constant(lane, model, at.inner_coupling, (m + 2) * k + 2 + j)
    own = own + weights.mass * constant(lane, model, at.inner_lateral, (m + 2) * k + 2 + j)
    own = own + weights.mass * constant(lane, model, at.inner_rotary, (m + 3) * k + 3 + j)
    own = own + scale(bend, factors_of(lane, par))
    block = outer(one, share * two)
    for a in range(3):
        for b in range(3):
            S[inner.matrix + 3 * m * (3 * k + a) + 3 * j + b] = block[a][b] + own[a] if a == b else block[a][b]


@kernel
def _diagonal(lane, model, at, i, A, geometric, cm):
    """Return A + diag(geometric H + cm h), one block of the derivative of moments on phi by phi (N m, frame axes).

    i: block (0: ll, 1: lr, 2: rr). A: material part. geometric: chord's force (N) times the weight of stiffness. cm:
    weight of mass. H: `FRAME.coupling`, m. h: `FRAME.lateral`, kg m^2. at: `FRAME` offsets."""
    d = geometric * constant(lane, model, at.coupling, i)
    return _plus_diagonal(A, d + cm * constant(lane, model, at.lateral, i))


@kernel
def _bending(lane, model, par, frame, stiff, pull, strong, rate, weights, at):
    """Return blocks (ll, lr, rr) of the symmetric derivative of the moments on phi_l, phi_r by phi, with inertia (N m).

    strong: EA / l with damping (N/m). rate: weight of K with damping. pull: chord's force (N). stiff: forces (`Stiff`)
    of the segment. Frame axes."""
    c, a, b = weights.stiffness, frame.left.phi, frame.right.phi
    (x, y, z), (a0, a1, a2), (b0, b1, b2) = HELIX * (b - a), 0.25 * a, 0.25 * b
    zero, one = x * 0.0, x * 0.0 + 1.0
    # d(strained rotations) by phi_l, then by phi_r
    near = Matrix(Vector(one, b2, -b1), Vector(z - b2, one, x + b0), Vector(b1 - y, -(b0 + x), one))
    far = Matrix(Vector(zero, -b2, b1), Vector(z + b2, zero, x - b0), Vector(-(b1 + y), b0 - x, zero))
    ll, _ = bent_rows(lane, model, par, a, b, near, far, at)
    near = Matrix(Vector(zero, -a2, a1), Vector(a2 - z, zero, -(a0 + x)), Vector(y - a1, a0 + x, zero))
    far = Matrix(Vector(one, a2, -a1), Vector(-(a2 + z), one, a0 - x), Vector(a1 + y, x - a0, one))
    lr, rr = bent_rows(lane, model, par, a, b, near, far, at)
    # stretch (H phi)(H phi)^T EA / l, and the second derivative of `framed._strained` times the moments
    sl, sr, both = stiff.slope_l, stiff.slope_r, c * stiff.both
    more = Matrix(Vector(zero, -both[2], both[1]), Vector(-both[2], zero, zero), Vector(both[1], zero, zero))
    ll = rate * ll + outer(strong * sl, sl) - more
    lr = rate * lr + outer(strong * sl, sr) + (more - skew(c * stiff.apart))
    rr = rate * rr + outer(strong * sr, sr) - more
    cm, geometric = weights.mass, pull * c
    return (
        _mirrored(_diagonal(lane, model, at, 0, ll, geometric, cm)),
        _diagonal(lane, model, at, 1, lr, geometric, cm),
        _mirrored(_diagonal(lane, model, at, 2, rr, geometric, cm)),
    )


@kernel
def _mirrored(A):
    """Return the symmetric matrix whose upper triangle is that of A."""
    return Matrix(A[0], Vector(A[0][1], A[1][1], A[1][2]), A.T[2])


class Turned(NamedTuple):
    """3 x 3 derivatives (N m) of moments by rotations. lr: left section's moment by the right section's; b: frame."""

    ll: Any
    lr: Any
    lb: Any
    rl: Any
    rr: Any
    rb: Any
    bl: Any
    br: Any
    bb: Any


@kernel
def _rows_by(P, Q, left, right):
    """Return P^T left, Q^T right, P left + Q right: derivatives of both sections' moments and of minus the frame's."""
    # P, Q: T^-1 of both ends; left, right: derivatives (3 x 3) of the moments on phi_l, phi_r
    return P.T @ left, Q.T @ right, P @ left + Q @ right


@kernel
def _turned(lane, model, frame, now, bending, late, bent, weights, at):
    """Return the `Turned` of a segment: d phi = T^-1 dth - T^-T dbeta at each end, each rotation in its own axes.

    now: (force between the ends, moments on phi_l, phi_r). bending: from `_bending`. late: `Late` or None. bent: mass
    moments (`Bent`) of the segment."""
    cm, c, P, Q = weights.mass, weights.stiffness, frame.left.T, frame.right.T
    # d(moment on phi), d phi = T^-1 dth - T^-T dbeta: ll P by dth of the left section, ll P^T + lr Q^T by -dbeta
    Pt, Qt, (ll, lr, rr) = P.T, Q.T, bending
    rl = lr.T
    ll_by, rl_by, lr_by, rr_by = ll @ P, rl @ P, lr @ Q, rr @ Q
    l_by, r_by = ll @ Pt + lr @ Qt, rl @ Pt + rr @ Qt
    if late is not None:
        ll_by, rl_by = ll_by + late.left[0], rl_by + late.left[1]
        lr_by, rr_by = lr_by + late.right[0], rr_by + late.right[1]
        l_by, r_by = l_by - late.frame[0], r_by - late.frame[1]
    ll, rl, bl = _rows_by(P, Q, ll_by, rl_by)
    lr, rr, br = _rows_by(P, Q, lr_by, rr_by)
    lb, rb, bb = _rows_by(P, Q, l_by, r_by)
    # c_m int m n^2 about the chord (x of the frame); without inner modes as if h were one in both planes
    ul, ur = cm * bent.left, cm * bent.right
    vl, vr = ex_cross(ul), ex_cross(ur)
    vl, vr, roll = Pt @ vl, Qt @ vr, P @ vl + Q @ vr
    own = dot(ul, frame.left.phi) + dot(ur, frame.right.phi)
    if bent.roll is not None:
        own = bent.roll * cm
    lb, rb, bl, br = _plus_column(lb, vl), _plus_column(rb, vr), _plus_row(bl, vl), _plus_row(br, vr)
    bb = Matrix(
        Vector(bb[0][0] + (own - roll[0] * 2.0), bb[0][1] - roll[1], bb[0][2] - roll[2]),
        Vector(bb[1][0] - roll[1], bb[1][1], bb[1][2]),
        Vector(bb[2][0] - roll[2], bb[2][1], bb[2][2]),
    )
    # c_m times the rotary inertia int J of the sections l, r and the frame c
    tl, tr, lc = (
        cm * constant(lane, model, at.rotary, 0),
        cm * constant(lane, model, at.rotary, 2),
        cm * constant(lane, model, at.rotary, 3),
    )
    rc, tc = cm * constant(lane, model, at.rotary, 4), cm * constant(lane, model, at.rotary, 5)
    tlr = cm * constant(lane, model, at.rotary, 1)
    # moments that turn: of T^-1 and T^-T, to first order
    half_l, half_r = 0.5 * c * now[1], 0.5 * c * now[2]
    on_l, on_r, off_l, off_r = skewed(half_l, P), skewed(half_r, Q), skewed(half_l, Pt), skewed(half_r, Qt)
    return Turned(
        _plus_diagonal(ll, tl) + on_l,
        _plus_diagonal(lr, tlr),
        _plus_diagonal(lb, lc) - off_l,
        _plus_diagonal(rl, tlr),
        _plus_diagonal(rr, tr) + on_r,
        _plus_diagonal(rb, rc) - off_r,
        _plus_diagonal(bl, lc) + on_l,
        _plus_diagonal(br, rc) + on_r,
        _plus_diagonal(bb, tc) - (off_l + off_r),
    )


@kernel
def _plus_column(A, a):
    """Return -A with the vector a added to its first column."""
    one, two, three = A
    return Matrix(
        Vector(a[0] - one[0], -one[1], -one[2]),
        Vector(a[1] - two[0], -two[1], -two[2]),
        Vector(a[2] - three[0], -three[1], -three[2]),
    )


@kernel
def _plus_row(A, a):
    """Return -A with the vector a added to its first row."""
    return Matrix(a - A[0], -A[1], -A[2])


@kernel
def _plus_roll(A, a, g):
    """Return A + a g^T for a vector g with g_y = 0."""
    one, two, three = A
    return Matrix(
        Vector(a[0] * g[0] + one[0], one[1], a[0] * g[2] + one[2]),
        Vector(a[1] * g[0] + two[0], two[1], a[1] * g[2] + two[2]),
        Vector(a[2] * g[0] + three[0], three[1], a[2] * g[2] + three[2]),
    )


@kernel
def _by_chord(frame, A):
    """Return rows y, z of the force between the ends, m_z / l, -(m_y + k m_x) / l, from rows A of the moment m."""
    share = frame.over
    return share * A[2], -share * (A[1] + frame.k * A[0])


@kernel
def _drawn(frame, left, right, bent, cm):
    """Return the inertia coupling of an end's lateral position with rotations and lateral positions, in frame axes.

    left, right, bent: h of both ends' rotations, and n, times the end's share of the mass (kg m). cm: weight of mass.
    Returns rows y, z by the left section's rotation, rows y, z by the right section's, and force by the chord's y and
    z."""
    P, Q, gl, gr = frame.left.T, frame.right.T, frame.left.g, frame.right.g
    hl, hr, n, Pt, Qt = cm * left, cm * right, cm * bent, P.T, Q.T
    y, z = hl[1] * Pt[2] + hr[1] * Qt[2], hl[2] * Pt[1] + hr[2] * Qt[1]
    y, z = Vector(-(y[0] + n[2]), -y[1], n[0] - y[2]), Vector(z[0] + n[1], z[1] - n[0], z[2])  # by the frame
    by_l = hl[1] * P[2] + y[0] * gl, -hl[2] * P[1] + z[0] * gl
    by_r = hr[1] * Q[2] + y[0] * gr, -hr[2] * Q[1] + z[0] * gr
    x = Vector(n[2] * 0.0, n[2], -n[1])
    return by_l, by_r, _by_chord(frame, Matrix(x, y, z).T)


@kernel
def _across(A, rows):
    """Return A M A^T; row x of M is zero, its rows y and z are `rows`. A: rotation from frame axes to inertial axes."""
    y, z = A @ rows[0], A @ rows[1]
    return Matrix(A[0][1] * y + A[0][2] * z, A[1][1] * y + A[1][2] * z, A[2][1] * y + A[2][2] * z)


@kernel
def _place_rows(A, x, rows, more):
    """Return A M; M has the row x and, as rows y and z, the sums of rows and more. A: frame axes to inertial axes."""
    y, z = rows[0] + more[0], rows[1] + more[1]
    return A @ Matrix(x, y, z)


@kernel
def _less(rows):
    """Return two rows with opposite signs."""
    return -rows[0], -rows[1]


@kernel
def _columns(frame):
    """Return `Column`s for left position and rotation, then right (positions: frame axes; rotations: section axes)."""
    a, b, share, zero = frame.left, frame.right, frame.over, frame.length * 0.0
    none, full = Vector(zero, zero, zero), zero + 1.0
    nothing, one = Matrix(none, none, none), about_identity(full, none, zero, none)
    beta = Matrix(Vector(zero, zero, -(frame.k * share)), Vector(zero, zero, -share), Vector(zero, share, zero))
    dl, dr = -(a.T.T @ beta), -(b.T.T @ beta)
    left = Column(-full, full, zero, -dl, -dr, -beta, nothing, nothing)
    ll, lr = a.T - outer(a.T[0], a.g), -outer(a.T[0], b.g)
    rl, rr = -outer(b.T[0], a.g), b.T - outer(b.T[0], b.g)
    turn_l = Column(zero, zero, zero, ll, rl, Matrix(a.g, none, none), one, nothing)
    turn_r = Column(zero, zero, zero, lr, rr, Matrix(b.g, none, none), nothing, one)
    return left, turn_l, Column(full, zero, full, dl, dr, beta, nothing, nothing), turn_r


@kernel
def tangent(lane, model, par, tau, frame, rates, spins, rate_l, stiff, pull, now, i, q, weights, S, f):
    """Store the derivative of `framed` for segment i in the `FACTOR` at offset f of S, in the axes of `framed`.

    The parts are inertia of the unbent segment, material stiffness, rotation of the force between the ends, and, to
    first order of phi, velocity-dependent damping and inertia. spins: sections' angular velocities, section axes.
    rate_l: `own` of the left `Vertex`. tau: s or None. pull: bounded force along the chord. now: (force between the
    ends, moments on phi). See docs/theory.md, (9.3)."""
    at, row = frame_at(model, i), inner_row(model, i)
    rate = weights.stiffness
    if tau is not None:
        rate = tau * weights.damping + rate
    cm, c, a, b, A, share = weights.mass, weights.stiffness, frame.left, frame.right, frame.A, frame.over
    # dm/d(theta_l, theta_r, beta): elastic, dampers (newton_share), inertia
    bent, strong = _bent_inertia(lane, model, frame, at, q, row), rate * model.frames[at.pull]
    bending = _bending(lane, model, par, frame, stiff, pull, strong, rate, weights, at)
    step, late = weights.newton_share, None
    if tau is not None:
        late = late_of(lane, model, par, frame, rates, spins, stiff, tau * c * step, at)
    of = _turned(lane, model, frame, now, bending, late, bent, weights, at)
    # beta_x = g . theta of both sections: the frame's roll is not a coordinate
    on_l, on_r, roll = _column(of.lb, 0), _column(of.rb, 0), _column(of.bb, 0)
    couple_l, couple_r = _plus_roll(of.bl, roll, a.g), _plus_roll(of.br, roll, b.g)
    ll, rr = _plus_roll(of.ll, on_l, a.g), _plus_roll(of.rr, on_r, b.g)
    lr, rl = _plus_roll(of.lr, on_l, b.g), _plus_roll(of.rl, on_r, a.g)
    ll, lr = ll + outer(a.g, couple_l[0]), lr + outer(a.g, couple_r[0])
    rl, rr = rl + outer(b.g, couple_l[0]), rr + outer(b.g, couple_r[0])
    # x_l, x_r: force along the chord (frame axes) by theta; transposed, moments by places, but for dampers
    aside, strain = c * now[0], -(a.T @ stiff.slope_l + b.T @ stiff.slope_r)
    x_l = strong * (a.T.T @ stiff.slope_l + strain[0] * a.g)
    x_r = strong * (b.T.T @ stiff.slope_r + strain[0] * b.g)
    late_l, late_r, (late_y, late_z) = late_pull(frame, late)
    push_l, push_r = _by_chord(frame, couple_l), _by_chord(frame, couple_r)
    push_l = push_l[0] - aside[2] * a.g, push_l[1] + aside[1] * a.g
    push_r = push_r[0] - aside[2] * b.g, push_r[1] + aside[1] * b.g
    lift_l = _by_chord(frame, _plus_roll(of.lb.T, of.bb[0], a.g))
    lift_r = _by_chord(frame, _plus_roll(of.rb.T, of.bb[0], b.g))
    # force by places (frame axes): along x EA / l, across by beta_y, beta_z = (-d_z, d_y) / length
    y, z = _by_chord(frame, of.bb)
    zero, lean = share * 0.0, frame.k
    sway = _by_chord(frame, Matrix(Vector(zero, zero, zero), y, z).T)
    by_y = (strain[2] * strong - aside[1]) * share
    by_z = ((strain[1] + strain[0] * lean) * strong + aside[2]) * -share
    y = Vector(by_y, sway[0][1] + aside[0] * share, sway[1][1] + aside[2] * lean * share)
    z = Vector(by_z, sway[0][2], sway[1][2] + (aside[0] - aside[1] * lean) * share)
    D = A @ Matrix(Vector(strong, by_y + late_y, by_z + late_z), y, z) @ A.T
    # c_m int m (1 - xi, xi)^2 of places, and the rotation of n, the bent shape (frame axes)
    near_l, near_r = constant(lane, model, at.near, 0), constant(lane, model, at.near, 1)
    far_l, far_r = constant(lane, model, at.far, 0), constant(lane, model, at.far, 1)
    near, far = _drawn(frame, near_l, near_r, bent.near, cm), _drawn(frame, far_l, far_r, bent.far, cm)
    drawn_l, drawn_r = _across(A, near[2]), _across(A, far[2])
    mass = cm * constant(lane, model, at.mass, 0)
    xx_ll = plus_identity(D - (drawn_l + drawn_l.T), mass[0])
    xx_lr = plus_identity(drawn_l.T - drawn_r - D, mass[1])
    xx_rl = plus_identity(drawn_l - drawn_r.T - D, mass[1])
    xx_rr = plus_identity(D + (drawn_r + drawn_r.T), mass[2])
    # inertia of tangents e_x at both ends, whose second rate contains w x (w x e_x): cd, newton_share
    cd = weights.damping * step
    spin_l, spin_r = swung(spins[0], rate_l, cd), swung(spins[1], 0.0 * rate_l, cd)
    ll = plus_lifted(ll, constant(lane, model, at.lateral, 0), spin_l)
    lr = plus_lifted(lr, constant(lane, model, at.lateral, 1), spin_r)
    rl = plus_lifted(rl, constant(lane, model, at.lateral, 1), spin_l)
    rr = plus_lifted(rr, constant(lane, model, at.lateral, 2), spin_r)
    # force by rotation (xt, inertial axes) and moment by place (tx); dampers are in xt alone, so that S is not
    # symmetric
    less_l, less_r = -x_l, -x_r
    pull_l, pull_r = x_l + late_l, x_r + late_r
    xt_ll = _place_rows(A, -pull_l, with_swung(near[0], near_l, spin_l), _less(push_l))
    xt_lr = _place_rows(A, -pull_r, with_swung(near[1], near_r, spin_r), _less(push_r))
    xt_rl = _place_rows(A, pull_l, with_swung(far[0], far_l, spin_l), push_l)
    xt_rr = _place_rows(A, pull_r, with_swung(far[1], far_r, spin_r), push_r)
    tx_ll, tx_lr = _place_rows(A, less_l, near[0], _less(lift_l)), _place_rows(A, x_l, far[0], lift_l)
    tx_rl, tx_rr = _place_rows(A, less_r, near[1], _less(lift_r)), _place_rows(A, x_r, far[1], lift_r)
    fill(lane, S, f + F.LL, xx_ll, xt_ll, tx_ll.T, ll)
    fill(lane, S, f + F.LR, xx_lr, xt_lr, tx_lr.T, lr)
    fill(lane, S, f + F.RL, xx_rl, xt_rl, tx_rl.T, rl)
    fill(lane, S, f + F.RR, xx_rr, xt_rr, tx_rr.T, rr)
    if model.inner is not None:
        # inner modes: their rows by (r_l, theta_l, r_r, theta_r), then among each other; eliminated within the segment
        inner, B = inner_at(model, i), A.T
        left, turn_l, right, turn_r = _columns(frame)
        more = A @ Vector(zero, late_y, late_z)
        by_all = (0, left, -more), (3, turn_l, late_l), (6, right, more), (9, turn_r, late_r)
        for k in range(inner_of(model)):
            own = _inner_own(lane, model, frame, at, k, q, row, weights.mass)
            for first, by, late_by in by_all:
                block = _inner_column(lane, model, stiff, pull * weights.stiffness, own, strong, weights, at, k, by)
                if first == 0 or first == 6:
                    block = block @ B
                for j in range(3):
                    slot = 12 * (3 * k + j) + first
                    store_vector(lane, S, inner.ends + slot, block[j])
                    store_vector(lane, S, inner.over + slot, block[j] + own[0][j] * late_by)
            for j in range(inner_of(model)):
                other = inner_by(lane, model, at.inner_coupling, 2, j, a.phi, b.phi, q, row)
                _inner_pair(lane, model, par, (own[0], other), strong, rate, pull, weights, at, k, j, S, inner)
        condense(lane, model, S, f, inner)
