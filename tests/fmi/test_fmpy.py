"""Functional mock-up units by another's hand: FMPy validates them, simulates them and comes to Python's numbers."""

from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from fmpy import simulate_fmu
from fmpy.validation import validate_fmu

from benchmarks.doors import unit
from flexarm_env import control
from flexarm_env.library import write_controller_fmu

PERIODS = 10_000
MOVING = {
    "obstacle": {"shape": "half_space", "point": [0.0, 0.4], "normal": [0.0, -1.0]}, "stiffness": 1e4, "damping": 0.3,
    "friction": 0.3, "displacement_y": {"kind": "sine", "amplitude": 0.1, "omega": 6.0},
}  # fmt: skip
"""Wall that moves by 0.1 m."""


@pytest.mark.parametrize("form", ["2.0", "3.0"])
@pytest.mark.parametrize(
    ("env_id", "keywords", "periods"),
    [
        ("FlexibleArm-v0", {}, PERIODS),
        ("flexarm/slew-geared-v2", {}, PERIODS),
        ("FlexibleArm-v0", {"formulation": "floating_frame", "multipliers": True}, PERIODS),
        ("TwoLinkFlexArm-v0", {"formulation": "floating_frame", "action_mode": "residual_pd"}, 500),
        ("SpatialFlexArm-v0", {}, PERIODS),
        ("FlexibleArm-v0", {"contacts": MOVING}, 500),
    ],
    ids=["strip", "gears and friction", "multipliers", "two links", "space", "moving wall"],
)
def test_a_unit(env_id: str, keywords: dict[str, Any], periods: int, form: str, tmp_path: Path) -> None:
    """As `benchmarks.doors` judges it."""
    env = gym.make(env_id, info_level="full", duration=1000.0, disable_env_checker=True, **keywords)
    found = unit(env, form, tmp_path, periods)
    assert found["messages"] == [] and found["different"] == 0


@pytest.mark.parametrize("form", ["2.0", "3.0"])
@pytest.mark.parametrize("name", ["pd", "lqg"])
def test_a_controllers_unit(name: str, form: str, tmp_path: Path) -> None:
    """Validated, and over a second of an observation that stands still it says what Python says."""
    env = gym.make("FlexibleArm-v0", observation="measured", history=2, disable_env_checker=True)
    own, path = control.make(name, env), tmp_path / "controller.fmu"
    write_controller_fmu(own, path, "controller", form)
    assert validate_fmu(str(path)) == []
    seen, _ = env.reset(seed=3)
    own.reset(seen)
    wanted = [own.act(seen) * own.limits for _ in range(50)]
    names = [f"observation[{k}].{word}" for k in range(2) for word in own.setup.names]
    run = simulate_fmu(
        str(path), stop_time=1.0, output_interval=0.02, output=["torque[0]"], set_stop_time=False,
        start_values=dict(zip(names, seen.tolist(), strict=True)),
    )  # fmt: skip
    assert np.abs(run["torque[0]"][1:] - np.ravel(wanted)).max() < 1e-6 * own.limits[0]
    env.close()
