"""A segment with a floating frame between two sections in space: forces of its ends, tangent, energy, damping.

The frame begins at the left section's place, its x axis (the chord) goes through the right one's, and its roll about
that follows both sections' y axes: z is at right angles to their sum. The sections' rotation vectors phi_l, phi_r
against it and e = |r_r - r_l| - l are the elastic coordinates of a Timoshenko element of 12, of which 6 are left:

    r(x) = (1 - x/l) r_l + x/l r_r + A n(x),   n = h_l (phi_l x e_x) + h_r (phi_r x e_x)     [41], h of either plane
    U = (phi' K phi + EA/l (e + phi' H phi / 2)^2) / 2                    (docs: theory, eq. 1.2, of both bendings)

By rotation increments in the sections' and the frame's own axes, d phi_i = T_i^-1 dth_i - T_i^-T dbeta, with

    dbeta_y = -d_z/l, dbeta_z = d_y/l, dbeta_x = g_l dth_l + g_r dth_r + k dbeta_y, d = A'(dr_r - dr_l), the chord's l

Sections at x have the rotary inertia of the rates a w_l + b w_r + c w, [41] again, each in axes of its own.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from ...compiler import kernel, load, splat, square_root
from ..arithmetic import clip
from ..model import STIFFNESS_FACTOR
from .chain import three_of
from .element import fill, most_force, scale
from .layout import POINTS, F, R, W
from .rotations import (
    about_identity,
    back,
    cross,
    difference,
    dot,
    matrix,
    minus,
    plus,
    product,
    scaled,
    skew,
    sum_of,
    times,
    transposed,
    turn_of,
    turned,
)


class Frame(NamedTuple):
    """Where the frame is, and what of it increments of the ends change."""

    A: Any
    length: Any  # of the chord
    left: Any  # `Turn` of the left section
    right: Any
    k: Any


class Turn(NamedTuple):
    """A section's rotation against the frame."""

    E: Any  # its axes in the frame's
    phi: Any
    T: Any  # T^-1(phi)
    g: Any


class Rates(NamedTuple):
    """How the frame moves, in its axes."""

    spin: Any
    d: Any  # of the right end against the left one
    left: Any  # of phi
    right: Any


class Stiff(NamedTuple):
    """Forces of the elastic coordinates: along the chord, on phi_l and phi_r; what e and these have in common."""

    pull: Any
    left: Any
    right: Any
    slope_l: Any  # H phi
    slope_r: Any


@kernel
def _normal(a):
    return times(a, 1.0 / square_root(dot(a, a)))


@kernel
def _turn(A, own, share):
    """own: the section's axes. share: 1 / p_y."""
    E = product(transposed(A), own)
    w = square_root(E[0][0] + E[1][1] + E[2][2] + 1.0) * 0.5
    part = 0.25 / w
    p = w, (E[2][1] - E[1][2]) * part, (E[0][2] - E[2][0]) * part, (E[1][0] - E[0][1]) * part
    found = turn_of(p)
    return Turn(E, found.psi, found.T, (E[2][2] * share, E[2][0] * 0.0, -(E[2][0] * share)))


@kernel
def frame_of(left, right):
    """The `Frame` between two `Place`s."""
    d, own_l, own_r = minus(right.r, left.r), matrix(left.p), matrix(right.p)
    x, p = _normal(d), (own_l[0][1] + own_r[0][1], own_l[1][1] + own_r[1][1], own_l[2][1] + own_r[2][1])
    z = _normal(cross(x, p))
    y = cross(z, x)
    A = transposed((x, y, z))
    share = 1.0 / dot(y, p)
    return Frame(A, dot(x, d), _turn(A, own_l, share), _turn(A, own_r, share), dot(x, p) * share)


@kernel
def rates_of(frame, left, right):
    """The `Rates` of two `Place`s."""
    d, share = back(frame.A, minus(right.v, left.v)), 1.0 / frame.length
    y = -(d[2] * share)
    spin = dot(frame.left.g, left.spin) + dot(frame.right.g, right.spin) + frame.k * y, y, d[1] * share
    return Rates(spin, d, _phi_rate(frame.left, left.spin, spin), _phi_rate(frame.right, right.spin, spin))


@kernel
def _phi_rate(turn, own, spin):
    return minus(turned(turn.T, own), back(turn.T, spin))


@kernel
def _phi_second(turn, rate, own, own_second, spin, second):
    """Second rate of phi: T^-1 = 1 + phi^/2 + c phi^ phi^, c = 1/12 + |phi|^2/720 + ... of angles below a right one."""
    phi = turn.phi
    square, apart = dot(phi, phi), minus(own, spin)
    c = square * (square * (square * (1.0 / 1209600.0) + 1.0 / 30240.0) + 1.0 / 720.0) + 1.0 / 12.0
    slope = square * (square * (square * (1.0 / 11975040.0) + 1.0 / 403200.0) + 1.0 / 15120.0) + 1.0 / 720.0
    found = plus(minus(turned(turn.T, own_second), back(turn.T, second)), times(cross(rate, plus(own, spin)), 0.5))
    inner = cross(phi, apart)
    found = plus(found, times(plus(cross(rate, inner), cross(phi, cross(rate, apart))), c))
    return plus(found, times(cross(phi, inner), slope * 2.0 * dot(phi, rate)))


@kernel
def _across(phi):
    """phi x e_x."""
    return phi[0] * 0.0, phi[2], -phi[1]


@kernel
def _lifted(f):
    """e_x x f: what a force across does on phi."""
    return f[0] * 0.0, -f[2], f[1]


@kernel
def _swirl(w, alpha, a):
    """alpha x a + w x (w x a)."""
    return plus(cross(alpha, a), cross(w, cross(w, a)))


@kernel
def _seconds(frame, rates, left, right):
    """The frame's second rate in its axes."""
    spin, share = rates.spin, 1.0 / frame.length
    d = back(frame.A, minus(right.a, left.a))
    y = spin[0] * spin[2] - (d[2] + rates.d[0] * spin[1] * 2.0) * share
    z = (d[1] - rates.d[0] * spin[2] * 2.0) * share - spin[0] * spin[1]
    first, second, p = (y * 0.0, y * 0.0, y * 0.0), (y * 0.0, y * 0.0, y * 0.0), (y * 0.0, y * 0.0, y * 0.0)
    for turn, at in ((frame.left, left), (frame.right, right)):
        w, alpha = at.place.spin, at.alpha
        p = plus(p, (turn.E[0][1], turn.E[1][1], turn.E[2][1]))
        first = plus(first, turned(turn.E, (-w[2], y * 0.0, w[0])))
        swung = w[0] * w[1] - alpha[2], -(w[0] * w[0] + w[2] * w[2]), w[1] * w[2] + alpha[0]
        second = plus(second, turned(turn.E, swung))
    own = plus(times(cross(spin, minus(first, cross(spin, p))), 2.0), cross(spin, cross(spin, p)))
    return (second[2] - own[2]) / p[1] + y * frame.k, y, z


@kernel
def _constant(lane, model, o, i):
    return three_of(lane, model.frames, o + 3 * i)


@kernel
def _product(lane, model, o, a, b):
    """The matrix of three vectors (ll, lr, rr) at o on (a, b)."""
    ll, lr, rr = _constant(lane, model, o, 0), _constant(lane, model, o, 1), _constant(lane, model, o, 2)
    return plus(scale(a, ll), scale(b, lr)), plus(scale(a, lr), scale(b, rr))


@kernel
def _bent(lane, model, par, o, a, b):
    """K (a, b), with the arm's own factor on EI."""
    factor = load(lane, par, STIFFNESS_FACTOR)
    l, r = _product(lane, model, o + R.bend, a, b)
    return (l[0], l[1] * factor, l[2] * factor), (r[0], r[1] * factor, r[2] * factor)


@kernel
def _stretch(lane, model, frame, o):
    """(e + phi' H phi / 2, H phi of the left, of the right)."""
    l, r = _product(lane, model, o + R.coupling, frame.left.phi, frame.right.phi)
    e = frame.length - model.frames[o + R.length]
    return e + (dot(l, frame.left.phi) + dot(r, frame.right.phi)) * 0.5, l, r


@kernel
def _elastic(lane, model, par, frame, rates, tau, o):
    """`Stiff`."""
    e, hl, hr = _stretch(lane, model, frame, o)
    l, r = _bent(lane, model, par, o, frame.left.phi, frame.right.phi)
    factor = load(lane, par, STIFFNESS_FACTOR)
    l = minus(l, times(_constant(lane, model, o + R.moment, 0), factor))
    r = minus(r, times(_constant(lane, model, o + R.moment, 1), factor))
    if tau is not None:
        e = e + (rates.d[0] + dot(hl, rates.left) + dot(hr, rates.right)) * tau
        dl, dr = _bent(lane, model, par, o, rates.left, rates.right)
        l, r = plus(l, times(dl, tau)), plus(r, times(dr, tau))
    pull = e * model.frames[o + R.pull]
    return Stiff(pull, plus(l, times(hl, pull)), plus(r, times(hr, pull)), hl, hr)


@kernel
def framed(lane, model, par, section, left, right, i, weights, S, f):
    """((force, moment) of the left end, of the right) of segment i, between two `Vertex`; its `FACTOR` at f of S."""
    o = R.end * i
    frame = frame_of(left.place, right.place)
    rates = rates_of(frame, left.place, right.place)
    spin, a, b = rates.spin, frame.left, frame.right
    alpha = _seconds(frame, rates, left, right)
    second_l = _phi_second(a, rates.left, left.place.spin, left.alpha, spin, alpha)
    second_r = _phi_second(b, rates.right, right.place.spin, right.alpha, spin, alpha)
    stiff = _elastic(lane, model, par, frame, rates, section.tau, o)
    al, ar = back(frame.A, left.a), back(frame.A, right.a)
    zero = splat(lane, 0.0)
    push_l, push_r, couple = (zero, zero, zero), (zero, zero, zero), (zero, zero, zero)
    ml, mr = stiff.left, stiff.right
    for p in range(POINTS):
        at = o + R.points + W.end * p
        xi, mass = model.frames[at + W.xi], model.frames[at + W.mass]
        hl, hr = three_of(lane, model.frames, at + W.left), three_of(lane, model.frames, at + W.right)
        n = plus(scale(_across(a.phi), hl), scale(_across(b.phi), hr))
        rate = plus(scale(_across(rates.left), hl), scale(_across(rates.right), hr))
        second = plus(scale(_across(second_l), hl), scale(_across(second_r), hr))
        found = plus(plus(times(al, 1.0 - xi), times(ar, xi)), plus(second, times(cross(spin, rate), 2.0)))
        force = times(plus(found, _swirl(spin, alpha, n)), mass)
        push_l, push_r = plus(push_l, times(force, 1.0 - xi)), plus(push_r, times(force, xi))
        couple = plus(couple, cross(n, force))
        ml, mr = plus(ml, _lifted(scale(force, hl))), plus(mr, _lifted(scale(force, hr)))
    turn_l, turn_r, turn = _rotary(lane, model, o, left, right, spin, alpha)
    couple = minus(plus(couple, turn), plus(turned(a.T, ml), turned(b.T, mr)))
    across = stiff.pull, couple[2] / frame.length, -((couple[1] + couple[0] * frame.k) / frame.length)
    if weights.mass != 0.0:
        most = most_force(section, model.frames[o + R.mass] * 0.5, weights.mass)
        now = (clip(across[0], most), clip(across[1], most), clip(across[2], most)), ml, mr
        _tangent(lane, model, par, section.tau, frame, stiff, clip(stiff.pull, most), now, o, weights, S, f)
    on_l = plus(plus(back(a.T, ml), times(a.g, couple[0])), turn_l)
    on_r = plus(plus(back(b.T, mr), times(b.g, couple[0])), turn_r)
    return (turned(frame.A, minus(push_l, across)), on_l), (turned(frame.A, plus(push_r, across)), on_r)


@kernel
def _momenta(lane, model, o, a, b, c):
    """Angular momenta that go with the rates a, b of the ends' rotations and c of the frame's."""
    l, r = _product(lane, model, o + R.rotary, a, b)
    lc, rc = _constant(lane, model, o + R.rotary, 3), _constant(lane, model, o + R.rotary, 4)
    cc = _constant(lane, model, o + R.rotary, 5)
    return plus(l, scale(c, lc)), plus(r, scale(c, rc)), plus(plus(scale(a, lc), scale(b, rc)), scale(c, cc))


@kernel
def _rotary(lane, model, o, left, right, spin, alpha):
    """Moments of rotary inertia: on the left section, the right one, the frame, each in its axes."""
    wl, wr = left.place.spin, right.place.spin
    l, r, c = _momenta(lane, model, o, wl, wr, spin)
    more_l, more_r, more = _momenta(lane, model, o, left.alpha, right.alpha, alpha)
    return plus(more_l, cross(wl, l)), plus(more_r, cross(wr, r)), plus(more, cross(spin, c))


@kernel
def _outer(a, b):
    """a b^T."""
    return times(b, a[0]), times(b, a[1]), times(b, a[2])


@kernel
def _rows(d, A):
    """diag(d) A."""
    return times(A[0], d[0]), times(A[1], d[1]), times(A[2], d[2])


@kernel
def _both_rows(lane, model, o, A, B):
    """`_product` of matrices."""
    ll, lr, rr = _constant(lane, model, o, 0), _constant(lane, model, o, 1), _constant(lane, model, o, 2)
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


@kernel
def _column(lane, model, par, frame, stiff, kept, now, rate, weights, o, by):
    """Rows of the tangent for a `Column`, in the frame's axes and the sections': of both forces and both moments."""
    cm, c, a, b, share = weights.mass, weights.stiffness, frame.left, frame.right, 1.0 / frame.length
    zero = frame.length * 0.0
    # what e and phi change by, to the force along the chord and the moments on phi
    sl, sr = stiff.slope_l, stiff.slope_r
    strain = plus(back(by.phi_l, sl), back(by.phi_r, sr))
    pull = times((strain[0] + by.d, strain[1], strain[2]), rate * model.frames[o + R.pull])
    l, r = _both_rows(lane, model, o + R.bend, scaled(by.phi_l, rate), scaled(by.phi_r, rate))
    factor = load(lane, par, STIFFNESS_FACTOR)
    l, r = (l[0], times(l[1], factor), times(l[2], factor)), (r[0], times(r[1], factor), times(r[2], factor))
    gl, gr = _both_rows(lane, model, o + R.coupling, by.phi_l, by.phi_r)
    geometric = kept * c
    l = sum_of(sum_of(l, scaled(gl, geometric)), _outer(sl, pull))
    r = sum_of(sum_of(r, scaled(gr, geometric)), _outer(sr, pull))
    # inertia of the unbent segment
    il, ir = _both_rows(lane, model, o + R.lateral, scaled(by.phi_l, cm), scaled(by.phi_r, cm))
    near_l, near_r = _constant(lane, model, o + R.near, 0), _constant(lane, model, o + R.near, 1)
    far_l, far_r = _constant(lane, model, o + R.far, 0), _constant(lane, model, o + R.far, 1)
    hl = times(plus(times(near_l, by.x_l), times(far_l, by.x_r)), cm)
    hr = times(plus(times(near_r, by.x_l), times(far_r, by.x_r)), cm)
    l = sum_of(sum_of(l, il), ((zero, zero, zero), (zero, zero, -hl[2]), (zero, hl[1], zero)))
    r = sum_of(sum_of(r, ir), ((zero, zero, zero), (zero, zero, -hr[2]), (zero, hr[1], zero)))
    mass = _constant(lane, model, o + R.mass, 0)
    bow_l = plus(scale(_across(a.phi), near_l), scale(_across(b.phi), near_r))  # int m (1 - x/l) n
    bow_r = plus(scale(_across(a.phi), far_l), scale(_across(b.phi), far_r))
    on_l = sum_of(_rows_across(near_l, by.phi_l), _rows_across(near_r, by.phi_r))
    on_r = sum_of(_rows_across(far_l, by.phi_l), _rows_across(far_r, by.phi_r))
    on_l = scaled(difference(on_l, product(skew(bow_l), by.beta)), cm)
    on_r = scaled(difference(on_r, product(skew(bow_r), by.beta)), cm)
    bow = scaled(skew(plus(times(bow_l, by.x_l), times(bow_r, by.x_r))), cm)
    # about the chord, as if h were one in both planes
    ul, ur = _product(lane, model, o + R.lateral, a.phi, b.phi)
    ul, ur = (zero, ul[1] * cm, ul[2] * cm), (zero, ur[1] * cm, ur[2] * cm)
    roll = plus(_cross_row(ul, by.phi_l), _cross_row(ur, by.phi_r))
    roll = plus(roll, times(by.beta[0], dot(ul, a.phi) + dot(ur, b.phi)))
    bow = plus(bow[0], roll), bow[1], bow[2]
    l, r = sum_of(l, _outer((zero, -ul[2], ul[1]), by.beta[0])), sum_of(r, _outer((zero, -ur[2], ur[1]), by.beta[0]))
    ml, mr = (mass[0] * by.x_l + mass[1] * by.x_r) * cm, (mass[1] * by.x_l + mass[2] * by.x_r) * cm
    # as in `framed`
    tl, tr = _both_rows(lane, model, o + R.rotary, by.t_l, by.t_r)
    lc, rc = _constant(lane, model, o + R.rotary, 3), _constant(lane, model, o + R.rotary, 4)
    tc = sum_of(sum_of(_rows(lc, by.t_l), _rows(rc, by.t_r)), _rows(_constant(lane, model, o + R.rotary, 5), by.beta))
    tl, tr = scaled(sum_of(tl, _rows(lc, by.beta)), cm), scaled(sum_of(tr, _rows(rc, by.beta)), cm)
    across, half_l, half_r = times(now[0], c), skew(times(now[1], 0.5 * c)), skew(times(now[2], 0.5 * c))
    half_l, half_r = product(half_l, by.phi_l), product(half_r, by.phi_r)  # of T^-1 and T^-T, to first order
    couple = difference(scaled(tc, cm), sum_of(product(a.T, l), product(b.T, r)))
    couple = sum_of(couple, sum_of(bow, sum_of(half_l, half_r)))
    d = pull, times(couple[2], share), times(plus(couple[1], times(couple[0], frame.k)), -share)
    d = difference(d, product(skew(across), by.beta))
    shorter, none = by.d * share, (zero, zero, zero)
    d = d[0], minus(d[1], (across[1] * shorter, zero, zero)), minus(d[2], (across[2] * shorter, zero, zero))
    tl = sum_of(sum_of(product(transposed(a.T), l), _outer(a.g, couple[0])), sum_of(tl, half_l))
    tr = sum_of(sum_of(product(transposed(b.T), r), _outer(b.g, couple[0])), sum_of(tr, half_r))
    on_l, on_r = sum_of(on_l, about_identity(ml, none, zero, none)), sum_of(on_r, about_identity(mr, none, zero, none))
    return difference(on_l, d), tl, sum_of(on_r, d), tr


@kernel
def _tangent(lane, model, par, tau, frame, stiff, pull, now, o, weights, S, f):
    """Derivative of `framed` to the `FACTOR` at f of S: inertia of the unbent segment, material stiffness, and how the
    force between the ends turns. What the motion does to it, small beside the rest as h w is beside 1, is left out."""
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
    xl = _column(lane, model, par, frame, stiff, pull, now, rate, weights, o, left)
    tl = _column(lane, model, par, frame, stiff, pull, now, rate, weights, o, turn_l)
    xr = _column(lane, model, par, frame, stiff, pull, now, rate, weights, o, right)
    tr = _column(lane, model, par, frame, stiff, pull, now, rate, weights, o, turn_r)
    B = transposed(A)
    fill(S, f + F.LL, product(product(A, xl[0]), B), product(A, tl[0]), product(xl[1], B), tl[1])
    fill(S, f + F.LR, product(product(A, xr[0]), B), product(A, tr[0]), product(xr[1], B), tr[1])
    fill(S, f + F.RL, product(product(A, xl[2]), B), product(A, tl[2]), product(xl[3], B), tl[3])
    fill(S, f + F.RR, product(product(A, xr[2]), B), product(A, tr[2]), product(xr[3], B), tr[3])


@kernel
def frame_energy(lane, model, par, left, right, i):
    """(kinetic, strain, gravity) energy, J, of segment i between two `Place`s."""
    o = R.end * i
    frame = frame_of(left, right)
    rates = rates_of(frame, left, right)
    a, b, spin = frame.left, frame.right, rates.spin
    e, _, _ = _stretch(lane, model, frame, o)
    l, r = _bent(lane, model, par, o, a.phi, b.phi)
    strain = (e * e * model.frames[o + R.pull] + dot(l, a.phi) + dot(r, b.phi)) * 0.5
    natural = dot(_constant(lane, model, o + R.moment, 0), a.phi) + dot(_constant(lane, model, o + R.moment, 1), b.phi)
    strain = strain + (model.frames[o + R.spent] - natural) * load(lane, par, STIFFNESS_FACTOR)
    tl, tr, tc = _momenta(lane, model, o, left.spin, right.spin, spin)
    kinetic = dot(tl, left.spin) + dot(tr, right.spin) + dot(tc, spin)
    gravity = splat(lane, 0.0)
    for p in range(POINTS):
        at = o + R.points + W.end * p
        mass, xi = model.frames[at + W.mass], model.frames[at + W.xi]
        hl, hr = three_of(lane, model.frames, at + W.left), three_of(lane, model.frames, at + W.right)
        n = plus(scale(_across(a.phi), hl), scale(_across(b.phi), hr))
        rate = plus(plus(scale(_across(rates.left), hl), scale(_across(rates.right), hr)), cross(spin, n))
        v = plus(plus(times(left.v, 1.0 - xi), times(right.v, xi)), turned(frame.A, rate))
        kinetic = kinetic + dot(v, v) * mass
        if model.gravity is not None:
            place = plus(plus(times(left.r, 1.0 - xi), times(right.r, xi)), turned(frame.A, n))
            gravity = gravity - dot(three_of(lane, model.gravity, 0), place) * mass
    return kinetic * 0.5, strain, gravity


@kernel
def frame_damping(lane, model, par, left, right, other_l, other_r, i):
    """Power over tau_d of segment i's damping at the rates of left and right over those of the others, W s."""
    o = R.end * i
    frame = frame_of(left, right)
    one, two = rates_of(frame, left, right), rates_of(frame, other_l, other_r)
    _, hl, hr = _stretch(lane, model, frame, o)
    l, r = _bent(lane, model, par, o, one.left, one.right)
    stretch = one.d[0] + dot(hl, one.left) + dot(hr, one.right)
    other = two.d[0] + dot(hl, two.left) + dot(hr, two.right)
    return stretch * other * model.frames[o + R.pull] + dot(l, two.left) + dot(r, two.right)
