"""Common part of contributions that are forces on a point of the arm and depend on its position, such as a spring.

The point is a point load of the arm (`AtPoint.place`). Every formulation therefore computes the displacement y of the
point, the generalized forces B f of a force f on the point, and the change of B with q. A stiffness k of the point adds
the block B k B^T to the matrix. It has few columns and is applied to solutions (theory, (6.7)):

    (S + B k B^T)^-1 b = x - W C B^T x,   x = S^-1 b,   W = S^-1 B,   C = (1 + k B^T W)^-1 k

A contribution registers `BLOCK`, its `point_forces` and `energy`, and an `assemble` that calls `store_block`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

from ...compiler import Lanes, kernel, size, stack
from ...parameters import Arm
from .. import protocol


class Point(NamedTuple):
    """A point of the arm on which a contribution acts, the field `point` of its record.

    Entries in S from `at` on: B, then W, each with a column of n numbers per axis; C (axes x axes); scratch of the same
    size; k.
    """

    input: int  # first of its entries in the arm's inputs (N) and input displacements (m, inertial axes)
    at: int  # offset in S
    axes: tuple[int, ...]  # as many zeros as the force has components: 2, in space 3
    room: tuple[int, ...]  # as many zeros as the Model has rows: size of stack arrays


@dataclass(frozen=True)
class AtPoint:
    """A kind of contribution at a point. An arm has it if one of the fields is not at its default.

    fields: names of fields of `Arm`. place: function that returns the point's (link, end) of an arm. make: function
    that returns the record.
    """

    fields: tuple[str, ...]
    place: Callable[[Arm], tuple[int, str]]
    make: Callable[[Arm, Point], Any]


KINDS: list[AtPoint] = []
"""Kinds of contributions at points. A module that defines a kind appends it."""


def numbers_in_matrix(rows: int, axes: int) -> int:
    """Return the number of entries of a `Point` in S; rows: number of rows of the Model."""
    return 2 * rows * axes + 2 * axes * axes + 1


@kernel
def point_displacement(lane, point, model, par, q, y):
    """Write the input displacements of the arm alone to y; the point's (m, inertial axes) begin at `point.input`.

    point: the `Point`; q: coordinates; y: as many entries as the arm has inputs.
    """
    protocol.input_displacements(lane, model.arm, par, q, y)


@kernel
def _column(lane, point, S: Lanes, k):
    """Return column k of B (k < axes) or column k - axes of W = S^-1 B (axes <= k < 2 axes), a view of n rows of S.

    Column i of B: generalized forces of a force of 1 N on the point along axis i.
    """
    n = size(point.room)
    return S[point.at + k * n : point.at + (k + 1) * n]


@kernel
def _inverse_at(point):
    """Return the offset in S of C = (1 + k B^T W)^-1 k (axes x axes, by rows); scratch of equal size and k follow."""
    return point.at + 2 * len(point.axes) * size(point.room)


@kernel
def _stiffness_at(point):
    """Return the offset in S of k, the weighted stiffness (N/m) of the point."""
    return _inverse_at(point) + 2 * len(point.axes) * len(point.axes)


@kernel
def store_block(lane, point, model, par, state, u: Lanes, stiffness, S: Lanes):
    """Store B and k of the block B k B^T; the `assemble` of a contribution with a matrix calls it.

    stiffness: k (N/m) times the weight of dr/dq in the matrix. Column i of B: the generalized forces of a force of 1 N
    on the point along axis i, which is how much that force lowers the arm's residual. Theory, (6.7).
    """
    n, axes = size(model.arm.n), len(point.axes)
    inputs, still, moved = stack(lane, model.points), stack(lane, point.room), stack(lane, point.room)
    for k in range(size(model.n_inputs)):
        inputs[k] = u[k]
    # r at the forces f that act now; below at f + e_i, so that column i of B is their difference, r being linear in f
    protocol.residual(lane, model.arm, par, state, inputs, still, S)
    for i in range(axes):
        force = inputs[point.input + i]
        inputs[point.input + i] = force + 1.0
        protocol.residual(lane, model.arm, par, state, inputs, moved, S)
        inputs[point.input + i] = force
        column = _column(lane, point, S, i)
        for k in range(size(model.n)):
            column[k] = 0.0
        for k in range(n):
            column[k] = still[k] - moved[k]
    S[_stiffness_at(point)] = 0.0 + stiffness


@kernel
def fix_coordinate(lane, part, model, S, k):
    """Set row k of B to 0: a fixed or prescribed coordinate does not move the point."""
    for i in range(len(part.point.axes)):
        _column(lane, part.point, S, i)[k] = 0.0


@kernel
def before_factor(lane, part, model, S: Lanes):
    """Set W and C (module docstring) to 0: `solve` leaves out the block B k B^T until `after_factor` has run."""
    point, axes = part.point, len(part.point.axes)
    for i in range(axes):
        for k in range(size(model.n)):
            _column(lane, point, S, axes + i)[k] = 0.0
        for j in range(axes):
            S[_inverse_at(point) + axes * i + j] = 0.0


@kernel
def after_factor(lane, part, model, S: Lanes):
    """Compute W = S^-1 B and C = (1 + k B^T W)^-1 k from B and k in S, by Gauss-Jordan elimination without pivoting.

    With them `after_solve` adds the block B k B^T of the point's stiffness k to solutions with the factors in S.
    Theory, (6.7).
    """
    point, axes, n = part.point, len(part.point.axes), size(model.n)
    for i in range(axes):
        # W e_i = S^-1 B e_i, with factors that do not contain the block yet
        column = _column(lane, point, S, axes + i)
        for k in range(n):
            column[k] = _column(lane, point, S, i)[k]
        protocol.solve(lane, model, S, column)
    # scratch <- 1 + k B^T W, C <- k
    c, stiffness = _inverse_at(point), S[_stiffness_at(point)]
    a = c + axes * axes
    for i in range(axes):
        for j in range(axes):
            own = 1.0 if i == j else 0.0
            work = _dot(lane, n, _column(lane, point, S, i), _column(lane, point, S, axes + j))
            S[a + axes * i + j] = own + stiffness * work
            S[c + axes * i + j] = own * stiffness
    for i in range(axes):
        # Gauss-Jordan: no pivoting, because 1 + k B^T W has eigenvalues of at least 1 where S is positive definite
        inverse = 1.0 / S[a + axes * i + i]
        for j in range(axes):
            S[a + axes * i + j] *= inverse
            S[c + axes * i + j] *= inverse
        for m in range(axes):
            if m != i:
                share = S[a + axes * m + i]
                for j in range(axes):
                    S[a + axes * m + j] -= share * S[a + axes * i + j]
                    S[c + axes * m + j] -= share * S[c + axes * i + j]


@kernel
def _dot(lane, n, x: Lanes, y: Lanes):
    """Return x . y of n rows."""
    total = 0.0
    for k in range(n):
        total = total + x[k] * y[k]
    return total


@kernel
def _subtract(lane, point, n, S: Lanes, along, target, transposed, x: Lanes):
    """Compute x <- x - target C (along^T x), or with C^T (transposed True); C: axes x axes numbers in S.

    along, target: number of the first column of each, 0 for B and `axes` for W = S^-1 B; n: rows of x. Theory, (6.7).
    """
    axes, c = len(point.axes), _inverse_at(point)
    parts = stack(lane, point.axes)
    for j in range(axes):
        # B^T x (or W^T x) before x changes, because all columns of C need it
        parts[j] = _dot(lane, n, _column(lane, point, S, along + j), x)
    for i in range(axes):
        share = 0.0
        for j in range(axes):
            entry = axes * j + i if transposed else axes * i + j
            share = share + S[c + entry] * parts[j]
        column = _column(lane, point, S, target + i)
        for k in range(n):
            x[k] -= column[k] * share


@kernel
def before_solve(lane, part, model, S, x, transposed):
    """Compute x <- x - B C^T W^T x before a solution of S^T x = b (transposed True) without the point's block.

    B: columns of forces on the point, W = S^-1 B, C: see `Point`. No-op for S x = b, which `after_solve` corrects.
    """
    if transposed:
        _subtract(lane, part.point, size(model.n), S, len(part.point.axes), 0, True, x)


@kernel
def after_solve(lane, part, model, S, x, transposed):
    """Compute x <- x - W C B^T x after a solution of S x = b without the point's block B k B^T (theory, (6.7)).

    W = S^-1 B, C = (1 + k B^T W)^-1 k. No-op for S^T x = b (transposed True), which `before_solve` corrects.
    """
    if not transposed:
        _subtract(lane, part.point, size(model.n), S, 0, len(part.point.axes), False, x)


@kernel
def multiply(lane, part, model, S: Lanes, x, y: Lanes):
    """Add the product B k B^T x of the point's block to y (n rows)."""
    point, n = part.point, size(model.n)
    for i in range(len(point.axes)):
        column = _column(lane, point, S, i)
        # k b_i^T x, N: the spring's answer along axis i (inertial) to the displacement x
        share = S[_stiffness_at(point)] * _dot(lane, n, column, x)
        for k in range(n):
            y[k] += column[k] * share


BLOCK = {
    "fix_coordinate": fix_coordinate, "before_factor": before_factor, "after_factor": after_factor,
    "before_solve": before_solve, "after_solve": after_solve, "multiply": multiply,
}  # fmt: skip
"""Kernels of a contribution whose record has a `point` and whose `assemble` calls `store_block`."""
