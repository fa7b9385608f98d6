"""Floating frames in space: the planar ones in drawn planes, known answers, the exact beam."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import flexarm_env as fx
from flexarm_env import arms, scenes
from flexarm_env.linear import modes
from flexarm_env.time_functions import constant, cycloid, pulse
from flexarm_env.validation import Array
from tests import space_answers as answers
from tests.scene_tools import everything

FLOATING = "floating_frame"


STUBBY = fx.Section(EI=5.0, EA=1e3, C=500.0, m=1.0, J=2e-3, EI_y=9.0, C_y=700.0, J_y=1e-3, GJ=2.0)
TAPER = fx.Taper((0.05, 0.02), (0.012, 0.006), 7e9, 2700.0, 2.6e9)


# ------------------------------------------------------------------ the plane
def extrapolated(scene: fx.Scene, **options: Any) -> Array:
    """Tips of a run in steps of no length: coordinates in space differ from those of the plane, and so, in second
    order of the step, do runs."""
    scenes = (everything(dataclasses.replace(scene, dt=h)) for h in (1e-3, 5e-4, 2.5e-4))
    runs = [fx.simulate(s, FLOATING, estimate_error=False, tolerance=1e-12, **options) for s in scenes]
    a, b, c = (run.tip[:, :3] if scene.spatial else run.tip[:, :2] for run in runs)
    return np.asarray((64.0 * c - 20.0 * b + a) / 45.0)


def falling(turn: Rotation | None) -> fx.Scene:
    when = {"duration": 0.3, "dt": 1e-3, "sample": 0.05}
    return answers.falling(turn, answers.section(5.0, 2.0, 9.0, 1e4, 1e-3), STUBBY, when, tau_d=1e-3)


@pytest.fixture(scope="module")
def plane() -> Array:
    """Tips of the scene of the plane."""
    tip = extrapolated(falling(None), segments=3)
    return np.column_stack([tip, np.zeros(len(tip))])


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(10))
def test_a_planar_scene_in_a_drawn_plane_is_that_of_the_plane(seed: int, plane: Array) -> None:
    turn = Rotation.random(random_state=seed)
    assert np.abs(extrapolated(falling(turn), segments=3) - turn.apply(plane)).max() < 1e-7 * 1.1


_PUSH = fx.PointLoad(0, "root", force_y=pulse(4.0, 0.1))
_CASES: dict[str, tuple[fx.Arm, dict[str, Any]]] = {
    "taper": (fx.Arm("a", (fx.Link(0.8, TAPER),), payload=fx.Payload(0.1)), {}),
    "curved": (fx.Arm("a", (fx.Link(0.8, STUBBY, curvature=1.5),), payload=fx.Payload(0.2, 1e-3)), {}),
    "motion": (fx.Arm("a", (fx.Link(0.8, STUBBY),)), {"motions": (fx.Motion("joint0", cycloid(1.0, 0.2)),)}),
    "rigid ends, free": (
        fx.Arm("a", (fx.Link(0.5, STUBBY, root_offset=0.06, tip_offset=0.04, tip_mass=0.1, tip_inertia=1e-3),)),
        {"root": "free", "loads": (_PUSH,)},
    ),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", _CASES)
def test_features_are_those_of_the_plane(name: str) -> None:
    arm, fields = _CASES[name]
    scene = fx.Scene("s", arm, gravity=(0.0, -3.0), duration=0.2, dt=1e-3, sample=0.05, **fields)
    plane, space = (extrapolated(s, segments=2) for s in (scene, dataclasses.replace(scene, space=True)))
    assert np.abs(space[:, :2] - plane).max() < 1e-7 and not space[:, 2].any()


@pytest.mark.slow
def test_modes_about_a_sagging_rest_are_those_of_the_plane() -> None:
    arm = fx.Arm("a", (fx.Link(1.0, STUBBY), fx.Link(0.7, STUBBY)), elbows=(fx.Elbow(0.2, 1e-3, 1e-3),))
    scene = fx.Scene("s", arm, duration=0.5, dt=1e-3, gravity=(0.0, -9.81), angles=(0.3, 0.8))
    plane = modes(scene, 4, FLOATING, segments=3).frequencies
    space = modes(everything(dataclasses.replace(scene, space=True)), 12, FLOATING, segments=3).frequencies
    assert max(np.abs(space / omega - 1.0).min() for omega in plane) < 1e-7


# ------------------------------------------------------------------ motion
@pytest.mark.slow
def test_segments_come_to_the_exact_beam() -> None:
    """A slew that bends a strip by a third of its length and twists it by 52 degrees."""
    scene = dataclasses.replace(scenes.named("three_dof_slew"), duration=0.4)
    exact = fx.simulate(scene, elements=24, estimate_error=False)
    runs = [fx.simulate(scene, FLOATING, segments=n, estimate_error=False) for n in (4, 8)]
    errors = [float(np.abs(run.tip - exact.tip).max()) / scene.arm.total_length for run in runs]
    assert np.abs(exact.tip_deflection).max() > 0.3 and np.degrees(np.abs(exact.twist)).max() > 50.0
    assert errors[1] < 1e-3 and errors[0] / errors[1] > 3.3


def test_iterations_of_long_steps() -> None:
    """3.6 a step of a slew that whips a strip about; without the motion in Newton's matrix it was 4.9."""
    scene = dataclasses.replace(scenes.named("three_dof_slew"), duration=0.4)
    run = fx.simulate(scene, FLOATING, segments=2, dt=2.5e-3, estimate_error=False)
    assert run.finished and run.halvings == 0 and run.iterations < 4.1 * run.steps


@pytest.mark.parametrize("bent", [0.0, 2.0])
def test_short_steps_bring_no_energy(bent: float) -> None:
    """What a first increment leaves of itself is as much as it leaves of its square, and in short steps more."""
    section = answers.section(2.0, 1.0, 3.0, 1e4, 1e-6, m=0.3)
    arm = fx.Arm("a", (fx.Link(0.8, section, curvature=((0.0, bent), (0.8, -bent))),), hub_axis=(0.0, 1.0, 0.0),
                 payload=fx.Payload(0.1, 1e-4, (0.0, 0.03, 0.0)), tau_d=1e-3)  # fmt: skip
    scene = everything(fx.Scene("s", arm, duration=0.05, dt=5e-5, sample=5e-3, gravity=(3.0, 0.0, -9.81), space=True))
    run = fx.simulate(scene, FLOATING, segments=2, estimate_error=False)
    assert run.finished and np.abs(run.balance).max() < 1e-5 * run.turned_over


@pytest.mark.slow
def test_a_run_tells_its_error() -> None:
    run = fx.simulate(dataclasses.replace(scenes.named("three_dof_slew"), duration=0.1), FLOATING)
    assert run.finished and 0.0 < run.error_estimate < 0.01
    assert arms.named("three_dof").n_links == 3 and np.abs(run.balance).max() < 0.01 * run.turned_over


# ------------------------------------------------------------------ modes
@pytest.mark.slow
@pytest.mark.parametrize(
    ("segments", "shapes", "first", "second"), [(1, 3, 5e-4, 0.015), (1, 4, 5e-5, 3e-3), (2, 3, 2e-5, 2e-3)]
)
def test_modes_of_a_clamped_strip(segments: int, shapes: int, first: float, second: float) -> None:
    """Flap and torsion by a few shapes; with the static ones alone the second is half as high again."""
    options = {"segments": segments, "modes": shapes}
    found = modes(everything(answers.STRIP), 9, FLOATING, **options, clamped=True).frequencies / (2.0 * math.pi)
    for known, share in ((6.5147, first), (40.824, second), (123.370, 5e-3)):
        assert np.abs(found / known - 1.0).min() < share


@pytest.mark.slow
def test_modes_of_an_arm_in_the_plane_stay_there_and_come_to_the_segments() -> None:
    arm = fx.Arm("a", (fx.Link(0.8, TAPER, curvature=0.5),), payload=fx.Payload(0.1, 1e-3, (0.05, 0.02)))
    scene = fx.Scene("s", arm, gravity=(0.0, -3.0, 0.0), duration=0.3, dt=1e-3, sample=0.05, space=True)
    runs = [fx.simulate(everything(scene), FLOATING, estimate_error=False, **options)
            for options in ({"segments": 24}, {"segments": 4, "modes": 3}, {"segments": 4})]  # fmt: skip
    apart = [float(np.abs(run.tip - runs[0].tip).max()) / arm.total_length for run in runs[1:]]
    assert not runs[1].tip[:, 2].any()
    assert apart[0] < 1e-4 and apart[0] < apart[1]


@pytest.mark.parametrize(("segments", "bent"), [(2, 2.5), (1, 0.5)])
def test_short_steps_of_a_bent_arm_reduced_to_modes(segments: int, bent: float) -> None:
    """The shorter the step the more inertia counts, and a light shaft's about the chord is that of its bow: Newton has
    it although shear differs between both planes."""
    section = dataclasses.replace(STUBBY, C_y=150.0, J=1e-4, J_y=1e-4)
    arm = fx.Arm("a", (fx.Link(0.4, section, curvature=((0.0, -bent), (0.4, 4.0 * bent))),), hub_axis=(0.0, 1.0, 0.0),
                 payload=fx.Payload(0.05, 1e-5, (0.0, 0.03, 0.0)))  # fmt: skip
    tip = fx.PointLoad(0, "tip", force_z=constant(1.0))
    scene = everything(fx.Scene("s", arm, duration=2e-3, dt=2e-5, sample=1e-3, loads=(tip,), space=True))
    run = fx.simulate(scene, FLOATING, segments=segments, modes=3, estimate_error=False)
    assert run.finished and run.halvings == 0 and run.iterations < 3.0 * run.steps
