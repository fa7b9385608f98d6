"""Parameters of an arm: frozen, validated dataclasses in SI units.

An :class:`Arm` is a chain of :class:`Link` objects. Link ``k`` starts at joint ``k`` and ends at joint ``k + 1`` or at
the tip. Joint 0 is the hub (the root of the arm); joint ``k >= 1`` is the elbow between the tip of link ``k-1`` and the
root of link ``k``. Every class is immutable and hashable, and stores sequences as tuples. ``dataclasses.replace``
returns a copy with changed fields. An invalid value raises a ``ValueError`` whose message names the key path, the value
and the rule.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from flexarm_env import bodies
from flexarm_env import validation as check
from flexarm_env.bodies import Axes, Inertia, RigidLink, Vector, axes_of
from flexarm_env.records import choice, described, number, validate, value
from flexarm_env.sections import Link, Points, Section, Taper
from flexarm_env.sensors import Sensors
from flexarm_env.validation import store as _store

__all__ = [
    "Arm", "Base", "Elbow", "Joint", "JointRange", "Link", "Motor", "Payload", "Points", "RigidLink", "Section",
    "Taper",
]  # fmt: skip

JointRange = tuple[float, float]


@described
@dataclass(frozen=True)
class Elbow:
    """Joint between two links: its masses, and its axis in space.

    In space the rotation matrix of the next link's root is R_tip M exp(angle [axis]x). R_tip is the rotation matrix of
    the previous link's tip, M is ``mount``, and [axis]x is the cross-product matrix of ``axis``. For contact with
    obstacles (`Contact`) the joint is a sphere of radius ``radius``, which is fixed to the previous link.
    """

    mass: float = number("mass at the tip of the link before the joint", "kg", 0.0, minimum=0.0)
    inertia_left: Inertia = bodies.inertia_field("inertia at the tip of the link before the joint, in that link's axes")
    inertia_right: Inertia = bodies.inertia_field("inertia at the root of the link after the joint, in its axes")
    axis: Vector = bodies.axis_field("joint axis, a unit vector in the axes of the link after the joint")
    mount: Any = bodies.mount_field("rotation at a joint angle of 0")
    radius: float = number("radius of a sphere at the joint that touches obstacles; 0: a point", "m", 0.0, minimum=0.0)

    def __post_init__(self) -> None:
        """Validate the fields and convert them to plain numbers; an `InvalidValue` names the invalid field."""
        validate(self)

    @property
    def spatial(self) -> bool:
        """True if the elbow turns a link out of the previous link's plane, or has an inertia tensor."""
        tensors = isinstance(self.inertia_left, tuple) or isinstance(self.inertia_right, tuple)
        return self.axis != bodies.Z or self.mount is not None or tensors


def _offset(path: str, value: object) -> tuple[float, ...]:
    """Validate a payload's offset. A third component that is 0 is dropped, so that the payload is planar."""
    what = "two numbers (m), along the tip's tangent and across it"
    count = 3 if isinstance(value, list | tuple) and len(value) == 3 else 2
    offset = check.numbers(path, value, what, count, "m")
    return offset if any(offset[2:]) else offset[:2]


@described
@dataclass(frozen=True)
class Payload:
    """Rigid body that is fixed to the tip of the last link.

    An arm is computed in space if its payload has an inertia tensor or an offset with a third component.
    """

    mass: float = number("mass", "kg", 0.0, minimum=0.0)
    inertia: Inertia = bodies.inertia_field("inertia about the center of mass")
    offset: tuple[float, ...] = value(
        _offset, {"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 3},
        "center of mass relative to the tip: along its tangent and across it, in space along the tip's x, y, z", "m",
        (0.0, 0.0),
    )  # fmt: skip
    radius: float = number("radius of the ball about the tip that touches obstacles", "m", 0.0, minimum=0.0)

    def __post_init__(self) -> None:
        """Validate the fields and convert them to plain numbers; an `InvalidValue` names the field."""
        validate(self, "payload")

    @property
    def spatial(self) -> bool:
        """True if the center of mass lies outside the arm's plane, or the payload has an inertia tensor."""
        return len(self.offset) > 2 or isinstance(self.inertia, tuple)

    @property
    def eccentric(self) -> bool:
        """True if the payload has a mass and its center of mass is not at the tip."""
        return self.mass > 0.0 and any(self.offset)

    @property
    def lever(self) -> complex:
        """Offset of the center of mass from the tip, along and across the tip's tangent, as a complex number, m."""
        return complex(*self.offset[:2])


@described
@dataclass(frozen=True)
class Motor:
    """Electric motor with the current i, A: torque = torque_constant i, voltage = resistance i + back_emf rate.

    Torque (N m) and rate (rad/s) are those of the motor's shaft, on the input side of the gear.
    """

    torque_constant: float = number("torque divided by current", "N m/A", above=0.0)
    resistance: float | None = number(
        "resistance of the winding; None: unknown, without voltage commands", "ohm", None, above=0.0, optional=True
    )
    back_emf: float | None = number(
        "voltage divided by rate; None: the torque constant, which has the same value in SI units", "V s/rad", None,
        minimum=0.0, optional=True,
    )  # fmt: skip
    current_limit: float | None = number("largest current", "A", None, above=0.0, optional=True)
    voltage_limit: float | None = number("largest voltage; requires a resistance", "V", None, above=0.0, optional=True)

    def __post_init__(self) -> None:
        """Validate the fields and convert them to plain numbers; an `InvalidValue` names the field."""
        validate(self, "motor")
        if self.resistance is None and (self.voltage_limit is not None or self.back_emf is not None):
            raise check.MissingKey("motor.resistance", "a voltage does not determine the current without it (ohm)")


FRICTION_SIDES = ("motor", "link")


def _stiffness(path: str, value: object) -> float:
    """Validate a gear's stiffness: a positive number, or infinity for a rigid gear."""
    if isinstance(value, float) and value == math.inf:
        return value
    try:
        return check.number(path, value, "N m/rad", above=0.0)
    except check.InvalidValue as error:
        what = "must be a positive number (N m/rad), or inf for a rigid gear"
        raise check.InvalidValue(path, error.value, what) from None


@described
@dataclass(frozen=True)
class Joint:
    """Drive of a joint: rotor, gear and friction.

    Angles, rates and torques refer to the gear's output side: the motor's angle and rate are divided by the gear ratio,
    and its torque is multiplied by the ratio. Angles of joint and motor are measured relative to the previous link.

    An elastic gear is a spring and a damper between motor and link. An elastic gear adds the motor's angle ("motor0",
    ...) to the arm's coordinates. The joint's angle ("joint0", ...) is the angle of the link's root. Torques from a
    `JointTorque` or an action act on the motor. An elastic gear needs a positive rotor inertia unless a motion
    prescribes the motor's angle.

    The rotor's kinetic energy is 1/2 motor_inertia (gear_ratio rate)^2, where rate is the motor's rate on the output
    side. In space the rotor's angular momentum causes a gyroscopic moment when the rotor's axis turns.
    """

    stiffness: float = value(
        _stiffness, {"type": "number", "exclusiveMinimum": 0.0},
        "stiffness of the gear; inf: a rigid gear", "N m/rad", math.inf,
    )  # fmt: skip
    damping: float = number(
        "damping of the gear, in parallel with the spring; 0 for a rigid gear", "N m s/rad", 0.0, minimum=0.0
    )
    motor_inertia: float = number("inertia of the rotor about its own axis", "kg m^2", 0.0, minimum=0.0)
    gear_ratio: float = number("turns of the rotor per turn of the joint", "", 1.0, above=0.0, maximum=1e9)
    friction_viscous: float = number("viscous friction", "N m s/rad", 0.0, minimum=0.0)
    friction_coulomb: float = number(
        "Coulomb friction torque", "N m", 0.0, minimum=0.0
    )
    backlash: float = number(
        "total backlash of an elastic gear on its output side; the spring acts only beyond half of it to either side, "
        "the damping always", "rad", 0.0, minimum=0.0,
    )  # fmt: skip
    motor: Motor | None = None
    friction_side: str = choice(FRICTION_SIDES, "side of an elastic gear on which the friction acts", "motor")

    def __post_init__(self) -> None:
        """Validate the fields and their combinations: a rigid gear has neither damping nor backlash."""
        validate(self)
        # a rigid gear has neither damping nor backlash
        if self.damping > 0.0 and not self.elastic:
            what = "must be 0 where the stiffness is infinite: a rigid gear has no damping"
            raise check.InvalidValue("damping", self.damping, what)
        if self.backlash > 0.0 and not self.elastic:
            what = "must be 0 where the stiffness is infinite: backlash requires an elastic gear"
            raise check.InvalidValue("backlash", self.backlash, what)
        if self.motor is not None:
            check.instance("motor", self.motor, Motor)

    @property
    def elastic(self) -> bool:
        """True if the gear is elastic, so that the motor's angle is an additional coordinate."""
        return self.stiffness < math.inf

    @property
    def rotor(self) -> float:
        """Rotor inertia on the gear's output side, motor_inertia gear_ratio^2, kg m^2."""
        return self.motor_inertia * self.gear_ratio**2

    @property
    def moves(self) -> bool:
        """True if the equations of motion differ from those of an ideal joint."""
        return self.elastic or self.rotor > 0.0 or self.friction_viscous > 0.0 or self.friction_coulomb > 0.0


@described
@dataclass(frozen=True)
class Base:
    """Rigid body that carries a freely floating arm (`Scene`, root="free"); its center of mass is at the hub.

    The first joint turns link 0 relative to the base, and the reaction torque turns the base.
    """

    mass: float = number("mass", "kg", minimum=0.0)
    inertia: float = number("inertia about the base's center of mass", "kg m^2", above=0.0)

    def __post_init__(self) -> None:
        """Validate the fields and convert them to plain numbers; an `InvalidValue` names the field."""
        validate(self)


@described
@dataclass(frozen=True)
class Arm:
    """Arm: a chain of N links with hub, elbows, joints and payload.

    In space the rotation matrix of link 0's root is M exp(angle [axis]x), with M = `hub_mount` and the cross-product
    matrix [axis]x of `hub_axis`.

    With the damping time `tau_d` of a link the stress is D (strain + tau_d strain rate), where D is the elastic
    stiffness. Due to `tau_d`, mode k with the natural frequency omega_k has the damping ratio zeta_k = tau_d omega_k/2.
    `mass_damping` is a damping force per mass and velocity. The velocity of link, elbow mass and payload is measured
    relative to the link's floating frame (Meek & Liu 1995, eq. [65]). The mass damping adds mass_damping / (2 omega_k)
    to zeta_k and requires one frame per link: the formulation "floating_frame" with segments=1 or with only modes.

    Args:
        name: name of the arm, a short word.
        links: N >= 1 links, from root to tip.
        elbows: N-1 elbows, or () for massless elbows.
        joints: N drives (:class:`Joint`), or () for ideal joints.
        payload: payload at the tip of the last link.
        torque_limits: N positive numbers, N m, or None (no limit).
        joint_limits: N entries, each None or (low, high) in rad; or None (no limits at all). The angle of joint 0 is
            the angle of link 0's root; the angle of joint k is the angle from link k-1's tip to link k's root.
        source: text about the origin of the arm's data.
        sensors: sensors for `observation="measured"` and `Trajectory.measured`, or None for ideal sensors.
        base: rigid body to which the hub of an arm in the plane is mounted, or None. The base floats freely if the root
            of the scene is "free", and is fixed otherwise.
    """

    name: str
    links: tuple[Link, ...]
    hub_inertia: Inertia = bodies.inertia_field("inertia at the root of link 0, in its axes")
    elbows: tuple[Elbow, ...] = ()
    payload: Payload = field(default_factory=Payload)
    tau_d: float = number("Kelvin-Voigt time constant of links that have none of their own", "s", 0.0, minimum=0.0)
    mass_damping: float = number("damping force per mass and velocity in the floating frame", "1/s", 0.0, minimum=0.0)
    torque_limits: tuple[float, ...] | None = None
    joint_limits: tuple[JointRange | None, ...] | None = None
    source: str = ""
    joints: tuple[Joint, ...] = ()
    sensors: Sensors | None = None
    hub_axis: Vector = bodies.axis_field("axis of the root joint")
    hub_mount: Any = bodies.mount_field("rotation of the root joint relative to the ground at an angle of 0")
    base: Base | None = None

    def __post_init__(self) -> None:
        """Validate the fields and the number of elbows, joints and limits; an `InvalidValue` names the field."""
        check.text("name", self.name, empty=False)
        links = check.instances("links", self.links, Link, "at least one Link")
        if not links:
            raise check.InvalidValue("links", links, "must be a sequence of at least one Link")
        n = len(links)
        # one elbow between two links, one joint per link
        elbows = check.instances("elbows", self.elbows, Elbow)
        if elbows and len(elbows) != n - 1:
            raise check.InvalidValue("elbows", elbows, f"must be empty or hold {n - 1} (one less than the links)")
        joints = check.instances("joints", self.joints, Joint)
        if joints and len(joints) != n:
            raise check.InvalidValue("joints", joints, f"must be empty or hold {n} (one for each link)")
        check.instance("payload", self.payload, Payload)
        check.text("source", self.source)
        if self.base is not None:
            check.instance("base", self.base, Base)
        if self.sensors is not None:
            check.instance("sensors", self.sensors, Sensors)
            with check.under("sensors"):
                self.sensors.check_for(links)
        validate(self)
        _store(
            self,
            links=links,
            elbows=elbows,
            joints=joints,
            torque_limits=_torque_limits(self.torque_limits, n),
            joint_limits=_joint_limits(self.joint_limits, n),
        )

    @property
    def spatial(self) -> bool:
        """True if the arm is computed in space: its links turn out of the x-y plane, or a link is rigid."""
        hub = self.hub_axis != bodies.Z or self.hub_mount is not None or isinstance(self.hub_inertia, tuple)
        parts: tuple[Elbow | Payload, ...] = (*self.elbows, self.payload)
        return hub or any(part.spatial for part in parts) or any(link.rigid for link in self.links)

    @property
    def axes(self) -> Axes:
        """Axes along which the arm moves: "xy" in the plane, "xyz" in space."""
        return axes_of(self.spatial)

    def relative(self, values: Sequence[float], joint: int, turn: float = 0.0) -> float:
        """Return a joint's angle (rad) or rate (rad/s) from a scene's `angles` or `rates`.

        `angles` and `rates` of a scene refer to links (absolute angles) in the plane, and to joints in space. values:
        one of the two sequences. turn: for a curved previous link, angle from the tangent at its root to the tangent at
        the joint, rad; 0 for straight links and for rates.
        """
        return self.axes.joint(values, joint, turn)

    def stated(self, joints: Sequence[float]) -> tuple[float, ...]:
        """Convert joint angles to a scene's `angles`, rad: absolute link angles in the plane, joint angles in space."""
        return self.axes.stated(joints)

    def check_planar(self) -> None:
        """Raise ValueError if the arm leaves the plane or has a rigid link."""
        what = "must move in the x-y plane here; SpatialFlexArm-v0, simulate and modes compute arms in space"
        self.axes.check_planar("arm", self.name, what)

    @property
    def n_links(self) -> int:
        """Number of links N."""
        return len(self.links)

    @property
    def total_length(self) -> float:
        """Sum of the links' lengths, including their rigid ends, m."""
        return sum(link.span for link in self.links)

    @property
    def mass(self) -> float:
        """Mass of links, elbows and payload, kg."""
        ends = sum(k.root_mass + k.tip_mass for k in self.links)
        return sum(k.mass for k in self.links) + ends + sum(e.mass for e in self.elbows) + self.payload.mass

    @property
    def damping(self) -> tuple[float, tuple[float, ...] | None]:
        """The links' largest tau_d, s, and each link's tau_d divided by the largest tau_d (None if all are equal)."""
        own = [self.tau_d if link.tau_d is None else link.tau_d for link in self.links]
        largest = max(own)
        return largest, None if min(own) == largest else tuple(tau / largest for tau in own)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the N joints: "hub", then "elbow" (for a single elbow) or "elbow_1", "elbow_2" and so on."""
        count = self.n_links - 1
        return ("hub", *(("elbow",) if count == 1 else tuple(f"elbow_{k + 1}" for k in range(count))))

    def by_link(self, name: str) -> tuple[str, ...]:
        """Return one name per link: `name` for a single link, otherwise `name` with _1, _2, ... appended."""
        return (name,) if self.n_links == 1 else tuple(f"{name}_{k + 1}" for k in range(self.n_links))

    @property
    def jointed(self) -> bool:
        """True if at least one joint is not ideal."""
        return any(joint.moves for joint in self.joints)

    @property
    def taut(self) -> Arm:
        """The arm without backlash, for linear models: a gear within its backlash has no stiffness."""
        return replace(self, joints=tuple(replace(joint, backlash=0.0) for joint in self.joints))

    def joint(self, k: int) -> Joint:
        """Return the drive of joint k, or an ideal joint if the arm defines no drives."""
        return self.joints[k] if self.joints else Joint()

    def elbow(self, joint: int) -> Elbow:
        """Return the elbow at a joint from 1 to N-1, or a massless elbow if the arm defines no elbows."""
        if not 1 <= joint < self.n_links:
            raise check.InvalidValue("joint", joint, f"must be from 1 to {self.n_links - 1} for this arm")
        return self.elbows[joint - 1] if self.elbows else Elbow()


def _torque_limits(value: object, n: int) -> tuple[float, ...] | None:
    """Validate N positive torque limits, N m, or None."""
    if value is None:
        return None
    return check.numbers("torque_limits", value, f"{n} positive numbers (N m), one per joint", n, "N m", above=0.0)


def _joint_limits(value: object, n: int) -> tuple[JointRange | None, ...] | None:
    """Validate N joint ranges (low, high), rad; None for an entry, or for the whole value, means no limit."""
    if value is None:
        return None
    ranges: list[JointRange | None] = []
    for i, entry in enumerate(check.sequence("joint_limits", value, f"{n} entries, one per joint", n)):
        # TOML has no null: an empty list means no limit
        if entry is None or (isinstance(entry, list | tuple) and not entry):
            ranges.append(None)
            continue
        low, high = check.numbers(f"joint_limits[{i}]", entry, "two numbers, (low, high) in rad", 2, "rad")
        if not low < high:
            raise check.InvalidValue(f"joint_limits[{i}]", (low, high), "must be (low, high) with low < high (rad)")
        ranges.append((low, high))
    return tuple(ranges)
