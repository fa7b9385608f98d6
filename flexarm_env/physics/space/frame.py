"""Kinematics of a segment's floating frame between two sections in space: position, rotation, rates (theory, 9).

The frame begins at the left section's origin. The frame's x axis (the chord) passes through the right section's origin.
The frame's roll about x follows both sections' y axes: z is normal to x and to the sum p of these y axes. The sections'
rotation vectors phi_l, phi_r (rad) relative to the frame and e = |r_r - r_l| - l (m) are the elastic coordinates of a
Timoshenko element with 12 coordinates, 6 of which are elastic:

    r(x) = (1 - x/l) r_l + x/l r_r + A n(x),   n = h_l (phi_l x e_x) + h_r (phi_r x e_x)     [41], h of either plane
    U = (phi' K phi + EA/l (e + phi' H phi / 2)^2) / 2                    (docs: theory, eq. 1.2, of both bendings)

With rotation increments in the sections' and the frame's own axes, d phi_i = T_i^-1 dth_i - T_i^-T dbeta, where

    dbeta_y = -d_z/l, dbeta_z = d_y/l, dbeta_x = g_l dth_l + g_r dth_r + k dbeta_y, d = A'(dr_r - dr_l), the chord's l

The rotary inertia of a section at x has the rate a w_l + b w_r + c w, with a, b, c from the shape functions [41], each
rate in its own axes.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from ...compiler import kernel, square_root
from .rotations import Matrix, Vector, about_identity, cross, dot, matrix


class Frame(NamedTuple):
    """A segment's floating frame, and the derivatives of the frame's rotation by the ends' motion.

    A: rotation matrix, frame axes to inertial axes
    left, right: rotations (`Turn`) of the left and the right section relative to the frame
    k: p_x / p_y, the derivative of the frame's roll by the frame's rotation about y
    """

    A: Any
    length: Any  # m: length of the chord
    over: Any  # 1/m: reciprocal of the chord's length
    left: Any
    right: Any
    k: Any
    share: Any  # 1 / p_y; p: sum of both sections' y axes, in frame axes


class Turn(NamedTuple):
    """A section's rotation relative to the frame."""

    E: Any  # rotation matrix: section axes to frame axes
    phi: Any  # rad: rotation vector of the section relative to the frame
    T: Any  # T^-1(phi), inverse of the tangent map of rotations
    g: Any  # derivative of the frame's roll by the section's rotation: dbeta_x = g . dth (section axes)


class Rates(NamedTuple):
    """Rates of the frame and of the elastic coordinates."""

    spin: Any  # rad/s: angular velocity of the frame, frame axes
    d: Any  # m/s: velocity of the right end relative to the left, frame axes
    left: Any  # rad/s: time derivatives of phi_l and phi_r, frame axes
    right: Any


_HALF_TURN = tuple(2.0**k * math.factorial(k) ** 2 / math.factorial(2 * k + 1) for k in range(16))
"""Power series, in 1 - w, of a / sin(a); w = cos(a), a: half a rotation angle. Its error is 1e-14 at a right angle."""
_BERNOULLI = (
    1 / 6, 1 / 30, 1 / 42, 1 / 30, 5 / 66, 691 / 2730, 7 / 6, 3617 / 510, 43867 / 798, 174611 / 330, 854513 / 138,
    236364091 / 2730,
)  # fmt: skip
_CURVED = tuple(_BERNOULLI[k] / math.factorial(2 * k + 2) for k in range(12))
"""Power series, in |phi|^2, of the coefficient c of T^-1 (`rotations.Turn`). Its error is 1e-14 at a right angle."""


@kernel
def _four(c, k, z, square):
    """Return the terms k to k + 3 of the power series c in z, divided by z^k; square = z^2.

    The sum has no chain of dependent operations (unlike Horner's rule), which makes it faster.
    """
    return (z * c[k + 1] + c[k]) + (z * c[k + 3] + c[k + 2]) * square


@kernel
def _turn(A, own, share):
    """Return the `Turn` of a section: its rotation relative to the frame, and the derivative of the frame's roll.

    A and own are the rotation matrices of frame and section, from their axes to inertial axes. share is 1 / p_y of the
    `Frame`. The function is valid for relative rotations below a right angle. See docs/theory.md, (9.3).
    """
    E = A.T @ own
    # quaternion of E from its trace: cos(a/2) = sqrt(1 + tr E) / 2, sin(a/2) n = part (E - E^T)
    w = square_root(E[0][0] + E[1][1] + E[2][2] + 1.0) * 0.5
    part = 0.25 / w
    p = Vector((E[2][1] - E[1][2]) * part, (E[0][2] - E[2][0]) * part, (E[1][0] - E[0][1]) * part)
    z = 1.0 - w
    z2 = z * z
    z4 = z2 * z2
    # phi = 2 sin(a/2) n times (a/2) / sin(a/2), by its series in 1 - cos(a/2)
    low, high = (
        _four(_HALF_TURN, 0, z, z2) + _four(_HALF_TURN, 4, z, z2) * z4,
        _four(_HALF_TURN, 8, z, z2) + _four(_HALF_TURN, 12, z, z2) * z4,
    )
    phi = (low + high * (z4 * z4)) * 2.0 * p
    # T^-1 = 1 + phi^/2 + c phi^ phi^
    square = dot(phi, phi)
    z2 = square * square
    z4 = z2 * z2
    c = _four(_CURVED, 0, square, z2) + (_four(_CURVED, 4, square, z2) + _four(_CURVED, 8, square, z2) * z4) * z4
    T = about_identity(1.0 - c * square, 0.5 * phi, c, phi)
    # g = (E_zz, 0, -E_zx) / p_y: the section's y axis moves by dth x y
    return Turn(E, phi, T, Vector(E[2][2] * share, E[2][0] * 0.0, -(E[2][0] * share)))


@kernel
def frame_of(left, right):
    """Return the floating `Frame` of the segment between two sections' `Place`s, left and right.

    The frame's x axis leads from the left to the right section's origin; z is normal to x and to the sum of both
    sections' y axes.
    """
    d, own_l, own_r = right.r - left.r, matrix(left.p), matrix(right.p)
    length = square_root(dot(d, d))
    over = 1.0 / length
    # A: x along the chord; z = x x p normalized, with p the sum of both y axes; y completes it
    x, p = over * d, Vector(own_l[0][1] + own_r[0][1], own_l[1][1] + own_r[1][1], own_l[2][1] + own_r[2][1])
    z = cross(x, p)
    share = 1.0 / square_root(dot(z, z))
    z = share * z
    A = Matrix(x, cross(z, x), z).T
    # roll by beta_y: p_x / p_y
    k = dot(x, p) * share
    return Frame(A, length, over, _turn(A, own_l, share), _turn(A, own_r, share), k, share)


@kernel
def rates_of(frame, left, right):
    """Return the `Rates` of a segment's frame, from the rates of the segment's ends (`Place`s left, right).

    w_y = -d_z / l, w_z = d_y / l, w_x = g_l . w_l + g_r . w_r + k w_y. d is the velocity of the right end relative to
    the left end (frame axes), l the length of the chord. w_l and w_r are the sections' angular velocities in section
    axes. g and k are fields of `Turn` and `Frame`.
    """
    d, share = frame.A.T @ (right.v - left.v), frame.over
    y = -(d[2] * share)
    spin = Vector(dot(frame.left.g, left.spin) + dot(frame.right.g, right.spin) + frame.k * y, y, d[1] * share)
    return Rates(spin, d, _phi_rate(frame.left, left.spin, spin), _phi_rate(frame.right, right.spin, spin))


@kernel
def _phi_rate(turn, own, spin):
    """Return phi' = T^-1 w - T^-T w_f (rad/s), the rate of a section's rotation vector phi relative to the frame.

    turn: the section's `Turn`.
    own: angular velocity w of the section, section axes.
    spin: angular velocity w_f of the frame, frame axes. phi and phi' are in frame axes.
    """
    return turn.T @ own - turn.T.T @ spin


@kernel
def phi_second(turn, rate, own, own_second, spin, second):
    """Return phi'' (rad/s^2), the second time derivative of a section's rotation vector relative to the frame.

    turn: the section's `Turn`.
    rate: time derivative phi' of the rotation vector.
    own, own_second: angular velocity and acceleration of the section, section axes.
    spin, second: angular velocity and acceleration of the frame, frame axes. The inverse tangent map is T^-1 = 1 +
    phi^/2 + c phi^ phi^ with c = 1/12 + |phi|^2/720 + ...; the series is valid below a right angle.
    """
    phi = turn.phi
    square, apart = dot(phi, phi), own - spin
    # c and dc/d|phi|^2
    c = square * (square * (square * (1.0 / 1209600.0) + 1.0 / 30240.0) + 1.0 / 720.0) + 1.0 / 12.0
    slope = square * (square * (square * (1.0 / 11975040.0) + 1.0 / 403200.0) + 1.0 / 15120.0) + 1.0 / 720.0
    # T^-1 alpha - T^-T alpha_frame, then the rate of T^-1: phi^/2 part, phi^ phi^ part, c' part
    found = turn.T @ own_second - turn.T.T @ second + 0.5 * cross(rate, own + spin)
    inner = cross(phi, apart)
    found = found + c * (cross(rate, inner) + cross(phi, cross(rate, apart)))
    return found + slope * 2.0 * dot(phi, rate) * cross(phi, inner)


@kernel
def cross_with_ex(phi):
    """Return phi x e_x = (0, phi_z, -phi_y), the slope of a section's tangent relative to the chord."""
    return Vector(phi[0] * 0.0, phi[2], -phi[1])


@kernel
def ex_cross(f):
    """Return e_x x f = (0, -f_z, f_y), the moment that a transverse force f exerts on phi."""
    return Vector(f[0] * 0.0, -f[2], f[1])


@kernel
def frame_second_rates(frame, rates, left, right):
    """Return the angular acceleration of a segment's frame (rad/s^2, frame axes), from its `Rates` and two `Vertex`es.

    The y and z components are the time derivatives of w_y = -d_z / l and w_z = d_y / l in the rotating frame, where d
    is the velocity of the right end relative to the left end. The x component follows from the condition p_z = 0 in
    frame axes, where p is the sum of both sections' y axes. See docs/theory.md, (9.3).
    """
    spin, share = rates.spin, frame.over
    # y and z, from the chord's second rate
    d = frame.A.T @ (right.a - left.a)
    y = spin[0] * spin[2] - (d[2] + rates.d[0] * spin[1] * 2.0) * share
    z = (d[1] - rates.d[0] * spin[2] * 2.0) * share - spin[0] * spin[1]
    # p and its rates in frame axes: sums over both sections' y axes, E y and its derivatives
    first, second, p = (
        Vector(y * 0.0, y * 0.0, y * 0.0),
        Vector(y * 0.0, y * 0.0, y * 0.0),
        Vector(y * 0.0, y * 0.0, y * 0.0),
    )
    for turn, at in ((frame.left, left), (frame.right, right)):
        w, alpha = at.place.spin, at.alpha
        p = p + turn.E.T[1]
        first = first + turn.E @ Vector(-w[2], y * 0.0, w[0])
        swung = Vector(w[0] * w[1] - alpha[2], -(w[0] * w[0] + w[2] * w[2]), w[1] * w[2] + alpha[0])
        second = second + turn.E @ swung
    # subtract the part of the frame's own rotation; the roll keeps p_z = 0
    own = 2.0 * cross(spin, first - cross(spin, p)) + cross(spin, cross(spin, p))
    return Vector((second[2] - own[2]) * frame.share + y * frame.k, y, z)
