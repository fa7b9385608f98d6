"""State estimate of planar receding-horizon control: it has the measured outputs, and its loop decays on own arms."""

import gymnasium as gym
import numpy as np
import pytest

from flexarm_env import arms, control
from flexarm_env.control.mpc import regulator
from flexarm_env.control.mpc_estimate import KEPT, estimate_maps, loop_radius

SLENDER = """
name = "slender"
hub_inertia = 0.05
payload = { mass = 0.25, inertia = 1e-4 }
torque_limits = [6.0]
tau_d = TAU_D

[[links]]
length = 1.5
[links.section]
width = 0.04
thickness = 0.004
E = 70e9
rho = 2700.0
G = 26e9
"""
"""Aluminium strip of 1.5 m, whose vibration decays slowly."""


def made(tau_d: float, period: float, **options: object) -> tuple[gym.Env, control.Controller]:
    """Environment with the slender arm, and its controller."""
    arm = arms.from_toml(SLENDER.replace("TAU_D", str(tau_d)))
    env = gym.make("FlexibleArm-v0", arm=arm, control_dt=period, **options)
    return env, control.make("mpc", env)


@pytest.mark.parametrize("env_id", ["FlexibleArm-v0", "TwoLinkFlexArm-v0"])
def test_the_estimate_has_the_measured_outputs(env_id: str) -> None:
    plant = control.make("mpc", gym.make(env_id)).plant
    home, _ = plant.still(np.zeros((1, plant.n_inputs)))
    C = plant.outputs(home)[1][0]
    for memory in (0.0, 0.5, 1.0):
        by_prediction, by_outputs = estimate_maps(plant, memory)
        assert abs(C @ by_outputs - np.eye(len(C))).max() < 1e-5
        assert abs(C @ by_prediction).max() < 1e-5 * max(1.0, abs(C).max())


def test_the_weight_is_reduced_only_where_the_loop_decays_slowly() -> None:
    assert control.make("mpc", gym.make("FlexibleArm-v0")).memory == 0.9
    _, own = made(1e-3, 0.01)
    assert own.memory < own.gains.memory
    K = regulator(own.setup.arm, 0.01, own.gains, ()).K
    (A,), (B,) = own.plant.jacobians(*own.plant.still(np.zeros((1, 1))))
    alone = np.log(abs(np.linalg.eigvals(A - B @ K)).max())
    kept, tuned = (np.log(loop_radius(own.plant, K, memory)) for memory in (own.memory, 0.9))
    assert kept <= KEPT * alone < tuned


def test_plans_last_as_long_with_shorter_periods() -> None:
    lengths = []
    for period in (0.02, 0.01, 0.005):
        own = control.make("mpc", gym.make("FlexibleArm-v0", control_dt=period))
        lengths.append(own.block * period)
    assert lengths == pytest.approx([0.04] * 3)


@pytest.mark.slow
@pytest.mark.parametrize(("tau_d", "period"), [(1e-3, 0.01), (1e-3, 0.005), (5e-4, 0.01)])
def test_mpc_settles_a_slender_arm_at_short_periods(tau_d: float, period: float) -> None:
    env, policy = made(tau_d, period, duration=4.5)
    observation, info = env.reset(seed=0, options={"start": 0.0, "target": 0.3})
    policy.reset(observation)
    over = False
    while not over:
        observation, _, terminated, truncated, info = env.step(policy.act(observation))
        over = terminated or truncated
    assert info["is_success"]
