"""Links that are bent without stress: rest, the moment that straightens them, frequencies, large motion."""

import dataclasses
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from flexarm_env import arms, rigid
from flexarm_env.compiler import SINGLE, uncompiled
from flexarm_env.linear import modes, static_equilibrium
from flexarm_env.parameters import Arm, Elbow, Link, Payload, Section
from flexarm_env.physics.assembly import assemble
from flexarm_env.physics.protocol import energy
from flexarm_env.scene import JointTorque, Motion, PointLoad, Scene
from flexarm_env.settings import Settings
from flexarm_env.simulation import simulate
from flexarm_env.time_functions import constant, sine
from tests.oracle_ritz import ritz_frequencies
from tests.scene_tools import Method, every, everything

STRIP = Section(EI=2.0, EA=2e6, C=2e6, m=0.3)
QUARTER = Link(1.0, STRIP, curvature=0.5 * np.pi)
SWAN = Link(0.8, STRIP, curvature=[(0.0, 2.0), (0.5, -1.0), (0.8, -3.0)])
METHODS: dict[str, Method] = {
    "exact": ("geometrically_exact", {"elements": 16}),
    "elastica": ("elastica", {"nodes": 12}),
    "segments": ("floating_frame", {"segments": 16}),
    "clamped": ("floating_frame", {"segments": 24, "frame": "root"}),
    "modes in segments": ("floating_frame", {"segments": 8, "modes": 3}),
}
NEAR = {"exact": 1e-6, "elastica": 1e-6, "segments": 2e-5, "clamped": 3e-4, "modes in segments": 1e-4}
"""How near a quarter circle's tip a mesh begins, m."""


def held(link: Link, loads: Any = (), **more: Any) -> Scene:
    arm, still = Arm("a", (link,), **more), (Motion("joint0", constant(0.0)),)
    return everything(Scene("s", arm, duration=0.5, dt=0.005, sample=0.05, loads=loads, motions=still))


def circle(angle: float, radius: float = 2.0 / np.pi) -> Any:
    return radius * np.array([np.sin(angle), 1.0 - np.cos(angle)])


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_a_quarter_circle_rests_without_stress(method: str) -> None:
    formulation, options = METHODS[method]
    run = simulate(held(QUARTER), formulation, estimate_error=False, **options)
    assert np.abs(run.strain_energy).max() < 1e-14 and np.abs(run.kinetic).max() < 1e-14
    np.testing.assert_allclose(run.tip[:, :2], [circle(0.5 * np.pi)] * len(run.t), atol=NEAR[method])
    np.testing.assert_allclose(run.tip[:, 2], 0.5 * np.pi, atol=1e-8)
    np.testing.assert_allclose(run.shapes[0][-1], run.tip[0, :2], atol=1e-12)
    apart = np.abs(np.hypot(*(run.shapes[0] - [0.0, 2.0 / np.pi]).T) - 2.0 / np.pi).max()
    assert apart < 1e-3  # all points drawn are on the circle
    assert np.abs(run.strain(0, 0.4, 0.01)).max() < 1e-10
    assert np.abs(run.tip_deflection).max() < 2.0 * NEAR[method]


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_the_moment_that_straightens_it(method: str) -> None:
    """M = -EI kappa at the tip, and as much work as the bent strip then holds, half EI kappa^2 L."""
    formulation, options = METHODS[method]
    moment = -STRIP.EI * 0.5 * np.pi
    scene = held(QUARTER, (PointLoad(0, "tip", torque=constant(moment)),))
    rest = static_equilibrium(scene, formulation, **options)
    np.testing.assert_allclose(rest.shape_points()[-1], [1.0, 0.0], atol=2e-5 if method != "clamped" else 5e-4)
    still = rest.record(0.05, 0.05)[0]["energies"][:, 1]
    np.testing.assert_allclose(still, 0.5 * STRIP.EI * (0.5 * np.pi) ** 2, rtol=1e-6)


@every(METHODS.values(), slow=("geometrically_exact", "floating_frame"))
@pytest.mark.parametrize("link", [QUARTER, SWAN, Link(1.0, STRIP, curvature=0.3)], ids=["quarter", "swan", "shallow"])
def test_frequencies(formulation: str, options: dict[str, Any], link: Link) -> None:
    """Three of a cantilever with an eccentric payload, against its energies."""
    payload = Payload(0.1, 1e-4, (0.02, 0.03))
    known = ritz_frequencies(Arm("a", (link,), payload=payload), 3)
    found = modes(held(link, payload=payload), 3, formulation, clamped=True, **options).frequencies
    np.testing.assert_allclose(found, known, rtol=4e-4)


def swung() -> Scene:
    """A bent link with a tapered one behind it, with rigid ends."""
    second = dataclasses.replace(
        Link.tapered(0.5, (0.02, 0.015), (6e-3, 4e-3), E=7e9, rho=2700.0, G=2.6e9), curvature=-1.5, root_offset=0.05,
        tip_offset=0.03, tip_mass=0.02,
    )  # fmt: skip
    arm = Arm("a", (SWAN, second), payload=Payload(0.1, 1e-4, (0.02, 0.05)), hub_inertia=0.02, tau_d=2e-3,
              elbows=(Elbow(0.05, 1e-5, 1e-5),))  # fmt: skip
    loads = JointTorque(0, sine(2.0, 6.28)), JointTorque(1, sine(0.8, 6.28))
    return Scene("s", arm, duration=1.0, dt=1e-3, sample=0.02, gravity=(0.0, -4.0), loads=loads, angles=(0.2, -0.3))


@pytest.mark.slow
def test_a_link_behind_a_bent_one_begins_where_that_ends() -> None:
    scene = swung()
    fine = simulate(scene, "geometrically_exact", elements=12, duration=0.02, estimate_error=False)
    assert fine.joint_angles[0, 1] == pytest.approx(-0.3 - 0.2 - SWAN.turn, abs=1e-9)
    links = scene.arm.links
    place = links[0].place(0.8) * np.exp(0.2j) + links[1].place(0.53) * np.exp(-0.3j)
    np.testing.assert_allclose(fine.tip[0, :2], [place.real, place.imag], atol=1e-5)


def test_rigid_inertia() -> None:
    """Of stiff bent links against the kinetic energy that the elastica starts with."""
    scene = dataclasses.replace(swung(), loads=(), gravity=None)
    inertia = rigid.rigid_inertia(scene.arm, np.array([[0.0, scene.initial_value("joint1")]]))[0]
    turning = dataclasses.replace(scene, rates=(2.0, 3.0))
    begun = assemble(turning, turning.settings("elastica", nodes=12))
    kinetic = uncompiled(energy)(SINGLE, begun.model, begun.par, begun.q0, begun.v0)[0]
    w = np.array([2.0, 1.0])  # joint rates
    assert kinetic == pytest.approx(0.5 * w @ inertia @ w, rel=1e-6)


def test_straight_is_the_same_arm() -> None:
    for formulation, options in METHODS.values():
        one, other = (
            assemble(held(link), Settings.make(formulation, dt=0.01, **options)).model
            for link in (Link(1.0, STRIP), Link(1.0, STRIP, curvature=[(0, 0), (0.4, 0.0), (1, 0)]))
        )
        assert type(one) is type(other) and [x is None for x in one] == [x is None for x in other]


def test_files_and_refusals() -> None:
    arm = swung().arm
    assert arms.from_toml(arms.to_toml(arm)) == arm
    assert Link(1.0, STRIP, curvature=[(0.0, 2.0), (1.0, 2.0)]).curvature == 2.0
    for value, message in (
        ([(0.1, 1.0), (1.0, 2.0)], r"^curvature\[0\]\[0\] = 0.1: must be 0, the link's root"),
        ([(0.0, 1.0), (0.9, 2.0)], r"^curvature\[1\]\[0\] = 0.9: must be the link's length, 1 m"),
        ([(0.0, 1.0)], r"^curvature = .* must be a number \(1/m\) or two or more pairs"),
        ([(0.0, 1.0), (0.6, 2.0), (0.5, 1.0), (1.0, 0.0)], r"^curvature\[2\]\[0\] = 0.5: must not be below"),
    ):
        with pytest.raises(ValueError, match=message):
            Link(1.0, STRIP, curvature=value)
    for options in ({"multipliers": True}, {"coupling": "paper"}, {"coupling": "linear"}):
        with pytest.raises(ValueError, match=r"^links\[0\].curvature = 1.57.*: must be 0 with multipliers=True and"):
            assemble(held(QUARTER), Settings.make(**options))
    with pytest.raises(ValueError, match=r"arm.links\[0\].curvature = 1.57.*: must be 0 in the environments"):
        gym.make("FlexibleArm-v0", arm=Arm("a", (QUARTER,), torque_limits=(1.0,)))
