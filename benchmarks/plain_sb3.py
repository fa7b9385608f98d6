"""Train Stable-Baselines3 with its default settings on each environment: docs/results/plain_sb3.{md,json}.

    python -m benchmarks.plain_sb3 [--id ID ...] [--algo ALGO ...] [--seeds N] [--steps N] [--page] [--out FOLDER]

A run is `ALGO("MlpPolicy", gym.make(ID), seed=SEED).learn(...)` on one PyTorch thread. At fixed numbers of steps its
deterministic policy plays 100 episodes that no training uses. Finished runs are stored in runs/benchmarks/, so that an
interrupted call continues. Each call adds its runs to the record and leaves the other runs unchanged.
"""

import argparse
import sys
import time
from typing import Any

import gymnasium as gym
import numpy as np

import flexarm_env  # noqa: F401  (registers the environments)
from benchmarks import pages
from benchmarks.machine import DOCS, describe_machine, table
from benchmarks.running import STORE, Row, run_all

IDS = ("FlexibleArm-v0", "TwoLinkFlexArm-v0", "MultiLinkFlexArm-v0", "SpatialFlexArm-v0")
EVALUATED_AFTER = {
    "ppo": (100_000, 300_000, 1_000_000),
    "sac": (30_000, 100_000),
    "td3": (30_000, 100_000),
}
"""Training steps after which a policy is evaluated."""

FIRST_SEED, EPISODES = 1_000_000, 100
"""Evaluation episode i is reset with seed FIRST_SEED + i. Training passes other seeds to its environment."""


def judge(policy: Any, env: gym.Env[Any, Any], episodes: int = EPISODES) -> dict[str, float]:
    """Share of successful episodes, share of failed ones, and mean return of a deterministic policy."""
    successes, failures, returns = 0, 0, 0.0
    for i in range(episodes):
        observation, _ = env.reset(seed=FIRST_SEED + i)
        terminated = truncated = False
        while not (terminated or truncated):
            observation, reward, terminated, truncated, info = env.step(policy(observation))
            returns += float(reward)
        failures += terminated
        successes += bool(info["is_success"]) and not terminated
    return {"success": successes / episodes, "failed": failures / episodes, "return": returns / episodes}


def train(case: Row) -> Row:
    """Train one seed; {"curve": evaluations, "cpu_s": CPU time of training without evaluations, "date": ...}."""
    import stable_baselines3 as sb3
    import torch
    from stable_baselines3.common.callbacks import BaseCallback

    torch.set_num_threads(1)
    steps_left = [steps for steps in EVALUATED_AFTER[case["algo"]] if steps <= case["steps"]]
    last = steps_left[-1]
    judged_env = gym.make(case["id"])
    curve: list[Row] = []
    spent = 0.0

    class Evaluations(BaseCallback):
        """Evaluates the present policy when the number of steps is reached."""

        def _on_step(self) -> bool:
            nonlocal spent
            if steps_left and self.num_timesteps >= steps_left[0]:
                clock = time.process_time()
                steps = steps_left.pop(0)
                curve.append(
                    {"steps": steps, **judge(lambda seen: self.model.predict(seen, deterministic=True)[0], judged_env)}
                )
                print(case["id"], case["algo"], case["seed"], curve[-1], flush=True)
                spent += time.process_time() - clock
            return bool(steps_left)

    begun = time.process_time()
    model = getattr(sb3, case["algo"].upper())("MlpPolicy", gym.make(case["id"]), seed=case["seed"])
    model.learn(last, callback=Evaluations())
    return {"curve": curve, "cpu_s": time.process_time() - begun - spent, "date": describe_machine()["date"]}


def measure(options: argparse.Namespace) -> pages.Found:
    """Train the selected cases; the record's other runs are kept."""
    cases = [
        {"id": env_id, "algo": algo, "seed": seed, "steps": min(options.steps, EVALUATED_AFTER[algo][-1])}
        for env_id in options.id
        for algo in options.algo
        for seed in range(options.seeds)
    ]
    runs = {_name(row): row for row in pages.kept(options.out, "plain_sb3").get("runs", [])}
    runs |= {_name(row): row for row in run_all("plain SB3", cases, train, STORE / "plain_sb3.jsonl")}
    return {"runs": [runs[name] for name in sorted(runs)], "recommended": recommended()}


def _name(row: Row) -> tuple[Any, ...]:
    """Sort key of a run: environment, algorithm, seed."""
    case = row["case"]
    return IDS.index(case["id"]), list(EVALUATED_AFTER).index(case["algo"]), case["seed"]


def recommended() -> dict[str, Row]:
    """Success of PPO with the packaged settings, by environment, from the record of `benchmarks.gradients`."""
    found: dict[str, Row] = {}
    for run in pages.kept(DOCS / "results", "gradients")["runs"]:
        if run["algorithm"] == "ppo":
            one = found.setdefault(run["env"], {"steps": run["steps"], "success": []})
            one["success"].append(run["success"])
    return found


def blocks(found: pages.Found) -> pages.Blocks:
    """Table of the page: a row for each environment and algorithm, a column for each number of steps."""
    columns = sorted({steps for after in EVALUATED_AFTER.values() for steps in after})
    rows = []
    for env_id in IDS:
        for algo, after in EVALUATED_AFTER.items():
            runs = [run for run in found["runs"] if (run["case"]["id"], run["case"]["algo"]) == (env_id, algo)]
            curves = [{point["steps"]: point for point in run["curve"]} for run in runs]
            cells = [percent([curve[steps]["success"] for curve in curves if steps in curve]) for steps in columns]
            cells = [cell if steps in after else "" for steps, cell in zip(columns, cells, strict=True)]
            cpu = [run["cpu_s"] / 60.0 for run in runs if run["curve"][-1]["steps"] == after[-1]]
            rows.append([f"`{env_id}`", algo.upper(), len(runs), *cells, f"{np.mean(cpu):.0f}" if cpu else ""])
    beside = [
        (f"`{env_id}`", f"{row['steps'] / 1e6:.1f} million", percent(row["success"]))
        for env_id, row in found["recommended"].items()
    ]
    heads = (
        "environment | algorithm | seeds | "
        + " | ".join(f"{steps:,} steps" for steps in columns)
        + " | training time, CPU min"
    )
    return {
        "success": table(heads, rows),
        "recommended": table("environment | steps | success of each seed", beside),
    }


def percent(shares: list[float]) -> str:
    """Success of each seed in a cell."""
    return ", ".join(f"{100.0 * share:.0f}" for share in shares) + " %" if shares else "not measured"


if __name__ == "__main__":
    several = {"nargs": "+", "metavar": "WORD"}
    words = {
        "id": {**several, "choices": IDS, "default": IDS, "help": "environments"},
        "algo": {**several, "choices": tuple(EVALUATED_AFTER), "default": tuple(EVALUATED_AFTER), "help": "algorithms"},
    }
    versions = ("stable-baselines3", "torch")
    sys.exit(pages.run("plain_sb3", __doc__, measure, blocks, packages=versions, more=words, seeds=3, steps=1_000_000))
