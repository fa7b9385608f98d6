"""One geometrically exact element, written out: residual, tangent, condensation, for each polynomial order.

An element of order p and length l joins two vertices (x, y, psi). Between them it has p - 1 interior functions whose
derivatives are the Legendre polynomials P_1 ... P_{p-1} (scaled to a largest value of 1 at the Gauss points) and which
vanish at both ends: together with the linear functions they span what p + 1 Lagrange nodes span, but their amplitudes,
the interior coordinates, make bending stiffness diagonal and the sums below short.

With d = l r' (twice the derivative on [-1, 1]), (c, s) = (cos psi, sin psi) and g = (c d_x + s d_y, -s d_x + c d_y) the
strains are Gamma_1 = g_1/l - 1, Gamma_2 = g_2/l, kappa = (l psi')/l, and with p Gauss points of weights w the energy is

    sum_g w/2 [k1 (g_1 - l)^2 + k2 g_2^2 + kb (l psi')^2],   k1 = EA/2l, k2 = C/2l, kb = EI/2l.

The code below writes Python source for that, loops over nodes and points unrolled and sums that recur taken once, and
turns it into a function (`function`). Which features it holds (tangent, damping, gravity) is settled then as well.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from .exact_tables import Tables, tables
from .written import Term, Writer, function, plus, scaled, times

AXES = "xyt"
LL = ("Lx", "Ly", "Lt")
RR = ("Rx", "Ry", "Rt")


def interior_names(order: int) -> list[str]:
    """Interior coordinates in the order of q."""
    return [f"{k}{axis}" for k in range(1, order) for axis in AXES]


def factor_size(order: int) -> int:
    """Entries of S for one element: interior factors with their couplings, then the condensed matrix."""
    n = 3 * (order - 1)
    return sum(1 + (n - 1 - m) + 6 for m in range(n)) + 21


# --- names: coordinate "Lx", "Rt", "1y" ...; q_, v_, a_ before it for its value, rate, acceleration -----------------


def _interpolate(w: Writer, t: Tables, letter: str, axis: str) -> tuple[list[Term], list[Term]]:
    """Slope and value of a coordinate at each Gauss point, as (factor, name)."""
    order = len(t.weights)
    span = w.let(f"{letter}_D{axis}", f"{letter}_R{axis} - {letter}_L{axis}")
    names = [span, *[f"{letter}_{i}{axis}" for i in range(1, order)]]
    slopes = [w.sum([(t.slope[i][g], names[i]) for i in range(order)]) for g in range(order)]
    if axis != "t":
        return slopes, []
    middle = w.let(f"{letter}_M{axis}", f"({letter}_L{axis} + {letter}_R{axis}) * 0.5")
    values = []
    for g in range(order):
        even = [(1.0, middle)] + [(t.value[i][g], f"{letter}_{i - 1}{axis}") for i in range(2, order + 1) if i % 2 == 0]
        odd = [(0.5 * (t.value[1][g] - t.value[0][g]), span)]
        odd += [(t.value[i][g], f"{letter}_{i - 1}{axis}") for i in range(2, order + 1) if i % 2 == 1]
        one, two = w.sum(even), w.sum(odd)
        values.append(w.sum([one, two]))
    return slopes, values


def _points(w: Writer, t: Tables, damped: bool) -> None:
    """At each Gauss point g: cosine, sine, strains and the forces fx, fy, mt (per d and psi), weights included."""
    order = len(t.weights)
    dx, dy = (_interpolate(w, t, "q", axis)[0] for axis in "xy")
    angle = _interpolate(w, t, "q", "t")[1]
    if damped:
        vx, vy = (_interpolate(w, t, "v", axis)[0] for axis in "xy")
        turn = _interpolate(w, t, "v", "t")[1]
    for g in range(order):
        x, y = times(*dx[g]), times(*dy[g])
        w.let(f"s{g}, c{g}", f"sincos({times(*angle[g])})")
        c, s = f"c{g}", f"s{g}"
        g1 = w.let(f"g1_{g}", f"{c} * {x} + {s} * {y}")
        g2 = w.let(f"g2_{g}", f"{c} * {y} - {s} * {x}")
        if damped:
            ux, uy, omega = times(*vx[g]), times(*vy[g]), times(*turn[g])
            w.let(f"e1_{g}", f"({g1} - length) + tau * ({c} * {ux} + {s} * {uy} + {g2} * ({omega}))")
            w.let(f"e2_{g}", f"{g2} + tau * ({c} * {uy} - {s} * {ux} - {g1} * ({omega}))")
        else:
            w.let(f"e1_{g}", f"{g1} - length")
            w.let(f"e2_{g}", g2)
        n1 = w.let(f"n1_{g}", f"e1_{g} * {scaled('k1', t.weights[g])}")
        n2 = w.let(f"n2_{g}", f"e2_{g} * {scaled('k2', t.weights[g])}")
        w.let(f"fx{g}", f"{c} * {n1} - {s} * {n2}")
        w.let(f"fy{g}", f"{s} * {n1} + {c} * {n2}")
        w.let(f"mt{g}", f"{n1} * {g2} - {n2} * {g1}")


def _slopes(w: Writer, t: Tables, damped: bool) -> None:
    """At each Gauss point g: hxx ... htt, the derivatives of fx, fy, mt by d_x, d_y, psi."""
    share = "(cc * tau + ck)" if damped else "ck"
    for k in ("k1", "k2", "kb"):
        w.let(f"{k}t", f"{share} * {k}")
    w.let("difference", "k1t - k2t")
    w.let("total", "k1t + k2t")
    for g, weight in enumerate(t.weights):
        c, s = f"c{g}", f"s{g}"
        w.let(f"part{g}", f"{scaled('difference', weight)} * {c}")
        w.let(f"hxx{g}", f"part{g} * {c} + {scaled('k2t', weight)}")
        w.let(f"hxy{g}", f"part{g} * {s}")
        w.let(f"hyy{g}", f"{scaled('total', weight)} - hxx{g}")
        w.let(f"p{g}", f"g2_{g} * {scaled('k1t', weight)} - ck * n2_{g}")
        w.let(f"r{g}", f"g1_{g} * {scaled('k2t', weight)} - ck * n1_{g}")
        w.let(f"hxt{g}", f"{c} * p{g} + {s} * r{g}")
        w.let(f"hyt{g}", f"{s} * p{g} - {c} * r{g}")
        w.let(f"htt{g}", f"g2_{g} * p{g} + g1_{g} * r{g}")


def _residual(w: Writer, t: Tables, damped: bool) -> None:
    """f_NAME: elastic and inertia force on each coordinate."""
    order = len(t.weights)
    points = range(order)
    for axis in "xy":
        for i in range(order):
            w.let(f"e_{i}{axis}", times(*w.sum([(t.slope[i][g], f"f{axis}{g}") for g in points])))
    for i in range(order + 1):
        w.let(f"m_{i}", times(*w.sum([(t.value[i][g], f"mt{g}") for g in points])))
    for i in range(order):
        bend = f"q_{'D' if i == 0 else i}t"
        if damped:
            bend = w.let(f"b_{i}", f"{bend} + tau * v_{'D' if i == 0 else i}t")
        w.let(f"k_{i}", f"{bend} * (kb * {float(t.norm[i])!r})")
    nodes = ["L", "R", *[str(k) for k in range(1, order)]]
    for axis in AXES:
        unit = "jl" if axis == "t" else "ml"
        for i, node in enumerate(nodes):
            factor, name = w.sum([(t.mass[i][j], f"a_{other}{axis}") for j, other in enumerate(nodes)])
            inertia = f"{name} * ({unit} * {factor!r})"
            if axis == "t":
                bend = "- k_0" if node == "L" else f"+ k_{0 if node == 'R' else node}"
                w.let(f"f_{node}t", f"{inertia} + (m_{i} {bend})")
            else:
                sign, k = ("-", 0) if node == "L" else ("+", max(i - 1, 0))
                w.let(f"f_{node}{axis}", f"{inertia} {sign} e_{k}{axis}")


def _tangent(w: Writer, t: Tables) -> Callable[[str, str], str]:
    """The writer of an entry of the tangent, for a pair of coordinates."""
    points = range(len(t.weights))

    def row(node: str) -> int:
        return "LR".index(node) if node in "LR" else int(node) + 1

    def slope(node: str) -> tuple[float, np.ndarray]:
        return (-1.0, t.slope[0]) if node == "L" else (1.0, t.slope[0 if node == "R" else int(node)])

    def mass(one: str, two: str, unit: str) -> str:
        factor = float(t.mass[row(one)][row(two)])
        return f"({unit} * {factor!r})" if factor != 0.0 else ""

    def entry(one: str, two: str) -> str:
        (n1, a1), (n2, a2) = (one[:-1], one[-1]), (two[:-1], two[-1])
        (sign1, d1), (sign2, d2) = slope(n1), slope(n2)
        if a1 != "t" and a2 != "t":
            kind = "".join(sorted(a1 + a2))
            factor, name = w.sum([(d1[g] * d2[g], f"h{kind}{g}") for g in points])
            return plus(times(sign1 * sign2 * factor, name), mass(n1, n2, "cml") if a1 == a2 else "")
        v1, v2 = t.value[row(n1)], t.value[row(n2)]
        if a1 == "t" and a2 == "t":
            text = times(*w.sum([(v1[g] * v2[g], f"htt{g}") for g in points]))
            bend = sign1 * sign2 * float((t.weights * d1 * d2).sum())
            stiff = f"kbt * {bend!r}" if abs(bend) > 1e-13 else ""
            return plus(text, f"({plus(stiff, mass(n1, n2, 'cjl'))})")
        (sign, d, v, axis) = (sign1, d1, v2, a1) if a2 == "t" else (sign2, d2, v1, a2)
        factor, name = w.sum([(v[g] * d[g], f"h{axis}t{g}") for g in points])
        return times(sign * factor, name)

    w.let("cml", "cm * ml")
    w.let("cjl", "cm * jl")
    return entry


def _condense(w: Writer, order: int, entry: Callable[[str, str], str]) -> None:
    """Eliminate the interior coordinates; store their factors, then the condensed matrix LL, LR, RR.

    An entry of the tangent is written where it is first needed: there are more of them than registers.
    """
    inner = interior_names(order)
    names = [*inner, *LL, *RR]
    at = 0
    for m, pivot in enumerate(inner):
        for name in names[m:]:
            less = "".join(f" - Z_{earlier}_{pivot} * V_{earlier}_{name}" for earlier in inner[:m])
            w.let(f"V_{pivot}_{name}", f"{entry(pivot, name)}{less}")
        inverse = w.let(f"D_{pivot}", f"1.0 / V_{pivot}_{pivot}")
        w.lines.append(f"store(S, at + {at}, {inverse})")
        at += 1
        for name in names[m + 1 :]:
            z = w.let(f"Z_{pivot}_{name}", f"V_{pivot}_{name} * {inverse}")
            w.lines.append(f"store(S, at + {at}, {z})")
            at += 1
    pairs = [(LL[i], LL[j]) for i in range(3) for j in range(i, 3)]
    pairs += [(i, j) for i in LL for j in RR]
    pairs += [(RR[i], RR[j]) for i in range(3) for j in range(i, 3)]
    for one, two in pairs:
        less = "".join(f" - V_{pivot}_{one} * Z_{pivot}_{two}" for pivot in inner)
        w.lines.append(f"store(S, at + {at}, {entry(one, two)}{less})")
        at += 1


ELEMENT_ARGUMENTS = (
    "lane, order, damped, gravity, q, v, a, left, i, k1, k2, kb, length, ml, jl, tau, cm, cc, ck, r, S, at"
)


@cache
def element_function(order: int, damped: bool, heavy: bool) -> Callable[..., Any]:
    """element(lane, ...) for an order and what is present; see `exact_beam.element`."""
    t, w = tables(order), Writer()
    w.let("zero", "splat(lane, 0.0)")
    left = [f"{letter}_L{axis}" for letter in ("q", "v", "a") for axis in AXES] + [f"f0_{axis}" for axis in AXES]
    w.lines.append(f"{', '.join(left)} = left")
    others = [*interior_names(order), *RR]
    for letter in ("q", "v", "a") if damped else ("q", "a"):
        for k, name in enumerate(others):
            falls = heavy and letter == "a" and name in ("Rx", "Ry")
            weight = f" - gravity[{AXES.index(name[-1])}]" if falls else ""
            w.let(f"{letter}_{name}", f"load(lane, {letter}, i + {k}){weight}")
    if not damped:
        for name in RR:
            w.let(f"v_{name}", "zero")
    _points(w, t, damped)
    _residual(w, t, damped)
    for k, axis in enumerate(AXES):
        w.lines.append(f"store(r, i + {k - 3}, f0_{axis} + f_L{axis})")
    for k, name in enumerate(interior_names(order)):
        w.lines.append(f"store(r, i + {k}, f_{name})")
    written = len(w.lines)
    _slopes(w, t, damped)
    _condense(w, order, _tangent(w, t))
    w.lines[written:] = ["if cm != 0.0:", *[f"    {line}" for line in w.lines[written:]]]
    right = [f"{letter}_{name}" for letter in ("q", "v", "a") for name in RR] + [f"f_{name}" for name in RR]
    return function(f"element{order}", ELEMENT_ARGUMENTS, w.lines, f"({', '.join(right)})")


SOLVE_ARGUMENTS = "lane, order, S, at, x, i, left"


@cache
def forward_function(order: int) -> Callable[..., Any]:
    """Reduce the interior entries of x (from row i) and return what they add to (left, right)."""
    w = Writer()
    inner = interior_names(order)
    for k, name in enumerate(inner):
        w.let(f"x_{name}", f"load(lane, x, i + {k})")
    totals = dict.fromkeys((*LL, *RR), "")
    at = 0
    for m, pivot in enumerate(inner):
        at += 1
        for name in [*inner[m + 1 :], *LL, *RR]:
            product = f"load(lane, S, at + {at}) * x_{pivot}"
            if name in totals:
                totals[name] = f"{totals[name]} + {product}" if totals[name] else product
            else:
                w.let(f"x_{name}", f"x_{name} - {product}")
            at += 1
        w.lines.append(f"store(x, i + {m}, x_{pivot})")
    if not inner:
        w.let("zero", "splat(lane, 0.0)")
    for name in totals:
        w.let(f"t_{name}", totals[name] or "zero")
    return function("forward", SOLVE_ARGUMENTS, w.lines, f"({', '.join(f't_{name}' for name in totals)})")


@cache
def backward_function(order: int) -> Callable[..., Any]:
    """Interior entries of x (from row i) from those of the vertices; returns the right vertex's."""
    w = Writer()
    inner = interior_names(order)
    n = len(inner)
    w.lines.append(f"{', '.join(f'x_{name}' for name in LL)} = left")
    for k, name in enumerate(RR):
        w.let(f"x_{name}", f"load(lane, x, i + {n + k})")
    starts = np.cumsum([0] + [1 + (n - 1 - m) + 6 for m in range(n)])
    for m in reversed(range(n)):
        text = f"load(lane, x, i + {m}) * load(lane, S, at + {starts[m]})"
        for k, name in enumerate([*LL, *RR]):
            text += f" - load(lane, S, at + {starts[m] + n - m + k}) * x_{name}"
        for k, name in enumerate(inner[m + 1 :]):
            text += f" - load(lane, S, at + {starts[m] + 1 + k}) * x_{name}"
        w.let(f"x_{inner[m]}", text)
        w.lines.append(f"store(x, i + {m}, x_{inner[m]})")
    return function("backward", SOLVE_ARGUMENTS, w.lines, f"({', '.join(f'x_{name}' for name in RR)})")


MEASURE_ARGUMENTS = "lane, order, q, v, turn, spin, i, k1, k2, kb, length, ml, jl"


@cache
def measure_function(order: int) -> Callable[..., Any]:
    """measure(lane, ...) for an order, see `exact_beam.measure`; `turn`, `spin` are psi and its rate at the left."""
    t, w = tables(order), Writer()
    inner = interior_names(order)
    for letter in "qv":
        for k, name in enumerate([*LL, *inner, *RR]):
            w.let(f"{letter}_{name}", f"load(lane, {letter}, i + {k - 3})")
    w.lines += ["q_Lt = turn", "v_Lt = spin", "strain = splat(lane, 0.0)", "lost = splat(lane, 0.0)"]
    (dx, _), (dy, _), (bend, angle) = (_interpolate(w, t, "q", axis) for axis in AXES)
    (vx, _), (vy, _), (bending, turning) = (_interpolate(w, t, "v", axis) for axis in AXES)
    for g in range(order):
        weight = float(t.weights[g])
        x, y, ux, uy = times(*dx[g]), times(*dy[g]), times(*vx[g]), times(*vy[g])
        w.let("s, c", f"sincos({times(*angle[g])})")
        w.let("omega", times(*turning[g]))
        w.let("g1", f"c * {x} + s * {y}")
        w.let("g2", f"c * {y} - s * {x}")
        w.let("r1", f"c * {ux} + s * {uy} + g2 * omega")
        w.let("r2", f"c * {uy} - s * {ux} - g1 * omega")
        w.let("k", times(*bend[g]))
        w.let("rk", times(*bending[g]))
        w.let("e1", "g1 - length")
        w.let("strain", f"strain + (e1 * e1 * k1 + g2 * g2 * k2 + k * k * kb) * {0.5 * weight!r}")
        w.let("lost", f"lost + (r1 * r1 * k1 + r2 * r2 * k2 + rk * rk * kb) * {weight!r}")
    nodes = ["L", "R", *[str(k) for k in range(1, order)]]
    for axis in AXES:
        rows = []
        for i, node in enumerate(nodes):
            factor, name = w.sum([(t.mass[i][j], f"v_{other}{axis}") for j, other in enumerate(nodes)])
            rows.append(f"v_{node}{axis} * {name} * {factor!r}")
        w.let(f"squares_{axis}", " + ".join(rows))
        parts = [(float(t.mass[i][0] + t.mass[i][1]), f"q_{node}{axis}") for i, node in enumerate(nodes)]
        w.let(f"moment_{axis}", times(*w.sum(parts)))
    kinetic = "(squares_x + squares_y) * (0.5 * ml) + squares_t * (0.5 * jl)"
    return function("measure", MEASURE_ARGUMENTS, w.lines, f"({kinetic}, strain, lost, moment_x * ml, moment_y * ml)")


CARRY_ARGUMENTS = "lane, order, start, q, turn, new_turn, i, x, y"


@cache
def carry_function(order: int) -> Callable[..., Any]:
    """Interior and right positions in q from the left one (x, y) and the angles in q, with the strains of `start`.

    d turns with psi at each Gauss point; sine and cosine of that turn to its sixth power, which is plenty for a guess.
    `turn`, `new_turn`: psi at the left.
    """
    t, w = tables(order), Writer()
    inner = interior_names(order)
    for k, name in enumerate([*LL, *inner, *RR]):
        w.let(f"q_{name}", f"load(lane, start, i + {k - 3})")
    w.lines += ["q_Lt = turn", "w_Lt = new_turn - turn"]
    for k, name in enumerate([*inner, *RR]):
        if name[-1] == "t":
            w.let(f"w_{name}", f"load(lane, q, i + {k}) - q_{name}")
    (dx, _), (dy, _), (_, turns) = (_interpolate(w, t, *of) for of in ("qx", "qy", "wt"))
    for g in range(order):
        px, py = times(*dx[g]), times(*dy[g])
        w.let("w", times(*turns[g]))
        w.let("z", "w * w")
        w.let("s", "w + w * (z * (z * (1.0 / 120.0) - 1.0 / 6.0))")
        w.let("c", "1.0 + z * (z * (1.0 / 24.0 - z * (1.0 / 720.0)) - 0.5)")
        w.let(f"ux{g}", f"c * {px} - s * {py}")
        w.let(f"uy{g}", f"s * {px} + c * {py}")
    for axis in "xy":
        for k in range(order):
            factor, name = w.sum([(t.weights[g] * t.slope[k][g], f"u{axis}{g}") for g in range(order)])
            value = times(factor / float(t.norm[k]), name)
            if k == 0:
                w.let(axis, f"{axis} + {value}")
                w.lines.append(f"store(q, i + {len(inner) + AXES.index(axis)}, {axis})")
            else:
                w.lines.append(f"store(q, i + {inner.index(f'{k}{axis}')}, {value})")
    return function("carry", CARRY_ARGUMENTS, w.lines, "(x, y)")
