"""Links in space as ribbons: smooth lines with the direction of their width, computed from coordinates."""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .. import validation as check
from ..parameters import Arm
from ..physics.space.reading import Frame, links
from ..rotations import matrices, turned, vectors
from ..scene import in_plane
from ..sections import Link
from ..settings import Settings
from ..validation import Array


class Ribbons(NamedTuple):
    """Lines of N links at n instants with P points in total; link k has the points cuts[k] ... cuts[k + 1] - 1.

    points (n, P, 3): points along the links, m. across (n, P, 3): unit vectors along the width, the z axes of sections.
    """

    points: Array
    across: Array
    cuts: tuple[int, ...]

    def chain(self, i: int) -> list[tuple[Array, Array]]:
        """Return the points (P_k, 3), m, and the width directions of each link at instant i."""
        return [(self.points[i, a:b], self.across[i, a:b]) for a, b in pairwise(self.cuts)]


def ribbons(arm: Arm, settings: Settings, q: Array, pieces: int = 6) -> Ribbons:
    """Return the links' `Ribbons` at n instants, from the arm's coordinates q (n, rows).

    Between two sections the line is a cubic that is tangent to the x axes of both sections, and the width direction
    rotates about a fixed axis. pieces: number of straight pieces of the line between two sections.
    """
    lines, cuts = [], [0]
    for link, motion in zip(arm.links, links(arm, settings, q, np.zeros_like(q)), strict=True):
        bent = [] if link.rigid else motion.sections
        root = [_at(motion.root)] if link.rigid or link.root_offset > 0.0 else []
        tip = [_at(motion.tip)] if link.rigid or link.tip_offset > 0.0 else []
        parts = [_between(a, b, pieces) for a, b in pairwise(bent)]
        lines += [*root, *(_at(first) for first in bent[:1]), *parts, *tip]
        cuts.append(sum(points.shape[1] for points, _ in lines))
    points, across = (np.concatenate(parts, axis=1) for parts in zip(*lines, strict=True))
    return Ribbons(points, across, tuple(cuts))


def ribbons_of(run: Any, pieces: int = 6) -> Ribbons:
    """Return the `Ribbons` of a run in space; a motion in a plane is converted from its planar scene."""
    flat = in_plane(run.scene)
    if flat is None:
        return ribbons(run.scene.arm, run.settings, run.q, pieces)
    kept, cuts = thinned(cuts_of(run.shapes, run.hinges), 4 * pieces + 1)
    lines, starts = [], [0]
    for (a, b), frame in zip(pairwise(cuts), flat.frames, strict=True):
        points = run.shapes[:, kept[a : b + 1]]
        along = np.gradient(points, axis=1)
        along /= np.linalg.norm(along, axis=-1, keepdims=True)
        normal = flat.axes[:, 2]
        lines.append((points, frame[1, 2] * np.cross(normal, along) + frame[2, 2] * normal))
        starts.append(starts[-1] + b + 1 - a)
    found, across = (np.concatenate(parts, axis=1) for parts in zip(*lines, strict=True))
    return Ribbons(found, across, tuple(starts))


def sides(arm: Arm) -> Array:
    """Return width and thickness (N, 2), m, of the links, from their stiffness at mid-length; 0 for rigid links."""
    return np.array([_sides(link) for link in arm.links])


def _sides(link: Link) -> tuple[float, float]:
    """Return width and thickness, m, of the rectangle with a link's EI, EI_y and EA at mid-length; 0 if rigid."""
    if link.rigid:
        return 0.0, 0.0
    middle = np.array([0.5 * link.length])
    at, wide = link.along(middle), float(link.across(middle)["EI_y"][0])
    return math.sqrt(12.0 * wide / float(at.EA[0])), math.sqrt(12.0 * float(at.EI[0]) / float(at.EA[0]))


def _at(section: Frame) -> tuple[Array, Array]:
    return section.r[:, None], section.A[:, None, :, 2]


def _between(a: Frame, b: Frame, pieces: int) -> tuple[Array, Array]:
    """Return positions and width directions of the line from section a (excluded) to section b, (n, pieces, 3) each."""
    s = (np.arange(1, pieces + 1) / pieces)[:, None]
    chord = np.linalg.norm(b.r - a.r, axis=1)[:, None, None]
    leaving, reaching = chord * a.A[:, None, :, 0], chord * b.A[:, None, :, 0]
    h = (2 * s - 3) * s * s + 1, ((s - 2) * s + 1) * s, (3 - 2 * s) * s * s, (s - 1) * s * s
    r = h[0] * a.r[:, None] + h[1] * leaving + h[2] * b.r[:, None] + h[3] * reaching
    psi = vectors(np.swapaxes(a.A, 1, 2) @ b.A)[:, None, :] * s
    return r, turned(a.A[:, None], matrices(psi)[..., 2])


def cuts_of(points: Array, hinges: Array) -> tuple[int, ...]:
    """Return the indices of root, hinges and tip among the points (n, P, 2) of a planar arm, m.

    hinges (n, N - 1, 2): positions of the hinges, m.
    """
    gaps = np.abs(points[:, None] - hinges[:, :, None]).sum(axis=-1)  # (n, N - 1, P)
    inner = gaps.max(axis=0).argmin(axis=-1) if len(points) else ()
    cuts = (0, *(int(k) for k in inner), points.shape[1] - 1)
    if any(b < a for a, b in pairwise(cuts)):
        raise check.InvalidValue("hinges", cuts[1:-1], "must be points of the chain, from root to tip")
    return cuts


def thinned(cuts: Sequence[int], most: int) -> tuple[NDArray[np.intp], tuple[int, ...]]:
    """Return the indices of the points to keep, at most `most` per link, and the `cuts` of the kept points."""
    kept = [np.unique(np.linspace(a, b, min(most, b - a + 1)).round().astype(int)) for a, b in pairwise(cuts)]
    places = np.unique(np.concatenate(kept))
    return places, tuple(int(np.searchsorted(places, c)) for c in cuts)
