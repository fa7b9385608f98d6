"""`make ray-demo`: train RLlib's PPO on FlexibleArm-v0 with two runners, and evaluate it on the 100 evaluation
episodes.

    python -m agents.ray_demo [--out runs/ray-demo] [--runners 2] [--seed 0] [--fresh]

The output folder contains the run folder, figures and report.md. Existing results are kept: a second call continues
where the first call stopped (--fresh starts again). The exit code is 1 if the task is not solved.
"""

import sys
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from agents.demo import ENV, judged
from flexarm_env.training.progress import finished
from flexarm_env.training.runs import command, fail, own_folder, report

SOLVED = 0.95


@dataclass(frozen=True)
class Arguments:
    """Arguments of `python -m agents.ray_demo`.

    Args:
        out: folder of all results.
        steps: environment steps of the training run.
        runners: number of processes that step environments.
        seed: seed of the training run.
        fresh: remove the contents of the folder first.
    """

    out: Path = Path("runs/ray-demo")
    steps: int = 800_000
    runners: int = 2
    seed: int = 0
    fresh: bool = False


def demonstrate(arguments: Arguments) -> int:
    """Train and evaluate the policy, and write report.md; return the exit code."""
    out, clock = own_folder(arguments.out, arguments.fresh), time.perf_counter()
    print(f"1/2 training PPO of RLlib on {ENV}, {arguments.runners} runners, {arguments.steps} steps", flush=True)
    from agents import train_rllib

    note = finished(
        train_rllib, out / "ppo", env=ENV, progress=sys.stderr.isatty(), seed=arguments.seed,
        n_timesteps=arguments.steps, runners=arguments.runners,
    )  # fmt: skip
    print("2/2 judging it beside classical controllers", flush=True)
    rows, lines = judged(out, ("pd", "zvd", "lqr"))
    report(out, "Training on Ray", clock, [
        f"PPO of RLlib on {ENV}, {arguments.runners} runners: {note}.", "",
        "![learning curve](ppo/learning_curve.png)", "", *lines,
    ])  # fmt: skip
    success = float(rows["ppo"]["success_rate"])
    if success < SOLVED:
        return fail(f"not solved: {success:.0%} of the episodes succeed, {SOLVED:.0%} are asked for") - 1
    return 0


main = partial(command, Arguments, "python -m agents.ray_demo", __doc__, demonstrate)

if __name__ == "__main__":
    sys.exit(main())
