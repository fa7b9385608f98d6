"""Inverse kinematics in the plane: compute joint angles of straight links that bring the tip to a point (x, y), m.

The array `angles` contains N joint angles, rad: the present angles before a call, the computed angles after it.
limits (2 N,): lower and upper limit of each joint, rad. If a target is out of reach, the tip is moved to the line from
the root to the target.

    sooner_angles    two links: the one of two solutions that the joints reach first
    least_angles     N links: the solution with the least sum of squared angles
    next_angles      N links: the solution with the least sum of squared angles near the present angles

The solution with the least sum of squares is the static shape of N rigid links with equal springs at the joints, when a
force f at the tip holds the tip at p. With joint k at r_k, each angle is the moment of this force: theta_k =
(p - r_k) x f, set to the joint limit if it is beyond the limit. For a given f, all angles follow from the root outward.
The two components of f are therefore the only unknowns, with the two equations tip(f) = p. Newton's method solves them;
a step that does not reduce the error is halved.
"""

import math

from ..compiler import kernel

_CLOSE = 1e-13
"""Largest accepted distance of the tip from its target, divided by the arm's length."""

_ITERATIONS, _HALVINGS, _BISECTIONS, _SCAN = 60, 12, 60, 64

_EASY, _STEPS = 0.6, 24
"""Distance of the target from the root, divided by the arm's length, at which the arc is near the solution, and number
of continuation
steps from that distance."""


@kernel
def nearest_turn(angle, now):
    """Return `angle` plus the multiple of 2 pi with which the sum is nearest to `now`, rad."""
    return angle - 2.0 * math.pi * math.floor((angle - now) / (2.0 * math.pi) + 0.5)


@kernel
def _within(hub, limits):
    """Return the hub's angle (rad), moved within limits[0] to limits[1] by whole turns if this is possible.

    hub: angle of joint 0, rad. The angle is returned unchanged if no whole turns bring it within the limits.
    """
    found = hub
    if hub < limits[0]:
        found = nearest_turn(hub, limits[0] + math.pi)
    elif hub > limits[1]:
        found = nearest_turn(hub, limits[1] - math.pi)
    if found < limits[0] or found > limits[1]:
        found = hub
    return found


@kernel
def sooner_angles(lengths, rates, limits, x, y, angles):
    """Write the joint angles of two links with the tip at (x, y), m, for the solution that the joints reach first.

    The two solutions have the elbow bent to opposite sides. The time in which a joint turns by the angle a is assumed
    to be proportional to sqrt(|a|) / rate (rates (2,): joint rates, rad/s); the slower joint determines the time of a
    solution. A solution beyond the joint limits is chosen only if both are. lengths (2,): link lengths, m. limits (4,):
    lower and upper limit of each joint, rad. angles (2,): joint angles, rad, present ones before, computed ones after
    the call.
    """
    a, b = lengths[0], lengths[1]
    # cos(bend) = (r^2 - a^2 - b^2) / 2ab, clamped where the target is out of reach; bearing of the target
    cosine = (x * x + y * y - a * a - b * b) / (2.0 * a * b)
    bend = math.acos(min(1.0, max(-1.0, cosine)))
    bearing, inner = math.atan2(y, x), math.atan2(b * math.sin(bend), a + b * math.cos(bend))
    hub_now, elbow_now = angles[0], angles[1]
    least = math.inf
    for side in (1.0, -1.0):
        # max_k (dtheta_k / rate_k^2): squared time of the slower joint, up to a factor
        elbow, hub = side * bend, _within(nearest_turn(bearing - side * inner, hub_now), limits)
        way = max(abs(hub - hub_now) / (rates[0] * rates[0]), abs(elbow - elbow_now) / (rates[1] * rates[1]))
        if elbow < limits[2] or elbow > limits[3] or hub < limits[0] or hub > limits[1]:
            way += 1e6
        if way < least:
            least = way
            angles[0], angles[1] = hub, elbow


@kernel
def _bent(lengths, limits, x, y, fx, fy):
    """Return the tip of a chain of springs bent by a force at (x, y), its derivatives, and the angles' sum of squares.

        theta_k = (x - px_k) fy - (y - py_k) fx, clamped to the joint's limits; (px_k, py_k): position of joint k

    The angle of each joint is the moment of the force (fx, fy) about the joint, so that the unit of the force is rad/m.
    lengths (N,): lengths of the links, m; limits (2 N,): lower and upper limit of each joint, rad. Returns (px, py,
    dpx/dfx, dpx/dfy, dpy/dfx, dpy/dfy, sum theta_k^2): tip position p, m, its derivatives by the force, and the sum of
    the squared joint angles, rad^2.
    """
    alpha, alpha_x, alpha_y, total = 0.0, 0.0, 0.0, 0.0
    px, py, px_x, px_y, py_x, py_y = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(lengths.shape[0]):
        angle = (x - px) * fy - (y - py) * fx
        # a joint on its limit does not change with the force
        if angle < limits[2 * k] or angle > limits[2 * k + 1]:
            angle = min(limits[2 * k + 1], max(limits[2 * k], angle))
        else:
            alpha_x, alpha_y = alpha_x - px_x * fy + py_x * fx - (y - py), alpha_y - px_y * fy + py_y * fx + (x - px)
        # inertial angle of link k, then its tip
        alpha, total = alpha + angle, total + angle * angle
        along, across = lengths[k] * math.cos(alpha), lengths[k] * math.sin(alpha)
        px, px_x, px_y = px + along, px_x - across * alpha_x, px_y - across * alpha_y
        py, py_x, py_y = py + across, py_x + along * alpha_x, py_y + along * alpha_y
    return px, py, px_x, px_y, py_x, py_y, total


@kernel
def _force(lengths, limits, x, y, fx, fy):
    """Return (fx, fy, sum of squared angles) of the force that bends a chain of springs to (x, y), from a guess.

    Newton's method with damped steps solves tip(f) = (x, y); each joint's angle is the force's moment about the joint.
    lengths (N,): lengths of the links, m; x, y: target, m; limits (2 N,): lower and upper limit of each joint, rad; fx,
    fy: the guess, rad/m. The returned sum is inf if no solution is found.
    """
    length = 0.0
    for k in range(lengths.shape[0]):
        length += lengths[k]
    px, py, a, b, c, d, total = _bent(lengths, limits, x, y, fx, fy)
    off = math.hypot(px - x, py - y)
    for _ in range(_ITERATIONS):
        determinant = a * d - b * c
        if off <= _CLOSE * length or determinant == 0.0:
            break
        # Newton step by the 2 x 2 Jacobian of (x, y) by the force, halved until the tip comes nearer
        step_x, step_y = (d * (x - px) - b * (y - py)) / determinant, (a * (y - py) - c * (x - px)) / determinant
        share, better, next_x, next_y, now = 1.0, False, fx, fy, off
        for _ in range(_HALVINGS):
            next_x, next_y = fx + share * step_x, fy + share * step_y
            px, py, a, b, c, d, total = _bent(lengths, limits, x, y, next_x, next_y)
            now = math.hypot(px - x, py - y)
            if now < off:
                better = True
                break
            share *= 0.5
        if not better:
            break
        fx, fy, off = next_x, next_y, now
    # accepted within 1e3 times the tolerance: there, halved steps come no nearer, by round-off
    if not off <= 1e3 * _CLOSE * length:
        total = math.inf
    return fx, fy, total


@kernel
def _guess(lengths, x, y, angles):
    """Return the force (rad/m) at (x, y) whose moments about the joints best fit `angles`, by least squares.

    lengths (N,): lengths of the links, m; x, y: point, m; angles (N,): joint angles, rad. Returns (0, 0) if the joints
    and the point lie on a line.
    """
    alpha, px, py = 0.0, 0.0, 0.0
    xx, xy, yy, gx, gy = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(lengths.shape[0]):
        # normal equations of theta_k = u fx + v fy
        u, v = -(y - py), x - px
        xx, xy, yy, gx, gy = xx + u * u, xy + u * v, yy + v * v, gx + u * angles[k], gy + v * angles[k]
        alpha += angles[k]
        px, py = px + lengths[k] * math.cos(alpha), py + lengths[k] * math.sin(alpha)
    determinant = xx * yy - xy * xy
    # determinant 0: joints and point in a line, where moments of f are not independent
    if determinant <= 1e-12 * xx * yy:
        return 0.0, 0.0
    return (yy * gx - xy * gy) / determinant, (xx * gy - xy * gx) / determinant


@kernel
def _take(lengths, limits, x, y, fx, fy, now, angles):
    """Write the joint angles of the chain bent by a force (rad/m) at (x, y), m: the force's moments about the joints.

    Whole turns bring the hub's angle near `now` (rad) if its limits allow. limits (2 N,): lower and upper limit of each
    joint, rad. angles (N,): out.
    """
    alpha, px, py = 0.0, 0.0, 0.0
    for k in range(lengths.shape[0]):
        angle = min(limits[2 * k + 1], max(limits[2 * k], (x - px) * fy - (y - py) * fx))
        angles[k] = angle
        alpha += angle
        px, py = px + lengths[k] * math.cos(alpha), py + lengths[k] * math.sin(alpha)
    _turn_hub(limits, now, angles)


@kernel
def _turn_hub(limits, now, angles):
    """Add whole turns to the hub angle angles[0] so that it is near `now` (rad), unless its limits forbid this.

    limits[0], limits[1]: lower and upper limit of the hub angle, rad.
    """
    hub = _within(nearest_turn(angles[0], now), limits)
    if limits[0] <= hub <= limits[1]:
        angles[0] = hub


@kernel
def _arc(lengths, bend):
    """Return the tip (px, py), m, of the chain with the hub at angle 0 and all elbows at `bend`, rad.

    lengths (N,): lengths of the straight links, m.
    """
    px, py = 0.0, 0.0
    for k in range(lengths.shape[0]):
        px, py = px + lengths[k] * math.cos(k * bend), py + lengths[k] * math.sin(k * bend)
    return px, py


@kernel
def _arc_bend(lengths, distance):
    """Return the common angle (rad) of all elbows at which the tip is `distance` (m) from the root, or nearest to that.

    lengths (N,): lengths of the straight links, m. Of several angles the smallest is returned.
    """
    low, high, nearest, kept = 0.0, -1.0, math.inf, 0.0
    # coarse scan: |arc tip| - distance may have several zeros, and the first one bends least
    for j in range(_SCAN + 1):
        bend = math.pi * j / _SCAN
        px, py = _arc(lengths, bend)
        off = math.hypot(px, py) - distance
        if abs(off) < nearest:
            nearest, kept = abs(off), bend
        if off <= 0.0:
            high = bend
            break
        low = bend
    if high <= 0.0:
        return kept
    # bisection of |arc tip| - distance, positive at `low`, negative at `high`
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        px, py = _arc(lengths, middle)
        if math.hypot(px, py) > distance:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


@kernel
def _from_arc(lengths, limits, x, y, side, angles):
    """Compute the force that bends the chain to (x, y), m, from an arc: (fx, fy, sum of squared angles).

    An arc has the same angle at all elbows; side: the sign of this angle, 1 or -1. fx, fy: force (rad/m) at (x, y)
    whose moments about the joints are the joint angles. The sum is inf without a solution. Newton's method starts from
    the arc to (x, y). If this fails, a second attempt starts from the arc to an easy point on the same bearing, and the
    point then moves to (x, y) in steps. The array `angles` receives the joint angles of the last arc from which the
    search started.
    """
    bearing, length, last = math.atan2(y, x), 0.0, _arc_bend(lengths, math.hypot(x, y))
    for k in range(lengths.shape[0]):
        length += lengths[k]
    for steps in (1, _STEPS):
        first = last if steps == 1 else _arc_bend(lengths, _EASY * length)
        _set_arc(lengths, limits, bearing, side * first, angles)
        # force whose moments are nearest to the arc's angles
        px, py = _arc(lengths, first)
        way = math.hypot(px, py)
        fx, fy = _guess(lengths, way * math.cos(bearing), way * math.sin(bearing), angles)
        total = math.inf
        for step in range(1, steps + 1):
            # next point on the bearing, of an arc between both bends; the last is (x, y)
            px, py = _arc(lengths, first + (last - first) * step / steps)
            way = math.hypot(px, py) if step < steps else math.hypot(x, y)
            fx, fy, total = _force(lengths, limits, way * math.cos(bearing), way * math.sin(bearing), fx, fy)
        if total < math.inf:
            return fx, fy, total
    return fx, fy, math.inf


@kernel
def least_angles(lengths, limits, x, y, angles):
    """Write the joint angles of N links that bring the tip to (x, y), m, with the least sum of squares.

    Newton's method starts from two arcs (equal angles at all elbows), bent to either side, and the solution with the
    smaller sum is written. For targets within about 0.2 arm lengths of the root a solution with a still smaller sum may
    exist. If neither start leads to a solution, the angles of an arc are written. lengths (N,): link lengths, m. limits
    (2 N,): lower and upper limit of each joint, rad. angles (N,): joint angles, rad, written; before the call only the
    hub's angle angles[0] is read, to which multiples of 2 pi bring the new hub angle near.
    """
    now, least, least_x, least_y = angles[0], math.inf, 0.0, 0.0
    for side in (1.0, -1.0):
        fx, fy, total = _from_arc(lengths, limits, x, y, side, angles)
        if total < least:
            least, least_x, least_y = total, fx, fy
    if least < math.inf:
        _take(lengths, limits, x, y, least_x, least_y, now, angles)
    else:
        bearing = math.atan2(y, x)
        side = -1.0 if bearing < 0.0 else 1.0
        _set_arc(lengths, limits, bearing, side * _arc_bend(lengths, math.hypot(x, y)), angles)
        _turn_hub(limits, now, angles)


@kernel
def _set_arc(lengths, limits, bearing, bend, angles):
    """Write the joint angles of an arc with its tip at `bearing` (rad): elbows at `bend`, within their limits.

    bend: angle of all elbows, rad. lengths (N,): lengths of the links, m; limits (2 N,): lower and upper limit of each
    joint, rad. angles (N,): joint angles, rad, written.
    """
    # the hub turns the unclamped arc's tip to the bearing
    px, py = _arc(lengths, bend)
    angles[0] = bearing - math.atan2(py, px)
    for k in range(1, lengths.shape[0]):
        angles[k] = min(limits[2 * k + 1], max(limits[2 * k], bend))
    angles[0] = nearest_turn(angles[0], 0.0)


@kernel
def next_angles(lengths, limits, x, y, angles):
    """Write the joint angles of N links with the least sum of squares near the present angles, tip at (x, y), m.

    If no solution is found near the present angles, `least_angles` is used. lengths (N,): link lengths, m. limits (2
    N,): lower and upper limit of each joint, rad. angles (N,): joint angles, rad: the present angles at entry, the
    resulting angles at return.
    """
    now = angles[0]
    # f from the present angles: the force (rad/m) whose moments about the joints are nearest to them
    angles[0] = nearest_turn(now, 0.0)
    fx, fy = _guess(lengths, x, y, angles)
    fx, fy, total = _force(lengths, limits, x, y, fx, fy)
    angles[0] = now
    if total < math.inf:
        _take(lengths, limits, x, y, fx, fy, now, angles)
    else:
        least_angles(lengths, limits, x, y, angles)
