"""Functions of a geometrically exact element on [-1, 1] and their Gauss points, for each polynomial order."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.polynomial import legendre


@dataclass(frozen=True)
class Tables:
    """Functions of an element on [-1, 1]: left and right linear ones, then the interior ones.

    weights (p,) of the Gauss points; value (p + 1, p), slope (p, p): values, and twice the derivatives of (right -
    left, interior ...), at the Gauss points; mass (p + 1, p + 1): integrals of products; norm (p,): sum w slope^2.
    """

    weights: np.ndarray
    value: np.ndarray
    slope: np.ndarray
    mass: np.ndarray
    norm: np.ndarray


def interior(order: int, x: np.ndarray) -> np.ndarray:
    """Interior functions at points x of [-1, 1], shape (order - 1, len(x))."""
    points = legendre.leggauss(order)[0]
    rows = []
    for k in range(1, order):
        polynomial = np.eye(order + 1)[k]
        values = legendre.legval(points, polynomial)
        scale = values[np.argmax(np.abs(values).round(12))]
        primitive = legendre.legint(polynomial / scale, lbnd=-1.0)
        rows.append(0.5 * legendre.legval(np.asarray(x, dtype=np.float64), primitive))
    return np.array(rows).reshape(order - 1, np.size(x))


def functions(order: int, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """At points x of [-1, 1]: values (order + 1, len(x)) and slopes (order, len(x)) as :class:`Tables` has them."""
    points = legendre.leggauss(order)[0]
    slopes = [np.ones(np.size(x))]
    for k in range(1, order):
        values = legendre.legval(points, np.eye(order)[k])
        scale = values[np.argmax(np.abs(values).round(12))]
        slopes.append(legendre.legval(x, np.eye(order)[k]) / scale)
    return np.vstack([0.5 * (1.0 - x), 0.5 * (1.0 + x), interior(order, x)]), np.array(slopes)


@cache
def tables(order: int) -> Tables:
    """The tables of an order from 1 to 3 (or more)."""
    points, weights = legendre.leggauss(order)

    def value(x: np.ndarray) -> np.ndarray:
        return np.vstack([0.5 * (1.0 - x), 0.5 * (1.0 + x), interior(order, x)])

    slope = [np.ones(order)]
    for k in range(1, order):
        values = legendre.legval(points, np.eye(order)[k])
        slope.append(values / values[np.argmax(np.abs(values).round(12))])
    fine, fine_weights = legendre.leggauss(order + 1)
    at = value(fine)
    slopes = np.array([_tidy(row) for row in slope])
    mass = _tidy((at * fine_weights) @ at.T)
    return Tables(_tidy(weights), value(points), slopes, mass, (weights * slopes**2).sum(1))


def _tidy(values: np.ndarray) -> np.ndarray:
    """Round-off taken out of numbers that are simple."""
    values = np.where(np.abs(values) < 1e-14, 0.0, values)
    simple = np.round(values * 60.0) / 60.0
    return np.where(np.abs(values - simple) < 1e-14, simple, values)
