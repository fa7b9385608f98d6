"""One geometrically exact element: forces, tangent, condensation, energy, for each polynomial order; traced.

An element of order p and length l joins two vertices (x, y, psi). Between them it has p - 1 interior functions whose
derivatives are the Legendre polynomials P_1 ... P_{p-1} (scaled to a largest value of 1 at the Gauss points) and which
vanish at both ends: together with the linear functions they span what p + 1 Lagrange nodes span, but their amplitudes,
the interior coordinates, make bending stiffness diagonal and the sums below short.

With d = l r' (twice the derivative on [-1, 1]), (c, s) = (cos psi, sin psi) and g = (c d_x + s d_y, -s d_x + c d_y) the
strains are Gamma_1 = g_1/l - 1, Gamma_2 = g_2/l, kappa = (l psi')/l, and with p Gauss points of weights w the energy is

    sum_g w/2 [k1 (g_1 - l)^2 + k2 g_2^2 + kb (l psi')^2],   k1 = EA/2l, k2 = C/2l, kb = EI/2l,

with the laws of `materials` in place of the squares. Inertia: ml = m l/2, jl = J l/2. Where sections vary within the
element (`layout.Varying`) k1 and k2 are those of each point, and bending and inertia have matrices of their own
(`constants`). Arrays of coordinates begin at the left vertex (`layout.ELEMENT`); lists of an axis hold left, right,
interior. All of this runs when a kernel is compiled (`compiler.trace`): what is left are the operations on values.
"""

from typing import Any, NamedTuple

from ...compiler import kernel, load, sincos, splat, store, traced
from ..arithmetic import pair, put_pair, turned, turned_back
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
"""Where the parts of a `Vertex` begin in what `forces` returns, and where they end."""


class Point(NamedTuple):
    """What is known of a Gauss point."""

    c: Any  # cos psi
    s: Any  # sin psi
    g1: Any
    g2: Any
    n1: Any  # normal force and
    n2: Any  # shear force, with the point's weight
    bent: Any  # l kappa without the natural one, where M is not EI kappa; otherwise 0


POINT = len(Point._fields)


@kernel
def handed_on(out):
    """What `forces` returns: the right `Vertex`, and a `Point` after the other."""
    return Vertex(out[:RATE], out[RATE:ACCELERATION], out[ACCELERATION:FORCE], out[FORCE:VERTEX]), out[VERTEX:]


def _at(node: int, order: int) -> int:
    """Where the coordinates of the left (0), right (1) or an interior (2 ...) node begin."""
    at = ELEMENT.offsets(0, order)
    return int((at.left, at.right)[node] if node < 2 else at.interior + AXES * (node - 2))


def _axis(lane: Any, x: Any, order: int, axis: int, left: Any = None) -> list[Any]:
    """A coordinate of all nodes; of the left one it is `left`, where that is given."""
    first = load(lane, x, _at(0, order) + axis) if left is None else left
    return [first, *(load(lane, x, _at(node, order) + axis) for node in range(1, order + 1))]


def _nodes(lane: Any, x: Any, order: int, left: Any) -> list[list[Any]]:
    """x, y and psi of all nodes, the left one's as given; None: as they stand in x."""
    return [_axis(lane, x, order, k, left[k]) for k in (X, Y, T)]


def _strain_rates(at: Any, ux: Any, uy: Any, omega: Any) -> tuple[Any, Any]:
    """Rates of g_1 and g_2, from those of d and psi; at: c, s, g_1, g_2, ..."""
    c, s, g1, g2, *_ = at
    r1, r2 = turned_back(c, s, ux, uy)
    return r1 + g2 * omega, r2 - g1 * omega


def _momenta(sums: Sums, t: Tables, section: Any, nodes: list[Any], axis: int) -> tuple[list[Any], Any, Any]:
    """Consistent mass times the coordinates of an axis: of the interior functions; of both vertices, their mean and
    half their difference."""
    if not hasattr(section, "ml"):
        all_of = [dot(inertia_row(section, len(nodes) - 1, axis, n), nodes) for n in range(len(nodes))]
        return all_of[2:], (all_of[0] + all_of[1]) * 0.5, (all_of[1] - all_of[0]) * 0.5
    m, unit = t.mass, section.jl if axis == T else section.ml
    both, across = nodes[0] + nodes[1], nodes[1] - nodes[0]
    even, odd = [both, *nodes[2::2]], [across, *nodes[3::2]]
    inner = range(2, len(nodes))
    rows = [sums([m[n, int(n % 2)], *m[n, 2 + n % 2 :: 2]], odd if n % 2 else even, 1.0, unit) for n in inner]
    mean = sums([0.5 * (m[0, 0] + m[0, 1]), *m[0, 2::2]], even, 1.0, unit)
    return rows, mean, sums([0.5 * (m[1, 1] - m[0, 1]), *m[1, 3::2]], odd, 1.0, unit)


@traced
def momentum(lane, order, a, left, section, r):
    """Write the left vertex's and the interior rows of r = M a. `left`: x, y, psi of a there and r so far; returns the
    same of the right vertex."""
    p, sums = len(order), Sums()
    t = tables(p)
    ends, rest = [], []
    for k, nodes in enumerate(_nodes(lane, a, p, left)):
        rows, mean, half = _momenta(sums, t, section, nodes, k)
        store(r, k, left[AXES + k] + (mean - half))
        for n, row in enumerate(rows, 2):
            store(r, _at(n, p) + k, row)
        ends.append(nodes[1])
        rest.append(mean + half)
    return [*ends, *rest]


def _bends(sums: Sums, t: Tables, bent: list[Any]) -> list[Any]:
    """l kappa at the Gauss points where M is not EI kappa, from `unbent`; otherwise 0."""
    return [0.0] * len(t.weights) if bending is None else [sums(column, bent) for column in t.slope.T]


def _beyond(section: Any, t: Tables, bends: list[Any], part: Any) -> list[Any]:
    """Where M is not EI kappa a `part` (l kappa, `Answer`) of its law, times kb and weight of each Gauss point."""
    if bending is None:
        return []
    found = []
    for w, e, (kb, own) in zip(t.weights, bends, bending_at(section, len(bends)), strict=True):
        found.append(part(e, bending(e, length_of(section), own)) * (kb * float(w)))
    return found


@traced
def directions(lane, order, q, psi, circle):
    """circle <- sine and cosine of psi at each Gauss point; `psi`: that at the left."""
    p, sums = len(order), Sums()
    t = tables(p)
    nodes = _axis(lane, q, p, T, psi)
    for g, angle in enumerate(values_at(sums, t, nodes, nodes[1] - nodes[0])):
        s, c = sincos(angle)
        put_pair(circle, PAIR * g, (s, c))


@traced
def forces(lane, order, gravity, state, left, section, r, circle):
    """Write the left vertex's and the interior rows of r; return the right `Vertex` and a `Point` for each point."""
    p, sums = len(order), Sums()
    t, tau = tables(p), section.tau
    place = _nodes(lane, state.q, p, left.place)
    inertia = _nodes(lane, state.a, p, left.acceleration)
    if gravity is not None:
        for k in (X, Y):
            inertia[k][1] = inertia[k][1] - gravity[k]
    rate = [[splat(lane, 0.0)] * (p + 1)] * 3
    if tau is not None:
        rate = _nodes(lane, state.v, p, left.rate)
        ux, uy = (slopes(sums, t, rate[k])[1] for k in (X, Y))
        turning = rate[T][1] - rate[T][0]
        omega = values_at(sums, t, rate[T], turning)
    dx, dy = (slopes(sums, t, place[k])[1] for k in (X, Y))
    bent = unbent(section, [place[T][1] - place[T][0], *place[T][2:]])
    points, fx, fy, moment = [], [], [], []
    length, kappa = length_of(section), _bends(sums, t, bent)
    for g, (k1, k2, own) in enumerate(materials(section, p)):
        s, c = pair(lane, circle, PAIR * g)
        g1, g2 = turned_back(c, s, dx[g], dy[g])
        e1, e2 = normal(g1 - length, length, own).force, shear(g2, length, own).force
        if tau is not None:
            r1, r2 = _strain_rates((c, s, g1, g2), ux[g], uy[g], omega[g])
            e1, e2 = viscoelastic(e1, r1, tau), viscoelastic(e2, r2, tau)
        w = float(t.weights[g])
        n1, n2 = e1 * times(k1, w), e2 * times(k2, w)
        x, y = turned(c, s, n1, n2)
        fx.append(x)
        fy.append(y)
        moment.append(n1 * g2 - n2 * g1)
        points += Point(c, s, g1, g2, n1, n2, kappa[g])
    beyond = _beyond(section, t, kappa, lambda e, of: of.force - e)
    if tau is not None:
        bent = [viscoelastic(x, y, tau) for x, y in zip(bent, [turning, *rate[T][2:]], strict=True)]
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
        store(r, k, left.force[k] + force[k][0])
        for n in range(2, p + 1):
            store(r, _at(n, p) + k, force[k][n])
    return [x[k][1] for x in (place, rate, inertia, force) for k in (X, Y, T)] + points


@traced
def tangent(lane, order, points, section, weights, S):
    """S <- factors of the interior with their couplings to both vertices, then the matrix condensed to these.

    Of the sum of M, C and K by their weights; see `layout.ELEMENT_FACTORS`. An entry of the tangent is written where it
    is needed first: there are more of them than registers.
    """
    p, sums = len(order), Sums()
    t = tables(p)
    ck, tau, length = weights.stiffness, section.tau, length_of(section)
    share = viscoelastic_slope(None, tau, weights.damping, ck)
    h = [[] for _ in range(6)]  # by d_x, d_y, psi: xx xy yy xt yt tt
    for g, (k1, k2, own) in enumerate(materials(section, p)):
        c, s, g1, g2, n1, n2, _ = points[POINT * g : POINT * (g + 1)]
        w = float(t.weights[g])
        answers = normal(g1 - length, length, own), shear(g2, length, own)
        c1, c2 = (viscoelastic_slope(answer.slope, tau, weights.damping, ck) for answer in answers)
        k1, k2 = k1 * c1, k2 * c2
        j1, j2, both = times(k1, w), times(k2, w), times(k1 + k2, w)
        part = c * times(k1 - k2, w)
        hxx = part * c + j2
        across, along = g2 * j1 - n2 * ck, g1 * j2 - n1 * ck
        entries = (
            hxx, part * s, both - hxx, c * across + s * along, s * across - c * along, g2 * across + g1 * along
        )  # fmt: skip
        for kind, entry in zip(h, entries, strict=True):
            kind.append(entry)
    bends, inertia = bending_entries(section, t, share), inertia_entries(section, t, weights.mass)
    beyond = _beyond(section, t, [points[POINT * g + POINT - 1] for g in range(p)], lambda e, of: (of.slope - 1.0) * ck)

    def slope(node: int) -> Any:
        return -t.slope[0] if node == 0 else t.slope[max(node - 1, 0)]

    def entry(one: tuple[int, int], two: tuple[int, int]) -> Any:
        """Entry of the tangent for two coordinates (node, axis)."""
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

    inner = [(n, k) for n in range(2, p + 1) for k in (X, Y, T)]
    outer = [(n, k) for n in (0, 1) for k in (X, Y, T)]
    rows, ratios = [], []
    at = 0
    for m, pivot in enumerate(inner):
        row = {}
        for name in [*inner[m:], *outer]:
            value = entry(pivot, name)
            for earlier, ratio in zip(rows, ratios, strict=True):
                value = value - ratio[pivot] * earlier[name]
            row[name] = value
        inverse = 1.0 / row[pivot]
        store(S, at, inverse)
        ratio = {}
        for name in [*inner[m + 1 :], *outer]:
            at += 1
            ratio[name] = row[name] * inverse
            store(S, at, ratio[name])
        at += 1
        rows.append(row)
        ratios.append(ratio)
    lefts, rights = outer[:AXES], outer[AXES:]
    assert at == ELEMENT_FACTORS.offsets(0, p).condensed
    pairs = [(lefts[i], lefts[j]) for i in range(AXES) for j in range(i, AXES)]
    pairs += [(i, j) for i in lefts for j in rights]
    pairs += [(rights[i], rights[j]) for i in range(AXES) for j in range(i, AXES)]
    for one, two in pairs:
        value = entry(one, two)
        for row, ratio in zip(rows, ratios, strict=True):
            value = value - row[one] * ratio[two]
        store(S, at, value)
        at += 1


def _starts(order: int) -> tuple[int, int, list[int]]:
    """How many interior coordinates there are, where they begin in x, and where the numbers of each begin in S."""
    at = ELEMENT.offsets(0, order)
    inner, starts = at.right - at.interior, [0]
    for m in range(inner):
        starts.append(starts[-1] + inner - m + 2 * AXES)
    return inner, at.interior, starts


@traced
def forward(lane, order, S, x):
    """Reduce the interior entries of x; return what they take from those of the left and the right vertex."""
    n, first, starts = _starts(len(order))
    inside = [load(lane, x, first + k) for k in range(n)]
    taken = [None] * (2 * AXES)
    for m in range(n):
        for k in range(m + 1, n):
            inside[k] = inside[k] - load(lane, S, starts[m] + k - m) * inside[m]
        for k in range(2 * AXES):
            product = load(lane, S, starts[m] + n - m + k) * inside[m]
            taken[k] = product if m == 0 else taken[k] + product
        store(x, first + m, inside[m])
    return [splat(lane, 0.0) for _ in taken] if n == 0 else taken


@traced
def backward(lane, order, S, x, left, right):
    """Interior entries of x from the reduced ones and those of the vertices."""
    n, first, starts = _starts(len(order))
    solved = {}
    for m in reversed(range(n)):
        value = load(lane, x, first + m) * load(lane, S, starts[m])
        for k, y in enumerate([*left, *right]):
            value = value - load(lane, S, starts[m] + n - m + k) * y
        for k in range(m + 1, n):
            value = value - load(lane, S, starts[m] + k - m) * solved[k]
        solved[m] = value
        store(x, first + m, value)


@traced
def measure(lane, order, q, v, psi, spin, left, section):
    """(kinetic, strain energy, mass moments x, y); `psi`, `spin`: that at the left, its rate. `left`: None, or x, y and
    their rates there where they are not in q and v."""
    p, sums = len(order), Sums()
    t = tables(p)
    x, y, vx, vy = (None,) * 4 if left is None else left
    place, rate = _nodes(lane, q, p, (x, y, psi)), _nodes(lane, v, p, (vx, vy, spin))
    (_, dx), (_, dy), (turn, bend) = (slopes(sums, t, nodes) for nodes in place)
    angle = values_at(sums, t, place[T], turn)
    strain, uniform = splat(lane, 0.0), hasattr(section, "kb")
    length, bent = length_of(section), unbent(section, [turn, *place[T][2:]])
    for g, (k1, k2, own) in enumerate(materials(section, p)):
        s, c = sincos(angle[g])
        g1, g2 = turned_back(c, s, dx[g], dy[g])
        both = normal(g1 - length, length, own).energy * k1 + shear(g2, length, own).energy * k2
        weight = 0.5 * float(t.weights[g])
        strain = strain + (both + (bend[g] * bend[g]) * section.kb if uniform else both) * weight
    for more in _beyond(section, t, _bends(sums, t, bent), lambda e, of: (of.energy - e * e) * 0.5):
        strain = strain + more
    squares, moments = [], []
    if not uniform:
        strain = strain + dot(moments_of(section, t, bent), bent) * 0.5
        for k in (X, Y, T):
            rows = [inertia_row(section, p, k, n) for n in range(p + 1)]
            squares.append(dot([dot(row, rate[k]) for row in rows], rate[k]) * 0.5)
            moments.append(dot(rows[0], place[k]) + dot(rows[1], place[k]))
        return [squares[X] + squares[Y] + squares[T], strain, moments[X], moments[Y]]
    for k in (X, Y, T):
        total = splat(lane, 0.0)
        for n in range(p + 1):
            total = total + rate[k][n] * sums(t.mass[n], rate[k])
        squares.append(total)
        moments.append(sums(t.mass[0] + t.mass[1], place[k]))
    kinetic = (squares[X] + squares[Y]) * (section.ml * 0.5) + squares[T] * (section.jl * 0.5)
    return [kinetic, strain, moments[X] * section.ml, moments[Y] * section.ml]


@traced
def damp(lane, order, q, v, x, psi, left, section):
    """Work of the damping forces of rates v over rates x, per tau_d; `psi`: the left one in q, v and x; `left`: as in
    `measure`, a pair: in q and v, in q and x."""
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
            at = c, s, *turned_back(c, s, dx[g], dy[g])
            rows.append((*_strain_rates(at, ux[g], uy[g], omega[g]), bend[g]))
        strains.append(rows)
    total = splat(lane, 0.0)
    uniform = hasattr(section, "kb")
    for w, one, two, (k1, k2, _) in zip(t.weights, *strains, materials(section, p), strict=True):
        parts = one[0] * two[0] * k1 + one[1] * two[1] * k2
        total = total + (parts + one[2] * two[2] * section.kb if uniform else parts) * float(w)
    return [total if uniform else total + dot(moments_of(section, t, bends[0]), bends[1])]


def _small_rotation(w: Any) -> tuple[Any, Any]:
    """Sine and cosine of a small angle to its sixth power."""
    z = w * w
    return w + w * (z * (z * (1.0 / 120.0) - 1.0 / 6.0)), z * (z * (1.0 / 24.0 - z * (1.0 / 720.0)) - 0.5) + 1.0


@traced
def rotate_pair(lane, order, x, w):
    """Rotate the vector at the beginning of x by a small angle w."""
    s, c = _small_rotation(w)
    ahead, aside = pair(lane, x, X)
    put_pair(x, X, turned(c, s, ahead, aside))


@traced
def carry(lane, order, start, q, psi, new_psi, x, y):
    """Interior and right positions in q from the left one (x, y) and the angles in q, with the strains of `start`.

    d rotates with psi at each Gauss point; sine and cosine of that angle to its sixth power, plenty for a guess.
    `psi`, `new_psi`: those at the left. Returns the right position.
    """
    p, sums = len(order), Sums()
    t = tables(p)
    old, new = ([load(lane, z, _at(n, p) + T) for n in range(1, p + 1)] for z in (start, q))
    change = [b - a for a, b in zip([psi, *old], [new_psi, *new], strict=True)]
    angle = values_at(sums, t, change, change[1] - change[0])
    dx, dy = (slopes(sums, t, _axis(lane, start, p, k))[1] for k in (X, Y))
    moved = []
    for g in range(p):
        s, c = _small_rotation(angle[g])
        moved.append(turned(c, s, dx[g], dy[g]))
    ends = []
    for k, first in ((X, x), (Y, y)):
        own = [d[k] for d in moved]
        parts = [sums(t.weights * t.slope[i], own, 1.0 / float(t.norm[i])) for i in range(p)]
        for n in range(2, p + 1):
            store(q, _at(n, p) + k, parts[n - 1])
        ends.append(first + parts[0])
        store(q, _at(1, p) + k, ends[k])
    return ends
