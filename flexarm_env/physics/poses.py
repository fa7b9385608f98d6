"""What is known of a link's motion: where the numbers are that `link_poses` writes and everybody reads."""

from __future__ import annotations

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
"""A link's numbers, as `physics.protocol.link_poses` writes them."""

POSE = POSES.places
"""Where these are; POSE.end: numbers a link."""

ROOT, ROOT_RATES = slice(POSE.x, POSE.vx), slice(POSE.vx, POSE.tip_x)
TIP, TIP_RATES = slice(POSE.tip_x, POSE.tip_vx), slice(POSE.tip_vx, POSE.end)
"""x, y, angle and their rates, of a link's root and of its tip: the last axis of poses (..., links, POSE.end)."""
