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

Where sections vary, the element bends about the centre of its flexibility, a l from the middle, and moments are those
there: the chord is that of the part beyond, which turns by (1/2 - a) psi, and so Gamma_y + a_z psi_z, Gamma_z - a_y
psi_y. Shear has the flexibility's second moment about there in place of l^2 / (12 EI). Where a curvature varies, the
chord without stress is the curve's own (`layout.ELEMENT`).

Mass is where a cubic of the vertices' places and tangents t = A e_x has it, by Simpson's rule: a sixth at each vertex,
four at r_m = (r_l + r_r)/2 + (t_l - t_r) l/8. With these an element's error is of fourth order in l where it bends.

Rows: forces along inertial axes, moments in the section's own.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from ...compiler import kernel, store
from ..arithmetic import add
from ..protocol import of_step
from .frame import across, lifted
from .layout import F
from .rotations import (
    about_identity,
    back,
    composed,
    cross,
    difference,
    dot,
    inverse,
    matrix,
    minus,
    outer,
    plus,
    plus_identity,
    product,
    put_matrix,
    scaled,
    shorter,
    skew,
    skewed,
    sum_of,
    times,
    transposed,
    turn_of,
    turned,
)

BOW = 1.0 / 24.0
"""Of the square of its angle: an arc is longer by that share than its chord."""


class Section(NamedTuple):
    """An element's constants, with the arm's own factors (`layout.ELEMENT`)."""

    length: Any
    stretch: Any
    bend: Any
    rest: Any
    uneven: Any  # (chord, tilt, tilt) of `layout.ELEMENT`, or None
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
    spin: Any  # that it turns by, 1/s, and so are the next two; None without damping
    slip: Any  # of the right end against the left, over the length
    both: Any  # sum of the ends' spins
    apart: Any  # the right end's less the left's
    bend: Any  # rate of psi


@kernel
def scale(a, d):
    """Vector a, entry by entry times d."""
    return a[0] * d[0], a[1] * d[1], a[2] * d[2]


@kernel
def middle(section, left, right):
    """Strains, and stress resultants of the middle: (Gamma, l kappa less its rest), Middle; the strains' rates, or None
    without damping."""
    share = 1.0 / section.length
    relative = shorter(composed(inverse(left.p), right.p))
    psi, half, g, T = turn_of(relative)
    R = matrix(composed(left.p, half))
    e = times(back(R, minus(right.r, left.r)), share)
    arc, bow = arc_of(section.uneven, psi), bow_of(section.uneven, psi)
    gamma = e[0] - 1.0 - bow[0], e[1] - bow[1], e[2] - bow[2]
    bent = minus(psi, section.rest)
    n, m = gamma, bent
    spin, slip, both, apart, bend, rates = None, None, None, None, None, None
    if section.tau is not None:
        spin, both = mean(g, left.spin, right.spin), plus(left.spin, right.spin)
        apart = minus(right.spin, left.spin)
        slip = times(back(R, minus(right.v, left.v)), share)
        bend = minus(turned(T, right.spin), back(T, left.spin))
        rates = plus(plus(slip, cross(e, spin)), turned(arc, bend)), bend
        n, m = plus(n, times(rates[0], section.tau)), plus(m, times(bend, section.tau))
    n = scale(n, section.stretch)
    m = plus(times(scale(m, section.bend), share), times(back(arc, n), section.length))
    return (gamma, bent), Middle(psi, R, e, g, T, n, m, spin, slip, both, apart, bend), rates


@kernel
def bow_of(uneven, psi):
    """What a chord has beside e_x and Gamma, an arc bent by psi: psi x (psi x e_x) / 24, and what is uneven."""
    arc = times(cross(psi, across(psi)), BOW)
    if uneven is None:
        return arc
    chord, y, z = uneven
    return arc[0] + chord[0], arc[1] + chord[1] - z * psi[2], arc[2] + chord[2] + y * psi[1]


@kernel
def arc_of(uneven, psi):
    """Derivative of Gamma by psi: of - `bow_of`."""
    x, y, z = times(psi, BOW)
    zero = x * 0.0
    if uneven is None:
        return (zero, y * 2.0, z * 2.0), (-y, -x, zero), (-z, zero, -x)
    return (zero, y * 2.0, z * 2.0), (-y, -x, uneven[2]), (-z, -uneven[1], -x)


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
def tangent(section, at, weights, S, o):
    """Derivative of `forces` by positions and by rates to the `FACTOR` at o of S.

    What moments change by at third order in the element's own psi is left out: Newton's iteration has no need of it.
    """
    R, g, T, e, psi, l = at.R, at.g, at.T, at.e, at.psi, section.length
    Tt, rate, c = transposed(T), weights.stiffness, weights.stiffness
    if section.tau is not None:
        rate = section.tau * weights.damping + c
    share = 1.0 / l
    D, b = times(section.stretch, rate), times(section.bend, share * rate)
    arc, zero = arc_of(section.uneven, psi), l * 0.0
    n, own = times(at.n, c), at.m
    x, y, z = times(n, l * BOW)
    # of Gamma by the rotations of the ends: e^ P - arc T^T, e^ Q + arc T; P, Q = 1/2 -+ g^/2
    swing, straight = _half_of_both(e, g)
    left_w, right_w = (
        difference(difference(straight, swing), product(arc, Tt)),
        sum_of(sum_of(straight, swing), product(arc, T)),
    )
    left_D, right_D, x_D = rows_of(D, left_w), rows_of(D, right_w), scaled(rows_of(D, transposed(R)), share)
    bend = (b[0], -y, -z), (-y, x * 2.0 + b[1], zero), (-z, zero, x * 2.0 + b[2])
    if section.tau is not None:  # what rates change by positions: e, slip and psi seen from axes that turn
        late, w, u = times(section.stretch, section.tau * c), at.spin, at.slip
        x_D = difference(x_D, scaled(rows_of(late, skewed(w, transposed(R))), share))
        swing = sum_of(skew(u), plus_identity(scaled(outer(e, w), -1.0), dot(w, e)))
        straight = cross(swing[0], g), cross(swing[1], g), cross(swing[2], g)
        d, more = times(at.apart, 0.125), times(late, of_step(weights))
        # by psi, e x (dg x apart) / 2 with g = psi / 4, and what the arc has of its rate
        unlike = rows_of(more, sum_of(plus_identity(outer(d, times(e, -1.0)), dot(d, e)), arc_of(None, at.bend)))
        left_D, right_D, late = difference(left_D, unlike), sum_of(right_D, unlike), times(late, 0.5)
        left_D = sum_of(left_D, rows_of(late, difference(swing, straight)))
        right_D = sum_of(right_D, rows_of(late, sum_of(swing, straight)))
        bend = difference(bend, rows_of(times(section.bend, share * section.tau * c * 0.5), skew(at.both)))
    put_matrix(S, o + F.by_place, x_D)
    put_matrix(S, o + F.by_left, left_D)
    put_matrix(S, o + F.by_right, right_D)
    swing, straight = _half_of_both(n, g)
    own_l, own_r = product(R, difference(swing, straight)), product(R, sum_of(swing, straight))
    xx, xl, xr = product(R, x_D), sum_of(product(R, left_D), own_l), difference(product(R, right_D), own_r)
    left_w, right_w = scaled(transposed(left_w), l), scaled(transposed(right_w), l)
    lx, rx = sum_of(product(left_w, x_D), transposed(own_l)), difference(product(right_w, x_D), transposed(own_r))
    # l n^ e^ between P or Q and P or Q
    Qe, Pe, Qn, Pn = _half(g, e), _half(times(g, -1.0), e), _half(g, times(n, l)), _half(times(g, -1.0), times(n, l))
    along, square = dot(n, e) * l, dot(g, g)
    gg = scaled(outer(g, g), 0.25 * along)
    crossing, turning = (
        plus_identity(gg, along * (square + 1.0) * -0.25),
        plus_identity(scaled(gg, -1.0), along * (square - 1.0) * 0.25),
    )
    spin = skew(times(g, 0.5 * along))
    f, m = times(cross(n, e), l * 0.125), times(own, 0.5 * c)
    swing = _second(psi, times(own, c * (1.0 / 12.0)))  # of psi x (psi x m) / 12 in T m
    left = difference(difference(skew(minus(m, f)), swing), product(T, bend))
    right = sum_of(sum_of(skew(plus(m, f)), swing), product(Tt, bend))
    ll = sum_of(product(left_w, left_D), difference(sum_of(outer(Qe, Qn), crossing), product(left, Tt)))
    lr = sum_of(product(left_w, right_D), sum_of(difference(sum_of(outer(Qe, Pn), turning), spin), product(left, T)))
    rl = sum_of(product(right_w, left_D), difference(sum_of(sum_of(outer(Pe, Qn), turning), spin), product(right, Tt)))
    rr = sum_of(product(right_w, right_D), sum_of(sum_of(outer(Pe, Pn), crossing), product(right, T)))
    minus_xx = scaled(xx, -1.0)
    fill(S, o + F.LL, xx, scaled(xl, -1.0), scaled(lx, -1.0), ll)
    fill(S, o + F.LR, minus_xx, scaled(xr, -1.0), lx, lr)
    fill(S, o + F.RL, minus_xx, xl, scaled(rx, -1.0), rl)
    fill(S, o + F.RR, xx, xr, rx, rr)


@kernel
def rows_of(d, A):
    """diag(d) A."""
    return times(A[0], d[0]), times(A[1], d[1]), times(A[2], d[2])


@kernel
def _half_of_both(a, g):
    """a^ g^ / 2 and a^ / 2: a^ P is the second less the first, a^ Q their sum."""
    half = times(a, 0.5)
    return plus_identity(outer(g, half), -dot(half, g)), skew(half)


@kernel
def _half(g, a):
    """(a + g x a) / 2."""
    return times(plus(a, cross(g, a)), 0.5)


@kernel
def _second(a, m):
    """Derivative of a x (a x m) by a: a m^T + (a . m) 1 - 2 m a^T."""
    x, y = dot(a, m), times(m, -2.0)
    rows = (
        plus(times(m, a[0]), times(a, y[0])),
        plus(times(m, a[1]), times(a, y[1])),
        plus(times(m, a[2]), times(a, y[2])),
    )
    return sum_of(rows, about_identity(x, times(a, 0.0), 0.0, a))


class Tangent(NamedTuple):
    """The tangent t = A e_x of a vertex: axes A, and the second rate of t in them."""

    A: Any
    w: Any
    second: Any
    own: Any  # see `chain.Vertex`


@kernel
def tangent_of(at):
    """Of a `Vertex`."""
    w, alpha = at.place.spin, at.alpha
    second = -(w[1] * w[1] + w[2] * w[2]), w[0] * w[1] + alpha[2], w[0] * w[2] - alpha[1]
    return Tangent(matrix(at.place.p), w, second, at.own)


@kernel
def _by_turn(t, weights):
    """Derivative, over A, of the second rate of t by rotation increments of its vertex."""
    w, zero = t.w, t.w[0] * 0.0
    ck, cd, cm = weights.stiffness, weights.damping, weights.mass
    # -(e^ (cm - own^ cd) + second^ ck + ((w x e)^ + w^ e^) cd)
    u, o = times(t.second, ck), times(t.own, cd)
    x, y, z = w[0] * cd - o[0], w[1] * cd, w[2] * cd
    return (
        (zero, u[2] - y * 2.0, -(u[1] + z * 2.0)),
        (y + o[1] - u[2], x, u[0] + cm),
        (z + o[2] + u[1], -(u[0] + cm), x),
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
        share = mass * arm
        Bl, Br = scaled(_by_turn(tl, weights), share), scaled(_by_turn(tr, weights), -share)
        xl, xr = product(tl.A, Bl), product(tr.A, Br)
        quarter, own, turn = 0.25 * weights.mass * mass, 0.5 * weights.mass * share, arm * weights.stiffness
        _add(lane, S, o + F.LL, quarter, xl, tl.A, own, Bl, arm)
        _add(lane, S, o + F.LR, quarter, xr, tl.A, own, product(transposed(tl.A), xr), arm)
        _add(lane, S, o + F.RL, quarter, xl, tr.A, -own, product(transposed(tr.A), xl), -arm)
        _add(lane, S, o + F.RR, quarter, xr, tr.A, -own, Br, -arm)
        _add_turn(lane, S, o + F.LL, times(own_l, turn))
        _add_turn(lane, S, o + F.RR, times(own_r, -turn))
    return (half, times(lifted(own_l), arm)), (half, times(lifted(own_r), -arm))


@kernel
def _add(lane, S, o, x, xt, A, tx, tt, arm):
    """To a matrix of an element: x along each axis; half of xt; e_x^ A^T tx; e_x^ tt arm."""
    for a in range(3):
        add(lane, S, o + 7 * a, x)
        for b in range(3):
            add(lane, S, o + 6 * a + 3 + b, xt[a][b] * 0.5)
        add(lane, S, o + 24 + a, A[a][2] * -tx)
        add(lane, S, o + 30 + a, A[a][1] * tx)
        add(lane, S, o + 27 + a, tt[2][a] * -arm)
        add(lane, S, o + 33 + a, tt[1][a] * arm)


@kernel
def _add_turn(lane, S, o, f):
    """e_x^ f^ to the rotations' block: f e_x^T - f_x."""
    add(lane, S, o + 27, f[1])
    add(lane, S, o + 28, -f[0])
    add(lane, S, o + 33, f[2])
    add(lane, S, o + 35, -f[0])


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
