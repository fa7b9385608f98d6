"""Recorded simulations of scenes."""

from ..scenes import COLUMNS
from .recorded import MOST_SAMPLES, MOST_STEPS, Trajectory, check_work, recorded

__all__ = [
    "COLUMNS", "MOST_SAMPLES", "MOST_STEPS", "Trajectory", "check_work", "recorded",
]  # fmt: skip
