"""MultiLinkFlexArm-v0 where it is not as the others are: spaces, goals, controllers, how exact it is."""

import math
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from numpy.typing import NDArray

from flexarm_env import arms, control
from flexarm_env.batch import GOAL
from flexarm_env.geometry.inverse import goal_of
from flexarm_env.tasks import angles as inverse
from tests.env_tools import MULTI as ID
from tests.env_tools import assert_same, successes

THREE = arms.named("three_strips")


# ------------------------------------------------------------------ spaces
def test_spaces_and_names_follow_the_links() -> None:
    env = gym.make(ID).unwrapped
    plan = env.plan
    assert env.action_space.shape == (3,) and env.observation_space.shape == (5 * 3 + 4,)
    assert plan.names[:6] == ("hub_sin", "hub_cos", "elbow_1_sin", "elbow_1_cos", "elbow_2_sin", "elbow_2_cos")
    assert plan.names[6:9] == ("hub_rate", "elbow_1_rate", "elbow_2_rate")
    assert plan.names[-2:] == ("to_target_x", "to_target_y")
    assert plan.scales[6:9] == pytest.approx((1.506, 1.735, 2.410), abs=5e-4), "the docstring says so"
    info = env.reset(seed=0)[1]
    assert info["joint_torque"].shape == info["tip_deflection"].shape == (3,)
    assert env.plan.limit == 500, "10 s"


# ------------------------------------------------------------------ one physics, one task
@pytest.mark.parametrize("mode", ["torque", pytest.param("residual_pd", marks=pytest.mark.slow)])
def test_with_two_links_it_is_the_two_link_arm(mode: str) -> None:
    keywords = {"action_mode": mode, "duration": 1.0}
    two, chain = gym.make("TwoLinkFlexArm-v0", **keywords), gym.make(ID, arm="de_luca_siciliano", **keywords)
    assert_same(two.reset(seed=3)[0], chain.reset(seed=3)[0])
    rng = np.random.default_rng(0)
    for _ in range(50):
        action = rng.uniform(-1, 1, 2).astype(np.float32)
        assert_same(two.step(action), chain.step(action))


# ------------------------------------------------------------------ goal angles
def tip_and_slopes(lengths: NDArray[np.float64], angles: NDArray[np.float64]) -> tuple[Any, Any]:
    """Tip (2,) of the chain of straight links, and its derivatives (2, N) by the joint angles."""
    alpha = np.cumsum(angles)
    x, y = lengths * np.cos(alpha), lengths * np.sin(alpha)
    return np.array([x.sum(), y.sum()]), np.array([-np.cumsum(y[::-1])[::-1], np.cumsum(x[::-1])[::-1]])


def drawn(count: int, n: int, seed: int = 0) -> Any:
    rng = np.random.default_rng(seed)
    for _ in range(count):
        lengths = rng.uniform(0.2, 0.6, n)
        far, bearing = lengths.sum() * rng.uniform(0.3, 0.95), rng.uniform(-2.0, 2.0)
        if far > 1.02 * (2.0 * lengths.max() - lengths.sum()):
            yield lengths, far * math.cos(bearing), far * math.sin(bearing)


def no_limits(n: int) -> NDArray[np.float64]:
    return np.array([-np.inf, np.inf] * n)


def test_of_two_links_it_is_the_lesser_of_both_solutions() -> None:
    for lengths, x, y in drawn(40, 2):
        a, b = lengths
        bend = math.acos((x * x + y * y - a * a - b * b) / (2.0 * a * b))
        both = []
        for elbow in (bend, -bend):
            hub = math.atan2(y, x) - math.atan2(b * math.sin(elbow), a + b * math.cos(elbow))
            both.append([(hub + math.pi) % (2.0 * math.pi) - math.pi, elbow])
        goal = np.zeros(2)
        inverse.least_angles(lengths, no_limits(2), x, y, goal)
        assert goal == pytest.approx(min(both, key=lambda angles: np.dot(angles, angles)), abs=1e-9)


@pytest.mark.parametrize("n", [3, 4, 6])
def test_goals_are_stationary_and_reach_the_target(n: int) -> None:
    """Lagrange: the angles are a combination of the slopes of the tip's coordinates."""
    for lengths, x, y in drawn(40, n):
        goal = np.zeros(n)
        inverse.least_angles(lengths, no_limits(n), x, y, goal)
        tip, slopes = tip_and_slopes(lengths, goal)
        assert tip == pytest.approx([x, y], abs=1e-9)
        force = np.linalg.lstsq(slopes.T, goal, rcond=None)[0]
        assert slopes.T @ force == pytest.approx(goal, abs=1e-8)


@pytest.mark.parametrize("n", [3, 4])
def test_no_search_finds_lesser_goals(n: int) -> None:
    from scipy.optimize import minimize

    rng = np.random.default_rng(5)
    for lengths, x, y in drawn(8, n, seed=2):
        goal = np.zeros(n)
        inverse.least_angles(lengths, no_limits(n), x, y, goal)
        off = {"type": "eq", "fun": lambda q, at=(lengths, x, y): tip_and_slopes(at[0], q)[0] - at[1:]}
        for _ in range(6):
            found = minimize(lambda q: q @ q, rng.uniform(-1.5, 1.5, n), constraints=off, method="SLSQP")
            if found.success and np.abs(off["fun"](found.x)).max() < 1e-7:
                assert goal @ goal <= found.fun + 1e-5


def test_goals_keep_the_joints_limits() -> None:
    lengths, limits = np.array([0.4, 0.35, 0.25]), np.array([-np.inf, np.inf, -0.4, 0.4, -2.8, 2.8])
    goal = np.zeros(3)
    inverse.least_angles(lengths, limits, 0.5, 0.4, goal)
    assert tip_and_slopes(lengths, goal)[0] == pytest.approx([0.5, 0.4], abs=1e-9)
    assert abs(goal[1]) == pytest.approx(0.4, abs=1e-12), "the limit binds"


def test_out_of_reach_the_arm_is_stretched_towards_the_target() -> None:
    lengths = np.array([0.4, 0.35, 0.25])
    for far in (1.0, 1.2):
        goal = np.zeros(3)
        inverse.least_angles(lengths, no_limits(3), far * math.cos(0.7), far * math.sin(0.7), goal)
        assert goal == pytest.approx([0.7, 0.0, 0.0], abs=1e-6)


def test_the_hub_turns_no_more_than_it_must() -> None:
    lengths = np.array([0.4, 0.35, 0.25])
    goal = np.array([20.0, 0.0, 0.0])
    inverse.least_angles(lengths, no_limits(3), 0.5, 0.4, goal)
    assert abs(goal[0] - 20.0) <= math.pi
    assert tip_and_slopes(lengths, goal)[0] == pytest.approx([0.5, 0.4], abs=1e-9)


def test_goals_of_a_moving_target_do_not_leap() -> None:
    """Through bearing 0, where the arcs to either side are alike, they go on as they were."""
    lengths = np.array([0.4, 0.35, 0.25])
    goal = np.zeros(3)
    inverse.least_angles(lengths, no_limits(3), 0.6, 0.3, goal)
    for y in np.linspace(0.3, -0.3, 121):
        before = goal.copy()
        inverse.next_angles(lengths, no_limits(3), 0.6, y, goal)
        assert tip_and_slopes(lengths, goal)[0] == pytest.approx([0.6, y], abs=1e-9)
        assert np.abs(goal - before).max() < 0.05


@pytest.mark.slow
def test_environment_and_controllers_have_the_same_goals() -> None:
    env = gym.make(ID, action_mode="residual_pd").unwrapped
    lengths = np.array([link.length for link in THREE.links])
    limits = np.array([-np.inf, np.inf, -2.8, 2.8, -2.8, 2.8])
    for seed in range(5):
        info = env.reset(seed=seed)[1]
        record = env.batch.record(0)
        assert tip_and_slopes(lengths, record[GOAL : GOAL + 3])[0] == pytest.approx(info["target"], abs=1e-9)
        mine = goal_of(lengths, np.ones(3), limits, *info["target"], np.zeros(3))
        assert record[GOAL : GOAL + 3] == pytest.approx(mine, abs=1e-9)


# ------------------------------------------------------------------ controllers
@pytest.mark.slow
@pytest.mark.parametrize("name", ["pd", "zv", "zvd", "lqr"])
def test_controllers_reach_their_targets(name: str) -> None:
    envs = gym.make_vec(ID, num_envs=20, vectorization_mode="vector_entry_point")
    assert successes(envs, control.make(name, envs), 100) > 0.9


def test_time_optimal_plans_are_for_one_link() -> None:
    with pytest.raises(ValueError, match="controller = 'time_optimal': must be one of"):
        control.make("time_optimal", gym.make(ID))


# ------------------------------------------------------------------ features
def test_a_prescribed_motion_is_followed() -> None:
    env = gym.make(ID, task="replay").unwrapped
    _, info = env.reset(seed=0)
    over = False
    while not over:
        _, _, terminated, over, info = env.step(np.zeros(3, np.float32))
        assert not terminated
    poses = env.batch.poses(0)
    assert poses[0, 2] == pytest.approx(env.guide.scene.motion_of("joint0")(env.guide.scene.duration), abs=1e-9)
    again = gym.make(ID, duration=0.5).unwrapped
    _, info = again.reset(seed=0, options={"motion": {"joint2": [[0.0, 0.1], [0.2, 0.3], [0.4, 0.2]]}})
    assert info["joint_torque"].shape == (3,)


# ------------------------------------------------------------------ how exact it is
@pytest.mark.slow
def test_default_settings_hold_half_a_percent() -> None:
    """Against the converged exact beam, 2 s under random torques and under bang-bang torques."""
    exact = {"formulation": "geometrically_exact", "elements": 4, "order": 3, "dt": 1e-3, "tolerance": 1e-9}
    envs = [gym.make_vec(ID, num_envs=8, vectorization_mode="vector_entry_point", **k) for k in ({}, exact)]
    rng = np.random.default_rng(3)
    for env in envs:
        env.reset(seed=50)
    most = 0.0
    for k in range(100):
        if k % 10 == 0:
            bang = rng.choice([-1.0, 1.0], (4, 3))
        actions = np.concatenate([bang, rng.uniform(-1, 1, (4, 3))]).astype(np.float32)
        infos = [env.step(actions)[4] for env in envs]
        off = np.linalg.norm(infos[0]["tip_position"] - infos[1]["tip_position"], axis=1)
        most = max(most, float(off.max()))
    assert most < 0.005
