"""An element of two vertices in space: strains at its middle, forces of its ends, their tangent, its inertia.

With q_rel = q_left^-1 q_right the vertices' relative rotation and psi its rotation vector, the section turns about one
axis along the element, the middle is turned by half of psi from the left, and

    Gamma = R^T (r_right - r_left) / l - e_x - psi x (psi x e_x) / 24,      kappa = psi / l
                                                                                (Simo & Vu-Quoc 1986, one point)

which is objective and does not depend on the path (Crisfield & Jelenic 1999). The last term of Gamma is what the chord
of a helix of that curvature departs from its tangent at the middle. A moment that grows along the element bends it by
what one point does not see; the stiffness to shear is that of both in series, 1/C* = 1/C + l^2 / (12 EI) (residual
bending flexibility, MacNeal 1978), with which vertices are where the beam's are under loads at vertices. By rotation
increments in body axes dth,

    R^T dR = (P dth_l + Q dth_r)^,  P, Q = 1/2 -+ g^/2,  g = tan(|psi|/4) psi/|psi|;   dpsi = T^-1 dth_r - T^-T dth_l.

Mass is where a cubic of the vertices' places and tangents t = A e_x has it, by Simpson's rule: a sixth at each vertex,
four at r_m = (r_l + r_r)/2 + (t_l - t_r) l/8. With these an element's error is of fourth order in l where it bends.

Rows: forces along inertial axes, moments in the section's own.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ...compiler import kernel, select_lt, store
from ..arithmetic import add, clip, smaller
from .layout import F
from .rotations import (
    about_identity,
    back,
    composed,
    cross,
    difference,
    halved,
    inverse,
    inverse_tangent,
    matrix,
    minus,
    plus,
    product,
    rotation_vector,
    scaled,
    shorter,
    skew,
    sum_of,
    times,
    transposed,
    turned,
)

BOW = 1.0 / 24.0
"""Of the square of its angle: an arc is longer by that share than its chord."""


MOST, HEAVY = 0.5, 40.0
"""Largest force of its own in an element's tangent, over EI / l^2 (its buckling force is pi^2 of that), where inertia
in steps is more than `HEAVY` times as stiff: as Newton begins, strains are off by second order of a step's turn. Times
EA that is a force that no tangent should have in it, and forces that are real are little beside such inertia."""


class Section(NamedTuple):
    """An element's constants, with the arm's own factors (`layout.ELEMENT`)."""

    length: Any
    stretch: Any
    bend: Any
    rest: Any
    tau: Any  # s, of Kelvin-Voigt


class Place(NamedTuple):
    """A vertex: its place and rate along inertial axes, quaternion, angular velocity in its own."""

    r: Any
    v: Any
    p: Any
    spin: Any


class Middle(NamedTuple):
    """What the tangent needs of the middle."""

    psi: Any
    R: Any
    e: Any  # Gamma + e_x
    g: Any
    T: Any  # T^-1(psi)
    n: Any  # force over the section, its axes
    m: Any  # moment


@kernel
def scale(a, d):
    """Vector a, entry by entry times d."""
    return a[0] * d[0], a[1] * d[1], a[2] * d[2]


@kernel
def middle(section, left, right):
    """Strains, and stress resultants of the middle: (Gamma, l kappa less its rest), Middle."""
    share = 1.0 / section.length
    relative = shorter(composed(inverse(left.p), right.p))
    psi, half = rotation_vector(relative), halved(relative)
    R = matrix(composed(left.p, half))
    w = 1.0 / (relative[0] + 1.0)
    g = relative[1] * w, relative[2] * w, relative[3] * w
    T = inverse_tangent(psi, relative)
    e = times(back(R, minus(right.r, left.r)), share)
    bow = bow_of(psi)
    gamma = e[0] - 1.0 - bow[0], e[1] - bow[1], e[2] - bow[2]
    bent = minus(psi, section.rest)
    n, m = gamma, bent
    if section.tau is not None:
        turn = mean(g, left.spin, right.spin)
        rate = plus(times(back(R, minus(right.v, left.v)), share), cross(e, turn))
        bend = minus(turned(T, right.spin), back(T, left.spin))
        n = plus(n, times(plus(rate, turned(_arc(psi), bend)), section.tau))
        m = plus(m, times(bend, section.tau))
    n = scale(n, section.stretch)
    m = plus(times(scale(m, section.bend), share), times(back(_arc(psi), n), section.length))
    return (gamma, bent), Middle(psi, R, e, g, T, n, m)


@kernel
def bow_of(psi):
    """What a chord has beside e_x and Gamma, an arc bent by psi: psi x (psi x e_x) / 24."""
    return times(cross(psi, (psi[0] * 0.0, psi[2], -psi[1])), BOW)


@kernel
def _arc(psi):
    """Derivative of Gamma by psi: of - `bow_of`."""
    x, y, z = times(psi, BOW)
    zero = x * 0.0
    return (zero, y * 2.0, z * 2.0), (-y, -x, zero), (-z, zero, -x)


@kernel
def rates(section, left, right):
    """Rates of the strains of `middle`: of Gamma, and of kappa times the length."""
    relative = shorter(composed(inverse(left.p), right.p))
    psi, half = rotation_vector(relative), halved(relative)
    w = 1.0 / (relative[0] + 1.0)
    share, R, T = 1.0 / section.length, matrix(composed(left.p, half)), inverse_tangent(psi, relative)
    turn = mean((relative[1] * w, relative[2] * w, relative[3] * w), left.spin, right.spin)
    e = times(back(R, minus(right.r, left.r)), share)
    stretch = plus(times(back(R, minus(right.v, left.v)), share), cross(e, turn))
    bend = minus(turned(T, right.spin), back(T, left.spin))
    return plus(stretch, turned(_arc(psi), bend)), bend


@kernel
def mean(g, a, b):
    """P a + Q b: what the middle turns by."""
    return times(plus(plus(a, b), cross(g, minus(b, a))), 0.5)


@kernel
def forces(section, at):
    """((force, moment) of the left end, of the right end)."""
    push = turned(at.R, at.n)
    turn = times(cross(at.n, at.e), section.length)
    half, more = times(turn, 0.5), times(cross(at.g, turn), 0.5)
    left = minus(plus(half, more), turned(at.T, at.m))
    return (times(push, -1.0), left), (push, plus(minus(half, more), back(at.T, at.m)))


@kernel
def _put(S, o, i, j, A):
    """Block (i, j) of three rows and columns of the 6 x 6 matrix at o."""
    for a in range(3):
        for b in range(3):
            store(S, o + 18 * i + 6 * a + 3 * j + b, A[a][b])


@kernel
def fill(S, o, xx, xt, tx, tt):
    """The 6 x 6 matrix at o from its blocks: of places (x) and rotations (t)."""
    _put(S, o, 0, 0, xx)
    _put(S, o, 0, 1, xt)
    _put(S, o, 1, 0, tx)
    _put(S, o, 1, 1, tt)


@kernel
def _columns(A, d):
    """A diag(d)."""
    return scale(A[0], d), scale(A[1], d), scale(A[2], d)


@kernel
def most_force(section, sixth, mass):
    """See `MOST`; sixth: of the element's mass, mass: that weight of the matrix."""
    x, y, z = section.bend
    square = section.length * section.length
    own = smaller(smaller(x, y), z) / square
    return select_lt(own * HEAVY, sixth * section.length * (6.0 * mass), own * MOST, np.inf)


@kernel
def tangent(section, at, c, cd, most, S, o):
    """Derivative of `forces`, c times by positions and cd by rates, to the `FACTOR` at o of S.

    Forces of its own that are in it are at most `most`. What moments change by at second order in the element's own psi
    is left out, and what rates change by positions: Newton's iteration has no need of it.
    """
    R, Q, T = at.R, about_identity(0.5, times(at.g, 0.5), 0.0, at.g), at.T
    P, Tt = transposed(Q), transposed(T)
    rate = c
    if section.tau is not None:
        rate = section.tau * cd + c
    share, l = 1.0 / section.length, section.length
    D, b = times(section.stretch, rate), times(section.bend, share * rate)
    arc, e = _arc(at.psi), skew(at.e)
    kept = clip(at.n[0], most), clip(at.n[1], most), clip(at.n[2], most)
    n, own = times(kept, c), minus(at.m, times(back(arc, minus(at.n, kept)), l))
    x, y, z = times(n, l * BOW)
    K = (b[0], -y, -z), (-y, x * 2.0 + b[1], x * 0.0), (-z, x * 0.0, x * 2.0 + b[2])
    nhat = skew(n)
    left_w = difference(product(e, P), product(arc, Tt))  # of Gamma by the rotations of the ends
    right_w = sum_of(product(e, Q), product(arc, T))
    RD = _columns(R, D)
    xx = scaled(product(RD, transposed(R)), share)
    Rn = product(R, nhat)
    xl, xr = difference(product(RD, left_w), product(Rn, P)), difference(product(RD, right_w), product(Rn, Q))
    left_D, right_D = scaled(_columns(transposed(left_w), D), l), scaled(_columns(transposed(right_w), D), l)
    geometric = scaled(product(nhat, e), l)
    gP, gQ = product(geometric, P), product(geometric, Q)
    lx, rx = transposed(xl), transposed(xr)
    f, m = skew(times(cross(n, at.e), l * 0.125)), skew(times(own, 0.5 * c))
    left, right = difference(difference(m, f), product(T, K)), sum_of(sum_of(m, f), product(Tt, K))
    minus_xx = scaled(xx, -1.0)
    ll = sum_of(product(left_D, left_w), difference(product(Q, gP), product(left, Tt)))
    lr = sum_of(product(left_D, right_w), sum_of(product(Q, gQ), product(left, T)))
    rl = sum_of(product(right_D, left_w), difference(product(P, gP), product(right, Tt)))
    rr = sum_of(product(right_D, right_w), sum_of(product(P, gQ), product(right, T)))
    fill(S, o + F.LL, xx, scaled(xl, -1.0), scaled(lx, -1.0), ll)
    fill(S, o + F.LR, minus_xx, scaled(xr, -1.0), lx, lr)
    fill(S, o + F.RL, minus_xx, xl, scaled(rx, -1.0), rl)
    fill(S, o + F.RR, xx, xr, rx, rr)


class Tangent(NamedTuple):
    """The tangent t = A e_x of a vertex: axes A, and the second rate of t in them."""

    A: Any
    w: Any
    second: Any


@kernel
def tangent_of(at):
    """Of a `Vertex`."""
    w, alpha = at.place.spin, at.alpha
    second = -(w[1] * w[1] + w[2] * w[2]), w[0] * w[1] + alpha[2], w[0] * w[2] - alpha[1]
    return Tangent(matrix(at.place.p), w, second)


@kernel
def _crossed(g):
    """e_x x g."""
    return g[0] * 0.0, -g[2], g[1]


@kernel
def _below(A):
    """e_x^ A."""
    return times(A[0], 0.0), times(A[2], -1.0), A[1]


@kernel
def _by_turn(t, weights):
    """Derivative, over A, of the second rate of t by rotation increments of its vertex."""
    w, zero = t.w, t.w[0] * 0.0
    ck, cd, cm = weights.stiffness, weights.damping, weights.mass
    # -(e^ cm + second^ ck + ((w x e)^ + w^ e^) cd)
    u = times(t.second, ck)
    y, z = w[1] * cd, w[2] * cd
    return (
        (zero, u[2] - y * 2.0, -(u[1] + z * 2.0)),
        (y - u[2], w[0] * cd, u[0] + cm),
        (z + u[1], -(u[0] + cm), w[0] * cd),
    )


@kernel
def inertia(lane, mass, length, left, right, weights, S, o):
    """((force, moment) of the left end, of the right) of the mass at the middle, and its part of the `FACTOR` at o."""
    arm = length * 0.125
    tl, tr = tangent_of(left), tangent_of(right)
    bent = minus(turned(tl.A, tl.second), turned(tr.A, tr.second))
    f = times(plus(times(plus(left.a, right.a), 0.5), times(bent, arm)), mass)
    half, own_l, own_r = times(f, 0.5), back(tl.A, f), back(tr.A, f)
    if weights.mass != 0.0:
        Bl, Br = scaled(_by_turn(tl, weights), arm), scaled(_by_turn(tr, weights), -arm)
        quarter = 0.25 * weights.mass * mass
        xl, xr = scaled(product(tl.A, Bl), 0.5 * mass), scaled(product(tr.A, Br), 0.5 * mass)
        lx = scaled(_below(transposed(tl.A)), arm * 0.5 * weights.mass * mass)
        rx = scaled(_below(transposed(tr.A)), arm * -0.5 * weights.mass * mass)
        across = scaled(product(transposed(tl.A), tr.A), arm * mass)
        ll = sum_of(scaled(_below(Bl), arm * mass), scaled(_below(skew(own_l)), arm * weights.stiffness))
        rr = sum_of(scaled(_below(Br), -arm * mass), scaled(_below(skew(own_r)), -arm * weights.stiffness))
        lr, rl = _below(product(across, Br)), scaled(_below(product(transposed(across), Bl)), -1.0)
        _add(lane, S, o + F.LL, quarter, xl, lx, ll)
        _add(lane, S, o + F.LR, quarter, xr, lx, lr)
        _add(lane, S, o + F.RL, quarter, xl, rx, rl)
        _add(lane, S, o + F.RR, quarter, xr, rx, rr)
    return (half, times(_crossed(own_l), arm)), (half, times(_crossed(own_r), -arm))


@kernel
def _add(lane, S, o, x, xt, tx, tt):
    """`fill`, added to what is there; x: of places, along each axis."""
    for a in range(3):
        add(lane, S, o + 7 * a, x)
    add_block(lane, S, o, 0, 1, xt)
    add_block(lane, S, o, 1, 0, tx)
    add_block(lane, S, o, 1, 1, tt)


@kernel
def add_block(lane, S, o, i, j, A):
    """Block (i, j) of three rows and columns of the 6 x 6 matrix at o, += A."""
    for a in range(3):
        for b in range(3):
            add(lane, S, o + 18 * i + 6 * a + 3 * j + b, A[a][b])


@kernel
def middle_of(length, left, right):
    """(place, velocity) of the mass at the middle, of two `Place`s."""
    A, B, arm = matrix(left.p), matrix(right.p), length * 0.125
    bent = minus((A[0][0], A[1][0], A[2][0]), (B[0][0], B[1][0], B[2][0]))
    a, b = left.spin, right.spin
    zero = a[0] * 0.0
    turning = minus(turned(A, (zero, a[2], -a[1])), turned(B, (zero, b[2], -b[1])))
    r, v = times(plus(left.r, right.r), 0.5), times(plus(left.v, right.v), 0.5)
    return plus(r, times(bent, arm)), plus(v, times(turning, arm))
