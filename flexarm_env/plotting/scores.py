"""Plot the suite's scores: one line for each task, one marker for each method."""

import os
from collections.abc import Mapping, Sequence

from .style import COLORS, FAINT, INK, styled_figure

LEFT, RIGHT = -1.0, 1.15
"""Range of the axis of scores. Lower scores are drawn at the left edge, and a label has their value."""

MARKERS = ("D", "o", "s", "^", "v", "P", "X")


def plot_scores(
    labels: Sequence[str], methods: Mapping[str, Sequence[float | None]], path: str | os.PathLike[str]
) -> None:
    """Plot scores: 0 is the score of PD control, 1 is the score of the best known result.

    Args:
        labels: names of the tasks. methods: scores of at most seven methods, one for each task, or None. path: file of
            the figure.
    Raises:
        ValueError: the path does not end in .png, .pdf or .svg.
    """
    with styled_figure(path, 7.6, 0.27 * len(labels) + 1.3) as figure:
        axes = figure.add_subplot()
        for value, name in ((0.0, "PD"), (1.0, "best known")):
            axes.axvline(value, color=FAINT, lw=1.2, zorder=1)
            axes.annotate(name, (value, 1.0), (0, 2), xycoords=("data", "axes fraction"), textcoords="offset points",
                          ha="center", va="bottom", fontsize=8, color=INK)  # fmt: skip
        below: list[list[str]] = [[] for _ in labels]
        for k, (name, scores) in enumerate(methods.items()):
            # methods of equal score stay visible
            at = [(i + 0.09 * (k - 2), score) for i, score in enumerate(scores) if score is not None]
            axes.scatter(
                [max(score, LEFT) for _, score in at], [i for i, _ in at], s=34, color=("#4c4c4c", *COLORS)[k],
                marker=MARKERS[k], label=name, zorder=3, lw=0.6, ec="white",
            )  # fmt: skip
            for texts, score in zip(below, scores, strict=True):
                if score is not None and score < LEFT:
                    texts.append(f"{name} {score:.1f}")
        for i, texts in enumerate(below):
            axes.annotate(", ".join(texts), (LEFT, i), (8, 0), textcoords="offset points", va="center", fontsize=7.5)
        axes.set(xlim=(LEFT - 0.06, RIGHT), ylim=(len(labels) - 0.5, -0.5), xlabel="score")
        axes.set_yticks(range(len(labels)), labels)
        axes.tick_params(axis="y", length=0)
        figure.legend(loc="outside lower center", ncols=6, columnspacing=1.2, handletextpad=0.2)
