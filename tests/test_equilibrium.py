"""Equilibria: statics by hand and by elliptic integrals, stability, what has no answer."""

from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import ellipe, ellipk

from flexarm_env.linear import NoEquilibrium, UnstableEquilibrium, linearize, modes, static_equilibrium
from flexarm_env.parameters import Arm, Elbow, Link, Payload, Section
from flexarm_env.scene import JointTorque, PointLoad, Scene
from flexarm_env.time_functions import constant
from tests.linear_tools import EXACT, FULL, at_rest, one_link, two_links
from tests.scene_tools import every

STUBBY = Section(EI=2.0, EA=1e5, C=60.0, m=1.0, J=1e-4)
"""With L = 1.5, shear is a twentieth of the deflection."""


@every(FULL, slow=("geometrically_exact",))
def test_cantilever_under_an_end_load(formulation: str, options: dict[str, Any]) -> None:
    P, L = 1e-4, 1.5
    scene = at_rest(one_link(STUBBY, L), loads=(PointLoad(0, "tip", force_y=constant(-P)),))
    simulation = static_equilibrium(scene, formulation, **options)
    shear = 0.0 if formulation == "elastica" else P * L / STUBBY.C
    assert simulation.observe()[0][0, 7] == pytest.approx(-(P * L**3 / (3 * STUBBY.EI) + shear), rel=1e-6)
    assert simulation.joint_torques() == pytest.approx([P * L], rel=1e-6)
    assert np.abs(linearize(simulation).rate).max() < 1e-6


@pytest.mark.parametrize(("P", "w", "u"), [(1.0, 0.30172, 0.05643), (10.0, 0.81061, 0.55500)])
@every([("floating_frame", {"segments": 16}), EXACT, ("elastica", {"nodes": 8})], slow=("geometrically_exact",))
def test_large_deflection(P: float, w: float, u: float, formulation: str, options: dict[str, Any]) -> None:
    """Tip of a cantilever under a dead end load, by elliptic integrals: Mattiasson, IJNME 17 (1981), 145-153."""
    scene = at_rest(one_link(), loads=(PointLoad(0, "tip", force_y=constant(P)),))
    simulation = static_equilibrium(scene, formulation, **options)
    tip = simulation.observe()[0][0]
    assert [tip[7], 1.0 - tip[6]] == pytest.approx([w, u], abs=1e-3)
    assert simulation.joint_torques() == pytest.approx([-P * (1.0 - u)], rel=2e-3)


@every(FULL, slow=("elastica", "geometrically_exact"))
def test_arm_held_against_gravity_stays(formulation: str, options: dict[str, Any]) -> None:
    arm = two_links(elbows=(Elbow(0.2, 0.01, 0.01),), payload=Payload(0.1))
    scene = at_rest(arm, gravity=(0.0, -0.5), angles=(0.3, -0.4))
    simulation = static_equilibrium(scene, formulation, **options)
    start = simulation.observe()[0]
    assert start[:, 2] - np.array([0.0, start[0, 8]]) == pytest.approx([0.3, -0.7], abs=1e-12)
    assert simulation.advance_to(0.5)
    assert simulation.observe()[0] == pytest.approx(start, abs=1e-6)
    # all moments about the root, from the positions of the masses along the chain
    points = simulation.shape_points()
    middle = 0.5 * (points[1:] + points[:-1])
    length = np.hypot(*np.diff(points, axis=0).T)
    moment = 0.5 * ((length * middle[:, 0]).sum() + 0.2 * start[0, 6] + 0.1 * start[1, 6])
    assert simulation.joint_torques()[0] == pytest.approx(moment, rel=5e-3)


@every(FULL, slow=("elastica", "geometrically_exact"))
def test_released_arm_finds_its_hanging_place(formulation: str, options: dict[str, Any]) -> None:
    scene = at_rest(two_links(), gravity=(0.0, -0.5), angles=(0.3, -0.4))
    simulation = static_equilibrium(scene, formulation, hold_joints=False, **options)
    poses = simulation.observe()[0]
    assert poses[1, 6:9] == pytest.approx([0.0, -2.0, -np.pi / 2], abs=1e-5)
    assert not simulation.joint_torques().any()


def test_upright_arm_is_an_equilibrium_that_falls() -> None:
    """A rigid rod: eigenvalues +-sqrt(3 g / 2 L) upright, +-i of it hanging."""
    stiff = Section(EI=1e4, EA=1e8, C=1e8, m=1.0, J=1e-6)
    for sign in (1.0, -1.0):
        scene = at_rest(one_link(stiff), gravity=(0.0, -9.81), angles=(sign * np.pi / 2,))
        simulation = static_equilibrium(scene, "floating_frame", hold_joints=False, require_stable=False, segments=2)
        assert simulation.observe()[0][0, 7] == pytest.approx(sign, abs=1e-4)
        assert simulation.stability.smallest == pytest.approx(-sign * 1.5 * 9.81, rel=2e-3)
        assert simulation.stability.stable == (sign < 0.0)
        slowest = modes(simulation, 1 if sign < 0.0 else 2)
        assert abs(slowest.eigenvalues) == pytest.approx(np.sqrt(1.5 * 9.81), rel=1e-3)
        assert slowest.frequencies.all() == (sign < 0.0), "what falls does not oscillate"
        assert sorted(slowest.damping.tolist()) == ([0.0] if sign < 0.0 else [-1.0, 1.0])


COLUMN = [("floating_frame", {"segments": 16}), ("geometrically_exact", {"elements": 8}), ("elastica", {"nodes": 8})]


def column(side: float, share: float = 1.152) -> Scene:
    """A cantilever pushed towards its root by a share of Euler's load, with a share of that across."""
    P = share * np.pi**2 / 4.0
    across = constant(side * P) if side else None
    return at_rest(one_link(), loads=(PointLoad(0, "tip", force_x=constant(-P), force_y=across),))


def buckled(share: float) -> tuple[float, float, float]:
    """Tip x, y and slope of the buckled column, L = 1, by elliptic integrals of k = sin(slope / 2)."""
    root = np.sqrt(share) * np.pi / 2.0
    k = brentq(lambda k: ellipk(k * k) - root, 1e-6, 0.999)
    return 2.0 * ellipe(k * k) / root - 1.0, 2.0 * k / root, 2.0 * np.arcsin(k)


@every(COLUMN, slow=("geometrically_exact", "floating_frame"))
@pytest.mark.parametrize("side", [1e-6, 0.03, -0.03])
def test_a_column_bends_to_the_side_of_its_side_load(side: float, formulation: str, options: dict[str, Any]) -> None:
    simulation = static_equilibrium(column(side), formulation, **options)
    tip = simulation.observe()[0][0, 6:9]
    assert np.sign(tip[1]) == np.sign(side)
    assert simulation.stability.stable and simulation.stability.smallest > 1.0
    assert modes(simulation, 1, clamped=True).growing == 0
    if abs(side) < 1e-3:
        x, y, slope = buckled(1.152)
        assert tip == pytest.approx([x, np.sign(side) * y, np.sign(side) * slope], abs=2e-3)


@every(COLUMN)
def test_an_unstable_column_says_so(formulation: str, options: dict[str, Any]) -> None:
    """Straight beyond Euler's load: the lowest squared frequency is negative, and the linear models say it too."""
    with pytest.warns(UnstableEquilibrium, match=r"unstable: a small disturbance of it grows by exp\(1\.4"):
        simulation = static_equilibrium(column(0.0), formulation, **options)
    assert simulation.observe()[0][0, 7] == pytest.approx(0.0, abs=1e-9)
    assert (simulation.stability.negative, simulation.stability.stable) == (1, False)
    assert modes(simulation, 1, clamped=True).growing == 1
    assert linearize(simulation).growing >= 1
    with pytest.warns(UnstableEquilibrium):
        assert modes(column(0.0), 1, formulation, clamped=True, **options).growing == 1
    with pytest.raises(NoEquilibrium, match="unstable"):
        static_equilibrium(column(0.0), formulation, require_stable=True, **options)
    safe = static_equilibrium(column(0.0, 0.99), formulation, require_stable=True, **options)
    assert safe.stability.stable and safe.followed == 1.0
    assert modes(safe, 1, clamped=True).growing == 0


SOFT = Section(EI=1.0, EA=1e5, C=5e4, m=0.795)
TURNED: dict[str, tuple[tuple[Link, ...], complex, complex]] = {
    "overloaded column": ((Link(1.0, SOFT),), -10.0 + 0.0j, 0.0j),
    "column beside its load": ((Link(1.0, SOFT),), -10.0 + 0.0j, 1e-5j),
    "cantilever": ((Link(1.0, SOFT),), 0.0j, 3.0 - 4.0j),
    "curved": ((Link(1.0, SOFT, curvature=0.8),), -6.0j, 1.0j),
    "two links": ((Link(0.6, SOFT), Link(0.4, SOFT)), 2.0 - 5.0j, 0.5j),
}
"""Links, gravity (m/s^2) and a load at the tip (N) in the arm's own axes."""


@pytest.mark.slow
@every(COLUMN)
@pytest.mark.parametrize("name", TURNED)
def test_the_same_problem_turned_is_the_same_answer(name: str, formulation: str, options: dict[str, Any]) -> None:
    """At six angles: cos(pi/2) = 6e-17 is no side load."""
    links, gravity, force = TURNED[name]
    arm, found = Arm(name, links), []
    for angle in (0.0, np.pi / 2, np.pi, -np.pi / 2, 1e-3, -2.7):
        way = np.exp(1j * angle) if angle else 1.0 + 0.0j
        load, g = force * way, gravity * way
        scene = Scene(
            name, arm, duration=1.0, dt=0.01, angles=(angle,) * len(links), gravity=(g.real, g.imag),
            loads=(PointLoad(len(links) - 1, "tip", constant(load.real), constant(load.imag)),),
        )  # fmt: skip
        rest = static_equilibrium(scene, formulation, require_stable=False, **options)
        x, y, psi = rest.observe()[0][-1, 6:9]
        tip = (x + 1j * y) * np.conj(way)
        found.append([tip.real, tip.imag, psi - angle, *rest.joint_torques(), rest.stability.negative, rest.followed])
    np.testing.assert_allclose(found, np.tile(found[0], (6, 1)), rtol=1e-5, atol=1e-6)
    assert found[0][-2] == (1.0 if name == "overloaded column" else 0.0)


@every([*COLUMN[:2], ("elastica", {"nodes": 12})], slow=("geometrically_exact", "floating_frame"))
@pytest.mark.parametrize("circles", [1, 2])
def test_an_end_moment_winds_the_arm_into_circles(circles: int, formulation: str, options: dict[str, Any]) -> None:
    moment = 2.0 * np.pi * circles  # EI = L = 1: the curvature
    scene = at_rest(one_link(), loads=(PointLoad(0, "tip", torque=constant(moment)),))
    simulation = static_equilibrium(scene, formulation, require_stable=True, **options)
    assert simulation.observe()[0][0, 6:9] == pytest.approx([0.0, 0.0, moment], abs=1e-3)
    assert simulation.joint_torques() == pytest.approx([-moment], rel=1e-4)
    points = simulation.shape_points()
    radius = np.hypot(points[:, 0], points[:, 1] - 1.0 / moment)
    assert radius * moment == pytest.approx(1.0, abs=0.03)
    assert simulation.followed == 1.0


@every(COLUMN, slow=("geometrically_exact", "floating_frame"))
def test_a_start_near_a_ridge_sinks(formulation: str, options: dict[str, Any]) -> None:
    """From 1e-5 rad beside upright Newton's iteration alone ends upright, which is no place to rest."""
    scene = at_rest(one_link(), gravity=(0.0, -0.5), angles=(np.pi / 2 - 1e-5,))
    simulation = static_equilibrium(scene, formulation, hold_joints=False, **options)
    assert simulation.observe()[0][0, 6:8] == pytest.approx([0.0, -1.0], abs=1e-4)
    assert simulation.stability.stable


@every(COLUMN, slow=("geometrically_exact",))
def test_loads_beyond_all_measure_end_in_a_sentence(formulation: str, options: dict[str, Any]) -> None:
    scene = at_rest(one_link(), loads=(PointLoad(0, "tip", torque=constant(1e9)),))
    with pytest.raises(NoEquilibrium, match=r"the loads are too large|larger than a floating body can have"):
        static_equilibrium(scene, formulation, **options)


@pytest.mark.slow
def test_two_links_held_bend_the_way_of_their_load() -> None:
    """A chain with held joints is one beam: the same stable rest, and the elbow's holding torque."""
    P = 1.152 * np.pi**2 / 16.0  # Euler's load of two lengths
    loads = (PointLoad(1, "tip", force_x=constant(-P), force_y=constant(0.03 * P)),)
    tips = []
    for formulation, options in COLUMN:
        simulation = static_equilibrium(at_rest(two_links(), loads=loads), formulation, **options)
        assert simulation.stability.stable
        tips.append(simulation.observe()[0][1, 6:8])
    assert tips[0] == pytest.approx([2 * 0.70102, 2 * 0.62832], abs=2e-3)  # the one link's, twice as long
    assert tips[1] == pytest.approx(tips[0], abs=2e-3) and tips[2] == pytest.approx(tips[0], abs=2e-3)


@pytest.mark.slow
def test_what_has_no_answer_says_so() -> None:
    falling = at_rest(one_link(), root="free", gravity=(0.0, -9.81))
    with pytest.raises(NoEquilibrium, match="nothing holds the arm"):
        static_equilibrium(falling, "floating_frame")
    heavy = at_rest(one_link(), gravity=(0.0, -9.81))
    with pytest.raises(NoEquilibrium, match="beyond the valid range of the reduction to modes"):
        static_equilibrium(heavy, "floating_frame", modes=3)
    turning = at_rest(one_link(), loads=(JointTorque(0, constant(1.0)),))
    with pytest.raises(NoEquilibrium, match="no equilibrium was found: the loads may be too large"):
        static_equilibrium(turning, "floating_frame", hold_joints=False)
