"""Floating frames in a chain without multipliers: equations, and scenes in both frames."""

import itertools
from typing import Any

import numpy as np
import pytest

from flexarm_env import simulate
from flexarm_env.parameters import Arm, Elbow, Link, Payload, Section
from flexarm_env.scene import JointTorque, Motion, Scene
from flexarm_env.scenes import named
from flexarm_env.simulation import Simulation
from flexarm_env.time_functions import cycloid, sine
from tests.physics.oracle_chain import Chain
from tests.processes import uncompiled_tests
from tests.scene_tools import everything, tips_apart

FRAMES = ("root", "chord")


@pytest.mark.slow
@pytest.mark.parametrize("mark", ["not slow", "slow"])
def test_uncompiled(mark: str) -> None:
    """Residual, tangents, energies, losses and places against the oracle, for every mesh (`uncompiled_chain.py`)."""
    uncompiled_tests("physics/uncompiled_chain.py", mark)


# ------------------------------------------------------------------------------ scenes
def ends_apart(one: Any, other: Any) -> float:
    """`tips_apart` of two runs that came to their end."""
    assert one.status == other.status == "ok", (one.message, other.message)
    return tips_apart(one, other)


def jointed() -> Scene:
    """Three links under gravity: an elbow that is driven, one that is rigid at an angle."""
    section = Section(4.0, 4e4, 1.5e4, 0.5, 1e-3)
    elbows = (Elbow(0.1, 0.01, 0.02), Elbow(0.05))
    arm = Arm("three", (Link(0.7, section),) * 3, hub_inertia=0.05, elbows=elbows, payload=Payload(0.2, 1e-3))
    start = {"angles": (-1.2, -0.7, 0.1), "rigid_joints": (2,), "gravity": (0.0, -9.81)}
    motions = (Motion("joint1", cycloid(0.9, 0.8, 0.5)),)
    return Scene("jointed", arm, duration=1.0, dt=0.002, sample=0.05, motions=motions, **start)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scene", "dt", "mesh"),
    [
        (named("robot_arm_motion_smooth"), 0.0125, {"segments": 3}),
        (named("spin_up"), 0.01, {"segments": 2, "modes": 2}),
        (named("flying_rod"), 2.5e-3, {"segments": 3}),
        (jointed(), 2e-3, {"segments": 2}),
    ],
    ids=lambda item: item.name if isinstance(item, Scene) else None,
)
def test_the_form_with_multipliers_is_approached(scene: Scene, dt: float, mesh: dict[str, Any]) -> None:
    """The same equations: with the step the difference falls in second order, to 1e-6 of L."""
    apart = []
    for k in range(4):
        options = {"dt": dt / 2**k, "rho_inf": 1.0, "sample": 0.1, "estimate_error": False, **mesh}
        joined = simulate(everything(scene), multipliers=True, **options)
        apart.append(ends_apart(simulate(everything(scene), frame="root", **options), joined))
    assert np.log2(np.array(apart[:-1]) / apart[1:]) == pytest.approx(2.0, abs=0.15)
    assert apart[-1] < 3e-6


@pytest.mark.slow
def test_a_chord_bears_a_large_deflection() -> None:
    """robot_arm_motion_smooth, 80 % of L: a frame through both ends halves the rotation that it has to bear. Four
    segments of it are nearer than eight clamped ones, and both frames' segments come to the exact beam."""
    scene, options = named("robot_arm_motion_smooth"), {"dt": 0.00625, "rho_inf": 1.0, "sample": 0.1}
    exact = simulate(scene, "geometrically_exact", elements=12, order=3, estimate_error=False, **options)
    errors = {
        frame: [
            ends_apart(simulate(scene, segments=n, elements=2, frame=frame, estimate_error=False, **options), exact)
            for n in (2, 4, 8)
        ]
        for frame in FRAMES
    }
    for found in errors.values():
        assert (np.log2(np.array(found[:-1]) / found[1:]) > 1.5).all()
    assert errors["chord"][1] < 0.5 * errors["root"][2]
    assert errors["chord"][0] < 0.01 < 0.1 < errors["root"][0]


@pytest.mark.slow
@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize("mesh", [{}, {"modes": 2}], ids=str)
def test_segments_converge_where_beams_are_slender(frame: str, mesh: dict[str, int]) -> None:
    """Deflection 0.7 L with hardly any shear or stretch: second order at least in both frames, down to 2e-6 of L."""
    section = Section(2.0, 4e6, 1.5e6, 0.5, 1e-5)
    arm = Arm("slender", (Link(1.0, section),), hub_inertia=0.05, payload=Payload(0.1, 1e-3))
    scene = Scene("slender", arm, duration=0.6, dt=5e-4, sample=0.02, loads=(JointTorque(0, sine(2.0, 8.0)),))
    exact = simulate(scene, "geometrically_exact", elements=16, rho_inf=0.9, estimate_error=False)
    apart = [
        ends_apart(simulate(scene, segments=n, frame=frame, rho_inf=0.9, estimate_error=False, **mesh), exact)
        for n in (6, 12, 24)
    ]
    assert all(fine < max(coarse / 2**1.5, 2e-6) for coarse, fine in itertools.pairwise(apart))
    assert apart[-1] < (1e-4 if frame == "root" else 2e-6)


@pytest.mark.parametrize("modes", [3, *(pytest.param(count, marks=pytest.mark.slow) for count in (2, 4))])
def test_chord_modes_stop_where_they_should(modes: int) -> None:
    """A driven link whose root has no inertia: a sentence, no step halved, and a mass matrix that is still definite."""
    section = Section(EI=1.0, EA=1e6, C=1e6, m=1.0, J=1e-6)
    arm = Arm("arm", (Link(1.0, section),), payload=Payload(0.3))
    scene = everything(Scene("arm", arm, duration=2.0, dt=1e-3, loads=(JointTorque(0, sine(1.0, np.pi, 0.0, 2.0)),)))
    simulation = Simulation(scene, scene.settings("floating_frame", modes=modes, rho_inf=1.0, frame="chord"))
    assert not simulation.advance_to(2.0)
    assert simulation.work.counts[2] == 0.0
    assert "is beyond the valid range of the reduction to modes" in simulation.message
    mass = Chain(scene, 1, modes=modes, frame="chord").mass_matrix(simulation.work.q)[2:, 2:]
    assert np.linalg.eigvalsh(mass)[0] > 0.0
