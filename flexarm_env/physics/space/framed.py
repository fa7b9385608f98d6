"""Forces of a segment with a floating frame in space, its energy, and its damping (see `frame`).

Where segments are reduced to modes, the inner ones have rows of their own, behind all others: of each mode an amplitude
about x, y, z, by which the sections turn in the frame beside what the ends turn them by.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ...compiler import inlined, kernel, load, select_lt, splat
from ..arithmetic import clip, smaller, vector
from ..model import STIFFNESS_FACTOR
from .chain import factors_of, three_of
from .element import scale
from .frame import across, frame_of, lifted, phi_second, rates_of, seconds
from .framed_tangent import tangent
from .inner import HELIX, constant, ends_by, inner_by, product
from .layout import W, frame_at, inner_of, inner_row, points_of, weight_end
from .rotations import add_vector, back, cross, dot, minus, plus, swirl, times, turned

MOST, HEAVY = 0.5, 40.0
"""Largest force of its own in a segment's tangent, over EI / l^2 (its buckling force is pi^2 of that), and moment, over
EI / l, where inertia in steps is more than `HEAVY` times as stiff: as Newton begins, strains are off by second order of
a step's turn. Times EA, or the stiffer EI, that is what no tangent should have in it, and what is real is little beside
such inertia."""


class Stiff(NamedTuple):
    """Forces of the elastic coordinates: along the chord, on phi_l and phi_r; what e and these have in common."""

    pull: Any
    left: Any
    right: Any
    slope_l: Any  # H phi
    slope_r: Any
    apart: Any  # of what bends and twists without the stretch, a quarter of left less right
    both: Any  # `HELIX` times their sum


@kernel
def _bent(lane, model, par, table, a, b):
    """K (a, b), with the arm's own factors."""
    factors = factors_of(lane, par)
    l, r = product(lane, model, table, a, b)
    return scale(l, factors), scale(r, factors)


@kernel
def _strained(a, b):
    """The ends' rotations phi_l, phi_r as K takes them, to second order. The sections turn against each other by
    b - a - a x b / 2, log(exp(-a) exp(b)), of which a share stays where sections shear, on however short a segment;
    and both are turned against the chord of a helix, which is not bent by that."""
    d = minus(b, a)
    c, helix = times(cross(a, b), 0.25), times(across(d), d[0] * HELIX)
    return minus(plus(a, c), helix), minus(minus(b, c), helix)


@kernel
def _strained_rate(a, b, x, y):
    """Its rate at rates x, y of a, b."""
    d, e = minus(b, a), minus(y, x)
    c = times(plus(cross(x, b), cross(a, y)), 0.25)
    helix = times(plus(times(across(d), e[0]), times(across(e), d[0])), HELIX)
    return minus(plus(x, c), helix), minus(minus(y, c), helix)


@kernel
def _unstrained(a, b, l, r, apart, both):
    """Forces on a, b of forces l, r on what `_strained` makes of them; apart, both: see `Stiff`."""
    d = minus(b, a)
    more = times(lifted(both), d[0])
    more = more[0] + dot(both, across(d)), more[1], more[2]
    return plus(plus(l, cross(b, apart)), more), minus(plus(r, cross(apart, a)), more)


@kernel
def _stretch(lane, model, frame, at, q, row):
    """(e + phi' H phi / 2, H phi of the left, of the right)."""
    a, b = frame.left.phi, frame.right.phi
    l, r = product(lane, model, at.coupling, a, b)
    e = frame.length - model.frames[at.length]
    if model.inner is not None:
        l, r = ends_by(lane, model, at.inner_coupling, 2, q, row, l, r)
        for i in range(inner_of(model)):
            slope = inner_by(lane, model, at.inner_coupling, 2, i, a, b, q, row)
            e = e + dot(slope, vector(lane, q, row + 3 * i)) * 0.5
    return e + (dot(l, a) + dot(r, b)) * 0.5, l, r


@kernel
def _stretch_rate(lane, model, frame, rates, slopes, at, q, v, row):
    """Its rate, at rates v; slopes: H phi of both ends."""
    e = rates.d[0] + dot(slopes[0], rates.left) + dot(slopes[1], rates.right)
    if model.inner is not None:
        for i in range(inner_of(model)):
            slope = inner_by(lane, model, at.inner_coupling, 2, i, frame.left.phi, frame.right.phi, q, row)
            e = e + dot(slope, vector(lane, v, row + 3 * i))
    return e


@kernel
def _elastic(lane, model, par, frame, rates, tau, at, state, row):
    """`Stiff`."""
    q, v, _ = state
    e, hl, hr = _stretch(lane, model, frame, at, q, row)
    a, b = frame.left.phi, frame.right.phi
    near, far = _strained(a, b)
    l, r = _bent(lane, model, par, at.bend, near, far)
    factor = load(lane, par, STIFFNESS_FACTOR)
    l = minus(l, times(constant(lane, model, at.moment, 0), factor))
    r = minus(r, times(constant(lane, model, at.moment, 1), factor))
    if tau is not None:
        e = e + _stretch_rate(lane, model, frame, rates, (hl, hr), at, q, v, row) * tau
        near, far = _strained_rate(a, b, rates.left, rates.right)
        dl, dr = _bent(lane, model, par, at.bend, near, far)
        l, r = plus(l, times(dl, tau)), plus(r, times(dr, tau))
    apart, both = times(minus(l, r), 0.25), times(plus(l, r), HELIX)
    l, r = _unstrained(a, b, l, r, apart, both)
    pull = e * model.frames[at.pull]
    return Stiff(pull, plus(l, times(hl, pull)), plus(r, times(hr, pull)), hl, hr, apart, both)


@kernel
def _inner_bent(lane, model, par, at, i, x, row):
    """K x of inner mode i."""
    zero = splat(lane, 0.0)
    total = zero, zero, zero
    for j in range(inner_of(model)):
        one = constant(lane, model, at.inner_bend, inner_of(model) * i + j)
        total = plus(total, scale(vector(lane, x, row + 3 * j), one))
    return scale(total, factors_of(lane, par))


@kernel
def _inner_forces(lane, model, par, frame, tau, pull, second, at, state, row, r):
    """What resists the inner modes, but for their mass, to their rows. second: of the sections and the frame."""
    q, v, a = state
    width, factor = inner_of(model) + 3, load(lane, par, STIFFNESS_FACTOR)
    for i in range(inner_of(model)):
        natural = times(constant(lane, model, at.inner_moment, i), factor)
        found = minus(_inner_bent(lane, model, par, at, i, q, row), natural)
        if tau is not None:
            found = plus(found, times(_inner_bent(lane, model, par, at, i, v, row), tau))
        slope = inner_by(lane, model, at.inner_coupling, 2, i, frame.left.phi, frame.right.phi, q, row)
        found = plus(found, times(slope, pull))
        turn = inner_by(lane, model, at.inner_rotary, 3, i, second[0], second[1], a, row)
        turn = plus(turn, scale(second[2], constant(lane, model, at.inner_rotary, width * i + 2)))
        add_vector(lane, r, row + 3 * i, plus(found, turn))


@kernel
def _off(lane, model, to, a, b, x, row):
    """By what the `WEIGHT` at `to` is off the chord, for rotations a, b of the ends and inner modes x."""
    hl, hr = three_of(lane, model.frames, to + W.left), three_of(lane, model.frames, to + W.right)
    n = plus(scale(across(a), hl), scale(across(b), hr))
    for i in range(inner_of(model)):
        n = plus(n, scale(across(vector(lane, x, row + 3 * i)), three_of(lane, model.frames, to + W.inner + 3 * i)))
    return n


@kernel
def _rate(lane, model, frame, rates, left, right, to, v, row, n):
    """Velocity of the `WEIGHT` at `to`, n off the chord, inertial axes."""
    xi, slip = model.frames[to + W.xi], _off(lane, model, to, rates.left, rates.right, v, row)
    slip = turned(frame.A, plus(slip, cross(rates.spin, n)))
    return plus(plus(times(left.v, 1.0 - xi), times(right.v, xi)), slip)


@kernel
def _most_force(section, sixth, mass):
    """See `MOST`; sixth: of the segment's mass, mass: that weight of the matrix."""
    x, y, z = section.bend
    square = section.length * section.length
    own = smaller(smaller(x, y), z) / square
    return select_lt(own * HEAVY, sixth * section.length * (6.0 * mass), own * MOST, np.inf)


@kernel
def _clipped(a, most):
    """Vector a, each entry within +-most."""
    return clip(a[0], most), clip(a[1], most), clip(a[2], most)


@kernel
def framed(lane, model, par, section, state, left, right, i, weights, r, S, f):
    """((force, moment) of the left end, of the right) of segment i, between two `Vertex`; its `FACTOR` at f of S, the
    rows of its inner modes in r."""
    at, row = frame_at(model, i), inner_row(model, i)
    frame = frame_of(left.place, right.place)
    rates = rates_of(frame, left.place, right.place)
    spin, a, b = rates.spin, frame.left, frame.right
    alpha = seconds(frame, rates, left, right)
    second_l = phi_second(a, rates.left, left.place.spin, left.alpha, spin, alpha)
    second_r = phi_second(b, rates.right, right.place.spin, right.alpha, spin, alpha)
    stiff = _elastic(lane, model, par, frame, rates, section.tau, at, state, row)
    al, ar = back(frame.A, left.a), back(frame.A, right.a)
    zero = splat(lane, 0.0)
    push_l, push_r, couple = (zero, zero, zero), (zero, zero, zero), (zero, zero, zero)
    ml, mr = stiff.left, stiff.right
    for p in range(points_of(model)):
        to = at.points + weight_end(model) * p
        xi, mass = model.frames[to + W.xi], model.frames[to + W.mass]
        hl, hr = three_of(lane, model.frames, to + W.left), three_of(lane, model.frames, to + W.right)
        n = _off(lane, model, to, a.phi, b.phi, state.q, row)
        rate = _off(lane, model, to, rates.left, rates.right, state.v, row)
        second = _off(lane, model, to, second_l, second_r, state.a, row)
        found = plus(plus(times(al, 1.0 - xi), times(ar, xi)), plus(second, times(cross(spin, rate), 2.0)))
        force = times(plus(found, swirl(spin, alpha, n)), mass)
        push_l, push_r = plus(push_l, times(force, 1.0 - xi)), plus(push_r, times(force, xi))
        couple = plus(couple, cross(n, force))
        ml, mr = plus(ml, lifted(scale(force, hl))), plus(mr, lifted(scale(force, hr)))
        for j in range(inner_of(model)):
            share = three_of(lane, model.frames, to + W.inner + 3 * j)
            add_vector(lane, r, row + 3 * j, lifted(scale(force, share)))
    if model.inner is not None:
        turns = left.alpha, right.alpha, alpha
        _inner_forces(lane, model, par, frame, section.tau, stiff.pull, turns, at, state, row, r)
    turn_l, turn_r, turn = _rotary(lane, model, at, left, right, (spin, alpha), state, row)
    couple = minus(plus(couple, turn), plus(turned(a.T, ml), turned(b.T, mr)))
    aside = stiff.pull, couple[2] * frame.over, (couple[1] + couple[0] * frame.k) * -frame.over
    if weights.mass != 0.0:
        most = _most_force(section, model.frames[at.mass] * 0.5, weights.mass)
        moment = most * section.length
        now = _clipped(aside, most), _clipped(ml, moment), _clipped(mr, moment)
        spins, pull = (left.place.spin, right.place.spin), clip(stiff.pull, most)
        tangent(
            lane, model, par, section.tau, frame, rates, spins, left.own, stiff, pull, now, i, state.q, weights, S, f
        )
    on_l = plus(plus(back(a.T, ml), times(a.g, couple[0])), turn_l)
    on_r = plus(plus(back(b.T, mr), times(b.g, couple[0])), turn_r)
    return (turned(frame.A, minus(push_l, aside)), on_l), (turned(frame.A, plus(push_r, aside)), on_r)


@kernel
def _momenta(lane, model, at, a, b, c, x, row):
    """Angular momenta that go with the rates a, b of the ends' rotations, c of the frame's and x of inner modes."""
    l, r = product(lane, model, at.rotary, a, b)
    lc, rc = constant(lane, model, at.rotary, 3), constant(lane, model, at.rotary, 4)
    own = plus(plus(scale(a, lc), scale(b, rc)), scale(c, constant(lane, model, at.rotary, 5)))
    l, r = plus(l, scale(c, lc)), plus(r, scale(c, rc))
    if model.inner is not None:
        l, r = ends_by(lane, model, at.inner_rotary, 3, x, row, l, r)
        for i in range(inner_of(model)):
            share = constant(lane, model, at.inner_rotary, (inner_of(model) + 3) * i + 2)
            own = plus(own, scale(vector(lane, x, row + 3 * i), share))
    return l, r, own


@kernel
def _rotary(lane, model, at, left, right, frame, state, row):
    """Moments of rotary inertia: on the left section, the right one, the frame, each in its axes. frame: its rates."""
    wl, wr, (spin, alpha) = left.place.spin, right.place.spin, frame
    l, r, c = _momenta(lane, model, at, wl, wr, spin, state.v, row)
    more_l, more_r, more = _momenta(lane, model, at, left.alpha, right.alpha, alpha, state.a, row)
    return plus(more_l, cross(wl, l)), plus(more_r, cross(wr, r)), plus(more, cross(spin, c))


@inlined
def frame_sums(lane, model, par, q, v, left, right, i):
    """`chain.sums_of` segment i between two `Place`s."""
    at, row = frame_at(model, i), inner_row(model, i)
    frame = frame_of(left, right)
    rates = rates_of(frame, left, right)
    a, b, spin = frame.left, frame.right, rates.spin
    e, _, _ = _stretch(lane, model, frame, at, q, row)
    near, far = _strained(a.phi, b.phi)
    l, r = _bent(lane, model, par, at.bend, near, far)
    strain = (e * e * model.frames[at.pull] + dot(l, near) + dot(r, far)) * 0.5
    natural = dot(constant(lane, model, at.moment, 0), near) + dot(constant(lane, model, at.moment, 1), far)
    tl, tr, tc = _momenta(lane, model, at, left.spin, right.spin, spin, v, row)
    kinetic = dot(tl, left.spin) + dot(tr, right.spin) + dot(tc, spin)
    for j in range(inner_of(model)):
        own, rate = vector(lane, q, row + 3 * j), vector(lane, v, row + 3 * j)
        strain = strain + dot(_inner_bent(lane, model, par, at, j, q, row), own) * 0.5
        natural = natural + dot(constant(lane, model, at.inner_moment, j), own)
        turn = inner_by(lane, model, at.inner_rotary, 3, j, left.spin, right.spin, v, row)
        turn = plus(turn, scale(spin, constant(lane, model, at.inner_rotary, (inner_of(model) + 3) * j + 2)))
        kinetic = kinetic + dot(turn, rate)
    strain = strain + (model.frames[at.spent] - natural) * load(lane, par, STIFFNESS_FACTOR)
    gravity = splat(lane, 0.0)
    push = gravity, gravity, gravity
    for p in range(points_of(model)):
        to = at.points + weight_end(model) * p
        mass, xi = model.frames[to + W.mass], model.frames[to + W.xi]
        n = _off(lane, model, to, a.phi, b.phi, q, row)
        rate = _rate(lane, model, frame, rates, left, right, to, v, row, n)
        kinetic, push = kinetic + dot(rate, rate) * mass, plus(push, times(rate, mass))
        if model.gravity is not None:
            place = plus(plus(times(left.r, 1.0 - xi), times(right.r, xi)), turned(frame.A, n))
            gravity = gravity - dot(three_of(lane, model.gravity, 0), place) * mass
    return (kinetic * 0.5, strain, gravity), push


@kernel
def frame_damping(lane, model, par, state, left, right, other_l, other_r, i):
    """Power over tau_d of segment i's damping at the rates of left and right over those of the others, W s; of inner
    modes at the rates v of the state over its a."""
    at, row = frame_at(model, i), inner_row(model, i)
    q, v, x = state
    frame = frame_of(left, right)
    one, two = rates_of(frame, left, right), rates_of(frame, other_l, other_r)
    _, hl, hr = _stretch(lane, model, frame, at, q, row)
    near, far = _strained_rate(frame.left.phi, frame.right.phi, one.left, one.right)
    l, r = _bent(lane, model, par, at.bend, near, far)
    near, far = _strained_rate(frame.left.phi, frame.right.phi, two.left, two.right)
    stretch = _stretch_rate(lane, model, frame, one, (hl, hr), at, q, v, row)
    other = _stretch_rate(lane, model, frame, two, (hl, hr), at, q, x, row)
    power = stretch * other * model.frames[at.pull] + dot(l, near) + dot(r, far)
    for j in range(inner_of(model)):
        power = power + dot(_inner_bent(lane, model, par, at, j, v, row), vector(lane, x, row + 3 * j))
    return power
