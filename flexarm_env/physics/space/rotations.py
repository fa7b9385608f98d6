"""Vectors, 3 x 3 matrices and rotations for one arm or for lanes, as named tuples whose numbers stay in registers.

A vector is a `Vector`, a matrix a `Matrix` of three rows, a unit quaternion a tuple p = (w, x, y, z) with w =
cos(|psi|/2). A rotation vector psi (rad) denotes the rotation exp(psi^), where psi^ b = psi x b. p and -p denote the
same rotation. Rotations map vectors from body axes to reference axes. The coordinates of a section are a rotation
vector psi (body axes to inertial axes). An increment d in body axes changes the rotation to exp(psi^) exp(d^) (Bruels &
Cardona 2010). T(d) is the tangent map, exp(d^ + e^) = exp(d^) exp((T e)^) to first order in e.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from ...compiler import Lanes, kernel, select_lt, square_root, superword
from ..arithmetic import store_vector

# Taylor coefficients, highest power first: sin(x)/x and cos(x) in x^2, atan(x)/x in x^2
_SINE = tuple((-1.0) ** k / math.factorial(2 * k + 1) for k in range(8, -1, -1))
_COSINE = tuple((-1.0) ** k / math.factorial(2 * k) for k in range(9, -1, -1))
_ARCTANGENT = tuple((-1.0) ** k / (2 * k + 1) for k in range(11, -1, -1))


class Vector(NamedTuple):
    """A vector with components x, y, z in some axes. Operators: `a + b`, `a - b`, `s * a`, `-a`; b may be a tuple."""

    x: Any
    y: Any
    z: Any

    def __add__(self, b: Any) -> Any:
        """Return the sum of two vectors in the same axes."""
        return Vector(self[0] + b[0], self[1] + b[1], self[2] + b[2])

    def __radd__(self, a: Any) -> Any:
        """Return the sum a + self, where a is a tuple of three numbers."""
        return Vector(a[0] + self[0], a[1] + self[1], a[2] + self[2])

    def __sub__(self, b: Any) -> Any:
        """Return the difference of two vectors in the same axes."""
        return Vector(self[0] - b[0], self[1] - b[1], self[2] - b[2])

    def __rsub__(self, a: Any) -> Any:
        """Return the difference a - self, where a is a tuple of three numbers."""
        return Vector(a[0] - self[0], a[1] - self[1], a[2] - self[2])

    def __mul__(self, s: Any) -> Any:
        """Return the vector multiplied by the number s."""
        return Vector(self[0] * s, self[1] * s, self[2] * s)

    def __rmul__(self, s: Any) -> Any:
        """Return the vector multiplied by the number s."""
        return Vector(self[0] * s, self[1] * s, self[2] * s)

    def __neg__(self) -> Any:
        """Return the opposite vector."""
        return Vector(-self[0], -self[1], -self[2])


class Matrix(NamedTuple):
    """A 3 x 3 matrix by rows, each a `Vector`: `A + B`, `A - B`, `s * A`, `-A`, `A @ b`, `A @ B`, transpose `A.T`.

    A rotation matrix R maps vectors from body axes to reference axes: R @ b, and back: R.T @ a.
    """

    x: Any
    y: Any
    z: Any

    def __add__(self, B: Any) -> Any:
        """Return the sum of two matrices."""
        return Matrix(self[0] + B[0], self[1] + B[1], self[2] + B[2])

    def __sub__(self, B: Any) -> Any:
        """Return the difference of two matrices."""
        return Matrix(self[0] - B[0], self[1] - B[1], self[2] - B[2])

    def __mul__(self, s: Any) -> Any:
        """Return the matrix multiplied by the number s."""
        return Matrix(s * self[0], s * self[1], s * self[2])

    def __rmul__(self, s: Any) -> Any:
        """Return the matrix multiplied by the number s."""
        return Matrix(s * self[0], s * self[1], s * self[2])

    def __neg__(self) -> Any:
        """Return the matrix with all signs reversed."""
        return Matrix(-self[0], -self[1], -self[2])

    def __matmul__(self, b: Any) -> Any:
        """Return the product of this matrix with a matrix or with a vector."""
        if isinstance(b, Matrix):
            return Matrix(_row(self[0], b), _row(self[1], b), _row(self[2], b))
        return Vector(dot(self[0], b), dot(self[1], b), dot(self[2], b))

    @property
    def T(self) -> Any:
        """Return the transpose."""
        return Matrix(
            Vector(self[0][0], self[1][0], self[2][0]),
            Vector(self[0][1], self[1][1], self[2][1]),
            Vector(self[0][2], self[1][2], self[2][2]),
        )


# numbers of NumPy leave `s * a` to these classes; otherwise the product would be an array
Vector.__array_ufunc__ = Matrix.__array_ufunc__ = None  # type: ignore[attr-defined]


@kernel
def load_vector(lane, array: Lanes, k):
    """Return elements k, k + 1 and k + 2 of an array of lanes as a `Vector`."""
    return Vector(array[k], array[k + 1], array[k + 2])


@kernel
def three_of(lane, array, k):
    """Return entries k, k + 1, k + 2 of a model array as a `Vector`; the vector is the same in all lanes."""
    return Vector(array[k], array[k + 1], array[k + 2])


@kernel
def nine_of(lane, array, k):
    """Return nine entries of a model array from k on, stored by rows, as a `Matrix` that is the same in all lanes."""
    return Matrix(three_of(lane, array, k), three_of(lane, array, k + 3), three_of(lane, array, k + 6))


@kernel
def store_matrix(lane, array, k, A):
    """Store the matrix A row by row: array[k : k + 9] <- A."""
    store_vector(lane, array, k, A[0])
    store_vector(lane, array, k + 3, A[1])
    store_vector(lane, array, k + 6, A[2])


@kernel
def add_vector(lane, array: Lanes, k, a):
    """Add a vector to three entries of an array: array[k : k + 3] <- array[k : k + 3] + a."""
    for i in range(3):
        array[k + i] += a[i]


@kernel
def dot(a, b):
    """Return the scalar product a . b of two vectors in the same axes."""
    return (a[0] * b[0] + a[1] * b[1]) + a[2] * b[2]


@kernel
def scale(a, d):
    """Return the vector with the components a_i d_i of two vectors a and d."""
    return Vector(a[0] * d[0], a[1] * d[1], a[2] * d[2])


@kernel
def cross(a, b):
    """Return the vector product a x b of two vectors in the same axes."""
    return Vector(a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@kernel
def rotating_acceleration(w, alpha, a):
    """Return alpha x a + w x (w x a), the acceleration (m/s^2) of a point of a rigid body relative to its origin.

    w, alpha: angular velocity and acceleration (rad/s, rad/s^2).
    a: position of the point, m. All vectors are in the same axes.
    """
    return cross(alpha, a) + cross(w, cross(w, a))


@kernel
def _row(a, B):
    """Return the row vector a^T B, one row of a matrix product."""
    return a[0] * B[0] + a[1] * B[1] + a[2] * B[2]


@kernel
def skew(a):
    """Return the skew-symmetric matrix a^ of a vector a, for which a^ b = a x b."""
    zero = a[0] * 0.0
    return Matrix(Vector(zero, -a[2], a[1]), Vector(a[2], zero, -a[0]), Vector(-a[1], a[0], zero))


@kernel
def skewed(a, A):
    """Return the matrix product a^ A: the cross product of a with each column of A."""
    return Matrix(a[1] * A[2] - a[2] * A[1], a[2] * A[0] - a[0] * A[2], a[0] * A[1] - a[1] * A[0])


@kernel
def outer(a, b):
    """Return the outer product a b^T, a matrix."""
    return Matrix(a[0] * b, a[1] * b, a[2] * b)


@kernel
def plus_identity(A, x):
    """Return A + x 1: the matrix A with the number x added to its diagonal."""
    return Matrix(
        Vector(A[0][0] + x, A[0][1], A[0][2]),
        Vector(A[1][0], A[1][1] + x, A[1][2]),
        Vector(A[2][0], A[2][1], A[2][2] + x),
    )


@kernel
def about_identity(x, a, y, b):
    """Return the matrix x 1 + a^ + y b b^T, with numbers x, y and vectors a, b."""
    c = y * b
    return Matrix(
        Vector(c[0] * b[0] + x, c[0] * b[1] - a[2], c[0] * b[2] + a[1]),
        Vector(c[1] * b[0] + a[2], c[1] * b[1] + x, c[1] * b[2] - a[0]),
        Vector(c[2] * b[0] - a[1], c[2] * b[1] + a[0], c[2] * b[2] + x),
    )


@kernel
def polynomial(series, z):
    """Return the value at z of the polynomial with coefficients `series`, highest power first (Horner's rule)."""
    total = z * series[0] + series[1]
    for x in series[2:]:
        total = total * z + x
    return total


@kernel
def quaternion(psi):
    """Return the quaternion (w, x, y, z) of the rotation by the rotation vector psi (rad).

    The error is 1e-16 for |psi| <= pi and 1e-12 for |psi| <= 2 pi.
    """
    # sin(a/4)/(a/4) and cos(a/4) of the angle a = |psi|, from their series in (a/4)^2
    z = dot(psi, psi) * 0.0625
    sine, cosine = polynomial(_SINE, z), polynomial(_COSINE, z)
    # double the angle: cos(a/2) = 1 - 2 sin^2(a/4), sin(a/2) = 2 sin(a/4) cos(a/4)
    part = sine * cosine * 0.5
    return 1.0 - z * (sine * sine) * 2.0, psi[0] * part, psi[1] * part, psi[2] * part


@kernel
def compose(p, r):
    """Return the quaternion product p r: the rotation r, then p about reference axes (or p, then r about body axes)."""
    a, b = Vector(p[1], p[2], p[3]), Vector(r[1], r[2], r[3])
    v = p[0] * b + r[0] * a + cross(a, b)
    return p[0] * r[0] - dot(a, b), v[0], v[1], v[2]


@kernel
def inverse_rotation(p):
    """Return the quaternion of the inverse rotation, the conjugate of p."""
    return p[0], -p[1], -p[2], -p[3]


@kernel
def shortest_rotation(p):
    """Return p or -p (the same rotation) so that w >= 0 and the rotation vector is at most pi long."""
    sign = select_lt(p[0], 0.0, -1.0, 1.0)
    return p[0] * sign, p[1] * sign, p[2] * sign, p[3] * sign


class Turn(NamedTuple):
    """Functions of a rotation by an angle a = |psi| of at most pi.

    psi: rotation vector, rad
    half: quaternion of the rotation by psi / 2
    g: vector tan(a/4) psi / a
    T: matrix T^-1(psi) = 1 + psi^/2 + c psi^ psi^ with c = (1 - a/2 cot(a/2)) / a^2; (exp(psi^))^T d exp(psi^) = (T
    dpsi)^
    """

    psi: Any
    half: Any
    g: Any
    T: Any


@kernel
def _unwound(square):
    """Return a / tan(a/4) and 1 / cos(a/4) for a rotation by the angle a (rad), given `square` = tan^2(a/4) <= 1.

    Two further halvings of the angle make the series of the arctangent converge fast.
    """
    whole = square_root(square + 1.0)
    # tan(a/8) = tan(a/4) near and tan(a/16) = tan(a/4) near far
    near = 1.0 / (whole + 1.0)
    z = square * near * near
    far = 1.0 / (square_root(z + 1.0) + 1.0)
    return polynomial(_ARCTANGENT, z * far * far) * (near * far * 16.0), whole


@kernel
def rotation_vector(p):
    """Return the rotation vector psi (rad, |psi| <= pi) of a quaternion p with w >= 0 (`shortest_rotation`)."""
    # g = tan(|psi|/4) psi/|psi|
    share = 1.0 / (p[0] + 1.0)
    g = Vector(p[1] * share, p[2] * share, p[3] * share)
    return _unwound(dot(g, g))[0] * g


@kernel
def turn_of(p):
    """Return the `Turn` of the quaternion p: rotation vector psi, half rotation, tan(|psi|/4) psi/|psi|, T^-1(psi).

    p must have w >= 0. T is the tangent map of rotations: exp(psi^ + e^) = exp(psi^) exp((T e)^) to first order in e.
    """
    # g = tan(a/4) psi/a, a = |psi|
    share = 1.0 / (p[0] + 1.0)
    g = Vector(p[1] * share, p[2] * share, p[3] * share)
    wound, whole = _unwound(dot(g, g))
    psi, cosine = wound * g, 1.0 / whole
    # c = (1 - a/2 cot(a/2)) / a^2; for a^2 < 1e-3 its series, because the closed form cancels
    square = dot(psi, psi)
    closed = (1.0 - wound * share * p[0] * 0.5) / select_lt(square, 1e-3, 1.0, square)
    c = select_lt(square, 1e-3, 1.0 / 12.0 + square * (1.0 / 720.0 + square * (1.0 / 30240.0)), closed)
    # T^-1 = 1 + psi^/2 + c psi^ psi^, with psi^ psi^ = psi psi^T - a^2 1
    T = about_identity(1.0 - c * square, 0.5 * psi, c, psi)
    return Turn(psi, (cosine, g[0] * cosine, g[1] * cosine, g[2] * cosine), g, T)


@kernel
def _half_sine(d):
    """Return cos(a/2), sin^2(a/2), a^2 and sin(a/2)/a of the angle a = |d| (rad).

    Below a^2 = 1e-3 the third value is 1 instead of a^2, and the fourth is meaningless: callers use series there.
    """
    square, p = dot(d, d), quaternion(d)
    sine = (p[1] * p[1] + p[2] * p[2]) + p[3] * p[3]
    over = select_lt(square, 1e-3, 1.0, square)
    return p[0], sine, over, square_root(sine / over)


@kernel
def inverse_share(d):
    """Return the coefficient c = (1 - a/2 cot(a/2)) / a^2 in T^-1(d) = 1 + d^/2 + c d^ d^; a = |d| is at most 2 pi.

    d: rotation vector, rad. T is the tangent map of rotations: exp(d^ + e^) = exp(d^) exp((T e)^) to first order in e.
    """
    square, (cosine, _, over, by_square) = dot(d, d), _half_sine(d)
    # series for a^2 < 1e-3, where the closed form cancels
    closed = (1.0 - cosine / (by_square * 2.0)) / over
    return select_lt(square, 1e-3, 1.0 / 12.0 + square * (1.0 / 720.0 + square * (1.0 / 30240.0)), closed)


@kernel
def inverse_map(d, share, x):
    """Return T^-T(d) x = x - d^ x / 2 + c d^ d^ x for a vector x, with c = `share` from `inverse_share(d)`.

    d: rotation vector, rad. d^ b is the cross product of d and b. T is the tangent map of rotations (`inverse_share`).
    """
    y = cross(d, x)
    return x + (-0.5 * y + share * cross(d, y))


@kernel
def tangent_map(d, inverse, x):
    """Return T^T(d) x, or T^-T(d) x where the compile-time flag `inverse` is True.

    d is a rotation vector of at most 2 pi (rad). T^T = 1 + (1 - cos a)/a^2 d^ + (1 - sin(a)/a)/a^2 d^ d^ with a = |d|.
    The tangent map T converts an increment e of d to the increment T e in body axes: exp(d^ + e^) = exp(d^) exp((T
    e)^). If x is conjugate to increments in body axes, T^T x is conjugate to increments of d.
    """
    if inverse:
        return inverse_map(d, inverse_share(d), x)
    square, (cosine, sine, over, by_square) = dot(d, d), _half_sine(d)
    # (1 - cos a)/a^2 and (1 - sin(a)/a)/a^2, by their series for a^2 < 1e-3
    once = select_lt(square, 1e-3, 0.5 - square * (1.0 / 24.0 - square * (1.0 / 720.0)), sine * 2.0 / over)
    closed = (1.0 - cosine * by_square * 2.0) / over
    twice = select_lt(square, 1e-3, 1.0 / 6.0 - square * (1.0 / 120.0 - square * (1.0 / 5040.0)), closed)
    y = cross(d, x)
    return x + (once * y + twice * cross(d, y))


@kernel
def matrix(p):
    """Return the rotation matrix of the quaternion p, which maps vectors from body axes to reference axes."""
    w, x, y, z = p
    x2, y2, z2 = x + x, y + y, z + z
    xx, yy, zz = x * x2, y * y2, z * z2
    xy, xz, yz, wx, wy, wz = x * y2, x * z2, y * z2, w * x2, w * y2, w * z2
    return Matrix(
        Vector(1.0 - (yy + zz), xy - wz, xz + wy),
        Vector(xy + wz, 1.0 - (xx + zz), yz - wx),
        Vector(xz - wy, yz + wx, 1.0 - (xx + yy)),
    )


@superword
def compose_rotation_vectors(psi, d):
    """Return the rotation vector (rad) of exp(psi^) exp(d^): the rotation psi, then the increment d in body axes."""
    return rotation_vector(shortest_rotation(compose(quaternion(psi), quaternion(d))))
