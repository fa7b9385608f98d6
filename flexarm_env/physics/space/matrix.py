"""The Newton matrix of a chain in space: 6 x 6 blocks of vertices eliminated from tip to base, joints between them.

The section before a joint moves by d = (position, rotation), the joint's angle by b. The link's first section moves by:

    position += X d_rotation + c b,   rotation = E^T d_rotation + axis b,     X = -A s^,  c = A E (axis x o)

A: axes of the preceding section to inertial axes. E: axes of the link's root to axes of the preceding section. s: lever
from the preceding section to the link's first section. o: the part of s beyond the joint. Without levers X = c = 0.
Block rows: force along inertial axes, moment in section axes. Block columns: position in inertial axes, rotation in
body axes.
"""

from __future__ import annotations

from ...compiler import Lanes, kernel, load_lane, traced
from ..arithmetic import store_vector
from ..layout import ROTOR
from ..model import TAU_D
from .chain import fill_zeros, has_lever
from .element import add_block
from .layout import AXES, B, F, H, J, before, factor_at, hinge_at, joint_row
from .rotations import Matrix, cross, dot, load_vector, skew, store_matrix, three_of


@kernel
def matrix_in(lane, S, o):
    """Return the nine entries of S from entry o on, stored row by row, as a 3 x 3 `Matrix`."""
    return Matrix(load_vector(lane, S, o), load_vector(lane, S, o + 3), load_vector(lane, S, o + 6))


@kernel
def _joint_of(model, row):
    """Return the index of the joint whose angle is in row `row`."""
    k = 0
    while joint_row(model, k) < row:
        k += 1
    return k


@kernel
def add_stiffness(lane, model, S: Lanes, k, x):
    """Add x (N m/rad) to the stiffness of the joint angle in row k of q, which `factor` adds to that row's diagonal.

    If x is None, row k (one of the base's six rows or a joint's row) is fixed: `factor` and `solve` then replace the
    row by that of the identity matrix.
    """
    if x is None:
        one = 1.0
        if k < AXES:
            S[B.pinned + k] = one
        else:
            S[hinge_at(_joint_of(model, k)) + H.pinned] = one
    else:
        S[hinge_at(_joint_of(model, k)) + H.own] += x


def _factors(lane, A: Lanes):
    """Replace a 6 x 6 matrix by its factors L (unit diagonal) and U (reciprocal pivots), without pivoting."""
    a = [[A[6 * i + j] for j in range(6)] for i in range(6)]
    for k in range(6):
        a[k][k] = 1.0 / a[k][k]
        for i in range(k + 1, 6):
            a[i][k] = a[i][k] * a[k][k]
            for j in range(k + 1, 6):
                a[i][j] = a[i][j] - a[i][k] * a[k][j]
    for i in range(6):
        for j in range(6):
            A[6 * i + j] = a[i][j]


def _solution(lane, A: Lanes, x):
    """Return the solution of A x = b; on entry the list x contains b, and A contains the factors from `_factors`."""
    # L y = b, then U x = y
    for k in range(6):
        for j in range(k):
            x[k] = x[k] - A[6 * k + j] * x[j]
    for k in range(5, -1, -1):
        for j in range(k + 1, 6):
            x[k] = x[k] - A[6 * k + j] * x[j]
        x[k] = x[k] * A[7 * k]
    return x


@traced
def solve_six_transposed(lane, A: Lanes, x: Lanes):
    """Solve A^T y = x in place for six entries of x; A (36 entries) contains the LU factors of the matrix."""
    y = [x[k] for k in range(6)]
    # U^T, then L^T
    for k in range(6):
        for j in range(k):
            y[k] = y[k] - A[6 * j + k] * y[j]
        y[k] = y[k] * A[7 * k]
    for k in range(5, -1, -1):
        for j in range(k + 1, 6):
            y[k] = y[k] - A[6 * j + k] * y[j]
    for k, value in enumerate(y):
        x[k] = value


@traced
def _factor_six(lane, A):
    """Replace the 6 x 6 matrix A by its LU factors (`_factors`)."""
    _factors(lane, A)


@traced
def solve_six(lane, A, x: Lanes):
    """Solve A y = x in place for six entries of x; A (36 entries) contains the LU factors of the matrix."""
    for k, value in enumerate(_solution(lane, A, [x[k] for k in range(6)])):
        x[k] = value


@traced
def eliminate(lane, LL: Lanes, LR: Lanes, RL: Lanes, RR):
    """Eliminate an element's right vertex: factor RR in place, then RL <- RR^-1 RL, LL <- LL - LR RR^-1 RL.

    LL, LR, RL, RR: the element's 6 x 6 blocks, 36 entries each; the first letter names the rows, the second the columns
    (left or right vertex).
    """
    _factors(lane, RR)
    for j in range(6):
        # RR^-1 RL by columns, then the Schur complement LL - LR RR^-1 RL
        column = _solution(lane, RR, [RL[6 * i + j] for i in range(6)])
        for i in range(6):
            RL[6 * i + j] = column[i]
            total = LL[6 * i + j]
            for m in range(6):
                total = total - LR[6 * i + m] * column[m]
            LL[6 * i + j] = total


@kernel
def part_of(lane, S: Lanes, o, n):
    """Return the n entries of the array S from entry o on, as a slice."""
    return S[o : o + n]


@kernel
def _block(lane, S, o, i, j):
    """Return the 3 x 3 block (i, j), i, j = 0, 1, of the 6 x 6 matrix at offset o of S."""
    k = o + 18 * i + 3 * j
    return Matrix(load_vector(lane, S, k), load_vector(lane, S, k + 6), load_vector(lane, S, k + 12))


@kernel
def _base_is_held(lane, S):
    """Return whether all six coordinates of the base are fixed, the same in all lanes (`BASE.pinned` in S)."""
    held = True
    for i in range(6):
        if S[(B.pinned + i) * len(lane)] == 0.0:
            held = False
    return held


@kernel
def eliminate_joint(lane, model, S: Lanes, k):
    """Condense the root block of link k onto the preceding section, eliminate the joint's angle, and fill its `HINGE`.

    The rotation d of the preceding section and the joint's angle b move the link's root: position += X d + c b
    (inertial axes), rotation = E^T d + axis b (root axes). A force f and a moment m on the root are transmitted as the
    moment E m + X^T f on the preceding section, and as axis . m + c . f in the joint's row. E, X, c are the fields
    `turn`, `shift`, `swing` of the `HINGE`. The `HINGE` also receives three results: the pivot, `column` (the wrench on
    the preceding section per joint angle) and `row` (the joint's moment per motion of the preceding section, divided by
    the pivot). The preceding section's 6 x 6 block receives the transformed root block minus column row^T. The
    geometric part of the wrench on the root is included. See docs/theory.md, (9.1).
    """
    h, o, below = hinge_at(k), factor_at(model, k, 0) + F.LL, before(model, k)
    axis, turn = three_of(lane, model.joints, J.end * k + J.axis), matrix_in(lane, S, h + H.turn)
    to_root, way = turn.T, joint_motion_of_root(lane, model, S, k, axis)
    xx, xt, tx, tt = (
        _block(lane, S, o, 0, 0),
        _block(lane, S, o, 0, 1),
        _block(lane, S, o, 1, 0),
        _block(lane, S, o, 1, 1),
    )
    # column: the root moves by `way`, which includes the damping lag; E turns the moment with the angle
    moment = cross(axis, load_vector(lane, S, h + H.moment))
    on_root = tt @ way
    force, on_section = xt @ way, turn @ (on_root + moment)
    # row: virtual work axis . m of the angle, without the lag
    by_place, by_turn = tx.T @ axis, turn @ (tt.T @ axis)
    pivot = dot(axis, on_root) + S[h + H.own]
    if has_lever(model, k):
        frame, lever, pull = (
            matrix_in(lane, S, h + H.frame),
            load_vector(lane, S, h + H.lever),
            load_vector(lane, S, h + H.force),
        )
        # levers: the root's place also follows c b (inertial axes); c in the section's axes is swing
        swing = swing_of(lane, model, k, axis, turn)
        c = frame @ swing
        drift = c
        if model.strains is None:
            drift = frame @ (turn @ joint_motion_of_root(lane, model, S, k, turn.T @ swing))
        store_matrix(lane, S, h + H.shift, -(frame @ skew(lever)))
        store_vector(lane, S, h + H.swing, c)
        store_vector(lane, S, h + H.drift, drift)
        pivot = pivot + dot(axis, tx @ drift) + dot(c, force) + dot(c, xx @ drift)
        pivot = pivot + dot(swing, cross(pull, turn @ axis))
    # a fixed angle: no column, pivot 1, so that its increment is its right side 0
    free = load_lane(lane, S, h + H.pinned, 0) == 0.0
    if k == 0:
        if _base_is_held(lane, S):
            # the base does not move: no block to condense onto
            fill_zeros(lane, S, h + H.column, 12)
            S[h + H.pivot] = 1.0 / pivot if free else 1.0
            return
    # block of the section before: (dr, dtheta) of the root are (1, E^T) times its own
    upper, lower = xt @ to_root, turn @ tx
    inner = turn @ tt @ to_root
    if has_lever(model, k):
        X, c, drift = (
            matrix_in(lane, S, h + H.shift),
            load_vector(lane, S, h + H.swing),
            load_vector(lane, S, h + H.drift),
        )
        lever, pull = load_vector(lane, S, h + H.lever), load_vector(lane, S, h + H.force)
        # levers: dr of the root also follows X d, with the rotation d of the section before
        Xt, swing = X.T, swing_of(lane, model, k, axis, turn)
        sideways, aside = xx @ drift, tx @ drift
        inner = inner + (lower @ X + (Xt @ upper + Xt @ (xx @ X)))
        # geometric stiffness lever^ pull^: the lever turns with the section before
        inner = inner + skew(lever) @ skew(pull)
        upper, lower = upper + xx @ X, lower + Xt @ xx
        # the joint's row and column with c: c . f and f = xx c in the block of the section before
        by_turn = by_turn + (turn @ (xt.T @ c) + Xt @ by_place)
        by_turn = by_turn + (Xt @ (xx.T @ c) + cross(swing, pull))
        by_place = by_place + xx.T @ c
        force = force + sideways
        on_section = on_section + turn @ aside + (Xt @ force + cross(swing, pull))
    if model.rotors is not None:
        if model.rotors[k] > 0:
            share = S[h + H.rotor + ROTOR.factor]
            on_section = on_section + share * load_vector(lane, S, h + H.sway)
    # add to the section before, then subtract column row^T / pivot
    add_block(lane, S, below, 0, 0, xx)
    add_block(lane, S, below, 0, 1, upper)
    add_block(lane, S, below, 1, 0, lower)
    add_block(lane, S, below, 1, 1, inner)
    if free:
        inverse = 1.0 / pivot
        store_vector(lane, S, h + H.column, force)
        store_vector(lane, S, h + H.column + 3, on_section)
        store_vector(lane, S, h + H.row, inverse * by_place)
        store_vector(lane, S, h + H.row + 3, inverse * by_turn)
        S[h + H.pivot] = inverse
        for i in range(6):
            for j in range(6):
                S[below + 6 * i + j] -= S[h + H.column + i] * S[h + H.row + j]
    else:
        fill_zeros(lane, S, h + H.column, 12)
        S[h + H.pivot] = 1.0


@kernel
def store_spin_lag(lane, model, par: Lanes, S, k, spin, weights):
    """Store the vector w tau/(1 + tau c_v) (rad) of link k's root in its `HINGE`; 0 if weights.newton_share is 0.

    w: argument `spin`, rad/s, root axes.
    c_v: weights.damping (1/s).
    tau: tau_d (s). `joint_motion_of_root` reads the stored vector. See docs/theory.md, section 9.
    """
    if model.damped is not None and model.strains is None:
        tau = par[TAU_D]
        store_vector(lane, S, hinge_at(k) + H.lag, (tau / (tau * weights.damping + 1.0) * weights.newton_share) * spin)


@kernel
def joint_motion_of_root(lane, model, S, k, a):
    """Return a + lag x a, the rotation of link k's root per joint angle in root axes. a: the same without damping.

    lag: the vector `HINGE.lag` of the joint. The joint's angle rotates the root's axes, so that rates in these axes
    change by w x a, where w is the spin of the root. Springs with dampers are 1 + tau_d c_v times as stiff as springs
    alone; c_v is the weight of dr/dv. The change of rates therefore acts like an additional rotation tau_d / (1 + tau_d
    c_v) w x a (theory, 9). Without damping the function returns a. It also returns a if strains are coordinates,
    because dampers of strains do not depend on these rates.
    """
    if model.damped is None or model.strains is not None:
        return a
    return a + cross(load_vector(lane, S, hinge_at(k) + H.lag), a)


@kernel
def factor_base(lane, S: Lanes):
    """Factor the base's 6 x 6 block in place; fixed rows and columns are replaced by those of the identity matrix."""
    zero, one = 0.0, 1.0
    for i in range(6):
        if load_lane(lane, S, B.pinned + i, 0) != 0.0:
            for j in range(6):
                S[B.matrix + 6 * i + j] = zero
                S[B.matrix + 6 * j + i] = zero
            S[B.matrix + 7 * i] = one
    _factor_six(lane, part_of(lane, S, B.matrix, 36))


@kernel
def solve_base(lane, S, x: Lanes, across):
    """Solve for the base's motion in x[0 : 6]: m along inertial axes, rad about base axes; 0 for fixed coordinates.

    across: if True, solve the transposed system; if False, solve the system itself.
    """
    for i in range(6):
        if S[(B.pinned + i) * len(lane)] != 0.0:
            x[i] = 0.0
    if across:
        solve_six_transposed(lane, part_of(lane, S, B.matrix, 36), part_of(lane, x, 0, 6))
    else:
        solve_six(lane, part_of(lane, S, B.matrix, 36), part_of(lane, x, 0, 6))


@kernel
def block_times(lane, S, o, a, b):
    """Return M (a, b), a pair of vectors: M is the 6 x 6 matrix at offset o of S, a and b are vectors."""
    upper = _block(lane, S, o, 0, 0) @ a + _block(lane, S, o, 0, 1) @ b
    return upper, _block(lane, S, o, 1, 0) @ a + _block(lane, S, o, 1, 1) @ b


@kernel
def transposed_times(lane, S, o, a, b):
    """Return M^T (a, b), a pair of vectors: M is the 6 x 6 matrix at offset o of S, a and b are vectors."""
    upper = _block(lane, S, o, 0, 0).T @ a + _block(lane, S, o, 1, 0).T @ b
    return upper, _block(lane, S, o, 0, 1).T @ a + _block(lane, S, o, 1, 1).T @ b


@kernel
def swing_of(lane, model, k, axis, turn):
    """Return E (axis x o), the displacement of link k's first section per joint angle (m/rad).

    The result is in the axes of the section before the joint.
    turn: rotation matrix E from axes of the link's root to axes of the preceding section.
    axis: the joint's axis, root axes.
    o: lever from the joint to the link's first section (`JOINT.beyond`), root axes.
    """
    return turn @ cross(axis, three_of(lane, model.joints, J.end * k + J.beyond))
