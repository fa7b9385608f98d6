"""Scenes: the named ones against the page that declares them, checks, kinks and settings."""

import dataclasses
import math
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flexarm_env import scenes
from flexarm_env import time_functions as tf
from flexarm_env.parameters import Arm, Joint, Link, Payload, Section
from flexarm_env.physics.assembly import assemble
from flexarm_env.physics.exact import build as exact
from flexarm_env.scene import JointTorque, Motion, PointLoad, Scene
from flexarm_env.settings import Settings
from tests.refusals import refusal, refuses, says
from tests.scene_tools import TWO, scene

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
    EI, EA, C = PRINTED[name]
    assert pytest.approx(0.867 * EA) == C
    for link, original in zip(printed.arm.links, s.arm.links, strict=True):
        section = dataclasses.replace(original.section, EI=EI, EA=EA, C=C)
        assert link == dataclasses.replace(original, section=section)


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
    refuses(r"did you mean flying_rod\?", lambda: scenes.named("flyingrod"))
    refuses(r"must be a name or a .toml file that exists", lambda: scenes.resolve("nowhere.toml"))
    refuses(r"scene = 3: must be a name", lambda: scenes.resolve(3))


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
        ({"solver": {"segments": 0}}, "solver.segments = 0: must be a whole number, from 1 to 1000"),
        ({"solver": {"dt": 0.1}}, "solver.dt = 0.1: must be given as the scene's own dt"),
        ({"solver": 3}, "solver = 3: must be a sequence of pairs (name, value)"),
        ({"solver": [([1], 2)]}, "solver[0][0] = [1]: must be a text"),
    ],
)
def test_a_wrong_scene_is_refused(changes: dict[str, object], message: str) -> None:
    says(message, lambda: scene(**changes))


def test_joints_that_are_rigid() -> None:
    assert scene(TWO, rigid_joints=[1]).rigid_joints == (1,)
    still, turned = Motion("joint1", tf.constant(0.0)), JointTorque(1, tf.constant(1.0))
    says("rigid_joints[1] = 1: must not be given twice", lambda: scene(TWO, rigid_joints=(1, 1)))
    says("rigid_joints[0] = 0: must be a whole number, from 1 to 1", lambda: scene(TWO, rigid_joints=(0,)))
    says("must be a joint that can turn", lambda: scene(TWO, rigid_joints=(1,), motions=(still,)))
    says("must be a joint that can turn", lambda: scene(TWO, rigid_joints=(1,), loads=(turned,)))


@pytest.mark.parametrize("name", ["joint", "joint-1", "joint01", "root", "tip", 0, "joint1 "])
def test_a_coordinate_must_exist(name: object) -> None:
    refuses(r'^coordinate = .*must be "joint0", "joint1"', lambda: Motion(name, tf.constant(0.0)))


def test_parts_refuse_what_they_must() -> None:
    refuses(r"^t\[1\] = 1.0: a motion must not jump", lambda: Motion("joint0", tf.pulse(1.0, 1.0)))
    refuses(r"force_x: missing; a point load needs", lambda: PointLoad(0, "tip"))
    refuses(r'end = .middle.: must be one of "root", "tip"', lambda: PointLoad(0, "middle", tf.constant(1.0)))
    refuses(r"joint = -1: must be a whole number, at least 0", lambda: JointTorque(-1, tf.constant(1.0)))
    refuses(r"function = 3.0: must be a TimeFunction", lambda: JointTorque(0, 3.0))


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
    refuses(r"^nodes: unknown option of geometrically_exact", lambda: s.settings(nodes=5))


@dataclasses.dataclass(frozen=True)
class Hardening(Section):
    """A section with a law of its own."""

    hardening: float = 0.0


@dataclasses.dataclass(frozen=True)
class Worn(Joint):
    """A joint with a law of its own."""

    wear: float = 0.0


@dataclasses.dataclass(frozen=True)
class Sloshing(Payload):
    """A payload with a law of its own."""

    slosh: float = 0.0


PLAIN = {"EI": 1.0, "EA": 1e4, "C": 1e4, "m": 1.0}
HARD = Hardening(**PLAIN, hardening=40.0)


@pytest.mark.parametrize("formulation", ["elastica", "geometrically_exact", "floating_frame"])
@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"links": (Link(1.0, HARD),)}, "links[0].section.hardening = 40.0: is not taken into account by "),
        (
            {"links": (Link(1.0, ((0.0, Section(**PLAIN)), (1.0, HARD))),)},
            "links[0].section[1][1].hardening = 40.0: is not taken into account by ",
        ),
        ({"links": (Link(1.0, Hardening(**PLAIN)),)}, "links[0].section = 'Hardening': must be one of Arm, Link, "),
        ({"joints": (Worn(wear=0.1),)}, "joints[0].wear = 0.1: is not taken into account by "),
        ({"payload": Sloshing(0.1, slosh=2.0)}, "payload.slosh = 2.0: is not taken into account by "),
    ],
)
def test_what_a_formulation_does_not_know_is_refused_by_name(
    changes: dict[str, Any], words: str, formulation: str
) -> None:
    arm = Arm("own", **{"links": (Link(1.0, Section(**PLAIN)),), **changes})
    scene = Scene("own", arm, duration=1.0, dt=0.01)
    told = refusal(lambda: assemble(scene, scene.settings(formulation)))
    assert told.startswith(words) and formulation in told


def test_a_formulation_that_declares_a_law_takes_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Only that one: a field that one formulation reads is refused by the others."""
    scene = Scene("own", Arm("own", (Link(1.0, HARD),)), duration=1.0, dt=0.01)
    known = {**exact.HONOURS, Hardening: (*exact.HONOURS[Section], "hardening")}
    monkeypatch.setattr(exact, "HONOURS", known)
    assert assemble(scene, scene.settings("geometrically_exact")).q0.size
    with pytest.raises(ValueError, match=r"hardening = 40\.0: is not taken into account by elastica"):
        assemble(scene, scene.settings("elastica"))
