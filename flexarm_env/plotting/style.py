"""Style and elements that all figures share."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure

from flexarm_env import validation as check
from flexarm_env.files import write_whole

if TYPE_CHECKING:
    from flexarm_env.trajectory import Trajectory

COLORS = ("#1f5fa8", "#d1591b", "#2a8a57", "#8a4fa8", "#b8860b", "#4c4c4c")
INK, FAINT = "#222222", "#9a9a9a"
_TIME = LinearSegmentedColormap.from_list("flexarm_time", ["#a9c6e8", "#1f5fa8", "#0b2545"])

_STYLE: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "axes.labelsize": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#555555",
    "axes.labelcolor": INK,
    "axes.linewidth": 0.8,
    "axes.grid": True,
    "grid.color": "#e6e6e6",
    "grid.linewidth": 0.6,
    "xtick.color": "#555555",
    "ytick.color": "#555555",
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "legend.fontsize": 8.0,
    "legend.frameon": False,
    "lines.linewidth": 1.4,
    "savefig.dpi": 150,
    "svg.hashsalt": "flexarm_env",  # the same figure gives the same file
}


@contextmanager
def styled_figure(path: str | os.PathLike[str], width: float, height: float, title: str = "") -> Iterator[Figure]:
    """Yield a figure of width by height inches for a `with` block, and write the figure to `path` at the block's end.

    Raises ValueError if matplotlib does not support the extension of `path`.
    """
    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=(width, height), layout="constrained")
        canvas = FigureCanvasAgg(figure)
        if Path(path).suffix.lower()[1:] not in canvas.get_supported_filetypes():
            raise check.InvalidValue("path", os.fspath(path), "must end in .png, .pdf or .svg")
        if title:
            figure.suptitle(title, x=0.01, ha="left", fontsize=10.5, color=INK)
        yield figure
        write_whole(Path(path), figure.savefig)


def shade(i: int, count: int, start: float = 0.0) -> Any:
    """Return the color of shape i of `count`: later shapes are darker."""
    return _TIME(start + (1.0 - start) * i / max(1, count - 1))


def mark_kinks(axes: Any, trajectory: Trajectory) -> None:
    """Draw a thin line at each instant at which a drive jumps, unless there are many such instants."""
    kinks = [t for t in trajectory.scene.kinks if t < trajectory.t[-1]]
    if len(kinks) <= 8:
        for t in kinks:
            axes.axvline(t, color=FAINT, lw=0.8, ls=":", zorder=0)


def draw_energies(axes: Any, trajectory: Trajectory) -> None:
    """Draw the energies and their sum over time."""
    parts = {"kinetic": trajectory.kinetic, "strain": trajectory.strain_energy}
    if np.any(trajectory.gravity != 0.0):
        parts["gravity"] = trajectory.gravity
    for color, (label, values) in zip(COLORS, parts.items(), strict=False):
        axes.plot(trajectory.t, values, color=color, lw=1.1, label=label)
    axes.plot(trajectory.t, trajectory.energy, color=INK, lw=1.6, label="total")
    axes.set(title="energy (J)", xlabel="t (s)")
    axes.margins(x=0.01)
    mark_kinks(axes, trajectory)
    legend_above(axes, len(parts) + 1)


def legend_above(axes: Any, columns: int) -> None:
    """Place a legend at the right of the title's line."""
    axes.legend(
        loc="lower right", bbox_to_anchor=(1.0, 0.985), ncols=columns, borderaxespad=0.0, handlelength=1.3,
        columnspacing=1.0, handletextpad=0.5,
    )  # fmt: skip
