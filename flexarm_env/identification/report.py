"""Result of an identification and its output: printed lines, a report page, an arm file, figures."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from flexarm_env import arms
from flexarm_env.files import write_json, write_text
from flexarm_env.parameters import Arm

from ..validation import Array
from .config import Config, Parameter
from .fit import Fit
from .log import Run
from .model import Experiment
from .signals import Ringing
from .uncertainty import Direction, Uncertainty


@dataclass(frozen=True)
class Prediction:
    """Prediction of one run by one model: readings (n,), VAF (%) and NRMSE (%) of each output.

    VAF is the variance accounted for. NRMSE is the root mean square error divided by the log's standard deviation.
    """

    run: Run
    readings: Mapping[str, Array]
    vaf: Mapping[str, float]
    nrmse: Mapping[str, float]


@dataclass(frozen=True, repr=False)
class Identification:
    """Result of an identification.

    Attributes:
        arm: the fitted arm, with the sensors of the given arm. given: the arm that was the initial guess of the fit.
        parameters: descriptions of the fitted parameters. values (p,): fitted values of the parameters. start (p,):
            values of the parameters in the given arm.
        uncertainty: uncertainty of the fitted values. verdict: "good", or a sentence that explains why the fit should
            not be trusted.
        train, held_out: the fitted arm's predictions of the fitted runs, and of the held-out runs (with nuisance
            parameters at their initial values). unfitted: the given arm's predictions of all fitted and held-out runs.
            baseline: for comparison, predictions of all runs by one linear oscillator for each output. oscillators:
            frequency (Hz) and damping ratio of each output's oscillator.
        frequencies, damping: natural frequencies (Hz) and damping ratios of the fitted arm with the prescribed joints
            held. seen: free vibrations (`Ringing`) that were measured in the runs, by output.
        fit: result of the least-squares fit. ranges: ranges of factors for the environments' option `randomization`.
            experiment: the fitted model, with the initial joint angles of the logs. files: log files of the runs.
    """

    arm: Arm
    given: Arm
    config: Config
    parameters: tuple[Parameter, ...]
    values: Array
    start: Array
    uncertainty: Uncertainty
    verdict: str
    train: tuple[Prediction, ...]
    held_out: tuple[Prediction, ...]
    unfitted: tuple[Prediction, ...]
    baseline: tuple[Prediction, ...]
    oscillators: Mapping[str, tuple[float, float]]
    frequencies: Array
    damping: Array
    seen: Mapping[str, Sequence[Ringing]]
    fit: Fit
    ranges: Mapping[str, tuple[float, float]]
    experiment: Experiment
    files: Mapping[str, str]

    def __repr__(self) -> str:
        """Show the arm's name, the verdict and the fitted values."""
        values = ", ".join(f"{p.name} {value:.4g}" for p, value in zip(self.parameters, self.values, strict=True))
        return f"<Identification of {self.given.name}: {self.verdict}; {values}>"

    @property
    def good(self) -> bool:
        """True if the fit can be trusted (the verdict is "good")."""
        return self.verdict == "good"

    def save(self, folder: str | os.PathLike[str]) -> None:
        """Write arm.toml, report.md, result.json and a figure of each run into a folder."""
        from flexarm_env.plotting import styled_figure

        home = Path(folder)
        write_text(home / "arm.toml", arm_text(self))
        write_text(home / "report.md", page(self))
        write_json(home / "result.json", self.lines())
        for row in (*self.train, *self.held_out):
            names = list(row.readings)
            with styled_figure(home / f"{row.run.stem}.png", 9.0, 2.6 * len(names)) as figure:
                draw(row, figure.subplots(2 * len(names), 1, sharex=True, height_ratios=[2, 1] * len(names)))

    def lines(self) -> dict[str, Any]:
        """Return the lines that `flexarm identify` prints, by name. Names without a prefix belong to held-out runs."""
        worth = self.uncertainty
        told: dict[str, Any] = {"verdict": self.verdict}
        # parameters with their 95 % half widths
        for p, value, half in zip(self.parameters, self.values, worth.half, strict=True):
            told[f"parameter.{p.name}"] = (
                f"{value:.6g} +- {half:.2g}" if np.isfinite(half) else f"{value:.6g} (at its bound)"
            )
        told["condition"] = worth.condition
        told["untold"] = ", ".join(worth.unidentifiable) or "none"
        # unidentifiable combinations, and the best known ones of the same parameters
        for i, (blind, known) in enumerate(_pairs(self)):
            told[f"untold.{i + 1}"] = f"{direction(blind)}; told: {direction(known) if known else 'nothing of it'}"
        told["evaluations"], told["runs"] = self.fit.evaluations, self.fit.runs
        told["by_differences"] = ", ".join(self.fit.by_differences) or "none"
        told["frequencies_hz"] = [round(float(f), 4) for f in self.frequencies]
        told["damping"] = [round(float(z), 5) for z in self.damping]
        n = len(self.train)
        # VAF and NRMSE of the fitted arm, of the given arm and of one oscillator per output
        for prefix, rows in (
            ("train.", self.train), ("unfitted.train.", self.unfitted[:n]), ("baseline.train.", self.baseline[:n]),
            ("unfitted.", self.unfitted[n:]), ("baseline.", self.baseline[n:]),
            ("", self.held_out),
        ):  # fmt: skip
            for row in rows:
                told |= {f"{prefix}vaf.{row.run.stem}.{name}": round(value, 3) for name, value in row.vaf.items()}
                if prefix in ("train.", ""):
                    told |= {f"{prefix}nrmse.{row.run.stem}.{name}": round(v, 3) for name, v in row.nrmse.items()}
        return told


def _pairs(result: Identification) -> list[tuple[Direction, Direction | None]]:
    """Pair each unidentifiable direction with the best known combination of the same parameters, or with None."""
    worth = result.uncertainty
    by_names = {frozenset(known.shares): known for known in worth.identifiable}
    return [(blind, by_names.get(frozenset(blind.shares))) for blind in worth.directions]


def direction(of: Direction) -> str:
    """Format a combination of parameters and half its 95 % interval, such as "EI_1 +1.00, elbow +0.97 (+-0.004)"."""
    parts = ", ".join(f"{name} {share:+.2f}" for name, share in of.shares.items())
    return f"{parts} (+-{of.deviation:.2g})"


def draw(row: Prediction, axes: Any) -> None:
    """Plot each output's measured and predicted readings in a run, and the prediction error below the readings."""
    run = row.run
    for k, name in enumerate(row.readings):
        above, below = axes[2 * k], axes[2 * k + 1]
        # a wide gray line stays visible under a good fit
        above.plot(run.t, run.outputs[name], lw=2.6, color="#9a9a9a", label="measured")  # wide: seen under a good fit
        above.plot(run.t, row.readings[name], lw=0.9, color="#d1591b", label="predicted")
        above.set_title(f"{run.stem}, {name}: {row.vaf[name]:.1f} % of the variance")
        below.plot(run.t, run.outputs[name] - row.readings[name], lw=0.8, color="#1f5fa8", label="residual")
        for axis in (above, below):
            # samples that are not compared
            axis.axvspan(0.0, run.t[~run.kept].max(initial=0.0), color="#eeeeee", lw=0)
            axis.legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=2, frameon=False)
    axes[-1].set_xlabel("t (s)")


def arm_text(result: Identification) -> str:
    """Format the fitted arm as a TOML file: [arm] with its source, [randomization], [identification]."""
    import tomli_w

    table = arms.to_table(result.arm)
    trained = ", ".join(result.files[row.run.stem] for row in result.train)
    paths = ", ".join(
        p.path for p in result.parameters if not p.path.startswith(("inputs", "outputs", "loads", "gravity"))
    )
    table["source"] = (
        f"flexarm identify on {datetime.now(UTC):%Y-%m-%d}: {paths} fitted to {trained}; the rest is that of "
        f"{result.given.name}: {result.given.source}"
    )
    own = {
        "verdict": result.verdict,
        "parameters": [
            {"path": p.path, "value": float(x), **({"half": float(h)} if np.isfinite(h) else {"at_bound": True})}
            for p, x, h in zip(result.parameters, result.values, result.uncertainty.half, strict=True)
        ],
        "vaf_train": {row.run.stem: dict(row.vaf) for row in result.train},
        "vaf_held_out": {row.run.stem: dict(row.vaf) for row in result.held_out},
    }
    ranges = {key: list(value) for key, value in result.ranges.items()}
    return tomli_w.dumps({"arm": table, "randomization": ranges, "identification": own})


def table_of(header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Format a Markdown table."""
    text = ["| " + " | ".join(map(str, row)) + " |" for row in (header, ["---"] * len(header), *rows)]
    return "\n".join(text)


def page(result: Identification) -> str:
    """Format the report as Markdown: parameters, correlations, predictions, frequencies and damping."""
    worth = result.uncertainty
    rows = [
        (f"`{p.path}`", p.name if p.name != p.path else "", f"{x0:.4g}", f"{x:.5g}",
         f"± {h:.2g}" if np.isfinite(h) else "at its bound", "no" if p.name in worth.unidentifiable else "yes")
        for p, x0, x, h in zip(result.parameters, result.start, result.values, worth.half, strict=True)
    ]  # fmt: skip
    parts = [
        f"# {result.arm.name}, identified",
        f"Verdict: **{result.verdict}**",
        "## Parameters",
        table_of(("key path", "name", "before", "fitted", "95 % interval", "told"), rows),
        f"Condition of the derivatives by parameters in their sizes: {worth.condition:.3g}. Residuals: "
        f"{100 * worth.noise:.2g} % of the readings' standard deviation; they amount to {worth.samples:.0f} "
        "independent samples.",
        _correlations(result),
    ]
    # nuisance parameters belong to the fitted runs only
    own = [f"`{p.path}`" for p in result.parameters if p.nuisance]
    if own:
        parts.append(f"{', '.join(own)}: of the fitted runs alone; runs held out are predicted without.")
    for blind, known in _pairs(result):
        parts.append(f"Not told: {direction(blind)}: changes that hardly show, together, in shares of each one's size.")
        if known:
            parts.append(f"What is told of these: the sum of changes weighed {direction(known)}.")
    names = [c.name for c in result.config.outputs]
    n = len(result.train)
    judged: list[tuple[str, ...]] = []
    for i, row in enumerate((*result.train, *result.held_out)):
        for kind, of in (("fitted", row), ("before", result.unfitted[i]), ("one oscillator", result.baseline[i])):
            judged.append((
                row.run.stem, "training" if i < n else "held out", kind,
                *(f"{of.vaf[name]:.1f} / {of.nrmse[name]:.1f}" for name in names),
            ))  # fmt: skip
    parts += ["## Prediction: variance accounted for / NRMSE, %", table_of(("run", "", "model", *names), judged)]
    parts += ["## Frequencies and damping", _vibration(result)]
    parts += [f"![{row.run.stem}]({row.run.stem}.png)" for row in (*result.train, *result.held_out)]
    return "\n\n".join(parts) + "\n"


def _correlations(result: Identification) -> str:
    """Format the lower triangle of the correlation matrix as a Markdown table."""
    names, c = [p.name for p in result.parameters], result.uncertainty.correlation
    # lower triangle, padded to full rows
    rows = [(name, *(f"{c[i, j]:+.2f}" for j in range(i + 1))) for i, name in enumerate(names)]
    return table_of(("correlation", *names), [(*row, *[""] * (len(names) + 1 - len(row))) for row in rows])


def _vibration(result: Identification) -> str:
    """Format a table of frequencies (Hz) and damping ratios of the fitted arm, of the oscillators and of measured
    vibrations.
    """
    rows = [(f"fitted arm, mode {k + 1}, prescribed joints held", f"{f:.3f}", f"{z:.4f}", "")
            for k, (f, z) in enumerate(zip(result.frequencies, result.damping, strict=True))]  # fmt: skip
    rows += [(f"one oscillator, {name}", f"{f:.3f}", f"{z:.4f}", "") for name, (f, z) in result.oscillators.items()]
    for name, seen in result.seen.items():
        rows += [
            (f"read off {name} at {r.start:.1f} s", f"{r.frequency:.3f}", f"{r.damping:.4f}", f"{r.amplitude:.3g}")
            for r in seen
        ]
    return table_of(("", "Hz", "damping ratio", "amplitude"), rows)
