"""Derivatives backwards of what turns the joints (model: `physics.model.Jointed`); laws that all arms share."""

from __future__ import annotations

from ...compiler import kernel, load, size, splat, store, vjp_of
from .. import protocol
from ..arithmetic import add
from ..model import Jointed
from ..protocol import RESIDUAL_ALONE, register
from .equations import assemble, multiply, spring
from .friction import count, law
from .layout import PLACE, PLACES


@kernel
def _residual(lane, model, par, state, u, r, S):
    assemble(lane, model, par, state, u, RESIDUAL_ALONE, r, S)


@kernel
def _product(lane, model, par, state, u, weights, x, y, S):
    assemble(lane, model, par, state, u, weights, y, S)
    for k in range(size(model.n)):
        store(y, k, splat(lane, 0.0))
    multiply(lane, model, S, x, y)


_vjp_whole = vjp_of(_residual, ("par", "state", "u", "r"), scratch=("S",))
_vjp_product = vjp_of(_product, ("par", "state", "u", "y"), scratch=("S",))


@kernel
def vjp_product(lane, model, par, par_bar, state, u, weights, x, S, bar, u_bar, y_bar):
    """See `protocol`."""
    _vjp_product(lane, model, par, state, u, weights, x, y_bar, S, par_bar, bar, u_bar, y_bar)


@kernel
def vjp_residual(lane, model, par, par_bar, state, u, S, bar, u_bar, r_bar):
    """See `protocol`; of rotors that turn in space, whose momentum the arm's own equations ask for, from the source."""
    if model.spin is not None:
        _vjp_whole(lane, model, par, state, u, r_bar, S, par_bar, bar, u_bar, r_bar)
    else:
        _vjp_laws(lane, model, par, par_bar, state, u, S, bar, u_bar, r_bar)


@kernel
def _vjp_laws(lane, model, par, par_bar, state, u, S, bar, u_bar, r_bar):
    for i in range(count(model)):
        at, one = PLACES * i, law(lane, model, par, i)
        row, motor, own = model.table[at + PLACE.row], model.table[at + PLACE.motor], model.table[at + PLACE.friction]
        turned = motor if motor >= 0 else row
        add(lane, bar.a, turned, load(lane, r_bar, turned) * one.rotor)
        add(lane, bar.v, own, load(lane, r_bar, own) * one.viscous)
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
    protocol.vjp_residual(lane, model.arm, par, par_bar, state, u, S, bar, u_bar, r_bar)


@kernel
def vjp_poses(lane, model, par, par_bar, q, v, poses, q_bar, v_bar, poses_bar):
    """The arm's own."""
    protocol.vjp_poses(lane, model.arm, par, par_bar, q, v, poses, q_bar, v_bar, poses_bar)


register(Jointed, vjp_residual, vjp_poses, vjp_product)
