"""Levers in a chain of floating frames: rigid ends of links, between a joint and the link's first or last body, and
that from the tip to the payload's centre.

At the near point of a lever a section has an acceleration a (less gravity), an angle, its rate w and second rate; at
its far point, l e away, a + l (alpha n - w^2 e), n = E e. A force there is a moment here besides. A lever has
a mass in its middle, and an elbow's mass at its far point.
"""

from typing import Any, NamedTuple

from ...compiler import kernel, load, sincos, splat, store
from ..layout import LEVER, OF_LOAD, POSE
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
def reach(lane, along, across, pose, S, at):
    """pose <- that of the far point of a lever; what is known of it is kept at S[at:]."""
    sine, cosine = sincos(load(lane, pose, PASSED.angle))
    ex, ey = cosine * along, sine * along
    if across is not None:
        ex, ey = ex - sine * across, ey + cosine * across
    w, alpha = load(lane, pose, PASSED.rate), load(lane, pose, PASSED.second)
    ax, ay = load(lane, pose, PASSED.ax), load(lane, pose, PASSED.ay)
    store(S, at + OF_FACTORS.ex, ex)
    store(S, at + OF_FACTORS.ey, ey)
    store(S, at + OF_FACTORS.rate, w)
    store(S, at + OF_FACTORS.second, alpha)
    store(S, at + OF_FACTORS.ax, ax)
    store(S, at + OF_FACTORS.ay, ay)
    store(pose, PASSED.ax, ax - (alpha * ey + (w * w) * ex))
    store(pose, PASSED.ay, ay + (alpha * ex - (w * w) * ey))


@kernel
def outward(lane, lever, pose, S, first):
    """pose <- that of the far point; what is known of the lever is kept in S."""
    if lever is not None:
        reach(lane, lever.along, lever.across, pose, S, first + OF_FACTORS.end * lever.number)


@kernel
def resist(lane, mass, inertia, far, force, cm, cc, ck, S, at):
    """force <- force and moment that a lever and all behind it need at its near point, from those at its far point.

    cm, cc, ck: weights of M, C and K; where cm is not 0 the lever's part of the matrix is kept at S[at:].
    """
    ex, ey = load(lane, S, at + OF_FACTORS.ex), load(lane, S, at + OF_FACTORS.ey)
    w, alpha = load(lane, S, at + OF_FACTORS.rate), load(lane, S, at + OF_FACTORS.second)
    ax, ay = load(lane, S, at + OF_FACTORS.ax), load(lane, S, at + OF_FACTORS.ay)
    dx, dy = -(alpha * ey + (w * w) * ex), alpha * ex - (w * w) * ey
    fx = load(lane, force, OF_LOAD.x) + (ax + dx) * far
    fy = load(lane, force, OF_LOAD.y) + (ay + dy) * far
    mx, my = (ax + dx * 0.5) * mass, (ay + dy * 0.5) * mass
    moment = load(lane, force, OF_LOAD.torque) + (ex * fy - ey * fx) + (ex * my - ey * mx) * 0.5 + alpha * inertia
    store(force, OF_LOAD.x, fx + mx)
    store(force, OF_LOAD.y, fy + my)
    store(force, OF_LOAD.torque, moment)
    if cm != 0.0:
        store(S, at + OF_FACTORS.nx, -ey)
        store(S, at + OF_FACTORS.ny, ex)
        twice = w * (2.0 * cc)
        store(S, at + OF_FACTORS.wx, -(ey * cm) - ex * twice - dy * ck)
        store(S, at + OF_FACTORS.wy, ex * cm - ey * twice + dx * ck)
        pull = (ex * fx + ey * fy) + (ex * mx + ey * my) * 0.5
        store(S, at + OF_FACTORS.turn, inertia * cm - pull * ck)


@kernel
def inward(lane, lever, force, cm, cc, ck, S, first):
    """`resist` of a lever, where there is one."""
    if lever is not None:
        at = first + OF_FACTORS.end * lever.number
        resist(lane, lever.mass, lever.inertia, lever.far, force, cm, cc, ck, S, at)


@kernel
def _near(lane, mass, far, S, at, tail):
    nx, ny = load(lane, S, at + OF_FACTORS.nx), load(lane, S, at + OF_FACTORS.ny)
    wx, wy = load(lane, S, at + OF_FACTORS.wx), load(lane, S, at + OF_FACTORS.wy)
    for i in range(2):
        store(tail, cell(i, i), load(lane, tail, cell(i, i)) + far)
    for i in range(3):
        moved = load(lane, tail, cell(i, 0)) * wx + load(lane, tail, cell(i, 1)) * wy
        store(tail, cell(i, 2), load(lane, tail, cell(i, 2)) + moved)
    for j in range(3):
        moment = load(lane, tail, cell(0, j)) * nx + load(lane, tail, cell(1, j)) * ny
        store(tail, cell(2, j), load(lane, tail, cell(2, j)) + moment)
    half = splat(lane, 0.5 * mass)
    for i in range(2):
        store(tail, cell(i, i), load(lane, tail, cell(i, i)) + mass)
    store(tail, cell(0, 2), load(lane, tail, cell(0, 2)) + wx * half)
    store(tail, cell(1, 2), load(lane, tail, cell(1, 2)) + wy * half)
    store(tail, cell(2, 0), load(lane, tail, cell(2, 0)) + nx * half)
    store(tail, cell(2, 1), load(lane, tail, cell(2, 1)) + ny * half)
    turn = (nx * wx + ny * wy) * (half * 0.5) + load(lane, S, at + OF_FACTORS.turn)
    store(tail, cell(2, 2), load(lane, tail, cell(2, 2)) + turn)


@kernel
def near(lane, lever, S, first, tail):
    """tail <- the matrix of force and moment by acceleration and angle at the near point, from that at the far one."""
    if lever is not None:
        _near(lane, lever.mass, lever.far, S, first + OF_FACTORS.end * lever.number, tail)


@kernel
def with_moment(lane, lever, S, first, arm, flow):
    """flow <- that of the near point, where it is a force and a moment; arm: ACROSS, or SWEPT if transposed."""
    if lever is not None:
        at = first + OF_FACTORS.end * lever.number + arm
        moment = load(lane, S, at) * load(lane, flow, 0)
        moment = moment + load(lane, S, at + 1) * load(lane, flow, 1)
        store(flow, 2, load(lane, flow, 2) + moment)


@kernel
def swept(lane, lever, S, first, arm, flow):
    """flow <- that of the far point, where it is a change of acceleration and angle; arm: SWEPT, or ACROSS if
    transposed."""
    if lever is not None:
        at = first + OF_FACTORS.end * lever.number + arm
        turn = load(lane, flow, 2)
        store(flow, 0, load(lane, flow, 0) + load(lane, S, at) * turn)
        store(flow, 1, load(lane, flow, 1) + load(lane, S, at + 1) * turn)


@kernel
def move(lane, along, across, pose):
    sine, cosine = sincos(load(lane, pose, POSE.angle))
    ex, ey, w = cosine * along, sine * along, load(lane, pose, POSE.rate)
    if across is not None:
        ex, ey = ex - sine * across, ey + cosine * across
    store(pose, POSE.x, load(lane, pose, POSE.x) + ex)
    store(pose, POSE.y, load(lane, pose, POSE.y) + ey)
    store(pose, POSE.vx, load(lane, pose, POSE.vx) - w * ey)
    store(pose, POSE.vy, load(lane, pose, POSE.vy) + w * ex)


@kernel
def moved(lane, lever, pose):
    """pose (x, y, angle and rates) <- that of the far point."""
    if lever is not None:
        move(lane, lever.along, lever.across, pose)


@kernel
def _body(lane, pose, mass, inertia, totals):
    """totals (kinetic energy, first moments x, y) += those of a rigid body at a pose."""
    vx, vy, w = load(lane, pose, POSE.vx), load(lane, pose, POSE.vy), load(lane, pose, POSE.rate)
    kinetic = ((vx * vx + vy * vy) * mass + (w * w) * inertia) * 0.5
    store(totals, 0, load(lane, totals, 0) + kinetic)
    store(totals, 1, load(lane, totals, 1) + load(lane, pose, POSE.x) * mass)
    store(totals, 2, load(lane, totals, 2) + load(lane, pose, POSE.y) * mass)


@kernel
def passed(lane, lever, pose, totals):
    """pose <- that of a rigid end's far point; totals += kinetic energy and first moments on the way."""
    if lever is not None:
        move(lane, lever.along * 0.5, None, pose)
        _body(lane, pose, lever.mass, lever.inertia, totals)
        move(lane, lever.along * 0.5, None, pose)
        _body(lane, pose, lever.far, 0.0, totals)
