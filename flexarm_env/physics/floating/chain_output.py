"""What is read off floating frames, in a chain or joined by multipliers: ports, energies, poses, range, shape.

model: `physics.model.FloatingChain`, whose table is None, or `FloatingFrame`, whose bodies have frames of their own.
"""

from ...compiler import WIDEST, absolute, kernel, load, select_lt, sincos, size, splat, stack, store, unrolled
from ..arithmetic import fall
from ..layout import OF_LOAD, POSE
from ..model import DIVERGED, OUT_OF_RANGE
from .body import along, constants, damping_time, dot, in_window, product, tip, turn_of_root
from .layout import ELASTIC, FRAME, LOADED, START, acts_at, elastic_row, elbow_row, span_at, station_at, window
from .rigid import ROOT_END, TIP_END, end_of, moved, passed, to_payload

SIX, FOUR = (0,) * 6, (0,) * 4


@kernel
def _enter(lane, model, q, v, k, b, pose):
    """To the root section of body b, of link k: from the tip section before it, or to where its own frame stands."""
    at = 0
    if model.table is not None:
        at = model.table[b, START]
    if model.table is not None or b == 0:
        for i in range(3):
            store(pose, POSE.x + i, load(lane, q, at + i))
            store(pose, POSE.vx + i, load(lane, v, at + i))
    elif b == k * model.segments:
        i = elbow_row(model, k)
        store(pose, POSE.angle, load(lane, pose, POSE.angle) + load(lane, q, i))
        store(pose, POSE.rate, load(lane, pose, POSE.rate) + load(lane, v, i))


@kernel
def _elastic(model, b):
    """Row of body b's first elastic coordinate."""
    if model.table is None:
        return elastic_row(model, b)
    return model.table[b, START] + ELASTIC


@unrolled
@kernel
def place(lane, model, D, q, v, pose, frame):
    """From a body's root section to its tip section; frame <- cosine, sine, its origin's velocity in its axes, rate."""
    own = constants(model)
    angle, w = load(lane, pose, POSE.angle), load(lane, pose, POSE.rate)
    if model.chord is not None:
        angle, w = angle - turn_of_root(lane, model, D, q), w - turn_of_root(lane, model, D, v)
    s, c = sincos(angle)
    vx, vy = load(lane, pose, POSE.vx), load(lane, pose, POSE.vy)
    x, y, phi = tip(lane, model, D, q)
    tx, ty, rate = tip(lane, model, D, v)
    x = x + D[own.length]
    if model.modal is not None:
        x = x - product(lane, model, D, own.tip_H, q, q) * 0.5
        tx = tx - product(lane, model, D, own.tip_H, q, v)
    tx, ty = tx - w * y, ty + w * x
    store(frame, FRAME.cos, c)
    store(frame, FRAME.sin, s)
    store(frame, FRAME.vx, c * vx + s * vy)
    store(frame, FRAME.vy, c * vy - s * vx)
    store(frame, FRAME.rate, w)
    store(pose, POSE.x, load(lane, pose, POSE.x) + (c * x - s * y))
    store(pose, POSE.y, load(lane, pose, POSE.y) + (s * x + c * y))
    store(pose, POSE.angle, angle + phi)
    store(pose, POSE.vx, vx + (c * tx - s * ty))
    store(pose, POSE.vy, vy + (s * tx + c * ty))
    store(pose, POSE.rate, w + rate)


@kernel
def _at_loads(lane, model, link, end, pose, y):
    """y <- place and angle of the point loads at an end of a link; how many there are."""
    found = 0
    for f in range(model.loads.shape[0] // LOADED.end):
        if acts_at(model.loads, f, link, end):
            found += 1
            for i in range(3):
                store(y, model.links + OF_LOAD.end * f + i, load(lane, pose, POSE.x + i))
    return found


@kernel
def ports(lane, model, par, q, y):
    """Joint angles, then position and section angle at each point load."""
    store(y, 0, load(lane, q, 2))
    for k in range(1, model.links):
        store(y, k, load(lane, q, elbow_row(model, k)))
    ports_of_loads(lane, model, q, y)


@kernel
def ports_of_loads(lane, model, q, y):
    """Those of the point loads alone."""
    if model.loads is not None:
        pose, frame, left = stack(lane, SIX), stack(lane, SIX), model.loads.shape[0] // LOADED.end
        for k in range(model.links):
            for b in range(k * model.segments, (k + 1) * model.segments):
                _enter(lane, model, q, q, k, b, pose)
                if b == k * model.segments:
                    left -= _at_loads(lane, model, k, 0, pose, y)
                    if left == 0:
                        return
                    moved(lane, end_of(model, k, ROOT_END), pose)
                own = q[_elastic(model, b) * len(lane) :]
                place(lane, model.mesh, model.data[model.block * b :], own, own, pose, frame)
            moved(lane, end_of(model, k, TIP_END), pose)
            left -= _at_loads(lane, model, k, 1, pose, y)
            if left == 0:
                return


@unrolled
@kernel
def _damping(lane, model, D, par, q, v, x, total):
    """total += x'C(q) v of one body."""
    own, n, wide = constants(model), size(model.n), len(model.window)
    if model.damped is not None:
        part = product(lane, model, D, own.K_bend, x, v) * load(lane, par, 2)
        if model.full is None and model.modal is None:
            part = part + product(lane, model, D, own.K_axial, x, v)
        else:
            span = span_at(own.spans, wide)
            for e in range(len(model.elements)):
                first = window(model, n, e)
                rate, other = splat(lane, 0.0), splat(lane, 0.0)
                for i in range(wide):
                    slope = in_window(lane, model, D, span.H + i * wide, q, first) + D[span.stretch + i]
                    rate = rate + slope * load(lane, v, first + i)
                    other = other + slope * load(lane, x, first + i)
                part = part + (rate * other) * D[span.stiffness]
                span = span_at(span.end, wide)
        store(total, 0, load(lane, total, 0) + part * damping_time(lane, model, D, par))
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
        e = _elastic(model, b) * len(lane)
        _damping(lane, model.mesh, model.data[model.block * b :], par, q[e:], v[e:], x[e:], total)
    e = _elastic(model, bodies - 1) * len(lane)
    _payload_drag(lane, model.mesh, model.data[model.block * (bodies - 1) :], par, q[e:], v[e:], x[e:], total)
    return load(lane, total, 0)


@unrolled
@kernel
def _energies(lane, model, D, par, q, v, frame, totals):
    """totals (kinetic, strain, first moments x, y about the body's origin) of one body; moments replace the last's."""
    own, n, wide = constants(model), size(model.n), len(model.window)
    c, s = load(lane, frame, FRAME.cos), load(lane, frame, FRAME.sin)
    vx, vy, w = load(lane, frame, FRAME.vx), load(lane, frame, FRAME.vy), load(lane, frame, FRAME.rate)
    sx, sy = along(lane, model, D, own.S_bar_x, q) + D[own.S0], dot(lane, model, D, own.S_bar_y, q)
    tx, ty = along(lane, model, D, own.S_bar_x, v), dot(lane, model, D, own.S_bar_y, v)
    if model.modal is not None:
        sx = sx - product(lane, model, D, own.D0, q, q) * 0.5
        tx = tx - product(lane, model, D, own.D0, q, v)
    inertia = along(lane, model, D, own.c_u, q) * 2.0 + D[own.I0] + product(lane, model, D, own.G, q, q)
    kinetic = (vx * vx + vy * vy) * (0.5 * D[own.mass]) + vx * (tx - w * sy) + vy * (ty + w * sx)
    kinetic = kinetic + ((w * w) * inertia + product(lane, model, D, own.M_ff, v, v)) * 0.5
    spun = dot(lane, model, D, own.c, v)
    if model.modal is None:
        spun = spun + product(lane, model, D, own.B, v, q)
    kinetic = kinetic + w * spun
    strain = product(lane, model, D, own.K_bend, q, q) * (load(lane, par, 2) * 0.5)
    if model.curved is not None:
        strain = strain + (D[own.spent] - dot(lane, model, D, own.moment, q)) * load(lane, par, 2)
    if model.full is None:
        if model.modal is None:
            strain = strain + product(lane, model, D, own.K_axial, q, q) * 0.5
    span = span_at(own.spans, wide)
    for e in range(len(model.elements)):
        first = window(model, n, e)
        linear, second = splat(lane, 0.0), splat(lane, 0.0)
        for i in range(wide):
            slope = in_window(lane, model, D, span.H + i * wide, q, first)
            linear = linear + load(lane, q, first + i) * D[span.stretch + i]
            second = second + load(lane, q, first + i) * slope
        if model.full is not None:
            linear = linear + second * 0.5
            strain = strain + (linear * linear) * (0.5 * D[span.stiffness])
        else:  # q'K(q)q / 2 of [43]; the paper's force has no potential
            strain = strain + (linear * second) * (0.5 * D[span.stiffness])
        span = span_at(span.end, wide)
    store(totals, 0, load(lane, totals, 0) + kinetic)
    store(totals, 1, load(lane, totals, 1) + strain)
    store(totals, 2, c * sx - s * sy)
    store(totals, 3, s * sx + c * sy)


@kernel
def energy(lane, model, par, q, v):
    """(kinetic, strain, gravity) energy, J."""
    L = len(lane)
    pose, frame, totals = stack(lane, SIX), stack(lane, SIX), stack(lane, FOUR)
    for i in range(4):
        store(totals, i, splat(lane, 0.0))
    ends = stack(lane, (0, 0, 0))
    for i in range(3):
        store(ends, i, splat(lane, 0.0))
    gx, gy = fall(model.gravity, 0), fall(model.gravity, 1)
    gravity = splat(lane, 0.0)
    for k in range(model.links):
        for b in range(k * model.segments, (k + 1) * model.segments):
            _enter(lane, model, q, v, k, b, pose)
            if b == k * model.segments:
                passed(lane, end_of(model, k, ROOT_END), pose, ends)
            e, D = _elastic(model, b) * L, model.data[model.block * b :]
            x, y, mass = load(lane, pose, POSE.x), load(lane, pose, POSE.y), D[constants(model.mesh).mass]
            place(lane, model.mesh, D, q[e:], v[e:], pose, frame)
            _energies(lane, model.mesh, D, par, q[e:], v[e:], frame, totals)
            gravity = gravity - (load(lane, totals, 2) + x * mass) * gx - (load(lane, totals, 3) + y * mass) * gy
        passed(lane, end_of(model, k, TIP_END), pose, ends)
    moved(lane, to_payload(model), pose)
    vx, vy, w = load(lane, pose, POSE.vx), load(lane, pose, POSE.vy), load(lane, pose, POSE.rate)
    mass = load(lane, par, 0)
    kinetic = load(lane, totals, 0) + ((vx * vx + vy * vy) * mass + (w * w) * load(lane, par, 1)) * 0.5
    gravity = gravity - mass * (load(lane, pose, POSE.x) * gx + load(lane, pose, POSE.y) * gy)
    if model.rigid is not None:
        kinetic = kinetic + load(lane, ends, 0)
        gravity = gravity - (load(lane, ends, 1) * gx + load(lane, ends, 2) * gy)
    return kinetic, load(lane, totals, 1), gravity


@kernel
def link_poses(lane, model, par, q, v, out):
    """Of each link: x, y, angle of its root and their rates, then those of its tip."""
    L = len(lane)
    pose, frame = stack(lane, SIX), stack(lane, SIX)
    for k in range(model.links):
        for b in range(k * model.segments, (k + 1) * model.segments):
            _enter(lane, model, q, v, k, b, pose)
            if b == k * model.segments:
                for i in range(6):
                    store(out, POSE.end * k + i, load(lane, pose, i))
                moved(lane, end_of(model, k, ROOT_END), pose)
            e = _elastic(model, b) * L
            place(lane, model.mesh, model.data[model.block * b :], q[e:], v[e:], pose, frame)
        moved(lane, end_of(model, k, TIP_END), pose)
        for i in range(6):
            store(out, POSE.end * k + POSE.tip_x + i, load(lane, pose, i))


@unrolled
@kernel
def _ranges(lane, model, D, payload, q, out):
    """out: the tip's deflection over the length; what the inertia about the root has lost over what it may lose."""
    own = constants(model)
    y = dot(lane, model, D, own.tip_v, q)
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
    L = len(lane)
    out, payload = stack(lane, (0, 0)), stack(lane, (0,))
    status = splat(lane, 0.0)
    bodies = model.links * model.segments
    store(payload, 0, load(lane, par, 0))
    for b in range(bodies - 1, -1, -1):
        own = q[_elastic(model, b) * L :]
        _ranges(lane, model.mesh, model.data[model.block * b :], payload, own, out)
        store(payload, 0, splat(lane, 0.0))
        deflection = load(lane, out, 0)
        if model.mesh.modal is not None:
            far = select_lt(model.bound, deflection, splat(lane, 2.0), load(lane, out, 1))
            status = select_lt(1.0, far, splat(lane, float(OUT_OF_RANGE)), status)
        status = select_lt(deflection, 1.0, status, splat(lane, float(DIVERGED)))
    return status


@kernel
def _sum(D, at, x, n):
    """sum_j D_j x_j, D of each station."""
    total = load(WIDEST, D, at) * x[0]
    for j in range(1, n):
        total = total + load(WIDEST, D, at + j) * x[j]
    return total


@kernel
def _draw(mesh, D, q, x0, y0, frame, line):
    """line <- x of the stations at D, in lanes, then y."""
    n = size(mesh.n)
    at = station_at(0, n)
    x, y = load(WIDEST, D, at.x), _sum(D, at.v, q, n)
    if mesh.modal is None:
        x = x + _sum(D, at.u, q, n)
    else:
        bent = _sum(D, at.H, q, n) * q[0]
        for i in range(1, n):
            bent = bent + _sum(D, at.H + i * n, q, n) * q[i]
        x = x - bent * 0.5
    c, s = frame[FRAME.cos], frame[FRAME.sin]
    store(line, 0, x * c + x0 - y * s)
    store(line, 1, x * s + y0 + y * c)


@kernel
def shape(model, q, points):
    """Positions along the chain at the bodies' stations, as many as `points` has room for; their number."""
    lane, many = (0,), len(WIDEST)
    mesh, n = model.mesh, size(model.mesh.n)
    pose, frame, line = stack(lane, SIX), stack(lane, SIX), stack(WIDEST, (0, 0))
    points[0, 0], points[0, 1] = q[0], q[1]
    count, stations = 1, constants(mesh).stations
    length = station_at(0, n).end * many
    for k in range(model.links):
        for b in range(k * model.segments, (k + 1) * model.segments):
            _enter(lane, model, q, q, k, b, pose)
            if b == k * model.segments:
                moved(lane, end_of(model, k, ROOT_END), pose)
            D, e = model.data[model.block * b :], q[_elastic(model, b) :]
            x0, y0 = pose[POSE.x], pose[POSE.y]
            place(lane, mesh, D, e, e, pose, frame)
            for group in range((model.block - stations) // length):
                _draw(mesh, D[stations + group * length :], e, x0, y0, frame, line)
                for i in range(many):
                    if count == points.shape[0]:
                        return count
                    points[count, 0], points[count, 1] = line[i], line[many + i]
                    count += 1
        moved(lane, end_of(model, k, TIP_END), pose)
        if model.rigid is not None:  # a link's last point is where its rigid end ends
            points[count - 1, 0], points[count - 1, 1] = pose[POSE.x], pose[POSE.y]
    return count
