"""Arms, scenes and formulations that tests share."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from flexarm_env.parameters import Arm, Link, Section
from flexarm_env.scene import PointLoad, Scene
from flexarm_env.time_functions import constant
from flexarm_env.trajectory import Trajectory

SECTION = Section(1000.0, 1e4, 1e4, 1.0, 10.0)
ONE = Arm("one", (Link(10.0, SECTION),))
TWO = Arm("two", (Link(5.0, SECTION), Link(5.0, SECTION)))


def scene(arm: Arm = ONE, **changes: object) -> Scene:
    """A scene of 2 s in steps of 0.01 s in which nothing happens, but for the changes."""
    return Scene("s", arm, **{"duration": 2.0, "dt": 0.01, **changes})


def everything(scene: Scene) -> Scene:
    """The same motion with gravity, a load and damping of next to nothing, so that tests share one compiled form."""
    loads = (*scene.loads, PointLoad(0, "tip", force_y=constant(1e-300)))
    arm = replace(scene.arm, tau_d=max(scene.arm.tau_d, 1e-300))
    return replace(scene, arm=arm, loads=loads, gravity=scene.gravity or (0.0, 0.0))


def tips_apart(one: Trajectory, other: Trajectory) -> float:
    """Largest distance of two runs' tips in the plane, as a share of the arm's length."""
    return float(np.hypot(*(one.tip - other.tip)[:, :2].T).max() / one.scene.arm.total_length)


Method = tuple[str, dict[str, Any]]
"""A formulation with its options."""


def every(choices: Any, slow: tuple[str, ...] = ()) -> Any:
    """Each formulation with its options; those `slow`, by formulation or option, compile what no other test needs, or
    take long."""
    sets = [
        pytest.param(
            f, o, id="_".join([f, *(f"{k}{v}" for k, v in o.items())]),
            marks=[pytest.mark.slow] if {f, *o} & set(slow) else [],
        )
        for f, o in choices
    ]
    return pytest.mark.parametrize(("formulation", "options"), sets)
