"""What libraries of reinforcement learning look for in the environments: words of errors, bases, infos, specs."""

import copy
import pickle
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from flexarm_env import validation as check
from tests.env_tools import IDS


def test_an_unknown_keyword_is_a_type_error_too() -> None:
    """TorchRL's GymEnv tries `frameskip`, and leaves it out where it reads what Python says of an unknown keyword."""
    for make in (gym.make, gym.make_vec):
        with pytest.raises(TypeError, match="got an unexpected keyword argument 'frameskip'") as caught:
            make("FlexibleArm-v0", frameskip=1)
        assert isinstance(caught.value, check.UnknownArgument)
        assert "allowed: arm, base, formulation" in str(caught.value)
    again = pickle.loads(pickle.dumps(check.UnknownArgument("armm", ("arm",))))
    assert str(again) == (
        "armm: unknown argument (did you mean arm?); allowed: arm; got an unexpected keyword argument 'armm'"
    )


@pytest.mark.parametrize("env_id", IDS)
def test_own_bases_are_gymnasiums(env_id: str) -> None:
    """skrl looks for "gymnasium" in the names of the class's own bases."""
    assert gym.Env in type(gym.make(env_id).unwrapped).__bases__
    assert gym.vector.VectorEnv in type(gym.make_vec(env_id, num_envs=1)).__bases__


def test_info_of_numbers_alone() -> None:
    """TorchRL makes tensors of the infos of vectors that reset in the step that ends an episode."""
    words = {"solver_status", "termination_reason"}
    plain = gym.make("FlexibleArm-v0", duration=0.1)
    bare = gym.make("FlexibleArm-v0", duration=0.1, info_level="numbers")
    assert set(plain.reset(seed=0)[1]) - set(bare.reset(seed=0)[1]) == words
    env = gym.make_vec("FlexibleArm-v0", num_envs=2, duration=0.1, autoreset_mode="SameStep", info_level="numbers")
    env.reset(seed=0)
    for _ in range(5):
        info = env.step(np.zeros((2, 1), np.float32))[-1]
    for infos in (info, info["final_info"]):
        kept = {k: v for k, v in infos.items() if not k.startswith("_") and not k.startswith("final")}
        assert not words & {name.removeprefix("_") for name in infos}
        assert {v.dtype.kind for v in kept.values()} == {"f", "b"}


def test_the_spec_says_how_long_episodes_are() -> None:
    cases: list[tuple[dict[str, Any], int]] = [({}, 200), ({"duration": 1.0, "control_dt": 0.1}, 10)]
    for kwargs, steps in cases:
        env = gym.make("FlexibleArm-v0", **kwargs)
        vector = gym.make_vec("FlexibleArm-v0", num_envs=3, **kwargs)
        for spec in (env.spec, env.unwrapped.spec, vector.spec):
            assert spec is not None
            for one in (spec, copy.deepcopy(spec), pickle.loads(pickle.dumps(spec))):
                assert one.max_episode_steps == steps
    assert gym.spec("FlexibleArm-v0").max_episode_steps is None  # nothing is registered
    for limited in (
        gym.make("FlexibleArm-v0", max_episode_steps=7),
        gym.make_vec("FlexibleArm-v0", num_envs=2, max_episode_steps=7),
    ):
        assert limited.spec is not None and limited.spec.max_episode_steps == 7
    wrapped = gym.wrappers.TimeAwareObservation(gym.make("FlexibleArm-v0", duration=0.1))
    assert wrapped.max_timesteps == 5


def length(env: Any) -> int:
    """Steps to the first end of an episode."""
    env.reset(seed=0)
    for k in range(1, 100):
        if np.any(env.step(np.zeros(env.action_space.shape, np.float32))[3]):
            return k
    return 100


def test_made_again_from_its_spec_nothing_is_cut_short() -> None:
    short = gym.make("FlexibleArm-v0", duration=0.1)
    assert short.spec is not None
    again: Any = gym.make(short.spec)
    assert length(again) == 5
    while again is not again.unwrapped:
        assert not isinstance(again, gym.wrappers.TimeLimit)
        again = again.env
    assert length(gym.make(short.spec, duration=0.4)) == 20
    assert length(short.spec.make(duration=0.4)) == 20
    limited = gym.make("FlexibleArm-v0", duration=0.1, max_episode_steps=3)
    assert limited.spec is not None
    assert length(gym.make(limited.spec)) == 3
    vector = gym.make_vec("FlexibleArm-v0", num_envs=2, duration=0.1)
    assert vector.spec is not None
    assert length(gym.make_vec(vector.spec)) == 5
    assert length(gym.make_vec(vector.spec, duration=0.4)) == 20
