"""Where things are in what every formulation reads or writes: inputs, motions, link poses, an arm's books."""

from ..layout import Field, Layout

POSES = Layout(
    "Pose", "",
    Field("x", (), "m", "of the link's root"),
    Field("y", (), "m", ""),
    Field("angle", (), "rad", "of its tangent there"),
    Field("vx", (), "m/s", "their rates"),
    Field("vy", (), "m/s", ""),
    Field("rate", (), "rad/s", ""),
    Field("tip_x", (), "m", "the same of its tip"),
    Field("tip_y", (), "m", ""),
    Field("tip_angle", (), "rad", ""),
    Field("tip_vx", (), "m/s", ""),
    Field("tip_vy", (), "m/s", ""),
    Field("tip_rate", (), "rad/s", ""),
)  # fmt: skip
"""What is known of a link, as `protocol.link_poses` writes it."""

POSE = POSES.places
"""Where these are; POSE.end: numbers a link."""

BASE_POSE = Layout(
    "BasePose", "",
    Field("angle", (), "rad", "attitude of a base that floats, 0 at the start"),
    Field("rate", (), "rad/s", "its rate"),
).places  # fmt: skip
"""What is known of such a base, behind the links' poses."""

ROOT, ROOT_RATES = slice(POSE.x, POSE.vx), slice(POSE.vx, POSE.tip_x)
TIP, TIP_RATES = slice(POSE.tip_x, POSE.tip_vx), slice(POSE.tip_vx, POSE.end)
"""x, y, angle and their rates, of a link's root and of its tip: along the last axis of poses (..., links, POSE.end)."""

SPACE_POSES = Layout(
    "SpatialPose", "",
    Field("angle", (), "rad", "of the joint at the link's root"),
    Field("rate", (), "rad/s", "its rate"),
    Field("deflection", (2,), "m", "of the tip along y and z of the root"),
    Field("deflection_rate", (2,), "m/s", ""),
    Field("twist", (), "rad", "of the tip against the root: x part of the rotation vector between them"),
    Field("twist_rate", (), "rad/s", ""),
    Field("tip", (3,), "m", "place"),
    Field("velocity", (3,), "m/s", "of the tip"),
    Field("axes", (3, 3), "", "of the root"),
    Field("turn", (3,), "rad", "rotation vector of the tip's axes"),
    Field("spin", (3,), "rad/s", "angular velocity of the tip about its own axes"),
)  # fmt: skip
"""What is known of a link in space, as `protocol.task_poses` writes it."""

SPACE_POSE = SPACE_POSES.places

LOAD = Layout(
    "PointLoad", "",
    Field("x", (), "N", "force; as a port: position, m"),
    Field("y", (), "N", ""),
    Field("torque", (), "N m", "as a port: angle, rad"),
)  # fmt: skip
"""A point load's entries of the inputs u, behind the joints' torques, and of the ports y."""
OF_LOAD = LOAD.places

MOTION = Layout(
    "Motion", "",
    Field("value", (), "m or rad", "of the prescribed coordinate"),
    Field("rate", (), "1/s", ""),
    Field("second", (), "1/s^2", "second rate"),
)  # fmt: skip
"""A prescribed motion's entries of psi."""
OF_MOTION = MOTION.places

LEVER = Layout(
    "Lever", "",
    Field("length", (), "m", "of a link's rigid end"),
    Field("mass", (), "kg", "in its middle"),
    Field("inertia", (), "kg m^2", "about there"),
    Field("far", (), "kg", "mass at its far point, an elbow's"),
)  # fmt: skip
"""Of each link's root and tip, where links have rigid ends."""

BOOKS = Layout(
    "Books", "",
    Field("work", (), "J", "of inputs and motions"),
    Field("dissipated", (), "J", "by damping"),
)  # fmt: skip
WORK_DONE, DISSIPATED, *_ = BOOKS.places

COUNTS = Layout(
    "Counts", "", *(Field(name, (), "", "") for name in ("iterations", "factorisations", "halvings", "steps"))
)
ITERATIONS, FACTORISATIONS, HALVINGS, STEPS, *_ = COUNTS.places
