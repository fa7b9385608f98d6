"""Checks of the elastica on plain Python numbers; `test_elastica.py` runs this file with FLEXARM_COMPILER=python.

The kernels are the very ones that are compiled elsewhere; here all sizes and features come at no compile time.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from flexarm_env.compiler import UNCOMPILED
from flexarm_env.compiler.lanes import SINGLE
from flexarm_env.parameters import Arm, Elbow, Link, Payload, Section
from flexarm_env.physics import protocol
from flexarm_env.physics.elastica import equations as kernels
from flexarm_env.physics.elastica.build import build, physical
from flexarm_env.scene import PointLoad, Scene
from flexarm_env.settings import Settings
from flexarm_env.time_functions import constant

from .oracle_elastica import Oracle
from .uncompiled_tools import Equations, States

pytestmark = pytest.mark.skipif(not UNCOMPILED, reason="runs uncompiled only")

ONE, OTHER = Section(EI=3.0, EA=1e6, C=1e6, m=0.5, J=0.02), Section(EI=7.0, EA=7e6, C=2e6, m=0.3, J=0.01)
LINKS = (Link(1.2, ONE), Link(0.8, OTHER), Link(0.5, ONE))
ELBOWS = (Elbow(0.3, 0.02, 0.04), Elbow(0.1, 0.01, 0.05))
GRAVITY = (1.0, -9.0)


def arm(count: int, bare: bool = False) -> Arm:
    payload = Payload() if bare else Payload(0.2, 0.03)
    links, elbows = LINKS[:count], ELBOWS[: count - 1]
    return Arm("arm", links, hub_inertia=0.05, elbows=elbows, payload=payload, tau_d=0.0 if bare else 0.01)


def scene(count: int, root: str, gravity: Any, loads: Any, bare: bool = False) -> Scene:
    one = constant(1.0)
    points = tuple(PointLoad(link, end, one, one, one) for link, end in loads)
    return Scene("s", arm(count, bare), duration=1.0, dt=0.01, root=root, gravity=gravity, loads=points)


def system(s: Scene, n: int, dt: float | None = None) -> Equations:
    return Equations(build(s, Settings.make("elastica", nodes=n, dt=dt)))


CASES = [
    (1, 5, "pinned", None, (), False),
    (1, 4, "pinned", None, (), True),
    (1, 3, "free", GRAVITY, (), True),
    (1, 6, "pinned", GRAVITY, ((0, "tip"),), False),
    (2, 5, "pinned", None, (), False),
    (2, 4, "free", GRAVITY, ((0, "root"), (1, "tip")), False),
    (2, 8, "pinned", GRAVITY, ((0, "tip"), (1, "root")), False),
    (3, 4, "pinned", GRAVITY, (), False),
    (3, 3, "free", None, ((2, "tip"),), True),
]


@pytest.fixture(params=CASES, ids=lambda case: "-".join(str(x) for x in case[:3]))
def case(request: Any) -> tuple[Equations, Oracle, States]:
    count, n, root, gravity, loads, bare = request.param
    where = scene(count, root, gravity, loads, bare)
    s = system(where, n)
    oracle = Oracle(where, n, free=s.n > count * n)
    rng = np.random.default_rng(4)
    q, v, a = rng.normal(size=(3, s.n))
    return s, oracle, (q, v, a, rng.normal(size=s.n_inputs))


def test_residual(case: Any) -> None:
    s, oracle, state = case
    expected = oracle.residual(*state)
    assert s.residual(*state) == pytest.approx(expected, abs=1e-12 * np.abs(expected).max())


def test_tangent_and_solution(case: Any) -> None:
    s, _, state = case
    s.par[:2] *= 1.5  # an arm of its own: in free flight the coordinates are no longer its centre of mass
    weights = 1.3, 0.7, 2.1
    expected = s.tangent(state, weights)
    matrix = s.assembled(state, weights).reshape(s.n, s.n)
    assert matrix == pytest.approx(expected, abs=2e-9 * np.abs(expected).max())
    s.check_solutions(state, (1e4, 1e2, 1.0), [(), (1,)] if s.n > 4 else [(), (0,)], tuple(2.0 * x for x in state))


def test_mass_matrix_is_the_hessian_of_kinetic_energy(case: Any) -> None:
    s, _, (q, v, a, u) = case
    s.par[:2] *= 1.5
    M, E = s.tangent((q, v, 0.0 * a, u), (1.0, 0.0, 0.0)), np.eye(s.n)
    alone = [s.kinetic(q, e) for e in E]
    hessian = [[s.kinetic(q, E[i] + E[j]) - alone[i] - alone[j] for j in range(s.n)] for i in range(s.n)]
    assert pytest.approx(np.array(hessian), abs=1e-12 * np.abs(M).max()) == M


def test_output(case: Any) -> None:
    s, oracle, (q, v, _, u) = case
    kinetic, strain, gravity = kernels.energy(SINGLE, s.model, s.par, q, v)
    assert kinetic == pytest.approx(float(oracle.kinetic(q, v)), rel=1e-12)
    assert strain + gravity == pytest.approx(float(oracle.potential(q)), rel=1e-11)
    lost = 2.0 * float(oracle.dissipation(q, v))
    assert kernels.damping_power(SINGLE, s.model, s.par, q, v, v) == pytest.approx(lost, rel=1e-11)
    y = np.full(len(u), np.nan)
    kernels.input_displacements(SINGLE, s.model, s.par, q, y)
    assert y == pytest.approx(oracle.ports(q), abs=1e-12)
    count = oracle.arm.n_links
    out, points = np.full(12 * count, np.nan), np.full((100, 2), np.nan)
    kernels.link_poses(SINGLE, s.model, s.par, q, v, out)
    walked = oracle.walk(q, v)
    for pose, (at, rate) in zip(out.reshape(count, 12), walked, strict=True):
        parts = [x[name] for end in ("root", "tip") for x in (at, rate) for name in (end, f"{end}_angle")]
        assert pose == pytest.approx(np.concatenate([np.atleast_1d(x) for x in parts]), abs=1e-12)
    used = kernels.centerline(SINGLE, s.model, q, points)
    assert used == 12 * count + 1
    assert points[0] == pytest.approx(walked[0][0]["root"], abs=1e-12)
    assert points[used - 1] == pytest.approx(walked[-1][0]["tip"], abs=1e-12)
    assert np.isnan(points[used:]).all()
    assert protocol.out_of_range(SINGLE, s.model, s.par, q) == 0.0


def test_factor_on_stiffness() -> None:
    """par: payload mass and inertia, factor on EI, tau_d are the arm's own."""
    plain = system(scene(2, "pinned", None, ()), 4)
    bent = Arm(
        "arm",
        tuple(replace(k, section=replace(k.section, EI=1.5 * k.section.EI)) for k in LINKS[:2]),
        hub_inertia=0.05,
        elbows=ELBOWS[:1],
        payload=Payload(0.7, 0.01),
        tau_d=0.03,
    )
    other = system(Scene("s", bent, duration=1.0, dt=0.01), 4)
    q, v, a = np.random.default_rng(5).normal(size=(3, 8))
    u = np.array([0.3, -0.2])
    plain.par[:] = [0.7, 0.01, 1.5, 0.03]
    assert plain.residual(q, v, a, u) == pytest.approx(other.residual(q, v, a, u), rel=1e-12)


def test_correction_of_the_period() -> None:
    """It has no part in rigid motion, and `physical` takes it back."""
    s, plain = system(scene(2, "pinned", None, ()), 5, dt=0.01), system(scene(2, "pinned", None, ()), 5)
    q, v = np.random.default_rng(6).normal(size=(2, 10))
    u, a, zero = np.zeros(2), np.zeros(10), np.zeros(10)
    a[0] = 1.0
    turn = np.concatenate([np.ones(5), [0.0], np.ones(4)])  # both links turn as one: joint 1 keeps its angle
    difference = s.residual(q, v, turn, u) - plain.residual(q, v, turn, u)
    assert difference == pytest.approx(zero, abs=1e-12)
    assert np.abs(s.residual(q, v, a, u) - plain.residual(q, v, a, u)).max() > 1e-4
    back = Equations(replace(s.system, model=physical(s.model)))
    assert back.residual(q, v, a, u) == pytest.approx(plain.residual(q, v, a, u), rel=1e-12)
