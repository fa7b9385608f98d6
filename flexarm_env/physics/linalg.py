"""Linear algebra: small dense systems for the assembly, and band LU with partial pivoting for kernels.

The assembly uses `product` and `solve`, which sum in a fixed order. NumPy's functions call a library (BLAS) whose order
of sums depends on the processor. A difference in the last bit can decide to which side an upright arm falls.

Band storage of an n x n matrix with half widths `below` and `above`: rows are contiguous. Entry (i, j) is A[i*width + j
- i + below] with `width = 2*below + above + 1`. The extra `below` columns receive the fill-in of row exchanges.
"""

from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..compiler import Lanes, absolute, kernel, max_over_lanes


def product(a: ArrayLike, b: ArrayLike) -> NDArray[Any]:
    """Return a @ b of vectors and matrices, with the same bits on every processor."""
    columns, rows = np.moveaxis(np.asarray(a), -1, 0), np.asarray(b)
    return np.asarray(reduce(np.add, map(np.multiply.outer, columns, rows)))


def solve(a: ArrayLike, b: ArrayLike) -> NDArray[Any]:
    """Return the solution x of a x = b by Gauss-Jordan elimination with row exchanges; a (n, n), b (n,) or (n, p).

    The result has the same bits on every processor. The function raises LinAlgError if a column has no pivot.
    """
    a, x = np.array(a, np.float64), np.array(b, np.float64)
    for k in range(len(a)):
        # pivot: the largest |a_ik|, because minors may vanish
        best = k + int(np.argmax(abs(a[k:, k])))
        for rows in (a, x):
            rows[[k, best]] = rows[[best, k]]
        if not abs(a[k, k]) > 0.0:
            raise np.linalg.LinAlgError("singular matrix")
        # Gauss-Jordan: row k / a_kk, then column k is eliminated from all other rows, whose sums have a set order
        others = np.arange(len(a)) != k
        x[k] /= a[k, k]
        a[k] /= a[k, k]
        x[others] -= np.multiply.outer(a[others, k], x[k])
        a[others] -= np.multiply.outer(a[others, k], a[k])
    return x


@kernel
def _exchange(lane, A: Lanes, i, j):
    """Exchange elements i and j of A, an array of lanes."""
    x = A[i]
    A[i] = A[j]
    A[j] = x


@kernel
def band_lu(lane, A: Lanes, pivot, n, below, above):
    """Factor a band matrix A = P^-1 L U in place, with partial pivoting; n rows, half widths `below` and `above`.

    Entry (i, j) is A[i * width + j - i + below], width = 2 below + above + 1. The extra `below` columns receive the
    fill-in of row exchanges. U replaces the upper part of A; the factors of L replace the eliminated entries. pivot[i]
    is the index (as float64) of the row that is exchanged with row i. A zero pivot causes inf or NaN entries.
    lane: lane tag of one arm, with or without tangents (derivatives along directions). Only values, not tangents,
    select the rows.
    """
    width = 2 * below + above + 1
    for k in range(n):
        last = min(n - 1, k + below)
        # pivot: largest |A_ik|, i >= k within the band, by values alone: tangents do not choose rows
        pivot_size, p = max_over_lanes(absolute(A[k * width + below])), k
        for i in range(k + 1, last + 1):
            candidate = max_over_lanes(absolute(A[i * width + k - i + below]))
            if candidate > pivot_size:
                pivot_size, p = candidate, i
        pivot[k] = p
        right = min(n - 1, k + below + above)
        # exchange rows k and p; their entries start at different offsets of the band
        if p != k:
            a, b = k * width + below - k, p * width + below - p
            for j in range(k, right + 1):
                _exchange(lane, A, a + j, b + j)
        # eliminate column k; the factors of L replace the zeros
        row = k * width + below - k
        inverse = 1.0 / A[row + k]
        for i in range(k + 1, last + 1):
            other = i * width + below - i
            factor = A[other + k] * inverse
            A[other + k] = factor
            # skip zero factors, unless they may have tangents
            if len(lane) > 1 or max_over_lanes(absolute(factor)) != 0.0:
                for j in range(k + 1, right + 1):
                    A[other + j] -= factor * A[row + j]


@kernel
def band_lu_solve(lane, A: Lanes, pivot, x: Lanes, n, below, above):
    """Solve A x = b in place: on entry x (n,) contains b, on return the solution.

    A, pivot: factors and row exchanges from `band_lu`.
    below, above: half widths of the band. Row i of A begins at A[i * width], width = 2 below + above + 1; its diagonal
    entry is A[i * width + below].
    """
    width = 2 * below + above + 1
    # x <- L^-1 P x
    for k in range(n):
        p = int(pivot[k])
        if p != k:
            _exchange(lane, x, k, p)
        value = x[k]
        if len(lane) > 1 or max_over_lanes(absolute(value)) != 0.0:
            for i in range(k + 1, min(n - 1, k + below) + 1):
                x[i] -= A[i * width + k - i + below] * value
    # x <- U^-1 x
    for k in range(n - 1, -1, -1):
        row = k * width + below - k
        total = x[k]
        for j in range(k + 1, min(n - 1, k + below + above) + 1):
            total = total - A[row + j] * x[j]
        x[k] = total / A[row + k]
