"""Natural frequencies and shapes about a point of the motion, steady rotation included."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import validation as check
from ..scene import Scene
from ..simulation import Simulation
from ..validation import Array
from . import space
from .equations import STEP, Equations, Point, slopes
from .equilibrium import find_rest, still, warn_unstable
from .period import point_of
from .stability import at_rest, eigenpairs, growing, moving
from .state_space import at_start, simulation_of


@dataclass(frozen=True)
class Modes:
    """The n lowest modes of an arm about a point of its motion.

    Attributes:
        frequencies (n,): natural frequencies |lambda|, rad/s, ascending; 0 for a rigid motion.
        damping (n,): ratios -Re lambda / |lambda|; 1 for each pole of an overdamped mode, -1 for a pole that grows
            without oscillation, 0 for a rigid motion.
        eigenvalues (n,): lambda, rad/s, the one of a pair with positive imaginary part.
        shapes (n, points, 2), in space (n, points, 3): displacements of the points along the chain at the phase of
            their largest one, which has unit length, m. In rotation points move on ellipses; this is the real part.
        points (points, 2) or (points, 3): the chain itself, root to tip, m.
        spin: rad/s.
        growing: how many modes of all, not of the n lowest alone, grow: 0 where the arm stays near the point. The
            frequency of one that grows without oscillation is its rate of growth.
        whirl (n,): in space, which way the points go round the first joint's axis, as an observer sees it who turns
            with the arm: 1 on circles with a positive spin, -1 against it, 0 where they move to and fro; NaN where they
            stay or move along the axis alone. In the plane empty.
    """

    frequencies: Array
    damping: Array
    eigenvalues: NDArray[np.complex128]
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
    """Natural frequencies, damping ratios and shapes of an arm about a point of its motion.

    Args:
        target: a Scene, about its equilibrium with the joints held at their initial angles (`static_equilibrium`); or a
            Simulation, about the state it has now.
        n: how many modes at most.
        formulation, options: of a Scene, as for `simulate`.
        spin: rad/s, about the root of a pinned Scene without gravity, its loads left out: the modes are those of the
            arm in steady rotation, stretched and bent as that makes it, as seen by an observer who turns with it.
        clamped: False: joints that are not prescribed or rigid can turn (their torques stay what they are); True: the
            hub is held ("clamped modes"); or the indices of the joints that are held. Behind an elastic gear it is the
            motor's side that is held. Coulomb friction is left out.
    Returns:
        The Modes.
    Raises:
        ValueError: a value that is not allowed. NoEquilibrium: of a Scene, there is none.
    Warns:
        UnstableEquilibrium: of a Scene, its equilibrium is unstable although the joints are held.
    """
    n = check.integer("n", n, minimum=1)
    spin = check.number("spin", spin, "rad/s")
    if (target.scene if isinstance(target, Simulation) else check.instance("target", target, Scene)).spatial:
        return _in_space(target, n, formulation, options, spin, clamped)
    equations, point = _about(target, formulation, options, spin)
    if isinstance(target, Scene) and spin == 0.0:
        warn_unstable(at_rest(equations, point, equations.inputs.tolist()), refuse=False)
    held = _held(clamped, equations.n_links)
    if isinstance(target, Scene):
        _check_rotors(target, held)
    keep = moving(equations, held)
    reduced = equations.reduced(point, spin)
    eigenvalues, vectors = eigenpairs(reduced, keep)
    unstable = growing(eigenvalues)
    order = np.argsort(np.abs(eigenvalues), kind="stable")[:n]
    eigenvalues, vectors = eigenvalues[order], vectors[:, order]
    frequencies = np.abs(eigenvalues)
    damping = np.where(frequencies > 0.0, -eigenvalues.real / np.maximum(frequencies, 1e-300), 0.0) + 0.0  # no -0.0
    shapes = [_shape(equations, point.q, reduced.lift[:, keep] @ vector) for vector in vectors.T]
    points = equations.points(point.q)
    return Modes(frequencies, damping, eigenvalues, np.array(shapes).reshape(-1, *points.shape), points, spin, unstable)


def _in_space(
    target: Simulation | Scene, n: int, formulation: str | None, options: dict[str, Any], spin: float,
    clamped: bool | Sequence[int],
) -> Modes:  # fmt: skip
    """`modes` of an arm in space."""
    if isinstance(target, Simulation):
        simulation = simulation_of(target, formulation, options)
        if spin != 0.0 or simulation.work.v.any():
            raise check.InvalidValue("spin", spin, "must be given with a Scene; a Simulation in space must be at rest")
    else:
        settings = target.settings(formulation, **options)
        if spin != 0.0 and (target.root != "pinned" or target.gravity is not None):
            raise check.InvalidValue("spin", spin, "needs a pinned root and no gravity, or there is no steady rotation")
        moved: dict[str, Any] = {"position": (0.0, 0.0), "loads": (), "space": True} if spin != 0.0 else {}
        scene = still(target, True, **moved)
        simulation = Simulation(scene, settings, False) if spin else space.rest_of(scene, settings, True)
    held = _held(clamped, simulation.scene.arm.n_links)
    if isinstance(target, Scene) and spin == 0.0:
        everywhere = list(range(simulation.scene.arm.n_links))
        warn_unstable(space.stability_of(simulation, everywhere), refuse=False)
    values, shapes, points, whirl = space.modes_of(simulation, simulation.work.q.copy(), held, spin)
    frequencies = np.abs(values)
    damping = np.where(frequencies > 0.0, -values.real / np.maximum(frequencies, 1e-300), 0.0) + 0.0
    return Modes(frequencies[:n], damping[:n], values[:n], shapes[:n], points, spin, growing(values), whirl[:n])


def _about(
    target: Simulation | Scene, formulation: str | None, options: dict[str, Any], spin: float
) -> tuple[Equations, Point]:
    """The arm's equations and the point that its modes are about."""
    if isinstance(target, Simulation):
        if spin != 0.0:
            raise check.InvalidValue("spin", spin, "must be given with a Scene; a Simulation brings its own motion")
        simulation = simulation_of(target, formulation, options)
        equations = Equations(simulation)
        return equations, point_of(at_start(simulation, equations.model)[1])
    scene = check.instance("target", target, Scene)
    settings = scene.settings(formulation, **options)
    if spin != 0.0 and (scene.root != "pinned" or scene.gravity is not None):
        raise check.InvalidValue("spin", spin, "needs a pinned root and no gravity, or there is no steady rotation")
    moved = {"position": (0.0, 0.0), "loads": ()} if spin != 0.0 else {}
    simulation = Simulation(still(scene, True, **moved), settings)
    equations = Equations(simulation)
    w = simulation.work
    start = Point(w.q.copy(), *equations.rotating(w.q, spin), w.u.copy(), w.psi.copy())
    return equations, find_rest(equations, start, equations.inputs.tolist(), spin).point


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


def _shape(equations: Equations, q: Array, vector: NDArray[np.complex128]) -> Array:
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
