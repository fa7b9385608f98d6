"""Motions and loads of a scene: prescribed coordinates, joint torques, point loads."""

import re
from dataclasses import dataclass

from flexarm_env import validation as check
from flexarm_env.time_functions import C0, TimeFunction

COORDINATES = '"joint0", "joint1", ..., "motor0", ... (behind an elastic gear), "root_x", "root_y" or "root_z"'
ROOT = ("root_x", "root_y", "root_z")


OUT_OF_PLANE = ("force_z", "torque_x", "torque_y")
FORCES = ("force_x", "force_y", "torque", *OUT_OF_PLANE)
"""Components of a point load; the components in `OUT_OF_PLANE` exist only in space."""


@dataclass(frozen=True)
class Motion:
    """Coordinate that is prescribed as a function of time.

    Args:
        coordinate: "joint0" is the absolute angle of link 0's root; "joint1", ... is the angle from the tip of link k-1
            to the root of link k; "motor0", ... is the angle of a motor with an elastic gear, divided by the gear
            ratio, with the zero of the joint's angle; "root_x", "root_y" and, in space, "root_z" are the root's
            position, m.
        function: value (rad or m) as a function of time; it must be continuous.
    """

    coordinate: str
    function: TimeFunction

    def __post_init__(self) -> None:
        """Validate the coordinate's name; reject a function with jumps."""
        name = self.coordinate
        # a root coordinate, or joint or motor with an index
        if not isinstance(name, str) or not (name in ROOT or re.fullmatch(r"(joint|motor)(0|[1-9][0-9]*)", name)):
            raise check.InvalidValue("coordinate", name, f"must be {COORDINATES}")
        check.instance("function", self.function, TimeFunction).check_no_jump()

    @property
    def joint(self) -> int | None:
        """Index of the joint whose joint or motor angle is prescribed; None if the root's position is prescribed."""
        return None if self.coordinate.startswith("root") else int(self.coordinate[5:])

    @property
    def on_motor(self) -> bool:
        """True if the motion prescribes the angle of a motor with an elastic gear."""
        return self.coordinate.startswith("motor")


@dataclass(frozen=True)
class JointTorque:
    """Torque, N m, of joint k on the root of link k; the opposite torque acts on the tip of link k-1 or the ground."""

    joint: int
    function: TimeFunction

    def __post_init__(self) -> None:
        object.__setattr__(self, "joint", check.integer("joint", self.joint, minimum=0))
        check.instance("function", self.function, TimeFunction)

    @property
    def functions(self) -> tuple[TimeFunction, ...]:
        """Functions of time that define the joint torque."""
        return (self.function,)


@dataclass(frozen=True)
class PointLoad:
    """Force, N, and torque, N m, on the root or tip of a link, in inertial axes; at least one component is required.

    The components force_z, torque_x and torque_y exist only in space.
    """

    link: int
    end: str
    force_x: TimeFunction | None = None
    force_y: TimeFunction | None = None
    torque: TimeFunction | None = None
    force_z: TimeFunction | None = None
    torque_x: TimeFunction | None = None
    torque_y: TimeFunction | None = None

    def __post_init__(self) -> None:
        """Validate link, end and functions; at least one component of the load must be given."""
        object.__setattr__(self, "link", check.integer("link", self.link, minimum=0))
        check.choice("end", self.end, ("root", "tip"))
        for name in FORCES:
            if getattr(self, name) is not None:
                check.instance(name, getattr(self, name), TimeFunction)
        if not self.functions:
            raise check.MissingKey("force_x", "a point load needs force_x, force_y or torque")

    @property
    def spatial(self) -> bool:
        """True if the load has a component force_z, torque_x or torque_y."""
        return any(getattr(self, name) is not None for name in OUT_OF_PLANE)

    @property
    def functions(self) -> tuple[TimeFunction, ...]:
        """Functions of time of all components that are not None."""
        return tuple(f for f in (getattr(self, name) for name in FORCES) if f is not None)

    @property
    def silent(self) -> bool:
        """True if the load is zero at all times."""
        return not any(f.pieces[:, C0:].any() for f in self.functions)


@dataclass(frozen=True)
class InnerLoad(PointLoad):
    """Force and torque on the section at a fraction of a link's length, as at contact points in environments.

    place: fraction, between 0 and 1, of the length without rigid ends.
    """

    place: float = 0.5

    def elements_before(self, count: int) -> int:
        """Return the number of elements between the link's root and the section. count: elements of equal length.

        Raises:
            InvalidValue: no element ends at the section.
        """
        before = round(self.place * count)
        if abs(self.place * count - before) > 1e-6 or not 0 < before < count:
            raise check.InvalidValue("place", self.place, f"must be at the end of one of the link's {count} elements")
        return before


Load = JointTorque | PointLoad
