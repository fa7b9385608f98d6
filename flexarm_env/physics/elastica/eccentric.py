"""What not all chains of the elastica have: links that are bent without stress, a law of M that is not EI kappa, a
payload whose centre of mass is not at the tip (docs: theory, sections "Elastica" and "Links").

The way from the root to it is sum w_j E_j, with the unit tangents as complex numbers, E_j = exp(i phi_j), and weights
w_j = along_j + i across_j: what is real elsewhere is complex. Its force A acts on node i as conj(w_i) A, and the matrix
P_ij of the chain's masses gets m_p conj(w_i) w_j. Where the root moves with the centre of mass beta is complex as well.
"""

from ...compiler import kernel, load, size, splat, stack, store
from ..materials import bending
from .layout import OWN, X, Y, bends_at, constants, eccentric_at, node_angles, weighted


@kernel
def less_rest(lane, model, x):
    """x <- the nodes' angles less those which they have without stress."""
    if model.rest is not None:
        for i in range(_nodes(model)):
            store(x, i, load(lane, x, i) - model.rest[i])


@kernel
def _nodes(model):
    return size(model.links) * size(model.nodes)


@kernel
def payload_at(lane, model, x, y):
    """Way to the payload's centre from the root, of unit tangents (x, y); or its rates, of theirs."""
    m, D = _nodes(model), model.data
    if model.eccentric is None:
        at = constants(model)
        return weighted(lane, D, at.w, x, m), weighted(lane, D, at.w, y, m)
    own, eccentric = eccentric_at(0, m), model.eccentric
    along_x, along_y = weighted(lane, eccentric, own.along, x, m), weighted(lane, eccentric, own.along, y, m)
    across_x, across_y = weighted(lane, eccentric, own.across, y, m), weighted(lane, eccentric, own.across, x, m)
    return along_x - across_x, along_y + across_y


@kernel
def with_payload(lane, model, i, force_x, force_y, x, y):
    """(x, y) with what a force on the payload is worth at node i."""
    if model.eccentric is None:
        w = constants(model).w + i
        return x + force_x * model.data[w], y + force_y * model.data[w]
    own, eccentric = eccentric_at(0, _nodes(model)), model.eccentric
    along, across = eccentric[own.along + i], eccentric[own.across + i]
    return x + (force_x * along + force_y * across), y + (force_y * along - force_x * across)


@kernel
def root_of(lane, model, q, x, y):
    """The root, from the last rows of q and unit tangents (x, y); or its rates, from theirs."""
    D, m, at = model.data, _nodes(model), constants(model)
    root_x = load(lane, q, m + X) - weighted(lane, D, at.beta, x, m)
    root_y = load(lane, q, m + Y) - weighted(lane, D, at.beta, y, m)
    if model.eccentric is None:
        return root_x, root_y
    own, eccentric = eccentric_at(0, m), model.eccentric
    return root_x + weighted(lane, eccentric, own.beta, y, m), root_y - weighted(lane, eccentric, own.beta, x, m)


@kernel
def less_root_aside(lane, model, r, fx, fy):
    """A_i <- A_i less what the root's force is worth by the part of beta across."""
    if model.eccentric is not None:
        m = _nodes(model)
        own, eccentric = eccentric_at(0, m), model.eccentric
        for i in range(m):
            beta = eccentric[own.beta + i]
            store(fx, i, load(lane, fx, i) - load(lane, r, m + Y) * beta)
            store(fy, i, load(lane, fy, i) + load(lane, r, m + X) * beta)


@kernel
def _answer(lane, model, g, x):
    """kappa at a point of quadrature, and what the law of M answers it with; x: as `less_rest` leaves it."""
    m = _nodes(model)
    at = bends_at(0, size(model.points), m)
    kappa = weighted(lane, model.bends, at.slope + g * m, x, m)
    return kappa, bending(kappa, 1.0, model.bends[at.own + OWN * g :])


@kernel
def more_moments(lane, model, factor, q, r):
    """r of nodes' angles with what M is beyond EI kappa; factor: on EI."""
    if model.bends is not None:
        x, m = stack(lane, model.scratch), _nodes(model)
        node_angles(lane, model, q, x)
        less_rest(lane, model, x)
        at = bends_at(0, size(model.points), m)
        for g in range(size(model.points)):
            kappa, answer = _answer(lane, model, g, x)
            moment = (answer.force - kappa) * (factor * model.bends[at.stiffness + g])
            for i in range(m):
                store(r, i, load(lane, r, i) + moment * model.bends[at.slope + g * m + i])


@kernel
def more_slopes(lane, model, factor, q, S):
    """S of nodes' angles likewise; factor: on EI, times the weight of K."""
    if model.bends is not None:
        x, m, rows = stack(lane, model.scratch), _nodes(model), size(model.n)
        node_angles(lane, model, q, x)
        less_rest(lane, model, x)
        at = bends_at(0, size(model.points), m)
        for g in range(size(model.points)):
            _, answer = _answer(lane, model, g, x)
            slope = (answer.slope - 1.0) * (factor * model.bends[at.stiffness + g])
            for i in range(m):
                for j in range(m):
                    more = slope * (model.bends[at.slope + g * m + i] * model.bends[at.slope + g * m + j])
                    store(S, i * rows + j, load(lane, S, i * rows + j) + more)


@kernel
def more_energy(lane, model, x):
    """Strain energy that M has beyond EI kappa, per factor on EI; x: as `less_rest` leaves it."""
    total = splat(lane, 0.0)
    if model.bends is not None:
        at = bends_at(0, size(model.points), _nodes(model))
        for g in range(size(model.points)):
            kappa, answer = _answer(lane, model, g, x)
            total = total + (answer.energy - kappa * kappa) * (0.5 * model.bends[at.stiffness + g])
    return total


@kernel
def _product(a, b, c, d):
    """conj(a + i b) (c + i d)."""
    return a * c + b * d, a * d - b * c


@kernel
def tangent_aside(lane, model, payload, on, cm, S):
    """S of nodes' angles with what the payload's place adds to one at the tip; on: as `equations._tangent` leaves it.

    With m complex p_ij for the real ones there: Re p d + Im p d', d and d' the parts of E_j's derivative across and
    along E_i.
    """
    if model.eccentric is not None:
        D, m, rows = model.data, _nodes(model), size(model.n)
        at, own, eccentric = constants(model), eccentric_at(0, m), model.eccentric
        whole = payload + D[at.mass]
        for i in range(m):
            ai, di, bi = eccentric[own.along + i], eccentric[own.across + i], eccentric[own.beta + i]
            wi, gi = D[at.w + i], D[at.beta + i]
            ci, si, dxi, dyi = load(lane, on.c, i), load(lane, on.s, i), load(lane, on.ex, i), load(lane, on.ey, i)
            for j in range(i + 1):
                aj, dj, bj = eccentric[own.along + j], eccentric[own.across + j], eccentric[own.beta + j]
                wj, gj = D[at.w + j], D[at.beta + j]
                real, aside = _product(ai, di, aj, dj)
                real, aside = payload * (real - wi * wj), payload * aside
                if model.root is not None:
                    # less conj(moment_i) beta_j and conj(beta_i) (moment_j - mass beta_j), but for what is there
                    real = real - payload * (ai * gj + di * bj - wi * gj + gi * aj + bi * dj - gi * wj)
                    aside = aside - payload * (ai * bj - di * gj + gi * dj - bi * aj)
                    aside = aside - (D[at.b + i] * bj - bi * D[at.b + j])
                    real, aside = real + whole * (bi * bj), aside + whole * (gi * bj - bi * gj)
                dxj, dyj = load(lane, on.ex, j), load(lane, on.ey, j)
                lower = real * (ci * dyj - si * dxj) + aside * (ci * dxj + si * dyj)
                store(S, i * rows + j, load(lane, S, i * rows + j) + lower)
                if j < i:
                    cj, sj = load(lane, on.c, j), load(lane, on.s, j)
                    upper = real * (cj * dyi - sj * dxi) - aside * (cj * dxi + sj * dyi)
                    store(S, j * rows + i, load(lane, S, j * rows + i) + upper)
        if model.root is not None:
            for j in range(m):
                real = payload * (eccentric[own.along + j] - D[at.w + j])
                aside = payload * eccentric[own.across + j] - whole * eccentric[own.beta + j]
                dx, dy, c, s = load(lane, on.ex, j), load(lane, on.ey, j), load(lane, on.c, j), load(lane, on.s, j)
                x, y = (m + X) * rows + j, (m + Y) * rows + j
                store(S, x, load(lane, S, x) + (real * dx - aside * dy))
                store(S, y, load(lane, S, y) + (real * dy + aside * dx))
                x, y = j * rows + m + X, j * rows + m + Y
                store(S, x, load(lane, S, x) - (real * s + aside * c) * cm)
                store(S, y, load(lane, S, y) + (real * c - aside * s) * cm)
