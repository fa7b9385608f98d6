"""Rotations in NumPy: rotation vectors, matrices and quaternions, many at once along the leading axes.

A rotation matrix maps components in body axes to components in inertial axes. The rotation vector psi (rad) has the
matrix exp(psi^), where psi^ b = psi x b for every vector b.
"""

from typing import Any

import numpy as np

from flexarm_env.validation import Array


def skew(a: Any) -> Array:
    """Return the skew matrices a^ (..., 3, 3) of vectors a (..., 3), with a^ b = a x b."""
    x, y, z = np.moveaxis(np.asarray(a, np.float64), -1, 0)
    zero = np.zeros_like(x)
    rows = ((zero, -z, y), (z, zero, -x), (-y, x, zero))
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def cross(a: Array, b: Array) -> Array:
    """Return the cross product of vectors (..., 3), without the call overhead of `numpy.cross`."""
    found: Array = np.empty(np.broadcast_shapes(a.shape, b.shape))
    found[..., 0] = a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1]
    found[..., 1] = a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2]
    found[..., 2] = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return found


def matrices(psi: Any) -> Array:
    """Return the rotation matrices exp(psi^), (..., 3, 3), of rotation vectors psi (..., 3), rad."""
    psi = np.asarray(psi, np.float64)
    angle = np.sqrt((psi**2).sum(axis=-1))[..., None, None]
    hat = skew(psi)
    # 1 + sin(a)/a psi^ + (1 - cos a)/a^2 psi^^2, with 1 - cos a = 2 sin^2(a/2)
    half = np.sinc(angle / (2.0 * np.pi))  # sin(a/2) / (a/2)
    return np.asarray(np.eye(3) + np.sinc(angle / np.pi) * hat + 0.5 * half**2 * hat @ hat)


def slope(psi: Array) -> Array:
    """Return the tangent map T (..., 3, 3) of rotation vectors psi (..., 3), rad.

    T maps changes of psi to rotations in body axes: exp(psi^ + d psi^) = exp(psi^) exp((T d psi)^).
    """
    angle, hat = np.sqrt((psi**2).sum(axis=-1))[..., None, None], skew(psi)
    # T = 1 - (1 - cos a)/a^2 psi^ + (a - sin a)/a^3 psi^^2, by its series below a = 0.01
    half, far = np.sinc(angle / (2.0 * np.pi)), np.maximum(angle, 1e-2)
    third = np.where(angle > 1e-2, (far - np.sin(far)) / far**3, (1.0 - angle**2 / 20.0) / 6.0)
    return np.asarray(np.eye(3) - 0.5 * half**2 * hat + third * hat @ hat)


def quaternions(A: Any) -> Array:
    """Return the quaternions (..., 4) of rotation matrices (..., 3, 3), with the real part w >= 0 first."""
    A = np.asarray(A, np.float64)
    trace = A[..., 0, 0] + A[..., 1, 1] + A[..., 2, 2]
    # four times the products of the quaternion's entries; the row of its largest entry has no round-off
    products = np.empty((*A.shape[:-2], 4, 4))
    products[..., 0, 0] = 1.0 + trace
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        products[..., 0, i + 1] = products[..., i + 1, 0] = A[..., k, j] - A[..., j, k]
        products[..., i + 1, i + 1] = 1.0 - trace + 2.0 * A[..., i, i]
        products[..., i + 1, j + 1] = products[..., j + 1, i + 1] = A[..., i, j] + A[..., j, i]
    largest = np.argmax(np.einsum("...ii->...i", products), axis=-1)
    row = np.take_along_axis(products, largest[..., None, None], axis=-2)[..., 0, :]
    row = row / np.sqrt((row**2).sum(axis=-1))[..., None]
    return np.asarray(np.where(row[..., :1] < 0.0, -row, row))


def vectors(A: Any) -> Array:
    """Return the rotation vectors (..., 3), with lengths of at most pi rad, of rotation matrices (..., 3, 3)."""
    return of_quaternions(quaternions(A))


def of_quaternions(p: Array) -> Array:
    """Return the rotation vectors (..., 3), with lengths of at most pi rad, of quaternions (..., 4) with w >= 0."""
    sine = np.sqrt((p[..., 1:] ** 2).sum(axis=-1))
    angle = 2.0 * np.arctan2(sine, p[..., 0])
    # angle over sine of half of it; 2 in the limit of small angles
    share = np.where(sine > 1e-12, angle / np.where(sine > 1e-12, sine, 1.0), 2.0)
    return np.asarray(p[..., 1:] * share[..., None])


def turned(A: Array, b: Any) -> Array:
    """Return A b: vectors b (..., 3) in body axes, mapped to inertial axes by rotation matrices A (..., 3, 3)."""
    return np.asarray((A @ np.asarray(b, np.float64)[..., None])[..., 0])


def back(A: Array, b: Any) -> Array:
    """Return A^T b: vectors b (..., 3) in inertial axes, mapped to body axes by rotation matrices A (..., 3, 3)."""
    return turned(np.swapaxes(A, -1, -2), b)
