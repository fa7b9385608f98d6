"""A segment with a floating frame between two sections in space: where the frame is, and how it moves.

The frame begins at the left section's place, its x axis (the chord) goes through the right one's, and its roll about
that follows both sections' y axes: z is at right angles to their sum. The sections' rotation vectors phi_l, phi_r
against it and e = |r_r - r_l| - l are the elastic coordinates of a Timoshenko element of 12, of which 6 are left:

    r(x) = (1 - x/l) r_l + x/l r_r + A n(x),   n = h_l (phi_l x e_x) + h_r (phi_r x e_x)     [41], h of either plane
    U = (phi' K phi + EA/l (e + phi' H phi / 2)^2) / 2                    (docs: theory, eq. 1.2, of both bendings)

By rotation increments in the sections' and the frame's own axes, d phi_i = T_i^-1 dth_i - T_i^-T dbeta, with

    dbeta_y = -d_z/l, dbeta_z = d_y/l, dbeta_x = g_l dth_l + g_r dth_r + k dbeta_y, d = A'(dr_r - dr_l), the chord's l

Sections at x have the rotary inertia of the rates a w_l + b w_r + c w, [41] again, each in axes of its own.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from ...compiler import kernel, square_root
from .rotations import about_identity, back, cross, dot, matrix, minus, plus, product, times, transposed, turned


class Frame(NamedTuple):
    """Where the frame is, and what of it increments of the ends change."""

    A: Any
    length: Any  # of the chord
    over: Any  # 1 / length
    left: Any  # `Turn` of the left section
    right: Any
    k: Any
    share: Any  # 1 / p_y, p the sum of both sections' y axes


class Turn(NamedTuple):
    """A section's rotation against the frame."""

    E: Any  # its axes in the frame's
    phi: Any
    T: Any  # T^-1(phi)
    g: Any


class Rates(NamedTuple):
    """How the frame moves, in its axes."""

    spin: Any
    d: Any  # of the right end against the left one
    left: Any  # of phi
    right: Any


_HALF_TURN = tuple(2.0**k * math.factorial(k) ** 2 / math.factorial(2 * k + 1) for k in range(16))
"""Of acos(w) / sqrt(1 - w^2) by 1 - w: half an angle over its sine; to 1e-14 where the angle is a right one."""
_BERNOULLI = (
    1 / 6, 1 / 30, 1 / 42, 1 / 30, 5 / 66, 691 / 2730, 7 / 6, 3617 / 510, 43867 / 798, 174611 / 330, 854513 / 138,
    236364091 / 2730,
)  # fmt: skip
_CURVED = tuple(_BERNOULLI[k] / math.factorial(2 * k + 2) for k in range(12))
"""Of c of T^-1 (`rotations.Turn`) by |phi|^2, likewise."""


@kernel
def _four(c, k, z, square):
    """Four terms of a power series, not one after the other: what waits for nothing costs nothing."""
    return (z * c[k + 1] + c[k]) + (z * c[k + 3] + c[k + 2]) * square


@kernel
def _turn(A, own, share):
    """own: the section's axes. share: 1 / p_y."""
    E = product(transposed(A), own)
    w = square_root(E[0][0] + E[1][1] + E[2][2] + 1.0) * 0.5
    part = 0.25 / w
    p = (E[2][1] - E[1][2]) * part, (E[0][2] - E[2][0]) * part, (E[1][0] - E[0][1]) * part
    z = 1.0 - w
    z2 = z * z
    z4 = z2 * z2
    low, high = (
        _four(_HALF_TURN, 0, z, z2) + _four(_HALF_TURN, 4, z, z2) * z4,
        _four(_HALF_TURN, 8, z, z2) + _four(_HALF_TURN, 12, z, z2) * z4,
    )
    phi = times(p, (low + high * (z4 * z4)) * 2.0)
    square = dot(phi, phi)
    z2 = square * square
    z4 = z2 * z2
    c = _four(_CURVED, 0, square, z2) + (_four(_CURVED, 4, square, z2) + _four(_CURVED, 8, square, z2) * z4) * z4
    T = about_identity(1.0 - c * square, times(phi, 0.5), c, phi)
    return Turn(E, phi, T, (E[2][2] * share, E[2][0] * 0.0, -(E[2][0] * share)))


@kernel
def frame_of(left, right):
    """The `Frame` between two `Place`s."""
    d, own_l, own_r = minus(right.r, left.r), matrix(left.p), matrix(right.p)
    length = square_root(dot(d, d))
    over = 1.0 / length
    x, p = times(d, over), (own_l[0][1] + own_r[0][1], own_l[1][1] + own_r[1][1], own_l[2][1] + own_r[2][1])
    z = cross(x, p)
    share = 1.0 / square_root(dot(z, z))
    z = times(z, share)
    A = transposed((x, cross(z, x), z))
    k = dot(x, p) * share
    return Frame(A, length, over, _turn(A, own_l, share), _turn(A, own_r, share), k, share)


@kernel
def rates_of(frame, left, right):
    """The `Rates` of two `Place`s."""
    d, share = back(frame.A, minus(right.v, left.v)), frame.over
    y = -(d[2] * share)
    spin = dot(frame.left.g, left.spin) + dot(frame.right.g, right.spin) + frame.k * y, y, d[1] * share
    return Rates(spin, d, _phi_rate(frame.left, left.spin, spin), _phi_rate(frame.right, right.spin, spin))


@kernel
def _phi_rate(turn, own, spin):
    return minus(turned(turn.T, own), back(turn.T, spin))


@kernel
def phi_second(turn, rate, own, own_second, spin, second):
    """Second rate of phi: T^-1 = 1 + phi^/2 + c phi^ phi^, c = 1/12 + |phi|^2/720 + ... of angles below a right one."""
    phi = turn.phi
    square, apart = dot(phi, phi), minus(own, spin)
    c = square * (square * (square * (1.0 / 1209600.0) + 1.0 / 30240.0) + 1.0 / 720.0) + 1.0 / 12.0
    slope = square * (square * (square * (1.0 / 11975040.0) + 1.0 / 403200.0) + 1.0 / 15120.0) + 1.0 / 720.0
    found = plus(minus(turned(turn.T, own_second), back(turn.T, second)), times(cross(rate, plus(own, spin)), 0.5))
    inner = cross(phi, apart)
    found = plus(found, times(plus(cross(rate, inner), cross(phi, cross(rate, apart))), c))
    return plus(found, times(cross(phi, inner), slope * 2.0 * dot(phi, rate)))


@kernel
def across(phi):
    """phi x e_x."""
    return phi[0] * 0.0, phi[2], -phi[1]


@kernel
def lifted(f):
    """e_x x f: what a force across does on phi."""
    return f[0] * 0.0, -f[2], f[1]


@kernel
def seconds(frame, rates, left, right):
    """The frame's second rate in its axes."""
    spin, share = rates.spin, frame.over
    d = back(frame.A, minus(right.a, left.a))
    y = spin[0] * spin[2] - (d[2] + rates.d[0] * spin[1] * 2.0) * share
    z = (d[1] - rates.d[0] * spin[2] * 2.0) * share - spin[0] * spin[1]
    first, second, p = (y * 0.0, y * 0.0, y * 0.0), (y * 0.0, y * 0.0, y * 0.0), (y * 0.0, y * 0.0, y * 0.0)
    for turn, at in ((frame.left, left), (frame.right, right)):
        w, alpha = at.place.spin, at.alpha
        p = plus(p, (turn.E[0][1], turn.E[1][1], turn.E[2][1]))
        first = plus(first, turned(turn.E, (-w[2], y * 0.0, w[0])))
        swung = w[0] * w[1] - alpha[2], -(w[0] * w[0] + w[2] * w[2]), w[1] * w[2] + alpha[0]
        second = plus(second, turned(turn.E, swung))
    own = plus(times(cross(spin, minus(first, cross(spin, p))), 2.0), cross(spin, cross(spin, p)))
    return (second[2] - own[2]) * frame.share + y * frame.k, y, z
