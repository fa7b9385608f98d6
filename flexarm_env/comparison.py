"""Errors of a run's tip relative to a reference solution."""

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from flexarm_env import validation as check
from flexarm_env.accuracy import common_instants


@dataclass(frozen=True)
class TipError:
    """Errors of a run relative to a reference solution, at the instants that run and reference have in common.

    max_tip_error, rms_tip_error: largest and root-mean-square distance of the tip from the reference tip, m.
    max_tip_angle_error, max_start_angle_error: largest error of the tip's and of the root's angle, rad. time_of_max:
    instant of the largest tip error, s. instants: number of compared instants. An error is NaN if the reference lacks
    the column of the compared quantity.
    """

    max_tip_error: float
    rms_tip_error: float
    max_tip_angle_error: float
    time_of_max: float
    instants: int
    max_start_angle_error: float = math.nan

    def found(self) -> dict[str, float]:
        """Dict of all errors that are not NaN, by name."""
        return {name: value for name, value in dataclasses.asdict(self).items() if not math.isnan(value)}


def tip_error(
    t: ArrayLike, tip: ArrayLike, reference: Mapping[str, NDArray[np.float64]], start: ArrayLike | None = None
) -> TipError:
    """Compute the errors of a run's tip relative to a reference solution.

    Args:
        t (n,): increasing instants, s. tip (n, 3): position x, y of the tip, m, and angle of the tip, rad.
        reference: arrays by name: t, and any of tip_x with tip_y, tip_angle and start_angle
            (`flexarm_env.scenes.reference(NAME).columns`, `read_reference`). start (n, 3): position and angle of the
            root, as in tip; required to compare start_angle.
    Raises:
        ValueError: run and reference have no common instant after the first; instants are not interpolated.
    """
    path = np.asarray(tip, dtype=float)
    mine, theirs = common_instants(t, reference["t"])
    if mine.size < 2:
        step = float(reference["t"][1] - reference["t"][0]) if reference["t"].size > 1 else 0.0
        what = f"must share instants with the reference, which has one every {step:g} s to {reference['t'][-1]:g} s"
        own = np.asarray(t, dtype=float)
        raise check.InvalidValue("sample", float(own[1] - own[0]) if own.size > 1 else 0.0, what)
    ways: dict[str, NDArray[np.float64]] = {}
    if "tip_x" in reference and "tip_y" in reference:
        ways["tip"] = np.hypot(path[mine, 0] - reference["tip_x"][theirs], path[mine, 1] - reference["tip_y"][theirs])
    if "tip_angle" in reference:
        ways["angle"] = np.abs(path[mine, 2] - reference["tip_angle"][theirs])
    if "start_angle" in reference and start is not None:
        ways["start"] = np.abs(np.asarray(start, dtype=float)[mine, 2] - reference["start_angle"][theirs])
    if not ways:
        what = "must be t, and tip_x and tip_y, tip_angle or start_angle"
        raise check.InvalidValue("columns", tuple(reference), what)
    largest = {name: float(way.max()) for name, way in ways.items()}
    first = next(iter(ways.values()))
    return TipError(
        max_tip_error=largest.get("tip", math.nan),
        rms_tip_error=float(np.sqrt(np.mean(ways["tip"] ** 2))) if "tip" in ways else math.nan,
        max_tip_angle_error=largest.get("angle", math.nan),
        time_of_max=float(np.asarray(t, dtype=float)[mine[first.argmax()]]),
        instants=int(mine.size),
        max_start_angle_error=largest.get("start", math.nan),
    )
