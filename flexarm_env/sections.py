"""Flexible links and their cross-sections: constant, linear between points, or tapered rectangles."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from flexarm_env import curves, meshing
from flexarm_env import validation as check
from flexarm_env.curves import Curvature
from flexarm_env.records import described, number, validate, value
from flexarm_env.validation import Array


def _across(text: str, unit: str, **bounds: float) -> Any:
    """Declare a property that only motion out of the x-y plane needs."""
    return number(f"{text}; required in space", unit, None, optional=True, **(bounds or {"above": 0.0}))


@described
@dataclass(frozen=True)
class Section:
    """Cross-section of a beam: stiffness, mass and rotary inertia per length (Meek & Liu 1995, eqs. [41], [52]).

    The x axis of a link points along the link, the y axis along its thickness and the z axis along its width. An arm in
    the plane bends in the x-y plane. The rotary inertia per length about the x axis is J + J_y.
    """

    EI: float = number("bending stiffness", "N m^2", above=0.0)
    EA: float = number("axial stiffness", "N", above=0.0)
    C: float = number("shear stiffness kappa G A", "N", above=0.0)
    m: float = number("mass per length", "kg/m", above=0.0)
    J: float = number("rotary inertia per length, rho I for a homogeneous section", "kg m", 0.0, minimum=0.0)
    EI_y: float | None = _across("bending stiffness in the x-z plane", "N m^2")
    C_y: float | None = _across("shear stiffness in the x-z plane", "N")
    J_y: float | None = _across("rotary inertia per length in the x-z plane", "kg m", minimum=0.0)
    GJ: float | None = _across("torsional stiffness, G times Saint-Venant's constant, not the polar moment", "N m^2")

    def __post_init__(self) -> None:
        """Validate the fields and convert them to plain numbers; an `InvalidValue` names the field."""
        validate(self, "section")

    @classmethod
    def rectangle(cls, width: float, thickness: float, E: float, rho: float, G: float, kappa: float = 0.85) -> Section:
        """Create a homogeneous rectangular section with the second moment of area width thickness^3 / 12.

        Args:
            width: width normal to the plane of motion, m. thickness: thickness in the plane of motion, m.
            E: Young's modulus, Pa. rho: density, kg/m^3. G: shear modulus, Pa. kappa: shear coefficient, 0 to 1.
        """
        width = check.number("section.width", width, "m", above=0.0)
        thickness = check.number("section.thickness", thickness, "m", above=0.0)
        E, rho, G, kappa = _material(E, rho, G, kappa)
        A = width * thickness
        # I about the width axis, and about the thickness axis for bending in x-z
        second_moment, across = width * thickness**3 / 12.0, thickness * width**3 / 12.0
        return cls(
            EI=E * second_moment, EA=E * A, C=kappa * G * A, m=rho * A, J=rho * second_moment,
            EI_y=E * across, C_y=kappa * G * A, J_y=rho * across, GJ=G * torsion_constant(width, thickness),
        )  # fmt: skip

    @classmethod
    def circle(cls, diameter: float, E: float, rho: float, G: float, kappa: float = 0.9) -> Section:
        """Create a homogeneous circular section.

        diameter: diameter, m. The other arguments are those of :meth:`rectangle`.
        """
        return cls.tube(diameter, check.number("section.diameter", diameter, "m", above=0.0) / 2.0, E, rho, G, kappa)

    @classmethod
    def tube(cls, diameter: float, wall: float, E: float, rho: float, G: float, kappa: float = 0.5) -> Section:
        """Create the homogeneous section of a round tube.

        diameter: outer diameter, m. wall: thickness of the wall, m. The other arguments are those of :meth:`rectangle`.
        """
        outer = check.number("section.diameter", diameter, "m", above=0.0)
        wall = check.number("section.wall", wall, "m", above=0.0, maximum=outer / 2.0)
        E, rho, G, kappa = _material(E, rho, G, kappa)
        inner = outer - 2.0 * wall
        # I = pi (D^4 - d^4) / 64; the torsion constant of a circular section is 2 I
        A, I = math.pi / 4.0 * (outer**2 - inner**2), math.pi / 64.0 * (outer**4 - inner**4)
        shear = kappa * G * A
        return cls(
            EI=E * I, EA=E * A, C=shear, m=rho * A, J=rho * I, EI_y=E * I, C_y=shear, J_y=rho * I, GJ=2.0 * G * I
        )


ACROSS = {"EI_y": "N m^2", "C_y": "N", "J_y": "kg m", "GJ": "N m^2"}
"""Names of a section's fields for motion out of the x-y plane, with units."""


def _material(E: float, rho: float, G: float, kappa: float) -> tuple[float, float, float, float]:
    """Validate E (Pa), rho (kg/m^3), G (Pa) and the shear coefficient kappa of a homogeneous section."""
    return (
        check.number("section.E", E, "Pa", above=0.0),
        check.number("section.rho", rho, "kg/m^3", above=0.0),
        check.number("section.G", G, "Pa", above=0.0),
        check.number("section.kappa", kappa, above=0.0, maximum=1.0),
    )


def torsion_constant(width: Any, thickness: Any) -> Any:
    """Return Saint-Venant's torsion constant of rectangles, m^4 (Timoshenko & Goodier, section 109).

    The side lengths are numbers or arrays, m. For sides a >= b the constant is
    (a b^3 / 3) (1 - (192 b / (pi^5 a)) sum over odd k of tanh(k pi a / (2 b)) / k^5).
    The relative error of the truncated sum is at most 2e-8.
    """
    a, b = np.maximum(width, thickness), np.minimum(width, thickness)
    # first 30 terms, odd k up to 59
    terms = sum(np.tanh(k * math.pi * a / (2.0 * b)) / k**5 for k in range(1, 60, 2))
    found = a * b**3 / 3.0 * (1.0 - 192.0 * b / (math.pi**5 * a) * terms)
    return float(found) if np.ndim(found) == 0 else found


class Properties(NamedTuple):
    """Properties of a link's sections at several positions: one array for each field of :class:`Section`."""

    EI: Array
    EA: Array
    C: Array
    m: Array
    J: Array


@dataclass(frozen=True)
class Taper:
    """Homogeneous rectangular section whose width b and thickness h vary linearly from a link's root to its tip.

    Args:
        widths: widths at root and tip, normal to the plane of motion, m. thicknesses: thicknesses at root and tip, in
            the plane of motion, m.
        E: Young's modulus, Pa. rho: density, kg/m^3. G: shear modulus, Pa. kappa: shear coefficient, 0 to 1.
    """

    widths: tuple[float, float]
    thicknesses: tuple[float, float]
    E: float
    rho: float
    G: float
    kappa: float = 0.85

    def __post_init__(self) -> None:
        """Validate sides and material, then the section at both ends."""
        for name in ("widths", "thicknesses"):
            what = "two positive numbers (m), root and tip"
            sides = check.numbers(f"section.{name}", getattr(self, name), what, 2, "m", above=0.0)
            check.store(self, **{name: sides})
        E, rho, G, kappa = _material(self.E, self.rho, self.G, self.kappa)
        check.store(self, E=E, rho=rho, G=G, kappa=kappa)
        for end in (0.0, 1.0):
            # validates EI, EA, C, m and J
            self.rectangle(end)

    def sides(self, share: Any) -> tuple[Any, Any]:
        """Return width and thickness, m, at `share`, a fraction (number or array) of the link's length."""
        (b0, b1), (h0, h1) = self.widths, self.thicknesses
        return b0 + (b1 - b0) * share, h0 + (h1 - h0) * share

    def rectangle(self, share: float) -> Section:
        """Return the section at `share`, the distance from the root divided by the link's length."""
        return Section.rectangle(*self.sides(share), self.E, self.rho, self.G, self.kappa)

    def along(self, share: Array) -> Properties:
        """Return the sections' properties at `share` (n,), distances from the root divided by the link's length."""
        # EI = E b h^3 / 12, EA = E b h, C = kappa G b h
        b, h = self.sides(share)
        area, second_moment = b * h, b * h**3 / 12.0
        stretch = self.E * area, self.kappa * self.G * area
        return Properties(self.E * second_moment, *stretch, self.rho * area, self.rho * second_moment)


Points = tuple[tuple[float, Section], ...]
GAUSS = np.polynomial.legendre.leggauss(16)
"""Gauss points and weights on [-1, 1] for a smooth piece. They are exact for b h^3 of a taper times a polynomial of
degree 27.
"""


ENDS = {
    "root_offset": "m", "tip_offset": "m", "root_mass": "kg", "tip_mass": "kg", "root_inertia": "kg m^2",
    "tip_inertia": "kg m^2",
}  # fmt: skip
"""Names of the fields for a link's rigid ends, with units."""


@described
@dataclass(frozen=True)
class Link:
    """Flexible link: a beam, straight or curved when free of stress, with optional rigid ends.

    The rigid end at the root extends from the joint to the beam, for example through a clamp or a hub. The rigid end at
    the tip extends from the beam to the next joint or to the arm's tip. Rigid ends are straight, along the beam's end
    tangents. The mass of a rigid end is concentrated at its midpoint.

    Args:
        section: a :class:`Section`, a :class:`Taper`, or a sequence of pairs (s, Section). s is the arc length from the
            beam's root, m, and increases from 0 to the length. Properties are linear between two pairs; two pairs with
            equal s define a jump. One Section replaces a sequence of equal sections.
        curvature: curvature of the stress-free beam, 1/m, positive if the beam turns left; or a sequence of pairs (s,
            curvature). The curvature is linear between two pairs; two pairs with equal s define a jump.
    """

    length: float = number("length of the beam", "m", above=0.0)
    section: Section | Taper | Points = value(lambda path, given: given, {}, "section, or sections along the link")
    tau_d: float | None = number(
        "Kelvin-Voigt time constant of this link; None: the arm's", "s", None, minimum=0.0, optional=True
    )
    root_offset: float = number("length of the rigid end at the root", "m", 0.0, minimum=0.0)
    tip_offset: float = number("length of the rigid end at the tip", "m", 0.0, minimum=0.0)
    root_mass: float = number("mass of the rigid end at the root", "kg", 0.0, minimum=0.0)
    tip_mass: float = number("mass of the rigid end at the tip", "kg", 0.0, minimum=0.0)
    root_inertia: float = number("inertia of the root's rigid end about its midpoint", "kg m^2", 0.0, minimum=0.0)
    tip_inertia: float = number("inertia of the tip's rigid end about its midpoint", "kg m^2", 0.0, minimum=0.0)
    curvature: Curvature = 0.0

    def __post_init__(self) -> None:
        """Validate the fields. section: a `Section`, a `Taper`, or points along the link."""
        validate(self)
        check.store(self, curvature=curves.checked(self.curvature, self.length))
        if not isinstance(self.section, Section | Taper):
            check.store(self, section=_points(self.section, self.length))

    @classmethod
    def tapered(
        cls,
        length: float,
        widths: tuple[float, float],
        thicknesses: tuple[float, float],
        *,
        E: float,
        rho: float,
        G: float,
        kappa: float = 0.85,
        **more: Any,
    ) -> Link:
        """Create a link with a rectangular section whose sides vary linearly from root to tip (:class:`Taper`).
        more: further fields of :class:`Link`.
        """
        taper = Taper(widths, thicknesses, E, rho, G, kappa)
        even = taper.sides(0.0) == taper.sides(1.0)
        return cls(length, taper.rectangle(0.0) if even else taper, **more)

    @property
    def rigid(self) -> bool:
        """False: the link is flexible."""
        return False

    @property
    def uniform(self) -> Section | None:
        """Section of a straight link with constant section; None for any other link."""
        return self.section if isinstance(self.section, Section) and not self.curved else None

    @property
    def curved(self) -> bool:
        """True if the link is curved when it is free of stress."""
        return self.curvature != 0.0

    @property
    def turn(self) -> float:
        """Angle from the tangent at the root to the tangent at the tip of the stress-free link, rad."""
        return float(curves.angle(self.curvature, self.length)) if self.curved else 0.0

    def place(self, s: Any) -> Any:
        """Return points of the stress-free link, x + iy, m, relative to the root joint, with x along the tangent there.

        s: arc lengths from the beam's root, m; below 0 and above the length the points are on the rigid ends.
        """
        # beam, then straight rigid ends along its end tangents
        inner = curves.place(self.curvature, np.clip(s, 0.0, self.length))
        beyond = np.maximum(np.asarray(s) - self.length, 0.0)
        return inner + self.root_offset + np.minimum(s, 0.0) + beyond * np.exp(1j * self.turn)

    @property
    def points(self) -> tuple[float, ...]:
        """Positions, m from the root, of the beam's two ends and of all jumps and kinks of section and curvature."""
        inner = () if isinstance(self.section, Section | Taper) else tuple(s for s, _ in self.section[1:-1])
        return tuple(sorted({0.0, *inner, *curves.points(self.curvature), self.length}))

    @property
    def jumps(self) -> tuple[float, ...]:
        """Positions at which sections or the curvature jump, m from the root."""
        bends = curves.jumps(self.curvature)
        if isinstance(self.section, Section | Taper):
            return bends
        # a jump: two points with the same s
        places = [s for s, _ in self.section]
        return tuple(sorted({*bends, *(s for s, after in pairwise(places) if s == after)}))

    @property
    def breaks(self) -> tuple[float, ...]:
        """Positions, m from the root, at which mesh cells must end: `points` except where only curvature has a kink."""
        inner = () if isinstance(self.section, Section | Taper) else (s for s, _ in self.section[1:-1])
        return tuple(sorted({0.0, *inner, *curves.jumps(self.curvature), self.length}))

    def along(self, s: Array | float, before: bool = False) -> Properties:
        """Return the properties of the sections at positions s, m from the root.

        At a jump the result is the properties after the jump or, with `before`, the properties before the jump.
        """
        s = np.asarray(s, np.float64)
        if isinstance(self.section, Taper):
            return self.section.along(s / self.length)
        if isinstance(self.section, Section):
            return Properties(*(np.full(s.shape, getattr(self.section, name)) for name in Properties._fields))
        places = np.array([place for place, _ in self.section])
        # linear between the points, each property by itself
        i, share = curves.between(places, s, before)
        columns = [np.array([getattr(section, name) for _, section in self.section]) for name in Properties._fields]
        return Properties(*(column[i] + (column[i + 1] - column[i]) * share for column in columns))

    def across(self, s: Array) -> dict[str, Array]:
        """Return EI_y, C_y, J_y and GJ at positions s, m from the root; raise ValueError if a section lacks a value."""
        if isinstance(self.section, Taper):
            # bending about the other axis: h b^3 / 12
            b, h = self.section.sides(s / self.length)
            second_moment, shear = h * b**3 / 12.0, self.section.kappa * self.section.G * b * h
            torsion = self.section.G * torsion_constant(b, h)
            bending, rotary = self.section.E * second_moment, self.section.rho * second_moment
            return {"EI_y": bending, "C_y": shear, "J_y": rotary, "GJ": torsion}
        # points: linear interpolation; every point needs all properties
        points = ((0.0, self.section),) if isinstance(self.section, Section) else self.section
        for name, unit in ACROSS.items():
            if any(getattr(section, name) is None for _, section in points):
                what = f"must be given ({unit}): the arm bends and twists in space"
                raise check.InvalidValue(f"section.{name}", None, what)
        places = np.array([place for place, _ in points])
        return {name: np.interp(s, places, [getattr(section, name) for _, section in points]) for name in ACROSS}

    def quadrature(self) -> tuple[Array, Array]:
        """Return Gauss points (m from the root) and weights (m) of all intervals between jumps or kinks."""
        x, weights = GAUSS
        ends = np.array(self.points)
        # map [-1, 1] to each piece
        half = 0.5 * np.diff(ends)[:, None]
        return (ends[:-1, None] + half * (1.0 + x)).ravel(), (half * weights).ravel()

    def part(self, first: float, last: float) -> Link:
        """Return the part of the beam between two positions, m from the root, as a link without rigid ends."""
        own: dict[str, Any] = {"curvature": curves.part(self.curvature, first, last)}
        if isinstance(self.section, Section):
            return Link(last - first, self.section, **own)
        # a part of a taper is a taper; other sections are interpolated at both ends
        if isinstance(self.section, Taper):
            ends = [self.section.sides(s / self.length) for s in (first, last)]
            material = self.section.E, self.section.rho, self.section.G, self.section.kappa
            sides = tuple((float(a), float(b)) for a, b in zip(*ends, strict=True))
            return Link(last - first, Taper(sides[0], sides[1], *material), **own)
        length = last - first
        inner = [(s - first, section) for s, section in self.section if first < s < last]
        ends_at = [Section(*map(float, self.along(s, end))) for s, end in ((first, False), (last, True))]
        return Link(length, ((0.0, ends_at[0]), *inner, (length, ends_at[1])), **own)

    def mesh(self, n: int, option: str) -> Array:
        """Return the boundaries (n + 1,), m, of n cells: equally spaced, or placed at jumps and kinks (`meshing`).

        Raises ValueError if n is too small for the jumps; the message names `option`, the solver option with value n.
        """
        return meshing.ends(self, n, option)

    def cut(self, n: int, option: str) -> list[Link]:
        """Return the n cells of :meth:`mesh` as links."""
        if isinstance(self.section, Section) and not self.curved:
            return [Link(self.length / n, self.section)] * n
        ends = self.mesh(n, option)
        return [self.part(a, b) for a, b in zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True)]

    @property
    def rigid_ends(self) -> bool:
        """True if a rigid end of the link has a length or a mass."""
        return any(getattr(self, name) for name in ENDS)

    @property
    def span(self) -> float:
        """Length of beam and rigid ends, m."""
        return self.root_offset + self.length + self.tip_offset

    @property
    def far(self) -> complex:
        """Position of the stress-free link's far end, x + i y, m, in the axes of :meth:`place`."""
        return complex(self.place(self.length + self.tip_offset)) if self.curved else self.span

    @property
    def ends(self) -> tuple[tuple[float, float, float], ...]:
        """Rigid ends at root and tip: mass, kg; distance of the midpoint from the root joint, m; inertia, kg m^2."""
        root = self.root_mass, 0.5 * self.root_offset, self.root_inertia
        return root, (self.tip_mass, self.span - 0.5 * self.tip_offset, self.tip_inertia)

    def integral(self, what: str, power: int = 0) -> float:
        """Integrate the property `what`, a field of :class:`Section`, times s^power over the beam's arc length s."""
        if isinstance(self.section, Section):
            return float(getattr(self.section, what) * self.length ** (power + 1) / (power + 1))
        s, weights = self.quadrature()
        return float(weights @ (getattr(self.along(s), what) * s**power))

    @property
    def mass(self) -> float:
        """Mass of the beam, kg, without rigid ends."""
        return self.integral("m")

    def moment(self, power: int) -> float:
        """Return the integral of m s^power over the arc length s of the beam, kg m^power."""
        return self.integral("m", power)

    @property
    def rotary(self) -> float:
        """Rotary inertia of the beam, the integral of J ds, kg m^2."""
        return self.integral("J")

    def series(self, what: str) -> float:
        """Return the harmonic mean along the beam of the stiffness `what`, a field of :class:`Section`."""
        if isinstance(self.section, Section):
            return float(getattr(self.section, what))
        s, weights = self.quadrature()
        return self.length / float(weights @ (1.0 / getattr(self.along(s), what)))

    @property
    def mean(self) -> Section:
        """Section of the link; if the section varies, a section with its mean properties."""
        if isinstance(self.section, Section):
            return self.section
        return Section(*(self.integral(name) / self.length for name in Properties._fields))

    @property
    def slenderness(self) -> float:
        """Ratio of shear flexibility to bending flexibility, EI / (C L^2), of the mean section.

        For stubby links the ratio is at least 1e-3.
        """
        return self.mean.EI / (self.mean.C * self.length**2)


def _points(value: object, length: float) -> Section | Points:
    """Validate points (s, Section) of a link; return one Section if all are equal."""
    what = "must be a Section, a Taper or a sequence of two or more (s, Section)"
    if not isinstance(value, list | tuple) or len(value) < 2:
        raise check.InvalidValue("section", value, what)
    found: list[tuple[float, Section]] = []
    for i, entry in enumerate(value):
        s, section = check.sequence(f"section[{i}]", entry, "s (m) and a Section", 2)
        place = check.number(f"section[{i}].s", s, "m", minimum=0.0)
        found.append((place, check.instance(f"section[{i}].section", section, Section)))
    found[-1] = curves.check_places("section[{}].s", [s for s, _ in found], length), found[-1][1]
    return found[0][1] if all(section == found[0][1] for _, section in found) else tuple(found)
