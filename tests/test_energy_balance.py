"""Energy of strongly driven soft arms: steps that do not keep its balance are refused, and made in halves."""

import dataclasses
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from flexarm_env.arms import named
from flexarm_env.compiler import uncompiled
from flexarm_env.derivatives import Arms
from flexarm_env.parameters import Arm, Section
from flexarm_env.physics.integrator.work import unpack
from flexarm_env.validation import Array
from tests.env_tools import ONE, TWO, assert_pair_same, pair, rich

USUAL = {"nodes": 4, "dt": 0.02 / 3.0, "tolerance": 1e-5}
"""Settings of shipped arms; the rule takes finer ones for these, with which no step is refused."""


def soft(name: str, share: float, *torques: float) -> Arm:
    """A shipped arm with a share of its bending stiffness and these torque limits, N m."""
    arm, links = named(name), []
    for link in arm.links:
        assert isinstance(link.section, Section)
        links.append(dataclasses.replace(link, section=dataclasses.replace(link.section, EI=share * link.section.EI)))
    return dataclasses.replace(arm, links=tuple(links), torque_limits=torques, joint_limits=None)


def thrown(arms: int, periods: int, arm: Arm, **keywords: Any) -> tuple[Any, Array, Array]:
    """Random bang-bang actions: the environment; kinetic and strain energy, J, and work less dissipation, J."""
    env = gym.make_vec(ONE, num_envs=arms, arm=arm, info_level="full", duration=100.0, threads=1, **keywords)
    env.reset(seed=0)
    rng, energies, work = np.random.default_rng(0), [], []
    for _ in range(periods):
        info = env.step(rng.choice([-1.0, 1.0], size=(arms, 1)).astype(np.float32))[4]
        assert (info["solver_status"] == "ok").all()
        energies.append(info["energy_kinetic"] + info["energy_strain"])
        work.append(info["work"] - info["energy_dissipated"])
    return env, np.array(energies), np.array(work)


@pytest.mark.parametrize(("share", "torque", "periods", "most"), [(0.03, 6.0, 120, 60.0), (1.0, 20.0, 60, 400.0)])
def test_a_whip_brings_no_energy(share: float, torque: float, periods: int, most: float) -> None:
    """Nodes turn by up to 0.7 rad in a step: the trapezoidal rule made 46 J of 29 J, then 10^4 J of 25 J. The exact
    beam stays below 45 and 350 J in these runs. In a period of three steps the balance is kept to 15 %."""
    env, energy, work = thrown(64, periods, soft("strip", share, torque), **USUAL)
    assert energy.max() < most
    gain = np.abs(np.diff(energy, axis=0) - np.diff(work, axis=0))
    assert (gain < 0.15 * np.maximum(energy[1:], energy[:-1])).all()
    assert env.unwrapped.batch.repeats, "no step was refused: the case tests nothing"


def test_refused_steps_are_the_same_in_a_lane_as_alone() -> None:
    both = pair(ONE, 16, arm=soft("strip", 1.0, 20.0), info_level="full", duration=1.0, **USUAL)
    assert_pair_same(both, 60)
    assert both[1].unwrapped.batch.repeats, "no step was refused: the case tests nothing"


@pytest.mark.slow
def test_derivatives_of_refused_steps() -> None:
    """Values are the environment's, and Jacobians and cotangents those of the halved steps."""
    usual = {"dt": 0.02 / 3.0, "nodes": 4, "tolerance": 1e-5}  # finer ones, by default, refuse no step
    arms = Arms(ONE, 16, arm=soft("strip", 1.0, 20.0), threads=1, **usual)
    rng, state = np.random.default_rng(0), arms.reset(seed=0)
    for _ in range(60):
        action = 0.9 * rng.choice([-1.0, 1.0], size=(16, 1))
        before, state = state, arms.step(state, action)[0]
        if arms._stuck.any():
            break
    assert arms._stuck.any() and not arms.failed.any()
    found, chosen = arms.jacobians(before, action), np.flatnonzero(arms._stuck)
    assert np.array_equal(found.state, state)
    way = np.zeros(arms.state_size)
    way[: arms.moving] = rng.normal(size=arms.moving)
    ahead, behind = (arms.step(before + step * way, action)[0] for step in (1e-6, -1e-6))
    slope = ((ahead - behind) / 2e-6)[:, : arms.moving]
    by_state = found.moved[:, : arms.moving, : arms.moving] @ way[: arms.moving]
    assert abs(slope - by_state)[chosen].max() < 1e-3 * abs(by_state[chosen]).max()
    bars = rng.normal(size=state.shape), rng.normal(size=(16, arms.observation_size)), rng.normal(size=16)
    back = arms.vjp(before, action, *bars)[0]
    given = np.concatenate([bars[0][:, : arms.moving], bars[1], bars[2][:, None]], axis=1)
    through = np.einsum("ij,ijk->ik", given, found.moved)[:, : arms.moving]
    assert np.allclose(back[chosen, : arms.moving], through[chosen], rtol=1e-9, atol=1e-9 * abs(through).max())
    arms.close()


def speed_up(env: Any, arm: int, factor: float) -> None:
    """Multiply an arm's rates: energy appears from nowhere."""
    batch = env.unwrapped.batch
    work = uncompiled(unpack)(batch.lane, batch.system.model, batch.block[arm // len(batch.lane)], 0)
    work.v[arm % len(batch.lane) :: len(batch.lane)] *= factor


KINDS: dict[str, tuple[str, dict[str, Any]]] = {
    "elastica": (ONE, {}), "exact": (ONE, {"formulation": "geometrically_exact"}),
    "floating": (ONE, {"formulation": "floating_frame"}), "two links": (TWO, {"joint_limits": None}),
    "features": (ONE, rich(ONE)), "fitted": (ONE, {"step_tolerance": 1e-3}), "space": ("SpatialFlexArm-v0", {}),
}  # fmt: skip


SLOW = [pytest.param(name, marks=pytest.mark.slow) for name in list(KINDS)[1:]]


@pytest.mark.parametrize("kind", ["elastica", *SLOW])
@pytest.mark.parametrize("arms", [1, 11])
def test_energy_from_nowhere_ends_one_episode(kind: str, arms: int) -> None:
    """Twelve times the rates are 144 times the kinetic energy: that arm ends as diverged, its neighbours go on."""
    env_id, keywords = KINDS[kind]
    env: Any = gym.make_vec(env_id, num_envs=arms, threads=1, **keywords)
    env.reset(seed=0)
    rng, one = np.random.default_rng(0), arms // 2
    for k in range(12):
        if k == 10:
            speed_up(env, one, 12.0)
        actions = rng.choice([-1.0, 1.0], size=env.action_space.shape).astype(np.float32)
        _, _, terminated, _, info = env.step(actions)
        if k == 10:
            assert info["termination_reason"][one] == info["solver_status"][one] == "diverged"
            assert np.flatnonzero(terminated).tolist() == [one]
        else:
            assert not terminated.any()
    env.close()


def test_prescribed_motion_ends_where_energy_appears() -> None:
    env: Any = gym.make(ONE)
    env.reset(seed=0, options={"motion": "robot_arm_motion_smooth"})
    for _ in range(20):
        assert not env.step(np.zeros(1, np.float32))[2]
    env.unwrapped.guide.simulation.work.v[1:] *= 20.0
    _, _, terminated, _, info = env.step(np.zeros(1, np.float32))
    assert terminated and info["termination_reason"] == "diverged"
