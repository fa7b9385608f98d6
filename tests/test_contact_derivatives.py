"""Derivatives of control periods in which an arm touches a wall and slides on it."""

from __future__ import annotations

import numpy as np
import pytest

from flexarm_env import Contact
from flexarm_env.compiler import UNCOMPILED
from flexarm_env.derivatives import Arms
from flexarm_env.shapes import HalfSpace


@pytest.mark.skipif(UNCOMPILED, reason="uncompiled code has no tangents")
def test_periods_in_contact_have_derivatives_forwards_and_backwards() -> None:
    """Against central differences, and backwards against forwards."""
    wall = Contact(HalfSpace((0.0, 0.957), (0.0, 1.0)), 300.0, damping=0.5, friction=0.3)

    free = Arms("FlexibleArm-v0", 1)
    env, action, h = Arms("FlexibleArm-v0", 1, contacts=wall, dt=0.02 / 3.0), np.full((1, 1), -0.5), 1e-4
    state = env.reset(seed=0)
    for _ in range(10):
        before, state = state, env.step(state, action)[0]
    # the wall acts in the last period
    assert abs(state - free.step(before, action)[0]).max() > 1e-3 * abs(state).max()
    forward = env.jacobians(state, action)
    slope = (env.step(state, action + h)[0] - env.step(state, action - h)[0]) / (2.0 * h)
    assert abs(forward.B[..., 0] - slope).max() < 1e-4 * abs(slope).max()
    bar, (entries,) = np.ones_like(state), forward.observation.shape[1:]
    backward = env.vjp(state, action, bar, np.zeros((1, entries)), np.zeros(1))[1]
    assert abs(backward - (bar[:, None] @ forward.B)[:, 0]).max() < 1e-9 * abs(backward).max()
