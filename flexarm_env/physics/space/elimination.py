"""Newton's equations of a chain in space: along the links from the tip to the base and back.

Of a link of elements its vertices are eliminated one by one; of one with strains what is on its last section is taken
to its root and its strains, and these are eliminated.
"""

from __future__ import annotations

from ...compiler import kernel, load, splat, store, superword
from ..arithmetic import add, put_vector, vector
from . import inner
from .chain import clear, has_lever, onto, three_of
from .inner import elements_before, factors, solution
from .layout import AXES, F, H, J, count_of, factor_at, hinge_at, inner_at, inner_row, joint_row, rows_before
from .matrix import (
    block_times,
    carried,
    eliminate,
    eliminate_joint,
    factor_base,
    matrix_in,
    part_of,
    solve_base,
    solve_six,
    transposed_times,
)
from .rotations import add_vector, back, dot, minus, plus, times, turned
from .strained import strain_row
from .strained_layout import noted_at


@kernel
def factor(lane, model, S):
    """See `protocol`."""
    for back_k in range(model.links):
        k = model.links - 1 - back_k
        if model.strains is None:
            _condense_elements(lane, model, S, k)
        elif count_of(model, k) > 0:
            _condense_strains(lane, model, S, k)
        eliminate_joint(lane, model, S, k)
    factor_base(lane, S)


@kernel
def solve(lane, model, S, x):
    """See `protocol`."""
    for back_k in range(model.links):
        k = model.links - 1 - back_k
        _joint_down(lane, model, S, k, x, _down(lane, model, S, k, x))
    solve_base(lane, S, x, False)
    for k in range(model.links):
        _up(lane, model, S, k, x, _joint_up(lane, model, S, k, x))


@superword
def _condense_elements(lane, model, S, k):
    """What is on link k to its root, vertex by vertex."""
    for back_e in range(count_of(model, k)):
        o = factor_at(model, k, count_of(model, k) - 1 - back_e)
        left, right = part_of(lane, S, o + F.LL, 36), part_of(lane, S, o + F.RR, 36)
        eliminate(lane, left, part_of(lane, S, o + F.LR, 36), part_of(lane, S, o + F.RL, 36), right)
        if back_e < count_of(model, k) - 1:
            for i in range(36):
                add(lane, S, o - F.end + F.RR + i, load(lane, S, o + F.LL + i))


@kernel
def _rows(model):
    """Rows of a link's strains."""
    return 3 * len(model.polynomials)


@kernel
def _to_last(lane, S, to, a, b):
    """What a link's last section moves by where its root moves by (a, b)."""
    return plus(a, turned(matrix_in(lane, S, to.shift), b)), back(matrix_in(lane, S, to.last_turn), b)


@kernel
def _to_root(lane, S, to, a, b):
    """What (a, b) on the last section is on the root."""
    return a, plus(turned(matrix_in(lane, S, to.last_turn), b), back(matrix_in(lane, S, to.shift), a))


@kernel
def _condense_strains(lane, model, S, k):
    """What is on the last section of link k to its root, without the strains."""
    n, to, f = _rows(model), noted_at(model, k), factor_at(model, k, 0)
    zero = splat(lane, 0.0)
    one = zero + 1.0
    for c in range(n):
        i = to.last + 6 * c
        on = block_times(lane, S, f + F.RR, vector(lane, S, i), vector(lane, S, i + 3))
        for row in range(n):
            o = to.last + 6 * row
            add(lane, S, to.matrix + n * row + c, dot(vector(lane, S, o), on[0]) + dot(vector(lane, S, o + 3), on[1]))
        on = _to_root(lane, S, to, on[0], on[1])
        add_vector(lane, S, to.on_root + 6 * c, on[0])
        add_vector(lane, S, to.on_root + 6 * c + 3, on[1])
        on = transposed_times(lane, S, f + F.RR, vector(lane, S, i), vector(lane, S, i + 3))
        on = _to_root(lane, S, to, on[0], on[1])
        add_vector(lane, S, to.by_root + 6 * c, on[0])
        add_vector(lane, S, to.by_root + 6 * c + 3, on[1])
    c = 0
    for axis in ((one, zero, zero), (zero, one, zero), (zero, zero, one)):
        for place, turn in ((axis, (zero, zero, zero)), ((zero, zero, zero), axis)):
            moved = _to_last(lane, S, to, place, turn)
            on = block_times(lane, S, f + F.RR, moved[0], moved[1])
            on = _to_root(lane, S, to, on[0], on[1])
            for i in range(3):
                add(lane, S, f + F.LL + 6 * i + c, on[0][i])
                add(lane, S, f + F.LL + 6 * i + 18 + c, on[1][i])
            c += 3
        c -= 5
    factors(lane, n, S, to.matrix)
    for i in range(6 * n):
        store(S, to.over + i, load(lane, S, to.by_root + i))
    for c in range(6):
        solution(lane, n, S, to.matrix, S, to.over + c, 6)
    for i in range(6):
        for j in range(6):
            total = load(lane, S, f + F.LL + 6 * i + j)
            for c in range(n):
                total = total - load(lane, S, to.on_root + 6 * c + i) * load(lane, S, to.over + 6 * c + j)
            store(S, f + F.LL + 6 * i + j, total)


@kernel
def _joint_down(lane, model, S, k, x, of):
    """Forward elimination of joint k, of (force, moment) on the root of its link, to the section before."""
    h, row, (a, b) = hinge_at(k), joint_row(model, k), of
    axis, turn = three_of(lane, model.joints, J.end * k + J.axis), matrix_in(lane, S, h + H.turn)
    on_section, on_joint = turned(turn, b), dot(axis, b)
    if has_lever(model, k):
        on_section = plus(on_section, back(matrix_in(lane, S, h + H.shift), a))
        on_joint = on_joint + dot(vector(lane, S, h + H.swing), a)
    onto(lane, model, x, S, k, (a, on_section))
    if S[(h + H.pinned) * len(lane)] == 0.0:
        own = (load(lane, x, row) + on_joint) * load(lane, S, h + H.pivot)
        column = vector(lane, S, h + H.column), vector(lane, S, h + H.column + 3)
        onto(lane, model, x, S, k, (times(column[0], -own), times(column[1], -own)))
        store(x, row, own)


@kernel
def _joint_up(lane, model, S, k, x):
    """Back substitution of joint k: (place, rotation) that the root of its link moves by."""
    h, row, (a, turned_by) = hinge_at(k), joint_row(model, k), _moved_before(lane, model, x, S, k)
    axis, turn = three_of(lane, model.joints, J.end * k + J.axis), matrix_in(lane, S, h + H.turn)
    own = load(lane, x, row)
    for j in range(3):
        own = own - load(lane, S, h + H.row + j) * a[j]
    for j in range(3):
        own = own - load(lane, S, h + H.row + 3 + j) * turned_by[j]
    store(x, row, own)
    b = plus(back(turn, turned_by), times(carried(lane, model, S, k, axis), own))
    if has_lever(model, k):
        shift = turned(matrix_in(lane, S, h + H.shift), turned_by)
        a = plus(a, plus(shift, times(vector(lane, S, h + H.drift), own)))
    return a, b


@kernel
def _moved_before(lane, model, x, S, k):
    """(place, rotation) that the section before joint k moves by; see `chain.onto`."""
    if model.strains is not None:
        if k > 0:
            on = noted_at(model, k - 1).on
            return vector(lane, S, on), vector(lane, S, on + 3)
    return vector(lane, x, rows_before(model, k)), vector(lane, x, rows_before(model, k) + 3)


@kernel
def _down(lane, model, S, k, x):
    """Forward elimination of link k: what is left, (force, moment) on its root."""
    if model.strains is not None:
        return _strains_down(lane, model, S, k, x)
    row, count = joint_row(model, k), count_of(model, k)
    a, b = vector(lane, x, row + 1), vector(lane, x, row + 4)  # of a rigid link
    for back_e in range(count):
        e = count - 1 - back_e
        o, i = factor_at(model, k, e), row + 1 + AXES * e
        if model.inner is not None:
            n = elements_before(model, k) + e
            on_left = inner.down(lane, model, S, inner_at(model, n), x, inner_row(model, n), i)
            if e > 0:
                add_vector(lane, x, i - 6, on_left[0])
                add_vector(lane, x, i - 3, on_left[1])
            else:
                a, b = on_left
        solve_six(lane, part_of(lane, S, o + F.RR, 36), part_of(lane, x, i, 6))
        if e > 0:
            push, turn_by = block_times(lane, S, o + F.LR, vector(lane, x, i), vector(lane, x, i + 3))
            add_vector(lane, x, i - 6, times(push, -1.0))
            add_vector(lane, x, i - 3, times(turn_by, -1.0))
    if count > 0:
        push, turn_by = vector(lane, x, row + 1), vector(lane, x, row + 4)
        push, turn_by = block_times(lane, S, factor_at(model, k, 0) + F.LR, push, turn_by)
        if model.inner is None:
            a, b = times(push, -1.0), times(turn_by, -1.0)
        else:
            a, b = minus(a, push), minus(b, turn_by)
    return a, b


@kernel
def _strains_down(lane, model, S, k, x):
    """`_down` of a link's strains."""
    to, n, i, zero = noted_at(model, k), _rows(model), strain_row(model, k), splat(lane, 0.0)
    a, b = vector(lane, S, to.on), vector(lane, S, to.on + 3)
    if k == model.links - 1:
        a, b = (zero, zero, zero), (zero, zero, zero)
    if k > 0:
        clear(lane, S, noted_at(model, k - 1).on, 6)
    if count_of(model, k) > 0:
        for c in range(n):
            last = to.last + 6 * c
            add(lane, x, i + c, dot(vector(lane, S, last), a) + dot(vector(lane, S, last + 3), b))
        a, b = _to_root(lane, S, to, a, b)
        solution(lane, n, S, to.matrix, x, i, 1)
        for c in range(n):
            own, on = load(lane, x, i + c), to.on_root + 6 * c
            a, b = minus(a, times(vector(lane, S, on), own)), minus(b, times(vector(lane, S, on + 3), own))
    return a, b


@kernel
def _up(lane, model, S, k, x, moved):
    """Back substitution of link k, the root being moved so."""
    if model.strains is not None:
        _strains_up(lane, model, S, k, x, moved)
        return
    i, (a, b) = joint_row(model, k) + 1, moved
    if count_of(model, k) == 0:
        put_vector(x, i, a)
        put_vector(x, i + 3, b)
    for e in range(count_of(model, k)):
        up, low = block_times(lane, S, factor_at(model, k, e) + F.RL, a, b)
        left = a, b
        a, b = minus(vector(lane, x, i), up), minus(vector(lane, x, i + 3), low)
        put_vector(x, i, a)
        put_vector(x, i + 3, b)
        if model.inner is not None:
            n = elements_before(model, k) + e
            inner.up(lane, model, S, inner_at(model, n), x, inner_row(model, n), left, (a, b))
        i += AXES


@kernel
def _strains_up(lane, model, S, k, x, moved):
    """`_up` of a link's strains."""
    to, n, i, (a, b) = noted_at(model, k), _rows(model), strain_row(model, k), moved
    if count_of(model, k) > 0:
        last = _to_last(lane, S, to, a, b)
        for c in range(n):
            over, o = to.over + 6 * c, to.last + 6 * c
            found = load(lane, x, i + c) - dot(vector(lane, S, over), a) - dot(vector(lane, S, over + 3), b)
            store(x, i + c, found)
            last = plus(last[0], times(vector(lane, S, o), found)), plus(last[1], times(vector(lane, S, o + 3), found))
        a, b = last
    put_vector(S, to.on, a)
    put_vector(S, to.on + 3, b)
