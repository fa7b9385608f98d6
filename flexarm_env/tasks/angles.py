"""Inverse kinematics: joint angles of an arm of straight links that bring its tip to a point (x, y), m.

Angles are written into `angles`, whose first N numbers are the joints' present ones, rad. limits (2 N,): low and high
of each joint. A target out of reach is approached along the line to it.

    sooner_angles    two links: of the two solutions the one that the joints come to sooner
    least_angles     N links: of all solutions the one of least sum of squares
    next_angles      N links: the one of least sum of squares that follows on the present angles

A least sum of squares of angles under the two conditions that the tip be at p makes each angle the moment, about its
joint, of one force f at the tip (f are Lagrange's multipliers): theta_k = (p - r_k) x f, or the limit that this is
beyond. The chain is an elastica of N springs. With f given, joints and tip follow from the root on; so there are but
two equations, tip(f) = p, in two unknowns, whatever N is (Newton's method, with steps halved where they do not help).
"""

import math

from ..compiler import kernel

_CLOSE = 1e-13
"""How far the tip may be from its target, over the arm's length."""

_ITERATIONS, _HALVINGS, _BISECTIONS, _SCAN = 60, 12, 60, 64

_EASY, _STEPS = 0.6, 24
"""A distance from the root, over the arm's length, where the arc is near the solution; steps from there."""


@kernel
def nearest_turn(angle, now):
    """The angle and as many whole turns that it is within half a turn of `now`."""
    return angle - 2.0 * math.pi * math.floor((angle - now) / (2.0 * math.pi) + 0.5)


@kernel
def sooner_angles(lengths, rates, limits, x, y, angles):
    """Two links. rates (2,): a joint takes a time for an angle a that goes as sqrt(|a|) / its rate."""
    a, b = lengths[0], lengths[1]
    cosine = (x * x + y * y - a * a - b * b) / (2.0 * a * b)
    bend = math.acos(min(1.0, max(-1.0, cosine)))
    bearing, inner = math.atan2(y, x), math.atan2(b * math.sin(bend), a + b * math.cos(bend))
    hub_now, elbow_now = angles[0], angles[1]
    least = math.inf
    for side in (1.0, -1.0):
        elbow, hub = side * bend, nearest_turn(bearing - side * inner, hub_now)
        way = max(abs(hub - hub_now) / rates[0] ** 2, abs(elbow - elbow_now) / rates[1] ** 2)
        if elbow < limits[2] or elbow > limits[3]:
            way += 1e6
        if way < least:
            least = way
            angles[0], angles[1] = hub, elbow


@kernel
def _bent(lengths, limits, x, y, fx, fy):
    """Tip of the chain that the force bends, (px, py), and its derivatives by fx and by fy; sum of squared angles."""
    alpha, alpha_x, alpha_y, total = 0.0, 0.0, 0.0, 0.0
    px, py, px_x, px_y, py_x, py_y = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(lengths.shape[0]):
        angle = (x - px) * fy - (y - py) * fx
        if angle < limits[2 * k] or angle > limits[2 * k + 1]:
            angle = min(limits[2 * k + 1], max(limits[2 * k], angle))
        else:
            alpha_x, alpha_y = alpha_x - px_x * fy + py_x * fx - (y - py), alpha_y - px_y * fy + py_y * fx + (x - px)
        alpha, total = alpha + angle, total + angle * angle
        along, across = lengths[k] * math.cos(alpha), lengths[k] * math.sin(alpha)
        px, px_x, px_y = px + along, px_x - across * alpha_x, px_y - across * alpha_y
        py, py_x, py_y = py + across, py_x + along * alpha_x, py_y + along * alpha_y
    return px, py, px_x, px_y, py_x, py_y, total


@kernel
def _force(lengths, limits, x, y, fx, fy):
    """(fx, fy, sum of squares) of the force that brings the tip to (x, y), from a guess; the sum is infinite where
    none is found."""
    length = 0.0
    for k in range(lengths.shape[0]):
        length += lengths[k]
    px, py, a, b, c, d, total = _bent(lengths, limits, x, y, fx, fy)
    off = math.hypot(px - x, py - y)
    for _ in range(_ITERATIONS):
        determinant = a * d - b * c
        if off <= _CLOSE * length or determinant == 0.0:
            break
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
    if not off <= 1e3 * _CLOSE * length:
        total = math.inf
    return fx, fy, total


@kernel
def _guess(lengths, x, y, angles):
    """The force whose moments about the joints are nearest to these angles (least squares)."""
    alpha, px, py = 0.0, 0.0, 0.0
    xx, xy, yy, gx, gy = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(lengths.shape[0]):
        u, v = -(y - py), x - px
        xx, xy, yy, gx, gy = xx + u * u, xy + u * v, yy + v * v, gx + u * angles[k], gy + v * angles[k]
        alpha += angles[k]
        px, py = px + lengths[k] * math.cos(alpha), py + lengths[k] * math.sin(alpha)
    determinant = xx * yy - xy * xy
    if determinant <= 1e-12 * xx * yy:
        return 0.0, 0.0
    return (yy * gx - xy * gy) / determinant, (xx * gy - xy * gx) / determinant


@kernel
def _take(lengths, limits, x, y, fx, fy, now, angles):
    """The joints' angles under a force; the hub's as many whole turns on as bring it near `now`, limits allowing."""
    alpha, px, py = 0.0, 0.0, 0.0
    for k in range(lengths.shape[0]):
        angle = min(limits[2 * k + 1], max(limits[2 * k], (x - px) * fy - (y - py) * fx))
        angles[k] = angle
        alpha += angle
        px, py = px + lengths[k] * math.cos(alpha), py + lengths[k] * math.sin(alpha)
    _turn_hub(limits, now, angles)


@kernel
def _turn_hub(limits, now, angles):
    hub = nearest_turn(angles[0], now)
    if limits[0] <= hub <= limits[1]:
        angles[0] = hub


@kernel
def _arc(lengths, bend):
    """Tip of the chain with its elbows all at one angle, its hub at 0."""
    px, py = 0.0, 0.0
    for k in range(lengths.shape[0]):
        px, py = px + lengths[k] * math.cos(k * bend), py + lengths[k] * math.sin(k * bend)
    return px, py


@kernel
def _arc_bend(lengths, distance):
    """The least angle of all elbows that brings the tip so near to the root, or as near as can be (rad)."""
    low, high, nearest, kept = 0.0, -1.0, math.inf, 0.0
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
    """(fx, fy, sum of squares) from the arc to a side; where that fails, from the arc to an easy point on the same
    bearing, which then goes to (x, y) step by step. `angles`: the first arc."""
    bearing, length, last = math.atan2(y, x), 0.0, _arc_bend(lengths, math.hypot(x, y))
    for k in range(lengths.shape[0]):
        length += lengths[k]
    for steps in (1, _STEPS):
        first = last if steps == 1 else _arc_bend(lengths, _EASY * length)
        _set_arc(lengths, limits, bearing, side * first, angles)
        px, py = _arc(lengths, first)
        way = math.hypot(px, py)
        fx, fy = _guess(lengths, way * math.cos(bearing), way * math.sin(bearing), angles)
        total = math.inf
        for step in range(1, steps + 1):
            px, py = _arc(lengths, first + (last - first) * step / steps)
            way = math.hypot(px, py) if step < steps else math.hypot(x, y)
            fx, fy, total = _force(lengths, limits, way * math.cos(bearing), way * math.sin(bearing), fx, fy)
        if total < math.inf:
            return fx, fy, total
    return fx, fy, math.inf


@kernel
def least_angles(lengths, limits, x, y, angles):
    """N links: the lesser of what the arcs (all elbows alike) to either side lead to; for targets within less than
    about 0.2 of the arm's length from the root there may be a lesser one. An arc where neither leads anywhere.
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
    px, py = _arc(lengths, bend)
    angles[0] = bearing - math.atan2(py, px)
    for k in range(1, lengths.shape[0]):
        angles[k] = min(limits[2 * k + 1], max(limits[2 * k], bend))
    angles[0] = nearest_turn(angles[0], 0.0)


@kernel
def next_angles(lengths, limits, x, y, angles):
    """N links: begun at the present angles; afresh where nothing is found near them."""
    now = angles[0]
    angles[0] = nearest_turn(now, 0.0)
    fx, fy = _guess(lengths, x, y, angles)
    fx, fy, total = _force(lengths, limits, x, y, fx, fy)
    angles[0] = now
    if total < math.inf:
        _take(lengths, limits, x, y, fx, fy, now, angles)
    else:
        least_angles(lengths, limits, x, y, angles)
