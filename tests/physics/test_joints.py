"""Rotors, elastic gears and friction: frequencies, limits, large motion, stick and slip, the books."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

from flexarm_env import arms
from flexarm_env.linear import linearize, modes, static_equilibrium
from flexarm_env.parameters import Arm, Elbow, Joint, Link, Payload, Section
from flexarm_env.scene import JointTorque, Motion, Scene
from flexarm_env.simulation import Simulation, simulate
from flexarm_env.time_functions import TimeFunction, constant, cycloid, linear_table, ramp, sine, spline_table, steps
from flexarm_env.trajectory import Trajectory
from flexarm_env.validation import Array
from tests.oracle_ritz import ritz_frequencies
from tests.refusals import refuses
from tests.scene_tools import everything, tips_apart

METHODS: dict[str, tuple[str, dict[str, Any]]] = {
    "elastica": ("elastica", {"nodes": 10}),
    "exact": ("geometrically_exact", {"elements": 16}),
    "segments": ("floating_frame", {"segments": 10}),
    "elements": ("floating_frame", {"segments": 1, "elements": 10}),
    "modes": ("floating_frame", {"modes": 6}),
}


def methods(*usual: str, slow: tuple[str, ...] = ()) -> Any:
    """Formulations by name; those in `slow` for the slow tests, since each has kernels of its own to compile."""
    marked = (pytest.param(name, marks=pytest.mark.slow) for name in slow)
    return pytest.mark.parametrize("method", [*usual, *marked])


THREE = methods("elastica", slow=("exact", "segments"))
SLENDER = Section(EI=7.0, EA=7e7, C=7e7, m=0.277)
STIFF = Section(EI=1e4, EA=1e9, C=1e9, m=1e-3)


def scene(arm: Arm, load: TimeFunction | None = None, **values: Any) -> Scene:
    loads = () if load is None else (JointTorque(0, load),)
    return everything(Scene("s", arm, **{"duration": 1.0, "dt": 0.005, "sample": 0.02, "loads": loads} | values))


def run(where: Scene, method: str, **options: Any) -> Trajectory:
    formulation, usual = METHODS[method]
    found = simulate(where, formulation, estimate_error=False, **usual | options)
    assert found.finished, found.message
    return found


# --- frequencies ------------------------------------------------------------------------------------
@methods("elastica", slow=("exact", "segments", "elements", "modes"))
def test_frequencies_of_a_link_on_an_elastic_gear_with_rotor(method: str) -> None:
    """Motor free: a rigid turn, then three frequencies; the motor held: three. Against energies, 1e-4."""
    gear = Joint(stiffness=40.0, motor_inertia=5e-4, gear_ratio=12.0)
    arm = Arm("a", (Link(1.0, SLENDER),), hub_inertia=0.02, payload=Payload(0.1, 1e-4), joints=(gear,))
    formulation, options = METHODS[method]
    free = modes(scene(arm), 4, formulation, **options).frequencies
    assert free[0] == 0.0
    np.testing.assert_allclose(free[1:], ritz_frequencies(arm, 3, hinged=True), rtol=1e-4)
    held = modes(scene(arm), 3, formulation, clamped=True, **options).frequencies
    np.testing.assert_allclose(held, ritz_frequencies(arm, 3), rtol=1e-4)


@methods("elastica", slow=("exact", "segments"))
def test_cantilever_on_a_torsion_spring(method: str) -> None:
    """The motor held, so that it needs no inertia."""
    arm = Arm("a", (Link(1.0, SLENDER),), joints=(Joint(stiffness=20.0),))
    formulation, options = METHODS[method]
    options = options | {"segments": 16} if method == "segments" else options
    found = modes(scene(arm), 3, formulation, clamped=True, **options).frequencies
    np.testing.assert_allclose(found, ritz_frequencies(arm, 3), rtol=1e-4)
    refuses(r"joints\[0\].motor_inertia = 0.0: must be positive", lambda: modes(scene(arm), 3, formulation, **options))
    refuses(r"joints\[0\].motor_inertia = 0.0: must be positive", lambda: simulate(scene(arm), formulation, **options))


# --- limits -----------------------------------------------------------------------------------------
@THREE
def test_what_does_not_give_is_todays_arm_to_the_last_bit(method: str) -> None:
    arm = arms.named("strip")
    load = sine(1.5, 8.0)
    both = arm, dataclasses.replace(arm, joints=(Joint(),))
    plain, named = (run(scene(a, load, duration=0.2), method) for a in both)
    assert np.array_equal(plain.q, named.q)
    assert np.array_equal(plain.energy, named.energy)


@THREE
def test_the_rotor_of_a_stiff_gear_is_inertia_of_the_hub(method: str) -> None:
    """And a gear of 1e6 N m/rad is all but stiff."""
    arm = arms.named("strip")
    rotor = Joint(motor_inertia=2e-4, gear_ratio=10.0)
    heavier = dataclasses.replace(arm, hub_inertia=arm.hub_inertia + 0.02)
    geared = dataclasses.replace(arm, joints=(rotor,))
    stiff = dataclasses.replace(arm, joints=(dataclasses.replace(rotor, stiffness=1e6),))
    runs = [run(scene(a, sine(1.5, 8.0), dt=0.002), method) for a in (heavier, geared, stiff)]
    assert np.abs(runs[1].tip - runs[0].tip).max() < 1e-8  # the elastica's corrected inertia knows the hub's
    assert np.abs(runs[2].tip - runs[0].tip).max() < 1e-4
    assert np.abs(runs[1].energy - runs[0].energy).max() < 1e-8


# --- large motion -----------------------------------------------------------------------------------
def two_links(**changes: Any) -> Arm:
    """Two links of a strip on damped elastic gears; the second motor sits on the first link."""
    strip = Section(2.0, 2e6, 7e5, 0.3, 1e-7)
    gears = (Joint(stiffness=30.0, damping=0.05, motor_inertia=2e-4, gear_ratio=10.0, **changes),
             Joint(stiffness=10.0, damping=0.02, motor_inertia=1e-4, gear_ratio=8.0, **changes))  # fmt: skip
    return Arm(
        "two", (Link(0.6, strip), Link(0.4, strip)), hub_inertia=0.02, elbows=(Elbow(0.05, 1e-3, 1e-3),),
        payload=Payload(0.1, 1e-5), tau_d=2e-3, joints=gears,
    )  # fmt: skip


@methods(slow=("elastica", "segments"))
def test_two_links_on_gears_and_their_books(method: str) -> None:
    """Bent by a fifth of L: against the exact beam, and energy where friction and gears take some of it."""
    loads = (JointTorque(0, sine(2.2, 2.0 * math.pi)), JointTorque(1, sine(1.0, 2.0 * math.pi)))
    where = scene(two_links(friction_viscous=0.02, friction_coulomb=0.05), loads=loads, dt=1e-3, gravity=(0.0, -4.0))
    exact, other = run(where, "exact", elements=8), run(where, method)
    assert np.abs(exact.tip_deflection).max() > 0.15
    assert tips_apart(other, exact) < 1.5e-3
    assert other.dissipated[-1] == pytest.approx(exact.dissipated[-1], rel=0.01)
    for found in (exact, other):
        assert np.abs(found.balance).max() < 2e-3 * found.turned_over
        assert np.abs(found.motor_angles - found.joint_angles).max() > 0.01


@THREE
def test_steps_are_of_second_order(method: str) -> None:
    loads = (JointTorque(0, sine(1.0, 6.0)), JointTorque(1, sine(0.5, 9.0)))
    where = scene(two_links(), loads=loads, duration=0.4, sample=0.4)
    ends = [run(where, method, dt=dt, tolerance=1e-12, rho_inf=0.9).motor_angles[-1] for dt in (4e-3, 2e-3, 1e-3, 5e-4)]
    errors = np.abs(np.diff(ends, axis=0)).max(axis=1)
    assert 1.7 < math.log2(errors[1] / errors[2]) < 2.3


def test_a_motor_that_is_prescribed_needs_the_torque_that_would_move_it() -> None:
    """Motion("motor0", ...) and the torque that it reports, given to a motor that is free, are one motion."""
    arm = dataclasses.replace(two_links(), joints=(two_links().joints[0], Joint()))
    wanted = cycloid(1.0, 0.5)
    held = run(scene(arm, motions=(Motion("motor0", wanted),), duration=0.6, dt=1e-3), "elastica", sample=1e-3)
    np.testing.assert_allclose(held.motor_angles[:, 0], wanted(held.t), atol=1e-12)
    assert np.abs(held.joint_angles[:, 0] - held.motor_angles[:, 0]).max() > 5e-3
    torque = spline_table(held.t, held.joint_torque[:, 0])
    free = run(scene(arm, torque, duration=0.6, dt=1e-3), "elastica", sample=1e-3)
    np.testing.assert_allclose(free.motor_angles, held.motor_angles, atol=2e-5)
    np.testing.assert_allclose(free.tip, held.tip, atol=2e-5)
    assert np.abs(held.balance).max() < 1e-3 * held.turned_over


# --- linear models ----------------------------------------------------------------------------------
@pytest.mark.slow
@methods("elastica", "exact", "segments")
def test_rest_and_linear_model_know_the_motor(method: str) -> None:
    """Held at the motor's side the link sags by weight moment over stiffness, and more as it bends."""
    arm = dataclasses.replace(arms.named("strip"), joints=(Joint(stiffness=80.0, damping=0.1, motor_inertia=0.02),))
    formulation, options = METHODS[method]
    options = options | {"segments": 4} if method == "segments" else options
    where = scene(arm, gravity=(0.0, -1.0), dt=2e-3)
    rest = static_equilibrium(where, formulation, **options)
    motor, joint = rest.system.coordinates["motor0"], rest.system.coordinates["joint0"]
    torque = float(rest.joint_torques()[0])
    assert rest.work.q[motor] == pytest.approx(0.0, abs=1e-12)
    assert 80.0 * (rest.work.q[motor] - rest.work.q[joint]) == pytest.approx(torque, rel=1e-6)
    model = linearize(rest, discrete=0.02)
    assert {"motor0", "motor0_rate"} <= set(model.states) & set(model.outputs)
    pushed = Simulation(rest.scene, rest.settings)
    pushed.work.q[:], pushed.work.v[:] = rest.work.q, rest.work.v
    step = 1e-3
    pushed.set_torques(rest.joint_torques() + step)
    pushed.advance_to(0.02)
    moved = (pushed.work.q - rest.work.q)[[motor, joint]] / step
    at = [model.states.index(name) for name in ("motor0", "joint0")]
    np.testing.assert_allclose(model.B[at, 0], moved, rtol=2e-3)


# --- friction ---------------------------------------------------------------------------------------
def rubbed(A: float, p: float, J: float, coulomb: float, t: Array) -> Array:
    """Angle of an inertia J under A sin(p t) against Coulomb friction, from rest: slips end where the rate does, and
    begin where the torque next exceeds the friction, the other way."""
    q, start, sign, reached = np.zeros_like(t), math.asin(coulomb / A) / p, 1.0, 0.0

    while start < t[-1]:

        def rate(x: float, t0: float = start, s: float = sign) -> float:
            return A / (J * p) * (math.cos(p * t0) - math.cos(p * x)) - s * coulomb * (x - t0) / J

        def angle(x: Any, t0: float = start, s: float = sign) -> Any:
            swing = math.cos(p * t0) * (x - t0) - (np.sin(p * x) - math.sin(p * t0)) / p
            return A / (J * p) * swing - s * coulomb * (x - t0) ** 2 / (2.0 * J)

        stop = brentq(rate, start + 0.25 / p, start + 1.2 * math.pi / p)
        slipping = (t >= start) & (t < stop)
        q[slipping] = reached + angle(t[slipping])
        reached += float(angle(stop))
        q[t >= stop] = reached
        n = next(n for n in range(1000) if (math.pi * n + math.asin(coulomb / A)) / p >= stop and (-1) ** n == -sign)
        start, sign = (math.pi * n + math.asin(coulomb / A)) / p, -sign
    return q


GEARS = {"stiff gear": {}, "elastic gear": {"stiffness": 1e3}}


def rod(joint: Joint) -> Arm:
    """A rotor with a rod of all but no mass on it."""
    return Arm("rod", (Link(1.0, STIFF),), joints=(joint,))


@methods("elastica", slow=("exact", "modes"))
@pytest.mark.parametrize("gear", GEARS)
def test_stick_and_slip(gear: str, method: str) -> None:
    """Against the exact solution, with books that close."""
    arm = rod(Joint(motor_inertia=0.05, friction_coulomb=0.6, **GEARS[gear]))
    where = scene(arm, sine(1.0, 2.0 * math.pi), duration=3.0)
    options: dict[str, Any] = {"modes": {"modes": 1}, "exact": {"elements": 1, "order": 2}}.get(method, {"nodes": 4})
    found = run(where, method, **options, rho_inf=1.0 if method != "exact" else 0.8)
    exact = rubbed(1.0, 2.0 * math.pi, 0.05 + 1e-3 / 3.0, 0.6, found.t)
    assert np.abs(exact).max() > 0.35
    assert np.abs(found.motor_angles[:, 0] - exact).max() < 2e-3 * np.abs(exact).max()
    assert np.abs(found.balance).max() < (1e-9 if method != "exact" else 1e-3) * found.turned_over
    assert found.dissipated[-1] > 1.3


@pytest.mark.parametrize("gear", GEARS)
def test_below_friction_nothing_moves(gear: str) -> None:
    """Not in 10 s, nor after it has slipped; not at all behind a stiff gear."""
    arm = rod(Joint(motor_inertia=0.05, friction_coulomb=0.6, **GEARS[gear]))
    still = run(scene(arm, sine(0.59, 3.0), duration=10.0, dt=0.02), "elastica", nodes=4)
    assert np.abs(still.motor_angles).max() == 0.0
    stopped = run(scene(arm, steps([0.0, 0.5, 1.0], [1.5, -0.5, 0.55]), duration=11.0, dt=0.02), "elastica", nodes=4)
    after = stopped.motor_angles[stopped.t > 1.5, 0]
    assert abs(after[0]) > 0.5
    assert np.ptp(after) <= 1e-6


@methods("elastica", slow=("exact",))
@pytest.mark.parametrize("gear", GEARS)
def test_slip_under_a_torque_that_jumps(gear: str, method: str) -> None:
    """From 1.5 to -0.5 N m: q'' = (u - T) / J with T against the rate, to rest, where 0.5 N m does not move it; then
    -1.5 N m does. Against the exact parabolas."""
    arm = rod(Joint(motor_inertia=0.05, friction_coulomb=0.6, **GEARS[gear]))
    found = run(
        scene(arm, steps([0.0, 0.5, 1.0], [1.5, -0.5, -1.5]), duration=1.3, dt=2e-3), method,
        **({"elements": 1, "order": 2} if method == "exact" else {"nodes": 4}),
    )  # fmt: skip
    J, t = 0.05 + 1e-3 / 3.0, found.t
    fast, stopped = 0.9 / J * 0.5, 0.5 + 0.9 * 0.5 / 1.1
    exact = np.select(
        [t < 0.5, t < stopped, t < 1.0],
        [0.45 / J * t**2, 0.225 * 0.5 / J + fast * (t - 0.5) - 0.55 / J * (t - 0.5) ** 2,
         0.225 * 0.5 / J + 0.5 * fast * (stopped - 0.5)],
        0.225 * 0.5 / J + 0.5 * fast * (stopped - 0.5) - 0.45 / J * (t - 1.0) ** 2,
    )  # fmt: skip
    assert found.status == "ok"
    assert np.abs(found.motor_angles[:, 0] - exact).max() < 2e-3 * exact.max()


@pytest.mark.slow
@pytest.mark.parametrize("method", ["elastica", "exact"])
def test_a_joint_struck_and_turned_by_a_motion_loses_friction_times_its_way(method: str) -> None:
    """From rest to 1 rad/s at once, and to rest at once: beside what the link's own damping takes, T_C times the angle;
    the blows, which friction has no part in, are in the books."""
    arm, coulomb = rod(Joint(motor_inertia=0.05)), 0.6
    turned = Motion("joint0", linear_table([0.0, 0.3, 0.6], [0.0, 0.3, 0.3]))
    options: dict[str, Any] = {"elements": 1, "order": 2} if method == "exact" else {"nodes": 4}
    free, rubbed = (
        run(scene(dataclasses.replace(arm, joints=(joint,)), motions=(turned,), duration=0.6), method, **options)
        for joint in (arm.joint(0), dataclasses.replace(arm.joint(0), friction_coulomb=coulomb))
    )
    assert rubbed.dissipated[-1] - free.dissipated[-1] == pytest.approx(coulomb * 0.3, rel=1e-6)
    assert np.abs(rubbed.balance - free.balance).max() < 1e-9  # what the scheme takes of the rod's waves is in both


def test_strong_viscous_friction_sets_no_limit_to_steps() -> None:
    """1 N m s/rad on 1e-3 kg m^2 in steps of 20 ms, a time constant of 1 ms: 1 rad/s is reached and kept."""
    arm = rod(Joint(motor_inertia=1e-3, friction_viscous=1.0))
    found = run(scene(arm, constant(1.0), duration=4.0, dt=0.02), "elastica", nodes=4)
    assert np.abs(found.joint_rates).max() < 2.0
    assert found.joint_rates[-1, 0] == pytest.approx(1.0, rel=1e-4)


def test_friction_on_the_links_side_holds_it_while_the_gear_winds_up() -> None:
    """The motor is turned steadily: the link goes when the spring's torque is the friction's, and then
    J q'' = k (motor - q) - T: at rest again each 2 pi / omega."""
    stiffness, coulomb, speed = 20.0, 0.5, 0.4
    joint = Joint(stiffness=stiffness, motor_inertia=1e-3, friction_coulomb=coulomb, friction_side="link")
    arm = dataclasses.replace(rod(joint), hub_inertia=0.05)
    turned = Motion("motor0", ramp(speed * 2.0, 2.0))
    found = run(scene(arm, motions=(turned,), duration=1.0, dt=1e-3), "elastica", nodes=4)
    J = 0.05 + 1e-3 / 3.0
    omega, start = math.sqrt(stiffness / J), coulomb / stiffness / speed
    s = np.maximum(found.t - start, 0.0)
    exact = speed * (s - np.sin(omega * s) / omega)
    assert np.abs(found.joint_angles[:, 0] - exact).max() < 2e-3 * exact.max()


# --- what is refused --------------------------------------------------------------------------------
def test_what_is_refused() -> None:
    link = Link(1.0, SLENDER)
    gear = Joint(stiffness=10.0, motor_inertia=0.1)
    refuses(r"stiffness = 0.0: must be a positive number \(N m/rad\), or inf", lambda: Joint(stiffness=0.0))
    refuses(r"damping = 0.1: must be 0 where the stiffness is infinite", lambda: Joint(damping=0.1))
    refuses(r"joints = .*: must be empty or hold 1", lambda: Arm("a", (link,), joints=(gear, gear)))
    with pytest.raises(ValueError, match=r'motions\[0\].coordinate = \'motor0\': must be "joint0"'):
        scene(Arm("a", (link,)), motions=(Motion("motor0", constant(0.0)),))
    with pytest.raises(ValueError, match=r"arm.joints\[0\] = .*: must be an ideal Joint\(\) where the root is free"):
        scene(Arm("a", (link,), joints=(gear,)), root="free")
    with pytest.raises(ValueError, match="multipliers = True: must be False for an arm whose joints are not ideal"):
        simulate(scene(Arm("a", (link,), joints=(gear,))), "floating_frame", segments=2, multipliers=True)
