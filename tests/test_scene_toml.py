"""Scenes as TOML: what is written is read back, and every wrong key is named by its path."""

import math
from pathlib import Path

import numpy as np
import pytest

from flexarm_env import arms, scenes
from flexarm_env import time_functions as tf
from flexarm_env.scene import JointTorque, Motion, PointLoad, Scene, toml
from tests.processes import ROOT
from tests.refusals import refusal, refuses
from tests.scene_tools import ONE, TWO, scene


@pytest.mark.parametrize("name", scenes.names(parameter_sets=True))
def test_named_scenes_round_trip(name: str) -> None:
    s = scenes.named(name)
    again = Scene.from_toml(s.to_toml())
    assert again == s
    assert hash(again) == hash(s)
    assert again.to_toml() == s.to_toml()


def test_everything_round_trips() -> None:
    t = np.array([0.0, 0.1, 0.7, 1.9])
    y = np.array([0.0, 0.3, -1 / 3, 1e-17])
    functions = [
        tf.constant(0.0),
        tf.ramp(1.0, 0.3),
        tf.cycloid(-1.0, 0.7),
        tf.spin_up(1.0, 1.0),
        tf.sine(0.1, 2.0, t_end=math.pi),
        tf.linear_table(t, y),
        tf.spline_table(t, y, "natural"),
        tf.hermite_table(t, y, y),
        tf.hermite_table(t, y, y, y),
        tf.ramp(1.0, 0.3).plus(-0.0),
    ]
    for f in functions:
        s = scene(motions=(Motion("joint0", f),))
        assert Scene.from_toml(s.to_toml()) == s
    loads = (
        JointTorque(1, tf.steps(t, y)),
        PointLoad(1, "tip", force_y=tf.linear_table(np.linspace(0, 1, 40), np.linspace(0, 1, 40) ** 2)),
        PointLoad(0, "root", tf.constant(1), tf.pulse(1, 2, 1), tf.sine(1, 2)),
    )
    s = scene(
        TWO,
        root="free",
        position=(0.1, -1e-300),
        angles=(0.1, 2 / 3),
        loads=loads,
        gravity=(0.0, -9.81),
        solver={"formulation": "elastica", "nodes": 4, "newmark": (0.25, 0.5)},
        description='quotes " and \\ back-slashes,\nlines, Greek κ',
        note="n",
        source="s",
    )
    assert Scene.from_toml(s.to_toml()) == s
    numpy = scene(solver={"segments": np.int64(3), "tolerance": np.float64(1e-8)})
    assert Scene.from_toml(numpy.to_toml()) == numpy == scene(solver={"segments": 3, "tolerance": 1e-8})
    assert Scene.from_toml(scene(TWO, rigid_joints=(1,)).to_toml()).rigid_joints == (1,)


GOOD = """
name = "s"
duration = 2.0
dt = 0.01
arm = "strip"
"""


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("lenght = 3", "lenght: unknown key; allowed: name, arm, duration,"),
        ("[[motions]]\nkind = 'ramp'", 'motions[0].coordinate: missing; must be "joint0"'),
        ("[[motions]]\ncoordinate = 'joint0'", 'motions[0].kind: missing; must be one of "constant"'),
        ("[[motions]]\ncoordinate = 'joint0'\nkind = 'step'", "motions[0].kind = 'step': must be one of \"constant\""),
        (
            "[[motions]]\ncoordinate = 'joint0'\nkind = 'ramp'\nrise = 1.0\ntime = 2.0",
            'motions[0].time: unknown parameter of kind "ramp"; allowed: rise, duration, offset',
        ),
        (
            "[[motions]]\ncoordinate = 'joint0'\nkind = 'ramp'\nrise = 1.0",
            'motions[0].duration: missing; kind "ramp" takes rise, duration, offset',
        ),
        (
            "[[motions]]\ncoordinate = 'joint0'\nkind = 'ramp'\nrise = true\nduration = 1",
            "motions[0].rise = True: must be a finite number",
        ),
        (
            "[[motions]]\ncoordinate = 'joint0'\nkind = 'linear_table'\nt = [0, 1]\ny = [0, nan]",
            "motions[0].y[1] = nan: must be a finite number, in row 1 of the table",
        ),
        (
            "[[motions]]\ncoordinate = 'joint0'\nkind = 'pulse'\nvalue = 1\nt_end = 1",
            "motions[0].t[1] = 1.0: a motion must not jump: row 1 goes from 1 to 0 in no time",
        ),
        (
            "[[motions]]\ncoordinate = 'joint0'\nkind = 'csv'\nfile = 'none.csv'",
            "motions[0].file = 'none.csv': must be a CSV file; there is none at none.csv",
        ),
        ("[[loads]]\nkind = 'pulse'", "loads[0].joint: missing; a load has joint and kind, or link, end"),
        ("[[loads]]\nlink = 0\nend = 'tip'", "loads[0].force_x: missing; a point load needs"),
        (
            "[[loads]]\nlink = 0\nend = 'tip'\nforce_w = {kind = 'constant', value = 1}",
            "loads[0].force_w: unknown key (did you mean force_z?); allowed: link, end, force_x, force_y, torque, ",
        ),
        (
            "[[loads]]\nlink = 0\nend = 'tip'\nforce_x = {kind = 'constant', value = '1'}",
            "loads[0].force_x.value = '1': must be a finite number",
        ),
        ("[[loads]]\nlink = 0\nend = 'tip'\nforce_x = 8.0", "loads[0].force_x = 8.0: must be a table"),
        ("[[loads]]\njoint = 1\nkind = 'constant'\nvalue = 1", "loads[0].joint = 1: must be a joint of the arm"),
        ("motions = 3", "motions = 3: must be a sequence of tables, [[motions]]"),
        ("[solver]\nsegment = 3", "solver.segment: unknown option of floating_frame (did you mean segments?)"),
        ("[parameter_sets.x]\nname = 'y'", "parameter_sets.x.name: unknown key; allowed: arm, duration"),
        ("[parameter_sets.x]\nduration = -1", "parameter_sets.x.duration = -1: must be a positive number (s)"),
    ],
)
def test_a_wrong_file_names_the_key_path(text: str, message: str) -> None:
    assert refusal(lambda: Scene.from_toml(GOOD + text)).startswith(message)


@pytest.mark.parametrize(
    ("arm", "message"),
    [
        ("arm = 'stripe'", "arm = 'stripe': must be one of \"de_luca_siciliano\""),
        ("arm = 3", "arm = 3: must be a text"),
        ("", "arm: missing; must be a name, a .toml file or a table"),
        (
            "[[arm.links]]\nlength = 1.0\nsection = {EI = -1.0, EA = 1, C = 1, m = 1}",
            "arm.links[0].section.EI = -1.0: must be a positive number (N m^2)",
        ),
    ],
)
def test_a_wrong_arm_in_a_scene_names_the_key_path(arm: str, message: str) -> None:
    """The path begins with `arm.`; what can be wrong in an arm: `test_arms.py`."""
    text = "name = 's'\nduration = 2.0\ndt = 0.01\n" + arm
    assert refusal(lambda: Scene.from_toml(text)).startswith(message)


def test_what_is_no_toml_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "broken.toml"
    path.write_text("duration = = 3")
    refuses(rf"^{path}: not a TOML file: .*line 1", lambda: Scene.from_toml(path))
    path.write_bytes(b"\xff\xfe\x00")
    refuses(rf"^{path}: not a TOML file: ", lambda: Scene.from_toml(path))
    with pytest.raises(FileNotFoundError):
        Scene.from_toml(tmp_path / "none.toml")


def test_a_path_with_an_equals_sign_is_a_path(tmp_path: Path) -> None:
    path = tmp_path / "dt=0.1" / "scene.toml"
    path.parent.mkdir()
    path.write_text(scene().to_toml())
    assert Scene.from_toml(str(path)) == scene()


def test_files_find_their_arms_and_tables(tmp_path: Path) -> None:
    (tmp_path / "my_arm.toml").write_text(arms.to_toml(ONE))
    (tmp_path / "move.csv").write_text("t,psi\n0,0\n1,1\n2,0\n")
    (tmp_path / "my_scene.toml").write_text(
        "duration = 2\ndt = 0.1\narm = 'my_arm.toml'\n"
        "[[motions]]\ncoordinate = 'joint0'\nkind = 'csv'\nfile = 'move.csv'\ninterpolation = 'linear'\n"
        "[parameter_sets.slow]\nduration = 4\n"
    )
    s = Scene.from_toml(tmp_path / "my_scene.toml")
    assert (s.name, s.arm) == ("my_scene", ONE)
    assert s.motions == (Motion("joint0", tf.linear_table([0, 1, 2], [0, 1, 0])),)
    slow = scenes.resolve(f"{tmp_path / 'my_scene.toml'}@slow")
    assert (slow.name, slow.duration, slow.motions) == ("my_scene@slow", 4.0, s.motions)
    with pytest.raises(ValueError, match=r"parameter_set = 'fast': must be one that my_scene has: slow"):
        scenes.resolve(f"{tmp_path / 'my_scene.toml'}@fast")


def test_errors_name_the_files_that_they_are_in(tmp_path: Path) -> None:
    path, arm = tmp_path / "a.scene.toml", tmp_path / "arm.toml"
    path.write_text("duration = 2\ndt = 0.1\narm = 'arm.toml'\n")
    arm.write_text(arms.to_toml(ONE).replace("EI = 1000.0", "EI = -1.0"))
    refuses(rf"^{path}: {arm}: links\[0\].section.EI = -1.0: must be", lambda: Scene.from_toml(path))
    path.write_text("duraton = 2\n")
    refuses(rf"^{path}: duraton: unknown key \(did you mean duration\?\)", lambda: Scene.from_toml(path))


def test_example_files() -> None:
    paths = sorted((ROOT / "configs" / "scenes").glob("*.toml"))
    assert len(paths) >= 3
    for path in paths:
        s = scenes.resolve(path)
        assert Scene.from_toml(s.to_toml()) == s
        s.settings()
    assert scenes.resolve(ROOT / "configs/scenes/three_link_swing.toml").arm.n_links == 3


def test_the_documented_file_is_a_scene() -> None:
    page = (ROOT / "docs" / "scenes.md").read_text(encoding="utf-8")
    block = page.split("```toml\n")[1].split("```")[0]
    s = Scene.from_toml(block, "heavy")
    assert (s.name, s.gravity, s.arm) == ("swing@heavy", (0.0, -19.62), arms.named("de_luca_siciliano"))
    for name in (*scenes.names(), *arms.names(), *(n for n in scenes.names(True) if "@" in n), *toml.KINDS):
        assert f"`{name}`" in page


def test_a_byte_order_mark_is_not_content(tmp_path: Path) -> None:
    """Some editors put one before the text."""
    text = scenes.named("robot_arm_motion").to_toml()
    path = tmp_path / "scene.toml"
    path.write_text(text, encoding="utf-8-sig")
    assert path.read_bytes().startswith(b"\xef\xbb\xbf")
    assert Scene.from_toml(path) == Scene.from_toml(text) == Scene.from_toml("\ufeff" + text)
