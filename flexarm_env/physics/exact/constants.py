"""Constants of an element for its traced functions; the calls are the same for one section and for varying sections.

`section` is a `layout.Section` or a `layout.Varying`, or the symbolic form of one of them while a kernel is traced.
Each class has the same fields as its symbolic form. `hasattr` selects the class at compile time. The functions of this
module are not compiled; the products that they return are compiled. The polynomial order p equals the number of Gauss
points.
"""

from typing import Any

from ..materials import BENDING, NORMAL_AND_SHEAR
from .layout import VARYING, T
from .tables import Tables


def _own(section: Any, p: int) -> list[list[Any]]:
    """Return one list per Gauss point: further constants of the material laws `NORMAL_AND_SHEAR`, then of `BENDING`."""
    count = len(NORMAL_AND_SHEAR) + len(BENDING)
    if hasattr(section, "own"):
        return [[section.own[i] for i in range(count)]] * p
    first = VARYING.offsets(0, p).own
    return [[section.numbers[first + count * g + i] for i in range(count)] for g in range(p)]


def materials(section: Any, p: int) -> list[tuple[Any, Any, list[Any]]]:
    """Return for each Gauss point EA_2l and C_2l (N/m), and further constants of the laws of N and Q (list)."""
    own = [row[: len(NORMAL_AND_SHEAR)] for row in _own(section, p)]
    if hasattr(section, "EA_2l"):
        return [(section.EA_2l, section.C_2l, row) for row in own]
    at, numbers = VARYING.offsets(0, p), section.numbers
    return [(numbers[at.EA_2l + g], numbers[at.C_2l + g], row) for g, row in enumerate(own)]


def bending_at(section: Any, p: int) -> list[tuple[Any, list[Any]]]:
    """Return for each Gauss point EI_2l (N m), and the other constants of the bending law M(kappa) (list)."""
    own = [row[len(NORMAL_AND_SHEAR) :] for row in _own(section, p)]
    if hasattr(section, "EI_2l"):
        return [(section.EI_2l, row) for row in own]
    first = VARYING.offsets(0, p).EI_2l
    return [(section.numbers[first + g] * section.factor, row) for g, row in enumerate(own)]


def length_of(section: Any) -> Any:
    """Return the length l of the element, m."""
    return section.length if hasattr(section, "length") else section.numbers[0]


def _row(section: Any, first: int, n: int, width: int) -> list[Any]:
    """Return row n of a matrix of a `VARYING` record; the matrix begins at offset `first` and has `width` columns."""
    return [section.numbers[first + width * n + k] for k in range(width)]


def dot(row: list[Any], values: list[Any]) -> Any:
    """Return the inner product of a row of constants and a list of values."""
    total = values[0] * row[0]
    for factor, value in zip(row[1:], values[1:], strict=True):
        total = total + value * factor
    return total


def moments_of(section: Any, t: Tables, bent: list[Any]) -> list[Any]:
    """Return bending moments K b (N m) conjugate to b = (psi_right - psi_left, interior psi ...), argument `bent`."""
    # one section: K is diagonal, EI_2l norm_i
    if hasattr(section, "EI_2l"):
        return [x * (section.EI_2l * float(norm)) for x, norm in zip(bent, t.norm, strict=True)]
    p = len(bent)
    first = VARYING.offsets(0, p).K_EI
    return [dot(_row(section, first, n, p), bent) * section.factor for n in range(p)]


def unbent(section: Any, bent: list[Any]) -> list[Any]:
    """Return bent = (psi_right - psi_left, interior psi ...), rad, minus its stress-free value."""
    rest = getattr(section, "rest", None)
    return bent if rest is None else [x - rest[k] for k, x in enumerate(bent)]


def inertia_row(section: Any, p: int, axis: int, n: int) -> list[Any]:
    """Return row n of the mass matrix of an element with varying section, for axis X or Y (kg) or T (kg m^2)."""
    at = VARYING.offsets(0, p)
    return _row(section, at.rotary if axis == T else at.mass, n, p + 1)


def bending_entries(section: Any, t: Tables, share: Any) -> Any:
    """Return a function (node, node) -> entry of the bending stiffness (N m) times share; None stands for 0.

    Nodes 0 and 1 are the left and right vertex, whose shape functions have opposite slopes. Nodes from 2 on are
    interior.
    share: factor on the stiffness, composed of the weights of stiffness K and damping C.
    """
    p = len(t.weights)
    if hasattr(section, "EI_2l"):
        EI_2l = section.EI_2l * share

        def entry(n1: int, n2: int) -> Any:
            one, two = (-t.slope[0] if n == 0 else t.slope[max(n - 1, 0)] for n in (n1, n2))
            bend = float((t.weights * one * two).sum())
            return None if abs(bend) < 1e-13 else EI_2l * bend

        return entry
    # varying sections: K of (right - left, interior ...) is full; psi_l and psi_r share its first row with opposite
    # signs
    first, factor = VARYING.offsets(0, p).K_EI, section.factor * share

    def own(n1: int, n2: int) -> Any:
        value = factor * section.numbers[first + p * max(n1 - 1, 0) + max(n2 - 1, 0)]
        return -value if (n1 == 0) != (n2 == 0) else value

    return own


def inertia_entries(section: Any, t: Tables, weight: Any) -> Any:
    """Return a function (node, node, axis) -> entry of the element's mass matrix times weight; None stands for 0."""
    if hasattr(section, "ml"):
        cml, cjl = section.ml * weight, section.jl * weight

        def entry(n1: int, n2: int, axis: int) -> Any:
            mass = float(t.mass[n1, n2])
            return (cjl if axis == T else cml) * mass if mass else None

        return entry
    return lambda n1, n2, axis: inertia_row(section, len(t.weights), axis, n1)[n2] * weight
