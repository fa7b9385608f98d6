"""How far a run's tip is from a reference: errors at the instants that both have."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from flexarm_env import validation as check

_SAME_TIME = 1e-9
"""Instants this close (s, and relative to the last one) are the same."""


@dataclass(frozen=True)
class TipError:
    """Distance of the tip from a reference.

    max_tip_error, rms_tip_error: largest and root-mean-square distance, m; max_tip_angle_error: rad;
    time_of_max: s, where the largest distance occurs; instants: how many were compared.
    """

    max_tip_error: float
    rms_tip_error: float
    max_tip_angle_error: float
    time_of_max: float
    instants: int


def common_instants(t: ArrayLike, other: ArrayLike) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Indices into two increasing sequences of times, t (n,) s and other (m,) s, of the instants that both have."""
    first, second = np.asarray(t, dtype=float), np.asarray(other, dtype=float)
    nearest = np.clip(np.searchsorted(second, first), 0, second.size - 1)
    before = np.maximum(nearest - 1, 0)
    nearest = np.where(np.abs(second[before] - first) < np.abs(second[nearest] - first), before, nearest)
    same = np.abs(second[nearest] - first) <= _SAME_TIME * max(1.0, abs(float(second[-1])))
    return np.flatnonzero(same), nearest[same]


def tip_error(t: ArrayLike, tip: ArrayLike, reference: Mapping[str, NDArray[np.float64]]) -> TipError:
    """Errors of a tip path against a reference table.

    Args:
        t: (n,) s, increasing. tip: (n, 3): x, y in m and angle in rad.
        reference: columns t, tip_x, tip_y, tip_angle (`flexarm_env.scenes.reference(NAME).columns`).
    Raises:
        ValueError: the two have no instant in common after the first; nothing is interpolated.
    """
    path = np.asarray(tip, dtype=float)
    mine, theirs = common_instants(t, reference["t"])
    if mine.size < 2:
        step = float(reference["t"][1] - reference["t"][0]) if reference["t"].size > 1 else 0.0
        what = f"must share instants with the reference, which has one every {step:g} s to {reference['t'][-1]:g} s"
        own = np.asarray(t, dtype=float)
        raise check.InvalidValue("sample", float(own[1] - own[0]) if own.size > 1 else 0.0, what)
    apart = np.hypot(path[mine, 0] - reference["tip_x"][theirs], path[mine, 1] - reference["tip_y"][theirs])
    turn = np.abs(path[mine, 2] - reference["tip_angle"][theirs])
    return TipError(
        max_tip_error=float(apart.max()),
        rms_tip_error=float(np.sqrt(np.mean(apart**2))),
        max_tip_angle_error=float(turn.max()),
        time_of_max=float(np.asarray(t, dtype=float)[mine[apart.argmax()]]),
        instants=int(mine.size),
    )
