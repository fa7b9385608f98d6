"""Named arms: their numbers against sources, TOML and errors."""

import dataclasses
import math
import re
import warnings
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from flexarm_env import arms
from flexarm_env.linear import modes
from flexarm_env.parameters import Arm, Elbow, Link, Payload, Section
from flexarm_env.scene import Scene
from tests.processes import ROOT
from tests.refusals import refusal, refuses
from tests.scene_tools import everything


def test_names_and_sources() -> None:
    known = {"strip", "de_luca_siciliano", "paper", "paper_two_link", "quanser_2dsfl", "strip_geared", "three_strips"}
    known |= {"two_link_geared", "two_link_upright", "strip_upright", "quanser_2dsfl@design"}
    known |= {"three_dof", "three_dof_loaded", "satellite_arm", "turret_boom"}
    assert set(arms.names()) == known
    for name in arms.names():
        arm = arms.named(name)
        assert arm.name == name
        assert arm.source
        assert arm.torque_limits is not None
        assert len(arm.torque_limits) == arm.n_links


def test_strip() -> None:
    arm = arms.named("strip")
    assert arm.n_links == 1
    assert arm.links[0].length == 1.0
    assert arm.links[0].section == Section.rectangle(0.03, 0.00342, 70e9, 2700, 26e9, 0.85)
    assert (arm.hub_inertia, arm.payload, arm.torque_limits) == (0.05, Payload(0.2), (2.0,))
    assert arm.tau_d == pytest.approx(2 * 0.01 / 8.889, rel=1e-3)  # of the clamped arm's first mode: `test_linear.py`


def test_de_luca_siciliano() -> None:
    arm = arms.named("de_luca_siciliano")
    for link in arm.links:
        assert (link.length, link.section.EI, link.section.m) == (0.5, 1.0, 0.2)
        assert link.slenderness < 1e-5  # stiff in shear, and in stretch:
        assert link.section.EI / (link.section.EA * link.length**2) < 1e-5
    assert arm.hub_inertia == 0.1
    assert arm.elbows == (Elbow(1.0, 0.05, 0.05),)
    assert arm.payload == Payload(0.1, 5e-4)
    assert (arm.torque_limits, arm.joint_limits) == ((1.0, 0.3), (None, (-2.8, 2.8)))
    assert arm.tau_d == pytest.approx(2 * 0.01 / (2 * math.pi * 0.48), rel=1e-3)


def test_quanser() -> None:
    arm = arms.named("quanser_2dsfl@design")
    first, second = arm.links
    inch, E = 0.0254, 2.068427e11
    assert pytest.approx(E * 3 * inch * (0.05 * inch) ** 3 / 12, rel=1e-12) == first.section.EI
    assert pytest.approx(E * 1.5 * inch * (0.035 * inch) ** 3 / 12, rel=1e-12) == second.section.EI
    # the vendor's torsional springs, 40.0 and 6.9 N m/rad, are 3 EI / L; torque limits are 2 degrees of them
    springs = np.array([3 * link.section.EI / link.length for link in arm.links])
    np.testing.assert_allclose(springs, [40.0, 6.9], atol=0.05)
    assert arm.torque_limits is not None
    np.testing.assert_allclose(arm.torque_limits, springs * math.radians(2), atol=0.005)
    assert arm.hub_inertia == pytest.approx(100**2 * 6.28e-6 + 0.00073616)
    elbow = arm.elbow(1)
    assert elbow.inertia_right == pytest.approx(50**2 * 1.03e-6 + 0.00044455)
    assert arm.payload.inertia == pytest.approx(0.157 * (0.0445**2 + 0.0224**2) / 12, rel=1e-3)
    assert elbow.mass + second.mass + arm.payload.mass == pytest.approx(1.578, abs=1e-4)
    # what link 1 carries, straight, about its root: the vendor's 0.17043 kg m^2
    a, b, m = first.length, arm.total_length, second.section.m
    carried = elbow.mass * a**2 + m * (b**3 - a**3) / 3 + arm.payload.mass * b**2 + arm.payload.inertia
    assert carried + elbow.inertia_left == pytest.approx(0.17043, abs=5e-4)
    scene = everything(Scene("straight", arm, duration=1.0, dt=0.01, rigid_joints=(1,)))
    omega = modes(scene, 1, "geometrically_exact", elements=4, clamped=True).frequencies[0]
    assert omega / (2 * math.pi) == pytest.approx(1.67, abs=0.01)
    assert arm.tau_d == pytest.approx(2 * 0.01 / omega, rel=0.01)


@pytest.mark.parametrize("name", arms.names())
def test_named_arms_round_trip(name: str) -> None:
    arm = arms.named(name)
    assert arms.from_toml(arms.to_toml(arm)) == arm
    in_a_table = re.sub(r"^(\[+)", r"\1arm.", arms.to_toml(arm), flags=re.MULTILINE)
    assert arms.from_toml("[arm]\n" + in_a_table) == arm


def test_resolve(tmp_path: Path) -> None:
    arm = Arm("mine", (Link(1.0, Section(1.0, 1.0, 1.0, 1.0)),) * 3, mass_damping=0.1, joint_limits=(None,) * 3)
    path = tmp_path / "mine.toml"
    path.write_text(arms.to_toml(arm))
    assert arms.resolve(arm) is arm
    assert arms.resolve("strip") is arms.named("strip")
    assert arms.resolve(path) == arms.resolve(str(path)) == arms.resolve("mine.toml", tmp_path) == arm
    for wrong in ("stripe", "none.toml", str(tmp_path)):
        with pytest.raises(ValueError, match=r'^arm = .*must be one of "de_luca_siciliano", .*or a .toml file'):
            arms.resolve(wrong)
    refuses(r"^arm = 3: must be a name, a TOML file or an Arm", lambda: arms.resolve(3))
    refuses(r"^arm = 'stripe': must be one of", lambda: arms.named("stripe"))


def test_the_example_arm() -> None:
    arm = arms.resolve(ROOT / "configs" / "arms" / "two_rods.toml")
    assert arm.n_links == 2
    assert arm.joint_limits == (None, (-2.5, 2.5))
    assert arm.links[1].section == Section.rectangle(0.02, 0.0025, 70e9, 2700, 26e9)


LINK = "[[links]]\nlength = 1.0\nsection = {EI = 1.0, EA = 1.0, C = 1.0, m = 1.0}\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("links = []", "name: missing"),
        ("name = 'a'", "links: missing"),
        ("name = 'a'\nlinks = []", "links = (): must be a sequence of at least one Link"),
        ("name = 'a'\npayloads = 1", "payloads: unknown key (did you mean payload?)"),
        ("name = 'a'\ntau_d = -1\n" + LINK, "tau_d = -1: must be a number, zero or positive (s)"),
        ("name = 'a'\npayload = {mass = '1'}\n" + LINK, "payload.mass = '1': must be"),
        ("name = 'a'\npayload = 1\n" + LINK, "payload = 1: must be a table"),
        ("name = 'a'\n" + LINK + LINK + "[[elbows]]\nmas = 1", "elbows[0].mas: unknown key"),
        ("name = 'a'\n" + LINK + LINK + "[[elbows]]\nmass = -1", "elbows[0].mass = -1: must be"),
        (
            "name = 'a'\n[[links]]\nlength = 1\nsection = {width = 1, thickness = 1, E = 1, rho = 1}",
            "links[0].section.G: missing",
        ),
        (
            "name = 'a'\n[[links]]\nlength = 1\nsection = {diameter = 1, wall = 0.1, E = 1, rho = 1}",
            "links[0].section.G: missing; a tube needs diameter, wall, E, rho, G",
        ),
        (
            "name = 'a'\n[[links]]\nlength = 1\nsection = {width = 1, thickness = 0, E = 1, rho = 1, G = 1}",
            "links[0].section.thickness = 0: must be a positive number (m)",
        ),
        (
            "name = 'a'\n[[links]]\nlength = 1\nsection = {EI = 1, EA = 1, C = 1, m = 1, width = 1}",
            "links[0].section.width: unknown key",
        ),
    ],
)
def test_a_wrong_file_names_the_key_path(text: str, message: str) -> None:
    assert refusal(lambda: arms.from_toml(text + "\n")).startswith(message)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "ideal"), [("strip_geared", "strip"), ("two_link_geared", "de_luca_siciliano")]
)
def test_arms_on_gears(name: str, ideal: str) -> None:
    """Whole and back; gears lower the first held frequency by a fifth and more, friction is 3 % of the limits."""
    arm = arms.named(name)
    joints = tuple(range(arm.n_links))
    assert arms.from_toml(arms.to_toml(arm)) == arm and arm.total_length == pytest.approx(1.0)
    assert arm.torque_limits is not None and arm.sensors is not None
    for joint, limit in zip(arm.joints, arm.torque_limits, strict=True):
        assert joint.friction_coulomb == pytest.approx(0.03 * limit)
        assert joint.motor is not None and joint.motor.current_limit is not None
        assert joint.motor.torque_constant * joint.motor.current_limit * joint.gear_ratio > limit
    first = [
        modes(Scene("s", a, duration=1.0, dt=0.01), 1, "elastica", clamped=joints).frequencies[0]
        for a in (arms.named(ideal), arm)
    ]
    assert first[1] < 0.8 * first[0]


def test_joints_in_toml() -> None:
    text = 'name = "a"\n[[links]]\nlength = 1.0\nsection = { EI = 1, EA = 1, C = 1, m = 1 }\n[[joints]]\n'
    assert arms.from_toml(text + "stiffness = inf").joints[0].elastic is False
    for line, words in (
        ("stifness = 1.0", r"joints\[0\].stifness: unknown key \(did you mean stiffness"),
        ("stiffness = -1.0", r"joints\[0\].stiffness = -1.0: must be a positive number \(N m/rad\), or inf"),
        ("motor = { resistance = 1.0 }", r"joints\[0\].motor.torque_constant: missing"),
        ("motor = { torque_constant = 1.0, voltage_limit = 3.0 }", r"joints\[0\].motor.resistance: missing"),
        ("backlash = 0.1", r"joints\[0\].backlash = 0.1: must be 0"),
    ):
        with pytest.raises(ValueError, match=words):
            arms.from_toml(text + line)


def test_quanser_is_fitted_and_keeps_what_was_not() -> None:
    """Masses and torque limits are the design's; mode 1 with both motors held is near what rings in the run."""
    arm, design = arms.named("quanser_2dsfl"), arms.named("quanser_2dsfl@design")
    for name in ("payload", "hub_inertia", "torque_limits"):
        assert getattr(arm, name) == getattr(design, name)
    assert arm.elbow(1).mass == design.elbow(1).mass
    for own, old in zip(arm.links, design.links, strict=True):
        assert own.uniform is not None and old.uniform is not None
        assert own.length == old.length and own.mass == pytest.approx(old.mass, rel=1e-6)
        assert 0.55 < own.uniform.EI / old.uniform.EI < 0.7
    scene = everything(Scene("straight", arm, duration=1.0, dt=0.01))
    omega = modes(scene, 1, "elastica", clamped=(0, 1)).frequencies[0]
    assert omega / (2 * math.pi) == pytest.approx(1.82, abs=0.01)


def test_a_table_of_an_arm_without_a_name_has_that_of_its_file(tmp_path: Path) -> None:
    text = arms.to_toml(arms.named("strip")).replace('name = "strip"\n', "").replace("[payload]", "[arm.payload]")
    file = tmp_path / "mine.toml"
    file.write_text("[arm]\n" + text.replace("[[links]]", "[[arm.links]]").replace("[links.", "[arm.links."), "utf-8")
    assert arms.from_toml(file).name == "mine"


SIDES = "width = 0.03, thickness = 0.002, E = 70e9, rho = 2700.0, G = 26e9"


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ("thickness = 3", "links[0].section.thickness = 3: read as m; in mm it would be 0.003 m"),
        ("E = 200", "links[0].section.E = 200: read as Pa; in GPa it would be 2e+11 Pa"),
        ("E = 210e3", "links[0].section.E = 210000: read as Pa; in MPa it would be 2.1e+11 Pa"),
        ("rho = 7.85", "links[0].section.rho = 7.85: read as kg/m^3; in g/cm^3 it would be 7850 kg/m^3"),
    ],
)
def test_likely_slips_of_units_cause_a_warning(given: str, words: str) -> None:
    usual = ", ".join(part for part in SIDES.split(", ") if part.split()[0] != given.split()[0])
    with pytest.warns(UserWarning) as caught:
        arms.from_toml(f"name = 'a'\n[[links]]\nlength = 1.0\nsection = {{{usual}, {given}}}\n")
    assert [str(one.message) for one in caught] == [words]


def test_packaged_arms_have_usual_units() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for name in arms.names():
            arms.named.__wrapped__(name)
        arms.from_toml(f"name = 'a'\n[[links]]\nlength = 1.0\nsection = {{{SIDES}}}\n")


def test_a_file_without_torque_limits_is_named(tmp_path: Path) -> None:
    path = tmp_path / "weak.toml"
    path.write_text(arms.to_toml(dataclasses.replace(arms.named("strip"), torque_limits=None)))
    refuses(r"weak\.toml: torque_limits: missing; an environment", lambda: gym.make("FlexibleArm-v0", arm=str(path)))
