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
from flexarm_env import control
from flexarm_env.library import write_controller_fmu, write_fmu

PERIODS = 10_000
NAMES = ("tip[0]", "tip[1]", "energy.strain", "energy.work")


@pytest.mark.parametrize("form", ["2.0", "3.0"])
@pytest.mark.parametrize(
    ("env_id", "keywords", "periods"),
    [
        ("FlexibleArm-v0", {}, PERIODS),
        ("flexarm/slew-geared-v2", {}, PERIODS),
        ("FlexibleArm-v0", {"formulation": "floating_frame", "multipliers": True}, PERIODS),
        ("TwoLinkFlexArm-v0", {"formulation": "floating_frame", "action_mode": "residual_pd"}, 500),
        ("SpatialFlexArm-v0", {}, PERIODS),
    ],
    ids=["strip", "gears and friction", "multipliers", "two links", "space"],
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
    space = plain.plan.arm.spatial
    names = [*NAMES, *(("tip[2]", "deflection[1,2]") if space else ("deflection[0]",))]
    run = simulate_fmu(
        str(path), stop_time=float(t[-1]), output_interval=dt, input=inputs, output=names, set_stop_time=False,
        start_values={f"start_angle[{i}]": 0.2 for i in k} | ({f"target[{i}]": 0.5 for i in k} if space else {}),
    )  # fmt: skip

    target = [0.6 * plain.plan.arm.total_length, 0.3 * plain.plan.arm.total_length] if joints > 1 else 0.5
    env.reset(seed=0, options=None if space else {"start": [0.2] * joints, "target": target, "vibration": 0.0})
    if space:  # a target by the joint angles there
        plain.batch.ask(np.full(joints, 0.2), np.full(joints, 0.5), np.zeros(1))
        plain.batch.start((0,), (0,), limit=10**6)
    at = plain.batch.info_at
    places = [at.tip, at.tip + 1, at.energies + 1, at.energies + 4]
    places += [at.tip + 2, at.deflection + 5] if space else [at.deflection]
    wanted = [plain.batch.table[places, 0].copy()]
    for action in actions[:-1]:
        plain.step(action.astype(np.float32))
        wanted.append(plain.batch.table[places, 0].copy())
    found = np.array([run[name] for name in names]).T
    assert found.shape == np.array(wanted).shape
    assert np.array_equal(found, wanted)
    env.close()


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
