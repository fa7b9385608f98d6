"""Angles, tip positions of arms with bent links, and minimum durations of motions, for many planar arms at once."""

import numpy as np

from ..parameters import Arm
from ..validation import Array


def wrapped(angle: Array) -> Array:
    """Wrap an angle, rad, to [-pi, pi)."""
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


def tip_in_hub_frame(arm: Arm, elbows: Array, bends: Array) -> Array:
    """Compute the tip position (n, 2), m, in the frame that turns with the hub.

    elbows (n, N - 1): angles of the elbow joints, rad. bends (n, N): tip deflection w of each link, divided by its
    length L. The tip of a link is assumed at L (1 - 0.6 w^2, w) in axes at its root, and rotated by 1.5 w, as for a
    cantilever with a force at its tip.
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
    """Return the minimum duration (n,), s, of rest-to-rest motions of rigid arms whose joints start and stop together.

    It is 2 sqrt(max_i |I dq|_i / tau_i). inertia (n, N, N): mass matrices I of the rigid arms, kg m^2. to_go (n, N):
    joint displacements dq, rad. limits (N,): largest torques tau, N m.
    """
    load = np.abs(np.einsum("nij,nj->ni", inertia, to_go)) / limits
    times: Array = 2.0 * np.sqrt(load.max(axis=1))
    return times
