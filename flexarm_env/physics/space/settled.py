"""Positions of sections from given rotations and section forces, by which Newton increments follow the constraint arc.

Steel strips rotate far in a step and hardly stretch. If positions moved along straight lines while sections rotate by
d, an element would be stretched by d^2/2. Damping would add c_v tau_d times the resulting force. The next iteration
would have to remove these forces first. Therefore Newton's increment is applied to rotations and to the elements'
section forces n, which are right to first order. Positions follow from rotations and forces; rates and accelerations
follow positions as in any step. With damping, the section force n of an element is affine in the chord's components e
(axes of the element's middle):

    n / D = (1 + tau_d c_v) e + tau_d e x w + (terms without e),   w: angular velocity of the middle
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...compiler import kernel, max_over_lanes, select_lt
from ..arithmetic import store_vector
from ..integrator.newton import follow_displacement, move_prediction
from ..integrator.work import accumulated_increment, copy_rows
from .chain import has_lever, joint_placement, place_at
from .element import Place, arc_of, bow_of, mean, middle
from .inner import elements_before
from .layout import F, H, J, count_of, factor_at, hinge_at, joint_row, section_at, vertex_row
from .matrix import joint_motion_of_root, matrix_in
from .output import restore_chords
from .rotations import (
    Vector,
    compose,
    cross,
    dot,
    inverse_rotation,
    load_vector,
    matrix,
    shortest_rotation,
    three_of,
    turn_of,
)

if TYPE_CHECKING:
    from ..integrator.work import Work


@kernel
def _chord(section, left, right, n, cv):
    """Return the position (m, inertial axes) of the right end at which the element has the section force n.

    n: section force (N), axes of the middle.
    left, right: `Place`s of the ends, with final rotations and spins.
    cv: change of velocity per change of position (1/s). The function solves n / D = Gamma + tau Gamma' for the chord e;
    D is the stiffness against stretch and shear Gamma. See docs/theory.md, section 9, "Increments".
    """
    relative = shortest_rotation(compose(inverse_rotation(left.p), right.p))
    psi, half, g, T = turn_of(relative)
    R = matrix(compose(left.p, half))
    bow = bow_of(section.uneven, psi)
    # e without damping: n / D + e_x + bow
    strain = Vector(n[0] / section.stretch[0], n[1] / section.stretch[1], n[2] / section.stretch[2])
    b = Vector(strain[0] + 1.0 + bow[0], strain[1] + bow[1], strain[2] + bow[2])
    if section.tau is None:
        e = b
    else:
        share = 1.0 / section.length
        # slip = v_r - v_l + c_v (r_l - r_r): v that the right end would have at the left end's place
        slip = right.v - left.v + cv * (left.r - right.r)
        bend = T @ right.spin - T.T @ left.spin
        known = share * (R.T @ slip) + arc_of(section.uneven, psi) @ bend
        b = b - section.tau * known
        # alpha e + e x turn = b: e = (alpha^2 b + alpha turn x b + turn (turn . b)) / (alpha (alpha^2 + turn^2))
        alpha, turn = section.tau * cv + 1.0, section.tau * mean(g, left.spin, right.spin)
        whole = alpha * (alpha * b + cross(turn, b)) + dot(turn, b) * turn
        e = 1.0 / (alpha * (alpha * alpha + dot(turn, turn))) * whole
    return left.r + R @ (section.length * e)


@kernel
def _hold_forces(lane, model, par, w):
    """Store the section force n (N, axes of the middle) of each element at the step's start (q0, v0) in `FACTOR`."""
    tip = place_at(lane, w.q0, w.v0, 0)
    for k in range(model.links):
        left, first = joint_placement(lane, model, w.q0, w.v0, k, tip)[2], elements_before(model, k)
        for e in range(count_of(model, k)):
            right = place_at(lane, w.q0, w.v0, vertex_row(model, k, e))
            found = middle(section_at(lane, model, par, first + e), left, right)[1]
            store_vector(lane, w.S, factor_at(model, k, e) + F.force, found.n)
            left = right
        tip = left


@kernel
def _add_forces(lane, model, w: Work, active):
    """Add the first-order change by the Newton increment w.r to each element's section force n, where `active`.

    dn = by_place (dr_r - dr_l) + by_left dth_l + by_right dth_r (N, axes of the middle); theory, 9, "Increments".
    """
    a, b = load_vector(lane, w.r, 0), load_vector(lane, w.r, 3)
    for k in range(model.links):
        h, own = hinge_at(k), w.r[joint_row(model, k)]
        axis = three_of(lane, model.joints, J.end * k + J.axis)
        # motion (a, b) of the link's root: position inertial, rotation in root axes
        if has_lever(model, k):
            shift = matrix_in(lane, w.S, h + H.shift) @ b
            a = a + (shift + own * load_vector(lane, w.S, h + H.drift))
        b = matrix_in(lane, w.S, h + H.turn).T @ b + own * joint_motion_of_root(lane, model, w.S, k, axis)
        for e in range(count_of(model, k)):
            f, i = factor_at(model, k, e), vertex_row(model, k, e)
            x, y = load_vector(lane, w.r, i), load_vector(lane, w.r, i + 3)
            # dn = dn/dr (x - a) + dn/dtheta_l b + ..., from the motions of its ends
            n = matrix_in(lane, w.S, f + F.by_place) @ (x - a)
            n = n + matrix_in(lane, w.S, f + F.by_left) @ b
            n = n + matrix_in(lane, w.S, f + F.by_right) @ y
            for j in range(3):
                w.S[f + F.force + j] += select_lt(0.5, active, n[j], -0.0)
            a, b = x, y


@kernel
def correct_positions(lane, model, par, w: Work, active, slopes, predicted):
    """Correct positions in w.q so that each exact element has its stored section force (`protocol.correct_positions`).

    active: lanes with values above 1/2 are corrected.
    slopes: changes of velocity and acceleration per change of position.
    predicted: None if the call follows the Newton increment w.r; the section forces then include this increment to
    first order. Otherwise (a compile-time tag) the call follows the prediction, and the section forces are those at the
    step's start. Segments with floating frames keep the chords of the step's start, only after the prediction. After
    the prediction w.r is scratch memory. See docs/theory.md, section 9, "Increments".
    """
    if predicted is not None:
        copy_rows(lane, model.n, w.q, w.r)
        restore_chords(lane, model, w.q0, w.r)
        move_prediction(lane, model, w, w.r, slopes)
    if model.frames is not None:
        return
    if predicted is None:
        if max_over_lanes(active) < 0.5:
            return
        _add_forces(lane, model, w, active)
    else:
        _hold_forces(lane, model, par, w)
    # from the base outward, because r of a right end is relative to the left one that is already corrected
    tip, (total, begin) = place_at(lane, w.q, w.v, 0), accumulated_increment(lane, w)
    for k in range(model.links):
        left, first = joint_placement(lane, model, w.q, w.v, k, tip)[2], elements_before(model, k)
        for e in range(count_of(model, k)):
            i = vertex_row(model, k, e)
            section, right = section_at(lane, model, par, first + e), place_at(lane, w.q, w.v, i)
            r = _chord(section, left, right, load_vector(lane, w.S, factor_at(model, k, e) + F.force), slopes.v)
            for j in range(3):
                # -0.0 where an arm is inactive: x + -0.0 is x to the last bit
                d = select_lt(0.5, active, r[j] - right.r[j], -0.0)
                moved = total[i + j] + d
                total[i + j] = moved
                w.q[i + j] = begin[i + j] + moved
                follow_displacement(lane, w, i + j, d, slopes)
            left = Place(load_vector(lane, w.q, i), load_vector(lane, w.v, i), right.p, right.spin)
        tip = left
