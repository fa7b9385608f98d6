"""Chains of links in space: their Model, their kinematics from the base outward, and the wrenches of bodies and loads.

Wrenches have the residual's sign: inertia forces are positive, applied loads negative. The force (N) of a wrench is
along inertial axes, the moment (N m) in the axes of the section on which it acts. Gravity is subtracted from
accelerations."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ...compiler import Lanes, kernel, sincos
from ..arithmetic import store_vector
from ..layout import ROTOR
from ..protocol import NewtonPolicy, State
from .element import Place, add_block
from .layout import H, J, L, P, hinge_at, joint_row, rows_before
from .rotations import (
    Vector,
    about_identity,
    add_vector,
    compose,
    cross,
    dot,
    load_vector,
    matrix,
    nine_of,
    outer,
    plus_identity,
    quaternion,
    rotating_acceleration,
    skew,
    skewed,
    three_of,
)
from .strained_layout import noted_at


class Chain(NamedTuple):
    """Model of N links in space; a link is rigid, or has elements with two vertices, or has strains as coordinates.

    places: int64, one `PLACE` for each link, and one more after the last link's
    joints: float64, one `JOINT` for each link, at its root
    end, payload: float64, `BODY` of the last link's rigid end and of the payload, both on the last section
    mounts: int64 (links,), 1 if the joint's `mount` rotates the axes; None if no joint's mount does
    levers: int64 (links,), 1 if the joint has a lever (`before`, `beyond`); None if no joint has a lever
    gravity: float64 (3,), m/s^2, inertial axes; or None
    loads: float64, one `LOAD` per point load, whose inputs are a force (N) and a moment (N m), inertial axes; or None
    damped: (0,) with Kelvin-Voigt damping, otherwise None
    rotors: int64 (links,), offset in S of the joint's `physics.layout.ROTOR`, negative without rotor; or None
    free: mass of the arm without the payload, kg, if no support holds the arm; otherwise None
    sections: float64, one `ELEMENT` for each element, from root to tip; None if coordinates are strains
    frames: float64, one `FRAME` for each element if elements are segments with floating frames, otherwise None
    inner: (0,) * n for segments with n inner modes, whose rows follow all other rows; otherwise None
    uneven: (0,) if a section or a curvature varies along an element, otherwise None
    strains: float64, one `STRAINED` for each link (zeros for rigid links); None, like all later fields, with elements
    polynomials, points: tuples of zeros, one for each polynomial of a strain and one for each Gauss point of a link
    scratch: tuple of zeros, three for each Gauss point: size of stack arrays
    curved: (0,) if a link is curved without stress, otherwise None
    inside: (0,) if a point load acts between two elements of a link, otherwise None

    Terms that a None or a tag switches off are left out of the machine code."""

    n: int
    n_factor: int
    n_inputs: int
    fixed: np.ndarray
    algebraic: None
    weight: np.ndarray
    newton: NewtonPolicy
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
    inside: tuple[int, ...] | None = None


class SpatialBeam(Chain):
    """Chain of elements: geometrically exact beams, or segments with floating frames."""


class SpatialElastica(Chain):
    """Chain whose links have their strains as coordinates, without stretch and shear."""


class Vertex(NamedTuple):
    """A section's kinematic state: its `Place` (position, rotation, rates) and its accelerations."""

    place: Place
    a: Any  # m/s^2: acceleration of the section's origin minus gravity, inertial axes
    alpha: Any  # rad/s^2: angular acceleration of the section, section axes
    # rad/s, section axes: rate of the joint before it, whose w x own is in alpha; 0 but for a Newton matrix of elements
    own: Any


class Hinge(NamedTuple):
    """Kinematics of a joint.

    turn: rotation matrix E, axes of the link's root to axes of the preceding section
    lever: vector (m) from the preceding to the link's first section, axes of the preceding section; or None
    root: `Vertex` (kinematic state) of the link's first section"""

    turn: Any
    lever: Any
    root: Vertex


@kernel
def place_at(lane, q, v, i):
    """Return the `Place` of the vertex in rows i ... i + 5: position (m, inertial axes), rotation vector (rad).

    q contains the coordinates. v contains the rates: velocity (m/s, inertial axes) and angular velocity (rad/s, section
    axes) in the same rows. Pass q for v if the rates of the `Place` are not read."""
    return Place(
        load_vector(lane, q, i),
        load_vector(lane, v, i),
        quaternion(load_vector(lane, q, i + 3)),
        load_vector(lane, v, i + 3),
    )


@kernel
def vertex_at(lane, model, state, i):
    """Return the `Vertex` in rows i ... i + 5 of state (q, v, a), with gravity subtracted from its acceleration."""
    q, v, a = state
    found = load_vector(lane, a, i)
    if model.gravity is not None:
        found = found - three_of(lane, model.gravity, 0)
    zero = 0.0
    return Vertex(place_at(lane, q, v, i), found, load_vector(lane, a, i + 3), Vector(zero, zero, zero))


@kernel
def has_mount(model, k):
    """Return whether joint k rotates its link's axes at angle 0. None (at compile time): no joint of the arm does."""
    if model.mounts is None:
        return None
    return model.mounts[k] != 0


@kernel
def has_lever(model, k):
    """Return whether joint k has a lever to a neighboring section. None (at compile time): no joint of the arm has."""
    if model.levers is None:
        return None
    return model.levers[k] != 0


@kernel
def joint_placement(lane, model, q: Lanes, v: Lanes, k, tip):
    """Compute where the root of link k is and how it moves, from the preceding section's `Place` tip (theory, 9).

        E = mount exp(theta axis),  r_L = r + A (t + E o),  A_L = A E,  w_L = E^T w + axis theta'

    theta: joint angle (rad).
    t and o are the levers `JOINT.before` and `JOINT.beyond` (m). r, A and w are position, rotation and spin of the
    section `tip`. Returns E (root axes to axes of the preceding section), t + E o (m, axes of the preceding section;
    None if no joint has a lever), the `Place` of the link's first section (r_L, A_L, w_L), and axis theta' (rad/s, root
    axes)."""
    o, row = J.end * k, joint_row(model, k)
    axis, held = three_of(lane, model.joints, o + J.axis), tip.p
    # Rodrigues: 1 + sin(theta) axis^ + (1 - cos(theta)) axis^ axis^, from half the angle
    half_sine, half_cosine = sincos(q[row] * 0.5)
    sine, less = half_sine * half_cosine * 2.0, half_sine * half_sine * 2.0  # less: 1 - cos
    turn = about_identity(1.0 - less, sine * axis, less, axis)
    if has_mount(model, k):
        turn, at = nine_of(lane, model.joints, o + J.mount) @ turn, o + J.quaternion
        x, y, z = three_of(lane, model.joints, at + 1)
        held = compose(held, (model.joints[at], x, y, z))
    # quaternion and spin of the link's root
    own = half_cosine, axis[0] * half_sine, axis[1] * half_sine, axis[2] * half_sine
    p = compose(held, own)
    rate = v[row] * axis
    spin = turn.T @ tip.spin + rate
    if model.levers is None:
        return turn, None, Place(tip.r, tip.v, p, spin), rate
    zero = 0.0
    # r_L = r + A (t + E o), v_L likewise (9.1): t before the joint (near), o behind it (far)
    lever, place, moved = Vector(zero, zero, zero), tip.r, tip.v
    if has_lever(model, k):
        near, far = three_of(lane, model.joints, o + J.before), three_of(lane, model.joints, o + J.beyond)
        A, B = matrix(tip.p), matrix(p)
        lever = near + turn @ far
        moved = tip.v + (A @ cross(tip.spin, near) + B @ cross(spin, far))
        place = tip.r + A @ lever
    return turn, lever, Place(place, moved, p, spin), rate


@kernel
def joint_kinematics(lane, model, state: State, k, tip, weights):
    """Return the `Hinge` of joint k: motion of its link's first section, from the preceding section's `Vertex` tip.

    alpha_L = E^T alpha + axis theta'' + w_L x axis theta' (root axes; for the symbols see `joint_placement`).
    weights: factors of mass, damping and stiffness (`Weights`). The field `own` of the root's `Vertex` is
    weights.newton_share times the joint's rate, or 0 if strains are coordinates. See docs/theory.md, (9.1)."""
    q, v, a = state
    o = J.end * k
    turn, lever, root, rate = joint_placement(lane, model, q, v, k, tip.place)
    own = a[joint_row(model, k)] * three_of(lane, model.joints, o + J.axis)
    alpha = turn.T @ tip.alpha + own + cross(root.spin, rate)
    rate = (0.0 if model.strains is not None else weights.newton_share) * rate
    # levers accelerate: alpha x t + w x (w x t) of the section before, the same of o at the root
    second = tip.a
    if has_lever(model, k):
        near, far = three_of(lane, model.joints, o + J.before), three_of(lane, model.joints, o + J.beyond)
        A, B, w, spin = matrix(tip.place.p), matrix(root.p), tip.place.spin, root.spin
        second = tip.a + (A @ rotating_acceleration(w, tip.alpha, near) + B @ rotating_acceleration(spin, alpha, far))
    return Hinge(turn, lever, Vertex(root, second, alpha, rate))


@kernel
def rotational_inertia_moment(I, spin, alpha):
    """Return the moment I alpha + w x I w (N m) of the inertia tensor I (kg m^2); spin w, alpha: body axes of I."""
    return I @ alpha + cross(spin, I @ spin)


@kernel
def add_lumped_mass(lane, mass, I, at, weights, S: Lanes, o):
    """Return the (force, moment) of a mass (kg) at a section's origin; add their derivative to the block at o of S.

    I: principal moments about the section's axes (kg m^2).
    at: kinematic state (`Vertex`) of the section. force = m a (N, inertial axes), moment = I alpha + w x I w (N m,
    section axes).
    weights: `Weights` of the 6 x 6 block; if weights.with_matrix is False, S is unchanged. See docs/theory.md, section
    9."""
    w, alpha = at.place.spin, at.alpha
    x, y, z = I[2] - I[1], I[0] - I[2], I[1] - I[0]
    if weights.with_matrix:
        # m cm on the diagonal; I cm + (w^ I - (I w)^) cd on the rotations
        cm, a, b, c = weights.mass, w[0] * weights.damping, w[1] * weights.damping, w[2] * weights.damping
        for k in range(3):
            S[o + 7 * k] += mass * cm
            S[o + 21 + 7 * k] += I[k] * cm
        S[o + 22] += c * x
        S[o + 23] += b * x
        S[o + 27] += c * y
        S[o + 29] += a * y
        S[o + 33] += b * z
        S[o + 34] += a * z
    moment = Vector(
        I[0] * alpha[0] + w[1] * w[2] * x,
        I[1] * alpha[1] + w[0] * w[2] * y,
        I[2] * alpha[2] + w[0] * w[1] * z,
    )
    return mass * at.a, moment


@kernel
def mass_of(lane, array, o, mass):
    """Return `mass` (kg), or, if `mass` is None, the mass stored in the `BODY` record at offset o of `array`."""
    if mass is None:
        return array[o + P.mass]
    return mass


@kernel
def inertia_of(lane, array, o, share):
    """Return the inertia tensor (kg m^2, section axes) of the `BODY` at o of `array`, times share (None: factor 1)."""
    I = nine_of(lane, array, o + P.inertia)
    if share is None:
        return I
    return share * I


@kernel
def add_rigid_body(lane, array, o, mass, share, at, weights, S: Lanes, to):
    """Return the (force, moment) of a `BODY` fixed to a section; add its derivatives to the 6 x 6 matrix at `to` of S.

        force = m (a + A (alpha x c + w x (w x c))),   moment = I alpha + w x I w + c x A^T force

    The `BODY` record is at offset o of `array`. m and I are its mass and inertia (`mass_of`, `inertia_of`), c is its
    center of mass in section axes.
    at: kinematic state (`Vertex`) of the section (a, A, w, alpha). Force in inertial axes, moment in section axes.
    Without weights.with_matrix S stays unchanged. See docs/theory.md, section 9."""
    zero = 0.0
    force, moment = Vector(zero, zero, zero), Vector(zero, zero, zero)
    if array[o + P.there] != 0.0:
        # force per axis of the section: m A^T a and the acceleration of c relative to the section
        c, mass = three_of(lane, array, o + P.centre), mass_of(lane, array, o, mass)
        I = inertia_of(lane, array, o, share)
        A, w, arm = matrix(at.place.p), at.place.spin, mass * c
        own, swing = mass * (A.T @ at.a), rotating_acceleration(w, at.alpha, arm)
        force, moment = (A @ (own + swing), rotational_inertia_moment(I, w, at.alpha) + cross(c, own + swing))
        if weights.with_matrix:
            cm, cd, ck = weights.mass, weights.damping, weights.stiffness
            # d(alpha x c + w x (w x c)) by the rotation: -c^ (cm - own^ cd) - cd ((w x c)^ + w^ c^)
            less = w - at.own
            turn = skew(cm * arm + cd * cross(w, arm))
            by_turn = turn + plus_identity(cd * outer(arm, w), dot(less, arm) * -cd)
            by_turn = -(by_turn - cd * outer(at.own, arm))
            # moment by the rotation: c x d(A^T force), and the tensor's I cm + (w^ I - (I w)^ - I own^) cd
            inner = skewed(c, by_turn + skew(ck * own))
            slope = skewed(w, I) - (skew(I @ w) + I @ skew(at.own))
            slope = cm * I + cd * slope
            for a in range(3):
                S[to + 7 * a] += mass * cm
            add_block(lane, S, to, 0, 1, A @ (by_turn - skew(ck * swing)))
            add_block(lane, S, to, 1, 0, skewed(cm * arm, A.T))
            add_block(lane, S, to, 1, 1, inner + slope)
    return force, moment


@kernel
def rotor_moment(lane, model, S: Lanes, k, at, weights, o):
    """Return (0, h w x e), the gyroscopic moment (N m) of joint k's rotor on the preceding section, section axes.

    h: the rotor's angular momentum (N m s), in S.
    e: the joint's axis.
    w: spin of the section, from its `Vertex` at; section axes (theory, 6). With weights.with_matrix stores w x e for
    `factor` and adds -h e^ cd to the 6 x 6 matrix at o of S."""
    zero, h = 0.0, hinge_at(k)
    axis = nine_of(lane, model.joints, J.end * k + J.mount) @ three_of(lane, model.joints, J.end * k + J.axis)
    sway, spin = cross(at.place.spin, axis), S[h + H.rotor + ROTOR.momentum]
    if weights.with_matrix:
        store_vector(lane, S, h + H.sway, sway)
        # strains as coordinates: the section before has no rows for the column h w x e to act on
        store_vector(lane, S, h + H.rotor + ROTOR.column, sway if model.strains is None else Vector(zero, zero, zero))
        add_block(lane, S, o, 1, 1, -(spin * weights.damping) * skew(axis))
    return Vector(zero, zero, zero), spin * sway


@kernel
def point_load_wrench(lane, model, u, k, section, at, weights, S, o):
    """Return the (force, moment) in the residual of the point loads on a section of link k; add their tangent.

    Inputs u hold force F and moment M of each load along inertial axes, behind the joint torques. force = -F (inertial
    axes), moment = -(A^T M + c x A^T F) (section axes) with the load's lever c.
    at: kinematic state (`Vertex`) of the section.
    section: `LOAD.section`. With weights.with_matrix the moment's derivative by the section's rotation is added to the
    6 x 6 matrix at o of S. See docs/theory.md, section 9."""
    zero = 0.0
    force, moment = Vector(zero, zero, zero), Vector(zero, zero, zero)
    if model.loads is not None:
        for f in range(model.loads.shape[0] // L.end):
            first = L.end * f
            if int(model.loads[first + L.link]) == k:
                if model.loads[first + L.section] == section:
                    j, A = model.links + 6 * f, matrix(at.place.p)
                    c, push = three_of(lane, model.loads, first + L.lever), load_vector(lane, u, j)
                    # force and moment in section axes
                    own, twist = A.T @ push, A.T @ load_vector(lane, u, j + 3)
                    force = force - push
                    moment = moment - (twist + cross(c, own))
                    if weights.with_matrix:
                        # d(A^T x) = (A^T x)^ dth
                        slope = skew(twist) + skew(c) @ skew(own)
                        add_block(lane, S, o, 1, 1, -weights.stiffness * slope)
    return force, moment


@kernel
def transmit_wrench(lane, model, r, S, k, of):
    """Add a wrench `of` = (force, N, inertial axes; moment, N m, section axes) to the section before joint k.

    The wrench is added to the section's rows of r. Where strains are coordinates only the base has rows (k = 0); for k
    > 0 the wrench is added to `NOTED.on` of link k - 1 in S."""
    if model.strains is not None:
        if k > 0:
            to = noted_at(model, k - 1).on
            add_vector(lane, S, to, of[0])
            add_vector(lane, S, to + 3, of[1])
            return
    add_vector(lane, r, rows_before(model, k), of[0])
    add_vector(lane, r, rows_before(model, k) + 3, of[1])


@kernel
def fill_zeros(lane, S: Lanes, o, n):
    """Store zeros in the n entries of the array S from index o on."""
    zero = 0.0
    for i in range(n):
        S[o + i] = zero


@kernel
def body_sums(lane, model, array, o, mass, share, at):
    """Return ((kinetic, strain = 0, gravitational) energy in J, momentum in kg m/s, inertial axes) of a rigid `BODY`.

    The `BODY` record of the body is at offset o of `array`.
    at: `Place` (position, rotation, rates) of the body's section.
    mass, share: as in `mass_of` and `inertia_of`."""
    c, I, A = three_of(lane, array, o + P.centre), inertia_of(lane, array, o, share), matrix(at.p)
    # center of mass and its velocity, inertial axes
    r, rate = at.r + A @ c, at.v + A @ cross(at.spin, c)
    mass, zero = mass_of(lane, array, o, mass), 0.0
    kinetic, gravity = (dot(rate, rate) * mass + dot(at.spin, I @ at.spin)) * 0.5, zero
    if model.gravity is not None:
        gravity = -(dot(three_of(lane, model.gravity, 0), r) * mass)
    return (kinetic, zero, gravity), mass * rate
