"""Newmark and generalized-alpha steps, equations [66]-[82] and (6.1), for every formulation and number of lanes.

    (1 - alpha_m) b+ + alpha_m b = (1 - alpha_f) a+ + alpha_f a          auxiliary acceleration b (Arnold & Bruels 2007)
    q+ = q + h v + h^2 ((1/2 - beta) b + beta b+),   v+ = v + h ((1 - gamma) b + gamma b+)

With alpha_m = alpha_f = 0 (or rho = 1 and b = a at the start) this is the paper's Newmark method. The end of a step
depends only on the state and inputs at its start. In lanes, the state of an arm whose iteration has converged does not
change while other arms iterate. A batch and a single arm therefore give the same bits.
"""

from __future__ import annotations

from ...compiler import inlined, kernel, lane_count, max_over_lanes, noinline, select_lt, size
from ..contact.integration import record_contacts
from ..contact.moving import move_obstacles
from ..layout import HALVINGS, STEPS
from ..model import NEWTON_FAILED, OK
from ..protocol import (
    MASS_ALONE,
    STEP_END_ALONE,
    assemble,
    conserve_momentum,
    constraint_residual,
    correct_positions,
    local_difference,
    out_of_range,
    retract,
)
from .balance import refuse_step
from .drive import set_inputs, set_motions
from .energy_account import account_for_step, start_energy_account
from .newton import follow_displacement, newmark_slopes, newton
from .work import Work, copy_rows, reset_shift, set_prescribed, solve_unknown_rows, state_of, store_reactions, unpack


@inlined
def newmark_predict(lane, model, w: Work, h, scheme):
    """Predict q, v, a and b at the end of a step of h (s), equations [66]-[68], where the Newton iteration starts.

    The acceleration is predicted as a+ = s a with s = `NewtonPolicy.acceleration_share`. s = 1 predicts a constant
    acceleration, s = 0 zero acceleration. b is the auxiliary acceleration: (1 - alpha_m) b+ + alpha_m b = (1 - alpha_f)
    a+ + alpha_f a.

    # model     model. scheme: `Scheme`, the coefficients of the method
    # state     w.q, w.v, w.a, w.b: state at the start of the step, replaced by the prediction at the step's end
    # scratch   w.r
    # out       w.q0, w.v0, w.a0, w.b0: values at the start of the step, from which a failed step restarts
    """
    am, af, beta, gamma = scheme.alpha_m, scheme.alpha_f, scheme.beta, scheme.gamma
    n, share = size(model.n), model.newton.acceleration_share
    for k in range(n):
        v, a, b = w.v[k], w.a[k], w.b[k]
        w.q0[k] = w.q[k]
        w.v0[k] = v
        w.a0[k] = a
        w.b0[k] = b
        # auxiliary acceleration: (1 - alpha_m) b+ + alpha_m b = (1 - alpha_f) a+ + alpha_f a
        new_a = a * share
        new_b = (new_a * (1.0 - af) + a * af - b * am) * (1.0 / (1.0 - am))
        # v+ = v + h ((1 - gamma) b + gamma b+); the h^2 term of q+ goes to w.r
        w.v[k] = v + (b * (1.0 - gamma) + new_b * gamma) * h
        w.a[k] = new_a
        w.b[k] = new_b
        w.r[k] = (b * (0.5 - beta) + new_b * beta) * (h * h)
    # q+ = q (+) (h v + w.r): rotations are composed, not added
    retract(lane, model, w.q, h, w.v0, w.r)


@kernel
def _restart_from_step_start(lane, model, w: Work, slopes):
    """Start the Newton iteration at the step's initial q instead of the prediction; v, a, b follow q by `slopes`.

    After a jump of a load, the step may not resolve the accelerations. The prediction's error may then be too large for
    the iteration to converge.
    slopes (`NewmarkSlopes`): derivatives of v+, a+, b+ by q+, equation (6.1).

    # state     w.q, w.v, w.a, w.b: in, prediction; out, the values that belong to q+ = w.q0
    # scratch   w.r
    """
    local_difference(lane, model, w.q, w.q0, w.r)
    for k in range(size(model.n)):
        w.q[k] = w.q0[k]
        follow_displacement(lane, w, k, w.r[k], slopes)


@kernel
def _predict_configuration(lane, model, par, w: Work, slopes):
    """Improve the predicted q by the formulation's own prediction, if `NewtonPolicy.predicts` is a tag.

    slopes (`NewmarkSlopes`): derivatives of v, a and b by q.

    # state     w.q, w.v, w.a, w.b: in and out, prediction at the end of the step; w.q0: its start
    # scratch   w.r
    """
    if model.newton.predicts is not None:
        correct_positions(lane, model, par, w, 1.0, slopes, (0,))


@kernel
def _prescribe(lane, model, drive, w, t, h):
    """Set inputs w.u, motions w.psi and prescribed rows of q, v, a, b to their values at the end t (s) of a step.

    If a time function jumps at t, the value before the jump is used: 1e-6 of the step's length h (s) earlier.
    drive: the scene's loads and motions over time (`Drive`). If it is None (no loads or motions in time), only moving
    obstacles of an environment change.
    """
    move_obstacles(lane, model, w, h)
    if drive is not None:
        before = t - 1e-6 * h
        set_inputs(lane, drive, w.u, t, before)
        set_motions(lane, drive, w.psi, t, before)
        set_prescribed(lane, drive.known, w.psi, w.q, w.v, w.a, w.b)


@inlined
def _project_onto_constraints(lane, model, drive, par, algebraic, w: Work):
    """Remove from velocities and accelerations the parts that violate derivatives of constraints, equation (6.3).

        M dv + Phi_q^T Lambda = 0, Phi_q dv = -dPhi/dt;    M da + Phi_q^T dlambda = 0, Phi_q da = -d2Phi/dt2;    db = da

    Phi = 0: constraints.
    lambda: multipliers of the constraints, which are forces.
    Lambda: impulses. The step satisfies the constraints at the level of positions. Velocities violate the constraints'
    time derivative by O(h^2), accelerations by O(h). At rho_inf = 1 both errors would alternate and grow. The equation
    of da neglects the change of other forces by dv. Otherwise stiff damping, which the step does not resolve, would act
    explicitly and be unstable.

    # state     w.v, w.a, w.b and the multipliers in w.q: in and out, at the end of the step
    # scratch   w.r, w.S.   algebraic: rows of the multipliers; None: nothing to do
    """
    if algebraic is not None:
        if algebraic.shape[0] == 0:
            return
        # velocities: one factorization of [M, Phi_q^T; Phi_q, 0] for both solves; Lambda is not kept
        assemble(lane, model, par, state_of(w), w.u, MASS_ALONE, w.r, w.S)
        _constraint_rate_residual(lane, model, drive, w, 1)
        for i in range(algebraic.shape[0]):
            w.r[algebraic[i]] = 0.0
        for k in range(size(model.n)):
            w.v[k] -= w.r[k]
        # accelerations, and multipliers lambda by dlambda
        _constraint_rate_residual(lane, model, drive, w, 2)
        for i in range(algebraic.shape[0]):
            k = algebraic[i]
            w.q[k] -= w.r[k]
            w.r[k] = 0.0
        for k in range(size(model.n)):
            w.a[k] -= w.r[k]
            w.b[k] -= w.r[k]


@kernel
def _constraint_rate_residual(lane, model, drive, w: Work, level):
    """Solve for the part of velocity (level 1) or acceleration (2) that violates the constraints; store it in w.r.

    Rows of multipliers of w.r contain the impulses Lambda or forces -dlambda. w.S: on entry the matrix of M and Phi_q
    for level 1, which is factored here; its factors for level 2.
    """
    for k in range(size(model.n)):
        w.r[k] = 0.0
    constraint_residual(lane, model, w.psi, state_of(w), level, 1.0, w.r)
    solve_unknown_rows(lane, model, drive, w, level == 1)


@inlined
def _compute_reactions(lane, model, drive, par, w):
    """Store in w.reaction the generalized forces (N, N m) that enforce the prescribed motions at the end of the step.

    The forces are the rows of the residual r of equation [64] at the prescribed coordinates, or the multipliers that
    prescribe them. Without motions, or if drive is None, do nothing.
    drive: the scene's loads and motions over time (`Drive`).
    algebraic: rows of the multipliers, or None without multipliers.
    Scratch memory: w.r, w.S.
    """
    if drive is not None and drive.known.shape[0] > 0:
        assemble(lane, model, par, state_of(w), w.u, STEP_END_ALONE, w.r, w.S)
        store_reactions(lane, drive.known, model.algebraic, w.r, w.q, w.reaction)


@kernel
def _restore_step_start(lane, model, w):
    """Restore q, v, a and b to their values at the start of the step (w.q0, w.v0, w.a0, w.b0)."""
    n = size(model.n)
    copy_rows(lane, n, w.q0, w.q)
    copy_rows(lane, n, w.v0, w.v)
    copy_rows(lane, n, w.a0, w.a)
    copy_rows(lane, n, w.b0, w.b)


@noinline
def advance(lane, model, drive, par, flat, n_motions, t, h, n_steps, scheme, books):
    """Integrate n_steps steps of h (s) from time t (s) on, between two kinks; return the reached time, s.

    If Newton's iteration fails for a single arm, the step is repeated without prediction, then halved. If this fails
    too, the integration stops at the last good state with w.flag set. A step that is rejected for its energy
    (`balance`) is halved at once. In lanes a failed arm is flagged while the other arms continue, and the intended end
    time is returned. The caller repeats the failed arm alone from time t.

    # model     model. drive: `Drive`, or None without loads and motions in time. par: the arm's parameters; scheme
    # state     flat: the work array, `Work`. n_motions: number of prescribed coordinates

    books: a tag, (0,), to add work and dissipation to the energy account w.books; None for no account.
    """
    w = unpack(lane, model, flat, n_motions)
    return advance_within(lane, model, drive, par, w, t, h, n_steps, scheme, books)


@inlined
def advance_within(lane, model, drive, par, w: Work, t, h, n_steps, scheme, books):
    """Integrate n_steps steps of h (s) from time t on, with the unpacked work array w; return the reached time, s.

    If a step of a single arm fails, the step is repeated without prediction, then halved. If this fails too, the
    integration stops at the last good state with w.flag set. In lanes a failed arm is flagged while the other arms
    continue, and t + n_steps h is returned.

    # model     model. drive: `Drive`, or None without loads and motions in time. par: the arm's parameters; `Scheme`
    # state     w.q, w.v, w.a, w.b and the other fields of w, first at t, then at the time reached

    books: a tag, (0,), to add work and dissipation to the energy account w.books; None for no account. See
    docs/theory.md, (6.1).
    """
    if books is not None:
        start_energy_account(lane, model, drive, par, w)
    # momentum and force at the start, of arms that no support holds; None otherwise
    moving = conserve_momentum(lane, model, par, None, h, w.q, w.v, w.u, w.r, w.S)
    # time left of the step (s), length tried now (s), and whether this length was tried once already
    done, left, part, again = 0, h, h, False
    while done < n_steps:
        start = t + done * h + (h - left)
        # q+, v+, a+, b+ predicted by (6.1) with s a for a+
        slopes = newmark_slopes(scheme, part)
        newmark_predict(lane, model, w, part, scheme)
        if lane_count(lane) == 1 and again:
            _restart_from_step_start(lane, model, w, slopes)
        _prescribe(lane, model, drive, w, start + part, part)
        reset_shift(lane, model, w)
        _predict_configuration(lane, model, par, w, slopes)
        # Newton (6.1), projection (6.3), reactions, and the energy test that refuses wrong roots
        active = newton(lane, model, drive, par, w, slopes, scheme, again)
        _project_onto_constraints(lane, model, drive, par, model.algebraic, w)
        _compute_reactions(lane, model, drive, par, w)
        refused = refuse_step(lane, model, drive, par, w, active, part)
        flag = select_lt(0.5, active, float(NEWTON_FAILED), w.flag[0])
        # one arm, failed: second try from another start, then halves down to h / 2^max_halvings
        if lane_count(lane) == 1 and max_over_lanes(flag) > 0.5:
            _restore_step_start(lane, model, w)
            if again or refused:
                part *= 0.5
                w.counts[HALVINGS] += 1.0
            again = not refused
            if refused:
                w.flag[0] = float(OK)
            least = h
            for _ in range(scheme.max_halvings):
                least *= 0.5
            if part < least:
                w.flag[0] = flag
                return start
            continue
        # accepted: W and D of the step, momentum before + h/2 (F_0 + F_1), and the range of modes
        w.counts[STEPS] += 1.0
        if books is not None:
            account_for_step(lane, model, drive, par, w, part)
        moving = conserve_momentum(lane, model, par, moving, part, w.q, w.v, w.u, w.r, w.S)
        record_contacts(lane, model, par, w.q, w.v, w.S, part)
        flag = select_lt(flag, 0.5, out_of_range(lane, model, par, w.q), flag)
        w.flag[0] = flag
        if lane_count(lane) == 1 and max_over_lanes(flag) > 0.5:
            return start + part
        # 1e-9: sums of halves may miss h by round-off
        left -= part
        if left <= 1e-9 * h:
            done += 1
            left, part, again = h, h, False
        else:
            part = min(part, left)
    return t + n_steps * h
