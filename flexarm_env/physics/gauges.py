"""Strain gauges: curvature of a link at a point. In the plane the reading is a linear function of the coordinates.

For bodies with floating frames the reading is the mean curvature between two drawing stations. For the other
formulations the reading is the curvature at the point.
"""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..scene import Scene
from ..settings import Settings
from .assembly import assemble
from .elastica.chain import chain
from .equations import read_gauges
from .exact.layout import AXES, CHAIN, T
from .exact.tables import functions
from .floating.build import bodies_of
from .model import System
from .space.gauges import gauges, strained_rows
from .space.layout import GAUGE

Array = NDArray[np.float64]
Spot = tuple[int, float] | tuple[int, float, str]
"""Place of a strain gauge: link index, position from 0 (link's root) to 1 (link's tip), and the measured quantity. In
space the quantity is one of `sensors.MEASURES`; in the plane it is "xy"."""


def curvatures(scene: Scene, settings: Settings, names: Sequence[str], places: Sequence[Spot], q: Array) -> Array:
    """Return curvatures (n, G), 1/m, relative to the stress-free link, at G spots for n configurations q (n, rows)."""
    # `curvature_rows` reads only q0 and names, so that a stand-in spares the assembly of a System
    like: Any = SimpleNamespace(q0=q[0], names=names)
    rows = curvature_rows(scene, settings, like, places)
    if scene.spatial and settings.formulation != "elastica":
        out = np.empty((len(q), len(places)))
        read_gauges(assemble(scene, settings).model, np.ascontiguousarray(q), rows, out)
        return out
    if not scene.spatial and any(link.curved for link in scene.arm.links):
        # curved links: less the curvature kappa_0 of q0, which has no stress
        q = q - assemble(scene, settings).q0
    return np.asarray(q @ rows.T)


def over(rows: Array, sizes: Array, space: bool) -> Array:
    """Return gauge rows (from `curvature_rows`) divided by `sizes` (G,), 1/m; readings are then relative to them.

    space: whether the rows are `GAUGE` records. In such records only the entries from `near` on are divided.
    """
    if not space:
        return np.asarray(rows / sizes[:, None])
    found = rows.copy()
    found[:, GAUGE.places.near :] /= sizes[:, None]
    return found


def curvature_rows(scene: Scene, settings: Settings, system: System, places: Sequence[Spot]) -> Array:
    """Return (G, n), one row for each gauge, for `protocol.strain_gauge`. In the plane the curvature (1/m) is row . q.

    In space a row begins with a `GAUGE` record, except for the elastica, whose reading is row . q.
    """
    if scene.spatial and settings.formulation == "elastica":
        return strained_rows(scene, settings, system, places)
    if scene.spatial:
        table, own = np.zeros((len(places), len(system.q0))), gauges(scene, settings, places)
        table[:, : own.shape[1]] = own
        return table
    rows = {
        "elastica": _elastica,
        "geometrically_exact": _exact,
        "floating_frame": _floating,
    }[settings.formulation]
    found = [rows(scene, settings, system, spot[0], spot[1] * scene.arm.links[spot[0]].length) for spot in places]
    return np.array(found).reshape(len(places), len(system.q0))


def _elastica(scene: Scene, settings: Settings, system: System, link: int, s: float) -> Array:
    """Return the row of d phi / ds (1/m) at arc length s (m) of a link of the elastica, from slopes of node angles."""
    assert settings.nodes is not None
    n, row = settings.nodes, np.zeros(len(system.q0))
    line = chain(scene.arm, n).lines[link]
    row[link * n : (link + 1) * n] = line.slope(np.array([s]))[0]
    # row 0 is the joint angle beta, relative to the last tangent before: phi_0 = phi_(n-1) + beta, so that both rows
    # add
    if link > 0:
        row[link * n - 1] += row[link * n]
    return row


def _exact(scene: Scene, settings: Settings, system: System, link: int, s: float) -> Array:
    """Return the row of d psi / ds (1/m) at arc length s (m) of a link of exact beams.

    The coordinates are the angles of the element's vertices and the amplitudes of its interior functions
    (`physics.exact.tables`).
    """
    assert settings.elements is not None and settings.order is not None
    elements, order, own = settings.elements, settings.order, scene.arm.links[link]
    length = own.length / elements
    # element e and xi in [-1, 1]: even elements of a uniform link, else those of its mesh
    e = min(int(s / length), elements - 1)
    xi = 2.0 * (s / length - e) - 1.0
    if own.uniform is None:
        ends = own.mesh(elements, "elements")
        e = int(np.clip(np.searchsorted(ends, s, side="right") - 1, 0, elements - 1))
        length = float(ends[e + 1] - ends[e])
        xi = 2.0 * (s - float(ends[e])) / length - 1.0
    row, at = np.zeros(len(system.q0)), CHAIN.offsets(0, scene.arm.n_links, elements, order)
    # psi' of the linear functions: (psi_right - psi_left) / l
    left = at.elements + AXES * order * (elements * link + e) + T
    right = left + AXES * order
    row[[left, right]] = -1.0 / length, 1.0 / length
    # the link's first angle is the vertex's psi plus the hinge angle
    if e == 0 and link > 0:
        row[at.hinges + link - 1] = -1.0 / length
    # psi' of the interior functions, g_j'(xi) 2 / l
    row[left + AXES : right : AXES] = functions(order, np.array([xi]))[1][1:, 0] / length
    return row


def _floating(scene: Scene, settings: Settings, system: System, link: int, s: float) -> Array:
    """Return the row of the mean curvature (1/m) between the drawing stations before and after s (m); floating frames.

    The bodies' shape functions give the section's angle. The last body is used for every s beyond its start.
    """
    segments, row, start = settings.segments or 1, np.zeros(len(system.q0)), 0.0
    own = bodies_of(scene.arm, settings)[link * segments : (link + 1) * segments]
    for b, body in enumerate(own):
        if s <= start + body.length * (1.0 + 1e-12) or body is own[-1]:
            # phi at the stations, whose slope between them is kappa; the root is added where it is no station
            x = np.concatenate([[0.0], body.stations]) if body.stations[0] > 0.0 else body.stations
            angles = body.shapes[:, 2] if body.stations[0] <= 0.0 else np.vstack([body.root, body.shapes[:, 2]])
            i = int(np.clip(np.searchsorted(x, s - start) - 1, 0, len(x) - 2))
            slope = (angles[i + 1] - angles[i]) / (x[i + 1] - x[i])
            name = f"body{link * segments + b}.q0" if settings.multipliers else f"link{link}.body{b}.q0"
            first = system.names.index(name)
            row[first : first + body.n] = slope
            break
        start += body.length
    return row
