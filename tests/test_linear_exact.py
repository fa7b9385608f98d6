"""Derivatives of the equations of motion of one arm: against differences, closed forms, symmetry."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

import flexarm_env as fx
from flexarm_env import arms
from flexarm_env.compiler import UNCOMPILED
from flexarm_env.equations import at_rest_of
from flexarm_env.equations.differences import derivative, step_along
from flexarm_env.equations.motion import Equations
from flexarm_env.equations.reduced import Point
from flexarm_env.linear import linearize, modes, static_equilibrium
from flexarm_env.simulation import Simulation
from tests.linear_tools import ELASTICA, EXACT, MODES, SEGMENTS
from tests.scene_tools import everything

Array = np.ndarray

pytestmark = pytest.mark.skipif(UNCOMPILED, reason="uncompiled derivatives are differences")

PLANE = {
    "elastica": ELASTICA, "exact": EXACT, "segments": SEGMENTS, "modes": MODES,
    "multipliers": ("floating_frame", {"segments": 2, "multipliers": True}),
}  # fmt: skip
SPACE = {
    "exact": ("geometrically_exact", {"elements": 2}), "segments": ("floating_frame", {"segments": 1}),
    "elastica": ("elastica", {}),
}  # fmt: skip
GEARS = {
    "joints": (fx.Joint(stiffness=200.0, damping=0.02, motor_inertia=1e-5, gear_ratio=50.0, friction_viscous=0.01),) * 2
}  # fmt: skip


def planar(name: str, spatial: bool = False, **arm: Any) -> Simulation:
    """Two slender links with a payload, bent, under gravity."""
    section = fx.Section(EI=5.0, EA=1e5, C=1e4, m=0.4, J=1e-4, EI_y=20.0, C_y=1e4, J_y=1e-4, GJ=5.0)
    own = fx.Arm(
        "two", (fx.Link(0.5, section), fx.Link(0.4, section)), hub_inertia=0.01, payload=fx.Payload(0.1, 1e-4),
        **{"tau_d": 1e-3} | arm,
    )  # fmt: skip
    scene = fx.Scene("s", own, duration=1.0, dt=1e-3, gravity=(0.0, -9.81), angles=(0.4, 0.7), rates=(2.0, -3.0))
    formulation, options = PLANE[name]
    return Simulation(everything(scene), scene.settings(formulation, **options))


def spatial(name: str, **changes: Any) -> Simulation:
    scene = everything(fx.Scene(
        "bent", arms.named("three_dof"), duration=1.0, dt=5e-4, gravity=(0.0, 0.0, -9.81), angles=(0.3, 0.6, 0.9),
        rates=(2.0, -1.5, 3.0), **changes,
    ))  # fmt: skip
    formulation, options = SPACE[name]
    return Simulation(scene, scene.settings(formulation, **options))


def moving(simulation: Simulation, rng: np.random.Generator) -> tuple[Equations, Point]:
    """The arm somewhere near its start, with any rates, accelerations and inputs."""
    equations, w = Equations(simulation), simulation.work
    weight = np.maximum(equations.model.weight, 1e-300)
    free = np.zeros(equations.n)
    free[equations.free] = 1.0
    stiff = 1e-3 if equations.simulation.scene.spatial else 1e-2
    q = equations.moved(w.q, free * stiff * rng.normal(size=equations.n) / weight * (weight > 1e-300))
    v, a = (size * free * rng.normal(size=equations.n) / weight for size in (3.0, 20.0))
    return equations, Point(q, v, a, rng.normal(size=len(w.u)), w.psi.copy())


CASES = [
    pytest.param(planar, name, {}, marks=[] if name == "elastica" else [pytest.mark.slow], id=f"plane, {name}")
    for name in PLANE
] + [
    pytest.param(planar, "exact", GEARS, marks=pytest.mark.slow, id="plane, exact, gears"),
    *(pytest.param(spatial, name, {}, marks=pytest.mark.slow, id=f"space, {name}") for name in SPACE),
]  # fmt: skip


@pytest.mark.parametrize(("kind", "name", "changes"), CASES)
def test_columns_are_those_of_differences(kind: Any, name: str, changes: Any, rng: np.random.Generator) -> None:
    """Along random directions of coordinates, rates, accelerations and inputs at once, of poses, and of points."""
    equations, point = moving(kind(name, **changes), rng)
    n, m, weight = equations.n, 3, np.maximum(equations.model.weight, 1e-300)
    q, v, a = np.zeros((3, n, m))
    for x, size in ((q, 1.0), (v, 3.0), (a, 20.0)):
        x[equations.free] = size * rng.normal(size=(equations.free.size, m)) / weight[equations.free, None]
    u = rng.normal(size=(len(point.u), m))
    levels = (0, 1, 2) if equations.algebraic.size else (0,)
    for level in levels:
        found = equations.along(point, q, v, a, u, level)
        for j in range(m):

            def moved(t: float, j: int = j, level: int = level) -> Array:
                there = Point(
                    equations.moved(point.q, t * q[:, j]), point.v + t * v[:, j], point.a + t * a[:, j],
                    point.u + t * u[:, j], point.psi,
                )  # fmt: skip
                return equations.residual(there, level)

            step = 0.3 * step_along(q[:, j], equations.model.weight)
            known = derivative(moved, step)
            rows = equations.algebraic if level else slice(None)
            scale = np.abs(known[rows]).max()
            assert np.abs((found[:, j] - known)[rows]).max() < 1e-8 * scale, (level, j)
    *_, poses, _ = equations.poses_along(point.q, point.v, q, v)
    for j in range(m):

        def posed(t: float, j: int = j) -> Array:
            return equations.poses(equations.moved(point.q, t * q[:, j]), point.v + t * v[:, j])

        known = derivative(posed, step_along(q[:, j], equations.model.weight))
        assert np.abs(poses[j] - known).max() < 1e-8 * np.abs(known).max(), j
    points = equations.points_along(point.q, q)
    for j in range(m):

        def drawn(t: float, j: int = j) -> Array:
            return equations.points(equations.moved(point.q, t * q[:, j]))

        known = derivative(drawn, step_along(q[:, j], equations.model.weight))
        assert np.abs(points[j] - known).max() < 1e-8 * np.abs(known).max(), j


@pytest.mark.parametrize(
    ("kind", "name"),
    [(planar, "elastica"), *(pytest.param(planar, name, marks=pytest.mark.slow) for name in ("exact", "segments"))]
    + [pytest.param(spatial, name, marks=pytest.mark.slow) for name in SPACE],
)  # fmt: skip
def test_inertia_and_stiffness_at_rest_are_symmetric(kind: Any, name: str) -> None:
    """Inertia anywhere; stiffness where weight, elasticity and holding torques, which have a potential, balance."""
    scene = kind(name).scene
    scene = dataclasses.replace(scene, rates=(0.0,) * scene.arm.n_links)
    formulation, options = (PLANE if kind is planar else SPACE)[name]
    rest = static_equilibrium(scene, formulation, **options)
    equations, point = at_rest_of(rest)
    M, _, K = equations.reduced(point).among(range(equations.independent.size))
    size = np.sqrt(M.diagonal())
    assert np.abs((M - M.T) / np.outer(size, size)).max() < 1e-13
    assert np.abs(K - K.T).max() < 1e-9 * np.abs(K).max()
    assert np.linalg.eigvalsh(M / np.outer(size, size)).min() > 0.0


@pytest.mark.slow
def test_a_rigid_pendulum() -> None:
    """omega^2 = m g c / I about the hinge, to round-off; a torque accelerates it by 1 / I."""
    m, c, inertia, g = 1.7, 0.35, 0.08, 9.81
    link = fx.RigidLink(1.0, m, (c, 0.0, 0.0), inertia)
    arm = fx.Arm("p", (link,), hub_axis=(0.0, 1.0, 0.0))
    scene = fx.Scene("p", arm, duration=1.0, dt=1e-3, gravity=(0.0, 0.0, -g), angles=(math.pi / 2.0,))
    about = inertia + m * c * c
    (frequency,) = modes(static_equilibrium(scene, hold_joints=False), 1).frequencies
    assert frequency == pytest.approx(math.sqrt(m * g * c / about), rel=1e-11)
    model = linearize(scene)
    row = model.states.index("joint0_rate")
    assert model.B[row, 0] == pytest.approx(1.0 / about, rel=1e-13)
    assert model.A[row, model.states.index("joint0")] == pytest.approx(-m * g * c / about, rel=1e-12)


@pytest.mark.slow
def test_a_continuous_model_in_space_has_the_arm_s_own_inertia() -> None:
    """Not the one by which an elastica corrects the period of its steps: eigenvalues do not depend on the step."""
    found = []
    for dt in (5e-4, 2e-2):
        scene = dataclasses.replace(spatial("elastica").scene, dt=dt, rates=(0.0, 0.0, 0.0))
        model = linearize(Simulation(scene, scene.settings("elastica"), False))
        found.append(np.sort(np.abs(model.eigenvalues)))
    np.testing.assert_allclose(found[0][8:], found[1][8:], rtol=1e-9)
