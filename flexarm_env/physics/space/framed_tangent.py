"""Newton's matrix of a segment with a floating frame in space (see `frame`, `framed`), its inner modes eliminated."""

from __future__ import annotations

from typing import Any, NamedTuple

from ...compiler import kernel, store
from ..arithmetic import put_vector, vector
from ..protocol import of_step
from .chain import factors_of
from .element import fill, rows_of, scale
from .frame import across, lifted
from .framed_motion import bent_rows, late_of, late_pull, plus_lifted, swung, with_swung
from .inner import HELIX, condense, constant, ends_by, inner_by
from .inner import product as product_of
from .layout import F, frame_at, inner_at, inner_of, inner_row
from .rotations import (
    about_identity,
    back,
    difference,
    dot,
    minus,
    outer,
    plus,
    plus_identity,
    product,
    scaled,
    skew,
    skewed,
    sum_of,
    times,
    transposed,
    turned,
)


@kernel
def _plus_diagonal(A, d):
    """A + diag(d)."""
    a, b, c = A
    return (a[0] + d[0], a[1], a[2]), (b[0], b[1] + d[1], b[2]), (c[0], c[1], c[2] + d[2])


@kernel
def _column(A, j):
    """Column j of A."""
    return A[0][j], A[1][j], A[2][j]


class Column(NamedTuple):
    """What three increments, of an end's place in the frame's axes or of its rotation, change."""

    d: Any  # 1, -1 or 0: of the right end's place against the left one's
    x_l: Any  # 1 or 0: the left end's place
    x_r: Any
    phi_l: Any
    phi_r: Any
    beta: Any  # the frame's rotation
    t_l: Any  # the left section's
    t_r: Any


class Bent(NamedTuple):
    """How the mass is off the chord: int m (1 - x/l) n, int m x/l n; of both rotations int m h h phi about y and z, by
    which it goes round the chord; with inner modes int m n^2."""

    near: Any
    far: Any
    left: Any
    right: Any
    roll: Any


@kernel
def _bent_inertia(lane, model, frame, at, q, row):
    """`Bent`."""
    a, b = frame.left.phi, frame.right.phi
    x, y = across(a), across(b)
    near = plus(scale(x, constant(lane, model, at.near, 0)), scale(y, constant(lane, model, at.near, 1)))
    far = plus(scale(x, constant(lane, model, at.far, 0)), scale(y, constant(lane, model, at.far, 1)))
    l, r = product_of(lane, model, at.lateral, a, b)
    roll = None
    if model.inner is not None:
        l, r = ends_by(lane, model, at.inner_lateral, 2, q, row, l, r)
        roll = dot(l, a) + dot(r, b)
        l = inner_by(lane, model, at.roll, 2, 0, a, b, q, row)
        r = inner_by(lane, model, at.roll, 2, 1, a, b, q, row)
        for i in range(inner_of(model)):
            own = vector(lane, q, row + 3 * i)
            roll = roll + dot(inner_by(lane, model, at.inner_lateral, 2, i, a, b, q, row), own)
            n = across(own)
            near = plus(near, scale(n, constant(lane, model, at.inner_near, i)))
            far = plus(far, scale(n, constant(lane, model, at.inner_far, i)))
    zero = l[0] * 0.0
    return Bent(near, far, (zero, l[1], l[2]), (zero, r[1], r[2]), roll)


@kernel
def _inner_own(lane, model, frame, at, k, q, row, mass):
    """Of inner mode k: H phi; int m h h phi about y and z, times mass."""
    a, b = frame.left.phi, frame.right.phi
    bow = times(inner_by(lane, model, at.roll, 2, k + 2, a, b, q, row), mass)
    return inner_by(lane, model, at.inner_coupling, 2, k, a, b, q, row), (bow[0] * 0.0, bow[1], bow[2])


@kernel
def _inner_column(lane, model, stiff, geometric, own, share, weights, at, k, by):
    """Rows of inner mode k by a `Column`; share: of EA / l. What of the ends these modes change is the same, turned."""
    cm, (slope, bow), pair = weights.mass, own, (inner_of(model) + 2) * k
    strain = plus(back(by.phi_l, stiff.slope_l), back(by.phi_r, stiff.slope_r))
    found = outer(slope, times((strain[0] + by.d, strain[1], strain[2]), share))
    hl = times(constant(lane, model, at.inner_coupling, pair), geometric)
    hr = times(constant(lane, model, at.inner_coupling, pair + 1), geometric)
    hl = plus(hl, times(constant(lane, model, at.inner_lateral, pair), cm))
    hr = plus(hr, times(constant(lane, model, at.inner_lateral, pair + 1), cm))
    found = sum_of(found, sum_of(rows_of(hl, by.phi_l), rows_of(hr, by.phi_r)))
    near, far = constant(lane, model, at.inner_near, k), constant(lane, model, at.inner_far, k)
    h, zero = times(plus(times(near, by.x_l), times(far, by.x_r)), cm), bow[0]
    found = sum_of(found, ((zero, zero, zero), (zero, zero, -h[2]), (zero, h[1], zero)))
    found = sum_of(found, outer((zero, -bow[2], bow[1]), by.beta[0]))
    turn = (inner_of(model) + 3) * k
    for j, part in ((0, by.t_l), (1, by.t_r), (2, by.beta)):
        found = sum_of(found, rows_of(times(constant(lane, model, at.inner_rotary, turn + j), cm), part))
    return found


@kernel
def _inner_pair(lane, model, par, slopes, share, rate, pull, weights, at, k, j, S, inner):
    """Rows of inner mode k by mode j, to the `INNER` at `inner` of S."""
    m, (one, two) = inner_of(model), slopes
    bend = times(constant(lane, model, at.inner_bend, m * k + j), rate)
    own = times(constant(lane, model, at.inner_coupling, (m + 2) * k + 2 + j), pull * weights.stiffness)
    own = plus(own, times(constant(lane, model, at.inner_lateral, (m + 2) * k + 2 + j), weights.mass))
    own = plus(own, times(constant(lane, model, at.inner_rotary, (m + 3) * k + 3 + j), weights.mass))
    own = plus(own, scale(bend, factors_of(lane, par)))
    block = outer(one, times(two, share))
    for a in range(3):
        for b in range(3):
            store(S, inner.matrix + 3 * m * (3 * k + a) + 3 * j + b, block[a][b] + own[a] if a == b else block[a][b])


@kernel
def _diagonal(lane, model, at, i, A, geometric, cm):
    """A and the i-th of what has the force in the chord and inertia of the bent shape."""
    d = times(constant(lane, model, at.coupling, i), geometric)
    return _plus_diagonal(A, plus(d, times(constant(lane, model, at.lateral, i), cm)))


@kernel
def _bending(lane, model, par, frame, stiff, pull, strong, rate, weights, at):
    """Symmetric derivative (ll, lr, rr) of the moments on phi_l, phi_r by these, with inertia of the bent shape.
    strong: EA / l, with its rate; pull: the force in the chord."""
    c, a, b = weights.stiffness, frame.left.phi, frame.right.phi
    (x, y, z), (a0, a1, a2), (b0, b1, b2) = times(minus(b, a), HELIX), times(a, 0.25), times(b, 0.25)
    zero, one = x * 0.0, x * 0.0 + 1.0
    near = (one, b2, -b1), (z - b2, one, x + b0), (b1 - y, -(b0 + x), one)
    far = (zero, -b2, b1), (z + b2, zero, x - b0), (-(b1 + y), b0 - x, zero)
    ll, _ = bent_rows(lane, model, par, a, b, near, far, at)
    near = (zero, -a2, a1), (a2 - z, zero, -(a0 + x)), (y - a1, a0 + x, zero)
    far = (one, a2, -a1), (-(a2 + z), one, a0 - x), (a1 + y, x - a0, one)
    lr, rr = bent_rows(lane, model, par, a, b, near, far, at)
    sl, sr, both = stiff.slope_l, stiff.slope_r, times(stiff.both, c)
    more = (zero, -both[2], both[1]), (-both[2], zero, zero), (both[1], zero, zero)
    ll = difference(sum_of(scaled(ll, rate), outer(times(sl, strong), sl)), more)
    lr = sum_of(sum_of(scaled(lr, rate), outer(times(sl, strong), sr)), difference(more, skew(times(stiff.apart, c))))
    rr = difference(sum_of(scaled(rr, rate), outer(times(sr, strong), sr)), more)
    cm, geometric = weights.mass, pull * c
    return (
        _mirrored(_diagonal(lane, model, at, 0, ll, geometric, cm)),
        _diagonal(lane, model, at, 1, lr, geometric, cm),
        _mirrored(_diagonal(lane, model, at, 2, rr, geometric, cm)),
    )


@kernel
def _mirrored(A):
    """The upper part of A and its mirror image."""
    return A[0], (A[0][1], A[1][1], A[1][2]), (A[0][2], A[1][2], A[2][2])


class Turned(NamedTuple):
    """Derivative of moments by rotations: of the sections (l, r) and of the frame (b), rows before columns."""

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
    """Rows of the sections' rotations and of the frame's, of moments on phi_l, phi_r."""
    return product(transposed(P), left), product(transposed(Q), right), sum_of(product(P, left), product(Q, right))


@kernel
def _turned(lane, model, frame, now, bending, late, bent, weights, at):
    """`Turned`, where d phi = T dth - T' dbeta of either end."""
    cm, c, P, Q = weights.mass, weights.stiffness, frame.left.T, frame.right.T
    Pt, Qt, (ll, lr, rr) = transposed(P), transposed(Q), bending
    rl = transposed(lr)
    ll_by, rl_by, lr_by, rr_by = product(ll, P), product(rl, P), product(lr, Q), product(rr, Q)
    l_by, r_by = sum_of(product(ll, Pt), product(lr, Qt)), sum_of(product(rl, Pt), product(rr, Qt))
    if late is not None:
        ll_by, rl_by = sum_of(ll_by, late.left[0]), sum_of(rl_by, late.left[1])
        lr_by, rr_by = sum_of(lr_by, late.right[0]), sum_of(rr_by, late.right[1])
        l_by, r_by = difference(l_by, late.frame[0]), difference(r_by, late.frame[1])
    ll, rl, bl = _rows_by(P, Q, ll_by, rl_by)
    lr, rr, br = _rows_by(P, Q, lr_by, rr_by)
    lb, rb, bb = _rows_by(P, Q, l_by, r_by)
    # inertia about the chord; without inner modes as if h were one in both planes
    ul, ur = times(bent.left, cm), times(bent.right, cm)
    vl, vr = lifted(ul), lifted(ur)
    vl, vr, roll = turned(Pt, vl), turned(Qt, vr), plus(turned(P, vl), turned(Q, vr))
    own = dot(ul, frame.left.phi) + dot(ur, frame.right.phi)
    if bent.roll is not None:
        own = bent.roll * cm
    lb, rb, bl, br = _plus_column(lb, vl), _plus_column(rb, vr), _plus_row(bl, vl), _plus_row(br, vr)
    bb = (
        (bb[0][0] + (own - roll[0] * 2.0), bb[0][1] - roll[1], bb[0][2] - roll[2]),
        (bb[1][0] - roll[1], bb[1][1], bb[1][2]),
        (bb[2][0] - roll[2], bb[2][1], bb[2][2]),
    )
    # rotary inertia
    tl, tr, lc = (
        times(constant(lane, model, at.rotary, 0), cm),
        times(constant(lane, model, at.rotary, 2), cm),
        times(constant(lane, model, at.rotary, 3), cm),
    )
    rc, tc = times(constant(lane, model, at.rotary, 4), cm), times(constant(lane, model, at.rotary, 5), cm)
    tlr = times(constant(lane, model, at.rotary, 1), cm)
    # moments that turn: of T^-1 and T^-T, to first order
    half_l, half_r = times(now[1], 0.5 * c), times(now[2], 0.5 * c)
    on_l, on_r, off_l, off_r = skewed(half_l, P), skewed(half_r, Q), skewed(half_l, Pt), skewed(half_r, Qt)
    return Turned(
        sum_of(_plus_diagonal(ll, tl), on_l),
        _plus_diagonal(lr, tlr),
        difference(_plus_diagonal(lb, lc), off_l),
        _plus_diagonal(rl, tlr),
        sum_of(_plus_diagonal(rr, tr), on_r),
        difference(_plus_diagonal(rb, rc), off_r),
        sum_of(_plus_diagonal(bl, lc), on_l),
        sum_of(_plus_diagonal(br, rc), on_r),
        difference(_plus_diagonal(bb, tc), sum_of(off_l, off_r)),
    )


@kernel
def _plus_column(A, a):
    """a to the first column of - A."""
    one, two, three = A
    return (a[0] - one[0], -one[1], -one[2]), (a[1] - two[0], -two[1], -two[2]), (a[2] - three[0], -three[1], -three[2])


@kernel
def _plus_row(A, a):
    """a to the first row of - A."""
    return minus(a, A[0]), times(A[1], -1.0), times(A[2], -1.0)


@kernel
def _plus_roll(A, a, g):
    """A + a g^T of a g without y."""
    one, two, three = A
    return (
        (a[0] * g[0] + one[0], one[1], a[0] * g[2] + one[2]),
        (a[1] * g[0] + two[0], two[1], a[1] * g[2] + two[2]),
        (a[2] * g[0] + three[0], three[1], a[2] * g[2] + three[2]),
    )


@kernel
def _by_chord(frame, A):
    """Rows of the frame's rotation as those of the force between the ends, but for that along the chord."""
    share = frame.over
    return times(A[2], share), times(plus(A[1], times(A[0], frame.k)), -share)


@kernel
def _drawn(frame, left, right, bent, cm):
    """Inertia of an end's place with rotations, (its rows across the chord by the left section, by the right one; what
    the force between the ends has of it by places, across the chord) of an end whose share of the mass is `bent` off
    the chord by left phi_l + right phi_r."""
    P, Q, gl, gr = frame.left.T, frame.right.T, frame.left.g, frame.right.g
    hl, hr, n, Pt, Qt = times(left, cm), times(right, cm), times(bent, cm), transposed(P), transposed(Q)
    y, z = plus(times(Pt[2], hl[1]), times(Qt[2], hr[1])), plus(times(Pt[1], hl[2]), times(Qt[1], hr[2]))
    y, z = (-(y[0] + n[2]), -y[1], n[0] - y[2]), (z[0] + n[1], z[1] - n[0], z[2])  # by the frame
    by_l = plus(times(P[2], hl[1]), times(gl, y[0])), plus(times(P[1], -hl[2]), times(gl, z[0]))
    by_r = plus(times(Q[2], hr[1]), times(gr, y[0])), plus(times(Q[1], -hr[2]), times(gr, z[0]))
    x = n[2] * 0.0, n[2], -n[1]
    return by_l, by_r, _by_chord(frame, transposed((x, y, z)))


@kernel
def _across(A, rows):
    """A M A' where M has these rows for y and z."""
    y, z = turned(A, rows[0]), turned(A, rows[1])
    return (
        plus(times(y, A[0][1]), times(z, A[0][2])),
        plus(times(y, A[1][1]), times(z, A[1][2])),
        plus(times(y, A[2][1]), times(z, A[2][2])),
    )


@kernel
def _place_rows(A, x, rows, more):
    """A times the matrix of x and of the sums of both pairs of rows."""
    y, z = plus(rows[0], more[0]), plus(rows[1], more[1])
    return product(A, (x, y, z))


@kernel
def _less(rows):
    """Minus a pair of rows."""
    return times(rows[0], -1.0), times(rows[1], -1.0)


@kernel
def _columns(frame):
    """The `Column`s of the left end's place and rotation, and of the right one's."""
    a, b, share, zero = frame.left, frame.right, frame.over, frame.length * 0.0
    none, full = (zero, zero, zero), zero + 1.0
    nothing, one = (none, none, none), about_identity(full, none, zero, none)
    beta = (zero, zero, -(frame.k * share)), (zero, zero, -share), (zero, share, zero)
    dl, dr = scaled(product(transposed(a.T), beta), -1.0), scaled(product(transposed(b.T), beta), -1.0)
    left = Column(-full, full, zero, scaled(dl, -1.0), scaled(dr, -1.0), scaled(beta, -1.0), nothing, nothing)
    ll, lr = difference(a.T, outer(a.T[0], a.g)), scaled(outer(a.T[0], b.g), -1.0)
    rl, rr = scaled(outer(b.T[0], a.g), -1.0), difference(b.T, outer(b.T[0], b.g))
    turn_l = Column(zero, zero, zero, ll, rl, (a.g, none, none), one, nothing)
    turn_r = Column(zero, zero, zero, lr, rr, (b.g, none, none), nothing, one)
    return left, turn_l, Column(full, zero, full, dl, dr, beta, nothing, nothing), turn_r


@kernel
def tangent(lane, model, par, tau, frame, rates, spins, rate_l, stiff, pull, now, i, q, weights, S, f):
    """Derivative of `framed`, segment i, to the `FACTOR` at f of S: inertia of the unbent segment, material stiffness,
    how the force between the ends turns, and, to first order of phi, what the motion does to dampers and inertia.
    spins: of the sections; rate_l: `own` of the left `Vertex`."""
    at, row = frame_at(model, i), inner_row(model, i)
    rate = weights.stiffness
    if tau is not None:
        rate = tau * weights.damping + rate
    cm, c, a, b, A, share = weights.mass, weights.stiffness, frame.left, frame.right, frame.A, frame.over
    bent, strong = _bent_inertia(lane, model, frame, at, q, row), rate * model.frames[at.pull]
    bending = _bending(lane, model, par, frame, stiff, pull, strong, rate, weights, at)
    step, late = of_step(weights), None
    if tau is not None:
        late = late_of(lane, model, par, frame, rates, spins, stiff, tau * c * step, at)
    of = _turned(lane, model, frame, now, bending, late, bent, weights, at)
    # by the sections alone: the frame rolls with them
    on_l, on_r, roll = _column(of.lb, 0), _column(of.rb, 0), _column(of.bb, 0)
    couple_l, couple_r = _plus_roll(of.bl, roll, a.g), _plus_roll(of.br, roll, b.g)
    ll, rr = _plus_roll(of.ll, on_l, a.g), _plus_roll(of.rr, on_r, b.g)
    lr, rl = _plus_roll(of.lr, on_l, b.g), _plus_roll(of.rl, on_r, a.g)
    ll, lr = sum_of(ll, outer(a.g, couple_l[0])), sum_of(lr, outer(a.g, couple_r[0]))
    rl, rr = sum_of(rl, outer(b.g, couple_l[0])), sum_of(rr, outer(b.g, couple_r[0]))
    # the force between the ends by rotations, and, turned over, moments by that of the ends' places
    aside, strain = times(now[0], c), times(plus(turned(a.T, stiff.slope_l), turned(b.T, stiff.slope_r)), -1.0)
    x_l = times(plus(back(a.T, stiff.slope_l), times(a.g, strain[0])), strong)
    x_r = times(plus(back(b.T, stiff.slope_r), times(b.g, strain[0])), strong)
    late_l, late_r, (late_y, late_z) = late_pull(frame, late)
    push_l, push_r = _by_chord(frame, couple_l), _by_chord(frame, couple_r)
    push_l = minus(push_l[0], times(a.g, aside[2])), plus(push_l[1], times(a.g, aside[1]))
    push_r = minus(push_r[0], times(b.g, aside[2])), plus(push_r[1], times(b.g, aside[1]))
    lift_l = _by_chord(frame, _plus_roll(transposed(of.lb), of.bb[0], a.g))
    lift_r = _by_chord(frame, _plus_roll(transposed(of.rb), of.bb[0], b.g))
    # by places
    y, z = _by_chord(frame, of.bb)
    zero, lean = share * 0.0, frame.k
    sway = _by_chord(frame, transposed(((zero, zero, zero), y, z)))
    by_y = (strain[2] * strong - aside[1]) * share
    by_z = ((strain[1] + strain[0] * lean) * strong + aside[2]) * -share
    y = by_y, sway[0][1] + aside[0] * share, sway[1][1] + aside[2] * lean * share
    z = by_z, sway[0][2], sway[1][2] + (aside[0] - aside[1] * lean) * share
    D = product(product(A, ((strong, by_y + late_y, by_z + late_z), y, z)), transposed(A))
    near_l, near_r = constant(lane, model, at.near, 0), constant(lane, model, at.near, 1)
    far_l, far_r = constant(lane, model, at.far, 0), constant(lane, model, at.far, 1)
    near, far = _drawn(frame, near_l, near_r, bent.near, cm), _drawn(frame, far_l, far_r, bent.far, cm)
    drawn_l, drawn_r = _across(A, near[2]), _across(A, far[2])
    mass = times(constant(lane, model, at.mass, 0), cm)
    xx_ll = plus_identity(difference(D, sum_of(drawn_l, transposed(drawn_l))), mass[0])
    xx_lr = plus_identity(difference(difference(transposed(drawn_l), drawn_r), D), mass[1])
    xx_rl = plus_identity(difference(difference(drawn_l, transposed(drawn_r)), D), mass[1])
    xx_rr = plus_identity(sum_of(D, sum_of(drawn_r, transposed(drawn_r))), mass[2])
    # ends' tangents, which turn with the sections, beside their inertia
    cd = weights.damping * step
    spin_l, spin_r = swung(spins[0], rate_l, cd), swung(spins[1], times(rate_l, 0.0), cd)
    ll = plus_lifted(ll, constant(lane, model, at.lateral, 0), spin_l)
    lr = plus_lifted(lr, constant(lane, model, at.lateral, 1), spin_r)
    rl = plus_lifted(rl, constant(lane, model, at.lateral, 1), spin_l)
    rr = plus_lifted(rr, constant(lane, model, at.lateral, 2), spin_r)
    less_l, less_r = times(x_l, -1.0), times(x_r, -1.0)
    pull_l, pull_r = plus(x_l, late_l), plus(x_r, late_r)
    xt_ll = _place_rows(A, times(pull_l, -1.0), with_swung(near[0], near_l, spin_l), _less(push_l))
    xt_lr = _place_rows(A, times(pull_r, -1.0), with_swung(near[1], near_r, spin_r), _less(push_r))
    xt_rl = _place_rows(A, pull_l, with_swung(far[0], far_l, spin_l), push_l)
    xt_rr = _place_rows(A, pull_r, with_swung(far[1], far_r, spin_r), push_r)
    tx_ll, tx_lr = _place_rows(A, less_l, near[0], _less(lift_l)), _place_rows(A, x_l, far[0], lift_l)
    tx_rl, tx_rr = _place_rows(A, less_r, near[1], _less(lift_r)), _place_rows(A, x_r, far[1], lift_r)
    fill(S, f + F.LL, xx_ll, xt_ll, transposed(tx_ll), ll)
    fill(S, f + F.LR, xx_lr, xt_lr, transposed(tx_lr), lr)
    fill(S, f + F.RL, xx_rl, xt_rl, transposed(tx_rl), rl)
    fill(S, f + F.RR, xx_rr, xt_rr, transposed(tx_rr), rr)
    if model.inner is not None:
        inner, B = inner_at(model, i), transposed(A)
        left, turn_l, right, turn_r = _columns(frame)
        more = turned(A, (zero, late_y, late_z))
        by_all = (0, left, times(more, -1.0)), (3, turn_l, late_l), (6, right, more), (9, turn_r, late_r)
        for k in range(inner_of(model)):
            own = _inner_own(lane, model, frame, at, k, q, row, weights.mass)
            for first, by, late_by in by_all:
                block = _inner_column(lane, model, stiff, pull * weights.stiffness, own, strong, weights, at, k, by)
                if first == 0 or first == 6:
                    block = product(block, B)
                for j in range(3):
                    put_vector(S, inner.ends + 12 * (3 * k + j) + first, block[j])
                    put_vector(S, inner.over + 12 * (3 * k + j) + first, plus(block[j], times(late_by, own[0][j])))
            for j in range(inner_of(model)):
                other = inner_by(lane, model, at.inner_coupling, 2, j, a.phi, b.phi, q, row)
                _inner_pair(lane, model, par, (own[0], other), strong, rate, pull, weights, at, k, j, S, inner)
        condense(lane, model, S, f, inner)
