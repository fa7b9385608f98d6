"""Derivatives backwards of what turns the joints (model: `physics.model.Jointed`); laws that all arms share."""

from __future__ import annotations

from ...compiler import kernel, vjp_of
from .. import protocol
from ..model import Jointed
from ..protocol import RESIDUAL_ALONE, register
from .equations import turn_joints


@kernel
def _turn_joints(lane, model, par, state, u, r, S):
    turn_joints(lane, model, par, state, u, RESIDUAL_ALONE, r, S)


_vjp_joints = vjp_of(_turn_joints, ("par", "state", "u", "r"), scratch=("S",))


@kernel
def vjp_residual(lane, model, par, par_bar, state, u, S, bar, u_bar, r_bar):
    """See `protocol`; of rotors that turn in space, whose momentum the arm's own equations ask for, from the source."""
    if model.spin is not None:
        protocol.vjp_source(lane, model, par, par_bar, state, u, S, bar, u_bar, r_bar)
    else:
        _vjp_joints(lane, model, par, state, u, r_bar, S, par_bar, bar, u_bar, r_bar)
        protocol.vjp_residual(lane, model.arm, par, par_bar, state, u, S, bar, u_bar, r_bar)


register(Jointed, vjp_residual)
