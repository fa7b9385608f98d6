"""Newton-Raphson within a step, eqs. [69]-[82]: from a start to coordinates that the step's equations hold for."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ...compiler import absolute, arms, change, inlined, kernel, largest, load, maximum, select_lt, size, splat, store
from ..joints.friction import apply_friction
from ..layout import ITERATIONS
from ..protocol import RESIDUAL_ALONE, Weights, assemble, constrain, factor, keeps, lack, rotates, settle, solve, stride
from .period import correct_period
from .work import move_on, solve_known, state_of, take_multipliers, take_out_known

LINEAR = 1e-3
"""Least contraction to expect of a later iteration where a model keeps factors: what is off most falls by its square at
first, and hides from the contraction seen what falls in proportion."""


class Slopes(NamedTuple):
    """What v, a and b of a step's end change by where its q changes by one; the step's length."""

    v: float  # 1/s
    a: float  # 1/s^2
    b: float  # 1/s^2
    h: float  # s


@kernel
def slopes_of(scheme, h):
    """Those of a step of h."""
    b = 1.0 / (scheme.beta * h * h)
    return Slopes(scheme.gamma / (scheme.beta * h), b * (1.0 - scheme.alpha_m) / (1.0 - scheme.alpha_f), b, h)


@kernel
def _trust(predictor):
    """How many times its square the first increment leaves as error; 0: not known."""
    if predictor is None:
        return 10.0
    if isinstance(predictor, tuple):
        return predictor[1]
    return 0.0


@kernel
def _first_contraction(lane, trust, increment):
    """Contraction to expect of the first iteration, which has seen none: 1/2, so that its increment itself is the error
    left, or `trust` times the increment where the error left is known to be quadratic."""
    if trust > 0.0:
        return select_lt(increment, 0.05, increment * trust, splat(lane, 0.5))
    return splat(lane, 0.5)


@kernel
def follow(lane, w, k, d, slopes):
    """v, a, b of row k where its q is another by d."""
    store(w.v, k, load(lane, w.v, k) + d * slopes.v)
    store(w.a, k, load(lane, w.a, k) + d * slopes.a)
    store(w.b, k, load(lane, w.b, k) + d * slopes.b)


@kernel
def _moved(lane, correction, shift, k, d):
    """The increment d and, where the period is corrected, the shift of the displacement; and the larger of the two."""
    if correction is None:
        return d, absolute(d)
    moved = d + load(lane, shift, k)
    return moved, maximum(absolute(moved), absolute(d))


@kernel
def _sharpen_multipliers(lane, algebraic, w, c_m):
    """`take_multipliers` of tangents alone."""
    if algebraic is not None:
        for i in range(algebraic.shape[0]):
            k = algebraic[i]
            store(w.q, k, load(lane, w.q, k) + change(-load(lane, w.r, k)) * c_m)
            store(w.r, k, splat(lane, 0.0))


@kernel
def _bound(lane, model, longest, r):
    """Scale r down to where its weighted size is at most `longest`, if that is not None."""
    if longest is not None:
        size_of = splat(lane, longest)
        for k in range(size(model.n)):
            size_of = maximum(absolute(load(lane, r, k)) * model.weight[k], size_of)
        share = longest / size_of
        for k in range(size(model.n)):
            store(r, k, load(lane, r, k) * share)


@inlined
def _move(lane, model, par, w, active, slopes, tolerance):
    """Apply the increment -r where `active`, eqs. [80]-[82]; return its weighted size, NaN if not finite."""
    _bound(lane, model, stride(model), w.r)
    take_multipliers(lane, model.algebraic, w, active, slopes.a)  # forces, which do not count towards convergence
    largest_of = splat(lane, 0.0)
    nothing = splat(lane, -0.0)  # x + -0.0 is x to the last bit
    for k in range(size(model.n)):
        d = -load(lane, w.r, k)
        moved, increment = _moved(lane, model.correction, w.shift, k, d)
        largest_of = maximum(increment * model.weight[k], largest_of)
        largest_of = select_lt(increment, np.inf, largest_of, splat(lane, np.nan))
        d = select_lt(0.5, active, d, nothing)
        if len(lane) > 1:
            store(w.r, k, select_lt(0.5, active, moved, nothing))
            follow(lane, w, k, d, slopes)
        else:
            store(w.r, k, d)
    if len(lane) == 1:  # loops of their own, which vectorise
        for k in range(size(model.n)):
            follow(lane, w, k, load(lane, w.r, k), slopes)
        if model.correction is not None:
            for k in range(size(model.n)):
                store(w.r, k, select_lt(0.5, active, load(lane, w.r, k) + load(lane, w.shift, k), nothing))
    move_on(lane, model, w, w.r)
    if stride(model) is not None:  # of smaller increments the square is below the tolerance
        active = select_lt(math.sqrt(tolerance), largest_of, active, splat(lane, 0.0))
    settle(lane, model, par, None, w, active, slopes)
    return largest_of


@inlined
def newton(lane, model, drive, par, w, slopes, scheme, plain):
    """Solve the equations of a step; returns lanes that are 1 where that did not succeed, 0 elsewhere.

    Arms that have converged, or failed before, are left as they are while the others go on. plain: without the
    correction of the period.
    """
    active = select_lt(load(lane, w.flag, 0), 0.5, splat(lane, 1.0), splat(lane, 0.0))
    before, corrected = splat(lane, 1e300), splat(lane, 1.0 if plain else 0.0)
    for iteration in range(scheme.max_iterations):
        fresh = iteration == 0
        if scheme.modified is None:
            fresh = not keeps(model, iteration)
        weights = Weights(slopes.a, slopes.v, 1.0)
        assemble(lane, model, par, state_of(w), w.u, weights if fresh else RESIDUAL_ALONE, w.r, w.S)
        constrain(lane, model, w.psi, state_of(w), 0, slopes.a, w.r)
        solve_known(lane, model, drive, w, fresh)
        apply_friction(lane, model, par, state_of(w), weights, slopes.v / slopes.a, w.S, w.r)
        corrected = correct_period(lane, model, drive, par, scheme.tolerance, w, corrected, active, slopes)
        increment = _move(lane, model, par, w, active, slopes, scheme.tolerance)
        w.counts[ITERATIONS] += 1.0
        # What is left after this update, from the contraction seen: increment * theta / (1 - theta).
        theta = select_lt(increment, before * 0.9, increment / before, splat(lane, 0.9))
        if keeps(model, 2):  # known when compiled
            theta = maximum(theta, LINEAR)
        if iteration == 0:
            theta = _first_contraction(lane, _trust(model.predictor), increment)
            if lack(model) is not None:
                theta = maximum(theta, lack(model)[0])
        elif lack(model) is not None:
            if not keeps(model, iteration):  # the contraction seen was the first increment's
                least = maximum(increment * 10.0, lack(model)[1])
                theta = select_lt(least, theta, least, theta)
        active = select_lt(increment * theta / (1.0 - theta), scheme.tolerance, splat(lane, 0.0), active)
        before = increment
        if largest(active) < 0.5:
            break
    if len(lane) > arms(lane):
        for _ in range(3 if rotates(model) is None else 6):
            _sharpen(lane, model, drive, par, w, slopes)
    return active


@kernel
def _sharpen(lane, model, drive, par, w, slopes):
    """Dual lanes: tangents as the equations have them at the values found. Those of the iterations are behind by one
    where they end; S is the derivative, or nearly so, so that one more or a few make them exact; values stay."""
    weights = Weights(slopes.a, slopes.v, 1.0)
    assemble(lane, model, par, state_of(w), w.u, weights, w.r, w.S)
    constrain(lane, model, w.psi, state_of(w), 0, slopes.a, w.r)
    take_out_known(lane, model, drive, w.r, w.S, True)
    factor(lane, model, w.S)
    solve(lane, model, w.S, w.r)
    apply_friction(lane, model, par, state_of(w), weights, slopes.v / slopes.a, w.S, w.r)
    _sharpen_multipliers(lane, model.algebraic, w, slopes.a)
    for k in range(size(model.n)):
        d = change(-load(lane, w.r, k))
        store(w.r, k, d)
        follow(lane, w, k, d, slopes)
    move_on(lane, model, w, w.r)
