"""Figures of run time against error: one for each scene, and one of all Pareto fronts."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.ticker import NullFormatter

from flexarm_env.plotting import COLORS, FAINT, INK, styled_figure

Rows = Sequence[dict[str, Any]]
PEERS = ("Exudyn", "PyElastica")
JOINED = "floating, joined"
LABELS = ("floating frame", "modes", JOINED, "exact", "exact, period corrected", "elastica", *PEERS)
PAINT = dict(zip(LABELS, (*COLORS[:2], "#a9b6cf", COLORS[2], "#6fc49a", COLORS[3], INK, COLORS[4]), strict=True))


def _points(rows: Rows) -> tuple[list[float], list[float]]:
    return [1e3 * row["cpu"] for row in rows], [row["max_error"] for row in rows]


def _stairs(rows: Rows) -> tuple[list[float], list[float]]:
    """The front as stairs: what error can be had for a time."""
    x, y = _points(rows)
    return [v for v in x for _ in (0, 1)][1:], [v for v in y for _ in (0, 1)][:-1]


def _limits(axes: Any, rows: Rows) -> None:
    errors = np.array([row["max_error"] for row in rows])
    axes.set(xscale="log", yscale="log")
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_ylim(0.6 * errors.min(), min(100.0, 1.5 * errors.max()))


def scene_figure(name: str, rows: Rows, front: Callable[[Rows], Rows], folder: Path) -> Path:
    """Plot all runs of a scene, the front of each formulation, and the default settings."""
    path = folder / f"work_precision_{name}.png"
    good = [row for row in rows if row["status"] == "ok"]
    with styled_figure(path, 7.6, 4.8) as figure:
        axes = figure.add_subplot()
        for label in LABELS:
            mine = [row for row in good if row["case"]["label"] == label]
            if not mine:
                continue
            marker = {"ls": "", "marker": "D" if label in PEERS else "o", "color": PAINT[label]}
            axes.plot(*_points(mine), ms=3.2, alpha=0.3, mew=0, **marker)
            axes.plot(*_stairs(front(mine)), color=PAINT[label], lw=1.6, label=label)
        best = front([row for row in good if row["case"]["label"] not in PEERS])
        axes.plot(*_stairs(best), color=FAINT, lw=6, alpha=0.35, zorder=0, label="front of all (ours)")
        for row in good:
            if row["case"].get("default"):
                axes.plot(1e3 * row["cpu"], row["max_error"], marker="*", ms=13, mec="white", mew=0.8, ls="",
                          color=PAINT[row["case"]["label"]], zorder=5)  # fmt: skip
        axes.plot([], [], marker="*", ms=11, ls="", color=FAINT, label="default")
        _limits(axes, good)
        axes.set(title=f"{name}: run time against error", xlabel="CPU, ms per simulated second",
                 ylabel="largest tip error, % of L")  # fmt: skip
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return path


def summary_figure(scenes: Sequence[str], rows: Rows, front: Callable[[Rows], Rows], path: Path) -> Path:
    """Plot the fronts of all scenes in small panels."""
    columns = 2 if len(scenes) <= 4 else 5
    lines = -(-len(scenes) // columns)
    with styled_figure(path, 2.6 * columns, 2.5 * lines + 0.4) as figure:
        panels = figure.subplots(lines, columns, squeeze=False).ravel()
        for axes, name in zip(panels, scenes, strict=False):
            good = [row for row in rows if row["case"]["scene"] == name and row["status"] == "ok"]
            for label in LABELS:
                mine = [row for row in good if row["case"]["label"] == label]
                if mine:
                    axes.plot(*_stairs(front(mine)), color=PAINT[label], lw=1.5)
            for row in good:
                if row["case"].get("default"):
                    axes.plot(1e3 * row["cpu"], row["max_error"], marker="*", ms=8, mec="white", mew=0.5, ls="",
                              color=PAINT[row["case"]["label"]], zorder=5)  # fmt: skip
            _limits(axes, good)
            axes.set_title(name, fontsize=8.5)
        for axes in panels[len(scenes) :]:
            axes.set_visible(False)
        handles = [panels[0].plot([], [], color=PAINT[label], lw=2, label=label)[0] for label in LABELS]
        handles += panels[0].plot([], [], marker="*", ms=9, ls="", color=FAINT, label="default")
        figure.supxlabel("CPU, ms per simulated second", fontsize=9)
        figure.supylabel("largest tip error, % of L", fontsize=9)
        figure.legend(handles=handles, loc="outside upper center", ncols=len(handles))
    return path
