"""Assemble the Model of a planar scene with geometrically exact beams (Simo & Vu-Quoc 1986; theory, section 5).

The strains Gamma_1 = cos psi x' + sin psi y' - 1, Gamma_2 = -sin psi x' + cos psi y', kappa = psi' have the energy 1/2
(EA Gamma_1^2 + C Gamma_2^2 + EI kappa^2) per length. An element has polynomial order p. The energy is integrated by
(reduced) Gauss quadrature with p points, the consistent mass with p + 1 points. The mass matrix is constant.
Coordinates are in inertial axes, so there are no quadratic-velocity terms.
"""

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from ... import curves
from ... import validation as check
from ...parameters import Arm, Link, Section
from ...scene import InnerLoad, PointLoad, Scene
from ...sections import Properties
from ...settings import Settings
from ..layout import OF_LOAD
from ..linalg import product, solve
from ..materials import BENDING, NORMAL_AND_SHEAR
from ..model import BEAM, ExactBeam, System, damped, fixed_rows, levers
from ..protocol import NewtonPolicy
from .layout import AXES, CHAIN, ELBOW, FACTORS, LEVER_FACTORS, LEVERS, SECTION, VARYING, T, X, Y
from .tables import functions, tables

Array = NDArray[np.float64]

HONOURS = {**BEAM, Section: (*BEAM[Section], *NORMAL_AND_SHEAR, *BENDING)}
"""Fields of an arm's dataclasses that the exact beam models; `assembly` rejects an arm that sets other fields."""

LEAST_ROTARY = 1e-8
"""Lower bound of a section's rotary inertia J, as a fraction of m l^2 with the element's length l. With J = 0 the mass
matrix would be singular."""


def sections(arm: Arm, elements: int, order: int) -> Array:
    """Return the packed constants of elements: one `SECTION` per link, or `VARYING` per element if sections vary."""
    if varies(arm):
        return np.concatenate([_varying(part, order) for link in arm.links for part in link.cut(elements, "elements")])
    rows = []
    for link in arm.links:
        # h = l / 2: weights of Gauss points on [-1, 1] become lengths, and d/dx = (d/dxi) / h
        h, s = 0.5 * link.length / elements, link.mean
        J = max(s.J, LEAST_ROTARY * s.m * (2.0 * h) ** 2)
        stiffness = {"EA_2l": 0.25 * s.EA / h, "C_2l": 0.25 * s.C / h, "EI_2l": 0.25 * s.EI / h}
        rows.append(SECTION.pack({}, **stiffness, length=2.0 * h, ml=s.m * h, jl=J * h, own=_own(s)))
    return np.concatenate(rows)


def varies(arm: Arm) -> bool:
    """Return whether the cross-section varies along at least one link of the arm."""
    return any(link.uniform is None for link in arm.links)


def _varying(part: Link, order: int) -> Array:
    """Pack one element's `VARYING`: stretch and shear at (reduced) Gauss points, exact integrals for all other terms.

    part: the element, as a link of length l.
    """
    # EA, C at the p Gauss points, which integrate strains with reduced order; EI, m, J by a quadrature that is exact
    l = part.length
    points = part.along(0.5 * l * (1.0 + legendre.leggauss(order)[0]))
    s, weights = part.quadrature()
    fine, (value, slope) = part.along(s), functions(order, 2.0 * s / l - 1.0)
    J = np.maximum(fine.J, LEAST_ROTARY * fine.m * l**2)
    return VARYING.pack(
        {"order": order}, length=l, EA_2l=0.5 * points.EA / l, C_2l=0.5 * points.C / l,
        K_EI=product(slope * (fine.EI * weights), slope.T) / l**2, mass=product(value * (fine.m * weights), value.T),
        rotary=product(value * (J * weights), value.T), EI_2l=0.5 * points.EI / l, own=_own(points),
    )  # fmt: skip


def _own(sections: Section | Properties) -> Array:
    """Return the further constants of the material laws NORMAL_AND_SHEAR and BENDING, one row per section."""
    return np.array([getattr(sections, name) for name in (*NORMAL_AND_SHEAR, *BENDING)]).T


def _bent(arm: Arm) -> bool:
    """Return whether at least one link of the arm is curved without stress."""
    return any(link.curved for link in arm.links)


def rest(arm: Arm, elements: int, order: int) -> list[Array]:
    """Return each link's stress-free values (right - left, interior ...) of the angle psi: (elements, order), rad.

    The values of psi minimize 1/2 int EI (psi' - kappa_0)^2 ds with the link's curvature kappa_0 (1/m).
    """
    found = []
    for link in arm.links:
        rows = []
        for start, part in _placed(link, elements):
            # normal equations of the element: (int EI g g^T) b = int EI kappa_0 g, psi' = g . b
            s, weights = part.quadrature()
            slope = functions(order, 2.0 * s / part.length - 1.0)[1] / part.length
            EI = weights * part.along(s).EI
            pull = product(slope, EI * curves.along(link.curvature, start + s))
            rows.append(solve(product(slope * EI, slope.T), pull))
        found.append(np.array(rows))
    return found


def _placed(link: Link, elements: int) -> list[tuple[float, Link]]:
    """Return a pair for each element of a link: distance of its start from the link's root (m), element as a `Link`."""
    parts = link.cut(elements, "elements")
    starts = np.cumsum([0.0] + [part.length for part in parts[:-1]])
    return list(zip(starts.tolist(), parts, strict=True))


def elbows(arm: Arm) -> Array:
    """Pack one `ELBOW` for each link but the first: mass (kg) and rotary inertias (kg m^2) of the elbow at its root."""
    found = [arm.elbow(k) for k in range(1, arm.n_links)]
    packed = [ELBOW.pack({}, mass=e.mass, left=e.inertia_left, right=e.inertia_right) for e in found]
    return np.concatenate([np.zeros(0), *packed])


def rigid_ends(scene: Scene) -> Array:
    """Pack the `LEVERS` of an arm with rigid ends: levers of each link's root and tip, then of each point load (m)."""
    links, loads = scene.arm.links, []
    for load in scene.loads:
        if isinstance(load, PointLoad):
            before = load.link - (load.end == "root")
            beyond = before >= 0 and not isinstance(load, InnerLoad)
            loads.append(links[before].tip_offset if beyond else 0.0)
    return LEVERS.pack({"links": len(links), "loads": len(loads)}, levers=levers(scene.arm), loads=loads)


def curved(scene: Scene, elements: int, order: int) -> Array:
    """Return the stress-free coordinates q (m, rad) of a chain with curved links at the scene's initial joint angles.

    Stretch and shear vanish at the Gauss points if d = l (cos psi, sin psi), where d is l times the derivative of the
    position. Positions follow from d, from the root outward, as in `element.propagate_positions`. The code writes
    positions as complex numbers x + i y.
    """
    arm, t = scene.arm, tables(order)
    at = CHAIN.offsets(0, arm.n_links, elements, order)
    q, row = np.zeros(at.end), at.elements
    q[row : row + AXES] = *scene.position, scene.angles[0]
    z, psi = complex(*scene.position), scene.angles[0]
    for k, (link, bends) in enumerate(zip(arm.links, rest(arm, elements, order), strict=True)):
        if k > 0:
            q[at.hinges + k - 1] = scene.initial_value(f"joint{k}")
            psi += q[at.hinges + k - 1]
        # z = x + i y along the link: rigid root end (its tangent is e^(i psi)), elements, rigid tip end
        z += link.root_offset * np.exp(1j * psi)
        for (_, part), bend in zip(_placed(link, elements), bends, strict=True):
            # psi of the nodes, d at the Gauss points, and the (right - left, interior ...) of x + i y that have this d
            nodes = np.array([psi, psi + bend[0], *bend[1:]])
            pull = part.length * np.exp(1j * product(nodes, t.value))
            parts = product(t.slope * t.weights, pull) / t.norm
            inner = q[row + AXES : row + AXES * order].reshape(order - 1, AXES)
            inner[:, X], inner[:, Y], inner[:, T] = parts[1:].real, parts[1:].imag, bend[1:]
            row += AXES * order
            z, psi = z + parts[0], nodes[1]
            q[row : row + AXES] = z.real, z.imag, psi
        z += link.tip_offset * np.exp(1j * psi)
    return q


def straight(scene: Scene, elements: int, order: int) -> Array:
    """Return the coordinates q (m, rad) of the chain without stress at the scene's initial angles.

    Interior coordinates of straight links are 0. If a link is curved, the function returns the result of `curved`.
    """
    arm = scene.arm
    if _bent(arm):
        return curved(scene, elements, order)
    at = CHAIN.offsets(0, arm.n_links, elements, order)
    q = np.zeros(at.end)
    x, y = scene.position
    row = at.elements
    q[row : row + AXES] = x, y, scene.angles[0]
    for k, link in enumerate(arm.links):
        # vertices at even arc lengths unless the section varies; then the next joint, beyond the rigid end (inertial
        # axes)
        step, ends = link.length / elements, None if link.uniform else link.mesh(elements, "elements")
        for e in range(elements):
            row += AXES * order
            share = (e + 1) * step if ends is None else float(ends[e + 1])
            angle = scene.angles[k]
            share = share + link.root_offset
            q[row : row + AXES] = x + share * np.cos(angle), y + share * np.sin(angle), angle
        x, y = q[row + X], q[row + Y]
        if link.tip_offset:
            x, y = x + link.tip_offset * np.cos(angle), y + link.tip_offset * np.sin(angle)
        if k > 0:
            q[at.hinges + k - 1] = scene.angles[k] - scene.angles[k - 1]
    return q


def rows(arm: Arm, elements: int, order: int) -> tuple[tuple[str, ...], dict[str, int]]:
    """Return the names of all rows, and a dict from the names of joint angles and root position to their rows.

    For example, link2.x3 is coordinate x of vertex 3 of link 2; link2.x3.1 is interior coordinate 1 of element 3 of
    link 2.
    """
    names = ["root_x", "root_y", "joint0"]
    for k in range(arm.n_links):
        for e in range(elements):
            names += [f"link{k}.{axis}{e}.{j}" for j in range(1, order) for axis in ("x", "y", "psi")]
            names += [f"link{k}.{axis}{e + 1}" for axis in ("x", "y", "psi")]
    names += [f"joint{k}" for k in range(1, arm.n_links)]
    named = ["root_x", "root_y", *[f"joint{k}" for k in range(arm.n_links)]]
    return tuple(names), {name: names.index(name) for name in named}


def load_rows(load: PointLoad, arm: Arm, elements: int, order: int) -> list[int]:
    """Return a point load's `ROWS_OF_LOAD`: rows of x, y, psi of its vertex and of the hinge angle (or -1)."""
    at, at_tip = CHAIN.offsets(0, arm.n_links, elements, order), load.end == "tip"
    if isinstance(load, InnerLoad):
        # the vertex at the load: elements of uniform links have equal lengths
        row = at.elements + AXES * order * (elements * load.link + load.elements_before(elements))
        return [row + X, row + Y, row + T, -1]
    first = at.elements + AXES * order * elements * (load.link + at_tip)
    hinge = -1 if at_tip or load.link == 0 else at.hinges + load.link - 1
    return [first + X, first + Y, first + T, hinge]


def build(scene: Scene, settings: Settings) -> System:
    """Build the scene's `System` with ``settings.elements`` elements of polynomial order ``settings.order`` per link.

    Raises:
        InvalidValue: the setting `period_correction` together with links of different tau_d, rigid ends or an eccentric
        payload.
    """
    assert settings.elements is not None and settings.order is not None
    arm, elements, order = scene.arm, settings.elements, settings.order
    if settings.period_correction and arm.damping[1]:
        raise check.InvalidValue("period_correction", True, "must be False where the links' tau_d differ")
    eccentric = arm.payload.eccentric
    rigid = any(link.rigid_ends for link in arm.links) or eccentric
    if settings.period_correction and rigid:
        why = "where links have rigid ends, or the payload an offset"
        raise check.InvalidValue("period_correction", True, f"must be False {why}")
    # weight 1/L for x, y, 1 for angles; vectors: pairs (x, y) of rows, which a turn of the arm rotates
    names, coordinates = rows(arm, elements, order)
    loads = [load_rows(load, arm, elements, order) for load in scene.loads if isinstance(load, PointLoad)]
    hinges = CHAIN.offsets(0, arm.n_links, elements, order).hinges
    vectors = tuple((row + X, row + Y) for row in range(0, hinges, AXES))
    absolute = tuple(range(T, hinges, AXES * order))  # of vertices; interior ones are departures from these
    weight = np.ones(len(names))
    weight[np.ravel(vectors)] = 1.0 / arm.total_length
    model = ExactBeam(
        n=len(names),
        n_factor=FACTORS.offsets(0, arm.n_links, elements, order).end
        + (rigid * 2 * arm.n_links + eccentric) * LEVER_FACTORS.places.end,
        n_inputs=arm.n_links + OF_LOAD.end * len(loads),
        fixed=fixed_rows(scene, coordinates),
        algebraic=None,
        weight=weight,
        newton=NewtonPolicy(
            first_error=None if rigid else 10.0,
            predicts=None if rigid else (0,),
            period_correction=2.0 * settings.period_error if settings.period_correction else None,
        ),
        order=(0,) * order,
        links=arm.n_links,
        elements=elements,
        varying=(0,) if varies(arm) else None,
        sections=sections(arm, elements, order),
        rest=np.concatenate([bend.ravel() for bend in rest(arm, elements, order)]) if _bent(arm) else None,
        elbows=elbows(arm),
        rigid=rigid_ends(scene) if rigid else None,
        hub_inertia=arm.hub_inertia,
        damped=damped(arm),
        gravity=None if scene.gravity is None else np.array(scene.gravity),
        loads=np.array(loads, dtype=np.int64).ravel() if loads else None,
        jointed=(0,) if arm.jointed else None,
        eccentric=np.array(arm.payload.offset) if eccentric else None,
    )
    return System.of(arm, model, straight(scene, elements, order), coordinates, names, vectors, absolute)
