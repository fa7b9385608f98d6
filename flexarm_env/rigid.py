"""Arm with rigid links in the plane: reach, inertia, Coriolis torques, and time scales derived from them.

The angle alpha_k is the absolute angle of the tangent at link k's root, rad. Positions are complex numbers x + i y: a
link that spans a from joint to joint contributes a exp(i alpha_k).
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .bodies import about_z
from .parameters import Arm
from .validation import Array

ComplexOrReal = NDArray[Any]

SETTLED = 0.5
"""Time (s) that the tip has to stay at a target for a success."""
TURNS, PERIODS = 2.0, 50.0
"""TURNS: duration of an episode in units of the time of a quarter turn, without `SETTLED`. PERIODS: number of control
periods in a quarter turn.
"""
STEPS = (1.0, 2.0, 5.0)
"""Leading digits of suggested control periods: 1, 2 or 5 times a power of ten."""


def reach(arm: Arm) -> tuple[float, float]:
    """Return the smallest and largest distance of the tip from the root, m."""
    lengths = [link.span for link in arm.links]
    return max(0.0, 2.0 * max(lengths) - sum(lengths)), sum(lengths)


def largest_force(arm: Arm) -> float:
    """Return the largest force (N) across the straight arm's tip that all motors can balance."""
    levers = np.cumsum([link.span for link in arm.links][::-1])[::-1]
    assert arm.torque_limits is not None
    return float(min(np.array(arm.torque_limits) / levers))


def link_inertia(arm: Arm) -> ComplexOrReal:
    """Return the constants C (N, N), kg m^2, of the inertia matrix M for the links' absolute angles alpha.

    The matrix is M_jk = Re C_jk exp(-i (alpha_j - alpha_k)). A body (link, elbow, motor or payload) has the position
    sum_j a_j exp(i alpha_j), summed over the links up to the body. The body adds m conj(a_j) a_k to C, and its own
    inertia to the entry of the link with which it turns. C is real if all bodies lie on straight lines from joint to
    joint.
    """
    ends = _link_ends(arm)
    total = np.zeros((arm.n_links, arm.n_links), ends.dtype)
    for mass, last, along, inertia in _bodies(arm, ends):
        levers = _levers(ends, last, along)
        total[:, :] += mass * np.outer(levers.conj(), levers)
        total[last, last] += inertia
    return total


def mass_moments(arm: Arm) -> ComplexOrReal:
    """Return the vector S (N,), kg m: the sum of the bodies' mass times position is sum_k S_k exp(i alpha_k)."""
    ends = _link_ends(arm)
    total = np.zeros(arm.n_links, ends.dtype)
    for mass, last, along, _ in _bodies(arm, ends):
        total += mass * _levers(ends, last, along)
    return total


def _link_ends(arm: Arm) -> ComplexOrReal:
    """Return the position of each link's far joint in the axes of its root, (N,) m.

    The numbers are complex, x + i y, or real if all bodies lie on straight lines from joint to joint.
    """
    bent = any(link.curved for link in arm.links)
    kind: Any = np.complex128 if arm.payload.eccentric or bent else np.float64
    return np.array([link.far for link in arm.links], kind)


def _levers(ends: ComplexOrReal, last: int, along: complex) -> ComplexOrReal:
    """Return the levers a_j, (N,) m, of a body at `along` (m) in the axes of link `last`.

    The body's position is sum a_j exp(i alpha_j), with the absolute angles alpha of the links.
    """
    levers = np.where(np.arange(len(ends)) < last, ends, 0.0)
    levers[last] = along
    return levers


def _bodies(arm: Arm, lengths: ComplexOrReal) -> Iterator[tuple[float, int, complex, float]]:
    """Yield the data of each body of the arm.

    The data of a body are its mass (kg), the index of the link with which it turns, its position in this link's axes
    (m), and its own inertia (kg m^2).

    lengths: far joint of each link in the axes of its root, m. Rotors of motors are not included.
    """
    for k, link in enumerate(arm.links):
        # hub, or elbow: mass and left inertia belong to the link before, the right inertia to this one
        if k == 0:
            yield 0.0, 0, 0.0, about_z(arm.hub_inertia)
        else:
            elbow = arm.elbow(k)
            yield elbow.mass, k - 1, lengths[k - 1], about_z(elbow.inertia_left)
            yield 0.0, k, 0.0, about_z(elbow.inertia_right)
        # rigid ends
        if link.rigid_ends:
            for mass, along, inertia in link.ends:
                yield mass, k, complex(link.place(along - link.root_offset)) if link.curved else along, inertia
        # the flexible part: uniform, curved, or varying along a straight line
        if link.uniform is not None and not link.rigid_ends:
            yield link.mass, k, 0.5 * link.length, link.mass * link.length**2 / 12.0 + link.rotary
        elif link.curved:
            s, weights = link.quadrature()
            masses, z = weights * link.along(s).m, link.place(s)
            centre = complex(masses @ z / masses.sum())
            yield link.mass, k, centre, float(masses @ abs(z - centre) ** 2) + link.rotary
        else:
            middle = link.moment(1) / link.mass if link.mass else 0.0
            inertia = link.moment(2) - link.mass * middle**2 + link.rotary
            yield link.mass, k, link.root_offset + middle, inertia
    # payload, off the tip where it is eccentric
    tip = lengths[-1] + arm.payload.lever * np.exp(1j * arm.links[-1].turn) if arm.payload.eccentric else lengths[-1]
    yield arm.payload.mass, arm.n_links - 1, tip, about_z(arm.payload.inertia)


def _differences(arm: Arm, elbows: Array) -> Array:
    """Return alpha_j - alpha_k, (n, N, N) rad, from elbow angles (n, N - 1) rad; curved links add their own angle."""
    elbows = np.asarray(elbows, np.float64)
    if any(link.curved for link in arm.links):
        elbows = elbows + [link.turn for link in arm.links[:-1]]
    alpha = np.concatenate([np.zeros((len(elbows), 1)), np.cumsum(elbows, axis=1)], axis=1)
    return np.asarray(alpha[:, :, None] - alpha[:, None, :])


def _of_joints(values: Array, axis: int) -> Array:
    """Return sums over links k ... N - 1 along an axis: forces on link k and all later links act at joint k."""
    return np.flip(np.cumsum(np.flip(values, axis), axis), axis)


def rigid_inertia(arm: Arm, elbows: Array) -> Array:
    """Return the inertia matrices for joint angles, (n, N, N), kg m^2, with rotors, at elbow angles (n, N - 1), rad."""
    rotors = np.diag([arm.joint(k).rotor for k in range(arm.n_links)])
    C, turned = link_inertia(arm), _differences(arm, elbows)
    return _of_joints(_of_joints(C.real * np.cos(turned) + C.imag * np.sin(turned), 1), 2) + rotors


def coriolis(arm: Arm, elbows: Array, rates: Array) -> Array:
    """Return the Coriolis and centrifugal torques (n, N), N m, at joint rates (n, N), rad/s.

    These torques are the joint torques minus inertia matrix times joint accelerations. elbows (n, N - 1): elbow angles,
    rad. rates (n, N): joint rates, rad/s.
    """
    # rates of the absolute angles, squared
    squares = np.cumsum(rates, axis=1) ** 2
    C, turned = link_inertia(arm), _differences(arm, elbows)
    pulls = C.real * np.sin(turned) - C.imag * np.cos(turned)
    return _of_joints(np.einsum("njk,nk->nj", pulls, squares), 1)


def inertia_beyond(arm: Arm, joint: int) -> float:
    """Return the inertia (kg m^2) about a joint of the straight arm from that joint to the tip, rotor included."""
    return float(rigid_inertia(arm, np.zeros((1, arm.n_links - 1)))[0, joint, joint])


def rate_scale(arm: Arm, joint: int) -> float:
    """Return the top rate sqrt(tau pi/2 / I), rad/s, of a rigid quarter turn from rest to rest at full torque.

    The arm reaches this rate in the middle of the turn. tau is the joint's torque limit, and I the inertia of the
    straight arm about the joint.
    """
    limits = arm.torque_limits
    assert limits is not None
    return math.sqrt(limits[joint] * (math.pi / 2) / inertia_beyond(arm, joint))


def centre_shift(arm: Arm) -> float:
    """Return the hub's largest distance from the center of mass of arm and floating base, m; 0 without a base.

    If the base floats freely, this center of mass is a fixed point. The hub stays within the returned distance of the
    center of mass, and the tip within the arm's length minus this distance.
    """
    if arm.base is None:
        return 0.0
    along, moment = 0.0, 0.0
    # first moments of the straight arm about the hub, kg m
    for k, link in enumerate(arm.links):
        if k > 0:
            moment += arm.elbow(k).mass * along
        moment += link.mass * (along + link.root_offset) + link.moment(1)
        moment += sum(mass * (along + at) for mass, at, _ in link.ends)
        along += link.span
    moment += arm.payload.mass * (along + math.hypot(*arm.payload.offset))
    return moment / (arm.mass + arm.base.mass)


@dataclass(frozen=True)
class TimeScales:
    """Time scales of an arm with torque limits.

    Attributes:
        quarter_turns (N,): minimum time of a quarter turn of each joint from rest to rest, s. The motor applies the
            full torque, reversed in the middle of the turn, and the arm beyond the joint is straight and rigid. slew:
            the longest of these times, s.
        duration: duration of an episode, s. control_dt: control period, s. gamma: discount factor per control period,
            whose horizon dt/(1 - gamma) equals a slew.
    """

    quarter_turns: tuple[float, ...]
    slew: float
    duration: float
    control_dt: float
    gamma: float


def timescales(arm: Arm, control_dt: float | None = None) -> TimeScales:
    """Compute the time scales of an arm.

    control_dt: control period, s, or None for a suggested control period.
    """
    # minimum time of a quarter turn, 2 sqrt(I (pi/2) / tau)
    quarters = tuple(math.pi / rate_scale(arm, k) for k in range(arm.n_links))
    slew = max(quarters)
    # rounded up to half a second
    duration = math.ceil(2.0 * (TURNS * slew + SETTLED)) / 2.0
    period = _leading(slew / PERIODS) if control_dt is None else control_dt
    return TimeScales(quarters, slew, duration, period, round(max(0.5, 1.0 - period / slew), 4))


def _leading(value: float) -> float:
    """Round a value down to 1, 2 or 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(value))
    return float(f"{max(step for step in STEPS if step * power <= value * (1.0 + 1e-9)) * power:.1g}")
