"""What is kept of arms, to be gone back to: q, v, a, b, books, inputs, and of the record what there is room for."""

from __future__ import annotations

from ...compiler.decorator import kernel
from ...compiler.lanes import load, store


@kernel
def keep(lane, n, w, record, saved):  # type: ignore[no-untyped-def]
    """All lanes into `saved`."""
    for k in range(n):
        store(saved, k, load(lane, w.q, k))
        store(saved, n + k, load(lane, w.v, k))
        store(saved, 2 * n + k, load(lane, w.a, k))
        store(saved, 3 * n + k, load(lane, w.b, k))
    for k in range(3):
        store(saved, 4 * n + k, load(lane, w.books, k))
    for k in range(w.u.shape[0] // len(lane)):
        store(saved, 4 * n + 3 + k, load(lane, w.u, k))
    first = (4 * n + 3) * len(lane) + w.u.shape[0]
    for k in range(saved.shape[0] - first):  # the record too, where a period may change it on the way
        saved[first + k] = record[k]


@kernel
def put_back(lanes, i, n, w, saved, record):  # type: ignore[no-untyped-def]
    """Lane i as it was when the period began."""
    for k in range(n):
        w.q[k * lanes + i] = saved[k * lanes + i]
        w.v[k * lanes + i] = saved[(n + k) * lanes + i]
        w.a[k * lanes + i] = saved[(2 * n + k) * lanes + i]
        w.b[k * lanes + i] = saved[(3 * n + k) * lanes + i]
    for k in range(3):
        w.books[k * lanes + i] = saved[(4 * n + k) * lanes + i]
    first = 4 * n + 3
    for k in range(w.u.shape[0] // lanes):
        w.u[k * lanes + i] = saved[(first + k) * lanes + i]
    first += w.u.shape[0] // lanes
    for k in range(saved.shape[0] // lanes - first):
        record[k * lanes + i] = saved[(first + k) * lanes + i]


@kernel
def keep_lane(lanes, i, n, w, record, saved):  # type: ignore[no-untyped-def]
    """Lane i into `saved`: what `put_back` takes out."""
    for k in range(n):
        saved[k * lanes + i] = w.q[k * lanes + i]
        saved[(n + k) * lanes + i] = w.v[k * lanes + i]
        saved[(2 * n + k) * lanes + i] = w.a[k * lanes + i]
        saved[(3 * n + k) * lanes + i] = w.b[k * lanes + i]
    for k in range(3):
        saved[(4 * n + k) * lanes + i] = w.books[k * lanes + i]
    first = 4 * n + 3
    for k in range(w.u.shape[0] // lanes):
        saved[(first + k) * lanes + i] = w.u[k * lanes + i]
    first += w.u.shape[0] // lanes
    for k in range(saved.shape[0] // lanes - first):
        saved[(first + k) * lanes + i] = record[k * lanes + i]
