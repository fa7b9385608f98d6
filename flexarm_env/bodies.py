"""Parameters of arms in space: joint axes, mounts, inertia tensors and rigid links."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from flexarm_env import validation as check
from flexarm_env.records import described, number, validate, value
from flexarm_env.rotations import matrices
from flexarm_env.sections import Link, Section
from flexarm_env.validation import Array

Vector = tuple[float, float, float]
Matrix = tuple[Vector, Vector, Vector]
Inertia = Any
"""Moment of inertia (kg m^2): one number for all axes, or an inertia tensor (`Matrix`)."""

Z: Vector = (0.0, 0.0, 1.0)
"""Joint axis of an arm in the plane."""


class Axes(str):
    """Conventions for arms: this class for arms in the plane (axes "xy"), a subclass for arms in space (axes "xyz").

    formulation: default formulation of scenes. quick_formulation: default formulation of environments and of fits.
    turns: axes of the gyroscope at the tip. rises: axes along which a camera measures the slope of the tip. measures:
    curvatures that strain gauges measure. hinges: axes about which the sections of a link rotate.
    """

    formulation, quick_formulation = "floating_frame", "elastica"
    turns, rises, hinges = "", "", "z"
    measures: tuple[str, ...] = ("xy",)

    def joint(self, values: Sequence[float], joint: int, turn: float) -> float:
        """Return a joint's angle (rad) or rate (rad/s) from a scene's `angles` or `rates`; turn: see `Arm.relative`."""
        if joint == 0:
            return values[0]
        return values[joint] - (values[joint - 1] + turn if turn else values[joint - 1])

    def stated(self, joints: Sequence[float]) -> tuple[float, ...]:
        """Convert joint angles (rad) to a scene's `angles` (rad)."""
        return tuple(np.cumsum(joints).tolist())

    def behind_rigid_joint(self, value: float) -> float:
        """Return a scene's angle or rate of a link with a rigid joint. value: the previous link's angle or rate."""
        return value

    def divides_cells(self, formulation: str) -> bool:
        """Return whether the meshes of a formulation have cell boundaries at jumps and kinks of the sections."""
        return True

    def inertia_across(self, link: Link, s: Array) -> Array:
        """Return the rotary inertia per length, kg m, about the y axis of a link's sections at s, m from its root."""
        return np.asarray(link.along(s).J)

    def check_planar(self, path: str, value: object, what: str) -> None:
        """Raise `InvalidValue` for an arm in space. path, value, what: key path, value and rule in the message."""

    def table_of_gains(self, task: str) -> str:
        """Return the name of the file with the controllers' tuned gains for a task."""
        return task


class _Space(Axes):
    """The three axes along which an arm in space moves."""

    formulation = quick_formulation = "geometrically_exact"
    turns, rises, hinges = "xyz", "yz", "xyz"
    measures = ("xy", "xz", "torsion")

    def joint(self, values: Sequence[float], joint: int, turn: float) -> float:
        return values[joint]

    def stated(self, joints: Sequence[float]) -> tuple[float, ...]:
        return tuple(joints)

    def behind_rigid_joint(self, value: float) -> float:
        return 0.0

    def divides_cells(self, formulation: str) -> bool:
        return formulation != "elastica"

    def inertia_across(self, link: Link, s: Array) -> Array:
        return link.across(s)["J_y"]

    def check_planar(self, path: str, value: object, what: str) -> None:
        raise check.InvalidValue(path, value, what)

    def table_of_gains(self, task: str) -> str:
        return "space"


PLANE, SPACE = Axes("xy"), _Space("xyz")


def axes_of(spatial: bool) -> Axes:
    """Return `SPACE` for an arm or scene that is computed in space, otherwise `PLANE`."""
    return SPACE if spatial else PLANE


def vector(path: str, value: object, unit: str = "") -> Vector:
    """Validate a vector of three finite numbers and return it as a tuple."""
    x, y, z = check.numbers(path, value, f"three numbers{f' ({unit})' if unit else ''}", 3, unit)
    return x, y, z


def unit_vector(path: str, value: object) -> Vector:
    """Validate a direction given by three numbers and return the unit vector."""
    given = np.array(vector(path, value))
    largest = float(np.abs(given).max())
    # the norm's squares must neither overflow nor underflow
    if not 1e-150 < largest < 1e150:
        raise check.InvalidValue(path, value, "must be a direction: three numbers of ordinary size, not all 0")
    # a length of 1 up to round-off is left as it is
    length = float(np.linalg.norm(given))
    x, y, z = (given / length).tolist() if abs(length - 1.0) > 1e-15 else given.tolist()
    return x, y, z


def rows(path: str, value: object, unit: str = "") -> Matrix:
    """Validate a 3 x 3 matrix and return it as tuples."""
    given = value.tolist() if isinstance(value, np.ndarray) else value
    a, b, c = (vector(f"{path}[{i}]", row, unit) for i, row in enumerate(check.sequence(path, given, "three rows", 3)))
    return a, b, c


def mount(path: str, value: Any) -> Matrix | None:
    """Validate a rotation, given as a matrix or as a pair of axis and angle (rad).

    Returns the rotation matrix, or None for no rotation.

    Raises:
        ValueError: the value is neither a matrix nor a pair of axis and angle, or the matrix deviates from a rotation
            matrix by more than 1e-6. Smaller deviations are corrected.
    """
    if value is None:
        return None
    what = "must be a rotation matrix of three rows, or (axis, angle) with an axis of three numbers and rad"
    if isinstance(value, list | tuple) and len(value) == 2:
        # rotation by the vector angle axis
        axis, angle = np.array(unit_vector(f"{path}[0]", value[0])), check.number(f"{path}[1]", value[1], "rad")
        R = matrices(angle * axis)
    elif isinstance(value, list | tuple | np.ndarray) and len(value) == 3:
        # tolerance 1e-6 for rounded input, then made orthogonal to round-off
        R = np.array(rows(path, value))
        # nearest orthogonal matrix: u v of the singular value decomposition
        u, _, v = np.linalg.svd(R)
        if not (np.abs(u @ v - R).max() < 1e-6 and np.linalg.det(R) > 0.0):
            raise check.InvalidValue(path, value, what + "; its rows are to be unit vectors, each square to the others")
        R = R if np.abs(R @ R.T - np.eye(3)).max() < 1e-15 else u @ v
    else:
        raise check.InvalidValue(path, value, what)
    return None if np.array_equal(R, np.eye(3)) else rows(path, R)


def inertia(path: str, value: object) -> Inertia:
    """Validate a moment of inertia or an inertia tensor about a center of mass, kg m^2.

    A tensor must be symmetric. Each principal moment must be at least 0 and at most the sum of the two other moments.
    """
    if not isinstance(value, list | tuple | np.ndarray):
        return check.number(path, value, "kg m^2", minimum=0.0)
    given = np.array(rows(path, value, "kg m^2"))
    size = float(np.abs(given).max())
    if np.abs(given - given.T).max() > 1e-9 * size:
        raise check.InvalidValue(path, value, "must be symmetric")
    # principal moments: none negative, triangle inequality up to round-off
    own = np.linalg.eigvalsh(0.5 * (given + given.T))
    if own[0] < -1e-9 * size or own[2] > (own[0] + own[1]) * (1.0 + 1e-6) + 1e-12 * size:
        what = "must be that of a body: principal values of at least 0, none above the sum of the other two (kg m^2); "
        raise check.InvalidValue(path, value, f"{what}they are {', '.join(f'{x:.4g}' for x in own)}")
    return rows(path, 0.5 * (given + given.T))


VECTOR = {"type": "array", "items": {"type": "number"}, "minItems": 3, "maxItems": 3}
"""JSON schema of three numbers."""

_ROWS = {"type": "array", "items": VECTOR, "minItems": 3, "maxItems": 3}
_TENSOR = {"if": {"type": "array"}, "then": _ROWS, "else": {"type": "number", "minimum": 0.0}}
_ROTATION = {"type": "array", "minItems": 2, "maxItems": 3}


def inertia_field(text: str) -> Any:
    """Declare a dataclass field for a moment of inertia or an inertia tensor. text: description of the field."""
    words = f"{text}: one number for all axes, or in space a tensor of three rows"
    return value(inertia, _TENSOR, words, "kg m^2", 0.0)


def axis_field(text: str) -> Any:
    """Declare a dataclass field for a direction. text: description of the field."""
    return value(unit_vector, VECTOR, text, "", Z)


def mount_field(text: str) -> Any:
    """Declare a dataclass field for a rotation. text: description of the field."""
    words = f"{text}: a rotation matrix, or (axis, angle in rad)"
    return value(mount, _ROTATION, words, "", None, optional=True)


def tensor(value: Inertia) -> Array:
    """Return the 3 x 3 inertia tensor; a number is multiplied by the identity matrix."""
    return np.array(value) if isinstance(value, tuple) else value * np.eye(3)


def about_z(value: Inertia) -> float:
    """Return the moment of inertia about the z axis, kg m^2, of a moment or tensor of inertia."""
    return float(value[2][2]) if isinstance(value, tuple) else value


def about(I: Array, mass: float, arm: Array) -> Array:
    """Return the inertia tensor about any point by the parallel axis theorem.

    The result is I + mass (arm^T arm E - arm arm^T), kg m^2, with the identity matrix E. I: inertia tensor about the
    center of mass. arm (3,): vector from the center of mass to the point, m.
    """
    return np.asarray(I + mass * (float(arm @ arm) * np.eye(3) - np.outer(arm, arm)))


class Body(NamedTuple):
    """Rigid body that is fixed to a section of an arm, described in the section's axes."""

    mass: float  # mass, kg
    centre: Array  # (3,): vector from the section's origin to the center of mass, m, section axes
    inertia: Array  # (3, 3): inertia tensor about the center of mass, kg m^2, section axes


def combined_body(parts: list[Body]) -> Body:
    """Combine bodies that are fixed to the same section into one body."""
    mass = sum(part.mass for part in parts)
    centre = sum((part.mass * part.centre for part in parts), np.zeros(3)) / mass if mass > 0.0 else np.zeros(3)
    inertia = sum((about(p.inertia, p.mass, p.centre - centre) for p in parts), np.zeros((3, 3)))
    return Body(mass, centre, inertia)


_STIFF = Section(EI=1.0, EA=1.0, C=1.0, m=1.0)
"""Placeholder for the section of a rigid link."""


@described
@dataclass(frozen=True)
class RigidLink(Link):
    """Rigid link, for example a column or a gearbox; an arm with a rigid link is computed in space."""

    length: float = number("distance along x from the joint at the root to the next joint or the tip", "m", minimum=0.0)
    mass: float = number("mass", "kg", 0.0, minimum=0.0)
    centre: Vector = value(
        partial(vector, unit="m"), VECTOR, "center of mass relative to the root, in the link's axes", "m",
        (0.0, 0.0, 0.0),
    )  # fmt: skip
    inertia: Inertia = inertia_field("inertia about the center of mass, in the link's axes")
    section: Section = field(init=False, default=_STIFF, repr=False)
    tau_d: None = field(init=False, default=None, repr=False)
    root_offset: float = field(init=False, default=0.0, repr=False)
    tip_offset: float = field(init=False, default=0.0, repr=False)
    root_mass: float = field(init=False, default=0.0, repr=False)
    tip_mass: float = field(init=False, default=0.0, repr=False)
    root_inertia: float = field(init=False, default=0.0, repr=False)
    tip_inertia: float = field(init=False, default=0.0, repr=False)
    curvature: float = field(init=False, default=0.0, repr=False)

    def __post_init__(self) -> None:
        """Validate the fields and convert them to plain numbers; an `InvalidValue` names the invalid field."""
        validate(self)

    @property
    def rigid(self) -> bool:
        """True: the link does not bend."""
        return True

    @property
    def uniform(self) -> None:
        """Section of the link: None for a rigid link."""
        return None

    def moment(self, power: int) -> float:
        """Return the integral of s^power dm, kg m^power, for powers 0 to 2; s: distance from the link's root, m."""
        # Steiner's term plus the inertia about z
        return self.mass * self.centre[0] ** power + (float(tensor(self.inertia)[2, 2]) if power == 2 else 0.0)

    @property
    def rotary(self) -> float:
        """Rotary inertia of the link: 0, because `moment` contains the whole rotary inertia."""
        return 0.0
