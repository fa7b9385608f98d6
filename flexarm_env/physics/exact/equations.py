"""Chains of geometrically exact beams: residual, tangent and its factors (model: `physics.model.ExactBeam`).

Rows (`layout.CHAIN`): x, y (m, inertial axes) and psi (rad) of each vertex, interior amplitudes, hinge angles delta.
Each element passes the state and force of its right vertex to the next element, so each row is written once. A link
hinged to a tip shares the position of the tip's vertex. The root section of a hinged link has the angle psi + delta. A
moment on it therefore acts on psi and delta. An element's interior coordinates are condensed once its tangent is known.
Vertices are eliminated from tip to root without pivoting, because the matrix is symmetric and cm M outweighs its
indefinite part. The angle of a free hinge, which transmits no moment, is eliminated too. Layout of S: `FACTORS`."""

from ...compiler import Lanes, kernel, load_lane, sincos
from ..arithmetic import load_vector, store_vector
from ..layout import OF_LOAD
from ..model import PAYLOAD_INERTIA, PAYLOAD_MASS, ExactBeam
from ..protocol import State, register
from .element import backward, element_result, forces, forward, section_directions, tangent
from .inertia import inertia_forces
from .layout import (
    AXES,
    LL,
    LR_T,
    LR_X,
    LR_Y,
    OF_HINGE,
    ROWS_OF_LOAD,
    RR,
    TT,
    XT,
    XX,
    XY,
    YT,
    YY,
    T,
    Vertex,
    X,
    Y,
    elbow_of,
    element_factors_at,
    factors_of,
    lever_at,
    next_section,
    root_angle,
    rows_of,
    section_of,
)
from .output import centerline, correct_positions, damping_power, energy, input_displacements, link_poses
from .rigid import (
    ROOT_END,
    TIP_END,
    about_root,
    about_tip,
    beam_start,
    beam_start_rows,
    condense_payload,
    condense_to_near_point,
    far_point_increment,
    last_vertex_force,
)


@kernel
def _subtract_loads(lane, model, u: Lanes, q: Lanes, r: Lanes):
    """Subtract the point loads u (force N in inertial axes, torque N m) from the rows of r on which they act.

    A load at the end of a lever (length l along psi) also exerts the moment l (cos psi F_y - sin psi F_x) on psi."""
    loads = model.loads
    for f in range(loads.shape[0] // ROWS_OF_LOAD.end):
        # B u: force on x and y (inertial axes); torque on psi, or on psi + delta behind a hinge
        at, k = ROWS_OF_LOAD.end * f, model.links + OF_LOAD.end * f
        r[loads[at + ROWS_OF_LOAD.x]] -= u[k + OF_LOAD.x]
        r[loads[at + ROWS_OF_LOAD.y]] -= u[k + OF_LOAD.y]
        r[loads[at + ROWS_OF_LOAD.psi]] -= u[k + OF_LOAD.torque]
        if loads[at + ROWS_OF_LOAD.hinge] >= 0:
            r[loads[at + ROWS_OF_LOAD.hinge]] -= u[k + OF_LOAD.torque]
    if model.rigid is not None:
        for f in range(loads.shape[0] // ROWS_OF_LOAD.end):
            row, k = loads[ROWS_OF_LOAD.end * f + ROWS_OF_LOAD.psi], model.links + OF_LOAD.end * f
            sine, cosine = sincos(q[row])
            moment = cosine * u[k + OF_LOAD.y] - sine * u[k + OF_LOAD.x]
            r[row] -= moment * model.rigid[lever_at(model.links, 0) + f]


@kernel
def _add_vertex_mass(lane, model, S: Lanes, o, mass):
    """Add a mass (kg, weighted) to the x and y diagonal of the 3x3 block at S[o]. With rigid ends, do nothing."""
    if model.rigid is None:
        S[o + XX] += mass
        S[o + YY] += mass


@kernel
def _add_lumped_inertia(lane, model, par: Lanes, weights, S: Lanes):
    """With weights.with_matrix: add the inertia of hub, elbows, payload to S; clear its fields `pinned` and `own`."""
    if weights.with_matrix:
        cm = weights.mass
        factors, own = factors_of(model), element_factors_at(0, len(model.order))
        for k in range(AXES):
            S[factors.pinned + k] = 0.0
        S[factors.elements + own.condensed + LL + TT] += cm * model.hub_inertia
        for k in range(1, model.links):
            S[factors.hinges + OF_HINGE.end * (k - 1) + OF_HINGE.pinned] = 0.0
            if model.jointed is not None:
                S[factors.hinges + OF_HINGE.end * (k - 1) + OF_HINGE.own] = 0.0
            # elbow: m and the left J on the vertex before it; the right J on psi + delta behind it
            elbow = elbow_of(model, k)
            after = factors.elements + own.end * model.elements * k + own.condensed
            before = after - own.end
            _add_vertex_mass(lane, model, S, before + RR, cm * elbow.mass)
            S[before + RR + TT] += cm * elbow.left
            S[after + LL + TT] += cm * elbow.right
        last = factors.end - own.end + own.condensed
        _add_vertex_mass(lane, model, S, last + RR, cm * par[PAYLOAD_MASS])
        S[last + RR + TT] += cm * par[PAYLOAD_INERTIA]


@kernel
def _directions(lane, model, q: Lanes, S: Lanes):
    """Store (sin psi, cos psi) of each Gauss point in the `circle` fields of S; psi: section angle from inertial x."""
    # one pass ahead of the elements: each sine is a long chain of operations, but none waits for another
    own = element_factors_at(0, len(model.order))
    i, o = rows_of(model).elements, factors_of(model).elements + own.circle
    for k in range(model.links):
        psi = root_angle(lane, model, q, k)
        for _ in range(model.elements):
            section_directions(lane, model.order, q[i:], psi, S[o:])
            i += AXES * len(model.order)
            o += own.end
            psi = q[i + T]


@kernel
def _vertex_behind_hinge(lane, model, state: State, k, left):
    """Return the `Vertex` at the root of link k > 0 from `left`, the tip vertex before its hinge, without rigid ends.

    The root section has the angle psi + delta (rad), where delta is the hinge angle. Forces (N, inertial axes) include
    the elbow's inertia forces. The moment (N m) only includes the elbow part behind the hinge, because a hinge
    transmits none. state: coordinates q, velocities v, accelerations a."""
    (x, y, psi), (vx, vy, spin), (ax, ay, alpha), (fx, fy, _) = left.place, left.rate, left.acceleration, left.force
    elbow, d = elbow_of(model, k), rows_of(model).hinges + k - 1
    alpha = alpha + state.a[d]
    if model.damped is not None:
        spin = spin + state.v[d]
    return Vertex(
        (x, y, psi + state.q[d]),
        (vx, vy, spin),
        (ax, ay, alpha),
        (fx + ax * elbow.mass, fy + ay * elbow.mass, alpha * elbow.right),
    )


@kernel
def assemble(lane, model, par: Lanes, state: State, u: Lanes, weights, r: Lanes, S: Lanes):
    """Write the residual r = M a + f(q, v) - B u [64]; with weights.with_matrix also S, condensed to vertices.

    Rows of r are forces (N, inertial axes) on x and y, and moments (N m) on psi and delta. S = weights.mass M +
    weights.damping C + weights.stiffness K, in the fields `interior` and `condensed` of FACTORS. state: coordinates q,
    velocities v, accelerations a. u: joint torques, then point loads."""
    q, v, a = state
    p, rows, own = len(model.order), rows_of(model), element_factors_at(0, len(model.order))
    zero = 0.0
    # a - g at the root (equivalence principle); moment J_h psi'' - tau_0 of hub inertia and hub torque
    torque = a[T] * model.hub_inertia - u[0]
    ax, ay, alpha = load_vector(lane, a, 0)
    rate = zero, zero, zero
    if model.gravity is not None:
        ax, ay = ax - model.gravity[0], ay - model.gravity[1]
    if model.damped is not None:
        rate = load_vector(lane, v, 0)
    left = Vertex(load_vector(lane, q, 0), rate, (ax, ay, alpha), (zero, zero, torque))
    i, o = rows.elements, factors_of(model).elements
    _directions(lane, model, q, S)
    for k in range(model.links):
        # first vertex of link k's beam: behind the rigid end's lever, or behind the hinge at psi + delta
        first, before = i, left
        if model.rigid is not None:
            left = beam_start(lane, model, state, k, left, i)
        elif k > 0:
            left = _vertex_behind_hinge(lane, model, state, k, left)
        section = section_of(lane, model, par, k)
        for _ in range(model.elements):
            # r of left vertex and interior; the force on the right vertex (inertial axes) goes on to the next element
            j = i
            here = State(q[j:], v[j:], a[j:])
            circle = S[o + own.circle :]
            left, points = element_result(forces(lane, model.order, model.gravity, here, left, section, r[j:], circle))
            if weights.with_matrix:
                tangent(lane, model.order, points, section, weights, S[o:])
            i += AXES * p
            o += own.end
            section = next_section(model, section)
        if model.rigid is not None:
            beam_start_rows(lane, model, state, u, k, before, first, r, weights, S)
        elif k > 0:
            # psi behind the hinge is psi + delta: by virtual work its moment acts on the rows of psi and of delta
            moment = r[first + T]
            r[first + T] = (before.force[T] + before.acceleration[T] * elbow_of(model, k).left) + moment
            r[rows.hinges + k - 1] = moment - u[k]
    # m_p (a - g) and J_p psi'' on the last vertex
    if model.rigid is not None:
        fx, fy, moment = last_vertex_force(lane, model, par, state, left, i, weights, S)
    else:
        (fx, fy, moment), (ax, ay, _) = left.force, left.acceleration
        mass = par[PAYLOAD_MASS]
        fx, fy = fx + ax * mass, fy + ay * mass
    store_vector(lane, r, i, (fx, fy, moment + left.acceleration[T] * par[PAYLOAD_INERTIA]))
    if model.loads is not None:
        _subtract_loads(lane, model, u, q, r)
    _add_lumped_inertia(lane, model, par, weights, S)


@kernel
def _six(lane, S, o):
    """Load the symmetric 3x3 matrix of (x, y, psi) at S[o] as xx, xy, xt, yy, yt, tt, where t stands for psi."""
    xx, xy, xt = load_vector(lane, S, o + XX)
    yy, yt, tt = load_vector(lane, S, o + YY)
    return xx, xy, xt, yy, yt, tt


@kernel
def _factor_three(lane, S, o, xx, xy, xt, yy, yt, tt):
    """Factor a symmetric 3x3 matrix of (x, y, psi) as L D L^T. Write 1/D and L to S[o] (`SYMMETRIC`), return both."""
    i0 = 1.0 / xx
    l1, l2 = xy * i0, xt * i0
    i1 = 1.0 / (yy - xy * l1)
    m2 = yt - xy * l2
    l3 = m2 * i1
    i2 = 1.0 / ((tt - xt * l2) - m2 * l3)
    store_vector(lane, S, o + XX, (i0, l1, l2))
    store_vector(lane, S, o + YY, (i1, l3, i2))
    return i0, l1, l2, i1, l3, i2


@kernel
def _eliminate(lane, S, o, tail):
    """Eliminate an element's right vertex. Return the Schur complement LL - LR (RR + tail)^-1 LR^T on the left vertex.

    S[o]: the element's `CONDENSED` record with blocks LL, LR, RR of left and right vertex. RR becomes the factors L D
    L^T of RR + tail. LR becomes LR L^-T D^-1. tail: symmetric 3x3 matrix (xx, xy, xt, yy, yt, tt; t for psi) of all
    elements beyond the right vertex. The result is a matrix in the form of tail."""
    xx, xy, xt, yy, yt, tt = _six(lane, S, o + RR)
    i0, l1, l2, i1, l3, i2 = _factor_three(
        lane, S, o + RR, xx + tail[0], xy + tail[1], xt + tail[2], yy + tail[3], yt + tail[4], tt + tail[5]
    )
    # LR L^-T, then times D^-1
    x0, x1, x2 = load_vector(lane, S, o + LR_X)
    y0, y1, y2 = load_vector(lane, S, o + LR_Y)
    t0, t1, t2 = load_vector(lane, S, o + LR_T)
    x1, y1, t1 = x1 - l1 * x0, y1 - l1 * y0, t1 - l1 * t0
    x2, y2, t2 = (x2 - l2 * x0) - l3 * x1, (y2 - l2 * y0) - l3 * y1, (t2 - l2 * t0) - l3 * t1
    p0, p1, p2 = x0 * i0, x1 * i1, x2 * i2
    q0, q1, q2 = y0 * i0, y1 * i1, y2 * i2
    r0, r1, r2 = t0 * i0, t1 * i1, t2 * i2
    store_vector(lane, S, o + LR_X, (p0, p1, p2))
    store_vector(lane, S, o + LR_Y, (q0, q1, q2))
    store_vector(lane, S, o + LR_T, (r0, r1, r2))
    xx, xy, xt, yy, yt, tt = _six(lane, S, o + LL)
    return (
        ((xx - p0 * x0) - p1 * x1) - p2 * x2,
        ((xy - p0 * y0) - p1 * y1) - p2 * y2,
        ((xt - p0 * t0) - p1 * t1) - p2 * t2,
        ((yy - q0 * y0) - q1 * y1) - q2 * y2,
        ((yt - q0 * t0) - q1 * t1) - q2 * t2,
        ((tt - r0 * t0) - r1 * t1) - r2 * t2,
    )


@kernel
def add_stiffness(lane, model, S: Lanes, k, x):
    """Add x (N m/rad) to the stiffness of the joint angle (hub or elbow) in row k. If x is None, fix row k.

    The hub's stiffness is added to S here, an elbow's stiffness in `factor`. `factor` and `solve` ignore fixed rows."""
    factors, hinge = factors_of(model), factors_of(model).hinges + OF_HINGE.end * (k - rows_of(model).hinges)
    if x is None:
        S[factors.pinned + k if k < AXES else hinge + OF_HINGE.pinned] = 1.0
    elif k < AXES:
        S[factors.elements + element_factors_at(0, len(model.order)).condensed + LL + TT] += x
    else:
        S[hinge + OF_HINGE.own] += x


@kernel
def _eliminate_hinge_angle(lane, model, S: Lanes, h, tail):
    """Eliminate the section angle behind a free hinge; return the 3x3 matrix on (x, y, psi) before the hinge.

    tail: symmetric matrix on (x, y, psi + delta) of all elements beyond the hinge. The `HINGE` at S[h] receives the
    inverse pivot and the couplings divided by the pivot. In a jointed arm, its joint stiffness on delta is added."""
    xx, xy, xt, yy, yt, tt = tail
    zero = 0.0
    # ideal hinge: psi + delta is coupled with x and y alone, so no moment reaches psi
    if model.jointed is None:
        inverse = 1.0 / tt
        zx, zy = xt * inverse, yt * inverse
        S[h + OF_HINGE.x] = zx
        S[h + OF_HINGE.y] = zy
        S[h + OF_HINGE.inverse] = inverse
        return xx - zx * xt, xy - zx * yt, zero, yy - zy * yt, zero, zero
    # joint stiffness k: adds k to the pivot and to psi's diagonal, -k to their coupling
    own = S[h + OF_HINGE.own]
    inverse = 1.0 / (tt + own)
    zx, zy, zt = xt * inverse, yt * inverse, own * inverse
    S[h + OF_HINGE.x] = zx
    S[h + OF_HINGE.y] = zy
    S[h + OF_HINGE.inverse] = inverse
    S[h + OF_HINGE.own] = zt
    return xx - zx * xt, xy - zx * yt, xt * zt, yy - zy * yt, yt * zt, tt * zt


@kernel
def factor(lane, model, S):
    """Factor the Newton matrix S of `assemble` as L D L^T in place, from tip to root; fixed rows are left out."""
    factors, own = factors_of(model), element_factors_at(0, len(model.order))
    zero, one = 0.0, 1.0
    # from tip to root: payload, tip lever; then each link's elements, root lever, hinge, tip lever of the link before
    tail = condense_payload(lane, model, S, (zero, zero, zero, zero, zero, zero))
    tail = condense_to_near_point(lane, model, S, model.links - 1, TIP_END, tail)
    o = factors.end
    for k in range(model.links - 1, -1, -1):
        for _ in range(model.elements):
            o -= own.end
            tail = _eliminate(lane, S, o + own.condensed, tail)
        tail = condense_to_near_point(lane, model, S, k, ROOT_END, tail)
        if k > 0:
            h = factors.hinges + OF_HINGE.end * (k - 1)
            if S[(h + OF_HINGE.pinned) * len(lane)] == 0.0:
                tail = _eliminate_hinge_angle(lane, model, S, h, tail)
            tail = condense_to_near_point(lane, model, S, k - 1, TIP_END, tail)
    # fixed rows of the root become those of the identity, so that their increments stay 0
    xx, xy, xt, yy, yt, tt = tail
    pinned = factors.pinned
    if S[(pinned + X) * len(lane)] != 0.0:
        xx, xy, xt = one, zero, zero
    if S[(pinned + Y) * len(lane)] != 0.0:
        yy, xy, yt = one, zero, zero
    if S[(pinned + T) * len(lane)] != 0.0:
        tt, xt, yt = one, zero, zero
    _factor_three(lane, S, factors.root, xx, xy, xt, yy, yt, tt)


@kernel
def _forward_three(lane, S: Lanes, o, x, y, t):
    """Return L^-1 (x, y, t), the forward substitution at a vertex; its 3x3 factors L D L^T are at S[o]."""
    y = y - S[o + XY] * x
    return x, y, (t - S[o + XT] * x) - S[o + YT] * y


@kernel
def _backward_three(lane, S: Lanes, o, x, y, t):
    """Return L^-T (x, y, t), the backward substitution at a vertex; its 3x3 factors L D L^T are at S[o]."""
    y = y - S[o + YT] * t
    return (x - S[o + XY] * y) - S[o + XT] * t, y, t


@kernel
def _reduce(lane, S, o, x, y, t):
    """Return six numbers: L^-1 b at an element's right vertex, and LR RR^-1 b; b = (x, y, t) with t for psi.

    LR RR^-1 b is to be subtracted from the left vertex's right side. S[o]: the factored `CONDENSED` of the element."""
    x, y, t = _forward_three(lane, S, o + RR, x, y, t)
    x0, x1, x2 = load_vector(lane, S, o + LR_X)
    y0, y1, y2 = load_vector(lane, S, o + LR_Y)
    t0, t1, t2 = load_vector(lane, S, o + LR_T)
    return x, y, t, (x0 * x + x1 * y) + x2 * t, (y0 * x + y1 * y) + y2 * t, (t0 * x + t1 * y) + t2 * t


@kernel
def _restore(lane, S: Lanes, o, right, left):
    """Return the solution (x, y, psi) at an element's right vertex, given the solution `left` at its left vertex.

    right: L^-1 b of the right vertex, from `_reduce`. S[o]: the factored `CONDENSED`: RR = L D L^T, LR L^-T D^-1."""
    (x, y, t), (a, b, c) = right, left
    x0, x1, x2 = load_vector(lane, S, o + LR_X)
    y0, y1, y2 = load_vector(lane, S, o + LR_Y)
    t0, t1, t2 = load_vector(lane, S, o + LR_T)
    t = ((t * S[o + RR + TT] - x2 * a) - y2 * b) - t2 * c
    y = ((y * S[o + RR + YY] - x1 * a) - y1 * b) - t1 * c
    x = ((x * S[o + RR + XX] - x0 * a) - y0 * b) - t0 * c
    return _backward_three(lane, S, o + RR, x, y, t)


@kernel
def solve(lane, model, S: Lanes, x: Lanes):
    """Solve S y = x in place with the factors from `factor`: forward from tip to root, then back from root to tip."""
    rows, factors, own = rows_of(model), factors_of(model), element_factors_at(0, len(model.order))
    span = AXES * len(model.order)
    i, o, taken = rows.tip, factors.end, 0.0
    tx, ty, tt = load_vector(lane, x, i)
    for k in range(model.links - 1, -1, -1):
        for _ in range(model.elements):
            # interior, then right vertex; (tx, ty, tt) goes on as the left vertex's right side
            i -= span
            o -= own.end
            lx, ly, lt, rx, ry, rt = forward(lane, model.order, S[o:], x[i:])
            tx, ty, tt, ux, uy, ut = _reduce(lane, S, o + own.condensed, tx - rx, ty - ry, tt - rt)
            store_vector(lane, x, i + span, (tx, ty, tt))
            taken = lt + ut
            tx, ty, tt = load_vector(lane, x, i)
            tx, ty, tt = (tx - lx) - ux, (ty - ly) - uy, tt - taken
        taken, tt = about_root(lane, model, S, k, x, i, tx, ty, taken, tt)
        if k > 0:
            h, d = factors.hinges + OF_HINGE.end * (k - 1), rows.hinges + k - 1
            if load_lane(lane, S, h + OF_HINGE.pinned, 0) == 0.0:
                # b of psi + delta: that of delta, the moment behind the hinge; the rest belongs to psi before it
                own_side = x[d]
                both = own_side - taken
                tt = x[i + T] - own_side
                if model.jointed is not None:  # with its part of the moment behind
                    tt = tt + S[h + OF_HINGE.own] * both
                tx, ty = tx - S[h + OF_HINGE.x] * both, ty - S[h + OF_HINGE.y] * both
                x[d] = both
            tt = about_tip(lane, model, S, k - 1, x, i, tx, ty, tt)
    # (x, y, psi) of the root: L D L^T of its 3 x 3 matrix
    pinned, root = factors.pinned, factors.root
    if load_lane(lane, S, pinned + X, 0) != 0.0:
        tx = x[X]
    if load_lane(lane, S, pinned + Y, 0) != 0.0:
        ty = x[Y]
    if load_lane(lane, S, pinned + T, 0) != 0.0:
        tt = x[T]
    tx, ty, tt = _forward_three(lane, S, root, tx, ty, tt)
    tx, ty, tt = tx * S[root + XX], ty * S[root + YY], tt * S[root + TT]
    tx, ty, tt = _backward_three(lane, S, root, tx, ty, tt)
    store_vector(lane, x, 0, (tx, ty, tt))
    for k in range(model.links):
        if k > 0:
            h, d = factors.hinges + OF_HINGE.end * (k - 1), rows.hinges + k - 1
            tx, ty = far_point_increment(lane, model, S, k - 1, TIP_END, tx, ty, tt)
            # angle behind the hinge, psi + delta; x[d] is the difference
            psi = tt
            if load_lane(lane, S, h + OF_HINGE.pinned, 0) == 0.0:
                psi = x[d] * S[h + OF_HINGE.inverse] - S[h + OF_HINGE.x] * tx
                psi = psi - S[h + OF_HINGE.y] * ty
                if model.jointed is not None:  # with the part that psi before it carries along
                    psi = psi + S[h + OF_HINGE.own] * tt
            x[d] = psi - tt
            tt = psi
        # from the beam's start: x_right from x_left by the condensed factors, then the interior by L^-T
        tx, ty = far_point_increment(lane, model, S, k, ROOT_END, tx, ty, tt)
        for _ in range(model.elements):
            left = tx, ty, tt
            tx, ty, tt = _restore(lane, S, o + own.condensed, load_vector(lane, x, i + span), left)
            store_vector(lane, x, i + span, (tx, ty, tt))
            backward(lane, model.order, S[o:], x[i:], left, (tx, ty, tt))
            i += span
            o += own.end


register(
    ExactBeam, correct_positions, assemble, inertia_forces, add_stiffness, factor, solve, input_displacements,
    damping_power, energy, link_poses, centerline, solve_transposed=solve,
)  # fmt: skip
