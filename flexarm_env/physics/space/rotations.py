"""Vectors, 3 x 3 matrices and rotations of one arm or of lanes: tuples, so that they stay in registers.

A vector is a tuple of three, a matrix a tuple of three rows, a quaternion (w, x, y, z) of length 1. A rotation vector
psi stands for exp(psi^), psi^ b = psi x b; coordinates are such vectors, and they are moved by increments in body axes:
exp(psi^) exp(d^) (Bruels & Cardona 2010). p and -p are the same rotation.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from ...compiler import kernel, load, select_lt, square_root, store, superword
from ..arithmetic import put_vector

_SINE = tuple((-1.0) ** k / math.factorial(2 * k + 1) for k in range(8, -1, -1))
_COSINE = tuple((-1.0) ** k / math.factorial(2 * k) for k in range(9, -1, -1))
_ARCTANGENT = tuple((-1.0) ** k / (2 * k + 1) for k in range(11, -1, -1))


@kernel
def put_matrix(array, k, A):
    """array[k : k + 9] <- A, row by row."""
    put_vector(array, k, A[0])
    put_vector(array, k + 3, A[1])
    put_vector(array, k + 6, A[2])


@kernel
def add_vector(lane, array, k, a):
    """array[k : k + 3] <- array[k : k + 3] + a."""
    for i in range(3):
        store(array, k + i, load(lane, array, k + i) + a[i])


@kernel
def plus(a, b):
    """a + b."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@kernel
def minus(a, b):
    """a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@kernel
def times(a, x):
    """a x, x a number."""
    return a[0] * x, a[1] * x, a[2] * x


@kernel
def dot(a, b):
    """a . b."""
    return (a[0] * b[0] + a[1] * b[1]) + a[2] * b[2]


@kernel
def cross(a, b):
    """a x b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@kernel
def swirl(w, alpha, a):
    """alpha x a + w x (w x a)."""
    return plus(cross(alpha, a), cross(w, cross(w, a)))


@kernel
def turned(A, b):
    """A b."""
    return dot(A[0], b), dot(A[1], b), dot(A[2], b)


@kernel
def transposed(A):
    """The transpose of A."""
    return (
        (A[0][0], A[1][0], A[2][0]),
        (A[0][1], A[1][1], A[2][1]),
        (A[0][2], A[1][2], A[2][2]),
    )


@kernel
def back(A, b):
    """The transpose of A times b."""
    return plus(plus(times(A[0], b[0]), times(A[1], b[1])), times(A[2], b[2]))


@kernel
def product(A, B):
    """A B."""
    return _row(A[0], B), _row(A[1], B), _row(A[2], B)


@kernel
def _row(a, B):
    return plus(plus(times(B[0], a[0]), times(B[1], a[1])), times(B[2], a[2]))


@kernel
def sum_of(A, B):
    """A + B, matrices."""
    return plus(A[0], B[0]), plus(A[1], B[1]), plus(A[2], B[2])


@kernel
def difference(A, B):
    """A - B, matrices."""
    return minus(A[0], B[0]), minus(A[1], B[1]), minus(A[2], B[2])


@kernel
def scaled(A, x):
    """A x, a matrix and a number."""
    return times(A[0], x), times(A[1], x), times(A[2], x)


@kernel
def skew(a):
    """a^, the matrix of b -> a x b."""
    zero = a[0] * 0.0
    return (zero, -a[2], a[1]), (a[2], zero, -a[0]), (-a[1], a[0], zero)


@kernel
def skewed(a, A):
    """a^ A."""
    return (
        minus(times(A[2], a[1]), times(A[1], a[2])),
        minus(times(A[0], a[2]), times(A[2], a[0])),
        minus(times(A[1], a[0]), times(A[0], a[1])),
    )


@kernel
def outer(a, b):
    """a b^T."""
    return times(b, a[0]), times(b, a[1]), times(b, a[2])


@kernel
def plus_identity(A, x):
    """A + x 1."""
    return (A[0][0] + x, A[0][1], A[0][2]), (A[1][0], A[1][1] + x, A[1][2]), (A[2][0], A[2][1], A[2][2] + x)


@kernel
def about_identity(x, a, y, b):
    """x 1 + a^ + y b b^T: x, y numbers, a, b vectors."""
    c = times(b, y)
    return (
        (c[0] * b[0] + x, c[0] * b[1] - a[2], c[0] * b[2] + a[1]),
        (c[1] * b[0] + a[2], c[1] * b[1] + x, c[1] * b[2] - a[0]),
        (c[2] * b[0] - a[1], c[2] * b[1] + a[0], c[2] * b[2] + x),
    )


@kernel
def polynomial(series, z):
    """A polynomial's value, its coefficients from the highest power on."""
    total = z * series[0] + series[1]
    for x in series[2:]:
        total = total * z + x
    return total


@kernel
def quaternion(psi):
    """That of exp(psi^), twice its half: to 1e-16 for |psi| <= pi, to 1e-12 up to 2 pi."""
    z = dot(psi, psi) * 0.0625
    sine, cosine = polynomial(_SINE, z), polynomial(_COSINE, z)  # of a quarter of the angle; the first over that
    part = sine * cosine * 0.5
    return 1.0 - z * (sine * sine) * 2.0, psi[0] * part, psi[1] * part, psi[2] * part


@kernel
def composed(p, r):
    """The rotation r and then, in axes that stand still, p: p r."""
    a, b = (p[1], p[2], p[3]), (r[1], r[2], r[3])
    v = plus(plus(times(b, p[0]), times(a, r[0])), cross(a, b))
    return p[0] * r[0] - dot(a, b), v[0], v[1], v[2]


@kernel
def inverse(p):
    """The rotation back."""
    return p[0], -p[1], -p[2], -p[3]


@kernel
def shorter(p):
    """p or -p, whichever turns by at most pi."""
    sign = select_lt(p[0], 0.0, -1.0, 1.0)
    return p[0] * sign, p[1] * sign, p[2] * sign, p[3] * sign


class Turn(NamedTuple):
    """A rotation of at most pi: its vector psi; half of it; tan(|psi|/4) psi/|psi|; T^-1, (exp(psi^))^T d exp(psi^) =
    (T d psi)^, of any psi 1 + psi^/2 + c psi^ psi^ with c = (1 - |psi|/2 cot(|psi|/2)) / |psi|^2."""

    psi: Any
    half: Any
    g: Any
    T: Any


@kernel
def _unwound(square):
    """Of g = tan(a/4), whose square this is, at most 1: a / g, and 1 / cos(a/4)."""
    whole = square_root(square + 1.0)
    near = 1.0 / (whole + 1.0)  # tan(a/8) = g near
    z = square * near * near
    far = 1.0 / (square_root(z + 1.0) + 1.0)  # tan(a/16) = g near far
    return polynomial(_ARCTANGENT, z * far * far) * (near * far * 16.0), whole


@kernel
def rotation_vector(p):
    """psi of at most pi with exp(psi^) that of p, which has w >= 0 (see `shorter`)."""
    share = 1.0 / (p[0] + 1.0)
    g = p[1] * share, p[2] * share, p[3] * share
    return times(g, _unwound(dot(g, g))[0])


@kernel
def turn_of(p):
    """The `Turn` of p, which has w >= 0."""
    share = 1.0 / (p[0] + 1.0)
    g = p[1] * share, p[2] * share, p[3] * share
    wound, whole = _unwound(dot(g, g))
    psi, cosine = times(g, wound), 1.0 / whole
    square = dot(psi, psi)
    closed = (1.0 - wound * share * p[0] * 0.5) / select_lt(square, 1e-3, 1.0, square)
    c = select_lt(square, 1e-3, 1.0 / 12.0 + square * (1.0 / 720.0 + square * (1.0 / 30240.0)), closed)
    T = about_identity(1.0 - c * square, times(psi, 0.5), c, psi)
    return Turn(psi, (cosine, g[0] * cosine, g[1] * cosine, g[2] * cosine), g, T)


@kernel
def _half_sine(d):
    """The cosine of half of |d|; the square of its sine; |d|^2, or 1 where it is small; the sine over |d|."""
    square, p = dot(d, d), quaternion(d)
    sine = (p[1] * p[1] + p[2] * p[2]) + p[3] * p[3]
    over = select_lt(square, 1e-3, 1.0, square)
    return p[0], sine, over, square_root(sine / over)


@kernel
def inverse_share(d):
    """c of T^-1 (`Turn`) of d, at most 2 pi."""
    square, (cosine, _, over, by_square) = dot(d, d), _half_sine(d)
    closed = (1.0 - cosine / (by_square * 2.0)) / over
    return select_lt(square, 1e-3, 1.0 / 12.0 + square * (1.0 / 720.0 + square * (1.0 / 30240.0)), closed)


@kernel
def inverse_map(d, share, x):
    """T^-T x, T being that of d, by its `inverse_share`."""
    y = cross(d, x)
    return plus(x, plus(times(y, -0.5), times(cross(d, y), share)))


@kernel
def tangent_map(d, inverse, x):
    """T^T x, or T^-T x, T being that of d (`Turn`), at most 2 pi."""
    if inverse:
        return inverse_map(d, inverse_share(d), x)
    square, (cosine, sine, over, by_square) = dot(d, d), _half_sine(d)
    once = select_lt(square, 1e-3, 0.5 - square * (1.0 / 24.0 - square * (1.0 / 720.0)), sine * 2.0 / over)
    closed = (1.0 - cosine * by_square * 2.0) / over
    twice = select_lt(square, 1e-3, 1.0 / 6.0 - square * (1.0 / 120.0 - square * (1.0 / 5040.0)), closed)
    y = cross(d, x)
    return plus(x, plus(times(y, once), times(cross(d, y), twice)))


@kernel
def matrix(p):
    """The rotation's matrix, body axes to those that stand still."""
    w, x, y, z = p
    x2, y2, z2 = x + x, y + y, z + z
    xx, yy, zz = x * x2, y * y2, z * z2
    xy, xz, yz, wx, wy, wz = x * y2, x * z2, y * z2, w * x2, w * y2, w * z2
    return (1.0 - (yy + zz), xy - wz, xz + wy), (xy + wz, 1.0 - (xx + zz), yz - wx), (xz - wy, yz + wx, 1.0 - (xx + yy))


@superword
def moved(psi, d):
    """The rotation vector of exp(psi^) exp(d^)."""
    return rotation_vector(shorter(composed(quaternion(psi), quaternion(d))))
