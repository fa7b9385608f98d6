"""Contact points along links: a propped cantilever, the numbers of joints and links, files, and what is refused."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import gymnasium as gym
import pytest

from flexarm_env import (
    Arm,
    Contact,
    Elbow,
    Joint,
    JointTorque,
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
from flexarm_env.scene import at_points
from flexarm_env.shapes import HalfSpace
from flexarm_env.time_functions import constant
from tests.contact_tools import reading
from tests.physics.test_contact import moved
from tests.refusals import refusal

SOFT = Section(EI=1.0, EA=1e6, C=1e6, m=0.2, EI_y=1.0, GJ=1.0, C_y=1e6, J_y=1e-6, J=1e-6)
FORMULATIONS = (
    "elastica",
    *(pytest.param(f, marks=pytest.mark.slow) for f in ("geometrically_exact", "floating_frame")),
)


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("space", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_prop_along_a_cantilever(formulation: str, space: bool) -> None:
    """Under a small force P at the tip a stiff prop at a carries P (3 L - a) / 2 a; its sphere has a radius."""
    push, k, radius, a, out = 1e-3, 1e3, 0.02, 0.4, (0.0,) * space
    contact = Contact(
        HalfSpace((0.0, -radius, *out), (0.0, 1.0, *out)), k, exponent=1.0, bodies=("link0@0.4",), radius=radius
    )
    scene = Scene(
        "propped", Arm("propped", (Link(1.0, SOFT),), tau_d=0.1), duration=2.0, dt=5e-3, contacts=(contact,),
        motions=(Motion("joint0", constant(0.0)),), loads=(PointLoad(0, "tip", None, constant(-push)),), space=space,
    )  # fmt: skip
    run = moved(scene, formulation, rho_inf=0.5)
    # the prop of stiffness k gives by R / k: R (a^3 / 3 EI + 1 / k) = P a^2 (3 L - a) / 6 EI
    wanted = push * a * a * (3.0 - a) / 6.0 / (a**3 / 3.0 + 1.0 / k)
    assert reading(run)["normal"] == pytest.approx(wanted, rel=2e-3)


def test_joints_links_and_bodies_get_new_numbers() -> None:
    link = dataclasses.replace(Link(0.5, SOFT), root_offset=0.1, tip_offset=0.2)
    arm = Arm(
        "two", (link, Link(0.4, SOFT)), elbows=(Elbow(0.3, radius=0.01),), payload=Payload(0.1),
        joints=(Joint(), Joint(stiffness=5.0, motor_inertia=1e-3)),
    )  # fmt: skip
    floor = HalfSpace((0.0, -9.0), (0.0, 1.0))
    scene = Scene(
        "two", arm, duration=1.0, dt=1e-3, angles=(0.3, 0.7), rates=(1.0, 2.0),
        motions=(Motion("motor1", constant(0.4)),),
        loads=(JointTorque(0, constant(1.0)), PointLoad(0, "tip", constant(1.0))),
        contacts=(
            Contact(floor, 1e3, bodies=("tip", "link0@0.25", "joint1"), radius=0.02),
            Contact(floor, 1e3, bodies=("link1@0.5", "link0@0.75"), radius=0.03),
        ),
    )  # fmt: skip
    found = at_points(scene)
    assert [piece.length for piece in found.arm.links] == pytest.approx([0.125, 0.25, 0.125, 0.2, 0.2])
    assert [piece.root_offset for piece in found.arm.links] == [0.1, 0.0, 0.0, 0.0, 0.0]
    assert [piece.tip_offset for piece in found.arm.links] == [0.0, 0.0, 0.2, 0.0, 0.0]
    assert found.rigid_joints == (1, 2, 4)
    assert found.angles == (0.3, 0.3, 0.3, 0.7, 0.7) and found.rates == (1.0, 1.0, 1.0, 2.0, 2.0)
    assert [elbow.radius for elbow in found.arm.elbows] == [0.02, 0.03, 0.01, 0.03]
    assert found.arm.joints[3] == arm.joints[1] and found.motions[0].coordinate == "motor3"
    assert found.loads[0].joint == 0 and (found.loads[1].link, found.loads[1].end) == (2, "tip")
    assert [contact.bodies for contact in found.contacts] == [("tip", "joint1", "joint3"), ("joint4", "joint2")]
    assert math.isclose(found.arm.mass, arm.mass)
    assert at_points(found) is found


def test_an_untouched_point_does_not_change_the_motion() -> None:
    arm = arms.named("strip")
    floor = HalfSpace((0.0, -9.0), (0.0, 1.0))
    tips = []
    for bodies in (("tip",), ("tip", "link0@0.5")):
        scene = Scene(
            "swings", arm, duration=0.3, dt=1e-3, gravity=(0.0, -9.81), contacts=(Contact(floor, 1e3, bodies=bodies),)
        )
        run = simulate(scene, "elastica", estimate_error=False)
        tips.append(run.tip[-1, :2])
    assert tips[0] == pytest.approx(tips[1], abs=2e-4)
    assert abs(tips[0] - (1.0, 0.0)).max() > 0.1


def test_points_along_links_in_files_and_what_is_refused() -> None:
    floor = HalfSpace((0.0, -0.3), (0.0, 1.0))
    arm = Arm("strip", (Link(1.0, SOFT),))
    common: dict[str, Any] = {"duration": 1.0, "dt": 1e-3}
    scene = Scene("points", arm, contacts=(Contact(floor, 1e3, bodies=("link0@0.5",), radius=0.01),), **common)
    assert Scene.from_toml(scene.to_toml()) == scene
    for name in ("link0@0", "link0@1.0", "link0@", "link@0.5"):
        assert "with a fraction between 0 and 1" in refusal(lambda name=name: Contact(floor, 1e3, bodies=(name,)))
    other = Contact(floor, 1e3, bodies=("link1@0.5",))
    assert "must be on a link of arm strip" in refusal(lambda: Scene("other", arm, contacts=(other,), **common))
    two = tuple(Contact(floor, 1e3, bodies=("link0@0.5",), radius=radius) for radius in (0.01, 0.02))
    told = refusal(lambda: Scene("two", arm, contacts=two, **common))
    assert "contacts[1].radius = 0.02: must be 0.01 (m), as in contacts[0]" in told
    told = refusal(lambda: gym.make("FlexibleArm-v0", contacts=two))
    assert told.startswith("contacts[1].radius = 0.02: must be 0.01 (m)")
    bent = Arm("bent", (Link(1.0, SOFT, curvature=1.0),))
    scene = dataclasses.replace(scene, arm=bent)
    assert "must be straight" in refusal(lambda: Simulation(scene, scene.settings("elastica")))
    told = refusal(lambda: gym.make("FlexibleArm-v0", contacts=other))
    assert told.startswith("contacts[0].bodies[0] = 'link1@0.5': must be on a link of arm strip")
