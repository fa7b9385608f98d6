"""Sections, links, arms and settings: what is taken, what is refused and how the refusal reads."""

import copy
import dataclasses
import math
import pickle

import numpy as np
import pytest

from flexarm_env.parameters import Arm, Elbow, Joint, Link, Payload, Section
from flexarm_env.scenes import named
from flexarm_env.settings import FORMULATIONS, Settings, default_options, options_of
from flexarm_env.validation import InvalidValue, MissingKey, UnknownKey, number, under
from tests.refusals import refusal, refuses, says

SECTION = Section(EI=1000.0, EA=1e4, C=1e4, m=1.0, J=10.0)
LINK = Link(10.0, SECTION)


def test_rectangle_by_hand() -> None:
    section = Section.rectangle(width=0.03, thickness=0.00342, E=70e9, rho=2700.0, G=26e9, kappa=0.85)
    area, second_moment = 0.03 * 0.00342, 0.03 * 0.00342**3 / 12
    assert pytest.approx(70e9 * second_moment, rel=1e-15) == section.EI
    assert pytest.approx(7.0, rel=1e-4) == section.EI
    assert pytest.approx(70e9 * area, rel=1e-15) == section.EA
    assert pytest.approx(0.85 * 26e9 * area, rel=1e-15) == section.C
    assert section.m == pytest.approx(2700 * area, rel=1e-15)
    assert pytest.approx(2700 * second_moment, rel=1e-15) == section.J


def test_derived_quantities() -> None:
    arm = Arm("a", (LINK, Link(5.0, SECTION)), elbows=(Elbow(2.0),), payload=Payload(3.0))
    assert arm.n_links == 2
    assert arm.total_length == 15.0
    assert arm.mass == 10.0 + 5.0 + 2.0 + 3.0
    assert LINK.slenderness == 1000.0 / (1e4 * 100.0)
    assert arm.elbow(1) == Elbow(2.0)
    assert Arm("b", (LINK, LINK)).elbow(1) == Elbow()
    refuses(r"joint = 2: must be from 1 to 1", lambda: arm.elbow(2))


def test_values_are_floats_and_sequences_tuples() -> None:
    arm = Arm("a", [LINK, LINK], torque_limits=[1, np.float32(2)], joint_limits=[None, (np.int64(-1), 2)])
    assert arm.links == (LINK, LINK)
    assert arm.torque_limits == (1.0, 2.0)
    assert all(type(v) is float for v in arm.torque_limits)
    assert arm.joint_limits == (None, (-1.0, 2.0))
    assert type(Section(1, 1, 1, 1).EI) is float


def test_hashable_immutable_and_copied_equal() -> None:
    arm = Arm("a", (LINK,), joint_limits=((-1.0, 1.0),))
    twin = Arm("a", (Link(10, Section(1000, 1e4, 1e4, 1, 10)),), joint_limits=((-1, 1),))
    assert arm == twin
    assert hash(arm) == hash(twin)
    assert arm != dataclasses.replace(arm, tau_d=0.1)
    assert pickle.loads(pickle.dumps(arm)) == arm
    assert copy.deepcopy(arm) == arm
    with pytest.raises(dataclasses.FrozenInstanceError):
        arm.tau_d = 1.0


@pytest.mark.parametrize("bad", [-1.0, 0.0, math.nan, math.inf, True, "1000", None, 1j])
def test_a_stiffness_must_be_positive(bad: object) -> None:
    told = refusal(lambda: Section(EI=bad, EA=1.0, C=1.0, m=1.0))
    assert told == f"section.EI = {bad!r}: must be a positive number (N m^2)"


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Section(1, 1, 1, 1, -1), "section.J = -1: must be a number, zero or positive (kg m)"),
        (
            lambda: Section.rectangle(1, 1, 1, 1, 1, 1.5),
            "section.kappa = 1.5: must be a finite number, above 0 and at most 1",
        ),
        (lambda: Link(0.0, SECTION), "length = 0.0: must be a positive number (m)"),
        (
            lambda: Link(1.0, "s"),
            "section = 's': must be a Section, a Taper or a sequence of two or more (s, Section)",
        ),
        (lambda: Joint(gear_ratio=1e308), "gear_ratio = 1e+308: must be a finite number, above 0 and at most 1e+09"),
        (lambda: Elbow(mass=-2), "mass = -2: must be a number, zero or positive (kg)"),
        (lambda: Payload(inertia=math.nan), "payload.inertia = nan: must be a number, zero or positive (kg m^2)"),
        (lambda: Arm("a", ()), "links = (): must be a sequence of at least one Link"),
        (lambda: Arm("a", (LINK, 3)), "links[1] = 3: must be a Link"),
        (lambda: Arm(" ", (LINK,)), "name = ' ': must be a text that is not empty"),
        (lambda: Arm("a", (LINK,), tau_d="0"), "tau_d = '0': must be a number, zero or positive (s)"),
        (lambda: Arm("a", (LINK,), torque_limits=(0.0,)), "torque_limits[0] = 0.0: must be a positive number (N m)"),
        (
            lambda: Arm("a", (LINK,), torque_limits=(1.0, 2.0)),
            "torque_limits = (1.0, 2.0): must be a sequence of 1 positive numbers (N m), one per joint",
        ),
        (
            lambda: Arm("a", (LINK,), joint_limits=((2.0, 1.0),)),
            "joint_limits[0] = (2.0, 1.0): must be (low, high) with low < high (rad)",
        ),
        (
            lambda: Arm("a", (LINK, LINK), joint_limits=(None, (1.0,))),
            "joint_limits[1] = (1.0,): must be a sequence of two numbers, (low, high) in rad",
        ),
    ],
)
def test_a_refusal_names_key_value_and_what_is_allowed(make: object, message: str) -> None:
    assert refusal(make) == message


def test_elbows_match_the_links() -> None:
    refuses(r"^elbows = .*must be empty or hold 1 ", lambda: Arm("a", (LINK, LINK), elbows=(Elbow(), Elbow())))


def test_errors_keep_their_parts_and_can_be_pickled() -> None:
    with pytest.raises(InvalidValue) as caught, under("links[0]"):
        number("section.EI", -1.0, "N m^2", above=0.0)
    error = caught.value
    assert (error.path, error.value) == ("links[0].section.EI", -1.0)
    assert str(error) == "links[0].section.EI = -1.0: must be a positive number (N m^2)"
    for each in (error, UnknownKey("a.b", ("bc",)), MissingKey("a", "must be there")):
        assert str(pickle.loads(pickle.dumps(each))) == str(each)


# ------------------------------------------------------------------------ settings


def test_defaults_of_each_formulation() -> None:
    frame = Settings.make()
    assert (frame.formulation, frame.segments, frame.elements, frame.coupling) == ("floating_frame", 5, 1, "von_karman")
    assert (frame.rho_inf, frame.tolerance, frame.newton, frame.dt) == (0.9, 1e-10, "full", None)
    exact = Settings.make("geometrically_exact")
    assert (exact.elements, exact.order, exact.rho_inf, exact.segments, exact.coupling) == (5, 2, 0.7, None, None)
    elastica = Settings.make("elastica")
    assert (elastica.nodes, elastica.rho_inf, elastica.elements) == (6, 1.0, None)


def test_paper_names_the_solver_of_the_paper() -> None:
    """Geometric stiffness [45], Lagrange multipliers, Newmark with beta = 1/4, gamma = 1/2; options override it."""
    theirs = {"coupling": "paper", "multipliers": True, "newmark": (0.25, 0.5)}
    assert Settings.make("paper") == Settings.make("floating_frame", **theirs)
    assert Settings.make("paper").frame == "root"
    damped = Settings.make("paper", rho_inf=0.9, segments=8)
    assert (damped.newmark, damped.rho_inf, damped.segments, damped.coupling) == (None, 0.9, 8, "paper")
    scene = named("robot_arm_motion")
    assert scene.settings("paper") == scene.settings("floating_frame", **theirs)
    with pytest.raises(ValueError, match="nodes: unknown option of floating_frame"):
        Settings.make("paper", nodes=4)
    with pytest.raises(ValueError, match=r"^formulation = 'papers': must be one of .*\"paper\""):
        Settings.make("papers")


def test_modes_and_newmark_replace_what_they_exclude() -> None:
    modal = Settings.make(modes=3)
    assert (modal.modes, modal.segments, modal.elements, modal.coupling) == (3, None, None, None)
    newmark = Settings.make(newmark=(0.25, 0.5))
    assert (newmark.newmark, newmark.rho_inf) == ((0.25, 0.5), None)
    assert modal.replace(elements=2) == Settings.make(elements=2)
    assert Settings.make(segments=8).replace(modes=2) == Settings.make(modes=2)
    assert Settings.make(segments=8).replace(modes=2, segments=4) == Settings.make(modes=2, segments=4)
    assert Settings.make(modes=2, segments=4).replace(dt=0.1).options()["segments"] == 4
    assert newmark.replace(rho_inf=0.8) == Settings.make(rho_inf=0.8)
    assert Settings.make(rho_inf=0.8).replace(newmark=(0.25, 0.5)) == newmark


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_options_make_the_settings_again(formulation: str) -> None:
    settings = Settings.make(formulation, dt=0.01, tolerance=1e-8)
    assert Settings.make(formulation, **settings.options()) == settings
    assert settings.with_dt(0.5) == settings
    assert Settings.make(formulation).with_dt(0.5).dt == 0.5
    assert set(default_options(formulation)) == set(options_of(formulation))
    assert hash(settings) == hash(settings.replace(max_halvings=8))
    assert pickle.loads(pickle.dumps(settings)) == settings


@pytest.mark.parametrize(
    ("formulation", "options", "message"),
    [
        ("elastica", {"segments": 3}, "segments: unknown option of elastica"),
        ("geometrically_exact", {"nodes": 3}, "nodes: unknown option of geometrically_exact (it belongs to elastica)"),
        ("floating_frame", {"order": 2}, "order: unknown option of floating_frame"),
        ("floating_frame", {"segment": 3}, "did you mean segments?"),
        ("floating_frame", {"modes": 2, "elements": 3}, "elements = 3: must not be given together with modes"),
        ("floating_frame", {"modes": 2, "coupling": "paper"}, "coupling = 'paper': must not be given together"),
        ("floating_frame", {"coupling": "cubic"}, 'must be one of "von_karman", "paper", "linear"'),
        ("floating_frame", {"segments": 0}, "segments = 0: must be a whole number, from 1 to 1000"),
        ("floating_frame", {"elements": 2.0}, "elements = 2.0: must be a whole number"),
        ("floating_frame", {"elements": True}, "elements = True: must be a whole number"),
        ("geometrically_exact", {"order": 4}, "order = 4: must be a whole number, from 1 to 3"),
        ("geometrically_exact", {"order": 7}, "order = 7: must be a whole number, from 1 to 3"),
        ("geometrically_exact", {"elements": 0}, "elements = 0: must be a whole number, from 1 to 1000"),
        ("elastica", {"nodes": 2}, "nodes = 2: must be a whole number, from 3 to 48"),
        ("elastica", {"rho_inf": 1.5}, "rho_inf = 1.5: must be a finite number, at least 0 and at most 1"),
        ("elastica", {"rho_inf": 0.5, "newmark": (0.25, 0.5)}, "rho_inf = 0.5: must not be given together"),
        ("elastica", {"newmark": 0.25}, "newmark = 0.25: must be a sequence of two numbers"),
        ("elastica", {"dt": 0.0}, "dt = 0.0: must be a positive number (s)"),
        ("elastica", {"dt": "0.1"}, "dt = '0.1': must be a positive number (s)"),
        ("elastica", {"tolerance": -1e-9}, "tolerance = -1e-09: must be"),
        ("elastica", {"newton": "quasi"}, "newton = 'quasi': must be one of"),
        ("elastica", {"max_iterations": 0}, "max_iterations = 0: must be"),
        ("exact", {}, "formulation = 'exact': must be one of"),
    ],
)
def test_a_wrong_option_is_refused(formulation: str, options: dict[str, object], message: str) -> None:
    says(message, lambda: Settings.make(formulation, **options))


def test_an_option_given_as_none_takes_its_default() -> None:
    assert Settings.make(segments=None, modes=None, dt=None) == Settings.make()
