"""What is read off a chain in space: energies, ports, the power of damping; and how its coordinates are moved."""

from __future__ import annotations

from ...compiler import Family, kernel, load, splat, square_root, store
from ..arithmetic import put
from ..layout import SPACE_POSE as SP
from ..model import PAYLOAD_INERTIA, PAYLOAD_MASS
from ..protocol import State
from .chain import SpatialBeam, energy_of, place_at, planted, section_at, three_of, uneven_of
from .element import Place, bow_of, middle, middle_of, rates, scale
from .frame import frame_of
from .framed import frame_damping, frame_energy
from .layout import AXES, E, G, J, L, P, count_of, joint_row
from .moving import vertices_of
from .rotations import (
    back,
    composed,
    cross,
    dot,
    inverse,
    matrix,
    minus,
    plus,
    put_vector,
    rotation_vector,
    shorter,
    times,
    turn_of,
    turned,
    vector,
)


@kernel
def _middle_of(lane, model, element, left, right):
    """Axes of an element's middle, and what its chord has beside e_x and Gamma."""
    turn, bow = turn_of(shorter(composed(inverse(left.p), right.p))), times(left.r, 0.0)
    if model.frames is None:
        bow = bow_of(uneven_of(lane, model, element), turn.psi)
    return matrix(composed(left.p, turn.half)), bow


@kernel
def predict(lane, model, start, q):
    """Places in q anew: from the base's, with the rotations of q and the strains of `start` (see `exact.output`); a
    chord is shorter by the bow that it has there. Exact beams have `settle`."""
    if model.frames is None:
        return
    tip, moved_tip, element = place_at(lane, start, start, 0), place_at(lane, q, q, 0), 0
    for k in range(model.links):
        i = joint_row(model, k) + 1
        left = root_of(lane, model, start, start, k, tip)
        moved_left = root_of(lane, model, q, q, k, moved_tip)
        for _ in range(count_of(model, k)):
            right, after = place_at(lane, start, start, i), place_at(lane, q, q, i)
            axes, bow = _middle_of(lane, model, element, left, right)
            moved_axes, moved_bow = _middle_of(lane, model, element, moved_left, after)
            shorter_by = times(minus(bow, moved_bow), splat(lane, model.sections[E.end * element + E.length]))
            inner = minus(back(axes, minus(right.r, left.r)), shorter_by)
            r = plus(moved_left.r, turned(moved_axes, inner))
            put_vector(q, i, r)
            left, moved_left = right, Place(r, after.v, after.p, after.spin)
            i += AXES
            element += 1
        tip, moved_tip = left, moved_left


@kernel
def _element_energy(lane, model, par, left, right, element):
    """(kinetic, strain, gravity), J, of an element of the exact beam."""
    section = section_at(lane, model, par, element)
    gamma, bent = middle(section, left, right)[0]
    stretch = dot(gamma, scale(gamma, section.stretch)) * section.length
    strain = (stretch + dot(bent, scale(bent, section.bend)) / section.length) * 0.5
    masses, gravity = three_of(lane, model.sections, E.end * element + E.mass), splat(lane, 0.0)
    r, rate = middle_of(section.length, left, right)
    kinetic = dot(rate, rate) * (0.5 * masses[1])
    if model.gravity is not None:
        gravity = gravity - dot(three_of(lane, model.gravity, 0), r) * masses[1]
    I = three_of(lane, model.sections, E.end * element + E.inertia)
    for end, own in ((left, masses[0]), (right, masses[2])):
        kinetic = kinetic + (dot(end.v, end.v) * own + dot(end.spin, scale(end.spin, I))) * 0.5
        if model.gravity is not None:
            gravity = gravity - dot(three_of(lane, model.gravity, 0), end.r) * own
    return kinetic, strain, gravity


@kernel
def energy(lane, model, par, q, v):
    """(kinetic, strain, gravity), J."""
    tip, element = place_at(lane, q, v, 0), 0
    kinetic, strain, gravity = splat(lane, 0.0), splat(lane, 0.0), splat(lane, 0.0)
    for k in range(model.links):
        at, i = J.end * k, joint_row(model, k) + 1
        if k > 0:
            mass = splat(lane, model.joints[at + J.near + P.mass])
            more, fall = energy_of(lane, model, model.joints, at + J.near, mass, None, tip)
            kinetic, gravity = kinetic + more, gravity + fall
        left = root_of(lane, model, q, v, k, tip)
        mass = splat(lane, model.joints[at + J.far + P.mass])
        more, fall = energy_of(lane, model, model.joints, at + J.far, mass, None, left)
        kinetic, gravity = kinetic + more, gravity + fall
        for _ in range(count_of(model, k)):
            right = place_at(lane, q, v, i)
            if model.frames is None:
                more, bent, fall = _element_energy(lane, model, par, left, right, element)
            else:
                more, bent, fall = frame_energy(lane, model, par, q, v, left, right, element)
            kinetic, strain, gravity = kinetic + more, strain + bent, gravity + fall
            left = right
            i += AXES
            element += 1
        tip = left
    more, fall = energy_of(lane, model, model.end, 0, splat(lane, model.end[P.mass]), None, tip)
    kinetic, gravity = kinetic + more, gravity + fall
    mass, share = load(lane, par, PAYLOAD_MASS), load(lane, par, PAYLOAD_INERTIA)
    more, fall = energy_of(lane, model, model.payload, 0, mass, share, tip)
    return kinetic + more, strain, gravity + fall


@kernel
def damping_work(lane, model, par, q, v, x):
    """x'C(q) v of the material, W."""
    total = splat(lane, 0.0)
    if model.damped is None:
        return total
    at, element = State(q, v, x), 0
    tip_v, tip_x = place_at(lane, q, v, 0), place_at(lane, q, x, 0)
    for k in range(model.links):
        i = joint_row(model, k) + 1
        tip_v, tip_x = root_of(lane, model, q, v, k, tip_v), root_of(lane, model, q, x, k, tip_x)
        for _ in range(count_of(model, k)):
            section = section_at(lane, model, par, element)
            right_v, right_x = place_at(lane, q, v, i), place_at(lane, q, x, i)
            if model.frames is None:
                stretch, bend = rates(section, tip_v, right_v)
                of_stretch, of_bend = rates(section, tip_x, right_x)
                power = dot(of_stretch, scale(stretch, section.stretch)) * section.length
                power = power + dot(of_bend, scale(bend, section.bend)) / section.length
            else:
                power = frame_damping(lane, model, par, at, tip_v, right_v, tip_x, right_x, element)
            total = total + power * section.tau
            tip_v, tip_x = right_v, right_x
            i += AXES
            element += 1
    return total


SECTIONS = Family("model")
last_section = SECTIONS.function("last_section", "lane, model, q, v, k, root")
"""The `Place` of link k's last section, root: of its first; by what coordinates its class has."""


@kernel
def _last_vertex(lane, model, q, v, k, root):
    """Sections are coordinates."""
    if count_of(model, k) > 0:
        return place_at(lane, q, v, joint_row(model, k) + 1 + AXES * (count_of(model, k) - 1))
    return root


SECTIONS.register(SpatialBeam, last_section=_last_vertex)


@kernel
def root_of(lane, model, q, v, k, tip):
    """The `Place` of the root of link k on the section before."""
    return planted(lane, model, q, v, k, tip)[2]


@kernel
def _loaded_place(lane, model, q, v, link, at_tip):
    """The section that a load works on."""
    tip = place_at(lane, q, v, 0)
    root = tip
    for k in range(link + 1):
        root = root_of(lane, model, q, v, k, tip)
        tip = last_section(lane, model, q, v, k, root)
    return tip if at_tip else root


@kernel
def _bent_ends(model, left, right):
    """Rotation vectors of an element's ends: against its middle, or against its frame."""
    if model.frames is None:
        half = times(rotation_vector(shorter(composed(inverse(left.p), right.p))), 0.5)
        return times(half, -1.0), half
    frame = frame_of(left, right)
    return frame.left.phi, frame.right.phi


@kernel
def gauge(lane, model, q, row):
    """See `protocol`."""
    k, e, axis = int(row[G.link]), int(row[G.element]), int(row[G.axis])
    i, total = joint_row(model, k) + 1 + AXES * e, splat(lane, -row[G.rest])
    left = _loaded_place(lane, model, q, q, k, False) if e == 0 else place_at(lane, q, q, i - AXES)
    for j in range(min(2, count_of(model, k) - e)):
        right = place_at(lane, q, q, i)
        a, b = _bent_ends(model, left, right)
        o = G.near + 2 * j
        total = total + a[axis] * row[o] + b[axis] * row[o + 1]
        left = right
        i += AXES
    return total


@kernel
def ports(lane, model, par, q, y):
    """Joint angles, then of each load the position of its point and the rotation of its section, as a vector."""
    for k in range(model.links):
        store(y, k, load(lane, q, joint_row(model, k)))
    if model.loads is not None:
        for f in range(model.loads.shape[0] // L.end):
            first, j = L.end * f, model.links + AXES * f
            place = _loaded_place(
                lane, model, q, q, int(model.loads[first + L.link]), model.loads[first + L.at_tip] != 0.0
            )
            put_vector(y, j, plus(place.r, turned(matrix(place.p), three_of(lane, model.loads, first + L.lever))))
            put_vector(y, j + 3, rotation_vector(shorter(place.p)))


@kernel
def ports_after(lane, model, par, start, y0, q, y):
    """`ports`, but rotations are those before (y0) and what was turned by since, about inertial axes: what moments work
    on. Rotations do not add up otherwise. The vectors in y0 that count are those of the state `start`."""
    ports(lane, model, par, q, y)
    if model.loads is not None:
        for f in range(model.loads.shape[0] // L.end):
            first, j = L.end * f, model.links + AXES * f
            link, at_tip = int(model.loads[first + L.link]), model.loads[first + L.at_tip] != 0.0
            before = _loaded_place(lane, model, start, start, link, at_tip)
            after = _loaded_place(lane, model, q, q, link, at_tip)
            turn = rotation_vector(shorter(composed(after.p, inverse(before.p))))
            put_vector(y, j + 3, plus(vector(lane, y0, j + 3), turn))


@kernel
def _tip_lever(model, k):
    """How far the tip of link k is beyond its last section, m, along x."""
    if k + 1 < model.links:
        return model.joints[J.end * (k + 1) + J.before]
    return 2.0 * model.end[P.centre]  # of a rigid end, whose centre is in its middle


@kernel
def put_pose(lane, model, k, q, v, root, tip, out):
    """The `SPACE_POSE` of link k between the `Place`s of its root and of its last section."""
    o, row, frame = SP.end * k, joint_row(model, k), matrix(root.p)
    A, lever = matrix(tip.p), (splat(lane, _tip_lever(model, k)), splat(lane, 0.0), splat(lane, 0.0))
    r, rate = plus(tip.r, turned(A, lever)), plus(tip.v, turned(A, cross(tip.spin, lever)))
    inner = back(frame, minus(r, root.r))
    slip = minus(back(frame, minus(rate, root.v)), cross(root.spin, inner))
    relative = turn_of(shorter(composed(inverse(root.p), tip.p)))
    psi, T = relative.psi, relative.T
    turn = minus(turned(T, tip.spin), back(T, root.spin))
    for values, to in ((inner, SP.deflection), (slip, SP.deflection_rate)):
        store(out, o + to, values[1])
        store(out, o + to + 1, values[2])
    for value, to in ((load(lane, q, row), SP.angle), (load(lane, v, row), SP.rate), (psi[0], SP.twist)):
        store(out, o + to, value)
    store(out, o + SP.twist_rate, turn[0])
    put_vector(out, o + SP.tip, r)
    put_vector(out, o + SP.velocity, rate)
    for a in range(3):
        put_vector(out, o + SP.axes + 3 * a, frame[a])
    put_vector(out, o + SP.turn, rotation_vector(shorter(tip.p)))
    put_vector(out, o + SP.spin, tip.spin)


@kernel
def task_poses(lane, model, par, q, v, out):
    """A `SPACE_POSES` a link."""
    tip = place_at(lane, q, v, 0)
    for k in range(model.links):
        root = root_of(lane, model, q, v, k, tip)
        tip = last_section(lane, model, q, v, k, root)
        put_pose(lane, model, k, q, v, root, tip, out)


@kernel
def _put_pair(lane, live, rows, i, first, second):
    """Two vectors into the rows from i on, where `live` > 1/2."""
    for a in range(3):
        put(live, rows, i + a, first[a], load(lane, rows, i + a))
        put(live, rows, i + 3 + a, second[a], load(lane, rows, i + 3 + a))


@kernel
def stand(lane, model, live, angles, rates, q, v):
    """See `protocol`; links are straight."""
    tip, element = place_at(lane, q, v, 0), 0
    for k in range(model.links):
        i = joint_row(model, k)
        put(live, q, i, load(lane, angles, k), load(lane, q, i))
        if rates is not None:
            put(live, v, i, load(lane, rates, i), load(lane, v, i))
        root = root_of(lane, model, q, v, k, tip)
        A, along, tip, i = matrix(root.p), splat(lane, 0.0), root, i + 1
        for _ in range(vertices_of(model, k)):
            slip, turn = root.v, root.spin
            if count_of(model, k) > 0:
                along = along + model.sections[E.end * element + E.length]
                element += 1
                if rates is not None:
                    inner = cross(root.spin, (along, along * 0.0, along * 0.0))
                    slip = plus(slip, turned(A, plus(inner, vector(lane, rates, i))))
                    turn = plus(turn, vector(lane, rates, i + 3))
            tip = Place(plus(root.r, times((A[0][0], A[1][0], A[2][0]), along)), slip, root.p, turn)
            _put_pair(lane, live, q, i, tip.r, rotation_vector(shorter(tip.p)))
            if rates is not None:
                _put_pair(lane, live, v, i, tip.v, tip.spin)
            i += AXES
    for j in range(joint_row(model, model.links), model.n):
        put(live, q, j, splat(lane, 0.0), load(lane, q, j))
        if rates is not None:
            put(live, v, j, load(lane, rates, j), load(lane, v, j))


@kernel
def link_poses(lane, model, par, q, v, out):
    """Nothing: poses in space are read off the coordinates (`space.reading`)."""


@kernel
def light(model):
    """See `protocol`: elements' ends turn by their sections' rotary inertia alone."""
    return (0,)


STATIONS = 4
"""Points that are drawn of an element, or of a rigid link."""


@kernel
def _drawn(points, count, r):
    """Row `count` of the points <- r, where there is room; how many there are then."""
    if count == points.shape[0]:
        return count
    for d in range(3):
        points[count, d] = r[d]
    return count + 1


@kernel
def _cubic(left, right, s):
    """A place between sections, on the cubic that leaves one and reaches the other along their x axes."""
    A, B, chord = matrix(left.p), matrix(right.p), minus(right.r, left.r)
    length = square_root(dot(chord, chord))
    a, b, c, d = (2.0 * s - 3.0) * s * s + 1.0, ((s - 2.0) * s + 1.0) * s, (3.0 - 2.0 * s) * s * s, (s - 1.0) * s * s
    ends = plus(times(left.r, a), times(right.r, c))
    leaving, reaching = (A[0][0], A[1][0], A[2][0]), (B[0][0], B[1][0], B[2][0])
    return plus(ends, plus(times(leaving, b * length), times(reaching, d * length)))


@kernel
def shape(model, q, points):
    """Places along the chain into points (P, 3): the base, then of each link its beginning, STATIONS of each element
    or of a rigid link, its tip; their number. None where points have two numbers: they are read off elsewhere."""
    if points.shape[1] < 3:
        return 0
    lane = (0,)
    tip = place_at(lane, q, q, 0)
    count = _drawn(points, 0, tip.r)
    for k in range(model.links):
        i = joint_row(model, k) + 1
        left = root_of(lane, model, q, q, k, tip)
        count = _drawn(points, count, left.r)
        for _ in range(count_of(model, k)):
            right = place_at(lane, q, q, i)
            for j in range(1, STATIONS + 1):
                count = _drawn(points, count, _cubic(left, right, j / STATIONS))
            left = right
            i += AXES
        tip, A = left, matrix(left.p)
        along = times((A[0][0], A[1][0], A[2][0]), _tip_lever(model, k))
        if count_of(model, k) == 0:
            for j in range(1, STATIONS):
                count = _drawn(points, count, plus(tip.r, times(along, j / STATIONS)))
        count = _drawn(points, count, plus(tip.r, along))
    return count
