"""What happens at an instant where only inputs jump: the torques of a controller, held over a period or a step."""

from __future__ import annotations

from ...compiler import kernel, load, select_lt, size, store
from ..joints.friction import apply_friction, note_friction
from ..layout import FACTORISATIONS
from ..protocol import MASS_ALONE, RESIDUAL_ALONE, Weights, assemble, factor, solve
from .work import state_of, take_multipliers, take_out_known, unpack


@kernel
def light_weights(h):
    """Shares in the matrix that accelerations of light joints jump by."""
    return Weights(1.0, 0.5 * h, 0.25 * h * h)


@kernel
def switch(lane, model, par, flat, n_motions, h, first, kept=None):
    """Let accelerations jump with the inputs, from w.u0 to w.u: M da + Phi_q^T dlambda = B (u - u0), for a and b alike.

    Unlike `restart` this keeps what the integrator has filtered: where stretch, shear and rotary modes are too fast for
    the step, accelerations solved afresh from round-off in the strains are large, and Newton would start far away.
    h: a step. first: None, but for models that are `protocol.light`, whose da is that of M + h/2 C + h^2/4 K: 1 in
    lanes that were not moved before, for which a = 0 and da follows from all forces. kept: a tag where accelerations
    before are to be left in w.a0.
    """
    w, n = unpack(lane, model, flat, n_motions), size(model.n)  # q0 is scratch
    assemble(lane, model, par, state_of(w), w.u0, RESIDUAL_ALONE, w.r, w.S)
    note_friction(lane, model, par, state_of(w), w.u0, w.r, w.S)
    for k in range(n):
        before = load(lane, w.r, k)
        if first is not None:
            before = select_lt(0.5, first, 0.0, before)
        store(w.q0, k, before)
    weights = MASS_ALONE if first is None else light_weights(h)
    assemble(lane, model, par, state_of(w), w.u, weights, w.r, w.S)
    for k in range(n):
        store(w.r, k, load(lane, w.r, k) - load(lane, w.q0, k))
    take_out_known(lane, model, None, w.r, w.S, True)
    factor(lane, model, w.S)
    w.counts[FACTORISATIONS] += 1.0
    solve(lane, model, w.S, w.r)
    apply_friction(lane, model, par, state_of(w), MASS_ALONE, 0.5 * h, w.S, w.r)
    take_multipliers(lane, model.algebraic, w, None, 1.0)
    for k in range(n):
        if kept is not None:
            store(w.a0, k, load(lane, w.a, k))
        store(w.a, k, load(lane, w.a, k) - load(lane, w.r, k))
        store(w.b, k, load(lane, w.b, k) - load(lane, w.r, k))
