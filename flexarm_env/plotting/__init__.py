"""Plot trajectories with matplotlib (extra `plot`), one function for each kind of figure.

`plot_trajectory` plots deformed shapes with time labels, and in further panels tip deflection and energy over time.
`plot_comparison` compares runs with each other and with a reference. `plot_energies` and `plot_spectrum` plot energies
and frequencies. `plot_all` writes all figures of a run to a folder. The extension of a file's name selects PNG, PDF or
SVG.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from flexarm_env.accuracy import common_instants
from flexarm_env.geometry.ribbons import cuts_of
from flexarm_env.view.sources import mesh_of, shapes_of

from .. import validation as check
from ..validation import Array
from .space import plot_in_space
from .style import COLORS, FAINT, INK, draw_energies, legend_above, mark_kinks, shade, styled_figure

if TYPE_CHECKING:
    from flexarm_env.linear import Campbell
    from flexarm_env.trajectory import Trajectory

__all__ = [
    "COLORS", "FAINT", "INK", "plot_all", "plot_campbell", "plot_comparison", "plot_energies", "plot_spectrum",
    "plot_trajectory", "spectrum", "styled_figure",
]  # fmt: skip

Columns = Mapping[str, Array]


def plot_trajectory(
    trajectory: Trajectory,
    path: str | os.PathLike[str],
    reference: Columns | None = None,
    shapes: int = 13,
    title: str | None = None,
) -> Path:
    """Plot deformed shapes with time labels, and in further panels tip deflection and energy over time.

    A small deflection after the last change of the drives is drawn enlarged; the panel's title states the factor.

    Args:
        trajectory: the run to plot. path: the file to write. reference: a reference solution
            (`scenes.reference(NAME).columns`), whose tip path is drawn as dots; None for no reference. shapes: number
            of deformed shapes. title: title of the figure; None for the names of scene and formulation.
    Returns:
        The path of the figure's file.
    Raises:
        ValueError: matplotlib does not support the file's extension.
    """
    plot = plot_in_space if trajectory.scene.spatial else _plot_in_plane
    return plot(trajectory, path, reference, shapes, _title(trajectory, title))


def _plot_in_plane(
    trajectory: Trajectory, path: str | os.PathLike[str], reference: Columns | None, shapes: int, title: str
) -> Path:
    """Plot a run in the plane, see `plot_trajectory`."""
    stages = _stages(trajectory)
    factors = [1.0, *(_larger(trajectory, chosen) for chosen in stages[1:])]
    extents = [_extent(trajectory.shapes[chosen]) for chosen in stages]
    widths = [float(np.clip(4.4 * w / h, 2.8, 8.5 if len(stages) == 1 else 4.8)) for w, h in extents]
    with styled_figure(path, sum(widths) + 4.4, 4.8, title) as figure:
        grid = figure.add_gridspec(2, len(stages) + 1, width_ratios=[*widths, 4.2])
        for i, chosen in enumerate(stages):
            axes = figure.add_subplot(grid[:, i])
            count = max(4, round(shapes / len(stages)) + len(stages) - 1)
            _draw_shapes(axes, trajectory, chosen, count, reference, (widths[i], 4.4), factors[i])
            t, larger = trajectory.t[chosen], f", deflection × {factors[i]:g}" if factors[i] > 1.0 else ""
            axes.set_title(f"shapes, {t[0]:g} to {t[-1]:g} s{larger}")
        deflection = figure.add_subplot(grid[0, -1])
        energy = figure.add_subplot(grid[1, -1], sharex=deflection)
        _draw_deflection(deflection, trajectory)
        draw_energies(energy, trajectory)
        deflection.tick_params(labelbottom=False)
    return Path(path)


def plot_comparison(
    trajectories: Mapping[str, Trajectory],
    path: str | os.PathLike[str],
    reference: Columns | None = None,
    title: str = "",
) -> Path:
    """Plot several runs of a scene: tip paths, tip deflections, and distances of the tips from a reference.

    The line of the first run is wide and all other lines are dashed, so that coinciding lines are all visible.

    Args:
        trajectories: the runs to compare, by label. path: the file to write. reference: a reference solution
            (`scenes.reference(NAME).columns`); None to use the first run as the reference. title: title of the figure.
    Returns:
        The path of the figure's file.
    Raises:
        ValueError: no run is given, or a run has no label.
    """
    given: Any = trajectories
    if not isinstance(given, Mapping):
        what = "must be runs by their labels, such as {'8 segments': run}"
        raise check.InvalidValue("trajectories", type(given).__name__, what)
    if not trajectories:
        raise ValueError("trajectories = {}: must contain at least one run")
    labels = list(trajectories)
    table: Columns = trajectories[labels[0]].columns() if reference is None else reference
    name = labels[0] if reference is None else "the reference"
    with styled_figure(path, 10.5, 5.0, title) as figure:
        grid = figure.add_gridspec(2, 2, width_ratios=[4.6, 5.4])
        paths = figure.add_subplot(grid[:, 0])
        deflection = figure.add_subplot(grid[0, 1])
        error = figure.add_subplot(grid[1, 1], sharex=deflection)
        if reference is not None:
            paths.plot(table["tip_x"], table["tip_y"], ".", color=INK, ms=2.5, label="reference")
        for k, (label, run) in enumerate(trajectories.items()):
            color = COLORS[k % len(COLORS)]
            first: Any = {"lw": 2.8, "alpha": 0.55} if len(labels) > 1 else {"lw": 1.1}
            style = first if k == 0 else {"lw": 1.3, "ls": (5 * k, (5, 5 * (len(labels) - 2) + 4))}
            paths.plot(run.tip[:, 0], run.tip[:, 1], color=color, label=label, **style)
            deflection.plot(run.t, run.tip_deflection[:, -1], color=color, **style)
            mine, theirs = common_instants(run.t, table["t"])
            if mine.size and not (reference is None and label == labels[0]):
                apart = np.hypot(*(run.tip[mine, :2] - np.column_stack([table["tip_x"], table["tip_y"]])[theirs]).T)
                error.semilogy(run.t[mine], np.where(apart > 0.0, apart, np.nan), color=color, lw=1.1)
        paths.set(title="path of the tip", xlabel="x (m)", ylabel="y (m)", aspect="equal", adjustable="datalim")
        paths.legend(loc="best")
        deflection.set(title="tip deflection / link length")
        deflection.tick_params(labelbottom=False)
        error.set(title=f"distance of the tip from {name} (m)", xlabel="t (s)")
        _floor(error)
    return Path(path)


def plot_energies(trajectory: Trajectory, path: str | os.PathLike[str], title: str | None = None) -> Path:
    """Plot energies over time, with the energy error `Trajectory.balance`, J, in a lower panel.

    Arguments are those of `plot_trajectory`.
    """
    with styled_figure(path, 7.0, 5.0, _title(trajectory, title)) as figure:
        energy, balance = figure.subplots(2, 1, sharex=True, gridspec_kw={"height_ratios": [2.2, 1.0]})
        draw_energies(energy, trajectory)
        energy.set_xlabel("")
        balance.plot(trajectory.t, trajectory.balance, color=COLORS[5], lw=1.1)
        balance.set(title="change of energy + dissipated - work (J)", xlabel="t (s)")
        mark_kinks(balance, trajectory)
    return Path(path)


LABELLED, LEAST_LABELLED = 4, 1e-2
"""Largest number of labelled peaks of a spectrum; smallest height of a labelled peak, divided by the highest peak."""


def spectrum(t: Array, x: Array) -> tuple[Array, Array]:
    """Return the amplitude spectrum of an evenly sampled signal x (n,) at times t (n,), s, with a Hann window.

    Returns frequencies (Hz) and amplitudes (unit of x), (n // 2 + 1,) each. The mean is removed first. A sine of
    amplitude A gives a peak of height A. Raises ValueError if samples are not evenly spaced, or if there are too few
    samples.
    """
    step = np.diff(t)
    if t.size < 8 or np.ptp(step) > 1e-6 * step.mean():
        raise ValueError(f"t = {t.size} samples: must be at least 8, evenly spaced")
    window = np.hanning(t.size)
    amplitude = np.abs(np.fft.rfft((x - x.mean()) * window)) * 2.0 / window.sum()
    return np.asarray(np.fft.rfftfreq(t.size, float(step.mean()))), np.asarray(amplitude)


def plot_spectrum(
    trajectory: Trajectory, path: str | os.PathLike[str], since: float | None = None, title: str | None = None
) -> Path:
    """Plot the amplitude spectrum of each link's tip deflection divided by the link's length; label the highest peaks.

    Args:
        trajectory, path, title: arguments of `plot_trajectory`.
        since: time, s, before which samples are ignored. None: the last instant at which an input jumps or ends.
    Raises:
        ValueError: too few samples remain.
    """
    start = _last_drive(trajectory) if since is None else since
    chosen = trajectory.t >= start - 1e-9
    t = trajectory.t[chosen]
    with styled_figure(path, 7.0, 3.8, _title(trajectory, title)) as figure:
        axes = figure.add_subplot()
        highest, last = 0.0, 0.0
        peaks: list[tuple[float, float, str]] = []
        for k in range(trajectory.tip_deflection.shape[1]):
            own = trajectory.tip_deflection[chosen, k]
            parts = [own] if own.ndim == 1 else list(own.T)  # in space along y and z: the larger of the two
            frequency, amplitude = spectrum(t, parts[0])
            amplitude = np.maximum.reduce([amplitude, *(spectrum(t, part)[1] for part in parts[1:])])
            if not amplitude[1:].any():  # a rigid link
                continue
            color = COLORS[k % len(COLORS)]
            axes.semilogy(frequency[1:], np.maximum(amplitude[1:], 1e-16), color=color, label=f"link {k + 1}")
            highest = max(highest, float(amplitude[1:].max()))
            last = max(last, float(frequency[amplitude > 1e-5 * amplitude[1:].max()].max(initial=0.0)))
            peaks += [(float(amplitude[i]), float(frequency[i]), color) for i in _peaks(amplitude)]
        for size, at, color in sorted(peaks, reverse=True)[:LABELLED]:
            if size >= LEAST_LABELLED * highest:
                axes.annotate(
                    f"{at:.3g} Hz", (at, size), xytext=(0, 3), textcoords="offset points",
                    fontsize=8, color=color, rotation=40, ha="left", va="bottom",
                )  # fmt: skip
        axes.set(xlabel="frequency (Hz)", title=f"amplitude of the tip deflection / length, {t[0]:g} to {t[-1]:g} s")
        axes.set_xlim(0.0, min(1.05 * last, float(frequency[-1])) or float(frequency[-1]))
        if highest > 0.0:
            axes.set_ylim(bottom=highest * 1e-5, top=highest * 10.0)
        if trajectory.tip_deflection.shape[1] > 1:
            axes.legend(loc="upper right")
    return Path(path)


def plot_all(
    trajectory: Trajectory, folder: str | os.PathLike[str], reference: Columns | None = None, ending: str = "png"
) -> list[Path]:
    """Write all plots of a run: shapes.png with the tip deflection, energies.png, spectrum.png.

    Args:
        trajectory: the run to plot. folder: folder of the figures, created if missing. reference: a reference solution,
            as in `plot_trajectory`.
        ending: format of the figures: png, pdf or svg.
    Returns:
        Paths of the figures. There is no spectrum if too few samples follow the last instant at which an input jumps or
            ends.
    """
    home = Path(folder)
    paths = [
        plot_trajectory(trajectory, home / f"shapes.{ending}", reference),
        plot_energies(trajectory, home / f"energies.{ending}"),
    ]
    try:
        paths.append(plot_spectrum(trajectory, home / f"spectrum.{ending}"))
    except ValueError as error:
        if "evenly spaced" not in str(error):
            raise
    return paths


# ------------------------------------------------------------------ parts
def _title(trajectory: Trajectory, title: str | None) -> str:
    """Return the given title, or a title with scene, formulation and options."""
    if title is not None:
        return title
    settings = trajectory.settings
    own = ", ".join(mesh_of(settings))
    ended = "" if trajectory.finished else f"   [{trajectory.status} after {trajectory.t[-1]:g} s]"
    return f"{trajectory.scene.name}   ({settings.formulation}: {own}, dt {settings.dt:g} s){ended}"


def _last_drive(trajectory: Trajectory) -> float:
    """Return the last instant, s, at which a drive jumps or ends."""
    scene = trajectory.scene
    ends = [motion.function.end for motion in scene.motions] + [f.end for load in scene.loads for f in load.functions]
    return max([t for t in (*scene.kinks, *ends) if t < trajectory.t[-1]], default=float(trajectory.t[0]))


def _stages(trajectory: Trajectory) -> list[NDArray[np.intp]]:
    """Return the samples of each panel: one panel, or panels for driven and free motion if shapes would overlap."""
    t, everything = trajectory.t, np.arange(trajectory.t.size)
    stop = _last_drive(trajectory)
    moved = float(np.ptp(trajectory.start[:, :2], axis=0).max())
    share = (stop - t[0]) / (t[-1] - t[0]) if t.size > 1 else 0.0
    if moved > 0.2 * trajectory.scene.arm.total_length or not 0.15 < share < 0.85:
        return [everything]
    return [everything[t <= stop + 1e-9], everything[t >= stop - 1e-9]]


def _larger(trajectory: Trajectory, chosen: NDArray[np.intp]) -> float:
    """Return the factor 1, 2, 5, 10 or 20 by which a small deflection is enlarged."""
    turned = float(np.ptp(trajectory.joint_angles[chosen], axis=0).max())
    largest = float(np.abs(trajectory.tip_deflection[chosen]).max())
    if turned > 0.2 or largest == 0.0:
        return 1.0
    return next((k for k in (20.0, 10.0, 5.0, 2.0) if k * largest <= 0.25), 1.0)


def _extent(points: Array) -> tuple[float, float]:
    """Return the width and the height of the shapes, m; neither is much smaller than the other."""
    flat = points.reshape(-1, 2)
    width, height = np.ptp(flat[:, 0]), np.ptp(flat[:, 1])
    least = 0.35 * max(width, height, 1e-12)
    return float(max(width, least)), float(max(height, least))


def _draw_shapes(
    axes: Any, trajectory: Trajectory, chosen: NDArray[np.intp], count: int, reference: Columns | None,
    size: tuple[float, float], factor: float,
) -> None:  # fmt: skip
    """Draw the arm at `count` instants, the path of its tip, and a reference's tip.

    chosen: indices of the samples that are shown. size: size of the figure, inches. factor: factor on the deflections.
    """
    t = trajectory.t[chosen]
    times = np.linspace(t[0], t[-1], min(count, t.size))
    frames = chosen[np.unique(np.abs(t[:, None] - times).argmin(axis=0))]
    shapes, cuts = shapes_of(trajectory, frames, factor), cuts_of(trajectory.shapes, trajectory.hinges)
    axes.plot(*shapes_of(trajectory, chosen, factor)[:, -1].T, color=FAINT, lw=0.7, ls=(0, (4, 2)), zorder=1)
    if reference is not None and factor == 1.0:
        inside = (reference["t"] >= t[0] - 1e-9) & (reference["t"] <= t[-1] + 1e-9)
        axes.plot(
            reference["tip_x"][inside], reference["tip_y"][inside], ".", color=COLORS[1], ms=2.2, zorder=2,
            label="reference tip",
        )  # fmt: skip
        axes.legend(loc="best", handletextpad=0.2)
    for i in range(len(frames)):
        color = shade(i, len(frames))
        axes.plot(*shapes[i].T, color=color, lw=1.7, solid_capstyle="round", zorder=3 + i)
        for hinge in shapes[i, list(cuts[1:-1])]:
            axes.plot(*hinge, "o", color="white", mec=color, mew=1.1, ms=4.0, zorder=4 + i)
    if trajectory.scene.root == "pinned":
        for color, size_of in ((INK, 6), ("white", 2.2)):
            axes.plot(*trajectory.start[frames[0], :2], "o", color=color, ms=size_of, zorder=40)
    _label_times(axes, shapes, trajectory.t[frames], trajectory.scene.root == "free", size)
    axes.set(xlabel="x (m)", ylabel="y (m)", aspect="equal", adjustable="datalim")
    axes.margins(0.09)


def _label_times(axes: Any, shapes: Array, times: Array, free: bool, size: tuple[float, float]) -> None:
    """Label each shape with its time where the label covers least; omit labels that would overlap.

    free: True if a label may be at either end of a shape. size: size of the panel, inches.
    """
    drawn = shapes.reshape(-1, 2)
    point = float(np.max(np.ptp(drawn, axis=0) / (np.array(size) * 72.0 * 0.8)))  # m
    half = np.array([11.0, 5.5]) * point  # of a label's box
    taken = np.zeros((0, 2))
    for i in [0, len(shapes) - 1, *range(1, len(shapes) - 1)][: len(shapes)]:
        places = np.array(list(_label_places(shapes[i], 11.0 * point, free)))
        cost = 0.5 * np.arange(len(places))
        cost += (np.abs(drawn - places[:, None]) < half).all(axis=2).sum(axis=1)
        cost[(np.abs(taken - places[:, None]) < 2.0 * half).all(axis=2).any(axis=1)] = np.inf
        best = int(cost.argmin())
        if not np.isfinite(cost[best]):
            continue
        taken = np.vstack([taken, places[best]])
        axes.text(
            *places[best], f"{times[i]:.3g}", fontsize=7.5, color=shade(i, len(shapes), 0.4), ha="center", va="center",
            zorder=50, bbox={"boxstyle": "round,pad=0.1", "fc": "white", "ec": "none", "alpha": 0.8},
        )  # fmt: skip


def _label_places(points: Array, gap: float, both_ends: bool) -> Iterator[Array]:
    """Return possible positions of a shape's label, best first: around its tip and, for a free body, its other end."""
    ends = [(points[-1], points[max(0, len(points) - 4)])]
    if both_ends:
        ends.append((points[0], points[min(3, len(points) - 1)]))
    for end, inner in ends:
        along = (end - inner) / max(float(np.hypot(*(end - inner))), 1e-300)
        across = np.array([-along[1], along[0]])
        for direction in (along, along + across, along - across, across, -across):
            yield end + direction * gap * np.array([1.25, 0.9])


def _draw_deflection(axes: Any, trajectory: Trajectory) -> None:
    """Draw each link's tip deflection, divided by the link's length, against time."""
    n_links = trajectory.tip_deflection.shape[1]
    for k, bend in enumerate(trajectory.tip_deflection.T):
        axes.plot(trajectory.t, bend, color=COLORS[k % len(COLORS)], label=f"link {k + 1}")
    axes.axhline(0.0, color=FAINT, lw=0.7, zorder=0)
    axes.set(title="tip deflection / link length")
    mark_kinks(axes, trajectory)
    if n_links > 1:
        legend_above(axes, n_links)


def _floor(axes: Any) -> None:
    """Limit a logarithmic axis so that distances of zero do not extend its range."""
    values = np.concatenate([np.asarray(line.get_ydata(), dtype=float) for line in axes.lines] or [np.ones(1)])
    values = values[np.isfinite(values)]
    if values.size:
        axes.set_ylim(bottom=max(values.max() * 1e-5, values.min() * 0.5), top=values.max() * 2.0)


def _peaks(amplitude: Array) -> list[int]:
    """Return the indices of peaks that are at least three times as high as their surroundings, the highest first."""
    from scipy.signal import find_peaks

    level = np.log(np.maximum(amplitude[1:], 1e-300))  # without the mean
    padded = np.concatenate([[level.min()], level, [level.min()]])
    found = find_peaks(padded, prominence=np.log(3.0))[0]
    return [int(i) for i in found[np.argsort(-amplitude[found])]]


def plot_campbell(found: Campbell, path: str | os.PathLike[str], title: str = "") -> Path:
    """Plot natural frequencies over spin rate, with the line of one vibration per revolution; return `path`.

    Frequencies refer to the fixed frame if all frequencies are defined in the fixed frame (`Campbell.at_rest`), as for
    a body of revolution. Otherwise all frequencies refer to the frame that rotates with the arm. Marks at the bottom
    show the spin rates at which the arm is unstable.
    """
    spins, rests = np.abs(found.spins), np.isfinite(found.at_rest).all()
    values = np.abs(found.at_rest if rests else found.frequencies)
    turning = found.at_rest != found.frequencies
    kinds = {"": np.ones_like(turning)}
    if rests and turning.any():
        forward = np.sign(found.spins)[:, None] * found.at_rest > 0.0
        still = (found.spins == 0.0)[:, None]
        kinds = {"forward": turning & forward, "backward": turning & ~forward, "neither": ~turning & ~still}
        kinds["no spin"] = ~turning & still
    with styled_figure(path, 6.0, 4.2, title) as figure:
        axes = figure.add_subplot()
        axes.plot([0.0, spins.max()], [0.0, spins.max()], color=FAINT, lw=1.0, ls="--")
        colors = {"": COLORS[0], "forward": COLORS[0], "backward": COLORS[1], "neither": COLORS[2], "no spin": INK}
        for name, chosen in kinds.items():
            k, j = np.nonzero(chosen)
            if len(k):
                axes.plot(spins[k], values[k, j], ".", ms=3.0, color=colors[name], label=name)
        grows = spins[found.growing > 0]
        if len(grows):
            axes.plot(grows, 0.0 * grows, "|", color=COLORS[3], ms=9.0, clip_on=False, label="grows")
        observer = "from rest" if rests else "turning with the arm"
        axes.set(xlabel="spin (rad/s)", ylabel=f"frequency seen {observer} (rad/s)")
        axes.set(xlim=(0.0, spins.max() or 1.0), ylim=(0.0, 1.05 * values.max()))
        if len(kinds) > 1:
            legend_above(axes, len(kinds) + 1)
    return Path(path)
