"""What turns the joints of an arm: rotors, elastic gears and friction (model: `physics.model.Jointed`).

The arm's own equations see a joint's torque as an input. Here that torque is the gear's, of the difference of two
angles; the torque asked for acts on the motor, which has a row of its own:

    J psi'' + k (psi - q) + d (psi' - q') + friction = u,    the arm's row of q:  ... - k (psi - q) - d (psi' - q') = 0

Of all other rows the motor's is coupled with that of q alone. It is eliminated before the arm's matrix is factored: one
number more in its row of q (`protocol.stiffen`), one term more on the right, and the motor's increment follows from
the joint's. A gear that does not give leaves the rotor's inertia on q.

Backlash takes what is wound up by less than half of it from k (psi - q): a torque that is continuous, whose slope is k
or 0, so that Newton's iteration finds what touches as it finds what sticks. The damping acts in the gap as well: were
it to begin with contact, contact would begin with a jump and end with a pull.

Coulomb friction is a set: |T| <= T_C at rest, T_C against the rate otherwise. With w = v + (h/2) a it is

    T = clip(share w - R, T_C),    R the row's residual without it, share > 0 any number:

within the bounds it is what w = 0 takes, and beyond them T_C sign(w). There is nothing to be resolved, hence no limit
on the step. w, and not v, so that what is stopped by friction is at rest two steps later: with v = 0 alone trapezoidal
steps would leave it an acceleration that alternates for ever.
"""

from __future__ import annotations

from ...compiler import absolute, kernel, load, select_lt, size, splat, store
from .. import protocol
from ..arithmetic import clip
from ..layout import DISSIPATED
from ..model import Jointed
from ..protocol import RESIDUAL_ALONE, register
from .layout import BEFORE, GEAR, GEARS, LAWS, LOOSE, PLACE, PLACES


@kernel
def _count(model):
    """How many joints there are with a law."""
    return model.table.shape[0] // PLACES


@kernel
def _gears_at(model):
    """Where the `GEARS` are in S."""
    return size(model.arm.n_factor)


@kernel
def _gear_at(model, i):
    """Where the `GEAR` of law i is in S."""
    return _gears_at(model) + GEARS.end + GEAR.end * i


@kernel
def _look(lane, S, g, ahead, share):
    """What friction is chosen by, see (6.6) of the theory."""
    store(S, g + GEAR.ahead, splat(lane, ahead))
    store(S, g + GEAR.share, splat(lane, share))


@kernel
def _known_friction(lane, coulomb, rate):
    """T_C against a rate that is prescribed."""
    zero = splat(lane, 0.0)
    return select_lt(zero, rate, splat(lane, coulomb), select_lt(rate, zero, splat(lane, -coulomb), zero))


@kernel
def _grip(lane, rough, model, i, rate, second, rest, pivot, near, weights, S):
    """A row's residual with Coulomb friction, and 1 where that holds it; `rest`, `pivot`: the row without it.

    near: inertia, less what viscous friction ends, that a change of the row's rate meets at once; None where it meets
    no other. Accelerations are solved for in a few passes, and what the other rows do is not known in the first of
    them: there friction acts against a rate that it could not end within half a step.
    """
    if rough is None:
        return rest, splat(lane, 0.0)
    g, zero, one = _gear_at(model, i), splat(lane, 0.0), splat(lane, 1.0)
    coulomb = model.data[LAWS.end * i + LAWS.coulomb]
    if weights.mass != 0.0:
        ahead = 0.5 * model.step
        if weights.damping != 0.0:
            ahead = weights.damping / weights.mass
        _look(lane, S, g, ahead, pivot / (weights.damping + ahead * weights.mass))
    push = (rate + second * load(lane, S, g + GEAR.ahead)) * load(lane, S, g + GEAR.share)
    wanted = push - rest
    torque = clip(wanted, coulomb)
    stuck = select_lt(absolute(wanted), coulomb, one, zero)
    if model.table[PLACES * i + PLACE.known] != 0:
        torque, stuck = _known_friction(lane, coulomb, rate), zero
    flag = S[(_gears_at(model) + GEARS.loose) * len(lane)]
    if near is not None:
        if flag == BEFORE or (weights.mass != 0.0 and weights.damping == 0.0):
            fast, bound = absolute(rate) * near, coulomb * 0.5 * model.step
            torque = select_lt(bound, fast, _known_friction(lane, coulomb, rate), torque)
            stuck = select_lt(bound, fast, zero, stuck)
    if flag == LOOSE:
        torque, stuck = zero, zero
    store(S, g + GEAR.torque, torque)
    way = select_lt(0.5, stuck, zero, select_lt(zero, torque, one, -one))
    turned = _gears_at(model) + GEARS.turned
    store(S, turned, load(lane, S, turned) + absolute(way - load(lane, S, g + GEAR.way)))
    store(S, g + GEAR.way, way)
    return select_lt(0.5, stuck, push, rest + torque), stuck


@kernel
def _flank(lane, wound, play):
    """1, -1 where the gear's flanks touch, driven forward or backward; 0 in the gap."""
    one = splat(lane, 1.0)
    return select_lt(play, wound, one, select_lt(wound, -play, -one, splat(lane, 0.0)))


@kernel
def _spring(lane, play, model, i, wound, S):
    """The spring's torque and its slope."""
    D, law = model.data, LAWS.end * i
    stiffness = D[law + LAWS.stiffness]
    if play is None:
        return wound * stiffness, stiffness
    half, g = D[law + LAWS.play], _gear_at(model, i)
    flank, turned = _flank(lane, wound, half), _gears_at(model) + GEARS.turned
    store(S, turned, load(lane, S, turned) + absolute(flank - load(lane, S, g + GEAR.flank)))
    store(S, g + GEAR.flank, flank)
    store(S, g + GEAR.wound, wound)
    return (wound - clip(wound, half)) * stiffness, absolute(flank) * stiffness


@kernel
def _wide(lane, play, x):
    """x in all lanes; with backlash it has one value in each."""
    if play is None:
        return splat(lane, x)
    return x


@kernel
def _held_pivot(lane, play, whole, pivot, stuck):
    """The pivot where friction holds the motor: with that of a gear that touches, see `_grip`."""
    if play is None:
        return splat(lane, pivot)
    return select_lt(0.5, stuck, splat(lane, whole), pivot)


@kernel
def _note_flank(lane, play, model, i, x, S):
    """Note where the increment -x takes a gear from contact to its gap, or from there to contact."""
    if play is not None:
        g, turned = _gear_at(model, i), _gears_at(model) + GEARS.turned
        row, motor = model.table[PLACES * i + PLACE.row], model.table[PLACES * i + PLACE.motor]
        wound = load(lane, S, g + GEAR.wound) - (load(lane, x, motor) - load(lane, x, row))
        flank = _flank(lane, wound, model.data[LAWS.end * i + LAWS.play])
        store(S, turned, load(lane, S, turned) + absolute(flank - load(lane, S, g + GEAR.flank)))


@kernel
def _through_gear(lane, model, i, state, u, weights, r, S):
    """The motor's row, and the gear's torque in the joint's in place of the one asked for."""
    law, at, g = LAWS.end * i, PLACES * i, _gear_at(model, i)
    D, row, motor = model.data, model.table[at + PLACE.row], model.table[at + PLACE.motor]
    stiffness, damping, rotor = D[law + LAWS.stiffness], D[law + LAWS.damping], D[law + LAWS.rotor]
    rate, second = load(lane, state.v, motor), load(lane, state.a, motor)
    wound = load(lane, state.q, motor) - load(lane, state.q, row)
    torque, steep = _spring(lane, model.play, model, i, wound, S)
    torque = torque + (rate - load(lane, state.v, row)) * damping
    asked = load(lane, u, model.table[at + PLACE.joint])
    store(r, row, load(lane, r, row) + asked - torque)
    slope = steep * weights.stiffness + damping * weights.damping
    pivot = rotor * weights.mass + slope
    whole = rotor * weights.mass + (stiffness * weights.stiffness + damping * weights.damping)
    own, stuck = second * rotor + torque - asked, splat(lane, 0.0)
    if model.table[at + PLACE.on_motor] != 0:
        viscous = D[law + LAWS.viscous]
        pivot, whole = pivot + viscous * weights.damping, whole + viscous * weights.damping
        own, stuck = _grip(lane, model.rough, model, i, rate, second, own + rate * viscous, whole, None, weights, S)
    store(r, motor, own)
    if weights.mass != 0.0:
        store(S, g + GEAR.pivot, _held_pivot(lane, model.play, whole, pivot, stuck))
        store(S, g + GEAR.slope, _wide(lane, model.play, slope))
        store(S, g + GEAR.back, (1.0 - stuck) * slope)


@kernel
def _at_joint(lane, model, i, state, weights, r, S):
    """What acts on the joint's own angle: the rotor of a gear that does not give, friction on the link's side."""
    law, at, g = LAWS.end * i, PLACES * i, _gear_at(model, i)
    D, row = model.data, model.table[at + PLACE.row]
    rate, second = load(lane, state.v, row), load(lane, state.a, row)
    total, own, stuck = load(lane, r, row), 0.0, splat(lane, 0.0)
    if model.table[at + PLACE.motor] < 0:
        rotor = D[law + LAWS.rotor]
        total, own = total + second * rotor, rotor * weights.mass
    if model.table[at + PLACE.on_motor] == 0:
        viscous, least = D[law + LAWS.viscous], D[law + LAWS.least] * weights.mass
        own = own + viscous * weights.damping
        rest, near = total + rate * viscous, D[law + LAWS.near] - 0.5 * model.step * viscous
        total, stuck = _grip(lane, model.rough, model, i, rate, second, rest, least, near, weights, S)
        if S[(_gears_at(model) + GEARS.loose) * len(lane)] != BEFORE:
            total = select_lt(0.5, stuck, total * D[law + LAWS.hold], total)
    store(r, row, total)
    if weights.mass != 0.0:
        store(S, g + GEAR.own, stuck * (D[law + LAWS.hold] * D[law + LAWS.least] * weights.mass) + own)


@kernel
def assemble(lane, model, par, state, u, weights, r, S):
    """The arm's own, and what turns its joints."""
    protocol.assemble(lane, model.arm, par, state, u, weights, r, S)
    store(S, _gears_at(model) + GEARS.turned, splat(lane, 0.0))
    for i in range(_count(model)):
        if model.table[PLACES * i + PLACE.motor] >= 0:
            _through_gear(lane, model, i, state, u, weights, r, S)
        _at_joint(lane, model, i, state, weights, r, S)
        if weights.mass != 0.0:
            store(S, _gear_at(model, i) + GEAR.pinned, splat(lane, 0.0))
            store(S, _gear_at(model, i) + GEAR.held, splat(lane, 0.0))


@kernel
def constrain(lane, model, psi, state, level, scale, r):
    """No constraint is left: joints are coordinates."""


@kernel
def pin(lane, model, S, k):
    """Flag a motor, or pin one of the arm's coordinates."""
    if k < size(model.arm.n):
        protocol.pin(lane, model.arm, S, k)
    for i in range(_count(model)):
        g = _gear_at(model, i)
        if model.table[PLACES * i + PLACE.motor] == k:
            store(S, g + GEAR.pinned, splat(lane, 1.0))
        if model.table[PLACES * i + PLACE.row] == k:
            store(S, g + GEAR.held, splat(lane, 1.0))


@kernel
def factor(lane, model, S):
    """Motors eliminated, and the arm's matrix factored."""
    for i in range(_count(model)):
        g, row = _gear_at(model, i), model.table[PLACES * i + PLACE.row]
        own = load(lane, S, g + GEAR.own)
        if model.table[PLACES * i + PLACE.motor] >= 0:
            inverse, slope = splat(lane, 0.0), load(lane, S, g + GEAR.slope)
            if S[(g + GEAR.pinned) * len(lane)] == 0.0:
                inverse = 1.0 / load(lane, S, g + GEAR.pivot)
            store(S, g + GEAR.pivot, inverse)
            own = own + (slope - slope * (load(lane, S, g + GEAR.back) * inverse))
        if S[(g + GEAR.held) * len(lane)] == 0.0:
            protocol.stiffen(lane, model.arm, S, row, own)
    protocol.factor(lane, model.arm, S)


@kernel
def solve(lane, model, S, x):
    """x <- S^-1 x with the factors of `factor`; a motor that is pinned keeps what stands in its row."""
    for i in range(_count(model)):
        at, g = PLACES * i, _gear_at(model, i)
        row, motor = model.table[at + PLACE.row], model.table[at + PLACE.motor]
        if motor >= 0:
            if S[(g + GEAR.held) * len(lane)] == 0.0:
                share = load(lane, S, g + GEAR.slope) * load(lane, S, g + GEAR.pivot)
                store(x, row, load(lane, x, row) + share * load(lane, x, motor))
    protocol.solve(lane, model.arm, S, x)
    for i in range(_count(model)):
        at, g = PLACES * i, _gear_at(model, i)
        row, motor = model.table[at + PLACE.row], model.table[at + PLACE.motor]
        if motor >= 0:
            if S[(g + GEAR.pinned) * len(lane)] == 0.0:
                turned = load(lane, x, motor) + load(lane, S, g + GEAR.back) * load(lane, x, row)
                store(x, motor, turned * load(lane, S, g + GEAR.pivot))
            _note_flank(lane, model.play, model, i, x, S)


@kernel
def predict(lane, model, start, q):
    """The arm's own; motors stay where they are predicted."""
    protocol.predict(lane, model.arm, start, q)


@kernel
def update(lane, model, q, d):
    """The arm's own, and angles that add up."""
    protocol.update(lane, model.arm, q, d)
    for k in range(size(model.arm.n), size(model.n)):
        store(q, k, load(lane, q, k) + load(lane, d, k))


@kernel
def inertia(lane, model, par, a, r):
    """r <- M a."""
    protocol.inertia(lane, model.arm, par, a, r)
    for i in range(_count(model)):
        row, motor = model.table[PLACES * i + PLACE.row], model.table[PLACES * i + PLACE.motor]
        rotor = model.data[LAWS.end * i + LAWS.rotor]
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
    for i in range(_count(model)):
        motor = model.table[PLACES * i + PLACE.motor]
        if motor >= 0:
            store(y, model.table[PLACES * i + PLACE.joint], load(lane, q, motor))


@kernel
def damping_work(lane, model, par, q, v, x):
    """The arm's own, the gears' damping and viscous friction."""
    total = protocol.damping_work(lane, model.arm, par, q, v, x)
    for i in range(_count(model)):
        law, at = LAWS.end * i, PLACES * i
        row, motor = model.table[at + PLACE.row], model.table[at + PLACE.motor]
        rubs = row
        if motor >= 0:
            over = load(lane, x, motor) - load(lane, x, row)
            total = total + (load(lane, v, motor) - load(lane, v, row)) * over * model.data[law + LAWS.damping]
            if model.table[at + PLACE.on_motor] != 0:
                rubs = motor
        total = total + load(lane, v, rubs) * load(lane, x, rubs) * model.data[law + LAWS.viscous]
    return total


@kernel
def _beyond_play(play, half, wound):
    """How far a gear's spring is wound."""
    if play is None:
        return wound
    return wound - clip(wound, half)


@kernel
def energy(lane, model, par, q, v):
    """(kinetic, strain, gravity), J: with the rotors' energy and that in the gears."""
    kinetic, strain, gravity = protocol.energy(lane, model.arm, par, q, v)
    for i in range(_count(model)):
        law, row, motor = LAWS.end * i, model.table[PLACES * i + PLACE.row], model.table[PLACES * i + PLACE.motor]
        turns = row
        if motor >= 0:
            turns, wound = motor, load(lane, q, motor) - load(lane, q, row)
            wound = _beyond_play(model.play, model.data[law + LAWS.play], wound)
            strain = strain + wound * wound * (0.5 * model.data[law + LAWS.stiffness])
        rate = load(lane, v, turns)
        kinetic = kinetic + rate * rate * (0.5 * model.data[law + LAWS.rotor])
    return kinetic, strain, gravity


@kernel
def loosen(lane, model, S, loose):
    """See `protocol`."""
    store(S, _gears_at(model) + GEARS.loose, splat(lane, loose))


@kernel
def begin_friction(lane, model, S):
    """See `protocol`: friction is chosen as where accelerations are solved for."""
    _begin(lane, model.rough, model, S)


@kernel
def _begin(lane, rough, model, S):
    if rough is not None:
        store(S, _gears_at(model) + GEARS.loose, splat(lane, BEFORE))
        for i in range(_count(model)):
            law, ahead = LAWS.end * i, 0.5 * model.step
            inertia = model.data[law + LAWS.least]
            if model.table[PLACES * i + PLACE.on_motor] != 0:
                inertia = model.data[law + LAWS.rotor]
            _look(lane, S, _gear_at(model, i), ahead, inertia / ahead)


@kernel
def expected(lane, model, S, theta):
    """See `protocol`: no more than a half where a joint has begun or ceased to stick or to touch."""
    return _expected(lane, model.rough, model.play, model, S, theta)


@kernel
def _expected(lane, rough, play, model, S, theta):
    if rough is None:
        if play is None:
            return theta
    return select_lt(0.5, load(lane, S, _gears_at(model) + GEARS.turned), splat(lane, 0.5), theta)


@kernel
def open_friction(lane, model, par, state, u, r, S):
    """See `protocol`."""
    _open(lane, model.rough, model, par, state, u, r, S)


@kernel
def _open(lane, rough, model, par, state, u, r, S):
    if rough is not None:
        assemble(lane, model, par, state, u, RESIDUAL_ALONE, r, S)
        for i in range(_count(model)):
            g = _gear_at(model, i)
            store(S, g + GEAR.before, load(lane, S, g + GEAR.torque))


@kernel
def book_friction(lane, model, par, state, u, r, S, start, books):
    """See `protocol`. Newton's own last residual will not do: neighbours in lanes may have gone on beyond an arm's."""
    _book(lane, model.rough, model, par, state, u, r, S, start, books)


@kernel
def _book(lane, rough, model, par, state, u, r, S, start, books):
    if rough is not None:
        assemble(lane, model, par, state, u, RESIDUAL_ALONE, r, S)
        total = load(lane, books, DISSIPATED)
        for i in range(_count(model)):
            at, g = PLACES * i, _gear_at(model, i)
            k = model.table[at + PLACE.row]
            if model.table[at + PLACE.on_motor] != 0:
                k = model.table[at + PLACE.motor]
            mean = (load(lane, S, g + GEAR.before) + load(lane, S, g + GEAR.torque)) * 0.5
            total = total + mean * (load(lane, state.q, k) - load(lane, start, k))
            store(S, g + GEAR.before, load(lane, S, g + GEAR.torque))
        store(books, DISSIPATED, total)


@kernel
def passes(lane, model):
    """More than one for friction to find out what sticks, where that takes others' accelerations."""
    return _passes(model.rough)


@kernel
def _passes(rough):
    if rough is None:
        return 1
    return len(rough)


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
    predict=predict,
    update=update,
    inertia=inertia,
    rotate=rotate,
    ports=ports,
    damping_work=damping_work,
    energy=energy,
    loosen=loosen,
    begin_friction=begin_friction,
    expected=expected,
    open_friction=open_friction,
    book_friction=book_friction,
    passes=passes,
    link_poses=link_poses,
    out_of_range=out_of_range,
    shape=shape,
)
