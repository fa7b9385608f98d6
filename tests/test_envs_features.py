"""Sensors, motors, controllers, moving targets, randomised arms: each against what it is meant to be."""

import dataclasses
import math
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from flexarm_env import arms
from flexarm_env.physics.joints.layout import LAWS
from flexarm_env.tasks.program import GOAL
from tests.env_tools import ONE, TWO, assert_same, rich, turned
from tests.refusals import refuses


def make(**changes: Any) -> Any:
    """FlexibleArm-v0 with everything, all of it ideal but for the changes. The target moves."""
    return gym.make(ONE, **rich(ONE, **changes))


def run(env: Any, actions: np.ndarray, seed: int = 0, **options: Any) -> list[Any]:
    """Outcomes of given actions (n, joints)."""
    env.reset(seed=seed, options=options or None)
    return [env.step(a.astype(np.float32)) for a in actions]


def column(outcomes: list[Any], key: str) -> np.ndarray:
    return np.array([o[-1][key] for o in outcomes])


START = {"start": 0.2}


# ---------------------------------------------------------------------------------------- controllers
@pytest.mark.parametrize("share", [0.7, 2.0])
def test_residual_pd_is_the_documented_controller(share: float) -> None:
    """Both joints, towards a target that moves."""
    env = gym.make(TWO, **rich(TWO, **({} if share == 0.7 else {"residual_share": share})))
    plan = env.unwrapped.plan
    limits = np.array([1.0, 0.3])
    stiffness = limits / (math.pi / 4)
    damping = 2.0 * np.sqrt(stiffness * np.array([straight_inertia(plan.arm, k) for k in range(2)]))
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    for _ in range(60):
        view = env.unwrapped.batch.view(0)
        hub, elbow = view.poses[0], view.poses[1]
        angles = np.array([hub[2], elbow[2] - hub[8]])
        rates = np.array([hub[5], elbow[5] - hub[11]])
        action = rng.uniform(-1, 1, 2).astype(np.float32)
        torques = stiffness * (reaching(view.target, angles) - angles) - damping * rates + share * limits * action
        info = env.step(action)[-1]
        np.testing.assert_allclose(info["joint_torque"], np.clip(torques, -limits, limits), atol=1e-9)
        assert info["hub_torque"] == info["joint_torque"][0]


def straight_inertia(arm: Any, joint: int) -> float:
    """Of the straight arm from a joint on, by its definition: sum of dm r^2."""
    x = np.linspace(0.0, 0.5, 20001)
    total, at = (arm.hub_inertia if joint == 0 else arm.elbows[0].inertia_right), 0.0
    for k in range(joint, 2):
        if k > joint:
            total += arm.elbows[0].mass * at**2 + arm.elbows[0].inertia_left + arm.elbows[0].inertia_right
        total += arm.links[k].section.m * np.trapezoid((x + at) ** 2, x) + arm.links[k].section.J * 0.5
        at += 0.5
    return float(total + arm.payload.mass * at**2 + arm.payload.inertia)


def reaching(target: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Joint angles of the rigid arm with links of 0.5 m that reach a target: of both solutions the one that is nearer
    (here: in the elbow's angle)."""
    distance = np.hypot(*target)
    elbow = 2.0 * math.acos(min(1.0, distance))
    options = []
    for side in (elbow, -elbow):
        hub = math.atan2(target[1], target[0]) - 0.5 * side
        options.append(np.array([hub - 2 * math.pi * round((hub - near[0]) / (2 * math.pi)), side]))
    return min(options, key=lambda o: abs(o[1] - near[1]))


def test_residual_pd_aims_at_the_posture_sooner_reached() -> None:
    """Of both solutions of the inverse kinematics, at the start of an episode."""
    env = gym.make(TWO, **rich(TWO))
    plan = env.unwrapped.plan
    inertia = np.array([straight_inertia(plan.arm, k) for k in range(2)])
    sides = set()
    for start in ([0.0, 0.0], [0.3, 0.4], [-0.3, -0.4], [0.0, 1.5], [0.0, -1.5]):
        for seed in range(8):
            env.reset(seed=seed, options={"start": start})
            target = env.unwrapped.batch.view(0).target
            elbow = 2.0 * math.acos(min(1.0, np.hypot(*target)))
            times = []
            for side in (elbow, -elbow):
                hub = math.atan2(target[1], target[0]) - 0.5 * side
                ways = np.abs([(hub - start[0] + math.pi) % (2 * math.pi) - math.pi, side - start[1]])
                times.append((np.max(np.sqrt(inertia * ways / np.array([1.0, 0.3]))), side))
            goal = env.unwrapped.batch.record(0)[GOAL + 1]
            assert goal == pytest.approx(min(times)[1], abs=1e-9), (start, seed)
            sides.add((np.sign(start[1]), np.sign(goal)))
    assert {(0.0, 1.0), (0.0, -1.0)} <= sides


# ---------------------------------------------------------------------------------------- motors
def test_an_ideal_actuator_is_no_actuator() -> None:
    env = gym.make(ONE, actuator={"lag": 0.0, "delay": 0.0, "viscous": 0.0})
    assert env.unwrapped.plan.extras.actuator is None


def test_lag_is_first_order() -> None:
    lag, period = 0.03, 0.02
    env = make(actuator={"lag": lag})
    torques = column(run(env, np.ones((20, 1)), **START), "hub_torque")
    t = period * np.arange(1, 21)
    np.testing.assert_allclose(torques, 2.0 * (1.0 - np.exp(-t / lag)), rtol=1e-12)


@pytest.mark.parametrize("delay", [0.04, 0.0225, 0.0025])
def test_delay_holds_commands_back(delay: float) -> None:
    """Under a lag the torque at the period's end tells how long the command has been there."""
    env = make(actuator={"delay": delay, "lag": 0.05}, dt=0.0025)
    actions = np.zeros((8, 1))
    actions[2:] = 1.0
    torques = column(run(env, actions, **START), "hub_torque")
    t = 0.02 * np.arange(1, 9) - 0.04 - delay
    np.testing.assert_allclose(torques, 2.0 * (1.0 - np.exp(-np.maximum(t, 0.0) / 0.05)), rtol=1e-9, atol=1e-15)


@pytest.mark.slow
def test_jitter_draws_how_late_each_command_comes() -> None:
    """Commands that alternate under a lag tell at each period's end how long the last one has been there."""
    dt, lag, most, n = 0.0025, 0.05, 24, 8
    env = make(actuator={"delay": 2 * dt, "jitter": most * dt, "lag": lag}, dt=dt, duration=20.0)
    actions = np.random.default_rng(1).uniform(-1.0, 1.0, (400, 1))
    torques = column(run(env, actions, **START), "hub_torque")
    asked, share, before, late = 2.0 * np.concatenate([np.zeros(9), actions[:, 0]]), 1.0 - np.exp(-dt / lag), 0.0, []
    for k, end in enumerate(torques):
        ends = []
        for steps in range(2, 2 + most + 1):
            torque = before
            for s in range(n):
                torque += (asked[9 + k - max(0, -(-(steps - s) // n))] - torque) * share
            ends.append(torque)
        before = end
        late.append(2 + int(np.argmin(np.abs(np.array(ends) - end))))
        assert min(np.abs(np.array(ends) - end)) < 1e-6
    counts = np.bincount(late[9:], minlength=27)
    assert set(np.flatnonzero(counts)) == set(range(2, 27)) and counts.max() < 40  # 16 expected of each
    keywords = rich(ONE, actuator={"delay": dt, "jitter": 4 * dt, "lag": lag}, dt=dt)
    vector, single = gym.make_vec(ONE, num_envs=9, threads=1, **keywords), gym.make(ONE, **keywords)
    vector.reset(seed=3), single.reset(seed=7)
    for a in actions[:20]:
        many, one = vector.step(np.tile(a, (9, 1)).astype(np.float32)), single.step(a.astype(np.float32))
        np.testing.assert_array_equal(many[0][4], one[0])


SPACE = "SpatialFlexArm-v0"
FRAMES: dict[str, Any] = {"formulation": "floating_frame"}
BEAMS: list[tuple[str, dict[str, Any]]] = [
    (ONE, {}), (ONE, {"formulation": "geometrically_exact"}), (ONE, FRAMES), (ONE, FRAMES | {"multipliers": True}),
    (ONE, FRAMES | {"modes": 2, "dt": 0.0025}), (SPACE, {}), (SPACE, FRAMES), (SPACE, FRAMES | {"modes": 2}),
]  # fmt: skip


def lateness(env_id: str, **keywords: Any) -> tuple[float, float]:
    """When a torque of five periods took effect, s, by a line through a stiff arm's angles once it is gone: these are
    the rate times the time since its middle. And the delay, s, where info tells one."""
    stiff: dict[str, Any] = {"EI": (100.0, 100.0)}
    if env_id == SPACE:
        stiff, keywords = stiff | {"GJ": (100.0, 100.0)}, {"gravity": (0.0, 0.0, 0.0)} | keywords
    env: Any = gym.make(env_id, randomization=stiff, duration=5.0, **keywords)
    joints, period = env.action_space.shape[0], env.unwrapped.dt
    pulse = np.outer(np.arange(60) < 5, np.eye(joints)[0] * (0.05 if env_id == SPACE else 0.5))
    outcomes = run(env, pulse, start=0.0 if joints == 1 else [0.0] * joints)
    angles = np.unwrap([math.atan2(float(o[0][0]), float(o[0][1])) for o in outcomes[30:]])
    rate, at = np.polyfit(period * np.arange(31, 61), angles, 1)
    return float(-at / rate), float(outcomes[-1][-1].get("drawn_command_delay", 0.0))


@pytest.mark.parametrize(
    ("env_id", "keywords"), [BEAMS[0], *(pytest.param(*each, marks=pytest.mark.slow) for each in BEAMS[1:])]
)
def test_motors_are_as_late_as_they_are_said_to_be(env_id: str, keywords: dict[str, Any]) -> None:
    """Delays that end within a control period too, those that are drawn, and lags; momentum tells, whatever the solver
    does with torques."""
    plan = gym.make(env_id, **keywords).unwrapped.plan
    (at_once, _), dt = lateness(env_id, **keywords), plan.settings.dt
    for steps in (1, 2, round(plan.period / dt) + 1):
        late, _ = lateness(env_id, actuator={"delay": steps * dt}, **keywords)
        assert late - at_once == pytest.approx(steps * dt, abs=0.01 * dt)
    late, told = lateness(env_id, actuator={"delay": (dt, 9 * dt)}, **keywords)
    assert told > 0.0 and late - at_once == pytest.approx(told, abs=0.01 * dt)
    late, _ = lateness(env_id, actuator={"lag": 0.02}, **keywords)
    assert late - at_once == pytest.approx(0.02, abs=0.01 * dt)


@pytest.mark.slow
@pytest.mark.parametrize("given", [{"delay": 0.02 / 3}, {"jitter": 0.04 / 3}, {"lag": 0.02}])
def test_books_close_where_torques_change_within_a_period(given: dict[str, float]) -> None:
    env = gym.make_vec(ONE, num_envs=16, info_level="full", duration=10.0, actuator=given)
    info = env.reset(seed=5)[1]
    stored = ("energy_kinetic", "energy_strain", "energy_gravity", "energy_dissipated")
    rng, turned, begun, last = np.random.default_rng(1), 0.0, sum(info[name] for name in stored), info["work"]
    worst = np.zeros(16)
    for _ in range(20):
        action = rng.uniform(-1.0, 1.0, (16, 1)).astype(np.float32)
        for _ in range(5):
            info = env.step(action)[-1]
            turned, last = turned + abs(info["work"] - last), info["work"]
            worst = np.maximum(worst, abs(sum(info[name] for name in stored) - begun - last))
    assert np.median(worst / turned) < 2e-4  # were torques late by half a step, it would be 1e-2


def test_factors_that_are_drawn_are_told() -> None:
    strip = arms.named("strip")
    arm = dataclasses.replace(strip, payload=dataclasses.replace(strip.payload, inertia=0.01))
    ranges = {"payload": (0.5, 2.0), "torque_constant": (0.9, 1.1), "payload_inertia": (0.5, 1.5)}
    vector = gym.make_vec(ONE, num_envs=9, arm=arm, randomization=ranges, info_level="numbers")
    _, first = vector.reset(seed=0)
    _, _, _, _, info = vector.step(np.full((9, 1), 0.25, np.float32))
    for name, (low, high) in ranges.items():
        drawn = info[f"drawn_{name}"]
        np.testing.assert_array_equal(drawn, first[f"drawn_{name}"])
        assert ((low <= drawn) & (drawn <= high)).all() and len(set(drawn)) == 9
    np.testing.assert_allclose(info["hub_torque"], 0.5 * info["drawn_torque_constant"], rtol=1e-6)
    mass, inertia = vector.unwrapped.batch.parameters(4)[:2]
    assert mass == arm.payload.mass * info["drawn_payload"][4]
    assert inertia == pytest.approx(arm.payload.inertia * info["drawn_payload"][4] * info["drawn_payload_inertia"][4])
    assert "drawn_EI" not in info


def test_saturation_limits_the_motor() -> None:
    env = make(actuator={"saturation": 0.4})
    assert column(run(env, np.ones((3, 1)), **START), "hub_torque") == pytest.approx([0.8] * 3)


# ---------------------------------------------------------------------------------------- sensors
def test_noise_has_the_size_asked_for_and_follows_the_seed() -> None:
    env = make(sensors={"noise": {"tip_deflection": 0.002, "hub_rate": 0.1}}, duration=40.0)
    plain = make(duration=40.0)
    actions = np.zeros((2000, 1))
    noisy = np.array([o[0] for o in run(env, actions, **START)])
    clean = np.array([o[0] for o in run(plain, actions, **START)])
    scales = np.array(env.unwrapped.plan.scales)
    sizes = (noisy - clean).std(axis=0) * scales
    np.testing.assert_allclose(sizes[[2, 3]], [0.1, 0.002], rtol=0.1)
    assert np.all(sizes[[0, 1, 4, 5]] == 0.0)
    assert abs((noisy - clean)[:, 3].mean()) < 0.1 * (noisy - clean)[:, 3].std()
    assert_same(noisy, np.array([o[0] for o in run(env, actions, **START)]))
    assert not np.array_equal(noisy, np.array([o[0] for o in run(env, actions, seed=1, **START)]))
    assert env.observation_space.high[0] == 1.0 or env.observation_space.contains(noisy[0])


def test_sensor_delay_shows_the_past() -> None:
    plain, late = make(), make(sensors={"delay": 0.06})
    actions = np.random.default_rng(0).uniform(-1, 1, (20, 1))
    first = plain.reset(seed=0, options=START)[0]
    one, other = run(plain, actions, **START), run(late, actions, **START)
    for k in range(20):
        assert_same(other[k][0], one[k - 3][0] if k >= 3 else first)
        assert_same(other[k][-1], one[k][-1])


@pytest.mark.slow
@pytest.mark.parametrize(
    "options",
    [
        {"nodes": 6},
        {"formulation": "geometrically_exact", "elements": 6, "order": 3},
        {"formulation": "floating_frame", "segments": 8, "dt": 0.001},
        {"formulation": "floating_frame", "modes": 3},
    ],
    ids=["elastica", "exact", "segments", "modes"],
)
def test_strain_gauges_read_the_curvature(options: dict[str, Any]) -> None:
    """In free motion, compared with the elastica of eight nodes."""
    places = {"strain_gauges": [0.0, 0.3, 0.7]}
    actions = np.sin(np.arange(40)[:, None] * 0.3) * 0.3
    env = gym.make(ONE, sensors=places, **options)
    assert env.observation_space.shape == (9,)
    a = np.array([o[0][6:] for o in run(gym.make(ONE, nodes=8, sensors=places), actions, **START)])
    b = np.array([o[0][6:] for o in run(env, actions, **START)])
    size = np.abs(a).max(axis=0)
    places_good = slice(1, 3) if "segments" in options else slice(0, 3)  # at the root a segment's mean lags behind
    np.testing.assert_allclose((b / size)[:, places_good], (a / size)[:, places_good], atol=0.08)


def test_a_gauge_on_a_bent_cantilever() -> None:
    """At rest under gravity, sideways, the hub held by a motion: EI kappa = moment of the weight beyond the gauge."""
    g = 0.3
    env = make(gravity=(0.0, -g), duration=60.0, arm=with_damping(0.1))
    env.reset(seed=0, options={"motion": [[0.0, 0.0], [30.0, 0.0]], "interpolation": "linear"})
    for _ in range(1500):
        observation = env.step(np.zeros(1, np.float32))[0]
    arm = arms.named("strip")
    link, section = arm.links[0], arm.links[0].section
    moments = [-g * (section.m * (1 - s) ** 2 / 2 + arm.payload.mass * (1 - s)) * link.length for s in (0.0, 0.5)]
    scale = 2.0 / section.EI
    np.testing.assert_allclose(observation[-2:] * scale, np.array(moments) / section.EI, rtol=0.01)


def with_damping(tau_d: float) -> Any:
    return dataclasses.replace(arms.named("strip"), tau_d=tau_d)


# ---------------------------------------------------------------------------------------- moving targets
def test_a_drawn_path_starts_at_rest_where_the_arm_is() -> None:
    env = make()
    observation, info = env.reset(seed=0)
    assert observation.shape == (11,)
    assert observation[5] == pytest.approx(0.0, abs=1e-6)
    assert observation[6] == 0.0
    targets, ahead = [info["target"]], [observation[7:9]]
    for _ in range(100):
        observation, *_, info = env.step(np.zeros(1, np.float32))
        targets.append(info["target"])
        ahead.append(observation[7:9])
        rate = observation[6] * env.unwrapped.plan.scales[6]
        assert rate == pytest.approx((targets[-1] - targets[-2]) / 0.02, abs=0.05)
    for k in range(80):
        assert ahead[k][0] == pytest.approx(targets[k + 5] - targets[k], abs=1e-5)
        assert ahead[k][1] == pytest.approx(targets[k + 15] - targets[k], abs=1e-5)


def test_a_drawn_circle_stays_within_reach() -> None:
    env = gym.make(TWO, **rich(TWO))
    for seed in range(10):
        _, info = env.reset(seed=seed)
        places = [info["target"]] + [env.step(np.zeros(2, np.float32))[-1]["target"] for _ in range(60)]
        assert 0.3 <= np.hypot(*np.array(places).T).min() <= np.hypot(*np.array(places).T).max() <= 0.95
        steps = np.hypot(*np.diff(places, axis=0).T)
        np.testing.assert_allclose(steps, steps[0], rtol=1e-9)


def test_a_given_path_is_followed() -> None:
    t = np.linspace(0, 8, 81)
    table = np.column_stack([t, 0.5 + 0.1 * np.cos(t), 0.2 * np.sin(t)])
    env = gym.make(TWO, **rich(TWO, reference=table))
    observation, info = env.reset(seed=0)
    assert observation.shape == (22,)
    for k in range(1, 100):
        observation, *_, info = env.step(np.zeros(2, np.float32))
        wanted = (0.5 + 0.1 * math.cos(0.02 * k), 0.2 * math.sin(0.02 * k))
        np.testing.assert_allclose(info["target"], wanted, atol=1e-5)
        hub = math.atan2(observation[0], observation[1])
        speed = turned(hub, (-0.1 * math.sin(0.02 * k), 0.2 * math.cos(0.02 * k)))
        np.testing.assert_allclose(observation[14:16] * env.unwrapped.plan.scales[14], speed, atol=2e-4)
        ahead = (0.1 * math.cos(0.02 * k + 0.3) + 0.5 - wanted[0], 0.2 * math.sin(0.02 * k + 0.3) - wanted[1])
        np.testing.assert_allclose(observation[18:20] * 0.5, turned(hub, ahead), atol=2e-5)


def test_the_reward_of_a_moving_target_counts_its_rate() -> None:
    """The settle term: the tip's rate is taken from the target's."""
    env = make(reference=[[0.0, 0.2], [8.0, 4.2]])
    env.reset(seed=0, options=START)
    *_, info = env.step(np.zeros(1, np.float32))  # at rest, while the target leaves at 0.5 rad/s
    error = 0.5 * 0.02
    assert info["reward_settle"] == pytest.approx(math.exp(-((error / 0.02) ** 2) - (0.5 / 0.2) ** 2), rel=1e-6)


# ---------------------------------------------------------------------------------------- starts
def test_initial_vibration_has_the_amplitude_asked_for() -> None:
    env = gym.make(ONE, initial_vibration=0.05, arm=with_damping(1e-12))
    env.reset(seed=0, options={"start": 0.7, "vibration": 0.03})
    bends = column([env.step(np.zeros(1, np.float32)) for _ in range(150)], "tip_deflection")
    assert np.abs(bends).max() == pytest.approx(0.03, rel=0.03)
    crossings = np.flatnonzero(np.diff(np.sign(bends)) != 0)
    assert np.ptp(np.diff(crossings)) <= 1, "one frequency alone"
    sizes = []
    for seed in range(40):
        env.reset(seed=seed)
        sizes.append(np.abs(column([env.step(np.zeros(1, np.float32)) for _ in range(25)], "tip_deflection")).max())
    assert max(sizes) < 0.052
    assert max(sizes) > 0.04
    assert min(sizes) < 0.01


@pytest.mark.slow
@pytest.mark.parametrize("start", [(0.7, 0.0), (0.4, 1.2)])
def test_initial_vibration_is_the_same_under_every_formulation(start: tuple[float, float]) -> None:
    """At any hub and elbow: no link is stretched, whatever coordinates it has, so that energies are the elastica's."""
    found = []
    for options in (
        {}, {"formulation": "geometrically_exact"}, {"formulation": "geometrically_exact", "order": 1, "elements": 8},
        {"formulation": "floating_frame"}, {"formulation": "floating_frame", "multipliers": True},
    ):  # fmt: skip
        env = gym.make(TWO, initial_vibration=0.05, info_level="full", **options)
        infos = [env.reset(seed=0, options={"start": start, "vibration": 0.05})[1]]
        infos += [env.step(np.zeros(2, np.float32))[-1] for _ in range(4)]
        names = ("energy_kinetic", "energy_strain", "energy_dissipated")
        found.append(np.array([[info[name] for name in names] for info in infos]))
        assert found[-1].sum(axis=1) == pytest.approx(found[-1][0, 0], rel=2e-3)
    for one in found[1:]:
        assert one == pytest.approx(found[0], abs=0.01 * found[0].max())


def test_gravity_bends_a_hanging_arm() -> None:
    env = make(gravity=(0.0, -9.81))
    env.reset(seed=0, options={"start": 0.0})
    info = [env.step(np.zeros(1, np.float32)) for _ in range(10)][-1][-1]
    assert info["tip_position"][1] < -0.05
    assert info["energy_gravity"] < 0.0


FACTORS = {"friction": 1.6, "backlash": 0.5, "motor_inertia": 2.5, "payload_inertia": 3.0}


@pytest.mark.slow
@pytest.mark.parametrize("formulation", ["elastica", "floating_frame"])
@pytest.mark.parametrize("count", [1, 5])
def test_drawn_joints_and_inertia_are_those_of_an_arm_that_has_them(formulation: str, count: int) -> None:
    """Friction, play, rotor and payload of an arm of its own, and the same by factors: motion to rounding."""
    arm = arms.named("strip_geared")
    joints = [dataclasses.replace(joint, backlash=0.04, friction_viscous=0.02) for joint in arm.joints]
    payload = dataclasses.replace(arm.payload, inertia=2e-4)
    arm = dataclasses.replace(arm, joints=joints, payload=payload)
    other = dataclasses.replace(
        arm,
        payload=dataclasses.replace(payload, inertia=3.0 * payload.inertia),
        joints=[
            dataclasses.replace(
                joint, backlash=0.5 * joint.backlash, friction_viscous=1.6 * joint.friction_viscous,
                friction_coulomb=1.6 * joint.friction_coulomb, motor_inertia=2.5 * joint.motor_inertia,
            )
            for joint in joints
        ],
    )  # fmt: skip
    ranges = {name: (factor, factor) for name, factor in FACTORS.items()}
    rng = np.random.default_rng(0)
    actions = np.repeat(rng.uniform(-1.0, 1.0, (40, 1, 1)).astype(np.float32), count, axis=1)
    found = []
    for given in ({"arm": arm, "randomization": ranges}, {"arm": other}, {"arm": arm}):
        env = gym.make_vec(ONE, count, vectorization_mode="vector_entry_point", formulation=formulation, **given)
        env.reset(seed=3)
        found.append(np.array([env.step(action)[0] for action in actions]) * env.unwrapped.plan.scales)
        env.close()
    drawn, made, nominal = found
    np.testing.assert_allclose(drawn, made, atol=2e-6)  # in float32
    assert np.abs(drawn - nominal).max() > 0.02


def shaken(env: Any, steps: int = 30) -> Any:
    """What is seen of three arms under random torques, times its scales."""
    env.reset(seed=3)
    actions = np.random.default_rng(0).uniform(-0.5, 0.5, (steps, *env.action_space.shape)).astype(np.float32)
    seen = np.array([env.step(action)[0] for action in actions]) * env.unwrapped.plan.scales
    env.close()
    return seen


@pytest.mark.slow
@pytest.mark.parametrize(
    ("env_id", "keywords"),
    [
        (ONE, {"formulation": "geometrically_exact"}),
        ("TwoLinkFlexArm-v0", {"formulation": "floating_frame"}),
        ("SpatialFlexArm-v0", {"elements": 1}),
    ],
)
def test_a_drawn_hub_is_that_of_an_arm_that_has_it(env_id: str, keywords: dict[str, Any]) -> None:
    """In space a tensor, of which what is about the axis counts; told by info."""
    base = arms.named({ONE: "strip", "SpatialFlexArm-v0": "three_dof"}.get(env_id, "de_luca_siciliano"))
    size = base.torque_limits[0] / 200.0

    def hubbed(factor: float) -> Any:
        diagonal = np.diag(np.where(base.hub_axis, factor, 2.0)) * size
        own = tuple(map(tuple, diagonal.tolist())) if "elements" in keywords else factor * size
        return dataclasses.replace(base, hub_inertia=own)

    def made(factor: float, **more: Any) -> Any:
        return gym.make_vec(env_id, num_envs=3, arm=hubbed(factor), **more, **keywords)

    drawn = shaken(made(1.0, randomization={"hub_inertia": (2.5, 2.5)}))
    np.testing.assert_allclose(drawn, shaken(made(2.5)), atol=2e-5)
    assert np.abs(drawn - shaken(made(1.0))).max() > 0.02
    env = made(1.0, randomization={"hub_inertia": (0.5, 2.0), "EI": (0.5, 2.0)})
    _, info = env.reset(seed=1)
    own = env.unwrapped.batch
    rotors = np.array([own.parameters(i)[len(own.system.model.own) + LAWS.rotor] for i in range(3)])
    assert rotors == pytest.approx(size * (info["drawn_hub_inertia"] - 1.0)) and len(set(rotors)) == 3
    env.close()


def test_hubs_that_are_not_drawn() -> None:
    """There is none; a factor of 1 changes nothing but round-off."""
    ranges = {"hub_inertia": (0.5, 2.0)}
    none = dataclasses.replace(arms.named("strip"), hub_inertia=0.0)
    refuses("must not be given: strip has none", lambda: gym.make(ONE, arm=none, randomization=ranges))
    plain, same = (gym.make_vec(ONE, num_envs=3, randomization=given) for given in ({}, {"hub_inertia": (1.0, 1.0)}))
    np.testing.assert_allclose(shaken(same), shaken(plain), atol=2e-6)


@pytest.mark.slow
def test_factors_of_joints_are_drawn_anew_and_only_where_they_are_asked_for() -> None:
    ranges = {"friction": (0.5, 2.0), "motor_inertia": (0.8, 1.2)}
    given = {"arm": "strip_geared", "randomization": ranges}
    env = gym.make_vec(ONE, 3, vectorization_mode="vector_entry_point", **given).unwrapped
    env.reset(seed=0)
    batch, joint = env.batch, arms.named("strip_geared").joints[0]
    first = np.array([batch.parameters(i)[4:] for i in range(3)])
    env.reset(seed=1)
    again = np.array([batch.parameters(i)[4:] for i in range(3)])
    for drawn in (first, again):
        rotor, coulomb = drawn[:, LAWS.rotor] / joint.rotor, drawn[:, LAWS.coulomb] / joint.friction_coulomb
        assert ((rotor > 0.8) & (rotor < 1.2) & (coulomb > 0.5) & (coulomb < 2.0)).all() and len(set(coulomb)) == 3
    assert (first != again).any(axis=1).all()
    plain = gym.make(ONE, arm="strip_geared", randomization={"EI": (0.5, 1.5)}).unwrapped
    assert len(plain.batch.parameters(0)) == 4
    refuses("must not be drawn for linear models", lambda: env.linearize(0))
    with pytest.raises(ValueError, match=r"options.motion.*must not be given in an environment that draws"):
        env.reset(options={"motion": np.array([[0.0, 0.0], [1.0, 0.1]])})


@pytest.mark.parametrize(
    ("ranges", "words"),
    [
        ({"friction": (0.5, 2.0)}, r"randomization.friction = .*: must not be given: strip has none"),
        ({"backlash": (0.5, 2.0)}, "randomization.backlash"),
        ({"motor_inertia": (0.5, 2.0)}, "randomization.motor_inertia"),
        ({"payload_inertia": (2.0, 0.5)}, "randomization.payload_inertia"),
    ],
)
def test_factors_on_what_is_not_there_are_refused(ranges: dict[str, Any], words: str) -> None:
    refuses(words, lambda: gym.make(ONE, randomization=ranges))


@pytest.mark.slow
@pytest.mark.parametrize("factor", [0.7, 1.3])
def test_a_drawn_stiffness_is_nearly_that_of_an_arm_that_has_it(factor: float) -> None:
    """The period's correction stays the nominal arm's (theory, 5.3): under full torque 0.12 to 0.15 % of L."""
    arm = arms.named("strip")
    link = arm.links[0]
    link = dataclasses.replace(link, section=dataclasses.replace(link.section, EI=factor * link.section.EI))
    own = dataclasses.replace(arm, links=(link,))

    def bent(**keywords: Any) -> Any:
        env = gym.make("FlexibleArm-v0", **keywords)
        env.reset(seed=0, options={"start": 0.0, "target": 1.0})
        torques = [1.0] * 20 + [-1.0] * 20 + [0.0] * 160
        return np.array([env.step(np.array([u], np.float32))[-1]["tip_deflection"] for u in torques])

    true, drawn, made = bent(arm=own, dt=0.02 / 24), bent(randomization={"EI": (factor, factor)}), bent(arm=own)
    assert abs(made - true).max() < 3e-4
    assert 5e-4 < abs(drawn - true).max() < 2e-3
