"""Where an arm's joints are to go, for many arms at once."""

import numpy as np

from ..parameters import Arm
from ..tasks.angles import least_angles, sooner_angles
from ..validation import Array


def wrapped(angle: Array) -> Array:
    """The angle in [-pi, pi)."""
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


def tip_in_hub_frame(arm: Arm, elbows: Array, bends: Array) -> Array:
    """Tip (n, 2) in m, in the frame that turns with the hub, from elbow angles (n, N - 1) and deflections (n, N) over
    length.

    The tip of a link turns by 1.5 times its deflection, as a cantilever's does that is bent by a force at its tip.
    """
    tip, angle = np.zeros((len(bends), 2)), np.zeros(len(bends))
    for k, link in enumerate(arm.links):
        cosine, sine, along, across = np.cos(angle), np.sin(angle), 1.0 - 0.6 * bends[:, k] ** 2, bends[:, k]
        tip[:, 0] += link.span * (along * cosine - across * sine)
        tip[:, 1] += link.span * (along * sine + across * cosine)
        if k + 1 < arm.n_links:
            angle = angle + (1.5 * bends[:, k] + elbows[:, k])
    return tip


def rigid_times(inertia: Array, to_go: Array, limits: Array) -> Array:
    """Times (n,), s, that a rigid arm of inertia (n, N, N) takes from rest to rest, its joints in step.

    to_go (n, N): angles that the joints turn by, rad. limits (N,): largest torques, N m.
    """
    load = np.abs(np.einsum("nij,nj->ni", inertia, to_go)) / limits
    times: Array = 2.0 * np.sqrt(load.max(axis=1))
    return times


def goal_of(lengths: Array, rates: Array, limits: Array, x: float, y: float, angles: Array) -> Array:
    """Joint angles (N,) that bring the tip of one arm of straight links to (x, y), as environments choose them.

    lengths, rates (N,), limits (2 N,) and angles (N,) now: see `tasks.angles`, whose kernels answer.
    """
    goal: Array = angles.copy()
    if len(lengths) == 2:
        sooner_angles(lengths, rates, limits, float(x), float(y), goal)
    else:
        least_angles(lengths, limits, float(x), float(y), goal)
    return goal


def goal_angles(arm: Arm, angles: Array, target: Array, rates: Array) -> Array:
    """Joint angles (n, N) of the rigid arm with its tip at the target.

    Of two links, the one of both solutions that is sooner reached; of more, the solution of least sum of squares
    (`tasks.angles`), the hub as near as whole turns bring it.

    Args:
        angles (n, N): now, rad. target (n, 2): in the frame of the hub as it stands at these angles, m.
        rates (n, N): time that a joint takes for an angle x is sqrt(|x|) / rate. For two links only.
    A target out of reach is approached along the line to it. Joint limits are kept, and no elbow turns past pi.
    """
    low_high = [(-np.inf, np.inf) if r is None else r for r in arm.joint_limits or (None,) * arm.n_links]
    lengths, limits = np.array([link.span for link in arm.links]), np.array(low_high, np.float64).ravel()
    hub = angles[:, 0]
    x = np.cos(hub) * target[:, 0] - np.sin(hub) * target[:, 1]
    y = np.sin(hub) * target[:, 0] + np.cos(hub) * target[:, 1]
    return np.array([goal_of(lengths, rates[i], limits, x[i], y[i], angles[i]) for i in range(len(angles))])
