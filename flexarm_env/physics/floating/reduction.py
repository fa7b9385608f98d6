"""Reduction of a link, or of a piece of a link, to a few bending modes with foreshortening (substructuring).

The deformed shape is s = (x - p'H(x)p / 2, v(x)'p). Sections rotate by phi(x)'p, and p'H(x)p = int_0^x v'^2 - (v' -
phi)^2 dx (theory, 4.1). The line along the sections' normals keeps its length, like the axis of an exact beam. The
modes are those of the clamped link with the carried mass and inertia lumped at its tip.
"""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ... import curves
from ...parameters import Link, Payload
from .beam_element import BENDING, mesh
from .constants import Body

Array = NDArray[np.float64]

MESH = 32
"""Number of elements of the mesh on which modes are computed. The error of the fourth frequency is below 1e-5."""


def _bending_matrices(link: Link) -> tuple[Array, Array]:
    """Return stiffness and mass matrix, both (2 (MESH + 1), 2 (MESH + 1)), of a free link on (v, phi) of its nodes."""
    size = 2 * (MESH + 1)
    stiffness, mass = np.zeros((size, size)), np.zeros((size, size))
    for e, part in enumerate(mesh(link, MESH, "elements")):
        at = slice(2 * e, 2 * e + 4)
        stiffness[at, at] += part.stiffness()[np.ix_(BENDING, BENDING)]
        mass[at, at] += part.mass()[np.ix_(BENDING, BENDING)]
    return stiffness, mass


def _lowest(stiffness: Array, mass: Array, n: int) -> tuple[Array, Array]:
    """Return the n lowest frequencies (rad/s) and mass-normalized shapes (columns) of a stiffness and a mass matrix.

    The eigenproblem is solved for 1 / omega^2, because the stiffness matrix is well conditioned. The mass matrix is
    nearly singular if the rotary inertia of sections is very small.
    """
    from scipy.linalg import eigh

    size = len(mass)
    squares, vectors = eigh(mass, stiffness, subset_by_index=[size - n, size - 1])
    squares, vectors = squares[::-1], vectors[:, ::-1]
    return 1.0 / np.sqrt(squares), vectors / np.sqrt(squares)


def clamped_modes(link: Link, n: int, tip_mass: float, tip_inertia: float) -> tuple[Array, Array]:
    """Return the lowest n bending modes of a clamped link with a mass (kg) and an inertia (kg m^2) at its tip.

    Returns frequencies (n,) in rad/s and mass-normalized nodal shapes (2 (MESH + 1), n). The rows of the shapes are v
    and phi of each node. Each shape has a positive deflection of the tip.
    """
    stiffness, mass = _bending_matrices(link)
    mass[-2, -2] += tip_mass
    mass[-1, -1] += tip_inertia
    frequencies, vectors = _lowest(stiffness[2:, 2:], mass[2:, 2:], n)
    shapes = np.zeros((len(mass), n))
    shapes[2:] = vectors * np.sign(vectors[-2])  # tip deflection positive
    return frequencies, shapes


def pinned_modes(link: Link, n: int) -> tuple[Array, Array]:
    """Return two static shapes and the lowest n - 2 bending modes of a link between pins.

    In a static shape the root section, or the tip section, is rotated by 1 rad. Returns the stiffness matrix (n, n) of
    the shapes, and the nodal shapes (2 (MESH + 1), n), whose rows are v and phi of each node. Each mode rotates the
    root section in the positive sense.
    """
    from scipy.linalg import solve

    stiffness, mass = _bending_matrices(link)
    size = len(mass)
    ends, inner = [1, size - 1], [k for k in range(size) if k not in (0, 1, size - 2, size - 1)]
    shapes = np.zeros((size, n))
    shapes[ends, [0, 1]] = 1.0
    shapes[inner, :2] = -solve(stiffness[np.ix_(inner, inner)], stiffness[np.ix_(inner, ends)], assume_a="pos")
    if n > 2:
        free = [k for k in range(size) if k not in (0, size - 2)]
        shapes[free, 2:] = _lowest(stiffness[np.ix_(free, free)], mass[np.ix_(free, free)], n - 2)[1]
        shapes[:, 2:] *= np.sign(shapes[1, 2:])  # root turned positive
    return shapes.T @ stiffness @ shapes, shapes


@lru_cache(256)
def modal_body(
    link: Link, n: int, tip_mass: float, tip_inertia: float, frame: str = "root", whole: bool = True
) -> Body:
    """Return the `Body` of a link, or of a piece of a link (whole=False), reduced to n shapes.

    frame="root": clamped modes with tip_mass (kg) and tip_inertia (kg m^2) at the tip. Tip mass and tip inertia affect
    the modes but are not part of the body's inertia. frame="chord": a whole link has the same modes, relative to the
    line through both ends. A piece of a link has `pinned_modes`, because neighboring pieces bend it by moments at both
    ends. With n = 1 the piece has the clamped mode.

    The result is cached and shared. Copy it before you change it.
    """
    length, parts = link.length, mesh(link, MESH, "elements")
    frequencies, nodal = clamped_modes(link, n, tip_mass, tip_inertia)
    k = np.diag(frequencies**2)
    if frame == "chord" and not whole and n > 1:
        k, nodal = pinned_modes(link, n)
    elif frame == "chord":
        # seen from the line through both ends: v - v(L) x / L, phi - v(L) / L
        turn = nodal[-2] / length
        nodes = np.linspace(0.0, length, MESH + 1) if link.uniform else np.array([*(p.start for p in parts), length])
        nodal[0::2] -= nodes[:, None] * turn
        nodal[1::2] -= turn
    moment = np.zeros(n)
    m_uv, m_ff, d, d0 = (np.zeros((n, n)) for _ in range(4))
    s_bar, c = np.zeros((2, n)), np.zeros(n)
    h = np.zeros((n, n))
    stations, shapes, station_h = [], [], []
    for e, part in enumerate(parts):
        w, l = nodal[2 * e : 2 * e + 4], part.length
        for xi, weight, section in part.points:
            _, n_v, n_phi = part.shapes(xi)
            # shapes v, phi and dv/dx at the point; dx: length of the quadrature point
            v, phi, slope = n_v[BENDING] @ w, n_phi[BENDING] @ w, _slope(xi, l, part.mu) @ w
            dx, x = weight * l, part.at(xi)
            # constants of (theory, eq. 2.1)
            m_uv += section.m * dx * np.outer(v, v)
            m_ff += dx * (section.m * np.outer(v, v) + section.J * np.outer(phi, phi))
            s_bar[1] += section.m * dx * v
            c += dx * (section.m * x * v + section.J * phi)
            # bending moment of the shape without stress, int EI kappa_0 phi' dx
            if link.curved:
                kappa = float(curves.along(part.link.curvature, xi * l))
                moment += dx * section.EI * kappa * (part.bend(xi)[BENDING] @ w)
            # contribution to H(x) of (theory, eq. 4.1)
            stretch = dx * (np.outer(slope, slope) - np.outer(slope - phi, slope - phi))
            h += stretch
            beyond = _beyond(link, x)
            d0 += beyond[0] * stretch  # int m H dx, by parts
            d += beyond[1] * stretch  # int m x H dx, by parts
        # v, phi and H(x) at the element's end, where the centerline is drawn
        stations.append(part.at(1.0))
        shapes.append(np.array([np.zeros(n), nodal[2 * e + 2], nodal[2 * e + 3]]))
        station_h.append(h.copy())
    return Body(
        length=length,
        mass=link.mass,
        s0=link.moment(1),
        i0=link.moment(2) + link.rotary,
        s_bar=s_bar,
        g=m_uv - d,
        m_ff=m_ff,
        b=np.zeros((n, n)),
        c_u=np.zeros(n),
        c=c,
        K_EA=np.zeros((n, n)),
        K_EI=k,
        d0=d0,
        tip=np.array([np.zeros(n), nodal[-2], nodal[-1]]),
        tip_h=h,
        root=nodal[1],
        shapes=np.array(shapes),
        stations=np.array(stations),
        station_h=np.array(station_h),
        moment=moment,
        q0=np.asarray(np.linalg.solve(k, moment), np.float64) if link.curved else np.zeros(n),
    )


def _beyond(link: Link, x: float) -> tuple[float, float]:
    """Return the link's mass beyond x (kg) and its first moment about the root (kg m); x in m."""
    if link.uniform is not None:
        m, length = link.uniform.m, link.length
        return m * (length - x), 0.5 * m * (length**2 - x**2)
    rest = link.part(x, link.length)
    return rest.mass, rest.moment(1) + x * rest.mass


def inertia_margins(bodies: Sequence[Body], payload: Payload, root_moves: bool, held: bool) -> list[float]:
    """Return each body's margin of inertia (kg m^2), which shows how far a mass matrix is from being indefinite.

    The link is straight. The margin is mu of theory, section 4: the body's effective inertia for a torque on the body's
    angle, while all other parts are free to move. The other parts are the link's other bodies, all modes and, unless
    held, the root. The margin is the reciprocal of the angle's diagonal entry in the inverse mass matrix.

    bodies: rigidly joined bodies of one link, from root to tip.
    payload: body at the tip of the last body.
    root_moves: whether the root moves freely across the link.
    held: whether the root's angle is prescribed.
    """
    size = 2 + sum(body.n for body in bodies)  # the root's y and angle, the modes of all
    mass, angles = np.zeros((size, size)), []
    across, turn = np.eye(2, size)  # y and angle of a body's root in these coordinates
    first = 2
    for k, body in enumerate(bodies):
        modes = np.eye(body.n, size, first)
        # angle of the body's frame: root section's less rho'q
        frame = turn - body.root @ modes
        own = np.vstack([across, frame, modes])
        angles.append(frame)
        # the body's mass matrix in y, angle and modes, transformed to the link's coordinates
        inertia = np.zeros((body.n + 2, body.n + 2))
        inertia[0, 0], inertia[1, 1], inertia[2:, 2:] = body.mass, body.i0, body.m_ff
        inertia[0, 1:] = inertia[1:, 0] = [body.s0, *body.s_bar[1]]
        inertia[1, 2:] = inertia[2:, 1] = body.c
        mass += own.T @ inertia @ own
        # y (m, across the link) and angle of the tip section, where the next body begins
        across, turn = across + body.length * frame + body.tip[1] @ modes, frame + body.tip[2] @ modes
        if k + 1 == len(bodies):
            # m_p and J_p at the payload's center, behind the last tip, add J^T M J of its motion
            along, aside = payload.offset
            across = across + along * turn
            inertia_there = payload.inertia + payload.mass * aside**2
            mass += payload.mass * np.outer(across, across) + inertia_there * np.outer(turn, turn)
        first += body.n
    # inverse of the mass matrix in free coordinates, entry of each body's angle
    free = [k for k in range(size) if k > 1 or (k == 0 and root_moves) or (k == 1 and not held)]
    compliance = [row[free] @ np.linalg.solve(mass[np.ix_(free, free)], row[free]) for row in np.array(angles)]
    return [1.0 / value if value > 0.0 else np.inf for value in compliance]


def _slope(xi: float, l: float, mu: float) -> Array:
    """Return dv/dx (4,) of the element's shape functions [41] at xi = x/l, for (v1, phi1, v2, phi2)."""
    eta = 1.0 - xi
    # d/dxi of eta (1 + mu xi (eta - xi)) etc.; d(xi eta)/dxi = eta - xi, d(eta - xi)/dxi = -2
    p, q = xi * eta, eta - xi
    v1 = (-1 - mu * xi * q + eta * mu * (q - 2 * xi)) / l
    phi1 = 0.5 * (q * (1 + mu * q) - 2 * mu * p)
    v2 = (1 - mu * eta * q + xi * mu * (q + 2 * eta)) / l
    phi2 = -0.5 * (q * (1 - mu * q) + 2 * mu * p)
    return np.array([v1, phi1, v2, phi2])
