"""Cross-sections of a link: one along all of it, linear between points, or a rectangle whose sides taper."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from flexarm_env import curves
from flexarm_env import validation as check
from flexarm_env.curves import Curvature
from flexarm_env.validation import Array


@dataclass(frozen=True)
class Section:
    """Cross-section of a beam, constant along a link (symbols of docs/theory.md; paper [41], [52]).

    Args:
        EI: bending stiffness, N m^2, positive.
        EA: stretching stiffness, N, positive.
        C: shear stiffness kappa G A, N, positive.
        m: mass per length, kg/m, positive.
        J: rotary inertia per length, kg m (rho I for a homogeneous section), zero or positive.
        EI_y, C_y, J_y: the same of bending and shear in the x-z plane; in space alone, where None is refused.
        GJ: torsional stiffness, N m^2, positive (Saint-Venant's constant times G, not the polar moment); likewise.

    A link's x axis runs along it, y along its thickness, z along its width; an arm in the plane bends in x-y. The polar
    rotary inertia is J + J_y.
    """

    EI: float
    EA: float
    C: float
    m: float
    J: float = 0.0
    EI_y: float | None = None
    C_y: float | None = None
    J_y: float | None = None
    GJ: float | None = None

    def __post_init__(self) -> None:
        check.store(
            self,
            EI=check.number("section.EI", self.EI, "N m^2", above=0.0),
            EA=check.number("section.EA", self.EA, "N", above=0.0),
            C=check.number("section.C", self.C, "N", above=0.0),
            m=check.number("section.m", self.m, "kg/m", above=0.0),
            J=check.number("section.J", self.J, "kg m", minimum=0.0),
        )
        for name, unit in ACROSS.items():
            if (value := getattr(self, name)) is not None:
                limit: dict[str, float] = {"minimum": 0.0} if name == "J_y" else {"above": 0.0}
                check.store(self, **{name: check.number(f"section.{name}", value, unit, **limit)})

    @classmethod
    def rectangle(cls, width: float, thickness: float, E: float, rho: float, G: float, kappa: float = 0.85) -> Section:
        """Homogeneous rectangle that bends about its ``width`` axis: I = width thickness^3 / 12.

        Args:
            width: m, across the plane of motion. thickness: m, in the plane of motion.
            E: Young's modulus, Pa. rho: density, kg/m^3. G: shear modulus, Pa. kappa: shear coefficient, 0 to 1.
        """
        width = check.number("section.width", width, "m", above=0.0)
        thickness = check.number("section.thickness", thickness, "m", above=0.0)
        E, rho, G, kappa = _material(E, rho, G, kappa)
        A = width * thickness
        second_moment, across = width * thickness**3 / 12.0, thickness * width**3 / 12.0
        return cls(
            EI=E * second_moment, EA=E * A, C=kappa * G * A, m=rho * A, J=rho * second_moment,
            EI_y=E * across, C_y=kappa * G * A, J_y=rho * across, GJ=G * torsion_constant(width, thickness),
        )  # fmt: skip

    @classmethod
    def circle(cls, diameter: float, E: float, rho: float, G: float, kappa: float = 0.9) -> Section:
        """Homogeneous round bar; diameter: m, the rest as in :meth:`rectangle`."""
        return cls.tube(diameter, check.number("section.diameter", diameter, "m", above=0.0) / 2.0, E, rho, G, kappa)

    @classmethod
    def tube(cls, diameter: float, wall: float, E: float, rho: float, G: float, kappa: float = 0.5) -> Section:
        """Homogeneous round tube; diameter (outer), wall: m, the rest as in :meth:`rectangle`."""
        outer = check.number("section.diameter", diameter, "m", above=0.0)
        wall = check.number("section.wall", wall, "m", above=0.0, maximum=outer / 2.0)
        E, rho, G, kappa = _material(E, rho, G, kappa)
        inner = outer - 2.0 * wall
        A, I = math.pi / 4.0 * (outer**2 - inner**2), math.pi / 64.0 * (outer**4 - inner**4)
        shear = kappa * G * A
        return cls(
            EI=E * I, EA=E * A, C=shear, m=rho * A, J=rho * I, EI_y=E * I, C_y=shear, J_y=rho * I, GJ=2.0 * G * I
        )


ACROSS = {"EI_y": "N m^2", "C_y": "N", "J_y": "kg m", "GJ": "N m^2"}
"""Fields of a section that motion in the plane does not see, and their units."""


def _material(E: float, rho: float, G: float, kappa: float) -> tuple[float, float, float, float]:
    """What a homogeneous section is made of, checked."""
    return (
        check.number("section.E", E, "Pa", above=0.0),
        check.number("section.rho", rho, "kg/m^3", above=0.0),
        check.number("section.G", G, "Pa", above=0.0),
        check.number("section.kappa", kappa, above=0.0, maximum=1.0),
    )


def torsion_constant(width: Any, thickness: Any) -> Any:
    """Saint-Venant's constant of rectangles, m^4, to 1e-9 (numbers or arrays, m; Timoshenko & Goodier, section 109).

    With a >= b: (a b^3 / 3) (1 - (192 b / (pi^5 a)) sum over odd k of tanh(k pi a / (2 b)) / k^5).
    """
    a, b = np.maximum(width, thickness), np.minimum(width, thickness)
    terms = sum(np.tanh(k * math.pi * a / (2.0 * b)) / k**5 for k in range(1, 60, 2))
    found = a * b**3 / 3.0 * (1.0 - 192.0 * b / (math.pi**5 * a) * terms)
    return float(found) if np.ndim(found) == 0 else found


class Properties(NamedTuple):
    """What a :class:`Section` holds, at many places: an array each, in its units."""

    EI: Array
    EA: Array
    C: Array
    m: Array
    J: Array


@dataclass(frozen=True)
class Taper:
    """Homogeneous rectangle whose sides go linearly from a link's root to its tip: EI = E b h^3 / 12 at each place.

    Args:
        widths: m, across the plane of motion, at root and tip. thicknesses: m, in the plane of motion, likewise.
        E: Young's modulus, Pa. rho: density, kg/m^3. G: shear modulus, Pa. kappa: shear coefficient, 0 to 1.
    """

    widths: tuple[float, float]
    thicknesses: tuple[float, float]
    E: float
    rho: float
    G: float
    kappa: float = 0.85

    def __post_init__(self) -> None:
        for name in ("widths", "thicknesses"):
            what = "two positive numbers (m), root and tip"
            sides = check.numbers(f"section.{name}", getattr(self, name), what, 2, "m", above=0.0)
            check.store(self, **{name: sides})
        E, rho, G, kappa = _material(self.E, self.rho, self.G, self.kappa)
        check.store(self, E=E, rho=rho, G=G, kappa=kappa)
        for end in (0.0, 1.0):
            self.rectangle(end)  # which checks EI, EA, C, m and J

    def sides(self, share: Any) -> tuple[Any, Any]:
        """Width and thickness, m, at a share of the length (a number or an array)."""
        (b0, b1), (h0, h1) = self.widths, self.thicknesses
        return b0 + (b1 - b0) * share, h0 + (h1 - h0) * share

    def rectangle(self, share: float) -> Section:
        """The section at a share of the length."""
        return Section.rectangle(*self.sides(share), self.E, self.rho, self.G, self.kappa)

    def along(self, share: Array) -> Properties:
        """The sections at shares of the length."""
        b, h = self.sides(share)
        area, second_moment = b * h, b * h**3 / 12.0
        stretch = self.E * area, self.kappa * self.G * area
        return Properties(self.E * second_moment, *stretch, self.rho * area, self.rho * second_moment)


Points = tuple[tuple[float, Section], ...]
GAUSS = np.polynomial.legendre.leggauss(16)
"""Of each smooth piece of a link: exact for a taper's b h^3 times polynomials of degree 27."""


ENDS = {
    "root_offset": "m", "tip_offset": "m", "root_mass": "kg", "tip_mass": "kg", "root_inertia": "kg m^2",
    "tip_inertia": "kg m^2",
}  # fmt: skip
"""Fields of a link's rigid ends, and their units."""


@dataclass(frozen=True)
class Link:
    """A beam of one section, or of sections that vary along it; straight where it has no curvature of its own.

    Args:
        length: m, positive.
        section: a :class:`Section`; a :class:`Taper`; or a sequence of (s, Section), s in m from the root, from 0 to
            the length in ascending order. Properties are linear between points; two points of the same s are a jump.
            Points that are all alike are one Section.
        tau_d: Kelvin-Voigt time constant of this link, s; None: the arm's.
        root_offset, tip_offset: m, zero or positive, of rigid ends (a clamp, a hub's radius): from the joint at the
            link's root to where the beam begins, and from where it ends to the next joint, or to the arm's tip. They go
            on along the beam's tangents.
        root_mass, tip_mass: kg, of these ends, in the middle of each. root_inertia, tip_inertia: kg m^2, about there.
        curvature: 1/m, which the beam has without stress, positive to the left; or a sequence of (s, curvature), s as
            in `section`, linear between points, two of the same s a jump.
    """

    length: float
    section: Section | Taper | Points
    tau_d: float | None = None
    root_offset: float = 0.0
    tip_offset: float = 0.0
    root_mass: float = 0.0
    tip_mass: float = 0.0
    root_inertia: float = 0.0
    tip_inertia: float = 0.0
    curvature: Curvature = 0.0

    def __post_init__(self) -> None:
        check.store(self, length=check.number("length", self.length, "m", above=0.0))
        if self.tau_d is not None:
            check.store(self, tau_d=check.number("tau_d", self.tau_d, "s", minimum=0.0))
        for name, unit in ENDS.items():
            check.store(self, **{name: check.number(name, getattr(self, name), unit, minimum=0.0)})
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
        """A rectangle whose sides go linearly from root to tip; see :class:`Taper`. Equal ones are one Section.

        more: the other fields of :class:`Link`.
        """
        taper = Taper(widths, thicknesses, E, rho, G, kappa)
        even = taper.sides(0.0) == taper.sides(1.0)
        return cls(length, taper.rectangle(0.0) if even else taper, **more)

    @property
    def rigid(self) -> bool:
        """Whether the link does not bend."""
        return False

    @property
    def uniform(self) -> Section | None:
        """The section of a straight link that has one alone, otherwise None."""
        return self.section if isinstance(self.section, Section) and not self.curved else None

    @property
    def curved(self) -> bool:
        """Whether it has a curvature of its own."""
        return self.curvature != 0.0

    @property
    def turn(self) -> float:
        """Angle of the tangent at the tip from that at the root, without stress, rad."""
        return float(curves.angle(self.curvature, self.length)) if self.curved else 0.0

    def place(self, s: Any) -> Any:
        """Places s (m from the beam's root, below 0 and beyond the length on rigid ends) without stress, as complex
        numbers, m, from the joint at the link's root and its tangent."""
        inner = curves.place(self.curvature, np.clip(s, 0.0, self.length))
        beyond = np.maximum(np.asarray(s) - self.length, 0.0)
        return inner + self.root_offset + np.minimum(s, 0.0) + beyond * np.exp(1j * self.turn)

    @property
    def points(self) -> tuple[float, ...]:
        """Where sections kink or jump, m from the root, the ends among them, each once."""
        inner = () if isinstance(self.section, Section | Taper) else tuple(s for s, _ in self.section[1:-1])
        return tuple(sorted({0.0, *inner, *curves.points(self.curvature), self.length}))

    @property
    def jumps(self) -> tuple[float, ...]:
        """Where sections jump, or the curvature does, m from the root."""
        bends = curves.jumps(self.curvature)
        if isinstance(self.section, Section | Taper):
            return bends
        places = [s for s, _ in self.section]
        return tuple(sorted({*bends, *(s for s, after in pairwise(places) if s == after)}))

    def along(self, s: Array | float, before: bool = False) -> Properties:
        """Properties at places s (m from the root); at a jump those behind it, or `before` it."""
        s = np.asarray(s, np.float64)
        if isinstance(self.section, Taper):
            return self.section.along(s / self.length)
        if isinstance(self.section, Section):
            return Properties(*(np.full(s.shape, getattr(self.section, name)) for name in Properties._fields))
        places = np.array([place for place, _ in self.section])
        i, share = curves.between(places, s, before)
        columns = [np.array([getattr(section, name) for _, section in self.section]) for name in Properties._fields]
        return Properties(*(column[i] + (column[i + 1] - column[i]) * share for column in columns))

    def across(self, s: Array) -> dict[str, Array]:
        """`ACROSS` at places s, m from the root; ValueError where a section has None of one."""
        if isinstance(self.section, Taper):
            b, h = self.section.sides(s / self.length)
            second_moment, shear = h * b**3 / 12.0, self.section.kappa * self.section.G * b * h
            torsion = self.section.G * torsion_constant(b, h)
            bending, rotary = self.section.E * second_moment, self.section.rho * second_moment
            return {"EI_y": bending, "C_y": shear, "J_y": rotary, "GJ": torsion}
        points = ((0.0, self.section),) if isinstance(self.section, Section) else self.section
        for name, unit in ACROSS.items():
            if any(getattr(section, name) is None for _, section in points):
                what = f"must be given ({unit}): the arm bends and twists in space"
                raise check.InvalidValue(f"section.{name}", None, what)
        places = np.array([place for place, _ in points])
        return {name: np.interp(s, places, [getattr(section, name) for _, section in points]) for name in ACROSS}

    def quadrature(self) -> tuple[Array, Array]:
        """Gauss points and weights, m, on each smooth piece."""
        x, weights = GAUSS
        ends = np.array(self.points)
        half = 0.5 * np.diff(ends)[:, None]
        return (ends[:-1, None] + half * (1.0 + x)).ravel(), (half * weights).ravel()

    def part(self, first: float, last: float) -> Link:
        """The beam between two places, m from the root."""
        own: dict[str, Any] = {"curvature": curves.part(self.curvature, first, last)}
        if isinstance(self.section, Section):
            return Link(last - first, self.section, **own)
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
        """Ends of n pieces, (n + 1,) in m: even ones, or as even as may be with an end at each jump.

        Raises ValueError, which names the `option` that gave n, where n is too few for the jumps.
        """
        ends = np.array([0.0, *self.jumps, self.length])
        if n < len(ends) - 1:
            what = f"must be at least {len(ends) - 1} for a link whose sections jump {len(ends) - 2} times"
            raise check.InvalidValue(option, n, what)
        spans, counts = np.diff(ends), np.ones(len(ends) - 1, np.int64)
        for _ in range(n - len(counts)):
            counts[np.argmax(spans / counts)] += 1
        pieces = [np.linspace(a, b, k, endpoint=False) for a, b, k in zip(ends[:-1], ends[1:], counts, strict=True)]
        return np.concatenate([*pieces, ends[-1:]])

    def cut(self, n: int, option: str) -> list[Link]:
        """The n pieces of :meth:`mesh`."""
        if isinstance(self.section, Section) and not self.curved:
            return [Link(self.length / n, self.section)] * n
        ends = self.mesh(n, option)
        return [self.part(a, b) for a, b in zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True)]

    @property
    def rigid_ends(self) -> bool:
        """Whether the link has any."""
        return any(getattr(self, name) for name in ENDS)

    @property
    def span(self) -> float:
        """From joint to joint, the beam and its rigid ends, m."""
        return self.root_offset + self.length + self.tip_offset

    @property
    def far(self) -> complex:
        """Where the next joint is without stress, m, from that at the link's root and the tangent there."""
        return complex(self.place(self.length + self.tip_offset)) if self.curved else self.span

    @property
    def ends(self) -> tuple[tuple[float, float, float], ...]:
        """Of both rigid ends: mass (kg), distance of its centre from the joint at the link's root (m), inertia."""
        root = self.root_mass, 0.5 * self.root_offset, self.root_inertia
        return root, (self.tip_mass, self.span - 0.5 * self.tip_offset, self.tip_inertia)

    def integral(self, what: str, power: int = 0) -> float:
        """int `what` s^power ds along the beam from its root; `what`: a field of :class:`Section`."""
        if isinstance(self.section, Section):
            return float(getattr(self.section, what) * self.length ** (power + 1) / (power + 1))
        s, weights = self.quadrature()
        return float(weights @ (getattr(self.along(s), what) * s**power))

    @property
    def mass(self) -> float:
        """Mass of the beam, kg, without rigid ends."""
        return self.integral("m")

    def moment(self, power: int) -> float:
        """int m s^power ds from the root, kg m^power."""
        return self.integral("m", power)

    @property
    def rotary(self) -> float:
        """int J ds, kg m^2."""
        return self.integral("J")

    def series(self, what: str) -> float:
        """The stiffness `what` of springs in series: length over int ds / stiffness."""
        if isinstance(self.section, Section):
            return float(getattr(self.section, what))
        s, weights = self.quadrature()
        return self.length / float(weights @ (1.0 / getattr(self.along(s), what)))

    @property
    def mean(self) -> Section:
        """The section, or the mean of what vary."""
        if isinstance(self.section, Section):
            return self.section
        return Section(*(self.integral(name) / self.length for name in Properties._fields))

    @property
    def slenderness(self) -> float:
        """EI / (C L^2): how much shear counts beside bending; the elastica leaves it out (about 1e-3 is stubby).

        Of sections that vary it is their mean.
        """
        return self.mean.EI / (self.mean.C * self.length**2)


def _points(value: object, length: float) -> Section | Points:
    """Points of sections, checked; one Section where all are alike."""
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
