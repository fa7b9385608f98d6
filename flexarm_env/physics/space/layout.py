"""Where things are in the flat arrays of a chain in space: coordinates, constants, the iteration matrix.

Rows: the base's place (x, y, z) and its rotation vector; of each link the angle of the joint at its root, then place and
rotation vector of its vertices, the right end of each element, from root to tip. A link's root is where the vertex before
it is; it is turned by the joint's mount and angle against that.
"""

from __future__ import annotations

from ...compiler import kernel
from ...layout import Field, Layout

AXES = 6
"""Rows of a vertex: place, then rotation."""

ELEMENT = Layout(
    "Element", "",
    Field("length", (), "m", "of the element"),
    Field("mass", (), "kg", "of half of it, which is at each of its ends"),
    Field("inertia", (3,), "kg m^2", "of that half about the section's axes"),
    Field("stretch", (3,), "N", "EA, and shear stiffnesses C along y, C_y along z"),
    Field("bend", (3,), "N m^2", "GJ, EI_y about y, EI about z"),
    Field("rest", (3,), "", "curvatures times length without stress, about x, y, z"),
)  # fmt: skip

JOINT = Layout(
    "Joint", "",
    Field("axis", (3,), "", "unit vector in the axes of the link's root"),
    Field("mount", (3, 3), "", "axes of the link's root at angle 0 in those of the section before"),
    Field("quaternion", (4,), "", "of the same rotation"),
    Field("mass", (), "kg", "at the joint"),
    Field("near", (3, 3), "kg m^2", "inertia that turns with the section before, in its axes"),
    Field("far", (3, 3), "kg m^2", "that turns with the link's root, in its axes"),
)  # fmt: skip

BODY = Layout(
    "Payload", "",
    Field("centre", (3,), "m", "from the tip, in its axes"),
    Field("inertia", (3, 3), "kg m^2", "about there"),
)  # fmt: skip

FACTOR = Layout(
    "Factor", "",
    Field("LL", (6, 6), "", "of an element's tangent, row by row; after `factor` with what lies behind"),
    Field("LR", (6, 6), "", ""),
    Field("RL", (6, 6), "", "after `factor` RR^-1 RL"),
    Field("RR", (6, 6), "", "after `factor` its L and U, pivots inverted"),
)  # fmt: skip

HINGE = Layout(
    "Hinge", "",
    Field("turn", (3, 3), "", "axes of the link's root in those of the section before"),
    Field("moment", (3,), "N m", "that the link's root takes, in its axes"),
    Field("own", (), "N m/rad", "what `stiffen` adds"),
    Field("column", (6,), "", "of the joint's row and column: by the vertex before"),
    Field("row", (6,), "", "over the pivot"),
    Field("pivot", (), "", "inverse"),
    Field("pinned", (), "", "1 where it does not move"),
)  # fmt: skip

BASE = Layout("Base", "", Field("matrix", (6, 6), "", "of the base"), Field("pinned", (6,), "", "1 where it is held"))

E, J, P, F, H, B = ELEMENT.places, JOINT.places, BODY.places, FACTOR.places, HINGE.places, BASE.places


@kernel
def joint_row(model, k):
    """Row of the angle of joint k."""
    return AXES + k * (1 + AXES * model.elements)


@kernel
def hinge_at(k):
    """Where the `HINGE` of joint k is in S."""
    return B.end + H.end * k


@kernel
def factor_at(model, k, e):
    """Where the `FACTOR` of element e of link k is in S."""
    return B.end + H.end * model.links + F.end * (k * model.elements + e)


@kernel
def before(model, k):
    """Where the matrix of the vertex before joint k is in S."""
    return B.matrix if k == 0 else factor_at(model, k - 1, model.elements - 1) + F.RR
