"""Arms as chains of hinges, as MJCF and URDF, and from both: against closed forms and against MuJoCo."""

from __future__ import annotations

import json
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import gymnasium
import numpy as np
import pytest

from flexarm_env import arms
from flexarm_env.cli import main
from flexarm_env.exchange import (
    calibrated,
    chain_modes,
    chain_of,
    choose_integrator,
    differences,
    import_arm,
    mjcf,
    tip_compliance,
    urdf,
)
from flexarm_env.exchange.bare import bare
from flexarm_env.exchange.linear import exact_compliance, mass_matrix
from flexarm_env.exchange.mjcf import diagonal
from flexarm_env.exchange.reader import _model
from flexarm_env.exchange.urdf import rpy
from flexarm_env.parameters import Arm, Joint, Link, RigidLink, Section
from flexarm_env.rigid import rigid_inertia
from flexarm_env.rotations import matrices
from flexarm_env.scene import JointTorque, Scene
from flexarm_env.simulation import simulate
from flexarm_env.time_functions import constant
from flexarm_env.validation import InvalidValue
from tests.refusals import says

UR5 = Path(__file__).parent / "robots" / "ur5.urdf"
ASSETS = Path(gymnasium.__file__).parent / "envs" / "mujoco" / "assets"
TUBE = Section.tube(0.1, 0.002, E=70e9, rho=2700.0, G=26e9)


def needs_mujoco() -> Any:
    return pytest.importorskip("mujoco")


# ------------------------------------------------------------------ the chain
@pytest.mark.parametrize("name", ["strip", "de_luca_siciliano", "two_link_geared", "three_strips"])
@pytest.mark.parametrize("segments", [0, 3])
def test_a_chain_has_the_inertia_of_its_arm(name: str, segments: int) -> None:
    """About its joints, springs locked; rotors included."""
    arm = arms.named(name)
    chain = chain_of(arm, segments)
    driven = [i for i, hinge in enumerate(chain.hinges) if hinge.driven]
    # a rotor behind an elastic gear turns by itself
    rotors = np.diag([arm.joint(k).rotor for k in range(arm.n_links)])
    own = mass_matrix(chain)[np.ix_(driven, driven)] - rotors
    rigid = rigid_inertia(arm, np.zeros((1, arm.n_links)))[0] - rotors
    assert np.abs(own - rigid).max() < 1e-12 * np.abs(rigid).max()
    assert sum(body.mass for body in chain.bodies) == pytest.approx(arm.mass, rel=1e-12)


def test_springs_at_gauss_points_bend_exactly_under_a_tip_load() -> None:
    """F L^3 / (3 EI) from two springs on; a spring in the middle of one piece gives 3/4 of it."""
    arm = arms.named("strip")
    EI = arm.links[0].uniform.EI  # type: ignore[union-attr]
    for segments in (2, 3, 5):
        assert tip_compliance(chain_of(arm, segments))[1, 1] == pytest.approx(1.0 / (3.0 * EI), rel=1e-12)
    assert tip_compliance(chain_of(arm, 1, "middle"))[1, 1] == pytest.approx(0.75 / (3.0 * EI), rel=1e-12)


def test_compliance_of_tapered_and_curved_links_converges() -> None:
    taper = Link.tapered(1.0, (0.04, 0.02), (0.006, 0.003), E=70e9, rho=2700.0, G=26e9)
    for link in (taper, replace(arms.named("strip").links[0], curvature=0.8)):
        arm = Arm("bent", (link,))
        exact = exact_compliance(chain_of(arm))
        errors = [np.abs(tip_compliance(chain_of(arm, n)) - exact).max() / np.abs(exact).max() for n in (2, 4)]
        assert errors[1] < 1e-3 and errors[1] < 0.2 * errors[0]


def test_frequencies_of_a_uniform_cantilever() -> None:
    """Clamped-free: (1.8751^2, 4.6941^2) sqrt(EI / m) / L^2, with many springs."""
    arm = Arm("rod", (Link(2.0, Section(EI=3.0, EA=1e7, C=1e7, m=0.5)),))
    own, _ = chain_modes(chain_of(arm, 40))
    exact = np.array([1.875104, 4.694091]) ** 2 * np.sqrt(3.0 / 0.5) / 4.0 / (2.0 * np.pi)
    assert own[:2] == pytest.approx(exact, rel=2e-3)


@pytest.mark.slow
def test_calibration_meets_the_first_frequency() -> None:
    chain, factor = calibrated(chain_of(arms.named("strip"), 4, "middle"))
    found = differences(chain)
    assert found["chain_frequency_1_hz"] == pytest.approx(found["frequency_1_hz"], rel=1e-9)
    assert 0.9 < factor < 1.0
    # damping ratio tau omega / 2
    own, ratios = chain_modes(chain)
    assert ratios[0] == pytest.approx(0.5 * 2.25e-3 * 2.0 * np.pi * own[0], rel=1e-9)


def test_calibration_of_an_arm_that_does_not_oscillate_is_that_of_its_springs() -> None:
    """Damped beyond critical the first mode has no frequency; the springs are the same."""
    arm = arms.named("strip")
    _, factor = calibrated(chain_of(arm, 4))
    _, damped = calibrated(chain_of(replace(arm, tau_d=1.0), 4))
    assert damped == pytest.approx(factor, rel=1e-9)
    heavy = replace(arm, payload=replace(arm.payload, mass=1e30))
    says("arm = 'strip': must have lengths, masses and stiffnesses", lambda: calibrated(chain_of(heavy, 4)))


@pytest.mark.parametrize("name", ["a\x1b[31m\x00b", "\uffff", "--> <b a='\"'>", "ends with -"])
def test_any_name_gives_xml_that_can_be_read(name: str) -> None:
    arm = replace(arms.named("strip"), name=name)
    for text in (mjcf(chain_of(arm, 2), comments=[name]), urdf(chain_of(arm, 0), [name])):
        top = ElementTree.fromstring(text)
        assert len(top) > 2 and len(top.get("model", top.get("name", ""))) == len(name)


def test_what_hinges_cannot_represent_is_rejected() -> None:
    strip = arms.named("strip")
    with pytest.raises(InvalidValue, match=r"mass_damping = 0\.1: must be 0"):
        chain_of(replace(strip, mass_damping=0.1))
    geared = replace(strip, joints=(Joint(stiffness=100.0, motor_inertia=1e-4, backlash=0.01),))
    with pytest.raises(InvalidValue, match=r"joints\[0\]\.backlash"):
        chain_of(geared)
    with pytest.raises(InvalidValue, match=r"bend0_1 = .*URDF has no springs"):
        urdf(chain_of(strip, 2))
    with pytest.raises(InvalidValue, match="segments"):
        chain_of(strip, -1)


def test_rotations_as_roll_pitch_yaw() -> None:
    def product(roll: float, pitch: float, yaw: float) -> Any:
        x, y, z = np.eye(3)
        return matrices(yaw * z) @ matrices(pitch * y) @ matrices(roll * x)

    for psi in ([0.3, -0.8, 1.4], [0.0, np.pi / 2, 0.0], [0.0, -np.pi / 2, 0.0], [2.0, 1.0, -2.0]):
        R = matrices(np.array(psi))
        assert np.abs(product(*rpy(R)) - R).max() < 1e-12


def test_principal_moments_satisfy_what_mujoco_wants() -> None:
    for I in (np.zeros((3, 3)), np.diag([0.0, 0.0, 1.0]), np.diag([1e-20, 2.0, 2.0])):
        own, _ = diagonal(I)
        assert own.min() > 1e-15 and own.sum() >= 2.0 * own.max()


# --------------------------------------------------------------------- export
@pytest.mark.parametrize("name", ["strip", "de_luca_siciliano", "three_dof", "strip_geared"])
def test_mujoco_reads_the_same_inertia_and_steps_it(name: str) -> None:
    mujoco = needs_mujoco()
    chain = chain_of(arms.named(name), 3)
    model = mujoco.MjModel.from_xml_string(mjcf(chain))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    M = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, M)
    assert np.abs(M - mass_matrix(chain)).max() < 1e-9 * np.abs(M).max()
    data.ctrl[:] = 0.1 * np.array(chain.arm.torque_limits)
    for _ in range(50):
        mujoco.mj_step(model, data)
    assert np.isfinite(data.qpos).all() and np.abs(data.qpos).max() > 1e-6


@pytest.mark.slow
def test_the_exported_strip_moves_as_the_arm_does(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    needs_mujoco()
    out = tmp_path / "strip.xml"
    assert main(["export", "strip", "--to", "mjcf", "--segments", "4", "--out", str(out), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["tip_apart"] < 2e-4
    assert found["chain_frequency_2_hz"] == pytest.approx(found["frequency_2_hz"], rel=2e-3)
    assert "tip" in out.read_text()


def test_stiff_chains_get_the_implicit_integrator() -> None:
    assert choose_integrator(chain_of(arms.named("three_dof"), 3))[0] == "discrete"
    assert choose_integrator(chain_of(arms.named("strip"), 3)) == ("RK4", 0.002)


@pytest.mark.slow
def test_an_urdf_comes_back_as_the_same_rigid_arm(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    needs_mujoco()
    out, back = tmp_path / "arm.urdf", tmp_path / "back.toml"
    assert main(["export", "de_luca_siciliano", "--to", "urdf", "--out", str(out)]) == 0
    assert main(["import", str(out), "--out", str(back)]) == 0
    capsys.readouterr()
    found, own = arms.resolve(back), arms.named("de_luca_siciliano")
    assert all(isinstance(link, RigidLink) for link in found.links)
    assert found.torque_limits == own.torque_limits and found.joint_limits == own.joint_limits
    angles = np.array([[-0.2, 0.7]])
    assert rigid_inertia(found, angles) == pytest.approx(rigid_inertia(own, angles), rel=1e-9)


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["two_link", "--to", "mjcf", "--out", "a.xml"], "arm = 'two_link'"),
        (["strip", "--to", "mjcf", "--out", "a.urdf"], "must end in .xml"),
        (["strip", "--to", "urdf", "--out", "a.urdf", "--segments", "3"], "--segments = 3: must not be given"),
        (["strip", "--to", "mjcf", "--out", "a.xml", "--gravity", "1:2"], "must be X:Y:Z"),
        (["strip", "--to", "mjcf", "--out", "a.xml", "--placement", "ends"], "placement = 'ends'"),
        (["flexible_arm", "--to", "c", "--out", "a.c", "--segments", "3"], "but with --to mjcf"),
    ],
)
def test_errors_of_export(
    words: list[str], says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["export", *words]) == 2
    assert says in capsys.readouterr().err


# --------------------------------------------------------------------- import
ROBOTS: dict[str, tuple[Path, dict[str, Any]]] = {
    "ur5": (UR5, {}),
    "reacher": (ASSETS / "reacher.xml", {"root": "body0", "gear_ratio": 1e8}),
    "pusher": (ASSETS / "pusher_v5.xml", {"root": "r_shoulder_pan_link", "gear_ratio": 1e8}),
}
"""Three robots: UR5 in space (example-robot-data, BSD), Reacher in the plane and Pusher in space (Gymnasium,
MIT). Rotors have gears so high that their gyroscopic moments, which MuJoCo's armature has not, vanish."""


@pytest.mark.slow
@pytest.mark.parametrize("robot", ROBOTS)
def test_the_rigid_limit_is_mujocos(robot: str) -> None:
    """Angles, rates and tip after 0.2 s from a random state, under gravity and random torques, to 1e-6."""
    mujoco = needs_mujoco()
    path, words = ROBOTS[robot]
    found = import_arm(path, **words)
    arm, n, end = found.arm, found.arm.n_links, 0.2
    rng = np.random.default_rng(1)
    q, v = rng.uniform(-0.5, 0.5, n), rng.uniform(-1.0, 1.0, n)
    limits = np.minimum(arm.torque_limits or 0.0, 20.0)
    torque = 0.2 * limits * rng.uniform(-1.0, 1.0, n)
    loads = tuple(JointTorque(k, constant(value)) for k, value in enumerate(torque))
    scene = Scene("rigid", arm, duration=end, dt=1e-3, sample=end, space=True, angles=tuple(q), rates=tuple(v),
                  gravity=found.gravity, loads=loads)  # fmt: skip
    rows = []
    for dt in (5e-4, 2.5e-4):
        run = simulate(scene, "floating_frame", dt=dt, estimate_error=False)
        rows.append(np.concatenate([run.joint_angles[-1], run.joint_rates[-1], run.tip[-1]]))
    # Richardson: the integrator is of second order
    own = rows[1] + (rows[1] - rows[0]) / 3.0
    model, _ = _model(path)
    model.opt.timestep, model.opt.integrator = 1e-4, mujoco.mjtIntegrator.mjINT_RK4
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
    data = mujoco.MjData(model)
    joints = [model.joint(name).id for name in found.joints]
    places, rates = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
    data.qpos[places], data.qvel[rates], data.qfrc_applied[rates] = q, v, torque
    for _ in range(round(end / 1e-4)):
        mujoco.mj_step(model, data)
    mujoco.mj_kinematics(model, data)
    tip = data.body(found.tip).xpos - np.array(found.root) if found.tip else own[-3:]
    theirs = np.concatenate([data.qpos[places], data.qvel[rates], tip])
    assert np.abs(own - theirs).max() < 1e-6
    assert np.abs(own[:n] - q).max() > 0.01


@pytest.mark.slow
def test_an_imported_arm_with_a_flexible_link(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The link keeps its mass; where its section is stiff it moves as its evenly spread rigid link does."""
    needs_mujoco()
    out = tmp_path / "ur5.toml"
    section = "{diameter = 0.1, wall = 0.002, E = 70e9, rho = 2700.0, G = 26e9, kappa = 0.5}"
    words = ["import", str(UR5), "--out", str(out), "--flexible", f"upper_arm_link={section}", "--json"]
    assert main(words) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["upper_arm_link.centre_shift_m"] == pytest.approx(0.0902, abs=1e-3)
    arm = arms.resolve(out)
    assert not arm.links[1].rigid and arm.links[1].mass == pytest.approx(8.393, rel=1e-12)
    assert replace(arm, name="ur5") == import_arm(UR5, flexible={"upper_arm_link": TUBE}).arm
    beam = arm.links[1]
    inertia = beam.mass * beam.length**2 / 12.0
    rigid = RigidLink(beam.length, beam.mass, (0.5 * beam.length, 0.0, 0.0), np.diag([
        (beam.section.J + beam.section.J_y) * beam.length, inertia + beam.section.J_y * beam.length,
        inertia + beam.section.J * beam.length,
    ]))  # fmt: skip
    stiff = replace(beam, section=replace(beam.section, **{
        name: 1e4 * getattr(beam.section, name) for name in ("EI", "EA", "C", "EI_y", "C_y", "GJ")
    }))  # fmt: skip
    tips = []
    for link in (stiff, rigid):
        made = replace(arm, links=(arm.links[0], link, *arm.links[2:]))
        scene = Scene("fall", made, duration=0.1, dt=5e-4, sample=0.1, gravity=(0.0, 0.0, -9.81), angles=(0.3,) * 6)
        tips.append(simulate(scene, "floating_frame", estimate_error=False).tip[-1])
    assert np.abs(tips[0] - tips[1]).max() < 1e-5


SERIAL = """<mujoco><worldbody><body name="a"><joint name="ja" type="hinge" axis="0 0 1"/>
<geom type="capsule" fromto="0 0 0 1 0 0" size="0.02"/>{more}</body></worldbody>{tail}</mujoco>"""
CHILD = """<body name="{0}" pos="1 0 0"><joint name="j{0}" type="hinge" axis="0 0 1"/>
<geom type="capsule" fromto="0 0 0 1 0 0" size="0.02"/></body>"""


@pytest.mark.parametrize(
    ("more", "tail", "says"),
    [
        (CHILD.format("b") + CHILD.format("c"), "", "body a = 2: must carry one moving body"),
        (CHILD.format("b").replace('type="hinge"', 'type="slide"'), "", "joint jb = 'slide': must be a hinge"),
        (CHILD.format("b").replace('type="hinge"', 'type="hinge" stiffness="2"'), "", "joint jb.stiffness = 2.0"),
        (CHILD.format("b").replace('type="hinge"', 'type="hinge" damping="1 2"'), "", "joint jb.damping = [2.0, 0.0]"),
        (CHILD.format("b"), '<equality><weld name="loop" body1="b"/></equality>', "loop = 'equality'"),
        (CHILD.format("b"), '<tendon><fixed name="t"><joint joint="ja" coef="1"/></fixed></tendon>', "t = 'tendon'"),
        ("<body", "", "is no XML"),
        ("", "<what/>", "MuJoCo cannot read it"),
    ],
)
def test_what_a_serial_chain_cannot_represent_is_named(more: str, tail: str, says: str, tmp_path: Path) -> None:
    needs_mujoco()
    path = tmp_path / "robot.xml"
    path.write_text(SERIAL.format(more=more, tail=tail))
    with pytest.raises(ValueError) as caught:
        import_arm(path)
    assert says in str(caught.value) and str(path) in str(caught.value)


def test_errors_of_import(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    needs_mujoco()
    out = str(tmp_path / "arm.toml")
    prismatic = tmp_path / "slide.urdf"
    elbow = 'name="elbow_joint" type="{}"'
    prismatic.write_text(UR5.read_text().replace(elbow.format("revolute"), elbow.format("prismatic")))
    bad = "forearm_link={EI = -1.0, EA = 1.0, C = 1.0, m = 1.0, J = 0.0}"
    for words, error in (
        ([str(tmp_path / "none.urdf")], "no such file"),
        ([str(prismatic)], "joint elbow_joint = 'prismatic'"),
        ([str(ASSETS / "reacher.xml")], "must be one of the mechanisms of the file (body0, target)"),
        ([str(UR5), "--tip", "hand"], "hand: unknown body or site of the last link"),
        ([str(UR5), "--flexible", "hand={EI = 1.0, EA = 1.0, C = 1.0, m = 1.0, J = 0.0}"], "hand: unknown link"),
        ([str(UR5), "--flexible", "forearm_link"], "must be BODY={...}"),
        ([str(UR5), "--flexible", bad], "EI = -1.0"),
    ):
        assert main(["import", *words, "--out", out]) == 2
        assert error in capsys.readouterr().err


def test_several_hinges_of_a_body_and_shifted_zeros(tmp_path: Path) -> None:
    """Hinges of one body become links without mass; a joint's reference angle is taken off its limits."""
    needs_mujoco()
    path = tmp_path / "wrist.xml"
    path.write_text("""<mujoco><compiler angle="radian"/><worldbody><body name="a">
        <joint name="yaw" axis="0 0 1"/><joint name="pitch" axis="0 1 0" ref="0.3" range="-0.5 0.5"/>
        <geom type="capsule" fromto="0 0 0 1 0 0" size="0.02"/><site name="end" pos="1 0 0"/></body></worldbody>
        <actuator><motor joint="yaw" gear="3" ctrlrange="-2 2"/><motor joint="pitch" forcerange="-4 5"/></actuator>
        </mujoco>""")
    found = import_arm(path)
    assert found.joints == ("yaw", "pitch") and found.links == ("a:yaw", "a") and found.tip == "end"
    assert [link.mass > 0.0 for link in found.arm.links] == [False, True]
    assert found.arm.joint_limits == (None, pytest.approx((-0.8, 0.2)))
    assert found.arm.torque_limits == (6.0, 4.0)


def test_constraints_of_another_mechanism_do_not_matter(tmp_path: Path) -> None:
    needs_mujoco()
    path = tmp_path / "two.xml"
    other = SERIAL.format(more="", tail='<equality><weld name="w" body1="x"/></equality>')
    path.write_text(other.replace("</worldbody>", '<body name="x"><freejoint/><geom size="0.1"/></body></worldbody>'))
    assert import_arm(path, root="a").joints == ("ja",)


HINGED = """<robot name="r"><link name="base"/><link name="a"><inertial><origin xyz="0.2 0 0"/><mass value="1"/>
<inertia ixx="0.01" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link><link name="tip"/>
<joint name="j" type="revolute"><parent link="base"/><child link="a"/><axis xyz="0 0 1"/>
<limit lower="-2" upper="2" effort="10" velocity="3"/></joint>
<joint name="f" type="fixed"><parent link="a"/><child link="tip"/><origin xyz="0.5 0 0"/></joint></robot>"""


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('mass value="1"', 'mass value="inf"', "link a.mass.value = 'inf': must be a finite number"),
        ('mass value="1"', 'mass value=""', "link a.mass.value = '': must be a finite number"),
        ('mass value="1"', 'mass value="1 0.0"', "link a.mass.value = '1 0.0': must be a finite number"),
        ('xyz="0.5 0 0"', 'xyz="0.5 0"', "joint f.origin.xyz = '0.5 0': must be 3 finite numbers"),
        ('ixx="0.01"', 'ixx="0,01"', "link a.inertia.ixx = '0,01'"),
        ('xyz="0.5 0 0"', 'xyz="nan 0 0"', "joint f.origin.xyz = 'nan 0 0'"),
        ('effort="10"', 'effort="nan"', "joint j.limit.effort = 'nan'"),
        ('effort="10"', 'effort="-3"', "joint j.limit.effort = -3.0: must be a number, zero or positive (N m)"),
        ('lower="-2"', 'lower="nan"', "joint j.limit.lower = 'nan'"),
        ('lower="-2" upper="2"', 'lower="2" upper="-2"', "joint j.limit = (2.0, -2.0): must be lower < upper (rad)"),
        ('name="f" type="fixed"', 'name="j" type="fixed"', "joint j = 'two joints': must have names of their own"),
        ("</robot>", "<a>" * 2000 + "</a>" * 2000 + "</robot>", "text: elements are nested more than 100 deep"),
    ],
)
def test_wrong_numbers_of_an_urdf_are_named(old: str, new: str, words: str) -> None:
    """MuJoCo drops limits that are not in order or no numbers, and a number of infinite size spreads."""
    assert old in HINGED
    says(words, lambda: bare(ElementTree.fromstring(HINGED.replace(old, new))))


def test_limits_that_exporters_write_for_none_are_named() -> None:
    zeros = HINGED.replace('lower="-2" upper="2" effort="10"', 'lower="0" upper="0" effort="0"')
    text, left_out = bare(ElementTree.fromstring(zeros))
    assert left_out == ["limits of j, whose ends are both 0 rad", "torque limit of j, which is 0"]
    assert "lower" not in text and bare(ElementTree.fromstring(HINGED))[1] == []


@pytest.mark.parametrize(
    ("joint", "motor", "words"),
    [
        ('range="2 -2"', 'ctrlrange="-5 5"', "joint ja.range = (2.0, -2.0): must increase"),
        ("", 'ctrlrange="nan 5"', "actuator m.ctrlrange = (nan, 5.0): must increase"),
        ("", 'ctrlrange="0 5"', "actuator m.ctrlrange = (0.0, 5.0): must reach from below 0 to above"),
        ("", 'forcerange="1 5"', "actuator m.forcerange = (1.0, 5.0): must reach"),
        ("", 'gear="0" ctrlrange="-5 5"', "actuator m.gear = 0.0"),
        ('damping="nan"', 'ctrlrange="-5 5"', "joint ja.friction_viscous = nan"),
    ],
)
def test_ranges_that_mujoco_ignores_are_rejected(joint: str, motor: str, words: str, tmp_path: Path) -> None:
    """An arm without the limit would turn without bound, or pull where its motor only pushes."""
    needs_mujoco()
    path = tmp_path / "robot.xml"
    text = SERIAL.format(more="", tail=f'<actuator><motor name="m" joint="ja" {motor}/></actuator>')
    path.write_text(text.replace('type="hinge"', f'type="hinge" {joint}'))
    says(f"{path}: {words}", lambda: import_arm(path))


def test_wrong_numbers_of_a_file_leave_no_trace_of_mujoco(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No file MUJOCO_LOG.TXT in the folder, no warning of NumPy, and the file's own error."""
    needs_mujoco()
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "far.xml"
    far = SERIAL.format(more=CHILD.format("b"), tail="").replace('pos="1 0 0"', 'pos="1e200 0 0"')
    weight = far.replace("<worldbody>", '<option gravity="nan 0 0"/><worldbody>')
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for text, words in (
            (far, "link a.length = inf"), (weight, "option.gravity[0] = nan"),
            (far.replace('pos="1e200 0 0"', 'pos="1e12 0 0"'), "link a.length = 1000000000000.0: must be"),
            ("<mujoco><what/></mujoco>", f"{path}: MuJoCo cannot read it"),
        ):  # fmt: skip
            path.write_text(text)
            says(words, lambda: import_arm(path))
    says("gear_ratio = 1e-300", lambda: import_arm(path, gear_ratio=1e-300))
    assert [one.name for one in tmp_path.iterdir()] == ["far.xml"]
