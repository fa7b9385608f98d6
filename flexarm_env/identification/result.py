"""Complete identification: read logs, fit parameters, estimate their uncertainty, and evaluate predictions."""

import dataclasses
import os
from collections.abc import Callable, Mapping, Sequence
from itertools import combinations
from pathlib import Path

import numpy as np

from flexarm_env import arms
from flexarm_env import validation as check
from flexarm_env.bodies import SPACE
from flexarm_env.files import read_toml
from flexarm_env.linear import modes
from flexarm_env.parameters import Arm
from flexarm_env.scene import Scene

from ..validation import Array
from .channels import deviations
from .config import Config, Parameter, read_config
from .discretization import Resolved, resolve
from .fit import Fit, Problem, Solver
from .log import BadLog, Run, read_run
from .model import Experiment
from .report import Identification, Prediction
from .signals import nrmse, oscillator, read_off, vaf
from .uncertainty import Uncertainty

FAR_OFF = 100.0
"""Ratio of a log's readings to the arm's readings, or its inverse, above which the log must be in another unit."""


def identify(
    arm: Arm | str | os.PathLike[str],
    config: Config | str | os.PathLike[str],
    data: Sequence[str | os.PathLike[str]],
    *,
    fit: Sequence[str] | None = None,
    hold_out: Sequence[str | os.PathLike[str]] = (),
    out: str | os.PathLike[str] | None = None,
    progress: Callable[[float], None] | None = None,
) -> Identification:
    """Fit an arm to logs and evaluate the arm on other logs.

    Args:
        arm: initial guess of the arm: an `Arm`, a name or a TOML file. config: configuration of the fit: a TOML file or
            its text.
        data: CSV files of the logs that are fitted. hold_out: CSV files of the logs that are only predicted. fit: names
            or key paths of the parameters to fit; None for the parameters that the config selects. out: folder for the
            result (`Identification.save`) and for the progress of the fit, from which an interrupted fit resumes.
        progress: function that is called with the completed share of the fit, 0 to 1.
    Raises:
        ValueError: a value is invalid; the message names its key path. BadLog (a ValueError): a log is unusable; the
            message names file, column and row. OSError: a file cannot be read or written.
    """
    given = arms.resolve(arm)
    setup = read_config(config, given)
    parameters = setup.chosen(None if fit is None else tuple(fit))
    runs = [read_run(path, setup) for path in data]
    others = [read_run(path, setup) for path in hold_out]
    if not runs:
        raise check.InvalidValue("data", list(data), "must name at least one log")
    stems = [run.stem for run in (*runs, *others)]
    for stem in stems:
        if stems.count(stem) > 1:
            raise check.InvalidValue("data", stem, "must be given once: logs must have different names")
    files = {run.stem: os.fspath(p) for run, p in zip((*runs, *others), (*data, *hold_out), strict=True)}
    experiment = Experiment(given, setup, parameters, [run.stem for run in runs])
    for run in (*runs, *others):
        _units(experiment, run, files[run.stem])
    problem = Problem(experiment, runs)
    state = None if out is None else Path(out) / "fit.json"
    solver = Solver(problem, progress=progress, state=state)
    resolved = resolve(solver, solver.run())
    problem, experiment, best, whole = resolved.problem, resolved.problem.experiment, resolved.fit, resolved.uncertainty
    # the joints' initial angles follow the fitted parameters; they are not reported
    values, n = problem.values(best.z), len(parameters)
    worth = dataclasses.replace(whole, half=whole.half[:n], correlation=whole.correlation[:n, :n])
    everything = (*runs, *others)
    train = tuple(_judged(run, experiment.predict(values, run), setup) for run in runs)
    held = tuple(_judged(run, experiment.predict(experiment.elsewhere(values), run), setup) for run in others)
    before = Experiment(given, setup, ())
    unfitted = tuple(_judged(run, before.predict(np.zeros(0), run), setup) for run in everything)
    assert setup.sensors is not None
    laws = {name: law for name, (_, law) in setup.sensors.readings(given, setup.axes).items()}
    simple = {c.name: oscillator(runs, c.name, laws[c.name]) for c in setup.outputs}
    baseline = tuple(_judged(run, {n: o.predict(run) for n, o in simple.items()}, setup) for run in everything)
    found = experiment.arm_of(values)
    # modes of the fitted arm with the prescribed joints held
    frequencies, damping = _modes(found, setup)
    result = Identification(
        arm=dataclasses.replace(found, sensors=given.sensors), given=given, config=setup, parameters=parameters,
        values=values[:n], start=experiment.start[:n], uncertainty=worth,
        verdict=_verdict(resolved, train, baseline), train=train, held_out=held, unfitted=unfitted,
        baseline=baseline, oscillators={name: (o.frequency, o.damping) for name, o in simple.items()},
        frequencies=frequencies, damping=damping,
        seen={c.name: [r for run in everything for r in read_off(run, c.name)] for c in setup.outputs},
        fit=best, ranges=_ranges(parameters, values[:n], worth), experiment=experiment, files=files,
    )  # fmt: skip
    if out is not None:
        result.save(out)
    return result


def _units(experiment: Experiment, run: Run, where: str) -> None:
    """Raise BadLog if a log seems to be in another unit than the config's, compared with the arm's own motion."""
    for name, values in run.inputs.items():
        if name.startswith(("joint", "motor")) and np.abs(values).max() > 100.0:
            raise BadLog(f"{where}: {name} reaches {np.abs(values).max():.4g} rad: another unit than the config says?")
    predicted = experiment.predict(experiment.start, run)
    for channel in experiment.config.outputs:
        y, own = run.outputs[channel.name], predicted[channel.name]
        # ratio of standard deviations, log over arm
        ratio = float(np.std(y[run.kept])) / max(float(np.std(own[run.kept])), 1e-300)
        if not 1.0 / FAR_OFF < ratio < FAR_OFF:
            angle = ", ".join(f"{c.column!r}" for c in experiment.config.inputs)
            raise BadLog(
                f"{where}: column {channel.column!r} moves {ratio:.3g} times as much as this arm's {channel.name} "
                f"would: is it, {angle} or {experiment.config.time.column!r} in another unit than the config says?"
            )


def _judged(run: Run, readings: Mapping[str, Array], config: Config) -> Prediction:
    """Return VAF and NRMSE, %, by output, of predicted readings of a run; a fitted offset is added to the readings."""
    explained, error, shown = {}, {}, {}
    for channel in config.outputs:
        y, own = run.outputs[channel.name], readings[channel.name]
        if channel.offset is None:
            own = own + float(np.mean((y - own)[run.kept]))
        shown[channel.name] = own
        explained[channel.name] = vaf(y[run.kept], own[run.kept])
        error[channel.name] = nrmse(y[run.kept], own[run.kept], False)
    return Prediction(run, shown, explained, error)


def _modes(arm: Arm, config: Config) -> tuple[Array, Array]:
    """Return frequencies, Hz, and damping ratios of the straight arm's modes while the prescribed joints are held."""
    held = tuple(c.joint for c in config.inputs if c.moves)
    solver = {key: value for key, value in config.solver.items() if key not in ("formulation", "dt")}
    rest = Scene("rest", arm, duration=1.0, dt=0.005, space=config.axes == SPACE)
    try:
        found = modes(rest, 4, config.solver["formulation"], clamped=held, **solver)
    except ValueError:  # an elastic gear with a massless, undriven motor
        return np.zeros(0), np.zeros(0)
    moving = found.frequencies > 1e-6
    return found.frequencies[moving] / (2.0 * np.pi), found.damping[moving]


BEATEN = 4.0
"""A fit is poor if its unexplained variance exceeds both 2 % and `BEATEN` times that of one oscillator per output."""


def _verdict(resolved: Resolved, train: Sequence[Prediction], baseline: Sequence[Prediction]) -> str:
    """Return "good", or a sentence that starts with "poor" or "suspect" and explains why."""
    problem, best = resolved.problem, resolved.fit
    least = problem.experiment.config.good
    poor = [f"{p.vaf[n]:.1f} % of {n} in {p.run.stem}" for p in train for n in p.vaf if not p.vaf[n] >= least]
    # tests in order of severity: swapped columns, low VAF, worse than one oscillator, coarse mesh, contradicting
    # columns
    swapped = _swapped(problem, best)
    if swapped:
        return f"poor: the readings follow {swapped} better: are columns swapped?"
    if poor:
        return f"poor: the fitted arm explains only {', '.join(poor)}; a good fit explains {least:g} %"
    for p, simple in zip(train, baseline, strict=False):
        for n, share in p.vaf.items():
            if 100.0 - share > max(2.0, BEATEN * (100.0 - simple.vaf[n])):
                what = f"explains {share:.1f} % of {n} in {p.run.stem}, one oscillator {simple.vaf[n]:.1f} %"
                return f"poor: the fitted arm {what}: a number that is not fitted may be wrong"
    if resolved.coarse:
        what = f"time step and mesh move {', '.join(resolved.coarse)} by more than the 95 % interval"
        return f"poor: {what}: take a smaller `dt` or a finer mesh in [solver]"
    told = [one for one in deviations(problem, best.z) if one.contradicts]
    return f"suspect: {told[0].sentence}: {told[0].remedy}" if told else "good"


def _swapped(problem: Problem, best: Fit) -> str:
    """Return a sentence on two columns whose exchange would fit better, or "".

    For the exchanged columns the parameters are adjusted to first order.
    """
    pairs = combinations(problem.experiment.config.outputs, 2)
    # only outputs of the same kind can be confused
    alike = [(a, b) for a, b in pairs if a.name.split("_")[:2] == b.name.split("_")[:2]]
    if not alike:
        return ""

    def errors(runs: Sequence[Run], z: Array) -> Array:
        """Return the residuals of several runs at the parameters z, concatenated."""
        return np.concatenate([e.ravel() for e in Problem(problem.experiment, runs).errors(z)])

    J = problem.slopes(best.z)
    own = float(np.square(errors(problem.runs, best.z)).sum())
    for a, b in alike:
        changed = []
        for run in problem.runs:
            outputs = {**run.outputs, a.name: run.outputs[b.name], b.name: run.outputs[a.name]}
            changed.append(dataclasses.replace(run, outputs=outputs))
        # residual after one Gauss-Newton step
        e = errors(changed, best.z)
        if float(np.square(e - J @ np.linalg.lstsq(J, e, rcond=None)[0]).sum()) < 0.7 * own:
            return f"{b.column!r} and {a.column!r} the other way round"
    return ""


# ------------------------------------------------------------------------------------------------- randomization
def _ranges(parameters: Sequence[Parameter], values: Array, worth: Uncertainty) -> dict[str, tuple[float, float]]:
    """Return ranges of factors on the fitted arm for `randomization`: for each key, the widest 95 % interval of its
    parameters.
    """
    kinds = {"EI": "EI", "payload": "mass", "damping": "tau_d", "torque_constant": "torque_constant"}
    found: dict[str, tuple[float, float]] = {}
    for p, value, half in zip(parameters, values, worth.half, strict=True):
        for key, word in kinds.items():
            mine = p.path.endswith(f".{word}") or p.path == word
            if mine and (key != "payload" or p.path.startswith("payload")) and value > 0.0 and np.isfinite(half):
                share = min(half / value, 0.5)
                low, high = found.get(key, (1.0, 1.0))
                found[key] = float(min(low, round(1.0 - share, 4))), float(max(high, round(1.0 + share, 4)))
    return found


def randomization(path: str | os.PathLike[str]) -> dict[str, tuple[float, float]]:
    """Read the ranges for an environment's option `randomization` from an arm.toml that `identify` wrote.

    Raises ValueError if the file has no valid ranges.
    """
    table, _ = read_toml(path)
    with check.in_file(path):
        ranges = check.table_of("randomization", check.needed("", table, "randomization", "must be a table of ranges"))
        return {key: check.limits(f"randomization.{key}", limits) for key, limits in ranges.items()}
