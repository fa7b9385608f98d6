"""Chains in space: their Model, and where a section is and how it moves, from the base on."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ...compiler import kernel, load, sincos, splat, store
from ..arithmetic import add, put_vector, vector
from ..model import EI_Y_FACTOR, GJ_FACTOR, STIFFNESS_FACTOR, TAU_D
from ..protocol import of_step
from .element import Place, Section, add_block, scale
from .layout import E, H, J, L, P, hinge_at, joint_row, rows_before
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
    outer,
    plus,
    plus_identity,
    product,
    quaternion,
    scaled,
    skew,
    skewed,
    sum_of,
    swirl,
    times,
    transposed,
    turned,
)
from .strained_layout import noted_at


class Chain(NamedTuple):
    """N links in space, each rigid, or of elements of two vertices, or with its strains as coordinates (`strained`).
    What is None is compiled out.

    places    int64: a `PLACE` for each link, and another for where one more would be
    joints    float64: a `JOINT` for each link, at its root
    end       float64 `BODY`, the last link's rigid end; payload  another
    mounts    int64: of each joint 1 where its `mount` turns; None: no joint's does
    levers    int64: of each joint 1 where it has `before` or `beyond`; None: no joint has
    gravity   float64 (3,) m/s^2, or None
    loads     float64: a `LOAD` each, whose inputs are a force and a moment along inertial axes; or None
    damped    (0,) with Kelvin-Voigt damping, otherwise None
    rotors    int64: of each joint 1 where it has a rotor, which `physics.joints` turns; None: no joint has
    free      kg, of all but the payload, where nothing holds the arm, otherwise None
    sections  float64: an `ELEMENT` for each element, from root to tip; None: coordinates are strains
    frames    float64: a `FRAME` for each, where elements are segments with floating frames; otherwise None
    inner     (0,) * n of segments with n inner modes, whose rows follow all others; otherwise None
    uneven    (0,) where a section or a curvature varies along an element, otherwise None
    strains   float64: a `STRAINED` a link (zeros of rigid ones); None, and so are the next: links have elements
    polynomials, points  tuples of as many zeros: of each strain, and Gauss's points along a link
    scratch   three zeros a point: room on the stack
    curved    (0,) where a link is curved without stress, otherwise None
    """

    n: int
    n_factor: int
    n_inputs: int
    fixed: np.ndarray
    algebraic: None
    weight: np.ndarray
    predictor: tuple[float, float] | None
    correction: None
    links: int
    places: np.ndarray
    joints: np.ndarray
    end: np.ndarray
    payload: np.ndarray
    mounts: np.ndarray | None
    levers: np.ndarray | None
    gravity: np.ndarray | None
    loads: np.ndarray | None
    damped: tuple[int, ...] | None
    rotors: np.ndarray | None
    free: float | None
    sections: np.ndarray | None = None
    frames: np.ndarray | None = None
    inner: tuple[int, ...] | None = None
    uneven: tuple[int, ...] | None = None
    strains: np.ndarray | None = None
    polynomials: tuple[int, ...] = ()
    points: tuple[int, ...] = ()
    scratch: tuple[int, ...] = ()
    curved: tuple[int, ...] | None = None


class SpatialBeam(Chain):
    """Of elements: exact beams, or segments with floating frames."""


class SpatialElastica(Chain):
    """By strains."""


class Vertex(NamedTuple):
    """A section: where it is, and the accelerations of it."""

    place: Place
    a: Any  # less gravity, inertial axes
    alpha: Any  # in its own
    own: Any  # rate of the joint before it, in a step's matrix: w x it is in alpha; otherwise, and by strains, 0


class Hinge(NamedTuple):
    """A joint: rotation of the link's root against the section before; from that section to where the link begins to
    bend, in its axes, or None where no joint has a lever; the link's section there."""

    turn: Any
    lever: Any
    root: Vertex


@kernel
def three_of(lane, array, k):
    """Three numbers of a model, in all lanes."""
    return splat(lane, array[k]), splat(lane, array[k + 1]), splat(lane, array[k + 2])


@kernel
def nine_of(lane, array, k):
    """A matrix of a model, in all lanes."""
    return three_of(lane, array, k), three_of(lane, array, k + 3), three_of(lane, array, k + 6)


@kernel
def uneven_of(lane, model, i):
    """What is uneven of element i: see `element.Section`."""
    if model.uneven is None:
        return None
    o = E.end * i
    tilt = splat(lane, model.sections[o + E.tilt]), splat(lane, model.sections[o + E.tilt + 1])
    return three_of(lane, model.sections, o + E.chord), tilt[0], tilt[1]


@kernel
def factors_of(lane, par):
    """The arm's own factors on GJ, EI_y, EI."""
    return load(lane, par, GJ_FACTOR), load(lane, par, EI_Y_FACTOR), load(lane, par, STIFFNESS_FACTOR)


@kernel
def section_at(lane, model, par, i):
    """Constants of element i of the chain."""
    o, of, factors = E.end * i, model.sections, factors_of(lane, par)
    tau = None if model.damped is None else load(lane, par, TAU_D) * of[o + E.damping]
    _, about_y, about_z = factors
    along_y = about_z / (about_z * of[o + E.shear] + of[o + E.bow])
    along_z = about_y / (about_y * of[o + E.shear + 1] + of[o + E.bow + 1])
    stretch = splat(lane, of[o + E.EA]), along_y, along_z
    bend, rest = scale(three_of(lane, of, o + E.bend), factors), three_of(lane, of, o + E.rest)
    return Section(splat(lane, of[o + E.length]), stretch, bend, rest, uneven_of(lane, model, i), tau)


@kernel
def place_at(lane, q, v, i):
    """The vertex whose rows begin at i."""
    return Place(vector(lane, q, i), vector(lane, v, i), quaternion(vector(lane, q, i + 3)), vector(lane, v, i + 3))


@kernel
def vertex_at(lane, model, state, i):
    """The same, and its accelerations."""
    q, v, a = state
    found = vector(lane, a, i)
    if model.gravity is not None:
        found = minus(found, three_of(lane, model.gravity, 0))
    zero = splat(lane, 0.0)
    return Vertex(place_at(lane, q, v, i), found, vector(lane, a, i + 3), (zero, zero, zero))


@kernel
def has_mount(model, k):
    """Whether the mount of joint k turns; None, known when compiled, where no joint's does."""
    if model.mounts is None:
        return None
    return model.mounts[k] != 0


@kernel
def has_lever(model, k):
    """Whether joint k has one; None, known when compiled, where no joint has."""
    if model.levers is None:
        return None
    return model.levers[k] != 0


@kernel
def planted(lane, model, q, v, k, tip):
    """The turn of joint k, the lever from the `Place` tip of the section before to where its link begins to bend (None
    where no joint has one), the `Place` there, and the joint's rate."""
    o, row = J.end * k, joint_row(model, k)
    axis, held = three_of(lane, model.joints, o + J.axis), tip.p
    half_sine, half_cosine = sincos(load(lane, q, row) * 0.5)
    sine, less = half_sine * half_cosine * 2.0, half_sine * half_sine * 2.0  # less: 1 - cos
    turn = about_identity(1.0 - less, times(axis, sine), less, axis)
    if has_mount(model, k):
        turn, at = product(nine_of(lane, model.joints, o + J.mount), turn), o + J.quaternion
        x, y, z = three_of(lane, model.joints, at + 1)
        held = composed(held, (splat(lane, model.joints[at]), x, y, z))
    own = half_cosine, axis[0] * half_sine, axis[1] * half_sine, axis[2] * half_sine
    p = composed(held, own)
    rate = times(axis, load(lane, v, row))
    spin = plus(back(turn, tip.spin), rate)
    if model.levers is None:
        return turn, None, Place(tip.r, tip.v, p, spin), rate
    zero = splat(lane, 0.0)
    lever, place, moved = (zero, zero, zero), tip.r, tip.v
    if has_lever(model, k):
        near, far = three_of(lane, model.joints, o + J.before), three_of(lane, model.joints, o + J.beyond)
        A, B = matrix(tip.p), matrix(p)
        lever = plus(near, turned(turn, far))
        moved = plus(tip.v, plus(turned(A, cross(tip.spin, near)), turned(B, cross(spin, far))))
        place = plus(tip.r, turned(A, lever))
    return turn, lever, Place(place, moved, p, spin), rate


@kernel
def hinged(lane, model, state, k, tip, weights):
    """The `Hinge` of link k on the section before."""
    q, v, a = state
    o = J.end * k
    turn, lever, root, rate = planted(lane, model, q, v, k, tip.place)
    own = times(three_of(lane, model.joints, o + J.axis), load(lane, a, joint_row(model, k)))
    alpha = plus(plus(back(turn, tip.alpha), own), cross(root.spin, rate))
    rate = times(rate, 0.0 if model.strains is not None else of_step(weights))
    second = tip.a
    if has_lever(model, k):
        near, far = three_of(lane, model.joints, o + J.before), three_of(lane, model.joints, o + J.beyond)
        A, B, w, spin = matrix(tip.place.p), matrix(root.p), tip.place.spin, root.spin
        second = plus(tip.a, plus(turned(A, swirl(w, tip.alpha, near)), turned(B, swirl(spin, alpha, far))))
    return Hinge(turn, lever, Vertex(root, second, alpha, rate))


@kernel
def turning(I, spin, alpha):
    """I alpha + w x I w."""
    return plus(turned(I, alpha), cross(spin, turned(I, spin)))


@kernel
def lump(lane, mass, I, at, weights, S, o):
    """(force, moment) of a mass with its centre in a section and inertia I about its axes, and its part of the matrix
    at o."""
    w, alpha = at.place.spin, at.alpha
    x, y, z = I[2] - I[1], I[0] - I[2], I[1] - I[0]
    if weights.mass != 0.0:  # I cm + (w^ I - (I w)^) cd
        cm, a, b, c = weights.mass, w[0] * weights.damping, w[1] * weights.damping, w[2] * weights.damping
        for k in range(3):
            add(lane, S, o + 7 * k, mass * cm)
            add(lane, S, o + 21 + 7 * k, I[k] * cm)
        add(lane, S, o + 22, c * x)
        add(lane, S, o + 23, b * x)
        add(lane, S, o + 27, c * y)
        add(lane, S, o + 29, a * y)
        add(lane, S, o + 33, b * z)
        add(lane, S, o + 34, a * z)
    moment = I[0] * alpha[0] + w[1] * w[2] * x, I[1] * alpha[1] + w[0] * w[2] * y, I[2] * alpha[2] + w[0] * w[1] * z
    return times(at.a, mass), moment


@kernel
def mass_of(lane, array, o, mass):
    """Mass of the `BODY` at o of `array`, its own where None is given."""
    if mass is None:
        return splat(lane, array[o + P.mass])
    return mass


@kernel
def inertia_of(lane, array, o, share):
    """The tensor of the `BODY` at o of `array`, as it is or times a share."""
    I = nine_of(lane, array, o + P.inertia)
    if share is None:
        return I
    return scaled(I, share)


@kernel
def body(lane, array, o, mass, share, at, weights, S, to):
    """(force, moment) of the `BODY` at o of `array`, of `mass_of` and `inertia_of`, on a section, and its part of the
    matrix at `to`."""
    zero = splat(lane, 0.0)
    force, moment = (zero, zero, zero), (zero, zero, zero)
    if array[o + P.there] != 0.0:
        c, mass = three_of(lane, array, o + P.centre), mass_of(lane, array, o, mass)
        I = inertia_of(lane, array, o, share)
        A, w, arm = matrix(at.place.p), at.place.spin, times(c, mass)
        own, swing = times(back(A, at.a), mass), swirl(w, at.alpha, arm)  # of the force, in its axes
        force, moment = turned(A, plus(own, swing)), plus(turning(I, w, at.alpha), cross(c, plus(own, swing)))
        if weights.mass != 0.0:
            cm, cd, ck = weights.mass, weights.damping, weights.stiffness
            # of alpha x c + w x (w x c) by the rotation: -c^ (cm - own^ cd) - cd ((w x c)^ + w^ c^)
            less = minus(w, at.own)
            turn = skew(plus(times(arm, cm), times(cross(w, arm), cd)))
            by_turn = sum_of(turn, plus_identity(scaled(outer(arm, w), cd), dot(less, arm) * -cd))
            by_turn = scaled(difference(by_turn, scaled(outer(at.own, arm), cd)), -1.0)
            inner = skewed(c, sum_of(by_turn, skew(times(own, ck))))
            slope = difference(skewed(w, I), sum_of(skew(turned(I, w)), product(I, skew(at.own))))
            slope = sum_of(scaled(I, cm), scaled(slope, cd))
            for a in range(3):
                add(lane, S, to + 7 * a, mass * cm)
            add_block(lane, S, to, 0, 1, product(A, difference(by_turn, skew(times(swing, ck)))))
            add_block(lane, S, to, 1, 0, skewed(times(arm, cm), transposed(A)))
            add_block(lane, S, to, 1, 1, sum_of(inner, slope))
    return force, moment


@kernel
def rotor_moment(lane, model, S, k, at, weights, o):
    """(force, moment) of joint k's rotor on the section before: its momentum along an axis e that turns, h w x e; and
    its part of the matrix. e is fixed in that section."""
    zero, h = splat(lane, 0.0), hinge_at(k)
    axis = turned(nine_of(lane, model.joints, J.end * k + J.mount), three_of(lane, model.joints, J.end * k + J.axis))
    sway, spin = cross(at.place.spin, axis), load(lane, S, h + H.now_spin)
    if weights.mass != 0.0:
        put_vector(S, h + H.sway, sway)
        add_block(lane, S, o, 1, 1, scaled(skew(axis), -(spin * weights.damping)))
    return (zero, zero, zero), times(sway, spin)


@kernel
def loaded(lane, model, u, k, at_tip, at, weights, S, o):
    """(force, moment) of the point loads on the root or tip of link k, as part of the residual, and of the matrix."""
    zero = splat(lane, 0.0)
    force, moment = (zero, zero, zero), (zero, zero, zero)
    if model.loads is not None:
        for f in range(model.loads.shape[0] // L.end):
            first = L.end * f
            if int(model.loads[first + L.link]) == k:
                if (model.loads[first + L.at_tip] != 0.0) == at_tip:
                    j, A = model.links + 6 * f, matrix(at.place.p)
                    c, push = three_of(lane, model.loads, first + L.lever), vector(lane, u, j)
                    own, twist = back(A, push), back(A, vector(lane, u, j + 3))
                    force = minus(force, push)
                    moment = minus(moment, plus(twist, cross(c, own)))
                    if weights.mass != 0.0:
                        slope = sum_of(skew(twist), product(skew(c), skew(own)))
                        add_block(lane, S, o, 1, 1, scaled(slope, -weights.stiffness))
    return force, moment


@kernel
def onto(lane, model, r, S, k, of):
    """(force, moment) to what is on the section before joint k: to its rows in r, or, where strains are coordinates and
    it has none, to what is noted of it in S."""
    if model.strains is not None:
        if k > 0:
            to = noted_at(model, k - 1).on
            add_vector(lane, S, to, of[0])
            add_vector(lane, S, to + 3, of[1])
            return
    add_vector(lane, r, rows_before(model, k), of[0])
    add_vector(lane, r, rows_before(model, k) + 3, of[1])


@kernel
def clear(lane, S, o, n):
    """n zeros from o on."""
    zero = splat(lane, 0.0)
    for i in range(n):
        store(S, o + i, zero)


@kernel
def sums_of(lane, model, array, o, mass, share, at):
    """((kinetic, strain, gravity) energy, J; momentum along inertial axes) of the `BODY` at o of `array` on a place."""
    c, I, A = three_of(lane, array, o + P.centre), inertia_of(lane, array, o, share), matrix(at.p)
    r, rate = plus(at.r, turned(A, c)), plus(at.v, turned(A, cross(at.spin, c)))
    mass, zero = mass_of(lane, array, o, mass), splat(lane, 0.0)
    kinetic, gravity = (dot(rate, rate) * mass + dot(at.spin, turned(I, at.spin))) * 0.5, zero
    if model.gravity is not None:
        gravity = -(dot(three_of(lane, model.gravity, 0), r) * mass)
    return (kinetic, zero, gravity), times(rate, mass)
