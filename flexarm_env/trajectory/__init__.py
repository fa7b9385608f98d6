"""Recorded simulations of scenes: `Trajectory` for motion in the plane, `SpatialTrajectory` for motion in space."""

from ..scenes import COLUMNS
from .recorded import MOST_SAMPLES, MOST_STEPS, Trajectory, check_work, kind_of, recorded
from .space import SpatialTrajectory

__all__ = [
    "COLUMNS", "MOST_SAMPLES", "MOST_STEPS", "SpatialTrajectory", "Trajectory", "check_work", "kind_of", "recorded",
]  # fmt: skip
