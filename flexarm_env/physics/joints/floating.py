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

_SUMS = (0,) * (3 * _MOTIONS)


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
    for k in range(_first(model), 2 if before is None else 3):  # forces at rest; with the momentum; that of a turn
        for j in range(n):
            store(still, j, splat(lane, 0.0))
            store(a, j, splat(lane, 0.0) if k != 1 else load(lane, v, j))
        if k == 2:
            _turn(lane, base, q, splat(lane, 1.0), a)
        protocol.assemble(lane, model, par, State(q, still, a), u, RESIDUAL_ALONE, r, S)
        _take_part(lane, base, q, r, sums[_MOTIONS * k * len(lane) :])
    x, y, turn = load(lane, sums, _X), load(lane, sums, _Y), load(lane, sums, _TURN)
    now = load(lane, sums, _MOTIONS + _X) - x, load(lane, sums, _MOTIONS + _Y) - y, load(lane, sums, 5) - turn
    push = -x, -y, -turn
    if before is None:
        return now, push
    was, pushed = before
    wanted = (
        was[0] + (pushed[0] + push[0]) * (0.5 * h), was[1] + (pushed[1] + push[1]) * (0.5 * h),
        was[2] + (pushed[2] + push[2]) * (0.5 * h),
    )  # fmt: skip
    # of a turn of 1 rad/s: momentum (-m y, m x) of the centre, and the inertia about the origin
    mx, my, inertia = load(lane, sums, 7) - y, x - load(lane, sums, 6), load(lane, sums, 8) - turn
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
    """1 where nothing acts from outside: what then is at rest, torques and strains, has no part in rigid motions."""
    if model.arm.loads is not None:
        return 0
    if model.arm.gravity is not None:
        return 0
    return 1


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
