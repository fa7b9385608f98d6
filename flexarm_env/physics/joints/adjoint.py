"""Derivatives backwards of what turns the joints (model: `physics.model.Jointed`); laws that all arms share.

Coulomb friction is in no residual: of x = S^-1 r + W T the torques T of joints that stick are those with which their
rates vanish, of the others constant. Backwards the torques' cotangents W' x are made to vanish for those that stick by
what their rates are given, a system with the transposed minors of W.
"""

from __future__ import annotations

from ...compiler import absolute, kernel, largest, load, maximum, size, splat, store
from .. import protocol
from ..arithmetic import add
from ..model import Jointed
from ..protocol import register
from .equations import solve, spring
from .friction import column_at, count, gear_at, law, rub, solve_torques
from .layout import GEAR, PLACE, PLACES


@kernel
def pull_residual(lane, model, par, par_bar, state, u, S, bar, u_bar, r_bar):
    """See `protocol`."""
    for i in range(count(model)):
        at, one = PLACES * i, law(lane, model, par, i)
        row, motor, rubs = model.table[at + PLACE.row], model.table[at + PLACE.motor], model.table[at + PLACE.rubs]
        turned = motor if motor >= 0 else row
        add(lane, bar.a, turned, load(lane, r_bar, turned) * one.rotor)
        add(lane, bar.v, rubs, load(lane, r_bar, rubs) * one.viscous)
        if motor >= 0:
            torque = load(lane, r_bar, motor) - load(lane, r_bar, row)
            wound = load(lane, state.q, motor) - load(lane, state.q, row)
            _, steep = spring(lane, model.play, one.stiffness, one.play, wound)
            add(lane, u_bar, model.table[at + PLACE.joint], -torque)
            add(lane, bar.q, motor, torque * steep)
            add(lane, bar.q, row, -(torque * steep))
            add(lane, bar.v, motor, torque * one.damping)
            add(lane, bar.v, row, -(torque * one.damping))
            store(r_bar, motor, splat(lane, 0.0))
    protocol.pull_residual(lane, model.arm, par, par_bar, state, u, S, bar, u_bar, r_bar)


@kernel
def pull_poses(lane, model, par, par_bar, q, v, poses, q_bar, v_bar, poses_bar):
    """The arm's own."""
    protocol.pull_poses(lane, model.arm, par, par_bar, q, v, poses, q_bar, v_bar, poses_bar)


@kernel
def stick(lane, model, par, state, weights, ahead, r, S):
    """See `protocol`."""
    _stick(lane, model.rough, model, par, state, weights, ahead, r, S)


@kernel
def _stick(lane, rough, model, par, state, weights, ahead, r, S):
    if rough is not None:
        solve(lane, model, S, r)
        rub(lane, model, par, state, weights, ahead, S, r)


@kernel
def rub_back(lane, model, weights, ahead, S, x, v_bar, a_bar):
    """See `protocol`."""
    _rub_back(lane, model.rough, model, weights, ahead, S, x, v_bar, a_bar)


@kernel
def _rub_back(lane, rough, model, weights, ahead, S, x, v_bar, a_bar):
    if rough is not None:
        for i in range(count(model)):
            g, column, total = gear_at(model, i), column_at(model, i), splat(lane, 0.0)
            for k in range(size(model.n)):
                total = total + load(lane, S, column + k) * load(lane, x, k)
            store(S, g + GEAR.gap, total)
            store(S, g + GEAR.bound, splat(lane, 0.0))
        solve_torques(lane, model, S, True)
        share = 1.0 / (weights.damping + ahead * weights.mass)
        for i in range(count(model)):
            row, given = model.table[PLACES * i + PLACE.rubs], load(lane, S, gear_at(model, i) + GEAR.torque)
            add(lane, x, row, -given)
            add(lane, v_bar, row, given * -share)
            add(lane, a_bar, row, given * (-share * ahead))


@kernel
def pull_note(lane, model, par, par_bar, state, u, room, bar, u_bar, S, x, r_bar):
    """See `protocol`."""
    _pull_note(lane, model.rough, model, par, par_bar, state, u, room, bar, u_bar, S, x, r_bar)


@kernel
def _pull_note(lane, rough, model, par, par_bar, state, u, room, bar, u_bar, S, x, r_bar):
    if rough is not None:
        for k in range(size(model.n)):
            store(r_bar, k, splat(lane, 0.0))
        _unnote(lane, rough, model, S, x, r_bar)
        most = splat(lane, 0.0)
        for i in range(count(model)):
            most = maximum(absolute(load(lane, r_bar, model.table[PLACES * i + PLACE.rubs])), most)
        if largest(most) > 0.0:
            pull_residual(lane, model, par, par_bar, state, u, room, bar, u_bar, r_bar)


@kernel
def unnote(lane, model, S, x, r_bar):
    """See `protocol`."""
    _unnote(lane, model.rough, model, S, x, r_bar)


@kernel
def _unnote(lane, rough, model, S, x, r_bar):
    """Torques noted, -rest where they are free, are added to the residual; they are those of joints that slide on."""
    if rough is not None:
        for i in range(count(model)):
            g, row = gear_at(model, i), model.table[PLACES * i + PLACE.rubs]
            given = load(lane, r_bar, row)
            torque = load(lane, S, g + GEAR.slides) * load(lane, x, row) + given
            store(r_bar, row, given - load(lane, S, g + GEAR.free) * torque)


register(
    Jointed,
    pull_residual=pull_residual,
    pull_poses=pull_poses,
    stick=stick,
    rub_back=rub_back,
    pull_note=pull_note,
    unnote=unnote,
)
