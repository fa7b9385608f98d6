"""Arms in space in batches and environments."""

import dataclasses
import itertools
import math
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import flexarm_env as fx
from flexarm_env import arms, control
from flexarm_env.physics.space.reading import links
from flexarm_env.rigid import frames, rate_scale, weight_and_inertia
from flexarm_env.rotations import matrices, of_quaternions, vectors
from tests import space_answers as answers
from tests.env_tools import assert_pair_same, pair
from tests.refusals import refuses, says

ARM = arms.named("three_dof")
COARSE: dict[str, Any] = {"elements": 1, "dt": 0.005}
FRAMES: dict[str, Any] = {"formulation": "floating_frame", "segments": 1}
MODES: dict[str, Any] = {"formulation": "floating_frame", "modes": 3}


def test_poses_are_those_of_recorded_coordinates() -> None:
    """Kernel beside what trajectories are read with; rates beside differences."""
    env = gym.make_vec("SpatialFlexArm-v0", num_envs=3, **COARSE)
    env.reset(seed=3)
    for _ in range(5):
        env.step(np.array([(0.05, -0.1, 0.2)] * 3, np.float32))
    many, settings = env.unwrapped.batch, env.unwrapped.plan.settings
    q, v = many.motions()[:2]
    eps = 1e-6
    for i in range(3):
        view, motions = many.view(i), list(links(ARM, settings, q[i : i + 1], v[i : i + 1]))
        for pose, motion in zip(view.poses, motions, strict=True):
            root, tip = motion.root, motion.tip
            inner = root.A[0].T @ (tip.r - root.r)[0]
            slip = root.A[0].T @ ((tip.v - root.v)[0] - np.cross(root.w[0], (tip.r - root.r)[0]))
            assert pose[2:4] == pytest.approx(inner[1:], abs=1e-12)
            assert pose[4:6] == pytest.approx(slip[1:], abs=1e-10)
            assert pose[8:11] == pytest.approx(tip.r[0], abs=1e-12)
            assert pose[11:14] == pytest.approx(tip.v[0], abs=1e-10)
            assert pose[14:23].reshape(3, 3) == pytest.approx(root.A[0], abs=1e-12)
            twists = [
                vectors((matrices(t * root.w[0]) @ root.A[0]).T @ matrices(t * tip.w[0]) @ tip.A[0])[0]
                for t in (-eps, 0.0, eps)
            ]
            assert pose[6] == pytest.approx(twists[1], abs=1e-12)
            assert pose[7] == pytest.approx((twists[2] - twists[0]) / (2.0 * eps), abs=1e-8)
        assert view.points[-1] == pytest.approx(motions[-1].tip.r[0])


# ------------------------------------------------------------------ initial vibration
ALL = ("kinetic", "strain", "dissipated")


def vibrating(amplitude: Any, start: Any, periods: int, **options: Any) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Energies by `ALL` (periods + 1, 3), and what else info tells of an arm without weight that is left alone."""
    common = {"gravity": (0.0, 0.0, 0.0), "info_level": "full", "initial_vibration": 0.05, "duration": 100.0}
    env = gym.make("SpatialFlexArm-v0", **common | options)
    infos = [env.reset(seed=0, options={"start": start, "vibration": amplitude})[1]]
    n, angles = len(start), [start]
    for _ in range(periods):
        seen, *_, info = env.step(np.zeros(n, np.float32))
        infos.append(info)
        angles.append(np.arctan2(seen[: 2 * n : 2], seen[1 : 2 * n : 2]))
    energies = np.array([[info[f"energy_{name}"] for name in ALL] for info in infos])
    told = {name: np.array([info[name] for info in infos]) for name in ("tip_deflection", "twist")}
    return energies, told | {"angles": np.array(angles)}


def test_an_episode_begins_with_the_vibration_that_reset_requests() -> None:
    env = gym.make("SpatialFlexArm-v0", initial_vibration=0.05, info_level="full")
    energies = []
    for amplitude in ((0.0, 0.0, 0.0), (0.02, 0.0, 0.0), (0.04, 0.0, 0.0), (0.0, 0.04, 0.0), (0.0, 0.0, 0.04)):
        info = env.reset(seed=1, options={"vibration": amplitude})[1]
        energies.append(info["energy_kinetic"])
    assert energies[0] == pytest.approx(0.0, abs=1e-12) and energies[1] > 1e-5
    assert energies[2:] == pytest.approx(4.0 * np.full(3, energies[1]), rel=1e-9)


@pytest.mark.slow
def test_initial_vibrations_are_those_of_a_uniform_rod() -> None:
    """A slender rod on a hinge about z, by Bernoulli's beam and Saint-Venant's shaft. Bending along z, which the hinge
    holds, is the softest: k L = 1.8751, and x^2 L^2 m w^2 L / 8 is what it has where the tip deflects by x L; along y
    k L = 3.9266, the deflection being measured from the link's root, which turns."""
    length, m, EI, GJ, J = 0.8, 0.5, 2.0, 0.3, 1e-5
    section = fx.Section(EI=EI, EA=1e5, C=1e5, m=m, J=J, EI_y=EI, C_y=1e5, J_y=J, GJ=GJ)
    arm = fx.Arm(
        "rod", (fx.Link(length, section),), hub_mount=((1.0, 2.0, 0.0), 0.7), torque_limits=(1.0,), tau_d=1e-12
    )  # fmt: skip
    waves = 1.875104 / length, 3.926602 / length, 0.5 * math.pi / length
    along_z, along_y = (k**2 * math.sqrt(EI / m) for k in waves[:2])
    torsion = waves[2] * math.sqrt(GJ / (2.0 * J))
    x, k = 0.02, waves[1]
    energy = x**2 * length**2 * m * along_z**2 * length / 8.0
    turn = 0.5 * k * (1.0 / math.sin(k * length) + 1.0 / math.sinh(k * length))
    seen = abs(1.0 - turn * length) * math.sqrt(8.0 * energy / (m * length)) / along_y / length
    twist = math.sqrt(4.0 * energy / (2.0 * J * length)) / torsion
    peaks = (seen, along_y), (x, along_z), (twist, torsion)
    for kind, (peak, omega) in enumerate(peaks):
        period = 2.0 * math.pi / omega / 40.0
        energies, moved = vibrating(
            x * np.eye(3)[kind], [0.4], 60, arm=arm, elements=8, control_dt=period, dt=period / 2.0, tolerance=1e-10
        )
        values = np.hstack([moved["tip_deflection"], moved["twist"]])
        assert energies[0] == pytest.approx([energy, 0.0, 0.0], rel=2e-3, abs=1e-15)
        assert energies[:, 1].max() == pytest.approx(energy, rel=0.01)
        assert energies.sum(axis=1) == pytest.approx(energy, rel=3e-3)
        assert values[:20, kind].max() == pytest.approx(peak, rel=0.01)  # to the positive side first
        assert values[41:, kind].max() == pytest.approx(peak, rel=0.02) and abs(values[40, kind]) < 0.02 * peak
        assert np.abs(np.delete(values, kind, axis=1)).max() < 0.02 * peak


@pytest.mark.slow
@pytest.mark.parametrize("settings", [{"elements": 1}, FRAMES, MODES], ids=["exact", "frames", "modes"])
@pytest.mark.parametrize("start", [(0.0, 0.0, 0.0), (0.4, 0.9, -1.2)])
def test_initial_vibrations_have_their_energy_and_swing_no_joint(start: Any, settings: dict[str, Any]) -> None:
    """At any joint angles, of drawn payloads and gears; what is put in is what the books have from then on, and joints
    begin without momentum, so that they go to and fro."""
    payload, gear = fx.Payload(0.2, 1e-3, (0.0, 0.05, 0.02)), fx.Joint(100.0, 0.01, 1e-3, 5.0)
    laden = dataclasses.replace(ARM, payload=payload, joints=(gear,) * 3, tau_d=1e-4)
    options = {"arm": laden, **settings, "dt": 2.5e-4, "randomization": {"payload": (2.0, 2.0)}}
    one = [vibrating(a * np.eye(3)[0], start, 0, **options)[0][0, 0] for a in (0.01, 0.02)]
    assert one[1] == pytest.approx(4.0 * one[0], rel=1e-12)
    amplitude = np.array([0.02, -0.01, 0.015])
    energies, moved = vibrating(amplitude, start, 60, **options)
    assert energies[0] == pytest.approx([one[1] * (amplitude**2).sum() / 0.02**2, 0.0, 0.0], rel=1e-9, abs=1e-15)
    assert energies.sum(axis=1) == pytest.approx(energies[0, 0], rel=0.01)
    assert np.abs(moved["twist"]).max() > 0.02 and np.abs(moved["tip_deflection"]).max() > 0.008
    assert np.abs(moved["angles"] - start).max() < 0.08  # that energy would turn the rigid arm's joints by 0.6 and more
    assert energies[:, 1].max() > 0.5 * energies[0, 0]


@pytest.mark.slow
def test_initial_vibrations_are_drawn_alike_in_lanes() -> None:
    options: dict[str, Any] = {**COARSE, "initial_vibration": 0.1, "info_level": "full"}
    many = gym.make_vec("SpatialFlexArm-v0", num_envs=5, **options)
    seen, infos = many.reset(seed=3)
    again, _ = many.reset(seed=3, options={"vibration": (0.0, 0.0, 0.0)})
    assert not np.array_equal(seen, again) and len(set(infos["energy_kinetic"])) == 5
    many.reset(seed=3)
    for i in range(5):
        one = gym.make("SpatialFlexArm-v0", **options)
        alone, info = one.reset(seed=3 + i)
        assert np.array_equal(alone, seen[i]) and info["energy_kinetic"] == infos["energy_kinetic"][i]
        assert np.array_equal(one.step(np.zeros(3, np.float32))[0], one.unwrapped.batch.observation[0])


# ------------------------------------------------------------------ the environment
@pytest.mark.parametrize(
    "settings",
    [{"elements": 1}, *(pytest.param(one, marks=pytest.mark.slow) for one in (FRAMES, MODES))],
    ids=["exact", "frames", "modes"],
)
def test_every_entry_is_that_of_a_scene_run_beside(settings: dict[str, Any]) -> None:
    """Torques held for 50 ms in fine steps; rates by differences of what is recorded."""
    env = gym.make("SpatialFlexArm-v0", **settings, dt=2e-4, tolerance=1e-9)
    start, action, target = (0.2, 0.7, -0.4), np.array([0.1, -0.3, 0.2], np.float32), np.array([0.5, 0.3, 0.6])
    env.reset(seed=0, options={"start": start, "target": target})
    for _ in range(5):
        seen, *_, info = env.step(action)
    run = answers.beside(env, action, start, 0.0502)
    at = len(run.t) - 2
    assert run.t[at] == pytest.approx(0.05)
    L, w = ARM.total_length, [rate_scale(ARM, k) for k in range(3)]
    bend, twist = run.tip_deflection, run.twist
    slope = lambda x: (x[at + 1] - x[at - 1]) / 4e-4  # noqa: E731
    expected = [f(run.joint_angles[at, k]) for k in range(3) for f in (math.sin, math.cos)]
    expected += [run.joint_rates[at, k] / w[k] for k in range(3)]
    for k in (1, 2):
        expected += [*(bend[at, k] / 0.1), *(slope(bend[:, k]) / (0.3 * w[0]))]
        expected += [twist[at, k] / 0.1, slope(twist[:, k]) / (0.3 * w[0])]
    root = matrices(of_quaternions(run.link_rotations[at, 0, 0]))
    expected += [*(root.T @ run.tip_velocity[at, :3] / (w[0] * L)), *(root.T @ (target - run.tip[at]) / (0.5 * L))]
    assert len(seen) == len(expected) == 27
    assert seen == pytest.approx(np.array(expected), abs=2e-3)
    assert info["target"] == pytest.approx(target, abs=1e-9)
    assert info["tip_position"] == pytest.approx(run.tip[at], abs=1e-4)
    assert info["tip_deflection"] == pytest.approx(bend[at].T.ravel(), abs=1e-4)
    assert info["twist"] == pytest.approx(twist[at], abs=1e-4)
    assert info["joint_torque"] == pytest.approx(np.array(ARM.torque_limits) * action)


@pytest.mark.parametrize("more", [{}, {"task": "track", "action_mode": "residual_pd"}], ids=["reach", "track"])
def test_a_vector_is_single_environments_to_the_bit_and_states_go_between(more: dict[str, Any]) -> None:
    """A whole group of lanes and a part of one; the arms' own states too."""
    sync, native = both = pair("SpatialFlexArm-v0", 11, **COARSE, **more)
    assert_pair_same(both, 4, scale=1.0, passed=3)
    for i, one in enumerate(sync.envs):
        pairs = zip(one.unwrapped.batch.motions(), native.unwrapped.batch.motions(), strict=True)
        assert all(np.array_equal(a[0], b[i]) for a, b in pairs)


def test_gymnasium_checks_it_and_bad_actions_end_an_episode() -> None:
    env = gym.make("SpatialFlexArm-v0", **COARSE).unwrapped
    check_env(env)
    env.reset(seed=0)
    _, _, terminated, _, info = env.step(np.array([np.nan, 0.0, 0.0], np.float32))
    assert terminated and info["termination_reason"] == "action_not_finite" and info["reward_failure"] < -5.0
    huge, full = (gym.make("SpatialFlexArm-v0", **COARSE) for _ in range(2))
    for one in (huge, full):
        one.reset(seed=3)
    pairs = zip(huge.step(np.full(3, 1e30)), full.step(np.ones(3, np.float32)), strict=True)
    assert all(np.array_equal(a, b) for a, b in list(pairs)[:2])


@pytest.mark.slow
@pytest.mark.parametrize(("settings", "most"), [({"elements": 1, "dt": 5e-4, "tolerance": 1e-7}, 0.01), ({}, 0.1)])
def test_full_torques_stay_sound(settings: dict[str, Any], most: float) -> None:
    """Bang-bang: no episode fails, energy keeps its books, and Newton's method takes few iterations."""
    env: Any = gym.make_vec("SpatialFlexArm-v0", num_envs=8, info_level="full", **settings)
    _, start = env.reset(seed=0)
    rng, before, turned_over = np.random.default_rng(0), 0.0, np.zeros(8)
    for _ in range(30):
        seen, _, terminated, _, info = env.step(np.sign(rng.uniform(-1.0, 1.0, (8, 3))).astype(np.float32))
        assert not terminated.any() and np.isfinite(seen).all()
        before, turned_over = info["work"], turned_over + np.abs(info["work"] - before)
    names = ("energy_kinetic", "energy_strain", "energy_gravity", "energy_dissipated")
    off = sum(info[name] - start[name] for name in names) - info["work"]
    assert np.abs(off / turned_over).max() < most
    iterations, _, _, steps = env.unwrapped.batch.counts.sum(0)
    assert iterations < 5.0 * steps


def test_features_carry_over() -> None:
    """Chosen entries with history, noise and delay, motors with lag, drawn arms, controllers under the action, pushes
    and a payload that changes."""
    laden = dataclasses.replace(ARM, payload=fx.Payload(0.1, 1e-3))
    env = gym.make_vec(
        "SpatialFlexArm-v0", num_envs=3, arm=laden, payload_change={"time": (0.02, 0.02), "factor": (3.0, 3.0)},
        pushes={"wait": (0.01, 0.01), "force": (0.2, 0.2), "lasting": 0.1},
        observation=["hub_error", "elbow_2_error", "target_z", "hub_rate"], history=2,
        sensors={"encoders": {"counts": 4096}, "noise": 0.001, "delay": 0.01},
        actuator={"lag": 0.01, "saturation": 0.9},
        randomization={"payload": (0.5, 2.0), "EI": (0.8, 1.2), "damping": (0.5, 2.0), "torque_constant": (0.9, 1.1),
                       "payload_inertia": (2.0, 2.0)},
        cost={"deflection": (1.0, 0.05, 0.05)}, action_mode="residual_pd",
        starts={"straight": 0.0, "target": [(0.1, 0.2), (0.3, 0.4), (0.5, 0.6)]}, **COARSE,
    )  # fmt: skip
    seen, info = env.reset(seed=0)
    assert seen.shape == (3, 8)
    total, costs = np.zeros(3), []
    for _ in range(3):
        seen, *_, info = env.step(np.zeros((3, 3), np.float32))
        y, z = np.split(info["tip_deflection"], 2, axis=1)
        past = (np.hypot(y, z) > (1.0, 0.05, 0.05)).any(axis=1)
        assert np.array_equal(info["cost"], past)
        total, costs = total + past, [*costs, *past]
        assert np.array_equal(info["episode_cost"], total)
    assert {True, False} <= set(costs)
    goals = env.unwrapped.batch.record(0)[-100:]
    assert np.isfinite(seen).all() and np.isfinite(goals).all()
    assert (np.abs(info["joint_torque"]) > 0.0).all()  # the controllers', who pull towards the goal
    assert info["payload_mass"] == pytest.approx([0.3] * 3) and info["push"].shape == (3, 3)
    assert np.linalg.norm(info["push"], axis=1) == pytest.approx([0.2] * 3)


@pytest.mark.slow
def test_strains_of_both_bendings_cost_beyond_a_limit() -> None:
    """Told by gauges at the stations; strips of 50 mm by 2 mm."""
    spots = [(k, place, what) for k in (1, 2) for place in (0.0, 0.25, 0.5, 0.75) for what in ("xy", "xz")]
    gauges = [{"link": k, "place": place, "measures": what} for k, place, what in spots]
    names = [f"strain_gauge_{k + 1}" for k in range(len(gauges))]
    half = {"xy": 0.001, "xz": 0.025} if ARM.links[1].section.J < 1e-4 else {"xy": 0.025, "xz": 0.001}
    limits, strains = [1.0], list[float]()
    for limit in limits:  # beyond none; then between those that there were
        env: Any = gym.make(
            "SpatialFlexArm-v0", observation=names, sensors={"strain_gauges": gauges}, cost={"strain": limit}, **COARSE
        )
        env.reset(seed=1, options={"start": (0.2, 0.7, -0.4)})
        scales, total = np.array(env.unwrapped.plan.scales), 0.0
        for k in range(40):
            read, *_, info = env.step(np.array([math.sin(k / 3), 0.3 * math.cos(k / 5), 0.1], np.float32))
            bent = np.abs(read * scales) * [half[what] for *_, what in spots]
            strain = float(bent.reshape(-1, 2).sum(axis=1).max())
            assert info["cost"] == float(strain > limit), k
            total += info["cost"]
            assert info["episode_cost"] == total
            if limit == 1.0:
                strains.append(strain)
        if limit == 1.0:
            assert total == 0.0
            limits += [0.5 * (one + other) for one, other in itertools.pairwise(sorted(strains)[10:31:10])]
        else:
            assert 0.0 < total < 40.0


@pytest.mark.slow
def test_strain_at_rest_is_that_of_the_weight() -> None:
    """The moments at the roots of the strips are the torques that hold the joints: M h / (2 EI)."""
    section, costs, strain = ARM.links[1].section, [], 1.0
    for share in (1.0, 0.8, 1.2):
        env: Any = gym.make("SpatialFlexArm-v0", cost={"strain": share * strain})
        controller = control.make("pd", env)
        seen, _ = env.reset(seed=0, options={"target": (0.6, 0.2, 0.4)})
        controller.reset(seen)
        for _ in range(400):
            seen, *_, info = env.step(controller.act(seen))
        costs.append(info["cost"])
        strain = float(np.abs(info["joint_torque"][1:]).max() * 0.001 / min(section.EI, section.EI_y))
    assert costs == [0.0, 1.0, 0.0]


@pytest.mark.slow
def test_drawn_stiffnesses() -> None:
    """EI is on both bendings, EI_y and GJ each on their own besides; what else is drawn stays; in the plane refused."""
    both: dict[str, Any] = {"EI": (0.5, 1.5), "GJ": (1.0, 1.0)}
    drawn = []
    for more in ({}, {"EI_y": (0.8, 1.2), "GJ": (0.5, 2.0)}):
        env = gym.make_vec("SpatialFlexArm-v0", num_envs=9, randomization=both | more, info_level="numbers", **COARSE)
        _, info = env.reset(seed=4)
        EI, EI_y, GJ = (info.get(f"drawn_{name}", np.ones(9)) for name in ("EI", "EI_y", "GJ"))
        own = np.array([env.unwrapped.batch.parameters(i) for i in range(9)])
        assert own.shape == (9, 6) and np.array_equal(own[:, [2, 4, 5]].T, [EI, EI * EI_y, GJ])
        drawn.append((EI, EI_y, GJ))
    assert np.array_equal(drawn[0][0], drawn[1][0]) and (drawn[0][1] == 1.0).all() and (drawn[0][2] == 1.0).all()
    assert len({*drawn[1][1], *drawn[1][2]}) == 18
    refuses(r"randomization\.GJ", lambda: gym.make("FlexibleArm-v0", randomization={"GJ": (0.5, 2.0)}))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"motion": "spin_up"}, "motion = 'spin_up': must be given with task=\"replay\" only"),
        ({"cost": {"strain": 0.0}}, "cost.strain = 0.0: must be a positive number"),
        ({"cost": {"deflection": (0.1, 0.1)}}, "cost.deflection = (0.1, 0.1): must be a sequence of 3"),
        ({"payload_change": {"time": (1, 2), "factor": (1, 2)}}, "arm.payload.mass = 0.0: must be positive"),
        ({"initial_vibration": 0.6}, "initial_vibration = 0.6"),
        ({"keep_out": [{"shape": "sphere", "center": (0, 0), "radius": 1}]}, "must be in space"),
        ({"action_mode": "voltage"}, "arm.joints[0].motor: missing"),
        ({"sensors": {"strain_gauges": [0.0]}}, "strain_gauges[0].link = 0: must be a flexible link"),
        ({"randomization": {"friction": (0.5, 2.0)}}, "randomization.friction"),
        ({"randomization": {"GJ": (0.0, 1.0)}}, "randomization.GJ[0] = 0.0: must be a positive number"),
        ({"randomization": {"EI_y": (1.0, 1e15)}}, "randomization.EI_y[1] = 1000000000000000.0: must be at most"),
        ({"arm": "three_strips"}, "arm = 'three_strips': must leave the x-y plane"),
        ({"gravity": (0.0, -9.81)}, "gravity"),
    ],
)
def test_what_is_not_there_is_refused_by_name(arguments: dict[str, Any], words: str) -> None:
    says(words, lambda: gym.make("SpatialFlexArm-v0", **arguments))


def test_weight_and_inertia_of_the_rigid_arm() -> None:
    """Torques that hold it beside the slope of the masses' heights; the straight strips' inertia about the elbow."""
    gravity, angles, eps = np.array([0.0, 0.0, -9.81]), np.array([[0.3, 0.7, -0.5]]), 1e-6

    def height(at: np.ndarray) -> float:
        places, _, _, tip = frames(ARM, at)
        middle = 0.5 * (places[0, 2] + tip[0])
        return 9.81 * 0.3935 * float(0.5 * (places[0, 1] + places[0, 2])[2] + middle[2])

    torques, inertia = weight_and_inertia(ARM, gravity, angles)
    for k in range(3):
        step = eps * np.eye(3)[k]
        assert torques[0, k] == pytest.approx((height(angles + step) - height(angles - step)) / (2 * eps), abs=1e-6)
    assert inertia[0, 2, 2] == pytest.approx(0.3935 * (0.5**2 / 3.0 + 0.002**2 / 12.0), rel=1e-9)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"target": (2.0, 0.0, 0.0)}, "options.target = (2.0, 0.0, 0.0): must be a point"),
        ({"target": (0.5, 0.5)}, "options.target"),
        ({"vibration": 0.1}, "options.vibration = 0.1: must be a sequence of three"),
        ({"vibration": (0.0, 0.6, 0.0)}, "options.vibration[1] = 0.6"),
        ({"vibration": (0.0, 0.1, 0.0)}, "options.vibration = (0.0, 0.1, 0.0): must be 0 in an environment without"),
        ({"motion": "flying_rod"}, "options.motion"),
    ],
)
def test_wrong_options_are_refused(options: dict[str, Any], words: str) -> None:
    env = gym.make("SpatialFlexArm-v0", **COARSE)
    says(words, lambda: env.reset(options=options))


@pytest.mark.slow
@pytest.mark.parametrize("settings", [FRAMES, {**MODES, "modes": 2}], ids=["frames", "modes"])
def test_frames_follow_the_exact_beam_under_a_quarter_of_the_torques(settings: dict[str, Any]) -> None:
    """The tip is within 0.5 % of the reach for 0.2 s."""
    both = [gym.make_vec("SpatialFlexArm-v0", num_envs=8, **one) for one in (settings, {"elements": 4, "dt": 1e-3})]
    rng = np.random.default_rng(5)
    for env in both:
        env.reset(seed=1)
    for _ in range(20):
        action = rng.uniform(-0.25, 0.25, (8, 3)).astype(np.float32)
        one, other = (env.step(action)[-1]["tip_position"] for env in both)
        assert np.linalg.norm(one - other, axis=1).max() < 0.005 * ARM.total_length
