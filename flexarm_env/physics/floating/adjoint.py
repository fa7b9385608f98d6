"""Derivatives backwards of a chain of floating frames without point loads: residual and poses.

What comes of a residual r from cotangents y is the gradient of y'r, the power of all forces at the rates y. As a sum
over bodies, levers and payload it needs of each its own forces alone: one sweep from root to tip, on which a section's
place and angle move at the rates that y gives them. Each one's share is written out backwards from its own source
(`compiler.vjp_of`), and they are gone back through from tip to root.
"""

from __future__ import annotations

from ...compiler import kernel, load, size, splat, stack, store, unrolled, vjp_of
from ..arithmetic import add, fall
from ..layout import OF_LOAD, POSE
from ..model import PAYLOAD_INERTIA, PAYLOAD_MASS, FloatingChain
from ..protocol import register
from .body import carry, constants, forces, product, tip, turn_of_root
from .chain_output import place
from .layout import KNOWN, NOW, PASSED, elastic_row, elbow_row
from .rigid import OF_FACTORS, ROOT_END, TIP_END, end_of, move, moved, reach, resist, to_payload

X, Y, TURN = range(PASSED.end, PASSED.end + 3)
"""Of a section, behind `PASSED`: the rates at which its place and its angle move."""
LENGTH = PASSED.end + 3
SECTION, HERE, NUMBERS, FACTORS = (0,) * LENGTH, (0,) * NOW.end, (0,) * KNOWN.end, (0,) * OF_FACTORS.end
ONE, TWO, THREE, SIX = (0,), (0,) * 2, (0,) * 3, (0,) * 6


@kernel
def _power(lane, force, x, y, turn):
    """Of a force and a moment where a section moves at these rates."""
    total = load(lane, force, OF_LOAD.x) * x + load(lane, force, OF_LOAD.y) * y
    return total + load(lane, force, OF_LOAD.torque) * turn


# --- a body -------------------------------------------------------------------------------------------
@unrolled
@kernel
def _pass(lane, model, D, q, v, a, rates, section, now):
    """section <- that at the body's tip, from that at its root; now <- a `NOW`."""
    w = load(lane, section, TURN) - turn_of_root(lane, model, D, rates)
    carry(lane, model, D, q, v, a, section, now)
    cos, sin = load(lane, now, NOW.cos), load(lane, now, NOW.sin)
    tx, ty, turn = tip(lane, model, D, rates)
    if model.modal is not None:
        tx = tx - product(lane, model, D, constants(model).tip_H, q, rates)
    tx, ty = tx - w * load(lane, now, NOW.tip + 1), ty + w * load(lane, now, NOW.tip)
    store(section, X, load(lane, section, X) + (cos * tx - sin * ty))
    store(section, Y, load(lane, section, Y) + (sin * tx + cos * ty))
    store(section, TURN, w + turn)


def _body(lane, model, D, par, carried, q, v, a, rates, section, power):
    """`_pass`, and the power of the body's own forces."""
    x, y, turn = load(lane, section, X), load(lane, section, Y), load(lane, section, TURN)
    now, force, r = stack(lane, HERE), stack(lane, THREE), stack(lane, model.n)
    known, vectors, strains = stack(lane, NUMBERS), stack(lane, model.scratch), stack(lane, model.strains)
    _pass(lane, model, D, q, v, a, rates, section, now)
    for i in range(3):
        store(force, i, splat(lane, 0.0))
    forces(lane, model, D, par, carried, q, v, a, force, known, vectors, strains, now, r)
    total = _power(lane, force, x, y, turn)
    for i in range(size(model.n)):
        total = total + load(lane, r, i) * load(lane, rates, i)
    store(power, 0, total)


_vjp_body = vjp_of(_body, ("par", "carried", "q", "v", "a", "section", "power"))


# --- a lever ------------------------------------------------------------------------------------------
@kernel
def _pass_over(lane, along, across, section, factors):
    """section <- that at a lever's far point, from that at its near one; factors <- what `resist` looks at."""
    reach(lane, along, across, section, factors, 0)
    turn = load(lane, section, TURN)
    store(section, X, load(lane, section, X) - turn * load(lane, factors, OF_FACTORS.ey))
    store(section, Y, load(lane, section, Y) + turn * load(lane, factors, OF_FACTORS.ex))


def _lever(lane, along, across, mass, inertia, far, section, power):
    """`_pass_over`, and the power of the lever's own forces."""
    x, y, turn = load(lane, section, X), load(lane, section, Y), load(lane, section, TURN)
    factors, force = stack(lane, FACTORS), stack(lane, THREE)
    _pass_over(lane, along, across, section, factors)
    for i in range(3):
        store(force, i, splat(lane, 0.0))
    resist(lane, mass, inertia, far, force, 0.0, 0.0, 0.0, factors, 0)
    store(power, 0, _power(lane, force, x, y, turn))


_vjp_lever = vjp_of(_lever, ("section", "power"))


@kernel
def _over(lane, own, section, room):
    """section <- that at the far point of a lever, where there is one; room <- what it was."""
    if own is not None:
        _keep(lane, section, room)
        _pass_over(lane, own.along, own.across, section, stack(lane, FACTORS))


@kernel
def _back_over(lane, own, room, section_bar):
    """The lever, backwards."""
    if own is not None:
        power_bar = stack(lane, ONE)
        store(power_bar, 0, splat(lane, 1.0))
        mass, inertia, far = own.mass, own.inertia, own.far
        _vjp_lever(lane, own.along, own.across, mass, inertia, far, room, room, section_bar, power_bar)


@kernel
def _payload(lane, par, par_bar, section, section_bar):
    """section_bar <- gradient of the payload's power by the section at its centre."""
    mass, inertia = load(lane, par, PAYLOAD_MASS), load(lane, par, PAYLOAD_INERTIA)
    ax, ay, second = load(lane, section, PASSED.ax), load(lane, section, PASSED.ay), load(lane, section, PASSED.second)
    x, y, turn = load(lane, section, X), load(lane, section, Y), load(lane, section, TURN)
    add(lane, par_bar, PAYLOAD_MASS, ax * x + ay * y)
    add(lane, par_bar, PAYLOAD_INERTIA, second * turn)
    store(section_bar, PASSED.angle, splat(lane, 0.0))
    store(section_bar, PASSED.rate, splat(lane, 0.0))
    store(section_bar, PASSED.second, inertia * turn)
    store(section_bar, PASSED.ax, mass * x)
    store(section_bar, PASSED.ay, mass * y)
    store(section_bar, X, mass * ax)
    store(section_bar, Y, mass * ay)
    store(section_bar, TURN, inertia * second)


# --- the chain ----------------------------------------------------------------------------------------
@kernel
def _keep(lane, section, room):
    for i in range(LENGTH):
        store(room, i, load(lane, section, i))


@kernel
def _room(lane, model, S, k, at_end):
    """Where the section before the lever at an end of link k is kept, behind those before the bodies: each takes less
    of S than its factors do."""
    bodies, levers = model.links * model.segments, 2 * k + at_end
    return S[LENGTH * (bodies + levers) * len(lane) :]


@kernel
def _go_out(lane, model, state, rates, section, S):
    """section <- the payload's; S <- those before each body and lever."""
    (q, v, a), L = state, len(lane)
    now = stack(lane, HERE)
    store(section, PASSED.angle, load(lane, q, 2))
    store(section, PASSED.rate, load(lane, v, 2))
    store(section, PASSED.second, load(lane, a, 2))
    store(section, PASSED.ax, load(lane, a, 0) - fall(model.gravity, 0))
    store(section, PASSED.ay, load(lane, a, 1) - fall(model.gravity, 1))
    for i in range(3):
        store(section, X + i, load(lane, rates, i))
    for k in range(model.links):
        if k > 0:
            elbow = elbow_row(model, k)
            add(lane, section, PASSED.angle, load(lane, q, elbow))
            add(lane, section, PASSED.rate, load(lane, v, elbow))
            add(lane, section, PASSED.second, load(lane, a, elbow))
            add(lane, section, TURN, load(lane, rates, elbow))
        _over(lane, end_of(model, k, ROOT_END), section, _room(lane, model, S, k, ROOT_END))
        for b in range(k * model.segments, (k + 1) * model.segments):
            e = elastic_row(model, b) * L
            _keep(lane, section, S[LENGTH * b * L :])
            _pass(lane, model.mesh, model.data[model.block * b :], q[e:], v[e:], a[e:], rates[e:], section, now)
        _over(lane, end_of(model, k, TIP_END), section, _room(lane, model, S, k, TIP_END))
    _over(lane, to_payload(model), section, _room(lane, model, S, model.links, ROOT_END))


@kernel
def _come_back(lane, model, par, par_bar, state, rates, S, section_bar, bar):
    """Cotangents of coordinates and parameters, from those of the payload's section; section_bar <- the root's."""
    (q, v, a), L = state, len(lane)
    carried, carried_bar, power_bar = stack(lane, TWO), stack(lane, TWO), stack(lane, ONE)
    store(carried, 0, load(lane, par, PAYLOAD_MASS))
    store(carried, 1, load(lane, par, PAYLOAD_INERTIA))
    for i in range(2):
        store(carried_bar, i, splat(lane, 0.0))
    _back_over(lane, to_payload(model), _room(lane, model, S, model.links, ROOT_END), section_bar)
    for k in range(model.links - 1, -1, -1):
        _back_over(lane, end_of(model, k, TIP_END), _room(lane, model, S, k, TIP_END), section_bar)
        for b in range((k + 1) * model.segments - 1, k * model.segments - 1, -1):
            D, e, room = model.data[model.block * b :], elastic_row(model, b) * L, S[LENGTH * b * L :]
            store(power_bar, 0, splat(lane, 1.0))
            _vjp_body(
                lane, model.mesh, D, par, carried, q[e:], v[e:], a[e:], rates[e:], room, room,
                par_bar, carried_bar, bar.q[e:], bar.v[e:], bar.a[e:], section_bar, power_bar,
            )  # fmt: skip
            if b + 1 == model.links * model.segments:
                add(lane, par_bar, PAYLOAD_MASS, load(lane, carried_bar, 0))
                add(lane, par_bar, PAYLOAD_INERTIA, load(lane, carried_bar, 1))
                store(carried, 0, splat(lane, 0.0))
                store(carried, 1, splat(lane, 0.0))
        _back_over(lane, end_of(model, k, ROOT_END), _room(lane, model, S, k, ROOT_END), section_bar)
        if k > 0:
            _turn_back(lane, section_bar, bar, elbow_row(model, k))
    _turn_back(lane, section_bar, bar, 2)
    add(lane, bar.a, 0, load(lane, section_bar, PASSED.ax))
    add(lane, bar.a, 1, load(lane, section_bar, PASSED.ay))


@kernel
def _turn_back(lane, section_bar, bar, i):
    """Cotangents of the joint's angle at row i."""
    add(lane, bar.q, i, load(lane, section_bar, PASSED.angle))
    add(lane, bar.v, i, load(lane, section_bar, PASSED.rate))
    add(lane, bar.a, i, load(lane, section_bar, PASSED.second))


@kernel
def vjp_residual(lane, model, par, par_bar, state, u, S, bar, u_bar, r_bar):
    """See `protocol`."""
    section, section_bar = stack(lane, SECTION), stack(lane, SECTION)
    _go_out(lane, model, state, r_bar, section, S)
    _payload(lane, par, par_bar, section, section_bar)
    _come_back(lane, model, par, par_bar, state, r_bar, S, section_bar, bar)
    add(lane, u_bar, 0, -load(lane, r_bar, 2))
    for k in range(1, model.links):
        add(lane, u_bar, k, -load(lane, r_bar, elbow_row(model, k)))
    for i in range(size(model.n)):
        store(r_bar, i, splat(lane, 0.0))


# --- poses --------------------------------------------------------------------------------------------
def _place(lane, model, D, q, v, pose):
    place(lane, model, D, q, v, pose, stack(lane, SIX))


_vjp_place = vjp_of(_place, ("q", "v", "pose"))
_vjp_move = vjp_of(move, ("pose",))


@kernel
def _moved_back(lane, own, pose, pose_bar):
    """`moved`, backwards; of pose, the one or the other, the angle and its rate are looked at."""
    if own is not None:
        _vjp_move(lane, own.along, own.across, pose, pose_bar)


@kernel
def _take(lane, bars, pose_bar):
    """Move cotangents of a pose."""
    for i in range(len(SIX)):
        add(lane, pose_bar, i, load(lane, bars, i))
        store(bars, i, splat(lane, 0.0))


@kernel
def vjp_poses(lane, model, par, par_bar, q, v, poses, q_bar, v_bar, poses_bar):
    """See `protocol`."""
    L = len(lane)
    pose, pose_bar, frame = stack(lane, SIX), stack(lane, SIX), stack(lane, SIX)
    for i in range(len(SIX)):
        store(pose_bar, i, splat(lane, 0.0))
    for k in range(model.links - 1, -1, -1):
        root, first = POSE.end * k, k * model.segments
        far = root + POSE.tip_x
        _take(lane, poses_bar[far * L :], pose_bar)
        _moved_back(lane, end_of(model, k, TIP_END), poses[far * L :], pose_bar)
        for b in range(first + model.segments - 1, first - 1, -1):
            for i in range(len(SIX)):
                store(pose, i, load(lane, poses, root + i))
            moved(lane, end_of(model, k, ROOT_END), pose)
            for j in range(first, b):
                e = elastic_row(model, j) * L
                place(lane, model.mesh, model.data[model.block * j :], q[e:], v[e:], pose, frame)
            D, e = model.data[model.block * b :], elastic_row(model, b) * L
            _vjp_place(lane, model.mesh, D, q[e:], v[e:], pose, q_bar[e:], v_bar[e:], pose_bar)
        _moved_back(lane, end_of(model, k, ROOT_END), poses[root * L :], pose_bar)
        _take(lane, poses_bar[root * L :], pose_bar)
        if k > 0:
            add(lane, q_bar, elbow_row(model, k), load(lane, pose_bar, POSE.angle))
            add(lane, v_bar, elbow_row(model, k), load(lane, pose_bar, POSE.rate))
    for i in range(3):
        add(lane, q_bar, i, load(lane, pose_bar, POSE.x + i))
        add(lane, v_bar, i, load(lane, pose_bar, POSE.vx + i))


register(FloatingChain, vjp_residual, vjp_poses)
