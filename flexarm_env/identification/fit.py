"""Least-squares fit: find the parameters with which the simulated readings are closest to the measured readings."""

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from flexarm_env.files import write_whole

from ..validation import Array
from .log import Run
from .model import Experiment

FIRST = 8
"""Number of evaluations per initial guess, after which only the best fit is continued."""

HORIZONS = (0.05, 0.15, 0.4)
"""Shares of the readings' variance. The first part of a run that contains a share of the variance is fitted before the
whole run. The cost of a long vibration has many local minima that differ by whole periods; the cost of a few periods
has only one minimum."""

SPREAD = 0.5
"""Further initial guesses are random, within SPREAD times the parameters' sizes around the first guess."""

ROUGH = 0.1
"""Relative size of the residuals that is assumed in the weight of priors until the actual size is known."""


@dataclass(frozen=True)
class Problem:
    """Least-squares problem for the scaled parameters z = (value - start) / size.

    Each residual is the simulated minus the measured reading, divided by the reading's standard deviation in the log.
    """

    experiment: Experiment
    runs: Sequence[Run]

    @property
    def sizes(self) -> Array:
        """Change (p,) of each parameter's value if its component of z changes by 1."""
        found = []
        for p, x in zip(self.experiment.parameters, self.experiment.start, strict=True):
            found.append(p.size or abs(x) or 0.1 * (p.high - p.low))
        return np.array(found)

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper bounds of z, (p,) each."""
        low, high = (np.array([getattr(p, end) for p in self.experiment.parameters]) for end in ("low", "high"))
        start, size = self.experiment.start, self.sizes
        return (low - start) / size, (high - start) / size

    def values(self, z: Array) -> Array:
        """Convert z (p,) to parameter values in the units of the parameters."""
        return np.asarray(self.experiment.start + self.sizes * z)

    def errors(self, z: Array) -> list[Array]:
        """Return each run's residuals (kept samples, outputs): (prediction - log) / standard deviation of the log.

        The mean is subtracted from the residuals of outputs with unknown offset.
        """
        return [self._of_run(z, run) for run in self.runs]

    def _of_run(self, z: Array, run: Run) -> Array:
        """Return the residuals of one run (kept samples, outputs), as `errors` defines them."""
        predicted = self.experiment.predict(self.values(z), run)
        columns = []
        for channel in self.experiment.config.outputs:
            y = run.outputs[channel.name][run.kept]
            # prediction minus log, over the log's standard deviation
            e = predicted[channel.name][run.kept] - y
            columns.append((e - e.mean() if channel.offset is None else e) / y.std())
        return np.array(columns).T

    def slopes(self, z: Array, careful: bool = False) -> Array:
        """Return the derivatives (n, p) of all residuals by z, with the runs concatenated.

        careful: as in `Experiment.slopes`.
        """
        blocks = []
        for run in self.runs:
            columns, found = [], self.experiment.slopes(self.values(z), run, self.sizes, careful)
            for channel in self.experiment.config.outputs:
                d, scale = found[channel.name][run.kept], run.outputs[channel.name][run.kept].std()
                columns.append((d - d.mean(axis=0) if channel.offset is None else d) / scale)
            # order of rows: by instant, then by output
            blocks.append(np.stack(columns, axis=1).reshape(-1, len(z)))
        return np.concatenate(blocks)

    def priors(self, z: Array) -> Array:
        """Return the residuals (p,) of the priors: (value - mean) / standard deviation, 0 without a prior."""
        known = zip(self.experiment.parameters, self.values(z), strict=True)
        return np.array([0.0 if p.prior is None else (x - p.prior[0]) / p.prior[1] for p, x in known])

    def residuals(self, z: Array, noise: float) -> Array:
        """Return one vector with the residuals of all runs, followed by the priors' residuals times `noise`."""
        return np.concatenate([*(e.ravel() for e in self.errors(z)), noise * self.priors(z)])

    def jacobian(self, z: Array, noise: float) -> Array:
        """Return the derivatives of `residuals` by z, (n + p, p)."""
        known = zip(self.experiment.parameters, self.sizes, strict=True)
        # derivative of the priors, diagonal
        own = [0.0 if p.prior is None else noise * size / p.prior[1] for p, size in known]
        return np.concatenate([self.slopes(z), np.diag(own)])


@dataclass(frozen=True)
class Fit:
    """Result of a least-squares fit.

    z (p,): best parameters, scaled as in `Problem`. cost: sum of squared residuals. starts: final cost of the fit from
        each initial guess. evaluations: number of evaluations of the residuals. ended: the optimizer's final message.
        runs: number of simulations.
    by_differences: parameters whose derivatives are finite differences between simulations, each with the reason.
    """

    z: Array
    cost: float
    starts: tuple[float, ...]
    evaluations: int
    ended: str
    runs: int
    by_differences: Mapping[str, str]


class Solver:
    """Fit a problem from several initial guesses; save the progress in a file, from which the fit can resume."""

    def __init__(
        self, problem: Problem, *, progress: Callable[[float], None] | None = None, state: Path | None = None
    ) -> None:
        """Prepare a fit. progress: function that is called with the completed fraction of the fit. state: file of the
        saved state, or None.
        """
        self.problem, self.progress, self.state_file = problem, progress, state
        self.config = problem.experiment.config
        self.count, self.done = 0, 0.0
        self.key = self._key()
        self.state = self._read()

    def run(self) -> Fit:
        """Fit from all initial guesses with few evaluations; continue from the best result until convergence."""
        noise, costs = ROUGH, []
        for k, z in enumerate(self._starts()):
            found = self.state["starts"][k] if k < len(self.state["starts"]) else None
            if found is None:
                # short horizons first, except from the first start
                for share in HORIZONS if k > 0 else ():
                    z = self._least_squares(z, noise, FIRST, share)[0]
                z, cost, _ = self._least_squares(z, noise, FIRST)
                found = [cost, z.tolist()]
                self.state["starts"].append(found)
                self._keep()
            costs.append(found[0])
        # continue with the best start; priors are weighed again with the residuals' actual size
        best = self.state["starts"][int(np.argmin(costs))]
        z = np.array(self.state.get("best", best[1]))
        z, cost, ended = self._least_squares(z, noise, self.config.evaluations)
        if any(p.prior is not None for p in self.problem.experiment.parameters):
            errors = np.concatenate([e.ravel() for e in self.problem.errors(z)])
            z, cost, ended = self._least_squares(z, float(errors.std()), self.config.evaluations)
        self._show_share(1.0)
        own = self.problem.experiment
        return Fit(z, cost, tuple(costs), self.count, ended, own.runs, dict(own.by_differences))

    def _starts(self) -> list[Array]:
        """Return initial guesses z: the config's values twice (the second time for short horizons), then random
        values.
        """
        low, high = self.problem.bounds
        rng = np.random.default_rng(self.config.seed)
        n = len(low)
        drawn = [np.clip(SPREAD * rng.uniform(-1.0, 1.0, n), low, high) for _ in range(self.config.starts - 2)]
        return [np.zeros(n), np.zeros(n), *drawn][: self.config.starts]

    def polish(self, problem: Problem, z: Array, most: int) -> tuple[Array, float, str]:
        """Fit a slightly changed problem from an initial z near its solution; return z, cost and message.

        most: largest number of evaluations of the residuals.
        """
        errors = np.concatenate([e.ravel() for e in problem.errors(z)])
        return self._search(problem, z, float(errors.std()), most)

    def _least_squares(self, z: Array, noise: float, most: int, share: float = 1.0) -> tuple[Array, float, str]:
        """Fit from z with at most `most` evaluations; return z, cost and message. share: fraction of each run that is
        fitted.
        """
        problem = self.problem
        if share < 1.0:
            problem = Problem(problem.experiment, [run.until(share) for run in problem.runs])
        return self._search(problem, z, noise, most)

    def _search(self, problem: Problem, z: Array, noise: float, most: int) -> tuple[Array, float, str]:
        """Minimize the problem's residuals from z by a trust-region reflective method; return z, cost and message.

        noise: weight of the priors' residuals. most: largest number of evaluations of the residuals.
        """
        from scipy.optimize import least_squares

        low, high = problem.bounds

        def f(x: Array) -> Array:
            self.count += 1
            return problem.residuals(x, noise)

        def slopes(x: Array) -> Array:
            """Return the Jacobian of the residuals at the parameters x; during the final fit also save x to the state
            file.
            """
            # the final fit saves every iterate, so that it can be resumed
            if len(self.state["starts"]) == self.config.starts:  # the last fit, from the best of them
                self.state["best"] = x.tolist()
                self._keep()
            self._show_share(0.0)
            return problem.jacobian(x, noise)

        # the method needs a strictly interior start
        inside = np.clip(z, low + 1e-9 * (high - low), high - 1e-9 * (high - low))
        found = least_squares(f, inside, slopes, bounds=(low, high), method="trf", max_nfev=most, ftol=1e-6, xtol=1e-5)
        return found.x, 2.0 * float(found.cost), str(found.message).strip()

    def _show_share(self, share: float) -> None:
        """Report the progress: the share of completed evaluations, at least `share`."""
        if self.progress is not None:
            whole = FIRST * (4 * self.config.starts - 3) + self.config.evaluations
            self.done = max(self.done, share, min(self.count / whole, 0.99))
            self.progress(self.done)

    def _key(self) -> str:
        """Return a hash of the problem and its data, by which a saved state of another problem is recognized and
        ignored.
        """
        config = self.config
        seed = repr((config, self.problem.experiment.arm, self.problem.experiment.parameters)).encode()
        digest = hashlib.sha256(seed)
        for run in self.problem.runs:
            for column in (*run.inputs.values(), *run.outputs.values()):
                digest.update(column.tobytes())
        return digest.hexdigest()

    def _read(self) -> dict[str, Any]:
        """Return the saved state, or a new state if no file has a state of this problem."""
        fresh: dict[str, Any] = {"key": self.key, "starts": []}
        if self.state_file is None or not self.state_file.is_file():
            return fresh
        try:
            kept = json.loads(self.state_file.read_text("utf-8"))
        except ValueError:
            return fresh
        return kept if isinstance(kept, dict) and kept.get("key") == self.key else fresh

    def _keep(self) -> None:
        """Save the state of the fit, if a file for it was given."""
        if self.state_file is not None:
            write_whole(self.state_file, json.dumps(self.state).encode())
