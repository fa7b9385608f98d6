"""What is read off a chain in space whose links' strains are coordinates; see `output`."""

from __future__ import annotations

from ...compiler import kernel, load, splat, store
from ..arithmetic import put
from ..model import PAYLOAD_INERTIA, PAYLOAD_MASS
from ..protocol import added
from .chain import SpatialElastica, energy_of, place_at
from .layout import AXES, J, P, count_of, joint_row
from .moving import between, move_vertex
from .output import SECTIONS, _drawn, _tip_lever, root_of
from .rotations import (
    matrix,
    minus,
    plus,
    put_vector,
    times,
    turned,
    vector,
)
from .strained import bend_of, last_place, still, strain_row, strained_damping, strained_energy, tangent_at, turned_by
from .strained_layout import strained_at


@kernel
def update(lane, model, q, share, d, more):
    """See `protocol`: the base's rotation is moved by an increment in its own axes."""
    move_vertex(lane, q, 0, share, d, more)
    for k in range(AXES, model.n):
        store(q, k, added(lane, q, share, d, more, k))


@kernel
def difference(lane, model, start, q, d):
    """See `protocol`."""
    put_vector(d, 0, minus(vector(lane, q, 0), vector(lane, start, 0)))
    put_vector(d, 3, between(lane, start, q, 3))
    for k in range(AXES, model.n):
        store(d, k, load(lane, q, k) - load(lane, start, k))


@kernel
def _last(lane, model, q, v, k, root):
    """Where its strains have it."""
    if count_of(model, k) > 0:
        return last_place(lane, model, k, q, v, root)
    return root


SECTIONS.register(SpatialElastica, last_section=_last)


@kernel
def energy(lane, model, par, q, v):
    """(kinetic, strain, gravity), J."""
    tip = place_at(lane, q, v, 0)
    kinetic, strain, gravity = splat(lane, 0.0), splat(lane, 0.0), splat(lane, 0.0)
    for k in range(model.links):
        at = J.end * k
        if k > 0:
            mass = splat(lane, model.joints[at + J.near + P.mass])
            more, fall = energy_of(lane, model, model.joints, at + J.near, mass, None, tip)
            kinetic, gravity = kinetic + more, gravity + fall
        root = root_of(lane, model, q, v, k, tip)
        mass = splat(lane, model.joints[at + J.far + P.mass])
        more, fall = energy_of(lane, model, model.joints, at + J.far, mass, None, root)
        kinetic, gravity = kinetic + more, gravity + fall
        if count_of(model, k) > 0:
            more, bent, fall = strained_energy(lane, model, par, k, q, v, root)
            kinetic, strain, gravity = kinetic + more, strain + bent, gravity + fall
        tip = _last(lane, model, q, v, k, root)
    more, fall = energy_of(lane, model, model.end, 0, splat(lane, model.end[P.mass]), None, tip)
    kinetic, gravity = kinetic + more, gravity + fall
    mass, share = load(lane, par, PAYLOAD_MASS), load(lane, par, PAYLOAD_INERTIA)
    more, fall = energy_of(lane, model, model.payload, 0, mass, share, tip)
    return kinetic + more, strain, gravity + fall


@kernel
def damping_work(lane, model, par, q, v, x):
    """x'C(q) v of the material, W."""
    total = splat(lane, 0.0)
    if model.damped is not None:
        for k in range(model.links):
            if count_of(model, k) > 0:
                total = total + strained_damping(lane, model, par, k, v, x)
    return total


@kernel
def stand(lane, model, live, angles, rates, q, v):
    """See `protocol`; links are straight, and all rates but the base's are against what comes before."""
    for k in range(model.links):
        i = joint_row(model, k)
        put(live, q, i, load(lane, angles, k), load(lane, q, i))
        if count_of(model, k) > 0:
            for j in range(3 * len(model.polynomials)):
                put(live, q, i + 1 + j, splat(lane, 0.0), load(lane, q, i + 1 + j))
    if rates is not None:
        for j in range(AXES, model.n):
            put(live, v, j, load(lane, rates, j), load(lane, v, j))


@kernel
def shape(model, q, points):
    """Places along the chain into points (P, 3): the base, then of each link its beginning, its points, its tip; their
    number. None where points have two numbers: they are read off elsewhere."""
    if points.shape[1] < 3:
        return 0
    lane = (0,)
    tip, n = place_at(lane, q, q, 0), len(model.points)
    count = _drawn(points, 0, tip.r)
    for k in range(model.links):
        root = root_of(lane, model, q, q, k, tip)
        count = _drawn(points, count, root.r)
        if count_of(model, k) > 0:
            for i in range(n):
                count = _drawn(points, count, _point(lane, model, k, i, q, root))
        tip = _last(lane, model, q, q, k, root)
        A = matrix(tip.p)
        along = times((A[0][0], A[1][0], A[2][0]), _tip_lever(model, k))
        if count_of(model, k) == 0:
            for j in range(1, n + 1):
                count = _drawn(points, count, plus(tip.r, times(along, j / (n + 1.0))))
        count = _drawn(points, count, plus(tip.r, along))
    return count


@kernel
def _point(lane, model, k, i, q, root):
    """Where point i of link k is."""
    n, at, row, zero = len(model.points), strained_at(model, k), strain_row(model, k), splat(lane, 0.0)
    p, r = still(lane), (zero, zero, zero)
    for j in range(n):
        p = turned_by(bend_of(lane, model, at, j, row, q, None, None), p)
        r = plus(r, times(tangent_at(p), model.strains[at.ways + n * i + j]))
    return plus(root.r, turned(matrix(root.p), r))
