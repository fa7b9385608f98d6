"""Reference results on the suite: train and evaluate methods on its tasks, and write docs/results/suite*.md.

    python -m agents.suite --plan                    # print jobs that are done, jobs to do, and their time
    python -m agents.suite                           # all missing jobs: days on two cores; can be continued
    python -m agents.suite --only pd,lqg             # these methods alone
    python -m agents.suite --only ppo --seeds 1 --minutes 60

Controllers are evaluated first, then the first seed of each method that learns, then the next seed. Runs are written to
runs/suite/METHOD-SEED/TASK, where an interrupted run is continued, and results to docs/results/suite/METHOD-SEED.json.
The pages are written again after each job. A training run uses the task's budget of control periods, times --share. The
run's policy with the highest mean return on the validation episodes is evaluated. --freeze writes the references of the
scores.
"""

import os
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from flexarm_env import control, suite
from flexarm_env.control import FORCE_NAMES, NAMES
from flexarm_env.suite.overview import figure_data
from flexarm_env.suite.page import pages
from flexarm_env.suite.policies import Chosen, choose, fingerprint
from flexarm_env.suite.results import (
    Results,
    begun,
    chosen_tasks,
    folder_of,
    frozen,
    judged,
    length,
    of_task,
    of_the_protocol,
    value,
)  # fmt: skip
from flexarm_env.suite.score import EPISODES, FLOOR, Reference
from flexarm_env.suite.score import references as frozen_references
from flexarm_env.training.runs import command, read_run, write_json, write_text

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "docs" / "results" / "suite"
REFERENCES = ROOT / "flexarm_env" / "data" / "suite" / "references.json"

FEW = ("slew-unknown-v2", "slew-geared-v2", "reach-measured-v1")
"""Tasks on which methods with memory, and methods that learn from earlier data, should have an advantage."""

PRESSED = ("press-v1", "land-v1", "wipe-v1")
"""Tasks for controllers of the contact force."""

FREE = tuple(task.id for task in suite.tasks() if task.id not in PRESSED)
"""Present tasks without contact."""

MANY = {
    "slew-measured-v2": 9000, "slew-unknown-v2": 2600, "slew-limited-v2": 2000, "slew-handling-v2": 10_000,
    "reach-measured-v1": 700, "reach-three-v2": 480, "reach-pushed-v1": 320, "float-reach-v1": 450,
    "space-reach-v1": 600, "space-wall-v1": 240, "space-measured-v1": 200, "land-v1": 700,
}  # fmt: skip
"""Numbers of episodes for tasks whose scores over 100 episodes are less certain than `flexarm_env.suite.page.WIDTH`."""

SECONDS = {"ppo": 60e-6, "gradient": 60e-6, "sac": 1.5e-3, "tqc": 2.5e-3, "recurrent_ppo": 1.2e-3}
"""Approximate CPU time, s, of a control period in training; used only by --plan."""


@dataclass(frozen=True)
class Method:
    """Method of the reference results.

    Args:
        name: name of the controller, or of the method's results. seeds: number of runs. algorithm: training algorithm;
            "": a controller. tasks: ids; None: all. config: file of hyperparameters, configs/ALGORITHM/CONFIG.yml.
    """

    name: str
    seeds: int = 1
    algorithm: str = ""
    tasks: tuple[str, ...] | None = None
    config: str = "suite"


METHODS = (
    *(Method(name, tasks=PRESSED if name in FORCE_NAMES else None) for name in NAMES),
    Method("ppo", 5, "ppo", FREE),
    Method("gradient", 3, "gradient", FREE),
    Method("sac", 1, "sac", ("slew-measured-v2", "slew-unknown-v2", "slew-geared-v2")),
    Method("tqc", 2, "tqc", FEW),
    Method("recurrent_ppo", 2, "recurrent_ppo", FEW),
    Method("ppo_press", 1, "ppo", ("press-v1", "land-v1"), "press"),
    Method("foresight", 1, "foresight"),
)


@dataclass(frozen=True)
class Arguments:
    """Arguments of `python -m agents.suite`.

    Args:
        only: methods, separated by commas; default all.
        task: ids of tasks, separated by commas; default all.
        seeds: largest number of runs of each method that learns.
        share: share of each task's training budget, for a preview.
        minutes: time after which no further run is started.
        home: folder of the runs.
        results: folder of the results files; the pages are written beside it.
        figures: folder of the figure of scores; default: docs/figures, or the folder of the pages with other --results.
        plan: only print the jobs.
        freeze: only write the references of tasks that have none: PD's mean returns, and the highest of all results.
        progress: show progress bars.
    """

    only: str | None = None
    task: str | None = None
    seeds: int = 5
    share: float = 1.0
    minutes: float | None = None
    home: Path = Path("runs/suite")
    results: Path = RESULTS
    figures: Path | None = None
    plan: bool = False
    freeze: bool = False
    progress: bool = True


@dataclass(frozen=True)
class Job:
    """One run of a method on a task."""

    method: Method
    seed: int
    task: suite.Task

    @property
    def name(self) -> str:
        """Name for display."""
        return f"{self.method.name}-{self.seed} on {self.task.id}"

    def folder(self, home: Path) -> Path:
        """Return the run folder."""
        return home / f"{self.method.name}-{self.seed}" / self.task.id

    @property
    def episodes(self) -> int:
        """Number of evaluation episodes; actions optimized in advance exist for 100 episodes only."""
        return EPISODES if self.method.algorithm == "foresight" else MANY.get(self.task.id, EPISODES)

    def done(self, results: Path) -> bool:
        """Return whether the results file contains the job's result, or the reason why the result is missing."""
        known = begun(results, self.method.name, self.seed)
        entry = known.tasks.get(self.task.id)
        if entry is None:
            return self.task.id in known.refused
        return of_the_protocol(self.task, entry) and length(entry) >= self.episodes


def jobs(arguments: Arguments) -> Iterator[Job]:
    """Return all jobs in order. Raises ValueError for an unknown method."""
    names = [method.name for method in METHODS]
    chosen = names if arguments.only is None else [word.strip() for word in arguments.only.split(",")]
    for word in chosen:
        if word not in names:
            raise ValueError(f"--only {word}: must be among {', '.join(names)}")
    tasks = [frozen(task) for task in chosen_tasks(arguments.task)]
    for seed in range(max((method.seeds for method in METHODS), default=0)):
        for method in METHODS:
            most = method.seeds if method.algorithm == "" else min(method.seeds, arguments.seeds)
            if method.name in chosen and seed < most:
                yield from (Job(method, seed, task) for task in tasks if task.id in (method.tasks or (task.id,)))


# ------------------------------------------------------------------ one job
def run(job: Job, arguments: Arguments) -> str:
    """Train and evaluate the method; return a line about the result."""
    word, chooser = job.method.name, choose
    if job.method.algorithm:
        try:
            word = str(train(job, arguments))
        except ValueError as error:
            if job.method.algorithm != "foresight":
                raise
            known = begun(arguments.results, job.method.name, job.seed)  # it is not made for the task, which is noted
            known.refused[job.task.id] = " ".join(str(error).split())
            known.write(arguments.results)
            return f"{job.name}: {error}"
        chooser = of_run
    name, folder = job.method.name, arguments.results
    results, trouble, _ = judged(
        word, [job.task], folder, name=name, run=job.seed, episodes=job.episodes, choose=chooser
    )
    if trouble:
        return f"{job.name}: not judged: {trouble[0]}"
    return f"{job.name}: J {value(job.task, results.tasks[job.task.id]):.2f}"


def train(job: Job, arguments: Arguments) -> Path:
    """Train a run, resume it, or keep it if finished; return its folder."""
    from flexarm_env.training import train as train_ppo
    from flexarm_env.training.progress import finished

    folder = job.folder(arguments.home)
    if job.method.algorithm == "foresight":
        from agents import foresight

        return foresight.found(job.task, folder)
    algorithm, steps = job.method.algorithm, round(job.task.budget * arguments.share)
    finished(
        train_ppo, folder, env=job.task.registered, algo=algorithm, seed=job.seed, n_timesteps=steps, best_by="return",
        config=ROOT / "configs" / algorithm / f"{job.method.config}.yml", evaluate_every=max(32_768, round(steps / 20)),
        tensorboard=False, progress=arguments.progress,
    )  # fmt: skip
    return folder


def of_run(word: str, task: suite.Task) -> Chosen:
    """Return the policy of a run folder: actions.npz, policy.npz, or the model if the policy has a memory."""
    folder = Path(word)
    if (folder / "actions.npz").is_file():
        from agents import foresight

        return foresight.chosen(folder)
    if (folder / "policy.npz").is_file():
        return choose(word, task)
    record = read_run(folder)
    content = fingerprint((folder / "model.zip").read_bytes())
    training = {key: record[key] for key in ("algorithm", "steps", "wall_s", "cpu_s")}
    make = control.find_policy(word).make
    return Chosen("model", folder.name, content, make, record["seed"], training)


# ------------------------------------------------------------------ references
def references(found: Sequence[Results]) -> dict[str, dict[str, Any]]:
    """Return the reference values of the tasks' scores; recorded values never change.

    For a task without recorded references the values are computed from the results in a folder. The task has no
    reference if the results lack PD, or if no method is better than PD.
    """
    known = {name: asdict(one) for name, one in frozen_references().items()}
    for task in suite.tasks():
        if task.id in known and known[task.id]["digest"] == task.digest:
            continue
        returns = {
            f"{one.name}-{one.run}" if entry["training"] else one.name: value(task, entry)
            for one, entry in of_task(task, found)
        }
        if FLOOR in returns and (best := max(returns, key=lambda name: returns[name])) != FLOOR:
            known[task.id] = asdict(Reference(task.digest, round(returns[FLOOR], 4), round(returns[best], 4), best))
    return known


def plan(todo: Sequence[Job], arguments: Arguments) -> list[str]:
    """Print a line per method: finished runs, missing runs, and the time that the missing runs need."""
    lines = []
    for method in METHODS:
        own = [job for job in todo if job.method == method]
        left = [job for job in own if not job.done(arguments.results)]
        if own:
            hours = sum(SECONDS.get(method.algorithm, 0.0) * job.task.budget * arguments.share for job in left) / 3600.0
            took = f", about {hours:.1f} CPU hours" if hours else ""
            lines.append(f"{method.name}: {len(own) - len(left)} of {len(own)} runs done{took if left else ''}")
    return lines


def made(arguments: Arguments) -> None:
    """Write the pages and the figure of results if the folder contains results."""
    if any(arguments.results.glob("*.json")):
        from flexarm_env.plotting.scores import plot_scores

        usual = ROOT / "docs" / "figures" if arguments.results.resolve() == RESULTS else arguments.results.parent
        found, figure = folder_of(arguments.results, earlier=True), (arguments.figures or usual) / "suite.png"
        figure.parent.mkdir(parents=True, exist_ok=True)
        plot_scores(*figure_data(found), figure)
        beside = os.path.relpath(figure, arguments.results.parent)
        for name, text in pages(found, arguments.results.name, beside).items():
            write_text(arguments.results.parent / name, text)


def work(arguments: Arguments) -> int:
    """Print the plan, write the references, or train and evaluate all missing jobs, as the flags say."""
    began, todo = time.monotonic(), list(jobs(arguments))
    if arguments.plan:
        print("\n".join(plan(todo, arguments)))
        return 0
    if arguments.freeze:
        known = references(folder_of(arguments.results, earlier=True))
        write_json(REFERENCES, known)
        print("\n".join(f"{name}: {one['pd']} (PD), {one['best']} ({one['by']})" for name, one in known.items()))
        return 0
    try:
        for job in todo:
            if job.done(arguments.results):
                continue
            if arguments.minutes is not None and time.monotonic() - began > 60.0 * arguments.minutes:
                print("\n".join(["the time is up; what is left:", *plan(todo, arguments)]))
                break
            print(run(job, arguments), flush=True)
            made(arguments)
        made(arguments)
    except KeyboardInterrupt:
        sys.stderr.write("interrupted; the same command goes on\n")
        return 130
    return 0


main = partial(command, Arguments, "python -m agents.suite", __doc__, work)

if __name__ == "__main__":
    sys.exit(main())
