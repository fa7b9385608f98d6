"""Where things are in a floating-frame Model's arrays: a body's row in `table`, its constants in `data`."""

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
    Field("elements", (), "", "finite elements; 0: reduced to modes"),
    Field("stations", (), "", "points that it is drawn through"),
    Field("block", (), "", "where its constants begin in `data`"),
)  # fmt: skip
START, SIZE, LINK, MULTIPLIERS, MOTION, ELEMENTS, STATIONS, BLOCK, _ = ROW.places

ELEMENT = Layout(
    "Element", "",
    Field("stiffness", (), "N/m", "EA / l"),
    Field("G", (4, 4), "1/m", "of eq. [45] on (v1, phi1, v2, phi2); H for von Karman"),
)  # fmt: skip
STATION = Layout(
    "Station", "n",
    Field("x", (), "m", "along the axis"),
    Field("u", ("n",), "", "shape along the axis"),
    Field("v", ("n",), "", "and across it"),
    Field("H", ("n", "n"), "1/m", "foreshortening: u -= q'H q / 2"),
)  # fmt: skip
BODY = Layout(
    "Body", "n, elements, stations",
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
    Field("elements", ("elements", ELEMENT.length), "", "an `ELEMENT` each"),
    Field("stations", ("stations", STATION.length), "", "a `STATION` each"),
)  # fmt: skip

OF_ELEMENT = ELEMENT.places
_body_at = kernel(BODY.offsets)
station_at = kernel(STATION.offsets)


@kernel
def constants(m, body):
    """Where a body's constants are in `data`: the fields of BODY."""
    t = m.table
    return _body_at(t[body, BLOCK], t[body, SIZE], t[body, ELEMENTS], t[body, STATIONS])
