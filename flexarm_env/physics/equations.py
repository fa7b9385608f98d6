"""Kernels that Python calls for one arm: equations of motion (differentiated and solved in `linear`), gauges, poses."""

from ..compiler import SINGLE, kernel, store
from .protocol import RESIDUAL_ALONE, assemble, constraint_residual, out_of_range, strain_gauge, task_poses


@kernel
def equations(lane, model, par, state, u, psi, level, r, S):
    """Compute the residual r = M(q) a + h(q, v) + Phi_q^T lambda - B u of one arm, eq. [64] (N, N m).

    Rows of multipliers: Phi (level 0), its first or second time derivative (1, 2). par: the arm's own parameters;
    state: q, v, a; u: inputs (N m, N); psi: prescribed motions, a `MOTION` each. Return 0 where the model is valid,
    otherwise a status code (`model.STATUS`). S: scratch, n_factor numbers. One lane only (SINGLE).
    """
    assemble(lane, model, par, state, u, RESIDUAL_ALONE, r, S)
    constraint_residual(lane, model, psi, state, level, 1.0, r)
    return out_of_range(lane, model, par, state.q)


@kernel
def read_gauges(model, q, rows, out):
    """Compute strain gauge readings (1/m) of m configurations: out (m, G) from q (m, n); one lane.

    rows (G, ...): one row per gauge, from `gauges.curvature_rows`.
    """
    for i in range(q.shape[0]):
        for g in range(rows.shape[0]):
            store(out[i], g, strain_gauge(SINGLE, model, q[i], rows[g]))


@kernel
def read_poses(model, par, q, v, out):
    """Write the poses that tasks read, `protocol.task_poses`, of one arm at coordinates q and velocities v (n,) to out.

    out, flat: one `layout.POSES` per link, in space one `layout.SPACE_POSES`, then the poses of contributions.
    """
    task_poses(SINGLE, model, par, q, v, out)
