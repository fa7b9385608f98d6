"""Residual and tangent of chains in space (models: `chain`), and the registration of their kernels.

The module `layout` defines the rows of coordinates and the layout of S, the array of the Newton matrix. Each end of an
exact element carries half of the element's rotary inertia J. The moment of this inertia on a vertex is J alpha + w x J
w in the vertex's own axes. Wrenches consist of a force along inertial axes and a moment in section axes.
"""

from __future__ import annotations

from ...compiler import Lanes, kernel, noinline
from ..arithmetic import store_vector
from ..model import PAYLOAD_INERTIA, PAYLOAD_MASS
from ..protocol import register
from .chain import (
    SpatialBeam,
    SpatialElastica,
    add_lumped_mass,
    add_rigid_body,
    fill_zeros,
    has_lever,
    joint_kinematics,
    point_load_wrench,
    rotor_moment,
    transmit_wrench,
    vertex_at,
)
from .element import forces, inertia_wrenches, middle, tangent
from .elimination import factor, solve
from .framed import framed
from .inner import elements_before
from .inputs import input_displacements
from .layout import AXES, B, E, F, H, J, L, before, count_of, factor_at, hinge_at, joint_row, section_at
from .matrix import add_stiffness, matrix_in, store_spin_lag
from .moving import local_difference, note_inverse, noted_inverse, retract, tangent_map, vertices_of
from .output import (
    add_vector_pairs,
    centerline,
    damping_power,
    energy,
    link_poses,
    momentum,
    set_joint_configuration,
    strain_gauge,
)
from .rotations import Vector, add_vector, cross, dot, load_vector, matrix, store_matrix, three_of
from .settled import correct_positions
from .strained import elastic, strained_difference, strained_update, sweep_inward, sweep_outward
from .strained_layout import noted_at
from .strained_tangent import strained_tangent


@noinline
def _add(lane, r, i, of):
    """Add the wrench `of` = (force, moment) to the six rows of the residual r from row i on.

    The function is not inlined. In a loop without a call LLVM compares all reads and writes in pairs, hundreds for an
    element.
    """
    add_vector(lane, r, i, of[0])
    add_vector(lane, r, i + 3, of[1])


@kernel
def assemble(lane, model, par: Lanes, state, u, weights, r, S):
    """Compute the residual r of equation [64] and, with weights.with_matrix, the matrix in S (`protocol.assemble`).

    An outward sweep computes each section's motion and the wrenches of elements, bodies and loads on it; an inward
    sweep transmits the links' root wrenches across their joints.
    r: forces (N, inertial axes) and moments (N m, section axes) of vertices, torques (N m) of joints. The matrix is
    stored in blocks (`FACTOR`, `HINGE`, `BASE`), never as a whole.
    """
    fill_zeros(lane, r, 0, model.n)
    if weights.with_matrix:
        fill_zeros(lane, S, 0, B.end)
    # from the base outward (9.1): r, v, a (inertial axes), p, w, alpha (section axes) of the section before joint k
    tip = vertex_at(lane, model, state, 0)
    for k in range(model.links):
        at, first, o = J.end * k, factor_at(model, k, 0) + F.LL, before(model, k)
        # bodies on the section before the joint: m (a - g) and I alpha + w x I w, less loads; the rotor's h w x e
        if k > 0:
            transmit_wrench(
                lane, model, r, S, k, add_rigid_body(lane, model.joints, at + J.near, None, None, tip, weights, S, o)
            )
            transmit_wrench(lane, model, r, S, k, point_load_wrench(lane, model, u, k - 1, 1.0, tip, weights, S, o))
        if model.rotors is not None:
            if model.rotors[k] > 0:
                transmit_wrench(lane, model, r, S, k, rotor_moment(lane, model, S, k, tip, weights, o))
        # (9.1) to the link's root; then wrenches of its elements, bodies and loads on it (force inertial, moment
        # section axes)
        hinge = joint_kinematics(lane, model, state, k, tip, weights)
        last, on_root = _along(lane, model, par, k, state, u, hinge.root, weights, r, S)
        on_root = add_vector_pairs(
            on_root, add_rigid_body(lane, model.joints, at + J.far, None, None, hinge.root, weights, S, first)
        )
        on_root = add_vector_pairs(on_root, point_load_wrench(lane, model, u, k, 0.0, hinge.root, weights, S, first))
        _note(lane, model, S, k, hinge, tip, on_root)
        if weights.with_matrix:
            store_spin_lag(lane, model, par, S, k, hinge.root.place.spin, weights)
        tip = last
    # wrenches of rigid end, payload (m_p, I_p) and loads on the last section
    n, o = model.links, before(model, model.links)
    transmit_wrench(lane, model, r, S, n, add_rigid_body(lane, model.end, 0, None, None, tip, weights, S, o))
    mass, share = par[PAYLOAD_MASS], par[PAYLOAD_INERTIA]
    transmit_wrench(lane, model, r, S, n, add_rigid_body(lane, model.payload, 0, mass, share, tip, weights, S, o))
    transmit_wrench(lane, model, r, S, n, point_load_wrench(lane, model, u, n - 1, 1.0, tip, weights, S, o))
    # from the tip inward: axis . m goes to the joint's row, (f, E m + lever) to the section before
    for back_k in range(model.links):
        k = model.links - 1 - back_k
        h = hinge_at(k)
        on_root = load_vector(lane, S, h + H.now_force), load_vector(lane, S, h + H.now_moment)
        on_root = _gathered(lane, model, par, k, state, weights, r, S, on_root)
        transmit_wrench(lane, model, r, S, k, _handed(lane, model, u, weights, r, S, k, on_root[0], on_root[1]))


@kernel
def _along(lane, model, par, k, state, u, root, weights, r, S):
    """Compute the wrenches on link k's sections from its root `Vertex` outward; add them to r, their tangent to S.

    Returns the `Vertex` (kinematic state) of the link's last section, and the (force, moment) on its root (N along
    inertial axes; N m in root axes). If strains are coordinates the wrench on the root is 0 here; `_gathered` computes
    it from the wrench on the last section.
    See docs/theory.md, section 9.
    """
    zero, first = 0.0, factor_at(model, k, 0)
    on_root = Vector(zero, zero, zero), Vector(zero, zero, zero)
    # strains as coordinates: only r, v, a of the points; forces need all of them and follow inward
    if model.strains is not None:
        fill_zeros(lane, S, noted_at(model, k).on, 6)
        if weights.with_matrix:
            fill_zeros(lane, S, first, F.end)
        if count_of(model, k) == 0:
            return root, on_root
        return sweep_outward(lane, model, k, state, root, S), on_root
    left, j, element = root, joint_row(model, k) + 1, elements_before(model, k)
    # rigid links have no element: LL starts from zero and collects the bodies on the root
    if weights.with_matrix:
        if count_of(model, k) == 0:
            fill_zeros(lane, S, first + F.LL, 36)
    for e in range(count_of(model, k)):
        section, right = section_at(lane, model, par, element), vertex_at(lane, model, state, j)
        f = first + F.end * e
        if model.frames is None:
            on_left, on_right = _exact(lane, model, section, left, right, element, weights, S, f)
        else:
            on_left, on_right = framed(lane, model, par, section, state, left, right, element, weights, r, S, f)
        # left end of the first element: the link's root, whose wrench goes to the joint
        if e == 0:
            on_root = on_left
        else:
            _add(lane, r, j - AXES, on_left)
        add_vector(lane, r, j, on_right[0])
        add_vector(lane, r, j + 3, on_right[1])
        # loads between two elements
        if model.inside is not None:
            if e + 1 < count_of(model, k):
                _add(lane, r, j, point_load_wrench(lane, model, u, k, 2.0 + e, right, weights, S, f + F.RR))
        left = right
        j += AXES
        element += 1
    return left, on_root


@kernel
def _gathered(lane, model, par, k, state, weights, r, S, of):
    """Return the total (force, moment) on the root of link k: the wrench `of` plus the wrench of the rest of the link.

    If strains are coordinates, the wrenches of the Gauss points are summed from tip to root, and the strains' rows of r
    and S are written. For a rigid link, the wrench in the link's rows of r is moved to the root. The force is along
    inertial axes (N), the moment in root axes (N m).
    See docs/theory.md, section 9.
    """
    i = joint_row(model, k) + 1
    if model.strains is not None:
        on = noted_at(model, k).on
        # (f, m) on the last section, carried inward over the points to r of the strains
        more = load_vector(lane, S, on), load_vector(lane, S, on + 3)
        if count_of(model, k) > 0:
            more = sweep_inward(lane, model, k, r, S)
            elastic(lane, model, par, k, state, r)
            if weights.with_matrix:
                strained_tangent(lane, model, par, k, weights, S, factor_at(model, k, 0))
        return add_vector_pairs(of, more)
    if count_of(model, k) == 0:
        # a rigid link's last section is its root: its wrenches add
        of = add_vector_pairs(of, (load_vector(lane, r, i), load_vector(lane, r, i + 3)))
        fill_zeros(lane, r, i, AXES)
    return of


@kernel
def _exact(lane, model, section, left, right, element, weights, S, f):
    """Return the (force, moment) on the left and on the right end of an exact element, including damping and inertia.

    left, right: `Vertex` (kinematic state) of each end.
    element: index of the element, counted over all links. Forces are along inertial axes (N), moments in section axes
    (N m). The function stores the section force n and, with weights.with_matrix, the tangent in the `FACTOR` record at
    offset f of S. See docs/theory.md, (9.2).
    """
    inner = middle(section, left.place, right.place)[1]
    store_vector(lane, S, f + F.force, inner.n)
    on_left, on_right = forces(section, inner)
    masses = three_of(lane, model.sections, E.end * element + E.mass)
    if weights.with_matrix:
        tangent(lane, section, inner, weights, S, f)
    # inertia by Simpson's rule: the middle's mass, then mass and rotary inertia of the ends
    at_left, at_right = inertia_wrenches(lane, masses[1], section.length, left, right, weights, S, f)
    I = three_of(lane, model.sections, E.end * element + E.inertia)
    on_left = add_vector_pairs(
        add_vector_pairs(on_left, at_left), add_lumped_mass(lane, masses[0], I, left, weights, S, f + F.LL)
    )
    return on_left, add_vector_pairs(
        add_vector_pairs(on_right, at_right), add_lumped_mass(lane, masses[2], I, right, weights, S, f + F.RR)
    )


@kernel
def conserve_momentum(lane, model, par: Lanes, before, h, q, v, u, r, S):
    """Correct velocities so that momentum changes by the impulse of weight and loads (theory, 9).

    The rigid translation (P_0 + h/2 (F_0 + F_1) - P) / M, which enters no other equation, is added to the velocities of
    all sections. The correction is needed because positions of middles and of offset centers of mass are not linear in
    the coordinates.
    P: momentum (kg m/s), F: force of weight and loads (N), 0 at the start and 1 at the end of the step h (s), inertial
    axes; M: mass. Returns (P, F) at the end, or None where a support holds the arm. before: (P_0, F_0), or None to skip
    the correction.
    """
    if model.free is None:
        return None
    mass, nothing = par[PAYLOAD_MASS] + model.free, 0.0
    # F (N, inertial axes): m g and the loads' forces
    push = Vector(nothing, nothing, nothing)
    if model.gravity is not None:
        push = mass * three_of(lane, model.gravity, 0)
    if model.loads is not None:
        for f in range(model.loads.shape[0] // L.end):
            push = push + load_vector(lane, u, model.links + AXES * f)
    now = momentum(lane, model, par, q, v)
    if before is None:
        return now, push
    # shift of all velocities, inertial axes
    wanted = before[0] + 0.5 * h * (before[1] + push)
    shift = 1.0 / mass * (wanted - now)
    add_vector(lane, v, 0, shift)
    # v_0 += shift alone moves all where coordinates are strains; otherwise each vertex has a v of its own
    if model.strains is None:
        for k in range(model.links):
            for e in range(vertices_of(model, k)):
                add_vector(lane, v, joint_row(model, k) + 1 + AXES * e, shift)
    return wanted, push


@kernel
def _note(lane, model, S, k, hinge, tip, on_root):
    """Store rotation, lever, axes of the section before and the root's wrench in the `HINGE` of joint k, for `_handed`.

    hinge: kinematics of the joint.
    tip: `Vertex` of the section before.
    on_root: force (N, inertial axes) and moment (N m, root axes) on the link's root.
    """
    h = hinge_at(k)
    store_matrix(lane, S, h + H.now_turn, hinge.turn)
    store_vector(lane, S, h + H.now_force, on_root[0])
    store_vector(lane, S, h + H.now_moment, on_root[1])
    if has_lever(model, k):
        store_vector(lane, S, h + H.now_lever, hinge.lever)
        store_matrix(lane, S, h + H.now_frame, matrix(tip.place.p))


@kernel
def _handed(lane, model, u: Lanes, weights, r: Lanes, S: Lanes, k, force, moment):
    """Transmit a wrench across joint k: return (force, moment) on the section before, write the joint's row of r.

    force (N, inertial) and moment m (N m, root axes) act on the link's first section. The force does not change. The
    moment becomes E m + s x A^T force (axes of the section before). The joint's row is axis . m + (axis x o)^T E^T A^T
    force - u_k (N m) with the joint torque u_k. E maps root axes to axes of the section before, A maps these axes to
    inertial axes. s is the lever from the section before to the link's first section, o its part beyond the joint. With
    weights.with_matrix the `HINGE` gets what `elimination` needs. See docs/theory.md, (9.1).
    """
    h, axis = hinge_at(k), three_of(lane, model.joints, J.end * k + J.axis)
    turn = matrix_in(lane, S, h + H.now_turn)
    own, on_section = dot(axis, moment), turn @ moment
    if has_lever(model, k):
        frame, lever = matrix_in(lane, S, h + H.now_frame), load_vector(lane, S, h + H.now_lever)
        # levers: force in the axes of the section before
        pull = frame.T @ force
        on_section = on_section + cross(lever, pull)
        far = three_of(lane, model.joints, J.end * k + J.beyond)
        own = own + dot(cross(axis, far), turn.T @ pull)
        if weights.with_matrix:
            store_vector(lane, S, h + H.force, weights.stiffness * pull)
            store_vector(lane, S, h + H.lever, lever)
            store_matrix(lane, S, h + H.frame, frame)
    r[joint_row(model, k)] = own - u[k]
    if weights.with_matrix:
        # copies: `factor` and `solve` need E, m of this matrix, which a later residual overwrites
        store_matrix(lane, S, h + H.turn, turn)
        store_vector(lane, S, h + H.moment, weights.stiffness * moment)
        S[h + H.own] = 0.0
        S[h + H.pinned] = 0.0
    return force, on_section


COMMON = (
    assemble, add_stiffness, factor, solve, energy, input_displacements, damping_power, link_poses,
    centerline, set_joint_configuration, conserve_momentum,
)  # fmt: skip
register(SpatialElastica, *COMMON, retract=strained_update, local_difference=strained_difference)
register(
    SpatialBeam, *COMMON, retract, local_difference, tangent_map, strain_gauge, correct_positions, note_inverse,
    noted_inverse,
)  # fmt: skip
