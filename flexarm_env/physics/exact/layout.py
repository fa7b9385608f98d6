"""Layouts and records of a chain of geometrically exact beams: coordinates, constants, Newton matrix, factors.

Components that kernels load together (`arithmetic.load_pair`, `load_vector`) are adjacent fields in the loaded order.
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
    Field("x", (), "m", "x of the vertex, inertial axes"),
    Field("y", (), "m", "y of the vertex, inertial axes"),
    Field("psi", (), "rad", "psi: section angle; beyond a hinge the section's angle is psi + delta"),
)  # fmt: skip
X, Y, T, AXES = NODE.places

ELEMENT = Layout(
    "Element", "order",
    Field("left", (AXES,), "", "x (m), y (m), psi (rad) of the left vertex"),
    Field("interior", ("order - 1", AXES), "", "amplitudes of the interior functions in x, y (m) and psi (rad)"),
    Field("right", (AXES,), "", "x (m), y (m), psi (rad) of the right vertex, which is the next element's left vertex"),
)  # fmt: skip
"""`ELEMENT`: order of the coordinates of one element in q, v, a and r."""

CHAIN = Layout(
    "Chain", "links, elements, order",
    Field("elements", ("links", "elements", "order", AXES), "", "an `ELEMENT` each, without its right vertex"),
    Field("tip", (AXES,), "", "x (m), y (m), psi (rad) of the last vertex"),
    Field("hinges", ("links - 1",), "rad", "delta: angle of a link's root section minus psi of the preceding tip"),
)  # fmt: skip
"""`CHAIN`: rows of the coordinates in q, v, a and r, from root to tip."""

# constants: EA, C, EI over 2 l, because d and kappa are derivatives by xi in [-1, 1]; m, J times l / 2

OWN = len(NORMAL_AND_SHEAR) + len(BENDING)
SECTION = Layout(
    "Section", "",
    Field("EA_2l", (), "N/m", "stretching stiffness EA / 2l"),
    Field("C_2l", (), "N/m", "shear stiffness C / 2l"),
    Field("EI_2l", (), "N m", "bending stiffness EI / 2l"),
    Field("length", (), "m", "length l of an element"),
    Field("ml", (), "kg", "m l / 2 with the mass m per length"),
    Field("jl", (), "kg m^2", "J l / 2 with the rotary inertia J per length"),
    Field("own", (OWN,), "", "further constants of the material laws (`materials.NORMAL_AND_SHEAR`, `BENDING`)"),
)  # fmt: skip
"""`SECTION`: constants of each element of a link with one section."""
VARYING = Layout(
    "Varying", "order",
    Field("length", (), "m", "length l of this element"),
    Field("EA_2l", ("order",), "N/m", "stretching stiffness EA / 2l at the Gauss points"),
    Field("C_2l", ("order",), "N/m", "shear stiffness C / 2l at the Gauss points"),
    Field("K_EI", ("order", "order"), "N m", "bending stiffness int EI d_i d_j ds / l^2; d: slopes (`tables.Tables`)"),
    Field("mass", ("order + 1", "order + 1"), "kg",
          "int m f_i f_j ds; f: shape functions of the nodes (`tables.Tables`)"),
    Field("rotary", ("order + 1", "order + 1"), "kg m^2", "int J f_i f_j ds: rotary inertia"),
    Field("EI_2l", ("order",), "N m", "EI / 2l at the Gauss points; read for a nonlinear law M(kappa)"),
    Field("own", ("order", OWN), "", "further constants of the material laws at the Gauss points"),
)  # fmt: skip
"""`VARYING`: constants of one element in an arm whose sections vary; used instead of `SECTION`."""

ELBOW = Layout(
    "Elbow", "",
    Field("mass", (), "kg", "mass at the joint"),
    Field("left", (), "kg m^2", "rotary inertia of the part that rotates with the tip before the joint"),
    Field("right", (), "kg m^2", "rotary inertia of the part that rotates with the root beyond the joint"),
)  # fmt: skip
LEVERS = Layout(
    "Levers", "links, loads",
    Field("levers", ("links", 2, LEVER.length), "", "a `LEVER` for each link's root and tip"),
    Field("loads", ("loads",), "m", "lever of each point load, from its vertex along psi"),
)  # fmt: skip
"""`LEVERS`: constants of the links' rigid ends."""

ROWS_OF_LOAD = Layout(
    "RowsOfLoad", "",
    Field("x", (), "", "row of coordinate x of the loaded vertex"),
    Field("y", (), "", "row of coordinate y of the loaded vertex"),
    Field("psi", (), "", "row of the angle psi of the loaded vertex"),
    Field("hinge", (), "", "row of the hinge angle delta if the load acts beyond a hinge; otherwise -1"),
).places  # fmt: skip
"""`ROWS_OF_LOAD`: the rows of CHAIN on which a point load acts."""

# S: blocks by x, y (inertial axes) and psi; symmetric ones hold six numbers

SYMMETRIC = Layout("Symmetric", "", *(Field(name, (), "", "") for name in ("xx", "xy", "xt", "yy", "yt", "tt")))
"""A symmetric 3x3 matrix on (x, y, psi), with t for psi. Factoring replaces it by L D L^T: 1 / D on the diagonal, and
L."""
XX, XY, XT, YY, YT, TT, SIX = SYMMETRIC.places

CONDENSED = Layout(
    "Condensed", "",
    Field("ll", (SIX,), "", "block of the left vertex: a `SYMMETRIC`"),
    Field("lr_x", (AXES,), "", "row x of the block (left vertex, right vertex); after factoring LR L^-T D^-1"),
    Field("lr_y", (AXES,), "", "row y of the block (left vertex, right vertex)"),
    Field("lr_t", (AXES,), "", "row psi of the block (left vertex, right vertex)"),
    Field("rr", (SIX,), "", "block of the right vertex; after factoring L D L^T, with all elements beyond"),
)  # fmt: skip
"""`CONDENSED`: an element's Newton matrix after elimination of its interior coordinates; only the vertices remain."""
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
    Field("pinned", (), "", "1: the hinge angle delta is fixed; 0: it is free"),
    Field("x", (), "", "coupling of psi + delta with x, over the pivot"),
    Field("y", (), "", "coupling of psi + delta with y, over the pivot"),
    Field("inverse", (), "", "reciprocal of the pivot of psi + delta"),
    Field("own", (), "", "joint stiffness of a jointed arm on delta; after factoring divided by the pivot"),
)  # fmt: skip
FACTORS = Layout(
    "Factors", "links, elements, order",
    Field("pinned", (AXES,), "", "1: x, y or psi of the root is fixed; 0: it is free"),
    Field("root", (SIX,), "", "`SYMMETRIC` matrix of the root vertex, after factoring"),
    Field("hinges", ("links - 1", HINGE.length), "", "one `HINGE` for each link but the first"),
    Field("elements", ("links", "elements", ELEMENT_FACTORS.length), "", "one `ELEMENT_FACTORS` for each element"),
)  # fmt: skip
"""`FACTORS`: layout of S, the Newton matrix, which `factor` replaces by its factors."""

OF_HINGE = HINGE.places
LEVER_FACTORS = Layout(
    "LeverFactors", "",
    Field("x", (), "m", "-e_y: derivative of the far point's x by the lever's angle; e: lever vector"),
    Field("y", (), "m", "e_x: derivative of the far point's y by the lever's angle"),
    Field("far", (), "", "mass at the far point times the weight of M in the Newton matrix"),
    Field("mass", (), "", "mass of the lever itself times the weight of M in the Newton matrix"),
    Field("turn", (), "",
          "diagonal entry of the lever's angle: weighted inertia about its middle, minus geometric stiffness"),
)  # fmt: skip
"""Terms of a lever in the Newton matrix. They follow `FACTORS`, for each link's root and tip, then for a payload's
lever."""

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
    """Return the first row of each field of CHAIN: elements, tip vertex, hinge angles."""
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

    EA_2l: float  # N/m, EA / 2l: stretching stiffness
    C_2l: float  # N/m, C / 2l: shear stiffness
    EI_2l: Any  # N m, EI / 2l times the arm's own factor on EI: bending stiffness
    length: float  # m, length l of an element
    ml: float  # kg, m l / 2 with the mass per length m
    jl: float  # kg m^2, J l / 2 with the rotary inertia per length J
    own: Any  # further constants of the material laws
    tau: Any  # s, the link's Kelvin-Voigt time constant tau_d; None without damping


class Varying(NamedTuple):
    """Constants of one element whose sections vary, and its damping."""

    numbers: Any  # array that begins with the element's `VARYING`
    factor: Any  # the arm's own factor on EI
    tau: Any  # s, the link's Kelvin-Voigt time constant tau_d; None without damping
    rest: Any  # rad, stress-free (right - left, interior ...) of psi (`ExactBeam.rest`); None: straight


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
        of[at + _OF_SECTION.EA_2l], of[at + _OF_SECTION.C_2l], par[STIFFNESS_FACTOR] * of[at + _OF_SECTION.EI_2l],
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

    mass: float  # kg, mass at the joint
    left: float  # kg m^2, rotary inertia that rotates with the tip before the joint
    right: float  # kg m^2, rotary inertia that rotates with the root beyond the joint


@kernel
def elbow_of(model, k):
    """Return the `ElbowInertia` of the joint at the root of link k, k = 1 ... links - 1."""
    at, of = _OF_ELBOW.end * (k - 1), model.elbows
    return ElbowInertia(of[at + _OF_ELBOW.mass], of[at + _OF_ELBOW.left], of[at + _OF_ELBOW.right])


class Vertex(NamedTuple):
    """State of a vertex between two elements; each field has components x, y (inertial axes) and psi."""

    place: tuple[Any, Any, Any]  # m, m, rad: position and section angle
    rate: tuple[Any, Any, Any]  # m/s, m/s, rad/s: rates, which only a damped model reads
    acceleration: tuple[Any, Any, Any]  # m/s^2, m/s^2, rad/s^2: acceleration minus gravity
    force: tuple[Any, Any, Any]  # N, N, N m: residual rows, the sum so far
