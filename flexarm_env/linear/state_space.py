"""State-space models of an arm about a point of its motion: continuous, or discrete with constant torques."""

from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import validation as check
from ..equations import Equations, Point
from ..parameters import Link
from ..physics.assembly import smooth
from ..physics.gauges import Spot
from ..scene import Scene
from ..simulation import Simulation
from ..validation import Array
from .point import ArmAtPoint
from .stability import eigenpairs, growing

METHODS = ("solver", "zoh")


@dataclass(frozen=True)
class LinearModel:
    """Linear model x' = rate + A (x - x0) + B (u - u0), y = y0 + C (x - x0) + D (u - u0).

    In a continuous model x' is the time derivative of x; in a discrete model x' is x(t + dt). The operating point x0,
    u0, y0 is in the attributes x, u, y. `A, B, C, D = model` unpacks the matrices.

    Attributes:
        A (2n, 2n), B (2n, m), C (p, 2n), D (p, m): matrices of the model.
        states: names of the states, in SI units: n independent coordinates ("joint0", ...), then their rates
            ("joint0_rate", ...). In space the states of a section's rotation ("link0.rx1", ...) are a rotation
            increment, which is 0 at the operating point, and the angular velocity, both in the section's own axes.
        inputs: names of the inputs: "torque0", ..., the torques, N m, of all joints that can turn and have no
            prescribed motion. With the option `motions`, further inputs are the accelerations of prescribed
            coordinates, "joint0_acceleration", ..., rad/s^2 or m/s^2.
        outputs: names of the outputs: joint angles "joint0", ... (rad) and their rates; deflections "deflection0", ...
            (displacement of each link's tip normal to the tangent at its root, m) and their rates; "tip_x", "tip_y"
            (m). Elastic gears add "motor0", "motor0_rate", ...; the argument `gauges` adds "curvature0@0", ... (1/m).
            In space the deflections are "deflection0_y" and "deflection0_z" (m), and "twist0" (rad) and "tip_z" (m) are
            added; gauges are also named "curvature_z0@0" (bending in the x-z plane) and "torsion0@0".
        x, u, y: states, inputs and outputs at the operating point. rate: x' at the operating point; in a discrete model
            the state one period after this point.
        t: time of the operating point, s. dt: period, s; None for a continuous model.
        growing: number of unstable modes of the continuous model with free joints; 0 if the model is stable.
            Eigenvalues of A that would be 0 without round-off do not count.
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
        """Eigenvalues of A: rad/s in a continuous model, dimensionless factors per period in a discrete model."""
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
    """Compute the linear model of an arm about a point of its motion.

    Args:
        target: a Simulation, which is linearized at its present state and remains unchanged; or a Scene, which is
            linearized at its initial state. `static_equilibrium` returns a Simulation at rest under gravity.
        formulation, options: formulation and options of the solver, as in `simulate`; only for a Scene.
        discrete: period, s, during which the torques are constant; None for the continuous model.
        method: method for discrete models. "solver" computes the derivative of the solver's steps along the motion in
            one period; the steps have equal length, at most the setting dt. "zoh" (zero-order hold) computes the matrix
            exponential of the continuous model.
        motions: True to include prescribed coordinates and their rates as states, and their accelerations as inputs
            (continuous model, or method "zoh"). If False, the model does not contain prescribed coordinates.
        gauges: one pair (link, place) for each curvature among the outputs, with the place from 0 at the link's root to
            1 at its tip. A strain is the curvature times half the thickness of the link. In space each gauge has a
            third entry, one of `sensors.MEASURES`, which selects bending in a plane or torsion.
    Returns:
        The linear model (`LinearModel`), which does not include Coulomb friction.
    Raises:
        ValueError: an argument is invalid, or an input of the scene is discontinuous within the period.
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
        what = 'must be "zoh" on a base that floats: derivatives of the steps neglect the conservation of momentum'
        raise check.InvalidValue("method", method, what)
    scene = simulation.scene
    if motions:
        scene.axes.check_planar("motions", True, "must be False in space")
    if motions and (simulation.drive.known < 0).any():
        what = "must be False where multipliers join bodies: they prescribe the joints"
        raise check.InvalidValue("motions", motions, what)
    places = _places(gauges, scene.arm.links, scene.axes.measures)
    about = ArmAtPoint(simulation, stepping, motions)
    A, B, rate = about.A, about.B, about.rate
    if discrete is not None:
        A, B, rate = about.period(discrete) if stepping else _over(discrete, A, B, rate, about.x)
    names, y, C = about.outputs(places)
    return LinearModel(
        A, B, C, np.zeros((len(names), B.shape[1])),
        states=(*about.names, *(f"{name}_rate" for name in about.names)), inputs=about.inputs, outputs=names,
        x=about.x, u=about.u, y=y, rate=rate, t=simulation.t, dt=discrete, growing=growing(eigenpairs(*about.still)[0]),
    )  # fmt: skip


def _places(gauges: object, links: Sequence[Link], measures: Sequence[str]) -> list[Any]:
    """Validate the links and places of gauges, and return them.

    measures: what gauges may measure; a place names it if there is a choice.
    """
    found: list[Any] = []
    for i, entry in enumerate(check.sequence("gauges", gauges, "pairs (link, place)")):
        count = 3 if len(measures) > 1 and isinstance(entry, list | tuple) and len(entry) == 3 else 2
        link, place, *more = check.sequence(f"gauges[{i}]", entry, "a link and a place from 0 to 1", count)
        link = check.integer(f"gauges[{i}][0]", link, minimum=0, maximum=len(links) - 1)
        if links[link].rigid:
            raise check.InvalidValue(f"gauges[{i}][0]", link, "must be a flexible link: this one is rigid")
        place = check.number(f"gauges[{i}][1]", place, minimum=0.0, maximum=1.0)
        found.append((link, place, *(check.choice(f"gauges[{i}][2]", what, measures) for what in more)))
    return found


def simulation_of(
    target: Simulation | Scene, formulation: str | None, options: dict[str, Any], period: float | None = None
) -> Simulation:
    """Return the target if it is a Simulation; for a Scene create a Simulation at its initial state.

    period: duration, s. The time step of the new Simulation is period / k with an integer k; None: no condition.
    """
    if isinstance(target, Simulation):
        given = options if formulation is None else {"formulation": formulation, **options}
        for name, value in given.items():
            raise check.InvalidValue(name, value, "must not be given with a Simulation, which brings its own settings")
        return target
    scene = check.instance("target", target, Scene)
    return Simulation(scene, target.settings(formulation, **options).dividing(period), False)


def without_friction(simulation: Simulation) -> Simulation:
    """Return the simulation, with Coulomb friction removed if it has any, because friction has no derivative."""
    model = smooth(simulation.model)
    if model is simulation.model:
        return simulation
    view = copy(simulation)
    view.model = model
    return view


def held(A: Array, B: Array, dt: float) -> tuple[Array, Array]:
    """Discretize the matrices A and B of a continuous model over a period dt, s, with constant inputs."""
    from scipy.linalg import expm

    n, m = B.shape
    block = np.zeros((n + m, n + m))
    block[:n, :n], block[:n, n:] = A, B
    power = expm(block * dt)
    return power[:n, :n], power[:n, n:]


def _over(dt: float, A: Array, B: Array, rate: Array, x0: Array) -> tuple[Array, Array, Array]:
    """Return the continuous model over a period with constant input, and the state after the period."""
    A, moved = held(A, np.column_stack([B, rate]), dt)
    return A, moved[:, :-1], x0 + moved[:, -1]


def state_of(simulation: Simulation) -> Array:
    """Return the state of a Simulation in the order of `LinearModel.states`, (2n,), SI."""
    equations = _in_plane(simulation)
    return np.concatenate(equations.state(simulation.work.q, simulation.work.v))


def _in_plane(simulation: Simulation) -> Equations:
    """Return the equations of an arm in the plane; ValueError for one in space."""
    scene = check.instance("simulation", simulation, Simulation).scene
    what = "must be a scene in the plane; in space there are `linearize`, `modes` and `static_equilibrium`"
    scene.axes.check_planar("scene", scene.name, what)
    return Equations(simulation)


def set_state(simulation: Simulation, x: Array) -> None:
    """Set the state of a Simulation to x (2n,), in the order of `LinearModel.states`.

    The function computes the dependent coordinates from x. Raises ValueError if x has the wrong size or is not finite,
    and RuntimeError if no configuration of the arm has this state.
    """
    equations = _in_plane(simulation)
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
