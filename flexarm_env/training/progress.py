"""Progress of a training run: learning curve, best policy so far, and the time at which the task was solved."""

import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from flexarm_env.training import episodes
from flexarm_env.training.runs import INTERRUPTED, fail, read_run, write_json, write_rows

sys.modules.setdefault("agents.progress", sys.modules[__name__])  # as pickles of older run folders name it

COLUMNS = (
    "steps", "success_rate", "settling_mean", "settling_median", "return_mean", "train_return", "std", "learning_rate",
    "wall_s", "cpu_s",
)  # fmt: skip
"""Columns of the learning curve. All but the last two are reproducible with the same seed on the same machine."""


@dataclass
class Progress:
    """Progress of a run, which is stored in every checkpoint.

    curve: learning curve, one row of COLUMNS per evaluation. best: smallest cost so far (see `cost`). best_return: mean
    return of the evaluation with the smallest cost. Until an episode succeeds, all costs are equal, and the evaluation
    with the higher return is better. solved: row of `curve` at which the task was solved, or None. wall_s, cpu_s: time
    spent so far, s, without evaluation and checkpoints.
    """

    curve: list[dict[str, float]] = field(default_factory=list)
    best: float = float("inf")
    best_return: float = -float("inf")
    best_steps: int = 0
    solved: dict[str, float] | None = None
    wall_s: float = 0.0
    cpu_s: float = 0.0

    def add(
        self, result: episodes.Episodes, steps: int, solved_at: float, best_by: str = "settling", **others: float
    ) -> bool:
        """Add an evaluation after `steps` steps; return whether the evaluation is the best so far.

        solved_at: success rate at which the task counts as solved. best_by: argument `by` of `cost`. others: values of
        the columns train_return, std and learning_rate.
        """
        row = {
            "steps": float(steps),
            "success_rate": float(result.success.mean()),
            "settling_mean": float(result.settling.mean()),
            "settling_median": float(np.median(result.settling)),
            "return_mean": float(result.returns.mean()),
            **others,
            "wall_s": round(self.wall_s, 2),
            "cpu_s": round(self.cpu_s, 2),
        }
        self.curve.append(row)
        if self.solved is None and row["success_rate"] >= solved_at:
            self.solved = dict(row)
        now = cost(result, best_by)
        # smaller cost, then larger mean return
        better = (now, -row["return_mean"]) < (self.best, -self.best_return)
        if better:
            self.best, self.best_return, self.best_steps = now, row["return_mean"], steps
        return better

    def judged(self, steps: int) -> bool:
        """Return whether the training had done exactly `steps` steps at the last evaluation."""
        return steps in [row["steps"] for row in self.curve[-1:]]

    def outcome(self) -> dict[str, Any]:
        """Return the entries of run.json for a finished run."""
        return {
            "finished": True,
            "steps": self.curve[-1]["steps"],
            "wall_s": self.wall_s,
            "cpu_s": self.cpu_s,
            "best_steps": self.best_steps,
            "best": self.best,
            "solved": self.solved,
        }


def cost(result: episodes.Episodes, by: str = "settling") -> float:
    """Return the cost by which the best policy of a run is chosen: the mean settling time, s, if by="settling".

    A failed episode counts with twice its duration. If by="return", the cost is minus the mean return.
    """
    if by == "return":
        return -float(result.returns.mean())
    # failed episodes cost twice the duration
    duration = (len(result.errors) - 1) * result.dt
    return float(np.where(result.success, result.settling, 2.0 * duration).mean())


def after(steps: int, every: int) -> int:
    """Return the first multiple of `every` above `steps`."""
    return (steps // every + 1) * every


def write_curve(path: Path, rows: list[dict[str, float]]) -> None:
    """Write the learning curve as a CSV file."""
    write_rows(path, COLUMNS, ({k: f"{v:.10g}" for k, v in row.items()} for row in rows))


def describe(progress: Progress) -> str:
    """Describe the progress of a run in a few words, for the progress bar."""
    if not progress.curve:
        return "nothing evaluated"
    rows = {row["steps"]: row for row in progress.curve}
    best = rows[float(progress.best_steps)]
    text = (
        f"best at {progress.best_steps} steps: success {best['success_rate']:.0%}, "
        f"median settling {best['settling_median']:.2f} s (validation episodes)"
    )
    if progress.solved is not None:
        s = progress.solved
        text += f"; solved after {s['steps']:.0f} steps, {s['wall_s']:.0f} s ({s['cpu_s']:.0f} s CPU)"
    return text


def bar(shown: bool, total: int, steps: int) -> Any:
    """Create a progress bar of environment steps."""
    from tqdm import tqdm

    return tqdm(total=total, initial=steps, unit="step", unit_scale=True, mininterval=0.5, disable=not shown)


def finish(folder: Path, record: dict[str, Any], progress: Progress) -> None:
    """Write a finished run's results into its record, and plot its learning curve."""
    from flexarm_env.training.figures import learning_curve

    write_json(folder / "run.json", record | progress.outcome())
    learning_curve([progress.curve], folder / "learning_curve.png", record["env_id"])


def training_program(program: str, train: Callable[[Any], Any], arguments: Any) -> int:
    """Call `train(arguments)`; print the result, or an error and how to continue; return the exit code."""
    try:
        progress = train(arguments)
    except ValueError as error:
        return fail(error)
    except (KeyboardInterrupt, OSError) as error:
        folder = arguments.folder
        there, again = (folder / "run.json").is_file(), f"go on with: {program} --out {folder} --resume"
        then = again if there else f"nothing is in {folder} yet: start it again"
        if isinstance(error, KeyboardInterrupt):
            sys.stderr.write(f"interrupted; {then}\n")
            return INTERRUPTED
        what = f"{folder if error.filename is None else error.filename}: {error.strerror or error}"
        return fail(f"{what}; what was written before is whole; when that is mended, {then}")
    folder, env = arguments.folder, "" if arguments.env == "FlexibleArm-v0" else f" --env {arguments.env}"
    print(f"{folder}: {describe(progress)}")
    presses = arguments.config == "press" or arguments.env.startswith("flexarm/press-")
    beside = "pd,hybrid_force" if presses else "pd,lqr"
    print(f"next: flexarm evaluate{env} --policy {folder},{beside}    or    flexarm view {folder} pd")
    return 0


def finished(trainer: Any, folder: Path, **given: Any) -> str:
    """Start or resume the run in a folder, unless the run is finished; return a text about the run's result."""
    begun = (folder / "run.json").exists()
    if begun and read_run(folder).get("finished"):
        return f"kept from an earlier call ({folder})"
    return describe(trainer.train(trainer.Arguments(out=folder, resume=begun, **given)))
