"""One geometrically exact element, theory (5.1): forces, tangent, condensation, energy, for each polynomial order.

An element of order p and length l joins two vertices (x, y, psi). The p - 1 interior functions of an element vanish at
both ends and have the Legendre polynomials P_1 ... P_{p-1} (scaled to a largest value of 1 at the Gauss points) as
derivatives. Linear and interior functions span the space of p + 1 Lagrange nodes. With their amplitudes as interior
coordinates the bending stiffness is diagonal and the sums below are short. With d = l r' (twice the derivative on [-1,
1]), inertial axes, (c, s) = (cos psi, sin psi) and g = (c d_x + s d_y, -s d_x + c d_y), section axes, all in m, the
strains are Gamma_1 = g_1/l - 1, Gamma_2 = g_2/l, kappa = psi', and with p Gauss points of weights w the energy is

    sum_g w/2 [EA_2l (g_1 - l)^2 + C_2l g_2^2 + EI_2l (l kappa)^2],   EA_2l = EA/2l, C_2l = C/2l, EI_2l = EI/2l.

The laws of `materials` replace the squares. Inertia: ml = m l/2, jl = J l/2. If sections vary within the element
(`layout.Varying`), EA_2l and C_2l differ between points, and bending and inertia have full matrices (`constants`).
Arrays of coordinates begin at the left vertex (`layout.ELEMENT`); lists of nodes have the order left, right, interior.
The argument `order` is a tuple of p zeros. All functions run when a kernel is compiled; `compiler.trace` records their
operations on values."""

from typing import Any, NamedTuple

from ...compiler import Lanes, kernel, sincos, traced
from ..arithmetic import load_pair, rotate_2d, rotate_back_2d, store_pair
from ..materials import bending, normal, shear, viscoelastic, viscoelastic_slope
from .constants import (
    bending_at,
    bending_entries,
    dot,
    inertia_entries,
    inertia_row,
    length_of,
    materials,
    moments_of,
    unbent,
)
from .layout import AXES, ELEMENT, ELEMENT_FACTORS, PAIR, T, Vertex, X, Y
from .tables import Sums, Tables, slopes, tables, times, values_at

RATE, ACCELERATION, FORCE, VERTEX = (AXES * k for k in range(1, 5))
"""Offsets of the fields of a `Vertex`, three numbers each, in the list that `forces` returns, and the end offset."""


class Point(NamedTuple):
    """State and section forces at a Gauss point, computed by `forces` and used by `tangent`."""

    c: Any  # cosine of the section angle psi
    s: Any  # sine of the section angle psi
    g1: Any  # m, l (1 + Gamma_1): component of l r' along the section's normal
    g2: Any  # m, l Gamma_2: component of l r' in the section's plane
    n1: Any  # N, normal force times w/2 (w: Gauss weight), including damping
    n2: Any  # N, shear force times w/2 (w: Gauss weight)
    bent: Any  # rad, l (kappa - kappa_0) for a nonlinear law M(kappa); otherwise 0


POINT = len(Point._fields)


@kernel
def element_result(out):
    """Return the right `Vertex` and the flat list of `Point` fields, parts of the list that `forces` returns."""
    return Vertex(out[:RATE], out[RATE:ACCELERATION], out[ACCELERATION:FORCE], out[FORCE:VERTEX]), out[VERTEX:]


def _at(node: int, order: int) -> int:
    """Return the row offset of coordinate x of a node in an element; node 0: left, 1: right vertex, 2 ...: interior."""
    at = ELEMENT.offsets(0, order)
    return int((at.left, at.right)[node] if node < 2 else at.interior + AXES * (node - 2))


def _axis(lane: Any, x: Lanes, order: int, axis: int, left: Any = None) -> list[Any]:
    """Load one coordinate (axis X, Y or T) of left, right, interior nodes; `left`, if not None, replaces the first."""
    first = x[_at(0, order) + axis] if left is None else left
    return [first, *(x[_at(node, order) + axis] for node in range(1, order + 1))]


def _nodes(lane: Any, x: Lanes, order: int, left: Any) -> list[list[Any]]:
    """Load the lists of x, y and psi of all nodes; left: (x, y, psi) of the left vertex, or None to load it from x."""
    return [_axis(lane, x, order, k, left[k]) for k in (X, Y, T)]


def _strain_rates(at: Any, ux: Any, uy: Any, omega: Any) -> tuple[Any, Any]:
    """Return the rates of g_1, g_2 (m/s, section axes). ux, uy: rate of d. omega: rate of psi; at: (c, s, g_1, g_2)."""
    c, s, g1, g2, *_ = at
    r1, r2 = rotate_back_2d(c, s, ux, uy)
    return r1 + g2 * omega, r2 - g1 * omega


def _momenta(sums: Sums, t: Tables, section: Any, nodes: list[Any], axis: int) -> tuple[list[Any], Any, Any]:
    """Multiply the mass matrix of one axis by `nodes` (left, right, interior values).
    Return the interior rows of the product, and (right + left)/2 and (right - left)/2 of its vertex rows."""
    if not hasattr(section, "ml"):
        all_of = [dot(inertia_row(section, len(nodes) - 1, axis, n), nodes) for n in range(len(nodes))]
        return all_of[2:], (all_of[0] + all_of[1]) * 0.5, (all_of[1] - all_of[0]) * 0.5
    # int m a_k g_i: symmetric functions g act on left + right, antisymmetric ones on right - left
    m, unit = t.mass, section.jl if axis == T else section.ml
    both, across = nodes[0] + nodes[1], nodes[1] - nodes[0]
    even, odd = [both, *nodes[2::2]], [across, *nodes[3::2]]
    inner = range(2, len(nodes))
    rows = [sums([m[n, int(n % 2)], *m[n, 2 + n % 2 :: 2]], odd if n % 2 else even, 1.0, unit) for n in inner]
    mean = sums([0.5 * (m[0, 0] + m[0, 1]), *m[0, 2::2]], even, 1.0, unit)
    return rows, mean, sums([0.5 * (m[1, 1] - m[0, 1]), *m[1, 3::2]], odd, 1.0, unit)


@traced
def momentum(lane, order, a, left, section, r: Lanes):
    """Write r = M a of an element to its left vertex's and interior rows of r: forces (inertial axes), moment on psi.

    left: acceleration (x, y, psi) and present r of the left vertex. Returns these six numbers of the right vertex."""
    p, sums = len(order), Sums()
    t = tables(p)
    ends, rest = [], []
    for k, nodes in enumerate(_nodes(lane, a, p, left)):
        rows, mean, half = _momenta(sums, t, section, nodes, k)
        r[k] = left[AXES + k] + (mean - half)
        for n, row in enumerate(rows, 2):
            r[_at(n, p) + k] = row
        ends.append(nodes[1])
        rest.append(mean + half)
    return [*ends, *rest]


def _nonlinear_bending(sums: Sums, t: Tables, bent: list[Any]) -> list[Any]:
    """Return l (kappa - kappa_0) (rad) at each Gauss point for a nonlinear law M(kappa); zeros for M = EI kappa."""
    return [0.0] * len(t.weights) if bending is None else [sums(column, bent) for column in t.slope.T]


def _nonlinear_part(section: Any, t: Tables, bends: list[Any], part: Any) -> list[Any]:
    """Return part(l kappa, `Answer`) EI_2l w (N m) at each Gauss point for nonlinear laws M; [] for M = EI kappa."""
    if bending is None:
        return []
    found = []
    for w, e, (EI_2l, own) in zip(t.weights, bends, bending_at(section, len(bends)), strict=True):
        found.append(part(e, bending(e, length_of(section), own)) * (EI_2l * float(w)))
    return found


@traced
def section_directions(lane, order, q, psi, circle):
    """Write (sine, cosine) of the section angle at each Gauss point to circle. psi: angle of the left end, rad."""
    p, sums = len(order), Sums()
    t = tables(p)
    nodes = _axis(lane, q, p, T, psi)
    for g, angle in enumerate(values_at(sums, t, nodes, nodes[1] - nodes[0])):
        s, c = sincos(angle)
        store_pair(lane, circle, PAIR * g, (s, c))


@traced
def forces(lane, order, gravity, state, left, section, r: Lanes, circle):
    """Write the rows M a + f(q, v) of an element's left vertex and interior to r: N (inertial axes) and N m.

    gravity: m/s^2, or None. state: q, v, a from the left vertex on. left: `Vertex`. circle: (sine, cosine) of psi at
    the Gauss points. section: constants of the element (`Section` or `Varying`). Returns one list: the right
    `Vertex`, with the element's force on it, then a `Point` for each Gauss point. See docs/theory.md, (5.1)."""
    p, sums = len(order), Sums()
    t, tau = tables(p), section.tau
    place = _nodes(lane, state.q, p, left.place)
    inertia = _nodes(lane, state.a, p, left.acceleration)
    # x, y of the left vertex come as a - g already; the other nodes' a is reduced here
    if gravity is not None:
        for k in (X, Y):
            inertia[k][1] = inertia[k][1] - gravity[k]
    # d = (x', y') in section axes, Gamma + e_1 times l; psi' and, with damping, the rates (5.1)
    rate = [[0.0] * (p + 1)] * 3
    if tau is not None:
        rate = _nodes(lane, state.v, p, left.rate)
        ux, uy = (slopes(sums, t, rate[k])[1] for k in (X, Y))
        turning = rate[T][1] - rate[T][0]
        omega = values_at(sums, t, rate[T], turning)
    dx, dy = (slopes(sums, t, place[k])[1] for k in (X, Y))
    bent = unbent(section, [place[T][1] - place[T][0], *place[T][2:]])
    points, fx, fy, moment = list[Any](), list[Any](), list[Any](), list[Any]()
    length, kappa = length_of(section), _nonlinear_bending(sums, t, bent)
    for g, (EA_2l, C_2l, own) in enumerate(materials(section, p)):
        s, c = load_pair(lane, circle, PAIR * g)
        g1, g2 = rotate_back_2d(c, s, dx[g], dy[g])
        e1, e2 = normal(g1 - length, length, own).force, shear(g2, length, own).force
        if tau is not None:
            r1, r2 = _strain_rates((c, s, g1, g2), ux[g], uy[g], omega[g])
            e1, e2 = viscoelastic(e1, r1, tau), viscoelastic(e2, r2, tau)
        # N, Q turned from section to inertial axes; moment on psi by dg_1/dpsi = g_2, dg_2/dpsi = -g_1
        w = float(t.weights[g])
        n1, n2 = e1 * times(EA_2l, w), e2 * times(C_2l, w)
        x, y = rotate_2d(c, s, n1, n2)
        fx.append(x)
        fy.append(y)
        moment.append(n1 * g2 - n2 * g1)
        points += Point(c, s, g1, g2, n1, n2, kappa[g])
    beyond = _nonlinear_part(section, t, kappa, lambda e, of: of.force - e)
    if tau is not None:
        bent = [viscoelastic(x, y, tau) for x, y in zip(bent, [turning, *rate[T][2:]], strict=True)]
    # r of all nodes: int m a g_i + int n g_i', inertial axes for x and y
    force = []
    for k in (X, Y, T):
        rows, mean, half = _momenta(sums, t, section, inertia[k], k)
        if k != T:
            pull = [sums(row, fx if k == X else fy) for row in t.slope]
        else:
            pull = moments_of(section, t, bent)
            if bending is not None:
                pull = [x + sums(row, beyond) for x, row in zip(pull, t.slope, strict=True)]
            mean = mean + sums([0.5] * p, moment)
            half = half + sums(0.5 * (t.value[1] - t.value[0]), moment) if p > 1 else half
            rows = [row + sums(t.value[n], moment) for n, row in enumerate(rows, 2)]
        half = half + pull[0]
        force.append([mean - half, mean + half, *[row + x for row, x in zip(rows, pull[1:], strict=True)]])
    for k in (X, Y, T):
        r[k] = left.force[k] + force[k][0]
        for n in range(2, p + 1):
            r[_at(n, p) + k] = force[k][n]
    return [x[k][1] for x in (place, rate, inertia, force) for k in (X, Y, T)] + points


@traced
def tangent(lane, order, points, section, weights, S: Lanes):
    """Write the factors of the interior block, its couplings to both vertices, and the condensed matrix to S.

    The element's matrix is weights.mass M + weights.damping C + weights.stiffness K. points: `Point` fields that
    `forces` returned. S: `layout.ELEMENT_FACTORS`. Entries are computed at their first use, which saves registers."""
    p, sums = len(order), Sums()
    t = tables(p)
    ck, tau, length = weights.stiffness, section.tau, length_of(section)
    share = viscoelastic_slope(None, tau, weights.damping, ck)
    # derivatives by d_x, d_y (inertial axes), psi: material, geometric; without d(strain rate)/dq
    h: list[list[Any]] = [[] for _ in range(6)]  # xx xy yy xt yt tt
    for g, (EA_2l, C_2l, own) in enumerate(materials(section, p)):
        c, s, g1, g2, n1, n2, _ = points[POINT * g : POINT * (g + 1)]
        w = float(t.weights[g])
        answers = normal(g1 - length, length, own), shear(g2, length, own)
        c1, c2 = (viscoelastic_slope(answer.slope, tau, weights.damping, ck) for answer in answers)
        EA_2l, C_2l = EA_2l * c1, C_2l * c2
        j1, j2, both = times(EA_2l, w), times(C_2l, w), times(EA_2l + C_2l, w)
        part = c * times(EA_2l - C_2l, w)
        hxx = part * c + j2
        across, along = g2 * j1 - n2 * ck, g1 * j2 - n1 * ck
        entries = (hxx, part * s, both - hxx, c * across + s * along, s * across - c * along, g2 * across + g1 * along)
        for kind, entry in zip(h, entries, strict=True):
            kind.append(entry)
    bends, inertia = bending_entries(section, t, share), inertia_entries(section, t, weights.mass)
    beyond = _nonlinear_part(
        section, t, [points[POINT * g + POINT - 1] for g in range(p)], lambda e, of: (of.slope - 1.0) * ck
    )

    def slope(node: int) -> Any:
        return -t.slope[0] if node == 0 else t.slope[max(node - 1, 0)]

    def weighted(one: tuple[int, int], two: tuple[int, int]) -> Any:
        """Return the entry of the weighted matrix before condensation. one, two: coordinates (node, axis)."""
        (n1, a1), (n2, a2) = (one, two) if one[1] <= two[1] else (two, one)
        if a2 != T:
            value = sums(slope(n1) * slope(n2), h[a1 + a2])
            mass = inertia(n1, n2, a1) if a1 == a2 else None
            return value if mass is None else value + mass
        if a1 != T:
            return sums(slope(n1) * t.value[n2], h[3 + a1])
        value = sums(t.value[n1] * t.value[n2], h[5])
        bend, mass = bends(n1, n2), inertia(n1, n2, T)
        if bending is not None:
            value = value + sums(slope(n1) * slope(n2), beyond)
        both = mass if bend is None else bend if mass is None else bend + mass
        return value if both is None else value + both

    # eliminate the interior coordinates: L D L^T
    inner = [(n, k) for n in range(2, p + 1) for k in (X, Y, T)]
    outer = [(n, k) for n in (0, 1) for k in (X, Y, T)]
    rows, ratios = list[Any](), list[Any]()
    at = 0
    for m, pivot in enumerate(inner):
        row = {}
        for name in [*inner[m:], *outer]:
            value = weighted(pivot, name)
            for earlier, ratio in zip(rows, ratios, strict=True):
                value = value - ratio[pivot] * earlier[name]
            row[name] = value
        inverse = 1.0 / row[pivot]
        S[at] = inverse
        ratio = {}
        for name in [*inner[m + 1 :], *outer]:
            at += 1
            ratio[name] = row[name] * inverse
            S[at] = ratio[name]
        at += 1
        rows.append(row)
        ratios.append(ratio)
    # K_oo - K_oi K_ii^-1 K_io on both vertices o, in the order of `layout.CONDENSED`
    lefts, rights = outer[:AXES], outer[AXES:]
    assert at == ELEMENT_FACTORS.offsets(0, p).condensed
    pairs = [(lefts[i], lefts[j]) for i in range(AXES) for j in range(i, AXES)]
    pairs += [(i, j) for i in lefts for j in rights]
    pairs += [(rights[i], rights[j]) for i in range(AXES) for j in range(i, AXES)]
    for one, two in pairs:
        value = weighted(one, two)
        for row, ratio in zip(rows, ratios, strict=True):
            value = value - row[one] * ratio[two]
        S[at] = value
        at += 1


def _starts(order: int) -> tuple[int, int, list[int]]:
    """Return the number of interior coordinates, their offset in x, and the offset of the factors of each one in S."""
    at = ELEMENT.offsets(0, order)
    inner, starts = at.right - at.interior, [0]
    for m in range(inner):
        starts.append(starts[-1] + inner - m + 2 * AXES)
    return inner, at.interior, starts


@traced
def forward(lane, order, S: Lanes, x: Lanes):
    """Apply L^-1 to the interior part of an element's right side x (S: `ELEMENT_FACTORS`).
    Return the six numbers that elimination subtracts from rows x, y, psi of the left and right vertex."""
    n, first, starts = _starts(len(order))
    inside = [x[first + k] for k in range(n)]
    taken = [None] * (2 * AXES)
    for m in range(n):
        for k in range(m + 1, n):
            inside[k] = inside[k] - S[starts[m] + k - m] * inside[m]
        for k in range(2 * AXES):
            product = S[starts[m] + n - m + k] * inside[m]
            taken[k] = product if m == 0 else taken[k] + product
        x[first + m] = inside[m]
    return [0.0 for _ in taken] if n == 0 else taken


@traced
def backward(lane, order, S: Lanes, x: Lanes, left, right):
    """Compute an element's interior entries of x; S: its `ELEMENT_FACTORS`; left, right: solution at the vertices."""
    n, first, starts = _starts(len(order))
    solved: dict[Any, Any] = {}
    for m in reversed(range(n)):
        value = x[first + m] * S[starts[m]]
        for k, y in enumerate([*left, *right]):
            value = value - S[starts[m] + n - m + k] * y
        for k in range(m + 1, n):
            value = value - S[starts[m] + k - m] * solved[k]
        solved[m] = value
        x[first + m] = value


@traced
def energy_sums(lane, order, q, v, psi, spin, left, section):
    """Return an element's kinetic and strain energy (J), and its first moments of mass int m x, int m y (kg m).

    psi, spin: angle and rate of the left vertex. left: its (x, y, vx, vy) if q and v do not contain them, else None."""
    p, sums = len(order), Sums()
    t = tables(p)
    x, y, vx, vy = (None,) * 4 if left is None else left
    place, rate = _nodes(lane, q, p, (x, y, psi)), _nodes(lane, v, p, (vx, vy, spin))
    (_, dx), (_, dy), (turn, bend) = (slopes(sums, t, nodes) for nodes in place)
    angle = values_at(sums, t, place[T], turn)
    strain, uniform = 0.0, hasattr(section, "EI_2l")
    length, bent = length_of(section), unbent(section, [turn, *place[T][2:]])
    for g, (EA_2l, C_2l, own) in enumerate(materials(section, p)):
        s, c = sincos(angle[g])
        g1, g2 = rotate_back_2d(c, s, dx[g], dy[g])
        both = normal(g1 - length, length, own).energy * EA_2l + shear(g2, length, own).energy * C_2l
        weight = 0.5 * float(t.weights[g])
        strain = strain + (both + (bend[g] * bend[g]) * section.EI_2l if uniform else both) * weight
    for more in _nonlinear_part(section, t, _nonlinear_bending(sums, t, bent), lambda e, of: (of.energy - e * e) * 0.5):
        strain = strain + more
    # T = 1/2 v^T M v with the consistent mass, and the first moments int m x, int m y (inertial axes)
    squares, moments = [], []
    if not uniform:
        strain = strain + dot(moments_of(section, t, bent), bent) * 0.5
        for k in (X, Y, T):
            rows = [inertia_row(section, p, k, n) for n in range(p + 1)]
            squares.append(dot([dot(row, rate[k]) for row in rows], rate[k]) * 0.5)
            moments.append(dot(rows[0], place[k]) + dot(rows[1], place[k]))
        return [squares[X] + squares[Y] + squares[T], strain, moments[X], moments[Y]]
    for k in (X, Y, T):
        total = 0.0
        for n in range(p + 1):
            total = total + rate[k][n] * sums(t.mass[n], rate[k])
        squares.append(total)
        moments.append(sums(t.mass[0] + t.mass[1], place[k]))
    kinetic = (squares[X] + squares[Y]) * (section.ml * 0.5) + squares[T] * (section.jl * 0.5)
    return [kinetic, strain, moments[X] * section.ml, moments[Y] * section.ml]


@traced
def damping_sums(lane, order, q, v, x, psi, left, section):
    """Return a list of one number, x^T C v / tau_d (W/s): power of an element's damping forces C v at the rates x.

    psi: angle of the left vertex in q, and its rates in v and in x. left: (x, y, vx, vy) of the left end for v, then
    for x, if the arrays do not contain them; otherwise None. See docs/theory.md, (5.1)."""
    p, sums = len(order), Sums()
    t = tables(p)
    one, two = ((None,) * 4 if at is None else at for at in left)
    place = _nodes(lane, q, p, (*one[:T], psi[0]))
    rates = _nodes(lane, v, p, (*one[T:], psi[1])), _nodes(lane, x, p, (*two[T:], psi[2]))
    (_, dx), (_, dy), (turn, _) = (slopes(sums, t, nodes) for nodes in place)
    angle = values_at(sums, t, place[T], turn)
    circle = [sincos(w) for w in angle]
    strains, bends = [], []
    for rate in rates:
        (_, ux), (_, uy), (turning, bend) = (slopes(sums, t, nodes) for nodes in rate)
        bends.append([turning, *rate[T][2:]])
        omega = values_at(sums, t, rate[T], turning)
        rows = []
        for g, (s, c) in enumerate(circle):
            # Gamma', kappa' (section axes) at the Gauss points, by the rates v and x
            at = c, s, *rotate_back_2d(c, s, dx[g], dy[g])
            rows.append((*_strain_rates(at, ux[g], uy[g], omega[g]), bend[g]))
        strains.append(rows)
    total = 0.0
    uniform = hasattr(section, "EI_2l")
    for w, one, two, (EA_2l, C_2l, _) in zip(t.weights, *strains, materials(section, p), strict=True):
        parts = one[0] * two[0] * EA_2l + one[1] * two[1] * C_2l
        total = total + (parts + one[2] * two[2] * section.EI_2l if uniform else parts) * float(w)
    return [total if uniform else total + dot(moments_of(section, t, bends[0]), bends[1])]


def _small_rotation(w: Any) -> tuple[Any, Any]:
    """Return the sine and cosine of a small angle w (rad), by their power series up to w^5 and w^6."""
    z = w * w
    return w + w * (z * (z * (1.0 / 120.0) - 1.0 / 6.0)), z * (z * (1.0 / 24.0 - z * (1.0 / 720.0)) - 0.5) + 1.0


@traced
def rotate_by_small_angle(lane, order, x, w):
    """Rotate the vector (x[0], x[1]) in inertial axes by a small angle w (rad), in place."""
    s, c = _small_rotation(w)
    ahead, aside = load_pair(lane, x, X)
    store_pair(lane, x, X, rotate_2d(c, s, ahead, aside))


@traced
def propagate_positions(lane, order, start: Lanes, q: Lanes, psi, new_psi, x, y):
    """Compute the interior and right positions in q (m) from the left position (x, y), angles in q and old strains.

    The tangent vectors of `start` at the Gauss points are rotated by the change of psi. psi, new_psi: angle (rad) of
    the left end in start and in q. Returns the position (x, y) of the right end."""
    p, sums = len(order), Sums()
    t = tables(p)
    old, new = ([z[_at(n, p) + T] for n in range(1, p + 1)] for z in (start, q))
    change = [b - a for a, b in zip([psi, *old], [new_psi, *new], strict=True)]
    angle = values_at(sums, t, change, change[1] - change[0])
    dx, dy = (slopes(sums, t, _axis(lane, start, p, k))[1] for k in (X, Y))
    # (right - left, interior ...) with these d: slopes are orthogonal, norm = sum w slope^2
    moved = []
    for g in range(p):
        s, c = _small_rotation(angle[g])
        moved.append(rotate_2d(c, s, dx[g], dy[g]))
    ends = []
    for k, first in ((X, x), (Y, y)):
        own = [d[k] for d in moved]
        parts = [sums(t.weights * t.slope[i], own, 1.0 / float(t.norm[i])) for i in range(p)]
        for n in range(2, p + 1):
            q[_at(n, p) + k] = parts[n - 1]
        ends.append(first + parts[0])
        q[_at(1, p) + k] = ends[k]
    return ends
