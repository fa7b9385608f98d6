"""Reduction to modes: its error against the exact beam, the range it reports, and its stop before it breaks down."""

from typing import Any

import numpy as np
import pytest

from flexarm_env import simulate
from flexarm_env.compiler.lanes import SINGLE
from flexarm_env.linear import modes as frequencies
from flexarm_env.parameters import Arm, Elbow, Link, Payload, Section
from flexarm_env.physics.floating.build import MARGIN_LOST, MODAL_BOUND
from flexarm_env.physics.protocol import energy
from flexarm_env.scene import JointTorque, Scene
from flexarm_env.scenes import named
from flexarm_env.simulation import Simulation
from flexarm_env.time_functions import TimeFunction, sine
from tests.scene_tools import everything, tips_apart

SOFT = Arm("soft", (Link(1.0, Section(2.0, 2e6, 1e6, 0.5, 1e-6)),), hub_inertia=0.05, payload=Payload(0.1))
STRIP = Section(EI=7.0, EA=7.2e6, C=2.3e6, m=0.277, J=2.7e-7)
TWO = Arm("two", (Link(1.0, STRIP),) * 2, hub_inertia=0.05, elbows=(Elbow(0.1, 0.01, 0.02),), payload=Payload(0.2))


def to_and_fro(torque: float) -> TimeFunction:
    pieces = np.zeros((3, 8))
    pieces[:, 0], pieces[:, 1] = [0.0, 0.4, 0.8], [torque, -torque, 0.0]
    return TimeFunction(pieces)


@pytest.mark.parametrize(("arm", "torques", "bound"), [(SOFT, (0.26,), 2e-3), (TWO, (0.53, 0.16), 5e-3)])
def test_error_at_a_tenth_of_the_length(arm: Arm, torques: tuple[float, ...], bound: float) -> None:
    """Undamped, 5 s, links bent by a tenth of their length: within 0.2 % of L, two links within 0.5 %."""
    loads = tuple(JointTorque(k, to_and_fro(torque)) for k, torque in enumerate(torques))
    scene = everything(Scene("s", arm, duration=5.0, dt=1e-3, sample=0.02, loads=loads))
    exact = simulate(scene, "geometrically_exact", elements=12, rho_inf=0.9, dt=5e-4, estimate_error=False)
    run = simulate(scene, "floating_frame", modes=3, rho_inf=1.0, estimate_error=False)
    assert run.status == exact.status == "ok"
    assert np.abs(exact.tip_deflection).max() == pytest.approx(0.1, abs=0.005)
    error = tips_apart(run, exact)
    assert error < 0.4 * bound
    assert (run.deflection_bound, exact.deflection_bound) == (MODAL_BOUND, np.inf)


def test_modes_in_segments_follow_a_large_deflection() -> None:
    """A link bent by half of its length, far beyond what modes of the whole can do: within 1 % of L, and it says so."""
    scene = everything(named("robot_arm_motion"))
    exact = simulate(scene, "geometrically_exact", elements=16, dt=0.0125, sample=0.1, estimate_error=False)
    run = simulate(scene, "floating_frame", modes=3, segments=5, dt=0.1, sample=0.1)
    assert np.abs(exact.tip_deflection).max() > 0.45
    assert (run.status, run.deflection_bound) == ("ok", np.inf)
    error = tips_apart(run, exact)
    assert error < 0.01
    assert 0.5 * error < run.error_estimate < 5.0 * error
    whole = simulate(scene, "floating_frame", modes=3, dt=0.1, sample=0.1)
    assert (whole.status, whole.deflection_bound) == ("out_of_range", MODAL_BOUND)


@pytest.mark.slow
def test_modes_of_segments_are_those_of_the_link() -> None:
    """Frequencies of the clamped and of the pinned link, its first three, reduced whole and in four segments."""
    scene = Scene("s", SOFT, duration=1.0, dt=1e-3)
    for clamped in (True, False):
        whole = frequencies(scene, 3, "floating_frame", clamped=clamped, modes=8).frequencies
        parts = frequencies(scene, 3, "floating_frame", clamped=clamped, modes=3, segments=4).frequencies
        assert parts == pytest.approx(whole, rel=2e-4)


def margin(simulation: Simulation, q: Any) -> float:
    """What is left of the first body's inertia about its root once its modes give way: theta's pivot in its mass."""
    rows = np.arange(2, simulation.system.q0.size)
    unit = np.eye(simulation.system.q0.size)[rows]

    def kinetic(v: Any) -> float:
        return float(energy(SINGLE, simulation.model, simulation.par, q, v)[0])

    mass = np.array([[kinetic(a + b) - kinetic(a) - kinetic(b) for b in unit] for a in unit])
    return float(mass[0, 0] - mass[0, 1:] @ np.linalg.solve(mass[1:, 1:], mass[1:, 0]))


@pytest.mark.parametrize("modes", [3, *(pytest.param(count, marks=pytest.mark.slow) for count in (2, 4))])
@pytest.mark.parametrize("hub", [0.0, 0.002, 0.2])
@pytest.mark.parametrize("payload", [0.0, 0.3])
def test_it_stops_before_its_mass_loses_definiteness(hub: float, payload: float, modes: int) -> None:
    """A driven link, its root with an inertia or hardly any: a sentence, no failure of Newton, half of the margin."""
    section = Section(EI=1.0, EA=1e6, C=1e6, m=1.0, J=1e-6)
    arm = Arm("arm", (Link(1.0, section),), hub_inertia=hub, payload=Payload(payload))
    scene = everything(Scene("s", arm, duration=2.0, dt=1e-3, loads=(JointTorque(0, sine(1.0, np.pi, 0.0, 2.0)),)))
    simulation = Simulation(scene, scene.settings("floating_frame", modes=modes, rho_inf=1.0))
    rest = margin(simulation, simulation.system.q0)
    assert not simulation.advance_to(2.0)
    assert simulation.work.counts[2] == 0.0  # no step was halved
    assert "is beyond the valid range of the reduction to modes (25% of the length" in simulation.message
    tip = simulation.observe()[0][0]
    deflection = abs(np.cos(tip[2]) * tip[7] - np.sin(tip[2]) * tip[6])
    assert deflection < MODAL_BOUND + 0.01
    left = margin(simulation, simulation.work.q)
    assert left > 0.8 * MARGIN_LOST * rest > 0.0
    if deflection < MODAL_BOUND:
        assert left < 0.9 * rest  # and not needlessly early
