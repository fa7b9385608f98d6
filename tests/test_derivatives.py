"""Jacobians of a control period against sixth-order differences of the period itself, for what arms are made of."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from flexarm_env.derivatives import Arms

Array = NDArray[np.float64]
SHARP = {"tolerance": 1e-12}

CASES = [
    pytest.param("FlexibleArm-v0", {}, id="one link"),
    pytest.param("TwoLinkFlexArm-v0", {}, id="two links", marks=pytest.mark.slow),
    pytest.param("FlexibleArm-v0", {"formulation": "floating_frame"}, id="floating frame", marks=pytest.mark.slow),
    pytest.param("FlexibleArm-v0", {"formulation": "geometrically_exact"}, id="exact beam", marks=pytest.mark.slow),
    pytest.param(
        "TwoLinkFlexArm-v0", {"action_mode": "residual_pd", "actuator": {"lag": 0.01, "delay": 0.025}},
        id="controllers and motors", marks=pytest.mark.slow,
    ),
]  # fmt: skip


def differences(arms: Arms, state: Array, action: Array) -> Array:
    """(n, X + O + 1, X + A) by sixth-order differences."""
    x = arms.moving

    def after(k: int, way: float) -> Array:
        both = np.concatenate([state, action], axis=1)
        both[:, k] += way
        out = arms.step(both[:, : arms.state_size], both[:, arms.state_size :])
        return np.concatenate([out[0][:, :x], out[1], out[2][:, None]], axis=1)

    columns = []
    for k in [*range(x), *range(arms.state_size, arms.state_size + arms.action_size)]:
        size = abs(state[:, k]).max() if k < x else 1.0
        e = 1e-4 * max(size, 1e-3)
        pairs = [after(k, m * e) - after(k, -m * e) for m in (1, 2, 3)]
        columns.append((45.0 * pairs[0] - 9.0 * pairs[1] + pairs[2]) / (60.0 * e))
    return np.stack(columns, axis=2)


def moving(arms: Arms, seed: int = 0, periods: int = 3) -> tuple[Array, Array]:
    """A state on the way, and an action."""
    rng, shape = np.random.default_rng(seed), (arms.n, arms.action_size)
    state = arms.reset(seed=seed)
    for _ in range(periods):
        state = arms.step(state, rng.uniform(-0.9, 0.9, shape))[0]
    return state, rng.uniform(-0.9, 0.9, shape)


@pytest.mark.parametrize(("env_id", "keywords"), CASES)
def test_a_period_against_differences(env_id: str, keywords: dict[str, Any]) -> None:
    """Relative error below 1e-6 (found: 1e-8 and less) for each arm; the values are those of a step, bit for bit."""
    arms = Arms(env_id, 9, **SHARP, **keywords)
    state, action = moving(arms)
    found = arms.jacobians(state, action)
    for one, other in zip(found[:3], arms.step(state, action), strict=True):
        assert np.array_equal(one, other)
    wanted = differences(arms, state, action)
    error = np.linalg.norm(found.moved - wanted, axis=(1, 2)) / np.linalg.norm(wanted, axis=(1, 2))
    assert error.max() < 1e-6
    arms.close()
