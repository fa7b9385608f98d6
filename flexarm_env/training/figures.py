"""Figures of learning curves, and of episodes under several controllers."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from flexarm_env.plotting import COLORS, styled_figure
from flexarm_env.training.episodes import Episodes


def learning_curve(curves: Sequence[Sequence[Mapping[str, float]]], path: Path, title: str = "") -> None:
    """Plot success rate, settling time and return over environment steps, for one run or for runs of several seeds.

    With several runs the figure also shows the median of the runs. curves: for each run, the rows of its learning
    curve.
    """
    shown = {"success_rate": "success rate", "settling_median": "median settling (s)", "return_mean": "mean return"}
    with styled_figure(path, 7.0, 7.8) as figure:
        axes = figure.subplots(3, 1, sharex=True)
        for ax, (key, label) in zip(axes, shown.items(), strict=True):
            for rows in curves:
                x, y = [row["steps"] / 1e3 for row in rows], [row[key] for row in rows]
                ax.plot(x, y, color=COLORS[0], linewidth=1.6 if len(curves) == 1 else 0.8, alpha=0.8)
            if len(curves) > 1:
                grid = sorted({row["steps"] for rows in curves for row in rows})
                lines = [np.interp(grid, [r["steps"] for r in rows], [r[key] for r in rows]) for rows in curves]
                label_all = f"median of {len(curves)} seeds"
                ax.plot(np.asarray(grid) / 1e3, np.median(lines, axis=0), color=COLORS[1], lw=2.0, label=label_all)
            ax.set_ylabel(label)
        if len(curves) > 1:
            axes[0].legend(loc="lower right")
        axes[0].set(ylim=(-0.03, 1.03), title=title)
        axes[1].set_yscale("log")
        axes[1].yaxis.set_major_formatter("{x:g}")
        axes[1].yaxis.set_minor_formatter("{x:g}")
        axes[1].tick_params(axis="y", which="minor", labelsize="x-small")
        axes[-1].set_xlabel("environment steps (thousands)")


def tip_errors(results: Mapping[str, Episodes], episode: int, path: Path, title: str = "") -> None:
    """Plot the tip error over time in one episode under each controller, on a linear and on a logarithmic axis."""
    first = next(iter(results.values()))
    slew = first.task == "slew"
    factor, unit = (180.0 / np.pi, "deg") if slew else (1000.0, "mm")
    until = 2.0 * max(float(result.settling[episode]) for result in results.values())
    with styled_figure(path, 7.0, 5.2) as figure:
        axes = figure.subplots(2, 1, sharex=True)
        for k, (name, result) in enumerate(results.items()):
            errors = result.errors[:, episode] * factor
            for ax in axes:
                style = "--" if k >= len(COLORS) else "-"
                ax.plot(np.arange(len(errors)) * result.dt, errors, style, color=COLORS[k % len(COLORS)], label=name)
                ax.set_ylabel(f"tip error ({unit})")
        axes[1].set(xlim=(0.0, min(until, (len(first.errors) - 1) * first.dt)), yscale="log", xlabel="time (s)")
        axes[1].set_ylim(bottom=1e-2 * (1.0 if slew else 10.0))
        axes[0].legend(ncols=2)
        axes[0].set_title(title)


def compared(
    rows: Sequence[Mapping[str, Any]], varied: Sequence[str], quantities: Mapping[str, str], path: Path, title: str = ""
) -> None:
    """Plot measured quantities over varied settings, with a column of panels for each setting.

    Each dot is a run, and a line connects the means of the runs with equal settings.
    """
    keys = list(quantities)
    with styled_figure(path, max(4.6, 3.4 * len(varied)), 1.9 * len(keys)) as figure:
        axes = figure.subplots(len(keys), len(varied), sharex="col", sharey="row", squeeze=False)
        for column, name in enumerate(varied):
            values = list(dict.fromkeys(str(row[name]) for row in rows))
            for ax, key in zip(axes[:, column], keys, strict=True):
                groups = [[float(row[key]) for row in rows if str(row[name]) == value] for value in values]
                for x, group in enumerate(groups):
                    ax.plot([x] * len(group), group, "o", color=COLORS[0], alpha=0.7, markersize=5)
                ax.plot(range(len(values)), [np.mean(group) for group in groups], color=COLORS[1])
                if column == 0:
                    ax.set_ylabel(quantities[key])
                if key == "success_rate":
                    ax.set_ylim(-0.05, 1.05)
            axes[-1, column].set_xticks(range(len(values)), values)
            axes[-1, column].set(xlim=(-0.4, len(values) - 0.6), xlabel=name)
        figure.suptitle(title)
