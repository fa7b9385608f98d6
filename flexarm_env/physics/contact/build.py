"""Assembly of contact: the record `Touching` of a scene's contacts, and a check that time steps resolve them."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexarm_env import validation as check
from flexarm_env.compiler import SINGLE, size, uncompiled
from flexarm_env.physics import protocol
from flexarm_env.physics.contact.account import respond
from flexarm_env.physics.contact.kinematics import less_obstacle, place_of
from flexarm_env.physics.contact.law import gap_of
from flexarm_env.physics.contact.layout import ACCOUNT, HERE, LAW, READ, REFERENCE, Paths, Touching, Watch
from flexarm_env.physics.elastica.chain import DATA
from flexarm_env.physics.elastica.layout import ECCENTRIC, LOAD
from flexarm_env.physics.layout import POSE, SPACE_POSE
from flexarm_env.physics.model import Elastica, System
from flexarm_env.physics.obstacles import packed
from flexarm_env.physics.protocol import State, Weights
from flexarm_env.scene import Contact, InnerLoad, PointLoad, Scene, touching_points
from flexarm_env.settings import Settings
from flexarm_env.time_functions import OMEGA, TimeFunction, constant

Array = NDArray[np.float64]


def points_of(scene: Scene) -> list[tuple[int, float]]:
    """Return link index and fraction of the link's length of each point that may touch obstacles, from root to tip."""
    return touching_points(scene.contacts, scene.arm)


def loads_of(scene: Scene) -> list[PointLoad]:
    """Return one point load of zero force for each point that may touch; obstacles act through the loads' inputs."""
    zero = constant(0.0)
    return [
        PointLoad(k, "tip", zero) if place == 1.0 else InnerLoad(k, "tip", zero, place=place)
        for k, place in points_of(scene)
    ]


def _radius(scene: Scene, point: tuple[int, float]) -> float:
    """Return the radius (m) of the sphere about a point of the arm that may touch."""
    arm, (k, place) = scene.arm, point
    if place < 1.0:
        return next(contact.radius for contact in scene.contacts if point in contact.points(arm))
    return arm.payload.radius if k + 1 == arm.n_links else arm.elbow(k + 1).radius


def obstacle_rows(scene: Scene) -> dict[str, TimeFunction]:
    """Return the displacement (m) over time of each moving obstacle, by the name of its row, in the order of rows."""
    return {
        f"obstacle{i}_{'xyz'[axis]}": function
        for i, contact in enumerate(scene.contacts)
        for axis, function in contact.displacements
    }


def touching(scene: Scene, inner: Any, entry: int, at: int, rows: int) -> tuple[Touching, Watch, int]:
    """Return the contribution of contacts, its `Watch` for the integrator, and the number of its entries in S.

    inner: Model of the arm alone.
    entry: index in the inputs u of the first point's entries.
    at: offset of the contribution's entries in S.
    rows: number of rows of the Model; the last rows are those of moving obstacles.
    """
    arm, contacts, points = scene.arm, scene.contacts, points_of(scene)
    space = 3 if scene.spatial else 2
    radii = np.array([_radius(scene, point) for point in points])
    inside = any(place < 1.0 for _, place in points)
    # friction on a sphere's surface has a moment about its center
    turned = bool(radii.any()) and any(contact.friction > 0.0 for contact in contacts)
    axes = space + (1 if space == 2 else 3) * turned
    laws = [
        LAW.pack(
            {}, stiffness=contact.stiffness, halves=2.0 * contact.exponent, damping=contact.damping,
            friction=contact.friction, creep=contact.creep,
        )
        for contact in contacts
    ]  # fmt: skip
    meets = [[float(point in contact.points(arm)) for contact in contacts] for point in points]
    stride = int(HERE.offsets(0, axes, rows).end)
    names = list(obstacle_rows(scene))
    row_of = {name: rows - len(names) + k for k, name in enumerate(names)}
    moving = [row_of.get(f"obstacle{i}_{axis}", -1) for i in range(len(contacts)) for axis in "xyz"]
    motions = size(inner.n_inputs) if inside else (POSE.end if space == 2 else SPACE_POSE.end) * arm.n_links
    part = Touching(
        input=entry, at=at, points=(0,) * len(points), entries=(0,) * (3 if space == 2 else 6), space=(0,) * space,
        axes=(0,) * axes, room=(0,) * rows, poses=(0,) * motions,
        links=np.array([k for k, _ in points], np.int64), radii=radii, meets=np.array(meets).ravel(),
        shapes=packed([contact.obstacle for contact in contacts]), laws=np.concatenate(laws),
        masses=np.zeros(len(points)), moving=np.array(moving, np.int64) if names else None,
        levers=_levers(inner, len(points), rows, len(names)), extent=_extent(scene), inside=(0,) if inside else None,
    )  # fmt: skip
    # a weighted increment of 1 in every row moves a point by at most the arm's length each
    watch = Watch(
        (0,) * len(points), at, READ.end, stride, rows * arm.total_length, (0,) if scene.root == "free" else None
    )
    numbers = stride * len(points) + int(REFERENCE.offsets(0, rows).end)
    return part, watch, numbers + (int(ACCOUNT.offsets(0, len(names)).end) if names else 0)


def with_paths(scene: Scene, system: System) -> System:
    """Return the System of an environment: kernels displace its obstacles, as functions of each arm's own time.

    The rows of displacements are fixed in the equations, and the integrator sets them at the end of each step. Without
    moving obstacles the function returns `system` itself.
    """
    functions = obstacle_rows(scene)
    if not functions:
        return system
    model = system.model
    watch, rows = model.newton.contact, np.array([system.coordinates[name] for name in functions], np.int64)
    # the account follows the entries of the points and the reference
    at = watch.at + len(watch.points) * watch.stride + int(REFERENCE.offsets(0, size(model.n)).end)
    pieces = np.concatenate([function.pieces for function in functions.values()]).ravel()
    first = np.cumsum([0] + [len(function.pieces) for function in functions.values()]).astype(np.int64)
    paths = Paths(at, (0,) * len(rows), rows, pieces, first)
    model = model._replace(
        fixed=np.concatenate([model.fixed, rows]),
        newton=model.newton._replace(contact=watch._replace(paths=paths)),
    )
    return dataclasses.replace(system, model=model)


def _levers(inner: Any, count: int, rows: int, moving: int) -> Array | None:
    """Return `Touching.levers` for an elastica in the plane; its last `count` point loads are the contact points.

    With the unit tangents e_j of the nodes, a point is at (x, y) + sum_j (arm_j - beta_j) e_j. e_j moves by at most the
    change of its angle. (x, y) are the last two rows of an arm whose root can move. The last `moving` of all rows are
    displacements of obstacles. For other formulations the result is None.
    """
    if not isinstance(inner, Elastica) or inner.loads is None:
        return None
    n, links = size(inner.nodes), size(inner.links)
    m = n * links
    loads = LOAD.offsets(0, links, n).end
    arms = inner.loads.reshape(-1, loads)[-count:, :m]
    data = DATA.offsets(0, links, n, 0)
    beta = np.abs(arms - inner.data[data.beta : data.beta + m]).max(axis=0)
    if inner.eccentric is not None:
        lever = ECCENTRIC.offsets(0, m)
        beta += np.abs(inner.eccentric[lever.beta : lever.beta + m])
    levers = np.zeros(rows)
    levers[:m] = beta
    # the angle of a link's first node is the joint's angle plus the angle of the node before
    for k in range(links - 1, 0, -1):
        levers[k * n - 1] += levers[k * n]
    if inner.root is not None:
        levers[m : m + 2] = 1.0
    levers[rows - moving :] = 1.0
    return levers


def _extent(scene: Scene) -> float:
    """Return `Touching.extent`, an upper bound (m) of the coordinates of points and obstacles."""
    place = np.concatenate([np.ravel(scene.position), *(contact.obstacle.place for contact in scene.contacts)])
    return float(scene.arm.total_length + np.abs(place).sum())


STEPS = 8.0
"""Smallest allowed number of time steps during an impact at `Contact.speed`."""


RELEASE = 20.0
"""Largest speed, as a multiple of `Contact.speed`, with which an obstacle may eject an arm that starts inside it."""


def duration(contact: Contact, mass: float) -> float:
    """Return the duration (s) of an undamped impact, in which a mass (kg) hits the obstacle at `contact.speed`.

    T = c d / v with the largest penetration d = ((n + 1) m v^2 / (2 k))^(1 / (n + 1)). The factor c = 2 int_0^1 (1 -
    x^(n + 1))^(-1/2) dx is pi for n = 1 and 2.94 for n = 1.5 (Hertz).
    """
    power = contact.exponent + 1.0
    depth = (0.5 * power * mass * contact.speed**2 / contact.stiffness) ** (1.0 / power)
    share = 2.0 * math.sqrt(math.pi) * math.gamma(1.0 + 1.0 / power) / math.gamma(0.5 + 1.0 / power)
    return float(share * depth / contact.speed)


def largest_stiffness(contact: Contact, mass: float, dt: float) -> float:
    """Return the stiffness (N/m^n) for which an impact (see `duration`) lasts `STEPS` time steps of dt (s)."""
    return float(contact.stiffness * (duration(contact, mass) / (STEPS * dt)) ** (contact.exponent + 1.0))


def effective_masses(system: System, dt: float) -> Array:
    """Return the effective mass (kg) of each point that may touch: the smallest over all directions, for a step dt (s).

    The mass is 1 / (c_m b^T S^-1 b), with the generalized force b of 1 N on the point and the Newton matrix S = c_m M +
    c_v C + K of the arm at its start. The effective mass is the inertia of the point in one step. Links bend away from
    a sudden force. The mass is therefore smaller than with rigid links, and decreases with the step.
    """
    model = system.model
    part = _touching_part(system)
    n, axes = size(model.arm.n), len(part.space)
    still, r, u = np.zeros(n), np.zeros(n), np.zeros(size(model.n_inputs))
    c_m, out = 4.0 / (dt * dt), np.zeros((len(part.points), axes, 2, n))
    S = np.zeros(size(model.arm.n_factor))
    state, weights = State(system.q0[:n].copy(), still, still.copy()), Weights(c_m, 2.0 / dt, 1.0)
    uncompiled(respond)(SINGLE, model, system.par, state, u, weights, part, r, S, out)
    compliance = np.einsum("pin,pjn->pij", out[:, :, 0], out[:, :, 1])
    largest = np.linalg.eigvalsh(0.5 * (compliance + compliance.transpose(0, 2, 1)))[:, -1]
    return np.asarray(1.0 / (c_m * largest))


def _touching_part(system: System) -> Touching:
    """Return the contribution of contacts in an assembled scene with contacts."""
    return next(part for part in system.model.contributions if isinstance(part, Touching))


def with_masses(scene: Scene, settings: Settings, system: System) -> System:
    """Return the System with the effective masses of its contact points; without contacts return `system` itself."""
    if not scene.contacts:
        return system
    assert settings.dt is not None
    parts, masses = system.model.contributions, effective_masses(system, settings.dt)
    parts = tuple(part._replace(masses=masses) if isinstance(part, Touching) else part for part in parts)
    return dataclasses.replace(system, model=system.model._replace(contributions=parts))


def largest_speed(contact: Contact, end: float) -> float:
    """Return the largest speed (m/s) of an obstacle from 0 to `end` (s); 0 if it is fixed.

    The speed is sampled at 1000 instants, at more if sines of the displacement have more than 62 periods.
    """
    fastest = max((abs(function.pieces[:, OMEGA]).max() for _, function in contact.displacements), default=0.0)
    t = np.linspace(0.0, end, int(min(max(1000.0, 16.0 * fastest * end / (2.0 * math.pi)), MOST_SAMPLES)))
    rates = [np.asarray(function(t, 1)) for _, function in contact.displacements]
    return float(np.sqrt(sum((rate**2 for rate in rates), np.zeros(1))).max())


MOST_SAMPLES = 200000
"""Largest number of instants at which the speed of an obstacle is sampled."""


def start_depths(system: System) -> Array:
    """Return the penetration (m) of each point into each obstacle at the start; 0 for points without contact."""
    model, part = system.model, _touching_part(system)
    n, y = size(model.arm.n), np.zeros(size(model.n_inputs))
    uncompiled(protocol.input_displacements)(SINGLE, model.arm, system.par, system.q0[:n].copy(), y)
    depths = np.zeros((len(part.points), len(part.meets) // len(part.points)))
    for p, o in np.argwhere(part.meets.reshape(depths.shape) > 0.5):
        place = uncompiled(place_of)(SINGLE, part, y, int(p))
        place = uncompiled(less_obstacle)(SINGLE, part, int(o), system.q0, place)
        depths[p, o] = max(0.0, -float(uncompiled(gap_of)(part, int(p), int(o), place)))
    return depths


def check_steps(scene: Scene, settings: Settings, system: System, start: bool = False) -> None:
    """Check that time steps resolve all contacts of an assembled scene: an impact lasts at least `STEPS` steps.

    Steps fitted to a tolerance (`step_tolerance`) are not checked.

    start: True to check also points that are inside an obstacle at the start. Such a point leaves at the speed whose
        impact has the energy k d^(n + 1) / (n + 1) of the point's penetration d.

    Raises:
        ValueError: the steps are too long. The message names the contact, the largest stiffness and the longest step.
    """
    if not scene.contacts or settings.step_tolerance is not None:
        return
    dt, masses, points = settings.dt, _touching_part(system).masses, points_of(scene)
    assert dt is not None
    depths = start_depths(system) if start else np.zeros((len(points), len(scene.contacts)))
    for i, given in enumerate(scene.contacts):
        # an obstacle hits a resting arm with its own speed
        contact = dataclasses.replace(given, speed=max(given.speed, largest_speed(given, scene.duration)))
        for name, point in zip(contact.bodies, contact.points(scene.arm), strict=True):
            mass, depth = float(masses[points.index(point)]), float(depths[points.index(point), i])
            power = contact.exponent + 1.0
            leaves = math.sqrt(2.0 * contact.stiffness * depth**power / (power * mass))
            if leaves > RELEASE * contact.speed:
                what = (
                    f"must not contain {name} of the arm at the start, which is {depth:.2g} m inside: the contact "
                    f"would throw it out at {leaves:.3g} m/s; move the arm or the obstacle, or give a speed of at "
                    f"least {leaves / RELEASE:.2g} m/s, to which time steps are adapted"
                )
                raise check.InvalidValue(f"contacts[{i}].obstacle", contact.obstacle, what)
            hits = dataclasses.replace(contact, speed=max(contact.speed, leaves))
            lasts = duration(hits, mass)
            if lasts < STEPS * dt * (1.0 - 1e-9):
                largest, cause = largest_stiffness(contact, mass, dt), f"an impact at {contact.speed:g} m/s"
                if leaves > contact.speed:
                    # the depth is given: T is proportional to k^(-1/2)
                    largest = min(largest, contact.stiffness * (lasts / (STEPS * dt)) ** 2)
                    cause = f"the arm begins {depth:.2g} m inside the obstacle; an impact at {leaves:.3g} m/s"
                what = (
                    f"must be at most {largest:.3g} N/m^{contact.exponent:g} for steps of dt = {dt:g} s: {cause} on "
                    f"the effective mass of {mass:.3g} kg at {name} lasts {lasts:.2g} s, and must last {STEPS:g} "
                    f"steps; give dt <= {lasts / STEPS:.2g} s or a lower stiffness"
                )
                raise check.InvalidValue(f"contacts[{i}].stiffness", contact.stiffness, what)
