"""Inertia of chains of geometrically exact beams: M a alone, along the same way as `exact_beam.assemble`."""

from __future__ import annotations

from .exact_element import momentum
from .jit import kernel
from .lanes import load, splat, store


@kernel
def inertia(lane, model, par, a, r):  # type: ignore[no-untyped-def]
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
