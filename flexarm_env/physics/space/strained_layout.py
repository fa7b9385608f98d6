"""Arrays of a link whose coordinates are its strains: constants (`STRAINED`), stored kinematics and matrix
(`NOTED`)."""

from __future__ import annotations

from ...compiler import kernel, size
from ...layout import Field, Layout
from .layout import PL, F

STRAINED = Layout(
    "Strained", "polynomials, points",
    Field("sums", ("points + 1", "polynomials"), "", "s (rad) of each interval by each polynomial's coefficient"),
    Field("slants", ("points + 1", "polynomials"), "", "d (rad) of each interval by each polynomial's coefficient"),
    Field("natural", ("points + 1", 2), "", "s and d about z of the stress-free link, rad"),
    Field("ways", ("points + 1", "points"), "m",
          "weights w: position of each point, and of the end, is sum w t over tangents t"),
    Field("mass", ("points",), "kg", "mass of each Gauss point"),
    Field("inertia", ("points", 3), "kg m^2", "rotary inertia of each point about section axes x, y, z"),
    Field("stiffness", (3, "polynomials", "polynomials"), "N m", "K of torsion, bending about y, about z"),
    Field("correction", (3, "polynomials", "polynomials"), "kg m^2",
          "inertia that steps leave out (theory 5.3), likewise"),
    Field("damping", (), "", "Kelvin-Voigt time constant over the arm's largest"),
)  # fmt: skip

NOTED = Layout(
    "Noted", "polynomials, points",
    Field("on", (6,), "N, N m", "force (inertial), moment (section axes) on the last section; in `solve` its motion"),
    Field("frame", (3, 3), "", "root axes to inertial axes; vectors below are in root axes unless stated otherwise"),
    Field("a", (3,), "m/s^2", "acceleration of the root less gravity"),
    Field("spin", (3,), "rad/s", "angular velocity of the root"),
    Field("turn", ("points + 1", 9), "",
          "rotation matrix, axes of each point's section, and of the last, to root axes"),
    Field("x_of", ("points + 1", 3), "", "Cayley's vector x of each interval, axes of its end"),
    Field("psi", ("points + 1", 3), "", "rotation vector psi of each interval, rad"),
    Field("s", ("points + 1", 3), "", "integral of the strain over each interval, rad"),
    Field("d", ("points + 1", 3), "", "first moment of the strain over the interval, rad"),
    Field("series", ("points + 1", 3), "", "1 / (1 + x.x); f and f' at psi.psi, x = psi f / 2"),
    Field("w", ("points + 1", 3), "rad/s", "angular velocity of each section"),
    Field("alpha", ("points + 1", 3), "rad/s^2", "angular acceleration of each section"),
    Field("second", ("points", 3), "1/s^2",
          "t'': second rate of each tangent; while columns are made, moments' changes (N m)"),
    Field("r", ("points + 1", 3), "m", "position of each point, and of the end, from the root"),
    Field("force", ("points", 3), "N", "inertia force of each point"),
    Field("moment", ("points", 3), "N m", "rotary inertia moment of each point"),
    Field("pull", ("points", 3), "N m", "generalized force on each point's tangent"),
    Field("bend", ("points + 1", 3), "N m", "moment on all that each interval rotates"),
    Field("slip", ("points + 1", 3), "m/s",
          "2 u - spin x r of each point: u its velocity relative to the root's origin"),
    Field("by_sum", ("points + 1", 9), "", "rotation of each interval's end by s, a row for each component of s"),
    Field("by_slant", ("points + 1", 9), "", "rotation of each interval's end by d, a row for each component of d"),
    Field("theta", ("points + 1", 3), "", "of one column: rotation of each section"),
    Field("moved", ("points + 1", 3), "m", "of one column: displacement of each point"),
    Field("change", ("points", 3), "N", "of one column: change of each point's force"),
    Field("last_turn", (3, 3), "", "`turn` of the last section when the matrix was made, as is all that follows"),
    Field("shift", (3, 3), "m", "displacement of the last section (inertial) by the root's rotation (root axes)"),
    Field("matrix", ("3 * polynomials", "3 * polynomials"), "",
          "strain rows by strains; after `factor` L and U, reciprocal pivots"),
    Field("on_root", ("3 * polynomials", 6), "", "d(force inertial, moment root axes, on the root)/d(strain)"),
    Field("by_root", ("3 * polynomials", 6), "", "d(strain row)/d(position inertial, rotation of the root)"),
    Field("over", ("3 * polynomials", 6), "", "after `factor`: matrix^-1 by_root"),
    Field("last", ("3 * polynomials", 6), "", "d(position inertial, rotation of the last section, its axes)/d(strain)"),
)  # fmt: skip
"""A `NOTED` record follows each link's `FACTOR`, whose LL is the block of the root, RR that of the last section."""

_strained, _noted = kernel(STRAINED.offsets), kernel(NOTED.offsets)


@kernel
def strained_at(model, k):
    """Return the offsets, in model.strains, of the fields of the `STRAINED` of link k."""
    n, points = size(model.polynomials), size(model.points)
    return _strained(k * _strained(0, n, points).end, n, points)


@kernel
def noted_at(model, k):
    """Return the offsets, in S, of the fields of the `NOTED` of link k."""
    return _noted(model.places[PL.end * k + PL.factor] + F.end, size(model.polynomials), size(model.points))
