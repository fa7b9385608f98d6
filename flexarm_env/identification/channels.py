"""Test a log for wrong gains, delayed readings and a clock with a wrong rate.

Each test adds one parameter e, such as the relative error of a gain, to a finished fit. To first order the
least-squares estimate of e is the last component of -(K'K)^-1 K' r. Here r is the vector of residuals, and K = [J, g]
contains the derivatives of r by the fitted parameters (J) and by e (g). A column is suspect if e exceeds `CERTAIN` half
widths of its 95 % confidence interval and also exceeds `Deviation.least`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..validation import Array
from .fit import Problem
from .uncertainty import interval_of_last

CERTAIN = 2.0
"""A deviation is significant if it exceeds `CERTAIN` times the half width of its 95 % interval."""

LEAST_GAIN = 0.02
LEAST_DELAY = 0.25
"""Smallest reported delay of a column, in sampling intervals of the log."""
LEAST_CLOCK = 0.005
"""Smallest relative errors that are reported: LEAST_CLOCK of the clock's rate, LEAST_GAIN of a column's gain."""

CLOCK_STEP = 1e-4
"""Relative change of the time axis for the finite difference by the clock's rate."""


@dataclass(frozen=True)
class Deviation:
    """Estimated error in the config's description of a column of the log.

    Attributes:
        value: the estimated deviation, as a relative error or in s. half: half width of the deviation's 95 % confidence
            interval. least: smallest deviation that is reported, in the same unit.
        sentence: sentence that describes the deviation with numbers. remedy: advice to the user.
    """

    value: float
    half: float
    least: float
    sentence: str
    remedy: str

    @property
    def contradicts(self) -> bool:
        """True if the deviation is statistically significant and at least `least`."""
        return abs(self.value) > max(CERTAIN * self.half, self.least)


Candidate = tuple[float, str, str, list[Array]]
"""Candidate for a deviation: its smallest value that matters, sentence with a placeholder, remedy, and derivatives of
each run's residuals (kept, outputs)."""


def deviations(problem: Problem, z: Array) -> list[Deviation]:
    """Estimate errors of the clock and of each output's gain and delay; return the most significant error first.

    Gains and delays that are parameters of the fit are omitted. z (p,): fitted parameters, scaled as in `Problem`.
    """
    J, errors = problem.slopes(z), problem.errors(z)
    found = []
    # append each candidate's derivative g to J; its Gauss-Newton value and interval
    for least, sentence, remedy, columns in (*_of_outputs(problem, z), _of_clock(problem, z)):
        g = np.concatenate([column.ravel() for column in columns])
        if np.isfinite(g).all() and g.any():
            value, half = interval_of_last(np.column_stack([J, g]), errors)
            found.append(Deviation(value, half, least, _sentence(sentence, value, half), remedy))
    return sorted(found, key=lambda one: -abs(one.value) / max(one.half, 1e-300))


def _sentence(pattern: str, value: float, half: float) -> str:
    """Return a sentence from a pattern: insert the value in ms at "[ms]" or in % at "[%]", and the word for its sign at
    "{less|more}".
    """
    scale, unit = (1e3, "ms") if "[ms]" in pattern else (100.0, "%")
    less, more = pattern[pattern.index("{") + 1 : pattern.index("}")].split("|")
    pattern = pattern.replace(f"[{unit}]", f"{scale * abs(value):.3g} +- {scale * half:.2g} {unit}")
    return pattern.replace(f"{{{less}|{more}}}", more if value > 0.0 else less)


def _of_outputs(problem: Problem, z: Array) -> Iterator[Candidate]:
    """Yield for each output a `Candidate` for a gain error and one for a delay, unless these are fitted."""
    experiment = problem.experiment
    outputs = experiment.config.outputs
    predicted = [experiment.predict(problem.values(z), run) for run in problem.runs]
    for k, channel in enumerate(outputs):
        name, column = channel.name, channel.column
        own = [p.path for p in experiment.parameters if name in p.path]
        readings = [one[name] for one in predicted]
        # a gain changes the reading in proportion
        if not any(path.endswith("gain") for path in own):
            sentence = f"column {column!r} reads [%] {{less|more}} than the fitted arm's {name}"
            remedy = f"check its unit and scale, or fit `outputs.{name}.gain`"
            yield LEAST_GAIN, sentence, remedy, _of_one(problem, k, readings)
        if not any(path.endswith(("shift", "delay")) for path in own):
            sentence = f"column {column!r} comes [ms] {{earlier|later}} than the fitted arm's {name}"
            remedy = f"check its timing, or fit `outputs.{name}.shift`"
            # a delay changes the reading by minus its rate
            rates = [-np.gradient(y, run.t) for y, run in zip(readings, problem.runs, strict=True)]
            yield LEAST_DELAY * problem.runs[0].period, sentence, remedy, _of_one(problem, k, rates)


def _of_one(problem: Problem, k: int, changes: list[Array]) -> list[Array]:
    """Return the derivative of each run's residuals (kept samples, outputs) by an error of output k alone.

    changes: for each run the change (n,) of the output.
    """
    blocks, outputs = [], problem.experiment.config.outputs
    for run, change in zip(problem.runs, changes, strict=True):
        # residuals are relative to the reading's standard deviation; a fitted offset removes the mean
        kept, y = change[run.kept], run.outputs[outputs[k].name][run.kept]
        block = np.zeros((len(kept), len(outputs)))
        block[:, k] = (kept - kept.mean() if outputs[k].offset is None else kept) / y.std()
        blocks.append(block)
    return blocks


def _of_clock(problem: Problem, z: Array) -> Candidate:
    """Return the `Candidate` for a clock that is fast by the fraction e. The derivative of the residuals is that of a
    stretched time axis.
    """
    longer = [dataclasses.replace(run, t=run.t * (1.0 + CLOCK_STEP)) for run in problem.runs]
    pairs = zip(Problem(problem.experiment.anew(), longer).errors(z), problem.errors(z), strict=True)
    column = problem.experiment.config.time.column
    sentence = f"the clock of column {column!r} runs [%] {{fast|slow}} against the fitted arm"
    return LEAST_CLOCK, sentence, "check its unit and rate", [(there - here) / CLOCK_STEP for there, here in pairs]
