"""Rigid ends of links: levers between the rows of a chain and its beams (docs: theory, "Exact beam").

The rows of a vertex are those of a beam's tip, or of the joint at the chain's root. Where links have rigid ends the
next beam begins elsewhere: past the lever of the tip before it (length b along psi), the hinge, and the lever of its
own root (c along psi + delta). What acts at the far point of a lever acts on the near one with a moment; its mass is
in its middle. The matrix leaves out that a lever turns while it accelerates (terms in h omega, times its share of the
inertia). A payload whose centre is not at the tip is at the far point of one more lever, behind the last.
"""

from ...compiler import kernel, load, sincos, splat, store
from ..arithmetic import pair, put_pair, put_vector, turned, vector
from ..layout import LEVER
from ..model import PAYLOAD_MASS
from .layout import LEVER_FACTORS, T, Vertex, X, Y, elbow_of, factors_of, lever_at, root_angle, rows_of, vertex_of

OF_LEVER, OF_FACTORS = LEVER.places, LEVER_FACTORS.places
ROOT_END, TIP_END = range(2)


@kernel
def arm(lane, model, k, end, angle):
    """The lever of an end of link k as a vector along its beam's tangent."""
    sine, cosine = sincos(angle)
    length = model.rigid[lever_at(k, end) + OF_LEVER.length]
    return cosine * length, sine * length


@kernel
def to_payload(lane, model, angle):
    """The lever from the tip to the payload's centre."""
    sine, cosine = sincos(angle)
    return turned(cosine, sine, model.eccentric[0], model.eccentric[1])


@kernel
def _factors_at(model, k, end):
    """Where the `LEVER_FACTORS` of an end of link k begin; of the payload's lever for k = links."""
    return factors_of(model).end + OF_FACTORS.end * (2 * k + end)


@kernel
def _keep(S, at, lever, far, mass, turn):
    """Write the `LEVER_FACTORS` at `at`."""
    ex, ey = lever
    put_pair(S, at + OF_FACTORS.x, (-ey, ex))
    put_vector(S, at + OF_FACTORS.far, (far, mass, turn))


@kernel
def payload_place(lane, model, psi, spin, x, y, vx, vy):
    """Place and velocity of the payload's centre, from those of the tip."""
    if model.eccentric is None:
        return x, y, vx, vy
    return swung(lane, to_payload(lane, model, psi), spin, x, y, vx, vy)


@kernel
def _payload_force(lane, model, psi, motion, mass, weights, S):
    """Force and moment of the payload's mass at the tip, whose motion is as in `_through`; mass there in the matrix."""
    rate, second, ax, ay = motion
    if model.eccentric is None:
        return ax * mass, ay * mass, splat(lane, 0.0), mass
    ex, ey = to_payload(lane, model, psi)
    px, py = _accelerated((ex, ey), rate, second, ax, ay, 1.0)
    fx, fy, zero = px * mass, py * mass, splat(lane, 0.0)
    if weights.mass != 0.0:
        turn = -((ex * fx + ey * fy) * weights.stiffness)
        _keep(S, _factors_at(model, model.links, ROOT_END), (ex, ey), mass * weights.mass, zero, turn)
    return fx, fy, ex * fy - ey * fx, zero


@kernel
def swung(lane, lever, rate, x, y, vx, vy):
    """Place and velocity of the far point of a lever."""
    ax, ay = lever
    return x + ax, y + ay, vx - rate * ay, vy + rate * ax


@kernel
def _accelerated(lever, rate, second, ax, ay, share):
    """Acceleration at a share of a lever."""
    ex, ey = lever
    square = rate * rate
    return ax + (-(second * ey) - square * ex) * share, ay + (second * ex - square * ey) * share


@kernel
def begin(lane, model, state, k, tip, i):
    """The vertex where the beam of link k begins, from that before it at row i (`tip`): its force is what turns with
    it, no more."""
    (x, y, psi), (vx, vy, turning), (ax, ay, alpha), (_, _, moment) = tip.place, tip.rate, tip.acceleration, tip.force
    omega = load(lane, state.v, i + T)
    zero = splat(lane, 0.0)
    if k > 0:
        d = rows_of(model).hinges + k - 1
        lever = arm(lane, model, k - 1, TIP_END, psi)
        x, y, vx, vy = swung(lane, lever, turning, x, y, vx, vy)
        ax, ay = _accelerated(lever, omega, alpha, ax, ay, 1.0)
        psi, spin, alpha = psi + load(lane, state.q, d), load(lane, state.v, d), alpha + load(lane, state.a, d)
        omega, turning = omega + spin, turning + spin
        moment = alpha * elbow_of(model, k).right
    lever = arm(lane, model, k, ROOT_END, psi)
    x, y, vx, vy = swung(lane, lever, turning, x, y, vx, vy)
    ax, ay = _accelerated(lever, omega, alpha, ax, ay, 1.0)
    return Vertex((x, y, psi), (vx, vy, turning), (ax, ay, alpha), (zero, zero, moment))


@kernel
def _through(lane, model, k, end, lever, motion, force, moment, far, weights, S):
    """Force and moment at the near point of a lever, from those at its far one; its factors, where S is wanted.

    motion: rate, second rate, acceleration (x, y) of the near point. far: mass there, that of the matrix."""
    rate, second, ax, ay = motion
    ex, ey = lever
    own = lever_at(k, end)
    mass, inertia = model.rigid[own + OF_LEVER.mass], model.rigid[own + OF_LEVER.inertia]
    mx, my = _accelerated(lever, rate, second, ax, ay, 0.5)
    mx, my = mx * mass, my * mass
    fx, fy = force
    if weights.mass != 0.0:
        pull = (ex * fx + ey * fy) + (ex * mx + ey * my) * 0.5
        turn = inertia * weights.mass - pull * weights.stiffness
        _keep(S, _factors_at(model, k, end), lever, far * weights.mass, splat(lane, mass * weights.mass), turn)
    moment = moment + (ex * fy - ey * fx) + (ex * my - ey * mx) * 0.5 + second * inertia
    return fx + mx, fy + my, moment


@kernel
def end(lane, model, state, u, k, tip, i, r, weights, S):
    """The rows of the vertex before link k and of its hinge, from what the beam asks for where it begins."""
    _, _, psi = tip.place
    (ax, ay, alpha), (gx, gy, moment) = tip.acceleration, tip.force
    omega, zero = load(lane, state.v, i + T), splat(lane, 0.0)
    fx, fy, turn = vector(lane, r, i)
    if k == 0:
        lever, motion = arm(lane, model, 0, ROOT_END, psi), (omega, alpha, ax, ay)
        fx, fy, turn = _through(lane, model, 0, ROOT_END, lever, motion, (fx, fy), turn, zero, weights, S)
    else:
        d, elbow = rows_of(model).hinges + k - 1, elbow_of(model, k)
        before = arm(lane, model, k - 1, TIP_END, psi)
        jx, jy = _accelerated(before, omega, alpha, ax, ay, 1.0)
        motion = omega + load(lane, state.v, d), alpha + load(lane, state.a, d), jx, jy
        lever = arm(lane, model, k, ROOT_END, psi + load(lane, state.q, d))
        fx, fy, turn = _through(lane, model, k, ROOT_END, lever, motion, (fx, fy), turn, zero, weights, S)
        store(r, d, turn - load(lane, u, k))
        fx, fy = fx + jx * elbow.mass, fy + jy * elbow.mass
        fx, fy, turn = _through(
            lane, model, k - 1, TIP_END, before, (omega, alpha, ax, ay), (fx, fy),
            turn + moment + alpha * elbow.left, splat(lane, elbow.mass), weights, S,
        )  # fmt: skip
        fx, fy = fx + gx, fy + gy
    put_vector(r, i, (fx, fy, turn))


@kernel
def last(lane, model, par, state, tip, i, weights, S):
    """Force and moment on the last vertex with those of the payload and the rigid end that carries it."""
    (fx, fy, moment), (ax, ay, alpha) = tip.force, tip.acceleration
    omega, mass, k = load(lane, state.v, i + T), load(lane, par, PAYLOAD_MASS), model.links - 1
    lever = arm(lane, model, k, TIP_END, tip.place[T])
    px, py = _accelerated(lever, omega, alpha, ax, ay, 1.0)
    motion = omega, alpha, px, py
    px, py, more, there = _payload_force(lane, model, tip.place[T], motion, mass, weights, S)
    motion, moment = (omega, alpha, ax, ay), moment + more
    gx, gy, turn = _through(lane, model, k, TIP_END, lever, motion, (px, py), moment, there, weights, S)
    return fx + gx, fy + gy, turn


# --- factors -----------------------------------------------------------------------------------------


@kernel
def near(lane, model, S, k, end, tail):
    """The matrix of x, y, psi at the near point of a lever from that at its far one."""
    if model.rigid is None:
        return tail
    at = _factors_at(model, k, end)
    nx, ny = pair(lane, S, at + OF_FACTORS.x)
    far, mass, turn = vector(lane, S, at + OF_FACTORS.far)
    xx, xy, xt, yy, yt, tt = tail
    xx, yy = xx + far, yy + far
    px, py = xx * nx + xy * ny, xy * nx + yy * ny
    tt = tt + (xt * nx + yt * ny) * 2.0 + (nx * px + ny * py)
    tt = tt + mass * (nx * nx + ny * ny) * 0.25 + turn
    return xx + mass, xy, xt + px + mass * nx * 0.5, yy + mass, yt + py + mass * ny * 0.5, tt


@kernel
def with_payload(lane, model, S, tail):
    """The matrix of x, y, psi at the tip, with that of the payload behind it."""
    if model.eccentric is None:
        return tail
    return near(lane, model, S, model.links, ROOT_END, tail)


@kernel
def moment_about(lane, model, S, k, end, x, y):
    """Moment about a lever's near point of a force at its far one."""
    if model.rigid is None:
        return splat(lane, 0.0)
    nx, ny = pair(lane, S, _factors_at(model, k, end) + OF_FACTORS.x)
    return nx * x + ny * y


@kernel
def carried(lane, model, S, k, end, x, y, turn):
    """How a lever's far point moves where its near one moves by x, y and turns."""
    if model.rigid is None:
        return x, y
    nx, ny = pair(lane, S, _factors_at(model, k, end) + OF_FACTORS.x)
    return x + nx * turn, y + ny * turn


@kernel
def about_root(lane, model, S, k, x, i, tx, ty, taken, tt):
    """What is taken from the angle at a joint, and what is left of row i's, with moments on the lever behind it."""
    if model.rigid is None:
        return taken, tt
    moment = moment_about(lane, model, S, k, ROOT_END, load(lane, x, i + X) - tx, load(lane, x, i + Y) - ty)
    return taken + moment, tt - moment


@kernel
def about_tip(lane, model, S, k, x, i, tx, ty, tt):
    """What is left of row i's angle, with moments on the lever before the joint."""
    if model.rigid is None:
        return tt
    return tt - moment_about(lane, model, S, k, TIP_END, load(lane, x, i + X) - tx, load(lane, x, i + Y) - ty)


# --- what is read off --------------------------------------------------------------------------------


@kernel
def vertex(lane, q, v, i):
    """Place and velocity of the vertex at row i."""
    (x, y), (vx, vy) = pair(lane, q, i), pair(lane, v, i)
    return x, y, vx, vy


@kernel
def joint(lane, model, q, v, k):
    """Place and velocity of joint k (of the arm's tip: k = links)."""
    i = vertex_of(model, k)
    x, y, vx, vy = vertex(lane, q, v, i)
    if model.rigid is None or k == 0:
        return x, y, vx, vy
    return swung(lane, arm(lane, model, k - 1, TIP_END, load(lane, q, i + T)), load(lane, v, i + T), x, y, vx, vy)


@kernel
def beginning(lane, model, q, v, k):
    """Place and velocity of where the beam of link k begins; None without rigid ends."""
    if model.rigid is None:
        return None
    x, y, vx, vy = joint(lane, model, q, v, k)
    psi, spin = root_angle(lane, model, q, k), root_angle(lane, model, v, k)
    return swung(lane, arm(lane, model, k, ROOT_END, psi), spin, x, y, vx, vy)


@kernel
def following(lane, model, q, v, i):
    """Those of the vertex at row i, where the next element of a beam begins."""
    if model.rigid is None:
        return None
    return vertex(lane, q, v, i)


@kernel
def ends_of(lane, model, q, v, k):
    """(kinetic energy, first moments x, y) of the rigid ends of link k."""
    zero = splat(lane, 0.0)
    kinetic, mx, my = zero, zero, zero
    for side in range(2):
        at, i = lever_at(k, side), vertex_of(model, k + side)
        mass, inertia = model.rigid[at + OF_LEVER.mass], model.rigid[at + OF_LEVER.inertia]
        if side == 0:
            x, y, vx, vy = joint(lane, model, q, v, k)
            psi, spin = root_angle(lane, model, q, k), root_angle(lane, model, v, k)
        else:
            x, y, vx, vy = vertex(lane, q, v, i)
            psi, spin = load(lane, q, i + T), load(lane, v, i + T)
        ax, ay = arm(lane, model, k, side, psi)
        x, y, vx, vy = swung(lane, (ax * 0.5, ay * 0.5), spin, x, y, vx, vy)
        kinetic = kinetic + ((vx * vx + vy * vy) * mass + (spin * spin) * inertia) * 0.5
        mx, my = mx + x * mass, my + y * mass
    return kinetic, mx, my
