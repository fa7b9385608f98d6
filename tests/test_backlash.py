"""Play in elastic gears: free flight across it, the period of an oscillator with a gap, books, agreement, refusals."""

import dataclasses
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from flexarm_env import arms, control
from flexarm_env.control.arm_model import arm_model
from flexarm_env.envs.vibration import swing
from flexarm_env.linear import modes, static_equilibrium
from flexarm_env.parameters import Arm, Elbow, Joint, Link, Payload, Section
from flexarm_env.scene import JointTorque, Motion, Scene
from flexarm_env.settings import Settings
from flexarm_env.simulation import simulate
from flexarm_env.time_functions import constant, sine
from tests.env_tools import assert_pair_same, pair, steered
from tests.scene_tools import Method, every, everything, tips_apart

STRIP = Section(EI=2.0, EA=2e6, C=7e5, m=0.3, J=1e-7)
STIFF = Section(EI=2e5, EA=1e9, C=1e9, m=0.3)
GEAR = Joint(stiffness=40.0, motor_inertia=1e-4, gear_ratio=10.0, backlash=0.1)
METHODS: list[Method] = [
    ("elastica", {"nodes": 6}),
    ("geometrically_exact", {"elements": 4}),
    ("floating_frame", {"segments": 4}),
]


def stiff_arm(joint: Joint = GEAR) -> Arm:
    """0.1 kg m^2 about the hub, as good as rigid."""
    return Arm("a", (Link(1.0, STIFF),), joints=(joint,))


@pytest.mark.slow
@every(METHODS)
def test_free_flight_across_the_gap(formulation: str, options: dict[str, Any]) -> None:
    """The motor alone moves, by tau t^2 / 2 J, until it has gone half of the play; the link knows nothing of it."""
    torque, inertia = 0.01, GEAR.rotor
    meets = np.sqrt(GEAR.backlash * inertia / torque)
    scene = Scene("s", stiff_arm(), duration=0.5, dt=1e-3, sample=0.01, loads=(JointTorque(0, constant(torque)),))
    run = simulate(everything(scene), formulation, estimate_error=False, **options)
    before = run.t < meets - 2e-3
    np.testing.assert_allclose(run.motor_angles[before, 0], 0.5 * torque / inertia * run.t[before] ** 2, atol=1e-12)
    assert np.abs(run.joint_angles[before]).max() < 1e-14 and before.sum() > 20
    assert run.joint_angles[-1, 0] > 1e-3
    assert np.abs(run.balance).max() < 2e-3 * run.turned_over


def oscillation(dt: float, rate: float = 0.5) -> tuple[float, float, Any]:
    """Period by passages through the gap's middle, its exact value, the run: a link behind a motor that is held."""
    joint = Joint(stiffness=40.0, backlash=0.1)
    scene = Scene(
        "s", stiff_arm(joint), duration=6.0, dt=dt, sample=dt, rates=(rate,), motions=(Motion("motor0", constant(0.0)),)
    )
    run = simulate(everything(scene), "elastica", nodes=3, rho_inf=1.0, estimate_error=False)
    angle, t = run.joint_angles[:, 0], run.t
    up = np.flatnonzero((angle[:-1] < 0.0) & (angle[1:] >= 0.0))
    passages = t[up] - angle[up] * (t[up + 1] - t[up]) / (angle[up + 1] - angle[up])
    exact = 2.0 * np.pi * np.sqrt(0.1 / joint.stiffness) + 2.0 * joint.backlash / rate
    return float(np.diff(passages).mean()), exact, run


@pytest.mark.slow
def test_period_of_an_oscillator_with_a_gap() -> None:
    """Two halves of a free vibration in contact and two flights; second order in the step; energy is kept."""
    errors = []
    for dt in (4e-3, 2e-3, 1e-3):
        period, exact, run = oscillation(dt)
        errors.append(abs(period / exact - 1.0))
        energy = run.kinetic + run.strain_energy
        assert np.abs(energy / energy[0] - 1.0).max() < 300.0 * dt**1.5
        amplitude = 0.05 + 0.5 * np.sqrt(0.1 / 40.0)
        assert np.abs(run.joint_angles).max() == pytest.approx(amplitude, rel=5e-3)
    assert errors[-1] < 5e-4 and errors[2] < 0.5 * errors[0]


def rattling(joint: Joint) -> Scene:
    arm = Arm(
        "a", (Link(0.6, STRIP), Link(0.4, STRIP)), payload=Payload(0.1, 1e-5), hub_inertia=0.02, tau_d=2e-3,
        elbows=(Elbow(0.05, 1e-5, 1e-5),), joints=(joint, joint),
    )  # fmt: skip
    loads = JointTorque(0, sine(1.5, 6.28)), JointTorque(1, sine(0.6, 9.0))
    return Scene("s", arm, duration=1.0, dt=1e-3, sample=0.02, loads=loads, gravity=(0.0, -2.0))


@pytest.mark.slow
@pytest.mark.parametrize("side", ["motor", "link"])
def test_two_flexible_links_that_rattle(side: str) -> None:
    """With friction and damping: formulations agree, and the books close."""
    joint = dataclasses.replace(
        GEAR, stiffness=60.0, backlash=0.02, damping=0.02, friction_coulomb=0.05, friction_side=side
    )
    runs = [simulate(rattling(joint), f, estimate_error=False, **o) for f, o in METHODS]
    apart = runs[0].motor_angles - runs[0].joint_angles
    assert apart.max() > 0.01 and apart.min() < -0.01 and (np.abs(apart) < 0.009).any()
    for run in runs:
        assert run.finished and np.abs(run.balance).max() < 2e-3 * run.turned_over
        assert tips_apart(run, runs[0]) < 3e-3


@pytest.mark.slow
def test_rest_on_a_flank() -> None:
    """Under its weight a link lies on the flank: half the play below its motor, and what the spring gives."""
    scene = Scene("s", stiff_arm(), duration=1.0, dt=1e-3, gravity=(0.0, -9.81))
    rest = static_equilibrium(scene, "elastica", nodes=4)
    sunk = -rest.work.q[rest.system.coordinates["joint0"]]
    assert 40.0 * (sunk - 0.05) == pytest.approx(0.15 * 9.81 * np.cos(sunk), rel=1e-6)
    assert rest.joint_torques()[0] == pytest.approx(0.15 * 9.81 * np.cos(sunk), rel=1e-6)
    lying = dataclasses.replace(scene, angles=(-float(sunk),), gravity=None)
    hangs = modes(lying, 1, "elastica", nodes=4, clamped=()).frequencies[0]
    assert hangs < 1e-3  # motor and link begin at one angle, in the gap, where nothing couples them


@pytest.mark.slow
@every(METHODS)
@pytest.mark.parametrize("start", [0.5, 0.5 * np.pi - 0.03, 0.5 * np.pi + 0.03])
def test_a_link_behind_a_held_motor_falls_to_the_flank_on_its_side(
    start: float, formulation: str, options: dict[str, Any]
) -> None:
    """In the gap nothing holds it, so that rest cannot be followed from the unloaded arm. It lies half the play below
    its motor, and by what the spring gives to m g L cos / 2."""
    joint = dataclasses.replace(GEAR, backlash=1.0)
    scene = Scene("s", stiff_arm(joint), duration=1.0, dt=1e-3, gravity=(0.0, -9.81), angles=(start,))
    rest = static_equilibrium(everything(scene), formulation, hold_joints=True, **options)
    assert rest.stability.stable
    tip = rest.shape_points()[-1]
    angle = np.arctan2(tip[1], tip[0])
    sunk = start - angle if start < 0.5 * np.pi else angle - start
    assert 40.0 * (sunk - 0.5) == pytest.approx(0.15 * 9.81 * abs(np.cos(angle)), rel=1e-4)


@pytest.mark.slow
def test_environments_and_files() -> None:
    arm = dataclasses.replace(arms.named("strip_geared"), name="loose", joints=(
        dataclasses.replace(arms.named("strip_geared").joints[0], backlash=0.01),))  # fmt: skip
    assert arms.from_toml(arms.to_toml(arm)) == arm
    assert_pair_same(pair("FlexibleArm-v0", 3, arm=arm), 30)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["pd", "zv", "lqr"])
def test_controllers_are_designed_as_if_gears_had_no_play(name: str) -> None:
    """In it nothing couples motor and link, and no gain follows; slews end within a few times the play."""
    arm = arms.named("strip_geared")
    loose = dataclasses.replace(arm, joints=(dataclasses.replace(arm.joints[0], backlash=0.01),))
    env = gym.make("FlexibleArm-v0", arm=loose)
    errors = [observation[5] for observation, *_ in steered(env, control.make(name, env), seed=1)]
    assert np.abs(errors[-50:]).max() < 0.05
    assert arm_model(loose).frequencies.tolist() == arm_model(arm).frequencies.tolist()


@pytest.mark.slow
def test_initial_vibrations_are_those_of_gears_that_have_taken_hold() -> None:
    """In the play nothing couples motor and link: twice as many of the lowest motions are no vibrations there."""
    energies = []
    for play in (0.0, 0.01):
        arm = dataclasses.replace(arms.named("strip"), joints=(dataclasses.replace(GEAR, backlash=play),))
        env = gym.make("FlexibleArm-v0", arm=arm, info_level="full", initial_vibration=0.05)
        energies += [env.reset(seed=seed)[1]["energy_kinetic"] for seed in range(3)]
    assert min(energies[:3]) > 0.0 and energies[3:] == pytest.approx(energies[:3], rel=1e-9)
    spatial = dataclasses.replace(arms.named("turret_boom"), joints=(GEAR, GEAR))
    found = swing(spatial, Settings.make("geometrically_exact", elements=2, dt=0.0025))
    assert np.isfinite(found).all() and (found[-2] > 0.0).all()  # energies of bending both ways and of torsion


def test_refusals() -> None:
    with pytest.raises(ValueError, match=r"^backlash = 0.1: must be 0 where the stiffness is infinite"):
        Joint(backlash=0.1)
    with pytest.raises(ValueError, match=r"^backlash = -0.1: must be a number, zero or positive \(rad\)"):
        Joint(stiffness=1.0, motor_inertia=1.0, backlash=-0.1)
