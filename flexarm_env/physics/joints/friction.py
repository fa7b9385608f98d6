"""Coulomb friction as a set-valued law, equation (6.6), by a correction of the linear system's solution.

The friction torque T of a joint at rest satisfies |T| <= T_C. If the joint moves, T has the magnitude T_C and opposes
the rate. The residual of the linear system does not contain T. The corrected solution x + W T, with the columns W of
S^-1, is linear in the torques T of all joints. Each joint's rate is therefore linear in T, too. For each joint either
the torque is known (T = +-T_C) or the rate (0). The law is not regularized, so that friction does not limit the step.

The law applies to the rate w = v + ahead a, half a step ahead. A joint that friction stops is then at rest two steps
later. If the law applied to v, trapezoidal steps would leave an alternating acceleration in the joint.

The integrator calls these functions for any Model. In models without Coulomb friction the functions do nothing.
"""

from __future__ import annotations

from ...compiler import Lanes, absolute, kernel, select_lt, size
from .. import protocol
from ..arithmetic import clip
from ..layout import DISSIPATED
from ..protocol import RESIDUAL_ALONE, State
from .layout import GEAR, PLACE, PLACES, joint_law

_SLIDES, _TURNS = 0.99, 1e-12
"""A joint slides if the other forces exceed the fraction _SLIDES of T_C and its rate exceeds _TURNS (rad/s, round-off).
The fraction is less than 1 because of the solver's error."""


@kernel
def count(model):
    """Return the number of joints in the model's table. The table lists the joints that are not ideal."""
    return model.table.shape[0] // PLACES


@kernel
def gear_at(model, i):
    """Return the offset in S of the `GEAR` record of joint i."""
    return size(model.arm.n_factor) + GEAR.end * i


@kernel
def column_at(model, i):
    """Return the offset in S of the column W_i (n numbers) of S^-1 for joint i, in models with friction."""
    return gear_at(model, count(model)) + size(model.n) * i


@kernel
def _row_at(model, i):
    """Return the offset in S of joint i's row of the linear system for the torques; a row has `count` + 1 numbers."""
    return column_at(model, count(model)) + (count(model) + 1) * i


@kernel
def array_slice(lane, S: Lanes, at, n):
    """Return a view of n entries of S from offset `at` on."""
    return S[at : at + n]


@kernel
def direction(lane, rate):
    """Return the sign of a rate: 1, -1, or 0 at rest."""
    zero, one = 0.0, 1.0
    return select_lt(zero, rate, one, select_lt(rate, zero, -one, zero))


@kernel
def store_columns(lane, model, S):
    """Store in S the columns W_i = S^-1 e_i of the rows on which friction acts; 0 if the angle is prescribed.

    On entry S contains the factors of the Newton matrix.
    """
    if model.newton.friction is not None:
        for i in range(count(model)):
            column = array_slice(lane, S, column_at(model, i), size(model.n))
            for k in range(size(model.n)):
                column[k] = 0.0
            if model.table[PLACES * i + PLACE.known] == 0:
                column[model.table[PLACES * i + PLACE.friction]] = 1.0
                protocol.solve(lane, model, S, column)


@kernel
def store_friction(lane, model, par, state: State, u, r: Lanes, S: Lanes):
    """Store in S the friction torques of the present state and which joints slide; r <- residual (N m) with friction.

    The friction torque of a sliding joint has the magnitude T_C and opposes the rate. The margin _SLIDES makes this
    torque independent of small changes of the other forces in the joint's row. The torque of a sticking joint balances
    the other forces, up to the Coulomb friction torque T_C.

    # in        state: q, v, a of the arm; u: inputs
    # out       r (n,); fields of `GEAR`: before (friction torque, N m), slides (1 or 0), free: 1 if the joint does
    #           not slide and friction within T_C balances the other forces of the joint's row, otherwise 0

    See docs/theory.md, (6.6).
    """
    if model.newton.friction is not None:
        protocol.assemble(lane, model, par, state, u, RESIDUAL_ALONE, r, S)
        for i in range(count(model)):
            g, row = gear_at(model, i), model.table[PLACES * i + PLACE.friction]
            coulomb, rate, rest = joint_law(lane, model, par, i).coulomb, state.v[row], r[row]
            # torque that balances the row's other forces `rest`, within +-T_C
            zero, one, torque = 0.0, 1.0, clip(-rest, coulomb)
            way = direction(lane, rate)
            # sliding: turning, and balanced by (nearly) T_C against the rate
            moves = select_lt(_TURNS, absolute(rate), torque * way, zero)
            slides = select_lt(_SLIDES * coulomb, moves, one, zero)
            torque = select_lt(0.5, slides, coulomb * way, torque)
            free = select_lt(coulomb, absolute(rest), zero, one - slides)
            # prescribed angle: T_C against the rate is already in the residual
            if model.table[PLACES * i + PLACE.known] != 0:
                torque, slides, free = coulomb * way, zero, zero
            else:
                r[row] = rest + torque
            S[g + GEAR.before] = torque
            S[g + GEAR.free] = free
            S[g + GEAR.slides] = slides


@kernel
def release_reversed_joints(lane, model, v: Lanes, S: Lanes):
    """Clear the flag `slides` in S for joints whose rate v has changed sign by impulses since `store_friction`.

    Joints whose rate has changed sign do not continue to slide in the stored direction.
    v: rates of all rows after the impulses.
    """
    if model.newton.friction is not None:
        for i in range(count(model)):
            g, row = gear_at(model, i), model.table[PLACES * i + PLACE.friction]
            slides, with_it = S[g + GEAR.slides], S[g + GEAR.before] * v[row]
            S[g + GEAR.slides] = select_lt(with_it, 0.0, 0.0, slides)


@kernel
def account_for_friction(lane, model, par, state, u, r, S, start, books):
    """Add the energy (J) that friction dissipates in a step, mean torque times change of angle, to the account `books`.

    start: coordinates at the step's start. The mean torque is the average of the torques stored at the step's start and
    those of the present state. The present torques are stored in S for the next step.
    Scratch memory: r.
    """
    if model.newton.friction is not None:
        _account_for_half(lane, model, state, S, start, books)
        store_friction(lane, model, par, state, u, r, S)
        _account_for_half(lane, model, state, S, start, books)


@kernel
def _account_for_half(lane, model, state: State, S: Lanes, start: Lanes, books: Lanes):
    """Add half of the stored friction torques times the rotations since `start` to the dissipation in books, J."""
    total = books[DISSIPATED]
    for i in range(count(model)):
        k = model.table[PLACES * i + PLACE.friction]
        moved = state.q[k] - start[k]
        total = total + S[gear_at(model, i) + GEAR.before] * moved * 0.5
    books[DISSIPATED] = total


@kernel
def apply_friction(lane, model, par, state, weights, ahead, S: Lanes, x):
    """Add Coulomb friction torques T to x = S^-1 r, x <- x + W T, so that the law (6.6) holds for the new rates.

    W: columns of S^-1 for the rows on which friction acts. The state changes by a -= weights.mass x, v -=
    weights.damping x. Friction acts on the rate v + ahead a (ahead in s). If weights.damping is 0, v does not change,
    and joints that slid at the last `store_friction` continue to slide.

    The kernel guesses which joints stick, solves for the torques, and corrects the guess. For one joint the result is
    exact at once. For several joints there are 2 joints - 1 passes, and Newton's next iteration corrects the remaining
    errors.

    # out       x (n,); `GEAR` fields gap, sticks, bound, torque in S
    """
    if model.newton.friction is not None:
        joints = count(model)
        find_gaps(lane, model, state, weights, ahead, S, x)
        for i in range(joints):
            S[gear_at(model, i) + GEAR.torque] = 0.0
        for _ in range(2 * joints - 1):
            for i in range(joints):
                _choose_branch(lane, model, par, weights, i, S)
            solve_torques(lane, model, S, False)
        add_torques(lane, model, S, x)


@kernel
def find_gaps(lane, model, state: State, weights, ahead, S: Lanes, x: Lanes):
    """Compute each joint's gap w/c - x_i, the change of the increment x_i that makes the joint's rate w vanish.

    w: rate v + ahead a before the increment. c = weights.damping + ahead weights.mass.
    """
    share = 1.0 / (weights.damping + ahead * weights.mass)
    for i in range(count(model)):
        row = model.table[PLACES * i + PLACE.friction]
        rate = state.v[row] + state.a[row] * ahead
        S[gear_at(model, i) + GEAR.gap] = rate * share - x[row]


@kernel
def _choose_branch(lane, model, par, weights, i, S: Lanes):
    """Decide from the present torques T whether joint i sticks, and store its sliding torque in `bound`, (6.6).

    If weights.damping is 0 (v does not change), a joint that slid at the last `store_friction` continues to slide with
    its stored torque.

    # out       `GEAR` fields sticks (1 or 0) and bound (N m) of joint i
    """
    g, row = gear_at(model, i), model.table[PLACES * i + PLACE.friction]
    coulomb, zero, one = joint_law(lane, model, par, i).coulomb, 0.0, 1.0
    # gap that the present torques leave: gap_i - (W T)_i
    left = S[g + GEAR.gap]
    for j in range(count(model)):
        left = left - S[column_at(model, j) + row] * S[gear_at(model, j) + GEAR.torque]
    sticks, bound = zero, zero
    if model.table[PLACES * i + PLACE.known] == 0:
        # torque that closes the gap; within T_C the joint sticks, otherwise T = +-T_C
        wanted = S[g + GEAR.torque] + left / S[column_at(model, i) + row]
        sticks, bound = select_lt(absolute(wanted), coulomb, one, zero), clip(wanted, coulomb)
        # torques jump, v does not: a joint that slid keeps its T_C
        if weights.damping == 0.0:
            slides = S[g + GEAR.slides]
            sticks = select_lt(0.5, slides, zero, sticks)
            bound = select_lt(0.5, slides, S[g + GEAR.before], bound)
    S[g + GEAR.sticks] = sticks
    S[g + GEAR.bound] = bound


@kernel
def solve_torques(lane, model, S: Lanes, transposed):
    """Solve for friction torques T (N m): sum_j W_ij T_j = gap_i where joint i sticks, T_i = bound_i where it slides.

    The function reads two `GEAR` fields: gap (`find_gaps`, the change of the increment x_i that leaves joint i at rest)
    and bound (N m). The field torque receives T.
    W_ij: entry of S^-1 in the friction rows of joints i and j.
    transposed: if True, use W^T, for cotangents; all bounds are then 0. The Gaussian elimination has no pivoting. See
    docs/theory.md, (6.6).
    """
    joints, one, zero = count(model), 1.0, 0.0
    for i in range(joints):
        g, row = gear_at(model, i), array_slice(lane, S, _row_at(model, i), joints + 1)
        sticks, own = S[g + GEAR.sticks], model.table[PLACES * i + PLACE.friction]
        # row i: sum_j W_ij T_j = gap where joint i sticks, T_i = +-T_C where it slides
        for j in range(joints):
            at = column_at(model, j) + own
            if transposed:
                at = column_at(model, i) + model.table[PLACES * j + PLACE.friction]
            row[j] = select_lt(0.5, sticks, S[at], one if i == j else zero)
        row[joints] = select_lt(0.5, sticks, S[g + GEAR.gap], S[g + GEAR.bound])
        # eliminate with the rows above; the pivots belong to minors of S^-1 and are not zero
        for j in range(i):
            above = array_slice(lane, S, _row_at(model, j), joints + 1)
            factor_of = row[j] / above[j]
            for k in range(j + 1, joints + 1):
                row[k] -= above[k] * factor_of
    # T from the last row to the first
    for i in range(joints - 1, -1, -1):
        row = array_slice(lane, S, _row_at(model, i), joints + 1)
        total = row[joints]
        for j in range(i + 1, joints):
            total = total - row[j] * S[gear_at(model, j) + GEAR.torque]
        S[gear_at(model, i) + GEAR.torque] = total / row[i]


@kernel
def add_torques(lane, model, S: Lanes, x: Lanes):
    """Add the friction torques T (N m) to the solution, x <- x + W T, so that sticking joints have exactly the rate 0.

    W: columns of S^-1 for the rows on which friction acts. The increment of a sticking joint becomes gap + x_i, which
    brings it to rest. See docs/theory.md, (6.6).
    """
    n = size(model.n)
    # gap + x_i = w/c, before x changes
    for i in range(count(model)):
        g = gear_at(model, i)
        S[g + GEAR.gap] = x[model.table[PLACES * i + PLACE.friction]] + S[g + GEAR.gap]
    for i in range(count(model)):
        torque, column = S[gear_at(model, i) + GEAR.torque], column_at(model, i)
        for k in range(n):
            x[k] += S[column + k] * torque
    # rounding in x + W T would leave a sticking joint a small rate
    for i in range(count(model)):
        g, row = gear_at(model, i), model.table[PLACES * i + PLACE.friction]
        x[row] = select_lt(0.5, S[g + GEAR.sticks], S[g + GEAR.gap], x[row])


@kernel
def hold_sticking_joints(lane, model, S: Lanes, x: Lanes):
    """Hold joints that stuck in the last `apply_friction` at rest: x <- x + W T, so that their rows of x become 0.

    x (n,): on entry a solution S^-1 y without friction.
    W: columns of S^-1 for the rows on which friction acts.
    T: friction torques. S contains the factors of the Newton matrix and the `GEAR` records.
    """
    if model.newton.friction is not None:
        for i in range(count(model)):
            g = gear_at(model, i)
            S[g + GEAR.gap] = -x[model.table[PLACES * i + PLACE.friction]]
            S[g + GEAR.bound] = 0.0
        solve_torques(lane, model, S, False)
        add_torques(lane, model, S, x)
