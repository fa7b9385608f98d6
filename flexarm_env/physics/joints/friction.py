"""Coulomb friction as a set: what of it corrects a solution, so that its law holds.

|T| <= T_C at rest, T_C against the rate otherwise. No residual has it in it. What is solved
for, x = S^-1 r, is linear in the torques T of all joints, x + W T with the columns W of S^-1, and so is what it leaves
of a joint's rate: of every joint either T = +-T_C is known or the rate that is left, 0. There is nothing to be
resolved, hence no limit on the step.

The rate that counts is v + ahead a, half a step ahead, so that what is stopped by friction is at rest two steps later:
with v = 0 alone trapezoidal steps would leave it an acceleration that alternates for ever.

The integrator calls these functions for any Model; where joints have no Coulomb friction they are nothing at all.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from ...compiler import absolute, kernel, load, select_lt, size, splat, store
from .. import protocol
from ..arithmetic import add, clip
from ..layout import DISSIPATED
from ..protocol import RESIDUAL_ALONE
from .layout import GEAR, LAWS, PLACE, PLACES

_SLIDES, _TURNS = 0.99, 1e-12
"""A joint slides where the other forces leave over this share of T_C, which stands for what the solver leaves of T_C,
and where it turns, rad/s: a rate below that is round-off."""


class Law(NamedTuple):
    """A `layout.LAW` but for the hub: numbers, or lanes of them where they are each arm's own."""

    stiffness: Any
    damping: Any
    rotor: Any
    viscous: Any
    coulomb: Any
    play: Any


@kernel
def count(model):
    """How many joints there are with a law."""
    return model.table.shape[0] // PLACES


@kernel
def _number(lane, model, par, k):
    """Number k of the laws: one for all arms, or each arm's."""
    if model.own is None:
        return model.data[k]
    return load(lane, par, size(model.own) + k)


@kernel
def law(lane, model, par, i):
    """The `LAW` of joint i."""
    o = LAWS.end * i
    return Law(
        _number(lane, model, par, o + LAWS.stiffness),
        _number(lane, model, par, o + LAWS.damping),
        _number(lane, model, par, o + LAWS.rotor),
        _number(lane, model, par, o + LAWS.viscous),
        _number(lane, model, par, o + LAWS.coulomb),
        _number(lane, model, par, o + LAWS.play),
    )


@kernel
def hub_of(lane, model, par):
    """The hub of law 0, where a model has one."""
    return _number(lane, model, par, LAWS.hub)


@kernel
def gear_at(model, i):
    """Where the `GEAR` of law i is in S."""
    return size(model.arm.n_factor) + GEAR.end * i


@kernel
def column_at(model, i):
    """Where its column of S^-1 is."""
    return gear_at(model, count(model)) + size(model.n) * i


@kernel
def _row_at(model, i):
    """Where its row of the torques' own equations is."""
    return column_at(model, count(model)) + (count(model) + 1) * i


@kernel
def view(lane, S, at, n):
    """n places of S."""
    return S[at * len(lane) : (at + n) * len(lane)]


@kernel
def direction(lane, rate):
    """1, -1 or 0: which way a joint turns."""
    zero, one = splat(lane, 0.0), splat(lane, 1.0)
    return select_lt(zero, rate, one, select_lt(rate, zero, -one, zero))


@kernel
def note_columns(lane, model, S):
    """The columns of S^-1 of the rows that friction acts on; zero where that angle is prescribed."""
    if model.friction is not None:
        for i in range(count(model)):
            column = view(lane, S, column_at(model, i), size(model.n))
            for k in range(size(model.n)):
                store(column, k, splat(lane, 0.0))
            if model.table[PLACES * i + PLACE.known] == 0:
                store(column, model.table[PLACES * i + PLACE.friction], splat(lane, 1.0))
                protocol.solve(lane, model, S, column)


@kernel
def note_friction(lane, model, par, state, u, r, S):
    """Remember in S friction as it is, and which joints slide; r <- the residual with it.

    That of a joint that slides is T_C against its rate, and does not change with what the other forces of its row leave
    over: they have a small margin, so that it slides still where the state is a little different. What sticks takes
    what they leave over.
    """
    if protocol.friction(model) is not None:
        protocol.assemble(lane, model, par, state, u, RESIDUAL_ALONE, r, S)
        for i in range(count(model)):
            g, row = gear_at(model, i), model.table[PLACES * i + PLACE.friction]
            coulomb, rate, rest = law(lane, model, par, i).coulomb, load(lane, state.v, row), load(lane, r, row)
            zero, one, torque = splat(lane, 0.0), splat(lane, 1.0), clip(-rest, coulomb)
            way = direction(lane, rate)
            moves = select_lt(_TURNS, absolute(rate), torque * way, zero)
            slides = select_lt(_SLIDES * coulomb, moves, one, zero)
            torque = select_lt(0.5, slides, coulomb * way, torque)
            free = select_lt(coulomb, absolute(rest), zero, one - slides)
            if model.table[PLACES * i + PLACE.known] != 0:
                torque, slides, free = coulomb * way, zero, zero
            else:
                store(r, row, rest + torque)
            store(S, g + GEAR.before, torque)
            store(S, g + GEAR.free, free)
            store(S, g + GEAR.slides, slides)


@kernel
def turn_round(lane, model, v, S):
    """Joints that slid when last noted and that impulses have turned round since no longer slide as they did."""
    if protocol.friction(model) is not None:
        for i in range(count(model)):
            g, row = gear_at(model, i), model.table[PLACES * i + PLACE.friction]
            slides, with_it = load(lane, S, g + GEAR.slides), load(lane, S, g + GEAR.before) * load(lane, v, row)
            store(S, g + GEAR.slides, select_lt(with_it, 0.0, splat(lane, 0.0), slides))


@kernel
def book_friction(lane, model, par, state, u, r, S, start, books):
    """Add what friction has taken since the coordinates were `start`, by the mean of what it was when last noted and is
    now, and note it; r is free."""
    if protocol.friction(model) is not None:
        _book_half(lane, model, state, S, start, books)
        note_friction(lane, model, par, state, u, r, S)
        _book_half(lane, model, state, S, start, books)


@kernel
def _book_half(lane, model, state, S, start, books):
    total = load(lane, books, DISSIPATED)
    for i in range(count(model)):
        k = model.table[PLACES * i + PLACE.friction]
        moved = load(lane, state.q, k) - load(lane, start, k)
        total = total + load(lane, S, gear_at(model, i) + GEAR.before) * moved * 0.5
    store(books, DISSIPATED, total)


@kernel
def apply_friction(lane, model, par, state, weights, ahead, S, x):
    """Correct x = S^-1 r, to be taken from the state by `weights` (of a by mass, of v by damping), so that friction's
    law holds for the rates v + ahead a after that. Where v stays (damping 0), joints that slid when last noted go on.

    Which joints stick is guessed, the torques are solved for, and the guess is mended: right at once for one joint;
    what is wrong of several after these passes is mended by Newton's next iteration."""
    if protocol.friction(model) is not None:
        joints = count(model)
        _find_gaps(lane, model, state, weights, ahead, S, x)
        for i in range(joints):
            store(S, gear_at(model, i) + GEAR.torque, splat(lane, 0.0))
        for _ in range(2 * joints - 1):
            for i in range(joints):
                _choose(lane, model, par, weights, i, S)
            _solve_torques(lane, model, S, False)
        _add_torques(lane, model, S, x)


@kernel
def _find_gaps(lane, model, state, weights, ahead, S, x):
    """What would have to be taken from x to leave each joint at rest."""
    share = 1.0 / (weights.damping + ahead * weights.mass)
    for i in range(count(model)):
        row = model.table[PLACES * i + PLACE.friction]
        rate = load(lane, state.v, row) + load(lane, state.a, row) * ahead
        store(S, gear_at(model, i) + GEAR.gap, rate * share - load(lane, x, row))


@kernel
def _choose(lane, model, par, weights, i, S):
    """Whether joint i sticks, and the torque if it does not."""
    g, row = gear_at(model, i), model.table[PLACES * i + PLACE.friction]
    coulomb, zero, one = law(lane, model, par, i).coulomb, splat(lane, 0.0), splat(lane, 1.0)
    left = load(lane, S, g + GEAR.gap)
    for j in range(count(model)):
        left = left - load(lane, S, column_at(model, j) + row) * load(lane, S, gear_at(model, j) + GEAR.torque)
    sticks, bound = zero, zero
    if model.table[PLACES * i + PLACE.known] == 0:
        wanted = load(lane, S, g + GEAR.torque) + left / load(lane, S, column_at(model, i) + row)
        sticks, bound = select_lt(absolute(wanted), coulomb, one, zero), clip(wanted, coulomb)
        if weights.damping == 0.0:
            slides = load(lane, S, g + GEAR.slides)
            sticks = select_lt(0.5, slides, zero, sticks)
            bound = select_lt(0.5, slides, load(lane, S, g + GEAR.before), bound)
    store(S, g + GEAR.sticks, sticks)
    store(S, g + GEAR.bound, bound)


@kernel
def _solve_torques(lane, model, S, transposed):
    """The torques with which the rates that stick have no gap left; `bound` elsewhere. transposed: of the transposed
    system, where all bounds are 0."""
    joints, one, zero = count(model), splat(lane, 1.0), splat(lane, 0.0)
    for i in range(joints):
        g, row = gear_at(model, i), view(lane, S, _row_at(model, i), joints + 1)
        sticks, own = load(lane, S, g + GEAR.sticks), model.table[PLACES * i + PLACE.friction]
        for j in range(joints):
            at = column_at(model, j) + own
            if transposed:
                at = column_at(model, i) + model.table[PLACES * j + PLACE.friction]
            store(row, j, select_lt(0.5, sticks, load(lane, S, at), one if i == j else zero))
        store(row, joints, select_lt(0.5, sticks, load(lane, S, g + GEAR.gap), load(lane, S, g + GEAR.bound)))
        for j in range(i):  # the minors that stick are those of S^-1: no pivot is zero
            above = view(lane, S, _row_at(model, j), joints + 1)
            factor_of = load(lane, row, j) / load(lane, above, j)
            for k in range(j + 1, joints + 1):
                store(row, k, load(lane, row, k) - load(lane, above, k) * factor_of)
    for i in range(joints - 1, -1, -1):
        row = view(lane, S, _row_at(model, i), joints + 1)
        total = load(lane, row, joints)
        for j in range(i + 1, joints):
            total = total - load(lane, row, j) * load(lane, S, gear_at(model, j) + GEAR.torque)
        store(S, gear_at(model, i) + GEAR.torque, total / load(lane, row, i))


@kernel
def _add_torques(lane, model, S, x):
    """x <- x + W T; what sticks to the last bit as it must."""
    n = size(model.n)
    for i in range(count(model)):
        g = gear_at(model, i)
        store(S, g + GEAR.gap, load(lane, x, model.table[PLACES * i + PLACE.friction]) + load(lane, S, g + GEAR.gap))
    for i in range(count(model)):
        torque, column = load(lane, S, gear_at(model, i) + GEAR.torque), column_at(model, i)
        for k in range(n):
            store(x, k, load(lane, x, k) + load(lane, S, column + k) * torque)
    for i in range(count(model)):
        g, row = gear_at(model, i), model.table[PLACES * i + PLACE.friction]
        store(x, row, select_lt(0.5, load(lane, S, g + GEAR.sticks), load(lane, S, g + GEAR.gap), load(lane, x, row)))


@kernel
def keep_sticking(lane, model, S, x):
    """x <- S^-1 y from S^-1 y without friction: joints that stuck when it was last applied stay where they are."""
    if protocol.friction(model) is not None:
        for i in range(count(model)):
            g = gear_at(model, i)
            store(S, g + GEAR.gap, -load(lane, x, model.table[PLACES * i + PLACE.friction]))
            store(S, g + GEAR.bound, splat(lane, 0.0))
        _solve_torques(lane, model, S, False)
        _add_torques(lane, model, S, x)


# --- derivatives, of joints that stick or slide as they did -------------------------------------------
@kernel
def note_branch(lane, model, par, state, weights, ahead, r, S):
    """Note which joints stick and which slide, and which way, at a step's end: as friction's law has it there, S being
    its matrix, factored, and r the residual, which is lost."""
    if protocol.friction(model) is not None:
        protocol.solve(lane, model, S, r)
        apply_friction(lane, model, par, state, weights, ahead, S, r)
        for i in range(count(model)):
            g, zero = gear_at(model, i), splat(lane, 0.0)
            slides = direction(lane, load(lane, S, g + GEAR.bound))
            store(S, g + GEAR.slides, select_lt(0.5, load(lane, S, g + GEAR.sticks), zero, slides))
            store(S, g + GEAR.bound, zero)


@kernel
def change_friction(lane, model, par, weight, S):
    """The friction of joints that slide changes by `weight` times this model's own."""
    if protocol.friction(model) is not None:
        for i in range(count(model)):
            g = gear_at(model, i)
            more = load(lane, S, g + GEAR.slides) * (law(lane, model, par, i).coulomb * weight)
            store(S, g + GEAR.bound, load(lane, S, g + GEAR.bound) + more)


@kernel
def friction_tangents(lane, model, change, weights, ahead, S, x):
    """`apply_friction` of tangents x, `change` being those of the state."""
    if protocol.friction(model) is not None:
        _find_gaps(lane, model, change, weights, ahead, S, x)
        _solve_torques(lane, model, S, False)
        _add_torques(lane, model, S, x)
        for i in range(count(model)):
            store(S, gear_at(model, i) + GEAR.bound, splat(lane, 0.0))


@kernel
def friction_cotangents(lane, model, weights, ahead, S, x, v_bar, a_bar):
    """`friction_tangents` backwards: of cotangents x of what is solved for, those before friction is applied; to v_bar
    and a_bar is added what the rates v + ahead a come to.

    The torques' own cotangents W' x are made to vanish for joints that stick by what their rates are given, a system
    with the transposed minors of W; the torques of the others are constant."""
    if protocol.friction(model) is not None:
        for i in range(count(model)):
            g, column, total = gear_at(model, i), column_at(model, i), splat(lane, 0.0)
            for k in range(size(model.n)):
                total = total + load(lane, S, column + k) * load(lane, x, k)
            store(S, g + GEAR.gap, total)
            store(S, g + GEAR.bound, splat(lane, 0.0))
        _solve_torques(lane, model, S, True)
        share = 1.0 / (weights.damping + ahead * weights.mass)
        for i in range(count(model)):
            row, given = model.table[PLACES * i + PLACE.friction], load(lane, S, gear_at(model, i) + GEAR.torque)
            add(lane, x, row, -given)
            add(lane, v_bar, row, given * -share)
            add(lane, a_bar, row, given * (-share * ahead))


@kernel
def note_cotangents(lane, model, S, r_bar):
    """`note_friction` backwards: from cotangents of the residual with friction to those of that without. Where friction
    is what the other forces leave over, the residual is 0 whatever they are."""
    if protocol.friction(model) is not None:
        for i in range(count(model)):
            row = model.table[PLACES * i + PLACE.friction]
            given = load(lane, r_bar, row)
            store(r_bar, row, given - load(lane, S, gear_at(model, i) + GEAR.free) * given)
