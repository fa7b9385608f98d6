"""Layouts of arrays that every formulation reads or writes: link poses, inputs, motions, energy account, counts."""

from ..layout import Field, Layout

POSES = Layout(
    "Pose", "",
    Field("x", (), "m", "x of the link's root, inertial axes"),
    Field("y", (), "m", "y of the link's root, inertial axes"),
    Field("angle", (), "rad", "angle of the tangent at the root, from the inertial x axis"),
    Field("vx", (), "m/s", "velocity of the root along inertial x"),
    Field("vy", (), "m/s", "velocity of the root along inertial y"),
    Field("rate", (), "rad/s", "rate of the angle at the root"),
    Field("tip_x", (), "m", "x of the link's tip, inertial axes"),
    Field("tip_y", (), "m", "y of the link's tip, inertial axes"),
    Field("tip_angle", (), "rad", "angle of the tangent at the tip, from the inertial x axis"),
    Field("tip_vx", (), "m/s", "velocity of the tip along inertial x"),
    Field("tip_vy", (), "m/s", "velocity of the tip along inertial y"),
    Field("tip_rate", (), "rad/s", "rate of the angle at the tip"),
)  # fmt: skip
"""`POSES`: pose and velocity of a link in the plane, as `protocol.link_poses` writes them."""

POSE = POSES.places
"""Offsets of the fields of POSES; POSE.end is the number of entries per link."""

BASE_POSE = Layout(
    "BasePose", "",
    Field("angle", (), "rad", "attitude of a floating base from the inertial x axis, 0 at the start"),
    Field("rate", (), "rad/s", "rate of the attitude"),
).places  # fmt: skip
"""`BASE_POSE`: attitude and rate of a floating base, stored after the links' poses."""

ROOT, ROOT_RATES = slice(POSE.x, POSE.vx), slice(POSE.vx, POSE.tip_x)
TIP, TIP_RATES = slice(POSE.tip_x, POSE.tip_vx), slice(POSE.tip_vx, POSE.end)
"""Slices of the last axis of poses (..., links, POSE.end): (x, y, angle) and their rates, at a link's root and tip."""

SPACE_POSES = Layout(
    "SpatialPose", "",
    Field("angle", (), "rad", "angle of the joint at the link's root"),
    Field("rate", (), "rad/s", "rate of the joint angle"),
    Field("deflection", (2,), "m", "deflection of the tip along y and z of the root's section axes"),
    Field("deflection_rate", (2,), "m/s", "time derivative of the deflection, root axes"),
    Field("twist", (), "rad", "twist of the tip relative to the root: x component of their rotation vector"),
    Field("twist_rate", (), "rad/s", "time derivative of the twist"),
    Field("tip", (3,), "m", "position of the tip, inertial axes"),
    Field("velocity", (3,), "m/s", "velocity of the tip, inertial axes"),
    Field("axes", (3, 3), "", "rotation matrix, by rows, from the root's section axes to inertial axes"),
    Field("turn", (3,), "rad", "rotation vector of the tip's section axes"),
    Field("spin", (3,), "rad/s", "angular velocity of the tip's section, section axes"),
)  # fmt: skip
"""`SPACE_POSES`: pose and velocity of a link in space, as `protocol.task_poses` writes them."""

SPACE_POSE = SPACE_POSES.places

LOAD = Layout(
    "PointLoad", "",
    Field("x", (), "N", "force along inertial x; as input displacement: position x, m"),
    Field("y", (), "N", "force along inertial y; as input displacement: position y, m"),
    Field("torque", (), "N m", "torque; as input displacement: angle of the section, rad"),
)  # fmt: skip
"""`LOAD`: entries of a point load in the inputs u and in the input displacements y. They follow the joints' entries."""
OF_LOAD = LOAD.places

MOTION = Layout(
    "Motion", "",
    Field("value", (), "m or rad", "prescribed value of the coordinate"),
    Field("rate", (), "1/s", "first time derivative of the value"),
    Field("second", (), "1/s^2", "second time derivative of the value"),
)  # fmt: skip
"""`MOTION`: entries of a prescribed motion in psi: value, rate and second rate."""
OF_MOTION = MOTION.places

LEVER = Layout(
    "Lever", "",
    Field("length", (), "m", "length of the rigid end"),
    Field("mass", (), "kg", "mass of the rigid end, located at its middle"),
    Field("inertia", (), "kg m^2", "moment of inertia about the middle of the rigid end"),
    Field("far", (), "kg", "mass of an elbow at the far point of the rigid end"),
)  # fmt: skip
"""`LEVER`: a rigid end of a link. If links have rigid ends, each link has two such records, for root and tip."""

ROTOR = Layout(
    "Rotor", "",
    Field("momentum", (), "N m s", "h: angular momentum along the joint's axis e, set before a residual"),
    Field("column", (3,), "rad/s",
          "w x e, where w is the angular velocity of the section before the joint, in its axes; set with a matrix; 0 "
          "if the three rows before the joint's row are not of that section"),
    Field("factor", (), "N m s", "set before `factor`, which adds factor (w x e) to the joint's column"),
).places  # fmt: skip
"""`ROTOR`: entries of a joint with a rotor in the matrix array S of an arm in space."""

BOOKS = Layout(
    "Books", "",
    Field("work", (), "J", "work of inputs and prescribed motions since the start"),
    Field("dissipated", (), "J", "energy dissipated by damping and friction"),
    Field("beyond", (), "J", "work of damping forces from strain rates that steps do not resolve, not in `dissipated`"),
)  # fmt: skip
# books: W (J), D (J), and the work of damping forces beyond D (J)
WORK_DONE, DISSIPATED, BEYOND, *_ = BOOKS.places

COUNTS = Layout(
    "Counts", "", *(Field(name, (), "", "") for name in ("iterations", "factorisations", "halvings", "steps"))
)
# counts of Newton iterations, factorizations, halvings and steps: lanes share them, since they iterate together
ITERATIONS, FACTORISATIONS, HALVINGS, STEPS, *_ = COUNTS.places
