"""Jump of the accelerations when only inputs jump, for example a controller's torques at the start of a period."""

from __future__ import annotations

from ...compiler import kernel, select_lt, size
from ..contact.moving import jump_obstacles
from ..joints.friction import apply_friction, store_friction
from ..layout import FACTORISATIONS
from ..protocol import MASS_ALONE, RESIDUAL_ALONE, Weights, assemble, factor, solve
from .work import Work, remove_known_rows, state_of, take_multipliers, unpack


@kernel
def light_joint_weights(h):
    """Return the `Weights` of the matrix M + h/2 C + h^2/4 K, for acceleration jumps of light joints. h: step, s."""
    return Weights(1.0, 0.5 * h, 0.25 * h * h)


@kernel
def jump_accelerations(lane, model, par, flat, n_motions, h, first, kept=None):
    """Add to a and b the jump da that inputs cause when they change from w.u0 to w.u; q and v do not change.

    Velocities of moving obstacles may jump at the same time.

    da solves M da + Phi_q^T dlambda = B (u - u0). Unlike `restart`, this function keeps the filtered accelerations of
    the integrator. Stretch, shear and rotary modes may be too fast for the step. Accelerations that are solved afresh
    from round-off in such strains would be large, and Newton's iteration would start far from the solution.

    # model     model, par. h: a step, s; B: the inputs' generalized forces; lambda: multipliers of constraints Phi = 0
    # state     flat: work array (n_motions prescribed coordinates); w.a, w.b and multipliers in w.q: in and out
    # scratch   w.r, w.S, w.q0

    first: None, or (for models with `NewtonPolicy.light_joints`) lanes > 1/2 that start from a = 0. The matrix is then
    M + h/2 C + h^2/4 K, and in the lanes `first` all forces contribute to da.
    kept: a tag to store the accelerations before the jump in w.a0, or None. See docs/theory.md, section 6, "Kinks".
    """
    w: Work = unpack(lane, model, flat, n_motions)
    n = size(model.n)
    # r(u_0) before the jump, with Coulomb friction; 0 in lanes `first`, whose a is solved from rest
    assemble(lane, model, par, state_of(w), w.u0, RESIDUAL_ALONE, w.r, w.S)
    store_friction(lane, model, par, state_of(w), w.u0, w.r, w.S)
    for k in range(n):
        before = w.r[k]
        if first is not None:
            before = select_lt(0.5, first, 0.0, before)
        w.q0[k] = before
    # right-hand side r(u) - r(u0) = -B (u - u0), with damping forces of obstacles whose velocities jump, and the matrix
    jump_obstacles(lane, model, w, h)
    weights = MASS_ALONE if first is None else light_joint_weights(h)
    assemble(lane, model, par, state_of(w), w.u, weights, w.r, w.S)
    for k in range(n):
        w.r[k] -= w.q0[k]
    remove_known_rows(lane, model, None, w.r, w.S, True)
    factor(lane, model, w.S)
    w.counts[FACTORISATIONS] += 1.0
    solve(lane, model, w.S, w.r)
    apply_friction(lane, model, par, state_of(w), MASS_ALONE, 0.5 * h, w.S, w.r)
    # w.r = -da, and in rows of multipliers -dlambda
    take_multipliers(lane, model.algebraic, w, None, 1.0)
    for k in range(n):
        if kept is not None:
            w.a0[k] = w.a[k]
        w.a[k] -= w.r[k]
        w.b[k] -= w.r[k]
