"""A strip that falls on a floor, bounces and slides is the same in all formulations, in the plane and in space."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from flexarm_env import Arm, Contact, Link, Payload, Scene, Section, simulate
from flexarm_env.shapes import HalfSpace

REFERENCE: dict[str, Any] = {"nodes": 11}
"""Mesh of the elastica in the plane with which all are compared."""

MESHES: tuple[tuple[bool, str, dict[str, int], dict[str, int]], ...] = (
    (False, "elastica", {"nodes": 7}, {"nodes": 5}),
    (False, "geometrically_exact", {"elements": 8}, {"elements": 4}),
    (False, "floating_frame", {"segments": 8, "elements": 1}, {"segments": 4, "elements": 1}),
    (False, "floating_frame", {"segments": 4, "modes": 3}, {"segments": 2, "modes": 3}),
    (True, "geometrically_exact", {"elements": 8}, {"elements": 4}),
    (True, "elastica", {"nodes": 7}, {"nodes": 5}),
    (True, "floating_frame", {"segments": 8}, {"segments": 4}),
    (True, "floating_frame", {"segments": 4, "modes": 3}, {"segments": 2, "modes": 3}),
)
"""Whether the strip is computed in space, formulation, mesh, and the mesh with about half as many cells."""

ORDER = 2
"""Least order of convergence with the length of cells: the finer mesh has at most a quarter of the coarse error."""

ROUND_OFF = 2e-6
"""Largest error (m) of converged meshes: tolerance of Newton's iteration, and the strip's stretch and shear."""


def falling_strip(space: bool) -> Scene:
    """A strip of 1 m with a payload, hinged, that falls on a floor 0.2 m below, with friction."""
    section = Section(EI=2.0, EA=2e6, C=2e6, m=0.2, J=1e-6, EI_y=2.0, C_y=2e6, J_y=1e-6, GJ=1.0)
    arm = Arm("strip", (Link(1.0, section),), payload=Payload(mass=0.1), tau_d=2e-3)
    more = (0.0,) if space else ()
    floor = Contact(HalfSpace((0.0, -0.2, *more), (0.0, 1.0, *more)), 1e4, damping=0.3, friction=0.3)
    return Scene(
        "falls", arm, duration=0.5, dt=5e-4, sample=0.01, gravity=(0.0, -9.81, *more), contacts=(floor,), space=space
    )


def tips(space: bool, formulation: str, mesh: dict[str, Any]) -> np.ndarray:
    """Tip positions (n, 2), m, in the plane in which the strip falls."""
    run = simulate(falling_strip(space), formulation, estimate_error=False, **mesh)
    assert run.finished, run.message
    if space:
        assert abs(run.tip[:, 2]).max() < 1e-9
    return np.asarray(run.tip[:, :2])


def apart(space: bool, formulation: str, mesh: dict[str, Any], exact: np.ndarray) -> float:
    """Largest distance (m) of the tip from that of the reference."""
    return float(np.linalg.norm(tips(space, formulation, mesh) - exact, axis=1).max())


@pytest.mark.slow
@pytest.mark.parametrize(("space", "formulation", "mesh", "coarse"), MESHES)
def test_a_falling_strip_is_the_same_in_all_formulations(
    space: bool, formulation: str, mesh: dict[str, int], coarse: dict[str, int]
) -> None:
    exact = tips(False, "elastica", REFERENCE)
    # it bounces and slides
    assert exact[:, 1].min() < -0.2 and (np.diff(np.sign(np.diff(exact[:, 1]))) != 0).sum() > 2
    allowed = apart(space, formulation, coarse, exact) / 2**ORDER
    assert apart(space, formulation, mesh, exact) < allowed + ROUND_OFF
