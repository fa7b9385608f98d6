"""Outputs of an elastica's state: input displacements, energies, damping power, poses, centerline.

Positions are in m and velocities in m/s, in inertial axes. phi_j is the tangent angle of node j, rad, and e_j = (cos
phi_j, sin phi_j) its unit tangent.
"""

from ...compiler import Lanes, kernel, sincos, size, stack
from ..arithmetic import scaled_by_share, store_pair, store_vector
from ..layout import OF_LOAD, POSE
from ..model import PAYLOAD_INERTIA, PAYLOAD_MASS, STIFFNESS_FACTOR, TAU_D
from .chain import constants
from .eccentric import nonlinear_strain_energy, payload_position, root_position, subtract_rest_angles
from .layout import X, Y, load_at, node_angles, weighted_sum


@kernel
def _tangents(lane, model, q, x: Lanes, c: Lanes, s: Lanes):
    """Compute the nodes' tangent angles x_j = phi_j (rad) and unit tangents (c_j, s_j) = (cos phi_j, sin phi_j).

    q: coordinates, rad. Vectors are in inertial axes.
    """
    node_angles(lane, model, q, x)
    for i in range(size(model.links) * size(model.nodes)):
        sine, cosine = sincos(x[i])
        c[i] = cosine
        s[i] = sine


@kernel
def _moving_tangents(lane, model, q, v, x, y: Lanes, c: Lanes, s: Lanes, ex: Lanes, ey: Lanes):
    """Write the node angles x (rad), their rates y (rad/s), unit tangents (c, s) and rates of tangents (ex, ey; 1/s).

    q: coordinates of the arm. v: rates of the coordinates. Vectors are in inertial axes.
    """
    _tangents(lane, model, q, x, c, s)
    node_angles(lane, model, v, y)
    for i in range(size(model.links) * size(model.nodes)):
        rate = y[i]
        ex[i] = -(s[i] * rate)
        ey[i] = c[i] * rate


@kernel
def _root(lane, model, q, c, s):
    """Return the position (x, y) of the root, m, inertial axes; (c, s): unit tangents of the nodes.

    The position of a root that cannot move is a constant of the model. If the root can move, the last two rows of q
    determine its position.
    """
    D = model.data
    at = constants(model)
    if model.root is not None:
        return root_position(lane, model, q, c, s)
    return D[at.root + X], D[at.root + Y]


@kernel
def _input_rates(lane, model, par, q, v: Lanes, y: Lanes):
    """Write the rates of `input_displacements` to y: joint rates (rad/s), then velocity (m/s), rate of each load point.

    q: coordinates of the arm. v: their rates. The velocity of a load is that of the root plus sum_j arm_j e_j'.
    """
    n, links = size(model.nodes), size(model.links)
    m = n * links
    # joint rates beta_k'
    for k in range(links):
        y[k] = v[k * n]
    # e_j' = phi_j' (-sin phi_j, cos phi_j)
    x, rate = stack(lane, model.scratch), stack(lane, model.scratch)
    c, s = stack(lane, model.scratch), stack(lane, model.scratch)
    ex, ey = stack(lane, model.scratch), stack(lane, model.scratch)
    _moving_tangents(lane, model, q, v, x, rate, c, s, ex, ey)
    root_x, root_y = rate[0] * 0.0, rate[0] * 0.0
    if model.root is not None:
        root_x, root_y = root_position(lane, model, v, ex, ey)
    # root' + sum_j arm_j e_j', and sum_j angle_j phi_j'
    for f in range((size(model.n_inputs) - links) // OF_LOAD.end):
        at, k = load_at(model, f), links + OF_LOAD.end * f
        px, py = weighted_sum(lane, model.loads, at.arm, ex, m), weighted_sum(lane, model.loads, at.arm, ey, m)
        store_vector(lane, y, k, (root_x + px, root_y + py, weighted_sum(lane, model.loads, at.angle, rate, m)))


@kernel
def input_displacements(lane, model, par, q: Lanes, y: Lanes, since=None, v=None):
    """Write the displacements on which inputs do work to y: joint angles (rad), then x, y, angle of each load point.

    q: coordinates of the arm. Positions (m, inertial axes) are root + sum_j arm_j e_j, with the load's weights arm_j
    (m) and the nodes' unit tangents e_j. par and since are not used, because angles in the plane add up. See
    docs/theory.md, section 5.
    """
    if v is not None:
        _input_rates(lane, model, par, q, v, y)
        return
    n, links = size(model.nodes), size(model.links)
    m = n * links
    # y_k = q_(k n): the first node's coordinate of link k is its joint angle beta_k
    for k in range(links):
        y[k] = q[k * n]
    if model.loads is not None:
        x, c, s = stack(lane, model.scratch), stack(lane, model.scratch), stack(lane, model.scratch)
        _tangents(lane, model, q, x, c, s)
        root_x, root_y = _root(lane, model, q, c, s)
        for f in range((size(model.n_inputs) - links) // OF_LOAD.end):
            at, k = load_at(model, f), links + OF_LOAD.end * f
            px, py = weighted_sum(lane, model.loads, at.arm, c, m), weighted_sum(lane, model.loads, at.arm, s, m)
            store_vector(lane, y, k, (root_x + px, root_y + py, weighted_sum(lane, model.loads, at.angle, x, m)))


@kernel
def _bending(lane, model, shares, x: Lanes, y: Lanes):
    """Return sum_k share_k x^T K_k y over links k; x, y: node angles or rates. Unit: N m times the units of x and y.

    K_k: bending stiffness of link k (N m) for an EI factor of 1.
    shares: one number per link; None or a tag stands for 1. The sum uses differences from the angle of the link's root
    node. Because K 1 = 0, a rigid rotation contributes exactly 0. See docs/theory.md, (5.2).
    """
    D = model.data
    at = constants(model)
    n = size(model.nodes)
    total = 0.0
    # rows and columns 1 ... n - 1 of K_k, by differences from node 0
    for k in range(size(model.links)):
        from_x, from_y = x[k * n], y[k * n]
        for i in range(1, n):
            row = 0.0
            for j in range(1, n):
                row = row + (y[k * n + j] - from_y) * D[at.K_EI + (k * n + i) * n + j]
            total = total + scaled_by_share(shares, k, row * (x[k * n + i] - from_x))
    return total


@kernel
def damping_power(lane, model, par: Lanes, q, v, x):
    """Return x^T C v (W) with C = tau_d K: the power of the Kelvin-Voigt damping moments C v at virtual rates x.

    x, v: rates of the coordinates, rad/s. The result is 0 without damping. q is not used, because K is constant.
    """
    if model.damping is None:
        return 0.0
    y, z = stack(lane, model.scratch), stack(lane, model.scratch)
    node_angles(lane, model, v, y)
    node_angles(lane, model, x, z)
    return _bending(lane, model, model.damping, z, y) * (par[STIFFNESS_FACTOR] * par[TAU_D])


@kernel
def energy(lane, model, par: Lanes, q, v):
    """Return (kinetic, strain, gravitational) energy, J. Gravitational energy is measured from the inertial origin.

    par: the arm's payload mass (kg), payload inertia (kg m^2) and EI factor.
    q: coordinates of the arm.
    v: rates of the coordinates. See docs/theory.md, (5.2).
    """
    D = model.data
    at = constants(model)
    n, links = size(model.nodes), size(model.links)
    m = n * links
    payload = par[PAYLOAD_MASS]
    x, y = stack(lane, model.scratch), stack(lane, model.scratch)
    c, s = stack(lane, model.scratch), stack(lane, model.scratch)
    ex, ey = stack(lane, model.scratch), stack(lane, model.scratch)
    _moving_tangents(lane, model, q, v, x, y, c, s, ex, ey)
    # strain energy 1/2 (phi - phi_0)^T K (phi - phi_0)
    subtract_rest_angles(lane, model, x)
    strain = _bending(lane, model, None, x, x) * (par[STIFFNESS_FACTOR] * 0.5)
    if model.bends is not None:
        strain = strain + nonlinear_strain_energy(lane, model, x) * par[STIFFNESS_FACTOR]
    # twice the kinetic energy relative to the root: payload, then sum P_ij e_i' . e_j' + R_ij phi_i' phi_j'
    tip_x, tip_y = payload_position(lane, model, ex, ey)
    tip_spin = 0.0
    for i in range(m - n, m):
        tip_spin = tip_spin + y[i] * D[at.tips + i]
    twice = payload * (tip_x * tip_x + tip_y * tip_y) + par[PAYLOAD_INERTIA] * (tip_spin * tip_spin)
    for i in range(m):
        px, py, rate, spin = 0.0, 0.0, y[i], 0.0
        for j in range(n):
            spin = spin + y[i // n * n + j] * D[at.R + i * n + j]
        for j in range(m):
            px = px + ex[j] * D[at.P + i * m + j]
            py = py + ey[j] * D[at.P + i * m + j]
        twice = twice + (ex[i] * px + ey[i] * py + rate * spin)
    # moving root: mass v^2 + 2 v . momentum relative to the root
    mass = payload + D[at.mass]
    if model.root is not None:
        vx, vy = root_position(lane, model, v, ex, ey)
        px = payload * tip_x + weighted_sum(lane, D, at.b, ex, m)
        py = payload * tip_y + weighted_sum(lane, D, at.b, ey, m)
        twice = twice + (mass * (vx * vx + vy * vy) + (vx * px + vy * py) * 2.0)
    # V = -g . (c_x, c_y), first moment of mass about the origin (kg m, inertial axes)
    gravity = 0.0
    if model.gravity is not None:
        root_x, root_y = _root(lane, model, q, c, s)
        far_x, far_y = payload_position(lane, model, c, s)
        cx = payload * far_x + weighted_sum(lane, D, at.b, c, m) + mass * root_x
        cy = payload * far_y + weighted_sum(lane, D, at.b, s, m) + mass * root_y
        gravity = -(cx * D[at.gravity + X] + cy * D[at.gravity + Y])
    return twice * 0.5, strain, gravity


@kernel
def link_poses(lane, model, par, q, v, out, tasks=None):
    """Write `layout.POSES` of each link to out: x, y (m), angle (rad) and their rates at the root, then at the tip.

    Vectors are in inertial axes. Root and tip are the joints, so that rigid ends lie between them. The angles are those
    of the beam's end tangents.
    q: coordinates of the arm.
    v: rates of q. par and tasks are not used. See docs/theory.md, section 5.
    """
    D = model.data
    at = constants(model)
    n, links = size(model.nodes), size(model.links)
    x, y = stack(lane, model.scratch), stack(lane, model.scratch)
    c, s = stack(lane, model.scratch), stack(lane, model.scratch)
    ex, ey = stack(lane, model.scratch), stack(lane, model.scratch)
    _moving_tangents(lane, model, q, v, x, y, c, s, ex, ey)
    px, py = _root(lane, model, q, c, s)
    vx, vy = 0.0, 0.0
    if model.root is not None:
        vx, vy = root_position(lane, model, v, ex, ey)
    # along the chain: a link's tip is its root + sum w_i e_i over its nodes, and the next link's root
    for k in range(links):
        o = POSE.end * k
        store_vector(lane, out, o + POSE.x, (px, py, x[k * n]))
        store_vector(lane, out, o + POSE.vx, (vx, vy, y[k * n]))
        # on to the tip; its angle is sum l_i(L) phi_i
        angle, rate = 0.0, 0.0
        for i in range(k * n, k * n + n):
            px, py = px + c[i] * D[at.w + i], py + s[i] * D[at.w + i]
            vx, vy = vx + ex[i] * D[at.w + i], vy + ey[i] * D[at.w + i]
            angle, rate = angle + x[i] * D[at.tips + i], rate + y[i] * D[at.tips + i]
        store_vector(lane, out, o + POSE.tip_x, (px, py, angle))
        store_vector(lane, out, o + POSE.tip_vx, (vx, vy, rate))


@kernel
def centerline(lane, model, q, points):
    """Write positions along the chain, root + sum_j weight_pj e_j, to points (m); return their number.

    q: coordinates of the arm.
    e_j: unit tangent of node j, inertial axes. DATA.points contains the weights of the drawn points p. Writing stops
    when `points` (n, lanes of 2 numbers) is full.
    """
    D = model.data
    m = size(model.links) * size(model.nodes)
    first = constants(model).points
    count = min((D.shape[0] - first) // m, points.shape[0])
    x, c, s = stack(lane, model.scratch), stack(lane, model.scratch), stack(lane, model.scratch)
    _tangents(lane, model, q, x, c, s)
    root_x, root_y = _root(lane, model, q, c, s)
    for p in range(count):
        x_p, y_p = weighted_sum(lane, D, first + p * m, c, m), weighted_sum(lane, D, first + p * m, s, m)
        store_pair(lane, points[p], 0, (root_x + x_p, root_y + y_p))
    return count
