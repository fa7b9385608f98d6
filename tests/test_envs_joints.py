"""Arms with motors, gears and friction in the environments: lanes, what info tells, currents and voltages."""

import dataclasses
import math
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from flexarm_env import JointTorque, Scene, arms, simulate
from flexarm_env.parameters import Arm, Joint, Motor
from flexarm_env.rigid import inertia_beyond
from flexarm_env.time_functions import steps
from tests.env_tools import ONE, TWO, assert_pair_same, assert_same, pair
from tests.scene_tools import everything

MOTOR = Motor(torque_constant=0.05, resistance=2.0, current_limit=1.2, voltage_limit=12.0)
GEAR = Joint(stiffness=60.0, damping=0.05, motor_inertia=2e-5, gear_ratio=30.0, friction_coulomb=0.06, motor=MOTOR)


def geared(name: str, joint: Joint = GEAR) -> Arm:
    arm = arms.named(name)
    return dataclasses.replace(arm, joints=(joint,) * arm.n_links)


def outcomes(env: Any, actions: np.ndarray, **options: Any) -> list[Any]:
    env.reset(seed=3, options=options or None)
    return [env.step(a.astype(np.float32)) for a in actions]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("env_id", "arm", "formulation"),
    [
        (ONE, "strip", "elastica"),
        (ONE, "strip", "floating_frame"),
        (TWO, "de_luca_siciliano", "elastica"),
        (TWO, "de_luca_siciliano", "geometrically_exact"),
    ],
)
def test_lanes_and_single_arms_are_equal_to_the_last_bit(env_id: str, arm: str, formulation: str) -> None:
    """Motors that stick and slip among them."""
    assert_pair_same(pair(env_id, 3, arm=geared(arm), formulation=formulation, info_level="full"), 30, scale=0.5)


@pytest.mark.slow
def test_a_held_arm_shakes_on_its_gear_and_the_motor_stands() -> None:
    env = gym.make(ONE, arm=geared("strip"), info_level="full", initial_vibration=0.02)
    found = [o[-1]["motor_angle"][0] for o in outcomes(env, np.zeros((50, 1)), start=0.2, vibration=0.001)]
    assert np.ptp(found[5:]) == 0.0


@pytest.mark.slow
def test_a_current_is_a_torque() -> None:
    """30 x 0.05 N m/A x 1.2 A = 1.8 N m, and the torque limit holds where that is less."""
    asked = {"current": np.full((20, 1), 0.5), "torque": np.full((20, 1), 0.5 * 1.8 / 2.0)}
    common: dict[str, Any] = {"arm": geared("strip"), "info_level": "full", "dt": 0.02 / 3.0}
    one, other = (outcomes(gym.make(ONE, **common, action_mode=m), a, start=0.0) for m, a in asked.items())
    for a, b in zip(one, other, strict=True):
        np.testing.assert_allclose(a[0], b[0], atol=1e-5)
        assert a[-1]["joint_torque"][0] == pytest.approx(0.9)


@pytest.mark.slow
def test_a_voltage_gives_the_rate_at_which_the_motor_makes_as_much() -> None:
    """Without friction r k w = V; at rest the torque is r k V / R, within the limits of current and torque."""
    joint = dataclasses.replace(GEAR, friction_coulomb=0.0)
    env = gym.make(ONE, arm=geared("strip", joint), action_mode="voltage", info_level="full", duration=20.0)
    found = outcomes(env, np.full((600, 1), 0.25), start=0.0)
    assert found[0][-1]["joint_torque"][0] < 1.8
    rate = np.mean([o[-1]["motor_rate"][0] for o in found[-100:]])
    assert rate == pytest.approx(0.25 * 12.0 / (30.0 * 0.05), rel=2e-3)
    assert abs(np.mean([o[-1]["joint_torque"][0] for o in found[-100:]])) < 5e-3
    first = outcomes(env, np.full((1, 1), 1.0), start=0.0)[0][-1]
    assert first["joint_torque"][0] <= 1.8
    strong = gym.make(ONE, arm=geared("strip", joint), action_mode="voltage", info_level="full",
                      randomization={"torque_constant": (1.5, 1.5)})  # fmt: skip
    for stronger, plain in ((1.0, 1.0), (0.1, 0.15)):  # that gain is on voltages, not on limits of currents
        asked = (strong, stronger), (env, plain)
        runs = [outcomes(one, np.full((3, 1), share), start=0.0) for one, share in asked]
        one, other = ([o[-1]["joint_torque"][0] for o in run] for run in runs)
        assert one == pytest.approx(other, rel=1e-6)
    with pytest.raises(ValueError, match=r"arm.joints\[0\].motor: missing; action_mode=\"voltage\" needs a motor"):
        gym.make(ONE, action_mode="voltage")


@pytest.mark.slow
def test_controllers_under_the_action_look_at_the_motor() -> None:
    env = gym.make(ONE, arm=geared("strip"), action_mode="residual_pd", info_level="full")
    env.reset(seed=0, options={"start": 0.0, "target": 0.5})
    limit = 2.0
    stiffness = limit / (math.pi / 4)
    damping = 2.0 * math.sqrt(stiffness * inertia_beyond(env.unwrapped.plan.arm, 0))
    angle = rate = 0.0
    for _ in range(20):
        info = env.step(np.zeros(1, np.float32))[-1]
        wanted = np.clip(stiffness * (0.5 - angle) - damping * rate, -limit, limit)
        assert info["joint_torque"][0] == pytest.approx(wanted, abs=1e-9)
        angle, rate = info["motor_angle"][0], info["motor_rate"][0]


def test_friction_of_the_actuator_is_that_of_the_joints() -> None:
    arm = arms.named("strip")
    rubbed = dataclasses.replace(arm, joints=(Joint(friction_viscous=0.02, friction_coulomb=0.1),))
    actions = np.random.default_rng(1).uniform(-1.0, 1.0, (20, 1))
    one = outcomes(gym.make(ONE, actuator={"viscous": 0.02, "coulomb": 0.1}, info_level="full"), actions)
    other = outcomes(gym.make(ONE, arm=rubbed, info_level="full"), actions)
    assert_same([o[0] for o in one], [o[0] for o in other])


RUBBED = (
    ("stiff gear", Joint(friction_viscous=0.1, friction_coulomb=0.1)),
    ("motor's side", dataclasses.replace(GEAR, friction_coulomb=0.06, friction_viscous=0.01)),
    ("link's side", dataclasses.replace(GEAR, friction_coulomb=0.06, friction_viscous=0.01, friction_side="link")),
)


@pytest.mark.parametrize("env_id", [ONE, pytest.param(TWO, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    "joint",
    [pytest.param(joint, id=name, marks=[pytest.mark.slow] if joint.elastic else []) for name, joint in RUBBED],
)
@pytest.mark.parametrize(
    ("formulation", "modes"),
    [
        ("elastica", None),
        *(pytest.param("floating_frame", count, marks=pytest.mark.slow) for count in (None, 2)),
        pytest.param("geometrically_exact", None, marks=pytest.mark.slow),
    ],
)
def test_friction_under_torques_that_jump_keeps_the_books(
    env_id: str, joint: Joint, formulation: str, modes: int | None
) -> None:
    """Joints that reverse, stop and start in every period, under torques of all sizes."""
    arm = geared("strip" if env_id == ONE else "de_luca_siciliano", joint)
    keywords: dict[str, Any] = {"arm": arm, "formulation": formulation, "info_level": "full", "duration": 4.0}
    env = gym.make(env_id, **keywords, **({} if modes is None else {"modes": modes}))
    for largest in (0.1, 0.3, 1.0) if modes is None else (0.05, 0.15):  # within the modes' range
        rng = np.random.default_rng(1)
        env.reset(seed=0)
        for _ in range(100):
            sizes = (
                rng.uniform(-largest, largest, arm.n_links) if largest < 1.0 else rng.choice([-1.0, 1.0], arm.n_links)
            )
            *_, terminated, _, info = env.step(sizes.astype(np.float32))
            assert not terminated, info["termination_reason"]
        energy = sum(info[f"energy_{kind}"] for kind in ("kinetic", "strain", "gravity"))
        own = 3e-3 if formulation == "geometrically_exact" else 1e-3  # its integrator takes energy from fast waves
        assert energy + info["energy_dissipated"] == pytest.approx(info["work"], rel=own, abs=3e-5)


@pytest.mark.slow
@pytest.mark.parametrize("formulation", ["elastica", "floating_frame"])
def test_three_joints_stick_and_slip_together(formulation: str) -> None:
    """Torques below friction move none of them, to the last bit; above it, books close."""
    arm = arms.named("three_strips")
    joints = tuple(Joint(friction_coulomb=0.1 * limit, friction_viscous=0.02 * limit) for limit in arm.torque_limits)
    arm = dataclasses.replace(arm, joints=joints)
    env = gym.make("MultiLinkFlexArm-v0", arm=arm, formulation=formulation, info_level="full")
    for largest in (0.05, 0.12, 0.3, 1.0):
        rng, start = np.random.default_rng(0), env.reset(seed=0)[1]["motor_angle"]
        for _ in range(150):
            *_, terminated, _, info = env.step(rng.uniform(-largest, largest, 3).astype(np.float32))
            assert not terminated, info["termination_reason"]
        moved = np.abs(np.subtract(info["motor_angle"], start)).max()
        assert moved == 0.0 if largest < 0.1 else moved > 1e-4
        energy = sum(info[f"energy_{kind}"] for kind in ("kinetic", "strain", "gravity"))
        assert energy + info["energy_dissipated"] == pytest.approx(info["work"], rel=1e-3, abs=1e-7)


@pytest.mark.parametrize("formulation", ["elastica", pytest.param("floating_frame", marks=pytest.mark.slow)])
def test_friction_under_torques_that_jump_is_that_of_short_steps(formulation: str) -> None:
    """An environment's joint, thrown about, against a scene's of the same torques in steps of 0.25 ms, in which every
    reversal and stop is resolved; the error falls with the step, as it must at reversals."""
    arm, period = geared("strip", RUBBED[0][1]), 0.02
    torques = 2.0 * np.random.default_rng(1).choice([-1.0, 1.0], 60)
    pushes = JointTorque(0, steps(period * np.arange(60), torques))
    scene = everything(Scene("pushed", arm, duration=60 * period, dt=2.5e-4, sample=period, loads=(pushes,)))
    right = simulate(scene, "elastica", tolerance=1e-9, estimate_error=False)
    assert right.status == "ok"
    for dt, off in ((period / 8.0, 3e-3), (period / 32.0, 1e-3)):
        env = gym.make(ONE, arm=arm, formulation=formulation, dt=dt, info_level="full")
        start = env.reset(seed=0)[1]["motor_angle"][0]
        hub = [env.step(np.float32([torque / 2.0]))[-1]["motor_angle"][0] - start for torque in torques]
        np.testing.assert_allclose(hub, right.joint_angles[1:, 0], atol=off)
        same = dataclasses.replace(scene, dt=dt)
        found = simulate(same, formulation, estimate_error=False)
        assert found.status == "ok"
        np.testing.assert_allclose(found.joint_angles[:, 0], right.joint_angles[:, 0], atol=off)
