"""PPO in one file, in the manner of CleanRL. This file uses the vector environment, PyTorch, and no other code of the
repository.

    python agents/cleanrl_ppo.py --env-id FlexibleArm-v0
    python agents/cleanrl_ppo.py --env-id flexarm_env:flexarm/slew-measured-v2 --out slew.pt

The trained networks are written to --out. `act` is a policy for `flexarm bench suite --policy agents.cleanrl_ppo:act`;
`act` reads the file that the environment variable AGENT names.
"""

import argparse
import os
import time
from functools import cache
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from gymnasium.vector import AutoresetMode
from torch import nn
from torch.distributions.normal import Normal

import flexarm_env  # noqa: F401  (registers the environments)


def arguments(words: list[str] | None = None) -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--env-id", default="FlexibleArm-v0")
    parser.add_argument("--out", default="cleanrl_ppo.pt")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--total-timesteps", type=int, default=800_000)
    parser.add_argument("--num-envs", type=int, default=64)
    parser.add_argument("--num-steps", type=int, default=128)
    parser.add_argument("--duration", type=float, default=1.5, help="duration of a training episode, s")
    parser.add_argument("--learning-rate", type=float, default=2e-3)
    parser.add_argument("--gamma", type=float, default=0.98)
    parser.add_argument("--gae-lambda", type=float, default=0.95)
    parser.add_argument("--minibatch-size", type=int, default=1024)
    parser.add_argument("--update-epochs", type=int, default=10)
    parser.add_argument("--clip-coef", type=float, default=0.2)
    parser.add_argument("--vf-coef", type=float, default=0.5)
    parser.add_argument("--max-grad-norm", type=float, default=0.5)
    return parser.parse_args(words)


def layer(rows: int, columns: int, gain: float = 2.0**0.5) -> nn.Linear:
    """Make a layer with orthogonal weights and no bias."""
    made = nn.Linear(rows, columns)
    nn.init.orthogonal_(made.weight, gain)
    nn.init.constant_(made.bias, 0.0)
    return made


class Agent(nn.Module):
    """Two networks: the mean action, and the value."""

    def __init__(self, entries: int, joints: int) -> None:
        super().__init__()
        self.critic = nn.Sequential(layer(entries, 64), nn.Tanh(), layer(64, 64), nn.Tanh(), layer(64, 1, 1.0))
        self.actor = nn.Sequential(layer(entries, 64), nn.Tanh(), layer(64, 64), nn.Tanh(), layer(64, joints, 0.01))
        self.logstd = nn.Parameter(torch.full((1, joints), -0.5))

    def value(self, seen: torch.Tensor) -> torch.Tensor:
        """Return the values (n,) of observations (n, entries)."""
        found: torch.Tensor = self.critic(seen).squeeze(-1)
        return found

    def distribution(self, seen: torch.Tensor) -> Normal:
        """Return the distribution of the actions for observations (n, entries)."""
        mean = self.actor(seen)
        return Normal(mean, self.logstd.expand_as(mean).exp())


def train(args: argparse.Namespace) -> list[float]:
    """Train and write the agent; return, for each iteration, the mean return of the episodes that ended during it."""
    torch.manual_seed(args.seed)
    torch.set_num_threads(1)  # networks this small wait for each other on more
    envs = gym.make_vec(
        args.env_id, args.num_envs, vectorization_mode="vector_entry_point", autoreset_mode=AutoresetMode.SAME_STEP,
        duration=args.duration,
    )  # fmt: skip
    entries, joints = envs.single_observation_space.shape[0], envs.single_action_space.shape[0]
    agent = Agent(entries, joints)
    optimizer = torch.optim.Adam(agent.parameters(), lr=args.learning_rate, eps=1e-5)
    steps, n = args.num_steps, args.num_envs
    seen = torch.zeros(steps, n, entries)
    actions = torch.zeros(steps, n, joints)
    logprobs, rewards, values, after, ends = (torch.zeros(steps, n) for _ in range(5))
    following = torch.from_numpy(envs.reset(seed=args.seed)[0])
    running = np.zeros(n)
    curve: list[float] = []
    iterations = max(1, args.total_timesteps // (steps * n))
    for iteration in range(iterations):
        began, returns = time.perf_counter(), []
        optimizer.param_groups[0]["lr"] = args.learning_rate * (1.0 - iteration / iterations)
        for t in range(steps):
            seen[t] = following
            with torch.no_grad():
                distribution = agent.distribution(following)
                actions[t] = distribution.sample()
                logprobs[t] = distribution.log_prob(actions[t]).sum(-1)
                values[t] = agent.value(following)
            observation, reward, terminated, truncated, info = envs.step(actions[t].clamp(-1.0, 1.0).numpy())
            over = terminated | truncated
            following = torch.from_numpy(observation)
            rewards[t], ends[t] = torch.from_numpy(reward), torch.from_numpy(over)
            with torch.no_grad():  # what follows the last step of an episode is not where the next one begins
                last = following.clone()
                for i in np.flatnonzero(over):
                    last[i] = torch.from_numpy(info["final_obs"][i])
                after[t] = agent.value(last) * torch.from_numpy(~terminated)
            running += reward
            returns += running[over].tolist()
            running[over] = 0.0
        advantages = torch.zeros_like(rewards)
        gained = torch.zeros(n)
        for t in reversed(range(steps)):
            delta = rewards[t] + args.gamma * after[t] - values[t]
            gained = delta + args.gamma * args.gae_lambda * (1.0 - ends[t]) * gained
            advantages[t] = gained
        learn(
            agent,
            optimizer,
            args,
            [x.flatten(0, 1) for x in (seen, actions, logprobs, advantages, advantages + values)],
        )
        curve.append(float(np.mean(returns)) if returns else float("nan"))
        rate = steps * n / (time.perf_counter() - began)
        print(f"{(iteration + 1) * steps * n} steps: return {curve[-1]:.2f}, {rate:.0f} steps/s", flush=True)
    envs.close()
    torch.save({"entries": entries, "joints": joints, "agent": agent.state_dict()}, args.out)
    return curve


def learn(agent: Agent, optimizer: Any, args: argparse.Namespace, batch: list[torch.Tensor]) -> None:
    """Update both networks with the rollout of one iteration, in several epochs of minibatches."""
    size = len(batch[0])
    for _ in range(args.update_epochs):
        for places in torch.randperm(size).split(args.minibatch_size):
            seen, actions, logprobs, advantages, returns = (x[places] for x in batch)
            distribution = agent.distribution(seen)
            ratio = (distribution.log_prob(actions).sum(-1) - logprobs).exp()
            advantages = (advantages - advantages.mean()) / (advantages.std() + 1e-8)
            clipped = ratio.clamp(1.0 - args.clip_coef, 1.0 + args.clip_coef)
            policy_loss = -torch.min(advantages * ratio, advantages * clipped).mean()
            value_loss = 0.5 * (agent.value(seen) - returns).square().mean()
            optimizer.zero_grad()
            (policy_loss + args.vf_coef * value_loss).backward()
            nn.utils.clip_grad_norm_(agent.parameters(), args.max_grad_norm)
            optimizer.step()


@cache
def trained(path: str) -> Agent:
    """Load the agent from a file."""
    kept = torch.load(path, weights_only=True)
    agent = Agent(kept["entries"], kept["joints"])
    agent.load_state_dict(kept["agent"])
    return agent


def act(observations: np.ndarray) -> np.ndarray:
    """Return the actions (n, joints) for observations (n, entries).

    The environment variable AGENT names the agent's file.
    """
    with torch.no_grad():
        found: np.ndarray = trained(os.environ["AGENT"]).actor(torch.from_numpy(observations)).clamp(-1.0, 1.0).numpy()
    return found


if __name__ == "__main__":
    train(arguments())
