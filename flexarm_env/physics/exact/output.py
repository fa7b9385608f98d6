"""What is read off a chain of geometrically exact beams: ports, energies, poses, shape; and Newton's first guess."""

import numpy as np

from ...compiler import kernel, load, sincos, splat, store
from ..arithmetic import fall, put_vector, share_of, vector
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
    root_angle,
    rows_of,
    section_of,
    vertex_of,
)
from .rigid import beginning, ends_of, following, joint, payload_place
from .tables import interior


@kernel
def ports(lane, model, par, q, y):
    """Joint angles, then position and angle of the point of each load."""
    rows, links = rows_of(model), model.links
    store(y, 0, load(lane, q, T))
    for k in range(1, links):
        store(y, k, load(lane, q, rows.hinges + k - 1))
    if model.loads is not None:
        for f in range(model.loads.shape[0] // ROWS_OF_LOAD.end):
            of = model.loads[ROWS_OF_LOAD.end * f :]
            px, py = load(lane, q, of[ROWS_OF_LOAD.x]), load(lane, q, of[ROWS_OF_LOAD.y])
            psi = load(lane, q, of[ROWS_OF_LOAD.psi])
            if model.rigid is not None:
                length = model.rigid[lever_at(links, 0) + f]
                sine, cosine = sincos(psi)
                px, py = px + cosine * length, py + sine * length
            if of[ROWS_OF_LOAD.hinge] >= 0:
                psi = psi + load(lane, q, of[ROWS_OF_LOAD.hinge])
            put_vector(y, links + OF_LOAD.end * f, (px, py, psi))


@kernel
def energy(lane, model, par, q, v):
    """(kinetic, strain, gravity) energy, J."""
    i = rows_of(model).elements
    psi, spin = load(lane, q, i + T), load(lane, v, i + T)
    kinetic = (spin * spin) * (0.5 * model.hub_inertia)
    strain, mx, my = splat(lane, 0.0), splat(lane, 0.0), splat(lane, 0.0)
    for k in range(model.links):
        if k > 0:
            elbow = elbow_of(model, k)
            x, y, vx, vy = joint(lane, model, q, v, k)
            kinetic = kinetic + (vx * vx + vy * vy) * (0.5 * elbow.mass) + (spin * spin) * (0.5 * elbow.left)
            mx, my = mx + x * elbow.mass, my + y * elbow.mass
            psi, spin = root_angle(lane, model, q, k), root_angle(lane, model, v, k)
            kinetic = kinetic + (spin * spin) * (0.5 * elbow.right)
        section, left = section_of(lane, model, par, k), beginning(lane, model, q, v, k)
        if model.rigid is not None:
            more, x, y = ends_of(lane, model, q, v, k)
            kinetic, mx, my = kinetic + more, mx + x, my + y
        for _ in range(model.elements):
            j = i * len(lane)
            part = measure(lane, model.order, q[j:], v[j:], psi, spin, left, section)
            kinetic, strain = kinetic + part[0], strain + part[1]
            mx, my = mx + part[2], my + part[3]
            section = next_section(model, section)
            i += AXES * len(model.order)
            psi, spin = load(lane, q, i + T), load(lane, v, i + T)
            left = following(lane, model, q, v, i)
    mass = load(lane, par, PAYLOAD_MASS)
    x, y, vx, vy = joint(lane, model, q, v, model.links)
    x, y, vx, vy = payload_place(lane, model, psi, spin, x, y, vx, vy)
    kinetic = kinetic + ((vx * vx + vy * vy) * mass + (spin * spin) * load(lane, par, PAYLOAD_INERTIA)) * 0.5
    mx, my = mx + x * mass, my + y * mass
    return kinetic, strain, -(mx * fall(model.gravity, 0) + my * fall(model.gravity, 1))


@kernel
def damping_work(lane, model, par, q, v, x):
    """x'C(q) v of the material, W."""
    if model.damped is None:
        return splat(lane, 0.0)
    i, total = rows_of(model).elements, splat(lane, 0.0)
    for k in range(model.links):
        psi = root_angle(lane, model, q, k), root_angle(lane, model, v, k), root_angle(lane, model, x, k)
        section = section_of(lane, model, par, k)
        left = beginning(lane, model, q, v, k), beginning(lane, model, q, x, k)
        for _ in range(model.elements):
            j = i * len(lane)
            work = damp(lane, model.order, q[j:], v[j:], x[j:], psi, left, section)[0]
            total = total + share_of(model.damped, k, work)
            section = next_section(model, section)
            i += AXES * len(model.order)
            psi = load(lane, q, i + T), load(lane, v, i + T), load(lane, x, i + T)
            left = following(lane, model, q, v, i), following(lane, model, q, x, i)
    return total * load(lane, par, TAU_D)


@kernel
def link_poses(lane, model, par, q, v, out):
    """Of each link: x, y, angle of its root and their rates, then those of its tip (`POSES`)."""
    for k in range(model.links + 1):
        x, y, vx, vy = joint(lane, model, q, v, k)
        if k < model.links:
            at = POSE.end * k
            put_vector(out, at + POSE.x, (x, y, root_angle(lane, model, q, k)))
            put_vector(out, at + POSE.vx, (vx, vy, root_angle(lane, model, v, k)))
        if k > 0:
            at, i = POSE.end * (k - 1), vertex_of(model, k)
            put_vector(out, at + POSE.tip_x, (x, y, load(lane, q, i + T)))
            put_vector(out, at + POSE.tip_vx, (vx, vy, load(lane, v, i + T)))


STATIONS = np.zeros((4, 4, 2))
"""Interior functions (last axis) at p equal steps along an element of order p."""
for _order in range(2, 4):
    STATIONS[_order, :_order, : _order - 1] = interior(_order, np.arange(_order) * 2.0 / _order - 1.0).T


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
                left = q[i + X], q[i + Y]
                if model.rigid is not None and e % model.elements == 0:
                    x, y, _, _ = beginning((0,), model, q, q, e // model.elements)
                    left = x, y
                for axis in range(2):
                    value = left[axis] * (1.0 - share) + q[i + at.right + axis] * share
                    for k in range(p - 1):
                        value += STATIONS[p, j, k] * q[i + at.interior + AXES * k + axis]
                    points[count, axis] = value
                if j == 0 and e % model.elements == 0:
                    points[count, 0], points[count, 1], _, _ = joint((0,), model, q, q, e // model.elements)
                count += 1
    if count < points.shape[0]:
        points[count, 0], points[count, 1], _, _ = joint((0,), model, q, q, model.links)
        count += 1
    return count


@kernel
def predict(lane, model, start, q):
    """Positions in q anew: from the root's, with the angles of q and the strains of `start`.

    A chain whose nodes move on along their velocities stretches by half the square of the angle it turns, which a
    stiff arm answers with forces that spoil the first iterations.
    """
    i = rows_of(model).elements
    x, y, _ = vector(lane, q, i)
    for k in range(model.links):
        psi, new_psi = root_angle(lane, model, start, k), root_angle(lane, model, q, k)
        for _ in range(model.elements):
            j = i * len(lane)
            x, y = carry(lane, model.order, start[j:], q[j:], psi, new_psi, x, y)
            i += AXES * len(model.order)
            psi, new_psi = load(lane, start, i + T), load(lane, q, i + T)
