"""Meshes of arms whose sections jump or kink: the default mesh, and a mesh with cells of half the size."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Collection
from operator import itemgetter
from typing import Any

import numpy as np

from flexarm_env import curves, meshing
from flexarm_env.bodies import PLANE, Axes
from flexarm_env.parameters import Arm
from flexarm_env.sections import Link, Section
from flexarm_env.settings import MOST_ELEMENTS, MOST_NODES, Settings, default_options

_CELLS = {"elastica": ("nodes", 1), "geometrically_exact": ("elements", 0), "floating_frame": ("segments", 0)}
"""For each formulation: option that sets a link's mesh, and the option's value minus the number of cells."""


MOST_SMOOTH = 12
"""Largest number of nodes per elastica link if its section neither jumps nor kinks (`physics.elastica.chain`)."""


def divided(arm: Arm) -> bool:
    """Return whether the section of a link jumps or kinks, or its curvature jumps."""
    return any(len(link.breaks) > 2 for link in arm.links if not link.rigid)


def default_mesh(arm: Arm, formulation: str, given: Collection[str] = (), axes: Axes = PLANE) -> dict[str, int]:
    """Return options of a mesh as fine as a uniform arm's default mesh, for an arm whose sections jump or kink.

    The result is {} if no link has a jump or kink; the formulation's default then applies. All links have the same
    number of nodes or cells, the largest number that any link requires. The number of nodes is at most 24. A link with
    few intervals between jumps or kinks permits fewer nodes, and the lowest number that a link permits is used.

    Args:
        given: names of the options that the user sets; if the user sets mesh or modes, the result is {}. axes: axes of
            the scene; in space the elastica has one polynomial for each link, and the result is {}.
    """
    chosen = {"segments", "elements", "modes", "nodes"}.intersection(given)
    if not divided(arm) or chosen or not axes.divides_cells(formulation):
        return {}
    option, further = _CELLS[formulation]
    usual = int(default_options(formulation)[option]) - further
    links = [link for link in arm.links if not link.rigid]
    found = max(meshing.cells_like(link, usual) for link in links)
    if formulation == "elastica":
        found = min(found, MOST_NODES // 2 - 1, *((MOST_SMOOTH - 1) * (len(link.breaks) - 1) for link in links))
    return {option: found + further}


def halved_mesh(arm: Arm, settings: Settings) -> tuple[Arm, Settings] | None:
    """Return an arm and settings with each cell of the mesh divided into at least two cells, or None.

    The returned arm has the same mechanical properties as `arm`. The sections of the returned arm have an additional
    point in the middle of each cell; the finer mesh divides the cell at this point. The result is None if there would
    be too many cells, if links are reduced to modes, or if a tapered link needs more than 6 nodes.
    """
    # cells: nodes - 1 intervals of an elastica, or elements, or segments
    option, further = _CELLS[settings.formulation]
    cells = (getattr(settings, option) or 1) - further
    links = tuple(_halved(link, cells, further > 0) if isinstance(link, Link) else link for link in arm.links)
    most = MOST_ELEMENTS // (settings.elements or 1)
    if further:
        most = min(MOST_NODES - 1, *((MOST_SMOOTH - 1) * (len(k.breaks) - 1) for k in links if isinstance(k, Link)))
    if settings.modes is not None or 2 * cells > most:
        return None
    # increase the number until every cell is divided in two
    pairs = [(fine, link) for fine, link in zip(links, arm.links, strict=True) if fine is not link]
    # a mesh too coarse to end at kinks and its half may have the same error
    found = min(most, max(2 * cells, default_mesh(arm, settings.formulation).get(option, further) - further))
    while found < most and not all(meshing.divides(fine, found, link, cells) for fine, link in pairs):
        # weights that differ by round-off only may leave a cell undivided
        found += 1
    return dataclasses.replace(arm, links=links), settings.replace(**{option: found + further})


def _halved(link: Link, n: int, nodes: bool) -> Link:
    """Return the link with a jump between equal sections, or equal curvatures, in the middle of each of its n cells.

    nodes: True if the cells are intervals between nodes of an elastica; even in a uniform link each becomes two
    polynomials.
    """
    if len(link.breaks) == 2 and not nodes:
        # equal cells: twice as many halve them
        return link
    places = meshing.middles(link, n) if len(link.jumps) < n else []
    if isinstance(link.curvature, tuple):
        bends = [(s, float(curves.along(link.curvature, s))) for s in places]
        return dataclasses.replace(link, curvature=_joined(link.curvature, bends))
    if isinstance(link.section, tuple):
        return dataclasses.replace(
            link, section=_joined(link.section, [(s, _section(link.section, s)) for s in places])
        )
    # equal points would be removed: let one section differ in the last bit of EI
    if isinstance(link.section, Section):
        s, other = 0.5 * link.length, dataclasses.replace(link.section, EI=math.nextafter(link.section.EI, math.inf))
        own = (0.0, link.section), (s, link.section), (s, other), (link.length, other)
        return dataclasses.replace(link, section=own)
    return link


def _joined(points: tuple[tuple[float, Any], ...], more: list[tuple[float, Any]]) -> tuple[tuple[float, Any], ...]:
    """Merge the points along a link with additional points; each additional point appears twice and so marks a jump."""
    known = [s for s, _ in points]
    return tuple(sorted((*points, *(at for at in more for _ in range(2 - known.count(at[0])))), key=itemgetter(0)))


def _section(points: tuple[tuple[float, Section], ...], s: float) -> Section:
    """Return the section at s, m from the root, interpolated linearly between the given points."""
    i, share = curves.between(np.array([place for place, _ in points]), np.array(s), False)
    one, other = points[int(i)][1], points[int(i) + 1][1]
    changes = {}
    for field in dataclasses.fields(one):
        a, b = getattr(one, field.name), getattr(other, field.name)
        if a is not None and b is not None:
            changes[field.name] = a + float(share) * (b - a)
    return dataclasses.replace(one, **changes)
