"""What an accelerometer on the tip of an arm in space reads: the mean of its specific force over a period."""

from __future__ import annotations

from ..compiler import kernel, pick, place
from ..physics.space.rotations import (
    back,
    composed,
    cross,
    difference,
    dot,
    inverse,
    matrix,
    minus,
    plus,
    product,
    quaternion,
    scaled,
    shorter,
    sum_of,
    times,
    transposed,
    turn_of,
    turned,
)
from .laws import GAUSS, channel_of


@kernel
def _inverse(A):
    """Of a matrix, by Cramer's rule."""
    a, b, c = transposed(A)
    share = 1.0 / dot(a, cross(b, c))
    return times(cross(b, c), share), times(cross(c, a), share), times(cross(a, b), share)


@kernel
def _on_the_way(s, turn, start, end):
    """Axes at s, from -1 to 1, in those at -1: a cubic of rotation vectors, 0 to `turn`, with slopes at both ends."""
    two = times(turn, (2.0 + s * (3.0 - s * s)) * 0.25)
    slopes = plus(times(start, (1.0 - s) * (1.0 - s) * (1.0 + s) * 0.25), times(end, (s + 1.0) * (s * s - 1.0) * 0.25))
    return matrix(quaternion(plus(two, slopes)))


@kernel
def specific_force(lane, memory, base, room, c, i, r, psi, v, w, period, gravity, first):
    """(3,) m/s^2 along the tip's axes, of its place r, rotation vector psi, velocity v (inertial), angular velocity w
    (its own axes), in channels c, c + 1, c + 2: `laws.tip_acceleration` in space.

    f = f0 + f1 s in the tip's own axes R(s), s from -1 to 1; M0 = mean R f = A0 f0 + A1 f1 and M1 = mean s R f =
    A1 f0 + A2 f1 are the changes of velocity and place, A_j = mean s^j R at three Gauss points; f0 is wanted.
    """
    R = matrix(quaternion(psi))
    if first:
        found = minus(cross(w, back(R, v)), back(R, gravity))
    else:
        old_r, old_v, old_psi, old_w = _before(lane, memory, base, room, c, i)
        p = quaternion(old_psi)
        whole = turn_of(shorter(composed(inverse(p), quaternion(psi))))
        turn = whole.psi
        start, end = times(old_w, 0.5 * period), times(turned(whole.T, w), 0.5 * period)
        R0, share = matrix(p), 1.0 / period
        M0 = back(R0, minus(times(minus(v, old_v), share), gravity))
        M1 = back(R0, times(minus(plus(v, old_v), times(minus(r, old_r), 2.0 * share)), share))
        a = _on_the_way(-GAUSS, turn, start, end)
        b = _on_the_way(0.0, turn, start, end)
        d = _on_the_way(GAUSS, turn, start, end)
        A0 = sum_of(scaled(sum_of(a, d), 5.0 / 18.0), scaled(b, 4.0 / 9.0))
        A1 = scaled(difference(d, a), 5.0 / 18.0 * GAUSS)
        A2 = scaled(sum_of(a, d), 5.0 / 18.0 * 0.6)
        over = product(A1, _inverse(A2))
        found = turned(_inverse(difference(A0, product(over, A1))), minus(M0, turned(over, M1)))
    for k in range(3):
        at = channel_of(base, room, c + k)
        place(lane, memory, at.place, i, r[k])
        place(lane, memory, at.speed, i, v[k])
        place(lane, memory, at.turn, i, psi[k])
        place(lane, memory, at.rate, i, w[k])
    return found


@kernel
def _before(lane, memory, base, room, c, i):
    """Place, velocity, rotation vector and angular velocity an instant ago."""
    x, y, z = channel_of(base, room, c), channel_of(base, room, c + 1), channel_of(base, room, c + 2)
    return (
        (pick(lane, memory, x.place, i), pick(lane, memory, y.place, i), pick(lane, memory, z.place, i)),
        (pick(lane, memory, x.speed, i), pick(lane, memory, y.speed, i), pick(lane, memory, z.speed, i)),
        (pick(lane, memory, x.turn, i), pick(lane, memory, y.turn, i), pick(lane, memory, z.turn, i)),
        (pick(lane, memory, x.rate, i), pick(lane, memory, y.rate, i), pick(lane, memory, z.rate, i)),
    )
