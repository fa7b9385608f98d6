"""Where things are in the flat arrays of a chain in space: coordinates, constants, the iteration matrix.

Rows: the base's place (x, y, z) and its rotation vector; of each link the angle of the joint at its root, then place
and rotation vector of its vertices, the right end of each element, from root to tip. A link's root is where the vertex
before it is; it is turned by the joint's mount and angle against that. Last come the amplitudes, about x, y and z, of
the inner modes of each segment with a floating frame.
"""

from __future__ import annotations

from ...compiler import kernel
from ...layout import Field, Layout

AXES = 6
"""Rows of a vertex: place, then rotation."""

ELEMENT = Layout(
    "Element", "",
    Field("length", (), "m", "of the element"),
    Field("mass", (3,), "kg", "of its left end, its middle and its right end (Simpson's rule)"),
    Field("inertia", (3,), "kg m^2", "of sections, half of it at each end, about their axes"),
    Field("EA", (), "N", ""),
    Field("shear", (2,), "1/N", "how it gives to shear along y and z"),
    Field("bow", (2,), "1/N", "and to that by bending within the element, of EI, of EI_y"),
    Field("bend", (3,), "N m^2", "GJ, EI_y about y, EI about z"),
    Field("rest", (3,), "", "curvatures times length without stress, about x, y, z"),
    Field("chord", (3,), "", "Gamma without stress; where sections or curvatures vary, and so are the next two"),
    Field("tilt", (2,), "", "of the centre of flexibility about y, about z: distance from the middle over the length"),
    Field("damping", (), "", "its time constant over the arm's largest"),
)  # fmt: skip

POINTS = 4
"""Gauss points of a segment's mass, without inner modes."""

WEIGHT = Layout(
    "Weight", "inner",
    Field("xi", (), "", "where on the segment, from 0 to 1"),
    Field("mass", (), "kg", "of the point"),
    Field("left", (3,), "m", "by what it is off the chord along y, z for rotations phi of the left end: h (phi x e_x)"),
    Field("right", (3,), "m", "likewise, of the right end"),
    Field("inner", ("inner", 3), "m", "of each inner mode"),
)  # fmt: skip

FRAME = Layout(
    "SpatialFrame", "inner, points",
    Field("length", (), "m", "of a segment"),
    Field("pull", (), "N/m", "EA / l"),
    Field("bend", (3, 3), "N m", "K about x, y, z of the rotations (left, left), (left, right), (right, right)"),
    Field("coupling", (3, 3), "m", "likewise H of stretch with bending"),
    Field("moment", (2, 3), "N m", "K phi of the rotations without stress, left and right"),
    Field("spent", (), "J", "half that times these"),
    Field("rotary", (6, 3), "kg m^2", "of sections: (l, l), (l, r), (r, r), (l, frame), (r, frame), (frame, frame)"),
    Field("mass", (3,), "kg", "of the ends' places: (l, l), (l, r), (r, r)"),
    Field("near", (2, 3), "kg m", "of the left place and the rotations left and right, h of `WEIGHT`"),
    Field("far", (2, 3), "kg m", "of the right place"),
    Field("lateral", (3, 3), "kg m^2", "of the rotations, about x, y, z: (l, l), (l, r), (r, r)"),
    Field("points", ("points", WEIGHT.length), "", "a `WEIGHT` each"),
    Field("inner_bend", ("inner", "inner", 3), "N m", "K of the inner modes, which these share with no rotation"),
    Field("inner_coupling", ("inner", "inner + 2", 3), "m", "H by left, right, and the inner modes"),
    Field("inner_lateral", ("inner", "inner + 2", 3), "kg m^2", "likewise"),
    Field("inner_rotary", ("inner", "inner + 3", 3), "kg m^2", "by left, right, frame, and the inner modes"),
    Field("inner_near", ("inner", 3), "kg m", ""),
    Field("inner_far", ("inner", 3), "kg m", ""),
    Field("inner_moment", ("inner", 3), "N m", ""),
    Field("roll", ("inner + 2", "inner + 2", 3), "kg m^2", "of left, right, inner: about y by these about z, ..."),
)  # fmt: skip

BODY = Layout(
    "Body", "",
    Field("mass", (), "kg", "the payload's is the arm's own parameter"),
    Field("there", (), "", "0 where there is none; the payload always is"),
    Field("centre", (3,), "m", "from the place of a section, in its axes"),
    Field("inertia", (3, 3), "kg m^2", "about there"),
)  # fmt: skip

JOINT = Layout(
    "Joint", "",
    Field("axis", (3,), "", "unit vector in the axes of the link's root"),
    Field("mount", (3, 3), "", "axes of the link's root at angle 0 in those of the section before"),
    Field("quaternion", (4,), "", "of the same rotation"),
    Field("before", (3,), "m", "from the place of the section before to the joint, in its axes"),
    Field("beyond", (3,), "m", "from the joint to where the link begins to bend, in the axes of its root"),
    Field("near", (BODY.length,), "", "a `BODY` on the section before"),
    Field("far", (BODY.length,), "", "a `BODY` on the link's root, from where it begins to bend"),
)  # fmt: skip

FACTOR = Layout(
    "Factor", "",
    Field("LL", (6, 6), "", "of an element's tangent, row by row; after `factor` with what lies behind"),
    Field("LR", (6, 6), "", ""),
    Field("RL", (6, 6), "", "after `factor` RR^-1 RL"),
    Field("RR", (6, 6), "", "after `factor` its L and U, pivots inverted"),
    Field("force", (3,), "N", "of an exact element over the section, its middle's axes; of the residual made last"),
    Field("by_place", (3, 3), "N/m", "what that changes by with the right end's place; of the matrix made last"),
    Field("by_left", (3, 3), "N", "with the rotation of the left end"),
    Field("by_right", (3, 3), "N", "with that of the right end"),
)  # fmt: skip

INNER = Layout(
    "Inner", "inner",
    Field("matrix", ("3 * inner", "3 * inner"), "", "of a segment's inner modes, its L and U, pivots inverted"),
    Field("ends", ("3 * inner", 12), "", "of the left and the right end by these, transposed"),
    Field("over", ("3 * inner", 12), "", "of these by the ends, matrix^-1 times that"),
)  # fmt: skip
"""Behind the `FACTOR`s, of each segment."""

HINGE = Layout(
    "Hinge", "",
    Field("turn", (3, 3), "", "axes of the link's root in those of the section before"),
    Field("moment", (3,), "N m", "that the link's root takes, in its axes"),
    Field("force", (3,), "N", "likewise, in the axes of the section before; where there are levers"),
    Field("lever", (3,), "m", "from the section before to the link's beginning, in the axes of that section"),
    Field("frame", (3, 3), "", "axes of the section before"),
    Field("own", (), "N m/rad", "what `stiffen` adds"),
    Field("column", (6,), "", "of the joint's row and column: by the vertex before"),
    Field("row", (6,), "", "over the pivot"),
    Field("pivot", (), "", "inverse"),
    Field("pinned", (), "", "1 where it does not move"),
    Field("shift", (3, 3), "m", "what the beginning moves by when the section before turns, in its axes"),
    Field("swing", (3,), "m", "what it moves by when the joint turns"),
    Field("lag", (3,), "rad", "of damping, by which the link's root turns: see `matrix.carried`"),
    Field("drift", (3,), "m", "`swing`, carried by it"),
    Field("sway", (3,), "rad/s", "w x e of the section before and the joint's axis e; where there are rotors"),
    Field("lean", (), "N m s", "times it: what the joint's column has of it, for `lean`"),
    Field("now_turn", (3, 3), "", "the first of these of the residual made last, which `solve` does not read"),
    Field("now_lever", (3,), "m", ""),
    Field("now_frame", (3, 3), "", ""),
    Field("now_force", (3,), "N", "on the link's beginning, inertial axes"),
    Field("now_moment", (3,), "N m", ""),
    Field("now_spin", (), "N m s", "angular momentum of the joint's rotor along its axis, against the section before"),
)  # fmt: skip

BASE = Layout("Base", "", Field("matrix", (6, 6), "", "of the base"), Field("pinned", (6,), "", "1 where it is held"))

PLACE = Layout(
    "Place", "",
    Field("row", (), "", "of the joint's angle"),
    Field("elements", (), "", "of the link; none where it is rigid: its six rows are its root's increments then"),
    Field("factor", (), "", "where its first `FACTOR` is in S"),
)  # fmt: skip

LOAD = Layout(
    "SpatialLoad", "",
    Field("link", (), "", "that it works on"),
    Field("at_tip", (), "", "1: on its tip; 0: on its root"),
    Field("lever", (3,), "m", "from there to where it works, in the axes there"),
)  # fmt: skip

GAUGE = Layout(
    "Gauge", "",
    Field("link", (), "", "that it is on"),
    Field("element", (), "", "of that, the first of two whose ends it looks at"),
    Field("axis", (), "", "0, 1 or 2: x, y or z of the rotations"),
    Field("near", (2,), "1/m", "share of the rotations of that element's ends, left and right"),
    Field("far", (2,), "1/m", "of the next one's, or 0"),
    Field("rest", (), "1/m", "what this is without stress"),
)  # fmt: skip
"""Rotations are those against the element's middle, or against a segment's frame."""

G = GAUGE.places
E, J, P, F, H, B = ELEMENT.places, JOINT.places, BODY.places, FACTOR.places, HINGE.places, BASE.places
PL, L = PLACE.places, LOAD.places
W = WEIGHT.offsets(0, 0)
_frame_at, _weight_at, inner_layout = kernel(FRAME.offsets), kernel(WEIGHT.offsets), kernel(INNER.offsets)


@kernel
def inner_of(model):
    """How many inner modes a segment has, each about three axes."""
    if model.inner is None:
        return 0
    return len(model.inner)


def points_for(inner: int) -> int:
    """Gauss points of the mass of a segment with so many inner modes."""
    return POINTS + 2 * inner


@kernel
def points_of(model):
    """`points_for` of the model."""
    return POINTS + 2 * inner_of(model)


@kernel
def frame_at(model, i):
    """Where the fields of the `FRAME` of segment i are."""
    inner, points = inner_of(model), points_of(model)
    return _frame_at(i * _frame_at(0, inner, points).end, inner, points)


@kernel
def weight_end(model):
    """Numbers of a `WEIGHT`."""
    return _weight_at(0, inner_of(model)).end


@kernel
def inner_row(model, i):
    """First row of the inner modes of segment i, behind all others."""
    return model.places[PL.end * model.links + PL.row] + 3 * inner_of(model) * i


@kernel
def inner_at(model, i):
    """The fields of the `INNER` of segment i in S."""
    inner = inner_of(model)
    return inner_layout(model.places[PL.end * model.links + PL.factor] + inner_layout(0, inner).end * i, inner)


@kernel
def joint_row(model, k):
    """Row of the angle of joint k."""
    return model.places[PL.end * k + PL.row]


@kernel
def vertex_row(model, k, e):
    """First row of vertex e of link k."""
    return joint_row(model, k) + 1 + AXES * e


@kernel
def count_of(model, k):
    """Elements of link k."""
    return model.places[PL.end * k + PL.elements]


@kernel
def hinge_at(k):
    """Where the `HINGE` of joint k is in S."""
    return B.end + H.end * k


@kernel
def factor_at(model, k, e):
    """Where the `FACTOR` of element e of link k is in S."""
    return model.places[PL.end * k + PL.factor] + F.end * e


@kernel
def rows_before(model, k):
    """The first row of the section before joint k."""
    return model.places[PL.end * k + PL.row] - AXES


@kernel
def before(model, k):
    """Where the matrix of the section before joint k is in S."""
    if k == 0:
        return B.matrix
    e = count_of(model, k - 1)
    return factor_at(model, k - 1, 0) + F.LL if e == 0 else factor_at(model, k - 1, e - 1) + F.RR
