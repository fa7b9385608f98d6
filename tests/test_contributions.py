"""Contributions at points, two at once, beside gears, on a floating base, in lanes and derivatives."""

import dataclasses
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from flexarm_env import arms
from flexarm_env.compiler import UNCOMPILED
from flexarm_env.derivatives import Arms
from flexarm_env.parameters import Arm, Base, Joint, Link, Section
from flexarm_env.scene import Scene
from flexarm_env.simulation import simulate
from tests.env_tools import assert_pair_same, pair
from tests.processes import uncompiled_tests
from tests.springs import springs

compiled = pytest.mark.skipif(UNCOMPILED, reason="the uncompiled tests have it")
STRIP = Section(EI=2.0, EA=2e6, C=7e5, m=0.3, J=1e-7)
GEAR = Joint(stiffness=20.0, damping=0.05, motor_inertia=1e-3, gear_ratio=5.0, friction_viscous=0.01)
TWO = (((0, "tip"), 3.0, (0.3, 0.4, 0.0)), ((0, "tip"), 2.0, (-0.2, 0.5, 0.3)))
OF_LINKS = (((0, "tip"), 3.0, (0.3, 0.4, 0.0)), ((1, "tip"), 2.0, (-0.2, 0.5, 0.3)))


def geared(name: str, **changes: Any) -> Arm:
    arm = arms.named(name)
    return dataclasses.replace(arm, **{"source": "springs", "joints": (GEAR,) * len(arm.links), **changes})


@compiled
def test_on_plain_numbers() -> None:
    uncompiled_tests("uncompiled_contributions.py")


@compiled
@pytest.mark.slow
@pytest.mark.parametrize("formulation", ["elastica", "geometrically_exact", "floating_frame"])
def test_a_floating_base_among_springs_keeps_its_energy(formulation: str) -> None:
    two = geared("two_link_geared", base=Base(0.5, 0.02), joints=(Joint(), GEAR), tau_d=0.0)
    arm = dataclasses.replace(two, links=tuple(Link(0.5, STRIP) for _ in two.links))
    with springs(*OF_LINKS):
        scene = Scene("s", arm, duration=0.3, dt=0.001, root="free", sample=0.05)
        run = simulate(scene, formulation, rho_inf=1.0, estimate_error=False)
    assert run.finished, run.message
    assert abs(run.balance).max() < 0.01 * run.turned_over


@compiled
@pytest.mark.slow
@pytest.mark.parametrize("formulation", ["elastica", "geometrically_exact", "floating_frame"])
def test_a_free_arm_in_space_swings_on_springs_about_their_middle(formulation: str) -> None:
    """Springs without rest length pull the more, the farther: the energy balances while the center of mass moves."""
    arm = dataclasses.replace(arms.named("three_dof"), source="springs", tau_d=0.0)
    with springs(*OF_LINKS):
        scene = Scene("s", arm, duration=0.2, dt=0.0025, root="free", sample=0.05)
        run = simulate(scene, formulation, rho_inf=1.0, estimate_error=False)
    assert run.finished, run.message
    assert run.kinetic.max() > 0.05 * run.turned_over
    assert abs(run.balance).max() < 0.01 * run.turned_over


@compiled
@pytest.mark.slow
@pytest.mark.parametrize("name", ["FlexibleArm-v0", "SpatialFlexArm-v0"])
def test_lanes_of_arms_with_springs_and_gears_are_single_arms_to_the_last_bit(name: str) -> None:
    with springs(*(TWO if name.startswith("Flex") else OF_LINKS)):
        arm = geared("strip" if name.startswith("Flex") else "turret_boom")
        assert_pair_same(pair(name, 3, arm=arm), 20)


@compiled
@pytest.mark.slow
@pytest.mark.parametrize("name", ["FlexibleArm-v0", "TwoLinkFlexArm-v0"])
def test_derivatives_of_arms_with_springs_and_gears(name: str) -> None:
    """Forwards against differences of whole control periods, backwards against forwards."""
    one = name.startswith("Flex")
    with springs(*(TWO if one else OF_LINKS)):
        made = gym.spec(name).make() if one else None
        arm = geared("strip") if one else geared("two_link_geared")
        env, h = Arms(name, 1, arm=arm), 1e-4
        joints = len(arm.links)
        action = np.full((1, joints), 0.3)
        state = env.step(env.reset(seed=0), action)[0]
        forward = env.jacobians(state, action)
        for k in range(joints):
            d = h * np.eye(joints)[k]
            slope = (env.step(state, action + d)[0] - env.step(state, action - d)[0]) / (2.0 * h)
            np.testing.assert_allclose(forward.B[..., k], slope, atol=1e-4 * abs(slope).max())
        bar, entries = np.ones_like(state), forward.observation.shape[1]
        backward = env.vjp(state, action, bar, np.zeros((1, entries)), np.zeros(1))[1]
        np.testing.assert_allclose(backward, (bar[:, None] @ forward.B)[:, 0], rtol=0, atol=1e-9 * abs(backward).max())
        if made is not None:
            made.close()
