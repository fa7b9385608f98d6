"""The arm with rigid links: reach, inertia, the torques that its rates ask for, and the scales that follow."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .bodies import about_z
from .parameters import Arm
from .validation import Array

ComplexOrReal = NDArray[Any]


def reach(arm: Arm) -> tuple[float, float]:
    """Smallest and largest distance of the tip from the root, m."""
    lengths = [link.span for link in arm.links]
    return max(0.0, 2.0 * max(lengths) - sum(lengths)), sum(lengths)


def link_inertia(arm: Arm) -> ComplexOrReal:
    """The (N, N) matrix C, kg m^2, with M_jk = Re C_jk exp(-i (alpha_j - alpha_k)) in the links' absolute angles alpha.

    Each body (link, motor, payload) at a_j exp(i alpha_j), summed over the links j on the way to it, adds m a_j* a_k,
    and its own inertia to the link that it turns with. C is real where all lies on straight lines from joint to joint.
    """
    n = arm.n_links
    bent = any(link.curved for link in arm.links)
    kind: Any = np.complex128 if arm.payload.eccentric or bent else np.float64
    lengths = np.array([link.far for link in arm.links], kind)
    total = np.zeros((n, n), kind)

    def add(mass: float, last: int, along: complex, inertia: float) -> None:
        levers = np.where(np.arange(n) < last, lengths, 0.0)
        levers[last] = along
        total[:, :] += mass * np.outer(levers.conj(), levers)
        total[last, last] += inertia

    for k, link in enumerate(arm.links):
        if k == 0:
            add(0.0, 0, 0.0, about_z(arm.hub_inertia))
        else:
            elbow = arm.elbow(k)
            add(elbow.mass, k - 1, lengths[k - 1], about_z(elbow.inertia_left))
            add(0.0, k, 0.0, about_z(elbow.inertia_right))
        if link.rigid_ends:
            for mass, along, inertia in link.ends:
                add(mass, k, complex(link.place(along - link.root_offset)) if link.curved else along, inertia)
        if link.uniform is not None and not link.rigid_ends:
            add(link.mass, k, 0.5 * link.length, link.mass * link.length**2 / 12.0 + link.rotary)
        elif link.curved:
            s, weights = link.quadrature()
            masses, z = weights * link.along(s).m, link.place(s)
            centre = complex(masses @ z / masses.sum())
            add(link.mass, k, centre, float(masses @ abs(z - centre) ** 2) + link.rotary)
        else:
            centre = link.moment(1) / link.mass if link.mass else 0.0
            add(link.mass, k, link.root_offset + centre, link.moment(2) - link.mass * centre**2 + link.rotary)
    tip = lengths[-1] + arm.payload.lever * np.exp(1j * arm.links[-1].turn) if arm.payload.eccentric else lengths[-1]
    add(arm.payload.mass, n - 1, tip, about_z(arm.payload.inertia))
    return total


def _differences(arm: Arm, elbows: Array) -> Array:
    """alpha_j - alpha_k (n, N, N) from elbow angles (n, N - 1), a link's being that of its tangent at its root."""
    elbows = np.asarray(elbows, np.float64)
    if any(link.curved for link in arm.links):
        elbows = elbows + [link.turn for link in arm.links[:-1]]
    alpha = np.concatenate([np.zeros((len(elbows), 1)), np.cumsum(elbows, axis=1)], axis=1)
    return np.asarray(alpha[:, :, None] - alpha[:, None, :])


def _of_joints(values: Array, axis: int) -> Array:
    """Sums over links k ... N - 1 along an axis: what acts on link k and beyond acts at joint k."""
    return np.flip(np.cumsum(np.flip(values, axis), axis), axis)


def rigid_inertia(arm: Arm, elbows: Array) -> Array:
    """Inertia (n, N, N) in kg m^2 about the joints, rotors included, at elbow angles (n, N - 1) in rad."""
    rotors = np.diag([arm.joint(k).rotor for k in range(arm.n_links)])
    C, turned = link_inertia(arm), _differences(arm, elbows)
    return _of_joints(_of_joints(C.real * np.cos(turned) + C.imag * np.sin(turned), 1), 2) + rotors


def coriolis(arm: Arm, elbows: Array, rates: Array) -> Array:
    """Torques (n, N) in N m that joint rates (n, N) in rad/s ask for, beside inertia times acceleration."""
    squares = np.cumsum(rates, axis=1) ** 2
    C, turned = link_inertia(arm), _differences(arm, elbows)
    pulls = C.real * np.sin(turned) - C.imag * np.cos(turned)
    return _of_joints(np.einsum("njk,nk->nj", pulls, squares), 1)


def inertia_beyond(arm: Arm, joint: int) -> float:
    """Inertia (kg m^2) about a joint of the straight arm from that joint to the tip."""
    return float(rigid_inertia(arm, np.zeros((1, arm.n_links - 1)))[0, joint, joint])


def rate_scale(arm: Arm, joint: int) -> float:
    """sqrt(tau pi/2 / I), rad/s: top rate of a rigid quarter turn, rest to rest at full torque, reached midway."""
    limits = arm.torque_limits
    assert limits is not None
    return math.sqrt(limits[joint] * (math.pi / 2) / inertia_beyond(arm, joint))


def centre_shift(arm: Arm) -> float:
    """How far the centre of mass of arm and base is from the hub at most, m; 0 without a base.

    A free arm's hub is so far from a point that stays, and its tip within the arm's length less that.
    """
    if arm.base is None:
        return 0.0
    along, moment = 0.0, 0.0
    for k, link in enumerate(arm.links):
        if k > 0:
            moment += arm.elbow(k).mass * along
        moment += link.mass * (along + link.root_offset) + link.moment(1)
        moment += sum(mass * (along + at) for mass, at, _ in link.ends)
        along += link.span
    moment += arm.payload.mass * (along + math.hypot(*arm.payload.offset))
    return moment / (arm.mass + arm.base.mass)
