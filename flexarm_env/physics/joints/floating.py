"""The momentum of an arm and the base that carries it and floats freely, and how steps keep it.

The base's centre of mass is at the hub, so that its mass is a mass at the arm's root and its attitude is turned by the
hub's torque alone, J psi'' = -u: a row that no other row is coupled with. u itself works on the angle between both.
"""

from __future__ import annotations

from ...compiler import kernel, load, size, splat, stack, store
from .. import protocol
from ..arithmetic import add
from ..model import PAYLOAD_MASS
from ..protocol import RESIDUAL_ALONE, State

_X, _Y, _TURN, _MOTIONS = range(4)
"""Rigid motions of the whole: 1 m/s along x, along y, 1 rad/s about the origin."""

_REST, _MOVING, _TURNED, _CASES = range(4)
"""What is summed up by them: forces at rest; these with the momentum; these with the momentum of a turn of 1 rad/s."""

_SUMS = (0,) * (_CASES * _MOTIONS)


@kernel
def conserve(lane, model, par, before, h, q, v, u, r, S):
    """See `protocol`: linear momentum and angular momentum about the origin, as M v takes part in rigid motions.

    Trapezoidal steps would leave the angular momentum a ripple of second order in the step, so that a base at rest
    would begin to turn. What is moved is the whole, as one rigid body: nothing else sees it.
    """
    n, base, sums = size(model.n), model.base, stack(lane, _SUMS)
    a, still = stack(lane, base.room), stack(lane, base.room)
    for k in range(_MOTIONS):
        store(sums, k, splat(lane, 0.0))
    for k in range(_first(model), _TURNED if before is None else _CASES):
        for j in range(n):
            store(still, j, splat(lane, 0.0))
            store(a, j, splat(lane, 0.0) if k != _MOVING else load(lane, v, j))
        if k == _TURNED:
            _turn(lane, base, q, splat(lane, 1.0), a)
        protocol.assemble(lane, model, par, State(q, still, a), u, RESIDUAL_ALONE, r, S)
        _take_part(lane, base, q, r, sums[_MOTIONS * k * len(lane) :])
    x, y, turn = _sums(lane, sums, _REST)
    moving = _sums(lane, sums, _MOVING)
    now, push = (moving[0] - x, moving[1] - y, moving[2] - turn), (-x, -y, -turn)
    if before is None:
        return now, push
    was, pushed = before
    wanted = (
        was[0] + (pushed[0] + push[0]) * (0.5 * h), was[1] + (pushed[1] + push[1]) * (0.5 * h),
        was[2] + (pushed[2] + push[2]) * (0.5 * h),
    )  # fmt: skip
    # of a turn of 1 rad/s: momentum (-m y, m x) of the centre, and the inertia about the origin
    turned = _sums(lane, sums, _TURNED)
    mx, my, inertia = turned[1] - y, x - turned[0], turned[2] - turn
    mass = load(lane, par, PAYLOAD_MASS) + base.mass
    dx, dy = wanted[0] - now[0], wanted[1] - now[1]
    rate = (wanted[2] - now[2] - (mx * dy - my * dx) / mass) / (inertia - (mx * mx + my * my) / mass)
    _turn(lane, base, q, rate, v)
    dx, dy = (dx + my * rate) / mass, (dy - mx * rate) / mass
    for j in range(0, base.places.shape[0], 2):
        add(lane, v, base.places[j], dx)
        add(lane, v, base.places[j + 1], dy)
    return wanted, push


@kernel
def _first(model):
    """The first case to sum up: where nothing acts from outside, forces at rest (torques, strains) come to nothing."""
    if model.arm.loads is not None:
        return _REST
    if model.arm.gravity is not None:
        return _REST
    return _MOVING


@kernel
def _sums(lane, sums, case):
    """Those of a case, by the three rigid motions."""
    at = _MOTIONS * case
    return load(lane, sums, at + _X), load(lane, sums, at + _Y), load(lane, sums, at + _TURN)


@kernel
def _turn(lane, base, q, rate, v):
    """v <- v and a turn of the whole about the origin."""
    for j in range(base.angles.shape[0]):
        add(lane, v, base.angles[j], rate)
    for j in range(0, base.vectors.shape[0], 2):
        x, y = base.vectors[j], base.vectors[j + 1]
        add(lane, v, x, -(load(lane, q, y) * rate))
        add(lane, v, y, load(lane, q, x) * rate)


@kernel
def _take_part(lane, base, q, r, sums):
    """sums <- what r, forces on the coordinates, comes to in each rigid motion."""
    x, y, turn = splat(lane, 0.0), splat(lane, 0.0), splat(lane, 0.0)
    for j in range(0, base.places.shape[0], 2):
        x, y = x + load(lane, r, base.places[j]), y + load(lane, r, base.places[j + 1])
    for j in range(base.angles.shape[0]):
        turn = turn + load(lane, r, base.angles[j])
    for j in range(0, base.vectors.shape[0], 2):
        at_x, at_y = base.vectors[j], base.vectors[j + 1]
        turn = turn + (load(lane, q, at_x) * load(lane, r, at_y) - load(lane, q, at_y) * load(lane, r, at_x))
    store(sums, _X, x)
    store(sums, _Y, y)
    store(sums, _TURN, turn)
