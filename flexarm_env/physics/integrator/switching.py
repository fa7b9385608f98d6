"""What happens at an instant where only inputs jump: the torques of a controller, held over a period."""

from __future__ import annotations

from ...compiler import bare, kernel, load, size, splat, store
from ..layout import FACTORISATIONS
from ..protocol import Weights, assemble, begin_friction, factor, loosen, solve
from .work import state_of, take_out_known, unpack


@kernel
def switch(lane, model, par, flat, n_motions):
    """Let accelerations jump with the inputs, from w.u0 to w.u: M da + Phi_q^T dlambda = B (u - u0), for a and b alike.

    Unlike `restart` this keeps what the integrator has filtered: where stretch, shear and rotary modes are too fast for
    the step, accelerations solved afresh from round-off in the strains are large, and Newton would start far away.
    """
    _switch(lane, bare(model), bare(par), unpack(lane, model, bare(flat), n_motions))


@kernel
def _switch(lane, model, par, w):
    """`switch` on bare arrays; q0 is scratch."""
    n = size(model.n)
    begin_friction(lane, model, w.S)
    for stage in range(2):  # residual with the inputs as they were, then as they are
        if stage == 1:
            loosen(lane, model, w.S, 0.0)
            for k in range(n):
                store(w.q0, k, load(lane, w.r, k))
        u = w.u if stage == 1 else w.u0
        assemble(lane, model, par, state_of(w), u, Weights(1.0 * stage, 0.0, 0.0), w.r, w.S)
    for k in range(n):
        store(w.r, k, load(lane, w.r, k) - load(lane, w.q0, k))
    take_out_known(lane, model, None, w.r, w.S, True)
    factor(lane, model, w.S)
    w.counts[FACTORISATIONS] += 1.0
    solve(lane, model, w.S, w.r)
    _jump_multipliers(lane, model.algebraic, w.q, w.r)
    for k in range(n):
        store(w.a, k, load(lane, w.a, k) - load(lane, w.r, k))
        store(w.b, k, load(lane, w.b, k) - load(lane, w.r, k))


@kernel
def _jump_multipliers(lane, algebraic, q, r):
    """Multipliers live in q."""
    if algebraic is not None:
        for i in range(algebraic.shape[0]):
            k = algebraic[i]
            store(q, k, load(lane, q, k) - load(lane, r, k))
            store(r, k, splat(lane, 0.0))
