"""Where things are in an elastica's data and coordinates."""

from __future__ import annotations

from ...compiler.decorator import kernel
from ...compiler.dispatch import size
from ...compiler.lanes import load, splat, store


@kernel
def offsets(model):  # type: ignore[no-untyped-def]
    """Where R, K, b, w, tips, beta and the single numbers begin in model.data; P begins at 0."""
    n = size(model.nodes)
    m = size(model.links) * n
    R = m * m
    b = R + 2 * m * n
    return R, R + m * n, b, b + m, b + 2 * m, b + 3 * m, b + 4 * m


@kernel
def weighted(lane, weights, first, x, m):  # type: ignore[no-untyped-def]
    """sum_j weights[first + j] x_j."""
    total = splat(lane, 0.0)
    for j in range(m):
        total = total + load(lane, x, j) * weights[first + j]
    return total


@kernel
def absolute(lane, model, q, x):  # type: ignore[no-untyped-def]
    """x <- angles of the nodes (or their rates) from the coordinates: a joint's is relative to the tip before it."""
    n = size(model.nodes)
    for i in range(n):
        store(x, i, load(lane, q, i))
    for k in range(1, size(model.links)):
        store(x, k * n, load(lane, q, k * n) + load(lane, q, k * n - 1))
        for i in range(k * n + 1, k * n + n):
            store(x, i, load(lane, q, i))
