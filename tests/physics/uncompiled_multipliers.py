"""Multipliers' constraints, their tangents against finite differences, and the matrices of an element.

`test_floating_frame.py` runs this file, on plain Python numbers: the kernels are those that are compiled elsewhere.
"""

from typing import Any

import numpy as np
import pytest

from flexarm_env.compiler import UNCOMPILED
from flexarm_env.compiler.lanes import SINGLE
from flexarm_env.parameters import Link, Section
from flexarm_env.physics.floating.beam_element import Element, coupling_matrix, geometric_matrix, linear_stiffness
from flexarm_env.physics.protocol import State
from flexarm_env.validation import Array
from tests.physics.oracle_bodies import element_fields
from tests.physics.oracle_chain import STEP, Chain
from tests.physics.uncompiled_chain import JOINED, Case, joined, named
from tests.uncompiled_tools import States, close

pytestmark = pytest.mark.skipif(not UNCOMPILED, reason="runs uncompiled only")


class Joined(Case):
    """Three links joined by multipliers."""

    def __init__(self, mesh: dict[str, Any]) -> None:
        mesh = {**mesh, "multipliers": True}
        super().__init__(3, joined(mesh), **mesh)

    def residual(self, q: Array, v: Array, a: Array, u: Array) -> Array:
        """None of the matrix is written: it starts as NaN."""
        S = np.full(self.n_factor, np.nan)
        r = self.with_room(q, v, a, u, S)
        assert np.isnan(S[: self.n * (3 * self.model.half + 2)]).all()
        return r

    def matrix(self, state: States, *weights: float) -> Array:
        """The banded tangent, full."""
        m, S = self.model, self.assembled(state, weights)
        width, full = 3 * m.half + 1, np.zeros((self.n, self.n))
        for i in range(self.n):
            columns = np.arange(max(0, i - m.half), min(self.n, i + m.half + 1))
            full[i, columns] = S[i * width + columns - i + m.half]
        return full

    def constraint(self, q: Array, v: Array, a: Array, level: int) -> Array:
        """Constraint rows of a level, at no prescribed motion."""
        r = np.zeros(self.n)
        self.functions["constraint_residual"](SINGLE, self.model, np.zeros(0), State(q, v, a), level, 1.0, r)
        return r[self.constrained]


MESHES = pytest.mark.parametrize("mesh", JOINED, ids=named)


@MESHES
def test_constraints_and_their_rates(mesh: dict[str, Any]) -> None:
    case = Joined(mesh)
    q, v, a, _ = case.state(size=0.1)
    step = 1e-5

    def phi(t: float) -> Array:
        return case.oracle.gaps(q + t * v + 0.5 * t**2 * a)

    assert close(case.constraint(q, v, a, 0), phi(0.0), case.tolerance)
    assert close(case.constraint(q, v, a, 1), (phi(step) - phi(-step)) / (2 * step), 1e-8)
    assert close(case.constraint(q, v, a, 2), (phi(step) - 2 * phi(0.0) + phi(-step)) / step**2, 1e-4)


@pytest.mark.parametrize("mesh", [{"segments": 2, "elements": 2}, {"segments": 2, "modes": 3}], ids=str)
def test_velocities_that_joints_allow(mesh: dict[str, int], rng: np.random.Generator) -> None:
    """Residual on the velocities that its constraints allow is that of the chain without: multipliers do no work."""
    joined = Case(3, {}, multipliers=True, **mesh)
    oracle = Chain(joined.scene, mesh["segments"], mesh.get("elements", 1), modes=mesh.get("modes"))
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
    u = rng.normal(size=joined.n_inputs)
    Q, V = absolute(q, v)
    A = absolute(q + 1j * STEP * v, v + 1j * STEP * a)[1].imag / STEP
    allowed = absolute(q, np.eye(oracle.n))[1]
    assert close(allowed @ joined.residual(Q, V, A, u), oracle.residual(q, v, a, u), 3e-8 if "modes" in mesh else 1e-12)


@MESHES
def test_tangents_are_derivatives(mesh: dict[str, Any]) -> None:
    """cm, cc and ck parts of the iteration matrix, the constraints' curvature included, by central differences."""
    case = Joined(mesh)
    state = q, _, _, u = case.state(size=0.1)
    h, free, rows = 1e-6, np.ix_(case.free, case.free), case.constrained

    def slope(which: int, k: int, step: float = h) -> Array:
        up, down = [x.copy() for x in state[:3]], [x.copy() for x in state[:3]]
        up[which][k] += step
        down[which][k] -= step
        return np.asarray((case.residual(*up, u) - case.residual(*down, u)) / (2 * step))

    base = case.matrix(state, 1.0, 0.0, 0.0)
    rates, places = case.matrix(state, 1.0, 1.0, 0.0) - base, case.matrix(state, 1.0, 0.0, 1.0) - base
    for which, matrix in ((2, base), (1, rates), (0, places)):
        wanted = np.array([slope(which, k) for k in range(case.n)]).T
        assert close(matrix[free], wanted[free], 3e-8), which
    # multipliers, linear: Phi_q' from the residual, Phi_q from the constraints
    columns = np.array([slope(0, k, 1.0) for k in rows]).T
    assert close(base[np.ix_(case.free, rows)], columns[case.free], 1e-8)
    zero, unit = np.zeros(case.n), np.eye(case.n)
    up, down = (np.array([case.constraint(q + s * unit[k], zero, zero, 0) for k in case.free]) for s in (h, -h))
    assert close(base[np.ix_(rows, case.free)], (up - down).T / (2 * h), 1e-8)
    mass = case.matrix((np.where(np.isin(np.arange(case.n), rows), 0.0, q), *state[1:]), 1.0, 0.0, 0.0)[free]
    assert close(mass, case.oracle.mass_matrix(q)[free], max(1e-12, case.tolerance) if "modes" in mesh else 1e-12)
    assert close(mass, mass.T, 1e-14)


@pytest.mark.parametrize("C", [1e12, 30.0])
def test_element_matrices(C: float) -> None:
    """Eqs. [44], [45], [52], (1.2): closed forms at mu = 1, and integrals of independently derived fields at any mu."""
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
    assert close(Element(Link(length, section), 0, 0.0).mass(), mass, 1e-10)
    assert close(linear_stiffness(section, length), stiffness, 1e-10)
    assert close(geometric_matrix(section, length), geometric[np.ix_(bending, bending)], 1e-9)
    assert close(coupling_matrix(section, length), coupling[np.ix_(bending, bending)], 1e-9)
    if C > 1e6:
        exact = Element(Link(length, Section(2.0, 50.0, C, 0.7, 1e-12)), 0, 0.0).mass()
        assert exact[1, 1] == pytest.approx(156 * 0.7 * length / 420, rel=1e-9)
        assert exact[2, 5] == pytest.approx(-3 * 0.7 * length**3 / 420, rel=1e-9)
