"""Rigid ends of links: levers between a chain's rows and its beams (docs: theory, "Links that vary, and rigid ends").

The rows of a vertex describe a beam's tip, or the joint at the chain's root. If links have rigid ends, three parts lie
between a tip and the next beam: the rigid end of the tip (length b along psi), the hinge, and the rigid root of the
next beam (length c along psi + delta). Each rigid end is a lever. The near point of a lever is its end closer to the
arm's root, the far point the other end. A force at the far point acts on the near point with an additional moment. The
mass of a lever is at the lever's middle. The matrix neglects the lever's rotation during its acceleration (terms in h
omega, times the lever's part of the inertia). A payload with an eccentric center of mass is at the far point of an
additional lever at the tip.

Vectors are in inertial axes (m, m/s, m/s^2, N); moments (N m) and angles (rad) are counter-clockwise. `end`: ROOT_END
(from joint to beam start) or TIP_END (from beam end to next joint). If `model.rigid` is None, there are no levers.
"""

from ...compiler import Lanes, kernel, sincos
from ..arithmetic import load_pair, load_vector, rotate_2d, store_pair, store_vector
from ..layout import LEVER
from ..model import PAYLOAD_MASS
from ..protocol import State
from .layout import LEVER_FACTORS, T, Vertex, X, Y, elbow_of, factors_of, lever_at, root_angle, rows_of, vertex_of

OF_LEVER, OF_FACTORS = LEVER.places, LEVER_FACTORS.places
ROOT_END, TIP_END = range(2)


@kernel
def lever_vector(lane, model, k, end, angle):
    """Return the lever vector (m, inertial axes) of a rigid end of link k, from near to far point; angle: beam's psi.

    end: ROOT_END (joint to beam start) or TIP_END (beam end to next joint). The near point is closer to the arm's root.
    """
    sine, cosine = sincos(angle)
    length = model.rigid[lever_at(k, end) + OF_LEVER.length]
    return cosine * length, sine * length


@kernel
def payload_lever_vector(lane, model, angle):
    """Return the vector (m, inertial axes) from the tip to the payload's center of mass; angle: psi of the tip, rad."""
    sine, cosine = sincos(angle)
    return rotate_2d(cosine, sine, model.eccentric[0], model.eccentric[1])


@kernel
def _factors_at(model, k, end):
    """Return the offset in S of the `LEVER_FACTORS` of an end of link k; with k = links of the payload's lever."""
    return factors_of(model).end + OF_FACTORS.end * (2 * k + end)


@kernel
def _store_lever_factors(lane, S, at, lever, far, mass, turn):
    """Write a lever's terms of the Newton matrix, the `LEVER_FACTORS`, to S from offset `at` on.

    lever: vector (e_x, e_y), m, inertial axes. The derivative of the far point by the lever's angle is (-e_y, e_x).
    far: mass at the far point. mass: mass of the lever itself. Both are in kg times the weight of M in the matrix.
    turn: diagonal entry of the lever's angle, i.e. weighted inertia minus geometric stiffness.
    """
    ex, ey = lever
    store_pair(lane, S, at + OF_FACTORS.x, (-ey, ex))
    store_vector(lane, S, at + OF_FACTORS.far, (far, mass, turn))


@kernel
def payload_place(lane, model, psi, spin, x, y, vx, vy):
    """Return (x, y, vx, vy; inertial axes) of the payload's center of mass, given x, y, vx, vy of the tip.

    Units are m and m/s.
    psi, spin: angle (rad) and rate (rad/s) of the tip section. If the payload is at the tip, the function returns the
    arguments of the tip.
    """
    if model.eccentric is None:
        return x, y, vx, vy
    return lever_end_velocity(lane, payload_lever_vector(lane, model, psi), spin, x, y, vx, vy)


@kernel
def _payload_force(lane, model, psi, motion, mass, weights, S):
    """Return the payload's inertia force at the tip and its moment about the tip: (fx, fy, moment, mass).

    Units are N (inertial axes), N m, kg.
    psi: angle of the tip section.
    motion: rate and second rate of psi, then the tip's acceleration (x, y) minus gravity.
    mass: mass of the payload, kg. The returned mass is the mass at the tip in the matrix, 0 if the payload has a lever;
    the lever's factors are then written to S with weights.with_matrix.
    """
    rate, second, ax, ay = motion
    if model.eccentric is None:
        return ax * mass, ay * mass, 0.0, mass
    ex, ey = payload_lever_vector(lane, model, psi)
    px, py = _lever_acceleration((ex, ey), rate, second, ax, ay, 1.0)
    fx, fy, zero = px * mass, py * mass, 0.0
    # stiffness of the angle: moment e x f changes by -e . f
    if weights.with_matrix:
        turn = -((ex * fx + ey * fy) * weights.stiffness)
        at = _factors_at(model, model.links, ROOT_END)
        _store_lever_factors(lane, S, at, (ex, ey), mass * weights.mass, zero, turn)
    return fx, fy, ex * fy - ey * fx, zero


@kernel
def lever_end_velocity(lane, lever, rate, x, y, vx, vy):
    """Return position (m) and velocity (m/s) of a lever's far point, (x, y, vx, vy), inertial axes.

    lever: vector from near to far point, m.
    rate: rate of the lever's angle, rad/s.
    x, y, vx, vy: position and velocity of the near point.
    """
    ax, ay = lever
    return x + ax, y + ay, vx - rate * ay, vy + rate * ax


@kernel
def _lever_acceleration(lever, rate, second, ax, ay, share):
    """Return the acceleration (x, y; m/s^2) of a point on a lever e: a + share (second e' - rate^2 e).

    e' is the vector (-e_y, e_x), a = (ax, ay) the acceleration of the near point. share is 0 at the near point, 1/2 in
    the middle, 1 at the far point.
    rate, second: first and second rate of the lever's angle, rad/s and rad/s^2. Vectors are in inertial axes.
    """
    ex, ey = lever
    square = rate * rate
    return ax + (-(second * ey) - square * ex) * share, ay + (second * ex - square * ey) * share


@kernel
def beam_start(lane, model, state: State, k, tip, i):
    """Return the `Vertex` at which the beam of link k begins, beyond levers and hinge; tip: vertex before, row i.

    For k = 0 `tip` is the joint at the chain's root. The force components of the new vertex are 0. The new vertex's
    moment is the hub's inertia torque minus the hub torque (k = 0), or the inertia torque of the elbow part beyond the
    hinge. `beam_start_rows` later transmits the beam's force to `tip`.
    state: coordinates q, velocities v, accelerations a of the arm. See docs/theory.md, section 5, "Rigid ends".
    """
    (x, y, psi), (vx, vy, turning), (ax, ay, alpha), (_, _, moment) = tip.place, tip.rate, tip.acceleration, tip.force
    # omega is for centripetal terms, `turning` for strain rates, which a damped model alone reads
    omega = state.v[i + T]
    zero = 0.0
    if k > 0:
        # lever e of link k - 1's tip end: r + e, v + w n; then psi + delta behind the hinge (inertial axes)
        d = rows_of(model).hinges + k - 1
        lever = lever_vector(lane, model, k - 1, TIP_END, psi)
        x, y, vx, vy = lever_end_velocity(lane, lever, turning, x, y, vx, vy)
        ax, ay = _lever_acceleration(lever, omega, alpha, ax, ay, 1.0)
        psi, spin, alpha = psi + state.q[d], state.v[d], alpha + state.a[d]
        omega, turning = omega + spin, turning + spin
        moment = alpha * elbow_of(model, k).right
    # root lever of link k (m, inertial axes): from the joint to the beam's first vertex
    lever = lever_vector(lane, model, k, ROOT_END, psi)
    x, y, vx, vy = lever_end_velocity(lane, lever, turning, x, y, vx, vy)
    ax, ay = _lever_acceleration(lever, omega, alpha, ax, ay, 1.0)
    return Vertex((x, y, psi), (vx, vy, turning), (ax, ay, alpha), (zero, zero, moment))


@kernel
def _through(lane, model, k, end, lever, motion, force, moment, far, weights, S):
    """Return (fx, fy, moment) at a lever's near point, given the force and moment at the lever's far point.

    The lever's own inertia is included.
    k, end: link and end of the lever.
    lever: vector e, m, inertial axes.
    motion: rate and second rate of the lever's angle, then acceleration (x, y) of the near point minus gravity. force
    (N), moment (N m): at the far point.
    far: mass at the far point, kg, used only in the matrix. With weights.with_matrix the lever's factors are written to
    S. See docs/theory.md, section 5, "Rigid ends".
    """
    rate, second, ax, ay = motion
    ex, ey = lever
    own = lever_at(k, end)
    mass, inertia = model.rigid[own + OF_LEVER.mass], model.rigid[own + OF_LEVER.inertia]
    # inertia force m (a + alpha n/2 - w^2 e/2) of the lever's mass, in its middle (inertial axes)
    mx, my = _lever_acceleration(lever, rate, second, ax, ay, 0.5)
    mx, my = mx * mass, my * mass
    fx, fy = force
    # geometric stiffness: the moments e x f + e/2 x m change with the angle by -(e . f + e/2 . m)
    if weights.with_matrix:
        pull = (ex * fx + ey * fy) + (ex * mx + ey * my) * 0.5
        turn = inertia * weights.mass - pull * weights.stiffness
        _store_lever_factors(lane, S, _factors_at(model, k, end), lever, far * weights.mass, mass * weights.mass, turn)
    moment = moment + (ex * fy - ey * fx) + (ex * my - ey * mx) * 0.5 + second * inertia
    return fx + mx, fy + my, moment


@kernel
def beam_start_rows(lane, model, state: State, u: Lanes, k, tip, i, r: Lanes, weights, S):
    """Write the residual rows of the vertex before link k (row i) and of its hinge, with rigid ends (theory, 5).

    On entry r[i : i + 3] is the force (N, inertial axes) and moment (N m) on the start of link k's beam. On return
    these rows are those of the vertex `tip`: the near point of the preceding tip lever, or of the root lever for k = 0.
    The hinge's row is the moment minus the joint torque u[k].
    state: coordinates q, velocities v, accelerations a of the arm. With weights.with_matrix the levers' factors are
    written to S.
    """
    _, _, psi = tip.place
    (ax, ay, alpha), (gx, gy, moment) = tip.acceleration, tip.force
    omega, zero = state.v[i + T], 0.0
    fx, fy, turn = load_vector(lane, r, i)
    if k == 0:
        lever, motion = lever_vector(lane, model, 0, ROOT_END, psi), (omega, alpha, ax, ay)
        fx, fy, turn = _through(lane, model, 0, ROOT_END, lever, motion, (fx, fy), turn, zero, weights, S)
    else:
        d, elbow = rows_of(model).hinges + k - 1, elbow_of(model, k)
        before = lever_vector(lane, model, k - 1, TIP_END, psi)
        jx, jy = _lever_acceleration(before, omega, alpha, ax, ay, 1.0)
        # force and moment on the beam's first vertex, carried through the lever e to the joint: M + e x f
        motion = omega + state.v[d], alpha + state.a[d], jx, jy
        lever = lever_vector(lane, model, k, ROOT_END, psi + state.q[d])
        fx, fy, turn = _through(lane, model, k, ROOT_END, lever, motion, (fx, fy), turn, zero, weights, S)
        r[d] = turn - u[k]
        # at the joint m (a - g) of the elbow; then through the tip lever to the vertex before it, with that beam's
        # force
        fx, fy = fx + jx * elbow.mass, fy + jy * elbow.mass
        fx, fy, turn = _through(
            lane, model, k - 1, TIP_END, before, (omega, alpha, ax, ay), (fx, fy),
            turn + moment + alpha * elbow.left, elbow.mass, weights, S,
        )  # fmt: skip
        fx, fy = fx + gx, fy + gy
    store_vector(lane, r, i, (fx, fy, turn))


@kernel
def last_vertex_force(lane, model, par: Lanes, state: State, tip, i, weights, S):
    """Return the force (N, inertial axes) and moment (N m) on the arm's last vertex, whose first row is i.

    The result is the sum of the force of the beam (field of `tip`), of the payload's mass, and of the tip lever that
    carries the payload. The caller adds the moment of the payload's rotary inertia.
    """
    (fx, fy, moment), (ax, ay, alpha) = tip.force, tip.acceleration
    omega, mass, k = state.v[i + T], par[PAYLOAD_MASS], model.links - 1
    lever = lever_vector(lane, model, k, TIP_END, tip.place[T])
    px, py = _lever_acceleration(lever, omega, alpha, ax, ay, 1.0)
    # m_p (a - g) at the payload's center, carried through its lever to the end of the tip lever and to the last vertex
    motion = omega, alpha, px, py
    px, py, more, there = _payload_force(lane, model, tip.place[T], motion, mass, weights, S)
    motion, moment = (omega, alpha, ax, ay), moment + more
    gx, gy, turn = _through(lane, model, k, TIP_END, lever, motion, (px, py), moment, there, weights, S)
    return fx + gx, fy + gy, turn


# factors: far point (x, y, psi) of a lever e condensed to the near one by n = (-e_y, e_x)


@kernel
def condense_to_near_point(lane, model, S, k, end, tail):
    """Return the symmetric 3x3 matrix on (x, y, psi) of a lever's near point, given the far point's matrix `tail`.

    Matrices are tuples (xx, xy, xt, yy, yt, tt), with t for psi.
    k, end: link and end of the lever; its `LEVER_FACTORS` are in S. With n = (-e_y, e_x), the far point moves by dx + n
    dpsi (a linear map T), the lever's middle by dx + n/2 dpsi. The result is T^T (tail + far mass) T, plus the lever's
    own mass and `turn` on psi. Without levers the function returns `tail`. See docs/theory.md, section 5, "Rigid ends".
    """
    if model.rigid is None:
        return tail
    # S_near = T^T S_far T with (x, y, psi)_far = (x, y, psi) + psi n, n = (-e_y, e_x)
    at = _factors_at(model, k, end)
    nx, ny = load_pair(lane, S, at + OF_FACTORS.x)
    far, mass, turn = load_vector(lane, S, at + OF_FACTORS.far)
    xx, xy, xt, yy, yt, tt = tail
    xx, yy = xx + far, yy + far
    px, py = xx * nx + xy * ny, xy * nx + yy * ny
    tt = tt + (xt * nx + yt * ny) * 2.0 + (nx * px + ny * py)
    # the lever's mass in its middle, its inertia and its geometric stiffness
    tt = tt + mass * (nx * nx + ny * ny) * 0.25 + turn
    return xx + mass, xy, xt + px + mass * nx * 0.5, yy + mass, yt + py + mass * ny * 0.5, tt


@kernel
def condense_payload(lane, model, S, tail):
    """Return the symmetric 3x3 matrix on (x, y, psi) of the tip, given the matrix `tail` of the payload's center.

    S contains the `LEVER_FACTORS` of the payload's lever. If the payload is at the tip, the function returns `tail`.
    """
    if model.eccentric is None:
        return tail
    return condense_to_near_point(lane, model, S, model.links, ROOT_END, tail)


@kernel
def moment_about(lane, model, S, k, end, x, y):
    """Return the moment n . (x, y), N m, about a lever's near point, of the force (x, y) at the lever's far point.

    The force is in N, inertial axes. S contains n = (-e_y, e_x) of the lever e at this end of link k. Without levers
    the moment is 0.
    """
    if model.rigid is None:
        return 0.0
    nx, ny = load_pair(lane, S, _factors_at(model, k, end) + OF_FACTORS.x)
    return nx * x + ny * y


@kernel
def far_point_increment(lane, model, S, k, end, x, y, turn):
    """Return the increment (x, y), m, of a lever's far point, given the increments of its near point and angle.

    x, y: increment of the near point (m, inertial axes).
    turn: increment of the lever's angle (rad). The result is (x, y) + n turn. S contains n = (-e_y, e_x) of the lever e
    at this end of link k. Without levers the function returns (x, y).
    """
    if model.rigid is None:
        return x, y
    nx, ny = load_pair(lane, S, _factors_at(model, k, end) + OF_FACTORS.x)
    return x + nx * turn, y + ny * turn


@kernel
def about_root(lane, model, S, k, x: Lanes, i, tx, ty, taken, tt):
    """Transfer the elimination's result from the start of link k's beam to the joint before it; return (taken, tt).

    In `solve`, rows i and i + 1 of x contain the original right side of rows x and y; (tx, ty) is their right side
    after elimination. The difference is a force at the far point of the root lever. The moment of this force about the
    joint is added to `taken` and subtracted from `tt`.
    taken: amount that elimination has subtracted from the row of psi.
    tt: remaining right side of the row of psi.
    S: array of the matrix factors. Without levers (taken, tt) is returned unchanged.
    """
    if model.rigid is None:
        return taken, tt
    moment = moment_about(lane, model, S, k, ROOT_END, x[i + X] - tx, x[i + Y] - ty)
    return taken + moment, tt - moment


@kernel
def about_tip(lane, model, S, k, x: Lanes, i, tx, ty, tt):
    """Return tt minus the moment of the force that elimination subtracted; tt: remaining right side of psi (row i + 2).

    In `solve`, rows i and i + 1 of x contain the original right side of rows x and y; (tx, ty) is their right side
    after elimination. The difference is a force at the far point of link k's tip lever.
    S: array of the matrix factors. Without levers tt is returned unchanged.
    """
    if model.rigid is None:
        return tt
    return tt - moment_about(lane, model, S, k, TIP_END, x[i + X] - tx, x[i + Y] - ty)


# motions of far points from near ones: r + e, v + w n


@kernel
def vertex_motion(lane, q, v, i):
    """Return position (m) and velocity (m/s) of the vertex whose first row is i: (x, y, vx, vy), inertial axes."""
    (x, y), (vx, vy) = load_pair(lane, q, i), load_pair(lane, v, i)
    return x, y, vx, vy


@kernel
def joint_motion(lane, model, q: Lanes, v: Lanes, k):
    """Return position (m) and velocity (m/s) of joint k, or of the tip for k = links: (x, y, vx, vy), inertial axes."""
    i = vertex_of(model, k)
    x, y, vx, vy = vertex_motion(lane, q, v, i)
    if model.rigid is None or k == 0:
        return x, y, vx, vy
    return lever_end_velocity(lane, lever_vector(lane, model, k - 1, TIP_END, q[i + T]), v[i + T], x, y, vx, vy)


@kernel
def beam_start_motion(lane, model, q, v, k):
    """Return (x, y, vx, vy) of the start of link k's beam (m and m/s, inertial axes); None without rigid ends.

    q: coordinates (m, rad). v: rates of q. Without rigid ends the start is the vertex, whose rows are in q and v.
    """
    if model.rigid is None:
        return None
    x, y, vx, vy = joint_motion(lane, model, q, v, k)
    psi, spin = root_angle(lane, model, q, k), root_angle(lane, model, v, k)
    return lever_end_velocity(lane, lever_vector(lane, model, k, ROOT_END, psi), spin, x, y, vx, vy)


@kernel
def next_vertex_motion(lane, model, q, v, i):
    """Return (x, y, vx, vy) of the vertex at row i, the left vertex of an element; None without rigid ends.

    Units are m and m/s, in inertial axes. The function serves all elements of a link except the first; use
    `beam_start_motion` for the first. Without rigid ends, read the vertex's motion from q and v.
    """
    if model.rigid is None:
        return None
    return vertex_motion(lane, q, v, i)


@kernel
def rigid_end_sums(lane, model, q: Lanes, v: Lanes, k):
    """Return kinetic energy (J) and first moments of mass (x, y; kg m, inertial axes) of the rigid ends of link k.

    See docs/theory.md, section 5, "Rigid ends".
    """
    zero = 0.0
    kinetic, mx, my = zero, zero, zero
    for side in range(2):
        at, i = lever_at(k, side), vertex_of(model, k + side)
        mass, inertia = model.rigid[at + OF_LEVER.mass], model.rigid[at + OF_LEVER.inertia]
        if side == 0:
            x, y, vx, vy = joint_motion(lane, model, q, v, k)
            psi, spin = root_angle(lane, model, q, k), root_angle(lane, model, v, k)
        else:
            x, y, vx, vy = vertex_motion(lane, q, v, i)
            psi, spin = q[i + T], v[i + T]
        # r + e/2, v + w n/2: the lever's mass is in its middle (inertial axes)
        ax, ay = lever_vector(lane, model, k, side, psi)
        x, y, vx, vy = lever_end_velocity(lane, (ax * 0.5, ay * 0.5), spin, x, y, vx, vy)
        kinetic = kinetic + ((vx * vx + vy * vy) * mass + (spin * spin) * inertia) * 0.5
        mx, my = mx + x * mass, my + y * mass
    return kinetic, mx, my
