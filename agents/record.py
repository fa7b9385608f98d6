"""Search the best actions for each episode of the suite's tasks; write them to flexarm_env/data/suite/best/TASK.npz.

    python -m agents.record [--task IDS] [--home runs/suite]

For each task the script runs several candidates: controllers with the task's observation and with the whole state, the
policies of all run folders, the results of `agents.foresight`, and the present record. `agents.foresight` then improves
the best actions of each episode, stabilized by feedback of the policies that observe the whole state. The search ends
when `PATIENCE` steps together increase the mean return by less than the share `ENOUGH`. Episodes whose value has
increased by more than `GAIN` are searched again from the new actions. With --grow, a second search optimizes growing
parts of the episodes without success (failed), or of all episodes (all).
"""

import sys
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from datetime import date
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from agents import foresight
from agents.suite import PRESSED, RESULTS, ROOT, of_run
from flexarm_env import control, suite
from flexarm_env import validation as check
from flexarm_env.episodes import Actions, Policy
from flexarm_env.files import write_npz
from flexarm_env.suite import best, results
from flexarm_env.suite.frozen import instants
from flexarm_env.suite.policies import choose
from flexarm_env.suite.results import chosen_tasks, frozen
from flexarm_env.suite.score import EPISODES
from flexarm_env.training.runs import command, read_json

HOME = ROOT / "flexarm_env" / "data" / "suite" / "best"
SEARCH, GROWS = "search from ", ("none", "failed", "all")
GAIN = 0.02
"""Least increase of an episode's value (return minus priced cost) after which the episode is searched again."""
GRIDS, LOST = (128.0, 256.0, 512.0, 1024.0, 8192.0), 0.02
"""GRIDS: the recorded actions of an episode are rounded to multiples of 1 / G; G is the first of GRIDS that suffices.

G suffices if rounding reduces the episode's value by at most LOST, and not below the value of any published run.
"""

AT_WALL = 512.0
"""Grid of actions at a wall. There the policies' own actions are rounded while they play, so that feedback corrects the
rounding; open-loop torques that are rounded later do not keep the tip on its path. Episodes in which a published run is
better keep exact actions."""


class Rounded(Policy):
    """Policy whose actions are rounded to multiples of 1 / grid."""

    def __init__(self, policy: Policy, grid: float) -> None:
        self.policy, self.grid = policy, grid

    def reset(self, observation: Any) -> None:
        """Reset the policy."""
        self.policy.reset(observation)

    def act(self, observation: Any) -> Any:
        """Return the policy's rounded actions."""
        return (np.round(self.policy.act(observation) * self.grid) / self.grid).astype(np.float32)


@dataclass(frozen=True)
class Arguments:
    """Arguments of `python -m agents.record`.

    Args:
        task: ids of tasks, separated by commas; default all.
        home: folder of the runs.
        out: folder of the records.
        steps: largest number of search steps; 0: no search.
        grow: failed, all or none: the episodes of the growing search; see `agents.foresight.growing`.
    """

    task: str | None = None
    home: Path = Path("runs/suite")
    out: Path = HOME
    steps: int = 500
    grow: str = "none"


def candidates(task: suite.Task, home: Path) -> Iterator[tuple[str, Any, bool]]:
    """Yield the candidates: name, function that makes the policy, and whether the policy observes the whole state."""
    if task.id in best.known():
        kept = best.record(task)
        yield "", lambda env: Actions(kept.actions), False
    for name in control.NAMES:
        for whole in (False, True) if set(foresight.SENSED) & set(task.keywords) else (False,):
            yield name, lambda env, name=name: choose(name, task).make(env), whole
    for folder in sorted(home.glob(f"*/{task.id}")):
        if finished(folder):
            yield folder.parent.name, of_run(str(folder), task).make, False


def finished(folder: Path) -> bool:
    """Return whether a folder contains a finished run."""
    ours = any((folder / name).is_file() for name in ("policy.npz", "model.zip", "actions.npz"))
    return ours and "cpu_s" in read_json(folder / "run.json")


def gathered(task: suite.Task, home: Path) -> tuple[Any, Any, list[str]]:
    """Run all candidates; return each episode's best actions, their value, and the name of the candidate."""
    shown = suite.make_vec(task.id, EPISODES)
    seen = foresight.seen_whole(task)
    wide = gym.make_vec(task.environment, EPISODES, vectorization_mode="vector_entry_point", **seen)
    names, ways, values, exact = [], [], [], []
    for name, make, whole in candidates(task, home):
        env = wide if whole else shown
        with suppress(ValueError):  # of a controller that is not made for the task
            # actions of the present record are rounded already
            for grid in (AT_WALL, None) if task.id in PRESSED and name else (None,):
                policy = make(env)
                way, value = foresight.played(env, policy if grid is None else Rounded(policy, grid), task.price)
                names.append(name)
                ways.append(way)
                values.append(value)
                exact.append(task.id in PRESSED and name != "" and grid is None)
    wide.close()
    # at a wall, exact actions only where the rounded ones are below a published run
    enough = np.max([v for v, e in zip(values, exact, strict=True) if not e], axis=0) >= published(task)
    values = [np.where(enough & e, -np.inf, v) for v, e in zip(values, exact, strict=True)]
    by = [names[i] or best.record(task).by[k] for k, i in enumerate(np.argmax(values, axis=0))]
    return *foresight.best_of(ways, values), by


def published(task: suite.Task) -> Any:
    """Return, for each episode, the largest value of the published runs; -inf if no run is published."""
    found = results.of_task(task, results.folder_of(RESULTS, earlier=True))
    rows = [results.values(task, entry) for _, entry in found]
    return np.max([np.full(EPISODES, -np.inf), *rows], axis=0)


def write(task: suite.Task, home: Path, actions: Any, values: Any, by: list[str]) -> None:
    """Write a task's record: actions, their values, the candidates' names, the task's digest and the date."""
    what = {"actions": best.packed(actions), "values": values, "by": by, "digest": task.digest}
    write_npz(home / f"{task.id}.npz", what | {"date": date.today().isoformat()})


def made(task: suite.Task, arguments: Arguments) -> str:
    """Search and write a task's record; return a line about the result.

    Raises ValueError if replayed actions have smaller values in the task than the run of their policy had.
    """
    kept, judged, by = gathered(task, arguments.home)
    env = suite.make_vec(task.id, EPISODES)
    values, successes = best.played(task, env, Actions(kept))
    if not (values >= judged).all():
        raise ValueError(f"{task.id}: other values in the task, by {np.abs(values - judged).max()}")
    # tasks at a wall have a force sensor, which has no derivatives: nothing is searched
    steps = 0 if task.id in PRESSED else arguments.steps
    trained = [] if task.id in PRESSED else foresight.beside(task, arguments.home)
    for stages in ([], foresight.growing(len(kept), instants(task.id)[1] + 2)):
        only = np.arange(EPISODES)
        if stages:
            only = only[{"none": only < 0, "failed": ~successes, "all": only >= 0}[arguments.grow]]
        if not steps:
            continue
        while len(only):
            begun = (kept.astype(float), values)
            more, _ = foresight.search(task, trained, steps=steps, start=begun, stages=stages, only=only, steadied=True)
            tried = kept.copy()
            tried[:, only] = more
            found, good = best.played(task, env, Actions(tried))
            gain, stages = found - values, []
            kept[:, gain > 0.0], values = tried[:, gain > 0.0], np.maximum(values, found)
            successes = np.where(gain > 0.0, good, successes)
            by = [SEARCH + name.removeprefix(SEARCH) if up > 0.0 else name for name, up in zip(by, gain, strict=True)]
            only = np.flatnonzero(gain > GAIN)
            write(task, arguments.out, kept, values, by)
    begun, whole = (kept.astype(float), values), np.ones(EPISODES, bool)
    least = np.maximum(values - LOST, np.minimum(published(task), values))
    for grid in () if task.id in PRESSED else GRIDS:
        rounded = foresight.search(task, trained, steps=0, start=begun, steadied=True, grid=grid)[0]
        rounded = rounded.astype(np.float32)
        found, _ = best.played(task, env, Actions(rounded))
        fine = whole & (found >= least)
        kept[:, fine] = rounded[:, fine]
        whole &= ~fine
    values, successes = best.played(task, env, Actions(kept))
    env.close()
    write(task, arguments.out, kept, values, by)
    return f"{task.id}: J {values.mean():.3f} ({judged.mean():.3f} before the search), success {successes.mean():.0%}"


def work(arguments: Arguments) -> int:
    """Search the records of the requested tasks."""
    check.choice("--grow", arguments.grow, GROWS)
    for task in map(frozen, chosen_tasks(arguments.task)):
        print(made(task, arguments), flush=True)
    return 0


main = partial(command, Arguments, "python -m agents.record", __doc__, work)

if __name__ == "__main__":
    sys.exit(main())
