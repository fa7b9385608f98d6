"""Optional terms of the elastica: curved links, a nonlinear law of M, a payload with an eccentric center of mass.

See docs/theory.md, section 5. The vector from the root to an eccentric payload is sum_j w_j E_j. The unit tangents are
complex numbers, E_j = exp(i phi_j), with real part x and imaginary part y in inertial axes. The weights w_j = along_j +
i across_j (m) are complex. For a payload at the tip they are real. The payload's force A acts on node i as conj(w_i) A,
and the matrix P_ij of the chain's masses receives m_p conj(w_i) w_j. If the root moves with the center of mass, beta is
complex as well.
"""

from __future__ import annotations

from ...compiler import Lanes, kernel, size, stack
from ..materials import bending
from .chain import constants
from .layout import OWN, Nodes, X, Y, bends_at, eccentric_at, node_angles, weighted_sum


@kernel
def subtract_rest_angles(lane, model, x: Lanes):
    """Subtract from the nodes' angles x (rad) their stress-free values, measured from their link's root.

    Do nothing if all links are straight.
    """
    if model.rest is not None:
        for i in range(_nodes(model)):
            x[i] -= model.rest[i]


@kernel
def _nodes(model):
    """Return the total number of nodes of all links."""
    return size(model.links) * size(model.nodes)


@kernel
def payload_position(lane, model, x, y):
    """Return the vector from the root to the payload's center of mass (m, inertial axes): sum_j w_j (x_j + i y_j).

    (x_j, y_j): unit tangent of node j. w_j = along_j + i across_j, m: complex weights from `ECCENTRIC`, or the real
    weights DATA.w if the payload is at the tip. Given first or second rates of the tangents, the function returns the
    same rates of the vector.
    """
    m, D = _nodes(model), model.data
    if model.eccentric is None:
        at = constants(model)
        return weighted_sum(lane, D, at.w, x, m), weighted_sum(lane, D, at.w, y, m)
    # complex product with w_j = along_j + i across_j
    own, eccentric = eccentric_at(0, m), model.eccentric
    along_x, along_y = weighted_sum(lane, eccentric, own.along, x, m), weighted_sum(lane, eccentric, own.along, y, m)
    across_x, across_y = (
        weighted_sum(lane, eccentric, own.across, y, m),
        weighted_sum(lane, eccentric, own.across, x, m),
    )
    return along_x - across_x, along_y + across_y


@kernel
def add_payload_lever(lane, model, i, force_x, force_y, x, y):
    """Return (x, y) + conj(w_i) F: the sum A_i (N m) of node i, plus the force F (N, inertial axes) on the payload.

    (x, y): A_i without F. The moment on node i is (-sin phi_i, cos phi_i) . A_i.
    w_i (m): complex weight of the node's unit tangent in the vector from the root to the payload; real for a payload at
    the tip. Vectors are written as complex numbers x + i y.
    """
    if model.eccentric is None:
        w = constants(model).w + i
        return x + force_x * model.data[w], y + force_y * model.data[w]
    own, eccentric = eccentric_at(0, _nodes(model)), model.eccentric
    along, across = eccentric[own.along + i], eccentric[own.across + i]
    return x + (force_x * along + force_y * across), y + (force_y * along - force_x * across)


@kernel
def root_position(lane, model, q: Lanes, x, y):
    """Return the root's position (m, inertial axes): the last two rows of q, minus sum_j beta_j (x_j + i y_j).

    (x_j, y_j): unit tangent of node j.
    beta_j (m): real weight from DATA; for an eccentric payload it also has the imaginary part ECCENTRIC.beta. With
    rates of q and of the tangents the function returns the root's velocity, with second rates the root's acceleration.
    """
    D, m, at = model.data, _nodes(model), constants(model)
    root_x = q[m + X] - weighted_sum(lane, D, at.beta, x, m)
    root_y = q[m + Y] - weighted_sum(lane, D, at.beta, y, m)
    if model.eccentric is None:
        return root_x, root_y
    # imaginary part of beta: less i beta_j (x_j + i y_j)
    own, eccentric = eccentric_at(0, m), model.eccentric
    return root_x + weighted_sum(lane, eccentric, own.beta, y, m), root_y - weighted_sum(
        lane, eccentric, own.beta, x, m
    )


@kernel
def subtract_root_lever(lane, model, r: Lanes, fx: Lanes, fy: Lanes):
    """Subtract from the sums A_i (fx, fy; N m) the part of conj(beta_i) F that stems from the imaginary part of beta.

    F: force on the root, the last two rows of r (N, inertial axes).
    beta_i (m): complex weight of node i's unit tangent in the root's position x - sum_i beta_i e_i. The caller
    subtracts the real part. Without an eccentric payload, do nothing.
    """
    if model.eccentric is not None:
        m = _nodes(model)
        own, eccentric = eccentric_at(0, m), model.eccentric
        for i in range(m):
            beta = eccentric[own.beta + i]
            fx[i] -= r[m + Y] * beta
            fy[i] += r[m + X] * beta


@kernel
def _bending_law(lane, model, g, x):
    """Return kappa - kappa_0 (1/m) at quadrature point g, and its law of M as an `Answer`: f, f', 2 int f, over EI.

    x: node angles minus their stress-free values, rad. kappa: curvature. kappa_0: curvature without stress.
    """
    m = _nodes(model)
    at = bends_at(0, size(model.points), m)
    kappa = weighted_sum(lane, model.bends, at.slope + g * m, x, m)
    return kappa, bending(kappa, 1.0, model.bends[at.own + OWN * g :])


@kernel
def add_nonlinear_moments(lane, model, factor, q, r: Lanes):
    """Add to r (N m), in the rows of node angles, the moments of a nonlinear law M(kappa) in excess of EI kappa.

    factor: the arm's own factor on EI.
    q: coordinates of the arm. r already contains the moments of EI kappa. For a linear law, do nothing.
    """
    if model.bends is not None:
        x, m = stack(lane, model.scratch), _nodes(model)
        node_angles(lane, model, q, x)
        subtract_rest_angles(lane, model, x)
        at = bends_at(0, size(model.points), m)
        # sum_g weight_g EI (f(kappa) - kappa) dkappa/dphi_i
        for g in range(size(model.points)):
            kappa, answer = _bending_law(lane, model, g, x)
            moment = (answer.force - kappa) * (factor * model.bends[at.EI + g])
            for i in range(m):
                r[i] += moment * model.bends[at.slope + g * m + i]


@kernel
def add_nonlinear_stiffness(lane, model, factor, q, S: Lanes):
    """Add to S (row-major, node angles) the stiffness of a nonlinear law M(kappa) in excess of EI; 0 for a linear law.

    factor: product of the arm's own factor on EI and the weight of the stiffness in the matrix.
    q: coordinates of the arm. See docs/theory.md, section 5, "Eccentric payload".
    """
    if model.bends is not None:
        x, m, rows = stack(lane, model.scratch), _nodes(model), size(model.n)
        node_angles(lane, model, q, x)
        subtract_rest_angles(lane, model, x)
        at = bends_at(0, size(model.points), m)
        # sum_g weight_g EI (f'(kappa) - 1) dkappa/dphi_i dkappa/dphi_j
        for g in range(size(model.points)):
            _, answer = _bending_law(lane, model, g, x)
            slope = (answer.slope - 1.0) * (factor * model.bends[at.EI + g])
            for i in range(m):
                for j in range(m):
                    more = slope * (model.bends[at.slope + g * m + i] * model.bends[at.slope + g * m + j])
                    S[i * rows + j] += more


@kernel
def nonlinear_strain_energy(lane, model, x):
    """Return the strain energy (J) of a nonlinear law M(kappa) in excess of 1/2 int EI kappa^2 ds, with EI factor 1.

    x: node angles minus their stress-free values, rad. The result is 0 for a linear law.
    """
    total = 0.0
    if model.bends is not None:
        at = bends_at(0, size(model.points), _nodes(model))
        for g in range(size(model.points)):
            kappa, answer = _bending_law(lane, model, g, x)
            total = total + (answer.energy - kappa * kappa) * (0.5 * model.bends[at.EI + g])
    return total


@kernel
def _product(a, b, c, d):
    """Return the real and the imaginary part of conj(a + i b) (c + i d)."""
    return a * c + b * d, a * d - b * c


@kernel
def add_offset_tangent(lane, model, payload, on: Nodes, cm, S: Lanes):
    """Add to S (row-major, node angles, root) the terms of an eccentric payload beyond those of a payload at the tip.

    # model     payload: the payload's mass, kg. cm: weight of the mass matrix M
    # state     on: `Nodes` with the unit tangents e_j in (c, s) and the weighted derivative of e_j'' in (ex, ey)
    # out       S[i, j] += Re p_ij d + Im p_ij d', where d and d' are the parts of that derivative across and along e_i

    p_ij (kg m^2) is the complex coefficient of masses minus the real coefficient that is in S already. The complex
    coefficient is conj(w_i) w_j m_p plus, if the root moves, the terms of beta.
    w_j (m): complex weight of e_j in the payload's position from the root; -beta_j (m): complex weight of e_j in the
    root's position. Do nothing without an eccentric payload. See docs/theory.md, section 5, "Eccentric payload".
    """
    if model.eccentric is not None:
        D, m, rows = model.data, _nodes(model), size(model.n)
        at, own, eccentric = constants(model), eccentric_at(0, m), model.eccentric
        whole = payload + D[at.mass]
        for i in range(m):
            ai, di, bi = eccentric[own.along + i], eccentric[own.across + i], eccentric[own.beta + i]
            wi, gi = D[at.w + i], D[at.beta + i]
            ci, si, dxi, dyi = on.c[i], on.s[i], on.ex[i], on.ey[i]
            # p_ij = m_p (conj(w_i) w_j - the product of the tip's real weights)
            for j in range(i + 1):
                aj, dj, bj = eccentric[own.along + j], eccentric[own.across + j], eccentric[own.beta + j]
                wj, gj = D[at.w + j], D[at.beta + j]
                real, aside = _product(ai, di, aj, dj)
                real, aside = payload * (real - wi * wj), payload * aside
                if model.root is not None:
                    # less (conj(moment_i) beta_j + conj(beta_i) (moment_j - mass beta_j)), but for real products in S
                    real = real - payload * (ai * gj + di * bj - wi * gj + gi * aj + bi * dj - gi * wj)
                    aside = aside - payload * (ai * bj - di * gj + gi * dj - bi * aj)
                    aside = aside - (D[at.b + i] * bj - bi * D[at.b + j])
                    real, aside = real + whole * (bi * bj), aside + whole * (gi * bj - bi * gj)
                # S_ij with p_ij, S_ji with its conjugate
                dxj, dyj = on.ex[j], on.ey[j]
                lower = real * (ci * dyj - si * dxj) + aside * (ci * dxj + si * dyj)
                S[i * rows + j] += lower
                if j < i:
                    cj, sj = on.c[j], on.s[j]
                    upper = real * (cj * dyi - sj * dxi) - aside * (cj * dxi + sj * dyi)
                    S[j * rows + i] += upper
        # root: complex moment_j = m_p w_j + b_j - mass beta_j, less the real part that S holds already
        if model.root is not None:
            for j in range(m):
                real = payload * (eccentric[own.along + j] - D[at.w + j])
                aside = payload * eccentric[own.across + j] - whole * eccentric[own.beta + j]
                dx, dy, c, s = on.ex[j], on.ey[j], on.c[j], on.s[j]
                # force rows: moment_j de_j''
                x, y = (m + X) * rows + j, (m + Y) * rows + j
                S[x] += real * dx - aside * dy
                S[y] += real * dy + aside * dx
                # moment columns: cm n_j . conj(moment_j) along x and y
                x, y = j * rows + m + X, j * rows + m + Y
                S[x] -= (real * s + aside * c) * cm
                S[y] += (real * c - aside * s) * cm
