"""Newmark and generalized-alpha with Newton-Raphson, eqs. [66]-[82], for every formulation and lane count.

    (1 - alpha_m) b+ + alpha_m b = (1 - alpha_f) a+ + alpha_f a          auxiliary acceleration b (Arnold & Bruels 2007)
    q+ = q + h v + h^2 ((1/2 - beta) b + beta b+),   v+ = v + h ((1 - gamma) b + gamma b+)

With alpha_m = alpha_f = 0 (or rho = 1 and b = a at the start) this is the paper's Newmark. A step is a
pure function of its start; the arms of a lane group that have converged are left untouched while the
others go on, so a batch and a single arm give the same bits.
"""

from __future__ import annotations

from ...compiler import apart, arms, inlined, kernel, largest, load, select_lt, size, splat, store
from ..layout import HALVINGS, STEPS
from ..model import NEWTON_FAILED
from ..protocol import (
    MASS_ALONE,
    RESIDUAL_ALONE,
    assemble,
    conserve,
    constrain,
    difference,
    out_of_range,
    predict,
    rotates,
    settle,
    update,
)
from .books import keep_books, open_books
from .drive import set_inputs, set_motions
from .newton import follow, newton, slopes_of
from .work import copy_rows, note_reactions, open_shift, set_known, solve_known, state_of, unpack


@kernel
def _share(predictor):
    """Share of the last acceleration to start from."""
    if predictor is None:
        return 0.0
    if isinstance(predictor, tuple):
        return predictor[0]
    return predictor


@inlined
def foresee(lane, model, w, h, scheme):
    """Where Newton starts, eqs. [66]-[68]: q+, v+, b+ of an acceleration a+; q, v, a, b are kept in q0, v0, a0, b0."""
    am, af, beta, gamma = scheme.alpha_m, scheme.alpha_f, scheme.beta, scheme.gamma
    n, share = size(model.n), _share(model.predictor)
    for k in range(n):
        v, a, b = load(lane, w.v, k), load(lane, w.a, k), load(lane, w.b, k)
        store(w.q0, k, load(lane, w.q, k))
        store(w.v0, k, v)
        store(w.a0, k, a)
        store(w.b0, k, b)
        new_a = a * share
        new_b = (new_a * (1.0 - af) + a * af - b * am) * (1.0 / (1.0 - am))
        store(w.v, k, v + (b * (1.0 - gamma) + new_b * gamma) * h)
        store(w.a, k, new_a)
        store(w.b, k, new_b)
        store(w.r, k, (b * (0.5 - beta) + new_b * beta) * (h * h))
    update(lane, model, w.q, h, w.v0, w.r)


@kernel
def _stay(lane, model, w, slopes):
    """Start Newton from where the step began, in place of the prediction: after a load has jumped, accelerations that
    the step does not resolve may throw the prediction so far that Newton does not come back from there."""
    difference(lane, model, w.q, w.q0, w.r)
    for k in range(size(model.n)):
        store(w.q, k, load(lane, w.q0, k))
        follow(lane, w, k, load(lane, w.r, k), slopes)


@kernel
def _guess(lane, model, par, predictor, w, slopes):
    """Start of Newton where the formulation knows better (predictor None)."""
    if predictor is None:
        copy_rows(lane, size(model.n), w.q, w.r)
        predict(lane, model, w.q0, w.r)
        for k in range(size(model.n)):
            q = load(lane, w.r, k)
            d = q - load(lane, w.q, k)
            store(w.q, k, q)
            follow(lane, w, k, d, slopes)
            if rotates(model) is not None:
                store(w.shift, k, d)
        settle(lane, model, par, (0,), w, splat(lane, 1.0), slopes)


@kernel
def _prescribe(lane, drive, w, t, h):
    """Inputs and motions at the end t of a step of h; where they jump there, as they were before."""
    if drive is not None:
        before = t - 1e-6 * h
        set_inputs(lane, drive, w.u, t, before)
        set_motions(lane, drive, w.psi, t, before)
        set_known(lane, drive.known, w.psi, w.q, w.v, w.a, w.b)


@inlined
def _settle(lane, model, drive, par, algebraic, w):
    """Take what a step left across the constraints out of velocities, then out of accelerations (theory, section 6).

    Constraints hold for positions alone, so that the velocity across them is off by O(h^2) and the acceleration by
    O(h); at rho_inf = 1 both would alternate and grow. M dv + Phi_q^T Lambda = 0 and M da + Phi_q^T dlambda = 0 set
    them right; b keeps its distance from a. What dv changes in the other forces stays out of da: stiff damping of it,
    which the step does not resolve, would be taken explicitly and blow up.
    """
    if algebraic is not None:
        if algebraic.shape[0] == 0:
            return
        assemble(lane, model, par, state_of(w), w.u, MASS_ALONE, w.r, w.S)
        _across(lane, model, drive, w, 1)
        for i in range(algebraic.shape[0]):
            store(w.r, algebraic[i], splat(lane, 0.0))
        for k in range(size(model.n)):
            store(w.v, k, load(lane, w.v, k) - load(lane, w.r, k))
        _across(lane, model, drive, w, 2)
        for i in range(algebraic.shape[0]):
            k = algebraic[i]
            store(w.q, k, load(lane, w.q, k) - load(lane, w.r, k))
            store(w.r, k, splat(lane, 0.0))
        for k in range(size(model.n)):
            store(w.a, k, load(lane, w.a, k) - load(lane, w.r, k))
            store(w.b, k, load(lane, w.b, k) - load(lane, w.r, k))


@kernel
def _across(lane, model, drive, w, level):
    """r <- what constraint forces alone have to take away for the velocities (level 1) or accelerations (2) to keep to
    the constraints; S: M and Phi_q, factored here for level 1."""
    for k in range(size(model.n)):
        store(w.r, k, splat(lane, 0.0))
    constrain(lane, model, w.psi, state_of(w), level, 1.0, w.r)
    solve_known(lane, model, drive, w, level == 1)


@inlined
def _react(lane, model, drive, par, w):
    """Forces that hold the prescribed coordinates at the step's end, where there are any."""
    if drive is not None and drive.known.shape[0] > 0:
        assemble(lane, model, par, state_of(w), w.u, RESIDUAL_ALONE, w.r, w.S)
        note_reactions(lane, drive.known, model.algebraic, w.r, w.q, w.reaction)


@kernel
def _go_back(lane, model, w):
    """To where the step began."""
    n = size(model.n)
    copy_rows(lane, n, w.q0, w.q)
    copy_rows(lane, n, w.v0, w.v)
    copy_rows(lane, n, w.a0, w.a)
    copy_rows(lane, n, w.b0, w.b)


@apart
def advance(lane, model, drive, par, flat, n_motions, t, h, n_steps, scheme, books):
    """n_steps steps of size h from t within a smooth stretch; returns the time reached (SINGLE) or meant (lanes).

    A single arm retries a step whose Newton fails, from another start and then in halves, and stops at the last good
    state. In lanes a failed arm is flagged and its neighbours go on; the caller repeats it alone from where the stretch
    began. `books`: a tag, (0,), where work and dissipation are kept account of; None: compiled out.
    """
    w = unpack(lane, model, flat, n_motions)
    return advance_within(lane, model, drive, par, w, t, h, n_steps, scheme, books)


@inlined
def advance_within(lane, model, drive, par, w, t, h, n_steps, scheme, books):
    """`advance` of a work array that has been unpacked."""
    if books is not None:
        open_books(lane, model, drive, par, w)
    moving = conserve(lane, model, par, None, h, w.q, w.v, w.u, w.r, w.S)
    done, left, part, again = 0, h, h, False  # of the step under way: what is left, the part tried now, once more
    while done < n_steps:
        start = t + done * h + (h - left)
        slopes = slopes_of(scheme, part)
        foresee(lane, model, w, part, scheme)
        if arms(lane) == 1 and again:
            _stay(lane, model, w, slopes)
        _prescribe(lane, drive, w, start + part, part)
        open_shift(lane, model, w)
        _guess(lane, model, par, model.predictor, w, slopes)
        active = newton(lane, model, drive, par, w, slopes, scheme, again)
        _settle(lane, model, drive, par, model.algebraic, w)
        _react(lane, model, drive, par, w)
        flag = select_lt(0.5, active, splat(lane, float(NEWTON_FAILED)), load(lane, w.flag, 0))
        if arms(lane) == 1 and largest(flag) > 0.5:
            _go_back(lane, model, w)
            if again:
                part *= 0.5
                w.counts[HALVINGS] += 1.0
            again = True
            if part < h * 0.5**scheme.max_halvings:
                store(w.flag, 0, flag)
                return start
            continue
        w.counts[STEPS] += 1.0
        if books is not None:
            keep_books(lane, model, drive, par, w, part)
        moving = conserve(lane, model, par, moving, part, w.q, w.v, w.u, w.r, w.S)
        flag = select_lt(flag, 0.5, out_of_range(lane, model, par, w.q), flag)
        store(w.flag, 0, flag)
        if arms(lane) == 1 and largest(flag) > 0.5:
            return start + part
        left -= part
        if left <= 1e-9 * h:
            done += 1
            left, part, again = h, h, False
        else:
            part = min(part, left)
    return t + n_steps * h
