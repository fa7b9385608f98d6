"""Entry points from Python: the equations of motion themselves, to be differentiated and solved in `linear`; gauges."""

from ..compiler import SINGLE, kernel, store
from .protocol import RESIDUAL_ALONE, assemble, constrain, gauge, out_of_range, task_poses


@kernel
def equations(lane, model, par, state, u, psi, level, r, S):
    """r = M(q) a + h(q, v) + Phi_q^T lambda - B u, rows of multipliers: Phi (level 0), its first or second rate (1, 2).

    S: room for the iteration matrix, left as it is. Returns 0 where the model holds, otherwise the status code.
    SINGLE only.
    """
    assemble(lane, model, par, state, u, RESIDUAL_ALONE, r, S)
    constrain(lane, model, psi, state, level, 1.0, r)
    return out_of_range(lane, model, par, state.q)


@kernel
def read_gauges(model, q, rows, out):
    """out (m, G) <- what gauges with these rows (G, ...) read of coordinates q (m, n)."""
    for i in range(q.shape[0]):
        for g in range(rows.shape[0]):
            store(out[i], g, gauge(SINGLE, model, q[i], rows[g]))


@kernel
def read_poses(model, par, q, v, out):
    """out <- what tasks look at (`protocol.task_poses`)."""
    task_poses(SINGLE, model, par, q, v, out)
