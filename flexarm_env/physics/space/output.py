"""Outputs of a chain in space: energies, momentum, damping power, input displacements, gauges, poses, drawn points."""

from __future__ import annotations

from ...compiler import Lanes, inlined, kernel, square_root
from ..arithmetic import store_vector, store_where
from ..layout import SPACE_POSE as SP
from ..model import PAYLOAD_INERTIA, PAYLOAD_MASS
from ..protocol import State
from .chain import body_sums, joint_placement, place_at
from .element import Place, element_damping, middle, middle_of
from .frame import frame_of
from .framed import frame_damping, frame_damping_over, frame_sums
from .inner import elements_before
from .layout import E, G, J, P, count_of, joint_row, section_at, vertex_row
from .moving import vertices_of
from .rotations import (
    Vector,
    compose,
    cross,
    dot,
    inverse_rotation,
    load_vector,
    matrix,
    rotation_vector,
    scale,
    shortest_rotation,
    three_of,
    turn_of,
)
from .strained import last_place, point_of, strained_damping, strained_sums


@kernel
def _middle_of(left, right):
    """Return the rotation matrix (section to inertial axes) of the middle section between two `Place`s."""
    return matrix(compose(left.p, turn_of(shortest_rotation(compose(inverse_rotation(left.p), right.p))).half))


@kernel
def restore_chords(lane, model, start, q):
    """Recompute the positions of vertices in q from root to tip, so that segments have the same chords as in `start`.

    The function changes nothing unless segments have floating frames. Rotations in q do not change. In the axes of a
    segment's middle section, the chord's components are those in `start`."""
    if model.frames is None:
        return
    tip, moved_tip = place_at(lane, start, start, 0), place_at(lane, q, q, 0)
    for k in range(model.links):
        left = root_of(lane, model, start, start, k, tip)
        moved_left = root_of(lane, model, q, q, k, moved_tip)
        for e in range(count_of(model, k)):
            i = vertex_row(model, k, e)
            right, after = place_at(lane, start, start, i), place_at(lane, q, q, i)
            # chord R^T (r_r - r_l) of the start, in the middle's axes, which the new middle R turns
            inner = _middle_of(left, right).T @ (right.r - left.r)
            r = moved_left.r + _middle_of(moved_left, after) @ inner
            store_vector(lane, q, i, r)
            left, moved_left = right, Place(r, after.v, after.p, after.spin)
        tip, moved_tip = left, moved_left


@inlined
def _element_sums(lane, model, par, left, right, element):
    """Return ((kinetic, strain, gravitational) energy in J, momentum in kg m/s, inertial axes) of an exact element.

    left, right: `Place` (position, rotation, rates) of each end. element: index over all links. See theory, (9.2)."""
    # inlined: each step of a free arm needs the momentum alone, and unused energies are then not compiled
    section = section_at(lane, model, par, element)
    gamma, bent = middle(section, left, right)[0]
    stretch = dot(gamma, scale(gamma, section.stretch)) * section.length
    strain = (stretch + dot(bent, scale(bent, section.EI)) / section.length) * 0.5
    # Simpson's rule: 4/6 m at the middle, m and J (section axes) at the ends
    masses, gravity = three_of(lane, model.sections, E.end * element + E.mass), 0.0
    r, rate = middle_of(section.length, left, right)
    kinetic, push = dot(rate, rate) * (0.5 * masses[1]), masses[1] * rate
    if model.gravity is not None:
        gravity = gravity - dot(three_of(lane, model.gravity, 0), r) * masses[1]
    I = three_of(lane, model.sections, E.end * element + E.inertia)
    for end, own in ((left, masses[0]), (right, masses[2])):
        kinetic = kinetic + (dot(end.v, end.v) * own + dot(end.spin, scale(end.spin, I))) * 0.5
        push = push + own * end.v
        if model.gravity is not None:
            gravity = gravity - dot(three_of(lane, model.gravity, 0), end.r) * own
    return (kinetic, strain, gravity), push


@kernel
def energy(lane, model, par, q, v):
    """Return (kinetic, strain, gravitational) energy in J of the whole arm (`protocol.energy`)."""
    return _sums(lane, model, par, q, v)[0]


@kernel
def momentum(lane, model, par, q, v):
    """Return the total linear momentum (kg m/s, inertial axes) of the arm."""
    return _sums(lane, model, par, q, v)[1]


@inlined
def _sums(lane, model, par: Lanes, q, v):
    """Return ((kinetic, strain, gravitational) energy in J, momentum in kg m/s, inertial axes) of the whole arm."""
    tip, zero = place_at(lane, q, v, 0), 0.0
    total = Vector(zero, zero, zero), Vector(zero, zero, zero)
    for k in range(model.links):
        if k > 0:
            total = add_vector_pairs(total, body_sums(lane, model, model.joints, J.end * k + J.near, None, None, tip))
        root = root_of(lane, model, q, v, k, tip)
        total = add_vector_pairs(total, body_sums(lane, model, model.joints, J.end * k + J.far, None, None, root))
        total = _sums_along(lane, model, par, k, q, v, root, total)
        tip = last_section(lane, model, q, v, k, root)
    total = add_vector_pairs(total, body_sums(lane, model, model.end, 0, None, None, tip))
    mass, share = par[PAYLOAD_MASS], par[PAYLOAD_INERTIA]
    return add_vector_pairs(total, body_sums(lane, model, model.payload, 0, mass, share, tip))


@kernel
def add_vector_pairs(a, b):
    """Return the sum of two pairs of vectors, such as (force, moment)."""
    return a[0] + b[0], a[1] + b[1]


@inlined
def _sums_along(lane, model, par, k, q, v, root, total):
    """Return `total` plus the energies (J) and momentum (kg m/s) of link k. root: `Place` of its first section."""
    if model.strains is not None:
        if count_of(model, k) > 0:
            total = add_vector_pairs(total, strained_sums(lane, model, par, k, q, v, root))
        return total
    left, first = root, elements_before(model, k)
    for e in range(count_of(model, k)):
        right = place_at(lane, q, v, vertex_row(model, k, e))
        if model.frames is None:
            total = add_vector_pairs(total, _element_sums(lane, model, par, left, right, first + e))
        else:
            total = add_vector_pairs(total, frame_sums(lane, model, par, q, v, left, right, first + e))
        left = right
    return total


@kernel
def damping_power(lane, model, par, q, v, x, since=None):
    """Return x^T C(q) v in W: the power of the material's damping forces C v (N, N m) at the virtual rates x.

    If since = (start, v0, h), return the mean power over a step of h (s) from start, v0 to q, v, and its unresolved
    part."""
    if since is not None:
        return _mean_damping_power(lane, model, par, since[0], since[1], q, v, since[2])
    total = 0.0
    if model.damped is None:
        return total
    if model.strains is not None:
        for k in range(model.links):
            if count_of(model, k) > 0:
                total = total + strained_damping(lane, model, par, k, v, x)
        return total
    at = State(q, v, x)
    # Gamma', kappa' (section axes) at the rates v and at x
    tip_v, tip_x = place_at(lane, q, v, 0), place_at(lane, q, x, 0)
    for k in range(model.links):
        tip_v, tip_x = root_of(lane, model, q, v, k, tip_v), root_of(lane, model, q, x, k, tip_x)
        first = elements_before(model, k)
        for e in range(count_of(model, k)):
            i, section = vertex_row(model, k, e), section_at(lane, model, par, first + e)
            right_v, right_x = place_at(lane, q, v, i), place_at(lane, q, x, i)
            if model.frames is None:
                stretch, bend = middle(section, tip_v, right_v)[2]
                by_stretch, by_bend = middle(section, tip_x, right_x)[2]
                power = dot(by_stretch, scale(stretch, section.stretch)) * section.length
                power = power + dot(by_bend, scale(bend, section.EI)) / section.length
            else:
                power = frame_damping(lane, model, par, at, tip_v, right_v, tip_x, right_x, first + e)
            total = total + power * section.tau
            tip_v, tip_x = right_v, right_x
    return total


@kernel
def _mean_damping_power(lane, model, par, start, v0, end, v, h):
    """Return the power (W) at the mean strain rates of a step, and the unresolved power (W) or None.

    start, v0, end, v: coordinates and rates at the start and the end of a step of h (s). The power is tau_d D ((end
    strain - start strain) / h)^2. Unresolved power: see `element_damping`, `protocol.damping_power`. Mean coordinate
    rates would be wrong: an element that rotates by d along straight paths is stretched by d^2/8 at mid-step, against
    EA."""
    total, beyond = 0.0, 0.0
    if model.damped is None:
        return total, None
    old, new, share = place_at(lane, start, v0, 0), place_at(lane, end, v, 0), 1.0 / h
    for k in range(model.links):
        old, new = root_of(lane, model, start, v0, k, old), root_of(lane, model, end, v, k, new)
        first = elements_before(model, k)
        for e in range(count_of(model, k)):
            i, section = vertex_row(model, k, e), section_at(lane, model, par, first + e)
            right_old, right_new = place_at(lane, start, v0, i), place_at(lane, end, v, i)
            if model.frames is None:
                # dissipated: tau_d D ((strain_1 - strain_0) / h)^2; more: mean power of both ends less that
                power, more = element_damping(section, (old, right_old), (new, right_new), share)
            else:
                before, after = (start, v0, old, right_old), (end, v, new, right_new)
                power, more = frame_damping_over(lane, model, par, before, after, share, first + e)
            total, beyond = total + power * section.tau, beyond + more * section.tau
            old, new = right_old, right_new
    return total, beyond


@kernel
def last_section(lane, model, q, v, k, root):
    """Return the `Place` of link k's last section. root: `Place` of its first section. Pass q for v to ignore rates."""
    if count_of(model, k) == 0:
        return root
    if model.strains is not None:
        return last_place(lane, model, k, q, v, root)
    return place_at(lane, q, v, vertex_row(model, k, count_of(model, k) - 1))


@kernel
def root_of(lane, model, q, v, k, tip):
    """Return the `Place` of the first section of link k, from the `Place` tip of the section before its joint."""
    return joint_placement(lane, model, q, v, k, tip)[2]


@kernel
def section_of_end(lane, model, q, v, link, at_tip):
    """Return the `Place` of a link's last section if at_tip, otherwise of its first section. For v see `place_at`."""
    tip = place_at(lane, q, v, 0)
    root = tip
    for k in range(link + 1):
        root = root_of(lane, model, q, v, k, tip)
        tip = last_section(lane, model, q, v, k, root)
    if at_tip:
        root = tip
    return root


@kernel
def _bent_ends(model, left, right):
    """Return the ends' rotation vectors (rad) relative to the element's middle or the segment's frame, in its axes."""
    if model.frames is None:
        # ends turn by -psi/2 and psi/2 against the middle (section axes)
        half = 0.5 * rotation_vector(shortest_rotation(compose(inverse_rotation(left.p), right.p)))
        return -half, half
    frame = frame_of(left, right)
    return frame.left.phi, frame.right.phi


@kernel
def strain_gauge(lane, model, q, row):
    """Return a gauge's reading (1/m): weighted end rotations of two elements, minus the stress-free reading."""
    k, e, axis = int(row[G.link]), int(row[G.element]), int(row[G.axis])
    total = -row[G.rest]
    left = section_of_end(lane, model, q, q, k, False) if e == 0 else place_at(lane, q, q, vertex_row(model, k, e - 1))
    for j in range(min(2, count_of(model, k) - e)):
        right = place_at(lane, q, q, vertex_row(model, k, e + j))
        a, b = _bent_ends(model, left, right)
        o = G.near + 2 * j
        total = total + a[axis] * row[o] + b[axis] * row[o + 1]
        left = right
    return total


@kernel
def _tip_lever(model, k):
    """Return the distance (m) from the last section of link k to its tip, along the section's x axis."""
    if k + 1 < model.links:
        return model.joints[J.end * (k + 1) + J.before]
    return 2.0 * model.end[P.centre]  # a rigid end's center of mass is in its middle


@kernel
def put_pose(lane, model, k, q: Lanes, v: Lanes, root, tip, out: Lanes):
    """Store the `SPACE_POSE` of link k in `out`. root, tip: `Place`s of the link's first and last section."""
    o, row, frame = SP.end * k, joint_row(model, k), matrix(root.p)
    A, lever = matrix(tip.p), Vector(_tip_lever(model, k), 0.0, 0.0)
    # r + A t, v + A (w x t): from the last section along the rigid end (inertial axes)
    r, rate = tip.r + A @ lever, tip.v + A @ cross(tip.spin, lever)
    # deflection and twist in root axes, with rates relative to it; below: r, A of the tip inertial, w in section axes
    inner = frame.T @ (r - root.r)
    slip = frame.T @ (rate - root.v) - cross(root.spin, inner)
    relative = turn_of(shortest_rotation(compose(inverse_rotation(root.p), tip.p)))
    psi, T = relative.psi, relative.T
    turn = T @ tip.spin - T.T @ root.spin
    for values, to in ((inner, SP.deflection), (slip, SP.deflection_rate)):
        out[o + to] = values[1]
        out[o + to + 1] = values[2]
    for value, to in ((q[row], SP.angle), (v[row], SP.rate), (psi[0], SP.twist)):
        out[o + to] = value
    out[o + SP.twist_rate] = turn[0]
    store_vector(lane, out, o + SP.tip, r)
    store_vector(lane, out, o + SP.velocity, rate)
    for a in range(3):
        store_vector(lane, out, o + SP.axes + 3 * a, frame[a])
    store_vector(lane, out, o + SP.turn, rotation_vector(shortest_rotation(tip.p)))
    store_vector(lane, out, o + SP.spin, tip.spin)


@kernel
def link_poses(lane, model, par, q, v, out, tasks=None):
    """Store the `SPACE_POSE` of each link in out; if tasks is None, do nothing (`space.reading` then reads q and v)."""
    if tasks is not None:
        tip = place_at(lane, q, v, 0)
        for k in range(model.links):
            root = root_of(lane, model, q, v, k, tip)
            tip = last_section(lane, model, q, v, k, root)
            put_pose(lane, model, k, q, v, root, tip, out)


@kernel
def _put_pair(lane, live, rows: Lanes, i, first, second):
    """Store two vectors in the six rows from row i on, in the lanes in which `live` is above 1/2."""
    for a in range(3):
        store_where(lane, live, rows, i + a, first[a], rows[i + a])
        store_where(lane, live, rows, i + 3 + a, second[a], rows[i + 3 + a])


@kernel
def _put_unbent(lane, live, rates: Lanes | None, q: Lanes, v: Lanes, first, end):
    """In lanes with `live` > 1/2, set rows first ... end - 1 of q to zero, and of v to `rates` (None: unchanged)."""
    for j in range(first, end):
        store_where(lane, live, q, j, 0.0, q[j])
        if rates is not None:
            store_where(lane, live, v, j, rates[j], v[j])


@kernel
def set_joint_configuration(lane, model, live, angles: Lanes, rates: Lanes | None, q: Lanes, v: Lanes):
    """Set q to straight links at joint angles (links,), rad, and v to `rates`, in lanes with `live` above 1/2.

    rates: joint rates, and rates of vertices relative to their rotating link (link axes), in the rows of v; None keeps
    v."""
    tip, element = place_at(lane, q, v, 0), 0
    for k in range(model.links):
        i = joint_row(model, k)
        store_where(lane, live, q, i, angles[k], q[i])
        if rates is not None:
            store_where(lane, live, v, i, rates[i], v[i])
        if model.strains is not None:
            _put_unbent(lane, live, rates, q, v, i + 1, joint_row(model, k + 1))
            continue
        root = root_of(lane, model, q, v, k, tip)
        A, along, tip = matrix(root.p), 0.0, root
        for e in range(vertices_of(model, k)):
            i = vertex_row(model, k, e)
            # v = v_root + w x r + rates, with w, r in root axes
            slip, turn = root.v, root.spin
            if count_of(model, k) > 0:
                along = along + model.sections[E.end * element + E.length]
                element += 1
                if rates is not None:
                    inner = cross(root.spin, Vector(along, along * 0.0, along * 0.0))
                    slip = slip + A @ (inner + load_vector(lane, rates, i))
                    turn = turn + load_vector(lane, rates, i + 3)
            tip = Place(root.r + along * A.T[0], slip, root.p, turn)
            _put_pair(lane, live, q, i, tip.r, rotation_vector(shortest_rotation(tip.p)))
            if rates is not None:
                _put_pair(lane, live, v, i, tip.v, tip.spin)
    _put_unbent(lane, live, rates, q, v, joint_row(model, model.links), model.n)


STATIONS = 4
"""Number of points that are drawn for an element or for a rigid link."""


@kernel
def _drawn(lane, points, count, r):
    """Store the position r (m) in row `count` of points if there is room; return the new number of points."""
    if count == points.shape[0]:
        return count
    store_vector(lane, points[count], 0, r)
    return count + 1


@kernel
def _cubic(left, right, s):
    """Return the point (m) at s in [0, 1] of the cubic curve from `left` to `right` that is tangent to both x axes."""
    A, B, chord = matrix(left.p), matrix(right.p), right.r - left.r
    length = square_root(dot(chord, chord))
    # Hermite's polynomials: values and slopes at s = 0 and 1
    a, b, c, d = (2.0 * s - 3.0) * s * s + 1.0, ((s - 2.0) * s + 1.0) * s, (3.0 - 2.0 * s) * s * s, (s - 1.0) * s * s
    ends = a * left.r + c * right.r
    leaving, reaching = A.T[0], B.T[0]
    return ends + (b * length * leaving + d * length * reaching)


@kernel
def centerline(lane, model, q, points):
    """Store points of the centerline (m, inertial axes) in `points`, from base to tip; return their number.

    points (P, lanes of 3 numbers); with less room nothing is written.
    """
    # a planar arm's centerline is drawn by the planar formulation
    if points.shape[1] < 3 * len(lane):
        return 0
    tip = place_at(lane, q, q, 0)
    count = _drawn(lane, points, 0, tip.r)
    for k in range(model.links):
        root = root_of(lane, model, q, q, k, tip)
        count = _draw(lane, model, k, q, root, points, _drawn(lane, points, count, root.r))
        tip = last_section(lane, model, q, q, k, root)
        A = matrix(tip.p)
        along = _tip_lever(model, k) * A.T[0]
        if count_of(model, k) == 0:
            for j in range(1, STATIONS):
                count = _drawn(lane, points, count, tip.r + j / STATIONS * along)
        count = _drawn(lane, points, count, tip.r + along)
    return count


@kernel
def _draw(lane, model, k, q, root, points, count):
    """Store STATIONS points per element of link k, or its Gauss points if q has strains; return the new count."""
    if model.strains is not None:
        if count_of(model, k) > 0:
            for j in range(len(model.points)):
                count = _drawn(lane, points, count, point_of(lane, model, k, j, q, root))
        return count
    left = root
    for e in range(count_of(model, k)):
        right = place_at(lane, q, q, vertex_row(model, k, e))
        for j in range(1, STATIONS + 1):
            count = _drawn(lane, points, count, _cubic(left, right, j / STATIONS))
        left = right
    return count
