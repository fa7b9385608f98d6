"""Where things are in a floating-frame Model's arrays: in `table` (a row a body), `data` (a block a body) and S.

Components that kernels read together (`arithmetic.pair`, `vector`) are fields side by side, in that order.
"""

from ...compiler import kernel, size
from ...layout import Field, Layout

ROW = Layout(
    "Row", "",
    Field("start", (), "", "first row in the system"),
    Field("size", (), "", "elastic coordinates n"),
    Field("link", (), "", "number of the link that it is part of"),
    Field("multipliers", (), "", "of the joint behind it: 0, 2 (hinge), 3 (with angle)"),
    Field("motion", (), "", "that prescribes that joint's angle; -1: rigid"),
)  # fmt: skip
START, SIZE, LINK, MULTIPLIERS, MOTION, _ = ROW.places

ANGLE, ELASTIC = 2, 3
"""Behind x and y of a frame comes its angle, behind that its elastic coordinates."""

LEVER_FACTORS = Layout(
    "LeverFactors", "",
    *(Field(name, (), "m", "along the beam's tangent") for name in ("ex", "ey")),
    *(Field(name, (), "", "of the near point now") for name in ("rate", "second", "ax", "ay")),
    *(Field(name, (), "m", "across it; this and the rest of the last matrix") for name in ("nx", "ny")),
    *(Field(name, (), "", "change of the far point's acceleration by the angle") for name in ("wx", "wy")),
    Field("turn", (), "", "what resists its turning by itself"),
)  # fmt: skip
"""Behind the bodies' factors in S, for each link's root and tip."""

SPAN = Layout(
    "Span", "window",
    Field("stiffness", (), "N/m", "EA / l"),
    Field("stretch", ("window",), "", "g: the linear stretch (u2 - u1) of a finite element is g'q of its window"),
    Field("H", ("window", "window"), "1/m", "its stretch of second order is q'H q / 2 (von Karman), or G of eq. [45]"),
)  # fmt: skip
STATION = Layout(
    "Station", "n",
    Field("x", (), "m", "along the axis"),
    Field("u", ("n",), "", "shape along the axis"),
    Field("v", ("n",), "", "and across it"),
    Field("H", ("n", "n"), "1/m", "foreshortening: u -= q'H q / 2"),
)  # fmt: skip
BODY = Layout(
    "Body", "n, window, elements, stations",
    Field("length", (), "m", ""),
    Field("mass", (), "kg", "m_t"),
    Field("S0", (), "kg m", "first moment along the axis"),
    Field("I0", (), "kg m^2", "inertia about the root"),
    Field("offset", (), "rad", "angle of the rigid joint behind it"),
    Field("most_lost", (), "kg m^2", "inertia about the root that foreshortening may take; inf: as much as it likes"),
    Field("S_bar_x", ("n",), "kg", "elastic part of the first moment along the axis"),
    Field("S_bar_y", ("n",), "kg", "and across it"),
    Field("c_u", ("n",), "kg m", "I = I0 + 2 c_u'q + q'G q"),
    Field("c", ("n",), "kg m", "angular momentum (c + B q)'q'"),
    Field("tip_u", ("n",), "", "shape along the axis at the tip"),
    Field("tip_v", ("n",), "", "across it"),
    Field("tip_phi", ("n",), "1/m", "and of the section's angle"),
    Field("G", ("n", "n"), "kg", ""),
    Field("M_ff", ("n", "n"), "kg", "elastic mass matrix"),
    Field("B", ("n", "n"), "kg", "skew"),
    Field("K_axial", ("n", "n"), "N/m", "stretching part of the linear stiffness"),
    Field("K_bend", ("n", "n"), "N/m", "bending part"),
    Field("D0", ("n", "n"), "kg", "foreshortening in the first moment"),
    Field("tip_H", ("n", "n"), "1/m", "foreshortening of the tip"),
    Field("drag", (), "1/s", "damping that goes with mass"),
    Field("damped", (), "", "share of tau_d, where links differ"),
    Field("root", ("n",), "", "rho: the root section is turned by rho'q against the frame"),
    Field("moment", ("n",), "", "K_bend q of q without stress"),
    Field("spent", (), "J", "half that times q: bending energy of q = 0"),
    Field("spans", ("elements", SPAN.length), "", "a `SPAN` each"),
    Field("stations", ("stations", STATION.length), "", "a `STATION` in lanes for each eight, the widest there are"),
)  # fmt: skip
body_at = kernel(BODY.offsets)
station_at = kernel(STATION.offsets)
span_at = kernel(SPAN.offsets)

NOW = Layout(
    "Now", "",
    Field("cos", (), "", "of the frame's angle"),
    Field("sin", (), "", ""),
    Field("a", (2,), "m/s^2", "acceleration of its origin less gravity; this and the rest in its axes"),
    Field("rate", (), "rad/s", "of its angle"),
    Field("second", (), "rad/s^2", ""),
    Field("tip", (2,), "m", "where the tip is"),
    Field("tip_rate", (2,), "m/s", "how it moves against the origin"),
    Field("tip_second", (2,), "m/s^2", "its acceleration less the origin's"),
).places  # fmt: skip
PASSED = Layout(
    "Passed", "",
    Field("angle", (), "rad", "of a section"),
    Field("rate", (), "rad/s", ""),
    Field("second", (), "rad/s^2", ""),
    Field("ax", (), "m/s^2", "its acceleration less gravity, global axes"),
    Field("ay", (), "m/s^2", ""),
).places  # fmt: skip
FRAME = Layout(
    "Frame", "",
    Field("cos", (), "", "of a body's frame"),
    Field("sin", (), "", ""),
    Field("vx", (), "m/s", "velocity of its origin, in its axes"),
    Field("vy", (), "m/s", ""),
    Field("rate", (), "rad/s", ""),
).places  # fmt: skip
VECTORS = Layout(
    "Vectors", "n",
    Field("gq", ("n",), "kg m", "c_u + G q"),
    Field("cb", ("n",), "kg m", "c + B q"),
    Field("bv", ("n",), "kg m/s", "B q'"),
    Field("gsx", ("n",), "kg", "change of the first moment along the axis by q"),
    Field("px", ("n",), "", "change of the tip's x by q"),
)  # fmt: skip
STRAIN = Layout(
    "Strain", "window",
    Field("force", (), "N", "of an element, along its axis"),
    Field("slope", ("window",), "", "change of its stretch by its window's coordinates"),
    Field("rate", ("window",), "1/s", "and of the stretch's rate"),
)  # fmt: skip
vectors_at = kernel(VECTORS.offsets)
strain_at = kernel(STRAIN.offsets)
KNOWN = Layout(
    "Known", "",
    Field("d", (2,), "N", "inertia force less mass times the origin's acceleration"),
    Field("s", (2,), "kg m", "first moment"),
    Field("t", (2,), "kg m/s", "its rate in the frame"),
    Field("inertia", (), "kg m^2", "I"),
    Field("spin_rate", (), "kg m^2/s", "I' / 2"),
    Field("g", (2,), "N", "force at the tip"),
).places  # fmt: skip
FACTORS = Layout(
    "Factors", "n",
    Field("now", (NOW.end,), "", "`NOW`, of the last residual"),
    Field("frame", (2,), "", "cosine and sine of the frame's angle, this and the rest of the last matrix"),
    Field("arm", ("n + 1", 2), "", "change of the tip's place by q and by the frame's angle"),
    Field("swept", ("n + 1", 2), "", "change of its acceleration"),
    Field("matrix", ("n + 3", "n + 3"), "", "of q, the origin's acceleration and the angle; then its factors"),
)  # fmt: skip


@kernel
def cell(i, j):
    """Place of an entry of a matrix of three rows and columns, kept by rows: of x, y and the angle."""
    return 3 * i + j


JOINT = Layout(
    "Joint", "",
    Field("pinned", (), "", "1: held"),
    Field("column", (2,), "", "of what is behind, by the angle, over the pivot"),
    Field("row", (2,), "", "by x and y, over the pivot"),
    Field("inverse", (), "", "of the pivot"),
    Field("own", (), "", "what a jointed arm adds to its row; factored: the same over the pivot"),
).places  # fmt: skip
ROOT = Layout(
    "Root", "",
    Field("pinned", (3,), "", "x, y, angle: 1: held"),
    Field("scale", (2,), "", "cm and its inverse"),
    Field("tail", (2,), "", "cm times the payload's inertia, and its mass"),
    Field("own", (), "", "what a jointed arm adds to the hub's row"),
    Field("factors", (3, 3), "", "of what all is to the root"),
).places  # fmt: skip
LOADED = Layout(
    "Loaded", "", Field("link", (), "", "that a point load acts on"), Field("side", (), "", "its end: 0 root, 1 tip")
).places
factors_at = kernel(FACTORS.offsets)


@kernel
def acts_at(loads, f, link, end):
    """Whether point load f acts at that end of a link."""
    at = LOADED.end * f
    return loads[at + LOADED.link] == link and loads[at + LOADED.side] == end


@kernel
def window(model, n, e):
    """First elastic coordinate of an element's window (`model`: a Mesh of n of them)."""
    first = 3 * e - 3
    if model.chord is not None:
        first = min(3 * e - 2, n - len(model.window))
    return max(first, 0)


@kernel
def elastic_row(model, b):
    """Row of the first elastic coordinate of body b in a chain, behind the root's x, y and angle."""
    return ELASTIC + size(model.mesh.n) * b


@kernel
def elbow_row(model, k):
    """Row of the angle of elbow k, from 1 on, in a chain: behind all bodies."""
    return elastic_row(model, model.links * model.segments) + k - 1
