"""Natural frequencies and mode shapes of an arm at rest, at a point of its motion, or in steady rotation."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from .. import validation as check
from ..equations import Equations, Point, at_rest_of, point_of
from ..rest import NoEquilibrium
from ..rigid import axis_of, mount_of
from ..scene import Scene
from ..simulation import Simulation
from ..validation import Array
from .equilibrium import find_rest, static_equilibrium, still, warn_unstable
from .period import at_start
from .stability import Complex, Stability, at_rest, eigenpairs, growing, moving
from .state_space import simulation_of


@dataclass(frozen=True)
class Modes:
    """The n lowest modes of an arm about a state.

    Attributes:
        frequencies (n,): natural frequencies |lambda|, rad/s; 0 for a rigid motion, and for a real eigenvalue (decay or
            growth without oscillation). The modes are sorted by |lambda|, ascending.
        damping (n,): damping ratios -Re lambda / |lambda|; 1 for each eigenvalue of an overdamped mode, -1 for growth
            without oscillation, 0 for a rigid motion.
        eigenvalues (n,): eigenvalues lambda, rad/s; a conjugate pair is represented by the eigenvalue with positive
            imaginary part.
        shapes (n, points, 2), in space (n, points, 3): displacements of points on the arm's center line, scaled and
            shifted in phase so that the largest displacement is 1 m. In rotation, points move on ellipses; the array
            contains the real parts of the complex displacements.
        points (points, 2), in space (points, 3): positions of the points on the center line, from root to tip, m.
        spin: spin rate, rad/s: the argument `spin` of `modes`.
        growing: number of unstable modes among all modes, not only among the n lowest; 0 if the state is stable.
        whirl (n,): in space, the direction in which points circle the first joint's axis, in the frame that turns with
            the arm. A mode's entry is 1 for circles in the direction of a positive spin, -1 for circles in the opposite
            direction, and 0 for motion along a straight line. For ellipses the entry is between 0 and 1 or between 0
            and -1. The entry is NaN if the points are at rest or move only along the axis. For arms in the plane,
            `whirl` is empty.
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
    """Compute natural frequencies, damping ratios and mode shapes of an arm about a state.

    Args:
        target: a Scene, for modes about the equilibrium with the joints held at their initial angles
            (`static_equilibrium`); or a Simulation, for modes about its present state.
        n: largest number of modes to return.
        formulation, options: formulation and options of the solver, as in `simulate`; only for a Scene.
        spin: spin rate, rad/s, about the root of a pinned Scene without gravity; the scene's loads are not used. The
            modes are small motions, in the rotating frame, about the steady rotation. Centrifugal forces deform the arm
            in the steady rotation.
        clamped: which joints are held. False: no joint is held; all joints turn under constant torques, except
            prescribed and rigid joints. True: the hub (joint 0) is held. A list: the joints with these indices are
            held. A held joint with an elastic gear is held at its motor. Coulomb friction is not included.
    Returns:
        The modes (`Modes`).
    Raises:
        ValueError: an argument is invalid. NoEquilibrium: the Scene has no equilibrium.
    Warns:
        UnstableEquilibrium: the Scene's equilibrium is unstable although the joints are held.
    """
    n = check.integer("n", n, minimum=1)
    spin = check.number("spin", spin, "rad/s")
    scene = target.scene if isinstance(target, Simulation) else check.instance("target", target, Scene)
    if isinstance(target, Scene) and spin != 0.0 and (scene.root != "pinned" or scene.gravity is not None):
        raise check.InvalidValue("spin", spin, "needs a pinned root and no gravity, or there is no steady rotation")
    held = _held(clamped, scene.arm.n_links)
    equations, point, rest = FINDERS[scene.axes](target, formulation, options, spin, held)
    if rest is not None:
        warn_unstable(rest, refuse=False)
    keep, reduced = moving(equations, held), equations.reduced(point, spin)
    values, vectors = eigenpairs(*(np.ascontiguousarray(part) for part in reduced.among(keep)))
    order = np.argsort(np.abs(values), kind="stable")[:n]
    eigenvalues = values[order]
    seen = [_shape(equations, point.q, reduced.lift[:, keep] @ vector) for vector in vectors.T[order]]
    size = np.abs(eigenvalues)
    damping = np.where(size > 0.0, -eigenvalues.real / np.maximum(size, 1e-300), 0.0) + 0.0  # no -0.0
    frequencies = np.where(np.abs(eigenvalues.imag) > 1e-9 * size, size, 0.0)
    points = equations.points(point.q)
    shapes = np.array([one for one, _ in seen]).reshape(-1, *points.shape)
    whirl = np.array([one for _, around in seen for one in around])
    return Modes(frequencies, damping, eigenvalues, shapes, points, spin, growing(values), whirl)


Found = tuple[Equations, Point, Stability | None]
"""An arm's equations, a point of the arm's motion, and for a Scene the stability of its equilibrium with all joints
held."""


def _point_in_space(
    target: Simulation | Scene, formulation: str | None, options: dict[str, Any], spin: float, held: list[int]
) -> Found:
    """Return the equations, the operating point and the stability for the modes of an arm in space."""
    if isinstance(target, Simulation):
        simulation = simulation_of(target, formulation, options)
        if spin != 0.0 or simulation.work.v.any():
            raise check.InvalidValue("spin", spin, "must be given with a Scene; a Simulation in space must be at rest")
        return *at_rest_of(simulation), None
    if spin == 0.0:
        found = static_equilibrium(target, formulation, require_stable=False, **options)
        equations, point = at_rest_of(found)
        return equations, point, at_rest(equations, point, list(range(target.arm.n_links)))
    scene = still(target, True, position=(0.0, 0.0), loads=(), space=True)
    equations, point = at_rest_of(Simulation(scene, target.settings(formulation, **options), False))
    return equations, _steady_rotation(equations, point, held, spin), None


def _point_in_plane(
    target: Simulation | Scene, formulation: str | None, options: dict[str, Any], spin: float, held: list[int]
) -> Found:
    """Return the equations, the operating point and the stability for the modes of an arm in the plane."""
    if isinstance(target, Simulation):
        if spin != 0.0:
            raise check.InvalidValue("spin", spin, "must be given with a Scene; a Simulation brings its own motion")
        equations = Equations(simulation_of(target, formulation, options))
        return equations, point_of(at_start(target, equations.model)[1]), None
    moved: dict[str, Any] = {"position": (0.0, 0.0), "loads": ()} if spin != 0.0 else {}
    equations, start = at_rest_of(Simulation(still(target, True, **moved), target.settings(formulation, **options)))
    v, a = equations.rotating(start.q, spin)
    joints = equations.inputs.tolist()
    point, _ = find_rest(equations, replace(start, v=v, a=a), joints, spin)
    rest = at_rest(equations, point, joints) if spin == 0.0 else None
    _check_rotors(target, held)
    return equations, point, rest


FINDERS = {"xy": _point_in_plane, "xyz": _point_in_space}
"""Functions by the axes along which an arm moves."""


def _steady_rotation(equations: Equations, start: Point, held: list[int], spin: float) -> Point:
    """Return the steady rotation (spin, rad/s) of an arm in space near the start, found by Newton's iteration.

    Raises:
        NoEquilibrium: Newton's iteration does not converge.
    """
    rows = equations.free[equations.independent[moving(equations, held)]]
    q, weight, ways = start.q, equations.model.weight[rows], equations.unit(rows)
    for _ in range(50):
        v, a = equations.rotating(q, spin)
        point = replace(start, q=q, v=v, a=a)
        frame = equations.frame(point, spin)
        K = equations.along(point, q=ways, v=frame.V @ ways, a=frame.W @ ways)[rows]
        d = np.asarray(-np.linalg.solve(K, equations.residual(point)[rows]), np.float64)
        largest = float(np.abs(d * weight).max())
        if not largest < 1e3:
            break
        q = equations.moved(q, ways @ (min(1.0, 0.3 / max(largest, 1e-300)) * d))
        if largest < 1e-10:
            v, a = equations.rotating(q, spin)
            return replace(start, q=q, v=v, a=a)
    raise NoEquilibrium("no steady rotation was found: the spin may be too large for the arm's stiffness")


def _held(clamped: bool | Sequence[int], links: int) -> list[int]:
    """Return the indices of the held joints."""
    if isinstance(clamped, bool):
        return [0] if clamped else []
    joints = check.sequence("clamped", clamped, "joint indices")
    for i, joint in enumerate(joints):
        check.integer(f"clamped[{i}]", joint, minimum=0, maximum=links - 1)
    return list(joints)


def _check_rotors(scene: Scene, held: list[int]) -> None:
    """Raise ValueError if the motor of an elastic gear has no inertia and is neither held nor prescribed."""
    for k, joint in enumerate(scene.arm.joints):
        if joint.elastic and joint.rotor == 0.0 and k not in held and scene.motion_of(f"motor{k}") is None:
            what = "must be positive (kg m^2): its motor is neither held nor prescribed"
            raise check.InvalidValue(f"arm.joints[{k}].motor_inertia", joint.motor_inertia, what)


def _shape(equations: Equations, q: Array, vector: Complex) -> tuple[Array, tuple[float, ...]]:
    """Return displacements of points along the chain for a complex mode of the movable coordinates, and the whirl.

    The displacements are those at the phase of the largest one; their largest length is 1. The whirl (see `Modes`) is
    () in the plane, and NaN if the points do not move across the first joint's axis.
    """
    weight, free = equations.model.weight, equations.free
    whole = np.zeros(equations.n, np.complex128)
    whole[free] = vector / max(float(np.abs(vector * weight[free]).max()), 1e-300)
    real, imaginary = equations.points_along(q, np.stack([whole.real, whole.imag], axis=1))
    change = real + 1j * imaginary
    largest = change.ravel()[np.abs(change).argmax()]
    seen = (change * (np.conj(largest) / max(abs(largest), 1e-300))).real
    shape = np.asarray(seen / max(float(np.sqrt((seen**2).sum(axis=1)).max()), 1e-300))
    if len(shape.T) == 2:
        return shape, ()
    # angular momentum of the points' ellipses about the axis, over their size
    arm = equations.simulation.scene.arm
    axis = mount_of(arm, 0) @ axis_of(arm, 0)
    across = change - np.outer(change @ axis, axis)
    around = -float(np.cross(across.conj(), across).imag.sum(axis=0) @ axis)
    moved_by, least = float((np.abs(across) ** 2).sum()), 1e-6 * arm.total_length  # less is round-off
    return shape, (around / moved_by if moved_by > least**2 else np.nan,)
