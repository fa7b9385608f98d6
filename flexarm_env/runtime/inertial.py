"""Reading of an accelerometer at the tip of an arm in space: the tip's mean specific force over a control period."""

from __future__ import annotations

from ..compiler import kernel, load_lane, store_lane
from ..physics.space.rotations import (
    Matrix,
    Vector,
    compose,
    cross,
    dot,
    inverse_rotation,
    matrix,
    quaternion,
    shortest_rotation,
    turn_of,
)
from .laws import GAUSS, channel_of


@kernel
def _inverse(A):
    """Return the inverse of a 3 x 3 `Matrix` A by Cramer's rule."""
    # columns of A; the rows of the inverse are their cross products over the determinant
    a, b, c = A.T
    share = 1.0 / dot(a, cross(b, c))
    return Matrix(share * cross(b, c), share * cross(c, a), share * cross(a, b))


@kernel
def _on_the_way(s, turn, start, end):
    """Return the tip's rotation matrix at s, from -1 to 1 over a period, relative to its axes at s = -1.

    The rotation vector is a cubic Hermite polynomial from 0 to `turn` (rad). The slopes of this polynomial are `start`
    at s = -1 and `end` at s = 1 (rad per unit of s).
    """
    two = (2.0 + s * (3.0 - s * s)) * 0.25 * turn
    slopes = (1.0 - s) * (1.0 - s) * (1.0 + s) * 0.25 * start + (s + 1.0) * (s * s - 1.0) * 0.25 * end
    return matrix(quaternion(two + slopes))


@kernel
def specific_force(lane, memory, base, room, c, i, r, psi, v, w, period, gravity, first):
    """Return the tip's mean specific force (acceleration minus gravity) over the last period, (3,), m/s^2, tip axes.

    Let the specific force in the tip's own axes R(s), s from -1 to 1 over the period, be f = f0 + f1 s. f0 and f1 are
    determined so that f moves the tip from position and velocity a period ago to the present ones
    (`laws.tip_acceleration` in space):

        M0 = mean R f = A0 f0 + A1 f1,     M1 = mean s R f = A1 f0 + A2 f1,     A_j = mean s^j R at three Gauss points,

    where M0 and M1 follow from the changes of velocity and position, and R is the rotation matrix of the tip's axes.
    The kernel returns f0, the mean of f. first: whether the episode begins, so that no period precedes. At the start of
    an episode the velocity in the tip's axes is assumed constant: f = w x R^T v - R^T g.

    # in        r (m), psi (rotation vector, rad), v (m/s), gravity (m/s^2), (3,) each, inertial axes;  w (3,): angular
    #           velocity, rad/s, tip axes;  period, s
    # in, out   memory: channels c, c + 1, c + 2 of lane i hold r, v, psi, w of the previous instant;  base: offset of
    #           channel 0;  room: number of past outputs in a channel
    """
    R = matrix(quaternion(psi))
    if first:
        found = cross(w, R.T @ v) - R.T @ gravity
    else:
        # turn: rotation over the period, in the tip's old axes; slopes at both ends from the angular velocities
        old_r, old_v, old_psi, old_w = _before(lane, memory, base, room, c, i)
        p = quaternion(old_psi)
        whole = turn_of(shortest_rotation(compose(inverse_rotation(p), quaternion(psi))))
        turn = whole.psi
        start, end = 0.5 * period * old_w, 0.5 * period * (whole.T @ w)
        # M0 and M1, in the tip's old axes
        R0, share = matrix(p), 1.0 / period
        M0 = R0.T @ (share * (v - old_v) - gravity)
        M1 = R0.T @ (share * (v + old_v - 2.0 * share * (r - old_r)))
        # rotation matrices at the Gauss points, and their moments A_j
        a = _on_the_way(-GAUSS, turn, start, end)
        b = _on_the_way(0.0, turn, start, end)
        d = _on_the_way(GAUSS, turn, start, end)
        A0 = 5.0 / 18.0 * (a + d) + 4.0 / 9.0 * b
        A1 = 5.0 / 18.0 * GAUSS * (d - a)
        A2 = 5.0 / 18.0 * 0.6 * (a + d)
        # eliminate f1: f0 = (A0 - A1 A2^-1 A1)^-1 (M0 - A1 A2^-1 M1)
        over = A1 @ _inverse(A2)
        found = _inverse(A0 - over @ A1) @ (M0 - over @ M1)
    for k in range(3):
        at = channel_of(base, room, c + k)
        store_lane(lane, memory, at.place, i, r[k])
        store_lane(lane, memory, at.speed, i, v[k])
        store_lane(lane, memory, at.turn, i, psi[k])
        store_lane(lane, memory, at.rate, i, w[k])
    return found


@kernel
def _before(lane, memory, base, room, c, i):
    """Return position (m), velocity (m/s), rotation vector (rad) and angular velocity (rad/s) of the tip a period ago.

    All vectors are in inertial axes, except for the angular velocity in tip axes. Channels c, c + 1, c + 2 store the
    components of these vectors for lane i, one channel per component. base: offset of channel 0 in `memory`; room: past
    outputs in a channel.
    """
    x, y, z = channel_of(base, room, c), channel_of(base, room, c + 1), channel_of(base, room, c + 2)
    return (
        _stored_vector(lane, memory, x.place, y.place, z.place, i),
        _stored_vector(lane, memory, x.speed, y.speed, z.speed, i),
        _stored_vector(lane, memory, x.turn, y.turn, z.turn, i),
        _stored_vector(lane, memory, x.rate, y.rate, z.rate, i),
    )


@kernel
def _stored_vector(lane, memory, x, y, z, i):
    """Return the vector whose components are lane i of `memory` at the offsets x, y, z (of a single lane)."""
    return Vector(load_lane(lane, memory, x, i), load_lane(lane, memory, y, i), load_lane(lane, memory, z, i))
