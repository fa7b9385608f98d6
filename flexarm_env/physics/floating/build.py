"""Assembly of a scene's links as floating-frame bodies: a `FloatingChain`, or a `FloatingFrame` with multipliers.

Each link is divided into `segments` bodies that are joined rigidly. A body has finite elements or is reduced to
`modes`.
"""

import itertools
from copy import deepcopy
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ... import validation as check
from ...parameters import Arm, Link, Payload
from ...scene import InnerLoad, PointLoad, Scene
from ...settings import MODAL_BOUND, Settings
from ..model import BEAM, FloatingChain, FloatingFrame, Mesh, System, fixed_rows, levers
from ..protocol import NewtonPolicy
from .constants import Body, finite_element_body, free_coordinates
from .layout import (
    ANGLE,
    ELASTIC,
    FACTORS,
    INNER,
    JOINT,
    LEVER_FACTORS,
    ROOT,
    ROW,
    STRAIN,
    VECTORS,
)
from .reduction import inertia_margins, modal_body

HONOURS = {**BEAM, Arm: (*BEAM[Arm], "mass_damping")}
"""For each class of an arm's description, the fields that this formulation models; `assembly` rejects other fields."""

WRITTEN_OUT = 8
"""Largest number of elastic coordinates of a body for which kernels are unrolled, with constant indices."""

MARGIN_LOST = 0.5
"""A run ends as out of range if bending has used up this fraction of the inertia margin of a body reduced to modes
(`inertia_margins`)."""


def carried(arm: Arm, link: int, rest: float = 0.0) -> tuple[float, float]:
    """Return the mass (kg) and inertia (kg m^2) of all parts beyond a point that is `rest` (m) before a link's tip.

    The parts are the rest of the link, its rigid end, elbows, later links and the payload. The function treats all
    parts as straight and rigid. The inertia is about the point.
    """
    own, mass, inertia, distance = arm.links[link], 0.0, 0.0, rest + arm.links[link].tip_offset
    # m and I = int m (s - s_0)^2 + J of the link's own rest behind the point
    if own.uniform is not None:
        section = own.uniform
        mass, inertia = section.m * rest, section.m * rest**3 / 3 + section.J * rest
    elif rest > 0.0:
        behind = own.part(own.length - rest, own.length)
        mass, inertia = behind.mass, behind.moment(2) + behind.rotary
    for k in range(link + 1, arm.n_links):
        # parallel axes: elbow and link k at `distance` m from the point add m d^2 to I
        elbow, item = arm.elbow(k), arm.links[k]
        length = item.length
        mass += elbow.mass + item.mass
        for m, along, own_inertia in item.ends:
            mass, inertia = mass + m, inertia + own_inertia + m * (distance + along) ** 2
        inertia += elbow.inertia_left + elbow.inertia_right + elbow.mass * distance**2
        distance += item.root_offset
        if item.uniform is not None:
            inertia += item.uniform.m * ((distance + length) ** 3 - distance**3) / 3 + item.rotary
        else:
            inertia += item.moment(2) + distance * (2.0 * item.moment(1) + distance * item.mass) + item.rotary
        distance += length + item.tip_offset
    # the link's own rigid end, m b at half its length (parallel axes), then the payload at its lever
    mass, inertia = mass + own.tip_mass, inertia + own.tip_inertia + own.tip_mass * (rest + 0.5 * own.tip_offset) ** 2
    far = abs(distance + arm.payload.lever)
    return mass + arm.payload.mass, inertia + arm.payload.inertia + arm.payload.mass * far**2


def _rigid(arm: Arm) -> bool:
    """Return whether any link of the arm has a rigid end."""
    return any(link.rigid_ends for link in arm.links)


ROUNDED = 1e-9
"""The end of an equal segment is moved to a jump of the section if the jump is within this fraction of the link."""


def _cut(link: Link, settings: Settings) -> list[Link]:
    """Divide a link into segments.

    If there are more segments than jumps of the section, segments end at the jumps. If there are fewer segments, all
    are equally long, with the jumps inside.

    Raises ValueError if a segment has too few elements for elements to end at each jump inside the segment.
    """
    segments = settings.segments or 1
    if segments > len(link.jumps):
        return link.cut(segments, "segments")
    # even segments; an end that equals a jump of the section up to rounding is set to it, so that no sliver remains
    ends = np.linspace(0.0, link.length, segments + 1)
    for jump in link.jumps:
        ends[abs(ends - jump) <= ROUNDED * link.length] = jump
    parts = [link.part(a, b) for a, b in itertools.pairwise(ends.tolist())]
    # an element has one section, so that each jump inside a segment must be an element's end
    least = 1 + max(len(part.jumps) for part in parts)
    if settings.elements is not None and segments > 1 and least > settings.elements:
        jumps = len(link.jumps)
        what = f"must be at least {jumps + 1} for a link whose sections jump {jumps} times, or elements {least}"
        raise check.InvalidValue("segments", segments, what)
    return parts


def bodies_of(arm: Arm, settings: Settings) -> list[Body]:
    """Return the bodies of all links from root to tip, with lumped inertia of hub and elbows; equal numbers per link.

    The payload is not lumped, because its mass may differ between the arms of a batch.
    """
    bodies: list[Body] = []
    frame, segments = settings.frame or "root", settings.segments or 1
    for k, link in enumerate(arm.links):
        parts = _cut(link, settings)
        if settings.modes is not None:
            # m and I beyond each segment shape its clamped modes, which carry that mass at their tip
            rests = [sum(part.length for part in parts[i + 1 :]) for i in range(segments)]
            if link.uniform is not None:
                rests = [parts[0].length * (segments - 1 - i) for i in range(segments)]
            pieces = [
                deepcopy(modal_body(part, settings.modes, *carried(arm, k, rest), frame, segments == 1))
                for part, rest in zip(parts, rests, strict=True)
            ]
        else:
            assert settings.elements is not None
            coupling = settings.coupling or "linear"
            pieces = [finite_element_body(part, settings.elements, coupling, frame) for part in parts]
        # eq. (2.6): hub or right elbow inertia on the root section, elbow's mass and left inertia on the tip
        pieces[0].add_root_inertia(arm.hub_inertia if k == 0 else arm.elbow(k).inertia_right)
        if k + 1 < arm.n_links:  # the elbow's mass belongs to the link before it, or to its rigid end
            mass = 0.0 if _rigid(arm) else arm.elbow(k + 1).mass
            pieces[-1].add_tip_mass(mass, arm.elbow(k + 1).inertia_left)
        bodies += pieces
    return bodies


def _limits(scene: Scene, bodies: list[Body], reduced: bool) -> list[float]:
    """Return each body's largest allowed loss of inertia about its root, kg m^2; inf for finite elements.

    The limit is a fraction of the body's `inertia_margins`. If the body's angle is prescribed, the limit is infinite.
    """
    if not reduced:
        return [np.inf] * len(bodies)
    arm, limits, segments = scene.arm, [], len(bodies) // scene.arm.n_links
    held = {motion.joint for motion in scene.motions} | set(scene.rigid_joints)
    for k in range(arm.n_links):
        own = bodies[k * segments : (k + 1) * segments]
        payload = arm.payload if k + 1 == arm.n_links else Payload()
        limits += inertia_margins(own, payload, k > 0 or scene.root == "free", k in held)
    return [MARGIN_LOST * limit for limit in limits]


def build(scene: Scene, settings: Settings) -> System:
    """Build the `System` of a scene with floating frames, and with Lagrange multipliers if `settings.multipliers`."""
    return _joined(scene, settings) if settings.multipliers else _chain(scene, settings)


def _mesh(bodies: list[Body], arm: Arm, settings: Settings) -> Mesh:
    """Return the `Mesh` of all bodies: the bodies' sizes, and a tag for each term that the kernels contain."""
    n = bodies[0].n
    # coupling "linear" has no term (1.2) per element; a window has the free ones of an element's 6 coordinates
    elements, wide = bodies[0].element_ea.size if settings.coupling != "linear" else 0, min(n, 6)
    largest, shares = arm.damping
    return Mesh(
        n=(0,) * n if n <= WRITTEN_OUT else n,
        scratch=(0,) * VECTORS.offsets(0, n).end,
        window=(0,) * wide,
        elements=(0,) * elements,
        strains=(0,) * max(1, elements * STRAIN.offsets(0, wide).end),
        modal=None if settings.modes is None else (0,),
        chord=(0,) if settings.frame == "chord" else None,
        full=(0,) if settings.coupling == "von_karman" else None,
        damped=None if largest == 0.0 else (0,) if shares is None else (0, 0),
        drag=(0,) if arm.mass_damping > 0.0 else None,
        curved=(0,) if any(link.curved for link in arm.links) else None,
    )


def _shared(scene: Scene, settings: Settings, bodies: list[Body], offsets: NDArray[np.float64]) -> dict[str, Any]:
    """Return the fields that `FloatingChain` and `FloatingFrame` share. offsets: angles of rigid joints, rad."""
    arm, mesh = scene.arm, _mesh(bodies, scene.arm, settings)
    assert settings.frame is not None
    limits, segments = _limits(scene, bodies, settings.modes is not None), settings.segments or 1
    shares = np.repeat(arm.damping[1] or (1.0,) * arm.n_links, segments)
    blocks = [
        body.packed(mesh, settings.frame, arm.mass_damping, share, offset, limit)
        for body, share, offset, limit in zip(bodies, shares, offsets, limits, strict=True)
    ]
    point_loads = [load for load in scene.loads if isinstance(load, PointLoad)]
    loaded = np.array([(load.link, _side(load, segments)) for load in point_loads], np.int64)
    return {
        "n_inputs": arm.n_links + 3 * len(point_loads),
        "mesh": mesh,
        "links": arm.n_links,
        "segments": segments,
        "block": blocks[0].size,
        "bound": 0.0 if settings.modes is None else MODAL_BOUND,
        "data": np.concatenate(blocks),
        "gravity": None if scene.gravity is None else np.array(scene.gravity),
        "loads": loaded.ravel() if point_loads else None,
    }


def _side(load: PointLoad, segments: int) -> int:
    """Return the `LOADED.side` of a point load on a link of so many segments."""
    if isinstance(load, InnerLoad):
        return INNER + load.elements_before(segments) - 1
    return int(load.end == "tip")


def _chain(scene: Scene, settings: Settings) -> System:
    """Assemble the scene's chain without multipliers.

    Rows: x, y, angle of the root; elastic coordinates of all bodies from root to tip; angles of the elbows.
    """
    arm = scene.arm
    bodies = bodies_of(arm, settings)
    n, count = bodies[0].n, len(bodies)
    # rows of q: root x, y and angle, q of all bodies, then the elbow angles beta
    each = itertools.product(range(arm.n_links), range(settings.segments or 1), range(n))
    names = ["root_x", "root_y", "joint0", *(f"link{k}.body{b}.q{i}" for k, b, i in each)]
    names += [f"joint{k}" for k in range(1, arm.n_links)]
    coordinates = {name: names.index(name) for name in ["root_x", "root_y", *[f"joint{k}" for k in range(arm.n_links)]]}
    # q0: straight links at the scene's angles; elastic coordinates of least energy, K q_0 = int EI kappa_0 kappa'
    q0, weight = np.zeros(len(names)), np.ones(len(names))
    q0[:2], q0[2] = scene.position, scene.angles[0]
    for k in range(1, arm.n_links):
        q0[-arm.n_links + k] = scene.initial_value(f"joint{k}")
    elastic = slice(ELASTIC, ELASTIC + n * count)
    q0[elastic] = np.concatenate([body.q0 for body in bodies])
    # Newton's weights: reciprocal of each coordinate's characteristic size
    weight[:2] = 1.0 / arm.total_length
    weight[elastic] = np.concatenate([_sizes(body, settings, arm) for body in bodies])
    rigid, eccentric = _rigid(arm), arm.payload.eccentric
    model = FloatingChain(
        n=len(names),
        n_factor=ROOT.end
        + JOINT.end * (arm.n_links - 1)
        + count * FACTORS.offsets(0, n).end
        + ((rigid or eccentric) * 2 * arm.n_links + eccentric) * LEVER_FACTORS.places.end,
        fixed=fixed_rows(scene, coordinates),
        algebraic=None,
        weight=weight,
        # with stretch an increment small in length leaves large forces EA u': no error bound is trusted
        newton=NewtonPolicy(
            acceleration_share=1.0,
            first_error=None if settings.modes is None else 10.0,
            resolved=None if settings.modes is None else (0,),
        ),
        rigid=levers(arm) if rigid else None,
        table=None,
        jointed=(0,) if arm.jointed else None,
        eccentric=np.array(arm.payload.offset) if eccentric else None,
        inside=(0,) if any(isinstance(load, InnerLoad) for load in scene.loads) else None,
        **_shared(scene, settings, bodies, np.zeros(count)),
    )
    return System.of(arm, model, q0, coordinates, names, ((0, 1),), (ANGLE,))


def _sizes(body: Body, settings: Settings, arm: Arm) -> NDArray[np.float64]:
    """Return the reciprocal of each elastic coordinate's characteristic size, (n,).

    For finite elements u and v are lengths (1 over the arm's length), and phi is an angle (1). For a mode, use the
    larger of the tip deflection over the arm's length and the angles of the ends.
    """
    if settings.modes is not None:
        moved = np.maximum(np.abs(body.tip[1]) / arm.total_length, np.abs(body.root))
        sizes: NDArray[np.float64] = np.maximum(moved, np.abs(body.tip[2]) * (settings.frame == "chord"))
        return sizes
    assert settings.elements is not None and settings.frame is not None
    angle = free_coordinates(settings.elements, settings.frame) % 3 == 2
    return np.where(angle, 1.0, 1.0 / arm.total_length)


def _joined(scene: Scene, settings: Settings) -> System:
    """Assemble the scene's bodies joined by multipliers (the paper's form): rows body 0, its tip joint, body 1, ..."""
    arm, bodies, segments = scene.arm, bodies_of(scene.arm, settings), settings.segments or 1
    n, count = bodies[0].n, len(bodies)
    links = np.arange(count) // segments
    # Phi (3.4) of the joint at each body's tip: number of rows, prescribing motion (-1: none), constant psi (rad)
    rows, angle, offset = np.full(count, 3), np.full(count, -1), np.zeros(count)
    rows[-1] = 0
    coordinates = {"root_x": 0, "root_y": 1, "joint0": 2}
    motions = [motion.coordinate for motion in scene.motions]
    # between links: rigid (3 rows, constant psi), prescribed (3 rows, psi(t)) or hinged (2 rows: no moment)
    for joint in range(1, arm.n_links):
        b, name = joint * segments - 1, f"joint{joint}"  # b: the body before it
        if joint in scene.rigid_joints:
            offset[b] = scene.angles[joint] - scene.angles[joint - 1]
        elif name in motions:
            angle[b] = motions.index(name)
            coordinates[name] = -1 - (int(rows[:b].sum()) + 2)
        else:
            rows[b] = 2
    # band in the order body, joint, body: its half-width reaches from a joint's last lambda to its body's first row
    start = np.cumsum([0, *(ELASTIC + n + rows)])
    size = int(start[-1])
    half = ELASTIC + n + int(rows.max()) - 1
    fixed = [k for k, name in ((0, "root_x"), (1, "root_y")) if scene.root == "pinned" and name not in motions]
    q0, weight, names = np.zeros(size), np.ones(size), list[str]()
    # R (inertial axes) and theta of each body: straight links at the scene's angles satisfy Phi = 0
    x, y = scene.position
    for b, (body, at, theta) in enumerate(zip(bodies, start, np.take(scene.angles, links), strict=False)):
        q0[at : at + ELASTIC] = x, y, theta
        x, y = x + body.length * np.cos(theta), y + body.length * np.sin(theta)
        weight[at : at + ANGLE] = 1.0 / arm.total_length
        weight[at + ELASTIC : at + ELASTIC + n] = _sizes(body, settings, arm)
        names += [f"body{b}.{what}" for what in ("x", "y", "theta", *(f"q{i}" for i in range(n)))]
        names += [f"joint{b}.lambda{i}" for i in range(rows[b])]
    # rows of lambda: each body's last ones
    algebraic = [row for end, own in zip(start[1:], rows, strict=True) for row in range(end - own, end)]
    table = np.zeros((count, ROW.places.end), np.int64)
    columns = {"start": start[:-1], "size": n, "link": links, "multipliers": rows, "motion": angle}
    for name, values in columns.items():
        table[:, getattr(ROW.places, name)] = values
    model = FloatingFrame(
        n=size,
        n_factor=size * (3 * half + 2) + FACTORS.offsets(0, n).end,
        fixed=np.array(fixed, np.int64),
        algebraic=np.array(algebraic, np.int64),
        weight=weight,
        newton=NewtonPolicy(acceleration_share=1.0),
        half=half,
        rigid=None,
        eccentric=None,
        table=table,
        **_shared(scene, settings, bodies, offset),
    )
    vectors = tuple((int(row), int(row) + 1) for row in start[:-1])
    return System.of(arm, model, q0, coordinates, names, vectors, [int(row) + ANGLE for row in start[:-1]])
