"""Newmark and generalized-alpha with Newton-Raphson, eqs. [66]-[82], for every formulation and lane count.

    (1 - alpha_m) b+ + alpha_m b = (1 - alpha_f) a+ + alpha_f a          auxiliary acceleration b (Arnold & Bruels 2007)
    q+ = q + h v + h^2 ((1/2 - beta) b + beta b+),   v+ = v + h ((1 - gamma) b + gamma b+)

With alpha_m = alpha_f = 0 (or rho = 1 and b = a at the start) this is the paper's Newmark. A step is a
pure function of its start; the arms of a lane group that have converged are left untouched while the
others go on, so a batch and a single arm give the same bits.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..model import NEWTON_FAILED, OK
from .drive import set_inputs, set_motions
from .jit import kernel
from .lanes import absolute, largest, load, maximum, select_lt, splat, store
from .protocol import assemble, constrain, dissipation, factor, out_of_range, pin, ports, size, solve

class Work(NamedTuple):
    """Views of one flat float64 array; n rows, L lanes. q v a b: state; *0: state at the step's start."""

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    b: np.ndarray
    q0: np.ndarray
    v0: np.ndarray
    a0: np.ndarray
    b0: np.ndarray
    r: np.ndarray
    S: np.ndarray
    u: np.ndarray
    u0: np.ndarray
    y: np.ndarray
    y0: np.ndarray
    psi: np.ndarray
    psi0: np.ndarray
    reaction: np.ndarray
    reaction0: np.ndarray
    flag: np.ndarray  # status of each lane
    books: np.ndarray  # work of the drives, dissipated energy, dissipated power at the step's start
    counts: np.ndarray  # Newton iterations, factorisations, halvings, steps


@kernel
def work_size(lanes, model, n_motions):  # type: ignore[no-untyped-def]
    """Length of the flat array behind `Work`."""
    n, n_u = size(model.n), size(model.n_inputs)
    return lanes * (9 * n + size(model.n_factor) + 4 * n_u + 8 * n_motions + 4) + 4


@kernel
def unpack(lane, model, flat, n_motions):  # type: ignore[no-untyped-def]
    """`Work` as views of `flat`."""
    lanes = len(lane)
    n, n_u, m, s = size(model.n) * lanes, size(model.n_inputs) * lanes, n_motions * lanes, size(model.n_factor) * lanes
    k = 9 * n
    i = k + s
    j = i + 4 * n_u
    e = j + 8 * m
    return Work(
        flat[0:n], flat[n : 2 * n], flat[2 * n : 3 * n], flat[3 * n : 4 * n],
        flat[4 * n : 5 * n], flat[5 * n : 6 * n], flat[6 * n : 7 * n], flat[7 * n : 8 * n], flat[8 * n : k],
        flat[k:i],
        flat[i : i + n_u], flat[i + n_u : i + 2 * n_u], flat[i + 2 * n_u : i + 3 * n_u], flat[i + 3 * n_u : j],
        flat[j : j + 3 * m], flat[j + 3 * m : j + 6 * m], flat[j + 6 * m : j + 7 * m], flat[j + 7 * m : e],
        flat[e : e + lanes], flat[e + lanes : e + 4 * lanes], flat[e + 4 * lanes : e + 4 * lanes + 4],
    )  # fmt: skip


@kernel
def _pin_fixed(lane, model, fixed, w):  # type: ignore[no-untyped-def]
    if fixed is not None:
        for k in fixed:
            pin(lane, model, w.S, k)


@kernel
def _zero_fixed(lane, fixed, w):  # type: ignore[no-untyped-def]
    if fixed is not None:
        for k in fixed:
            store(w.r, k, splat(lane, 0.0))


@kernel
def _pin_all(lane, model, drive, w):  # type: ignore[no-untyped-def]
    """Take fixed and prescribed coordinates out of the Newton matrix."""
    _pin_fixed(lane, model, model.fixed, w)
    if drive is not None:
        for k in drive.known:
            if k >= 0:
                pin(lane, model, w.S, k)


@kernel
def _zero_known(lane, model, drive, w):  # type: ignore[no-untyped-def]
    """Take fixed and prescribed coordinates out of the residual."""
    _zero_fixed(lane, model.fixed, w)
    if drive is not None:
        for k in drive.known:
            if k >= 0:
                w.r[k] = 0.0


@kernel
def _set_known(drive, w):  # type: ignore[no-untyped-def]
    """Give prescribed coordinates their position, velocity and acceleration."""
    for i in range(drive.known.shape[0]):
        k = drive.known[i]
        if k >= 0:
            w.q[k], w.v[k], w.a[k] = w.psi[3 * i], w.psi[3 * i + 1], w.psi[3 * i + 2]
            w.b[k] = w.a[k]


@kernel
def _predict(lane, model, w, h, scheme):  # type: ignore[no-untyped-def]
    """Start of Newton, eqs. [66]-[68]; the state is kept in q0, v0, a0, b0."""
    am, af, beta, gamma = scheme.alpha_m, scheme.alpha_f, scheme.beta, scheme.gamma
    for k in range(size(model.n)):
        q, v, a, b = load(lane, w.q, k), load(lane, w.v, k), load(lane, w.a, k), load(lane, w.b, k)
        store(w.q0, k, q)
        store(w.v0, k, v)
        store(w.a0, k, a)
        store(w.b0, k, b)
        new_a = a * model.predictor
        new_b = (new_a * (1.0 - af) + a * af - b * am) * (1.0 / (1.0 - am))
        store(w.a, k, new_a)
        store(w.b, k, new_b)
        store(w.q, k, q + v * h + (b * (0.5 - beta) + new_b * beta) * (h * h))
        store(w.v, k, v + (b * (1.0 - gamma) + new_b * gamma) * h)


@kernel
def _restore(lane, model, w):  # type: ignore[no-untyped-def]
    for k in range(size(model.n)):
        store(w.q, k, load(lane, w.q0, k))
        store(w.v, k, load(lane, w.v0, k))
        store(w.a, k, load(lane, w.a0, k))
        store(w.b, k, load(lane, w.b0, k))


@kernel
def _correct_multipliers(algebraic, w, active, c_m):  # type: ignore[no-untyped-def]
    """Multipliers do not count towards convergence: they have the scale of a force."""
    if algebraic is not None:
        for k in algebraic:
            w.q[k] = select_lt(0.5, active, w.q[k] - c_m * w.r[k], w.q[k])
            w.r[k] = 0.0


@kernel
def _correct(lane, model, w, active, c_b, c_v, c_m):  # type: ignore[no-untyped-def]
    """Apply the Newton increment -w.r where `active`, eqs. [80]-[82]; return its weighted size, NaN if not finite."""
    _correct_multipliers(model.algebraic, w, active, c_m)
    increment = splat(lane, 0.0)
    for k in range(size(model.n)):
        d = -load(lane, w.r, k)
        increment = maximum(absolute(d) * model.weight[k], increment)
        increment = select_lt(absolute(d), np.inf, increment, splat(lane, np.nan))
        q, v, a, b = load(lane, w.q, k), load(lane, w.v, k), load(lane, w.a, k), load(lane, w.b, k)
        store(w.q, k, select_lt(0.5, active, q + d, q))
        store(w.v, k, select_lt(0.5, active, v + d * c_v, v))
        store(w.b, k, select_lt(0.5, active, b + d * c_b, b))
        store(w.a, k, select_lt(0.5, active, a + d * c_m, a))
    return increment


@kernel
def _newton_matrix(lane, model, drive, par, w, c_m, c_v, iteration, modified):  # type: ignore[no-untyped-def]
    """Residual, and the factored iteration matrix [76]-[78] (in modified Newton only in the first iteration)."""
    if modified is not None:
        if iteration > 0:
            assemble(lane, model, par, w.q, w.v, w.a, w.u, c_m, c_v, 1.0, w.r, None)
            constrain(lane, model, w.psi, w.q, w.v, w.a, 0, c_m, w.r)
            _zero_known(lane, model, drive, w)
            return 0.0
    assemble(lane, model, par, w.q, w.v, w.a, w.u, c_m, c_v, 1.0, w.r, w.S)
    constrain(lane, model, w.psi, w.q, w.v, w.a, 0, c_m, w.r)
    _zero_known(lane, model, drive, w)
    _pin_all(lane, model, drive, w)
    factor(lane, model, w.S)
    return 1.0


@kernel
def step(lane, model, drive, par, w, t, h, scheme):  # type: ignore[no-untyped-def]
    """One step of size h from time t; lanes whose iteration does not converge are flagged NEWTON_FAILED."""
    _predict(lane, model, w, h, scheme)
    if drive is not None:
        end = t + h
        set_inputs(drive, w.u, end, end - 1e-6 * h)
        set_motions(drive, w.psi, end, end - 1e-6 * h)
        _set_known(drive, w)
    c_b = 1.0 / (scheme.beta * h * h)
    c_v = scheme.gamma / (scheme.beta * h)
    c_m = c_b * (1.0 - scheme.alpha_m) / (1.0 - scheme.alpha_f)
    active = select_lt(load(lane, w.flag, 0), 0.5, splat(lane, 1.0), splat(lane, 0.0))
    before = splat(lane, 1e300)
    for iteration in range(scheme.max_iterations):
        w.counts[1] += _newton_matrix(lane, model, drive, par, w, c_m, c_v, iteration, scheme.modified)
        solve(lane, model, w.S, w.r)
        increment = _correct(lane, model, w, active, c_b, c_v, c_m)
        w.counts[0] += 1.0
        # What is left after this update, from the contraction seen: increment * theta / (1 - theta).
        # The first iteration has seen none and must itself be below the tolerance.
        theta = select_lt(increment, before * 0.9, increment / before, splat(lane, 0.9))
        if iteration == 0:
            theta = splat(lane, 0.5)
        active = select_lt(increment * theta / (1.0 - theta), scheme.tolerance, splat(lane, 0.0), active)
        before = increment
        if largest(active) < 0.5:
            break
    store(w.flag, 0, select_lt(0.5, active, splat(lane, float(NEWTON_FAILED)), load(lane, w.flag, 0)))
    w.counts[3] += 1.0


@kernel
def _halve(lane, model, drive, par, w, t, h, scheme, books):  # type: ignore[no-untyped-def]
    """Repeat a failed step in pieces, at the smallest h / 2^max_halvings; SINGLE only. Leaves the last good state."""
    done, piece = 0.0, 0.5 * h
    smallest = h * 0.5**scheme.max_halvings
    _restore(lane, model, w)
    while done < h * (1.0 - 1e-9):
        piece = min(piece, h - done)
        w.flag[0] = OK
        step(lane, model, drive, par, w, t + done, piece, scheme)
        if w.flag[0] == OK:
            if books:
                _keep_books(lane, model, drive, par, w, piece)
            done += piece
        else:
            _restore(lane, model, w)
            w.counts[2] += 1.0
            piece *= 0.5
            if piece < smallest:
                return t + done
    return t + h


@kernel
def advance(lane, model, drive, par, w, t, h, n_steps, scheme, books):  # type: ignore[no-untyped-def]
    """n_steps steps of size h from t within a smooth stretch; returns the time reached (SINGLE) or meant (lanes).

    A single arm retries a failed step in halves and stops at the last good state. In lanes a failed arm is
    flagged and its neighbours go on; the caller repeats it alone from where the stretch began.
    """
    if books:
        _open_books(lane, model, drive, par, w)
    for i in range(n_steps):
        start = t + i * h
        step(lane, model, drive, par, w, start, h, scheme)
        if len(lane) == 1 and w.flag[0] != OK:
            w.counts[2] += 1.0
            reached = _halve(lane, model, drive, par, w, start, h, scheme, books)
            if w.flag[0] != OK:
                return reached
        elif books:
            _keep_books(lane, model, drive, par, w, h)
        code = out_of_range(lane, model, par, w.q)
        flag = load(lane, w.flag, 0)
        store(w.flag, 0, select_lt(flag, 0.5, code, flag))
        if len(lane) == 1 and w.flag[0] != OK:
            return start + h
    return t + n_steps * h


@kernel
def restart(lane, model, drive, par, w, t, h):  # type: ignore[no-untyped-def]
    """Consistent velocities, accelerations and multipliers at t+, where a load or motion may have jumped.

    Velocities jump by M dv + Phi_q^T Lambda = 0 with the prescribed part known, then M a + Phi_q^T lambda =
    Q - h(q, v) gives a, and b = a. The work of the impulse goes to the books. h: a step, for sidedness only.
    """
    n = size(model.n)
    if drive is not None:
        set_inputs(drive, w.u, t, t + 1e-6 * h)
        set_motions(drive, w.psi, t, t + 1e-6 * h)
        _velocity_jump(lane, model, drive, par, w)
        _set_known(drive, w)
    for k in range(n):
        store(w.a, k, splat(lane, 0.0))
    _clear_multipliers(model.algebraic, w)
    if drive is not None:
        _set_known(drive, w)
    assemble(lane, model, par, w.q, w.v, w.a, w.u, 1.0, 0.0, 0.0, w.r, w.S)
    constrain(lane, model, w.psi, w.q, w.v, w.a, 2, 1.0, w.r)
    _zero_known(lane, model, drive, w)
    _pin_all(lane, model, drive, w)
    factor(lane, model, w.S)
    w.counts[1] += 1.0
    solve(lane, model, w.S, w.r)
    for k in range(n):
        store(w.a, k, load(lane, w.a, k) - load(lane, w.r, k))
    _move_multipliers(model.algebraic, w)
    for k in range(n):
        store(w.b, k, load(lane, w.a, k))
    if drive is not None:
        reactions(lane, model, drive, par, w)


@kernel
def _clear_multipliers(algebraic, w):  # type: ignore[no-untyped-def]
    if algebraic is not None:
        for k in algebraic:
            w.q[k] = 0.0


@kernel
def _move_multipliers(algebraic, w):  # type: ignore[no-untyped-def]
    """The solve for accelerations leaves the multipliers in a; they live in q."""
    if algebraic is not None:
        for k in algebraic:
            w.q[k], w.a[k] = w.a[k], 0.0


@kernel
def _velocity_jump(lane, model, drive, par, w):  # type: ignore[no-untyped-def]
    """v <- v + dv with M dv + Phi_q^T Lambda = 0; SINGLE only. q0, v0, a0, b0 serve as scratch."""
    n = size(model.n)
    dv, impulse = w.a, w.b0
    for k in range(n):
        w.v0[k], w.q0[k] = w.v[k], w.q[k]
        dv[k] = 0.0
    for i in range(drive.known.shape[0]):
        k = drive.known[i]
        if k >= 0:
            dv[k] = w.psi[3 * i + 1] - w.v[k]
    for k in range(n):
        w.v[k] = 0.0
    _clear_multipliers(model.algebraic, w)
    _momentum(lane, model, par, w, dv, impulse)
    assemble(lane, model, par, w.q, w.v, dv, w.u, 1.0, 0.0, 0.0, w.r, w.S)
    for k in range(n):
        w.r[k] = impulse[k]
        w.v[k] = w.v0[k] + dv[k]
    constrain(lane, model, w.psi, w.q, w.v, w.a, 1, 1.0, w.r)
    _zero_known(lane, model, drive, w)
    _pin_all(lane, model, drive, w)
    factor(lane, model, w.S)
    w.counts[1] += 1.0
    solve(lane, model, w.S, w.r)
    for k in range(n):
        dv[k] -= w.r[k]
    _work_of_impulse(lane, model, drive, par, w, dv, impulse)
    for k in range(n):
        w.q[k] = w.q0[k]
        w.v[k] = w.v0[k] + dv[k]
    _clear_multiplier_rates(model.algebraic, w)


@kernel
def _clear_multiplier_rates(algebraic, w):  # type: ignore[no-untyped-def]
    if algebraic is not None:
        for k in algebraic:
            w.v[k] = 0.0


@kernel
def _momentum(lane, model, par, w, dv, out):  # type: ignore[no-untyped-def]
    """out <- M(q) dv: what the residual gains by the acceleration dv, at v = 0."""
    n = size(model.n)
    for k in range(n):
        w.a0[k] = 0.0
        w.v[k] = 0.0
    assemble(lane, model, par, w.q, w.v, w.a0, w.u, 1.0, 0.0, 0.0, out, None)
    assemble(lane, model, par, w.q, w.v, dv, w.u, 1.0, 0.0, 0.0, w.r, None)
    for k in range(n):
        out[k] = w.r[k] - out[k]


@kernel
def _work_of_impulse(lane, model, drive, par, w, dv, impulse):  # type: ignore[no-untyped-def]
    """Impulse times mean velocity of each prescribed coordinate is exactly the kinetic energy it brings."""
    multipliers = w.reaction0
    for i in range(drive.known.shape[0]):
        if drive.known[i] < 0:
            multipliers[i] = dv[_multiplier_row(model.algebraic, -1 - drive.known[i])]
    _momentum(lane, model, par, w, dv, impulse)
    for i in range(drive.known.shape[0]):
        k = drive.known[i]
        if k >= 0:
            w.books[0] += impulse[k] * 0.5 * (w.v0[k] + w.v0[k] + dv[k])
        else:
            w.books[0] += multipliers[i] * (w.psi[3 * i + 1] + w.psi0[3 * i + 1]) * 0.5


@kernel
def reactions(lane, model, drive, par, w):  # type: ignore[no-untyped-def]
    """Generalised forces that hold the prescribed coordinates, from the converged state."""
    assemble(lane, model, par, w.q, w.v, w.a, w.u, 1.0, 0.0, 0.0, w.r, None)
    for i in range(drive.known.shape[0]):
        k = drive.known[i]
        if k >= 0:
            w.reaction[i] = w.r[k]
        else:
            w.reaction[i] = w.q[_multiplier_row(model.algebraic, -1 - k)]


@kernel
def _multiplier_row(algebraic, j):  # type: ignore[no-untyped-def]
    if algebraic is None:
        return 0
    return algebraic[j]


@kernel
def _open_books(lane, model, drive, par, w):  # type: ignore[no-untyped-def]
    """Remember ports, forces and dissipated power at the start of a step or a smooth stretch."""
    for i in range(w.u.shape[0]):
        w.u0[i] = w.u[i]
    ports(lane, model, par, w.q, w.y0)
    store(w.books, 2, dissipation(lane, model, par, w.q, w.v))
    if drive is not None:
        for i in range(w.psi.shape[0]):
            w.psi0[i] = w.psi[i]
        reactions(lane, model, drive, par, w)
        for i in range(w.reaction.shape[0]):
            w.reaction0[i] = w.reaction[i]


@kernel
def _keep_books(lane, model, drive, par, w, h):  # type: ignore[no-untyped-def]
    """Add the step's work (mean force times displacement, what Newmark itself does) and dissipation."""
    ports(lane, model, par, w.q, w.y)
    work = load(lane, w.books, 0)
    for i in range(size(model.n_inputs)):
        force = (load(lane, w.u0, i) + load(lane, w.u, i)) * 0.5
        work = work + force * (load(lane, w.y, i) - load(lane, w.y0, i))
        store(w.u0, i, load(lane, w.u, i))
        store(w.y0, i, load(lane, w.y, i))
    if drive is not None:
        reactions(lane, model, drive, par, w)
        for i in range(drive.known.shape[0]):
            work += 0.5 * (w.reaction0[i] + w.reaction[i]) * (w.psi[3 * i] - w.psi0[3 * i])
            w.reaction0[i] = w.reaction[i]
        for i in range(w.psi.shape[0]):
            w.psi0[i] = w.psi[i]
    store(w.books, 0, work)
    power = dissipation(lane, model, par, w.q, w.v)
    store(w.books, 1, load(lane, w.books, 1) + (load(lane, w.books, 2) + power) * (0.5 * h))
    store(w.books, 2, power)
