"""A chain of floating frames without multipliers: residual, matrix, factors (model: `physics.model.FloatingChain`).

A frame begins where the body before it ends, so that its place and turn follow from the elastic coordinates before it:
rigid joints between segments need no rows. One sweep from root to tip gives every frame's motion, one back the forces;
the matrix is never formed, its blocks are eliminated body by body from the tip (an articulated body's inertia, but of
the whole tangent): the cost is linear in the number of bodies.

S holds `ROOT`, then a `JOINT` for each elbow and `FACTORS` for each body, then `LEVER_FACTORS` of rigid ends.
"""

from ...compiler import kernel, load, size, splat, stack, store
from ..arithmetic import add, fall, pair, put_pair, put_vector, vector
from ..layout import OF_LOAD
from ..model import PAYLOAD_INERTIA, PAYLOAD_MASS, FloatingChain
from ..protocol import register
from .body import carry, forces
from .chain_output import damping_work, energy, link_poses, out_of_range, ports, shape
from .layout import ANGLE, JOINT, KNOWN, LOADED, PASSED, ROOT, acts_at, cell, elastic_row, elbow_row, factors_at
from .matrix import condense, reduce, restore, tangent
from .rigid import ACROSS, ROOT_END, SWEPT, TIP_END, end_of, inward, near, outward, swept, to_payload, with_moment

THREE, FIVE, NINE = (0,) * 3, (0,) * 5, (0,) * 9
NUMBERS = (0,) * KNOWN.end


@kernel
def _stride(model):
    """Numbers of a body in S."""
    return factors_at(0, size(model.mesh.n)).end


@kernel
def _bodies_at(model):
    """Where the bodies' part of S begins."""
    return ROOT.end + JOINT.end * (model.links - 1)


@kernel
def _levers_at(model):
    """Where the part of the rigid ends begins."""
    return _bodies_at(model) + _stride(model) * model.links * model.segments


@kernel
def _joint_at(k):
    """Where the part of elbow k, from 1 on, begins."""
    return ROOT.end + JOINT.end * (k - 1)


@kernel
def frame_at(lane, model, state, i, pose):
    """pose <- angle at rows i of what moves as `state` tells, its rates, and the acceleration there less gravity."""
    q, v, a = state
    put_vector(pose, PASSED.angle, (load(lane, q, i + ANGLE), load(lane, v, i + ANGLE), load(lane, a, i + ANGLE)))
    ax, ay = pair(lane, a, i)
    put_pair(pose, PASSED.ax, (ax - fall(model.gravity, 0), ay - fall(model.gravity, 1)))


@kernel
def less_loads(lane, model, link, end, u, force):
    """force (x, y, moment) less the point loads at an end of a link."""
    if model.loads is not None:
        for f in range(model.loads.shape[0] // LOADED.end):
            if acts_at(model.loads, f, link, end):
                for i in range(3):
                    add(lane, force, i, -load(lane, u, model.links + OF_LOAD.end * f + i))


@kernel
def payload_force(lane, par, pose, force, carried):
    """force <- what the payload asks for at a pose; carried <- its mass and inertia."""
    mass, inertia = load(lane, par, PAYLOAD_MASS), load(lane, par, PAYLOAD_INERTIA)
    ax, ay = pair(lane, pose, PASSED.ax)
    put_vector(force, 0, (ax * mass, ay * mass, load(lane, pose, PASSED.second) * inertia))
    put_pair(carried, 0, (mass, inertia))


@kernel
def assemble(lane, model, par, state, u, weights, r, S):
    """r and, unless only that is asked for, the bodies' matrices."""
    (q, v, a), (cm, cc, ck) = state, weights
    mesh, L = model.mesh, len(lane)
    pose, force, carried = stack(lane, FIVE), stack(lane, THREE), stack(lane, THREE)
    known, vectors, strains = stack(lane, NUMBERS), stack(lane, mesh.scratch), stack(lane, mesh.strains)
    stride, first, levers = _stride(model), _bodies_at(model), _levers_at(model)
    frame_at(lane, model, state, 0, pose)
    for k in range(model.links):
        if k > 0:
            elbow = elbow_row(model, k)
            add(lane, pose, PASSED.angle, load(lane, q, elbow))
            add(lane, pose, PASSED.rate, load(lane, v, elbow))
            add(lane, pose, PASSED.second, load(lane, a, elbow))
        outward(lane, end_of(model, k, ROOT_END), pose, S, levers)
        for b in range(k * model.segments, (k + 1) * model.segments):
            e = elastic_row(model, b) * L
            carry(lane, mesh, model.data[model.block * b :], q[e:], v[e:], a[e:], pose, S[(first + stride * b) * L :])
        outward(lane, end_of(model, k, TIP_END), pose, S, levers)
    outward(lane, to_payload(model), pose, S, levers)
    payload_force(lane, par, pose, force, carried)
    inward(lane, to_payload(model), force, cm, cc, ck, S, levers)
    for k in range(model.links - 1, -1, -1):
        less_loads(lane, model, k, 1, u, force)
        inward(lane, end_of(model, k, TIP_END), force, cm, cc, ck, S, levers)
        for b in range((k + 1) * model.segments - 1, k * model.segments - 1, -1):
            e, D, own = elastic_row(model, b) * L, model.data[model.block * b :], S[(first + stride * b) * L :]
            forces(lane, mesh, D, par, carried, q[e:], v[e:], a[e:], force, known, vectors, strains, own, r[e:])
            if cm != 0.0:
                tangent(lane, mesh, D, par, carried, cm, cc, ck, q[e:], v[e:], a[e:], known, vectors, strains, own)
            put_pair(carried, 0, (splat(lane, 0.0), splat(lane, 0.0)))
        inward(lane, end_of(model, k, ROOT_END), force, cm, cc, ck, S, levers)
        less_loads(lane, model, k, 0, u, force)
        if k > 0:
            store(r, elbow_row(model, k), load(lane, force, 2) - load(lane, u, k))
    fx, fy, moment = vector(lane, force, 0)
    put_vector(r, 0, (fx, fy, moment - load(lane, u, 0)))
    if cm != 0.0:
        for k in range(3):
            store(S, ROOT.pinned + k, splat(lane, 0.0))
        for k in range(1, model.links):
            store(S, _joint_at(k) + JOINT.pinned, splat(lane, 0.0))
        put_pair(S, ROOT.scale, (splat(lane, cm), splat(lane, 1.0 / cm)))
        put_pair(S, ROOT.tail, (load(lane, par, PAYLOAD_INERTIA) * cm, load(lane, par, PAYLOAD_MASS)))


@kernel
def pin(lane, model, S, k):
    """Flag coordinate k, of the root or of an elbow, for `factor`."""
    slot = ROOT.pinned + k
    if k > 2:
        slot = _joint_at(k - elbow_row(model, 0)) + JOINT.pinned
    store(S, slot, splat(lane, 1.0))


@kernel
def stiffen(lane, model, S, k, x):
    """See `protocol`; kept for `factor`."""
    slot = ROOT.own
    if k > 2:
        slot = _joint_at(k - elbow_row(model, 0)) + JOINT.own
    store(S, slot, x)


@kernel
def _with_own(lane, model, S, at, x, y):
    """x and, in a jointed arm, what stands at S[at] for a joint, times y."""
    if model.jointed is None:
        return x
    return x + load(lane, S, at) * y


@kernel
def diagonal(tail, zero, mass, inertia):
    """tail <- the matrix of a body's force and moment at its centre."""
    put_vector(tail, cell(0, 0), (mass, zero, zero))
    put_vector(tail, cell(1, 0), (zero, mass, zero))
    put_vector(tail, cell(2, 0), (zero, zero, inertia))


@kernel
def factor(lane, model, S):
    """Bodies condensed from tip to root, and the root's three rows factored; inverse pivots are kept."""
    L, stride, first = len(lane), _stride(model), _bodies_at(model)
    tail, (inertia, mass) = stack(lane, NINE), pair(lane, S, ROOT.tail)
    zero, one = splat(lane, 0.0), splat(lane, 1.0)
    diagonal(tail, zero, mass, inertia)
    levers = _levers_at(model)
    near(lane, to_payload(model), S, levers, tail)
    for k in range(model.links - 1, -1, -1):
        near(lane, end_of(model, k, TIP_END), S, levers, tail)
        for b in range((k + 1) * model.segments - 1, k * model.segments - 1, -1):
            condense(lane, model.mesh, model.data[model.block * b :], S[(first + stride * b) * L :], tail)
        near(lane, end_of(model, k, ROOT_END), S, levers, tail)
        if k > 0:
            o = _joint_at(k)
            if S[(o + JOINT.pinned) * L] == 0.0:
                inverse = one / _with_own(lane, model, S, o + JOINT.own, load(lane, tail, cell(2, 2)), 1.0)
                store(S, o + JOINT.inverse, inverse)
                for i in range(2):
                    store(S, o + JOINT.column + i, load(lane, tail, cell(i, 2)) * inverse)
                    store(S, o + JOINT.row + i, load(lane, tail, cell(2, i)) * inverse)
                for i in range(2):
                    for j in range(2):
                        part = load(lane, S, o + JOINT.column + i) * load(lane, tail, cell(2, j))
                        store(tail, cell(i, j), load(lane, tail, cell(i, j)) - part)
                if model.jointed is None:  # nothing of the angle behind is left for that before
                    for i in range(3):
                        store(tail, cell(i, 2), zero)
                        store(tail, cell(2, i), zero)
                else:
                    share = load(lane, S, o + JOINT.own) * inverse
                    store(S, o + JOINT.own, share)
                    for i in range(2):
                        store(tail, cell(i, 2), load(lane, tail, cell(i, 2)) * share)
                        store(tail, cell(2, i), load(lane, tail, cell(2, i)) * share)
                    store(tail, cell(2, 2), load(lane, tail, cell(2, 2)) * share)
    store(tail, cell(2, 2), _with_own(lane, model, S, ROOT.own, load(lane, tail, cell(2, 2)), 1.0))
    for i in range(3):
        for j in range(3):
            entry = load(lane, tail, cell(i, j))
            if S[(ROOT.pinned + i) * L] != 0.0 or S[(ROOT.pinned + j) * L] != 0.0:
                entry = one if i == j else zero
            store(S, ROOT.factors + cell(i, j), entry)
    F = ROOT.factors
    for k in range(3):
        if S[(ROOT.pinned + k) * L] == 0.0:  # a row of the identity is its own factor
            inverse = one / load(lane, S, F + cell(k, k))
            store(S, F + cell(k, k), inverse)
            for i in range(k + 1, 3):
                f = load(lane, S, F + cell(i, k)) * inverse
                store(S, F + cell(i, k), f)
                for j in range(k + 1, 3):
                    store(S, F + cell(i, j), load(lane, S, F + cell(i, j)) - f * load(lane, S, F + cell(k, j)))


@kernel
def solve(lane, model, S, x):
    """x <- S^-1 x with the factors of `factor`."""
    mesh, L, stride, first = model.mesh, len(lane), _stride(model), _bodies_at(model)
    flow, levers, zero = stack(lane, THREE), _levers_at(model), splat(lane, 0.0)
    put_vector(flow, 0, (zero, zero, zero))
    for k in range(model.links - 1, -1, -1):
        with_moment(lane, end_of(model, k, TIP_END), S, levers, ACROSS, flow)
        for b in range((k + 1) * model.segments - 1, k * model.segments - 1, -1):
            D, own = model.data[model.block * b :], S[(first + stride * b) * L :]
            reduce(lane, mesh, D, own, x[elastic_row(model, b) * L :], flow)
        with_moment(lane, end_of(model, k, ROOT_END), S, levers, ACROSS, flow)
        if k > 0:
            o = _joint_at(k)
            if S[(o + JOINT.pinned) * L] == 0.0:
                wanted = load(lane, x, elbow_row(model, k))
                left = wanted - load(lane, flow, 2)
                for i in range(2):
                    add(lane, flow, i, load(lane, S, o + JOINT.column + i) * left)
                store(x, elbow_row(model, k), left)
                store(flow, 2, _with_own(lane, model, S, o + JOINT.own, wanted, -left))
    for i in range(3):
        right = load(lane, x, i)
        if S[(ROOT.pinned + i) * L] == 0.0:
            right = right - load(lane, flow, i)
        elif i < 2:
            right = right * load(lane, S, ROOT.scale)
        store(flow, i, right)
    F = ROOT.factors
    for i in range(1, 3):
        if S[(ROOT.pinned + i) * L] == 0.0:
            for j in range(i):
                add(lane, flow, i, -(load(lane, S, F + cell(i, j)) * load(lane, flow, j)))
    for i in range(2, -1, -1):
        if S[(ROOT.pinned + i) * L] == 0.0:
            total = load(lane, flow, i)
            for j in range(i + 1, 3):
                total = total - load(lane, S, F + cell(i, j)) * load(lane, flow, j)
            store(flow, i, total * load(lane, S, F + cell(i, i)))
    (dx, dy, turn), inverse = vector(lane, flow, 0), load(lane, S, ROOT.scale + 1)
    put_vector(x, 0, (dx * inverse, dy * inverse, turn))
    for k in range(model.links):
        if k > 0:
            o, before = _joint_at(k), load(lane, flow, 2)
            turn = before
            if S[(o + JOINT.pinned) * L] == 0.0:
                turn = load(lane, x, elbow_row(model, k)) * load(lane, S, o + JOINT.inverse)
                for i in range(2):
                    turn = turn - load(lane, S, o + JOINT.row + i) * load(lane, flow, i)
                turn = _with_own(lane, model, S, o + JOINT.own, turn, before)
            store(x, elbow_row(model, k), turn - before)
            store(flow, 2, turn)
        swept(lane, end_of(model, k, ROOT_END), S, levers, SWEPT, flow)
        for b in range(k * model.segments, (k + 1) * model.segments):
            D, own = model.data[model.block * b :], S[(first + stride * b) * L :]
            restore(lane, mesh, D, own, x[elastic_row(model, b) * L :], flow)
        swept(lane, end_of(model, k, TIP_END), S, levers, SWEPT, flow)


register(
    FloatingChain, assemble, pin, stiffen, factor, solve, ports, damping_work, energy, link_poses,
    out_of_range, shape,
)  # fmt: skip
