"""Natural frequencies and mode shapes about a point of the motion, also in steady rotation."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .. import validation as check
from ..scene import Scene
from ..simulation import Simulation
from ..validation import Array
from . import space
from .equations import STEP, Equations, Point, slopes
from .equilibrium import find_rest, still, warn_unstable
from .period import at_start, point_of
from .stability import Complex, Stability, at_rest, eigenpairs, growing, moving
from .state_space import simulation_of


@dataclass(frozen=True)
class Modes:
    """The n lowest modes of an arm about a point of its motion.

    Attributes:
        frequencies (n,): natural frequencies, rad/s: the magnitude of `eigenvalues`; 0 for a rigid motion, and for a
            pole that decays or grows without oscillation. The modes are sorted by this magnitude, ascending.
        damping (n,): ratios -Re lambda / |lambda|; 1 for each pole of an overdamped mode, -1 for a pole that grows
            without oscillation, 0 for a rigid motion.
        eigenvalues (n,): lambda, rad/s, the one of a pair with positive imaginary part.
        shapes (n, points, 2), in space (n, points, 3): displacements of the points along the chain at the phase of
            their largest one, which has unit length, m. In rotation points move on ellipses; this is the real part.
        points (points, 2) or (points, 3): the chain itself, root to tip, m.
        spin: rad/s.
        growing: number of unstable modes among all modes, not only the n lowest; 0 if the point is stable.
        whirl (n,): in space, direction in which points circle the first joint's axis, in the frame that turns
            with the arm: 1 for circles in the direction of a positive spin, -1 against it, 0 for linear motion; NaN if
            points rest or move only along the axis. Empty in the plane.
    """

    frequencies: Array
    damping: Array
    eigenvalues: Complex
    shapes: Array = field(repr=False)
    points: Array = field(repr=False)
    spin: float
    growing: int = 0
    whirl: Array = field(default_factory=lambda: np.zeros(0))


def modes(
    target: Simulation | Scene,
    n: int = 6,
    formulation: str | None = None,
    *,
    spin: float = 0.0,
    clamped: bool | Sequence[int] = False,
    **options: Any,
) -> Modes:
    """Compute natural frequencies, damping ratios and mode shapes of an arm about a point of its motion.

    Args:
        target: a Scene: modes about its equilibrium with the joints held at their initial angles
            (`static_equilibrium`); or a Simulation: modes about its present state.
        n: largest number of modes.
        formulation, options: of a Scene, as for `simulate`.
        spin: rad/s, about the root of a pinned Scene without gravity and without its loads: modes of the arm in steady
            rotation, stretched and bent by the rotation, in the rotating frame.
        clamped: False: joints that are not prescribed or rigid can turn, with constant torques; True: the
            hub is held ("clamped modes"); or the indices of the joints that are held. With an elastic gear the motor's
            side is held. Coulomb friction is left out.
    Returns:
        The Modes.
    Raises:
        ValueError: a value that is not allowed. NoEquilibrium: a Scene without an equilibrium.
    Warns:
        UnstableEquilibrium: a Scene whose equilibrium is unstable although the joints are held.
    """
    n = check.integer("n", n, minimum=1)
    spin = check.number("spin", spin, "rad/s")
    scene = target.scene if isinstance(target, Simulation) else check.instance("target", target, Scene)
    if isinstance(target, Scene) and spin != 0.0 and (scene.root != "pinned" or scene.gravity is not None):
        raise check.InvalidValue("spin", spin, "needs a pinned root and no gravity, or there is no steady rotation")
    held = _held(clamped, scene.arm.n_links)
    about = _in_space if scene.spatial else _in_plane
    (values, vectors, points, shape), rest = about(target, formulation, options, spin, held)
    if rest is not None:
        warn_unstable(rest, refuse=False)
    order = np.argsort(np.abs(values), kind="stable")[:n]
    eigenvalues, seen = values[order], [shape(vector) for vector in vectors.T[order]]
    size = np.abs(eigenvalues)
    damping = np.where(size > 0.0, -eigenvalues.real / np.maximum(size, 1e-300), 0.0) + 0.0  # no -0.0
    frequencies = np.where(np.abs(eigenvalues.imag) > 1e-9 * size, size, 0.0)
    shapes = np.array([one for one, _ in seen]).reshape(-1, *points.shape)
    whirl = np.array([one for _, one in seen if scene.spatial])
    return Modes(frequencies, damping, eigenvalues, shapes, points, spin, growing(values), whirl)


def _in_space(
    target: Simulation | Scene, formulation: str | None, options: dict[str, Any], spin: float, held: list[int]
) -> tuple[space.Vibration, Stability | None]:
    """Of an arm in space; of a Scene at rest also how that is with all joints held."""
    rest = None
    if isinstance(target, Simulation):
        simulation = simulation_of(target, formulation, options)
        if spin != 0.0 or simulation.work.v.any():
            raise check.InvalidValue("spin", spin, "must be given with a Scene; a Simulation in space must be at rest")
    elif spin != 0.0:
        scene = still(target, True, position=(0.0, 0.0), loads=(), space=True)
        simulation = Simulation(scene, target.settings(formulation, **options), False)
    else:
        simulation = space.rest_of(still(target, True), target.settings(formulation, **options), True)
        rest = space.stability_of(simulation, list(range(target.arm.n_links)))
    return space.modes_of(simulation, simulation.work.q.copy(), held, spin), rest


def _in_plane(
    target: Simulation | Scene, formulation: str | None, options: dict[str, Any], spin: float, held: list[int]
) -> tuple[space.Vibration, Stability | None]:
    """The same of an arm in the plane."""
    rest = None
    if isinstance(target, Simulation):
        if spin != 0.0:
            raise check.InvalidValue("spin", spin, "must be given with a Scene; a Simulation brings its own motion")
        equations = Equations(simulation_of(target, formulation, options))
        point = point_of(at_start(target, equations.model)[1])
    else:
        moved: dict[str, Any] = {"position": (0.0, 0.0), "loads": ()} if spin != 0.0 else {}
        simulation = Simulation(still(target, True, **moved), target.settings(formulation, **options))
        equations, w = Equations(simulation), simulation.work
        start = Point(w.q.copy(), *equations.rotating(w.q, spin), w.u.copy(), w.psi.copy())
        joints = equations.inputs.tolist()
        point, _ = find_rest(equations, start, joints, spin)
        rest = at_rest(equations, point, joints) if spin == 0.0 else None
        _check_rotors(target, held)
    keep = moving(equations, held)
    reduced = equations.reduced(point, spin)

    def shape(vector: Complex) -> tuple[Array, float]:
        return _shape(equations, point.q, reduced.lift[:, keep] @ vector), np.nan

    return (*eigenpairs(*reduced.among(keep)), equations.points(point.q), shape), rest


def _held(clamped: bool | Sequence[int], links: int) -> list[int]:
    """The held joints."""
    if isinstance(clamped, bool):
        return [0] if clamped else []
    joints = check.sequence("clamped", clamped, "joint indices")
    for i, joint in enumerate(joints):
        check.integer(f"clamped[{i}]", joint, minimum=0, maximum=links - 1)
    return list(joints)


def _check_rotors(scene: Scene, held: list[int]) -> None:
    """A motor behind an elastic gear has inertia, or is held, or prescribed."""
    for k, joint in enumerate(scene.arm.joints):
        if joint.elastic and joint.rotor == 0.0 and k not in held and scene.motion_of(f"motor{k}") is None:
            what = "must be positive (kg m^2): its motor is neither held nor prescribed"
            raise check.InvalidValue(f"arm.joints[{k}].motor_inertia", joint.motor_inertia, what)


def _shape(equations: Equations, q: Array, vector: Complex) -> Array:
    """Displacements of the chain's points along a complex change of the rows that can move."""
    weight = equations.model.weight[equations.free]
    vector = vector / np.abs(vector * weight).max()

    def moved(step: Array) -> Array:
        at = q.copy()
        at[equations.free] += step[0] * vector.real + step[1] * vector.imag
        return equations.points(at).ravel()

    parts = slopes(moved, np.zeros(2), np.array([0, 1]), np.full(2, STEP / 5.0))
    change = (parts[:, 0] + 1j * parts[:, 1]).reshape(-1, 2)
    largest = change.ravel()[np.abs(change).argmax()]
    real = (change * (np.conj(largest) / np.abs(largest))).real if np.abs(largest) > 0.0 else change.real
    return np.asarray(real / max(float(np.sqrt((real**2).sum(axis=1)).max()), 1e-300))
