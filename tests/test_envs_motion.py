"""Episodes with prescribed motion, and the replay of scenes through an environment."""

import dataclasses
import math
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from flexarm_env import named, simulate, time_functions
from flexarm_env.envs.replay import through_env
from flexarm_env.scene import JointTorque
from tests.env_tools import assert_same

BROKEN = time_functions.from_array([[0.0, 0.0], [0.085, 0.05], [0.16, 0.02], [5.0, 0.6]], "linear")
"""Rates jump within a control period and at the end of one."""


def rest(env: Any) -> np.ndarray:
    return np.zeros(env.action_space.shape, np.float32)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scene", "formulation", "options"),
    [
        ("robot_arm_motion", None, {"segments": 5, "elements": 1, "dt": 0.05}),
        ("robot_arm_torque", "elastica", {"nodes": 5}),
        ("two_link_motion", "elastica", {}),
    ],
)
def test_replay_through_the_environment_is_simulate(
    scene: str, formulation: str | None, options: dict[str, Any], tmp_path: Path
) -> None:
    settings = named(scene).settings(formulation, **options)
    one, other = through_env(named(scene), settings), simulate(named(scene), formulation, **options)
    one.to_csv(tmp_path / "one.csv")
    other.to_csv(tmp_path / "other.csv")
    assert (tmp_path / "one.csv").read_bytes() == (tmp_path / "other.csv").read_bytes()
    assert_same(one.joint_torque, other.joint_torque)
    assert_same(one.work, other.work)


@pytest.mark.parametrize("scene", ["flying_rod", "two_link_free_flight"])
def test_free_bodies_are_refused_in_a_sentence(scene: str) -> None:
    with pytest.raises(ValueError, match="free body"):
        through_env(named(scene), named(scene).settings())


def test_hub_torque_is_what_enforces_the_motion() -> None:
    """The hub's own inertia and the arm's: compared with the rate of angular momentum about the hub."""
    env = gym.make("FlexibleArm-v0")
    motion = time_functions.cycloid(1.0, 2.0)
    _, info = env.reset(seed=0, options={"motion": motion})
    torques = [info["hub_torque"]]
    while True:
        _, _, terminated, truncated, info = env.step(env.action_space.sample())
        torques.append(info["hub_torque"])
        if terminated or truncated:
            break
    assert len(torques) == 101
    settings = {"formulation": "elastica", **env.unwrapped.plan.settings.options()}
    trajectory = simulate(env.unwrapped.guide.scene, sample=0.02, **settings)
    np.testing.assert_allclose(torques, trajectory.joint_torque[:, 0], rtol=0, atol=0)
    assert np.abs(torques).max() > 0.1


def test_the_motion_s_action_is_ignored_and_the_other_joint_keeps_its_own() -> None:
    env = gym.make("TwoLinkFlexArm-v0", joint_limits=None)
    ends = []
    for action in ([0.0, 0.0], [1.0, 0.0], [0.0, 0.5]):
        env.reset(seed=0, options={"motion": "two_link_motion"})
        for _ in range(30):
            outcome = env.step(np.array(action, np.float32))
        ends.append(outcome)
    assert_same(ends[0][0], ends[1][0])
    assert not np.array_equal(ends[0][0], ends[2][0])
    assert ends[2][-1]["joint_torque"][1] == pytest.approx(0.15)


@pytest.mark.slow
@pytest.mark.parametrize("formulation", ["elastica", "geometrically_exact"])
def test_torques_beside_a_motion_are_a_scene_s_load(formulation: str) -> None:
    """The elbow's torques, held over periods, are those of a load in steps; the hub's motion has kinks between them."""
    env: Any = gym.make("TwoLinkFlexArm-v0", formulation=formulation, joint_limits=None).unwrapped
    motion = time_functions.from_array([[0.0, 0.0], [0.05, 0.05], [0.09, 0.02], [0.2, 0.1]], "linear")
    env.reset(seed=0, options={"motion": {"joint0": motion}})
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, 10).astype(np.float32)
    torques = env.plan.arm.torque_limits[1] * actions.astype(np.float64)
    load = JointTorque(1, time_functions.steps(0.02 * np.arange(10), torques))
    scene = dataclasses.replace(env.guide.scene, loads=(load,))
    settings = {"formulation": formulation, **env.plan.settings.options()}
    trajectory = simulate(scene, sample=0.02, estimate_error=False, **settings)
    for k, action in enumerate(actions):
        env.step(np.array([0.0, action], np.float32))
        np.testing.assert_allclose(env.guide.simulation.work.q, trajectory.q[k + 1], rtol=0.0, atol=1e-9)


def test_the_arm_starts_where_the_motion_does_and_ends_with_it() -> None:
    env = gym.make("FlexibleArm-v0", duration=1.0)
    table = np.array([[0.0, 0.4], [1.0, 0.9], [3.0, 0.5]])
    observation, info = env.reset(seed=0, options={"motion": table})
    assert observation[0] == pytest.approx(math.sin(0.4), abs=1e-7)
    assert info["target"] == pytest.approx(0.5)
    steps = 0
    while True:
        observation, _, terminated, truncated, _ = env.step(rest(env))
        steps += 1
        if terminated or truncated:
            break
    assert steps == 150
    assert observation[0] == pytest.approx(math.sin(0.5), abs=1e-6)
    env.reset(seed=0)
    assert env.unwrapped.guide is None


def test_motions_in_every_form_agree(tmp_path: Path) -> None:
    rows = [[0.0, 0.0], [0.5, 0.3], [1.0, 0.2]]
    path = tmp_path / "motion.csv"
    path.write_text("t,psi\n" + "\n".join(f"{t},{psi}" for t, psi in rows) + "\n")
    forms = [rows, np.array(rows), str(path), {"t": [0.0, 0.5, 1.0], "psi": [0.0, 0.3, 0.2]}]
    forms += [time_functions.from_array(rows), {"joint0": rows}, [np.array(rows)]]
    env = gym.make("FlexibleArm-v0")
    outcomes = []
    for form in forms:
        env.reset(seed=0, options={"motion": form})
        outcomes.append([env.step(rest(env)) for _ in range(10)])
    for other in outcomes[1:]:
        assert_same(outcomes[0], other)
    env.reset(seed=0, options={"motion": rows, "interpolation": "linear"})
    assert not np.array_equal(env.step(rest(env))[0], outcomes[0][0][0])


def test_vector_resets_take_one_motion_for_all_or_one_each() -> None:
    single = gym.make("FlexibleArm-v0")
    motions: list[Any] = ["robot_arm_motion", None, time_functions.ramp(0.5, 0.1)]
    native = gym.make_vec("FlexibleArm-v0", num_envs=3)
    native.reset(seed=0, options={"motion": motions})
    for _ in range(8):
        outcome = native.step(np.full((3, 1), 0.3, np.float32))
    for i, motion in enumerate(motions):
        single.reset(seed=i, options={} if motion is None else {"motion": motion})
        for _ in range(5 if i == 2 else 8):
            alone = single.step(np.full(1, 0.3, np.float32))
        if i < 2:
            assert_same(alone[0], outcome[0][i])
            assert alone[-1]["hub_torque"] == outcome[4]["hub_torque"][i]
        else:
            assert alone[3], "the ramp ends after five periods"
    observation, infos = native.reset(seed=0, options={"motion": "robot_arm_motion"})
    assert np.all(infos["target"] == 1.5)
    assert np.all(observation[:, 1] == 1.0)


def test_a_table_with_as_many_rows_as_arms_is_one_table() -> None:
    rows = [[0.0, 0.2], [0.1, 0.3], [0.4, 0.1]]
    env = gym.make_vec("FlexibleArm-v0", num_envs=3)
    _, infos = env.reset(seed=0, options={"motion": rows})
    assert np.all(infos["target"] == 0.1)


def test_motion_episodes_in_a_vector_reset_themselves() -> None:
    """After the motion an ordinary episode begins; its neighbours never knew."""
    one, other = (gym.make_vec("FlexibleArm-v0", num_envs=3, max_episode_steps=20) for _ in range(2))
    one.reset(seed=0)
    other.reset(seed=0, options={"motion": [None, time_functions.ramp(0.2, 0.1), None]})
    for k in range(30):
        a, b = one.step(np.ones((3, 1), np.float32)), other.step(np.ones((3, 1), np.float32))
        assert_same(a[0][[0, 2]], b[0][[0, 2]])
        assert bool(b[3][1]) is (k in (4, 25))


def test_replay_task() -> None:
    env = gym.make("FlexibleArm-v0", task="replay", motion=time_functions.cycloid(0.8, 0.4))
    for _ in range(2):
        _, info = env.reset(seed=0)
        assert info["target"] == pytest.approx(0.8)
        steps = 1
        while not env.step(rest(env))[3]:
            steps += 1
        assert steps == 20


def test_a_motion_to_replay_may_be_an_array_and_is_named_as_given() -> None:
    env = gym.make("FlexibleArm-v0", task="replay", motion=np.array([[0.0, 0.0], [0.1, 0.05], [0.2, 0.1]]))
    assert env.reset(seed=0)[1]["target"] == pytest.approx(0.1)


def test_an_action_that_is_not_finite_ends_a_motion_episode_too() -> None:
    env = gym.make("TwoLinkFlexArm-v0")
    env.reset(seed=0, options={"motion": "two_link_motion"})
    assert not env.step(np.array([math.nan, 0.0], np.float32))[2], "the hub's action is ignored"
    assert env.step(np.array([0.0, math.nan], np.float32))[-1]["termination_reason"] == "action_not_finite"


def test_a_copied_arm_goes_on_with_the_step_that_it_had() -> None:
    env, other = (gym.make("FlexibleArm-v0", step_tolerance=1e-4, max_episode_steps=20).unwrapped for _ in range(2))
    env.reset(seed=0, options={"motion": BROKEN})
    runs = []
    for _ in range(5):
        env.step(rest(env))
    other.set_state(env.get_state())
    for one in (env, other):
        runs.append([[*one.step(rest(one))[:4], one.guide.simulation.levels] for _ in range(10)])
    assert repr(runs[0]) == repr(runs[1])
    # two stretches in the period with a kink
    assert len(env.guide.simulation.levels) == 15 + 1
