"""Layouts of a floating-frame Model's `table` (row per body), of factors in S and of scratch; `data`: see `constants`.

Components that kernels read together (`arithmetic.load_pair`, `load_vector`) are adjacent fields in the loaded order.
Symbols are those of docs/theory.md, sections 1 to 3. Frame axes are the axes of a body's floating frame.
"""

from ...compiler import kernel, size
from ...layout import Field, Layout

ROW = Layout(
    "Row", "",
    Field("start", (), "", "index of the body's first row in the system"),
    Field("size", (), "", "number n of elastic coordinates of the body"),
    Field("link", (), "", "index of the link that the body is part of"),
    Field("multipliers", (), "",
          "number of multipliers of the joint at the tip: 0 (last body), 2 (hinge), 3 (no hinge)"),
    Field("motion", (), "", "index of the motion that prescribes this joint's angle; -1: constant angle or hinge"),
)  # fmt: skip
START, SIZE, LINK, MULTIPLIERS, MOTION, _ = ROW.places

ANGLE, ELASTIC = 2, 3
"""Offsets of the angle and the elastic coordinates in a body's rows, which begin with x and y of the frame's origin."""

# in S: n and the weighted derivative w of a lever's far point by theta, and its geometric term (inertial axes)
LEVER_FACTORS = Layout(
    "LeverFactors", "",
    *(Field(name, (), "m", "lever from near to far point, inertial axes") for name in ("ex", "ey")),
    *(Field(name, (), "", "near point: w, alpha, acceleration - g") for name in ("rate", "second", "ax", "ay")),
    *(Field(name, (), "m", "E lever: change of the far point by the angle, last matrix") for name in ("nx", "ny")),
    *(Field(name, (), "", "weighted change of the far point's acceleration by the angle") for name in ("wx", "wy")),
    Field("turn", (), "", "weighted derivative of the near point's moment by the angle at constant forces"),
)  # fmt: skip
"""Terms of the Newton matrix for each rigid end and for the payload's lever. They follow the bodies' factors in S."""

# in S: w, alpha, R'' - g and t of the last residual, frame axes
NOW = Layout(
    "Now", "",
    Field("cos", (), "", "cos theta of the body's frame"),
    Field("sin", (), "", "sin theta of the body's frame"),
    Field("a", (2,), "m/s^2", "R'' - g: acceleration of the origin minus gravity, frame axes"),
    Field("rate", (), "rad/s", "w = theta', angular velocity of the frame"),
    Field("second", (), "rad/s^2", "alpha = theta'', angular acceleration of the frame"),
    Field("tip", (2,), "m", "t: position of the tip relative to the origin, frame axes"),
    Field("tip_rate", (2,), "m/s", "t' + w E t: velocity of the tip relative to the origin, frame axes"),
    Field("tip_second", (2,), "m/s^2", "acceleration of the tip relative to the origin, frame axes"),
).places  # fmt: skip
# on the stack: theta, w, alpha (rad, ...) and R'' - g (inertial axes) of a section, from body to body
PASSED = Layout(
    "Passed", "",
    Field("angle", (), "rad", "angle of a section from the inertial x axis"),
    Field("rate", (), "rad/s", "angular velocity of the section"),
    Field("second", (), "rad/s^2", "angular acceleration of the section"),
    Field("ax", (), "m/s^2", "x of the section center's acceleration minus gravity, inertial axes"),
    Field("ay", (), "m/s^2", "y of the section center's acceleration minus gravity, inertial axes"),
).places  # fmt: skip
# on the stack: theta, its rate and the origin's velocity (frame axes) of a body, for energies and poses
FRAME = Layout(
    "Frame", "",
    Field("cos", (), "", "cos theta of a body's frame"),
    Field("sin", (), "", "sin theta of a body's frame"),
    Field("vx", (), "m/s", "x of the origin's velocity, frame axes"),
    Field("vy", (), "m/s", "y of the origin's velocity, frame axes"),
    Field("rate", (), "rad/s", "w = theta', angular velocity of the frame"),
).places  # fmt: skip
# on the stack: n-vectors Gamma, c + B q, c_u + G q of one body (2.4), from `body.forces` to `matrix.tangent`
VECTORS = Layout(
    "Vectors", "n",
    Field("gq", ("n",), "kg m", "c_u + G q: half the gradient of the inertia I by q"),
    Field("cb", ("n",), "kg m", "c + B q: derivative of the elastic angular momentum by q'"),
    Field("bv", ("n",), "kg m/s", "B q': half the Coriolis force divided by w"),
    Field("gsx", ("n",), "kg", "Gamma, x row: derivative of the first moment along the axis by q"),
    Field("px", ("n",), "", "dt/dq, x row: derivative of the tip's x by q"),
)  # fmt: skip
# on the stack: N of one finite element and dN/dq, from `body.forces` to `matrix.tangent`
STRAIN = Layout(
    "Strain", "window",
    Field("force", (), "N", "axial force of a finite element"),
    Field("slope", ("window",), "", "gradient of the element's stretch (m) by its window's coordinates"),
    Field("rate", ("window",), "1/s", "time derivative of the gradient, H q' (von Karman with damping)"),
)  # fmt: skip
vectors_at = kernel(VECTORS.offsets)
strain_at = kernel(STRAIN.offsets)
# on the stack: quantities that (2.4) and its derivative share, from `body.forces` to `matrix.tangent`, frame axes
KNOWN = Layout(
    "Known", "",
    Field("d", (2,), "N", "f_R - m_t (R'' - g), eq. 2.4, frame axes"),
    Field("s", (2,), "kg m", "s_bar(q): first moment, frame axes"),
    Field("t", (2,), "kg m/s", "s_bar': time derivative of the first moment in the frame, frame axes"),
    Field("inertia", (), "kg m^2", "I(q): inertia about the origin"),
    Field("spin_rate", (), "kg m^2/s", "half of the inertia's rate, I'/2 = (c_u + G q)'q'"),
    Field("g", (2,), "N", "force required at the tip by all bodies beyond, frame axes"),
).places  # fmt: skip
# in S: d(r_q, f_R, f_theta) by (q, R'', theta) of one body, frame axes, then its factors
FACTORS = Layout(
    "Factors", "n",
    Field("now", (NOW.end,), "", "the record `NOW` of the last residual"),
    Field("frame", (2,), "", "cos theta, sin theta; this and all later fields: of the last matrix"),
    Field("arm", ("n + 1", 2), "", "J: derivative of the tip's position by q, then by theta; frame axes"),
    Field("swept", ("n + 1", 2), "", "weighted derivative of the tip's acceleration by q, theta, eq. 3.3"),
    Field("matrix", ("n + 3", "n + 3"), "", "Newton matrix of q, origin's acceleration, theta; then its factors"),
)  # fmt: skip


@kernel
def cell(i, j):
    """Return the index of entry (i, j) in a 3 x 3 matrix stored row by row; rows and columns are x, y and angle."""
    return 3 * i + j


# in S: pivot, column and row of an elbow; their rows are x, y (inertial axes), theta
JOINT = Layout(
    "Joint", "",
    Field("pinned", (), "", "1: the elbow's angle is fixed or prescribed, 0: free"),
    Field("column", (2,), "",
          "force by the angle of the section beyond the elbow, for all bodies beyond, over the pivot"),
    Field("row", (2,), "", "moment by acceleration along x and y, for all bodies beyond, over the pivot"),
    Field("inverse", (), "", "reciprocal of the pivot: moment by angle for all bodies beyond, plus `own`"),
    Field("own", (), "", "stiffness (N m) from `add_stiffness`; `factor` divides it by the pivot"),
).places  # fmt: skip
# in S: the 3 x 3 matrix of the root's x, y, theta (inertial axes)
ROOT = Layout(
    "Root", "",
    Field("pinned", (3,), "", "1: x, y or angle of the root is fixed or prescribed; 0: free"),
    Field("scale", (2,), "", "cm and 1/cm: ratio of the root's weighted acceleration to its position"),
    Field("tail", (2,), "", "of the payload: cm times its inertia, and its mass"),
    Field("own", (), "", "stiffness (N m) from `add_stiffness` at the hub"),
    Field("factors", (3, 3), "", "LU of the whole chain condensed to x, y, angle of the root; inverted pivots"),
).places  # fmt: skip
# a point load acts on a link's root or tip (side 0 or 1), or between two of the link's bodies
LOADED = Layout(
    "Loaded", "", Field("link", (), "", "link that a point load acts on"),
    Field("side", (), "", "end: 0 root, 1 tip; `INNER` + b: tip of the link's body b, which is not the last"),
).places  # fmt: skip
INNER = 2
"""Value of `LOADED.side` for the tip of a link's first body."""
factors_at = kernel(FACTORS.offsets)


@kernel
def acts_at(loads, f, link, end):
    """Return whether point load f acts at an end of a link (a `LOADED.side`); `loads` contains a `LOADED` per load."""
    at = LOADED.end * f
    return loads[at + LOADED.link] == link and loads[at + LOADED.side] == end


@kernel
def window(model, n, e):
    """Return the first elastic coordinate in the window of element e: the free coordinates of the element's two nodes.

    `model` is a `Mesh` with n elastic coordinates. Each node has (u, v, phi). A frame clamped to the root fixes all
    three at the first node. A frame through both ends fixes u and v at the first node and v at the last node. Windows
    at the ends are shifted inwards, so that all windows have the same width.
    """
    first = 3 * e - 3
    if model.chord is not None:
        first = min(3 * e - 2, n - len(model.window))
    return max(first, 0)


@kernel
def elastic_row(model, b):
    """Return the row of body b's first elastic coordinate in a chain: after the root's x, y and angle."""
    return ELASTIC + size(model.mesh.n) * b


@kernel
def elbow_row(model, k):
    """Return the row of the angle of elbow k >= 1 in a chain: after the elastic coordinates of all bodies."""
    return elastic_row(model, model.links * model.segments) + k - 1
