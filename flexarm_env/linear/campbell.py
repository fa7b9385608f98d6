"""Natural frequencies of a spinning arm as functions of its spin (Campbell diagram)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import validation as check
from ..scene import Scene
from ..validation import Array
from .vibration import modes

ROUND = 1e-3
"""Largest difference of a mode's `whirl` from 1 or -1 at which its points count as moving on circles."""


@dataclass(frozen=True)
class Campbell:
    """The n lowest natural frequencies of an arm in steady rotation, at each of m spin rates.

    Attributes:
        spins (m,): spin rates, rad/s. frequencies (m, n): natural frequencies, rad/s, in the frame that rotates with
            the arm (`Modes.frequencies`).
        at_rest (m, n): natural frequencies, rad/s, in the fixed frame. Let f be the frequency in the rotating frame. In
            the fixed frame the frequency is f + spin if points move on circles in the direction of the spin
            (`Modes.whirl` = 1), and spin - f if points move on circles against the spin. The frequency is f in both
            frames if all points move along the axis of rotation. For a positive spin, positive values are forward whirl
            and negative values are backward whirl. Every other motion has several frequencies in the fixed frame, and
            its entry is NaN.
        growing (m,): number of unstable modes at each spin rate, counted among all modes (`Modes.growing`).
    """

    spins: Array
    frequencies: Array
    at_rest: Array
    growing: NDArray[np.int64]


def campbell(
    scene: Scene,
    spins: Sequence[float],
    n: int = 6,
    formulation: str | None = None,
    *,
    clamped: bool | Sequence[int] = True,
    **options: Any,
) -> Campbell:
    """Compute natural frequencies of an arm in steady rotation about its first joint's axis, for several spins.

    Args:
        scene: a scene with a pinned root and without gravity; its loads are not used. spins: spin rates, rad/s.
        n: number of frequencies at each spin rate. The n lowest frequencies in the fixed frame are chosen if all modes
            have a frequency there. If a mode has no frequency in the fixed frame, as for planar arms, the n lowest
            frequencies in the frame that rotates with the arm are chosen.
        formulation, options, clamped: arguments of `modes`; by default the hub rotates at exactly the spin rate.
    Returns:
        The frequencies as a `Campbell`, which `plotting.plot_campbell` plots.
    Raises:
        ValueError: an argument is invalid. NoEquilibrium: the arm has no steady state at a spin rate.
    """
    n = check.integer("n", n, minimum=1)
    given = check.sequence("spins", spins, "one or more numbers (rad/s)")
    if not given:
        raise check.InvalidValue("spins", spins, "must be one or more numbers (rad/s)")
    rows = []
    for k, value in enumerate(given):
        spin = check.number(f"spins[{k}]", value, "rad/s")
        found = modes(scene, 10**6, formulation, spin=spin, clamped=clamped, **options)
        seen = found.frequencies.copy()
        if spin != 0.0:
            whirl = found.whirl if len(found.whirl) else np.zeros(len(seen))  # in the plane all is across the axis
            seen = np.where(np.isnan(whirl), seen, spin + np.sign(whirl) * seen)
            seen[np.abs(np.abs(whirl) - 1.0) > ROUND] = np.nan
        key = np.where(np.isnan(seen), found.frequencies, np.abs(seen))
        lowest = np.argsort(key, kind="stable")[:n]
        rows.append((spin, found.frequencies[lowest], seen[lowest], found.growing))
    columns = [np.array(column) for column in zip(*rows, strict=True)]
    return Campbell(columns[0], columns[1], columns[2], columns[3])
