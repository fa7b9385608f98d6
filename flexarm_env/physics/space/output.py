"""What is read off a chain in space: energies, ports, the power of damping; and how its coordinates are moved."""

from __future__ import annotations

from ...compiler import inlined, kernel, load, splat, square_root, store
from ..arithmetic import put, put_vector, vector
from ..layout import SPACE_POSE as SP
from ..model import PAYLOAD_INERTIA, PAYLOAD_MASS
from ..protocol import State
from .chain import place_at, planted, section_at, sums_of, three_of
from .element import Place, middle, middle_of, scale
from .frame import frame_of
from .framed import frame_damping, frame_sums
from .inner import elements_before
from .layout import AXES, E, G, J, L, P, count_of, joint_row, vertex_row
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
    rotation_vector,
    shorter,
    times,
    turn_of,
    turned,
)
from .strained import last_place, point_of, strained_damping, strained_sums


@kernel
def _middle_of(left, right):
    """Axes of a segment's middle."""
    return matrix(composed(left.p, turn_of(shorter(composed(inverse(left.p), right.p))).half))


@kernel
def predict(lane, model, start, q):
    """Places in q anew: from the base's, with the rotations of q and the strains of `start` (see `exact.output`). Exact
    beams have `settle`."""
    if model.frames is None:
        return
    tip, moved_tip = place_at(lane, start, start, 0), place_at(lane, q, q, 0)
    for k in range(model.links):
        left = root_of(lane, model, start, start, k, tip)
        moved_left = root_of(lane, model, q, q, k, moved_tip)
        for e in range(count_of(model, k)):
            i = vertex_row(model, k, e)
            right, after = place_at(lane, start, start, i), place_at(lane, q, q, i)
            inner = back(_middle_of(left, right), minus(right.r, left.r))
            r = plus(moved_left.r, turned(_middle_of(moved_left, after), inner))
            put_vector(q, i, r)
            left, moved_left = right, Place(r, after.v, after.p, after.spin)
        tip, moved_tip = left, moved_left


@inlined
def _element_sums(lane, model, par, left, right, element):
    """`sums_of` an element of the exact beam, with the masses of `element.inertia`. Inlined, as those of other links
    are: where momentum alone is asked for, each step of a free arm, the compiler leaves the energies out."""
    section = section_at(lane, model, par, element)
    gamma, bent = middle(section, left, right)[0]
    stretch = dot(gamma, scale(gamma, section.stretch)) * section.length
    strain = (stretch + dot(bent, scale(bent, section.bend)) / section.length) * 0.5
    masses, gravity = three_of(lane, model.sections, E.end * element + E.mass), splat(lane, 0.0)
    r, rate = middle_of(section.length, left, right)
    kinetic, push = dot(rate, rate) * (0.5 * masses[1]), times(rate, masses[1])
    if model.gravity is not None:
        gravity = gravity - dot(three_of(lane, model.gravity, 0), r) * masses[1]
    I = three_of(lane, model.sections, E.end * element + E.inertia)
    for end, own in ((left, masses[0]), (right, masses[2])):
        kinetic = kinetic + (dot(end.v, end.v) * own + dot(end.spin, scale(end.spin, I))) * 0.5
        push = plus(push, times(end.v, own))
        if model.gravity is not None:
            gravity = gravity - dot(three_of(lane, model.gravity, 0), end.r) * own
    return (kinetic, strain, gravity), push


@kernel
def energy(lane, model, par, q, v):
    """(kinetic, strain, gravity), J."""
    return _sums(lane, model, par, q, v)[0]


@kernel
def momentum(lane, model, par, q, v):
    """Of all that moves, along inertial axes."""
    return _sums(lane, model, par, q, v)[1]


@inlined
def _sums(lane, model, par, q, v):
    """`sums_of` all that moves."""
    tip, zero = place_at(lane, q, v, 0), splat(lane, 0.0)
    total = (zero, zero, zero), (zero, zero, zero)
    for k in range(model.links):
        if k > 0:
            total = both(total, sums_of(lane, model, model.joints, J.end * k + J.near, None, None, tip))
        root = root_of(lane, model, q, v, k, tip)
        total = both(total, sums_of(lane, model, model.joints, J.end * k + J.far, None, None, root))
        total = _sums_along(lane, model, par, k, q, v, root, total)
        tip = last_section(lane, model, q, v, k, root)
    total = both(total, sums_of(lane, model, model.end, 0, None, None, tip))
    mass, share = load(lane, par, PAYLOAD_MASS), load(lane, par, PAYLOAD_INERTIA)
    return both(total, sums_of(lane, model, model.payload, 0, mass, share, tip))


@kernel
def both(a, b):
    """The sum of two pairs of vectors."""
    return plus(a[0], b[0]), plus(a[1], b[1])


@inlined
def _sums_along(lane, model, par, k, q, v, root, total):
    """Sums with those of link k."""
    if model.strains is not None:
        if count_of(model, k) > 0:
            total = both(total, strained_sums(lane, model, par, k, q, v, root))
        return total
    left, first = root, elements_before(model, k)
    for e in range(count_of(model, k)):
        right = place_at(lane, q, v, vertex_row(model, k, e))
        if model.frames is None:
            total = both(total, _element_sums(lane, model, par, left, right, first + e))
        else:
            total = both(total, frame_sums(lane, model, par, q, v, left, right, first + e))
        left = right
    return total


@kernel
def damping_work(lane, model, par, q, v, x):
    """x'C(q) v of the material, W."""
    return _damping(lane, model, par, q, v, x, None)


@kernel
def damping_over(lane, model, par, q, v, start, end, x, h):
    """See `protocol`. The places of a step that turns an element by d, straight from one to the other, stretch it by
    d^2/8 at the middle: rates of strain that it has at neither end, times forces of EA. Strains of both ends know
    nothing of that."""
    if model.frames is not None:
        return damping_work(lane, model, par, q, v, x)
    return _damping(lane, model, par, q, v, x, (start, end)) * (1.0 / h)


@kernel
def _damping(lane, model, par, q, v, x, ends):
    """Power of the material's damping at rates v over rates x, or, of exact beams, over what strains change by between
    two ends."""
    total = splat(lane, 0.0)
    if model.damped is None:
        return total
    if model.strains is not None:
        for k in range(model.links):
            if count_of(model, k) > 0:
                total = total + strained_damping(lane, model, par, k, v, x)
        return total
    at = State(q, v, x)
    tip_v, tip_x, old, new = place_at(lane, q, v, 0), place_at(lane, q, x, 0), None, None
    if ends is not None:
        old, new = place_at(lane, ends[0], v, 0), place_at(lane, ends[1], v, 0)
    for k in range(model.links):
        tip_v, tip_x = root_of(lane, model, q, v, k, tip_v), root_of(lane, model, q, x, k, tip_x)
        first = elements_before(model, k)
        if ends is not None:
            old, new = root_of(lane, model, ends[0], v, k, old), root_of(lane, model, ends[1], v, k, new)
        for e in range(count_of(model, k)):
            i, section = vertex_row(model, k, e), section_at(lane, model, par, first + e)
            right_v, right_x = place_at(lane, q, v, i), place_at(lane, q, x, i)
            if model.frames is None:
                stretch, bend = middle(section, tip_v, right_v)[2]
                if ends is None:
                    by_stretch, by_bend = middle(section, tip_x, right_x)[2]
                else:
                    right_old, right_new = place_at(lane, ends[0], v, i), place_at(lane, ends[1], v, i)
                    before, after = middle(section, old, right_old)[0], middle(section, new, right_new)[0]
                    by_stretch, by_bend = minus(after[0], before[0]), minus(after[1], before[1])
                    old, new = right_old, right_new
                power = dot(by_stretch, scale(stretch, section.stretch)) * section.length
                power = power + dot(by_bend, scale(bend, section.bend)) / section.length
            else:
                power = frame_damping(lane, model, par, at, tip_v, right_v, tip_x, right_x, first + e)
            total = total + power * section.tau
            tip_v, tip_x = right_v, right_x
    return total


@kernel
def last_section(lane, model, q, v, k, root):
    """The `Place` of link k's last section, root: of its first."""
    if count_of(model, k) == 0:
        return root
    if model.strains is not None:
        return last_place(lane, model, k, q, v, root)
    return place_at(lane, q, v, vertex_row(model, k, count_of(model, k) - 1))


@kernel
def root_of(lane, model, q, v, k, tip):
    """The `Place` of the root of link k on the section before."""
    return planted(lane, model, q, v, k, tip)[2]


@kernel
def _section_of(lane, model, q, link, at_tip):
    """The last section of a link, or the first."""
    tip = place_at(lane, q, q, 0)
    root = tip
    for k in range(link + 1):
        root = root_of(lane, model, q, q, k, tip)
        tip = last_section(lane, model, q, q, k, root)
    return tip if at_tip else root


@kernel
def _loaded(lane, model, q, f):
    """The section that load f works on."""
    at = L.end * f
    return _section_of(lane, model, q, int(model.loads[at + L.link]), model.loads[at + L.at_tip] != 0.0)


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
    total = splat(lane, -row[G.rest])
    left = _section_of(lane, model, q, k, False) if e == 0 else place_at(lane, q, q, vertex_row(model, k, e - 1))
    for j in range(min(2, count_of(model, k) - e)):
        right = place_at(lane, q, q, vertex_row(model, k, e + j))
        a, b = _bent_ends(model, left, right)
        o = G.near + 2 * j
        total = total + a[axis] * row[o] + b[axis] * row[o + 1]
        left = right
    return total


@kernel
def ports(lane, model, par, q, y):
    """Joint angles, then of each load the position of its point and the rotation of its section, as a vector."""
    for k in range(model.links):
        store(y, k, load(lane, q, joint_row(model, k)))
    if model.loads is not None:
        for f in range(model.loads.shape[0] // L.end):
            place, j = _loaded(lane, model, q, f), model.links + AXES * f
            lever = three_of(lane, model.loads, L.end * f + L.lever)
            put_vector(y, j, plus(place.r, turned(matrix(place.p), lever)))
            put_vector(y, j + 3, rotation_vector(shorter(place.p)))


@kernel
def ports_after(lane, model, par, start, y0, q, y):
    """`ports`, but rotations are those before (y0) and what was turned by since, about inertial axes: what moments work
    on. Rotations do not add up otherwise. The vectors in y0 that count are those of the state `start`."""
    ports(lane, model, par, q, y)
    if model.loads is not None:
        for f in range(model.loads.shape[0] // L.end):
            before, after, j = _loaded(lane, model, start, f), _loaded(lane, model, q, f), model.links + AXES * f + 3
            turn = rotation_vector(shorter(composed(after.p, inverse(before.p))))
            put_vector(y, j, plus(vector(lane, y0, j), turn))


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
def _put_unbent(lane, live, rates, q, v, first, end):
    """Zeros into these rows of q, rates into those of v."""
    for j in range(first, end):
        put(live, q, j, splat(lane, 0.0), load(lane, q, j))
        if rates is not None:
            put(live, v, j, load(lane, rates, j), load(lane, v, j))


@kernel
def stand(lane, model, live, angles, rates, q, v):
    """See `protocol`; links are straight. By strains all rates but the base's are against what comes before."""
    tip, element = place_at(lane, q, v, 0), 0
    for k in range(model.links):
        i = joint_row(model, k)
        put(live, q, i, load(lane, angles, k), load(lane, q, i))
        if rates is not None:
            put(live, v, i, load(lane, rates, i), load(lane, v, i))
        if model.strains is not None:
            _put_unbent(lane, live, rates, q, v, i + 1, joint_row(model, k + 1))
            continue
        root = root_of(lane, model, q, v, k, tip)
        A, along, tip = matrix(root.p), splat(lane, 0.0), root
        for e in range(vertices_of(model, k)):
            i = vertex_row(model, k, e)
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
    _put_unbent(lane, live, rates, q, v, joint_row(model, model.links), model.n)


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
    """Places along the chain into points (P, 3): the base, then of each link its beginning, those along it (of a rigid
    one STATIONS), its tip; their number. None where points have two numbers: they are read off elsewhere."""
    if points.shape[1] < 3:
        return 0
    lane = (0,)
    tip = place_at(lane, q, q, 0)
    count = _drawn(points, 0, tip.r)
    for k in range(model.links):
        root = root_of(lane, model, q, q, k, tip)
        count = _draw(model, k, q, root, points, _drawn(points, count, root.r))
        tip = last_section(lane, model, q, q, k, root)
        A = matrix(tip.p)
        along = times((A[0][0], A[1][0], A[2][0]), _tip_lever(model, k))
        if count_of(model, k) == 0:
            for j in range(1, STATIONS):
                count = _drawn(points, count, plus(tip.r, times(along, j / STATIONS)))
        count = _drawn(points, count, plus(tip.r, along))
    return count


@kernel
def _draw(model, k, q, root, points, count):
    """STATIONS of each element of link k; by strains its points."""
    if model.strains is not None:
        if count_of(model, k) > 0:
            for j in range(len(model.points)):
                count = _drawn(points, count, point_of(model, k, j, q, root))
        return count
    left = root
    for e in range(count_of(model, k)):
        right = place_at((0,), q, q, vertex_row(model, k, e))
        for j in range(1, STATIONS + 1):
            count = _drawn(points, count, _cubic(left, right, j / STATIONS))
        left = right
    return count
