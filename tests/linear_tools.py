"""What the tests of linear models, modes and equilibria share: formulations, arms, scenes at rest."""

from typing import Any

from flexarm_env.parameters import Arm, Link, Section
from flexarm_env.scene import Scene
from tests.scene_tools import everything

SEGMENTS = ("floating_frame", {"segments": 4})
MODES = ("floating_frame", {"modes": 3})
EXACT = ("geometrically_exact", {"elements": 4})
ELASTICA = ("elastica", {})
ALL = (SEGMENTS, MODES, EXACT, ELASTICA)
FULL = (SEGMENTS, EXACT, ELASTICA)


SLENDER = Section(EI=1.0, EA=1e6, C=1e6, m=1.0, J=1e-6)
"""Nearly without stretch, shear and rotary inertia; with L = 1 frequencies are those of the dimensionless tables."""


def one_link(section: Section = SLENDER, length: float = 1.0, **arm: Any) -> Arm:
    return Arm("one", (Link(length, section),), **arm)


def two_links(section: Section = SLENDER, **arm: Any) -> Arm:
    return Arm("two", (Link(1.0, section), Link(1.0, section)), **arm)


def unloaded(arm: Arm, **more: Any) -> Scene:
    """For steady rotation, which there is without gravity alone."""
    return Scene("rest", arm, duration=1.0, dt=0.01, **more)


def at_rest(arm: Arm, **more: Any) -> Scene:
    return everything(unloaded(arm, **more))
