"""Floating frames joined by multipliers against an oracle of another derivation, tangents against finite differences.

`test_floating_frame.py` runs this file, on plain Python numbers: the kernels are those that are compiled elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numba import config
from numpy.typing import NDArray

from flexarm_env.compiler.lanes import SINGLE
from flexarm_env.parameters import Arm, Elbow, Link, Payload, Section
from flexarm_env.physics.protocol import REGISTRY, RESIDUAL_ALONE, State, Weights
from flexarm_env.scene import JointTorque, PointLoad, Scene
from flexarm_env.simulation import Simulation
from flexarm_env.time_functions import constant
from tests.physics.oracle_chain import STEP, Chain
from tests.physics.oracle_floating import Oracle, element_fields
from tests.physics.uncompiled_chain import close

pytestmark = pytest.mark.skipif(not config.DISABLE_JIT, reason="runs uncompiled only")

Array = NDArray[np.float64]
MESHES = [(1, 2, "von_karman"), (2, 1, "von_karman"), (1, 3, "paper"), (2, 1, "linear")]


def chain() -> Scene:
    """Three unlike links, a hinge, a rigid joint at an angle, everything lumped that can be, weight and damping."""
    sections = (
        Section(3.0, 40.0, 25.0, 0.7, 0.02),
        Section(2.0, 60.0, 1e3, 0.4, 0.01),
        Section(5.0, 90.0, 70.0, 0.9, 0.0),
    )
    arm = Arm(
        "chain",
        tuple(Link(length, section) for length, section in zip((1.0, 0.8, 0.5), sections, strict=True)),
        hub_inertia=0.03,
        elbows=(Elbow(0.2, 0.01, 0.02), Elbow(0.1, 0.005, 0.004)),
        payload=Payload(0.3, 0.006),
        tau_d=0.04,
        mass_damping=0.3,
    )
    loads = (
        JointTorque(0, constant(0.4)),
        JointTorque(1, constant(-0.3)),
        PointLoad(1, "tip", constant(1.0), constant(2.0), constant(0.5)),
        PointLoad(2, "root", constant(-1.0), constant(0.7), constant(0.2)),
        PointLoad(2, "tip", constant(0.3), constant(0.2), constant(-0.1)),
    )
    start = {"angles": (0.3, -0.2, 1.0), "rigid_joints": (2,), "gravity": (0.5, -9.81)}
    return Scene("chain", arm, duration=1.0, dt=0.01, loads=loads, **start)


class Kernel:
    """The compiled functions of a scene's model, called alone on random states."""

    def __init__(self, scene: Scene, **options: Any) -> None:
        self.simulation = Simulation(scene, scene.settings("floating_frame", multipliers=True, **options))
        self.model, self.par = self.simulation.model, self.simulation.par
        self.functions: dict[str, Callable[..., Any]] = REGISTRY[type(self.model)]
        self.n = int(self.model.n)
        self.constrained = list(self.model.algebraic)
        self.free = [k for k in range(self.n) if k not in self.constrained]

    def state(self, rng: np.random.Generator, size: float = 0.1) -> tuple[Array, Array, Array, Array]:
        """q, v, a, u with deflections of `size`; multipliers in q, none in v and a."""
        q = self.simulation.system.q0 + size * rng.normal(size=self.n)
        v, a = rng.normal(size=self.n), rng.normal(size=self.n)
        q[self.constrained] = rng.normal(size=len(self.constrained))
        v[self.constrained] = a[self.constrained] = 0.0
        return q, v, a, rng.normal(size=self.model.n_inputs)

    def residual(self, q: Array, v: Array, a: Array, u: Array) -> Array:
        """Every entry is written, none of the matrix and its pivots: both start as NaN."""
        r = np.full(self.n, np.nan)
        S = np.full(self.model.n_factor, np.nan)
        self.functions["assemble"](SINGLE, self.model, self.par, State(q, v, a), u, RESIDUAL_ALONE, r, S)
        matrix = S[: self.n * (3 * self.model.half + 2)]
        assert np.isnan(matrix).all(), "the residual alone must leave the matrix as it is"
        r[self.constrained] = 0.0
        return r

    def matrix(self, q: Array, v: Array, a: Array, u: Array, cm: float, cc: float, ck: float) -> Array:
        """The banded tangent, full."""
        m = self.model
        r, S = np.full(self.n, np.nan), np.full(m.n_factor, np.nan)
        self.functions["assemble"](SINGLE, m, self.par, State(q, v, a), u, Weights(cm, cc, ck), r, S)
        width, full = 3 * m.half + 1, np.zeros((self.n, self.n))
        for i in range(self.n):
            columns = np.arange(max(0, i - m.half), min(self.n, i + m.half + 1))
            full[i, columns] = S[i * width + columns - i + m.half]
        return full

    def constraint(self, q: Array, v: Array, a: Array, level: int) -> Array:
        """Constraint rows of a level, at no prescribed motion."""
        r = np.zeros(self.n)
        self.functions["constrain"](SINGLE, self.model, np.zeros(0), State(q, v, a), level, 1.0, r)
        return r[self.constrained]

    def energy(self, q: Array, v: Array) -> Array:
        """Kinetic, strain, gravity."""
        return np.array(self.functions["energy"](SINGLE, self.model, self.par, q, v))


@pytest.fixture(params=MESHES, ids=lambda mesh: "{}x{}-{}".format(*mesh))
def pair(request: pytest.FixtureRequest) -> tuple[Kernel, Oracle]:
    """Package and oracle for one mesh of the chain."""
    segments, elements, coupling = request.param
    scene = chain()
    if segments > 1:  # drag belongs to links of one frame
        scene = replace(scene, arm=replace(scene.arm, mass_damping=0.0))
    kernel = Kernel(scene, segments=segments, elements=elements, coupling=coupling)
    return kernel, Oracle(scene, segments, elements, coupling)


def test_rows_are_those_of_the_oracle(pair: tuple[Kernel, Oracle]) -> None:
    kernel, oracle = pair
    assert kernel.n == oracle.n
    assert kernel.constrained == oracle.constraints(np.zeros(oracle.n))[0]


def test_equations_are_those_of_lagrange(pair: tuple[Kernel, Oracle], rng: np.random.Generator) -> None:
    """Inertia and all quadratic-velocity forces [61]-[63], elasticity, weight, damping, joints, loads."""
    kernel, oracle = pair
    for _ in range(2):
        state = kernel.state(rng)
        assert close(kernel.residual(*state), oracle.residual(*state), 1e-11)


def test_mass_is_the_hessian_of_the_kinetic_energy(pair: tuple[Kernel, Oracle], rng: np.random.Generator) -> None:
    kernel, oracle = pair
    q, v, a, u = kernel.state(rng)
    q[kernel.constrained] = 0.0
    mass = kernel.matrix(q, v, a, u, 1.0, 0.0, 0.0)[np.ix_(kernel.free, kernel.free)]
    assert close(mass, oracle.mass_matrix(q)[np.ix_(kernel.free, kernel.free)], 1e-12)
    assert close(mass, mass.T, 1e-14)
    unit = np.eye(kernel.n)
    single = [kernel.energy(q, unit[k])[0] for k in kernel.free]
    for i, k in enumerate(kernel.free):  # polarisation of a quadratic form is exact
        for j, other in enumerate(kernel.free):
            assert abs(kernel.energy(q, unit[k] + unit[other])[0] - single[i] - single[j] - mass[i, j]) < 1e-12


def test_energies(pair: tuple[Kernel, Oracle], rng: np.random.Generator) -> None:
    kernel, oracle = pair
    q, v, _, _ = kernel.state(rng)
    kinetic, strain, gravity = kernel.energy(q, v)
    assert kinetic == pytest.approx(oracle.kinetic(q, v), rel=1e-12)
    assert gravity == pytest.approx(oracle.gravity(q), rel=1e-12)
    if oracle.coupling != "paper":  # its force has no potential
        assert strain == pytest.approx(oracle.strain(q), rel=1e-12)


def test_dissipation_is_that_of_the_strain_rates(pair: tuple[Kernel, Oracle], rng: np.random.Generator) -> None:
    kernel, oracle = pair
    q, v, _, _ = kernel.state(rng)
    power = kernel.functions["damping_work"](SINGLE, kernel.model, kernel.par, q, v, v)
    assert power == pytest.approx(2.0 * oracle.dissipation(q, v), rel=1e-12)


def test_damping_forces_take_the_dissipated_power(rng: np.random.Generator) -> None:
    """Virtual work: the forces of damping on the rates are the power that is booked, modes and drag included."""
    scene = chain()
    for mesh in ({"segments": 1, "elements": 2}, {"modes": 3}, {"segments": 1, "elements": 2, "coupling": "paper"}):
        damped = Kernel(scene, **mesh)
        free = Kernel(replace(scene, arm=replace(scene.arm, mass_damping=0.0, tau_d=0.0)), **mesh)
        state = damped.state(rng)
        taken = state[1] @ (damped.residual(*state) - free.residual(*state))
        power = damped.functions["damping_work"](SINGLE, damped.model, damped.par, *state[:2], state[1])
        assert taken == pytest.approx(power, rel=1e-10) and power > 0.1


def test_constraints_and_their_rates(pair: tuple[Kernel, Oracle], rng: np.random.Generator) -> None:
    kernel, oracle = pair
    q, v, a, _ = kernel.state(rng)
    step = 1e-5

    def phi(t: float) -> Array:
        return oracle.constraints(q + t * v + 0.5 * t**2 * a)[1]

    assert close(kernel.constraint(q, v, a, 0), phi(0.0), 1e-13)
    assert close(kernel.constraint(q, v, a, 1), (phi(step) - phi(-step)) / (2 * step), 1e-8)
    assert close(kernel.constraint(q, v, a, 2), (phi(step) - 2 * phi(0.0) + phi(-step)) / step**2, 1e-4)


@pytest.mark.parametrize("mesh", [{"segments": 2, "elements": 2}, {"segments": 2, "modes": 3}], ids=str)
def test_velocities_that_joints_allow(mesh: dict[str, int], rng: np.random.Generator) -> None:
    """Residual on the velocities that its constraints allow is that of the chain without: multipliers do no work."""
    scene = chain()
    scene = replace(scene, rigid_joints=(), arm=replace(scene.arm, mass_damping=0.0))
    joined = Kernel(scene, **mesh)
    oracle = Chain(scene, mesh["segments"], mesh.get("elements", 1), modes=mesh.get("modes"))
    starts = joined.model.table[:, 0]

    def absolute(q: Array, v: Array) -> tuple[Array, Array]:
        shape = (*np.broadcast(q[..., 0], v[..., 0]).shape, joined.n)
        places, rates = np.zeros((2, *shape), np.result_type(q, v))
        for at, m in zip(starts, oracle.motion(q, v), strict=True):
            size = m.p.shape[-1]
            for target, values in ((places, (m.X, m.angle, m.p)), (rates, (m.X_rate, m.rate, m.p_rate))):
                target[..., at : at + 2], target[..., at + 2], target[..., at + 3 : at + 3 + size] = values
        return places, rates

    q, v, a = 0.1 * rng.normal(size=oracle.n), rng.normal(size=oracle.n), rng.normal(size=oracle.n)
    u = rng.normal(size=joined.model.n_inputs)
    Q, V = absolute(q, v)
    A = absolute(q + 1j * STEP * v, v + 1j * STEP * a)[1].imag / STEP
    allowed = absolute(q, np.eye(oracle.n))[1]
    assert close(allowed @ joined.residual(Q, V, A, u), oracle.residual(q, v, a, u), 3e-8 if "modes" in mesh else 1e-12)


def test_tangents_are_derivatives(pair: tuple[Kernel, Oracle], rng: np.random.Generator) -> None:
    """cm, cc and ck parts of the iteration matrix, the constraints' curvature included, by central differences."""
    kernel, _ = pair
    check_tangents(kernel, rng)


def test_tangents_of_the_reduction(rng: np.random.Generator) -> None:
    check_tangents(Kernel(chain(), modes=2), rng)


def check_tangents(kernel: Kernel, rng: np.random.Generator) -> None:
    q, v, a, u = kernel.state(rng)
    step, unit = 1e-6, np.eye(kernel.n)

    def slope(which: int, k: int) -> Array:
        up, down = [q.copy(), v.copy(), a.copy()], [q.copy(), v.copy(), a.copy()]
        up[which][k] += step
        down[which][k] -= step
        return np.asarray((kernel.residual(*up, u) - kernel.residual(*down, u)) / (2 * step))

    base = kernel.matrix(q, v, a, u, 1.0, 0.0, 0.0)
    rates, places = kernel.matrix(q, v, a, u, 1.0, 1.0, 0.0) - base, kernel.matrix(q, v, a, u, 1.0, 0.0, 1.0) - base
    for which, matrix in ((2, base), (1, rates), (0, places)):
        wanted = np.array([slope(which, k) for k in range(kernel.n)]).T
        assert close(matrix[np.ix_(kernel.free, kernel.free)], wanted[np.ix_(kernel.free, kernel.free)], 3e-8), which
    # multipliers: Phi_q' from the residual, Phi_q from the constraints
    columns = np.array([slope(0, k) for k in kernel.constrained]).T
    assert close(base[np.ix_(kernel.free, kernel.constrained)], columns[kernel.free], 1e-8)
    zero = np.zeros(kernel.n)
    up = np.array([kernel.constraint(q + step * unit[k], zero, zero, 0) for k in kernel.free])
    down = np.array([kernel.constraint(q - step * unit[k], zero, zero, 0) for k in kernel.free])
    assert close(base[np.ix_(kernel.constrained, kernel.free)], (up - down).T / (2 * step), 1e-8)


def test_reduction_is_lagrangian(rng: np.random.Generator) -> None:
    """Reduced to modes: all forces are d/dt dT/dv - dT/dq + d(U + V)/dq of the model's own energies."""
    scene = chain()
    kernel = Kernel(replace(scene, arm=replace(scene.arm, mass_damping=0.0)), modes=2)
    q, v, a, u = kernel.state(rng)
    q[kernel.constrained], u[:] = 0.0, 0.0
    kernel.par = kernel.par.copy()
    kernel.par[3] = 0.0  # no material damping
    step, unit = 1e-5, np.eye(kernel.n)

    def momentum(q: Array, v: Array) -> Array:
        """dT/dv, exact for a quadratic form."""
        return np.array([0.5 * (kernel.energy(q, v + e)[0] - kernel.energy(q, v - e)[0]) for e in unit])

    wanted = momentum(q, a) + (momentum(q + step * v, v) - momentum(q - step * v, v)) / (2 * step)
    for k in range(kernel.n):
        up, down = kernel.energy(q + step * unit[k], v), kernel.energy(q - step * unit[k], v)
        wanted[k] += (up[1] + up[2] - up[0] - down[1] - down[2] + down[0]) / (2 * step)
    assert close(kernel.residual(q, v, a, u)[kernel.free], wanted[kernel.free], 1e-8)


def test_paths_and_ports(pair: tuple[Kernel, Oracle], rng: np.random.Generator) -> None:
    """Tip poses with their rates, and the displacements that inputs work on."""
    kernel, oracle = pair
    q, v, _, _ = kernel.state(rng)
    poses, ports = np.full((3, 12), np.nan), np.full(kernel.model.n_inputs, np.nan)
    kernel.functions["link_poses"](SINGLE, kernel.model, kernel.par, q, v, poses.reshape(-1))
    kernel.functions["ports"](SINGLE, kernel.model, kernel.par, q, ports)
    last = len(oracle.links) - 1
    assert close(poses[2, 6:9], oracle.position(last, oracle.tips[last], q), 1e-13)
    assert close(poses[2, 9:12], oracle.jacobian(last, oracle.tips[last], q) @ v, 1e-13)
    joints = [poses[k, 2] - (poses[k - 1, 8] if k else 0.0) for k in range(3)]
    assert close(ports[:3], joints, 1e-13)
    assert close(ports[3:6], poses[1, 6:9], 1e-13)
    assert close(ports[6:9], poses[2, :3], 1e-13)


@pytest.mark.parametrize("C", [1e12, 30.0])
def test_element_matrices(C: float) -> None:
    """Eqs. [44], [45], [52], (1.2): closed forms at mu = 1, and integrals of independently derived fields at any mu."""
    from flexarm_env.physics.floating.beam_element import (
        consistent_mass,
        coupling_matrix,
        geometric_matrix,
        linear_stiffness,
    )

    section, length = Section(2.0, 50.0, C, 0.7, 0.03), 1.3
    points, weights = np.polynomial.legendre.leggauss(6)
    mass, stiffness, geometric, coupling = (np.zeros((6, 6)) for _ in range(4))
    third = sum(element_fields(section.EI, C, length, xi)[4] * sign for xi, sign in ((1.0, 1.0), (0.0, -1.0))) / length
    for point, weight in zip(points, weights, strict=True):
        u, v, phi, slope, curvature = element_fields(section.EI, C, length, 0.5 * (1.0 + point))
        dx = 0.5 * weight * length
        mass += dx * (0.7 * (np.outer(u, u) + np.outer(v, v)) + 0.03 * np.outer(phi, phi))
        shear = slope - phi if C < 1e6 else np.zeros(6)  # no shear deformation; the difference is round-off
        stiffness += dx * (section.EI * np.outer(curvature, curvature) + C * np.outer(shear, shear))
        geometric += dx * np.outer(slope, slope)
        stretch = np.outer(phi, slope) - 0.5 * np.outer(phi, phi) + section.EI / section.EA * np.outer(phi, third)
        coupling += dx * (stretch + stretch.T)  # the shear force is -EI phi''
    axial = np.zeros(6)
    axial[[0, 3]] = -1.0, 1.0
    stiffness += section.EA / length * np.outer(axial, axial)
    bending = [1, 2, 4, 5]
    assert close(consistent_mass(section, length), mass, 1e-10)
    assert close(linear_stiffness(section, length), stiffness, 1e-10)
    assert close(geometric_matrix(section, length), geometric[np.ix_(bending, bending)], 1e-9)
    assert close(coupling_matrix(section, length), coupling[np.ix_(bending, bending)], 1e-9)
    if C > 1e6:
        exact = consistent_mass(Section(2.0, 50.0, C, 0.7, 1e-12), length)
        assert exact[1, 1] == pytest.approx(156 * 0.7 * length / 420, rel=1e-9)
        assert exact[2, 5] == pytest.approx(-3 * 0.7 * length**3 / 420, rel=1e-9)


def frequencies(speed: float, elements: int) -> Array:
    """First three of a slender unit cantilever (EI = m = L = 1) turning steadily, rad/s: eigenvalues of the tangent."""
    arm = Arm("cantilever", (Link(1.0, Section(1.0, 1e8, 1e8, 1.0, 1e-10)),))
    scene = Scene("cantilever", arm, duration=1.0, dt=0.1)
    kernel = Kernel(scene, segments=1, elements=elements)
    q, v, zero = kernel.simulation.system.q0.copy(), np.zeros(kernel.n), np.zeros(kernel.n)
    v[2] = speed

    def tangent(cc: float, ck: float) -> tuple[Array, Array]:
        state = q, v, zero, np.zeros(kernel.model.n_inputs)
        return kernel.residual(*state)[3:], kernel.matrix(*state, 1.0, cc, ck)[3:, 3:]

    for _ in range(5):  # the steady shape: stretched
        r, mass = tangent(0.0, 0.0)
        q[3:] -= np.linalg.solve(tangent(0.0, 1.0)[1] - mass, r)
    r, mass = tangent(0.0, 0.0)
    assert np.abs(r).max() < 1e-6 * max(1.0, speed**2)
    gyroscopic, stiffness = tangent(1.0, 0.0)[1] - mass, tangent(0.0, 1.0)[1] - mass
    n = len(mass)
    state = np.block(
        [[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(mass, stiffness), -np.linalg.solve(mass, gyroscopic)]]
    )
    values = np.linalg.eigvals(state)
    assert np.abs(values.real).max() < 1e-6 * np.abs(values.imag).max()
    return np.sort(values.imag[values.imag > 1e-6])[:3]


@pytest.mark.parametrize(
    ("speed", "exact"),
    [
        (0.0, (1.87510407**2, 4.69409113**2, 7.85475744**2)),  # clamped-free
        (2.0, (3.6218, 22.5263, 62.2411)),  # rotating: 24-term Ritz
        (6.0, (4.2632, 26.1290, 66.4134)),
        (12.0, (5.4270, 35.6370, 78.7049)),
    ],
)
def test_frequencies_of_a_turning_cantilever(speed: float, exact: tuple[float, ...]) -> None:
    assert frequencies(speed, 32) == pytest.approx(exact, rel=5e-4)


def test_frequencies_converge_at_second_order() -> None:
    """The stretch of the centrifugal force is constant in an element: first mode 5.472, 5.439, 5.430 at speed 12."""
    first = [float(frequencies(12.0, elements)[0]) for elements in (5, 10, 20)]
    assert first == pytest.approx([5.472, 5.439, 5.430], abs=6e-4)
    coarse, middle, fine = (value - 5.4270 for value in first)
    assert np.log2([coarse / middle, middle / fine]) == pytest.approx(2.0, abs=0.1)
