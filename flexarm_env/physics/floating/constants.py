"""Constants of a link, or a piece of it, as a floating-frame body with elastic coordinates q, equations [20]-[27].

Frame "root" is clamped to the body's first node. The node's (u, v, phi) vanish, so the frame's angle is the angle of
the root section. The x axis of frame "chord" passes through both ends of the body. All inertia terms are expressed by
constants (theory, 2.1) that this module computes once, packs (`BODY`) and that kernels read. Components that kernels
read together are adjacent fields in the loaded order. A body reduced to modes has additional constants for its
foreshortening (`reduction`).
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ... import curves
from ...compiler import kernel
from ...layout import Field, Layout
from ...parameters import Link
from ..model import Mesh
from .beam_element import BENDING, Element, coupling_matrix, geometric_matrix, mesh
from .layout import window

Array = NDArray[np.float64]

# in `data`: EA/l, g and H of one finite element (1.2), on the coordinates of its window
SPAN = Layout(
    "Span", "window",
    Field("stiffness", (), "N/m", "axial stiffness EA / l"),
    Field("stretch", ("window",), "", "g: linear stretch u2 - u1 (m) of an element is g'q, with q of its window"),
    Field("H", ("window", "window"), "1/m", "H: stretch q'H q / 2 of second order (von Karman); G of [45] (paper)"),
)  # fmt: skip
# in `data`: N_u, N_v (m) at a point where the centerline is drawn (frame axes)
STATION = Layout(
    "Station", "n",
    Field("x", (), "m", "position of the drawing station along the axis"),
    Field("u", ("n",), "", "shape functions along the axis"),
    Field("v", ("n",), "", "shape functions across the axis"),
    Field("H", ("n", "n"), "1/m", "foreshortening: u -= q'H q / 2"),
)  # fmt: skip
# in `data`: the constants (2.1) of one body, frame axes
BODY = Layout(
    "Body", "n, window, elements, stations",
    Field("length", (), "m", "undeformed length of the body"),
    Field("mass", (), "kg", "m_t (theory, 2.1): mass of the body"),
    Field("S0", (), "kg m", "S_0: first moment along the axis, undeformed"),
    Field("I0", (), "kg m^2", "I_0: inertia about the frame's origin, undeformed"),
    Field("offset", (), "rad", "angle of the rigid joint at the body's tip"),
    Field("most_lost", (), "kg m^2", "largest allowed loss of inertia about the root by foreshortening; inf: no limit"),
    Field("S_bar_x", ("n",), "kg", "S_bar, x row: elastic part of the first moment along the axis"),
    Field("S_bar_y", ("n",), "kg", "S_bar, y row: elastic part of the first moment across the axis"),
    Field("c_u", ("n",), "kg m", "c_u of the inertia I = I0 + 2 c_u'q + q'G q, eq. 2.2"),
    Field("c", ("n",), "kg m", "c of the elastic angular momentum (c + B q)'q', eq. 2.3"),
    Field("tip_u", ("n",), "", "shape functions along the axis at the tip"),
    Field("tip_v", ("n",), "", "shape functions across the axis at the tip"),
    Field("tip_phi", ("n",), "1/m", "phi_t (tau of eq. 3.1): shape functions of the tip section's angle"),
    Field("G", ("n", "n"), "kg", "G = M_uv - D, eq. 2.2"),
    Field("M_ff", ("n", "n"), "kg", "M_ff: elastic mass matrix with rotary inertia"),
    Field("B", ("n", "n"), "kg", "B: skew gyroscopic matrix, eq. 2.1"),
    Field("K_EA", ("n", "n"), "N/m", "linear stiffness [44], stretching part"),
    Field("K_EI", ("n", "n"), "N/m", "linear stiffness [44], bending part (with shear)"),
    Field("D0", ("n", "n"), "kg", "D_0: foreshortening in the first moment, s_bar_x -= q'D0 q / 2"),
    Field("tip_H", ("n", "n"), "1/m", "H(L): foreshortening of the tip, t_x -= q'H q / 2"),
    Field("drag", (), "1/s", "alpha: coefficient of mass-proportional damping"),
    Field("damped", (), "", "the body's share of the arm's tau_d, read if tau_d differs between links"),
    Field("root", ("n",), "", "rho: the root section is rotated by rho'q (rad) relative to the frame"),
    Field("moment", ("n",), "", "K_EI q0: bending forces subtracted for a stress-free shape q0"),
    Field("spent", (), "J", "q0'K_EI q0 / 2: bending energy at q = 0"),
    Field("spans", ("elements", SPAN.length), "", "one `SPAN` for each finite element"),
    Field("stations", ("stations", STATION.length), "", "a `STATION` for each drawing station"),
)  # fmt: skip
body_at = kernel(BODY.offsets)
station_at = kernel(STATION.offsets)
span_at = kernel(SPAN.offsets)


@dataclass
class Body:
    """Constants of one body with n elastic coordinates q, in the axes of the body's frame and SI units.

    With s_bar(q) = S0 + S_bar q - e1 q'D0 q / 2 and I(q) = I0 + 2 c_u'q + q'G q its kinetic energy is
    1/2 m_t |R'|^2 + R''A (w S~ s_bar + s_bar') + 1/2 w^2 I + w (c + B q)'q' + 1/2 q''M_ff q'  (theory, eq. 2.3).
    """

    length: float  # m: undeformed length
    mass: float  # kg: mass m_t
    s0: float  # kg m: S0, first moment along the axis
    i0: float  # kg m^2: I0, inertia about the frame's origin
    s_bar: Array  # (2, n) kg: S_bar, elastic part of the first moment, rows x and y
    g: Array  # (n, n) kg: M_uv; for modes minus the foreshortening term D
    m_ff: Array  # (n, n) kg: elastic mass matrix, including rotary inertia
    b: Array  # (n, n) kg: skew-symmetric matrix B
    c_u: Array  # (n,) kg m: integral of m x N_u
    c: Array  # (n,) kg m: integral of m x N_v + J N_phi
    K_EA: Array  # (n, n) N/m: stretching part of the linear stiffness [44]
    K_EI: Array  # (n, n) N/m: bending part of the linear stiffness [44]
    d0: Array  # (n, n) kg: foreshortening in the first moment; zero for finite elements
    tip: Array  # (3, n): shape functions of u, v, phi at the tip
    tip_h: Array  # (n, n) 1/m: foreshortening of the tip, u -= q'H q / 2; zero for finite elements
    root: Array  # (n,): rho; the root section is rotated by rho'q relative to the frame; zero if clamped
    shapes: Array  # (s, 3, n): shape functions of u, v, phi at drawing stations
    stations: Array  # (s,) m: positions x of the drawing stations
    station_h: Array  # (s, n, n): foreshortening at the drawing stations
    moment: Array  # (n,): K_EI q0, bending forces subtracted for the stress-free shape
    q0: Array  # (n,): elastic coordinates of the stress-free shape; zero for straight links
    element_ea: Array = field(default_factory=lambda: np.zeros(0))  # EA / l of each element, N/m
    element_g: Array = field(default_factory=lambda: np.zeros((0, 4, 4)))  # 1/m: G of [45]; H for von Karman

    @property
    def n(self) -> int:
        """Return the number of elastic coordinates."""
        return self.c.size

    def add_tip_mass(self, mass: float, inertia: float) -> None:
        """Lump a mass (kg) and an inertia (kg m^2), such as those of an elbow, at the tip (theory, 2.6)."""
        n_u, n_v, n_phi = self.tip
        length = self.length
        # eq. (2.1) of a point mass: S_bar; G = M_uv - D and M_ff, because foreshortening takes D from the inertia; c_u,
        # c
        self.s_bar += mass * np.array([n_u, n_v])
        m_uv = mass * (np.outer(n_u, n_u) + np.outer(n_v, n_v))
        self.g += m_uv - mass * length * self.tip_h
        self.m_ff += m_uv + inertia * np.outer(n_phi, n_phi)
        self.b += mass * (np.outer(n_v, n_u) - np.outer(n_u, n_v))
        self.c_u += mass * length * n_u
        self.c += mass * length * n_v + inertia * n_phi
        self.d0 += mass * self.tip_h
        self.mass += mass
        self.s0 += mass * length
        self.i0 += mass * length**2 + inertia

    def add_root_inertia(self, inertia: float) -> None:
        """Lump an inertia (kg m^2), of the hub or an elbow, at the root section, whose angle is theta + rho'q."""
        self.i0 += inertia
        self.c += inertia * self.root
        self.m_ff += inertia * np.outer(self.root, self.root)

    def packed(
        self, mesh: Mesh, frame: str, drag: float, damped: float, offset: float, most_lost: float
    ) -> NDArray[np.float64]:
        """Return the body's block in `data`, packed as `BODY`.

        frame: "root" or "chord".
        drag: mass-proportional damping, 1/s.
        damped: the body's share of tau_d.
        offset: angle (rad) of the rigid joint at its tip.
        most_lost: largest loss of inertia, kg m^2.
        """
        n, elements = self.n, len(mesh.elements)
        stations = np.array([
            STATION.pack({"n": n}, x=x, u=shape[0], v=shape[1], H=h)
            for x, shape, h in zip(self.stations, self.shapes, self.station_h, strict=True)
        ])  # fmt: skip
        return BODY.pack(
            {"n": n, "window": len(mesh.window), "elements": elements, "stations": len(stations)},
            length=self.length, mass=self.mass, S0=self.s0, I0=self.i0, offset=offset, most_lost=most_lost,
            S_bar_x=self.s_bar[0], S_bar_y=self.s_bar[1], c_u=self.c_u, c=self.c,
            tip_u=self.tip[0], tip_v=self.tip[1], tip_phi=self.tip[2],
            G=self.g, M_ff=self.m_ff, B=self.b, K_EA=self.K_EA, K_EI=self.K_EI, D0=self.d0, tip_H=self.tip_h,
            drag=drag, damped=damped, root=self.root, stations=stations,
            moment=self.moment, spent=0.5 * self.moment @ self.q0,
            spans=[self._span(e, mesh, frame) for e in range(elements)],
        )  # fmt: skip

    def _span(self, e: int, mesh: Mesh, frame: str) -> NDArray[np.float64]:
        """Return the `SPAN` of finite element e: EA/l, and stretch and matrix H on the coordinates of its window."""
        elements = len(mesh.elements)
        free, wide = list(free_coordinates(elements, frame)), len(mesh.window)
        begin = window(mesh, self.n, e)
        # (u, v, phi) of all nodes less those that the frame fixes: the coordinates in the element's window
        own = free[begin : begin + wide]  # of all nodes' coordinates, those in the window
        # g and H on the coordinates of all nodes, because a window at the body's end lacks fixed ones; then cut out
        stretch, H = np.zeros(3 * elements + 3), np.zeros((3 * elements + 3,) * 2)
        first = 3 * e  # three coordinates a node
        # stretch u2 - u1, and H on (v1, phi1, v2, phi2)
        stretch[[first, first + 3]] = -1.0, 1.0
        bending = first + BENDING
        H[np.ix_(bending, bending)] = self.element_g[e]
        return SPAN.pack(
            {"window": wide}, stiffness=self.element_ea[e], stretch=stretch[own], H=H[np.ix_(own, own)]
        )


def free_coordinates(elements: int, frame: str) -> NDArray[np.int64]:
    """Return the indices of a body's elastic coordinates among (u, v, phi) of its elements + 1 nodes.

    Frame "root" is clamped to the first node, which therefore has no elastic coordinates. Frame "chord" passes through
    both ends. Therefore u and v of the first node and v of the last node are not elastic coordinates.
    """
    last = 3 * elements + 3
    return np.arange(3, last) if frame == "root" else np.r_[2 : last - 2, last - 1]


def finite_element_body(link: Link, elements: int, coupling: str, frame: str = "root") -> Body:
    """Return the `Body` of a link, or of a piece of a link, with finite elements; it has n = 3 elements coordinates.

    coupling: coupling of stretch and bending, one of COUPLINGS. frame: "root" or "chord".
    """
    parts = mesh(link, elements, "elements")
    n_all = 3 * (elements + 1)
    K_EA, K_EI = np.zeros((n_all, n_all)), np.zeros((n_all, n_all))
    mass = np.zeros((n_all, n_all))
    m_uv = np.zeros((n_all, n_all))
    b = np.zeros((n_all, n_all))
    s_bar = np.zeros((2, n_all))
    c_u, c = np.zeros(n_all), np.zeros(n_all)
    for e, part in enumerate(parts):
        # K, split into rows of bending (v, phi) and of stretch (u), because the EI factor scales the former alone
        at, k, bend = slice(3 * e, 3 * e + 6), part.stiffness(), np.zeros((6, 6))
        bend[np.ix_(BENDING, BENDING)] = k[np.ix_(BENDING, BENDING)]
        K_EA[at, at] += k - bend
        K_EI[at, at] += bend
        mass[at, at] += part.mass()
        for xi, weight, section in part.points:
            n_u, n_v, n_phi = part.shapes(xi)
            # mass integrals of (theory, eq. 2.1) by quadrature
            dm, x = section.m * weight * part.length, part.at(xi)
            m_uv[at, at] += dm * (np.outer(n_u, n_u) + np.outer(n_v, n_v))
            # q'B q' = dm r'S~ r' with S~ = [[0, -1], [1, 0]]
            b[at, at] += dm * (np.outer(n_v, n_u) - np.outer(n_u, n_v))
            s_bar[:, at] += dm * np.array([n_u, n_v])
            c_u[at] += dm * x * n_u
            c[at] += dm * x * n_v + section.J * weight * part.length * n_phi
    # delete the rows that the frame fixes: u, v, phi of the root, or u, v of the root and v of the tip
    free = free_coordinates(elements, frame)
    both, n = np.ix_(free, free), n_all - 3
    shapes, stations = _drawing_stations(parts)
    stretching = coupling_matrix if coupling == "von_karman" else geometric_matrix
    moment, q0 = _natural(link, parts, K_EI, stretching, free)
    return Body(
        length=link.length,
        mass=link.mass,
        s0=link.moment(1),
        i0=link.moment(2) + link.rotary,
        s_bar=s_bar[:, free],
        g=m_uv[both],
        m_ff=mass[both],
        b=b[both],
        c_u=c_u[free],
        c=c[free],
        K_EA=K_EA[both],
        K_EI=K_EI[both],
        d0=np.zeros((n, n)),
        tip=np.eye(n_all)[-3:, free],
        tip_h=np.zeros((n, n)),
        root=np.eye(n_all)[2, free],
        element_ea=np.array([part.section.EA / part.length for part in parts]),
        element_g=np.array([stretching(part.section, part.length) for part in parts]),
        shapes=shapes[:, :, free],
        stations=stations,
        station_h=np.zeros((stations.size, n, n)),
        moment=moment,
        q0=q0,
    )


def _bending_moments(parts: list[Element]) -> Array:
    """Return int EI kappa_0 phi' dx on all nodes' coordinates: bending forces of the stress-free curvature kappa_0."""
    total = np.zeros(3 * len(parts) + 3)
    for e, part in enumerate(parts):
        for xi, weight, section in part.points:
            kappa = float(curves.along(part.link.curvature, xi * part.length))
            total[3 * e : 3 * e + 6] += weight * part.length * section.EI * kappa * part.bend(xi)
    return total


def _natural(link: Link, parts: list[Element], K_EI: Array, stretching: Any, free: Any) -> Array:
    """Return `Body.moment` and `Body.q0` of the stress-free shape, which has no stretch, as an array (2, n).

    stretching: `coupling_matrix` or `geometric_matrix`.
    free: indices of the elastic coordinates. The results are zero for straight links.
    """
    if not link.curved:
        return np.zeros((2, len(free)))
    moment, q = _bending_moments(parts), np.zeros(K_EI.shape[0])
    # v and phi: K_EI q0 = int EI kappa_0 phi' dx
    bends = np.array([i for i in free if i % 3])
    q[bends] = np.linalg.solve(K_EI[np.ix_(bends, bends)], moment[bends])
    for e, part in enumerate(parts):
        # u: no stretch to second order, u2 - u1 = -w'Hw / 2
        w = q[3 * e + BENDING]
        q[3 * e + 3] = q[3 * e] - 0.5 * w @ stretching(part.section, part.length) @ w
    return np.array([K_EI @ q, q])[:, free]


def _drawing_stations(parts: list[Element]) -> tuple[Array, Array]:
    """Return shape functions (s, 3, nodal coordinates) and positions x (s,), m, at eight points of each element."""
    rows, places = [], []
    for e, part in enumerate(parts):
        for xi in np.arange(1, 9) / 8:
            full = np.zeros((3, 3 * len(parts) + 3))
            full[:, 3 * e : 3 * e + 6] = part.shapes(float(xi))
            rows.append(full)
            places.append(part.at(float(xi)))
    return np.array(rows), np.array(places)
