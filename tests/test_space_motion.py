"""Targets that move, and joints whose motion is prescribed, in space."""

import copy
import dataclasses
import math
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import flexarm_env as fx
from flexarm_env import arms, time_functions
from flexarm_env.geometry.inverse import angles_at, beyond_reach
from flexarm_env.rigid import rate_scale, tip_at
from flexarm_env.rotations import matrices, of_quaternions
from flexarm_env.tasks.program import GOAL
from tests import space_answers as answers
from tests.refusals import refuses

ARM = arms.named("three_dof")
COARSE: dict[str, Any] = {"elements": 1, "dt": 0.005}
STILL = np.zeros(3, np.float32)
ENDS = ((0.5, 0.6), (0.3, 0.2), (0.6, 0.7))
PATH = [time_functions.from_array([[0.0, a], [0.4, b], [6.0, b]], "linear") for a, b in ENDS]
AHEAD = (0.1, 0.3)


def root_of(run: Any, at: int) -> np.ndarray:
    """Axes of the root of link 0."""
    return matrices(of_quaternions(run.link_rotations[at, 0, 0]))


@pytest.mark.slow
def test_a_given_path_is_seen_and_paid_as_a_scene_beside_has_it() -> None:
    """Torques held for 50 ms in fine steps; what the path adds to the entries, and the speed that counts."""
    env = gym.make("SpatialFlexArm-v0", task="track", reference=PATH, elements=1, dt=2e-4, tolerance=1e-9)
    start, action = (0.2, 0.7, -0.4), np.array([0.1, -0.3, 0.2], np.float32)
    env.reset(seed=0, options={"start": start})
    for _ in range(5):
        seen, reward, *_, info = env.step(action)
    run = answers.beside(env, action, start)
    at, L, w = len(run.t) - 1, ARM.total_length, rate_scale(ARM, 0)
    assert run.t[at] == pytest.approx(0.05)
    target, rate = (np.array([f(0.05, d) for f in PATH]) for d in (0, 1))
    ways = [np.array([f(0.05 + time) for f in PATH]) - target for time in AHEAD]
    A, tip, velocity = root_of(run, at), run.tip[at], run.tip_velocity[at, :3]
    expected = [*(A.T @ velocity / (w * L)), *(A.T @ (target - tip) / (0.5 * L)), *(A.T @ rate / (w * L))]
    expected += [x for way in ways for x in A.T @ way / (0.5 * L)]
    assert env.unwrapped.plan.names[-9:] == tuple(
        f"target_{name}_{axis}" for name in ("velocity", "ahead_1", "ahead_2") for axis in "xyz"
    )
    assert seen[-15:] == pytest.approx(np.array(expected), abs=2e-3)
    assert seen[-9:-6] == pytest.approx(A.T @ rate / (w * L), abs=1e-5)  # which the arm's motion hardly enters
    assert info["target"] == pytest.approx(target, abs=1e-12)
    e, v = np.linalg.norm(target - tip) / L, np.linalg.norm(velocity - rate) / L
    assert info["reward_accuracy"] == pytest.approx(0.5 * math.exp(-((e / 0.1) ** 2)), abs=1e-4)
    assert info["reward_settle"] == pytest.approx(math.exp(-((e / 0.02) ** 2) - (v / 0.1) ** 2), abs=1e-4)
    assert reward == pytest.approx(sum(x for name, x in info.items() if name.startswith("reward_")))


@pytest.mark.slow
def test_who_goes_with_the_target_succeeds() -> None:
    """A rigid tip can be no nearer: rest at a target that stands, where the same place under a moving one is none."""
    start = (0.2, 0.7, -0.4)
    place = tip_at(ARM, np.array(start))
    for speed, won in ((0.0, True), (0.1, False)):
        path = [(0.0, *place), (1.0, *(place - [0.0, speed, 0.0])), (9.0, *(place - [0.0, speed, 0.0]))]
        env = gym.make("SpatialFlexArm-v0", task="track", reference=path, gravity=(0, 0, 0), **COARSE)
        env.reset(seed=0, options={"start": start})
        for _ in range(60):
            *_, info = env.step(STILL)
        assert info["is_success"] is won


@pytest.mark.slow
def test_drawn_circles_and_lines() -> None:
    """Their numbers within the ranges that are given, the goal's joint angles on the target, the rate its slope."""
    ranges = {"distance": (0.6, 0.65), "bearing": (-0.5, 1.5), "elevation": (0.5, 0.8)}
    L, normals, ways = ARM.total_length, [], []
    circle = gym.make_vec(
        "SpatialFlexArm-v0", num_envs=8, task="track", reference=ranges | {"radius": (0.1, 0.12), "period": (0.5, 0.6)},
        **COARSE,
    )  # fmt: skip
    line = gym.make_vec(
        "SpatialFlexArm-v0", num_envs=8, task="track",
        reference=ranges | {"path": "line", "time": (0.2, 0.3), "speed": (0.3, 0.4)}, **COARSE,
    )  # fmt: skip
    for env in (circle, line):
        _, info = env.reset(seed=0)
        targets = [info["target"]]
        for _ in range(60):
            *_, info = env.step(np.zeros((8, 3), np.float32))
            targets.append(info["target"])
        places = np.array(targets)  # (61, 8, 3)
        for i in range(8):
            goal = env.unwrapped.batch.record(i)[GOAL : GOAL + 3]
            assert np.abs(tip_at(ARM, goal) - places[-1, i]).max() < 1e-9 * L
            p = places[:, i]
            if env is circle:
                normal = np.linalg.svd(p - p.mean(axis=0))[2][2]
                assert np.abs((p - p[0]) @ normal).max() < 1e-12
                flat = np.linalg.lstsq(np.hstack([2.0 * p, np.ones((61, 1))]), (p * p).sum(axis=1), rcond=None)[0][:3]
                middle = flat + ((p[0] - flat) @ normal) * normal  # of all on the circle's axis the one in its plane
                radius = np.linalg.norm(p - middle, axis=1)
                assert np.ptp(radius) < 1e-9 and 0.1 <= radius[0] <= 0.12
                turn = math.asin(np.linalg.norm(np.cross(p[0] - middle, p[1] - middle)) / radius[0] ** 2)
                assert 0.5 <= 2.0 * math.pi / turn * 0.01 <= 0.6
                normals.append(np.sign(np.cross(p[0] - middle, p[1] - middle) @ normal) * normal)
            else:
                steps = np.diff(p, axis=0)
                assert np.ptp(steps, axis=0).max() < 1e-12
                velocity = steps[0] / 0.01
                assert 0.3 <= np.linalg.norm(velocity) <= 0.4
                time = -(p[0] @ velocity) / (velocity @ velocity)
                middle = p[0] + time * velocity
                assert 0.2 <= time <= 0.3
                ways.append(velocity)
            assert 0.6 - 1e-9 <= np.linalg.norm(middle) <= 0.65 + 1e-9
            assert -0.5 <= math.atan2(middle[1], middle[0]) <= 1.5
            assert 0.5 <= math.asin(middle[2] / np.linalg.norm(middle)) <= 0.8
    for vectors in (normals, ways):  # they point all around
        assert np.linalg.matrix_rank(np.array(vectors), tol=0.1 * np.linalg.norm(vectors[0])) == 3
    assert np.ptp(np.sign(np.array(normals)), axis=0).all()


@pytest.mark.slow
def test_encoders_turn_what_is_shown_of_the_target() -> None:
    """Into the frame at the angle that the first one reads."""
    keywords: dict[str, Any] = {"task": "track", "reference": PATH, **COARSE}
    env = gym.make("SpatialFlexArm-v0", observation="measured", sensors={"encoders": {"counts": 16}}, **keywords)
    true = gym.make("SpatialFlexArm-v0", **keywords)
    names = env.unwrapped.plan.names
    action = np.array([0.3, 0.0, 0.0], np.float32)
    for one in (env, true):
        one.reset(seed=0, options={"start": (0.45, 0.7, -0.4)})
    for _ in range(5):
        seen, entries = env.step(action)[0], true.step(action)[0]
    angle = math.atan2(seen[names.index("hub_sin")], seen[names.index("hub_cos")])
    truth = math.atan2(entries[0], entries[1])
    assert abs(angle % (2.0 * math.pi / 16.0)) == pytest.approx(0.0, abs=1e-6) and abs(angle - truth) > 0.02
    turn = matrices((truth - angle) * np.array(ARM.hub_axis))
    for k, first in enumerate(range(len(entries) - 9, len(entries), 3)):
        at = names.index("target_velocity_x") + 3 * k
        assert seen[at : at + 3] == pytest.approx(turn @ entries[first : first + 3], abs=1e-6)


def test_points_are_told_from_those_beyond_reach() -> None:
    """Two strips of 0.5 m about a shoulder at 0.15 m: within 1 m of it."""
    rng = np.random.default_rng(0)
    shoulder, way = np.array([0.0, 0.0, 0.15]), rng.normal(size=(40, 3))
    way /= np.linalg.norm(way, axis=1)[:, None]
    inside = shoulder + way * rng.uniform(0.3, 0.98, (40, 1))
    assert beyond_reach(ARM, inside) is None
    for off in (1.02 * way[7], np.array([np.nan, 0.0, 0.0])):
        points = inside.copy()
        points[23] = shoulder + off
        assert beyond_reach(ARM, points) == 23
    found = angles_at(ARM, inside[0])
    assert found is not None and np.abs(tip_at(ARM, found) - inside[0]).max() < 1e-9


@pytest.mark.parametrize(
    ("reference", "words"),
    [
        ([(0.0, 0.5, 0.0, 0.6), (5.0, -0.5, math.nan, 0.6)], r"reference\[1\]\.psi\[1\] = nan: must be a finite"),
        ([(0.0, 0.5, 0.0, 0.6), (5.0, -0.5, 3.0, 0.6)], r"reference = \(.*\) m at 1.45 s: must be a point within"),
        ([(0.0, 0.5, 0.0), (5.0, 0.5, 0.1)], r"reference = .*: must be .* a table \(n, 4\): t, x, y, z"),
        (3.0, r"reference = 3.0: must be a sequence of three functions of time"),
        ({"distance": (0.1, 5.0)}, r"reference.distance = \(0.1, 5.0\): must keep the path.*within reach: \(.*\) m is"),
        ({"path": "line", "distance": (1.1, 1.2)}, r"reference.distance = \(1.1, 1.2\): must keep the path"),
        ({"elevation": (0.1, math.nan)}, r"reference.elevation\[1\] = nan"),
        ({"path": "swing"}, r"reference.path = 'swing': must be one of \"circle\", \"line\""),
        ({"path": "line", "radius": (0.0, 0.1)}, r"reference.radius: unknown key; allowed: .*elevation"),
    ],
)
def test_wrong_paths_are_refused(reference: Any, words: str) -> None:
    refuses(words, lambda: gym.make("SpatialFlexArm-v0", task="track", reference=reference))


@pytest.mark.slow
def test_what_goes_with_a_moving_target_alone_is_refused() -> None:
    refuses(r'reference = .*task="track" only', lambda: gym.make("SpatialFlexArm-v0", reference={"path": "circle"}))
    env = gym.make("SpatialFlexArm-v0", task="track", reference=PATH, **COARSE)
    refuses(r"options\.target = .*track", lambda: env.reset(options={"target": [0.5, 0.0, 0.5]}))


# ------------------------------------------------------------------ prescribed motions
TURNS = [time_functions.cycloid(rise, 0.2) for rise in (0.5, 0.9, -0.7)]


def replayed(env: Any, run: Any, periods: int) -> None:
    """Info and entries of an episode of prescribed motion beside the trajectory of its scene."""
    w, L = [rate_scale(ARM, k) for k in range(3)], ARM.total_length
    for at in range(1, periods + 1):
        seen, _, terminated, _, info = env.step(STILL)
        assert not terminated
        assert np.array_equal(info["joint_torque"], run.joint_torque[at])
        assert info["tip_position"] == pytest.approx(run.tip[at], abs=1e-12)
        assert info["tip_deflection"] == pytest.approx(run.tip_deflection[at].T.ravel(), abs=1e-12)
        assert info["twist"] == pytest.approx(run.twist[at], abs=1e-12)
        for name in ("kinetic", "gravity"):
            assert info[f"energy_{name}"] == getattr(run, name)[at]
        assert info["energy_dissipated"] == run.dissipated[at] + run.unresolved_damping[at]
        assert (info["energy_strain"], info["work"]) == (run.strain_energy[at], run.work[at])
        A = root_of(run, at)
        expected = [f(run.joint_angles[at, k]) for k in range(3) for f in (math.sin, math.cos)]
        expected += [run.joint_rates[at, k] / w[k] for k in range(3)]
        assert seen[:9] == pytest.approx(np.array(expected), abs=1e-6)
        ways = [*(A.T @ run.tip_velocity[at, :3] / (w[0] * L)), *(A.T @ (info["target"] - run.tip[at]) / (0.5 * L))]
        assert seen[-6:] == pytest.approx(np.array(ways), abs=1e-6)


@pytest.mark.slow
def test_an_episode_of_prescribed_motion_is_simulate() -> None:
    """Reactions to the last bit, and what they work against: motors' work is what energies and damping come to."""
    env: Any = gym.make("SpatialFlexArm-v0", task="replay", motion=TURNS, info_level="full", **COARSE)
    _, start = env.reset(seed=0)
    scene = dataclasses.replace(env.unwrapped.guide.scene, sample=0.01)
    run = fx.simulate(scene, estimate_error=False, **env.unwrapped.plan.settings.options())
    assert np.array_equal(start["joint_torque"], run.joint_torque[0])
    assert start["target"] == pytest.approx(tip_at(ARM, np.array([0.5, 0.9, -0.7])), abs=1e-12)
    replayed(env, run, 19)
    *_, truncated, info = env.step(STILL)
    assert truncated and np.array_equal(info["joint_torque"], run.joint_torque[20])
    fine = fx.simulate(scene, sample=5e-4, dt=5e-4, estimate_error=False, elements=1, tolerance=1e-8)
    power = (fine.joint_torque * fine.joint_rates).sum(axis=1)
    work = np.concatenate([[0.0], np.cumsum(0.5 * np.diff(fine.t) * (power[1:] + power[:-1]))])
    energy = fine.kinetic + fine.strain_energy + fine.gravity + fine.dissipated
    assert np.abs(energy - energy[0] - work).max() < 5e-3 * np.abs(work).max()


@pytest.mark.slow
def test_joints_that_are_left_free_take_torques() -> None:
    """As loads from t = 0 on; that the arm is let go before they set in differs by h^3 (6e-4 N m at 5 ms)."""
    env: Any = gym.make("SpatialFlexArm-v0", info_level="full", elements=1, dt=0.001, tolerance=1e-7)
    env.reset(seed=0, options={"motion": {"joint1": TURNS[1]}, "start": (0.3, 0.0, -0.2)})
    action, scene = np.array([0.1, 1.0, -0.05], np.float32), env.unwrapped.guide.scene
    torques = np.array(ARM.torque_limits) * action.astype(np.float64)
    loads = tuple(fx.JointTorque(k, time_functions.constant(float(torques[k]))) for k in (0, 2))
    scene = dataclasses.replace(scene, loads=loads, sample=0.01)
    run = fx.simulate(scene, estimate_error=False, **env.unwrapped.plan.settings.options())
    for at in range(1, 11):
        info = env.step(action)[-1]
        assert info["joint_torque"] == pytest.approx(run.joint_torque[at], abs=5e-5)
        assert info["joint_torque"][0] == torques[0] and info["joint_torque"][1] != torques[1]
        assert info["tip_position"] == pytest.approx(run.tip[at], abs=1e-8)


@pytest.mark.slow
def test_replays_in_a_vector_are_single_ones_and_states_go_back() -> None:
    n = 3
    many: Any = gym.make_vec("SpatialFlexArm-v0", num_envs=n, info_level="full", **COARSE)
    one: Any = gym.make("SpatialFlexArm-v0", info_level="full", **COARSE).unwrapped
    motions = [None, {"joint0": TURNS[0], "joint2": TURNS[2]}, None]
    many.reset(seed=4, options={"motion": motions, "start": (0.0, 0.1, 0.0)})
    one.reset(seed=5, options={"motion": motions[1], "start": (0.0, 0.1, 0.0)})
    for step in range(6):
        action = np.full((n, 3), 0.1, np.float32)
        seen, _, _, _, infos = many.step(action)
        alone, *_, info = one.step(action[1])
        assert np.array_equal(alone, seen[1])
        assert all(np.array_equal(infos[name][1], value) for name, value in info.items())
        if step == 2:
            kept, view = copy.deepcopy(one.get_state()), one.snapshot()
            assert view.points[-1] == pytest.approx(info["tip_position"], abs=1e-12)
            assert view.deflection == pytest.approx(info["tip_deflection"], abs=1e-12)
    one.set_state(kept)
    for _ in range(3):
        last = one.step(action[1])
    assert np.array_equal(last[0], alone) and np.array_equal(last[-1]["joint_torque"], info["joint_torque"])


@pytest.mark.slow
def test_sensors_read_a_replay_as_its_trajectory() -> None:
    gauges = [(1, 0.0), {"link": 2, "place": 0.3, "measures": "torsion"}, {"link": 1, "place": 0.1, "measures": "xz"}]
    names = ["strain_gauge_1", "strain_gauge_2", "strain_gauge_3", "hub_sin"]
    env: Any = gym.make(
        "SpatialFlexArm-v0", task="replay", motion=TURNS, observation=names, sensors={"strain_gauges": gauges}, **COARSE
    )
    env.reset(seed=0)
    plan, scene = env.unwrapped.plan, dataclasses.replace(env.unwrapped.guide.scene, sample=0.01)
    run = fx.simulate(scene, estimate_error=False, **plan.settings.options())
    measured = run.measured({"strain_gauges": gauges})
    for at in range(1, 11):
        seen = env.step(STILL)[0]
        expected = [measured[name][at] / scale for name, scale in zip(names[:3], plan.scales, strict=False)]
        assert seen[:3] == pytest.approx(np.array(expected), abs=1e-6)


def test_the_usual_motion_goes_to_its_end() -> None:
    env = gym.make("SpatialFlexArm-v0", task="replay", max_episode_steps=3, **COARSE)
    _, info = env.reset(seed=0)
    assert info["target"] == pytest.approx(tip_at(ARM, np.full(3, 1.5)), abs=1e-9)
    assert [env.step(STILL)[3] for _ in range(3)] == [False, False, True]


@pytest.mark.parametrize(
    ("motion", "words"),
    [
        ([[0.0, 0.0], [1.0, math.nan]], r"options\.motion.psi\[1\] = nan"),
        ("nope.csv", r"options\.motion = 'nope\.csv': must be a \.csv file that exists"),
        ("flying_rod", r"options\.motion = 'flying_rod': must be a scene of an arm that is pinned"),
        ({"joint7": TURNS[0]}, r"options\.motion\.joint7: unknown joint .*allowed: joint0, joint1, joint2"),
        ([TURNS[0], None], r"must hold one entry a joint, 3"),
        ([None, None, None], r"must prescribe at least one joint"),
    ],
)
def test_wrong_motions_are_refused(motion: Any, words: str) -> None:
    env = gym.make("SpatialFlexArm-v0", **COARSE)
    refuses(words, lambda: env.reset(options={"motion": motion}))


def test_what_does_not_go_with_a_motion_is_refused() -> None:
    env = gym.make("SpatialFlexArm-v0", **COARSE)
    refuses(r"options\.start\[0\] = 0.4: must be where the motion", lambda: env.reset(options={
        "motion": {"joint0": TURNS[0]}, "start": (0.4, 0.0, 0.0)}))  # fmt: skip
    scene = fx.Scene("s", arms.named("turret_boom"), duration=1.0, dt=0.01)
    refuses(r"options\.motion = 's': must be a scene of this", lambda: env.reset(options={"motion": scene}))
