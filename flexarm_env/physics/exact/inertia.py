"""Kernels of the period correction (theory, 6.2) for chains of exact beams: M a, rotated accelerations."""

from ...compiler import Lanes, kernel
from ..arithmetic import load_vector, store_vector
from ..model import PAYLOAD_INERTIA, PAYLOAD_MASS
from .element import momentum, rotate_by_small_angle
from .layout import AXES, T, elbow_of, next_section, rows_of, section_of


@kernel
def inertia_forces(lane, model, par: Lanes, turn, a: Lanes, r: Lanes):
    """Rotate the accelerations a by `turn`, then compute the inertia forces r <- M a (unless r is None).

    M is the constant mass matrix.
    turn: None, or (start, q, share). Each node's vector is then rotated by `share` times the rotation of the node's
    section from coordinates start to q.
    a: accelerations in the rows of CHAIN (m/s^2, inertial axes; rad/s^2).
    r: forces (N) and moments (N m) in the same rows. The model has no rigid ends, because models with rigid ends have
    no period correction.
    """
    if turn is not None:
        rotate_vectors(lane, model, turn[0], turn[1], turn[2], a)
    if r is not None:
        _multiply_mass(lane, model, par, a, r)


@kernel
def _multiply_mass(lane, model, par: Lanes, a: Lanes, r: Lanes):
    """Compute r <- M a with the mass matrix of elements, hub, elbows and payload.

    a: accelerations in the rows of CHAIN (m/s^2, inertial axes; rad/s^2).
    r: forces (N) and moments (N m) in the same rows.
    par: contains the payload's mass (kg) and inertia (kg m^2). See docs/theory.md, (6.2).
    """
    rows, zero = rows_of(model), 0.0
    # left: (a_x, a_y, a_psi) of the current vertex and the rows of r that it has so far
    x, y, psi = load_vector(lane, a, 0)
    left = (x, y, psi, zero, zero, psi * model.hub_inertia)
    i = rows.elements
    for k in range(model.links):
        root, before, d = i + T, zero, rows.hinges + k - 1
        if k > 0:
            # through the hinge: the section behind it turns by psi + delta, forces are transmitted, no moment
            x, y, psi, fx, fy, moment = left
            elbow = elbow_of(model, k)
            before = moment + psi * elbow.left
            psi = psi + a[d]
            left = (x, y, psi, fx + x * elbow.mass, fy + y * elbow.mass, psi * elbow.right)
        section = section_of(lane, model, par, k)
        for _ in range(model.elements):
            j = i
            left = momentum(lane, model.order, a[j:], left, section, r[j:])
            i += AXES * len(model.order)
            section = next_section(model, section)
        # moment on psi + delta: by virtual work on the rows of psi and of delta
        if k > 0:
            moment = r[root]
            r[root] = before + moment
            r[d] = moment
    x, y, psi, fx, fy, moment = left
    mass = par[PAYLOAD_MASS]
    store_vector(lane, r, i, (fx + x * mass, fy + y * mass, moment + psi * par[PAYLOAD_INERTIA]))


@kernel
def rotate_vectors(lane, model, start: Lanes, q: Lanes, share, x: Lanes):
    """Rotate each node's vector (x, y; inertial axes) in x by `share` times its section's rotation from start to q.

    start and q are coordinates; the angles psi (rad) of both must differ little. Interior amplitudes are rotated by the
    mean rotation of both vertices. See docs/theory.md, (6.2).
    """
    order, p, rows = model.order, len(model.order), rows_of(model)
    i = rows.elements
    left = q[i + T] - start[i + T]
    rotate_by_small_angle(lane, order, x, left * share)
    for k in range(model.links):
        if k > 0:
            d = rows.hinges + k - 1
            left = left + (q[d] - start[d])
        for _ in range(model.elements):
            last = i + AXES * p
            right = q[last + T] - start[last + T]
            # (a_x, a_y) of the interior nodes and the right vertex, turned by share times their section's rotation in
            # the step
            for j in range(1, p):
                rotate_by_small_angle(lane, order, x[i + AXES * j :], (left + right) * (0.5 * share))
            rotate_by_small_angle(lane, order, x[last:], right * share)
            left = right
            i = last
