"""Links whose sections vary: known frequencies, masses, what a constant one is equal to, TOML and errors."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from flexarm_env import arms, rigid
from flexarm_env.accuracy import slowest_rate
from flexarm_env.linear import modes
from flexarm_env.parameters import Arm, Elbow, Link, Payload, Section, Taper
from flexarm_env.physics.assembly import assemble
from flexarm_env.physics.floating.constants import finite_element_body
from flexarm_env.scene import Scene
from flexarm_env.settings import Settings
from flexarm_env.simulation import simulate
from tests.oracle_ritz import ritz_frequencies
from tests.refusals import refuses, says
from tests.scene_tools import Method, every, everything

THICK = Section(EI=2.0, EA=2e7, C=7e6, m=0.3)
THIN = Section(EI=0.5, EA=1e7, C=3e6, m=0.15)
METHODS: list[Method] = [
    ("geometrically_exact", {"elements": 16}),
    ("elastica", {"nodes": 12}),
    ("floating_frame", {"segments": 16}),
    ("floating_frame", {"modes": 3}),
]
FOUR = [*METHODS[:3], ("floating_frame", {"modes": 4})]


def scene(arm: Arm) -> Scene:
    return everything(Scene("s", arm, duration=1.0, dt=0.01))


@every(METHODS)
@pytest.mark.parametrize(
    ("thickness", "width", "known"),
    [(0.1, 1.0, 4.631), (0.02, 1.0, 5.124), (0.001, 1.0, 5.305), (1.0, 1e-5, 7.156)],
)
def test_wedge(
    formulation: str, options: dict[str, Any], thickness: float, width: float, known: float
) -> None:
    """c of the first clamped mode c sqrt(EI0 / m0 L^4) of a wedge, shares of the root's sides at its tip."""
    link = Link.tapered(2.0, (0.03, 0.03 * width), (0.01, 0.01 * thickness), E=7e10, rho=2700.0, G=2.6e12, kappa=1.0)
    root = link.along(0.0)
    first = modes(scene(Arm("a", (link,))), 1, formulation, clamped=True, **options).frequencies[0]
    assert first / np.sqrt(root.EI / (root.m * 2.0**4)) == pytest.approx(known, abs=6e-4)


STEPPED = Link(1.0, [(0.0, THICK), (0.53, THICK), (0.53, THIN), (1.0, THIN)])
"""The step is where an even mesh has no end."""


def stepped_frequencies() -> Any:
    """rad/s, of STEPPED as two even links, the second held by the first."""
    return ritz_frequencies(Arm("a", (Link(0.53, THICK), Link(0.47, THIN))), 3)


def test_what_beams_are_compared_with_knows_the_even_one() -> None:
    found = ritz_frequencies(Arm("a", (Link(2.0, THICK),)), 3) / np.sqrt(THICK.EI / (THICK.m * 2.0**4))
    assert np.sqrt(found) == pytest.approx([1.875104, 4.694091, 7.854757], rel=1e-6)


@every(FOUR, slow=("modes",))
def test_stepped_beam(formulation: str, options: dict[str, Any]) -> None:
    found = modes(scene(Arm("a", (STEPPED,))), 3, formulation, clamped=True, **options).frequencies
    assert np.all(np.abs(found / stepped_frequencies() - 1.0) < [1e-4, 2e-4, 1e-3])


@every(METHODS)
def test_a_constant_section_as_points_is_that_section(formulation: str, options: dict[str, Any]) -> None:
    plain, points = Link(0.7, THICK), Link(0.7, [(0, THICK), (0.3, THICK), (0.3, THICK), (0.7, THICK)])
    assert plain == points and points.uniform == THICK
    assert Link.tapered(1.0, (0.03, 0.03), (0.002, 0.002), E=7e10, rho=2700.0, G=2.6e10) == Link(
        1.0, Section.rectangle(0.03, 0.002, 7e10, 2700.0, 2.6e10)
    )
    one, other = (
        assemble(scene(Arm("a", (link, plain))), Settings.make(formulation, **options)).model
        for link in (plain, points)
    )
    numbers = "sections" if formulation == "geometrically_exact" else "data"
    assert np.array_equal(getattr(one, numbers), getattr(other, numbers))


@every(METHODS)
def test_nearly_constant_is_nearly_the_same(formulation: str, options: dict[str, Any]) -> None:
    """A link that varies by one part in 1e9 goes through the other path and has the same frequencies."""
    nearly = Section(*(getattr(THICK, name) * (1.0 + 1e-9) for name in ("EI", "EA", "C", "m")))
    elbow, payload = (Elbow(0.05, 1e-3, 1e-3),), Payload(0.1, 1e-3)
    found = [
        modes(
            scene(Arm("a", (link, Link(0.4, THICK)), elbows=elbow, payload=payload)), 3, formulation,
            clamped=True, **options,
        ).frequencies
        for link in (Link(0.6, THICK), Link(0.6, [(0.0, THICK), (0.6, nearly)]))
    ]  # fmt: skip
    np.testing.assert_allclose(found[0], found[1], rtol=1e-7)


VARIED = (
    Link(1.3, [(0.0, THICK), (0.4, THIN), (0.4, THICK), (1.3, THIN)]),
    Link.tapered(0.5, (0.03, 0.02), (0.004, 0.002), E=70e9, rho=2700.0, G=26e9),
)


def test_mass_properties() -> None:
    """Masses, moments and the rigid arm's inertia against sums over short pieces."""
    for link in VARIED:
        s = (np.arange(130_000) + 0.5) * link.length / 130_000
        at, ds = link.along(s), link.length / 130_000
        sums = [float(np.sum(at.m * s**k) * ds) for k in range(3)]
        np.testing.assert_allclose([link.mass, link.moment(1), link.moment(2)], sums, rtol=1e-9)
        assert link.rotary == pytest.approx(float(np.sum(at.J) * ds), rel=1e-9, abs=1e-18)
        assert sum(part.mass for part in link.cut(7, "elements")) == pytest.approx(link.mass, rel=1e-12)
    first, second = VARIED
    arm = Arm("a", VARIED, elbows=(Elbow(0.2, 1e-3, 2e-3),), payload=Payload(0.1, 1e-3))
    beyond = second.moment(2) + second.rotary + 0.1 * 0.5**2 + 1e-3 + 2e-3
    assert rigid.inertia_beyond(arm, 1) == pytest.approx(beyond, rel=1e-12)
    whole = first.moment(2) + first.rotary + 0.2 * 1.3**2 + 1e-3 + beyond
    whole += 1.3**2 * (second.mass + 0.1) + 2.0 * 1.3 * (second.moment(1) + 0.1 * 0.5)
    assert rigid.inertia_beyond(arm, 0) == pytest.approx(whole, rel=1e-12)


def test_meshes_end_at_jumps() -> None:
    link = Link(1.0, [(0.0, THICK), (0.3, THICK), (0.3, THIN), (1.0, THIN)])
    np.testing.assert_allclose(link.mesh(4, "elements"), [0.0, 0.3, 0.3 + 0.7 / 3, 0.3 + 1.4 / 3, 1.0])
    assert [part.uniform for part in link.cut(3, "elements")] == [THICK, THIN, THIN]
    for coarse in (Settings.make("geometrically_exact", elements=1), Settings.make(segments=1, elements=1)):
        words = r"^elements = 1: must be at least 2 for a link whose sections jump 1 times"
        with pytest.raises(ValueError, match=words):
            assemble(scene(Arm("a", (link,))), coarse)
    many = [(0.0, THICK)] + [(0.2 * k, s) for k in (1, 2, 3) for s in (THICK, THIN)] + [(1.0, THICK)]
    with pytest.raises(ValueError, match=r"^nodes = 4: must be at least 5"):
        assemble(scene(Arm("a", (Link(1.0, many),))), Settings.make("elastica", nodes=4, dt=0.01))


def test_constants_of_a_body_whose_elements_are_not_even() -> None:
    """Of v = x^2, phi = 2 x, which the elements hold exactly: c'q = int m x v."""
    link = Link(1.0, [(0.0, THICK), (0.3, THICK), (0.3, THIN), (1.0, THIN)])
    for elements in (2, 5):
        body = finite_element_body(link, elements, "linear")
        x = link.mesh(elements, "elements")[1:]
        q = np.stack([np.zeros_like(x), x**2, 2.0 * x], axis=1).ravel()
        assert body.c @ q == pytest.approx(0.3 * 0.3**4 / 4 + 0.15 * (1.0 - 0.3**4) / 4, rel=1e-4)
        np.testing.assert_allclose(body.shapes[:, 1] @ q, body.stations**2, atol=1e-4)
        assert body.stations[-1] == pytest.approx(1.0)


def test_slowest_rate() -> None:
    """Of a wedge and of a stepped beam, within 5 %."""
    wedge = Link.tapered(1.0, (0.03, 0.03), (0.01, 0.0002), E=7e10, rho=2700.0, G=2.6e10)
    root = wedge.along(0.0)
    assert slowest_rate(scene(Arm("a", (wedge,)))) == pytest.approx(5.124 * np.sqrt(root.EI / root.m), rel=0.05)
    assert slowest_rate(scene(Arm("a", (STEPPED,)))) == pytest.approx(stepped_frequencies()[0], rel=0.02)


def test_toml_reads_back_equal() -> None:
    arm = Arm("a", (*VARIED, Link(1.0, THIN)))
    assert arms.from_toml(arms.to_toml(arm)) == arm
    rectangles = """
name = "a"
[[links]]
length = 0.5
section = [
  { s = 0.0, width = 0.03, thickness = 0.004, E = 7e10, rho = 2700.0, G = 2.6e10 },
  { s = 0.5, EI = 1.0, EA = 1e6, C = 1e6, m = 0.1 },
]
"""
    assert arms.from_toml(rectangles).links[0].section[1] == (0.5, Section(1.0, 1e6, 1e6, 0.1))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Link(1.0, [(0.0, THICK)]), "must be a Section, a Taper or a sequence of two or more (s, Section)"),
        (lambda: Link(1.0, [(0.1, THICK), (1.0, THIN)]), "section[0].s = 0.1: must be 0, the link's root"),
        (lambda: Link(1.0, [(0.0, THICK), (0.9, THIN)]), "section[1].s = 0.9: must be the link's length, 1 m"),
        (lambda: Link(1.0, [(0.0, THICK), (0.6, THIN), (0.5, THICK), (1.0, THIN)]), "section[2].s = 0.5: must not be"),
        (lambda: Link(1.0, [(0.0, THICK), (0.0, THIN), (1.0, THIN)]), "section[1].s = 0.0: must not be below the one"),
        (lambda: Link(1.0, [(0.0, THICK), (1.0, "s")]), "section[1].section = 's': must be a Section"),
        (
            lambda: Taper((0.1, 0.0), (0.1, 0.1), 1.0, 1.0, 1.0),
            "section.widths[1] = 0.0: must be a positive number (m)",
        ),
        (
            lambda: Taper((1e-3, 1e9), (1e-3, 1e9), 70e9, 2700.0, 26e9),
            "section.EI = 5.833333333333333e+45: must be at least 1e-30 and at most 1e+30 in size (N m^2)",
        ),
        (
            lambda: arms.from_table({"name": "a", "links": [{"length": 1.0, "section": [{"s": 0.0, "EJ": 1.0}]}]}),
            "links[0].section[0].EJ: unknown key; allowed: EI, EA,",
        ),
        (
            lambda: arms.from_table({"name": "a", "links": [{"length": 1.0, "section": {"widths": [1.0, 2.0]}}]}),
            "links[0].section.thicknesses: missing",
        ),
    ],
)
def test_a_refusal_names_what_is_wrong(make: Any, message: str) -> None:
    says(message, make)


def test_damping_of_one_link_alone() -> None:
    """Links of the same tau_d, their own or the arm's, are one model."""
    kept, plain = ((Link(0.6, THICK, tau_d=tau_d), Link(0.4, THICK, tau_d=tau_d)) for tau_d in (4e-3, None))
    same = Arm("a", kept, payload=Payload(0.1), tau_d=1.0), Arm("a", plain, payload=Payload(0.1), tau_d=4e-3)
    for formulation, options in METHODS:
        one, other = (assemble(scene(arm), Settings.make(formulation, dt=0.01, **options)) for arm in same)
        assert np.array_equal(one.par, other.par)
        assert [x is None for x in one.model] == [x is None for x in other.model]
    unlike = Arm("a", (kept[0], plain[1]), hub_inertia=0.05, payload=Payload(0.1), tau_d=2e-4)
    assert unlike.damping == (4e-3, (1.0, 0.05))
    assert arms.from_toml(arms.to_toml(unlike)) == unlike
    with pytest.raises(ValueError, match=r"^period_correction = True: must be False where the links' tau_d differ"):
        assemble(scene(unlike), Settings.make("geometrically_exact", period_correction=True))


# ------------------------------------------------------------------ rigid ends
ENDED = Link(
    0.6, THICK, root_offset=0.12, tip_offset=0.08, root_mass=0.1, tip_mass=0.05, root_inertia=2e-4, tip_inertia=1e-4
)


@every(FOUR, slow=("geometrically_exact", "floating_frame"))
@pytest.mark.parametrize("clamped", [(0, 1), ()])
def test_frequencies_with_rigid_ends(formulation: str, options: dict[str, Any], clamped: Any) -> None:
    """Three of a two-link arm against its energies, joints held and free."""
    arm = Arm(
        "a", (ENDED, dataclasses.replace(ENDED, length=0.4, root_mass=0.0)), hub_inertia=0.01,
        elbows=(Elbow(0.1, 1e-4, 2e-4),), payload=Payload(0.1, 1e-4),
    )  # fmt: skip
    found = modes(scene(arm), 5 if clamped == () else 3, formulation, clamped=clamped, **options).frequencies
    found = found[found > 1.0][:3]
    np.testing.assert_allclose(found, ritz_frequencies(arm, 3, hinged=clamped == ()), rtol=5e-4)


@pytest.mark.slow
@every(METHODS)
def test_joints_poses_shapes_and_reach_agree(formulation: str, options: dict[str, Any]) -> None:
    arm = Arm("a", (ENDED, dataclasses.replace(ENDED, length=0.4)), payload=Payload(0.1), tau_d=1e-3, hub_inertia=0.1)
    assert ENDED.span == pytest.approx(0.8) and arm.total_length == pytest.approx(1.4)
    assert rigid.reach(arm) == pytest.approx((0.2, 1.4))
    assert arm.mass == pytest.approx(0.3 * 1.0 + 4 * 0.05 + 2 * 0.05 + 0.1)
    bent = everything(Scene("s", arm, duration=0.05, dt=1e-3, sample=0.05, angles=(0.3, 1.2), gravity=(0.0, -9.81)))
    run = simulate(bent, formulation, estimate_error=False, **options)
    elbow = 0.8 * np.array([np.cos(0.3), np.sin(0.3)])
    tip = elbow + 0.6 * np.array([np.cos(1.2), np.sin(1.2)])
    np.testing.assert_allclose(run.tip[0, :2], tip, atol=1e-12)
    np.testing.assert_allclose(run.shapes[0][0], 0.0, atol=1e-12)
    np.testing.assert_allclose(run.shapes[0][-1], tip, atol=1e-12)
    assert np.abs(run.shapes[0] - elbow).sum(1).min() < 1e-9
    fine = simulate(bent, "geometrically_exact", elements=8, estimate_error=False)
    np.testing.assert_allclose(run.tip[-1, :2], fine.tip[-1, :2], atol=1e-4)
    assert np.abs(run.balance).max() < 1e-5 * run.turned_over


def test_rigid_inertia_with_rigid_ends() -> None:
    """That of the straight arm against its parts."""
    arm = Arm("a", (ENDED,), hub_inertia=0.01, payload=Payload(0.1, 1e-4))
    whole = 0.01 + 0.1 * 0.06**2 + 2e-4 + 0.05 * 0.76**2 + 1e-4 + 0.1 * 0.8**2 + 1e-4
    whole += 0.3 * (0.72**3 - 0.12**3) / 3
    assert rigid.inertia_beyond(arm, 0) == pytest.approx(whole, rel=1e-12)
    assert arms.from_toml(arms.to_toml(arm)) == arm


def test_where_rigid_ends_are_refused() -> None:
    refuses(r"^tip_offset = -0.1: must be a number, zero or positive \(m\)", lambda: Link(1.0, THICK, tip_offset=-0.1))
    assert Link(0.6, THICK) == Link(0.6, THICK, root_offset=0.0, tip_offset=0, tip_mass=0.0)
    arm = Arm("a", (ENDED,))
    with pytest.raises(ValueError, match=r"^links\[0\]\.root_offset = 0.12: must be 0 with multipliers=True"):
        assemble(scene(arm), Settings.make(multipliers=True))
    with pytest.raises(ValueError, match=r"^period_correction = True: must be False where links have rigid ends"):
        assemble(scene(arm), Settings.make("geometrically_exact", period_correction=True))
