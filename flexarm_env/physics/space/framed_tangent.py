"""Newton's matrix of a segment with a floating frame in space (see `frame`, `framed`), its inner modes eliminated."""

from __future__ import annotations

from typing import Any, NamedTuple

from ...compiler import kernel, load, store
from ..model import STIFFNESS_FACTOR
from .element import fill, scale
from .frame import across
from .inner import HELIX, condense, constant, ends_by, inner_by
from .inner import product as product_of
from .layout import F, frame_at, inner_at, inner_of, inner_row
from .rotations import (
    about_identity,
    back,
    difference,
    dot,
    minus,
    plus,
    product,
    put_vector,
    scaled,
    skew,
    sum_of,
    times,
    transposed,
    vector,
)


@kernel
def _outer(a, b):
    """a b^T."""
    return times(b, a[0]), times(b, a[1]), times(b, a[2])


@kernel
def _rows(d, A):
    """diag(d) A."""
    return times(A[0], d[0]), times(A[1], d[1]), times(A[2], d[2])


@kernel
def _both_rows(lane, model, table, A, B):
    """`product_of` of matrices."""
    ll, lr, rr = constant(lane, model, table, 0), constant(lane, model, table, 1), constant(lane, model, table, 2)
    return sum_of(_rows(ll, A), _rows(lr, B)), sum_of(_rows(lr, A), _rows(rr, B))


@kernel
def _rows_across(h, A):
    """h (phi x e_x) where phi's rows are A."""
    return times(A[0], 0.0), times(A[2], h[1]), times(A[1], -h[2])


@kernel
def _cross_row(u, A):
    """The first row of u^ A."""
    return minus(times(A[2], u[1]), times(A[1], u[2]))


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
    """How the mass is off the chord: int m (1 - x/l) n, int m x/l n; of both rotations int m h h phi about y and z."""

    near: Any
    far: Any
    left: Any
    right: Any


@kernel
def _bent_inertia(lane, model, frame, at, q, row):
    """`Bent`."""
    a, b = frame.left.phi, frame.right.phi
    x, y = across(a), across(b)
    near = plus(scale(x, constant(lane, model, at.near, 0)), scale(y, constant(lane, model, at.near, 1)))
    far = plus(scale(x, constant(lane, model, at.far, 0)), scale(y, constant(lane, model, at.far, 1)))
    l, r = product_of(lane, model, at.lateral, a, b)
    if model.inner is not None:
        l, r = ends_by(lane, model, at.inner_lateral, 2, q, row, l, r)
        for i in range(inner_of(model)):
            n = across(vector(lane, q, row + 3 * i))
            near = plus(near, scale(n, constant(lane, model, at.inner_near, i)))
            far = plus(far, scale(n, constant(lane, model, at.inner_far, i)))
    zero = l[0] * 0.0
    return Bent(near, far, (zero, l[1], l[2]), (zero, r[1], r[2]))


@kernel
def _inner_own(lane, model, frame, at, k, q, row, mass):
    """Of inner mode k: H phi; int m h h phi about y and z, times mass."""
    a, b = frame.left.phi, frame.right.phi
    bow = times(inner_by(lane, model, at.inner_lateral, 2, k, a, b, q, row), mass)
    return inner_by(lane, model, at.inner_coupling, 2, k, a, b, q, row), (bow[0] * 0.0, bow[1], bow[2])


@kernel
def _inner_column(lane, model, stiff, geometric, own, share, weights, at, k, by):
    """Rows of inner mode k by a `Column`; share: of EA / l. What of the ends these modes change is the same, turned."""
    cm, (slope, bow), pair = weights.mass, own, (inner_of(model) + 2) * k
    strain = plus(back(by.phi_l, stiff.slope_l), back(by.phi_r, stiff.slope_r))
    found = _outer(slope, times((strain[0] + by.d, strain[1], strain[2]), share))
    hl = times(constant(lane, model, at.inner_coupling, pair), geometric)
    hr = times(constant(lane, model, at.inner_coupling, pair + 1), geometric)
    hl = plus(hl, times(constant(lane, model, at.inner_lateral, pair), cm))
    hr = plus(hr, times(constant(lane, model, at.inner_lateral, pair + 1), cm))
    found = sum_of(found, sum_of(_rows(hl, by.phi_l), _rows(hr, by.phi_r)))
    near, far = constant(lane, model, at.inner_near, k), constant(lane, model, at.inner_far, k)
    h, zero = times(plus(times(near, by.x_l), times(far, by.x_r)), cm), bow[0]
    found = sum_of(found, ((zero, zero, zero), (zero, zero, -h[2]), (zero, h[1], zero)))
    found = sum_of(found, _outer((zero, -bow[2], bow[1]), by.beta[0]))
    turn = (inner_of(model) + 3) * k
    for j, part in ((0, by.t_l), (1, by.t_r), (2, by.beta)):
        found = sum_of(found, _rows(times(constant(lane, model, at.inner_rotary, turn + j), cm), part))
    return found


@kernel
def _inner_pair(lane, model, par, slopes, share, rate, pull, weights, at, k, j, S, inner):
    """Rows of inner mode k by mode j, to the `INNER` at `inner` of S."""
    m, factor, (one, two) = inner_of(model), load(lane, par, STIFFNESS_FACTOR), slopes
    bend = times(constant(lane, model, at.inner_bend, m * k + j), rate)
    own = times(constant(lane, model, at.inner_coupling, (m + 2) * k + 2 + j), pull * weights.stiffness)
    own = plus(own, times(constant(lane, model, at.inner_lateral, (m + 2) * k + 2 + j), weights.mass))
    own = plus(own, times(constant(lane, model, at.inner_rotary, (m + 3) * k + 3 + j), weights.mass))
    own = plus(own, (bend[0], bend[1] * factor, bend[2] * factor))
    block = _outer(one, times(two, share))
    for a in range(3):
        for b in range(3):
            store(S, inner.matrix + 3 * m * (3 * k + a) + 3 * j + b, block[a][b] + own[a] if a == b else block[a][b])


@kernel
def _strained_rows(lane, model, par, a, b, A, B, at):
    """K of the `framed._strained` of a, b, on increments A, B of these."""
    d, D = minus(b, a), difference(B, A)
    c = scaled(difference(product(skew(a), B), product(skew(b), A)), 0.25)
    zero, x = (d[0] * 0.0, d[0] * 0.0, d[0] * 0.0), d[0] * HELIX
    y, z = plus(times(D[0], d[2] * HELIX), times(D[2], x)), minus(times(D[0], -d[1] * HELIX), times(D[1], x))
    helix, factor = (zero, y, z), load(lane, par, STIFFNESS_FACTOR)
    l, r = _both_rows(lane, model, at.bend, difference(sum_of(A, c), helix), difference(difference(B, c), helix))
    l, r = (l[0], times(l[1], factor), times(l[2], factor)), (r[0], times(r[1], factor), times(r[2], factor))
    apart, both = scaled(difference(l, r), 0.25), sum_of(l, r)
    more = minus(times(both[1], d[2] * HELIX), times(both[2], d[1] * HELIX)), times(both[2], -x), times(both[1], x)
    l, r = sum_of(l, product(skew(b), apart)), difference(r, product(skew(a), apart))
    return sum_of(l, more), difference(r, more)


@kernel
def _column(lane, model, par, frame, stiff, kept, now, bent, rate, weights, at, by):
    """Rows of the tangent for a `Column`, in the frame's axes and the sections': of both forces and both moments."""
    cm, c, a, b, share = weights.mass, weights.stiffness, frame.left, frame.right, 1.0 / frame.length
    zero = frame.length * 0.0
    # what e and phi change by, to the force along the chord and the moments on phi
    sl, sr = stiff.slope_l, stiff.slope_r
    strain = plus(back(by.phi_l, sl), back(by.phi_r, sr))
    pull = times((strain[0] + by.d, strain[1], strain[2]), rate * model.frames[at.pull])
    l, r = _strained_rows(lane, model, par, a.phi, b.phi, scaled(by.phi_l, rate), scaled(by.phi_r, rate), at)
    turned, f, D = scaled(skew(stiff.apart), c), times(stiff.both, c), difference(by.phi_r, by.phi_l)
    more = minus(times(D[2], f[1]), times(D[1], f[2])), times(D[0], -f[2]), times(D[0], f[1])
    l = sum_of(difference(l, product(turned, by.phi_r)), more)
    r = difference(sum_of(r, product(turned, by.phi_l)), more)
    gl, gr = _both_rows(lane, model, at.coupling, by.phi_l, by.phi_r)
    geometric = kept * c
    l = sum_of(sum_of(l, scaled(gl, geometric)), _outer(sl, pull))
    r = sum_of(sum_of(r, scaled(gr, geometric)), _outer(sr, pull))
    # inertia of the unbent segment
    il, ir = _both_rows(lane, model, at.lateral, scaled(by.phi_l, cm), scaled(by.phi_r, cm))
    near_l, near_r = constant(lane, model, at.near, 0), constant(lane, model, at.near, 1)
    far_l, far_r = constant(lane, model, at.far, 0), constant(lane, model, at.far, 1)
    hl = times(plus(times(near_l, by.x_l), times(far_l, by.x_r)), cm)
    hr = times(plus(times(near_r, by.x_l), times(far_r, by.x_r)), cm)
    l = sum_of(sum_of(l, il), ((zero, zero, zero), (zero, zero, -hl[2]), (zero, hl[1], zero)))
    r = sum_of(sum_of(r, ir), ((zero, zero, zero), (zero, zero, -hr[2]), (zero, hr[1], zero)))
    mass = constant(lane, model, at.mass, 0)
    on_l = sum_of(_rows_across(near_l, by.phi_l), _rows_across(near_r, by.phi_r))
    on_r = sum_of(_rows_across(far_l, by.phi_l), _rows_across(far_r, by.phi_r))
    on_l = scaled(difference(on_l, product(skew(bent.near), by.beta)), cm)
    on_r = scaled(difference(on_r, product(skew(bent.far), by.beta)), cm)
    bow = scaled(skew(plus(times(bent.near, by.x_l), times(bent.far, by.x_r))), cm)
    # about the chord, as if h were one in both planes
    ul, ur = times(bent.left, cm), times(bent.right, cm)
    roll = plus(_cross_row(ul, by.phi_l), _cross_row(ur, by.phi_r))
    roll = plus(roll, times(by.beta[0], dot(ul, a.phi) + dot(ur, b.phi)))
    bow = plus(bow[0], roll), bow[1], bow[2]
    l, r = sum_of(l, _outer((zero, -ul[2], ul[1]), by.beta[0])), sum_of(r, _outer((zero, -ur[2], ur[1]), by.beta[0]))
    ml, mr = (mass[0] * by.x_l + mass[1] * by.x_r) * cm, (mass[1] * by.x_l + mass[2] * by.x_r) * cm
    # as in `framed`
    tl, tr = _both_rows(lane, model, at.rotary, by.t_l, by.t_r)
    lc, rc = constant(lane, model, at.rotary, 3), constant(lane, model, at.rotary, 4)
    tc = sum_of(sum_of(_rows(lc, by.t_l), _rows(rc, by.t_r)), _rows(constant(lane, model, at.rotary, 5), by.beta))
    tl, tr = scaled(sum_of(tl, _rows(lc, by.beta)), cm), scaled(sum_of(tr, _rows(rc, by.beta)), cm)
    aside, half_l, half_r = times(now[0], c), skew(times(now[1], 0.5 * c)), skew(times(now[2], 0.5 * c))
    half_l, half_r = product(half_l, by.phi_l), product(half_r, by.phi_r)  # of T^-1 and T^-T, to first order
    couple = difference(scaled(tc, cm), sum_of(product(a.T, l), product(b.T, r)))
    couple = sum_of(couple, sum_of(bow, sum_of(half_l, half_r)))
    d = pull, times(couple[2], share), times(plus(couple[1], times(couple[0], frame.k)), -share)
    d = difference(d, product(skew(aside), by.beta))
    shorter, none = by.d * share, (zero, zero, zero)
    d = d[0], minus(d[1], (aside[1] * shorter, zero, zero)), minus(d[2], (aside[2] * shorter, zero, zero))
    tl = sum_of(sum_of(product(transposed(a.T), l), _outer(a.g, couple[0])), sum_of(tl, half_l))
    tr = sum_of(sum_of(product(transposed(b.T), r), _outer(b.g, couple[0])), sum_of(tr, half_r))
    on_l, on_r = sum_of(on_l, about_identity(ml, none, zero, none)), sum_of(on_r, about_identity(mr, none, zero, none))
    return difference(on_l, d), tl, sum_of(on_r, d), tr


@kernel
def tangent(lane, model, par, tau, frame, stiff, pull, now, i, q, weights, S, f):
    """Derivative of `framed`, segment i, to the `FACTOR` at f of S: inertia of the unbent segment, material stiffness,
    and how the force between the ends turns. What the motion does to it, small beside the rest as h w is beside 1, is
    left out."""
    at, row = frame_at(model, i), inner_row(model, i)
    rate = weights.stiffness
    if tau is not None:
        rate = tau * weights.damping + rate
    a, b, A, share, zero = frame.left, frame.right, frame.A, 1.0 / frame.length, frame.length * 0.0
    none, full = (zero, zero, zero), zero + 1.0
    nothing, one = (none, none, none), about_identity(full, none, zero, none)
    beta = (zero, zero, -(frame.k * share)), (zero, zero, -share), (zero, share, zero)
    dl, dr = scaled(product(transposed(a.T), beta), -1.0), scaled(product(transposed(b.T), beta), -1.0)
    left = Column(-full, full, zero, scaled(dl, -1.0), scaled(dr, -1.0), scaled(beta, -1.0), nothing, nothing)
    right = Column(full, zero, full, dl, dr, beta, nothing, nothing)
    ll, lr = difference(a.T, _outer(a.T[0], a.g)), scaled(_outer(a.T[0], b.g), -1.0)
    rl, rr = scaled(_outer(b.T[0], a.g), -1.0), difference(b.T, _outer(b.T[0], b.g))
    turn_l = Column(zero, zero, zero, ll, rl, (a.g, none, none), one, nothing)
    turn_r = Column(zero, zero, zero, lr, rr, (b.g, none, none), nothing, one)
    bent = _bent_inertia(lane, model, frame, at, q, row)
    xl = _column(lane, model, par, frame, stiff, pull, now, bent, rate, weights, at, left)
    tl = _column(lane, model, par, frame, stiff, pull, now, bent, rate, weights, at, turn_l)
    xr = _column(lane, model, par, frame, stiff, pull, now, bent, rate, weights, at, right)
    tr = _column(lane, model, par, frame, stiff, pull, now, bent, rate, weights, at, turn_r)
    B = transposed(A)
    fill(S, f + F.LL, product(product(A, xl[0]), B), product(A, tl[0]), product(xl[1], B), tl[1])
    fill(S, f + F.LR, product(product(A, xr[0]), B), product(A, tr[0]), product(xr[1], B), tr[1])
    fill(S, f + F.RL, product(product(A, xl[2]), B), product(A, tl[2]), product(xl[3], B), tl[3])
    fill(S, f + F.RR, product(product(A, xr[2]), B), product(A, tr[2]), product(xr[3], B), tr[3])
    if model.inner is not None:
        inner, share = inner_at(model, i), rate * model.frames[at.pull]
        for k in range(inner_of(model)):
            own = _inner_own(lane, model, frame, at, k, q, row, weights.mass)
            for c, by in ((0, left), (3, turn_l), (6, right), (9, turn_r)):
                block = _inner_column(lane, model, stiff, pull * weights.stiffness, own, share, weights, at, k, by)
                if c == 0 or c == 6:
                    block = product(block, B)
                for j in range(3):
                    put_vector(S, inner.ends + 12 * (3 * k + j) + c, block[j])
            for j in range(inner_of(model)):
                other = inner_by(lane, model, at.inner_coupling, 2, j, a.phi, b.phi, q, row)
                _inner_pair(lane, model, par, (own[0], other), share, rate, pull, weights, at, k, j, S, inner)
        condense(lane, model, S, f, inner)
