"""Moving obstacles and several contact points in the environments: against scenes, energy, vectors, derivatives."""

import math
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from flexarm_env import Contact, JointTorque, Scene, simulate
from flexarm_env.compiler import UNCOMPILED
from flexarm_env.shapes import Box, Cylinder, HalfSpace, Sphere
from flexarm_env.time_functions import constant, linear_table, ramp, sine
from tests.env_tools import RANDOM, assert_goes_back, assert_pair_same, pair
from tests.refusals import refusal

FLOOR = Contact(HalfSpace((0.0, -0.1), (0.0, 1.0)), 1e4, damping=0.5, friction=0.3, displacement_y=sine(0.08, 12.0))
SLIDING = Contact(HalfSpace((0.8, 0.0), (-1.0, 0.0)), 1e4, displacement_x=sine(0.1, 1.0))
TABLE = Contact(
    HalfSpace((0.0, 0.0, 0.35), (0.0, 0.0, 1.0)), 1e4, damping=0.5, friction=0.3, displacement_x=sine(0.02, 5.0),
    displacement_z=sine(0.08, 12.0),
)  # fmt: skip
SHAKEN: dict[str, tuple[str, dict[str, Any]]] = {
    "elastica": (
        "FlexibleArm-v0", {
            "contacts": FLOOR.to_table(), "starts": {"angles": [(0.0, 0.6)]}, "initial_vibration": 0.05,
            "sensors": {"strain_gauges": [0.0, 0.5]},
        },
    ),
    "exact": (
        "TwoLinkFlexArm-v0", {
            "contacts": {**FLOOR.to_table(), "bodies": ["tip", "joint1"]}, "formulation": "geometrically_exact",
            "elements": 2,
        },
    ),
    "space": ("SpatialFlexArm-v0", {"contacts": TABLE, "elements": 1, "initial_vibration": 0.02}),
    "floating": ("FlexibleArm-v0", {"contacts": FLOOR, "base": {"mass": 10.0, "inertia": 1.0}}),
}  # fmt: skip
"""Environments whose arms a moving floor hits often."""


def total(info: dict[str, Any]) -> float:
    """Energies less work, J."""
    energies = ("energy_kinetic", "energy_strain", "energy_gravity", "energy_dissipated")
    return float(sum(info[name] for name in energies) - info["work"])


def test_an_environment_is_the_scene_with_the_same_obstacle() -> None:
    """Positions at the ends of control periods, for a constant torque and a floor that shakes the arm."""
    env: Any = gym.make("FlexibleArm-v0", contacts=FLOOR, dt=2.5e-3)
    env.reset(seed=0, options={"start": 0.0})
    tips = [env.step(np.array([-0.2], np.float32))[4]["tip_position"] for _ in range(60)]
    plan = env.unwrapped.plan
    torque = JointTorque(0, constant(-0.2 * plan.arm.torque_limits[0]))
    scene = Scene("shaken", plan.arm, duration=1.2, dt=2.5e-3, sample=0.02, contacts=(FLOOR,), loads=(torque,))
    solver = {name: getattr(plan.settings, name) for name in ("nodes", "rho_inf", "tolerance")}
    run = simulate(scene, plan.settings.formulation, estimate_error=False, **solver)
    assert max(run.tip[:, 1]) > 0.1
    assert abs(run.tip[1:, :2] - np.array(tips)).max() < 1e-6


def test_the_work_of_a_moving_floor_is_what_the_arm_gains() -> None:
    """Floor and motor do work; the remainder of the balance falls with the square of the step."""
    rest = []
    for dt in (5e-3, 2.5e-3):
        env = gym.make("FlexibleArm-v0", contacts=FLOOR, info_level="full", dt=dt)
        *_, info = env.reset(seed=0, options={"start": 0.0})
        start, most, work = total(info), 0.0, 0.0
        for _ in range(100):
            *_, terminated, _, info = env.step(np.array([-0.2], np.float32))
            assert not terminated
            most, work = max(most, abs(total(info) - start)), max(work, info["work"])
        assert work > 0.3
        rest.append(most / work)
    assert rest[0] < 0.02
    assert rest[1] < 0.4 * rest[0]


@pytest.mark.parametrize(
    "formulation", ["elastica", pytest.param("geometrically_exact", marks=pytest.mark.slow)]
)
def test_a_velocity_that_jumps_at_a_control_instant(formulation: str) -> None:
    """A floor on which the tip rests starts with a jump of 0.2 m/s: second order in the step, as the scene's runs.

    Between control instants the damping force's jump leaves an error of first order.
    """
    errors = []
    for start in (0.2, 0.2074):
        path = linear_table([0.0, start, 1.0], [0.0, 0.0, 0.2 * (1.0 - start)])
        floor = Contact(HalfSpace((0.0, -0.1), (0.0, 1.0)), 1e4, damping=3.0, displacement_y=path)
        for dt in (2e-3, 1e-3):
            env: Any = gym.make("FlexibleArm-v0", contacts=floor, formulation=formulation, dt=dt, tolerance=1e-10)
            env.reset(seed=0, options={"start": -0.09})
            tips = [env.step(np.array([-0.4], np.float32))[4]["tip_position"] for _ in range(20)]
            plan = env.unwrapped.plan
            torque = JointTorque(0, constant(float(np.float32(-0.4)) * plan.arm.torque_limits[0]))
            scene = Scene(
                "jump", plan.arm, duration=0.4, dt=1.25e-4, sample=0.02, contacts=(floor,), loads=(torque,),
                angles=(-0.09,),
            )  # fmt: skip
            mesh = {name: getattr(plan.settings, name) for name in ("nodes", "elements", "rho_inf")}
            mesh = {name: value for name, value in mesh.items() if value is not None}
            run = simulate(scene, formulation, estimate_error=False, tolerance=1e-11, **mesh)
            errors.append(abs(run.tip[11:, :2] - np.array(tips)[10:]).max())
    assert errors[0] < 1e-5 and errors[1] < 0.3 * errors[0]
    assert errors[2] > 1.5 * errors[0] and errors[2] < 1e-4


def test_a_wall_that_approaches_presses_the_held_joint_away() -> None:
    """A floor that has risen to y = 0.2 m: the tip that an opposite torque presses rests on it, F_n x = torque."""
    floor = Contact(HalfSpace((0.0, -0.1), (0.0, 1.0)), 1e4, damping=5.0, displacement_y=ramp(0.3, 1.0))
    env = gym.make("FlexibleArm-v0", contacts=floor, duration=30.0)
    env.reset(seed=0, options={"start": 0.0})
    for _ in range(1400):
        *_, terminated, _, info = env.step(np.array([-0.25], np.float32))
        assert not terminated
    x, y = info["tip_position"]
    assert info["contact_force"] == pytest.approx(0.25 * 2.0 / x, rel=1e-3)
    assert info["contact_penetration"] == pytest.approx(0.2 - y, rel=1e-6)


@pytest.mark.parametrize(
    "kind",
    [
        "elastica",
        pytest.param("exact", marks=pytest.mark.slow),
        pytest.param("space", marks=pytest.mark.slow),
        pytest.param("floating", marks=pytest.mark.slow),
    ],
)
def test_a_vector_is_single_arms_that_a_floor_hits(kind: str) -> None:
    """To the last bit, over restarts at different times; states are gone back to."""
    env_id, keywords = SHAKEN[kind]
    drawn = {name: RANDOM[name] for name in ("EI", "damping")}
    both = pair(env_id, 9, duration=0.6, info_level="full", randomization=drawn, **keywords)
    assert assert_pair_same(both, 70, scale=1.6) > 0
    env = gym.make(env_id, **keywords)
    env.reset(seed=0)
    for _ in range(9):
        env.step(np.zeros(env.action_space.shape, np.float32))  # type: ignore[arg-type]
    assert_goes_back(env)


@pytest.mark.skipif(UNCOMPILED, reason="derivatives are compiled")
@pytest.mark.slow
def test_derivatives_under_a_moving_floor() -> None:
    """Of a period in which the floor pushes the tip: differences of periods, and backwards."""
    from flexarm_env.derivatives import Arms

    slippery = {**FLOOR.to_table(), "stiffness": 1e3, "creep": 0.05}
    env = Arms("FlexibleArm-v0", 1, contacts=slippery, tolerance=1e-9)
    state, action, h = env.reset(seed=0, options={"start": 0.0}), np.array([[-0.4]]), 1e-5
    twin = gym.make("FlexibleArm-v0", contacts=slippery, tolerance=1e-9)
    twin.reset(seed=0, options={"start": 0.0})
    info = {"contact_force": 0.0}
    while info["contact_force"] == 0.0:  # the floor pushes from this period on
        state = env.step(state, action)[0]
        info = twin.step(action[0].astype(np.float32))[4]
    forward = env.jacobians(state, action)
    slope = (env.step(state, action + h)[0] - env.step(state, action - h)[0]) / (2.0 * h)
    assert abs(forward.B[..., 0] - slope).max() < 2e-6 * abs(slope).max()
    rng = np.random.default_rng(0)
    bars = [rng.normal(size=part.shape) for part in forward[:3]]
    assert env.backwards
    for one, other in zip(env.vjp(state, action, *bars), forward.vjp(*bars), strict=True):
        assert abs(one - other)[:, : env.moving].max() < 1e-9 * abs(other).max()
    env.close()


def test_steps_resolve_the_speed_of_the_obstacle() -> None:
    fast = {**FLOOR.to_table(), "displacement_y": {"kind": "sine", "amplitude": 0.1, "omega": 50.0}}
    steps = [gym.make("FlexibleArm-v0", contacts=x).unwrapped.plan.settings.dt for x in (FLOOR, fast)]
    assert steps[1] < steps[0]
    told = refusal(lambda: gym.make("FlexibleArm-v0", contacts=fast, dt=steps[0]))
    assert told.startswith("contacts[0].stiffness = 10000.0: must be at most") and "an impact at 5 m/s" in told


def test_steps_resolve_the_displacement_itself() -> None:
    """A sine of 5 ms has steps well within its period; one of a microsecond is refused by name."""
    quick = {**FLOOR.to_table(), "displacement_y": {"kind": "sine", "amplitude": 1e-5, "omega": 2.0 * math.pi / 5e-3}}
    assert gym.make("FlexibleArm-v0", contacts=quick).unwrapped.plan.settings.dt < 5e-3 / 8.0
    told = refusal(lambda: gym.make("FlexibleArm-v0", contacts=quick, dt=5e-3))
    assert told.startswith("dt = 0.005: must be at most")
    shaken = {**quick, "displacement_y": {"kind": "sine", "amplitude": 1e-9, "omega": 2e6 * math.pi}}
    assert "too fast" in refusal(lambda: gym.make("FlexibleArm-v0", contacts=shaken))


@pytest.mark.parametrize(
    ("keywords", "words"),
    [
        ({"contacts": {**FLOOR.to_table(), "displacement_z": {"kind": "constant", "value": 0.1}}}, ("displacement_z",)),
        ({"contacts": {**FLOOR.to_table(), "displacement_y": 0.1}}, ("contacts[0].displacement_y = 0.1",)),
        ({"contacts": {**FLOOR.to_table(), "displacement_y": {"kind": "sinus"}}}, ("displacement_y.kind = 'sinus'",)),
        (
            {"contacts": {**FLOOR.to_table(), "displacement_y": {"kind": "sine", "amplitude": math.nan, "omega": 1.0}}},
            ("displacement_y", "nan"),
        ),
        (
            {"task": "press", "contacts": SLIDING},
            ("contacts[0].displacement_x", "the wall of the task stands still"),
        ),
    ],
)  # fmt: skip
def test_what_is_refused(keywords: dict[str, Any], words: tuple[str, ...]) -> None:
    env_id = "TwoLinkFlexArm-v0" if "task" in keywords else "FlexibleArm-v0"
    told = refusal(lambda: gym.make(env_id, **keywords), Exception)
    assert all(word in told for word in words), told


@pytest.mark.parametrize(
    "shape", [HalfSpace((0.1, 0.2), (0.6, 0.8)), Sphere((0.1, 0.2), 0.3), Box((0.1, 0.2), (0.4, 0.2), 0.5),
              Cylinder((0.0, 0.0, 0.1), (0.5, 0.0, 0.3), 0.1)]
)  # fmt: skip
def test_a_moved_shape_is_the_shape_elsewhere(shape: Any) -> None:
    rng = np.random.default_rng(0)
    by, points = rng.normal(size=shape.dimension), rng.normal(size=(20, shape.dimension))
    assert np.allclose(shape.moved(by).distance(points + by), shape.distance(points), atol=1e-12)


def test_pictures_show_the_obstacle_where_it_is() -> None:
    env: Any = gym.make("FlexibleArm-v0", contacts=FLOOR, render_mode="rgb_array")
    env.reset(seed=0, options={"start": 1.5})
    pictures = []
    for _ in range(2):
        pictures.append(np.asarray(env.render()))
        for _ in range(5):
            env.step(np.zeros(1, np.float32))
    # below the floor's place at rest, far from the arm
    assert (pictures[0][-40:] == pictures[1][-40:]).all()
    assert (pictures[0] != pictures[1]).any(axis=2).sum() > 0.01 * pictures[0].shape[0] * pictures[0].shape[1]


def test_info_of_several_points() -> None:
    """A bar at each of two joints: sums over the points are the entries of all points; forces balance the torque."""
    elbow = HalfSpace((0.0, 0.25), (0.0, -1.0))
    contacts = [
        Contact(elbow, 1e4, damping=5.0, bodies=("joint1",)),
        Contact(HalfSpace((0.0, -0.1), (0.0, 1.0)), 1e4, damping=5.0),
    ]
    env: Any = gym.make("TwoLinkFlexArm-v0", contacts=contacts, duration=40.0)
    *_, info = env.reset(seed=0, options={"start": (0.3, -0.6)})
    assert not info["contact_force_at_points"].any()
    u1, u2 = 0.05, -0.05
    for _ in range(1900):
        *_, terminated, _, info = env.step(np.array([u1, u2], np.float32))
        assert not terminated
    forces = info["contact_force_at_points"]
    assert forces.shape == (2,) and forces.min() > 0.0
    assert forces.sum() == pytest.approx(info["contact_force"])
    assert info["contact_penetration_at_points"].max() == pytest.approx(info["contact_penetration"])
    assert info["contact_impulse_at_points"].sum() == pytest.approx(info["contact_impulse"])
    # moments about the elbow: F_tip (x_tip - x_elbow) balances the elbow's torque
    elbow_place = env.unwrapped.batch.view(0).touches[0, :2]
    torque = -u2 * env.unwrapped.plan.arm.torque_limits[1]
    assert forces[1] * (info["tip_position"][0] - elbow_place[0]) == pytest.approx(torque, rel=1e-2)
    single: Any = gym.make("FlexibleArm-v0", contacts=FLOOR)
    assert not any(name.endswith("_at_points") for name in single.reset(seed=0)[1])
