"""Rigid two-link geometry and inertia, for many arms at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..parameters import Arm

Array = NDArray[np.float64]


def wrapped(angle: Array) -> Array:
    """The angle in [-pi, pi)."""
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


def tip_in_hub_frame(arm: Arm, elbow: Array, bends: Array) -> Array:
    """Tip (n, 2) in m, in the frame that turns with the hub, from elbow angles (n,) and deflections (n, 2) over length.

    The tip of link 1 turns by 1.5 times its deflection, as a cantilever's does that is bent by a force at its tip.
    """
    one, two = (link.length for link in arm.links)
    chord = 1.0 - 0.6 * bends**2
    angle = 1.5 * bends[:, 0] + elbow
    x = one * chord[:, 0] + two * (chord[:, 1] * np.cos(angle) - bends[:, 1] * np.sin(angle))
    y = one * bends[:, 0] + two * (chord[:, 1] * np.sin(angle) + bends[:, 1] * np.cos(angle))
    return np.stack([x, y], axis=1)


def target_in_hub_frame(arm: Arm, angles: Array, bends: Array, error: Array) -> Array:
    """Target (n, 2) in m, in the frame of the hub, from what an observation holds (see `base.Signals`)."""
    return tip_in_hub_frame(arm, angles[:, 1], bends) + error


def goal_angles(arm: Arm, angles: Array, target: Array, weight: Array) -> Array:
    """Joint angles (n, 2) of the rigid arm with its tip at the target, of the two solutions the one sooner reached.

    Args:
        angles (n, 2): now, rad. target (n, 2): in the frame of the hub as it stands at these angles, m.
        weight (n, 2): time that a joint takes for an angle x is weight sqrt(|x|).
    A target out of reach is approached along the line to it. Joint limits are kept, and no elbow turns past pi.
    """
    one, two = (link.length for link in arm.links)
    distance = np.linalg.norm(target, axis=1)
    cosine = np.clip((distance**2 - one**2 - two**2) / (2.0 * one * two), -1.0, 1.0)
    bearing = np.arctan2(target[:, 1], target[:, 0])
    moves, times = [], []
    low, high = arm.joint_limits[1] if arm.joint_limits and arm.joint_limits[1] else (-np.pi, np.pi)
    for sign in (1.0, -1.0):
        elbow = sign * np.arccos(cosine)
        hub = bearing - np.arctan2(two * np.sin(elbow), one + two * np.cos(elbow))
        move = np.stack([wrapped(hub), elbow - angles[:, 1]], axis=1)
        moves.append(move)
        times.append(np.max(weight * np.sqrt(np.abs(move)), axis=1) + 1e6 * ((elbow < low) | (elbow > high)))
    best = np.where((times[0] <= times[1])[:, None], moves[0], moves[1])
    return angles + best


def rigid_inertia(arm: Arm, elbow: Array) -> Array:
    """Inertia (n, 2, 2) in kg m^2 of the rigid arm about its joints, at elbow angles (n,)."""
    first, second = arm.links
    motor, payload = arm.elbow(1), arm.payload
    one, two = first.length, second.length
    beyond = motor.mass + second.mass + payload.mass
    about_root = (
        arm.hub_inertia + first.mass * one**2 / 3 + first.section.J * one + motor.inertia_left + beyond * one**2
    )
    outer = motor.inertia_right + second.mass * two**2 / 3 + second.section.J * two
    outer += payload.mass * two**2 + payload.inertia
    coupling = one * (second.mass * two / 2 + payload.mass * two) * np.cos(elbow)
    inertia = np.empty((len(elbow), 2, 2))
    inertia[:, 0, 0] = about_root + outer + 2.0 * coupling
    inertia[:, 0, 1] = inertia[:, 1, 0] = outer + coupling
    inertia[:, 1, 1] = outer
    return inertia


def coriolis(arm: Arm, elbow: Array, rates: Array) -> Array:
    """Torques (n, 2) in N m that the rigid arm needs at these joint rates (n, 2) beside inertia times acceleration."""
    second, payload = arm.links[1], arm.payload
    lever = arm.links[0].length * (second.mass / 2 + payload.mass) * second.length * np.sin(elbow)
    hub, turn = rates[:, 0], rates[:, 1]
    return np.stack([-lever * (2.0 * hub * turn + turn**2), lever * hub**2], axis=1)
