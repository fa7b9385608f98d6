"""Arms of any stiffness: right against the rigid arm, or refused with a sentence that names field, value and limit."""

import dataclasses
import math
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from flexarm_env import JointTorque, Scene, arms, simulate
from flexarm_env.parameters import Arm
from flexarm_env.time_functions import constant
from tests.refusals import refuses

STRIP = arms.named("strip")
INERTIA = 0.05 + 0.27702 / 3.0 + 0.2 + 2.70011e-7
RIGID = 0.5 / INERTIA
"""rad: what 1 N m turns the rigid strip by in 1 s, from T t^2 / 2 I."""


def stiff(bending: float = 1.0, along: float = 1.0, arm: Arm = STRIP) -> Arm:
    """An arm with factors on EI, and on EA and C."""
    links = []
    for link in arm.links:
        s = link.uniform
        assert s is not None
        section = dataclasses.replace(s, EI=s.EI * bending, EA=s.EA * along, C=s.C * along)
        links.append(dataclasses.replace(link, section=section))
    return dataclasses.replace(arm, links=tuple(links))


def turned(arm: Arm, **options: Any) -> tuple[float, dict[str, Any]]:
    """Angle (rad) of the tip after 50 periods at half torque from rest, and the last info; NaN where it failed."""
    env = gym.make("FlexibleArm-v0", arm=arm, info_level="full", joint_limits=None, **options)
    env.reset(seed=0, options={"start": 0.0})
    for _ in range(50):
        *_, terminated, _, info = env.step(np.array([0.5], np.float32))
        assert info["energy_kinetic"] >= 0.0
        if terminated:
            return math.nan, info
    x, y = info["tip_position"]
    return math.atan2(y, x), info


@pytest.mark.slow
def test_an_elastica_of_any_stiffness_is_right() -> None:
    """It turned by 1.206, -0.113 and 0.000 rad at 1e9, 1e10 and 1e12 times the strip's EI, with negative energies."""
    for factor in (1e6, 1e8, 3e8, 1e9, 1e10):
        for arm in (stiff(factor), stiff(factor, factor)):
            angle, info = turned(arm)
            assert angle == pytest.approx(RIGID, rel=1e-3), factor
            assert info["work"] == pytest.approx(angle, rel=1e-3)
            assert info["energy_kinetic"] == pytest.approx(info["work"], rel=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("formulation", ["geometrically_exact", "floating_frame"])
def test_stiff_sections_are_right(formulation: str) -> None:
    """The exact beam turned by 1.513 and 0.543 rad at 1e6 and 1e8; floating frames of stiff EA alone were lost."""
    for factor in (1e3, 1e5, 1e6, 3e6):
        assert turned(stiff(factor, factor), formulation=formulation)[0] == pytest.approx(RIGID, rel=1e-3), factor
    soft, _ = turned(STRIP, formulation=formulation)
    for factor in (1e2, 1e4, 1e6):
        assert turned(stiff(1.0, factor), formulation=formulation)[0] == pytest.approx(soft, abs=2e-4), factor
    assert turned(stiff(1e9, 1.0), formulation=formulation)[0] == pytest.approx(RIGID, rel=1e-3)


@pytest.mark.slow
def test_long_steps_with_stiff_sections_are_right_or_said_to_have_failed() -> None:
    """At dt = 0.02 s, EA times 30 and 100: 1.518 and 1.777 rad where 1.449 is right."""
    for factor in (30.0, 100.0, 1e6):
        angle, info = turned(stiff(1.0, factor), formulation="geometrically_exact", dt=0.02)
        assert angle == pytest.approx(1.449, abs=2e-3) or info["solver_status"] != "ok"


@pytest.mark.parametrize(
    ("formulation", "factors", "words"),
    [
        ("elastica", (1e12, 1.0), r"links\[0\].section.EI = 7\S+: must be at most 8\.\d+e\+10 N m\^2 under elastica"),
        ("geometrically_exact", (1e8, 1e8), r"links\[0\].section.EA = 7\.?\d*.*: must be at most 7.14e\+13 N under"),
        ("geometrically_exact", (1e12, 1e12), r"links\[0\].section.EA = "),
        ("floating_frame", (1e9, 1e9), r"links\[0\].section.EA = "),
    ],
)
def test_what_double_precision_does_not_carry_is_refused(
    formulation: str, factors: tuple[float, float], words: str
) -> None:
    for make in (gym.make, gym.make_vec):
        with pytest.raises(ValueError, match=words):
            make("FlexibleArm-v0", arm=stiff(*factors), formulation=formulation)
    load = JointTorque(0, constant(1.0))
    scene = Scene("stiff", stiff(*factors), duration=0.1, dt=0.01, loads=(load,))
    refuses(words.split(" = ")[0], lambda: simulate(scene, formulation))


def test_what_a_reset_may_draw_or_is_given() -> None:
    with pytest.raises(ValueError, match=r"randomization.EI\[1\] = 1\S+: must be at most 1\.\d+e\+10 times the arm's"):
        gym.make("FlexibleArm-v0", randomization={"EI": (1.0, 1e12)})
    env = gym.make("FlexibleArm-v0", arm=stiff(1e9), joint_limits=None)
    refuses(r"options.start\[0\] = 100000.0: must be within \+-\d+ rad", lambda: env.reset(options={"start": 1e5}))
    env.reset(seed=0, options={"start": 50.0})
    state = env.unwrapped.get_state()
    batch = env.unwrapped.batch
    state["arm"]["block"][batch._work + 2] = 1e4
    with pytest.raises(ValueError, match=r"state.arm.EI_factor = 10000.0: must be at most 12\.4 under elastica"):
        env.unwrapped.set_state(state)


def test_parameters_of_differentiated_arms() -> None:
    from flexarm_env.derivatives import Arms

    own = Arms("FlexibleArm-v0", 2, parameters=True)
    rows = own.reset(seed=0)
    k = own.names.index("EI_factor")
    assert np.isfinite(own.step(rows, np.zeros((2, 1)))[0]).all()
    rows[1, k] = 1e12
    with pytest.raises(ValueError, match=r"state.EI_factor = 1\S+: must be at most 1\.\d+e\+10 under elastica"):
        own.step(rows, np.zeros((2, 1)))


@pytest.mark.parametrize("changed", [{"mass": 1e18}, {"inertia": 1e18}])
def test_masses_too_far_apart_are_refused(changed: dict[str, float]) -> None:
    """They were a LinAlgError."""
    arm = dataclasses.replace(STRIP, payload=dataclasses.replace(STRIP.payload, **changed))
    refuses("arm = 'strip': masses, inertias, .* must differ by fewer", lambda: gym.make("FlexibleArm-v0", arm=arm))
