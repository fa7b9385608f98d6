"""What moves and loads the arm of a scene: prescribed coordinates, joint torques, point loads."""

import re
from dataclasses import dataclass

from flexarm_env import validation as check
from flexarm_env.time_functions import C0, TimeFunction

COORDINATES = '"joint0", "joint1", ..., "motor0", ... (behind an elastic gear), "root_x", "root_y" or "root_z"'
ROOT = ("root_x", "root_y", "root_z")


OUT_OF_PLANE = ("force_z", "torque_x", "torque_y")
FORCES = ("force_x", "force_y", "torque", *OUT_OF_PLANE)
"""What a point load may have, and what of it in space alone."""


@dataclass(frozen=True)
class Motion:
    """A coordinate that is prescribed.

    Args:
        coordinate: "joint0" (absolute angle of the root of link 0), "joint1", ... (angle of link k's root from the
            tip section of link k-1), "motor0", ... (angle of the motor behind an elastic gear, over its ratio, from
            the same), "root_x", "root_y" or, in space, "root_z" (position of the root, m).
        function: its value (rad or m) over time; the value must not jump.
    """

    coordinate: str
    function: TimeFunction

    def __post_init__(self) -> None:
        name = self.coordinate
        if not isinstance(name, str) or not (name in ROOT or re.fullmatch(r"(joint|motor)(0|[1-9][0-9]*)", name)):
            raise check.InvalidValue("coordinate", name, f"must be {COORDINATES}")
        check.instance("function", self.function, TimeFunction).check_no_jump()

    @property
    def joint(self) -> int | None:
        """Index of the joint, or of the motor's, or None for a coordinate of the root's position."""
        return None if self.coordinate.startswith("root") else int(self.coordinate[5:])

    @property
    def on_motor(self) -> bool:
        """Whether the motor's side of an elastic gear is prescribed, not the link's."""
        return self.coordinate.startswith("motor")


@dataclass(frozen=True)
class JointTorque:
    """A torque (N m) of joint ``k``: + on the root of link k, - on the tip of link k-1 (k = 0: on the ground)."""

    joint: int
    function: TimeFunction

    def __post_init__(self) -> None:
        object.__setattr__(self, "joint", check.integer("joint", self.joint, minimum=0))
        check.instance("function", self.function, TimeFunction)

    @property
    def functions(self) -> tuple[TimeFunction, ...]:
        """The functions of time in it."""
        return (self.function,)


@dataclass(frozen=True)
class PointLoad:
    """A force in global axes (N) and a torque (N m) on the "root" or "tip" of a link; at least one of these.

    In space: force_z, and torque_x, torque_y beside the torque about z; global axes as well.
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
        object.__setattr__(self, "link", check.integer("link", self.link, minimum=0))
        check.choice("end", self.end, ("root", "tip"))
        for name in FORCES:
            if getattr(self, name) is not None:
                check.instance(name, getattr(self, name), TimeFunction)
        if not self.functions:
            raise check.MissingKey("force_x", "a point load needs force_x, force_y or torque")

    @property
    def spatial(self) -> bool:
        """Whether it acts out of the plane."""
        return any(getattr(self, name) is not None for name in OUT_OF_PLANE)

    @property
    def functions(self) -> tuple[TimeFunction, ...]:
        """The functions of time in it."""
        return tuple(f for f in (getattr(self, name) for name in FORCES) if f is not None)

    @property
    def silent(self) -> bool:
        """Whether it is zero throughout: a place for forces that come from outside."""
        return not any(f.pieces[:, C0:].any() for f in self.functions)


Load = JointTorque | PointLoad
