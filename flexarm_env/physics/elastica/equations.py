"""The elastica's equations of motion and their tangent (model: `physics.model.Elastica`).

With e_j = (cos phi_j, sin phi_j), second rate e_j'', the inertia force on node i is (-sin phi_i, cos phi_i) . A_i,
A_i = sum_j P_ij e_j'' + b_i (a_root - g) - loads: no sine of a difference is needed. Its derivative by node j is
(-sin phi_i, cos phi_i) . P_ij d e_j'', by node i itself also -e_i . A_i. The payload adds m_p w w' to P, m_p w to b and
J_p l(L) l(L)' to the last link's R; `eccentric` has what differs where its centre is not at the tip. Where the root
can move it is at x - sum_j beta_j e_j, with x the last two rows: beta = 0 where it is prescribed; in free flight x is
the centre of mass, so that steps keep momentum to round-off.
"""

from typing import NamedTuple

import numpy as np

from ...compiler import kernel, load, sincos, size, splat, stack, store, unrolled, vjp_of
from ..arithmetic import share_of
from ..layout import OF_LOAD
from ..materials import viscoelastic, viscoelastic_slope
from ..model import PAYLOAD_INERTIA, PAYLOAD_MASS, STIFFNESS_FACTOR, TAU_D, Elastica
from ..protocol import State, register
from .eccentric import less_root_aside, more_moments, more_slopes, payload_at, root_of, tangent_aside, with_payload
from .layout import X, Y, constants, load_at, node_angles, weighted
from .output import damping_work, energy, link_poses, ports, shape


class Nodes(NamedTuple):
    """Room for what is known of each node."""

    rate: np.ndarray  # of its angle
    c: np.ndarray  # e = (c, s)
    s: np.ndarray
    ex: np.ndarray  # e''
    ey: np.ndarray
    fx: np.ndarray  # A
    fy: np.ndarray


@kernel
def assemble(lane, model, par, state, u, weights, r, S):
    """r and, where the weight of M is not 0, S (row-major, model.n squared), see `protocol`."""
    on = Nodes(
        stack(lane, model.scratch), stack(lane, model.scratch), stack(lane, model.scratch), stack(lane, model.scratch),
        stack(lane, model.scratch), stack(lane, model.scratch), stack(lane, model.scratch),
    )  # fmt: skip
    _forces(lane, model, par, state, u, on, r)
    if weights.mass != 0.0:
        _tangent(lane, model, par, state.q, on, weights, S)


@kernel
def residual(lane, model, par, state, u, r, S):
    """See `protocol`."""
    on = Nodes(
        stack(lane, model.scratch), stack(lane, model.scratch), stack(lane, model.scratch), stack(lane, model.scratch),
        stack(lane, model.scratch), stack(lane, model.scratch), stack(lane, model.scratch),
    )  # fmt: skip
    _forces(lane, model, par, state, u, on, r)


@unrolled
@kernel
def _forces(lane, model, par, state, u, on, r):
    """r, and on the way all that `Nodes` holds."""
    q, v, a = state.q, state.v, state.a
    y, c, s, ex, ey, fx, fy = on.rate, on.c, on.s, on.ex, on.ey, on.fx, on.fy
    D = model.data
    at = constants(model)
    n, links = size(model.nodes), size(model.links)
    m = n * links
    payload, stiffness, tau_d = load(lane, par, PAYLOAD_MASS), load(lane, par, STIFFNESS_FACTOR), load(lane, par, TAU_D)
    x, z = stack(lane, model.scratch), stack(lane, model.scratch)
    node_angles(lane, model, q, x)
    node_angles(lane, model, v, y)
    node_angles(lane, model, a, z)
    for i in range(m):
        angle, rate, second = load(lane, x, i), load(lane, y, i), load(lane, z, i)
        sine, cosine = sincos(angle)
        square = rate * rate
        ax, ay = -(sine * second + cosine * square), cosine * second - sine * square
        store(c, i, cosine)
        store(s, i, sine)
        store(ex, i, ax)
        store(ey, i, ay)
        if model.rest is not None:
            angle = angle - model.rest[i]
        if model.damping is not None:
            angle = viscoelastic(angle, rate, share_of(model.damping, i // n, tau_d))
        store(x, i, angle * stiffness)
    frame_x, frame_y = splat(lane, 0.0), splat(lane, 0.0)  # acceleration of the root less gravity
    if model.root is not None:
        frame_x, frame_y = root_of(lane, model, a, ex, ey)
    if model.gravity is not None:
        frame_x, frame_y = frame_x - D[at.gravity + X], frame_y - D[at.gravity + Y]
    tip_x, tip_y = splat(lane, 0.0), splat(lane, 0.0)
    if model.payload is not None:
        tip_x, tip_y = payload_at(lane, model, ex, ey)
        tip_x, tip_y = (tip_x + frame_x) * payload, (tip_y + frame_y) * payload
    for i in range(m):
        fxi, fyi = load(lane, ex, 0) * D[at.P + i * m], load(lane, ey, 0) * D[at.P + i * m]
        for j in range(1, m):
            fxi = fxi + load(lane, ex, j) * D[at.P + i * m + j]
            fyi = fyi + load(lane, ey, j) * D[at.P + i * m + j]
        if model.root is not None or model.gravity is not None:
            fxi, fyi = fxi + frame_x * D[at.b + i], fyi + frame_y * D[at.b + i]
        if model.payload is not None:
            fxi, fyi = with_payload(lane, model, i, tip_x, tip_y, fxi, fyi)
        store(fx, i, fxi)
        store(fy, i, fyi)
    if model.loads is not None:
        _less_forces(lane, model, u, fx, fy)
    if model.root is not None:  # momentum of the whole chain
        store(r, m + X, frame_x * D[at.mass] + weighted(lane, D, at.b, ex, m) + tip_x)
        store(r, m + Y, frame_y * D[at.mass] + weighted(lane, D, at.b, ey, m) + tip_y)
        if model.loads is not None:
            for f in range((size(model.n_inputs) - links) // OF_LOAD.end):
                at_load = links + OF_LOAD.end * f
                store(r, m + X, load(lane, r, m + X) - load(lane, u, at_load + OF_LOAD.x))
                store(r, m + Y, load(lane, r, m + Y) - load(lane, u, at_load + OF_LOAD.y))
        for i in range(m):
            store(fx, i, load(lane, fx, i) - load(lane, r, m + X) * D[at.beta + i])
            store(fy, i, load(lane, fy, i) - load(lane, r, m + Y) * D[at.beta + i])
        less_root_aside(lane, model, r, fx, fy)
    for k in range(links):
        for i in range(k * n, k * n + n):
            total = load(lane, z, k * n) * D[at.R + i * n]
            for j in range(1, n):
                total = total + load(lane, z, k * n + j) * D[at.R + i * n + j]
            for j in range(n):
                total = total + load(lane, x, k * n + j) * D[at.K + i * n + j]
            store(r, i, total + (load(lane, c, i) * load(lane, fy, i) - load(lane, s, i) * load(lane, fx, i)))
    more_moments(lane, model, stiffness, q, r)
    if model.loads is not None:
        _less_torques(lane, model, u, r)
    _payload_turns(lane, model, load(lane, par, PAYLOAD_INERTIA), z, r)
    for k in range(links - 1, 0, -1):  # from angles to coordinates, see _to_relative
        store(r, k * n - 1, load(lane, r, k * n - 1) + load(lane, r, k * n))
    for k in range(links):
        store(r, k * n, load(lane, r, k * n) - load(lane, u, k))


@unrolled
@kernel
def _tangent(lane, model, par, q, on, weights, S):
    """The matrix of `assemble`; e'' becomes its weighted derivative."""
    cm, cc, ck = weights.mass, weights.damping, weights.stiffness
    y, c, s, ex, ey, fx, fy = on.rate, on.c, on.s, on.ex, on.ey, on.fx, on.fy
    D = model.data
    at = constants(model)
    n, links, rows = size(model.nodes), size(model.links), size(model.n)
    m = n * links
    payload, factor, tau_d = load(lane, par, PAYLOAD_MASS), load(lane, par, STIFFNESS_FACTOR), load(lane, par, TAU_D)
    slope = factor * ck
    if model.damping is not None:
        slope = factor * viscoelastic_slope(None, tau_d, cc, ck)
    for i in range(m):
        cosine, sine, ax, ay = load(lane, c, i), load(lane, s, i), load(lane, ex, i), load(lane, ey, i)
        twice = load(lane, y, i) * (2.0 * cc)
        store(ex, i, -(sine * cm + cosine * twice + ay * ck))
        store(ey, i, cosine * cm - sine * twice + ax * ck)
    mass = payload + D[at.mass]
    for i in range(m):
        share = payload * D[at.w + i]
        moment = share + D[at.b + i]
        ci, si, dxi, dyi = load(lane, c, i), load(lane, s, i), load(lane, ex, i), load(lane, ey, i)
        k = i // n
        steep = slope
        if model.damping is not None and not isinstance(model.damping, tuple):  # a link's own
            steep = factor * viscoelastic_slope(None, tau_d, model.damping[k] * cc, ck)
        for j in range(i):
            p = splat(lane, D[at.P + i * m + j])
            if model.payload is not None:
                p = share * D[at.w + j] + D[at.P + i * m + j]
            if model.root is not None:
                rest = payload * D[at.w + j] + D[at.b + j] - mass * D[at.beta + j]
                p = p - (moment * D[at.beta + j] + rest * D[at.beta + i])
            lower = p * (ci * load(lane, ey, j) - si * load(lane, ex, j))
            upper = p * (load(lane, c, j) * dyi - load(lane, s, j) * dxi)
            if j >= k * n:
                bend = steep * D[at.K + i * n + j - k * n] + cm * D[at.R + i * n + j - k * n]
                lower, upper = lower + bend, upper + bend
            store(S, i * rows + j, lower)
            store(S, j * rows + i, upper)
        p = splat(lane, D[at.P + i * m + i])
        if model.payload is not None:
            p = share * D[at.w + i] + D[at.P + i * m + i]
        if model.root is not None:
            p = p - (moment + (moment - mass * D[at.beta + i])) * D[at.beta + i]
        own = p * (ci * dyi - si * dxi) + (steep * D[at.K + i * n + i - k * n] + cm * D[at.R + i * n + i - k * n])
        store(S, i * rows + i, own - (ci * load(lane, fx, i) + si * load(lane, fy, i)) * ck)
    more_slopes(lane, model, factor * ck, q, S)
    _payload_turns_tangent(lane, model, load(lane, par, PAYLOAD_INERTIA), cm, S)
    _root_tangent(lane, model, payload, on, cm, S)
    tangent_aside(lane, model, payload, on, cm, S)
    _to_relative(lane, model, S)


@kernel
def _less_forces(lane, model, u, fx, fy):
    """A_i <- A_i less the forces of the point loads times their arms."""
    links, loads = size(model.links), model.loads
    m = links * size(model.nodes)
    for f in range((size(model.n_inputs) - links) // OF_LOAD.end):
        at, k = load_at(model, f), links + OF_LOAD.end * f
        force_x, force_y = load(lane, u, k + OF_LOAD.x), load(lane, u, k + OF_LOAD.y)
        for i in range(m):
            store(fx, i, load(lane, fx, i) - force_x * loads[at.arm + i])
            store(fy, i, load(lane, fy, i) - force_y * loads[at.arm + i])


@kernel
def _less_torques(lane, model, u, r):
    """r_i <- r_i less the torques of the point loads."""
    links, loads = size(model.links), model.loads
    for f in range((size(model.n_inputs) - links) // OF_LOAD.end):
        at, torque = load_at(model, f), load(lane, u, links + OF_LOAD.end * f + OF_LOAD.torque)
        for i in range(links * size(model.nodes)):
            store(r, i, load(lane, r, i) - torque * loads[at.angle + i])


@kernel
def _payload_turns(lane, model, inertia, z, r):
    """Rotary inertia of the payload, on the last link's angles."""
    D = model.data
    at = constants(model)
    if model.payload_turns is not None:
        n, m = size(model.nodes), size(model.links) * size(model.nodes)
        moment = splat(lane, 0.0)
        for j in range(m - n, m):
            moment = moment + load(lane, z, j) * D[at.tips + j]
        moment = moment * inertia
        for i in range(m - n, m):
            store(r, i, load(lane, r, i) + moment * D[at.tips + i])


@kernel
def _payload_turns_tangent(lane, model, inertia, cm, S):
    D = model.data
    at = constants(model)
    if model.payload_turns is not None:
        n, m, rows = size(model.nodes), size(model.links) * size(model.nodes), size(model.n)
        for i in range(m - n, m):
            share = inertia * (cm * D[at.tips + i])
            for j in range(m - n, m):
                store(S, i * rows + j, load(lane, S, i * rows + j) + share * D[at.tips + j])


@kernel
def _root_tangent(lane, model, payload, on, cm, S):
    """Rows and columns of the root, or of the centre of mass (where little or nothing is left of `moment`)."""
    D = model.data
    at = constants(model)
    if model.root is not None:
        m, rows = size(model.links) * size(model.nodes), size(model.n)
        for j in range(m):
            moment = payload * D[at.w + j] + D[at.b + j] - (payload + D[at.mass]) * D[at.beta + j]
            store(S, (m + X) * rows + j, moment * load(lane, on.ex, j))
            store(S, (m + Y) * rows + j, moment * load(lane, on.ey, j))
            store(S, j * rows + m + X, moment * load(lane, on.s, j) * -cm)
            store(S, j * rows + m + Y, moment * load(lane, on.c, j) * cm)
        mass = (payload + D[at.mass]) * cm
        store(S, (m + X) * rows + m + X, mass)
        store(S, (m + X) * rows + m + Y, splat(lane, 0.0))
        store(S, (m + Y) * rows + m + X, splat(lane, 0.0))
        store(S, (m + Y) * rows + m + Y, mass)


@kernel
def _to_relative(lane, model, S):
    """From the nodes' angles to the coordinates: what acts on a link's root acts on the tip before it as well."""
    n, rows = size(model.nodes), size(model.n)
    for k in range(size(model.links) - 1, 0, -1):
        for j in range(rows):
            o = j * rows + k * n
            store(S, o - 1, load(lane, S, o - 1) + load(lane, S, o))
        for j in range(rows):
            o = k * n * rows + j
            store(S, o - rows, load(lane, S, o - rows) + load(lane, S, o))


@kernel
def pin(lane, model, S, k):
    """Row and column k <- those of the identity."""
    rows = size(model.n)
    for j in range(rows):
        store(S, k * rows + j, splat(lane, 0.0))
        store(S, j * rows + k, splat(lane, 0.0))
    store(S, k * rows + k, splat(lane, 1.0))


@kernel
def stiffen(lane, model, S, k, x):
    """See `protocol`."""
    at = k * size(model.n) + k
    store(S, at, load(lane, S, at) + x)


@unrolled
@kernel
def factor(lane, model, S):
    """S <- L U without pivoting, the diagonal inverted: cm M, positive definite, outweighs the rest."""
    rows = size(model.n)
    for k in range(rows):
        inverse = 1.0 / load(lane, S, k * rows + k)
        store(S, k * rows + k, inverse)
        for i in range(k + 1, rows):
            f = load(lane, S, i * rows + k) * inverse
            store(S, i * rows + k, f)
            for j in range(k + 1, rows):
                store(S, i * rows + j, load(lane, S, i * rows + j) - f * load(lane, S, k * rows + j))


@unrolled
@kernel
def solve(lane, model, S, x):
    """x <- S^-1 x with the factors of `factor`."""
    rows = size(model.n)
    for i in range(1, rows):
        total = load(lane, x, i)
        for j in range(i):
            total = total - load(lane, S, i * rows + j) * load(lane, x, j)
        store(x, i, total)
    for i in range(rows - 1, -1, -1):
        total = load(lane, x, i)
        for j in range(i + 1, rows):
            total = total - load(lane, S, i * rows + j) * load(lane, x, j)
        store(x, i, total * load(lane, S, i * rows + i))


def _residual(lane, model, par, q, v, a, u, r):
    residual(lane, model, par, State(q, v, a), u, r, r)


def _solve(lane, model, S, x):
    solve(lane, model, S, x)


_vjp_solve = vjp_of(_solve, ("x",))  # straight-line code, as both are no kernels
_vjp_residual = vjp_of(_residual, ("par", "q", "v", "a", "u", "r"))


@kernel
def solve_transposed(lane, model, S, x):
    """See `protocol`."""
    _vjp_solve(lane, model, S, x, x)


@kernel
def vjp_residual(lane, model, par, par_bar, state, u, S, bar, u_bar, r_bar):
    """See `protocol`."""
    q, v, a = state
    _vjp_residual(lane, model, par, q, v, a, u, S, par_bar, bar.q, bar.v, bar.a, u_bar, r_bar)


register(
    Elastica, assemble, residual, pin, stiffen, factor, solve, ports, damping_work, energy, link_poses, shape,
    solve_transposed, vjp_residual,
)  # fmt: skip
