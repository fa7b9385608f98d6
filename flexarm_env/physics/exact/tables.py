"""Functions of a geometrically exact element on [-1, 1], their Gauss points, for each polynomial order, and sums.

What takes values of run time (`Sums` and what follows it) is for traced functions.
"""

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.polynomial import legendre

from ..linalg import product


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


def _scaled(order: int, evaluate: Any) -> list[np.ndarray]:
    """What `evaluate` makes of each interior function's slope, a Legendre series, and of its largest Gauss value."""
    points = legendre.leggauss(order)[0]
    found = []
    for k in range(1, order):
        polynomial = np.eye(order + 1)[k]
        values = legendre.legval(points, polynomial)
        found.append(evaluate(polynomial, values[np.argmax(np.abs(values).round(12))]))
    return found


def interior(order: int, x: np.ndarray) -> np.ndarray:
    """Interior functions at points x of [-1, 1], shape (order - 1, len(x))."""
    x = np.asarray(x, dtype=np.float64)
    rows = _scaled(order, lambda f, scale: 0.5 * legendre.legval(x, legendre.legint(f / scale, lbnd=-1.0)))
    return np.array(rows).reshape(order - 1, np.size(x))


def functions(order: int, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """At points x of [-1, 1]: values (order + 1, len(x)) and slopes (order, len(x)) as :class:`Tables` has them."""
    slopes = [np.ones(np.size(x)), *_scaled(order, lambda f, scale: legendre.legval(x, f) / scale)]
    return np.vstack([0.5 * (1.0 - x), 0.5 * (1.0 + x), interior(order, x)]), np.array(slopes)


@cache
def tables(order: int) -> Tables:
    """The tables of an order from 1 to 3 (or more)."""
    points, weights = legendre.leggauss(order)
    value, slopes = functions(order, points)
    slopes = np.array([_tidy(row) for row in slopes])
    fine, fine_weights = legendre.leggauss(order + 1)
    at = functions(order, fine)[0]
    mass = _tidy(product(at * fine_weights, at.T))
    return Tables(_tidy(weights), value, slopes, mass, (weights * slopes**2).sum(1))


def _tidy(values: np.ndarray) -> np.ndarray:
    """Round-off taken out of numbers that are simple."""
    values = np.where(np.abs(values) < 1e-14, 0.0, values)
    simple = np.round(values * 60.0) / 60.0
    return np.where(np.abs(values - simple) < 1e-14, simple, values)


class Sums:
    """Sums of values with known coefficients, each written once: what is a multiple of another sum is not repeated."""

    def __init__(self) -> None:
        self.known: dict[Any, Any] = {}

    def __call__(self, coefficients: Any, values: Any, factor: float = 1.0, unit: Any = None) -> Any:
        """factor * unit * sum of coefficient * value; 0.0 where all coefficients vanish. `unit`: a scalar symbol."""
        terms = [(float(c), v) for c, v in zip(coefficients, values, strict=True) if abs(c) > 1e-14]
        if not terms:
            return 0.0
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
    return round(ratio) if abs(abs(ratio) - 1.0) < 1e-14 else ratio


def times(value: Any, factor: float) -> Any:
    factor = _near_one(factor)
    return value if factor == 1.0 else -value if factor == -1.0 else value * factor


def slopes(sums: Sums, t: Tables, nodes: list[Any]) -> tuple[Any, list[Any]]:
    """Right less left value, and d (slope times l) at the Gauss points."""
    span = nodes[1] - nodes[0]
    return span, [sums(column, [span, *nodes[2:]]) for column in t.slope.T]


def values_at(sums: Sums, t: Tables, nodes: list[Any], span: Any) -> list[Any]:
    """The coordinate at the Gauss points: even and odd functions apart, since points come in pairs."""
    middle = (nodes[0] + nodes[1]) * 0.5
    values = []
    for v in t.value.T:
        even = sums([1.0, *v[2::2]], [middle, *nodes[2::2]])
        odd = sums([0.5 * (v[1] - v[0]), *v[3::2]], [span, *nodes[3::2]])
        values.append(even if isinstance(odd, float) and odd == 0.0 else even + odd)
    return values
