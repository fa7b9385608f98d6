"""What is read off an elastica's state: energies, ports, poses, shape (equations of motion: `equations`)."""

from ...compiler import kernel, load, sincos, size, splat, stack, store
from ..arithmetic import put_vector, share_of
from ..layout import OF_LOAD, POSE
from ..model import PAYLOAD_INERTIA, PAYLOAD_MASS, STIFFNESS_FACTOR, TAU_D
from .eccentric import less_rest, more_energy, payload_at, root_of
from .layout import X, Y, constants, load_at, node_angles, weighted


@kernel
def _tangents(lane, model, q, x, c, s):
    """x <- angles of the nodes, (c, s) <- e_j."""
    node_angles(lane, model, q, x)
    for i in range(size(model.links) * size(model.nodes)):
        sine, cosine = sincos(load(lane, x, i))
        store(c, i, cosine)
        store(s, i, sine)


@kernel
def _moving_tangents(lane, model, q, v, x, y, c, s, ex, ey):
    """And y <- rates of the angles, (ex, ey) <- e_j'."""
    _tangents(lane, model, q, x, c, s)
    node_angles(lane, model, v, y)
    for i in range(size(model.links) * size(model.nodes)):
        rate = load(lane, y, i)
        store(ex, i, -(load(lane, s, i) * rate))
        store(ey, i, load(lane, c, i) * rate)


@kernel
def _root(lane, model, q, c, s):
    """Position of the root; c, s: cosines and sines of the nodes' angles."""
    D = model.data
    at = constants(model)
    if model.root is not None:
        return root_of(lane, model, q, c, s)
    return splat(lane, D[at.root + X]), splat(lane, D[at.root + Y])


@kernel
def ports(lane, model, par, q, y):
    """Joint angles, then position and angle of the point of each load."""
    n, links = size(model.nodes), size(model.links)
    m = n * links
    for k in range(links):
        store(y, k, load(lane, q, k * n))
    if model.loads is not None:
        x, c, s = stack(lane, model.scratch), stack(lane, model.scratch), stack(lane, model.scratch)
        _tangents(lane, model, q, x, c, s)
        root_x, root_y = _root(lane, model, q, c, s)
        for f in range((size(model.n_inputs) - links) // OF_LOAD.end):
            at, k = load_at(model, f), links + OF_LOAD.end * f
            px, py = weighted(lane, model.loads, at.arm, c, m), weighted(lane, model.loads, at.arm, s, m)
            put_vector(y, k, (root_x + px, root_y + py, weighted(lane, model.loads, at.angle, x, m)))


@kernel
def _bending(lane, model, shares, x, y):
    """x' K y over all links, by their `shares`; x, y: angles or rates of the nodes.

    Differences from the root's keep spins exact.
    """
    D = model.data
    at = constants(model)
    n = size(model.nodes)
    total = splat(lane, 0.0)
    for k in range(size(model.links)):
        from_x, from_y = load(lane, x, k * n), load(lane, y, k * n)
        for i in range(1, n):
            row = splat(lane, 0.0)
            for j in range(1, n):
                row = row + (load(lane, y, k * n + j) - from_y) * D[at.K + (k * n + i) * n + j]
            total = total + share_of(shares, k, row * (load(lane, x, k * n + i) - from_x))
    return total


@kernel
def damping_work(lane, model, par, q, v, x):
    """x'C v of Kelvin-Voigt damping, W."""
    if model.damping is None:
        return splat(lane, 0.0)
    y, z = stack(lane, model.scratch), stack(lane, model.scratch)
    node_angles(lane, model, v, y)
    node_angles(lane, model, x, z)
    return _bending(lane, model, model.damping, z, y) * (load(lane, par, STIFFNESS_FACTOR) * load(lane, par, TAU_D))


@kernel
def energy(lane, model, par, q, v):
    """(kinetic, strain, gravity), J; gravity's is zero where the centre of mass is at the origin."""
    D = model.data
    at = constants(model)
    n, links = size(model.nodes), size(model.links)
    m = n * links
    payload = load(lane, par, PAYLOAD_MASS)
    x, y = stack(lane, model.scratch), stack(lane, model.scratch)
    c, s = stack(lane, model.scratch), stack(lane, model.scratch)
    ex, ey = stack(lane, model.scratch), stack(lane, model.scratch)
    _moving_tangents(lane, model, q, v, x, y, c, s, ex, ey)
    less_rest(lane, model, x)
    strain = _bending(lane, model, None, x, x) * (load(lane, par, STIFFNESS_FACTOR) * 0.5)
    if model.bends is not None:
        strain = strain + more_energy(lane, model, x) * load(lane, par, STIFFNESS_FACTOR)
    tip_x, tip_y = payload_at(lane, model, ex, ey)
    tip_spin = splat(lane, 0.0)
    for i in range(m - n, m):
        tip_spin = tip_spin + load(lane, y, i) * D[at.tips + i]
    twice = payload * (tip_x * tip_x + tip_y * tip_y) + load(lane, par, PAYLOAD_INERTIA) * (tip_spin * tip_spin)
    for i in range(m):
        px, py, rate, spin = splat(lane, 0.0), splat(lane, 0.0), load(lane, y, i), splat(lane, 0.0)
        for j in range(n):
            spin = spin + load(lane, y, i // n * n + j) * D[at.R + i * n + j]
        for j in range(m):
            px = px + load(lane, ex, j) * D[at.P + i * m + j]
            py = py + load(lane, ey, j) * D[at.P + i * m + j]
        twice = twice + (load(lane, ex, i) * px + load(lane, ey, i) * py + rate * spin)
    mass = payload + D[at.mass]
    if model.root is not None:
        vx, vy = root_of(lane, model, v, ex, ey)
        px = payload * tip_x + weighted(lane, D, at.b, ex, m)
        py = payload * tip_y + weighted(lane, D, at.b, ey, m)
        twice = twice + (mass * (vx * vx + vy * vy) + (vx * px + vy * py) * 2.0)
    gravity = splat(lane, 0.0)
    if model.gravity is not None:
        root_x, root_y = _root(lane, model, q, c, s)
        far_x, far_y = payload_at(lane, model, c, s)
        cx = payload * far_x + weighted(lane, D, at.b, c, m) + mass * root_x
        cy = payload * far_y + weighted(lane, D, at.b, s, m) + mass * root_y
        gravity = -(cx * D[at.gravity + X] + cy * D[at.gravity + Y])
    return twice * 0.5, strain, gravity


@kernel
def link_poses(lane, model, par, q, v, out):
    """Of each link: x, y, angle of its root and their rates, then those of its tip (`POSES`)."""
    D = model.data
    at = constants(model)
    n, links = size(model.nodes), size(model.links)
    x, y = stack(lane, model.scratch), stack(lane, model.scratch)
    c, s = stack(lane, model.scratch), stack(lane, model.scratch)
    ex, ey = stack(lane, model.scratch), stack(lane, model.scratch)
    _moving_tangents(lane, model, q, v, x, y, c, s, ex, ey)
    px, py = _root(lane, model, q, c, s)
    vx, vy = splat(lane, 0.0), splat(lane, 0.0)
    if model.root is not None:
        vx, vy = root_of(lane, model, v, ex, ey)
    for k in range(links):
        o = POSE.end * k
        put_vector(out, o + POSE.x, (px, py, load(lane, x, k * n)))
        put_vector(out, o + POSE.vx, (vx, vy, load(lane, y, k * n)))
        angle, rate = splat(lane, 0.0), splat(lane, 0.0)
        for i in range(k * n, k * n + n):
            px, py = px + load(lane, c, i) * D[at.w + i], py + load(lane, s, i) * D[at.w + i]
            vx, vy = vx + load(lane, ex, i) * D[at.w + i], vy + load(lane, ey, i) * D[at.w + i]
            angle, rate = angle + load(lane, x, i) * D[at.tips + i], rate + load(lane, y, i) * D[at.tips + i]
        put_vector(out, o + POSE.tip_x, (px, py, angle))
        put_vector(out, o + POSE.tip_vx, (vx, vy, rate))


@kernel
def shape(model, q, points):
    """Positions along the chain, into the first rows of `points`; returns how many."""
    D = model.data
    lane = (0,)
    m = size(model.links) * size(model.nodes)
    first = constants(model).points
    count = min((D.shape[0] - first) // m, points.shape[0])
    x, c, s = stack(lane, model.scratch), stack(lane, model.scratch), stack(lane, model.scratch)
    _tangents(lane, model, q, x, c, s)
    root_x, root_y = _root(lane, model, q, c, s)
    for p in range(count):
        points[p, 0] = root_x + weighted(lane, D, first + p * m, c, m)
        points[p, 1] = root_y + weighted(lane, D, first + p * m, s, m)
    return count
