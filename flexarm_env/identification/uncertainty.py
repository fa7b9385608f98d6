"""What a fit is worth: intervals of its parameters, which of them the logs cannot tell, which combinations they can.

Residuals of a model that is not quite right, and of filtered sensors, are alike from sample to sample. The covariance
is the sandwich (J'J)^-1 S (J'J)^-1 of a heteroskedasticity- and autocorrelation-consistent S (Newey & West 1987), with
the bandwidth of Andrews (1991) and quantiles of Student's t with as many degrees of freedom as S has (Kiefer &
Vogelsang 2005: 1.5 n over the bandwidth of Bartlett's kernel); it is never less than that of independent residuals.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..validation import Array
from .fit import Problem

UNTOLD = 0.5
"""A parameter whose 95 % interval reaches further than so many of its sizes to either side is not told."""

SHOWN = 0.2
"""Parameters whose share in a direction, over the largest, is less are not named."""

AT_BOUND = 1e-4
"""A parameter is at a bound where it is nearer to it than so much of their distance."""

SMALLEST = 1e-7
"""Singular values of the derivatives are taken as at least this over the largest."""


@dataclass(frozen=True)
class Direction:
    """Changes of parameters in sizes of theirs, the largest 1, that go together; deviation: 95 %, of the largest."""

    shares: dict[str, float]
    deviation: float


@dataclass(frozen=True)
class Uncertainty:
    """Of a fit.

    Attributes:
        half (p,): half widths of the 95 % intervals, in the parameters' units. correlation (p, p).
        condition: of the derivatives by parameters in their sizes. at_bound: names of parameters that ended there; they
            have no interval (nan).
        unidentifiable: names of those the logs cannot tell, at a bound or not. directions: changes of several
            parameters that change hardly anything; identifiable: for each, the combination of the same parameters that
            is known best.
        noise: root mean square of the residuals over the readings' standard deviation. samples: independent ones that
            the residuals amount to.
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
    """The Uncertainty of a fit at its end."""
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
    # what the logs can tell does not depend on where a search along a blind direction was stopped
    whole, freedom, _, _ = _covariance(J, errors, noise2)
    quantile = float(student.ppf(0.975, freedom))
    wide = quantile * np.sqrt(np.diag(whole)) / larger > UNTOLD
    lost = tuple(name for name, out in zip(names, wide, strict=True) if out)
    directions, known = _directions(whole / np.outer(larger, larger), quantile, names)
    half, correlation, condition, samples = np.full(len(z), np.nan), np.eye(len(z)), 1.0, float(len(flat))
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


def _with_priors(problem: Problem, free: NDArray[np.intp], covariance: Array) -> Array:
    """Standard deviations of some parameters, in their sizes: of what the logs say and what was known, together."""
    alone = np.sqrt(np.diag(covariance))
    prior = [problem.experiment.parameters[i].prior for i in free]
    if all(known is None for known in prior):
        return alone
    own = np.array([0.0 if known is None else 1.0 / known[1] for known in prior]) * problem.sizes[free]
    both = np.linalg.inv(np.linalg.pinv(covariance, hermitian=True) + np.diag(own**2))
    together: Array = np.minimum(alone, np.sqrt(np.maximum(np.diag(both), 0.0)))
    return together


def _covariance(J: Array, errors: Sequence[Array], noise2: float) -> tuple[Array, float, float, float]:
    """Covariance of the parameters by which J is the derivative, its degrees of freedom, the condition of J, and how
    many samples tell as much as one that is independent."""
    p = J.shape[1]
    _, values, right = np.linalg.svd(J, full_matrices=False)
    kept = np.maximum(values, SMALLEST * values.max(initial=0.0))
    inverse = (right.T / kept**2) @ right  # (J'J)^-1
    scores, at = [], 0
    for e in errors:
        block = J[at : at + e.size].reshape(*e.shape, p)
        scores.append(np.einsum("tcp,tc->tp", block, e))
        at += e.size
    S, freedom = _long_run(scores)
    robust = inverse @ S @ inverse
    grow = np.sqrt(np.maximum(1.0, noise2 * np.diag(inverse) / np.maximum(np.diag(robust), 1e-300)))
    alike = float(np.trace(inverse @ S) / max(p, 1)) / noise2
    return robust * np.outer(grow, grow), freedom, float(values.max() / max(values.min(), 1e-300)), alike


def _long_run(scores: Sequence[Array]) -> tuple[Array, float]:
    """Sum of the scores' covariances over all lags, Bartlett's weights; and its degrees of freedom."""
    n = sum(len(g) for g in scores)
    numerator = denominator = 0.0
    for k in range(scores[0].shape[1]):
        own = [g[:, k] / (np.sqrt(sum((h[:, k] ** 2).sum() for h in scores)) + 1e-300) for g in scores]
        past, now = np.concatenate([g[:-1] for g in own]), np.concatenate([g[1:] for g in own])
        rho = float(np.clip(past @ now / max(past @ past, 1e-300), -0.97, 0.99))
        rest = float(((now - rho * past) ** 2).mean())
        numerator += 4.0 * rho**2 * rest**2 / ((1.0 - rho) ** 6 * (1.0 + rho) ** 2)
        denominator += rest**2 / (1.0 - rho) ** 4
    width = min(1.1447 * (numerator / max(denominator, 1e-300) * n) ** (1.0 / 3.0), n / 8.0)
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
    """Combinations that are not told, and for the parameters of each the one that is told best."""
    values, vectors = np.linalg.eigh(covariance)
    blind, told = [], []
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
