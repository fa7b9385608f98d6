"""An element of two vertices in space: strains at its middle, forces of its ends, their tangent.

With q_rel = q_left^-1 q_right the vertices' relative rotation and psi its rotation vector, the section turns about one
axis along the element, the middle is turned by half of psi from the left, and

    Gamma = R^T (r_right - r_left) / l - e_x,    kappa = psi / l                (Simo & Vu-Quoc 1986, strains of one point)

which is objective and does not depend on the path (Crisfield & Jelenic 1999), and exact where the curvature is constant.
By rotation increments in body axes dth,

    R^T dR = (P dth_l + Q dth_r)^,  P, Q = 1/2 -+ g^/2,  g = tan(|psi|/4) psi/|psi|;   dpsi = T^-1 dth_r - T^-T dth_l.

Rows: forces along inertial axes, moments in the section's own.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from ...compiler import kernel, store
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
    w = 1.0 / (half[0] + 1.0)
    g = half[1] * w, half[2] * w, half[3] * w
    T = inverse_tangent(psi, relative)
    e = times(back(R, minus(right.r, left.r)), share)
    gamma = e[0] - 1.0, e[1], e[2]
    bent = minus(psi, section.rest)
    n, m = gamma, bent
    if section.tau is not None:
        turn = mean(g, left.spin, right.spin)
        rate = plus(times(back(R, minus(right.v, left.v)), share), cross(e, turn))
        bend = minus(turned(T, right.spin), back(T, left.spin))
        n, m = plus(n, times(rate, section.tau)), plus(m, times(bend, section.tau))
    return (gamma, bent), Middle(R, e, g, T, scale(n, section.stretch), times(scale(m, section.bend), share))


@kernel
def rates(section, left, right):
    """Rates of the strains of `middle`: of Gamma, and of kappa times the length."""
    relative = shorter(composed(inverse(left.p), right.p))
    psi, half = rotation_vector(relative), halved(relative)
    w = 1.0 / (half[0] + 1.0)
    share, R, T = 1.0 / section.length, matrix(composed(left.p, half)), inverse_tangent(psi, relative)
    e, turn = times(back(R, minus(right.r, left.r)), share), mean((half[1] * w, half[2] * w, half[3] * w), left.spin, right.spin)
    stretch = plus(times(back(R, minus(right.v, left.v)), share), cross(e, turn))
    return stretch, minus(turned(T, right.spin), back(T, left.spin))


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
def _fill(S, o, xx, xt, tx, tt):
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
def tangent(section, at, c, cd, S, o):
    """Derivative of `forces`, c times by positions and cd by rates, to the `FACTOR` at o of S.

    What moments change by at second order in the element's own psi is left out, and what rates change by positions:
    Newton's iteration has no need of it.
    """
    R, Q, T = at.R, about_identity(0.5, times(at.g, 0.5), 0.0, at.g), at.T
    P, Tt = transposed(Q), transposed(T)
    rate = c
    if section.tau is not None:
        rate = section.tau * cd + c
    share = 1.0 / section.length
    D, K = times(section.stretch, rate), times(section.bend, share * rate)
    n, e = times(at.n, c), skew(at.e)
    nhat, De = skew(n), (times(e[0], D[0]), times(e[1], D[1]), times(e[2], D[2]))
    by_turn = difference(De, nhat)  # force in the middle's axes by its rotation; its transpose: moment by displacement
    moment = scaled(sum_of(product(transposed(e), De), product(nhat, e)), section.length)
    xx = scaled(product(_columns(R, D), transposed(R)), share)
    xt = product(R, by_turn)
    tx = transposed(xt)
    xl, xr = product(xt, P), product(xt, Q)
    lx, rx = product(Q, tx), product(P, tx)
    f, m = skew(times(cross(n, at.e), section.length * 0.125)), skew(times(at.m, 0.5 * c))
    left, right = difference(difference(m, f), _columns(T, K)), sum_of(sum_of(m, f), _columns(Tt, K))
    mP, mQ = product(moment, P), product(moment, Q)
    minus_xx = scaled(xx, -1.0)
    _fill(S, o + F.LL, xx, scaled(xl, -1.0), scaled(lx, -1.0), difference(product(Q, mP), product(left, Tt)))
    _fill(S, o + F.LR, minus_xx, scaled(xr, -1.0), lx, sum_of(product(Q, mQ), product(left, T)))
    _fill(S, o + F.RL, minus_xx, xl, scaled(rx, -1.0), difference(product(P, mP), product(right, Tt)))
    _fill(S, o + F.RR, xx, xr, rx, sum_of(product(P, mQ), product(right, T)))
