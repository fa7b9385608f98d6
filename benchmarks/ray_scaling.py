"""Measure Ray's cost and how training scales with its processes: docs/results/ray.{md,json}.

    .venv-ray/bin/python -m benchmarks.ray_scaling [--iterations 8] [--rounds 2] [--page] [--out FOLDER]

PPO is trained on FlexibleArm-v0 with the hyper-parameters of configs/ppo/default.yml: rollouts of 8192 steps of 64
environments, 10 epochs, minibatches of 1024, network [64, 64], one torch thread in each process. `plain` is the same
training loop with the same network in NumPy and torch, without Ray, on one core. All other cases are RLlib's PPO. The
runners of RLlib's PPO are `native` (agents/rllib/runner.py) or `rllib` (RLlib's own). Runners and learners are separate
processes, or the training process does their work. The cases alternate. Times are medians over iterations, without the
first two of each turn.
"""

import argparse
import dataclasses
import os
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks import pages
from benchmarks.machine import table

ENV = "FlexibleArm-v0"
WARM = 2
ARRANGEMENTS: dict[str, dict[str, Any]] = {
    "native, in the training process": {"runners": 0, "native": True},
    "native, 1 runner": {"runners": 1, "native": True},
    "native, 2 runners": {"runners": 2, "native": True},
    "native, 2 runners, 4 times the environments": {"runners": 2, "native": True, "n_envs": 256},
    "native, 2 runners, 2 learners": {"runners": 2, "native": True, "learners": 2},
    "rllib, 1 runner": {"runners": 1, "native": False},
    "rllib, 2 runners": {"runners": 2, "native": False},
}
PLAIN, ALONE = "plain, without Ray", "native, in the training process"
PARTS = ("environment_s", "policy_s", "episodes_s")

Row = dict[str, float]


class Clock:
    """Stopwatch that adds up the durations of calls by name."""

    def __init__(self) -> None:
        self.spent: dict[str, float] = {}

    def timed(self, name: str, call: Callable[..., Any]) -> Callable[..., Any]:
        """Return a function that calls `call` and adds the duration to the total of `name`."""

        def wrapped(*args: Any, **kwargs: Any) -> Any:
            begin = time.perf_counter()
            try:
                return call(*args, **kwargs)
            finally:
                self.spent[name] = self.spent.get(name, 0.0) + time.perf_counter() - begin

        return wrapped

    def take(self) -> dict[str, float]:
        """Return the durations, s, by name, and start again from zero."""
        spent, self.spent = self.spent, {}
        return spent


# ------------------------------------------------------------------ with Ray
def on_ray(config: Any, iterations: int, runners: int, native: bool, n_envs: int = 64, learners: int = 0) -> list[Row]:
    """Train with RLlib; return the durations, s, of each iteration and of its parts.

    The duration of a part inside the runners is the mean over the runners.
    """
    from ray.rllib.algorithms.ppo import ppo

    from agents.rllib import setup

    config = dataclasses.replace(config, text={**config.text, "n_envs": n_envs})
    algorithm = setup.build(
        setup.algorithm_config(
            ENV, config, dict(config.env_kwargs), seed=0, runners=runners, learners=learners,
            envs_per_runner=None, native=native,
        )
    )  # fmt: skip
    clock, usual = Clock(), ppo.synchronous_parallel_sample
    ppo.synchronous_parallel_sample = clock.timed("sampling", usual)
    algorithm.learner_group.update = clock.timed("learning", algorithm.learner_group.update)
    algorithm.env_runner_group.sync_weights = clock.timed("weights", algorithm.env_runner_group.sync_weights)
    rows, before = [], dict.fromkeys((*PARTS, "num_env_steps_sampled_lifetime"), 0.0)
    try:
        for k in range(WARM + iterations):
            clock.take()
            begin = time.perf_counter()
            result = algorithm.train()["env_runners"]
            row = {"iteration": time.perf_counter() - begin, **clock.take()}
            now = {name: float(result.get(name, 0.0)) for name in before}
            change = {name: now[name] - before[name] for name in before}
            before = now
            row |= {name: change[name] / max(1, runners) for name in PARTS if native}
            row["steps"] = change["num_env_steps_sampled_lifetime"]
            if k >= WARM:
                rows.append(row)
    finally:
        ppo.synchronous_parallel_sample = usual
        algorithm.stop()
    return rows


# ------------------------------------------------------------------ without
def plain(config: Any, iterations: int) -> list[Row]:
    """Train with the same loop without Ray; return the durations, s, of each iteration and of its parts."""
    import gymnasium as gym
    import torch
    from ray.rllib.core.columns import Columns
    from ray.rllib.core.rl_module.rl_module import RLModuleSpec

    from agents.rllib.module import FreeDeviationModule
    from flexarm_env.training.starts import staggered

    text = config.text
    n, horizon, size = int(text["n_envs"]), int(text["n_steps"]), int(text["batch_size"])
    env = gym.make_vec(
        f"flexarm_env:{ENV}", num_envs=n, vectorization_mode="vector_entry_point", threads=1, **config.env_kwargs
    )
    model = {"fcnet_hiddens": [64, 64], "fcnet_activation": "tanh", "vf_share_layers": False, "free_log_std": True,
             "log_std_init": -0.5}  # fmt: skip
    spaces = (env.single_observation_space, env.single_action_space)
    module: Any = RLModuleSpec(FreeDeviationModule, *spaces, model_config=model).build()
    drawn = module.get_exploration_action_dist_cls()
    adam = torch.optim.Adam(module.parameters(), 1e-3)
    gamma, lam = float(text["gamma"]), float(text["gae_lambda"])
    env.reset(seed=0)
    seen, over = staggered(env.unwrapped, 0), np.zeros(n, bool)
    rows = []
    for k in range(WARM + iterations):
        begin, spent = time.perf_counter(), dict.fromkeys(PARTS, 0.0)
        columns: list[Any] = []
        for _ in range(horizon):
            clock = time.perf_counter()
            with torch.no_grad():
                chosen = drawn.from_logits(module.forward_exploration({Columns.OBS: torch.from_numpy(seen)})[
                    Columns.ACTION_DIST_INPUTS])  # fmt: skip
                action = chosen.sample()
                logp = chosen.logp(action)
            between = time.perf_counter()
            after, reward, ended, cut, _ = env.step(np.clip(action.numpy(), -1.0, 1.0))
            columns.append((seen, action.numpy(), logp.numpy(), reward, ended, cut, ~over))
            seen, over = after, ended | cut
            spent["policy_s"] += between - clock
            spent["environment_s"] += time.perf_counter() - between
        obs, act, logp, reward, ended, cut, alive = (np.stack(c) for c in zip(*columns, strict=True))
        sampled = time.perf_counter()
        with torch.no_grad():
            everything = torch.from_numpy(np.concatenate([obs, seen[None]]).reshape(-1, obs.shape[-1]))
            value = module.compute_values({Columns.OBS: everything}).numpy().reshape(horizon + 1, n)
        advantage, last = np.zeros_like(value[:-1]), np.zeros(n, np.float32)
        for t in reversed(range(horizon)):
            delta = reward[t] + gamma * value[t + 1] * ~ended[t] - value[t]
            last = (delta + gamma * lam * ~(ended[t] | cut[t]) * last).astype(np.float32)
            advantage[t] = last
        valid = np.flatnonzero(alive.reshape(-1))
        target = torch.from_numpy((advantage + value[:-1]).reshape(-1)[valid])
        flat = advantage.reshape(-1)[valid]
        gain = torch.from_numpy((flat - flat.mean()) / flat.std())
        seen_, act_, logp_ = (torch.from_numpy(x.reshape(-1, *x.shape[2:])[valid]) for x in (obs, act, logp))
        for _ in range(int(text["n_epochs"])):
            for some in torch.randperm(len(valid)).split(size):
                out = module.forward_train({Columns.OBS: seen_[some]})
                policy = module.get_train_action_dist_cls().from_logits(out[Columns.ACTION_DIST_INPUTS])
                ratio = torch.exp(policy.logp(act_[some]) - logp_[some])
                won = torch.min(gain[some] * ratio, gain[some] * ratio.clamp(0.8, 1.2))
                miss = module.compute_values({Columns.OBS: seen_[some]}, embeddings=out[Columns.EMBEDDINGS])
                loss = (-won + 0.5 * (miss - target[some]) ** 2).mean()
                adam.zero_grad()
                loss.backward()
                torch.nn.utils.clip_grad_norm_(module.parameters(), 0.5)
                adam.step()
        end = time.perf_counter()
        row = {"iteration": end - begin, "sampling": sampled - begin, "learning": end - sampled, "steps": len(valid)}
        if k >= WARM:
            rows.append({**row, **spent})
    env.close()
    return rows


def bare(config: Any, n: int = 64, repeats: int = 400) -> float:
    """Return the time of an environment step per arm, µs, for n environments on one thread without a policy."""
    import gymnasium as gym

    env = gym.make_vec(f"flexarm_env:{ENV}", num_envs=n, vectorization_mode="vector_entry_point", threads=1,
                       **config.env_kwargs)  # fmt: skip
    env.reset(seed=0)
    action = np.random.default_rng(0).uniform(-1.0, 1.0, (n, 1)).astype(np.float32)
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        env.step(action)
        times.append(time.perf_counter() - begin)
    env.close()
    return float(np.median(times)) / n * 1e6


# ------------------------------------------------------------------ the page
def medians(rows: list[Row]) -> Row:
    """Return the medians over the iterations, and the rate in steps per second."""
    out = {key: float(np.median([row[key] for row in rows])) for key in rows[0]}
    return out | {"steps_per_second": out["steps"] / out["iteration"]}


def blocks(found: pages.Found) -> pages.Blocks:
    """Format the tables of the page."""
    rows, shares = [], []
    for name, row in found["found"].items():
        cells = (row["steps"], row["steps_per_second"], row["steps"] / row["sampling"])
        cells += tuple(1e3 * row[part] for part in ("iteration", "sampling", "learning"))
        rows.append((name, *(f"{cell:,.0f}" for cell in cells)))
        if name == PLAIN or name.startswith("native"):
            carried = max(0.0, row["sampling"] - sum(row[part] for part in PARTS))
            parts = (*(row[part] for part in PARTS), carried, row["learning"])
            shares.append((name, *(f"{part / row['iteration']:.0%}" for part in parts)))
    heads = (
        "runners | steps per iteration | steps/s | steps/s while sampling | iteration, ms | sampling, ms | learning, ms"
    )
    parts_of = "environments | policy | building episodes | transfer to the training process | learning"
    return {
        "load": [f"The machine's load average was {found['load_average']:.1f} at the "
                 "start."], "rates": table(heads, rows, True),
        "cost": _cost(found["found"], found["bare_us"]), "shares": table(f"| {parts_of}", shares, True),
    }  # fmt: skip


def _cost(found: dict[str, Row], bare_us: float) -> list[str]:
    """Describe the cost of Ray and RLlib in words."""
    without, alone = (found[name]["iteration"] / found[name]["steps"] * 1e6 for name in (PLAIN, ALONE))
    names = ("1 runner", "2 runners")
    ours = [found[f"native, {name}"] for name in names]
    times = [found[f"rllib, {name}"]["sampling"] / row["sampling"] for name, row in zip(names, ours, strict=True)]
    share = [1.0 - without / (row["iteration"] / row["steps"] * 1e6) for row in ours]
    return [
        f"In one process on one core a step takes {without:.0f} µs without RLlib and {alone:.0f} µs with it: RLlib",
        f"takes {1.0 - without / alone:.0%} of the time. The overhead of Ray and RLlib over the plain loop is",
        f"{share[0]:.0%} of an iteration with one runner and {share[1]:.0%} of an iteration with two. To collect the",
        f"same samples, one RLlib runner takes {times[0]:.1f} times as long as one native runner, and two",
        f"RLlib runners take {times[1]:.1f} times as long as two native runners. Without Ray, policy and learning,",
        f"a step of the environments takes {bare_us:.2f} µs.",
    ]


def measure(arguments: argparse.Namespace) -> pages.Found:
    """Measure all arrangements of processes in turn."""
    load = os.getloadavg()[0]
    from agents.rllib import cluster, setup

    try:
        ray = cluster.need_ray()
    except ValueError as error:
        sys.exit(str(error))
    ray.init(num_cpus=4, include_dashboard=False, object_store_memory=cluster.MEMORY, log_to_driver=False,
             logging_level="ERROR")  # fmt: skip
    import torch

    torch.set_num_threads(1)
    config = setup.load(None, ENV)
    rows: dict[str, list[Row]] = {name: [] for name in (PLAIN, *ARRANGEMENTS)}
    for k in range(arguments.rounds):
        rows[PLAIN] += plain(config, arguments.iterations)
        for name, how in ARRANGEMENTS.items():
            rows[name] += on_ray(config, arguments.iterations, **how)
        for name, found in rows.items():
            print(f"round {k + 1}, {name}: {medians(found)['steps_per_second']:.0f} steps/s", flush=True)
    found = {name: medians(each) for name, each in rows.items()}
    return {"load_average": load, "env": ENV, "bare_us": bare(config), "found": found}


if __name__ == "__main__":
    sys.exit(pages.run("ray", __doc__, measure, blocks, packages=("ray", "torch"), iterations=8, rounds=2))
