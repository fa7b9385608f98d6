"""Assemble a scene: its System, with the `build` module of its formulation, and its Drive (loads and motions)."""

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import validation as check
from ..parameters import Arm, Elbow, Payload
from ..scene import JointTorque, Motion, Scene, standing_scene
from ..sections import ACROSS, ENDS, Section
from ..settings import Settings
from ..time_functions import PIECE, TimeFunction, constant
from .contact.build import obstacle_rows, with_masses
from .joints.build import check_floating, places_of, with_base_mass, with_contributions, with_joints, with_points
from .linalg import solve
from .model import Drive, Elastica, Honours, Jointed, Scheme, System, scheme
from .space.chain import SpatialElastica

Array = NDArray[np.float64]


def assemble(scene: Scene, settings: Settings) -> System:
    """Return the scene's System in the formulation that the settings name.

    Raises:
        ValueError: the formulation, or the chosen variant of the formulation, does not model a property of the arm.
    """
    if scene.spatial:
        return _in_space(scene, settings)
    # rejected by variant: the formulation's HONOURS holds rigid ends, but multipliers and mass_damping omit their
    # levers
    for k, link in enumerate(scene.arm.links):
        if link.rigid_ends and (settings.multipliers or scene.arm.mass_damping):
            name = next(name for name in ENDS if getattr(link, name))
            raise check.InvalidValue(
                f"links[{k}].{name}", getattr(link, name), "must be 0 with multipliers=True and with mass_damping, "
                "which know no rigid ends; take multipliers=False, elastica or geometrically_exact, and tau_d"
            )  # fmt: skip
    if scene.arm.payload.eccentric and (settings.multipliers or scene.arm.mass_damping):
        raise check.InvalidValue(
            "payload.offset", scene.arm.payload.offset, "must be (0, 0) with multipliers=True and with mass_damping, "
            "which know a payload at the tip alone; take multipliers=False, elastica or geometrically_exact, and tau_d"
        )  # fmt: skip
    if scene.floats:
        check_floating(scene, settings)
    bent = [k for k, link in enumerate(scene.arm.links) if link.curved]
    if bent and (settings.multipliers or settings.coupling in ("paper", "linear")):
        raise check.InvalidValue(
            f"links[{bent[0]}].curvature", scene.arm.links[bent[0]].curvature, "must be 0 with multipliers=True and "
            "with coupling='paper' or 'linear', which have no foreshortening; take coupling='von_karman', elastica or "
            "geometrically_exact"
        )  # fmt: skip
    drag, segments = scene.arm.mass_damping, settings.segments
    if drag > 0.0 and (settings.formulation != "floating_frame" or segments not in (None, 1)):
        given = settings.formulation if segments is None else f"floating_frame in {segments} segments a link"
        raise check.InvalidValue(
            "mass_damping", drag, f"must be 0 under {given}: it is drag relative to a link's frame, which one floating "
            "frame a link has (segments=1, or modes alone); tau_d damps under every formulation"
        )  # fmt: skip
    if drag > 0.0 and settings.frame == "chord":
        raise check.InvalidValue(
            "mass_damping", drag, "must be 0 with frame='chord': it is drag relative to a frame clamped to the link's "
            "root (give frame='root'); tau_d damps under every formulation"
        )  # fmt: skip
    # any other field off its default must be in the formulation's HONOURS, because the assembly would silently ignore
    # it
    _check_honoured(scene.arm, "", settings.formulation, with_contributions(_builder(settings.formulation).HONOURS))
    system = _built(scene, settings)
    # v0 <- rates of straight links that turn at scene.rates (rad/s) and whose root moves at scene.velocity (m/s)
    if any(scene.rates) or any(scene.velocity):
        system = dataclasses.replace(system, v0=_rates(scene, settings))
    return with_masses(scene, settings, system)


def _in_space(scene: Scene, settings: Settings) -> System:
    """Return the System of a scene in space, with its joints, in the formulation that the settings name.

    Raises ValueError for a property of the arm that this formulation does not model in space.
    """
    from .space import build, elastica_build

    _check_honoured(scene.arm, "", f"{settings.formulation} in space", with_contributions(build.HONOURS))
    build.check_scene(scene, settings)
    builder: Any = elastica_build if settings.formulation == "elastica" else build
    return with_masses(scene, settings, with_joints(scene, settings, builder.build(with_points(scene), settings)))


def _builder(formulation: str) -> Any:
    """Return the `build` module of a formulation in the plane, imported when first used."""
    if formulation == "floating_frame":
        from .floating import build as floating

        return floating
    if formulation == "geometrically_exact":
        from .exact import build as exact

        return exact
    from .elastica import build as elastica

    return elastica


_NOT_MECHANICS: dict[type, tuple[str, ...]] = {
    Arm: ("name", "source", "torque_limits", "joint_limits", "sensors"),
    Section: tuple(ACROSS),
    Payload: ("radius",),
    Elbow: ("radius",),
}
"""Fields of an arm that enter no equation of motion. In the plane, they include the properties of a section for motion
out of the plane."""


def _check_honoured(part: Any, path: str, formulation: str, honours: Honours) -> None:
    """Raise ValueError if a field of `part`, or of an object within it, is set although `honours` does not contain it.

    A field is set if it differs from its default.
    part: an Arm or an object within it, at key path `path`.
    honours: for each class, the fields that the formulation models. A subclass that `honours` does not name is rejected
    as well.
    """
    if isinstance(part, tuple | list):
        for i, entry in enumerate(part):
            _check_honoured(entry, f"{path}[{i}]", formulation, honours)
    elif dataclasses.is_dataclass(part):
        given: type = type(part)
        # nearest base class that HONOURS names: its fields are checked first, then the subclass itself is rejected
        kind = next((kind for kind in given.__mro__ if kind in honours), None)
        known = honours[kind] if kind else ()
        for field in dataclasses.fields(part):
            value, name = getattr(part, field.name), f"{path}.{field.name}".lstrip(".")
            if field.name in known:
                _check_honoured(value, name, formulation, honours)
            elif field.name not in _NOT_MECHANICS.get(kind or Arm, ()) and value != field.default:
                what = f"is not taken into account by {formulation}, which honours {', '.join(known)}"
                raise check.InvalidValue(name, value, f"{what}; take another formulation, or leave it out")
        if kind is not given:
            what = f"must be one of {', '.join(k.__name__ for k in honours)}, which {formulation} knows"
            raise check.InvalidValue(path or "arm", given.__name__, what)


def _built(scene: Scene, settings: Settings) -> System:
    """Return the System of a scene in the plane with its joints, and with the floating base if it has one.

    v0 of the System is not computed from the scene's rates and velocity here; `_rates` computes it. The scene is not
    checked.
    """
    build = _builder(settings.formulation).build
    if not scene.floats:
        return with_joints(scene, settings, build(with_points(scene), settings))
    loaded = with_points(with_base_mass(scene))
    system: System = build(loaded, settings)
    # rows that change when the scene is moved by 1 m are positions, which the base's momentum needs
    aside = dataclasses.replace(loaded, position=tuple(x + 1.0 for x in loaded.position))
    places = places_of(system, build(aside, settings))
    return with_joints(scene, settings, system, places)


# central differences of sixth order: sum_k w_k (f(k t) - f(-k t)) / t
_WEIGHTS = ((1, 3 / 4), (2, -3 / 20), (3, 1 / 60))


def _rates(scene: Scene, settings: Settings) -> Array:
    """Return the rates v0 (n,) of all coordinates if straight links move and turn at the scene's initial rates.

    Coordinates are linear in the scene's position and in the sines and cosines of its angles. Central differences of
    sixth order are therefore exact up to round-off.
    """
    # t (s): in it the fastest link turns by 0.01 rad or the root moves by 0.01 L, where the differences are exact to
    # 1e-12
    longest = max(1e-300, *map(abs, scene.rates), *(abs(x) / scene.arm.total_length for x in scene.velocity))
    t = 0.01 / longest

    def moved(s: float) -> Array:
        """Return q0 (n,) of the scene at time s (s).

        Position and angles have moved at their initial rates; prescribed motions are constant.
        """
        place = [x + s * rate for x, rate in zip(scene.position, scene.velocity, strict=True)]
        angles = tuple(angle + s * rate for angle, rate in zip(scene.angles, scene.rates, strict=True))
        still = dataclasses.replace(
            scene, motions=(), position=(place[0], place[1]), angles=angles, velocity=(0.0, 0.0), rates=()
        )  # fmt: skip
        held = tuple(Motion(m.coordinate, constant(still.initial_value(m.coordinate))) for m in scene.motions)
        # obstacles stay: their rates are those of their displacements
        contacts = tuple(contact.held() for contact in scene.contacts)
        return _built(dataclasses.replace(still, motions=held, contacts=contacts), settings).q0

    system = _built(scene, settings)
    total = np.zeros_like(system.q0)
    for name in obstacle_rows(scene):
        total[system.coordinates[name]] = system.v0[system.coordinates[name]]
    for k, weight in _WEIGHTS:
        total += weight / t * (moved(k * t) - moved(-k * t))
    return total


def physical(model: Any) -> Any:
    """Return the model with the arm's physical inertia and without Coulomb friction.

    The elastica's inertia contains a correction of the integrator's period error (5.3). Equations in continuous time
    need the inertia without this correction. Coulomb friction has no derivative.
    """
    if isinstance(model, Jointed):
        return smooth(model)._replace(arm=physical(model.arm))
    if isinstance(model, Elastica):
        from .elastica.build import physical as without_correction

        return without_correction(model)
    return uncorrected(model)


def uncorrected(model: Any) -> Any:
    """Return the model without the inertia correction (5.3) that an elastica in space contains for its time steps."""
    if isinstance(model, Jointed):
        return model._replace(arm=uncorrected(model.arm))
    if isinstance(model, SpatialElastica):
        from .space.elastica_build import physical as without_correction

        return without_correction(model)
    return model


def smooth(model: Any) -> Any:
    """Return the model without Coulomb friction, which has no derivative."""
    return model._replace(newton=model.newton._replace(friction=None))


def scheme_of(settings: Settings, tolerance: float) -> Scheme:
    """Return the integrator's `Scheme` for the settings. tolerance: Newton tolerance, computed by `precision`."""
    return scheme(
        settings.rho_inf, settings.newmark, tolerance, settings.max_iterations, settings.max_halvings,
        settings.newton == "modified",
    )  # fmt: skip


def room_for_points(settings: Settings, n_links: int) -> int:
    """Return an upper bound, for any formulation, of the number of drawn points along an arm with n_links links."""
    a_segment = 32 if settings.modes is not None else 8 * (settings.elements or 1)
    return n_links * (2 + max(512, (settings.segments or 1) * a_segment))


def pose_table(arm: Arm, settings: Settings, gravity: tuple[float, ...] | None) -> Array:
    """Return the table (n, 1 + 3 N) with q = table @ (1, alpha_k, cos alpha_k, sin alpha_k) for straight links.

    n: number of coordinates of the planar arm in the formulation of the settings.
    N: number of links. alpha_k (rad), k < N: angle of link k from the inertial x axis.
    gravity: m/s^2 or None. Entries within 1e-12 of an integer are rounded to the integer.
    """
    assert settings.dt is not None
    count = arm.n_links
    rng = np.random.default_rng(1)
    # 1 + 3 N poses determine the table (all zero, then each angle alone); six random ones check it
    alone = np.kron(np.eye(count), [[-2.0], [1.0], [2.0]])
    samples = np.concatenate([np.zeros((1, count)), alone, rng.uniform(-3.0, 3.0, (6, count))])
    rows = [assemble(standing_scene(arm, settings.dt, gravity, angles), settings).q0 for angles in samples.tolist()]
    basis = np.concatenate([np.ones((len(samples), 1)), samples, np.cos(samples), np.sin(samples)], axis=1)
    own = basis.shape[1]
    table = solve(basis[:own], np.array(rows[:own])).T
    table[np.abs(table) < 1e-12] = 0.0
    exact = np.round(table)
    table = np.where(np.abs(table - exact) < 1e-12, exact, table)
    assert np.allclose(basis @ table.T, np.array(rows), atol=1e-9 * max(1.0, arm.total_length))
    return np.ascontiguousarray(table)


def drive(scene: Scene, system: System) -> Drive:
    """Return the scene's loads and motions as a `Drive`.

    A scene without loads and motions has an empty `Drive`, so that the same compiled kernel serves all scenes.

    system: the assembled scene. It contains the rows of the prescribed coordinates.
    """
    functions: list[TimeFunction] = []
    terms: list[tuple[int, int]] = []

    def add(entry: int, function: TimeFunction | None) -> None:
        """Add a function of time to the sum for entry `entry` of the inputs u. None adds nothing."""
        if function is not None:
            terms.append((entry, len(functions)))
            functions.append(function)

    # u: joint torques (N m), then for each point load its force (N) and torque (N m), inertial axes
    point = 0
    for load in scene.loads:
        if isinstance(load, JointTorque):
            add(load.joint, load.function)
        else:
            own: tuple[TimeFunction | None, ...] = (load.force_x, load.force_y, load.torque)
            if scene.spatial:
                own = (*own[:2], load.force_z, load.torque_x, load.torque_y, load.torque)
            for k, function in enumerate(own):
                add(scene.arm.n_links + len(own) * point + k, function)
            point += 1
    # terms of one entry of u in sequence, because `set_inputs` clears an entry at its first term
    terms.sort(key=lambda term: term[0])
    entries, added = np.array(terms, np.int64).reshape(-1, 2).T.copy()
    # known: rows of q that motions prescribe, or negative: rows of multipliers; motions: their functions' numbers
    prescribed = [(motion.coordinate, motion.function) for motion in scene.motions]
    prescribed += obstacle_rows(scene).items()
    known = np.array([system.coordinates[name] for name, _ in prescribed], np.int64)
    motions = np.arange(len(functions), len(functions) + len(prescribed), dtype=np.int64)
    functions += [function for _, function in prescribed]
    pieces = np.concatenate([function.pieces for function in functions] or [np.zeros((1, PIECE))])
    first = np.cumsum([0] + [len(function.pieces) for function in functions]).astype(np.int64)
    return Drive(pieces.ravel(), first, entries, added, known, motions)
