"""Inverse kinematics in space: joint angles of the rigid arm that bring its tip to a point, by damped least squares.

`chain` is the arm's kinematics: one `JOINT` record per joint. The resulting joint angles (rad) replace the present
ones; limits (2 N,) are the lower and upper limit of each joint. If a point is out of reach, the tip approaches it.
"""

import math

from ..compiler import kernel, size, stack
from ..layout import Field, Layout
from ..physics.space.rotations import (
    Matrix,
    Vector,
    cross,
    dot,
    matrix,
    outer,
    plus_identity,
    quaternion,
)

JOINT = Layout(
    "ChainJoint", "",
    Field("mount", (9,), "", "rotation from the link's root axes at joint angle 0 to the preceding tip, by rows"),
    Field("axis", (3,), "", "unit vector of the joint's axis, in the axes of the link's root"),
    Field("span", (), "m", "length of the link, along x of its root axes"),
)  # fmt: skip
"""Kinematics of a joint and the link beyond it."""

_AT = JOINT.places
_ONE, _FARTHEST = (0,), 0.5
_FOLLOWED, _SOUGHT = 4, 60
"""Number of iterations for a point that has moved a little, and for a point anywhere."""
_SIDE = 0.8
"""rad: joint angles of the two bent postures from which a failed search is repeated."""


@kernel
def rows_of(table, k):
    """Return the 3 x 3 matrix stored by rows at table[k:k + 9]."""
    return Matrix(
        Vector(table[k], table[k + 1], table[k + 2]),
        Vector(table[k + 3], table[k + 4], table[k + 5]),
        Vector(table[k + 6], table[k + 7], table[k + 8]),
    )


@kernel
def _stretched(chain, links, angles, lines):
    """Return the tip of the rigid arm (m, inertial axes); write position (m) and axis of each joint into lines (6 N,).

    chain: kinematics of the arm, one `JOINT` record per joint. links: a tuple of N zeros. angles (N,): joint angles,
    rad.
    """
    A, r = Matrix(Vector(1.0, 0.0, 0.0), Vector(0.0, 1.0, 0.0), Vector(0.0, 0.0, 1.0)), Vector(0.0, 0.0, 0.0)
    for k in range(size(links)):
        o = _AT.end * k
        axis = Vector(chain[o + _AT.axis], chain[o + _AT.axis + 1], chain[o + _AT.axis + 2])
        # less whole turns, in [-pi, pi), because `quaternion` is a series about 0
        angle = angles[k] - 2.0 * math.pi * math.floor(angles[k] / (2.0 * math.pi) + 0.5)
        # axes of link k in inertial axes
        A = A @ rows_of(chain, o) @ matrix(quaternion(angle * axis))
        turn = A @ axis
        for d in range(3):
            lines[6 * k + d], lines[6 * k + 3 + d] = r[d], turn[d]
        span = chain[o + _AT.span]
        r = r + Vector(A[0][0] * span, A[1][0] * span, A[2][0] * span)
    return r


@kernel
def _solved(S, b):
    """Solve S x = b for a 3 x 3 `Matrix` S and a vector b by Cramer's rule; return x."""
    share = 1.0 / dot(S[0], cross(S[1], S[2]))
    x, y, z = cross(S[1], S[2]), cross(S[2], S[0]), cross(S[0], S[1])
    return share * (b[0] * x + b[1] * y + b[2] * z)


@kernel
def _approach(chain, links, length, limits, point, steps, angles):
    """Move joint angles by damped least squares towards a target point; return the tip's distance / the arm's length.

        d theta = J' (J J' + damping)^-1 (point - tip)

    J (3, N): derivative of the tip position (m) by the joint angles. chain: kinematics of the arm, one `JOINT` record
    per joint; links: tuple of N zeros; length: length of the arm, m; limits (2 N,): lower and upper limit of each
    joint, rad; point: target point, m, inertial axes; steps: largest number of iterations; angles (N,): joint angles,
    rad, in and out. In an iteration no joint moves by more than _FARTHEST rad.
    """
    lines = stack(_ONE, links + links + links + links + links + links)
    off = point - _stretched(chain, links, angles, lines)
    for _ in range(steps):
        away = math.sqrt(dot(off, off))
        if away < 1e-12 * length:
            break
        # damping proportional to the distance; a floor bounds the step at singular postures
        damping = 1e-3 * length * away + 1e-10 * length * length
        tip = point - off
        # S = J J' + damping
        S = plus_identity(Matrix(Vector(0.0, 0.0, 0.0), Vector(0.0, 0.0, 0.0), Vector(0.0, 0.0, 0.0)), damping)
        for k in range(size(links)):
            column = _column(lines, k, tip)
            S = S + outer(column, column)
        f, largest = _solved(S, off), 1e-12
        for k in range(size(links)):
            # step scaled so that no joint turns by more than _FARTHEST, because J is local
            largest = max(largest, abs(dot(_column(lines, k, tip), f)))
        share = min(1.0, _FARTHEST / largest)
        for k in range(size(links)):
            angle = angles[k] + share * dot(_column(lines, k, tip), f)
            angles[k] = min(limits[2 * k + 1], max(limits[2 * k], angle))
        off = point - _stretched(chain, links, angles, lines)
    return math.sqrt(dot(off, off)) / length


@kernel
def _column(lines, k, tip):
    """Return the derivative of the tip (m, inertial axes) by joint k's angle: the joint's axis x (tip - joint).

    lines (6 N,): position (m) and axis of each joint, inertial axes. tip: tip position, m, inertial axes.
    """
    o = 6 * k
    lever = tip - Vector(lines[o], lines[o + 1], lines[o + 2])
    return cross(Vector(lines[o + 3], lines[o + 4], lines[o + 5]), lever)


@kernel
def follow_point(chain, links, length, limits, point, angles):
    """Move the joint angles so that the tip follows a point that has moved a little, with few iterations.

    chain: kinematics of the arm, one `JOINT` record per joint; links: tuple of N zeros; length: length of the arm, m;
    limits (2 N,): lower and upper limit of each joint, rad; point (3,): target point, m, inertial axes; angles (N,):
    joint angles, rad, in and out.
    """
    _approach(chain, links, length, limits, point, _FOLLOWED, angles)


@kernel
def seek_point(chain, links, length, limits, point, angles):
    """Move the joint angles so that the tip reaches a point anywhere within reach.

    The search starts from the present joint angles. If the search fails, it is repeated from two bent postures, and the
    best result is kept. chain: kinematics of the arm, one `JOINT` record per joint; links: tuple of N zeros; length:
    length of the arm, m; limits (2 N,): lower and upper limit of each joint, rad; point (3,): target point, m, inertial
    axes; angles (N,): joint angles, rad, in, out.
    """
    least, mine, best = math.inf, stack(_ONE, links), stack(_ONE, links)
    for trial in range(3):
        if least > 1e-9:
            # attempt 0 starts at the present angles, 1 and 2 at elbows bent to alternating sides, because straight arms
            # are singular
            for k in range(size(links)):
                side = _SIDE if (k + trial) % 2 == 0 else -_SIDE
                mine[k] = angles[k] if trial == 0 or k == 0 else side
            off = _approach(chain, links, length, limits, point, _SOUGHT, mine)
            if off < least:
                least = off
                for k in range(size(links)):
                    best[k] = mine[k]
    for k in range(size(links)):
        angles[k] = best[k]
