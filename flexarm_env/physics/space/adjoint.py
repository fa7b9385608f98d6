"""Backwards through exact beams in space: the transposed system and the product with the matrix, by `matrix`."""

from ...compiler import kernel, load, store
from ..arithmetic import add, put_vector, vector
from ..protocol import register
from .chain import SpatialBeam, clear, has_lever, three_of
from .inner import elements_before, multiplied
from .layout import AXES, B, F, H, J, count_of, factor_at, hinge_at, inner_at, inner_row, joint_row, rows_before
from .matrix import (
    block_times,
    carried,
    matrix_in,
    part_of,
    solve_base,
    solve_six_transposed,
    swing_of,
    transposed_times,
)
from .rotations import add_vector, back, cross, dot, minus, plus, times, turned


@kernel
def multiply(lane, model, S, x, y):
    """See `protocol`."""
    for k in range(model.links):
        h, row, under = hinge_at(k), joint_row(model, k), rows_before(model, k)
        axis, turn = three_of(lane, model.joints, J.end * k + J.axis), matrix_in(lane, S, h + H.turn)
        own = load(lane, x, row)
        a, turned_by = vector(lane, x, under), vector(lane, x, under + 3)
        b = plus(back(turn, turned_by), times(axis, own))
        if has_lever(model, k):
            frame, swing = matrix_in(lane, S, h + H.frame), swing_of(lane, model, k, axis, turn)
            moved = minus(times(swing, own), cross(vector(lane, S, h + H.lever), turned_by))
            a = plus(a, turned(frame, moved))
        first = factor_at(model, k, 0)
        force, moment = block_times(lane, S, first + F.LL, a, b)
        for e in range(count_of(model, k)):
            o, i = first + F.end * e, row + 1 + AXES * e
            c, d = vector(lane, x, i), vector(lane, x, i + 3)
            left, right = block_times(lane, S, o + F.LL, a, b), block_times(lane, S, o + F.RL, a, b)
            more, far = block_times(lane, S, o + F.LR, c, d), block_times(lane, S, o + F.RR, c, d)
            if model.inner is not None:
                n = elements_before(model, k) + e
                at, first_row = inner_at(model, n), inner_row(model, n)
                more_l, more_r = multiplied(lane, model, S, at, x, y, first_row, (a, b), (c, d))
                left = plus(left[0], more_l[0]), plus(left[1], more_l[1])
                right = plus(right[0], more_r[0]), plus(right[1], more_r[1])
            if e == 0:
                force, moment = plus(left[0], more[0]), plus(left[1], more[1])
            else:
                _add_both(lane, y, i - AXES, left, more)
            _add_both(lane, y, i, right, far)
            a, b = c, d
        put_vector(S, h + H.now_force, force)
        put_vector(S, h + H.now_moment, moment)
    for back_k in range(model.links):
        k = model.links - 1 - back_k
        h, row, under = hinge_at(k), joint_row(model, k), rows_before(model, k)
        axis, turn = three_of(lane, model.joints, J.end * k + J.axis), matrix_in(lane, S, h + H.turn)
        own = load(lane, x, row)
        force, moment = vector(lane, S, h + H.now_force), vector(lane, S, h + H.now_moment)
        if count_of(model, k) == 0:
            force, moment = plus(force, vector(lane, y, row + 1)), plus(moment, vector(lane, y, row + 4))
            clear(lane, y, row + 1, AXES)
        on_joint = dot(axis, moment)
        on_section = turned(turn, plus(moment, times(cross(axis, vector(lane, S, h + H.moment)), own)))
        if has_lever(model, k):
            frame, swing = matrix_in(lane, S, h + H.frame), swing_of(lane, model, k, axis, turn)
            lever, pull = vector(lane, S, h + H.lever), vector(lane, S, h + H.force)
            inner = plus(back(frame, force), cross(pull, vector(lane, x, under + 3)))
            on_section = plus(on_section, plus(cross(lever, inner), times(cross(swing, pull), own)))
            on_joint = on_joint + dot(swing, inner) + dot(swing, cross(pull, turned(turn, axis))) * own
        add(lane, y, row, on_joint)
        add_vector(lane, y, under, force)
        add_vector(lane, y, under + 3, on_section)
    force, moment = block_times(lane, S, B.matrix, vector(lane, x, 0), vector(lane, x, 3))
    add_vector(lane, y, 0, force)
    add_vector(lane, y, 3, moment)


@kernel
def _add_both(lane, y, i, a, b):
    """y[i : i + 6] + a + b."""
    add_vector(lane, y, i, plus(a[0], b[0]))
    add_vector(lane, y, i + 3, plus(a[1], b[1]))


@kernel
def solve_transposed(lane, model, S, x):
    """See `protocol`: `matrix.solve` backwards, block by block."""
    for back_k in range(model.links):
        _up(lane, model, S, model.links - 1 - back_k, x)
    solve_base(lane, S, x, True)
    for k in range(model.links):
        _down(lane, model, S, k, x)


@kernel
def _take(lane, x, i, S, o, a, b):
    """x[i : i + 6] less the transposed 6 x 6 matrix at o times (a, b)."""
    upper, lower = transposed_times(lane, S, o, a, b)
    put_vector(x, i, minus(vector(lane, x, i), upper))
    put_vector(x, i + 3, minus(vector(lane, x, i + 3), lower))


@kernel
def _up(lane, model, S, k, x):
    """`matrix._up`, backwards: from the tip to the section before link k."""
    h, row, under, count = hinge_at(k), joint_row(model, k), rows_before(model, k), count_of(model, k)
    axis, turn = three_of(lane, model.joints, J.end * k + J.axis), matrix_in(lane, S, h + H.turn)
    for back_e in range(count - 1):
        e = count - 1 - back_e
        i = row + 1 + AXES * e
        _take(lane, x, i - AXES, S, factor_at(model, k, e) + F.RL, vector(lane, x, i), vector(lane, x, i + 3))
    a, b = vector(lane, x, row + 1), vector(lane, x, row + 4)
    if count > 0:
        a, b = transposed_times(lane, S, factor_at(model, k, 0) + F.RL, times(a, -1.0), times(b, -1.0))
    own, on_section = load(lane, x, row) + dot(carried(lane, model, S, k, axis), b), turned(turn, b)
    if has_lever(model, k):
        on_section = plus(on_section, back(matrix_in(lane, S, h + H.shift), a))
        own = own + dot(vector(lane, S, h + H.drift), a)
    store(x, row, own)
    add_vector(lane, x, under, a)
    add_vector(lane, x, under + 3, on_section)
    for j in range(6):
        add(lane, x, under + j, -(load(lane, S, h + H.row + j) * own))


@kernel
def _down(lane, model, S, k, x):
    """`matrix._down`, backwards: from the section before link k to its tip."""
    h, row, under = hinge_at(k), joint_row(model, k), rows_before(model, k)
    axis, turn = three_of(lane, model.joints, J.end * k + J.axis), matrix_in(lane, S, h + H.turn)
    own, a, turned_by = load(lane, x, row), vector(lane, x, under), vector(lane, x, under + 3)
    b = back(turn, turned_by)
    if S[(h + H.pinned) * len(lane)] == 0.0:
        for j in range(6):
            own = own - load(lane, S, h + H.column + j) * load(lane, x, under + j)
        own = own * load(lane, S, h + H.pivot)
        store(x, row, own)
        b = plus(b, times(axis, own))
    if has_lever(model, k):
        a = plus(a, turned(matrix_in(lane, S, h + H.shift), turned_by))
        if S[(h + H.pinned) * len(lane)] == 0.0:
            a = plus(a, times(vector(lane, S, h + H.swing), own))
    i = row + 1
    if count_of(model, k) == 0:
        put_vector(x, i, a)
        put_vector(x, i + 3, b)
    for e in range(count_of(model, k)):
        o = factor_at(model, k, e)
        _take(lane, x, i, S, o + F.LR, a, b)
        solve_six_transposed(lane, part_of(lane, S, o + F.RR, 36), part_of(lane, x, i, 6))
        a, b = vector(lane, x, i), vector(lane, x, i + 3)
        i += AXES


register(SpatialBeam, multiply, solve_transposed)
