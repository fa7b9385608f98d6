"""Chains of geometrically exact beams in space: the residual and its tangent (model: `SpatialBeam`).

Where all that is in coordinates and in S is told in `layout`. Half of an element's rotary inertia is at each of its
ends; a vertex's moment is J dw/dt + w x J w in its own axes.
"""

from __future__ import annotations

from ...compiler import kernel, load, splat, store
from ..model import PAYLOAD_INERTIA, PAYLOAD_MASS
from ..protocol import RESIDUAL_ALONE, State, register
from .chain import (
    SpatialBeam,
    body,
    clear,
    hinged,
    loaded,
    lump,
    place_at,
    rotor_moment,
    section_at,
    three_of,
    vertex_at,
)
from .element import forces, inertia, middle, middle_of, tangent
from .framed import framed
from .layout import AXES, B, E, F, H, J, L, P, before, count_of, factor_at, hinge_at, joint_row, rows_before
from .lost import damping_over
from .matrix import factor, gyrate, lean, matrix_in, pin, put_matrix, solve, stiffen, sway
from .moving import difference, note_inverse, noted_inverse, rotates, tangent_map, update
from .output import (
    damping_work,
    energy,
    gauge,
    light,
    link_poses,
    ports,
    ports_after,
    predict,
    root_of,
    shape,
    stand,
    task_poses,
)
from .rotations import add_vector, back, cross, dot, matrix, minus, plus, put_vector, times, turned, vector
from .settled import settle, stride


@kernel
def _add(lane, r, i, of):
    """(force, moment) to the rows from i on."""
    add_vector(lane, r, i, of[0])
    add_vector(lane, r, i + 3, of[1])


@kernel
def _both(a, b):
    """The sum of two pairs (force, moment)."""
    return plus(a[0], b[0]), plus(a[1], b[1])


@kernel
def assemble(lane, model, par, state, u, weights, r, S):
    """See `protocol`."""
    zero = splat(lane, 0.0)
    for i in range(model.n):
        store(r, i, zero)
    matrix_too = weights.mass != 0.0
    if matrix_too:
        clear(lane, S, 0, B.end)
    tip = vertex_at(lane, model, state, 0)
    element = 0
    for k in range(model.links):
        at, h, row, first, count = (
            J.end * k,
            hinge_at(k),
            joint_row(model, k),
            factor_at(model, k, 0),
            count_of(model, k),
        )
        o, i = before(model, k), rows_before(model, k)
        if k > 0:
            mass = splat(lane, model.joints[at + J.near + P.mass])
            _add(lane, r, i, body(lane, model.joints, at + J.near, mass, None, tip, weights, S, o))
            _add(lane, r, i, loaded(lane, model, u, k - 1, True, tip, weights, S, o))
        if model.rotors is not None:
            if model.rotors[k] != 0:
                _add(lane, r, i, rotor_moment(lane, model, S, k, tip, weights, o))
        hinge = hinged(lane, model, state, k, tip)
        root, left, j = hinge.root, hinge.root, row + 1
        on_root = (zero, zero, zero), (zero, zero, zero)
        if matrix_too:
            if count == 0:
                clear(lane, S, first + F.LL, 36)
        for e in range(count):
            section = section_at(lane, model, par, element)
            right = vertex_at(lane, model, state, j)
            f = first + F.end * e
            if model.frames is None:
                on_left, on_right = _exact(lane, model, section, left, right, element, weights, S, f)
            else:
                on_left, on_right = framed(lane, model, par, section, state, left, right, element, weights, r, S, f)
            if e == 0:
                on_root = on_left
            else:
                _add(lane, r, j - AXES, on_left)
            _add(lane, r, j, on_right)
            left = right
            j += AXES
            element += 1
        mass = splat(lane, model.joints[at + J.far + P.mass])
        on_root = _both(on_root, body(lane, model.joints, at + J.far, mass, None, root, weights, S, first + F.LL))
        on_root = _both(on_root, loaded(lane, model, u, k, False, root, weights, S, first + F.LL))
        _note(lane, model, S, h, hinge, tip, on_root)
        tip = left
    i = rows_before(model, model.links)
    o = before(model, model.links)
    _add(lane, r, i, body(lane, model.end, 0, splat(lane, model.end[P.mass]), None, tip, weights, S, o))
    mass, share = load(lane, par, PAYLOAD_MASS), load(lane, par, PAYLOAD_INERTIA)
    _add(lane, r, i, body(lane, model.payload, 0, mass, share, tip, weights, S, o))
    _add(lane, r, i, loaded(lane, model, u, model.links - 1, True, tip, weights, S, o))
    for back_k in range(model.links):
        _hand_on(lane, model, u, weights, r, S, model.links - 1 - back_k)


@kernel
def _exact(lane, model, section, left, right, element, weights, S, f):
    """((force, moment) of the left end, of the right) of an element of the exact beam; its `FACTOR` at f of S."""
    inner = middle(section, left.place, right.place)[1]
    put_vector(S, f + F.force, inner.n)
    on_left, on_right = forces(section, inner)
    masses = three_of(lane, model.sections, E.end * element + E.mass)
    if weights.mass != 0.0:
        tangent(section, inner, weights.stiffness, weights.damping, S, f)
    at_left, at_right = inertia(lane, masses[1], section.length, left, right, weights, S, f)
    I = three_of(lane, model.sections, E.end * element + E.inertia)
    on_left = _both(_both(on_left, at_left), lump(lane, masses[0], I, left, weights, S, f + F.LL))
    return on_left, _both(_both(on_right, at_right), lump(lane, masses[2], I, right, weights, S, f + F.RR))


@kernel
def _of_body(lane, array, o, mass, at):
    """Momentum of the `BODY` at o of `array` on a place."""
    arm = turned(matrix(at.p), cross(at.spin, three_of(lane, array, o + P.centre)))
    return times(plus(at.v, arm), mass)


@kernel
def _momentum(lane, model, par, q, v):
    """Of a chain of exact beams, whose masses are those of `element.inertia`."""
    tip, element = place_at(lane, q, v, 0), 0
    zero = splat(lane, 0.0)
    total = zero, zero, zero
    for k in range(model.links):
        at, i = J.end * k, joint_row(model, k) + 1
        if k > 0:
            mass = splat(lane, model.joints[at + J.near + P.mass])
            total = plus(total, _of_body(lane, model.joints, at + J.near, mass, tip))
        left = root_of(lane, model, q, v, k, tip)
        mass = splat(lane, model.joints[at + J.far + P.mass])
        total = plus(total, _of_body(lane, model.joints, at + J.far, mass, left))
        for _ in range(count_of(model, k)):
            right, own = place_at(lane, q, v, i), E.end * element
            masses = three_of(lane, model.sections, own + E.mass)
            middle_rate = middle_of(splat(lane, model.sections[own + E.length]), left, right)[1]
            ends = plus(times(left.v, masses[0]), times(right.v, masses[2]))
            total = plus(total, plus(ends, times(middle_rate, masses[1])))
            left = right
            i += AXES
            element += 1
        tip = left
    total = plus(total, _of_body(lane, model.end, 0, splat(lane, model.end[P.mass]), tip))
    return plus(total, _of_body(lane, model.payload, 0, load(lane, par, PAYLOAD_MASS), tip))


@kernel
def conserve(lane, model, par, before, h, q, v, u, zero, r, S):
    """See `protocol`: sections turn, and places of centres and middles are no linear function of what the integrator
    moves. Inertial forces of the accelerations v are M v, whose sum is the momentum; no other equation sees a rigid
    translation."""
    if model.free is None:
        return None
    mass, nothing = load(lane, par, PAYLOAD_MASS) + model.free, splat(lane, 0.0)
    push = nothing, nothing, nothing
    if model.frames is None:
        momentum = _momentum(lane, model, par, q, v)
    else:
        clear(lane, zero, 0, model.n)
        assemble(lane, model, par, State(q, zero, v), u, RESIDUAL_ALONE, r, S)
        momentum = vector(lane, r, 0)
        for k in range(model.links):
            for e in range(count_of(model, k)):
                momentum = plus(momentum, vector(lane, r, joint_row(model, k) + 1 + AXES * e))
    if model.gravity is not None:
        push = times(three_of(lane, model.gravity, 0), mass)
    if model.loads is not None:
        for f in range(model.loads.shape[0] // L.end):
            push = plus(push, vector(lane, u, model.links + AXES * f))
    if model.frames is not None:  # weight and loads are in the residual
        momentum = plus(momentum, push)
    if before is None:
        return momentum, push
    wanted = plus(before[0], times(plus(before[1], push), 0.5 * h))
    shift = times(minus(wanted, momentum), 1.0 / mass)
    add_vector(lane, v, 0, shift)
    for k in range(model.links):
        for e in range(max(count_of(model, k), 1)):
            add_vector(lane, v, joint_row(model, k) + 1 + AXES * e, shift)
    return wanted, push


@kernel
def renewed(model, iteration):
    """See `protocol`: the factors of the second iteration will do for the third and the fourth."""
    return iteration != 2 and iteration != 3


@kernel
def _note(lane, model, S, h, hinge, tip, on_root):
    """What `_hand_on` needs of a joint."""
    put_matrix(S, h + H.now_turn, hinge.turn)
    put_vector(S, h + H.now_force, on_root[0])
    put_vector(S, h + H.now_moment, on_root[1])
    if model.levers is not None:
        put_vector(S, h + H.now_lever, hinge.lever)
        put_matrix(S, h + H.now_frame, matrix(tip.place.p))


@kernel
def _hand_on(lane, model, u, weights, r, S, k):
    """What is on the root of link k, to the joint and to the section before."""
    h, row = hinge_at(k), joint_row(model, k)
    force, moment = vector(lane, S, h + H.now_force), vector(lane, S, h + H.now_moment)
    if count_of(model, k) == 0:  # what is on the rows of a rigid link is on its root
        force, moment = plus(force, vector(lane, r, row + 1)), plus(moment, vector(lane, r, row + 4))
        clear(lane, r, row + 1, 6)
    _add(lane, r, rows_before(model, k), _handed(lane, model, u, weights, r, S, k, force, moment))


@kernel
def _handed(lane, model, u, weights, r, S, k, force, moment):
    """(force, moment) on the section before joint k of those on the root of its link; to the joint's row what is on
    that; and what the matrix needs of it."""
    h, axis = hinge_at(k), three_of(lane, model.joints, J.end * k + J.axis)
    turn = matrix_in(lane, S, h + H.now_turn)
    own, on_section = dot(axis, moment), turned(turn, moment)
    if model.levers is not None:
        frame, lever = matrix_in(lane, S, h + H.now_frame), vector(lane, S, h + H.now_lever)
        pull = back(frame, force)
        on_section = plus(on_section, cross(lever, pull))
        far = three_of(lane, model.joints, J.end * k + J.beyond)
        own = own + dot(cross(axis, far), back(turn, pull))
        if weights.mass != 0.0:
            put_vector(S, h + H.force, times(pull, weights.stiffness))
            put_vector(S, h + H.lever, lever)
            put_matrix(S, h + H.frame, frame)
    store(r, joint_row(model, k), own - load(lane, u, k))
    if weights.mass != 0.0:
        put_matrix(S, h + H.turn, turn)
        put_vector(S, h + H.moment, times(moment, weights.stiffness))
        store(S, h + H.own, splat(lane, 0.0))
        store(S, h + H.pinned, splat(lane, 0.0))
    return force, on_section


register(
    SpatialBeam, assemble=assemble, pin=pin, stiffen=stiffen, factor=factor, solve=solve, update=update,
    difference=difference, energy=energy, ports=ports, ports_after=ports_after, damping_work=damping_work,
    link_poses=link_poses, shape=shape, predict=predict, task_poses=task_poses, stand=stand,
    light=light, rotates=rotates, tangent_map=tangent_map, conserve=conserve, gyrate=gyrate, lean=lean, sway=sway,
    gauge=gauge, renewed=renewed, settle=settle, stride=stride, damping_over=damping_over, note_inverse=note_inverse,
    noted_inverse=noted_inverse,
)  # fmt: skip
