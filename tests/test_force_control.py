"""`HybridForce`: the arm at rest under a tip force against the solver, refusals, and an episode of the task "press"."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from flexarm_env import PointLoad, Scene, arms, control
from flexarm_env.control.force import StaticChain
from flexarm_env.linear import static_equilibrium
from flexarm_env.time_functions import constant
from tests.refusals import refusal


def test_the_arm_at_rest_is_that_of_the_solver() -> None:
    """One strip under a small force across it: theory of small deflections, tip to 0.1 % of the deflection."""
    arm = arms.named("strip")
    scene = Scene("held", arm, duration=1.0, dt=0.01, loads=(PointLoad(0, "tip", force_y=constant(0.5)),))
    still = static_equilibrium(scene, "elastica").shape_points()[-1]
    tip, _, torques = StaticChain(arm).bend(np.zeros((1, 1)), np.array([[0.0, 0.5]]))
    assert abs(tip[0] - still).max() < 2e-3 * abs(still[1])
    assert torques[0, 0] == pytest.approx(-0.5 * tip[0, 0])


def test_angles_are_found_whose_tip_is_where_it_was_asked_to_be() -> None:
    chain, force = StaticChain(arms.named("de_luca_siciliano")), np.array([[-0.2, 0.05]])
    place = np.array([[0.7, 0.1]])
    angles, bends, torques = chain.solve(np.array([[-0.7, 1.6]]), force, place)
    assert abs(chain.bend(angles, force)[0] - place).max() < 1e-6
    # virtual work: joint torques balance the force about the hub
    assert torques[0, 0] == pytest.approx(-(place[0, 0] * 0.05 - place[0, 1] * -0.2), abs=1e-6)
    assert bends.shape == (1, 2)


def test_what_is_refused() -> None:
    setup = control.Setup.of(gym.make("TwoLinkFlexArm-v0"))
    assert "task = 'reach'" in refusal(lambda: control.HybridForce(setup))


def test_the_force_is_held_within_ten_per_cent() -> None:
    """Root mean square over the last two thirds, of five arms."""
    env: Any = gym.make_vec("TwoLinkFlexArm-v0", num_envs=5, task="press")
    controller = control.HybridForce(control.Setup.of(env))
    observation, _ = env.reset(seed=7)
    controller.reset(observation)
    errors = []
    for _ in range(env.unwrapped.plan.limit):
        observation, _, terminated, _, info = env.step(controller.act(observation))
        assert not terminated.any()
        errors.append(info["contact_force"] / info["target_force"] - 1.0)
    judged = np.array(errors[len(errors) // 3 :])
    assert np.sqrt((judged**2).mean(axis=0)).max() < 0.1
