"""Arrays of a link whose coordinates are its strains: constants (`STRAINED`), stored kinematics, matrix (`NOTED`)."""

from __future__ import annotations

from ...compiler import kernel, size
from ...layout import Field, Layout
from .layout import PL, F

STRAINED = Layout(
    "Strained", "polynomials, points",
    Field("sums", ("points + 1", "polynomials"), "", "s (rad) of each interval per coefficient of each polynomial"),
    Field("slants", ("points + 1", "polynomials"), "", "d (rad) of each interval per coefficient of each polynomial"),
    Field("natural", ("points + 1", 2), "", "s and d (rad) about z of each interval of the stress-free link"),
    Field("ways", ("points + 1", "points"), "m",
          "weights w: the position of each point, and of the end, is the sum of w t over the tangents t"),
    Field("mass", ("points",), "kg", "mass of each Gauss point"),
    Field("inertia", ("points", 3), "kg m^2", "rotary inertia of each point about section axes x, y, z"),
    Field("K_EI", (3, "polynomials", "polynomials"), "N m", "stiffness K for torsion, bending about y, about z"),
    Field("correction", (3, "polynomials", "polynomials"), "kg m^2",
          "inertia that time steps subtract (theory 5.3) for torsion, bending about y, about z"),
    Field("damping", (), "", "the link's Kelvin-Voigt time constant divided by the arm's largest"),
)  # fmt: skip

NOTED = Layout(
    "Noted", "polynomials, points",
    Field("on", (6,), "N, N m", "force (inertial), moment (section axes) on the last section; motion of it in `solve`"),
    Field("frame", (3, 3), "", "rotation, root axes to inertial axes; vectors below are in root axes unless stated"),
    Field("a", (3,), "m/s^2", "acceleration of the root minus gravity"),
    Field("spin", (3,), "rad/s", "angular velocity of the root"),
    Field("turn", ("points + 1", 9), "",
          "rotation matrix of each point's section, and of the last section, to root axes"),
    Field("x_of", ("points + 1", 3), "", "Cayley vector x of each interval's rotation, axes of its end"),
    Field("psi", ("points + 1", 3), "", "rotation vector psi of each interval, rad"),
    Field("s", ("points + 1", 3), "", "integral of the strain over each interval, rad"),
    Field("d", ("points + 1", 3), "", "first moment of the strain over the interval, rad"),
    Field("series", ("points + 1", 3), "", "1 / (1 + x.x); f and f' at psi.psi, where x = psi f / 2"),
    Field("w", ("points + 1", 3), "rad/s", "angular velocity of each section"),
    Field("alpha", ("points + 1", 3), "rad/s^2", "angular acceleration of each section"),
    Field("second", ("points", 3), "1/s^2",
          "t'': second time derivative of each tangent; while columns are computed, changes of moments (N m)"),
    Field("r", ("points + 1", 3), "m", "position of each point, and of the end, relative to the root"),
    Field("force", ("points", 3), "N", "inertia force of each point"),
    Field("moment", ("points", 3), "N m", "rotary inertia moment of each point"),
    Field("pull", ("points", 3), "N m", "generalized force on each point's tangent"),
    Field("bend", ("points + 1", 3), "N m", "moment on all sections beyond that each interval rotates"),
    Field("slip", ("points + 1", 3), "m/s",
          "2 u - spin x r of each point; u: velocity of the point relative to the root's origin"),
    Field("by_sum", ("points + 1", 9), "", "rotation of each interval's end by s, a row for each component of s"),
    Field("by_slant", ("points + 1", 9), "", "rotation of each interval's end by d, a row for each component of d"),
    Field("theta", ("points + 1", 3), "", "while a column is computed: rotation of each section"),
    Field("moved", ("points + 1", 3), "m", "while a column is computed: displacement of each point"),
    Field("change", ("points", 3), "N", "while a column is computed: change of each point's force"),
    Field("last_turn", (3, 3), "", "`turn` of the last section for the last matrix, as all fields below"),
    Field("shift", (3, 3), "m",
          "derivative of the last section's position (inertial) by the root's rotation (root axes)"),
    Field("matrix", ("3 * polynomials", "3 * polynomials"), "",
          "derivative of strain rows by strains; `factor` replaces it by L and U with reciprocal pivots"),
    Field("on_root", ("3 * polynomials", 6), "",
          "derivative of the force (inertial), moment (root axes) on the root by strains"),
    Field("by_root", ("3 * polynomials", 6), "",
          "derivative of strain rows by the root's position (inertial) and rotation"),
    Field("over", ("3 * polynomials", 6), "", "matrix^-1 by_root, written by `factor`"),
    Field("last", ("3 * polynomials", 6), "",
          "derivative of the last section's position (inertial), rotation (its axes) by strains"),
)  # fmt: skip
"""A `NOTED` record follows each link's `FACTOR`. LL of this `FACTOR` is the root's block, RR that of the last
section."""

_strained, _noted = kernel(STRAINED.offsets), kernel(NOTED.offsets)


@kernel
def strained_at(model, k):
    """Return the offsets, in model.strains, of the fields of the `STRAINED` record of link k."""
    n, points = size(model.polynomials), size(model.points)
    return _strained(k * _strained(0, n, points).end, n, points)


@kernel
def noted_at(model, k):
    """Return the offsets, in the matrix array S, of the fields of the `NOTED` record of link k."""
    return _noted(model.places[PL.end * k + PL.factor] + F.end, size(model.polynomials), size(model.points))
