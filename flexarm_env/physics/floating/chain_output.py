"""Outputs of floating frames, with or without multipliers: input displacements, energies, poses, range, centerline.

The Model is `physics.model.FloatingChain`, whose table is None, or `FloatingFrame`, in which each body has rows for its
frame. `D` is one body's block of constants (`constants.BODY`). The argument for the `Mesh` of all bodies is called
`mesh`, in kernels of a single body `model`."""

from ...compiler import Lanes, absolute, kernel, select_lt, sincos, size, stack, unrolled
from ..arithmetic import (
    gravity_along,
    load_pair,
    load_vector,
    rotate_2d,
    rotate_back_2d,
    store_pair,
    store_vector,
)
from ..layout import POSE
from ..model import DIVERGED, OUT_OF_RANGE, PAYLOAD_INERTIA, PAYLOAD_MASS, STIFFNESS_FACTOR
from .body import along, constants, damping_time, dot, in_window, product, tip, turn_of_root
from .constants import span_at, station_at
from .layout import ELASTIC, FRAME, START, elastic_row, elbow_row, window
from .rigid import ROOT_END, TIP_END, add_rigid_end, end_of, far_point_pose, to_payload

SIX = (0,) * 6


@kernel
def enter(lane, model, q: Lanes, v: Lanes, k, b, pose: Lanes):
    """Write the pose (6,) of the root section of body b of link k: position, angle and their rates, inertial axes.

    On entry, pose is that of the tip section before body b. The pose of the first body, or of a body with its own frame
    (multipliers), is read from q, v. For the first body of a later link, the elbow's angle and rate are added. In all
    other cases the pose does not change."""
    at = 0
    if model.table is not None:
        at = model.table[b, START]
    if model.table is not None or b == 0:
        store_vector(lane, pose, POSE.x, load_vector(lane, q, at))
        store_vector(lane, pose, POSE.vx, load_vector(lane, v, at))
    elif b == k * model.segments:
        i = elbow_row(model, k)
        pose[POSE.angle] += q[i]
        pose[POSE.rate] += v[i]


@kernel
def elastic_of(model, b):
    """Return the row of body b's first elastic coordinate, in a chain or with multipliers (model.table is not None)."""
    if model.table is None:
        return elastic_row(model, b)
    return model.table[b, START] + ELASTIC


@unrolled
@kernel
def place(lane, model, D, q, v, pose: Lanes, frame: Lanes):
    """Move a pose from a body's root section to its tip section: position, angle (m, rad) and their rates.

        r_tip = R + A t(q),   r'_tip = R' + A (t' + w E t),   angle = theta + phi_t'q                 (theory, eq. 3.1)

    R: position of the frame's origin. A: rotation by the frame's angle theta. w: angular velocity theta' of the frame.
    t: position of the tip in frame axes. E: matrix of a rotation by 90 deg.

    # state    q, v: the body's elastic coordinates and rates
    # in, out  pose (6,): x, y, angle and their rates, inertial axes
    # out      frame, `FRAME`: cos theta, sin theta, velocity of the origin in frame axes, w
    """
    own = constants(model)
    # angle and rate of the frame: the root section's, less rho'q (frame through both ends)
    angle, w = pose[POSE.angle], pose[POSE.rate]
    if model.chord is not None:
        angle, w = angle - turn_of_root(lane, model, D, q), w - turn_of_root(lane, model, D, v)
    s, c = sincos(angle)
    X, Y = load_pair(lane, pose, POSE.x)
    vx, vy = load_pair(lane, pose, POSE.vx)
    # t(q) and t' in frame axes; modes shorten x by q'H q / 2
    x, y, phi = tip(lane, model, D, q)
    tx, ty, rate = tip(lane, model, D, v)
    x = x + D[own.length]
    if model.modal is not None:
        x = x - product(lane, model, D, own.tip_H, q, q) * 0.5
        tx = tx - product(lane, model, D, own.tip_H, q, v)
    store_pair(lane, frame, FRAME.cos, (c, s))
    store_pair(lane, frame, FRAME.vx, rotate_back_2d(c, s, vx, vy))
    frame[FRAME.rate] = w
    # velocity and position of the tip relative to the origin, inertial axes
    tx, ty = rotate_2d(c, s, tx - w * y, ty + w * x)
    x, y = rotate_2d(c, s, x, y)
    store_vector(lane, pose, POSE.x, (X + x, Y + y, angle + phi))
    store_vector(lane, pose, POSE.vx, (vx + tx, vy + ty, w + rate))


@kernel
def visit(lane, model, q: Lanes, v: Lanes, tell, out):
    """Call tell(lane, model, k, end, pose, out) at the root and at the tip of each link k, along the chain.

    pose (6,), `POSE`: x, y, angle and rates of the section at the joint, beyond rigid ends; inertial axes.
    end: ROOT_END or TIP_END.
    q: coordinates of the arm.
    v: rates of the coordinates.
    out: array that is passed to `tell`."""
    pose, frame = stack(lane, SIX), stack(lane, SIX)
    for k in range(model.links):
        for b in range(k * model.segments, (k + 1) * model.segments):
            enter(lane, model, q, v, k, b, pose)
            if b == k * model.segments:
                tell(lane, model, k, ROOT_END, pose, out)
                far_point_pose(lane, end_of(model, k, ROOT_END), pose)
            e = elastic_of(model, b)
            place(lane, model.mesh, model.data[model.block * b :], q[e:], v[e:], pose, frame)
        far_point_pose(lane, end_of(model, k, TIP_END), pose)
        tell(lane, model, k, TIP_END, pose, out)


@kernel
def _to_pose(lane, model, link, end, pose: Lanes, out: Lanes):
    """Copy a pose (6,) into the `POSE` of a link in out: at its root (end 0) or tip (end 1). Argument of `visit`."""
    for i in range(6):
        out[POSE.end * link + POSE.tip_x * end + i] = pose[i]


@kernel
def link_poses(lane, model, par, q, v, out, tasks=None):
    """Write x, y (m), angle (rad) and their rates of each link's root, then of its tip, in inertial axes.

    out: one `layout.POSES` record for each link. q, v: coordinates and rates of the arm."""
    visit(lane, model, q, v, _to_pose, out)


@unrolled
@kernel
def _damping(lane, model, D, par: Lanes, q, v: Lanes, x: Lanes, total):
    """Return total + x'C(q) v of one body as a tuple of one number; C: Kelvin-Voigt and mass-proportional damping.

    # model    D: constants of the body. par: the arm's parameters (factor on bending stiffness, tau_d)
    # state    q, v: elastic coordinates and rates. x: rates that are multiplied from the left

    See docs/theory.md, (1.3)."""
    own, n, wide = constants(model), size(model.n), len(model.window)
    if model.damped is not None:
        part = product(lane, model, D, own.K_EI, x, v) * par[STIFFNESS_FACTOR]
        # linear stretch: K_EA
        # von Karman (theory, eq. 1.3): EA/l times both stretch rates, (g + H q)'v and (g + H q)'x
        if model.full is None and model.modal is None:
            part = part + product(lane, model, D, own.K_EA, x, v)
        else:
            span = span_at(own.spans, wide)
            for e in range(len(model.elements)):
                first = window(model, n, e)
                rate, other = 0.0, 0.0
                for i in range(wide):
                    slope = in_window(lane, model, D, span.H + i * wide, q, first) + D[span.stretch + i]
                    rate = rate + slope * v[first + i]
                    other = other + slope * x[first + i]
                part = part + (rate * other) * D[span.stiffness]
                span = span_at(span.end, wide)
        total = total + part * damping_time(lane, model, D, par)
    # alpha x^T M_ff v: drag on rates relative to the frame
    if model.drag is not None:
        total = total + product(lane, model, D, own.M_ff, x, v) * D[own.drag]
    return (total,)


@unrolled
@kernel
def _payload_drag(lane, model, D, par: Lanes, q, v, x):
    """Return the part of x'C(q) v from mass-proportional damping of the payload, as a tuple of one (W for x = v).

        drag (m_p x_t.v_t + J_p (phi_t'x) (phi_t'v))

    v_t, x_t: velocities of the tip relative to the last body's frame, in its axes, for elastic rates v and x. For modes
    they include the rate of foreshortening, -q'H v.
    J_p, m_p: inertia and mass of the payload.
    phi_t: derivative of the tip section's angle by q.
    drag: coefficient of mass-proportional damping, 1/s."""
    own = constants(model)
    vx, vy, turning = tip(lane, model, D, v)
    xx, xy, turn = tip(lane, model, D, x)
    if model.modal is not None:
        vx = vx - product(lane, model, D, own.tip_H, q, v)
        xx = xx - product(lane, model, D, own.tip_H, q, x)
    part = (vx * xx + vy * xy) * par[PAYLOAD_MASS] + (turning * turn) * par[PAYLOAD_INERTIA]
    return (part * D[own.drag],)


@kernel
def damping_power(lane, model, par, q: Lanes, v: Lanes, x: Lanes):
    """Return x'C(q) v, the power (W) of the damping forces at virtual rates x; for x = v the dissipated power.

    The elastic coordinates and the payload are damped; rigid motion is not damped.
    q: coordinates of the arm.
    v: rates of the arm."""
    total, mesh, last = 0.0, model.mesh, model.links * model.segments - 1
    for b in range(last + 1):
        e = elastic_of(model, b)
        total = _damping(lane, mesh, model.data[model.block * b :], par, q[e:], v[e:], x[e:], total)[0]
    if mesh.drag is not None:
        e = elastic_of(model, last)
        total = total + _payload_drag(lane, mesh, model.data[model.block * last :], par, q[e:], v[e:], x[e:])[0]
    return total


@unrolled
@kernel
def _energies(lane, model, D, par: Lanes, q: Lanes, v, frame):
    """Return one body's kinetic and strain energy (J) and first moments x, y about its origin (kg m, inertial axes).

        T = m_t |R'|^2 / 2 + R'.(s_bar' + w E s_bar) + w^2 I / 2 + w (c + B q)'v + v'M_ff v / 2     (theory, eq. 2.3)

    R: origin of the frame.
    w: angular velocity of the frame. s_bar(q): first moment. I(q): inertia about the origin.
    E: matrix of a rotation by 90 deg.

    # state    q, v: elastic coordinates and rates. frame: `FRAME` of the body, velocity R' in frame axes
    """
    own, n, wide = constants(model), size(model.n), len(model.window)
    c, s = load_pair(lane, frame, FRAME.cos)
    vx, vy, w = load_vector(lane, frame, FRAME.vx)
    # s_bar(q) and s_bar' in frame axes
    sx, sy = along(lane, model, D, own.S_bar_x, q) + D[own.S0], dot(lane, model, D, own.S_bar_y, q)
    tx, ty = along(lane, model, D, own.S_bar_x, v), dot(lane, model, D, own.S_bar_y, v)
    if model.modal is not None:
        sx = sx - product(lane, model, D, own.D0, q, q) * 0.5
        tx = tx - product(lane, model, D, own.D0, q, v)
    # I(q) = I0 + 2 c_u'q + q'G q
    inertia = along(lane, model, D, own.c_u, q) * 2.0 + D[own.I0] + product(lane, model, D, own.G, q, q)
    # T (2.3): 1/2 m |v|^2 + v . (w E s + s'), 1/2 w^2 I + 1/2 q'^T M_ff q', w (c + B q) . q'
    kinetic = (vx * vx + vy * vy) * (0.5 * D[own.mass]) + vx * (tx - w * sy) + vy * (ty + w * sx)
    kinetic = kinetic + ((w * w) * inertia + product(lane, model, D, own.M_ff, v, v)) * 0.5
    spun = dot(lane, model, D, own.c, v)
    if model.modal is None:
        spun = spun + product(lane, model, D, own.B, v, q)
    kinetic = kinetic + w * spun
    # U = 1/2 q^T K_EI q times the EI factor, less q^T K_EI q_0 of a curved body
    strain = product(lane, model, D, own.K_EI, q, q) * (par[STIFFNESS_FACTOR] * 0.5)
    if model.curved is not None:
        strain = strain + (D[own.spent] - dot(lane, model, D, own.moment, q)) * par[STIFFNESS_FACTOR]
    if model.full is None and model.modal is None:
        strain = strain + product(lane, model, D, own.K_EA, q, q) * 0.5
    # elements: EA/(2 l) (g'q + q'H q / 2)^2 (theory, eq. 1.2)
    span = span_at(own.spans, wide)
    for e in range(len(model.elements)):
        first = window(model, n, e)
        linear, second = 0.0, 0.0
        for i in range(wide):
            slope = in_window(lane, model, D, span.H + i * wide, q, first)
            linear = linear + q[first + i] * D[span.stretch + i]
            second = second + q[first + i] * slope
        if model.full is not None:
            linear = linear + second * 0.5
            strain = strain + (linear * linear) * (0.5 * D[span.stiffness])
        else:  # q'K(q)q / 2 of [43]; the paper's force has no potential
            strain = strain + (linear * second) * (0.5 * D[span.stiffness])
        span = span_at(span.end, wide)
    mx, my = rotate_2d(c, s, sx, sy)
    return kinetic, strain, mx, my


@kernel
def energy(lane, model, par: Lanes, q: Lanes, v: Lanes):
    """Return the arm's (kinetic, strain, gravitational) energy, J. Gravitational energy is 0 at the inertial origin.

    q: coordinates of the arm.
    v: rates of the arm.
    par: payload mass and inertia, factor on bending stiffness. See docs/theory.md, (2.3)."""
    pose, frame, ends = stack(lane, SIX), stack(lane, SIX), stack(lane, (0, 0, 0))
    zero = 0.0
    # ends <- 0: T (J), m x, m y (kg m, inertial axes) of the rigid ends, and of the elbows' masses on them
    store_vector(lane, ends, 0, (zero, zero, zero))
    kinetic, strain, gravity = zero, zero, zero
    gx, gy = gravity_along(model.gravity, 0), gravity_along(model.gravity, 1)
    for k in range(model.links):
        for b in range(k * model.segments, (k + 1) * model.segments):
            enter(lane, model, q, v, k, b, pose)
            if b == k * model.segments:
                add_rigid_end(lane, end_of(model, k, ROOT_END), pose, ends)
            e, D = elastic_of(model, b), model.data[model.block * b :]
            (x, y), mass = load_pair(lane, pose, POSE.x), D[constants(model.mesh).mass]
            place(lane, model.mesh, D, q[e:], v[e:], pose, frame)
            moving, bent, mx, my = _energies(lane, model.mesh, D, par, q[e:], v[e:], frame)
            kinetic, strain = kinetic + moving, strain + bent
            # V = -g . (first moment about the inertial origin)
            gravity = gravity - (mx + x * mass) * gx - (my + y * mass) * gy
        add_rigid_end(lane, end_of(model, k, TIP_END), pose, ends)
    # T and V of m_p, J_p at the payload's center (inertial axes)
    far_point_pose(lane, to_payload(model), pose)
    x, y = load_pair(lane, pose, POSE.x)
    vx, vy, w = load_vector(lane, pose, POSE.vx)
    mass = par[PAYLOAD_MASS]
    kinetic = kinetic + ((vx * vx + vy * vy) * mass + (w * w) * par[PAYLOAD_INERTIA]) * 0.5
    gravity = gravity - mass * (x * gx + y * gy)
    if model.rigid is not None:
        more, mx, my = load_vector(lane, ends, 0)
        kinetic, gravity = kinetic + more, gravity - (mx * gx + my * gy)
    return kinetic, strain, gravity


@unrolled
@kernel
def _ranges(lane, model, D, payload, q):
    """Return two ratios of one body: tip deflection to length, and loss of root inertia to the largest allowed loss.

    The deflection is measured from the tangent at the root. The loss counts only foreshortening (theory, section 4).
    The loss is q'(D - M_uv)q = -q'G q (`BODY.G`), plus the payload's part m_p (L q'H q - y^2) with length L, H =
    `BODY.tip_H` and the tip's deflection y. The loss is 0 for finite elements.

    # in       payload: m_p, kg, mass at the body's tip; q: elastic coordinates
    """
    own = constants(model)
    y = dot(lane, model, D, own.tip_v, q)
    far, lost = y, 0.0
    # frame through both ends: distance from the tangent at the root, y - sin(rho'q) x, sine to third order
    if model.chord is not None:
        turn, x = dot(lane, model, D, own.root, q), tip(lane, model, D, q)[0] + D[own.length]
        if model.modal is not None:
            x = x - product(lane, model, D, own.tip_H, q, q) * 0.5
        far = y - (turn - turn * (turn * turn) * (1.0 / 6.0)) * x
    if model.modal is not None:
        # inertia about the root: payload's loss, then the body's (G = M_uv - D)
        lost = product(lane, model, D, own.tip_H, q, q) * D[own.length] - y * y
        lost = (lost * payload - product(lane, model, D, own.G, q, q)) * (1.0 / D[own.most_lost])
    return absolute(far) * (1.0 / D[own.length]), lost


@kernel
def out_of_range(lane, model, par: Lanes, q: Lanes):
    """Return a status code per lane: 0.0, DIVERGED or OUT_OF_RANGE.

    DIVERGED: a body's tip deflects by its length or more, or the deflection is NaN.
    OUT_OF_RANGE (only for modes): the deflection exceeds `model.bound`, or the inertia about the root is so small that
    the mass matrix is nearly indefinite. If several bodies are out of range, the body nearest to the root determines
    the code."""
    status, payload = 0.0, par[PAYLOAD_MASS]
    for b in range(model.links * model.segments - 1, -1, -1):
        own = q[elastic_of(model, b) :]
        deflection, lost = _ranges(lane, model.mesh, model.data[model.block * b :], payload, own)
        payload = 0.0
        if model.mesh.modal is not None:
            far = select_lt(model.bound, deflection, 2.0, lost)
            status = select_lt(1.0, far, float(OUT_OF_RANGE), status)
        status = select_lt(deflection, 1.0, status, float(DIVERGED))
    return status


@kernel
def _sum(lane, D, at, x: Lanes, n):
    """Return sum_j D[at + j] x_j, j < n. x (n,): lanes."""
    total = x[0] * D[at]
    for j in range(1, n):
        total = total + x[j] * D[at + j]
    return total


@kernel
def _draw(lane, mesh, D, q: Lanes, x0, y0, frame, line):
    """Write x, y (m, inertial axes) of one drawing station of a body to line (2,).

    # in       D: the station's `STATION`; q: elastic coordinates; x0, y0: origin (m); frame: `FRAME`

    See docs/theory.md, (4.1)."""
    n = size(mesh.n)
    at = station_at(0, n)
    # place in frame axes: shape functions, or modes with foreshortening q'H q / 2
    x, y = D[at.x], _sum(lane, D, at.v, q, n)
    if mesh.modal is None:
        x = x + _sum(lane, D, at.u, q, n)
    else:
        bent = _sum(lane, D, at.H, q, n) * q[0]
        for j in range(1, n):
            bent = bent + _sum(lane, D, at.H + j * n, q, n) * q[j]
        x = x - bent * 0.5
    # to inertial axes
    c, s = load_pair(lane, frame, FRAME.cos)
    store_pair(lane, line, 0, (x * c + x0 - y * s, x * s + y0 + y * c))


@kernel
def centerline(lane, model, q: Lanes, points):
    """Write points (m, inertial axes) along the arm to `points` (n, lanes of 2 numbers); return the number of points.

    The points are the root, then the drawing stations of all bodies from root to tip, until `points` is full. The last
    point of a link with rigid ends is its joint at the tip."""
    mesh, n = model.mesh, size(model.mesh.n)
    pose, frame = stack(lane, SIX), stack(lane, SIX)
    store_pair(lane, points[0], 0, load_pair(lane, q, 0))
    count, stations = 1, constants(mesh).stations
    length = station_at(0, n).end
    for k in range(model.links):
        for b in range(k * model.segments, (k + 1) * model.segments):
            enter(lane, model, q, q, k, b, pose)
            if b == k * model.segments:
                far_point_pose(lane, end_of(model, k, ROOT_END), pose)
            D, e = model.data[model.block * b :], q[elastic_of(model, b) :]
            x0, y0 = load_pair(lane, pose, POSE.x)
            place(lane, mesh, D, e, e, pose, frame)
            for i in range((model.block - stations) // length):
                if count == points.shape[0]:
                    return count
                _draw(lane, mesh, D[stations + i * length :], e, x0, y0, frame, points[count])
                count += 1
        far_point_pose(lane, end_of(model, k, TIP_END), pose)
        if model.rigid is not None:  # a link's last point is where its rigid end ends
            store_pair(lane, points[count - 1], 0, load_pair(lane, pose, POSE.x))
    return count
