"""An element with two vertices in space: strains at its middle, end forces, their tangent, and its inertia (theory, 9).

With q_rel = q_left^-1 q_right the vertices' relative rotation and psi its rotation vector, the section turns about one
axis along the element, the middle is rotated by psi/2 from the left end, R is its rotation matrix, and

    Gamma = R^T (r_right - r_left) / l - e_x - psi x (psi x e_x) / 24,      kappa = psi / l
                                                                                (Simo & Vu-Quoc 1986, one point)

Gamma and kappa are objective and independent of the path (Crisfield & Jelenic 1999). The last term of Gamma is the
difference between the chord of a helix and its tangent at the middle. One strain point does not capture the bending by
a moment that grows along the element. The shear flexibility includes this missing (residual) bending flexibility, 1/C*
= 1/C + l^2 / (12 EI) (MacNeal 1978). Under loads at vertices, vertices then have the positions of the beam's sections.
With rotation increments dth in body axes,

    R^T dR = (P dth_l + Q dth_r)^,  P, Q = 1/2 -+ g^/2,  g = tan(|psi|/4) psi/|psi|;   dpsi = T^-1 dth_r - T^-T dth_l.

Where sections vary, the element bends about its center of flexibility, a l from the middle: Gamma_y + a_z psi_z and
Gamma_z - a_y psi_y, and the second moment of flexibility about this center replaces l^2 / (12 EI). Where a curvature
varies, the chord without stress is the curve's own (`layout.ELEMENT`).

The mass moves as a cubic through the vertices' positions and tangents t = A e_x, integrated by Simpson's rule: a sixth
at each vertex, four at r_m = (r_l + r_r)/2 + (t_l - t_r) l/8. Errors are of fourth order in l where an element bends.

Rows: forces (N) along inertial axes, moments (N m) in section axes, derivatives of the energy as in the residual."""

from __future__ import annotations

from typing import Any, NamedTuple

from ...compiler import Lanes, kernel
from .frame import cross_with_ex, ex_cross
from .layout import F
from .rotations import (
    Matrix,
    Vector,
    about_identity,
    compose,
    cross,
    dot,
    inverse_rotation,
    matrix,
    outer,
    plus_identity,
    scale,
    shortest_rotation,
    skew,
    skewed,
    store_matrix,
    turn_of,
)

BOW = 1.0 / 24.0
"""Relative shortening of a circular arc, 1 - chord/arc, divided by the square of the arc's angle (rad)."""


class Place(NamedTuple):
    """Position, velocity, rotation and angular velocity of a section."""

    r: Any  # m: position, inertial axes
    v: Any  # m/s: velocity, inertial axes
    p: Any  # quaternion: section axes to inertial axes
    spin: Any  # rad/s: angular velocity, section axes


class Middle(NamedTuple):
    """Kinematics and stress resultants at an element's middle that its forces and tangent need (axes of the middle).

    psi, g: relative rotation vector of the ends, rad, and tan(|psi|/4) psi/|psi|
    R, m: rotation matrix (axes of the middle to inertial axes), and moment conjugate to psi with the helix term's part,
    N m"""

    psi: Any
    R: Any
    # without unit: chord / l = Gamma + e_x + bow
    e: Any
    g: Any
    T: Any  # matrix T^-1(psi), inverse of the tangent map of rotations
    n: Any  # N: section force, axes of the middle section
    m: Any
    # only with damping, otherwise None
    spin: Any  # rad/s: angular velocity of the middle section
    slip: Any  # 1/s: velocity of the right end relative to the left end, divided by l
    both: Any  # rad/s: sum of the ends' angular velocities, each in the axes of its own section
    apart: Any  # rad/s: angular velocity of the right end minus that of the left end, each in its own axes
    bend: Any  # rad/s: time derivative of psi


@kernel
def middle(section, left, right):
    """Compute strains and stress resultants at an element's middle, all in the axes of the middle section (theory, 9).

    section: constants of the element (`Section`).
    left, right: positions, rotations and rates (`Place`) of the ends.
    Returns three items: the strains (Gamma, without unit; psi - psi_0, rad), the `Middle`, and the rates of the strains
    (1/s, rad/s; None undamped). Gamma is stretch and shear, psi the rotation vector from the left to the right end,
    psi_0 that without stress. With D and K, the fields stretch and EI of `Section`, and arc from `arc_of`:
    n = D (Gamma + tau Gamma'), m = K (psi - psi_0 + tau psi') / l + l arc^T n."""
    share = 1.0 / section.length
    # relative rotation psi, rotation R of the middle, chord e = R^T (r_r - r_l) / l
    relative = shortest_rotation(compose(inverse_rotation(left.p), right.p))
    psi, half, g, T = turn_of(relative)
    R = matrix(compose(left.p, half))
    e = share * (R.T @ (right.r - left.r))
    # strains; Gamma depends on psi through the helix term
    arc, bow = arc_of(section.uneven, psi), bow_of(section.uneven, psi)
    gamma = Vector(e[0] - 1.0 - bow[0], e[1] - bow[1], e[2] - bow[2])
    bent = psi - section.rest
    n, m = gamma, bent
    spin, slip, both, apart, bend, rates = None, None, None, None, None, None
    # Kelvin-Voigt: Gamma' = R^T (v_r - v_l) / l + e x w + arc psi', psi' = T^-1 w_r - T^-T w_l
    if section.tau is not None:
        spin, both = mean(g, left.spin, right.spin), left.spin + right.spin
        apart = right.spin - left.spin
        slip = share * (R.T @ (right.v - left.v))
        bend = T @ right.spin - T.T @ left.spin
        rates = slip + cross(e, spin) + arc @ bend, bend
        n, m = n + section.tau * rates[0], m + section.tau * bend
    # stress resultants; by virtual work n contributes to the moment with arc = dGamma/dpsi
    n = scale(n, section.stretch)
    m = share * scale(m, section.EI) + section.length * (arc.T @ n)
    return (gamma, bent), Middle(psi, R, e, g, T, n, m, spin, slip, both, apart, bend), rates


@kernel
def element_damping(section, before, after, share):
    """Return the damping power of an element over a step and its unresolved part, both divided by tau_d (W/s).

    before, after: pairs (left, right) of the ends' `Place`s at the step's start and end.
    share: 1 / step (1/s). The power is the stiffness times the squared change of strain per step. The unresolved part
    is the power of the same force at the mean of the strain rates before and after the step, minus the first value."""
    (stretch_0, bend_0), _, (stretch_rate_0, bend_rate_0) = middle(section, before[0], before[1])
    (stretch_1, bend_1), _, (stretch_rate_1, bend_rate_1) = middle(section, after[0], after[1])
    # Gamma', kappa' (section axes): (strain_1 - strain_0) / h, and n, m that they cause
    stretch, bend = share * (stretch_1 - stretch_0), share * (bend_1 - bend_0)
    pull = scale(section.length * stretch, section.stretch)
    moment = scale(1.0 / section.length * bend, section.EI)
    more = 0.5 * (stretch_rate_0 + stretch_rate_1) - stretch
    turn = 0.5 * (bend_rate_0 + bend_rate_1) - bend
    return dot(pull, stretch) + dot(moment, bend), dot(pull, more) + dot(moment, turn)


@kernel
def bow_of(uneven, psi):
    """Return chord / l - (e_x + Gamma) = psi x (psi x e_x)/24 + the part of uneven elements; axes of the middle.

    psi: rotation vector from left to right end, rad. uneven: (chord, a_y, a_z), or None where section and curvature are
    constant.
    chord: stress-free chord / l minus that of a circular arc; a_y, a_z: distance from the middle to the center of
    flexibility for bending about y, z, divided by l."""
    arc = BOW * cross(psi, cross_with_ex(psi))
    if uneven is None:
        return arc
    chord, y, z = uneven
    return Vector(arc[0] + chord[0], arc[1] + chord[1] - z * psi[2], arc[2] + chord[2] + y * psi[1])


@kernel
def arc_of(uneven, psi):
    """Return dGamma/dpsi = -d(`bow_of`)/dpsi, a 3 x 3 matrix in the axes of the middle. psi: rad; uneven: see `bow_of`.

    Gamma: stretch and shear at the middle; psi: rotation vector from the left to the right end."""
    x, y, z = BOW * psi
    zero = x * 0.0
    if uneven is None:
        return Matrix(Vector(zero, y * 2.0, z * 2.0), Vector(-y, -x, zero), Vector(-z, zero, -x))
    return Matrix(Vector(zero, y * 2.0, z * 2.0), Vector(-y, -x, uneven[2]), Vector(-z, -uneven[1], -x))


@kernel
def mean(g, a, b):
    """Return (a + b + g x (b - a))/2: the spin of an element's middle, axes of the middle, from its ends' spins a, b.

    a, b: spins of the left and right end, rad/s, each in its section's axes; g = tan(|psi|/4) psi/|psi| of the ends'
    relative rotation vector psi. The result equals P a + Q b, with P, Q = 1/2 -+ g^/2."""
    return 0.5 * (a + b + cross(g, b - a))


@kernel
def forces(section, at):
    """Return ((force, moment) on the left end, on the right end) from the stress resultants n, m of a `Middle` at.

    Forces -+ R n (N, inertial axes). Moments (N m, each in its section's axes): P^T l (n x e) - T^-1 m and Q^T l (n x
    e) + T^-T m, with P, Q = 1/2 -+ g^/2 and R, e, g, T of the `Middle`.
    l: length in section (`Section`)."""
    push = at.R @ at.n
    turn = section.length * cross(at.n, at.e)
    # P^T and Q^T applied to l n x e
    half, more = 0.5 * turn, 0.5 * cross(at.g, turn)
    left = half + more - at.T @ at.m
    return (-push, left), (push, half - more + at.T.T @ at.m)


@kernel
def _put(lane, S: Lanes, o, i, j, A):
    """Store the 3 x 3 matrix A as block (i, j), i, j = 0, 1, of the 6 x 6 matrix at offset o of S."""
    for a in range(3):
        for b in range(3):
            S[o + 18 * i + 6 * a + 3 * j + b] = A[a][b]


@kernel
def fill(lane, S, o, xx, xt, tx, tt):
    """Store four 3 x 3 blocks as the 6 x 6 matrix at offset o of S; block xt has position rows and rotation columns."""
    _put(lane, S, o, 0, 0, xx)
    _put(lane, S, o, 0, 1, xt)
    _put(lane, S, o, 1, 0, tx)
    _put(lane, S, o, 1, 1, tt)


@kernel
def tangent(lane, section, at, weights, S, o):
    """Store the derivative of `forces` by positions and rates in the `FACTOR` at offset o of S (theory, 9).

    section: constants of the element (`Section`).
    at: kinematics of its middle (`Middle`).
    weights: factors of dr/dq (stiffness) and dr/dv (damping).
    Rows: forces along inertial axes, moments in section axes.
    Columns: positions (inertial axes), rotations in body axes. Also stores the derivatives of n by the ends (by_place,
    by_left, by_right). Changes of moments of third order in psi are neglected."""
    R, g, T, e, psi, l = at.R, at.g, at.T, at.e, at.psi, section.length
    Tt, rate, c = T.T, weights.stiffness, weights.stiffness
    if section.tau is not None:
        rate = section.tau * weights.damping + c
    # material stiffness of n and m, springs and dampers: D (c_k + tau c_v), K (c_k + tau c_v) / l
    share = 1.0 / l
    D, b = rate * section.stretch, share * rate * section.EI
    arc, zero = arc_of(section.uneven, psi), l * 0.0
    n, own = c * at.n, at.m
    x, y, z = l * BOW * n
    # dGamma by the ends' rotations: e^ P - arc T^-T, e^ Q + arc T^-1; P, Q = 1/2 -+ g^/2 (T in the code is T^-1)
    swing, straight = _half_of_both(e, g)
    left_w, right_w = (straight - swing - arc @ Tt, straight + swing + arc @ T)
    # dn by the rotations of both ends and by r_r - r_l
    left_D, right_D, x_D = rows_of(D, left_w), rows_of(D, right_w), share * rows_of(D, R.T)
    # dm by psi: bending stiffness and the second derivative of the helix term times n
    bend = Matrix(Vector(b[0], -y, -z), Vector(-y, x * 2.0 + b[1], zero), Vector(-z, zero, x * 2.0 + b[2]))
    if section.tau is not None:
        # damper forces change with positions, too: e, slip and psi' are seen from axes that turn
        late, w, u = section.tau * c * section.stretch, at.spin, at.slip
        x_D = x_D - share * rows_of(late, skewed(w, R.T))
        swing = skew(u) + plus_identity(-outer(e, w), dot(w, e))
        straight = Matrix(cross(swing[0], g), cross(swing[1], g), cross(swing[2], g))
        d, more = 0.125 * at.apart, weights.newton_share * late
        # by psi, e x (dg x apart) / 2 with g = psi / 4, and what the arc has of its rate
        unlike = rows_of(more, plus_identity(outer(d, -e), dot(d, e)) + arc_of(None, at.bend))
        left_D, right_D, late = left_D - unlike, right_D + unlike, 0.5 * late
        left_D = left_D + rows_of(late, swing - straight)
        right_D = right_D + rows_of(late, swing + straight)
        bend = bend - rows_of(share * section.tau * c * 0.5 * section.EI, skew(at.both))
    # dn/d(r_r - r_l), dn/dtheta: for the correction of places (`settled`)
    store_matrix(lane, S, o + F.by_place, x_D)
    store_matrix(lane, S, o + F.by_left, left_D)
    store_matrix(lane, S, o + F.by_right, right_D)
    # how the force R n turns with the ends; xx, xl, xr: force on the right end by places and rotations
    swing, straight = _half_of_both(n, g)
    own_l, own_r = R @ (swing - straight), R @ (swing + straight)
    xx, xl, xr = R @ x_D, R @ left_D + own_l, R @ right_D - own_r
    # moments by places; the geometric part is the transpose of the force's
    left_w, right_w = l * left_w.T, l * right_w.T
    lx, rx = left_w @ x_D + own_l.T, right_w @ x_D - own_r.T
    # l n^ e^ between P or Q and P or Q
    Qe, Pe, Qn, Pn = _half(g, e), _half(-g, e), _half(g, l * n), _half(-g, l * n)
    along, square = dot(n, e) * l, dot(g, g)
    gg = 0.25 * along * outer(g, g)
    crossing, turning = (
        plus_identity(gg, along * (square + 1.0) * -0.25),
        plus_identity(-gg, along * (square - 1.0) * 0.25),
    )
    # end moments by psi: through T^-1 m and T^-T m, and through g = psi/4 + ... in P^T, Q^T (l n x e)
    spin = skew(0.5 * along * g)
    f, m = l * 0.125 * cross(n, e), 0.5 * c * own
    swing = _second(psi, c * (1.0 / 12.0) * own)  # of psi x (psi x m) / 12 in T m
    left = skew(m - f) - swing - T @ bend
    right = skew(m + f) + swing + Tt @ bend
    # moments by rotations: material, geometric, and bending through dpsi = T^-1 dth_r - T^-T dth_l
    ll = left_w @ left_D + (outer(Qe, Qn) + crossing - left @ Tt)
    lr = left_w @ right_D + (outer(Qe, Pn) + turning - spin + left @ T)
    rl = right_w @ left_D + (outer(Pe, Qn) + turning + spin - right @ Tt)
    rr = right_w @ right_D + (outer(Pe, Pn) + crossing + right @ T)
    minus_xx = -xx
    fill(lane, S, o + F.LL, xx, -xl, -lx, ll)
    fill(lane, S, o + F.LR, minus_xx, -xr, lx, lr)
    fill(lane, S, o + F.RL, minus_xx, xl, -rx, rl)
    fill(lane, S, o + F.RR, xx, xr, rx, rr)


@kernel
def rows_of(d, A):
    """Return diag(d) A: each row i of the matrix A is multiplied by the component d[i]."""
    return Matrix(d[0] * A[0], d[1] * A[1], d[2] * A[2])


@kernel
def _half_of_both(a, g):
    """Return a^ g^ / 2 and a^ / 2. With P, Q = 1/2 -+ g^/2 their difference gives a^ P, their sum a^ Q."""
    half = 0.5 * a
    return plus_identity(outer(g, half), -dot(half, g)), skew(half)


@kernel
def _half(g, a):
    """Return (a + g x a) / 2 = P^T a; called with -g for g, it returns Q^T a. P and Q are 1/2 -+ g^/2."""
    return 0.5 * (a + cross(g, a))


@kernel
def _second(a, m):
    """Return the derivative of the vector a x (a x m) by a: the matrix a m^T + (a . m) 1 - 2 m a^T."""
    x, y = dot(a, m), -2.0 * m
    rows = Matrix(a[0] * m + y[0] * a, a[1] * m + y[1] * a, a[2] * m + y[2] * a)
    return rows + about_identity(x, 0.0 * a, 0.0, a)


class Tangent(NamedTuple):
    """Tangent t = A e_x of a vertex: A (section to inertial axes), spin w (rad/s) and t'' (1/s^2), in section axes."""

    A: Any
    w: Any
    second: Any
    own: Any  # rad/s: rate of the joint before the vertex, see `chain.Vertex`


@kernel
def tangent_of(at):
    """Return the `Tangent` of a `Vertex`, with t'' = alpha x e_x + w x (w x e_x) in section axes."""
    w, alpha = at.place.spin, at.alpha
    second = Vector(-(w[1] * w[1] + w[2] * w[2]), w[0] * w[1] + alpha[2], w[0] * w[2] - alpha[1])
    return Tangent(matrix(at.place.p), w, second, at.own)


@kernel
def _by_turn(t, weights):
    """Return B = A^T d(t'')/d(rotation increment of its vertex), 3 x 3 in section axes, for the `Tangent` t.

    t'': second rate of the vertex' tangent A e_x. Rates and accelerations follow the increment with the `Weights`
    weights: B sums the derivatives times mass, damping, stiffness."""
    w, zero = t.w, t.w[0] * 0.0
    ck, cd, cm = weights.stiffness, weights.damping, weights.mass
    # -(e^ (cm - own^ cd) + t''^ ck + ((w x e)^ + w^ e^) cd), e = e_x
    u, o = ck * t.second, cd * t.own
    x, y, z = w[0] * cd - o[0], w[1] * cd, w[2] * cd
    return Matrix(
        Vector(zero, u[2] - y * 2.0, -(u[1] + z * 2.0)),
        Vector(y + o[1] - u[2], x, u[0] + cm),
        Vector(z + o[2] + u[1], -(u[0] + cm), x),
    )


@kernel
def inertia_wrenches(lane, mass, length, left, right, weights, S, o):
    """Compute the inertia forces of the mass at an element's middle; add their derivative to the `FACTOR` at o of S.

    f = m ((a_l + a_r)/2 + l/8 (t''_l - t''_r)), a: acceleration less gravity, t: tangent A e_x of each end; left,
    right: `Vertex`; mass m (kg), length l (m). Returns (force, moment) on the left and the right end: f/2 (N, inertial
    axes), +- l/8 e_x x A^T f (N m, section axes). Without weights.with_matrix the `FACTOR` stays unchanged. See
    docs/theory.md, section 9, "inertia"."""
    arm = length * 0.125
    tl, tr = tangent_of(left), tangent_of(right)
    bent = tl.A @ tl.second - tr.A @ tr.second
    # inertia force f, inertial axes; own_l, own_r: the same in the axes of either end
    f = mass * (0.5 * (left.a + right.a) + arm * bent)
    half, own_l, own_r = 0.5 * f, tl.A.T @ f, tr.A.T @ f
    if weights.with_matrix:
        share = mass * arm
        # df by the ends' rotations: A B on the left, with the opposite sign on the right
        Bl, Br = share * _by_turn(tl, weights), -share * _by_turn(tr, weights)
        xl, xr = tl.A @ Bl, tr.A @ Br
        quarter, own, turn = 0.25 * weights.mass * mass, 0.5 * weights.mass * share, arm * weights.stiffness
        _add(lane, S, o + F.LL, quarter, xl, tl.A, own, Bl, arm)
        _add(lane, S, o + F.LR, quarter, xr, tl.A, own, tl.A.T @ xr, arm)
        _add(lane, S, o + F.RL, quarter, xl, tr.A, -own, tr.A.T @ xl, -arm)
        _add(lane, S, o + F.RR, quarter, xr, tr.A, -own, Br, -arm)
        # the lever l/8 e_x turns with the section against f
        _add_turn(lane, S, o + F.LL, turn * own_l)
        _add_turn(lane, S, o + F.RR, -turn * own_r)
    return (half, arm * ex_cross(own_l)), (half, -arm * ex_cross(own_r))


@kernel
def _add(lane, S: Lanes, o, x, xt, A, tx, tt, arm):
    """Add the derivative of a middle mass's wrench on one end, by motion of an end, to the 6 x 6 block at o of S.

    Rows: force (inertial axes), moment (section axes).
    Columns: position (inertial axes), rotation (section axes). Force rows: x 1 and xt/2. Moment rows: tx e_x^ A^T and
    arm e_x^ tt.
    x, tx, arm: numbers; xt, A, tt: 3 x 3."""
    for a in range(3):
        S[o + 7 * a] += x
        for b in range(3):
            S[o + 6 * a + 3 + b] += xt[a][b] * 0.5
        S[o + 24 + a] += A[a][2] * -tx
        S[o + 30 + a] += A[a][1] * tx
        S[o + 27 + a] += tt[2][a] * -arm
        S[o + 33 + a] += tt[1][a] * arm


@kernel
def _add_turn(lane, S: Lanes, o, f):
    """Add e_x^ f^ = f e_x^T - f_x 1 (rows y and z) to the rotation block of the 6 x 6 matrix at o of S. f: vector."""
    S[o + 27] += f[1]
    S[o + 28] -= f[0]
    S[o + 33] += f[2]
    S[o + 35] -= f[0]


@kernel
def add_block(lane, S: Lanes, o, i, j, A):
    """Add the 3 x 3 matrix A to the 6 x 6 matrix at offset o of S, from row 3 i and column 3 j on (i, j: 0 or 1)."""
    for a in range(3):
        for b in range(3):
            S[o + 18 * i + 6 * a + 3 * j + b] += A[a][b]


@kernel
def middle_of(length, left, right):
    """Return the position r_m (m) and velocity (m/s), along inertial axes, of the mass at an element's middle.

    r_m = (r_l + r_r)/2 + l/8 (t_l - t_r), with the ends' tangents t = A e_x and t' = A (w x e_x)."""
    A, B, arm = matrix(left.p), matrix(right.p), length * 0.125
    bent = A.T[0] - B.T[0]
    a, b = left.spin, right.spin
    zero = a[0] * 0.0
    turning = A @ Vector(zero, a[2], -a[1]) - B @ Vector(zero, b[2], -b[1])
    r, v = 0.5 * (left.r + right.r), 0.5 * (left.v + right.v)
    return r + arm * bent, v + arm * turning
