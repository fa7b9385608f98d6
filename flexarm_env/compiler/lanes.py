"""Lanes: one kernel source for a single arm and for several arms, whose numbers are in the lanes of SIMD vectors.

The argument `lane` of a kernel is a *lane tag*, a tuple of zeros whose length L is the number of arms that are advanced
together (`SINGLE` or `EIGHT`). In an array of lanes, element k of all L arms is at `[k*L : (k+1)*L]`. `load(lane,
array, k)` returns a float64 if L = 1 and an LLVM `<L x double>` otherwise. Arithmetic and the functions of this module
accept both types. The compiler neither contracts nor reorders operations. A single arm and an arm in a batch therefore
give bitwise the same results, on all x86 and Arm processors.

With the longer tag `dual(lane, D)` the same source also computes derivatives (forward mode). In memory each element is
then followed by D tangents of L numbers each: its derivatives along D directions. Every operation also computes the
tangents of its result, by the rules in the module `symbols`. `lane_count(lane)` is the number of arms of a tag, with or
without tangents.

Python runs the functions of this module if compilation is disabled. `words` defines the instructions that the compiler
writes for arrays of lanes.
"""

import math

import numpy as np

from .decorator import UNCOMPILED, kernel

SINGLE: tuple[int, ...] = (0,)
EIGHT: tuple[int, ...] = (0,) * 8
WIDEST = SINGLE if UNCOMPILED else EIGHT
"""Lane tag for batches: EIGHT, or SINGLE if compilation is disabled, since Python has no vectors of lanes."""


def dual(lane: tuple[int, ...], tangents: int = 1) -> tuple[int, ...]:
    """Return the lane tag for the same number of arms with `tangents` tangents per number (at most 6 for one arm)."""
    return lane * (1 + tangents)


def shape(length: int) -> tuple[int, int]:
    """Return the number of lanes and the number of tangents of a lane tag with `length` zeros."""
    count = 1 if length % len(EIGHT) else len(EIGHT)
    return count, length // count - 1


def _one(lane: tuple[int, ...]) -> None:
    """Raise RuntimeError for more than one lane, because Python's numbers are single lanes."""
    if len(lane) != 1:
        raise RuntimeError(f"{len(lane)} lanes: there is only one where compilation is disabled (FLEXARM_COMPILER)")


# --- memory ----------------------------------------------------------------------------------------


def load(lane: tuple[int, ...], array: np.ndarray, k: int) -> float:
    """Return element k of every lane of a contiguous array, as one vector."""
    _one(lane)
    return array[k]


def store(array: np.ndarray, k: int, value: float) -> None:
    """Write the vector `value` into element k of every lane."""
    array[k] = value


def splat(lane: tuple[int, ...], x: float) -> float:
    """Return a vector with the scalar x in every lane."""
    _one(lane)
    return x


def load_lane(lane: tuple[int, ...], array: np.ndarray, k: int, i: int) -> float:
    """Return element k of arm i as one number, with its tangents under a dual tag."""
    _one(lane)
    return array[k]


def store_lane(lane: tuple[int, ...], array: np.ndarray, k: int, i: int, value: float) -> None:
    """Write value into element k of arm i, with its tangents under a dual tag."""
    array[k] = value


def stack(lane: tuple[int, ...], sizes: tuple[int, ...]) -> np.ndarray:
    """Return an uninitialized array of `len(sizes)` values per lane that lives until the kernel returns.

    The array becomes registers if the compiler knows every index into it.
    """
    return np.full(len(lane) * len(sizes), np.nan)


def dereference(address):
    """Return the named tuple at an address (see `entry.Placed`)."""
    return address


# --- functions -------------------------------------------------------------------------------------


def size(n):
    """Return a size as a number: n itself if n is an int, or the length of n if n is a tuple of zeros."""
    return len(n) if isinstance(n, tuple) else n


def lane_count(lane: tuple[int, ...]) -> int:
    """Return the number of arms of a lane tag, with or without tangents."""
    _one(lane)
    return 1


def select_lt(a: float, b: float, x: float, y: float) -> float:
    """Return x where a < b, otherwise y (also where a or b is NaN), lane by lane."""
    return x if a < b else y


def absolute(x: float) -> float:
    """Return |x|."""
    return abs(x)


def square_root(x: float) -> float:
    """Return the square root of x."""
    return math.sqrt(x)


def round_even(x: float) -> float:
    """Return the nearest whole number, ties to even."""
    return float(np.rint(x))


def max_over_lanes(x: float) -> float:
    """Return the largest number of all lanes as a float64; NaN is ignored unless all lanes are NaN."""
    return x


def without_tangents(x: float) -> float:
    """Return x without its tangents, that is, as a constant of the differentiation."""
    return x


def with_slope(y: float, x: float, slope: float) -> float:
    """Return y with tangents `slope` times those of x: y is a function of x with the derivative `slope`."""
    return y


def tangents_only(x: float) -> float:
    """Return -0 with the tangents of x; added to a number, it changes only the number's tangents."""
    return -0.0


@kernel
def maximum(x, y):
    """Return the larger of x and y; y where x is NaN."""
    return select_lt(y, x, x, y)


_WHOLE = 6755399441055744.0
"""1.5 * 2^52: adding a number of moderate size rounds it to a whole number, in the lowest bits of the sum."""


def turn(t: float, s: float, c: float) -> tuple[float, float]:
    """Return (sine, cosine) of the angle k pi/2 + r.

    t: number 1.5 * 2^52 + k with an integer k. s: sin r. c: cos r.
    """
    return ((s, c), (c, -s), (-s, -c), (-c, s))[int(t - _WHOLE) % 4 if math.isfinite(t) else 0]


_FAR = 1e15
"""Above this angle a period contains fewer than 50 floats, and `_WHOLE` cannot count right angles."""

# pi/2 in three parts of 33 bits: k * part is exact for |k| < 2^20, so the reduction keeps full precision.
_HALF_PI_1 = 1.57079632673412561417e00
_HALF_PI_2 = 6.07710050630396597660e-11
_HALF_PI_3 = 2.02226624879595063154e-21
# Best polynomials on |r| <= pi/4 (S. Moshier's Cephes): sin r = r + r z S(z), cos r = 1 - z / 2 + z^2 C(z), z = r^2.
_S = (
    -1.66666666666666307295e-1,
    8.33333333332211858878e-3,
    -1.98412698295895385996e-4,
    2.75573136213857245213e-6,
    -2.50507477628578072866e-8,
    1.58962301576546568060e-10,
)
_C = (
    4.16666666666665929218e-2,
    -1.38888888888730564116e-3,
    2.48015872888517045348e-5,
    -2.75573141792967388112e-7,
    2.08757008419747316778e-9,
    -1.13585365213876817300e-11,
)


@kernel
def sincos(x):
    """Return (sin x, cos x), x in rad, with the same bits in any lane.

    The error is below 2e-16 for |x| < 1e6 and below 2e-16 |x| for |x| < 1e15. For larger angles the results are NaN.
    """
    # values without tangents; the derivatives are attached at the end
    given = without_tangents(x)
    angle = select_lt(absolute(given), _FAR, given, math.nan)
    # k: nearest number of right angles; r = x - k pi/2 in three exact steps
    t = angle * (2.0 / math.pi) + _WHOLE
    k = t - _WHOLE
    r = ((angle - k * _HALF_PI_1) - k * _HALF_PI_2) - k * _HALF_PI_3
    # polynomials in z, Estrin's scheme
    z = r * r
    y = z * z
    s = ((z * _S[5] + _S[4]) * y + (z * _S[3] + _S[2])) * y + (z * _S[1] + _S[0])
    s = r + r * (z * s)
    c = ((z * _C[5] + _C[4]) * y + (z * _C[3] + _C[2])) * y + (z * _C[1] + _C[0])
    c = (1.0 - z * 0.5) + y * c
    # rotate by k right angles
    s, c = turn(t, s, c)
    return with_slope(s, x, c), with_slope(c, x, -s)
