"""Where things are in a floating-frame Model's arrays: in `table` (a row a body), `data` (a block a body) and S."""

from __future__ import annotations

from ...compiler.decorator import kernel
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
    Field("S_bar", (2, "n"), "kg", "elastic part of the first moments"),
    Field("c_u", ("n",), "kg m", "I = I0 + 2 c_u'q + q'G q"),
    Field("c", ("n",), "kg m", "angular momentum (c + B q)'q'"),
    Field("tip", (3, "n"), "", "u, v, phi at the tip"),
    Field("G", ("n", "n"), "kg", ""),
    Field("M_ff", ("n", "n"), "kg", "elastic mass matrix"),
    Field("B", ("n", "n"), "kg", "skew"),
    Field("K_axial", ("n", "n"), "N/m", "stretching part of the linear stiffness"),
    Field("K_bend", ("n", "n"), "N/m", "bending part"),
    Field("D0", ("n", "n"), "kg", "foreshortening in the first moment"),
    Field("tip_H", ("n", "n"), "1/m", "foreshortening of the tip"),
    Field("drag", (), "1/s", "damping that goes with mass"),
    Field("root", ("n",), "", "rho: the root section is turned by rho'q against the frame"),
    Field("spans", ("elements", SPAN.length), "", "a `SPAN` each"),
    Field("stations", ("stations", STATION.length), "", "a `STATION` each"),
)  # fmt: skip
body_at = kernel(BODY.offsets)
station_at = kernel(STATION.offsets)

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
    Field("arm", (2, "n + 1"), "", "change of the tip's place by q and by the frame's angle"),
    Field("swept", (2, "n + 1"), "", "change of its acceleration"),
    Field("matrix", ("n + 3", "n + 3"), "", "of q, the origin's acceleration and the angle; then its factors"),
)  # fmt: skip
JOINT = Layout(
    "Joint", "",
    Field("pinned", (), "", "1: held"),
    Field("column", (2,), "", "of what is behind, by the angle, over the pivot"),
    Field("row", (2,), "", "by x and y, over the pivot"),
    Field("inverse", (), "", "of the pivot"),
).places  # fmt: skip
ROOT = Layout(
    "Root", "",
    Field("pinned", (3,), "", "x, y, angle: 1: held"),
    Field("scale", (2,), "", "cm and its inverse"),
    Field("tail", (2,), "", "cm times the payload's inertia, and its mass"),
    Field("factors", (3, 3), "", "of what all is to the root"),
).places  # fmt: skip
factors_at = kernel(FACTORS.offsets)


@kernel
def window(model, n, e):
    """First elastic coordinate of an element's window (`model`: a Mesh of n of them)."""
    first = 3 * e - 3
    if model.chord is not None:
        first = min(3 * e - 2, n - len(model.window))
    return max(first, 0)
