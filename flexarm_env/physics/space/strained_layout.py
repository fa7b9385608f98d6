"""Where things are of a link whose coordinates are its strains: constants, what a step notes of it, its matrix."""

from __future__ import annotations

from ...compiler import kernel, size
from ...layout import Field, Layout
from .layout import PL, F

STRAINED = Layout(
    "Strained", "polynomials, points",
    Field("sums", ("points + 1", "polynomials"), "", "s of an interval by each polynomial's coefficient"),
    Field("slants", ("points + 1", "polynomials"), "", "d likewise"),
    Field("natural", ("points + 1", 2), "", "s and d about z without stress"),
    Field("ways", ("points + 1", "points"), "m", "by what each point's tangent takes a point, or the end, along"),
    Field("mass", ("points",), "kg", ""),
    Field("inertia", ("points", 3), "kg m^2", "of sections, about their axes"),
    Field("stiffness", (3, "polynomials", "polynomials"), "N m", "of torsion, of bending about y and about z"),
    Field("correction", (3, "polynomials", "polynomials"), "kg m^2", "what steps take from the inertia of these"),
    Field("damping", (), "", "its time constant over the arm's largest"),
)  # fmt: skip

NOTED = Layout(
    "Noted", "polynomials, points",
    Field("on", (6,), "N, N m", "force (inertial), moment (own axes) on the last section; of `solve` what it moves by"),
    Field("frame", (3, 3), "", "axes of the root; of all that follows, unless it says otherwise"),
    Field("a", (3,), "m/s^2", "of the root, less gravity"),
    Field("spin", (3,), "rad/s", "of the root"),
    Field("turn", ("points + 1", 9), "", "axes of each point's section, and of the last one"),
    Field("x_of", ("points + 1", 3), "", "Cayley's vector of each interval"),
    Field("psi", ("points + 1", 3), "", "its rotation vector"),
    Field("s", ("points + 1", 3), "", "what that is made of"),
    Field("d", ("points + 1", 3), "", ""),
    Field("series", ("points + 1", 3), "", "1 / (1 + x.x); f and f' of x = psi f / 2 by psi.psi"),
    Field("w", ("points + 1", 3), "rad/s", "of sections"),
    Field("alpha", ("points + 1", 3), "rad/s^2", ""),
    Field("second", ("points", 3), "1/s^2", "of tangents"),
    Field("r", ("points + 1", 3), "m", "from the root"),
    Field("force", ("points", 3), "N", "mass times acceleration"),
    Field("moment", ("points", 3), "N m", "of rotary inertia"),
    Field("pull", ("points", 3), "N m", "on a point's tangent"),
    Field("bend", ("points + 1", 3), "N m", "on all that an interval turns"),
    Field("slip", ("points + 1", 3), "m/s", "of points against the root's frame"),
    Field("by_sum", ("points + 1", 9), "", "turn of an interval's end by s, a row for each of its axes"),
    Field("by_slant", ("points + 1", 9), "", "by d"),
    Field("theta", ("points + 1", 3), "", "of a column: what sections turn by"),
    Field("moved", ("points + 1", 3), "m", "what points move by"),
    Field("change", ("points", 3), "N", "of their forces"),
    Field("last_turn", (3, 3), "", "axes of the last section when the matrix was made, as all that follows is"),
    Field("shift", (3, 3), "m", "what that section moves by (inertial) when the root turns"),
    Field("matrix", ("3 * polynomials", "3 * polynomials"), "", "by strains; after `factor` L and U, pivots inverted"),
    Field("on_root", ("3 * polynomials", 6), "", "what is on the root by the strains"),
    Field("by_root", ("3 * polynomials", 6), "", "what is on the strains by the root"),
    Field("over", ("3 * polynomials", 6), "", "matrix^-1 by_root"),
    Field("last", ("3 * polynomials", 6), "", "what the last section moves by: place (inertial), rotation (own axes)"),
)  # fmt: skip
"""Behind a link's `FACTOR`, of which LL is on its root and RR on its last section."""

_strained, _noted = kernel(STRAINED.offsets), kernel(NOTED.offsets)


@kernel
def strained_at(model, k):
    """Where the fields of the `STRAINED` of link k are."""
    n, points = size(model.polynomials), size(model.points)
    return _strained(k * _strained(0, n, points).end, n, points)


@kernel
def noted_at(model, k):
    """Where the fields of the `NOTED` of link k are in S."""
    return _noted(model.places[PL.end * k + PL.factor] + F.end, size(model.polynomials), size(model.points))
