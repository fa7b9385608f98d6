"""Kernels of one body with a floating frame: motion of its tip, inertia forces [57]-[63], elastic and damping forces.

A body's frame has origin R and angle theta. In frame axes the body's tip has the position t(q). The body's root section
is rotated by the angle rho'q relative to the frame. Gravity enters as an acceleration of the frame, so positions R are
not needed. The sweep from root to tip therefore transmits only a section's angle, its rates and its acceleration. The
sweep from tip to root transmits a force and a moment (theory, section 3).

Recurring arguments. `model` is the `Mesh`, common to all bodies. `D` is one body's block of constants
(`constants.BODY`). q, v, a begin at the body's n elastic coordinates. E = [[0, -1], [1, 0]] rotates a vector by 90 deg.
In a frame that rotates at w the derivative of a vector y is y' + w E y.
"""

from ...compiler import Lanes, kernel, sincos, size, unrolled
from ..arithmetic import load_pair, load_vector, rotate_2d, rotate_back_2d, store_pair, store_vector
from ..model import STIFFNESS_FACTOR, TAU_D
from .constants import body_at, span_at
from .layout import KNOWN, NOW, PASSED, factors_at, strain_at, vectors_at, window


@kernel
def constants(model):
    """Return a named tuple with the index of each field of `constants.BODY` in a body's block of constants."""
    return body_at(0, size(model.n), len(model.window), len(model.elements), 0)


@kernel
def damping_time(lane, model, D, par: Lanes):
    """Return the body's damping time (s): the arm's tau_d in par, times the body's share if tau_d differs by link."""
    tau = par[TAU_D]
    if model.damped is not None and len(model.damped) > 1:
        tau = tau * D[constants(model).damped]
    return tau


@kernel
def dot(lane, model, D, at, x: Lanes):
    """Return sum_j D[at + j] x_j, summed over the body's n elastic coordinates (or their rates or accelerations) x."""
    total = x[0] * D[at]
    for j in range(1, size(model.n)):
        total = total + x[j] * D[at + j]
    return total


@kernel
def along(lane, model, D, at, x):
    """Return sum_j D[at + j] x_j of a shape function along the axis of the body's frame (m for coordinates x).

    D: constants of the body.
    at: offset of the shape function in D.
    x: elastic coordinates, rates or accelerations. Bodies reduced to modes have no shape functions along the axis. For
    them the result is -0.0, because x + -0.0 is x to the last bit.
    """
    if model.modal is not None:
        return -0.0
    return dot(lane, model, D, at, x)


@kernel
def product(lane, model, D, at, x: Lanes, y):
    """Return x' A y, where the n x n matrix A is stored row by row in D from index `at` on."""
    n = size(model.n)
    total = x[0] * dot(lane, model, D, at, y)
    for i in range(1, n):
        total = total + x[i] * dot(lane, model, D, at + i * n, y)
    return total


@kernel
def in_window(lane, model, D, at, x: Lanes, first):
    """Return sum_j D[at + j] x[first + j] over the elastic coordinates of one finite element (its window)."""
    total = x[first] * D[at]
    for j in range(1, len(model.window)):
        total = total + x[first + j] * D[at + j]
    return total


@kernel
def tip(lane, model, D, x):
    """Return (u, v, phi)'x at the body's tip: displacement (m) along and across the frame's axis, section angle (rad).

    Foreshortening of bodies reduced to modes is not included.
    x: elastic coordinates of the body, or their rates or accelerations.
    """
    own = constants(model)
    return along(lane, model, D, own.tip_u, x), dot(lane, model, D, own.tip_v, x), dot(lane, model, D, own.tip_phi, x)


@kernel
def turn_of_root(lane, model, D, x):
    """Return the root section's angle rho'x (rad) relative to the body's frame; 0 for a frame clamped to the root."""
    if model.chord is None:
        return 0.0
    return dot(lane, model, D, constants(model).root, x)


@unrolled
@kernel
def propagate_to_tip(lane, model, D, q, v, a, pose, S):
    """Propagate angle, rates and acceleration from a body's root section to its tip section.

        theta = angle - rho'q,   r''_tip = R'' + A (t'' + 2 w E t' + alpha E t - w^2 t)       (theory, eq. 3.1)

    A: rotation by the frame's angle theta.
    E: matrix of a rotation by 90 deg.
    w, alpha: angular velocity theta' and acceleration theta'' of the frame.
    t: position of the tip in frame axes.
    R: position of the frame's origin.

    # state    q, v, a: elastic coordinates, rates, accelerations
    # in, out  pose (5,), `PASSED`: at the root section, then at the tip section; inertial axes
    # out      S: `NOW` of the body's `FACTORS`; frame axes
    """
    own, now = constants(model), factors_at(0, size(model.n)).now
    # angle and rates of the frame: the root section's, less rho'q (frame through both ends)
    angle, w, alpha = load_vector(lane, pose, PASSED.angle)
    if model.chord is not None:
        angle = angle - turn_of_root(lane, model, D, q)
        w = w - turn_of_root(lane, model, D, v)
        alpha = alpha - turn_of_root(lane, model, D, a)
    # R'' - g in the frame's axes
    sine, cosine = sincos(angle)
    gx, gy = load_pair(lane, pose, PASSED.ax)
    ax, ay = rotate_back_2d(cosine, sine, gx, gy)
    # t(q), its first and second derivative in the frame; modes shorten x = length + u by q'H q / 2
    x, y, phi = tip(lane, model, D, q)
    tx, ty, rate = tip(lane, model, D, v)
    hx, hy, second = tip(lane, model, D, a)
    x = x + D[own.length]
    if model.modal is not None:
        x = x - product(lane, model, D, own.tip_H, q, q) * 0.5
        tx = tx - product(lane, model, D, own.tip_H, q, v)
        hx = hx - (product(lane, model, D, own.tip_H, q, a) + product(lane, model, D, own.tip_H, v, v))
    # acceleration of the tip relative to the origin, frame axes
    bx = hx - alpha * y - (w * w) * x - (w * ty) * 2.0
    by = hy + alpha * x - (w * w) * y + (w * tx) * 2.0
    store_pair(lane, S, now + NOW.cos, (cosine, sine))
    store_pair(lane, S, now + NOW.a, (ax, ay))
    store_pair(lane, S, now + NOW.rate, (w, alpha))
    store_pair(lane, S, now + NOW.tip, (x, y))
    store_pair(lane, S, now + NOW.tip_rate, (tx - w * y, ty + w * x))
    store_pair(lane, S, now + NOW.tip_second, (bx, by))
    # tip section: angle and rates; acceleration less gravity in inertial axes
    store_vector(lane, pose, PASSED.angle, (angle + phi, w + rate, alpha + second))
    store_pair(lane, pose, PASSED.ax, rotate_2d(cosine, sine, ax + bx, ay + by))


@kernel
def _strains(lane, model, D, tau, q: Lanes, v: Lanes, strains: Lanes):
    """Compute each element's axial force (N), and the gradient of its stretch by the coordinates of its window.

        von Karman:  stretch = g'q + q'Hq / 2,  gradient = g + H q,  its rate H v        (theory, eq. 1.2)
        paper:       stretch = g'q, "gradient" = G q of equation [45], whose force has no potential

    g, H (G) are `SPAN.stretch` and `SPAN.H`. The window is the element's elastic coordinates, from `window` on.

    # in       tau: tau_d, s; q, v: elastic coordinates and rates; EA has no factor
    # out      strains: a `STRAIN` per element; `rate` only with damping and von Karman
    """
    n, wide = size(model.n), len(model.window)
    own = span_at(constants(model).spans, wide)
    kept = strain_at(0, wide)
    for e in range(len(model.elements)):
        first = window(model, n, e)
        linear, half, lost = 0.0, 0.0, 0.0
        # linear = g'q, half = q'Hq, lost = gradient'v (rate of the stretch)
        for i in range(wide):
            slope = in_window(lane, model, D, own.H + i * wide, q, first)
            x = q[first + i]
            linear, half = linear + x * D[own.stretch + i], half + x * slope
            if model.full is None:
                strains[kept.slope + i] = slope
            else:
                slope = slope + D[own.stretch + i]
                lost = lost + v[first + i] * slope
                strains[kept.slope + i] = slope
        # N = EA/l (stretch + tau_d times its rate)
        force = linear * D[own.stiffness]
        if model.full is not None:
            force = (linear + half * 0.5) * D[own.stiffness]
            if model.damped is not None:
                force = force + (lost * tau) * D[own.stiffness]
                for i in range(wide):
                    strains[kept.rate + i] = in_window(lane, model, D, own.H + i * wide, v, first)
        strains[kept.force] = force
        own, kept = span_at(own.end, wide), strain_at(kept.end, wide)


@unrolled
@kernel
def forces(
    lane, model, D, par: Lanes, carried, q: Lanes, v: Lanes, a: Lanes, force: Lanes, known, vectors: Lanes,
    strains: Lanes, S, r: Lanes,
):  # fmt: skip
    """Compute a body's rows r of the residual, and the force G_b and moment M_b that the body requires at its root.

        M_b = f_theta + (E t)'g + M,  r = f_q + K q + (dt/dq)'g + phi_t M - rho M_b,  G_b = f_R + G   (theory, eq. 3.2)

    f: inertia forces with gravity, equations [61]-[63] (theory, 2.4). K q: elastic forces [44], [45] with damping. t,
    phi_t'q: position and angle of the tip in frame axes. rho'q: angle of the root section relative to the frame.
    E: matrix of a rotation by 90 deg.
    G, M: force and moment required at the tip.
    g: the force G in frame axes.

    # model    D. par: the arm's parameters (factor on bending stiffness, tau_d)
    # state    q, v, a: elastic coordinates, rates, accelerations; S: `NOW`, written by `propagate_to_tip`
    # in       carried (2,): mass (kg) and inertia (kg m^2) at the tip, read by mass-proportional damping alone
    # in, out  force (3,): force (N, inertial axes) and moment (N m) required at the tip by all bodies beyond it; then
    #          at the root by this body and all beyond
    # out      r: n rows of q. known, vectors, strains: `KNOWN`, `VECTORS`, `STRAIN`, which `tangent` needs
    """
    own, n = constants(model), size(model.n)
    now, vec = factors_at(0, n).now, vectors_at(0, n)
    # R'' - g (frame axes), w, alpha; g = A^T G (frame axes) and the moment M at the tip (3.2)
    cos, sin = load_pair(lane, S, now + NOW.cos)
    ax, ay = load_pair(lane, S, now + NOW.a)
    w, alpha = load_pair(lane, S, now + NOW.rate)
    stiffness, tau = par[STIFFNESS_FACTOR], damping_time(lane, model, D, par)
    fx, fy, moment = load_vector(lane, force, 0)
    gx, gy = rotate_back_2d(cos, sin, fx, fy)
    # first moment s = s_bar(q) (theory, eq. 2.2), its first and second derivative t, h in the frame
    sx, sy = along(lane, model, D, own.S_bar_x, q) + D[own.S0], dot(lane, model, D, own.S_bar_y, q)
    tx, ty = along(lane, model, D, own.S_bar_x, v), dot(lane, model, D, own.S_bar_y, v)
    hx, hy = along(lane, model, D, own.S_bar_x, a), dot(lane, model, D, own.S_bar_y, a)
    if model.modal is not None:
        sx = sx - product(lane, model, D, own.D0, q, q) * 0.5
        tx = tx - product(lane, model, D, own.D0, q, v)
        hx = hx - (product(lane, model, D, own.D0, q, a) + product(lane, model, D, own.D0, v, v))
    # I(q), I'/2 = (c_u + G q)'v and (c + B q)'a
    inertia, spin_rate, lever = D[own.I0], 0.0, 0.0
    for i in range(n):
        gq = dot(lane, model, D, own.G + i * n, q)
        if model.modal is None:
            inertia = inertia + (gq + 2.0 * D[own.c_u + i]) * q[i]
            gq = gq + D[own.c_u + i]
        else:
            inertia = inertia + gq * q[i]
        cb = along(lane, model, D, own.B + i * n, q) + D[own.c + i]
        spin_rate = spin_rate + gq * v[i]
        lever = lever + cb * a[i]
        vectors[vec.gq + i] = gq
        vectors[vec.cb + i] = cb
    # d = f_R - m_t (R'' - g) in frame axes
    square = w * w
    mass = D[own.mass]
    dx = hx - alpha * sy - square * sx - (w * ty) * 2.0
    dy = hy + alpha * sx - square * sy + (w * tx) * 2.0
    # f_theta, then M_b = f_theta + (E t)'g + M
    turning = (sx * ay - sy * ax) + alpha * inertia + lever + (w * spin_rate) * 2.0
    x, y = load_pair(lane, S, now + NOW.tip)
    turning = turning + (x * gy - y * gx) + moment
    _strains(lane, model, D, tau, q, v, strains)
    # r_q = f_q + elastic force + (dt/dq)'g + phi_t M - rho M_b
    for i in range(n):
        # rows of Gamma = d s_bar/dq and of dt/dq
        gsx, gsy, px = D[own.S_bar_x + i], D[own.S_bar_y + i], D[own.tip_u + i]
        if model.modal is not None:
            gsx = gsx - dot(lane, model, D, own.D0 + i * n, q)
            px = px - dot(lane, model, D, own.tip_H + i * n, q)
        bv = along(lane, model, D, own.B + i * n, v)
        vectors[vec.bv + i] = bv
        vectors[vec.gsx + i] = gsx
        vectors[vec.px + i] = px
        gq, cb = vectors[vec.gq + i], vectors[vec.cb + i]
        # (K_EI (q - q0) + tau_d K_EI v) times the factor on EI; the linear stretch unless von Karman replaces it
        elastic = dot(lane, model, D, own.K_EI + i * n, q)
        if model.curved is not None:
            elastic = elastic - D[own.moment + i]
        if model.damped is not None:
            elastic = elastic + dot(lane, model, D, own.K_EI + i * n, v) * tau
        elastic = elastic * stiffness
        if model.full is None:
            elastic = elastic + along(lane, model, D, own.K_EA + i * n, q)
            if model.damped is not None:
                elastic = elastic + along(lane, model, D, own.K_EA + i * n, v) * tau
        # f_q = Gamma'(R'' - g) + alpha (c + B q) + M_ff a - w^2 (c_u + G q) + 2 w B v
        total = (gsx * ax + ay * gsy) + alpha * cb + dot(lane, model, D, own.M_ff + i * n, a)
        total = total - square * gq
        if model.modal is None:
            total = total + (w * bv) * 2.0
        total = total + elastic
        total = total + (px * gx + gy * D[own.tip_v + i]) + moment * D[own.tip_phi + i]
        if model.chord is not None:
            total = total - turning * D[own.root + i]
        r[i] = total
    # axial forces N of the elements times d(stretch)/dq, the gradient of (1.2)
    wide = len(model.window)
    kept = strain_at(0, wide)
    for e in range(len(model.elements)):
        first = window(model, n, e)
        for i in range(wide):
            pull = strains[kept.force] * strains[kept.slope + i]
            r[first + i] += pull
        kept = strain_at(kept.end, wide)
    if model.drag is not None:
        _mass_damping(lane, model, D, carried, v, vectors, r)
    # G_b = f_R + G, back in inertial axes
    force[0] = cos * (ax * mass + dx + gx) - sin * (ay * mass + dy + gy)
    force[1] = sin * (ax * mass + dx + gx) + cos * (ay * mass + dy + gy)
    force[2] = turning
    store_pair(lane, known, KNOWN.d, (dx, dy))
    store_pair(lane, known, KNOWN.s, (sx, sy))
    store_pair(lane, known, KNOWN.t, (tx, ty))
    store_pair(lane, known, KNOWN.inertia, (inertia, spin_rate))
    store_pair(lane, known, KNOWN.g, (gx, gy))


@kernel
def _mass_damping(lane, model, D, carried: Lanes, v: Lanes, vectors: Lanes, r: Lanes):
    """Add mass-proportional damping to the body's rows of r: r += drag (M_ff + m J'J + J_p phi phi') v.

    drag: coefficient of mass-proportional damping, 1/s.
    M_ff: the body's mass matrix.
    v: elastic rates, relative to the frame. m, J_p = `carried`: mass (kg) and inertia (kg m^2) at the tip. J = dt/dq
    and phi: derivatives of the tip's position and of its angle by q, frame axes. `vectors` contains the x row of J.
    """
    own, n, px = constants(model), size(model.n), vectors_at(0, size(model.n)).px
    mass, inertia = carried[0] * D[own.drag], carried[1] * D[own.drag]
    _, ty, turning = tip(lane, model, D, v)
    # velocity of the tip in the frame, m/s: J v
    tx = 0.0
    for i in range(n):
        tx = tx + vectors[px + i] * v[i]
    for i in range(n):
        total = dot(lane, model, D, own.M_ff + i * n, v) * D[own.drag]
        total = total + (vectors[px + i] * tx + ty * D[own.tip_v + i]) * mass
        total = total + (turning * D[own.tip_phi + i]) * inertia
        r[i] += total
