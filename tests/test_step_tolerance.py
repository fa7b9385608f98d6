"""Steps fitted to a tolerance: in environments bit for bit the same in any number, in scenes with an honest error."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from benchmarks.fitted_steps import run
from benchmarks.work_precision import scene_named
from flexarm_env.batch import Batch, standing_scene
from flexarm_env.runtime.fitted import FITS
from flexarm_env.simulation import Simulation, simulate
from flexarm_env.tasks.program import LEVEL
from tests.env_tools import assert_goes_back, assert_pair_same, assert_same, pair
from tests.scene_tools import tips_apart

UNLIKE = {"payload": (0.1, 8.0), "EI": (0.4, 2.5)}
FITTED: dict[str, Any] = {"dt": 0.02, "step_tolerance": 2e-5, "randomization": UNLIKE, "duration": 0.4}


def levels(batch: Batch) -> np.ndarray[Any, Any]:
    """Halvings that each arm's last period took."""
    return np.array([batch.record(i)[LEVEL] for i in range(batch.n)])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("env_id", "n", "threads", "kwargs"),
    [
        ("FlexibleArm-v0", 7, 1, {}),
        ("FlexibleArm-v0", 20, 2, {}),
        ("TwoLinkFlexArm-v0", 9, 2, {"step_tolerance": 1e-6, "tolerance": 1e-6}),
        ("FlexibleArm-v0", 9, 1, {"formulation": "geometrically_exact"}),
        ("FlexibleArm-v0", 9, 1, {"actuator": {"lag": 0.01, "viscous": 0.01}}),
        ("FlexibleArm-v0", 4, 2, {"formulation": "floating_frame"}),
    ],
)
def test_any_number_of_arms_gives_the_same_bits(env_id: str, n: int, threads: int, kwargs: dict[str, Any]) -> None:
    """Arms that ask for different steps side by side in one lane group."""
    both = pair(env_id, n, "NextStep", threads, **{**FITTED, **kwargs})
    assert assert_pair_same(both, 30) >= n
    native = both[1].unwrapped
    found = set()
    for _ in range(15):
        native.step(native.action_space.sample())
        found |= set(levels(native.batch).tolist())
    assert len(found) > 1 and found <= set(range(FITS))


@pytest.mark.slow
def test_delayed_observations_and_fitted_steps_go_together() -> None:
    """What comes late leaves the motion as it is."""
    plain = gym.make("FlexibleArm-v0", **FITTED).unwrapped
    late = gym.make("FlexibleArm-v0", **FITTED, sensors={"delay": 0.04}).unwrapped
    far = {"start": 0.0, "target": 1.5}  # the last entry of the observation is larger than 1
    plain.reset(seed=5, options=far), late.reset(seed=5, options=far)
    rng = np.random.default_rng(0)
    seen = []
    for k in range(15):
        action = rng.choice([-1.0, 1.0], 1).astype(np.float32)
        observation, _, _, _, here = plain.step(action)
        delayed, _, _, _, there = late.step(action)
        assert here["tip_position"].tolist() == there["tip_position"].tolist(), k
        seen.append(observation)
        if k >= 2:
            assert_same(delayed, seen[k - 2])


EXACT = {"formulation": "geometrically_exact", "dt": 0.01, "randomization": UNLIKE, "duration": 0.4}


@pytest.mark.slow
@pytest.mark.parametrize(
    "kwargs", [FITTED | {"max_iterations": 2}, EXACT | {"max_iterations": 3}], ids=["fitted", "exact"]
)
def test_a_failed_lane_is_repeated_alone(kwargs: dict[str, Any]) -> None:
    """Newton is allowed few iterations, so that lanes fail all the time: single environments halve instead."""
    both = pair("FlexibleArm-v0", 5, "NextStep", tolerance=1e-10, **kwargs)
    assert assert_pair_same(both, 30) >= 5
    batch = both[1].unwrapped.batch
    assert batch.repeats and batch.alone().counts[0, 3] > 0.0


def test_states_are_kept_with_the_step_they_call_for() -> None:
    env = gym.make("FlexibleArm-v0", **FITTED)
    env.reset(seed=1)
    rng = np.random.default_rng(0)
    for _ in range(7):
        env.step(rng.uniform(-1.0, 1.0, 1).astype(np.float32))
    assert_goes_back(env, other=gym.make("FlexibleArm-v0", **FITTED))


def test_a_period_adds_no_more_than_is_tolerated() -> None:
    """Three times the torque limit: steps of 20/3 ms add a fifth of a per cent of the length, fitted ones less."""
    wild, calm = "bang-bang, 3 times the limit", "calm"
    fitted = {"dt": 0.02, "step_tolerance": 1e-4}
    assert run(wild, "elastica", {"dt": 0.02 / 3.0, "tolerance": 1e-5}, 150, 1)["largest"] > 1e-3
    found = run(wild, "elastica", fitted, 150, 1)
    assert found["largest"] < 1e-4
    assert found["steps"] > 10.0
    quiet = run(calm, "elastica", fitted, 60, 1)
    assert quiet["largest"] < 1e-4
    assert quiet["steps"] == 3.0  # one step, and two to compare it with


def test_a_scene_fits_its_steps_and_says_how_far_it_is_off() -> None:
    scene = scene_named("FlexibleArm-v0")
    fine = simulate(scene, "elastica", nodes=4, dt=2.5e-4, sample=0.02, estimate_error=False)
    steps, errors = [], []
    for tolerance in (1e-3, 1e-4, 1e-5):
        run_ = simulate(scene, "elastica", nodes=4, dt=0.02, sample=0.02, step_tolerance=tolerance)
        errors.append(tips_apart(run_, fine))
        steps.append(run_.steps)
        assert run_.status == "ok"
        assert errors[-1] < 20.0 * tolerance  # over 200 stretches
        assert 0.3 * errors[-1] < run_.error_parts["time_step"] < 20.0 * errors[-1]
        assert len(run_.step_levels) == 200 and min(run_.step_levels) >= 1
    assert steps[0] < steps[1] < steps[2] and errors[0] > errors[1] > errors[2]


def test_a_scene_fits_as_an_environment_does() -> None:
    """A constant torque, by periods of 20 ms in one and by stretches as long in the other: the same halvings, all steps
    counted, those to compare with among them, and the same arm to the last digits."""
    env = gym.make("FlexibleArm-v0", step_tolerance=1e-4, dt=0.02, joint_limits=None)
    env.reset(seed=0, options={"start": 0.0, "target": 0.5})
    batch: Batch = env.unwrapped.batch
    scene = Simulation(standing_scene(batch.arm, 0.02, None), batch.settings)
    steps, of_env, of_scene = 0, [], []
    for k in range(40):
        env.step(np.ones(1, np.float32))
        of_env.append(int(batch.record(0)[LEVEL]))
        scene.set_torques(batch.motion(0)[2])
        first = max(1, scene._level) - 1
        assert scene.advance_to(0.02 * (k + 1))
        of_scene.append(scene._level)
        steps += sum(2**j for j in range(first, scene.levels[-1] + 1))
    assert scene.work.counts[3] == steps == batch.counts[0, 3]
    assert of_env == of_scene and len(set(of_env)) > 1
    assert np.abs(scene.work.q[:4] - batch.motion(0)[0]).max() < 1e-9


def test_a_prescribed_motion_is_the_scene_bit_for_bit() -> None:
    """Through the environment and through `simulate`: the same steps."""
    env = gym.make("FlexibleArm-v0", dt=0.02, step_tolerance=1e-4, tolerance=1e-10)
    env.reset(seed=0, options={"motion": "robot_arm_motion"})
    found = [env.step(np.zeros(1, np.float32))[4]["tip_position"] for _ in range(200)]
    guide = env.unwrapped.guide
    run_ = simulate(
        guide.simulation.scene, "elastica", nodes=4, dt=0.02, sample=0.02, duration=4.0, step_tolerance=1e-4,
        estimate_error=False,
    )  # fmt: skip
    assert np.array_equal(run_.tip[1:, :2], np.array(found))


def test_a_tolerance_that_is_not_kept_is_told() -> None:
    """With five halvings of so long a step: what is left is above the tolerance, and said to be; where it is kept,
    what is told is at most the tolerance. Twice the step leaves more than twice the error."""
    scene, left = scene_named("FlexibleArm-v0"), []
    for dt in (0.02, 0.01):
        run_ = simulate(scene, "elastica", nodes=4, dt=dt, sample=0.02, step_tolerance=1e-9, estimate_error=False)
        assert run_.status == "inaccurate"
        assert "step_tolerance = 1e-09 is not kept" in run_.message and f"{run_.step_error:.2g}" in run_.message
        left.append(run_.step_error)
    assert left[0] > 2.0 * left[1] > 2e-9
    kept = simulate(scene, "elastica", nodes=4, dt=0.02, sample=0.02, step_tolerance=1e-4, estimate_error=False)
    assert kept.status == "ok" and 0.0 < kept.step_error <= 1e-4


@pytest.mark.parametrize("motion", [None, "robot_arm_motion"])
def test_an_environment_tells_what_a_period_is_left_with(motion: str | None) -> None:
    for tolerance, kept in ((1e-4, True), (1e-9, False)):
        env = gym.make("FlexibleArm-v0", dt=0.02, step_tolerance=tolerance, tolerance=1e-10)
        _, info = env.reset(seed=0, options={} if motion is None else {"motion": motion})
        assert info["step_error"] == 0.0
        told = [env.step(np.ones(1, np.float32))[4]["step_error"] for _ in range(20)]
        assert (max(told) <= tolerance) == kept and max(told) > 0.0
    assert "step_error" not in gym.make("FlexibleArm-v0").reset()[1]


def test_a_tolerance_below_what_steps_are_solved_to_is_refused() -> None:
    with pytest.raises(ValueError, match=r"step_tolerance = 1e-300: must be at least tolerance = 1e-"):
        gym.make("FlexibleArm-v0", step_tolerance=1e-300)
    with pytest.raises(ValueError, match=r"step_tolerance = 1e-11: must be at least tolerance = 1e-10"):
        simulate(scene_named("FlexibleArm-v0"), "elastica", step_tolerance=1e-11)


@pytest.mark.parametrize("value", [0.0, -1e-3, 2.0, float("nan")])
def test_a_wrong_tolerance_is_named(value: float) -> None:
    with pytest.raises(ValueError, match="step_tolerance = "):
        gym.make("FlexibleArm-v0", step_tolerance=value)
