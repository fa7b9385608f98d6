"""Contact against known answers: bouncing, restitution, pressing, friction, impact of a beam, energy, order."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from flexarm_env import (
    Arm,
    Contact,
    Elbow,
    Link,
    Motion,
    Payload,
    PointLoad,
    Scene,
    Section,
    Simulation,
    arms,
    simulate,
)
from flexarm_env.compiler import uncompiled
from flexarm_env.linear import static_equilibrium
from flexarm_env.physics.equations import read_poses
from flexarm_env.physics.layout import POSE
from flexarm_env.shapes import Box, HalfSpace, Sphere
from flexarm_env.time_functions import constant, cycloid
from tests.contact_tools import reading

FORMULATIONS = ("elastica", "geometrically_exact", "floating_frame")
STIFF = Section(EI=1e6, EA=1e9, C=1e9, m=1e-6)
"""A link without mass that does not bend: its tip is a point mass on a circle."""
FLOOR = HalfSpace((0.0, 0.0), (0.0, 1.0))


def bar(mass: float, **more: Any) -> Arm:
    """One such link of 1 m with a point mass at its tip."""
    return Arm("bar", (Link(1.0, STIFF),), payload=Payload(mass=mass, **more))


def moved(scene: Scene, formulation: str = "elastica", **options: Any) -> Simulation:
    """The scene's arm at the scene's end."""
    simulation = Simulation(scene, scene.settings(formulation, **{"rho_inf": 1.0, **options}))
    assert simulation.advance_to(scene.duration), simulation.message
    return simulation


# --- bouncing -------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "formulation", [FORMULATIONS[0], *(pytest.param(name, marks=pytest.mark.slow) for name in FORMULATIONS[1:])]
)
def test_a_mass_bounces_off_a_linear_spring_for_half_a_period(formulation: str) -> None:
    mass, k, speed, start = 0.5, 2000.0, 0.05, 0.001
    omega = math.sqrt(k / mass)
    scene = Scene(
        "spring", bar(mass), duration=0.12, dt=2.5e-4, rates=(-speed,), angles=(start,),
        contacts=(Contact(FLOOR, k, exponent=1.0),),
    )  # fmt: skip
    run = moved(scene, formulation)
    found, touches = reading(run), math.pi / omega
    # it arrives at t = 0.02 s, leaves half a period later, as fast as it came
    assert -found["penetration"] == pytest.approx(speed * (0.12 - 0.02 - touches), rel=1e-4)
    assert found["peak"] == pytest.approx(speed * math.sqrt(k * mass), rel=1e-3)
    assert found["impulse"] == pytest.approx(2.0 * mass * speed, rel=1e-3)
    assert found["normal"] == 0.0 and not found["force"].any()


def restitution(speed: float, k: float, damping: float, mass: float, start: float) -> float:
    """Ratio of the speeds after and before, by the equation of the mass on its circle of 1 m."""

    def rates(_: float, y: NDArray[np.float64]) -> list[float]:
        depth, rate = -math.sin(y[0]), -math.cos(y[0]) * y[1]
        force = max(0.0, k * max(depth, 0.0) ** 1.5 * (1.0 + 1.5 * damping * rate))
        return [y[1], force * math.cos(y[0]) / mass]

    def back(_: float, y: NDArray[np.float64]) -> float:
        return float(y[0] - start)

    back.direction, back.terminal = 1, True  # type: ignore[attr-defined]
    run = solve_ivp(rates, (0.0, 1.0), [start, -speed], rtol=1e-12, atol=1e-14, events=back, max_step=1e-4)
    return float(run.y[1, -1] / speed)


@pytest.mark.parametrize("speed", [0.05, 0.2, 0.8])
def test_restitution_falls_with_speed_as_the_scalar_equation_says(speed: float) -> None:
    """To second order of the step: half the step, a quarter of the error."""
    mass, k, damping = 0.5, 1e5, 0.4
    start = 0.02 * speed
    exact, errors = restitution(speed, k, damping, mass, start), []
    for dt in (2e-4, 1e-4):
        scene = Scene(
            "hit", bar(mass), duration=0.12, dt=dt, rates=(-speed,), angles=(start,),
            contacts=(Contact(FLOOR, k, damping=damping),),
        )  # fmt: skip
        errors.append(abs(moved(scene).work.v[0] / speed - exact))
    assert errors[1] < 1e-5
    assert 3.0 < errors[0] / errors[1] < 6.0
    # low speeds: 1 - alpha v
    if speed < 0.1:
        assert exact == pytest.approx(1.0 - damping * speed, abs=1e-3)


def test_energy_balances_over_a_hundred_impacts() -> None:
    """Within 1e-4 of the energy that the contacts exchange, with and without loss."""
    mass, drop, k = 0.5, 0.02, 1e6
    speed = math.sqrt(2.0 * 9.81 * drop)
    # without loss an impact a flight of 0.147 s with its contact; with loss 60 impacts and then rest
    for damping, duration, impacts in ((0.0, 14.8, 100), (0.02, 6.0, 60)):
        scene = Scene(
            "bouncing", bar(mass), duration=duration, dt=1.25e-4, sample=0.01, angles=(drop,), gravity=(0.0, -9.81),
            contacts=(Contact(FLOOR, k, damping=damping),),
        )  # fmt: skip
        run = simulate(scene, "elastica", rho_inf=1.0, estimate_error=False)
        assert run.finished
        height = run.tip[:, 1]
        assert np.count_nonzero(np.diff(np.sign(np.diff(height))) < 0) >= impacts * (1.0 if damping == 0.0 else 0.5)
        # each impact stores and returns the kinetic energy of the fall
        exchanged = 0.5 * mass * speed**2 * (impacts if damping == 0.0 else 1.0)
        assert abs(run.balance).max() < (1e-5 if damping == 0.0 else 1e-3) * exchanged
        if damping == 0.0:
            assert height[-30:].max() == pytest.approx(drop, rel=1e-3)


# --- pressing -------------------------------------------------------------------------------------------
def pressed_strip(EI: float, angle: float, height: float, k: float) -> tuple[float, float, float]:
    """Force and tip of an inextensible strip of 1 m, clamped at `angle`, on a smooth floor at `height`, by shooting."""

    def tip(force: float, moment: float) -> NDArray[np.float64]:
        def rates(_: float, y: NDArray[np.float64]) -> list[float]:
            return [math.cos(y[2]), math.sin(y[2]), y[3], -force * math.cos(y[2]) / EI]

        run = solve_ivp(rates, (0.0, 1.0), [0.0, 0.0, angle, moment / EI], rtol=1e-11, atol=1e-13)
        return np.asarray(run.y[:, -1])

    def bent(force: float) -> NDArray[np.float64]:
        moment = brentq(lambda m: tip(force, m)[3], -5.0 * EI, 5.0 * EI, xtol=1e-14)
        return tip(force, float(moment))

    force = float(brentq(lambda f: f - k * max(height - bent(f)[1], 0.0) ** 1.5, 0.0, 2.0 * EI, xtol=1e-12))
    end = bent(force)
    return force, float(end[0]), float(end[1])


def test_a_pressed_strip_is_the_elastica_with_a_tip_force() -> None:
    EI, angle, k = 2.0, -0.5, 1e4
    arm = Arm("strip", (Link(1.0, Section(EI=EI, EA=1e8, C=1e8, m=0.2)),), tau_d=0.05)
    contacts = (Contact(HalfSpace((0.0, -0.3), (0.0, 1.0)), k, damping=1.0),)
    force, x, y = pressed_strip(EI, angle, -0.3, k)
    assert force > 1.0
    # the elastica at rest
    scene = Scene("pressed", arm, duration=1.0, dt=1e-3, angles=(angle,), contacts=contacts)
    rest = static_equilibrium(scene, "elastica", nodes=9)
    assert rest.shape_points()[-1] == pytest.approx((x, y), abs=1e-5)
    # the joint holds the moment of the force about the root
    assert rest.joint_torques()[0] == pytest.approx(-force * x, rel=1e-4)
    # an exact beam that is turned against the floor and comes to rest
    turn = Motion("joint0", cycloid(angle + 0.29, 1.0, -0.29))
    scene = Scene("turned", arm, duration=6.0, dt=2e-3, angles=(-0.29,), motions=(turn,), contacts=contacts)
    run = moved(scene, "geometrically_exact", elements=8, rho_inf=0.5)
    found = reading(run)
    assert found["normal"] == pytest.approx(force, rel=1e-4)
    assert -0.3 - found["penetration"] == pytest.approx(y, abs=1e-5)


# --- friction -------------------------------------------------------------------------------------------
@pytest.mark.parametrize("push", [2.0, 4.9, 5.1, 8.0])
def test_a_pressed_tip_slides_out_of_the_friction_cone_alone(push: float) -> None:
    """Pressed by 10 N at mu = 0.5 it creeps below 5 N, at v_s / sqrt((mu F_n / F)^2 - 1), and accelerates above."""
    mass, mu, k, creep, down = 0.5, 0.5, 1e5, 1e-4, 10.0
    link = Link(1.0, Section(EI=1e4, EA=1e7, C=1e7, m=1e-4))
    floor = HalfSpace((0.0, (down / k) ** (2.0 / 3.0)), (0.0, 1.0))
    scene = Scene(
        "pushed", Arm("two", (link, link), payload=Payload(mass=mass)), duration=0.2, dt=5e-4,
        angles=(math.pi / 3.0, -math.pi / 3.0), loads=(PointLoad(1, "tip", constant(push), constant(-down)),),
        contacts=(Contact(floor, k, damping=2.0, friction=mu, creep=creep),),
    )  # fmt: skip
    run = Simulation(scene, scene.settings("elastica", rho_inf=1.0))
    assert run.advance_to(0.1)
    before = float(reading(run)["sliding"])
    assert run.advance_to(0.2)
    after = float(reading(run)["sliding"])
    assert reading(run)["normal"] == pytest.approx(down, rel=1e-4)
    if push < mu * down:
        assert after == pytest.approx(creep / math.sqrt((mu * down / push) ** 2 - 1.0), rel=5e-3)
    else:
        assert (after - before) / 0.1 == pytest.approx((push - mu * down) / mass, rel=1e-3)


def test_friction_acts_on_the_surface_of_the_sphere() -> None:
    """It brakes a bar that stands on a floor below its hub with a lever of the length and the radius."""
    mass, radius, k, down, rate, time = 0.5, 0.1, 1e5, 5.0, 0.3, 5e-3
    floor = HalfSpace((0.0, -1.0 - radius + (down / k) ** (2.0 / 3.0)), (0.0, 1.0))
    arm = Arm("bar", (Link(1.0, Section(EI=1e4, EA=1e7, C=1e7, m=1e-4)),), payload=Payload(mass=mass, radius=radius))
    scene = Scene(
        "swings", arm, duration=time, dt=2.5e-4, angles=(-0.5 * math.pi,), rates=(rate,),
        contacts=(Contact(floor, k, friction=0.3),),
    )  # fmt: skip
    run = moved(scene, rho_inf=0.8)
    found, poses = reading(run), np.zeros(POSE.end)
    uncompiled(read_poses)(run.model, run.par, run.work.q, run.work.v, poses)
    # the surface moves with the center and, at the radius from it, with the tip's section
    assert found["sliding"] == pytest.approx(poses[POSE.tip_vx] + radius * poses[POSE.tip_rate], rel=1e-9)
    assert found["tangential"] == pytest.approx(0.3 * float(found["normal"]), rel=1e-4)
    assert found["force"][0] == pytest.approx(-float(found["tangential"]))
    lost = mass * (rate - poses[POSE.tip_vx])
    assert lost == pytest.approx((1.0 + radius) * 0.3 * down * time, rel=0.03)


# --- a beam ----------------------------------------------------------------------------------------------
def clamped_free(count: int) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Roots beta, tip values and means of the first modes of a clamped-free beam of length 1, of mean square 1."""
    roots, tips, means = [], [], []
    s = (np.polynomial.legendre.leggauss(200)[0] + 1.0) / 2.0
    weights = np.polynomial.legendre.leggauss(200)[1] / 2.0
    for j in range(count):
        guess = (j + 0.5) * math.pi
        beta = float(brentq(lambda b: math.cos(b) + 1.0 / math.cosh(b), guess - 0.6, guess + 0.6, xtol=1e-14))
        share = (math.cosh(beta) + math.cos(beta)) / (math.sinh(beta) + math.sin(beta))

        def shape(x: Any, beta: float = beta, share: float = share) -> Any:
            # cosh - share sinh without cancellation
            grows = 0.5 * (1.0 - share) * np.exp(beta * x) + 0.5 * (1.0 + share) * np.exp(-beta * x)
            return grows - np.cos(beta * x) + share * np.sin(beta * x)

        scale = math.sqrt(float(weights @ shape(s) ** 2))
        roots.append(beta)
        tips.append(float(shape(1.0)) / scale)
        means.append(float(weights @ shape(s)) / scale)
    return np.array(roots), np.array(tips), np.array(means)


@pytest.mark.parametrize(
    "formulation", ["elastica", pytest.param("geometrically_exact", marks=pytest.mark.slow)]
)
def test_a_beam_that_falls_on_a_stop_moves_as_its_modes_do(formulation: str) -> None:
    EI, m, g, gap, k = 1.0, 0.1, 0.05, 5e-4, 100.0
    arm = Arm("beam", (Link(1.0, Section(EI=EI, EA=1e7, C=1e7, m=m)),))
    stop = Box((1.0, -gap - 0.5), (0.4, 1.0))
    scene = Scene(
        "stop", arm, duration=0.6, dt=5e-4, sample=0.01, gravity=(0.0, -g),
        motions=(Motion("joint0", constant(0.0)),), contacts=(Contact(stop, k, exponent=1.0),),
    )  # fmt: skip
    run = simulate(
        scene, formulation, rho_inf=1.0, estimate_error=False,
        **({"nodes": 9} if formulation == "elastica" else {"elements": 6}),
    )  # fmt: skip
    assert run.finished
    beta, tips, means = clamped_free(8)
    omega2 = beta**4 * EI / m

    def rates(_: float, y: NDArray[np.float64]) -> NDArray[np.float64]:
        q, v = y[:8], y[8:]
        force = k * max(0.0, -gap - float(tips @ q))
        return np.concatenate([v, -omega2 * q - g * means + tips * force / m])

    modal = solve_ivp(rates, (0.0, 0.6), np.zeros(16), t_eval=run.t, rtol=1e-9, atol=1e-13, max_step=1e-4)
    deflection = tips @ modal.y[:8]
    assert deflection.min() < -1.05 * gap and deflection.max() > -0.6 * gap
    assert abs(run.tip[:, 1] - deflection).max() < 0.01 * abs(deflection).max()


# --- formulations ---------------------------------------------------------------------------------------
@pytest.mark.slow
def test_formulations_agree_on_an_arm_that_falls_and_slides() -> None:
    link = Link(0.5, Section(EI=5.0, EA=1e5, C=1e5, m=0.3))
    arm = Arm("two", (link, link), payload=Payload(mass=0.1, radius=0.02), tau_d=1e-3)
    contacts = (
        Contact(HalfSpace((0.0, -0.3), (0.0, 1.0)), 1e4, damping=0.5, friction=0.3, bodies=("tip", "joint1")),
        Contact(Sphere((0.3, -0.25), 0.1), 1e4, damping=0.5, friction=0.1, bodies=("joint1",)),
    )
    scene = Scene("falls", arm, duration=0.4, dt=5e-4, sample=0.01, gravity=(0.0, -9.81), contacts=contacts)
    tips = []
    for formulation in FORMULATIONS:
        run = simulate(scene, formulation, rho_inf=1.0, estimate_error=False)
        assert run.finished, run.message
        assert abs(run.balance).max() < 2e-3 * run.turned_over
        tips.append(run.tip[:, :2])
    assert max(abs(tip - tips[0]).max() for tip in tips) < 2e-3


@pytest.mark.parametrize(
    "formulation", ["elastica", *(pytest.param(name, marks=pytest.mark.slow) for name in FORMULATIONS[1:])]
)
@pytest.mark.parametrize("space", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_joint_touches_with_the_sphere_about_it(formulation: str, space: bool) -> None:
    """Moments about the hub: the joint's sphere carries link and forearm, N x = m g x / 2 + m g (x + 1/4)."""
    radius, k, out = 0.03, 1e5, (0.0,) * space
    link = Link(0.5, Section(EI=1e3, EA=1e6, C=1e6, m=0.4, EI_y=1e3, GJ=1e3, C_y=1e6, J_y=1e-6, J=1e-6))
    arm = Arm("two", (link, link), elbows=(Elbow(radius=radius),), tau_d=1e-3)
    contact = Contact(HalfSpace((0.0, -0.1, *out), (0.0, 1.0, *out)), k, damping=20.0, bodies=("joint1",))
    # the forearm is held level
    angle = -math.asin((0.1 - radius) / 0.5)
    scene = Scene(
        "elbow", arm, duration=0.5, dt=1e-3, angles=(angle, 0.0), gravity=(0.0, -9.81, *out), contacts=(contact,),
        motions=(Motion("joint1", constant(-angle)),), space=space,
    )  # fmt: skip
    run = moved(scene, formulation, rho_inf=0.5)
    found, x, weight = reading(run), 0.5 * math.cos(angle), 0.4 * 0.5 * 9.81
    assert found["normal"] == pytest.approx(weight * (0.5 * x + x + 0.25) / x, rel=5e-3)
    depth = (float(found["normal"]) / k) ** (2.0 / 3.0)
    assert found["penetration"] == pytest.approx(depth, rel=1e-3)
    middle = run.shape_points()[:, :2]
    elbow = middle[np.argmin(abs(np.hypot(*middle.T) - 0.5))]
    assert elbow[1] == pytest.approx(-0.1 + radius - depth, abs=1e-4)


def test_radius_of_an_elbow_in_files() -> None:
    arm = Arm("two", (Link(0.5, STIFF),) * 2, elbows=(Elbow(0.1, radius=0.03),))
    assert arms.from_table(arms.to_table(arm)) == arm
    with pytest.raises(ValueError, match=r"radius = -1\.0"):
        Elbow(radius=-1.0)


@pytest.mark.parametrize(
    "formulation", ["elastica", *(pytest.param(name, marks=pytest.mark.slow) for name in FORMULATIONS[1:])]
)
@pytest.mark.parametrize("space", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_point_along_a_link_is_a_rigid_joint(formulation: str, space: bool) -> None:
    """A cantilever on a prop in its middle under a small force P at its tip: the prop carries 5/2 P."""
    push, k, out = 1e-3, 1e3, (0.0,) * space
    half = Link(0.5, Section(EI=1.0, EA=1e6, C=1e6, m=0.2, EI_y=1.0, GJ=1.0, C_y=1e6, J_y=1e-6, J=1e-6))
    arm = Arm("propped", (half, half), tau_d=0.1)
    contact = Contact(HalfSpace((0.0, 0.0, *out), (0.0, 1.0, *out)), k, exponent=1.0, bodies=("joint1",))
    scene = Scene(
        "propped", arm, duration=2.0, dt=5e-3, rigid_joints=(1,), motions=(Motion("joint0", constant(0.0)),),
        loads=(PointLoad(1, "tip", None, constant(-push)),), contacts=(contact,), space=space,
    )  # fmt: skip
    run = moved(scene, formulation, rho_inf=0.5)
    # the prop of stiffness k gives by R / k: R (a^3 / 3 EI + 1 / k) = P a^2 (3 L - a) / 6 EI
    a = 0.5
    wanted = push * a * a * (3.0 - a) / 6.0 / (a**3 / 3.0 + 1.0 / k)
    assert reading(run)["normal"] == pytest.approx(wanted, rel=2e-3)
    assert wanted == pytest.approx(2.5 * push, rel=0.03)


def test_fitted_steps_resolve_an_impact() -> None:
    """Steps of 10 ms are halved where the tip touches; the error is within the estimate."""
    mass, k, damping, speed = 0.5, 1e5, 0.4, 0.8
    start = 0.1 * speed
    scene = Scene(
        "hit", bar(mass), duration=0.3, dt=1e-2, rates=(-speed,), angles=(start,),
        contacts=(Contact(FLOOR, k, damping=damping),),
    )  # fmt: skip
    run = simulate(scene, "elastica", rho_inf=1.0, step_tolerance=1e-5)
    assert run.status == "ok" and max(run.step_levels) >= 3
    assert abs(run.v[-1, 0] / speed - restitution(speed, k, damping, mass, start)) < 3e-4
    # equal steps as short as the shortest ones are more than twice as many
    assert run.steps < 0.5 * 30 * 2 ** max(run.step_levels)
