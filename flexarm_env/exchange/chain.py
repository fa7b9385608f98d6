"""Approximate an arm by a serial chain of rigid bodies that hinges connect.

Some hinges are the arm's joints. All other hinges carry springs, which represent the bending and torsion of flexible
links: a flexible link becomes several rigid bodies with springs between them. The spring at the arc length s_i has the
compliance of a cell of the link, 1 / k_i = integral of ds / EI over the cell. If the s_i are Gauss points and the
lengths of the cells are the weights w_i, the stiffness is k_i = EI(s_i) / w_i. With this stiffness, two springs in each
interval of smooth EI give the exact compliance of the tip under tip loads. The chain neglects stretch and shear of the
links.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from flexarm_env import bodies, curves, rotations
from flexarm_env import validation as check
from flexarm_env.parameters import Arm, Joint, Link
from flexarm_env.sections import GAUSS
from flexarm_env.validation import Array

PLACEMENTS = ("gauss", "middle", "between")
LEAST = 1e-12
"""Smallest principal moment of inertia, kg m^2, and smallest mass, kg, of a body in a file. MuJoCo requires more than
1e-15."""
_Z = np.array(bodies.Z)


@dataclass(frozen=True)
class Hinge:
    """Hinge that connects a body to the preceding body; `axis` (3,) is its direction in the body's axes.

    stiffness: spring stiffness, N m/rad. damping: damping coefficient, N m s/rad. armature: rotor inertia about the
    hinge's axis, kg m^2. friction: friction torque, N m. joint: index of the arm's joint that the hinge represents, or
    -1 for a spring of a flexible link. limits: lower and upper angle, rad, or None. driven: True if the joint's torque
    acts on the hinge. place: arc length of a spring from the root of its link, m.
    """

    name: str
    axis: Array
    stiffness: float = 0.0
    damping: float = 0.0
    armature: float = 0.0
    friction: float = 0.0
    joint: int = -1
    limits: tuple[float, float] | None = None
    driven: bool = False
    place: float = 0.0


@dataclass(frozen=True)
class Body:
    """Rigid body of the chain; the origin of its frame is on its hinges.

    position (3,), rotation (3, 3): origin, m, and axes of the body's frame in the preceding body's frame, with all
    hinge angles 0. mass: mass, kg. centre (3,): center of mass, m, in the body's frame. inertia (3, 3): inertia tensor
    about the center of mass, kg m^2. end (3,): position of the next body's frame or of the tip, m. link: index of the
    arm's link.
    """

    name: str
    position: Array
    rotation: Array
    hinges: tuple[Hinge, ...]
    mass: float
    centre: Array
    inertia: Array
    end: Array
    link: int


@dataclass(frozen=True)
class Chain:
    """Chain of bodies from root to tip.

    tip (3,), tip_rotation (3, 3): position, m, and axes of the arm's tip in the frame of the last body.
    """

    arm: Arm
    bodies: tuple[Body, ...]
    tip: Array
    tip_rotation: Array
    left_out: tuple[str, ...] = field(default=())

    @property
    def hinges(self) -> tuple[Hinge, ...]:
        """All hinges of the chain, from root to tip."""
        return tuple(hinge for body in self.bodies for hinge in body.hinges)

    def stiffened(self, factor: float) -> Chain:
        """Return the chain with its bending springs and dampers multiplied by a factor."""

        def hinge(own: Hinge) -> Hinge:
            if own.joint >= 0:
                return own
            return replace(own, stiffness=own.stiffness * factor, damping=own.damping * factor)

        made = tuple(replace(body, hinges=tuple(map(hinge, body.hinges))) for body in self.bodies)
        return replace(self, bodies=made)


class _Mass:
    """Sum of rigid parts in one frame: mass, first moment, and inertia about the frame's origin."""

    def __init__(self) -> None:
        self.mass, self.moment, self.about = 0.0, np.zeros(3), np.zeros((3, 3))

    def add(self, mass: float, at: Array, inertia: Array) -> None:
        """Add a rigid part with its center of mass `at` (3,) and its inertia (3, 3) about this center, in the frame's
        axes.
        """
        self.mass += mass
        self.moment += mass * at
        self.about += bodies.about(inertia, mass, at)

    def body(self) -> tuple[float, Array, Array]:
        """Return mass, center of mass, and inertia about the center of mass."""
        centre = self.moment / self.mass if self.mass > 0.0 else np.zeros(3)
        own = self.about - bodies.about(np.zeros((3, 3)), self.mass, centre)
        return self.mass, centre, 0.5 * (own + own.T)


def chain_of(arm: Arm, segments: int = 4, placement: str = "gauss") -> Chain:
    """Build the chain of rigid bodies that approximates an arm.

    Args:
        arm: the arm. segments: number of springs in each flexible link (for placement "between", the number of rigid
            bodies); 0 makes all links rigid.
        placement: positions of the springs. "gauss": at the Gauss points of each interval with smooth EI. "middle": in
            the middle of cells of equal length. "between": between rigid bodies of equal length l, with the stiffness
            EI / l; the first body is fixed to the joint. "between" is common in hand-written models, but the least
            accurate of the three placements.
    Raises:
        ValueError: a value is out of range, or the arm has backlash or mass_damping, which hinges cannot represent.
    """
    segments = check.integer("segments", segments, minimum=0, maximum=200)
    check.choice("placement", placement, PLACEMENTS)
    if arm.mass_damping > 0.0:
        what = "must be 0: joints of rigid bodies have no drag relative to a link's floating frame"
        raise check.InvalidValue("mass_damping", arm.mass_damping, what)
    made, left_out = [], []
    before, R, end = _Mass(), np.eye(3), np.zeros(3)
    for k, link in enumerate(arm.links):
        joint = arm.joint(k)
        if joint.backlash > 0.0:
            what = "must be 0: a chain of hinges has no play"
            raise check.InvalidValue(f"joints[{k}].backlash", joint.backlash, what)
        if arm.spatial and joint.rotor > 0.0 and joint.gear_ratio < 1e3:
            left_out.append(f"gyroscopic moment of the rotor of joint {k}")
        mount = arm.hub_mount if k == 0 else arm.elbow(k).mount
        rotation = R if mount is None else R @ np.array(mount)
        axis = np.array(arm.hub_axis if k == 0 else arm.elbow(k).axis)
        drives = _drive(arm, k, joint, axis)
        # the motor's side of an elastic gear is a body of its own, without mass but for the rotor
        if len(drives) > 1:
            motor = Body(f"motor{k}", end, rotation, drives[:1], 0.0, np.zeros(3), np.zeros((3, 3)), np.zeros(3), k)
            made.append(motor)
            rotation, end = np.eye(3), np.zeros(3)
        root = arm.hub_inertia if k == 0 else arm.elbow(k).inertia_right
        pieces = _pieces(arm, k, link, segments, placement)
        for i, (place, turn, hinges, mass, tip) in enumerate(pieces):
            if i == 0:
                mass.add(0.0, np.zeros(3), bodies.tensor(root))
                hinges, name = drives[-1:], f"link{k}"
            else:
                rotation, end, name = rotations.matrices(turn * _Z), place, f"link{k}_{i}"
            made.append(Body(name, end, rotation, hinges, 0.0, np.zeros(3), np.zeros((3, 3)), tip, k))
            before = mass
            if i < len(pieces) - 1:
                made[-1] = _with_mass(made[-1], before)
        # mass on the link's tip, axes of the last piece: the elbow's mass and left inertia, or the payload
        R, end = rotations.matrices((link.turn - sum(piece[1] for piece in pieces)) * _Z), pieces[-1][4]
        if k < arm.n_links - 1:
            elbow = arm.elbow(k + 1)
            before.add(elbow.mass, end, R @ bodies.tensor(elbow.inertia_left) @ R.T)
        else:
            offset = np.array((*arm.payload.offset, 0.0)[:3])
            before.add(arm.payload.mass, end + R @ offset, R @ bodies.tensor(arm.payload.inertia) @ R.T)
        made[-1] = _with_mass(made[-1], before)
    if any(not link.rigid for link in arm.links):
        left_out.append("stretch and shear" if segments else "bending, torsion, stretch and shear")
    return Chain(arm, tuple(made), end, R, tuple(left_out))


def _with_mass(body: Body, total: _Mass) -> Body:
    mass, centre, inertia = total.body()
    return replace(body, mass=mass, centre=centre, inertia=inertia)


def _drive(arm: Arm, k: int, joint: Joint, axis: Array) -> tuple[Hinge, ...]:
    """Return the hinge of joint k, or, for an elastic gear, the hinges of its motor and of its spring."""
    limits = None if arm.joint_limits is None else arm.joint_limits[k]
    own = {"friction": joint.friction_coulomb, "damping": joint.friction_viscous}
    if not joint.elastic:
        return (Hinge(f"joint{k}", axis, armature=joint.rotor, joint=k, limits=limits, driven=True, **own),)
    on_motor = joint.friction_side == "motor"
    motor, gear = (own, {}) if on_motor else ({}, own)
    # friction on the link's side brakes the link's angle, which is the sum of both hinges: not one hinge's friction
    if gear and any(gear.values()):
        what = 'must be "motor" for an elastic gear: no single hinge has the link\'s angle'
        raise check.InvalidValue(f"joints[{k}].friction_side", joint.friction_side, what)
    return (
        Hinge(f"joint{k}", axis, armature=joint.rotor, joint=k, limits=limits, driven=True, **motor),
        Hinge(f"gear{k}", axis, joint.stiffness, joint.damping, joint=k),
    )


def spring_places(link: Link, segments: int, placement: str) -> list[tuple[float, float, float]]:
    """Return a link's springs from root to tip: each spring's place s_i, and the start and end of its cell, m."""
    if placement == "middle":
        ends = np.linspace(0.0, link.length, segments + 1)
        return [(0.5 * (a + b), a, b) for a, b in pairwise(ends.tolist())]
    if placement == "between":
        length = link.length / segments
        return [(k * length, (k - 0.5) * length, (k + 0.5) * length) for k in range(1, segments)]
    smooth = list(pairwise(link.breaks))
    # one spring a smooth piece at least, the rest by the length of the pieces
    counts = [1] * len(smooth)
    while sum(counts) < segments:
        counts[max(range(len(smooth)), key=lambda i: (smooth[i][1] - smooth[i][0]) / counts[i])] += 1
    found = []
    for (a, b), count in zip(smooth, counts, strict=True):
        x, weights = np.polynomial.legendre.leggauss(count)
        ends = a + 0.5 * (b - a) * np.concatenate([[0.0], np.cumsum(weights)])
        middles = a + 0.5 * (b - a) * (1.0 + x)
        found += [(s, p, q) for s, p, q in zip(middles.tolist(), ends[:-1].tolist(), ends[1:].tolist(), strict=True)]
    return found


def _pieces(
    arm: Arm, k: int, link: Link, segments: int, placement: str
) -> list[tuple[Array, float, tuple[Hinge, ...], _Mass, Array]]:
    """Return a link's rigid pieces: position and rotation in the preceding frame, hinges, masses, far end."""
    if isinstance(link, bodies.RigidLink):
        mass = _Mass()
        mass.add(link.mass, np.array(link.centre), bodies.tensor(link.inertia))
        return [(np.zeros(3), 0.0, (), mass, np.array([link.length, 0.0, 0.0]))]
    cells = spring_places(link, segments, placement) if segments else []
    places = [-link.root_offset, *(s for s, _, _ in cells), link.length + link.tip_offset]
    found = []
    for i, (a, b) in enumerate(pairwise(places)):
        # frame of the piece: at its root end, along the stress-free tangent there
        origin, angle = _spot(link, a), _tangent(link, a)
        before = places[i - 1] if i else a
        turn = angle - _tangent(link, before)
        place = (origin - _spot(link, before)) * np.exp(-1j * _tangent(link, before))
        hinges = () if i == 0 else _springs(arm, k, link, i, cells[i - 1], placement)
        far = (_spot(link, b) - origin) * np.exp(-1j * angle)
        found.append((_vector(place), turn, hinges, _piece_mass(arm, link, a, b), _vector(far)))
    return found


def _spot(link: Link, s: float) -> complex:
    return complex(link.place(s))


def _tangent(link: Link, s: float) -> float:
    """Return the angle, rad, of the stress-free link's tangent at s m from the beam's root."""
    return float(curves.angle(link.curvature, min(max(s, 0.0), link.length))) if link.curved else 0.0


def _vector(z: complex) -> Array:
    return np.array([z.real, z.imag, 0.0])


def _springs(
    arm: Arm, k: int, link: Link, i: int, cell: tuple[float, float, float], placement: str
) -> tuple[Hinge, ...]:
    """Return the hinges at spring i: bending in the plane, and in space also torsion and bending out of this plane."""
    s, a, b = cell
    tau = arm.tau_d if link.tau_d is None else link.tau_d
    if placement == "gauss":
        at, weights = np.array([s]), np.array([b - a])
    else:
        # compliance of the cell, exact for sections that vary
        inner = [p for p in link.points if a < p < b]
        at, weights = _quadrature([a, *inner, b])
    found = []
    for axis in arm.axes.hinges:
        values = link.along(at).EI if axis == "z" else link.across(at)[{"x": "GJ", "y": "EI_y"}[axis]]
        own = 1.0 / float(weights @ (1.0 / values))
        name = f"bend{k}_{i}{'' if axis == 'z' else axis}"
        found.append(Hinge(name, np.eye(3)["xyz".index(axis)], own, tau * own, place=s))
    return tuple(found)


def _quadrature(ends: list[float]) -> tuple[Array, Array]:
    x, weights = GAUSS
    edges = np.array(ends)
    half = 0.5 * np.diff(edges)[:, None]
    return (edges[:-1, None] + half * (1.0 + x)).ravel(), (half * weights).ravel()


def _piece_mass(arm: Arm, link: Link, a: float, b: float) -> _Mass:
    """Return the masses of a link between a and b (m from the beam's root) in the section's axes at a."""
    total, origin, angle = _Mass(), _spot(link, a), _tangent(link, a)

    def there(s: float) -> Array:
        return _vector((_spot(link, s) - origin) * complex(math.cos(angle), -math.sin(angle)))

    low, high = max(a, 0.0), min(b, link.length)
    if high > low:
        at, weights = _quadrature([low, *(p for p in link.points if low < p < high), high])
        sections = link.along(at)
        J_y = arm.axes.inertia_across(link, at)
        for s, w, m, J, Jy in zip(at, weights, sections.m, sections.J, J_y, strict=True):
            turn = rotations.matrices((_tangent(link, s) - angle) * _Z)
            total.add(w * m, there(s), turn @ np.diag([w * (J + Jy), w * Jy, w * J]) @ turn.T)
    # masses on the rigid ends, at the root of the first piece and the tip of the last
    if a <= 0.0:
        total.add(link.root_mass, there(-0.5 * link.root_offset), link.root_inertia * np.eye(3))
    if b >= link.length:
        total.add(link.tip_mass, there(link.length + 0.5 * link.tip_offset), link.tip_inertia * np.eye(3))
    return total
