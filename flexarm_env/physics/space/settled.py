"""Where sections go when their rotations and the forces of elements are given: the curve that increments follow.

Steel strips turn far in a step, and hardly stretch. Places that move along straight lines where sections turn by d
stretch an element by d^2/2, and damp it by c_v tau_d as much again: forces that the next iteration has to take away
first. Newton's increment is therefore taken as one of rotations and of the elements' forces, which it has right to
first order; places follow from these, and rates and accelerations follow places as in any step. By the damping of
stretch and shear a force is affine in the chord's components e of the element's middle:

    n / D = (1 + tau_d c_v) e + tau_d e x w + (what does not depend on e),   w: what the middle turns by
"""

from __future__ import annotations

from ...compiler import kernel, largest, load, select_lt, splat, store
from ..arithmetic import add, put_vector, vector
from ..integrator.newton import follow
from ..integrator.work import moved_by
from .chain import has_lever, place_at, planted, section_at, three_of
from .element import Place, arc_of, bow_of, mean, middle
from .inner import elements_before
from .layout import F, H, J, count_of, factor_at, hinge_at, joint_row, vertex_row
from .matrix import carried, matrix_in
from .rotations import back, composed, cross, dot, inverse, matrix, minus, plus, shorter, times, turn_of, turned

LONGEST = 0.05
"""Of Newton's increments, rad or shares of the arm's length: what whips about starts further off than that, and leaves
the range of its tangent otherwise."""


LACK = 1e-2
"""Of the derivative in Newton's matrix, at most: measured up to 35 rad/s in steps of 2.5 ms, a third of it."""


@kernel
def lack(model):
    """See `protocol`. A frame's matrix lacks as much of inertia, which is all that counts in short steps."""
    return (0.0 if model.frames is None else LACK), LACK


@kernel
def stride(model):
    """See `protocol`."""
    return LONGEST


@kernel
def _chord(section, left, right, n, cv):
    """The place of `right` beside `left` with the force n, its rate c_v faster than where it is per m."""
    relative = shorter(composed(inverse(left.p), right.p))
    psi, half, g, T = turn_of(relative)
    R = matrix(composed(left.p, half))
    bow = bow_of(section.uneven, psi)
    strain = n[0] / section.stretch[0], n[1] / section.stretch[1], n[2] / section.stretch[2]
    b = strain[0] + 1.0 + bow[0], strain[1] + bow[1], strain[2] + bow[2]
    if section.tau is None:
        e = b
    else:
        share = 1.0 / section.length
        slip = plus(minus(right.v, left.v), times(minus(left.r, right.r), cv))
        bend = minus(turned(T, right.spin), back(T, left.spin))
        known = plus(times(back(R, slip), share), turned(arc_of(section.uneven, psi), bend))
        b = minus(b, times(known, section.tau))
        alpha, turn = section.tau * cv + 1.0, times(mean(g, left.spin, right.spin), section.tau)
        whole = plus(times(plus(times(b, alpha), cross(turn, b)), alpha), times(turn, dot(turn, b)))
        e = times(whole, 1.0 / (alpha * (alpha * alpha + dot(turn, turn))))
    return plus(left.r, turned(R, times(e, section.length)))


@kernel
def _hold_forces(lane, model, par, w):
    """Elements are to have the forces of the step's start."""
    tip = place_at(lane, w.q0, w.v0, 0)
    for k in range(model.links):
        left, first = planted(lane, model, w.q0, w.v0, k, tip)[2], elements_before(model, k)
        for e in range(count_of(model, k)):
            right = place_at(lane, w.q0, w.v0, vertex_row(model, k, e))
            found = middle(section_at(lane, model, par, first + e), left, right)[1]
            put_vector(w.S, factor_at(model, k, e) + F.force, found.n)
            left = right
        tip = left


@kernel
def _add_forces(lane, model, w, active):
    """Elements are to have the forces that the increment w.r brings to first order, where `active`."""
    a, b = vector(lane, w.r, 0), vector(lane, w.r, 3)
    for k in range(model.links):
        h, own = hinge_at(k), load(lane, w.r, joint_row(model, k))
        axis = three_of(lane, model.joints, J.end * k + J.axis)
        if has_lever(model, k):
            shift = turned(matrix_in(lane, w.S, h + H.shift), b)
            a = plus(a, plus(shift, times(vector(lane, w.S, h + H.drift), own)))
        b = plus(back(matrix_in(lane, w.S, h + H.turn), b), times(carried(lane, model, w.S, k, axis), own))
        for e in range(count_of(model, k)):
            f, i = factor_at(model, k, e), vertex_row(model, k, e)
            x, y = vector(lane, w.r, i), vector(lane, w.r, i + 3)
            n = turned(matrix_in(lane, w.S, f + F.by_place), minus(x, a))
            n = plus(n, turned(matrix_in(lane, w.S, f + F.by_left), b))
            n = plus(n, turned(matrix_in(lane, w.S, f + F.by_right), y))
            for j in range(3):
                add(lane, w.S, f + F.force + j, select_lt(0.5, active, n[j], splat(lane, -0.0)))
            a, b = x, y


@kernel
def settle(lane, model, par, start, w, active, slopes):
    """See `protocol`."""
    if model.frames is not None:
        return
    if start is None:
        if largest(active) < 0.5:
            return
        _add_forces(lane, model, w, active)
    else:
        _hold_forces(lane, model, par, w)
    tip, (total, begin) = place_at(lane, w.q, w.v, 0), moved_by(w)
    for k in range(model.links):
        left, first = planted(lane, model, w.q, w.v, k, tip)[2], elements_before(model, k)
        for e in range(count_of(model, k)):
            i = vertex_row(model, k, e)
            section, right = section_at(lane, model, par, first + e), place_at(lane, w.q, w.v, i)
            r = _chord(section, left, right, vector(lane, w.S, factor_at(model, k, e) + F.force), slopes.v)
            for j in range(3):
                d = select_lt(0.5, active, r[j] - right.r[j], splat(lane, -0.0))
                moved = load(lane, total, i + j) + d
                store(total, i + j, moved)
                store(w.q, i + j, load(lane, begin, i + j) + moved)
                follow(lane, w, i + j, d, slopes)
            left = Place(vector(lane, w.q, i), vector(lane, w.v, i), right.p, right.spin)
        tip = left
