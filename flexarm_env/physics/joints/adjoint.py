"""Derivatives backwards of what turns the joints (model: `physics.model.Jointed`); laws that all arms share."""

from __future__ import annotations

from ...compiler import kernel, load, splat, store
from .. import protocol
from ..arithmetic import add
from ..model import Jointed
from ..protocol import register
from .equations import spring
from .friction import count, law
from .layout import PLACE, PLACES


@kernel
def vjp_residual(lane, model, par, par_bar, state, u, S, bar, u_bar, r_bar):
    """See `protocol`; of rotors that turn in space, whose momentum the arm's own equations ask for, from the source."""
    if model.spin is not None:
        protocol.vjp_source(lane, model, par, par_bar, state, u, S, bar, u_bar, r_bar)
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


register(Jointed, vjp_residual)
