"""Scenes that start turning and moving: energies against the rigid arm's, no jump where motions go on alike."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flexarm_env.parameters import Arm, Elbow, Link, Payload, Section
from flexarm_env.rigid import link_inertia
from flexarm_env.scene import Motion, Scene
from flexarm_env.simulation import simulate
from flexarm_env.time_functions import from_csv, ramp, spline_table
from tests.refusals import refusal, refuses
from tests.scene_tools import Method, every, everything

METHODS: list[Method] = [
    ("floating_frame", {"segments": 3}),
    ("floating_frame", {"segments": 2, "frame": "root"}),
    ("floating_frame", {"segments": 2, "frame": "root", "multipliers": True}),
    ("floating_frame", {"modes": 3}),
    ("geometrically_exact", {"elements": 2}),
    ("elastica", {"nodes": 5}),
]
LINK = Link(0.7, Section(EI=40.0, EA=4e6, C=1e6, m=0.3, J=3e-6))
PAIR = Arm("pair", (LINK, LINK), hub_inertia=0.02, elbows=(Elbow(0.2, 0.003, 0.004),), payload=Payload(0.1, 1e-3))
ANGLES, RATES = (0.4, -0.7), (1.5, -2.5)


@every(METHODS)
def test_links_turn_as_rigid_ones_at_the_start(formulation: str, options: dict[str, Any]) -> None:
    """Kinetic energy at 0 is that of the rigid arm; from there the books close."""
    scene = Scene("turning", PAIR, duration=0.2, dt=1e-3, angles=ANGLES, rates=RATES)
    run = simulate(everything(scene), formulation, estimate_error=False, **options)
    w = np.array(RATES)
    expected = 0.5 * w @ (link_inertia(PAIR) * np.cos(np.subtract.outer(ANGLES, ANGLES))) @ w
    assert run.status == "ok"
    rotary = 0.5 * LINK.section.J * LINK.length * (w @ w) if formulation == "elastica" else 0.0
    assert run.energy[0] == pytest.approx(expected, rel=1e-10, abs=1.1 * rotary) and run.work[0] == 0.0
    assert np.abs(run.balance).max() < 1e-4 * expected


@every(METHODS)
def test_a_thrown_arm_keeps_its_momentum(formulation: str, options: dict[str, Any]) -> None:
    """A free rod: its middle goes on straight, and one that is stiff turns evenly about it."""
    rod = Arm("rod", (Link(1.0, Section(EI=4e3, EA=4e7, C=1e7, m=0.5, J=1e-5)),))
    scene = Scene("thrown", rod, duration=0.5, dt=1e-3, root="free", position=(0.2, 0.1), angles=(0.3,),
                  velocity=(0.5, -0.2), rates=(2.0,))  # fmt: skip
    run = simulate(everything(scene), formulation, estimate_error=False, sample=0.05, **options)
    across = np.array([-np.sin(0.3), np.cos(0.3)])
    middle = np.array([0.2, 0.1]) + 0.5 * np.array([np.cos(0.3), np.sin(0.3)])
    speed = np.array([0.5, -0.2]) + 0.5 * 2.0 * across
    turned = 0.3 + 2.0 * run.t
    tip = middle + run.t[:, None] * speed + 0.5 * np.column_stack([np.cos(turned), np.sin(turned)])
    assert run.status == "ok" and np.abs(run.tip[:, :2] - tip).max() < 2e-5


@every(METHODS)
def test_a_motion_that_goes_on_at_the_same_rate_strikes_nothing(formulation: str, options: dict[str, Any]) -> None:
    common = {"duration": 0.3, "dt": 1e-3, "motions": (Motion("joint0", ramp(0.45, 0.3)),)}
    struck = simulate(everything(Scene("struck", PAIR, **common)), formulation, estimate_error=False, **options)
    gone_on = everything(Scene("gone on", PAIR, **common, rates=(1.5, 1.5)))
    run = simulate(gone_on, formulation, estimate_error=False, **options)
    assert struck.work[0] > 0.02 and run.work[0] == pytest.approx(0.0, abs=1e-12)
    assert np.abs(run.tip_deflection).max() < 0.2 * np.abs(struck.tip_deflection).max()


def test_what_cannot_be_a_start_is_refused_and_files_keep_it() -> None:
    with pytest.raises(ValueError, match=r"^velocity = \(0.1, 0.0\): must be 0 in the direction of root_x"):
        Scene("s", PAIR, duration=1.0, dt=0.01, velocity=(0.1, 0.0))
    with pytest.raises(ValueError, match=r"^rates\[1\] = 2.0: must be that of the link before, 1.0: joint 1 is rigid"):
        Scene("s", PAIR, duration=1.0, dt=0.01, rates=(1.0, 2.0), rigid_joints=(1,))
    refuses("rates", lambda: Scene("s", PAIR, duration=1.0, dt=0.01, rates=(1.0,)))
    scene = Scene("s", PAIR, duration=1.0, dt=0.01, root="free", velocity=(0.1, 2.0), rates=(1.0, -2.0))
    assert Scene.from_toml(scene.to_toml()) == scene


def test_one_file_serves_several_motions(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("time,hub,note,elbow\n0,0,start,0\n0.5,10,,3\n1,40,,9\n1.5,50,x,12\n")
    hub = from_csv(path, column="hub", time="time", scale=np.pi / 180)
    assert hub == spline_table([0, 0.5, 1, 1.5], np.array([0, 10, 40, 50]) * np.pi / 180)
    text = f"""
        duration = 1.0
        dt = 0.01
        name = "log"
        arm = "de_luca_siciliano"
        [[motions]]
        coordinate = "joint0"
        kind = "csv"
        file = "{path}"
        column = "hub"
        time = "time"
        scale = 0.01
        [[motions]]
        coordinate = "joint1"
        kind = "csv"
        file = "{path}"
        column = "elbow"
        time = "time"
        interpolation = "linear"
    """
    scene = Scene.from_toml(text)
    assert scene.motions[1].function(1.25) == pytest.approx(10.5)
    assert Scene.from_toml(scene.to_toml()) == scene
    for options, message in (
        ({"column": "shoulder", "time": "time"}, "column = 'shoulder': must name one column; the file has time, hub"),
        ({"column": "hub"}, "time = 't': must name one column"),
        ({"column": "note", "time": "time"}, "[0] = 'start': must be a number, in row 0 of column 'note'"),
        ({"time": "time"}, "column: missing"),
    ):
        told = refusal(lambda options=options: from_csv(path, **options))
        assert told.startswith(str(path)) and message in told
