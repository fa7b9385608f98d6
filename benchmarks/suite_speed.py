"""Measure steps per second of the suite's tasks, each beside its plain environment: docs/results/throughput.md.

    python -m benchmarks.suite_speed [--rounds 4] [--page] [--out FOLDER]

64 arms run on one thread with random actions. The tasks alternate. Rates are of processor time, in the best round of
each task, because other programs may use the machine too.
"""

import argparse
import sys
import time

import gymnasium as gym

from benchmarks import pages
from benchmarks.machine import table
from benchmarks.running import periods
from flexarm_env import suite

ARMS, PERIODS = 64, 190


def measure(options: argparse.Namespace) -> pages.Found:
    """Measure steps per second of all tasks and of their plain environments, alternately."""
    rows = []
    for task in suite.tasks():
        ids = f"flexarm_env:{task.environment}", task.env_id
        pair = [gym.make_vec(env_id, num_envs=ARMS, threads=1) for env_id in ids]
        seconds = [[periods(env, PERIODS, time.process_time) for env in pair] for _ in range(options.rounds + 1)]
        plain, own = (PERIODS * ARMS / min(values) for values in zip(*seconds[1:], strict=True))  # the first compiles
        row = {"task": task.id, "environment": task.environment, "plain_rate": plain, "task_rate": own}
        rows.append(row | {"ratio": own / plain})
        print(rows[-1], flush=True)
    return {"rows": rows}


def blocks(found: pages.Found) -> pages.Blocks:
    """Format the table of the page."""
    cells = [
        (f"[{row['task']}](../suite/{row['task']}.md)", f"`{row['environment']}`", f"{row['plain_rate']:,.0f}",
         f"{row['task_rate']:,.0f}", f"{row['ratio']:.2f}")
        for row in found["rows"]
    ]  # fmt: skip
    return {
        "rates": table("task | environment | steps/s of the plain environment | steps/s of the task | ratio", cells)
    }


if __name__ == "__main__":
    sys.exit(pages.run("suite_speed", __doc__, measure, blocks, page="results/throughput", rounds=4))
