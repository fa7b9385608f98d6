"""What correcting the period of a chain of geometrically exact beams takes: M a alone, and rotating its vectors."""

from __future__ import annotations

from ...compiler.decorator import kernel
from ...compiler.lanes import load, splat, store
from .element import momentum, rotate_pair


@kernel
def inertia(lane, model, par, a, r):
    """r <- M a: that of the elements, hub, elbows and payload."""
    links, p = model.links, len(model.order)
    deltas = 3 * p * model.elements * links + 3
    zero = splat(lane, 0.0)
    turn = load(lane, a, 2)
    left = (load(lane, a, 0), load(lane, a, 1), turn, zero, zero, turn * model.hub_inertia)
    i = 3
    for k in range(links):
        root, before, d = i, zero, deltas + k - 1
        if k > 0:
            ax, ay, at, fx, fy, ft = left
            mass = model.elbows[3 * k - 3]
            before = ft + at * model.elbows[3 * k - 2]
            turn = at + load(lane, a, d)
            left = (ax, ay, turn, fx + ax * mass, fy + ay * mass, turn * model.elbows[3 * k - 1])
        ml, jl = model.sections[6 * k + 4], model.sections[6 * k + 5]
        for _ in range(model.elements):
            j = (i - 3) * len(lane)
            left = momentum(lane, model.order, a[j:], left, ml, jl, r[j:])
            i += 3 * p
        if k > 0:
            ft = load(lane, r, root - 1)
            store(r, root - 1, before + ft)
            store(r, d, ft)
    mass = load(lane, par, 0)
    store(r, i - 3, left[3] + left[0] * mass)
    store(r, i - 2, left[4] + left[1] * mass)
    store(r, i - 1, left[5] + left[2] * load(lane, par, 1))


@kernel
def rotate(lane, model, start, q, share, x):
    """Rotate each node's vector (x, y) in x by a share of what its section turns by from start to q."""
    order, links, p = model.order, model.links, len(model.order)
    deltas = 3 * p * model.elements * links + 3
    left = load(lane, q, 2) - load(lane, start, 2)
    rotate_pair(lane, order, x, left * share)
    i = 3
    for k in range(links):
        if k > 0:
            left = left + (load(lane, q, deltas + k - 1) - load(lane, start, deltas + k - 1))
        for _ in range(model.elements):
            last = i + 3 * (p - 1)
            right = load(lane, q, last + 2) - load(lane, start, last + 2)
            for j in range(p - 1):
                rotate_pair(lane, order, x[(i + 3 * j) * len(lane) :], (left + right) * (0.5 * share))
            rotate_pair(lane, order, x[last * len(lane) :], right * share)
            left = right
            i = last + 3
