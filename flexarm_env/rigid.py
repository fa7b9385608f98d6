"""Rigid model of an arm, with rigid links in place of flexible ones: kinematics, inertia, gravity torques, time scales.

Arguments named `angles` are joint angles (n, N), rad. The function `bodies` lists the arm's masses. Inertia, Coriolis
torques and gravity torques are sums over the arm's bodies. Positions in the plane are complex numbers x + i y. Let a be
the vector from joint k to joint k + 1 in the axes of link k's root, and alpha_k the absolute angle of the tangent at
this root. Link k contributes a exp(i alpha_k) to the tip's position. In the plane the coefficients of inertia and
gravity torques do not depend on the angles (`link_inertia`, `mass_moments`).
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import curves
from . import validation as check
from .bodies import Body, Inertia, RigidLink, combined_body, tensor
from .parameters import Arm, Link, Taper
from .rotations import cross, matrices
from .sections import ACROSS, Section
from .validation import Array

ComplexOrReal = NDArray[Any]

SETTLED = 0.5
"""Time (s) for which the tip must stay at a target for the episode to count as a success."""
TURNS, PERIODS = 2.0, 50.0
"""TURNS: duration of an episode in units of the time of a quarter turn, without `SETTLED`. PERIODS: number of control
periods in a quarter turn.
"""
STEPS = (1.0, 2.0, 5.0)
"""Leading digits of suggested control periods: 1, 2 or 5 times a power of ten."""


def reach(arm: Arm) -> tuple[float, float]:
    """Return the smallest and the largest possible distance of the rigid arm's tip from its root, m."""
    lengths = [link.span for link in arm.links]
    return max(0.0, 2.0 * max(lengths) - sum(lengths)), sum(lengths)


def largest_force(arm: Arm) -> float:
    """Return the largest force, N, at the tip and normal to the straight arm, that the motors can balance."""
    levers = np.cumsum([link.span for link in arm.links][::-1])[::-1]
    assert arm.torque_limits is not None
    return float(min(np.array(arm.torque_limits) / levers))


# ---------------------------------------------------------------------- kinematics
def mount_of(arm: Arm, k: int) -> Array:
    """Return the rotation matrix, at joint angle 0, from the axes of link k's root to the axes before joint k.

    The axes before the joint are those of the previous link's tip, or the inertial axes for joint 0.
    """
    mount = arm.hub_mount if k == 0 else arm.elbow(k).mount
    return np.eye(3) if mount is None else np.array(mount)


def axis_of(arm: Arm, k: int) -> Array:
    """Return the axis of joint k, a unit vector in the axes of the root of link k."""
    return np.array(arm.hub_axis if k == 0 else arm.elbow(k).axis)


def frames(arm: Arm, angles: Array) -> tuple[Array, Array, Array, Array]:
    """Compute the rigid arm's kinematics at joint angles (..., N), rad.

    Returns the joints' positions (..., N, 3), m, the directions of the joints' axes (..., N, 3), the axes of the links'
    roots (..., N, 3, 3) as columns of matrices, and the tip's position (..., 3), m. All vectors have components along
    inertial axes; the origin is the root.
    """
    A, r = np.broadcast_to(np.eye(3), (*angles.shape[:-1], 3, 3)), np.zeros((*angles.shape[:-1], 3))
    places, axes, links = [], [], []
    for k, link in enumerate(arm.links):
        # A_k = A mount exp(axis theta); r_(k+1) = r + A far
        axis = axis_of(arm, k)
        A = A @ mount_of(arm, k) @ matrices(angles[..., k, None] * axis)
        places.append(r)
        axes.append(A @ axis)
        links.append(A)
        if link.curved:
            r, A = r + A @ _in_axes(link.far), A @ _turn(link)
        else:
            r = r + link.span * A[..., 0]
    return np.stack(places, -2), np.stack(axes, -2), np.stack(links, -3), r


def tip_at(arm: Arm, angles: Array) -> Array:
    """Return the rigid arm's tip position (..., 3), m, inertial axes, at joint angles (..., N), rad."""
    return frames(arm, angles)[3]


def jacobian(arm: Arm, angles: Array) -> Array:
    """Return the Jacobian (..., 3, N), m/rad, of the rigid arm's tip position by the joint angles.

    Column k is e_k x (tip - p_k) with the direction e_k of joint k's axis and the joint's position p_k, m, in inertial
    axes. angles (..., N): joint angles, rad.
    """
    places, axes, _, tip = frames(arm, angles)
    return np.swapaxes(np.cross(axes, tip[..., None, :] - places), -1, -2)


def _in_axes(place: complex) -> Array:
    """Return a position x + i y, m, in a link's axes as a vector (3,)."""
    return np.array([np.real(place), np.imag(place), 0.0])


def _turn(link: Link) -> Array:
    """Return the rotation matrix from tip axes to root axes of a stress-free link."""
    return matrices(np.array([0.0, 0.0, link.turn]))


# --------------------------------------------------------------------------- bodies
def bodies(arm: Arm) -> Iterator[tuple[int, Body]]:
    """Yield for each body of the rigid arm the index of its link, and the `Body` in the axes of this link's root.

    Bodies are hub, elbows, rigid ends, beams, rigid links and payload, but not the rotors of the motors.
    """
    for k, link in enumerate(arm.links):
        # hub, or elbow: mass and left inertia belong to the link before, the right inertia to this one
        if k == 0:
            yield 0, Body(0.0, np.zeros(3), tensor(arm.hub_inertia))
        else:
            elbow, before = arm.elbow(k), arm.links[k - 1]
            yield k - 1, Body(elbow.mass, _in_axes(before.far), _at_tip(before, elbow.inertia_left))
            yield k, Body(0.0, np.zeros(3), tensor(elbow.inertia_right))
        if isinstance(link, RigidLink):
            yield k, Body(link.mass, np.array(link.centre), tensor(link.inertia))
            continue
        if link.rigid_ends:
            for mass, along, inertia in link.ends:
                place = complex(link.place(along - link.root_offset)) if link.curved else along
                yield k, Body(mass, _in_axes(place), tensor(inertia))
        yield k, _beam(link)
    # payload, off the tip where it is eccentric
    last, held = arm.links[-1], arm.payload
    tip = _in_axes(last.far + held.lever * np.exp(1j * last.turn) if held.eccentric else last.far)
    tip[2] = (*held.offset, 0.0)[2]
    yield arm.n_links - 1, Body(held.mass, tip, _at_tip(last, held.inertia))


def _at_tip(link: Link, inertia: Inertia) -> Array:
    """Return an inertia given in the axes of a link's tip as a tensor in the axes of the link's root, kg m^2."""
    turned = link.curved and isinstance(inertia, tuple)
    return np.asarray(_turn(link) @ tensor(inertia) @ _turn(link).T) if turned else tensor(inertia)


def _beam(link: Link) -> Body:
    """Return a link's stress-free beam as a rigid body in the axes of the link's root."""
    rotary, across = link.rotary, _rotary_across(link)
    if link.curved:
        s, weights = link.quadrature()
        masses, z = weights * link.along(s).m, link.place(s)
        centre = complex(masses @ z / masses.sum())
        # second moments of mass about the center; sections turned by the tangent's angle
        away, tangent = z - centre, np.exp(1j * curves.angle(link.curvature, s))
        J = weights * link.along(s).J
        xx = masses @ away.imag**2 + J @ tangent.real**2
        yy = masses @ away.real**2 + J @ tangent.imag**2
        xy = J @ (tangent.real * tangent.imag) - masses @ (away.real * away.imag)
        zz = float(masses @ abs(away) ** 2) + rotary
        inertia = np.array([[xx + across, xy, 0.0], [xy, yy + across, 0.0], [0.0, 0.0, zz]])
        return Body(link.mass, _in_axes(centre), inertia)
    if link.uniform is not None and not link.rigid_ends:
        middle, swing = 0.5 * link.length, link.mass * link.length**2 / 12.0
    else:
        middle = link.moment(1) / link.mass if link.mass else 0.0
        swing = link.moment(2) - link.mass * middle**2
        middle = link.root_offset + middle
    return Body(link.mass, _in_axes(middle), np.diag([rotary + across, swing + across, swing + rotary]))


def _rotary_across(link: Link) -> float:
    """Return the integral of J_y along a beam, kg m^2; 0 for planar sections, which lack J_y."""
    if isinstance(link.section, Taper):
        known = True
    else:
        sections = [link.section] if isinstance(link.section, Section) else [section for _, section in link.section]
        known = all(getattr(section, name) is not None for section in sections for name in ACROSS)
    if not known:
        return 0.0
    s, weights = link.quadrature()
    return float(weights @ link.across(s)["J_y"])


def link_bodies(arm: Arm) -> list[Body]:
    """Return one body for each link: all `bodies` of this link combined."""
    found: list[list[Body]] = [[] for _ in arm.links]
    for k, body in bodies(arm):
        found[k].append(body)
    return [combined_body(parts) for parts in found]


# ------------------------------------------------------------------------- dynamics
def weight_and_inertia(
    arm: Arm, gravity: Array, angles: Array, parts: Sequence[Body] | None = None
) -> tuple[Array, Array]:
    """Compute gravity torques (n, N), N m, and joint inertia (n, N, N), kg m^2, of the rigid arm with its rotors.

    gravity (3,): acceleration of gravity, m/s^2. angles (n, N): joint angles, rad. parts: result of `link_bodies(arm)`;
    if None, the function calls `link_bodies`.
    """
    places, axes, links, _ = frames(arm, angles)
    torques, inertia = np.zeros(angles.shape), np.zeros((*angles.shape, arm.n_links))
    inertia += np.diag([arm.joint(k).rotor for k in range(arm.n_links)])
    for k, part in enumerate(link_bodies(arm) if parts is None else parts):
        moved = slice(k + 1)
        # e_j x (center - p_j), velocity of the center by joint rate; joint axes in link axes
        swing = cross(axes[:, moved], (places[:, k] + links[:, k] @ part.centre)[:, None] - places[:, moved])
        own = axes[:, moved] @ links[:, k]
        # holding torque -m (e x r) . g; inertia m s s' + e' J e
        torques[:, moved] -= part.mass * swing @ gravity
        inertia[:, moved, moved] += part.mass * swing @ np.swapaxes(swing, 1, 2)
        inertia[:, moved, moved] += own @ part.inertia @ np.swapaxes(own, 1, 2)
    return torques, inertia


def rigid_inertia(arm: Arm, angles: Array) -> Array:
    """Return the joint inertia matrices (n, N, N), kg m^2, with rotors, at joint angles (n, N), rad."""
    angles = _joints("angles", arm, angles)
    return _recursions(arm)[0](arm, angles)


def coriolis(arm: Arm, angles: Array, rates: Array) -> Array:
    """Return the Coriolis and centrifugal torques (n, N), N m, at joint angles, rad, and rates, rad/s, (n, N) each.

    The result equals the joint torques minus the gravity torques minus the inertia matrix times the joint
    accelerations. Gyroscopic moments of rotors are not included.
    """
    return _recursions(arm)[1](arm, _joints("angles", arm, angles), rates)


def _recursions(arm: Arm) -> tuple[Callable[..., Array], Callable[..., Array]]:
    """Return the functions that compute inertia matrices and Coriolis torques; in the plane closed forms, quicker."""
    return (_inertia_in_space, _coriolis) if arm.spatial else (_planar_inertia, _planar_coriolis)


def _inertia_in_space(arm: Arm, angles: Array) -> Array:
    return weight_and_inertia(arm, np.zeros(3), angles)[1]


def _planar_coriolis(arm: Arm, angles: Array, rates: Array) -> Array:
    """Return `coriolis` in the plane."""
    # rates of the absolute angles, squared
    squares = np.cumsum(rates, axis=1) ** 2
    C, turned = link_inertia(arm), _differences(arm, angles)
    pulls = C.real * np.sin(turned) - C.imag * np.cos(turned)
    return _of_joints(np.einsum("njk,nk->nj", pulls, squares), 1)


def _coriolis(arm: Arm, angles: Array, rates: Array) -> Array:
    """Return `coriolis` by recursion from the root: accelerations of the links at joint accelerations 0."""
    places, axes, links, tip = frames(arm, angles)
    ends = np.concatenate([places[:, 1:], tip[:, None]], axis=1)
    spin, growth, a = np.zeros((3, len(angles), 3))
    torques = np.zeros(angles.shape)
    for k, part in enumerate(link_bodies(arm)):
        # omega_k = omega + e q', omega_k' = omega' + omega x e q'
        turn = axes[:, k] * rates[:, k, None]
        growth, spin = growth + cross(spin, turn), spin + turn
        # force m r'' on the body, and moment J omega' + omega x J omega about its center, inertial axes
        lever, J = links[:, k] @ part.centre, links[:, k] @ part.inertia @ np.swapaxes(links[:, k], 1, 2)
        force = part.mass * (a + _swept(growth, spin, lever))
        moment = (J @ growth[..., None])[..., 0] + cross(spin, (J @ spin[..., None])[..., 0])
        # torque e_j . ((r - p_j) x force + moment) of joints 0 ... k
        levers = (places[:, k] + lever)[:, None] - places[:, : k + 1]
        torques[:, : k + 1] += (axes[:, : k + 1] * (cross(levers, force[:, None]) + moment[:, None])).sum(axis=-1)
        a = a + _swept(growth, spin, ends[:, k] - places[:, k])
    return torques


def _swept(growth: Array, spin: Array, lever: Array) -> Array:
    """Return the acceleration omega' x r + omega x (omega x r), m/s^2, of a point at r (m) on a turning body."""
    return cross(growth, lever) + cross(spin, cross(spin, lever))


def _joints(path: str, arm: Arm, angles: Array) -> Array:
    """Validate the shape (n, N) of joint angles."""
    angles = np.asarray(angles, np.float64)
    if angles.ndim != 2 or angles.shape[1] != arm.n_links:
        raise check.InvalidValue(f"shape of {path}", angles.shape, f"must be (n, {arm.n_links}): one per joint")
    return angles


# ------------------------------------------------------------- sums in the plane
def link_inertia(arm: Arm) -> ComplexOrReal:
    """Return the constant matrix C (N, N), kg m^2, from which a planar arm's inertia matrix M is computed.

    M refers to the links' absolute angles alpha: M_jk = Re(C_jk exp(-i (alpha_j - alpha_k))). The position of a body is
    sum_j a_j exp(i alpha_j), with a sum over the links up to the body. A body of mass m adds m conj(a_j) a_k to C_jk.
    The body also adds its moment of inertia to the diagonal entry of its link. C is real if all bodies lie on straight
    lines from joint to joint.
    """
    ends = _link_ends(arm)
    total = np.zeros((arm.n_links, arm.n_links), ends.dtype)
    for last, body in bodies(arm):
        levers = _levers(ends, last, body)
        total[:, :] += body.mass * np.outer(levers.conj(), levers)
        total[last, last] += body.inertia[2, 2]
    return total


def mass_moments(arm: Arm) -> ComplexOrReal:
    """Return the first mass moments S (N,), kg m, of a planar arm.

    The sum of mass times position over all bodies is sum_k S_k exp(i alpha_k), with the links' absolute angles alpha_k.
    """
    ends = _link_ends(arm)
    total = np.zeros(arm.n_links, ends.dtype)
    for last, body in bodies(arm):
        total += body.mass * _levers(ends, last, body)
    return total


def _planar_inertia(arm: Arm, angles: Array) -> Array:
    """Return `rigid_inertia` of a planar arm: sums of M_jk over the links beyond both joints."""
    rotors = np.diag([arm.joint(k).rotor for k in range(arm.n_links)])
    C, turned = link_inertia(arm), _differences(arm, angles)
    return _of_joints(_of_joints(C.real * np.cos(turned) + C.imag * np.sin(turned), 1), 2) + rotors


def _link_ends(arm: Arm) -> ComplexOrReal:
    """Return the position of each link's far joint in the axes of its root, (N,) m.

    The numbers are complex, x + i y, or real if all bodies lie on straight lines from joint to joint.
    """
    bent = any(link.curved for link in arm.links) or any(body.mass and body.centre[1] for _, body in bodies(arm))
    kind: Any = np.complex128 if bent else np.float64
    return np.array([link.far for link in arm.links], kind)


def _levers(ends: ComplexOrReal, last: int, body: Body) -> ComplexOrReal:
    """Return the levers a_j, (N,) m, of a body on link `last`: its position is sum a_j exp(i alpha_j)."""
    levers = np.where(np.arange(len(ends)) < last, ends, 0.0)
    x, y, _ = body.centre.tolist()
    levers[last] = complex(x, y) if np.iscomplexobj(ends) else x
    return levers


def _differences(arm: Arm, angles: Array) -> Array:
    """Return alpha_j - alpha_k, (n, N, N) rad, from joint angles (n, N) rad; curved links add their own angle."""
    elbows = angles[:, 1:]
    if any(link.curved for link in arm.links):
        elbows = elbows + [link.turn for link in arm.links[:-1]]
    alpha = np.concatenate([np.zeros((len(elbows), 1)), np.cumsum(elbows, axis=1)], axis=1)
    return np.asarray(alpha[:, :, None] - alpha[:, None, :])


def _of_joints(values: Array, axis: int) -> Array:
    """Return the sums over links k ... N - 1 along an axis: forces on these links act at joint k."""
    return np.flip(np.cumsum(np.flip(values, axis), axis), axis)


def inertia_beyond(arm: Arm, joint: int) -> float:
    """Return the moment of inertia, kg m^2, about a joint of the straight arm between this joint and the tip.

    The rotor of the joint's motor is included. The joint's axis is the z axis of the next link; in space the axes of
    all further links are parallel to this link's axes.
    """
    return float(_planar_inertia(arm, np.zeros((1, arm.n_links)))[0, joint, joint])


def rate_scale(arm: Arm, joint: int) -> float:
    """Return sqrt(tau pi/2 / I), rad/s: the largest rate in the fastest rest-to-rest quarter turn of the rigid arm.

    tau is the joint's torque limit, and I is the inertia of the straight arm about the joint (`inertia_beyond`). The
    torque is tau in the first half of the turn and -tau in the second half.
    """
    limits = arm.torque_limits
    assert limits is not None
    return math.sqrt(limits[joint] * (math.pi / 2) / inertia_beyond(arm, joint))


def centre_shift(arm: Arm) -> float:
    """Return the largest possible distance, m, of the hub from the center of mass of arm and base; 0 without a base.

    If the base floats freely, the center of mass does not move. The hub's distance from the center of mass is at most
    the returned distance. The tip's distance from the center of mass is at most the arm's length minus the returned
    distance.
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
        quarter_turns (N,): for each joint, the shortest time, s, of a 90 degree turn from rest to rest with full
            torque. The arm beyond the joint is straight and rigid. slew: the longest time in `quarter_turns`, s.
        duration: suggested duration of an episode, s. control_dt: control period, s. gamma: suggested discount factor,
            for which the horizon control_dt / (1 - gamma) equals `slew`.
    """

    quarter_turns: tuple[float, ...]
    slew: float
    duration: float
    control_dt: float
    gamma: float


def timescales(arm: Arm, control_dt: float | None = None) -> TimeScales:
    """Compute an arm's time scales from the fastest quarter turns of its rigid model.

    control_dt: control period, s; None to compute a suggested control period.
    """
    # minimum time of a quarter turn, 2 sqrt(I (pi/2) / tau)
    quarters = tuple(math.pi / rate_scale(arm, k) for k in range(arm.n_links))
    slew = max(quarters)
    duration = math.ceil(2.0 * (TURNS * slew + SETTLED)) / 2.0
    period = _leading(slew / PERIODS) if control_dt is None else control_dt
    return TimeScales(quarters, slew, duration, period, round(max(0.5, 1.0 - period / slew), 4))


def _leading(value: float) -> float:
    """Round a value down to 1, 2 or 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(value))
    return float(f"{max(step for step in STEPS if step * power <= value * (1.0 + 1e-9)) * power:.1g}")
