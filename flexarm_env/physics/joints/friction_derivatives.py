"""Derivatives of Coulomb friction, equation (6.6), for changes so small that no joint starts or stops sliding.

`transitions` and `runtime.sensitivity` call these functions after `joints.friction` has computed the values.
`joints.friction` stores the friction torques and the state of each joint (sticking or sliding) in the matrix array S.
"""

from __future__ import annotations

from ...compiler import Lanes, kernel, load, select_lt, size, splat, store
from .. import protocol
from .friction import (
    add_torques,
    apply_friction,
    column_at,
    count,
    direction,
    find_gaps,
    gear_at,
    solve_torques,
)
from .layout import GEAR, LAWS, PLACE, PLACES, joint_law


@kernel
def store_branch(lane, model, par, state, weights, ahead, r, S: Lanes):
    """Store in S which joints stick at the end of a step, and the direction (slides = +-1) in which the others slide.

    S: factors of the step's matrix.
    r: residual at the step's end, overwritten.
    weights, ahead: as in `apply_friction`.
    """
    if model.newton.friction is not None:
        protocol.solve(lane, model, S, r)
        apply_friction(lane, model, par, state, weights, ahead, S, r)
        store_directions(lane, model, S)


@kernel
def store_directions(lane, model, S: Lanes):
    """Store the signs (+-1) of the sliding torques `bound` in `slides` (0: the joint sticks), then set `bound` to 0."""
    if model.newton.friction is not None:
        for i in range(count(model)):
            g, zero = gear_at(model, i), 0.0
            slides = direction(lane, S[g + GEAR.bound])
            S[g + GEAR.slides] = select_lt(0.5, S[g + GEAR.sticks], zero, slides)
            S[g + GEAR.bound] = zero


@kernel
def _coulomb_tangent(lane, wide, model, parx, i, j):
    """Return tangent j of joint i's T_C (N m), from the arms' own parameters parx; 0 if all arms have the same T_C."""
    if model.own is None:
        return splat(lane, 0.0)
    return load(lane, parx, _coulomb_at(model, i) * (len(wide) // len(lane)) + j)


@kernel
def _coulomb_at(model, i):
    """Return the index of joint i's T_C among an arm's own parameters."""
    return size(model.own) + LAWS.end * i + LAWS.coulomb


@kernel
def change_friction_tangents(lane, wide, model, parx, j, S: Lanes):
    """Set `bound` in S to tangent j of each sliding torque: the tangent of T_C times the sliding direction `slides`."""
    if model.newton.friction is not None:
        for i in range(count(model)):
            g = gear_at(model, i)
            S[g + GEAR.bound] = S[g + GEAR.slides] * _coulomb_tangent(lane, wide, model, parx, i, j)


@kernel
def friction_residual_tangents(lane, wide, model, parx, S: Lanes, r, first):
    """Apply the linearized `store_friction` to the tangents of r (n dual rows); S contains the state of each joint.

    A joint that sticks with a torque within T_C has residual 0 for any other forces. In all other joints friction is
    +-T_C. Lanes with `first` > 1/2 start afresh. Lanes that start afresh have no residual before the jump and are
    skipped.
    """
    if model.newton.friction is not None:
        many = len(wide) // len(lane)
        for i in range(count(model)):
            g, row, zero = gear_at(model, i), model.table[PLACES * i + PLACE.friction], splat(lane, 0.0)
            for j in range(1, many):
                rest = load(lane, r, row * many + j)
                more = direction(lane, S[g + GEAR.before]) * _coulomb_tangent(lane, wide, model, parx, i, j)
                found = select_lt(0.5, S[g + GEAR.free], zero, rest + more)
                store(r, row * many + j, select_lt(0.5, first, zero, found))


@kernel
def change_friction(lane, model, par, weight, S: Lanes):
    """For joints that slide, add weight * T_C of this model, with the sign of the sliding direction, to `bound` (N m).

    The added value is the change of the Coulomb friction torques along a direction of the parameters.
    """
    if model.newton.friction is not None:
        for i in range(count(model)):
            g = gear_at(model, i)
            more = S[g + GEAR.slides] * (joint_law(lane, model, par, i).coulomb * weight)
            S[g + GEAR.bound] += more


@kernel
def friction_tangents(lane, model, change, weights, ahead, S: Lanes, x):
    """Add friction to the tangents x (n,) of an increment: the linearized `apply_friction` for the stored joint states.

    change: `State` of tangents of q, v, a.
    weights, ahead: as in `apply_friction` (rate v + ahead a). `bound` in S contains tangents of the torques of sliding
    joints; it is set to 0.
    """
    if model.newton.friction is not None:
        find_gaps(lane, model, change, weights, ahead, S, x)
        solve_torques(lane, model, S, False)
        add_torques(lane, model, S, x)
        for i in range(count(model)):
            S[gear_at(model, i) + GEAR.bound] = 0.0


@kernel
def friction_cotangents(lane, model, par_bar: Lanes, weights, ahead, S: Lanes, x: Lanes, v_bar: Lanes, a_bar: Lanes):
    """Replace cotangents x after friction by cotangents before friction: the reverse derivative of `friction_tangents`.

    The cotangents of the rates w = v + ahead a are added to v_bar and a_bar. W^T x contains the cotangents of the
    torques, with the columns W of S^-1. For sticking joints it must vanish; this requires the solution of a linear
    system with the transposed entries of W in the rows of these joints. The torques of sliding joints are T_C in the
    directions `slides` (`store_directions`); their cotangents are added to the arms' own T_C in par_bar. See
    docs/theory.md, (6.6).
    """
    if model.newton.friction is not None:
        for i in range(count(model)):
            # cotangent of torque i: W_i^T x
            g, column, total = gear_at(model, i), column_at(model, i), 0.0
            for k in range(size(model.n)):
                total = total + S[column + k] * x[k]
            S[g + GEAR.gap] = total
            S[g + GEAR.bound] = 0.0
        solve_torques(lane, model, S, True)
        # the gap is w/c - x_i: its cotangent goes to x_i and to v, a
        share = 1.0 / (weights.damping + ahead * weights.mass)
        for i in range(count(model)):
            row, given = model.table[PLACES * i + PLACE.friction], S[gear_at(model, i) + GEAR.torque]
            x[row] -= given
            v_bar[row] += given * -share
            a_bar[row] += given * (-share * ahead)
        if model.own is not None and par_bar is not None:
            for i in range(count(model)):
                g, column = gear_at(model, i), column_at(model, i)
                total = S[g + GEAR.gap]
                # sticking joints balance a part of torque i
                for j in range(count(model)):
                    row = model.table[PLACES * j + PLACE.friction]
                    total = total - S[column + row] * S[gear_at(model, j) + GEAR.torque]
                par_bar[_coulomb_at(model, i)] -= S[g + GEAR.slides] * total


@kernel
def friction_residual_cotangents(lane, model, par_bar: Lanes, S: Lanes, r_bar: Lanes):
    """Replace r_bar by the cotangents of the residual without friction: the reverse derivative of `store_friction`.

    A joint that sticks with a torque within T_C (GEAR.free = 1) has residual 0 for any other forces. The cotangent of a
    joint that sticks within T_C therefore vanishes. For all other joints friction is +-T_C. The cotangent of joints
    with friction +-T_C does not change, and is added to the cotangent of T_C in par_bar.
    """
    if model.newton.friction is not None:
        for i in range(count(model)):
            row = model.table[PLACES * i + PLACE.friction]
            given = r_bar[row]
            r_bar[row] = given - S[gear_at(model, i) + GEAR.free] * given
            if model.own is not None and par_bar is not None:
                par_bar[_coulomb_at(model, i)] += direction(lane, S[gear_at(model, i) + GEAR.before]) * r_bar[row]
