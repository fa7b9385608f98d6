"""LQR and LQG of arms in space: their model of the arm, and what they reach."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from flexarm_env import control
from flexarm_env.control import space_lqg
from flexarm_env.control.catalogue import tuned_gains
from flexarm_env.control.space import tip_at
from flexarm_env.control.space_pd import holding
from flexarm_env.physics.space.reading import frames

ID = "SpatialFlexArm-v0"
COARSE: dict[str, Any] = {"elements": 1, "dt": 0.005}
GAUGES = [{"link": k, "measures": what} for k in (1, 2) for what in ("xy", "xz", "torsion")]
MEASURED: dict[str, Any] = {
    "observation": "measured", "sensors": {"encoders": {"counts": 2**16}, "strain_gauges": GAUGES},
}  # fmt: skip


@pytest.mark.parametrize(("name", "keywords"), [("lqr", {}), ("lqg", MEASURED)])
def test_regulator_and_filter_about_a_bent_rest(name: str, keywords: dict[str, Any]) -> None:
    controller, angles = control.make(name, gym.make(ID, **keywords)), np.array([0.3, 0.7, -0.5])
    assert isinstance(controller, space_lqg.SpatialLQG)
    own, y = space_lqg.plant(controller.setup, controller.gravity, angles)
    d, size, turned = controller.design(own), len(own.A), 1e-4 * np.eye(3)
    joints, rates = (np.array([own.rows[f"joint{k}{end}"] for k in range(3)]) for end in ("", "_rate"))
    assert joints @ own.rigid == pytest.approx(np.eye(3), abs=1e-6)
    ends = [holding(controller.setup.arm, controller.gravity, angles + sign * turned)[0] for sign in (1.0, -1.0)]
    weight, left = own.B @ (ends[0] - ends[1]).T / 2e-4, own.A @ own.rigid - own.rigid
    for rows in (joints, rates):  # its weight is held wherever it is turned to, but for what it bends by
        assert np.linalg.norm(rows @ left) < 0.3 * np.linalg.norm(rows @ weight)
    assert [y[f"joint{k}"] for k in range(3)] == pytest.approx(angles)
    assert np.abs(np.linalg.eigvals(own.A - own.B @ d.K[:, :size])).max() < 1.0
    fading = np.abs(np.linalg.eigvals(d.A - d.A @ d.L[-1] @ d.C))  # all but biases, which are given none to walk
    assert np.sort(fading)[size + 2] < 0.9999


@pytest.mark.parametrize(("name", "keywords"), [("lqr", COARSE), pytest.param("lqg", MEASURED, marks=pytest.mark.slow)])
def test_reaches_settle_sooner_than_under_pd(name: str, keywords: dict[str, Any]) -> None:
    """Within 2.8 s, where PD has few that do; one arm's actions are those it has among others."""
    env: Any = gym.make_vec(ID, num_envs=3, **keywords)
    controller, alone = control.make(name, env), control.make(name, env)
    seen, _ = env.reset(seed=400)
    controller.reset(seen)
    alone.reset(seen[1])
    for k in range(280):
        actions = controller.act(seen)
        if k < 5:
            assert alone.act(seen[1]) == pytest.approx(actions[1], abs=1e-5)
        seen, *_, info = env.step(actions)
    assert info["is_success"].all()


def test_goals_that_encoders_tell_are_those_of_the_targets_place() -> None:
    """From the upright arm, by joint errors and by the way to the target; they hold the sagging tip there."""
    goals, errors = [], np.array([0.3, 0.7, -0.5])
    arm = control.Setup.of(gym.make(ID)).arm
    way = (tip_at(arm, errors) - tip_at(arm, np.zeros(3))) @ frames(arm, np.zeros((1, 3)))[2][0, 0]
    told = {f"{joint}_error": x for joint, x in zip(arm.joint_names, errors, strict=True)}
    told |= {f"to_target_{axis}": x for axis, x in zip("xyz", way, strict=True)}
    for observation in ("full", "measured"):
        keywords: dict[str, Any] = {} if observation == "full" else {"observation": observation}
        controller = control.make("pd", gym.make(ID, **keywords))
        known = told | {name: 1.0 for name in controller.setup.names if name.endswith("_cos")}
        controller.reset(np.array([known.get(name, 0.0) for name in controller.setup.names]) / controller.setup.scales)
        goals.append(controller.goal)
    assert goals[0] == pytest.approx(goals[1], abs=1e-9)
    assert np.abs(goals[0] - errors).max() > 1e-3


def test_what_is_not_there_is_refused_by_name() -> None:
    env = gym.make(ID, **COARSE)
    there = 'must be one of "pd", "lqr", "lqg" for an arm in space'
    for name, words in (("zv", there), ("lqg", "LQG needs the entry hub_error")):
        with pytest.raises(ValueError, match=words):
            control.make(name, env)
    with pytest.raises(ValueError, match=r"^gains = .*: must be a LQGGains"):
        control.make("lqr", env, tuned_gains("pd", "space"))
