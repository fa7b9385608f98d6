"""Linear algebra: small matrices of a model that is built, and, for kernels, band LU with partial pivoting.

A model is made by `product` and `solve`, whose operations have one order: NumPy's own call a library (BLAS) that adds
up in another order on another processor, and an arm that stands upright goes another way by the last bit.

Of a band matrix, rows stored contiguously, entry (i, j) of n x n with half widths `below` and `above` lies at
`A[i*width + j - i + below]`, with `width = 2*below + above + 1`: the extra `below` columns take the fill that row
exchanges cause.
"""

from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..compiler import absolute, kernel, largest, load, store


def product(a: ArrayLike, b: ArrayLike) -> NDArray[Any]:
    """a @ b of vectors and matrices, the same bits on every processor."""
    columns, rows = np.moveaxis(np.asarray(a), -1, 0), np.asarray(b)
    return np.asarray(reduce(np.add, map(np.multiply.outer, columns, rows)))


def solve(a: ArrayLike, b: ArrayLike) -> NDArray[Any]:
    """x of a x = b, a (n, n), b (n,) or (n, p), by elimination, rows exchanged; the same bits on every processor.
    LinAlgError where a row is left without a pivot."""
    a, x = np.array(a, np.float64), np.array(b, np.float64)
    for k in range(len(a)):
        best = k + int(np.argmax(abs(a[k:, k])))
        for rows in (a, x):
            rows[[k, best]] = rows[[best, k]]
        if not abs(a[k, k]) > 0.0:
            raise np.linalg.LinAlgError("singular matrix")
        others = np.arange(len(a)) != k
        x[k] /= a[k, k]
        a[k] /= a[k, k]
        x[others] -= np.multiply.outer(a[others, k], x[k])
        a[others] -= np.multiply.outer(a[others, k], a[k])
    return x


@kernel
def _exchange(lane, A, i, j):
    x = load(lane, A, i)
    store(A, i, load(lane, A, j))
    store(A, j, x)


@kernel
def band_lu(lane, A, pivot, n, below, above):
    """Factor A in place; `pivot[i]` (a float64) is the row exchanged with row i. A zero pivot leaves inf or NaN.

    lane: of one arm, with tangents or without; its values say which rows are exchanged.
    """
    width = 2 * below + above + 1
    for k in range(n):
        last = min(n - 1, k + below)
        pivot_size, p = largest(absolute(load(lane, A, k * width + below))), k
        for i in range(k + 1, last + 1):
            candidate = largest(absolute(load(lane, A, i * width + k - i + below)))
            if candidate > pivot_size:
                pivot_size, p = candidate, i
        pivot[k] = p
        right = min(n - 1, k + below + above)
        if p != k:
            a, b = k * width + below - k, p * width + below - p
            for j in range(k, right + 1):
                _exchange(lane, A, a + j, b + j)
        row = k * width + below - k
        inverse = 1.0 / load(lane, A, row + k)
        for i in range(k + 1, last + 1):
            other = i * width + below - i
            factor = load(lane, A, other + k) * inverse
            store(A, other + k, factor)
            if len(lane) > 1 or largest(absolute(factor)) != 0.0:  # a tangent may be there where there is no value
                for j in range(k + 1, right + 1):
                    store(A, other + j, load(lane, A, other + j) - factor * load(lane, A, row + j))


@kernel
def band_lu_solve(lane, A, pivot, x, n, below, above):
    """x <- A^-1 x with the factors of `band_lu`."""
    width = 2 * below + above + 1
    for k in range(n):
        p = int(pivot[k])
        if p != k:
            _exchange(lane, x, k, p)
        value = load(lane, x, k)
        if len(lane) > 1 or largest(absolute(value)) != 0.0:
            for i in range(k + 1, min(n - 1, k + below) + 1):
                store(x, i, load(lane, x, i) - load(lane, A, i * width + k - i + below) * value)
    for k in range(n - 1, -1, -1):
        row = k * width + below - k
        total = load(lane, x, k)
        for j in range(k + 1, min(n - 1, k + below + above) + 1):
            total = total - load(lane, A, row + j) * load(lane, x, j)
        store(x, k, total / load(lane, A, row + k))
