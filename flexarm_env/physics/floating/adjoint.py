"""Derivatives backwards of a chain of floating frames' solve, residual and poses, from their sources
(`compiler.vjp_of`)."""

from ...compiler import kernel, vjp_of
from ..model import FloatingChain
from ..protocol import RESIDUAL_ALONE, register
from .chain import assemble, solve
from .chain_output import link_poses


@kernel
def _residual(lane, model, par, state, u, r, S):
    assemble(lane, model, par, state, u, RESIDUAL_ALONE, r, S)


_vjp_solve = vjp_of(solve, ("x",))
_vjp_residual = vjp_of(_residual, ("par", "state", "u", "r"), scratch=("S",))
_vjp_poses = vjp_of(link_poses, ("par", "q", "v", "out"))


@kernel
def solve_transposed(lane, model, S, x):
    """See `protocol`: cotangents of what is linear go by its transposed."""
    _vjp_solve(lane, model, S, x, x)


@kernel
def vjp_residual(lane, model, par, par_bar, state, u, S, bar, u_bar, r_bar):
    """See `protocol`."""
    _vjp_residual(lane, model, par, state, u, r_bar, S, par_bar, bar, u_bar, r_bar)


@kernel
def vjp_poses(lane, model, par, par_bar, q, v, poses, q_bar, v_bar, poses_bar):
    """See `protocol`."""
    _vjp_poses(lane, model, par, q, v, poses, par_bar, q_bar, v_bar, poses_bar)


register(FloatingChain, solve_transposed, vjp_residual, vjp_poses)
