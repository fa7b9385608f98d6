"""Inverse kinematics in space: joint angles of the rigid arm that bring its tip to a point, by damped least squares.

`chain` holds a `JOINT` a joint. Angles are written where the joints' present ones are, rad; limits: see `angles`. A
point out of reach is approached.
"""

import math

from ..compiler import kernel, size, stack
from ..layout import Field, Layout
from ..physics.space.rotations import (
    cross,
    dot,
    matrix,
    minus,
    outer,
    plus,
    plus_identity,
    product,
    quaternion,
    sum_of,
    times,
    turned,
)

JOINT = Layout(
    "ChainJoint", "",
    Field("mount", (9,), "", "axes of the link's root at angle 0, in those of the section before, row by row"),
    Field("axis", (3,), "", "of the joint, in the axes of the link's root"),
    Field("span", (), "m", "of the link"),
)  # fmt: skip
"""What kinematics know of a joint and the link behind it."""

_AT = JOINT.places
_ONE, _FARTHEST = (0,), 0.5
_FOLLOWED, _SOUGHT = 4, 60
"""Steps where a point has moved on a little, and where it may be anywhere."""
_SIDE = 0.8
"""rad: joints of the postures from which it is then sought."""


@kernel
def _rows(table, k):
    """A matrix from nine numbers from k on."""
    return (
        (table[k], table[k + 1], table[k + 2]),
        (table[k + 3], table[k + 4], table[k + 5]),
        (table[k + 6], table[k + 7], table[k + 8]),
    )


@kernel
def _stretched(chain, links, angles, lines):
    """The tip; lines <- place and axis of each joint, 6 numbers each."""
    A, r = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), (0.0, 0.0, 0.0)
    for k in range(size(links)):
        o = _AT.end * k
        axis = (chain[o + _AT.axis], chain[o + _AT.axis + 1], chain[o + _AT.axis + 2])
        angle = angles[k] - 2.0 * math.pi * math.floor(angles[k] / (2.0 * math.pi) + 0.5)
        A = product(product(A, _rows(chain, o)), matrix(quaternion(times(axis, angle))))
        turn = turned(A, axis)
        for d in range(3):
            lines[6 * k + d], lines[6 * k + 3 + d] = r[d], turn[d]
        span = chain[o + _AT.span]
        r = plus(r, (A[0][0] * span, A[1][0] * span, A[2][0] * span))
    return r


@kernel
def _solved(S, b):
    """x of S x = b, by Cramer's rule."""
    share = 1.0 / dot(S[0], cross(S[1], S[2]))
    x, y, z = cross(S[1], S[2]), cross(S[2], S[0]), cross(S[0], S[1])
    return times(plus(plus(times(x, b[0]), times(y, b[1])), times(z, b[2])), share)


@kernel
def _approach(chain, links, length, limits, point, steps, angles):
    """The angles near these; returns how far the tip is then from the point, over the length."""
    lines = stack(_ONE, links + links + links + links + links + links)
    off = minus(point, _stretched(chain, links, angles, lines))
    for _ in range(steps):
        away = math.sqrt(dot(off, off))
        if away < 1e-12 * length:
            break
        damping = 1e-3 * length * away + 1e-10 * length * length
        tip = minus(point, off)
        S = plus_identity(((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), damping)
        for k in range(size(links)):
            column = _column(lines, k, tip)
            S = sum_of(S, outer(column, column))
        f, largest = _solved(S, off), 1e-12
        for k in range(size(links)):
            largest = max(largest, abs(dot(_column(lines, k, tip), f)))
        share = min(1.0, _FARTHEST / largest)
        for k in range(size(links)):
            angle = angles[k] + share * dot(_column(lines, k, tip), f)
            angles[k] = min(limits[2 * k + 1], max(limits[2 * k], angle))
        off = minus(point, _stretched(chain, links, angles, lines))
    return math.sqrt(dot(off, off)) / length


@kernel
def _column(lines, k, tip):
    """What the tip moves by with joint k."""
    o = 6 * k
    lever = minus(tip, (lines[o], lines[o + 1], lines[o + 2]))
    return cross((lines[o + 3], lines[o + 4], lines[o + 5]), lever)


@kernel
def follow_point(chain, links, length, limits, point, angles):
    """The angles that follow on these, where the point has moved on a little."""
    _approach(chain, links, length, limits, point, _FOLLOWED, angles)


@kernel
def seek_point(chain, links, length, limits, point, angles):
    """The angles found from these, or from two bent postures where the tip then does not come there."""
    least, mine, best = math.inf, stack(_ONE, links), stack(_ONE, links)
    for trial in range(3):
        if least > 1e-9:
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
