"""Arms and scenes that the tests of scenes share."""

from __future__ import annotations

from flexarm_env.parameters import Arm, Link, Section
from flexarm_env.scene import Scene

SECTION = Section(1000.0, 1e4, 1e4, 1.0, 10.0)
ONE = Arm("one", (Link(10.0, SECTION),))
TWO = Arm("two", (Link(5.0, SECTION), Link(5.0, SECTION)))


def scene(arm: Arm = ONE, **changes: object) -> Scene:
    """A scene of 2 s in steps of 0.01 s in which nothing happens, but for the changes."""
    return Scene("s", arm, **{"duration": 2.0, "dt": 0.01, **changes})
