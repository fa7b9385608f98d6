"""Outputs of a chain of geometrically exact beams: input displacements, energies, damping power, poses, centerline.

The module also has `correct_positions`, for the start of the Newton iteration. Positions (m) are along inertial axes;
angles (rad) are from the x axis.
"""

import numpy as np

from ...compiler import Lanes, kernel, sincos, store
from ..arithmetic import gravity_along, load_vector, scaled_by_share, store_pair, store_vector
from ..integrator.newton import move_prediction
from ..integrator.work import copy_rows
from ..layout import OF_LOAD, POSE
from ..model import PAYLOAD_INERTIA, PAYLOAD_MASS, TAU_D
from .element import damping_sums, energy_sums, propagate_positions
from .layout import (
    AXES,
    ROWS_OF_LOAD,
    T,
    X,
    Y,
    elbow_of,
    element_at,
    lever_at,
    next_section,
    root_angle,
    rows_of,
    section_of,
    vertex_of,
)
from .rigid import beam_start_motion, joint_motion, next_vertex_motion, payload_place, rigid_end_sums
from .tables import interior


@kernel
def _input_rates(lane, model, par, q: Lanes, v: Lanes, y: Lanes):
    """Write the rates of `input_displacements` to y: joint rates (rad/s), then velocity (m/s), rate of each load point.

    A load at the end of a lever (length l along psi) moves at (x', y') + l psi' (-sin psi, cos psi).
    """
    rows, links = rows_of(model), model.links
    # joint rates psi_0', beta_k'
    y[0] = v[T]
    for k in range(1, links):
        y[k] = v[rows.hinges + k - 1]
    for f in range(model.loads.shape[0] // ROWS_OF_LOAD.end):
        of = model.loads[ROWS_OF_LOAD.end * f :]
        vx, vy = v[of[ROWS_OF_LOAD.x]], v[of[ROWS_OF_LOAD.y]]
        rate = v[of[ROWS_OF_LOAD.psi]]
        # + l psi' (-sin psi, cos psi)
        if model.rigid is not None:
            turned = rate * model.rigid[lever_at(links, 0) + f]
            sine, cosine = sincos(q[of[ROWS_OF_LOAD.psi]])
            vx, vy = vx - sine * turned, vy + cosine * turned
        # beyond a joint the section turns with the joint's angle, too
        if of[ROWS_OF_LOAD.hinge] >= 0:
            rate = rate + v[of[ROWS_OF_LOAD.hinge]]
        store_vector(lane, y, links + OF_LOAD.end * f, (vx, vy, rate))


@kernel
def input_displacements(lane, model, par, q: Lanes, y: Lanes, since=None, v=None):
    """Write to y the displacements on which inputs do work: joint angles (rad), then x, y, angle of each load point.

    Positions (m) are in inertial axes. The angle of joint 0 is psi of the root vertex. The other joint angles are the
    hinge angles delta. A load at the end of a lever moves with the lever. If a load acts beyond a hinge, its angle is
    psi + delta. par and since are not used, because angles in the plane add up.
    """
    if v is not None:
        _input_rates(lane, model, par, q, v, y)
        return
    rows, links = rows_of(model), model.links
    y[0] = q[T]
    for k in range(1, links):
        y[k] = q[rows.hinges + k - 1]
    if model.loads is not None:
        for f in range(model.loads.shape[0] // ROWS_OF_LOAD.end):
            of = model.loads[ROWS_OF_LOAD.end * f :]
            px, py = q[of[ROWS_OF_LOAD.x]], q[of[ROWS_OF_LOAD.y]]
            psi = q[of[ROWS_OF_LOAD.psi]]
            if model.rigid is not None:
                length = model.rigid[lever_at(links, 0) + f]
                sine, cosine = sincos(psi)
                px, py = px + cosine * length, py + sine * length
            if of[ROWS_OF_LOAD.hinge] >= 0:
                psi = psi + q[of[ROWS_OF_LOAD.hinge]]
            store_vector(lane, y, links + OF_LOAD.end * f, (px, py, psi))


@kernel
def energy(lane, model, par: Lanes, q: Lanes, v: Lanes):
    """Return (kinetic, strain, gravitational) energy of the chain, J; gravitational energy is 0 at the origin.

    q: coordinates (m, rad); v: their rates. The strain energy is that of theory, (5.1).
    """
    i = rows_of(model).elements
    # mx, my: first moments of mass, kg m
    psi, spin = q[i + T], v[i + T]
    kinetic = (spin * spin) * (0.5 * model.hub_inertia)
    strain, mx, my = 0.0, 0.0, 0.0
    for k in range(model.links):
        # T of the elbow: 1/2 m |v|^2 at the joint, 1/2 J psi'^2 with psi before the hinge (left) and behind it (right)
        if k > 0:
            elbow = elbow_of(model, k)
            x, y, vx, vy = joint_motion(lane, model, q, v, k)
            kinetic = kinetic + (vx * vx + vy * vy) * (0.5 * elbow.mass) + (spin * spin) * (0.5 * elbow.left)
            mx, my = mx + x * elbow.mass, my + y * elbow.mass
            psi, spin = root_angle(lane, model, q, k), root_angle(lane, model, v, k)
            kinetic = kinetic + (spin * spin) * (0.5 * elbow.right)
        section, left = section_of(lane, model, par, k), beam_start_motion(lane, model, q, v, k)
        # T, U and first moments (inertial axes) of the rigid end's lever, then of the elements
        if model.rigid is not None:
            more, x, y = rigid_end_sums(lane, model, q, v, k)
            kinetic, mx, my = kinetic + more, mx + x, my + y
        for _ in range(model.elements):
            j = i
            part = energy_sums(lane, model.order, q[j:], v[j:], psi, spin, left, section)
            kinetic, strain = kinetic + part[0], strain + part[1]
            mx, my = mx + part[2], my + part[3]
            section = next_section(model, section)
            i += AXES * len(model.order)
            psi, spin = q[i + T], v[i + T]
            left = next_vertex_motion(lane, model, q, v, i)
    # T = 1/2 (m_p |v|^2 + J_p psi'^2) at the payload's center, which may be off the tip
    mass = par[PAYLOAD_MASS]
    x, y, vx, vy = joint_motion(lane, model, q, v, model.links)
    x, y, vx, vy = payload_place(lane, model, psi, spin, x, y, vx, vy)
    kinetic = kinetic + ((vx * vx + vy * vy) * mass + (spin * spin) * par[PAYLOAD_INERTIA]) * 0.5
    mx, my = mx + x * mass, my + y * mass
    return kinetic, strain, -(mx * gravity_along(model.gravity, 0) + my * gravity_along(model.gravity, 1))


@kernel
def damping_power(lane, model, par: Lanes, q: Lanes, v: Lanes, x: Lanes):
    """Return x^T C(q) v, W: the power of the Kelvin-Voigt damping forces C v at the rates x; 0 without damping.

    See docs/theory.md, (5.1).
    """
    if model.damped is None:
        return 0.0
    i, total = rows_of(model).elements, 0.0
    for k in range(model.links):
        # psi (rad) of the left vertex in q, v and x: behind a hinge psi + delta
        psi = root_angle(lane, model, q, k), root_angle(lane, model, v, k), root_angle(lane, model, x, k)
        section = section_of(lane, model, par, k)
        left = beam_start_motion(lane, model, q, v, k), beam_start_motion(lane, model, q, x, k)
        for _ in range(model.elements):
            j = i
            # per tau_d (W/s), times the link's share of tau_d
            work = damping_sums(lane, model.order, q[j:], v[j:], x[j:], psi, left, section)[0]
            total = total + scaled_by_share(model.damped, k, work)
            section = next_section(model, section)
            i += AXES * len(model.order)
            psi = q[i + T], v[i + T], x[i + T]
            left = next_vertex_motion(lane, model, q, v, i), next_vertex_motion(lane, model, q, x, i)
    return total * par[TAU_D]


@kernel
def link_poses(lane, model, par, q: Lanes, v: Lanes, out, tasks=None):
    """Write `layout.POSES` of each link to out: x, y (m), angle (rad) and their rates at the root, then at the tip.

    Vectors are in inertial axes. Root and tip are the joints, so that rigid ends lie between them. The angles are those
    of the beam's end sections.
    q, v: coordinates and their rates. par and tasks are not used.
    """
    for k in range(model.links + 1):
        # r, psi and their rates at joint k (inertial axes): the root of link k and the tip of link k - 1
        x, y, vx, vy = joint_motion(lane, model, q, v, k)
        if k < model.links:
            at = POSE.end * k
            store_vector(lane, out, at + POSE.x, (x, y, root_angle(lane, model, q, k)))
            store_vector(lane, out, at + POSE.vx, (vx, vy, root_angle(lane, model, v, k)))
        if k > 0:
            at, i = POSE.end * (k - 1), vertex_of(model, k)
            store_vector(lane, out, at + POSE.tip_x, (x, y, q[i + T]))
            store_vector(lane, out, at + POSE.tip_vx, (vx, vy, v[i + T]))


STATIONS = np.zeros((4, 4, 2))
"""STATIONS[p, j, k] is the value of interior function k at station j; an element of order p has p equal steps."""
for _order in range(2, 4):
    STATIONS[_order, :_order, : _order - 1] = interior(_order, np.arange(_order) * 2.0 / _order - 1.0).T


@kernel
def centerline(lane, model, q: Lanes, points):
    """Write positions along the chain (m, inertial axes) to points, p per element; return the number of positions.

    q: coordinates of the arm. p is the polynomial order. Writing stops when `points` (n, lanes of 2 numbers) is full.
    The first point of a link is its joint; the last point of all is the arm's tip.
    """
    p, rows = len(model.order), rows_of(model)
    at = element_at(0, p)
    count = 0
    for e in range(model.links * model.elements):
        i = rows.elements + at.right * e
        for j in range(p):
            if count < points.shape[0]:
                share = j / p
                left = q[i + X], q[i + Y]
                if model.rigid is not None and e % model.elements == 0:
                    x, y, _, _ = beam_start_motion(lane, model, q, q, e // model.elements)
                    left = x, y
                # x, y (inertial axes) = (1 - share) left + share right + interior functions
                for axis in range(2):
                    value = left[axis] * (1.0 - share) + q[i + at.right + axis] * share
                    for k in range(p - 1):
                        value = value + STATIONS[p, j, k] * q[i + at.interior + AXES * k + axis]
                    store(points[count], axis, value)
                if j == 0 and e % model.elements == 0:
                    x, y, _, _ = joint_motion(lane, model, q, q, e // model.elements)
                    store_pair(lane, points[count], 0, (x, y))
                count += 1
    if count < points.shape[0]:
        x, y, _, _ = joint_motion(lane, model, q, q, model.links)
        store_pair(lane, points[count], 0, (x, y))
        count += 1
    return count


@kernel
def restore_strains(lane, model, start: Lanes, q: Lanes):
    """Replace the predicted positions in q (m): compute them from q's root, q's angles and the strains of `start`.

    start contains the coordinates at the beginning of the step. Nodes that moved straight along their velocities would
    stretch the chain by half the square of its rotation. In a stiff arm the resulting forces would spoil the first
    Newton iterations.
    """
    i = rows_of(model).elements
    x, y, _ = load_vector(lane, q, i)
    for k in range(model.links):
        # psi (rad) of the beam's first section, in `start` and in q
        psi, new_psi = root_angle(lane, model, start, k), root_angle(lane, model, q, k)
        for _ in range(model.elements):
            j = i
            x, y = propagate_positions(lane, model.order, start[j:], q[j:], psi, new_psi, x, y)
            i += AXES * len(model.order)
            psi, new_psi = start[i + T], q[i + T]


@kernel
def correct_positions(lane, model, par, w, active, slopes, predicted):
    """Replace the predicted positions in w.q (m): compute them from the strains of w.q0, the start of the step.

    w.v, w.a and w.b change by `slopes` (`NewmarkSlopes`) times the change of position.
    predicted: a compile-time tag after a prediction, None after a Newton increment. If it is None nothing changes.
    active is not used.

    # scratch   w.r
    """
    if predicted is not None:
        copy_rows(lane, model.n, w.q, w.r)
        restore_strains(lane, model, w.q0, w.r)
        move_prediction(lane, model, w, w.r, slopes)
