"""Contact of an arm with an obstacle: the force law, and the points of the arm that can touch the obstacle."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from flexarm_env import validation as check
from flexarm_env.parameters import Arm
from flexarm_env.scene.functions import function_from_table, function_table
from flexarm_env.shapes import Shape, shape_of
from flexarm_env.time_functions import TimeFunction, constant

DISPLACEMENTS = ("displacement_x", "displacement_y", "displacement_z")
"""Fields of `Contact` with the displacement of a moving obstacle along x, y and z."""

EXPONENTS = (1.0, 1.5, 2.0, 2.5, 3.0)
"""Exponents of the normal force; their powers require only products and square roots."""


@dataclass(frozen=True)
class Contact:
    """Obstacle with the law of its normal force and friction force on points of an arm.

    The normal force at the penetration d is F_n = max(0, k d^n (1 + 3/2 alpha dd/dt)) (Hunt & Crossley 1975). The
    friction force at the sliding velocity w is the regularized Coulomb law F_t = -mu F_n w / sqrt(|w|^2 + v_s^2). With
    the regularized friction law a point never sticks. Under a tangential force F < mu F_n the point creeps with a
    velocity of at most v_s / sqrt((mu F_n / F)^2 - 1).

    Args:
        obstacle: `HalfSpace`, `Sphere`, `Box` or, in space, `Cylinder` (`flexarm_env.shapes`). In the plane shapes have
            two coordinates, in space three.
        stiffness: stiffness k, N/m^n, positive.
        exponent: exponent n of the force law: 1, 1.5 (Hertz), 2, 2.5 or 3.
        damping: damping coefficient alpha, s/m, zero or positive. The coefficient of restitution at low impact speed v
            is about 1 - alpha v.
        friction: coefficient of friction mu, zero or positive.
        creep: velocity v_s of the regularization, m/s, positive.
        speed: impact speed, m/s, positive, that limits the time step: an impact of the arm's effective mass at this
            speed must last at least 8 steps.
        bodies: points of the arm that can touch the obstacle. "tip" is the center of a sphere of radius
            `Payload.radius`; "joint1", "joint2", ... are centers of spheres of radius `Elbow.radius`. "link0@0.5"
            is the center of a sphere of radius `radius` in the middle of link 0.
        radius: radius of the spheres at points along links, m, zero or positive.
        displacement_x, displacement_y, displacement_z: displacement of the obstacle as a function of time, m; None: no
            displacement along this axis. A displacement must be continuous.
    """

    obstacle: Shape
    stiffness: float
    exponent: float = 1.5
    damping: float = 0.0
    friction: float = 0.0
    creep: float = 1e-3
    speed: float = 1.0
    bodies: tuple[str, ...] = ("tip",)
    displacement_x: TimeFunction | None = None
    displacement_y: TimeFunction | None = None
    displacement_z: TimeFunction | None = None
    radius: float = 0.0

    def __post_init__(self) -> None:
        """Validate the fields; an `InvalidValue` names the invalid field."""
        check.instance("obstacle", self.obstacle, Shape)
        exponent = check.number("exponent", self.exponent)
        if exponent not in EXPONENTS:
            raise check.InvalidValue("exponent", self.exponent, "must be 1, 1.5, 2, 2.5 or 3")
        given: object = self.bodies
        given = (given,) if isinstance(given, str) else given
        bodies = check.sequence("bodies", given, 'points of the arm: "tip", "joint1", "link0@0.5", ...')
        if not bodies:
            raise check.InvalidValue("bodies", bodies, 'must name at least one point of the arm: "tip", "joint1", ...')
        for i, name in enumerate(bodies):
            if not isinstance(name, str) or not (re.fullmatch(r"tip|joint[1-9][0-9]*", name) or place_on_link(name)):
                what = 'must be "tip", "joint1", "joint2", ... or "link0@0.5", ... with a fraction between 0 and 1'
                raise check.InvalidValue(f"bodies[{i}]", name, what)
            if name in bodies[:i]:
                raise check.InvalidValue(f"bodies[{i}]", name, "must not be given twice")
        for name in DISPLACEMENTS:
            displacement = getattr(self, name)
            if displacement is None:
                continue
            if not isinstance(displacement, TimeFunction):
                what = "must be a TimeFunction, or in environments and scene files a table with kind and parameters"
                raise check.InvalidValue(name, displacement, what)
            with check.under(name):
                displacement.check_no_jump()
        check.store(
            self, exponent=exponent, bodies=bodies,
            stiffness=check.number("stiffness", self.stiffness, f"N/m^{exponent:g}", above=0.0),
            damping=check.number("damping", self.damping, "s/m", minimum=0.0),
            friction=check.number("friction", self.friction, minimum=0.0),
            creep=check.number("creep", self.creep, "m/s", above=0.0),
            speed=check.number("speed", self.speed, "m/s", above=0.0),
            radius=check.number("radius", self.radius, "m", minimum=0.0),
        )  # fmt: skip

    @property
    def spatial(self) -> bool:
        """True if the obstacle has three coordinates, False if it has two."""
        return self.obstacle.dimension == 3

    @property
    def displacements(self) -> tuple[tuple[int, TimeFunction], ...]:
        """Axes (0, 1, 2) along which the obstacle moves, each with the displacement (m) as a function of time."""
        found = [(axis, getattr(self, name)) for axis, name in enumerate(DISPLACEMENTS)]
        return tuple((axis, function) for axis, function in found if function is not None)

    def obstacle_at(self, t: float) -> Shape:
        """Return the obstacle, displaced to its position at time t (s)."""
        if not self.displacements:
            return self.obstacle
        found = dict(self.displacements)
        return self.obstacle.moved([float(found[k](t)) if k in found else 0.0 for k in range(self.obstacle.dimension)])

    def held(self) -> Contact:
        """Return the contact with the obstacle fixed at its position at t = 0."""
        still: dict[str, Any] = {
            DISPLACEMENTS[axis]: constant(float(function(0.0))) for axis, function in self.displacements
        }
        return replace(self, **still) if still else self

    def links(self, arm: Arm) -> tuple[int, ...]:
        """Return the link index of each point in `bodies`; a joint belongs to the link before the joint.

        Raises:
            ValueError: the arm lacks a joint or link that `bodies` names.
        """
        found = []
        for i, name in enumerate(self.bodies):
            place = place_on_link(name)
            if place is not None:
                if place[0] >= arm.n_links:
                    what = f"must be on a link of arm {arm.name}, 0 to {arm.n_links - 1}"
                    raise check.InvalidValue(f"bodies[{i}]", name, what)
                found.append(place[0])
                continue
            k = arm.n_links if name == "tip" else int(name[5:])
            if name != "tip" and k >= arm.n_links:
                known = ", ".join(['"tip"', *(f'"joint{j}"' for j in range(1, arm.n_links))])
                raise check.InvalidValue(f"bodies[{i}]", name, f"must be one of {known} of arm {arm.name}")
            found.append(k - 1)
        return tuple(found)

    def points(self, arm: Arm) -> tuple[tuple[int, float], ...]:
        """Return link index and fraction of the link's length of each point in `bodies`; the fraction of a tip is 1.

        Raises:
            ValueError: the arm lacks a joint or link that `bodies` names.
        """
        places = map(place_on_link, self.bodies)
        return tuple(
            (k, 1.0 if place is None else place[1]) for k, place in zip(self.links(arm), places, strict=True)
        )

    def to_table(self) -> dict[str, Any]:
        """Return a table from which `contact_of` creates an equal contact; default values are omitted."""
        table: dict[str, Any] = {"obstacle": self.obstacle.to_dict(), "stiffness": self.stiffness}
        table |= {name: value for name, value in check.changed(self).items() if name not in table}
        return table | {name: function_table(table[name]) for name in DISPLACEMENTS if name in table}


def touching_points(contacts: Iterable[Contact], arm: Arm) -> list[tuple[int, float]]:
    """Return the points that may touch obstacles, from root to tip, as pairs like those of `Contact.points`."""
    return sorted({point for contact in contacts for point in contact.points(arm)})


def place_on_link(name: str) -> tuple[int, float] | None:
    """Parse the name of a point on a link, such as "link0@0.5", to (0, 0.5); return None for any other name."""
    found = re.fullmatch(r"link(0|[1-9][0-9]*)@(0?\.[0-9]+)", name)
    place = (int(found[1]), float(found[2])) if found else None
    return place if place and 0.0 < place[1] < 1.0 else None


def contact_of(path: str, value: object, dimension: int | None = None, directory: Path = Path()) -> Contact:
    """Return `value` if it is a `Contact`; create a contact if it is a table with the fields of `Contact`.

    A displacement in a table is a `TimeFunction` or a table with `kind` and parameters, as in scene files.

    dimension: required number of coordinates of the obstacle, 2 in the plane, 3 in space; None: no requirement.
    directory: folder of CSV files with displacements.

    Raises:
        ValueError: a value is invalid; the message names the key path, the value and the rule.
    """
    if not isinstance(value, Contact):
        table = check.table_of(path, value)
        check.known_keys(path, table, check.names_of(Contact))
        given = check.needed(path, table, "obstacle", "must be a shape, or a table of a shape")
        table["obstacle"] = _shape(f"{path}.obstacle", given, dimension)
        for name in DISPLACEMENTS:
            if isinstance(table.get(name), Mapping):
                with check.under(f"{path}.{name}"):
                    table[name] = function_from_table(check.table_of("", table[name]), directory)
        value = check.made(path, Contact, table, stiffness="must be a positive number (N/m^n)")
    if dimension is not None:
        shape_of(f"{path}.obstacle", value.obstacle, dimension)
        if dimension == 2 and value.displacement_z is not None:
            raise check.InvalidValue(f"{path}.displacement_z", value.displacement_z, "must be left out in the plane")
    return value


def _shape(path: str, value: object, dimension: int | None) -> Shape:
    """Return the shape of a table; if dimension is None, one of its points gives the dimension."""
    if dimension is None and isinstance(value, Mapping):
        points = [value[key] for key in ("point", "center", "start") if isinstance(value.get(key), Sequence)]
        dimension = len(points[0]) if points and len(points[0]) in (2, 3) else 2
    if dimension is None and isinstance(value, Shape):
        return value
    return shape_of(path, value, dimension or 2)


def contacts_of(path: str, value: object, arm: Arm, dimension: int | None = None) -> tuple[Contact, ...]:
    """Return an arm's validated contacts from a contact, a table, or a sequence of contacts and tables.

    The value None means no contacts. dimension: 2 for an arm in the plane, 3 for an arm in space; None if the dimension
    is unknown.

    Raises:
        ValueError: a value is invalid; the message names the key path, the value and the rule.
    """
    if value is None:
        return ()
    one = isinstance(value, Contact | Mapping)
    rows = [value] if one else check.sequence(path, value, "Contact, or tables of them")
    found = tuple(contact_of(f"{path}[{i}]", row, dimension) for i, row in enumerate(rows))
    spheres: dict[tuple[int, float], tuple[int, float]] = {}
    for i, contact in enumerate(found):
        with check.under(f"{path}[{i}]"):
            for point in contact.points(arm):
                first, radius = spheres.setdefault(point, (i, contact.radius))
                if point[1] < 1.0 and radius != contact.radius:
                    what = f"must be {radius:g} (m), as in {path}[{first}], at the same point of link {point[0]}"
                    raise check.InvalidValue("radius", contact.radius, what)
    return found
