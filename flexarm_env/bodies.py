"""What arms in space have beside those in the plane: axes and mounts of joints, tensors of inertia, rigid links."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from flexarm_env import validation as check
from flexarm_env.rotations import matrices
from flexarm_env.sections import Link, Section
from flexarm_env.validation import Array

Vector = tuple[float, float, float]
Matrix = tuple[Vector, Vector, Vector]
Inertia = Any
"""A number (kg m^2), or a `Matrix`: a tensor."""

Z: Vector = (0.0, 0.0, 1.0)
"""The axis of an arm in the plane."""


def vector(path: str, value: object, unit: str = "") -> Vector:
    """Three finite numbers."""
    x, y, z = check.numbers(path, value, f"three numbers{f' ({unit})' if unit else ''}", 3, unit)
    return x, y, z


def unit_vector(path: str, value: object) -> Vector:
    """Three numbers, scaled to a length of 1."""
    given = np.array(vector(path, value))
    largest = float(np.abs(given).max())
    if not 1e-150 < largest < 1e150:
        raise check.InvalidValue(path, value, "must be a direction: three numbers of ordinary size, not all 0")
    length = float(np.linalg.norm(given))
    x, y, z = (given / length).tolist() if abs(length - 1.0) > 1e-15 else given.tolist()
    return x, y, z


def rows(path: str, value: object, unit: str = "") -> Matrix:
    """A 3 x 3 matrix as tuples."""
    given = value.tolist() if isinstance(value, np.ndarray) else value
    a, b, c = (vector(f"{path}[{i}]", row, unit) for i, row in enumerate(check.sequence(path, given, "three rows", 3)))
    return a, b, c


def mount(path: str, value: Any) -> Matrix | None:
    """A rotation: a matrix, or an axis and an angle (rad) about it; None where there is none.

    Raises:
        ValueError: neither, or a matrix that is not orthogonal, right-handed, to 1e-6; nearer ones are made so.
    """
    if value is None:
        return None
    what = "must be a rotation matrix of three rows, or (axis, angle) with an axis of three numbers and rad"
    if isinstance(value, list | tuple) and len(value) == 2:
        axis, angle = np.array(unit_vector(f"{path}[0]", value[0])), check.number(f"{path}[1]", value[1], "rad")
        R = matrices(angle * axis)
    elif isinstance(value, list | tuple | np.ndarray) and len(value) == 3:
        R = np.array(rows(path, value))
        u, _, v = np.linalg.svd(R)
        if not (np.abs(u @ v - R).max() < 1e-6 and np.linalg.det(R) > 0.0):
            raise check.InvalidValue(path, value, what + "; its rows are to be unit vectors, each square to the others")
        R = R if np.abs(R @ R.T - np.eye(3)).max() < 1e-15 else u @ v
    else:
        raise check.InvalidValue(path, value, what)
    return None if np.array_equal(R, np.eye(3)) else rows(path, R)


def inertia(path: str, value: object) -> Inertia:
    """A number, or a tensor of inertia about a centre of mass, kg m^2: symmetric, with principal values that a body may
    have (none negative, none above the sum of the others)."""
    if not isinstance(value, list | tuple | np.ndarray):
        return check.number(path, value, "kg m^2", minimum=0.0)
    given = np.array(rows(path, value, "kg m^2"))
    size = float(np.abs(given).max())
    if np.abs(given - given.T).max() > 1e-9 * size:
        raise check.InvalidValue(path, value, "must be symmetric")
    own = np.linalg.eigvalsh(0.5 * (given + given.T))
    if own[0] < -1e-9 * size or own[2] > (own[0] + own[1]) * (1.0 + 1e-6) + 1e-12 * size:
        what = "must be that of a body: principal values of at least 0, none above the sum of the other two (kg m^2); "
        raise check.InvalidValue(path, value, f"{what}they are {', '.join(f'{x:.4g}' for x in own)}")
    return rows(path, 0.5 * (given + given.T))


def tensor(value: Inertia) -> Array:
    """The 3 x 3 tensor; a number is that about any axis."""
    return np.array(value) if isinstance(value, tuple) else value * np.eye(3)


def about_z(value: Inertia) -> float:
    """What of it turns about z."""
    return float(value[2][2]) if isinstance(value, tuple) else value


def about(I: Array, mass: float, arm: Array) -> Array:
    """The tensor about a point that is `arm` from the centre (Steiner)."""
    return np.asarray(I + mass * (float(arm @ arm) * np.eye(3) - np.outer(arm, arm)))


_STIFF = Section(EI=1.0, EA=1.0, C=1.0, m=1.0)
"""Stands where a rigid link has no section."""


@dataclass(frozen=True)
class RigidLink(Link):
    """A link that does not bend: a pillar, a gearbox, a satellite. An arm with one is computed in space.

    Args:
        length: m, from the joint at its root to the next one (or to the arm's tip) along its x axis.
        mass: kg. centre: of mass, m, three numbers in the link's axes, from its root.
        inertia: kg m^2 about the centre, a tensor of three rows in the link's axes; a number: about any axis.
    """

    length: float
    mass: float = 0.0
    centre: Vector = (0.0, 0.0, 0.0)
    inertia: Inertia = 0.0
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
        check.store(
            self,
            length=check.number("length", self.length, "m", minimum=0.0),
            mass=check.number("mass", self.mass, "kg", minimum=0.0),
            centre=vector("centre", self.centre, "m"),
            inertia=inertia("inertia", self.inertia),
        )

    @property
    def rigid(self) -> bool:
        """Whether the link does not bend."""
        return True

    @property
    def uniform(self) -> None:
        """It has no section."""
        return None

    def moment(self, power: int) -> float:
        """int m s^power ds from the root for powers 0 to 2, kg m^power."""
        return self.mass * self.centre[0] ** power + (float(tensor(self.inertia)[2, 2]) if power == 2 else 0.0)

    @property
    def rotary(self) -> float:
        """None beside `moment`."""
        return 0.0
