"""Policy learning by derivatives of the return that are computed through the simulation (short-horizon actor-critic).

The method follows Xu et al. 2022 (Accelerated policy learning with parallel differentiable simulation). n arms act for
a window of a few control periods. The objective is the sum of the discounted rewards in the window and the critic's
estimate of the return after the window. The gradient of the objective by the policy's weights is computed backward
through all periods of the window. The critic is fitted to the returns. The class `Gradient` has the interface of a
Stable-Baselines3 algorithm. Policies and checkpoints of `Gradient` have PPO's format, so that the functions that read
PPO's files read them.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.policies import ActorCriticPolicy

from flexarm_env.around import AroundControllerVector
from flexarm_env.control.around import linear_law
from flexarm_env.derivatives import Arms
from flexarm_env.training.networks import of_policy
from flexarm_env.validation import Array, Array32

Flags = NDArray[np.bool_]

SEEDS = (10**6, 2**31)
"""Range of the seeds of training episodes; it does not overlap with the seeds of evaluation."""

NOT_OF_ARMS = ("autoreset_mode", "num_envs", "vectorization_mode", "render_mode", "info_level")
"""Keywords of a vector environment that do not concern its arms."""


@dataclass
class Window:
    """Record of T control periods of n arms: lists of T entries.

    states (n, S), seen (n, O): states and observations before each period. inputs: inputs of each layer of the policy.
    wanted, noise (n, A): the policy's actions before clipping, and the random part of these actions. total (n, A):
    `wanted` plus the action of the controller inside the policy (`control.around`), before saturation. rewards (T, n):
    rewards including the cost near joint limits and the penalty of a failure. slopes (n, O): derivatives of the cost
    near joint limits by the observation after the period. ended, failed (T, n):
    whether the episode ended, and whether the solver failed. after (T, n, O): observations after each period.
    """

    states: list[Array]
    seen: list[Array32]
    inputs: list[list[Array32]]
    wanted: list[Array32]
    total: list[Array]
    noise: list[Array32]
    slopes: list[Array]
    rewards: Array
    ended: Flags
    failed: Flags
    after: Array32


class Gradient(BaseAlgorithm):
    """Learning algorithm: policy gradient through the simulation over short windows (short-horizon actor-critic).

    Args:
        policy: name of the policy class, "MlpPolicy". env: a vector environment of this package.
        learning_rate: learning rate of actor and critic. n_steps: control periods of a window. gamma: discount factor.
        batch_size, n_epochs: batch size and number of epochs for fitting the critic in each window.
        gae_lambda: weight of longer returns in the critic's targets. max_grad_norm: largest norm of the actor's
            gradient.
        limit_margin: distance from a joint limit, rad, below which a cost is subtracted from the reward. limit_cost:
            value of the cost, per period, for a joint at its limit. At a joint limit the episode ends and the return
            jumps. The gradient does not contain the jump; the cost replaces the jump in the gradient.
        policy_kwargs, seed, verbose, device, tensorboard_log: as for PPO of Stable-Baselines3.
    """

    policy_aliases: ClassVar = {"MlpPolicy": ActorCriticPolicy}

    def __init__(
        self, policy: Any, env: Any, learning_rate: Any = 4e-3, n_steps: int = 32, batch_size: int = 512,
        n_epochs: int = 2, gamma: float = 0.98, gae_lambda: float = 0.95, max_grad_norm: float = 10.0,
        limit_margin: float = 0.3, limit_cost: float = 1.0, policy_kwargs: dict[str, Any] | None = None,
        tensorboard_log: str | None = None, verbose: int = 0, seed: int | None = None, device: Any = "cpu",
        _init_setup_model: bool = True,
    ) -> None:  # fmt: skip
        """Store the hyper-parameters and set up policy and arms."""
        super().__init__(
            policy, env, learning_rate, policy_kwargs=policy_kwargs, tensorboard_log=tensorboard_log, verbose=verbose,
            device=device, support_multi_env=True, seed=seed,
        )  # fmt: skip
        self.n_steps, self.batch_size, self.n_epochs = n_steps, batch_size, n_epochs
        self.gamma, self.gae_lambda, self.max_grad_norm = gamma, gae_lambda, max_grad_norm
        self.limit_margin, self.limit_cost = limit_margin, limit_cost
        self.memories: tuple[Array, Array] | None = None
        self.state: Array | None = None
        if _init_setup_model:
            self._setup_model()

    # --- set up, saved, loaded -------------------------------------------------------------------------
    def _setup_model(self) -> None:
        """Create the policy with actor and critic, restore the state of loaded optimizers, and set up the arms."""
        self._setup_lr_schedule()
        self.set_random_seed(self.seed)
        self.policy = self.policy_class(
            self.observation_space, self.action_space, self.lr_schedule, **self.policy_kwargs
        )  # fmt: skip
        self.actor, self.critic = of_policy(self.policy)
        if self.memories is not None:  # loaded
            for network, memory in zip((self.actor, self.critic), self.memories, strict=True):
                network.parameters.memory[:] = memory
        self.memories = self.actor.parameters.memory, self.critic.parameters.memory
        if self.env is not None:
            self._setup_arms()

    def _setup_arms(self) -> None:
        """Create differentiable arms like the environment's, started at times spread over an episode; compile them."""
        env: Any = self.env
        spec = env.unwrapped.env.spec
        keywords = {k: v for k, v in spec.kwargs.items() if k not in NOT_OF_ARMS}
        self.arms = Arms(spec.id, self.n_envs, **keywords)
        # a controller inside, linear in the observation, and the share of the policy's actions beside it
        inside = env.unwrapped.env
        around = isinstance(inside, AroundControllerVector)
        self.law = linear_law(inside.controller) if around else None
        self.share = inside.inside.share if around else 1.0
        plan = self.arms.environment.plan
        self.limit, self.price = int(plan.limit), float(plan.record.weights[-1])
        last = len(plan.names) * (plan.history - 1)
        # entries of the sine and cosine of each joint with limits, and the limits, rad
        self.margins = [
            (last + plan.names.index(f"{name}_sin"), last + plan.names.index(f"{name}_cos"), *limits)
            for name, limits in zip(plan.arm.joint_names, plan.arm.joint_limits or (), strict=False)
            if limits is not None and self.limit_cost > 0.0 and f"{name}_sin" in plan.names
            and limits[1] - limits[0] < 2.0 * np.pi  # of wider ones the sine and cosine do not tell which is near
        ]  # fmt: skip
        if self.state is None:
            self.rng = np.random.default_rng(self.seed)
            self.state = self.arms.reset(seed=self._seeds(self.n_envs))
            self.ages = self.rng.permutation(np.arange(self.n_envs) * self.limit // self.n_envs)
            self.returns = np.zeros(self.n_envs)
        still = np.zeros((self.n_envs, self.arms.action_size))
        self.arms.step(self.state, still)
        self.arms.vjp(self.state, still, self.state, self.arms.observe(self.state), self.returns)

    def _seeds(self, count: int) -> list[int]:
        return [int(seed) for seed in self.rng.integers(*SEEDS, size=count)]

    def _excluded_save_params(self) -> list[str]:
        """Return the names of attributes that are not saved but rebuilt on loading."""
        return [*super()._excluded_save_params(), "arms", "actor", "critic", "law"]

    # --- learning --------------------------------------------------------------------------------------
    def learn(
        self, total_timesteps: int, callback: Any = None, log_interval: int = 100, tb_log_name: str = "gradient",
        reset_num_timesteps: bool = True, progress_bar: bool = False,
    ) -> Gradient:  # fmt: skip
        """Train for a number of environment steps, in whole windows."""
        if reset_num_timesteps:
            self.num_timesteps = 0
        self._total_timesteps = self.num_timesteps + total_timesteps
        self.ep_info_buffer = self.ep_info_buffer or deque(maxlen=self._stats_window_size)
        callback = self._init_callback(callback, progress_bar)
        callback.on_training_start(locals(), globals())
        while self.num_timesteps < self._total_timesteps:
            callback.on_rollout_start()
            window = self._act()
            self.num_timesteps += self.n_envs * self.n_steps
            if not callback.on_step():
                break
            rate = float(self.lr_schedule(self._current_progress_remaining))
            self._improve(window, rate)
            self._fit(window, rate)
            self._update_current_progress_remaining(self.num_timesteps, self._total_timesteps)
        callback.on_training_end()
        return self

    def _act(self) -> Window:
        """Run a window of all arms with random actions; finished episodes restart."""
        assert self.state is not None
        arms, n, steps = self.arms, self.n_envs, self.n_steps
        self._begin_anew(self.ages >= self.limit)
        shape = steps, n
        window = Window(
            [], [], [], [], [], [], [], np.zeros(shape), np.zeros(shape, np.bool_), np.zeros(shape, np.bool_),
            np.zeros((*shape, arms.observation_size), np.float32),
        )  # fmt: skip
        std = np.exp(self.actor.more[0])
        seen = arms.observe(self.state).astype(np.float32)
        for k in range(steps):
            mean, inputs = self.actor.forward(seen)
            # Gaussian exploration: action = mean + std * noise
            noise = std * self.rng.standard_normal(mean.shape, np.float32)
            wanted = mean + noise
            window.states.append(self.state)
            window.seen.append(seen)
            window.inputs.append(inputs)
            window.wanted.append(wanted)
            window.noise.append(noise)
            total = np.clip(wanted, -1.0, 1.0)
            if self.law is not None:
                total = seen @ self.law + self.share * total
            window.total.append(total)
            self.state, after, reward = arms.step(self.state, np.clip(total, -1.0, 1.0))
            failed, ended = arms.failed, arms.failed | arms.past
            if failed.any():
                after[failed], reward[failed] = 0.0, 0.0
            cost, slopes = self._near_limits(after)
            window.slopes.append(slopes)
            reward = reward - self.price * ended
            seen = after.astype(np.float32)
            window.rewards[k], window.after[k] = reward - cost, seen
            window.ended[k], window.failed[k] = ended, failed
            self.ages += 1
            self.returns += reward
            if ended.any():
                self._begin_anew(ended)
                seen = arms.observe(self.state).astype(np.float32)
        return window

    def _begin_anew(self, chosen: Flags) -> None:
        """Restart the chosen arms (mask) and record their finished episodes."""
        if chosen.any():
            assert self.state is not None and self.ep_info_buffer is not None
            for k in np.flatnonzero(chosen).tolist():
                self.ep_info_buffer.append({"r": float(self.returns[k]), "l": int(self.ages[k]), "t": 0.0})
            seeds: list[int | None] = [None] * self.n_envs
            for k, seed in zip(np.flatnonzero(chosen).tolist(), self._seeds(int(chosen.sum())), strict=True):
                seeds[k] = seed
            fresh = self.arms.reset(seed=seeds, options={"reset_mask": chosen})
            self.state = np.where(chosen[:, None], fresh, self.state)
            self.ages, self.returns = np.where(chosen, 0, self.ages), np.where(chosen, 0.0, self.returns)

    def _near_limits(self, seen: Array) -> tuple[Array, Array]:
        """Return the cost of joints near their limits (n,), and the derivatives (n, O) of minus this cost by `seen`.

        seen (n, O): observations.
        """
        cost, slopes = np.zeros(self.n_envs), np.zeros(seen.shape)
        for sine, cosine, low, high in self.margins:
            s, c = seen[:, sine], seen[:, cosine]
            middle = 0.5 * (low + high)
            along, aside = np.cos(middle), np.sin(middle)
            # joint angle relative to the middle of its range, from sine and cosine
            angle = middle + np.arctan2(s * along - c * aside, c * along + s * aside)
            above, below = angle - high, low - angle
            # quadratic cost from the margin before the limit to one margin beyond it, then constant
            over = np.clip(np.maximum(above, below) / self.limit_margin + 1.0, 0.0, 2.0)
            cost += self.limit_cost * over * over
            slope = np.where(above > below, -2.0, 2.0) * (self.limit_cost / self.limit_margin) * over * (over < 2.0)
            slopes[:, sine] += slope * c
            slopes[:, cosine] -= slope * s
        return cost, slopes

    def _improve(self, window: Window, rate: float) -> None:
        """Take one optimizer step of the actor along the gradient of the window's return.

        The return of a window is the sum of discounted rewards plus the critic's value after the window. rate: learning
        rate.
        """
        n, steps = self.n_envs, self.n_steps
        # discount factors since the window's, or an episode's, beginning
        weights = np.ones((steps + 1, n))
        for k in range(steps):
            weights[k + 1] = np.where(window.ended[k], 1.0, weights[k] * self.gamma)
        by_state = np.zeros((n, self.arms.state_size))
        inputs = self.critic.forward(window.after[-1])[1]
        # terminal gradient: the critic's value of the last observation
        by_seen = self.critic.backward(np.ones((n, 1), np.float32), inputs)[0] * weights[-1][:, None]
        slopes: list[list[Array32]] = []
        spread = np.zeros_like(self.actor.more[0])
        for k in reversed(range(steps)):
            # backwards through each period: arms, clipping of the action, policy
            on, wanted = ~window.ended[k][:, None], window.wanted[k]
            weight = np.where(window.failed[k], 0.0, weights[k])
            by_seen = by_seen * on + window.slopes[k] * weight[:, None]
            by_state, by_action = self.arms.vjp(
                window.states[k], np.clip(window.total[k], -1.0, 1.0), by_state * on, by_seen, weight
            )  # fmt: skip
            # through the controller inside, and the saturation of its sum with the policy's actions
            past: Array | float = 0.0
            if self.law is not None:
                by_action = _within(by_action, window.total[k])
                past, by_action = by_action @ self.law.T, self.share * by_action
            slope = _within(by_action, wanted).astype(np.float32)
            by_seen, each = self.actor.backward(slope, window.inputs[k])
            by_seen = by_seen + past
            slopes.append(each)
            spread += (slope * window.noise[k]).sum(axis=0)
        # accumulate the parameters' gradients; ascend the mean return
        slopes.reverse()
        self.actor.note(*(_joined(rows) for rows in (window.inputs, slopes)))
        self.actor.more_slopes[0][:] = spread
        self.actor.parameters.gradient *= np.float32(-1.0 / n)
        self.actor.parameters.descend(rate, self.max_grad_norm)

    def _fit(self, window: Window, rate: float) -> None:
        """Fit the critic to the window's TD(lambda) returns by minibatch steps."""
        wanted = self._paid(window).reshape(-1, 1).astype(np.float32)
        seen = np.concatenate(window.seen)
        for _ in range(self.n_epochs):
            order = self.rng.permutation(len(seen))
            for first in range(0, len(order) - self.batch_size + 1, self.batch_size):
                rows = order[first : first + self.batch_size]
                found, inputs = self.critic.forward(seen[rows])
                slopes = self.critic.backward((found - wanted[rows]) * np.float32(2.0 / len(rows)), inputs)[1]
                self.critic.note(inputs, slopes)
                self.critic.parameters.descend(rate)

    def _paid(self, window: Window) -> Array:
        """Return TD(lambda) returns (T, n), each counted from its own period on."""
        entries = window.after.shape[-1]
        expected = self.critic.forward(window.after.reshape(-1, entries))[0].reshape(window.rewards.shape)
        paid, beyond = np.zeros(window.rewards.shape), expected[-1].astype(np.float64)
        for k in reversed(range(self.n_steps)):
            # G_k = r_k + gamma ((1 - lambda) V_{k+1} + lambda G_{k+1}), without the bracket at an episode's end
            mixed = (1.0 - self.gae_lambda) * expected[k] + self.gae_lambda * beyond
            beyond = window.rewards[k] + self.gamma * np.where(window.ended[k], 0.0, mixed)
            paid[k] = beyond
        return paid


def _within(slope: Array, value: Array | Array32) -> Array:
    """Propagate derivatives through clipping to [-1, 1]; outside, keep only those that lead back to the range."""
    return np.where((np.abs(value) < 1.0) | (slope * value < 0.0), slope, 0.0)


def _joined(rows: list[list[Array32]]) -> list[Array32]:
    """Concatenate the rows of all periods, layer by layer."""
    return [np.concatenate(layer) for layer in zip(*rows, strict=True)]


__all__ = ["Gradient"]
