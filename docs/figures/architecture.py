"""Draw docs/figures/architecture.svg: the modules of the package and their uses of each other.

python docs/figures/architecture.py [FILE.svg]
"""

import re
import sys
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.patches import FancyBboxPatch

from flexarm_env.plotting import COLORS, INK, styled_figure

HERE = Path(__file__).resolve().parent

ROOMS = {path.stem for path in (HERE.parents[1] / "flexarm_env").iterdir()}

# name: (x, y, width, height, colour, lines); y upwards
BOXES: dict[str, tuple[float, float, float, float, str, tuple[str, ...]]] = {
    "compiler": (3.2, 6.0, 7.4, 0.55, COLORS[4], ("compiler, layout",)),
    "describe": (-0.05, 4.3, 2.7, 1.45, COLORS[0],
        ("sections, curves, meshing", "bodies, rotations, rigid", "parameters, arms, sensors",
         "scene, scenes, settings, records", "time_functions, shapes, files")),
    "physics": (3.2, 4.45, 3.2, 1.15, COLORS[2],
        ("physics", "floating · exact · elastica", "space · joints · integrator")),
    "tasks": (7.0, 4.45, 1.5, 1.15, COLORS[1], ("tasks", "see, judge")),
    "runtime": (9.1, 4.45, 1.5, 1.15, COLORS[1], ("runtime", "an episode")),
    "view": (0.0, 2.9, 2.6, 1.05, COLORS[5], ("view", "data of a run to show", "the player's page")),
    "simulation": (3.2, 2.9, 3.2, 1.05, COLORS[0],
        ("simulation, rest, accuracy", "accuracy_space, geometry, trajectory", "one arm, a scene")),
    "batch": (9.1, 2.9, 1.5, 1.05, COLORS[0], ("batch", "many arms, a call")),
    "identification": (0.0, 1.35, 2.6, 1.05, COLORS[3], ("identification", "from a log to an arm")),
    "linear": (3.2, 1.35, 2.0, 1.05, COLORS[2], ("equations, linear", "A, B, modes, rest")),
    "control": (5.8, 1.35, 2.2, 1.05, COLORS[3], ("control", "PD ... LQR, policies")),
    "envs": (8.6, 1.35, 2.0, 1.05, COLORS[3], ("envs", "single, vector, films")),
    "suite": (5.8, -0.05, 2.2, 0.9, COLORS[4], ("suite", "tasks as data, scores")),
    "derivatives": (8.6, -0.05, 2.0, 0.9, COLORS[2], ("derivatives, torch", "of control periods")),
    "users": (0.0, -1.45, 10.6, 0.9, COLORS[5],
        ("around, comparison, episodes, exchange, goals, plotting, recording, library, remote, sb3, training, cli",
         "agents/ and benchmarks/, which are not installed")),
}  # fmt: skip
ARROWS = (
    ("compiler", "physics", "down"), ("compiler", "tasks", "down"), ("compiler", "runtime", "down"),
    ("describe", "physics", "right"), ("physics", "tasks", "right"), ("tasks", "runtime", "right"),
    ("describe", "view", "down"), ("view", "simulation", "right"), ("physics", "simulation", "down"),
    ("runtime", "batch", "down"), ("simulation", "batch", "right"), ("simulation", "linear", "down"),
    ("linear", "identification", "left"), ("linear", "control", "right"),
    ("batch", "envs", "down"), ("identification", "users", "down"), ("linear", "users", "down"),
    ("control", "suite", "down"), ("envs", "derivatives", "down"), ("suite", "users", "down"),
    ("derivatives", "users", "down"),
)  # fmt: skip


def main() -> None:
    """Draw it."""
    path = Path(sys.argv[1]) if len(sys.argv) > 1 else HERE / "architecture.svg"
    mpl.rcParams.update({"svg.fonttype": "none", "svg.hashsalt": "rooms"})  # the same file every time
    with styled_figure(path, 9.6, 7.3) as figure:
        axes: Any = figure.add_subplot()
        axes.set(xlim=(-0.1, 10.7), ylim=(-1.5, 6.6))
        axes.set_axis_off()
        for x, y, width, height, color, lines in BOXES.values():
            axes.add_patch(_box(x, y, width, height, color))
            for k, line in enumerate(lines):
                place = y + height / 2 + 0.26 * ((len(lines) - 1) / 2 - k)
                bold = "bold" if k == 0 or set(line.replace(",", "").split()) <= ROOMS else "normal"
                axes.text(x + width / 2, place, line, ha="center", va="center", color=INK, weight=bold, fontsize=8.5)
        for source, target, way in ARROWS:
            style = {"arrowstyle": "-|>", "color": "#777777", "lw": 1.1, "shrinkA": 1, "shrinkB": 1}
            axes.annotate("", _end(target, source, way, True), _end(source, target, way, False), arrowprops=style)
    path.write_text(re.sub(r"<dc:date>.*?</dc:date>", "", path.read_text("utf-8")), encoding="utf-8")


def _box(x: float, y: float, width: float, height: float, color: str) -> Any:
    return FancyBboxPatch((x, y), width, height, boxstyle="round,pad=0,rounding_size=0.1", fc=color + "22", ec=color)


def _end(name: str, other: str, way: str, head: bool) -> tuple[float, float]:
    """Where an arrow meets a box: on the side that faces the other box, within the span that both share."""
    x, y, width, height, *_ = BOXES[name]
    ox, oy, other_width, other_height, *_ = BOXES[other]
    if way == "down":
        middle = (max(x, ox) + min(x + width, ox + other_width)) / 2
        return middle, y + height if head else y
    middle = (max(y, oy) + min(y + height, oy + other_height)) / 2
    return (x if (way == "right") == head else x + width), middle


if __name__ == "__main__":
    main()
