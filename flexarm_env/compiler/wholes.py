"""Ratio of two integers, rounded once to float64 as in Python, for integers of any size up to 64 bits."""

import numpy as np

from .decorator import kernel, noinline

EXACT = 2**53
"""Integers up to this size are represented exactly by float64."""

_ENOUGH = np.uint64(2**55)
"""A quotient from 2^55 on has three bits more than float64. With a sticky last bit it rounds like the exact ratio."""


@kernel
def ratio(p, q):
    """Return p / q of two int64 as float64, correctly rounded; an infinity or NaN for q = 0."""
    # both are exact as float64, so one division rounds once
    if -EXACT <= p <= EXACT and -EXACT <= q <= EXACT:
        return float(p) / float(q)
    return _far_ratio(p, q)


@noinline
def _far_ratio(p, q):
    """Return p / q of two int64 as float64 by long division of their magnitudes, correctly rounded.

    Binary digits of the quotient are computed until it has 56 bits or the division ends. The result is `whole * scale`.
    """
    # magnitudes; -2^63 negated wraps to 2^63 as unsigned
    a, b = np.uint64(-p if p < 0 else p), np.uint64(-q if q < 0 else q)
    result = float(p) / float(q)
    if q != 0:
        whole, rest, scale = a // b, a % b, 1.0
        # append the next binary digit
        while rest != 0 and whole < _ENOUGH:
            whole, rest, scale = whole << np.uint64(1), rest << np.uint64(1), scale * 0.5
            if rest >= b:
                whole, rest = whole | np.uint64(1), rest - b
        # sticky bit: a remainder is left, which decides ties
        if rest != 0:
            whole = whole | np.uint64(1)
        result = float(whole) * scale if (p < 0) == (q < 0) else -float(whole) * scale
    return result
