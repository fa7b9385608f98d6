"""Where things are in an elastica's data and coordinates."""

from ...compiler import kernel, load, size, splat, store
from ...layout import Field, Layout
from ..materials import BENDING

POINT = Layout("Point", "", Field("x", (), "m", ""), Field("y", (), "m", ""))
"""The root's rows, or the centre of mass's, behind those of the angles."""
X, Y, _ = POINT.places

DATA = Layout(
    "Data", "links, nodes, points",
    Field("P", ("links * nodes", "links * nodes"), "kg m^2", "masses but the payload's"),
    Field("R", ("links", "nodes", "nodes"), "kg m^2", "rotary inertia, of hub and elbows too, less C"),
    Field("K", ("links", "nodes", "nodes"), "N m", "bending stiffness"),
    Field("b", ("links * nodes",), "kg m", "first moments: sum b_j e_j = mass (centre - root)"),
    Field("w", ("links * nodes",), "m", "sum w_j e_j = tip of the last link - root; link by link, its tip - its root"),
    Field("tips", ("links * nodes",), "", "weights of a link's angles in its tip's angle"),
    Field("beta", ("links * nodes",), "m", "root = last rows - sum beta_j e_j"),
    Field("mass", (), "kg", "payload left out"),
    Field("root", (POINT.length,), "m", "place of a root that cannot move"),
    Field("gravity", (POINT.length,), "m/s^2", ""),
    Field("C", ("links", "nodes", "nodes"), "kg m^2", "correction of the integrator's period"),
    Field("points", ("points", "links * nodes"), "m", "of each point drawn: sum of weights times e_j = point - root"),
)  # fmt: skip
LOAD = Layout(
    "Load", "links, nodes",
    Field("arm", ("links * nodes",), "m", "sum of it times e_j = point of the load - root"),
    Field("angle", ("links * nodes",), "", "weights of the angles in the angle there"),
)  # fmt: skip
ECCENTRIC = Layout(
    "Eccentric", "nodes",
    Field("along", ("nodes",), "m", "sum of it times e_j and of across times n_j = the payload's centre - root"),
    Field("across", ("nodes",), "m", ""),
    Field("beta", ("nodes",), "m", "root = last rows - sum beta_j e_j (`DATA`) and of this times n_j"),
)  # fmt: skip
"""Of a payload whose centre is not at the tip; n_j = (-sin phi_j, cos phi_j); nodes: of all links."""
OWN = len(BENDING)
BENDS = Layout(
    "Bends", "points, nodes",
    Field("stiffness", ("points",), "N m^3", "EI times the point's weight"),
    Field("slope", ("points", "nodes"), "1/m", "sum of it times the angles = kappa"),
    Field("own", ("points", OWN), "", "what the law of M has besides"),
)  # fmt: skip
"""Of a law of M that is not EI kappa, at the points of quadrature of all links; nodes: of all links."""
_data_at = kernel(DATA.offsets)
eccentric_at = kernel(ECCENTRIC.offsets)
bends_at = kernel(BENDS.offsets)
_load_at = kernel(LOAD.offsets)


@kernel
def constants(model):
    """Where the fields of DATA are in model.data."""
    return _data_at(0, size(model.links), size(model.nodes), 0)


@kernel
def load_at(model, f):
    """Where the fields of LOAD are in model.loads for load f."""
    links, nodes = size(model.links), size(model.nodes)
    first = _load_at(0, links, nodes)
    return _load_at(f * first.end, links, nodes)


@kernel
def weighted(lane, weights, first, x, m):
    """sum_j weights[first + j] x_j."""
    total = splat(lane, 0.0)
    for j in range(m):
        total = total + load(lane, x, j) * weights[first + j]
    return total


@kernel
def node_angles(lane, model, q, x):
    """x <- angles of the nodes (or their rates) from the coordinates: a joint's is relative to the tip before it."""
    n = size(model.nodes)
    for i in range(n):
        store(x, i, load(lane, q, i))
    for k in range(1, size(model.links)):
        store(x, k * n, load(lane, q, k * n) + load(lane, q, k * n - 1))
        for i in range(k * n + 1, k * n + n):
            store(x, i, load(lane, q, i))
