"""Where things are in a chain of geometrically exact beams: coordinates, factors of the tangent, constants.

Components that kernels read together (`arithmetic.pair`, `vector`) are fields side by side, in that order.
"""

from typing import Any, NamedTuple

from ...compiler import kernel, load
from ...layout import Field, Layout
from ..arithmetic import share_of
from ..layout import LEVER
from ..materials import BENDING, NORMAL_AND_SHEAR
from ..model import STIFFNESS_FACTOR, TAU_D

NODE = Layout(
    "Node", "",
    Field("x", (), "m", ""),
    Field("y", (), "m", ""),
    Field("psi", (), "rad", "of the section; a link's first one has the hinge's angle beside it"),
)  # fmt: skip
X, Y, T, AXES = NODE.places

ELEMENT = Layout(
    "Element", "order",
    Field("left", (AXES,), "", "vertex"),
    Field("interior", ("order - 1", AXES), "", "amplitudes of the interior functions"),
    Field("right", (AXES,), "", "vertex, the next element's left one"),
)  # fmt: skip
"""Coordinates of one element."""

CHAIN = Layout(
    "Chain", "links, elements, order",
    Field("elements", ("links", "elements", "order", AXES), "", "an `ELEMENT` each, less its right vertex"),
    Field("tip", (AXES,), "", "the last vertex"),
    Field("hinges", ("links - 1",), "rad", "angle of a link's root less psi of the tip before it"),
)  # fmt: skip
"""Rows of the system."""

OWN = len(NORMAL_AND_SHEAR) + len(BENDING)
SECTION = Layout(
    "Section", "",
    Field("k1", (), "N/m", "EA / 2l"),
    Field("k2", (), "N/m", "C / 2l"),
    Field("kb", (), "N m", "EI / 2l"),
    Field("length", (), "m", "l of an element"),
    Field("ml", (), "kg", "m l / 2"),
    Field("jl", (), "kg m^2", "J l / 2"),
    Field("own", (OWN,), "", "what its laws have besides (`materials`)"),
)  # fmt: skip
VARYING = Layout(
    "Varying", "order",
    Field("length", (), "m", "l of this element"),
    Field("stretch", ("order",), "N/m", "EA / 2l at the Gauss points"),
    Field("shear", ("order",), "N/m", "C / 2l there"),
    Field("bend", ("order", "order"), "N m", "int EI of products of the slopes (`Tables`), over l^2"),
    Field("mass", ("order + 1", "order + 1"), "kg", "int m of products of the functions"),
    Field("rotary", ("order + 1", "order + 1"), "kg m^2", "int J of them"),
    Field("bending", ("order",), "N m", "EI / 2l at the Gauss points"),
    Field("own", ("order", OWN), "", "what the laws have besides there (`materials`)"),
)  # fmt: skip
"""What stands for a `SECTION` in each element of an arm whose sections vary."""

ELBOW = Layout(
    "Elbow", "",
    Field("mass", (), "kg", ""),
    Field("left", (), "kg m^2", "inertia that turns with the tip before it"),
    Field("right", (), "kg m^2", "inertia that turns with the root behind it"),
)  # fmt: skip
LEVERS = Layout(
    "Levers", "links, loads",
    Field("levers", ("links", 2, LEVER.length), "", "a `LEVER` for each link's root and tip"),
    Field("loads", ("loads",), "m", "of each point load, along psi of the vertex it works on"),
)  # fmt: skip
"""Rigid ends of the links."""

ROWS_OF_LOAD = Layout(
    "RowsOfLoad", "",
    Field("x", (), "", "row of the point's x"),
    Field("y", (), "", "of its y"),
    Field("psi", (), "", "of its angle"),
    Field("hinge", (), "", "of a hinge's angle to be added to that; -1: none"),
).places  # fmt: skip

SYMMETRIC = Layout("Symmetric", "", *(Field(name, (), "", "") for name in ("xx", "xy", "xt", "yy", "yt", "tt")))
"""A symmetric matrix of x, y, psi; factored L D L': 1 / D in the diagonal's places, L in the others."""
XX, XY, XT, YY, YT, TT, SIX = SYMMETRIC.places

CONDENSED = Layout(
    "Condensed", "",
    Field("ll", (SIX,), "", "left vertex by itself"),
    Field("lr_x", (AXES,), "", "row x of the left vertex by the right one; factored: over the right one's pivots"),
    Field("lr_y", (AXES,), "", "row y"),
    Field("lr_t", (AXES,), "", "row psi"),
    Field("rr", (SIX,), "", "right vertex by itself, with all that hangs on it when it is factored"),
)  # fmt: skip
"""Tangent of an element without its interior."""
LL, LR_X, LR_Y, LR_T, RR, _ = CONDENSED.places

CIRCLE = Layout("Circle", "", Field("sine", (), "", "of psi"), Field("cosine", (), "", ""))
*_, PAIR = CIRCLE.places

_INNER = f"({AXES} * order - {AXES})"
ELEMENT_FACTORS = Layout(
    "ElementFactors", "order",
    Field(
        "interior", (f"{_INNER} * ({_INNER} - 1) // 2 + {_INNER} * (1 + 2 * {AXES})",), "",
        "of each interior coordinate: inverse pivot, couplings over it to later ones and to both vertices",
    ),
    Field("condensed", (CONDENSED.length,), "", "a `CONDENSED`"),
    Field("circle", ("order", PAIR), "", "a `CIRCLE` for each Gauss point"),
)  # fmt: skip
HINGE = Layout(
    "Hinge", "",
    Field("pinned", (), "", "1: its angle does not move"),
    Field("x", (), "", "coupling of its angle with x, over the pivot"),
    Field("y", (), "", "with y"),
    Field("inverse", (), "", "1 / pivot"),
    Field("own", (), "", "what a jointed arm adds to its row; factored: the same over the pivot"),
)  # fmt: skip
FACTORS = Layout(
    "Factors", "links, elements, order",
    Field("pinned", (AXES,), "", "1: that coordinate of the root does not move"),
    Field("root", (SIX,), "", "factored `SYMMETRIC` of the root"),
    Field("hinges", ("links - 1", HINGE.length), "", "a `HINGE` each"),
    Field("elements", ("links", "elements", ELEMENT_FACTORS.length), "", "an `ELEMENT_FACTORS` each"),
)  # fmt: skip
"""S: the iteration matrix and what `factor` makes of it."""

OF_HINGE = HINGE.places
LEVER_FACTORS = Layout(
    "LeverFactors", "",
    Field("x", (), "m", "how its far point moves where it turns"),
    Field("y", (), "m", ""),
    Field("far", (), "", "mass at its far point, in the matrix"),
    Field("mass", (), "", "its own"),
    Field("turn", (), "", "what resists its turning by itself"),
)  # fmt: skip
"""Behind `FACTORS`, for each link's root and tip."""

_OF_SECTION, _OF_ELBOW = SECTION.places, ELBOW.places
_LEVER = LEVER.places.end
_chain_at = kernel(CHAIN.offsets)
_factors_at = kernel(FACTORS.offsets)
element_at = kernel(ELEMENT.offsets)
_varying_at = kernel(VARYING.offsets)
element_factors_at = kernel(ELEMENT_FACTORS.offsets)


@kernel
def lever_at(k, end):
    """Where the `LEVER` of an end (0: root, 1: tip) of link k begins."""
    return _LEVER * (2 * k + end)


@kernel
def rows_of(model):
    """Where the parts of CHAIN begin."""
    return _chain_at(0, model.links, model.elements, len(model.order))


@kernel
def vertex_of(model, k):
    """Row of the vertex that link k begins at; of the last one for k = links."""
    return rows_of(model).elements + AXES * len(model.order) * model.elements * k


@kernel
def root_angle(lane, model, x, k):
    """psi, or its rate, of the section at the root of link k."""
    i = vertex_of(model, k)
    if k > 0:
        return load(lane, x, i + T) + load(lane, x, rows_of(model).hinges + k - 1)
    return load(lane, x, i + T)


@kernel
def factors_of(model):
    """Where the parts of FACTORS begin."""
    return _factors_at(0, model.links, model.elements, len(model.order))


class Section(NamedTuple):
    """Constants of a link's elements: `SECTION`, an arm's own factor in kb; tau_d (s), or None without damping."""

    k1: float
    k2: float
    kb: Any
    length: float
    ml: float
    jl: float
    own: Any
    tau: Any


class Varying(NamedTuple):
    """Of an element whose sections vary: its numbers of `VARYING`, an arm's own factor on EI, and `Section.tau`; its
    bending without stress (`ExactBeam.rest`), or None."""

    numbers: Any
    factor: Any
    tau: Any
    rest: Any


@kernel
def section_of(lane, model, par, k):
    """The `Section` of link k, or the `Varying` of its first element."""
    if model.damped is None:
        tau = None
    else:
        tau = share_of(model.damped, k, load(lane, par, TAU_D))
    if model.varying is not None:
        numbers = model.sections[_varying_at(0, len(model.order)).end * model.elements * k :]
        factor = load(lane, par, STIFFNESS_FACTOR)
        if model.rest is None:
            return Varying(numbers, factor, tau, None)
        return Varying(numbers, factor, tau, model.rest[len(model.order) * model.elements * k :])
    at, of = _OF_SECTION.end * k, model.sections
    return Section(
        of[at + _OF_SECTION.k1], of[at + _OF_SECTION.k2], load(lane, par, STIFFNESS_FACTOR) * of[at + _OF_SECTION.kb],
        of[at + _OF_SECTION.length], of[at + _OF_SECTION.ml], of[at + _OF_SECTION.jl], of[at + _OF_SECTION.own :], tau,
    )  # fmt: skip


@kernel
def next_section(model, section):
    """That of the link's next element."""
    if model.varying is None:
        return section
    numbers = section.numbers[_varying_at(0, len(model.order)).end :]
    if model.rest is None:
        return Varying(numbers, section.factor, section.tau, None)
    return Varying(numbers, section.factor, section.tau, section.rest[len(model.order) :])


class ElbowInertia(NamedTuple):
    """The numbers of `ELBOW`."""

    mass: float
    left: float
    right: float


@kernel
def elbow_of(model, k):
    """The elbow in front of link k, from 1."""
    at, of = _OF_ELBOW.end * (k - 1), model.elbows
    return ElbowInertia(of[at + _OF_ELBOW.mass], of[at + _OF_ELBOW.left], of[at + _OF_ELBOW.right])


class Vertex(NamedTuple):
    """What one element hands on to the next; x, y, psi in each."""

    place: tuple[Any, Any, Any]
    rate: tuple[Any, Any, Any]
    acceleration: tuple[Any, Any, Any]  # less gravity
    force: tuple[Any, Any, Any]  # on it so far
