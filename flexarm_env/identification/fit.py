"""Least squares: parameters for which an arm's readings come closest to those of the logs."""

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
"""Evaluations that each start gets before the best of them goes on alone."""

HORIZONS = (0.05, 0.15, 0.4)
"""Shares of the readings' variance up to which a run is fitted before all of it is. What rings for many periods fits
in many wrong places where some periods more or less hardly matter; a few periods fit in one."""

SPREAD = 0.5
"""Further starts are drawn so many sizes around the first."""

ROUGH = 0.1
"""What is taken for the relative size of residuals, as priors weigh against them, before it is known."""


@dataclass(frozen=True)
class Problem:
    """Residuals over parameters z = (value - start) / size, relative to each reading's standard deviation."""

    experiment: Experiment
    runs: Sequence[Run]

    @property
    def sizes(self) -> Array:
        """What a change of 1 in z is."""
        found = []
        for p, x in zip(self.experiment.parameters, self.experiment.start, strict=True):
            found.append(p.size or abs(x) or 0.1 * (p.high - p.low))
        return np.array(found)

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Of z."""
        low, high = (np.array([getattr(p, end) for p in self.experiment.parameters]) for end in ("low", "high"))
        start, size = self.experiment.start, self.sizes
        return (low - start) / size, (high - start) / size

    def values(self, z: Array) -> Array:
        """The parameters themselves."""
        return np.asarray(self.experiment.start + self.sizes * z)

    def errors(self, z: Array) -> list[Array]:
        """Prediction less log of each run (kept, outputs), over the log's standard deviation, offsets taken out."""
        return [self._of_run(z, run) for run in self.runs]

    def _of_run(self, z: Array, run: Run) -> Array:
        predicted = self.experiment.predict(self.values(z), run)
        columns = []
        for channel in self.experiment.config.outputs:
            y = run.outputs[channel.name][run.kept]
            e = predicted[channel.name][run.kept] - y
            columns.append((e - e.mean() if channel.offset is None else e) / y.std())
        return np.array(columns).T

    def slopes(self, z: Array, careful: bool = False) -> Array:
        """Derivatives of all errors in a row by z, (n, p); careful: see `Experiment.slopes`."""
        blocks = []
        for run in self.runs:
            columns, found = [], self.experiment.slopes(self.values(z), run, self.sizes, careful)
            for channel in self.experiment.config.outputs:
                d, scale = found[channel.name][run.kept], run.outputs[channel.name][run.kept].std()
                columns.append((d - d.mean(axis=0) if channel.offset is None else d) / scale)
            blocks.append(np.stack(columns, axis=1).reshape(-1, len(z)))  # an instant's outputs follow each other
        return np.concatenate(blocks)

    def priors(self, z: Array) -> Array:
        """(value - mean) / deviation where there is a prior, otherwise 0."""
        known = zip(self.experiment.parameters, self.values(z), strict=True)
        return np.array([0.0 if p.prior is None else (x - p.prior[0]) / p.prior[1] for p, x in known])

    def residuals(self, z: Array, noise: float) -> Array:
        """All of them in a row, the priors at the end."""
        return np.concatenate([*(e.ravel() for e in self.errors(z)), noise * self.priors(z)])

    def jacobian(self, z: Array, noise: float) -> Array:
        """Their derivatives by z."""
        known = zip(self.experiment.parameters, self.sizes, strict=True)
        own = [0.0 if p.prior is None else noise * size / p.prior[1] for p, size in known]
        return np.concatenate([self.slopes(z), np.diag(own)])


@dataclass(frozen=True)
class Fit:
    """The best z, its cost, the costs of all starts, how many evaluations they took and how the last one ended; runs of
    the arm, and parameters that were differentiated by runs of their own, with the reason."""

    z: Array
    cost: float
    starts: tuple[float, ...]
    evaluations: int
    ended: str
    runs: int
    by_differences: Mapping[str, str]


class Solver:
    """Fits a problem from several starts; keeps what it has in a file, from which it goes on."""

    def __init__(
        self, problem: Problem, *, progress: Callable[[float], None] | None = None, state: Path | None = None
    ) -> None:
        self.problem, self.progress, self.state_file = problem, progress, state
        self.config = problem.experiment.config
        self.count, self.done = 0, 0.0
        self.key = self._key()
        self.state = self._read()

    def run(self) -> Fit:
        """The best fit of all starts."""
        noise, costs = ROUGH, []
        for k, z in enumerate(self._starts()):
            found = self.state["starts"][k] if k < len(self.state["starts"]) else None
            if found is None:
                for share in HORIZONS if k > 0 else ():
                    z = self._least_squares(z, noise, FIRST, share)[0]
                z, cost, _ = self._least_squares(z, noise, FIRST)
                found = [cost, z.tolist()]
                self.state["starts"].append(found)
                self._keep()
            costs.append(found[0])
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
        low, high = self.problem.bounds
        rng = np.random.default_rng(self.config.seed)
        n = len(low)
        drawn = [np.clip(SPREAD * rng.uniform(-1.0, 1.0, n), low, high) for _ in range(self.config.starts - 2)]
        return [np.zeros(n), np.zeros(n), *drawn][: self.config.starts]

    def _least_squares(self, z: Array, noise: float, most: int, share: float = 1.0) -> tuple[Array, float, str]:
        """The best z from a z, its cost, how it ended; share: of the runs that are fitted."""
        from scipy.optimize import least_squares

        problem = self.problem
        if share < 1.0:
            problem = Problem(problem.experiment, [run.until(share) for run in problem.runs])
        low, high = problem.bounds

        def f(x: Array) -> Array:
            self.count += 1
            return problem.residuals(x, noise)

        def slopes(x: Array) -> Array:
            if len(self.state["starts"]) == self.config.starts:  # the last fit, from the best of them
                self.state["best"] = x.tolist()
                self._keep()
            self._show_share(0.0)
            return problem.jacobian(x, noise)

        inside = np.clip(z, low + 1e-9 * (high - low), high - 1e-9 * (high - low))
        found = least_squares(f, inside, slopes, bounds=(low, high), method="trf", max_nfev=most, ftol=1e-6, xtol=1e-5)
        return found.x, 2.0 * float(found.cost), str(found.message).strip()

    def _show_share(self, share: float) -> None:
        if self.progress is not None:
            whole = FIRST * (4 * self.config.starts - 3) + self.config.evaluations
            self.done = max(self.done, share, min(self.count / whole, 0.99))
            self.progress(self.done)

    def _key(self) -> str:
        """Of what is fitted to what: a kept state of something else is not gone on from."""
        config = self.config
        seed = repr((config, self.problem.experiment.arm, self.problem.experiment.parameters)).encode()
        digest = hashlib.sha256(seed)
        for run in self.problem.runs:
            for column in (*run.inputs.values(), *run.outputs.values()):
                digest.update(column.tobytes())
        return digest.hexdigest()

    def _read(self) -> dict[str, Any]:
        fresh: dict[str, Any] = {"key": self.key, "starts": []}
        if self.state_file is None or not self.state_file.is_file():
            return fresh
        try:
            kept = json.loads(self.state_file.read_text("utf-8"))
        except ValueError:
            return fresh
        return kept if isinstance(kept, dict) and kept.get("key") == self.key else fresh

    def _keep(self) -> None:
        if self.state_file is not None:
            write_whole(self.state_file, json.dumps(self.state).encode())
