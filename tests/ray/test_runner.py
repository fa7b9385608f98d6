"""The environment runner: what it hands to RLlib is what the environments did."""

import dataclasses
import itertools
from collections import defaultdict
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch
from ray.rllib.core.columns import Columns
from ray.rllib.env.single_agent_env_runner import SingleAgentEnvRunner

from agents.rllib import setup
from agents.rllib.runner import NativeEnvRunner

ENV, N, LIMIT = "FlexibleArm-v0", 4, 20
KWARGS = {"duration": 0.4}  # 20 control periods


def config_of(native: bool, env_id: str = ENV, **others: Any) -> Any:
    config = setup.load(None, env_id)
    config = dataclasses.replace(config, text={**config.text, "n_envs": N, "n_steps": 32, "batch_size": 64, **others})
    return setup.algorithm_config(
        env_id, config, KWARGS, seed=3, runners=0, learners=0, envs_per_runner=None, native=native
    )


@pytest.fixture(scope="module")
def runner() -> NativeEnvRunner:
    return NativeEnvRunner(config=config_of(True), worker_index=1)


def test_episodes_are_what_the_environments_did(runner: NativeEnvRunner) -> None:
    runner._begin()
    states, seen, ids = runner._native.get_state(), runner._seen, list(runner._ids)
    pieces = {piece.id_: piece for piece in runner.sample(num_timesteps=N * 30, explore=True)}
    firsts = [pieces[id_] for id_ in ids]
    other = gym.make_vec(f"flexarm_env:{ENV}", num_envs=N, vectorization_mode="vector_entry_point", **KWARGS)
    other.reset(seed=0)
    other.unwrapped.set_state(states)
    assert np.array_equal(seen, np.stack([p.get_observations(0) for p in firsts]))
    assert max(map(len, firsts)) > 10
    for k in range(max(map(len, firsts))):
        alive = [i for i in range(N) if k < len(firsts[i])]
        action = np.zeros((N, 1), np.float32)
        action[alive] = [firsts[i].get_actions(k) for i in alive]
        observation, reward, _, truncated, _ = other.step(np.clip(action, -1.0, 1.0))
        for i in alive:
            assert np.array_equal(observation[i], firsts[i].get_observations(k + 1))
            assert reward[i] == firsts[i].get_rewards(k)
            assert truncated[i] == (k + 1 == len(firsts[i]))


def test_pieces_go_on_where_the_last_sample_stopped(runner: NativeEnvRunner) -> None:
    samples = [runner.sample(num_timesteps=N * 15, explore=True) for _ in range(4)]
    lives: dict[str, list[Any]] = defaultdict(list)
    for pieces in samples:
        assert sum(map(len, pieces)) >= N * 15
        for piece in pieces:
            lives[piece.id_].append(piece)
    whole = 0
    for parts in lives.values():
        for before, after in itertools.pairwise(parts):
            assert np.array_equal(before.get_observations(-1), after.get_observations(0))
            assert after.t_started == before.t
            assert not before.is_done
        if parts[0].t_started == 0 and parts[-1].is_done:
            whole += 1
            assert parts[-1].is_truncated and not parts[-1].is_terminated
            assert parts[-1].t <= LIMIT
    assert whole >= N


def test_probabilities_are_the_modules(runner: NativeEnvRunner) -> None:
    (piece, *_) = runner.sample(num_timesteps=N * 8, explore=True)
    seen = torch.from_numpy(piece.get_observations(slice(0, len(piece))))
    inputs = runner.module.forward_exploration({Columns.OBS: seen})[Columns.ACTION_DIST_INPUTS]
    assert np.allclose(piece.get_extra_model_outputs(Columns.ACTION_DIST_INPUTS), inputs.numpy(), atol=1e-6)
    distribution = runner.module.get_exploration_action_dist_cls().from_logits(inputs)
    logp = distribution.logp(torch.from_numpy(piece.get_actions()))
    assert np.allclose(piece.get_extra_model_outputs(Columns.ACTION_LOGP), logp.numpy(), atol=1e-5)


def test_the_learner_gets_the_columns_that_rllibs_runner_gives(runner: NativeEnvRunner) -> None:
    theirs = SingleAgentEnvRunner(config=config_of(False), worker_index=1)
    (one, *_), (other, *_) = (r.sample(num_timesteps=N * 8, explore=True) for r in (runner, theirs))
    assert set(one.extra_model_outputs) == set(other.extra_model_outputs) - {"weights_seq_no"}
    for name in ("observations", "actions", "rewards"):
        mine, their = getattr(one, name).data, getattr(other, name).data
        assert mine.shape[1:] == their.shape[1:]
        assert mine.dtype.kind == their.dtype.kind


def test_runners_draw_different_starts_and_the_same_again() -> None:
    made = [NativeEnvRunner(config=config_of(True), worker_index=k) for k in (1, 2, 1)]
    firsts = [r.sample(num_timesteps=N, explore=True)[0].get_observations(0) for r in made]
    assert not np.array_equal(firsts[0], firsts[1])
    assert np.array_equal(firsts[0], firsts[2])


def test_an_environment_takes_one_thread(runner: NativeEnvRunner) -> None:
    assert runner.env.env.unwrapped.batch.threads == 1


def test_processes_that_do_not_divide_are_told_in_a_sentence() -> None:
    config = setup.load(None, ENV)
    with pytest.raises(ValueError, match="runners = 3: must divide n_envs = 64"):
        setup.split(config, 3, 0, None)
    with pytest.raises(ValueError, match="learners = 3: must divide n_envs n_steps = 8192"):
        setup.split(config, 2, 3, None)
    assert setup.split(config, 2, 2, None) == (32, 4096, 512)
    assert setup.split(config, 10, 0, 16) == (16, 20480, 1024)
