"""What the suite's tasks cost, steps a second of each beside its plain environment: docs/results/throughput.md.

    python -m benchmarks.suite_speed [--rounds 4] [--page] [--out FOLDER]

64 arms on one thread by random actions, in turns, by processor time, the best round of each (others may share the
machine).
"""

import argparse
import sys
import time
from collections.abc import Callable
from typing import Any

import gymnasium as gym

from benchmarks import pages
from benchmarks.machine import table
from flexarm_env import suite

ARMS, PERIODS = 64, 190


def runner(env_id: str) -> Callable[[], float]:
    """Processor seconds of a control period of an arm."""
    env: Any = gym.make_vec(env_id, num_envs=ARMS, threads=1)
    env.action_space.seed(0)
    actions = [env.action_space.sample() for _ in range(64)]

    def run() -> float:
        env.reset(seed=0)
        clock = time.process_time()
        for k in range(PERIODS):
            env.step(actions[k % 64])
        return (time.process_time() - clock) / (PERIODS * ARMS)

    return run


def measure(options: argparse.Namespace) -> pages.Found:
    """Rates of all tasks, 1/s, and of their environments as they come, from the same rounds."""
    rows = []
    for task in suite.tasks():
        pair = {"plain": runner(f"flexarm_env:{task.environment}"), "task": runner(task.env_id)}
        seconds: dict[str, list[float]] = {key: [] for key in pair}
        for _ in range(options.rounds + 1):  # the first compiles
            for key, run in pair.items():
                seconds[key].append(run())
        plain, own = (1.0 / min(values[1:]) for values in seconds.values())
        row = {"task": task.id, "environment": task.environment, "plain_rate": plain, "task_rate": own}
        rows.append(row | {"ratio": own / plain})
        print(rows[-1], flush=True)
    return {"rows": rows}


def blocks(found: pages.Found) -> pages.Blocks:
    """Table of the page."""
    cells = [
        (f"[{row['task']}](../suite/{row['task']}.md)", f"`{row['environment']}`", f"{row['plain_rate']:,.0f}",
         f"{row['task_rate']:,.0f}", f"{row['ratio']:.2f}")
        for row in found["rows"]
    ]  # fmt: skip
    return {"rates": table("task | environment | plain, 1/s | task, 1/s | ratio", cells)}


if __name__ == "__main__":
    sys.exit(pages.run("suite_speed", __doc__, measure, blocks, page="results/throughput", rounds=4))
