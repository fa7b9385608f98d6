"""What turns the joints of arms in space: rotors on axes that turn, gears, play, friction; motors in environments."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import flexarm_env as fx
from flexarm_env import arms
from flexarm_env.linear import modes, static_equilibrium
from flexarm_env.rotations import matrices
from flexarm_env.time_functions import constant, linear_table, ramp, sine
from tests import space_answers as answers
from tests.env_tools import assert_pair_same, pair
from tests.scene_tools import everything

EXACT, FLOATING = "geometrically_exact", "floating_frame"
X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


def gimbal(*joints: fx.Joint, mass: float = 0.4) -> fx.Arm:
    """Yaw about z, pitch about y, then a wheel about the x axis of the pitching link: all rigid, of 0.1, 0.2, 0.1 m."""
    links = (
        fx.RigidLink(0.1, 1.0, (0.0, 0.0, 0.0), np.diag([0.01, 0.01, 0.01])),
        fx.RigidLink(0.2, 0.0, (0.0, 0.0, 0.0), np.diag([1e-4, 1e-4, 1e-4])),
        fx.RigidLink(0.1, mass, (0.0, 0.0, 0.0), np.diag([2e-3, 1e-3, 1e-3])),
    )
    return fx.Arm("gimbal", links, elbows=(fx.Elbow(axis=Y), fx.Elbow(axis=X)), joints=joints)


def run(scene: fx.Scene, how: str = EXACT, **options: Any) -> Any:
    """`scene_tools.everything`, friction and a rotor among it."""
    first, *others = (scene.arm.joint(k) for k in range(scene.arm.n_links))
    least = {name: max(1e-300, getattr(first, name)) for name in ("friction_coulomb", "motor_inertia")}
    arm = dataclasses.replace(scene.arm, joints=(dataclasses.replace(first, **least), *others))
    return answers.finished(everything(dataclasses.replace(scene, arm=arm)), how, **options)


# ------------------------------------------------------------------ rotors on axes that turn
@pytest.mark.parametrize("stiffness", [math.inf, 50.0])
def test_a_rotor_on_an_axis_that_turns_asks_for_its_gyroscopic_moment(stiffness: float) -> None:
    """Yaw at W, the wheel's motor at n w: the pitching joint must give I n w W more than without the rotor."""
    inertia, ratio, yaw, spin = 3e-4, 40.0, 1.5, 2.0
    torques = []
    for rotor in (0.0, inertia):
        joint = fx.Joint(stiffness=stiffness, motor_inertia=rotor, gear_ratio=ratio)
        name = "joint2" if stiffness == math.inf else "motor2"
        motions = (
            fx.Motion("joint0", ramp(yaw, 1.0)), fx.Motion("joint1", constant(0.0)), fx.Motion(name, ramp(spin, 1.0)),
        )  # fmt: skip
        arm = gimbal(fx.Joint(), fx.Joint(), joint)
        scene = fx.Scene("s", arm, duration=0.5, dt=1e-3, motions=motions, rates=(yaw, 0.0, spin))
        found = run(scene)
        assert np.ptp(found.joint_torque[5:, 1]) < 1e-8
        torques.append(found.joint_torque[-1, 1])
    # w x e = yaw z x (x axis) = yaw y, so that the moment about the pitching axis y is I n w W
    assert torques[1] - torques[0] == pytest.approx(inertia * ratio * spin * yaw, rel=1e-8)
    # the wheel's own momentum: 2e-3 kg m^2 about its axis
    assert torques[0] == pytest.approx(2e-3 * spin * yaw, rel=1e-8)


@pytest.mark.parametrize("stiffness", [math.inf, 50.0])
def test_a_spinning_rotor_carries_its_arm_round(stiffness: float) -> None:
    """A level top: m g l = (I n + I_wheel) w W, all joints free; without the rotor it falls."""
    inertia, ratio, spin, mass = 4e-3, 30.0, 20.0, 0.4
    lever, gravity = 0.2, 9.81
    momentum = (inertia * ratio + 2e-3) * spin
    yaw = mass * gravity * lever / momentum  # the weight's moment is about +y, and so is z x (momentum along x)
    joints = (fx.Joint(), fx.Joint(), fx.Joint(stiffness=stiffness, motor_inertia=inertia, gear_ratio=ratio))
    scene = fx.Scene(
        "top", gimbal(*joints), duration=1.0, dt=5e-4, sample=0.05, gravity=(0.0, 0.0, -gravity), rates=(yaw, 0.0, spin)
    )
    found = run(scene, rho_inf=1.0)
    assert np.abs(found.joint_angles[:, 1]).max() < 1e-5
    np.testing.assert_allclose(found.joint_angles[:, 0], yaw * found.t, atol=2e-5)
    np.testing.assert_allclose(found.joint_rates[:, 2], spin, rtol=1e-6)
    fallen = run(dataclasses.replace(scene, arm=gimbal(), duration=0.3))
    assert fallen.joint_angles[-1, 1] > 0.2


# ------------------------------------------------------------------ friction
@pytest.mark.parametrize("how", [EXACT, pytest.param(FLOATING, marks=pytest.mark.slow)])
def test_what_friction_takes_of_a_swinging_link(how: str) -> None:
    """A rigid link swings down about a level axis: Coulomb friction takes T_C times its way, viscous friction the
    integral of c w^2, both as the rigid pendulum has them."""
    mass, length, gravity, coulomb, viscous = 1.2, 0.6, 9.81, 0.3, 0.05
    inertia, weight = mass * length**2 / 3.0, mass * gravity * 0.5 * length
    link = fx.RigidLink(length, mass, (0.5 * length, 0.0, 0.0), np.diag([1e-5, *(mass * length**2 / 12.0,) * 2]))
    joint = fx.Joint(friction_coulomb=coulomb, friction_viscous=viscous)
    more = fx.RigidLink(0.1, 1e-9, (0.0, 0.0, 0.0), np.diag([1e-12, 1e-12, 1e-12]))
    arm = fx.Arm("p", (link, more), hub_axis=Y, hub_mount=((0.0, 0.0, 1.0), 0.4), joints=(joint, fx.Joint()))
    scene = fx.Scene("p", arm, duration=0.4, dt=5e-4, sample=0.01, gravity=(0.0, 0.0, -gravity), rigid_joints=(1,))
    found = run(scene, how, rho_inf=1.0)

    def pendulum(t: float, y: np.ndarray) -> list[float]:
        q, w, _ = y
        return [w, (weight * math.cos(q) - coulomb - viscous * w) / inertia, viscous * w * w]

    exact = solve_ivp(pendulum, (0.0, 0.4), [0.0, 0.0, 0.0], t_eval=found.t, rtol=1e-11, atol=1e-12).y
    np.testing.assert_allclose(found.joint_angles[:, 0], exact[0], atol=2e-6)
    assert exact[0, -1] > 1.0
    np.testing.assert_allclose(found.dissipated, coulomb * exact[0] + exact[2], atol=5e-6)
    assert np.abs(found.balance).max() < 1e-5


def test_below_friction_nothing_moves_and_a_level_arm_stays() -> None:
    """The yaw joint of a bent arm sticks while its torque is below T_C, to the last bit, and slides above it."""
    arm = dataclasses.replace(arms.named("three_dof"), joints=(fx.Joint(friction_coulomb=2.0), fx.Joint(), fx.Joint()))
    motions = (fx.Motion("joint1", constant(0.9)), fx.Motion("joint2", constant(0.4)))
    scene = fx.Scene(
        "s", arm, duration=0.1, dt=1e-3, angles=(0.0, 0.9, 0.4), motions=motions, gravity=(0.0, 0.0, -9.81),
        start="held", loads=(fx.JointTorque(0, sine(1.8, 20.0)),),
    )  # fmt: skip
    assert np.abs(run(scene).joint_angles[:, 0]).max() == 0.0
    more = dataclasses.replace(scene, loads=(fx.JointTorque(0, constant(4.0)),))
    assert run(more).joint_angles[-1, 0] > 1e-3


@pytest.mark.parametrize("rate", [-0.8, 0.0, 0.8])
@pytest.mark.parametrize("how", [EXACT, pytest.param(FLOATING, marks=pytest.mark.slow)])
def test_a_joint_with_friction_whose_base_is_struck(how: str, rate: float) -> None:
    """The base of a level link is at once drawn upwards at V. The blow has no moment about the joint, and friction no
    impulse, so that the link turns by m V l / 2I more, whether it slid down, rested or slid up. From then on, as seen
    from the base, which moves evenly, T_C / I takes its rate, in steps of any size."""
    mass, length, speed, coulomb, begin = 1.2, 0.6, 0.5, 0.3, 0.08
    inertia, blow = mass * length**2 / 3.0, mass * speed * 0.5 * length
    slow = coulomb / inertia
    link = fx.RigidLink(length, mass, (0.5 * length, 0.0, 0.0), np.diag([1e-5, *(mass * length**2 / 12.0,) * 2]))
    more = fx.RigidLink(0.1, 1e-9, (0.0, 0.0, 0.0), np.diag([1e-12, 1e-12, 1e-12]))
    arm = fx.Arm("p", (link, more), hub_axis=(0.0, -1.0, 0.0), joints=(fx.Joint(friction_coulomb=coulomb), fx.Joint()))
    drawn = fx.Motion("root_z", linear_table([0.0, begin, 1.1], [0.0, 0.0, (1.1 - begin) * speed]))
    before = rate - math.copysign(slow * begin, rate) if rate else 0.0
    scene = fx.Scene(
        "p", arm, duration=1.1, dt=4e-3, sample=0.02, motions=(drawn,), rigid_joints=(1,), rates=(rate, 0.0),
        angles=(-0.5 * begin * (rate + before), 0.0),
    )  # fmt: skip
    found = run(scene, how, rho_inf=1.0)
    struck, t = before - blow / inertia, found.t - begin
    stop = abs(struck) / slow
    after = struck - math.copysign(slow, struck) * t
    sliding, resting = (t > 1e-9) & (t < stop - scene.dt), t > stop + 2.0 * scene.dt
    np.testing.assert_allclose(found.joint_rates[sliding, 0], after[sliding], atol=1e-7)
    assert resting.any() and np.ptp(found.joint_angles[resting, 0]) < 1e-9
    way = 0.5 * begin * abs(rate + before) + 0.5 * abs(struck) * stop
    assert found.dissipated[-1] == pytest.approx(coulomb * way, rel=1e-3)
    # at the base: force over time times the mean of its velocities before and after
    assert found.work[-1] == pytest.approx(0.5 * mass * speed**2 - 0.5 * blow * (before + struck), rel=1e-3)


def test_joints_with_friction_of_a_bent_arm_whose_base_is_struck() -> None:
    """Two rods on oblique axes, a base that is at once drawn off obliquely. Lagrange's momenta of the joints, of both
    masses and the base's velocity, are as before after the blow, and change from then on by dT/dx - T_C sign x'."""
    mass, length, coulomb, begin = (0.9, 0.6), (0.5, 0.4), (0.08, 0.03), 0.05
    axes, velocity = (np.array([0.6, 0.0, 0.8]), np.array([0.0, 0.6, 0.8])), np.array([0.5, -0.7, 0.4])
    own = [np.diag([1e-4, *(m * x**2 / 12.0,) * 2]) for m, x in zip(mass, length, strict=True)]
    rods = tuple(fx.RigidLink(x, m, (0.5 * x, 0.0, 0.0), I) for m, x, I in zip(mass, length, own, strict=True))
    joints = tuple(fx.Joint(friction_coulomb=c) for c in coulomb)
    arm = fx.Arm("two", rods, hub_axis=tuple(axes[0]), elbows=(fx.Elbow(axis=tuple(axes[1])),), joints=joints)
    drawn = tuple(
        fx.Motion(f"root_{name}", linear_table([0.0, begin, 0.1], [0.0, 0.0, v * (0.1 - begin)]))
        for name, v in zip("xyz", velocity, strict=True)
    )
    scene = fx.Scene(
        "two", arm, duration=0.1, dt=1e-3, sample=1e-3, motions=drawn, angles=(0.3, 0.7), rates=(-0.8, 0.0), space=True
    )
    found = run(scene, rho_inf=1.0)

    def kinetic(x: np.ndarray, rates: np.ndarray, base: np.ndarray) -> float:
        A, w, v, total = np.eye(3), np.zeros(3), base, 0.0
        for k in range(2):
            w = w + rates[k] * (A @ axes[k])
            A = A @ matrices(x[k] * axes[k])
            centre = v + np.cross(w, A @ [0.5 * length[k], 0.0, 0.0])
            inner = A.T @ w
            total += 0.5 * mass[k] * centre @ centre + 0.5 * inner @ own[k] @ inner
            v = v + np.cross(w, A @ [length[k], 0.0, 0.0])
        return float(total)

    def slope(of: Any) -> np.ndarray:
        return np.array([(of(1e-4 * e) - of(-1e-4 * e)) / 2e-4 for e in np.eye(2)])

    momenta, forces = [], []
    for k, t in enumerate(found.t):
        x, rates, base = found.joint_angles[k], found.joint_rates[k], velocity * (t > begin + 1e-9)
        momenta.append(slope(lambda d: kinetic(x, rates + d, base)))  # noqa: B023
        forces.append(slope(lambda d: kinetic(x + d, rates, base)) - np.array(coulomb) * np.sign(rates))  # noqa: B023
    p, f, struck = np.array(momenta), np.array(forces), 50
    assert found.joint_rates[struck] @ [1.0, 0.0] < -0.5 and found.joint_rates[struck, 1] == 0.0
    assert (found.joint_rates[struck + 1] > 0.1).all()  # the one is turned round, the other begins to slide
    f[struck] = 2.0 * f[struck + 1] - f[struck + 2]  # those after the blow
    kept = (np.diff(p, axis=0) / 1e-3 - 0.5 * (f[1:] + f[:-1])) / coulomb
    assert np.abs(kept[struck:]).max() < 1e-4 and np.abs(kept[: struck - 1, 0]).max() < 1e-4
    assert 0.02 < np.abs(kept[: struck - 1, 1]).max() < 1.0  # where it sticks, what the other forces leave over


# ------------------------------------------------------------------ beside the plane
STRIP = fx.Section(EI=2.0, EA=2e5, C=7e4, m=0.3, J=1e-5, EI_y=8.0, C_y=7e4, J_y=1e-5, GJ=2.0)


def geared(**changes: Any) -> fx.Arm:
    """Two strips on damped elastic gears with rotors, friction and play."""
    common: dict[str, Any] = {"damping": 0.05, "backlash": 0.02, "friction_coulomb": 0.05, "friction_viscous": 0.02}
    gears = (fx.Joint(stiffness=30.0, motor_inertia=2e-4, gear_ratio=10.0, **common | changes),
             fx.Joint(stiffness=10.0, motor_inertia=1e-4, gear_ratio=8.0, **common | changes))  # fmt: skip
    return fx.Arm(
        "two", (fx.Link(0.6, STRIP), fx.Link(0.4, STRIP)), hub_inertia=0.02, elbows=(fx.Elbow(0.05, 1e-3, 1e-3),),
        payload=fx.Payload(0.1, 1e-4), tau_d=2e-3, joints=gears,
    )  # fmt: skip


@pytest.mark.slow
def test_modes_and_rest_on_a_gear_are_those_of_the_plane() -> None:
    """Frequencies with the motor free and held; the rest under gravity, the motor held."""
    arm = geared(backlash=0.0, friction_coulomb=0.0)
    scene = fx.Scene("s", arm, duration=1.0, dt=1e-3, angles=(0.2, 0.9), gravity=(0.0, 0.0))
    for held in ((), (0,), (0, 1)):
        plane = modes(scene, 5, EXACT, elements=8, order=2, clamped=held).frequencies
        space = modes(dataclasses.replace(scene, space=True), 16, elements=8, clamped=held).frequencies
        for omega in plane[plane > 1.0][:3]:
            assert np.abs(space / omega - 1.0).min() < 2e-3
    heavy = dataclasses.replace(scene, gravity=(0.0, -1.0))
    rests = [
        static_equilibrium(s, EXACT, **o)
        for s, o in ((heavy, {"elements": 8, "order": 2}), (dataclasses.replace(heavy, space=True), {"elements": 8}))
    ]
    torques = np.array([rest.joint_torques() for rest in rests])
    np.testing.assert_allclose(torques[1], torques[0], rtol=1e-4)
    for name in ("motor0", "motor1", "joint0", "joint1"):
        at = [rest.work.q[rest.system.coordinates[name]] for rest in rests]
        assert at[1] == pytest.approx(at[0], abs=1e-4)


# ------------------------------------------------------------------ environments
MOTOR = fx.Motor(torque_constant=0.05, resistance=1.0, current_limit=6.0, voltage_limit=24.0)
GEAR = fx.Joint(
    stiffness=300.0, damping=0.3, motor_inertia=2e-5, gear_ratio=40.0, friction_coulomb=0.1, backlash=0.002, motor=MOTOR
)


@pytest.mark.slow
def test_lanes_and_single_environments_with_geared_joints_are_equal_to_the_last_bit() -> None:
    """Motors that stick and slip behind gears with play under currents, drawn friction."""
    drawn = {"friction": (0.5, 1.5), "motor_inertia": (0.8, 1.2), "backlash": (0.5, 1.5)}
    arm = dataclasses.replace(arms.named("three_dof"), joints=(GEAR,) * 3)
    more: dict[str, Any] = {"elements": 1, "dt": 1e-3, "action_mode": "current", "randomization": drawn}
    assert_pair_same(pair("SpatialFlexArm-v0", 3, arm=arm, info_level="full", **more), 15, scale=0.7)


@pytest.mark.parametrize(
    ("formulation", "mesh"),
    [("elastica", {}), ("floating_frame", {}), pytest.param("floating_frame", {"modes": 3}, marks=pytest.mark.slow)],
)
def test_a_held_rigid_link_before_a_rotor_stays(formulation: str, mesh: dict[str, int]) -> None:
    """A motor's share in the section before it has no rows by strains, and what has those keeps its own. Its angle is
    behind all others, those of inner modes among them."""
    links = fx.Link(0.4, STRIP), fx.RigidLink(0.3, 0.3, (0.15, 0.0, 0.0), 2e-3), fx.Link(0.5, STRIP)
    elbows = fx.Elbow(0.1, 1e-4, 1e-4, (0.0, 0.6, 0.8)), fx.Elbow(0.1, 1e-4, 1e-4, (0.0, 0.8, 0.6))
    gear = fx.Joint(stiffness=35.0, damping=0.02, motor_inertia=2e-4, gear_ratio=30.0)
    arm = fx.Arm("a", links, elbows=elbows, tau_d=2e-3, joints=(fx.Joint(), fx.Joint(), gear))
    loads = fx.JointTorque(2, sine(-0.5, 6.0)), fx.JointTorque(0, sine(2.0, 6.0))
    scene = fx.Scene("s", arm, duration=0.1, dt=1e-3, angles=(0.2, 0.3, 0.4), loads=loads, space=True,
                     motions=(fx.Motion("joint1", constant(0.3)),))  # fmt: skip
    run = fx.simulate(scene, formulation, estimate_error=False, **mesh)
    assert run.finished and np.abs(run.joint_angles[:, 1] - 0.3).max() < 1e-12
    assert np.array_equal(run.motor_angles[:, 2], run.q[:, run.names.index("motor2")])
    assert np.abs(run.balance).max() < 1e-3 * run.turned_over
