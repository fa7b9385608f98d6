"""A payload whose centre of mass is not at the tip: known frequencies, a pendulum, large motion, books, errors."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from flexarm_env import arms, rigid
from flexarm_env.accuracy import slowest_rate
from flexarm_env.linear import modes, static_equilibrium
from flexarm_env.parameters import Arm, Elbow, Link, Payload, Section
from flexarm_env.physics.assembly import assemble
from flexarm_env.scene import Scene
from flexarm_env.settings import Settings
from flexarm_env.simulation import Simulation
from tests.env_tools import assert_pair_same, pair
from tests.oracle_ritz import ritz_frequencies
from tests.scene_tools import Method, every

STRIP = Section(EI=2.0, EA=2e7, C=2e7, m=0.3)
PAYLOAD = Payload(0.2, 1e-3, (0.05, 0.08))
METHODS: list[Method] = [
    ("geometrically_exact", {"elements": 16}),
    ("elastica", {"nodes": 12}),
    ("floating_frame", {"segments": 16}),
    ("floating_frame", {"segments": 16, "frame": "root"}),
    ("floating_frame", {"modes": 4}),
]


@pytest.mark.slow
@every(METHODS)
def test_frequencies_of_a_cantilever(formulation: str, options: dict[str, Any]) -> None:
    scene = Scene("s", Arm("a", (Link(1.0, STRIP),), payload=PAYLOAD), duration=1.0, dt=0.002)
    known = ritz_frequencies(scene.arm, 3)
    found = modes(scene, 3, formulation, clamped=True, **options).frequencies
    np.testing.assert_allclose(found, known, rtol=5e-4)
    assert slowest_rate(scene) == pytest.approx(known[0], rel=0.01)


@pytest.mark.slow
@every(METHODS[:3])
def test_rigid_pendulum(formulation: str, options: dict[str, Any]) -> None:
    """A stiff arm hangs so that the common centre of mass is below the hub, and swings about that as a rigid body."""
    stiff = Section(EI=1e5, EA=1e8, C=1e8, m=0.3)
    arm = Arm("a", (Link(1.0, stiff),), payload=PAYLOAD)
    along, across = 0.15 + 0.2 * 1.05, 0.2 * 0.08
    hangs = -0.5 * np.pi - np.arctan2(across, along)
    scene = Scene("s", arm, duration=1.0, dt=0.001, gravity=(0.0, -9.81), angles=(hangs + 0.05,))
    options = {key: min(value, 4) for key, value in options.items()}
    rest = static_equilibrium(scene, formulation, hold_joints=False, **options)
    assert rest.work.q[rest.system.coordinates["joint0"]] == pytest.approx(hangs, abs=1e-6)
    inertia = 0.1 + 1e-3 + 0.2 * (1.05**2 + 0.08**2)
    assert rigid.inertia_beyond(arm, 0) == pytest.approx(inertia, rel=1e-12)
    below = dataclasses.replace(scene, angles=(hangs,))
    found = modes(below, 1, formulation, clamped=(), **options).frequencies[0]
    assert found == pytest.approx(np.sqrt(9.81 * np.hypot(along, across) / inertia), rel=1e-5)


def test_rigid_arm_with_an_offset() -> None:
    """Inertia and Coriolis torques of two rigid links against Lagrange's equations of the payload's place alone."""
    arm = Arm("a", (Link(0.6, STRIP), Link(0.4, STRIP)), payload=PAYLOAD)
    light = dataclasses.replace(arm, payload=Payload())
    angles, rates = np.array([[0.3, 0.7]]), np.array([[0.4, -1.1]])

    def place(joints: Any) -> Any:
        second = joints[0] + joints[1]
        lever = 0.4 + complex(*PAYLOAD.offset)
        z = 0.6 * np.exp(1j * joints[0]) + lever * np.exp(1j * second)
        return np.array([z.real, z.imag])

    q, h = np.array([0.3, 0.7]), 1e-5
    jacobian = np.array([(place(q + h * e) - place(q - h * e)) / (2 * h) for e in np.eye(2)]).T
    inertia = PAYLOAD.mass * jacobian.T @ jacobian + PAYLOAD.inertia
    found = (rigid.rigid_inertia(arm, angles) - rigid.rigid_inertia(light, angles))[0]
    np.testing.assert_allclose(found, inertia, rtol=1e-6)
    h = 1e-4
    swept = (place(q + h * rates[0]) - 2.0 * place(q) + place(q - h * rates[0])) / h**2
    torque = PAYLOAD.mass * jacobian.T @ swept
    found = (rigid.coriolis(arm, angles, rates) - rigid.coriolis(light, angles, rates))[0]
    np.testing.assert_allclose(found, torque, rtol=1e-5)


@pytest.mark.slow
def test_momentum_in_free_flight() -> None:
    """What flies free of loads keeps its centre of mass, that of arm and payload: a coordinate of the elastica."""
    links, elbows = (Link(0.6, STRIP), Link(0.4, STRIP)), (Elbow(0.05, 1e-5, 1e-5),)
    arm = Arm("a", links, payload=PAYLOAD, hub_inertia=0.02, elbows=elbows, tau_d=2e-3)
    scene = Scene("s", arm, duration=1.0, dt=2e-3, root="free", angles=(0.2, -0.3), rates=(3.0, 5.0))
    flight = Simulation(scene, scene.settings("elastica", nodes=8))
    rows = [flight.system.coordinates[f"centre_{axis}"] for axis in "xy"]
    centre, rate = flight.work.q[rows].copy(), flight.work.v[rows].copy()
    assert flight.advance_to(1.0)
    np.testing.assert_allclose(flight.work.v[rows], rate, atol=1e-11)
    first, second = np.exp(0.2j), np.exp(-0.3j)  # of the straight links at the start, m
    elbow = 0.6 * first
    moments = 0.18 * 0.3 * first + 0.05 * elbow + 0.12 * (elbow + 0.2 * second)
    moments += 0.2 * (elbow + (0.4 + complex(*PAYLOAD.offset)) * second)
    np.testing.assert_allclose(complex(*centre), moments / (0.18 + 0.05 + 0.12 + 0.2), rtol=1e-12)
    np.testing.assert_allclose(flight.work.q[rows], centre + rate, atol=1e-10)


def test_no_offset_is_the_same_arm() -> None:
    for formulation, options in METHODS:
        for payload in (Payload(0.2, 1e-3), Payload(0.0, 1e-3, (0.1, 0.1))):
            scene = Scene("s", Arm("a", (Link(1.0, STRIP),), payload=payload), duration=1.0, dt=0.01)
            model = assemble(scene, Settings.make(formulation, dt=0.01, **options)).model
            assert model.eccentric is None


@pytest.mark.slow
def test_environments_and_files() -> None:
    """One arm and a vector of them, with payloads of their own; TOML."""
    arm = dataclasses.replace(arms.named("strip"), payload=PAYLOAD)
    assert arms.from_toml(arms.to_toml(arm)) == arm
    options: dict[str, Any] = {"arm": arm, "randomization": {"payload": (0.8, 1.2)}}
    assert_pair_same(pair("FlexibleArm-v0", 3, **options), 20)


def test_refusals() -> None:
    with pytest.raises(ValueError, match=r"^payload.offset = \(0.1,\): must be "):
        Payload(0.1, 0.0, (0.1,))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"^payload.offset\[1\] = 'b': must be a finite number"):
        Payload(0.1, 0.0, (0.1, "b"))  # type: ignore[arg-type]
    scene = Scene("s", Arm("a", (Link(1.0, STRIP),), payload=PAYLOAD), duration=1.0, dt=0.01)
    with pytest.raises(ValueError, match=r"^payload.offset = \(0.05, 0.08\): must be \(0, 0\) with multipliers=True"):
        assemble(scene, Settings.make(multipliers=True))
    with pytest.raises(ValueError, match=r"^period_correction = True: must be False where links have rigid ends, or"):
        assemble(scene, Settings.make("geometrically_exact", period_correction=True))
