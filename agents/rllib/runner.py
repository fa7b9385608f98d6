"""Environment runner for RLlib that steps the native vector environment with arrays and builds RLlib's episodes."""

from __future__ import annotations

import time
import uuid
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from ray.rllib.core.columns import Columns
from ray.rllib.env.single_agent_env_runner import SingleAgentEnvRunner
from ray.rllib.env.single_agent_episode import SingleAgentEpisode

from agents.rllib.cluster import one_at_a_time
from flexarm_env.training.starts import staggered

TIMES = ("environment_s", "policy_s", "episodes_s")
"""Names of the measured parts of a runner's time; the metrics sum each part over the runners."""


class NativeEnvRunner(SingleAgentEnvRunner):
    """RLlib's runner without its Python loop over environments.

    The runner accepts any vector environment in next-step autoreset mode whose observations and actions are boxes.
    RLlib's connectors and step callbacks are not called. Actions are drawn from the module's distribution and clipped
    to the action space; observations reach the module unchanged. The episodes equal those of RLlib's own runner,
    without infos.

    The first environment of a node compiles; it is made and stepped once under a lock, so that all other environments
    load the compiled code.
    """

    def make_env(self) -> None:
        """Make the vector environment."""
        with one_at_a_time():
            super().make_env()
            self._native: Any = self.env.env
            self._native.reset(seed=0)
            self._native.step(np.zeros(self._native.action_space.shape, self._native.action_space.dtype))
        self._seen: NDArray[np.float32] | None = None

    def _begin(self) -> None:
        """Start all environments at times spread over an episode, with seeds that no other runner has."""
        entropy = [self.config.seed or 0, self.worker_index or 0, self.num_env_steps_sampled_lifetime]
        seed, order, torchs = (int(k) for k in np.random.SeedSequence(entropy).generate_state(3))
        observation = self._native.reset(seed=seed)[0]
        later = staggered(self._native, order)
        torch.manual_seed(torchs)
        n = self.num_envs
        self._seen = observation if later is None else later
        self._over = np.zeros(n, bool)
        self._ids = [uuid.uuid4().hex for _ in range(n)]
        self._ages, self._returns = np.zeros(n, np.int64), np.zeros(n)
        self._needs_initial_reset = False

    def _sample(
        self,
        *,
        num_timesteps: int | None = None,
        num_episodes: int | None = None,
        explore: bool,
        random_actions: bool = False,
        force_reset: bool = False,
    ) -> list[SingleAgentEpisode]:
        """Sample at least num_timesteps steps; return the episodes and parts of episodes."""
        if num_timesteps is None or random_actions:
            raise ValueError("NativeEnvRunner samples a number of steps under its policy, nothing else")
        if force_reset or self._seen is None or self._needs_initial_reset:
            self._begin()
        assert self._seen is not None
        space, module = self._native.single_action_space, self.module
        drawn = module.get_exploration_action_dist_cls() if explore else module.get_inference_action_dist_cls()
        forward = module.forward_exploration if explore else module.forward_inference
        rows: list[tuple[NDArray[Any], ...]] = []
        spent = dict.fromkeys(TIMES, 0.0)
        seen, over, steps, busy = self._seen, self._over, 0, time.process_time()
        while steps < num_timesteps:
            clock = time.perf_counter()
            inputs = forward({Columns.OBS: torch.from_numpy(seen)})[Columns.ACTION_DIST_INPUTS]
            distribution = drawn.from_logits(inputs)
            if not explore:
                distribution = distribution.to_deterministic()
            action = distribution.sample()
            logp = distribution.logp(action)
            act, between = action.numpy(), time.perf_counter()
            after, reward, terminated, truncated, _ = self._native.step(np.clip(act, space.low, space.high))
            rows.append((seen, act, reward, logp.numpy(), inputs.numpy(), terminated, truncated, over))
            steps += int(self.num_envs - np.count_nonzero(over))  # the step after an episode's last is its reset
            seen, over = after, terminated | truncated
            spent["policy_s"] += between - clock
            spent["environment_s"] += time.perf_counter() - between
        clock = time.perf_counter()
        episodes, ended = self._episodes(rows, seen)
        self._seen, self._over = seen, over
        spent["episodes_s"] = time.perf_counter() - clock
        spent["cpu_s"] = time.process_time() - busy
        for name, value in spent.items():
            self.metrics.log_value(name, value, reduce="lifetime_sum")
        self._log_env_steps(metric=self._metrics_num_env_steps_sampled, num_steps=steps)
        self._increase_sampled_metrics(steps, ended)
        self.num_env_steps_sampled_lifetime += steps
        return episodes

    def _episodes(
        self, rows: list[tuple[NDArray[Any], ...]], last: NDArray[np.float32]
    ) -> tuple[list[SingleAgentEpisode], int]:
        """Convert rows, one step of all environments each, to episodes and parts of episodes; count finished ones."""
        columns = (np.stack(column) for column in zip(*rows, strict=True))
        obs, act, reward, logp, inputs, terminated, truncated, over = columns
        obs = np.concatenate([obs, last[None]])
        done = terminated | truncated
        pieces: list[SingleAgentEpisode] = []
        ended = 0
        for i in range(self.num_envs):
            start = int(over[0, i])
            for end in [*(np.flatnonzero(done[:, i]) + 1).tolist(), len(reward)]:
                if end <= start:
                    continue
                part, final = slice(start, end), bool(done[end - 1, i])
                pieces.append(
                    SingleAgentEpisode(
                        self._ids[i],
                        observations=np.ascontiguousarray(obs[start : end + 1, i]),
                        infos=[{}] * (end - start + 1),
                        actions=np.ascontiguousarray(act[part, i]),
                        rewards=np.ascontiguousarray(reward[part, i]),
                        terminated=bool(terminated[end - 1, i]),
                        truncated=bool(truncated[end - 1, i]),
                        extra_model_outputs={
                            Columns.ACTION_LOGP: np.ascontiguousarray(logp[part, i]),
                            Columns.ACTION_DIST_INPUTS: np.ascontiguousarray(inputs[part, i]),
                        },
                        observation_space=self._native.single_observation_space,
                        action_space=self._native.single_action_space,
                        t_started=int(self._ages[i]),
                        len_lookback_buffer=0,
                    ).to_numpy()
                )
                self._ages[i] += end - start
                self._returns[i] += float(reward[part, i].sum())
                if final:
                    ended += 1
                    self._log_episode_metrics(int(self._ages[i]), float(self._returns[i]), 0.0)
                    self._ids[i], self._ages[i], self._returns[i] = uuid.uuid4().hex, 0, 0.0
                start = end + 1 if final else end
        return pieces, ended
