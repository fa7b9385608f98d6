"""Figures of learning curves and of episodes under several controllers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from agents.episodes import Episodes
from agents.runs import write_whole

COLOURS = ("#1b6ca8", "#d1495b", "#2e933c", "#e08e0b", "#7b4fa3", "#4d4d4d", "#17a2a2")


def _axes(rows: int, width: float = 7.0, height: float = 2.6) -> tuple[Any, Any]:
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(
        rows, 1, figsize=(width, height * rows), sharex=True, layout="constrained", squeeze=False
    )
    for ax in axes[:, 0]:
        ax.spines[["top", "right"]].set_visible(False)
        ax.grid(True, linewidth=0.4, alpha=0.5)
    return figure, axes[:, 0]


def _save(figure: Any, path: Path) -> None:
    import matplotlib.pyplot as plt

    write_whole(
        path, lambda part: figure.savefig(part, dpi=140, metadata={"Software": None} if path.suffix == ".png" else None)
    )
    plt.close(figure)


def learning_curve(curves: Sequence[Sequence[Mapping[str, float]]], path: Path, title: str = "") -> None:
    """Success, settling time and return over environment steps; of one run or of several seeds with their median."""
    figure, axes = _axes(3)
    shown = (
        ("success_rate", "success rate"),
        ("settling_median", "median settling (s)"),
        ("return_mean", "mean return"),
    )
    for ax, (key, label) in zip(axes, shown, strict=True):
        for rows in curves:
            x = [row["steps"] / 1e3 for row in rows]
            ax.plot(
                x, [row[key] for row in rows], color=COLOURS[0], linewidth=1.6 if len(curves) == 1 else 0.8, alpha=0.8
            )
        if len(curves) > 1:
            grid = sorted({row["steps"] for rows in curves for row in rows})
            lines = [np.interp(grid, [r["steps"] for r in rows], [r[key] for r in rows]) for rows in curves]
            x, label_all = np.asarray(grid) / 1e3, f"median of {len(curves)} seeds"
            ax.plot(x, np.median(lines, axis=0), color=COLOURS[1], linewidth=2.0, label=label_all)
        ax.set_ylabel(label)
    if len(curves) > 1:
        axes[0].legend(frameon=False, loc="lower right")
    axes[0].set_ylim(-0.03, 1.03)
    axes[0].set_title(title)
    axes[1].set_yscale("log")
    axes[1].yaxis.set_major_formatter("{x:g}")
    axes[1].yaxis.set_minor_formatter("{x:g}")
    axes[1].tick_params(axis="y", which="minor", labelsize="x-small")
    axes[-1].set_xlabel("environment steps (thousands)")
    _save(figure, path)


def tip_errors(results: Mapping[str, Episodes], episode: int, path: Path, title: str = "") -> None:
    """Tip error over time in the same episode under each controller."""
    figure, axes = _axes(2)
    first = next(iter(results.values()))
    slew = first.task == "slew"
    factor, unit = (180.0 / np.pi, "deg") if slew else (1000.0, "mm")
    for k, (name, result) in enumerate(results.items()):
        errors = result.errors[:, episode] * factor
        t = np.arange(len(errors)) * result.dt
        for ax in axes:
            ax.plot(t, errors, color=COLOURS[k % len(COLOURS)], linewidth=1.5, label=name)
    until = 2.0 * max(float(result.settling[episode]) for result in results.values())
    axes[1].set_xlim(0.0, min(until, (len(first.errors) - 1) * first.dt))
    axes[1].set_yscale("log")
    axes[1].set_ylim(bottom=1e-2 * (1.0 if slew else 10.0))
    for ax in axes:
        ax.set_ylabel(f"tip error ({unit})")
    axes[0].legend(frameon=False, ncols=2)
    axes[0].set_title(title)
    axes[-1].set_xlabel("time (s)")
    _save(figure, path)


def compared(
    rows: Sequence[Mapping[str, Any]], varied: Sequence[str], quantities: Mapping[str, str], path: Path, title: str = ""
) -> None:
    """Quantities over the values of what was varied: a column of panels each, a dot a run, a line through the means."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    keys = list(quantities)
    size = (max(4.6, 3.4 * len(varied)), 1.9 * len(keys))
    figure, axes = plt.subplots(
        len(keys), len(varied), figsize=size, sharex="col", sharey="row", layout="constrained", squeeze=False
    )
    for column, name in enumerate(varied):
        values = list(dict.fromkeys(str(row[name]) for row in rows))
        for ax, key in zip(axes[:, column], keys, strict=True):
            ax.spines[["top", "right"]].set_visible(False)
            ax.grid(True, linewidth=0.4, alpha=0.5)
            groups = [[float(row[key]) for row in rows if str(row[name]) == value] for value in values]
            for x, group in enumerate(groups):
                ax.plot([x] * len(group), group, "o", color=COLOURS[0], alpha=0.7, markersize=5)
            ax.plot(range(len(values)), [np.mean(group) for group in groups], color=COLOURS[1], linewidth=1.4)
            if column == 0:
                ax.set_ylabel(quantities[key])
            if key == "success_rate":
                ax.set_ylim(-0.05, 1.05)
        axes[-1, column].set_xticks(range(len(values)), values)
        axes[-1, column].set_xlim(-0.4, len(values) - 0.6)
        axes[-1, column].set_xlabel(name)
    figure.suptitle(title)
    _save(figure, path)
