"""Derivatives backwards of a chain of exact beams' residual and poses, from their sources (`compiler.vjp_of`)."""

from ...compiler import kernel, vjp_of
from ..model import ExactBeam
from ..protocol import RESIDUAL_ALONE, register
from .equations import assemble, solve
from .output import link_poses


@kernel
def _residual(lane, model, par, state, u, r, S):
    assemble(lane, model, par, state, u, RESIDUAL_ALONE, r, S)


_vjp_residual = vjp_of(_residual, ("par", "state", "u", "r"), scratch=("S",))
_vjp_poses = vjp_of(link_poses, ("par", "q", "v", "out"))


@kernel
def vjp_residual(lane, model, par, par_bar, state, u, S, bar, u_bar, r_bar):
    """See `protocol`."""
    _vjp_residual(lane, model, par, state, u, r_bar, S, par_bar, bar, u_bar, r_bar)


@kernel
def vjp_poses(lane, model, par, par_bar, q, v, poses, q_bar, v_bar, poses_bar):
    """See `protocol`."""
    _vjp_poses(lane, model, par, q, v, poses, par_bar, q_bar, v_bar, poses_bar)


register(ExactBeam, vjp_residual, vjp_poses, solve_transposed=solve)
