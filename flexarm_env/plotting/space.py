"""Plot runs in space: deformed shapes in perspective, deflections and twist, and energies."""

import os
from pathlib import Path
from typing import Any

import numpy as np

from .style import COLORS, FAINT, INK, draw_energies, legend_above, mark_kinks, shade, styled_figure


def plot_in_space(
    trajectory: Any, path: str | os.PathLike[str], reference: Any, shapes: int, title: str
) -> Path:
    """Plot a run in space, as in `plotting.plot_trajectory` but without a reference solution."""
    with styled_figure(path, 12.0, 5.6, title) as figure:
        grid = figure.add_gridspec(3, 2, width_ratios=[6.6, 4.6])
        axes: Any = figure.add_subplot(grid[:, 0], projection="3d")
        _draw_shapes(axes, trajectory, shapes)
        deflection = figure.add_subplot(grid[0, 1])
        twist = figure.add_subplot(grid[1, 1], sharex=deflection)
        energy = figure.add_subplot(grid[2, 1], sharex=deflection)
        for k, link in enumerate(trajectory.scene.arm.links):
            if link.rigid:
                continue
            color, name = COLORS[k % len(COLORS)], f"link {k + 1}"
            deflection.plot(trajectory.t, trajectory.tip_deflection[:, k, 0], color=color, label=name)
            deflection.plot(trajectory.t, trajectory.tip_deflection[:, k, 1], color=color, ls="--")
            twist.plot(trajectory.t, np.degrees(trajectory.twist[:, k]), color=color, label=name)
        deflection.set(title="tip deflection / link length, along y (dashed: z)")
        twist.set(title="twist of the tip against the root (degrees)")
        for panel in (deflection, twist):
            legend_above(panel, trajectory.scene.arm.n_links)
            mark_kinks(panel, trajectory)
            panel.tick_params(labelbottom=False)
        draw_energies(energy, trajectory)
    return Path(path)


def _frame(axes: Any, trajectory: Any) -> float:
    """Set axes that contain the whole run; return the ground's height, m."""
    points = trajectory.shapes.reshape(-1, 3)
    low, high = points.min(axis=0), points.max(axis=0)
    half = 0.55 * max(float((high - low).max()), 1e-9)
    middle = 0.5 * (low + high)
    ground = min(float(low[2]), 0.0)
    top = ground + 2.0 * half if high[2] - ground <= 2.0 * half else float(high[2])
    axes.set(
        xlim=(middle[0] - half, middle[0] + half), ylim=(middle[1] - half, middle[1] + half), zlim=(ground, top),
        xlabel="x (m)", ylabel="y (m)", zlabel="z (m)",
    )  # fmt: skip
    axes.set_box_aspect((1.0, 1.0, (top - ground) / (2.0 * half)))
    axes.view_init(elev=22.0, azim=-52.0)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_pane_color((0.97, 0.97, 0.97, 1.0))
        axis._axinfo["grid"].update(color="#e2e2e2", linewidth=0.5)
    return ground


def _draw_shapes(axes: Any, trajectory: Any, count: int) -> None:
    """Draw shapes at evenly spaced times (later shapes darker), their shadows on the ground, and the tip's path."""
    points = trajectory.shapes
    ground = _frame(axes, trajectory)
    chosen = np.unique(np.linspace(0, len(points) - 1, count).round().astype(int))
    for i, k in enumerate(chosen.tolist()):
        x, y, z = points[k].T
        axes.plot(x, y, np.full(len(x), ground), color=FAINT, lw=0.8, alpha=0.35)
        axes.plot(x, y, z, color=shade(i, len(chosen)), lw=2.0)
    axes.plot(*_path(trajectory).T, color=COLORS[1], lw=0.9, alpha=0.9)
    label: Any = {"fontsize": 8, "color": INK, "zorder": 9, "bbox": {"fc": "w", "ec": "none", "alpha": 0.7, "pad": 0.6}}
    for k in (chosen[0], chosen[-1]):
        axes.text(*trajectory.tip[k], f" {trajectory.t[k]:.3g} s", **label)
    axes.set_title(f"shapes, {trajectory.t[0]:g} to {trajectory.t[-1]:g} s, and the path of the tip")


def _path(trajectory: Any) -> Any:
    """Return the tip's path (n, 3), m: a cubic between recorded instants that matches the tip's velocities."""
    tip, step = trajectory.tip, np.diff(trajectory.t)[:, None, None]
    a, b, s = tip[:-1, None], tip[1:, None], np.linspace(0.0, 1.0, 8, endpoint=False)[:, None]
    left, right = step * trajectory.tip_velocity[:-1, None, :3], step * trajectory.tip_velocity[1:, None, :3]
    path = a + s * (left + s * (3.0 * (b - a) - 2.0 * left - right + s * (left + right - 2.0 * (b - a))))
    return np.concatenate([path.reshape(-1, 3), tip[-1:]])
