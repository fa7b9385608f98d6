"""What the motion has of Newton's matrix of a segment with a floating frame in space, to first order of phi.

Sections keep their rates in axes of their own, which turn with them, and places keep theirs in inertial ones: with
positions, rates of strains change by more than with rates, and so do second rates of the tangents that inertia has.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from ...compiler import kernel
from .chain import factors_of
from .element import rows_of
from .inner import HELIX, constant, product
from .rotations import cross, difference, minus, outer, plus, scaled, skew, skewed, sum_of, times


@kernel
def _both_rows(lane, model, table, A, B):
    """`inner.product` of matrices."""
    ll, lr, rr = constant(lane, model, table, 0), constant(lane, model, table, 1), constant(lane, model, table, 2)
    return sum_of(rows_of(ll, A), rows_of(lr, B)), sum_of(rows_of(lr, A), rows_of(rr, B))


@kernel
def bent_rows(lane, model, par, a, b, near, far, at):
    """Rows of the moments on phi_l, phi_r of K by what the `framed._strained` of a, b changes by, near and far."""
    d, factors = times(minus(b, a), HELIX), factors_of(lane, par)
    l, r = _both_rows(lane, model, at.bend, near, far)
    l, r = rows_of(factors, l), rows_of(factors, r)
    apart, both = scaled(difference(l, r), 0.25), sum_of(l, r)
    more = minus(times(both[1], d[2]), times(both[2], d[1])), times(both[2], -d[0]), times(both[1], d[0])
    return sum_of(sum_of(l, skewed(b, apart)), more), difference(difference(r, skewed(a, apart)), more)


class Late(NamedTuple):
    """What damps rates of strains that change with positions, beside what they change by with rates."""

    left: Any  # moments on phi_l, phi_r by the left section's rotation
    right: Any
    frame: Any
    e_l: Any  # the force along the chord likewise
    e_r: Any
    e_b: Any


@kernel
def late_of(lane, model, par, frame, rates, spins, stiff, late, at):
    """`Late`: d phi' has (phi' / 2) x (dth + dbeta) - w x dth - X dbeta, X dbeta = w_x (0, dbeta_z, -dbeta_y) of the
    frame's spin, and what `framed._strained_rate` makes of that. late: tau_d times the weight of positions."""
    x, y, spin = times(rates.left, 0.25 * late), times(rates.right, 0.25 * late), times(rates.spin, late)
    l, r, b = (
        minus(plus(x, minus(x, y)), times(spins[0], late)),
        minus(plus(y, minus(y, x)), times(spins[1], late)),
        plus(x, y),
    )
    zero = x[0] * 0.0
    X = (zero, zero, zero), (zero, zero, spin[0]), (zero, -spin[0], zero)
    by_b, a, c = difference(skew(b), X), frame.left.phi, frame.right.phi
    hl, hr, strong = stiff.slope_l, stiff.slope_r, model.frames[at.pull]
    dl, dr = product(lane, model, at.coupling, times(x, 4.0), times(y, 4.0))
    both = plus(hl, hr)
    e_l = plus(plus(cross(hl, l), cross(hr, y)), dl)
    e_r = plus(plus(cross(hr, r), cross(hl, x)), dr)
    turn = times(spin, frame.length)
    e_b = minus(plus((zero, turn[1], turn[2]), cross(both, b)), plus(dl, dr))
    e_b = e_b[0], e_b[1] + both[2] * spin[0], e_b[2] - both[1] * spin[0]
    e_l, e_r, e_b = times(e_l, strong), times(e_r, strong), times(e_b, strong)
    on_l = bent_rows(lane, model, par, a, c, skew(l), skew(y), at)
    on_r = bent_rows(lane, model, par, a, c, skew(x), skew(r), at)
    on_b = bent_rows(lane, model, par, a, c, by_b, by_b, at)
    return Late(
        (sum_of(on_l[0], outer(hl, e_l)), sum_of(on_l[1], outer(hr, e_l))),
        (sum_of(on_r[0], outer(hl, e_r)), sum_of(on_r[1], outer(hr, e_r))),
        (sum_of(on_b[0], outer(hl, e_b)), sum_of(on_b[1], outer(hr, e_b))),
        e_l, e_r, e_b,
    )  # fmt: skip


@kernel
def late_pull(frame, late):
    """What the force along the chord has of `Late`: by both sections' rotations, and by the right place across it."""
    if late is None:
        zero = frame.length * 0.0
        return (zero, zero, zero), (zero, zero, zero), (zero, zero)
    roll, (x, y, z), share = late.e_b[0], late.e_b, frame.over
    across_chord = z * share, (y + x * frame.k) * -share
    return plus(late.e_l, times(frame.left.g, roll)), plus(late.e_r, times(frame.right.g, roll)), across_chord


@kernel
def swung(w, own, cd):
    """Rows y and z of the second rate of a section's tangent by its rotation, of what rates make: see
    `element.Tangent`."""
    x, zero = (w[0] - own[0]) * cd, w[0] * 0.0
    return ((w[1] + own[1]) * cd, x, zero), ((w[2] + own[2]) * cd, zero, x)


@kernel
def with_swung(rows, h, turned):
    """A pair of rows, and `swung` times h along y and z."""
    return plus(rows[0], times(turned[0], h[1])), plus(rows[1], times(turned[1], h[2]))


@kernel
def plus_lifted(A, h, turned):
    """A, and moments of forces across: `swung` times h about z and y."""
    return A[0], minus(A[1], times(turned[1], h[1])), plus(A[2], times(turned[0], h[2]))
