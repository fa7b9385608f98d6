"""What the suite's tasks cost: environment steps a second of each beside the plain environment that it is made of:
docs/results/suite_speed.{md,json}.

    python -m benchmarks.suite_speed [--rounds 5] [--out FOLDER]

64 arms on one thread by random actions, in turns, by processor time, the best round of each (others may share the
machine).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import gymnasium as gym

from benchmarks.machine import command, describe_machine, publish, table, told
from flexarm_env import suite

ARMS, PERIODS = 64, 190

LEAST = 0.5
"""Of the plain environment's rate that a task is to have."""

WHY = {
    "slew-geared-v1": "the rotor has an equation of its own, and whether the joint sticks is solved for at every step",
}
"""What the physics asks for where a task is slower than that."""


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


def measure(rounds: int) -> list[dict[str, Any]]:
    """Rates of all tasks, 1/s, and of their environments as they come, from the same rounds."""
    rows = []
    for task in suite.tasks():
        pair = {"plain": runner(f"flexarm_env:{task.environment}"), "task": runner(task.env_id)}
        seconds: dict[str, list[float]] = {key: [] for key in pair}
        for _ in range(rounds + 1):  # the first compiles
            for key, run in pair.items():
                seconds[key].append(run())
        plain, own = (1.0 / min(values[1:]) for values in seconds.values())
        row = {"task": task.id, "environment": task.environment, "plain_rate": plain, "task_rate": own}
        rows.append(row | {"ratio": own / plain})
        print(rows[-1], flush=True)
    return rows


def page(machine: dict[str, str], rows: list[dict[str, Any]], rounds: int) -> str:
    """The results as Markdown."""
    cells = [
        [f"[{row['task']}](../suite/{row['task']}.md)", f"`{row['environment']}`", f"{row['plain_rate']:,.0f}",
         f"{row['task_rate']:,.0f}", f"{row['ratio']:.2f}"]
        for row in rows
    ]  # fmt: skip
    slow = [f"- `{row['task']}`: {WHY[row['task']]}." for row in rows if row["ratio"] < LEAST and row["task"] in WHY]
    lines = [
        "# How fast the suite's tasks run", "",
        f"Environment steps a processor second of {ARMS} arms on one thread, random actions, autoreset counted, beside",
        f"the plain environment as it comes; both in turn, the best of {rounds} rounds. Written by",
        "`python -m benchmarks.suite_speed`.", "",
        told(machine), "",
        *table("task | environment | plain, 1/s | task, 1/s | ratio", cells), "",
        *([f"Below {LEAST}, for which there is a reason:", "", *slow, ""] if slow else []),
    ]  # fmt: skip
    return "\n".join(lines).rstrip() + "\n"


def main() -> None:
    """Measure and publish."""
    arguments = command(__doc__, rounds=5).parse_args()
    machine, rows = describe_machine(), measure(arguments.rounds)
    publish("suite_speed", arguments.out, {"machine": machine, "rows": rows}, page(machine, rows, arguments.rounds))


if __name__ == "__main__":
    main()
