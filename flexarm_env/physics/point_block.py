"""Solutions of a linear system whose matrix contains a block B K B^T from forces on a point (theory, (6.7)).

    (S + B K B^T)^-1 b = x - W C B^T x,   x = S^-1 b,   W = S^-1 B,   C = (1 + K B^T W)^-1 K

B has one column for each component of the force. All arrays are in the matrix array S; the arguments B, W, C, A are
offsets in S. axes: one zero for each component of the force. room: one zero for each row of the Model, which is also a
row of B and W.
"""

from __future__ import annotations

from ..compiler import Lanes, kernel, size, stack
from . import protocol


@kernel
def column(lane, at, room, S: Lanes, i):
    """Return column i of B or W as a view of n entries of S. at: offset of the matrix's first column in S."""
    n = size(room)
    return S[at + i * n : at + (i + 1) * n]


@kernel
def product(lane, n, x: Lanes, y: Lanes):
    """Return the scalar product of the vectors x and y, each of n rows."""
    total = 0.0
    for k in range(n):
        total = total + x[k] * y[k]
    return total


@kernel
def store_columns(lane, model, par, state, u: Lanes, first, axes, room, S: Lanes, B):
    """Store B in S: column i is the amount by which a unit of force component i lowers the arm's residual.

    u: inputs, i.e. joint torques (N m), then point loads.
    first: index of the point's first entry in u. The residual is linear in the inputs, so that its difference between u
    and u + e_i is exact.
    """
    n, rows = size(model.arm.n), size(room)
    inputs, still, moved = stack(lane, model.points), stack(lane, room), stack(lane, room)
    for k in range(size(model.n_inputs)):
        inputs[k] = u[k]
    protocol.residual(lane, model.arm, par, state, inputs, still, S)
    for i in range(len(axes)):
        force = inputs[first + i]
        inputs[first + i] = force + 1.0
        protocol.residual(lane, model.arm, par, state, inputs, moved, S)
        inputs[first + i] = force
        own = column(lane, B, room, S, i)
        for k in range(rows):
            own[k] = 0.0
        for k in range(n):
            own[k] = still[k] - moved[k]


@kernel
def store_solutions(lane, model, axes, room, S: Lanes, B, W):
    """Store W = S^-1 B, with the factors in S and the blocks that `protocol.solve` currently includes."""
    for i in range(len(axes)):
        x, source, target = stack(lane, room), column(lane, B, room, S, i), column(lane, W, room, S, i)
        for k in range(size(room)):
            x[k] = source[k]
        protocol.solve(lane, model, S, x)
        for k in range(size(room)):
            target[k] = x[k]


@kernel
def divide(lane, axes, S: Lanes, A, C):
    """Compute C <- A^-1 C by Gauss-Jordan elimination; both matrices are stored row by row, and A is overwritten.

    Rows are not exchanged: A = 1 + K B^T W has eigenvalues of at least 1 if S is positive definite and K is symmetric.
    """
    n = len(axes)
    for i in range(n):
        inverse = 1.0 / S[A + n * i + i]
        for j in range(n):
            S[A + n * i + j] *= inverse
            S[C + n * i + j] *= inverse
        for m in range(n):
            if m != i:
                share = S[A + n * m + i]
                for j in range(n):
                    S[A + n * m + j] -= share * S[A + n * i + j]
                    S[C + n * m + j] -= share * S[C + n * i + j]


@kernel
def subtract(lane, axes, room, S: Lanes, along, target, C, transposed, x: Lanes):
    """Compute x <- x - target C (along^T x), with C^T if transposed. along, target: offsets of the matrices B and W."""
    n, rows = len(axes), size(room)
    parts = stack(lane, axes)
    for j in range(n):
        # along^T x before x changes, because all columns of C need it
        parts[j] = product(lane, rows, column(lane, along, room, S, j), x)
    for i in range(n):
        share = 0.0
        for j in range(n):
            share = share + S[C + (n * j + i if transposed else n * i + j)] * parts[j]
        own = column(lane, target, room, S, i)
        for k in range(rows):
            x[k] -= own[k] * share
