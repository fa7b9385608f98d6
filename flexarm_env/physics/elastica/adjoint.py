"""Derivatives backwards of the elastica's solve and residual as straight-line code (`compiler.vjp_of`)."""

from ...compiler import kernel, vjp_of
from ..model import Elastica
from ..protocol import State, register
from .equations import residual, solve


def _residual(lane, model, par, q, v, a, u, r):
    residual(lane, model, par, State(q, v, a), u, r, r)


def _solve(lane, model, S, x):
    solve(lane, model, S, x)


_vjp_solve = vjp_of(_solve, ("x",))
_vjp_residual = vjp_of(_residual, ("par", "q", "v", "a", "u", "r"))


@kernel
def solve_transposed(lane, model, S, x):
    """See `protocol`: cotangents of what is linear go by its transposed."""
    _vjp_solve(lane, model, S, x, x)


@kernel
def vjp_residual(lane, model, par, par_bar, state, u, S, bar, u_bar, r_bar):
    """See `protocol`."""
    q, v, a = state
    _vjp_residual(lane, model, par, q, v, a, u, S, par_bar, bar.q, bar.v, bar.a, u_bar, r_bar)


register(Elastica, solve_transposed, vjp_residual)
