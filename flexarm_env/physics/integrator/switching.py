"""What happens at an instant where only inputs jump: the torques of a controller, held over a period."""

from __future__ import annotations

from ...compiler import kernel, load, size, splat, store
from ..joints.friction import apply_friction, note_friction
from ..layout import FACTORISATIONS
from ..protocol import MASS_ALONE, RESIDUAL_ALONE, assemble, factor, solve
from .work import state_of, take_out_known, unpack


@kernel
def switch(lane, model, par, flat, n_motions, h):
    """Let accelerations jump with the inputs, from w.u0 to w.u: M da + Phi_q^T dlambda = B (u - u0), for a and b alike.

    Unlike `restart` this keeps what the integrator has filtered: where stretch, shear and rotary modes are too fast for
    the step, accelerations solved afresh from round-off in the strains are large, and Newton would start far away.
    h: a step.
    """
    w, n = unpack(lane, model, flat, n_motions), size(model.n)  # q0 is scratch
    assemble(lane, model, par, state_of(w), w.u0, RESIDUAL_ALONE, w.r, w.S)
    note_friction(lane, model, par, state_of(w), w.u0, w.r, w.S)
    for k in range(n):
        store(w.q0, k, load(lane, w.r, k))
    assemble(lane, model, par, state_of(w), w.u, MASS_ALONE, w.r, w.S)
    for k in range(n):
        store(w.r, k, load(lane, w.r, k) - load(lane, w.q0, k))
    take_out_known(lane, model, None, w.r, w.S, True)
    factor(lane, model, w.S)
    w.counts[FACTORISATIONS] += 1.0
    solve(lane, model, w.S, w.r)
    apply_friction(lane, model, par, state_of(w), MASS_ALONE, 0.5 * h, w.S, w.r)
    jump_multipliers(lane, model.algebraic, w.q, w.r)
    for k in range(n):
        store(w.a, k, load(lane, w.a, k) - load(lane, w.r, k))
        store(w.b, k, load(lane, w.b, k) - load(lane, w.r, k))


@kernel
def jump_multipliers(lane, algebraic, q, r):
    """Multipliers live in q."""
    if algebraic is not None:
        for i in range(algebraic.shape[0]):
            k = algebraic[i]
            store(q, k, load(lane, q, k) - load(lane, r, k))
            store(r, k, splat(lane, 0.0))
