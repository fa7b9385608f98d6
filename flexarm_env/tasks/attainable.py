"""Test whether an arm can reach a random target within its joint limits and hold it with its motors."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..compiler import kernel, size, stack
from ..physics.space.rotations import (
    Matrix,
    Vector,
    cross,
    dot,
    matrix,
    quaternion,
)
from .angles import nearest_turn
from .program import GOAL, MOVING, TARGET
from .space_angles import JOINT, rows_of
from .stream import draw
from .task import aim, draw_line, draw_path, path_at, pursue

_AT = JOINT.places
_TO = MOVING.places
_ONE, _RECORD, _PLACE, _DRAWN = (0,), (0,) * GOAL, (0,) * _TO.end, (0,) * 7
_INSTANTS = 32
_POINTS = (0,) * (2 * _INSTANTS)
"""Two zeros for each of the `_INSTANTS` instants of an episode at which a path is checked."""
_CLOSE = 1e-9
"""Largest accepted distance of a posture's tip from its target, divided by the arm's length, and of an angle beyond its
limit, rad."""

MOST_DRAWS = 10_000
"""Largest number of draws of a target; the last draw is kept. (Environments with fewer hits are rejected.)"""


class Attainable(NamedTuple):
    """Conditions that a random target must satisfy, for N links in D = 2 or 3 dimensions."""

    bodies: np.ndarray  # (2 N,) moments of mass of each link, kg m; in space (4 N,) mass, kg, and center of mass, m
    gravity: np.ndarray  # (D,) acceleration of gravity, m/s^2
    torques: np.ndarray  # (N,) largest torque of each joint, N m
    chain: np.ndarray | None  # in space, the arm's kinematics: one `space_angles.JOINT` record per joint


@kernel
def attainable(task, needs, angles, x, y):
    """Return 1.0 if a planar arm can reach the target (x, y) and rest there, otherwise 0.0.

    The checked posture is the task's goal posture from joint angles `angles` (rad). The posture's joint angles must be
    within the joint limits, and its tip must be at (x, y), m; for a target angle, rad, the tip is not checked. No joint
    torque against gravity may exceed the joint's largest torque. needs: an `Attainable`, with masses, gravity and
    largest torques.
    """
    mine = stack(_ONE, task.links + _RECORD)
    mine[TARGET], mine[TARGET + 1] = x, y
    for k in range(size(task.links)):
        mine[GOAL + k] = angles[k]
    # goal posture; an angle that counts modulo whole turns is moved to the middle of its limits, so that it passes if
    # any turn does
    aim(task, mine)
    return _allowed(task, needs, mine)


@kernel
def first_unattainable(task, needs, angles, points):
    """Return the index of the first point of a path that the arm cannot reach, or -1 if it can reach all points.

    A point cannot be reached if the posture there does not reach the target, is beyond joint limits, or needs more than
    the largest torques against gravity. points: two numbers per point: x and y, m, or an angle, rad, and an unused
    number. angles: joint angles before the first point, rad, from which `pursue` moves the posture from point to point.
    needs: an `Attainable`, which contains masses, gravity and largest torques.
    """
    mine = stack(_ONE, task.links + _RECORD)
    for k in range(size(task.links)):
        mine[GOAL + k] = angles[k]
    for j in range(points.shape[0] // 2):
        mine[TARGET], mine[TARGET + 1] = points[2 * j], points[2 * j + 1]
        # theta of the first point from anywhere; later ones follow continuously, as the goal does in an episode
        if j == 0:
            aim(task, mine)
        else:
            pursue(task, mine)
        if _allowed(task, needs, mine) < 0.5:
            return j
    return -1


@kernel
def _allowed(task, needs, mine):
    """Return 1.0 if a posture reaches its target within the joint limits and the motors can hold it, otherwise 0.0.

    mine: record of one arm. Its field `goal` contains the posture's joint angles, rad; its field `target` contains the
    target point, m, or an angle that needs no check. If task.turns is not None, the hub's angle is first moved by whole
    turns to the middle of its limits. needs.bodies: mass moment along and across each link, kg m, with all masses
    beyond the link at its far joint; needs.gravity: m/s^2; needs.torques: largest joint torques, N m.
    """
    n, limits, x, y = size(task.links), task.joint_limits, mine[TARGET], mine[TARGET + 1]
    if task.turns is not None and limits[0] > -math.inf and limits[1] < math.inf:
        mine[GOAL] = nearest_turn(mine[GOAL], 0.5 * (limits[0] + limits[1]))
    good, alpha, px, py = 1.0, 0.0, 0.0, 0.0
    # theta_k within limits; (p_x, p_y): tip of the straight links (inertial axes)
    for k in range(n):
        angle = mine[GOAL + k]
        if not (limits[2 * k] - _CLOSE <= angle <= limits[2 * k + 1] + _CLOSE):
            good = 0.0
        alpha += angle
        px, py = px + task.lengths[k] * math.cos(alpha), py + task.lengths[k] * math.sin(alpha)
    if size(task.targets) > 1 and not math.hypot(px - x, py - y) <= _CLOSE * task.length:
        good = 0.0
    # tau_k = g_x S_y - g_y S_x (N m), S: first moment (inertial axes) of all links from k on, straight; from the tip
    # inward
    torque = 0.0
    for j in range(n):
        k = n - 1 - j
        c, s, along, across = math.cos(alpha), math.sin(alpha), needs.bodies[2 * k], needs.bodies[2 * k + 1]
        moment_x, moment_y = along * c - across * s, along * s + across * c
        torque = torque - (needs.gravity[1] * moment_x - needs.gravity[0] * moment_y)
        if not abs(torque) <= needs.torques[k]:
            good = 0.0
        alpha -= mine[GOAL + k]
    return good


@kernel
def draw_attainable(reference, task, stream, arm, angles, path, most):
    """Draw random paths until the arm can follow one; return 1.0, or 0.0 if it can follow none of `most` paths.

    In the latter case the last path stays in `path`. reference.ranges: lower and upper bound of each random number.
    reference.line: a tag for straight lines, None for circles. reference.needs: an `Attainable`, or None to accept the
    first path.
    # in        angles: joint angles at the start, rad; arm: index of the arm in the batch
    # in, out   stream[arm]
    # out       path: a `PATH`
    """
    drawn = stack(_ONE, _DRAWN)
    for _ in range(most):
        for k in range(reference.ranges.shape[0] // 2):
            drawn[k] = draw(stream, arm, reference.ranges, k)
        for k in range(path.shape[0]):
            path[k] = 0.0
        if reference.line is not None:
            draw_line(task, stream, arm, angles[0], drawn, path)
        else:
            draw_path(task, stream, arm, angles[0], drawn, path)
        # needs None: the first draw counts, so that the stream consumes a fixed number of draws
        if reference.needs is None:
            return 1.0
        if _can_follow(reference, task, angles, drawn, path):
            return 1.0
    return 0.0


@kernel
def _can_follow(reference, task, angles, drawn, path):
    """Return whether an arm with joint angles `angles` (rad) can follow a drawn path for the whole episode.

    A target on a straight line finally leaves the arm's reach. Only the line's point nearest to the root must be
    reached, at the time t = drawn[1] (s). path: parameters of the target's path, a `PATH` record; drawn: the numbers
    from which it was made. reference.lasting: duration of an episode, s.
    """
    points, out = stack(_ONE, _POINTS), stack(_ONE, _PLACE)
    for j in range(_INSTANTS):
        # t = 0 ... T at even instants; a line is followed up to its nearest point alone
        t = reference.lasting * (j / (_INSTANTS - 1.0))
        if reference.line is not None:
            t = drawn[1]
        path_at(task, path, t, out)
        points[2 * j], points[2 * j + 1] = out[_TO.x], out[_TO.y]
    return first_unattainable(task, reference.needs, angles, points) < 0


@kernel
def held_in_space(needs, links, angles):
    """Return 1.0 if the rigid arm in space can rest at `angles` without exceeding a joint's largest torque, else 0.0.

    links: tuple of N zeros. angles (N,): joint angles, rad. Gravity is the only load. needs: an `Attainable` with
    gravity (m/s^2, inertial axes), torques (N m, the largest), chain (a `JOINT` per joint) and bodies: mass (kg) and
    center of mass (m, link axes) of each link.
    """
    lines, torques = stack(_ONE, links + links + links + links + links + links), stack(_ONE, links)
    g = Vector(needs.gravity[0], needs.gravity[1], needs.gravity[2])
    A, r = Matrix(Vector(1.0, 0.0, 0.0), Vector(0.0, 1.0, 0.0), Vector(0.0, 0.0, 1.0)), Vector(0.0, 0.0, 0.0)
    for k in range(size(links)):
        # axes A and root r of link k, inertial; joint axis and place are stored as a line
        o, torques[k] = _AT.end * k, 0.0
        axis = Vector(needs.chain[o + _AT.axis], needs.chain[o + _AT.axis + 1], needs.chain[o + _AT.axis + 2])
        angle = nearest_turn(angles[k], 0.0)
        A = A @ rows_of(needs.chain, o) @ matrix(quaternion(angle * axis))
        turn = A @ axis
        for d in range(3):
            lines[6 * k + d], lines[6 * k + 3 + d] = r[d], turn[d]
        # moment of link k's weight about each joint axis before it
        centre = Vector(needs.bodies[4 * k + 1], needs.bodies[4 * k + 2], needs.bodies[4 * k + 3])
        place, weight = r + A @ centre, needs.bodies[4 * k] * g
        for j in range(k + 1):
            lever = place - Vector(lines[6 * j], lines[6 * j + 1], lines[6 * j + 2])
            torques[j] = (
                torques[j] - dot(cross(Vector(lines[6 * j + 3], lines[6 * j + 4], lines[6 * j + 5]), lever), weight)
            )
        span = needs.chain[o + _AT.span]
        r = r + Vector(A[0][0] * span, A[1][0] * span, A[2][0] * span)
    good = 1.0
    for k in range(size(links)):
        if not abs(torques[k]) <= needs.torques[k]:
            good = 0.0
    return good
