"""Levers in a chain of floating frames: rigid ends of links, between a joint and the link's first or last body, and
that from the tip to the payload's centre.

At the near point of a lever a section has an acceleration a (less gravity), an angle, its rate w and second rate; at
its far point, l e away, a + l (alpha n - w^2 e), n = E e. A force there is a moment here besides. A lever has
a mass in its middle, and an elbow's mass at its far point.
"""

from typing import Any, NamedTuple

from ...compiler import kernel, load, sincos, splat, store
from ..arithmetic import add, pair, put_pair, put_vector, vector
from ..layout import LEVER, POSE
from .layout import LEVER_FACTORS, PASSED, cell

OF_LEVER, OF_FACTORS = LEVER.places, LEVER_FACTORS.places
ROOT_END, TIP_END = range(2)
ACROSS, SWEPT = OF_FACTORS.nx, OF_FACTORS.wx
"""Where change of the far point's place by the angle begins, and that of its acceleration."""


class Lever(NamedTuple):
    """One of them."""

    number: int  # in the order of their factors in S
    along: float  # m, from the near point to the far one, along the section's tangent
    across: Any  # m, across it, or None
    mass: float  # kg
    inertia: float  # kg m^2
    far: float  # kg, of a mass at the far point


@kernel
def end_of(model, k, end):
    """The rigid end of link k, or None."""
    if model.rigid is None:
        return None
    at = OF_LEVER.end * (2 * k + end)
    mass, inertia = model.rigid[at + OF_LEVER.mass], model.rigid[at + OF_LEVER.inertia]
    return Lever(2 * k + end, model.rigid[at + OF_LEVER.length], None, mass, inertia, model.rigid[at + OF_LEVER.far])


@kernel
def to_payload(model):
    """The lever to the payload, or None."""
    if model.eccentric is None:
        return None
    return Lever(2 * model.links, model.eccentric[0], model.eccentric[1], 0.0, 0.0, 0.0)


@kernel
def _factors_at(first, lever):
    """Where the `LEVER_FACTORS` of a lever begin, those of all of them at `first`."""
    return first + OF_FACTORS.end * lever.number


@kernel
def _lever_at(lane, along, across, angle):
    """A lever, or a part of one, at an angle of its section."""
    sine, cosine = sincos(angle)
    ex, ey = cosine * along, sine * along
    if across is not None:
        ex, ey = ex - sine * across, ey + cosine * across
    return ex, ey


@kernel
def outward(lane, lever, pose, S, first):
    """pose <- that of the far point of a lever; what is known of it is kept in S."""
    if lever is not None:
        at, (angle, w, alpha) = _factors_at(first, lever), vector(lane, pose, PASSED.angle)
        ex, ey = _lever_at(lane, lever.along, lever.across, angle)
        ax, ay = pair(lane, pose, PASSED.ax)
        put_pair(S, at + OF_FACTORS.ex, (ex, ey))
        put_pair(S, at + OF_FACTORS.rate, (w, alpha))
        put_pair(S, at + OF_FACTORS.ax, (ax, ay))
        put_pair(pose, PASSED.ax, (ax - (alpha * ey + (w * w) * ex), ay + (alpha * ex - (w * w) * ey)))


@kernel
def inward(lane, lever, force, cm, cc, ck, S, first):
    """force <- force and moment that a lever and all behind it need at its near point, from those at its far point.

    cm, cc, ck: weights of M, C and K; where cm is not 0 the lever's part of the matrix is kept in S.
    """
    if lever is not None:
        at = _factors_at(first, lever)
        ex, ey = pair(lane, S, at + OF_FACTORS.ex)
        w, alpha = pair(lane, S, at + OF_FACTORS.rate)
        ax, ay = pair(lane, S, at + OF_FACTORS.ax)
        dx, dy = -(alpha * ey + (w * w) * ex), alpha * ex - (w * w) * ey
        fx, fy, moment = vector(lane, force, 0)
        fx, fy = fx + (ax + dx) * lever.far, fy + (ay + dy) * lever.far
        mx, my = (ax + dx * 0.5) * lever.mass, (ay + dy * 0.5) * lever.mass
        moment = moment + (ex * fy - ey * fx) + (ex * my - ey * mx) * 0.5 + alpha * lever.inertia
        put_vector(force, 0, (fx + mx, fy + my, moment))
        if cm != 0.0:
            twice, pull = w * (2.0 * cc), (ex * fx + ey * fy) + (ex * mx + ey * my) * 0.5
            put_pair(S, at + OF_FACTORS.nx, (-ey, ex))
            put_pair(S, at + OF_FACTORS.wx, (-(ey * cm) - ex * twice - dy * ck, ex * cm - ey * twice + dx * ck))
            store(S, at + OF_FACTORS.turn, lever.inertia * cm - pull * ck)


@kernel
def near(lane, lever, S, first, tail):
    """tail <- the matrix of force and moment by acceleration and angle at the near point, from that at the far one."""
    if lever is not None:
        at, mass = _factors_at(first, lever), lever.mass
        nx, ny = pair(lane, S, at + OF_FACTORS.nx)
        wx, wy = pair(lane, S, at + OF_FACTORS.wx)
        for i in range(2):
            add(lane, tail, cell(i, i), lever.far)
        for i in range(3):
            add(lane, tail, cell(i, 2), load(lane, tail, cell(i, 0)) * wx + load(lane, tail, cell(i, 1)) * wy)
        for j in range(3):
            add(lane, tail, cell(2, j), load(lane, tail, cell(0, j)) * nx + load(lane, tail, cell(1, j)) * ny)
        half = splat(lane, 0.5 * mass)
        for i in range(2):
            add(lane, tail, cell(i, i), mass)
        add(lane, tail, cell(0, 2), wx * half)
        add(lane, tail, cell(1, 2), wy * half)
        add(lane, tail, cell(2, 0), nx * half)
        add(lane, tail, cell(2, 1), ny * half)
        add(lane, tail, cell(2, 2), (nx * wx + ny * wy) * (half * 0.5) + load(lane, S, at + OF_FACTORS.turn))


@kernel
def with_moment(lane, lever, S, first, arm, flow):
    """flow <- that of the near point, where it is a force and a moment; arm: ACROSS, or SWEPT if transposed."""
    if lever is not None:
        x, y = pair(lane, S, _factors_at(first, lever) + arm)
        add(lane, flow, 2, x * load(lane, flow, 0) + y * load(lane, flow, 1))


@kernel
def swept(lane, lever, S, first, arm, flow):
    """flow <- that of the far point, where it is a change of acceleration and angle; arm: SWEPT, or ACROSS if
    transposed."""
    if lever is not None:
        x, y = pair(lane, S, _factors_at(first, lever) + arm)
        turn = load(lane, flow, 2)
        add(lane, flow, 0, x * turn)
        add(lane, flow, 1, y * turn)


@kernel
def _move(lane, along, across, pose):
    """pose (x, y, angle and rates) <- that of a point so far away."""
    w = load(lane, pose, POSE.rate)
    ex, ey = _lever_at(lane, along, across, load(lane, pose, POSE.angle))
    add(lane, pose, POSE.x, ex)
    add(lane, pose, POSE.y, ey)
    store(pose, POSE.vx, load(lane, pose, POSE.vx) - w * ey)
    add(lane, pose, POSE.vy, w * ex)


@kernel
def moved(lane, lever, pose):
    """pose <- that of the far point."""
    if lever is not None:
        _move(lane, lever.along, lever.across, pose)


@kernel
def _body(lane, pose, mass, inertia, totals):
    """totals (kinetic energy, first moments x, y) += those of a rigid body at a pose."""
    vx, vy, w = vector(lane, pose, POSE.vx)
    add(lane, totals, 0, ((vx * vx + vy * vy) * mass + (w * w) * inertia) * 0.5)
    add(lane, totals, 1, load(lane, pose, POSE.x) * mass)
    add(lane, totals, 2, load(lane, pose, POSE.y) * mass)


@kernel
def passed(lane, lever, pose, totals):
    """pose <- that of a rigid end's far point; totals += kinetic energy and first moments on the way."""
    if lever is not None:
        _move(lane, lever.along * 0.5, None, pose)
        _body(lane, pose, lever.mass, lever.inertia, totals)
        _move(lane, lever.along * 0.5, None, pose)
        _body(lane, pose, lever.far, 0.0, totals)
