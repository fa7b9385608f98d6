"""What an arm is to stay out of: info beside runs of scenes, single beside vector, in the plane and in space."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import flexarm_env as fx
from flexarm_env import time_functions
from flexarm_env.derivatives import Arms
from flexarm_env.geometry.ribbons import ribbons
from flexarm_env.shapes import Box, Cylinder, HalfSpace, Shape, Sphere
from tests.env_tools import assert_pair_same, assert_same, pair
from tests.refusals import says

PLANE: list[Shape] = [Sphere((0.5, 0.6), 0.25), Box((-0.4, 0.7), (0.3, 0.5), 0.4), HalfSpace((0.0, -0.3), (0.1, 1.0))]
SPACE: list[Shape] = [
    HalfSpace((0.45, 0.0, 0.0), (-1.0, 0.2, 0.1)), Sphere((0.0, 0.5, 0.6), 0.2),
    Box((-0.3, 0.2, 0.3), (0.2, 0.3, 0.4), ((0.0, 1.0, 1.0), 0.4)), Cylinder((0.2, -0.5, 0.0), (0.0, -0.4, 0.9), 0.1),
]  # fmt: skip
KINDS: dict[str, tuple[str, dict[str, Any]]] = {
    "plane": ("TwoLinkFlexArm-v0", {"keep_out": PLANE}),
    "space": ("SpatialFlexArm-v0", {"keep_out": SPACE, "elements": 1, "dt": 0.005}),
}


def nearest(shapes: list[Shape], points: Any) -> float:
    """Of points (n, d) and shapes."""
    return min(float(shape.distance(points).min()) for shape in shapes)


def along(arm: fx.Arm, settings: fx.Settings, q: Any) -> Any:
    """Points along an arm in space whose first link is straight, from states q (n, rows), and those between."""
    found = ribbons(arm, settings, q, pieces=4).points
    pillar = found[:, :1] + np.linspace(0.0, 1.0, 5)[1:, None] * (found[:, 1:2] - found[:, :1])
    strips = np.concatenate([pillar[:, -1:], found[:, 2:]], axis=1)
    return np.concatenate([pillar, strips, 0.5 * (strips[:, 1:] + strips[:, :-1])], axis=1)


@pytest.mark.parametrize("formulation", ["elastica", "geometrically_exact", "floating_frame"])
def test_rigid_ends_are_a_part_of_the_arm(formulation: str) -> None:
    """Spheres on them were nowhere near."""
    section = fx.Section.rectangle(0.02, 0.006, 70e9, 2700.0, 26e9)
    links = fx.Link(0.4, section, root_offset=0.3, tip_offset=0.3), fx.Link(0.4, section)
    arm = fx.Arm("clamped", links, torque_limits=(5.0, 5.0))
    for x in (0.05, 0.15, 0.25, 0.75, 0.9):
        ball = {"shape": "sphere", "center": (x, 0.0), "radius": 0.06}
        env = gym.make("TwoLinkFlexArm-v0", arm=arm, formulation=formulation, keep_out=ball)
        assert env.reset(seed=0, options={"start": (0.0, 0.0)})[1]["clearance"] < 0.0, x


@pytest.mark.parametrize("kind", ["plane", pytest.param("space", marks=pytest.mark.slow)])
def test_clearance_is_that_of_the_arm_and_of_a_scene_run_beside(kind: str) -> None:
    """Torques held for 0.2 s; a scene starts with another acceleration, which leaves the fourth digit."""
    env_id, keywords = KINDS[kind]
    env = gym.make(env_id, **keywords)
    plan, arm = env.unwrapped.plan, env.unwrapped.plan.arm
    start, action = (0.4, 0.8, -0.6)[: arm.n_links], np.array([0.3, -0.2, 0.2], np.float32)[: arm.n_links]
    infos, own = [env.reset(seed=0, options={"start": start})[-1]], [env.unwrapped.snapshot()]
    for _ in range(round(0.2 / plan.period)):
        infos.append(env.step(action)[-1])
        own.append(env.unwrapped.snapshot())
    torques = np.array(arm.torque_limits) * action
    loads = tuple(fx.JointTorque(k, time_functions.constant(float(u))) for k, u in enumerate(torques))
    space, angles = kind == "space", start if kind == "space" else tuple(np.cumsum(start))
    scene = fx.Scene("s", arm, duration=0.2, dt=plan.settings.dt, gravity=plan.gravity, angles=angles, loads=loads)
    mesh: dict[str, Any] = {"elements": 1} if space else {"nodes": plan.settings.nodes}
    run = fx.simulate(scene, plan.settings.formulation, sample=plan.period, estimate_error=False, **mesh)
    beside = along(arm, run.settings, run.q) if space else run.shapes[:, 1:]
    for told, view, points in zip(infos, own, beside, strict=True):
        here = along(arm, plan.settings, view.q[None])[0] if space else view.points[1:]
        assert told["clearance"] == pytest.approx(nearest(plan.keep_out, here), abs=1e-12)
        assert told["clearance"] == pytest.approx(nearest(plan.keep_out, points), abs=1e-3)
        assert told["penetration"] == max(0.0, -told["clearance"])
        assert told["cost"] == (view.time > 0.0 and told["clearance"] < 0.0)


def test_the_tip_alone_a_margin_and_the_price_of_a_wall() -> None:
    """The wall of an arm of the plane that stands beside it."""
    wall = {"shape": "half_space", "point": (1.0, 0.0), "normal": (-1.0, 0.0)}
    kept = {"keep_out": {"shapes": wall, "of": "tip", "margin": 0.1}}
    env = gym.make("FlexibleArm-v0", **kept)
    charged = gym.make_vec("FlexibleArm-v0", num_envs=2, reward={"cost": 3.0, "change": 0.1}, **kept)
    free = gym.make_vec("FlexibleArm-v0", num_envs=2, reward={"change": 0.1}, **kept)
    for one in (env, charged, free):
        one.reset(seed=0, options={"start": (1.0,)})
    total = 0.0
    for _ in range(30):
        info = env.step(np.array([-1.0], np.float32))[-1]
        (_, paid, *_, told), reward = charged.step(np.full((2, 1), -1.0, np.float32)), free.step(-np.ones((2, 1)))[1]
        assert np.array_equal(paid, reward + told["reward_cost"]) and told["cost"][0] == info["cost"]
        assert np.array_equal(told["reward_cost"], -3.0 * told["cost"])
        total += float(info["cost"])
        assert info["clearance"] == pytest.approx(1.0 - info["tip_position"][0], abs=1e-12)
        assert info["cost"] == (info["clearance"] < 0.1) and info["episode_cost"] == total
    assert total > 0.0


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_single_and_vector_agree_to_the_last_bit(kind: str) -> None:
    env_id, keywords = KINDS[kind]
    both = pair(env_id, 4, duration=0.1, reward={"cost": 2.0}, **keywords)
    assert assert_pair_same(both, 14) >= 4


def test_absent_it_changes_nothing() -> None:
    """Neither what is observed nor, but for what is told, info."""
    plain, kept = gym.make("TwoLinkFlexArm-v0"), gym.make("TwoLinkFlexArm-v0", keep_out=PLANE)
    rng = np.random.default_rng(1)
    first, second = plain.reset(seed=5), kept.reset(seed=5)
    for _ in range(5):
        told = {name: value for name, value in second[-1].items() if name in first[-1]}
        assert_same((*first[:-1], first[-1]), (*second[:-1], told))
        more = set(second[-1]) - set(first[-1])
        assert more == {"clearance", "penetration", "cost", "episode_cost"}
        action = rng.uniform(-1.0, 1.0, 2).astype(np.float32)
        first, second = plain.step(action), kept.step(action)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ([], "keep_out = []: must hold shapes"),
        ("wall", "keep_out = 'wall'"),
        ([Sphere((0.0, 0.0, 0.0), 1.0)], "keep_out[0]"),
        ([{"shape": "sphere", "center": (0, 0), "radius": -1}], "keep_out[0].radius = -1"),
        ({"shapes": PLANE, "margin": -0.1}, "keep_out.margin = -0.1"),
        ({"shapes": PLANE, "of": "elbow"}, "keep_out.of = 'elbow'"),
        ({"shapes": PLANE, "reach": 1.0}, "keep_out.reach"),
    ],
)
def test_what_is_wrong_is_named(given: Any, words: str) -> None:
    says(words, lambda: gym.make("TwoLinkFlexArm-v0", keep_out=given))


def test_a_price_needs_what_costs_and_has_no_slope() -> None:
    says("reward.cost = 3.0: must be given with", lambda: gym.make("FlexibleArm-v0", reward={"cost": 3.0}))
    priced = {"keep_out": PLANE, "reward": {"cost": 3.0}}
    says("reward.cost = 3.0: must be left out", lambda: Arms("TwoLinkFlexArm-v0", 2, **priced))


@pytest.mark.parametrize("kind", ["plane", pytest.param("space", marks=pytest.mark.slow)])
def test_shapes_are_drawn(kind: str) -> None:
    pytest.importorskip("pygame")
    env_id, keywords = KINDS[kind]
    env = gym.make(env_id, render_mode="rgb_array", **keywords)
    env.reset(seed=0)
    picture = np.asarray(env.render()).astype(int)
    assert picture.shape == (640, 640, 3)
    red = (picture[..., 0] > picture[..., 1] + 6) & (picture[..., 0] > picture[..., 2] + 6)
    assert red.mean() > 0.02
