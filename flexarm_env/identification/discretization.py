"""Refine the model's time step and mesh until they no longer influence the fitted parameters significantly.

With half the time step, or with a finer mesh, the model predicts slightly different readings for the same parameters.
To first order this difference shifts the best parameters z by the Gauss-Newton step -(J'J)^-1 J' d. J is the derivative
of the residuals by z, and d is the change of the residuals that the smaller step or the finer mesh causes. The solver's
error is of second order in dt, so that the shift to dt = 0 is 4/3 of the shift caused by halving the step (Richardson
extrapolation). If a shift exceeds the fraction `SHARE` of the half width of a parameter's 95 % interval, the refined
model is fitted again from the current parameters. After the last fit the remaining shift is added to the parameters,
and half of its magnitude is added to the half widths.
"""

import dataclasses
from dataclasses import dataclass

import numpy as np

from flexarm_env.bodies import SPACE

from ..validation import Array
from .fit import Fit, Problem, Solver
from .uncertainty import Uncertainty, uncertainty

SHARE = 0.2
"""Largest accepted shift of a parameter, divided by the half width of its 95 % interval."""

LEAST = 1e-4
"""Smallest shift, divided by a parameter's size, that causes a refinement."""

MOST = {"step": 5, "mesh": 2}
"""Largest numbers of refinements of time step and mesh."""

FACTOR = {"step": 4.0 / 3.0, "mesh": 1.0}
"""Ratio of the remaining shift to dt = 0, or to the exact mesh, to the shift by one refinement."""

WORSE = 2.0
"""A refinement is rejected if it increases the cost by more than this factor."""

EVALUATIONS = 8
"""Largest number of evaluations of a fit after a refinement; such a fit starts close to its solution."""

FAR = 3.0
"""Largest plausible shift, divided by a parameter's size. A larger shift counts as a failure of the refined model."""


@dataclass(frozen=True)
class Resolved:
    """Result of a fit with an estimate of the discretization error in each parameter.

    Attributes:
        problem: the least-squares problem with the final step and mesh. shifts: dict with the remaining shifts (p,) for
            the keys "step" and "mesh", scaled as z (see the module's docstring). fit: the fit, whose z (p,) includes
            the remaining shifts. uncertainty: confidence intervals, widened for the remaining shifts. coarse: names of
            the parameters whose remaining shift exceeds the half width of their interval.
    """

    problem: Problem
    fit: Fit
    uncertainty: Uncertainty
    shifts: dict[str, Array]
    coarse: tuple[str, ...]


def resolve(solver: Solver, found: Fit) -> Resolved:
    """Refine step and mesh of a fit until the discretization error is small compared with the confidence intervals.

    Fits of arms in space are not refined.
    """
    problem, z, left = solver.problem, found.z, dict(MOST)
    if problem.experiment.config.axes == SPACE:
        return Resolved(problem, found, uncertainty(problem, z), {}, ())
    while True:
        # shifts by one refinement, and their limits from the present intervals
        worth = uncertainty(problem, z)
        values = np.abs(problem.values(z) / problem.sizes)
        limit = np.maximum(SHARE * worth.half / problem.sizes, LEAST * np.maximum(1.0, values))
        limit[np.isnan(limit)] = np.inf  # of a parameter at its bound, which has no interval
        shifts = {kind: _shift(problem, z, kind) for kind in MOST}
        wanted = [kind for kind in MOST if left[kind] > 0 and (np.abs(shifts[kind]) > limit).any()]
        if not wanted:
            break
        finer, moved = problem, z
        for kind in wanted:
            finer, left[kind] = refined(finer, kind), left[kind] - 1
            moved = moved + shifts[kind]
        # fit again from the shifted parameters; reject a refinement that fits much worse
        moved, cost, ended = solver.polish(finer, moved, EVALUATIONS)
        if cost > WORSE * found.cost:  # a finer model that fails, or a fit that was led astray: keep the one before
            left = dict.fromkeys(left, 0)
            continue
        problem, z = finer, moved
        found = dataclasses.replace(found, cost=cost, ended=ended, evaluations=solver.count)
    # correct z by the remaining shifts; widen the intervals by half their magnitudes
    low, high = problem.bounds
    change = np.where(np.isinf(limit), 0.0, sum(shifts.values()))
    size = np.where(np.isinf(limit), 0.0, sum(np.abs(shift) for shift in shifts.values()))
    far = size > worth.half / problem.sizes
    far &= size > LEAST * np.maximum(1.0, values)
    names = [p.name for p in problem.experiment.parameters]
    coarse = tuple(name for name, beyond in zip(names, far, strict=True) if beyond)
    half = worth.half + 0.5 * size * problem.sizes
    own = problem.experiment
    fit = dataclasses.replace(
        found, z=np.clip(z + change, low, high), runs=own.runs, by_differences=dict(own.by_differences)
    )
    return Resolved(problem, fit, dataclasses.replace(worth, half=half), shifts, coarse)


def refined(problem: Problem, kind: str) -> Problem:
    """Return the problem with half the time step (kind "step") or with a finer mesh ("mesh")."""
    return Problem(problem.experiment.anew(kind), problem.runs)


def _shift(problem: Problem, z: Array, kind: str) -> Array:
    """Predict the change of z (p,) to dt = 0, or to the exact mesh; 0 if the companion model fails.

    The change is -FACTOR (J'J)^-1 J' d for the parameters that are not at a bound. d: residuals of the companion model
    minus residuals of the model.
    """
    finer = refined(problem, kind)
    here, there = (np.concatenate([e.ravel() for e in one.errors(z)]) for one in (problem, finer))
    problem.experiment.runs += len(problem.runs)
    low, high = problem.bounds
    free = (z > low) & (z < high)
    noise = float(here.std())
    J = problem.jacobian(z, noise)[:, free]
    d = np.concatenate([there - here, np.zeros(len(z))])  # priors do not depend on the mesh
    found = np.zeros(len(z))
    found[free] = -FACTOR[kind] * np.linalg.lstsq(J, d, rcond=1e-6)[0]
    return found if np.isfinite(found).all() and np.abs(found).max(initial=0.0) < FAR else np.zeros(len(z))
