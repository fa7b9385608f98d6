"""What is read off floating frames, in a chain or joined by multipliers: ports, energies, poses, range, shape.

model: `physics.model.FloatingChain`, whose table is None, or `FloatingFrame`, whose bodies have frames of their own.
"""

from ...compiler import WIDEST, absolute, kernel, load, select_lt, sincos, size, splat, stack, store, unrolled
from ..arithmetic import add, fall, pair, put_pair, put_vector, turned, turned_back, vector
from ..layout import OF_LOAD, POSE
from ..model import DIVERGED, OUT_OF_RANGE, PAYLOAD_INERTIA, PAYLOAD_MASS, STIFFNESS_FACTOR
from .body import along, constants, damping_time, dot, in_window, product, tip, turn_of_root
from .layout import ANGLE, ELASTIC, FRAME, LOADED, START, acts_at, elastic_row, elbow_row, span_at, station_at, window
from .rigid import ROOT_END, TIP_END, end_of, moved, passed, to_payload

SIX = (0,) * 6


@kernel
def _enter(lane, model, q, v, k, b, pose):
    """To the root section of body b, of link k: from the tip section before it, or to where its own frame stands."""
    at = 0
    if model.table is not None:
        at = model.table[b, START]
    if model.table is not None or b == 0:
        put_vector(pose, POSE.x, vector(lane, q, at))
        put_vector(pose, POSE.vx, vector(lane, v, at))
    elif b == k * model.segments:
        i = elbow_row(model, k)
        add(lane, pose, POSE.angle, load(lane, q, i))
        add(lane, pose, POSE.rate, load(lane, v, i))


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
    X, Y = pair(lane, pose, POSE.x)
    vx, vy = pair(lane, pose, POSE.vx)
    x, y, phi = tip(lane, model, D, q)
    tx, ty, rate = tip(lane, model, D, v)
    x = x + D[own.length]
    if model.modal is not None:
        x = x - product(lane, model, D, own.tip_H, q, q) * 0.5
        tx = tx - product(lane, model, D, own.tip_H, q, v)
    put_pair(frame, FRAME.cos, (c, s))
    put_pair(frame, FRAME.vx, turned_back(c, s, vx, vy))
    store(frame, FRAME.rate, w)
    tx, ty = turned(c, s, tx - w * y, ty + w * x)
    x, y = turned(c, s, x, y)
    put_vector(pose, POSE.x, (X + x, Y + y, angle + phi))
    put_vector(pose, POSE.vx, (vx + tx, vy + ty, w + rate))


@kernel
def _visit(lane, model, q, v, tell, out):
    """From root to tip; tell(lane, model, k, end, pose, out) at the root and at the tip of each link k."""
    pose, frame = stack(lane, SIX), stack(lane, SIX)
    for k in range(model.links):
        for b in range(k * model.segments, (k + 1) * model.segments):
            _enter(lane, model, q, v, k, b, pose)
            if b == k * model.segments:
                tell(lane, model, k, ROOT_END, pose, out)
                moved(lane, end_of(model, k, ROOT_END), pose)
            e = _elastic(model, b) * len(lane)
            place(lane, model.mesh, model.data[model.block * b :], q[e:], v[e:], pose, frame)
        moved(lane, end_of(model, k, TIP_END), pose)
        tell(lane, model, k, TIP_END, pose, out)


@kernel
def _to_pose(lane, model, link, end, pose, out):
    for i in range(6):
        store(out, POSE.end * link + POSE.tip_x * end + i, load(lane, pose, i))


@kernel
def link_poses(lane, model, par, q, v, out):
    """Of each link: x, y, angle of its root and their rates, then those of its tip."""
    _visit(lane, model, q, v, _to_pose, out)


@kernel
def _to_loads(lane, model, link, end, pose, y):
    for f in range(model.loads.shape[0] // LOADED.end):
        if acts_at(model.loads, f, link, end):
            put_vector(y, model.links + OF_LOAD.end * f, vector(lane, pose, POSE.x))


@kernel
def ports_of_loads(lane, model, q, y):
    """Position and section angle at each point load."""
    if model.loads is not None:
        _visit(lane, model, q, q, _to_loads, y)


@kernel
def ports(lane, model, par, q, y):
    """Joint angles, then `ports_of_loads`."""
    store(y, 0, load(lane, q, ANGLE))
    for k in range(1, model.links):
        store(y, k, load(lane, q, elbow_row(model, k)))
    ports_of_loads(lane, model, q, y)


@unrolled
@kernel
def _damping(lane, model, D, par, q, v, x, total):
    """total + x'C(q) v of one body (a tuple of it)."""
    own, n, wide = constants(model), size(model.n), len(model.window)
    if model.damped is not None:
        part = product(lane, model, D, own.K_bend, x, v) * load(lane, par, STIFFNESS_FACTOR)
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
        total = total + part * damping_time(lane, model, D, par)
    if model.drag is not None:
        total = total + product(lane, model, D, own.M_ff, x, v) * D[own.drag]
    return (total,)


@unrolled
@kernel
def _payload_drag(lane, model, D, par, q, v, x):
    """What drag does on the payload (a tuple of it), the tip's rates in the frame of its body."""
    own = constants(model)
    vx, vy, turning = tip(lane, model, D, v)
    xx, xy, turn = tip(lane, model, D, x)
    if model.modal is not None:
        vx = vx - product(lane, model, D, own.tip_H, q, v)
        xx = xx - product(lane, model, D, own.tip_H, q, x)
    part = (vx * xx + vy * xy) * load(lane, par, PAYLOAD_MASS) + (turning * turn) * load(lane, par, PAYLOAD_INERTIA)
    return (part * D[own.drag],)


@kernel
def damping_work(lane, model, par, q, v, x):
    """x'C(q) v, W: damping of the elastic coordinates and of the payload (for x = v twice Rayleigh's function)."""
    total, mesh, last = splat(lane, 0.0), model.mesh, model.links * model.segments - 1
    for b in range(last + 1):
        e = _elastic(model, b) * len(lane)
        total = _damping(lane, mesh, model.data[model.block * b :], par, q[e:], v[e:], x[e:], total)[0]
    if mesh.drag is not None:
        e = _elastic(model, last) * len(lane)
        total = total + _payload_drag(lane, mesh, model.data[model.block * last :], par, q[e:], v[e:], x[e:])[0]
    return total


@unrolled
@kernel
def _energies(lane, model, D, par, q, v, frame):
    """Kinetic and strain energy, first moments x, y about the body's origin, of one body."""
    own, n, wide = constants(model), size(model.n), len(model.window)
    c, s = pair(lane, frame, FRAME.cos)
    vx, vy, w = vector(lane, frame, FRAME.vx)
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
    strain = product(lane, model, D, own.K_bend, q, q) * (load(lane, par, STIFFNESS_FACTOR) * 0.5)
    if model.curved is not None:
        strain = strain + (D[own.spent] - dot(lane, model, D, own.moment, q)) * load(lane, par, STIFFNESS_FACTOR)
    if model.full is None and model.modal is None:
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
    mx, my = turned(c, s, sx, sy)
    return kinetic, strain, mx, my


@kernel
def energy(lane, model, par, q, v):
    """(kinetic, strain, gravity) energy, J."""
    pose, frame, ends = stack(lane, SIX), stack(lane, SIX), stack(lane, (0, 0, 0))
    zero = splat(lane, 0.0)
    put_vector(ends, 0, (zero, zero, zero))
    kinetic, strain, gravity = zero, zero, zero
    gx, gy = fall(model.gravity, 0), fall(model.gravity, 1)
    for k in range(model.links):
        for b in range(k * model.segments, (k + 1) * model.segments):
            _enter(lane, model, q, v, k, b, pose)
            if b == k * model.segments:
                passed(lane, end_of(model, k, ROOT_END), pose, ends)
            e, D = _elastic(model, b) * len(lane), model.data[model.block * b :]
            (x, y), mass = pair(lane, pose, POSE.x), D[constants(model.mesh).mass]
            place(lane, model.mesh, D, q[e:], v[e:], pose, frame)
            moving, bent, mx, my = _energies(lane, model.mesh, D, par, q[e:], v[e:], frame)
            kinetic, strain = kinetic + moving, strain + bent
            gravity = gravity - (mx + x * mass) * gx - (my + y * mass) * gy
        passed(lane, end_of(model, k, TIP_END), pose, ends)
    moved(lane, to_payload(model), pose)
    x, y = pair(lane, pose, POSE.x)
    vx, vy, w = vector(lane, pose, POSE.vx)
    mass = load(lane, par, PAYLOAD_MASS)
    kinetic = kinetic + ((vx * vx + vy * vy) * mass + (w * w) * load(lane, par, PAYLOAD_INERTIA)) * 0.5
    gravity = gravity - mass * (x * gx + y * gy)
    if model.rigid is not None:
        more, mx, my = vector(lane, ends, 0)
        kinetic, gravity = kinetic + more, gravity - (mx * gx + my * gy)
    return kinetic, strain, gravity


@unrolled
@kernel
def _ranges(lane, model, D, payload, q):
    """The tip's deflection over the length; what the inertia about the root has lost over what it may lose."""
    own = constants(model)
    y = dot(lane, model, D, own.tip_v, q)
    far, lost = y, splat(lane, 0.0)
    if model.chord is not None:  # against the tangent at the root
        turn, x = dot(lane, model, D, own.root, q), tip(lane, model, D, q)[0] + D[own.length]
        if model.modal is not None:
            x = x - product(lane, model, D, own.tip_H, q, q) * 0.5
        far = y - (turn - turn * (turn * turn) * (1.0 / 6.0)) * x
    if model.modal is not None:
        lost = product(lane, model, D, own.tip_H, q, q) * D[own.length] - y * y
        lost = (lost * payload - product(lane, model, D, own.G, q, q)) * (1.0 / D[own.most_lost])
    return absolute(far) * (1.0 / D[own.length]), lost


@kernel
def out_of_range(lane, model, par, q):
    """DIVERGED when a body's tip deflects beyond its length; OUT_OF_RANGE when a reduced link leaves its range: by its
    deflection, or by an inertia about its root that comes near to where the mass matrix is indefinite."""
    status, payload = splat(lane, 0.0), load(lane, par, PAYLOAD_MASS)
    for b in range(model.links * model.segments - 1, -1, -1):
        own = q[_elastic(model, b) * len(lane) :]
        deflection, lost = _ranges(lane, model.mesh, model.data[model.block * b :], payload, own)
        payload = splat(lane, 0.0)
        if model.mesh.modal is not None:
            far = select_lt(model.bound, deflection, splat(lane, 2.0), lost)
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
