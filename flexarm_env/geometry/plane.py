"""Planar kinematics for targets of the tip: joint angles, tip positions and minimum times of many arms at once."""

import numpy as np

from ..parameters import Arm
from ..tasks.angles import least_angles, sooner_angles
from ..validation import Array


def wrapped(angle: Array) -> Array:
    """Wrap an angle, rad, to [-pi, pi)."""
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


def tip_in_hub_frame(arm: Arm, elbows: Array, bends: Array) -> Array:
    """Compute the tip position (n, 2), m, in the frame that turns with the hub.

    elbows (n, N - 1): angles of the elbow joints, rad. bends (n, N): tip deflection w of each link, divided by its
    length. A link's tip is at L (1 - 0.6 w^2, w) in its root frame and is turned by 1.5 w, as in a cantilever bent by a
    force at its tip.
    """
    tip, angle = np.zeros((len(bends), 2)), np.zeros(len(bends))
    for k, link in enumerate(arm.links):
        cosine, sine, along, across = np.cos(angle), np.sin(angle), 1.0 - 0.6 * bends[:, k] ** 2, bends[:, k]
        tip[:, 0] += link.span * (along * cosine - across * sine)
        tip[:, 1] += link.span * (along * sine + across * cosine)
        if k + 1 < arm.n_links:
            # root of the next link: slope at this tip plus elbow angle
            angle = angle + (1.5 * bends[:, k] + elbows[:, k])
    return tip


def rigid_times(inertia: Array, to_go: Array, limits: Array) -> Array:
    """Return the minimum time (n,), s, of a rigid arm from rest to rest with synchronized joints.

    The minimum time is 2 sqrt(max_i |I dq|_i / tau_i). inertia (n, N, N): mass matrices I of the rigid arms, kg m^2.
    to_go (n, N): joint displacements dq, rad. limits (N,): largest torques tau, N m.
    """
    load = np.abs(np.einsum("nij,nj->ni", inertia, to_go)) / limits
    times: Array = 2.0 * np.sqrt(load.max(axis=1))
    return times


def goal_of(lengths: Array, rates: Array, limits: Array, x: float, y: float, angles: Array) -> Array:
    """Return joint angles (N,), rad, with which the tip of a straight-link arm is at (x, y), m, relative to its root.

    The environments choose the same solution as this function. x, y: target in inertial axes. lengths (N,): lengths of
    the links, m. rates (N,): speed factors of the joints; a joint's time is proportional to sqrt(|angle|) / rate.
    limits (2 N,), rad: lower and upper limit of each joint in turn. angles (N,): present joint angles, rad. With two
    links the function returns the solution with the shorter time, with more links the solution with the least sum of
    squares of the angles (`tasks.angles`). If the point is out of reach, the arm points along the line to the point.
    """
    goal: Array = angles.copy()
    if len(lengths) == 2:
        sooner_angles(lengths, rates, limits, float(x), float(y), goal)
    else:
        least_angles(lengths, limits, float(x), float(y), goal)
    return goal


def goal_angles(arm: Arm, angles: Array, target: Array, rates: Array) -> Array:
    """Compute joint angles (n, N), rad, that place the rigid arm's tip at the target.

    With two links, the solution with the shorter time is chosen; with more links, the solution with the least sum of
    squares of the angles (`tasks.angles`). The hub angle is unwrapped to the nearest turn.

    Args:
        angles (n, N): present joint angles, rad. target (n, 2): target of the tip, m, in hub axes at these angles.
        rates (n, N): speed factors, for two links only; a joint turns by x in a time proportional to sqrt(|x|) / rate.
    A target out of reach is approached along the line to the target. Joint limits are kept, and no elbow turns past pi.
    """
    low_high = [(-np.inf, np.inf) if r is None else r for r in arm.joint_limits or (None,) * arm.n_links]
    lengths, limits = np.array([link.span for link in arm.links]), np.array(low_high, np.float64).ravel()
    # target from hub axes to inertial axes
    hub = angles[:, 0]
    x = np.cos(hub) * target[:, 0] - np.sin(hub) * target[:, 1]
    y = np.sin(hub) * target[:, 0] + np.cos(hub) * target[:, 1]
    return np.array([goal_of(lengths, rates[i], limits, x[i], y[i], angles[i]) for i in range(len(angles))])
