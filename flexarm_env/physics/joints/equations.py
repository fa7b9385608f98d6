"""What turns the joints of an arm: rotors, elastic gears and friction (model: `physics.model.Jointed`).

The arm's own equations see a joint's torque as an input. Here that torque is the gear's, of the difference of two
angles; the torque asked for acts on the motor, which has a row of its own:

    J psi'' + k (psi - q) + d (psi' - q') + friction = u,    the arm's row of q:  ... - k (psi - q) - d (psi' - q') = 0

Of all other rows the motor's is coupled with that of q alone. It is eliminated before the arm's matrix is factored: one
number more in its row of q (`protocol.stiffen`), one term more on the right, and the motor's increment follows from
the joint's. A gear that does not give leaves the rotor's inertia on q.

Backlash takes what is wound up by less than half of it from k (psi - q): a torque that is continuous, of a slope of k
or 0, which Newton's iteration finds with all else. The damping acts in the gap as well: if it began with contact,
contact would begin with a jump of the torque and end with a pull.
"""

from __future__ import annotations

from typing import Any

from ...compiler import NONE, absolute, by_kind, kernel, load, select_lt, size, splat, store
from .. import protocol
from ..arithmetic import clip
from ..layout import DISSIPATED
from ..model import Jointed
from ..protocol import RESIDUAL_ALONE, register
from .friction import bound_along, column_at, count, gear_at, hold, law, note_slip, rub, rub_along, view
from .layout import GEAR, PLACE, PLACES

_SLIPS = 0.99
"""Share of T_C from which a joint that moves slips."""


@kernel
def _known_friction(lane, coulomb, rate):
    """T_C against a rate that is prescribed."""
    zero = splat(lane, 0.0)
    return select_lt(zero, rate, coulomb, select_lt(rate, zero, -coulomb, zero))


@kernel
def _rest(lane, model, i, own, state, total):
    """The residual of the row that friction acts on, with viscous friction, and Coulomb's where the rate is known."""
    rate = load(lane, state.v, model.table[PLACES * i + PLACE.rubs])
    total = total + rate * own.viscous
    if model.table[PLACES * i + PLACE.known] != 0:
        total = total + _known_friction(lane, own.coulomb, rate)
    return total


@kernel
def _tight(lane, play, stiffness, half, wound):
    return wound * stiffness, stiffness


@kernel
def _loose(lane, play, stiffness, half, wound):
    beyond = wound - clip(wound, half)
    return beyond * stiffness, select_lt(0.0, absolute(beyond), stiffness, splat(lane, 0.0))


@by_kind("play", "lane, play, stiffness, half, wound")
def spring(kind: str) -> Any:
    """The torque of a gear's spring and its slope: a number, with backlash one in each lane."""
    return _tight if kind == NONE else _loose


@kernel
def _through_gear(lane, model, i, one, state, u, weights, r, S):
    """The motor's row, and the gear's torque in the joint's in place of the one asked for."""
    at, g = PLACES * i, gear_at(model, i)
    row, motor = model.table[at + PLACE.row], model.table[at + PLACE.motor]
    damping, rotor, none = one.damping, one.rotor, splat(lane, 0.0)
    rate, second = load(lane, state.v, motor), load(lane, state.a, motor)
    wound = load(lane, state.q, motor) - load(lane, state.q, row)
    torque, steep = spring(lane, model.play, one.stiffness, one.play, wound)
    torque = torque + (rate - load(lane, state.v, row)) * damping
    asked = load(lane, u, model.table[at + PLACE.joint])
    store(r, row, load(lane, r, row) + asked - torque)
    slope = steep * weights.stiffness + damping * weights.damping
    pivot = rotor * weights.mass + slope
    own = second * rotor + torque - asked
    if model.table[at + PLACE.rubs] == motor:
        pivot = pivot + one.viscous * weights.damping
        own = _rest(lane, model, i, one, state, own)
    store(r, motor, own)
    if weights.mass != 0.0:
        store(S, g + GEAR.pivot, none + pivot)
        store(S, g + GEAR.slope, none + slope)


@kernel
def _at_joint(lane, model, i, one, state, weights, r, S):
    """What acts on the joint's own angle: the rotor of a gear that does not give, friction on the link's side."""
    at, g = PLACES * i, gear_at(model, i)
    row = model.table[at + PLACE.row]
    total, own = load(lane, r, row), splat(lane, 0.0)
    if model.table[at + PLACE.motor] < 0:
        total, own = total + load(lane, state.a, row) * one.rotor, own + one.rotor * weights.mass
    if model.table[at + PLACE.rubs] == row:
        total, own = _rest(lane, model, i, one, state, total), own + one.viscous * weights.damping
    store(r, row, total)
    if weights.mass != 0.0:
        store(S, g + GEAR.own, own)


@kernel
def assemble(lane, model, par, state, u, weights, r, S):
    """The arm's own, and what turns its joints."""
    protocol.assemble(lane, model.arm, par, state, u, weights, r, S)
    for i in range(count(model)):
        one = law(lane, model, par, i)
        if model.table[PLACES * i + PLACE.motor] >= 0:
            _through_gear(lane, model, i, one, state, u, weights, r, S)
        _at_joint(lane, model, i, one, state, weights, r, S)
        if weights.mass != 0.0:
            store(S, gear_at(model, i) + GEAR.pinned, splat(lane, 0.0))
            store(S, gear_at(model, i) + GEAR.held, splat(lane, 0.0))


@kernel
def constrain(lane, model, psi, state, level, scale, r):
    """No constraint is left: joints are coordinates."""


@kernel
def pin(lane, model, S, k):
    """Flag a motor, or pin one of the arm's coordinates."""
    if k < size(model.arm.n):
        protocol.pin(lane, model.arm, S, k)
    for i in range(count(model)):
        g = gear_at(model, i)
        if model.table[PLACES * i + PLACE.motor] == k:
            store(S, g + GEAR.pinned, splat(lane, 1.0))
        if model.table[PLACES * i + PLACE.row] == k:
            store(S, g + GEAR.held, splat(lane, 1.0))


@kernel
def factor(lane, model, S):
    """Motors eliminated, and the arm's matrix factored."""
    for i in range(count(model)):
        g, row = gear_at(model, i), model.table[PLACES * i + PLACE.row]
        own = load(lane, S, g + GEAR.own)
        if model.table[PLACES * i + PLACE.motor] >= 0:
            inverse, slope = splat(lane, 0.0), load(lane, S, g + GEAR.slope)
            if S[(g + GEAR.pinned) * len(lane)] == 0.0:
                inverse = 1.0 / load(lane, S, g + GEAR.pivot)
            store(S, g + GEAR.pivot, inverse)
            own = own + (slope - slope * (slope * inverse))
        if S[(g + GEAR.held) * len(lane)] == 0.0:
            protocol.stiffen(lane, model.arm, S, row, own)
    protocol.factor(lane, model.arm, S)
    _note_columns(lane, model.rough, model, S)


@kernel
def _note_columns(lane, rough, model, S):
    """The columns of S^-1 of the rows that friction acts on; zero where that angle is prescribed."""
    if rough is not None:
        for i in range(count(model)):
            column = view(lane, S, column_at(model, i), size(model.n))
            for k in range(size(model.n)):
                store(column, k, splat(lane, 0.0))
            if model.table[PLACES * i + PLACE.known] == 0:
                store(column, model.table[PLACES * i + PLACE.rubs], splat(lane, 1.0))
                solve(lane, model, S, column)


@kernel
def solve(lane, model, S, x):
    """x <- S^-1 x with the factors of `factor`; a motor that is pinned keeps what stands in its row."""
    _without_motors(lane, model, S, x)
    protocol.solve(lane, model.arm, S, x)
    _turn_motors(lane, model, S, x)


@kernel
def solve_transposed(lane, model, S, x):
    """See `protocol`: motors are coupled with joints as these are with them."""
    _without_motors(lane, model, S, x)
    protocol.solve_transposed(lane, model.arm, S, x)
    _turn_motors(lane, model, S, x)


@kernel
def _without_motors(lane, model, S, x):
    for i in range(count(model)):
        at, g = PLACES * i, gear_at(model, i)
        row, motor = model.table[at + PLACE.row], model.table[at + PLACE.motor]
        if motor >= 0:
            if S[(g + GEAR.held) * len(lane)] == 0.0:
                share = load(lane, S, g + GEAR.slope) * load(lane, S, g + GEAR.pivot)
                store(x, row, load(lane, x, row) + share * load(lane, x, motor))


@kernel
def _turn_motors(lane, model, S, x):
    for i in range(count(model)):
        at, g = PLACES * i, gear_at(model, i)
        row, motor = model.table[at + PLACE.row], model.table[at + PLACE.motor]
        if motor >= 0:
            if S[(g + GEAR.pinned) * len(lane)] == 0.0:
                turned = load(lane, x, motor) + load(lane, S, g + GEAR.slope) * load(lane, x, row)
                store(x, motor, turned * load(lane, S, g + GEAR.pivot))


@kernel
def predict(lane, model, start, q):
    """The arm's own; motors stay where they are predicted."""
    protocol.predict(lane, model.arm, start, q)


@kernel
def update(lane, model, q, share, d, more):
    """The arm's own, and angles that add up."""
    protocol.update(lane, model.arm, q, share, d, more)
    for k in range(size(model.arm.n), size(model.n)):
        store(q, k, protocol.added(lane, q, share, d, more, k))


@kernel
def inertia(lane, model, par, a, r):
    """r <- M a."""
    protocol.inertia(lane, model.arm, par, a, r)
    for i in range(count(model)):
        row, motor = model.table[PLACES * i + PLACE.row], model.table[PLACES * i + PLACE.motor]
        rotor = law(lane, model, par, i).rotor
        if motor >= 0:
            store(r, motor, load(lane, a, motor) * rotor)
        else:
            store(r, row, load(lane, r, row) + load(lane, a, row) * rotor)


@kernel
def rotate(lane, model, start, q, share, x):
    """The arm's own."""
    protocol.rotate(lane, model.arm, start, q, share, x)


@kernel
def ports(lane, model, par, q, y):
    """The arm's own, but a torque works on its motor's angle."""
    protocol.ports(lane, model.arm, par, q, y)
    for i in range(count(model)):
        motor = model.table[PLACES * i + PLACE.motor]
        if motor >= 0:
            store(y, model.table[PLACES * i + PLACE.joint], load(lane, q, motor))


@kernel
def damping_work(lane, model, par, q, v, x):
    """The arm's own, the gears' damping and viscous friction."""
    total = protocol.damping_work(lane, model.arm, par, q, v, x)
    for i in range(count(model)):
        at, one = PLACES * i, law(lane, model, par, i)
        row, motor = model.table[at + PLACE.row], model.table[at + PLACE.motor]
        if motor >= 0:
            over = load(lane, x, motor) - load(lane, x, row)
            total = total + (load(lane, v, motor) - load(lane, v, row)) * over * one.damping
        rubs = model.table[at + PLACE.rubs]
        total = total + load(lane, v, rubs) * load(lane, x, rubs) * one.viscous
    return total


@kernel
def _beyond(play, half, wound):
    """How far a gear's spring is wound."""
    if play is None:
        return wound
    return wound - clip(wound, half)


@kernel
def energy(lane, model, par, q, v):
    """(kinetic, strain, gravity), J: with the rotors' energy and that in the gears."""
    kinetic, strain, gravity = protocol.energy(lane, model.arm, par, q, v)
    for i in range(count(model)):
        row, motor = model.table[PLACES * i + PLACE.row], model.table[PLACES * i + PLACE.motor]
        turns, one = row, law(lane, model, par, i)
        if motor >= 0:
            turns, wound = motor, load(lane, q, motor) - load(lane, q, row)
            wound = _beyond(model.play, one.play, wound)
            strain = strain + wound * wound * (one.stiffness * 0.5)
        rate = load(lane, v, turns)
        kinetic = kinetic + rate * rate * (one.rotor * 0.5)
    return kinetic, strain, gravity


@kernel
def note_friction(lane, model, par, state, u, r, S):
    """See `protocol`."""
    _note(lane, model.rough, model, par, state, u, r, S)


@kernel
def _note(lane, rough, model, par, state, u, r, S):
    """Friction is what the other forces of its row leave over."""
    if rough is not None:
        assemble(lane, model, par, state, u, RESIDUAL_ALONE, r, S)
        for i in range(count(model)):
            g, row = gear_at(model, i), model.table[PLACES * i + PLACE.rubs]
            coulomb, rate, rest = law(lane, model, par, i).coulomb, load(lane, state.v, row), load(lane, r, row)
            zero, one, torque = splat(lane, 0.0), splat(lane, 1.0), clip(-rest, coulomb)
            free = select_lt(coulomb, absolute(rest), zero, one)
            if model.table[PLACES * i + PLACE.known] != 0:
                torque, free = _known_friction(lane, coulomb, rate), zero
            else:
                store(r, row, rest + torque)
            store(S, g + GEAR.before, torque)
            store(S, g + GEAR.free, free)
            slides = select_lt(zero, torque * rate, one, zero)
            store(S, g + GEAR.slides, select_lt(absolute(torque), _SLIPS * coulomb, zero, slides))


@kernel
def book_friction(lane, model, par, state, u, r, S, start, books):
    """See `protocol`."""
    _book(lane, model.rough, model, par, state, u, r, S, start, books)


@kernel
def _book(lane, rough, model, par, state, u, r, S, start, books):
    if rough is not None:
        total = load(lane, books, DISSIPATED)
        for i in range(count(model)):
            g, k = gear_at(model, i), model.table[PLACES * i + PLACE.rubs]
            moved = load(lane, state.q, k) - load(lane, start, k)
            total = total + load(lane, S, g + GEAR.before) * moved * 0.5
        _note(lane, rough, model, par, state, u, r, S)
        for i in range(count(model)):
            g, k = gear_at(model, i), model.table[PLACES * i + PLACE.rubs]
            moved = load(lane, state.q, k) - load(lane, start, k)
            total = total + load(lane, S, g + GEAR.before) * moved * 0.5
        store(books, DISSIPATED, total)


@kernel
def link_poses(lane, model, par, q, v, out):
    """The arm's own."""
    protocol.link_poses(lane, model.arm, par, q, v, out)


@kernel
def out_of_range(lane, model, par, q):
    """The arm's own."""
    return protocol.out_of_range(lane, model.arm, par, q)


@kernel
def shape(model, q, points):
    """The arm's own."""
    return protocol.shape(model.arm, q, points)


register(
    Jointed,
    assemble=assemble,
    constrain=constrain,
    pin=pin,
    factor=factor,
    solve=solve,
    solve_transposed=solve_transposed,
    predict=predict,
    update=update,
    inertia=inertia,
    rotate=rotate,
    ports=ports,
    damping_work=damping_work,
    energy=energy,
    note_friction=note_friction,
    rub=rub,
    hold=hold,
    note_slip=note_slip,
    bound_along=bound_along,
    rub_along=rub_along,
    book_friction=book_friction,
    link_poses=link_poses,
    out_of_range=out_of_range,
    shape=shape,
)
