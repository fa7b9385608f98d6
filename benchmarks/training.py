"""Training throughput of the native vector environment against SB3's SubprocVecEnv: docs/results/training.{md,json}.

python -m benchmarks.training [--env FlexibleArm-v0] [--rollouts 6] [--rounds 3] [--out FOLDER]

Both sides train the same PPO: network [64, 64], rollouts of 8192 steps, batches of 2048, 10 epochs, one torch thread.
Ours steps 64 environments in one compiled call; the other side is `make_vec_env(..., n_envs=8)` with SubprocVecEnv, as
Stable-Baselines3's own guide has it. They take turns, so that what else runs on the machine meets both alike; the
rate is that of the median rollout with its update, the first of each turn left out. CPU time counts the worker
processes too.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.machine import describe_machine, write_text

RESULTS = Path(__file__).parents[1] / "docs" / "results"
ROLLOUT = 8192
PPO: dict[str, Any] = {
    "batch_size": 2048, "n_epochs": 10, "gamma": 0.98, "learning_rate": 1e-3,
    "policy_kwargs": {"net_arch": [64, 64]}, "seed": 0, "device": "cpu",
}  # fmt: skip
SIDES = {"native, 64 environments": 64, "SubprocVecEnv, 8 processes": 8}


def make(env_id: str, n: int, kwargs: dict[str, Any]) -> Any:
    """The side's VecEnv."""
    if n == 64:
        from flexarm_env.sb3 import make_sb3_vec

        return make_sb3_vec(env_id, n, seed=0, **kwargs)
    from stable_baselines3.common.env_util import make_vec_env
    from stable_baselines3.common.vec_env import SubprocVecEnv

    import flexarm_env  # noqa: F401  (registers the environments)

    return make_vec_env(f"flexarm_env:{env_id}", n, seed=0, env_kwargs=kwargs, vec_env_cls=SubprocVecEnv)


def cpu(workers: Sequence[Any]) -> float:
    """CPU seconds of this process and of its workers (NaN where the system does not tell)."""
    total = time.process_time()
    for worker in workers:
        try:
            fields = Path(f"/proc/{worker.pid}/stat").read_text().rpartition(")")[2].split()
        except OSError:
            return float("nan")
        total += (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    return total


def turn(env_id: str, n: int, rollouts: int, kwargs: dict[str, Any]) -> tuple[list[float], list[float]]:
    """Wall and CPU seconds of each rollout with its update, the first left out."""
    import stable_baselines3
    from stable_baselines3.common.callbacks import BaseCallback

    class Clock(BaseCallback):
        """Notes when rollouts begin."""

        def __init__(self) -> None:
            super().__init__()
            self.at: list[tuple[float, float]] = []

        def _on_rollout_start(self) -> None:
            self.at.append((time.perf_counter(), cpu(getattr(self.training_env.unwrapped, "processes", ()))))

        def _on_step(self) -> bool:
            return True

    env = make(env_id, n, kwargs)
    clock = Clock()
    try:
        model = stable_baselines3.PPO("MlpPolicy", env, n_steps=ROLLOUT // n, **PPO)
        model.learn((rollouts + 2) * ROLLOUT, callback=clock)
    finally:
        env.close()
    walls, cpus = np.diff(np.array(clock.at), axis=0)[1:].T
    return walls.tolist(), cpus.tolist()


def measure(env_id: str, rollouts: int, rounds: int, kwargs: dict[str, Any]) -> dict[str, Any]:
    """Rates of both sides, steps/s, and their ratio."""
    import torch

    torch.set_num_threads(1)
    walls: dict[str, list[float]] = {name: [] for name in SIDES}
    cpus: dict[str, list[float]] = {name: [] for name in SIDES}
    for k in range(rounds):
        for name, n in SIDES.items():
            times, busy = turn(env_id, n, rollouts, kwargs)
            walls[name] += times
            cpus[name] += busy
            rate, load = ROLLOUT / np.median(times), np.median(busy) / ROLLOUT * 1e6
            print(f"round {k + 1}, {env_id}, {name}: {rate:.0f} steps/s, {load:.0f} us CPU a step", flush=True)
    rows = {
        name: {
            "steps_per_second": ROLLOUT / float(np.median(walls[name])),
            "steps_per_second_quartiles": [ROLLOUT / float(q) for q in np.quantile(walls[name], (0.75, 0.25))],
            "cpu_microseconds_per_step": float(np.median(cpus[name])) / ROLLOUT * 1e6,
        }
        for name in SIDES
    }
    ours, theirs = (rows[name] for name in SIDES)
    return {
        "env": env_id,
        "env_kwargs": kwargs,
        "rows": rows,
        "ratio": ours["steps_per_second"] / theirs["steps_per_second"],
        "ratio_cpu": theirs["cpu_microseconds_per_step"] / ours["cpu_microseconds_per_step"],
    }


def table(results: list[dict[str, Any]], machine: dict[str, str], load: float) -> str:
    """The page."""
    lines = [
        "# Training throughput", "",
        "Environment steps a second of PPO, rollouts and updates together: the native vector environment against",
        "Stable-Baselines3's SubprocVecEnv on the same environment, with the same network [64, 64], rollouts of 8192",
        "steps, batches of 2048, 10 epochs and one torch thread, taking turns in one run. CPU time counts all",
        "processes. Written by `python -m benchmarks.training`.", "",
        " · ".join(f"{k}: {v}" for k, v in machine.items()) + f" · load average at the start: {load:.1f}", "",
        "| environment | side | steps/s (quartiles) | CPU µs a step | times as fast | less CPU |",
        "|---|---|---:|---:|---:|---:|",
    ]  # fmt: skip
    for result in results:
        for k, (name, row) in enumerate(result["rows"].items()):
            low, high = row["steps_per_second_quartiles"]
            last = f"{result['ratio']:.1f} | {result['ratio_cpu']:.1f}" if k == 0 else "1 | 1"
            lines.append(
                f"| {result['env']} | {name} | {row['steps_per_second']:.0f} ({low:.0f} to {high:.0f}) "
                f"| {row['cpu_microseconds_per_step']:.0f} | {last} |"
            )
    return "\n".join(lines) + "\n"


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--env", default="FlexibleArm-v0,TwoLinkFlexArm-v0", help="ids, separated by commas")
    parser.add_argument("--env-kwargs", type=json.loads, default={}, help="keywords of the environment, JSON")
    parser.add_argument("--rollouts", type=int, default=6, help="rollouts of a turn that are measured")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--out", type=Path, default=RESULTS)
    arguments = parser.parse_args()
    load = os.getloadavg()[0]
    ids = arguments.env.split(",")
    results = [measure(one, arguments.rollouts, arguments.rounds, arguments.env_kwargs) for one in ids]
    machine = describe_machine("stable-baselines3", "torch")
    content = {"machine": machine, "load_average": load, "rollout": ROLLOUT, "results": results}
    write_text(arguments.out / "training.json", json.dumps(content, indent=1) + "\n")
    page = table(results, machine, load)
    write_text(arguments.out / "training.md", page)
    print(page)


if __name__ == "__main__":
    main()
