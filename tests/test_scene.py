"""Scenes: the named ones against the page that declares them, checks, kinks, settings and TOML."""

from __future__ import annotations

import dataclasses
import itertools
import math
import pickle
from pathlib import Path

import numpy as np
import pytest

from flexarm_env import arms, scenes, toml_text
from flexarm_env import time_functions as tf
from flexarm_env.parameters import Arm, Link, Section
from flexarm_env.scene import JointTorque, Motion, PointLoad, Scene, toml
from flexarm_env.settings import Settings

ROOT = Path(__file__).resolve().parents[1]
SECTION = Section(1000.0, 1e4, 1e4, 1.0, 10.0)
ONE = Arm("one", (Link(10.0, SECTION),))
TWO = Arm("two", (Link(5.0, SECTION), Link(5.0, SECTION)))


def scene(arm: Arm = ONE, **changes: object) -> Scene:
    return Scene("s", arm, **{"duration": 2.0, "dt": 0.01, **changes})  # type: ignore[arg-type]


# ------------------------------------------------------------------- named scenes

#        name: (links, length of each, EI, EA, C, m, J of each, duration)
DECLARED = {
    "robot_arm_motion": (1, 10, 1000, 1e4, 1e4, 1, (10,), 9),
    "robot_arm_motion_smooth": (1, 10, 1000, 1e4, 1e4, 1, (10,), 9),
    "robot_arm_torque": (1, 10, 1000, 1e4, 1e4, 1, (10,), 15),
    "flying_rod": (1, 10, 500, 1e4, 1e4, 1, (10,), 13),
    "flying_rod_soft": (1, 10, 100, 1e4, 1e4, 1, (10,), 7.5),
    "two_link_motion": (2, 5, 1e5, 1e6, 1e6, 1, (1, 1), 2.2),
    "two_link_free_flight": (2, 5, 1e4, 1e6, 1e6, 1, (1, 10), 5),
    "spin_up": (1, 10, 1.4e4, 2.8e7, 1e7, 1.2, (6e-4,), 20),
}
PRINTED = {
    "robot_arm_motion": (1000, 100, 86.7),
    "robot_arm_torque": (1000, 100, 86.7),
    "flying_rod": (500, 1000, 867.0),
    "two_link_motion": (100, 10000, 8670.0),
    "two_link_free_flight": (100, 10000, 8670.0),
}


def test_names() -> None:
    assert scenes.names() == tuple(DECLARED)
    variants = [n for n in scenes.names(parameter_sets=True) if "@" in n]
    assert variants == [f"{name}@as_printed" for name in DECLARED if name in PRINTED]


@pytest.mark.parametrize("name", DECLARED)
def test_named_scenes_are_as_declared(name: str) -> None:
    n, length, EI, EA, C, m, J, duration = DECLARED[name]
    s = scenes.named(name)
    assert s.name == name
    assert s.source
    assert s.duration == duration
    assert s.arm.n_links == n
    for link, inertia in zip(s.arm.links, J, strict=True):
        assert link == Link(length, Section(EI, EA, C, m, inertia))
    assert (s.arm.hub_inertia, s.arm.tau_d, s.arm.mass_damping, s.gravity) == (0.0, 0.0, 0.0, None)
    assert s.arm.mass == m * length * n  # no payload, no elbow
    assert s.dt <= s.sample
    assert s.duration / s.sample == pytest.approx(round(s.duration / s.sample))


@pytest.mark.parametrize("name", PRINTED)
def test_as_printed_changes_the_section_alone(name: str) -> None:
    s, printed = scenes.named(name), scenes.named(f"{name}@as_printed")
    assert printed.name == f"{name}@as_printed"
    assert "rotary inertia J = " in printed.note
    assert "Assumed" in printed.note
    assert (printed.motions, printed.loads, printed.angles) == (s.motions, s.loads, s.angles)
    for link, original in zip(printed.arm.links, s.arm.links, strict=True):
        assert PRINTED[name] == (link.section.EI, link.section.EA, link.section.C)
        assert pytest.approx(0.867 * link.section.EA) == link.section.C
        assert (link.length, link.section.m, link.section.J) == (
            original.length,
            original.section.m,
            original.section.J,
        )


def test_drives() -> None:
    ramp = scenes.named("robot_arm_motion").motion_of("joint0")
    assert ramp == tf.linear_table([0.0, 5.0], [0.0, 1.5])
    torque = scenes.named("robot_arm_torque")
    assert torque.motions == ()
    assert torque.loads == (JointTorque(0, tf.pulse(80.0, 2.5)),)
    for name, force, moment, t_end in (
        ("flying_rod", 8.0, -80.0, 2.5),
        ("flying_rod_soft", 8.0, -80.0, 2.5),
        ("two_link_free_flight", 40.0, -160.0, 0.5),
    ):
        s = scenes.named(name)
        assert s.root == "free"
        assert s.position == (6.0, 0.0)
        ends = np.array([6.0, 0.0]) + s.arm.total_length * np.array([math.cos(s.angles[0]), math.sin(s.angles[0])])
        np.testing.assert_allclose(ends, [0.0, 8.0], atol=1e-14)
        assert len(set(s.angles)) == 1
        pulses = {"force_x": tf.pulse(force, t_end), "torque": tf.pulse(moment, t_end)}
        assert s.loads == (PointLoad(0, "root", **pulses),)
        assert s.kinks == (t_end,)
    two = scenes.named("two_link_motion")
    assert two.motions == (Motion("joint0", tf.ramp(1.5, 0.5)),)
    assert two.rigid_joints == ()
    assert scenes.named("spin_up").motions == (Motion("joint0", tf.spin_up(6.0, 15.0)),)


def test_an_unknown_scene_is_refused() -> None:
    for name in ("robot_arm", "spin_up@as_printed", "flying_rod@"):
        with pytest.raises(ValueError, match=r"unknown scene.*allowed: robot_arm_motion, "):
            scenes.resolve(name)
    with pytest.raises(ValueError, match=r"did you mean flying_rod\?"):
        scenes.named("flyingrod")
    with pytest.raises(ValueError, match=r"must be a name or a .toml file that exists"):
        scenes.resolve("nowhere.toml")
    with pytest.raises(ValueError, match=r"scene = 3: must be a name"):
        scenes.resolve(3)  # type: ignore[arg-type]


def test_resolve_takes_scenes_names_and_files(tmp_path: Path) -> None:
    s = scenes.named("flying_rod")
    assert scenes.resolve(s) is s
    assert scenes.resolve("flying_rod") is s
    path = tmp_path / "mine.toml"
    path.write_text(s.to_toml())
    assert scenes.resolve(path) == s
    assert scenes.resolve(str(path)) == s


# ------------------------------------------------------------------------- checks


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"duration": 0}, "duration = 0: must be a positive number (s)"),
        ({"dt": 3.0}, "dt = 3.0: must not exceed the duration, 2 s"),
        ({"sample": 3.0}, "sample = 3.0: must not exceed the duration, 2 s"),
        ({"sample": math.nan}, "sample = nan: must be a positive number (s)"),
        ({"root": "fixed"}, 'root = \'fixed\': must be one of "pinned", "free"'),
        ({"position": (1.0,)}, "position = (1.0,): must be a sequence of 2 numbers (m)"),
        ({"position": (1.0, "2")}, "position[1] = '2': must be a finite number (m)"),
        ({"angles": (0.0, 1.0)}, "angles = (0.0, 1.0): must be a sequence of 1 numbers (rad)"),
        ({"angles": 1.0}, "angles = 1.0: must be a sequence of 1 numbers (rad)"),
        ({"gravity": 9.81}, "gravity = 9.81: must be a sequence of 2 numbers (m/s^2)"),
        ({"rigid_joints": (1,)}, "rigid_joints[0] = 1: must be a whole number, from 1 to 0"),
        ({"motions": (3,)}, "motions[0] = 3: must be a Motion"),
        ({"motions": (Motion("joint1", tf.constant(0)),)}, 'must be a joint of the arm, "joint0" to "joint0"'),
        (
            {"motions": (Motion("joint0", tf.constant(0.5)),)},
            "motions[0].function(0) = 0.5: must be 0.0, the value of joint0",
        ),
        (
            {"motions": (Motion("root_x", tf.constant(0.0)),), "position": (1.0, 0.0)},
            "motions[0].function(0) = 0.0: must be 1.0, the value of root_x",
        ),
        (
            {"motions": (Motion("joint0", tf.constant(0.0)),) * 2},
            "motions[1].coordinate = 'joint0': must not have two motions",
        ),
        (
            {"motions": (Motion("joint0", tf.constant(0.0)),), "root": "free"},
            "motions[0].coordinate = 'joint0': must not be prescribed where the root is free",
        ),
        (
            {"motions": (Motion("root_y", tf.constant(0.0)),), "root": "free"},
            "motions[0].coordinate = 'root_y': must not be prescribed where the root is free",
        ),
        ({"loads": (JointTorque(1, tf.constant(1)),)}, "loads[0].joint = 1: must be a joint of the arm, 0 to 0"),
        (
            {"loads": (JointTorque(0, tf.constant(1)),), "motions": (Motion("joint0", tf.constant(0.0)),)},
            "loads[0].joint = 0: must be a joint without a prescribed motion",
        ),
        (
            {"loads": (JointTorque(0, tf.constant(1)),), "root": "free"},
            "loads[0].joint = 0: must not be 0 where the root is free",
        ),
        ({"loads": (PointLoad(1, "tip", tf.constant(1)),)}, "loads[0].link = 1: must be a link of the arm, 0 to 0"),
        ({"loads": (tf.constant(1),)}, "must be a JointTorque or a PointLoad"),
        ({"solver": {"formulation": "fem"}}, "solver.formulation = 'fem': must be one of"),
        ({"solver": {"nodes": 5}}, "solver.nodes: unknown option of floating_frame"),
        ({"solver": {"segments": 0}}, "solver.segments = 0: must be a whole number, at least 1"),
        ({"solver": {"dt": 0.1}}, "solver.dt = 0.1: must be given as the scene's own dt"),
        ({"solver": 3}, "solver = 3: must be a sequence of pairs (name, value)"),
    ],
)
def test_a_wrong_scene_is_refused(changes: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError) as caught:
        scene(**changes)
    assert message in str(caught.value)


def test_joints_that_are_rigid() -> None:
    assert scene(TWO, rigid_joints=[1]).rigid_joints == (1,)
    for changes, message in (
        ({"rigid_joints": (1, 1)}, r"rigid_joints\[1\] = 1: must not be given twice"),
        ({"rigid_joints": (0,)}, r"rigid_joints\[0\] = 0: must be a whole number, from 1 to 1"),
        ({"rigid_joints": (1,), "motions": (Motion("joint1", tf.constant(0.0)),)}, r"must be a joint that can turn"),
        ({"rigid_joints": (1,), "loads": (JointTorque(1, tf.constant(1.0)),)}, r"must be a joint that can turn"),
    ):
        with pytest.raises(ValueError, match=message):
            scene(TWO, **changes)


@pytest.mark.parametrize("name", ["joint", "joint-1", "joint01", "root", "tip", 0, "joint1 "])
def test_a_coordinate_must_exist(name: object) -> None:
    with pytest.raises(ValueError, match=r'^coordinate = .*must be "joint0", "joint1"'):
        Motion(name, tf.constant(0.0))  # type: ignore[arg-type]


def test_parts_refuse_what_they_must() -> None:
    with pytest.raises(ValueError, match=r"^t\[1\] = 1.0: a motion must not jump"):
        Motion("joint0", tf.pulse(1.0, 1.0))
    with pytest.raises(ValueError, match=r"force_x: missing; a point load needs"):
        PointLoad(0, "tip")
    with pytest.raises(ValueError, match=r'end = .middle.: must be one of "root", "tip"'):
        PointLoad(0, "middle", tf.constant(1.0))
    with pytest.raises(ValueError, match=r"joint = -1: must be a whole number, at least 0"):
        JointTorque(-1, tf.constant(1.0))
    with pytest.raises(ValueError, match=r"function = 3.0: must be a TimeFunction"):
        JointTorque(0, 3.0)  # type: ignore[arg-type]


def test_the_joint_angle_of_a_motion_is_relative() -> None:
    s = scene(TWO, angles=(0.3, 1.0), motions=(Motion("joint1", tf.ramp(1.0, 1.0, 0.7)),))
    assert s.initial_value("joint0") == 0.3
    assert s.initial_value("joint1") == pytest.approx(0.7)
    assert s.motion_of("joint0") is None
    assert s.motion_of("joint1") == tf.ramp(1.0, 1.0, 0.7)


def test_defaults_and_hash() -> None:
    s = scene(TWO, angles=[0.0, 0.0], position=[0, 0])
    assert s == scene(TWO)
    assert hash(s) == hash(scene(TWO))
    assert s.sample == s.dt == 0.01
    assert s.angles == (0.0, 0.0)
    assert pickle.loads(pickle.dumps(s)) == s
    assert dataclasses.replace(s, duration=1.0) != s


# -------------------------------------------------------------------------- kinks


def test_kinks_of_motions_and_loads() -> None:
    s = scene(
        motions=(Motion("joint0", tf.ramp(1.0, 0.5)), Motion("root_x", tf.cycloid(1.0, 1.5))),
        loads=(PointLoad(0, "tip", force_x=tf.pulse(1.0, 1.0, 0.25), torque=tf.pulse(1.0, 2.0)),),
    )
    assert s.kinks == (0.25, 0.5, 1.0)  # not the smooth motion's end, not the end of the run
    smooth_load = tf.spline_table([0.0, 0.7, 1.4], [0.0, 1.0, 0.0], "clamped")
    assert scene(loads=(JointTorque(0, smooth_load),)).kinks == ()
    assert Motion("joint0", smooth_load).function.kinks == (1.4,)


def test_instants_that_differ_by_round_off_are_one() -> None:
    third = 0.1 + 0.2
    assert third != 0.3
    s = scene(motions=(Motion("joint0", tf.ramp(1.0, third)),), loads=(PointLoad(0, "tip", torque=tf.pulse(1.0, 0.3)),))
    assert s.kinks == (0.3,)
    function = s.motions[0].function
    assert function(0.3, 1, "left") == pytest.approx(1.0 / third)
    assert function(0.3, 1) == 0.0
    assert Scene.from_toml(s.to_toml()) == s
    fine = tf.linear_table([0.0, 1.0, 1.0 + 1e-12, 2.0], [0.0, 1.0, 1.0, 0.0])
    assert scene(motions=(Motion("joint0", fine),)).motions[0].function == fine


# ----------------------------------------------------------------------- settings


def test_settings_of_a_scene() -> None:
    s = scene(solver={"formulation": "geometrically_exact", "order": 3, "elements": 4})
    assert s.settings() == Settings.make("geometrically_exact", order=3, elements=4, dt=0.01)
    assert s.settings(elements=2, dt=0.5) == Settings.make("geometrically_exact", order=3, elements=2, dt=0.5)
    assert s.settings("elastica") == Settings.make("elastica", dt=0.01)
    assert scene().settings() == Settings.make(dt=0.01)
    modal = scene(solver=(("modes", 3),))
    assert modal.settings().modes == 3
    assert modal.settings(elements=5).modes is None
    assert scene(solver={"segments": 2}).settings(modes=2).segments is None
    newmark = scene(solver={"newmark": [0.25, 0.5]})
    assert newmark.settings().newmark == (0.25, 0.5)
    assert newmark.settings(rho_inf=0.9).newmark is None
    assert hash(newmark) == hash(scene(solver={"newmark": (0.25, 0.5)}))
    with pytest.raises(ValueError, match=r"^nodes: unknown option of geometrically_exact"):
        s.settings(nodes=5)


# --------------------------------------------------------------------------- TOML


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
        (
            "[[motions]]\ncoordinate = 'joint0'\nkind = 'step'",
            "motions[0].kind = 'step': must be one of \"constant\"",
        ),
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
            "[[loads]]\nlink = 0\nend = 'tip'\nforce_z = {kind = 'constant', value = 1}",
            "loads[0].force_z: unknown key (did you mean force_y?); allowed: link, end, force_x, force_y, torque",
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
    with pytest.raises(ValueError) as caught:
        Scene.from_toml(GOOD + text)
    assert str(caught.value).startswith(message)


@pytest.mark.parametrize(
    ("arm", "message"),
    [
        ("arm = 'stripe'", "arm = 'stripe': must be one of \"de_luca_siciliano\""),
        ("arm = 3", "arm = 3: must be a text"),
        ("", "arm: missing; must be a name, a .toml file or a table"),
        ("[arm]\nlinks = 3", "arm.links = 3: must be a sequence of tables"),
        ("[arm]\nhub = 3", "arm.hub: unknown key"),
        ("[[arm.links]]\nlength = 1.0", "arm.links[0].section: missing; must be a table of EI, EA, C, m, J"),
        (
            "[[arm.links]]\nlength = 1.0\nsection = {EI = -1.0, EA = 1, C = 1, m = 1}",
            "arm.links[0].section.EI = -1.0: must be a positive number (N m^2)",
        ),
        (
            "[[arm.links]]\nlength = 1.0\nsection = {EI = 1.0, EA = 1, C = 1, mu = 1}",
            "arm.links[0].section.mu: unknown key",
        ),
        (
            "[[arm.links]]\nlength = 1.0\nsection = {EI = 1.0, EA = 1, C = 1}",
            "arm.links[0].section.m: missing",
        ),
        (
            "[[arm.links]]\nlength = '1'\nsection = {EI = 1.0, EA = 1, C = 1, m = 1}",
            "arm.links[0].length = '1': must be a positive number (m)",
        ),
    ],
)
def test_a_wrong_arm_in_a_scene_names_the_key_path(arm: str, message: str) -> None:
    with pytest.raises(ValueError) as caught:
        Scene.from_toml("name = 's'\nduration = 2.0\ndt = 0.01\n" + arm)
    assert str(caught.value).startswith(message)


def test_what_is_no_toml_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "broken.toml"
    path.write_text("duration = = 3")
    with pytest.raises(ValueError, match=rf"^{path}: not a TOML file: .*line 1"):
        Scene.from_toml(path)
    with pytest.raises(FileNotFoundError):
        Scene.from_toml(tmp_path / "none.toml")


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


def test_example_files() -> None:
    paths = sorted((ROOT / "configs" / "scenes").glob("*.toml"))
    assert len(paths) >= 3
    for path in paths:
        s = scenes.resolve(path)
        assert Scene.from_toml(s.to_toml()) == s
        s.settings()
    assert scenes.resolve(ROOT / "configs/scenes/three_link_swing.toml").arm.n_links == 3


def test_toml_text_of_odd_values() -> None:
    table = {"a b": 1, "t": {"x": True, "s": 'é"\n'}, "e": [], "n": [[1, 2], [3]], "big": list(range(60))}
    assert toml_text.read(toml_text.write(table))[0] == table
    with pytest.raises(TypeError):
        toml_text.write({"a": None})


# --------------------------------------------------------------------- references


def test_references_have_origin_tolerance_and_sound_columns() -> None:
    assert scenes.reference_names() == ("robot_arm_motion", "robot_arm_motion_smooth", "flying_rod")
    for name in scenes.reference_names():
        reference, s = scenes.reference(name), scenes.named(name)
        assert reference.scene == name
        assert reference.source
        assert reference.method
        t = reference.columns["t"]
        assert set(reference.columns) == set(scenes.COLUMNS)
        np.testing.assert_allclose(t, np.arange(len(t)) * s.sample, atol=1e-9)
        assert t[-1] == s.duration
        tip = np.array([reference.columns["tip_x"][0], reference.columns["tip_y"][0]])
        straight = np.array(s.position) + 10.0 * np.array([math.cos(s.angles[0]), math.sin(s.angles[0])])
        np.testing.assert_allclose(tip, straight, atol=1e-8)
        with pytest.raises(ValueError):
            reference.columns["t"][0] = 1.0
    for name in ("robot_arm_motion", "robot_arm_motion_smooth"):
        psi = scenes.named(name).motion_of("joint0")
        assert psi is not None
        columns = scenes.reference(name).columns
        np.testing.assert_allclose(columns["start_angle"], psi(columns["t"]), atol=1e-8)
    assert scenes.reference("robot_arm_motion").tip_tolerance == 2e-3
    assert scenes.reference("robot_arm_motion_smooth").tip_tolerance == 1e-4
    with pytest.raises(ValueError, match="unknown scene with a reference"):
        scenes.reference("spin_up")


def test_spot_values_of_another_program_agree_with_the_reference() -> None:
    spots = scenes.spot_values("robot_arm_motion")
    columns = scenes.reference("robot_arm_motion").columns
    for t, x, y in zip(spots["t"], spots["tip_x"], spots["tip_y"], strict=True):
        row = int(np.argmin(np.abs(columns["t"] - t)))
        assert columns["tip_x"][row] == pytest.approx(x, abs=spots["tolerance"]["tip"])
        assert columns["tip_y"][row] == pytest.approx(y, abs=spots["tolerance"]["tip"])


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (["t,energy"], "must begin with t,energy,start_x"),
        ([",".join(scenes.COLUMNS)], "rows = 0: must be at least one"),
        ([",".join(scenes.COLUMNS), "0,0,0,0,0,0,0,x"], "must hold 8 numbers, in row 0"),
        ([",".join(scenes.COLUMNS), "0,0,0"], "must hold 8 numbers, in row 0"),
        ([",".join(scenes.COLUMNS), "0,0,0,0,0,0,0,0", "1,0,0,0,nan,0,0,0"], "must hold finite numbers"),
        ([",".join(scenes.COLUMNS), *itertools.repeat("0,0,0,0,0,0,0,0", 2)], "in row 1"),
    ],
)
def test_a_wrong_trajectory_file_is_refused(tmp_path: Path, lines: list[str], message: str) -> None:
    path = tmp_path / "trajectory.csv"
    path.write_text("\n".join(lines))
    with pytest.raises(ValueError) as caught:
        scenes.read_trajectory(path)
    assert str(caught.value).startswith(str(path))
    assert message in str(caught.value)


def test_the_documented_file_is_a_scene() -> None:
    page = (ROOT / "docs" / "scenes.md").read_text(encoding="utf-8")
    block = page.split("```toml\n")[1].split("```")[0]
    s = Scene.from_toml(block, "heavy")
    assert (s.name, s.gravity, s.arm) == ("swing@heavy", (0.0, -19.62), arms.named("de_luca_siciliano"))
    for name in (*scenes.names(), *arms.names(), *(n for n in scenes.names(True) if "@" in n), *toml.KINDS):
        assert f"`{name}`" in page
