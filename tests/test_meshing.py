"""Meshes where sections jump or kink: where cells end, the default mesh, the companion mesh, and the error."""

from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from flexarm_env import meshing
from flexarm_env.accuracy import companion_mesh
from flexarm_env.bodies import SPACE
from flexarm_env.parameters import Arm, Link, Payload, Section, Taper
from flexarm_env.physics.elastica.chain import chain
from flexarm_env.scene import JointTorque, Scene, default_mesh, halved_mesh
from flexarm_env.settings import Settings
from flexarm_env.simulation import simulate
from flexarm_env.time_functions import sine
from flexarm_env.trajectory import Trajectory
from tests.scene_tools import tips_apart

THIN, THICK = Section(0.019, 8e5, 2.5e5, 0.031, 7.3e-10), Section(0.152, 1.6e6, 5.1e5, 0.0624, 5.9e-9)
STEPPED = Link(0.556, [(0.0, THIN), (0.146, THIN), (0.146, THICK), (0.556, THICK)])
THREE_JUMPS = Link(
    0.6, [(0.0, THICK), *((s, own) for s, pair in ((0.2, (THICK, THIN)), (0.3, (THIN, THICK)), (0.5, (THICK, THIN)))
                          for own in pair), (0.6, THIN)]
)  # fmt: skip
KINKED = Link(0.6, [(0.0, THICK), (0.1, THIN), (0.2, THICK), (0.6, THIN)])
TAPERED = Link(0.6, Taper((0.03, 0.02), (0.004, 0.002), 70e9, 2700.0, 26e9))
PLAIN = Link(0.4, THICK)


@pytest.mark.parametrize("link", [PLAIN, TAPERED, Link(0.6, [(0.0, THICK), (0.6, THIN)])])
def test_cells_of_one_smooth_piece_are_even(link: Link) -> None:
    for n in (1, 5, 7):
        assert np.array_equal(link.mesh(n, "elements"), np.linspace(0.0, link.length, n + 1))
        assert meshing.cells_like(link, n) == n
    assert default_mesh(Arm("a", (link,)), "elastica") == {}


@pytest.mark.parametrize("link", [STEPPED, THREE_JUMPS, KINKED])
def test_cells_end_at_jumps_and_kinks(link: Link) -> None:
    ends = link.mesh(len(link.breaks) + 3, "elements")
    assert set(link.breaks) <= set(ends.tolist())
    assert (np.diff(ends) > 0.0).all()


def test_the_softer_piece_gets_the_more_cells() -> None:
    """Nine cells in proportion to EI^(-1/2) times length. Within a piece whose EI falls by 8 cells become shorter."""
    assert (STEPPED.mesh(9, "elements") <= 0.146).sum() == 6  # five cells in 0.146 m, four in 0.41 m
    widths = np.diff([s for s in KINKED.mesh(12, "elements") if s >= 0.2])
    assert (np.diff(widths) < 0.0).all()


def test_too_few_cells_for_kinks_end_at_jumps_alone() -> None:
    link = Link(1.0, [(0.0, THICK), (0.3, THIN), (0.6, THIN), (0.6, THICK), (1.0, THICK)])
    assert link.mesh(2, "elements").tolist() == [0.0, 0.6, 1.0]
    assert link.mesh(3, "elements").tolist() == [0.0, 0.3, 0.6, 1.0]


@pytest.mark.parametrize(("link", "cells"), [(STEPPED, 6), (THREE_JUMPS, 8), (KINKED, 12)])
def test_default_mesh_follows_the_section(link: Link, cells: int) -> None:
    """Five cells a uniform link, and more where sections jump or kink; one number for all links, 11 of a smooth one."""
    arm = Arm("a", (PLAIN, link))
    assert default_mesh(arm, "geometrically_exact") == {"elements": cells}
    assert default_mesh(arm, "floating_frame") == {"segments": cells}
    assert default_mesh(arm, "elastica") == {"nodes": min(cells, 11) + 1}
    assert default_mesh(Arm("a", (link,)), "elastica") == {"nodes": cells + 1}
    assert default_mesh(arm, "elastica", axes=SPACE) == {}
    for given in ("nodes", "elements", "segments", "modes"):
        assert default_mesh(arm, "floating_frame", [given]) == {}
    scene = Scene("s", arm, duration=0.1, dt=0.01)
    assert scene.settings("elastica").nodes == min(cells, 11) + 1
    assert scene.settings("elastica", nodes=9).nodes == 9
    assert scene.settings("floating_frame", coupling="paper").segments == cells
    assert scene.settings("floating_frame", modes=2).segments is None


@pytest.mark.parametrize("link", [STEPPED, THREE_JUMPS, KINKED])
@pytest.mark.parametrize("n", [4, 5, 8, 11])
def test_the_companion_halves_every_cell(link: Link, n: int) -> None:
    """Also where a piece has one cell that twice as many by weight would leave as it is."""
    for formulation, option in (("geometrically_exact", "elements"), ("floating_frame", "segments")):
        found = halved_mesh(Arm("a", (link, PLAIN)), Settings.make(formulation, **{option: n}))
        assert found is not None
        arm, settings = found
        m = getattr(settings, option)
        assert 2 * n <= m <= 2 * n + 4
        fine, coarse = arm.links[0].mesh(m, option), link.mesh(n, option)
        assert all(((fine > a) & (fine < b)).any() for a, b in pairwise(coarse))
        assert arm.links[0].mass == pytest.approx(link.mass, rel=1e-12)
    found = halved_mesh(Arm("a", (link,)), Settings.make("elastica", nodes=n + 1))
    assert found is not None
    arm, settings = found
    before = [len(own.own) for *_, own in chain(Arm("a", (link,)), n + 1).lines[0].pieces]
    after = [len(own.own) for *_, own in chain(arm, settings.nodes).lines[0].pieces]
    assert len(after) == 2 * len(before)
    assert all(own >= least for own, least in zip(after, np.repeat(before, 2), strict=True))


def test_there_is_a_companion_for_every_mesh() -> None:
    """Of modes the full model in segments enough for the jumps; of a mesh too fine to be halved a coarser one."""
    scene = Scene("s", Arm("a", (THREE_JUMPS,)), duration=0.1, dt=0.01)
    assert companion_mesh(scene, Settings.make("floating_frame", modes=2))[1].segments == 8
    assert companion_mesh(scene, Settings.make("geometrically_exact", elements=600))[1].elements == 300
    kinked = Scene("s", Arm("a", (KINKED,)), duration=0.1, dt=0.01)  # at least the default mesh, which ends at kinks
    assert companion_mesh(kinked, Settings.make("elastica", nodes=3))[1].nodes >= 13
    tapered = Scene("s", Arm("a", (THREE_JUMPS, TAPERED)), duration=0.1, dt=0.01)
    assert companion_mesh(tapered, Settings.make("elastica", nodes=6))[1].nodes in (11, 12)
    assert companion_mesh(tapered, Settings.make("elastica", nodes=9))[1].nodes == 7


def test_a_smooth_piece_has_at_most_twelve_nodes() -> None:
    assert simulate(swung(THREE_JUMPS, 0.01, 0.02), "elastica", nodes=40, estimate_error=False).finished
    for link, most in ((PLAIN, 12), (STEPPED, 23)):
        with pytest.raises(ValueError, match=rf"^nodes = 24: must be at most {most} for a link of"):
            simulate(swung(link, 0.01, 0.02), "elastica", nodes=24)


def test_segments_that_end_at_jumps_by_round_off() -> None:
    """Three even segments of 0.6 m with jumps at 0.2, 0.3 and 0.5 m: the first ends at a jump, off by 3e-17 m."""
    scene = swung(THREE_JUMPS, 0.02, 0.1)
    run = simulate(scene, "floating_frame", modes=3, segments=3)
    assert run.status == "ok" and run.error_estimate < 1e-3
    message = "^segments = 2: must be at least 4 for a link whose sections jump 3 times, or elements 2"
    with pytest.raises(ValueError, match=message):
        simulate(scene, "floating_frame", segments=2)


def swung(link: Link, torque: float, duration: float) -> Scene:
    """A link with a payload under a torque that swings with 14 rad/s."""
    arm = Arm("a", (link,), hub_inertia=1e-3, payload=Payload(0.05, 1e-5))
    drive = JointTorque(0, sine(torque, 14.0))
    return Scene("swung", arm, duration=duration, dt=0.002, sample=duration / 30, loads=(drive,))


@lru_cache
def reference(link: Link, torque: float, formulation: str) -> Trajectory:
    """Of another formulation, its cells ending at jumps; 36 cells agree with 48 to 2e-4 of the length."""
    other = {"segments": 36} if formulation == "geometrically_exact" else {"elements": 36}
    name = "floating_frame" if formulation == "geometrically_exact" else "geometrically_exact"
    return simulate(swung(link, torque, 0.6), name, dt=5e-4, estimate_error=False, **other)


CASES: list[tuple[Link, str, dict[str, Any]]] = [
    (STEPPED, "elastica", {"nodes": 9}),
    (STEPPED, "geometrically_exact", {"elements": 3}),
    (STEPPED, "floating_frame", {"segments": 3}),
    (THREE_JUMPS, "elastica", {"nodes": 9}),
    (THREE_JUMPS, "geometrically_exact", {"elements": 8}),
    (THREE_JUMPS, "floating_frame", {"segments": 8}),
    (KINKED, "elastica", {"nodes": 9}),
    (KINKED, "elastica", {"nodes": 12}),
    (KINKED, "geometrically_exact", {"elements": 3}),
    (KINKED, "floating_frame", {"segments": 3}),
    *((link, name, {}) for link in (STEPPED, THREE_JUMPS, KINKED)
      for name in ("elastica", "geometrically_exact", "floating_frame")),
]  # fmt: skip


@pytest.mark.parametrize(
    ("link", "formulation", "options"),
    [pytest.param(*case, marks=() if case[0] is STEPPED and case[1] == "elastica" else pytest.mark.slow)
     for case in CASES],
)  # fmt: skip
def test_the_estimate_covers_jumps_and_kinks(link: Link, formulation: str, options: dict[str, Any]) -> None:
    """Links that fold by 0.9 of their length: errors up to 0.1 L, with an estimate of at least two thirds of that."""
    run = simulate(swung(link, 0.3, 0.6), formulation, **options)
    error = tips_apart(run, reference(link, 0.3, formulation))
    assert run.status == ("ok" if run.error_estimate <= 0.05 else "inaccurate")
    assert error < 1.5 * run.error_estimate
    if not options:  # the default mesh
        assert error < 0.03 and run.status == "ok"
