"""Recorded runs of scenes: `Trajectory` in the plane, `SpatialTrajectory` in space."""

from ..scenes import COLUMNS
from .recorded import MOST_SAMPLES, MOST_STEPS, Trajectory, check_work, placed, recorded, tips_of
from .space import SpatialTrajectory

__all__ = [
    "COLUMNS", "MOST_SAMPLES", "MOST_STEPS", "SpatialTrajectory", "Trajectory", "check_work", "placed", "recorded",
    "tips_of",
]  # fmt: skip
