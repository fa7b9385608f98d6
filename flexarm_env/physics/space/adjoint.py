"""Reverse derivatives of beams in space: the transposed linear system, and the product with the matrix (`matrix`).

The matrix maps position increments (inertial axes) and rotation increments (body axes) to forces (inertial axes) and
moments (section axes).
"""

from ...compiler import kernel, load, splat, store
from ..arithmetic import add_to, store_vector
from ..protocol import register
from .chain import SpatialBeam, fill_zeros, has_lever
from .inner import down_transposed, elements_before, multiplied, up_transposed
from .layout import AXES, B, F, H, J, count_of, factor_at, hinge_at, inner_at, inner_row, joint_row, rows_before
from .matrix import (
    block_times,
    joint_motion_of_root,
    matrix_in,
    part_of,
    solve_base,
    solve_six_transposed,
    swing_of,
    transposed_times,
)
from .rotations import Vector, add_vector, cross, dot, load_vector, three_of


@kernel
def multiply(lane, model, S, x, y):
    """Add the product K x to y, where K is the assembled Newton matrix in S (`protocol.multiply`; theory, 9).

    The vector x contains position increments (m, inertial axes), rotation increments (rad, body axes) and joint angles
    (rad). The vector y contains forces (N), moments and joint torques (N m). `assemble` has already condensed the inner
    modes in S.
    """
    # from the base outward: (a, b), motion of each link's root (inertial, body axes); then each element's block times
    # it
    for k in range(model.links):
        h, row, under = hinge_at(k), joint_row(model, k), rows_before(model, k)
        axis, turn = three_of(lane, model.joints, J.end * k + J.axis), matrix_in(lane, S, h + H.turn)
        own = load(lane, x, row)
        a, turned_by = load_vector(lane, x, under), load_vector(lane, x, under + 3)
        b = turn.T @ turned_by + own * axis
        if has_lever(model, k):
            frame, swing = matrix_in(lane, S, h + H.frame), swing_of(lane, model, k, axis, turn)
            moved = own * swing - cross(load_vector(lane, S, h + H.lever), turned_by)
            a = a + frame @ moved
        # a rigid link has one block, its root's
        first = factor_at(model, k, 0)
        force, moment = block_times(lane, S, first + F.LL, a, b)
        for e in range(count_of(model, k)):
            o, i = first + F.end * e, row + 1 + AXES * e
            c, d = load_vector(lane, x, i), load_vector(lane, x, i + 3)
            left, right = block_times(lane, S, o + F.LL, a, b), block_times(lane, S, o + F.RL, a, b)
            more, far = block_times(lane, S, o + F.LR, c, d), block_times(lane, S, o + F.RR, c, d)
            # `condense` has eliminated the inner modes p from S: K_ep p + K_pe terms are added
            if model.inner is not None:
                n = elements_before(model, k) + e
                at, first_row = inner_at(model, n), inner_row(model, n)
                more_l, more_r = multiplied(lane, model, S, at, x, y, first_row, (a, b), (c, d))
                left = left[0] + more_l[0], left[1] + more_l[1]
                right = right[0] + more_r[0], right[1] + more_r[1]
            if e == 0:
                force, moment = left[0] + more[0], left[1] + more[1]
            else:
                _add_both(lane, y, i - AXES, left, more)
            _add_both(lane, y, i, right, far)
            a, b = c, d
        store_vector(lane, S, h + H.now_force, force)
        store_vector(lane, S, h + H.now_moment, moment)
    # from the tip inward: wrenches on roots onto the joint's row and the section before, by the transpose of (9.1)
    for back_k in range(model.links):
        k = model.links - 1 - back_k
        h, row, under = hinge_at(k), joint_row(model, k), rows_before(model, k)
        axis, turn = three_of(lane, model.joints, J.end * k + J.axis), matrix_in(lane, S, h + H.turn)
        own = load(lane, x, row)
        force, moment = load_vector(lane, S, h + H.now_force), load_vector(lane, S, h + H.now_moment)
        if count_of(model, k) == 0:
            force, moment = force + load_vector(lane, y, row + 1), moment + load_vector(lane, y, row + 4)
            fill_zeros(lane, y, row + 1, AXES)
        # joint row axis . m; E m, with the geometric part of the moment on the root
        on_joint = dot(axis, moment)
        on_section = turn @ (moment + own * cross(axis, load_vector(lane, S, h + H.moment)))
        if has_lever(model, k):
            # levers t, o: shift X and swing c of the place, as in `matrix.eliminate_joint`
            frame, swing = matrix_in(lane, S, h + H.frame), swing_of(lane, model, k, axis, turn)
            lever, pull = load_vector(lane, S, h + H.lever), load_vector(lane, S, h + H.force)
            inner = frame.T @ force + cross(pull, load_vector(lane, x, under + 3))
            on_section = on_section + (cross(lever, inner) + own * cross(swing, pull))
            on_joint = on_joint + dot(swing, inner) + dot(swing, cross(pull, turn @ axis)) * own
        add_to(lane, y, row, on_joint)
        add_vector(lane, y, under, force)
        add_vector(lane, y, under + 3, on_section)
    # S of the base times (dr, dtheta), the first six rows of x
    force, moment = block_times(lane, S, B.matrix, load_vector(lane, x, 0), load_vector(lane, x, 3))
    add_vector(lane, y, 0, force)
    add_vector(lane, y, 3, moment)


@kernel
def _add_both(lane, y, i, a, b):
    """Add the sum of the pairs a and b, each (force, moment), to the six entries y[i : i + 6]."""
    add_vector(lane, y, i, a[0] + b[0])
    add_vector(lane, y, i + 3, a[1] + b[1])


@kernel
def solve_transposed(lane, model, S, x):
    """Replace x by S^-T x, the solution of the transposed system; `elimination.factor` has stored the factors in S."""
    for back_k in range(model.links):
        _up(lane, model, S, model.links - 1 - back_k, x)
    solve_base(lane, S, x, True)
    for k in range(model.links):
        _down(lane, model, S, k, x)


@kernel
def _take(lane, x, i, S, o, a, b):
    """Subtract M^T (a, b) from x[i : i + 6]. M is the 6 x 6 matrix at offset o of S; a and b are vectors."""
    upper, lower = transposed_times(lane, S, o, a, b)
    store_vector(lane, x, i, load_vector(lane, x, i) - upper)
    store_vector(lane, x, i + 3, load_vector(lane, x, i + 3) - lower)


@kernel
def _up(lane, model, S, k, x):
    """Apply the transpose of `elimination._up` and `_joint_up` to the rows of link k in x, from tip to root.

    Loop over the vertices from the tip: subtract RL^T (x of this vertex) from x of the preceding vertex. RL is a block
    of the element's `FACTOR` record in S. Then cross the joint and update the joint's row of x. See docs/theory.md,
    section 9, "Elimination".
    """
    h, row, under, count = hinge_at(k), joint_row(model, k), rows_before(model, k), count_of(model, k)
    axis, turn = three_of(lane, model.joints, J.end * k + J.axis), matrix_in(lane, S, h + H.turn)
    # the inner modes' back substitution was last; (p, m): the first segment's part of the root
    zero = splat(lane, 0.0)
    p, m = Vector(zero, zero, zero), Vector(zero, zero, zero)
    if model.inner is not None:
        for e in range(count):
            n, i = elements_before(model, k) + e, row + 1 + AXES * e
            left = up_transposed(lane, model, S, inner_at(model, n), x, inner_row(model, n), i)
            if e > 0:
                add_vector(lane, x, i - 6, left[0])
                add_vector(lane, x, i - 3, left[1])
            else:
                p, m = left
    for back_e in range(count - 1):
        e = count - 1 - back_e
        i = row + 1 + AXES * e
        _take(lane, x, i - AXES, S, factor_at(model, k, e) + F.RL, load_vector(lane, x, i), load_vector(lane, x, i + 3))
    a, b = load_vector(lane, x, row + 1), load_vector(lane, x, row + 4)
    if count > 0:
        a, b = transposed_times(lane, S, factor_at(model, k, 0) + F.RL, -a, -b)
        if model.inner is not None:
            a, b = a + p, b + m
    # transpose of the joint's back substitution
    own, on_section = load(lane, x, row) + dot(joint_motion_of_root(lane, model, S, k, axis), b), turn @ b
    if has_lever(model, k):
        on_section = on_section + matrix_in(lane, S, h + H.shift).T @ a
        own = own + dot(load_vector(lane, S, h + H.drift), a)
    store(x, row, own)
    add_vector(lane, x, under, a)
    add_vector(lane, x, under + 3, on_section)
    for j in range(6):
        add_to(lane, x, under + j, -(load(lane, S, h + H.row + j) * own))


@kernel
def _down(lane, model, S, k, x):
    """Apply the transpose of `elimination._down` and `_joint_down` to the rows of link k in x, from root to tip.

    Solve for the joint's row of x first, then for each vertex: subtract LR^T (x of the preceding vertex) and solve with
    the transposed factors of RR. LR and RR are blocks of the element's `FACTOR` record in S. See docs/theory.md,
    section 9, "Elimination".
    """
    h, row, under = hinge_at(k), joint_row(model, k), rows_before(model, k)
    axis, turn = three_of(lane, model.joints, J.end * k + J.axis), matrix_in(lane, S, h + H.turn)
    own, a, turned_by = load(lane, x, row), load_vector(lane, x, under), load_vector(lane, x, under + 3)
    b = turn.T @ turned_by
    # own = (own - column . x) / pivot: transpose of the elimination of the joint's row
    if S[(h + H.pinned) * len(lane)] == 0.0:
        for j in range(6):
            own = own - load(lane, S, h + H.column + j) * load(lane, x, under + j)
        own = own * load(lane, S, h + H.pivot)
        store(x, row, own)
        b = b + own * axis
    if has_lever(model, k):
        a = a + matrix_in(lane, S, h + H.shift) @ turned_by
        if S[(h + H.pinned) * len(lane)] == 0.0:
            a = a + own * load_vector(lane, S, h + H.swing)
    i = row + 1
    if count_of(model, k) == 0:
        store_vector(lane, x, i, a)
        store_vector(lane, x, i + 3, b)
    # transposed back substitution: x <- RR^-T (x - LR^T (a, b)), vertex by vertex
    for e in range(count_of(model, k)):
        o = factor_at(model, k, e)
        _take(lane, x, i, S, o + F.LR, a, b)
        solve_six_transposed(lane, part_of(lane, S, o + F.RR, 36), part_of(lane, x, i, 6))
        left = a, b
        a, b = load_vector(lane, x, i), load_vector(lane, x, i + 3)
        if model.inner is not None:
            n = elements_before(model, k) + e
            down_transposed(lane, model, S, inner_at(model, n), x, inner_row(model, n), left, (a, b))
        i += AXES


register(SpatialBeam, multiply, solve_transposed)
