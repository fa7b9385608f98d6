"""Rigid levers in a chain of floating frames: rigid ends of links, and the offset from the tip to the payload's center.

A rigid end lies between a joint and the link's first or last body. The lever e = (ex, ey), in inertial axes, leads from
its near point (the end nearer to the arm's root) to its far point. The lever rotates with the section to which it is
fixed (angle, w, alpha). The far point's acceleration is a + alpha n - w^2 e, where a is the near point's acceleration
and n = E e is the lever rotated by 90 deg. A force f at the far point exerts the moment n.f on the near point. The
lever's own mass is at e/2, the mass of an elbow at the far point.
"""

from typing import Any, NamedTuple

from ...compiler import Lanes, kernel, sincos
from ..arithmetic import load_pair, load_vector, store_pair, store_vector
from ..layout import LEVER, POSE
from .layout import LEVER_FACTORS, PASSED, cell

OF_LEVER, OF_FACTORS = LEVER.places, LEVER_FACTORS.places
ROOT_END, TIP_END = range(2)
ACROSS, SWEPT = OF_FACTORS.nx, OF_FACTORS.wx
"""Indices in `LEVER_FACTORS` of two derivatives by the angle: of the far point's position and weighted acceleration."""


class Lever(NamedTuple):
    """A rigid lever: the rigid end of a link, or the lever from the arm's tip to the payload's center."""

    number: int  # index of the lever's `LEVER_FACTORS` in S
    along: float  # m: component of the lever, from near to far point, along the section's tangent
    across: Any  # m: component of the lever across the section's tangent, or None
    mass: float  # kg: mass in the middle of the lever
    inertia: float  # kg m^2: moment of inertia about the middle
    far: float  # kg: mass at the far point


@kernel
def end_of(model, k, end):
    """Return the `Lever` of link k's rigid end; end: ROOT_END or TIP_END. None if links have no rigid ends."""
    if model.rigid is None:
        return None
    at = OF_LEVER.end * (2 * k + end)
    mass, inertia = model.rigid[at + OF_LEVER.mass], model.rigid[at + OF_LEVER.inertia]
    return Lever(2 * k + end, model.rigid[at + OF_LEVER.length], None, mass, inertia, model.rigid[at + OF_LEVER.far])


@kernel
def to_payload(model):
    """Return the massless `Lever` from the tip to the payload's center; None if the payload's center is at the tip."""
    if model.eccentric is None:
        return None
    return Lever(2 * model.links, model.eccentric[0], model.eccentric[1], 0.0, 0.0, 0.0)


@kernel
def _factors_at(first, lever):
    """Return the index in S of a lever's `LEVER_FACTORS`; `first`: index of the first lever's `LEVER_FACTORS`."""
    return first + OF_FACTORS.end * lever.number


@kernel
def _lever_at(lane, along, across, angle):
    """Return the vector (along, across) in inertial axes, m; along, across: components in section axes.

    angle: angle of the section, rad. If across is None, it counts as 0.
    """
    sine, cosine = sincos(angle)
    ex, ey = cosine * along, sine * along
    if across is not None:
        ex, ey = ex - sine * across, ey + cosine * across
    return ex, ey


@kernel
def propagate_outward(lane, lever, pose, S, first):
    """Replace the near point's acceleration a in pose by the far point's acceleration a + alpha n - w^2 e of a lever.

    e: vector of the lever, m.
    n: lever rotated by 90 deg.
    w, alpha: angular velocity and acceleration of the section. If `lever` is None, do nothing.

    # in, out  pose (5,), `PASSED`: the acceleration is replaced, angle and rates do not change; inertial axes
    # out      S: ex, ey, rates and near acceleration in `LEVER_FACTORS`. first: index in S of the first `LEVER_FACTORS`
    """
    if lever is not None:
        at, (angle, w, alpha) = _factors_at(first, lever), load_vector(lane, pose, PASSED.angle)
        ex, ey = _lever_at(lane, lever.along, lever.across, angle)
        ax, ay = load_pair(lane, pose, PASSED.ax)
        store_pair(lane, S, at + OF_FACTORS.ex, (ex, ey))
        store_pair(lane, S, at + OF_FACTORS.rate, (w, alpha))
        store_pair(lane, S, at + OF_FACTORS.ax, (ax, ay))
        store_pair(lane, pose, PASSED.ax, (ax - (alpha * ey + (w * w) * ex), ay + (alpha * ex - (w * w) * ey)))


@kernel
def transmit_inward(lane, lever, force, weights, S: Lanes, first):
    """Transmit a force and a moment from a lever's far point to its near point, adding inertia forces of its masses.

        f_near = f + m_far a_far + m a_mid,   M_near = M + e x (f + m_far a_far) + (e/2) x m a_mid + J alpha

    e: lever, from near to far point.
    J: inertia of the lever's own mass m.
    alpha: angular acceleration.
    a_far, a_mid: accelerations minus gravity at e and e/2. Vectors are in inertial axes. If `lever` is None, do
    nothing.

    # in       S: values of `propagate_outward`. weights: `Weights`. first: index in S of the first `LEVER_FACTORS`
    # in, out  force (3,): force (N) and moment (N m) required at the far point, then at the near point
    # out      S, with weights.with_matrix: n, weighted change of the far acceleration, and `turn`, of `LEVER_FACTORS`

    See docs/theory.md, section 5, "Rigid ends".
    """
    if lever is not None:
        at = _factors_at(first, lever)
        ex, ey = load_pair(lane, S, at + OF_FACTORS.ex)
        w, alpha = load_pair(lane, S, at + OF_FACTORS.rate)
        ax, ay = load_pair(lane, S, at + OF_FACTORS.ax)
        # acceleration of the far point relative to the near one: alpha n - w^2 e
        dx, dy = -(alpha * ey + (w * w) * ex), alpha * ex - (w * w) * ey
        fx, fy, moment = load_vector(lane, force, 0)
        # force at the far point with its mass; inertia force of the lever's own mass at half the way
        fx, fy = fx + (ax + dx) * lever.far, fy + (ay + dy) * lever.far
        mx, my = (ax + dx * 0.5) * lever.mass, (ay + dy * 0.5) * lever.mass
        moment = moment + (ex * fy - ey * fx) + (ex * my - ey * mx) * 0.5 + alpha * lever.inertia
        store_vector(lane, force, 0, (fx + mx, fy + my, moment))
        if weights.with_matrix:
            cm, cc, ck = weights.mass, weights.damping, weights.stiffness
            # weighted derivatives by the angle: n, cm n - 2 cc w e + ck E (alpha n - w^2 e), and cm J - ck (e.f +
            # e.f_mid / 2)
            twice, pull = w * (2.0 * cc), (ex * fx + ey * fy) + (ex * mx + ey * my) * 0.5
            store_pair(lane, S, at + OF_FACTORS.nx, (-ey, ex))
            store_pair(lane, S, at + OF_FACTORS.wx, (-(ey * cm) - ex * twice - dy * ck, ex * cm - ey * twice + dx * ck))
            S[at + OF_FACTORS.turn] = lever.inertia * cm - pull * ck


@kernel
def condense_to_near_point(lane, lever, S: Lanes, first, tail: Lanes):
    """Transform the matrix `tail` of force and moment by acceleration and angle from a lever's far to its near point.

        tail <- N' (tail + m_far) W + own mass at e/2,   N = [1, 0, nx; 0, 1, ny; 0, 0, 1], W: with (wx, wy)

    (nx, ny): derivative of the far point by the angle. (wx, wy): derivative of its acceleration by the angle, weighted
    by cm, cc, ck (`Weights`).
    e: vector of the lever, m.
    m_far: mass at the far point. If `lever` is None, do nothing. Vectors are in inertial axes.

    # in       S: `LEVER_FACTORS`, written by `transmit_inward`. first: index in S of the first `LEVER_FACTORS`
    # in, out  tail (9,), by rows: force x, y, moment; columns: acceleration x, y (weighted), angle

    See docs/theory.md, section 5, "Rigid ends".
    """
    if lever is not None:
        at, mass = _factors_at(first, lever), lever.mass
        nx, ny = load_pair(lane, S, at + OF_FACTORS.nx)
        wx, wy = load_pair(lane, S, at + OF_FACTORS.wx)
        # S_xx, S_yy += m of the far point (unknown: R'', hence without c_m)
        for i in range(2):
            tail[cell(i, i)] += lever.far
        # far acceleration = near acceleration + w times the angle: columns; moment += n.f: rows
        for i in range(3):
            tail[cell(i, 2)] += tail[cell(i, 0)] * wx + tail[cell(i, 1)] * wy
        for j in range(3):
            tail[cell(2, j)] += tail[cell(0, j)] * nx + tail[cell(1, j)] * ny
        # mass in the middle: n/2 in place of n, hence m/4 in theta-theta; -(e . f) at constant f
        half = 0.5 * mass
        for i in range(2):
            tail[cell(i, i)] += mass
        tail[cell(0, 2)] += wx * half
        tail[cell(1, 2)] += wy * half
        tail[cell(2, 0)] += nx * half
        tail[cell(2, 1)] += ny * half
        tail[cell(2, 2)] += (nx * wx + ny * wy) * (half * 0.5) + S[at + OF_FACTORS.turn]


@kernel
def with_moment(lane, lever, S, first, arm, flow: Lanes):
    """Transmit a force f and a moment, `flow` (3,), from a lever's far point to its near point: moment += n.f.

    n: derivative of the far point's position by the section's angle, inertial axes. If `lever` is None, do nothing.
    arm: ACROSS selects n. SWEPT is for the transposed matrix, in which n is exchanged for the derivative of the far
    point's acceleration by the angle, weighted by the Newton matrix's weights cm, cc, ck (`transmit_inward`).
    first: index in S of the first `LEVER_FACTORS`.
    """
    if lever is not None:
        x, y = load_pair(lane, S, _factors_at(first, lever) + arm)
        flow[2] += x * flow[0] + y * flow[1]


@kernel
def far_point_change(lane, lever, S, first, arm, flow: Lanes):
    """Propagate a weighted change of acceleration and angle, `flow` (3,), from a lever's near point to its far point.

        (x, y) += angle times the derivative of the far point's weighted acceleration by the angle

    Vectors are in inertial axes.
    arm: SWEPT selects this derivative. ACROSS (n) is for solutions with the transposed matrix.
    first: index in S of the first `LEVER_FACTORS`. If `lever` is None, do nothing.
    """
    if lever is not None:
        x, y = load_pair(lane, S, _factors_at(first, lever) + arm)
        turn = flow[2]
        flow[0] += x * turn
        flow[1] += y * turn


@kernel
def _move_pose(lane, along, across, pose: Lanes):
    """Move a pose by a lever that rotates with the section of the pose.

    along, across: components of the lever (m) in section axes; across may be None (0).

    pose (6,) is a `POSE` from x to rate, inertial axes. Position (m) and velocity (m/s) change; angle and rate do not.
    """
    w = pose[POSE.rate]
    ex, ey = _lever_at(lane, along, across, pose[POSE.angle])
    pose[POSE.x] += ex
    pose[POSE.y] += ey
    pose[POSE.vx] -= w * ey
    pose[POSE.vy] += w * ex


@kernel
def far_point_pose(lane, lever, pose):
    """Move a pose (6,), inertial axes, from a lever's near point to its far point. If `lever` is None, do nothing."""
    if lever is not None:
        _move_pose(lane, lever.along, lever.across, pose)


@kernel
def _body(lane, pose: Lanes, mass, inertia, totals: Lanes):
    """Add a rigid body's kinetic energy (J) and first moments m x, m y (kg m) to totals (3,); pose: of its center."""
    vx, vy, w = load_vector(lane, pose, POSE.vx)
    totals[0] += ((vx * vx + vy * vy) * mass + (w * w) * inertia) * 0.5
    totals[1] += pose[POSE.x] * mass
    totals[2] += pose[POSE.y] * mass


@kernel
def add_rigid_end(lane, lever, pose, totals):
    """Move a pose (6,) from a rigid end's near to its far point; add the energy and first moments of its masses.

    totals (3,): kinetic energy (J) and first moments m x, m y (kg m, inertial axes). If `lever` is None, do nothing.
    """
    if lever is not None:
        _move_pose(lane, lever.along * 0.5, None, pose)
        _body(lane, pose, lever.mass, lever.inertia, totals)
        _move_pose(lane, lever.along * 0.5, None, pose)
        _body(lane, pose, lever.far, 0.0, totals)
