"""Solve Newton's equations of a chain in space: forward elimination from tip to base, back substitution outward.

The vertices of a link with elements are eliminated one by one. For a link with strains, the block on its last section
is transformed to its root and its strains, and then the strains are eliminated. Before `solve`, a vector x contains
forces (inertial axes) and moments (section axes). After `solve`, x contains position increments (inertial axes) and
rotation increments (body axes).
"""

from __future__ import annotations

from ...compiler import Lanes, kernel, load_lane, superword
from ..arithmetic import store_vector
from . import inner
from .chain import fill_zeros, has_lever, transmit_wrench
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
from .rotations import Vector, add_vector, dot, load_vector, three_of
from .strained import strain_row
from .strained_layout import noted_at


@kernel
def factor(lane, model, S):
    """Factor the Newton matrix in S in place, one link after another from the tip to the base (`protocol.factor`)."""
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
    """Replace the right side x by the solution S^-1 x, using the factors that `factor` stored in S (`protocol.solve`).

    On entry x contains forces (inertial axes) and moments (section axes). On return x contains increments of positions
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
    """Condense the matrix blocks of link k onto its root, from the tip inward; the result is the block LL of element 0.

    LL, LR, RL and RR are the 6 x 6 blocks of each element's `FACTOR` record in S; the first letter names the rows, the
    second the columns (left or right vertex). RR is replaced by its factors, RL by RR^-1 RL.
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
    """Return the number of rows for the strains of one link: three for each polynomial."""
    return 3 * len(model.polynomials)


@kernel
def _to_last(lane, S, to, a, b):
    """Return the motion of a link's last section that the motion (a, b) of its root causes at constant strains.

    a is a displacement (inertial axes), b a rotation (root axes).
    Result: displacement (inertial axes), rotation (axes of the last section).
    to: `noted_at`, offsets of the link's stored kinematics in S.
    """
    return a + matrix_in(lane, S, to.shift) @ b, matrix_in(lane, S, to.last_turn).T @ b


@kernel
def _to_root(lane, S, to, a, b):
    """Return the (force, moment) on a link's root that is equivalent to the (force, moment) (a, b) on its last section.

    `_to_root` is the transpose of `_to_last`. Forces are along inertial axes; each moment is in the axes of its own
    section.
    to: `noted_at`, offsets of the link's stored kinematics in S.
    """
    return a, matrix_in(lane, S, to.last_turn) @ b + matrix_in(lane, S, to.shift).T @ a


@kernel
def _condense_strains(lane, model, S: Lanes, k):
    """Condense the block RR on the last section of link k onto its root block LL, and eliminate the link's strains.

    Rows are forces along inertial axes and moments along section axes; columns are positions along inertial axes and
    rotations along section axes.
    # in, out   `NOTED.matrix`, `on_root`, `by_root`: the strains' own parts; the parts from RR are added
    # out       `NOTED.matrix` <- its factors, `over` <- matrix^-1 by_root; `FACTOR.LL` <- LL + T^T RR T - on_root over
    T is the linear map `_to_last`.

    See docs/theory.md, (9.4).
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
    """Eliminate joint k from x: transmit the wrench `of` = (force, moment) on the link's root to the section before.

    The force is along inertial axes, the moment in root axes. The joint's row of x becomes (x + axis . moment + c .
    force) / pivot. The new row times `HINGE.column` is subtracted from the wrench on the section before. The row of a
    fixed joint keeps its value. c is `HINGE.swing`, the motion of the link's first section per joint angle;
    `HINGE.column` is the wrench on the section before per joint angle.
    See docs/theory.md, (9.1).
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
    """Compute the angle of joint k by back substitution, store it in x, and return the motion of the link's root.

    The motion is a pair: position along inertial axes, rotation in root axes. The product of `HINGE.row` with the
    motion of the section before is subtracted from the joint's row of x. See docs/theory.md, (9.1).
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
    """Return (position, rotation), the increments of the section before joint k.

    If strains are coordinates, the function reads the increments from `NOTED.on` of link k - 1, otherwise from x.
    Position along inertial axes, rotation in section axes.
    """
    if model.strains is not None:
        if k > 0:
            on = noted_at(model, k - 1).on
            return load_vector(lane, S, on), load_vector(lane, S, on + 3)
    return load_vector(lane, x, rows_before(model, k)), load_vector(lane, x, rows_before(model, k) + 3)


@kernel
def _down(lane, model, S, k, x):
    """Eliminate the vertices of link k from x; return the (force, moment) that remains on the link's root.

    The force is along inertial axes, the moment in root axes. From the tip inward, x of each vertex becomes RR^-1 x;
    then LR times this x is subtracted from x of the preceding vertex. RR (factored) and LR are 6 x 6 blocks of each
    element's `FACTOR` record in S. See docs/theory.md, section 9, "Elimination".
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
    """Eliminate the strains of link k from x; return the (force, moment) that remains on the link's root.

    The force is along inertial axes, the moment in root axes. `NOTED.on` of link k contains the wrench on the link's
    last section (0 at the tip). `NOTED.on` of link k - 1 is set to zero, so that `_joint_down` can add to it. The
    strains' rows of x become matrix^-1 x with the matrix `NOTED.matrix`. See docs/theory.md, (9.4).
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
    """Compute the increments of the vertices of link k by back substitution, from the motion of its root outward.

    moved: increments (position along inertial axes, rotation in root axes) of the root. From x of each vertex subtract
    RR^-1 RL (motion of the preceding vertex); `FACTOR.RL` contains the matrix RR^-1 RL. See docs/theory.md, section 9,
    "Elimination".
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
    """Compute the strains of link k by back substitution, and store the motion of its last section in `NOTED.on`.

    moved: increments of the root (position along inertial axes, rotation in root axes). From the strains' rows of x
    subtract `NOTED.over` times moved. `NOTED.last` then maps the strains to their part of the last section's motion.
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
