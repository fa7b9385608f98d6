"""A body's part of the chain's matrix: what lies behind it taken in, its elastic coordinates eliminated, solved for.

From tip to root what is left is three rows, of the force and the moment at the root section; from root to tip goes the
change of the acceleration and of the angle there.
"""

from __future__ import annotations

from ...compiler.decorator import kernel
from ...compiler.dispatch import size
from ...compiler.lanes import load, splat, store
from ...compiler.trace import unrolled
from .body import constants, dot, turn_of_root
from .layout import factors_at


@unrolled
@kernel
def take_in(lane, model, D, S, tail):
    """The body's matrix with what lies behind it.

    tail (9, by rows, global axes): change of force and moment by a change of the acceleration and the angle at the tip
    section; it is turned to the frame's axes.
    """
    own, n = constants(model), size(model.n)
    at = factors_at(0, n)
    W, wide = at.matrix, n + 3
    _turn_matrix(lane, tail, load(lane, S, at.frame), -load(lane, S, at.frame + 1))
    for j in range(wide):  # what comes back through the tip by column j
        if j < n:
            bx, by = load(lane, S, at.swept + j), load(lane, S, at.swept + n + 1 + j)
            fx, fy, m = _times(lane, tail, bx, by, splat(lane, D[own.tip + 2 * n + j]))
        elif j == wide - 1:
            bx, by = load(lane, S, at.swept + n), load(lane, S, at.swept + n + 1 + n)
            fx, fy, m = _times(lane, tail, bx, by, splat(lane, 1.0))
        else:
            fx, fy, m = load(lane, tail, j - n), load(lane, tail, 3 + j - n), load(lane, tail, 6 + j - n)
        for i in range(wide):
            k = W + i * wide + j
            if i < n:
                part = load(lane, S, at.arm + i) * fx + load(lane, S, at.arm + n + 1 + i) * fy
                part = part + m * D[own.tip + 2 * n + i]
            elif i == n:
                part = fx
            elif i == n + 1:
                part = fy
            else:
                part = load(lane, S, at.arm + n) * fx + load(lane, S, at.arm + n + 1 + n) * fy + m
            store(S, k, load(lane, S, k) + part)


@unrolled
@kernel
def condense(lane, model, D, S, tail):
    """Take in what lies behind, eliminate the elastic coordinates, hand on what is left.

    tail (9, by rows, global axes): change of force and moment by a change of the acceleration and the angle; in at the
    tip section, out at the root section. Factors stay in the matrix, pivots inverted: no pivoting, since cm M, positive
    definite, outweighs the rest.
    """
    take_in(lane, model, D, S, tail)
    own, n = constants(model), size(model.n)
    at = factors_at(0, n)
    W, wide = at.matrix, n + 3
    if model.chord is not None:  # from the frame's angle to the root section's
        for i in range(wide):
            last = load(lane, S, W + i * wide + n + 2)
            for j in range(n):
                k = W + i * wide + j
                store(S, k, load(lane, S, k) - last * D[own.root + j])
        for j in range(wide):
            last = load(lane, S, W + (n + 2) * wide + j)
            for i in range(n):
                k = W + i * wide + j
                store(S, k, load(lane, S, k) - last * D[own.root + i])
    for k in range(n):
        inverse = 1.0 / load(lane, S, W + k * wide + k)
        store(S, W + k * wide + k, inverse)
        for i in range(k + 1, wide):
            f = load(lane, S, W + i * wide + k) * inverse
            store(S, W + i * wide + k, f)
            for j in range(k + 1, wide):
                place = W + i * wide + j
                store(S, place, load(lane, S, place) - f * load(lane, S, W + k * wide + j))
    for i in range(3):
        for j in range(3):
            store(tail, 3 * i + j, load(lane, S, W + (n + i) * wide + n + j))
    _turn_matrix(lane, tail, load(lane, S, at.frame), load(lane, S, at.frame + 1))


@kernel
def _times(lane, tail, x, y, turn):
    """The matrix of three rows times (x, y, turn)."""
    return (
        load(lane, tail, 0) * x + load(lane, tail, 1) * y + load(lane, tail, 2) * turn,
        load(lane, tail, 3) * x + load(lane, tail, 4) * y + load(lane, tail, 5) * turn,
        load(lane, tail, 6) * x + load(lane, tail, 7) * y + load(lane, tail, 8) * turn,
    )


@kernel
def _turn_matrix(lane, tail, c, s):
    """The matrix of three rows in axes turned back by the angle with cosine c and sine s."""
    for j in range(3):
        x, y = load(lane, tail, j), load(lane, tail, 3 + j)
        store(tail, j, c * x - s * y)
        store(tail, 3 + j, s * x + c * y)
    for i in range(3):
        x, y = load(lane, tail, 3 * i), load(lane, tail, 3 * i + 1)
        store(tail, 3 * i, c * x - s * y)
        store(tail, 3 * i + 1, s * x + c * y)


@unrolled
@kernel
def reduce(lane, model, D, S, x, flow):
    """Right sides from tip to root: flow (3, global axes) is what is left of those behind, in force and moment."""
    own, n = constants(model), size(model.n)
    at = factors_at(0, n)
    W, wide = at.matrix, n + 3
    c, s = load(lane, S, at.frame), load(lane, S, at.frame + 1)
    fx, fy, moment = load(lane, flow, 0), load(lane, flow, 1), load(lane, flow, 2)
    gx, gy = c * fx + s * fy, c * fy - s * fx
    turning = load(lane, S, at.arm + n) * gx + load(lane, S, at.arm + n + 1 + n) * gy + moment
    left_x, left_y, left_t = gx, gy, turning
    for i in range(n):
        total = load(lane, x, i) - (load(lane, S, at.arm + i) * gx + load(lane, S, at.arm + n + 1 + i) * gy)
        total = total - moment * D[own.tip + 2 * n + i]
        if model.chord is not None:
            total = total + turning * D[own.root + i]
        for j in range(i):
            total = total - load(lane, S, W + i * wide + j) * load(lane, x, j)
        store(x, i, total)
        left_x = left_x + load(lane, S, W + n * wide + i) * total
        left_y = left_y + load(lane, S, W + (n + 1) * wide + i) * total
        left_t = left_t + load(lane, S, W + (n + 2) * wide + i) * total
    store(flow, 0, c * left_x - s * left_y)
    store(flow, 1, s * left_x + c * left_y)
    store(flow, 2, left_t)


@unrolled
@kernel
def restore(lane, model, D, S, x, flow):
    """Solution from root to tip: flow (3, global axes) is the change of acceleration and angle at a section."""
    own, n = constants(model), size(model.n)
    at = factors_at(0, n)
    W, wide = at.matrix, n + 3
    c, s = load(lane, S, at.frame), load(lane, S, at.frame + 1)
    fx, fy, turn = load(lane, flow, 0), load(lane, flow, 1), load(lane, flow, 2)
    bx, by = c * fx + s * fy, c * fy - s * fx
    for i in range(n - 1, -1, -1):
        row = W + i * wide
        total = load(lane, x, i) - load(lane, S, row + n) * bx - load(lane, S, row + n + 1) * by
        total = total - load(lane, S, row + n + 2) * turn
        for j in range(i + 1, n):
            total = total - load(lane, S, row + j) * load(lane, x, j)
        store(x, i, total * load(lane, S, row + i))
    if model.chord is not None:
        turn = turn - turn_of_root(lane, model, D, x)
    bx, by = bx + load(lane, S, at.swept + n) * turn, by + load(lane, S, at.swept + n + 1 + n) * turn
    for j in range(n):
        bx = bx + load(lane, S, at.swept + j) * load(lane, x, j)
        by = by + load(lane, S, at.swept + n + 1 + j) * load(lane, x, j)
    store(flow, 0, c * bx - s * by)
    store(flow, 1, s * bx + c * by)
    store(flow, 2, turn + dot(lane, model, D, own.tip + 2 * n, x))
