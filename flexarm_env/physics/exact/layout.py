"""Layouts and records of a chain of geometrically exact beams: coordinates, constants, Newton matrix, factors.

Components that kernels load together (`arithmetic.load_pair`, `load_vector`) are adjacent fields, in that order.
Positions are in inertial axes. Angles are from the inertial x axis, except for hinge angles, which are relative.
"""

from typing import Any, NamedTuple

from ...compiler import Lanes, kernel
from ...layout import Field, Layout
from ..arithmetic import scaled_by_share
from ..layout import LEVER
from ..materials import BENDING, NORMAL_AND_SHEAR
from ..model import STIFFNESS_FACTOR, TAU_D

# coordinates: x, y (m, inertial axes), psi (rad); interior ones are departures from both vertices' line

NODE = Layout(
    "Node", "",
    Field("x", (), "m", "position, inertial axes"),
    Field("y", (), "m", "position, inertial axes"),
    Field("psi", (), "rad", "section angle; behind a hinge the section turns by psi + delta"),
)  # fmt: skip
X, Y, T, AXES = NODE.places

ELEMENT = Layout(
    "Element", "order",
    Field("left", (AXES,), "", "x (m), y (m), psi (rad) of the left vertex"),
    Field("interior", ("order - 1", AXES), "", "amplitudes of the interior functions in x, y (m) and psi (rad)"),
    Field("right", (AXES,), "", "x (m), y (m), psi (rad) of the right vertex, the next element's left one"),
)  # fmt: skip
"""`ELEMENT`: order of the coordinates of one element in q, v, a and r."""

CHAIN = Layout(
    "Chain", "links, elements, order",
    Field("elements", ("links", "elements", "order", AXES), "", "an `ELEMENT` each, less its right vertex"),
    Field("tip", (AXES,), "", "x (m), y (m), psi (rad) of the last vertex"),
    Field("hinges", ("links - 1",), "rad", "delta: angle of a link's root section less psi of the tip before it"),
)  # fmt: skip
"""`CHAIN`: rows of the coordinates in q, v, a and r, from root to tip."""

# constants: EA, C, EI over 2 l, because d and kappa are derivatives by xi in [-1, 1]; m, J times l / 2

OWN = len(NORMAL_AND_SHEAR) + len(BENDING)
SECTION = Layout(
    "Section", "",
    Field("k1", (), "N/m", "EA / 2l, stretching stiffness"),
    Field("k2", (), "N/m", "C / 2l, shear stiffness"),
    Field("kb", (), "N m", "EI / 2l, bending stiffness"),
    Field("length", (), "m", "l of an element"),
    Field("ml", (), "kg", "m l / 2, m the mass per length"),
    Field("jl", (), "kg m^2", "J l / 2, J the rotary inertia per length"),
    Field("own", (OWN,), "", "further constants of the material laws (`materials.NORMAL_AND_SHEAR`, `BENDING`)"),
)  # fmt: skip
"""`SECTION`: constants of each element of a link with one section."""
VARYING = Layout(
    "Varying", "order",
    Field("length", (), "m", "l of this element"),
    Field("stretch", ("order",), "N/m", "EA / 2l at the Gauss points"),
    Field("shear", ("order",), "N/m", "C / 2l there"),
    Field("bend", ("order", "order"), "N m", "int EI d_i d_j ds / l^2, bending stiffness; d: slopes (`tables.Tables`)"),
    Field("mass", ("order + 1", "order + 1"), "kg", "int m f_i f_j ds; f: functions of nodes (`tables.Tables`)"),
    Field("rotary", ("order + 1", "order + 1"), "kg m^2", "int J f_i f_j ds, rotary inertia"),
    Field("bending", ("order",), "N m", "EI / 2l at the Gauss points, for a nonlinear law of M"),
    Field("own", ("order", OWN), "", "further constants of the material laws at the Gauss points"),
)  # fmt: skip
"""`VARYING`: constants of one element in an arm whose sections vary; they replace `SECTION`."""

ELBOW = Layout(
    "Elbow", "",
    Field("mass", (), "kg", "mass at the joint"),
    Field("left", (), "kg m^2", "rotary inertia that turns with the tip before the joint"),
    Field("right", (), "kg m^2", "rotary inertia that turns with the root behind the joint"),
)  # fmt: skip
LEVERS = Layout(
    "Levers", "links, loads",
    Field("levers", ("links", 2, LEVER.length), "", "a `LEVER` for each link's root and tip"),
    Field("loads", ("loads",), "m", "lever of each point load, from its vertex along psi"),
)  # fmt: skip
"""`LEVERS`: constants of the links' rigid ends."""

ROWS_OF_LOAD = Layout(
    "RowsOfLoad", "",
    Field("x", (), "", "row of x of the vertex that the load acts on"),
    Field("y", (), "", "row of its y"),
    Field("psi", (), "", "row of its angle psi"),
    Field("hinge", (), "", "row of the hinge angle delta, if the load acts behind a hinge; -1: none"),
).places  # fmt: skip
"""`ROWS_OF_LOAD`: the rows of CHAIN on which a point load acts."""

# S: blocks by x, y (inertial axes) and psi; symmetric ones hold six numbers

SYMMETRIC = Layout("Symmetric", "", *(Field(name, (), "", "") for name in ("xx", "xy", "xt", "yy", "yt", "tt")))
"""A symmetric 3x3 matrix on (x, y, psi), with t for psi. After factoring, L D L^T: 1 / D on the diagonal, and L."""
XX, XY, XT, YY, YT, TT, SIX = SYMMETRIC.places

CONDENSED = Layout(
    "Condensed", "",
    Field("ll", (SIX,), "", "block of the left vertex, a `SYMMETRIC`"),
    Field("lr_x", (AXES,), "", "row x of the block left by right vertex; factored: LR L^-T D^-1"),
    Field("lr_y", (AXES,), "", "row y of that block"),
    Field("lr_t", (AXES,), "", "row psi of that block"),
    Field("rr", (SIX,), "", "block of the right vertex; factored: L D L^T with all elements behind it"),
)  # fmt: skip
"""`CONDENSED`: an element's Newton matrix after its interior coordinates are condensed to its two vertices."""
LL, LR_X, LR_Y, LR_T, RR, _ = CONDENSED.places

CIRCLE = Layout("Circle", "", Field("sine", (), "", "of psi"), Field("cosine", (), "", "of psi"))
*_, PAIR = CIRCLE.places

_INNER = f"({AXES} * order - {AXES})"
ELEMENT_FACTORS = Layout(
    "ElementFactors", "order",
    Field(
        "interior", (f"{_INNER} * ({_INNER} - 1) // 2 + {_INNER} * (1 + 2 * {AXES})",), "",
        "for each interior coordinate: 1 / pivot, then couplings over the pivot to later ones and to both vertices",
    ),
    Field("condensed", (CONDENSED.length,), "", "a `CONDENSED`"),
    Field("circle", ("order", PAIR), "", "a `CIRCLE` for each Gauss point, written before the forces"),
)  # fmt: skip
HINGE = Layout(
    "Hinge", "",
    Field("pinned", (), "", "1: the hinge angle delta does not move, 0: it is free"),
    Field("x", (), "", "coupling of psi + delta with x, over the pivot"),
    Field("y", (), "", "coupling of psi + delta with y, over the pivot"),
    Field("inverse", (), "", "1 / pivot of psi + delta"),
    Field("own", (), "", "joint stiffness that a jointed arm adds to delta; factored: over the pivot"),
)  # fmt: skip
FACTORS = Layout(
    "Factors", "links, elements, order",
    Field("pinned", (AXES,), "", "1: x, y or psi of the root does not move, 0: it is free"),
    Field("root", (SIX,), "", "factored `SYMMETRIC` of the root vertex"),
    Field("hinges", ("links - 1", HINGE.length), "", "a `HINGE` each"),
    Field("elements", ("links", "elements", ELEMENT_FACTORS.length), "", "an `ELEMENT_FACTORS` each"),
)  # fmt: skip
"""`FACTORS`: layout of S, the Newton matrix, which `factor` replaces by its factors."""

OF_HINGE = HINGE.places
LEVER_FACTORS = Layout(
    "LeverFactors", "",
    Field("x", (), "m", "derivative of the far point's x by the lever's angle, -e_y"),
    Field("y", (), "m", "derivative of the far point's y by the lever's angle, e_x"),
    Field("far", (), "", "mass at the far point times the matrix's weight of M"),
    Field("mass", (), "", "the lever's own mass times that weight"),
    Field("turn", (), "", "entry of its angle: weighted inertia about its middle, less geometric stiffness"),
)  # fmt: skip
"""Terms of a lever in the Newton matrix: behind `FACTORS`, for each link's root and tip, then an eccentric payload."""

# offsets as constants, so that the compiler folds them into addresses

_OF_SECTION, _OF_ELBOW = SECTION.places, ELBOW.places
_LEVER = LEVER.places.end
_chain_at = kernel(CHAIN.offsets)
_factors_at = kernel(FACTORS.offsets)
element_at = kernel(ELEMENT.offsets)
_varying_at = kernel(VARYING.offsets)
element_factors_at = kernel(ELEMENT_FACTORS.offsets)


@kernel
def lever_at(k, end):
    """Return the offset in `model.rigid` of the `LEVER` of an end (0: root, 1: tip) of link k."""
    return _LEVER * (2 * k + end)


@kernel
def rows_of(model):
    """Return the first row of each field of CHAIN: elements, tip vertex, hinges."""
    return _chain_at(0, model.links, model.elements, len(model.order))


@kernel
def vertex_of(model, k):
    """Return the row of coordinate x of link k's first vertex, or of the arm's last vertex for k = links."""
    return rows_of(model).elements + AXES * len(model.order) * model.elements * k


@kernel
def root_angle(lane, model, x: Lanes, k):
    """Return the angle (rad) of the section at link k's root from x = q, or its rate (rad/s) from x = v.

    For k = 0 the angle is psi of the root vertex; for k > 0 the angle is psi plus the hinge angle delta.
    """
    i = vertex_of(model, k)
    if k > 0:
        return x[i + T] + x[rows_of(model).hinges + k - 1]
    return x[i + T]


@kernel
def factors_of(model):
    """Return the offset in S at which each field of FACTORS (pinned, root, hinges, elements) begins."""
    return _factors_at(0, model.links, model.elements, len(model.order))


class Section(NamedTuple):
    """Constants of the elements of a link with one section, as in `SECTION`, and its damping."""

    k1: float  # N/m, EA / 2l
    k2: float  # N/m, C / 2l
    kb: Any  # N m, EI / 2l times the arm's own factor on EI
    length: float  # m, l of an element
    ml: float  # kg, m l / 2
    jl: float  # kg m^2, J l / 2
    own: Any  # further constants of the material laws
    tau: Any  # s, the link's Kelvin-Voigt time constant tau_d; None without damping


class Varying(NamedTuple):
    """Constants of one element whose sections vary, and its damping."""

    numbers: Any  # array that begins with its `VARYING`
    factor: Any  # the arm's own factor on EI
    tau: Any  # s, the link's Kelvin-Voigt time constant tau_d; None without damping
    rest: Any  # rad, (right - left, interior ...) of psi without stress (`ExactBeam.rest`); None: straight


@kernel
def section_of(lane, model, par: Lanes, k):
    """Return the `Section` of link k, or the `Varying` of its first element, with the arm's own EI factor and tau_d.

    par: the arm's own parameters. tau_d (s) is None in a model without damping.
    """
    # tau_d of the link: its share of the arm's own
    if model.damped is None:
        tau = None
    else:
        tau = scaled_by_share(model.damped, k, par[TAU_D])
    # varying sections: arrays that begin at the link's first element
    if model.varying is not None:
        numbers = model.sections[_varying_at(0, len(model.order)).end * model.elements * k :]
        factor = par[STIFFNESS_FACTOR]
        if model.rest is None:
            return Varying(numbers, factor, tau, None)
        return Varying(numbers, factor, tau, model.rest[len(model.order) * model.elements * k :])
    at, of = _OF_SECTION.end * k, model.sections
    return Section(
        of[at + _OF_SECTION.k1], of[at + _OF_SECTION.k2], par[STIFFNESS_FACTOR] * of[at + _OF_SECTION.kb],
        of[at + _OF_SECTION.length], of[at + _OF_SECTION.ml], of[at + _OF_SECTION.jl], of[at + _OF_SECTION.own :], tau,
    )  # fmt: skip


@kernel
def next_section(model, section):
    """Return the constants of a link's next element: the same `Section`, or the next `Varying` in the model's array.

    section: constants of the current element, a `Section` or a `Varying`.
    """
    if model.varying is None:
        return section
    numbers = section.numbers[_varying_at(0, len(model.order)).end :]
    if model.rest is None:
        return Varying(numbers, section.factor, section.tau, None)
    return Varying(numbers, section.factor, section.tau, section.rest[len(model.order) :])


class ElbowInertia(NamedTuple):
    """Inertia of an elbow, as in `ELBOW`."""

    mass: float  # kg, at the joint
    left: float  # kg m^2, turns with the tip before the joint
    right: float  # kg m^2, turns with the root behind the joint


@kernel
def elbow_of(model, k):
    """Return the `ElbowInertia` of the joint before link k, k = 1 ... links - 1."""
    at, of = _OF_ELBOW.end * (k - 1), model.elbows
    return ElbowInertia(of[at + _OF_ELBOW.mass], of[at + _OF_ELBOW.left], of[at + _OF_ELBOW.right])


class Vertex(NamedTuple):
    """State of a vertex between two elements; each field has components x, y (inertial axes) and psi."""

    place: tuple[Any, Any, Any]  # m, m, rad
    rate: tuple[Any, Any, Any]  # m/s, m/s, rad/s; read by a damped model alone
    acceleration: tuple[Any, Any, Any]  # m/s^2, m/s^2, rad/s^2; less gravity
    force: tuple[Any, Any, Any]  # N, N, N m: rows of the residual summed so far
