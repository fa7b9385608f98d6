"""Deflections and joint angles from the poses of links in the plane."""

import numpy as np

from ..physics.layout import POSE
from ..validation import Array


def link_deflection(poses: Array) -> Array:
    """Return each link's tip deflection, m: the component of tip - root normal to its root's tangent.

    poses (..., n_links, 12), see `physics.layout`; result (..., n_links).
    """
    dx, dy = poses[..., POSE.tip_x] - poses[..., POSE.x], poses[..., POSE.tip_y] - poses[..., POSE.y]
    angle = poses[..., POSE.angle]
    return np.asarray(np.cos(angle) * dy - np.sin(angle) * dx)


def joint_angles(poses: Array) -> tuple[Array, Array]:
    """Return joint angles (rad) and rates (rad/s): joint 0 from the x axis, joint k from the tip of link k - 1.

    poses (..., n_links, 12), see `physics.layout`; results (..., n_links).
    """
    angles, rates = poses[..., POSE.angle].copy(), poses[..., POSE.rate].copy()
    angles[..., 1:] -= poses[..., :-1, POSE.tip_angle]
    rates[..., 1:] -= poses[..., :-1, POSE.tip_rate]
    return angles, rates
