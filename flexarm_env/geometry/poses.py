"""Deflections and joint angles from the poses of links in the plane."""

import numpy as np

from ..physics.layout import POSE
from ..validation import Array


def link_deflection(poses: Array) -> Array:
    """Return each link's tip deflection, m: the signed distance of the tip from the tangent at the root.

    poses (..., n_links, 12): poses of links with the fields of `physics.layout.POSES`. The result has shape (...,
    n_links).
    """
    dx, dy = poses[..., POSE.tip_x] - poses[..., POSE.x], poses[..., POSE.tip_y] - poses[..., POSE.y]
    angle = poses[..., POSE.angle]
    return np.asarray(np.cos(angle) * dy - np.sin(angle) * dx)


def joint_angles(poses: Array) -> tuple[Array, Array]:
    """Return joint angles (rad) and rates (rad/s): of joint 0 from the x axis, of joint k from the tip of link k - 1.

    poses (..., n_links, 12): poses of links with the fields of `physics.layout.POSES`. Both results have shape (...,
    n_links).
    """
    angles, rates = poses[..., POSE.angle].copy(), poses[..., POSE.rate].copy()
    angles[..., 1:] -= poses[..., :-1, POSE.tip_angle]
    rates[..., 1:] -= poses[..., :-1, POSE.tip_rate]
    return angles, rates
