"""A scene's links as floating-frame bodies joined by multipliers: the `FloatingFrame` Model.

Each link is cut into `segments` bodies joined rigidly, of finite elements or reduced to `modes`. What needs no
multiplier has none: a pinned root and a prescribed hub angle are coordinates that are known.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...parameters import Arm, Link, Payload
from ...scene import PointLoad, Scene
from ...settings import MODAL_BOUND, Settings
from ..model import COUPLINGS, FloatingFrame, System
from .constants import Body, finite_element_body
from .layout import BODY, ELEMENT, ROW, STATION
from .reduction import inertia_margins, modal_body

MARGIN_LOST = 0.5
"""Share of the margin of a reduced body's mass matrix whose loss likewise ends the run."""


def carried(arm: Arm, link: int, rest: float = 0.0) -> tuple[float, float]:
    """Mass (kg) and inertia (kg m^2) that link k carries `rest` m before its tip, all of it straight and locked."""
    section = arm.links[link].section
    mass, inertia, distance = section.m * rest, section.m * rest**3 / 3 + section.J * rest, rest
    for k in range(link + 1, arm.n_links):
        elbow, item = arm.elbow(k), arm.links[k]
        m, length = item.section.m, item.length
        mass += elbow.mass + m * length
        inertia += elbow.inertia_left + elbow.inertia_right + elbow.mass * distance**2
        inertia += m * ((distance + length) ** 3 - distance**3) / 3 + item.section.J * length
        distance += length
    return mass + arm.payload.mass, inertia + arm.payload.inertia + arm.payload.mass * distance**2


def _bodies(arm: Arm, settings: Settings) -> tuple[list[Body], list[int]]:
    """Bodies root to tip with hub and elbows lumped (the payload stays an arm's own parameter), and their links."""
    bodies: list[Body] = []
    links: list[int] = []
    for k, link in enumerate(arm.links):
        segments = settings.segments or 1
        part = link.length / segments
        if settings.modes is not None:
            piece = Link(part, link.section)
            rests = [part * (segments - 1 - i) for i in range(segments)]
            pieces = [modal_body(piece, settings.modes, *carried(arm, k, rest)) for rest in rests]
        else:
            assert settings.segments is not None and settings.elements is not None
            coupling = settings.coupling or "linear"
            pieces = [finite_element_body(link.section, part, settings.elements, coupling) for _ in range(segments)]
        pieces[0].add_root_inertia(arm.hub_inertia if k == 0 else arm.elbow(k).inertia_right)
        if k + 1 < arm.n_links:  # the elbow's mass belongs to the link before it
            pieces[-1].add_tip_mass(arm.elbow(k + 1).mass, arm.elbow(k + 1).inertia_left)
        bodies += pieces
        links += [k] * len(pieces)
    return bodies, links


def _limits(scene: Scene, bodies: list[Body], links: list[int], reduced: bool) -> list[float]:
    """Loss of inertia about its root (kg m^2) that each body may suffer; any where its angle is prescribed."""
    if not reduced:
        return [np.inf] * len(bodies)
    arm, limits = scene.arm, []
    held = {motion.joint for motion in scene.motions} | set(scene.rigid_joints)
    for k in range(arm.n_links):
        own = [body for body, link in zip(bodies, links, strict=True) if link == k]
        payload = arm.payload if k + 1 == arm.n_links else Payload()
        limits += inertia_margins(own, payload, k > 0 or scene.root == "free", k in held)
    return [MARGIN_LOST * limit for limit in limits]


def _block(body: Body, offset: float, most_lost: float) -> NDArray[np.float64]:
    """A body's block of `FloatingFrame.data`."""
    n = {"n": body.n}
    elements = [ELEMENT.pack({}, stiffness=ea, G=g) for ea, g in zip(body.element_ea, body.element_g, strict=True)]
    stations = [
        STATION.pack(n, x=x, u=shape[0], v=shape[1], H=h)
        for x, shape, h in zip(body.stations, body.shapes, body.station_h, strict=True)
    ]
    return BODY.pack(
        {**n, "elements": len(elements), "stations": len(stations)},
        length=body.length, mass=body.mass, S0=body.s0, I0=body.i0, offset=offset, most_lost=most_lost,
        S_bar=body.s_bar, c_u=body.c_u, c=body.c, tip=body.tip,
        G=body.g, M_ff=body.m_ff, B=body.b, K_axial=body.k_axial, K_bend=body.k_bend, D0=body.d0, tip_H=body.tip_h,
        elements=elements, stations=stations,
    )  # fmt: skip


def build(scene: Scene, settings: Settings) -> System:
    """Assemble a scene in the floating-frame formulation."""
    arm = scene.arm
    bodies, links = _bodies(arm, settings)
    count = len(bodies)
    sizes = np.array([body.n for body in bodies], dtype=np.int64)
    motions = [motion.coordinate for motion in scene.motions]
    rows, angle, offset = np.zeros(count, np.int64), np.full(count, -1, np.int64), np.zeros(count)
    start = np.zeros(count + 1, np.int64)
    algebraic: list[int] = []
    coordinates: dict[str, int] = {"root_x": 0, "root_y": 1, "joint0": 2}
    names: list[str] = []
    for b in range(count):
        names += [f"body{b}.{what}" for what in ("x", "y", "theta")]
        names += [f"body{b}.q{i}" for i in range(bodies[b].n)]
        if b + 1 < count:
            rows[b] = 3
            if links[b + 1] != links[b]:
                joint = links[b + 1]
                if joint in scene.rigid_joints:
                    offset[b] = scene.angles[joint] - scene.angles[joint - 1]
                elif f"joint{joint}" in motions:
                    angle[b] = motions.index(f"joint{joint}")
                    coordinates[f"joint{joint}"] = -1 - (len(algebraic) + 2)
                else:
                    rows[b] = 2
            first = start[b] + 3 + sizes[b]
            algebraic += range(first, first + rows[b])
            names += [f"joint{b}.lambda{i}" for i in range(rows[b])]
        start[b + 1] = start[b] + 3 + sizes[b] + rows[b]
    n = int(start[-1])
    half = max(max(3 + sizes[b] + rows[b] - 1, rows[b] + 2) for b in range(count))
    fixed = [k for k, name in ((0, "root_x"), (1, "root_y")) if scene.root == "pinned" and name not in motions]
    q0, weight = np.zeros(n), np.ones(n)
    x, y = scene.position
    for b, body in enumerate(bodies):
        theta = scene.angles[links[b]]
        q0[start[b] : start[b] + 3] = x, y, theta
        x, y = x + body.length * np.cos(theta), y + body.length * np.sin(theta)
        weight[start[b] : start[b] + 2] = 1.0 / arm.total_length
        elastic = slice(start[b] + 3, start[b] + 3 + body.n)
        # finite elements: u and v are lengths, phi is an angle; modes: their tip deflection is a length
        own = np.tile([1.0, 1.0, arm.total_length], body.n // 3) if settings.modes is None else np.abs(body.tip[1])
        weight[elastic] = own / arm.total_length
    heads = [links.index(k) for k in range(arm.n_links)]
    tails = [count - 1 - links[::-1].index(k) for k in range(arm.n_links)]
    point_loads = [load for load in scene.loads if isinstance(load, PointLoad)]
    places = [(heads[p.link], 0) if p.end == "root" else (tails[p.link], 1) for p in point_loads]
    limits = _limits(scene, bodies, links, settings.modes is not None)
    blocks = [_block(body, float(offset[b]), limits[b]) for b, body in enumerate(bodies)]
    places_of_blocks = np.cumsum([0] + [block.size for block in blocks[:-1]])
    elements = [body.element_ea.size for body in bodies]
    stations = [body.stations.size for body in bodies]
    table = np.zeros((count, ROW.places.end), np.int64)
    columns = {
        "start": start[:-1], "size": sizes, "link": links, "multipliers": rows, "motion": angle,
        "elements": elements, "stations": stations, "block": places_of_blocks,
    }  # fmt: skip
    for name, values in columns.items():
        table[:, getattr(ROW.places, name)] = values
    model = FloatingFrame(
        n=n,
        n_factor=n * (3 * int(half) + 2),
        n_inputs=arm.n_links + 3 * len(point_loads),
        fixed=np.array(fixed, np.int64),
        algebraic=np.array(algebraic, np.int64),
        weight=weight,
        predictor=1.0,
        correction=None,
        half=int(half),
        coupling=COUPLINGS[settings.coupling or "linear"],
        mass_damping=arm.mass_damping,
        gravity=np.array(scene.gravity or (0.0, 0.0)),
        n_links=arm.n_links,
        bound=0.0 if settings.modes is None else MODAL_BOUND,
        table=table,
        data=np.concatenate(blocks),
        loads=np.array(places, np.int64).reshape(-1, 2),
    )
    par = np.array([arm.payload.mass, arm.payload.inertia, 1.0, arm.tau_d])
    return System(model, par, q0, np.zeros(n), coordinates, tuple(names), {})
