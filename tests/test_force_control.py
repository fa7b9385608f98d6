"""Controllers of the contact force: the arm at rest under a tip force against the solver, refusals, and episodes."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from flexarm_env import PointLoad, Scene, arms, control
from flexarm_env.control.arm_model import arm_model
from flexarm_env.control.catalogue import Following, controller
from flexarm_env.control.force import StaticChain
from flexarm_env.control.in_c import controller_source
from flexarm_env.control.lqr_force import _inverse_mass, _tip_rows
from flexarm_env.linear import static_equilibrium
from flexarm_env.time_functions import constant
from tests.control_tools import assert_restart_is_a_start
from tests.refusals import refusal


def pressing(n: int = 5, task: str = "press", **keywords: Any) -> Any:
    return gym.make_vec("TwoLinkFlexArm-v0", num_envs=n, task=task, **keywords)


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


def test_the_jacobian_balances_the_force() -> None:
    """Virtual work: without bending, the holding torques are -J' F."""
    chain, force = StaticChain(arms.named("de_luca_siciliano")), np.array([[-2e-6, 1e-6]])
    angles = np.array([[-0.7, 1.6]])
    _, bends, torques = chain.bend(angles, force)
    jacobian = chain.jacobian(angles, bends)
    assert torques[0] == pytest.approx(-jacobian[0].T @ force[0], rel=1e-4)


@pytest.mark.parametrize("bearing", [0.8, -2.0])
def test_the_modes_transmit_a_torque_to_the_wall(bearing: float) -> None:
    """Virtual work: torques J' n F press with F on a wall with normal n, and no mode accelerates."""
    arm, posture, stiffness, force = arms.named("de_luca_siciliano"), (1.6,), 240.0, 0.1
    model = arm_model(arm, posture)
    n, normal = len(model.A) // 2, np.array([np.cos(bearing), np.sin(bearing)])
    row = normal @ _tip_rows(arm, model, posture)
    torques = force * StaticChain(arm).jacobian(np.array([[0.0, 1.6]]), np.zeros((1, 2)))[0].T @ normal
    K = -model.A[n:, :n] + stiffness * np.outer(_inverse_mass(model) @ row, row)
    amplitudes, *_ = np.linalg.lstsq(K, model.B[n:] @ torques, rcond=None)
    assert abs(K @ amplitudes - model.B[n:] @ torques).max() < 1e-9
    assert stiffness * row @ amplitudes == pytest.approx(force, rel=1e-6)


def test_what_is_refused() -> None:
    reach = gym.make("TwoLinkFlexArm-v0")
    setup = control.Setup.of(reach)
    assert "task = 'reach'" in refusal(lambda: control.HybridForce(setup))
    for name in control.FORCE_NAMES:
        assert f"controller = '{name}'" in refusal(lambda name=name: control.make(name, reach))
    press = gym.make("TwoLinkFlexArm-v0", task="press")
    for name in ("lqr", "zvd"):
        assert f"controller = '{name}': must be one of \"pd\"" in refusal(lambda name=name: control.make(name, press))
    wall = {"obstacle": {"shape": "half_space", "point": [0.7, 0.0], "normal": [-1.0, 0.0]}, "stiffness": 1e3}
    touching = gym.make("TwoLinkFlexArm-v0", contacts=wall)
    assert "must be left out with mpc" in refusal(lambda: control.make("mpc", touching))
    made = control.make("impedance", press)
    assert "without contact" in refusal(lambda: controller_source(made, "c"))


def test_pd_follows_the_path_and_does_not_press() -> None:
    env = pressing(2)
    own = controller("pd", env)
    assert isinstance(own, Following)
    observation, _ = env.reset(seed=7)
    own.reset(observation)
    for _ in range(300):
        observation, *_, info = env.step(own.act(observation))
    assert (info["contact_force"] < 0.2 * info["target_force"]).all()
    assert np.linalg.norm(info["target"] - info["tip_position"], axis=1).max() < 0.05


@pytest.mark.slow
@pytest.mark.parametrize("name", control.FORCE_NAMES)
def test_the_force_is_held_within_ten_per_cent(name: str) -> None:
    """Root mean square over the last third of 12 s, of five arms."""
    env = pressing(duration=12.0)
    own = control.make(name, env)
    observation, _ = env.reset(seed=7)
    own.reset(observation)
    errors = []
    for _ in range(env.unwrapped.plan.limit):
        observation, _, terminated, _, info = env.step(own.act(observation))
        assert not terminated.any()
        errors.append(info["contact_force"] / info["target_force"] - 1.0)
    judged = np.array(errors[2 * len(errors) // 3 :])
    assert np.sqrt((judged**2).mean(axis=0)).max() < 0.1


@pytest.mark.parametrize("name", control.FORCE_NAMES)
def test_an_episode_may_begin_later_than_the_others(name: str) -> None:
    """Rows that restart act as in a controller whose episodes begin there; all other rows do not change."""
    assert_restart_is_a_start(name, pressing(3))
