"""Campbell's diagram."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .style import COLORS, FAINT, INK, legend_above, styled_figure

if TYPE_CHECKING:
    from flexarm_env.linear import Campbell


def plot_campbell(found: Campbell, path: str | os.PathLike[str], title: str = "") -> Path:
    """Frequencies over spin, and the line at which one turn takes as long as one vibration; returns `path`.

    Forward and backward whirl as seen from rest; where some motion is neither (an arm that is no body of revolution),
    all as an observer sees them who turns with the arm. Spins at which something grows have a mark at the foot.
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
