"""Rows of the coordinates, and offsets of all constants and matrices in the flat arrays of a chain in space.

Rows of q: the base's position (x, y, z; m, inertial axes) and rotation vector (rad, section axes to inertial axes). For
each link follow the angle of the joint at the link's root, then position and rotation vector of the link's vertices
(the right ends of its elements) from root to tip. Last come the amplitudes (rad), about x, y and z of the frame, of the
inner modes of each segment with a floating frame. Rows of v and a are the same with velocities along inertial axes and
angular velocities in the section's own axes. Rows of a residual are forces along inertial axes and moments in section
axes.

A link's root coincides with the vertex before it (levers of rigid ends aside); the joint's mount and angle rotate the
root relative to that vertex. In the descriptions "section before" is the last section of the link before the joint.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from ...compiler import Lanes, kernel
from ...layout import Field, Layout
from ..layout import ROTOR
from ..model import EI_Y_FACTOR, GJ_FACTOR, STIFFNESS_FACTOR, TAU_D
from .rotations import Vector, scale, three_of

AXES = 6
"""Number of coordinates of a vertex: position x, y, z, then rotation vector x, y, z."""

ELEMENT = Layout(
    "Element", "",
    Field("length", (), "m", "reference length l"),
    Field("mass", (3,), "kg", "masses lumped at the left end, the middle and the right end (Simpson's rule)"),
    Field("inertia", (3,), "kg m^2", "rotary inertia about the section's x, y, z at each end: half of the element's"),
    Field("EA", (), "N", "axial stiffness"),
    Field("shear", (2,), "1/N", "shear flexibility 1/C along y, 1/C_y along z"),
    Field("bow", (2,), "1/N",
          "residual bending flexibility along y (from EI) and z (from EI_y); l^2/(12 EI) if EI is constant"),
    Field("EI", (3,), "N m^2", "GJ, EI_y, EI: torsion and bending stiffness about x, y, z"),
    Field("rest", (3,), "", "l kappa_0: rotation vector (rad) from the left to the right end without stress"),
    Field("chord", (3,), "", "stress-free chord / l minus that of an arc (`element.bow_of`), axes of the middle"),
    Field("tilt", (2,), "", "a_y, a_z: distance from middle to center of flexibility for bending about y, z, over l"),
    Field("damping", (), "", "the link's Kelvin-Voigt time constant divided by the arm's largest"),
)  # fmt: skip

BODY = Layout(
    "Body", "",
    Field("mass", (), "kg", "mass of the body; for the payload, the arm's parameter replaces this value"),
    Field("there", (), "", "1: the body exists, 0: no body; 1 for the payload"),
    Field("centre", (3,), "m", "center of mass, measured from the section's origin, section axes"),
    Field("inertia", (3, 3), "kg m^2", "inertia tensor about the center of mass, section axes"),
)  # fmt: skip

JOINT = Layout(
    "Joint", "",
    Field("axis", (3,), "", "unit vector of the joint's axis, axes of the link's root"),
    Field("mount", (3, 3), "", "rotation at angle 0: axes of the link's root to axes of the section before"),
    Field("quaternion", (4,), "", "quaternion of the rotation `mount`"),
    Field("before", (3,), "m", "lever from the origin of the section before to the joint, axes of the section before"),
    Field("beyond", (3,), "m", "lever from the joint to the link's first section, axes of the link's root"),
    Field("near", (BODY.length,), "", "`BODY` fixed to the section before (elbow, rigid end)"),
    Field("far", (BODY.length,), "", "`BODY` fixed to the link's root; its center is measured from the first section"),
)  # fmt: skip

FACTOR = Layout(
    "Factor", "",
    Field("LL", (6, 6), "",
          "6 x 6 block (left rows, left columns), row by row; `factor` adds the condensed blocks of the vertices "
          "beyond"),
    Field("LR", (6, 6), "", "block (left rows, right columns)"),
    Field("RL", (6, 6), "", "block (right rows, left columns); after `factor` RR^-1 RL"),
    Field("RR", (6, 6), "", "block (right, right); after `factor` its L and U, reciprocal pivots"),
    Field("force", (3,), "N", "exact element: section force n of the last residual, axes of the middle"),
    Field("by_place", (3, 3), "N/m", "exact element: derivative of n by the right end's position (inertial axes)"),
    Field("by_left", (3, 3), "N", "derivative of n by the rotation of the left end (its axes)"),
    Field("by_right", (3, 3), "N", "derivative of n by the rotation of the right end (its axes)"),
)  # fmt: skip

INNER = Layout(
    "Inner", "inner",
    Field("matrix", ("3 * inner", "3 * inner"), "",
          "block of a segment's inner modes; `factor` replaces it by L and U with reciprocal pivots"),
    Field("ends", ("3 * inner", 12), "",
          "derivative of the force on the ends' 12 rows by inner amplitudes, transposed"),
    Field("over", ("3 * inner", 12), "",
          "derivative of the inner rows by the ends' 12 coordinates; `factor` multiplies it by matrix^-1"),
)  # fmt: skip
"""`INNER`: one record for each segment; the records follow all `FACTOR`s in the matrix array S."""

HINGE = Layout(
    "Hinge", "",
    Field("turn", (3, 3), "",
          "rotation from axes of the link's root to axes of the section before, in the last matrix"),
    Field("moment", (3,), "N m", "moment on the link's root times weights.stiffness, root axes"),
    Field("force", (3,), "N",
          "force on the root times weights.stiffness, axes of the section before; used only with levers"),
    Field("lever", (3,), "m",
          "s: lever from the section before to the link's first section, axes of the section before"),
    Field("frame", (3, 3), "", "A: axes of the section before to inertial axes"),
    Field("own", (), "N m/rad", "stiffness that `add_stiffness` adds to the pivot"),
    Field("column", (6,), "", "derivative of the wrench (inertial, section axes) on the section before by joint angle"),
    Field("row", (6,), "", "derivative of the joint's row by motion of the section before, divided by the pivot"),
    Field("pivot", (), "", "reciprocal pivot of the joint's row"),
    Field("pinned", (), "", "1: the joint is fixed (row and column of the identity); otherwise 0"),
    Field("shift", (3, 3), "m",
          "X: derivative of the first section's position (inertial axes) by the rotation of the section before"),
    Field("swing", (3,), "m", "c: derivative of the first section's position (inertial axes) by the joint angle"),
    Field("lag", (3,), "rad",
          "rotation by which Kelvin-Voigt damping lets the root lag, see `matrix.joint_motion_of_root`"),
    Field("drift", (3,), "m", "`swing` with the rotation that `lag` adds, inertial axes"),
    Field("sway", (3,), "rad/s",
          "w x e: spin w of the section before, joint axis e, both in its axes; only with rotors"),
    Field("rotor", (ROTOR.end,), "", "`physics.layout.ROTOR` of the joint's rotor"),
    Field("now_turn", (3, 3), "", "`turn` of the last residual; `solve` reads `turn` instead"),
    Field("now_lever", (3,), "m", "field `lever` of the last residual"),
    Field("now_frame", (3, 3), "", "field `frame` of the last residual"),
    Field("now_force", (3,), "N", "force on the link's first section, inertial axes, of the last residual"),
    Field("now_moment", (3,), "N m", "moment on the link's first section, root axes, of the last residual"),
)  # fmt: skip

BASE = Layout("Base", "", Field("matrix", (6, 6), "", "block of the base"), Field("pinned", (6,), "", "1: row fixed"))

PLACE = Layout(
    "Place", "",
    Field("row", (), "", "row of the angle of the joint at the link's root"),
    Field("elements", (), "", "number of elements; 0: a rigid link, whose six rows hold the increment of its root"),
    Field("factor", (), "", "offset of the link's first `FACTOR` in S"),
)  # fmt: skip

LOAD = Layout(
    "SpatialLoad", "",
    Field("link", (), "", "index of the loaded link"),
    Field("section", (), "", "0: on the link's first section; 1: on its last section; 2 + e: on its vertex e"),
    Field("lever", (3,), "m", "lever from the section's origin to the loaded point, section axes"),
)  # fmt: skip

GAUGE = Layout(
    "Gauge", "",
    Field("link", (), "", "index of the link"),
    Field("element", (), "", "index within the link of the first of at most two elements that it reads"),
    Field("axis", (), "", "0, 1 or 2: x, y or z component of the ends' rotations"),
    Field("near", (2,), "1/m", "weights of the rotations of the left and right end of that element"),
    Field("far", (2,), "1/m", "weights of the next element's rotations; 0 without next element"),
    Field("rest", (), "1/m", "reading without stress, which is subtracted"),
)  # fmt: skip
"""A `GAUGE` reads the ends' rotations (rad) relative to the element's middle section, or to the segment's frame."""

G = GAUGE.places
E, J, P, F, H, B = ELEMENT.places, JOINT.places, BODY.places, FACTOR.places, HINGE.places, BASE.places
PL, L = PLACE.places, LOAD.places
inner_layout = kernel(INNER.offsets)


@kernel
def inner_of(model):
    """Return the number of inner modes of a segment (compile-time constant). Each mode has amplitudes about x, y, z."""
    if model.inner is None:
        return 0
    return len(model.inner)


@kernel
def inner_row(model, i):
    """Return the first row, in q and r, of the inner modes of segment i, which follow all rows of the chain."""
    return model.places[PL.end * model.links + PL.row] + 3 * inner_of(model) * i


@kernel
def inner_at(model, i):
    """Return the offsets, in the matrix array S, of the fields of the `INNER` record of segment i, over all links."""
    inner = inner_of(model)
    return inner_layout(model.places[PL.end * model.links + PL.factor] + inner_layout(0, inner).end * i, inner)


@kernel
def joint_row(model, k):
    """Return the row, in q and r, of the angle of joint k; with k = model.links, the first row behind the chain."""
    return model.places[PL.end * k + PL.row]


@kernel
def vertex_row(model, k, e):
    """Return the first of six rows of vertex e of link k: right end of element e, or the root of a rigid link."""
    return joint_row(model, k) + 1 + AXES * e


@kernel
def count_of(model, k):
    """Return the number of elements (or segments) of link k; a rigid link has 0."""
    return model.places[PL.end * k + PL.elements]


@kernel
def hinge_at(k):
    """Return the offset of the `HINGE` record of joint k in S, the array of the Newton matrix and its factors."""
    return B.end + H.end * k


@kernel
def factor_at(model, k, e):
    """Return the offset in S, the array of the Newton matrix, of the `FACTOR` record of element e of link k."""
    return model.places[PL.end * k + PL.factor] + F.end * e


@kernel
def rows_before(model, k):
    """Return the first of the six rows of the section before joint k; for k = 0 this is the base."""
    return model.places[PL.end * k + PL.row] - AXES


@kernel
def before(model, k):
    """Return the offset in S of the 6 x 6 diagonal block of the last section before joint k; for k = 0 of the base.

    With k = model.links the function returns the block of the arm's last section. S: array of the Newton matrix.
    """
    if k == 0:
        return B.matrix
    # S of the last section of link k - 1: LL of a rigid link's only block, RR of the last element
    e = count_of(model, k - 1)
    return factor_at(model, k - 1, 0) + F.LL if e == 0 else factor_at(model, k - 1, e - 1) + F.RR


class Section(NamedTuple):
    """Constants of one element, including the arm's own factors (`ELEMENT`).

    length: reference length l, m
    stretch: EA, and the shear stiffness C* along y and z, which includes the residual bending flexibility, N
    EI: GJ, EI_y, EI (about x, y, z), N m^2
    rest: rotation vector psi from the left to the right end without stress, rad"""

    length: Any
    stretch: Any
    EI: Any
    rest: Any
    uneven: Any  # (chord, a_y, a_z): fields chord and tilt of `ELEMENT`; None without them
    tau: Any  # s: time constant of Kelvin-Voigt damping


@kernel
def uneven_of(lane, model, i):
    """Return (chord, a_y, a_z) of element i, see `bow_of`; None if no section and curvature varies along an element."""
    if model.uneven is None:
        return None
    o = E.end * i
    tilt = model.sections[o + E.tilt], model.sections[o + E.tilt + 1]
    return three_of(lane, model.sections, o + E.chord), tilt[0], tilt[1]


@kernel
def factors_of(lane, par: Lanes):
    """Return the arm's own factors (no unit) on the stiffnesses GJ, EI_y, EI as a `Vector`, from its parameters."""
    return Vector(par[GJ_FACTOR], par[EI_Y_FACTOR], par[STIFFNESS_FACTOR])


@kernel
def section_at(lane, model, par: Lanes, i):
    """Return the constants (`Section`) of element i, scaled by the arm's stiffness factors and tau_d in par."""
    o, of, factors = E.end * i, model.sections, factors_of(lane, par)
    tau = None if model.damped is None else par[TAU_D] * of[o + E.damping]
    _, about_y, about_z = factors
    # C* = 1 / (1/C + bow / factor): shear along y in series with residual bending about z, and vice versa
    along_y = about_z / (about_z * of[o + E.shear] + of[o + E.bow])
    along_z = about_y / (about_y * of[o + E.shear + 1] + of[o + E.bow + 1])
    stretch = Vector(of[o + E.EA], along_y, along_z)
    EI, rest = scale(three_of(lane, of, o + E.EI), factors), three_of(lane, of, o + E.rest)
    return Section(of[o + E.length], stretch, EI, rest, uneven_of(lane, model, i), tau)
