"""What is read off a chain of geometrically exact beams: ports, energies, poses, shape; and Newton's first guess."""

from __future__ import annotations

import numpy as np

from ...compiler import kernel, load, sincos, splat, store
from ..arithmetic import share_of
from ..layout import OF_LOAD, POSE
from ..model import PAYLOAD_INERTIA, PAYLOAD_MASS, TAU_D
from .element import carry, damp, measure
from .layout import (
    AXES,
    ROWS_OF_LOAD,
    T,
    X,
    Y,
    elbow_of,
    element_at,
    lever_at,
    next_section,
    rows_of,
    section_of,
    three,
)
from .rigid import beginning, ends_of, following, joint, payload_place
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
    rows = rows_of(model)
    store(y, 0, load(lane, q, T))
    for k in range(1, model.links):
        store(y, k, load(lane, q, rows.hinges + k - 1))
    _load_points(lane, model.loads, model.links, q, y)
    _on_levers(lane, model.rigid, model.loads, model.links, q, y)


@kernel
def _on_levers(lane, rigid, loads, links, q, y):
    """The points of loads on rigid ends."""
    if rigid is not None and loads is not None:
        for f in range(loads.shape[0] // ROWS_OF_LOAD.end):
            length, k = rigid[lever_at(links, 0) + f], links + OF_LOAD.end * f
            sine, cosine = sincos(load(lane, q, loads[ROWS_OF_LOAD.end * f + ROWS_OF_LOAD.psi]))
            store(y, k + OF_LOAD.x, load(lane, y, k + OF_LOAD.x) + cosine * length)
            store(y, k + OF_LOAD.y, load(lane, y, k + OF_LOAD.y) + sine * length)


@kernel
def _load_points(lane, loads, links, q, y):
    if loads is not None:
        for f in range(loads.shape[0] // ROWS_OF_LOAD.end):
            at, k = ROWS_OF_LOAD.end * f, links + OF_LOAD.end * f
            store(y, k + OF_LOAD.x, load(lane, q, loads[at + ROWS_OF_LOAD.x]))
            store(y, k + OF_LOAD.y, load(lane, q, loads[at + ROWS_OF_LOAD.y]))
            psi = load(lane, q, loads[at + ROWS_OF_LOAD.psi])
            if loads[at + ROWS_OF_LOAD.hinge] >= 0:
                psi = psi + load(lane, q, loads[at + ROWS_OF_LOAD.hinge])
            store(y, k + OF_LOAD.torque, psi)


@kernel
def _totals(lane, model, par, q, v):
    """(kinetic energy, strain energy, first mass moments x, y) of the whole chain."""
    rows = rows_of(model)
    i = rows.elements
    psi, spin = load(lane, q, i + T), load(lane, v, i + T)
    kinetic = (spin * spin) * (0.5 * model.hub_inertia)
    strain, mx, my = splat(lane, 0.0), splat(lane, 0.0), splat(lane, 0.0)
    for k in range(model.links):
        if k > 0:
            elbow, d = elbow_of(model, k), rows.hinges + k - 1
            x, y, vx, vy = joint(lane, model.rigid, model, q, v, k)
            kinetic = kinetic + (vx * vx + vy * vy) * (0.5 * elbow.mass) + (spin * spin) * (0.5 * elbow.left)
            mx, my = mx + x * elbow.mass, my + y * elbow.mass
            psi, spin = psi + load(lane, q, d), spin + load(lane, v, d)
            kinetic = kinetic + (spin * spin) * (0.5 * elbow.right)
        section, left = section_of(lane, model, par, k), beginning(lane, model.rigid, model, q, v, k)
        kinetic, mx, my = _with_ends(lane, model.rigid, model, q, v, k, kinetic, mx, my)
        for _ in range(model.elements):
            j = i * len(lane)
            part = measure(lane, model.order, q[j:], v[j:], psi, spin, left, section)
            kinetic, strain = kinetic + part[0], strain + part[1]
            mx, my = mx + part[2], my + part[3]
            section = next_section(model, section)
            i += AXES * len(model.order)
            psi, spin = load(lane, q, i + T), load(lane, v, i + T)
            left = following(lane, model.rigid, model, q, v, i)
    mass = load(lane, par, PAYLOAD_MASS)
    x, y, vx, vy = joint(lane, model.rigid, model, q, v, model.links)
    x, y, vx, vy = payload_place(lane, model.eccentric, psi, spin, x, y, vx, vy)
    kinetic = kinetic + ((vx * vx + vy * vy) * mass + (spin * spin) * load(lane, par, PAYLOAD_INERTIA)) * 0.5
    return kinetic, strain, mx + x * mass, my + y * mass


@kernel
def _with_ends(lane, rigid, model, q, v, k, kinetic, mx, my):
    """Kinetic energy and moments with those of the rigid ends of link k."""
    if rigid is None:
        return kinetic, mx, my
    more, x, y = ends_of(lane, rigid, model, q, v, k)
    return kinetic + more, mx + x, my + y


@kernel
def damping_work(lane, model, par, q, v, x):
    """x'C(q) v of the material, W."""
    return _damped(lane, model.damped, model, par, q, v, x)


@kernel
def _damped(lane, damped, model, par, q, v, x):
    if damped is None:
        return splat(lane, 0.0)
    rows, total = rows_of(model), splat(lane, 0.0)
    i = rows.elements
    for k in range(model.links):
        psi = load(lane, q, i + T), load(lane, v, i + T), load(lane, x, i + T)
        if k > 0:
            d = rows.hinges + k - 1
            psi = psi[0] + load(lane, q, d), psi[1] + load(lane, v, d), psi[2] + load(lane, x, d)
        section, rigid = section_of(lane, model, par, k), model.rigid
        left = beginning(lane, rigid, model, q, v, k), beginning(lane, rigid, model, q, x, k)
        for _ in range(model.elements):
            j = i * len(lane)
            total = total + share_of(damped, k, damp(lane, model.order, q[j:], v[j:], x[j:], psi, left, section)[0])
            section = next_section(model, section)
            i += AXES * len(model.order)
            psi = load(lane, q, i + T), load(lane, v, i + T), load(lane, x, i + T)
            left = following(lane, rigid, model, q, v, i), following(lane, rigid, model, q, x, i)
    return total * load(lane, par, TAU_D)


@kernel
def energy(lane, model, par, q, v):
    """(kinetic, strain, gravity) energy, J."""
    kinetic, strain, mx, my = _totals(lane, model, par, q, v)
    return kinetic, strain, -(mx * _fall(model.gravity, 0) + my * _fall(model.gravity, 1))


@kernel
def link_poses(lane, model, par, q, v, out):
    """Of each link: x, y, angle of its root and their rates, then those of its tip (`POSES`)."""
    rows, span = rows_of(model), AXES * len(model.order) * model.elements
    for k in range(model.links):
        for end in range(2):
            at = POSE.end * k + (POSE.tip_x - POSE.x) * end
            for j in range(AXES):
                i = rows.elements + span * (k + end) + j
                position, rate = load(lane, q, i), load(lane, v, i)
                if k > 0 and end == 0 and j == T:
                    position = position + load(lane, q, rows.hinges + k - 1)
                    rate = rate + load(lane, v, rows.hinges + k - 1)
                store(out, at + POSE.x + j, position)
                store(out, at + POSE.vx + j, rate)
    _joints(lane, model.rigid, model, q, v, out)


@kernel
def _joints(lane, rigid, model, q, v, out):
    """Where rigid ends end."""
    if rigid is not None:
        for k in range(model.links + 1):
            x, y, vx, vy = joint(lane, rigid, model, q, v, k)
            if k < model.links:
                _put(out, POSE.end * k + POSE.x, POSE.end * k + POSE.vx, x, y, vx, vy)
            if k > 0:
                _put(out, POSE.end * (k - 1) + POSE.tip_x, POSE.end * (k - 1) + POSE.tip_vx, x, y, vx, vy)


@kernel
def _put(out, place, rate, x, y, vx, vy):
    store(out, place, x)
    store(out, place + 1, y)
    store(out, rate, vx)
    store(out, rate + 1, vy)


@kernel
def out_of_range(lane, model, par, q):
    """The exact beam holds at any deflection."""
    return splat(lane, 0.0)


STATIONS = np.zeros((4, 4, 2))
"""Interior functions (last axis) at p equal steps along an element of order p."""
for _order in range(2, 4):
    STATIONS[_order, :_order, : _order - 1] = interior(_order, np.arange(_order) * 2.0 / _order - 1.0).T


@kernel
def _left(rigid, model, q, e, i):
    """Where element e begins, its left vertex at row i."""
    if rigid is not None:
        if e % model.elements == 0:
            x, y, _, _ = beginning((0,), rigid, model, q, q, e // model.elements)
            return x, y
    return q[i + X], q[i + Y]


@kernel
def shape(model, q, points):
    """Positions along the chain at p equal steps of each element, as many as `points` has room for; their number."""
    p, rows = len(model.order), rows_of(model)
    at = element_at(0, p)
    count = 0
    for e in range(model.links * model.elements):
        i = rows.elements + at.right * e
        for j in range(p):
            if count < points.shape[0]:
                share = j / p
                left = _left(model.rigid, model, q, e, i)
                for axis in range(2):
                    value = left[axis] * (1.0 - share) + q[i + at.right + axis] * share
                    for k in range(p - 1):
                        value += STATIONS[p, j, k] * q[i + at.interior + AXES * k + axis]
                    points[count, axis] = value
                if j == 0 and e % model.elements == 0:
                    points[count, 0], points[count, 1], _, _ = joint(
                        (0,), model.rigid, model, q, q, e // model.elements
                    )
                count += 1
    if count < points.shape[0]:
        points[count, 0], points[count, 1], _, _ = joint((0,), model.rigid, model, q, q, model.links)
        count += 1
    return count


@kernel
def predict(lane, model, start, q):
    """Positions in q anew: from the root's, with the angles of q and the strains of `start`.

    A chain whose nodes move on along their velocities stretches by half the square of the angle it turns, which a
    stiff arm answers with forces that spoil the first iterations.
    """
    rows = rows_of(model)
    i = rows.elements
    x, y, _ = three(lane, q, i)
    for k in range(model.links):
        psi, new_psi = load(lane, start, i + T), load(lane, q, i + T)
        if k > 0:
            d = rows.hinges + k - 1
            psi, new_psi = psi + load(lane, start, d), new_psi + load(lane, q, d)
        for _ in range(model.elements):
            j = i * len(lane)
            x, y = carry(lane, model.order, start[j:], q[j:], psi, new_psi, x, y)
            i += AXES * len(model.order)
            psi, new_psi = load(lane, start, i + T), load(lane, q, i + T)
