"""The iteration matrix of a chain in space: vertices eliminated from the tip to the base, joints on the way.

A link begins where d = (place, rotation) of the section before and the joint's angle b have it:

    place += X d_rotation + c b,   rotation = turn^T d_rotation + axis b,     X = -A s^,  c = A turn (axis x beyond)

with A the axes of the section before and s the lever to the link's beginning; without levers X = c = 0.
"""

from __future__ import annotations

from ...compiler import kernel, load, splat, store, traced
from ..arithmetic import add, put_vector, vector
from ..model import TAU_D
from ..protocol import of_step
from .chain import clear, has_lever, three_of
from .element import add_block
from .layout import AXES, B, F, H, J, before, factor_at, hinge_at, joint_row
from .rotations import back, cross, dot, plus, product, put_matrix, scaled, skew, sum_of, times, transposed, turned


@kernel
def matrix_in(lane, S, o):
    """What `put_matrix` has put there."""
    return vector(lane, S, o), vector(lane, S, o + 3), vector(lane, S, o + 6)


@kernel
def _joint_of(model, row):
    """The joint whose angle is in this row."""
    k = 0
    while joint_row(model, k) < row:
        k += 1
    return k


@kernel
def pin(lane, model, S, k):
    """See `protocol`."""
    one = splat(lane, 1.0)
    if k < AXES:
        store(S, B.pinned + k, one)
    else:
        store(S, hinge_at(_joint_of(model, k)) + H.pinned, one)


@kernel
def stiffen(lane, model, S, k, x):
    """See `protocol`."""
    store(S, hinge_at(_joint_of(model, k)) + H.own, x)


@kernel
def gyrate(lane, model, S, k, momentum):
    """See `protocol`."""
    store(S, hinge_at(k) + H.now_spin, momentum)


@kernel
def sway(lane, model, S, k):
    """See `protocol`. By strains the section before has no rows: the three before the joint's are others' there."""
    if model.strains is not None:
        zero = splat(lane, 0.0)
        return zero, zero, zero
    return vector(lane, S, hinge_at(k) + H.sway)


@kernel
def lean(lane, model, S, k, x):
    """See `protocol`."""
    store(S, hinge_at(k) + H.lean, x)


def _factors(lane, A):
    """L and U of a 6 x 6 matrix, in place, its pivots inverted, no rows exchanged: mass outweighs the rest."""
    a = [[load(lane, A, 6 * i + j) for j in range(6)] for i in range(6)]
    for k in range(6):
        a[k][k] = 1.0 / a[k][k]
        for i in range(k + 1, 6):
            a[i][k] = a[i][k] * a[k][k]
            for j in range(k + 1, 6):
                a[i][j] = a[i][j] - a[i][k] * a[k][j]
    for i in range(6):
        for j in range(6):
            store(A, 6 * i + j, a[i][j])


def _solution(lane, A, x):
    """Of six numbers, by the factors in A."""
    for k in range(6):
        for j in range(k):
            x[k] = x[k] - load(lane, A, 6 * k + j) * x[j]
    for k in range(5, -1, -1):
        for j in range(k + 1, 6):
            x[k] = x[k] - load(lane, A, 6 * k + j) * x[j]
        x[k] = x[k] * load(lane, A, 7 * k)
    return x


@traced
def solve_six_transposed(lane, A, x):
    """x <- A^-T x, of the factors in A."""
    y = [load(lane, x, k) for k in range(6)]
    for k in range(6):
        for j in range(k):
            y[k] = y[k] - load(lane, A, 6 * j + k) * y[j]
        y[k] = y[k] * load(lane, A, 7 * k)
    for k in range(5, -1, -1):
        for j in range(k + 1, 6):
            y[k] = y[k] - load(lane, A, 6 * j + k) * y[j]
    for k, value in enumerate(y):
        store(x, k, value)


@traced
def _factor_six(lane, A):
    """`_factors`."""
    _factors(lane, A)


@traced
def solve_six(lane, A, x):
    """x <- `_solution`."""
    for k, value in enumerate(_solution(lane, A, [load(lane, x, k) for k in range(6)])):
        store(x, k, value)


@traced
def eliminate(lane, LL, LR, RL, RR):
    """A vertex, of the four matrices of the element before it: RR <- factors, RL <- RR^-1 RL, LL <- LL - LR RL."""
    _factors(lane, RR)
    for j in range(6):
        column = _solution(lane, RR, [load(lane, RL, 6 * i + j) for i in range(6)])
        for i in range(6):
            store(RL, 6 * i + j, column[i])
            total = load(lane, LL, 6 * i + j)
            for m in range(6):
                total = total - load(lane, LR, 6 * i + m) * column[m]
            store(LL, 6 * i + j, total)


@kernel
def part_of(lane, S, o, n):
    """n numbers of S from o on."""
    return S[o * len(lane) : (o + n) * len(lane)]


@kernel
def _block(lane, S, o, i, j):
    k = o + 18 * i + 3 * j
    return vector(lane, S, k), vector(lane, S, k + 6), vector(lane, S, k + 12)


@kernel
def _base_is_held(lane, S):
    """Whether none of the base's rows moves."""
    held = True
    for i in range(6):
        if S[(B.pinned + i) * len(lane)] == 0.0:
            held = False
    return held


@kernel
def eliminate_joint(lane, model, S, k):
    """What is at the root of link k, to the section before, without the joint's row."""
    h, o, below = hinge_at(k), factor_at(model, k, 0) + F.LL, before(model, k)
    axis, turn = three_of(lane, model.joints, J.end * k + J.axis), matrix_in(lane, S, h + H.turn)
    to_root, way = transposed(turn), carried(lane, model, S, k, axis)
    xx, xt, tx, tt = (
        _block(lane, S, o, 0, 0),
        _block(lane, S, o, 0, 1),
        _block(lane, S, o, 1, 0),
        _block(lane, S, o, 1, 1),
    )
    moment = cross(axis, vector(lane, S, h + H.moment))
    on_root = turned(tt, way)
    force, on_section = turned(xt, way), turned(turn, plus(on_root, moment))
    by_place, by_turn = back(tx, axis), turned(turn, back(tt, axis))
    pivot = dot(axis, on_root) + load(lane, S, h + H.own)
    if has_lever(model, k):
        frame, lever, pull = matrix_in(lane, S, h + H.frame), vector(lane, S, h + H.lever), vector(lane, S, h + H.force)
        swing = swing_of(lane, model, k, axis, turn)
        c = turned(frame, swing)
        drift = c
        if model.strains is None:
            drift = turned(frame, turned(turn, carried(lane, model, S, k, back(turn, swing))))
        put_matrix(S, h + H.shift, scaled(product(frame, skew(lever)), -1.0))
        put_vector(S, h + H.swing, c)
        put_vector(S, h + H.drift, drift)
        pivot = pivot + dot(axis, turned(tx, drift)) + dot(c, force) + dot(c, turned(xx, drift))
        pivot = pivot + dot(swing, cross(pull, turned(turn, axis)))
    free = S[(h + H.pinned) * len(lane)] == 0.0
    if k == 0:
        if _base_is_held(lane, S):  # what would be handed on meets nothing that moves
            clear(lane, S, h + H.column, 12)
            store(S, h + H.pivot, 1.0 / pivot if free else splat(lane, 1.0))
            return
    upper, lower = product(xt, to_root), product(turn, tx)
    inner = product(product(turn, tt), to_root)
    if has_lever(model, k):
        X, c, drift = matrix_in(lane, S, h + H.shift), vector(lane, S, h + H.swing), vector(lane, S, h + H.drift)
        lever, pull = vector(lane, S, h + H.lever), vector(lane, S, h + H.force)
        Xt, swing = transposed(X), swing_of(lane, model, k, axis, turn)
        sideways, aside = turned(xx, drift), turned(tx, drift)
        inner = sum_of(inner, sum_of(product(lower, X), sum_of(product(Xt, upper), product(Xt, product(xx, X)))))
        inner = sum_of(inner, product(skew(lever), skew(pull)))
        upper, lower = sum_of(upper, product(xx, X)), sum_of(lower, product(Xt, xx))
        by_turn = plus(by_turn, plus(turned(turn, back(xt, c)), turned(Xt, by_place)))
        by_turn = plus(by_turn, plus(turned(Xt, back(xx, c)), cross(swing, pull)))
        by_place = plus(by_place, back(xx, c))
        force = plus(force, sideways)
        on_section = plus(plus(on_section, turned(turn, aside)), plus(turned(Xt, force), cross(swing, pull)))
    if model.rotors is not None:
        if model.rotors[k] != 0:
            on_section = plus(on_section, times(vector(lane, S, h + H.sway), load(lane, S, h + H.lean)))
    add_block(lane, S, below, 0, 0, xx)
    add_block(lane, S, below, 0, 1, upper)
    add_block(lane, S, below, 1, 0, lower)
    add_block(lane, S, below, 1, 1, inner)
    if free:
        inverse = 1.0 / pivot
        put_vector(S, h + H.column, force)
        put_vector(S, h + H.column + 3, on_section)
        put_vector(S, h + H.row, times(by_place, inverse))
        put_vector(S, h + H.row + 3, times(by_turn, inverse))
        store(S, h + H.pivot, inverse)
        for i in range(6):
            for j in range(6):
                add(lane, S, below + 6 * i + j, -(load(lane, S, h + H.column + i) * load(lane, S, h + H.row + j)))
    else:
        clear(lane, S, h + H.column, 12)
        store(S, h + H.pivot, splat(lane, 1.0))


@kernel
def note_lag(lane, model, par, S, k, spin, weights):
    """What `carried` needs, of a step's matrix: the spin of the root of link k."""
    if model.damped is not None and model.strains is None:
        tau = load(lane, par, TAU_D)
        put_vector(S, hinge_at(k) + H.lag, times(spin, tau / (tau * weights.damping + 1.0) * of_step(weights)))


@kernel
def carried(lane, model, S, k, a):
    """What the root of link k moves by with its joint's angle, a being that in its axes. With the angle the root's axes
    turn, and so do its rates, by w x a: dampers of c_v tau_d + 1 times their springs' stiffness have from that what
    these have from tau_d / (c_v tau_d + 1) times it. Where strains are coordinates dampers see none of it."""
    if model.damped is None or model.strains is not None:
        return a
    return plus(a, cross(vector(lane, S, hinge_at(k) + H.lag), a))


@kernel
def factor_base(lane, S):
    """What is left on the base, its rows that are held pinned."""
    zero, one = splat(lane, 0.0), splat(lane, 1.0)
    for i in range(6):
        if S[(B.pinned + i) * len(lane)] != 0.0:
            for j in range(6):
                store(S, B.matrix + 6 * i + j, zero)
                store(S, B.matrix + 6 * j + i, zero)
            store(S, B.matrix + 7 * i, one)
    _factor_six(lane, part_of(lane, S, B.matrix, 36))


@kernel
def solve_base(lane, S, x, across):
    """What the base moves by; across: of the transposed system."""
    for i in range(6):
        if S[(B.pinned + i) * len(lane)] != 0.0:
            store(x, i, splat(lane, 0.0))
    if across:
        solve_six_transposed(lane, part_of(lane, S, B.matrix, 36), part_of(lane, x, 0, 6))
    else:
        solve_six(lane, part_of(lane, S, B.matrix, 36), part_of(lane, x, 0, 6))


@kernel
def block_times(lane, S, o, a, b):
    """The 6 x 6 matrix at o times (a, b)."""
    upper = plus(turned(_block(lane, S, o, 0, 0), a), turned(_block(lane, S, o, 0, 1), b))
    return upper, plus(turned(_block(lane, S, o, 1, 0), a), turned(_block(lane, S, o, 1, 1), b))


@kernel
def transposed_times(lane, S, o, a, b):
    """The transposed 6 x 6 matrix at o times (a, b)."""
    upper = plus(back(_block(lane, S, o, 0, 0), a), back(_block(lane, S, o, 1, 0), b))
    return upper, plus(back(_block(lane, S, o, 0, 1), a), back(_block(lane, S, o, 1, 1), b))


@kernel
def swing_of(lane, model, k, axis, turn):
    """By how much the beginning of link k moves with its joint's angle, in axes of the section before."""
    return turned(turn, cross(axis, three_of(lane, model.joints, J.end * k + J.beyond)))
