"""What is read off a chain of geometrically exact beams: ports, energies, poses, shape; and Newton's first guess."""

from __future__ import annotations

import numpy as np

from ...compiler import kernel, load, splat, store
from .element import carry, damp, measure
from .tables import interior


@kernel
def _fall(gravity, k):
    """Component k of gravity; 0.0 where there is none."""
    if gravity is None:
        return 0.0
    return gravity[k]


@kernel
def ports(lane, model, par, q, y):
    """Joint angles, then position and angle of the point of each load."""
    links = model.links
    store(y, 0, load(lane, q, 2))
    for k in range(1, links):
        store(y, k, load(lane, q, 3 * len(model.order) * model.elements * links + 2 + k))
    _load_points(lane, model.loads, links, q, y)


@kernel
def _load_points(lane, loads, links, q, y):
    if loads is not None:
        for f in range(loads.shape[0] // 4):
            k = links + 3 * f
            store(y, k, load(lane, q, loads[4 * f]))
            store(y, k + 1, load(lane, q, loads[4 * f + 1]))
            turn = load(lane, q, loads[4 * f + 2])
            if loads[4 * f + 3] >= 0:
                turn = turn + load(lane, q, loads[4 * f + 3])
            store(y, k + 2, turn)


@kernel
def _totals(lane, model, par, q, v):
    """(kinetic energy, strain energy, first mass moments x, y) of the whole chain."""
    links, p = model.links, len(model.order)
    deltas = 3 * p * model.elements * links + 3
    stiffness = load(lane, par, 2)
    w = load(lane, v, 2)
    kinetic = (w * w) * (0.5 * model.hub_inertia)
    strain, mx, my = splat(lane, 0.0), splat(lane, 0.0), splat(lane, 0.0)
    i = 3
    for k in range(links):
        turn, spin = load(lane, q, i - 1), load(lane, v, i - 1)
        if k > 0:
            mass = model.elbows[3 * k - 3]
            vx, vy = load(lane, v, i - 3), load(lane, v, i - 2)
            kinetic = kinetic + (vx * vx + vy * vy) * (0.5 * mass) + (spin * spin) * (0.5 * model.elbows[3 * k - 2])
            mx, my = mx + load(lane, q, i - 3) * mass, my + load(lane, q, i - 2) * mass
            turn, spin = turn + load(lane, q, deltas + k - 1), spin + load(lane, v, deltas + k - 1)
            kinetic = kinetic + (spin * spin) * (0.5 * model.elbows[3 * k - 1])
        k1, k2, kb = model.sections[6 * k], model.sections[6 * k + 1], stiffness * model.sections[6 * k + 2]
        length, ml, jl = model.sections[6 * k + 3], model.sections[6 * k + 4], model.sections[6 * k + 5]
        for _ in range(model.elements):
            j = (i - 3) * len(lane)
            part = measure(lane, model.order, q[j:], v[j:], turn, spin, k1, k2, kb, length, ml, jl)
            kinetic, strain = kinetic + part[0], strain + part[1]
            mx, my = mx + part[2], my + part[3]
            i += 3 * p
            turn, spin = load(lane, q, i - 1), load(lane, v, i - 1)
    mass = load(lane, par, 0)
    vx, vy = load(lane, v, i - 3), load(lane, v, i - 2)
    kinetic = kinetic + ((vx * vx + vy * vy) * mass + (spin * spin) * load(lane, par, 1)) * 0.5
    return kinetic, strain, mx + load(lane, q, i - 3) * mass, my + load(lane, q, i - 2) * mass


@kernel
def damping_work(lane, model, par, q, v, x):
    """x'C(q) v of the material, W."""
    return _damped(lane, model.damped, model, par, q, v, x)


@kernel
def _damped(lane, damped, model, par, q, v, x):
    if damped is None:
        return splat(lane, 0.0)
    links, p = model.links, len(model.order)
    deltas = 3 * p * model.elements * links + 3
    total = splat(lane, 0.0)
    i = 3
    for k in range(links):
        turns = load(lane, q, i - 1), load(lane, v, i - 1), load(lane, x, i - 1)
        if k > 0:
            d = deltas + k - 1
            turns = turns[0] + load(lane, q, d), turns[1] + load(lane, v, d), turns[2] + load(lane, x, d)
        k1, k2, kb = model.sections[6 * k], model.sections[6 * k + 1], load(lane, par, 2) * model.sections[6 * k + 2]
        for _ in range(model.elements):
            j = (i - 3) * len(lane)
            total = total + damp(lane, model.order, q[j:], v[j:], x[j:], turns, k1, k2, kb)[0]
            i += 3 * p
            turns = load(lane, q, i - 1), load(lane, v, i - 1), load(lane, x, i - 1)
    return total * load(lane, par, 3)


@kernel
def energy(lane, model, par, q, v):
    """(kinetic, strain, gravity) energy, J."""
    kinetic, strain, mx, my = _totals(lane, model, par, q, v)
    return kinetic, strain, -(mx * _fall(model.gravity, 0) + my * _fall(model.gravity, 1))


@kernel
def link_poses(lane, model, par, q, v, out):
    """Of each link: x, y, angle of its root and their rates, then those of its tip."""
    span = 3 * len(model.order) * model.elements
    deltas = span * model.links + 3
    for k in range(model.links):
        for part in range(2):
            for j in range(3):
                i = span * (k + part) + j
                position, rate = load(lane, q, i), load(lane, v, i)
                if k > 0 and part == 0 and j == 2:
                    position = position + load(lane, q, deltas + k - 1)
                    rate = rate + load(lane, v, deltas + k - 1)
                store(out, 12 * k + 6 * part + j, position)
                store(out, 12 * k + 6 * part + j + 3, rate)


@kernel
def out_of_range(lane, model, par, q):
    """The exact beam holds at any deflection."""
    return splat(lane, 0.0)


STATIONS = np.zeros((4, 4, 2))
"""Interior functions (last axis) at p equal steps along an element of order p."""
for _order in range(2, 4):
    STATIONS[_order, :_order, : _order - 1] = interior(_order, np.arange(_order) * 2.0 / _order - 1.0).T


@kernel
def shape(model, q, points):
    """Positions along the chain at p equal steps of each element, as many as `points` has room for; their number."""
    p = len(model.order)
    count = 0
    for e in range(model.links * model.elements):
        i = 3 * p * e
        for j in range(p):
            if count < points.shape[0]:
                share = j / p
                for axis in range(2):
                    value = q[i + axis] * (1.0 - share) + q[i + 3 * p + axis] * share
                    for k in range(p - 1):
                        value += STATIONS[p, j, k] * q[i + 3 + 3 * k + axis]
                    points[count, axis] = value
                count += 1
    if count < points.shape[0]:
        last = 3 * p * model.links * model.elements
        points[count, 0], points[count, 1] = q[last], q[last + 1]
        count += 1
    return count


@kernel
def predict(lane, model, start, q):
    """Positions in q anew: from the root's, with the angles of q and the strains of `start`.

    A chain whose nodes move on along their velocities stretches by half the square of the angle it turns, which a
    stiff arm answers with forces that spoil the first iterations.
    """
    links, p = model.links, len(model.order)
    deltas = 3 * p * model.elements * links + 3
    i = 3
    x, y = load(lane, q, 0), load(lane, q, 1)
    for k in range(links):
        turn, new_turn = load(lane, start, i - 1), load(lane, q, i - 1)
        if k > 0:
            turn, new_turn = turn + load(lane, start, deltas + k - 1), new_turn + load(lane, q, deltas + k - 1)
        for _ in range(model.elements):
            j = (i - 3) * len(lane)
            x, y = carry(lane, model.order, start[j:], q[j:], turn, new_turn, x, y)
            i += 3 * p
            turn, new_turn = load(lane, start, i - 1), load(lane, q, i - 1)
