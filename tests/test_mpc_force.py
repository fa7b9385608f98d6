"""The controller `mpc_force`: its quadratic program against conditions of optimality, and against `lqr_force`."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from flexarm_env import control
from flexarm_env.control.lqr_force import wall_model
from flexarm_env.control.mpc_force import Program, boxed
from flexarm_env.rigid import largest_force
from tests.refusals import refusal


def model_and_limits() -> tuple[Any, np.ndarray]:
    env = gym.make("TwoLinkFlexArm-v0", task="press")
    setup = control.Setup.of(env)
    own = setup.arm, setup.torque_limits, setup.control_dt, control.LQRForceGains(), (1.6,), 0.8
    return wall_model(*own, largest_force(setup.arm), 0.3), np.asarray(setup.torque_limits)


def test_a_boxed_minimum_satisfies_its_conditions() -> None:
    """Karush, Kuhn and Tucker: no slope inside the bounds, and at a bound the slope points out of it."""
    rng = np.random.default_rng(0)
    for _ in range(50):
        root = rng.normal(size=(12, 12))
        H, wanted = root @ root.T + 0.01 * np.eye(12), 2.0 * rng.normal(size=12)
        low, high = -rng.uniform(0.1, 1.0, 12), rng.uniform(0.1, 1.0, 12)
        u = boxed(H, wanted, low, high)
        slope = H @ (u - wanted)
        assert (u >= low).all() and (u <= high).all()
        inside = (u > low) & (u < high)
        assert abs(slope[inside]).max(initial=0.0) < 1e-6 * abs(H).max()
        assert (slope[u == low] > -1e-6).all() and (slope[u == high] < 1e-6).all()


def test_the_program_has_the_cost_of_the_horizon() -> None:
    """The cost of any torques, summed period by period with the regulator's cost behind the horizon, exceeds x' P x by
    the program's; within the limits the program's torques are the regulator's."""
    model, limits = model_and_limits()
    rng, horizon, n = np.random.default_rng(0), 6, 2
    program, S = Program.of(model, horizon), len(model.A)
    x0, R = 1e-3 * rng.normal(size=S), model.W - model.B.T @ model.P @ model.B
    # Riccati: P = Q + A' P A - K' W K
    Q = model.P - model.A.T @ model.P @ model.A + model.K.T @ model.W @ model.K
    regulated = program.F @ x0
    assert regulated[:n] == pytest.approx(-model.K @ x0)
    for _ in range(5):
        u, x, cost = regulated + 0.01 * rng.normal(size=horizon * n), x0, 0.0
        for k in range(horizon):
            now = u[k * n : (k + 1) * n]
            cost += x @ Q @ x + now @ R @ now
            x = model.A @ x + model.B @ now
        cost += x @ model.P @ x
        off = u - regulated
        assert cost - x0 @ model.P @ x0 == pytest.approx(off @ program.H @ off, rel=1e-6)
    assert program.first_torques(x0, -1e3 * limits, 1e3 * limits) == pytest.approx(-model.K @ x0)


def test_within_the_limits_it_is_the_regulator_and_beyond_them_cheaper_than_a_clipped_one() -> None:
    model, limits = model_and_limits()
    rng, program = np.random.default_rng(1), Program.of(model, 20)
    cheaper = 0
    for _ in range(20):
        x = 0.05 * rng.normal(size=len(model.A))
        wanted = program.F @ x
        bounds = np.tile(limits, 20)
        u = boxed(program.H, wanted, -bounds, bounds)
        clipped = np.clip(wanted, -bounds, bounds)
        own, other = ((v - wanted) @ program.H @ (v - wanted) for v in (u, clipped))
        assert own <= other * (1.0 + 1e-9)
        cheaper += own < 0.999 * other
    assert cheaper > 5


def test_what_the_horizon_refuses() -> None:
    env = gym.make("TwoLinkFlexArm-v0", task="press")
    assert "horizon = 0" in refusal(lambda: control.make("mpc_force", env, {"horizon": 0}))
    space = gym.make("SpatialFlexArm-v0", task="press", elements=1)
    assert "controller = 'mpc_force'" in refusal(lambda: control.make("mpc_force", space))
