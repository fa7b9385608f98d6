"""What correcting the period of a chain of geometrically exact beams takes: M a alone, and rotating its vectors."""

from ...compiler import kernel, load, splat, store
from ..arithmetic import put_vector, vector
from ..model import PAYLOAD_INERTIA, PAYLOAD_MASS
from .element import momentum, rotate_pair
from .layout import AXES, T, elbow_of, next_section, rows_of, section_of


@kernel
def inertia(lane, model, par, a, r):
    """r <- M a: that of the elements, hub, elbows and payload."""
    rows, zero = rows_of(model), splat(lane, 0.0)
    x, y, psi = vector(lane, a, 0)
    left = (x, y, psi, zero, zero, psi * model.hub_inertia)
    i = rows.elements
    for k in range(model.links):
        root, before, d = i + T, zero, rows.hinges + k - 1
        if k > 0:
            x, y, psi, fx, fy, moment = left
            elbow = elbow_of(model, k)
            before = moment + psi * elbow.left
            psi = psi + load(lane, a, d)
            left = (x, y, psi, fx + x * elbow.mass, fy + y * elbow.mass, psi * elbow.right)
        section = section_of(lane, model, par, k)
        for _ in range(model.elements):
            j = i * len(lane)
            left = momentum(lane, model.order, a[j:], left, section, r[j:])
            i += AXES * len(model.order)
            section = next_section(model, section)
        if k > 0:
            moment = load(lane, r, root)
            store(r, root, before + moment)
            store(r, d, moment)
    x, y, psi, fx, fy, moment = left
    mass = load(lane, par, PAYLOAD_MASS)
    put_vector(r, i, (fx + x * mass, fy + y * mass, moment + psi * load(lane, par, PAYLOAD_INERTIA)))


@kernel
def rotate(lane, model, start, q, share, x):
    """Rotate each node's vector (x, y) in x by a share of the angle that its section turns by from start to q."""
    order, p, rows = model.order, len(model.order), rows_of(model)
    i = rows.elements
    left = load(lane, q, i + T) - load(lane, start, i + T)
    rotate_pair(lane, order, x, left * share)
    for k in range(model.links):
        if k > 0:
            d = rows.hinges + k - 1
            left = left + (load(lane, q, d) - load(lane, start, d))
        for _ in range(model.elements):
            last = i + AXES * p
            right = load(lane, q, last + T) - load(lane, start, last + T)
            for j in range(1, p):
                rotate_pair(lane, order, x[(i + AXES * j) * len(lane) :], (left + right) * (0.5 * share))
            rotate_pair(lane, order, x[last * len(lane) :], right * share)
            left = right
            i = last
