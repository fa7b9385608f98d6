"""Targets that are drawn: within reach at the joints' limits, and held by the motors against gravity."""

import dataclasses
import functools
import math
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from flexarm_env import Arm, Elbow, Link, Section, arms
from flexarm_env.batch import FURTHER
from flexarm_env.envs.options import plan
from flexarm_env.envs.space import SPACE
from flexarm_env.envs.task import REACH, SLEW
from flexarm_env.rigid import tip_at, weight_and_inertia
from flexarm_env.tasks.starts import FACTOR
from tests.refusals import refuses, says

LINK = Link(0.5, Section(EI=1.0, EA=1e4, C=1e4, m=0.2))


def drawn(env_id: str, n: int = 400, seed: int = 0, **keywords: Any) -> tuple[Any, np.ndarray]:
    """The plan of an environment, and the targets of n arms."""
    env = gym.make_vec(env_id, num_envs=n, vectorization_mode="vector_entry_point", **keywords)
    _, info = env.reset(seed=seed)
    return env.unwrapped.plan, info["target"]


def reached(arm: Arm, target: np.ndarray) -> bool:
    """Whether one of both elbows of two links reaches a point, by the law of cosines and all whole turns of the hub."""
    (a, b), (hub, elbow) = (link.span for link in arm.links), arm.joint_limits
    cosine = (target @ target - a * a - b * b) / (2.0 * a * b)
    if abs(cosine) > 1.0:
        return False
    for bend in (math.acos(cosine), -math.acos(cosine)):
        turn = math.atan2(target[1], target[0]) - math.atan2(b * math.sin(bend), a + b * math.cos(bend))
        turns = [turn + 2.0 * math.pi * k for k in range(-3, 4)]
        if elbow[0] <= bend <= elbow[1] and any(hub[0] <= one <= hub[1] for one in turns):
            return True
    return False


def test_points_of_two_links_are_within_the_joints_limits() -> None:
    """Limits of +-2.0 and +-2.2: of 400 targets that rules 1 draw, 83 have no posture within them."""
    limits = {"joint_limits": [(-2.0, 2.0), (-2.2, 2.2)]}
    plan, targets = drawn("TwoLinkFlexArm-v0", **limits)
    _, before = drawn("TwoLinkFlexArm-v0", rules=1, **limits)
    lost = np.array([not reached(plan.arm, target) for target in before])
    assert lost.sum() == 83 and all(reached(plan.arm, target) for target in targets)
    assert np.array_equal(targets[~lost], before[~lost])  # those that need no other draw are as they were


def test_unlike_links_have_a_hole_in_their_reach() -> None:
    """Links of 0.8 and 0.2 m do not come nearer than 0.6 m, without limits too."""
    long, short = (dataclasses.replace(LINK, length=length) for length in (0.8, 0.2))
    arm = Arm("unlike", (long, short), hub_inertia=0.1, elbows=(Elbow(0.1, 0.01, 0.01),), torque_limits=(1.0, 0.2))
    _, targets = drawn("TwoLinkFlexArm-v0", arm=arm)
    assert np.linalg.norm(targets, axis=1).min() > 0.6 - 1e-9


def test_goals_keep_the_limits_of_the_hub() -> None:
    """Of both elbows, the one that the hub's limits allow, however many whole turns off."""
    limits = [(1.0, 7.0), (-2.8, 2.8)]
    env = gym.make_vec(
        "TwoLinkFlexArm-v0", num_envs=100, vectorization_mode="vector_entry_point", joint_limits=limits,
        starts={"angles": [(3.0, 5.0), (-1.0, 1.0)]},
    )  # fmt: skip
    env.reset(seed=0)
    goals = np.array([env.unwrapped.batch.record(i)[-2:] for i in range(100)])
    assert (goals[:, 0] >= 1.0).all() and (goals[:, 0] <= 7.0).all() and (np.abs(goals[:, 1]) <= 2.8).all()


def test_three_links_and_one() -> None:
    """Chains by the posture of least angles; angles of one link within the hub's limits."""
    _, targets = drawn("MultiLinkFlexArm-v0", n=100, joint_limits=[(-0.5, 0.5), (-1.0, 1.0), (-1.0, 1.0)])
    bearings = np.arctan2(targets[:, 1], targets[:, 0])
    assert np.abs(bearings).max() < 0.5 + 2.0  # the hub's limit, and what both elbows can add
    _, angles = drawn("FlexibleArm-v0", joint_limits=[(-1.0, 1.0)])
    assert np.abs(angles).max() <= 1.0


def test_what_motors_cannot_hold_is_not_drawn() -> None:
    """One link under gravity: torque m g c cos(angle), c the centre of mass, from its uniform mass and payload."""
    strip = arms.named("strip")
    keywords = {"gravity": (0.0, -9.81)}
    plan, angles = drawn("FlexibleArm-v0", **keywords)
    weight = 9.81 * (0.5 * strip.links[0].mass + strip.payload.mass) * strip.links[0].length
    assert weight > plan.arm.torque_limits[0]
    assert (weight * np.abs(np.cos(angles)) <= plan.arm.torque_limits[0] + 1e-9).all()


@pytest.mark.parametrize(("env_id", "limits"), [("TwoLinkFlexArm-v0", [(-0.05, 0.05), (2.6, 2.8)])])
def test_where_no_target_is_attainable_the_environment_is_not_made(env_id: str, limits: list[Any]) -> None:
    wrong = r"starts.target = .*: must hold targets that 'de_luca_siciliano' reaches within its joint limits"
    refuses(wrong, lambda: gym.make(env_id, joint_limits=limits))


def test_weak_motors_in_space_hold_what_is_drawn() -> None:
    """12 of 40 targets of an arm with weak motors could not be held at their posture."""
    arm = dataclasses.replace(arms.named("three_dof_loaded"), torque_limits=(20.0, 3.0, 1.2))
    gravity = np.array([0.0, 0.0, -9.81])

    def share(rules: int) -> float:
        env = gym.make_vec(
            "SpatialFlexArm-v0", num_envs=60, vectorization_mode="vector_entry_point", arm=arm, rules=rules
        )
        env.reset(seed=0)
        goals = np.array([env.unwrapped.batch.record(i)[-3:] for i in range(60)])
        needed = np.abs(weight_and_inertia(arm, gravity, goals)[0])
        return float((needed > np.array(arm.torque_limits)).any(axis=1).mean())

    assert share(1) > 0.2 and share(2) == 0.0
    weaker = dataclasses.replace(arm, torque_limits=(20.0, 1e-3, 1e-3))
    wrong = "starts.target = .* that its motors hold against gravity"
    refuses(wrong, lambda: gym.make("SpatialFlexArm-v0", arm=weaker))


def test_a_requested_target_in_space_leaves_later_draws_as_they_are() -> None:
    """Targets of weak motors are drawn several times; a request must not change how many numbers of the stream go."""
    arm = dataclasses.replace(arms.named("three_dof_loaded"), torque_limits=(20.0, 3.0, 1.2))
    env: Any = gym.make("SpatialFlexArm-v0", arm=arm, elements=1, dt=0.005, randomization={"GJ": (0.5, 2.0)}).unwrapped
    free, row = np.full(3, np.nan), env.batch.info_at.further + FURTHER.drawn + FACTOR.GJ
    for key in range(20):
        found = []
        # requests of no angle, of one, as the C library permits, and of all
        for goals in (free, np.array([np.nan, 0.3, np.nan]), np.array([0.1, 0.3, 0.2])):
            env.batch.ask(free, goals, np.zeros(1))
            env.batch.start((0,), (key,), limit=10)
            found.append((env.batch.record(0)[-3:].copy(), env.batch.table[row, 0]))
        (drawn, factor), (one, second), (all_of_them, third) = found
        assert factor == second == third
        assert one.tolist() == [drawn[0], 0.3, drawn[2]] and all_of_them.tolist() == [0.1, 0.3, 0.2]


def test_heavier_payloads_are_held_too() -> None:
    """Of a payload that is drawn the heaviest counts."""
    keywords: dict[str, Any] = {"gravity": (0.0, -9.81), "randomization": {"payload": (0.5, 2.0)}}
    strip = arms.named("strip")
    plan, angles = drawn("FlexibleArm-v0", **keywords)
    weight = 9.81 * (0.5 * strip.links[0].mass + 2.0 * strip.payload.mass) * strip.links[0].length
    assert (weight * np.abs(np.cos(angles)) <= plan.arm.torque_limits[0] + 1e-9).all()


def test_two_joints_in_space_find_their_targets() -> None:
    """J J' of two joints has no full rank: for some targets of a long arm the steps raised LinAlgError."""
    from flexarm_env.geometry.inverse import angles_at

    three, rng = arms.named("three_dof"), np.random.default_rng(0)
    for joints in ((0, 1), (1, 2)):
        links = tuple(dataclasses.replace(three.links[k], length=6.0 * three.links[k].length) for k in joints)
        arm = dataclasses.replace(three, links=links, elbows=three.elbows[:1], torque_limits=(20.0, 10.0))
        for _ in range(40):
            point = tip_at(arm, rng.uniform(-1.8, 1.8, 2))
            found = angles_at(arm, point)
            assert found is not None and np.linalg.norm(tip_at(arm, found) - point) < 1e-9 * arm.total_length


def test_of_several_postures_the_one_that_motors_hold_is_taken() -> None:
    """Both elbows reach a point; near the base, with the upper arm up, less is asked of the shoulder."""
    from flexarm_env.geometry.inverse import angles_at

    arm = arms.named("three_dof")
    gravity, rng, weaker = (0.0, 0.0, -9.81), np.random.default_rng(1), 0
    for _ in range(60):
        angles = rng.uniform(-1.2, 1.2, 3)
        needed = np.abs(weight_and_inertia(arm, np.array(gravity), angles[None])[0][0])
        weak = dataclasses.replace(arm, torque_limits=tuple((needed + 0.01).tolist()))
        found = angles_at(weak, tip_at(arm, angles), gravity)
        assert found is not None
        held = np.abs(weight_and_inertia(weak, np.array(gravity), found[None])[0][0])
        assert (held <= np.array(weak.torque_limits) + 1e-9).all()
        blind = angles_at(weak, tip_at(arm, angles))
        assert blind is not None
        lost = np.abs(weight_and_inertia(weak, np.array(gravity), blind[None])[0][0])
        weaker += bool((lost > weak.torque_limits).any())
    assert weaker > 0


def test_moving_targets_stay_within_the_joint_limits() -> None:
    """Drawn circles: under rules 1 some lead where no posture within the limits reaches, under rules 2 none."""
    limits, out = [(-1.2, 1.2), (-1.7, 1.7)], []
    for rules in (1, 2):
        env: Any = gym.make_vec("TwoLinkFlexArm-v0", num_envs=64, task="track", joint_limits=limits, rules=rules)
        env.reset(seed=0)
        at = [env.step(np.zeros((64, 2), np.float32))[4]["target"] for _ in range(390)][::10]
        arm = env.unwrapped.plan.arm
        out.append(sum(not all(reached(arm, point[i]) for point in at) for i in range(64)))
    assert out[0] >= 5 and out[1] == 0


def test_swings_stay_within_the_joint_limits() -> None:
    env: Any = gym.make_vec("FlexibleArm-v0", num_envs=64, task="track", joint_limits=[(-1.5, 1.5)])
    env.reset(seed=0)
    at = np.array([env.step(np.zeros((64, 1), np.float32))[4]["target"] for _ in range(200)])
    assert abs(at).max() <= 1.5 and abs(at).max() > 1.0


def test_paths_beyond_the_joint_limits_are_refused() -> None:
    t = np.linspace(0.0, 8.0, 81)
    circle = np.column_stack([t, 0.3 + 0.2 * np.cos(t), 0.2 * np.sin(t)])  # 0.1 m from the root at t = pi
    says("m at 2.", lambda: plan(REACH, task="track", reference=circle))
    says("can follow within its joint limits", lambda: plan(REACH, task="track", reference=circle))
    circle[:, 1] += 0.15
    plan(REACH, task="track", reference=circle)
    table = np.column_stack([t, 0.5 * t])
    says("reference = (1.01) rad at 2.02 s", lambda: plan(SLEW, task="track", reference=table, joint_limits=[(-1, 1)]))
    says("none of 100 drawn ones is", lambda: plan(REACH, task="track", joint_limits=[(-0.1, 0.1), (-0.1, 0.1)]))


def test_paths_in_space_stay_within_the_joint_limits() -> None:
    """A given path is followed from the start on; usual ranges are narrowed, those that are given are not."""
    space, free = functools.partial(plan, SPACE, task="track"), [(-2.0, 2.0), (-2.5, 2.5)]
    t = np.linspace(0.0, 5.0, 51)
    turn = 0.5 * math.pi * t  # the yaw joint has to turn with it
    circle = np.column_stack([t, 0.57 * np.cos(turn), 0.57 * np.sin(turn), np.full(51, 0.34)])
    beyond = "must be a point within reach and the joint limits"
    says(beyond, lambda: space(reference=circle, joint_limits=[(-1.0, 1.0), *free]))
    refuses(
        r"^reference = \(.*\) m at 2\.\d+ s: must stay where 'three_dof' can follow within its joint limits",
        lambda: space(reference=circle, joint_limits=[(-3.2, 3.2), *free]),
    )
    space(reference=circle, joint_limits=[(-1.0, 8.2), *free])
    narrow = [(-2.0, 2.0), *free]
    with pytest.warns(UserWarning, match=r"the usual paths lead beyond the joint limits of 'three_dof'"):
        found = space(joint_limits=narrow).extras.reference.ranges.reshape(5, 2)
    usual = space().extras.reference.ranges.reshape(5, 2)
    assert (found[[0, 2, 3, 4], 0] > usual[[0, 2, 3, 4], 0]).all() and (found[1] == usual[1]).all()
    says("within reach and the joint limits", lambda: space(joint_limits=narrow, reference={"distance": usual[0]}))


def test_a_given_path_is_not_measured_by_what_would_be_drawn() -> None:
    """Links of 0.8 and 0.2 m reach from 0.6 m on; circles of the usual ranges come nearer."""
    links = tuple(dataclasses.replace(LINK, length=length) for length in (0.8, 0.2))
    arm = Arm("unlike", links, hub_inertia=0.1, torque_limits=(1.0, 0.3))
    path = np.array([[0.0, 0.7, 0.0], [5.0, 0.7, 0.3]])
    assert plan(REACH, arm=arm, task="track", reference=path, dt=0.005, nodes=4).extras.reference.needs is None
    says("must keep the path within reach", lambda: plan(REACH, arm=arm, task="track", dt=0.005, nodes=4))


def test_given_targets_beyond_the_joint_limits_are_refused() -> None:
    """The least distance is 0.17 m, at an elbow of 2.8 rad; within it a target was accepted that nothing reaches."""
    env = gym.make("TwoLinkFlexArm-v0")
    for near in (0.0, 0.1, -0.169):
        says("must be within the joint limits", lambda: env.reset(options={"target": (0.0, near)}))  # noqa: B023
    env.reset(options={"target": (0.0, 0.171)})
    slew = gym.make("FlexibleArm-v0", joint_limits=[(-1.0, 1.0)])
    says("options.target = 1.2: must be within the joint limits", lambda: slew.reset(options={"target": 1.2}))
    slew.reset(options={"target": -0.9})
    gym.make("FlexibleArm-v0").reset(options={"target": 3.0})
