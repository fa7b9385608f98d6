"""LQG: what its filter finds of the arm, and what it reaches on what sensors read."""

import dataclasses
import re
from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest

from flexarm_env import Joint, arms, control
from flexarm_env.control import lqg
from flexarm_env.control.arm_model import NODES
from flexarm_env.control.catalogue import tuned_gains
from flexarm_env.linear import set_state, state_of
from flexarm_env.scene import Scene
from flexarm_env.simulation import Simulation
from tests.env_tools import ONE, TWO, successes
from tests.refusals import refuses
from tests.scene_tools import everything


def make(env_id, n=20, **keywords):
    return gym.make_vec(env_id, num_envs=n, observation="measured", **keywords)


def told(env_id=ONE, **keywords):
    env = gym.make(env_id, **{"observation": "measured", **keywords})
    return control.Setup.of(env)


@pytest.mark.slow
@pytest.mark.parametrize("geared", [False, True])
def test_the_estimate_becomes_the_state(geared):
    """A shaken arm whose torques the filter knows: its whole state from the motor's angle and a gauge with a bias."""
    arm = arms.named("strip")
    if geared:
        arm = dataclasses.replace(arm, joints=(Joint(stiffness=30.0, damping=0.1, motor_inertia=0.027),))
    gauges = [{"link": 0, "place": 0.0, "bias": 0.0057}]
    setup = told(arm=arm, sensors={"encoders": {"side": "motor"}, "strain_gauges": gauges})
    gains = tuned_gains("lqg", "slew")
    d = lqg.design(setup, gains)
    scene = everything(Scene("own", arm, duration=20.0, dt=1e-3))
    simulation = Simulation(scene, scene.settings("elastica", nodes=NODES))
    own = np.zeros(len(d.states))
    own[1:NODES] = 0.02 * np.linspace(0.1, 1.0, NODES - 1)  # bent to begin with
    set_state(simulation, own)
    rows, bias, goal = d.C[:, : len(d.states)], 0.004, 0.3
    controller = control.LQG(setup, gains)
    off = []
    for k in range(400):
        x = state_of(simulation)
        angle, gauge = rows @ x
        signals = SimpleNamespace(gauges=np.array([[gauge + bias]]))
        to_go = np.array([[goal - angle]])
        if k == 0:
            controller.goal, controller.step = np.array([[goal]]), 0
            controller.initialise(signals, to_go)
        torque = np.clip(controller.torques(signals, to_go), -2.0, 2.0)
        about = x - goal * d.rigid[: len(x), 0]
        half = len(x) // 2
        off.append([np.abs(part).max() for part in np.split(controller.z[0, : len(x)] - about, [half])])
        wrong = controller.z[0, -1] - bias
        controller.predict(torque)
        controller.step += 1
        simulation.set_torques(torque[0])
        assert simulation.advance_to((k + 1) * setup.control_dt)
    assert off[0][0] > 0.015  # rad: it knew nothing of the bending
    assert np.max(off[-20:], axis=0) == pytest.approx([0.0, 0.0], abs=2e-4)  # rad, rad/s
    assert wrong == pytest.approx(0.0, abs=2e-4)
    assert angle == pytest.approx(goal, abs=2e-3)


@pytest.mark.parametrize(("env_id", "posture"), [(ONE, ()), pytest.param(TWO, (0.9,), marks=pytest.mark.slow)])
def test_regulator_and_filter_are_stable(env_id, posture):
    setup = told(env_id)
    d = lqg.design(setup, tuned_gains("lqg", setup.task), posture)
    n, held = len(d.states), setup.n_joints + len(d.states)
    K = d.K[:, :n]
    assert np.abs(np.linalg.eigvals(d.A[:n, :n] - d.B[:n] @ K)).max() < 1.0
    fading = np.linalg.eigvals(d.A - d.A @ d.L[-1] @ d.C)  # all but biases, which are given none to walk
    assert np.sort(np.abs(fading))[held - 1] < 0.9999
    assert d.C[: setup.n_joints] @ d.rigid == pytest.approx(np.eye(setup.n_joints), abs=1e-9)
    assert d.C[setup.n_joints :] @ d.rigid == pytest.approx(0.0, abs=1e-7)  # a stiff turn bends nothing


@pytest.mark.parametrize(
    "keywords",
    [
        pytest.param({}, id="ideal"),
        pytest.param({"arm": "strip_geared"}, id="geared", marks=pytest.mark.slow),
        pytest.param({"sensors": {"noise": 5e-4}}, id="noisy", marks=pytest.mark.slow),
    ],
)
def test_one_link_slews_and_settles(keywords):
    env = make(ONE, **keywords)
    assert successes(env, control.make("lqg", env), 50) >= 0.98


@pytest.mark.slow
@pytest.mark.parametrize("arm", [None, "two_link_geared"])
def test_two_links_reach_and_settle(arm):
    env = make(TWO, arm=arm)
    assert successes(env, control.make("lqg", env), 50) >= 0.9


def test_one_arm_or_many_and_a_second_episode_are_the_same():
    """With the last of three observations; nothing is left of an episode before."""
    env = make(ONE, 4, history=3)
    many, one, again = (control.make("lqg", env) for _ in range(3))
    first = successes(env, again, 7)
    assert successes(env, again, 7) == first >= 0.75
    observation, _ = env.reset(seed=9)
    for controller, seen in ((many, observation), (one, observation[2]), (again, observation)):
        controller.reset(seen)
    for _ in range(5):
        actions, action = many.act(observation), one.act(observation[2])
        assert action.shape == (1,)
        assert actions[2] == pytest.approx(action, abs=1e-6)
        assert np.array_equal(actions, again.act(observation))
        observation = env.step(actions)[0]


def test_weights_are_the_sensors_own():
    """A noisier gauge is believed less, and so are all that an environment makes noisy."""
    gains = tuned_gains("lqg", "slew")
    settled = lambda **keywords: np.abs(lqg.design(told(**keywords), gains).L[-1][:2]).sum(axis=0)  # noqa: E731
    fine, coarse = (settled(sensors={"strain_gauges": [{"noise": noise}]}) for noise in (0.0, 0.1))
    assert coarse[1] < 0.2 * fine[1]
    assert settled(sensors={"noise": 0.01})[0] < settled()[0]
    assert told(sensors={"noise": 0.01}).noise == pytest.approx(0.01 * np.array(told().scales))


@pytest.mark.slow
def test_what_is_missing_is_said():
    says = 'LQG needs the entry hub_error (observation="measured" has it), which is not among hub_sin'
    refuses(re.escape(says), lambda: control.make("lqg", gym.make(ONE)))
    own = told(observation=("hub_sin", "hub_cos", "hub_rate", "hub_error"))
    assert lqg.design(own, tuned_gains("lqg", "slew")).C.shape[0] == 1  # without a gauge: the angle alone
