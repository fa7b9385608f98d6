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

from ...compiler import absolute, inlined, kernel, load, select_lt, size, splat, store
from .. import protocol
from ..arithmetic import add, clip, put
from ..layout import BASE_POSE
from ..model import Jointed
from ..protocol import FORMULATIONS, register
from . import floating
from .friction import count, direction, gear_at, hub_of, law, note_columns
from .layout import GEAR, PLACE, PLACES


@kernel
def _rest(lane, model, i, own, state, total):
    """The residual of the row that friction acts on, with viscous friction, and Coulomb's where the rate is known."""
    rate = load(lane, state.v, model.table[PLACES * i + PLACE.friction])
    total = total + rate * own.viscous
    if model.table[PLACES * i + PLACE.known] != 0:
        total = total + own.coulomb * direction(lane, rate)
    return total


@kernel
def spring(lane, play, stiffness, half, wound):
    """The torque of a gear's spring and its slope: a number, with backlash one in each lane."""
    if play is None:
        return wound * stiffness, stiffness
    beyond = wound - clip(wound, half)
    return beyond * stiffness, select_lt(0.0, absolute(beyond), stiffness, splat(lane, 0.0))


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
    if model.table[at + PLACE.friction] == motor:
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
    if model.table[at + PLACE.friction] == row:
        total, own = _rest(lane, model, i, one, state, total), own + one.viscous * weights.damping
    store(r, row, total)
    if weights.mass != 0.0:
        store(S, g + GEAR.own, own)


@kernel
def _spin_rotors(lane, model, par, state, weights, S):
    """Tell the arm how fast its rotors turn: by that their momentum along an axis that turns asks for a moment."""
    for i in range(count(model)):
        at, share = PLACES * i, law(lane, model, par, i).rotor * model.spin[i]
        row, motor = model.table[at + PLACE.row], model.table[at + PLACE.motor]
        rate = load(lane, state.v, motor if motor >= 0 else row)
        protocol.gyrate(lane, model.arm, S, model.table[at + PLACE.joint], rate * share)
        if weights.mass != 0.0:
            store(S, gear_at(model, i) + GEAR.sway, splat(lane, 0.0) + share * weights.damping)


@kernel
def assemble(lane, model, par, state, u, weights, r, S):
    """The arm's own, and what turns its joints."""
    if model.spin is not None:
        _spin_rotors(lane, model, par, state, weights, S)
    protocol.assemble(lane, model.arm, par, state, u, weights, r, S)
    for i in range(count(model)):
        one = law(lane, model, par, i)
        if model.table[PLACES * i + PLACE.motor] >= 0:
            _through_gear(lane, model, i, one, state, u, weights, r, S)
        _at_joint(lane, model, i, one, state, weights, r, S)
        if weights.mass != 0.0:
            store(S, gear_at(model, i) + GEAR.pinned, splat(lane, 0.0))
            store(S, gear_at(model, i) + GEAR.held, splat(lane, 0.0))
    if model.hub is not None:
        row, hub = model.table[PLACE.row], hub_of(lane, model, par)
        add(lane, r, row, load(lane, state.a, row) * hub)
        if weights.mass != 0.0:
            add(lane, S, gear_at(model, 0) + GEAR.own, hub * weights.mass)
    if model.base is not None:
        store(r, model.base.row, load(lane, state.a, model.base.row) * model.base.inertia + load(lane, u, 0))
        if weights.mass != 0.0:
            store(S, size(model.n_factor) - 1, splat(lane, model.base.inertia * weights.mass))


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
        own, through = load(lane, S, g + GEAR.own), splat(lane, 1.0)
        if model.table[PLACES * i + PLACE.motor] >= 0:
            inverse, slope = splat(lane, 0.0), load(lane, S, g + GEAR.slope)
            if S[(g + GEAR.pinned) * len(lane)] == 0.0:
                inverse = 1.0 / load(lane, S, g + GEAR.pivot)
            store(S, g + GEAR.pivot, inverse)
            own, through = own + (slope - slope * (slope * inverse)), slope * inverse
        if model.spin is not None:
            share = load(lane, S, g + GEAR.sway) * through
            protocol.lean(lane, model.arm, S, model.table[PLACES * i + PLACE.joint], share)
        if S[(g + GEAR.held) * len(lane)] == 0.0:
            protocol.stiffen(lane, model.arm, S, row, own)
    protocol.factor(lane, model.arm, S)
    note_columns(lane, model, S)


@kernel
def solve(lane, model, S, x):
    """x <- S^-1 x with the factors of `factor`; a motor that is pinned keeps what stands in its row."""
    _without_motors(lane, model, S, x, False)
    protocol.solve(lane, model.arm, S, x)
    _turn_motors(lane, model, S, x, False)
    _turn_base(lane, model, S, x)


@kernel
def solve_transposed(lane, model, S, x):
    """See `protocol`: motors are coupled with joints as these are with them."""
    _without_motors(lane, model, S, x, True)
    protocol.solve_transposed(lane, model.arm, S, x)
    _turn_motors(lane, model, S, x, True)
    _turn_base(lane, model, S, x)


@kernel
def _turn_base(lane, model, S, x):
    """A base that floats: its row is coupled with no other."""
    if model.base is not None:
        store(x, model.base.row, load(lane, x, model.base.row) / load(lane, S, size(model.n_factor) - 1))


@kernel
def multiply(lane, model, S, x, y):
    """See `protocol`: the arm's own, motors, and what is on the joints themselves."""
    protocol.multiply(lane, model.arm, S, x, y)
    for i in range(count(model)):
        at, g = PLACES * i, gear_at(model, i)
        row, motor = model.table[at + PLACE.row], model.table[at + PLACE.motor]
        turned = load(lane, x, row)
        add(lane, y, row, load(lane, S, g + GEAR.own) * turned)
        if motor >= 0:
            slope, wound = load(lane, S, g + GEAR.slope), load(lane, x, motor)
            add(lane, y, row, slope * (turned - wound))
            add(lane, y, motor, load(lane, S, g + GEAR.pivot) * wound - slope * turned)
            turned = wound
        if model.spin is not None:
            column = _sway_of(lane, model, S, i)
            for j in range(len(column)):
                add(lane, y, row - len(column) + j, column[j] * turned)
    if model.base is not None:
        add(lane, y, model.base.row, load(lane, S, size(model.n_factor) - 1) * load(lane, x, model.base.row))


@kernel
def _sway_of(lane, model, S, i):
    """The column of a motor's rate in the three rows before its joint's."""
    a, b, c = protocol.sway(lane, model.arm, S, model.table[PLACES * i + PLACE.joint])
    share = load(lane, S, gear_at(model, i) + GEAR.sway)
    return a * share, b * share, c * share


@kernel
def _without_motors(lane, model, S, x, across):
    """across: of the transposed system."""
    for i in range(count(model)):
        at, g = PLACES * i, gear_at(model, i)
        row, motor = model.table[at + PLACE.row], model.table[at + PLACE.motor]
        if motor >= 0 and S[(g + GEAR.held) * len(lane)] == 0.0:
            share = load(lane, S, g + GEAR.slope) * load(lane, S, g + GEAR.pivot)
            store(x, row, load(lane, x, row) + share * load(lane, x, motor))
        if model.spin is not None and not across:
            if motor >= 0:
                column, turned = _sway_of(lane, model, S, i), load(lane, x, motor) * load(lane, S, g + GEAR.pivot)
                for j in range(len(column)):
                    add(lane, x, row - len(column) + j, -(column[j] * turned))


@kernel
def _turn_motors(lane, model, S, x, across):
    for i in range(count(model)):
        at, g = PLACES * i, gear_at(model, i)
        row, motor = model.table[at + PLACE.row], model.table[at + PLACE.motor]
        if motor >= 0 and S[(g + GEAR.pinned) * len(lane)] == 0.0:
            turned = load(lane, x, motor) + load(lane, S, g + GEAR.slope) * load(lane, x, row)
            if model.spin is not None and across:
                column = _sway_of(lane, model, S, i)
                for j in range(len(column)):
                    turned = turned - column[j] * load(lane, x, row - len(column) + j)
            store(x, motor, turned * load(lane, S, g + GEAR.pivot))


@kernel
def update(lane, model, q, share, d, more):
    """The arm's own, and angles that add up."""
    protocol.update(lane, model.arm, q, share, d, more)
    for k in range(size(model.arm.n), size(model.n)):
        store(q, k, protocol.added(lane, q, share, d, more, k))


@kernel
def difference(lane, model, start, q, d):
    """The arm's own, and angles that add up."""
    protocol.difference(lane, model.arm, start, q, d)
    for k in range(size(model.arm.n), size(model.n)):
        store(d, k, load(lane, q, k) - load(lane, start, k))


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
    if model.hub is not None:
        add(lane, r, model.table[PLACE.row], load(lane, a, model.table[PLACE.row]) * hub_of(lane, model, par))
    if model.base is not None:
        store(r, model.base.row, load(lane, a, model.base.row) * model.base.inertia)


@kernel
def ports(lane, model, par, q, y):
    """The arm's own, but a torque works on its motor's angle, and the hub's turns a base that floats back."""
    protocol.ports(lane, model.arm, par, q, y)
    _at_motors(lane, model, q, y)


@kernel
def ports_after(lane, model, par, start, y0, q, y):
    """Likewise."""
    protocol.ports_after(lane, model.arm, par, start, y0, q, y)
    _at_motors(lane, model, q, y)


@kernel
def _at_motors(lane, model, q, y):
    for i in range(count(model)):
        motor = model.table[PLACES * i + PLACE.motor]
        if motor >= 0:
            store(y, model.table[PLACES * i + PLACE.joint], load(lane, q, motor))
    if model.base is not None:
        store(y, 0, load(lane, y, 0) - load(lane, q, model.base.row))


@kernel
def friction(model):
    """See `protocol`."""
    return model.friction


@kernel
def damping_work(lane, model, par, q, v, x):
    """The arm's own, the gears' damping and viscous friction."""
    return _damped(lane, model, par, v, x, protocol.damping_work(lane, model.arm, par, q, v, x))


@kernel
def damping_over(lane, model, par, q, v, start, end, x, h):
    """Likewise."""
    return _damped(lane, model, par, v, x, protocol.damping_over(lane, model.arm, par, q, v, start, end, x, h))


@inlined
def _damped(lane, model, par, v, x, total):
    for i in range(count(model)):
        at, one = PLACES * i, law(lane, model, par, i)
        row, motor = model.table[at + PLACE.row], model.table[at + PLACE.motor]
        if motor >= 0:
            over = load(lane, x, motor) - load(lane, x, row)
            total = total + (load(lane, v, motor) - load(lane, v, row)) * over * one.damping
        own = model.table[at + PLACE.friction]
        total = total + load(lane, v, own) * load(lane, x, own) * one.viscous
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
    if model.hub is not None:
        rate = load(lane, v, model.table[PLACE.row])
        kinetic = kinetic + rate * rate * (hub_of(lane, model, par) * 0.5)
    if model.base is not None:
        rate = load(lane, v, model.base.row)
        kinetic = kinetic + rate * rate * (model.base.inertia * 0.5)
    return kinetic, strain, gravity


@kernel
def stand(lane, model, live, angles, rates, q, v):
    """The arm's own, and gears without a torque."""
    protocol.stand(lane, model.arm, live, angles, rates, q, v)
    for i in range(count(model)):
        row, motor = model.table[PLACES * i + PLACE.row], model.table[PLACES * i + PLACE.motor]
        if motor >= 0:
            put(live, q, motor, load(lane, q, row), load(lane, q, motor))
            if rates is not None:
                put(live, v, motor, load(lane, rates, motor), load(lane, v, motor))


@kernel
def vjp_residual(lane, model, par, par_bar, state, u, S, bar, u_bar, r_bar):
    """See `protocol`, for laws that all arms share. Of rotors that turn in space the arm's own equations ask for the
    momentum."""
    if model.spin is not None:
        protocol.vjp_source(lane, model, par, par_bar, state, u, S, bar, u_bar, r_bar)
    else:
        _vjp_laws(lane, model, par, state, bar, u_bar, r_bar)
        protocol.vjp_residual(lane, model.arm, par, par_bar, state, u, S, bar, u_bar, r_bar)


@kernel
def task_poses(lane, model, par, q, v, out):
    """The arm's own; behind them the attitude of a base that floats and its rate."""
    protocol.task_poses(lane, model.arm, par, q, v, out)
    if model.base is not None:
        at = out.shape[0] // len(lane) - BASE_POSE.end
        store(out, at + BASE_POSE.angle, load(lane, q, model.base.row))
        store(out, at + BASE_POSE.rate, load(lane, v, model.base.row))


@kernel
def conserve(lane, model, par, before, h, q, v, u, r, S):
    """The arm's own; of a base that floats and the arm that of both."""
    if model.base is not None:
        return floating.conserve(lane, model, par, before, h, q, v, u, r, S)
    return protocol.conserve(lane, model.arm, par, before, h, q, v, u, r, S)


@kernel
def _vjp_laws(lane, model, par, state, bar, u_bar, r_bar):
    if model.base is not None:
        add(lane, bar.a, model.base.row, load(lane, r_bar, model.base.row) * model.base.inertia)
        add(lane, u_bar, 0, load(lane, r_bar, model.base.row))
        store(r_bar, model.base.row, splat(lane, 0.0))
    if model.hub is not None:
        row = model.table[PLACE.row]
        add(lane, bar.a, row, load(lane, r_bar, row) * hub_of(lane, model, par))
    for i in range(count(model)):
        at, one = PLACES * i, law(lane, model, par, i)
        row, motor, own = model.table[at + PLACE.row], model.table[at + PLACE.motor], model.table[at + PLACE.friction]
        turned = motor if motor >= 0 else row
        add(lane, bar.a, turned, load(lane, r_bar, turned) * one.rotor)
        add(lane, bar.v, own, load(lane, r_bar, own) * one.viscous)
        if motor >= 0:
            torque = load(lane, r_bar, motor) - load(lane, r_bar, row)
            wound = load(lane, state.q, motor) - load(lane, state.q, row)
            _, steep = spring(lane, model.play, one.stiffness, one.play, wound)
            add(lane, u_bar, model.table[at + PLACE.joint], -torque)
            add(lane, bar.q, motor, torque * steep)
            add(lane, bar.q, row, -(torque * steep))
            add(lane, bar.v, motor, torque * one.damping)
            add(lane, bar.v, row, -(torque * one.damping))
            store(r_bar, motor, splat(lane, 0.0))


register(
    Jointed, assemble, pin, factor, solve, solve_transposed, multiply, update, difference, inertia, ports, ports_after,
    friction, damping_work, damping_over, energy, stand, vjp_residual, task_poses, conserve,
)  # fmt: skip
FORMULATIONS.delegate(
    Jointed, "arm", protocol.predict, protocol.settle, protocol.stride, protocol.lack, protocol.rotate,
    protocol.rotates, protocol.tangent_map, protocol.note_inverse, protocol.noted_inverse, protocol.light,
    protocol.keeps, protocol.link_poses, protocol.gauge, protocol.out_of_range, protocol.shape,
)  # fmt: skip
