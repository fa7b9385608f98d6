"""Strain gauges: the curvature of a link at a place, in the plane a linear function of the state in every formulation.

Floating-frame bodies resolve it as the mean curvature between two drawing stations; the others give it at the point.
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
from .exact.tables import functions
from .floating import build as floating_chain
from .model import System
from .space.gauges import gauges, strained_rows
from .space.layout import GAUGE

Array = NDArray[np.float64]
Spot = tuple[int, float] | tuple[int, float, str]
"""Link, place from 0 (root) to 1 (tip), and of `sensors.MEASURES`, in the plane always the first."""


def curvatures(
    scene: Scene, settings: Settings, names: Sequence[str], places: Sequence[Spot], q: Array
) -> Array:
    """(n, G) 1/m at each `Spot`, over what it is without stress, for states q (n, rows)."""
    if scene.spatial and settings.formulation == "elastica":
        like: Any = SimpleNamespace(q0=q[0], names=names)
        return np.asarray(q @ strained_rows(scene, settings, like, places).T)
    if scene.spatial:
        out = np.empty((len(q), len(places)))
        read_gauges(assemble(scene, settings).model, np.ascontiguousarray(q), gauges(scene, settings, places), out)
        return out
    like = SimpleNamespace(q0=q[0], names=names)
    rows = curvature_rows(scene, settings, like, places)
    if any(link.curved for link in scene.arm.links):
        q = q - assemble(scene, settings).q0
    return np.asarray(q @ rows.T)


def over(rows: Array, sizes: Array, space: bool) -> Array:
    """Rows of `curvature_rows` for readings over these sizes, (G,)."""
    if not space:
        return np.asarray(rows / sizes[:, None])
    found = rows.copy()
    found[:, GAUGE.places.near :] /= sizes[:, None]
    return found


def curvature_rows(scene: Scene, settings: Settings, system: System, places: Sequence[Spot]) -> Array:
    """(G, n): what `protocol.gauge` takes for each `Spot`: in the plane curvature (1/m) = row . q; in space the first
    numbers of a row are a `GAUGE`."""
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
    assert settings.nodes is not None
    n, row = settings.nodes, np.zeros(len(system.q0))
    line = chain(scene.arm, n).lines[link]
    row[link * n : (link + 1) * n] = line.slope(np.array([s]))[0]
    if link > 0:  # the first node's angle is that of the tip before it, and the joint's on top
        row[link * n - 1] += row[link * n]
    return row


def _exact(scene: Scene, settings: Settings, system: System, link: int, s: float) -> Array:
    """Vertices' angles and interior amplitudes, whose slopes are Legendre polynomials (`physics.exact.tables`)."""
    assert settings.elements is not None and settings.order is not None
    elements, order, names = settings.elements, settings.order, list(system.names)
    own = scene.arm.links[link]
    length = own.length / elements
    e = min(int(s / length), elements - 1)
    xi = 2.0 * (s / length - e) - 1.0
    if own.uniform is None:
        ends = own.mesh(elements, "elements")
        e = int(np.clip(np.searchsorted(ends, s, side="right") - 1, 0, elements - 1))
        length = float(ends[e + 1] - ends[e])
        xi = 2.0 * (s - float(ends[e])) / length - 1.0
    row = np.zeros(len(names))
    row[names.index(f"link{link}.psi{e + 1}")] = 1.0 / length
    if e > 0:
        row[names.index(f"link{link}.psi{e}")] = -1.0 / length
    elif link == 0:
        row[names.index("joint0")] = -1.0 / length
    else:
        row[names.index(f"link{link - 1}.psi{elements}")] = -1.0 / length
        row[names.index(f"joint{link}")] = -1.0 / length
    slopes = functions(order, np.array([xi]))[1][:, 0]
    for j in range(1, order):
        row[names.index(f"link{link}.psi{e}.{j}")] = slopes[j] / length
    return row


def _floating(scene: Scene, settings: Settings, system: System, link: int, s: float) -> Array:
    bodies, links = floating_chain._bodies(scene.arm, settings)
    names, row = list(system.names), np.zeros(len(system.q0))
    own = [b for b, k in enumerate(links) if k == link]
    start = 0.0
    for b in own:
        body = bodies[b]
        if s <= start + body.length * (1.0 + 1e-12) or b == own[-1]:
            x = np.concatenate([[0.0], body.stations]) if body.stations[0] > 0.0 else body.stations
            angles = body.shapes[:, 2] if body.stations[0] <= 0.0 else np.vstack([body.root, body.shapes[:, 2]])
            i = int(np.clip(np.searchsorted(x, s - start) - 1, 0, len(x) - 2))
            slope = (angles[i + 1] - angles[i]) / (x[i + 1] - x[i])
            for k in range(body.n):
                name = f"body{b}.q{k}" if settings.multipliers else f"link{link}.body{b - own[0]}.q{k}"
                row[names.index(name)] = slope[k]
            break
        start += body.length
    return row
