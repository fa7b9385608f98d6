"""What is read off floating frames, in a chain or joined by multipliers: ports, energies, poses, range, shape.

model: `physics.model.FloatingChain`, whose table is None, or `FloatingFrame`, whose bodies have frames of their own.
"""

from __future__ import annotations

from ...compiler.arrays import stack
from ...compiler.decorator import kernel
from ...compiler.dispatch import size
from ...compiler.lanes import absolute, load, select_lt, sincos, splat, store
from ...compiler.trace import unrolled
from ..model import DIVERGED, OUT_OF_RANGE
from .body import constants, dot, product, tip, turn_of_root
from .layout import START, station_at, window

POSE = (0,) * 6
FRAME = (0,) * 6
FOUR = (0,) * 4


@kernel
def _begin(lane, q, v, pose):
    """pose <- x, y, angle of a section and their rates."""
    for i in range(3):
        store(pose, i, load(lane, q, i))
        store(pose, 3 + i, load(lane, v, i))


@kernel
def _enter(lane, model, table, q, v, k, b, pose):
    """To the root section of body b, of link k: from the tip section before it, or to where its own frame stands."""
    if table is not None:
        at = table[b, START] * len(lane)
        _begin(lane, q[at:], v[at:], pose)
    elif b == 0:
        _begin(lane, q, v, pose)
    elif b == k * model.segments:
        i = 2 + size(model.mesh.n) * model.links * model.segments + k
        store(pose, 2, load(lane, pose, 2) + load(lane, q, i))
        store(pose, 5, load(lane, pose, 5) + load(lane, v, i))


@kernel
def _elastic(table, n, b):
    """Row of body b's first elastic coordinate."""
    if table is None:
        return 3 + n * b
    return table[b, START] + 3


@unrolled
@kernel
def place(lane, model, D, q, v, pose, frame):
    """From a body's root section to its tip section; frame <- cosine, sine, its origin's velocity in its axes, rate."""
    own = constants(model)
    angle, w = load(lane, pose, 2), load(lane, pose, 5)
    if model.chord is not None:
        angle, w = angle - turn_of_root(lane, model, D, q), w - turn_of_root(lane, model, D, v)
    s, c = sincos(angle)
    vx, vy = load(lane, pose, 3), load(lane, pose, 4)
    x, y, phi = tip(lane, model, D, q)
    tx, ty, rate = tip(lane, model, D, v)
    x = x + D[own.length]
    if model.modal is not None:
        x = x - product(lane, model, D, own.tip_H, q, q) * 0.5
        tx = tx - product(lane, model, D, own.tip_H, q, v)
    tx, ty = tx - w * y, ty + w * x
    store(frame, 0, c)
    store(frame, 1, s)
    store(frame, 2, c * vx + s * vy)
    store(frame, 3, c * vy - s * vx)
    store(frame, 4, w)
    store(pose, 0, load(lane, pose, 0) + (c * x - s * y))
    store(pose, 1, load(lane, pose, 1) + (s * x + c * y))
    store(pose, 2, angle + phi)
    store(pose, 3, vx + (c * tx - s * ty))
    store(pose, 4, vy + (s * tx + c * ty))
    store(pose, 5, w + rate)


@kernel
def _note(lane, loads, model, link, end, pose, y):
    """The place and angle of the point loads at an end of a link."""
    if loads is not None:
        for f in range(loads.shape[0]):
            if loads[f, 0] == link and loads[f, 1] == end:
                for i in range(3):
                    store(y, model.links + 3 * f + i, load(lane, pose, i))


@kernel
def ports(lane, model, par, q, y):
    """Joint angles, then position and section angle at each point load."""
    n = size(model.mesh.n)
    store(y, 0, load(lane, q, 2))
    for k in range(1, model.links):
        store(y, k, load(lane, q, 2 + n * model.links * model.segments + k))
    ports_of_loads(lane, model, model.loads, n, q, y)


@kernel
def ports_of_loads(lane, model, loads, n, q, y):
    """Those of the point loads alone."""
    if loads is not None:
        pose, frame = stack(lane, POSE), stack(lane, FRAME)
        for k in range(model.links):
            for b in range(k * model.segments, (k + 1) * model.segments):
                _enter(lane, model, model.table, q, q, k, b, pose)
                if b == k * model.segments:
                    _note(lane, loads, model, k, 0, pose, y)
                own = q[_elastic(model.table, n, b) * len(lane) :]
                place(lane, model.mesh, model.data[model.block * b :], own, own, pose, frame)
            _note(lane, loads, model, k, 1, pose, y)


@unrolled
@kernel
def _damping(lane, model, D, par, q, v, x, total):
    """total += x'C(q) v of one body."""
    own, n, wide = constants(model), size(model.n), len(model.window)
    if model.damped is not None:
        part = product(lane, model, D, own.K_bend, x, v) * load(lane, par, 2)
        if model.full is None:
            part = part + product(lane, model, D, own.K_axial, x, v)
        else:
            at = own.spans
            for e in range(len(model.elements)):
                first = window(model, n, e)
                ea, g, H = at, at + 1, at + 1 + wide
                at = H + wide * wide
                rate, other = splat(lane, 0.0), splat(lane, 0.0)
                for i in range(wide):
                    slope = load(lane, q, first) * D[H + i * wide]
                    for j in range(1, wide):
                        slope = slope + load(lane, q, first + j) * D[H + i * wide + j]
                    slope = slope + D[g + i]
                    rate = rate + slope * load(lane, v, first + i)
                    other = other + slope * load(lane, x, first + i)
                part = part + (rate * other) * D[ea]
        store(total, 0, load(lane, total, 0) + part * load(lane, par, 3))
    if model.drag is not None:
        part = product(lane, model, D, own.M_ff, x, v) * D[own.drag]
        store(total, 0, load(lane, total, 0) + part)


@unrolled
@kernel
def _payload_drag(lane, model, D, par, q, v, x, total):
    """total += what drag does on the payload, the tip's rates in the frame of its body."""
    if model.drag is not None:
        own = constants(model)
        vx, vy, turning = tip(lane, model, D, v)
        xx, xy, turned = tip(lane, model, D, x)
        if model.modal is not None:
            vx = vx - product(lane, model, D, own.tip_H, q, v)
            xx = xx - product(lane, model, D, own.tip_H, q, x)
        part = (vx * xx + vy * xy) * load(lane, par, 0) + (turning * turned) * load(lane, par, 1)
        store(total, 0, load(lane, total, 0) + part * D[own.drag])


@kernel
def damping_work(lane, model, par, q, v, x):
    """x'C(q) v, W: damping of the elastic coordinates and of the payload (for x = v twice Rayleigh's function)."""
    total = stack(lane, (0,))
    store(total, 0, splat(lane, 0.0))
    bodies = model.links * model.segments
    for b in range(bodies):
        e = _elastic(model.table, size(model.mesh.n), b) * len(lane)
        _damping(lane, model.mesh, model.data[model.block * b :], par, q[e:], v[e:], x[e:], total)
    e = _elastic(model.table, size(model.mesh.n), bodies - 1) * len(lane)
    _payload_drag(lane, model.mesh, model.data[model.block * (bodies - 1) :], par, q[e:], v[e:], x[e:], total)
    return load(lane, total, 0)


@unrolled
@kernel
def _energies(lane, model, D, par, q, v, frame, totals):
    """totals (kinetic, strain, first moments x, y about the body's origin) of one body; moments replace the last's."""
    own, n, wide = constants(model), size(model.n), len(model.window)
    c, s = load(lane, frame, 0), load(lane, frame, 1)
    vx, vy, w = load(lane, frame, 2), load(lane, frame, 3), load(lane, frame, 4)
    sx, sy = dot(lane, model, D, own.S_bar, q) + D[own.S0], dot(lane, model, D, own.S_bar + n, q)
    tx, ty = dot(lane, model, D, own.S_bar, v), dot(lane, model, D, own.S_bar + n, v)
    if model.modal is not None:
        sx = sx - product(lane, model, D, own.D0, q, q) * 0.5
        tx = tx - product(lane, model, D, own.D0, q, v)
    inertia = dot(lane, model, D, own.c_u, q) * 2.0 + D[own.I0] + product(lane, model, D, own.G, q, q)
    kinetic = (vx * vx + vy * vy) * (0.5 * D[own.mass]) + vx * (tx - w * sy) + vy * (ty + w * sx)
    kinetic = kinetic + ((w * w) * inertia + product(lane, model, D, own.M_ff, v, v)) * 0.5
    kinetic = kinetic + w * (dot(lane, model, D, own.c, v) + product(lane, model, D, own.B, v, q))
    strain = product(lane, model, D, own.K_bend, q, q) * (load(lane, par, 2) * 0.5)
    if model.full is None:
        strain = strain + product(lane, model, D, own.K_axial, q, q) * 0.5
    at = own.spans
    for e in range(len(model.elements)):
        first = window(model, n, e)
        ea, g, H = at, at + 1, at + 1 + wide
        at = H + wide * wide
        linear, second = splat(lane, 0.0), splat(lane, 0.0)
        for i in range(wide):
            slope = load(lane, q, first) * D[H + i * wide]
            for j in range(1, wide):
                slope = slope + load(lane, q, first + j) * D[H + i * wide + j]
            linear = linear + load(lane, q, first + i) * D[g + i]
            second = second + load(lane, q, first + i) * slope
        if model.full is not None:
            linear = linear + second * 0.5
            strain = strain + (linear * linear) * (0.5 * D[ea])
        else:  # q'K(q)q / 2 of [43]; the paper's force has no potential
            strain = strain + (linear * second) * (0.5 * D[ea])
    store(totals, 0, load(lane, totals, 0) + kinetic)
    store(totals, 1, load(lane, totals, 1) + strain)
    store(totals, 2, c * sx - s * sy)
    store(totals, 3, s * sx + c * sy)


@kernel
def fall(gravity, k):
    """Gravity along axis k, m/s^2."""
    if gravity is None:
        return 0.0
    return gravity[k]


@kernel
def energy(lane, model, par, q, v):
    """(kinetic, strain, gravity) energy, J."""
    n, L = size(model.mesh.n), len(lane)
    pose, frame, totals = stack(lane, POSE), stack(lane, FRAME), stack(lane, FOUR)
    for i in range(4):
        store(totals, i, splat(lane, 0.0))
    gx, gy = fall(model.gravity, 0), fall(model.gravity, 1)
    gravity = splat(lane, 0.0)
    for k in range(model.links):
        for b in range(k * model.segments, (k + 1) * model.segments):
            _enter(lane, model, model.table, q, v, k, b, pose)
            e, D = _elastic(model.table, n, b) * L, model.data[model.block * b :]
            x, y, mass = load(lane, pose, 0), load(lane, pose, 1), D[constants(model.mesh).mass]
            place(lane, model.mesh, D, q[e:], v[e:], pose, frame)
            _energies(lane, model.mesh, D, par, q[e:], v[e:], frame, totals)
            gravity = gravity - (load(lane, totals, 2) + x * mass) * gx - (load(lane, totals, 3) + y * mass) * gy
    vx, vy, w = load(lane, pose, 3), load(lane, pose, 4), load(lane, pose, 5)
    mass = load(lane, par, 0)
    kinetic = load(lane, totals, 0) + ((vx * vx + vy * vy) * mass + (w * w) * load(lane, par, 1)) * 0.5
    gravity = gravity - mass * (load(lane, pose, 0) * gx + load(lane, pose, 1) * gy)
    return kinetic, load(lane, totals, 1), gravity


@kernel
def _write(lane, pose, out, k):
    for i in range(6):
        store(out, k + i, load(lane, pose, i))


@kernel
def link_poses(lane, model, par, q, v, out):
    """Of each link: x, y, angle of its root and their rates, then those of its tip."""
    n, L = size(model.mesh.n), len(lane)
    pose, frame = stack(lane, POSE), stack(lane, FRAME)
    for k in range(model.links):
        for b in range(k * model.segments, (k + 1) * model.segments):
            _enter(lane, model, model.table, q, v, k, b, pose)
            if b == k * model.segments:
                _write(lane, pose, out, 12 * k)
            e = _elastic(model.table, n, b) * L
            place(lane, model.mesh, model.data[model.block * b :], q[e:], v[e:], pose, frame)
        _write(lane, pose, out, 12 * k + 6)


@unrolled
@kernel
def _ranges(lane, model, D, payload, q, out):
    """out: the tip's deflection over the length; what the inertia about the root has lost over what it may lose."""
    own, n = constants(model), size(model.n)
    y = dot(lane, model, D, own.tip + n, q)
    far = y
    if model.chord is not None:  # against the tangent at the root
        turn, x = dot(lane, model, D, own.root, q), tip(lane, model, D, q)[0] + D[own.length]
        if model.modal is not None:
            x = x - product(lane, model, D, own.tip_H, q, q) * 0.5
        far = y - (turn - turn * (turn * turn) * (1.0 / 6.0)) * x
    store(out, 0, absolute(far) * (1.0 / D[own.length]))
    store(out, 1, splat(lane, 0.0))
    if model.modal is not None:
        lost = product(lane, model, D, own.tip_H, q, q) * D[own.length] - y * y
        lost = lost * load(lane, payload, 0) - product(lane, model, D, own.G, q, q)
        store(out, 1, lost * (1.0 / D[own.most_lost]))


@kernel
def out_of_range(lane, model, par, q):
    """DIVERGED when a body's tip deflects beyond its length; OUT_OF_RANGE when a reduced link leaves its range: by its
    deflection, or by an inertia about its root that comes near to where the mass matrix is indefinite."""
    n, L = size(model.mesh.n), len(lane)
    out, payload = stack(lane, (0, 0)), stack(lane, (0,))
    status = splat(lane, 0.0)
    bodies = model.links * model.segments
    store(payload, 0, load(lane, par, 0))
    for b in range(bodies - 1, -1, -1):
        own = q[_elastic(model.table, n, b) * L :]
        _ranges(lane, model.mesh, model.data[model.block * b :], payload, own, out)
        store(payload, 0, splat(lane, 0.0))
        deflection = load(lane, out, 0)
        if model.mesh.modal is not None:
            far = select_lt(model.bound, deflection, splat(lane, 2.0), load(lane, out, 1))
            status = select_lt(1.0, far, splat(lane, float(OUT_OF_RANGE)), status)
        status = select_lt(deflection, 1.0, status, splat(lane, float(DIVERGED)))
    return status


@kernel
def shape(model, q, points):
    """Positions along the chain at the bodies' stations, as many as `points` has room for; their number."""
    lane = (0,)
    mesh, n = model.mesh, size(model.mesh.n)
    pose, frame = stack(lane, POSE), stack(lane, FRAME)
    points[0, 0], points[0, 1] = q[0], q[1]
    count, own = 1, constants(mesh)
    length = station_at(0, n).end
    for k in range(model.links):
        for b in range(k * model.segments, (k + 1) * model.segments):
            _enter(lane, model, model.table, q, q, k, b, pose)
            D, e = model.data[model.block * b :], q[_elastic(model.table, n, b) :]
            x0, y0 = pose[0], pose[1]
            place(lane, mesh, D, e, e, pose, frame)
            for i in range((model.block - own.stations) // length):
                if count == points.shape[0]:
                    return count
                at = station_at(own.stations + i * length, n)
                x, y = D[at.x] + dot(lane, mesh, D, at.u, e), dot(lane, mesh, D, at.v, e)
                x -= 0.5 * product(lane, mesh, D, at.H, e, e)
                points[count, 0] = x0 + frame[0] * x - frame[1] * y
                points[count, 1] = y0 + frame[1] * x + frame[0] * y
                count += 1
    return count
