"""Layouts of an elastica: point loads, eccentric payload, nonlinear bending, coordinates; for `DATA` see `chain`.

e_j = (cos phi_j, sin phi_j): unit tangent at node j, inertial axes; n_j = (-sin phi_j, cos phi_j). Nodes are numbered
over all links from root to tip.
"""

from typing import NamedTuple

from ...compiler import Lanes, kernel, size
from ...layout import Field, Layout
from ..materials import BENDING

POINT = Layout("Point", "", Field("x", (), "m", "inertial axes"), Field("y", (), "m", "inertial axes"))
"""Last two rows, after the angles: position of the root, or of the center of mass in free flight."""
X, Y, _ = POINT.places

LOAD = Layout(
    "Load", "links, nodes",
    Field("arm", ("links * nodes",), "m", "weights of the load's position: position - root = sum arm_j e_j"),
    Field("angle", ("links * nodes",), "", "weights of the node angles in the angle of the section at the load"),
)  # fmt: skip
ECCENTRIC = Layout(
    "Eccentric", "nodes",
    Field("along", ("nodes",), "m", "payload's center of mass - root = sum along_j e_j + across_j n_j"),
    Field("across", ("nodes",), "m", "weights of n_j in the vector from root to payload"),
    Field("beta", ("nodes",), "m",
          "root = last rows - sum (beta_j of `chain.DATA`) e_j + beta_j n_j; imaginary part of complex beta"),
)  # fmt: skip
"""`ECCENTRIC`: constants of a payload whose center of mass is not at the tip; nodes are those of all links."""
OWN = len(BENDING)
BENDS = Layout(
    "Bends", "points, nodes",
    Field("EI", ("points",), "N m^3", "EI times the point's quadrature weight"),
    Field("slope", ("points", "nodes"), "1/m",
          "weights of the node angles in the curvature: kappa = sum slope_j phi_j"),
    Field("own", ("points", OWN), "", "further constants of the law of M (`materials.BENDING`)"),
)  # fmt: skip
"""`BENDS`: constants of a nonlinear law M(kappa) at all quadrature points; nodes are those of all links."""
eccentric_at = kernel(ECCENTRIC.offsets)
bends_at = kernel(BENDS.offsets)
_load_at = kernel(LOAD.offsets)


class Nodes(NamedTuple):
    """Scratch arrays on the stack with an entry for each node; vectors are in inertial axes."""

    rate: Lanes  # rad/s: phi', rate of the tangent angle
    c: Lanes  # cos phi, x of the unit tangent e
    s: Lanes  # sin phi, y of the unit tangent e
    ex: Lanes  # 1/s^2: x of e''; in `_tangent` its weighted derivative by phi
    ey: Lanes  # 1/s^2: y of e''; in `_tangent` its weighted derivative by phi
    fx: Lanes  # N m: x of the sum A
    fy: Lanes  # N m: y of the sum A


@kernel
def load_at(model, f):
    """Return the offsets in model.loads of the fields of LOAD (arm, angle) of point load f."""
    links, nodes = size(model.links), size(model.nodes)
    first = _load_at(0, links, nodes)
    return _load_at(f * first.end, links, nodes)


@kernel
def weighted_sum(lane, weights, first, x: Lanes, m):
    """Return sum_j weights[first + j] x_j for j = 0 ... m - 1; entries of weights are numbers, entries of x lanes."""
    total = 0.0
    for j in range(m):
        total = total + x[j] * weights[first + j]
    return total


@kernel
def node_angles(lane, model, q: Lanes, x: Lanes):
    """Compute x <- tangent angles of all nodes (rad), or their rates, from the coordinates q (or their rates v, a).

    Nodes are numbered from root to tip. The coordinate of the first node of a link k > 0 is the joint's angle. The
    tangent angle of a link's first node is the joint's angle plus the angle of the previous link's tip node. All other
    coordinates are tangent angles.
    """
    n = size(model.nodes)
    for i in range(n):
        x[i] = q[i]
    for k in range(1, size(model.links)):
        x[k * n] = q[k * n] + q[k * n - 1]
        for i in range(k * n + 1, k * n + n):
            x[i] = q[i]
