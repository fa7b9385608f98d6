"""Inner modes of segments with floating frames in space: sums over them, and their part of the matrix.

A segment has `inner_of` of them, each with an amplitude about x, y and z in rows of its own behind those of the chain.
Newton's matrix eliminates them within their segment before it goes along the chain.
"""

from __future__ import annotations

from ...compiler import kernel, load, splat, store
from ..arithmetic import add, vector
from .chain import three_of
from .element import scale
from .layout import F, count_of, inner_of
from .rotations import dot, minus, plus, times

HELIX = 1.0 / 24.0
"""Of twist times bending, rad: by what the sections of a helix are turned against its chord."""


@kernel
def constant(lane, model, table, i):
    """Three numbers of a `FRAME`: entry i of a table of such."""
    return three_of(lane, model.frames, table + 3 * i)


@kernel
def product(lane, model, table, a, b):
    """The matrix of three vectors (ll, lr, rr) on (a, b)."""
    ll, lr, rr = constant(lane, model, table, 0), constant(lane, model, table, 1), constant(lane, model, table, 2)
    return plus(scale(a, ll), scale(b, lr)), plus(scale(a, lr), scale(b, rr))


@kernel
def ends_by(lane, model, table, others, x, row, l, r):
    """l, r of the ends with what the inner modes x make there by a table with `others` columns before their own."""
    for i in range(inner_of(model)):
        own, at = vector(lane, x, row + 3 * i), (inner_of(model) + others) * i
        l = plus(l, scale(own, constant(lane, model, table, at)))
        r = plus(r, scale(own, constant(lane, model, table, at + 1)))
    return l, r


@kernel
def inner_by(lane, model, table, others, i, a, b, x, row):
    """What (a, b) of the ends and the inner modes x make by such a table on mode i."""
    at = (inner_of(model) + others) * i
    total = plus(scale(a, constant(lane, model, table, at)), scale(b, constant(lane, model, table, at + 1)))
    for j in range(inner_of(model)):
        total = plus(total, scale(vector(lane, x, row + 3 * j), constant(lane, model, table, at + others + j)))
    return total


@kernel
def elements_before(model, k):
    """Elements of the links before k."""
    total = 0
    for j in range(k):
        total += count_of(model, j)
    return total


@kernel
def factors(lane, n, S, o):
    """The n x n matrix at o of S <- its L and U, pivots inverted; no rows exchanged: mass outweighs the rest."""
    for k in range(n):
        inverse = 1.0 / load(lane, S, o + (n + 1) * k)
        store(S, o + (n + 1) * k, inverse)
        for i in range(k + 1, n):
            factor = load(lane, S, o + n * i + k) * inverse
            store(S, o + n * i + k, factor)
            for j in range(k + 1, n):
                add(lane, S, o + n * i + j, -(factor * load(lane, S, o + n * k + j)))


@kernel
def solution(lane, n, S, o, x, i, stride):
    """n elements of x from i on, `stride` apart, by the factors at o."""
    for k in range(1, n):
        total = load(lane, x, i + stride * k)
        for j in range(k):
            total = total - load(lane, S, o + n * k + j) * load(lane, x, i + stride * j)
        store(x, i + stride * k, total)
    for back_k in range(n):
        k = n - 1 - back_k
        total = load(lane, x, i + stride * k)
        for j in range(k + 1, n):
            total = total - load(lane, S, o + n * k + j) * load(lane, x, i + stride * j)
        store(x, i + stride * k, total * load(lane, S, o + (n + 1) * k))


@kernel
def condense(lane, model, S, f, inner):
    """Factor the `INNER` of S and take it out of the `FACTOR` at f; `over` is what it has of the ends."""
    n, o = 3 * inner_of(model), inner.matrix
    factors(lane, n, S, o)
    for j in range(12):
        solution(lane, n, S, o, S, inner.over + j, 12)
    for a in range(12):
        for b in range(12):
            total = load(lane, S, inner.ends + a) * load(lane, S, inner.over + b)
            for k in range(1, n):
                total = total + load(lane, S, inner.ends + 12 * k + a) * load(lane, S, inner.over + 12 * k + b)
            add(lane, S, f + F.LL + 72 * (a // 6) + 36 * (b // 6) + 6 * (a % 6) + b % 6, -total)


@kernel
def down(lane, model, S, inner, x, row, right):
    """Forward elimination of a segment's inner modes: off x of its right end; the same of its left end is returned."""
    n = 3 * inner_of(model)
    solution(lane, n, S, inner.matrix, x, row, 1)
    for j in range(6):
        for k in range(n):
            add(lane, x, right + j, -(load(lane, S, inner.ends + 12 * k + 6 + j) * load(lane, x, row + k)))
    zero = splat(lane, 0.0)
    a, b = (zero, zero, zero), (zero, zero, zero)
    for k in range(n):
        own, at = load(lane, x, row + k), inner.ends + 12 * k
        a, b = minus(a, times(vector(lane, S, at), own)), minus(b, times(vector(lane, S, at + 3), own))
    return a, b


@kernel
def up(lane, model, S, inner, x, row, left, right):
    """Back substitution of a segment's inner modes; left, right: (place, rotation) that its ends move by."""
    for k in range(3 * inner_of(model)):
        for part, side in ((left, 0), (right, 6)):
            for j in range(3):
                add(lane, x, row + k, -(load(lane, S, inner.over + 12 * k + side + j) * part[0][j]))
                add(lane, x, row + k, -(load(lane, S, inner.over + 12 * k + side + 3 + j) * part[1][j]))


@kernel
def _entry(lane, n, S, o, i, j):
    """That of the matrix whose `factors` are at o."""
    total = splat(lane, 0.0)
    for k in range(min(i, j) + 1):
        upper = 1.0 / load(lane, S, o + (n + 1) * k) if k == j else load(lane, S, o + n * k + j)
        total = total + (upper if k == i else load(lane, S, o + n * i + k) * upper)
    return total


@kernel
def multiplied(lane, model, S, inner, x, y, row, left, right):
    """What `condense` has taken out, times x and what the ends move by, (place, rotation) each: to y that of the inner
    modes; ((force, moment) on the left end, on the right)."""
    n, zero = 3 * inner_of(model), splat(lane, 0.0)
    nothing = zero, zero, zero
    a, b, c, d = nothing, nothing, nothing, nothing
    for k in range(n):
        over, at = inner.over + 12 * k, inner.ends + 12 * k
        moved = dot(vector(lane, S, over), left[0]) + dot(vector(lane, S, over + 3), left[1])
        moved = moved + dot(vector(lane, S, over + 6), right[0]) + dot(vector(lane, S, over + 9), right[1])
        moved = moved + load(lane, x, row + k)
        a, b = plus(a, times(vector(lane, S, at), moved)), plus(b, times(vector(lane, S, at + 3), moved))
        c, d = plus(c, times(vector(lane, S, at + 6), moved)), plus(d, times(vector(lane, S, at + 9), moved))
        for i in range(n):
            add(lane, y, row + i, _entry(lane, n, S, inner.matrix, i, k) * moved)
    return (a, b), (c, d)
