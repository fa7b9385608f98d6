"""How coordinates of a chain in space are moved: places add up, rotations are moved by increments in body axes."""

from __future__ import annotations

from ...compiler import alone, change, kernel, load, select_lt, store, superword
from ..arithmetic import put_vector, vector
from ..protocol import added
from . import rotations
from .layout import count_of, joint_row, vertex_row
from .rotations import (
    add_vector,
    composed,
    dot,
    inverse,
    minus,
    moved,
    plus,
    quaternion,
    rotation_vector,
    shorter,
    times,
)


@kernel
def move_vertex(lane, q, i, share, d, more):
    """Place and rotation of the rows from i on; what does not turn, as of arms that are done, stays to the last bit."""
    step, turn = times(vector(lane, d, i), share), times(vector(lane, d, i + 3), share)
    if more is not None:
        step, turn = plus(step, vector(lane, more, i)), plus(turn, vector(lane, more, i + 3))
    add_vector(lane, q, i, step)
    old, square = vector(lane, q, i + 3), dot(turn, turn)
    new = moved(old, turn)
    for a in range(3):
        store(q, i + 3 + a, select_lt(0.0, square, new[a], alone(old[a]) + change(new[a])))


@kernel
def vertices_of(model, k):
    """How many places of rotations follow the joint of link k."""
    return max(count_of(model, k), 1)


@kernel
def update(lane, model, q, share, d, more):
    """See `protocol`: rotations are moved by increments in body axes, the sum of both."""
    move_vertex(lane, q, 0, share, d, more)
    for k in range(model.links):
        store(q, joint_row(model, k), added(lane, q, share, d, more, joint_row(model, k)))
        for e in range(vertices_of(model, k)):
            move_vertex(lane, q, vertex_row(model, k, e), share, d, more)
    for j in range(joint_row(model, model.links), model.n):
        store(q, j, added(lane, q, share, d, more, j))


@kernel
def between(lane, start, q, i):
    """The increment in body axes that moves the rotation in rows i of start to that of q."""
    before, after = quaternion(vector(lane, start, i)), quaternion(vector(lane, q, i))
    return rotation_vector(shorter(composed(inverse(before), after)))


@superword
def put_difference(lane, start, q, d, i):
    """Place and rotation in the rows of d from i on: what moves those of start to those of q."""
    put_vector(d, i, minus(vector(lane, q, i), vector(lane, start, i)))
    put_vector(d, i + 3, between(lane, start, q, i + 3))


@kernel
def difference(lane, model, start, q, d):
    """See `protocol`."""
    put_difference(lane, start, q, d, 0)
    for k in range(model.links):
        i = joint_row(model, k)
        store(d, i, load(lane, q, i) - load(lane, start, i))
        for e in range(vertices_of(model, k)):
            put_difference(lane, start, q, d, vertex_row(model, k, e))
    for j in range(joint_row(model, model.links), model.n):
        store(d, j, load(lane, q, j) - load(lane, start, j))


@kernel
def tangent_map(lane, model, d, inverse, x):
    """See `protocol`."""
    put_vector(x, 3, rotations.tangent_map(vector(lane, d, 3), inverse, vector(lane, x, 3)))
    for k in range(model.links):
        for e in range(vertices_of(model, k)):
            i = vertex_row(model, k, e) + 3
            put_vector(x, i, rotations.tangent_map(vector(lane, d, i), inverse, vector(lane, x, i)))


@kernel
def note_inverse(lane, model, d, share):
    """See `protocol`."""
    store(share, 3, rotations.inverse_share(vector(lane, d, 3)))
    for k in range(model.links):
        for e in range(vertices_of(model, k)):
            i = vertex_row(model, k, e) + 3
            store(share, i, rotations.inverse_share(vector(lane, d, i)))


@kernel
def noted_inverse(lane, model, d, share, x):
    """See `protocol`."""
    put_vector(x, 3, rotations.inverse_map(vector(lane, d, 3), load(lane, share, 3), vector(lane, x, 3)))
    for k in range(model.links):
        for e in range(vertices_of(model, k)):
            i = vertex_row(model, k, e) + 3
            put_vector(x, i, rotations.inverse_map(vector(lane, d, i), load(lane, share, i), vector(lane, x, i)))


@kernel
def rotates(model):
    """See `protocol`."""
    return (0,)
