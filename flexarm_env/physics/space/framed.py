"""Forces of a segment with a floating frame in space, its energy and its damping (kinematics: `frame`; theory, 9).

If segments are reduced to modes, each inner mode has rows of its own, behind all other rows. A mode has an amplitude
(rad) about x, y and z of the frame. A mode rotates sections relative to the frame, in addition to the shape functions
of the ends' rotations."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ...compiler import Lanes, inlined, kernel, select_lt
from ..arithmetic import clip, minimum
from ..model import STIFFNESS_FACTOR
from .frame import cross_with_ex, ex_cross, frame_of, frame_second_rates, phi_second, rates_of
from .framed_tangent import tangent
from .inner import HELIX, constant, ends_by, inner_by, product
from .layout import factors_of, inner_of, inner_row
from .rotations import Vector, add_vector, cross, dot, load_vector, rotating_acceleration, scale, three_of
from .segments import W, frame_at, points_of, weight_end

MOST, HEAVY = 0.5, 40.0
"""Bound of the forces in a segment's tangent: force divided by EI / l^2 (buckling force: pi^2 EI / l^2), moment divided
by EI / l. The bound applies if the inertia term of the Newton matrix exceeds `HEAVY` times the bending stiffness. When
Newton's iteration begins, strains have errors of second order in a step's rotation. Multiplied by EA or the stiffer EI,
such strains would spoil the tangent. Real forces are small compared with such inertia."""


class Stiff(NamedTuple):
    """Forces conjugate to a segment's elastic coordinates, with intermediate results (frame axes)."""

    pull: Any  # N: force along the chord
    left: Any  # N m: moments conjugate to the rotations phi_l and phi_r
    right: Any
    slope_l: Any  # m: vectors H phi of the left and of the right end
    slope_r: Any
    apart: Any  # N m: (left - right) / 4 of the bending and torsion moments, without the part from stretch
    both: Any  # N m: `HELIX` times the sum of left and right bending and torsion moments


@kernel
def _bent(lane, model, par, table, a, b):
    """Return the moments K (a, b) (N m) on both ends of a segment whose ends rotate by a and b (rad), in frame axes.

    The stiffness K begins at offset `table` of model.frames. The arm's own factors (par) on GJ, EI_y and EI are
    applied."""
    factors = factors_of(lane, par)
    l, r = product(lane, model, table, a, b)
    return scale(l, factors), scale(r, factors)


@kernel
def _strained(a, b):
    """Return near and far (rad), the rotations of both ends that K multiplies, to second order; frame axes (theory, 9).

    near, far = phi_l + c - h, phi_r - c - h with c = phi_l x phi_r / 4, h = d_x (d x e_x) / 24, d = phi_r - phi_l. a,
    b: phi_l, phi_r (rad), rotations of both sections relative to the segment's frame. c makes far - near the sections'
    relative rotation log(exp(-a) exp(b)) = b - a - a x b / 2. h subtracts the rotation of a helix's sections relative
    to its chord, which they have without shear; with shear a part of h remains even in short segments."""
    d = b - a
    c, helix = 0.25 * cross(a, b), d[0] * HELIX * cross_with_ex(d)
    return a + c - helix, b - c - helix


@kernel
def _strained_rate(a, b, x, y):
    """Return the time derivatives (rad/s) of both results of `_strained`. x, y: rates of rotations a, b; frame axes."""
    d, e = b - a, y - x
    c = 0.25 * (cross(x, b) + cross(a, y))
    helix = HELIX * (e[0] * cross_with_ex(d) + d[0] * cross_with_ex(e))
    return x + c - helix, y - c - helix


@kernel
def _unstrained(a, b, l, r, apart, both):
    """Return the moments (N m) on phi_l and phi_r that are equivalent to moments l, r on the `_strained` rotations.

    The function applies the transposed derivative of `_strained`. a, b: rotations phi_l, phi_r (rad). apart: (l - r) /
    4. both: (l + r) / 24. All vectors are in frame axes."""
    d = b - a
    more = d[0] * ex_cross(both)
    more = Vector(more[0] + dot(both, cross_with_ex(d)), more[1], more[2])
    return l + cross(b, apart) + more, r + cross(apart, a) - more


@kernel
def _stretch(lane, model, frame, at, q, row):
    """Return (e + phi' H phi / 2, H phi of the left end, H phi of the right end), in m: stretch and foreshortening.

    e is the length of the chord minus the segment's length, H is `FRAME.coupling`. phi contains the rotations of both
    ends and the amplitudes of inner modes, which begin at row `row` of q. at: offsets of the segment's `FRAME` record
    (`frame_at`). Vectors are in frame axes."""
    a, b = frame.left.phi, frame.right.phi
    l, r = product(lane, model, at.coupling, a, b)
    e = frame.length - model.frames[at.length]
    if model.inner is not None:
        l, r = ends_by(lane, model, at.inner_coupling, 2, q, row, l, r)
        for i in range(inner_of(model)):
            slope = inner_by(lane, model, at.inner_coupling, 2, i, a, b, q, row)
            e = e + dot(slope, load_vector(lane, q, row + 3 * i)) * 0.5
    return Vector(e + (dot(l, a) + dot(r, b)) * 0.5, l, r)


@kernel
def _stretch_rate(lane, model, frame, rates, slopes, at, q, v, row):
    """Return the rate (m/s) of the stretch e + phi' H phi / 2; slopes: H phi of both ends (m), from `_stretch`.

    rates: rates of frame and strains (`Rates`). q, v: the arm's coordinates and rates; the segment's inner modes begin
    at row `row`.
    at: offsets of the segment's `FRAME` record (`frame_at`)."""
    e = rates.d[0] + dot(slopes[0], rates.left) + dot(slopes[1], rates.right)
    if model.inner is not None:
        for i in range(inner_of(model)):
            slope = inner_by(lane, model, at.inner_coupling, 2, i, frame.left.phi, frame.right.phi, q, row)
            e = e + dot(slope, load_vector(lane, v, row + 3 * i))
    return e


@kernel
def _elastic(lane, model, par: Lanes, frame, rates, tau, at, state, row):
    """Return the `Stiff` of a segment: force along the chord (N) and moments on phi_l, phi_r (N m), in frame axes.

    The forces are elastic, with Kelvin-Voigt damping (theory, eq. 1.3) unless tau is None. tau: time constant (s).
    rates: `Rates` of the frame, only read with damping.
    at: offsets of the segment's `FRAME` record (`frame_at`).
    row: first row of its inner modes in state."""
    q, v, _ = state
    e, hl, hr = _stretch(lane, model, frame, at, q, row)
    a, b = frame.left.phi, frame.right.phi
    # bending and torsion: K of the strained rotations less the moments without stress
    near, far = _strained(a, b)
    l, r = _bent(lane, model, par, at.K_EI, near, far)
    factor = par[STIFFNESS_FACTOR]
    l = l - factor * constant(lane, model, at.moment, 0)
    r = r - factor * constant(lane, model, at.moment, 1)
    # damping: strain plus tau times its rate
    if tau is not None:
        e = e + _stretch_rate(lane, model, frame, rates, (hl, hr), at, q, v, row) * tau
        near, far = _strained_rate(a, b, rates.left, rates.right)
        dl, dr = _bent(lane, model, par, at.K_EI, near, far)
        l, r = l + tau * dl, r + tau * dr
    # back to phi, and the stretch's moments pull H phi
    apart, both = 0.25 * (l - r), HELIX * (l + r)
    l, r = _unstrained(a, b, l, r, apart, both)
    pull = e * model.frames[at.pull]
    return Stiff(pull, l + pull * hl, r + pull * hr, hl, hr, apart, both)


@kernel
def _inner_bent(lane, model, par, at, i, x, row):
    """Return row i of K x, the moment (N m, frame axes) on inner mode i; inner amplitudes begin at row `row` of x."""
    zero = 0.0
    total = Vector(zero, zero, zero)
    for j in range(inner_of(model)):
        one = constant(lane, model, at.inner_K_EI, inner_of(model) * i + j)
        total = total + scale(load_vector(lane, x, row + 3 * j), one)
    return scale(total, factors_of(lane, par))


@kernel
def _inner_forces(lane, model, par: Lanes, frame, tau, pull, second, at, state, row, r):
    """Add elastic, damping and rotary inertia forces of a segment's inner modes to their rows of r (N m, frame axes).

    `framed` adds the translational inertia. tau: time constant (s) or None. pull: force along the chord (N). second:
    angular accelerations (rad/s^2) of left section, right section (section axes) and frame (frame axes). at: offsets of
    the segment's `FRAME` record (`frame_at`). row: first row of the inner modes in state and r. See docs/theory.md,
    (9.3)."""
    q, v, a = state
    width, factor = inner_of(model) + 3, par[STIFFNESS_FACTOR]
    for i in range(inner_of(model)):
        natural = factor * constant(lane, model, at.inner_moment, i)
        found = _inner_bent(lane, model, par, at, i, q, row) - natural
        if tau is not None:
            found = found + tau * _inner_bent(lane, model, par, at, i, v, row)
        # stretch: pull H phi
        slope = inner_by(lane, model, at.inner_coupling, 2, i, frame.left.phi, frame.right.phi, q, row)
        found = found + pull * slope
        # rotary inertia int J h_i (alpha of the section), about x, y, z in frame axes
        turn = inner_by(lane, model, at.inner_rotary, 3, i, second[0], second[1], a, row)
        turn = turn + scale(second[2], constant(lane, model, at.inner_rotary, width * i + 2))
        add_vector(lane, r, row + 3 * i, found + turn)


@kernel
def _off(lane, model, to, a, b, x, row):
    """Return the offset n (m, frame axes) of a mass point from the chord, for end rotations a, b and inner amplitudes.

    n = h_l (a x e_x) + h_r (b x e_x) + sum h_i (x_i x e_x). Given first or second rates of the rotations, the result is
    the corresponding rate of n. to: offset of the point's `WEIGHT` in model.frames. row: first row of inner modes in x.
    """
    hl, hr = three_of(lane, model.frames, to + W.left), three_of(lane, model.frames, to + W.right)
    n = scale(cross_with_ex(a), hl) + scale(cross_with_ex(b), hr)
    for i in range(inner_of(model)):
        share = three_of(lane, model.frames, to + W.inner + 3 * i)
        n = n + scale(cross_with_ex(load_vector(lane, x, row + 3 * i)), share)
    return n


@kernel
def _rate(lane, model, frame, rates, left, right, to, v, row, n):
    """Return the velocity (m/s, inertial axes) of a mass point at the offset n (m, frame axes) from the chord.

    left, right: `Place`s of the ends.
    rates: rates of frame and strains (`Rates`).
    v: rates of the arm; the segment's inner modes begin at row `row`.
    to: offset of the point's `WEIGHT` record in model.frames."""
    xi, slip = model.frames[to + W.xi], _off(lane, model, to, rates.left, rates.right, v, row)
    slip = frame.A @ (slip + cross(rates.spin, n))
    return (1.0 - xi) * left.v + xi * right.v + slip


@kernel
def _most_force(section, sixth, mass):
    """Return the largest force (N) that enters the tangent of a segment, or infinity without a bound (see `MOST`).

    section: `Section`. sixth: a sixth of the segment's mass (kg). mass: weight of the mass in the matrix (1/s^2)."""
    x, y, z = section.EI
    square = section.length * section.length
    own = minimum(minimum(x, y), z) / square
    return select_lt(own * HEAVY, sixth * section.length * (6.0 * mass), own * MOST, np.inf)


@kernel
def _clipped(a, most):
    """Return the vector a with each entry clipped to [-most, most]."""
    return Vector(clip(a[0], most), clip(a[1], most), clip(a[2], most))


@kernel
def framed(lane, model, par, section, state, left, right, i, weights, r, S, f):
    """Return the (force, moment) on the left and on the right end of segment i: elastic, damping and inertia forces.

    See docs/theory.md, (9.3). Forces along inertial axes (N), moments in section axes (N m).

    # model    section: constants (`Section`) of segment i (index over all links); par: factors on stiffnesses, tau_d
    # state    left, right: `Vertex` of the segment's ends; state: q, v, a of the arm (rows of inner modes are read)
    # out      r (n,): rows of inner modes, N m;  S, with weights.with_matrix: the `FACTOR` at offset f
    """
    # w, alpha of the frame; phi', phi'' of both ends against it (frame axes)
    at, row = frame_at(model, i), inner_row(model, i)
    frame = frame_of(left.place, right.place)
    rates = rates_of(frame, left.place, right.place)
    spin, a, b = rates.spin, frame.left, frame.right
    alpha = frame_second_rates(frame, rates, left, right)
    second_l = phi_second(a, rates.left, left.place.spin, left.alpha, spin, alpha)
    second_r = phi_second(b, rates.right, right.place.spin, right.alpha, spin, alpha)
    # moments K phi_bar and pull EA (e + phi H phi / 2) / l of (1.3); a of the ends in frame axes
    stiff = _elastic(lane, model, par, frame, rates, section.tau, at, state, row)
    al, ar = frame.A.T @ left.a, frame.A.T @ right.a
    zero = 0.0
    push_l, push_r, couple = Vector(zero, zero, zero), Vector(zero, zero, zero), Vector(zero, zero, zero)
    ml, mr = stiff.left, stiff.right
    # Gauss points: inertia forces in the rotating frame, on the ends, on phi and as moment n x f on the frame
    for p in range(points_of(model)):
        to = at.points + weight_end(model) * p
        xi, mass = model.frames[to + W.xi], model.frames[to + W.mass]
        hl, hr = three_of(lane, model.frames, to + W.left), three_of(lane, model.frames, to + W.right)
        n = _off(lane, model, to, a.phi, b.phi, state.q, row)
        rate = _off(lane, model, to, rates.left, rates.right, state.v, row)
        second = _off(lane, model, to, second_l, second_r, state.a, row)
        found = (1.0 - xi) * al + xi * ar + (second + 2.0 * cross(spin, rate))
        force = mass * (found + rotating_acceleration(spin, alpha, n))
        push_l, push_r = push_l + (1.0 - xi) * force, push_r + xi * force
        couple = couple + cross(n, force)
        ml, mr = ml + ex_cross(scale(force, hl)), mr + ex_cross(scale(force, hr))
        for j in range(inner_of(model)):
            share = three_of(lane, model.frames, to + W.inner + 3 * j)
            add_vector(lane, r, row + 3 * j, ex_cross(scale(force, share)))
    # r of inner modes: K phi_bar, H phi pull, tau_d and rotary inertia
    if model.inner is not None:
        turns = left.alpha, right.alpha, alpha
        _inner_forces(lane, model, par, frame, section.tau, stiff.pull, turns, at, state, row, r)
    # moment on the frame: n x f and rotary inertia less T^-1 m of both ends; forces across the chord that carry it
    turn_l, turn_r, turn = _rotary(lane, model, at, left, right, (spin, alpha), state, row)
    couple = couple + turn - (a.T @ ml + b.T @ mr)
    aside = Vector(stiff.pull, couple[2] * frame.over, (couple[1] + couple[0] * frame.k) * -frame.over)
    # S with pull at most EI/2l^2 and moments at most EI/2l (`MOST`): early iterates overestimate them
    if weights.with_matrix:
        most = _most_force(section, model.frames[at.mass] * 0.5, weights.mass)
        moment = most * section.length
        now = _clipped(aside, most), _clipped(ml, moment), _clipped(mr, moment)
        spins, pull = (left.place.spin, right.place.spin), clip(stiff.pull, most)
        tangent(
            lane, model, par, section.tau, frame, rates, spins, left.own, stiff, pull, now, i, state.q, weights, S, f
        )
    # on the sections: T^-T m, their share g of the roll moment, rotary inertia
    on_l = a.T.T @ ml + couple[0] * a.g + turn_l
    on_r = b.T.T @ mr + couple[0] * b.g + turn_r
    return (frame.A @ (push_l - aside), on_l), (frame.A @ (push_r + aside), on_r)


@kernel
def _momenta(lane, model, at, a, b, c, x, row):
    """Return the angular momenta (kg m^2/s) of the rotary inertia: left section, right section, frame, in own axes.

    a, b, c: angular velocities of left section, right section and frame (rad/s, own axes).
    x: rates; the inner modes begin at row `row`.
    at: offsets of the segment's `FRAME` record (`frame_at`). Given accelerations for a, b, c and x, the function
    returns inertia moments (N m) without gyroscopic terms."""
    l, r = product(lane, model, at.rotary, a, b)
    lc, rc = constant(lane, model, at.rotary, 3), constant(lane, model, at.rotary, 4)
    own = scale(a, lc) + scale(b, rc) + scale(c, constant(lane, model, at.rotary, 5))
    l, r = l + scale(c, lc), r + scale(c, rc)
    if model.inner is not None:
        l, r = ends_by(lane, model, at.inner_rotary, 3, x, row, l, r)
        for i in range(inner_of(model)):
            share = constant(lane, model, at.inner_rotary, (inner_of(model) + 3) * i + 2)
            own = own + scale(load_vector(lane, x, row + 3 * i), share)
    return l, r, own


@kernel
def _rotary(lane, model, at, left, right, frame, state, row):
    """Return the rotary inertia moments (N m) on left section, right section and frame, each in its own axes.

    The moments are d(momentum)/dt + w x momentum.
    at: offsets of the `FRAME` record.
    left, right: kinematic states (`Vertex`) of the two ends.
    frame: angular velocity and angular acceleration of the frame. The rates and accelerations of the segment's inner
    modes begin at row `row` of state."""
    wl, wr, (spin, alpha) = left.place.spin, right.place.spin, frame
    l, r, c = _momenta(lane, model, at, wl, wr, spin, state.v, row)
    more_l, more_r, more = _momenta(lane, model, at, left.alpha, right.alpha, alpha, state.a, row)
    return more_l + cross(wl, l), more_r + cross(wr, r), more + cross(spin, c)


@inlined
def frame_sums(lane, model, par: Lanes, q, v, left, right, i):
    """Return ((kinetic, strain, gravitational) energy in J, momentum in kg m/s, inertial axes) of segment i.

    left, right: `Place`s (position, rotation, rates) of the segment's ends.
    q, v: coordinates and rates, from which the inner modes are read. See docs/theory.md, (9.3)."""
    at, row = frame_at(model, i), inner_row(model, i)
    frame = frame_of(left, right)
    rates = rates_of(frame, left, right)
    a, b, spin = frame.left, frame.right, rates.spin
    # strain energy (1.2), less the work of the moments without stress
    e, _, _ = _stretch(lane, model, frame, at, q, row)
    near, far = _strained(a.phi, b.phi)
    l, r = _bent(lane, model, par, at.K_EI, near, far)
    strain = (e * e * model.frames[at.pull] + dot(l, near) + dot(r, far)) * 0.5
    natural = dot(constant(lane, model, at.moment, 0), near) + dot(constant(lane, model, at.moment, 1), far)
    # T of rotary inertia, 1/2 w^T J w of a w_l + b w_r + c w
    tl, tr, tc = _momenta(lane, model, at, left.spin, right.spin, spin, v, row)
    kinetic = dot(tl, left.spin) + dot(tr, right.spin) + dot(tc, spin)
    # the same with inner amplitudes: 1/2 p^T K p, less moments without stress, and T of their rates
    for j in range(inner_of(model)):
        own, rate = load_vector(lane, q, row + 3 * j), load_vector(lane, v, row + 3 * j)
        strain = strain + dot(_inner_bent(lane, model, par, at, j, q, row), own) * 0.5
        natural = natural + dot(constant(lane, model, at.inner_moment, j), own)
        turn = inner_by(lane, model, at.inner_rotary, 3, j, left.spin, right.spin, v, row)
        turn = turn + scale(spin, constant(lane, model, at.inner_rotary, (inner_of(model) + 3) * j + 2))
        kinetic = kinetic + dot(turn, rate)
    strain = strain + (model.frames[at.spent] - natural) * par[STIFFNESS_FACTOR]
    gravity = 0.0
    push = Vector(gravity, gravity, gravity)
    # Gauss points: 1/2 m |v|^2, m v, -m g . r (inertial axes)
    for p in range(points_of(model)):
        to = at.points + weight_end(model) * p
        mass, xi = model.frames[to + W.mass], model.frames[to + W.xi]
        n = _off(lane, model, to, a.phi, b.phi, q, row)
        rate = _rate(lane, model, frame, rates, left, right, to, v, row, n)
        kinetic, push = kinetic + dot(rate, rate) * mass, push + mass * rate
        if model.gravity is not None:
            place = (1.0 - xi) * left.r + xi * right.r + frame.A @ n
            gravity = gravity - dot(three_of(lane, model.gravity, 0), place) * mass
    return (kinetic * 0.5, strain, gravity), push


@kernel
def frame_damping(lane, model, par, state, left, right, other_l, other_r, i):
    """Return v1^T C v2 / tau_d (W/s): power of segment i's damping forces at rates v1 for a second set of rates v2.

    left, right: `Place`s of the ends with the first rates.
    other_l, other_r: `Place`s of the same ends with the second rates. state.v contains the first rates of the inner
    modes, state.a their second rates.
    i: index over all links. See docs/theory.md, (9.3)."""
    at, row = frame_at(model, i), inner_row(model, i)
    q, v, x = state
    frame = frame_of(left, right)
    one, two = rates_of(frame, left, right), rates_of(frame, other_l, other_r)
    _, hl, hr = _stretch(lane, model, frame, at, q, row)
    near, far = _strained_rate(frame.left.phi, frame.right.phi, one.left, one.right)
    l, r = _bent(lane, model, par, at.K_EI, near, far)
    near, far = _strained_rate(frame.left.phi, frame.right.phi, two.left, two.right)
    stretch = _stretch_rate(lane, model, frame, one, (hl, hr), at, q, v, row)
    other = _stretch_rate(lane, model, frame, two, (hl, hr), at, q, x, row)
    power = stretch * other * model.frames[at.pull] + dot(l, near) + dot(r, far)
    for j in range(inner_of(model)):
        power = power + dot(_inner_bent(lane, model, par, at, j, v, row), load_vector(lane, x, row + 3 * j))
    return power


@kernel
def _strains(lane, model, state, left, right, at, row):
    """Return the strains (stretch, near, far) of a segment (m, rad, rad) and their rates, without inner bending.

    state: pair (q, v). left, right: `Place`s of the ends. near, far: their `_strained` rotations, frame axes."""
    q, v = state
    frame = frame_of(left, right)
    rates, a, b = rates_of(frame, left, right), frame.left.phi, frame.right.phi
    e, hl, hr = _stretch(lane, model, frame, at, q, row)
    rate = _stretch_rate(lane, model, frame, rates, (hl, hr), at, q, v, row)
    near, far = _strained(a, b)
    near_rate, far_rate = _strained_rate(a, b, rates.left, rates.right)
    return (e, near, far), (rate, near_rate, far_rate)


@kernel
def frame_damping_over(lane, model, par, before, after, share, i):
    """Return the damping power of segment i over a step and its unresolved part, both divided by tau_d (W/s).

    before, after: (q, v, left `Place`, right `Place`) at the step's start and end.
    share: 1 / step (1/s). The power uses mean strain rates, i.e. the change of strain divided by the step. The
    unresolved part is the excess power of the mean damping force, as in `element.element_damping`. See docs/theory.md,
    (9.3)."""
    at, row = frame_at(model, i), inner_row(model, i)
    (q0, v0, left_0, right_0), (q, v, left, right) = before, after
    (e_0, near_0, far_0), (e_rate_0, near_rate_0, far_rate_0) = _strains(
        lane, model, (q0, v0), left_0, right_0, at, row
    )
    (e, near, far), (e_rate, near_rate, far_rate) = _strains(lane, model, (q, v), left, right, at, row)
    # rates (strain_1 - strain_0) / h of e and phi_bar, and the forces that they cause
    e, near, far = (e - e_0) * share, share * (near - near_0), share * (far - far_0)
    l, r = _bent(lane, model, par, at.K_EI, near, far)
    pull = e * model.frames[at.pull]
    power = pull * e + dot(l, near) + dot(r, far)
    # (rate_0 + rate_1) / 2 less those: the end rates' work beyond the dissipation
    near, far = (0.5 * (near_rate_0 + near_rate) - near, 0.5 * (far_rate_0 + far_rate) - far)
    beyond = pull * ((e_rate_0 + e_rate) * 0.5 - e) + dot(l, near) + dot(r, far)
    # inner modes p: dissipation K (dp/h)^2, and the work of the mean end rates beyond it
    factors = factors_of(lane, par)
    for j in range(inner_of(model)):
        o = row + 3 * j
        rate = share * (load_vector(lane, q, o) - load_vector(lane, q0, o))
        more = 0.5 * (load_vector(lane, v0, o) + load_vector(lane, v, o)) - rate
        for k in range(inner_of(model)):
            stiff = scale(constant(lane, model, at.inner_K_EI, inner_of(model) * j + k), factors)
            moment = scale(share * (load_vector(lane, q, row + 3 * k) - load_vector(lane, q0, row + 3 * k)), stiff)
            power, beyond = power + dot(moment, rate), beyond + dot(moment, more)
    return power, beyond
