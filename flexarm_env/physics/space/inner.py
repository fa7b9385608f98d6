"""Inner modes of segments with floating frames in space: sums over modes, and their part of the Newton matrix.

A segment has `inner_of(model)` inner modes. Each mode has an amplitude (rad) about x, y and z of the frame. The rows of
these amplitudes follow the rows of the chain. Inner modes are eliminated within their segment before the Newton matrix
is condensed along the chain. A `FRAME` record contains tables of three numbers (for x, y, z) for each pair of
coordinates. Row i of a table is for inner mode i. The columns are for the left end, the right end, the frame (only in
`inner_rotary`) and the inner modes.
"""

from __future__ import annotations

from ...compiler import Lanes, kernel
from .layout import F, count_of, inner_of
from .rotations import Vector, dot, load_vector, scale, three_of

HELIX = 1.0 / 24.0
"""Rotation (rad) of the sections of a helix relative to its chord, divided by twist times bending angle (rad^2)."""


@kernel
def constant(lane, model, table, i):
    """Return entry i of a table of a `FRAME` record as a `Vector` for x, y, z; table: its offset in model.frames."""
    return three_of(lane, model.frames, table + 3 * i)


@kernel
def product(lane, model, table, a, b):
    """Return (ll a + lr b, lr a + rr b): the symmetric table (ll, lr, rr) of a `FRAME` times the ends' vectors a, b.

    ll, lr and rr are diagonal matrices (entries for x, y, z) for the pairs left-left, left-right and right-right of
    ends. The table begins at offset `table` of model.frames.
    """
    ll, lr, rr = constant(lane, model, table, 0), constant(lane, model, table, 1), constant(lane, model, table, 2)
    return scale(a, ll) + scale(b, lr), scale(a, lr) + scale(b, rr)


@kernel
def ends_by(lane, model, table, others, x, row, l, r):
    """Return the vectors l and r of the two ends plus the contributions of the inner amplitudes, by a table.

    table: offset in model.frames. For each inner mode the table has `others` columns, of which the first two are for
    the left and right end, then the columns of the inner modes.
    row: first row of the segment's inner amplitudes in x.
    """
    for i in range(inner_of(model)):
        own, at = load_vector(lane, x, row + 3 * i), (inner_of(model) + others) * i
        l = l + scale(own, constant(lane, model, table, at))
        r = r + scale(own, constant(lane, model, table, at + 1))
    return l, r


@kernel
def inner_by(lane, model, table, others, i, a, b, x, row):
    """Return the product of row i of a table with (a, b, inner amplitudes). a, b: vectors of the left and right end.

    table: offset in model.frames. The table has `others` columns, of which the first two are for the left and right
    end, then the columns of the inner modes.
    row: first row of the segment's inner amplitudes in x.
    """
    at = (inner_of(model) + others) * i
    total = scale(a, constant(lane, model, table, at)) + scale(b, constant(lane, model, table, at + 1))
    for j in range(inner_of(model)):
        total = total + scale(load_vector(lane, x, row + 3 * j), constant(lane, model, table, at + others + j))
    return total


@kernel
def elements_before(model, k):
    """Return the number of elements (or segments) on all links before link k."""
    total = 0
    for j in range(k):
        total += count_of(model, j)
    return total


@kernel
def factors(lane, n, S: Lanes, o):
    """Factor the n x n matrix at offset o of S in place into L (unit diagonal) and U (stored with reciprocal pivots).

    No rows are exchanged, because the mass dominates the diagonal.
    """
    for k in range(n):
        inverse = 1.0 / S[o + (n + 1) * k]
        S[o + (n + 1) * k] = inverse
        for i in range(k + 1, n):
            # L_ik = S_ik / U_kk; row i less L_ik row k
            factor = S[o + n * i + k] * inverse
            S[o + n * i + k] = factor
            for j in range(k + 1, n):
                S[o + n * i + j] -= factor * S[o + n * k + j]


@kernel
def solution(lane, n, S: Lanes, o, x: Lanes, i, stride):
    """Solve A y = x in place for the n entries x[i + stride k], k < n, with the factors of A at offset o of S."""
    # L y = x
    for k in range(1, n):
        total = x[i + stride * k]
        for j in range(k):
            total = total - S[o + n * k + j] * x[i + stride * j]
        x[i + stride * k] = total
    # U x = y
    for back_k in range(n):
        k = n - 1 - back_k
        total = x[i + stride * k]
        for j in range(k + 1, n):
            total = total - S[o + n * k + j] * x[i + stride * j]
        x[i + stride * k] = total * S[o + (n + 1) * k]


@kernel
def condense(lane, model, S: Lanes, f, inner):
    """Factor the matrix of a segment's inner modes and eliminate these modes from the `FACTOR` at offset f of S.

    In the segment's `INNER` record the field `over` becomes matrix^-1 over. Each block LL, LR, RL, RR of the `FACTOR`
    becomes block - ends^T over.
    inner: offsets of the fields `matrix`, `ends`, `over` of the `INNER` record (`inner_at`).
    """
    n, o = 3 * inner_of(model), inner.matrix
    factors(lane, n, S, o)
    # over = matrix^-1 (rows by the ends' 12 motions)
    for j in range(12):
        solution(lane, n, S, o, S, inner.over + j, 12)
    # Schur complement: rows and columns 0 to 5 are the left end's, 6 to 11 the right end's
    for a in range(12):
        for b in range(12):
            total = S[inner.ends + a] * S[inner.over + b]
            for k in range(1, n):
                total = total + S[inner.ends + 12 * k + a] * S[inner.over + 12 * k + b]
            S[f + F.LL + 72 * (a // 6) + 36 * (b // 6) + 6 * (a % 6) + b % 6] -= total


@kernel
def transposed_solution(lane, n, S: Lanes, o, x: Lanes, i):
    """Solve A^T y = x in place for n entries of x from index i on, with the factors of A at offset o of S."""
    # U^T y = x
    for k in range(n):
        total = x[i + k]
        for j in range(k):
            total = total - S[o + n * j + k] * x[i + j]
        x[i + k] = total * S[o + (n + 1) * k]
    # L^T x = y
    for back_k in range(n):
        k = n - 1 - back_k
        total = x[i + k]
        for j in range(k + 1, n):
            total = total - S[o + n * j + k] * x[i + j]
        x[i + k] = total


@kernel
def _subtract_from_ends(lane, model, S: Lanes, table, x: Lanes, row, right):
    """Subtract table^T y, with y the inner rows of x, from both ends' rows. table: offset in S of 12 columns per mode.

    row, right: first rows in x of the inner modes and of the right end. The left end's part is returned, to be added,
    as a force (inertial axes) and a moment (section axes).
    """
    n = 3 * inner_of(model)
    for j in range(6):
        for k in range(n):
            x[right + j] -= S[table + 12 * k + 6 + j] * x[row + k]
    zero = 0.0
    a, b = Vector(zero, zero, zero), Vector(zero, zero, zero)
    for k in range(n):
        own, at = x[row + k], table + 12 * k
        a, b = a - own * load_vector(lane, S, at), b - own * load_vector(lane, S, at + 3)
    return a, b


@kernel
def _subtract_from_modes(lane, model, S: Lanes, table, x: Lanes, row, left, right):
    """Subtract table (left, right) from the inner modes' rows of x; table and row as in `_subtract_from_ends`.

    left, right: motion of each end, a pair of position (inertial axes) and rotation (section axes).
    """
    for k in range(3 * inner_of(model)):
        for part, side in ((left, 0), (right, 6)):
            for j in range(3):
                x[row + k] -= S[table + 12 * k + side + j] * part[0][j]
                x[row + k] -= S[table + 12 * k + side + 3 + j] * part[1][j]


@kernel
def down(lane, model, S, inner, x, row, right):
    """Eliminate a segment's inner modes from x: inner rows <- matrix^-1 x, then subtract ends^T x from both ends' rows.

    inner: offsets of the segment's `INNER` record in S (`inner_at`).
    row, right: first rows in x of the inner modes and of the right end. The left end's part is not subtracted but
    returned, to be added, as a force (inertial axes) and a moment (section axes).
    """
    solution(lane, 3 * inner_of(model), S, inner.matrix, x, row, 1)
    return _subtract_from_ends(lane, model, S, inner.ends, x, row, right)


@kernel
def up(lane, model, S, inner, x, row, left, right):
    """Compute a segment's inner amplitudes by back substitution: inner rows of x <- x - over (left, right).

    inner: offsets of the segment's `INNER` record in S (`inner_at`), whose field `over` is read.
    row: first row of the inner modes in x.
    left, right: motion of each end, a pair of position (inertial axes) and rotation (section axes).
    """
    _subtract_from_modes(lane, model, S, inner.over, x, row, left, right)


@kernel
def up_transposed(lane, model, S, inner, x, row, right):
    """Apply the transpose of `up`: subtract over^T (inner rows of x) from both ends' rows; arguments as in `down`."""
    return _subtract_from_ends(lane, model, S, inner.over, x, row, right)


@kernel
def down_transposed(lane, model, S, inner, x, row, left, right):
    """Apply the transpose of `down`: inner rows of x <- matrix^-T (x - ends (left, right)); arguments as in `up`."""
    _subtract_from_modes(lane, model, S, inner.ends, x, row, left, right)
    transposed_solution(lane, 3 * inner_of(model), S, inner.matrix, x, row)


@kernel
def _entry(lane, n, S: Lanes, o, i, j):
    """Return entry (i, j) of the n x n matrix whose `factors` are at offset o of S: the product of L and U."""
    total = 0.0
    for k in range(min(i, j) + 1):
        upper = 1.0 / S[o + (n + 1) * k] if k == j else S[o + n * k + j]
        total = total + (upper if k == i else S[o + n * i + k] * upper)
    return total


@kernel
def multiplied(lane, model, S, inner, x: Lanes, y: Lanes, row, left, right):
    """Multiply the part of the matrix that `condense` eliminated by x and the ends' motions; add the inner rows to y.

    inner: offsets of the segment's `INNER` record in S (`inner_at`).
    x contains amplitudes, y forces. In both, the inner modes begin at row `row`.
    left, right: motion (position, rotation) of the ends. The function returns the (force, moment) on the left end and
    on the right end that the condensed blocks do not contain. See docs/theory.md, (9.3).
    """
    n, zero = 3 * inner_of(model), 0.0
    nothing = Vector(zero, zero, zero)
    a, b, c, d = nothing, nothing, nothing, nothing
    for k in range(n):
        over, at = inner.over + 12 * k, inner.ends + 12 * k
        # x + K_pp^-1 K_pe (motions of the ends): the factored K_pp acts on this sum
        moved = dot(load_vector(lane, S, over), left[0]) + dot(load_vector(lane, S, over + 3), left[1])
        moved = moved + dot(load_vector(lane, S, over + 6), right[0]) + dot(load_vector(lane, S, over + 9), right[1])
        moved = moved + x[row + k]
        a, b = a + moved * load_vector(lane, S, at), b + moved * load_vector(lane, S, at + 3)
        c, d = c + moved * load_vector(lane, S, at + 6), d + moved * load_vector(lane, S, at + 9)
        for i in range(n):
            y[row + i] += _entry(lane, n, S, inner.matrix, i, k) * moved
    return (a, b), (c, d)
