"""Settings and fixtures that all tests share."""

from __future__ import annotations

import os

# No window, no sound, no display: set before anything imports pygame or matplotlib.
os.environ.setdefault("SDL_VIDEODRIVER", "dummy")
os.environ.setdefault("SDL_AUDIODRIVER", "dummy")
os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
os.environ.setdefault("MPLBACKEND", "Agg")

import numpy as np
import pytest
from hypothesis import HealthCheck, settings

# The first call of a compiled function takes seconds, so no deadline. On a developer's machine every run draws the same
# examples; CI draws new ones, and says of one that fails how to draw it again (@reproduce_failure).
settings.register_profile(
    "flexarm",
    deadline=None,
    derandomize=not os.environ.get("CI"),
    database=None,
    print_blob=True,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)
settings.load_profile("flexarm")


@pytest.fixture
def rng() -> np.random.Generator:
    """A generator that starts alike in every test."""
    return np.random.default_rng(20240611)
