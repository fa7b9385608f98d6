"""Moving obstacles: the same arm in the obstacle's frame, the energy balance, files, and what is refused."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from flexarm_env import Arm, Contact, Link, Motion, Payload, Scene, Section, arms, simulate
from flexarm_env.linear import static_equilibrium
from flexarm_env.shapes import Box, HalfSpace, Sphere
from flexarm_env.time_functions import TimeFunction, constant, ramp, sine
from tests.refusals import refusal

LINK = Link(0.5, Section(EI=5.0, EA=1e5, C=1e5, m=0.3))
TWO = Arm("two", (LINK, LINK), payload=Payload(mass=0.1, radius=0.02), tau_d=1e-3)
BOX = Box((0.8, -0.2), (0.6, 0.3), 0.1)
FLOOR = HalfSpace((0.0, -0.3), (0.0, 1.0))
SPEED, ACCELERATION = 0.3, 4.0


def falling(share: float) -> TimeFunction:
    """A displacement with constant acceleration, m."""
    return TimeFunction([[0.0, 0.0, share * SPEED, 0.5 * share * ACCELERATION, 0.0, 0.0, 1.0, 0.0]])


def in_both_frames(arm: Arm, contact: Contact, angles: tuple[float, ...] = ()) -> tuple[Scene, Scene, np.ndarray]:
    """An obstacle that approaches with constant acceleration; the root that approaches it, with d'Alembert's force.

    Also the direction of the displacement.
    """
    space = contact.spatial
    way = np.array([0.0, 0.5, 1.0] if space else [0.5, 1.0])
    names = [name for name, share in zip("xyz", way, strict=False) if share]
    shares = dict(zip("xyz", way, strict=False))
    moving = dataclasses.replace(contact, **{f"displacement_{name}": falling(shares[name]) for name in names})
    common = {"arm": arm, "duration": 0.25, "dt": 5e-4, "sample": 0.01, "angles": angles}
    roots = tuple(Motion(f"root_{name}", falling(-shares[name])) for name in names)
    return (
        Scene("obstacle", contacts=(moving,), **common),
        Scene(
            "root", contacts=(contact,), motions=roots, velocity=tuple(-SPEED * way),
            gravity=tuple(-ACCELERATION * way), **common,
        ),
        way,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("formulation", "obstacle"),
    [
        ("elastica", HalfSpace((0.0, -0.05), (0.1, 1.0))),
        pytest.param("elastica", Sphere((0.9, -0.25), 0.2), marks=pytest.mark.slow),
        pytest.param("geometrically_exact", BOX, marks=pytest.mark.slow),
        pytest.param("floating_frame", BOX, marks=pytest.mark.slow),
    ],
)
def test_a_moving_obstacle_is_a_moving_root_in_its_frame(formulation: str, obstacle: HalfSpace | Sphere | Box) -> None:
    """Galilei and d'Alembert: to round-off (with Newton's tolerance where its matrix is approximate)."""
    contact = Contact(obstacle, 1e4, damping=0.5, friction=0.3, bodies=("tip", "joint1"))
    here, there, way = in_both_frames(TWO, contact)
    runs = [simulate(scene, formulation, rho_inf=1.0, estimate_error=False) for scene in (here, there)]
    assert all(run.finished for run in runs)
    moved = SPEED * runs[0].t + 0.5 * ACCELERATION * runs[0].t ** 2
    assert abs(runs[0].tip[-1, :2] - runs[0].tip[0, :2]).max() > 0.05
    assert abs(runs[0].tip[:, :2] - runs[1].tip[:, :2] - np.outer(moved, way)).max() < 1e-8
    for run in runs:
        assert abs(run.balance).max() < 2e-4 * run.turned_over


@pytest.mark.slow
@pytest.mark.parametrize("formulation", ["elastica", "geometrically_exact", "floating_frame"])
def test_a_moving_obstacle_in_space_is_a_moving_root_in_its_frame(formulation: str) -> None:
    arm = dataclasses.replace(arms.named("three_dof"), payload=Payload(mass=0.2, radius=0.02))
    # the tip begins at (0.966, 0.196, 0.072)
    contact = Contact(HalfSpace((0.966, 0.196, 0.03), (0.0, 0.2, 1.0)), 2e4, damping=0.5, friction=0.3)
    here, there, way = in_both_frames(arm, contact, (0.2, 1.5, 0.3))
    runs = [simulate(scene, formulation, rho_inf=1.0, estimate_error=False) for scene in (here, there)]
    assert all(run.finished for run in runs)
    moved = SPEED * runs[0].t + 0.5 * ACCELERATION * runs[0].t ** 2
    assert abs(runs[0].tip[-1] - runs[0].tip[0]).max() > 0.02
    assert abs(runs[0].tip - runs[1].tip - np.outer(moved, way)).max() < 1e-6


def test_the_work_of_a_shaking_wall_is_what_the_arm_gains_and_loses() -> None:
    """The remainder of the balance falls with the square of the step."""
    wall = Contact(HalfSpace((0.0, -0.03), (0.0, 1.0)), 1e4, damping=0.5, friction=0.3, displacement_y=sine(0.03, 12.0))
    rest = []
    for dt in (5e-4, 2.5e-4):
        scene = Scene("shaken", TWO, duration=0.6, dt=dt, sample=0.01, contacts=(wall,), start="held")
        run = simulate(scene, "elastica", rho_inf=1.0, estimate_error=False)
        assert run.finished and run.work[-1] > 5.0 * run.dissipated[-1] > 0.0
        rest.append(abs(run.balance).max() / run.turned_over)
    assert rest[0] < 2e-4
    assert rest[1] < 0.4 * rest[0]


def test_an_arm_rests_on_an_obstacle_where_it_is_at_the_start() -> None:
    """A displaced obstacle is an obstacle at another place."""
    arm = Arm("strip", (Link(1.0, Section(EI=2.0, EA=1e8, C=1e8, m=0.2)),))
    moved = Contact(HalfSpace((0.0, -0.5), (0.0, 1.0)), 1e4, damping=1.0, displacement_y=ramp(0.3, 1.0, 0.2))
    still = Contact(HalfSpace((0.0, -0.3), (0.0, 1.0)), 1e4, damping=1.0)
    tips = []
    for contact in (moved, still):
        scene = Scene("pressed", arm, duration=1.0, dt=1e-3, angles=(-0.5,), contacts=(contact,))
        tips.append(static_equilibrium(scene, "elastica", nodes=5).shape_points()[-1])
    assert tips[0] == pytest.approx(tips[1], abs=1e-9)
    assert tips[0][1] < -0.25


def test_moving_obstacles_in_files() -> None:
    wall = Contact(FLOOR, 1e4, displacement_y=sine(0.03, 12.0), displacement_x=constant(0.1))
    scene = Scene("moved", TWO, duration=0.6, dt=5e-4, contacts=(wall,))
    assert Scene.from_toml(scene.to_toml()) == scene
    text = scene.to_toml().replace('kind = "sine"', 'kind = "sinus"')
    assert "contacts[0].displacement_y.kind = 'sinus'" in refusal(lambda: Scene.from_toml(text))


def test_what_moving_obstacles_refuse() -> None:
    floor = FLOOR
    told = refusal(lambda: Contact(floor, 1e4, displacement_y=0.1))  # type: ignore[arg-type]
    assert told.startswith("displacement_y = 0.1: must be a TimeFunction, or in environments")
    assert told.endswith("a table with kind and parameters")
    jump = TimeFunction([[0.0, *(0.0,) * 5, 1.0, 0.0], [1.0, 0.1, *(0.0,) * 4, 1.0, 0.0]])
    assert "must not jump" in refusal(lambda: Contact(floor, 1e4, displacement_y=jump))
    up = Contact(floor, 1e4, displacement_z=constant(0.1))
    told = refusal(lambda: Scene("up", TWO, duration=1.0, dt=1e-3, contacts=(up,)))
    assert told.startswith("contacts[0].displacement_z = ") and "in the plane" in told
    # the impact of an obstacle at 6 m/s must last 8 steps
    hits = Contact(floor, 1e4, displacement_y=sine(0.06, 100.0))
    told = refusal(lambda: simulate(Scene("hits", TWO, duration=1.0, dt=3.3e-3, contacts=(hits,))))
    assert told.startswith("contacts[0].stiffness = 10000.0: must be at most") and "an impact at 6 m/s" in told
    # a fast obstacle shortens the steps, one that is too fast is refused by name
    fast = Contact(floor, 1e4, displacement_y=sine(1e-3, 2.0 * math.pi * 1e8))
    told = refusal(lambda: simulate(Scene("fast", TWO, duration=1.0, dt=1e-3, contacts=(fast,))))
    assert told.startswith("contacts[0].displacement_y = 'too fast")
