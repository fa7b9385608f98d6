"""Common part of contributions that exert forces on a point of the arm, such as a spring; forces depend on position.

The point is a point load of the arm (`AtPoint.place`). Every formulation therefore computes the point's displacement y,
the generalized forces B f of a force f on the point, and the change of B with q. A stiffness k of the point adds the
block B k B^T to the Newton matrix. The block B k B^T is applied as a correction of solutions (`physics.point_block`).

A contribution registers `BLOCK`, its `point_forces` and `energy`, and an `assemble` that calls `store_block`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

from ...compiler import Lanes, kernel, size
from ...parameters import Arm
from .. import protocol
from ..point_block import column, divide, product, store_columns, store_solutions, subtract


class Point(NamedTuple):
    """A point of the arm on which a contribution acts, stored in the field `point` of the contribution's record.

    S contains these arrays from offset `at` on: B and W, one column of n numbers per axis; C (axes x axes), scratch
    memory of the size of C, and k.
    """

    input: int  # index of its first entry in the arm's inputs (N) and input displacements (m, inertial axes)
    at: int  # offset of the point's entries in S
    axes: tuple[int, ...]  # one zero per component of the force: 2, in space 3
    room: tuple[int, ...]  # one zero per row of the Model: size of stack arrays


@dataclass(frozen=True)
class AtPoint:
    """A kind of point force, such as a spring. An arm has the point force if one of `fields` differs from its default.

    fields: names of fields of `Arm`.
    place: function that returns (link, end) of the point for an arm.
    make: function that returns the contribution's record.
    """

    fields: tuple[str, ...]
    place: Callable[[Arm], tuple[int, str]]
    make: Callable[[Arm, Point], Any]


KINDS: list[AtPoint] = []
"""Registered kinds of point forces. A module that defines a kind appends it to this list."""


def numbers_in_matrix(rows: int, axes: int) -> int:
    """Return the number of entries of a `Point` in S. rows: number of rows of the Model; axes: force components."""
    return 2 * rows * axes + 2 * axes * axes + 1


@kernel
def point_displacement(lane, point, model, par, q, y):
    """Write the arm's input displacements to y; the point's displacement (m, inertial axes) begins at `point.input`.

    point: the point (`Point`) of the arm. q: coordinates of the arm. y: array with one entry per input of the arm.
    """
    protocol.input_displacements(lane, model.arm, par, q, y)


@kernel
def _solutions_at(point):
    """Return the offset in S of the array W of a point (see `Point`)."""
    return point.at + len(point.axes) * size(point.room)


@kernel
def _inverse_at(point):
    """Return the offset in S of C = (1 + k B^T W)^-1 k (axes x axes, by rows); equally large scratch and k follow."""
    return point.at + 2 * len(point.axes) * size(point.room)


@kernel
def _stiffness_at(point):
    """Return the offset in S of k, the weighted stiffness (N/m) of the point."""
    return _inverse_at(point) + 2 * len(point.axes) * len(point.axes)


@kernel
def store_block(lane, point, model, par, state, u: Lanes, stiffness, S: Lanes):
    """Store B and k of the point's block B k B^T. A contribution's `assemble` calls this function if it needs a matrix.

    stiffness: k (N/m) times the weight of dr/dq in the matrix. Column i of B contains the generalized forces of a force
    of 1 N on the point along axis i, i.e. the amounts by which this force lowers the arm's residual. See
    docs/theory.md, (6.7).
    """
    store_columns(lane, model, par, state, u, point.input, point.axes, point.room, S, point.at)
    S[_stiffness_at(point)] = 0.0 + stiffness


@kernel
def fix_coordinate(lane, part, model, S, k):
    """Set row k of B to 0, because a fixed or prescribed coordinate does not move the point."""
    for i in range(len(part.point.axes)):
        column(lane, part.point.at, part.point.room, S, i)[k] = 0.0


@kernel
def before_factor(lane, part, model, S: Lanes):
    """Set W and C (see `Point`) to 0, so that `solve` omits the block B k B^T until `after_factor` has run."""
    point, axes = part.point, len(part.point.axes)
    for i in range(axes):
        for k in range(size(point.room)):
            column(lane, _solutions_at(point), point.room, S, i)[k] = 0.0
        for j in range(axes):
            S[_inverse_at(point) + axes * i + j] = 0.0


@kernel
def after_factor(lane, part, model, S: Lanes):
    """Compute W = S^-1 B and C = (1 + k B^T W)^-1 k from B and k in S, by Gauss-Jordan elimination without pivoting.

    With W and C `after_solve` adds the block B k B^T of the point's stiffness k to solutions with the factors in S. See
    docs/theory.md, (6.7).
    """
    point, axes, n = part.point, len(part.point.axes), size(part.point.room)
    # with factors that do not contain the block yet, because C is still 0
    w = _solutions_at(point)
    store_solutions(lane, model, point.axes, point.room, S, point.at, w)
    # scratch <- 1 + k B^T W, C <- k
    c, stiffness = _inverse_at(point), S[_stiffness_at(point)]
    a = c + axes * axes
    for i in range(axes):
        for j in range(axes):
            own = 1.0 if i == j else 0.0
            moved = product(lane, n, column(lane, point.at, point.room, S, i), column(lane, w, point.room, S, j))
            S[a + axes * i + j] = own + stiffness * moved
            S[c + axes * i + j] = own * stiffness
    divide(lane, point.axes, S, a, c)


@kernel
def _subtract(lane, point, S: Lanes, transposed, x):
    """Compute x <- x - W C B^T x; if transposed, compute x <- x - B C^T W^T x."""
    b, w, c = point.at, _solutions_at(point), _inverse_at(point)
    if transposed:
        subtract(lane, point.axes, point.room, S, w, b, c, True, x)
    else:
        subtract(lane, point.axes, point.room, S, b, w, c, False, x)


@kernel
def before_solve(lane, part, model, S, x, transposed):
    """If transposed, compute x <- x - B C^T W^T x before the solution of S^T x = b without the point's block.

    B, W, C: arrays of the `Point`. If not transposed, do nothing; `after_solve` then corrects the solution.
    """
    if transposed:
        _subtract(lane, part.point, S, True, x)


@kernel
def after_solve(lane, part, model, S, x, transposed):
    """Compute x <- x - W C B^T x after a solution of S x = b without the point's block B k B^T (theory, (6.7)).

    W = S^-1 B, C = (1 + k B^T W)^-1 k. If transposed, do nothing; `before_solve` has then corrected the right side.
    """
    if not transposed:
        _subtract(lane, part.point, S, False, x)


@kernel
def multiply(lane, part, model, S: Lanes, x, y: Lanes):
    """Add the product B k B^T x of the point's block to y (n rows)."""
    point, n = part.point, size(part.point.room)
    for i in range(len(point.axes)):
        own = column(lane, point.at, point.room, S, i)
        # k b_i^T x, N: the spring's answer along axis i (inertial) to the displacement x
        share = S[_stiffness_at(point)] * product(lane, n, own, x)
        for k in range(n):
            y[k] += own[k] * share


BLOCK = {
    "fix_coordinate": fix_coordinate, "before_factor": before_factor, "after_factor": after_factor,
    "before_solve": before_solve, "after_solve": after_solve, "multiply": multiply,
}  # fmt: skip
"""Kernels for a contribution whose record has a field `point` and whose `assemble` calls `store_block`."""
