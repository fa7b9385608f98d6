"""Uncertainty of a fit: confidence intervals, unidentifiable parameters, and identifiable combinations of parameters.

Because of modeling errors and sensor filters, residuals of successive samples are correlated. The parameters'
covariance is therefore computed by the sandwich formula (J'J)^-1 S (J'J)^-1, where J is the derivative of the residuals
by the parameters. S is the heteroskedasticity- and autocorrelation-consistent estimate of Newey & West (1987), with the
bandwidth of Andrews (1991). The intervals use quantiles of Student's t distribution. For n samples the distribution has
1.5 n / b degrees of freedom, where b is the bandwidth of Bartlett's kernel (Kiefer & Vogelsang 2005). The covariance is
never smaller than the covariance for independent residuals.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..validation import Array
from .fit import Problem

UNTOLD = 0.5
"""A parameter is unidentifiable if the half width of its 95 % interval exceeds `UNTOLD` times its size."""

SHOWN = 0.2
"""A direction names the parameters whose share is at least `SHOWN` times the largest share."""

AT_BOUND = 1e-4
"""A parameter is at a bound if its distance from the bound is below this share of the distance between both bounds."""

SMALLEST = 1e-7
"""Lower limit of the derivatives' singular values, divided by the largest one."""


@dataclass(frozen=True)
class Direction:
    """Linear combination of parameters; coefficients are scaled by the parameters' sizes, and the largest is 1.

    deviation: half width of the 95 % interval of this combination of scaled parameters.
    """

    shares: dict[str, float]
    deviation: float


@dataclass(frozen=True)
class Uncertainty:
    """Uncertainty of the parameters of a fit.

    Attributes:
        half (p,): half widths of the 95 % intervals, in the parameters' units. correlation (p, p): correlation matrix
            of the parameters.
        condition: condition number of the residuals' derivatives by z (`fit.Problem`). at_bound: names of the
            parameters whose fitted value is at a bound; the intervals of these parameters are nan.
        unidentifiable: names of the parameters that the logs do not determine. directions: simultaneous changes of
            several parameters that hardly change the residuals. identifiable: for each direction, the combination of
            the direction's parameters that has the smallest uncertainty.
        noise: root mean square of the residuals, divided by the readings' standard deviation. samples: number of
            independent residuals with the same information as the correlated residuals.
    """

    half: Array
    correlation: Array
    condition: float
    at_bound: tuple[str, ...]
    unidentifiable: tuple[str, ...]
    directions: tuple[Direction, ...]
    identifiable: tuple[Direction, ...]
    noise: float
    samples: float


def uncertainty(problem: Problem, z: Array) -> Uncertainty:
    """Compute the uncertainty of a fit at its solution z (p,)."""
    from scipy.stats import t as student

    low, high = problem.bounds
    names = [p.name for p in problem.experiment.parameters]
    near = AT_BOUND * (high - low)
    free = np.flatnonzero((z - low > near) & (high - z > near))
    errors = problem.errors(z)
    flat = np.concatenate([e.ravel() for e in errors])
    J = problem.slopes(z, careful=True)
    noise2 = float(flat @ flat) / max(len(flat) - len(free), 1)
    larger = np.maximum(1.0, np.abs(problem.values(z) / problem.sizes))  # sizes are those of the values found

    # all parameters: what the logs determine does not depend on where a search along a blind direction stopped
    whole, freedom, _, _ = _covariance(J, errors, noise2)
    quantile = float(student.ppf(0.975, freedom))
    wide = quantile * np.sqrt(np.diag(whole)) / larger > UNTOLD
    lost = tuple(name for name, out in zip(names, wide, strict=True) if out)
    directions, known = _directions(whole / np.outer(larger, larger), quantile, names)
    half, correlation, condition, samples = np.full(len(z), np.nan), np.eye(len(z)), 1.0, float(len(flat))
    # free parameters alone: intervals, with priors, and correlations
    if len(free):
        covariance, freedom, condition, alike = _covariance(J[:, free], errors, noise2)
        quantile, spread = float(student.ppf(0.975, freedom)), np.sqrt(np.diag(covariance))
        half[free] = quantile * _with_priors(problem, free, covariance) * problem.sizes[free]
        correlation[np.ix_(free, free)] = covariance / np.outer(spread, spread)
        samples /= max(alike, 1.0)
    return Uncertainty(
        half=half, correlation=correlation, condition=condition,
        at_bound=tuple(name for i, name in enumerate(names) if i not in free), unidentifiable=lost,
        directions=directions, identifiable=known, noise=noise2**0.5, samples=samples,
    )  # fmt: skip


def interval_of_last(J: Array, errors: Sequence[Array]) -> tuple[float, float]:
    """Return the Gauss-Newton step of the last parameter, and the half width of its 95 % confidence interval.

    J (n, p): derivatives of the residuals by the parameters. errors: residuals of each run (samples, outputs).
    """
    from scipy.stats import t as student

    flat = np.concatenate([e.ravel() for e in errors])
    step = -np.linalg.lstsq(J, flat, rcond=SMALLEST)[0]
    # residuals after the step, split into runs
    rest, left, at = flat + J @ step, [], 0
    for e in errors:
        left.append(rest[at : at + e.size].reshape(e.shape))
        at += e.size
    covariance, freedom, _, _ = _covariance(J, left, float(rest @ rest) / max(len(rest) - J.shape[1], 1))
    return float(step[-1]), float(student.ppf(0.975, freedom) * np.sqrt(covariance[-1, -1]))


def _with_priors(problem: Problem, free: NDArray[np.intp], covariance: Array) -> Array:
    """Return the standard deviations of the free parameters, in units of their sizes, from the logs and the priors
    together.

    covariance: covariance of the parameters from the logs alone. The information matrices of logs and priors are added:
        (C^-1 + diag(1 / s^2))^-1.
    """
    alone = np.sqrt(np.diag(covariance))
    prior = [problem.experiment.parameters[i].prior for i in free]
    if all(known is None for known in prior):
        return alone
    own = np.array([0.0 if known is None else 1.0 / known[1] for known in prior]) * problem.sizes[free]
    both = np.linalg.inv(np.linalg.pinv(covariance, hermitian=True) + np.diag(own**2))
    together: Array = np.minimum(alone, np.sqrt(np.maximum(np.diag(both), 0.0)))
    return together


def _covariance(J: Array, errors: Sequence[Array], noise2: float) -> tuple[Array, float, float, float]:
    """Return the covariance (p, p) of the parameters by the sandwich formula, from J (n, p) and each run's residuals.

    noise2: mean squared residual. Further results: degrees of freedom, condition number of J, and the number of
        correlated residuals that carry the information of one independent residual.
    """
    p = J.shape[1]
    _, values, right = np.linalg.svd(J, full_matrices=False)
    kept = np.maximum(values, SMALLEST * values.max(initial=0.0))
    inverse = (right.T / kept**2) @ right  # (J'J)^-1
    channels = errors[0].shape[1]
    squares, counts, products = np.zeros(channels), 0, np.zeros((channels, p, p))
    scores, at = [], 0
    # scores J' e per instant, and J'J per output channel
    for e in errors:
        block = J[at : at + e.size].reshape(*e.shape, p)
        scores.append(np.einsum("tcp,tc->tp", block, e))
        squares += np.square(e).sum(axis=0)
        products += np.einsum("tcp,tcq->cpq", block, block)
        counts += len(e)
        at += e.size
    # robust covariance, scaled up where it is below that of independent residuals
    S, freedom = _long_run(scores)
    robust = inverse @ S @ inverse
    # independent residuals with a variance per channel: a pooled one would treat a fine encoder like a noisy gauge
    noises = squares / max(counts - p / channels, 1.0)
    independent = inverse @ np.einsum("c,cpq->pq", noises, products) @ inverse
    grow = np.sqrt(np.maximum(1.0, np.diag(independent) / np.maximum(np.diag(robust), 1e-300)))
    alike = float(np.trace(inverse @ S) / max(p, 1)) / noise2
    return robust * np.outer(grow, grow), freedom, float(values.max() / max(values.min(), 1e-300)), alike


def _long_run(scores: Sequence[Array]) -> tuple[Array, float]:
    """Return the long-run covariance S (p, p) of the scores with Bartlett weights, and its degrees of freedom.

    scores: scores (samples, p) of each run.
    """
    n = sum(len(g) for g in scores)
    numerator = denominator = 0.0
    # bandwidth of Andrews (1991) from AR(1) fits of each score
    for k in range(scores[0].shape[1]):
        own = [g[:, k] / (np.sqrt(sum((h[:, k] ** 2).sum() for h in scores)) + 1e-300) for g in scores]
        past, now = np.concatenate([g[:-1] for g in own]), np.concatenate([g[1:] for g in own])
        rho = float(np.clip(past @ now / max(past @ past, 1e-300), -0.97, 0.99))
        rest = float(((now - rho * past) ** 2).mean())
        numerator += 4.0 * rho**2 * rest**2 / ((1.0 - rho) ** 6 * (1.0 + rho) ** 2)
        denominator += rest**2 / (1.0 - rho) ** 4
    width = min(1.1447 * (numerator / max(denominator, 1e-300) * n) ** (1.0 / 3.0), n / 8.0)
    # S = sum over lags of w(lag) (Gamma + Gamma'), w = 1 - lag / (width + 1)
    S = np.zeros((scores[0].shape[1],) * 2)
    for g in scores:
        S += g.T @ g
        for lag in range(1, min(int(width) + 1, len(g))):
            part = g[lag:].T @ g[:-lag]
            S += (1.0 - lag / (width + 1.0)) * (part + part.T)
    return S, max(3.0, 1.5 * n / max(width, 1.0))


def _directions(
    covariance: Array, quantile: float, names: list[str]
) -> tuple[tuple[Direction, ...], tuple[Direction, ...]]:
    """Find unidentifiable combinations of parameters, and for each the best known combination of the same parameters.

    covariance (p, p): covariance in units of the parameters' sizes. quantile: 97.5 % quantile of Student's t
        distribution.
    """
    values, vectors = np.linalg.eigh(covariance)
    blind, told = [], []
    # eigenvectors of the covariance, the largest variance first
    for value, vector in zip(values[::-1], vectors.T[::-1], strict=True):
        vector = vector / vector[np.abs(vector).argmax()]
        deviation = quantile * float(np.sqrt(max(value, 0.0) / (vector @ vector)))
        if deviation <= UNTOLD:
            break
        group = [i for i in range(len(names)) if abs(vector[i]) > SHOWN]
        blind.append(Direction({names[i]: float(vector[i]) for i in group}, deviation))
        if len(group) > 1:
            own, axes = np.linalg.eigh(covariance[np.ix_(group, group)])
            best = axes[:, 0] / axes[np.abs(axes[:, 0]).argmax(), 0]
            told.append(Direction(
                {names[i]: float(s) for i, s in zip(group, best, strict=True)},
                quantile * float(np.sqrt(max(own[0], 0.0) * (best @ best))),
            ))  # fmt: skip
    return tuple(blind), tuple(told)
