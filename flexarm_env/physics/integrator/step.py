"""Newmark and generalized-alpha with Newton-Raphson, eqs. [66]-[82], for every formulation and lane count.

    (1 - alpha_m) b+ + alpha_m b = (1 - alpha_f) a+ + alpha_f a          auxiliary acceleration b (Arnold & Bruels 2007)
    q+ = q + h v + h^2 ((1/2 - beta) b + beta b+),   v+ = v + h ((1 - gamma) b + gamma b+)

With alpha_m = alpha_f = 0 (or rho = 1 and b = a at the start) this is the paper's Newmark. A step is a
pure function of its start; the arms of a lane group that have converged are left untouched while the
others go on, so a batch and a single arm give the same bits.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...compiler.arrays import bare
from ...compiler.decorator import kernel
from ...compiler.dispatch import NONE, NUMBER, TUPLE, by_kind, size
from ...compiler.lanes import absolute, largest, load, maximum, select_lt, splat, store
from ..model import NEWTON_FAILED
from ..protocol import assemble, constrain, dissipation, factor, out_of_range, ports, predict, solve
from .drive import set_inputs, set_motions
from .period import correct_period
from .work import note_reactions, set_known, take_out_known, unpack


@kernel
def _first(predictor):  # type: ignore[no-untyped-def]
    return predictor[0]


@kernel
def _second(predictor):  # type: ignore[no-untyped-def]
    return predictor[1]


@kernel
def _itself(predictor):  # type: ignore[no-untyped-def]
    return predictor


@kernel
def _zero(predictor):  # type: ignore[no-untyped-def]
    return 0.0


@kernel
def _ten(predictor):  # type: ignore[no-untyped-def]
    return 10.0


@by_kind("predictor", "predictor")
def _share(kind: str) -> Any:
    """Share of the last acceleration to start from."""
    return {TUPLE: _first, NONE: _zero, NUMBER: _itself}[kind]


@by_kind("predictor", "predictor")
def _trust(kind: str) -> Any:
    """How many times its square the first increment leaves as error; 0: not known."""
    return {TUPLE: _second, NONE: _ten, NUMBER: _zero}[kind]


@kernel
def _guess(lane, model, n, predictor, w, c_b, c_v, c_m):  # type: ignore[no-untyped-def]
    """Start of Newton where the formulation knows better (predictor None); v, a, b follow q as in `_correct`."""
    if predictor is None:
        for k in range(n):
            store(w.r, k, load(lane, w.q, k))
        predict(lane, model, w.q0, w.r)
        for k in range(n):
            q = load(lane, w.r, k)
            d = q - load(lane, w.q, k)
            store(w.q, k, q)
            store(w.v, k, load(lane, w.v, k) + d * c_v)
            store(w.a, k, load(lane, w.a, k) + d * c_m)
            store(w.b, k, load(lane, w.b, k) + d * c_b)


@kernel
def _first_contraction(lane, trust, increment):  # type: ignore[no-untyped-def]
    """Contraction to expect of the first iteration, which has seen none: 1/2, so that its increment itself is the error
    left, or `trust` times the increment where the error left is known to be quadratic."""
    if trust > 0.0:
        return select_lt(increment, 0.05, increment * trust, splat(lane, 0.5))
    return splat(lane, 0.5)


@kernel
def _predict(lane, n, flat, predictor, h, scheme):  # type: ignore[no-untyped-def]
    """Start of Newton, eqs. [66]-[68]; q, v, a, b are kept in q0, v0, a0, b0 (rows of `flat`, see `unpack`)."""
    am, af, beta, gamma = scheme.alpha_m, scheme.alpha_f, scheme.beta, scheme.gamma
    share = _share(predictor)
    for k in range(n):
        q, v, a, b = (
            load(lane, flat, k),
            load(lane, flat, n + k),
            load(lane, flat, 2 * n + k),
            load(lane, flat, 3 * n + k),
        )
        store(flat, 4 * n + k, q)
        store(flat, 5 * n + k, v)
        store(flat, 6 * n + k, a)
        store(flat, 7 * n + k, b)
        new_a = a * share
        new_b = (new_a * (1.0 - af) + a * af - b * am) * (1.0 / (1.0 - am))
        store(flat, k, q + v * h + (b * (0.5 - beta) + new_b * beta) * (h * h))
        store(flat, n + k, v + (b * (1.0 - gamma) + new_b * gamma) * h)
        store(flat, 2 * n + k, new_a)
        store(flat, 3 * n + k, new_b)


@kernel
def _stay(lane, n, flat, c_b, c_v, c_m):  # type: ignore[no-untyped-def]
    """Start Newton from where the step began, in place of the prediction: after a load has jumped, accelerations that
    the step does not resolve may throw the prediction so far that Newton does not come back from there."""
    for k in range(n):
        d = load(lane, flat, 4 * n + k) - load(lane, flat, k)
        store(flat, k, load(lane, flat, 4 * n + k))
        store(flat, n + k, load(lane, flat, n + k) + d * c_v)
        store(flat, 2 * n + k, load(lane, flat, 2 * n + k) + d * c_m)
        store(flat, 3 * n + k, load(lane, flat, 3 * n + k) + d * c_b)


@kernel
def _moved(lane, correction, shift, k, d, q):  # type: ignore[no-untyped-def]
    """q + d and, where the period is corrected, the shift of the displacement; and the larger of the two increments."""
    if correction is None:
        return q + d, absolute(d)
    moved = d + load(lane, shift, k)
    return q + moved, maximum(absolute(moved), absolute(d))


@kernel
def _correct(lane, n, flat, algebraic, correction, shift, weight, active, c_b, c_v, c_m):  # type: ignore[no-untyped-def]
    """Apply the Newton increment -r where `active`, eqs. [80]-[82]; return its weighted size, NaN if not finite.

    Multipliers do not count towards convergence: they have the scale of a force.
    """
    if algebraic is not None:
        for i in range(algebraic.shape[0]):
            k = algebraic[i]
            flat[k] = select_lt(0.5, active, flat[k] - c_m * flat[8 * n + k], flat[k])
            flat[8 * n + k] = 0.0
    size_of = splat(lane, 0.0)
    for k in range(n):
        d = -load(lane, flat, 8 * n + k)
        q, v = load(lane, flat, k), load(lane, flat, n + k)
        new_q, increment = _moved(lane, correction, shift, k, d, q)
        size_of = maximum(increment * weight[k], size_of)
        size_of = select_lt(increment, np.inf, size_of, splat(lane, np.nan))
        a, b = load(lane, flat, 2 * n + k), load(lane, flat, 3 * n + k)
        store(flat, k, select_lt(0.5, active, new_q, q))
        store(flat, n + k, select_lt(0.5, active, v + d * c_v, v))
        store(flat, 2 * n + k, select_lt(0.5, active, a + d * c_m, a))
        store(flat, 3 * n + k, select_lt(0.5, active, b + d * c_b, b))
    return size_of


@kernel
def _open_books(lane, model, drive, par, w):  # type: ignore[no-untyped-def]
    """Remember ports and forces at the start of a smooth stretch."""
    for i in range(w.u.shape[0]):
        w.u0[i] = w.u[i]
    ports(lane, model, par, w.q, w.y0)
    if drive is not None:
        for i in range(w.psi.shape[0]):
            w.psi0[i] = w.psi[i]
        for i in range(w.reaction.shape[0]):
            w.reaction0[i] = w.reaction[i]


@kernel
def _keep_books(lane, model, drive, par, w, h):  # type: ignore[no-untyped-def]
    """Add the step's work and dissipation: mean force times displacement, what Newmark itself does.

    Of damping, force times displacement x is h/4 of the difference of the powers of v + x/h and v - x/h. At the middle
    of a step that turns a stiff section by a large angle there are strain rates that it has at neither end. q0, v0, a0
    and r are free once the step has succeeded.
    """
    ports(lane, model, par, w.q, w.y)
    work = load(lane, w.books, 0)
    for i in range(size(model.n_inputs)):
        force = (load(lane, w.u0, i) + load(lane, w.u, i)) * 0.5
        work = work + force * (load(lane, w.y, i) - load(lane, w.y0, i))
        store(w.u0, i, load(lane, w.u, i))
        store(w.y0, i, load(lane, w.y, i))
    if drive is not None:
        for i in range(drive.known.shape[0]):
            work += 0.5 * (w.reaction0[i] + w.reaction[i]) * (w.psi[3 * i] - w.psi0[3 * i])
            w.reaction0[i] = w.reaction[i]
        for i in range(w.psi.shape[0]):
            w.psi0[i] = w.psi[i]
    store(w.books, 0, work)
    n, lost = size(model.n), load(lane, w.books, 1)
    for k in range(n):
        x, v = (load(lane, w.q, k) - load(lane, w.q0, k)) * (1.0 / h), load(lane, w.v0, k)
        store(w.r, k, x)
        store(w.v0, k, v - x)
        store(w.a0, k, v + x)
    lost = lost + (dissipation(lane, model, par, w.q0, w.a0) - dissipation(lane, model, par, w.q0, w.v0)) * (0.125 * h)
    for k in range(n):
        x, v = load(lane, w.r, k), load(lane, w.v, k)
        store(w.v0, k, v - x)
        store(w.a0, k, v + x)
    lost = lost + (dissipation(lane, model, par, w.q, w.a0) - dissipation(lane, model, par, w.q, w.v0)) * (0.125 * h)
    store(w.books, 1, lost)


NEWTON, VELOCITIES, ACCELERATIONS, CLOSE = range(4)
"""Stages of a step: the iteration; with multipliers, velocities and accelerations across the constraints; a driven arm
closes with one residual, for its reactions."""


@kernel
def _after_newton(algebraic):  # type: ignore[no-untyped-def]
    if algebraic is None:
        return CLOSE
    return VELOCITIES if algebraic.shape[0] > 0 else CLOSE


@kernel
def _constrain(lane, model, algebraic, w, stage, c_m):  # type: ignore[no-untyped-def]
    """Constraint rows of a stage: of positions, of velocities and of accelerations (by constraint forces alone)."""
    if algebraic is not None:
        if stage != NEWTON:
            for k in range(size(model.n)):
                w.r[k] = 0.0
        constrain(lane, model, w.psi, w.q, w.v, w.a, stage, c_m if stage == NEWTON else 1.0, w.r)


@kernel
def _settle(algebraic, w, stage):  # type: ignore[no-untyped-def]
    """Take what a step left across the constraints out of velocities, then out of accelerations (theory, section 6).

    Constraints hold for positions alone, so that the velocity across them is off by O(h^2) and the acceleration by
    O(h); at rho_inf = 1 both would alternate and grow. M dv + Phi_q^T Lambda = 0 and M da + Phi_q^T dlambda = 0 set
    them right; b keeps its distance from a. What dv changes in the other forces stays out of da: stiff damping of it,
    which the step does not resolve, would be taken explicitly and blow up.
    """
    if algebraic is not None:
        for i in range(algebraic.shape[0]):
            k = algebraic[i]
            if stage == ACCELERATIONS:
                w.q[k] -= w.r[k]
            w.r[k] = 0.0
        for k in range(w.r.shape[0]):
            if stage == VELOCITIES:
                w.v[k] -= w.r[k]
            else:
                w.a[k] -= w.r[k]
                w.b[k] -= w.r[k]


@kernel
def advance(lane, model, drive, par, flat, n_motions, t, h, n_steps, scheme, books):  # type: ignore[no-untyped-def]
    """n_steps steps of size h from t within a smooth stretch; returns the time reached (SINGLE) or meant (lanes).

    A single arm retries a step whose Newton fails, from another start and then in halves, and stops at the last good
    state. In lanes a failed arm is flagged and its neighbours go on; the caller repeats it alone from where the stretch
    began. `books`: a tag, (0,), where work and dissipation are kept account of; None: compiled out.
    """
    flat = bare(flat)
    w = unpack(lane, model, flat, n_motions)
    return advance_bare(lane, bare(model), drive, bare(par), flat, w, t, h, n_steps, scheme, books)


@kernel
def advance_bare(lane, model, drive, par, flat, w, t, h, n_steps, scheme, books):  # type: ignore[no-untyped-def]
    """`advance` on bare arrays."""
    n = size(model.n)
    if books is not None:
        _open_books(lane, model, drive, par, w)
    done, left, piece, failed = 0, h, h, False
    while done < n_steps:
        start = t + done * h + (h - left)
        c_b = 1.0 / (scheme.beta * piece * piece)
        c_v = scheme.gamma / (scheme.beta * piece)
        c_m = c_b * (1.0 - scheme.alpha_m) / (1.0 - scheme.alpha_f)
        _predict(lane, n, flat, model.predictor, piece, scheme)
        if len(lane) == 1:
            if failed:
                _stay(lane, n, flat, c_b, c_v, c_m)
        if drive is not None:
            finish = start + piece
            set_inputs(drive, w.u, finish, finish - 1e-6 * piece)
            set_motions(drive, w.psi, finish, finish - 1e-6 * piece)
            set_known(drive.known, w.psi, w.q, w.v, w.a, w.b)
        _guess(lane, model, n, model.predictor, w, c_b, c_v, c_m)
        active = select_lt(load(lane, w.flag, 0), 0.5, splat(lane, 1.0), splat(lane, 0.0))
        before, corrected = splat(lane, 1e300), splat(lane, 1.0 if failed else 0.0)  # retried steps are plain
        iteration, stage = 0, NEWTON
        while True:  # Newton-Raphson, eqs. [69]-[82], and what follows once it has converged
            fresh = iteration == 0 if stage == NEWTON else stage == VELOCITIES
            if scheme.modified is None:
                fresh = fresh or stage == NEWTON
            c_a, use = c_m if stage == NEWTON else 1.0, 1.0 if stage == NEWTON else 0.0
            if not fresh:
                c_a, use = 0.0, 0.0
            if stage != ACCELERATIONS:
                assemble(lane, model, par, w.q, w.v, w.a, w.u, c_a, use * c_v, use, w.r, w.S)
            if stage == CLOSE:
                if drive is not None:
                    note_reactions(drive.known, model.algebraic, w.r, w.q, w.reaction)
                break
            _constrain(lane, model, model.algebraic, w, stage, c_m)
            take_out_known(lane, model, drive, w.r, w.S, fresh)
            if fresh:
                factor(lane, model, w.S)
                w.counts[1] += 1.0
            solve(lane, model, w.S, w.r)
            if stage != NEWTON:
                _settle(model.algebraic, w, stage)
                stage += 1
                if drive is None:
                    if stage == CLOSE:
                        break
                continue
            corrected = correct_period(
                lane, model, drive, par, model.correction, scheme.tolerance, w, corrected, active, c_v, c_m, piece
            )
            increment = _correct(
                lane, n, flat, model.algebraic, model.correction, w.shift, model.weight, active, c_b, c_v, c_m
            )  # fmt: skip
            w.counts[0] += 1.0
            # What is left after this update, from the contraction seen: increment * theta / (1 - theta).
            theta = select_lt(increment, before * 0.9, increment / before, splat(lane, 0.9))
            if iteration == 0:
                theta = _first_contraction(lane, _trust(model.predictor), increment)
            active = select_lt(increment * theta / (1.0 - theta), scheme.tolerance, splat(lane, 0.0), active)
            before = increment
            iteration += 1
            if largest(active) < 0.5 or iteration == scheme.max_iterations:
                stage = _after_newton(model.algebraic)
                if drive is None:
                    if stage == CLOSE:
                        break
        flag = load(lane, w.flag, 0)
        flag = select_lt(0.5, active, splat(lane, float(NEWTON_FAILED)), flag)
        if len(lane) == 1:
            if largest(flag) > 0.5:
                for k in range(4 * n):
                    flat[k] = flat[4 * n + k]
                if failed:
                    piece *= 0.5
                    w.counts[2] += 1.0
                failed = True
                if piece < h * 0.5**scheme.max_halvings:
                    store(w.flag, 0, flag)
                    return start
                continue
        w.counts[3] += 1.0
        if books is not None:
            _keep_books(lane, model, drive, par, w, piece)
        code = out_of_range(lane, model, par, w.q)
        flag = select_lt(flag, 0.5, code, flag)
        store(w.flag, 0, flag)
        if len(lane) == 1:
            if largest(flag) > 0.5:
                return start + piece
        left -= piece
        if left <= 1e-9 * h:
            done += 1
            left, piece, failed = h, h, False
        else:
            piece = min(piece, left)
    return t + n_steps * h
