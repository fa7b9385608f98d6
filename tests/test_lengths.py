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


def test_wrong_input_changes_no_arm() -> None:
    """A part that has stepped or started while another refuses would be out of step with it."""
    env = LengthsVectorEnv("FlexibleArm-v0", 4, (1.0, 1.1), duration=0.1)
    env.reset(seed=0)
    before = env.get_state()

    def unchanged() -> bool:
        pairs = zip(before, env.get_state(), strict=True)
        return all(np.array_equal(one["arm"]["block"], two["arm"]["block"]) for one, two in pairs)

    for shape in [(3, 1), (5, 1), (4, 2), (4,), ()]:
        says("must be an array of numbers of shape (4, 1)", lambda shape=shape: env.step(np.ones(shape, np.float32)))
    says("action = None", lambda: env.step(None))
    for seeds in [[1, 2], [1, 2, 3, 4, 5]]:
        says("must be a number or a sequence of 4", lambda seeds=seeds: env.reset(seed=seeds))
    for mask in [[True, False, False, True], np.array([1, 0, 0, 1]), np.zeros(4, bool), np.ones(2, bool), "abcd"]:
        says("a numpy array of 4 bools", lambda mask=mask: env.reset(options={"reset_mask": mask}))
    says("options = 'abc'", lambda: env.reset(options="abc"))
    says("options.nonsense", lambda: env.reset(options={"nonsense": 1}))
    for count in (3, 8):
        says("must be 4, one for each arm", lambda count=count: env.set_state([before[0]] * count))
    broken = dict(before[3], seed="x")
    says("state.seed", lambda: env.set_state([before[3], before[2], before[1], broken]))
    says("states = None", lambda: env.set_state(None))
    says("indices[0] = 9", lambda: env.call("dt", indices=[9]))
    says("name = 'nonsense'", lambda: env.set_attr("nonsense", [1] * 4))
    says("starts", lambda: env.set_attr("starts", [{}] * 3))
    assert unchanged()
    env.set_attr("starts", {"angles": [(0.5, 0.5)]})  # one value for all
    assert env.call("starts") == ({"angles": [(0.5, 0.5)]},) * 4
    assert env.reset(seed=0)[0][:, 0] == pytest.approx(np.sin(0.5))


def test_some_states_and_motions_of_single_arms() -> None:
    env = LengthsVectorEnv("FlexibleArm-v0", 3, (1.0, 1.1), duration=0.1)
    env.reset(seed=0)
    state = env.get_state([2])
    first = env.step(np.full((3, 1), 0.5, np.float32))[0]
    env.call("set_state", state, indices=[2])
    assert np.array_equal(env.step(np.full((3, 1), 0.5, np.float32))[0][2], first[2])


def test_ended_arms_of_one_length_stop_all_without_autoreset() -> None:
    env = LengthsVectorEnv("FlexibleArm-v0", 4, (1.0, 1.1), duration=0.1, autoreset_mode="Disabled")
    env.reset(seed=0)
    env.reset(seed=0, options={"reset_mask": np.array([True, True, False, False])})
    env.step(np.zeros((4, 1), np.float32))
    env.reset(seed=0, options={"reset_mask": np.array([True, True, False, False])})  # behind by a period
    for _ in range(4):
        env.step(np.zeros((4, 1), np.float32))
    before = env.get_state([0])[0]["arm"]["block"]
    with pytest.raises(gym.error.ResetNeeded, match=r"Arms \[2, 3\] have ended"):
        env.step(np.zeros((4, 1), np.float32))
    assert np.array_equal(env.get_state([0])[0]["arm"]["block"], before)
