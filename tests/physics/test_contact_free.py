"""Contacts of arms that no support holds: a rod that falls and slides, impulses, a floating base, space."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from flexarm_env import Arm, Base, Contact, Joint, Link, Payload, Scene, Section, Simulation, simulate
from flexarm_env.shapes import HalfSpace
from tests.contact_tools import reading

FORMULATIONS = ("elastica", "geometrically_exact", "floating_frame")
OTHERS = ("elastica", *(pytest.param(name, marks=pytest.mark.slow) for name in FORMULATIONS[1:]))
L, M, G = 1.0, 1.0, 9.81
ROD = Arm("rod", (Link(L, Section(EI=1e5, EA=1e8, C=1e8, m=M / L)),))
FLOOR = HalfSpace((0.0, 0.0), (0.0, 1.0))


def sliding_rod(theta: float, mu: float, t: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
    """A rigid rod that leans on a floor and slides to -x: first normal force; angle and center of mass (2, times).

    Newton and Euler with the tip on the floor: y - L/2 sin theta = 0. Friction mu N pushes the tip to +x.
    """
    inertia = M * L * L / 12.0

    def rates(_: float, y: NDArray[np.float64]) -> list[float]:
        c, s = math.cos(y[0]), math.sin(y[0])
        force = (G - 0.5 * L * s * y[1] ** 2) / (1.0 / M + 0.25 * L * L * c * (c - mu * s) / inertia)
        return [y[1], -0.5 * L * (c - mu * s) * force / inertia, y[3], mu * force / M, force]

    first = rates(0.0, np.array([theta, 0.0, 0.0, 0.0]))[4]
    run = solve_ivp(
        lambda t, y: rates(t, y)[:4], (0.0, t[-1]), [theta, 0.0, 0.0, 0.0], t_eval=t, rtol=1e-10, atol=1e-12
    )
    return first, run.y[[0, 2]]


@pytest.mark.parametrize("formulation", OTHERS)
@pytest.mark.parametrize(("theta", "mu"), [(1.0, 0.0), (0.6, 0.2)])
def test_a_rod_falls_and_slides(formulation: str, theta: float, mu: float) -> None:
    """Within 4e-4 of the swing; the deviation is that of the floor's stiffness."""
    k, t = 1e7, np.linspace(0.0, 0.25, 26)
    force, (angle, center) = sliding_rod(theta, mu, t)
    depth = (force / k) ** (2.0 / 3.0)
    scene = Scene(
        "rod", ROD, duration=0.25, dt=2.5e-4, sample=0.01, root="free", gravity=(0.0, -G),
        position=(L * math.cos(theta), L * math.sin(theta) - depth), angles=(math.pi + theta,),
        contacts=(Contact(FLOOR, k, damping=20.0, friction=mu, creep=1e-5),),
    )  # fmt: skip
    run = simulate(scene, formulation, rho_inf=1.0, estimate_error=False)
    assert run.finished
    found = run.link_angles[:, 0, 0] - math.pi
    middle = 0.5 * (run.tip[:, 0] + run.shapes[:, 0, 0] - L * math.cos(theta))
    assert theta - angle[-1] > 0.4 and (center[-1] > 0.015 or mu == 0.0)
    assert abs(found - angle).max() < 4e-4 * (theta - angle[-1])
    assert abs(middle - center).max() < 2e-4
    if mu == 0.0:
        # energy: theta'^2 = 12 g (sin theta_0 - sin theta) / (L (1 + 3 cos^2 theta))
        rate = math.sqrt(
            12.0 * G * (math.sin(theta) - math.sin(angle[-1])) / (L * (1.0 + 3.0 * math.cos(angle[-1]) ** 2))
        )
        assert np.gradient(found, t, edge_order=2)[-1] == pytest.approx(-rate, rel=5e-3)
    assert abs(run.balance).max() < 1e-5 * run.turned_over


@pytest.mark.parametrize("formulation", OTHERS)
def test_a_rod_that_hits_a_wall_turns_by_the_impulse(formulation: str) -> None:
    """J = (1 + e) m_e v with m_e = m / (1 + 3 cos^2 theta), here e = 1; the center slows by J / m."""
    theta, speed, k = 1.1, 0.2, 1e6
    scene = Scene(
        "hits", ROD, duration=0.02, dt=5e-5, root="free", velocity=(0.0, -speed), angles=(math.pi + theta,),
        position=(L * math.cos(theta), L * math.sin(theta) + 5e-4), contacts=(Contact(FLOOR, k, exponent=1.0),),
    )  # fmt: skip
    run = Simulation(scene, scene.settings(formulation, rho_inf=1.0))
    assert run.advance_to(scene.duration)
    mass = M / (1.0 + 3.0 * math.cos(theta) ** 2)
    assert reading(run)["impulse"] == pytest.approx(2.0 * mass * speed, rel=2e-3)


def free_chain(base: Base | None) -> Arm:
    link = Link(0.5, Section(EI=5.0, EA=1e5, C=1e5, m=0.3))
    return Arm("chain", (link, link), payload=Payload(mass=0.1, radius=0.02), tau_d=1e-3, base=base)


@pytest.mark.slow
@pytest.mark.parametrize("joints", [(), (Joint(), Joint(stiffness=20.0, damping=0.01, motor_inertia=1e-3))])
def test_a_base_that_its_arm_pushes_off_a_wall(joints: tuple[Joint, ...]) -> None:
    """Formulations agree, energy balances, and a base that touched gains the momentum of the wall's impulse."""
    arm = dataclasses.replace(free_chain(Base(mass=3.0, inertia=0.1)), joints=joints)
    wall = Contact(HalfSpace((1.0, -0.06), (0.1, 1.0)), 1e4, damping=0.5, friction=0.3, bodies=("tip", "joint1"))
    tips, rest = [], []
    for dt in (1e-3, 5e-4):
        for formulation in FORMULATIONS:
            scene = Scene(
                "off", arm, duration=0.5, dt=dt, sample=0.01, root="free", velocity=(0.1, -0.3), rates=(0.2, 0.2),
                contacts=(wall,),
            )  # fmt: skip
            run = simulate(scene, formulation, rho_inf=1.0, estimate_error=False)
            assert run.finished, run.message
            rest.append(abs(run.balance).max() / run.turned_over)
            tips.append(run.tip[:, :2])
    assert max(rest[3:]) < 2e-3
    assert max(abs(tip - tips[3]).max() for tip in tips[3:]) < 3e-3
    # second order of the step: the momentum's correction contains the damping and friction of the wall
    assert abs(tips[0] - tips[3]).max() < 1e-5


@pytest.mark.slow
@pytest.mark.parametrize("formulation", ["elastica", "geometrically_exact"])
def test_a_free_arm_in_space_bounces_as_in_the_plane(formulation: str) -> None:
    """In space velocities are corrected by the impulses of the wall."""
    bar = Link(0.5, Section.circle(0.012, 3e9, 1200.0, 1.1e9))
    arm = Arm("two", (bar, bar), payload=Payload(mass=0.1, radius=0.02), tau_d=1e-3)
    tips = []
    for z in ((), (0.0,)):
        wall = HalfSpace((1.0, -0.03, *z), (0.1, 1.0, *z))
        scene = Scene(
            "flies", arm, duration=0.4, dt=1e-3, sample=0.01, root="free", velocity=(0.1, -0.3), rates=(0.2, 0.2),
            contacts=(Contact(wall, 1e4, damping=0.5, friction=0.3),), space=bool(z),
        )  # fmt: skip
        run = simulate(scene, formulation, rho_inf=1.0, estimate_error=False)
        assert run.finished and run.dissipated[-1] > 0.0
        assert abs(run.balance).max() < 2e-4 * run.turned_over
        tips.append(run.tip[:, :2])
    assert abs(tips[0] - tips[1]).max() < 1e-7
