"""What an arm is made of: frozen, validated, in SI units.

An :class:`Arm` is a chain of :class:`Link` objects. Link ``k`` starts at joint ``k``: joint 0 is the hub
(the root of the arm), joint ``k >= 1`` the elbow between the tip of link ``k-1`` and the root of link ``k``.
Every class is immutable and hashable; sequences are kept as tuples; ``dataclasses.replace`` makes a variant
and checks it again. A value that is not allowed raises a ``ValueError`` which names the key path, the value
and what is allowed.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from flexarm_env import validation as check
from flexarm_env.sections import Link, Points, Section, Taper
from flexarm_env.sections import store as _store

__all__ = ["Arm", "Elbow", "JointRange", "Link", "Payload", "Points", "Section", "Taper"]

JointRange = tuple[float, float]


@dataclass(frozen=True)
class Elbow:
    """What sits at the joint between two links.

    ``mass`` (kg) and ``inertia_left`` (kg m^2) belong to the tip of the link before it, ``inertia_right``
    (kg m^2) to the root of the link after it. All zero or positive.
    """

    mass: float = 0.0
    inertia_left: float = 0.0
    inertia_right: float = 0.0

    def __post_init__(self) -> None:
        _store(
            self,
            mass=check.number("mass", self.mass, "kg", minimum=0.0),
            inertia_left=check.number("inertia_left", self.inertia_left, "kg m^2", minimum=0.0),
            inertia_right=check.number("inertia_right", self.inertia_right, "kg m^2", minimum=0.0),
        )


@dataclass(frozen=True)
class Payload:
    """A body fixed to the tip of the last link: ``mass`` in kg, ``inertia`` in kg m^2, zero or positive."""

    mass: float = 0.0
    inertia: float = 0.0

    def __post_init__(self) -> None:
        _store(
            self,
            mass=check.number("payload.mass", self.mass, "kg", minimum=0.0),
            inertia=check.number("payload.inertia", self.inertia, "kg m^2", minimum=0.0),
        )


@dataclass(frozen=True)
class Arm:
    """A chain of N links with hub, elbows and payload.

    Args:
        name: a short word.
        links: N >= 1 links, root to tip.
        hub_inertia: at the root of link 0, kg m^2.
        elbows: N-1 elbows, or () for massless ones.
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
    """

    name: str
    links: tuple[Link, ...]
    hub_inertia: float = 0.0
    elbows: tuple[Elbow, ...] = ()
    payload: Payload = field(default_factory=Payload)
    tau_d: float = 0.0
    mass_damping: float = 0.0
    torque_limits: tuple[float, ...] | None = None
    joint_limits: tuple[JointRange | None, ...] | None = None
    source: str = ""

    def __post_init__(self) -> None:
        check.text("name", self.name, empty=False)
        links = check.sequence("links", self.links, "at least one Link")
        if not links:
            raise check.InvalidValue("links", links, "must be a sequence of at least one Link")
        for i, link in enumerate(links):
            check.instance(f"links[{i}]", link, Link)
        n = len(links)
        elbows = check.sequence("elbows", self.elbows, "Elbow")
        if elbows and len(elbows) != n - 1:
            raise check.InvalidValue("elbows", elbows, f"must be empty or hold {n - 1} (one less than the links)")
        for i, elbow in enumerate(elbows):
            check.instance(f"elbows[{i}]", elbow, Elbow)
        check.instance("payload", self.payload, Payload)
        check.text("source", self.source)
        _store(
            self,
            links=links,
            elbows=elbows,
            hub_inertia=check.number("hub_inertia", self.hub_inertia, "kg m^2", minimum=0.0),
            tau_d=check.number("tau_d", self.tau_d, "s", minimum=0.0),
            mass_damping=check.number("mass_damping", self.mass_damping, "1/s", minimum=0.0),
            torque_limits=_torque_limits(self.torque_limits, n),
            joint_limits=_joint_limits(self.joint_limits, n),
        )

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

    def elbow(self, joint: int) -> Elbow:
        """The elbow at joint 1 ... N-1 (a massless one where none is given)."""
        if not 1 <= joint < self.n_links:
            raise check.InvalidValue("joint", joint, f"must be from 1 to {self.n_links - 1} for this arm")
        return self.elbows[joint - 1] if self.elbows else Elbow()


def _torque_limits(value: object, n: int) -> tuple[float, ...] | None:
    if value is None:
        return None
    limits = check.sequence("torque_limits", value, f"{n} positive numbers (N m), one a joint", n)
    return tuple(check.number(f"torque_limits[{i}]", v, "N m", above=0.0) for i, v in enumerate(limits))


def _joint_limits(value: object, n: int) -> tuple[JointRange | None, ...] | None:
    if value is None:
        return None
    ranges: list[JointRange | None] = []
    for i, entry in enumerate(check.sequence("joint_limits", value, f"{n} entries, one a joint", n)):
        if entry is None or (isinstance(entry, list | tuple) and not entry):
            ranges.append(None)
            continue
        low, high = check.sequence(f"joint_limits[{i}]", entry, "two numbers, (low, high) in rad", 2)
        low = check.number(f"joint_limits[{i}][0]", low, "rad")
        high = check.number(f"joint_limits[{i}][1]", high, "rad")
        if not low < high:
            raise check.InvalidValue(f"joint_limits[{i}]", (low, high), "must be (low, high) with low < high (rad)")
        ranges.append((low, high))
    return tuple(ranges)
