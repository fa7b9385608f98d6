"""What is kept of arms, to be gone back to: a `tasks.program.SAVED`, with of the record what there is room for."""

from __future__ import annotations

from ..compiler import kernel, load, store
from ..tasks.program import saved_at


@kernel
def keep(lane, n, w, record, saved):
    """All lanes into `saved`."""
    inputs, motions = w.u.shape[0] // len(lane), w.reaction.shape[0] // len(lane)
    at = saved_at(0, n, inputs, motions, 0)
    for k in range(n):
        store(saved, at.q + k, load(lane, w.q, k))
        store(saved, at.v + k, load(lane, w.v, k))
        store(saved, at.a + k, load(lane, w.a, k))
        store(saved, at.b + k, load(lane, w.b, k))
    for k in range(at.inputs - at.books):
        store(saved, at.books + k, load(lane, w.books, k))
    for k in range(inputs):
        store(saved, at.inputs + k, load(lane, w.u, k))
    for k in range(3 * motions):
        store(saved, at.psi + k, load(lane, w.psi, k))
    for k in range(motions):
        store(saved, at.reaction + k, load(lane, w.reaction, k))
    first = at.record * len(lane)
    for k in range(saved.shape[0] - first):  # the record too, where a period may change it on the way
        saved[first + k] = record[k]


@kernel
def put_back(lanes, i, n, w, saved, record):
    """Lane i as it was kept."""
    inputs, motions = w.u.shape[0] // lanes, w.reaction.shape[0] // lanes
    at = saved_at(0, n, inputs, motions, 0)
    for k in range(n):
        w.q[k * lanes + i] = saved[(at.q + k) * lanes + i]
        w.v[k * lanes + i] = saved[(at.v + k) * lanes + i]
        w.a[k * lanes + i] = saved[(at.a + k) * lanes + i]
        w.b[k * lanes + i] = saved[(at.b + k) * lanes + i]
    for k in range(at.inputs - at.books):
        w.books[k * lanes + i] = saved[(at.books + k) * lanes + i]
    for k in range(inputs):
        w.u[k * lanes + i] = saved[(at.inputs + k) * lanes + i]
    for k in range(3 * motions):
        w.psi[k * lanes + i] = saved[(at.psi + k) * lanes + i]
    for k in range(motions):
        w.reaction[k * lanes + i] = saved[(at.reaction + k) * lanes + i]
    for k in range(saved.shape[0] // lanes - at.record):
        record[k * lanes + i] = saved[(at.record + k) * lanes + i]


@kernel
def keep_lane(lanes, i, n, w, record, saved):
    """Lane i into `saved`: what `put_back` takes out."""
    inputs, motions = w.u.shape[0] // lanes, w.reaction.shape[0] // lanes
    at = saved_at(0, n, inputs, motions, 0)
    for k in range(n):
        saved[(at.q + k) * lanes + i] = w.q[k * lanes + i]
        saved[(at.v + k) * lanes + i] = w.v[k * lanes + i]
        saved[(at.a + k) * lanes + i] = w.a[k * lanes + i]
        saved[(at.b + k) * lanes + i] = w.b[k * lanes + i]
    for k in range(at.inputs - at.books):
        saved[(at.books + k) * lanes + i] = w.books[k * lanes + i]
    for k in range(inputs):
        saved[(at.inputs + k) * lanes + i] = w.u[k * lanes + i]
    for k in range(3 * motions):
        saved[(at.psi + k) * lanes + i] = w.psi[k * lanes + i]
    for k in range(motions):
        saved[(at.reaction + k) * lanes + i] = w.reaction[k * lanes + i]
    for k in range(saved.shape[0] // lanes - at.record):
        saved[(at.record + k) * lanes + i] = record[k * lanes + i]
