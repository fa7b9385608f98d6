"""Solve Newton's equations of a chain in space: forward elimination from tip to base, back substitution outward.

The vertices of a link of elements are eliminated one by one. For a link with strains the block on its last section is
transformed to its root and its strains, and then the strains are eliminated. Before `solve`, vectors x hold forces
(inertial) and moments (section axes). After `solve` the vectors x hold position increments (inertial) and rotation
increments (body axes).
"""

from __future__ import annotations

from ...compiler import Lanes, kernel, load_lane, superword
from ..arithmetic import store_vector
from . import inner
from .chain import fill_zeros, has_lever, three_of, transmit_wrench
from .inner import elements_before, factors, solution
from .layout import AXES, F, H, J, count_of, factor_at, hinge_at, inner_at, inner_row, joint_row, rows_before
from .matrix import (
    block_times,
    eliminate,
    eliminate_joint,
    factor_base,
    joint_motion_of_root,
    matrix_in,
    part_of,
    solve_base,
    solve_six,
    transposed_times,
)
from .rotations import Vector, add_vector, dot, load_vector
from .strained import strain_row
from .strained_layout import noted_at


@kernel
def factor(lane, model, S):
    """Factor the Newton matrix in S in place, link by link from the tip to the base (`protocol.factor`)."""
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
    """Replace x by S^-1 x with the factors that `factor` has left in S (`protocol.solve`).

    On entry x holds forces (inertial axes) and moments (section axes). On return x holds increments of positions
    (inertial axes) and of rotations (body axes).
    """
    for back_k in range(model.links):
        k = model.links - 1 - back_k
        _joint_down(lane, model, S, k, x, _down(lane, model, S, k, x))
    solve_base(lane, S, x, False)
    for k in range(model.links):
        _up(lane, model, S, k, x, _joint_up(lane, model, S, k, x))


@superword
def _condense_elements(lane, model, S: Lanes, k):
    """Condense the blocks of link k onto its root, vertex by vertex from the tip; the result is the link's first LL.

    LL, LR, RL, RR: the 6 x 6 blocks (left, right vertex) of each `FACTOR` in S; RR <- its factors, RL <- RR^-1 RL.
    """
    for back_e in range(count_of(model, k)):
        o = factor_at(model, k, count_of(model, k) - 1 - back_e)
        left, right = part_of(lane, S, o + F.LL, 36), part_of(lane, S, o + F.RR, 36)
        eliminate(lane, left, part_of(lane, S, o + F.LR, 36), part_of(lane, S, o + F.RL, 36), right)
        # LL += on the diagonal block RR of the vertex before: both are rows of the same vertex
        if back_e < count_of(model, k) - 1:
            for i in range(36):
                S[o - F.end + F.RR + i] += S[o + F.LL + i]


@kernel
def _rows(model):
    """Return the number of rows of a link's strains: three for each polynomial."""
    return 3 * len(model.polynomials)


@kernel
def _to_last(lane, S, to, a, b):
    """Return the motion of a link's last section due to the root's motion (a, b) at constant strains.

    a: displacement (inertial axes), b: rotation (root axes); result: displacement (inertial), rotation (last section's
    axes). to: `noted_at` of the link.
    """
    return a + matrix_in(lane, S, to.shift) @ b, matrix_in(lane, S, to.last_turn).T @ b


@kernel
def _to_root(lane, S, to, a, b):
    """Return the (force, moment) on a link's root equivalent to the (force, moment) = (a, b) on its last section.

    This is the transpose of `_to_last`. Forces along inertial axes, moments in the axes of the last section and of the
    root. to: `noted_at` of the link.
    """
    return a, matrix_in(lane, S, to.last_turn) @ b + matrix_in(lane, S, to.shift).T @ a


@kernel
def _condense_strains(lane, model, S: Lanes, k):
    """Condense block RR on the last section of link k onto its root (LL) and eliminate the link's strains.

    Rows: force along inertial, moment along section axes; columns: position along inertial, rotation along section
    axes.
    # in, out   `matrix`, `on_root`, `by_root` of `NOTED` hold the strains' own parts, to which those of RR are added
    # out       `matrix` <- its factors, `over` <- matrix^-1 by_root;  LL <- LL + T^T RR T - on_root over (`FACTOR`)
    T: `_to_last`.

    See theory, (9.4).
    """
    n, to, f = _rows(model), noted_at(model, k), factor_at(model, k, 0)
    zero = 0.0
    one = zero + 1.0
    # the last section moves with strain c by column c of `last`: add last^T RR last, and the coupling with the root
    for c in range(n):
        i = to.last + 6 * c
        on = block_times(lane, S, f + F.RR, load_vector(lane, S, i), load_vector(lane, S, i + 3))
        for row in range(n):
            o = to.last + 6 * row
            S[to.matrix + n * row + c] += dot(load_vector(lane, S, o), on[0]) + dot(load_vector(lane, S, o + 3), on[1])
        on = _to_root(lane, S, to, on[0], on[1])
        add_vector(lane, S, to.on_root + 6 * c, on[0])
        add_vector(lane, S, to.on_root + 6 * c + 3, on[1])
        on = transposed_times(lane, S, f + F.RR, load_vector(lane, S, i), load_vector(lane, S, i + 3))
        on = _to_root(lane, S, to, on[0], on[1])
        add_vector(lane, S, to.by_root + 6 * c, on[0])
        add_vector(lane, S, to.by_root + 6 * c + 3, on[1])
    # columns of the root's six motions: LL += T^T RR T, T = `_to_last`
    c = 0
    for axis in (Vector(one, zero, zero), Vector(zero, one, zero), Vector(zero, zero, one)):
        for place, turn in ((axis, Vector(zero, zero, zero)), (Vector(zero, zero, zero), axis)):
            moved = _to_last(lane, S, to, place, turn)
            on = block_times(lane, S, f + F.RR, moved[0], moved[1])
            on = _to_root(lane, S, to, on[0], on[1])
            for i in range(3):
                S[f + F.LL + 6 * i + c] += on[0][i]
                S[f + F.LL + 6 * i + 18 + c] += on[1][i]
            c += 3
        c -= 5
    # over = matrix^-1 by_root
    factors(lane, n, S, to.matrix)
    for i in range(6 * n):
        S[to.over + i] = S[to.by_root + i]
    for c in range(6):
        solution(lane, n, S, to.matrix, S, to.over + c, 6)
    # Schur complement LL - on_root over
    for i in range(6):
        for j in range(6):
            total = S[f + F.LL + 6 * i + j]
            for c in range(n):
                total = total - S[to.on_root + 6 * c + i] * S[to.over + 6 * c + j]
            S[f + F.LL + 6 * i + j] = total


@kernel
def _joint_down(lane, model, S: Lanes, k, x: Lanes, of):
    """Forward elimination of joint k: transmit `of` = (force, moment) on its link's root to the section before, in x.

    Force inertial, moment in root axes. x of the joint's row becomes (x + axis . moment + c . force) / pivot, and that
    times the joint's column is subtracted from the section before; a fixed joint keeps its row of x. c: `HINGE.swing`,
    motion of the link's first section per angle; column: `HINGE.column`, wrench on the section before per angle.
    See theory, (9.1).
    """
    h, row, (a, b) = hinge_at(k), joint_row(model, k), of
    axis, turn = three_of(lane, model.joints, J.end * k + J.axis), matrix_in(lane, S, h + H.turn)
    on_section, on_joint = turn @ b, dot(axis, b)
    # X^T f: the lever's moment of the force, on the section before
    if has_lever(model, k):
        on_section = on_section + matrix_in(lane, S, h + H.shift).T @ a
        on_joint = on_joint + dot(load_vector(lane, S, h + H.swing), a)
    transmit_wrench(lane, model, x, S, k, (a, on_section))
    if load_lane(lane, S, h + H.pinned, 0) == 0.0:
        own = (x[row] + on_joint) * S[h + H.pivot]
        column = load_vector(lane, S, h + H.column), load_vector(lane, S, h + H.column + 3)
        transmit_wrench(lane, model, x, S, k, (-own * column[0], -own * column[1]))
        x[row] = own


@kernel
def _joint_up(lane, model, S: Lanes, k, x: Lanes):
    """Back substitution of joint k: x of its row <- the angle; return its link's root motion (position, rotation).

    Position along inertial axes, rotation in root axes. x <- x - row . (motion of the section before), row:
    `HINGE.row`. See theory, (9.1).
    """
    h, row, (a, turned_by) = hinge_at(k), joint_row(model, k), _moved_before(lane, model, x, S, k)
    axis, turn = three_of(lane, model.joints, J.end * k + J.axis), matrix_in(lane, S, h + H.turn)
    own = x[row]
    for j in range(3):
        own = own - S[h + H.row + j] * a[j]
    for j in range(3):
        own = own - S[h + H.row + 3 + j] * turned_by[j]
    x[row] = own
    # rotation E^T b + way angle; position a + X b + drift angle
    b = turn.T @ turned_by + own * joint_motion_of_root(lane, model, S, k, axis)
    if has_lever(model, k):
        shift = matrix_in(lane, S, h + H.shift) @ turned_by
        a = a + (shift + own * load_vector(lane, S, h + H.drift))
    return a, b


@kernel
def _moved_before(lane, model, x, S, k):
    """Return (position, rotation) by which the section before joint k moves: from x, or from `NOTED.on` of link k - 1.

    `NOTED.on` applies if strains are coordinates. Position along inertial axes, rotation in section axes.
    """
    if model.strains is not None:
        if k > 0:
            on = noted_at(model, k - 1).on
            return load_vector(lane, S, on), load_vector(lane, S, on + 3)
    return load_vector(lane, x, rows_before(model, k)), load_vector(lane, x, rows_before(model, k) + 3)


@kernel
def _down(lane, model, S, k, x):
    """Forward elimination of link k in x: return the (force, moment) that remains on its root (inertial; root axes).

    For each vertex from the tip inward: x of the vertex <- RR^-1 x, then LR times this x is subtracted from x of the
    vertex before. RR (factored), LR: 6 x 6 blocks of each element's `FACTOR`. See theory, section 9, "Elimination".
    """
    if model.strains is not None:
        return _strains_down(lane, model, S, k, x)
    # a rigid link: its rows are those of its root, (force, moment) = (a, b)
    row, count = joint_row(model, k), count_of(model, k)
    a, b = load_vector(lane, x, row + 1), load_vector(lane, x, row + 4)
    for back_e in range(count):
        e = count - 1 - back_e
        o, i = factor_at(model, k, e), row + 1 + AXES * e
        # inner modes go first, since they were condensed first: x_e - K_ep K_pp^-1 x_p
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
            push, turn_by = block_times(lane, S, o + F.LR, load_vector(lane, x, i), load_vector(lane, x, i + 3))
            add_vector(lane, x, i - 6, -push)
            add_vector(lane, x, i - 3, -turn_by)
    # the first element's left end is the root: LR times (push, turn_by) goes to its wrench
    if count > 0:
        push, turn_by = load_vector(lane, x, row + 1), load_vector(lane, x, row + 4)
        push, turn_by = block_times(lane, S, factor_at(model, k, 0) + F.LR, push, turn_by)
        if model.inner is None:
            a, b = -push, -turn_by
        else:
            a, b = a - push, b - turn_by
    return a, b


@kernel
def _strains_down(lane, model, S, k, x: Lanes):
    """Forward elimination of link k with strains: return the (force, moment) that remains on its root.

    Force inertial, moment in root axes. `NOTED.on` of link k is the wrench on its last section (0 at the tip); that of
    link k - 1 is set to zero here, for `_joint_down` to add to. The strains' rows of x become matrix^-1 x, with
    `NOTED.matrix`. See theory, (9.4).
    """
    to, n, i, zero = noted_at(model, k), _rows(model), strain_row(model, k), 0.0
    a, b = load_vector(lane, S, to.on), load_vector(lane, S, to.on + 3)
    if k == model.links - 1:
        a, b = Vector(zero, zero, zero), Vector(zero, zero, zero)
    if k > 0:
        fill_zeros(lane, S, noted_at(model, k - 1).on, 6)
    if count_of(model, k) > 0:
        # rows of the strains get last^T (a, b)
        for c in range(n):
            last = to.last + 6 * c
            x[i + c] += dot(load_vector(lane, S, last), a) + dot(load_vector(lane, S, last + 3), b)
        a, b = _to_root(lane, S, to, a, b)
        # c <- matrix^-1 x, then what the strains require of the root: (a, b) - on_root c
        solution(lane, n, S, to.matrix, x, i, 1)
        for c in range(n):
            own, on = x[i + c], to.on_root + 6 * c
            a, b = a - own * load_vector(lane, S, on), b - own * load_vector(lane, S, on + 3)
    return a, b


@kernel
def _up(lane, model, S, k, x, moved):
    """Back substitution of link k in x, from the motion `moved` = (position, rotation) of its root outward.

    Position along inertial axes, rotation in root axes. x of each vertex <- x - RR^-1 RL (motion of the vertex before);
    `FACTOR.RL` holds RR^-1 RL. See theory, section 9, "Elimination".
    """
    if model.strains is not None:
        _strains_up(lane, model, S, k, x, moved)
        return
    i, (a, b) = joint_row(model, k) + 1, moved
    # a rigid link: its rows move as its root, (a, b)
    if count_of(model, k) == 0:
        store_vector(lane, x, i, a)
        store_vector(lane, x, i + 3, b)
    for e in range(count_of(model, k)):
        up, low = block_times(lane, S, factor_at(model, k, e) + F.RL, a, b)
        left = a, b
        a, b = load_vector(lane, x, i) - up, load_vector(lane, x, i + 3) - low
        store_vector(lane, x, i, a)
        store_vector(lane, x, i + 3, b)
        if model.inner is not None:
            n = elements_before(model, k) + e
            inner.up(lane, model, S, inner_at(model, n), x, inner_row(model, n), left, (a, b))
        i += AXES


@kernel
def _strains_up(lane, model, S, k, x: Lanes, moved):
    """Back substitution of the strains of link k; `NOTED.on` <- (position, rotation) by which its last section moves.

    moved: motion of the root (inertial; root axes). Strains: x <- x - over moved; the last section adds `last` x
    (`NOTED`).
    """
    to, n, i, (a, b) = noted_at(model, k), _rows(model), strain_row(model, k), moved
    if count_of(model, k) > 0:
        last = _to_last(lane, S, to, a, b)
        for c in range(n):
            over, o = to.over + 6 * c, to.last + 6 * c
            found = x[i + c] - dot(load_vector(lane, S, over), a) - dot(load_vector(lane, S, over + 3), b)
            x[i + c] = found
            last = (last[0] + found * load_vector(lane, S, o), last[1] + found * load_vector(lane, S, o + 3))
        a, b = last
    store_vector(lane, S, to.on, a)
    store_vector(lane, S, to.on + 3, b)
