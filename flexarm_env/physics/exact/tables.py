"""Shape functions of a geometrically exact element on [-1, 1], their values at Gauss points, and their traced sums.

The function `tables` and the functions that it calls use NumPy. `Sums` and the functions after it run in traced
functions and take run-time values. The nodes of an element of order p are left vertex, right vertex, and p - 1 interior
functions that vanish at both ends.
"""

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.polynomial import legendre

from ..linalg import product


@dataclass(frozen=True)
class Tables:
    """Shape functions of an element of order p at its p Gauss points on [-1, 1]: two linear ones, and interior ones.

    Slopes are stored as twice the derivative on [-1, 1], which equals l times the derivative along an element of length
    l.
    """

    weights: np.ndarray  # (p,), weights of the Gauss points; their sum is 2
    value: np.ndarray  # (p + 1, p), shape functions (left, right, interior ...) at the Gauss points
    slope: np.ndarray  # (p, p), twice the derivatives of (right - left, interior ...) at the Gauss points
    mass: np.ndarray  # (p + 1, p + 1), integrals of products of the functions over [-1, 1]
    norm: np.ndarray  # (p,), sums of w slope^2 over the Gauss points


def _scaled(order: int, evaluate: Any) -> list[np.ndarray]:
    """Return evaluate(f, scale) for each interior function, where f is the function's slope as an unscaled series.

    The slope f is a Legendre series. scale is the value of f with the largest magnitude at the `order` Gauss points.
    """
    points = legendre.leggauss(order)[0]
    found = []
    for k in range(1, order):
        polynomial = np.eye(order + 1)[k]
        values = legendre.legval(points, polynomial)
        found.append(evaluate(polynomial, values[np.argmax(np.abs(values).round(12))]))
    return found


def interior(order: int, x: np.ndarray) -> np.ndarray:
    """Return the interior functions at points x of [-1, 1], (order - 1, len(x)): integrals of scaled Legendre P_k."""
    x = np.asarray(x, dtype=np.float64)
    rows = _scaled(order, lambda f, scale: 0.5 * legendre.legval(x, legendre.legint(f / scale, lbnd=-1.0)))
    return np.array(rows).reshape(order - 1, np.size(x))


def functions(order: int, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return values (order + 1, len(x)) and slopes (order, len(x)) of all shape functions at points x of [-1, 1]."""
    slopes = [np.ones(np.size(x)), *_scaled(order, lambda f, scale: legendre.legval(x, f) / scale)]
    return np.vstack([0.5 * (1.0 - x), 0.5 * (1.0 + x), interior(order, x)]), np.array(slopes)


@cache
def tables(order: int) -> Tables:
    """Return the `Tables` (shape functions at Gauss points) for a polynomial order of 1 or more."""
    # p Gauss points for the strains (reduced), p + 1 for the mass
    points, weights = legendre.leggauss(order)
    value, slopes = functions(order, points)
    slopes = np.array([_tidy(row) for row in slopes])
    # int g_i g_j: products of degree 2p, exact with p + 1 Gauss points
    fine, fine_weights = legendre.leggauss(order + 1)
    at = functions(order, fine)[0]
    mass = _tidy(product(at * fine_weights, at.T))
    return Tables(_tidy(weights), value, slopes, mass, (weights * slopes**2).sum(1))


def _tidy(values: np.ndarray) -> np.ndarray:
    """Round each value within 1e-14 of 0 or of a multiple of 1/60 to 0 or to that multiple."""
    values = np.where(np.abs(values) < 1e-14, 0.0, values)
    simple = np.round(values * 60.0) / 60.0
    return np.where(np.abs(values - simple) < 1e-14, simple, values)


class Sums:
    """Emit sums of traced values with constant coefficients. A multiple of an earlier sum is computed from that sum."""

    def __init__(self) -> None:
        self.known: dict[Any, Any] = {}

    def __call__(self, coefficients: Any, values: Any, factor: float = 1.0, unit: Any = None) -> Any:
        """Return factor * unit * (sum of coefficient * value), or 0.0 if all coefficients are 0; unit: traced value."""
        terms = [(float(c), v) for c, v in zip(coefficients, values, strict=True) if abs(c) > 1e-14]
        if not terms:
            return 0.0
        # the sum over its first coefficient: one sum serves all its multiples
        first = terms[0][0]
        ratios = [_near_one(c / first) for c, _ in terms]
        key = tuple((ratio, id(v)) for ratio, (_, v) in zip(ratios, terms, strict=True))
        if key not in self.known:
            total = terms[0][1]
            for ratio, (_, v) in zip(ratios[1:], terms[1:], strict=True):
                total = total + v if ratio == 1.0 else total - v if ratio == -1.0 else total + v * ratio
            self.known[key] = total, terms  # the terms live on, so that their ids stay theirs
        if unit is not None:
            return self.known[key][0] * (unit * (first * factor))
        return times(self.known[key][0], first * factor)


def _near_one(ratio: float) -> float:
    """Return 1 or -1 if the ratio is within 1e-14 of it; otherwise return the ratio."""
    return round(ratio) if abs(abs(ratio) - 1.0) < 1e-14 else ratio


def times(value: Any, factor: float) -> Any:
    """Return value * factor, without emitting a multiplication if the factor is 1 or -1."""
    factor = _near_one(factor)
    return value if factor == 1.0 else -value if factor == -1.0 else value * factor


def slopes(sums: Sums, t: Tables, nodes: list[Any]) -> tuple[Any, list[Any]]:
    """Return a coordinate's right minus left value, and l times its derivative along the element at Gauss points.

    nodes: left, right, interior values of the coordinate. t: `Tables` of the element.
    """
    span = nodes[1] - nodes[0]
    return span, [sums(column, [span, *nodes[2:]]) for column in t.slope.T]


def values_at(sums: Sums, t: Tables, nodes: list[Any], span: Any) -> list[Any]:
    """Return a coordinate's values at the Gauss points; nodes: left, right, interior values; span: right minus left."""
    # even and odd functions apart: Gauss points come in pairs, which share both sums
    middle = (nodes[0] + nodes[1]) * 0.5
    values = []
    for v in t.value.T:
        even = sums([1.0, *v[2::2]], [middle, *nodes[2::2]])
        odd = sums([0.5 * (v[1] - v[0]), *v[3::2]], [span, *nodes[3::2]])
        values.append(even if isinstance(odd, float) and odd == 0.0 else even + odd)
    return values
