"""Parameters of an arm: frozen, validated dataclasses in SI units.

An :class:`Arm` is a chain of :class:`Link` objects. Link ``k`` starts at joint ``k``. Joint 0 is the hub (the root of
the arm); joint ``k >= 1`` is the elbow between the tip of link ``k-1`` and the root of link ``k``. Every class is
immutable and hashable, and stores sequences as tuples. ``dataclasses.replace`` makes a variant and validates it. An
invalid value raises a ``ValueError`` that names the key path, the value and the rule.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

from flexarm_env import bodies
from flexarm_env import validation as check
from flexarm_env.bodies import Inertia, RigidLink, Vector
from flexarm_env.sections import Link, Points, Section, Taper
from flexarm_env.sensors import Sensors
from flexarm_env.validation import store as _store

__all__ = [
    "Arm", "Base", "Elbow", "Joint", "JointRange", "Link", "Motor", "Payload", "Points", "RigidLink", "Section",
    "Taper",
]  # fmt: skip

JointRange = tuple[float, float]


@dataclass(frozen=True)
class Elbow:
    """Masses and axis of the joint between two links.

    ``mass`` (kg) and ``inertia_left`` (kg m^2) belong to the tip of the link before the joint, ``inertia_right`` (kg
    m^2) to the root of the link after the joint. All three values are zero or positive. Inertias may be tensors (three
    rows) in the axes of their link; a number holds for any axis.

    In space the root axes of the link after the joint are R_tip mount exp(angle axis), with the axes R_tip of the tip
    before the joint. ``axis`` is a unit vector in the axes of the link after the joint. ``mount`` is a rotation matrix,
    (axis, angle in rad) or None.
    """

    mass: float = 0.0
    inertia_left: Inertia = 0.0
    inertia_right: Inertia = 0.0
    axis: Vector = bodies.Z
    mount: Any = None

    def __post_init__(self) -> None:
        """Validate the fields and convert them to plain numbers; an `InvalidValue` names the field."""
        _store(
            self,
            mass=check.number("mass", self.mass, "kg", minimum=0.0),
            inertia_left=bodies.inertia("inertia_left", self.inertia_left),
            inertia_right=bodies.inertia("inertia_right", self.inertia_right),
            axis=bodies.unit_vector("axis", self.axis),
            mount=bodies.mount("mount", self.mount),
        )

    @property
    def spatial(self) -> bool:
        """Whether the elbow turns a link out of the plane of the previous link, or has inertia tensors."""
        tensors = isinstance(self.inertia_left, tuple) or isinstance(self.inertia_right, tuple)
        return self.axis != bodies.Z or self.mount is not None or tensors


@dataclass(frozen=True)
class Payload:
    """A rigid body fixed to the tip of the last link.

    ``mass`` (kg) and ``inertia`` (kg m^2, about the center of mass) are zero or positive. ``offset`` is the center's
    position relative to the tip, m (along the tip's tangent, across it to the left). In space the inertia may be a
    tensor (three rows, in the tip's axes; a number holds for any axis), and the offset may have a third component.
    ``radius`` (m) is the radius of the sphere about the tip that touches obstacles (`Contact`); 0 stands for a point.
    """

    mass: float = 0.0
    inertia: Inertia = 0.0
    offset: tuple[float, ...] = (0.0, 0.0)
    radius: float = 0.0

    def __post_init__(self) -> None:
        """Validate the fields and convert them to plain numbers; an `InvalidValue` names the field."""
        _store(
            self,
            mass=check.number("payload.mass", self.mass, "kg", minimum=0.0),
            inertia=bodies.inertia("payload.inertia", self.inertia),
            radius=check.number("payload.radius", self.radius, "m", minimum=0.0),
        )
        # a third component that is 0 is dropped: the payload is then planar
        what = "two numbers (m), along the tip's tangent and across it"
        count = 3 if isinstance(self.offset, list | tuple) and len(self.offset) == 3 else 2
        offset = check.numbers("payload.offset", self.offset, what, count, "m")
        _store(self, offset=offset if any(offset[2:]) else offset[:2])

    @property
    def spatial(self) -> bool:
        """Whether the payload is out of the arm's plane, or has an inertia tensor."""
        return len(self.offset) > 2 or isinstance(self.inertia, tuple)

    @property
    def eccentric(self) -> bool:
        """Whether the payload has a mass whose center is not at the tip."""
        return self.mass > 0.0 and any(self.offset)

    @property
    def lever(self) -> complex:
        """Offset along and across the tip's tangent as a complex number, m."""
        return complex(*self.offset[:2])


@dataclass(frozen=True)
class Motor:
    """An electric motor: torque = torque_constant i, voltage = resistance i + back_emf rate, with i the current in A.

    Torque (N m) and rate (rad/s) are those of the shaft before the gear.

    Args:
        torque_constant: N m/A, positive.
        resistance: resistance of the winding, ohm, positive; None: unknown, and voltage commands are not available.
        back_emf: V s/rad, zero or positive; None: equal to the torque constant, as in SI units.
        current_limit: A, positive, or None. voltage_limit: V, positive, or None; requires a resistance.
    """

    torque_constant: float
    resistance: float | None = None
    back_emf: float | None = None
    current_limit: float | None = None
    voltage_limit: float | None = None

    def __post_init__(self) -> None:
        """Validate the fields and convert them to plain numbers; an `InvalidValue` names the field."""
        # the limits and the resistance may be None
        positive = {"resistance": "ohm", "current_limit": "A", "voltage_limit": "V"}
        for name, unit in positive.items():
            value = getattr(self, name)
            _store(self, **{name: None if value is None else check.number(f"motor.{name}", value, unit, above=0.0)})
        # back_emf None stands for the torque constant
        constant = check.number("motor.torque_constant", self.torque_constant, "N m/A", above=0.0)
        emf = self.back_emf
        _store(self, torque_constant=constant)
        _store(self, back_emf=None if emf is None else check.number("motor.back_emf", emf, "V s/rad", minimum=0.0))
        if self.resistance is None and (self.voltage_limit is not None or emf is not None):
            raise check.MissingKey("motor.resistance", "a voltage says nothing about the current without it (ohm)")


FRICTION_SIDES = ("motor", "link")


@dataclass(frozen=True)
class Joint:
    """Drive of a joint: rotor, gear and friction. Angles, rates and torques are on the gear's output side.

    The torque of the joint (`JointTorque`, an action) acts on the motor's side. An elastic gear adds a coordinate to
    the arm: the motor's angle divided by the gear ratio, measured relative to the previous link like the joint's angle.
    The motor's coordinate is "motor0", in addition to "joint0", the angle of the link's root. Spring and damper act
    between both.

    Args:
        stiffness: stiffness of the gear, N m/rad, positive; inf: rigid, without the motor's coordinate.
        damping: damping of the gear, N m s/rad, in parallel with the spring; 0 for infinite stiffness.
        motor_inertia: inertia of the rotor about its own axis, kg m^2. The rotor's energy is 1/2 motor_inertia
            (gear_ratio rate)^2, with the rate of the motor's angle relative to the previous link. An elastic gear needs
            a positive inertia unless a motion prescribes the motor's angle. In space the rotor's angular momentum
            causes a gyroscopic moment when the rotor's axis turns.
        gear_ratio: turns of the rotor per turn of the joint, positive, at most 1e9.
        friction_viscous: N m s/rad. friction_coulomb: N m: the torque that holds the joint at rest and brakes it in
            motion.
        friction_side: "motor" or "link": the side of an elastic gear on which the friction acts.
        backlash: total play of an elastic gear at its output, rad. The spring engages after half of the play to either
            side. The damping also acts in the gap.
        motor: source of the torque; None: the torque is applied directly.
    """

    stiffness: float = math.inf
    damping: float = 0.0
    motor_inertia: float = 0.0
    gear_ratio: float = 1.0
    friction_viscous: float = 0.0
    friction_coulomb: float = 0.0
    backlash: float = 0.0
    motor: Motor | None = None
    friction_side: str = "motor"

    def __post_init__(self) -> None:
        """Validate the fields and their combinations: a rigid gear has neither damping nor backlash."""
        # infinite stiffness is no number of the unit, but permitted
        if not (isinstance(self.stiffness, float) and self.stiffness == math.inf):
            try:
                stiffness = check.number("stiffness", self.stiffness, "N m/rad", above=0.0)
            except check.InvalidValue as error:
                what = "must be a positive number (N m/rad), or inf for a gear that does not give"
                raise check.InvalidValue("stiffness", error.value, what) from None
            _store(self, stiffness=stiffness)
        _store(
            self,
            damping=check.number("damping", self.damping, "N m s/rad", minimum=0.0),
            motor_inertia=check.number("motor_inertia", self.motor_inertia, "kg m^2", minimum=0.0),
            gear_ratio=check.number("gear_ratio", self.gear_ratio, above=0.0, maximum=1e9),
            friction_viscous=check.number("friction_viscous", self.friction_viscous, "N m s/rad", minimum=0.0),
            friction_coulomb=check.number("friction_coulomb", self.friction_coulomb, "N m", minimum=0.0),
            backlash=check.number("backlash", self.backlash, "rad", minimum=0.0),
        )
        check.choice("friction_side", self.friction_side, FRICTION_SIDES)
        # a rigid gear has neither damping nor backlash
        if self.damping > 0.0 and not self.elastic:
            what = "must be 0 where the stiffness is infinite: the gear's two sides turn as one"
            raise check.InvalidValue("damping", self.damping, what)
        if self.backlash > 0.0 and not self.elastic:
            what = "must be 0 where the stiffness is infinite: flanks that do not give would meet in blows"
            raise check.InvalidValue("backlash", self.backlash, what)
        if self.motor is not None:
            check.instance("motor", self.motor, Motor)

    @property
    def elastic(self) -> bool:
        """Whether the gear is elastic, so that the motor has a coordinate of its own."""
        return self.stiffness < math.inf

    @property
    def rotor(self) -> float:
        """Rotor inertia at the gear's output, motor_inertia gear_ratio^2, kg m^2."""
        return self.motor_inertia * self.gear_ratio**2

    @property
    def moves(self) -> bool:
        """Whether the joint differs from an ideal one in the equations of motion."""
        return self.elastic or self.rotor > 0.0 or self.friction_viscous > 0.0 or self.friction_coulomb > 0.0


@dataclass(frozen=True)
class Base:
    """Rigid body that carries a freely floating arm (`Scene`, root="free"); its center of mass is at the hub.

    The first joint turns link 0 relative to the base, and the reaction torque turns the base.

    Args:
        mass: kg, zero or positive. inertia: about the base's center of mass, kg m^2, positive.
    """

    mass: float
    inertia: float

    def __post_init__(self) -> None:
        """Validate the fields and convert them to plain numbers; an `InvalidValue` names the field."""
        _store(
            self,
            mass=check.number("mass", self.mass, "kg", minimum=0.0),
            inertia=check.number("inertia", self.inertia, "kg m^2", above=0.0),
        )


@dataclass(frozen=True)
class Arm:
    """A chain of N links with hub, elbows, joints and payload.

    Args:
        name: a short word.
        links: N >= 1 links, root to tip.
        hub_inertia: inertia at the root of link 0, kg m^2; in space also a tensor, in the axes of link 0.
        hub_axis, hub_mount: axis and mount of the root joint relative to the ground (see `Elbow.axis` and
            `Elbow.mount`): the axes of link 0's root are hub_mount exp(angle hub_axis).
        elbows: N-1 elbows, or () for massless elbows.
        joints: N drives (:class:`Joint`), or () for ideal joints.
        payload: payload at the tip of the last link.
        tau_d: Kelvin-Voigt time constant, s, of the links that do not define their own: stress = D (strain + tau_d
            strain rate), so that zeta_k = tau_d omega_k / 2.
        mass_damping: 1/s, drag on the motion of a link, its elbow's mass and the payload relative to the link's
            floating frame, eq. [65]; it adds mass_damping / (2 omega_k) to zeta_k. The drag requires one frame per link
            (formulation "floating_frame" with segments=1 or only modes); other formulations raise an error.
        torque_limits: N positive numbers, N m, or None (no limit).
        joint_limits: N entries, each None or (low, high) in rad (joint 0: the root angle; joint k: the angle of
            link k's root from link k-1's tip), or None (no limits at all).
        source: origin of the numbers.
        sensors: sensors of `observation="measured"` and `Trajectory.measured`; None: ideal sensors.
        base: body that carries the arm in the plane if its root is free; None: no body. If the root is held, the base
            is held, too.
    """

    name: str
    links: tuple[Link, ...]
    hub_inertia: Inertia = 0.0
    elbows: tuple[Elbow, ...] = ()
    payload: Payload = field(default_factory=Payload)
    tau_d: float = 0.0
    mass_damping: float = 0.0
    torque_limits: tuple[float, ...] | None = None
    joint_limits: tuple[JointRange | None, ...] | None = None
    source: str = ""
    joints: tuple[Joint, ...] = ()
    sensors: Sensors | None = None
    hub_axis: Vector = bodies.Z
    hub_mount: Any = None
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
        # one drive per joint
        joints = check.instances("joints", self.joints, Joint)
        if joints and len(joints) != n:
            raise check.InvalidValue("joints", joints, f"must be empty or hold {n} (one for each link)")
        check.instance("payload", self.payload, Payload)
        check.text("source", self.source)
        if self.base is not None:
            check.instance("base", self.base, Base)
        # sensors must fit the links
        if self.sensors is not None:
            check.instance("sensors", self.sensors, Sensors)
            with check.under("sensors"):
                self.sensors.check_for(links)
        _store(
            self,
            links=links,
            elbows=elbows,
            joints=joints,
            hub_inertia=bodies.inertia("hub_inertia", self.hub_inertia),
            hub_axis=bodies.unit_vector("hub_axis", self.hub_axis),
            hub_mount=bodies.mount("hub_mount", self.hub_mount),
            tau_d=check.number("tau_d", self.tau_d, "s", minimum=0.0),
            mass_damping=check.number("mass_damping", self.mass_damping, "1/s", minimum=0.0),
            torque_limits=_torque_limits(self.torque_limits, n),
            joint_limits=_joint_limits(self.joint_limits, n),
        )

    @property
    def spatial(self) -> bool:
        """Whether the arm is computed in space: its links turn out of the x-y plane, or a link is rigid."""
        # the root joint's axis, mount or tensor
        hub = self.hub_axis != bodies.Z or self.hub_mount is not None or isinstance(self.hub_inertia, tuple)
        parts: tuple[Elbow | Payload, ...] = (*self.elbows, self.payload)
        return hub or any(part.spatial for part in parts) or any(link.rigid for link in self.links)

    def check_planar(self) -> None:
        """Raise ValueError if the arm leaves the plane or has a rigid link."""
        if self.spatial:
            what = "must move in the x-y plane here; SpatialFlexArm-v0, simulate and modes compute arms in space"
            raise check.InvalidValue("arm", self.name, what)

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
        # masses on the links' rigid ends
        ends = sum(k.root_mass + k.tip_mass for k in self.links)
        return sum(k.mass for k in self.links) + ends + sum(e.mass for e in self.elbows) + self.payload.mass

    @property
    def damping(self) -> tuple[float, tuple[float, ...] | None]:
        """Largest tau_d of the links, s, and each link's ratio to it; if all are equal, None instead of the ratios."""
        # a link's own tau_d takes precedence over the arm's
        own = [self.tau_d if link.tau_d is None else link.tau_d for link in self.links]
        largest = max(own)
        return largest, None if min(own) == largest else tuple(tau / largest for tau in own)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the N joints: "hub", then "elbow", or "elbow_1", "elbow_2", ... if there are several elbows."""
        # a single elbow has no number
        count = self.n_links - 1
        return ("hub", *(("elbow",) if count == 1 else tuple(f"elbow_{k + 1}" for k in range(count))))

    def by_link(self, name: str) -> tuple[str, ...]:
        """Return one name per link: `name` for a single link, otherwise `name` with _1, _2, ... appended."""
        return (name,) if self.n_links == 1 else tuple(f"{name}_{k + 1}" for k in range(self.n_links))

    @property
    def jointed(self) -> bool:
        """Whether a joint is not ideal."""
        return any(joint.moves for joint in self.joints)

    @property
    def taut(self) -> Arm:
        """The arm without backlash, for linear models: there is no spring to linearize within the gap."""
        return replace(self, joints=tuple(replace(joint, backlash=0.0) for joint in self.joints))

    def joint(self, k: int) -> Joint:
        """Return the drive of joint k; an ideal joint if none is given."""
        return self.joints[k] if self.joints else Joint()

    def elbow(self, joint: int) -> Elbow:
        """Return the elbow at joint 1 ... N-1; a massless elbow if none is given."""
        if not 1 <= joint < self.n_links:
            raise check.InvalidValue("joint", joint, f"must be from 1 to {self.n_links - 1} for this arm")
        return self.elbows[joint - 1] if self.elbows else Elbow()


def _torque_limits(value: object, n: int) -> tuple[float, ...] | None:
    """Validate N positive torque limits, N m, or None."""
    if value is None:
        return None
    return check.numbers("torque_limits", value, f"{n} positive numbers (N m), one a joint", n, "N m", above=0.0)


def _joint_limits(value: object, n: int) -> tuple[JointRange | None, ...] | None:
    """Validate N joint ranges (low, high), rad; None, or None as an entry, stands for no limit."""
    if value is None:
        return None
    ranges: list[JointRange | None] = []
    for i, entry in enumerate(check.sequence("joint_limits", value, f"{n} entries, one a joint", n)):
        # TOML has no null: an empty list means no limit
        if entry is None or (isinstance(entry, list | tuple) and not entry):
            ranges.append(None)
            continue
        low, high = check.numbers(f"joint_limits[{i}]", entry, "two numbers, (low, high) in rad", 2, "rad")
        if not low < high:
            raise check.InvalidValue(f"joint_limits[{i}]", (low, high), "must be (low, high) with low < high (rad)")
        ranges.append((low, high))
    return tuple(ranges)
