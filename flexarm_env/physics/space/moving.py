"""Increments of the coordinates of a chain in space: positions add, rotations are composed in body axes.

Each function below treats the base's rows, then each link's joint angle and vertices, then the inner modes.
"""

from __future__ import annotations

from ...compiler import Lanes, kernel, select_lt, superword, tangents_only, without_tangents
from ..arithmetic import store_vector
from ..protocol import added
from . import rotations
from .layout import count_of, joint_row, vertex_row
from .rotations import (
    add_vector,
    compose,
    compose_rotation_vectors,
    dot,
    inverse_rotation,
    load_vector,
    quaternion,
    rotation_vector,
    shortest_rotation,
)


@kernel
def move_vertex(lane, q: Lanes, i, share, d, more):
    """Move the position (m, inertial axes) and rotation vector (rad) in rows i ... i + 5 of q by share * d + more.

    d and more are increments of q, whose rotations are in body axes (rad); more = None means zero. share is a factor on
    d. The rotation becomes exp(q^) exp((share d + more)^). If the increment is zero, as for arms that have converged,
    the rotation vector keeps its exact value without rounding.
    """
    step, turn = share * load_vector(lane, d, i), share * load_vector(lane, d, i + 3)
    if more is not None:
        step, turn = step + load_vector(lane, more, i), turn + load_vector(lane, more, i + 3)
    add_vector(lane, q, i, step)
    old, square = load_vector(lane, q, i + 3), dot(turn, turn)
    new = compose_rotation_vectors(old, turn)
    # zero increment: keep the value, but pass on the derivatives of the composition
    for a in range(3):
        q[i + 3 + a] = select_lt(0.0, square, new[a], without_tangents(old[a]) + tangents_only(new[a]))


@kernel
def vertices_of(model, k):
    """Return the number of six-row vertices beyond the joint of link k: one per element, or one for a rigid link."""
    return max(count_of(model, k), 1)


@kernel
def retract(lane, model, q: Lanes, share, d, more):
    """Apply the increment share * d + more to q: rotations are composed in body axes, other coordinates are added.

    d and more are increments of all coordinates; more = None means zero. share is a factor on d. See `move_vertex` and
    `protocol.retract`.
    """
    # r, A of the base; theta of each joint; r, A of the vertices: exp(d) composed in section axes
    move_vertex(lane, q, 0, share, d, more)
    for k in range(model.links):
        q[joint_row(model, k)] = added(lane, q, share, d, more, joint_row(model, k))
        for e in range(vertices_of(model, k)):
            move_vertex(lane, q, vertex_row(model, k, e), share, d, more)
    # amplitudes of inner modes (rad): added
    for j in range(joint_row(model, model.links), model.n):
        q[j] = added(lane, q, share, d, more, j)


@kernel
def rotation_increment(lane, start, q, i):
    """Return the increment (rad, body axes) from coordinates start to q of the rotation in rows i ... i + 2."""
    before, after = quaternion(load_vector(lane, start, i)), quaternion(load_vector(lane, q, i))
    return rotation_vector(shortest_rotation(compose(inverse_rotation(before), after)))


@superword
def store_increment(lane, start, q, d, i):
    """Store in rows i ... i + 5 of d a vertex's increment from start to q: position, and rotation in body axes."""
    store_vector(lane, d, i, load_vector(lane, q, i) - load_vector(lane, start, i))
    store_vector(lane, d, i + 3, rotation_increment(lane, start, q, i + 3))


@kernel
def local_difference(lane, model, start: Lanes, q: Lanes, d: Lanes):
    """Store in d the increment from coordinates start to q, rotations in body axes (`protocol.local_difference`)."""
    # d of the base, of joint angles (differences) and of vertices (rotations in section axes)
    store_increment(lane, start, q, d, 0)
    for k in range(model.links):
        i = joint_row(model, k)
        d[i] = q[i] - start[i]
        for e in range(vertices_of(model, k)):
            store_increment(lane, start, q, d, vertex_row(model, k, e))
    # amplitudes of inner modes (rad): differences
    for j in range(joint_row(model, model.links), model.n):
        d[j] = q[j] - start[j]


@kernel
def tangent_map(lane, model, d, inverse, x):
    """Multiply the rotation rows of x by T^T(d), or by T^-T(d) if `inverse` is True; other rows do not change.

    T is the tangent map of rotations: exp(d^ + e^) = exp(d^) exp((T e)^) to first order in e. d contains increments of
    q, rad. See `protocol.tangent_map`.
    """
    store_vector(lane, x, 3, rotations.tangent_map(load_vector(lane, d, 3), inverse, load_vector(lane, x, 3)))
    for k in range(model.links):
        for e in range(vertices_of(model, k)):
            i = vertex_row(model, k, e) + 3
            store_vector(lane, x, i, rotations.tangent_map(load_vector(lane, d, i), inverse, load_vector(lane, x, i)))


@kernel
def note_inverse(lane, model, d, share: Lanes):
    """Store in share, at the first row of each rotation, the number c in T^-T(d) x = x - d^ x / 2 + c d^ d^ x.

    d contains increments of q, whose rotations (rad) are in body axes. `noted_inverse` reads the numbers c in share.
    """
    share[3] = rotations.inverse_share(load_vector(lane, d, 3))
    for k in range(model.links):
        for e in range(vertices_of(model, k)):
            i = vertex_row(model, k, e) + 3
            share[i] = rotations.inverse_share(load_vector(lane, d, i))


@kernel
def noted_inverse(lane, model, d, share: Lanes, x):
    """Multiply the rotation rows of x by T^-T(d), with the coefficients that `note_inverse` stored in share.

    T is the tangent map of rotations: exp(d^ + e^) = exp(d^) exp((T e)^) to first order in e. d: increments of q, rad.
    """
    store_vector(lane, x, 3, rotations.inverse_map(load_vector(lane, d, 3), share[3], load_vector(lane, x, 3)))
    for k in range(model.links):
        for e in range(vertices_of(model, k)):
            i = vertex_row(model, k, e) + 3
            store_vector(lane, x, i, rotations.inverse_map(load_vector(lane, d, i), share[i], load_vector(lane, x, i)))
