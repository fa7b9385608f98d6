"""Displacements and rates on which the inputs of a chain in space do work: joint angles, positions of point loads."""

from __future__ import annotations

from ...compiler import Lanes, kernel
from ..arithmetic import store_vector
from .chain import place_at
from .layout import AXES, L, joint_row, vertex_row
from .output import section_of_end
from .rotations import (
    compose,
    cross,
    inverse_rotation,
    load_vector,
    matrix,
    rotation_vector,
    shortest_rotation,
    three_of,
)


@kernel
def _loaded(lane, model, q, v, f):
    """Return the `Place` of the section on which point load f acts. Pass q for v if its rates are not read."""
    link, section = int(model.loads[L.end * f + L.link]), model.loads[L.end * f + L.section]
    # 0, 1: the link's first and last section; 2 + e: the section at vertex e
    place = section_of_end(lane, model, q, v, link, section != 0.0)
    if model.inside is not None:
        if section >= 2.0:
            place = place_at(lane, q, v, vertex_row(model, link, int(section) - 2))
    return place


@kernel
def _input_rates(lane, model, par, q: Lanes, v: Lanes, y: Lanes):
    """Store in y the joint rates (rad/s), then velocity (m/s), angular velocity (rad/s) of each load, inertial axes."""
    # joint rates
    for k in range(model.links):
        y[k] = v[joint_row(model, k)]
    # y' = r' + A (omega x lever), and A omega; omega in section axes
    for f in range(model.loads.shape[0] // L.end):
        place, j = _loaded(lane, model, q, v, f), model.links + AXES * f
        A, lever = matrix(place.p), three_of(lane, model.loads, L.end * f + L.lever)
        store_vector(lane, y, j, place.v + A @ cross(place.spin, lever))
        store_vector(lane, y, j + 3, A @ place.spin)


@kernel
def input_displacements(lane, model, par, q: Lanes, y: Lanes, since=None, v=None):
    """Store in y the joint angles (rad), then the position (m) and rotation vector (rad) of each load, inertial axes.

    If since = (start, y0), each rotation vector is that in y0 plus the rotation since the coordinates `start` about
    inertial axes; moments do work on it. If since is None, the vector is the rotation vector of the section's rotation
    matrix."""
    if v is not None:
        _input_rates(lane, model, par, q, v, y)
        return
    for k in range(model.links):
        y[k] = q[joint_row(model, k)]
    if model.loads is not None:
        for f in range(model.loads.shape[0] // L.end):
            # y of the loaded point r + A lever (inertial axes), on which a force does work
            place, j = _loaded(lane, model, q, q, f), model.links + AXES * f
            lever = three_of(lane, model.loads, L.end * f + L.lever)
            store_vector(lane, y, j, place.r + matrix(place.p) @ lever)
            store_vector(lane, y, j + 3, rotation_vector(shortest_rotation(place.p)))
            if since is not None:
                before = _loaded(lane, model, since[0], since[0], f)
                turn = rotation_vector(shortest_rotation(compose(place.p, inverse_rotation(before.p))))
                store_vector(lane, y, j + 3, load_vector(lane, since[1], j + 3) + turn)
