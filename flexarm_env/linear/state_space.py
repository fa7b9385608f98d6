"""State space of an arm about a point of its motion, continuous, or over one period with the torques held."""

from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import validation as check
from ..compiler import SINGLE, uncompiled
from ..parameters import Link
from ..physics.assembly import smooth
from ..physics.gauges import Spot, curvature_rows
from ..physics.integrator.work import Work, unpack
from ..physics.layout import POSE, ROOT, ROOT_RATES, TIP, TIP_RATES
from ..scene import Scene
from ..sensors import MEASURES
from ..simulation import Simulation
from ..trajectory import link_deflection
from ..validation import Array
from .equations import Equations, Point, Reduced, exact_slopes, slopes
from .period import point_of, solved
from .space_model import linear_parts
from .stability import eigenpairs, growing

METHODS = ("solver", "zoh")


@dataclass(frozen=True)
class LinearModel:
    """x' = rate + A (x - x0) + B (u - u0), y = y0 + C (x - x0) + D (u - u0); with dt, x(t + dt) stands for x'.

    `A, B, C, D = model` unpacks the matrices.

    Attributes:
        A (2n, 2n), B (2n, m), C (p, 2n), D (p, m).
        states: n independent coordinates, then their rates: "joint0", ..., "joint0_rate", ...; SI. In space they are
            those of the tangent space: of a rotation ("link0.rx1", ...) increments in the section's own axes, from 0 at
            the point, and its angular velocity there.
        inputs: torques of the joints that can turn and are not prescribed, "torque0", ..., N m; with `motions` then the
            accelerations of prescribed coordinates, "joint0_acceleration", ..., rad/s^2 or m/s^2.
        outputs: "joint0" ... (rad), their rates, "deflection0" ... (each link's tip normal to its root's tangent, m),
            their rates, "tip_x", "tip_y" (m); behind elastic gears "motor0", "motor0_rate", ...; and what `gauges` asks
            for, "curvature0@0", ... (1/m). In space "deflection0_y", "deflection0_z", "twist0" (rad), "tip_z";
            "curvature_z0@0" in x-z, "torsion0@0".
        x, u, y: the point of the motion. rate: x' there; with dt, the state one period later.
        t: its time, s. dt: period, s, or None (continuous).
        growing: how many motions of the continuous model grow about the point, joints free; 0 where it is stable. The
            round-off of A's eigenvalues (a stiff beam's zero ones) does not count here.
    """

    A: Array
    B: Array
    C: Array
    D: Array
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    x: Array = field(repr=False)
    u: Array = field(repr=False)
    y: Array = field(repr=False)
    rate: Array = field(repr=False)
    t: float
    dt: float | None
    growing: int = 0

    def __iter__(self) -> Iterator[Array]:
        return iter((self.A, self.B, self.C, self.D))

    @property
    def eigenvalues(self) -> NDArray[np.complex128]:
        """Of A: rad/s (continuous) or multipliers of one period."""
        return np.asarray(np.linalg.eigvals(self.A), np.complex128)


def linearize(
    target: Simulation | Scene,
    formulation: str | None = None,
    *,
    discrete: float | None = None,
    method: str = "solver",
    motions: bool = False,
    gauges: Sequence[Spot] = (),
    **options: Any,
) -> LinearModel:
    """The linear model of an arm about a point of its motion.

    Args:
        target: a Simulation, taken at the state, torques and parameters it has now (it is not changed); or a Scene,
            taken at its start (`static_equilibrium` gives a Simulation at rest under gravity).
        formulation, options: of a Scene, as for `simulate`.
        discrete: period, s, over which the torques are held; None for the continuous model.
        method: "solver": the derivative of what the solver does in a period (accelerations afresh, then steps of at
            most the settings' dt), along the motion; "zoh": the exponential of the continuous model.
        motions: True: prescribed coordinates and their rates are states, their accelerations inputs (continuous, or
            method "zoh"); False: they are neither.
        gauges: (link, place from 0 at its root to 1 at its tip) of curvatures among the outputs; times half the
            thickness they are strains. In space a third entry says what of `sensors.MEASURES`.
    Returns:
        The LinearModel. Coulomb friction is left out.
    Raises:
        ValueError: a value that is not allowed, or a kink of the scene within the period.
        RuntimeError: the solver fails within the period.
    """
    check.choice("method", method, METHODS)
    if discrete is not None:
        discrete = check.number("discrete", discrete, "s", above=0.0)
    if not isinstance(motions, bool):
        raise check.InvalidValue("motions", motions, "must be True or False")
    stepping = discrete is not None and method == "solver"
    if motions and stepping:
        raise check.InvalidValue("method", method, "must be 'zoh' where motions are inputs of a discrete model")
    simulation = without_friction(simulation_of(target, formulation, options, discrete if stepping else None))
    if stepping and simulation.scene.floats:
        what = 'must be "zoh" on a base that floats: how steps keep its momentum is in no derivative of them'
        raise check.InvalidValue("method", method, what)
    if simulation.scene.spatial:
        return _in_space(simulation, discrete, stepping, motions, gauges)
    if motions and (simulation.drive.known < 0).any():
        what = "must be False where multipliers join bodies: they prescribe the joints"
        raise check.InvalidValue("motions", motions, what)
    equations = Equations(simulation, stepping, driven=motions)
    flat, w = at_start(simulation, equations.model)
    start = point_of(w)
    reduced = equations.reduced(start)
    n, m = equations.independent.size, equations.inputs.size
    x0 = np.concatenate(equations.state(start.q, start.v))
    driven = equations.driven
    accelerations, moved = reduced.accelerations_of(driven)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [accelerations[:, : 2 * n]]])
    B = np.vstack([np.zeros((n, m + driven.size)), np.hstack([accelerations[:, 2 * n :], moved])])
    rate = np.concatenate([x0[n:], equations.state(start.q, start.a)[1]])  # joint angles are linear in q
    if discrete is not None and method == "zoh":
        A, B, rate = _held(A, B, rate, x0, discrete)
    elif discrete is not None:
        A, B, rate = solved(simulation, equations, flat, w, reduced, discrete)
    names, y0, C = _outputs(equations, start, reduced)
    if gauges:
        places = _places(gauges, simulation.scene.arm.links)
        rows = curvature_rows(simulation.scene, simulation.settings, simulation.system, places)
        names += tuple(f"curvature{link}@{place:g}" for link, place in places)
        y0, own = np.concatenate([y0, rows @ start.q]), rows[:, equations.free] @ reduced.lift
        C = np.vstack([C, np.hstack([own, np.zeros_like(own)])])
    free = [i for i in range(n) if i not in driven]
    return LinearModel(
        A, B, C, np.zeros((len(names), B.shape[1])),
        states=(*equations.names, *(f"{name}_rate" for name in equations.names)),
        inputs=(
            *(f"torque{k}" for k in equations.inputs), *(f"{equations.names[i]}_acceleration" for i in driven)
        ),
        outputs=names,
        x=x0, u=np.concatenate([start.u[equations.inputs], equations.state(start.q, start.a)[1][driven]]),
        y=y0, rate=rate, t=simulation.t, dt=discrete, growing=growing(eigenpairs(reduced, free)[0]),
    )  # fmt: skip


def _in_space(
    simulation: Simulation, discrete: float | None, stepping: bool, motions: bool, gauges: Sequence[Spot]
) -> LinearModel:
    """`linearize` of an arm in space."""
    if motions:
        raise check.InvalidValue("motions", True, "must be False in space")
    flat, w = at_start(simulation, simulation.model)
    spots = _places(gauges, simulation.scene.arm.links, True)
    model = LinearModel(**linear_parts(simulation, flat, w, discrete if stepping else None, spots))
    if discrete is None or stepping:
        return model
    A, B, rate = _held(model.A, model.B, model.rate, model.x, discrete)
    return replace(model, A=A, B=B, rate=rate, dt=discrete)


def _places(gauges: object, links: Sequence[Link], space: bool = False) -> list[Any]:
    """Checked places of gauges."""
    found: list[Any] = []
    for i, entry in enumerate(check.sequence("gauges", gauges, "pairs (link, place)")):
        count = 3 if space and isinstance(entry, list | tuple) and len(entry) == 3 else 2
        link, place, *more = check.sequence(f"gauges[{i}]", entry, "a link and a place from 0 to 1", count)
        link = check.integer(f"gauges[{i}][0]", link, minimum=0, maximum=len(links) - 1)
        if links[link].rigid:
            raise check.InvalidValue(f"gauges[{i}][0]", link, "must be a link that bends: this one is rigid")
        place = check.number(f"gauges[{i}][1]", place, minimum=0.0, maximum=1.0)
        found.append((link, place, *(check.choice(f"gauges[{i}][2]", what, MEASURES) for what in more)))
    return found


def simulation_of(
    target: Simulation | Scene, formulation: str | None, options: dict[str, Any], period: float | None = None
) -> Simulation:
    """The target itself, or a Simulation of the scene at its start, in steps that divide a period, s."""
    if isinstance(target, Simulation):
        given = options if formulation is None else {"formulation": formulation, **options}
        for name, value in given.items():
            raise check.InvalidValue(name, value, "must not be given with a Simulation, which brings its own settings")
        return target
    scene = check.instance("target", target, Scene)
    return Simulation(scene, target.settings(formulation, **options).dividing(period), False)


def without_friction(simulation: Simulation) -> Simulation:
    """The simulation, or a view of it without Coulomb friction, which has no derivative."""
    model = smooth(simulation.model)
    if model is simulation.model:
        return simulation
    view = copy(simulation)
    view.model = model
    return view


def at_start(simulation: Simulation, model: Any) -> tuple[Array, Work]:
    """A copy of the simulation's state, consistent at t+ by the model: its work array and the views of it."""
    work, n_motions = simulation.work, simulation.n_motions
    flat: Array = np.zeros(sum(view.size for view in work))
    w: Work = uncompiled(unpack)(SINGLE, model, flat, n_motions)
    w.q[:], w.v[:], w.u[:], w.psi[:] = work.q, work.v, work.u, work.psi
    simulation.make_consistent(model, simulation.drive, flat)
    return flat, w


def _held(A: Array, B: Array, rate: Array, x0: Array, dt: float) -> tuple[Array, Array, Array]:
    """The continuous model over a period with the input held."""
    from scipy.linalg import expm

    n, m = B.shape
    block = np.zeros((n + m + 1, n + m + 1))
    block[:n, :n], block[:n, n : n + m], block[:n, -1] = A, B, rate
    power = expm(block * dt)
    return power[:n, :n], power[:n, n : n + m], x0 + power[:n, -1]


def _outputs(equations: Equations, point: Point, reduced: Reduced) -> tuple[tuple[str, ...], Array, Array]:
    """Names, values, and derivatives by the state of the outputs."""
    links = range(equations.n_links)

    def outputs(q: Array, v: Array) -> Array:
        poses = equations.poses(q, v)
        angles, rates = equations.joint_angles(q, v)
        cos, sin, spin = np.cos(poses[:, POSE.angle]), np.sin(poses[:, POSE.angle]), poses[:, POSE.rate]
        (dx, dy, _), (vx, vy, _) = (poses[:, TIP] - poses[:, ROOT]).T, (poses[:, TIP_RATES] - poses[:, ROOT_RATES]).T
        turning = cos * vy - sin * vx - spin * (cos * dx + sin * dy)
        motors = [x[row] for row in equations.motors.values() for x in (q, v)]
        return np.concatenate([angles, rates, link_deflection(poses), turning, poses[-1, TIP][:2], motors])

    q, v = point.q, point.v
    by_q = slopes(lambda x: outputs(x, v), q, equations.free, equations.steps)
    by_v = exact_slopes(lambda x: outputs(q, x), v, equations.free)
    names = [f"{what}{k}{end}" for what in ("joint", "deflection") for end in ("", "_rate") for k in links]
    C = np.hstack([by_q @ reduced.lift + by_v @ reduced.drift, by_v @ reduced.lift])
    names += ["tip_x", "tip_y", *(f"motor{k}{end}" for k in equations.motors for end in ("", "_rate"))]
    return tuple(names), outputs(q, v), C


def state_of(simulation: Simulation) -> Array:
    """The state of a Simulation in the order of `LinearModel.states`, (2n,), SI."""
    equations = Equations(check.instance("simulation", simulation, Simulation))
    return np.concatenate(equations.state(simulation.work.q, simulation.work.v))


def set_state(simulation: Simulation, x: Array) -> None:
    """Give a Simulation the state x (2n,), in the order of `LinearModel.states`; dependent coordinates follow.

    Raises ValueError where x has the wrong size or is not finite, RuntimeError where no position of the arm has it.
    """
    equations = Equations(check.instance("simulation", simulation, Simulation))
    n, w = equations.independent.size, simulation.work
    x = check.floats("x", x, f"{2 * n} finite numbers")
    if x.shape != (2 * n,) or not np.isfinite(x).all():
        raise check.InvalidValue("x", x, f"must be {2 * n} finite numbers")
    free, lam = equations.free, equations.algebraic
    zero = np.zeros(equations.n)
    for _ in range(30):
        point = Point(w.q, zero, zero, w.u, w.psi)
        G = equations.constraint_slopes(point)
        change = np.vstack([G, equations.changes(w.q, np.eye(free.size))])
        missing = np.concatenate([-equations.residual(point)[lam], x[:n] - equations.state(w.q, zero)[0]])
        move = np.linalg.solve(change, missing)
        w.q[free] += move
        if np.abs(move * simulation.model.weight[free]).max() < 1e-13:
            break
    else:
        raise RuntimeError("no position of the arm with this state was found: it is too far from the present one")
    w.v[free] = 0.0  # prescribed rates remain
    drift = equations.residual(Point(w.q, w.v, zero, w.u, w.psi), 1)[lam]
    w.v[free] = np.linalg.solve(change, np.concatenate([-drift, x[n:] - equations.state(w.q, w.v)[1]]))
    simulation.set_torques(w.u[: equations.n_links].copy())
