"""Chains of geometrically exact beams in space: residual, tangent and its factors (model: `SpatialBeam`).

Where all that is in coordinates and in S is told in `layout`. Half of an element's mass and rotary inertia is at each of
its ends; a vertex's moment is J dw/dt + w x J w in its own axes. The vertices are eliminated from the tip to the base,
the joint of each link on the way.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ...compiler import kernel, load, sincos, splat, store
from ..arithmetic import add
from ..model import PAYLOAD_INERTIA, PAYLOAD_MASS, STIFFNESS_FACTOR, TAU_D  # noqa: F401
from ..protocol import State, register
from .element import Place, Section, forces, middle, scale, tangent
from .layout import AXES, B, E, F, H, J, P, before, factor_at, hinge_at, joint_row
from .rotations import (
    about_identity,
    add_vector,
    back,
    composed,
    cross,
    difference,
    dot,
    matrix,
    minus,
    moved,
    plus,
    product,
    put_vector,
    quaternion,
    scaled,
    skew,
    sum_of,
    times,
    transposed,
    turned,
    vector,
)


class SpatialBeam(NamedTuple):
    """N links of equal numbers of elements in space. What is None is compiled out.

    sections  float64: an `ELEMENT` for each element, from root to tip
    joints    float64: a `JOINT` for each link, at its root
    payload   float64 `BODY`
    gravity   float64 (3,) m/s^2, or None
    loads     int64 (n,): the first row of the vertex that a force and a moment along inertial axes work on, or None
    damped    (0,) with Kelvin-Voigt damping, otherwise None
    """

    n: int
    n_factor: int
    n_inputs: int
    fixed: np.ndarray
    algebraic: None
    weight: np.ndarray
    predictor: float
    correction: None
    links: int
    elements: int
    sections: np.ndarray
    joints: np.ndarray
    payload: np.ndarray
    gravity: np.ndarray | None
    loads: np.ndarray | None
    damped: tuple[int, ...] | None


class Vertex(NamedTuple):
    """A section at a vertex: where it is, and the accelerations of it."""

    place: Place
    a: Any  # less gravity, inertial axes
    alpha: Any  # in its own


@kernel
def _three(lane, array, k):
    """Three numbers of a model, in all lanes."""
    return splat(lane, array[k]), splat(lane, array[k + 1]), splat(lane, array[k + 2])


@kernel
def _nine(lane, array, k):
    return _three(lane, array, k), _three(lane, array, k + 3), _three(lane, array, k + 6)


@kernel
def _section(lane, model, par, i):
    o, factor = E.end * i, load(lane, par, STIFFNESS_FACTOR)
    x, y, z = _three(lane, model.sections, o + E.bend)
    tau = None if model.damped is None else load(lane, par, TAU_D)
    stretch, rest = _three(lane, model.sections, o + E.stretch), _three(lane, model.sections, o + E.rest)
    return Section(splat(lane, model.sections[o + E.length]), stretch, (x, y * factor, z * factor), rest, tau)


@kernel
def _acceleration(lane, model, a, i):
    """Of row i, less gravity."""
    found = vector(lane, a, i)
    if model.gravity is not None:
        return minus(found, _three(lane, model.gravity, 0))
    return found


@kernel
def vertex(lane, model, state, i):
    """The section whose rows begin at i."""
    q, v, a = state
    place = Place(vector(lane, q, i), vector(lane, v, i), quaternion(vector(lane, q, i + 3)), vector(lane, v, i + 3))
    return Vertex(place, _acceleration(lane, model, a, i), vector(lane, a, i + 3))


@kernel
def hinged(lane, model, state, k, tip):
    """(rotation of the root of link k against the section before, that root)."""
    q, v, a = state
    o, row = J.end * k, joint_row(model, k)
    axis, mount = _three(lane, model.joints, o + J.axis), _nine(lane, model.joints, o + J.mount)
    sine, cosine = sincos(load(lane, q, row))
    turn = product(mount, about_identity(cosine, times(axis, sine), 1.0 - cosine, axis))
    half_sine, half_cosine = sincos(load(lane, q, row) * 0.5)
    mounted = composed(tip.place.p, _mount_quaternion(lane, model, k))
    p = composed(mounted, (half_cosine, axis[0] * half_sine, axis[1] * half_sine, axis[2] * half_sine))
    rate = times(axis, load(lane, v, row))
    spin = plus(back(turn, tip.place.spin), rate)
    alpha = plus(plus(back(turn, tip.alpha), times(axis, load(lane, a, row))), cross(spin, rate))
    return turn, Vertex(Place(tip.place.r, tip.place.v, p, spin), tip.a, alpha)


@kernel
def _mount_quaternion(lane, model, k):
    o = J.end * k + J.quaternion
    return (
        splat(lane, model.joints[o]), splat(lane, model.joints[o + 1]), splat(lane, model.joints[o + 2]),
        splat(lane, model.joints[o + 3]),
    )  # fmt: skip


@kernel
def _diagonal(a):
    zero = a[0] * 0.0
    return (a[0], zero, zero), (zero, a[1], zero), (zero, zero, a[2])


@kernel
def turning(I, spin, alpha):
    """I alpha + w x I w."""
    return plus(turned(I, alpha), cross(spin, turned(I, spin)))


@kernel
def _turning_slope(I, spin, cm, cd):
    """Derivative of `turning`: cm I + cd (w^ I - (I w)^)."""
    return sum_of(scaled(I, cm), scaled(difference(product(skew(spin), I), skew(turned(I, spin))), cd))


@kernel
def _add_block(lane, S, o, i, j, A):
    """Block (i, j) of three rows and columns of the 6 x 6 matrix at o, += A."""
    for a in range(3):
        for b in range(3):
            add(lane, S, o + 18 * i + 6 * a + 3 * j + b, A[a][b])


@kernel
def _lump(lane, mass, I, at, weights, S, o):
    """(force, moment) of a mass with its centre in a section, and its part of the matrix at o."""
    if weights.mass != 0.0:
        for a in range(3):
            add(lane, S, o + 7 * a, mass * weights.mass)
        _add_block(lane, S, o, 1, 1, _turning_slope(I, at.place.spin, weights.mass, weights.damping))
    return times(at.a, mass), turning(I, at.place.spin, at.alpha)


@kernel
def _payload(lane, model, par, at, weights, S, o):
    """(force, moment) of the payload at the tip, and its part of the matrix at o."""
    mass, c = load(lane, par, PAYLOAD_MASS), _three(lane, model.payload, P.centre)
    I, A, w = _nine(lane, model.payload, P.inertia), matrix(at.place.p), at.place.spin
    swing = plus(cross(at.alpha, c), cross(w, cross(w, c)))
    pull = times(plus(back(A, at.a), swing), mass)  # force, in its axes
    moment = plus(turning(I, w, at.alpha), cross(c, pull))
    if weights.mass != 0.0:
        cm, cd, ck = weights.mass, weights.damping, weights.stiffness
        chat, arm = skew(c), times(c, mass)
        # of alpha x c + w x (w x c) by the rotation: -cm c^ - cd ((w x c)^ + w^ c^)
        by_turn = scaled(sum_of(scaled(skew(arm), cm), scaled(sum_of(skew(cross(w, arm)), product(skew(w), skew(arm))), cd)), -1.0)
        inner = sum_of(by_turn, scaled(skew(times(back(A, at.a), mass)), ck))
        for a in range(3):
            add(lane, S, o + 7 * a, mass * cm)
        xt = product(A, difference(by_turn, scaled(skew(times(swing, mass)), ck)))
        _add_block(lane, S, o, 0, 1, xt)
        _add_block(lane, S, o, 1, 0, scaled(product(chat, transposed(A)), mass * cm))
        _add_block(lane, S, o, 1, 1, sum_of(product(chat, inner), _turning_slope(I, w, cm, cd)))
    return turned(A, pull), moment


@kernel
def _clear(lane, S, o, n):
    zero = splat(lane, 0.0)
    for i in range(n):
        store(S, o + i, zero)


@kernel
def assemble(lane, model, par, state, u, weights, r, S):
    """See `protocol`."""
    zero = splat(lane, 0.0)
    nothing = zero, zero, zero
    for i in range(model.n):
        store(r, i, zero)
    matrix_too = weights.mass != 0.0
    if matrix_too:
        _clear(lane, S, 0, B.end)
    tip = vertex(lane, model, state, 0)
    o, i = 0, 0  # the matrix and the rows of the section before
    for k in range(model.links):
        at, h, row = J.end * k, hinge_at(k), joint_row(model, k)
        first = factor_at(model, k, 0)
        near = _nine(lane, model.joints, at + J.near)
        force, moment = _lump(lane, splat(lane, model.joints[at + J.mass]), near, tip, weights, S, o)
        add_vector(lane, r, i, force)
        add_vector(lane, r, i + 3, moment)
        turn, left = hinged(lane, model, state, k, tip)
        j = row + 1
        force, moment = nothing, nothing
        root = left
        for e in range(model.elements):
            element = k * model.elements + e
            section = _section(lane, model, par, element)
            right = vertex(lane, model, state, j)
            _, inner = middle(section, left.place, right.place)
            on_left, on_right = forces(section, inner)
            f = first + F.end * e
            if matrix_too:
                tangent(section, inner, weights.stiffness, weights.damping, S, f)
            half = splat(lane, model.sections[E.end * element + E.mass])
            I = _diagonal(_three(lane, model.sections, E.end * element + E.inertia))
            pulled, spun = _lump(lane, half, I, left, weights, S, f + F.LL)
            if e == 0:
                force, moment = plus(on_left[0], pulled), plus(on_left[1], spun)
            else:
                add_vector(lane, r, j - AXES, plus(on_left[0], pulled))
                add_vector(lane, r, j - 3, plus(on_left[1], spun))
            pulled, spun = _lump(lane, half, I, right, weights, S, f + F.RR)
            put_vector(r, j, plus(on_right[0], pulled))
            put_vector(r, j + 3, plus(on_right[1], spun))
            left = right
            j += AXES
        pulled, spun = _lump(lane, zero, _nine(lane, model.joints, at + J.far), root, weights, S, first + F.LL)
        moment = plus(moment, spun)
        add_vector(lane, r, i, force)
        add_vector(lane, r, i + 3, turned(turn, moment))
        store(r, row, dot(_three(lane, model.joints, at + J.axis), moment) - load(lane, u, k))
        if matrix_too:
            for a in range(3):
                put_vector(S, h + H.turn + 3 * a, turn[a])
            put_vector(S, h + H.moment, times(moment, weights.stiffness))
            store(S, h + H.own, zero)
            store(S, h + H.pinned, zero)
        tip, i, o = left, j - AXES, factor_at(model, k, model.elements - 1) + F.RR
    force, moment = _payload(lane, model, par, tip, weights, S, o)
    add_vector(lane, r, i, force)
    add_vector(lane, r, i + 3, moment)
    if model.loads is not None:
        for k in range(model.loads.shape[0]):
            i, j = model.loads[k], model.links + AXES * k
            add_vector(lane, r, i, times(vector(lane, u, j), -1.0))
            A = matrix(quaternion(vector(lane, state.q, i + 3)))
            add_vector(lane, r, i + 3, times(back(A, vector(lane, u, j + 3)), -1.0))


@kernel
def pin(lane, model, S, k):
    """See `protocol`."""
    one = splat(lane, 1.0)
    if k < AXES:
        store(S, B.pinned + k, one)
    else:
        store(S, hinge_at((k - AXES) // (1 + AXES * model.elements)) + H.pinned, one)


@kernel
def stiffen(lane, model, S, k, x):
    """See `protocol`."""
    store(S, hinge_at((k - AXES) // (1 + AXES * model.elements)) + H.own, x)


@kernel
def _factor_six(lane, S, o):
    """L and U of the 6 x 6 matrix at o, in place, its pivots inverted. No rows are exchanged: mass outweighs the rest."""
    for k in range(6):
        inverse = 1.0 / load(lane, S, o + 7 * k)
        store(S, o + 7 * k, inverse)
        for i in range(k + 1, 6):
            factor = load(lane, S, o + 6 * i + k) * inverse
            store(S, o + 6 * i + k, factor)
            for j in range(k + 1, 6):
                add(lane, S, o + 6 * i + j, -(factor * load(lane, S, o + 6 * k + j)))


@kernel
def _solve_six(lane, S, o, x, i, stride):
    """Six elements of x from i on, `stride` apart, by the factors at o."""
    for k in range(1, 6):
        total = load(lane, x, i + stride * k)
        for j in range(k):
            total = total - load(lane, S, o + 6 * k + j) * load(lane, x, i + stride * j)
        store(x, i + stride * k, total)
    for back_k in range(6):
        k = 5 - back_k
        total = load(lane, x, i + stride * k)
        for j in range(k + 1, 6):
            total = total - load(lane, S, o + 6 * k + j) * load(lane, x, i + stride * j)
        store(x, i + stride * k, total * load(lane, S, o + 7 * k))


@kernel
def _block(lane, S, o, i, j):
    k = o + 18 * i + 3 * j
    return vector(lane, S, k), vector(lane, S, k + 6), vector(lane, S, k + 12)


@kernel
def _turn_of(lane, S, h):
    """`HINGE.turn` at h."""
    return vector(lane, S, h + H.turn), vector(lane, S, h + H.turn + 3), vector(lane, S, h + H.turn + 6)


@kernel
def _eliminate_joint(lane, model, S, k):
    """What is at the root of link k, to the vertex before, without the joint's row."""
    h, o, below = hinge_at(k), factor_at(model, k, 0) + F.LL, before(model, k)
    axis, turn = _three(lane, model.joints, J.end * k + J.axis), _turn_of(lane, S, h)
    to_root = transposed(turn)
    xx, xt, tx, tt = _block(lane, S, o, 0, 0), _block(lane, S, o, 0, 1), _block(lane, S, o, 1, 0), _block(lane, S, o, 1, 1)
    _add_block(lane, S, below, 0, 0, xx)
    _add_block(lane, S, below, 0, 1, product(xt, to_root))
    _add_block(lane, S, below, 1, 0, product(turn, tx))
    _add_block(lane, S, below, 1, 1, product(product(turn, tt), to_root))
    if S[(h + H.pinned) * len(lane)] == 0.0:
        moment = cross(axis, vector(lane, S, h + H.moment))
        force, turning_moment = turned(xt, axis), turned(turn, plus(turned(tt, axis), moment))
        inverse = 1.0 / (dot(axis, turned(tt, axis)) + load(lane, S, h + H.own))
        by_place, by_turn = back(tx, axis), turned(turn, back(tt, axis))
        put_vector(S, h + H.column, force)
        put_vector(S, h + H.column + 3, turning_moment)
        put_vector(S, h + H.row, times(by_place, inverse))
        put_vector(S, h + H.row + 3, times(by_turn, inverse))
        store(S, h + H.pivot, inverse)
        for i in range(6):
            for j in range(6):
                add(lane, S, below + 6 * i + j, -(load(lane, S, h + H.column + i) * load(lane, S, h + H.row + j)))
    else:
        _clear(lane, S, h + H.column, 12)
        store(S, h + H.pivot, splat(lane, 1.0))


@kernel
def factor(lane, model, S):
    """See `protocol`."""
    for back_k in range(model.links):
        k = model.links - 1 - back_k
        for back_e in range(model.elements):
            o = factor_at(model, k, model.elements - 1 - back_e)
            _factor_six(lane, S, o + F.RR)
            for j in range(6):
                _solve_six(lane, S, o + F.RR, S, o + F.RL + j, 6)
            for i in range(6):
                for j in range(6):
                    total = load(lane, S, o + F.LL + 6 * i + j)
                    for m in range(6):
                        total = total - load(lane, S, o + F.LR + 6 * i + m) * load(lane, S, o + F.RL + 6 * m + j)
                    store(S, o + F.LL + 6 * i + j, total)
            if back_e < model.elements - 1:
                for i in range(36):
                    add(lane, S, o - F.end + F.RR + i, load(lane, S, o + F.LL + i))
        _eliminate_joint(lane, model, S, k)
    zero, one = splat(lane, 0.0), splat(lane, 1.0)
    for i in range(6):
        if S[(B.pinned + i) * len(lane)] != 0.0:
            for j in range(6):
                store(S, B.matrix + 6 * i + j, zero)
                store(S, B.matrix + 6 * j + i, zero)
            store(S, B.matrix + 7 * i, one)
    _factor_six(lane, S, B.matrix)


@kernel
def _across(lane, S, o, x, i):
    """The 6 x 6 matrix at o times six elements of x: (first three, last three)."""
    a, b = vector(lane, x, i), vector(lane, x, i + 3)
    upper = plus(turned(_block(lane, S, o, 0, 0), a), turned(_block(lane, S, o, 0, 1), b))
    return upper, plus(turned(_block(lane, S, o, 1, 0), a), turned(_block(lane, S, o, 1, 1), b))


@kernel
def _times_pair(lane, S, o, a, b):
    """The 6 x 6 matrix at o times (a, b)."""
    upper = plus(turned(_block(lane, S, o, 0, 0), a), turned(_block(lane, S, o, 0, 1), b))
    return upper, plus(turned(_block(lane, S, o, 1, 0), a), turned(_block(lane, S, o, 1, 1), b))


@kernel
def solve(lane, model, S, x):
    """See `protocol`."""
    for back_k in range(model.links):
        k = model.links - 1 - back_k
        h, row = hinge_at(k), joint_row(model, k)
        axis, turn = _three(lane, model.joints, J.end * k + J.axis), _turn_of(lane, S, h)
        under = row - AXES if k > 0 else 0
        for back_e in range(model.elements):
            e = model.elements - 1 - back_e
            o, i = factor_at(model, k, e), row + 1 + AXES * e
            _solve_six(lane, S, o + F.RR, x, i, 1)
            a, b = _across(lane, S, o + F.LR, x, i)
            if e > 0:
                add_vector(lane, x, i - 6, times(a, -1.0))
                add_vector(lane, x, i - 3, times(b, -1.0))
            else:
                add_vector(lane, x, under, times(a, -1.0))
                add_vector(lane, x, under + 3, times(turned(turn, b), -1.0))
                if S[(h + H.pinned) * len(lane)] == 0.0:
                    own = load(lane, x, row) - dot(axis, b)
                    for j in range(6):
                        change = load(lane, S, h + H.column + j) * load(lane, S, h + H.pivot) * own
                        add(lane, x, under + j, -change)
                    store(x, row, own * load(lane, S, h + H.pivot))
    for i in range(6):
        if S[(B.pinned + i) * len(lane)] != 0.0:
            store(x, i, splat(lane, 0.0))
    _solve_six(lane, S, B.matrix, x, 0, 1)
    for k in range(model.links):
        h, row = hinge_at(k), joint_row(model, k)
        under = row - AXES if k > 0 else 0
        axis, turn = _three(lane, model.joints, J.end * k + J.axis), _turn_of(lane, S, h)
        own = load(lane, x, row)
        for j in range(6):
            own = own - load(lane, S, h + H.row + j) * load(lane, x, under + j)
        store(x, row, own)
        a, b = vector(lane, x, under), plus(back(turn, vector(lane, x, under + 3)), times(axis, own))
        i = row + 1
        for e in range(model.elements):
            up, low = _times_pair(lane, S, factor_at(model, k, e) + F.RL, a, b)
            a, b = minus(vector(lane, x, i), up), minus(vector(lane, x, i + 3), low)
            put_vector(x, i, a)
            put_vector(x, i + 3, b)
            i += AXES


@kernel
def _move_vertex(lane, q, i, share, d, more):
    """Place and rotation of the rows from i on."""
    step, turn = times(vector(lane, d, i), share), times(vector(lane, d, i + 3), share)
    if more is not None:
        step, turn = plus(step, vector(lane, more, i)), plus(turn, vector(lane, more, i + 3))
    add_vector(lane, q, i, step)
    put_vector(q, i + 3, moved(vector(lane, q, i + 3), turn))


@kernel
def update(lane, model, q, share, d, more):
    """See `protocol`: rotations are moved by increments in body axes, the sum of both."""
    _move_vertex(lane, q, 0, share, d, more)
    i = AXES
    for _ in range(model.links):
        angle = load(lane, d, i) * share
        if more is not None:
            angle = angle + load(lane, more, i)
        add(lane, q, i, angle)
        i += 1
        for _ in range(model.elements):
            _move_vertex(lane, q, i, share, d, more)
            i += AXES


@kernel
def _at(lane, q, v, i):
    return Place(vector(lane, q, i), vector(lane, v, i), quaternion(vector(lane, q, i + 3)), vector(lane, v, i + 3))


@kernel
def _of_lump(lane, model, mass, I, at):
    """(kinetic, gravity) energy of a mass with its centre in a section."""
    kinetic = (dot(at.v, at.v) * mass + dot(at.spin, turned(I, at.spin))) * 0.5
    if model.gravity is None:
        return kinetic, splat(lane, 0.0)
    return kinetic, -(dot(_three(lane, model.gravity, 0), at.r) * mass)


@kernel
def energy(lane, model, par, q, v):
    """(kinetic, strain, gravity), J."""
    state = State(q, v, v)
    tip = _at(lane, q, v, 0)
    kinetic, strain, gravity = splat(lane, 0.0), splat(lane, 0.0), splat(lane, 0.0)
    for k in range(model.links):
        at, i = J.end * k, joint_row(model, k) + 1
        more, fall = _of_lump(lane, model, splat(lane, model.joints[at + J.mass]), _nine(lane, model.joints, at + J.near), tip)
        kinetic, gravity = kinetic + more, gravity + fall
        _, root = hinged(lane, model, state, k, Vertex(tip, tip.v, tip.spin))
        left = root.place
        spin = left.spin
        kinetic = kinetic + dot(spin, turned(_nine(lane, model.joints, at + J.far), spin)) * 0.5
        for e in range(model.elements):
            element = k * model.elements + e
            section, right = _section(lane, model, par, element), _at(lane, q, v, i)
            strains, _ = middle(section, left, right)
            gamma, bent = strains
            stretch = dot(gamma, scale(gamma, section.stretch)) * section.length
            strain = strain + (stretch + dot(bent, scale(bent, section.bend)) / section.length) * 0.5
            half = splat(lane, model.sections[E.end * element + E.mass])
            I = _diagonal(_three(lane, model.sections, E.end * element + E.inertia))
            more, fall = _of_lump(lane, model, half, I, left)
            kinetic, gravity = kinetic + more, gravity + fall
            more, fall = _of_lump(lane, model, half, I, right)
            kinetic, gravity = kinetic + more, gravity + fall
            left = right
            i += AXES
        tip = left
    c, A = _three(lane, model.payload, P.centre), matrix(tip.p)
    r, rate = plus(tip.r, turned(A, c)), plus(tip.v, turned(A, cross(tip.spin, c)))
    body = Place(r, rate, tip.p, tip.spin)
    more, fall = _of_lump(lane, model, load(lane, par, PAYLOAD_MASS), _nine(lane, model.payload, P.inertia), body)
    return kinetic + more, strain, gravity + fall


register(
    SpatialBeam, assemble=assemble, pin=pin, stiffen=stiffen, factor=factor, solve=solve, update=update, energy=energy
)
