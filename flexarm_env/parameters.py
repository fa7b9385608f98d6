"""What an arm is made of: frozen, validated, in SI units.

An :class:`Arm` is a chain of :class:`Link` objects. Link ``k`` starts at joint ``k``: joint 0 is the hub
(the root of the arm), joint ``k >= 1`` the elbow between the tip of link ``k-1`` and the root of link ``k``.
Every class is immutable and hashable; sequences are kept as tuples; ``dataclasses.replace`` makes a variant
and checks it again. A value that is not allowed raises a ``ValueError`` which names the key path, the value
and what is allowed.
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
    """What sits at the joint between two links, and how it turns.

    ``mass`` (kg) and ``inertia_left`` (kg m^2) belong to the tip of the link before it, ``inertia_right``
    (kg m^2) to the root of the link after it. All zero or positive; inertias may be tensors (three rows), in the axes
    of the link that they belong to, and a number is that about any axis.

    In space the root of the link after it has the axes R_tip mount exp(angle axis), R_tip being those of the tip before
    it: ``axis``, a unit vector in the link's own axes, and ``mount``, a rotation: a matrix, or (axis, angle), or None.
    """

    mass: float = 0.0
    inertia_left: Inertia = 0.0
    inertia_right: Inertia = 0.0
    axis: Vector = bodies.Z
    mount: Any = None

    def __post_init__(self) -> None:
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
        """Whether it takes a link out of the plane of the one before it, or has tensors."""
        tensors = isinstance(self.inertia_left, tuple) or isinstance(self.inertia_right, tuple)
        return self.axis != bodies.Z or self.mount is not None or tensors


@dataclass(frozen=True)
class Payload:
    """A body fixed to the tip of the last link.

    ``mass`` in kg and ``inertia`` in kg m^2, about its centre of mass, zero or positive; ``offset``: from the tip to
    that centre, m, (along the tip's tangent, across it to the left). In space the inertia may be a tensor (three rows,
    in the tip's axes; a number is that about any axis), the offset have a third component.
    """

    mass: float = 0.0
    inertia: Inertia = 0.0
    offset: tuple[float, ...] = (0.0, 0.0)

    def __post_init__(self) -> None:
        _store(
            self,
            mass=check.number("payload.mass", self.mass, "kg", minimum=0.0),
            inertia=bodies.inertia("payload.inertia", self.inertia),
        )
        what = "two numbers (m), along the tip's tangent and across it"
        count = 3 if isinstance(self.offset, list | tuple) and len(self.offset) == 3 else 2
        offset = check.numbers("payload.offset", self.offset, what, count, "m")
        _store(self, offset=offset if any(offset[2:]) else offset[:2])

    @property
    def spatial(self) -> bool:
        """Whether it takes an arm out of its plane, or has a tensor."""
        return len(self.offset) > 2 or isinstance(self.inertia, tuple)

    @property
    def eccentric(self) -> bool:
        """Whether there is a mass whose centre is not at the tip."""
        return self.mass > 0.0 and any(self.offset)

    @property
    def lever(self) -> complex:
        """The offset as a complex number, m."""
        return complex(*self.offset[:2])


@dataclass(frozen=True)
class Motor:
    """An electric motor: its torque is torque_constant times its current, its voltage resistance times that plus
    back_emf times its rate; both are those of the shaft, before the gear.

    Args:
        torque_constant: N m/A, positive.
        resistance: of the winding, ohm, positive; None: not known, and no voltage can be given.
        back_emf: V s/rad, zero or positive; None: the torque constant, which it is in SI units.
        current_limit: A, positive, or None. voltage_limit: V, positive, or None; it needs a resistance.
    """

    torque_constant: float
    resistance: float | None = None
    back_emf: float | None = None
    current_limit: float | None = None
    voltage_limit: float | None = None

    def __post_init__(self) -> None:
        positive = {"resistance": "ohm", "current_limit": "A", "voltage_limit": "V"}
        for name, unit in positive.items():
            value = getattr(self, name)
            _store(self, **{name: None if value is None else check.number(f"motor.{name}", value, unit, above=0.0)})
        constant = check.number("motor.torque_constant", self.torque_constant, "N m/A", above=0.0)
        emf = self.back_emf
        _store(self, torque_constant=constant)
        _store(self, back_emf=None if emf is None else check.number("motor.back_emf", emf, "V s/rad", minimum=0.0))
        if self.resistance is None and (self.voltage_limit is not None or emf is not None):
            raise check.MissingKey("motor.resistance", "a voltage says nothing about the current without it (ohm)")


FRICTION_SIDES = ("motor", "link")


@dataclass(frozen=True)
class Joint:
    """What turns a joint: a motor with its rotor, a gear, friction. Angles, rates and torques are after the ratio.

    The torque of the joint (`JointTorque`, an action) acts on the motor's side. An elastic gear gives the arm one more
    coordinate, the motor's angle over the ratio, relative to the link before, as the joint's own is: "motor0" beside
    "joint0", which is the angle of the link's root. Between the two act spring and damper.

    Args:
        stiffness: of the gear, N m/rad, positive; inf: it does not give, and there is no such coordinate.
        damping: of the gear, N m s/rad, beside the spring; 0 where the stiffness is infinite.
        motor_inertia: of the rotor about its own axis, kg m^2: its energy is 1/2 motor_inertia (gear_ratio rate)^2,
            rate being that of the motor's angle relative to the link before. An elastic gear needs one, unless a
            motion prescribes the motor's angle. In space its momentum along an axis that turns asks for a moment.
        gear_ratio: turns of the rotor for one of the joint, positive, at most 1e9.
        friction_viscous: N m s/rad. friction_coulomb: N m: the torque that the joint withstands before it moves, and
            that brakes it while it does.
        friction_side: "motor" or "link": which side of an elastic gear the friction acts on.
        backlash: play of an elastic gear after the ratio, rad: the link's side turns so far between its flanks before
            the spring, half of it to either side, takes hold. The damping acts in the gap as well.
        motor: what makes the torque; None: it is given.
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
        """Whether the gear gives, so that the motor has a coordinate of its own."""
        return self.stiffness < math.inf

    @property
    def rotor(self) -> float:
        """The rotor's inertia after the ratio, kg m^2."""
        return self.motor_inertia * self.gear_ratio**2

    @property
    def moves(self) -> bool:
        """Whether the joint is anything that an equation of motion knows of."""
        return self.elastic or self.rotor > 0.0 or self.friction_viscous > 0.0 or self.friction_coulomb > 0.0


@dataclass(frozen=True)
class Base:
    """What carries an arm where its root floats freely (`Scene`, root="free"): a rigid body whose centre of mass is at
    the hub. The first joint turns link 0 against it, and its torque's reaction turns it.

    Args:
        mass: kg, zero or positive. inertia: about its centre, kg m^2, positive.
    """

    mass: float
    inertia: float

    def __post_init__(self) -> None:
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
        hub_inertia: at the root of link 0, kg m^2; in space also a tensor, in that link's axes.
        hub_axis, hub_mount: as `Elbow.axis`, `Elbow.mount` of the joint at the root, the ground in place of the link
            before: link 0's root has the axes hub_mount exp(angle hub_axis).
        elbows: N-1 elbows, or () for massless ones.
        joints: N of :class:`Joint`, what turns them, or () for ideal ones.
        payload: at the tip of the last link.
        tau_d: Kelvin-Voigt time constant, s: stress = D (strain + tau_d strain rate), so zeta_k = tau_d omega_k / 2; of
            the links that have none of their own.
        mass_damping: 1/s, drag on what a link, its elbow's mass and the payload move relative to the link's floating
            frame, eq. [65]: zeta_k gains mass_damping / (2 omega_k). Only one frame a link (formulation
            "floating_frame" with segments=1 or modes alone) has it; elsewhere an error.
        torque_limits: N positive numbers, N m, or None (no limit).
        joint_limits: N entries, each None or (low, high) in rad (joint 0: the root angle; joint k: the angle of
            link k's root from link k-1's tip), or None (no limits at all).
        source: where the numbers come from.
        sensors: what `observation="measured"` and `Trajectory.measured` read; None: ideal ones.
        base: what carries the arm where its root is free, in the plane; None: nothing does. Where the root is held it
            is, too.
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
        check.text("name", self.name, empty=False)
        links = check.instances("links", self.links, Link, "at least one Link")
        if not links:
            raise check.InvalidValue("links", links, "must be a sequence of at least one Link")
        n = len(links)
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
        """Whether its links turn out of the x-y plane, or one of them is rigid: it is then computed in space."""
        hub = self.hub_axis != bodies.Z or self.hub_mount is not None or isinstance(self.hub_inertia, tuple)
        parts: tuple[Elbow | Payload, ...] = (*self.elbows, self.payload)
        return hub or any(part.spatial for part in parts) or any(link.rigid for link in self.links)

    def check_planar(self) -> None:
        """Raise ValueError where the arm leaves the plane, or a link is rigid."""
        if self.spatial:
            what = "must move in the x-y plane here; SpatialFlexArm-v0, simulate and modes compute arms in space"
            raise check.InvalidValue("arm", self.name, what)

    @property
    def n_links(self) -> int:
        """Number of links N."""
        return len(self.links)

    @property
    def total_length(self) -> float:
        """Sum of the links' lengths, rigid ends among them, m."""
        return sum(link.span for link in self.links)

    @property
    def mass(self) -> float:
        """Mass of links, elbows and payload, kg."""
        ends = sum(k.root_mass + k.tip_mass for k in self.links)
        return sum(k.mass for k in self.links) + ends + sum(e.mass for e in self.elbows) + self.payload.mass

    @property
    def damping(self) -> tuple[float, tuple[float, ...] | None]:
        """The largest tau_d of the links, s, and each link's share of it; None where they are alike."""
        own = [self.tau_d if link.tau_d is None else link.tau_d for link in self.links]
        largest = max(own)
        return largest, None if min(own) == largest else tuple(tau / largest for tau in own)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the N joints: "hub"; "elbow", or where there are several "elbow_1", "elbow_2", ..."""
        count = self.n_links - 1
        return ("hub", *(("elbow",) if count == 1 else tuple(f"elbow_{k + 1}" for k in range(count))))

    def by_link(self, name: str) -> tuple[str, ...]:
        """A name for each of the N links: itself for a single one, otherwise with _1, _2, ... behind it."""
        return (name,) if self.n_links == 1 else tuple(f"{name}_{k + 1}" for k in range(self.n_links))

    @property
    def jointed(self) -> bool:
        """Whether a joint is not ideal."""
        return any(joint.moves for joint in self.joints)

    @property
    def taut(self) -> Arm:
        """The arm without the play of its gears: in the play a link turns freely, and no linear model has a spring."""
        return replace(self, joints=tuple(replace(joint, backlash=0.0) for joint in self.joints))

    def joint(self, k: int) -> Joint:
        """What turns joint k (an ideal one where none is given)."""
        return self.joints[k] if self.joints else Joint()

    def elbow(self, joint: int) -> Elbow:
        """The elbow at joint 1 ... N-1 (a massless one where none is given)."""
        if not 1 <= joint < self.n_links:
            raise check.InvalidValue("joint", joint, f"must be from 1 to {self.n_links - 1} for this arm")
        return self.elbows[joint - 1] if self.elbows else Elbow()


def _torque_limits(value: object, n: int) -> tuple[float, ...] | None:
    if value is None:
        return None
    return check.numbers("torque_limits", value, f"{n} positive numbers (N m), one a joint", n, "N m", above=0.0)


def _joint_limits(value: object, n: int) -> tuple[JointRange | None, ...] | None:
    if value is None:
        return None
    ranges: list[JointRange | None] = []
    for i, entry in enumerate(check.sequence("joint_limits", value, f"{n} entries, one a joint", n)):
        if entry is None or (isinstance(entry, list | tuple) and not entry):
            ranges.append(None)
            continue
        low, high = check.numbers(f"joint_limits[{i}]", entry, "two numbers, (low, high) in rad", 2, "rad")
        if not low < high:
            raise check.InvalidValue(f"joint_limits[{i}]", (low, high), "must be (low, high) with low < high (rad)")
        ranges.append((low, high))
    return tuple(ranges)
