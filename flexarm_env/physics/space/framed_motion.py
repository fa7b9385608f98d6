"""Velocity-dependent part of a floating segment's Newton matrix in space, to first order of phi (theory, 9).

Angular velocities of sections are coordinates in the sections' own axes, velocities of positions in inertial axes. If a
coordinate changes at constant rates, these axes rotate relative to the frame. Strain rates and the second rates of the
ends' tangents therefore change by more than c_v times the strains. Blocks act on the rotations phi_l and phi_r of the
ends, in frame axes.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from ...compiler import kernel
from .element import rows_of
from .inner import HELIX, constant, product
from .layout import factors_of
from .rotations import Matrix, Vector, cross, outer, skew, skewed


@kernel
def _both_rows(lane, model, table, A, B):
    """Return (ll A + lr B, lr A + rr B) for 3 x 3 matrices A, B and diagonal matrices ll, lr, rr of a `FRAME` table.

    table: offset of the table in model.frames. For K the results are derivatives of the moments on both ends, where A
    and B are derivatives of the ends' rotations.
    """
    ll, lr, rr = constant(lane, model, table, 0), constant(lane, model, table, 1), constant(lane, model, table, 2)
    return rows_of(ll, A) + rows_of(lr, B), rows_of(lr, A) + rows_of(rr, B)


@kernel
def bent_rows(lane, model, par, a, b, near, far, at):
    """Return (dm_l, dm_r), the 3 x 3 derivatives of the moments on phi_l and phi_r by any three variables.

    near, far: derivatives (3 x 3) of the `_strained` rotations of the left and right end by these variables.
    a, b: rotations phi_l and phi_r of the ends (rad).
    at: offsets of the segment's `FRAME` record (`frame_at`). All vectors are in frame axes. The function multiplies
    near and far by the stiffness K, then by the transposed derivative of the `_strained` rotations by phi_l, phi_r.
    """
    d, factors = HELIX * (b - a), factors_of(lane, par)
    l, r = _both_rows(lane, model, at.K_EI, near, far)
    l, r = rows_of(factors, l), rows_of(factors, r)
    # transposed derivative of the terms phi_l x phi_r / 4 and d_x (d x e_x) / 24
    apart, both = 0.25 * (l - r), l + r
    more = Matrix(d[2] * both[1] - d[1] * both[2], -d[0] * both[2], d[0] * both[1])
    return l + skewed(b, apart) + more, r - skewed(a, apart) - more


class Late(NamedTuple):
    """Derivatives of damping forces by rotations at constant rates; they are added to the derivatives by rates.

    left, right, frame: derivatives (N m) of the pair (moment on phi_l, moment on phi_r) by the rotation of the left
    section, right section and frame
    e_l, e_r, e_b: derivatives (N) of the force along the chord by the rotation of the left section, right section and
    frame
    """

    left: Any
    right: Any
    frame: Any
    e_l: Any
    e_r: Any
    e_b: Any


@kernel
def late_of(lane, model, par, frame, rates, spins, stiff, late, at):
    """Return the `Late` of a segment, the derivatives of damping forces by rotations at constant rates.

    d phi' = (phi' / 2) x (dth + dbeta) - w x dth - X dbeta, X dbeta = w_x (0, dbeta_z, -dbeta_y), w_x: spin of the
    frame. The strain rates follow from phi and phi'.
    spins: angular velocities of both sections (rad/s, section axes).
    late: tau_d times a weight (s), see `framed_tangent.tangent`. stiff: forces (`Stiff`) of the segment. See
    docs/theory.md, (9.3).
    """
    x, y, spin = 0.25 * late * rates.left, 0.25 * late * rates.right, late * rates.spin
    # d phi' by the rotations of the left section, the right section, and the frame
    l, r, b = (x + (x - y) - late * spins[0], y + (y - x) - late * spins[1], x + y)
    zero = x[0] * 0.0
    X = Matrix(Vector(zero, zero, zero), Vector(zero, zero, spin[0]), Vector(zero, -spin[0], zero))
    by_b, a, c = skew(b) - X, frame.left.phi, frame.right.phi
    hl, hr, strong = stiff.slope_l, stiff.slope_r, model.frames[at.pull]
    # rate of the stretch by these rotations, then the chord's force with EA / l
    dl, dr = product(lane, model, at.coupling, 4.0 * x, 4.0 * y)
    both = hl + hr
    e_l = cross(hl, l) + cross(hr, y) + dl
    e_r = cross(hr, r) + cross(hl, x) + dr
    turn = frame.length * spin
    e_b = Vector(zero, turn[1], turn[2]) + cross(both, b) - (dl + dr)
    e_b = Vector(e_b[0], e_b[1] + both[2] * spin[0], e_b[2] - both[1] * spin[0])
    e_l, e_r, e_b = strong * e_l, strong * e_r, strong * e_b
    # K d(phi_bar'), by the left, the right section and the frame (frame axes)
    on_l = bent_rows(lane, model, par, a, c, skew(l), skew(y), at)
    on_r = bent_rows(lane, model, par, a, c, skew(x), skew(r), at)
    on_b = bent_rows(lane, model, par, a, c, by_b, by_b, at)
    return Late(
        (on_l[0] + outer(hl, e_l), on_l[1] + outer(hr, e_l)),
        (on_r[0] + outer(hl, e_r), on_r[1] + outer(hr, e_r)),
        (on_b[0] + outer(hl, e_b), on_b[1] + outer(hr, e_b)),
        e_l,
        e_r,
        e_b,
    )  # fmt: skip


@kernel
def late_pull(frame, late):
    """Return derivatives of the chord's damping force by both sections' rotations (N) and by lateral positions (N/m).

    The derivative by positions is a pair, by the right end's y and z position in frame axes. The frame rotates with the
    ends' positions (beta_y, beta_z) and rolls with the sections (g).
    late: `Late` of the segment; the results are 0 if it is None.
    """
    if late is None:
        zero = frame.length * 0.0
        return Vector(zero, zero, zero), Vector(zero, zero, zero), (zero, zero)
    roll, (x, y, z), share = late.e_b[0], late.e_b, frame.over
    across_chord = z * share, (y + x * frame.k) * -share
    return late.e_l + roll * frame.left.g, late.e_r + roll * frame.right.g, across_chord


@kernel
def swung(w, own, cd):
    """Return the derivative of a section's t'' by its rotation that its rates cause, times cd: rows y, z, section axes.

    t'': second time derivative of the section's tangent.
    w: angular velocity of the section (rad/s, section axes).
    own: joint's rate (rad/s), field `own` of the section's `Vertex`.
    cd: weight of dr/dv in the Newton matrix (1/s). Each row is a `Vector`, with one entry for each component of the
    rotation.
    """
    x, zero = (w[0] - own[0]) * cd, w[0] * 0.0
    return Vector((w[1] + own[1]) * cd, x, zero), Vector((w[2] + own[2]) * cd, zero, x)


@kernel
def with_swung(rows, h, turned):
    """Return `rows`, to which h_y and h_z times the rows `turned` are added.

    rows: two `Vector`s, the derivatives of the y and z components (frame axes) of an end's force by a section's
    rotation.
    h: first moments (kg m) of the mass that moves with the section's tangent.
    turned: result of `swung`, two `Vector`s: cd times the derivative of t'' (second time derivative of the section's
    tangent) by the section's rotation, components y and z in section axes.
    """
    return rows[0] + h[1] * turned[0], rows[1] + h[2] * turned[1]


@kernel
def plus_lifted(A, h, turned):
    """Return A plus the moments that the rows `turned` cause: -h_y turned_z in row y, +h_z turned_y in row z.

    A: derivative of the moment on a section by a section's rotation, 3 x 3 (N m).
    turned: result of `swung`.
    h: second moments of the mass about x, y, z (kg m^2, `FRAME.lateral`).
    """
    return Matrix(A[0], A[1] - h[1] * turned[1], A[2] + h[2] * turned[0])
