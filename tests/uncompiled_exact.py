"""Checks of the exact beam on plain Python numbers; `test_exact_beam.py` runs this file with FLEXARM_COMPILER=python.

The kernels are the very ones that are compiled elsewhere; here all orders, damping and gravity come at no compile time.
"""

import dataclasses
import itertools
from typing import Any

import numpy as np
import pytest
from numpy.polynomial import legendre

from flexarm_env.compiler import UNCOMPILED
from flexarm_env.compiler.lanes import SINGLE
from flexarm_env.parameters import Arm, Elbow, Link, Payload, Section
from flexarm_env.physics.exact import equations as kernels
from flexarm_env.physics.exact.build import build
from flexarm_env.physics.exact.layout import ELEMENT_FACTORS
from flexarm_env.physics.exact.output import restore_strains
from flexarm_env.physics.exact.tables import interior, tables
from flexarm_env.scene import PointLoad, Scene
from flexarm_env.settings import Settings
from flexarm_env.time_functions import constant
from tests.uncompiled_tools import Equations, States

pytestmark = pytest.mark.skipif(not UNCOMPILED, reason="runs uncompiled only")

SOFT = Section(EI=3.0, EA=50.0, C=30.0, m=0.7, J=0.2)
OTHER = Section(EI=2.0, EA=40.0, C=20.0, m=0.5, J=0.1)


VARIED = (
    Link(1.3, [(0.0, SOFT), (0.4, SOFT), (0.4, OTHER), (1.0, SOFT), (1.3, OTHER)]),
    Link(0.8, OTHER),
    Link.tapered(0.5, (0.2, 0.1), (0.1, 0.05), E=4e3, rho=40.0, G=1e3),
)
"""A link that jumps and kinks, one alike all along, and a taper."""

RIGID = tuple(
    dataclasses.replace(
        link, root_offset=0.2, tip_offset=0.3, root_mass=0.1, tip_mass=0.2, root_inertia=0.03, tip_inertia=0.02
    )
    for link in (Link(1.3, SOFT), VARIED[0], Link(0.5, SOFT))
)
"""Links with rigid ends."""


def system(order: int, damped: bool, heavy: bool, links: Any = None) -> Equations:
    arm = Arm(
        "three",
        links or (Link(1.3, SOFT), Link(0.8, OTHER), Link(0.5, SOFT)),
        hub_inertia=0.3,
        elbows=(Elbow(0.2, 0.1, 0.05), Elbow(0.3, 0.02, 0.04)),
        payload=Payload(0.4, 0.06),
        tau_d=0.05 if damped else 0.0,
    )
    loads = tuple(
        PointLoad(link, end, constant(1.0), constant(1.0), constant(1.0)) for link, end in ((1, "root"), (2, "tip"))
    )
    scene = Scene(
        "s", arm, duration=1.0, dt=0.01, root="free", angles=(0.0, 0.3, -0.4), loads=loads,
        gravity=(0.5, -9.8) if heavy else None,
    )  # fmt: skip
    return Equations(build(scene, Settings.make("geometrically_exact", elements=2, order=order, dt=0.01)))


def states(s: Equations) -> States:
    rng = np.random.default_rng(3)
    q = s.system.q0 + 0.1 * rng.normal(size=s.n)
    return q, rng.normal(size=s.n), rng.normal(size=s.n), rng.normal(size=s.n_inputs)


@pytest.mark.parametrize("order", [1, 2, 3])
def test_tables(order: int) -> None:
    t = tables(order)
    x = np.linspace(-1.0, 1.0, 7)
    assert np.allclose(t.value[:2].sum(0), 1.0)
    if order > 1:
        assert np.abs(interior(order, np.array([-1.0, 1.0]))).max() < 1e-15
        # together with the linear functions they span all polynomials of the order
        basis = np.vstack([1 - x, 1 + x, interior(order, x)])
        powers = np.vander(x, order + 1)
        assert np.linalg.matrix_rank(np.column_stack([basis.T, powers]), tol=1e-9) == order + 1
    points, weights = legendre.leggauss(8)
    values = np.vstack([0.5 * (1 - points), 0.5 * (1 + points), interior(order, points)])
    assert np.allclose(t.mass, (values * weights) @ values.T, atol=1e-14)
    assert np.allclose((t.slope * t.weights) @ t.slope.T, np.diag(t.norm), atol=1e-14)
    at, h = legendre.leggauss(order)[0], 1e-6
    if order > 1:
        slopes = (interior(order, at + h) - interior(order, at - h)) / h
        assert np.allclose(t.slope[1:], slopes, atol=1e-8)
    inner = 3 * (order - 1)
    at = ELEMENT_FACTORS.offsets(0, order)
    assert at.condensed == sum(1 + (inner - 1 - m) + 6 for m in range(inner))
    assert (at.circle - at.condensed, at.end - at.circle) == (21, 2 * order)


@pytest.mark.parametrize("order", [1, 2, 3])
@pytest.mark.parametrize(
    ("damped", "heavy", "links"),
    [*itertools.product([False, True], [False, True], [None]), (False, True, VARIED), (True, True, VARIED),
     (True, True, RIGID)],
)  # fmt: skip
def test_tangent_solves_what_differences_of_the_residual_say(order: int, damped: bool, heavy: bool, links: Any) -> None:
    """Pinned or not; links with rigid ends where nothing moves, where their tangent is complete."""
    s = system(order, damped, heavy, links)
    n = s.n
    q, v, a, u = states(s)
    if damped:  # the term that would make the tangent unsymmetric is left out: it vanishes with the rates
        v = np.zeros(n)
    if links is RIGID:
        a, u = np.zeros(n), 0.0 * u
    pins: list[tuple[int, ...]] = [(), (0, 1), (2,), (0, 1, 2), (n - 1,), (n - 2, 0, 1), (n - 2, n - 1)]
    T = s.check_solutions((q, v, a, u), (3.0, 0.7, 1.3), pins, states(s))
    assert links is RIGID or np.abs(T - T.T).max() < 1e-6


@pytest.mark.parametrize("order", [1, 2, 3])
@pytest.mark.parametrize("links", [None, VARIED, RIGID])
def test_forces_are_the_gradient_of_the_energy(order: int, links: Any) -> None:
    s = system(order, damped=False, heavy=True, links=links)
    q, v, _, u = states(s)
    zero, unit = np.zeros(s.n), np.eye(s.n)

    def potential(x: Any) -> float:
        energies = kernels.energy(SINGLE, s.model, s.par, x, zero)
        return float(energies[1] + energies[2])

    def work(x: Any) -> float:
        y = np.full(len(u), np.nan)
        kernels.input_displacements(SINGLE, s.model, s.par, x, y)
        return float(u @ y)

    h = 1e-5
    gradient = np.array(
        [(potential(q + h * e) - potential(q - h * e) - work(q + h * e) + work(q - h * e)) / (2 * h) for e in unit]
    )
    assert np.allclose(s.residual(q, zero, zero, u), gradient, atol=1e-7)
    M = s.tangent((q, v, zero, u), (1.0, 0.0, 0.0))
    assert np.isclose(s.kinetic(q, v), 0.5 * v @ M @ v, rtol=1e-12)
    assert np.linalg.eigvalsh(M).min() > 0.0


@pytest.mark.parametrize("links", [None, VARIED])
def test_mass_is_the_hessian_of_the_kinetic_energy_of_the_fields(links: Any) -> None:
    """Kinetic energy by quadrature over r(s), psi(s), by 6 Gauss points an element (of varying ones a fine sum)."""
    s = system(2, damped=False, heavy=False, links=links)
    rng = np.random.default_rng(5)
    v = rng.normal(size=s.n)
    x, weights = legendre.leggauss(6)
    if links:
        x, weights = np.linspace(-1.0, 1.0, 40001)[:-1] + 2.5e-5, np.full(40000, 5e-5)
    values = np.vstack([0.5 * (1 - x), 0.5 * (1 + x), interior(2, x)])
    energy, row = 0.0, 0
    for k, (length, section) in enumerate(((1.3, SOFT), (0.8, OTHER), (0.5, SOFT))):
        edges = [0.0, 0.5 * length, length] if not links or k > 0 else [0.0, 0.4, length]  # the jump's place
        for e in range(2):
            size = edges[e + 1] - edges[e]
            if links:
                section = links[k].along(edges[e] + 0.5 * size * (1.0 + x))
            left, inner, right = v[row : row + 3].copy(), v[row + 3 : row + 6], v[row + 6 : row + 9]
            if e == 0 and k > 0:
                left[2] += v[-3 + k]
            field = np.array([left, right, inner]).T @ values
            factor = 0.5 * size * weights
            energy += 0.5 * float((section.m * factor * (field[0] ** 2 + field[1] ** 2)).sum())
            energy += 0.5 * float((section.J * factor * field[2] ** 2).sum())
            row += 6
    hinges = (12, 24)
    energy += 0.5 * 0.3 * v[2] ** 2 + 0.5 * (0.4 * (v[36] ** 2 + v[37] ** 2) + 0.06 * v[38] ** 2)
    for k, (row, mass, left_inertia, right_inertia) in enumerate(
        zip(hinges, (0.2, 0.3), (0.1, 0.02), (0.05, 0.04), strict=True)
    ):
        energy += 0.5 * (mass * (v[row] ** 2 + v[row + 1] ** 2) + left_inertia * v[row + 2] ** 2)
        energy += 0.5 * right_inertia * (v[row + 2] + v[39 + k]) ** 2
    assert np.isclose(s.kinetic(s.system.q0, v), energy, rtol=1e-8 if links else 1e-12)


@pytest.mark.parametrize("order", [1, 2, 3])
@pytest.mark.parametrize("links", [None, VARIED, RIGID])
def test_power_is_what_the_energy_gains(order: int, links: Any) -> None:
    """v'r(q, v, a) along any motion: inertia forces of the second order in the rates among them."""
    s = system(order, damped=False, heavy=True, links=links)
    q, v, a, u = states(s)

    def total(t: float) -> float:
        return float(sum(kernels.energy(SINGLE, s.model, s.par, q + t * v + 0.5 * t * t * a, v + t * a)))

    h = 1e-5
    gained = (total(h) - total(-h)) / (2.0 * h)
    assert np.isclose(v @ s.residual(q, v, a, 0.0 * u), gained, rtol=1e-6)


@pytest.mark.parametrize("order", [1, 2, 3])
@pytest.mark.parametrize("links", [None, VARIED, RIGID])
def test_damping_takes_the_power_that_it_reports_and_none_from_rigid_motion(order: int, links: Any) -> None:
    s = system(order, damped=True, heavy=False, links=links)
    q, v, a, u = states(s)
    loss = kernels.damping_power(SINGLE, s.model, s.par, q, v, v)
    assert loss > 0.0
    without = system(order, damped=False, heavy=False, links=links)
    assert np.isclose(loss, v @ (s.residual(q, v, a, u) - without.residual(q, v, a, u)), rtol=1e-9)
    spin = np.zeros_like(q)  # the whole chain turns about the origin: positions (interior ones too) and angles
    nodes = 3 * order * 2 * 3 + 3
    if links is RIGID:  # the root turns about itself; interior positions turn too, vertices by where they are
        return
    spin[0:nodes:3], spin[1:nodes:3] = -q[1:nodes:3], q[0:nodes:3]
    for row in range(0, nodes, 3 * order):
        spin[row + 2] = 1.0
    assert abs(kernels.damping_power(SINGLE, s.model, s.par, q, spin, spin)) < 1e-12 * loss


@pytest.mark.parametrize("order", [1, 2, 3])
def test_first_guess_keeps_the_strains(order: int) -> None:
    s = system(order, damped=False, heavy=False)
    q = states(s)[0]
    turned = q.copy()
    nodes = 3 * order * 2 * 3 + 3
    turned[2:nodes:3] += 0.05 * np.random.default_rng(2).normal(size=len(turned[2:nodes:3]))
    turned[-2:] += 0.03
    angles = turned[2:nodes:3].copy()
    restore_strains(SINGLE, s.model, q, turned)
    assert np.array_equal(turned[2:nodes:3], angles)
    assert np.array_equal(turned[:2], q[:2])
    zero = np.zeros_like(q)
    straight = Section(EI=1e-12, EA=50.0, C=30.0, m=1.0)
    arm = Arm("a", (Link(1.3, straight), Link(0.8, straight), Link(0.5, straight)))
    scene = Scene("s", arm, duration=1.0, dt=0.01, root="free")
    bare = build(scene, Settings.make("geometrically_exact", elements=2, order=order, dt=0.01))
    before, after = (float(kernels.energy(SINGLE, bare.model, bare.par, x, zero)[1]) for x in (q, turned))
    assert np.isclose(before, after, rtol=1e-8)


def test_shape_and_poses() -> None:
    s = system(2, damped=False, heavy=False)
    points, out = np.full((20, 2), np.nan), np.full(36, np.nan)
    assert kernels.centerline(SINGLE, s.model, s.system.q0, points) == 13
    assert kernels.centerline(SINGLE, s.model, s.system.q0, np.zeros((5, 2))) == 5
    v = np.arange(s.n) * 0.1
    kernels.link_poses(SINGLE, s.model, s.par, s.system.q0, v, out)
    ends = np.array([0.0, 0.0]), np.array([1.3, 0.0])
    assert np.allclose(points[0], ends[0])
    assert np.allclose(points[4], ends[1])
    assert np.allclose(np.diff(points[:5], axis=0), [0.325, 0.0])
    third = ends[1] + 0.8 * np.array([np.cos(0.3), np.sin(0.3)])
    assert np.allclose(points[8], third)
    assert np.allclose(out[12:15], [1.3, 0.0, 0.3])
    assert np.allclose(out[17], v[14] + v[39])
    assert np.allclose(out[30:33], [*(third + 0.5 * np.array([np.cos(0.4), -np.sin(0.4)])), -0.4])
    assert np.allclose(out[33:36], v[36:39])
