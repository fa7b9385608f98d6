"""Contacts in the environments: single beside vector, states, steps, info against closed forms, refusals."""

import dataclasses
import math
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from flexarm_env import Contact, Payload, arms, simulate
from flexarm_env.compiler import UNCOMPILED
from flexarm_env.scene import standing_scene
from flexarm_env.shapes import HalfSpace, Sphere
from tests.env_tools import RANDOM, assert_goes_back, assert_pair_same, pair
from tests.refusals import refusal

CEILING = HalfSpace((0.0, 0.5), (0.0, -1.0))
WALL: dict[str, Any] = {"obstacle": CEILING.to_dict(), "stiffness": 1e4, "damping": 0.3, "friction": 0.3}
BALL = Sphere((0.6, -0.3), 0.2)
FLOOR: dict[str, Any] = {**WALL, "obstacle": HalfSpace((0.0, 0.0, 0.2), (0.0, 0.0, 1.0)).to_dict()}
NAMES = {"contact_force", "contact_friction", "contact_penetration", "contact_sliding", "contact_impulse"}
BUSY: dict[str, tuple[str, dict[str, Any]]] = {
    "elastica": ("FlexibleArm-v0", {"contacts": WALL, "starts": {"angles": [(0.0, 0.6)]}}),
    "exact": (
        "TwoLinkFlexArm-v0", {
            "contacts": [{**WALL, "bodies": ["tip", "joint1"]}, {**WALL, "obstacle": BALL.to_dict()}],
            "formulation": "geometrically_exact", "elements": 2, "starts": {"angles": [(0.0, 0.6), (-0.5, 0.5)]},
        },
    ),
    "space": ("SpatialFlexArm-v0", {"contacts": FLOOR, "elements": 1}),
    "floating": ("FlexibleArm-v0", {"contacts": WALL, "base": {"mass": 10.0, "inertia": 1.0}}),
}  # fmt: skip
"""Environments in which arms touch often."""


def pushed(env: Any, action: float, periods: int) -> dict[str, Any]:
    """The info after so many periods under a constant action."""
    for _ in range(periods):
        *_, terminated, _, info = env.step(np.full(env.action_space.shape, action, np.float32))
        assert not terminated, info["termination_reason"]
    found: dict[str, Any] = info
    return found


def test_info_of_an_arm_that_is_held_against_a_wall() -> None:
    """Moments about the hub: torque = x F_n of a wall without friction; F_n = k d^1.5; impulse = F_n T."""
    arm = dataclasses.replace(arms.named("strip"), payload=Payload(0.2, radius=0.03))
    smooth = {**WALL, "friction": 0.0, "damping": 3.0}
    env = gym.make("FlexibleArm-v0", arm=arm, contacts=smooth, duration=30.0, reward_terms={})
    *_, info = env.reset(seed=0, options={"start": 0.4})
    assert {name for name in info if name.startswith("contact")} == NAMES
    assert not any(info[name] for name in NAMES)
    info = pushed(env, 0.5, 1400)
    x, y = info["tip_position"]
    assert info["contact_force"] == pytest.approx(0.5 * 2.0 / x, rel=1e-3)
    assert info["contact_penetration"] == pytest.approx(y + 0.03 - 0.5, rel=1e-6)
    assert info["contact_force"] == pytest.approx(1e4 * (y + 0.03 - 0.5) ** 1.5, rel=1e-3)
    assert info["contact_impulse"] == pytest.approx(0.02 * info["contact_force"], rel=1e-3)
    assert info["contact_friction"] == 0.0
    touch = env.unwrapped.snapshot().touches
    assert touch.shape == (1, 7)
    assert np.allclose(touch[0, :3], (x, y, 0.0))
    assert np.allclose(touch[0, 3:], (0.0, -info["contact_force"], 0.0, info["contact_force"]))


def test_energy_of_impacts_is_accounted_for() -> None:
    """Kinetic, strain, gravitational and dissipated energy less the motors' work stay as they were."""
    env = gym.make("FlexibleArm-v0", contacts=WALL, info_level="full")
    *_, info = env.reset(seed=0, options={"start": 0.3})
    start = total(info)
    touched, largest = 0, 0.0
    for _ in range(150):
        *_, info = env.step(np.array([0.6], np.float32))
        touched += info["contact_force"] > 0.0
        largest = max(largest, abs(info["work"]))
    assert touched > 20
    assert info["energy_dissipated"] > 0.1 * largest
    assert abs(total(info) - start) < 0.02 * largest


def total(info: dict[str, Any]) -> float:
    """Energies less work, J."""
    energies = ("energy_kinetic", "energy_strain", "energy_gravity", "energy_dissipated")
    return float(sum(info[name] for name in energies) - info["work"])


@pytest.mark.slow
def test_an_arm_on_a_floating_base_pushes_itself_off() -> None:
    """Energy is balanced, a period's step of 5 ms gives the impulse of one of 0.5 ms, and the base moves away."""
    found = []
    for dt in (5e-3, 5e-4):
        env = gym.make("FlexibleArm-v0", info_level="full", dt=dt, **BUSY["floating"][1])
        *_, info = env.reset(seed=0, options={"start": 0.3})
        start, impulse = total(info), 0.0
        for _ in range(100):
            *_, info = env.step(np.array([0.6], np.float32))
            impulse += info["contact_impulse"]
        assert impulse > 1.0
        assert abs(total(info) - start) < (2e-3 if dt == 5e-3 else 2e-5) * abs(info["work"])
        found.append((impulse, *info["tip_position"], *info["base_position"]))
    assert found[0] == pytest.approx(found[1], rel=5e-3, abs=2e-3)
    # the ceiling pushes down
    assert found[1][4] < -0.01


@pytest.mark.slow
def test_an_object_is_gripped_while_the_tip_is_pressed_on_a_wall() -> None:
    """Speeds jump with the momentum, the contact force does not; fewer and more steps agree."""
    change = {"time": (0.5, 0.5), "factor": (3.0, 3.0), "gripped": "resting"}
    found = []
    for dt in (2e-3, 5e-4):
        env = gym.make("FlexibleArm-v0", contacts=WALL, payload_change=change, info_level="full", dt=dt)
        env.reset(seed=0, options={"start": math.asin(0.5)})
        forces = []
        for _ in range(50):
            *_, terminated, _, info = env.step(np.array([0.9], np.float32))
            assert not terminated
            forces.append(info["contact_force"])
        found.append(np.array([*forces[15:], *info["tip_position"], info["energy_dissipated"]]))
        assert forces[24] > 1.0
    assert abs(found[0] - found[1]).max() < 0.01 * abs(found[1]).max()


@pytest.mark.parametrize(
    "kind",
    [
        "elastica",
        pytest.param("exact", marks=pytest.mark.slow),
        "space",
        pytest.param("floating", marks=pytest.mark.slow),
    ],
)
def test_a_vector_is_single_arms_that_touch(kind: str) -> None:
    """To the last bit, with drawn parameters and over restarts."""
    env_id, keywords = BUSY[kind]
    drawn = {"EI": (0.7, 1.3), "damping": (0.5, 2.0)} if kind == "space" else RANDOM
    both = pair(env_id, 9, duration=0.6, info_level="full", randomization=drawn, **keywords)
    assert assert_pair_same(both, 70, scale=1.6) > 0
    assert both[1].unwrapped.batch.view(0).touches.shape[1] == 7


TABLE = HalfSpace((0.0, 0.0, 0.6), (0.0, 0.0, 1.0))
INSIDE: dict[str, tuple[str, dict[str, Any]]] = {
    "angle": ("FlexibleArm-v0", {"contacts": WALL, "starts": {"angles": [(-1.0, 1.5)], "target": (-2.0, 2.0)}}),
    "point": ("TwoLinkFlexArm-v0", {"contacts": [{**WALL, "bodies": ["tip", "joint1"]}]}),
    "space": ("SpatialFlexArm-v0", {"contacts": {**FLOOR, "obstacle": TABLE.to_dict()}}),
}  # fmt: skip
"""Environments of whose drawn starts and targets many would be inside an obstacle."""


@pytest.mark.parametrize("kind", ["angle", pytest.param("point", marks=pytest.mark.slow), "space"])
def test_drawn_starts_and_targets_are_outside_obstacles(kind: str) -> None:
    """Signed distances of tips, by the shapes' own Python; rules 1 do not draw again."""
    env_id, keywords = INSIDE[kind]
    shape = TABLE if kind == "space" else CEILING
    inside = []
    for rules in (2, 1):
        envs: Any = gym.make_vec(env_id, num_envs=40, vectorization_mode="vector_entry_point", rules=rules, **keywords)
        envs.reset(seed=5)
        views = [envs.unwrapped.batch.view(i) for i in range(40)]
        ends = np.array([view.points[-1] for view in views])
        goals = np.array([view.target for view in views])
        if kind == "angle":
            goals = np.array([np.cos(goals[:, 0]), np.sin(goals[:, 0])]).T
        inside.append(((shape.distance(ends) < -1e-9).sum(), (shape.distance(goals) < -1e-9).sum()))
        assert rules == 1 or max(view.touches[:, 6].max() for view in views) == 0.0
    assert inside[0] == (0, 0)
    assert min(inside[1]) > 0


def test_a_vector_draws_its_starts_as_single_arms_do() -> None:
    env_id, keywords = INSIDE["angle"]
    assert_pair_same(pair(env_id, 9, duration=0.1, **keywords), 14)


def test_starts_that_are_all_inside_an_obstacle_are_refused() -> None:
    env_id, keywords = INSIDE["angle"]
    told = refusal(lambda: gym.make(env_id, **{**keywords, "starts": {"angles": [(0.6, 2.0)]}}))
    assert told.startswith("starts.angles = [(0.6, 2.0)]: must contain places outside the obstacles")
    high = {"target": (0.6, 2.0), "absolute": True}
    told = refusal(lambda: gym.make(env_id, **{**keywords, "starts": high}))
    assert told.startswith("starts.target = ") and "none of 50 drawn ones" in told


def test_states_in_contact_are_gone_back_to() -> None:
    env_id, keywords = BUSY["elastica"]
    env = gym.make(env_id, **keywords)
    env.reset(seed=0, options={"start": math.asin(0.5)})
    assert pushed(env, 1.0, 8)["contact_force"] > 0.0
    assert_goes_back(env)


def test_without_contacts_there_is_nothing_of_them() -> None:
    env, other = (gym.make("FlexibleArm-v0", contacts=value) for value in ([], None))
    *_, info = env.reset(seed=0)
    assert not any(name.startswith("contact") for name in info)
    assert env.unwrapped.batch.system.model.newton.contact is None
    assert env.unwrapped.plan.settings == other.unwrapped.plan.settings
    assert env.unwrapped.batch.layout == other.unwrapped.batch.layout


def test_steps_resolve_the_stiffest_contact() -> None:
    """Chosen where dt is not given: an impact lasts 8 steps at least; a lighter payload needs shorter ones."""
    steps = []
    for stiffness, drawn in ((1e3, {}), (1e5, {}), (1e5, {"payload": (0.1, 1.0)})):
        plan = gym.make("FlexibleArm-v0", contacts={**WALL, "stiffness": stiffness}, randomization=drawn).unwrapped.plan
        steps.append(plan.settings.dt)
        assert abs(plan.period / steps[-1] - round(plan.period / steps[-1])) < 1e-9
    assert steps[0] > steps[1] > steps[2]
    told = refusal(lambda: gym.make("FlexibleArm-v0", contacts=WALL, dt=0.02))
    assert told.startswith("contacts[0].stiffness = 10000.0: must be at most")
    assert "dt = 0.02 s" in told
    assert "give dt <=" in told
    told = refusal(lambda: gym.make("FlexibleArm-v0", contacts={**WALL, "stiffness": 1e30}))
    assert told.startswith("contacts[0].stiffness = 1e+30: must be at most")
    assert "dt = 2e-05 s" in told


@pytest.mark.parametrize(
    ("keywords", "words"),
    [
        ({"contacts": {**WALL, "stiffness": math.nan}}, ("contacts[0].stiffness = nan",)),
        ({"contacts": {**WALL, "bodies": ["joint1"]}}, ("contacts[0].bodies[0] = 'joint1'",)),
        ({"contacts": [WALL, {**WALL, "mu": 0.1}]}, ("contacts[1].mu: unknown key",)),
        ({"contacts": {**WALL, "obstacle": {**BALL.to_dict(), "radius": 0.0}}}, ("radius = 0.0",)),
        ({"contacts": FLOOR}, ("contacts[0].obstacle", "in the plane")),
        ({"contacts": WALL, "step_tolerance": 1e-4}, ("step_tolerance = 0.0001: must be None with contacts",)),
        ({"contacts": WALL, "formulation": "paper"}, ("multipliers = True: must be False with contacts",)),
        ({"contacts": WALL, "task": "replay"}, ("task = 'replay'", "contacts")),
        ({"contacts": "wall"}, ("contacts = 'wall'",)),
    ],
)  # fmt: skip
def test_what_is_refused(keywords: dict[str, Any], words: tuple[str, ...]) -> None:
    told = refusal(lambda: gym.make("FlexibleArm-v0", **keywords), Exception)
    assert all(word in told for word in words), told


def test_refusals_of_an_arm_that_touches() -> None:
    env: Any = gym.make("FlexibleArm-v0", contacts=WALL).unwrapped
    told = refusal(lambda: env.reset(options={"motion": "robot_arm_motion"}))
    assert told.startswith("options.motion = ")
    assert "contacts" in told
    *_, info = env.reset(seed=0, options={"start": 0.55})
    assert info["contact_force"] > 0.0
    assert "must not be touched" in refusal(env.linearize)
    env.reset(seed=0, options={"start": 0.3})
    assert env.linearize().A.shape == (8, 8)


@pytest.mark.parametrize(
    ("contacts", "start", "action"),
    [
        (WALL, math.asin(0.5), 1.0),
        (WALL, 1.5, 0.0),
        ({**WALL, "obstacle": HalfSpace((0.0, -5.0), (0.0, -1.0)).to_dict()}, 1.5, 0.0),
        ({**WALL, "obstacle": Sphere((1.0, 0.0), 0.3).to_dict()}, 0.0, 0.0),
        ([{**WALL, "obstacle": HalfSpace((0.0, s * 0.005), (0.0, -s)).to_dict()} for s in (-1.0, 1.0)], 0.0, 1.0),
        ([{**WALL, "obstacle": HalfSpace((0.0, -s * 0.02), (0.0, -s)).to_dict()} for s in (-1.0, 1.0)], 0.0, 1.0),
        ({**WALL, "friction": 1e6, "creep": 1e-12}, 0.3, 1.0),
    ],
    ids=["touches", "deep", "deeper", "center", "jammed", "overlapping", "sticky"],
)
def test_hard_cases_end_in_numbers_or_a_reason(contacts: Any, start: float, action: float) -> None:
    # rules 1: some of these obstacles leave no place for a drawn start or target, which rules 2 refuse
    env = gym.make("FlexibleArm-v0", contacts=contacts, rules=1)
    observation, info = env.reset(seed=0, options={"start": start})
    for _ in range(100):
        observation, reward, terminated, _, info = env.step(np.array([action], np.float32))
        assert np.isfinite(observation).all()
        assert math.isfinite(reward)
        assert all(math.isfinite(info[name]) for name in NAMES)
        assert bool(terminated) == bool(info["termination_reason"])
        if terminated:
            break


@pytest.mark.skipif(UNCOMPILED, reason="derivatives are compiled")
@pytest.mark.parametrize(
    ("formulation", "least"),
    [("elastica", 1e-6), pytest.param("geometrically_exact", 1e-3, marks=pytest.mark.slow)],
)
def test_derivatives_in_contact(formulation: str, least: float) -> None:
    """Of a period in which the tip is pressed on the wall and slides: differences of periods, and backwards."""
    from flexarm_env.derivatives import Arms

    slippery = {**WALL, "creep": 0.05}
    env = Arms("FlexibleArm-v0", 1, contacts=slippery, formulation=formulation, tolerance=1e-9)
    state, action, h = env.reset(seed=0, options={"start": math.asin(0.5)}), np.array([[0.6]]), 1e-5
    for _ in range(5):
        state = env.step(state, action)[0]
    forward = env.jacobians(state, action)
    slope = (env.step(state, action + h)[0] - env.step(state, action - h)[0]) / (2.0 * h)
    assert abs(forward.B[..., 0] - slope).max() < 2e-6 * abs(slope).max()
    for k in range(0, env.moving, max(1, env.moving // 8)):
        # steps that move numbers of other scales alike
        aside, h = np.zeros_like(state), least / max(1.0, abs(forward.A[0, :, k]).max())
        aside[0, k] = h
        slope = (env.step(state + aside, action)[0] - env.step(state - aside, action)[0]) / (2.0 * h)
        assert abs(forward.A[0, :, k] - slope[0]).max() < 5e-5 * abs(slope).max()
    rng = np.random.default_rng(0)
    bars = [rng.normal(size=part.shape) for part in forward[:3]]
    for one, other in zip(env.vjp(state, action, *bars), forward.vjp(*bars), strict=True):
        assert abs(one - other)[:, : env.moving].max() < 1e-9 * abs(other).max()
    env.close()


def test_contacts_as_objects_and_as_tables_are_the_same() -> None:
    table, given = WALL, Contact(CEILING, 1e4, damping=0.3, friction=0.3)
    plans = [gym.make("FlexibleArm-v0", contacts=value).unwrapped.plan for value in (table, given, [given])]
    assert plans[0].contacts == plans[1].contacts == plans[2].contacts == (given,)


SENSED: dict[str, Any] = {"force": {}, "switch": {"threshold": 2.0}, "strain_gauges": [{"gain": (0.9, 1.1)}]}


def test_sensors_of_contact_read_what_info_says() -> None:
    """With the force's scale, torque limit over length; the switch beyond its threshold; at the start too."""
    env: Any = gym.make("FlexibleArm-v0", contacts=WALL, sensors=SENSED).unwrapped
    names = env.plan.names
    at = [names.index(name) for name in ("tip_force_normal", "tip_force_tangential", "contact_switch")]
    assert [env.plan.scales[k] for k in at] == [2.0, 2.0, 1.0]
    touched = 0
    for start in (0.4, 0.528):
        seen, info = env.reset(seed=0, options={"start": start})
        for _ in range(60):
            wanted = info["contact_force"] / 2.0, info["contact_friction"] / 2.0, float(info["contact_force"] > 2.0)
            assert np.allclose(seen[at], np.minimum(wanted, 10.0), atol=1e-6)
            touched += info["contact_force"] > 0.0
            seen, *_, info = env.step(np.array([0.5], np.float32))
    assert touched > 20


def test_errors_of_contact_sensors() -> None:
    """Gain, delay and noise are those of every sensor."""
    sensors = {"force": {"gain": 2.0, "delay": 0.02}, "switch": {"bias": (0.25, 0.25)}}
    env: Any = gym.make("FlexibleArm-v0", contacts=WALL, sensors=sensors).unwrapped
    k = env.plan.names.index("tip_force_normal")
    env.reset(seed=0, options={"start": 0.45})
    forces, seen = [], []
    for _ in range(60):
        observation, *_, info = env.step(np.array([0.5], np.float32))
        forces.append(info["contact_force"])
        seen.append(observation[k])
        assert observation[k + 2] == pytest.approx(0.25 + (info["contact_force"] > 0.0))
    assert max(forces) > 0.0
    assert np.allclose(seen[1:], np.minimum(np.array(forces[:-1]), 10.0), atol=1e-6)


def test_contact_sensors_without_contacts_and_where_they_cannot_be() -> None:
    env: Any = gym.make("FlexibleArm-v0", sensors={"force": {}, "switch": {}}).unwrapped
    assert env.reset(seed=0)[0][-3:].tolist() == [0.0, 0.0, 0.0]
    elbow = {**WALL, "bodies": ["joint1"], "obstacle": HalfSpace((0.0, 0.2), (0.0, -1.0)).to_dict()}
    two: Any = gym.make("TwoLinkFlexArm-v0", contacts=elbow, sensors={"force": {}, "switch": {}}).unwrapped
    seen, info = two.reset(seed=0, options={"start": (0.8, -0.5)})
    assert info["contact_force"] > 0.0
    assert seen[-3:].tolist() == [0.0, 0.0, 0.0]
    assert "sensors.switch.threshold = -1.0" in refusal(
        lambda: gym.make("FlexibleArm-v0", sensors={"switch": {"threshold": -1.0}})
    )
    scene = standing_scene(arms.named("strip"), 0.01, None)
    run = simulate(scene, "elastica", estimate_error=False)
    assert "sensors.force" in refusal(lambda: run.measured({"force": {}}))


def test_a_vector_reads_contact_sensors_as_single_arms_do() -> None:
    keywords = BUSY["elastica"][1]
    both = pair("FlexibleArm-v0", 9, duration=0.6, sensors={**SENSED, "noise": 0.01}, **keywords)
    assert assert_pair_same(both, 70, scale=1.6) > 0
