"""FLEXARM_COMPILER=python: the same numbers from plain Python, for a debugger to step through."""

import json
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from flexarm_env.compiler import UNCOMPILED
from tests.processes import python, uncompiled_tests

CASES: list[tuple[str, int, dict[str, Any]]] = [
    ("FlexibleArm-v0", 4, {}),
    ("TwoLinkFlexArm-v0", 5, {"formulation": "geometrically_exact", "elements": 2}),
    ("TwoLinkFlexArm-v0", 3, {"formulation": "elastica", "step_tolerance": 1e-3}),
    ("FlexibleArm-v0", 3, {"formulation": "floating_frame"}),
]
"""Environment, arms (as many as are advanced in lanes where they are compiled), keywords."""


def stepped(name: str, count: int, options: dict[str, Any], mode: str | None = None) -> list[float]:
    """Observations and rewards of a vector's start and first two steps."""
    envs = gym.make_vec(name, num_envs=count, vectorization_mode=mode, **options)
    found = envs.reset(seed=7)[0].ravel().tolist()
    actions = np.linspace(-1.0, 1.0, count, dtype=np.float32)[:, None].repeat(envs.single_action_space.shape[0], 1)
    for _ in range(2):
        observations, rewards, *_ = envs.step(actions)
        found += [*observations.ravel().tolist(), *rewards.tolist()]
    envs.close()
    return found


@pytest.mark.slow
@pytest.mark.skipif(UNCOMPILED, reason="compares compiled with uncompiled")
def test_vectors() -> None:
    """Each is what its single environments are, and the first what it is when compiled."""
    lines = "import json; from tests.test_uncompiled import CASES, stepped"
    lines += "; print(json.dumps([[stepped(*case), stepped(*case, 'sync')] for case in CASES]))"
    results = json.loads(python("-W", "ignore", "-c", lines, FLEXARM_COMPILER="python").stdout)
    for case, (vector, singles) in zip(CASES, results, strict=True):
        assert vector == singles, case
    np.testing.assert_allclose(results[0][0], stepped(*CASES[0]), rtol=0.0, atol=1e-12)


def test_lanes_are_refused() -> None:
    """Python's numbers stand for one arm: a kernel that is called on eight says so instead of mixing them."""
    lines = "import numpy as np; from flexarm_env.compiler.lanes import *; load(EIGHT, np.arange(16.0), 1)"
    run = python("-c", lines, code=1, FLEXARM_COMPILER="python")
    assert "8 lanes: there is only one where compilation is disabled" in run.stderr


@pytest.mark.slow
def test_what_formulations_owe_the_integrator() -> None:
    """Damping forces that come from a potential, and `update` (`uncompiled_coordinates.py`)."""
    uncompiled_tests("uncompiled_coordinates.py")
