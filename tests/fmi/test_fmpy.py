"""Functional mock-up units by another's hand: FMPy validates them, simulates them and comes to Python's numbers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from fmpy import simulate_fmu
from fmpy.validation import validate_fmu

import flexarm_env  # noqa: F401
from flexarm_env.library import write_fmu

PERIODS = 10_000
NAMES = ("tip[0]", "tip[1]", "deflection[0]", "energy.strain", "energy.work")


@pytest.mark.parametrize("form", ["2.0", "3.0"])
@pytest.mark.parametrize(
    ("env_id", "keywords", "periods"),
    [
        ("FlexibleArm-v0", {}, PERIODS),
        ("flexarm/slew-geared-v2", {}, PERIODS),
        ("FlexibleArm-v0", {"formulation": "floating_frame", "multipliers": True}, PERIODS),
        ("TwoLinkFlexArm-v0", {"formulation": "floating_frame", "action_mode": "residual_pd"}, 500),
    ],
    ids=["strip", "gears and friction", "multipliers", "two links"],
)
def test_a_unit(env_id: str, keywords: dict[str, Any], periods: int, form: str, tmp_path: Path) -> None:
    env = gym.make(env_id, info_level="full", duration=1000.0, disable_env_checker=True, **keywords)
    path = tmp_path / "arm.fmu"
    write_fmu(env, path, "arm", form)
    assert validate_fmu(str(path)) == []

    plain = env.unwrapped
    joints, dt = env.action_space.shape[0], plain.dt
    t, k = dt * np.arange(periods + 1), np.arange(joints)
    actions = (0.3 * np.sin(2.0 * t[:, None] + k)).astype(np.float32).astype(np.float64)
    word, scale = ("torque", plain.plan.arm.torque_limits) if plain.plan.action_mode == "torque" else ("action", 1.0)
    inputs = np.zeros(len(t), [("time", float), *((f"{word}[{i}]", float) for i in k)])
    inputs["time"] = t
    for i in k:
        inputs[f"{word}[{i}]"] = (actions * scale)[:, i]
    run = simulate_fmu(
        str(path), stop_time=float(t[-1]), output_interval=dt, input=inputs, output=list(NAMES), set_stop_time=False,
        start_values={f"start_angle[{i}]": 0.2 for i in k},
    )  # fmt: skip

    target = [0.6 * plain.plan.arm.total_length, 0.3 * plain.plan.arm.total_length] if joints > 1 else 0.5
    env.reset(options={"start": [0.2] * joints, "target": target, "vibration": 0.0})
    at = plain.batch.info_at
    places = [at.tip, at.tip + 1, at.deflection, at.energies + 1, at.energies + 4]
    wanted = [plain.batch.table[places, 0].copy()]
    for action in actions[:-1]:
        plain.step(action.astype(np.float32))
        wanted.append(plain.batch.table[places, 0].copy())
    found = np.array([run[name] for name in NAMES]).T
    assert found.shape == np.array(wanted).shape
    assert np.array_equal(found, wanted)
    env.close()
