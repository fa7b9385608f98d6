"""Chains in space: the residual and its tangent (models: `chain`).

Where all that is in coordinates and in S is told in `layout`. Of exact beams half of an element's rotary inertia is at
each of its ends; a vertex's moment is J dw/dt + w x J w in its own axes.
"""

from __future__ import annotations

from ...compiler import apart, kernel, load, splat, store
from ..arithmetic import put_vector, vector
from ..model import PAYLOAD_INERTIA, PAYLOAD_MASS
from ..protocol import register
from .chain import (
    SpatialBeam,
    SpatialElastica,
    body,
    clear,
    has_lever,
    hinged,
    loaded,
    lump,
    onto,
    rotor_moment,
    section_at,
    three_of,
    vertex_at,
)
from .element import forces, inertia, middle, tangent
from .elimination import factor, solve
from .framed import framed
from .inner import elements_before
from .layout import AXES, B, E, F, H, J, L, before, count_of, factor_at, hinge_at, joint_row
from .matrix import gyrate, lean, matrix_in, note_lag, pin, stiffen, sway
from .moving import difference, note_inverse, noted_inverse, rotates, tangent_map, update, vertices_of
from .output import (
    both,
    damping_over,
    damping_work,
    energy,
    gauge,
    light,
    link_poses,
    momentum,
    ports,
    ports_after,
    predict,
    shape,
    stand,
    task_poses,
)
from .rotations import add_vector, back, cross, dot, matrix, minus, plus, put_matrix, times, turned
from .settled import lack, settle, stride
from .strained import elastic, pull, strained_difference, strained_update, walk
from .strained_layout import noted_at
from .strained_tangent import strained_tangent


@apart
def _add(lane, r, i, of):
    """(force, moment) to the rows from i on; apart: in a loop without a call LLVM compares all that is read or
    written, pair by pair, of an element hundreds."""
    add_vector(lane, r, i, of[0])
    add_vector(lane, r, i + 3, of[1])


@kernel
def assemble(lane, model, par, state, u, weights, r, S):
    """See `protocol`."""
    clear(lane, r, 0, model.n)
    if weights.mass != 0.0:
        clear(lane, S, 0, B.end)
    tip = vertex_at(lane, model, state, 0)
    for k in range(model.links):
        at, first, o = J.end * k, factor_at(model, k, 0) + F.LL, before(model, k)
        if k > 0:
            onto(lane, model, r, S, k, body(lane, model.joints, at + J.near, None, None, tip, weights, S, o))
            onto(lane, model, r, S, k, loaded(lane, model, u, k - 1, True, tip, weights, S, o))
        if model.rotors is not None:
            if model.rotors[k] != 0:
                onto(lane, model, r, S, k, rotor_moment(lane, model, S, k, tip, weights, o))
        hinge = hinged(lane, model, state, k, tip, weights)
        last, on_root = _along(lane, model, par, k, state, hinge.root, weights, r, S)
        on_root = both(on_root, body(lane, model.joints, at + J.far, None, None, hinge.root, weights, S, first))
        on_root = both(on_root, loaded(lane, model, u, k, False, hinge.root, weights, S, first))
        _note(lane, model, S, k, hinge, tip, on_root)
        if weights.mass != 0.0:
            note_lag(lane, model, par, S, k, hinge.root.place.spin, weights)
        tip = last
    n, o = model.links, before(model, model.links)
    onto(lane, model, r, S, n, body(lane, model.end, 0, None, None, tip, weights, S, o))
    mass, share = load(lane, par, PAYLOAD_MASS), load(lane, par, PAYLOAD_INERTIA)
    onto(lane, model, r, S, n, body(lane, model.payload, 0, mass, share, tip, weights, S, o))
    onto(lane, model, r, S, n, loaded(lane, model, u, n - 1, True, tip, weights, S, o))
    for back_k in range(model.links):
        k = model.links - 1 - back_k
        h = hinge_at(k)
        on_root = vector(lane, S, h + H.now_force), vector(lane, S, h + H.now_moment)
        on_root = _gathered(lane, model, par, k, state, weights, r, S, on_root)
        onto(lane, model, r, S, k, _handed(lane, model, u, weights, r, S, k, on_root[0], on_root[1]))


@kernel
def _along(lane, model, par, k, state, root, weights, r, S):
    """The last `Vertex` of link k behind that of its root, and (force, moment) on the root as far as they are known (of
    strains: `_gathered`, from what is on the last section); the link's part of the matrix."""
    zero, first = splat(lane, 0.0), factor_at(model, k, 0)
    on_root = (zero, zero, zero), (zero, zero, zero)
    if model.strains is not None:
        clear(lane, S, noted_at(model, k).on, 6)
        if weights.mass != 0.0:
            clear(lane, S, first, F.end)
        if count_of(model, k) == 0:
            return root, on_root
        return walk(lane, model, k, state, root, S), on_root
    left, j, element = root, joint_row(model, k) + 1, elements_before(model, k)
    if weights.mass != 0.0:
        if count_of(model, k) == 0:
            clear(lane, S, first + F.LL, 36)
    for e in range(count_of(model, k)):
        section, right = section_at(lane, model, par, element), vertex_at(lane, model, state, j)
        f = first + F.end * e
        if model.frames is None:
            on_left, on_right = _exact(lane, model, section, left, right, element, weights, S, f)
        else:
            on_left, on_right = framed(lane, model, par, section, state, left, right, element, weights, r, S, f)
        if e == 0:
            on_root = on_left
        else:
            _add(lane, r, j - AXES, on_left)
        add_vector(lane, r, j, on_right[0])
        add_vector(lane, r, j + 3, on_right[1])
        left = right
        j += AXES
        element += 1
    return left, on_root


@kernel
def _gathered(lane, model, par, k, state, weights, r, S, of):
    """All (force, moment) on the root of link k: `of`, and what lies behind."""
    i = joint_row(model, k) + 1
    if model.strains is not None:
        on = noted_at(model, k).on
        more = vector(lane, S, on), vector(lane, S, on + 3)
        if count_of(model, k) > 0:
            more = pull(lane, model, k, r, S)
            elastic(lane, model, par, k, state, r)
            if weights.mass != 0.0:
                strained_tangent(lane, model, par, k, weights, S, factor_at(model, k, 0))
        return both(of, more)
    if count_of(model, k) == 0:  # what is on the rows of a rigid link is on its root
        of = both(of, (vector(lane, r, i), vector(lane, r, i + 3)))
        clear(lane, r, i, AXES)
    return of


@kernel
def _exact(lane, model, section, left, right, element, weights, S, f):
    """((force, moment) of the left end, of the right) of an element of the exact beam; its `FACTOR` at f of S."""
    inner = middle(section, left.place, right.place)[1]
    put_vector(S, f + F.force, inner.n)
    on_left, on_right = forces(section, inner)
    masses = three_of(lane, model.sections, E.end * element + E.mass)
    if weights.mass != 0.0:
        tangent(section, inner, weights, S, f)
    at_left, at_right = inertia(lane, masses[1], section.length, left, right, weights, S, f)
    I = three_of(lane, model.sections, E.end * element + E.inertia)
    on_left = both(both(on_left, at_left), lump(lane, masses[0], I, left, weights, S, f + F.LL))
    return on_left, both(both(on_right, at_right), lump(lane, masses[2], I, right, weights, S, f + F.RR))


@kernel
def conserve(lane, model, par, before, h, q, v, u, r, S):
    """See `protocol`: sections turn, and places of centres and middles are no linear function of what the integrator
    moves; no other equation sees a rigid translation."""
    if model.free is None:
        return None
    mass, nothing = load(lane, par, PAYLOAD_MASS) + model.free, splat(lane, 0.0)
    push = nothing, nothing, nothing
    if model.gravity is not None:
        push = times(three_of(lane, model.gravity, 0), mass)
    if model.loads is not None:
        for f in range(model.loads.shape[0] // L.end):
            push = plus(push, vector(lane, u, model.links + AXES * f))
    now = momentum(lane, model, par, q, v)
    if before is None:
        return now, push
    wanted = plus(before[0], times(plus(before[1], push), 0.5 * h))
    shift = times(minus(wanted, now), 1.0 / mass)
    add_vector(lane, v, 0, shift)
    if model.strains is None:  # by strains all else is relative
        for k in range(model.links):
            for e in range(vertices_of(model, k)):
                add_vector(lane, v, joint_row(model, k) + 1 + AXES * e, shift)
    return wanted, push


@kernel
def keeps(model, iteration):
    """See `protocol`: the factors of the second iteration will do for the third and the fourth. By strains the matrix
    costs four residuals and more; what does not converge with one has all of its own."""
    if model.strains is not None:
        return iteration == 1 or iteration == 2
    return iteration == 2 or iteration == 3


@kernel
def _note(lane, model, S, k, hinge, tip, on_root):
    """What `_handed` needs of joint k."""
    h = hinge_at(k)
    put_matrix(S, h + H.now_turn, hinge.turn)
    put_vector(S, h + H.now_force, on_root[0])
    put_vector(S, h + H.now_moment, on_root[1])
    if has_lever(model, k):
        put_vector(S, h + H.now_lever, hinge.lever)
        put_matrix(S, h + H.now_frame, matrix(tip.place.p))


@kernel
def _handed(lane, model, u, weights, r, S, k, force, moment):
    """(force, moment) on the section before joint k of those on the root of its link; to the joint's row what is on
    that; and what the matrix needs of it."""
    h, axis = hinge_at(k), three_of(lane, model.joints, J.end * k + J.axis)
    turn = matrix_in(lane, S, h + H.now_turn)
    own, on_section = dot(axis, moment), turned(turn, moment)
    if has_lever(model, k):
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


COMMON = (
    assemble, pin, stiffen, factor, solve, energy, ports, ports_after, damping_work, link_poses, shape, task_poses,
    stand, conserve, gyrate, lean, sway, keeps,
)  # fmt: skip
register(SpatialElastica, *COMMON, update=strained_update, difference=strained_difference)
register(
    SpatialBeam, *COMMON, update, difference, predict, light, rotates, tangent_map, gauge, settle, stride, lack,
    damping_over, note_inverse, noted_inverse,
)  # fmt: skip
