"""The rigid arm in the plane and in space: kinematics, inertia, weight, Coriolis torques and inverse kinematics."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from flexarm_env import arms
from flexarm_env.geometry.inverse import angles_at, approach, goal_angles
from flexarm_env.parameters import Arm, Elbow, Joint, Link, Payload, RigidLink, Section
from flexarm_env.rigid import (
    _coriolis,
    bodies,
    coriolis,
    frames,
    inertia_beyond,
    jacobian,
    link_bodies,
    mass_moments,
    rigid_inertia,
    tip_at,
    weight_and_inertia,
)
from tests.differences import central

SECTION = Section(EI=2.0, EA=1e6, C=1e6, m=1.0, J=0.002, EI_y=3.0, C_y=1e6, J_y=0.003, GJ=1.0)
GRAVITY = np.array([1.0, -9.0, -3.0])


def drawn(seed: int, space: bool, bent: bool) -> Arm:
    """Return a random arm of two or three links; bent: with curved links."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 4))
    axes = rng.normal(size=(n, 3)) if space else np.array([[0.0, 0.0, 1.0]] * n)
    tensor = ((0.03, 0.01, 0.0), (0.01, 0.04, 0.005), (0.0, 0.005, 0.05)) if space else 0.02
    ends: dict[str, Any] = {"root_offset": 0.05, "tip_offset": 0.04, "root_mass": 0.2, "tip_mass": 0.1}
    links: list[Link] = [
        Link(float(rng.uniform(0.4, 1.0)), SECTION, curvature=float(rng.uniform(-1.0, 1.0)) if bent else 0.0, **ends)
        for _ in range(n)
    ]
    if space:
        links[0] = RigidLink(0.3, mass=1.2, centre=(0.1, 0.02, -0.03), inertia=tensor)
    elbows = tuple(Elbow(mass=0.3, inertia_left=tensor, inertia_right=0.01, axis=tuple(a)) for a in axes[1:].tolist())
    return Arm(
        "drawn", tuple(links), hub_inertia=tensor, elbows=elbows, hub_axis=tuple(axes[0].tolist()),
        payload=Payload(mass=0.5, inertia=tensor, offset=(0.1, 0.06, 0.04) if space else (0.1, 0.06)),
        joints=tuple(Joint(motor_inertia=0.01 * (k + 1)) for k in range(n)), torque_limits=(9.0,) * n,
    )  # fmt: skip


ARMS = [drawn(seed, space, bent) for seed in range(3) for space in (False, True) for bent in (False, True)]


def posture(arm: Arm, seed: int = 0) -> Any:
    return np.random.default_rng(seed).uniform(-2.0, 2.0, (2, arm.n_links))


def places(arm: Arm, angles: Any) -> list[Any]:
    """Return the position of each body's center of mass, m, inertial axes."""
    roots, _, links, _ = frames(arm, angles)
    return [roots[k] + links[k] @ body.centre for k, body in bodies(arm)]


# ------------------------------------------------------------------ kinematics
@pytest.mark.parametrize("arm", ARMS)
def test_jacobian_is_the_derivative_of_the_tip(arm: Arm) -> None:
    angles, n = posture(arm)[0], arm.n_links
    slope = central(lambda s: tip_at(arm, angles + s * np.eye(n)), 1e-4, 4).T
    assert jacobian(arm, angles) == pytest.approx(slope, abs=1e-9)


def test_tip_of_a_curved_arm_in_the_plane() -> None:
    """Closed form: the chord of an arc of radius R that turns by beta is R (sin beta, 1 - cos beta)."""
    curvature, length = 0.8, 1.1
    arm = Arm("arc", (Link(length, SECTION, curvature=curvature), Link(0.7, SECTION)))
    angles, beta = np.array([0.4, -0.9]), curvature * length
    chord = (math.sin(beta) + 1j * (1.0 - math.cos(beta))) / curvature
    tip = chord * np.exp(0.4j) + 0.7 * np.exp(1j * (0.4 + beta - 0.9))
    assert tip_at(arm, angles) == pytest.approx([tip.real, tip.imag, 0.0], abs=1e-14)


# -------------------------------------------------------------------- dynamics
@pytest.mark.parametrize("arm", ARMS)
def test_inertia_is_the_kinetic_energy_of_the_bodies(arm: Arm) -> None:
    """Velocities of the bodies' centers and spins of their axes by differences, rotors beside them."""
    angles, rates = posture(arm)
    centers = central(lambda s: np.array(places(arm, angles + s * rates)), 1e-4, 4)
    turning = central(lambda s: frames(arm, angles + s * rates)[2], 1e-4, 4)
    energy = sum(0.5 * arm.joint(k).rotor * rates[k] ** 2 for k in range(arm.n_links))
    for (k, body), velocity in zip(bodies(arm), centers, strict=True):
        spin = frames(arm, angles)[2][k].T @ turning[k]  # A' A_dot = omega^, link axes
        omega = np.array([spin[2, 1], spin[0, 2], spin[1, 0]])
        energy += 0.5 * body.mass * velocity @ velocity + 0.5 * omega @ body.inertia @ omega
    assert 0.5 * rates @ rigid_inertia(arm, angles[None])[0] @ rates == pytest.approx(energy, rel=1e-9)


@pytest.mark.parametrize("arm", ARMS)
def test_weight_is_the_slope_of_the_potential_energy(arm: Arm) -> None:
    angles, n = posture(arm)[0], arm.n_links

    def potential(s: float) -> Any:
        masses = [body.mass for _, body in bodies(arm)]
        return np.array([-np.dot(masses, np.array(places(arm, angles + s * e)) @ GRAVITY) for e in np.eye(n)])

    assert weight_and_inertia(arm, GRAVITY, angles[None])[0][0] == pytest.approx(central(potential, 1e-4, 4), rel=1e-8)


@pytest.mark.parametrize("arm", ARMS)
def test_coriolis_torques_follow_from_the_inertia(arm: Arm) -> None:
    """Lagrange: (dM/dt) v - 1/2 grad (v' M v), by differences of the inertia matrix."""
    angles, rates = posture(arm)
    grown = central(lambda s: rigid_inertia(arm, (angles + s * rates)[None])[0], 1e-4, 4) @ rates

    def energies(s: float) -> Any:
        return np.einsum("knm,n,m->k", rigid_inertia(arm, angles + s * np.eye(arm.n_links)), rates, rates)

    expected = grown - 0.5 * central(energies, 1e-4, 4)
    found = coriolis(arm, angles[None], rates[None])[0]
    assert found == pytest.approx(expected, abs=1e-8 * np.abs(expected).max())


@pytest.mark.parametrize("arm", [*(a for a in ARMS if not a.spatial), arms.named("two_link_geared")])
def test_sums_of_the_plane_are_those_of_the_recursion(arm: Arm) -> None:
    angles, rates = np.random.default_rng(2).uniform(-2.0, 2.0, (2, 5, arm.n_links))
    gravity = np.array([2.0, -9.0, 0.0])
    weight, inertia = weight_and_inertia(arm, gravity, angles)
    assert rigid_inertia(arm, angles) == pytest.approx(inertia, rel=1e-12, abs=1e-14)
    assert coriolis(arm, angles, rates) == pytest.approx(_coriolis(arm, angles, rates), rel=1e-10, abs=1e-13)
    # holding torques by the first moments: Im of conj(g) sum_k S_k exp(i alpha_k) over the links beyond a joint
    turns = np.array([0.0, *(link.turn for link in arm.links[:-1])])
    parts = mass_moments(arm) * np.exp(1j * np.cumsum(angles + turns, axis=1))
    pulled = (np.conj(parts) * complex(*gravity[:2])).imag
    assert weight == pytest.approx(-np.flip(np.cumsum(np.flip(pulled, 1), 1), 1), rel=1e-12, abs=1e-13)


def test_two_uniform_links_have_the_inertia_of_the_textbook() -> None:
    """Siciliano et al. 2009, sec. 7.3.2: two rods about their joints, and h = -m2 a1 l2 sin(theta_2)."""
    a, b, m = 0.8, 0.5, SECTION.m
    arm = Arm("rods", (Link(a, Section(EI=1.0, EA=1.0, C=1.0, m=m)), Link(b, Section(EI=1.0, EA=1.0, C=1.0, m=m))))
    m1, m2, theta, rates = m * a, m * b, 0.7, np.array([[0.4, -1.1]])
    c, far = math.cos(theta), m2 * b**2 / 3.0
    M = [[m1 * a**2 / 3.0 + m2 * (a**2 + a * b * c) + far, far + m2 * a * b * c / 2.0], [0.0, far]]
    M[1][0] = M[0][1]
    assert rigid_inertia(arm, np.array([[0.3, theta]]))[0] == pytest.approx(np.array(M), rel=1e-13)
    h, (u, v) = -0.5 * m2 * a * b * math.sin(theta), rates[0]
    expected = [h * v * v + 2.0 * h * u * v, -h * u * u]
    assert coriolis(arm, np.array([[0.3, theta]]), rates)[0] == pytest.approx(expected, rel=1e-13)


def test_masses_beside_a_rigid_link_count_for_inertia_beyond_its_joint() -> None:
    """m (x^2 + y^2) + I_zz of a rigid link about the z axis of its joint."""
    link = RigidLink(0.4, mass=2.0, centre=(0.1, 0.3, 0.2), inertia=0.05)
    arm = Arm("block", (link,), hub_axis=(0.0, 0.0, 1.0))
    assert inertia_beyond(arm, 0) == pytest.approx(2.0 * (0.01 + 0.09) + 0.05, rel=1e-14)
    assert rigid_inertia(arm, np.zeros((1, 1)))[0, 0, 0] == pytest.approx(inertia_beyond(arm, 0), rel=1e-14)


def test_bodies_of_a_link_together_have_its_mass() -> None:
    for arm in ARMS:
        assert sum(body.mass for body in link_bodies(arm)) == pytest.approx(arm.mass, rel=1e-14)


def test_angles_of_another_shape_are_refused() -> None:
    with pytest.raises(ValueError, match=r"^shape of angles = \(1, 1\): must be \(n, 2\): one per joint"):
        rigid_inertia(Arm("two", (Link(0.5, SECTION), Link(0.4, SECTION))), np.zeros((1, 1)))


# ---------------------------------------------------------- inverse kinematics
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("n", [2, 3, 4])
def test_a_planar_pose_comes_back(n: int, seed: int) -> None:
    """The analytic branch and damped least squares place the tip of the same arm at the same point."""
    rng = np.random.default_rng(seed)
    arm = Arm("plane", tuple(Link(float(length), SECTION) for length in rng.uniform(0.3, 0.8, n)))
    angles = rng.uniform(-1.2, 1.2, (1, n))
    tip, hub = tip_at(arm, angles)[0], angles[0, 0]
    seen = (tip[0] + 1j * tip[1]) * np.exp(-1j * hub)  # in the hub's axes
    goal = goal_angles(arm, angles, np.array([[seen.real, seen.imag]]), np.ones((1, n)))
    assert tip_at(arm, goal)[0] == pytest.approx(tip, abs=1e-11)
    found = approach(arm, angles + 0.2, tip[None])
    assert tip_at(arm, found)[0] == pytest.approx(tip, abs=1e-9)
    if n > 2:  # the least sum of squares: no other solution has less
        assert (goal**2).sum() <= (found**2).sum() + 1e-9


@pytest.mark.parametrize("arm", [a for a in ARMS if a.spatial])
def test_a_pose_in_space_comes_back(arm: Arm) -> None:
    for seed in range(3):
        point = tip_at(arm, posture(arm, seed)[0])
        found = angles_at(arm, point)
        assert found is not None and tip_at(arm, found) == pytest.approx(point, abs=1e-8 * arm.total_length)
    assert angles_at(arm, np.array([2.0 * arm.total_length, 0.0, 0.0])) is None
