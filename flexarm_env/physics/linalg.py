"""Band LU with partial pivoting, rows stored contiguously.

Entry (i, j) of an n x n matrix with half widths `below` and `above` lies at `A[i*width + j - i + below]`,
with `width = 2*below + above + 1`: the extra `below` columns take the fill that row exchanges cause.
"""

from __future__ import annotations

from ..compiler import kernel


@kernel
def band_lu(A, pivot, n, below, above):
    """Factor A in place; `pivot[i]` (a float64) is the row exchanged with row i. A zero pivot leaves inf or NaN."""
    width = 2 * below + above + 1
    for k in range(n):
        last = min(n - 1, k + below)
        pivot_size, p = abs(A[k * width + below]), k
        for i in range(k + 1, last + 1):
            candidate = abs(A[i * width + k - i + below])
            if candidate > pivot_size:
                pivot_size, p = candidate, i
        pivot[k] = p
        right = min(n - 1, k + below + above)
        if p != k:
            a, b = k * width + below - k, p * width + below - p
            for j in range(k, right + 1):
                A[a + j], A[b + j] = A[b + j], A[a + j]
        row = k * width + below - k
        inverse = 1.0 / A[row + k]
        for i in range(k + 1, last + 1):
            other = i * width + below - i
            factor = A[other + k] * inverse
            A[other + k] = factor
            if factor != 0.0:
                for j in range(k + 1, right + 1):
                    A[other + j] -= factor * A[row + j]


@kernel
def band_lu_solve(A, pivot, x, n, below, above):
    """x <- A^-1 x with the factors of `band_lu`."""
    width = 2 * below + above + 1
    for k in range(n):
        p = int(pivot[k])
        if p != k:
            x[k], x[p] = x[p], x[k]
        value = x[k]
        if value != 0.0:
            for i in range(k + 1, min(n - 1, k + below) + 1):
                x[i] -= A[i * width + k - i + below] * value
    for k in range(n - 1, -1, -1):
        row = k * width + below - k
        total = x[k]
        for j in range(k + 1, min(n - 1, k + below + above) + 1):
            total -= A[row + j] * x[j]
        x[k] = total / A[row + k]
