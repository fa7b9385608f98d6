"""Arms with links of several lengths in one vector environment."""

import warnings
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from flexarm_env import Arm, Link, RigidLink, Section, arms
from flexarm_env.envs.lengths import LengthsVectorEnv, scaled
from tests.refusals import says

FACTORS, SIZES = (0.9, 1.0, 1.2), (3, 3, 2)
SHORT: dict[str, Any] = {"duration": 0.1, "autoreset_mode": "SameStep"}


@pytest.fixture(autouse=True)
def _quiet() -> None:
    """Episodes are shorter than an arm of one's own needs for a slew."""
    warnings.filterwarnings("ignore", "arm 'strip' takes at least", UserWarning)


def test_each_arm_is_the_one_of_its_length() -> None:
    """Observations, rewards, ends and infos are those of a vector environment for each length, to the last bit."""
    env = LengthsVectorEnv("FlexibleArm-v0", 8, FACTORS, **SHORT)
    plain = [
        gym.make_vec("FlexibleArm-v0", num_envs=n, arm=scaled(arms.named("strip"), factor), **SHORT)
        for factor, n in zip(FACTORS, SIZES, strict=True)
    ]
    firsts = (0, 3, 6)
    seen, info = env.reset(seed=5)
    alone = [one.reset(seed=5 + first) for one, first in zip(plain, firsts, strict=True)]
    assert np.array_equal(seen, np.concatenate([one[0] for one in alone]))
    assert np.array_equal(info["target"], np.concatenate([one[1]["target"] for one in alone]))
    assert abs(seen[0]).max() > 0.0 and env.call("dt") == (0.02,) * 8
    for _ in range(6):  # five periods an episode
        actions = np.random.default_rng(0).uniform(-1.0, 1.0, (8, 1)).astype(np.float32)
        *out, info = env.step(actions)
        parts = [one.step(actions[a : a + n]) for one, a, n in zip(plain, firsts, SIZES, strict=True)]
        for k in range(4):
            assert np.array_equal(out[k], np.concatenate([part[k] for part in parts]))
        assert info.keys() == parts[0][4].keys()
        assert np.array_equal(info["tip_deflection"], np.concatenate([part[4]["tip_deflection"] for part in parts]))
    env.close()


def test_states_are_gone_back_to() -> None:
    env = LengthsVectorEnv("FlexibleArm-v0", 4, (1.0, 1.1), **SHORT)
    env.reset(seed=0)
    actions, states = np.full((4, 1), 0.5, np.float32), env.get_state()
    first = env.step(actions)[0]
    env.step(actions)
    env.set_state(states)
    assert np.array_equal(env.step(actions)[0], first)


def test_some_arms_are_reset() -> None:
    env = LengthsVectorEnv("FlexibleArm-v0", 4, (1.0, 1.1), **SHORT)
    env.reset(seed=0)
    env.step(np.ones((4, 1), np.float32))
    before = env.parts[1].batch.observation.copy()
    seen, info = env.reset(seed=7, options={"reset_mask": np.array([False, True, False, False])})
    assert np.array_equal(seen[2:], before) and info["_target"].tolist() == [False, True, False, False]
    fresh, _ = gym.make("FlexibleArm-v0", duration=0.1).reset(seed=8)
    assert np.array_equal(seen[1], fresh)


def test_what_is_scaled() -> None:
    thin, thick = Section(1.0, 1e4, 1e4, 0.2), Section(2.0, 1e4, 1e4, 0.3)
    links = Link(1.0, ((0.0, thin), (0.5, thin), (0.5, thick), (1.0, thick))), Link(0.4, thin, curvature=0.3)
    own = scaled(Arm("own", links), (1.5, 0.5))
    assert [link.length for link in own.links] == [1.5, 0.2] and own.links[1].curvature == 0.3
    assert isinstance(own.links[0].section, tuple) and [s for s, _ in own.links[0].section] == [0.0, 0.75, 0.75, 1.5]
    pillar = scaled(Arm("pillar", (RigidLink(0.4, 2.0, (0.1, 0.0, 0.2)), Link(1.0, thin))), 2.0).links[0]
    assert isinstance(pillar, RigidLink) and (pillar.length, pillar.centre) == (0.8, (0.2, 0.0, 0.4))
    assert scaled(arms.named("strip"), 1.0) == arms.named("strip")


def test_stable_baselines3_trains_on_them() -> None:
    pytest.importorskip("stable_baselines3")
    from flexarm_env.sb3 import make_sb3_vec

    env = make_sb3_vec("FlexibleArm-v0", 4, seed=0, lengths=(0.9, 1.1), duration=0.1)
    env.set_attr("starts", {"angles": [(0.5, 0.5)]})
    first: Any = env.reset()
    assert first[:, 0] == pytest.approx(np.sin(0.5)) and env.get_attr("starts") == [{"angles": [(0.5, 0.5)]}] * 4
    infos = [env.step(np.zeros((4, 1), np.float32))[3] for _ in range(5)][-1]
    assert all(info["TimeLimit.truncated"] and len(info["terminal_observation"]) == 6 for info in infos)
    says("lengths", lambda: make_sb3_vec("FlexibleArm-v0", 4, vectorization_mode="sync", lengths=(0.9, 1.1)))


def test_what_is_refused() -> None:
    says("num_envs = 1: must be at least 2", lambda: LengthsVectorEnv("FlexibleArm-v0", 1, (0.9, 1.1)))
    says("lengths[0]", lambda: LengthsVectorEnv("FlexibleArm-v0", 2, (0.0,)))
    says("env_id", lambda: LengthsVectorEnv("CartPole-v1", 2, (1.0,)))
    says("make_sb3_vec(..., lengths=...)", lambda: gym.make("FlexibleArm-v0", randomization={"length": (0.9, 1.1)}))
