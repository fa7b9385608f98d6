"""The task "press" in space: path, reward and success from what happened, refusals; controllers and static forces."""

import math
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from flexarm_env import PointLoad, Scene, arms, control
from flexarm_env.control.space_statics import SpatialChain
from flexarm_env.envs.pictures import renderer
from flexarm_env.envs.space_rendering import _above
from flexarm_env.linear import linearize, static_equilibrium
from flexarm_env.physics.space.reading import tips
from flexarm_env.sensors import StrainGauge
from flexarm_env.shapes import HalfSpace, Sphere
from flexarm_env.time_functions import constant
from tests.control_tools import assert_restart_is_a_start
from tests.env_tools import assert_goes_back, assert_pair_same, pair
from tests.refusals import refusal

ID = "SpatialFlexArm-v0"
TILT = 0.3
NORMAL = np.array([math.sin(TILT), 0.0, math.cos(TILT)])
FLOOR: dict[str, Any] = {
    "obstacle": HalfSpace(tuple(-0.2 * NORMAL), tuple(NORMAL)).to_dict(), "stiffness": 2e4, "damping": 10.0,
    "friction": 0.3,
}  # fmt: skip
GAUGES = [{"link": k, "place": 0.2, "measures": what} for k in (1, 2) for what in ("xy", "xz", "torsion")]


def pressing(**keywords: Any) -> Any:
    return gym.make(ID, task="press", arm="three_dof_loaded", **keywords)


def test_the_path_is_on_the_wall_in_all_directions() -> None:
    env = pressing(reference={"force": (2.0, 3.0), "speed": (0.02, 0.03), "height": (0.1, 0.1), "time": (7.0, 7.0)})
    plan = env.unwrapped.plan
    at = [plan.names.index(name) for name in ("target_force", "tip_force_normal")]
    directions = []
    for seed in range(6):
        seen, info = env.reset(seed=seed)
        start = info["target"]
        assert start[0] == pytest.approx(0.805, abs=1e-12)
        assert 2.0 <= info["target_force"] <= 3.0
        assert seen[at[0]] * plan.scales[at[0]] == pytest.approx(info["target_force"], rel=1e-6)
        assert info["tip_position"][0] < 0.75
        for _ in range(5):
            *_, info = env.step(np.zeros(3, np.float32))
        velocity = (info["target"] - start) / 0.05
        assert 0.02 <= np.linalg.norm(velocity) <= 0.03
        # the path's middle is reached at 7 s
        assert start + 7.0 * velocity == pytest.approx([0.805, 0.0, 0.1], abs=1e-9)
        directions.append(math.atan2(velocity[2], velocity[1]))
    assert np.ptp(directions) > math.pi / 2


def test_reward_and_success_follow_from_force_and_path() -> None:
    """Computed again from infos of an arm that falls on an inclined floor."""
    env = pressing(contacts=FLOOR, success={"force": 400.0, "path": 2.0}, duration=0.9)
    env.reset(seed=1)
    weights = dict(zip(env.unwrapped.plan.kind.rewards, env.unwrapped.plan.record.weights.tolist(), strict=True))
    squares, farthest, touched = 0.0, 0.0, 0
    for k in range(1, 91):
        *_, info = env.step(np.zeros(3, np.float32))
        f = (info["contact_force"] - info["target_force"]) / info["target_force"]
        way = info["target"] - info["tip_position"]
        e = float(np.linalg.norm(np.cross(way, NORMAL)))
        touched += info["contact_force"] > 0.0
        assert info["reward_force"] == pytest.approx(weights["force"] * math.exp(-((f / 0.25) ** 2)), abs=1e-9)
        assert info["reward_accuracy"] == pytest.approx(weights["accuracy"] * math.exp(-((e / 0.01) ** 2)), abs=1e-9)
        own = weights["settle"] / (1.0 + ((e / 2.0) ** 2 + (f / 400.0) ** 2) ** 2)
        assert info["reward_settle"] == pytest.approx(own, rel=1e-9)
        near = weights["distance"] * (1.0 - min(float(np.linalg.norm(way)) / 1.15, 1.0))
        assert info["reward_distance"] == pytest.approx(near, rel=1e-9)
        if k > 30:
            squares, farthest = squares + f * f, max(farthest, e)
        assert info["is_success"] == (k > 30 and squares / (k - 30) < 400.0**2 and farthest < 2.0)
    assert touched > 0
    assert info["is_success"]


@pytest.mark.slow
def test_a_vector_presses_as_single_arms_do() -> None:
    keywords: dict[str, Any] = {"task": "press", "arm": "three_dof_loaded", "contacts": FLOOR, "duration": 0.6}
    keywords["sensors"] = {"noise": 0.01, "strain_gauges": [{**GAUGES[0], "noise": 0.1, "bias": 0.1}]}
    both = pair(ID, 9, **keywords)
    assert assert_pair_same(both, 60, scale=0.2) > 0
    env = gym.make(ID, **keywords)
    env.reset(seed=0)
    assert_goes_back(env, scale=0.2)


def test_a_measured_observation_has_the_commanded_force() -> None:
    env = pressing(observation="measured", sensors={"strain_gauges": GAUGES})
    assert "target_force" in env.unwrapped.plan.names
    assert "tip_velocity_x" not in env.unwrapped.plan.names


def test_a_wall_stands_on_the_ground_in_pictures() -> None:
    square = np.array([[0.8, -1.0, -1.0], [0.8, 1.0, -1.0], [0.8, 1.0, 1.0], [0.8, -1.0, 1.0]])
    found = _above(square, 0.0)
    assert found[:, 2].min() == 0.0
    assert found[:, 2].max() == 1.0
    assert np.ptp(found[:, 1]) == 2.0
    assert _above(square, 2.0) is square
    assert np.array_equal(_above(square, -2.0), square)
    pen = renderer(pressing().unwrapped.plan, "rgb_array")
    pen.touches = np.array([[0.8, 0.0, 0.2, -3.0, 0.0, 0.0, 3.0]])
    ((start, end),) = pen.arrows()
    assert start == pytest.approx([0.8, 0.0, 0.2])
    assert 0.1 < np.linalg.norm(end - start) / 1.15 < 0.4


@pytest.mark.parametrize(
    ("keywords", "words"),
    [
        ({"task": "land"}, "task = 'land': must be given for TwoLinkFlexArm-v0"),
        ({"contacts": {**FLOOR, "obstacle": Sphere((0.7, 0.0, 0.2), 0.1).to_dict()}}, "a half-space"),
        ({"contacts": {**FLOOR, "obstacle": HalfSpace((2.0, 0.0, 0.0), (-1.0, 0.0, 0.0)).to_dict()}}, "0.9775 m"),
        ({"contacts": {**FLOOR, "obstacle": HalfSpace((0.0, 0.0, 0.1), (0.0, 0.0, 1.0)).to_dict()}}, "outside"),
        ({"reference": {"elevation": (0.5, 0.6)}}, "reference.elevation"),
        ({"reference": {"force": (-1.0, 1.0)}}, "reference.force"),
        ({"reference": {"force": (0.0, 0.0)}}, "reference.force"),
        ({"reference": {"height": (0.2, 0.9)}}, "reference.height"),
        ({"reference": {"speed": (0.2, 0.3)}}, "reference.height"),
        ({"joint_limits": [[-1.0, 1.0], [-0.1, 0.1], [-0.1, 0.1]]}, "reach and the joint limits"),
    ],
)  # fmt: skip
def test_what_is_refused(keywords: dict[str, Any], words: str) -> None:
    given = {"task": "press", "arm": "three_dof_loaded", **keywords}
    assert words in refusal(lambda: gym.make(ID, **given), Exception)


def test_controllers_that_are_refused() -> None:
    env = pressing()
    assert "must be left out with mpc" in refusal(lambda: control.make("mpc", env))
    for name in ("lqr", "lqr_force"):
        assert f"controller = '{name}'" in refusal(lambda name=name: control.make(name, env))
    blind = pressing(observation="measured", sensors={"strain_gauges": []})
    names = [name for name in blind.unwrapped.plan.names if "tip_force" not in name]
    blind = pressing(observation=names, sensors={"encoders": {}})
    assert "strain gauges" in refusal(lambda: control.make("hybrid_force", blind))


def test_the_arm_at_rest_is_that_of_the_solver() -> None:
    """Deflections of 90 mm under gravity and a tip force: tip within 0.3 mm, torques and gauges within 0.3 %."""
    arm, gravity, force = arms.named("three_dof_loaded"), (0.0, 0.0, -9.81), np.array([-5.0, 1.2, -0.8])
    angles = np.array([0.2, 0.6, 1.8])
    gauges = [StrainGauge(**{**gauge, "place": 0.25}) for gauge in GAUGES]
    chain = SpatialChain(arm, np.array(gravity), gauges)
    curvatures = np.zeros((1, chain.cells, 3))
    for _ in range(8):
        found = chain.at(angles[None], force[None], curvatures)
        curvatures = found.curvatures
    load = PointLoad(2, "tip", force_x=constant(-5.0), force_y=constant(1.2), force_z=constant(-0.8))
    where: dict[str, Any] = {"gravity": gravity, "angles": tuple(angles.tolist()), "loads": (load,)}
    scene = Scene("held", arm, duration=1.0, dt=1e-3, **where)
    still = static_equilibrium(scene, elements=6, hold_joints=True, require_stable=False)
    assert found.tip[0] == pytest.approx(tips(arm, still.settings, still.work.q[None])[0, 0], abs=3e-4)
    assert found.torques[0] == pytest.approx(np.array(still.joint_torques()), rel=3e-3)
    model = linearize(still, gauges=[gauge.spot for gauge in gauges])
    readings = model.y[-len(gauges) :]
    mine = found.rows[0] @ force + found.offsets[0]
    scale = np.abs(readings).reshape(2, 3).max(axis=0)
    assert np.abs((mine - readings).reshape(2, 3) / scale).max() < 6e-3
    # without bending, the torques of the force are -J' F (virtual work)
    weightless = SpatialChain(arm, np.zeros(3)).at(angles[None], 1e-6 * force[None], np.zeros((1, chain.cells, 3)))
    assert weightless.torques[0] == pytest.approx(-weightless.jacobian[0].T @ (1e-6 * force), rel=1e-9)


@pytest.mark.slow
def test_the_gauges_of_a_pressed_arm_at_rest_reveal_the_force() -> None:
    """Static balance: the estimate of the gauges and the motors' torques are those of the contact's force, to 1.5 %."""
    wall = {**FLOOR, "obstacle": HalfSpace((0.805, 0.0, 0.0), (-1.0, 0.0, 0.0)).to_dict(), "friction": 0.0}
    still = {"speed": (0.0, 0.0), "force": (4.0, 4.0)}
    names = pressing(observation="measured", sensors={"strain_gauges": GAUGES}).unwrapped.plan.names
    env = gym.make_vec(
        ID, num_envs=2, vectorization_mode="vector_entry_point", task="press", arm="three_dof_loaded", contacts=wall,
        reference=still, sensors={"strain_gauges": GAUGES}, duration=9.0,
        observation=[name for name in names if "tip_force" not in name],
    )  # fmt: skip
    own: Any = control.make("hybrid_force", env, {"friction": 0.0, "force": 0.5, "path": 1.5})
    seen, _ = env.reset(seed=3)
    own.reset(seen)
    for _ in range(900):
        seen, *_, info = env.step(own.act(seen))
    assert info["contact_force"] == pytest.approx([4.0, 4.0], rel=0.015)
    estimate = own._force
    assert -estimate[:, 0] == pytest.approx(info["contact_force"], rel=0.015)
    assert np.abs(estimate[:, 1:]).max() < 0.06
    # virtual work: torques of the arm at rest under the contact's force
    force = -info["contact_force"][:, None] * np.array([1.0, 0.0, 0.0])
    rest = own.chain.at(own.read(seen).angles, force, own._shape)
    assert np.abs(rest.torques - info["joint_torque"]).max() < 0.015 * np.abs(rest.torques).max()
    assert np.linalg.norm(info["target"] - info["tip_position"], axis=1).max() < 0.005


@pytest.mark.slow
@pytest.mark.parametrize("name", ["hybrid_force", "impedance"])
def test_an_episode_may_begin_later_than_the_others(name: str) -> None:
    """Rows that restart act as in a controller whose episodes begin there; all other rows do not change."""
    env = gym.make_vec(ID, num_envs=3, vectorization_mode="vector_entry_point", task="press", arm="three_dof_loaded")
    assert_restart_is_a_start(name, env)
