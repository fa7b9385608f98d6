"""Entry point from Python to the equations of motion themselves, to be differentiated and solved in `linear`."""

from __future__ import annotations

from ..compiler import bare, kernel
from .protocol import assemble, constrain, out_of_range


@kernel
def equations(lane, model, par, q, v, a, u, psi, level, r, S):
    """r = M(q) a + h(q, v) + Phi_q^T lambda - B u, rows of multipliers: Phi (level 0), its first or second rate (1, 2).

    S: room for the iteration matrix, left as it is. Returns 0 where the model holds, otherwise the status code.
    SINGLE only.
    """
    m = bare(model)
    assemble(lane, m, bare(par), bare(q), bare(v), bare(a), bare(u), 0.0, 0.0, 0.0, bare(r), bare(S))
    constrain(lane, m, bare(psi), bare(q), bare(v), bare(a), level, 1.0, bare(r))
    return out_of_range(lane, m, bare(par), bare(q))
