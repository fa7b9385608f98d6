"""The single environments: Gymnasium's rules, the specification in the docstrings."""

import math
import re
import warnings
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import flexarm_env
from flexarm_env import arms
from flexarm_env.envs.task import REACH, REWARDS, SLEW
from flexarm_env.rigid import inertia_beyond
from tests.env_tools import ENERGIES, IDS, MULTI, RANDOM, STANDARD, assert_same, episode, rich, turned
from tests.processes import ROOT


@pytest.fixture(scope="module", params=(*IDS, MULTI))
def env(request: pytest.FixtureRequest) -> Any:
    made = gym.make(request.param)
    yield made
    made.close()


# ---------------------------------------------------------------------------------------- Gymnasium's rules
FORMULATIONS: dict[str, dict[str, Any]] = {
    "elastica": {},
    "exact": {"formulation": "geometrically_exact"},
    "segments": {"formulation": "floating_frame"},
    "modes": {"formulation": "floating_frame", "modes": 2},
}


@pytest.mark.parametrize(
    ("env_id", "formulation"),
    [
        *((env_id, "elastica") for env_id in (*IDS, MULTI)),
        (IDS[0], "exact"),
        *(pytest.param(IDS[0], name, marks=pytest.mark.slow) for name in ("segments", "modes")),
        *(pytest.param(IDS[1], name, marks=pytest.mark.slow) for name in ("exact", "segments", "modes")),
    ],
)
def test_both_checkers_without_a_warning(env_id: str, formulation: str) -> None:
    from gymnasium.utils.env_checker import check_env

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(gym.make(env_id, render_mode="rgb_array", **FORMULATIONS[formulation]).unwrapped)
        checker = pytest.importorskip("stable_baselines3.common.env_checker")
        checker.check_env(gym.make(env_id, render_mode="rgb_array", **FORMULATIONS[formulation]).unwrapped)


@pytest.mark.parametrize("env_id", [IDS[0], pytest.param(IDS[1], marks=pytest.mark.slow)])
def test_checkers_without_a_warning_with_everything(env_id: str) -> None:
    from gymnasium.utils.env_checker import check_env

    noisy = {"sensors": {"noise": 0.01, "delay": 0.04}, "actuator": {"lag": 0.01}, "initial_vibration": 0.02}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(gym.make(env_id, **rich(env_id, randomization=RANDOM, **noisy)).unwrapped, skip_render_check=True)


def test_registered_with_strings_and_without_a_time_limit() -> None:
    for env_id in (*IDS, MULTI):
        spec = gym.spec(env_id)
        assert isinstance(spec.entry_point, str)
        assert isinstance(spec.vector_entry_point, str)
        assert spec.max_episode_steps is None
        made = gym.make(f"flexarm_env:{env_id}")
        assert made.spec is not None and made.spec.id == env_id


def test_same_seed_same_bits_other_seed_other_bits(env: Any) -> None:
    first, second, other = episode(env, 5, 20), episode(env, 5, 20), episode(env, 6, 20)
    assert_same(first, second)
    assert not np.array_equal(first[0][0], other[0][0])


def test_fresh_objects_every_step(env: Any) -> None:
    outcomes = episode(env, 1, 3)
    assert len({id(o[0]) for o in outcomes}) == len({id(o[-1]) for o in outcomes}) == len(outcomes)
    arrays = [o[-1]["tip_position"] for o in outcomes]
    before = [a.copy() for a in arrays]
    env.step(env.action_space.sample())
    assert all(np.array_equal(a, b) for a, b in zip(arrays, before, strict=True))


@pytest.mark.parametrize("env_id", IDS)
def test_info_has_the_same_keys_and_types_throughout(env_id: str) -> None:
    full = gym.make(env_id, **rich(env_id))
    outcomes = episode(full, 2, 10)
    wanted = STANDARD | ENERGIES | {f"reward_{name}" for name in REWARDS}
    kinds = {key: type(value) for key, value in outcomes[0][-1].items()}
    assert set(kinds) == wanted
    for outcome in outcomes:
        assert {key: type(value) for key, value in outcome[-1].items()} == kinds
        for value in outcome[-1].values():
            assert not isinstance(value, np.ndarray) or value.dtype == np.float64
    assert set(gym.make(env_id).reset(seed=0)[1]) == wanted - ENERGIES


# ---------------------------------------------------------------------------------------- the specification
def expected_observation(env: Any) -> np.ndarray:
    """The docstring's table, computed from link poses."""
    plain = env.unwrapped
    view, plan = plain.batch.view(0), plain.plan
    poses, target = view.poses, view.target
    bends, rates = [], []
    for k, link in enumerate(plan.arm.links):
        p = poses[k]
        chord, speed = p[6:8] - p[0:2], p[9:11] - p[3:5]
        along, normal = turned(p[2], chord)
        bends.append(normal / link.length)
        rates.append((turned(p[2], speed)[1] - p[5] * along) / link.length)
    tip, velocity = poses[-1, 6:8], poses[-1, 9:11]
    if plan.arm.n_links == 1:
        hub, rate = poses[0, 2], poses[0, 5]
        angle = math.atan2(tip[1], tip[0])
        error = target[0] - angle
        error -= 2 * math.pi * round((error - (target[0] - hub)) / (2 * math.pi))
        values = [math.sin(hub), math.cos(hub), rate, bends[0], rates[0], error]
    else:
        angles = poses[:, 2] - np.append(0.0, poses[:-1, 8])
        spins = poses[:, 5] - np.append(0.0, poses[:-1, 11])
        sines = [f(a) for a in angles for f in (math.sin, math.cos)]
        way = turned(angles[0], target - tip)
        values = [*sines, *spins, *bends, *rates, *turned(angles[0], velocity), *way]
    return np.clip(np.array(values) / np.array(plan.scales), -10.0, 10.0)


def test_observation_is_that_of_the_docstring(env: Any) -> None:
    rng = np.random.default_rng(0)
    observation, _ = env.reset(seed=11)
    for _ in range(40):
        assert observation.dtype == np.float32
        assert env.observation_space.contains(observation)
        np.testing.assert_allclose(observation, expected_observation(env), rtol=2e-6, atol=2e-6)
        observation = env.step(rng.uniform(-1, 1, env.action_space.shape).astype(np.float32))[0]


def test_scales_are_those_of_the_docstring() -> None:
    w = math.sqrt(2.0 * math.pi / 2 / inertia_beyond(arms.named("strip"), 0))
    assert w == pytest.approx(3.029, abs=5e-4)
    one = gym.make("FlexibleArm-v0").unwrapped
    assert one.plan.scales == pytest.approx((1, 1, w, 0.1, 0.3 * w, 1))
    two = gym.make("TwoLinkFlexArm-v0").unwrapped
    assert two.plan.scales[4:6] == pytest.approx((1.595, 2.371), abs=5e-4)
    assert len(two.plan.scales) == len(two.plan.names) == 14


def test_docstring_and_options_page_name_everything_there_is() -> None:
    """Arguments, options of reset, entries of observation and info, reward terms, keys of nested tables."""
    from flexarm_env.envs import features, options, resets
    from flexarm_env.envs.flexible_arm import FlexibleArmEnv
    from flexarm_env.envs.two_link import TwoLinkFlexArmEnv

    one, two = str(FlexibleArmEnv.__doc__), str(TwoLinkFlexArmEnv.__doc__)
    options_page = (ROOT / "docs" / "environments" / "options.md").read_text("utf-8")
    table = set(re.findall(r"`(\w+)`", "".join(re.findall(r"^\| (`.*?) \|", options_page, re.MULTILINE))))
    assert not sorted({*options.ARGUMENTS} - table), "missing among the arguments of docs/environments/options.md"
    names = {*options.ARGUMENTS, *resets.KEYS, *options.FACTOR_NAMES, *features._SENSORS, *features._ACTUATOR}
    names |= {"autoreset_mode", "threads", "reset_mask", *STANDARD, *ENERGIES}
    names |= {*options.plan(SLEW, **rich(IDS[0])).names} - {"strain_gauge_2"}
    names -= {"interpolation", "EI_y", "GJ"}
    assert not [name for name in sorted(names) if f"`{name}" not in one + options_page], "missing in docstring and page"
    assert 'interpolation="linear"' in options_page
    assert all(f"| {term} |" in text for term in REWARDS for text in (one, two))
    names = {*options.plan(REACH, **rich(IDS[1])).names} - {"strain_gauge_2"}
    assert not [name for name in sorted(names) if f"`{name}`" not in two], "missing in TwoLinkFlexArm-v0's docstring"


def test_reward_is_the_sum_of_bounded_terms(env: Any) -> None:
    weights = dict(zip(REWARDS, env.unwrapped.plan.record.weights, strict=True))
    for observation, reward, terminated, _, info in episode(env, 4, 150)[1:]:
        terms = {name: info[f"reward_{name}"] for name in REWARDS}
        assert reward == pytest.approx(sum(terms.values()), abs=1e-12)
        for name in ("accuracy", "settle", "distance"):
            assert 0.0 <= terms[name] <= weights[name]
        for name in ("effort", "vibration", "failure"):
            joints = env.unwrapped.plan.arm.n_links if name == "effort" else 1
            assert -weights[name] * joints <= terms[name] <= 0.0
        if env.unwrapped.plan.arm.n_links == 1:
            error = float(observation[5])
            assert terms["accuracy"] == pytest.approx(0.5 * math.exp(-((error / 0.1) ** 2)), abs=1e-5)
            assert terms["distance"] == pytest.approx(0.5 - 0.5 * min(abs(error), 1.0), abs=1e-6)
        else:
            distance = float(np.linalg.norm(info["target"] - info["tip_position"]))
            assert terms["accuracy"] == pytest.approx(0.5 * math.exp(-((distance / 0.1) ** 2)), abs=1e-9)
            assert terms["distance"] == pytest.approx(0.5 - 0.5 * min(distance, 1.0), abs=1e-9)
        if terminated:
            break


def test_starts_and_targets_lie_where_they_should() -> None:
    one, two = gym.make("FlexibleArm-v0"), gym.make("TwoLinkFlexArm-v0")
    straight, farthest = 0, 0.0
    for seed in range(200):
        observation, info = one.reset(seed=seed)
        assert abs(observation[5]) <= math.pi / 2 + 1e-6
        assert np.all(observation[2:5] == 0.0) or np.abs(observation[2:5]).max() < 1e-12
        observation, info = two.reset(seed=seed)
        distance, bearing = np.hypot(*info["target"]), math.atan2(info["target"][1], info["target"][0])
        assert 0.3 <= distance <= 0.95
        assert abs(bearing) <= 2 * math.pi / 3
        hub, elbow = math.atan2(*observation[0:2]), math.atan2(*observation[2:4])
        assert max(abs(hub), abs(elbow)) <= 0.5 + 1e-6
        straight, farthest = straight + (hub == 0.0 and elbow == 0.0), max(farthest, abs(elbow))
    assert 70 <= straight <= 130 and farthest > 0.45


def test_success_needs_half_a_second_in_the_band() -> None:
    env = gym.make("FlexibleArm-v0")
    _, info = env.reset(seed=0, options={"start": 0.3, "target": 0.3})
    assert info["is_success"] is False
    flags = [env.step(np.zeros(1, np.float32))[-1]["is_success"] for _ in range(30)]
    assert flags.index(True) == 24  # 0.5 s after the first instant
    assert all(flags[24:])
    env.reset(seed=0, options={"start": 0.3, "target": 0.33})
    assert not any(env.step(np.zeros(1, np.float32))[-1]["is_success"] for _ in range(60))


def test_episodes_end_after_their_duration() -> None:
    cases = (
        ({}, 200), ({"duration": 0.5}, 25), ({"max_episode_steps": 7}, 7), ({"max_episode_steps": 300}, 200),
        ({"control_dt": 0.04}, 100),
    )  # fmt: skip
    for kwargs, length in cases:
        env = gym.make("FlexibleArm-v0", **kwargs)
        outcomes = episode(env, 0, 1000)
        assert len(outcomes) - 1 == length == env.spec.max_episode_steps
        assert outcomes[-1][3] is True
        assert outcomes[-1][2] is False


def test_joint_limits_end_an_episode() -> None:
    env = gym.make("TwoLinkFlexArm-v0")
    env.reset(seed=0, options={"start": [0.0, 1.8], "target": [0.5, 0.0]})
    for _ in range(400):
        _, reward, terminated, _, info = env.step(np.array([0.0, 1.0], np.float32))
        if terminated:
            break
    assert info["termination_reason"] == "joint_limit"
    assert info["solver_status"] == "ok"
    assert info["reward_failure"] == pytest.approx(-(400 * 0.02 + 50.0))
    assert reward < -6.0
    free = gym.make("TwoLinkFlexArm-v0", joint_limits=None)
    free.reset(seed=0, options={"start": [0.0, 1.8], "target": [0.5, 0.0]})
    assert not any(free.step(np.array([0.0, 1.0], np.float32))[2] for _ in range(200))


@pytest.mark.parametrize(
    ("env_id", "limits"),
    [
        ("FlexibleArm-v0", [(4.0, 5.0)]),
        ("TwoLinkFlexArm-v0", [(-0.1, 0.5), (1.0, 2.0)]),
        ("TwoLinkFlexArm-v0", [None, (2.0, 2.5)]),
        pytest.param("SpatialFlexArm-v0", [(2.0, 3.0)] * 3, marks=pytest.mark.slow),
    ],
)
def test_arms_start_within_their_joints_limits(env_id: str, limits: list[Any]) -> None:
    """Limits that leave out a part of the usual starts, or all of it, ended episodes in their first step."""
    env: Any = gym.make_vec(env_id, num_envs=64, joint_limits=limits)
    env.reset(seed=0)
    for k, own in enumerate(limits):
        low, high = env.unwrapped.plan.starts.start[k]
        assert own is None or own[0] <= low < high <= own[1]
    assert env.step(np.zeros(env.action_space.shape, np.float32))[2].sum() <= 3  # but for those close to a limit


def test_energy_books_balance() -> None:
    env = gym.make("FlexibleArm-v0", **rich("FlexibleArm-v0", gravity=(0.0, -9.81)))
    _, info = env.reset(seed=3)
    rng, gross = np.random.default_rng(3), 0.0
    start = info["energy_kinetic"] + info["energy_strain"] + info["energy_gravity"]
    for _ in range(200):
        before = info["work"]
        info = env.step(rng.uniform(-1, 1, 1).astype(np.float32))[-1]
        gross += abs(info["work"] - before)
        energy = info["energy_kinetic"] + info["energy_strain"] + info["energy_gravity"]
        assert abs(energy - start + info["energy_dissipated"] - info["work"]) < 0.02 * (gross + 1e-3)


def test_arms_and_formulations_by_name_and_value() -> None:
    env = gym.make("TwoLinkFlexArm-v0", arm="quanser_2dsfl")
    assert env.unwrapped.plan.arm.name == "quanser_2dsfl"
    own = arms.named("strip")
    assert gym.make("FlexibleArm-v0", arm=own).unwrapped.plan.arm == own
    assert flexarm_env.Arm is type(own)


def said(vectors: bool, key: str, keywords: dict[str, Any]) -> float:
    """An entry of info, the same alone and in a vector, at resets and at steps."""
    envs: list[Any] = [gym.make("FlexibleArm-v0", **keywords)]
    if vectors or not keywords:
        envs.append(gym.make_vec("FlexibleArm-v0", num_envs=3, **keywords))
    infos = [info for env in envs for info in (env.reset(seed=1)[1], env.step(env.action_space.sample())[4])]
    values = np.concatenate([np.ravel(info[key]) for info in infos])
    assert (values == values[0]).all()
    return float(values[0])


@pytest.mark.slow
@pytest.mark.parametrize("env_id", ["FlexibleArm-v0", "TwoLinkFlexArm-v0", "MultiLinkFlexArm-v0"])
def test_the_solver_of_the_paper_converges_to_the_exact_beam(env_id: str) -> None:
    """Bang-bang torques over 1 s. Without foreshortening a segment of length l is off by O(l^2): twice as many, 1/4."""
    fine = {"formulation": "geometrically_exact", "elements": 4, "order": 3, "dt": 5e-4, "tolerance": 1e-9}
    tips = []
    for options in (fine, {"formulation": "paper"}, {"formulation": "paper", "segments": 10}):
        env = gym.make(env_id, **options)
        env.reset(seed=0)
        signs = np.random.default_rng(2).choice([-1.0, 1.0], (10, *env.action_space.shape)).astype(np.float32)
        tips.append(np.array([env.step(signs[k // 5])[4]["tip_position"] for k in range(50)]))
    errors = [np.linalg.norm(one - tips[0], axis=1).max() / env.unwrapped.plan.arm.total_length for one in tips[1:]]
    assert errors[0] < 4e-3 and 3.5 < errors[0] / errors[1] < 4.5  # measured: 3.2e-3, 2.0e-3, 2.2e-4; 4.1, 4.0, 3.8


@pytest.mark.slow
@pytest.mark.parametrize("vectors", [False, True])
def test_a_reduction_to_modes_says_how_far_it_holds(vectors: bool) -> None:
    assert said(vectors, "deflection_bound", FORMULATIONS["modes"]) == 0.25
    assert said(vectors, "deflection_bound", {}) == np.inf


@pytest.mark.parametrize(
    ("name", "vectors"),
    [("exact", False), *(pytest.param(*c, marks=pytest.mark.slow) for c in (("exact", True), ("segments", True)))],
)
def test_an_environment_estimates_what_mesh_and_step_leave(name: str, vectors: bool) -> None:
    assert 0.0 < said(vectors, "error_estimate", FORMULATIONS[name]) < 0.02
    assert 0.0 < said(vectors, "error_estimate", {}) < 0.02


# ---------------------------------------------------------------------------------------- failures, parameters, films
def test_a_solver_that_fails_ends_the_episode_with_a_reason() -> None:
    env = gym.make("FlexibleArm-v0", max_iterations=1, tolerance=1e-14, max_halvings=0)
    observation, _ = env.reset(seed=0)
    after, reward, terminated, _, info = env.step(np.ones(1, np.float32))
    assert terminated
    assert info["termination_reason"] == info["solver_status"] == "newton_failed"
    assert_same(after, observation)
    assert math.isfinite(reward)
    env.reset(seed=0)


def test_randomization_is_always_from_the_nominal_arm() -> None:
    env = gym.make("FlexibleArm-v0", randomization=RANDOM).unwrapped
    seen = []
    for seed in range(50):
        env.reset(seed=seed)
        seen.append(env.batch.parameters(0))
    table = np.array(seen)
    nominal = env.batch.system.par
    assert np.all(table[:, 0] >= 0.5 * nominal[0]) and np.all(table[:, 0] <= 2.0 * nominal[0])
    assert np.all(table[:, 2] >= 0.7) and np.all(table[:, 2] <= 1.3)
    assert np.all(table[:, 3] >= 0.5 * nominal[3]) and np.all(table[:, 3] <= 2.0 * nominal[3])
    assert len(np.unique(table[:, 0])) == 50


@pytest.mark.parametrize("env_id", IDS)
def test_videos(env_id: str, tmp_path: Any) -> None:
    pytest.importorskip("moviepy")
    env = gym.make(env_id, render_mode="rgb_array")
    recorder = gym.wrappers.RecordVideo(env, str(tmp_path), episode_trigger=lambda k: True, disable_logger=True)
    recorder.reset(seed=0)
    for _ in range(5):
        recorder.step(env.action_space.sample())
    recorder.close()
    (film,) = tmp_path.glob("*.mp4")
    assert film.stat().st_size > 1000
