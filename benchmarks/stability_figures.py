"""Maps of the stability sweep: each cell shows the outcomes of its cases side by side."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.patches import Patch, Rectangle

from flexarm_env.plotting import styled_figure

PAINT = {
    "ok": "#3f7fbf", "inaccurate": "#e8c468", "failed": "#b9b9b9", "silently wrong": "#c8102e", "broken": "#000000",
}  # fmt: skip
MAPS = (
    ("step", "h", "rho", "step / first period", "rho_inf"),
    ("stiffness", "slender", "payload", "EA L^2 / EI", "payload / link mass"),
    ("spin", "amplitude", "h", "spin rate / first frequency", "step / first period"),
    ("bang-bang", "amplitude", "h", "torque / limit", "step / first period"),
    ("damping", "h", "zeta", "step / first period", "damping ratio"),
)


def _label(value: Any) -> str:
    return f"{value:.1g}" if isinstance(value, float) else str(value)


def maps(rows: Sequence[dict[str, Any]], path: Path, methods: Sequence[str]) -> Path:
    """Draw maps of the outcomes: one row of panels per family, one column per formulation."""
    with styled_figure(path, 2.9 * len(methods), 2.35 * len(MAPS) + 0.4) as figure:
        panels = figure.subplots(len(MAPS), len(methods), squeeze=False)
        for axes, method in zip(panels[0], methods, strict=True):
            axes.set_title(method)
        for line, (family, x, y, x_label, y_label) in zip(panels, MAPS, strict=True):
            mine = [row for row in rows if row["case"]["family"] == family and not row["case"]["mass_damping"]]
            xs, ys = (sorted({row["case"][name] for row in mine}) for name in (x, y))
            for axes, method in zip(line, methods, strict=True):
                for i, a in enumerate(xs):
                    for j, b in enumerate(ys):
                        cell = [row["outcome"] for row in mine if row["case"]["method"] == method
                                and row["case"][x] == a and row["case"][y] == b]  # fmt: skip
                        _mosaic(axes, i, j, cell)
                axes.set(xlim=(-0.05, len(xs) + 0.05), ylim=(-0.05, len(ys) + 0.05))
                every = max(1, -(-len(xs) // 5))
                axes.set_xticks(np.arange(0, len(xs), every) + 0.5, [_label(v) for v in xs[::every]])
                axes.set_yticks(np.arange(len(ys)) + 0.5, [_label(v) for v in ys] if axes is line[0] else [])
                axes.grid(False)
                axes.tick_params(length=0)
                for spine in axes.spines.values():
                    spine.set_visible(False)
                axes.set_xlabel(x_label)
            line[0].set_ylabel(f"{family}\n{y_label}")
        handles = [Patch(color=PAINT[name], label=name) for name in ("ok", "inaccurate", "failed", "silently wrong")]
        figure.legend(handles=handles, loc="outside lower center", ncols=4)
    return path


def _mosaic(axes: Any, i: int, j: int, cell: list[str]) -> None:
    """Draw the outcomes of a cell as strips whose widths are their shares."""
    left = 0.0
    for name, color in PAINT.items():
        share = cell.count(name) / max(1, len(cell))
        if share > 0.0:
            axes.add_patch(Rectangle((i + 0.04 + 0.92 * left, j + 0.04), 0.92 * share, 0.92, color=color, lw=0))
        left += share
