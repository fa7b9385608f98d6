"""Cotangents of a step and of a fresh start: what comes out of them, pulled back to what went in.

The transposes of `tangents`: a system with the transposed matrix, and the residual's derivatives backwards, written out
from its own source (`compiler.pulled`). `bar` is a work array whose q, v, a, b and u hold cotangents; `w` holds the arm
at the end of the step.
"""

from __future__ import annotations

from ...compiler import kernel, load, pulled, size, splat, store
from ..protocol import State, residual, solve_transposed
from .work import take_out_known


def _residual(lane, model, par, q, v, a, u, r):
    residual(lane, model, par, State(q, v, a), u, r, r)


_pull_residual = pulled(_residual, ("par", "q", "v", "a", "u", "r"))


@kernel
def _back(lane, model, par, par_bar, w, bar):
    """bar <- bar - (derivatives of the residual)' S^-T bar.r, of the factors in w.S; bar.r becomes 0."""
    for k in range(size(model.n)):
        store(bar.r, k, -load(lane, bar.r, k))
    take_out_known(lane, model, None, bar.r, w.S, False)
    solve_transposed(lane, model, w.S, bar.r)
    take_out_known(lane, model, None, bar.r, w.S, False)
    _pull_residual(lane, model, par, w.q, w.v, w.a, w.u, w.r, par_bar, bar.q, bar.v, bar.a, bar.u, bar.r)


@kernel
def pull_step(lane, model, par, par_bar, w, bar, slopes, scheme):
    """bar: cotangents of q, v, a, b from a step's end to its start; those of u and of the parameters are added."""
    n, h, am, af = size(model.n), slopes.h, scheme.alpha_m, scheme.alpha_f
    zero = splat(lane, 0.0)
    for k in range(n):
        q, v = load(lane, bar.q, k), load(lane, bar.v, k)
        a, b = load(lane, bar.a, k), load(lane, bar.b, k)
        store(bar.r, k, q + v * slopes.v + a * slopes.a + b * slopes.b)
        store(bar.q0, k, -b * slopes.b)
        store(bar.q, k, zero)
    _back(lane, model, par, par_bar, w, bar)  # what reaches q itself is in the matrix
    for k in range(n):
        v, a = load(lane, bar.v, k), load(lane, bar.a, k)
        ahead = load(lane, bar.q0, k) - v * slopes.v - a * slopes.a
        store(bar.q, k, ahead)
        store(bar.v, k, v + ahead * h)
        store(bar.b, k, v * (h * (1.0 - scheme.gamma)) + a * (am / (1.0 - af)) + ahead * (h * h * (0.5 - scheme.beta)))
        store(bar.a, k, a * (-af / (1.0 - af)))


@kernel
def pull_restart(lane, model, par, par_bar, w, bar):
    """bar: cotangents of q and v from after a fresh start to before it; w.S: its matrix."""
    zero = splat(lane, 0.0)
    for k in range(size(model.n)):
        store(bar.r, k, load(lane, bar.a, k) + load(lane, bar.b, k))
        store(bar.a, k, zero)
        store(bar.b, k, zero)
    _back(lane, model, par, par_bar, w, bar)
    for k in range(size(model.n)):
        store(bar.a, k, zero)
