"""The elastica's equations of motion, theory (5.2), and their tangent (model: `physics.model.Elastica`).

phi_j is the tangent angle of node j (rad, from the inertial x axis), e_j = (cos phi_j, sin phi_j) the unit tangent in
inertial axes and e_j'' its second time derivative. The inertia moment on node i is (-sin phi_i, cos phi_i) . A_i with

    A_i = sum_j P_ij e_j'' + b_i (a_root - g) - loads    (N m, inertial axes),

No sine of a difference of angles occurs in A_i. The derivative of the moment by phi_j is (-sin phi_i, cos phi_i) . P_ij
d e_j''. For j = i the term -e_i . A_i is added. The payload adds m_p w w^T to P, m_p w to b and J_p l(L) l(L)^T to the
last link's R. `eccentric` adds the terms of a payload whose center is off the tip. A root that can move is at x - sum_j
beta_j e_j, where x is the last two rows of q. For a prescribed root beta = 0. In free flight x is the center of mass,
so that steps conserve momentum to round-off. The coordinates are the angles of the nodes, with one exception. The first
coordinate of a link k > 0 is the joint's angle: phi of the link's first node minus phi of the previous tip."""

from ...compiler import Lanes, kernel, sincos, size, stack, unrolled, vjp_of
from ..arithmetic import scaled_by_share
from ..layout import OF_LOAD
from ..materials import viscoelastic, viscoelastic_slope
from ..model import PAYLOAD_INERTIA, PAYLOAD_MASS, STIFFNESS_FACTOR, TAU_D, Elastica
from ..protocol import State, register
from .chain import constants
from .eccentric import (
    add_nonlinear_moments,
    add_nonlinear_stiffness,
    add_offset_tangent,
    add_payload_lever,
    payload_position,
    root_position,
    subtract_root_lever,
)
from .layout import Nodes, X, Y, load_at, node_angles, weighted_sum
from .output import centerline, damping_power, energy, input_displacements, link_poses


@kernel
def assemble(lane, model, par, state, u, weights, r, S):
    """Write the residual r [64] and, with weights.with_matrix, the Newton matrix S (dense, row-major, model.n rows).

    r = M a + h(q, v) - B u: moments (N m) in rows of angles, forces (N, inertial axes) in the two rows of a root that
    moves. S = weights.mass dr/da + weights.damping dr/dv + weights.stiffness dr/dq.
    par: payload mass (kg) and inertia (kg m^2), EI factor, tau_d (s).
    state: coordinates q, velocities v, accelerations a.
    u: joint torques (N m), then force and torque of each point load."""
    on = Nodes(
        stack(lane, model.scratch), stack(lane, model.scratch), stack(lane, model.scratch), stack(lane, model.scratch),
        stack(lane, model.scratch), stack(lane, model.scratch), stack(lane, model.scratch),
    )  # fmt: skip
    _forces(lane, model, par, state, u, on, r)
    if weights.with_matrix:
        _tangent(lane, model, par, state.q, on, weights, S)


@kernel
def residual(lane, model, par, state, u, r, S):
    """Write the residual r = M a + h(q, v) - B u, equation [64], without a matrix.

    r: moments (N m) in rows of angles, forces (N, inertial axes) in the two rows of a root that moves.
    par: payload mass (kg) and inertia (kg m^2), EI factor, tau_d (s).
    state: coordinates q, velocities v, accelerations a.
    u: joint torques (N m), then force and torque of each point load. S is not used."""
    on = Nodes(
        stack(lane, model.scratch), stack(lane, model.scratch), stack(lane, model.scratch), stack(lane, model.scratch),
        stack(lane, model.scratch), stack(lane, model.scratch), stack(lane, model.scratch),
    )  # fmt: skip
    _forces(lane, model, par, state, u, on, r)


@unrolled
@kernel
def _forces(lane, model, par: Lanes, state, u: Lanes, on: Nodes, r: Lanes):
    """Write the residual r of theory (5.2) and fill the arrays of `on` (`Nodes`).

    # state     q, v, a: coordinates and rates; u: joint torques (N m), then point loads (N, N, N m)
    # scratch   x: K's argument, the nodes' angles with damping; z: second rates of the nodes' angles
    # out       r: moments (N m) by the coordinates, forces (N, inertial axes) in the last two rows if the root moves
    #           on: rates phi', unit tangents e, their second rates e'' and sums A_i (N m; all inertial axes) of all
    #           nodes; the inertia and load moment on node i is (-sin phi_i, cos phi_i) . A_i

    Constants from DATA: P, R masses and rotary inertia (kg m^2), K bending stiffness (N m), b first moments (kg m)."""
    q, v, a = state.q, state.v, state.a
    y, c, s, ex, ey, fx, fy = on.rate, on.c, on.s, on.ex, on.ey, on.fx, on.fy
    D = model.data
    at = constants(model)
    n, links = size(model.nodes), size(model.links)
    m = n * links
    payload, stiffness, tau_d = par[PAYLOAD_MASS], par[STIFFNESS_FACTOR], par[TAU_D]
    # phi, phi', phi'' of the nodes
    x, z = stack(lane, model.scratch), stack(lane, model.scratch)
    node_angles(lane, model, q, x)
    node_angles(lane, model, v, y)
    node_angles(lane, model, a, z)
    # e, e'' = phi'' n - phi'^2 e with n = (-sin phi, cos phi), and the EI factor times (phi - phi_0 + tau_d phi')
    for i in range(m):
        angle, rate, second = x[i], y[i], z[i]
        sine, cosine = sincos(angle)
        square = rate * rate
        ax, ay = -(sine * second + cosine * square), cosine * second - sine * square
        c[i] = cosine
        s[i] = sine
        ex[i] = ax
        ey[i] = ay
        if model.rest is not None:
            angle = angle - model.rest[i]
        if model.damping is not None:
            angle = viscoelastic(angle, rate, scaled_by_share(model.damping, i // n, tau_d))
        x[i] = angle * stiffness
    # a - g of the root, inertial axes (equivalence principle)
    frame_x, frame_y = 0.0, 0.0
    if model.root is not None:
        frame_x, frame_y = root_position(lane, model, a, ex, ey)
    if model.gravity is not None:
        frame_x, frame_y = frame_x - D[at.gravity + X], frame_y - D[at.gravity + Y]
    # inertia force of the payload, N
    tip_x, tip_y = 0.0, 0.0
    if model.payload is not None:
        tip_x, tip_y = payload_position(lane, model, ex, ey)
        tip_x, tip_y = (tip_x + frame_x) * payload, (tip_y + frame_y) * payload
    # A_i = sum_j P_ij e_j'' + b_i (a_root - g) + the payload's
    for i in range(m):
        fxi, fyi = ex[0] * D[at.P + i * m], ey[0] * D[at.P + i * m]
        for j in range(1, m):
            fxi = fxi + ex[j] * D[at.P + i * m + j]
            fyi = fyi + ey[j] * D[at.P + i * m + j]
        if model.root is not None or model.gravity is not None:
            fxi, fyi = fxi + frame_x * D[at.b + i], fyi + frame_y * D[at.b + i]
        if model.payload is not None:
            fxi, fyi = add_payload_lever(lane, model, i, tip_x, tip_y, fxi, fyi)
        fx[i] = fxi
        fy[i] = fyi
    if model.loads is not None:
        _subtract_load_forces(lane, model, u, fx, fy)
    # root rows: inertia force of the whole chain less all loads, N
    if model.root is not None:
        r[m + X] = frame_x * D[at.mass] + weighted_sum(lane, D, at.b, ex, m) + tip_x
        r[m + Y] = frame_y * D[at.mass] + weighted_sum(lane, D, at.b, ey, m) + tip_y
        if model.loads is not None:
            for f in range((size(model.n_inputs) - links) // OF_LOAD.end):
                at_load = links + OF_LOAD.end * f
                r[m + X] -= u[at_load + OF_LOAD.x]
                r[m + Y] -= u[at_load + OF_LOAD.y]
        # the root moves by -beta_j de_j with the angles: its force acts on them
        for i in range(m):
            fx[i] -= r[m + X] * D[at.beta + i]
            fy[i] -= r[m + Y] * D[at.beta + i]
        subtract_root_lever(lane, model, r, fx, fy)
    # moments on the nodes' angles: R phi'' + K (phi - phi_0 + tau_d phi') + (-sin phi, cos phi) . A
    for k in range(links):
        for i in range(k * n, k * n + n):
            total = z[k * n] * D[at.R + i * n]
            for j in range(1, n):
                total = total + z[k * n + j] * D[at.R + i * n + j]
            for j in range(n):
                total = total + x[k * n + j] * D[at.K_EI + i * n + j]
            r[i] = total + (c[i] * fy[i] - s[i] * fx[i])
    add_nonlinear_moments(lane, model, stiffness, q, r)
    if model.loads is not None:
        _subtract_load_torques(lane, model, u, r)
    _payload_turns(lane, model, par[PAYLOAD_INERTIA], z, r)
    # from nodes' angles to coordinates, T^T r: a moment on a link's first node acts on the tip node before it as well
    for k in range(links - 1, 0, -1):
        r[k * n - 1] += r[k * n]
    for k in range(links):
        r[k * n] -= u[k]


@unrolled
@kernel
def _tangent(lane, model, par: Lanes, q, on: Nodes, weights, S: Lanes):
    """Write S = weights.mass M + weights.damping C + weights.stiffness K of theory (5.2), row-major, model.n rows.

    # state     q: coordinates. on: `Nodes` as `_forces` leaves them, A_i = (fx, fy)
    # scratch   on.ex, on.ey: become (cm d/dphi'' + cc d/dphi' + ck d/dphi) of e_j''
    # out       S: by the coordinates; by the nodes' angles, before `_to_relative`, with n_i = (-sin phi_i, cos phi_i)
    #           S_ij = P_ij n_i . de_j'' + (ck + tau_d cc) K_ij + cm R_ij - (ck e_i^T A_i if i = j)

    cm, cc, ck: weights.mass, damping, stiffness. P are the masses with the payload, R the rotary inertia (kg m^2). K is
    the bending stiffness (N m) times the EI factor, e_j the unit tangent of node j in inertial axes."""
    cm, cc, ck = weights.mass, weights.damping, weights.stiffness
    y, c, s, ex, ey, fx, fy = on.rate, on.c, on.s, on.ex, on.ey, on.fx, on.fy
    D = model.data
    at = constants(model)
    n, links, rows = size(model.nodes), size(model.links), size(model.n)
    m = n * links
    payload, factor, tau_d = par[PAYLOAD_MASS], par[STIFFNESS_FACTOR], par[TAU_D]
    # weight of K: ck + tau_d cc, times the EI factor
    slope = factor * ck
    if model.damping is not None:
        slope = factor * viscoelastic_slope(None, tau_d, cc, ck)
    # e'' = phi'' n - phi'^2 e: by phi'' n, by phi' -2 phi' e, by phi e'' turned by a right angle
    for i in range(m):
        cosine, sine, ax, ay = c[i], s[i], ex[i], ey[i]
        twice = y[i] * (2.0 * cc)
        ex[i] = -(sine * cm + cosine * twice + ay * ck)
        ey[i] = cosine * cm - sine * twice + ax * ck
    mass = payload + D[at.mass]
    for i in range(m):
        share = payload * D[at.w + i]
        moment = share + D[at.b + i]
        ci, si, dxi, dyi = c[i], s[i], ex[i], ey[i]
        # steep: EI factor times (ck + tau_d s_k cc), s_k: link k's share of tau_d, where the links differ
        k = i // n
        steep = slope
        if model.damping is not None and not isinstance(model.damping, tuple):
            steep = factor * viscoelastic_slope(None, tau_d, model.damping[k] * cc, ck)
        # p: P_ij with the payload and, if the root moves, with the masses' motion by -beta_j e_j
        for j in range(i):
            p = D[at.P + i * m + j]
            if model.payload is not None:
                p = share * D[at.w + j] + D[at.P + i * m + j]
            if model.root is not None:
                rest = payload * D[at.w + j] + D[at.b + j] - mass * D[at.beta + j]
                p = p - (moment * D[at.beta + j] + rest * D[at.beta + i])
            # S_ij and S_ji: n_i . de_j'', n_j . de_i''
            lower = p * (ci * ey[j] - si * ex[j])
            upper = p * (c[j] * dyi - s[j] * dxi)
            if j >= k * n:
                bend = steep * D[at.K_EI + i * n + j - k * n] + cm * D[at.R + i * n + j - k * n]
                lower, upper = lower + bend, upper + bend
            S[i * rows + j] = lower
            S[j * rows + i] = upper
        # diagonal: also -e_i . A_i, the turn of n_i
        p = D[at.P + i * m + i]
        if model.payload is not None:
            p = share * D[at.w + i] + D[at.P + i * m + i]
        if model.root is not None:
            p = p - (moment + (moment - mass * D[at.beta + i])) * D[at.beta + i]
        own = p * (ci * dyi - si * dxi) + (steep * D[at.K_EI + i * n + i - k * n] + cm * D[at.R + i * n + i - k * n])
        S[i * rows + i] = own - (ci * fx[i] + si * fy[i]) * ck
    add_nonlinear_stiffness(lane, model, factor * ck, q, S)
    _payload_turns_tangent(lane, model, par[PAYLOAD_INERTIA], cm, S)
    _root_tangent(lane, model, payload, on, cm, S)
    add_offset_tangent(lane, model, payload, on, cm, S)
    _to_relative(lane, model, S)


@kernel
def _subtract_load_forces(lane, model, u: Lanes, fx: Lanes, fy: Lanes):
    """Subtract the point loads' forces (N, inertial axes; in u) times their arms (m) from the sums A_i (fx, fy; N m).

    The moment on node i is (-sin phi_i, cos phi_i) . A_i. arm_i of a load is the weight of node i's unit tangent e_i in
    the position of the load: r_load = r_root + sum_i arm_i e_i."""
    links, loads = size(model.links), model.loads
    m = links * size(model.nodes)
    for f in range((size(model.n_inputs) - links) // OF_LOAD.end):
        at, k = load_at(model, f), links + OF_LOAD.end * f
        force_x, force_y = u[k + OF_LOAD.x], u[k + OF_LOAD.y]
        for i in range(m):
            fx[i] -= force_x * loads[at.arm + i]
            fy[i] -= force_y * loads[at.arm + i]


@kernel
def _subtract_load_torques(lane, model, u: Lanes, r: Lanes):
    """Subtract from r_i (N m) the point loads' torques in u, times the weight of node i in the angle at the load."""
    links, loads = size(model.links), model.loads
    for f in range((size(model.n_inputs) - links) // OF_LOAD.end):
        at, torque = load_at(model, f), u[links + OF_LOAD.end * f + OF_LOAD.torque]
        for i in range(links * size(model.nodes)):
            r[i] -= torque * loads[at.angle + i]


@kernel
def _payload_turns(lane, model, inertia, z: Lanes, r: Lanes):
    """Add the moment of the payload's rotary inertia, J_p l(L) (l(L) . phi''), to the last link's rows of r (N m).

    inertia: rotary inertia J_p of the payload, kg m^2.
    z: second rates of all node angles. l(L) = DATA.tips: weights of node angles in the tip's angle."""
    D = model.data
    at = constants(model)
    if model.payload_turns is not None:
        n, m = size(model.nodes), size(model.links) * size(model.nodes)
        moment = 0.0
        for j in range(m - n, m):
            moment = moment + z[j] * D[at.tips + j]
        # J_p times the tip's angular acceleration, N m
        moment = moment * inertia
        for i in range(m - n, m):
            r[i] += moment * D[at.tips + i]


@kernel
def _payload_turns_tangent(lane, model, inertia, cm, S: Lanes):
    """Add the payload's rotary inertia, cm J_p l(L) l(L)^T, to the last link's block of S (row-major, node angles).

    inertia: rotary inertia J_p of the payload, kg m^2.
    cm: weight of the mass matrix in S. l(L) = DATA.tips: weights of the node angles in the tip's angle."""
    D = model.data
    at = constants(model)
    if model.payload_turns is not None:
        n, m, rows = size(model.nodes), size(model.links) * size(model.nodes), size(model.n)
        for i in range(m - n, m):
            share = inertia * (cm * D[at.tips + i])
            for j in range(m - n, m):
                S[i * rows + j] += share * D[at.tips + j]


@kernel
def _root_tangent(lane, model, payload, on: Nodes, cm, S: Lanes):
    """Write the last two rows and columns of S: x, y of the root, or of the center of mass in free flight.

    # state     payload: its mass, kg. on: `Nodes`, with the weighted derivatives de_j'' of e_j'' by phi_j in ex, ey
    # out       S[m + X, j] = moment_j de_j'', S[j, m + X] = cm moment_j n_j, S[m + X, m + X] = cm mass; the same for Y

    cm: weight of M; n_j = (-sin phi_j, cos phi_j).
    m: number of nodes. sum_j moment_j e_j (kg m), moment_j = payload w_j + b_j - mass beta_j, is the first moment about
    the point (x, y), 0 up to round-off about the center of mass. See docs/theory.md, (5.2)."""
    D = model.data
    at = constants(model)
    if model.root is not None:
        m, rows = size(model.links) * size(model.nodes), size(model.n)
        # coupling of angles with the root: rows of force (inertial axes), columns of moment, (m_p w_j + b_j - m beta_j)
        # de_j
        for j in range(m):
            moment = payload * D[at.w + j] + D[at.b + j] - (payload + D[at.mass]) * D[at.beta + j]
            S[(m + X) * rows + j] = moment * on.ex[j]
            S[(m + Y) * rows + j] = moment * on.ey[j]
            S[j * rows + m + X] = moment * on.s[j] * -cm
            S[j * rows + m + Y] = moment * on.c[j] * cm
        mass = (payload + D[at.mass]) * cm
        S[(m + X) * rows + m + X] = mass
        S[(m + X) * rows + m + Y] = 0.0
        S[(m + Y) * rows + m + X] = 0.0
        S[(m + Y) * rows + m + Y] = mass


@kernel
def _to_relative(lane, model, S: Lanes):
    """Transform S in place from the node angles to the coordinates, T^T S T.

    The angle of the first node of link k > 0 is the joint's angle plus phi of the previous link's tip node, whose row
    precedes. Therefore the column of each such first node is added to the preceding column, then its row to the
    preceding row."""
    n, rows = size(model.nodes), size(model.n)
    for k in range(size(model.links) - 1, 0, -1):
        # S <- T^T S T: columns of both nodes of a joint add, then rows
        for j in range(rows):
            o = j * rows + k * n
            S[o - 1] += S[o]
        for j in range(rows):
            o = k * n * rows + j
            S[o - rows] += S[o]


@kernel
def add_stiffness(lane, model, S: Lanes, k, x):
    """Add the stiffness x (N m/rad) to diagonal entry k of the dense matrix S. If x is None, fix coordinate k.

    If x is None, row and column k become those of the identity matrix."""
    rows = size(model.n)
    if x is None:
        for j in range(rows):
            S[k * rows + j] = 0.0
            S[j * rows + k] = 0.0
        S[k * rows + k] = 1.0
    else:
        at = k * rows + k
        S[at] += x


@unrolled
@kernel
def factor(lane, model, S: Lanes):
    """Factor the dense matrix S = L U in place, row-major, model.n rows, with 1 / U_kk on the diagonal; L_kk = 1.

    Rows are not exchanged, because the weighted mass matrix in S is positive definite and outweighs the other terms."""
    rows = size(model.n)
    for k in range(rows):
        inverse = 1.0 / S[k * rows + k]
        S[k * rows + k] = inverse
        # L_ik = S_ik / U_kk; row i less L_ik times row k
        for i in range(k + 1, rows):
            f = S[i * rows + k] * inverse
            S[i * rows + k] = f
            for j in range(k + 1, rows):
                S[i * rows + j] -= f * S[k * rows + j]


@unrolled
@kernel
def solve(lane, model, S: Lanes, x: Lanes):
    """Solve S y = x in place: y replaces the model.n entries of x. S contains the factors L U from `factor`."""
    rows = size(model.n)
    # L y = x, then U x = y with inverse diagonal
    for i in range(1, rows):
        total = x[i]
        for j in range(i):
            total = total - S[i * rows + j] * x[j]
        x[i] = total
    for i in range(rows - 1, -1, -1):
        total = x[i]
        for j in range(i + 1, rows):
            total = total - S[i * rows + j] * x[j]
        x[i] = total * S[i * rows + i]


def _residual(lane, model, par, q, v, a, u, r):
    """Write the residual r, with the fields of State as arguments, for `vjp_of`; r is passed as the unused S."""
    residual(lane, model, par, State(q, v, a), u, r, r)


def _solve(lane, model, S, x):
    """Solve S y = x in place: `solve` as a plain function, which `vjp_of` can differentiate."""
    solve(lane, model, S, x)


_vjp_solve = vjp_of(_solve, ("x",))  # straight-line code, as both are no kernels
_vjp_residual = vjp_of(_residual, ("par", "q", "v", "a", "u", "r"))


@kernel
def solve_transposed(lane, model, S, x):
    """Solve S^T y = x in place, with the factors from `factor`; it is the reverse derivative of the linear `solve`."""
    _vjp_solve(lane, model, S, x, x)


@kernel
def vjp_residual(lane, model, par, par_bar, state, u, S, bar, u_bar, r_bar):
    """Add the cotangents from r_bar to par_bar, bar (a `State`) and u_bar; then set r_bar to 0.

    The function is the reverse derivative of `residual`. A cotangent is the derivative of a scalar: r_bar by the
    residual, par_bar by the arm's parameters par, bar by q, v, a, u_bar by the inputs u. S is not used."""
    q, v, a = state
    _vjp_residual(lane, model, par, q, v, a, u, S, par_bar, bar.q, bar.v, bar.a, u_bar, r_bar)


register(
    Elastica, assemble, residual, add_stiffness, factor, solve, input_displacements, damping_power,
    energy, link_poses, centerline, solve_transposed, vjp_residual,
)  # fmt: skip
