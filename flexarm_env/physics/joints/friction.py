"""Coulomb friction as a set: what of it corrects a solution, so that its law holds.

|T| <= T_C at rest, T_C against the rate otherwise. No residual has it in it. What is solved
for, x = S^-1 r, is linear in the torques T of all joints, x + W T with the columns W of S^-1, and so is what it leaves
of a joint's rate: of every joint either T = +-T_C is known or the rate that is left, 0. There is nothing to be
resolved, hence no limit on the step.

The rate that counts is v + ahead a, half a step ahead, so that what is stopped by friction is at rest two steps later:
with v = 0 alone trapezoidal steps would leave it an acceleration that alternates for ever.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from ...compiler import NONE, absolute, by_kind, kernel, load, select_lt, size, splat, store
from ..arithmetic import clip
from ..model import JOINT_LAWS
from .layout import GEAR, LAWS, PLACE, PLACES


class Law(NamedTuple):
    """A `layout.LAW`: numbers, or lanes of them where they are each arm's own."""

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
def _shared(lane, own, model, par, k):
    return model.data[k]


@kernel
def _each(lane, own, model, par, k):
    return load(lane, par, JOINT_LAWS + k)


@by_kind("own", "lane, own, model, par, k")
def _number(kind: str) -> Any:
    """Number k of the laws: one for all arms, or each arm's."""
    return _shared if kind == NONE else _each


@kernel
def law(lane, model, par, i):
    """The `LAW` of joint i."""
    own, o = model.own, LAWS.end * i
    return Law(
        _number(lane, own, model, par, o + LAWS.stiffness),
        _number(lane, own, model, par, o + LAWS.damping),
        _number(lane, own, model, par, o + LAWS.rotor),
        _number(lane, own, model, par, o + LAWS.viscous),
        _number(lane, own, model, par, o + LAWS.coulomb),
        _number(lane, own, model, par, o + LAWS.play),
    )


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
def rub(lane, model, par, state, weights, ahead, S, x):
    """See `protocol`."""
    _rub(lane, model.rough, model, par, state, weights, ahead, S, x)


@kernel
def _rub(lane, rough, model, par, state, weights, ahead, S, x):
    """Which joints stick is guessed, the torques are solved for, and the guess is mended: right at once for one joint;
    what is wrong of several after these passes is mended by Newton's next iteration."""
    if rough is not None:
        joints = count(model)
        _leave(lane, model, state, weights, ahead, S, x)
        for i in range(joints):
            store(S, gear_at(model, i) + GEAR.torque, splat(lane, 0.0))
        for _ in range(2 * joints - 1):
            for i in range(joints):
                _choose(lane, model, par, weights, i, S)
            solve_torques(lane, model, S, False)
        _apply(lane, model, S, x)


@kernel
def _leave(lane, model, state, weights, ahead, S, x):
    """What would have to be taken from x to leave each joint at rest."""
    share = 1.0 / (weights.damping + ahead * weights.mass)
    for i in range(count(model)):
        row = model.table[PLACES * i + PLACE.rubs]
        rate = load(lane, state.v, row) + load(lane, state.a, row) * ahead
        store(S, gear_at(model, i) + GEAR.gap, rate * share - load(lane, x, row))


@kernel
def _choose(lane, model, par, weights, i, S):
    """Whether joint i sticks, and the torque if it does not."""
    g, row = gear_at(model, i), model.table[PLACES * i + PLACE.rubs]
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
def solve_torques(lane, model, S, transposed):
    """The torques with which the rates that stick have no gap left; `bound` elsewhere. transposed: of the transposed
    system, where all bounds are 0."""
    joints, one, zero = count(model), splat(lane, 1.0), splat(lane, 0.0)
    for i in range(joints):
        g, row = gear_at(model, i), view(lane, S, _row_at(model, i), joints + 1)
        sticks, rubs = load(lane, S, g + GEAR.sticks), model.table[PLACES * i + PLACE.rubs]
        for j in range(joints):
            at = column_at(model, j) + rubs
            if transposed:
                at = column_at(model, i) + model.table[PLACES * j + PLACE.rubs]
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
def _apply(lane, model, S, x):
    """x <- x + W T; what sticks to the last bit as it must."""
    n = size(model.n)
    for i in range(count(model)):
        g = gear_at(model, i)
        store(S, g + GEAR.gap, load(lane, x, model.table[PLACES * i + PLACE.rubs]) + load(lane, S, g + GEAR.gap))
    for i in range(count(model)):
        torque, column = load(lane, S, gear_at(model, i) + GEAR.torque), column_at(model, i)
        for k in range(n):
            store(x, k, load(lane, x, k) + load(lane, S, column + k) * torque)
    for i in range(count(model)):
        g, row = gear_at(model, i), model.table[PLACES * i + PLACE.rubs]
        store(x, row, select_lt(0.5, load(lane, S, g + GEAR.sticks), load(lane, S, g + GEAR.gap), load(lane, x, row)))


@kernel
def hold(lane, model, S, x):
    """See `protocol`."""
    _hold(lane, model.rough, model, S, x)


@kernel
def _hold(lane, rough, model, S, x):
    if rough is not None:
        for i in range(count(model)):
            g = gear_at(model, i)
            store(S, g + GEAR.gap, -load(lane, x, model.table[PLACES * i + PLACE.rubs]))
            store(S, g + GEAR.bound, splat(lane, 0.0))
        solve_torques(lane, model, S, False)
        _apply(lane, model, S, x)


# --- of tangents ------------------------------------------------------------------------------------
_STICKS = 1.0 - 1e-6
"""Share of T_C below which the torque of a joint at a step's end is that of one that sticks."""


@kernel
def note_slip(lane, model, par, state, ahead, r, S):
    """See `protocol`."""
    _note_slip(lane, model.rough, model, par, state, ahead, r, S)


@kernel
def _note_slip(lane, rough, model, par, state, ahead, r, S):
    if rough is not None:
        zero, one = splat(lane, 0.0), splat(lane, 1.0)
        for i in range(count(model)):
            g, row = gear_at(model, i), model.table[PLACES * i + PLACE.rubs]
            bound = law(lane, model, par, i).coulomb * _STICKS
            rate = load(lane, state.v, row) + load(lane, state.a, row) * ahead
            sticks = select_lt(absolute(load(lane, r, row)), bound, one, zero)
            slides = select_lt(zero, rate, one, select_lt(rate, zero, -one, zero))
            if model.table[PLACES * i + PLACE.known] != 0:
                sticks, slides = zero, zero
            store(S, g + GEAR.sticks, sticks)
            store(S, g + GEAR.slides, slides)
            store(S, g + GEAR.bound, zero)


@kernel
def bound_along(lane, model, par, weight, S):
    """See `protocol`."""
    _bound_along(lane, model.rough, model, par, weight, S)


@kernel
def _bound_along(lane, rough, model, par, weight, S):
    if rough is not None:
        for i in range(count(model)):
            g = gear_at(model, i)
            more = load(lane, S, g + GEAR.slides) * (law(lane, model, par, i).coulomb * weight)
            store(S, g + GEAR.bound, load(lane, S, g + GEAR.bound) + more)


@kernel
def rub_along(lane, model, par, change, weights, ahead, S, x):
    """See `protocol`."""
    _rub_along(lane, model.rough, model, change, weights, ahead, S, x)


@kernel
def _rub_along(lane, rough, model, change, weights, ahead, S, x):
    if rough is not None:
        _leave(lane, model, change, weights, ahead, S, x)
        solve_torques(lane, model, S, False)
        _apply(lane, model, S, x)
        for i in range(count(model)):
            store(S, gear_at(model, i) + GEAR.bound, splat(lane, 0.0))
